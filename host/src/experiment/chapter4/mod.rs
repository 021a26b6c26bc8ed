//! The thesis' figures of chapter 4 about uncertainty, contact areas and simulated actions, as pictures
//! and numbers. Pictures show seed 0; the numbers are over all seeds.

mod actions;
mod areas;
mod uncertainty;

use serde::Serialize;

use super::figure::{Drawn, FigureError};
use crate::explore::Belief;
use crate::shape::Geometry;
use crate::sim::{Options, simulate};
use crate::slam::track;

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

/// The numbers of a figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Numbers {
    /// Of figure 4.1.
    Measures {
        /// Row by row.
        lines: Vec<Measure>,
    },
    /// Of figure 4.3.
    Divisions {
        /// Row by row.
        lines: Vec<Division>,
    },
    /// Of figures 4.6 and 4.7.
    Actions {
        /// Row by row.
        lines: Vec<Action>,
    },
}

impl Figure {
    /// Makes the figure with seeds from 0 on.
    ///
    /// # Errors
    /// When an object cannot be simulated, seed 0 makes no surface, or the picture cannot be drawn.
    pub fn draw(&self, seeds: u64) -> Result<Drawn<Numbers>, FigureError> {
        let (numbers, picture) = match self.view {
            View::Uncertainty => {
                let lines = uncertainty::measure(seeds)?;
                (Numbers::Measures { lines }, uncertainty::picture(self.title)?)
            }
            View::Areas => {
                let lines = areas::divide(seeds)?;
                (Numbers::Divisions { lines }, areas::picture(self.title)?)
            }
            View::Actions => {
                let lines = actions::judge(seeds)?;
                (Numbers::Actions { lines }, actions::grasps(self.title)?)
            }
            View::Poses => {
                let lines = actions::judge(seeds)?;
                (Numbers::Actions { lines }, actions::poses(self.title)?)
            }
        };
        Ok(Drawn { title: self.title, thesis: self.thesis, numbers, picture })
    }
}

impl std::fmt::Display for Numbers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Numbers::Measures { lines } => uncertainty::show(f, lines),
            Numbers::Divisions { lines } => areas::show(f, lines),
            Numbers::Actions { lines } => actions::show(f, lines),
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
