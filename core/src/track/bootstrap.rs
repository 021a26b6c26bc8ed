//! The bootstrap particle filter over the pose with one shared map: Algorithm 3.1 of the thesis, as
//! corrected (weights multiply, the likelihood has a scale, means are taken on the manifold).

mod foresight;

pub use foresight::Foreseen;

use crate::contact::{Contact, GraspView};
use crate::matrix::Coordinates;
use crate::random::Random;
use crate::space::{Pose, Space};
use crate::surface::{Insertion, Map};
use crate::track::blurred::blurred;
use crate::track::likelihood::{is_strange, log_free, log_likelihood};
use crate::track::particles::Particles;
use crate::track::{Estimate, MotionNoise, Separation, Status, Tracker, is_plausible};

/// The thesis' condition on a pose (3.5.1): enough contacts of the grasp must lie close to contacts
/// already in the map, or its likelihood is zero. Of a grasp with fewer contacts, all must.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// How many contacts.
    pub contacts: u16,
    /// How close, metres.
    pub distance: f32,
}

impl Gate {
    /// Four contacts within 10 mm.
    pub const THESIS: Self = Gate { contacts: 4, distance: 0.01 };
}

/// How far apart two answers are: two deviations of the thesis' motion noise, for a belief that slides
/// along a face is broad and yet one answer, to be learnt with all of its doubt.
const APART: Separation = Separation { translation: 0.02, rotation: 0.698_131_7 };

/// A second answer with this share of the belief makes it ambiguous.
const AMBIGUOUS: f32 = 0.25;

/// How a [`Bootstrap`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motion noise of one grasp.
    pub motion: MotionNoise,
    /// The thesis' gate; `None` leaves it to the likelihood, which knows where the map is uncertain.
    pub gate: Option<Gate>,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Settings {
    /// The thesis' motion noise, no gate, seed 0.
    pub const DEFAULT: Self = Settings { motion: MotionNoise::THESIS, gate: None, seed: 0 };
}

/// A bootstrap filter of `PARTICLES` poses over the map `M`.
#[derive(Clone, Debug)]
pub struct Bootstrap<S: Space, M: Map<S>, const PARTICLES: usize> {
    map: M,
    particles: Particles<S, PARTICLES>,
    /// `None` until the first use, so that a new filter is all zero bits.
    running: Option<Running>,
    /// Grasps seen.
    grasps: u32,
    /// Grasps in a row that fitted nowhere.
    lost: u16,
    /// Whether a contact has fixed the object frame.
    started: bool,
    /// Mean of the contacts learnt, object frame, and their number.
    middle: S::Vector,
    learnt: f32,
}

#[derive(Clone, Debug)]
struct Running {
    motion: MotionNoise,
    /// No contacts: no gate. (Not an `Option`, whose unused tags would encode that nothing is
    /// running, and that encoding is not zero.)
    gate: Gate,
    random: Random,
}

impl Running {
    fn new(settings: Settings) -> Self {
        Running {
            motion: settings.motion,
            gate: settings.gate.unwrap_or(Gate { contacts: 0, distance: 0.0 }),
            random: Random::new(settings.seed),
        }
    }

    fn gate(&self) -> Option<Gate> {
        (self.gate.contacts > 0).then_some(self.gate)
    }
}

impl<S: Space, M: Map<S>, const PARTICLES: usize> Bootstrap<S, M, PARTICLES> {
    /// A filter over an empty `map`, with [`Settings::DEFAULT`].
    pub const fn new(map: M) -> Self {
        let particles = Particles::new();
        Bootstrap {
            map,
            particles,
            running: None,
            grasps: 0,
            lost: 0,
            started: false,
            middle: S::Vector::ZERO,
            learnt: 0.0,
        }
    }

    /// Starts anew with these settings.
    pub fn configure(&mut self, settings: Settings) {
        self.running = Some(Running::new(settings));
        self.map.clear();
        self.grasps = 0;
        self.lost = 0;
        self.started = false;
        (self.middle, self.learnt) = (S::Vector::ZERO, 0.0);
    }

    /// The shape so far.
    pub fn map(&self) -> &M {
        &self.map
    }

    /// The shape, to set its model; call [`configure`](Self::configure) afterwards.
    pub fn map_mut(&mut self) -> &mut M {
        &mut self.map
    }

    /// The belief over the pose.
    pub fn particles(&self) -> &Particles<S, PARTICLES> {
        &self.particles
    }

    /// Fixes the object frame at the centroid of the first contacts.
    fn start(&mut self, grasp: &GraspView<'_, S>) {
        if let Some(centroid) = grasp.centroid() {
            self.particles.place(S::Pose::from_translation(centroid));
            self.started = true;
        }
    }

    /// Moves every particle as the hand meant to, and then some. A lost object may be anywhere: a hand closes about it,
    /// so that its middle is where the contacts' is.
    fn predict(&mut self, motion: Option<&S::Pose>, grasp: &GraspView<'_, S>) {
        let elsewhere = grasp.centroid().filter(|_| self.lost > 0);
        let running = self.running.get_or_insert_with(|| Running::new(Settings::DEFAULT));
        let motion = motion.filter(|m| is_plausible::<S>(m));
        let noise = running.motion.of(motion.is_some()).after_losing(self.lost);
        for pose in self.particles.poses_mut() {
            let mut moved = motion.map_or(*pose, |m| m.compose(pose));
            if let Some(felt) = elsewhere {
                let off = felt - moved.transform(self.middle);
                moved = S::Pose::from_translation(off).compose(&moved);
            }
            *pose = noise.disturb::<S>(&moved, &mut running.random);
        }
    }

    /// Weighs the particles by the grasp, unless it fits at none of them.
    fn weigh(&mut self, grasp: &GraspView<'_, S>) -> Fit {
        let gate = self.running.as_ref().and_then(Running::gate);
        let map = &self.map;
        let best = self.particles.compare(|pose| {
            let (mut sum, mut close, mut all) = (0.0, 0u32, 0u32);
            for contact in grasp.usable() {
                let probe = map.probe(pose.untransform(contact.point));
                sum += log_likelihood(&probe, contact.normal.map(|n| pose.unrotate(n)), &contact);
                all += 1;
                close += u32::from(gate.is_some_and(|g| probe.nearest <= g.distance));
            }
            let free = grasp.free.iter().map(|f| f.point).filter(|p| p.is_finite());
            for point in free {
                sum += log_free(&map.probe(pose.untransform(point)));
            }
            gate.is_none_or(|g| close >= u32::from(g.contacts).min(all)).then_some(sum)
        });
        let likeliest = best.unwrap_or_else(|| self.particles.mean().0);
        match (self.contradicts(grasp, &likeliest), best) {
            (true, _) => Fit::Nowhere,
            (false, None) => Fit::Refused,
            (false, Some(_)) if self.particles.accept() => Fit::Somewhere,
            (false, Some(_)) => Fit::Refused,
        }
    }

    /// Whether most contacts are strange to the map at this pose.
    fn contradicts(&self, grasp: &GraspView<'_, S>, pose: &S::Pose) -> bool {
        let (mut strange, mut all) = (0, 0);
        for contact in grasp.usable() {
            let probe = self.map.probe(pose.untransform(contact.point));
            let normal = contact.normal.map(|n| pose.unrotate(n));
            strange += usize::from(is_strange(&probe, normal, &contact));
            all += 1;
        }
        strange >= 2 && 2 * strange >= all
    }

    /// Resamples when fewer than half of the particles count.
    fn resample_if_poor(&mut self) -> bool {
        let poor = self.particles.effective() < 0.5 * PARTICLES as f32;
        if poor && let Some(running) = &mut self.running {
            self.particles.resample(&mut running.random);
        }
        poor
    }

    /// Adds the grasp to the map at the mean pose; the number of contacts let go.
    ///
    /// The doubt about the pose ([`blurred`]) goes into each contact's noise, so that a grasp
    /// placed badly does not overrule one placed well. What is still strange with it is a wild contact
    /// and not learnt.
    fn learn(
        &mut self,
        grasp: &GraspView<'_, S>,
        pose: &S::Pose,
        covariance: &S::Covariance,
    ) -> u16 {
        // The map answers only for what it was fitted to, so every contact is judged before the first
        // is inserted. (One bit each; beyond 128 in a grasp all are learnt.)
        let mut wild = 0u128;
        if self.map.contacts() > 0 {
            for (contact, bit) in grasp.usable().zip(0..u128::BITS) {
                let placed = place(&contact, pose, covariance);
                let probe = self.map.probe(placed.point);
                wild |= u128::from(is_strange(&probe, placed.normal, &placed)) << bit;
            }
        }
        let mut dropped = 0u16;
        for (number, contact) in grasp.usable().enumerate() {
            if number < 128 && wild >> number & 1 == 1 {
                continue;
            }
            let placed = place(&contact, pose, covariance);
            self.learnt += 1.0;
            self.middle += (placed.point - self.middle) * (1.0 / self.learnt);
            dropped = dropped.saturating_add(match self.map.insert(&placed) {
                Insertion::Stored | Insertion::Merged => 0,
                Insertion::Replaced(others) => others,
                Insertion::Dropped => 1,
            });
        }
        self.map.refit();
        dropped
    }
}

/// Where a grasp fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// At some particles.
    Somewhere,
    /// At none that the gate lets pass, though the map does not contradict it: it was felt where
    /// nothing had been touched.
    Refused,
    /// At none: most of it contradicts the map even where it fits best.
    Nowhere,
}

/// The contact in the object frame at an uncertain pose.
fn place<S: Space>(contact: &Contact<S>, pose: &S::Pose, covariance: &S::Covariance) -> Contact<S> {
    let point = pose.untransform(contact.point);
    let normal = contact.normal.map(|n| pose.unrotate(n));
    blurred(&Contact { point, normal, ..*contact }, covariance)
}

impl<S: Space, M: Map<S>, const PARTICLES: usize> Tracker<S> for Bootstrap<S, M, PARTICLES> {
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        let contacts = grasp.usable().count();
        let mut resampled = false;
        let mut status = Status::Started;
        if !self.started {
            self.particles.place(S::Pose::IDENTITY);
            self.start(&grasp);
        } else {
            self.predict(motion, &grasp);
            status = match if contacts > 0 { self.weigh(&grasp) } else { Fit::Refused } {
                Fit::Somewhere => Status::Tracking,
                Fit::Refused => Status::Predicted,
                Fit::Nowhere => Status::Lost,
            };
            let lost = self.lost.saturating_add(u16::from(status == Status::Lost));
            self.lost = if status == Status::Tracking { 0 } else { lost };
        }
        let modes = self.particles.modes(&APART);
        let (mut pose, mut covariance) = self.particles.mean();
        if status == Status::Tracking
            && modes.disagree(AMBIGUOUS)
            && let Some(heaviest) = modes.as_slice().first()
        {
            status = Status::Ambiguous;
            (pose, covariance) = self.particles.mean_near(heaviest.pose, &APART);
        }
        let corrected = matches!(status, Status::Tracking | Status::Ambiguous);
        let effective_particles = self.particles.effective();
        if corrected {
            resampled = self.resample_if_poor();
        }
        let mut dropped = 0;
        if status != Status::Lost {
            dropped = self.learn(&grasp, &pose, &covariance);
        }
        let estimate = Estimate {
            effective_particles,
            dropped,
            resampled,
            ..Estimate::after(self.grasps, &grasp, (pose, covariance), status, modes)
        };
        self.grasps = self.grasps.saturating_add(1);
        estimate
    }

    fn reset(&mut self, seed: u64) {
        let settings = self.running.as_ref().map_or(Settings::DEFAULT, |r| Settings {
            motion: r.motion,
            gate: r.gate(),
            seed,
        });
        self.configure(Settings { seed, ..settings });
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        let running = self.running.get_or_insert_with(|| Running::new(Settings::DEFAULT));
        running.motion = noise;
    }
}

#[cfg(test)]
mod tests;
