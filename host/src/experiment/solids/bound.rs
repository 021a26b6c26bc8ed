//! How well the pose of an object that slips can be known at all: by one grasp of a shape that is known
//! exactly, at a pose that was known exactly before the slip. No tracker and no map can do better on
//! average, since whatever was felt before the slip says no more about it.
//!
//! To first order: distances along the normals, and the normals' two tilts, as if the surface were flat
//! about each contact. Where it is curved this is no bound but a guess: a ball's normals say nothing of how
//! it is turned, a sharp edge's also say where it is.

use nalgebra::{Matrix6, Point3, Vector6};
use rayon::prelude::*;
use serde::Serialize;

use crate::explore::placement::drawn;
use crate::quantity::Deviation;
use crate::shape::Geometry;
use crate::sim::random::Random;
use crate::space::Point;

/// Draws of a pose.
const DRAWS: usize = 512;

/// Grasps among which the best is looked for.
const GRASPS: usize = 1000;

/// What decides how well a pose is known after a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    /// Of the contacts.
    pub contact: Deviation,
    /// Of the slip before the grasp, per axis, about `centre`.
    pub slip: Deviation,
    /// The object's centroid, object frame.
    pub centre: Point,
    /// How near the pose must be: metres at the centroid and radians.
    pub tolerance: Deviation,
}

/// How probable it is, after grasps as exploration draws them, that the pose is known within the
/// tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outlook {
    /// Of a usual grasp: the median.
    pub usual: f64,
    /// Of the best of a thousand.
    pub best: f64,
}

impl Bound {
    /// Probability that the pose is within the tolerance after a grasp with these contacts (points and
    /// outward normals, object frame).
    pub fn chance(&self, contacts: &[(Point, Point)]) -> f64 {
        let Some(root) = self.information(contacts).cholesky().map(|c| c.l().transpose()) else {
            return 0.0;
        };
        let [mut random] = Random::streams(1);
        let near = (0..DRAWS).filter(|_| {
            let (a, b) = (random.normal3(), random.normal3());
            let z = Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z);
            // Of the covariance (Lᵀ)⁻¹ L⁻¹.
            let Some(off) = root.solve_upper_triangular(&z) else { return false };
            let (shift, turn) = (off.fixed_rows::<3>(0), off.fixed_rows::<3>(3));
            shift.norm() < self.tolerance.length && turn.norm() < self.tolerance.angle
        });
        near.count() as f64 / DRAWS as f64
    }

    /// Of the pose about the centroid, translation then rotation: the slip's and the contacts'.
    fn information(&self, contacts: &[(Point, Point)]) -> Matrix6<f64> {
        let Bound { contact, slip, .. } = self;
        let weights = [slip.length, slip.angle].map(|s| 1.0 / (s * s).max(1e-18));
        let mut information = Matrix6::from_diagonal(&Vector6::from_fn(|i, _| weights[i / 3]));
        for (point, normal) in contacts {
            let lever = (point - self.centre).cross(normal);
            let row = Vector6::new(normal.x, normal.y, normal.z, lever.x, lever.y, lever.z);
            information += row * row.transpose() / contact.length.powi(2);
            let across = nalgebra::Matrix3::identity() - normal * normal.transpose();
            let mut turns = information.fixed_view_mut::<3, 3>(3, 3);
            turns += across / contact.angle.powi(2);
        }
        information
    }

    /// Over grasps as exploration draws them; zeros where none meets the object.
    pub fn outlook(&self, geometry: &Geometry) -> Outlook {
        let (low, high) = geometry.bounds();
        let radius = ((high - low) / 2.0).norm();
        let [mut random] = Random::streams(0);
        let placements: Vec<_> =
            (0..GRASPS).map(|_| drawn(3, &self.centre, radius, &mut random)).collect();
        // The tree that rays are cast into, before the threads ask for it.
        geometry.distance(&self.centre);
        let felt = placements.par_iter().map(|placement| {
            let met = placement.strokes(3, 2.0 * radius).into_iter().filter_map(|stroke| {
                let start = (placement.hand * Point3::from(stroke.start)).coords;
                let direction = placement.hand.rotation * stroke.direction;
                let (along, normal) = geometry.cast(&start, &direction, stroke.travel)?;
                Some((start + along * direction, normal))
            });
            met.collect::<Vec<_>>()
        });
        let mut chances: Vec<f64> =
            felt.filter(|f| !f.is_empty()).map(|contacts| self.chance(&contacts)).collect();
        chances.sort_by(f64::total_cmp);
        let at = |i: usize| chances.get(i).copied().unwrap_or(0.0);
        Outlook { usual: at(chances.len() / 2), best: at(chances.len().saturating_sub(1)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    const DEGREE: f64 = std::f64::consts::PI / 180.0;

    fn bound() -> Bound {
        Bound {
            contact: Deviation { length: 1e-3, angle: 5.0 * DEGREE },
            slip: Deviation { length: 5e-3, angle: 10.0 * DEGREE },
            centre: Point::zeros(),
            tolerance: Deviation { length: 3e-3, angle: 3.0 * DEGREE },
        }
    }

    #[test]
    fn what_is_felt_on_two_opposite_faces_says_nothing_of_the_other_axes() {
        let face = |y: f64| {
            [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]
                .map(|[x, z]| (Point::new(0.03 * x, y, 0.03 * z), Point::new(0.0, y.signum(), 0.0)))
        };
        let opposite = [face(0.03), face(-0.03)].concat();
        // About y it stays at the slip's 10°, along x and z at its 5 mm.
        assert!(bound().chance(&opposite) < 0.06, "{}", bound().chance(&opposite));
        let turned = |axis: Point| {
            let turn = nalgebra::UnitQuaternion::from_scaled_axis(axis * (90.0 * DEGREE));
            opposite.iter().map(move |(p, n)| (turn * p, turn * n))
        };
        let all: Vec<_> =
            opposite.iter().copied().chain(turned(Point::x())).chain(turned(Point::z())).collect();
        assert!(bound().chance(&all) > 0.95, "{}", bound().chance(&all));
        let fine = Bound { slip: Deviation { length: 1e-4, angle: 1e-3 }, ..bound() };
        assert_eq!((bound().chance(&[]) < 0.02, fine.chance(&[])), (true, 1.0));
    }

    #[test]
    fn the_best_grasp_is_better_than_a_usual_one_and_fine_fingers_are_better_still() {
        let cube = "box:0.07x0.07x0.07".parse::<ObjectSpec>().unwrap().geometry().unwrap();
        let seen = bound().outlook(&cube);
        assert!(seen.usual < seen.best && seen.best < 1.0, "{seen:?}");
        let contact = Deviation { length: 1e-4, angle: 0.5 * DEGREE };
        let fine = Bound { contact, ..bound() }.outlook(&cube);
        assert!(fine.usual > seen.usual && fine.best > 0.99, "{fine:?}");
    }
}
