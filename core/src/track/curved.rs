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
//!    beginning, when a ball was all that was known, is repaired later.
//! 4. *Choose*: equal trajectories are one, improbable ones go, a few stay. Contacts that the others
//!    contradict lose trust.
//!
//! Every grasp stays linear about where it was proposed. Making all of them linear anew about the smoothed
//! poses (Kaess et al. 2012, "iSAM2") gains nothing on ellipses and ellipsoids, and where an object slides
//! under the fingers, as a cylinder does about its axis, poses go back and forth by 0.2 rad.
//!
//! When memory is full the oldest grasp is settled: its contacts go to the map for good where the best
//! hypothesis has them, and the map's own policy bounds what they take.
//!
//! A grasp that wild contacts explain better than the surface does is sought wherever the object may have
//! slipped to; what is found there is [ambiguous](Status::Ambiguous) until the next grasp agrees. A
//! grasp that is not found is not learnt, and the next ones are searched for all around.
//!
//! Thesis 3.3.1 follows the pose over a surface that is never revised. The smoothing is that of the
//! Gaussian-process latent variable model (Lawrence 2005) with the motion as the latent prior.

mod branching;
mod choice;
mod doubt;
mod memory;
mod prediction;
mod proposal;
mod settling;
mod small;
mod smoothing;
mod trajectory;

use crate::contact::GraspView;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::Revisable;
use crate::track::automatic::{Evidence, all_short_by, all_wild};
use crate::track::{Estimate, Modes, MotionNoise, Separation, Status, Tracker};
use doubt::Belief;
use memory::{Drift, Memory, Move};
use proposal::Prediction;
use smoothing::USUAL_ROUGHNESS;
use trajectory::{Hypothesis, Trajectory};

/// How a [`Curved`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motion noise of one grasp.
    pub motion: MotionNoise,
    /// How far the object may have moved when nobody knows, or after it was lost; twice the motion noise where that is
    /// more.
    pub unknown: MotionNoise,
    /// Hypotheses this many nats below the best are dropped.
    pub prune: f32,
    /// How many parts of the remembered contacts, of at most sixteen each, are compared with what the others
    /// say after each grasp, in turn.
    pub parts: u8,
}

impl Settings {
    /// The thesis' motion noise; 50 mm and a radian when unknown.
    pub const DEFAULT: Self = Settings {
        motion: MotionNoise::THESIS,
        unknown: MotionNoise { translation: 0.05, rotation: 1.0 },
        prune: 10.0,
        parts: 3,
    };

    /// How far the object may have moved when nobody knows: as said, and no less than every tracker takes it for.
    fn of_unknown(&self) -> MotionNoise {
        let twice = self.motion.of(false);
        MotionNoise {
            translation: math::max(self.unknown.translation, twice.translation),
            rotation: math::max(self.unknown.rotation, twice.rotation),
        }
    }
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
    /// [`Hypothesis::number`] of the one that the map is brought to; zero while it is none whole.
    laid: u16,
    trajectory: Trajectory<S, GRASPS, CONTACTS, ROWS>,
    /// Zero until the first use, so that a new tracker is all zero bits.
    settings: Settings,
    configured: bool,
    /// What happened since the last remembered grasp, and whether that takes in a slip.
    pending: Move<S>,
    slipped: bool,
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

/// A second answer of at least this share makes the belief ambiguous.
const AMBIGUOUS: f32 = 0.2;

/// How often the object moves as if nobody knew how.
const SLIP: f32 = 0.03;

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
            laid: 0,
            trajectory: Trajectory::new(),
            settings: Settings {
                motion: MotionNoise { translation: 0.0, rotation: 0.0 },
                unknown: MotionNoise { translation: 0.0, rotation: 0.0 },
                prune: 0.0,
                parts: 0,
            },
            configured: false,
            pending: Move { motion: S::Pose::UNSET, drift: Drift::NONE },
            slipped: false,
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
        self.rest();
        self.base = S::Covariance::ZERO;
        (self.based, self.started) = (false, false);
        (self.grasps, self.evidence) = (0, 0.0);
        (self.roughness, self.rougher) = (USUAL_ROUGHNESS, false);
        self.roughen(self.roughness);
    }

    /// The empty map of a kernel rougher by this factor.
    fn roughen(&mut self, factor: f32) {
        self.map.roughen(factor);
        self.trajectory.clear();
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
        let centroid = grasp.centroid().unwrap_or(S::Vector::ZERO);
        let none = Move { motion: S::Pose::IDENTITY, drift: Drift::NONE };
        let dropped = self.memory.push(self.grasps, none, grasp);
        let first = &mut self.hypotheses[0];
        let pose = S::Pose::from_translation(centroid);
        (first.poses[0], first.about[0], first.base) = (pose, pose, pose);
        (first.covariance, first.free, first.weight) = (S::Covariance::ZERO, 0.0, 1.0);
        first.number = 1;
        for (belief, touch) in first.beliefs.iter_mut().zip(self.memory.touches()) {
            // Nothing depends on it: this pose has no error.
            let gradient = touch.direction().unwrap_or(S::Vector::ZERO);
            *belief =
                Belief::new(crate::surface::Bend { gradient, curvature: [S::Vector::ZERO; 3] });
        }
        self.count = 1;
        self.started = true;
        self.lay(0);
        // Every later one is the density of all that is remembered.
        self.hypotheses[0].evidence = self.evidence_of(0, self.memory.grasps().len());
        dropped
    }

    /// Brings the map to a hypothesis.
    fn lay(&mut self, index: usize) {
        self.lay_part(index, self.memory.grasps().len());
        self.laid = self.hypotheses[index].number;
    }

    /// Brings the map to the best hypothesis, where it is not.
    fn lay_best(&mut self) {
        if self.hypotheses[0].number != self.laid {
            self.lay(0);
        }
    }

    /// Its first grasps only.
    fn lay_part(&mut self, index: usize, grasps: usize) {
        self.laid = 0;
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
        self.laid = 0;
        self.trajectory.withdraw(&mut self.map, self.settled, &self.memory, grasp);
        self.map.refit();
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

    /// Whether the grasp was explained better than by wild contacts, and not beyond what a density can be: far
    /// from the surface single precision is at its end.
    fn is_found(&self, density: f32, nowhere: f32, exact: f32) -> bool {
        self.born > 0 && density > nowhere && density <= exact
    }

    /// One grasp with contacts: what became of it, and how many contacts found no room.
    fn learn(&mut self, grasp: &GraspView<'_, S>, contacts: usize) -> (Status, u16) {
        let mut dropped = self.make_room(contacts);
        dropped = dropped.saturating_add(self.memory.push(self.grasps, self.pending, grasp));
        // What found no room says nothing of the rest.
        let kept = self.memory.grasps().last().map_or(0, |last| last.touches().len());
        let (nowhere, exact) = (all_wild(grasp, 0..kept), all_short_by(grasp, 0..kept, 0.0));
        self.evidence += all_wild(grasp, kept..contacts);
        let expected = self.pending.motion;
        let mut density = math::ln(1.0 - SLIP) + self.branch(grasp);
        if !self.is_found(density, nowhere, exact) {
            self.memory.pop();
            self.rank();
            let odds = self.slip(grasp);
            self.memory.push(self.grasps, self.pending, grasp);
            self.lay_part(0, self.memory.grasps().len().saturating_sub(1));
            density = math::ln(SLIP) + odds + self.branch(grasp);
        }
        if !self.is_found(density, nowhere, exact) {
            self.evidence += nowhere;
            self.memory.pop();
            self.rank();
            self.lay(0);
            self.pending.motion = expected;
            return (Status::Lost, dropped);
        }
        self.evidence += density;
        self.grow();
        // What only a slip explains may be a grasp of something else: the next one has to agree.
        let status = if self.slipped { Status::Ambiguous } else { Status::Tracking };
        self.rest();
        (status, dropped)
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
        let contacts = grasp.usable().count();
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
        let corrected = matches!(status, Status::Tracking | Status::Ambiguous);
        let (pose, covariance, modes, effective_particles) = self.belief(begun && !corrected);
        if corrected && modes.disagree(AMBIGUOUS) {
            status = Status::Ambiguous;
        }
        let estimate = Estimate {
            effective_particles,
            dropped,
            ..Estimate::after(self.grasps, &grasp, (pose, covariance), status, modes)
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
mod model_tests;
#[cfg(test)]
mod slip_tests;
#[cfg(test)]
mod tests;
