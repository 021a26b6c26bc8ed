//! How a surface of experts is made.

use super::grid::Grid;
use super::partition::Partition;
use super::pyramid::Pyramid;
use super::site::widest;
use crate::reference::gpis::Error as SurfaceError;
use crate::reference::{Kernel, Prior};
use crate::space::Point;

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
    /// Bytes the experts' factors may take; what does not fit is factored anew when a
    /// variance is asked for.
    pub memory: usize,
}

impl Settings {
    /// The usual numbers: 80 sites an expert (48 in the plane), 1 GB.
    pub fn new(dimension: usize, kernel: Kernel, prior: Prior, noise: f64) -> Settings {
        let most = if dimension == 2 { 48 } else { 80 };
        let reach = Settings::reach(dimension, &kernel, noise);
        Settings { dimension, kernel, prior, noise, reach, most, memory: 1_000_000_000 }
    }

    /// How close contacts merge: where the field bends by a small share of their `noise` (metres),
    /// one in 128 in the plane and one in 32 in space.
    pub fn reach(dimension: usize, kernel: &Kernel, noise: f64) -> f64 {
        DISC * widest(kernel, length(kernel), (BENT[usize::from(dimension == 3)] * noise).powi(2))
    }

    /// # Errors
    /// When a number is not finite and positive, or for the thin plate.
    pub(super) fn check(&self) -> Result<(), Error> {
        let Settings { dimension, kernel, prior, noise, reach, most, .. } = *self;
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
        Ok(())
    }

    /// Empty lattices of contacts and of experts.
    pub(super) fn lattices(&self) -> (Pyramid, Partition) {
        let Settings { dimension, kernel, prior, noise, reach, most, .. } = *self;
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
        (Pyramid::new(grid, (reach, along)), Partition::new(grid, most, finest))
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
