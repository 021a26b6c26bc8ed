//! The edges of a graph that count, and the poses that they alone lead to.

use super::chordal::chordal_in;
use super::odometry::Sets;
use super::optimizer::{Optimizer, Options};
use super::rigid::Rigid;
use super::{Error, Group, PoseGraph};

/// The edges of a graph that count.
pub(super) struct Part<G, const D: usize> {
    pub graph: PoseGraph<G, D>,
    /// Their indices in the whole graph.
    pub edges: Vec<usize>,
    pub weights: Vec<f64>,
}

impl<G: Group<D>, const D: usize> Part<G, D> {
    /// Those that are accepted.
    pub fn new(whole: &PoseGraph<G, D>, accepted: &[bool]) -> Self {
        let edges: Vec<usize> = (0..accepted.len()).filter(|&edge| accepted[edge]).collect();
        let graph = PoseGraph {
            ids: whole.ids.clone(),
            poses: whole.poses.clone(),
            edges: edges.iter().map(|&edge| whole.edges[edge].clone()).collect(),
            fixed: whole.fixed.clone(),
        };
        Part { weights: vec![1.0; edges.len()], graph, edges }
    }

    /// Poses to the chordal relaxation where that costs less.
    pub fn relax<const N: usize>(&mut self, optimizer: &Optimizer<D>) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let Ok(poses) = chordal_in(&self.graph, &optimizer.layout, None) else {
            return Ok(());
        };
        let before = self.graph.chi2();
        let old = std::mem::replace(&mut self.graph.poses, poses);
        if !(self.graph.chi2() < before) {
            self.graph.poses = old;
        }
        Ok(())
    }

    /// Poses towards the optimum of the weighted edges.
    pub fn solve(&mut self, optimizer: &mut Optimizer<D>, iterations: usize) -> Result<(), Error> {
        let options = Options { max_iterations: iterations, ..Options::default() };
        let weights = Some(&self.weights[..]);
        optimizer.optimize_weighted(&mut self.graph, weights, &options, &mut |_| ())?;
        Ok(())
    }

    /// Poses whose places are known relative to each other.
    pub fn pieces(&self) -> Sets {
        let counts: Vec<bool> = self.weights.iter().map(|&weight| weight > 0.0).collect();
        pieces(&self.graph, &counts)
    }
}

/// Poses that `counting` edges connect, and those that are fixed.
pub(super) fn pieces<G, const D: usize>(graph: &PoseGraph<G, D>, counting: &[bool]) -> Sets {
    let mut sets = Sets::new(graph.poses.len());
    for pair in graph.fixed.windows(2) {
        sets.join(pair[0], pair[1]);
    }
    for (edge, _) in graph.edges.iter().zip(counting).filter(|(_, counts)| **counts) {
        sets.join(edge.from, edge.to);
    }
    sets
}
