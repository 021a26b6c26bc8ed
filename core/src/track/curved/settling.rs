//! The oldest grasps leave the memory: their contacts go to the map for good.

use super::Curved;
use super::doubt::scaled;
use crate::matrix::Square;
use crate::space::Space;
use crate::surface::Revisable;
use crate::track::blurred::blurred;

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    /// Makes room for a grasp of so many contacts: the oldest are settled as the best hypothesis has them.
    pub(super) fn make_room(&mut self, contacts: usize) -> u16 {
        let mut dropped = 0u16;
        while self.memory.grasps().len() > 1 && !self.memory.has_room(contacts) {
            dropped = dropped.saturating_add(self.settle_oldest());
        }
        dropped
    }

    fn settle_oldest(&mut self) -> u16 {
        let Some(oldest) = self.memory.grasps().first().copied() else { return 0 };
        let before = self.map.contacts();
        // Its pose given everything: what the trajectory says of it when it is the last.
        self.lay(0);
        let mut covariance = S::Covariance::ZERO;
        if self.based {
            // The later grasps' knowledge is left out, which makes it too uncertain rather than too sure.
            self.lift(1);
            covariance = self.trajectory.covariance(&self.map, self.settled);
        }
        self.map.withdraw(self.settled);
        self.trajectory.clear();
        let best = &self.hypotheses[0];
        let pose = best.poses[0];
        for index in oldest.touches() {
            let (touch, belief) = (&self.memory.touches()[index], &best.beliefs[index]);
            let contact = scaled(touch, belief).seen_from(&pose);
            self.map.settle(&blurred(&contact, &covariance), CONTACTS);
        }
        self.settled = self.map.rows();
        let gone = self.memory.forget_oldest();
        (self.base, self.based) = (covariance, true);
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.base = hypothesis.poses[0];
            hypothesis.poses.copy_within(1.., 0);
            hypothesis.about.copy_within(1.., 0);
            hypothesis.beliefs.copy_within(gone.., 0);
        }
        self.lay(0);
        // From here on evidence is of what is still remembered, and hypotheses are as far apart as before.
        let less = self.evidence_of(0, self.memory.grasps().len()) - self.hypotheses[0].evidence;
        if less.is_finite() {
            for hypothesis in &mut self.hypotheses[..self.count] {
                hypothesis.evidence += less;
            }
        }
        (before.saturating_sub(self.map.contacts())) as u16
    }
}
