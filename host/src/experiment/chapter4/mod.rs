//! The thesis' figures of chapter 4 about uncertainty, contact areas and simulated actions, as pictures
//! and numbers. Pictures show seed 0; the numbers are over all seeds.

mod actions;
mod areas;
mod uncertainty;

use serde::Serialize;

use crate::explore::Belief;
use crate::shape::Geometry;
use crate::sim::{Options, SimError, simulate};
use crate::slam::{reconstruct, track};
use crate::view::drawing::{Drawing, PictureError};

pub use actions::Action;
pub use areas::Division;
pub use uncertainty::Measure;

/// What a figure shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// As the command line names it.
    pub name: &'static str,
    title: &'static str,
    view: View,
    /// What the thesis says.
    thesis: &'static str,
}

#[derive(Clone, Copy, Debug)]
enum View {
    /// A cube in three measures of uncertainty.
    Uncertainty,
    /// Contact areas.
    Areas,
    /// Three grasps that could be made.
    Actions,
    /// Where the object could be after each of them.
    Poses,
}

/// All of them, in the thesis' order.
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "figure-4.1",
        title: "Figure 4.1: uncertainty of a cube after five contacts, in three ways",
        view: View::Uncertainty,
        thesis: "entropy “similar” to the variance; IGEF high near contacts, low away from them",
    },
    Figure {
        name: "figure-4.3",
        title: "Figure 4.3: contact areas after two grasps",
        view: View::Areas,
        thesis: "picture only; areas “must not be spread”",
    },
    Figure {
        name: "figure-4.6",
        title: "Figure 4.6: three grasps that could tell more about the pose",
        view: View::Actions,
        thesis: "drawing only",
    },
    Figure {
        name: "figure-4.7",
        title: "Figure 4.7: where the object could be, before and after each of them",
        view: View::Poses,
        thesis: "the KL divergence shows which action allows “gaining the maximum information”",
    },
];

/// The figure of that name.
pub fn figure(name: &str) -> Option<&'static Figure> {
    FIGURES.iter().find(|f| f.name == name)
}

/// What came of a figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Numbers {
    /// Of figure 4.1.
    Measures(Vec<Measure>),
    /// Of figure 4.3.
    Divisions(Vec<Division>),
    /// Of figures 4.6 and 4.7.
    Actions(Vec<Action>),
}

/// A figure's numbers and its picture.
#[derive(Clone, Debug, Serialize)]
pub struct Drawn {
    /// What is shown.
    pub title: &'static str,
    /// What the thesis says of it.
    pub thesis: &'static str,
    /// The numbers.
    pub lines: Numbers,
    /// The picture.
    #[serde(skip)]
    pub picture: Drawing,
}

/// Why a figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// Nothing to touch.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// What was felt makes no surface.
    #[error(transparent)]
    Surface(#[from] reconstruct::Error),
    /// Nothing to see.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

impl Figure {
    /// Makes the figure with seeds from 0 on.
    ///
    /// # Errors
    /// When an object cannot be simulated, seed 0 makes no surface, or the picture cannot be drawn.
    pub fn draw(&self, seeds: u64) -> Result<Drawn, FigureError> {
        let (lines, picture) = match self.view {
            View::Uncertainty => {
                (Numbers::Measures(uncertainty::measure(seeds)?), uncertainty::picture(self.title)?)
            }
            View::Areas => (Numbers::Divisions(areas::divide(seeds)?), areas::picture(self.title)?),
            View::Actions => {
                (Numbers::Actions(actions::judge(seeds)?), actions::grasps(self.title)?)
            }
            View::Poses => (Numbers::Actions(actions::judge(seeds)?), actions::poses(self.title)?),
        };
        Ok(Drawn { title: self.title, thesis: self.thesis, lines, picture })
    }
}

impl std::fmt::Display for Drawn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.title)?;
        writeln!(f, "  thesis: {}", self.thesis)?;
        match &self.lines {
            Numbers::Measures(lines) => uncertainty::show(f, lines),
            Numbers::Divisions(lines) => areas::show(f, lines),
            Numbers::Actions(lines) => actions::show(f, lines),
        }
    }
}

/// What is known of an object at its true poses, in its true frame, and its true shape.
fn touched(options: &Options) -> Result<(Belief, Geometry), FigureError> {
    let simulation = simulate(options)?;
    let steps = track::truth(&simulation.log).unwrap_or_default();
    Ok((Belief::new(&simulation.log, &steps)?, simulation.geometry))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_thesis_own() {
        for number in [1, 3, 6, 7] {
            assert!(figure(&format!("figure-4.{number}")).is_some());
        }
        assert!(figure("figure-4.8").is_none());
    }
}
