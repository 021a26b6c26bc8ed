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
//! The same contacts in the same order give the same bits, whatever the number of threads, whatever
//! was asked in between and whatever else is asked with it.
//!
//! A variance needs the factors of its experts' matrices. They are kept while there is room
//! ([`Settings::memory`]; all about a hand-sized object at 1 mm of noise and 100 000 contacts take
//! 1.4 GB, those about its surface 0.9 GB), and one that is missing is made anew, which costs five
//! times a query. A query reads them once, and is as fast as memory; points asked together share
//! that, the more the closer they are.
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

mod ask;
pub mod expert;
pub mod grid;
pub mod partition;
pub mod pyramid;
pub mod settings;
pub mod site;
pub mod store;

#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use crate::dense::Cholesky;
use crate::reference::Contact;
use crate::reference::gpis::Error as SurfaceError;

use expert::Expert;
use partition::Partition;
use pyramid::{Pyramid, Source, Stamped};
use site::{Moments, Observation};
use store::Store;

pub use settings::{Error, Settings};

/// An expert that sees more than this many times the sites it takes near it has values only of what
/// is farther away, which keeps its matrix small, if more than [`ORIENTED`] times as many are near.
const CROWD: f64 = 1.4;

/// See [`CROWD`].
const ORIENTED: f64 = 0.25;

/// An expert that was asked.
#[derive(Clone, Debug)]
struct Fitted {
    expert: Arc<Expert>,
    /// Number of contacts when it was fitted.
    version: u64,
    /// Number of contacts when it was last found to be up to date.
    checked: u64,
}

/// An expert, once it was asked.
type Slot = Mutex<Option<Fitted>>;

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
    store: Store,
}

impl Experts {
    /// Without contacts: the prior.
    ///
    /// # Errors
    /// When a number is not finite and positive, or for the thin plate.
    pub fn new(settings: Settings) -> Result<Experts, Error> {
        settings.check()?;
        let (pyramid, partition) = settings.lattices();
        let (slots, store) = (Vec::new(), Store::new(settings.memory));
        Ok(Experts { settings, pyramid, partition, slots, contacts: 0, store })
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
        self.store.bytes()
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
            self.fitted(*leaf);
            let before = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            progress(before + 1, leaves.len());
        });
    }

    /// The expert of a leaf, up to date. No lock is held while it is fitted: threads that ask for
    /// the same one at once fit it twice, to the same bits.
    fn fitted(&self, leaf: u32) -> Fitted {
        let slot = || self.slots[leaf as usize].lock().unwrap_or_else(PoisonError::into_inner);
        let held = slot().clone();
        if let Some(fitted) = held.as_ref().filter(|f| f.checked == self.contacts) {
            return fitted.clone();
        }
        let cell = self.partition.nodes()[leaf as usize].cell;
        let sources = self.pyramid.sources(&cell, self.partition.near(&cell));
        let checked = self.contacts;
        let fitted = match held.filter(|f| f.expert.sources == sources) {
            Some(same) => Fitted { checked, ..same },
            None => {
                let Settings { kernel, dimension, .. } = self.settings;
                let seen = self.observations(&sources);
                let (expert, factor) = Expert::fit(kernel, dimension, sources, &seen);
                self.store.put(leaf, checked, Arc::new(factor));
                Fitted { checked, version: checked, expert: Arc::new(expert) }
            }
        };
        *slot() = Some(fitted.clone());
        fitted
    }

    /// The factor of an expert, made anew if there was no room for it.
    fn factor(&self, leaf: u32, fitted: &Fitted) -> Arc<Cholesky> {
        self.store.get(leaf, fitted.version).unwrap_or_else(|| {
            let factor = Arc::new(fitted.expert.factor());
            self.store.put(leaf, fitted.version, factor.clone());
            factor
        })
    }

    /// What an expert makes of its sources: whether their gradients count however vague, and what
    /// is seen. Where sites are dense, their values say from afar what their normals would; but
    /// somebody has to say which side is outside.
    fn observations(&self, sources: &[Stamped]) -> Vec<(bool, Observation)> {
        let Settings { kernel, dimension, most, .. } = self.settings;
        let is_near = |source: &Source| matches!(source, Source::Near(_));
        let near = sources.iter().filter(|s| is_near(&s.0)).count() as f64;
        let oriented = near > ORIENTED * most as f64;
        let crowded = sources.len() as f64 > CROWD * most as f64;
        let observe = |(source, _): &Stamped| {
            let near = is_near(source);
            let mut seen = self.pyramid.moments(*source).observation(&kernel, dimension);
            seen.slope = seen.slope.filter(|_| near || !(oriented && crowded));
            (near || !oriented, seen)
        };
        sources.iter().map(observe).collect()
    }
}
