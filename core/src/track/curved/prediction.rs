//! What happened since the last remembered grasp, and where that leads.

use super::Curved;
use super::memory::{Drift, Move};
use super::proposal::Prediction;
use super::trajectory::Hypothesis;
use crate::contact::GraspView;
use crate::math;
use crate::matrix::{Coordinates, Square};
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
            None => self.settings.of_unknown(),
        };
        self.widen(&noise);
    }

    /// Motion has a second, rare component: the object slipped who knows how far. One that is touched far from
    /// there was put where it is touched; the log density of that, over one that it slipped.
    #[inline(never)]
    pub(super) fn slip(&mut self, grasp: &GraspView<'_, S>) -> f32 {
        let unknown = self.settings.of_unknown();
        self.widen(&unknown);
        self.slipped = true;
        let Some(last) = self.memory.grasps().len().checked_sub(1) else { return 0.0 };
        let Some(felt) = grasp.centroid() else { return 0.0 };
        let before = self.hypotheses[0].poses[last].transform(self.middle(0, last + 1));
        let off = felt - self.pending.motion.transform(before);
        let far = off.norm() / (2.0 * unknown.translation);
        if !(far > 1.0) {
            return 0.0;
        }
        self.pending.motion = S::Pose::from_translation(off).compose(&self.pending.motion);
        // A normal density as wide as it was put away, at two deviations, over that of a slip at its middle.
        -(S::DIMENSION as f32) * math::ln(far) - 2.0
    }

    fn widen(&mut self, noise: &MotionNoise) {
        let most = &self.settings.of_unknown();
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
