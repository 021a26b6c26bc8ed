//! Contacts that can be taken back, with noise in common: see [`Revisable`].

use super::{Gpis, Site};
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::packed;
use crate::surface::kernel::{Kernel, Radial};
use crate::surface::prior::Prior;
use crate::surface::revisable::{Bend, Revisable, Shared};
use crate::surface::{Map, Probe};

/// Square of the distance (metres) below which the bend of a kernel is taken for that at 2 mm: a
/// Matérn-3/2 field has kinks at its contacts.
const KINK: f32 = 4e-6;

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Revisable<S> for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn rows(&self) -> usize {
        self.factor.rows()
    }

    fn append(&mut self, contact: &Contact<S>, shared: &Shared<'_, S>) -> usize {
        let Ok(contact) = contact.checked() else { return 0 };
        let (sites, _) = self.sites_of(&contact);
        let (mut site, value_noise, slope_noise) = sites[0];
        site.followers = 0;
        let (first, count) = (self.factor.rows(), site.rows());
        if !self.fits(1, count, 0) || shared.lever.len() < count {
            return 0;
        }
        site.shared = true;
        site.value_offset = -shared.offset[0];
        site.slope_offset = S::Vector::from_fn(|j| -shared.offset[1 + j]);
        for part in 0..count {
            let row = first + part;
            let noise = &mut self.noise[packed(row)..packed(row + 1)];
            noise.fill(0.0);
            let common = noise.get_mut(shared.since..).unwrap_or(&mut []);
            for (noise, spread) in common.iter_mut().zip(shared.spread) {
                *noise = spread.dot(shared.lever[part]);
            }
            noise[row] += if part == 0 { value_noise } else { slope_noise };
        }
        site.value_precision = 1.0 / (self.kernel.variance() + value_noise);
        if site.slope {
            site.slope_precision = 1.0 / (self.kernel.slope_variance() + slope_noise);
        }
        self.stage(&mut site, shared.since.min(first));
        if self.factor.append_together(count).is_err() {
            return 0;
        }
        self.hold(site);
        count
    }

    fn withdraw(&mut self, rows: usize) {
        while self.count > 0 && usize::from(self.sites[self.count - 1].row) >= rows {
            self.count -= 1;
        }
        self.factor.truncate(rows);
    }

    fn roughen(&mut self, factor: f32) {
        self.clear();
        self.kernel = self.given.rougher(factor);
    }

    fn settle(&mut self, contact: &Contact<S>, room: usize) {
        let _ = self.insert_sparing(contact, room);
    }

    fn log_density_since(&self, row: usize) -> f32 {
        const HALF_LN_TAU: f32 = 0.918_938_5;
        let mut residuals = [0.0; ROWS];
        for site in self.sites() {
            Self::residuals(&self.prior, site, &mut residuals);
        }
        let residuals = &mut residuals[..self.factor.rows()];
        self.factor.forward(residuals);
        let own = residuals.get(row..).unwrap_or(&[]);
        let misfit: f32 = own.iter().map(|v| v * v).sum();
        -0.5 * misfit - self.factor.half_log_determinant_since(row) - HALF_LN_TAU * own.len() as f32
    }

    fn weights(&self) -> &[f32] {
        &self.weights[..self.factor.rows()]
    }

    fn whiten<const C: usize>(&self, first: usize, x: &mut [[f32; C]]) {
        self.factor.forward_together(first, x);
    }

    fn precision<const N: usize>(&self, first: usize, count: usize) -> Option<[[f32; N]; N]> {
        let rows = self.factor.rows();
        if count == 0 || count > N || first + count > rows {
            return None;
        }
        // L⁻¹ of unit vectors.
        let mut columns = [[0.0; N]; ROWS];
        let columns = &mut columns[..rows - first];
        for part in 0..count {
            columns[part][part] = 1.0;
        }
        self.factor.forward_together(first, columns);
        let mut block = [[0.0; N]; N];
        for column in &*columns {
            for i in 0..count {
                for j in 0..N {
                    block[i][j] += column[i] * column[j];
                }
            }
        }
        Some(block)
    }

    fn bend(&self, point: S::Vector) -> Bend<S> {
        let mut bend = self.prior_bend(point);
        for site in self.sites() {
            let d = point - site.point;
            self.add_bend(site, d, d.norm_squared(), &mut bend);
        }
        bend
    }

    fn sense(&self, point: S::Vector) -> (Probe<S>, Bend<S>) {
        let mut bend = self.prior_bend(point);
        let mut value = self.prior.mean(point).0;
        let mut variance = self.kernel.variance();
        let mut slope_variance = self.kernel.slope_variance();
        let mut nearest = f32::INFINITY;
        for site in self.sites() {
            let d = point - site.point;
            let d2 = d.norm_squared();
            let radial = self.add_bend(site, d, d2, &mut bend);
            value += site.value_weight * radial.k - radial.a * site.slope_weight.dot(d);
            variance = math::min(self.variance_given(site, d2, radial), variance);
            slope_variance = math::min(self.slope_variance_given(site, d2, radial), slope_variance);
            nearest = math::min(if site.aside { f32::INFINITY } else { d2 }, nearest);
        }
        let probe = Probe {
            value,
            gradient: bend.gradient,
            variance: math::max(variance, 0.0),
            slope_variance: math::max(slope_variance, 0.0),
            nearest: math::sqrt(nearest),
        };
        (probe, bend)
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn prior_bend(&self, point: S::Vector) -> Bend<S> {
        Bend { gradient: self.prior.mean(point).1, curvature: self.prior.curvature(point) }
    }

    /// One site's part in ∇f = Σ w a d − b (s·d) d − a s and in its slopes, where ∇a = b d and
    /// ∇b = (b′/r) d.
    #[inline(always)]
    fn add_bend(&self, site: &Site<S>, d: S::Vector, d2: f32, bend: &mut Bend<S>) -> Radial {
        let r2 = math::max(d2, KINK);
        let radial = self.kernel.radial(r2);
        let Radial { a, b, .. } = radial;
        let (value, slope) = (site.value_weight, site.slope_weight);
        let along = slope.dot(d);
        let round = value * a - b * along;
        let outer = value * b - self.kernel.third(r2) * along;
        bend.gradient += d * round - slope * a;
        for i in 0..S::DIMENSION {
            bend.curvature[i] += d * (outer * d[i] - b * slope[i]) - slope * (b * d[i]);
            bend.curvature[i][i] += round;
        }
        radial
    }
}
