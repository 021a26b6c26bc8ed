//! The two spaces a tactile object lives in, and their rigid poses.
//!
//! A pose maps object coordinates to world coordinates. Its tangent is taken at the pose and in
//! *object* axes: translation first (metres), then rotation (radians); `retract` adds a tangent,
//! `local` is its inverse. Translation and rotation are retracted separately (ℝⁿ × SO(n)), so a
//! covariance in tangent coordinates reads as "so many metres, so many radians about the object".

use core::fmt::Debug;

use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};

/// A space: its dimension, its vectors and its rigid poses. The one generic of the core.
pub trait Space: Copy + Debug + Default + PartialEq + Send + Sync + 'static {
    /// Number of coordinates of a point.
    const DIMENSION: usize;
    /// Degrees of freedom of a rigid body.
    const FREEDOM: usize;
    /// A point (metres) or a direction.
    type Vector: Coordinates;
    /// Translation in object axes, then rotation: metres and radians.
    type Tangent: Coordinates;
    /// Covariance of a pose in tangent coordinates, and the matrix of its eigenvectors.
    type Covariance: Square<Vector = Self::Tangent>;
    /// A rigid transformation, object to world.
    type Pose: Pose<Self>;

    /// The velocity of `point` (relative to the object's origin, object axes) under each unit
    /// tangent, projected on `normal`: the Jacobian of n·p, thesis 3.17 as corrected.
    fn lever(point: Self::Vector, normal: Self::Vector) -> Self::Tangent;

    /// Orthonormal directions across a unit vector, as many as it has coordinates less one; the rest
    /// are zero.
    fn tangents(normal: Self::Vector) -> [Self::Vector; 2];

    /// The angle in radians between two unit vectors, in [0, π].
    fn angle_between(a: Self::Vector, b: Self::Vector) -> f32;
}

/// A rigid transformation.
pub trait Pose<S: Space>: Copy + Debug + PartialEq + Send + Sync + 'static {
    /// Maps every point to itself.
    const IDENTITY: Self;
    /// All zero bits, so that arrays of poses can live in `.bss`; not a rigid transformation.
    const UNSET: Self;

    /// The pose at `translation` (metres), not rotated.
    fn from_translation(translation: S::Vector) -> Self;

    /// Where the object's origin is, metres.
    fn translation(&self) -> S::Vector;

    /// `self ∘ other`: first `other`, then `self`.
    fn compose(&self, other: &Self) -> Self;

    /// The transformation back.
    fn inverse(&self) -> Self;

    /// A direction from object to world axes.
    fn rotate(&self, v: S::Vector) -> S::Vector;

    /// A direction from world to object axes.
    fn unrotate(&self, v: S::Vector) -> S::Vector;

    /// A point from object to world.
    #[inline(always)]
    fn transform(&self, p: S::Vector) -> S::Vector {
        self.rotate(p) + self.translation()
    }

    /// A point from world to object.
    #[inline(always)]
    fn untransform(&self, p: S::Vector) -> S::Vector {
        self.unrotate(p - self.translation())
    }

    /// The pose displaced by a tangent in object axes.
    fn retract(&self, tangent: S::Tangent) -> Self;

    /// The tangent that retracts `self` to `other`; rotations in (−π, π].
    fn local(&self, other: &Self) -> S::Tangent;

    /// Whether every number is finite.
    fn is_finite(&self) -> bool;
}

/// The plane: x, y and one angle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Planar;

/// Three-dimensional space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spatial;

impl Space for Planar {
    const DIMENSION: usize = 2;
    const FREEDOM: usize = 3;
    type Vector = Vector<2>;
    type Tangent = Vector<3>;
    type Covariance = Matrix<3>;
    type Pose = PlanarPose;

    #[inline]
    fn lever(p: Vector<2>, n: Vector<2>) -> Vector<3> {
        Vector([n[0], n[1], p[0] * n[1] - p[1] * n[0]])
    }

    #[inline(always)]
    fn tangents(n: Vector<2>) -> [Vector<2>; 2] {
        [Vector([-n[1], n[0]]), Vector::ZERO]
    }

    #[inline]
    fn angle_between(a: Vector<2>, b: Vector<2>) -> f32 {
        math::atan2(a[0] * b[1] - a[1] * b[0], a.dot(b)).abs()
    }
}

impl Space for Spatial {
    const DIMENSION: usize = 3;
    const FREEDOM: usize = 6;
    type Vector = Vector<3>;
    type Tangent = Vector<6>;
    type Covariance = Matrix<6>;
    type Pose = SpatialPose;

    #[inline]
    fn lever(p: Vector<3>, n: Vector<3>) -> Vector<6> {
        let m = p.cross(n);
        Vector([n[0], n[1], n[2], m[0], m[1], m[2]])
    }

    #[inline(always)]
    fn tangents(n: Vector<3>) -> [Vector<3>; 2] {
        n.tangents()
    }

    #[inline]
    fn angle_between(a: Vector<3>, b: Vector<3>) -> f32 {
        math::atan2(a.cross(b).norm(), a.dot(b))
    }
}

/// A translation and a rotation in the plane, the rotation as a unit complex number so that
/// transforming a point needs no trigonometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarPose {
    /// Position of the object's origin in the world, metres.
    pub translation: Vector<2>,
    cos: f32,
    sin: f32,
}

impl PlanarPose {
    /// The pose at `translation` (metres) turned by `angle` (radians, counter-clockwise).
    pub fn new(translation: Vector<2>, angle: f32) -> Self {
        let (sin, cos) = math::sin_cos(angle);
        PlanarPose { translation, cos, sin }
    }

    /// The rotation in (−π, π], radians.
    pub fn angle(&self) -> f32 {
        math::atan2(self.sin, self.cos)
    }

    /// Rounding makes the complex number drift off the unit circle; one Newton step returns it.
    #[inline(always)]
    fn renormalized(translation: Vector<2>, cos: f32, sin: f32) -> Self {
        let scale = 1.5 - 0.5 * (cos * cos + sin * sin);
        PlanarPose { translation, cos: cos * scale, sin: sin * scale }
    }
}

impl Pose<Planar> for PlanarPose {
    const IDENTITY: Self = PlanarPose { translation: Vector::ZERO, cos: 1.0, sin: 0.0 };
    const UNSET: Self = PlanarPose { translation: Vector::ZERO, cos: 0.0, sin: 0.0 };

    fn from_translation(translation: Vector<2>) -> Self {
        PlanarPose { translation, ..Self::IDENTITY }
    }

    #[inline(always)]
    fn translation(&self) -> Vector<2> {
        self.translation
    }

    #[inline]
    fn compose(&self, other: &Self) -> Self {
        Self::renormalized(
            self.transform(other.translation),
            self.cos * other.cos - self.sin * other.sin,
            self.sin * other.cos + self.cos * other.sin,
        )
    }

    #[inline]
    fn inverse(&self) -> Self {
        PlanarPose { translation: -self.unrotate(self.translation), cos: self.cos, sin: -self.sin }
    }

    #[inline(always)]
    fn rotate(&self, v: Vector<2>) -> Vector<2> {
        Vector([self.cos * v[0] - self.sin * v[1], self.sin * v[0] + self.cos * v[1]])
    }

    #[inline(always)]
    fn unrotate(&self, v: Vector<2>) -> Vector<2> {
        Vector([self.cos * v[0] + self.sin * v[1], self.cos * v[1] - self.sin * v[0]])
    }

    #[inline]
    fn retract(&self, t: Vector<3>) -> Self {
        self.compose(&PlanarPose::new(Vector([t[0], t[1]]), t[2]))
    }

    #[inline]
    fn local(&self, other: &Self) -> Vector<3> {
        let d = self.unrotate(other.translation - self.translation);
        let cos = self.cos * other.cos + self.sin * other.sin;
        let sin = self.cos * other.sin - self.sin * other.cos;
        Vector([d[0], d[1], math::atan2(sin, cos)])
    }

    fn is_finite(&self) -> bool {
        self.translation.is_finite() && self.cos.is_finite() && self.sin.is_finite()
    }
}

/// A translation and a rotation in space, the rotation as a unit quaternion (x, y, z, w).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialPose {
    /// Position of the object's origin in the world, metres.
    pub translation: Vector<3>,
    vector: Vector<3>,
    scalar: f32,
}

impl SpatialPose {
    /// The pose at `translation` (metres) with the rotation of the quaternion (x, y, z, w), which
    /// is normalised; a quaternion shorter than 10⁻⁶ or not finite gives no rotation.
    pub fn new(translation: Vector<3>, quaternion: [f32; 4]) -> Self {
        let [x, y, z, w] = quaternion;
        let n = math::sqrt(x * x + y * y + z * z + w * w);
        if !(n > 1e-6 && n.is_finite()) {
            return SpatialPose { translation, ..Self::IDENTITY };
        }
        let s = 1.0 / n;
        SpatialPose { translation, vector: Vector([x * s, y * s, z * s]), scalar: w * s }
    }

    /// The rotation as a unit quaternion (x, y, z, w).
    pub fn quaternion(&self) -> [f32; 4] {
        [self.vector[0], self.vector[1], self.vector[2], self.scalar]
    }

    /// The rotation by |w| radians about w.
    fn from_rotation_vector(w: Vector<3>) -> (Vector<3>, f32) {
        let angle = w.norm();
        let (sin, cos) = math::sin_cos(0.5 * angle);
        let scale = if angle > 1e-4 { sin / angle } else { 0.5 - angle * angle * (1.0 / 48.0) };
        (w * scale, cos)
    }

    #[inline(always)]
    fn multiply(a: (Vector<3>, f32), b: (Vector<3>, f32)) -> (Vector<3>, f32) {
        (b.0 * a.1 + a.0 * b.1 + a.0.cross(b.0), a.1 * b.1 - a.0.dot(b.0))
    }

    #[inline(always)]
    fn turn(vector: Vector<3>, scalar: f32, v: Vector<3>) -> Vector<3> {
        let t = vector.cross(v) * 2.0;
        v + t * scalar + vector.cross(t)
    }
}

impl Pose<Spatial> for SpatialPose {
    const IDENTITY: Self =
        SpatialPose { translation: Vector::ZERO, vector: Vector::ZERO, scalar: 1.0 };
    const UNSET: Self =
        SpatialPose { translation: Vector::ZERO, vector: Vector::ZERO, scalar: 0.0 };

    fn from_translation(translation: Vector<3>) -> Self {
        SpatialPose { translation, ..Self::IDENTITY }
    }

    #[inline(always)]
    fn translation(&self) -> Vector<3> {
        self.translation
    }

    #[inline(never)]
    fn compose(&self, other: &Self) -> Self {
        let (v, s) = Self::multiply((self.vector, self.scalar), (other.vector, other.scalar));
        // One Newton step back to unit length, as rounding lets products drift.
        let scale = 1.5 - 0.5 * (v.norm_squared() + s * s);
        SpatialPose {
            translation: self.transform(other.translation),
            vector: v * scale,
            scalar: s * scale,
        }
    }

    #[inline]
    fn inverse(&self) -> Self {
        SpatialPose {
            translation: -self.unrotate(self.translation),
            vector: -self.vector,
            scalar: self.scalar,
        }
    }

    #[inline(always)]
    fn rotate(&self, v: Vector<3>) -> Vector<3> {
        Self::turn(self.vector, self.scalar, v)
    }

    #[inline(always)]
    fn unrotate(&self, v: Vector<3>) -> Vector<3> {
        Self::turn(-self.vector, self.scalar, v)
    }

    #[inline(never)]
    fn retract(&self, t: Vector<6>) -> Self {
        let (vector, scalar) = Self::from_rotation_vector(Vector([t[3], t[4], t[5]]));
        self.compose(&SpatialPose { translation: Vector([t[0], t[1], t[2]]), vector, scalar })
    }

    #[inline(never)]
    fn local(&self, other: &Self) -> Vector<6> {
        let d = self.unrotate(other.translation - self.translation);
        let (v, s) = Self::multiply((-self.vector, self.scalar), (other.vector, other.scalar));
        // q and −q are the same rotation: take the one of at most half a turn.
        let (v, s) = if s < 0.0 { (-v, -s) } else { (v, s) };
        let n = v.norm();
        let scale = if n > 1e-6 { 2.0 * math::atan2(n, s) / n } else { 2.0 };
        Vector([d[0], d[1], d[2], v[0] * scale, v[1] * scale, v[2] * scale])
    }

    fn is_finite(&self) -> bool {
        self.translation.is_finite() && self.vector.is_finite() && self.scalar.is_finite()
    }
}

/// Weighted mean of poses on the manifold (Karcher mean, at most eight Gauss–Newton steps) and
/// their covariance in tangent coordinates at the mean. Weights need not sum to one; `start` is a
/// pose near the heaviest mass. Without positive weight, `start` and zero covariance.
///
/// Algorithm 3.1 averages rotations as numbers; on the manifold there is no seam at ±π.
pub fn mean<S: Space>(
    poses: impl Iterator<Item = (f32, S::Pose)> + Clone,
    start: S::Pose,
) -> (S::Pose, S::Covariance) {
    let mut mean = start;
    for _ in 0..8 {
        let mut step = S::Tangent::ZERO;
        let mut total = 0.0;
        for (weight, pose) in poses.clone() {
            step += mean.local(&pose) * weight;
            total += weight;
        }
        if !(total > 0.0) {
            return (start, S::Covariance::ZERO);
        }
        step = step * (1.0 / total);
        mean = mean.retract(step);
        if step.norm_squared() < 1e-12 {
            break;
        }
    }
    let mut covariance = S::Covariance::ZERO;
    let mut total = 0.0;
    for (weight, pose) in poses {
        let d = mean.local(&pose);
        covariance.add_outer(weight, d, d);
        total += weight;
    }
    covariance.scale(1.0 / total);
    (mean, covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tangent6() -> impl Strategy<Value = Vector<6>> {
        proptest::array::uniform6(-1.2f32..1.2).prop_map(Vector)
    }

    fn close<V: Coordinates>(a: V, b: V, tolerance: f32) -> bool {
        (a - b).norm() < tolerance
    }

    proptest! {
        #[test]
        fn spatial_retract_inverts_local(a in tangent6(), b in tangent6()) {
            let x = SpatialPose::IDENTITY.retract(a);
            prop_assert!(close(x.local(&x.retract(b)), b, 2e-5));
        }
        #[test]
        fn spatial_inverse_undoes(a in tangent6(), p in proptest::array::uniform3(-2.0f32..2.0)) {
            let x = SpatialPose::IDENTITY.retract(a);
            let p = Vector(p);
            prop_assert!(close(x.untransform(x.transform(p)), p, 1e-5));
            prop_assert!(close(x.compose(&x.inverse()).transform(p), p, 1e-5));
        }
        #[test]
        fn spatial_compose_is_composition(a in tangent6(), b in tangent6(), p in proptest::array::uniform3(-2.0f32..2.0)) {
            let (x, y, p) = (SpatialPose::IDENTITY.retract(a), SpatialPose::IDENTITY.retract(b), Vector(p));
            prop_assert!(close(x.compose(&y).transform(p), x.transform(y.transform(p)), 1e-5));
        }
        #[test]
        fn planar_retract_inverts_local(a in proptest::array::uniform3(-3.0f32..3.0), b in proptest::array::uniform3(-3.0f32..3.0)) {
            let x = PlanarPose::IDENTITY.retract(Vector(a));
            prop_assert!(close(x.local(&x.retract(Vector(b))), Vector(b), 2e-5));
            let p = Vector([0.3, -0.7]);
            prop_assert!(close(x.compose(&x.inverse()).transform(p), p, 1e-5));
        }
        #[test]
        fn lever_is_the_derivative(p in proptest::array::uniform3(-0.2f32..0.2), n in proptest::array::uniform3(-1.0f32..1.0), k in 0usize..6) {
            let (p, n) = (Vector(p), Vector(n));
            let h = 1e-2;
            let mut t = Vector::<6>::ZERO;
            t[k] = h;
            let moved = SpatialPose::IDENTITY.retract(t).transform(p) - SpatialPose::IDENTITY.retract(-t).transform(p);
            prop_assert!((moved.dot(n) / (2.0 * h) - Spatial::lever(p, n)[k]).abs() < 1e-3);
        }
    }

    #[test]
    fn mean_crosses_the_seam() {
        let poses = [3.1f32, -3.1].map(|a| (1.0, PlanarPose::new(Vector([0.1, 0.2]), a)));
        let (mean, covariance) = mean::<Planar>(poses.iter().copied(), poses[0].1);
        assert!((mean.angle().abs() - core::f32::consts::PI).abs() < 1e-4, "{mean:?}");
        assert!((math::sqrt(covariance.at(2, 2)) - 0.0416).abs() < 1e-3);
        assert_eq!(super::mean::<Planar>([].iter().copied(), poses[0].1).0, poses[0].1);
    }

    #[test]
    fn bad_quaternions_do_not_rotate() {
        for q in [[0.0; 4], [f32::NAN, 0.0, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0, 1.0]] {
            assert_eq!(SpatialPose::new(Vector::ZERO, q), SpatialPose::IDENTITY);
        }
    }
}
