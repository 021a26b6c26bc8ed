//! Covariances between parts of a field at many points.
//!
//! A field is observed through linear functionals: its value or its derivative along an axis at a
//! point. Those at one point form a *site* and share one evaluation of the kernel.

use super::lower::Lower;
use super::panel::WIDTH;
use super::radial::{Of, radials};
use super::sides::Sides;
use super::simd::{Simd, Work, run};
use super::sum::Weighted;
use crate::reference::Kernel;
use crate::space::Point;

/// a·f(p) + g·∇f(p): an observation of a field (a, or one of the gᵢ, is 1), or weights on the
/// observations at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Functional {
    /// p, metres.
    pub point: Point,
    /// a.
    pub value: f64,
    /// g.
    pub slopes: Point,
}

/// Absence of a row.
const NONE: usize = usize::MAX;

/// The observations at one point: the row of the value, then those of the slopes.
#[derive(Clone, Copy, Debug)]
struct Site {
    point: Point,
    rows: [usize; 4],
}

/// The rows of a covariance matrix.
#[derive(Clone, Debug, Default)]
pub struct Sites {
    sites: Vec<Site>,
    rows: Vec<Functional>,
}

impl Sites {
    /// One more row: the value of the field at `point`, or its derivative along `axis`.
    pub fn push(&mut self, point: Point, axis: Option<usize>) {
        let part = axis.map_or(0, |axis| 1 + axis);
        let row = self.rows.len();
        let mut slopes = Point::zeros();
        if let Some(axis) = axis {
            slopes[axis] = 1.0;
        }
        let value = if axis.is_none() { 1.0 } else { 0.0 };
        self.rows.push(Functional { point, value, slopes });
        match self.sites.last_mut() {
            Some(last) if last.point == point && last.rows[part] == NONE => last.rows[part] = row,
            _ => {
                let mut rows = [NONE; 4];
                rows[part] = row;
                self.sites.push(Site { point, rows });
            }
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The rows' weights, site by site: what Σ wᵢ·cov(rowᵢ, ·) is summed with.
    pub fn weighted(&self, weights: &[f64]) -> Weighted {
        let weight = |row: usize| weights.get(row).copied().unwrap_or(0.0);
        let of = |site: &Site| Functional {
            point: site.point,
            value: weight(site.rows[0]),
            slopes: Point::new(weight(site.rows[1]), weight(site.rows[2]), weight(site.rows[3])),
        };
        self.sites.iter().map(of).collect()
    }

    /// Covariance among the rows, noise-free.
    pub fn covariance(&self, kernel: &Kernel) -> Lower {
        self.lower(kernel, Of::Kernel)
    }

    /// Its derivative by the logarithm of the lengthscale; `None` for the thin plate.
    pub fn covariance_by_log_lengthscale(&self, kernel: &Kernel) -> Option<Lower> {
        match kernel {
            Kernel::ThinPlate { .. } => None,
            _ => Some(self.lower(kernel, Of::LogLengthscale)),
        }
    }

    /// Covariance of the rows with what `image` makes of them, noise-free, where that is symmetric: where the
    /// image of an image is the row itself.
    pub fn covariance_with(
        &self,
        kernel: &Kernel,
        image: impl Fn(&Functional) -> Functional,
    ) -> Lower {
        let images: Vec<Functional> = self.rows.iter().map(image).collect();
        self.lower_with(kernel, Of::Kernel, &images)
    }

    fn lower(&self, kernel: &Kernel, of: Of) -> Lower {
        self.lower_with(kernel, of, &self.rows)
    }

    fn lower_with(&self, kernel: &Kernel, of: Of, others: &[Functional]) -> Lower {
        let mut lower = Lower::zeros(self.rows());
        for (first, panel) in lower.panels_mut() {
            let end = (first + WIDTH).min(others.len());
            run(Cross { sites: self, kernel, of, others: &others[first..end], to: panel });
        }
        lower
    }

    /// Covariance of every row with each of `others`, one side for each, into `sides`.
    pub(super) fn cross(&self, kernel: &Kernel, others: &[Functional], sides: &mut Sides) {
        let stride = sides.stride().max(1);
        for (others, to) in others.chunks(WIDTH).zip(sides.panels.chunks_exact_mut(stride)) {
            run(Cross { sites: self, kernel, of: Of::Kernel, others, to });
        }
    }
}

/// One panel: covariance of up to WIDTH functionals with every row before its last column.
struct Cross<'a> {
    sites: &'a Sites,
    kernel: &'a Kernel,
    of: Of,
    others: &'a [Functional],
    to: &'a mut [f64],
}

/// Vectors of points evaluated side by side.
pub(super) const ABREAST: usize = 3;

impl Work for Cross<'_> {
    type Output = ();

    #[inline(always)]
    fn with<S: Simd>(mut self, s: S) {
        let mut lanes = [[0.0; WIDTH]; 7];
        for (r, o) in self.others.iter().enumerate() {
            let parts =
                [o.point.x, o.point.y, o.point.z, o.value, o.slopes.x, o.slopes.y, o.slopes.z];
            for (lane, part) in lanes.iter_mut().zip(parts) {
                lane[r] = part;
            }
        }
        let sloped = |f: &Functional| f.slopes != Point::zeros();
        let plain = !self.others.iter().any(sloped) && !self.sites.rows.iter().any(sloped);
        let mut row = 0;
        while row < self.others.len() {
            row += match (self.others.len() - row).div_ceil(S::LANES) {
                1 => self.abreast::<S, 1>(s, &lanes, row, plain),
                2 => self.abreast::<S, 2>(s, &lanes, row, plain),
                _ => self.abreast::<S, ABREAST>(s, &lanes, row, plain),
            };
        }
    }
}

impl Cross<'_> {
    /// The covariances of G vectors of others from `row`; `plain` where no slope is among them.
    /// Returns how many others those are.
    #[inline(always)]
    fn abreast<S: Simd, const G: usize>(
        &mut self,
        s: S,
        lanes: &[[f64; WIDTH]; 7],
        row: usize,
        plain: bool,
    ) -> usize {
        let columns = self.to.len() / WIDTH;
        let of = lanes.each_ref().map(|lane| {
            let mut vectors = [s.splat(0.0); G];
            for g in 0..G {
                vectors[g] = s.load(&lane[row + g * S::LANES..]);
            }
            vectors
        });
        if plain {
            for (k, site) in self.sites.sites.iter().enumerate().take(columns) {
                let e = apart::<S, G>(s, &of[0], &of[1], &of[2], &site.point);
                let k_e = radials(s, self.kernel, self.of, squares(s, &e));
                for g in 0..G {
                    s.store(k_e[g].value, &mut self.to[k * WIDTH + row + g * S::LANES..]);
                }
            }
            return G * S::LANES;
        }
        for site in &self.sites.sites {
            if site.rows.iter().all(|k| *k >= columns) {
                continue;
            }
            let e = apart::<S, G>(s, &of[0], &of[1], &of[2], &site.point);
            let k_e = radials(s, self.kernel, self.of, squares(s, &e));
            for g in 0..G {
                let (k, [x, y, z]) = (k_e[g], e[g]);
                let along = s.mul_add(of[6][g], z, s.mul_add(of[5][g], y, s.mul(of[4][g], x)));
                let at = row + g * S::LANES;
                if site.rows[0] < columns {
                    let value = s.mul_add(k.slope, along, s.mul(k.value, of[3][g]));
                    s.store(value, &mut self.to[site.rows[0] * WIDTH + at..]);
                }
                // −(a·slope + bend·(g·e))·eᵢ − slope·gᵢ.
                let common = s.mul_add(k.bend, along, s.mul(k.slope, of[3][g]));
                for axis in 0..3 {
                    let column = site.rows[1 + axis];
                    if column < columns {
                        let own = s.mul(k.slope, of[4 + axis][g]);
                        let sum = s.mul_add(common, [x, y, z][axis], own);
                        let value = s.sub(s.splat(0.0), sum);
                        s.store(value, &mut self.to[column * WIDTH + at..]);
                    }
                }
            }
        }
        G * S::LANES
    }
}

/// Points minus a point.
#[inline(always)]
pub(super) fn apart<S: Simd, const G: usize>(
    s: S,
    x: &[S::Vector; G],
    y: &[S::Vector; G],
    z: &[S::Vector; G],
    from: &Point,
) -> [[S::Vector; 3]; G] {
    let mut e = [[s.splat(0.0); 3]; G];
    for g in 0..G {
        e[g] = [
            s.sub(x[g], s.splat(from.x)),
            s.sub(y[g], s.splat(from.y)),
            s.sub(z[g], s.splat(from.z)),
        ];
    }
    e
}

#[inline(always)]
pub(super) fn squares<S: Simd, const G: usize>(s: S, e: &[[S::Vector; 3]; G]) -> [S::Vector; G] {
    let mut sums = [s.splat(0.0); G];
    for g in 0..G {
        let [x, y, z] = e[g];
        sums[g] = s.mul_add(z, z, s.mul_add(y, y, s.mul(x, x)));
    }
    sums
}
