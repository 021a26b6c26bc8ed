//! Rows of a triangular factor in the order in which the processor wants them.
//!
//! A *panel* is [`WIDTH`] rows held column after column: `panel[k * WIDTH + r]` is column k of its
//! row r. In this order a panel is both operands of the product that dominates factorisation and
//! substitution, X Lᵀ, without any copying; and a right-hand side of L x = b is nothing but one
//! more row of the factor, so one routine, [`eliminate`], serves both.

use super::simd::Simd;

/// Rows of a panel: three vectors of 512 bits.
pub(super) const WIDTH: usize = 24;

/// Panels worked on together, so that the factor is read from far away once for all of them.
pub(super) const GROUP: usize = 4;

/// Where panel `number` of a lower-triangular matrix starts: panel i has (i + 1)·WIDTH columns.
pub(super) fn offset(number: usize) -> usize {
    WIDTH * WIDTH * number * (number + 1) / 2
}

/// Given rows x with x Lᵀ = b solved before column `first`, solves the WIDTH columns from there:
/// `rows` holds x there and b from there on, `factor` is the panel of L with those columns on its
/// diagonal, `reciprocals` one over that diagonal. x is known to be zero before column `from`; only
/// the first `width` rows matter.
#[inline(always)]
pub(super) fn eliminate<S: Simd>(
    s: S,
    rows: &mut [f64],
    factor: &[f64],
    reciprocals: &[f64],
    (from, first): (usize, usize),
    width: usize,
) {
    if S::LANES == 8 {
        eliminate_by::<S, 8>(s, rows, factor, reciprocals, (from, first), width);
    } else {
        eliminate_by::<S, 4>(s, rows, factor, reciprocals, (from, first), width);
    }
}

#[inline(always)]
fn eliminate_by<S: Simd, const C: usize>(
    s: S,
    rows: &mut [f64],
    factor: &[f64],
    reciprocals: &[f64],
    (from, first): (usize, usize),
    width: usize,
) {
    for chunk in 0..WIDTH / C {
        let column = first + chunk * C;
        let (done, rest) = rows.split_at_mut(column * WIDTH);
        let (done, known) = (&done[from * WIDTH..], &factor[from * WIDTH..column * WIDTH]);
        let corner = &factor[column * WIDTH..(column + C) * WIDTH];
        let reciprocals = &reciprocals[chunk * C..(chunk + 1) * C];
        let chunk = Chunk { done, known, corner, top: chunk * C, reciprocals };
        let mut row = 0;
        while row < width {
            row += match (width - row).div_ceil(S::LANES) {
                1 => chunk.eliminate::<S, C, 1>(s, rest, row),
                2 => chunk.eliminate::<S, C, 2>(s, rest, row),
                _ => chunk.eliminate::<S, C, 3>(s, rest, row),
            };
        }
    }
}

/// Columns solved together: the rows' columns before them, the factor's, their block on the diagonal,
/// where it starts, and one over its diagonal.
struct Chunk<'a> {
    done: &'a [f64],
    known: &'a [f64],
    corner: &'a [f64],
    top: usize,
    reciprocals: &'a [f64],
}

impl Chunk<'_> {
    /// Solves them for V vectors of rows from `row`. Returns how many rows those are.
    #[inline(always)]
    fn eliminate<S: Simd, const C: usize, const V: usize>(
        &self,
        s: S,
        rows: &mut [f64],
        row: usize,
    ) -> usize {
        let mut tile = load::<S, C, V>(s, rows, row);
        subtract(s, &mut tile, self.done, row, self.known, self.top);
        substitute(s, &mut tile, self.corner, self.top, self.reciprocals);
        store(s, &tile, rows, row);
        V * S::LANES
    }
}

/// The last step of a factor's own panel: all columns before `first` done, factors the block on
/// the diagonal and solves the rows below it. `least` are the pivots that count as lost.
///
/// # Errors
/// The row within the panel whose pivot is lost.
#[inline(always)]
pub(super) fn finish<S: Simd>(
    s: S,
    panel: &mut [f64],
    reciprocals: &mut [f64],
    least: &[f64],
    first: usize,
) -> Result<(), usize> {
    if S::LANES == 8 {
        finish_by::<S, 8>(s, panel, reciprocals, least, first)
    } else {
        finish_by::<S, 4>(s, panel, reciprocals, least, first)
    }
}

#[inline(always)]
fn finish_by<S: Simd, const C: usize>(
    s: S,
    panel: &mut [f64],
    reciprocals: &mut [f64],
    least: &[f64],
    first: usize,
) -> Result<(), usize> {
    for chunk in 0..WIDTH / C {
        let top = chunk * C;
        let column = first + top;
        let (done, rest) = panel.split_at_mut(column * WIDTH);
        for row in (0..WIDTH).step_by(3 * S::LANES) {
            let mut tile = load::<S, C, 3>(s, rest, row);
            subtract(s, &mut tile, done, row, done, top);
            store(s, &tile, rest, row);
        }
        let mut corner = [0.0; 8 * WIDTH];
        for j in 0..C {
            for k in 0..j {
                let scale = corner[k * WIDTH + top + j];
                for i in j..C {
                    rest[j * WIDTH + top + i] -= scale * corner[k * WIDTH + top + i];
                }
            }
            let pivot = rest[j * WIDTH + top + j];
            if !(pivot > least[top + j] && pivot.is_finite()) {
                return Err(top + j);
            }
            reciprocals[top + j] = 1.0 / pivot.sqrt();
            for i in j..C {
                corner[j * WIDTH + top + i] = rest[j * WIDTH + top + i] * reciprocals[top + j];
            }
        }
        // The rows of the block are in `corner` now; those above it are above the diagonal.
        for row in (0..WIDTH).step_by(3 * S::LANES) {
            let mut tile = load::<S, C, 3>(s, rest, row);
            substitute(s, &mut tile, &corner, top, &reciprocals[top..top + C]);
            store(s, &tile, rest, row);
        }
        for j in 0..C {
            rest[j * WIDTH..j * WIDTH + top].fill(0.0);
            rest[j * WIDTH + top..j * WIDTH + top + C]
                .copy_from_slice(&corner[j * WIDTH + top..j * WIDTH + top + C]);
        }
    }
    Ok(())
}

/// C columns of V vectors of rows.
pub(super) type Tile<S, const C: usize, const V: usize> = [[<S as Simd>::Vector; V]; C];

#[inline(always)]
pub(super) fn load<S: Simd, const C: usize, const V: usize>(
    s: S,
    from: &[f64],
    row: usize,
) -> Tile<S, C, V> {
    let mut tile = [[s.splat(0.0); V]; C];
    for j in 0..C {
        let column = &from[j * WIDTH + row..j * WIDTH + row + V * S::LANES];
        for v in 0..V {
            tile[j][v] = s.load(&column[v * S::LANES..]);
        }
    }
    tile
}

#[inline(always)]
pub(super) fn store<S: Simd, const C: usize, const V: usize>(
    s: S,
    tile: &Tile<S, C, V>,
    to: &mut [f64],
    row: usize,
) {
    for j in 0..C {
        let column = &mut to[j * WIDTH + row..j * WIDTH + row + V * S::LANES];
        for v in 0..V {
            s.store(tile[j][v], &mut column[v * S::LANES..]);
        }
    }
}

/// tile − X Yᵀ for rows of X from `row` and rows of Y from `column`.
#[inline(always)]
pub(super) fn subtract<S: Simd, const C: usize, const V: usize>(
    s: S,
    tile: &mut Tile<S, C, V>,
    x: &[f64],
    row: usize,
    y: &[f64],
    column: usize,
) {
    let mut sum = *tile;
    for (x, y) in x.as_chunks::<WIDTH>().0.iter().zip(y.as_chunks::<WIDTH>().0) {
        let x = &x[row..row + V * S::LANES];
        let y = &y[column..column + C];
        let mut a = [s.splat(0.0); V];
        for v in 0..V {
            a[v] = s.load(&x[v * S::LANES..]);
        }
        for j in 0..C {
            let b = s.splat(y[j]);
            for v in 0..V {
                sum[j][v] = s.mul_sub(a[v], b, sum[j][v]);
            }
        }
    }
    *tile = sum;
}

/// Solves x Lᵀ = tile for a block L on the diagonal whose rows start at `top` of `corner`.
#[inline(always)]
fn substitute<S: Simd, const C: usize, const V: usize>(
    s: S,
    tile: &mut Tile<S, C, V>,
    corner: &[f64],
    top: usize,
    reciprocals: &[f64],
) {
    let mut x = *tile;
    for j in 0..C {
        let below = &corner[j * WIDTH + top..j * WIDTH + top + C];
        for v in 0..V {
            x[j][v] = s.mul(x[j][v], s.splat(reciprocals[j]));
        }
        for i in j + 1..C {
            let scale = s.splat(below[i]);
            for v in 0..V {
                x[i][v] = s.mul_sub(x[j][v], scale, x[i][v]);
            }
        }
    }
    *tile = x;
}

/// X Xᵀ for two panels of rows: `to` (WIDTH columns) gets X Yᵀ over the columns from `from` on.
#[inline(always)]
pub(super) fn product<S: Simd>(s: S, x: &[f64], y: &[f64], from: usize, to: &mut [f64]) {
    if S::LANES == 8 {
        product_by::<S, 8>(s, x, y, from, to);
    } else {
        product_by::<S, 4>(s, x, y, from, to);
    }
}

#[inline(always)]
fn product_by<S: Simd, const C: usize>(s: S, x: &[f64], y: &[f64], from: usize, to: &mut [f64]) {
    let (x, y) = (&x[from * WIDTH..], &y[from * WIDTH..]);
    for column in (0..WIDTH).step_by(C) {
        for row in (0..WIDTH).step_by(3 * S::LANES) {
            let mut tile = [[s.splat(0.0); 3]; C];
            subtract(s, &mut tile, x, row, y, column);
            for j in 0..C {
                for v in 0..3 {
                    tile[j][v] = s.sub(s.splat(0.0), tile[j][v]);
                }
            }
            store(s, &tile, &mut to[column * WIDTH..], row);
        }
    }
}
