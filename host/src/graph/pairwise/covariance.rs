//! The covariance of a relative pose from the likelihood of poses about it (thesis 3.23; Olson 2009).
//!
//! K = Σ w x xᵀ, u = Σ w x, s = Σ w over samples x in tangent coordinates about the optimum, and
//! Σ = K/s − u uᵀ/s². The samples are spread by what the curvature at the optimum says, a little
//! wider, and each weighs its likelihood over how densely it was drawn; they are a low-discrepancy
//! sequence and its mirror image, the same for every call.

use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};

/// Samples, in mirrored pairs.
const PAIRS: usize = 128;

/// How much wider than the curvature says.
const WIDER: f64 = 1.3;

const BASES: [usize; 6] = [2, 3, 5, 7, 11, 13];

/// Weighted covariance of samples about their weighted mean (thesis 3.23, the mean as corrected: of
/// tangent coordinates). `None` without weight.
pub fn weighted<const D: usize>(
    samples: impl Iterator<Item = (SVector<f64, D>, f64)>,
) -> Option<SMatrix<f64, D, D>> {
    let mut k = SMatrix::<f64, D, D>::zeros();
    let mut u = SVector::<f64, D>::zeros();
    let mut s = 0.0;
    for (x, weight) in samples {
        k += x * x.transpose() * weight;
        u += x * weight;
        s += weight;
    }
    let covariance = k / s - u * u.transpose() / (s * s);
    (s > 0.0 && covariance.iter().all(|v| v.is_finite())).then_some(covariance)
}

/// The covariance of a pose whose cost (twice the negative log likelihood) grows by `growth` over that
/// at the optimum and whose curvature there has the inverse `curvature`.
pub fn sampled<const D: usize>(
    curvature: &SMatrix<f64, D, D>,
    growth: impl Fn(&SVector<f64, D>) -> f64,
) -> Option<SMatrix<f64, D, D>> {
    let spread = curvature.cholesky()?.l() * WIDER;
    let samples = (1..=PAIRS).flat_map(|number| {
        let z = normal::<D>(number);
        [z, -z].map(|z| {
            let x = spread * z;
            let weight = (0.5 * (z.norm_squared() - growth(&x))).exp();
            (x, weight)
        })
    });
    weighted(samples)
}

/// A point of a low-discrepancy sequence of normal deviates.
fn normal<const D: usize>(number: usize) -> SVector<f64, D> {
    let uniform = |axis: usize| inverted(number, BASES[axis % BASES.len()]);
    SVector::from_fn(|i, _| {
        // Box and Muller: two uniform numbers make two normal ones.
        let first = i - i % 2;
        let radius = (-2.0 * uniform(first).ln()).sqrt();
        let angle = TAU * uniform(first + 1);
        radius * if i % 2 == 0 { angle.cos() } else { angle.sin() }
    })
}

/// The digits of `number` mirrored at the point, in (0, 1).
fn inverted(mut number: usize, base: usize) -> f64 {
    let (mut part, mut value) = (1.0, 0.0);
    while number > 0 {
        part /= base as f64;
        value += part * (number % base) as f64;
        number /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix3, Vector2};

    use super::*;

    #[test]
    fn equation_3_23_is_a_covariance_about_the_mean() {
        let samples = [([1.0, 2.0], 1.0), ([3.0, 2.0], 1.0), ([3.0, 6.0], 2.0)];
        let found = weighted(samples.iter().map(|(x, w)| (Vector2::from(*x), *w))).unwrap();
        // By hand: the mean is (2.5, 4).
        assert!((found - Matrix2::new(0.75, 1.0, 1.0, 4.0)).norm() < 1e-12, "{found}");
        assert!(weighted(std::iter::empty::<(Vector2<f64>, f64)>()).is_none());
        assert!(weighted([(Vector2::new(f64::NAN, 0.0), 1.0)].into_iter()).is_none());
    }

    #[test]
    fn a_gaussian_keeps_its_covariance() {
        let root = Matrix3::new(2e-3, 0.0, 0.0, 1e-3, 1e-3, 0.0, 0.02, -0.01, 0.03);
        let covariance = root * root.transpose();
        let information = covariance.try_inverse().unwrap();
        let found = sampled(&covariance, |x| x.dot(&(information * x))).unwrap();
        let whitened =
            root.try_inverse().unwrap() * found * root.try_inverse().unwrap().transpose();
        assert!((whitened - Matrix3::identity()).amax() < 0.1, "{whitened}");
        let six = SMatrix::<f64, 6, 6>::identity();
        let found = sampled(&six, SVector::norm_squared).unwrap();
        assert!((found - six).amax() < 0.25, "{found}");
    }

    #[test]
    fn a_wall_narrows_it() {
        // Where the cost rises more steeply than the curvature at the optimum says.
        let one = SMatrix::<f64, 1, 1>::identity();
        let found = sampled(&one, |x| x[0].powi(2) + 2.0 * x[0].powi(4)).unwrap();
        assert!(found[0] > 0.1 && found[0] < 0.45, "{found}");
        assert!(sampled(&one, |_| f64::NAN).is_none());
        assert!(sampled(&(-one), |_| 0.0).is_none());
    }
}
