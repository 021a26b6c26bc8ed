//! The normal equations of a pose graph: Σ ρ(eᵀ Ω e) to second order about the current poses.

use std::collections::VecDeque;

use nalgebra::{SMatrix, SVector};

use super::kernel::Kernel;
use super::sparse::{BlockMatrix, Structure, numbers};
use super::{Edge, Error, Group, PoseGraph};

/// No place: the pose does not move.
const HELD: u32 = u32::MAX;

/// What a factorisation may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Bytes for the factor and for computing it.
    pub bytes: usize,
    /// Multiplications.
    pub products: f64,
}

impl Default for Limit {
    /// 4 GB, and about a minute of one processor.
    fn default() -> Self {
        Self { bytes: 4 << 30, products: 2e11 }
    }
}

/// Where a pose graph's poses and edges stand in its normal equations.
#[derive(Clone, Debug)]
pub struct Layout {
    pub(super) structure: Structure,
    /// Position of every pose in the system, or [`HELD`].
    pub(super) position: Vec<u32>,
    /// Pose at every position.
    pub(super) pose: Vec<u32>,
    /// Slot of every edge between two moving poses; [`HELD`] for the others.
    pub(super) slot: Vec<u32>,
}

impl Layout {
    /// `held` poses stay where they are; edges are in range. A graph whose factor with blocks of D × D
    /// would exceed `limit` is to be solved iteratively: the factor is that of a tree then.
    pub(super) fn new<G, const D: usize>(
        graph: &PoseGraph<G, D>,
        held: &[bool],
        limit: Limit,
    ) -> Result<Self, Error> {
        let mut block = vec![HELD; held.len()];
        let mut moving = Vec::new();
        for pose in (0..held.len()).filter(|&pose| !held[pose]) {
            block[pose] = moving.len() as u32;
            moving.push(pose as u32);
        }
        let pair = |e: &Edge<G, D>| (block[e.from] as usize, block[e.to] as usize);
        let both = |e: &&Edge<G, D>| block[e.from] != HELD && block[e.to] != HELD;
        let pairs = graph.edges.iter().filter(both).map(pair);
        let most = limit.bytes / (8 * D * D);
        let structure = match Structure::new(moving.len(), pairs.clone(), most) {
            Ok(structure) if limit.allows::<D>(&structure) => structure,
            _ => {
                let tree = nearest_tree(graph, held);
                let [inside, outside] = [true, false].map(|wanted| {
                    let edges = graph.edges.iter().zip(&tree).filter(move |(_, t)| **t == wanted);
                    edges.map(|(edge, _)| edge).filter(both).map(pair)
                });
                Structure::partial(moving.len(), inside, outside, usize::MAX)
                    .map_err(|_| Error::TooDense)?
            }
        };
        let mut position = vec![HELD; held.len()];
        let mut pose = vec![0; moving.len()];
        for (block, &at) in moving.iter().enumerate() {
            position[at as usize] = structure.position(block) as u32;
            pose[structure.position(block)] = at;
        }
        let slot = |from: usize, to: usize| {
            let (a, b) = (position[from], position[to]);
            if a == HELD || b == HELD {
                return HELD;
            }
            structure.slot(a.max(b) as usize, a.min(b) as usize).map_or(HELD, |slot| slot as u32)
        };
        let slot = graph.edges.iter().map(|e| slot(e.from, e.to)).collect();
        Ok(Self { structure, position, pose, slot })
    }

    /// Position of `pose`, unless it is held.
    pub(super) fn position(&self, pose: usize) -> Option<usize> {
        Some(self.position[pose]).filter(|&p| p != HELD).map(|p| p as usize)
    }
}

impl Limit {
    fn allows<const B: usize>(self, structure: &Structure) -> bool {
        let products = structure.products() * (B * B * B) as f64;
        products <= self.products && numbers::<B>(structure) <= self.bytes / 8
    }
}

/// A tree of edges (several where parts are separate or more poses held) in which every pose is as few edges
/// from a held one as it can be: one entry per edge.
fn nearest_tree<G, const D: usize>(graph: &PoseGraph<G, D>, held: &[bool]) -> Vec<bool> {
    let mut starts = vec![0usize; held.len() + 1];
    for edge in &graph.edges {
        starts[edge.from + 1] += 1;
        starts[edge.to + 1] += 1;
    }
    (0..held.len()).for_each(|pose| starts[pose + 1] += starts[pose]);
    let (mut next, mut touching) = (starts.clone(), vec![0u32; 2 * graph.edges.len()]);
    for (index, edge) in graph.edges.iter().enumerate() {
        for pose in [edge.from, edge.to] {
            touching[next[pose]] = index as u32;
            next[pose] += 1;
        }
    }
    let mut reached = held.to_vec();
    let mut queue: VecDeque<usize> = (0..held.len()).filter(|&pose| held[pose]).collect();
    let mut tree = vec![false; graph.edges.len()];
    while let Some(pose) = queue.pop_front() {
        for &index in &touching[starts[pose]..starts[pose + 1]] {
            let edge = &graph.edges[index as usize];
            let other = if edge.from == pose { edge.to } else { edge.from };
            if !std::mem::replace(&mut reached[other], true) {
                tree[index as usize] = true;
                queue.push_back(other);
            }
        }
    }
    tree
}

/// H and g of the cost about a set of poses: cost(x ⊕ −h) ≈ cost − 2 gᵀh + hᵀ H h.
#[derive(Clone, Debug)]
pub(super) struct Normal<const D: usize> {
    pub matrix: BlockMatrix<D>,
    /// By position.
    pub gradient: Vec<f64>,
}

/// What edges cost: their own weights times a kernel.
#[derive(Clone, Copy)]
pub(super) struct Cost<'a> {
    pub kernel: Kernel,
    pub weights: Option<&'a [f64]>,
}

impl Cost<'_> {
    /// The cost of an edge and the weight of its information, from its squared error.
    #[inline]
    fn of(self, edge: usize, squared: f64) -> (f64, f64) {
        let (cost, weight) = self.kernel.cost_and_weight(squared);
        match self.weights {
            None => (cost, weight),
            Some(weights) => (cost * weights[edge], weight * weights[edge]),
        }
    }

    /// Σ over the edges at `poses`.
    pub fn total<G: Group<D>, const D: usize>(self, graph: &PoseGraph<G, D>, poses: &[G]) -> f64 {
        let edges = graph.edges.iter().enumerate();
        edges.map(|(edge, e)| self.of(edge, e.chi2(poses)).0).sum()
    }
}

impl<const D: usize> Normal<D> {
    pub fn new(layout: &Layout) -> Self {
        let gradient = vec![0.0; layout.structure.blocks() * D];
        Self { matrix: BlockMatrix::new(&layout.structure), gradient }
    }

    /// Linearises all edges about `poses` and returns the cost there. With `gradient_only` the matrix
    /// stays what it is. `measured` are the edges' measurements.
    pub fn linearise<G: Group<D>>(
        &mut self,
        layout: &Layout,
        graph: &PoseGraph<G, D>,
        measured: &[G::Frame],
        poses: &[G::Frame],
        cost: Cost,
        gradient_only: bool,
    ) -> f64 {
        self.gradient.fill(0.0);
        if !gradient_only {
            self.matrix.clear();
        }
        let mut total = 0.0;
        for (index, edge) in graph.edges.iter().enumerate() {
            let (from, to) = (&poses[edge.from], &poses[edge.to]);
            let at = G::linearise_frames(from, to, &measured[index]);
            let pull = edge.information * at.error;
            let (own, weight) = cost.of(index, at.error.dot(&pull));
            total += own;
            if weight == 0.0 {
                continue;
            }
            let pull = pull * weight;
            let (from, to) = (layout.position[edge.from], layout.position[edge.to]);
            for (position, by) in [(from, &at.from), (to, &at.to)] {
                if position != HELD {
                    let start = position as usize * D;
                    let own: SVector<f64, D> = by.tr_mul(&pull);
                    for (sum, x) in self.gradient[start..start + D].iter_mut().zip(own.iter()) {
                        *sum += x;
                    }
                }
            }
            if gradient_only {
                continue;
            }
            let information = edge.information * weight;
            let by_from: SMatrix<f64, D, D> = information * at.from;
            let by_to: SMatrix<f64, D, D> = information * at.to;
            if from != HELD {
                self.matrix.diagonal[from as usize] += at.from.tr_mul(&by_from);
            }
            if to != HELD {
                self.matrix.diagonal[to as usize] += at.to.tr_mul(&by_to);
            }
            if from != HELD && to != HELD {
                let block = &mut self.matrix.below[layout.slot[index] as usize];
                *block += if from > to { at.from.tr_mul(&by_to) } else { at.to.tr_mul(&by_from) };
            }
        }
        total
    }
}
