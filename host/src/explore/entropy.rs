//! How uncertain a distribution over finitely many things is, and how far one is from another (thesis
//! 4.4.1–4.4.3, as corrected). Natural logarithms: everything is in nats.
//!
//! ```
//! use tactile_host::explore::entropy::{divergence, renyi, shannon};
//!
//! let (fair, loaded) = ([0.5, 0.5], [0.9, 0.1]);
//! assert!((shannon(&fair) - 2f64.ln()).abs() < 1e-12);
//! assert!(renyi(&loaded, 2.0) < shannon(&loaded));
//! assert!(divergence(&loaded, &fair) > 0.0);
//! ```

/// Orders of the Rényi entropy nearer to 1 than this are Shannon's, its limit.
const SHANNON: f64 = 1e-6;

/// Shannon's entropy Σ −p log p (4.2, 4.3). What has no probability counts nothing.
pub fn shannon(p: &[f64]) -> f64 {
    positive(p).map(|p| -p * p.ln()).sum()
}

/// Rényi's entropy of order α > 0: log(Σ pᵅ)/(1 − α); Shannon's for α = 1. (4.4 lacks the power.)
pub fn renyi(p: &[f64], alpha: f64) -> f64 {
    if (alpha - 1.0).abs() < SHANNON {
        return shannon(p);
    }
    // From the greatest probability on, so that high orders do not underflow.
    let Some(greatest) = positive(p).reduce(f64::max) else { return 0.0 };
    let sum: f64 = positive(p).map(|p| (p / greatest).powf(alpha)).sum();
    (sum.ln() + alpha * greatest.ln()) / (1.0 - alpha)
}

/// Kullback–Leibler divergence of `p` from `q`, Σ p log(p/q) (4.6): infinite where p holds possible
/// what q does not. What a measurement told is the divergence of the posterior from the prior; the
/// direction that is printed is unbounded.
pub fn divergence(p: &[f64], q: &[f64]) -> f64 {
    let both = p.iter().zip(q).filter(|(p, _)| **p > 0.0);
    both.map(|(p, q)| if *q > 0.0 { p * (p / q).ln() } else { f64::INFINITY }).sum()
}

fn positive(p: &[f64]) -> impl Iterator<Item = f64> {
    p.iter().copied().filter(|p| *p > 0.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn distribution(weights: Vec<f64>) -> Vec<f64> {
        let total: f64 = weights.iter().sum();
        weights.into_iter().map(|w| w / total).collect()
    }

    proptest! {
        #[test]
        fn renyi_falls_with_its_order_and_meets_shannon_at_one(
            weights in proptest::collection::vec(1e-3..1.0f64, 1..20)
        ) {
            let p = distribution(weights);
            let n = (p.len() as f64).ln();
            let orders = [0.2, 0.5, 0.999_99, 1.0, 1.000_01, 2.0, 5.0, 80.0];
            let h = orders.map(|a| renyi(&p, a));
            prop_assert!(h.windows(2).all(|w| w[0] >= w[1] - 1e-9), "{h:?}");
            prop_assert!((-1e-12..=n + 1e-12).contains(&h[3]));
            prop_assert!((h[2] - h[3]).abs() < 1e-3 && (h[4] - h[3]).abs() < 1e-3, "{h:?}");
            // The least of them: of the likeliest.
            let most = p.iter().copied().fold(0.0, f64::max);
            prop_assert!(renyi(&p, 5000.0) >= -most.ln() - 1e-9);
        }

        #[test]
        fn divergence_is_zero_for_equals_and_positive_for_others(
            pairs in proptest::collection::vec((1e-3..1.0f64, 1e-3..1.0f64), 1..20)
        ) {
            let (p, q): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
            let (p, q) = (distribution(p), distribution(q));
            prop_assert!(divergence(&p, &q) >= -1e-12);
            prop_assert!(divergence(&p, &p).abs() < 1e-12);
            let uniform = vec![1.0 / p.len() as f64; p.len()];
            let fall = shannon(&uniform) - shannon(&p);
            prop_assert!((divergence(&p, &uniform) - fall).abs() < 1e-9);
        }
    }

    #[test]
    fn certainty_has_no_entropy_and_the_impossible_is_infinitely_far() {
        let sure = [1.0, 0.0, 0.0];
        for alpha in [0.5, 1.0, 2.0] {
            assert_eq!(renyi(&sure, alpha), 0.0);
            assert_eq!(renyi(&[], alpha), 0.0);
        }
        assert_eq!(divergence(&[0.5, 0.5], &[1.0, 0.0]), f64::INFINITY);
        assert_eq!(divergence(&sure, &[0.5, 0.25, 0.25]), 2f64.ln());
    }
}
