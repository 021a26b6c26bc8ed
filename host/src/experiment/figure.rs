//! What every figure of the thesis comes as: its title, what the thesis says of it, our numbers and a
//! picture.

use std::fmt;

use serde::Serialize;

use super::tracking::mujoco;
use crate::explore::episode;
use crate::sim::SimError;
use crate::slam::reconstruct;
use crate::view::drawing::{Drawing, PictureError};

/// A figure's numbers and its picture. `N` prints itself as whole lines, and its fields stand beside the
/// title in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drawn<N> {
    /// What is shown.
    pub title: &'static str,
    /// What the thesis says of it.
    pub thesis: &'static str,
    /// The numbers.
    #[serde(flatten)]
    pub numbers: N,
    /// The picture.
    #[serde(skip)]
    pub picture: Drawing,
}

impl<N: fmt::Display> fmt::Display for Drawn<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n  thesis: {}\n{}", self.title, self.thesis, self.numbers)
    }
}

/// Why a figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// Nothing to touch.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// No recordings.
    #[error(transparent)]
    Recordings(#[from] mujoco::Error),
    /// Nothing came of an exploration.
    #[error(transparent)]
    Exploration(#[from] episode::Error),
    /// What was felt makes no surface.
    #[error(transparent)]
    Surface(#[from] reconstruct::Error),
    /// Nothing to see.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Two {
        lines: [u32; 2],
    }

    impl fmt::Display for Two {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "  {} {}", self.lines[0], self.lines[1])
        }
    }

    #[test]
    fn numbers_stand_below_what_the_thesis_says_and_beside_it_in_json() {
        let numbers = Two { lines: [1, 2] };
        let (title, thesis, picture) = ("Figure 1", "rounded", Drawing::default());
        let drawn = Drawn { title, thesis, numbers, picture };
        assert_eq!(drawn.to_string(), "Figure 1\n  thesis: rounded\n  1 2");
        let json = serde_json::to_value(&drawn).unwrap();
        assert_eq!(
            json,
            serde_json::json!({ "title": "Figure 1", "thesis": "rounded", "lines": [1, 2] })
        );
    }
}
