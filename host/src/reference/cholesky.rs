//! Lower-triangular factor of a symmetric positive-definite matrix.

use nalgebra::{DMatrix, DVector};

/// Columns handled at once: small enough for the cache, large enough that the products between
/// blocks, where nearly all the work is, run at full speed.
const BLOCK: usize = 64;

/// A = L Lᵀ.
#[derive(Clone, Debug)]
pub struct Cholesky {
    /// L; above the diagonal is zero.
    factor: DMatrix<f64>,
}

impl Cholesky {
    /// Factors the symmetric matrix `a`, of which only the lower triangle is read.
    ///
    /// # Errors
    /// The first row whose pivot is lost in rounding or negative: `a` is not positive definite.
    pub fn new(mut a: DMatrix<f64>) -> Result<Self, usize> {
        let n = a.nrows();
        for start in (0..n).step_by(BLOCK) {
            let end = (start + BLOCK).min(n);
            let diagonal: Vec<f64> = (start..end).map(|j| a[(j, j)]).collect();
            {
                let (done, mut panel) = a.columns_range_pair_mut(0..start, start..end);
                let below = done.rows_range(start..n);
                let beside = done.rows_range(start..end).transpose();
                panel.rows_range_mut(start..n).gemm(-1.0, &below, &beside, 1.0);
            }
            for j in start..end {
                for k in start..j {
                    let (left, mut column) = a.columns_range_pair_mut(k..k + 1, j..j + 1);
                    let scale = left[(j, 0)];
                    column.rows_range_mut(j..n).zip_apply(&left.rows_range(j..n), |x, l| {
                        *x -= scale * l;
                    });
                }
                let pivot = a[(j, j)];
                let least = f64::EPSILON * diagonal[j - start];
                if !(pivot > least && pivot > 0.0 && pivot.is_finite()) {
                    return Err(j);
                }
                a.view_range_mut(j..n, j..j + 1).scale_mut(1.0 / pivot.sqrt());
            }
        }
        a.fill_upper_triangle(0.0, 1);
        Ok(Cholesky { factor: a })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.factor.nrows()
    }

    /// L⁻¹ `b`, in place, one right-hand side a column.
    pub fn forward(&self, b: &mut DMatrix<f64>) {
        let n = self.rows();
        let l = &self.factor;
        for start in (0..n).step_by(BLOCK) {
            let end = (start + BLOCK).min(n);
            let (solved, mut block) = b.rows_range_pair_mut(0..start, start..end);
            block.gemm(-1.0, &l.view_range(start..end, 0..start), &solved, 1.0);
            for mut column in block.column_iter_mut() {
                for i in start..end {
                    let mut x = column[i - start];
                    for k in start..i {
                        x -= l[(i, k)] * column[k - start];
                    }
                    column[i - start] = x / l[(i, i)];
                }
            }
        }
    }

    /// A⁻¹ `b`.
    pub fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut x = DMatrix::from_column_slice(b.len(), 1, b.as_slice());
        self.forward(&mut x);
        let mut x = x.column(0).into_owned();
        for i in (0..self.rows()).rev() {
            let known = self.factor.column(i).rows_range(i + 1..).dot(&x.rows_range(i + 1..));
            x[i] = (x[i] - known) / self.factor[(i, i)];
        }
        x
    }

    /// A⁻¹.
    pub fn inverse(&self) -> DMatrix<f64> {
        let mut half = DMatrix::identity(self.rows(), self.rows());
        self.forward(&mut half);
        half.transpose() * half
    }

    /// log det A.
    pub fn log_determinant(&self) -> f64 {
        2.0 * self.factor.diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sizes on both sides of one and two blocks.
    fn random(n: usize, seed: u64) -> DMatrix<f64> {
        let mut state = seed.wrapping_mul(2).wrapping_add(1);
        let b = DMatrix::from_fn(n, n, |_, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
        });
        &b * b.transpose() + DMatrix::identity(n, n) * 0.1
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn solves_and_has_the_determinant(n in 1usize..150, seed in any::<u64>()) {
            let a = random(n, seed);
            let b = DVector::from_fn(n, |i, _| (i as f64).sin());
            let ours = Cholesky::new(a.clone()).unwrap();
            prop_assert!((&a * ours.solve(&b) - &b).amax() < 1e-9);
            prop_assert!((&a * ours.inverse() - DMatrix::identity(n, n)).amax() < 1e-9);
            let theirs = nalgebra::Cholesky::new(a).unwrap();
            let determinant = 2.0 * theirs.l_dirty().diagonal().map(f64::ln).sum();
            prop_assert!((ours.log_determinant() - determinant).abs() < 1e-8);
        }
    }

    #[test]
    fn names_the_row_that_fails() {
        let mut a = random(100, 7);
        // Row 80 repeats row 3: the leading 80 rows are fine, the 81st adds nothing.
        for i in 0..100 {
            a[(80, i)] = a[(3, i)];
        }
        for i in 0..100 {
            a[(i, 80)] = a[(i, 3)];
        }
        a[(80, 80)] = a[(3, 3)] - 1e-6;
        assert_eq!(Cholesky::new(a).unwrap_err(), 80);
    }

    #[test]
    fn nothing_factors_to_nothing() {
        let empty = Cholesky::new(DMatrix::zeros(0, 0)).unwrap();
        assert_eq!(empty.solve(&DVector::zeros(0)).len(), 0);
        assert_eq!(empty.log_determinant(), 0.0);
    }
}
