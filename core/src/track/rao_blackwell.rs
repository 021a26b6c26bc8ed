//! The Rao-Blackwellised particle filter: every particle is a pose and the faces that follow from
//! where it has been.
//!
//! With one map shared by all particles (thesis 3.3.1) a grasp placed badly spoils the map for all of
//! them, however many there are. Here the faces are learnt by each particle at its own pose, where
//! they are Gaussian (Murphy 1999), and the pose is drawn from a proposal that already knows the
//! grasp (FastSLAM 2.0, Montemerlo et al. 2003): 64 particles do what 10 000 could not. A particle
//! that went wrong is contradicted by its own faces and dies out with them.
//!
//! An object without flat faces is approximated by as many faces as there is room for; the shape is
//! then coarse, and so is the pose.

mod face;
mod genealogy;
mod proposal;
mod shape;

pub use face::{Face, Faceted};
pub use shape::Shape;

use crate::contact::GraspView;
use crate::math;
use crate::matrix::Coordinates;
use crate::random::Random;
use crate::space::{self, Pose};
use crate::track::particles::{effective, multiply, resample};
use crate::track::{Estimate, Modes, MotionNoise, Separation, Status, Tracker, is_plausible};
use genealogy::Genealogy;
use proposal::{Drawn, Prior, draw, free};

/// Kernel of the medoid: poses this close support each other.
const KERNEL: Separation = Separation { translation: 0.005, rotation: 0.1 };

/// Poses of a belief with one answer: wide, but without another face's alias (60° on a hexagon).
const SAME_HILL: Separation = Separation { translation: 0.03, rotation: 0.8 };

const EVERYWHERE: Separation = Separation { translation: f32::INFINITY, rotation: f32::INFINITY };

/// A second answer with this share of the belief makes it ambiguous.
const AMBIGUOUS: f32 = 0.25;

/// One answer to where the object is, and what it looks like in that case.
#[derive(Clone, Copy, Debug)]
pub struct Particle<S: Faceted, const FACES: usize> {
    /// Object to world.
    pub pose: S::Pose,
    /// What it believes the object's faces to be.
    pub shape: Shape<S, FACES>,
}

/// `PARTICLES` particles of at most `FACES` faces each; poses of the last `HISTORY` grasps are
/// remembered for [`Tracker::recall`]. 64 planar particles of 12 faces take 27 kB, 64 spatial
/// ones of 8 faces 32 kB, without history.
///
/// ```
/// use tactile_core::contact::{Contact, GraspView};
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::{Planar, PlanarPose, Pose};
/// use tactile_core::track::{RaoBlackwell, Status, Tracker};
///
/// // Two touches on each side of a rectangle of 100 × 60 mm.
/// let touch = |pose: &PlanarPose| {
///     [(0.05, [1.0, 0.0]), (0.03, [0.0, 1.0]), (0.05, [-1.0, 0.0]), (0.03, [0.0, -1.0])]
///         .into_iter()
///         .flat_map(|(half, n)| [-0.02, 0.015].map(|s| (half, Vector(n), s)))
///         .map(|(half, n, s)| Contact {
///             point: pose.transform(n * half + Vector([-n[1], n[0]]) * s),
///             normal: Some(pose.rotate(n)),
///             point_deviation: 1e-3,
///             normal_deviation: 0.09,
///             finger: 0,
///         })
///         .collect::<Vec<_>>()
/// };
/// let mut tracker = Box::new(RaoBlackwell::<Planar, 64, 12, 0>::new());
/// tracker.update(None, GraspView { contacts: &touch(&PlanarPose::IDENTITY), free: &[] });
/// let slipped = PlanarPose::new(Vector([0.008, -0.005]), 0.3);
/// let estimate = tracker.update(None, GraspView { contacts: &touch(&slipped), free: &[] });
/// assert_eq!(estimate.status, Status::Tracking);
/// assert!(estimate.pose.local(&slipped)[2].abs() < 0.1);
/// ```
#[derive(Clone, Debug)]
pub struct RaoBlackwell<
    S: Faceted,
    const PARTICLES: usize,
    const FACES: usize,
    const HISTORY: usize,
> {
    particles: [Particle<S, FACES>; PARTICLES],
    /// Summing to one.
    weights: [f32; PARTICLES],
    /// Log weights while weighing, numbers of children while resampling.
    scratch: [f32; PARTICLES],
    /// Poses drawn for the grasp being weighed.
    drawn: [S::Pose; PARTICLES],
    /// Where each particle comes from.
    parents: [u16; PARTICLES],
    genealogy: Genealogy<S, PARTICLES, HISTORY>,
    /// Where the belief's best mode is.
    mode: S::Pose,
    /// `None` until the first use, so that a new filter is all zero bits.
    running: Option<Running>,
    /// Grasps seen.
    grasps: u32,
    /// Grasps lost in a row.
    lost: u16,
    /// Whether a contact has fixed the object frame.
    started: bool,
}

#[derive(Clone, Debug)]
struct Running {
    motion: MotionNoise,
    random: Random,
}

/// What the particles together say about a grasp, weighted: shares from 0 to 1.
#[derive(Clone, Copy, Debug, Default)]
struct Verdict {
    /// Of particles to whom most contacts are strange.
    strange: f32,
    /// Of particles whose known faces explain most contacts.
    fitting: f32,
}

impl<S: Faceted, const PARTICLES: usize, const FACES: usize, const HISTORY: usize>
    RaoBlackwell<S, PARTICLES, FACES, HISTORY>
{
    const SIZE_FITS: () =
        assert!(PARTICLES > 0 && PARTICLES < 1 << 16 && FACES > 0 && FACES < 1 << 16);

    /// A filter that knows nothing; all zero bits.
    pub const fn new() -> Self {
        let () = Self::SIZE_FITS;
        RaoBlackwell {
            particles: [Particle { pose: S::Pose::UNSET, shape: Shape::NONE }; PARTICLES],
            weights: [0.0; PARTICLES],
            scratch: [0.0; PARTICLES],
            drawn: [S::Pose::UNSET; PARTICLES],
            parents: [0; PARTICLES],
            genealogy: Genealogy::new(),
            mode: S::Pose::UNSET,
            running: None,
            grasps: 0,
            lost: 0,
            started: false,
        }
    }

    /// Starts anew with this motion noise and seed.
    pub fn configure(&mut self, motion: MotionNoise, seed: u64) {
        self.running = Some(Running { motion, random: Random::new(seed) });
        self.genealogy.clear();
        self.place(S::Pose::UNSET);
        self.grasps = 0;
        self.lost = 0;
        self.started = false;
    }

    /// The belief: poses with their shapes.
    pub fn particles(&self) -> &[Particle<S, FACES>] {
        &self.particles
    }

    /// The particles' weights, summing to one.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// The shape of the particle at the best mode.
    pub fn shape(&self) -> &Shape<S, FACES> {
        &self.particles[self.nearest_to_mode()].shape
    }

    /// The particle at the best mode, or what resampling has left nearest to it.
    fn nearest_to_mode(&self) -> usize {
        let mut best = (f32::INFINITY, 0);
        for (place, particle) in self.particles.iter().enumerate() {
            let apart = KERNEL.between::<S>(&self.mode, &particle.pose);
            if apart < best.0 {
                best = (apart, place);
            }
        }
        best.1
    }

    fn running(&mut self) -> &mut Running {
        self.running
            .get_or_insert_with(|| Running { motion: MotionNoise::THESIS, random: Random::new(0) })
    }

    /// Puts every particle at `pose`, ignorant of any face.
    fn place(&mut self, pose: S::Pose) {
        for particle in &mut self.particles {
            particle.pose = pose;
            particle.shape = Shape::NONE;
        }
        self.weights.fill(1.0 / PARTICLES as f32);
        self.mode = pose;
    }

    /// Moves every particle as the hand meant to, and then some.
    fn predict(&mut self, motion: Option<&S::Pose>) {
        let Running { motion: noise, random } = self.running();
        let (noise, mut random) = (noise.of(motion.is_some()), random.clone());
        for particle in &mut self.particles {
            let moved = motion.map_or(particle.pose, |m| m.compose(&particle.pose));
            particle.pose = noise.disturb::<S>(&moved, &mut random);
        }
        self.running().random = random;
    }

    /// Draws a pose for every particle and puts what it changes the weights by into `scratch`.
    /// `lost` grasps in a row widen the search; 0 trusts the motion.
    fn search(
        &mut self,
        motion: Option<&S::Pose>,
        grasp: &GraspView<'_, S>,
        lost: u16,
    ) -> Option<Verdict> {
        let Running { motion: noise, random } = self.running();
        let (noise, mut random) = (noise.of(motion.is_some()).after_losing(lost), random.clone());
        let felt = grasp.centroid().unwrap_or(S::Vector::ZERO);
        let contacts = grasp.usable().count() as u32;
        // Two fingers must agree; one alone fits anywhere.
        let enough = math::max(contacts.clamp(2, 3) as f32, 0.6 * contacts as f32);
        let (mut strange, mut fitting, mut total) = (0.0, 0.0, 0.0);
        let mut greatest = f32::NEG_INFINITY;
        for (i, particle) in self.particles.iter().enumerate() {
            let mean = motion.map_or(particle.pose, |m| m.compose(&particle.pose));
            let view = particle.shape.view();
            let centre = particle.shape.centre();
            let mut noise = noise;
            if lost > 0 {
                // Put elsewhere, it is within two deviations of where it was expected.
                let far = (felt - mean.transform(centre)).norm();
                noise.translation = math::max(noise.translation, 0.5 * far);
            }
            let prior = Prior { mean, noise };
            let drawn = draw(&view, &prior, grasp, &mut random, |k, random| {
                let start = if k == 0 { mean } else { noise.disturb::<S>(&mean, random) };
                if lost == 0 {
                    return start;
                }
                // A hand closes about the object: its middle is where the contacts' is.
                S::Pose::from_translation(felt - start.transform(centre)).compose(&start)
            });
            let Some(Drawn { pose, log_weight, agreement }) = drawn else {
                (self.drawn[i], self.scratch[i]) = (mean, f32::NEG_INFINITY);
                continue;
            };
            self.drawn[i] = pose;
            self.scratch[i] = log_weight;
            // Sums relative to the greatest weight so far.
            let log = log_weight + math::ln(self.weights[i]);
            if log > greatest {
                let fade = math::exp(greatest - log);
                (strange, fitting, total) = (strange * fade, fitting * fade, total * fade);
                greatest = log;
            }
            let weight = math::exp(log - greatest);
            total += weight;
            if agreement.strange >= 2 && 2 * agreement.strange >= contacts {
                strange += weight;
            }
            if agreement.fitting as f32 >= enough {
                fitting += weight;
            }
        }
        self.running().random = random;
        (greatest > f32::NEG_INFINITY)
            .then_some(Verdict { strange: strange / total, fitting: fitting / total })
    }

    /// Corrects the belief with a grasp; false, and the belief unchanged, where it fits nowhere.
    fn correct(&mut self, motion: Option<&S::Pose>, grasp: &GraspView<'_, S>) -> bool {
        let mut found = false;
        if self.lost == 0 {
            found = self.search(motion, grasp, 0).is_some_and(|v| v.strange < 0.5);
        }
        if !found {
            let lost = self.lost.saturating_add(1);
            found = self.search(motion, grasp, lost).is_some_and(|v| v.fitting > 0.5);
        }
        found = found && multiply(&mut self.weights, &mut self.scratch);
        if found {
            for (particle, pose) in self.particles.iter_mut().zip(&self.drawn) {
                particle.pose = *pose;
            }
        }
        found
    }

    /// Weighs the particles by where fingers met nothing.
    fn weigh_free(&mut self, grasp: &GraspView<'_, S>) {
        if grasp.free.is_empty() {
            return;
        }
        for (log, particle) in self.scratch.iter_mut().zip(&self.particles) {
            *log = free(&particle.shape.view(), &particle.pose, grasp);
        }
        multiply(&mut self.weights, &mut self.scratch);
    }

    /// Resamples when fewer than half of the particles count; every particle's parent is noted.
    fn resample_if_poor(&mut self) -> bool {
        for (place, parent) in self.parents.iter_mut().enumerate() {
            *parent = place as u16;
        }
        if effective(&self.weights) >= 0.5 * PARTICLES as f32 {
            return false;
        }
        let mut random = self.running().random.clone();
        let (particles, parents) = (&mut self.particles, &mut self.parents);
        resample(&mut self.weights, &mut self.scratch, &mut random, |from, to| {
            particles.copy_within(from..=from, to);
            parents[to] = from as u16;
        });
        self.running().random = random;
        true
    }

    /// Teaches every particle the grasp at its own pose; how many contacts or faces a particle let
    /// go, on average and rounded up.
    fn learn(&mut self, grasp: &GraspView<'_, S>) -> u16 {
        let number = (self.grasps & 0xffff) as u16;
        let mut dropped = 0.0;
        for (particle, weight) in self.particles.iter_mut().zip(&self.weights) {
            for contact in grasp.usable() {
                let felt = face::Felt::at(&particle.pose, &contact);
                dropped += weight * f32::from(particle.shape.learn(&felt, number));
            }
        }
        (dropped + 0.99) as u16
    }

    /// The weights of the particles in the best mode, zero for the others.
    fn in_mode(&self) -> impl Iterator<Item = f32> + Clone + '_ {
        self.particles.iter().zip(&self.weights).map(|(particle, weight)| {
            let apart = Separation::DEFAULT.between::<S>(&self.mode, &particle.pose);
            if apart < 1.0 { *weight } else { 0.0 }
        })
    }

    /// Finds the best mode: the pose that most of the belief supports.
    fn find_mode(&mut self) {
        let mut most = 0.0;
        let mut mode = None;
        for candidate in &self.particles {
            let mut support = 0.0;
            for (particle, weight) in self.particles.iter().zip(&self.weights) {
                if *weight > 0.0 {
                    let apart = KERNEL.between::<S>(&candidate.pose, &particle.pose);
                    support += weight * math::exp(-0.5 * apart * apart);
                }
            }
            if support > most {
                (most, mode) = (support, Some(candidate.pose));
            }
        }
        if let Some(mode) = mode {
            self.mode = mode;
        }
    }
}

impl<S: Faceted, const PARTICLES: usize, const FACES: usize, const HISTORY: usize> Tracker<S>
    for RaoBlackwell<S, PARTICLES, FACES, HISTORY>
{
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        let contacts = grasp.usable().count();
        let motion = motion.filter(|m| is_plausible::<S>(m));
        let mut status = Status::Started;
        if !self.started {
            let centroid = grasp.centroid().unwrap_or(S::Vector::ZERO);
            self.place(S::Pose::from_translation(centroid));
            self.started = contacts > 0;
        } else if contacts == 0 {
            self.predict(motion);
            self.weigh_free(&grasp);
            status = Status::Predicted;
        } else if self.correct(motion, &grasp) {
            self.lost = 0;
            status = Status::Tracking;
        } else {
            self.predict(motion);
            self.lost = self.lost.saturating_add(1);
            status = Status::Lost;
        }
        self.find_mode();
        let weighted = self.particles.iter().zip(&self.weights).map(|(p, w)| (*w, p.pose));
        let modes = Modes::of(weighted.clone(), &Separation::DEFAULT);
        if status == Status::Tracking && modes.disagree(AMBIGUOUS) {
            status = Status::Ambiguous;
        }
        let reach = match status {
            Status::Ambiguous => Separation::DEFAULT,
            Status::Tracking => SAME_HILL,
            // Nothing has said where it is: the whole belief is one answer.
            _ => EVERYWHERE,
        };
        let own = weighted.filter(|(_, pose)| reach.between::<S>(&self.mode, pose) < 1.0);
        let (pose, covariance) = space::mean::<S>(own, self.mode);
        let corrected = matches!(status, Status::Tracking | Status::Ambiguous);
        let effective_particles = effective(&self.weights);
        let resampled = self.resample_if_poor();
        let dropped = if corrected || status == Status::Started { self.learn(&grasp) } else { 0 };
        let family = self.particles.iter().zip(&self.parents).map(|(p, parent)| (p.pose, *parent));
        self.genealogy.record(family);
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
        let motion = self.running().motion;
        self.configure(motion, seed);
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        self.running().motion = noise;
    }

    fn recall(&self, grasp: u32) -> Option<S::Pose> {
        self.genealogy.mean(grasp, self.nearest_to_mode(), self.in_mode())
    }
}

impl<S: Faceted, const PARTICLES: usize, const FACES: usize, const HISTORY: usize> Default
    for RaoBlackwell<S, PARTICLES, FACES, HISTORY>
{
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
