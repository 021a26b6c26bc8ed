//! Lower-triangular factor of a symmetric positive-definite matrix, at the speed of the machine.

use nalgebra::{DMatrix, DVector};

use super::lower::Lower;
use super::panel::{GROUP, WIDTH, eliminate, finish, offset, product};
use super::sides::Sides;
use super::simd::{Simd, Work, run};
use super::substitute::{Forward, Solve, forward};

/// A = L Lᵀ.
#[derive(Clone, Debug)]
pub struct Cholesky {
    pub(super) factor: Lower,
    /// One over the diagonal of L, filled up with ones.
    pub(super) reciprocals: Vec<f64>,
}

impl Cholesky {
    /// Factors the symmetric matrix `a`, of which only the lower triangle is read.
    ///
    /// # Errors
    /// The first row whose pivot is lost in rounding or negative: `a` is not positive definite.
    pub fn new(a: DMatrix<f64>) -> Result<Self, usize> {
        Self::of(Lower::of(&a))
    }

    /// Factors the symmetric matrix whose lower triangle is `a`.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of(a: Lower) -> Result<Self, usize> {
        run(Factor(a))
    }

    /// Of nothing.
    pub fn empty() -> Self {
        Cholesky { factor: Lower::zeros(0), reciprocals: Vec::new() }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.factor.rows
    }

    /// Bytes of memory it takes.
    pub fn bytes(&self) -> usize {
        std::mem::size_of_val(&*self.factor.panels) + std::mem::size_of_val(&*self.reciprocals)
    }

    /// L⁻¹ `b`, in place, one right-hand side a column.
    pub fn forward(&self, b: &mut DMatrix<f64>) {
        let mut sides = Sides::zeros(self.rows(), b.ncols());
        for (side, column) in b.column_iter().enumerate() {
            for (k, x) in column.iter().enumerate() {
                *sides.at(side, k) = *x;
            }
        }
        forward(self, &mut sides, b.ncols());
        for (side, mut column) in b.column_iter_mut().enumerate() {
            for (k, x) in column.iter_mut().enumerate() {
                *x = *sides.at(side, k);
            }
        }
    }

    /// A⁻¹ `b`.
    pub fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut x: Vec<f64> = b.iter().copied().collect();
        x.resize(self.reciprocals.len(), 0.0);
        run(Solve { factor: self, x: &mut x });
        x.truncate(self.rows());
        DVector::from_vec(x)
    }

    /// The lower triangle of A⁻¹.
    pub fn inverse_lower(&self) -> Lower {
        let n = self.rows();
        let mut half = Sides::zeros(n, n);
        for i in 0..n {
            *half.at(i, i) = 1.0;
        }
        run(Forward { factor: self, sides: &mut half, count: n, identity: true });
        let mut inverse = Lower::zeros(n);
        run(Gram { half: &half, to: &mut inverse });
        inverse
    }

    /// A⁻¹.
    pub fn inverse(&self) -> DMatrix<f64> {
        let lower = self.inverse_lower();
        DMatrix::from_fn(self.rows(), self.rows(), |i, j| lower.get(i.max(j), i.min(j)))
    }

    /// log det A.
    pub fn log_determinant(&self) -> f64 {
        -2.0 * self.reciprocals.iter().map(|r| r.ln()).sum::<f64>()
    }
}

/// Left-looking: each group of panels is first cleared of all panels before it, then finished one
/// by one.
struct Factor(Lower);

impl Work for Factor {
    type Output = Result<Cholesky, usize>;

    #[inline(always)]
    fn with<S: Simd>(self, s: S) -> Self::Output {
        let Factor(mut a) = self;
        let count = a.rows.div_ceil(WIDTH);
        let mut least = vec![0.0; count * WIDTH];
        for i in 0..count * WIDTH {
            if i < a.rows {
                least[i] = (f64::EPSILON * a.get(i, i)).max(0.0);
            } else {
                // Rows that are not there are rows of the identity.
                for j in 0..i {
                    *a.at(i, j) = 0.0;
                }
                *a.at(i, i) = 1.0;
            }
        }
        let mut reciprocals = vec![1.0; count * WIDTH];
        for group in (0..count).step_by(GROUP) {
            let end = (group + GROUP).min(count);
            let (before, from_here) = a.panels.split_at_mut(offset(group));
            let mut ours = &mut from_here[..offset(end) - offset(group)];
            for j in 0..group {
                let factor = &before[offset(j)..offset(j + 1)];
                let diagonal = &reciprocals[j * WIDTH..(j + 1) * WIDTH];
                let mut rest = &mut *ours;
                for i in group..end {
                    let (panel, after) = rest.split_at_mut(offset(i + 1) - offset(i));
                    eliminate(s, panel, factor, diagonal, (0, j * WIDTH), WIDTH);
                    rest = after;
                }
            }
            for i in group..end {
                let (done, rest) =
                    std::mem::take(&mut ours).split_at_mut(offset(i) - offset(group));
                let panel = &mut rest[..offset(i + 1) - offset(i)];
                for j in group..i {
                    let factor = &done[offset(j) - offset(group)..offset(j + 1) - offset(group)];
                    let diagonal = &reciprocals[j * WIDTH..(j + 1) * WIDTH];
                    eliminate(s, panel, factor, diagonal, (0, j * WIDTH), WIDTH);
                }
                let here = i * WIDTH..(i + 1) * WIDTH;
                finish(s, panel, &mut reciprocals[here.clone()], &least[here], i * WIDTH)
                    .map_err(|row| i * WIDTH + row)?;
                ours = &mut from_here[..offset(end) - offset(group)];
            }
        }
        Ok(Cholesky { factor: a, reciprocals })
    }
}

/// Row i of `half` being column i of L⁻¹, their products are A⁻¹.
struct Gram<'a> {
    half: &'a Sides,
    to: &'a mut Lower,
}

impl Work for Gram<'_> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        let stride = self.half.stride();
        let rows = |i: usize| &self.half.panels[i * stride..(i + 1) * stride];
        for (first, panel) in self.to.panels_mut() {
            let x = rows(first / WIDTH);
            for (j, to) in panel.chunks_exact_mut(WIDTH * WIDTH).enumerate() {
                product(s, x, rows(j), first, to);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Instructions, run_with};
    use super::*;
    use crate::reference::cholesky::Cholesky as Plain;
    use proptest::prelude::*;

    const PATHS: [Instructions; 3] =
        [Instructions::Portable, Instructions::Avx2, Instructions::Avx512];

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
        fn every_path_agrees_with_the_plain_factor(n in 1usize..150, seed in any::<u64>()) {
            let a = random(n, seed);
            let plain = Plain::new(a.clone()).unwrap();
            let b = DVector::from_fn(n, |i, _| (i as f64).sin());
            let many = DMatrix::from_fn(n, 1 + n / 2, |i, j| ((i * 7 + j * 3) as f64).cos());
            let mut forward = many.clone();
            plain.forward(&mut forward);
            for most in PATHS {
                let ours = run_with(most, Factor(Lower::of(&a))).unwrap();
                let mut sides = many.clone();
                ours.forward(&mut sides);
                prop_assert!((sides - &forward).amax() < 1e-10, "{most:?}");
                prop_assert!((ours.solve(&b) - plain.solve(&b)).amax() < 1e-10);
                prop_assert!((ours.inverse() - plain.inverse()).amax() < 1e-10);
                prop_assert!((ours.log_determinant() - plain.log_determinant()).abs() < 1e-10);
            }
        }

        #[test]
        fn every_path_substitutes_alike(n in 1usize..100, seed in any::<u64>()) {
            let ours = Cholesky::new(random(n, seed)).unwrap();
            let b: Vec<f64> = (0..n.next_multiple_of(WIDTH))
                .map(|i| if i < n { (i as f64).sin() } else { 0.0 })
                .collect();
            let found = PATHS.map(|most| {
                let (mut x, mut sides) = (b.clone(), Sides::zeros(n, 30));
                run_with(most, Solve { factor: &ours, x: &mut x });
                for side in 0..30 {
                    for k in 0..n {
                        *sides.at(side, k) = ((side + 5 * k) as f64).sin();
                    }
                }
                run_with(most, Forward { factor: &ours, sides: &mut sides, count: 30, identity: false });
                let mut inverse = Lower::zeros(n);
                let mut half = Sides::zeros(n, n);
                (0..n).for_each(|i| *half.at(i, i) = 1.0);
                run_with(most, Forward { factor: &ours, sides: &mut half, count: n, identity: true });
                run_with(most, Gram { half: &half, to: &mut inverse });
                x.extend(&*sides.panels);
                x.extend((0..n).flat_map(|j| (j..n).map(move |i| (i, j))).map(|(i, j)| inverse.get(i, j)));
                x
            });
            for other in &found[1..] {
                for (a, b) in found[0].iter().zip(other) {
                    prop_assert!((a - b).abs() < 1e-10);
                }
            }
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
        for most in PATHS {
            assert_eq!(run_with(most, Factor(Lower::of(&a))).unwrap_err(), 80);
        }
        let mut broken = random(30, 1);
        broken[(27, 5)] = f64::NAN;
        assert_eq!(Cholesky::new(broken).unwrap_err(), 27);
    }

    #[test]
    fn nothing_factors_to_nothing() {
        let empty = Cholesky::new(DMatrix::zeros(0, 0)).unwrap();
        assert_eq!(empty.solve(&DVector::zeros(0)).len(), 0);
        assert_eq!(empty.inverse().nrows(), 0);
        assert_eq!(empty.log_determinant(), 0.0);
        let mut sides = DMatrix::zeros(0, 3);
        empty.forward(&mut sides);
    }
}
