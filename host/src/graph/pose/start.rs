//! Where a descent starts.

use super::chordal::chordal;
use super::odometry::odometry;
use super::{Error, PoseGraph, Rigid};

/// The initial values on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Start {
    /// The file's poses
    File,
    /// Rotations, then translations, each by linear least squares
    Chordal,
    /// Measurements composed along the odometry
    Odometry,
}

impl Start {
    /// Its word on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Start::File => "file",
            Start::Chordal => "chordal",
            Start::Odometry => "odometry",
        }
    }

    /// Moves the poses there; those that are held stay.
    ///
    /// # Errors
    /// See [`chordal()`] and [`odometry()`]; the poses are as they were.
    pub fn place<G: Rigid<D, N>, const D: usize, const N: usize>(
        self,
        graph: &mut PoseGraph<G, D>,
    ) -> Result<(), Error> {
        match self {
            Start::File => (),
            Start::Chordal => graph.poses = chordal(graph)?,
            Start::Odometry => graph.poses = odometry(graph)?,
        }
        Ok(())
    }
}
