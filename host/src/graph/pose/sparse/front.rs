//! Dense elimination inside one supernode.
//!
//! A *front* is the lower triangle of a symmetric matrix, column after column, in two parts: the
//! *panel* has the columns that are eliminated, with all their rows; the *update* has what the
//! elimination leaves in the rows below. Columns are a multiple of [`LANES`] numbers apart, so that
//! vectors need no special case at the end; what is above the diagonal and beyond the last row is
//! scratch.

use crate::dense::simd::Simd;

/// Numbers that are worked on together: rows are padded to a multiple.
const LANES: usize = 4;

/// Columns worked on together. With eight rows their sums fill the registers of AVX2, and blocks of
/// three and six columns divide evenly.
const CHUNK: usize = 6;

/// `n` rounded up to a multiple of [`LANES`].
pub(super) fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// Numbers between the columns of a panel with `eliminated` columns and `below` rows below them.
pub(super) fn stride(eliminated: usize, below: usize) -> usize {
    padded(eliminated + padded(below))
}

/// Replaces the panel (its first `reciprocals.len()` rows are the triangle, `height` are all) by the
/// factor's columns. `least` are the pivots below which a column counts as dependent on those
/// before: the first such is the error. `reciprocals` become one over the diagonal.
#[inline(always)]
pub(super) fn eliminate<S: Simd>(
    s: S,
    panel: &mut [f64],
    stride: usize,
    height: usize,
    least: &[f64],
    reciprocals: &mut [f64],
) -> Result<(), usize> {
    for first in (0..reciprocals.len()).step_by(CHUNK) {
        let (done, rest) = panel.split_at_mut(first * stride);
        let panel = Panel { done, stride, height, first };
        let (least, reciprocals) = (&least[first..], &mut reciprocals[first..]);
        let result = match reciprocals.len() {
            1 => panel.chunk::<S, 1>(s, rest, least, reciprocals),
            2 => panel.chunk::<S, 2>(s, rest, least, reciprocals),
            3 => panel.chunk::<S, 3>(s, rest, least, reciprocals),
            4 => panel.chunk::<S, 4>(s, rest, least, reciprocals),
            5 => panel.chunk::<S, 5>(s, rest, least, reciprocals),
            _ => panel.chunk::<S, CHUNK>(s, rest, least, reciprocals),
        };
        result.map_err(|column| first + column)?;
    }
    Ok(())
}

/// A panel whose columns before `first` are done.
struct Panel<'a> {
    done: &'a [f64],
    stride: usize,
    height: usize,
    first: usize,
}

impl Panel<'_> {
    /// Eliminates the next C columns, which `rest` begins with.
    #[inline(always)]
    fn chunk<S: Simd, const C: usize>(
        &self,
        s: S,
        rest: &mut [f64],
        least: &[f64],
        reciprocals: &mut [f64],
    ) -> Result<(), usize> {
        let (stride, first) = (self.stride, self.first);
        let rest = &mut rest[..C * stride];
        // The triangle on the diagonal, by itself.
        let mut corner = [[0.0; C]; C];
        for c in 0..C {
            corner[c].copy_from_slice(&rest[c * stride + first..c * stride + first + C]);
        }
        for column in self.done.chunks_exact(stride) {
            let top = &column[first..first + C];
            for c in 0..C {
                for r in 0..C {
                    corner[c][r] -= top[c] * top[r];
                }
            }
        }
        for c in 0..C {
            let pivot = corner[c][c];
            if !(pivot > least[c]) || pivot == f64::INFINITY {
                return Err(c);
            }
            let reciprocal = 1.0 / pivot.sqrt();
            reciprocals[c] = reciprocal;
            for r in c..C {
                corner[c][r] *= reciprocal;
            }
            for later in c + 1..C {
                for r in later..C {
                    corner[later][r] -= corner[c][later] * corner[c][r];
                }
            }
        }
        // All rows from the triangle on, whose own come out as they are in `corner`.
        let (mut row, end) = (first / LANES * LANES, padded(self.height));
        while row + 2 * LANES <= end {
            self.rows::<S, C>(s, rest, row, 2, &corner, reciprocals);
            row += 2 * LANES;
        }
        if row < end {
            self.rows::<S, C>(s, rest, row, 1, &corner, reciprocals);
        }
        Ok(())
    }

    /// [`tile`](Self::tile) for `lanes` × [`LANES`] rows.
    #[inline(always)]
    fn rows<S: Simd, const C: usize>(
        &self,
        s: S,
        rest: &mut [f64],
        row: usize,
        lanes: usize,
        corner: &[[f64; C]; C],
        reciprocals: &[f64],
    ) {
        match lanes * LANES / S::LANES {
            1 => self.tile::<S, 1, C>(s, rest, row, corner, reciprocals),
            2 => self.tile::<S, 2, C>(s, rest, row, corner, reciprocals),
            _ => self.tile::<S, 4, C>(s, rest, row, corner, reciprocals),
        }
    }

    /// Rows of the chunk less their product with the columns done, divided by the triangle.
    #[inline(always)]
    fn tile<S: Simd, const V: usize, const C: usize>(
        &self,
        s: S,
        rest: &mut [f64],
        row: usize,
        corner: &[[f64; C]; C],
        reciprocals: &[f64],
    ) {
        let (stride, width) = (self.stride, V * S::LANES);
        let mut x = load::<S, V, C>(s, rest, stride, row);
        subtract::<S, V, C>(s, &mut x, self.done, stride, row, self.first);
        for c in 0..C {
            for p in 0..c {
                let factor = s.splat(corner[p][c]);
                for v in 0..V {
                    x[c][v] = s.mul_sub(x[p][v], factor, x[c][v]);
                }
            }
            let reciprocal = s.splat(reciprocals[c]);
            let column = &mut rest[c * stride + row..c * stride + row + width];
            for v in 0..V {
                x[c][v] = s.mul(x[c][v], reciprocal);
                s.store(x[c][v], &mut column[v * S::LANES..]);
            }
        }
    }
}

#[inline(always)]
fn load<S: Simd, const V: usize, const C: usize>(
    s: S,
    columns: &[f64],
    stride: usize,
    row: usize,
) -> [[S::Vector; V]; C] {
    let mut x = [[s.splat(0.0); V]; C];
    for c in 0..C {
        let column = &columns[c * stride + row..c * stride + row + V * S::LANES];
        for v in 0..V {
            x[c][v] = s.load(&column[v * S::LANES..]);
        }
    }
    x
}

/// x − Σ_p a_p b_pᵀ, where a are the rows from `row` and b the C rows from `other` of all columns p.
#[inline(always)]
fn subtract<S: Simd, const V: usize, const C: usize>(
    s: S,
    x: &mut [[S::Vector; V]; C],
    columns: &[f64],
    stride: usize,
    row: usize,
    other: usize,
) {
    for column in columns.chunks_exact(stride) {
        let a = &column[row..row + V * S::LANES];
        let b = &column[other..other + C];
        let mut vectors = [s.splat(0.0); V];
        for v in 0..V {
            vectors[v] = s.load(&a[v * S::LANES..]);
        }
        for c in 0..C {
            let factor = s.splat(b[c]);
            for v in 0..V {
                x[c][v] = s.mul_sub(vectors[v], factor, x[c][v]);
            }
        }
    }
}

/// The update less the product of the panel's rows below its triangle with themselves. With `fresh`
/// the update is taken for zeros, whatever it holds.
#[inline(always)]
pub(super) fn update<S: Simd>(
    s: S,
    panel: &[f64],
    stride: usize,
    eliminated: usize,
    update: &mut [f64],
    below: usize,
    fresh: bool,
) {
    let product = Product { panel, stride, eliminated, step: padded(below), fresh };
    for column in (0..below).step_by(CHUNK) {
        match below - column {
            1 => product.columns::<S, 1>(s, update, column),
            2 => product.columns::<S, 2>(s, update, column),
            3 => product.columns::<S, 3>(s, update, column),
            4 => product.columns::<S, 4>(s, update, column),
            5 => product.columns::<S, 5>(s, update, column),
            _ => product.columns::<S, CHUNK>(s, update, column),
        }
    }
}

/// The product of the rows below a panel's triangle with themselves.
struct Product<'a> {
    panel: &'a [f64],
    stride: usize,
    eliminated: usize,
    /// Numbers between the columns of the update, which are also its rows.
    step: usize,
    fresh: bool,
}

impl Product<'_> {
    /// The C columns from `column`.
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&self, s: S, update: &mut [f64], column: usize) {
        let update = &mut update[column * self.step..(column + C) * self.step];
        let mut row = column / LANES * LANES;
        while row + 2 * LANES <= self.step {
            self.rows::<S, C>(s, update, row, column, 2);
            row += 2 * LANES;
        }
        if row < self.step {
            self.rows::<S, C>(s, update, row, column, 1);
        }
    }

    #[inline(always)]
    fn rows<S: Simd, const C: usize>(
        &self,
        s: S,
        update: &mut [f64],
        row: usize,
        column: usize,
        lanes: usize,
    ) {
        match lanes * LANES / S::LANES {
            1 => self.tile::<S, 1, C>(s, update, row, column),
            2 => self.tile::<S, 2, C>(s, update, row, column),
            _ => self.tile::<S, 4, C>(s, update, row, column),
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const V: usize, const C: usize>(
        &self,
        s: S,
        update: &mut [f64],
        row: usize,
        column: usize,
    ) {
        let (step, width) = (self.step, V * S::LANES);
        let mut x = match self.fresh {
            true => [[s.splat(0.0); V]; C],
            false => load::<S, V, C>(s, update, step, row),
        };
        let (above, other) = (self.eliminated + row, self.eliminated + column);
        subtract::<S, V, C>(s, &mut x, self.panel, self.stride, above, other);
        for c in 0..C {
            let to = &mut update[c * step + row..c * step + row + width];
            for v in 0..V {
                s.store(x[c][v], &mut to[v * S::LANES..]);
            }
        }
    }
}
