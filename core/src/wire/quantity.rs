//! How numbers and geometry are packed.

use core::f32::consts::PI;
use core::fmt::Debug;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::math;
use crate::matrix::{Coordinates, Vector};
use crate::space::{Planar, PlanarPose, Space, Spatial, SpatialPose};

/// A number in [−1, 1] in two bytes: value / 32767, least significant byte first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "[u8; 2]", into = "[u8; 2]")]
pub struct Fraction(pub i16);

impl Fraction {
    /// The nearest fraction; numbers outside [−1, 1] are taken to the nearer end and NaN to zero.
    pub fn new(value: f32) -> Self {
        Fraction(nearest(value.clamp(-1.0, 1.0) * 32767.0) as i16)
    }

    /// The number.
    pub fn value(self) -> f32 {
        self.0 as f32 * (1.0 / 32767.0)
    }
}

impl From<[u8; 2]> for Fraction {
    fn from(bytes: [u8; 2]) -> Self {
        Fraction(i16::from_le_bytes(bytes))
    }
}

impl From<Fraction> for [u8; 2] {
    fn from(fraction: Fraction) -> Self {
        fraction.0.to_le_bytes()
    }
}

/// Microseconds of a sender's clock in four bytes, least significant first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "[u8; 4]", into = "[u8; 4]")]
pub struct Clock(pub u32);

impl From<[u8; 4]> for Clock {
    fn from(bytes: [u8; 4]) -> Self {
        Clock(u32::from_le_bytes(bytes))
    }
}

impl From<Clock> for [u8; 4] {
    fn from(clock: Clock) -> Self {
        clock.0.to_le_bytes()
    }
}

/// To the nearest whole number, halves away from zero; NaN gives zero, huge numbers the nearest.
#[inline(never)]
pub(super) fn nearest(x: f32) -> i32 {
    // From 2²³ on numbers are whole, and a half more would be rounded to the next but one.
    let half = if x.abs() < 8_388_608.0 { 0.5f32.copysign(x) } else { 0.0 };
    (x + half) as i32
}

/// What can stand in a frame.
pub trait Field: Serialize + DeserializeOwned + Copy + Debug + PartialEq + 'static {}

impl<T: Serialize + DeserializeOwned + Copy + Debug + PartialEq + 'static> Field for T {}

/// How a space's geometry is packed. The arrays' lengths are fixed, so none is sent.
pub trait WireSpace: Space {
    /// A point in whole micrometres.
    type Point: Field;
    /// A unit vector: its angle over π in the plane; the octahedral projection in space.
    type Normal: Field;
    /// A pose: x, y (metres), angle (radians); or x, y, z, quaternion x, y, z, w.
    type Numbers: Field;
    /// One `f32` for every degree of freedom.
    type Deviations: Field + Default + AsRef<[f32]> + AsMut<[f32]>;
    /// One fraction for every degree of freedom.
    type Fractions: Field + Default + AsRef<[Fraction]> + AsMut<[Fraction]>;
    /// One fraction for every pair of degrees of freedom: (1,0), (2,0), (2,1), (3,0) …
    type Correlations: Field + Default + AsRef<[Fraction]> + AsMut<[Fraction]>;

    /// Metres to micrometres, to the nearest; beyond ±2147 m the end of the range.
    fn pack_point(point: Self::Vector) -> Self::Point;
    /// Micrometres to metres.
    fn unpack_point(point: Self::Point) -> Self::Vector;
    /// A unit vector to its packed direction.
    fn pack_normal(normal: Self::Vector) -> Self::Normal;
    /// A unit vector, within 10⁻⁴ radians of the one that was packed.
    fn unpack_normal(normal: Self::Normal) -> Self::Vector;
    /// A pose to its numbers.
    fn pack_pose(pose: &Self::Pose) -> Self::Numbers;
    /// The pose, or `None` when a number is not finite or a quaternion not of unit length (within 1 %).
    fn unpack_pose(numbers: Self::Numbers) -> Option<Self::Pose>;
}

fn micrometres(x: f32) -> i32 {
    nearest(x * 1e6)
}

fn metres(x: i32) -> f32 {
    x as f32 * 1e-6
}

impl WireSpace for Planar {
    type Point = [i32; 2];
    type Normal = Fraction;
    type Numbers = [f32; 3];
    type Deviations = [f32; 3];
    type Fractions = [Fraction; 3];
    type Correlations = [Fraction; 3];

    fn pack_point(point: Vector<2>) -> [i32; 2] {
        point.0.map(micrometres)
    }

    fn unpack_point(point: [i32; 2]) -> Vector<2> {
        Vector(point.map(metres))
    }

    fn pack_normal(normal: Vector<2>) -> Fraction {
        Fraction::new(math::atan2(normal[1], normal[0]) * (1.0 / PI))
    }

    fn unpack_normal(normal: Fraction) -> Vector<2> {
        let (sin, cos) = math::sin_cos(normal.value() * PI);
        Vector([cos, sin])
    }

    fn pack_pose(pose: &PlanarPose) -> [f32; 3] {
        [pose.translation[0], pose.translation[1], pose.angle()]
    }

    fn unpack_pose(n: [f32; 3]) -> Option<PlanarPose> {
        let known = n[0].is_finite() && n[1].is_finite() && n[2].abs() <= math::LARGEST_ANGLE;
        known.then(|| PlanarPose::new(Vector([n[0], n[1]]), n[2]))
    }
}

impl WireSpace for Spatial {
    type Point = [i32; 3];
    type Normal = [Fraction; 2];
    type Numbers = [f32; 7];
    type Deviations = [f32; 6];
    type Fractions = [Fraction; 6];
    type Correlations = [Fraction; 15];

    fn pack_point(point: Vector<3>) -> [i32; 3] {
        point.0.map(micrometres)
    }

    fn unpack_point(point: [i32; 3]) -> Vector<3> {
        Vector(point.map(metres))
    }

    fn pack_normal(n: Vector<3>) -> [Fraction; 2] {
        // Onto |x| + |y| + |z| = 1, the lower half folded out over the corners of the upper.
        let sum = n[0].abs() + n[1].abs() + n[2].abs();
        let (x, y) = (n[0] / sum, n[1] / sum);
        let (x, y) = if n[2] < 0.0 { fold(x, y) } else { (x, y) };
        [Fraction::new(x), Fraction::new(y)]
    }

    fn unpack_normal(normal: [Fraction; 2]) -> Vector<3> {
        let [x, y] = normal.map(Fraction::value);
        let z = 1.0 - x.abs() - y.abs();
        let (x, y) = if z < 0.0 { fold(x, y) } else { (x, y) };
        Vector([x, y, z]).normalized().unwrap_or(Vector([0.0, 0.0, 1.0]))
    }

    fn pack_pose(pose: &SpatialPose) -> [f32; 7] {
        let [x, y, z, w] = pose.quaternion();
        [pose.translation[0], pose.translation[1], pose.translation[2], x, y, z, w]
    }

    fn unpack_pose(n: [f32; 7]) -> Option<SpatialPose> {
        let [x, y, z, quaternion @ ..] = n;
        let square: f32 = quaternion.iter().map(|v| v * v).sum();
        let known = [x, y, z].iter().all(|v| v.is_finite()) && (square - 1.0).abs() <= 0.02;
        known.then(|| SpatialPose::new(Vector([x, y, z]), quaternion))
    }
}

/// Mirrors a point of the square's corners across the nearest edge of the inner diamond.
fn fold(x: f32, y: f32) -> (f32, f32) {
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn normals_survive(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let Some(n) = Vector([x, y, z]).normalized() else { return Ok(()) };
            let back = Spatial::unpack_normal(Spatial::pack_normal(n));
            prop_assert!((back.norm() - 1.0).abs() < 1e-6);
            prop_assert!((back - n).norm() < 1e-4);
            let Some(n) = Vector([x, y]).normalized() else { return Ok(()) };
            prop_assert!((Planar::unpack_normal(Planar::pack_normal(n)) - n).norm() < 1e-4);
        }
        #[test]
        fn points_survive_to_half_a_micrometre(x in proptest::array::uniform3(-4.0f32..4.0)) {
            let back = Spatial::unpack_point(Spatial::pack_point(Vector(x)));
            for i in 0..3 {
                prop_assert!((back[i] - x[i]).abs() < 0.8e-6);
            }
        }
    }

    #[test]
    fn the_nearest_whole_number_is_meant() {
        let all = [
            (8_388_609.0, 8_388_609),
            (-16_777_215.0, -16_777_215),
            (0.5, 1),
            (-2.5, -3),
            (-2.4, -2),
            (3e9, i32::MAX),
            (f32::NEG_INFINITY, i32::MIN),
            (f32::NAN, 0),
        ];
        for (x, whole) in all {
            assert_eq!(nearest(x), whole, "{x}");
        }
    }

    #[test]
    fn axes_and_ends_are_decided() {
        for n in [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]] {
            assert!(
                (Spatial::unpack_normal(Spatial::pack_normal(Vector(n))) - Vector(n)).norm() < 1e-4
            );
        }
        assert_eq!(Fraction::new(f32::NAN).0, 0);
        assert_eq!(Fraction::new(7.0).0, 32767);
        assert_eq!(Spatial::pack_normal(Vector([f32::NAN; 3])), [Fraction(0); 2]);
        assert_eq!(Planar::pack_point(Vector([f32::INFINITY, f32::NAN])), [i32::MAX, 0]);
        assert!(Planar::unpack_pose([0.0, f32::NAN, 0.0]).is_none());
        // No angle by which anything could be turned.
        assert!(Planar::unpack_pose([0.0, 0.0, 3e5]).is_none());
        assert!(Planar::unpack_pose([0.0, 0.0, -1e5]).is_some());
        // No rotation.
        for q in [0.0, 0.9, 1.1, 1e30, f32::NAN] {
            assert!(Spatial::unpack_pose([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, q]).is_none());
        }
        assert!(Spatial::unpack_pose([0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.8001]).is_some());
    }
}
