//! What a surface says at points: means, gradients, variances, covariances.

use nalgebra::{DMatrix, DMatrixView, DVector};
use rayon::prelude::*;

use super::Gpis;
use super::observe::Part;
use crate::dense::Functional;
use crate::reference::mean::Local;
use crate::shape::Field;
use crate::space::Point;

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
/// Query points handled by one task: a whole number of the panels that are solved together.
const BLOCK: usize = 96;

impl Gpis {
    /// Least length of the gradient when a value is turned into a distance for
    /// [`Field::deviations`].
    pub const LEAST_GRADIENT: f64 = 0.1;

    /// Posterior mean (2.13 as corrected) at each point, metres.
    pub fn means(&self, points: &[Point]) -> Vec<f64> {
        let block = |points: &[Point]| -> Vec<f64> {
            let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
            let mut sums = self.weighted.values(&self.kernel, &points);
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
            let (values, gradients) = self.weighted.gradients(&self.kernel, &points);
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
