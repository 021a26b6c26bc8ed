//! Rows of the covariance matrix: what a contact becomes, and how the factor grows by it.

use core::array::{from_fn, from_ref};

use super::revise::TOGETHER;
use super::{Gpis, Training};
use crate::contact::Contact;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::{NotPositiveDefinite, packed};
use crate::surface::kernel::{Kernel, Radial};
use crate::surface::prior::Prior;

/// Sites of one contact, at most.
const MOST_SITES: usize = 3;

/// One point of the covariance matrix: a value row and, where `slope`, one row per axis after it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Site<S: Space> {
    pub point: S::Vector,
    /// Observed value, metres.
    pub value: f32,
    /// The contact's normal, zero without one: unit length until it took in other contacts.
    pub normal: S::Vector,
    /// Whether there is a normal.
    pub felt: bool,
    /// Whether the normal is observed as a gradient.
    pub slope: bool,
    /// Sites after this one that belong to the same contact.
    pub followers: u8,
    /// Index of the value row.
    pub row: u16,
    /// 1/(k(0) + σ²) of the value and of each slope: what this site alone explains.
    pub value_precision: f32,
    pub slope_precision: f32,
    /// σ² of value and normal before others' knowledge came to them, square metres and radians².
    pub noise: f32,
    pub turn_noise: f32,
    /// Whether the point lies off the surface: no contact.
    pub aside: bool,
    /// Whether its noise is shared with others, see [`Revisable`](super::Revisable).
    pub shared: bool,
    /// What its pose shifts the observations by: value and slopes.
    pub value_offset: f32,
    pub slope_offset: S::Vector,
    /// Posterior weights: (K + Σ)⁻¹ (y − m) of its rows.
    pub value_weight: f32,
    pub slope_weight: S::Vector,
}

impl<S: Space> Site<S> {
    pub const UNSET: Self = Site {
        point: S::Vector::ZERO,
        value: 0.0,
        normal: S::Vector::ZERO,
        felt: false,
        slope: false,
        followers: 0,
        row: 0,
        value_precision: 0.0,
        slope_precision: 0.0,
        noise: 0.0,
        turn_noise: 0.0,
        aside: false,
        shared: false,
        value_offset: 0.0,
        slope_offset: S::Vector::ZERO,
        value_weight: 0.0,
        slope_weight: S::Vector::ZERO,
    };

    pub fn rows(&self) -> usize {
        if self.slope { 1 + S::DIMENSION } else { 1 }
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// y − m of one site into its rows.
    pub(super) fn residuals(prior: &P, site: &Site<S>, rows: &mut [f32]) {
        let (mean, slope) = prior.mean(site.point);
        let row = usize::from(site.row);
        rows[row] = site.value + site.value_offset - mean;
        if site.slope {
            for j in 0..S::DIMENSION {
                rows[row + 1 + j] = site.normal[j] + site.slope_offset[j] - slope[j];
            }
        }
    }

    /// Whether a contact of this many sites and rows still fits, with as many sites to spare.
    pub(super) fn fits(&self, sites: usize, rows: usize, spare: usize) -> bool {
        let spare_rows = spare * (1 + S::DIMENSION);
        self.count + sites + spare <= SITES && self.taken() + rows + spare_rows <= ROWS
    }

    /// Appends the rows of one site, with noise of its own; the site learns where they are.
    pub(super) fn append(
        &mut self,
        site: &mut Site<S>,
        value_noise: f32,
        slope_noise: f32,
    ) -> Result<(), NotPositiveDefinite> {
        if !self.fits(1, site.rows(), 0) {
            return Err(NotPositiveDefinite);
        }
        let value = self.kernel.variance() + value_noise;
        let slope = self.kernel.slope_variance() + slope_noise;
        site.row = self.factor.rows() as u16;
        site.value_precision = 1.0 / value;
        if !site.slope {
            self.stage_value(site, value);
            self.factor.append()?;
        } else {
            site.slope_precision = 1.0 / slope;
            if S::DIMENSION == 2 {
                self.factorise_independent(site, [value, slope, slope])?;
            } else {
                self.factorise_independent(site, [value, slope, slope, slope])?;
            }
        }
        let first = usize::from(site.row);
        for row in first..first + site.rows() {
            let noise = &mut self.noise[packed(row)..packed(row + 1)];
            // Of a zero that the compiler does not know: its routine clears a number in seven cycles.
            let zero = core::hint::black_box(0.0);
            let (noise4, rest) = noise.as_chunks_mut::<4>();
            noise4.fill([zero; 4]);
            rest.fill(zero);
            noise[row] = if row == first { value_noise } else { slope_noise };
        }
        self.hold(*site);
        Ok(())
    }

    /// Appends the C rows of a new site with its slopes to the factor; their place in Σ, still to be
    /// written, is the workspace.
    fn factorise_independent<const C: usize>(
        &mut self,
        site: &Site<S>,
        variances: [f32; C],
    ) -> Result<(), NotPositiveDefinite> {
        let first = self.factor.rows();
        let (columns, _) = self.noise[packed(first)..packed(first + C)].as_chunks_mut::<C>();
        let columns = &mut columns[..first];
        Self::covary_all(self.kernel, site, &self.sites[..self.count], columns);
        self.factor.append_independent(columns, variances)
    }

    /// Covariances of the rows of a new `site`, with its slopes, with those of all others, which
    /// `columns` are.
    pub(super) fn covary_all<const C: usize>(
        kernel: K,
        site: &Site<S>,
        others: &[Site<S>],
        columns: &mut [[f32; C]],
    ) {
        let (groups, rest) = others.as_chunks::<TOGETHER>();
        groups.iter().for_each(|others| Self::covary(&kernel, site, others, columns));
        rest.iter().for_each(|other| Self::covary(&kernel, site, from_ref(other), columns));
    }

    /// Its covariances with some of them.
    #[inline(always)]
    fn covary<const C: usize, const N: usize>(
        kernel: &K,
        site: &Site<S>,
        others: &[Site<S>; N],
        columns: &mut [[f32; C]],
    ) {
        let d: [S::Vector; N] = from_fn(|n| site.point - others[n].point);
        let radials = kernel.radials(d.map(|d| d.norm_squared()));
        for ((other, d), Radial { k, a, b }) in others.iter().zip(d).zip(radials) {
            let columns = &mut columns[usize::from(other.row)..][..other.rows()];
            let Some((values, slopes)) = columns.split_first_mut() else { continue };
            *values = from_fn(|i| match i {
                0 => k,
                _ if i > S::DIMENSION => 0.0,
                _ => a * d[i - 1],
            });
            for (j, slopes) in slopes.iter_mut().enumerate() {
                *slopes = from_fn(|i| match i {
                    0 => -a * d[j],
                    _ if i > S::DIMENSION => 0.0,
                    _ => -(b * d[i - 1] * d[j] + if i == j + 1 { a } else { 0.0 }),
                });
            }
        }
    }

    /// Appends the rows of one site whose noise is in place, and zero before column `since`.
    pub(super) fn factorise(
        &mut self,
        mut site: Site<S>,
        since: usize,
    ) -> Result<(), NotPositiveDefinite> {
        let first = self.factor.rows();
        self.stage(&mut site, since);
        if S::DIMENSION == 2 {
            self.factor.append_together(site.rows())?;
        } else {
            // One by one: a spatial board's stack has no room for four columns here.
            for _ in 0..site.rows() {
                if self.factor.append().is_err() {
                    self.factor.truncate(first);
                    return Err(NotPositiveDefinite);
                }
            }
        }
        self.hold(site);
        Ok(())
    }

    /// Adds a site whose rows are in the factor.
    pub(super) fn hold(&mut self, site: Site<S>) {
        self.sites[self.count] = site;
        self.count += 1;
    }

    /// Writes the covariances of a new site's rows, whose noise is in place and zero before column
    /// `since`, into the staged rows.
    pub(super) fn stage(&mut self, site: &mut Site<S>, since: usize) {
        let first = self.factor.rows();
        site.row = first as u16;
        if site.slope {
            let kernel = self.kernel;
            let mut rows = self.factor.stage_together();
            for other in &self.sites[..self.count] {
                Self::stage_cross(&kernel, site, other, &mut rows);
            }
        } else {
            self.stage_value(site, self.kernel.variance());
        }
        for i in 0..site.rows() {
            let row = self.factor.stage(i);
            // A value and a slope at one point, and two slopes of one point, are independent.
            row[first..].fill(0.0);
            row[first + i] =
                if i == 0 { self.kernel.variance() } else { self.kernel.slope_variance() };
            let noise = &self.noise[packed(first + i)..packed(first + i + 1)];
            for (k, noise) in row.iter_mut().zip(noise).skip(since) {
                *k += noise;
            }
        }
    }

    /// Writes the covariances of a new site of one row with all others, and its `variance`, into the
    /// staged row.
    fn stage_value(&mut self, site: &Site<S>, variance: f32) {
        // By value: what depends on it alone is then worked out once.
        let kernel = self.kernel;
        let row = self.factor.stage(0);
        let (pairs, last) = self.sites[..self.count].as_chunks::<2>();
        for pair in pairs {
            if pair.iter().all(|other| !other.slope) {
                // Their columns are side by side, and no number waits for the one before.
                let d2 = from_fn(|n| (site.point - pair[n].point).norm_squared());
                row[usize::from(pair[0].row)..][..2].copy_from_slice(&kernel.values::<2>(d2));
            } else {
                pair.iter().for_each(|other| Self::cross_value(&kernel, site, other, row));
            }
        }
        last.iter().for_each(|other| Self::cross_value(&kernel, site, other, row));
        if let Some(own) = row.last_mut() {
            *own = variance;
        }
    }

    /// Writes the covariances of the new `site`'s value with an old one's rows.
    fn cross_value(kernel: &K, site: &Site<S>, other: &Site<S>, row: &mut [f32]) {
        let d = site.point - other.point;
        let at = usize::from(other.row);
        row[at] = kernel.value(d.norm_squared());
        if other.slope {
            let a = kernel.radial(d.norm_squared()).a;
            for j in 0..S::DIMENSION {
                row[at + 1 + j] = -a * d[j];
            }
        }
    }

    /// Writes the covariances of the new `site`, with its slopes, and an old one into the staged rows.
    #[inline]
    fn stage_cross(
        kernel: &K,
        site: &Site<S>,
        other: &Site<S>,
        [value, slopes @ ..]: &mut [&mut [f32]; 4],
    ) {
        let d = site.point - other.point;
        let Radial { k, a, b } = kernel.radial(d.norm_squared());
        let at = usize::from(other.row);
        let row = &mut value[at..at + other.rows()];
        row[0] = k;
        if other.slope {
            let row = &mut row[1..][..S::DIMENSION];
            for j in 0..S::DIMENSION {
                row[j] = -a * d[j];
            }
        }
        for (i, row) in slopes.iter_mut().enumerate().take(S::DIMENSION) {
            let row = &mut row[at..at + other.rows()];
            row[0] = a * d[i];
            if other.slope {
                let row = &mut row[1..][..S::DIMENSION];
                for j in 0..S::DIMENSION {
                    let diagonal = if i == j { a } else { 0.0 };
                    row[j] = -(b * d[i] * d[j] + diagonal);
                }
            }
        }
    }

    /// The sites of a contact, how many, and the variances of their values and slopes.
    pub(super) fn sites_of(
        &self,
        contact: &Contact<S>,
    ) -> ([(Site<S>, f32, f32); MOST_SITES], usize) {
        let value_noise = contact.point_deviation * contact.point_deviation;
        let slope_noise = contact.normal_deviation * contact.normal_deviation;
        let felt = contact.normal.is_some();
        let normal = contact.normal.unwrap_or(S::Vector::ZERO);
        let surface = Site {
            point: contact.point,
            normal,
            felt,
            noise: value_noise,
            turn_noise: slope_noise,
            ..Site::UNSET
        };
        let mut sites = [(surface, value_noise, slope_noise); MOST_SITES];
        let count = match (contact.normal, self.training) {
            (None, _) => 1,
            (Some(_), Training::Normals) => {
                sites[0].0.slope = true;
                1
            }
            (Some(normal), Training::OffSurface(distance)) => {
                sites[0].0.followers = 2;
                for (site, value) in sites[1..].iter_mut().zip([distance, -distance]) {
                    site.0.point = contact.point + normal * value;
                    site.0.value = value;
                    site.0.aside = true;
                }
                3
            }
            // Only the contact: its other points wait for the spheres.
            (Some(_), Training::Spheres(_)) => 1,
        };
        (sites, count)
    }

    /// Appends all sites of a contact, or none.
    pub(super) fn append_contact(
        &mut self,
        contact: &Contact<S>,
    ) -> Result<(), NotPositiveDefinite> {
        let (count, rows) = (self.count, self.factor.rows());
        let (mut sites, number) = self.sites_of(contact);
        for (site, value_noise, slope_noise) in &mut sites[..number] {
            if self.append(site, *value_noise, *slope_noise).is_err() {
                self.count = count;
                self.factor.truncate(rows);
                return Err(NotPositiveDefinite);
            }
        }
        Ok(())
    }
}
