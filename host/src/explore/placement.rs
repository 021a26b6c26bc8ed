//! Where a hand can close: the candidates among which exploration chooses.

use std::f64::consts::{PI, TAU};

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::sim::random::Random;
use crate::sim::touch::{Stroke, strokes};
use crate::space::{Point, Pose};

/// Fingers of the hand.
const FINGERS: usize = 5;

/// How far off the object's middle a hand is placed at most, in the object's radius.
const OFF_CENTRE: f64 = 0.5;

/// A grasp: the hand's pose in the object frame, as it is believed to be, and its posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Hand to object; the fingers close along the hand's y.
    pub hand: Pose,
    /// Distances between the fingers and their turns inwards, 1 for an open hand.
    pub spread: f64,
}

impl Placement {
    /// The ways of the fingertips in the hand's frame, for an object no part of which is further than
    /// `radius` metres from the middle of the hand.
    pub fn strokes(&self, dimension: usize, radius: f64) -> Vec<Stroke> {
        strokes(dimension, FINGERS, radius, self.spread, 0.0)
    }

    /// Whether the other is nearly the same grasp: within 5 mm and 10°, with the same posture.
    pub fn repeats(&self, other: &Placement) -> bool {
        let between = self.hand.inv_mul(&other.hand);
        between.translation.vector.norm() < 5e-3
            && between.rotation.angle() < 10f64.to_radians()
            && self.spread == other.spread
    }
}

/// Ten grasps about `centre`, object frame (thesis 4.5.2 has ten by hand, without their numbers): in
/// the plane one every 36°, in space with palms spread evenly over the sphere; every second one with
/// the fingers closer together.
pub fn fixed(dimension: usize, centre: &Point) -> Vec<Placement> {
    const COUNT: usize = 10;
    let golden = PI * (3.0 - 5f64.sqrt());
    (0..COUNT)
        .map(|k| {
            let turn = if dimension == 2 {
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), TAU * k as f64 / COUNT as f64)
            } else {
                let height = 1.0 - (2.0 * k as f64 + 1.0) / COUNT as f64;
                let across = (1.0 - height * height).sqrt();
                let (sin, cos) = (golden * k as f64).sin_cos();
                let palm = Vector3::new(across * cos, across * sin, height);
                UnitQuaternion::rotation_between(&Vector3::y(), &palm)
                    .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI))
            };
            let hand = Pose::from_parts(Translation3::from(*centre), turn);
            Placement { hand, spread: [1.0, 0.6][k % 2] }
        })
        .collect()
}

/// A grasp of any direction about `centre` (object frame), off it by up to half of `radius` per axis
/// (metres), with one of three postures.
pub fn drawn(dimension: usize, centre: &Point, radius: f64, random: &mut Random) -> Placement {
    let off: [f64; 3] = std::array::from_fn(|axis| match axis {
        2 if dimension == 2 => 0.0,
        _ => random.around_zero(OFF_CENTRE * radius),
    });
    let turn = if dimension == 2 {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.around_zero(PI))
    } else {
        // Uniform over the rotations: any axis for the palm, any turn about it.
        let palm = random.direction(3);
        let toward = UnitQuaternion::rotation_between(&Vector3::y(), &palm)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        toward * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), random.around_zero(PI))
    };
    let spread = [0.5, 0.75, 1.0][((random.unit() * 3.0) as usize).min(2)];
    let middle = centre + Point::from(off);
    Placement { hand: Pose::from_parts(Translation3::from(middle), turn), spread }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_grasps_face_ten_ways() {
        for dimension in [2, 3] {
            let ten = fixed(dimension, &Point::new(0.01, 0.02, 0.0));
            assert_eq!(ten.len(), 10);
            for (i, a) in ten.iter().enumerate() {
                assert_eq!(a.hand.translation.vector, Point::new(0.01, 0.02, 0.0));
                for b in &ten[..i] {
                    assert!(!a.repeats(b));
                    let apart =
                        (a.hand.rotation * Point::y()).angle(&(b.hand.rotation * Point::y()));
                    assert!(apart > 30f64.to_radians(), "{dimension}: {apart}");
                }
            }
        }
    }

    #[test]
    fn drawn_grasps_stay_near_and_in_their_space() {
        let [mut random] = Random::streams(3);
        for _ in 0..200 {
            let p = drawn(2, &Point::zeros(), 0.06, &mut random);
            assert!(p.hand.translation.vector.amax() <= 0.03 && p.hand.translation.z == 0.0);
            assert!((p.hand.rotation * Point::z() - Point::z()).norm() < 1e-12);
            assert!(p.repeats(&p));
            let q = drawn(3, &Point::zeros(), 0.06, &mut random);
            assert!(q.hand.translation.vector.amax() <= 0.03);
        }
    }
}
