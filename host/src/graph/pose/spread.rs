//! How uncertain a graph's optimum leaves what an edge measures.

use nalgebra::SMatrix;

use super::error::Error;
use super::group::Linearised;
use super::kernel::Kernel;
use super::normal::Cost;
use super::optimizer::Optimizer;
use super::sparse::{Paths, SelectedInverse};
use super::{Group, PoseGraph};

/// Covariances J H⁻¹ Jᵀ of the errors of edges, in the graph or not, about an optimum.
pub(super) struct Spread<'o, const D: usize> {
    optimizer: &'o Optimizer<D>,
    selected: SelectedInverse<D>,
    paths: Paths<D>,
}

impl<'o, const D: usize> Spread<'o, D> {
    /// About the poses of `graph` with a weight for each of its edges.
    ///
    /// # Errors
    /// A pose that the measurements do not determine; a graph too dense to factorise.
    pub fn new<G: Group<D>>(
        optimizer: &'o mut Optimizer<D>,
        graph: &PoseGraph<G, D>,
        weights: &[f64],
    ) -> Result<Self, Error> {
        let cost = Cost { kernel: Kernel::Identity, weights: Some(weights) };
        optimizer.factorise_at(graph, cost)?;
        let structure = &optimizer.layout.structure;
        if !structure.is_complete() {
            return Err(Error::TooDense);
        }
        let selected = SelectedInverse::new(structure, &optimizer.factor);
        Ok(Spread { selected, paths: Paths::new(structure), optimizer })
    }

    /// The covariance of the error between two poses that was linearised as `at`.
    pub fn of(&mut self, from: usize, to: usize, at: &Linearised<D>) -> SMatrix<f64, D, D> {
        let structure = &self.optimizer.layout.structure;
        let (a, b) = (self.optimizer.layout.position(from), self.optimizer.layout.position(to));
        let own = |position: Option<usize>, by: &SMatrix<f64, D, D>| {
            let block = position.and_then(|p| self.selected.block(structure, p, p));
            block.map_or_else(SMatrix::zeros, |block| by * block * by.transpose())
        };
        let (Some(a), Some(b)) = (a, b) else { return own(a, &at.from) + own(b, &at.to) };
        match self.selected.block(structure, a, b) {
            Some(block) => {
                let cross = at.from * block * at.to.transpose();
                own(Some(a), &at.from) + own(Some(b), &at.to) + cross + cross.transpose()
            }
            None => {
                let right = [(a, at.from.transpose()), (b, at.to.transpose())];
                self.paths.form(structure, &self.optimizer.factor, &right)
            }
        }
    }

    /// A matrix that is no less than [`of`](Self::of), for a fraction of the work:
    /// Cov(a + b) ≤ 2 Cov(a) + 2 Cov(b).
    pub fn bound(&self, from: usize, to: usize, at: &Linearised<D>) -> SMatrix<f64, D, D> {
        let layout = &self.optimizer.layout;
        let own = |pose: usize, by: &SMatrix<f64, D, D>| {
            let position = layout.position(pose);
            let block = position.and_then(|p| self.selected.block(&layout.structure, p, p));
            block.map_or_else(SMatrix::zeros, |block| by * block * by.transpose() * 2.0)
        };
        own(from, &at.from) + own(to, &at.to)
    }
}
