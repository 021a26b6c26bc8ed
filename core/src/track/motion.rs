//! How much the object moves beyond what the hand intended.

use crate::random::Random;
use crate::space::{Pose, Space};

/// Gaussian motion noise of one grasp: thesis 3.7, the perturbation taken in object axes about the
/// object's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionNoise {
    /// Standard deviation of each translation, metres.
    pub translation: f32,
    /// Standard deviation of each rotation, radians.
    pub rotation: f32,
}

impl MotionNoise {
    /// The thesis' "100 %": 10 mm and 20°.
    pub const THESIS: Self = MotionNoise { translation: 0.01, rotation: 0.349_065_85 };

    /// `pose` displaced by one draw of the noise.
    pub fn disturb<S: Space>(&self, pose: &S::Pose, random: &mut Random) -> S::Pose {
        let mut t: S::Tangent = random.normal();
        for i in 0..S::FREEDOM {
            t[i] *= if i < S::DIMENSION { self.translation } else { self.rotation };
        }
        pose.retract(t)
    }
}
