//! Quadratic forms of the inverse of a sparse matrix in vectors that are zero almost everywhere.

use nalgebra::{SMatrix, SVector};

use super::front::stride;
use super::{Factor, Structure};

/// Rᵀ A⁻¹ R for matrices R with few blocks that are not zero.
///
/// With A = L Lᵀ it is XᵀX where L X = R, and X is zero outside of the paths from R's blocks to the
/// root of the elimination tree (Gilbert and Peierls 1988): only these supernodes are visited.
#[derive(Clone, Debug)]
pub struct Paths<const B: usize> {
    node_of: Vec<u32>,
    /// Rows of R and X by position; zero between calls.
    rows: Vec<SVector<f64, B>>,
    visited: Vec<u32>,
}

impl<const B: usize> Paths<B> {
    /// For factors with this structure.
    pub fn new(structure: &Structure) -> Self {
        let mut node_of = vec![0; structure.blocks()];
        for (at, node) in structure.nodes.iter().enumerate() {
            node_of[node.first..node.first + node.columns].fill(at as u32);
        }
        let rows = vec![SVector::zeros(); structure.blocks() * B];
        Paths { node_of, rows, visited: Vec::new() }
    }

    /// The form for R with these blocks at these positions.
    pub fn form(
        &mut self,
        structure: &Structure,
        factor: &Factor<B>,
        right: &[(usize, SMatrix<f64, B, B>)],
    ) -> SMatrix<f64, B, B> {
        self.visited.clear();
        for &(position, block) in right {
            for r in 0..B {
                self.rows[position * B + r] += block.row(r).transpose();
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
        let mut form = SMatrix::<f64, B, B>::zeros();
        for &at in &self.visited {
            let node = &structure.nodes[at as usize];
            let (columns, below) = (node.columns * B, &structure.rows[node.rows.clone()]);
            let step = stride(columns, below.len() * B);
            for (c, column) in factor.panel(at as usize).chunks_exact(step).enumerate() {
                let first = node.first * B;
                let own = self.rows[first + c];
                if own == SVector::<f64, B>::zeros() {
                    continue;
                }
                self.rows[first + c] = SVector::zeros();
                let own = own / column[c];
                form += own * own.transpose();
                let rest = &mut self.rows[first + c + 1..first + columns];
                for (row, l) in rest.iter_mut().zip(&column[c + 1..columns]) {
                    *row -= own * *l;
                }
                for (&row, l) in below.iter().zip(column[columns..].chunks_exact(B)) {
                    let rows = &mut self.rows[row as usize * B..(row as usize + 1) * B];
                    for (row, l) in rows.iter_mut().zip(l) {
                        *row -= own * *l;
                    }
                }
            }
        }
        form
    }
}
