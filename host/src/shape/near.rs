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

mod cells;

use std::ops::Range;

use super::Field;
use super::lattice::{Lattice, Samples, values_at};
use cells::{Cell, Cells, Form, combinations};

/// Spacings between neighbouring nodes of the coarse lattice; a power of two.
const COARSE: usize = 4;

/// How much steeper the field may be within a cell than between the nodes around it.
const SAFETY: f64 = 1.5;

/// Counts on, place by place.
fn add(counts: &mut [u8], more: &[u8]) {
    counts.iter_mut().zip(more).for_each(|(count, more)| *count += more);
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
    while cells.half > 0 {
        cells = search.refine(cells);
    }
    search.complete();
    // Where the object reaches the edge, the cells there are crossed.
    let edge = |range: &Range<usize>, i: usize| {
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
    fn coarse(&mut self, inner: [Range<usize>; 3]) -> Cells {
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
        let nodes = combinations(&stops);
        let raw = self.ask(&nodes.iter().map(|n| self.lattice.index(*n)).collect::<Vec<_>>());

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

        let mut cells = Cells { half: COARSE / 2, groups: Vec::new() };
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
                    let low = [stops[0][i], stops[1][j], stops[2][k]];
                    let high = [stops[0][p], stops[1][q], stops[2][r]];
                    let size = std::array::from_fn(|a| high[a] - low[a]);
                    let steepest = (SAFETY * steepest).max(self.lattice.spacing());
                    let cell = Cell { low: self.lattice.index(low), steepest };
                    cells.push(self.lattice, size, cell);
                }
            }
        }
        cells
    }

    /// Settles the sign of the nodes in the cells once they are halved, evaluating those in doubt;
    /// gives the parts of the cells that may hold a piece of the surface.
    fn refine(&mut self, cells: Cells) -> Cells {
        let Cells { half, mut groups } = cells;
        for (form, cells) in &mut groups {
            cells.retain(|cell| match self.bound(form, cell) {
                Some(bound) => {
                    self.fill(form, cell, bound);
                    false
                }
                None => true,
            });
        }
        // What the middles of edges prove spares some of those of faces, and these some of those of
        // cells.
        for kind in 1..=3 {
            let mut asked = Vec::new();
            for (form, cells) in &groups {
                cells.iter().for_each(|cell| self.settle(form, cell, kind, &mut asked));
            }
            self.ask(&asked);
        }
        let mut parts = Cells { half: half / 2, groups: Vec::new() };
        if parts.half == 0 {
            return parts;
        }
        for (form, cells) in &groups {
            for cell in cells {
                for (offset, size) in &form.parts {
                    let part = Cell { low: cell.low + offset, steepest: cell.steepest };
                    parts.push(self.lattice, *size, part);
                }
            }
        }
        for (form, cells) in &mut parts.groups {
            for cell in cells {
                cell.steepest = cell.steepest.max(SAFETY * self.slope(form, cell));
            }
        }
        parts
    }

    /// Settles the sign of a cell's new nodes of one kind where their witnesses prove it; the others
    /// are to be `asked`.
    fn settle(&mut self, form: &Form, cell: &Cell, kind: usize, asked: &mut Vec<usize>) {
        for n in form.kinds[kind].clone() {
            let at = cell.low + form.nodes[n];
            if self.known[at] == 1 {
                continue;
            }
            self.known[at] = 1;
            // How far from zero the witnesses let the field be: above, and below.
            let (mut above, mut below) = (0.0, 0.0);
            for (witness, distance) in &form.witnesses[n] {
                let value = self.values[cell.low + witness];
                let reach = cell.steepest * distance;
                above = if value - reach > above { value - reach } else { above };
                below = if value + reach < below { value + reach } else { below };
            }
            // Witnesses that contradict one another prove nothing.
            match (above > 0.0, below < 0.0) {
                (true, false) => self.values[at] = above,
                (false, true) => self.values[at] = below,
                _ => asked.push(at),
            }
        }
    }

    /// A value that the field is certainly beyond in all of the cell, if one corner gives it.
    fn bound(&self, form: &Form, cell: &Cell) -> Option<f64> {
        let values = form.corners.map(|c| self.values[cell.low + c]);
        let outside = values[0] > 0.0;
        if values.iter().any(|v| (*v > 0.0) != outside) {
            return None;
        }
        let furthest = values.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let left = furthest - cell.steepest * form.diagonal;
        (left > 0.0).then(|| left.copysign(values[0]))
    }

    /// The steepest edge of a cell between corners whose values are known.
    fn slope(&self, form: &Form, cell: &Cell) -> f64 {
        let corners = form.corners.map(|c| cell.low + c);
        let mut squared = 0.0;
        for axis in 0..3 {
            let length = form.size[axis] as f64;
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

    fn fill(&mut self, form: &Form, cell: &Cell, value: f64) {
        for k in 0..=form.size[2] {
            for j in 0..=form.size[1] {
                let first = cell.low + self.lattice.index([0, j, k]);
                let row = first..first + form.size[0] + 1;
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
    fn missing(&self) -> Vec<usize> {
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
                        let first = self.lattice.index([i, j, k]);
                        missing.extend((first..first + 2).filter(|at| self.exact[*at] == 0));
                    }
                }
            }
        }
        missing.sort_unstable();
        missing.dedup();
        missing
    }

    /// Evaluates the field at nodes; what it gave, finite or not.
    fn ask(&mut self, nodes: &[usize]) -> Vec<f64> {
        let [nx, ny, _] = self.lattice.counts();
        let point = |at: &usize| self.lattice.node([at % nx, at / nx % ny, at / nx / ny]);
        let points: Vec<_> = nodes.iter().map(point).collect();
        let found = values_at(self.field, &points);
        for (at, value) in nodes.iter().zip(&found) {
            self.values[*at] = if value.is_finite() { *value } else { self.lattice.spacing() };
            (self.exact[*at], self.known[*at]) = (1, 1);
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
