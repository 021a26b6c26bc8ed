//! An incremental Cholesky factor in packed storage: rows are appended and removed one at a time,
//! never refactored.

use crate::math;

/// Numbers in the packed lower triangle of a matrix of `rows` rows: the third const argument of
/// [`Gpis`](super::Gpis).
pub const fn packed(rows: usize) -> usize {
    rows * (rows + 1) / 2
}

/// The lower factor L of a symmetric positive definite matrix, L·Lᵀ, of at most `ROWS` rows, row by
/// row. `PACKED` must be [`packed`]`(ROWS)`; anything else does not compile.
#[derive(Clone, Debug)]
pub struct Cholesky<const ROWS: usize, const PACKED: usize> {
    lower: [f32; PACKED],
    /// 1/Lᵢᵢ: divisions are slow.
    inverse_diagonal: [f32; ROWS],
    rows: usize,
}

/// A row that would make the matrix indefinite; the factor is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotPositiveDefinite;

const fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

impl<const ROWS: usize, const PACKED: usize> Cholesky<ROWS, PACKED> {
    const SIZES_AGREE: () = assert!(PACKED == packed(ROWS), "PACKED must be packed(ROWS)");

    /// The factor of the empty matrix, all zero bits.
    pub const fn new() -> Self {
        let () = Self::SIZES_AGREE;
        Cholesky { lower: [0.0; PACKED], inverse_diagonal: [0.0; ROWS], rows: 0 }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Forgets every row beyond the first `rows`.
    pub fn truncate(&mut self, rows: usize) {
        self.rows = self.rows.min(rows);
    }

    /// Where the covariances of the `ahead`-th row to come are written, itself last: a slice of
    /// `rows() + ahead + 1` numbers, empty when that row would not fit. Contents are unspecified.
    pub fn stage(&mut self, ahead: usize) -> &mut [f32] {
        let row = self.rows + ahead;
        if row >= ROWS {
            return &mut [];
        }
        &mut self.lower[start(row)..start(row + 1)]
    }

    /// Appends the row staged by [`stage`](Self::stage)`(0)`: about n²/2 multiplications.
    ///
    /// # Errors
    /// When the staged row is not positive definite beyond rounding, or there is no room.
    pub fn append(&mut self) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        if n >= ROWS {
            return Err(NotPositiveDefinite);
        }
        let (old, rest) = self.lower.split_at_mut(start(n));
        let row = &mut rest[..n + 1];
        let variance = row[n];
        forward(old, &self.inverse_diagonal[..n], &mut row[..n]);
        let left = variance - dot(&row[..n], &row[..n]);
        // Below this the new number is rounding error, not information.
        if !(left > 1e-7 * variance && variance.is_finite()) {
            return Err(NotPositiveDefinite);
        }
        let diagonal = math::sqrt(left);
        row[n] = diagonal;
        self.inverse_diagonal[n] = 1.0 / diagonal;
        self.rows = n + 1;
        Ok(())
    }

    /// Removes one row and column by a rank-one update of what follows: about (n − row)²
    /// multiplications and 3·`ROWS` numbers of stack. A row that does not exist is ignored.
    pub fn remove(&mut self, row: usize) {
        let n = self.rows;
        if row >= n {
            return;
        }
        // The rotation of each later column: cosine, sine, 1/cosine.
        let mut turns = [(1.0f32, 0.0f32, 1.0f32); ROWS];
        for i in row + 1..n {
            // Row i loses a column and becomes row i − 1, which ends where row i begins.
            let (before, after) = self.lower.split_at_mut(start(i));
            let (to, from) = (&mut before[start(i - 1)..], &after[..i + 1]);
            to[..row].copy_from_slice(&from[..row]);
            let mut v = from[row];
            let columns = to[row..i - 1].iter_mut().zip(&from[row + 1..i]);
            for ((new, old), &(c, s, inverse)) in columns.zip(&turns[row + 1..i]) {
                *new = (old + s * v) * inverse;
                v = c * v - s * *new;
            }
            let d = from[i];
            let r = math::sqrt(d * d + v * v);
            turns[i] = (r / d, v / d, d / r);
            to[i - 1] = r;
            self.inverse_diagonal[i - 1] = 1.0 / r;
        }
        self.rows = n - 1;
    }

    /// Takes v·vᵀ away from the matrix by hyperbolic rotations, about n² multiplications and
    /// 3·`ROWS` numbers of stack. What is left must be positive definite: where it is not, or not
    /// beyond rounding, diagonals end at a thousandth of what they were. A v shorter than `rows()`
    /// changes nothing.
    pub fn downdate(&mut self, v: &[f32]) {
        let n = if v.len() < self.rows { 0 } else { self.rows };
        // The rotation of each column: 1/cosh, tanh, cosh.
        let mut turns = [(1.0f32, 0.0f32, 1.0f32); ROWS];
        for i in 0..n {
            let row = &mut self.lower[start(i)..start(i + 1)];
            let mut v = v[i];
            let mut turn = |l: &mut f32, &(c, s, inverse): &(f32, f32, f32)| {
                *l = (*l - s * v) * inverse;
                v = c * v - s * *l;
            };
            let (row4, rest) = row[..i].as_chunks_mut::<4>();
            let (turns4, last) = turns[..i].as_chunks::<4>();
            for (row, turns) in row4.iter_mut().zip(turns4) {
                for j in 0..4 {
                    turn(&mut row[j], &turns[j]);
                }
            }
            rest.iter_mut().zip(last).for_each(|(l, t)| turn(l, t));
            let d = row[i];
            let left = d * d - v * v;
            // NaN fails the comparison.
            let r = if left > 1e-6 * d * d { math::sqrt(left) } else { 1e-3 * d };
            turns[i] = (r / d, v / d, d / r);
            row[i] = r;
            self.inverse_diagonal[i] = 1.0 / r;
        }
    }

    /// x ← L⁻¹ x over the first `rows()` numbers; a shorter x uses as many rows as it has.
    pub fn forward(&self, x: &mut [f32]) {
        let n = self.rows.min(x.len());
        forward(&self.lower, &self.inverse_diagonal[..n], &mut x[..n]);
    }

    /// x ← L⁻¹ x where the numbers before `row` are zero, and stay so.
    pub fn forward_from(&self, row: usize, x: &mut [f32]) {
        for i in row..self.rows.min(x.len()) {
            let (head, tail) = x.split_at_mut(i);
            let known = dot(&self.lower[start(i) + row..start(i) + i], &head[row..]);
            tail[0] = (tail[0] - known) * self.inverse_diagonal[i];
        }
    }

    /// x ← L⁻ᵀ x over the first `rows()` numbers; a shorter x uses as many rows as it has.
    pub fn backward(&self, x: &mut [f32]) {
        let n = self.rows.min(x.len());
        for i in (0..n).rev() {
            let (head, tail) = x.split_at_mut(i);
            let xi = tail[0] * self.inverse_diagonal[i];
            tail[0] = xi;
            for (h, l) in head.iter_mut().zip(&self.lower[start(i)..start(i) + i]) {
                *h -= l * xi;
            }
        }
    }

    /// ln det(L·Lᵀ)/2 = Σ ln Lᵢᵢ.
    pub fn half_log_determinant(&self) -> f32 {
        self.half_log_determinant_since(0)
    }

    /// Σ ln Lᵢᵢ over the rows from `row` on: ln det/2 of what those rows leave open to the ones before.
    pub fn half_log_determinant_since(&self, row: usize) -> f32 {
        let diagonal = self.inverse_diagonal[..self.rows].get(row..).unwrap_or(&[]);
        -diagonal.iter().map(|&d| math::ln(d)).sum::<f32>()
    }
}

impl<const ROWS: usize, const PACKED: usize> Default for Cholesky<ROWS, PACKED> {
    fn default() -> Self {
        Self::new()
    }
}

/// x ← L⁻¹ x, four rows at a time so that each x is loaded once for four products.
#[inline]
fn forward(lower: &[f32], inverse_diagonal: &[f32], x: &mut [f32]) {
    let n = x.len();
    let mut i = 0;
    while i + 4 <= n {
        let (done, todo) = x.split_at_mut(i);
        let l0 = &lower[start(i)..start(i) + i + 1];
        let l1 = &lower[start(i + 1)..start(i + 1) + i + 2];
        let l2 = &lower[start(i + 2)..start(i + 2) + i + 3];
        let l3 = &lower[start(i + 3)..start(i + 3) + i + 4];
        let (a0, a1, a2, a3) = (&l0[..i], &l1[..i], &l2[..i], &l3[..i]);
        // Four partial sums a row: sixteen in flight, or four vectors.
        let mut sums = [[0.0f32; 4]; 4];
        // i is a multiple of four, and so nothing is left over.
        let blocks = a0.as_chunks::<4>().0.iter().zip(a1.as_chunks::<4>().0);
        let blocks = blocks.zip(a2.as_chunks::<4>().0).zip(a3.as_chunks::<4>().0);
        for ((((l0, l1), l2), l3), v) in blocks.zip(done.as_chunks::<4>().0) {
            for j in 0..4 {
                sums[0][j] += l0[j] * v[j];
                sums[1][j] += l1[j] * v[j];
                sums[2][j] += l2[j] * v[j];
                sums[3][j] += l3[j] * v[j];
            }
        }
        let [s0, s1, s2, s3] = sums.map(|[a, b, c, d]| (a + b) + (c + d));
        let d = &inverse_diagonal[i..i + 4];
        let y0 = (todo[0] - s0) * d[0];
        let y1 = (todo[1] - s1 - l1[i] * y0) * d[1];
        let y2 = (todo[2] - s2 - l2[i] * y0 - l2[i + 1] * y1) * d[2];
        let y3 = (todo[3] - s3 - l3[i] * y0 - l3[i + 1] * y1 - l3[i + 2] * y2) * d[3];
        todo[0] = y0;
        todo[1] = y1;
        todo[2] = y2;
        todo[3] = y3;
        i += 4;
    }
    while i < n {
        let (done, todo) = x.split_at_mut(i);
        todo[0] = (todo[0] - dot(&lower[start(i)..start(i) + i], done)) * inverse_diagonal[i];
        i += 1;
    }
}

/// Scalar product in four interleaved sums: four multiplications in flight on a Cortex-M4F.
#[inline]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let mut rest = 0.0;
    for (x, y) in a4.remainder().iter().zip(b4.remainder()) {
        rest += x * y;
    }
    for (x, y) in a4.zip(b4) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const N: usize = 13;
    type Factor = Cholesky<N, { packed(N) }>;

    /// A·Aᵀ + I of the first `n` rows of a random A.
    fn matrix(a: &[[f32; N]], rows: &[usize]) -> Vec<Vec<f32>> {
        rows.iter()
            .map(|&i| {
                rows.iter()
                    .map(|&j| {
                        let s: f32 = (0..N).map(|k| a[i][k] * a[j][k]).sum();
                        s + f32::from(u8::from(i == j))
                    })
                    .collect()
            })
            .collect()
    }

    fn factor(m: &[Vec<f32>]) -> Factor {
        let mut f = Factor::new();
        for i in 0..m.len() {
            f.stage(0).copy_from_slice(&m[i][..i + 1]);
            assert_eq!(f.append(), Ok(()));
        }
        f
    }

    fn solve_error(f: &Factor, m: &[Vec<f32>]) -> f32 {
        let mut x: Vec<f32> = (0..m.len()).map(|i| 1.0 - 0.3 * i as f32).collect();
        let b = x.clone();
        f.forward(&mut x);
        f.backward(&mut x);
        (0..m.len())
            .map(|i| ((0..m.len()).map(|j| m[i][j] * x[j]).sum::<f32>() - b[i]).abs())
            .fold(0.0, f32::max)
    }

    proptest! {
        #[test]
        fn appending_and_removing_solves(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), gone in 0usize..13) {
            let mut rows: Vec<usize> = (0..N).collect();
            let mut f = factor(&matrix(&a, &rows));
            prop_assert!(solve_error(&f, &matrix(&a, &rows)) < 1e-3);
            f.remove(gone);
            rows.remove(gone);
            let m = matrix(&a, &rows);
            prop_assert!(solve_error(&f, &m) < 1e-3);
            let fresh = factor(&m);
            prop_assert!((f.half_log_determinant() - fresh.half_log_determinant()).abs() < 1e-3);
            f.remove(99);
            prop_assert_eq!(f.rows(), N - 1);
        }
    }

    proptest! {
        #[test]
        fn downdating_takes_a_product_away(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), v in proptest::array::uniform13(-1.0f32..1.0)) {
            let rows: Vec<usize> = (0..N).collect();
            let m = matrix(&a, &rows);
            let more: Vec<Vec<f32>> =
                (0..N).map(|i| (0..N).map(|j| m[i][j] + v[i] * v[j]).collect()).collect();
            let mut f = factor(&more);
            f.downdate(&v[..N - 1]);
            prop_assert!(solve_error(&f, &more) < 1e-3);
            f.downdate(&v);
            prop_assert!(solve_error(&f, &m) < 3e-3);
            // More than there is: still a factor.
            f.downdate(&[100.0; N]);
            prop_assert!(f.half_log_determinant().is_finite());
        }
    }

    #[test]
    fn refuses_what_is_not_positive_definite() {
        let mut f = Factor::new();
        f.stage(0).copy_from_slice(&[2.0]);
        assert_eq!(f.append(), Ok(()));
        for bad in [[2.0, 2.0], [3.0, 1.0], [0.0, f32::NAN], [0.0, f32::INFINITY], [0.0, -1.0]] {
            f.stage(0).copy_from_slice(&bad);
            assert_eq!(f.append(), Err(NotPositiveDefinite));
            assert_eq!(f.rows(), 1);
        }
    }

    #[test]
    fn a_full_factor_stages_nothing() {
        let mut f = Cholesky::<1, 1>::new();
        f.stage(0)[0] = 1.0;
        assert_eq!(f.append(), Ok(()));
        assert!(f.stage(0).is_empty());
        assert_eq!(f.append(), Err(NotPositiveDefinite));
    }
}
