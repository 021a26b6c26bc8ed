//! Gaussian-process implicit surface over a dense covariance matrix: thesis 2.2.

mod left_out;
mod observe;
mod posterior;
mod symmetric;

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::{Contact, Kernel, Mean, Normalisation};
use crate::dense::{Cholesky, Lower, Sites, Weighted};
use crate::space::Point;

pub use left_out::LeftOut;
pub(super) use observe::Observation;
#[cfg(test)]
pub(super) use observe::Part;
use observe::Rows;
pub use observe::{Reading, Training};
pub use posterior::Evaluation;

/// Why there is no surface.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Neither planar nor spatial.
    #[error("the dimension must be 2 or 3, not {0}")]
    Dimension(usize),
    /// A number of a contact is unusable.
    #[error("contact {index}: {what}")]
    Contact {
        /// Counted from 0.
        index: usize,
        /// What is wrong and what was expected.
        what: &'static str,
    },
    /// A parameter of kernel, prior or training is unusable.
    #[error("{name} must be finite and positive, not {value}")]
    Parameter {
        /// Its name.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// The thin plate is no covariance over data this wide.
    #[error("thin-plate range {range} m is too small: these contacts need at least {least} m")]
    Range {
        /// As given, metres.
        range: f64,
        /// [`Kernel::LEAST_RANGE`] times the diameter of the training points, metres.
        least: f64,
    },
    /// The dense matrix would not fit.
    #[error("{rows} observations are more than a dense surface takes ({})", Gpis::MOST_ROWS)]
    TooLarge {
        /// How many there would have been.
        rows: usize,
    },
    /// The covariance matrix is not positive definite.
    #[error(
        "the covariance matrix is not positive definite at row {row} (contact {contact}): contacts \
         coincide with too little noise, or the kernel does not suit them"
    )]
    NotPositiveDefinite {
        /// Row of the matrix, from 0.
        row: usize,
        /// The contact this row belongs to, from 0; their number for a point of
        /// [`Training::Spheres`].
        contact: usize,
    },
}
/// The surface given contacts in the object frame.
#[derive(Clone, Debug)]
pub struct Gpis {
    dimension: usize,
    pub(super) kernel: Kernel,
    prior: Arc<dyn Mean>,
    pub(super) observations: Vec<Observation>,
    pub(super) sites: Sites,
    /// K⁻¹ y, site by site.
    weighted: Weighted,
    /// The mean's modes at the rows of the covariance matrix, one a column.
    pub(super) modes: DMatrix<f64>,
    /// What the contacts make of each mode, in its standard deviations.
    shifts: DVector<f64>,
    /// Where the contacts are.
    touched: Vec<Point>,
    pub(super) cholesky: Cholesky,
    log_marginal_likelihood: f64,
}

impl Gpis {
    /// Largest number of rows: 144 MB of matrix. A contact takes 1 + dimension of them.
    pub const MOST_ROWS: usize = 6000;

    /// Fits the surface to `contacts`; without any, it is the prior.
    ///
    /// # Errors
    /// When a number is unusable, the thin plate's range is too small for the contacts, they are
    /// too many, or the covariance matrix cannot be factored.
    pub fn fit(
        dimension: usize,
        kernel: Kernel,
        prior: impl Into<Arc<dyn Mean>>,
        training: Training,
        contacts: &[Contact],
    ) -> Result<Self, Error> {
        Self::fit_with(dimension, kernel, prior, training, contacts, &[])
    }

    /// The same with `readings` of the field's value elsewhere.
    ///
    /// # Errors
    /// As [`fit`](Gpis::fit); readings count on after the contacts.
    pub fn fit_with(
        dimension: usize,
        kernel: Kernel,
        prior: impl Into<Arc<dyn Mean>>,
        training: Training,
        contacts: &[Contact],
        readings: &[Reading],
    ) -> Result<Self, Error> {
        let prior = prior.into();
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        kernel.check()?;
        prior.check()?;
        let kernel = match (training, Normalisation::of(contacts)) {
            (Training::Spheres(_), Some(normalisation)) => kernel.scaled(normalisation.extent),
            _ => kernel,
        };
        let rows = Rows::of(dimension, &*prior, training, contacts, readings)?;
        let n = rows.observations.len();
        if n > Self::MOST_ROWS {
            return Err(Error::TooLarge { rows: n });
        }
        if let Kernel::ThinPlate { range, .. } = kernel {
            let least = Kernel::LEAST_RANGE * rows.diameter();
            if range < least {
                return Err(Error::Range { range, least });
            }
        }

        let (sites, modes, observations) = (rows.sites(), rows.modes(), rows.observations);
        let covariance = observed(sites.covariance(&kernel), &modes, &observations);
        let Solved { cholesky, weights, log_marginal_likelihood } =
            solve(covariance, &observations)?;
        Ok(Gpis {
            dimension,
            kernel,
            prior,
            weighted: sites.weighted(weights.as_slice()),
            observations,
            sites,
            shifts: modes.tr_mul(&weights),
            modes,
            touched: contacts.iter().map(|c| c.point).collect(),
            cholesky,
            log_marginal_likelihood,
        })
    }

    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Rows of the covariance matrix.
    pub fn rows(&self) -> usize {
        self.observations.len()
    }

    /// What the contacts make of each of the mean's modes, in its standard deviations.
    pub fn shifts(&self) -> &[f64] {
        self.shifts.as_slice()
    }

    /// Distance from `point` to the nearest contact, metres; infinite without any.
    pub fn nearest(&self, point: &Point) -> f64 {
        let p = self.flat(point);
        self.touched.iter().map(|t| (t - p).norm()).fold(f64::INFINITY, f64::min)
    }

    /// Thesis 2.16 as corrected: log p(targets), the constant −n/2·log 2π included.
    pub fn log_marginal_likelihood(&self) -> f64 {
        self.log_marginal_likelihood
    }

    /// Planar fields ignore z.
    fn flat(&self, p: &Point) -> Point {
        if self.dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p }
    }
}

/// Covariance of the observations: the `field`'s, the prior mean's and their noise.
fn observed(field: Lower, modes: &DMatrix<f64>, observations: &[Observation]) -> Lower {
    let mut matrix = field;
    for (i, o) in observations.iter().enumerate() {
        *matrix.at(i, i) += o.variance;
    }
    if modes.ncols() > 0 {
        let rows = modes.transpose();
        for j in 0..rows.ncols() {
            for i in j..rows.ncols() {
                *matrix.at(i, j) += rows.column(i).dot(&rows.column(j));
            }
        }
    }
    matrix
}

/// What observations say.
struct Solved {
    cholesky: Cholesky,
    /// K⁻¹ y.
    weights: DVector<f64>,
    log_marginal_likelihood: f64,
}

/// Of observations with this covariance K.
///
/// # Errors
/// When it is not positive definite.
fn solve(covariance: Lower, observations: &[Observation]) -> Result<Solved, Error> {
    let cholesky = Cholesky::of(covariance)
        .map_err(|row| Error::NotPositiveDefinite { row, contact: observations[row].contact })?;
    let n = observations.len();
    let targets = DVector::from_iterator(n, observations.iter().map(|o| o.target));
    let weights = cholesky.solve(&targets);
    // Thesis 2.16 prints the negative of this without its constant, and σ_n for σ_n².
    let log_marginal_likelihood = -0.5
        * (targets.dot(&weights)
            + cholesky.log_determinant()
            + n as f64 * std::f64::consts::TAU.ln());
    Ok(Solved { cholesky, weights, log_marginal_likelihood })
}
