//! Curved objects: a few trajectories over one Gaussian-process surface.
//!
//! A curved object shows no faces that could be told apart, only a surface that all contacts share. Every
//! hypothesis is a trajectory, the poses of all remembered grasps, about which surface and poses are
//! one linear Gaussian model (see [`crate::surface::revisable`]): the kernel couples contacts through
//! the surface, the motion couples grasps. One factorisation then gives the surface with all poses
//! marginalised, the poses with the surface marginalised, and the evidence of the trajectory. A grasp is
//! learnt in four steps:
//!
//! 1. *Propose*: from several starts across what the motion leaves open, Gauss–Newton steps on the
//!    calibrated distance and normal of every contact (Laplace approximation).
//! 2. *Judge*: every proposal's grasp is appended to the hypothesis' model, whose log density, correlations
//!    through surface and motion included, is its weight.
//! 3. *Smooth*: all remembered poses move to their posterior mean, so that what was placed wrongly in the
//!    beginning, when a ball was all that was known, is repaired later; contacts that the others
//!    contradict lose trust.
//! 4. *Choose*: equal trajectories are one, improbable ones go, a few stay.
//!
//! When memory is full the oldest grasp is settled: its contacts go to the map for good where the best
//! hypothesis has them, and the map's own policy bounds what they take. A grasp that wild contacts
//! explain better than the surface does is not learnt; the next ones are searched for all around.
//!
//! Thesis 3.3.1 follows the pose over a surface that is never revised. The smoothing is that of the
//! Gaussian-process latent variable model (Lawrence 2005) with the motion as the latent prior.

mod memory;
mod proposal;
mod small;
mod trajectory;

use crate::contact::{Contact, GraspView};
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::Revisable;
use crate::track::automatic::{Evidence, log_sum, wild};
use crate::track::likelihood::LEAST_SLOPE;
use crate::track::{Estimate, Modes, MotionNoise, Observability, Separation, Status, Tracker};
use memory::{Drift, Memory, Move};
use proposal::{Candidate, Prediction, Scene};
use trajectory::{Belief, Hypothesis, Trajectory};

/// How a [`Curved`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motion noise of one grasp.
    pub motion: MotionNoise,
    /// How far the object may have moved when nobody knows, or after it was lost.
    pub unknown: MotionNoise,
    /// Hypotheses this many nats below the best are dropped.
    pub prune: f32,
    /// Rounds of smoothing per grasp.
    pub rounds: u8,
}

impl Settings {
    /// The thesis' motion noise; 50 mm and a radian when unknown.
    pub const DEFAULT: Self = Settings {
        motion: MotionNoise::THESIS,
        unknown: MotionNoise { translation: 0.05, rotation: 1.0 },
        prune: 10.0,
        rounds: 3,
    };
}

/// At most `HYPOTHESES` trajectories of the last `GRASPS` grasps and `CONTACTS` contacts over the map
/// `M`, of which `ROWS` rows hold them: as many as the map has is always enough. The map must hold
/// `CONTACTS` contacts and, for longer logs, those that settle.
#[derive(Clone, Debug)]
pub struct Curved<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> {
    map: M,
    memory: Memory<S, GRASPS, CONTACTS>,
    hypotheses: [Hypothesis<S, GRASPS, CONTACTS>; HYPOTHESES],
    children: [Hypothesis<S, GRASPS, CONTACTS>; HYPOTHESES],
    count: usize,
    born: usize,
    trajectory: Trajectory<S, GRASPS, CONTACTS, ROWS>,
    /// Zero until the first use, so that a new tracker is all zero bits.
    settings: Settings,
    configured: bool,
    /// What happened since the last remembered grasp.
    pending: Move<S>,
    /// Rows of the map that are settled, and the covariance of the pose before the oldest grasp.
    settled: usize,
    base: S::Covariance,
    based: bool,
    started: bool,
    /// Factor on the kernel's amplitude, and whether a greater one is tried next.
    roughness: f32,
    rougher: bool,
    grasps: u32,
    /// Cumulative log density of the grasps, nats.
    evidence: f32,
}

/// Poses of a hypothesis that differ by less in every grasp make it a copy.
const COPY: Separation = Separation { translation: 0.002, rotation: 0.035 };

/// A second answer of at least this share makes the belief ambiguous.
const AMBIGUOUS: f32 = 0.2;

/// How often the object moves as if nobody knew how.
const SLIP: f32 = 0.03;

/// Candidates this many nats below the best are not looked at closely.
const HOPELESS: f32 = 12.0;

/// Poses that lie within this of where everything was made linear (in millimetres and hundredths of a
/// radian) leave it so.
const STILL: f32 = 1.0;

/// Factor on the kernel's amplitude in the beginning, and what its logarithm usually departs from that.
const USUAL_ROUGHNESS: f32 = 0.5;
const ROUGHNESS_DEVIATION: f32 = 0.7;

/// Factor between two amplitudes that are compared.
const ROUGHNESS_STEP: f32 = 1.4;

/// Fewer contacts say nothing about the amplitude.
const LEAST_CONTACTS: usize = 8;

/// Contacts whose fit is looked at again in one round.
const DOUBTED: usize = 24;

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    const SIZES_FIT: () = assert!(HYPOTHESES > 0, "at least one hypothesis");

    /// A tracker over an empty `map`, with [`Settings::DEFAULT`].
    pub const fn new(map: M) -> Self {
        let () = Self::SIZES_FIT;
        Curved {
            map,
            memory: Memory::new(),
            hypotheses: [const { Hypothesis::UNSET }; HYPOTHESES],
            children: [const { Hypothesis::UNSET }; HYPOTHESES],
            count: 0,
            born: 0,
            trajectory: Trajectory::new(),
            settings: Settings {
                motion: MotionNoise { translation: 0.0, rotation: 0.0 },
                unknown: MotionNoise { translation: 0.0, rotation: 0.0 },
                prune: 0.0,
                rounds: 0,
            },
            configured: false,
            pending: Move { motion: S::Pose::UNSET, drift: Drift::NONE },
            settled: 0,
            base: S::Covariance::ZERO,
            based: false,
            started: false,
            roughness: 0.0,
            rougher: false,
            grasps: 0,
            evidence: 0.0,
        }
    }

    /// Starts anew with these settings.
    pub fn configure(&mut self, settings: Settings) {
        self.settings = settings;
        self.configured = true;
        self.map.clear();
        self.memory.clear();
        (self.count, self.born, self.settled) = (0, 0, 0);
        self.pending = Move { motion: S::Pose::IDENTITY, drift: Drift::NONE };
        self.base = S::Covariance::ZERO;
        (self.based, self.started) = (false, false);
        (self.grasps, self.evidence) = (0, 0.0);
        (self.roughness, self.rougher) = (USUAL_ROUGHNESS, false);
        self.map.roughen(self.roughness);
    }

    /// The shape so far, as the best hypothesis has it.
    pub fn map(&self) -> &M {
        &self.map
    }

    /// The shape, to set its model; call [`configure`](Self::configure) afterwards.
    pub fn map_mut(&mut self) -> &mut M {
        &mut self.map
    }

    /// Number of hypotheses held.
    pub fn hypotheses(&self) -> usize {
        self.count
    }

    fn base(&self) -> Option<S::Covariance> {
        self.based.then_some(self.base)
    }

    /// Fixes the object frame at the centroid of the first contacts.
    fn start(&mut self, grasp: &GraspView<'_, S>) -> u16 {
        let (mut centroid, mut count) = (S::Vector::ZERO, 0.0);
        for contact in good(grasp) {
            centroid += contact.point;
            count += 1.0;
        }
        let centroid = centroid * (1.0 / count);
        let none = Move { motion: S::Pose::IDENTITY, drift: Drift::NONE };
        let dropped = self.memory.push(self.grasps, none, grasp);
        let first = &mut self.hypotheses[0];
        let pose = S::Pose::from_translation(centroid);
        (first.poses[0], first.about[0], first.base) = (pose, pose, pose);
        (first.covariance, first.evidence, first.weight) = (S::Covariance::ZERO, 0.0, 1.0);
        for (belief, touch) in first.beliefs.iter_mut().zip(self.memory.touches()) {
            // Nothing depends on it: this pose has no error.
            let gradient = touch.direction().unwrap_or(S::Vector::ZERO);
            *belief =
                Belief::new(crate::surface::Bend { gradient, curvature: [S::Vector::ZERO; 3] });
        }
        self.count = 1;
        self.started = true;
        self.lay(0);
        dropped
    }

    /// Brings the map to a hypothesis.
    fn lay(&mut self, index: usize) {
        self.lay_part(index, self.memory.grasps().len());
    }

    /// Its first grasps only.
    fn lay_part(&mut self, index: usize, grasps: usize) {
        let base = self.base();
        let hypothesis = &self.hypotheses[index];
        let memory = &self.memory;
        self.trajectory.place(
            &mut self.map,
            self.settled,
            base.as_ref(),
            memory,
            hypothesis,
            grasps,
        );
    }

    /// One grasp more of it.
    fn lay_next(&mut self, index: usize, grasp: usize) {
        let base = self.base();
        let hypothesis = &self.hypotheses[index];
        let memory = &self.memory;
        self.trajectory.append(
            &mut self.map,
            self.settled,
            base.as_ref(),
            memory,
            hypothesis,
            grasp,
        );
    }

    /// Takes back its grasps from this one on.
    fn lift(&mut self, grasp: usize) {
        self.trajectory.withdraw(&mut self.map, self.settled, &self.memory, grasp);
        self.map.refit();
    }

    /// Moves on: what happened since the last remembered grasp.
    fn move_on(&mut self, motion: Option<&S::Pose>) {
        let motion = motion.filter(|m| m.is_finite());
        let noise = match motion {
            Some(motion) => {
                self.pending.motion = motion.compose(&self.pending.motion);
                self.settings.motion
            }
            None => self.settings.unknown,
        };
        self.widen(&noise);
    }

    fn widen(&mut self, noise: &MotionNoise) {
        let most = &self.settings.unknown;
        let drift = &mut self.pending.drift;
        // Beyond twice what unknown motion allows, all places are alike.
        let most_shift = math::max(
            4.0 * most.translation * most.translation,
            noise.translation * noise.translation,
        );
        let most_turn =
            math::max(4.0 * most.rotation * most.rotation, noise.rotation * noise.rotation);
        drift.translation =
            math::min(drift.translation + noise.translation * noise.translation, most_shift);
        drift.rotation = math::min(drift.rotation + noise.rotation * noise.rotation, most_turn);
    }

    /// Where a hypothesis expects the object now.
    fn predict(&self, hypothesis: &Hypothesis<S, GRASPS, CONTACTS>, last: usize) -> Prediction<S> {
        let pose = self.pending.motion.compose(&hypothesis.poses[last]);
        let mut covariance = hypothesis.covariance;
        for axis in 0..S::FREEDOM {
            *covariance.at_mut(axis, axis) += self.pending.drift.along::<S>(axis) + 1e-9;
        }
        Prediction { pose, covariance }
    }

    /// Makes room for a grasp of so many contacts: the oldest are settled as the best hypothesis has them.
    fn make_room(&mut self, contacts: usize) -> u16 {
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
        let best = &self.hypotheses[0];
        let pose = best.about[0];
        for index in oldest.touches() {
            let (touch, belief) = (&self.memory.touches()[index], &best.beliefs[index]);
            let contact = trajectory::scaled(touch, belief).seen_from(&pose);
            self.map.settle(&blurred(&contact, &covariance), CONTACTS);
        }
        self.settled = self.map.rows();
        let gone = self.memory.forget_oldest();
        (self.base, self.based) = (covariance, true);
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.base = hypothesis.about[0];
            hypothesis.poses.copy_within(1.., 0);
            hypothesis.about.copy_within(1.., 0);
            hypothesis.beliefs.copy_within(gone.., 0);
        }
        self.lay(0);
        (before.saturating_sub(self.map.contacts())) as u16
    }

    /// Hypotheses that explain the grasp, as children; the log density of the grasp.
    fn branch(&mut self, grasp: &GraspView<'_, S>) -> f32 {
        self.born = 0;
        let Some(new) = self.memory.grasps().len().checked_sub(1) else { return 0.0 };
        let Some(last) = new.checked_sub(1) else { return 0.0 };
        let mut density = f32::NEG_INFINITY;
        for parent in 0..self.count {
            // The first is laid already.
            if parent > 0 {
                self.lay_part(parent, new);
            }
            let prediction = self.predict(&self.hypotheses[parent], last);
            let touches = self.memory.grasps()[new].touches();
            let scene = Scene {
                map: &self.map,
                touches: &self.memory.touches()[touches],
                free: grasp.free,
                prediction,
                middle: self.middle(parent, new),
            };
            let Some(candidates) = scene.propose() else { continue };
            let best = candidates.as_slice().first().map_or(0.0, |c| c.score);
            for candidate in candidates.as_slice() {
                if candidate.score < best - HOPELESS {
                    break;
                }
                let fit = self.bear(parent, new, candidate);
                let weight = math::ln(self.hypotheses[parent].weight);
                density = log_sum(density, weight + fit);
            }
        }
        density
    }

    /// Centroid of a hypothesis' contacts before grasp `new`, object frame.
    fn middle(&self, parent: usize, new: usize) -> S::Vector {
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

    /// Makes the child of a parent (which is laid) that has the new grasp at the candidate; the log density
    /// of the grasp there, as [`Evidence`] has it.
    fn bear(&mut self, parent: usize, new: usize, candidate: &Candidate<S>) -> f32 {
        let contacts = self.memory.grasps()[new].touches();
        let rows = self.map.rows();
        self.hypotheses[parent].about[new] = candidate.pose;
        for index in contacts.clone() {
            let contact = self.memory.touches()[index].seen_from(&candidate.pose);
            self.hypotheses[parent].beliefs[index] = Belief::new(self.map.bend(contact.point));
        }
        self.lay_next(parent, new);
        let mut gained = self.map.log_density_since(rows);
        self.map.refit();
        let (memory, hypothesis) = (&self.memory, &mut self.hypotheses[parent]);
        if self.trajectory.doubt(&self.map, self.settled, memory, hypothesis, contacts.clone()) {
            let price = hypothesis.price(contacts);
            self.lift(new);
            self.lay_next(parent, new);
            gained = self.map.log_density_since(rows) + price;
            self.map.refit();
        }
        let evidence = self.hypotheses[parent].evidence + gained;
        if evidence.is_finite()
            && let Some(slot) = self.cradle(evidence)
        {
            self.children[slot] = self.hypotheses[parent];
            let child = &mut self.children[slot];
            (child.evidence, child.parent) = (evidence, parent as u16);
            self.trajectory.settle(&self.map, self.settled, &self.memory, child);
        }
        self.lift(new);
        let contacts = self.memory.grasps()[new].touches();
        let (touches, beliefs) = (self.memory.touches(), &self.hypotheses[parent].beliefs);
        let unmeasured = |index: usize| {
            let touch = trajectory::scaled(&touches[index], &beliefs[index]);
            steepness::<S>(&self.map, &touch.seen_from(&candidate.pose))
        };
        gained - contacts.map(unmeasured).sum::<f32>()
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

    /// Children become hypotheses: smoothed, weighed, sorted, without copies and the improbable.
    fn grow(&mut self) {
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

    /// Sorts and weighs, drops copies and the improbable.
    fn choose(&mut self) {
        self.order();
        self.forget_copies();
        self.weigh();
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
            let again = self.doubted();
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

    /// The contacts whose fit is looked at again: all while they are few, else a part in turn.
    fn doubted(&self) -> core::ops::Range<usize> {
        let contacts = self.memory.touches().len();
        let parts = contacts.div_ceil(DOUBTED).max(1);
        let part = self.grasps as usize % parts;
        part * contacts / parts..(part + 1) * contacts / parts
    }

    /// Best first: insertion sort of a handful.
    fn order(&mut self) {
        for i in 1..self.count {
            let mut j = i;
            while j > 0 && self.hypotheses[j].evidence > self.hypotheses[j - 1].evidence {
                exchange(&mut self.hypotheses, j - 1, j);
                j -= 1;
            }
        }
    }

    /// Of trajectories that are the same only the best stays.
    fn forget_copies(&mut self) {
        let grasps = self.memory.grasps().len();
        let mut kept = 0;
        for index in 0..self.count {
            let (before, rest) = self.hypotheses.split_at(index);
            let Some(this) = rest.first() else { break };
            let copy = before[..kept].iter().any(|other| {
                let poses = this.poses[..grasps].iter().zip(&other.poses);
                poses.into_iter().all(|(a, b)| COPY.between::<S>(a, b) < 1.0)
            });
            if !copy {
                exchange(&mut self.hypotheses, kept, index);
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Weights from evidence; the improbable go.
    fn weigh(&mut self) {
        let Some(best) = self.hypotheses[..self.count].first().map(|h| h.evidence) else { return };
        let limit = best - self.settings.prune;
        self.count =
            self.hypotheses[..self.count].iter().take_while(|h| h.evidence >= limit).count();
        let mut total = 0.0;
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.weight = math::exp(hypothesis.evidence - best);
            total += hypothesis.weight;
        }
        for hypothesis in &mut self.hypotheses[..self.count] {
            hypothesis.weight *= 1.0 / total;
        }
    }

    /// What is believed of the pose now, `predicted` from the last remembered grasp or at it.
    fn belief(&self, predicted: bool) -> (S::Pose, S::Covariance, Modes<S>, f32) {
        let Some(last) = self.memory.grasps().len().checked_sub(1) else {
            return (S::Pose::IDENTITY, S::Covariance::ZERO, Modes::one(S::Pose::IDENTITY), 1.0);
        };
        let at = |h: &Hypothesis<S, GRASPS, CONTACTS>| {
            if predicted {
                self.predict(h, last)
            } else {
                Prediction { pose: h.poses[last], covariance: h.covariance }
            }
        };
        let all = || self.hypotheses[..self.count].iter();
        let modes = Modes::of(all().map(|h| (h.weight, at(h).pose)), &Separation::DEFAULT);
        let best = at(&self.hypotheses[0]);
        let mut covariance = S::Covariance::ZERO;
        let mut squares = 0.0;
        for hypothesis in all() {
            let Prediction { pose, covariance: own } = at(hypothesis);
            let apart = best.pose.local(&pose);
            for i in 0..S::FREEDOM {
                for j in 0..S::FREEDOM {
                    *covariance.at_mut(i, j) += hypothesis.weight * own.at(i, j);
                }
            }
            covariance.add_outer(hypothesis.weight, apart, apart);
            squares += hypothesis.weight * hypothesis.weight;
        }
        (best.pose, covariance, modes, if squares > 0.0 { 1.0 / squares } else { 1.0 })
    }

    /// Whether the grasp was explained better than by wild contacts.
    fn is_found(&self, density: f32, nowhere: f32) -> bool {
        self.born > 0 && density > nowhere
    }

    /// One grasp with contacts: what became of it, and how many contacts found no room.
    fn learn(&mut self, grasp: &GraspView<'_, S>, contacts: usize) -> (Status, u16) {
        let mut dropped = self.make_room(contacts);
        dropped = dropped.saturating_add(self.memory.push(self.grasps, self.pending, grasp));
        let nowhere: f32 = good(grasp).map(|c| wild(&c)).sum();
        let mut density = math::ln(1.0 - SLIP) + self.branch(grasp);
        if !self.is_found(density, nowhere) {
            // Motion has a second, rare component: the object slipped who knows how far.
            self.memory.pop();
            let unknown = self.settings.unknown;
            self.widen(&unknown);
            self.memory.push(self.grasps, self.pending, grasp);
            self.lay_part(0, self.memory.grasps().len().saturating_sub(1));
            density = math::ln(SLIP) + self.branch(grasp);
        }
        if !self.is_found(density, nowhere) {
            self.evidence += nowhere;
            self.memory.pop();
            self.lay(0);
            return (Status::Lost, dropped);
        }
        self.evidence += density;
        self.grow();
        self.pending = Move { motion: S::Pose::IDENTITY, drift: Drift::NONE };
        (Status::Tracking, dropped)
    }
}

/// The contacts of a grasp that can be used, with unit normals.
fn good<'a, S: Space>(grasp: &GraspView<'a, S>) -> impl Iterator<Item = Contact<S>> + Clone + 'a {
    grasp.contacts.iter().filter_map(|c| c.checked().ok())
}

/// Log density of an amplitude's factor, up to a constant.
fn usual(roughness: f32) -> f32 {
    let off = math::ln(roughness / USUAL_ROUGHNESS) / ROUGHNESS_DEVIATION;
    -0.5 * off * off
}

/// Swaps two hypotheses of which `before` comes first, without a third on the stack.
fn exchange<H>(hypotheses: &mut [H], before: usize, after: usize) {
    if before < after && after < hypotheses.len() {
        let (head, tail) = hypotheses.split_at_mut(after);
        core::mem::swap(&mut head[before], &mut tail[0]);
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

/// The contact (object frame) with the doubt about its pose in its noise, as far as it has a normal.
fn blurred<S: Space>(contact: &Contact<S>, covariance: &S::Covariance) -> Contact<S> {
    let Some(normal) = contact.normal else { return *contact };
    let h = S::lever(contact.point, normal);
    let along = h.dot(small::times::<S>(covariance, h));
    let turns = (S::DIMENSION..S::FREEDOM).map(|i| covariance.at(i, i)).sum::<f32>();
    let turn = turns / (S::FREEDOM - S::DIMENSION) as f32;
    let add = |deviation: f32, more: f32| math::sqrt(deviation * deviation + math::max(more, 0.0));
    Contact {
        point_deviation: add(contact.point_deviation, along),
        normal_deviation: add(contact.normal_deviation, turn),
        ..*contact
    }
}

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Tracker<S> for Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        if !self.configured {
            self.configure(Settings::DEFAULT);
        }
        let contacts = good(&grasp).count();
        let begun = self.started;
        if begun {
            self.move_on(motion);
        }
        let (mut status, dropped) = match (begun, contacts) {
            (false, 0) => (Status::Started, 0),
            (false, _) => (Status::Started, self.start(&grasp)),
            (true, 0) => (Status::Predicted, 0),
            (true, _) => self.learn(&grasp, contacts),
        };
        let corrected = status == Status::Tracking;
        let (pose, covariance, modes, effective_particles) = self.belief(begun && !corrected);
        if corrected && modes.disagree(AMBIGUOUS) {
            status = Status::Ambiguous;
        }
        let felt = good(&grasp)
            .filter_map(|c| Some((pose.untransform(c.point), pose.unrotate(c.normal?))));
        let estimate = Estimate {
            grasp: self.grasps,
            pose,
            covariance,
            status,
            modes,
            effective_particles,
            observability: Observability::of(felt),
            contacts: contacts.min(usize::from(u16::MAX)) as u16,
            rejected: (grasp.contacts.len() - contacts).min(usize::from(u16::MAX)) as u16,
            dropped,
            corrected,
            resampled: false,
        };
        self.grasps = self.grasps.saturating_add(1);
        estimate
    }

    /// The seed has no part in it: nothing is drawn.
    fn reset(&mut self, _seed: u64) {
        self.configure(if self.configured { self.settings } else { Settings::DEFAULT });
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        if !self.configured {
            self.configure(Settings::DEFAULT);
        }
        self.settings.motion = noise;
    }

    fn recall(&self, grasp: u32) -> Option<S::Pose> {
        let place = self.memory.grasps().iter().position(|g| g.number == grasp)?;
        self.hypotheses.first().map(|best| best.poses[place])
    }
}

impl<
    S: Space,
    M: Revisable<S>,
    const HYPOTHESES: usize,
    const GRASPS: usize,
    const CONTACTS: usize,
    const ROWS: usize,
> Evidence<S> for Curved<S, M, HYPOTHESES, GRASPS, CONTACTS, ROWS>
{
    fn evidence(&self) -> f32 {
        self.evidence
    }
}

#[cfg(test)]
mod tests;
