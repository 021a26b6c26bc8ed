//! Linear least squares over the edges of a pose graph with unknowns of any size per pose.
//!
//! The rotations of the chordal relaxation (N numbers in N right-hand sides), its translations (one)
//! and the certificate (N + 1) share the graph's order of elimination, hence its [`Layout`].

use nalgebra::SMatrix;

use super::normal::Layout;
use super::sparse::{BlockMatrix, Factor, NotPositive, Structure, conjugate_gradients};
use super::{Edge, Group, PoseGraph};

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
        let slot = |(index, edge): (usize, &Edge<G, D>)| {
            let (a, b) = layout.position(edge.from).zip(layout.position(edge.to))?;
            Some(Slot { at: layout.slot[index] as usize, transposed: a > b })
        };
        let slots = graph.edges.iter().enumerate().map(slot).collect();
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

    /// The diagonal block at a position.
    pub fn diagonal(&self, position: usize) -> &SMatrix<f64, B, B> {
        &self.matrix.diagonal[position]
    }

    /// This matrix plus `share` of `sizes`, a diagonal by position.
    pub fn raised(&self, share: f64, sizes: &[f64]) -> Self {
        let mut raised = self.clone();
        for (block, sizes) in raised.matrix.diagonal.iter_mut().zip(sizes.chunks_exact(B)) {
            (0..B).for_each(|r| block[(r, r)] += share * sizes[r]);
        }
        raised
    }

    /// Replaces right-hand sides, one after the other in `right` and each in the order of positions,
    /// by their solutions.
    ///
    /// # Errors
    /// A matrix that is not positive definite, with the pose where that shows.
    pub fn solve(self, right: &mut [f64]) -> Result<(), Singular> {
        self.factorised()?.solve(right);
        Ok(())
    }

    /// The matrix ready to be solved with many times.
    ///
    /// # Errors
    /// A matrix that is not positive definite, with the pose where that shows.
    pub fn factorised(self) -> Result<Factorised<'p, B>, Singular> {
        let layout = self.places.layout;
        let mut factor = Factor::new(&layout.structure);
        factor.factorise(&layout.structure, &self.matrix, 0.0).map_err(
            |NotPositive { position, row }| Singular { pose: layout.pose[position] as usize, row },
        )?;
        Ok(Factorised { structure: &layout.structure, factor, matrix: self })
    }
}

/// What is left of a residual where the factor is that of a tree only: relaxations are solved for initial
/// values.
const ACCURACY: f64 = 1e-7;

/// A symmetric positive definite matrix as its factor.
pub(super) struct Factorised<'p, const B: usize> {
    structure: &'p Structure,
    factor: Factor<B>,
    matrix: Blocks<'p, B>,
}

impl<const B: usize> Factorised<'_, B> {
    /// Replaces right-hand sides by their solutions; see [`Blocks::solve`].
    pub fn solve(&self, right: &mut [f64]) {
        let length = self.structure.blocks() * B;
        if length > 0 {
            let Self { structure, factor, matrix } = self;
            right.chunks_exact_mut(length).for_each(|right| {
                conjugate_gradients(structure, factor, &matrix.matrix, 0.0, right, ACCURACY);
            });
        }
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
