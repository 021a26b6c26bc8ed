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

    /// Moves the poses to the most promising start, and says which that is.
    ///
    /// Poses that agree with their measurements as well as noise lets any (χ² at most the measured
    /// numbers less those that the poses need) stay. Else it is the chordal relaxation, which is near the
    /// global minimum where odometry ends in a local one; where it does not exist or costs more, the
    /// poses as they are.
    pub fn best<G: Rigid<D, N>, const D: usize, const N: usize>(
        graph: &mut PoseGraph<G, D>,
    ) -> Start {
        let given = graph.chi2();
        let degrees = D * (graph.edges.len() + 1).saturating_sub(graph.poses.len());
        if given <= degrees as f64 {
            return Start::File;
        }
        let Ok(poses) = chordal(graph) else { return Start::File };
        let file = std::mem::replace(&mut graph.poses, poses);
        if graph.chi2() <= given {
            return Start::Chordal;
        }
        graph.poses = file;
        Start::File
    }
}
