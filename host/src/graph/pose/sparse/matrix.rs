//! The numbers of a sparse symmetric matrix of blocks.

use nalgebra::{SMatrix, SVector};

use super::Structure;

/// A symmetric matrix of B × B blocks: the diagonal and what is below it, in the order of elimination.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockMatrix<const B: usize> {
    /// Diagonal blocks by position.
    pub diagonal: Vec<SMatrix<f64, B, B>>,
    /// Blocks below the diagonal by [`Structure::slot`].
    pub below: Vec<SMatrix<f64, B, B>>,
}

impl<const B: usize> BlockMatrix<B> {
    /// Zeros.
    pub fn new(structure: &Structure) -> Self {
        let zeros = SMatrix::zeros();
        Self { diagonal: vec![zeros; structure.blocks()], below: vec![zeros; structure.pairs()] }
    }

    /// All numbers zero again.
    pub fn clear(&mut self) {
        self.diagonal.fill(SMatrix::zeros());
        self.below.fill(SMatrix::zeros());
    }

    /// A x, for x by position.
    pub fn times(&self, structure: &Structure, x: &[f64]) -> Vec<f64> {
        let at = |i: usize| SVector::<f64, B>::from_column_slice(&x[i * B..(i + 1) * B]);
        let mut product = vec![0.0; x.len()];
        let mut add = |i: usize, own: SVector<f64, B>| {
            for (sum, x) in product[i * B..(i + 1) * B].iter_mut().zip(own.iter()) {
                *sum += x;
            }
        };
        for (column, block) in self.diagonal.iter().enumerate() {
            let right = at(column);
            add(column, block * right);
            for slot in structure.starts[column]..structure.starts[column + 1] {
                let row = structure.below[slot] as usize;
                add(row, self.below[slot] * right);
                add(column, self.below[slot].tr_mul(&at(row)));
            }
        }
        let inside = structure.below.len();
        for (block, &(column, row)) in self.below[inside..].iter().zip(&structure.outside) {
            let (column, row) = (column as usize, row as usize);
            add(row, block * at(column));
            add(column, block.tr_mul(&at(row)));
        }
        product
    }

    /// xᵀ A x, for x by position.
    pub fn quadratic(&self, structure: &Structure, x: &[f64]) -> f64 {
        self.times(structure, x).iter().zip(x).map(|(a, x)| a * x).sum()
    }
}
