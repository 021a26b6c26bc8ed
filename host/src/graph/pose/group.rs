//! The groups of rigid motions: SE(2) and SE(3), their small motions and the error of a measurement.

use nalgebra::{Matrix3, Quaternion, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

/// The error of a measurement and how it changes when the two poses are displaced, each by a tangent
/// of its own: error(x ⊕ a, y ⊕ b) ≈ error + from·a + to·b.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearised<const D: usize> {
    /// [`Group::error`].
    pub error: SVector<f64, D>,
    /// Derivative by the tangent of the pose it is measured from.
    pub from: SMatrix<f64, D, D>,
    /// Derivative by the tangent of the pose that is measured.
    pub to: SMatrix<f64, D, D>,
}

/// A rigid motion with `D` degrees of freedom.
///
/// Tangents are a translation (metres) and then a rotation (radians), both in the pose's own axes:
/// x ⊕ δ = (t + R δ_t, R Exp(δ_r)).
pub trait Group<const D: usize>:
    Copy + std::fmt::Debug + PartialEq + Send + Sync + 'static
{
    /// Dimension of the space: 2 or 3.
    const DIMENSION: usize;

    /// The motion with what derivatives need of it computed once.
    type Frame: Copy + std::fmt::Debug + Send + Sync;

    /// This motion's frame.
    fn frame(&self) -> Self::Frame;

    /// The motion that moves nothing.
    fn identity() -> Self;

    /// `self` after `other`: self · other.
    fn compose(&self, other: &Self) -> Self;

    /// The motion that undoes this one.
    fn inverse(&self) -> Self;

    /// self⁻¹ · other: `other` in the axes of `self`.
    fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }

    /// `self` displaced by `tangent`.
    fn retract(&self, tangent: &SVector<f64, D>) -> Self;

    /// The tangent δ with `self` ⊕ δ = `other`; rotations by up to half a turn.
    fn local(&self, other: &Self) -> SVector<f64, D>;

    /// How [`local`](Group::local) changes with the tangent of `other`, where it is `tangent`.
    fn local_derivative(tangent: &SVector<f64, D>) -> SMatrix<f64, D, D>;

    /// How far `poses` x and y contradict the measurement z ≈ x⁻¹ y, as g2o counts it, so that costs
    /// of the same file agree: the translation and rotation of z⁻¹ x⁻¹ y. In the plane the rotation is an
    /// angle in (−π, π]; in space it is the vector part of the unit quaternion with w ≥ 0, which is half
    /// the rotation vector for small ones.
    fn error(from: &Self, to: &Self, measured: &Self) -> SVector<f64, D>;

    /// [`error`](Group::error) with its derivatives.
    fn linearise(from: &Self, to: &Self, measured: &Self) -> Linearised<D> {
        Self::linearise_frames(&from.frame(), &to.frame(), &measured.frame())
    }

    /// [`linearise`](Group::linearise) between frames, where many edges meet in a pose.
    fn linearise_frames(
        from: &Self::Frame,
        to: &Self::Frame,
        measured: &Self::Frame,
    ) -> Linearised<D>;

    /// Whether every number is finite.
    fn is_finite(&self) -> bool;
}

/// A motion of the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Se2 {
    /// Metres.
    pub translation: Vector2<f64>,
    /// Radians, in (−π, π].
    pub angle: f64,
}

/// A motion of space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Se3 {
    /// Metres.
    pub translation: Vector3<f64>,
    /// Unit quaternion.
    pub rotation: UnitQuaternion<f64>,
}

/// `angle` less full turns: in (−π, π].
pub fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle.abs() <= PI && angle != -PI {
        return angle;
    }
    let turns = angle - TAU * (angle / TAU).round();
    if turns <= -PI { turns + TAU } else { turns }
}

fn turned(angle: f64, v: Vector2<f64>) -> Vector2<f64> {
    let (sin, cos) = angle.sin_cos();
    Vector2::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y)
}

impl Se2 {
    /// The motion by (x, y) metres after a turn by `angle` radians.
    pub fn new(x: f64, y: f64, angle: f64) -> Self {
        Self { translation: Vector2::new(x, y), angle: wrapped(angle) }
    }
}

/// A motion of the plane and its rotation's cosine and sine.
#[derive(Clone, Copy, Debug)]
pub struct Frame2 {
    translation: Vector2<f64>,
    angle: f64,
    cos: f64,
    sin: f64,
}

impl Frame2 {
    /// A direction of the world in the axes of the frame.
    fn back(&self, v: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x)
    }
}

impl Group<3> for Se2 {
    const DIMENSION: usize = 2;
    type Frame = Frame2;

    fn identity() -> Self {
        Self::new(0.0, 0.0, 0.0)
    }

    fn compose(&self, other: &Self) -> Self {
        Self {
            translation: self.translation + turned(self.angle, other.translation),
            angle: wrapped(self.angle + other.angle),
        }
    }

    fn inverse(&self) -> Self {
        Self { translation: -turned(-self.angle, self.translation), angle: wrapped(-self.angle) }
    }

    fn retract(&self, tangent: &SVector<f64, 3>) -> Self {
        self.compose(&Self::new(tangent[0], tangent[1], tangent[2]))
    }

    fn local(&self, other: &Self) -> SVector<f64, 3> {
        let step = self.between(other);
        SVector::<f64, 3>::new(step.translation.x, step.translation.y, step.angle)
    }

    fn local_derivative(tangent: &SVector<f64, 3>) -> Matrix3<f64> {
        let (sin, cos) = tangent[2].sin_cos();
        Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
    }

    fn error(from: &Self, to: &Self, measured: &Self) -> SVector<f64, 3> {
        let error = measured.between(&from.between(to));
        SVector::<f64, 3>::new(error.translation.x, error.translation.y, error.angle)
    }

    fn frame(&self) -> Frame2 {
        let (sin, cos) = self.angle.sin_cos();
        Frame2 { translation: self.translation, angle: self.angle, cos, sin }
    }

    #[inline]
    fn linearise_frames(from: &Frame2, to: &Frame2, measured: &Frame2) -> Linearised<3> {
        let seen = from.back(to.translation - from.translation);
        let t = measured.back(seen - measured.translation);
        let swing = measured.back(Vector2::new(seen.y, -seen.x));
        // The first column of the error's rotation.
        let turn = measured.back(from.back(Vector2::new(to.cos, to.sin)));
        let (cos, sin) = (measured.cos, measured.sin);
        let angle = wrapped(to.angle - from.angle - measured.angle);
        Linearised {
            error: SVector::<f64, 3>::new(t.x, t.y, angle),
            from: Matrix3::new(-cos, -sin, swing.x, sin, -cos, swing.y, 0.0, 0.0, -1.0),
            to: Matrix3::new(turn.x, -turn.y, 0.0, turn.y, turn.x, 0.0, 0.0, 0.0, 1.0),
        }
    }

    fn is_finite(&self) -> bool {
        self.translation.iter().all(|x| x.is_finite()) && self.angle.is_finite()
    }
}

impl Se3 {
    /// The motion by `translation` metres after a rotation by the quaternion (x, y, z, w), which is
    /// normalised.
    pub fn new(translation: [f64; 3], [x, y, z, w]: [f64; 4]) -> Self {
        Self {
            translation: translation.into(),
            rotation: UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
        }
    }
}

impl Group<6> for Se3 {
    const DIMENSION: usize = 3;
    type Frame = Self;

    fn identity() -> Self {
        Self { translation: Vector3::zeros(), rotation: UnitQuaternion::identity() }
    }

    fn compose(&self, other: &Self) -> Self {
        Self {
            translation: self.translation + self.rotation * other.translation,
            rotation: self.rotation * other.rotation,
        }
    }

    fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { translation: -(rotation * self.translation), rotation }
    }

    fn retract(&self, tangent: &SVector<f64, 6>) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(tangent.fixed_rows::<3>(3).into_owned());
        let mut rotation = self.rotation * turn;
        rotation.renormalize_fast();
        Self {
            translation: self.translation + self.rotation * tangent.fixed_rows::<3>(0).into_owned(),
            rotation,
        }
    }

    fn local(&self, other: &Self) -> SVector<f64, 6> {
        let step = self.between(other);
        let (t, r) = (step.translation, step.rotation.scaled_axis());
        SVector::<f64, 6>::new(t.x, t.y, t.z, r.x, r.y, r.z)
    }

    fn local_derivative(tangent: &SVector<f64, 6>) -> SMatrix<f64, 6, 6> {
        let r = tangent.fixed_rows::<3>(3).into_owned();
        let (angle, cross) = (r.norm(), r.cross_matrix());
        // The inverse of the right Jacobian of SO(3): 1 + ½[r] + (1/θ² − (1 + cos θ)/(2θ sin θ))[r]².
        let square = if angle < 1e-4 {
            1.0 / 12.0
        } else {
            (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle)
        };
        let turn = UnitQuaternion::from_scaled_axis(r).to_rotation_matrix().into_inner();
        let bend = Matrix3::identity() + cross * 0.5 + cross * cross * square;
        let mut derivative = SMatrix::<f64, 6, 6>::zeros();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        derivative.fixed_view_mut::<3, 3>(3, 3).copy_from(&bend);
        derivative
    }

    fn error(from: &Self, to: &Self, measured: &Self) -> SVector<f64, 6> {
        let error = measured.between(&from.between(to));
        let (t, q) = (error.translation, error.rotation.quaternion());
        let v = if q.w < 0.0 { -q.imag() } else { q.imag() };
        SVector::<f64, 6>::new(t.x, t.y, t.z, v.x, v.y, v.z)
    }

    fn frame(&self) -> Self {
        *self
    }

    #[inline]
    fn linearise_frames(from: &Self, to: &Self, measured: &Self) -> Linearised<6> {
        let from_back = from.rotation.inverse();
        let seen = from_back * (to.translation - from.translation);
        let back = measured.rotation.inverse();
        let q = (back * (from_back * to.rotation)).into_inner();
        let t = back * (seen - measured.translation);
        let back = back.to_rotation_matrix().into_inner();
        let turn = UnitQuaternion::new_unchecked(q).to_rotation_matrix().into_inner();
        let (v, sign) = (q.imag(), if q.w < 0.0 { -1.0 } else { 1.0 });
        // v of q (1, b/2) and of (1, −a/2) q, the latter with a seen from the measurement.
        let after = (Matrix3::from_diagonal_element(q.w) + v.cross_matrix()) * (0.5 * sign);
        let before = (Matrix3::from_diagonal_element(q.w) - v.cross_matrix()) * (0.5 * sign);
        let (mut by_from, mut by_to) =
            (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 6>::zeros());
        by_from.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
        by_from.fixed_view_mut::<3, 3>(0, 3).copy_from(&(back * seen.cross_matrix()));
        by_from.fixed_view_mut::<3, 3>(3, 3).copy_from(&-(before * back));
        by_to.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        by_to.fixed_view_mut::<3, 3>(3, 3).copy_from(&after);
        let v = v * sign;
        Linearised {
            error: SVector::<f64, 6>::new(t.x, t.y, t.z, v.x, v.y, v.z),
            from: by_from,
            to: by_to,
        }
    }

    fn is_finite(&self) -> bool {
        self.translation.iter().chain(self.rotation.coords.iter()).all(|x| x.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn se2() -> impl Strategy<Value = Se2> {
        [-5.0f64..5.0, -5.0f64..5.0, -9.0f64..9.0].prop_map(|[x, y, a]| Se2::new(x, y, a))
    }

    fn se3() -> impl Strategy<Value = Se3> {
        let numbers = proptest::array::uniform7(-1.0f64..1.0);
        numbers.prop_map(|[x, y, z, a, b, c, w]| {
            Se3::new([x, y, z], [a, b, c, w + 1.5f64.copysign(w)])
        })
    }

    fn group<G: Group<D>, const D: usize>(a: G, b: G) -> Result<(), TestCaseError> {
        let none = SVector::<f64, D>::zeros();
        let exact = G::error(&a, &b, &a.between(&b));
        prop_assert!((exact - none).norm() < 1e-12, "{exact}");
        let back = G::error(&G::identity(), &a.compose(&a.inverse()), &G::identity());
        prop_assert!(back.norm() < 1e-12, "{back}");
        Ok(())
    }

    /// Derivatives against central differences.
    fn derivatives<G: Group<D>, const D: usize>(x: G, y: G, z: G) -> Result<(), TestCaseError> {
        let exact = G::linearise(&x, &y, &z);
        prop_assert!((exact.error - G::error(&x, &y, &z)).norm() < 1e-12);
        let h = 1e-6;
        for i in 0..D {
            let step = SVector::<f64, D>::from_fn(|r, _| if r == i { h } else { 0.0 });
            let from = [x.retract(&-step), x.retract(&step)].map(|x| G::error(&x, &y, &z));
            let to = [y.retract(&-step), y.retract(&step)].map(|y| G::error(&x, &y, &z));
            for ([less, more], exact) in [(from, exact.from), (to, exact.to)] {
                let slope = (more - less) / (2.0 * h);
                let wrong = (slope - exact.column(i)).norm();
                prop_assert!(wrong < 1e-7 * (1.0 + slope.norm()), "{i}: {slope} {exact}");
            }
        }
        Ok(())
    }

    fn tangents<G: Group<D>, const D: usize>(x: G, y: G) -> Result<(), TestCaseError> {
        let tangent = x.local(&y);
        prop_assert!(G::error(&x.retract(&tangent), &y, &G::identity()).norm() < 1e-9);
        let (h, exact) = (1e-6, G::local_derivative(&tangent));
        for i in 0..D {
            let step = SVector::<f64, D>::from_fn(|r, _| if r == i { h } else { 0.0 });
            let slope = (x.local(&y.retract(&step)) - x.local(&y.retract(&-step))) / (2.0 * h);
            prop_assert!((slope - exact.column(i)).norm() < 1e-6, "{i}: {slope} {exact}");
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn tangents_lead_from_pose_to_pose((x, y) in (se2(), se2()), (a, b) in (se3(), se3())) {
            prop_assume!(x.local(&y)[2].abs() < 3.13 && a.local(&b).fixed_rows::<3>(3).norm() < 3.1);
            tangents(x, y)?;
            tangents(a, b)?;
        }

        #[test]
        fn derivatives_are_those_of_the_error(
            (x, y, z) in (se2(), se2(), se2()), (a, b, c) in (se3(), se3(), se3()),
        ) {
            // At half a turn the error itself jumps.
            prop_assume!(Se2::error(&x, &y, &z)[2].abs() < std::f64::consts::PI - 1e-4);
            derivatives(x, y, z)?;
            prop_assume!(Se3::error(&a, &b, &c).fixed_rows::<3>(3).norm() < 0.99999);
            derivatives(a, b, c)?;
        }

        #[test]
        fn derivatives_are_right_near_half_turns(
            axis in proptest::array::uniform3(-1.0f64..1.0), short in 1e-4f64..1e-2, (x, z) in (se3(), se3()),
            (u, v) in (se2(), se2()), side in prop::bool::ANY,
        ) {
            let axis = Vector3::from(axis);
            prop_assume!(axis.norm() > 0.1);
            let angle = std::f64::consts::PI - short;
            let turn = UnitQuaternion::from_scaled_axis(axis.normalize() * angle);
            let error = Se3 { translation: axis, rotation: turn };
            derivatives(x, x.compose(&z).compose(&error), z)?;
            let error = Se2::new(axis.x, axis.y, if side { angle } else { -angle });
            derivatives(u, u.compose(&v).compose(&error), v)?;
        }

        #[test]
        fn measurements_of_the_poses_themselves_have_no_error(
            (a, b) in (se2(), se2()), (c, d) in (se3(), se3()),
        ) {
            group(a, b)?;
            group(c, d)?;
        }

        #[test]
        fn angles_are_wrapped(angle in -100.0f64..100.0) {
            let w = wrapped(angle);
            prop_assert!(w > -std::f64::consts::PI && w <= std::f64::consts::PI);
            prop_assert!((w.sin() - angle.sin()).abs() < 1e-12 && (w.cos() - angle.cos()).abs() < 1e-12);
        }
    }

    #[test]
    fn half_turns_stay_positive() {
        use std::f64::consts::PI;
        assert_eq!(wrapped(-PI), PI);
        assert_eq!(wrapped(PI), PI);
        assert_eq!(wrapped(-3.0 * PI), PI);
        assert!(wrapped(f64::NAN).is_nan() && wrapped(f64::INFINITY).is_nan());
    }
}
