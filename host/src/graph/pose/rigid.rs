//! Rigid motions as a rotation matrix beside a translation: the coordinates in which relaxations of
//! pose graphs are linear or quadratic.

use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::{Group, Se2, Se3};

/// A motion with `D` degrees of freedom of a space with `N` dimensions.
///
/// Sums of squares of a group's error can be written with rotation matrices: that is what
/// [`chordal`](super::chordal::chordal) relaxes and [`certify`](super::certificate::certify) bounds.
pub trait Rigid<const D: usize, const N: usize>: Group<D> {
    /// Body to world.
    fn rotation_matrix(&self) -> SMatrix<f64, N, N>;

    /// Metres.
    fn translation_vector(&self) -> SVector<f64, N>;

    /// The motion with this translation and the rotation nearest to `matrix` in the Frobenius norm
    /// (orthogonal Procrustes problem in SO(N)); `None` where that is not unique or a number is not
    /// finite.
    fn nearest(matrix: &SMatrix<f64, N, N>, translation: SVector<f64, N>) -> Option<Self>;

    /// `self` with another translation.
    fn moved_to(&self, translation: SVector<f64, N>) -> Self;

    /// The rotation part of an error as a lower bound that is linear in the relative rotation matrix
    /// M = Rzᵀ Rᵢᵀ Rⱼ: the constant c and the matrix K with eᵣᵀ Ω eᵣ ≥ c − tr(Kᵀ M) for every rotation,
    /// with equality and equal slope at the error `at`.
    ///
    /// In space it is an equality everywhere: products of a unit quaternion's parts are linear in its
    /// matrix. In the plane ω θ² is a convex function of cos θ, which is above its tangent. `None`
    /// at half a turn, where the plane's θ² has a kink.
    fn linear_rotation_cost(
        information: &SMatrix<f64, D, D>,
        at: &SVector<f64, D>,
    ) -> Option<(f64, SMatrix<f64, N, N>)>;
}

impl Rigid<3, 2> for Se2 {
    fn rotation_matrix(&self) -> Matrix2<f64> {
        let (sin, cos) = self.angle.sin_cos();
        Matrix2::new(cos, -sin, sin, cos)
    }

    fn translation_vector(&self) -> Vector2<f64> {
        self.translation
    }

    fn nearest(matrix: &Matrix2<f64>, translation: Vector2<f64>) -> Option<Self> {
        let (sin, cos) = (matrix[(1, 0)] - matrix[(0, 1)], matrix[(0, 0)] + matrix[(1, 1)]);
        let unique = sin.hypot(cos) > UNIQUE * matrix.norm();
        let pose = Se2 { translation, angle: sin.atan2(cos) };
        (unique && pose.is_finite()).then_some(pose)
    }

    fn moved_to(&self, translation: Vector2<f64>) -> Self {
        Se2 { translation, ..*self }
    }

    fn linear_rotation_cost(
        information: &SMatrix<f64, 3, 3>,
        at: &SVector<f64, 3>,
    ) -> Option<(f64, Matrix2<f64>)> {
        let (weight, angle) = (information[(2, 2)], at[2]);
        // θ² = a − b cos θ up to second order about `angle`: slopes 2θ = b sin θ.
        let slope = match angle.abs() {
            small if small < 1e-4 => 2.0 + angle * angle / 3.0,
            large if large > std::f64::consts::PI - 1e-6 => return None,
            _ => 2.0 * angle / angle.sin(),
        };
        let constant = angle * angle + slope * angle.cos();
        Some((weight * constant, Matrix2::identity() * (weight * slope / 2.0)))
    }
}

impl Rigid<6, 3> for Se3 {
    fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    fn translation_vector(&self) -> Vector3<f64> {
        self.translation
    }

    fn nearest(matrix: &Matrix3<f64>, translation: Vector3<f64>) -> Option<Self> {
        let rotation = nearest_rotation(matrix)?;
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let pose = Se3 { translation, rotation };
        pose.is_finite().then_some(pose)
    }

    fn moved_to(&self, translation: Vector3<f64>) -> Self {
        Se3 { translation, ..*self }
    }

    fn linear_rotation_cost(
        information: &SMatrix<f64, 6, 6>,
        _at: &SVector<f64, 6>,
    ) -> Option<(f64, Matrix3<f64>)> {
        // 4 v vᵀ = M + Mᵀ + (1 − tr M) I of the vector part v of M's unit quaternion.
        let omega = information.fixed_view::<3, 3>(3, 3).into_owned();
        let trace = omega.trace();
        Some((trace / 4.0, (Matrix3::identity() * trace - omega * 2.0) / 4.0))
    }
}

/// Below this part of a matrix' norm, what decides about its nearest rotation is rounding.
const UNIQUE: f64 = 1e-12;

/// argmin ‖R − A‖ over rotations of space; `None` where it is not unique.
///
/// Matrices near a rotation, the usual ones, take Higham's scaled Newton iteration for the polar factor;
/// the others the singular value decomposition.
fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = matrix.norm();
    if !(scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let matrix = matrix / scale;
    if matrix.determinant() > 1e-3 {
        let mut polar = matrix;
        for _ in 0..12 {
            let inverse = polar.try_inverse()?.transpose();
            let stretch = (inverse.norm() / polar.norm()).sqrt();
            let next = (polar * stretch + inverse / stretch) * 0.5;
            let moved = (next - polar).norm();
            polar = next;
            if moved < 1e-9 {
                // Convergence is quadratic: the step left is below rounding.
                return Some(polar);
            }
        }
    }
    let svd = matrix.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let sign = (u * v).determinant().signum();
    let values = svd.singular_values;
    let mut ascending: Vec<usize> = vec![0, 1, 2];
    ascending.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let (least, middle) = (ascending[0], ascending[1]);
    if values[middle] + sign * values[least] < UNIQUE {
        return None;
    }
    let mut flip = Vector3::repeat(1.0);
    flip[least] = sign;
    Some(u * Matrix3::from_diagonal(&flip) * v)
}
