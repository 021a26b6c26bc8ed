//! Which model is meant: two trackers on the same grasps, and the one that foretells them better speaks.
//!
//! # The measurement density
//!
//! Trackers are compared by the density they gave to each grasp before they learnt it, all
//! their earlier grasps known and the pose marginalised over what the motion leaves open: the product over
//! the grasps is the evidence of the model (prequential likelihood; Dawid 1984), and the ratio of two
//! is their Bayes factor. That holds for densities of the *same* numbers only. They are, for each usable
//! contact of a grasp after the first,
//!
//! ```text
//! d   distance of the contact from the surface along the surface's normal     metres
//! α   deviation of the felt normal from it, one angle per axis                radians (1 in the plane, 2 in space)
//! ```
//!
//! with the density in 1/m · 1/rad per axis, constants included: N(e; 0, S) has (2π)^(−k/2) det S^(−½).
//! A contact without a normal gives d alone. The first grasp fixes the frame of both models and counts in
//! neither; an empty grasp counts nothing; bad contacts count nowhere. A contact that no part of the model
//! explains has the density of [`wild`]: anywhere along 120 mm, or along twelve of its own deviations where
//! that is more, in any direction (1/2π per radian, 1/4π per steradian), times the probability that the
//! model gives to such a contact (a new face, an outlier). A lost grasp counts as wild in all its contacts:
//! it was not learnt, but it was not foretold either.
//!
//! A model that holds several hypotheses gives the sum of their densities weighed by their
//! weights before the grasp.

mod patience;
#[cfg(test)]
mod tests;

use core::ops::Range;

use crate::contact::{Contact, GraspView};
use crate::math;
use crate::space::Space;
use crate::track::{Estimate, MotionNoise, Tracker};
use patience::{Held, Patience};

/// The length along a surface's normal over which a wild contact of usual precision may lie, metres.
pub const REACH: f32 = 0.12;

/// Log density of a contact that no part of the model explains: see the module.
pub fn wild<S: Space>(contact: &Contact<S>) -> f32 {
    wild_of::<S>(contact.normal.is_some(), contact.point_deviation * contact.point_deviation)
}

/// The same of a contact with a normal or without, and a point of this variance.
#[inline(never)]
pub(crate) fn wild_of<S: Space>(is_directed: bool, variance: f32) -> f32 {
    /// −ln 0.12, −ln 12, −ln 2π, −ln 4π.
    const PLACE: f32 = 2.120_263_5;
    const DEVIATIONS: f32 = -2.484_906_7;
    const PLANAR: f32 = -1.837_877_1;
    const SPATIAL: f32 = -2.531_024_2;
    let direction = if S::DIMENSION == 2 { PLANAR } else { SPATIAL };
    // What is no better known than to 120 mm would never be explained: its own density is less.
    let place = math::min(PLACE, DEVIATIONS - 0.5 * math::ln(variance));
    place + if is_directed { direction } else { 0.0 }
}

/// The same of the usable contacts of a grasp that have these numbers among them.
#[inline(never)]
pub(crate) fn all_wild<S: Space>(grasp: &GraspView<'_, S>, numbers: Range<usize>) -> f32 {
    let mut sum = 0.0;
    for (number, contact) in grasp.usable().enumerate() {
        if numbers.contains(&number) {
            sum += wild(&contact);
        }
    }
    sum
}

/// Log density of the usable contacts of a grasp that have these numbers among them, if each number felt (a
/// distance, an angle) has so many nats less than where it is exactly what was expected.
#[inline(never)]
pub(crate) fn all_short_by<S: Space>(
    grasp: &GraspView<'_, S>,
    numbers: Range<usize>,
    nats: f32,
) -> f32 {
    /// ln √(2π).
    const ROOT: f32 = 0.918_938_5;
    let felt = |deviation: f32| -ROOT - nats - math::ln(deviation);
    let mut sum = 0.0;
    for (number, contact) in grasp.usable().enumerate() {
        if numbers.contains(&number) {
            let angles = if contact.normal.is_some() { (S::DIMENSION - 1) as f32 } else { 0.0 };
            sum += felt(contact.point_deviation) + angles * felt(contact.normal_deviation);
        }
    }
    sum
}

/// ln(eᵃ + eᵇ).
pub(crate) fn log_sum(a: f32, b: f32) -> f32 {
    let (most, least) = if a > b { (a, b) } else { (b, a) };
    if least == f32::NEG_INFINITY { most } else { most + math::ln(1.0 + math::exp(least - most)) }
}

/// A tracker that says how well it foretold what was felt.
pub trait Evidence<S: Space>: Tracker<S> {
    /// Log density of all grasps after the first, each given those before: the sum since the last reset
    /// (natural logarithm; see the [module](self)).
    fn evidence(&self) -> f32;
}

/// Which of two models is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Meant {
    /// The first.
    #[default]
    First,
    /// The second.
    Second,
}

/// Who learns the grasps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Learning {
    /// The first; what the second has to learn is kept.
    #[default]
    FirstUntilItFails,
    /// Both.
    Both,
    /// The first: the second is too far behind, or was never needed.
    First,
    /// The second: the first is too far behind.
    Second,
}

/// Two trackers, of which the second waits until the first fails to foretell what is felt: most objects
/// are of the first kind, and two trackers take the time of two.
///
/// While it waits, the last `GRASPS` grasps of at most `CONTACTS` contacts are kept for it, and once it is
/// needed it learns them all. From then on both learn every grasp; the estimate is that of the one whose
/// evidence is higher, where the other must be ahead by [`Self::MARGIN`] nats before it is heard. Nothing
/// restarts: each has its own poses from the beginning, about the same object frame, since both fix it
/// at the centroid of the first contacts. One that is [`Self::BEHIND`] learns no more, and nor does a
/// second that was not needed for `GRASPS` grasps, at least half of which felt the object.
///
/// [`recall`](Tracker::recall) answers with the trajectory of the model that is meant now.
#[derive(Clone, Debug)]
pub struct Automatic<S: Space, A, B, const GRASPS: usize, const CONTACTS: usize> {
    first: A,
    second: B,
    meant: Meant,
    learning: Learning,
    held: Held<S, GRASPS, CONTACTS>,
    patience: Patience,
    /// Evidence of the second over the first when both learnt last, nats.
    ahead: f32,
}

impl<S: Space, A, B, const GRASPS: usize, const CONTACTS: usize>
    Automatic<S, A, B, GRASPS, CONTACTS>
{
    /// Nats (a Bayes factor of twenty: "strong", Kass & Raftery 1995) by which the other model must
    /// be ahead.
    pub const MARGIN: f32 = 3.0;

    /// Nats that no model makes good again.
    pub const BEHIND: f32 = 50.0;

    /// `first` speaks until `second` is ahead.
    pub const fn new(first: A, second: B) -> Self {
        Automatic {
            first,
            second,
            meant: Meant::First,
            learning: Learning::FirstUntilItFails,
            held: Held::new(),
            patience: Patience::new(),
            ahead: 0.0,
        }
    }

    /// Which model is meant.
    pub fn meant(&self) -> Meant {
        self.meant
    }

    /// Who learns the next grasp.
    pub fn learning(&self) -> Learning {
        self.learning
    }

    /// Evidence of the second model over the first after the last grasp that both learnt, nats; zero
    /// before.
    pub fn advantage(&self) -> f32 {
        self.ahead
    }

    /// The first tracker.
    pub fn first(&self) -> &A {
        &self.first
    }

    /// The first tracker, to configure it; [`Tracker::reset`] afterwards.
    pub fn first_mut(&mut self) -> &mut A {
        &mut self.first
    }

    /// The second tracker.
    pub fn second(&self) -> &B {
        &self.second
    }

    /// The second tracker, to configure it; [`Tracker::reset`] afterwards.
    pub fn second_mut(&mut self) -> &mut B {
        &mut self.second
    }
}

impl<S, A, B, const GRASPS: usize, const CONTACTS: usize> Automatic<S, A, B, GRASPS, CONTACTS>
where
    S: Space,
    A: Evidence<S>,
    B: Evidence<S>,
{
    /// One grasp for the first while the second waits.
    #[inline(never)]
    fn alone(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        let before = self.first.evidence();
        let first = self.first.update(motion, grasp);
        let room = self.held.push(motion, &grasp);
        let over = self.patience.is_over(&first, &grasp, self.first.evidence() - before);
        let full = self.held.is_full();
        // A first that was hardly put to the test does not make the second needless.
        if over || !room || full && 2 * self.patience.tests() < GRASPS {
            let mut second = self.held.learnt(&mut self.second);
            if !room {
                second = Some(self.second.update(motion, grasp));
            }
            self.learning = Learning::Both;
            return self.heard(first, second.unwrap_or(first));
        }
        if full {
            self.held.clear();
            self.learning = Learning::First;
        }
        first
    }

    /// What the one says that is meant; and who will go on.
    fn heard(&mut self, first: Estimate<S>, second: Estimate<S>) -> Estimate<S> {
        let ahead = self.second.evidence() - self.first.evidence();
        self.ahead = ahead;
        match self.meant {
            Meant::First if ahead > Self::MARGIN => self.meant = Meant::Second,
            Meant::Second if ahead < -Self::MARGIN => self.meant = Meant::First,
            _ => {}
        }
        if ahead.abs() > Self::BEHIND {
            self.learning = if ahead > 0.0 { Learning::Second } else { Learning::First };
        }
        match self.meant {
            Meant::First => first,
            Meant::Second => second,
        }
    }
}

impl<S, A, B, const GRASPS: usize, const CONTACTS: usize> Tracker<S>
    for Automatic<S, A, B, GRASPS, CONTACTS>
where
    S: Space,
    A: Evidence<S>,
    B: Evidence<S>,
{
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S> {
        match self.learning {
            Learning::FirstUntilItFails => self.alone(motion, grasp),
            Learning::First => self.first.update(motion, grasp),
            Learning::Second => self.second.update(motion, grasp),
            Learning::Both => {
                let first = self.first.update(motion, grasp);
                let second = self.second.update(motion, grasp);
                self.heard(first, second)
            }
        }
    }

    fn reset(&mut self, seed: u64) {
        self.first.reset(seed);
        self.second.reset(seed);
        (self.meant, self.learning) = (Meant::First, Learning::FirstUntilItFails);
        self.held.clear();
        (self.patience, self.ahead) = (Patience::new(), 0.0);
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        self.first.set_motion_noise(noise);
        self.second.set_motion_noise(noise);
    }

    fn recall(&self, grasp: u32) -> Option<S::Pose> {
        match self.meant {
            Meant::First => self.first.recall(grasp),
            Meant::Second => self.second.recall(grasp),
        }
    }
}

impl<S, A, B, const GRASPS: usize, const CONTACTS: usize> Evidence<S>
    for Automatic<S, A, B, GRASPS, CONTACTS>
where
    S: Space,
    A: Evidence<S>,
    B: Evidence<S>,
{
    /// Of the model that is meant.
    fn evidence(&self) -> f32 {
        match self.meant {
            Meant::First => self.first.evidence(),
            Meant::Second => self.second.evidence(),
        }
    }
}
