//! Contacts that can be taken back, with noise in common: see [`Revisable`].

use core::array::{from_fn, from_ref};

use super::{Gpis, Site};
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::{NotPositiveDefinite, packed};
use crate::surface::kernel::{Kernel, Radial};
use crate::surface::prior::Prior;
use crate::surface::revisable::{Bend, Revisable, Shared};
use crate::surface::{Map, Probe};

/// Square of the distance (metres) below which the bend of a kernel is taken for that at 2 mm: a
/// Matérn-3/2 field has kinks at its contacts.
const KINK: f32 = 4e-6;

/// Columns in which the three rows of a planar contact are appended: vectors of a host have four numbers.
const PLANAR_SIDES: usize = if cfg!(target_arch = "arm") { 3 } else { 4 };

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Revisable<S> for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn rows(&self) -> usize {
        self.factor.rows()
    }

    fn append(
        &mut self,
        contact: &Contact<S>,
        shared: &Shared<'_, S>,
        workspace: &mut [f32],
    ) -> usize {
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
        let since = shared.since.min(first);
        if self.factorise_in(site, since, workspace).is_err() { 0 } else { count }
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

    fn precision<const N: usize>(
        &self,
        first: usize,
        count: usize,
        workspace: &mut [f32],
    ) -> Option<[[f32; N]; N]> {
        let rows = self.factor.rows();
        if count == 0 || count > N || first + count > rows {
            return None;
        }
        // L⁻¹ of unit vectors.
        let columns = workspace.as_chunks_mut::<N>().0.get_mut(..rows - first)?;
        columns.fill([0.0; N]);
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
        self.visit(point, |near| near.add_to(&mut bend));
        bend
    }

    fn sense(&self, point: S::Vector) -> (Probe<S>, Bend<S>) {
        let mut bend = self.prior_bend(point);
        let mut value = self.prior.mean(point).0;
        let mut variance = self.kernel.variance();
        let mut slope_variance = self.kernel.slope_variance();
        let mut nearest = f32::INFINITY;
        self.visit(point, |near| {
            near.add_to(&mut bend);
            let Near { site, d, d2, radial, .. } = near;
            value += site.value_weight * radial.k - radial.a * site.slope_weight.dot(d);
            variance = math::min(self.variance_given(site, d2, radial), variance);
            slope_variance = math::min(self.slope_variance_given(site, d2, radial), slope_variance);
            nearest = math::min(if site.aside { f32::INFINITY } else { d2 }, nearest);
        });
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

/// Sites whose distances are worked on together: a host does at once what does not wait for each other. On a
/// board it would save one instruction in a hundred, and take flash.
pub(super) const TOGETHER: usize = if cfg!(target_arch = "arm") { 1 } else { 4 };

/// A site and the kernel at a point beside it.
struct Near<'a, S: Space> {
    site: &'a Site<S>,
    /// From the site to the point, and its square.
    d: S::Vector,
    d2: f32,
    /// The kernel there, and b′/r; this and b never nearer than the [`KINK`].
    radial: Radial,
    third: f32,
}

impl<S: Space> Near<'_, S> {
    /// The site's part in ∇f = Σ w a d − b (s·d) d − a s and in its slopes, where ∇a = b d and
    /// ∇b = (b′/r) d.
    #[inline(always)]
    fn add_to(&self, bend: &mut Bend<S>) {
        let (d, Radial { a, b, .. }) = (self.d, self.radial);
        let (value, slope) = (self.site.value_weight, self.site.slope_weight);
        let along = slope.dot(d);
        let round = value * a - b * along;
        let outer = value * b - self.third * along;
        bend.gradient += d * round - slope * a;
        for i in 0..S::DIMENSION {
            bend.curvature[i] += d * (outer * d[i] - b * slope[i]) - slope * (b * d[i]);
            bend.curvature[i][i] += round;
        }
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// Appends the rows of one site whose noise is in place, and zero before column `since`, in one pass over
    /// the factor; `workspace` holds four numbers for each row before.
    fn factorise_in(
        &mut self,
        mut site: Site<S>,
        since: usize,
        workspace: &mut [f32],
    ) -> Result<(), NotPositiveDefinite> {
        if !site.slope {
            return self.factorise(site, since);
        }
        site.row = self.factor.rows() as u16;
        if S::DIMENSION == 2 {
            self.factorise_sides::<PLANAR_SIDES>(&site, since, workspace)?;
        } else {
            self.factorise_sides::<4>(&site, since, workspace)?;
        }
        self.hold(site);
        Ok(())
    }

    /// Appends the rows of a site with its slopes to the factor, as columns of C numbers.
    fn factorise_sides<const C: usize>(
        &mut self,
        site: &Site<S>,
        since: usize,
        workspace: &mut [f32],
    ) -> Result<(), NotPositiveDefinite> {
        let (first, count) = (self.factor.rows(), site.rows());
        let columns = workspace.as_chunks_mut::<C>().0;
        let columns = columns.get_mut(..first).ok_or(NotPositiveDefinite)?;
        Self::covary_all(self.kernel, site, &self.sites[..self.count], columns);
        let mut own = [[0.0; C]; C];
        for (part, own) in own[..count].iter_mut().enumerate() {
            let noise = &self.noise[packed(first + part)..packed(first + part + 1)];
            for (column, noise) in columns.iter_mut().zip(noise).skip(since) {
                column[part] += noise;
            }
            own[..=part].copy_from_slice(&noise[first..]);
            own[part] +=
                if part == 0 { self.kernel.variance() } else { self.kernel.slope_variance() };
        }
        self.factor.append_block(count, columns, &own)
    }

    /// Calls `each` with every site, in their order.
    #[inline(always)]
    fn visit(&self, point: S::Vector, mut each: impl FnMut(Near<'_, S>)) {
        // By value: what depends on it alone is then worked out once.
        let kernel = self.kernel;
        let (groups, rest) = self.sites().as_chunks::<TOGETHER>();
        groups.iter().for_each(|sites| visit_group(&kernel, sites, point, &mut each));
        rest.iter().for_each(|site| visit_group(&kernel, from_ref(site), point, &mut each));
    }

    fn prior_bend(&self, point: S::Vector) -> Bend<S> {
        Bend { gradient: self.prior.mean(point).1, curvature: self.prior.curvature(point) }
    }
}

#[inline(always)]
fn visit_group<S: Space, K: Kernel, const N: usize>(
    kernel: &K,
    sites: &[Site<S>; N],
    point: S::Vector,
    each: &mut impl FnMut(Near<'_, S>),
) {
    let d: [S::Vector; N] = from_fn(|n| point - sites[n].point);
    let d2 = d.map(|d| d.norm_squared());
    let there = kernel.radials_and_thirds(d2.map(|d2| math::max(d2, KINK)));
    for (n, (mut radial, third)) in there.into_iter().enumerate() {
        if d2[n] < KINK {
            // The field itself and its slope are as they are.
            let Radial { k, a, .. } = kernel.radial(d2[n]);
            (radial.k, radial.a) = (k, a);
        }
        each(Near { site: &sites[n], d: d[n], d2: d2[n], radial, third });
    }
}
