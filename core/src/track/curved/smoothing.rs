//! What all grasps say of those before: how far contacts are to be trusted, where poses are then most
//! likely, and how far the surface departs from the prior mean.

use super::Curved;
use crate::math;
use crate::space::Space;
use crate::surface::Revisable;

/// Factor on the kernel's amplitude in the beginning, and what its logarithm usually departs from that.
pub(super) const USUAL_ROUGHNESS: f32 = 0.5;
const ROUGHNESS_DEVIATION: f32 = 0.7;

/// Factor between two amplitudes that are compared.
const ROUGHNESS_STEP: f32 = 1.4;

/// Fewer contacts say nothing about the amplitude.
const LEAST_CONTACTS: usize = 8;

/// Contacts of a part that is looked at again, at most.
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
    /// Children become hypotheses: weighed, sorted, without copies and the improbable. The map is brought to
    /// the best.
    pub(super) fn grow(&mut self) {
        core::mem::swap(&mut self.hypotheses, &mut self.children);
        self.count = self.born;
        self.choose();
        self.lay_best();
        self.review(0, self.memory.grasps().len());
        self.temper();
        self.rank();
        self.lay_best();
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
        self.roughen(trial);
        self.lay(0);
        let likelihood = self.evidence_of(0, grasps);
        if !(likelihood + usual(trial) > known) {
            self.rougher = !self.rougher;
            self.roughen(self.roughness);
            self.lay(0);
            return;
        }
        self.roughness = trial;
        for index in (0..self.count).rev() {
            // One alone is laid by the trial.
            if self.count > 1 {
                self.lay(index);
            }
            let evidence = self.evidence_of(index, grasps);
            self.renew(index, evidence);
        }
    }

    /// Looks again at what is thought of some contacts of the first `grasps` grasps of a hypothesis, which
    /// are laid, and are still afterwards; how its evidence changes.
    pub(super) fn review(&mut self, index: usize, grasps: usize) -> f32 {
        let before = self.evidence_of(index, grasps);
        let contacts = self.memory.touches_of(grasps);
        let parts = contacts.div_ceil(DOUBTED).min(usize::from(self.settings.parts));
        let mut changed = false;
        for part in 0..parts {
            let again = doubted(contacts, self.grasps as usize * parts + part);
            let (memory, hypothesis) = (&self.memory, &mut self.hypotheses[index]);
            changed |= self.trajectory.doubt(&self.map, self.settled, memory, hypothesis, again);
        }
        if !changed {
            return 0.0;
        }
        let whole = self.laid;
        self.lay_part(index, grasps);
        self.laid = whole;
        // What it was worth beyond what is remembered, it is still: what settled told hypotheses apart, too.
        let known = self.hypotheses[index].evidence;
        self.renew(index, known + self.evidence_of(index, grasps) - before);
        self.hypotheses[index].evidence - known
    }

    /// Gives a hypothesis whose remembered grasps are laid this evidence, and what it says of their poses.
    fn renew(&mut self, index: usize, evidence: f32) {
        let hypothesis = &mut self.hypotheses[index];
        hypothesis.evidence = if evidence.is_finite() { evidence } else { f32::MIN };
        self.trajectory.settle(&self.map, self.settled, &self.memory, hypothesis);
        hypothesis.covariance = self.trajectory.covariance(&self.map, self.settled);
    }

    /// Log density of the contacts of a hypothesis of which so many grasps are laid, and of where fingers
    /// met nothing.
    pub(super) fn evidence_of(&self, index: usize, grasps: usize) -> f32 {
        let contacts = self.memory.touches_of(grasps);
        let hypothesis = &self.hypotheses[index];
        self.map.log_density_since(self.settled) + hypothesis.price(0..contacts) + hypothesis.free
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
