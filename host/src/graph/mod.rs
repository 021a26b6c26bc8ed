//! The back end: graphs that correct a whole trajectory at once, after the tracker.
//!
//! A tracker that goes forward only keeps the mistakes it made when it knew little. The thesis (3.3.3)
//! corrects them by a graph whose edges are relative poses between pairs of similar grasps; five
//! contacts then serve many edges ([`pairwise`]). In the [`joint`] graph nothing is counted twice:
//! contacts measure faces from poses.
//!
//! [`pose`] is the optimiser for pose graphs of any origin (`tactile optimize` on a `.g2o` file).

pub mod joint;
pub mod pairwise;
pub mod pose;

use crate::log::GraspLog;
use crate::model::Faces;
use crate::slam::track::Step;

/// The corrections on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// Poses and flat faces, or a smooth surface, estimated together; from eight grasps on
    Planes,
    /// Relative poses between grasps that felt the same faces (thesis 3.3.3)
    Pairwise,
    /// None: the tracker's poses stand
    None,
}

impl Kind {
    /// The log's steps corrected; `None` where they stand.
    pub fn correct(self, log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
        match self {
            Kind::Planes => Some(Corrected::jointly(log, joint::correct(log, steps)?)),
            Kind::Pairwise => {
                let found = pairwise::correct(log, steps)?;
                let relative = found.relative();
                Some(Corrected { steps: found.steps, relative, faces: None })
            }
            Kind::None => None,
        }
    }
}

/// A trajectory after its correction.
#[derive(Clone, Debug)]
pub struct Corrected {
    /// With the poses' marginal covariances: how uncertain they are in the frame of the first grasp.
    pub steps: Vec<Step>,
    /// The same with how uncertain contacts are beside each other, to make a shape of.
    pub relative: Vec<Step>,
    /// The faces that were estimated with the poses, where the object has any; with the contacts of the
    /// log at `relative` ([`crate::slam::reconstruct::reconstruct_known`]).
    pub faces: Option<Faces>,
}

impl Corrected {
    /// What the joint graph found of the log.
    pub fn jointly(log: &GraspLog, found: joint::Corrected) -> Corrected {
        let (relative, faces) = (found.relative(), found.shape(log));
        Corrected { steps: found.steps, relative, faces }
    }
}
