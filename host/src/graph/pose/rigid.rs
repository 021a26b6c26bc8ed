//! Rigid motions as a rotation matrix beside a translation: the coordinates in which relaxations of
//! pose graphs are linear or quadratic.

use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::certificate::{Certificate, in_blocks};
use super::normal::Layout;
use super::{Error, Group, PoseGraph, Se2, Se3};

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

    /// A lower bound of eᵣᵀ Ω eᵣ + 2 γᵀ eᵣ, the cost of a rotation error, that is linear in the
    /// relative rotation matrix M = Rzᵀ Rᵢᵀ Rⱼ: c − tr(Kᵀ M), with Ω of `information`'s rotation part
    /// and γ of `linear`'s. It holds for every rotation. At the error `at` it is equal, with equal slope;
    /// in space only where γ is zero, else it is lower by 4‖γ‖ at most. `None` where there is no
    /// such bound.
    fn linear_rotation_cost(
        information: &SMatrix<f64, D, D>,
        linear: &SVector<f64, D>,
        at: &SVector<f64, D>,
    ) -> Option<Affine<N>>;

    /// [`certify`](super::certificate::certify) with blocks of N + 1 numbers, which only a type that
    /// knows N can say.
    #[doc(hidden)]
    fn certify(graph: &PoseGraph<Self, D>, layout: &Layout) -> Result<Certificate, Error>;
}

/// c − tr(Kᵀ M) of a rotation matrix M.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine<const N: usize> {
    /// c.
    pub constant: f64,
    /// K.
    pub slope: SMatrix<f64, N, N>,
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
        linear: &SVector<f64, 3>,
        at: &SVector<f64, 3>,
    ) -> Option<Affine<2>> {
        let weight = information[(2, 2)];
        if weight == 0.0 {
            let nothing = Affine { constant: 0.0, slope: Matrix2::zeros() };
            return (linear[2] == 0.0).then_some(nothing);
        }
        // ω θ² + 2 γ θ = ω (θ + γ/ω)² − γ²/ω, and the square of an angle φ, convex in cos φ, is above its
        // tangent φ₀² + b (cos φ₀ − cos φ) with b = 2 φ₀ / sin φ₀: beyond half a turn too, where the
        // tangent falls again.
        let shift = linear[2] / weight;
        let angle = at[2] + shift;
        let slope = match angle.abs() {
            small if small < 1e-4 => 2.0 + angle * angle / 3.0,
            large if large > std::f64::consts::PI - 1e-6 => return None,
            _ => 2.0 * angle / angle.sin(),
        };
        // cos(θ + δ) = ½ tr(R(−δ)ᵀ M).
        let (sin, cos) = shift.sin_cos();
        Some(Affine {
            constant: weight * (angle * angle + slope * angle.cos() - shift * shift),
            slope: Matrix2::new(cos, sin, -sin, cos) * (weight * slope / 2.0),
        })
    }

    fn certify(graph: &PoseGraph<Self, 3>, layout: &Layout) -> Result<Certificate, Error> {
        in_blocks::<Self, 3, 2, 3>(graph, layout)
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
        linear: &SVector<f64, 6>,
        at: &SVector<f64, 6>,
    ) -> Option<Affine<3>> {
        // 4 v vᵀ = M + Mᵀ + (1 − tr M) I of the vector part v of M's unit quaternion (w, v).
        let omega = information.fixed_view::<3, 3>(3, 3).into_owned();
        let trace = omega.trace();
        let mut affine = Affine {
            constant: trace / 4.0,
            slope: (Matrix3::identity() * trace - omega * 2.0) / 4.0,
        };
        let gamma = linear.fixed_rows::<3>(3).into_owned();
        let size = gamma.norm();
        if size > 0.0 {
            // γᵀv = γᵀ(w v)/w₀ + γᵀv (w₀ − w)/w₀: linear in M − Mᵀ, and small near w₀.
            let w = (1.0 - at.fixed_rows::<3>(3).norm_squared()).max(0.0).sqrt();
            if w < 0.5 {
                return None;
            }
            affine.slope -= gamma.cross_matrix() / (2.0 * w);
            affine.constant -= 2.0 * size * w.max(1.0 - w) / w;
        }
        Some(affine)
    }

    fn certify(graph: &PoseGraph<Self, 6>, layout: &Layout) -> Result<Certificate, Error> {
        in_blocks::<Self, 6, 3, 4>(graph, layout)
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
