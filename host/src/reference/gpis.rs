//! Gaussian-process implicit surface over a dense covariance matrix: thesis 2.2.

use std::sync::Arc;

use nalgebra::{DMatrix, DMatrixView, DVector};
use rayon::prelude::*;

use super::mean::Local;
use super::spheres::Normalisation;
use super::{Contact, Kernel, Mean, Spheres};
use crate::dense::{Cholesky, Functional, Sites, expansion};
use crate::shape::Field;
use crate::space::Point;

/// What each contact teaches the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Training {
    /// Value 0 with variance σ_p² and, where there is a normal, the gradient equal to the normal
    /// with variance σ_θ² per axis.
    Derivative,
    /// Thesis 2.2.2: value 0 and, where there is a normal n, the values ±`distance` at
    /// p ± `distance`·n, all with variance σ_p².
    OffSurface {
        /// Metres.
        distance: f64,
    },
    /// Thesis 2.2.4: contacts between an enclosing sphere and one within, normalised: the kernel's
    /// lengths and amplitude are multiples of the contacts' [extent](Normalisation::extent).
    Spheres(Spheres),
}

/// The field's value at a point, known to a variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Where, metres.
    pub point: Point,
    /// f there, metres.
    pub value: f64,
    /// m².
    pub variance: f64,
}

impl Reading {
    /// What is wrong with it, if anything.
    fn check(&self) -> Result<(), &'static str> {
        if !self.point.iter().chain([&self.value]).all(|x| x.is_finite()) {
            return Err("a reading's point and value must be finite");
        }
        if !(self.variance > 0.0 && self.variance.is_finite()) {
            return Err("a reading's variance must be finite and positive");
        }
        Ok(())
    }
}

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

/// What of the field is observed or asked for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part {
    Value,
    /// Derivative along this axis.
    Slope(usize),
}

/// One row of the covariance matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    contact: usize,
    pub(super) point: Point,
    pub(super) part: Part,
    pub(super) target: f64,
    pub(super) variance: f64,
}

/// Everything the surface knows at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Posterior mean f, metres.
    pub value: f64,
    /// Gradient of the mean.
    pub gradient: Point,
    /// Posterior variance of f, m².
    pub variance: f64,
    /// Mean over the axes of the posterior variance of f's derivative along each.
    pub gradient_variance: f64,
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
    weighted: Vec<Functional>,
    /// The mean's modes at the rows of the covariance matrix, one a column.
    pub(super) modes: DMatrix<f64>,
    /// What the contacts make of each mode, in its standard deviations.
    shifts: DVector<f64>,
    /// Where the contacts are.
    touched: Vec<Point>,
    pub(super) cholesky: Cholesky,
    log_marginal_likelihood: f64,
}

/// Query points handled by one task: a whole number of the panels that are solved together.
const BLOCK: usize = 96;

impl Gpis {
    /// Largest number of rows: 144 MB of matrix. A contact takes 1 + dimension of them.
    pub const MOST_ROWS: usize = 6000;

    /// Least length of the gradient when a value is turned into a distance for
    /// [`Field::deviations`].
    pub const LEAST_GRADIENT: f64 = 0.1;

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
        let (mut observations, mut felt) = observe(dimension, &*prior, training, contacts)?;
        for (index, reading) in readings.iter().enumerate() {
            let contact = contacts.len() + index;
            reading.check().map_err(|what| Error::Contact { index: contact, what })?;
            observations.push(Observation {
                contact,
                point: reading.point,
                part: Part::Value,
                target: reading.value - prior.value(&reading.point),
                variance: reading.variance,
            });
            felt.extend(prior.modes(&reading.point).iter().map(|mode| mode.0));
        }
        let n = observations.len();
        if n > Self::MOST_ROWS {
            return Err(Error::TooLarge { rows: n });
        }
        if let Kernel::ThinPlate { range, .. } = kernel {
            let least = Kernel::LEAST_RANGE * diameter(&observations);
            if range < least {
                return Err(Error::Range { range, least });
            }
        }

        let sites = sites(&observations);
        let mut matrix = sites.covariance(&kernel);
        for (i, o) in observations.iter().enumerate() {
            *matrix.at(i, i) += o.variance;
        }
        let modes = DMatrix::from_row_iterator(n, felt.len().checked_div(n).unwrap_or(0), felt);
        if modes.ncols() > 0 {
            let rows = modes.transpose();
            for j in 0..n {
                for i in j..n {
                    *matrix.at(i, j) += rows.column(i).dot(&rows.column(j));
                }
            }
        }
        let cholesky = Cholesky::of(matrix).map_err(|row| Error::NotPositiveDefinite {
            row,
            contact: observations[row].contact,
        })?;

        let targets = DVector::from_iterator(n, observations.iter().map(|o| o.target));
        let weights = cholesky.solve(&targets);
        // Thesis 2.16 prints the negative of this without its constant, and σ_n for σ_n².
        let log_marginal_likelihood = -0.5
            * (targets.dot(&weights)
                + cholesky.log_determinant()
                + n as f64 * std::f64::consts::TAU.ln());

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

    /// Distance from `point` to the nearest contact, metres; infinite without any.
    pub fn nearest(&self, point: &Point) -> f64 {
        let p = self.flat(point);
        self.touched.iter().map(|t| (t - p).norm()).fold(f64::INFINITY, f64::min)
    }

    /// Thesis 2.16 as corrected: log p(targets), the constant −n/2·log 2π included.
    pub fn log_marginal_likelihood(&self) -> f64 {
        self.log_marginal_likelihood
    }

    /// Posterior mean (2.13 as corrected) at each point, metres.
    pub fn means(&self, points: &[Point]) -> Vec<f64> {
        let block = |points: &[Point]| -> Vec<f64> {
            let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
            let mut sums = expansion::values(&self.kernel, &self.weighted, &points);
            let own = |p: &Point| self.prior.value(p) + self.shift(p).0;
            sums.iter_mut().zip(&points).for_each(|(sum, p)| *sum += own(p));
            sums
        };
        points.par_chunks(BLOCK).flat_map_iter(block).collect()
    }

    /// Gradient of the posterior mean at each point.
    pub fn gradients(&self, points: &[Point]) -> Vec<Point> {
        self.means_and_gradients(points).into_iter().map(|(_, gradient)| gradient).collect()
    }

    /// Posterior mean, metres, and its gradient at each point: little dearer than the mean alone.
    pub fn means_and_gradients(&self, points: &[Point]) -> Vec<(f64, Point)> {
        let block = |points: &[Point]| -> Vec<(f64, Point)> {
            let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
            let (values, gradients) = expansion::gradients(&self.kernel, &self.weighted, &points);
            let sums = values.into_iter().zip(gradients).zip(&points);
            sums.map(|((value, gradient), p)| {
                let (shift, turn) = self.shift(p);
                let gradient = self.flat(&(gradient + self.prior.gradient(p) + turn));
                (value + self.prior.value(p) + shift, gradient)
            })
            .collect()
        };
        points.par_chunks(BLOCK).flat_map_iter(block).collect()
    }

    /// Posterior variance of the value (2.14) at each point, m². Rounding below zero gives zero.
    pub fn variances(&self, points: &[Point]) -> Vec<f64> {
        self.posterior_variances(points, Part::Value)
    }

    /// Posterior mean and covariance (2.14) of the values at all points together, m and m².
    pub fn joint(&self, points: &[Point]) -> (DVector<f64>, DMatrix<f64>) {
        let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
        let explained = self.explained(&points);
        let covariance = self.covariance(&points, explained.as_view());
        (DVector::from_vec(self.means(&points)), covariance)
    }

    /// Posterior covariance (2.14) of the values at the points of each group, m²: what
    /// [`joint`](Gpis::joint) says of every group alone, for the price of one.
    pub fn joint_each(&self, groups: &[Vec<Point>]) -> Vec<DMatrix<f64>> {
        let points: Vec<Point> = groups.iter().flatten().map(|p| self.flat(p)).collect();
        let explained = self.explained(&points);
        let mut start = 0;
        let one = |group: &Vec<Point>| {
            let range = start..start + group.len();
            start = range.end;
            self.covariance(&points[range.clone()], explained.columns_range(range))
        };
        groups.iter().map(one).collect()
    }

    /// L⁻¹ k(contacts, points), one point a column.
    fn explained(&self, points: &[Point]) -> DMatrix<f64> {
        let asked = |p: &Point| Functional { point: *p, value: 1.0, slopes: Point::zeros() };
        let of: Vec<Functional> = points.iter().map(asked).collect();
        let modes = self.modes_at(&of);
        self.cholesky.whitened(&self.sites, &self.kernel, &of, (&self.modes, &modes))
    }

    /// Prior covariance of the values at the points, less what is explained.
    fn covariance(&self, points: &[Point], explained: DMatrixView<'_, f64>) -> DMatrix<f64> {
        let mut own = DMatrix::from_fn(points.len(), points.len(), |i, j| {
            self.kernel.radial((points[i] - points[j]).norm()).value
        });
        if !self.shifts.is_empty() {
            let modes = self.values_of_modes(points);
            own.gemm_tr(1.0, &modes, &modes, 1.0);
        }
        own.gemm_tr(-1.0, &explained, &explained, 1.0);
        own
    }

    /// Values of the prior mean's modes, one point a column.
    fn values_of_modes(&self, points: &[Point]) -> DMatrix<f64> {
        let modes = points.iter().flat_map(|p| self.prior.modes(p)).map(|mode| mode.0);
        DMatrix::from_iterator(self.shifts.len(), points.len(), modes)
    }

    /// Mean over the axes of the posterior variance of the derivative along each, at each point.
    pub fn gradient_variances(&self, points: &[Point]) -> Vec<f64> {
        let mut sums = vec![0.0; points.len()];
        for axis in 0..self.dimension {
            let along = self.posterior_variances(points, Part::Slope(axis));
            sums.iter_mut().zip(along).for_each(|(sum, v)| *sum += v / self.dimension as f64);
        }
        sums
    }

    /// Everything at each point.
    pub fn evaluate(&self, points: &[Point]) -> Vec<Evaluation> {
        let means = self.means_and_gradients(points).into_iter();
        let variances = self.variances(points).into_iter().zip(self.gradient_variances(points));
        means
            .zip(variances)
            .map(|((value, gradient), (variance, gradient_variance))| Evaluation {
                value,
                gradient,
                variance,
                gradient_variance,
            })
            .collect()
    }

    /// How the contacts have changed the prior mean's own value and gradient at `p`.
    fn shift(&self, p: &Point) -> Local {
        if self.shifts.is_empty() {
            return (0.0, Point::zeros());
        }
        let modes = self.prior.modes(p).into_iter().zip(&self.shifts);
        modes
            .fold((0.0, Point::zeros()), |sum, (mode, z)| (sum.0 + mode.0 * z, sum.1 + mode.1 * *z))
    }

    /// The prior mean's modes as functionals see them, one functional a column.
    fn modes_at(&self, of: &[Functional]) -> DMatrix<f64> {
        if self.shifts.is_empty() {
            return DMatrix::zeros(0, of.len());
        }
        let seen = |f: &Functional| {
            let (value, slopes) = (f.value, f.slopes);
            let modes = self.prior.modes(&f.point).into_iter();
            modes.map(move |mode| value * mode.0 + slopes.dot(&mode.1))
        };
        let seen: Vec<f64> = of.iter().flat_map(seen).collect();
        DMatrix::from_vec(self.shifts.len(), of.len(), seen)
    }

    fn posterior_variances(&self, points: &[Point], part: Part) -> Vec<f64> {
        let prior = match part {
            Part::Value => self.kernel.radial(0.0).value,
            Part::Slope(_) => -self.kernel.radial(0.0).slope,
        };
        let block = |points: &[Point]| -> Vec<f64> {
            let of: Vec<Functional> = points
                .iter()
                .map(|p| {
                    let mut asked =
                        Functional { point: self.flat(p), value: 0.0, slopes: Point::zeros() };
                    match part {
                        Part::Value => asked.value = 1.0,
                        Part::Slope(axis) => asked.slopes[axis] = 1.0,
                    }
                    asked
                })
                .collect();
            let modes = self.modes_at(&of);
            let shared = (&self.modes, &modes);
            let explained = self.cholesky.explained(&self.sites, &self.kernel, &of, shared);
            let own = modes.column_iter().map(|m| prior + m.norm_squared());
            explained.into_iter().zip(own).map(|(e, own)| (own - e).max(0.0)).collect()
        };
        points.par_chunks(4 * BLOCK).flat_map_iter(block).collect()
    }

    /// Planar fields ignore z.
    fn flat(&self, p: &Point) -> Point {
        if self.dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p }
    }
}

impl Field for Gpis {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.means(points)
    }

    fn first_order(&self, points: &[Point], _step: f64) -> Vec<(f64, Point)> {
        self.means_and_gradients(points)
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let slopes = self.gradients(points).into_iter().map(|g| g.norm().max(Self::LEAST_GRADIENT));
        self.variances(points).into_iter().zip(slopes).map(|(v, slope)| v.sqrt() / slope).collect()
    }
}

/// The rows contacts give: per contact its value, then its derivatives or off-surface values. The
/// prior is subtracted from the targets. With the prior's modes at each row.
fn observe(
    dimension: usize,
    prior: &dyn Mean,
    training: Training,
    contacts: &[Contact],
) -> Result<(Vec<Observation>, Vec<f64>), Error> {
    if let Training::OffSurface { distance } = training
        && !(distance > 0.0 && distance.is_finite())
    {
        return Err(Error::Parameter { name: "off-surface distance", value: distance });
    }
    let spheres = match training {
        Training::Spheres(spheres) => {
            spheres.check()?;
            Normalisation::of(contacts).map(|normalisation| (spheres, normalisation))
        }
        _ => None,
    };
    let (mut rows, mut felt) = (Vec::new(), Vec::new());
    for (index, contact) in contacts.iter().enumerate() {
        contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
        let p = contact.point;
        let variance = contact.point_deviation.powi(2);
        let value = |point: Point, target: f64| Observation {
            contact: index,
            point,
            part: Part::Value,
            target: target - prior.value(&point),
            variance,
        };
        rows.push(value(p, 0.0));
        let modes = prior.felt_modes(contact);
        felt.extend(modes.iter().map(|mode| mode.0));
        let Some(n) = contact.normal.map(|n| n.normalize()) else { continue };
        match training {
            Training::Derivative => {
                let target = n - prior.felt(contact);
                rows.extend((0..dimension).map(|axis| Observation {
                    contact: index,
                    point: p,
                    part: Part::Slope(axis),
                    target: target[axis],
                    variance: contact.normal_deviation.powi(2),
                }));
                for axis in 0..dimension {
                    felt.extend(modes.iter().map(|mode| mode.1[axis]));
                }
            }
            Training::OffSurface { distance } => {
                for d in [distance, -distance] {
                    rows.push(value(p + n * d, d));
                    felt.extend(prior.modes(&(p + n * d)).iter().map(|mode| mode.0));
                }
            }
            Training::Spheres(_) => {
                let offset =
                    spheres.and_then(|(s, normalisation)| Some(s.offset? * normalisation.extent));
                for d in offset.into_iter().flat_map(|d| [d, -d]) {
                    rows.push(value(p + n * d, d));
                    felt.extend(prior.modes(&(p + n * d)).iter().map(|mode| mode.0));
                }
            }
        }
    }
    if let Some((spheres, normalisation)) = spheres {
        let variance = normalisation.deviation.powi(2);
        for (point, target) in spheres.points(dimension, &normalisation) {
            rows.push(Observation {
                contact: contacts.len(),
                point,
                part: Part::Value,
                target: target - prior.value(&point),
                variance,
            });
            felt.extend(prior.modes(&point).iter().map(|mode| mode.0));
        }
    }
    Ok((rows, felt))
}

/// Where the rows are and what of the field they are.
fn sites(observations: &[Observation]) -> Sites {
    let mut sites = Sites::default();
    for o in observations {
        let axis = match o.part {
            Part::Value => None,
            Part::Slope(axis) => Some(axis),
        };
        sites.push(o.point, axis);
    }
    sites
}

/// Largest distance between two training points, metres.
fn diameter(observations: &[Observation]) -> f64 {
    let mut largest: f64 = 0.0;
    for (i, a) in observations.iter().enumerate() {
        for b in &observations[..i] {
            largest = largest.max((a.point - b.point).norm_squared());
        }
    }
    largest.sqrt()
}

impl Contact {
    /// What is wrong with it, if anything.
    pub(crate) fn check(&self, dimension: usize) -> Result<(), &'static str> {
        let flat = |v: &Point| dimension == 3 || v.z == 0.0;
        if !(self.point.iter().all(|x| x.is_finite()) && flat(&self.point)) {
            return Err("the point must be finite, and z zero in the plane");
        }
        if let Some(n) = &self.normal
            && !((n.norm() - 1.0).abs() <= 1e-3 && flat(n))
        {
            return Err("the normal must have length 1 within 0.001, and z zero in the plane");
        }
        for deviation in [self.point_deviation, self.normal_deviation] {
            if !(deviation > 0.0 && deviation.is_finite()) {
                return Err("standard deviations must be finite and positive");
            }
        }
        Ok(())
    }
}
