//! Dense elimination inside one supernode.
//!
//! A *front* is the lower triangle of a symmetric matrix, column after column, in two parts: the
//! *panel* has the columns that are eliminated, with all their rows; the *update* has what the
//! elimination leaves in the rows below. Columns are `stride` numbers apart, a multiple of
//! [`LANES`], and the rows up to there are zeros, so that vectors need no special case at the end.

use crate::dense::simd::Simd;

/// Numbers that are worked on together, at most: columns and rows are padded to a multiple.
pub(super) const LANES: usize = 4;

/// Columns eliminated together.
const CHUNK: usize = 4;

/// `n` rounded up to a multiple of [`LANES`].
pub(super) fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// Numbers between the columns of a panel with `eliminated` columns and `below` rows below them.
pub(super) fn stride(eliminated: usize, below: usize) -> usize {
    padded(eliminated + padded(below))
}

/// Replaces the panel (its first `reciprocals.len()` rows are the triangle) by the factor's columns.
/// `least` are the pivots below which a column counts as dependent on those before: the first such
/// is the error. `reciprocals` become one over the diagonal.
#[inline(always)]
pub(super) fn eliminate<S: Simd>(
    s: S,
    panel: &mut [f64],
    stride: usize,
    height: usize,
    least: &[f64],
    reciprocals: &mut [f64],
) -> Result<(), usize> {
    let columns = reciprocals.len();
    for first in (0..columns).step_by(CHUNK) {
        let (least, reciprocals) = (&least[first..], &mut reciprocals[first..]);
        let (done, rest) = panel.split_at_mut(first * stride);
        let result = match columns - first {
            1 => chunk::<S, 1>(s, done, rest, stride, height, first, least, reciprocals),
            2 => chunk::<S, 2>(s, done, rest, stride, height, first, least, reciprocals),
            3 => chunk::<S, 3>(s, done, rest, stride, height, first, least, reciprocals),
            _ => chunk::<S, CHUNK>(s, done, rest, stride, height, first, least, reciprocals),
        };
        result.map_err(|column| first + column)?;
    }
    Ok(())
}

/// Eliminates the columns `first .. first + C`, which `rest` begins with; `done` are those before.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn chunk<S: Simd, const C: usize>(
    s: S,
    done: &[f64],
    rest: &mut [f64],
    stride: usize,
    height: usize,
    first: usize,
    least: &[f64],
    reciprocals: &mut [f64],
) -> Result<(), usize> {
    let rest = &mut rest[..C * stride];
    let vectors = LANES / S::LANES;
    // The triangle on the diagonal.
    let mut corner = [[0.0; C]; C];
    for c in 0..C {
        for r in c..C {
            corner[c][r] = rest[c * stride + first + r];
        }
    }
    for column in done.chunks_exact(stride) {
        let top = &column[first..first + C];
        for c in 0..C {
            for r in c..C {
                corner[c][r] -= top[c] * top[r];
            }
        }
    }
    for c in 0..C {
        for p in 0..c {
            for r in c..C {
                corner[c][r] -= corner[p][c] * corner[p][r];
            }
        }
        if !(corner[c][c] > least[c]) || corner[c][c] == f64::INFINITY {
            return Err(c);
        }
        let pivot = corner[c][c].sqrt();
        reciprocals[c] = 1.0 / pivot;
        corner[c][c] = pivot;
        for r in c + 1..C {
            corner[c][r] *= reciprocals[c];
        }
    }
    // All rows from the triangle on, whose own come out as they are in `corner`.
    let mut row = first;
    while row < height {
        row += match (height - row).div_ceil(LANES) {
            1 => rows::<S, C>(s, done, rest, stride, row, first, &corner, reciprocals, 1, vectors),
            2 => rows::<S, C>(s, done, rest, stride, row, first, &corner, reciprocals, 2, vectors),
            _ => rows::<S, C>(s, done, rest, stride, row, first, &corner, reciprocals, 3, vectors),
        };
    }
    Ok(())
}

/// [`tile`] for `lanes` × [`LANES`] rows; returns how many rows that is.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn rows<S: Simd, const C: usize>(
    s: S,
    done: &[f64],
    rest: &mut [f64],
    stride: usize,
    row: usize,
    first: usize,
    corner: &[[f64; C]; C],
    reciprocals: &[f64],
    lanes: usize,
    vectors: usize,
) -> usize {
    match lanes * vectors {
        1 => tile::<S, 1, C>(s, done, rest, stride, row, first, corner, reciprocals),
        2 => tile::<S, 2, C>(s, done, rest, stride, row, first, corner, reciprocals),
        3 => tile::<S, 3, C>(s, done, rest, stride, row, first, corner, reciprocals),
        4 => tile::<S, 4, C>(s, done, rest, stride, row, first, corner, reciprocals),
        _ => tile::<S, 6, C>(s, done, rest, stride, row, first, corner, reciprocals),
    }
    lanes * LANES
}

/// Rows of the chunk less their product with the columns done, divided by the triangle.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn tile<S: Simd, const V: usize, const C: usize>(
    s: S,
    done: &[f64],
    rest: &mut [f64],
    stride: usize,
    row: usize,
    first: usize,
    corner: &[[f64; C]; C],
    reciprocals: &[f64],
) {
    let width = V * S::LANES;
    let mut x = [[s.splat(0.0); V]; C];
    for c in 0..C {
        let column = &rest[c * stride + row..c * stride + row + width];
        for v in 0..V {
            x[c][v] = s.load(&column[v * S::LANES..]);
        }
    }
    subtract::<S, V, C>(s, &mut x, done, stride, row, first);
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

/// x − Σ_p a_p b_p, where a are the rows from `row` and b the C rows from `other` of all columns p.
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
    let step = padded(below);
    let vectors = LANES / S::LANES;
    for column in (0..below).step_by(CHUNK) {
        let mut row = column;
        while row < below {
            let lanes = (step - row).div_ceil(LANES).min(3);
            match lanes * vectors {
                1 => square::<S, 1>(s, panel, stride, eliminated, update, step, row, column, fresh),
                2 => square::<S, 2>(s, panel, stride, eliminated, update, step, row, column, fresh),
                3 => square::<S, 3>(s, panel, stride, eliminated, update, step, row, column, fresh),
                4 => square::<S, 4>(s, panel, stride, eliminated, update, step, row, column, fresh),
                _ => square::<S, 6>(s, panel, stride, eliminated, update, step, row, column, fresh),
            }
            row += lanes * LANES;
        }
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn square<S: Simd, const V: usize>(
    s: S,
    panel: &[f64],
    stride: usize,
    eliminated: usize,
    update: &mut [f64],
    step: usize,
    row: usize,
    column: usize,
    fresh: bool,
) {
    let width = V * S::LANES;
    let mut x = [[s.splat(0.0); V]; CHUNK];
    if !fresh {
        for c in 0..CHUNK {
            let from = &update[(column + c) * step + row..(column + c) * step + row + width];
            for v in 0..V {
                x[c][v] = s.load(&from[v * S::LANES..]);
            }
        }
    }
    subtract::<S, V, CHUNK>(s, &mut x, panel, stride, eliminated + row, eliminated + column);
    for c in 0..CHUNK {
        let to = &mut update[(column + c) * step + row..(column + c) * step + row + width];
        for v in 0..V {
            s.store(x[c][v], &mut to[v * S::LANES..]);
        }
    }
}
