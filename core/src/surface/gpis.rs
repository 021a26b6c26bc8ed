//! The Gaussian-process implicit surface (thesis 2.2): f ~ GP(m, k) conditioned on contacts, with
//! an incremental packed Cholesky factor in place of the matrix inverse.
//!
//! A contact is learnt in one of two ways. [`Training::Normals`] gives the contact's value 0 and its
//! normal as an observation of ∇f, with their own noise: one value row and one row per axis.
//! [`Training::OffSurface`] is the thesis' form: value 0 at the contact and values ±d at the points
//! p ± d·n. A contact without a normal gives its value row alone. [`Training::Spheres`] is the
//! thesis' form for space (2.2.4).
//!
//! Contacts that are not valid ([`Contact::checked`]: a number that is not finite, a normal that is
//! none, no noise) are dropped, and so are contacts that repeat another with so little noise that
//! their row is not positive definite in `f32`. Everything else has a finite answer: coincident
//! points with opposite normals leave the slope between them undecided.

mod bound;
mod condense;
mod forget;
mod joint;
mod revise;
mod rows;
mod spheres;

use rows::Site;
pub use spheres::Spheres;

use core::array::from_fn;

use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::cholesky::{Cholesky, NotPositiveDefinite};
use crate::surface::kernel::{Kernel, Radial};
use crate::surface::prior::Prior;
use crate::surface::{Insertion, Map, Probe, Surface};

/// How a contact becomes rows of the covariance matrix. Its tag is a byte of its own, so that an
/// empty surface is all zero bits.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(u8)]
pub enum Training {
    /// Value and gradient (Solak et al. 2003): 1 + dimension rows per contact.
    Normals,
    /// Thesis 2.2.2: three value rows per contact, the outer two this many metres off the surface.
    OffSurface(
        /// d, metres. The thesis' values ±1 in units of d: the same surface as with its own units
        /// when amplitude and noise are d times the thesis' and the prior mean is zero.
        f32,
    ),
    /// Thesis 2.2.4: contacts between an enclosing sphere and one within, normalised. Sphere points
    /// take the last sites, and every refit factors anew: about n³/6 multiplications and n²/2
    /// kernel values over all n rows. From an insertion to the next refit they are missing.
    Spheres(Spheres),
}

/// A GPIS of at most `SITES` sites (contacts, or three times as many with
/// [`Training::OffSurface`]) and `ROWS` rows; `PACKED` is
/// [`packed`](super::cholesky::packed)`(ROWS)`.
///
/// ```
/// use tactile_core::contact::Contact;
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::Planar;
/// use tactile_core::surface::{cholesky::packed, Ball, Gpis, Map, Matern32, Prior, Surface, Training};
///
/// // Eight touches around a disc of radius 30 mm.
/// let mut disc = Gpis::<Planar, Matern32, Ball<Planar>, 8, 24, { packed(24) }>::new();
/// disc.configure(Matern32 { amplitude: 0.03, lengthscale: 0.1 }, Ball::UNSET, Training::Normals);
/// for k in 0..8 {
///     let (sin, cos) = (k as f32 * 0.785).sin_cos();
///     disc.insert(&Contact {
///         point: Vector([0.03 * cos, 0.03 * sin]),
///         normal: Some(Vector([cos, sin])),
///         point_deviation: 1e-3,
///         normal_deviation: 0.09,
///         finger: 0,
///     });
/// }
/// disc.refit();
/// let outside = disc.probe(Vector([0.035, 0.0]));
/// assert!((outside.value - 0.005).abs() < 1e-3);
/// ```
#[derive(Clone, Debug)]
pub struct Gpis<
    S: Space,
    K: Kernel,
    P: Prior<S>,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
> {
    /// In force; `given` is what was configured, from which normalisation makes it.
    kernel: K,
    given: K,
    prior: P,
    training: Training,
    sites: [Site<S>; SITES],
    /// Sites of contacts, and of sphere points after them.
    count: usize,
    enclosing: usize,
    factor: Cholesky<ROWS, PACKED>,
    /// Σ, covariance of the observations' noise, row by row like the factor: diagonal until the map
    /// is full.
    noise: [f32; PACKED],
    /// Whether Σ has entries off its diagonal.
    condensed: bool,
    /// Contacts condensed since a site's rows were last made anew.
    renewal: u8,
    /// (K + Σ)⁻¹ (y − m), row by row: the workspace of `refit`.
    weights: [f32; ROWS],
    /// L⁻¹ (y − m) squared, summed: what the log likelihood needs.
    misfit: f32,
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// Sites and rows are counted in 16 bits.
    const SIZES_FIT: () = assert!(SITES < u16::MAX as usize && ROWS < u16::MAX as usize);

    /// An empty surface, all zero bits; [`configure`](Self::configure) it before use.
    pub const fn new() -> Self {
        let () = Self::SIZES_FIT;
        Gpis {
            kernel: K::UNSET,
            given: K::UNSET,
            prior: P::UNSET,
            training: Training::Normals,
            sites: [Site::UNSET; SITES],
            count: 0,
            enclosing: 0,
            factor: Cholesky::new(),
            noise: [0.0; PACKED],
            condensed: false,
            renewal: 0,
            weights: [0.0; ROWS],
            misfit: 0.0,
        }
    }

    /// Sets the model and forgets every contact.
    pub fn configure(&mut self, kernel: K, prior: P, training: Training) {
        (self.kernel, self.given) = (kernel, kernel);
        self.prior = prior;
        self.training = training;
        self.clear();
    }

    /// The prior in force, fitted by the last [`refit`](Map::refit).
    pub fn prior(&self) -> P {
        self.prior
    }

    /// Replaces the prior; the next [`refit`](Map::refit) fits it and makes it count.
    pub fn assume(&mut self, prior: P) {
        self.prior = prior;
    }

    /// Number of rows in use.
    pub fn rows(&self) -> usize {
        self.factor.rows()
    }

    /// Value of the posterior mean at `L` points, metres. One pass over the contacts serves all
    /// points, and each point gets the same bits whatever `L` is.
    #[inline(always)]
    pub fn values<const L: usize>(&self, points: &[S::Vector; L]) -> [f32; L] {
        if self.enclosing > 0 {
            return points.map(|p| self.between_spheres(p));
        }
        let mut f = [0.0; L];
        for (f, p) in f.iter_mut().zip(points) {
            *f = self.prior.mean(*p).0;
        }
        if let [point] = points[..]
            && let [f] = &mut f[..]
        {
            self.add_parts(point, f);
            return [*f; L];
        }
        for site in self.sites() {
            for l in 0..L {
                let d = points[l] - site.point;
                let d2 = d.norm_squared();
                if site.slope {
                    let Radial { k, a, .. } = self.kernel.radial(d2);
                    f[l] += site.value_weight * k - a * site.slope_weight.dot(d);
                } else {
                    f[l] += site.value_weight * self.kernel.value(d2);
                }
            }
        }
        f
    }

    /// Adds the contacts' parts to the mean at one point, two by two: no number waits for the one before.
    #[inline(always)]
    fn add_parts(&self, point: S::Vector, f: &mut f32) {
        let kernel = self.kernel;
        let (pairs, last) = self.sites().as_chunks::<2>();
        for pair in pairs {
            for part in Self::parts(&kernel, pair, point) {
                *f += part;
            }
        }
        if let [site] = last {
            let [part] = Self::parts(&kernel, &[*site], point);
            *f += part;
        }
    }

    /// What sites add to the mean at a point.
    #[inline(always)]
    fn parts<const N: usize>(kernel: &K, sites: &[Site<S>; N], point: S::Vector) -> [f32; N] {
        let d: [S::Vector; N] = from_fn(|n| point - sites[n].point);
        let d2 = d.map(S::Vector::norm_squared);
        if K::IS_CHEAPER_ALONE && sites.iter().all(|site| !site.slope) {
            let k = kernel.values(d2);
            return from_fn(|n| sites[n].value_weight * k[n]);
        }
        let radials = kernel.radials(d2);
        // A site without slopes has no weights of them.
        let along: [f32; N] = from_fn(|n| sites[n].slope_weight.dot(d[n]));
        from_fn(|n| sites[n].value_weight * radials[n].k - radials[n].a * along[n])
    }

    /// Posterior variance of f at `point`, square metres, exactly (thesis 2.14): about n²/2
    /// multiplications and `ROWS` numbers of stack.
    pub fn variance(&self, point: S::Vector) -> f32 {
        (self.kernel.variance() - self.explained(point, 0)).max(0.0)
    }

    /// Posterior variance of one component of ∇f at `point`, averaged over the components, exactly.
    pub fn slope_variance(&self, point: S::Vector) -> f32 {
        let mut explained = 0.0;
        for axis in 0..S::DIMENSION {
            explained += self.explained(point, 1 + axis);
        }
        (self.kernel.slope_variance() - explained * (1.0 / S::DIMENSION as f32)).max(0.0)
    }

    /// k*ᵀ (K + Σ)⁻¹ k* for the covariances of f (part 0) or of its slope along an axis (1 + axis).
    fn explained(&self, point: S::Vector, part: usize) -> f32 {
        let mut row = [0.0; ROWS];
        self.whiten(point, part, &mut row);
        row[..self.factor.rows()].iter().map(|v| v * v).sum()
    }

    /// L⁻¹ k* of the same, in a row that is zero.
    fn whiten(&self, point: S::Vector, part: usize, row: &mut [f32; ROWS]) {
        for site in self.sites() {
            let at = usize::from(site.row);
            self.cross(point, part, site, &mut row[at..at + site.rows()]);
        }
        self.factor.forward(&mut row[..self.factor.rows()]);
    }

    /// Log marginal likelihood of the contacts after the last refit (thesis 2.16, corrected).
    pub fn log_likelihood(&self) -> f32 {
        const HALF_LN_TAU: f32 = 0.918_938_5;
        -0.5 * self.misfit
            - self.factor.half_log_determinant()
            - HALF_LN_TAU * self.factor.rows() as f32
    }

    /// Sites of contacts and sphere points.
    fn sites(&self) -> &[Site<S>] {
        &self.sites[..self.count + self.enclosing]
    }

    /// [`Map::insert`] with as many sites to spare after it.
    fn insert_sparing(&mut self, contact: &Contact<S>, spare: usize) -> Insertion {
        let Ok(contact) = contact.checked() else { return Insertion::Dropped };
        let contact = &contact;
        if let Training::Spheres(spheres) = self.training {
            return self.defer(contact, &spheres);
        }
        let (sites, count) = self.sites_of(contact);
        let rows = sites[..count].iter().map(|(site, ..)| site.rows()).sum();
        let mut released = 0;
        while !self.fits(count, rows, spare) {
            let Some(leader) = self.most_redundant(contact) else {
                if self.count == 0 {
                    return Insertion::Dropped;
                }
                self.condense(contact);
                return Insertion::Merged;
            };
            self.release(leader);
            released += 1;
        }
        match self.append_contact(contact) {
            Err(NotPositiveDefinite) => Insertion::Dropped,
            Ok(()) if released > 0 => Insertion::Replaced(released),
            Ok(()) => Insertion::Stored,
        }
    }

    /// Indices of the first site of every contact.
    fn leaders(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        let next =
            |&leader: &usize| Some(leader + 1 + usize::from(self.sites().get(leader)?.followers));
        core::iter::successors(Some(0), next).take_while(|&leader| leader < self.count)
    }

    /// The prior that fits the contacts held.
    fn refitted(&self) -> P {
        self.prior.fitted(self.leaders().map(|leader| {
            let site = &self.sites[leader];
            // One that took in other contacts has the mean of their normals.
            (site.point, site.felt.then(|| site.normal.normalized()).flatten())
        }))
    }

    /// Variance of f at squared distance `d2` from one site when nothing else is known: an upper
    /// bound of the posterior variance, since a value and its slopes are independent at one point.
    #[inline(always)]
    fn variance_given(&self, site: &Site<S>, d2: f32, radial: Radial) -> f32 {
        let Radial { k, a, .. } = radial;
        self.kernel.variance() - k * k * site.value_precision - a * a * d2 * site.slope_precision
    }

    /// The same for one component of ∇f, averaged over the components.
    #[inline(always)]
    fn slope_variance_given(&self, site: &Site<S>, d2: f32, radial: Radial) -> f32 {
        let Radial { a, b, .. } = radial;
        let dimension = S::DIMENSION as f32;
        let slope = b * d2 * (b * d2 + 2.0 * a) + dimension * a * a;
        self.kernel.slope_variance()
            - (a * a * d2 * site.value_precision + slope * site.slope_precision) * (1.0 / dimension)
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Default for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Surface<S> for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// Mean and its gradient exactly; the two variances as the least upper bound that any single
    /// contact gives, at one more multiplication or two per contact. [`Gpis::variance`] is exact.
    #[inline]
    fn probe(&self, point: S::Vector) -> Probe<S> {
        let (mut value, mut gradient) = self.prior.mean(point);
        let mut variance = self.kernel.variance();
        let mut slope_variance = self.kernel.slope_variance();
        let mut nearest = f32::INFINITY;
        for site in self.sites() {
            let d = point - site.point;
            let d2 = d.norm_squared();
            let radial = self.kernel.radial(d2);
            let Radial { k, a, b } = radial;
            let along = site.slope_weight.dot(d);
            value += site.value_weight * k - a * along;
            gradient += d * (site.value_weight * a - b * along) - site.slope_weight * a;
            variance = math::min(self.variance_given(site, d2, radial), variance);
            slope_variance = math::min(self.slope_variance_given(site, d2, radial), slope_variance);
            nearest = math::min(if site.aside { f32::INFINITY } else { d2 }, nearest);
        }
        if self.enclosing > 0 {
            value = self.between_spheres(point);
        }
        Probe {
            value,
            gradient,
            variance: math::max(variance, 0.0),
            slope_variance: math::max(slope_variance, 0.0),
            nearest: math::sqrt(nearest),
        }
    }
}

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Map<S> for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn insert(&mut self, contact: &Contact<S>) -> Insertion {
        self.insert_sparing(contact, 0)
    }

    fn refit(&mut self) {
        if let Training::Spheres(spheres) = self.training {
            self.enclose(&spheres);
        }
        self.prior = self.refitted();
        if self.condensed {
            self.rate_sites();
        }
        for site in &self.sites[..self.count + self.enclosing] {
            Self::residuals(&self.prior, site, &mut self.weights);
        }
        let weights = &mut self.weights[..self.factor.rows()];
        self.factor.forward(weights);
        self.misfit = weights.iter().map(|v| v * v).sum();
        self.factor.backward(weights);
        for site in &mut self.sites[..self.count + self.enclosing] {
            let row = usize::from(site.row);
            site.value_weight = weights[row];
            if site.slope {
                site.slope_weight = S::Vector::from_fn(|j| weights[row + 1 + j]);
            }
        }
        if self.enclosing > 0 {
            self.refine();
        }
    }

    /// The prior stays as the last refit fitted it, until the next.
    fn clear(&mut self) {
        self.kernel = self.given;
        (self.count, self.enclosing) = (0, 0);
        self.factor.truncate(0);
        (self.condensed, self.renewal) = (false, 0);
        self.misfit = 0.0;
    }

    fn contacts(&self) -> usize {
        self.leaders().count()
    }
}

#[cfg(test)]
mod tests;
