//! What observations say about other functionals of the field.

use nalgebra::DMatrix;

use super::cholesky::Cholesky;
use super::expansion::{Functional, Sites};
use super::panel::{GROUP, WIDTH};
use super::sides::Sides;
use super::substitute::forward;
use crate::reference::Kernel;

impl Cholesky {
    /// How much each functional of the field is explained by the rows: cᵀ K⁻¹ c with c its
    /// covariances with them and K what was factored. `shared` adds the product of its two matrices
    /// to the covariances: what the rows (one a row) and the functionals (one a column) have in
    /// common besides the kernel; without columns and rows, nothing.
    pub fn explained(
        &self,
        sites: &Sites,
        kernel: &Kernel,
        of: &[Functional],
        shared: (&DMatrix<f64>, &DMatrix<f64>),
    ) -> Vec<f64> {
        let mut squares = Vec::with_capacity(of.len());
        self.whiten(sites, kernel, of, shared, |sides, count| {
            let end = squares.len() + count;
            squares.extend(sides.squares());
            squares.resize(end, 0.0);
        });
        squares
    }

    /// L⁻¹ c of each functional, one a column, with L the factor and c as in
    /// [`explained`](Self::explained): products of two columns are what the rows explain of the
    /// covariance of two functionals.
    pub fn whitened(
        &self,
        sites: &Sites,
        kernel: &Kernel,
        of: &[Functional],
        shared: (&DMatrix<f64>, &DMatrix<f64>),
    ) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.rows(), of.len());
        let mut first = 0;
        self.whiten(sites, kernel, of, shared, |sides, count| {
            for side in 0..count {
                for (row, to) in columns.column_mut(first + side).iter_mut().enumerate() {
                    *to = *sides.at(side, row);
                }
            }
            first += count;
        });
        columns
    }

    /// Hands L⁻¹ c to `take`, as many functionals at a time as are solved together, with their number.
    fn whiten(
        &self,
        sites: &Sites,
        kernel: &Kernel,
        of: &[Functional],
        shared: (&DMatrix<f64>, &DMatrix<f64>),
        mut take: impl FnMut(&mut Sides, usize),
    ) {
        // One stretch of memory, used again and again.
        let mut sides = Sides::zeros(self.rows(), of.len().min(GROUP * WIDTH));
        let mut first = 0;
        for of in of.chunks(GROUP * WIDTH) {
            sites.cross(kernel, of, &mut sides);
            if shared.0.ncols() > 0 {
                let more = shared.0 * shared.1.columns(first, of.len());
                for (side, column) in more.column_iter().enumerate() {
                    for (row, more) in column.iter().enumerate() {
                        *sides.at(side, row) += more;
                    }
                }
            }
            forward(self, &mut sides, of.len());
            take(&mut sides, of.len());
            first += of.len();
        }
    }
}
