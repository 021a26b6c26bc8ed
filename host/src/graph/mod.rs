//! Global correction: all grasps and the object's faces estimated together, after the tracker.
//!
//! A tracker that goes forward only keeps the mistakes it made when it knew little. The thesis (3.3.3)
//! corrects them by a graph whose edges are relative poses between pairs of similar grasps; five
//! contacts then serve many edges as if they were independent. Here nothing is counted twice: every
//! contact is one measurement of one face from one pose, and poses, faces and motions are solved in one
//! least-squares problem (planar SLAM: Kaess, ICRA 2015; the sparsity is that of bundle adjustment,
//! Triggs et al. 2000).
//!
//! [`planes`](mod@planes) is the entrance. Below it, [`problem`] holds the measurements and the
//! unknowns, [`factors`] their residuals and derivatives, [`solve`](mod@solve) the
//! Levenberg–Marquardt iteration on the structure that [`arrow`] exploits and the evidence of what it
//! finds, to which [`size`] belongs. [`explain`] and [`alias`] decide which contact lies on which face
//! and at which of several look-alike poses a grasp was made, [`retrack`] builds a trajectory of its
//! own, and [`surface`] does for curved objects what faces do for flat ones.

pub mod alias;
pub mod arrow;
pub mod explain;
pub mod factors;
pub mod planes;
pub mod problem;
pub mod retrack;
pub mod size;
pub mod solve;
pub mod surface;
pub mod tangent;

pub use planes::{Corrected, Effort, Plane, planes};

use crate::log::GraspLog;
use crate::reference::Contact;
use crate::slam::choose;
use crate::slam::reconstruct::place;
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
            Kind::Planes => correct(log, steps),
            Kind::None => None,
        }
    }
}

/// Grasps from which on poses are corrected. Of fewer, many sets of poses lay all contacts on a few
/// faces, the fewest faces win, and what comes of it looks more certain than it is.
const ENOUGH: usize = 8;

/// By faces where the object that they make is to be believed ([`choose::judge`]), else by the smooth
/// surface of least cost, whether it starts from the tracker's poses or from those of the faces.
fn correct(log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
    if log.grasps.len() < ENOUGH {
        return None;
    }
    let flat = planes(log, &[steps], Effort::default());
    let believed = |flat: &Corrected| {
        let contacts = place(log, &flat.relative());
        let contacts: Vec<Contact> = contacts.into_iter().map(|p| p.contact).collect();
        choose::judge(log.dimension, &contacts, &[]).is_ok()
    };
    if flat.as_ref().is_some_and(believed) {
        return flat;
    }
    let starts: Vec<&[Step]> =
        std::iter::once(steps).chain(flat.as_ref().map(|f| &f.steps[..])).collect();
    surface::smooth(log, &starts).or(flat)
}

#[cfg(test)]
mod tests;
