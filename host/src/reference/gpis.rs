//! Gaussian-process implicit surface over a dense covariance matrix: thesis 2.2.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::cholesky::Cholesky;
use super::kernel::Radial;
use super::{Contact, Kernel, Prior};
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
        /// The contact this row belongs to, from 0.
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

/// All rows at one point, as the mean needs them: one kernel evaluation serves them all.
#[derive(Clone, Copy, Debug)]
struct Site {
    point: Point,
    value: f64,
    slopes: Point,
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
    prior: Prior,
    pub(super) observations: Vec<Observation>,
    sites: Vec<Site>,
    /// Where the contacts are.
    touched: Vec<Point>,
    pub(super) cholesky: Cholesky,
    log_marginal_likelihood: f64,
}

/// Query points handled by one task.
const BLOCK: usize = 128;

impl Gpis {
    /// Largest number of rows: 288 MB of matrix. A contact takes 1 + dimension of them.
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
        prior: Prior,
        training: Training,
        contacts: &[Contact],
    ) -> Result<Self, Error> {
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        kernel.check()?;
        prior.check()?;
        let observations = observe(dimension, &prior, training, contacts)?;
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

        let mut matrix = DMatrix::zeros(n, n);
        for (j, b) in observations.iter().enumerate() {
            for (i, a) in observations.iter().enumerate().skip(j) {
                matrix[(i, j)] = covariance(&kernel, (a.point, a.part), (b.point, b.part));
            }
            matrix[(j, j)] += b.variance;
        }
        let cholesky = Cholesky::new(matrix).map_err(|row| Error::NotPositiveDefinite {
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

        let mut sites: Vec<Site> = Vec::new();
        for (o, &weight) in observations.iter().zip(&weights) {
            match o.part {
                Part::Value => {
                    sites.push(Site { point: o.point, value: weight, slopes: Point::zeros() });
                }
                // Slopes follow the value at the same point.
                Part::Slope(axis) => {
                    if let Some(site) = sites.last_mut() {
                        site.slopes[axis] = weight;
                    }
                }
            }
        }
        Ok(Gpis {
            dimension,
            kernel,
            prior,
            observations,
            sites,
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
        points.par_iter().with_min_len(BLOCK).map(|p| self.mean(p)).collect()
    }

    /// Gradient of the posterior mean at each point.
    pub fn gradients(&self, points: &[Point]) -> Vec<Point> {
        points.par_iter().with_min_len(BLOCK).map(|p| self.gradient(p)).collect()
    }

    /// Posterior variance of the value (2.14) at each point, m². Rounding below zero gives zero.
    pub fn variances(&self, points: &[Point]) -> Vec<f64> {
        self.posterior_variances(points, Part::Value)
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
        let means = self.means(points).into_iter().zip(self.gradients(points));
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

    fn mean(&self, p: &Point) -> f64 {
        let p = self.flat(p);
        let mut sum = self.prior.value(&p);
        for site in &self.sites {
            let e = p - site.point;
            let k = self.kernel.radial(e.norm());
            sum += k.value * site.value - k.slope * e.dot(&site.slopes);
        }
        sum
    }

    fn gradient(&self, p: &Point) -> Point {
        let p = self.flat(p);
        let mut sum = self.prior.gradient(&p);
        for site in &self.sites {
            let e = p - site.point;
            let k = self.kernel.radial(e.norm());
            let along = k.slope * site.value - k.bend * e.dot(&site.slopes);
            sum += e * along - site.slopes * k.slope;
        }
        self.flat(&sum)
    }

    fn posterior_variances(&self, points: &[Point], part: Part) -> Vec<f64> {
        let block = |points: &[Point]| -> Vec<f64> {
            let mut cross = DMatrix::from_fn(self.rows(), points.len(), |i, j| {
                let o = &self.observations[i];
                covariance(&self.kernel, (o.point, o.part), (self.flat(&points[j]), part))
            });
            self.cholesky.forward(&mut cross);
            let prior = covariance(&self.kernel, (Point::zeros(), part), (Point::zeros(), part));
            cross.column_iter().map(|c| (prior - c.norm_squared()).max(0.0)).collect()
        };
        points.par_chunks(BLOCK).flat_map_iter(block).collect()
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

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let slopes = self.gradients(points).into_iter().map(|g| g.norm().max(Self::LEAST_GRADIENT));
        self.variances(points).into_iter().zip(slopes).map(|(v, slope)| v.sqrt() / slope).collect()
    }
}

/// The rows contacts give: per contact its value, then its derivatives or off-surface values. The
/// prior is subtracted from the targets.
fn observe(
    dimension: usize,
    prior: &Prior,
    training: Training,
    contacts: &[Contact],
) -> Result<Vec<Observation>, Error> {
    if let Training::OffSurface { distance } = training
        && !(distance > 0.0 && distance.is_finite())
    {
        return Err(Error::Parameter { name: "off-surface distance", value: distance });
    }
    let mut rows = Vec::new();
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
        let Some(n) = contact.normal.map(|n| n.normalize()) else { continue };
        match training {
            Training::Derivative => {
                let target = n - prior.gradient(&p);
                rows.extend((0..dimension).map(|axis| Observation {
                    contact: index,
                    point: p,
                    part: Part::Slope(axis),
                    target: target[axis],
                    variance: contact.normal_deviation.powi(2),
                }));
            }
            Training::OffSurface { distance } => {
                rows.extend([distance, -distance].map(|d| value(p + n * d, d)));
            }
        }
    }
    Ok(rows)
}

/// Covariance of two parts of the field before data and without noise.
fn covariance(kernel: &Kernel, a: (Point, Part), b: (Point, Part)) -> f64 {
    let e = a.0 - b.0;
    between(&kernel.radial(e.norm()), &e, a.1, b.1)
}

/// Covariance of part `a` of the field at x with part `b` at y, given e = x − y and k(|e|).
pub(super) fn between(k: &Radial, e: &Point, a: Part, b: Part) -> f64 {
    match (a, b) {
        (Part::Value, Part::Value) => k.value,
        (Part::Slope(i), Part::Value) => k.slope * e[i],
        (Part::Value, Part::Slope(j)) => -k.slope * e[j],
        (Part::Slope(i), Part::Slope(j)) => {
            -(k.bend * e[i] * e[j] + if i == j { k.slope } else { 0.0 })
        }
    }
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
