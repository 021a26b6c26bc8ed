//! Lower triangles in panels.

use nalgebra::DMatrix;

use super::aligned::Aligned;
use super::panel::{WIDTH, offset};

/// The lower triangle of a square matrix, half the memory of the whole.
#[derive(Clone, Debug)]
pub struct Lower {
    pub(super) rows: usize,
    /// Panels of rows one after the other, filled up with rows that are not there.
    pub(super) panels: Aligned,
}

impl Lower {
    /// All zero.
    pub fn zeros(rows: usize) -> Self {
        Lower { rows, panels: Aligned::zeros(offset(rows.div_ceil(WIDTH))) }
    }

    /// The lower triangle of a square matrix.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        let mut lower = Self::zeros(matrix.nrows());
        for j in 0..lower.rows {
            for i in j..lower.rows {
                *lower.at(i, j) = matrix[(i, j)];
            }
        }
        lower
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Entry (i, j), j ≤ i.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.panels[offset(i / WIDTH) + j * WIDTH + i % WIDTH]
    }

    /// Entry (i, j), j ≤ i.
    pub fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.panels[offset(i / WIDTH) + j * WIDTH + i % WIDTH]
    }

    /// Panel after panel with the number of its first row. What it holds right of the diagonal
    /// and below the last row does not count.
    pub(super) fn panels_mut(&mut self) -> impl Iterator<Item = (usize, &mut [f64])> {
        let mut rest = &mut *self.panels;
        (0..self.rows.div_ceil(WIDTH)).map(move |i| {
            let (panel, after) = std::mem::take(&mut rest).split_at_mut(offset(i + 1) - offset(i));
            rest = after;
            (i * WIDTH, panel)
        })
    }

    /// The sum over all entries, on both sides of the diagonal, of a symmetric matrix times
    /// `xᵢ xⱼ − other`ᵢⱼ.
    pub fn contract(&self, x: &[f64], other: &Lower) -> f64 {
        let mut sum = 0.0;
        for j in 0..self.rows {
            for i in j..self.rows {
                let share = if i == j { 1.0 } else { 2.0 };
                sum += share * self.get(i, j) * (x[i] * x[j] - other.get(i, j));
            }
        }
        sum
    }
}

/// Of matrices with as many rows.
impl std::ops::AddAssign for Lower {
    fn add_assign(&mut self, other: Lower) {
        for (sum, more) in self.panels.iter_mut().zip(other.panels.iter()) {
            *sum += more;
        }
    }
}
