//! Trajectories that all their grasps agree on: poses move to their posterior mean, and the surface's
//! amplitude to what suits the contacts.

use super::Curved;
use crate::math;
use crate::space::Space;
use crate::surface::Revisable;

/// Poses that lie within this of where everything was made linear (in millimetres and hundredths of a
/// radian) leave it so.
const STILL: f32 = 1.0;

/// Factor on the kernel's amplitude in the beginning, and what its logarithm usually departs from that.
pub(super) const USUAL_ROUGHNESS: f32 = 0.5;
const ROUGHNESS_DEVIATION: f32 = 0.7;

/// Factor between two amplitudes that are compared.
const ROUGHNESS_STEP: f32 = 1.4;

/// Fewer contacts say nothing about the amplitude.
const LEAST_CONTACTS: usize = 8;

/// Contacts whose fit is looked at again in one round, at most.
pub(super) const DOUBTED: usize = 16;

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    /// Children become hypotheses: smoothed, weighed, sorted, without copies and the improbable.
    pub(super) fn grow(&mut self) {
        let laid = self.count.saturating_sub(1);
        core::mem::swap(&mut self.hypotheses, &mut self.children);
        self.count = self.born;
        self.choose();
        if self.count == 1 && usize::from(self.hypotheses[0].parent) == laid {
            // Its parent is laid still.
            self.lay_next(0, self.memory.grasps().len().saturating_sub(1));
            self.map.refit();
            self.smooth(0);
            self.temper();
            return;
        }
        for index in (0..self.count).rev() {
            self.lay(index);
            self.smooth(index);
        }
        self.choose();
        if self.count > 1 {
            self.lay(0);
        }
        self.temper();
    }

    /// How far the object departs from the prior mean is learnt too: a step up or down in amplitude is kept
    /// where it makes the contacts likelier (empirical Bayes, with what suits most objects as
    /// the prior), until the first contacts settle.
    fn temper(&mut self) {
        let (grasps, contacts) = (self.memory.grasps().len(), self.memory.touches().len());
        let due = grasps <= 6 || grasps.is_multiple_of(3);
        if self.settled > 0 || contacts < LEAST_CONTACTS || !due {
            return;
        }
        let known = self.hypotheses[0].evidence + usual(self.roughness);
        let step = if self.rougher { ROUGHNESS_STEP } else { 1.0 / ROUGHNESS_STEP };
        let trial = self.roughness * step;
        self.map.roughen(trial);
        self.lay(0);
        let likelihood = self.map.log_density_since(0) + self.hypotheses[0].price(0..contacts);
        if !(likelihood + usual(trial) > known) {
            self.rougher = !self.rougher;
            self.map.roughen(self.roughness);
            self.lay(0);
            return;
        }
        self.roughness = trial;
        for index in (0..self.count).rev() {
            self.lay(index);
            self.smooth(index);
        }
        self.order();
        self.weigh();
        if self.count > 1 {
            self.lay(0);
        }
    }

    /// Rounds of smoothing of a hypothesis that is laid, and is still afterwards: poses move, and where they
    /// move far everything is made linear anew (Kaess et al. 2012, "iSAM2").
    fn smooth(&mut self, index: usize) {
        let settled = self.settled;
        for round in 0..=self.settings.rounds {
            let hypothesis = &mut self.hypotheses[index];
            let far = self.trajectory.settle(&self.map, settled, &self.memory, hypothesis);
            if round == self.settings.rounds || far < STILL {
                break;
            }
            let turn = self.grasps as usize + usize::from(round);
            let again = doubted(self.memory.touches().len(), turn);
            let hypothesis = &mut self.hypotheses[index];
            self.trajectory.doubt(&self.map, settled, &self.memory, hypothesis, again);
            self.trajectory.relinearise(&self.map, &self.memory, hypothesis);
            self.lay(index);
        }
        let contacts = self.memory.touches().len();
        let hypothesis = &mut self.hypotheses[index];
        hypothesis.evidence =
            self.map.log_density_since(self.settled) + hypothesis.price(0..contacts);
        if !hypothesis.evidence.is_finite() {
            hypothesis.evidence = f32::MIN;
        }
        hypothesis.covariance = self.trajectory.covariance(&self.map, self.settled);
    }
}

/// The contacts whose fit is looked at again: all while they are few, else a part in turn.
pub(super) fn doubted(contacts: usize, turn: usize) -> core::ops::Range<usize> {
    let parts = contacts.div_ceil(DOUBTED).max(1);
    let part = turn % parts;
    part * contacts / parts..(part + 1) * contacts / parts
}

/// Log density of an amplitude's factor, up to a constant.
fn usual(roughness: f32) -> f32 {
    let off = math::ln(roughness / USUAL_ROUGHNESS) / ROUGHNESS_DEVIATION;
    -0.5 * off * off
}
