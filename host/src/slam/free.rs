//! Points known to be outside the object, as inequality evidence for its surface.
//!
//! A fingertip that touched nothing at p says f(p) > 0: with a deviation s of its position, the
//! likelihood Φ(f(p)/s), which is not Gaussian. Expectation propagation (Minka 2001; Rasmussen and
//! Williams 2006, algorithm 3.5) replaces it by the reading of f(p) that leaves the same mean and
//! variance.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::reference::gpis::{Error, Reading};
use crate::reference::{Contact, Gpis, Kernel, Mean, Training};
use crate::slam::choose::farthest;
use crate::space::Point;

/// A point outside the object, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Free {
    /// Metres.
    pub point: Point,
    /// Standard deviation of its position, metres.
    pub deviation: f64,
}

/// Deviations outside the surface from which on a free point says nothing new: inside once in a
/// thousand.
const CERTAIN: f64 = 3.0;

/// Free points looked at closely: those of least expected value.
const DOUBTFUL: usize = 1000;

/// Free points that take part, how many of them are new in each round, and rounds.
const MOST: usize = 96;
const ROUNDS: usize = 3;

/// Free points closer to one another than this, in distances from the contacts' centre to the
/// farthest, say the same.
const APART: f64 = 0.03;

/// Sweeps of expectation propagation at most, and the greatest change at which it ends, in
/// deviations.
const SWEEPS: usize = 20;
const STILL: f64 = 1e-3;

/// The surface through `contacts` that leaves the `free` points outside. Those that lie outside
/// for certain change nothing; a few thousand of them cost little. Points that are not finite are
/// left out.
///
/// # Errors
/// As [`Gpis::fit`].
pub fn open(
    dimension: usize,
    kernel: Kernel,
    mean: impl Into<Arc<dyn Mean>>,
    contacts: &[Contact],
    free: &[Free],
) -> Result<Gpis, Error> {
    let mean = mean.into();
    let train = Training::Derivative;
    let closed = Gpis::fit(dimension, kernel, mean.clone(), train, contacts)?;
    let doubtful = doubtful(&closed, free);
    let apart = APART * farthest(contacts);
    let mut chosen: Vec<Free> = Vec::new();
    let mut gpis = closed.clone();
    for round in 1..=ROUNDS {
        let before = chosen.len();
        for free in inside(&gpis, &doubtful) {
            let new = chosen.iter().all(|c| (c.point - free.point).norm() >= apart);
            if new && chosen.len() < MOST * round / ROUNDS {
                chosen.push(free);
            }
        }
        if chosen.len() == before {
            break;
        }
        let readings = propagate(&closed, &chosen);
        // Where free points contradict contacts so sharply that no surface results, the contacts
        // stand.
        match Gpis::fit_with(dimension, kernel, mean.clone(), train, contacts, &readings) {
            Ok(opened) => gpis = opened,
            Err(Error::NotPositiveDefinite { .. }) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(gpis)
}

/// The finite free points of least expected value.
fn doubtful(gpis: &Gpis, free: &[Free]) -> Vec<Free> {
    let usable = |f: &&Free| f.point.iter().all(|x| x.is_finite()) && f.deviation.is_finite();
    let free: Vec<Free> = free.iter().filter(usable).copied().collect();
    let points: Vec<Point> = free.iter().map(|f| f.point).collect();
    let mut valued: Vec<(f64, Free)> = gpis.means(&points).into_iter().zip(free).collect();
    valued.sort_by(|a, b| a.0.total_cmp(&b.0));
    valued.into_iter().take(DOUBTFUL).map(|(_, free)| free).collect()
}

/// Those that may lie inside, the likeliest first.
fn inside(gpis: &Gpis, free: &[Free]) -> Vec<Free> {
    let points: Vec<Point> = free.iter().map(|f| f.point).collect();
    let (means, variances) = (gpis.means(&points), gpis.variances(&points));
    let mut judged: Vec<(f64, Free)> = free
        .iter()
        .zip(means.iter().zip(&variances))
        .map(|(f, (mean, variance))| (mean / (variance + f.deviation.powi(2)).sqrt(), *f))
        .filter(|(deviations, _)| *deviations < CERTAIN)
        .collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    judged.into_iter().map(|(_, free)| free).collect()
}

/// The readings that stand for f > 0 at the points, given everything else `gpis` knows.
fn propagate(gpis: &Gpis, free: &[Free]) -> Vec<Reading> {
    let points: Vec<Point> = free.iter().map(|f| f.point).collect();
    let (mean, prior) = gpis.joint(&points);
    let n = points.len();
    // Sites: precision τ and precision times mean ν.
    let mut tau: DVector<f64> = DVector::zeros(n);
    let mut nu: DVector<f64> = DVector::zeros(n);
    let (mut covariance, mut belief) = (prior.clone(), mean.clone());
    for _ in 0..SWEEPS {
        let mut moved: f64 = 0.0;
        for i in 0..n {
            let variance = covariance[(i, i)];
            let left = 1.0 / variance - tau[i];
            if !(variance > 0.0 && left > 0.0) {
                continue;
            }
            let without = (belief[i] / variance - nu[i]) / left;
            let wide: f64 = 1.0 / left + free[i].deviation.powi(2);
            let z = without / wide.sqrt();
            let h = hazard(z);
            let shrink = h * (z + h) / wide;
            let tilted = 1.0 / left - shrink / (left * left);
            let to = without + h / (left * wide.sqrt());
            if !(tilted > 0.0 && to.is_finite()) {
                continue;
            }
            let precision = (1.0 / tilted - left).max(0.0);
            let change = precision - tau[i];
            moved = moved.max((to - belief[i]).abs() / variance.sqrt());
            tau[i] = precision;
            nu[i] = to / tilted - without * left;
            let column = covariance.column(i).into_owned();
            covariance.ger(-change / (1.0 + change * variance), &column, &column, 1.0);
            belief = &mean + &covariance * (&nu - tau.component_mul(&mean));
        }
        // Rounding gathers in the updates: once a sweep from the beginning.
        if let Some(fresh) = posterior(&prior, &tau) {
            covariance = fresh;
            belief = &mean + &covariance * (&nu - tau.component_mul(&mean));
        }
        if moved < STILL {
            break;
        }
    }
    let says = |i: &usize| tau[*i] * prior[(*i, *i)] > 1e-6;
    let reading =
        |i: usize| Reading { point: points[i], value: nu[i] / tau[i], variance: 1.0 / tau[i] };
    (0..n).filter(says).map(reading).collect()
}

/// (Σ⁻¹ + diag τ)⁻¹ without inverting Σ.
fn posterior(prior: &DMatrix<f64>, tau: &DVector<f64>) -> Option<DMatrix<f64>> {
    let root = tau.map(f64::sqrt);
    let scaled = DMatrix::from_fn(tau.len(), tau.len(), |i, j| root[i] * prior[(i, j)]);
    let mut inner = DMatrix::from_fn(tau.len(), tau.len(), |i, j| scaled[(i, j)] * root[j]);
    inner.fill_diagonal(0.0);
    for i in 0..tau.len() {
        inner[(i, i)] = 1.0 + tau[i] * prior[(i, i)];
    }
    let half = inner.cholesky()?.l().solve_lower_triangular(&scaled)?;
    Some(prior - half.tr_mul(&half))
}

/// φ(z)/Φ(z), of the standard normal distribution, to 2·10⁻⁷ relative, in the far tail too: by the
/// Chebyshev fit of the complementary error function in Press et al., Numerical Recipes, 6.2.
fn hazard(z: f64) -> f64 {
    const FIT: [f64; 10] = [
        -1.265_512_23,
        1.000_023_68,
        0.374_091_96,
        0.096_784_18,
        -0.186_288_06,
        0.278_868_07,
        -1.135_203_98,
        1.488_515_87,
        -0.822_152_23,
        0.170_872_77,
    ];
    let t = 1.0 / (1.0 + 0.5 * z.abs() * std::f64::consts::FRAC_1_SQRT_2);
    // Φ(−|z|) e^{z²/2}.
    let tail = 0.5 * t * FIT.iter().rev().fold(0.0, |sum, c| sum * t + c).exp();
    let density = std::f64::consts::TAU.sqrt().recip();
    if z < 0.0 {
        density / tail
    } else {
        let bell = (-0.5 * z * z).exp();
        density * bell / (1.0 - tail * bell)
    }
}

#[cfg(test)]
mod tests;
