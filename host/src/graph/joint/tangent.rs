//! Small motions of poses and planes, as the solver counts them.
//!
//! Poses are ℝⁿ × SO(n): a tangent is a translation and then a rotation vector, both in object axes,
//! as in the core ([`tactile_core::space::Pose::retract`]). Planar poses use three of the six numbers.

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

use crate::space::{Point, Pose, across};

/// A pose's displacement: translation (metres), then rotation (radians), object axes.
pub type Tangent = Vector6<f64>;

/// Poses of one grasp nearer than this (metres, radians) are one answer.
pub const SAME: [f64; 2] = [2e-3, 0.05];

/// Which of the six numbers of a tangent a pose of `D` degrees of freedom has.
pub fn axes<const D: usize>() -> [usize; D] {
    std::array::from_fn(|i| if D == 3 && i == 2 { 5 } else { i })
}

/// A covariance of `D` numbers among all six, zero for the others.
pub fn six_by_six<const D: usize>(block: &SMatrix<f64, D, D>) -> Matrix6<f64> {
    let mut full = Matrix6::zeros();
    for (i, row) in axes::<D>().into_iter().enumerate() {
        for (j, column) in axes::<D>().into_iter().enumerate() {
            full[(row, column)] = block[(i, j)];
        }
    }
    full
}

/// `pose` displaced by `tangent`.
pub fn retract(pose: &Pose, tangent: &Tangent) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(tangent.fixed_rows::<3>(3).into_owned());
    let mut moved = pose * Pose::from_parts(tangent.fixed_rows::<3>(0).into_owned().into(), turn);
    moved.rotation.renormalize();
    moved
}

/// The tangent that takes `pose` to `other`, its rotation at most half a turn.
pub fn local(pose: &Pose, other: &Pose) -> Tangent {
    let step = pose.inv_mul(other);
    let (t, w) = (step.translation.vector, step.rotation.scaled_axis());
    Tangent::new(t.x, t.y, t.z, w.x, w.y, w.z)
}

/// Whether two poses are less apart than `apart`: metres, radians. Never of poses that are not finite.
pub fn are_near(a: &Pose, b: &Pose, apart: [f64; 2]) -> bool {
    let off = local(a, b);
    off.fixed_rows::<3>(0).norm() < apart[0] && off.fixed_rows::<3>(3).norm() < apart[1]
}

/// Inverse of the right Jacobian of SO(3) at the rotation vector `w`: by how much the logarithm
/// changes when the rotation is turned about its own axes. Its transpose is that of the left one.
pub fn log_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let cross = w.cross_matrix();
    let angle = w.norm();
    let square = if angle < 1e-3 {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        1.0 / (angle * angle) - 1.0 / (2.0 * angle * (0.5 * angle).tan())
    };
    Matrix3::identity() + cross * 0.5 + cross * cross * square
}

/// A plane n·p = ρ in the object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Unit, out of the object.
    pub normal: Point,
    /// ρ, metres.
    pub offset: f64,
}

impl Face {
    /// n·p − ρ, metres.
    pub fn value(&self, point: &Point) -> f64 {
        self.normal.dot(point) - self.offset
    }

    /// The directions in which the normal can turn. In the plane the first alone keeps it there.
    pub fn tangents(&self, dimension: usize) -> [Point; 2] {
        across(dimension, &self.normal)
    }

    /// The face displaced: turns along the [tangents](Face::tangents) (radians), then the offset
    /// (metres).
    pub fn retract(&self, dimension: usize, change: &[f64]) -> Face {
        let tangents = self.tangents(dimension);
        let turned: Point =
            tangents.iter().zip(change).take(dimension - 1).map(|(t, c)| t * *c).sum();
        let normal = (self.normal + turned).normalize();
        Face { normal, offset: self.offset + change.get(dimension - 1).copied().unwrap_or(0.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbers() -> impl Strategy<Value = Tangent> {
        proptest::array::uniform6(-1.2f64..1.2).prop_map(Tangent::from)
    }

    proptest! {
        #[test]
        fn local_undoes_retract(a in numbers(), b in numbers()) {
            let pose = retract(&Pose::identity(), &a);
            prop_assert!((local(&pose, &retract(&pose, &b)) - b).norm() < 1e-9);
        }

        #[test]
        fn the_logarithm_changes_as_its_jacobian_says(w in proptest::array::uniform3(-1.7f64..1.7), k in 0usize..3) {
            let w = Vector3::from(w);
            let at = |h: f64| {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(k, h));
                (UnitQuaternion::from_scaled_axis(w) * turn).scaled_axis()
            };
            let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
            prop_assert!((slope - log_jacobian(&w).column(k)).norm() < 1e-6);
            let small = w * 1e-4;
            prop_assert!((log_jacobian(&small) - Matrix3::identity() - small.cross_matrix() * 0.5).norm() < 1e-7);
        }

        #[test]
        fn faces_stay_unit_and_in_the_plane(angle in -3.0f64..3.0, turn in -0.5f64..0.5) {
            let face = Face { normal: Point::new(angle.cos(), angle.sin(), 0.0), offset: 0.03 };
            let moved = face.retract(2, &[turn, 0.001]);
            prop_assert!((moved.normal.norm() - 1.0).abs() < 1e-12 && moved.normal.z == 0.0);
            prop_assert!((moved.offset - 0.031).abs() < 1e-12);
            let [t, u] = face.retract(3, &[turn, 0.2, 0.0]).tangents(3);
            prop_assert!(t.dot(&u).abs() < 1e-12);
        }
    }
}
