//! Pose graphs: the optimiser for relative measurements between poses, in SE(2) and SE(3).
//!
//! x* = argmin Σ ρ(eᵀ Ω e), where e compares a measured relative pose with x_from⁻¹ x_to (thesis 3.20,
//! as corrected) and ρ is the identity or a robust kernel. χ² is Σ eᵀ Ω e, without ½.
//!
//! Nothing here knows of contacts: a graph comes from a `.g2o` file or from the tactile front end.

mod blocks;
pub mod certificate;
mod check;
pub mod chordal;
mod consensus;
mod curvature;
mod cycles;
mod descent;
pub mod diagnosis;
pub mod error;
mod evidence;
pub mod g2o;
pub mod global;
pub mod gnc;
#[cfg(test)]
pub(crate) mod grid;
pub mod group;
pub mod incremental;
pub mod kernel;
pub mod marginals;
mod normal;
pub mod odometry;
pub mod optimizer;
mod part;
pub mod rigid;
pub mod sparse;
mod spread;
pub mod start;

pub use error::Error;
pub use group::{Group, Linearised, Se2, Se3};
pub use incremental::{FixedLag, Incremental};
pub use kernel::Kernel;
pub use marginals::{Marginals, marginals};
pub use normal::Limit;
pub use optimizer::{Iteration, Method, Optimizer, Options, Stop, Summary, optimize};
pub use rigid::Rigid;
pub use start::Start;

use nalgebra::SMatrix;

/// A relative measurement: `measured` ≈ poses\[from]⁻¹ · poses\[to].
#[derive(Clone, Debug, PartialEq)]
pub struct Edge<G, const D: usize> {
    /// Index of the pose it is seen from.
    pub from: usize,
    /// Index of the pose that is seen.
    pub to: usize,
    /// `to` in the axes of `from`.
    pub measured: G,
    /// Ω, inverse covariance of the error: translation first, then rotation; 1/m² and 1/rad² (in space
    /// the error's rotation is the quaternion's vector, half the angle; see [`Group::error`]).
    pub information: SMatrix<f64, D, D>,
}

/// Poses and what was measured between them.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseGraph<G, const D: usize> {
    /// Names of the poses in their file, all different.
    pub ids: Vec<u64>,
    /// Current estimates, body to world; as many as `ids`.
    pub poses: Vec<G>,
    /// Measurements; `from` and `to` are below `poses.len()` and differ.
    pub edges: Vec<Edge<G, D>>,
    /// Indices of poses that stay where they are. Where a connected part has none, the solver holds its
    /// first pose.
    pub fixed: Vec<usize>,
}

impl<G, const D: usize> Default for PoseGraph<G, D> {
    fn default() -> Self {
        Self { ids: Vec::new(), poses: Vec::new(), edges: Vec::new(), fixed: Vec::new() }
    }
}

/// A planar pose graph.
pub type PoseGraph2 = PoseGraph<Se2, 3>;

/// A spatial pose graph.
pub type PoseGraph3 = PoseGraph<Se3, 6>;

impl<G: Group<D>, const D: usize> PoseGraph<G, D> {
    /// χ² = Σ eᵀ Ω e at the current poses.
    pub fn chi2(&self) -> f64 {
        self.edges.iter().fold(0.0, |sum, edge| sum + edge.chi2(&self.poses))
    }
}

impl<G: Group<D>, const D: usize> Edge<G, D> {
    /// eᵀ Ω e at `poses`.
    pub fn chi2(&self, poses: &[G]) -> f64 {
        let error = G::error(&poses[self.from], &poses[self.to], &self.measured);
        error.dot(&(self.information * error))
    }
}

#[cfg(test)]
mod tests;
