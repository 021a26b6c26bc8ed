//! Sampling a field on a lattice only where its zero set may be.
//!
//! From a coarse lattice inwards: a cell is passed over when the field at one of its corners is so
//! far from zero that it cannot reach zero within the cell, were it as steep there as a signed
//! distance, or [`SAFETY`] times as steep as between the nodes around the cell, whichever is more.
//! Finally every cell of the fine lattice that the surface crosses gets its true corners, and with
//! them its neighbours, until no crossed cell is left: a component of which one cell was found is
//! found whole.
//!
//! Fields whose slope is nowhere above one, signed distances among them, therefore lose nothing, be
//! it as small as a single node. Of others a whole component may be lost if it lies within a cell
//! of [`COARSE`] spacings and the field climbs to it more than [`SAFETY`] times as steeply as
//! anywhere between the nodes around: no Gaussian process does whose lengthscale spans that cell.

use super::Field;
use super::lattice::{Lattice, Samples, values_at};

/// Spacings between neighbouring nodes of the coarse lattice; a power of two.
const COARSE: usize = 4;

/// How much steeper the field may be within a cell than between the nodes around it.
const SAFETY: f64 = 1.5;

/// A box of the lattice between two nodes; flat along axes the lattice does not have.
#[derive(Clone, Copy)]
struct Cell {
    low: [usize; 3],
    high: [usize; 3],
    /// The greatest slope the field is believed to have within, metres per spacing.
    steepest: f64,
}

impl Cell {
    /// Its eight corners, some of them equal where it is flat.
    fn corners(&self) -> [[usize; 3]; 8] {
        let ([a, b, c], [x, y, z]) = (self.low, self.high);
        let below = [[a, b, c], [x, b, c], [a, y, c], [x, y, c]];
        let above = below.map(|[i, j, _]| [i, j, z]);
        let [p, q, r, s] = below;
        let [t, u, v, w] = above;
        [p, q, r, s, t, u, v, w]
    }

    fn diagonal(&self) -> f64 {
        distance(self.low, self.high)
    }

    /// Along each axis its ends and, `half` from the lower one, its middle.
    fn stops(&self, half: usize) -> [Vec<usize>; 3] {
        std::array::from_fn(|a| {
            let mut stops = vec![self.low[a], self.low[a] + half, self.high[a]];
            stops.retain(|s| *s <= self.high[a]);
            stops.dedup();
            stops
        })
    }
}

/// The nodes half-way through cells of one size: where from the lower corner, and how far, in
/// spacings, from each corner.
struct Template {
    size: [usize; 3],
    nodes: Vec<([usize; 3], [f64; 8])>,
}

impl Template {
    fn of(size: [usize; 3], half: usize) -> Self {
        let cell = Cell { low: [0; 3], high: size, steepest: 0.0 };
        let [xs, ys, zs] = cell.stops(half);
        let mut nodes = Vec::with_capacity(27);
        for &k in &zs {
            for &j in &ys {
                nodes.extend(xs.iter().map(|i| [*i, j, k]));
            }
        }
        let corners = cell.corners();
        nodes.retain(|n| !corners.contains(n));
        let nodes =
            nodes.into_iter().map(|n| (n, corners.map(|corner| distance(corner, n)))).collect();
        Template { size, nodes }
    }
}

/// Counts on, place by place.
fn add(counts: &mut [u8], more: &[u8]) {
    counts.iter_mut().zip(more).for_each(|(count, more)| *count += more);
}

/// In spacings.
fn distance(a: [usize; 3], b: [usize; 3]) -> f64 {
    let squared = |axis: usize| (a[axis].abs_diff(b[axis]) as f64).powi(2);
    (squared(0) + squared(1) + squared(2)).sqrt()
}

struct Search<'a> {
    lattice: &'a Lattice,
    field: &'a dyn Field,
    /// The field where `exact`; elsewhere a value of the same sign closer to zero.
    values: Vec<f64>,
    /// 1 for nodes whose value is the field's.
    exact: Vec<u8>,
    /// 1 for nodes whose value or sign is known.
    known: Vec<u8>,
}

/// The field in every cell that its zero set crosses, its sign everywhere; see the
/// [module](self) for what the sign rests on. The outermost layer, and wherever the field is not
/// finite, holds the spacing.
pub(super) fn sample(lattice: &Lattice, field: &dyn Field) -> Samples {
    let [nx, ny, nz] = lattice.counts();
    let nodes = nx * ny * nz;
    let mut search = Search {
        lattice,
        field,
        values: vec![lattice.spacing(); nodes],
        exact: vec![1; nodes],
        known: vec![1; nodes],
    };
    let inner = lattice.counts().map(|n| if n == 1 { 0..1 } else { 1..n - 1 });
    for k in inner[2].clone() {
        for j in inner[1].clone() {
            let row = lattice.index([inner[0].start, j, k]);
            search.exact[row..row + inner[0].len()].fill(0);
            search.known[row..row + inner[0].len()].fill(0);
        }
    }
    let mut cells = search.coarse(inner.clone());
    let mut half = COARSE / 2;
    while half > 0 {
        cells = search.refine(cells, half);
        half /= 2;
    }
    search.complete();
    // Where the object reaches the edge, the cells there are crossed.
    let edge = |range: &std::ops::Range<usize>, i: usize| {
        range.len() > 1 && (i == range.start || i + 1 == range.end)
            || range.len() == 1 && range.start == 1
    };
    let mut clipped = false;
    for k in inner[2].clone() {
        for j in inner[1].clone() {
            let whole = edge(&inner[2], k) || edge(&inner[1], j);
            let step = if whole { 1 } else { (inner[0].len() - 1).max(1) };
            clipped |= inner[0]
                .clone()
                .step_by(step)
                .any(|i| search.values[lattice.index([i, j, k])] < 0.0);
        }
    }
    Samples { values: search.values, clipped }
}

impl Search<'_> {
    /// Evaluates the coarse lattice and gives its cells.
    fn coarse(&mut self, inner: [std::ops::Range<usize>; 3]) -> Vec<Cell> {
        let stops = inner.map(|range| {
            let last = range.end - 1;
            let mut stops: Vec<usize> = range.step_by(COARSE).collect();
            if stops.last() != Some(&last) {
                stops.push(last);
            }
            stops
        });
        let [nx, ny, nz] = [stops[0].len(), stops[1].len(), stops[2].len()];
        let place = |i: usize, j: usize, k: usize| (k * ny + j) * nx + i;
        let mut nodes = Vec::with_capacity(nx * ny * nz);
        for k in &stops[2] {
            for j in &stops[1] {
                nodes.extend(stops[0].iter().map(|i| [*i, *j, *k]));
            }
        }
        let raw = self.ask(&nodes);

        let mut slopes = vec![0.0; nodes.len()];
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let here = [i, j, k];
                    let at = place(i, j, k);
                    let mut squared = 0.0;
                    for axis in 0..3 {
                        let mut greatest: f64 = 0.0;
                        for other in [here[axis].wrapping_sub(1), here[axis] + 1] {
                            if let Some(stop) = stops[axis].get(other) {
                                let mut there = here;
                                there[axis] = other;
                                let change = raw[place(there[0], there[1], there[2])] - raw[at];
                                let apart = stop.abs_diff(stops[axis][here[axis]]) as f64;
                                let slope = change.abs() / apart;
                                greatest = if slope <= greatest { greatest } else { slope };
                            }
                        }
                        squared += greatest * greatest;
                    }
                    // Nothing is known about a field around where it is not finite.
                    slopes[at] = if squared.is_finite() { squared.sqrt() } else { f64::INFINITY };
                }
            }
        }

        let mut cells = Vec::new();
        let ranges = |n: usize| 0..(n - 1).max(1);
        for k in ranges(nz) {
            for j in ranges(ny) {
                for i in ranges(nx) {
                    let [p, q, r] = [(i + 1).min(nx - 1), (j + 1).min(ny - 1), (k + 1).min(nz - 1)];
                    let mut steepest: f64 = 0.0;
                    for c in 0..8usize {
                        let pick = |a: usize, low: usize, high: usize| {
                            if c >> a & 1 == 0 { low } else { high }
                        };
                        let corner = place(pick(0, i, p), pick(1, j, q), pick(2, k, r));
                        steepest = steepest.max(slopes[corner]);
                    }
                    cells.push(Cell {
                        low: [stops[0][i], stops[1][j], stops[2][k]],
                        high: [stops[0][p], stops[1][q], stops[2][r]],
                        steepest: (SAFETY * steepest).max(self.lattice.spacing()),
                    });
                }
            }
        }
        cells
    }

    /// Settles the sign of the nodes `half` apart in the cells, evaluating those in doubt; gives
    /// the halves of the cells that may hold a piece of the surface.
    fn refine(&mut self, cells: Vec<Cell>, half: usize) -> Vec<Cell> {
        let mut doubtful = Vec::new();
        for cell in cells {
            match self.bound(&cell) {
                Some(bound) => self.fill(&cell, bound),
                None => doubtful.push(cell),
            }
        }
        let mut asked = Vec::new();
        let mut template = Template { size: [usize::MAX; 3], nodes: Vec::new() };
        for cell in &doubtful {
            let size = std::array::from_fn(|a| cell.high[a] - cell.low[a]);
            if size != template.size {
                template = Template::of(size, half);
            }
            let values = self.corner_values(cell);
            for (offset, distances) in &template.nodes {
                let node = std::array::from_fn(|a| cell.low[a] + offset[a]);
                let at = self.lattice.index(node);
                if self.known[at] == 1 {
                    continue;
                }
                self.known[at] = 1;
                // How far from zero the corners let the field be: above, and below.
                let (mut above, mut below) = (0.0, 0.0);
                for (value, distance) in values.iter().zip(distances) {
                    let reach = cell.steepest * distance;
                    above = if value - reach > above { value - reach } else { above };
                    below = if value + reach < below { value + reach } else { below };
                }
                // Corners that contradict one another prove nothing.
                match (above > 0.0, below < 0.0) {
                    (true, false) => self.values[at] = above,
                    (false, true) => self.values[at] = below,
                    _ => asked.push(node),
                }
            }
        }
        self.ask(&asked);
        let mut halves = Vec::new();
        if half == 1 {
            return halves;
        }
        for cell in doubtful {
            let stops = cell.stops(half);
            let spans = stops.each_ref().map(|s| {
                let pairs: Vec<[usize; 2]> = s.windows(2).map(|w| [w[0], w[1]]).collect();
                if pairs.is_empty() { vec![[s[0], s[0]]] } else { pairs }
            });
            for z in &spans[2] {
                for y in &spans[1] {
                    for x in &spans[0] {
                        let mut part = Cell {
                            low: [x[0], y[0], z[0]],
                            high: [x[1], y[1], z[1]],
                            steepest: cell.steepest,
                        };
                        part.steepest = part.steepest.max(SAFETY * self.slope(&part));
                        halves.push(part);
                    }
                }
            }
        }
        halves
    }

    fn corner_values(&self, cell: &Cell) -> [f64; 8] {
        cell.corners().map(|c| self.values[self.lattice.index(c)])
    }

    /// A value that the field is certainly beyond in all of the cell, if one corner gives it.
    fn bound(&self, cell: &Cell) -> Option<f64> {
        let values = self.corner_values(cell);
        let outside = values[0] > 0.0;
        if values.iter().any(|v| (*v > 0.0) != outside) {
            return None;
        }
        let furthest = values.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let left = furthest - cell.steepest * cell.diagonal();
        (left > 0.0).then(|| left.copysign(values[0]))
    }

    /// The steepest edge of a cell between corners whose values are known.
    fn slope(&self, cell: &Cell) -> f64 {
        let corners = cell.corners().map(|c| self.lattice.index(c));
        let mut squared = 0.0;
        for axis in 0..3 {
            let length = cell.high[axis].abs_diff(cell.low[axis]) as f64;
            let mut greatest: f64 = 0.0;
            for (c, from) in corners.iter().enumerate().filter(|(c, _)| c >> axis & 1 == 0) {
                let to = corners[c | 1 << axis];
                if length > 0.0 && self.exact[*from] == 1 && self.exact[to] == 1 {
                    greatest = greatest.max((self.values[to] - self.values[*from]).abs() / length);
                }
            }
            squared += greatest * greatest;
        }
        squared.sqrt()
    }

    fn fill(&mut self, cell: &Cell, value: f64) {
        for k in cell.low[2]..=cell.high[2] {
            for j in cell.low[1]..=cell.high[1] {
                let first = self.lattice.index([cell.low[0], j, k]);
                let row = first..first + cell.high[0] - cell.low[0] + 1;
                for (known, to) in self.known[row.clone()].iter_mut().zip(&mut self.values[row]) {
                    if *known == 0 {
                        (*known, *to) = (1, value);
                    }
                }
            }
        }
    }

    /// Evaluates the field until every crossed cell has its true corners.
    fn complete(&mut self) {
        loop {
            let missing = self.missing();
            if missing.is_empty() {
                return;
            }
            self.ask(&missing);
        }
    }

    /// Nodes without a value of their own in cells whose corners differ in sign.
    fn missing(&self) -> Vec<[usize; 3]> {
        let [nx, ny, nz] = self.lattice.counts();
        let layers: &[usize] = if nz == 1 { &[0] } else { &[0, 1] };
        let most = 4 * layers.len() as u8;
        let negative: Vec<u8> = self.values.iter().map(|v| u8::from(*v < 0.0)).collect();
        let mut missing = Vec::new();
        let (mut inside, mut exact) = (vec![0u8; nx], vec![0u8; nx]);
        let mut open = vec![false; nx - 1];
        for k in 0..(nz - 1).max(1) {
            for j in 0..ny - 1 {
                let rows = layers.iter().flat_map(|up| [[j, k + up], [j + 1, k + up]]);
                inside.fill(0);
                exact.fill(0);
                for [j, k] in rows.clone() {
                    let first = self.lattice.index([0, j, k]);
                    add(&mut inside, &negative[first..first + nx]);
                    add(&mut exact, &self.exact[first..first + nx]);
                }
                let mut any = false;
                let cells = inside.windows(2).zip(exact.windows(2));
                for (open, (inside, exact)) in open.iter_mut().zip(cells) {
                    let (inside, exact) = (inside[0] + inside[1], exact[0] + exact[1]);
                    *open = (inside != 0) & (inside != most) & (exact != most);
                    any |= *open;
                }
                if !any {
                    continue;
                }
                for i in (0..nx - 1).filter(|i| open[*i]) {
                    for [j, k] in rows.clone() {
                        let unknown = |i: &usize| self.exact[self.lattice.index([*i, j, k])] == 0;
                        missing.extend([i, i + 1].into_iter().filter(unknown).map(|i| [i, j, k]));
                    }
                }
            }
        }
        missing.sort_unstable();
        missing.dedup();
        missing
    }

    /// Evaluates the field at nodes; what it gave, finite or not.
    fn ask(&mut self, nodes: &[[usize; 3]]) -> Vec<f64> {
        let points: Vec<_> = nodes.iter().map(|n| self.lattice.node(*n)).collect();
        let found = values_at(self.field, &points);
        for (node, value) in nodes.iter().zip(&found) {
            let at = self.lattice.index(*node);
            self.values[at] = if value.is_finite() { *value } else { self.lattice.spacing() };
            (self.exact[at], self.known[at]) = (1, 1);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
    use crate::space::Point;
    use proptest::prelude::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// A field that counts how often it is asked.
    struct Counted<F>(F, AtomicUsize);

    fn counted<F: Fn(&Point) -> f64 + Sync>(f: F) -> Counted<F> {
        Counted(f, AtomicUsize::new(0))
    }

    impl<F: Fn(&Point) -> f64 + Sync> Field for Counted<F> {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            self.1.fetch_add(points.len(), Ordering::Relaxed);
            points.iter().map(&self.0).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            vec![0.0; points.len()]
        }
    }

    /// Whether both ways of sampling have the same signs, and the same values wherever a cell is
    /// crossed; how many nodes are negative.
    fn compare(lattice: &Lattice, field: &dyn Field) -> Result<usize, String> {
        let (near, all) = (sample(lattice, field), lattice.sample_everywhere(field));
        if near.clipped != all.clipped {
            return Err(format!("clipped: {} {}", near.clipped, all.clipped));
        }
        let [nx, ny, nz] = lattice.counts();
        let layers: &[usize] = if nz == 1 { &[0] } else { &[0, 1] };
        for k in 0..(nz - 1).max(1) {
            for j in 0..ny - 1 {
                for i in 0..nx - 1 {
                    let mut corners = Vec::new();
                    for up in layers {
                        for [i, j] in [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]] {
                            corners.push(lattice.index([i, j, k + up]));
                        }
                    }
                    let negative = corners.iter().filter(|c| all.values[**c] < 0.0).count();
                    let crossed = negative > 0 && negative < corners.len();
                    for c in corners {
                        let (a, b) = (near.values[c], all.values[c]);
                        if (a < 0.0) != (b < 0.0) || crossed && a != b {
                            return Err(format!("cell {:?}: {a} for {b}", [i, j, k]));
                        }
                    }
                }
            }
        }
        Ok(all.values.iter().filter(|v| **v < 0.0).count())
    }

    fn cube(half: f64, spacing: f64, axes: usize) -> Lattice {
        let corner = Point::from([half; 3]);
        Lattice::new((-corner, corner), spacing, axes).unwrap()
    }

    /// Contacts strewn about at random with normals at random: no object at all.
    fn nonsense(dimension: usize, draws: &[[f64; 6]], kernel: Kernel) -> Gpis {
        let contacts: Vec<Contact> = draws
            .iter()
            .map(|u| {
                let flat = |p: Point| if dimension == 2 { Point::new(p.x, p.y, 0.0) } else { p };
                let point = flat(Point::new(u[0], u[1], u[2]) * 0.05);
                let normal = flat(Point::new(u[3], u[4], u[5]) + Point::x() * 1e-3).normalize();
                let (point_deviation, normal_deviation) = (1e-3, 0.1);
                Contact { point, normal: Some(normal), point_deviation, normal_deviation }
            })
            .collect();
        let prior = Prior::Ball { centre: Point::zeros(), radius: 0.03 };
        Gpis::fit(dimension, kernel, prior, Training::Derivative, &contacts).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn no_gaussian_process_loses_anything(
            dimension in 2usize..=3,
            draws in proptest::collection::vec(proptest::array::uniform6(-1.0f64..1.0), 1..25),
            lengthscale in 0.01f64..0.1,
            rough in any::<bool>(),
        ) {
            let amplitude = 0.03;
            let kernel = if rough {
                Kernel::Matern32 { amplitude, lengthscale }
            } else {
                Kernel::SquaredExponential { amplitude, lengthscale }
            };
            let surface = nonsense(dimension, &draws, kernel);
            let lattice = cube(0.07, if dimension == 2 { 0.0013 } else { 0.003 }, dimension);
            compare(&lattice, &surface).map_err(TestCaseError::fail)?;
        }

        #[test]
        fn no_distance_loses_anything(
            spheres in proptest::collection::vec(
                (proptest::array::uniform3(-0.06f64..0.06), 0.5f64..4.0), 1..12),
            sheet in proptest::option::of((-0.06f64..0.06, 0.2f64..3.0)),
            axes in 2usize..=3,
        ) {
            // Down to a single node, in the coarse cells' middles or anywhere; sheets and gaps too.
            let spacing = 0.003;
            let solid = |p: &Point| {
                spheres
                    .iter()
                    .map(|(c, r)| (p - Point::from(*c)).norm() - r * spacing)
                    .chain(sheet.map(|(x, half)| (p.x - x).abs() - half * spacing))
                    .fold(f64::INFINITY, f64::min)
            };
            let lattice = cube(0.07, spacing, axes);
            compare(&lattice, &counted(solid)).map_err(TestCaseError::fail)?;
            compare(&lattice, &counted(|p: &Point| -solid(p))).map_err(TestCaseError::fail)?;
        }
    }

    #[test]
    fn only_the_surface_is_looked_at() {
        let lattice = cube(1.0, 2.0 / 63.0, 3);
        let ball = counted(|p: &Point| p.norm() - 0.5);
        sample(&lattice, &ball);
        let asked = ball.1.load(Ordering::Relaxed);
        assert!(asked < 64 * 64 * 64 / 12, "{asked}");
        let nodes = compare(&lattice, &ball).unwrap();
        assert!(nodes > 15_000, "{nodes}");
    }

    #[test]
    fn small_and_odd_lattices_are_whole() {
        for axes in [2, 3] {
            for cells in [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0, 10.0] {
                let corner = Point::from([cells; 3]);
                let lattice = Lattice::new((Point::zeros(), corner), 1.0, axes).unwrap();
                for radius in [0.3, 1.2, 3.0, 100.0] {
                    let ball = counted(|p: &Point| (p - corner * 0.4).norm() - radius);
                    let lost = compare(&lattice, &ball);
                    assert!(lost.is_ok(), "{axes} {cells} {radius}: {lost:?}");
                }
            }
        }
    }

    #[test]
    fn what_is_not_finite_is_outside_and_hides_nothing_around_it() {
        let lattice = cube(0.06, 0.003, 3);
        for hole in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let f = |p: &Point| if p.x > 0.01 { hole } else { p.norm() - 0.03 };
            compare(&lattice, &counted(f)).unwrap();
        }
        compare(&lattice, &counted(|_: &Point| f64::NAN)).unwrap();
        compare(&lattice, &counted(|_: &Point| 0.0)).unwrap();
        compare(&lattice, &counted(|_: &Point| -1.0)).unwrap();
    }
}
