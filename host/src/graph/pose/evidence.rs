//! How much more probable a measurement is if it is right than if it is a random one.
//!
//! A random closure says that a pose is anywhere in the extent of the map, turned anyhow: a uniform
//! density. A right one is off by its own noise and by what is not known of the poses it is compared
//! with: a normal density. Their ratio weighs at once how far a measurement is off and how surprising it
//! is that it is not; what is hardly known can neither refute nor confirm.
//!
//! Information claims a variance, which is seldom the true one and not equally wrong everywhere. Errors are
//! therefore Student's t (normal with a variance that differs from edge to edge), with the scale and the
//! degrees of freedom under which those of agreeing edges are most probable ([`Errors`]).

use nalgebra::{SMatrix, SVector};

use super::rigid::Rigid;

/// What random closures look like, and how large the errors of right ones are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chance {
    /// Log of the density of a random error.
    log_density: f64,
    /// Metres.
    extent: f64,
    /// How right measurements err.
    pub errors: Errors,
}

/// How the errors of right measurements are distributed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Errors {
    /// Squared scale, in units of the variance that information claims.
    pub variance: f64,
    /// Degrees of freedom of Student's t; infinite for a normal distribution.
    freedom: f64,
}

/// Degrees of freedom that are tried: even, for which gamma functions are products.
const FREEDOM: [usize; 7] = [4, 6, 8, 12, 20, 40, 100];

/// Log likelihood that tails must gain to be believed.
const TAILS: f64 = 3.0;

/// The scale starts from what was claimed, as sure as that many numbers.
const PRIOR: f64 = 10.0;

impl Errors {
    /// Normal.
    pub fn normal(variance: f64) -> Self {
        Errors { variance, freedom: f64::INFINITY }
    }

    /// Most probable for squared errors, in claimed units, of vectors of D numbers each, where
    /// `claimed` is the variance without any.
    pub fn of<const D: usize>(squared: &[f64], claimed: f64) -> Self {
        let numbers = (squared.len() * D) as f64;
        if squared.is_empty() {
            return Errors::normal(claimed);
        }
        let sure = numbers / (numbers + PRIOR);
        let settled = |variance: f64| {
            (sure * variance.max(1e-12 * claimed).ln() + (1.0 - sure) * claimed.ln()).exp()
        };
        let mean = squared.iter().sum::<f64>() / numbers;
        let likelihood = |errors: &Errors| -> f64 {
            let constant = errors.log_peak::<D>() - 0.5 * D as f64 * errors.variance.ln();
            squared.iter().map(|s| constant - errors.fall::<D>(s / errors.variance)).sum()
        };
        let normal = Errors::normal(mean.max(1e-12 * claimed));
        let mut best = (normal, likelihood(&normal) + TAILS);
        for freedom in FREEDOM.map(|freedom| freedom as f64) {
            // Errors far out weigh less: the fixed point of the weighted mean.
            let mut variance = normal.variance;
            for _ in 0..30 {
                let weight = |s: f64| (freedom + D as f64) / (freedom + s / variance);
                let sum: f64 = squared.iter().map(|&s| s * weight(s)).sum();
                variance = (sum / numbers).max(1e-12 * claimed);
            }
            let errors = Errors { variance, freedom };
            let likelihood = likelihood(&errors);
            if likelihood > best.1 {
                best = (errors, likelihood);
            }
        }
        Errors { variance: settled(best.0.variance), ..best.0 }
    }

    /// Log of the density at zero, of D numbers of unit scale.
    fn log_peak<const D: usize>(&self) -> f64 {
        use std::f64::consts::PI;
        let half = 0.5 * D as f64;
        if self.freedom.is_infinite() {
            return -half * (2.0 * PI).ln();
        }
        // Γ(m + D/2) / Γ(m) for m = ν/2: from Γ(3/2) / Γ(1) = √π / 2 where D is odd.
        let m = (0.5 * self.freedom) as usize;
        let mut ratio = 0.0;
        if D % 2 == 1 {
            ratio += (0.5 * PI.sqrt()).ln();
            ratio += (1..m).map(|k| ((k as f64 + 0.5) / k as f64).ln()).sum::<f64>();
        }
        let first = m as f64 + 0.5 * (D % 2) as f64;
        ratio += (0..D / 2).map(|k| (first + k as f64).ln()).sum::<f64>();
        ratio - half * (self.freedom * PI).ln()
    }

    /// How much lower the log density is at a squared distance.
    fn fall<const D: usize>(&self, squared: f64) -> f64 {
        if self.freedom.is_infinite() {
            return 0.5 * squared;
        }
        0.5 * (self.freedom + D as f64) * (squared / self.freedom).ln_1p()
    }
}

/// How one measurement compares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Verdict {
    /// Squared error in units of its covariance.
    pub chi2: f64,
    /// Log of the ratio of densities, right to random.
    pub odds: f64,
    /// Variance of the error by that of the measurement alone: mean over its components.
    pub doubt: f64,
}

impl Chance {
    /// Of closures anywhere in a ball with radius `extent` metres.
    pub fn new<const D: usize, const N: usize>(extent: f64) -> Self {
        use std::f64::consts::PI;
        let extent = extent.max(1e-9);
        // Volumes of the ball and of all rotations; in space in coordinates of half the angle.
        let volume = if N == 2 {
            PI * extent.powi(2) * 2.0 * PI
        } else {
            4.0 / 3.0 * PI * extent.powi(3) * PI.powi(2)
        };
        Chance { log_density: -volume.ln(), extent, errors: Errors::normal(1.0) }
    }

    /// Of an error with isotropic variances of translation (m²) and rotation as claimed, if right ones
    /// have `variance` times as much.
    pub fn isotropic<const D: usize, const N: usize>(
        &self,
        [t, r]: [f64; 2],
        claimed: [f64; 2],
        variance: f64,
    ) -> f64 {
        let [translation, rotation] = claimed.map(|claimed| claimed * variance);
        let log = |variance: f64| (2.0 * std::f64::consts::PI * variance).ln();
        let normal = -0.5 * (t / translation + r / rotation)
            - 0.5 * (N as f64 * log(translation) + (D - N) as f64 * log(rotation));
        let odds = normal - self.log_density;
        if odds.is_nan() { f64::NEG_INFINITY } else { odds }
    }

    /// Of a measurement that took no part in the estimate it is compared with, whose error has the
    /// covariance `spread` (in claimed units) on its account.
    pub fn outside<G: Rigid<D, N>, const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
    ) -> Verdict {
        self.judge::<N, D>(error, information, spread, 1.0)
    }

    /// The same for one that did take part, as if it had not: its error would have been larger.
    pub fn inside<G: Rigid<D, N>, const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
    ) -> Verdict {
        self.judge::<N, D>(error, information, spread, -1.0)
    }

    /// With Ω = L Lᵀ and A = Lᵀ P L, P being the spread: the error is normal with covariance
    /// Ω⁻¹ + P = L⁻ᵀ (I + A) L⁻¹. Without a measurement that took part, it would be e′ with
    /// e′ᵀ C⁻¹ e′ = eᵀ L (I − A)⁻¹ Lᵀ e and C = L⁻ᵀ (I − A)⁻¹ L⁻¹.
    fn judge<const N: usize, const D: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
        sign: f64,
    ) -> Verdict {
        let undecided = Verdict { chi2: 0.0, odds: 0.0, doubt: f64::INFINITY };
        // Where information is zero, a measurement says no more than that it is in the map.
        let mut own = information / self.errors.variance;
        for k in 0..D {
            own[(k, k)] += if k < N { self.extent.powi(-2) } else { 0.1 };
        }
        let Some(own) = own.cholesky() else { return undecided };
        let l = own.l();
        let inner = l.tr_mul(&(spread * self.errors.variance * l));
        let inner = SMatrix::<f64, D, D>::identity() + (inner + inner.transpose()) * (0.5 * sign);
        let Some(inner) = inner.cholesky() else { return undecided };
        let white = l.tr_mul(error);
        let chi2 = white.dot(&inner.solve(&white));
        let log = |l: &SMatrix<f64, D, D>| 2.0 * (0..D).map(|k| l[(k, k)].ln()).sum::<f64>();
        let triangle = inner.l();
        let own_log = log(&l) - sign * log(&triangle);
        let peak = self.errors.log_peak::<D>() + 0.5 * own_log;
        // What may be anywhere in the map is as probable there as what is random.
        let odds = (peak - self.log_density).max(0.0) - self.errors.fall::<D>(chi2);
        if !(chi2.is_finite() && odds.is_finite()) {
            return undecided;
        }
        let doubt = (sign * log(&triangle) / D as f64).exp();
        Verdict { chi2, odds, doubt }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::grid::{Random, grid};
    use super::super::spread::Spread;
    use super::super::{Group, Optimizer, Options, PoseGraph, Se2, Se3, optimize};
    use super::*;

    /// The covariance of an edge's error from the whole inverse.
    fn dense<G: Group<D>, const D: usize>(
        graph: &PoseGraph<G, D>,
        (from, to): (usize, usize),
        at: &super::super::Linearised<D>,
    ) -> SMatrix<f64, D, D> {
        let marginals = super::super::marginals(graph).unwrap();
        let cross = at.from * marginals.pair(from, to) * at.to.transpose();
        at.from * marginals.pose(from) * at.from.transpose()
            + at.to * marginals.pose(to) * at.to.transpose()
            + cross
            + cross.transpose()
    }

    /// What is said of an edge that took part is what is said without it.
    fn consistent<G: Rigid<D, N>, const D: usize, const N: usize>(seed: u64) {
        // So little noise that the errors are linear.
        let mut with = grid::<G, D>(seed, 5, 1e-5);
        let mut random = Random::new(seed);
        let index = 24 + random.index(with.edges.len() - 24);
        let mut without = with.clone();
        let edge = without.edges.remove(index);
        optimize(&mut with, &Options::default()).unwrap();
        optimize(&mut without, &Options::default()).unwrap();
        let chance = Chance { errors: Errors::normal(0.3), ..Chance::new::<D, N>(4.0) };
        let verdict = |graph: &PoseGraph<G, D>, inside: bool| {
            let mut optimizer = Optimizer::new(graph).unwrap();
            let weights = vec![1.0; graph.edges.len()];
            let mut spread = Spread::new(&mut optimizer, graph, &weights).unwrap();
            let poses = &graph.poses;
            let at = G::linearise(&poses[edge.from], &poses[edge.to], &edge.measured);
            let own = spread.of(edge.from, edge.to, &at);
            let exact = dense(graph, (edge.from, edge.to), &at);
            assert!((own - exact).norm() < 1e-9 * exact.norm(), "{own} {exact}");
            let slack = spread.bound(edge.from, edge.to, &at) - own;
            let rounding = SMatrix::<f64, D, D>::identity() * (1e-9 * own.norm());
            assert!((slack + rounding).cholesky().is_some(), "{slack}");
            match inside {
                true => chance.inside::<G, D, N>(&at.error, &edge.information, &own),
                false => chance.outside::<G, D, N>(&at.error, &edge.information, &own),
            }
        };
        let (inside, outside) = (verdict(&with, true), verdict(&without, false));
        assert!((inside.odds - outside.odds).abs() < 1e-3, "{inside:?} {outside:?}");
        assert!((inside.doubt - outside.doubt).abs() < 1e-3, "{inside:?} {outside:?}");
        assert!((inside.chi2 - outside.chi2).abs() < 1e-3 * (1e-3 + outside.chi2));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]

        #[test]
        fn taking_part_makes_no_difference(seed in 0u64..1000) {
            consistent::<Se2, 3, 2>(seed);
            consistent::<Se3, 6, 3>(seed);
        }
    }

    #[test]
    fn evidence_falls_with_the_error_and_with_doubt() {
        let chance = Chance::new::<3, 2>(10.0);
        let information = nalgebra::Matrix3::identity() * 100.0;
        let of = |x: f64, doubt: f64| {
            let spread = nalgebra::Matrix3::identity() * doubt;
            let error = nalgebra::Vector3::new(x, 0.0, 0.0);
            chance.outside::<Se2, 3, 2>(&error, &information, &spread).odds
        };
        // ln (2 π · 100 π) − 1.5 ln (2 π / 100)
        let exact = 7.588 + 4.151;
        assert!((of(0.0, 0.0) - exact).abs() < 0.02, "{}", of(0.0, 0.0));
        assert!(of(0.2, 0.0) < of(0.0, 0.0) && of(0.0, 0.1) < of(0.0, 0.0));
        assert!(of(1.0, 0.0) < -30.0 && of(1.0, 0.5) > 0.0);
        // What is not known at all neither speaks for it nor against it.
        assert!(of(1.0, 1e6).abs() < 1e-3);
        let nothing = nalgebra::Matrix3::zeros();
        let far = nalgebra::Vector3::new(3.0, 0.0, 0.0);
        let verdict = chance.outside::<Se2, 3, 2>(&far, &nothing, &nothing);
        assert!(verdict.odds.abs() < 0.5, "{verdict:?}");
    }

    #[test]
    fn the_scale_and_the_tails_of_errors_are_found() {
        let mut random = Random::new(1000);
        let mut squared = |freedom: Option<usize>| -> Vec<f64> {
            let of = |_| {
                let normal = (0..3).map(|_| random.normal().powi(2)).sum::<f64>();
                let scale = freedom.map_or(1.0, |freedom| {
                    (0..freedom).map(|_| random.normal().powi(2)).sum::<f64>() / freedom as f64
                });
                0.04 * normal / scale
            };
            (0..2000).map(of).collect()
        };
        let normal = Errors::of::<3>(&squared(None), 1.0);
        assert!((normal.variance / 0.04 - 1.0).abs() < 0.1, "{normal:?}");
        assert!(normal.freedom > 30.0, "{normal:?}");
        let tails = Errors::of::<3>(&squared(Some(6)), 1.0);
        assert!((tails.variance / 0.04 - 1.0).abs() < 0.15, "{tails:?}");
        assert!((4.0..=8.0).contains(&tails.freedom), "{tails:?}");
        assert_eq!(Errors::of::<3>(&[], 0.5), Errors::normal(0.5));
        assert!(Errors::of::<3>(&[0.0], 1.0).variance > 0.0);
    }

    #[test]
    fn densities_integrate_to_one() {
        for freedom in [4.0, 12.0, f64::INFINITY] {
            let errors = Errors { variance: 1.0, freedom };
            let step = 0.01;
            let shell = |k: usize| {
                let r = (k as f64 + 0.5) * step;
                let density = |peak: f64, fall: f64| (peak - fall).exp();
                let flat = density(errors.log_peak::<3>(), errors.fall::<3>(r * r));
                let solid = density(errors.log_peak::<6>(), errors.fall::<6>(r * r));
                let pi = std::f64::consts::PI;
                [4.0 * pi * r * r * flat * step, pi.powi(3) * r.powi(5) * solid * step]
            };
            let sums = (0..20_000).map(shell).fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-3), "{freedom}: {sums:?}");
        }
    }
}
