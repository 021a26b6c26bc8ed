//! Several answers at once: a multi-hypothesis iterated extended Kalman filter over pose and faces.
//!
//! One map shared by all samples is what loses an object whose motion is uncertain: a grasp placed
//! wrongly spoils it for every sample. Here every hypothesis owns its faces, jointly Gaussian with the
//! pose (EKF-SLAM with planes as landmarks: Smith, Self and Cheeseman 1990; the multi-hypothesis
//! treatment after Reid 1979), so a dozen do what the thesis (3.4) needed 10 000 particles for.
//!
//! One grasp is explained contact by contact. Every contact may lie on a face of the hypothesis,
//! open a new one, or be wild; a beam search keeps the best partial explanations, and
//! each is scored by its Gaussian evidence, relinearised at its own best pose. What is known beside is
//! evidence too, all of it bounded:
//! * a contact beyond a plane it is not on contradicts convexity; a plane that contacts
//!   were beyond before forgives it (a Beta–Bernoulli rate per plane), so concave objects are learnt;
//! * a new face is as likely as there is room between the known planes and the points touched: faces
//!   are expected as a Poisson process over normals and offsets, of which that room is left;
//! * a finger that met nothing is not inside a map that is whole.
//!
//! The best `K` explanations live on. When the best calls most contacts wild, the object is lost:
//! the maps stay as they are, and the next grasps are sought at every rotation.

mod alignment;
mod beam;
mod belief;
mod chart;
mod explanation;
mod face;
mod foresight;
mod hypothesis;
mod joint;
mod past;
mod plane;
mod search;
mod selection;
mod work;

#[cfg(test)]
mod joint_tests;
#[cfg(test)]
mod tests;

pub use belief::{Disbelief, ToldFace};
pub use chart::Chart;
pub use face::Face;
pub use foresight::{Foreseen, On};

use crate::contact::GraspView;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::track::automatic::{Evidence, all_wild};
use crate::track::{Estimate, Modes, MotionNoise, Separation, Status, Tracker, is_plausible};
use beam::TOUCHES;
use explanation::Outcome;
use hypothesis::Hypothesis;
use past::Past;
use plane::Touch;
use search::{LEAVES, Search};
use work::Work;

/// Numbers of a joint belief over a pose and `faces` planes: the `ROWS` of [`Hypotheses`].
pub const fn rows<S: Space>(faces: usize) -> usize {
    S::FREEDOM + S::DIMENSION * faces
}

/// A second answer with this share of the belief makes it ambiguous.
const AMBIGUOUS: f32 = 0.1;

/// Variances beyond which nothing makes the pose vaguer: 1 m and a turn in every direction. Single precision
/// cannot take a contact of a millimetre from much more.
const VAGUEST: [f32; 2] = [1.0, 10.0];

/// How a [`Hypotheses`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motion noise of one grasp.
    pub motion: MotionNoise,
    /// How many faces an object is expected to have.
    pub faces: f32,
    /// Which share of the contacts is expected to be wild, above 0.
    pub wild: f32,
    /// Partial explanations kept while a grasp is explained, of each hypothesis: 1 to 16.
    pub beam: u8,
}

impl Settings {
    /// The thesis' motion noise, six faces, 2 % wild contacts, a beam of 8 (16 found no more).
    pub const DEFAULT: Self =
        Settings { motion: MotionNoise::THESIS, faces: 6.0, wild: 0.02, beam: 8 };
}

/// At most `K` hypotheses of at most `FACES` planes; `ROWS` is [`rows`]`(FACES)`, `PACKED` is
/// [`packed`](crate::surface::cholesky::packed)`(ROWS)`, and each remembers its last `GRASPS` poses.
///
/// ```
/// use tactile_core::contact::{Contact, GraspView};
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::{Planar, PlanarPose, Pose};
/// use tactile_core::surface::cholesky::packed;
/// use tactile_core::track::{Hypotheses, Tracker};
///
/// // Two touches on each side of a square of 40 mm.
/// let touch = |pose: &PlanarPose| {
///     let sides = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
///     let ends = sides.into_iter().flat_map(|s| [-0.01, 0.01].map(|along| (s, along)));
///     let felt = ends.map(|((x, y), along)| Contact {
///         point: pose.transform(Vector([0.02 * x - along * y, 0.02 * y + along * x])),
///         normal: Some(pose.rotate(Vector([x, y]))),
///         point_deviation: 1e-3,
///         normal_deviation: 0.09,
///         finger: 0,
///     });
///     felt.collect::<Vec<_>>()
/// };
/// let mut tracker = Hypotheses::<Planar, 4, 8, 19, { packed(19) }, 2>::new();
/// let first = touch(&PlanarPose::IDENTITY);
/// tracker.update(None, GraspView { contacts: &first, free: &[] });
/// assert_eq!(tracker.faces().count(), 4);
///
/// // It turned by 17° and moved by 8 mm; nobody said so.
/// let pose = PlanarPose::new(Vector([0.008, 0.0]), 0.3);
/// let second = touch(&pose);
/// let estimate = tracker.update(None, GraspView { contacts: &second, free: &[] });
/// assert!((estimate.pose.angle() - 0.3).abs() < 0.02);
/// assert!((estimate.pose.translation - pose.translation)[0].abs() < 1e-3);
/// ```
#[derive(Clone, Debug)]
pub struct Hypotheses<
    S: Space,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> {
    slots: [Hypothesis<S, FACES, ROWS, PACKED, GRASPS>; K],
    /// Slots in use, best first.
    order: [u8; K],
    count: usize,
    work: Work<S, FACES, ROWS, PACKED>,
    search: Search<S>,
    touches: [Touch<S>; TOUCHES],
    /// Of no account until `configured`, so that a new tracker is all zero bits.
    settings: Settings,
    configured: bool,
    /// Grasps seen.
    grasps: u32,
    /// Whether a contact has fixed the object frame.
    started: bool,
    /// Grasps since the object was lost; 0 when it is not.
    lost: u32,
    /// Radius that the object is thought not to exceed, metres.
    reach: f32,
    /// Log density of the grasps so far, nats.
    evidence: f32,
    /// Grasps that are not recalled any more, because another's word has replaced what they told.
    forgotten: u32,
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    const SIZES: () = assert!(K > 0 && K <= LEAVES && FACES > S::DIMENSION, "K: 1 to 32");

    /// Nothing touched yet, [`Settings::DEFAULT`]; all zero bits.
    pub const fn new() -> Self {
        let () = Self::SIZES;
        Hypotheses {
            slots: [const { Hypothesis::new() }; K],
            order: [0; K],
            count: 0,
            work: Work::new(),
            search: Search::new(),
            touches: [Touch::UNSET; TOUCHES],
            settings: Settings {
                motion: MotionNoise { translation: 0.0, rotation: 0.0 },
                faces: 0.0,
                wild: 0.0,
                beam: 0,
            },
            configured: false,
            grasps: 0,
            started: false,
            lost: 0,
            reach: 0.0,
            evidence: 0.0,
            forgotten: 0,
        }
    }

    /// Starts anew with these settings.
    pub fn configure(&mut self, settings: Settings) {
        self.settings = settings;
        self.configured = true;
        self.count = 0;
        self.grasps = 0;
        self.started = false;
        self.lost = 0;
        self.reach = 0.0;
        self.evidence = 0.0;
        self.forgotten = 0;
    }

    /// The pose of every hypothesis and its share of the belief, best first.
    pub fn hypotheses(&self) -> impl Iterator<Item = (f32, S::Pose)> + Clone + '_ {
        let best = self.best().map_or(0.0, |b| b.weight);
        let alive = self.order[..self.count].iter().filter_map(|i| self.slots.get(usize::from(*i)));
        let share = move |h: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>| {
            math::exp(math::max(h.weight - best, -60.0))
        };
        let total: f32 = alive.clone().map(share).sum();
        alive.map(move |h| (share(h) / total, h.pose))
    }

    fn best(&self) -> Option<&Hypothesis<S, FACES, ROWS, PACKED, GRASPS>> {
        self.order[..self.count].first().and_then(|i| self.slots.get(usize::from(*i)))
    }

    /// Fixes the object frame at the centroid of the first contacts.
    fn start(&mut self, grasp: &GraspView<'_, S>) {
        let felt = grasp.centroid();
        let centroid = felt.unwrap_or(S::Vector::ZERO);
        self.slots[0].place(S::Pose::from_translation(centroid));
        self.started = felt.is_some();
        let mut furthest = 0.01 * 0.01;
        for contact in grasp.usable() {
            furthest = math::max(furthest, (contact.point - centroid).norm_squared());
        }
        self.reach = 1.5 * math::sqrt(furthest);
        (self.order[0], self.count) = (0, 1);
    }

    /// Moves every hypothesis as the hand meant to, and adds the doubt about that.
    fn predict(&mut self, motion: Option<&S::Pose>) {
        let motion = motion.filter(|m| is_plausible::<S>(m));
        let noise = self.settings.motion.of(motion.is_some());
        let variances = [noise.translation, noise.rotation].map(|deviation| deviation * deviation);
        for slot in self.order[..self.count].iter().map(|i| usize::from(*i)) {
            let hypothesis = &mut self.slots[slot];
            if let Some(motion) = motion {
                hypothesis.pose = motion.compose(&hypothesis.pose);
            }
            for i in 0..S::FREEDOM {
                let kind = usize::from(i >= S::DIMENSION);
                let room = math::max(VAGUEST[kind] - hypothesis.joint.at(i, i), 0.0);
                hypothesis.joint.add_variance(i, math::min(variances[kind], room));
            }
            if GRASPS > 0 {
                let past = &mut hypothesis.past[self.grasps as usize % GRASPS];
                (past.predicted, past.noise) = (hypothesis.pose, variances);
            }
        }
    }

    /// Makes room for new faces by giving up those that only one contact speaks for.
    fn tidy(&mut self) {
        for slot in &self.order[..self.count] {
            let hypothesis = &mut self.slots[usize::from(*slot)];
            let mut face = 0;
            while face < hypothesis.faces {
                let record = &hypothesis.records[face];
                let full = hypothesis.faces + S::DIMENSION > FACES;
                let refuted = record.beyond > 1 || (full && record.tested > 0);
                if record.contacts < 2 && refuted {
                    hypothesis.forget_face(face);
                } else {
                    face += 1;
                }
            }
        }
    }

    /// The pose now in every hypothesis' memory of this grasp.
    fn remember(&mut self) {
        if GRASPS > 0 {
            let place = self.grasps as usize % GRASPS;
            for slot in &self.order[..self.count] {
                let hypothesis = &mut self.slots[usize::from(*slot)];
                let covariance = hypothesis.pose_covariance();
                let past = &mut hypothesis.past[place];
                (past.pose, past.covariance) = (hypothesis.pose, covariance);
            }
        }
    }

    /// Covariance about the best pose of the hypotheses that share its mode.
    fn covariance(&self, pose: &S::Pose) -> S::Covariance {
        let mut covariance = S::Covariance::ZERO;
        let mut total = 0.0;
        for ((share, other), slot) in self.hypotheses().zip(&self.order[..self.count]) {
            if Separation::DEFAULT.between::<S>(pose, &other) < 1.0 {
                let apart = pose.local(&other);
                let own = self.slots[usize::from(*slot)].pose_covariance();
                total += share;
                for i in 0..S::FREEDOM {
                    for j in 0..S::FREEDOM {
                        *covariance.at_mut(i, j) += share * (own.at(i, j) + apart[i] * apart[j]);
                    }
                }
            }
        }
        if total > 0.0 {
            covariance.scale(1.0 / total);
        }
        covariance
    }
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Default for Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Tracker<S> for Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        if !self.configured {
            self.configure(Settings::DEFAULT);
        }
        let contacts = grasp.usable().count();
        let begun = self.started;
        if begun {
            self.predict(motion);
            self.tidy();
        } else {
            self.start(&grasp);
        }
        let mut outcome = Outcome::NONE;
        let mut felt = grasp.usable();
        let (mut free, mut told) = (grasp.free, 0);
        loop {
            let mut count = 0;
            for (touch, contact) in self.touches.iter_mut().zip(&mut felt) {
                *touch = Touch::of(&contact);
                count += 1;
            }
            if count == 0 {
                break;
            }
            // What was not touched is told once, however many parts there are.
            let part = self.absorb(count, core::mem::take(&mut free), told == 0);
            outcome.dropped = outcome.dropped.saturating_add(part.dropped);
            outcome.corrected |= part.corrected && begun;
            outcome.slipped |= part.slipped;
            outcome.density += part.density;
            if part.lost {
                outcome.lost = told == 0;
                // What no hypothesis explains of a grasp that is explained otherwise is wild.
                outcome.dropped = outcome.dropped.saturating_add((contacts - told) as u16);
                outcome.density += all_wild(&grasp, told..contacts);
                break;
            }
            told += count;
            // Where a part of it was felt is where the rest of it was.
            if part.corrected {
                self.lost = 0;
            }
        }
        if begun {
            self.evidence +=
                if outcome.lost { all_wild(&grasp, 0..contacts) } else { outcome.density };
        }
        if contacts > 0 {
            self.lost = if outcome.lost { self.lost.saturating_add(1) } else { 0 };
        }
        self.remember();
        let pose = self.best().map_or(S::Pose::IDENTITY, |b| b.pose);
        let modes = Modes::of(self.hypotheses(), &Separation::DEFAULT);
        let status = match (begun, contacts) {
            (false, _) => Status::Started,
            (true, 0) => Status::Predicted,
            _ if outcome.lost => Status::Lost,
            // What only a slip explains may be a grasp of something else: the next one has to agree.
            _ if outcome.slipped || modes.disagree(AMBIGUOUS) => Status::Ambiguous,
            _ if !outcome.corrected => Status::Predicted,
            _ => Status::Tracking,
        };
        let squares: f32 = self.hypotheses().map(|(share, _)| share * share).sum();
        let estimate = Estimate {
            effective_particles: if squares > 0.0 { 1.0 / squares } else { 0.0 },
            dropped: outcome.dropped,
            corrected: outcome.corrected,
            ..Estimate::after(self.grasps, &grasp, (pose, self.covariance(&pose)), status, modes)
        };
        self.grasps = self.grasps.saturating_add(1);
        estimate
    }

    /// No random numbers are drawn: every seed gives the same.
    fn reset(&mut self, _seed: u64) {
        let settings = if self.configured { self.settings } else { Settings::DEFAULT };
        self.configure(settings);
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        if !self.configured {
            self.configure(Settings::DEFAULT);
        }
        self.settings.motion = noise;
    }

    fn recall(&self, grasp: u32) -> Option<S::Pose> {
        let age = self.grasps.checked_sub(grasp)?;
        if GRASPS == 0 || age == 0 || age as usize > GRASPS || grasp < self.forgotten {
            return None;
        }
        let past =
            |grasp: u32| -> Option<&Past<S>> { self.best()?.past.get(grasp as usize % GRASPS) };
        let mut pose = past(self.grasps - 1)?.pose;
        for earlier in (grasp..self.grasps - 1).rev() {
            pose = past(earlier)?.smoothed(past(earlier + 1)?, &pose);
        }
        Some(pose)
    }
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Evidence<S> for Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    fn evidence(&self) -> f32 {
        self.evidence
    }
}
