//! The hand that touches: idealised, with fingertips on straight ways, or articulated, from a URDF, with
//! links, joints and everything they can run into.
//!
//! A hand offers the ways of its fingertips ([`FingerPath`]), which exploration casts against the shape it
//! believes in, and closes on the true object. The idealised hand is that of the thesis' planar
//! experiments and works in the plane and in space; articulated hands work in space only, since a planar
//! object has no height to close around.

pub mod articulated;
pub mod closing;
pub mod collision;
pub mod kinematics;
pub mod probing;
pub mod urdf;

#[cfg(test)]
mod tests;

use std::sync::Arc;

pub use articulated::{Articulated, SPREADS};
pub use closing::Unreachable;
pub use collision::Surroundings;
pub use urdf::{HandError, Model};

use super::touch::{FINGERS, strokes};
use crate::space::Point;

/// What touches.
#[derive(Clone, Debug, Default)]
pub enum Hand {
    /// Four fingertips against a thumb on straight ways, with nothing behind them.
    #[default]
    Idealised,
    /// Links and joints.
    Articulated(Arc<Articulated>),
}

/// The way of a fingertip while the hand closes.
#[derive(Clone, Debug, PartialEq)]
pub struct FingerPath {
    /// Index of the hand's finger.
    pub finger: usize,
    /// Corners of the way of the fingertip's middle, metres, frame of the hand's placement: at least two.
    pub points: Vec<Point>,
    /// Of the fingertip, metres; 0 for the points of the idealised hand.
    pub radius: f64,
}

/// What carries a hand: an arm that reaches every palm pose within a ball about its shoulder, however
/// turned. Nothing of the arm itself can run into anything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arm {
    /// World frame, metres.
    pub shoulder: Point,
    /// Metres.
    pub reach: f64,
}

impl Default for Arm {
    /// One of 0.9 m, half a metre behind the middle of the table and 0.3 m above it.
    fn default() -> Arm {
        Arm { shoulder: Point::new(-0.5, 0.0, 0.3), reach: 0.9 }
    }
}

impl Hand {
    /// The names of the fingers, as in a log.
    pub fn fingers(&self) -> Vec<String> {
        match self {
            Hand::Idealised => FINGERS.map(String::from).to_vec(),
            Hand::Articulated(hand) => hand.fingers().iter().map(|f| f.name.clone()).collect(),
        }
    }

    /// The ways of the fingertips, frame of the placement, for a posture of this spread; the idealised
    /// hand starts so far out that no part of an object within `radius` metres of its middle is in its
    /// way.
    pub fn paths(&self, dimension: usize, spread: f64, radius: f64) -> Vec<FingerPath> {
        match self {
            Hand::Idealised => strokes(dimension, FINGERS.len(), radius, spread, 0.0)
                .into_iter()
                .map(|s| FingerPath {
                    finger: s.finger,
                    points: vec![s.start, s.start + s.travel * s.direction],
                    radius: 0.0,
                })
                .collect(),
            Hand::Articulated(hand) => hand.paths(spread).to_vec(),
        }
    }
}
