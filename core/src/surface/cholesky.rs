//! An incremental Cholesky factor in packed storage: rows are appended and removed one at a time,
//! never refactored.

mod products;

use heapless::Vec;

use crate::math;
use products::{
    IN_PAIRS, TOGETHER, add_products, four_products, one_product, pair_of_products, products,
};

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
        let row = self.rows.saturating_add(ahead);
        if row >= ROWS {
            return &mut [];
        }
        &mut self.lower[start(row)..start(row + 1)]
    }

    /// The first four [staged](Self::stage) rows at once.
    pub fn stage_together(&mut self) -> [&mut [f32]; TOGETHER] {
        let rows = self.rows;
        let mut rest = &mut self.lower[start(rows)..];
        core::array::from_fn(|ahead| {
            let length = if rows + ahead < ROWS { rows + ahead + 1 } else { 0 };
            let (row, after) = core::mem::take(&mut rest).split_at_mut(length);
            rest = after;
            row
        })
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
        let (old, staged) = self.lower.split_at_mut(start(n));
        let staged = &mut staged[..n];
        forward(old, &self.inverse_diagonal[..n], staged);
        let known = dot(staged, staged);
        self.finish(n, &[known])
    }

    /// Appends the first `count` staged rows, one to four, in one pass over the factor; takes four
    /// times `ROWS` numbers of stack.
    ///
    /// # Errors
    /// As [`append`](Self::append); the factor is as it was.
    #[inline(always)]
    pub fn append_together(&mut self, count: usize) -> Result<(), NotPositiveDefinite> {
        match count {
            1 => self.append(),
            2 | 3 => self.append_sides::<3>(count),
            4 => self.append_sides::<4>(count),
            _ => Err(NotPositiveDefinite),
        }
    }

    #[inline(never)]
    fn append_sides<const C: usize>(&mut self, count: usize) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        if n + count > ROWS {
            return Err(NotPositiveDefinite);
        }
        // Where there are fewer than C, the last again.
        let staged = |side: usize| &self.lower[start(n + side.min(count - 1))..][..n];
        let staged: [&[f32]; C] = core::array::from_fn(staged);
        let mut columns = Vec::<[f32; C], ROWS>::new();
        columns.extend((0..n).map(|k| staged.map(|row| row[k])));
        self.append_columns(count, &mut columns)
    }

    /// Appends C rows in one pass over the factor. `columns` holds their covariances with the rows
    /// before, all C of a row together, and is the workspace; they are independent of each other, with
    /// variances `own`.
    ///
    /// # Errors
    /// As [`append`](Self::append), or when there are not [`rows`](Self::rows)`()` columns; the factor is
    /// as it was.
    pub fn append_independent<const C: usize>(
        &mut self,
        columns: &mut [[f32; C]],
        own: [f32; C],
    ) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        if n + C > ROWS || columns.len() != n {
            return Err(NotPositiveDefinite);
        }
        for (side, variance) in own.into_iter().enumerate() {
            let corner = &mut self.lower[start(n + side) + n..=start(n + side) + n + side];
            corner.fill(0.0);
            corner[side] = variance;
        }
        self.append_columns(C, columns)
    }

    /// Appends the first `count` of C rows in one pass over the factor. `columns` is as in
    /// [`append_independent`](Self::append_independent); the lower triangle of `own` is their covariance.
    ///
    /// # Errors
    /// As [`append_independent`](Self::append_independent), or when `count` is more than C; the factor is
    /// as it was.
    pub fn append_block<const C: usize>(
        &mut self,
        count: usize,
        columns: &mut [[f32; C]],
        own: &[[f32; C]; C],
    ) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        if count > C || n + count > ROWS || columns.len() != n {
            return Err(NotPositiveDefinite);
        }
        for (side, own) in own[..count].iter().enumerate() {
            self.lower[start(n + side) + n..][..=side].copy_from_slice(&own[..=side]);
        }
        self.append_columns(count, columns)
    }

    /// Appends the first `count` of C rows, whose covariances among themselves are staged; there is
    /// room for them.
    #[inline(always)]
    fn append_columns<const C: usize>(
        &mut self,
        count: usize,
        columns: &mut [[f32; C]],
    ) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        self.forward_together(0, columns);
        for side in 0..count {
            let staged = &mut self.lower[start(n + side)..];
            columns.iter().zip(staged).for_each(|(x, staged)| *staged = x[side]);
        }
        let mut products = [[0.0; C]; C];
        for x in &*columns {
            for i in 0..C {
                for j in 0..=i {
                    products[i][j] += x[i] * x[j];
                }
            }
        }
        for own in &products[..count] {
            if self.finish(n, own).is_err() {
                self.rows = n;
                return Err(NotPositiveDefinite);
            }
        }
        Ok(())
    }

    /// Appends the staged row, which is solved before column `solved`; the products of what is solved
    /// with that of the rows from `solved` on, itself last, are `known`.
    fn finish(&mut self, solved: usize, known: &[f32]) -> Result<(), NotPositiveDefinite> {
        let n = self.rows;
        let (old, rest) = self.lower.split_at_mut(start(n));
        let row = &mut rest[solved..n + 1];
        let mut left = 0.0;
        for (k, known) in (solved..n + 1).zip(known) {
            let (before, own) = row.split_at_mut(k - solved);
            left = own[0] - known;
            if k < n {
                for (l, x) in old[start(k) + solved..start(k) + k].iter().zip(&*before) {
                    left -= l * x;
                }
                own[0] = left * self.inverse_diagonal[k];
            } else {
                for x in &*before {
                    left -= x * x;
                }
            }
        }
        let variance = row[n - solved];
        // Below this the new number is rounding error, not information.
        if !(left > 1e-7 * variance && variance.is_finite()) {
            return Err(NotPositiveDefinite);
        }
        let diagonal = math::sqrt(left);
        row[n - solved] = diagonal;
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
    /// 3·`ROWS` numbers of stack. What is left must be positive definite: where it would not be, or not
    /// beyond rounding, less is taken away. A v shorter than `rows()` changes nothing.
    pub fn downdate(&mut self, v: &[f32]) {
        let n = if v.len() < self.rows { 0 } else { self.rows };
        // The rotation of each column: 1/cosh, tanh, cosh.
        let mut turns = [(1.0f32, 0.0f32, 1.0f32); ROWS];
        // 1 − |L⁻¹v|² of the rows so far. Below this later rows, which grow by its root, are rounding errors.
        const LEAST: f32 = 1e-6;
        let mut left = 1.0;
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
            let r = math::sqrt(d * d - v * v);
            let c = r / d;
            // NaN fails the comparison.
            if left * c * c > LEAST {
                left *= c * c;
                turns[i] = (c, v / d, d / r);
                row[i] = r;
                self.inverse_diagonal[i] = 1.0 / r;
            }
        }
    }

    /// x ← L⁻¹ x over the first `rows()` numbers; a shorter x uses as many rows as it has.
    pub fn forward(&self, x: &mut [f32]) {
        let n = self.rows.min(x.len());
        forward(&self.lower, &self.inverse_diagonal[..n], &mut x[..n]);
    }

    /// L⁻¹ of C right-hand sides in one pass over the factor. All are zero before row `first`, from
    /// which on `x` holds them, one row of them after the other.
    pub fn forward_together<const C: usize>(&self, first: usize, x: &mut [[f32; C]]) {
        let n = self.rows.saturating_sub(first).min(x.len());
        if n == 0 {
            return;
        }
        let diagonal = &self.inverse_diagonal[first..];
        let mut rest = &self.lower[start(first)..];
        let mut row = rest;
        let mut i = 0;
        while i < n {
            let (done, todo) = x[..n].split_at_mut(i);
            if let [here] = todo {
                let sums = one_product(&rest[first..][..i], done);
                for c in 0..C {
                    here[c] = (here[c] - sums[c]) * diagonal[i];
                }
                return;
            }
            // Past the last row the last again.
            let mut next = |i: usize| -> [&[f32]; TOGETHER] {
                core::array::from_fn(|r| {
                    if i + r < n {
                        (row, rest) = rest.split_at(first + i + r + 1);
                    }
                    &row[first..]
                })
            };
            let rows = next(i);
            if !IN_PAIRS || todo.len() < 2 * TOGETHER {
                let sums = products(rows.map(|row| &row[..i]), done);
                solve(rows.map(|row| &row[i..]), sums, &diagonal[i..], todo);
                i += TOGETHER;
                continue;
            }
            let j = i + TOGETHER;
            let others = next(j);
            let [sums, mut further] = pair_of_products([rows, others], done);
            let (here, there) = todo.split_at_mut(TOGETHER);
            solve(rows.map(|row| &row[i..]), sums, &diagonal[i..], here);
            add_products(others.map(|row| &row[i..j]), here, &mut further);
            solve(others.map(|row| &row[j..]), further, &diagonal[j..], there);
            i = j + TOGETHER;
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

/// x ← L⁻¹ x for the rows at the head of `x`, at most four, of which `rows` hold the columns from their own
/// on; what all columns before make of them are the `sums`.
#[inline(always)]
fn solve<const C: usize>(
    rows: [&[f32]; TOGETHER],
    sums: [[f32; C]; TOGETHER],
    diagonal: &[f32],
    x: &mut [[f32; C]],
) {
    if let ([x0, x1, x2, x3, ..], [d0, d1, d2, d3, ..]) = (&mut *x, diagonal) {
        let [_, l1, l2, l3] = rows;
        let (l1, l2, l3) = (l1[0], [l2[0], l2[1]], [l3[0], l3[1], l3[2]]);
        for c in 0..C {
            let y0 = (x0[c] - sums[0][c]) * d0;
            let y1 = (x1[c] - sums[1][c] - l1 * y0) * d1;
            let y2 = (x2[c] - sums[2][c] - l2[0] * y0 - l2[1] * y1) * d2;
            let y3 = x3[c] - sums[3][c] - l3[0] * y0 - l3[1] * y1 - l3[2] * y2;
            (x0[c], x1[c], x2[c], x3[c]) = (y0, y1, y2, y3 * d3);
        }
        return;
    }
    for r in 0..x.len().min(TOGETHER) {
        let (before, here) = x.split_at_mut(r);
        for c in 0..C {
            let mut rest = here[0][c] - sums[r][c];
            for (l, x) in rows[r].iter().zip(&*before) {
                rest -= l * x[c];
            }
            here[0][c] = rest * diagonal[r];
        }
    }
}

/// x ← L⁻¹ x, four rows at a time so that each x is loaded once for four products.
#[inline]
fn forward(lower: &[f32], inverse_diagonal: &[f32], x: &mut [f32]) {
    let n = x.len();
    let mut rest = lower;
    let (diagonals, _) = inverse_diagonal[..n].as_chunks::<TOGETHER>();
    for (block, [d0, d1, d2, d3]) in diagonals.iter().enumerate() {
        let i = TOGETHER * block;
        let (done, todo) = x.split_at_mut(i);
        let [x0, x1, x2, x3, ..] = todo else { break };
        let rows: [&[f32]; TOGETHER];
        (rows, rest) = four_rows(rest, i);
        let [s0, s1, s2, s3] = four_products(rows.map(|row| &row[..i]), done);
        let [_, l1, l2, l3] = rows.map(|row| &row[i..]);
        let y0 = (*x0 - s0) * d0;
        let y1 = (*x1 - s1 - l1[0] * y0) * d1;
        let y2 = (*x2 - s2 - l2[0] * y0 - l2[1] * y1) * d2;
        let y3 = (*x3 - s3 - l3[0] * y0 - l3[1] * y1 - l3[2] * y2) * d3;
        (*x0, *x1, *x2, *x3) = (y0, y1, y2, y3);
    }
    for i in n - n % TOGETHER..n {
        let (done, todo) = x.split_at_mut(i);
        todo[0] = (todo[0] - dot(&lower[start(i)..start(i) + i], done)) * inverse_diagonal[i];
    }
}

/// Rows `i` to `i` + 3, which begin here, and what follows them.
#[inline(always)]
fn four_rows(lower: &[f32], i: usize) -> ([&[f32]; TOGETHER], &[f32]) {
    let mut rest = lower;
    let rows = core::array::from_fn(|r| {
        let row;
        (row, rest) = rest.split_at(i + r + 1);
        row
    });
    (rows, rest)
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
mod tests;
