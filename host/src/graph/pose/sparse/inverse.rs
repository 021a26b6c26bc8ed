//! Blocks of the inverse of a sparse matrix, without the inverse.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Accum, Mat, MatMut, MatRef, Par};
use nalgebra::SMatrix;

use super::front::stride;
use super::{Factor, Structure};

/// The blocks of A⁻¹ where the factor of A has blocks: among them all on the diagonal and those of
/// all pairs that are not zero in A.
///
/// Supernodes are treated from the root down (Takahashi, Fagan and Chen 1973; Erisman and Tinney
/// 1975): with the columns L₁₁ above L₂₁ of one, and the inverse Z₂₂ of the rows below, known from
/// its parent, Y = L₂₁ L₁₁⁻¹ gives Z₂₁ = −Z₂₂ Y and Z₁₁ = (L₁₁ L₁₁ᵀ)⁻¹ − Yᵀ Z₂₁.
#[derive(Clone, Debug)]
pub struct SelectedInverse<const B: usize> {
    /// The columns of every supernode: as many rows as its front has.
    panels: Vec<Vec<f64>>,
    node_of: Vec<u32>,
}

impl<const B: usize> SelectedInverse<B> {
    /// From the factor of A.
    pub fn new(structure: &Structure, factor: &Factor<B>) -> Self {
        let nodes = &structure.nodes;
        let mut node_of = vec![0; structure.blocks()];
        let mut panels = vec![Vec::new(); nodes.len()];
        // Whole fronts of Z, kept until the last child has taken its part.
        let mut fronts: Vec<Vec<f64>> = vec![Vec::new(); nodes.len()];
        for at in (0..nodes.len()).rev() {
            let node = &nodes[at];
            node_of[node.first..node.first + node.columns].fill(at as u32);
            let (columns, rows) = (node.columns * B, node.rows.len() * B);
            let height = columns + rows;
            let mut front = vec![0.0; height * height];
            if let Some(parent) = node.parent {
                let places = &structure.relative[node.rows.clone()];
                let above = &nodes[parent];
                let from = (fronts[parent].as_slice(), (above.columns + above.rows.len()) * B);
                gather::<B>(from, places, (front.as_mut_slice(), height), node.columns);
                if structure.children[above.children.start] as usize == at {
                    fronts[parent] = Vec::new();
                }
            }
            let l = factor.panel(at);
            let step = stride(columns, rows);
            let l = MatRef::from_column_major_slice_with_stride(l, height, columns, step);
            let (l11, l21) = l.split_at_row(columns);
            // Yᵀ = L₁₁⁻ᵀ L₂₁ᵀ, held as Y.
            let mut y = l21.to_owned();
            solve_upper_triangular_in_place(l11.transpose(), y.as_mut().transpose_mut(), Par::Seq);
            let mut w = Mat::<f64>::identity(columns, columns);
            solve_lower_triangular_in_place(l11, w.as_mut(), Par::Seq);
            let mut whole = MatMut::from_column_major_slice_mut(&mut front, height, height);
            let mut z21 = Mat::<f64>::zeros(rows, columns);
            let z22 = whole.as_ref().submatrix(columns, columns, rows, rows);
            matmul(&mut z21, Accum::Replace, z22, &y, -1.0, Par::Seq);
            let mut z11 = whole.as_mut().submatrix_mut(0, 0, columns, columns);
            matmul(&mut z11, Accum::Replace, w.transpose(), &w, 1.0, Par::Seq);
            matmul(&mut z11, Accum::Add, y.transpose(), &z21, -1.0, Par::Seq);
            whole.as_mut().submatrix_mut(columns, 0, rows, columns).copy_from(&z21);
            whole.submatrix_mut(0, columns, columns, rows).copy_from(z21.transpose());
            panels[at] = front[..height * columns].to_vec();
            if !node.children.is_empty() {
                fronts[at] = front;
            }
        }
        Self { panels, node_of }
    }

    /// The block of A⁻¹ of these positions, if it was computed.
    pub fn block(
        &self,
        structure: &Structure,
        row: usize,
        column: usize,
    ) -> Option<SMatrix<f64, B, B>> {
        if row < column {
            return Some(self.block(structure, column, row)?.transpose());
        }
        let at = self.node_of[column] as usize;
        let node = &structure.nodes[at];
        let local = if row < node.first + node.columns {
            row - node.first
        } else {
            let rows = &structure.rows[node.rows.clone()];
            node.columns + rows.binary_search(&(row as u32)).ok()?
        };
        let height = (node.columns + node.rows.len()) * B;
        let start = (column - node.first) * B * height + local * B;
        Some(SMatrix::from_fn(|r, c| self.panels[at][start + c * height + r]))
    }
}

/// Copies the rows and columns `places` of a square front to another, `offset` blocks from its corner.
fn gather<const B: usize>(
    (from, height): (&[f64], usize),
    places: &[u32],
    (to, width): (&mut [f64], usize),
    offset: usize,
) {
    for (c, &column) in places.iter().enumerate() {
        for inner in 0..B {
            let source = &from[(column as usize * B + inner) * height..][..height];
            let target = &mut to[((offset + c) * B + inner) * width..][..width];
            for (block, &row) in target[offset * B..].chunks_exact_mut(B).zip(places) {
                block.copy_from_slice(&source[row as usize * B..row as usize * B + B]);
            }
        }
    }
}
