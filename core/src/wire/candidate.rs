//! Grasps that might be made, and which of them to make.

use serde::{Deserialize, Serialize};

use super::quantity::{WireSpace, nearest};
use crate::explore::{Candidate, CandidateError, Choice, Criterion, FINGERS, Stroke};

/// The way of one fingertip, in the hand's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct StrokeFrame<S: WireSpace> {
    /// Where it begins, micrometres.
    pub start: S::Point,
    /// Unit.
    pub direction: S::Normal,
    /// How far it can go, micrometres.
    pub travel: u32,
}

/// A grasp that might be made. In space, with five strokes that begin within a metre of the hand's
/// origin, at most 130 bytes on the wire; within 134 metres it fits in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CandidateFrame<S: WireSpace> {
    /// Its place in the list, from 0.
    pub number: u8,
    /// Hand to world.
    pub hand: S::Numbers,
    /// Of each finger that closes.
    pub strokes: [Option<StrokeFrame<S>>; FINGERS],
}

impl<S: WireSpace> CandidateFrame<S> {
    /// Packs candidate `number`.
    ///
    /// # Errors
    /// Where the candidate cannot be used, or a stroke is shorter than a micrometre.
    pub fn new(number: u8, candidate: &Candidate<S>) -> Result<Self, CandidateError> {
        let candidate = candidate.checked()?;
        let packed = |stroke: Stroke<S>| StrokeFrame {
            start: S::pack_point(stroke.start),
            direction: S::pack_normal(stroke.direction),
            travel: nearest(stroke.travel * 1e6).max(0) as u32,
        };
        let frame = CandidateFrame {
            number,
            hand: S::pack_pose(&candidate.hand),
            strokes: candidate.strokes.map(|stroke| stroke.map(packed)),
        };
        frame.candidate().map(|_| frame)
    }

    /// The candidate.
    ///
    /// # Errors
    /// Where a number of the pose is not finite, no finger closes, or a stroke has no length.
    pub fn candidate(&self) -> Result<Candidate<S>, CandidateError> {
        let hand = S::unpack_pose(self.hand).ok_or(CandidateError::Hand)?;
        let unpacked = |stroke: StrokeFrame<S>| Stroke {
            start: S::unpack_point(stroke.start),
            direction: S::unpack_normal(stroke.direction),
            travel: stroke.travel as f32 * 1e-6,
        };
        let strokes = self.strokes.map(|stroke| stroke.map(unpacked));
        Candidate { hand, strokes }.checked()
    }
}

/// Which candidate teaches most.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChoiceFrame {
    /// Its place in the list, from 0.
    pub number: u8,
    /// How many there were.
    pub considered: u8,
    /// How many contacts it may give.
    pub contacts: u8,
    /// By what it was chosen.
    pub criterion: Criterion,
    /// What it is worth: nats, or square metres.
    pub gain: f32,
}

impl ChoiceFrame {
    /// Packs a choice.
    pub fn new(choice: &Choice, criterion: Criterion) -> Self {
        ChoiceFrame {
            number: choice.index.min(255) as u8,
            considered: choice.considered.min(255) as u8,
            contacts: choice.contacts.min(255) as u8,
            criterion,
            gain: choice.gain,
        }
    }
}
