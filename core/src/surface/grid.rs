//! A surface baked on a regular grid: value, gradient and variance by multilinear interpolation, at
//! a cost that does not depend on the number of contacts.

use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Gpis, Kernel, Prior, Probe, Surface};

/// Added to a number in [0, 2²²), it leaves the nearest whole number in the lowest bits: 1.5·2²³.
const ROUND: f32 = 12_582_912.0;

/// What a node knows beside its value.
#[derive(Clone, Copy, Debug)]
struct Node<S: Space> {
    gradient: S::Vector,
    variance: f32,
    slope_variance: f32,
    nearest: f32,
}

impl<S: Space> Node<S> {
    const UNSET: Self =
        Node { gradient: S::Vector::ZERO, variance: 0.0, slope_variance: 0.0, nearest: 0.0 };
}

/// Where a point lies between nodes.
struct Cell<S: Space> {
    /// Index of the lowest corner.
    base: usize,
    /// Position within the cell, 0 to 1 along each axis.
    weights: S::Vector,
    /// How far outside the cube, metres.
    outside: f32,
}

impl<S: Space> Cell<S> {
    /// Index relative to the lowest corner, and weight, of a corner; the lowest bit of its number
    /// says whether it is up along the last axis.
    #[inline(always)]
    fn corner(&self, corner: usize, side: usize) -> (usize, f32) {
        let mut weight = 1.0;
        let mut offset = 0;
        for axis in 0..S::DIMENSION {
            let up = corner >> (S::DIMENSION - 1 - axis) & 1;
            weight *= if up == 1 { self.weights[axis] } else { 1.0 - self.weights[axis] };
            offset = offset * side + up;
        }
        (offset, weight)
    }
}

/// At most `NODES` nodes on a cube of equal sides: ⌊√`NODES`⌋ (⌊∛`NODES`⌋) per axis.
#[derive(Clone, Debug)]
pub struct Grid<S: Space, const NODES: usize> {
    /// Apart from the rest, so that what only needs values stays in the cache.
    values: [f32; NODES],
    nodes: [Node<S>; NODES],
    baked: bool,
    low: S::Vector,
    /// Distance between nodes, metres, and its inverse.
    spacing: f32,
    inverse_spacing: f32,
}

/// What interpolation costs in accuracy, measured at the centres of the cells within 10 mm of the
/// surface, where it is worst as a rule. [`Grid::bound`] is what it can cost at most.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BakeError {
    /// Largest error of the value, metres.
    pub value: f32,
    /// Largest error of the gradient.
    pub gradient: f32,
    /// Number of cells measured.
    pub cells: usize,
}

impl<S: Space, const NODES: usize> Grid<S, NODES> {
    /// An empty grid, all zero bits.
    pub const fn new() -> Self {
        Grid {
            values: [0.0; NODES],
            nodes: [Node::UNSET; NODES],
            baked: false,
            low: S::Vector::ZERO,
            spacing: 0.0,
            inverse_spacing: 0.0,
        }
    }

    /// Nodes per axis.
    const SIDE: usize = Self::capacity();

    /// From the lowest corner of a cell to one past its highest: a slice of this constant length
    /// needs no further checks.
    const WINDOW: usize = {
        let (mut window, mut axis) = (1, 0);
        while axis < S::DIMENSION {
            window += power(Self::SIDE, axis);
            axis += 1;
        }
        window
    };

    /// Nodes per axis that `NODES` allows.
    pub const fn capacity() -> usize {
        let mut side = 1;
        while power(side + 1, S::DIMENSION) <= NODES {
            side += 1;
        }
        side
    }

    /// Distance between nodes, metres.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Samples `surface` on the cube of half-width `reach` (metres) about `centre`. Grids of fewer
    /// than two nodes per axis stay empty.
    pub fn bake(&mut self, surface: &impl Surface<S>, centre: S::Vector, reach: f32) {
        self.baked = false;
        let side = Self::SIDE;
        let good = reach > 0.0 && reach.is_finite() && centre.is_finite();
        if side < 2 || !good {
            return;
        }
        self.low = centre - S::Vector::from_fn(|_| reach);
        self.spacing = 2.0 * reach / (side - 1) as f32;
        self.inverse_spacing = 1.0 / self.spacing;
        let nodes = self.values.iter_mut().zip(&mut self.nodes).take(power(side, S::DIMENSION));
        for (index, (value, node)) in nodes.enumerate() {
            let probe = surface.probe(place::<S>(self.low, self.spacing, side, index, 0.0));
            *value = probe.value;
            *node = Node {
                gradient: probe.gradient,
                variance: probe.variance,
                slope_variance: probe.slope_variance,
                nearest: probe.nearest,
            };
        }
        self.baked = true;
    }

    /// Value of the interpolation at each point, the same bits as [`probe`](Surface::probe) gives.
    #[inline(always)]
    pub fn values<const L: usize>(&self, points: &[S::Vector; L]) -> [f32; L] {
        let mut f = [0.0; L];
        if self.baked {
            for (f, p) in f.iter_mut().zip(points) {
                let cell = self.locate(*p);
                if let Some(values) = self.values.get(cell.base..cell.base + Self::WINDOW) {
                    for corner in 0..1usize << S::DIMENSION {
                        let (index, weight) = cell.corner(corner, Self::SIDE);
                        *f += weight * values.get(index).copied().unwrap_or(0.0);
                    }
                }
                *f += cell.outside;
            }
        }
        f
    }

    /// The cell of a point; there must be one.
    #[inline(always)]
    fn locate(&self, point: S::Vector) -> Cell<S> {
        let last = (Self::SIDE - 1) as f32;
        let mut cell = Cell::<S> { base: 0, weights: S::Vector::ZERO, outside: 0.0 };
        let mut outside = S::Vector::ZERO;
        for axis in 0..S::DIMENSION {
            let c = (point[axis] - self.low[axis]) * self.inverse_spacing;
            // NaN fails the comparison and ends in cell 0.
            let inside = if c > 0.0 { c } else { 0.0 };
            let inside = if inside < last { inside } else { last };
            // The cell below, by adding a number so large that only whole ones have room beside it;
            // on a node either neighbour will do.
            let shifted = (inside - 0.5) + ROUND;
            let shifted =
                if shifted < ROUND + (last - 1.0) { shifted } else { ROUND + (last - 1.0) };
            let below = shifted.to_bits().wrapping_sub(ROUND.to_bits()) as usize;
            cell.base = cell.base * Self::SIDE + below;
            cell.weights[axis] = inside - (shifted - ROUND);
            outside[axis] = c - inside;
        }
        let square = outside.norm_squared();
        if square > 0.0 {
            cell.outside = math::sqrt(square) * self.spacing;
        }
        cell
    }

    /// Upper bounds of the errors of value (metres) and gradient anywhere in the cube, against the
    /// map the grid was baked from; at no cost that depends on the number of nodes. Zero before
    /// baking. See [`Gpis::interpolation_bound`].
    pub fn bound<K, P, const SITES: usize, const ROWS: usize, const PACKED: usize>(
        &self,
        map: &Gpis<S, K, P, SITES, ROWS, PACKED>,
    ) -> (f32, f32)
    where
        K: Kernel,
        P: Prior<S>,
    {
        if self.baked { map.interpolation_bound(self.spacing) } else { (0.0, 0.0) }
    }

    /// The error against the surface the grid was baked from.
    pub fn error(&self, surface: &impl Surface<S>) -> BakeError {
        let mut error = BakeError::default();
        if !self.baked {
            return error;
        }
        let cells = Self::SIDE - 1;
        for index in 0..power(cells, S::DIMENSION) {
            let p = place::<S>(self.low, self.spacing, cells, index, 0.5);
            let (got, want) = (self.probe(p), surface.probe(p));
            if want.value.abs() < 0.01 {
                error.value = error.value.max((got.value - want.value).abs());
                error.gradient = error.gradient.max((got.gradient - want.gradient).norm());
                error.cells += 1;
            }
        }
        error
    }
}

impl<S: Space, const NODES: usize> Default for Grid<S, NODES> {
    fn default() -> Self {
        Self::new()
    }
}

const fn power(base: usize, exponent: usize) -> usize {
    let mut result = 1;
    let mut i = 0;
    while i < exponent {
        result *= base;
        i += 1;
    }
    result
}

/// The point of node `index`, moved by `shift` cells along every axis; the last axis runs fastest.
fn place<S: Space>(
    low: S::Vector,
    spacing: f32,
    side: usize,
    index: usize,
    shift: f32,
) -> S::Vector {
    let mut rest = index;
    let mut p = low;
    for axis in (0..S::DIMENSION).rev() {
        p[axis] += ((rest % side) as f32 + shift) * spacing;
        rest /= side;
    }
    p
}

impl<S: Space, const NODES: usize> Surface<S> for Grid<S, NODES> {
    /// Multilinear inside the cube. Outside, the value at the nearest point of the cube plus the
    /// distance to it, so that leaving never pays. An empty grid answers with zeros and an infinite
    /// `nearest`.
    fn probe(&self, point: S::Vector) -> Probe<S> {
        let mut probe = Probe {
            value: 0.0,
            gradient: S::Vector::ZERO,
            variance: 0.0,
            slope_variance: 0.0,
            nearest: f32::INFINITY,
        };
        if !self.baked {
            return probe;
        }
        let cell = self.locate(point);
        probe.nearest = 0.0;
        let window = cell.base..cell.base + Self::WINDOW;
        let (Some(values), Some(nodes)) = (self.values.get(window.clone()), self.nodes.get(window))
        else {
            return probe;
        };
        for corner in 0..1usize << S::DIMENSION {
            let (index, weight) = cell.corner(corner, Self::SIDE);
            let (Some(value), Some(node)) = (values.get(index), nodes.get(index)) else {
                continue;
            };
            // Infinite at a node where nothing is known.
            if weight == 0.0 {
                continue;
            }
            probe.value += weight * value;
            probe.gradient += node.gradient * weight;
            probe.variance += weight * node.variance;
            probe.slope_variance += weight * node.slope_variance;
            probe.nearest += weight * node.nearest;
        }
        probe.value += cell.outside;
        probe.nearest += cell.outside;
        probe
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Contact;
    use crate::matrix::Vector;
    use crate::random::Random;
    use crate::space::{Planar, Spatial};
    use crate::surface::cholesky::packed;
    use crate::surface::{Ball, Map, Matern32, SquaredExponential, ThinPlate, Training};

    /// The signed distance of a ball of 30 mm.
    struct Round;
    impl<S: Space> Surface<S> for Round {
        fn probe(&self, p: S::Vector) -> Probe<S> {
            let n = p.norm().max(1e-6);
            let (gradient, nearest) = (p * (1.0 / n), (n - 0.03).abs());
            Probe { value: n - 0.03, gradient, variance: p[0] * p[0], slope_variance: 0.1, nearest }
        }
    }

    #[test]
    fn interpolates_within_the_reported_error() {
        let mut grid = Grid::<Spatial, 4096>::new();
        assert_eq!(Grid::<Spatial, 4096>::capacity(), 16);
        grid.bake(&Round, Vector([0.0; 3]), 0.06);
        let error = grid.error(&Round);
        assert!(error.cells > 100 && error.value < 1.2e-3 && error.gradient < 0.2, "{error:?}");
        for i in 0..50 {
            let (s, c) = (i as f32).sin_cos();
            let p = Vector([0.031 * c, 0.031 * s * 0.6, 0.031 * s * 0.8]);
            let (got, want) = (grid.probe(p), Surface::<Spatial>::probe(&Round, p));
            assert!((got.value - want.value).abs() <= error.value);
        }
    }

    #[test]
    fn values_have_the_bits_of_probes() {
        let mut grid = std::boxed::Box::new(Grid::<Spatial, 1331>::new());
        let points =
            [[0.0, 0.0, 0.0], [0.01, -0.02, 0.033], [0.05, 0.05, 0.05], [-0.05, 0.0, 0.01]]
                .map(Vector);
        assert_eq!(grid.values(&points), [0.0; 4]);
        grid.bake(&Round, Vector::ZERO, 0.05);
        let outside = [
            [0.2, 0.0, 0.0],
            [0.0, f32::NAN, 0.0],
            [f32::INFINITY, 0.0, 0.0],
            [0.049_999, 0.0, -0.3],
        ]
        .map(Vector);
        for points in [points, outside] {
            let probes = points.map(|p| grid.probe(p).value.to_bits());
            assert_eq!(grid.values(&points).map(f32::to_bits), probes);
        }
    }

    #[test]
    fn nodes_are_exact_and_leaving_never_pays() {
        let mut grid = Grid::<Planar, 900>::new();
        grid.bake(&Round, Vector([0.0, 0.0]), 0.058);
        let node = Vector([-0.058 + 4.0 * grid.spacing(), -0.058 + 9.0 * grid.spacing()]);
        let want = Surface::<Planar>::probe(&Round, node);
        assert!((grid.probe(node).value - want.value).abs() < 1e-6);
        assert!((grid.probe(node).variance - want.variance).abs() < 1e-6);
        let edge = grid.probe(Vector([0.058, 0.0])).value;
        assert!((grid.probe(Vector([0.158, 0.0])).value - edge - 0.1).abs() < 1e-5);
    }

    /// Largest errors inside the cube, and their bounds, of a map of 14 noisy touches.
    fn observed<K: Kernel>(kernel: K, seed: u64) -> ([f32; 2], [f32; 2]) {
        type Touched<K> = Gpis<Planar, K, Ball<Planar>, 14, 42, { packed(42) }>;
        let mut random = Random::new(seed);
        let mut map = std::boxed::Box::new(Touched::<K>::new());
        map.configure(kernel, Ball::UNSET, Training::Normals);
        for k in 0..14 {
            let (sin, cos) = (0.45 * k as f32 + 0.3).sin_cos();
            let off: Vector<2> = random.normal();
            map.insert(&Contact {
                point: Vector([0.05 * cos, 0.03 * sin]) + off * 1e-3,
                normal: Vector([cos / 0.05, sin / 0.03]).normalized(),
                point_deviation: 1e-3,
                normal_deviation: 0.0873,
                finger: 0,
            });
        }
        map.refit();
        let mut grid = std::boxed::Box::new(Grid::<Planar, 900>::new());
        grid.bake(&*map, Vector::ZERO, 0.07);
        let mut worst = [0.0f32; 2];
        for i in 0..20_000 {
            let at = |bits: i32| 0.1396 * ((bits % 141) as f32 / 140.0 - 0.5);
            let p = Vector([at(i), at(i / 141) + 1e-4]);
            let (got, want) = (grid.probe(p), map.probe(p));
            worst[0] = worst[0].max((got.value - want.value).abs());
            worst[1] = worst[1].max((got.gradient - want.gradient).norm());
        }
        let (value, gradient) = grid.bound(&map);
        (worst, [value, gradient])
    }

    #[test]
    fn no_error_exceeds_the_bound() {
        for seed in 0..3 {
            let rough = observed(Matern32 { amplitude: 0.03, lengthscale: 0.1 }, seed);
            let smooth = observed(SquaredExponential { amplitude: 0.03, lengthscale: 0.05 }, seed);
            let plate = observed(ThinPlate { amplitude: 0.05, range: 0.4 }, seed);
            // The norm allows for the worst function there is; the smooth ones are far from it.
            for ((worst, bound), loose) in [(rough, 20.0), (smooth, 50.0), (plate, 50.0)] {
                for (worst, bound) in worst.iter().zip(bound) {
                    assert!(worst <= &bound && bound < loose * worst, "{worst} of {bound}");
                }
            }
        }
        assert_eq!(
            Grid::<Planar, 900>::new()
                .bound(&Gpis::<Planar, Matern32, Ball<Planar>, 1, 3, 6>::new()),
            (0.0, 0.0)
        );
    }

    #[test]
    fn bad_input_is_decided() {
        let mut grid = Grid::<Planar, 100>::new();
        assert_eq!(grid.probe(Vector([0.0, 0.0])).nearest, f32::INFINITY);
        grid.bake(&Round, Vector([0.0, f32::NAN]), 0.05);
        assert_eq!(grid.probe(Vector([0.0, 0.0])).nearest, f32::INFINITY);
        grid.bake(&Round, Vector([0.0, 0.0]), 0.05);
        let _ = grid.probe(Vector([f32::NAN, f32::INFINITY]));
        let mut tiny = Grid::<Planar, 1>::new();
        tiny.bake(&Round, Vector([0.0, 0.0]), 0.05);
        assert_eq!(tiny.error(&Round).cells, 0);
    }
}
