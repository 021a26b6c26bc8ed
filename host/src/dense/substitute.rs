//! Solving triangular systems.

use super::cholesky::Cholesky;
use super::panel::{GROUP, WIDTH, eliminate, load, offset, store, subtract};
use super::sides::Sides;
use super::simd::{Simd, Work, run};

/// L⁻¹ b for the first `count` sides: the same bits for a side, however many there are.
pub(super) fn forward(factor: &Cholesky, sides: &mut Sides, count: usize) {
    let panel = &mut sides.panels;
    match count {
        0 => {}
        1 => run(ForwardFew::<1> { factor, panel, first: 0 }),
        2..=FEW => run(ForwardFew::<FEW> { factor, panel, first: 0 }),
        _ => run(Forward { factor, sides, count, identity: false }),
    }
}

/// Up to so many sides are solved with rows of the factor side by side in vectors, more of them with
/// sides in vectors.
const FEW: usize = 4;

/// L⁻¹ b for the first `count` sides, as many of them side by side in vectors as there are.
pub(super) struct Forward<'a> {
    pub factor: &'a Cholesky,
    pub sides: &'a mut Sides,
    pub count: usize,
    /// Whether the sides are the columns of the identity, zero before their own number.
    pub identity: bool,
}

impl Work for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        let Cholesky { factor, reciprocals } = self.factor;
        let stride = self.sides.stride();
        if stride == 0 {
            return;
        }
        for (number, group) in self.sides.panels.chunks_mut(GROUP * stride).enumerate() {
            let start = if self.identity { number * GROUP } else { 0 };
            for j in start..factor.rows.div_ceil(WIDTH) {
                let panel = &factor.panels[offset(j)..offset(j + 1)];
                let diagonal = &reciprocals[j * WIDTH..(j + 1) * WIDTH];
                for (first, rows) in (number * GROUP..).zip(group.chunks_exact_mut(stride)) {
                    let width = self.count.saturating_sub(first * WIDTH).min(WIDTH);
                    eliminate(s, rows, panel, diagonal, (start * WIDTH, j * WIDTH), width);
                }
            }
        }
    }
}

/// L⁻¹ x for the C sides from `first` of one panel, in the order of [`Forward`], so that every
/// rounding is the same. Here rows of the factor are side by side in vectors, not right-hand sides,
/// of which there need not be a whole panel.
struct ForwardFew<'a, const C: usize> {
    factor: &'a Cholesky,
    panel: &'a mut [f64],
    first: usize,
}

impl<const C: usize> Work for ForwardFew<'_, C> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        let Cholesky { factor, reciprocals } = self.factor;
        for i in 0..factor.rows.div_ceil(WIDTH) {
            let panel = &factor.panels[offset(i)..offset(i + 1)];
            let (known, corner) = panel.split_at(i * WIDTH * WIDTH);
            let (done, here) = self.panel.split_at_mut(i * WIDTH * WIDTH);
            let mut x = [[0.0; WIDTH]; C];
            for (j, x) in x.iter_mut().enumerate() {
                (0..WIDTH).for_each(|r| x[r] = here[r * WIDTH + self.first + j]);
            }
            let x = x.as_flattened_mut();
            for row in (0..WIDTH).step_by(3 * S::LANES) {
                let mut tile = load::<S, C, 3>(s, x, row);
                subtract(s, &mut tile, known, row, done, self.first);
                store(s, &tile, x, row);
            }
            within::<S, C>(s, x, corner, &reciprocals[i * WIDTH..(i + 1) * WIDTH]);
            for (x, j) in x.as_chunks::<WIDTH>().0.iter().zip(self.first..) {
                (0..WIDTH).for_each(|r| here[r * WIDTH + j] = x[r]);
            }
        }
    }
}

/// Solves L x = b in place for a block L on the diagonal, a column at a time, for C sides one after
/// the other: none waits for its own last column alone.
#[inline(always)]
fn within<S: Simd, const C: usize>(s: S, x: &mut [f64], block: &[f64], reciprocals: &[f64]) {
    let sides = x.as_chunks_mut::<WIDTH>().0;
    for (k, column) in block.as_chunks::<WIDTH>().0.iter().enumerate() {
        for x in sides.iter_mut().take(C) {
            let found = x[k] * reciprocals[k];
            // The block is zero in the rows above.
            for v in (k / S::LANES * S::LANES..WIDTH).step_by(S::LANES) {
                let rest = s.mul_sub(s.splat(found), s.load(&column[v..]), s.load(&x[v..]));
                s.store(rest, &mut x[v..]);
            }
            x[k] = found;
        }
    }
}

/// A⁻¹ x in place, for one right-hand side filled up with zeros.
pub(super) struct Solve<'a> {
    pub factor: &'a Cholesky,
    pub x: &'a mut [f64],
}

impl Work for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        let Cholesky { factor, reciprocals } = self.factor;
        let count = factor.rows.div_ceil(WIDTH);
        for i in 0..count {
            let panel = &factor.panels[offset(i)..offset(i + 1)];
            let (known, here) = self.x.split_at_mut(i * WIDTH);
            let mut sums = [0.0; WIDTH];
            // Three vectors at once, so that each waits for its own sum alone.
            for v in (0..WIDTH).step_by(3 * S::LANES) {
                let mut sum = [s.splat(0.0); 3];
                for (column, x) in panel.as_chunks::<WIDTH>().0.iter().zip(&*known) {
                    let x = s.splat(*x);
                    for part in 0..3 {
                        sum[part] = s.mul_add(s.load(&column[v + part * S::LANES..]), x, sum[part]);
                    }
                }
                for part in 0..3 {
                    s.store(sum[part], &mut sums[v + part * S::LANES..]);
                }
            }
            let corner = &panel[i * WIDTH * WIDTH..];
            for r in 0..WIDTH {
                let mut x = here[r] - sums[r];
                for k in 0..r {
                    x -= corner[k * WIDTH + r] * here[k];
                }
                here[r] = x * reciprocals[i * WIDTH + r];
            }
        }
        for i in (0..count).rev() {
            let panel = &factor.panels[offset(i)..offset(i + 1)];
            let (before, here) = self.x.split_at_mut(i * WIDTH);
            let corner = &panel[i * WIDTH * WIDTH..];
            for r in (0..WIDTH).rev() {
                let mut x = here[r];
                for k in r + 1..WIDTH {
                    x -= corner[r * WIDTH + k] * here[k];
                }
                here[r] = x * reciprocals[i * WIDTH + r];
            }
            for (column, x) in panel.as_chunks::<WIDTH>().0.iter().zip(before) {
                let mut sums = s.splat(0.0);
                for v in (0..WIDTH).step_by(S::LANES) {
                    sums = s.mul_add(s.load(&column[v..]), s.load(&here[v..]), sums);
                }
                let mut lanes = [0.0; WIDTH];
                s.store(sums, &mut lanes);
                *x -= lanes[..S::LANES].iter().sum::<f64>();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Instructions, run_with};
    use super::*;
    use nalgebra::DMatrix;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_side_gets_the_same_bits_in_any_company(n in 1usize..120, seed in any::<u64>()) {
            let mut state = seed.wrapping_mul(2).wrapping_add(1);
            let mut uniform = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
            };
            let b = DMatrix::from_fn(n, n, |_, _| uniform());
            let factor = Cholesky::new(&b * b.transpose() + DMatrix::identity(n, n) * 0.1).unwrap();
            let mut asked = Sides::zeros(n, WIDTH);
            for (side, k) in (0..WIDTH).flat_map(|side| (0..n).map(move |k| (side, k))) {
                *asked.at(side, k) = uniform();
            }
            for most in [Instructions::Portable, Instructions::Avx2, Instructions::Avx512] {
                let mut all = asked.clone();
                let every =
                    Forward { factor: &factor, sides: &mut all, count: WIDTH, identity: false };
                run_with(most, every);
                for count in 1..WIDTH {
                    let mut few = asked.clone();
                    let sides = &mut few;
                    run_with(most, Forward { factor: &factor, sides, count, identity: false });
                    for (side, k) in (0..count).flat_map(|s| (0..n).map(move |k| (s, k))) {
                        prop_assert_eq!(few.at(side, k).to_bits(), all.at(side, k).to_bits());
                    }
                }
                for first in 0..WIDTH - 4 {
                    let mut few = asked.clone();
                    let panel = &mut few.panels;
                    run_with(most, ForwardFew::<1> { factor: &factor, panel, first });
                    let panel = &mut few.panels;
                    run_with(most, ForwardFew::<4> { factor: &factor, panel, first: first + 1 });
                    for (side, k) in (first..first + 5).flat_map(|s| (0..n).map(move |k| (s, k))) {
                        prop_assert_eq!(few.at(side, k).to_bits(), all.at(side, k).to_bits());
                    }
                }
            }
        }
    }
}
