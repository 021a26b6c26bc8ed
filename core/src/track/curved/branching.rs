//! Which children a grasp gives to the hypotheses, and how likely each makes the grasp.

use super::Curved;
use super::doubt::{Belief, scaled};
use super::proposal::{Candidate, Scene};

use crate::contact::{Contact, GraspView};
use crate::math;
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};
use crate::surface::Revisable;
use crate::track::automatic::log_sum;
use crate::track::likelihood::LEAST_SLOPE;

/// Candidates this many nats below the best of any hypothesis so far are not looked at closely.
const HOPELESS: f32 = 8.0;

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    /// Hypotheses that explain the grasp, as children; the log density of the grasp.
    pub(super) fn branch(&mut self, grasp: &GraspView<'_, S>) -> f32 {
        self.born = 0;
        let Some(new) = self.memory.grasps().len().checked_sub(1) else { return 0.0 };
        let Some(last) = new.checked_sub(1) else { return 0.0 };
        let (mut density, mut number) = (f32::NEG_INFINITY, 0);
        let (mut best, mut mass) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for parent in 0..self.count {
            let mut weight = math::ln(self.hypotheses[parent].weight);
            // The first is laid already.
            if parent > 0 {
                self.lay_part(parent, new);
                weight += self.review(parent, new);
            }
            mass = log_sum(mass, weight);
            let prediction = self.predict(&self.hypotheses[parent], last);
            let scene = Scene {
                map: &self.map,
                touches: self.memory.touches_in(new),
                free: grasp.free,
                prediction,
                middle: self.middle(parent, new),
            };
            let Some(candidates) = scene.propose() else { continue };
            let first = candidates.as_slice().first();
            best = first.map_or(best, |c| math::max(best, weight + c.score));
            let hopeful = |c: &&Candidate<S>| weight + c.score >= best - HOPELESS;
            for (rank, candidate) in candidates.as_slice().iter().take_while(hopeful).enumerate() {
                if rank > 0 {
                    self.lift(new);
                }
                number += 1;
                let fit = self.bear(parent, new, candidate, number);
                density = log_sum(density, weight + fit);
            }
        }
        density - mass
    }

    /// Centroid of a hypothesis' contacts before grasp `new`, object frame.
    #[inline(never)]
    pub(super) fn middle(&self, parent: usize, new: usize) -> S::Vector {
        let (mut sum, mut count) = (S::Vector::ZERO, 0.0);
        for (grasp, pose) in self.memory.grasps()[..new].iter().zip(&self.hypotheses[parent].poses)
        {
            for touch in &self.memory.touches()[grasp.touches()] {
                sum += pose.untransform(touch.point);
                count += 1.0;
            }
        }
        if count > 0.0 { sum * (1.0 / count) } else { S::Vector::ZERO }
    }

    /// Makes the child of a parent (which is laid) that has the new grasp at the candidate, and leaves it
    /// laid; the log density of the grasp there, as [`Evidence`](crate::track::automatic::Evidence) has it.
    fn bear(&mut self, parent: usize, new: usize, candidate: &Candidate<S>, number: u16) -> f32 {
        let contacts = self.memory.grasps()[new].touches();
        let rows = self.map.rows();
        self.hypotheses[parent].about[new] = candidate.pose;
        for index in contacts.clone() {
            let contact = self.memory.touches()[index].seen_from(&candidate.pose);
            self.hypotheses[parent].beliefs[index] = Belief::new(self.map.bend(contact.point));
        }
        let mut unmeasured = self.unmeasured(parent, new);
        self.lay_next(parent, new);
        let mut gained = self.map.log_density_since(rows);
        self.map.refit();
        let (memory, hypothesis) = (&self.memory, &mut self.hypotheses[parent]);
        if self.trajectory.doubt(&self.map, self.settled, memory, hypothesis, contacts.clone()) {
            let price = hypothesis.price(contacts);
            self.lift(new);
            unmeasured = self.unmeasured(parent, new);
            self.lay_next(parent, new);
            gained = self.map.log_density_since(rows) + price;
            self.map.refit();
        }
        self.laid = number;
        gained += candidate.free;
        let evidence = self.hypotheses[parent].evidence + gained;
        if evidence.is_finite()
            && let Some(slot) = self.cradle(evidence)
        {
            self.children[slot] = self.hypotheses[parent];
            let child = &mut self.children[slot];
            (child.evidence, child.number) = (evidence, number);
            child.free += candidate.free;
            self.trajectory.settle(&self.map, self.settled, &self.memory, child);
            child.covariance = self.trajectory.covariance(&self.map, self.settled);
        }
        gained - unmeasured
    }

    /// What the model's density of a hypothesis' new grasp will say beyond distances and angles; the grasps
    /// before are laid.
    fn unmeasured(&self, index: usize, new: usize) -> f32 {
        let hypothesis = &self.hypotheses[index];
        let touches = self.memory.grasps()[new].touches();
        let part = |index: usize| {
            let touch = scaled(&self.memory.touches()[index], &hypothesis.beliefs[index]);
            steepness::<S>(&self.map, &touch.seen_from(&hypothesis.about[new]))
        };
        touches.map(part).sum()
    }

    /// The place for a child of this evidence: a free one, or that of the worst if it is worse.
    fn cradle(&mut self, evidence: f32) -> Option<usize> {
        if self.born < HYPOTHESES {
            self.born += 1;
            return Some(self.born - 1);
        }
        let (mut worst, mut least) = (None, evidence);
        for (slot, child) in self.children.iter().enumerate() {
            if child.evidence < least {
                (worst, least) = (Some(slot), child.evidence);
            }
        }
        worst
    }
}

/// What the model's density of a contact says beyond distance and angle ([`crate::track::automatic`]): the
/// length of the gradient along the felt normal, which nothing measured, and the scale of f.
fn steepness<S: Space>(map: &impl Revisable<S>, contact: &Contact<S>) -> f32 {
    const HALF_LN_TAU: f32 = 0.918_938_5;
    let probe = map.probe(contact.point);
    let slope = math::max(probe.gradient.norm(), LEAST_SLOPE);
    let Some(normal) = contact.normal else { return -math::ln(slope) };
    let variance = contact.normal_deviation * contact.normal_deviation + probe.slope_variance;
    let off = 1.0 - probe.gradient.dot(normal);
    -0.5 * (off * off / variance + math::ln(variance)) - HALF_LN_TAU - math::ln(slope)
}
