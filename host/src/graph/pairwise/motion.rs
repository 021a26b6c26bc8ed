//! Poses of the tactile side as elements of the pose graph's groups, and covariances with them.

use nalgebra::{Matrix6, SMatrix, UnitQuaternion, Vector3};

use crate::graph::joint::tangent::axes;
use crate::graph::pose::{Group, Se2, Se3};
use crate::space::{Pose, angle, planar};

/// A group that host poses can be turned into and back.
pub trait Motion<const D: usize>: Group<D> {
    /// From a host pose; what the space does not have is dropped.
    fn of(pose: &Pose) -> Self;

    /// To a host pose.
    fn pose(&self) -> Pose;

    /// By how much the group's [error](Group::error) moves with the rotation in radians.
    const TURN: f64;

    /// Inverse of a covariance in tangent coordinates (metres and radians, the pose's own axes) as the
    /// information of the group's error; `None` where it is not positive definite.
    fn information(covariance: &Matrix6<f64>) -> Option<SMatrix<f64, D, D>> {
        let axes = axes::<D>();
        let own = SMatrix::<f64, D, D>::from_fn(|i, j| covariance[(axes[i], axes[j])]);
        let inverse = own.cholesky()?.inverse();
        let unit = |i: usize| if i < Self::DIMENSION { 1.0 } else { 1.0 / Self::TURN };
        let scaled = SMatrix::<f64, D, D>::from_fn(|i, j| inverse[(i, j)] * unit(i) * unit(j));
        scaled.iter().all(|v| v.is_finite()).then_some(scaled)
    }
}

impl Motion<3> for Se2 {
    const TURN: f64 = 1.0;

    fn of(pose: &Pose) -> Self {
        Se2::new(pose.translation.x, pose.translation.y, angle(pose))
    }

    fn pose(&self) -> Pose {
        planar(self.translation.x, self.translation.y, self.angle)
    }
}

impl Motion<6> for Se3 {
    // The vector of a unit quaternion is half the angle.
    const TURN: f64 = 0.5;

    fn of(pose: &Pose) -> Self {
        let q = pose.rotation.quaternion();
        let t = pose.translation.vector;
        Se3::new([t.x, t.y, t.z], [q.i, q.j, q.k, q.w])
    }

    fn pose(&self) -> Pose {
        Pose::from_parts(
            self.translation.into(),
            UnitQuaternion::new_normalize(self.rotation.into_inner()),
        )
    }
}

/// What a small motion `tangent` of a frame is in the axes of another frame that `pose` takes to it:
/// p · Exp(δ) = Exp(Ad_p δ) · p.
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix();
    let r = rotation.matrix();
    let shift: Vector3<f64> = pose.translation.vector;
    let mut ad = Matrix6::zeros();
    ad.fixed_view_mut::<3, 3>(0, 0).copy_from(r);
    ad.fixed_view_mut::<3, 3>(3, 3).copy_from(r);
    ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&(shift.cross_matrix() * r));
    ad
}

/// A covariance seen from other axes.
pub fn carried(covariance: &Matrix6<f64>, ad: &Matrix6<f64>) -> Matrix6<f64> {
    ad * covariance * ad.transpose()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::graph::joint::tangent::{Tangent, local, retract};

    proptest! {
        #[test]
        fn small_motions_are_carried(
            pose in proptest::array::uniform6(-0.9f64..0.9), by in proptest::array::uniform6(-1e-5f64..1e-5),
        ) {
            let pose = retract(&Pose::identity(), &Tangent::from(pose));
            let by = Tangent::from(by);
            let moved = retract(&pose, &by) * pose.inverse();
            let seen = local(&Pose::identity(), &moved);
            prop_assert!((seen - adjoint(&pose) * by).norm() < 1e-9);
        }

        #[test]
        fn information_is_of_the_groups_own_error(by in proptest::array::uniform6(-1e-4f64..1e-4)) {
            let root = Matrix6::from_fn(|i, j| if i == j { 1e-3 * (1 + i) as f64 } else { 1e-4 });
            let covariance = root * root.transpose();
            let by = Tangent::from(by);
            let pose = retract(&Pose::identity(), &Tangent::new(0.1, 0.2, -0.1, 0.3, -0.2, 0.5));
            let error = Se3::error(
                &Se3::identity(), &Se3::of(&retract(&pose, &by)), &Se3::of(&pose),
            );
            let expected = by.dot(&(covariance.try_inverse().unwrap() * by));
            let found = error.dot(&(Se3::information(&covariance).unwrap() * error));
            prop_assert!((found - expected).abs() < 1e-3 * expected + 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn poses_come_back() {
        let flat = planar(0.1, -0.2, 2.0);
        assert!(local(&Se2::of(&flat).pose(), &flat).norm() < 1e-12);
        let turn = retract(&Pose::identity(), &Tangent::new(0.1, 0.2, 0.3, 1.0, -0.5, 0.2));
        assert!(local(&Se3::of(&turn).pose(), &turn).norm() < 1e-12);
        assert!(Se2::information(&Matrix6::zeros()).is_none());
    }
}
