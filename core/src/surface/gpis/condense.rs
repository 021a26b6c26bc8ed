//! What a full map does with one contact more: it keeps the knowledge and lets a place go.
//!
//! The map is a sparse Gaussian process (Csató & Opper 2002, "Sparse on-line Gaussian processes";
//! the projection is that of Titsias' inducing variables): f and ∇f at the sites are u, everything
//! learnt about them is "y = u + noise of covariance Σ", and f anywhere else is what the kernel
//! interpolates from u. A contact that finds no room is an observation of that interpolation,
//! z = eᵀu + noise of variance σ², where e = K⁻¹k over the nearest sites. With w = Σ·e and
//! ρ = σ² + eᵀw it is learnt exactly, row by row, as a Kalman filter would:
//!
//! ```text
//! y ← y + w (z − eᵀy)/ρ,   Σ ← Σ − w wᵀ/ρ,   K + Σ ← K + Σ − w wᵀ/ρ
//! ```
//!
//! (y and z about the prior mean), the last line as a downdate of the Cholesky factor. A site that
//! makes room for another goes the same way: its row q of y becomes an observation of what its
//! neighbours interpolate there, whose noise is known to be correlated: w = Σ·e − Σ_q and
//! ρ = Σ_qq − 2 eᵀΣ_q + eᵀΣe. Without this, forty contacts out of a stream of hundreds keep the noise of
//! forty; averaging contacts into point and normal of the nearest site does not help enough,
//! because the mean slope of a stretch says more about the field than the slope at one point.
//!
//! It makes the map a little too sure of itself: what the sites interpolate is taken for the truth.
//!
//! Per contact of r rows into n: r·n²/2 multiplications for Σ and 2·r·n² for the factor.
//! Σ takes as much memory as the factor.

use super::{Gpis, Site};
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::{Cholesky, packed};
use crate::surface::kernel::{Kernel, Radial};
use crate::surface::prior::Prior;

/// Sites that take over what another place knew. Three are too few at corners, eight gain nothing.
const NEAR: usize = 4;

/// Rows of that many sites in space.
const NEAR_ROWS: usize = 4 * NEAR;

/// Rows known better than this part of their prior variance (for f about 0.03 mm) are not refined:
/// single precision has no room for more, and the map stays open to change.
const WELL_KNOWN: f32 = 1e-6;

/// One site in so many condensed contacts is factored anew from K + Σ, in turn, so that the rounding
/// of downdates does not accumulate however long the stream.
const RENEWAL: u8 = 8;

/// The sites nearest to a point, with the factor of their covariance: interpolation from them.
struct Near<S: Space> {
    sites: [usize; NEAR],
    count: usize,
    rows: [usize; NEAR_ROWS],
    factor: Cholesky<NEAR_ROWS, { packed(NEAR_ROWS) }>,
    point: S::Vector,
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// Covariance of noise between two rows.
    pub(super) fn noise(&self, i: usize, j: usize) -> f32 {
        let (row, column) = if i > j { (i, j) } else { (j, i) };
        self.noise.get(packed(row) + column).copied().unwrap_or(0.0)
    }

    /// Writes the covariances of f (part 0) or of its slope along an axis (1 + axis) at `point` with
    /// the rows of `other`.
    pub(super) fn cross(&self, point: S::Vector, part: usize, other: &Site<S>, to: &mut [f32]) {
        let d = point - other.point;
        let Radial { k, a, b } = self.kernel.radial(d.norm_squared());
        let Some((value, slopes)) = to.split_first_mut() else { return };
        *value = if part == 0 { k } else { a * d[part - 1] };
        for (j, slope) in slopes.iter_mut().enumerate() {
            *slope = if part == 0 {
                -a * d[j]
            } else {
                -(b * d[part - 1] * d[j] + if part == 1 + j { a } else { 0.0 })
            };
        }
    }

    /// The sites nearest to `point` other than those in `except`.
    fn near(&self, point: S::Vector, except: core::ops::Range<usize>) -> Near<S> {
        let mut near = Near {
            sites: [0; NEAR],
            count: 0,
            rows: [0; NEAR_ROWS],
            factor: Cholesky::new(),
            point,
        };
        let mut squares = [f32::INFINITY; NEAR];
        for (index, site) in self.sites().iter().enumerate() {
            let square = (site.point - point).norm_squared();
            if except.contains(&index) || !(square < squares[NEAR - 1]) {
                continue;
            }
            let mut slot = NEAR - 1;
            while slot > 0 && squares[slot - 1] > square {
                squares[slot] = squares[slot - 1];
                near.sites[slot] = near.sites[slot - 1];
                slot -= 1;
            }
            squares[slot] = square;
            near.sites[slot] = index;
            near.count = (near.count + 1).min(NEAR);
        }
        self.factor_near(&mut near);
        near
    }

    /// Factors the covariance of the sites found. A trace of noise keeps close sites apart.
    fn factor_near(&self, near: &mut Near<S>) {
        let Near { sites, count, rows, factor, .. } = near;
        let mut known = 0;
        for place in 0..*count {
            let site = self.sites[sites[place]];
            let first = factor.rows();
            for part in 0..site.rows() {
                let staged = factor.stage(part);
                let mut at = 0;
                for other in &sites[..known] {
                    let other = &self.sites[*other];
                    self.cross(site.point, part, other, &mut staged[at..at + other.rows()]);
                    at += other.rows();
                }
                staged[first..].fill(0.0);
                staged[first + part] = 1.000_01 * self.prior_variance(part);
            }
            let rank = (0..site.rows()).take_while(|_| factor.append().is_ok()).count();
            if rank < site.rows() {
                // As good as in the place of a nearer one: it adds nothing.
                factor.truncate(first);
                continue;
            }
            for part in 0..rank {
                rows[first + part] = usize::from(site.row) + part;
            }
            sites[known] = sites[place];
            known += 1;
        }
        *count = known;
    }

    /// Variance of f (part 0) or of a slope before anything is known.
    fn prior_variance(&self, part: usize) -> f32 {
        if part == 0 { self.kernel.variance() } else { self.kernel.slope_variance() }
    }

    /// Weights of the near rows in the interpolation of f (part 0) or a slope at the near point.
    fn interpolate(&self, near: &Near<S>, part: usize) -> [f32; NEAR_ROWS] {
        let mut weights = [0.0; NEAR_ROWS];
        let mut at = 0;
        for index in &near.sites[..near.count] {
            let site = &self.sites[*index];
            self.cross(near.point, part, site, &mut weights[at..at + site.rows()]);
            at += site.rows();
        }
        near.factor.forward(&mut weights);
        near.factor.backward(&mut weights);
        weights
    }

    /// What a site says in its `part`-th row, about the prior mean.
    fn residual(prior: &P, site: &Site<S>, part: usize) -> f32 {
        let (mean, slope) = prior.mean(site.point);
        if part == 0 { site.value - mean } else { site.normal[part - 1] - slope[part - 1] }
    }

    /// What the near sites say together, about the prior mean, with these weights.
    fn predicted(&self, prior: &P, near: &Near<S>, weights: &[f32; NEAR_ROWS]) -> f32 {
        let (mut sum, mut at) = (0.0, 0);
        for index in &near.sites[..near.count] {
            let site = &self.sites[*index];
            let (mean, slope) = prior.mean(site.point);
            sum += weights[at] * (site.value - mean);
            for j in 0..site.rows() - 1 {
                sum += weights[at + 1 + j] * (site.normal[j] - slope[j]);
            }
            at += site.rows();
        }
        sum
    }

    /// Σ·e for all rows, and eᵀΣe.
    fn spread(&self, near: &Near<S>, weights: &[f32; NEAR_ROWS]) -> ([f32; ROWS], f32) {
        let mut w = [0.0f32; ROWS];
        let n = self.factor.rows();
        for (&row, &weight) in near.rows[..near.factor.rows()].iter().zip(weights) {
            let across = &self.noise[packed(row)..packed(row) + row + 1];
            for (w, noise) in w.iter_mut().zip(across) {
                *w += noise * weight;
            }
            let mut at = packed(row + 1) + row;
            for (i, w) in w[..n].iter_mut().enumerate().skip(row + 1) {
                *w += self.noise[at] * weight;
                at += i + 1;
            }
        }
        let rows = near.rows[..near.factor.rows()].iter();
        let own = rows.zip(weights).map(|(&row, weight)| w[row] * weight).sum();
        (w, own)
    }

    /// y, Σ and the factor after an observation with w, ρ and innovation; `partly` is a site of
    /// which only the first so many rows are left.
    fn assimilate(
        &mut self,
        w: &mut [f32; ROWS],
        variance: f32,
        innovation: f32,
        partly: Option<(usize, usize)>,
    ) {
        let n = self.factor.rows();
        if !(variance > 0.0 && variance.is_finite() && innovation.is_finite()) {
            return;
        }
        let gain = innovation / variance;
        for (index, site) in self.sites[..self.count].iter_mut().enumerate() {
            let rows = match partly {
                Some((partial, rows)) if partial == index => rows,
                _ => site.rows(),
            };
            let w = &w[usize::from(site.row)..];
            for (part, w) in w[..rows].iter().enumerate() {
                if part == 0 {
                    site.value += w * gain;
                } else {
                    site.normal[part - 1] += w * gain;
                }
            }
        }
        let scale = 1.0 / math::sqrt(variance);
        for w in &mut w[..n] {
            *w *= scale;
        }
        let mut rest = &mut self.noise[..];
        for i in 0..n {
            let (row, later) = rest.split_at_mut(i + 1);
            subtract(row, w[i], &w[..=i]);
            // Rounding must not take more than there is.
            row[i] = math::max(row[i], 0.0);
            rest = later;
        }
        self.factor.downdate(&w[..n]);
        self.condensed = true;
    }

    /// Learns a contact that gets no site of its own, one row after the other.
    pub(super) fn condense(&mut self, contact: &Contact<S>) {
        let prior = self.refitted();
        let (sites, count) = self.sites_of(contact);
        for (site, noise, slope_noise) in &sites[..count] {
            let near = self.near(site.point, 0..0);
            for part in 0..site.rows() {
                let weights = self.interpolate(&near, part);
                let (mut w, own) = self.spread(&near, &weights);
                if own < WELL_KNOWN * self.prior_variance(part) {
                    continue;
                }
                let noise = if part == 0 { *noise } else { *slope_noise };
                let innovation =
                    Self::residual(&prior, site, part) - self.predicted(&prior, &near, &weights);
                self.assimilate(&mut w, noise + own, innovation, None);
            }
        }
        self.renewal += 1;
        if self.renewal >= RENEWAL {
            self.renewal = 0;
            self.renew();
        }
    }

    /// Lets the contact whose first site is `leader` go; its neighbours take over what it knew.
    pub(super) fn release(&mut self, leader: usize) {
        let prior = self.refitted();
        let followers = usize::from(self.sites[leader].followers);
        for index in (leader..=leader + followers).rev() {
            let site = self.sites[index];
            let mut near = self.near(site.point, leader..index + 1);
            for part in (0..site.rows()).rev() {
                let row = usize::from(site.row) + part;
                let weights = self.interpolate(&near, part);
                let (mut w, own) = self.spread(&near, &weights);
                let n = self.factor.rows();
                let mut shared = 0.0;
                for (&other, weight) in near.rows[..near.factor.rows()].iter().zip(&weights) {
                    shared += self.noise(other, row) * weight;
                }
                for (i, w) in w[..n].iter_mut().enumerate() {
                    *w -= self.noise(i, row);
                }
                let variance = self.noise(row, row) - 2.0 * shared + own;
                let innovation = Self::residual(&prior, &self.sites[index], part)
                    - self.predicted(&prior, &near, &weights);
                self.forget_row(row);
                w.copy_within(row + 1..n, row);
                near.rows.iter_mut().filter(|r| **r > row).for_each(|r| *r -= 1);
                for later in &mut self.sites[index + 1..self.count] {
                    later.row -= 1;
                }
                if near.count > 0 {
                    self.assimilate(&mut w, variance, innovation, Some((index, part)));
                }
            }
            self.sites.copy_within(index + 1..self.count, index);
            self.count -= 1;
        }
    }

    /// The first site of the contact that others explain best; `None` when that is `contact`.
    pub(super) fn most_redundant(&self, contact: &Contact<S>) -> Option<usize> {
        let fresh = Site {
            point: contact.point,
            normal: contact.normal.unwrap_or(S::Vector::ZERO),
            felt: contact.normal.is_some(),
            ..Site::UNSET
        };
        let doubt = contact.normal_deviation * contact.normal_deviation;
        let mut least = self.novelty(&fresh, doubt, None);
        let mut redundant = None;
        for leader in self.leaders() {
            let site = &self.sites[leader];
            let novelty = self.novelty(site, self.slope_noise(site), Some(leader));
            if novelty < least {
                (least, redundant) = (novelty, Some(leader));
            }
        }
        redundant
    }

    /// How much one contact would be missed, square metres: the variance of f there when value and
    /// slope at the one best other contact are known exactly, and what their normals differ by over
    /// the distance between them beyond `doubt` (variance of the normal, per axis): a corner or an
    /// edge between two contacts is worth both.
    fn novelty(&self, at: &Site<S>, doubt: f32, except: Option<usize>) -> f32 {
        let (prior, slope) = (self.kernel.variance(), self.kernel.slope_variance());
        let (value_precision, slope_precision) = (1.0 / prior, 1.0 / slope);
        let mut least = prior;
        // What is further away than this explains less than what was found.
        let mut limit = f32::INFINITY;
        for leader in self.leaders() {
            let other = &self.sites[leader];
            let d2 = (at.point - other.point).norm_squared();
            if d2 >= limit || Some(leader) == except {
                continue;
            }
            let Radial { k, a, .. } = self.kernel.radial(d2);
            let left = prior - k * k * value_precision - a * a * d2 * slope_precision;
            if left >= least {
                limit = d2;
                continue;
            }
            let mut turn = 0.0;
            if at.felt && other.felt {
                let noise = 2.0 * (doubt + self.slope_noise(other));
                turn = d2 * math::max((at.normal - other.normal).norm_squared() - noise, 0.0);
            }
            least = math::min(left + turn, least);
        }
        least
    }

    /// Variance of the noise of a site's slopes, averaged over the axes; zero without slopes.
    fn slope_noise(&self, site: &Site<S>) -> f32 {
        let row = usize::from(site.row);
        let noise: f32 = (row + 1..row + site.rows()).map(|r| self.noise(r, r)).sum();
        noise * (1.0 / S::DIMENSION as f32)
    }

    /// What each site alone explains, now that its observations have learnt from others. The noise of
    /// a site's rows is taken as independent and large enough to bound what it is (each row of
    /// correlations summed), so that the quick variances stay upper bounds.
    pub(super) fn rate_sites(&mut self) {
        for index in 0..self.count {
            let site = self.sites[index];
            if site.shared {
                continue;
            }
            let rows = usize::from(site.row)..usize::from(site.row) + site.rows();
            let (mut value, mut slope) = (0.0, 0.0f32);
            for i in rows.clone() {
                let mut noise = 0.0;
                for j in rows.clone() {
                    let (own, other) = (self.noise(i, i), self.noise(j, j));
                    let ratio = if other > 0.0 { math::sqrt(own / other) } else { 0.0 };
                    noise += self.noise(i, j).abs() * ratio;
                }
                if i == rows.start {
                    value = noise;
                } else {
                    slope = math::max(slope, noise);
                }
            }
            let site = &mut self.sites[index];
            site.value_precision = 1.0 / (self.kernel.variance() + value);
            if site.slope {
                site.slope_precision = 1.0 / (self.kernel.slope_variance() + slope);
            }
        }
    }

    /// Takes a row out of factor and noise.
    pub(super) fn forget_row(&mut self, row: usize) {
        self.forget_noise(row, self.factor.rows());
        self.factor.remove(row);
    }

    /// Takes a row and column out of the noise of `n` rows.
    fn forget_noise(&mut self, row: usize, n: usize) {
        for i in row + 1..n {
            let from = packed(i);
            self.noise.copy_within(from..from + row, packed(i - 1));
            self.noise.copy_within(from + row + 1..from + i + 1, packed(i - 1) + row);
        }
    }

    /// Moves the contact that has waited longest to the end, its rows of the factor made anew.
    pub(super) fn renew(&mut self) {
        let followers = self.sites().first().map_or(0, |site| usize::from(site.followers));
        let (mut kept, mut is_whole) = (0, true);
        for _ in 0..=followers {
            let (site, n) = (self.sites[0], self.factor.rows());
            for _ in 0..site.rows() {
                let mut noise = [0.0f32; ROWS];
                for (i, noise) in noise[..n].iter_mut().enumerate() {
                    *noise = self.noise(i, 0);
                }
                noise[..n].rotate_left(1);
                self.forget_noise(0, n);
                self.noise[packed(n - 1)..packed(n)].copy_from_slice(&noise[..n]);
                self.factor.remove(0);
            }
            self.sites.copy_within(1..self.count, 0);
            self.count -= 1;
            for later in &mut self.sites[..self.count] {
                later.row -= site.rows() as u16;
            }
            // K + Σ is positive definite and was a moment ago; else the contact is lost.
            is_whole = is_whole && self.factorise(site, 0).is_ok();
            kept += usize::from(is_whole);
        }
        if is_whole {
            return;
        }
        for _ in 0..kept {
            self.count -= 1;
            self.factor.truncate(usize::from(self.sites[self.count].row));
        }
    }
}

/// row ← row − scale·w, four numbers at a time.
#[inline]
fn subtract(row: &mut [f32], scale: f32, w: &[f32]) {
    let (row4, row) = row.as_chunks_mut::<4>();
    let (w4, w) = w.as_chunks::<4>();
    for (row, w) in row4.iter_mut().zip(w4) {
        for j in 0..4 {
            row[j] -= scale * w[j];
        }
    }
    for (row, w) in row.iter_mut().zip(w) {
        *row -= scale * w;
    }
}
