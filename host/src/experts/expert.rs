//! One expert: the exact Gaussian process of the residual f − prior over a bounded number of
//! summaries.

use nalgebra::{DMatrix, DVector};

use super::pyramid::Stamped;
use super::site::Observation;
use crate::dense::{Cholesky, Functional, Sites, Weighted};
use crate::reference::Kernel;
use crate::space::Point;

/// Least variance of a row in units of its prior variance: keeps the matrix well conditioned where
/// thousands of contacts coincide. If rounding still spoils it, the next of these is tried.
const FLOORS: [f64; 4] = [1e-9, 1e-7, 1e-5, 1e-3];

/// A summary's gradient is left out where its variance exceeds this share of the prior's.
const VAGUE: f64 = 0.06;

/// A fitted expert.
#[derive(Debug)]
pub struct Expert {
    kernel: Kernel,
    /// What it was made of.
    pub sources: Vec<Stamped>,
    sites: Sites,
    /// Variance of each row, beside the field's own.
    noise: Vec<f64>,
    /// K⁻¹ y, site by site.
    weighted: Weighted,
}

impl Expert {
    /// Fits the residual to observations: (whether its gradient counts however vague, what is
    /// seen). With the factor of its matrix, which [`factor`](Expert::factor) makes again.
    pub fn fit(
        kernel: Kernel,
        dimension: usize,
        sources: Vec<Stamped>,
        observations: &[(bool, Observation)],
    ) -> (Expert, Cholesky) {
        let origin = kernel.radial(0.0);
        let mut sites = Sites::default();
        let (mut noise, mut targets, mut own) = (Vec::new(), Vec::new(), Vec::new());
        for (near, seen) in observations {
            sites.push(seen.point, None);
            noise.push(seen.value.1);
            targets.push(seen.value.0);
            own.push(origin.value);
            if let Some((slope, variance)) = seen.slope
                && (*near || variance < -VAGUE * origin.slope)
            {
                for axis in 0..dimension {
                    sites.push(seen.point, Some(axis));
                    noise.push(variance);
                    targets.push(slope[axis]);
                    own.push(-origin.slope);
                }
            }
        }
        let targets = DVector::from_vec(targets);
        let mut expert = Expert { kernel, sources, sites, noise, weighted: Weighted::default() };
        for floor in FLOORS {
            expert.noise.iter_mut().zip(&own).for_each(|(v, own)| *v = v.max(floor * own));
            let Some(factor) = expert.try_factor() else { continue };
            let weights = factor.solve(&targets);
            if weights.iter().all(|w| w.is_finite()) {
                expert.weighted = expert.sites.weighted(weights.as_slice());
                return (expert, factor);
            }
        }
        // Not even with large noise: what is left is the prior.
        (expert.sites, expert.noise) = (Sites::default(), Vec::new());
        (expert, Cholesky::empty())
    }

    /// Rows of its matrix.
    pub fn rows(&self) -> usize {
        self.noise.len()
    }

    /// The factor of its matrix: the same bits every time.
    pub fn factor(&self) -> Cholesky {
        // Factored before with the same numbers, so it can be again.
        self.try_factor().unwrap_or_else(Cholesky::empty)
    }

    fn try_factor(&self) -> Option<Cholesky> {
        let mut matrix = self.sites.covariance(&self.kernel);
        for (i, variance) in self.noise.iter().enumerate() {
            *matrix.at(i, i) += variance;
        }
        Cholesky::of(matrix).ok()
    }

    /// Posterior mean of the residual at each point, metres.
    pub fn means(&self, points: &[Point]) -> Vec<f64> {
        self.weighted.values(&self.kernel, points)
    }

    /// Posterior mean of the residual, metres, and its gradient at each point.
    pub fn means_and_gradients(&self, points: &[Point]) -> Vec<(f64, Point)> {
        let (means, gradients) = self.weighted.gradients(&self.kernel, points);
        means.into_iter().zip(gradients).collect()
    }

    /// Posterior variance of the value at each point, m², by the expert's own factor.
    pub fn variances(&self, factor: &Cholesky, points: &[Point]) -> Vec<f64> {
        let prior = self.kernel.radial(0.0).value;
        let asked = |p: &Point| Functional { point: *p, value: 1.0, slopes: Point::zeros() };
        let asked: Vec<Functional> = points.iter().map(asked).collect();
        let none = DMatrix::zeros(0, 0);
        let explained = factor.explained(&self.sites, &self.kernel, &asked, (&none, &none));
        explained.into_iter().map(|e| (prior - e).max(0.0)).collect()
    }
}
