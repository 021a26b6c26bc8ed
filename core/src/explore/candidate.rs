//! A grasp that might be made.

use core::fmt;

use heapless::Vec;

use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

/// Fingers that a candidate may have.
pub const FINGERS: usize = 5;

/// The straight way of one fingertip while the hand closes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke<S: Space> {
    /// Where it begins, metres.
    pub start: S::Vector,
    /// Unit.
    pub direction: S::Vector,
    /// How far the fingertip can go, metres.
    pub travel: f32,
}

impl<S: Space> Stroke<S> {
    /// The same way in the frame that `frame` maps to.
    pub fn seen_from(&self, frame: &S::Pose) -> Self {
        Stroke {
            start: frame.transform(self.start),
            direction: frame.rotate(self.direction),
            travel: self.travel,
        }
    }

    /// Where the fingertip is after so many metres.
    pub fn at(&self, along: f32) -> S::Vector {
        self.start + self.direction * along
    }
}

/// A grasp that might be made: where the hand would be, and the ways of its fingertips when it closes.
///
/// The hand's pose is in the *world*, the one frame that a board and its host share: the host may think
/// another way of the object's frame. The board lays it on the object where the object is expected to
/// be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate<S: Space> {
    /// Hand to world.
    pub hand: S::Pose,
    /// In the hand's frame, of each finger that closes.
    pub strokes: [Option<Stroke<S>>; FINGERS],
}

/// Why a candidate is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CandidateError {
    /// A number of the hand's pose is not finite.
    Hand,
    /// No finger closes.
    Empty,
    /// A stroke's start is not finite.
    Start,
    /// A stroke's direction is not finite, or its length not within 10⁻³ of one.
    Direction,
    /// A stroke's travel is not finite and positive.
    Travel,
}

impl fmt::Display for CandidateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            CandidateError::Hand => "the hand's pose must be finite",
            CandidateError::Empty => "at least one finger must close",
            CandidateError::Start => "a stroke must start at finite coordinates",
            CandidateError::Direction => "a stroke's direction must have length 1 within 0.001",
            CandidateError::Travel => "a stroke's travel must be finite and positive",
        })
    }
}

impl core::error::Error for CandidateError {}

impl<S: Space> Candidate<S> {
    /// A hand with no finger that closes.
    pub const fn new(hand: S::Pose) -> Self {
        Candidate { hand, strokes: [None; FINGERS] }
    }

    /// The candidate with directions scaled to exactly one.
    ///
    /// # Errors
    /// What cannot be used.
    pub fn checked(mut self) -> Result<Self, CandidateError> {
        if !self.hand.is_finite() {
            return Err(CandidateError::Hand);
        }
        let mut closing = false;
        for stroke in self.strokes.iter_mut().flatten() {
            closing = true;
            if !stroke.start.is_finite() {
                return Err(CandidateError::Start);
            }
            if !((stroke.direction.norm() - 1.0).abs() <= 1e-3) {
                return Err(CandidateError::Direction);
            }
            stroke.direction = stroke.direction.normalized().ok_or(CandidateError::Direction)?;
            if !(stroke.travel > 0.0 && stroke.travel.is_finite()) {
                return Err(CandidateError::Travel);
            }
        }
        if closing { Ok(self) } else { Err(CandidateError::Empty) }
    }
}

/// Why a candidate has no place in a list; the list is as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListError {
    /// The candidate before it is missing.
    Gap,
    /// The list has no such place.
    Full,
}

/// The candidates for the next grasp, at most `N` (16 at most).
#[derive(Clone, Debug)]
pub struct Candidates<S: Space, const N: usize> {
    list: Vec<Candidate<S>, N>,
}

impl<S: Space, const N: usize> Candidates<S, N> {
    const FITS: () = assert!(N > 0 && N <= 16, "1 to 16 candidates");

    /// None.
    pub const fn new() -> Self {
        let () = Self::FITS;
        Candidates { list: Vec::new() }
    }

    /// In the order of their numbers.
    pub fn as_slice(&self) -> &[Candidate<S>] {
        &self.list
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.list.clear();
    }

    /// Puts a candidate in its place: number 0 begins a new list, the number after the last adds to it,
    /// and a number in between replaces.
    ///
    /// # Errors
    /// A number that leaves a gap, or is beyond the list's end.
    pub fn put(&mut self, number: usize, candidate: Candidate<S>) -> Result<(), ListError> {
        if number == 0 {
            self.list.clear();
        }
        if number >= N {
            return Err(ListError::Full);
        }
        if number > self.list.len() {
            return Err(ListError::Gap);
        }
        if let Some(place) = self.list.get_mut(number) {
            *place = candidate;
            return Ok(());
        }
        self.list.push(candidate).map_err(|_| ListError::Full)
    }
}

impl<S: Space, const N: usize> Default for Candidates<S, N> {
    fn default() -> Self {
        Self::new()
    }
}
