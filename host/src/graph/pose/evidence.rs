//! How much more probable a measurement is if it is right than if it is a random one.
//!
//! A random closure says that a pose is anywhere in the extent of the map, turned anyhow: a uniform
//! density. A right one is off by its own noise and by what is not known of the poses it is compared
//! with: a normal density. Their ratio weighs at once how far a measurement is off and how surprising it
//! is that it is not; what is hardly known can neither refute nor confirm.

use nalgebra::{SMatrix, SVector};

use super::rigid::Rigid;

/// What random closures look like, and how large the errors of right ones are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chance {
    /// Log of the density of a random error.
    log_density: f64,
    /// Metres.
    extent: f64,
    /// Variance of right measurements in units of what their information claims.
    pub variance: f64,
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
        Chance { log_density: -volume.ln(), extent, variance: 1.0 }
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
        let mut own = information / self.variance;
        for k in 0..D {
            own[(k, k)] += if k < N { self.extent.powi(-2) } else { 0.1 };
        }
        let Some(own) = own.cholesky() else { return undecided };
        let l = own.l();
        let inner = l.tr_mul(&(spread * self.variance * l));
        let inner = SMatrix::<f64, D, D>::identity() + (inner + inner.transpose()) * (0.5 * sign);
        let Some(inner) = inner.cholesky() else { return undecided };
        let white = l.tr_mul(error);
        let chi2 = white.dot(&inner.solve(&white));
        let log = |l: &SMatrix<f64, D, D>| 2.0 * (0..D).map(|k| l[(k, k)].ln()).sum::<f64>();
        let triangle = inner.l();
        let own_log = log(&l) - sign * log(&triangle);
        let normal = 0.5 * (own_log - D as f64 * (2.0 * std::f64::consts::PI).ln());
        // What may be anywhere in the map is as probable there as what is random.
        let odds = (normal - self.log_density).max(0.0) - 0.5 * chi2;
        if !(chi2.is_finite() && odds.is_finite()) {
            return undecided;
        }
        let doubt = (sign * log(&triangle) / D as f64).exp();
        Verdict { chi2, odds, doubt }
    }
}

/// The medians of χ² with three and six degrees of freedom.
pub(super) fn median_chi2(degrees: usize) -> f64 {
    if degrees == 3 { 2.366 } else { 5.348 }
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
}
