//! The matrix from which an arrow's faces are solved once its poses are gone: C − BᵀT⁻¹B.
//!
//! With many faces nearly all time of a factorisation goes into this product. Only its lower triangle is
//! read, a column of it is a few whole vectors, and a face that no grasp up to here has felt has nothing
//! taken from it. Sums are made in the order of a plain product and without fused multiplication, so that
//! the bits do not depend on the processor.

use nalgebra::DMatrix;

use super::arrow::Row;
use crate::dense::simd::{Simd, Work, run};

/// Numbers of a column that are worked on together.
const LANES: usize = 8;

/// Some numbers of a column.
type Lanes = [f64; LANES];

/// The lower triangle, column by column, each filled up to whole [`Lanes`].
pub(super) struct Schur {
    width: usize,
    /// Lanes of a column.
    height: usize,
    columns: Vec<Lanes>,
}

impl Schur {
    /// C, its diagonal so many times as large.
    pub fn new(corner: &DMatrix<f64>, enlarge: f64) -> Schur {
        let width = corner.nrows();
        let height = width.div_ceil(LANES);
        let mut columns = vec![[0.0; LANES]; width * height];
        if height > 0 {
            for (j, column) in columns.chunks_mut(height).enumerate() {
                let column = column.as_flattened_mut();
                column[..width].copy_from_slice(&corner.as_slice()[j * width..(j + 1) * width]);
                column[j] *= enlarge;
            }
        }
        Schur { width, height, columns }
    }

    /// Takes HᵀH away for the `half` rows H = L⁻¹B of a pose.
    pub fn take<const D: usize>(&mut self, half: &Row<D>) {
        let lanes = |c: usize| {
            let mut rows = [[0.0; LANES]; D];
            for (l, column) in (c * LANES..self.width.min((c + 1) * LANES)).enumerate() {
                for (row, x) in rows.iter_mut().zip(half.column(column).iter()) {
                    row[l] = *x;
                }
            }
            rows
        };
        let rows: Vec<[Lanes; D]> = (0..self.height).map(lanes).collect();
        run(Take { schur: self, rows: &rows });
    }

    /// As a matrix whose upper triangle says nothing.
    pub fn matrix(self) -> DMatrix<f64> {
        let column = |j: usize| &self.columns[j * self.height..(j + 1) * self.height];
        let all = (0..self.width).flat_map(|j| &column(j).as_flattened()[..self.width]);
        DMatrix::from_iterator(self.width, self.width, all.copied())
    }
}

/// [`Schur::take`] with H by lanes of its columns.
struct Take<'a, const D: usize> {
    schur: &'a mut Schur,
    rows: &'a [[Lanes; D]],
}

impl<const D: usize> Work for Take<'_, D> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        if self.schur.height == 0 {
            return;
        }
        for (j, column) in self.schur.columns.chunks_mut(self.schur.height).enumerate() {
            let (first, lane) = (j / LANES, j % LANES);
            let by: [f64; D] = std::array::from_fn(|d| self.rows[first][d][lane]);
            if by == [0.0; D] {
                continue;
            }
            // A product less so many times minus another is their sum, each rounded.
            let by: [S::Vector; D] =
                std::array::from_fn(|d| s.splat(if d == 0 { by[d] } else { -by[d] }));
            for (to, rows) in column[first..].iter_mut().zip(&self.rows[first..]) {
                for at in (0..LANES).step_by(S::LANES) {
                    let mut sum = s.mul(s.load(&rows[0][at..]), by[0]);
                    for d in 1..D {
                        sum = s.sub(sum, s.mul(s.load(&rows[d][at..]), by[d]));
                    }
                    s.store(s.sub(s.load(&to[at..]), sum), &mut to[at..]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take<const D: usize>(width: usize) {
        let mut corner =
            DMatrix::from_fn(width, width, |i, j| 3.0 + ((i + j) as f64).sin() + (i * j) as f64);
        let mut schur = Schur::new(&corner, 1.1);
        for i in 0..width {
            corner[(i, i)] *= 1.1;
        }
        for pose in 0..3 {
            // Every third column is of a face that was not felt.
            let number =
                |i, j| if j % 3 == pose { 0.0 } else { ((7 * i + 3 * j + pose) as f64).cos() };
            let half = Row::<D>::from_fn(width, number);
            schur.take(&half);
            for (i, j) in (0..width).flat_map(|j| (0..width).map(move |i| (i, j))) {
                corner[(i, j)] -= (1..D)
                    .fold(half[(0, i)] * half[(0, j)], |sum, d| sum + half[(d, i)] * half[(d, j)]);
            }
        }
        assert_eq!(schur.matrix().lower_triangle(), corner.lower_triangle(), "{width}");
    }

    #[test]
    fn it_has_the_bits_of_a_plain_product() {
        for width in [0, 1, 2, 7, 8, 9, 18, 40] {
            take::<3>(width);
            take::<6>(width);
        }
    }
}
