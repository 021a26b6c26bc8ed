//! How much the object moves beyond what the hand intended.

use crate::math;
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

    /// The noise of a grasp whose motion is known or not: unknown motion is rest with twice the noise.
    pub(crate) fn of(&self, is_known: bool) -> Self {
        let factor = if is_known { 1.0 } else { 2.0 };
        MotionNoise { translation: factor * self.translation, rotation: factor * self.rotation }
    }

    /// The noise to search with after this many grasps in a row that fitted nowhere: the object may
    /// have slipped by more than the hand knows. At first twice the noise and no less than 30 mm and
    /// 40°, growing with every grasp to 200 mm (or four times the noise) and 115°; without a loss, the noise
    /// itself.
    pub fn after_losing(&self, grasps: u16) -> Self {
        if grasps == 0 {
            return *self;
        }
        let wider = |own: f32, least: f32, most: f32| {
            let wide = math::max(2.0 * own, least) * f32::from(grasps);
            math::min(wide, math::max(most, own))
        };
        MotionNoise {
            translation: wider(self.translation, 0.03, math::max(0.2, 4.0 * self.translation)),
            rotation: wider(self.rotation, 0.7, 2.0),
        }
    }

    /// `pose` displaced by one draw of the noise.
    pub fn disturb<S: Space>(&self, pose: &S::Pose, random: &mut Random) -> S::Pose {
        let mut t: S::Tangent = random.normal();
        for i in 0..S::FREEDOM {
            t[i] *= if i < S::DIMENSION { self.translation } else { self.rotation };
        }
        pose.retract(t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losing_widens_up_to_everywhere() {
        let noise = MotionNoise { translation: 1e-3, rotation: 0.1 };
        assert_eq!(noise.after_losing(0), noise);
        assert_eq!(noise.after_losing(1), MotionNoise { translation: 0.03, rotation: 0.7 });
        assert_eq!(noise.after_losing(2), MotionNoise { translation: 0.06, rotation: 1.4 });
        let most = MotionNoise { translation: 0.2, rotation: 2.0 };
        assert_eq!(noise.after_losing(u16::MAX), most);
        let huge = MotionNoise { translation: 1.0, rotation: 9.0 };
        assert_eq!(huge.after_losing(1), MotionNoise { translation: 2.0, ..huge });
        assert_eq!(huge.after_losing(5), MotionNoise { translation: 4.0, ..huge });
    }
}
