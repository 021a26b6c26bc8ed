//! A Gaussian-process surface over any number of contacts: overlapping local experts, each exact
//! over what is near it and summaries of what is far, blended smoothly.
//!
//! # How it works
//!
//! 1. **Merging.** A contact joins a site if one is within a disc so small that the field bends
//!    within it by a small share of a contact's noise ([`Site`](site::Site)); a site keeps additive
//!    moments, and so costs the same for one contact or ten thousand. Where contacts are sparser
//!    than that, every contact is a site and nothing is lost.
//! 2. **Summaries.** Sites are summed up in cells of twice, four times, … the side
//!    ([`Pyramid`]), so that anyone far away sees few numbers (Barnes & Hut 1986).
//! 3. **Experts.** Space is tiled by the leaves of a tree of cells, split where more than
//!    [`Settings::most`] sites are near ([`Partition`]). A leaf's expert is an exact Gaussian
//!    process, of value and normals, over the sites near it and the summaries of all others. It is
//!    fitted when it is first asked and again when what it sees has changed.
//! 4. **Blending.** With weights wᵢ(p) that are a partition of unity (Ohtake et al. 2003), μ and V
//!    the experts' means and variances:
//!    f = Σ wᵢ μᵢ, V = Σ wᵢ (Vᵢ + (μᵢ − f)²), the moments of the mixture. V is never below the least
//!    of the Vᵢ, and more where experts disagree. Both are continuously differentiable: weights,
//!    means and variances of a Matérn-3/2 process are.
//!
//! Adding a contact touches the sites around it and the cells above it; asking a point, the experts
//! that have a say there, of bounded number and size: neither grows with the number of contacts.
//! The same contacts in the same order give the same bits, whatever the number of threads and
//! whatever was asked in between.
//!
//! # Why this and not another sparse method
//!
//! - *FITC, SVGP* (Snelson & Ghahramani 2006; Hensman et al. 2013) summarise everything by m
//!   inducing points for the whole object: a surface of area A needs m ~ A/ℓ² for its detail, the
//!   cost is m³ again, and where an object outgrows them they smooth it (SVGP) or understate its
//!   uncertainty (FITC). They need no lattice and bound the error of the whole at once.
//! - *Robust Bayesian committee machines* (Deisenroth & Ng 2015) split the data at random or by
//!   place and multiply the experts' densities everywhere: a query costs all experts, n/M of them.
//! - *Local regression* (Lee et al., "Online continuous mapping using Gaussian process implicit
//!   surfaces", 2019; Suresh et al., "Tactile SLAM", 2021) keeps hierarchies or grids of small
//!   processes of what is near, as here, but an expert knows nothing of what lies beyond, so
//!   that gaps fall back to the prior, and answers jump from one cell to the next.
//! - *Truncated distance volumes* are faster by far, but have no variance that a pose estimate
//!   could weigh contacts by, and nothing to say in a gap.
//!
//! What this one gives up: a site's contacts count as one at their mean, with a variance that
//! grows by what the field may do between them; far contacts are seen blurred; and the mixture's
//! variance is no posterior of one model. Against the dense process, on an ellipsoid of
//! 120 × 60 × 80 mm with 1 mm and 5° of noise, in the band where the surface is sought: with 300
//! contacts the means differ by 0.02 dense standard deviations (median; 0.23 at worst) and the
//! standard deviations are 1.00 to 1.05 times as large; with 700 contacts, of which a few merge,
//! by 0.06 (0.37), and 0.99 to 1.09 times.

pub mod expert;
pub mod grid;
pub mod partition;
pub mod pyramid;
pub mod site;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use crate::reference::gpis::Error as SurfaceError;
use crate::reference::{Contact, Gpis, Kernel, Prior};
use crate::shape::Field;
use crate::space::Point;

use expert::{Budget, Expert};
use grid::Grid;
use partition::{Partition, Share};
use pyramid::{Pyramid, Source};
use site::{Moments, widest};

/// Contacts of one site differ along the normal by their noise alone if they are within so many
/// standard deviations.
const THICK: f64 = 5.0;

/// The field may bend within a site by this share of a contact's standard deviation, in the plane
/// and in space. An outline has so few sites that they can be close; on a surface the number grows
/// as the share to the power −4/3.
const BENT: [f64; 2] = [1.0 / 128.0, 1.0 / 32.0];

/// A site is this much wider than the scatter of its contacts.
const DISC: f64 = 2.0;

/// Cells of the top level are at least this many lengthscales and radii of the prior wide: beyond,
/// contacts are independent.
const WIDE: (f64, f64) = (8.0, 4.0);

/// Most levels; a top cell is then a million million units wide.
const LEVELS: i32 = 40;

/// An expert that sees more than this many times the sites it takes near it has values only of what
/// is farther away, which keeps its matrix small, if more than [`ORIENTED`] times as many are near.
const CROWD: f64 = 1.4;

/// See [`CROWD`].
const ORIENTED: f64 = 0.25;

/// Points whose variance one task computes at one expert.
const BLOCK: usize = 64;

/// How a surface of experts is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// 2 or 3.
    pub dimension: usize,
    /// Covariance of the field; not the thin plate, which is none over unbounded space.
    pub kernel: Kernel,
    /// Mean of the field before contacts.
    pub prior: Prior,
    /// Standard deviation of a usual contact point, metres: decides how close contacts merge.
    pub noise: f64,
    /// Sites merge no farther than this, metres; [`Settings::reach`] by default. Zero: only what
    /// coincides.
    pub reach: f64,
    /// Sites an expert takes near it before it is split.
    pub most: usize,
    /// Bytes the experts' factors may take; what does not fit is factored anew for each batch of
    /// variances.
    pub memory: usize,
}

impl Settings {
    /// The usual numbers: 80 sites an expert (48 in the plane), 400 MB.
    pub fn new(dimension: usize, kernel: Kernel, prior: Prior, noise: f64) -> Settings {
        let most = if dimension == 2 { 48 } else { 80 };
        let reach = Settings::reach(dimension, &kernel, noise);
        Settings { dimension, kernel, prior, noise, reach, most, memory: 400_000_000 }
    }

    /// How close contacts merge: where the field bends by a small share of their `noise` (metres),
    /// one in 128 in the plane and one in 32 in space.
    pub fn reach(dimension: usize, kernel: &Kernel, noise: f64) -> f64 {
        DISC * widest(kernel, length(kernel), (BENT[usize::from(dimension == 3)] * noise).powi(2))
    }
}

/// The kernel's own length, metres.
fn length(kernel: &Kernel) -> f64 {
    match *kernel {
        Kernel::SquaredExponential { lengthscale, .. }
        | Kernel::Matern32 { lengthscale, .. }
        | Kernel::Matern52 { lengthscale, .. } => lengthscale,
        Kernel::ThinPlate { range, .. } => range,
    }
}

/// Why there is no surface, or a contact was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A number of a contact or a parameter is unusable.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The thin plate is a covariance only among points within its range.
    #[error("experts need a covariance over all of space: not the thin plate")]
    ThinPlate,
    /// So far away that cells cannot be numbered.
    #[error("contact {index}: farther from the others than experts can reach")]
    Far {
        /// Counted from 0.
        index: usize,
    },
}

/// An expert, once it was asked, and the number of contacts when it was last up to date.
type Slot = Mutex<Option<(u64, Arc<Expert>)>>;

/// The surface.
///
/// ```
/// use tactile_host::experts::{Experts, Settings};
/// use tactile_host::reference::{Contact, Kernel, Prior};
/// use tactile_host::space::Point;
///
/// let kernel = Kernel::Matern32 { amplitude: 0.02, lengthscale: 0.08 };
/// let prior = Prior::Ball { centre: Point::zeros(), radius: 0.05 };
/// let mut surface = Experts::new(Settings::new(2, kernel, prior, 1e-3))?;
/// for i in 0..500 {
///     let (y, x) = (f64::from(i) * 0.2).sin_cos();
///     surface.insert(&Contact {
///         point: Point::new(0.06 * x, 0.04 * y, 0.0),
///         normal: Some(Point::new(x / 0.06, y / 0.04, 0.0).normalize()),
///         point_deviation: 1e-3,
///         normal_deviation: 0.1,
///     })?;
/// }
/// let tip = Point::new(0.06, 0.0, 0.0);
/// assert!(surface.means(&[tip])[0].abs() < 1e-3);
/// assert!(surface.variances(&[tip])[0] < 1e-6);
/// # Ok::<(), tactile_host::experts::Error>(())
/// ```
#[derive(Debug)]
pub struct Experts {
    settings: Settings,
    pyramid: Pyramid,
    partition: Partition,
    /// One per cell of the partition.
    slots: Vec<Slot>,
    contacts: u64,
    budget: Budget,
}

impl Experts {
    /// Without contacts: the prior.
    ///
    /// # Errors
    /// When a number is not finite and positive, or for the thin plate.
    pub fn new(settings: Settings) -> Result<Experts, Error> {
        let Settings { dimension, kernel, prior, noise, reach, most, memory } = settings;
        if !(2..=3).contains(&dimension) {
            return Err(SurfaceError::Dimension(dimension).into());
        }
        if matches!(kernel, Kernel::ThinPlate { .. }) {
            return Err(Error::ThinPlate);
        }
        kernel.check()?;
        prior.check()?;
        for (name, value) in [("noise", noise), ("sites an expert takes", most as f64)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SurfaceError::Parameter { name, value }.into());
            }
        }
        if !(reach >= 0.0 && reach.is_finite()) {
            let name = "distance within which contacts merge";
            return Err(SurfaceError::Parameter { name, value: reach }.into());
        }
        let (centre, radius) = match prior {
            Prior::Ball { centre, radius } => (centre, radius),
            Prior::Ellipsoid(ellipsoid) => (ellipsoid.centre, ellipsoid.height),
            Prior::Constant(_) => (Point::zeros(), 0.0),
        };
        let along = if reach > 0.0 { reach.max(THICK * noise) } else { 0.0 };
        let unit = along.max(THICK * noise);
        let wide = (WIDE.0 * length(&kernel)).max(WIDE.1 * radius);
        let top = ((wide / unit).log2().ceil() as i32).clamp(1, LEVELS);
        let grid = Grid::new(dimension, &centre, unit, top);
        // A cell a quarter as wide as a site is packed with sites: splitting would not help.
        let smallest = (0.25 * reach).max(1e-3 * noise);
        let finest = ((smallest / unit).log2().floor() as i32).clamp(-LEVELS, 0);
        Ok(Experts {
            settings,
            pyramid: Pyramid::new(grid, (reach, along)),
            partition: Partition::new(grid, most, finest),
            slots: Vec::new(),
            contacts: 0,
            budget: Budget::new(memory),
        })
    }

    /// A surface of all `contacts`.
    ///
    /// # Errors
    /// As [`Experts::new`] and [`Experts::insert`].
    pub fn fit(settings: Settings, contacts: &[Contact]) -> Result<Experts, Error> {
        let mut experts = Experts::new(settings)?;
        for contact in contacts {
            experts.insert(contact)?;
        }
        Ok(experts)
    }

    /// Adds a contact. One that is refused changes nothing.
    ///
    /// # Errors
    /// When a number of it is unusable, or it is out of reach; contacts are counted from 0 in the
    /// order they are given.
    pub fn insert(&mut self, contact: &Contact) -> Result<(), Error> {
        let index = self.contacts as usize;
        contact
            .check(self.settings.dimension)
            .map_err(|what| SurfaceError::Contact { index, what })?;
        let moments = Moments::of(contact, &self.settings.prior);
        if !self.pyramid.reaches(&contact.point) {
            return Err(Error::Far { index });
        }
        if let Some(seat) = self.pyramid.add(&moments) {
            let pyramid = &self.pyramid;
            self.partition.add(&seat, |cell, half| pyramid.count(cell, half));
            self.slots.resize_with(self.partition.nodes().len(), Slot::default);
        }
        self.contacts += 1;
        Ok(())
    }

    /// How it was made.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of contacts.
    pub fn contacts(&self) -> u64 {
        self.contacts
    }

    /// Number of sites the contacts have been merged to.
    pub fn sites(&self) -> usize {
        self.pyramid.sites().len()
    }

    /// Number of experts.
    pub fn experts(&self) -> usize {
        self.partition.nodes().iter().filter(|n| n.children.is_none()).count()
    }

    /// Bytes of factors held at present.
    pub fn memory(&self) -> usize {
        self.budget.taken()
    }

    /// Fits all experts that have sites near them, on all threads, instead of when they are first
    /// asked. `progress` is told the number of experts done, and of all.
    pub fn settle(&self, progress: impl Fn(usize, usize) + Sync) {
        let nodes = self.partition.nodes().iter().enumerate();
        let leaves: Vec<u32> = nodes
            .filter(|(_, n)| n.children.is_none() && n.near > 0)
            .map(|(i, _)| i as u32)
            .collect();
        let done = std::sync::atomic::AtomicUsize::new(0);
        leaves.par_iter().for_each(|leaf| {
            self.expert(*leaf);
            let before = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            progress(before + 1, leaves.len());
        });
    }

    /// The expert of a leaf, up to date. No lock is held while it is fitted: threads that ask for
    /// the same one at once fit it twice, to the same bits.
    fn expert(&self, leaf: u32) -> Arc<Expert> {
        let slot = &self.slots[leaf as usize];
        let held = slot.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some((contacts, expert)) = &held
            && *contacts == self.contacts
        {
            return expert.clone();
        }
        let cell = self.partition.nodes()[leaf as usize].cell;
        let sources = self.pyramid.sources(&cell, self.partition.near(&cell));
        let expert = match held {
            Some((_, expert)) if expert.sources == sources => expert,
            _ => {
                let Settings { kernel, dimension, .. } = self.settings;
                // Where sites are dense, their values say from afar what their normals would; but
                // somebody has to say which side is outside.
                let is_near = |source: &Source| matches!(source, Source::Near(_));
                let near = sources.iter().filter(|s| is_near(&s.0)).count() as f64;
                let most = self.settings.most as f64;
                let oriented = near > ORIENTED * most;
                let crowded = sources.len() as f64 > CROWD * most;
                let seen: Vec<_> = sources
                    .iter()
                    .map(|(source, _)| {
                        let near = is_near(source);
                        let mut seen =
                            self.pyramid.moments(*source).observation(&kernel, dimension);
                        seen.slope = seen.slope.filter(|_| near || !(oriented && crowded));
                        (near || !oriented, seen)
                    })
                    .collect();
                Arc::new(Expert::fit(kernel, dimension, sources, &seen, &self.budget))
            }
        };
        let fresh = Some((self.contacts, expert.clone()));
        *slot.lock().unwrap_or_else(PoisonError::into_inner) = fresh;
        expert
    }

    /// Posterior mean of the field at each point, metres.
    pub fn means(&self, points: &[Point]) -> Vec<f64> {
        points.par_iter().map(|p| self.mean(&self.flat(p))).collect()
    }

    fn mean(&self, p: &Point) -> f64 {
        let residual = |s: &Share| s.leaf.map_or(0.0, |leaf| s.weight * self.expert(leaf).mean(p));
        self.settings.prior.value(p) + self.partition.shares(p).iter().map(residual).sum::<f64>()
    }

    /// Gradient of the mean at each point.
    pub fn gradients(&self, points: &[Point]) -> Vec<Point> {
        points.par_iter().map(|p| self.gradient(&self.flat(p))).collect()
    }

    fn gradient(&self, p: &Point) -> Point {
        let mut sum = self.settings.prior.gradient(p);
        for share in self.partition.shares(p) {
            let Some(leaf) = share.leaf else { continue };
            let (value, gradient) = self.expert(leaf).residual(p);
            sum += gradient * share.weight + share.slope * value;
        }
        self.flat(&sum)
    }

    /// Variance of the field at each point, m²: that of the mixture of the experts.
    pub fn variances(&self, points: &[Point]) -> Vec<f64> {
        let prior = self.settings.kernel.radial(0.0).value;
        let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
        let shares: Vec<Vec<Share>> = points.par_iter().map(|p| self.partition.shares(p)).collect();
        // Each expert answers for all its points at once.
        let mut asked: BTreeMap<u32, Vec<(usize, usize)>> = BTreeMap::new();
        for (point, shares) in shares.iter().enumerate() {
            for (place, share) in shares.iter().enumerate() {
                if let Some(leaf) = share.leaf {
                    asked.entry(leaf).or_default().push((point, place));
                }
            }
        }
        let asked: Vec<(u32, Vec<(usize, usize)>)> = asked.into_iter().collect();
        let answers: Vec<Vec<(f64, f64)>> = asked
            .par_iter()
            .map(|(leaf, at)| {
                let expert = self.expert(*leaf);
                let at: Vec<Point> = at.iter().map(|(point, _)| points[*point]).collect();
                let means = at.iter().map(|p| expert.mean(p));
                let variances = at.chunks(BLOCK).flat_map(|block| expert.variances(block));
                means.zip(variances).collect()
            })
            .collect();
        // The prior answers where there is no expert: residual zero.
        let mut said: Vec<Vec<(f64, f64)>> =
            shares.iter().map(|s| vec![(0.0, prior); s.len()]).collect();
        for ((_, at), answers) in asked.iter().zip(answers) {
            for ((point, place), answer) in at.iter().zip(answers) {
                said[*point][*place] = answer;
            }
        }
        shares
            .iter()
            .zip(said)
            .map(|(shares, said)| {
                let weighted = || shares.iter().map(|s| s.weight).zip(&said);
                let mean: f64 = weighted().map(|(w, (m, _))| w * m).sum();
                weighted().map(|(w, (m, v))| w * (v + (m - mean).powi(2))).sum()
            })
            .collect()
    }

    /// Planar fields ignore z.
    fn flat(&self, p: &Point) -> Point {
        if self.settings.dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p }
    }
}

impl Field for Experts {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.means(points)
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let slopes = self.gradients(points);
        let slopes = slopes.into_iter().map(|g| g.norm().max(Gpis::LEAST_GRADIENT));
        self.variances(points).into_iter().zip(slopes).map(|(v, slope)| v.sqrt() / slope).collect()
    }
}
