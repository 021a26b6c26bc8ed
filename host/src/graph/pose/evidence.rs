//! How much more probable a measurement is if it is right than if it is a random one.
//!
//! A random closure says that a pose is anywhere in the extent of the map, turned anyhow: a uniform
//! density. A right one is off by its own noise and by what is not known of the poses it is compared
//! with: a normal density. Their ratio weighs at once how far a measurement is off and how surprising it
//! is that it is not; what is hardly known can neither refute nor confirm.
//!
//! Information claims a variance, which is seldom the true one, and some right measurements are much worse than
//! theirs. Errors are therefore a mixture of normal densities ([`SCALES`]), all with the one
//! factor to claimed variances under which those of agreeing edges are most probable ([`scale`]). The
//! uncertainty of the poses has no such tails: it sums up many measurements.

use nalgebra::{SMatrix, SVector};

/// What random closures look like, and how large the errors of right ones are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chance {
    /// Log of the density of a random error.
    log_density: f64,
    /// Metres.
    extent: f64,
    /// Variance of right measurements' errors, in units of what information claims.
    pub variance: f64,
    /// Shares of the errors by [`SCALES`].
    shares: [f64; 4],
}

/// How right measurements err: shares of them, and their variance by that of the most. Every tenfold variance
/// is a tenth as frequent (after the contaminated normal distribution of Tukey 1960).
const SCALES: [(f64, f64); 4] = [(0.9, 1.0), (0.09, 10.0), (0.009, 100.0), (0.001, 1000.0)];

/// The scale starts from what was claimed, as sure as that many numbers.
const PRIOR: f64 = 10.0;

/// The shares of large errors start from [`SCALES`], as sure as that many measurements.
const SHARED: f64 = 20.0;

/// Rounds of learning how large errors are, at most, and how little the logarithm of their variance changes
/// in the last.
const MOST: usize = 30;
const SETTLED: f64 = 1e-3;

/// Logarithm of a sum of exponentials.
fn log_sum<const K: usize>(terms: [f64; K]) -> f64 {
    let most = terms.into_iter().fold(f64::NEG_INFINITY, f64::max);
    most + terms.into_iter().map(|term| (term - most).exp()).sum::<f64>().ln()
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
        Chance {
            log_density: -volume.ln(),
            extent,
            variance: 1.0,
            shares: SCALES.map(|(share, _)| share),
        }
    }

    /// Sets the variance, and the shares of large errors, to the most probable for squared errors, in
    /// claimed units, of vectors of D numbers each, where `claimed` is the variance without any.
    pub fn learn<const D: usize>(&mut self, squared: &[f64], claimed: f64) {
        let numbers = (squared.len() * D) as f64;
        let least = 1e-12 * claimed;
        let mut variance = (squared.iter().sum::<f64>() / numbers.max(1.0)).max(least);
        let own = SCALES.map(|(_, times)| 0.5 * D as f64 * times.ln());
        let mut shares = SCALES.map(|(share, _)| share);
        for _ in 0..MOST {
            // Expectation maximisation: an error counts by the scales that it probably has.
            let logs: [f64; 4] = std::array::from_fn(|k| shares[k].ln() - own[k]);
            let (mut sum, mut counts) = (0.0, [0.0; 4]);
            for s in squared {
                let terms: [f64; 4] =
                    std::array::from_fn(|k| logs[k] - 0.5 * s / (variance * SCALES[k].1));
                let most = terms.into_iter().fold(f64::NEG_INFINITY, f64::max);
                let terms = terms.map(|term| (term - most).exp());
                let all: f64 = terms.iter().sum();
                for k in 0..4 {
                    counts[k] += terms[k] / all;
                    sum += s * terms[k] / (all * SCALES[k].1);
                }
            }
            let before = std::mem::replace(&mut variance, (sum / numbers.max(1.0)).max(least));
            let all = SHARED + squared.len() as f64;
            shares = std::array::from_fn(|k| (SHARED * SCALES[k].0 + counts[k]) / all);
            if (variance / before).ln().abs() < SETTLED {
                break;
            }
        }
        let sure = numbers / (numbers + PRIOR);
        self.variance = (sure * variance.ln() + (1.0 - sure) * claimed.ln()).exp();
        self.shares = shares;
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
    pub fn outside<const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
    ) -> Verdict {
        self.judge::<N, D>(error, information, spread, false)
    }

    /// The same for one that did take part, as if it had not: its error would have been larger.
    pub fn inside<const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
    ) -> Verdict {
        self.judge::<N, D>(error, information, spread, true)
    }

    /// χ² and doubt of [`inside`](Self::inside) alone, without odds, for a fraction of the work:
    /// (I − A)⁻¹ whitens and weighs at once.
    pub fn fit<const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
    ) -> Verdict {
        let undecided = Verdict { chi2: 0.0, odds: 0.0, doubt: f64::INFINITY };
        let Some(l) = self.own::<D, N>(information) else { return undecided };
        let rest = SMatrix::<f64, D, D>::identity() - l.tr_mul(&(spread * self.variance * l));
        let Some(rest) = ((rest + rest.transpose()) * 0.5).cholesky() else { return undecided };
        let white = l.tr_mul(error);
        let chi2 = white.dot(&rest.solve(&white));
        let determinant: f64 = rest.l_dirty().diagonal().iter().product();
        let doubt = determinant.powf(-2.0 / D as f64);
        if !(chi2.is_finite() && doubt.is_finite()) {
            return undecided;
        }
        Verdict { chi2, odds: 0.0, doubt }
    }

    /// L of a measurement's own information, as the variance has it. Where it is zero, the measurement says
    /// no more than that it is in the map.
    fn own<const D: usize, const N: usize>(
        &self,
        information: &SMatrix<f64, D, D>,
    ) -> Option<SMatrix<f64, D, D>> {
        let mut own = information / self.variance;
        for k in 0..D {
            own[(k, k)] += if k < N { self.extent.powi(-2) } else { 0.1 };
        }
        Some(own.cholesky()?.l())
    }

    /// With Ω = L Lᵀ, P being the spread and A = Lᵀ P L: the whitened error Lᵀ e is normal with
    /// covariance k I + A, k being the scale of its own noise. Without a measurement that took part, it
    /// would be (I − A)⁻¹ Lᵀ e, and what is left of A is (I − A)⁻¹ − I.
    fn judge<const N: usize, const D: usize>(
        &self,
        error: &SVector<f64, D>,
        information: &SMatrix<f64, D, D>,
        spread: &SMatrix<f64, D, D>,
        took_part: bool,
    ) -> Verdict {
        let undecided = Verdict { chi2: 0.0, odds: 0.0, doubt: f64::INFINITY };
        let Some(l) = self.own::<D, N>(information) else { return undecided };
        let log = |l: &SMatrix<f64, D, D>| 2.0 * (0..D).map(|k| l[(k, k)].ln()).sum::<f64>();
        let one = SMatrix::<f64, D, D>::identity();
        let inner = l.tr_mul(&(spread * self.variance * l));
        let mut inner = (inner + inner.transpose()) * 0.5;
        let mut white = l.tr_mul(error);
        if took_part {
            let Some(without) = (one - inner).cholesky() else { return undecided };
            white = without.solve(&white);
            inner = without.inverse() - one;
        }
        let compared = |times: f64| {
            let sum = (inner + one * times).cholesky()?;
            Some((white.dot(&sum.solve(&white)), log(&sum.l())))
        };
        let Some((chi2, doubt)) = compared(1.0) else { return undecided };
        let scales: [(f64, f64); 4] = std::array::from_fn(|k| {
            let (share, times) = (self.shares[k], SCALES[k].1);
            let none = (0.0, f64::INFINITY);
            let (squared, log) = compared(times).unwrap_or(none);
            let peak = share.ln() - 0.5 * log;
            (peak, peak - 0.5 * squared)
        });
        let constant = 0.5 * (log(&l) - D as f64 * (2.0 * std::f64::consts::PI).ln());
        let peak = log_sum(scales.map(|(peak, _)| peak));
        let here = log_sum(scales.map(|(_, here)| here));
        // What may be anywhere in the map is as probable there as what is random.
        let odds = (peak + constant - self.log_density).max(0.0) + (here - peak);
        if !(chi2.is_finite() && odds.is_finite()) {
            return undecided;
        }
        Verdict { chi2, odds, doubt: (doubt / D as f64).exp() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::grid::{Random, grid};
    use super::super::spread::Spread;
    use super::super::{Group, Optimizer, Options, PoseGraph, Se2, Se3, optimize};
    use super::*;
    use crate::graph::pose::Rigid;

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
        let chance = Chance { variance: 0.3, ..Chance::new::<D, N>(4.0) };
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
            let fit = chance.fit::<D, N>(&at.error, &edge.information, &own);
            let verdict = match inside {
                true => chance.inside::<D, N>(&at.error, &edge.information, &own),
                false => chance.outside::<D, N>(&at.error, &edge.information, &own),
            };
            (verdict, fit)
        };
        let ((inside, fit), (outside, _)) = (verdict(&with, true), verdict(&without, false));
        assert!((inside.odds - outside.odds).abs() < 1e-3, "{inside:?} {outside:?}");
        assert!((inside.doubt - outside.doubt).abs() < 1e-3, "{inside:?} {outside:?}");
        assert!((inside.chi2 - outside.chi2).abs() < 1e-3 * (1e-3 + outside.chi2));
        assert!((fit.chi2 - inside.chi2).abs() < 1e-9 * (1e-3 + inside.chi2), "{fit:?} {inside:?}");
        assert!((fit.doubt / inside.doubt - 1.0).abs() < 1e-9, "{fit:?} {inside:?}");
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
            chance.outside::<3, 2>(&error, &information, &spread).odds
        };
        // ln (2 π · 100 π) − 1.5 ln (2 π / 100) + ln Σ wₖ k^−1.5
        let exact = 7.588 + 4.151 - 0.102;
        assert!((of(0.0, 0.0) - exact).abs() < 0.02, "{}", of(0.0, 0.0));
        assert!(of(0.2, 0.0) < of(0.0, 0.0) && of(0.0, 0.1) < of(0.0, 0.0));
        // Ten standard deviations are as probably bad luck as a random hit, fifty are not.
        assert!(of(1.0, 0.0).abs() < 2.0 && of(5.0, 0.0) < -5.0 && of(1.0, 0.5) > 3.0);
        // What is not known at all neither speaks for it nor against it.
        assert!(of(1.0, 1e6).abs() < 1e-3);
        let nothing = nalgebra::Matrix3::zeros();
        let far = nalgebra::Vector3::new(3.0, 0.0, 0.0);
        let verdict = chance.outside::<3, 2>(&far, &nothing, &nothing);
        assert!(verdict.odds.abs() < 0.5, "{verdict:?}");
    }

    #[test]
    fn the_scale_of_errors_is_found() {
        let mut random = Random::new(1000);
        let mut squared = |worse: usize| -> Vec<f64> {
            let of = |k| {
                let normal = (0..3).map(|_| random.normal().powi(2)).sum::<f64>();
                0.04 * normal * if k < worse { 100.0 } else { 1.0 }
            };
            (0..2000).map(of).collect()
        };
        let learned = |squared: &[f64], claimed: f64| {
            let mut chance = Chance::new::<3, 2>(1.0);
            chance.learn::<3>(squared, claimed);
            chance
        };
        let (normal, some) = (learned(&squared(0), 1.0), learned(&squared(60), 1.0));
        assert!((normal.variance / 0.04 - 1.0).abs() < 0.05, "{normal:?}");
        // Their plain mean would be four times as large.
        assert!((some.variance / 0.04 - 1.0).abs() < 0.05, "{some:?}");
        // 3 % are a hundred times as large; without them, there are few large errors at all.
        let large = |chance: &Chance| chance.shares[2] + chance.shares[3];
        assert!((large(&some) - 0.03).abs() < 0.01, "{some:?}");
        assert!(large(&normal) < 0.001 && normal.shares[0] > 0.98, "{normal:?}");
        for chance in [&normal, &some] {
            assert!((chance.shares.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        }
        let none = learned(&[], 0.5);
        assert_eq!((none.variance, none.shares), (0.5, SCALES.map(|(share, _)| share)));
        assert!(learned(&[0.0], 1.0).variance > 0.0);
    }

    #[test]
    fn large_errors_are_excused_as_far_as_others_are_large() {
        let mut random = Random::new(1001);
        let mut after = |worse: usize| {
            let mut chance = Chance::new::<3, 2>(10.0);
            let of = |k| {
                let normal = (0..3).map(|_| random.normal().powi(2)).sum::<f64>();
                normal * if k < worse { 100.0 } else { 1.0 }
            };
            let squared: Vec<f64> = (0..2000).map(of).collect();
            chance.learn::<3>(&squared, 1.0);
            let error = nalgebra::Vector3::new(1.0, 0.0, 0.0);
            let information = nalgebra::Matrix3::identity() * 100.0;
            chance.outside::<3, 2>(&error, &information, &nalgebra::Matrix3::zeros()).odds
        };
        // Ten standard deviations.
        assert!(after(60) > 0.5 && after(0) < -2.0, "{} {}", after(60), after(0));
    }

    #[test]
    fn densities_integrate_to_one() {
        // Odds are a ratio of densities, of which that of random closures is uniform.
        let chance = Chance::new::<3, 2>(1e6);
        let one = nalgebra::Matrix3::identity();
        let step = 0.02;
        let sum: f64 = (0..20_000)
            .map(|k| {
                let r = (f64::from(k) + 0.5) * step;
                let error = nalgebra::Vector3::new(r, 0.0, 0.0);
                let verdict = chance.outside::<3, 2>(&error, &(one * 100.0), &(one * 0.1));
                4.0 * std::f64::consts::PI
                    * r
                    * r
                    * step
                    * (verdict.odds + chance.log_density).exp()
            })
            .sum();
        assert!((sum - 1.0).abs() < 5e-3, "{sum}");
    }
}
