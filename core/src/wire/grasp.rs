//! What a grasp is made of: the motion before it, what fingers felt, and where they felt nothing.

use serde::{Deserialize, Serialize};

use super::frame::Settings;
use super::quantity::{WireSpace, nearest};
use crate::contact::{Contact, FreePoint};
use crate::track::is_plausible;

/// A motion, world to world: predicted pose = motion ∘ previous pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct MotionFrame<S: WireSpace> {
    /// The pose's numbers.
    pub numbers: S::Numbers,
}

impl<S: WireSpace> MotionFrame<S> {
    /// Packs a motion.
    pub fn new(motion: &S::Pose) -> Self {
        MotionFrame { numbers: S::pack_pose(motion) }
    }

    /// The motion, or `None` when a number is not finite or it goes further than 10 km.
    pub fn motion(&self) -> Option<S::Pose> {
        S::unpack_pose(self.numbers).filter(is_plausible::<S>)
    }
}

/// A contact in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct ContactFrame<S: WireSpace> {
    /// Which finger.
    pub finger: u8,
    /// Where, micrometres.
    pub point: S::Point,
    /// The unit normal out of the object and its standard deviation in quarter degrees, where 0
    /// stands for [`Settings::normal`].
    pub normal: Option<(S::Normal, u8)>,
}

const QUARTER_DEGREE: f32 = core::f32::consts::PI / 720.0;

impl<S: WireSpace> ContactFrame<S> {
    /// Packs a contact. Its own normal deviation is sent (to the nearest quarter degree, at least
    /// one and at most 63.75°) only where it differs from the `usual` one; the point's deviation is
    /// always the configured one.
    pub fn new(contact: &Contact<S>, usual: f32) -> Self {
        let deviation = if contact.normal_deviation == usual {
            0
        } else {
            nearest(contact.normal_deviation / QUARTER_DEGREE).clamp(1, 255) as u8
        };
        ContactFrame {
            finger: contact.finger,
            point: S::pack_point(contact.point),
            normal: contact.normal.map(|n| (S::pack_normal(n), deviation)),
        }
    }

    /// The contact, with the deviations of `settings` where the frame has none.
    pub fn contact(&self, settings: &Settings) -> Contact<S> {
        let deviation = match self.normal {
            Some((_, quarters)) if quarters > 0 => quarters as f32 * QUARTER_DEGREE,
            _ => settings.normal,
        };
        Contact {
            point: S::unpack_point(self.point),
            normal: self.normal.map(|(n, _)| S::unpack_normal(n)),
            point_deviation: settings.point,
            normal_deviation: deviation,
            finger: self.finger,
        }
    }
}

/// A free fingertip in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct FreeFrame<S: WireSpace> {
    /// Which finger.
    pub finger: u8,
    /// Where, micrometres.
    pub point: S::Point,
}

impl<S: WireSpace> FreeFrame<S> {
    /// Packs a free point.
    pub fn new(free: &FreePoint<S>) -> Self {
        FreeFrame { finger: free.finger, point: S::pack_point(free.point) }
    }

    /// The free point.
    pub fn free_point(&self) -> FreePoint<S> {
        FreePoint { point: S::unpack_point(self.point), finger: self.finger }
    }
}
