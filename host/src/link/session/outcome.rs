//! What comes back from a board.

use std::time::Duration;

use tactile_core::track::Observability;
use tactile_core::wire::{
    ContactFrame, Counters, EstimateFrame, Health, Hello, ModeFrame, WireSpace,
};

use crate::slam::track::{Step, six_by_six};
use crate::space::{Bridge, Pose};

/// What a board made of one grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspOutcome<S: WireSpace> {
    /// What the board believes.
    pub estimate: EstimateFrame<S>,
    /// The poses it held possible, heaviest first: asked for where the estimate is ambiguous.
    pub modes: Vec<ModeFrame<S>>,
    /// How it fares.
    pub health: Health,
    /// Contacts of the log that the board's grasp had no room for.
    pub not_sent: usize,
    /// Free points of the log that it had no room for.
    pub free_not_sent: usize,
    /// From the first frame of the grasp to the estimate.
    pub elapsed: Duration,
    /// What the board's own sensors added to the grasp.
    pub felt: Vec<ContactFrame<S>>,
}

/// What a finger of the board felt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeltContact<S: WireSpace> {
    /// When it was sampled, microseconds of the sensor's clock, wrapping.
    pub time: u32,
    /// What, in the world frame.
    pub contact: ContactFrame<S>,
}

/// What a board made of a whole log.
#[derive(Clone, Debug, PartialEq)]
pub struct LogOutcome<S: WireSpace> {
    /// Who answered.
    pub hello: Hello,
    /// One for every grasp of the log.
    pub grasps: Vec<GraspOutcome<S>>,
    /// What the host saw of the board's frames.
    pub received: Counters,
    /// Frames sent again.
    pub repeated: u32,
    /// Contacts of the log that the board was not told, but shown what its sensors read.
    pub shown: usize,
}

impl<S: Bridge + WireSpace> LogOutcome<S> {
    /// The estimated pose of every grasp, object to world.
    pub fn poses(&self) -> Vec<Pose> {
        // Sessions refuse estimates that are not finite.
        self.grasps.iter().filter_map(|g| g.estimate.pose()).map(|p| S::isometry(&p)).collect()
    }

    /// The estimates as [`crate::slam`] takes them.
    pub fn steps(&self) -> Vec<Step> {
        steps(&self.grasps)
    }
}

impl<S: Bridge + WireSpace> GraspOutcome<S> {
    /// The estimate as [`crate::slam`] takes it; `None` if it is not finite, which sessions refuse.
    pub fn step(&self) -> Option<Step> {
        let estimate = &self.estimate;
        let seen = estimate.eigenvalues();
        Some(Step {
            pose: S::isometry(&estimate.pose()?),
            covariance: six_by_six::<S>(&estimate.covariance()),
            status: estimate.status(),
            modes: self
                .modes
                .iter()
                .filter_map(ModeFrame::mode)
                .map(|m| (S::isometry(&m.pose), m.weight.into()))
                .collect(),
            effective_particles: estimate.effective_particles.into(),
            corrected: estimate.corrected(),
            observed: (0..S::FREEDOM).filter(|&i| seen[i] > Observability::<S>::THRESHOLD).count(),
            contacts: [estimate.contacts, estimate.rejected, estimate.dropped].map(usize::from),
        })
    }
}

/// Estimates as [`crate::slam`] takes them; those that are not finite are left out.
pub fn steps<S: Bridge + WireSpace>(grasps: &[GraspOutcome<S>]) -> Vec<Step> {
    grasps.iter().filter_map(GraspOutcome::step).collect()
}
