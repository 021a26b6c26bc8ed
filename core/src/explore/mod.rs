//! Which of a few grasps teaches most: active exploration (thesis chapter 4) within a board's means.
//!
//! ```text
//! candidate: a hand's pose and its fingers' strokes
//!   → Foresight::meet: the contact that each stroke would give, by the belief held, if any
//!   → Foresight::doubts: how uncertain their distances are, and how much of that is the pose's fault
//!   → worth: nats about the shape, over which of the fingers meet anything
//!   → choose: the best of them
//! ```
//!
//! The belief is a tracker's own: the faces of the best hypothesis ([`crate::track::hypotheses`]), or
//! the map that a bootstrap filter holds, where that answers for several points at once
//! ([`crate::surface::Joint`]).
//!
//! # What a grasp is worth
//!
//! The mutual information of its contacts and the shape, with the pose a nuisance that has to be learnt
//! from the same contacts:
//!
//! ```text
//! ½ log det(I + (S + JΣJᵀ)/σ²) − ½ log det(I + JΣJᵀ/σ²)
//! ```
//!
//! S is the joint covariance of the surface at the contacts, JΣJᵀ what the doubt about the pose *at the
//! next grasp* (motion noise included) does to them, σ the noise of a contact's point. Where shape and
//! pose are correlated, the first is the covariance of both together and Σ in the second that of the
//! pose if the shape were known. Sums of single variances, as thesis 4.20 has them, stand beside it
//! ([`Criterion::VarianceSum`]).
//!
//! A finger meets the object with the probability that it goes deeper into the believed body than the
//! doubt about the distance there is wide. Information is taken in expectation over which fingers meet,
//! each by itself: of a grasp whose hand is misplaced as a whole that makes too much of the mixed cases.
//! That a finger meets nothing is taken to teach nothing. Neither is what normals tell.
//!
//! Where nothing was touched there is something to learn, or no hand would ever go there: see
//! [`Foreseen`](crate::track::hypotheses::Foreseen) for faces, whose prior doubt grows with the distance
//! from what was touched; a Gaussian process, truncated or not, knows by itself.

mod candidate;
mod worth;

#[cfg(test)]
mod tests;

pub use candidate::{Candidate, CandidateError, Candidates, FINGERS, ListError, Stroke};
pub use worth::Doubts;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::space::{Pose, Space};

/// What a grasp is judged by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Criterion {
    /// Nats about the shape, the pose being a nuisance.
    #[default]
    Information,
    /// Sum of the surface's variances at the contacts times their chances, square metres: thesis 4.20.
    VarianceSum,
}

/// A contact that a finger would give, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting<S: Space, P> {
    /// Metres.
    pub point: S::Vector,
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// How deep in the body the finger would come if nothing stopped it, metres.
    pub depth: f32,
    /// Probability that the surface reaches here at all.
    pub share: f32,
    /// What else the belief has to know of it.
    pub place: P,
}

/// A belief that can tell what a finger would feel at the next grasp.
pub trait Foresight<S: Space> {
    /// What it remembers of a contact it has foretold.
    type Place: Copy;

    /// Object to world, as is to be expected.
    fn pose(&self) -> S::Pose;

    /// What a fingertip meets first on a way given in the object frame; `None` where that is nothing. A
    /// way that begins inside the body meets it at once.
    fn meet(&self, way: &Stroke<S>) -> Option<Meeting<S, Self::Place>>;

    /// How uncertain the contacts' distances to the surface are: at most [`FINGERS`] of them.
    fn doubts(&mut self, meetings: &[Meeting<S, Self::Place>]) -> Doubts;
}

/// The best of some candidates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Its place in the list, from 0.
    pub index: usize,
    /// What it is worth: nats, or square metres.
    pub gain: f32,
    /// How many contacts it may give.
    pub contacts: usize,
    /// How many candidates there were.
    pub considered: usize,
}

/// The candidate that is worth most to `belief`, the first of equals; `noise` is the standard deviation
/// of a contact's point in metres. `None` of an empty list. A candidate that meets nothing is worth 0.
///
/// ```
/// use tactile_core::contact::{Contact, GraspView};
/// use tactile_core::explore::{Candidate, Criterion, Stroke, choose};
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::{Planar, PlanarPose, Pose};
/// use tactile_core::surface::cholesky::packed;
/// use tactile_core::track::{Hypotheses, MotionNoise, Tracker};
///
/// // A square of 40 mm was felt above and below, near the middle of its sides.
/// let mut tracker = Hypotheses::<Planar, 4, 8, 19, { packed(19) }, 0>::new();
/// tracker.set_motion_noise(MotionNoise { translation: 1e-3, rotation: 0.02 });
/// let touch = |x: f32, y: f32| Contact {
///     point: Vector([x, 0.02 * y]),
///     normal: Some(Vector([0.0, y])),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
///     finger: 0,
/// };
/// let felt = [touch(-0.01, 1.0), touch(0.01, 1.0), touch(-0.01, -1.0), touch(0.01, -1.0)];
/// tracker.update(None, GraspView { contacts: &felt, free: &[] });
///
/// // Two fingers could close on it along y, or along x.
/// let pinch = |along: Vector<2>| {
///     let mut pinch = Candidate::new(PlanarPose::IDENTITY);
///     for (finger, side) in [1.0, -1.0].into_iter().enumerate() {
///         let start = along * (0.1 * side);
///         pinch.strokes[finger] = Some(Stroke { start, direction: along * -side, travel: 0.1 });
///     }
///     pinch
/// };
/// let candidates = [pinch(Vector([0.0, 1.0])), pinch(Vector([1.0, 0.0]))];
/// let mut belief = tracker.foresee(None).unwrap();
/// let choice = choose(&mut belief, &candidates, Criterion::Information, 1e-3).unwrap();
/// assert_eq!((choice.index, choice.contacts, choice.considered), (1, 2, 2));
/// ```
pub fn choose<S: Space, F: Foresight<S>>(
    belief: &mut F,
    candidates: &[Candidate<S>],
    criterion: Criterion,
    noise: f32,
) -> Option<Choice> {
    let considered = candidates.len();
    let mut best: Option<Choice> = None;
    for (index, candidate) in candidates.iter().enumerate() {
        let (gain, contacts) = worth(belief, candidate, criterion, noise);
        if best.is_none_or(|best| gain > best.gain) {
            best = Some(Choice { index, gain, contacts, considered });
        }
    }
    best
}

/// What a candidate is worth to `belief`, and how many contacts it may give; never negative, and 0 where
/// numbers overflow.
pub fn worth<S: Space, F: Foresight<S>>(
    belief: &mut F,
    candidate: &Candidate<S>,
    criterion: Criterion,
    noise: f32,
) -> (f32, usize) {
    let frame = belief.pose().inverse().compose(&candidate.hand);
    let mut meetings: Vec<Meeting<S, F::Place>, FINGERS> = Vec::new();
    for stroke in candidate.strokes.iter().flatten() {
        if let Some(meeting) = belief.meet(&stroke.seen_from(&frame)) {
            // As many as there are strokes, so that there is room.
            let _ = meetings.push(meeting);
        }
    }
    if meetings.is_empty() {
        return (0.0, 0);
    }
    let doubts = belief.doubts(&meetings);
    let mut chances = [0.0; FINGERS];
    for (i, (chance, meeting)) in chances.iter_mut().zip(&meetings).enumerate() {
        *chance = meeting.share * doubts.likely(i, meeting.depth);
    }
    let count = meetings.len();
    let gain = match criterion {
        Criterion::Information => doubts.information(&chances[..count], noise),
        Criterion::VarianceSum => doubts.variance_sum(&chances[..count]),
    };
    (if gain > 0.0 && gain.is_finite() { gain } else { 0.0 }, count)
}
