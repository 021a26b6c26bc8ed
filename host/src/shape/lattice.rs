//! The regular lattice a field is sampled on before its zero set is traced.

use rayon::prelude::*;
use thiserror::Error;

use super::{Field, near};
use crate::space::Point;

/// Most nodes a lattice may have: 256³, about 130 MB of values.
pub const MOST_NODES: usize = 1 << 24;

/// Points handed to a field at once; small enough to spread the work evenly over the cores.
const BATCH: usize = 288;

/// Why a field cannot be traced.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LatticeError {
    /// Not a positive, finite length.
    #[error("lattice spacing {0} m: expected a positive finite length")]
    Spacing(f64),
    /// Not an upright box.
    #[error("lattice bounds from {least:?} to {greatest:?}: expected finite corners, least first")]
    Bounds {
        /// The corner given first, metres.
        least: [f64; 3],
        /// The corner given second, metres.
        greatest: [f64; 3],
    },
    /// Too fine for the box.
    #[error("lattice of {0:.0} nodes: expected at most {MOST_NODES}; use a wider spacing")]
    Nodes(f64),
}

/// Nodes `spacing` apart that fill a box, inside one more layer all around that counts as outside
/// the object, so that the zero set of any field on it is closed.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    corner: Point,
    spacing: f64,
    counts: [usize; 3],
    axes: usize,
}

/// The values of a field on a [`Lattice`].
#[derive(Clone, Debug)]
pub struct Samples {
    /// One value per node, metres; x runs fastest, then y, then z. Where neighbours differ in sign,
    /// and in all cells that do, it is the field's; elsewhere it has the field's sign. The
    /// outermost layer, and wherever the field is not finite, holds `spacing`.
    pub values: Vec<f64>,
    /// Whether the object reaches the edge of the box, so that its surface is cut off there.
    pub clipped: bool,
}

impl Lattice {
    /// A lattice over the box between two corners, metres; `axes` is 2 (in the plane z = 0) or 3.
    pub fn new(bounds: (Point, Point), spacing: f64, axes: usize) -> Result<Self, LatticeError> {
        let (least, greatest) = bounds;
        if !(spacing.is_finite() && spacing > 0.0) {
            return Err(LatticeError::Spacing(spacing));
        }
        let upright = (0..axes.min(3))
            .all(|a| least[a].is_finite() && greatest[a].is_finite() && least[a] <= greatest[a]);
        if !upright {
            return Err(LatticeError::Bounds { least: least.into(), greatest: greatest.into() });
        }
        let mut counts = [1; 3];
        let mut corner = Point::zeros();
        let mut nodes = 1.0;
        for axis in 0..axes.min(3) {
            let steps = ((greatest[axis] - least[axis]) / spacing).ceil();
            nodes *= steps + 3.0;
            if nodes > MOST_NODES as f64 {
                return Err(LatticeError::Nodes(nodes));
            }
            counts[axis] = steps as usize + 3;
            corner[axis] = least[axis] - spacing;
        }
        Ok(Self { corner, spacing, counts, axes: axes.min(3) })
    }

    /// Nodes along x, y and z, the outermost layer included.
    pub fn counts(&self) -> [usize; 3] {
        self.counts
    }

    /// Metres between neighbouring nodes.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Where fractional lattice coordinates are, metres.
    pub fn position(&self, coordinates: [f64; 3]) -> Point {
        self.corner + Point::from(coordinates) * self.spacing
    }

    /// Where a node is, metres.
    pub fn node(&self, [i, j, k]: [usize; 3]) -> Point {
        self.position([i as f64, j as f64, k as f64])
    }

    /// A node's place in [`Samples::values`].
    pub fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.counts[1] + j) * self.counts[0] + i
    }

    /// Whether a node lies within `layers` of the edge; 1 is the outermost layer.
    pub fn is_within(&self, layers: usize, node: [usize; 3]) -> bool {
        (0..self.axes).any(|a| node[a] < layers || node[a] + layers >= self.counts[a])
    }

    /// The field's sign at every node, and its value around the zero set: see `near`
    /// for where the field is asked.
    pub fn sample(&self, field: &dyn Field) -> Samples {
        near::sample(self, field)
    }

    /// The field at every node.
    #[cfg(test)]
    pub(super) fn sample_everywhere(&self, field: &dyn Field) -> Samples {
        let [nx, ny, nz] = self.counts;
        let nodes = || {
            (0..nz).flat_map(move |k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])))
        };
        let asked: Vec<[usize; 3]> = nodes().filter(|n| !self.is_within(1, *n)).collect();
        let points: Vec<Point> = asked.iter().map(|n| self.node(*n)).collect();
        let mut values = vec![self.spacing; nx * ny * nz];
        let mut clipped = false;
        for (node, value) in asked.into_iter().zip(values_at(field, &points)) {
            if value.is_finite() {
                values[self.index(node)] = value;
                clipped |= value < 0.0 && self.is_within(2, node);
            }
        }
        Samples { values, clipped }
    }
}

/// The field's values at any number of points, in batches spread over the cores.
pub fn values_at(field: &dyn Field, points: &[Point]) -> Vec<f64> {
    in_batches(points, f64::NAN, |batch| field.values(batch))
}

/// The field's deviations at any number of points, in batches spread over the cores.
pub fn deviations_at(field: &dyn Field, points: &[Point]) -> Vec<f64> {
    in_batches(points, f64::NAN, |batch| field.deviations(batch))
}

/// The field to first order at any number of points, in batches spread over the cores; see
/// [`Field::first_order`].
pub fn first_order_at(field: &dyn Field, points: &[Point], step: f64) -> Vec<(f64, Point)> {
    let nothing = (f64::NAN, Point::zeros());
    in_batches(points, nothing, |batch| field.first_order(batch, step))
}

/// A field that gives too few answers gives `nothing` for the rest.
fn in_batches<T: Copy + Send + Sync>(
    points: &[Point],
    nothing: T,
    of: impl Fn(&[Point]) -> Vec<T> + Sync,
) -> Vec<T> {
    let batches: Vec<Vec<T>> = points
        .par_chunks(BATCH)
        .map(|batch| {
            let mut found = of(batch);
            found.resize(batch.len(), nothing);
            found
        })
        .collect();
    batches.concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Slope;

    impl Field for Slope {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| p.x).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| p.y).collect()
        }
    }

    #[test]
    fn an_impossible_lattice_is_refused_by_name() {
        let (a, b) = (Point::zeros(), Point::new(0.1, 0.1, 0.1));
        assert_eq!(Lattice::new((a, b), 0.0, 2), Err(LatticeError::Spacing(0.0)));
        assert!(matches!(Lattice::new((a, b), f64::NAN, 2), Err(LatticeError::Spacing(_))));
        assert!(matches!(Lattice::new((b, a), 0.01, 3), Err(LatticeError::Bounds { .. })));
        assert!(matches!(Lattice::new((a, b), 1e-6, 3), Err(LatticeError::Nodes(_))));
        assert!(matches!(
            Lattice::new((a, b * f64::NAN), 1e-2, 2),
            Err(LatticeError::Bounds { .. })
        ));
    }

    #[test]
    fn the_box_is_covered_and_its_edge_is_outside() {
        let bounds = (Point::new(-0.1, -0.05, 0.0), Point::new(0.1, 0.05, 0.0));
        let lattice = Lattice::new(bounds, 0.03, 2).unwrap();
        let [nx, ny, nz] = lattice.counts();
        assert_eq!((nx, ny, nz), (10, 7, 1));
        assert!((lattice.node([1, 1, 0]) - bounds.0).norm() < 1e-15);
        assert!(lattice.node([nx - 2, ny - 2, 0]).x >= 0.1);
        let samples = lattice.sample(&Slope);
        assert!(samples.clipped);
        assert_eq!(samples.values[lattice.index([0, 3, 0])], 0.03);
        // Beside the zero set the value is the field's, elsewhere the sign.
        let inner = lattice.node([4, 3, 0]).x;
        assert!(inner < 0.0 && lattice.node([5, 3, 0]).x > 0.0);
        assert_eq!(samples.values[lattice.index([4, 3, 0])], inner);
        assert!(samples.values[lattice.index([2, 3, 0])] < 0.0);
    }

    #[test]
    fn batches_keep_their_order() {
        let points: Vec<Point> =
            (0..1000).map(|i| Point::new(i as f64, -(i as f64), 0.0)).collect();
        assert!(values_at(&Slope, &points).iter().enumerate().all(|(i, v)| *v == i as f64));
        assert!(deviations_at(&Slope, &points).iter().enumerate().all(|(i, v)| *v == -(i as f64)));
    }
}
