//! Robust kernels: what an edge costs whose error is far outside its information.

/// ρ, a function of the squared error s = eᵀ Ω e of an edge. All behave like s for small errors.
///
/// Minimising Σ ρ(s) by iteratively reweighted least squares gives every edge the weight ρ′(s).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Kernel {
    /// ρ = s: no robustness.
    #[default]
    Identity,
    /// Quadratic up to the error c, linear beyond (Huber 1964).
    Huber(f64),
    /// c² ln(1 + s/c²).
    Cauchy(f64),
    /// c² s / (c² + s): bounded by c².
    GemanMcClure(f64),
    /// (c²/3) (1 − (1 − s/c²)³), and c²/3 beyond the error c: edges there have no say.
    Tukey(f64),
    /// Dynamic covariance scaling (Agarwal and others 2013) with Φ = c²: the error is scaled by
    /// min(1, 2Φ/(Φ + s)), whose cost is s up to Φ and (3Φ s − Φ²)/(Φ + s) beyond.
    Dcs(f64),
}

impl Kernel {
    /// The width c; infinite for the identity.
    pub fn width(self) -> f64 {
        match self {
            Kernel::Identity => f64::INFINITY,
            Kernel::Huber(c)
            | Kernel::Cauchy(c)
            | Kernel::GemanMcClure(c)
            | Kernel::Tukey(c)
            | Kernel::Dcs(c) => c,
        }
    }

    /// ρ(s) and ρ′(s). Below zero, where rounding leads of a semidefinite Ω, s is zero.
    #[inline]
    pub fn cost_and_weight(self, s: f64) -> (f64, f64) {
        // What is no number stays none.
        let s = if s < 0.0 { 0.0 } else { s };
        match self {
            Kernel::Identity => (s, 1.0),
            Kernel::Huber(c) => {
                let error = s.sqrt();
                if error <= c { (s, 1.0) } else { (2.0 * c * error - c * c, c / error) }
            }
            Kernel::Cauchy(c) => {
                let c2 = c * c;
                (c2 * (s / c2).ln_1p(), c2 / (c2 + s))
            }
            Kernel::GemanMcClure(c) => {
                let share = c * c / (c * c + s);
                (share * s, share * share)
            }
            Kernel::Tukey(c) => {
                let c2 = c * c;
                let rest = 1.0 - s / c2;
                let rest = if rest < 0.0 { 0.0 } else { rest };
                (c2 / 3.0 * (1.0 - rest * rest * rest), rest * rest)
            }
            Kernel::Dcs(c) => {
                let phi = c * c;
                if s <= phi {
                    return (s, 1.0);
                }
                let switch = 2.0 * phi / (phi + s);
                (phi * (3.0 - 2.0 * switch), switch * switch)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(c: f64) -> [Kernel; 6] {
        use Kernel::*;
        [Identity, Huber(c), Cauchy(c), GemanMcClure(c), Tukey(c), Dcs(c)]
    }

    proptest! {
        #[test]
        fn weights_are_derivatives_of_costs(c in 0.1f64..10.0, error in 0.0f64..40.0) {
            let s = error * error + 1e-3;
            let h = 1e-5 * s;
            for kernel in all(c) {
                // DCS and Huber have a kink in their slope at s = c².
                if (s - c * c).abs() < 2.0 * h {
                    continue;
                }
                let [less, more] = [s - h, s + h].map(|s| kernel.cost_and_weight(s).0);
                let (cost, weight) = kernel.cost_and_weight(s);
                let slope = (more - less) / (2.0 * h);
                prop_assert!((slope - weight).abs() < 1e-6, "{kernel:?} {s}: {slope} {weight}");
                prop_assert!((0.0..=1.0).contains(&weight) && (0.0..=s * (1.0 + 1e-12)).contains(&cost));
            }
        }

        #[test]
        fn small_errors_cost_what_they_are(c in 0.5f64..10.0) {
            for kernel in all(c) {
                let s = 1e-6 * c * c;
                let (cost, weight) = kernel.cost_and_weight(s);
                prop_assert!((cost / s - 1.0).abs() < 3e-6 && (weight - 1.0).abs() < 3e-6);
                for nothing in [0.0, -1e-17] {
                    prop_assert_eq!(kernel.cost_and_weight(nothing), (0.0, 1.0));
                }
                prop_assert!(kernel.cost_and_weight(f64::NAN).0.is_nan());
            }
        }
    }

    #[test]
    fn bounded_kernels_stay_bounded() {
        let far = 1e12;
        assert!(Kernel::GemanMcClure(2.0).cost_and_weight(far).0 <= 4.0);
        assert_eq!(Kernel::Tukey(3.0).cost_and_weight(far), (3.0, 0.0));
        let (cost, weight) = Kernel::Dcs(2.0).cost_and_weight(far);
        assert!(cost < 12.0 + 1e-6 && weight < 1e-20, "{cost}");
    }
}
