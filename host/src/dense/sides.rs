//! Right-hand sides in panels.

use super::aligned::Aligned;
use super::panel::WIDTH;
use super::simd::{Simd, Work, run};

/// Right-hand sides of one system, or points with a row of covariances each, in panels.
#[derive(Clone, Debug)]
pub(super) struct Sides {
    /// Numbers of one side.
    pub length: usize,
    /// Panels one after the other; each has as many columns as the factor has rows, filled up.
    pub panels: Aligned,
}

impl Sides {
    pub(super) fn zeros(length: usize, count: usize) -> Self {
        let stride = length.next_multiple_of(WIDTH) * WIDTH;
        Sides { length, panels: Aligned::zeros(stride * count.div_ceil(WIDTH)) }
    }

    /// Numbers of one panel.
    pub(super) fn stride(&self) -> usize {
        self.length.next_multiple_of(WIDTH) * WIDTH
    }

    pub(super) fn at(&mut self, side: usize, k: usize) -> &mut f64 {
        let stride = self.stride();
        &mut self.panels[side / WIDTH * stride + k * WIDTH + side % WIDTH]
    }

    /// Sum of squares of each side, filled up to whole panels.
    pub(super) fn squares(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.panels.len() / self.stride().max(1) * WIDTH];
        run(Squares { sides: self, to: &mut sums });
        sums
    }
}

struct Squares<'a> {
    sides: &'a Sides,
    to: &'a mut [f64],
}

impl Work for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(self, s: S) {
        let panels = self.sides.panels.chunks_exact(self.sides.stride().max(1));
        for (panel, to) in panels.zip(self.to.chunks_exact_mut(WIDTH)) {
            for row in (0..WIDTH).step_by(3 * S::LANES) {
                let mut sums = [s.splat(0.0); 3];
                for column in panel.as_chunks::<WIDTH>().0 {
                    for v in 0..3 {
                        let x = s.load(&column[row + v * S::LANES..]);
                        sums[v] = s.mul_add(x, x, sums[v]);
                    }
                }
                for v in 0..3 {
                    s.store(sums[v], &mut to[row + v * S::LANES..]);
                }
            }
        }
    }
}
