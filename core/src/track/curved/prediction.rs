//! What happened since the last remembered grasp, and where that leads.

use super::Curved;
use super::memory::{Drift, Move};
use super::proposal::Prediction;
use super::trajectory::Hypothesis;
use crate::math;
use crate::matrix::Square;
use crate::space::{Pose, Space};
use crate::surface::Revisable;
use crate::track::{MotionNoise, is_plausible};

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    /// Nothing has happened since the last remembered grasp.
    pub(super) fn rest(&mut self) {
        self.pending = Move { motion: S::Pose::IDENTITY, drift: Drift::NONE };
        self.slipped = false;
    }

    /// Moves on: what happened since the last remembered grasp.
    pub(super) fn move_on(&mut self, motion: Option<&S::Pose>) {
        let motion = motion.filter(|m| is_plausible::<S>(m));
        let noise = match motion {
            Some(motion) => {
                self.pending.motion = motion.compose(&self.pending.motion);
                self.settings.motion
            }
            None => self.settings.unknown,
        };
        self.widen(&noise);
    }

    /// Motion has a second, rare component: the object slipped who knows how far.
    pub(super) fn slip(&mut self) {
        let unknown = self.settings.unknown;
        self.widen(&unknown);
        self.slipped = true;
    }

    fn widen(&mut self, noise: &MotionNoise) {
        let most = &self.settings.unknown;
        let drift = &mut self.pending.drift;
        // Beyond twice what unknown motion allows, or this one, all places are alike.
        let add = |drift: f32, noise: f32, most: f32| {
            let most = 2.0 * math::max(noise, most);
            math::min(drift + noise * noise, most * most)
        };
        drift.translation = add(drift.translation, noise.translation, most.translation);
        drift.rotation = add(drift.rotation, noise.rotation, most.rotation);
    }

    /// Where a hypothesis expects the object now.
    pub(super) fn predict(
        &self,
        hypothesis: &Hypothesis<S, GRASPS, CONTACTS>,
        last: usize,
    ) -> Prediction<S> {
        let pose = self.pending.motion.compose(&hypothesis.poses[last]);
        let mut covariance = hypothesis.covariance;
        for axis in 0..S::FREEDOM {
            *covariance.at_mut(axis, axis) += self.pending.drift.along::<S>(axis) + 1e-9;
        }
        Prediction { pose, covariance }
    }
}
