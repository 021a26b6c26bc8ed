//! Quadratic forms of the inverse of a sparse matrix in vectors that are zero almost everywhere.

use nalgebra::{SMatrix, SVector};

use super::front::stride;
use super::{Factor, Structure};
use crate::dense::simd::{Instructions, Simd, Work, run_with};

/// Rᵀ A⁻¹ R for matrices R with few blocks that are not zero.
///
/// With A = L Lᵀ it is XᵀX where L X = R, and X is zero outside of the paths from R's blocks to the
/// root of the elimination tree (Gilbert and Peierls 1988): only these supernodes are visited.
#[derive(Clone, Debug)]
pub struct Paths<const B: usize> {
    node_of: Vec<u32>,
    /// R and X, column after column; zero between calls.
    rows: Vec<f64>,
    visited: Vec<u32>,
    /// What a supernode takes off the rows below, column after column.
    update: Vec<f64>,
    instructions: Instructions,
}

impl<const B: usize> Paths<B> {
    /// For factors with this structure.
    pub fn new(structure: &Structure) -> Self {
        let mut node_of = vec![0; structure.blocks()];
        for (at, node) in structure.nodes.iter().enumerate() {
            node_of[node.first..node.first + node.columns].fill(at as u32);
        }
        let most = structure.nodes.iter().map(|node| node.rows.len()).max().unwrap_or(0);
        Paths {
            node_of,
            rows: vec![0.0; structure.blocks() * B * B],
            visited: Vec::new(),
            update: vec![0.0; most * B * B],
            instructions: Instructions::best(),
        }
    }

    /// The form for R with these blocks at these positions.
    pub fn form(
        &mut self,
        structure: &Structure,
        factor: &Factor<B>,
        right: &[(usize, SMatrix<f64, B, B>)],
    ) -> SMatrix<f64, B, B> {
        self.visited.clear();
        let height = structure.blocks() * B;
        for &(position, block) in right {
            for (c, column) in block.column_iter().enumerate() {
                for (r, value) in column.iter().enumerate() {
                    self.rows[c * height + position * B + r] += value;
                }
            }
            let mut next = Some(self.node_of[position] as usize);
            while let Some(at) = next {
                self.visited.push(at as u32);
                next = structure.nodes[at].parent;
            }
        }
        // Parents come after their children.
        self.visited.sort_unstable();
        self.visited.dedup();
        run_with(self.instructions, Form { paths: self, structure, factor })
    }
}

/// The solution along the visited supernodes.
struct Form<'a, const B: usize> {
    paths: &'a mut Paths<B>,
    structure: &'a Structure,
    factor: &'a Factor<B>,
}

impl<const B: usize> Work for Form<'_, B> {
    type Output = SMatrix<f64, B, B>;

    #[inline(always)]
    fn with<S: Simd>(self, _: S) -> Self::Output {
        let Form { paths: Paths { rows, visited, update, .. }, structure, factor } = self;
        let height = structure.blocks() * B;
        let mut form = SMatrix::<f64, B, B>::zeros();
        for &at in visited.iter() {
            let node = &structure.nodes[at as usize];
            let below = &structure.rows[node.rows.clone()];
            let (first, columns, rest) = (node.first * B, node.columns * B, below.len() * B);
            let step = stride(columns, rest);
            update[..B * rest].fill(0.0);
            for (c, column) in factor.panel(at as usize).chunks_exact(step).enumerate() {
                let mut own = SVector::<f64, B>::zeros();
                for k in 0..B {
                    own[k] = std::mem::take(&mut rows[k * height + first + c]) / column[c];
                }
                if own == SVector::<f64, B>::zeros() {
                    continue;
                }
                form += own * own.transpose();
                for k in 0..B {
                    let inside =
                        &mut rows[k * height + first + c + 1..k * height + first + columns];
                    subtract(inside, own[k], &column[c + 1..columns]);
                    subtract(&mut update[k * rest..(k + 1) * rest], own[k], &column[columns..]);
                }
            }
            for k in 0..B {
                let update = update[k * rest..(k + 1) * rest].chunks_exact(B);
                for (&row, update) in below.iter().zip(update) {
                    let rows = &mut rows[k * height + row as usize * B..][..B];
                    rows.iter_mut().zip(update).for_each(|(row, update)| *row += update);
                }
            }
        }
        form
    }
}

/// y − a x, where x may be longer.
#[inline(always)]
fn subtract(y: &mut [f64], a: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y -= a * x);
}
