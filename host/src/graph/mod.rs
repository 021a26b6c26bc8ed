//! The back end: graphs that correct a whole trajectory at once, after the tracker.
//!
//! A tracker that goes forward only keeps the mistakes it made when it knew little. The thesis (3.3.3)
//! corrects them by a graph whose edges are relative poses between pairs of similar grasps; five
//! contacts then serve many edges as if they were independent. In the [`joint`] graph nothing is
//! counted twice: contacts measure faces from poses.
//!
//! [`pose`] is the optimiser for pose graphs of any origin (`tactile optimize` on a `.g2o` file).

pub mod joint;
pub mod pose;

pub use joint::Corrected;

use crate::log::GraspLog;
use crate::slam::track::Step;

/// The corrections on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// Poses and flat faces, or a smooth surface, estimated together; from eight grasps on
    Planes,
    /// None: the tracker's poses stand
    None,
}

impl Kind {
    /// The log's steps corrected; `None` where they stand.
    pub fn correct(self, log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
        match self {
            Kind::Planes => joint::correct(log, steps),
            Kind::None => None,
        }
    }
}
