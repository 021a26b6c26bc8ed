//! Linear least squares over the edges of a pose graph with unknowns of any size per pose.
//!
//! The rotations of the chordal relaxation (N numbers in N right-hand sides), its translations (one)
//! and the certificate (N + 1) share the graph's order of elimination, hence its [`Layout`].

use nalgebra::SMatrix;

use super::normal::Layout;
use super::sparse::{BlockMatrix, Factor, NotPositive};
use super::{Group, PoseGraph};

/// Where the block of an edge is below the diagonal.
#[derive(Clone, Copy, Debug)]
struct Slot {
    at: usize,
    /// Whether the edge's first pose is the row.
    transposed: bool,
}

/// Where the poses and edges of a graph stand in such systems.
#[derive(Clone, Debug)]
pub(super) struct Places<'l> {
    layout: &'l Layout,
    /// Of every edge; `None` where it touches a held pose.
    slots: Vec<Option<Slot>>,
}

impl<'l> Places<'l> {
    /// Of a graph in its layout.
    pub fn new<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>, layout: &'l Layout) -> Self {
        let slot = |from: usize, to: usize| {
            let (a, b) = layout.position(from).zip(layout.position(to))?;
            let at = layout.structure.slot(a.max(b), a.min(b))?;
            Some(Slot { at, transposed: a > b })
        };
        let slots = graph.edges.iter().map(|edge| slot(edge.from, edge.to)).collect();
        Places { layout, slots }
    }

    /// Row of blocks of a pose; `None` where it is held.
    pub fn position(&self, pose: usize) -> Option<usize> {
        self.layout.position(pose)
    }

    /// How many poses are not held.
    pub fn free(&self) -> usize {
        self.layout.structure.blocks()
    }
}

/// A symmetric matrix of `B` × `B` blocks.
#[derive(Clone, Debug)]
pub(super) struct Blocks<'p, const B: usize> {
    places: &'p Places<'p>,
    matrix: BlockMatrix<B>,
}

impl<'p, const B: usize> Blocks<'p, B> {
    /// All zero.
    pub fn new(places: &'p Places<'p>) -> Self {
        Blocks { places, matrix: BlockMatrix::new(&places.layout.structure) }
    }

    /// Adds to the diagonal block of a pose; nothing where it is held.
    pub fn add_pose(&mut self, pose: usize, block: &SMatrix<f64, B, B>) {
        if let Some(at) = self.places.position(pose) {
            self.matrix.diagonal[at] += block;
        }
    }

    /// Adds to the block in the row of an edge's second pose and the column of its first (and to its
    /// mirror image); nothing where one of them is held.
    pub fn add_edge(&mut self, edge: usize, block: &SMatrix<f64, B, B>) {
        match self.places.slots[edge] {
            Some(Slot { at, transposed: true }) => self.matrix.below[at] += block.transpose(),
            Some(Slot { at, transposed: false }) => self.matrix.below[at] += block,
            None => (),
        }
    }

    /// Replaces right-hand sides, one after the other in `right` and each in the order of positions,
    /// by their solutions.
    ///
    /// # Errors
    /// A matrix that is not positive definite, with the pose where that shows.
    pub fn solve(&self, right: &mut [f64]) -> Result<(), Singular> {
        let structure = &self.places.layout.structure;
        let mut factor = Factor::new(structure);
        factor.factorise(structure, &self.matrix, 0.0).map_err(
            |NotPositive { position, row }| Singular {
                pose: self.places.layout.pose[position] as usize,
                row,
            },
        )?;
        let length = structure.blocks() * B;
        if length > 0 {
            right.chunks_exact_mut(length).for_each(|right| factor.solve(structure, right));
        }
        Ok(())
    }
}

/// A system without a unique solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Singular {
    /// The pose where that shows.
    pub pose: usize,
    /// Row within its block.
    pub row: usize,
}
