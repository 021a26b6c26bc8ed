//! The Cholesky factor of a sparse matrix of blocks, and what is solved with it.

use super::front::{self, padded, stride};
use super::structure::Supernode;
use super::{BlockMatrix, Structure};
use crate::dense::simd::{Instructions, Simd, Work, run_with};

/// A matrix that is not positive definite, to working precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotPositive {
    /// Position of the block that depends on those eliminated before it.
    pub position: usize,
    /// Row within the block.
    pub row: usize,
}

/// A pivot less than this share of its diagonal element is rounding error.
const DEPENDENT: f64 = 2e-15;

/// L with L Lᵀ = A, for a matrix of B × B blocks. Memory is kept from one matrix to the next.
#[derive(Clone, Debug)]
pub struct Factor<const B: usize> {
    /// Columns of every supernode, as [`front`] lays them out.
    panels: Vec<f64>,
    /// Where the panel of each supernode starts, and where it ends.
    starts: Vec<usize>,
    /// One over the diagonal of L.
    reciprocals: Vec<f64>,
    /// Least acceptable pivots.
    least: Vec<f64>,
    /// What supernodes leave to their parents until these have gathered it. Parents and children
    /// are on different stacks: while one grows by the parent's, the children's leave the other.
    stacks: [Vec<f64>; 2],
    /// Where in its stack each supernode leaves its own.
    updates: Vec<usize>,
    /// Whether that is the second stack.
    odd: Vec<bool>,
}

/// The numbers that a factor with blocks of B × B and what it takes to compute it consist of.
pub fn numbers<const B: usize>(structure: &Structure) -> usize {
    let plan = Plan::new::<B>(structure);
    plan.starts[structure.nodes.len()] + plan.most[0] + plan.most[1]
}

/// Where everything is held.
struct Plan {
    starts: Vec<usize>,
    updates: Vec<usize>,
    odd: Vec<bool>,
    /// Lengths of the stacks.
    most: [usize; 2],
}

impl Plan {
    fn new<const B: usize>(structure: &Structure) -> Self {
        let nodes = &structure.nodes;
        let mut starts = vec![0];
        for node in nodes {
            let (columns, rows) = (node.columns * B, node.rows.len() * B);
            starts.push(starts[starts.len() - 1] + columns * stride(columns, rows));
        }
        let mut odd = vec![false; nodes.len()];
        for at in (0..nodes.len()).rev() {
            odd[at] = nodes[at].parent.is_some_and(|parent| !odd[parent]);
        }
        // The heights of the two stacks, and the most they reach.
        let (mut heights, mut most) = ([0; 2], [0; 2]);
        let mut updates = Vec::with_capacity(nodes.len());
        for (node, &odd) in nodes.iter().zip(&odd) {
            let stack = usize::from(odd);
            updates.push(heights[stack]);
            heights[stack] += size::<B>(node);
            most[stack] = most[stack].max(heights[stack]);
            let children = &structure.children[node.children.clone()];
            heights[1 - stack] -=
                children.iter().map(|&c| size::<B>(&nodes[c as usize])).sum::<usize>();
        }
        Plan { starts, updates, odd, most }
    }
}

/// Numbers a supernode leaves to its parent.
fn size<const B: usize>(node: &Supernode) -> usize {
    padded(node.rows.len() * B) * node.rows.len() * B
}

impl<const B: usize> Factor<B> {
    /// Room for factors of matrices with this structure.
    pub fn new(structure: &Structure) -> Self {
        let Plan { starts, updates, odd, most } = Plan::new::<B>(structure);
        Self {
            panels: vec![0.0; starts[structure.nodes.len()]],
            starts,
            reciprocals: vec![0.0; structure.blocks() * B],
            least: vec![0.0; structure.blocks() * B],
            stacks: most.map(|most| vec![0.0; most]),
            updates,
            odd,
        }
    }

    /// Factorises `matrix` with its diagonal elements times 1 + `damping`.
    ///
    /// # Errors
    /// A matrix that is not positive definite, with the block where that shows.
    pub fn factorise(
        &mut self,
        structure: &Structure,
        matrix: &BlockMatrix<B>,
        damping: f64,
    ) -> Result<(), NotPositive> {
        // 512-bit vectors would pad the many small fronts more than they speed up the few large.
        run_with(Instructions::Avx2, Factorise { factor: self, structure, matrix, damping })
    }

    /// Replaces `x`, a vector by position, by A⁻¹ x.
    pub fn solve(&self, structure: &Structure, x: &mut [f64]) {
        run_with(Instructions::Avx2, Solve { factor: self, structure, x });
    }

    /// The columns of supernode `at`, as [`front`] lays them out.
    pub(super) fn panel(&self, at: usize) -> &[f64] {
        &self.panels[self.starts[at]..self.starts[at + 1]]
    }

    fn assemble(
        &mut self,
        structure: &Structure,
        matrix: &BlockMatrix<B>,
        damping: f64,
        at: usize,
    ) {
        let node = &structure.nodes[at];
        let stride = stride(node.columns * B, node.rows.len() * B);
        let panel = &mut self.panels[self.starts[at]..self.starts[at + 1]];
        panel.fill(0.0);
        for local in 0..node.columns {
            let column = node.first + local;
            let block = &matrix.diagonal[column];
            for c in 0..B {
                let start = (local * B + c) * stride;
                for r in c..B {
                    panel[start + local * B + r] = block[(r, c)];
                }
                let pivot = &mut panel[start + local * B + c];
                *pivot *= 1.0 + damping;
                self.least[column * B + c] = *pivot * DEPENDENT;
            }
            for slot in structure.starts[column]..structure.starts[column + 1] {
                let row = structure.local[slot] as usize * B;
                let block = &matrix.below[slot];
                for c in 0..B {
                    let start = (local * B + c) * stride + row;
                    let to = &mut panel[start..start + B];
                    for r in 0..B {
                        to[r] = block[(r, c)];
                    }
                }
            }
        }
    }
}

struct Factorise<'a, const B: usize> {
    factor: &'a mut Factor<B>,
    structure: &'a Structure,
    matrix: &'a BlockMatrix<B>,
    damping: f64,
}

impl<const B: usize> Work for Factorise<'_, B> {
    type Output = Result<(), NotPositive>;

    #[inline(always)]
    fn with<S: Simd>(self, s: S) -> Result<(), NotPositive> {
        let Self { factor, structure, matrix, damping } = self;
        for (at, node) in structure.nodes.iter().enumerate() {
            factor.assemble(structure, matrix, damping, at);
            let (columns, rows) = (node.columns * B, node.rows.len() * B);
            let stride = stride(columns, rows);
            let panel = &mut factor.panels[factor.starts[at]..factor.starts[at + 1]];
            let [even, odd] = &mut factor.stacks;
            let (own, children) = if factor.odd[at] { (odd, even) } else { (even, odd) };
            let own = &mut own[factor.updates[at]..factor.updates[at] + size::<B>(node)];
            let leaf = node.children.is_empty();
            if !leaf {
                own.fill(0.0);
            }
            for &child in &structure.children[node.children.clone()] {
                let from = &children[factor.updates[child as usize]..];
                let places = &structure.relative[structure.nodes[child as usize].rows.clone()];
                extend::<B>(from, places, panel, stride, node.columns, own, padded(rows));
            }
            let range = node.first * B..node.first * B + columns;
            let least = &factor.least[range.clone()];
            let reciprocals = &mut factor.reciprocals[range];
            front::eliminate(s, panel, stride, columns + rows, least, reciprocals).map_err(
                |column| NotPositive { position: node.first + column / B, row: column % B },
            )?;
            front::update(s, panel, stride, columns, own, rows, leaf);
        }
        Ok(())
    }
}

/// Adds what a child left, `from`, whose rows are the blocks `places` of the parent.
#[inline(always)]
fn extend<const B: usize>(
    from: &[f64],
    places: &[u32],
    panel: &mut [f64],
    stride: usize,
    columns: usize,
    own: &mut [f64],
    step: usize,
) {
    let width = padded(places.len() * B);
    for (b, &place) in places.iter().enumerate() {
        let place = place as usize;
        for c in 0..B {
            let start = (b * B + c) * width;
            let source = &from[start + b * B..start + places.len() * B];
            let (target, offset) = if place < columns {
                let start = (place * B + c) * stride;
                (&mut panel[start..start + stride], 0)
            } else {
                let start = ((place - columns) * B + c) * step;
                (&mut own[start..start + step], columns)
            };
            for (block, &row) in source.chunks_exact(B).zip(&places[b..]) {
                let row = (row as usize - offset) * B;
                let to = &mut target[row..row + B];
                for r in 0..B {
                    to[r] += block[r];
                }
            }
        }
    }
}

struct Solve<'a, const B: usize> {
    factor: &'a Factor<B>,
    structure: &'a Structure,
    x: &'a mut [f64],
}

impl<const B: usize> Work for Solve<'_, B> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, _: S) {
        let Self { factor, structure, x } = self;
        let largest = structure.nodes.iter().map(|n| n.rows.len() * B).max().unwrap_or(0);
        let mut gathered = vec![0.0; largest];
        for (at, node) in structure.nodes.iter().enumerate() {
            let (columns, rows) = (node.columns * B, node.rows.len() * B);
            let stride = stride(columns, rows);
            let panel = factor.panel(at);
            let range = node.first * B..node.first * B + columns;
            let reciprocals = &factor.reciprocals[range.clone()];
            let own = &mut x[range];
            let gathered = &mut gathered[..rows];
            gathered.fill(0.0);
            for (c, column) in panel.chunks_exact(stride).enumerate() {
                own[c] *= reciprocals[c];
                let value = own[c];
                for (x, l) in own[c + 1..].iter_mut().zip(&column[c + 1..columns]) {
                    *x -= l * value;
                }
                for (x, l) in gathered.iter_mut().zip(&column[columns..]) {
                    *x += l * value;
                }
            }
            let blocks = gathered.chunks_exact(B).zip(&structure.rows[node.rows.clone()]);
            for (block, &row) in blocks {
                let to = &mut x[row as usize * B..(row as usize + 1) * B];
                for r in 0..B {
                    to[r] -= block[r];
                }
            }
        }
        for (at, node) in structure.nodes.iter().enumerate().rev() {
            let (columns, rows) = (node.columns * B, node.rows.len() * B);
            let stride = stride(columns, rows);
            let panel = factor.panel(at);
            let gathered = &mut gathered[..rows];
            let blocks = gathered.chunks_exact_mut(B).zip(&structure.rows[node.rows.clone()]);
            for (block, &row) in blocks {
                block.copy_from_slice(&x[row as usize * B..(row as usize + 1) * B]);
            }
            let range = node.first * B..node.first * B + columns;
            let reciprocals = &factor.reciprocals[range.clone()];
            let own = &mut x[range];
            for (c, column) in panel.chunks_exact(stride).enumerate().rev() {
                let sum = dot(&own[c + 1..], &column[c + 1..columns])
                    + dot(gathered, &column[columns..columns + rows]);
                own[c] = (own[c] - sum) * reciprocals[c];
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; 4];
    for (a, b) in a.zip(b) {
        for i in 0..4 {
            sums[i] += a[i] * b[i];
        }
    }
    sums.iter().sum::<f64>() + rest
}
