//! Weighted sums of covariances: what a process says at points.

use super::expansion::{ABREAST, Functional, apart, squares};
use super::radial::{Of, radials};
use super::simd::{Simd, Work, run};
use crate::reference::Kernel;
use crate::space::Point;

/// Sites in a block: the widest vector.
const BLOCK: usize = 8;

/// Eight sites' points, weights of their values and weights of their slopes, number by number.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    point: [[f64; BLOCK]; 3],
    value: [f64; BLOCK],
    slopes: [[f64; BLOCK]; 3],
}

impl Block {
    fn set(&mut self, place: usize, w: &Functional) {
        self.value[place] = w.value;
        for axis in 0..3 {
            self.point[axis][place] = w.point[axis];
            self.slopes[axis][place] = w.slopes[axis];
        }
    }

    fn site(&self, place: usize) -> Functional {
        let at = |of: &[[f64; BLOCK]; 3]| Point::new(of[0][place], of[1][place], of[2][place]);
        Functional { point: at(&self.point), value: self.value[place], slopes: at(&self.slopes) }
    }
}

/// Weights wᵢ on observations of a field, site by site.
#[derive(Clone, Debug, Default)]
pub struct Weighted {
    blocks: Vec<Block>,
    count: usize,
    /// Whether any weight is on a slope.
    sloped: bool,
}

impl FromIterator<Functional> for Weighted {
    fn from_iter<I: IntoIterator<Item = Functional>>(sites: I) -> Self {
        let mut weighted = Weighted::default();
        for site in sites {
            if weighted.count.is_multiple_of(BLOCK) {
                weighted.blocks.push(Block::default());
            }
            if let Some(last) = weighted.blocks.last_mut() {
                last.set(weighted.count % BLOCK, &site);
            }
            weighted.count += 1;
            weighted.sloped |= site.slopes != Point::zeros();
        }
        weighted
    }
}

impl Weighted {
    /// Σ wᵢ cov(rowᵢ, f(p)) at each point: the same bits for a point in any company.
    pub fn values(&self, kernel: &Kernel, points: &[Point]) -> Vec<f64> {
        let mut values = vec![0.0; points.len()];
        let (to, slopes) = (&mut values[..], &mut [][..]);
        if self.sloped {
            run(Sum::<true, false> { kernel, weighted: self, points, values: to, slopes });
        } else {
            run(Sum::<false, false> { kernel, weighted: self, points, values: to, slopes });
        }
        values
    }

    /// [`values`](Self::values) and their gradients.
    pub fn gradients(&self, kernel: &Kernel, points: &[Point]) -> (Vec<f64>, Vec<Point>) {
        let mut values = vec![0.0; points.len()];
        let mut gradients = vec![Point::zeros(); points.len()];
        let (to, slopes) = (&mut values[..], &mut gradients[..]);
        if self.sloped {
            run(Sum::<true, true> { kernel, weighted: self, points, values: to, slopes });
        } else {
            run(Sum::<false, true> { kernel, weighted: self, points, values: to, slopes });
        }
        (values, gradients)
    }
}

/// `SLOPED`: whether any weight is on a slope. `GRADIENT`: whether gradients are asked for.
struct Sum<'a, const SLOPED: bool, const GRADIENT: bool> {
    kernel: &'a Kernel,
    weighted: &'a Weighted,
    points: &'a [Point],
    values: &'a mut [f64],
    slopes: &'a mut [Point],
}

/// Points of one pass: ABREAST vectors of the widest kind.
const PASS: usize = 8 * ABREAST;

impl<const SLOPED: bool, const GRADIENT: bool> Work for Sum<'_, SLOPED, GRADIENT> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(mut self, s: S) {
        let mut first = 0;
        while first < self.points.len() {
            first += match (self.points.len() - first).div_ceil(S::LANES) {
                1 if first + 1 == self.points.len() => self.few::<S, 1>(s, first),
                1 if first + 2 == self.points.len() => self.few::<S, 2>(s, first),
                1 => self.abreast::<S, 1>(s, first),
                2 => self.abreast::<S, 2>(s, first),
                _ => self.abreast::<S, ABREAST>(s, first),
            };
        }
    }
}

impl<const SLOPED: bool, const GRADIENT: bool> Sum<'_, SLOPED, GRADIENT> {
    /// Up to G vectors of points from `first`, side by side, site after site. Returns how many.
    #[inline(always)]
    fn abreast<S: Simd, const G: usize>(&mut self, s: S, first: usize) -> usize {
        let count = (self.points.len() - first).min(G * S::LANES);
        let mut lanes = [[0.0; PASS]; 3];
        for (r, p) in self.points[first..first + count].iter().enumerate() {
            (lanes[0][r], lanes[1][r], lanes[2][r]) = (p.x, p.y, p.z);
        }
        let at = lanes.each_ref().map(|lane| {
            let mut vectors = [s.splat(0.0); G];
            for g in 0..G {
                vectors[g] = s.load(&lane[g * S::LANES..]);
            }
            vectors
        });
        let mut value = [s.splat(0.0); G];
        let mut gradient = [[s.splat(0.0); 3]; G];
        for i in 0..self.weighted.count {
            let w = self.weighted.blocks[i / BLOCK].site(i % BLOCK);
            let e = apart::<S, G>(s, &at[0], &at[1], &at[2], &w.point);
            let k = radials(s, self.kernel, Of::Kernel, squares(s, &e));
            let weight = s.splat(w.value);
            let slopes = [s.splat(w.slopes.x), s.splat(w.slopes.y), s.splat(w.slopes.z)];
            for g in 0..G {
                value[g] = s.mul_add(k[g].value, weight, value[g]);
                let mut common = s.mul(k[g].slope, weight);
                if SLOPED {
                    let along = along(s, &e[g], &slopes);
                    value[g] = s.mul_sub(k[g].slope, along, value[g]);
                    common = s.mul_sub(k[g].bend, along, common);
                }
                if GRADIENT {
                    for axis in 0..3 {
                        let sum = s.mul_add(common, e[g][axis], gradient[g][axis]);
                        gradient[g][axis] =
                            if SLOPED { s.mul_sub(k[g].slope, slopes[axis], sum) } else { sum };
                    }
                }
            }
        }
        let mut lanes = [[0.0; PASS]; 4];
        for g in 0..G {
            s.store(value[g], &mut lanes[0][g * S::LANES..]);
            for axis in 0..3 {
                s.store(gradient[g][axis], &mut lanes[1 + axis][g * S::LANES..]);
            }
        }
        for r in 0..count {
            self.values[first + r] = lanes[0][r];
            if GRADIENT {
                self.slopes[first + r] = Point::new(lanes[1][r], lanes[2][r], lanes[3][r]);
            }
        }
        count
    }

    /// The C points from `first`: here sites are side by side in vectors. What they add is summed up
    /// in the order of [`abreast`](Self::abreast), so that every rounding is the same.
    #[inline(always)]
    fn few<S: Simd, const C: usize>(&mut self, s: S, first: usize) -> usize {
        let points = &self.points[first..first + C];
        let mut sums = [[0.0; 4]; C];
        let mut terms = [Terms::default(); C];
        for (i, block) in self.weighted.blocks.iter().enumerate() {
            for row in (0..BLOCK).step_by(S::LANES) {
                self.terms(s, points, block, row, &mut terms);
            }
            for r in 0..BLOCK.min(self.weighted.count - i * BLOCK) {
                for (terms, sums) in terms.iter().zip(&mut sums) {
                    terms.add::<S, SLOPED, GRADIENT>(s, block, r, sums);
                }
            }
        }
        for (c, [value, x, y, z]) in sums.into_iter().enumerate() {
            self.values[first + c] = value;
            if GRADIENT {
                self.slopes[first + c] = Point::new(x, y, z);
            }
        }
        C
    }

    /// What a vector of sites of a block, from `row`, adds at each point.
    #[inline(always)]
    fn terms<S: Simd, const C: usize>(
        &self,
        s: S,
        points: &[Point],
        block: &Block,
        row: usize,
        to: &mut [Terms; C],
    ) {
        let mut e = [[s.splat(0.0); 3]; C];
        for c in 0..C {
            for axis in 0..3 {
                e[c][axis] = s.sub(s.splat(points[c][axis]), s.load(&block.point[axis][row..]));
            }
        }
        let k = radials(s, self.kernel, Of::Kernel, squares(s, &e));
        let weight = s.load(&block.value[row..]);
        let slopes = block.slopes.each_ref().map(|of| s.load(&of[row..]));
        for (c, to) in to.iter_mut().enumerate() {
            s.store(k[c].value, &mut to.value[row..]);
            let mut common = s.mul(k[c].slope, weight);
            if SLOPED {
                let along = along(s, &e[c], &slopes);
                common = s.mul_sub(k[c].bend, along, common);
                s.store(s.sub(s.splat(0.0), k[c].slope), &mut to.fall[row..]);
                s.store(along, &mut to.along[row..]);
            }
            if GRADIENT {
                s.store(common, &mut to.common[row..]);
                for axis in 0..3 {
                    s.store(e[c][axis], &mut to.apart[axis][row..]);
                }
            }
        }
    }
}

/// What a block of sites adds to the sums at one point, but for the products with the weights.
#[derive(Clone, Copy, Default)]
struct Terms {
    value: [f64; BLOCK],
    /// −slope.
    fall: [f64; BLOCK],
    along: [f64; BLOCK],
    common: [f64; BLOCK],
    apart: [[f64; BLOCK]; 3],
}

impl Terms {
    /// Adds those of site `r`: to the value, then to the gradient.
    #[inline(always)]
    fn add<S: Simd, const SLOPED: bool, const GRADIENT: bool>(
        &self,
        s: S,
        block: &Block,
        r: usize,
        sums: &mut [f64; 4],
    ) {
        sums[0] = s.one_mul_add(self.value[r], block.value[r], sums[0]);
        if SLOPED {
            sums[0] = s.one_mul_add(self.fall[r], self.along[r], sums[0]);
        }
        if GRADIENT {
            for axis in 0..3 {
                let sum = s.one_mul_add(self.common[r], self.apart[axis][r], sums[1 + axis]);
                sums[1 + axis] = if SLOPED {
                    s.one_mul_add(self.fall[r], block.slopes[axis][r], sum)
                } else {
                    sum
                };
            }
        }
    }
}

/// e·g.
#[inline(always)]
fn along<S: Simd>(s: S, e: &[S::Vector; 3], slopes: &[S::Vector; 3]) -> S::Vector {
    let x = s.mul(e[0], slopes[0]);
    s.mul_add(e[2], slopes[2], s.mul_add(e[1], slopes[1], x))
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Instructions, run_with};
    use super::*;
    use proptest::prelude::*;

    fn asked<const SLOPED: bool, const GRADIENT: bool>(
        most: Instructions,
        kernel: &Kernel,
        weighted: &Weighted,
        points: &[Point],
    ) -> Vec<[u64; 4]> {
        let (mut values, mut slopes) =
            (vec![0.0; points.len()], vec![Point::zeros(); points.len()]);
        let (to, gradients) = (&mut values, &mut slopes);
        let sum =
            Sum::<SLOPED, GRADIENT> { kernel, weighted, points, values: to, slopes: gradients };
        run_with(most, sum);
        let bits = |(v, g): (f64, Point)| [v, g.x, g.y, g.z].map(f64::to_bits);
        values.into_iter().zip(slopes).map(bits).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn a_point_gets_the_same_bits_in_any_company(sites in 1usize..30, seed in any::<u64>()) {
            let mut state = seed.wrapping_mul(2).wrapping_add(1);
            let mut uniform = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
            };
            let mut point = || Point::new(uniform(), uniform(), uniform());
            let site = |k: usize, point: Point, slopes| Functional { point, value: k as f64, slopes };
            let weighted: Weighted = (0..sites).map(|k| site(k, point(), point())).collect();
            let mut points: Vec<Point> = (0..PASS + 1).map(|_| point()).collect();
            points[3] = weighted.blocks[0].site(0).point;
            let kernels = [
                Kernel::SquaredExponential { amplitude: 1.0, lengthscale: 0.3 },
                Kernel::Matern32 { amplitude: 1.0, lengthscale: 0.3 },
                Kernel::Matern52 { amplitude: 1.0, lengthscale: 0.3 },
                Kernel::ThinPlate { amplitude: 1.0, range: 3.0 },
            ];
            for kernel in &kernels {
                for most in [Instructions::Portable, Instructions::Avx2, Instructions::Avx512] {
                    for ask in [asked::<true, true>, asked::<true, false>, asked::<false, true>] {
                        let all = ask(most, kernel, &weighted, &points);
                        for number in 1..points.len() {
                            let some = ask(most, kernel, &weighted, &points[..number]);
                            prop_assert_eq!(&some[..], &all[..number], "{} of {:?}", number, kernel);
                        }
                    }
                }
            }
        }
    }
}
