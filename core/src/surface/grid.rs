//! A surface baked on a regular grid: value, gradient and variance by multilinear interpolation, at
//! a cost that does not depend on the number of contacts.

use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Probe, Surface};

#[derive(Clone, Copy, Debug)]
struct Node<S: Space> {
    value: f32,
    gradient: S::Vector,
    variance: f32,
    slope_variance: f32,
    nearest: f32,
}

impl<S: Space> Node<S> {
    const UNSET: Self = Node {
        value: 0.0,
        gradient: S::Vector::ZERO,
        variance: 0.0,
        slope_variance: 0.0,
        nearest: 0.0,
    };
}

/// At most `NODES` nodes on a cube of equal sides: ⌊√`NODES`⌋ (⌊∛`NODES`⌋) per axis.
#[derive(Clone, Debug)]
pub struct Grid<S: Space, const NODES: usize> {
    nodes: [Node<S>; NODES],
    /// Nodes per axis; 0 before the first baking.
    side: usize,
    low: S::Vector,
    /// Distance between nodes, metres, and its inverse.
    spacing: f32,
    inverse_spacing: f32,
}

/// What interpolation costs in accuracy, measured at the centres of the cells within 10 mm of the
/// surface, where it is worst.
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
            nodes: [Node::UNSET; NODES],
            side: 0,
            low: S::Vector::ZERO,
            spacing: 0.0,
            inverse_spacing: 0.0,
        }
    }

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
        self.side = 0;
        let side = Self::capacity();
        let good = reach > 0.0 && reach.is_finite() && centre.is_finite();
        if side < 2 || !good {
            return;
        }
        self.low = centre - S::Vector::from_fn(|_| reach);
        self.spacing = 2.0 * reach / (side - 1) as f32;
        self.inverse_spacing = 1.0 / self.spacing;
        for (index, node) in self.nodes[..power(side, S::DIMENSION)].iter_mut().enumerate() {
            let probe = surface.probe(place::<S>(self.low, self.spacing, side, index, 0.0));
            *node = Node {
                value: probe.value,
                gradient: probe.gradient,
                variance: probe.variance,
                slope_variance: probe.slope_variance,
                nearest: probe.nearest,
            };
        }
        self.side = side;
    }

    /// The error against the surface the grid was baked from.
    pub fn error(&self, surface: &impl Surface<S>) -> BakeError {
        let mut error = BakeError::default();
        if self.side < 2 {
            return error;
        }
        let cells = self.side - 1;
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
        if self.side < 2 {
            return probe;
        }
        probe.nearest = 0.0;
        let last = (self.side - 2) as f32;
        let mut base = 0;
        let mut weights = S::Vector::ZERO;
        let mut outside = S::Vector::ZERO;
        for axis in 0..S::DIMENSION {
            let c = (point[axis] - self.low[axis]) * self.inverse_spacing;
            let inside = c.clamp(0.0, last + 1.0);
            // NaN fails the comparison and ends in cell 0.
            let inside = if inside >= 0.0 { inside } else { 0.0 };
            let cell = (inside as usize).min(self.side - 2);
            base = base * self.side + cell;
            weights[axis] = inside - cell as f32;
            outside[axis] = (c - inside) * self.spacing;
        }
        for corner in 0..1usize << S::DIMENSION {
            let mut weight = 1.0;
            let mut offset = 0;
            for axis in 0..S::DIMENSION {
                let up = corner >> (S::DIMENSION - 1 - axis) & 1;
                weight *= if up == 1 { weights[axis] } else { 1.0 - weights[axis] };
                offset = offset * self.side + up;
            }
            let Some(node) = self.nodes.get(base + offset) else { continue };
            probe.value += weight * node.value;
            probe.gradient += node.gradient * weight;
            probe.variance += weight * node.variance;
            probe.slope_variance += weight * node.slope_variance;
            probe.nearest += weight * node.nearest;
        }
        let left = outside.norm();
        if left > 0.0 {
            probe.value += left;
            probe.nearest += left;
        }
        probe
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::{Planar, Spatial};

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
