//! The best rigid alignment of an estimated shape to the true one.

use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector6};
use rayon::prelude::*;

use super::{Geometry, metrics};
use crate::space::{Point, Pose, centroid};

/// Levenberg–Marquardt iterations from each start.
const ITERATIONS: usize = 25;

/// A step that moves no point farther than this ends the search, metres.
const SETTLED: f64 = 1e-8;

/// Points drawn from each surface while aligning: planar, spatial.
const SAMPLES: [usize; 2] = [250, 500];

/// Turns tried in the plane, radians either way.
const PLANAR_TURNS: [f64; 2] = [0.1, 0.3];

/// Turns tried about each axis in space, radians either way.
const SPATIAL_TURN: f64 = 0.15;

/// The rigid motion (estimate's frame to truth's) that takes `estimate` closest to `truth`.
///
/// From the identity, from coinciding centroids and from small turns about the centroid, the mean
/// squared distance between the surfaces, both ways, is minimised by Levenberg–Marquardt; from the
/// best of these once more with outlying distances weighed down. Of all results **and the
/// identity** the one with the least Hausdorff distance is returned, so the alignment never makes
/// that worse. Turns stay local: the alignment takes out what an estimator cannot know, it does not
/// search for another match of a symmetric shape. Deterministic; the identity if the shapes cannot
/// be compared (see [`metrics::compare`]).
pub fn align(estimate: &Geometry, truth: &Geometry) -> Pose {
    let Some(mut least) = metrics::compare(estimate, truth).map(|d| d.hausdorff) else {
        return Pose::identity();
    };
    let problem = Problem::new(estimate, truth);
    let mut found: Vec<Pose> =
        problem.starts().into_iter().map(|start| problem.minimise(start, None)).collect();
    // The few points used so far decide which results are worth the full comparison.
    found.sort_by(|a, b| problem.greatest_distance(a).total_cmp(&problem.greatest_distance(b)));
    let mut best = Pose::identity();
    let robust = found.first().map(|pose| {
        let scale = 1.5 * problem.median_distance(pose);
        problem.minimise(*pose, Some(scale))
    });
    for pose in found.into_iter().take(3).chain(robust) {
        if let Some(hausdorff) = metrics::nearer_than(least, estimate, &pose, truth) {
            least = hausdorff;
            best = pose;
        }
    }
    best
}

struct Problem<'a> {
    estimate: &'a Geometry,
    truth: &'a Geometry,
    /// Points and outward normals of each surface in its own frame.
    from_estimate: Vec<(Point, Point)>,
    from_truth: Vec<(Point, Point)>,
    /// Centroids of the two surfaces.
    centres: (Point, Point),
}

/// A distance between the surfaces and how it changes with the pose.
struct Residual {
    distance: f64,
    /// The point of the pair that moves with the pose, truth's frame.
    moving: Point,
    /// Unit direction in which moving it lengthens the distance.
    away: Point,
}

impl<'a> Problem<'a> {
    fn new(estimate: &'a Geometry, truth: &'a Geometry) -> Self {
        let centroid = |samples: &[(Point, Point)]| centroid(samples.iter().map(|s| s.0));
        let count = SAMPLES[usize::from(truth.dimension() == 3)];
        let from_estimate = estimate.samples(count);
        let from_truth = truth.samples(count);
        let centres = (centroid(&from_estimate), centroid(&from_truth));
        Self { estimate, truth, from_estimate, from_truth, centres }
    }

    fn is_planar(&self) -> bool {
        self.truth.dimension() == 2
    }

    fn starts(&self) -> Vec<Pose> {
        let (from, to) = self.centres;
        let mut starts = vec![Pose::identity(), Translation3::from(to - from).into()];
        let mut turn = |scaled_axis: Point| {
            starts.push(
                Translation3::from(to)
                    * UnitQuaternion::from_scaled_axis(scaled_axis)
                    * Translation3::from(-from),
            );
        };
        if self.is_planar() {
            for angle in PLANAR_TURNS {
                turn(Point::z() * angle);
                turn(Point::z() * -angle);
            }
        } else {
            for axis in [Point::x(), Point::y(), Point::z()] {
                turn(axis * SPATIAL_TURN);
                turn(axis * -SPATIAL_TURN);
            }
        }
        starts
    }

    fn residuals(&self, pose: &Pose) -> Vec<Residual> {
        let back = pose.inverse();
        let there = self.from_estimate.par_iter().map(|(p, normal)| {
            let moving = (pose * Point3::from(*p)).coords;
            let gap = moving - self.truth.closest(&moving);
            let distance = gap.norm();
            // On the surface the distance grows along the normal.
            let away = if distance > 1e-9 { gap / distance } else { pose * normal };
            Residual { distance, moving, away }
        });
        let from = self.from_truth.par_iter().map(|(p, normal)| {
            let seen = (back * Point3::from(*p)).coords;
            let moving = (pose * Point3::from(self.estimate.closest(&seen))).coords;
            let gap = moving - p;
            let distance = gap.norm();
            let away = if distance > 1e-9 { gap / distance } else { *normal };
            Residual { distance, moving, away }
        });
        there.chain(from).collect()
    }

    /// Mean (robust, if `scale` is given) squared distance.
    fn cost(residuals: &[Residual], scale: Option<f64>) -> f64 {
        let terms = residuals.iter().map(|r| {
            let square = r.distance * r.distance;
            scale.map_or(square, |s| s * s * (square / (s * s)).ln_1p())
        });
        terms.sum::<f64>() / residuals.len().max(1) as f64
    }

    fn median_distance(&self, pose: &Pose) -> f64 {
        let mut distances: Vec<f64> =
            self.residuals(pose).into_iter().map(|r| r.distance).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().unwrap_or(0.0).max(1e-6)
    }

    fn greatest_distance(&self, pose: &Pose) -> f64 {
        self.residuals(pose).iter().map(|r| r.distance).fold(0.0, f64::max)
    }

    /// Levenberg–Marquardt over turns about the truth's centroid and shifts.
    fn minimise(&self, start: Pose, scale: Option<f64>) -> Pose {
        let centre = self.centres.1;
        // Turns are counted in metres at the rim, so that one damping fits turns and shifts.
        let rim = self.from_truth.iter().map(|(p, _)| (p - centre).norm()).fold(1e-6, f64::max);
        let mut pose = start;
        let mut residuals = self.residuals(&pose);
        let mut cost = Self::cost(&residuals, scale);
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            let mut normal = Matrix6::<f64>::zeros();
            let mut right = Vector6::<f64>::zeros();
            for r in &residuals {
                let weight = scale.map_or(1.0, |s| 1.0 / (1.0 + (r.distance / s).powi(2)));
                let turn = (r.moving - centre).cross(&r.away) / rim;
                let mut row = Vector6::new(r.away.x, r.away.y, r.away.z, turn.x, turn.y, turn.z);
                if self.is_planar() {
                    (row[2], row[3], row[4]) = (0.0, 0.0, 0.0);
                }
                normal.ger(weight, &row, &row, 1.0);
                right.axpy(-weight * r.distance, &row, 1.0);
            }
            let mean = normal.trace() / 6.0;
            let damped = normal + Matrix6::identity() * (damping * mean.max(1e-12));
            let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else { break };
            let turn = Point::new(step[3], step[4], step[5]) / rim;
            let motion: Pose = Translation3::from(centre + step.fixed_rows::<3>(0))
                * UnitQuaternion::from_scaled_axis(turn)
                * Translation3::from(-centre);
            let tried: Isometry3<f64> = motion * pose;
            let tried_residuals = self.residuals(&tried);
            let tried_cost = Self::cost(&tried_residuals, scale);
            if tried_cost < cost {
                let settled = cost - tried_cost < 1e-5 * cost || step.norm() < SETTLED;
                (pose, residuals, cost) = (tried, tried_residuals, tried_cost);
                damping = (damping * 0.2).max(1e-9);
                if settled {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::Outline;
    use crate::shape::mesh::tests::cuboid;
    use crate::space::planar;

    fn rectangle(a: f64, b: f64) -> Geometry {
        let vertices = vec![[-a, -b], [a, -b], [a, b], [-a, b]];
        Geometry::Outline(Outline { loops: vec![vertices] })
    }

    fn assert_close(found: &Pose, expected: &Pose) {
        let error = found.inverse() * expected;
        assert!(error.translation.vector.norm() < 5e-5, "{error}");
        assert!(error.rotation.angle() < 1e-3, "{error}");
    }

    #[test]
    fn a_displaced_outline_is_put_back() {
        let truth = rectangle(0.06, 0.03);
        for (x, y, turn) in [(0.004, -0.003, 0.1), (-0.012, 0.008, -0.25), (0.0, 0.0, 0.02)] {
            let displaced = planar(x, y, turn);
            let found = align(&truth.transformed(&displaced), &truth);
            assert_close(&found, &displaced.inverse());
            assert_eq!(found.translation.z, 0.0);
        }
    }

    #[test]
    fn a_displaced_mesh_is_put_back() {
        let truth = Geometry::Mesh(cuboid([0.06, 0.04, 0.03]));
        let displaced = Pose::new(Point::new(0.006, -0.004, 0.005), Point::new(0.1, -0.05, 0.12));
        assert_close(&align(&truth.transformed(&displaced), &truth), &displaced.inverse());
    }

    #[test]
    fn the_hausdorff_distance_never_grows() {
        let truth = rectangle(0.06, 0.03);
        // A bulge on one side, a corner cut off: least squares alone would trade the greatest
        // distance for the mean.
        let shapes: [&[[f64; 2]]; 3] = [
            &[[-0.06, -0.03], [0.06, -0.03], [0.06, 0.01], [0.04, 0.03], [-0.06, 0.03]],
            &[[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [0.0, 0.045], [-0.06, 0.03]],
            &[[0.0, -0.03], [0.06, 0.0], [0.0, 0.03]],
        ];
        for vertices in shapes {
            let estimate = Geometry::Outline(Outline { loops: vec![vertices.to_vec()] });
            let before = metrics::compare(&estimate, &truth).unwrap().hausdorff;
            let pose = align(&estimate, &truth);
            let after = metrics::compare_at(&estimate, &pose, &truth).unwrap().hausdorff;
            assert!(after <= before, "{after} > {before}");
        }
    }

    #[test]
    fn a_quarter_turn_of_a_symmetric_shape_is_not_undone_for_free() {
        // Nearly square: the better match a quarter turn away is out of reach.
        let truth = rectangle(0.032, 0.03);
        let pose = align(&truth.transformed(&planar(0.0, 0.0, 1.45)), &truth);
        assert!(pose.rotation.angle() < 0.6, "{pose}");
    }

    #[test]
    fn what_cannot_be_compared_stays_where_it_is() {
        let nothing = Geometry::Outline(Outline { loops: vec![] });
        assert_eq!(align(&nothing, &rectangle(0.1, 0.1)), Pose::identity());
        assert_eq!(
            align(&Geometry::Mesh(cuboid([0.1, 0.1, 0.1])), &rectangle(0.1, 0.1)),
            Pose::identity()
        );
    }

    #[test]
    fn the_answer_is_the_same_every_time() {
        let truth = rectangle(0.06, 0.03);
        let estimate = rectangle(0.055, 0.033).transformed(&planar(0.003, 0.002, 0.1));
        assert_eq!(align(&estimate, &truth), align(&estimate, &truth));
    }
}
