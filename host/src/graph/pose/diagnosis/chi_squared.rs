//! The χ² distribution of the few degrees of freedom that an edge has.

use std::f64::consts::PI;

/// The probability that a sum of `degrees` squared standard normal numbers exceeds `x`: 1 where x ≤ 0
/// or where there are no degrees, NaN for NaN.
///
/// By Q(k+2, x) = Q(k, x) + (x/2)^(k/2) e^(−x/2) / Γ(k/2 + 1) from Q(1, x) = erfc √(x/2) and
/// Q(2, x) = e^(−x/2) (Abramowitz & Stegun 26.4.4 to 26.4.8).
pub(super) fn survival(x: f64, degrees: usize) -> f64 {
    if x <= 0.0 || degrees == 0 {
        return 1.0;
    }
    if x == f64::INFINITY {
        return 0.0;
    }
    let half = 0.5 * x;
    let density = (-half).exp();
    let (mut sum, mut term, mut k) = if degrees % 2 == 1 {
        (erfc(half.sqrt()), 2.0 * density * (half / PI).sqrt(), 1)
    } else {
        (density, density * half, 2)
    };
    while k < degrees {
        sum += term;
        k += 2;
        term *= half / (0.5 * k as f64);
    }
    if sum > 1.0 { 1.0 } else { sum }
}

/// The complementary error function of x ≥ 0, to a relative error of 1e-12: its series where x is small,
/// its continued fraction where it is large (Abramowitz & Stegun 7.1.6, 7.1.14).
fn erfc(x: f64) -> f64 {
    let density = (-x * x).exp() / PI.sqrt();
    if x < 2.0 {
        // erf x = 2/√π e^(−x²) Σ 2ⁿ x^(2n+1) / (2n+1)!!
        let (mut sum, mut term) = (x, x);
        for n in 1..60 {
            term *= 2.0 * x * x / (2 * n + 1) as f64;
            sum += term;
        }
        return 1.0 - 2.0 * density * sum;
    }
    // √π e^(x²) erfc x = 1/(x + (1/2)/(x + 1/(x + (3/2)/(x + …)))), from the inside out.
    let mut fraction = x;
    for n in (1..=80).rev() {
        fraction = x + 0.5 * n as f64 / fraction;
    }
    density / fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_are_those_of_the_tables() {
        // Abramowitz & Stegun, table 26.8, and the closed forms of the even ones.
        for (x, degrees, expected) in [
            (3.841458820694124, 1, 0.05),
            (5.991464547107979, 2, 0.05),
            (7.814727903251179, 3, 0.05),
            (9.487729036781154, 4, 0.05),
            (11.070497693516351, 5, 0.05),
            (12.591587243743977, 6, 0.05),
            (0.351846317749271, 3, 0.95),
            (16.26623619623813, 3, 0.001),
            (22.457744484825323, 6, 0.001),
            (2.0 * 40.0, 2, (-40f64).exp()),
            (2.0 * 300.0, 6, (-300f64).exp() * (1.0 + 300.0 + 45_000.0)),
        ] {
            let found = survival(x, degrees);
            assert!(
                (found / expected - 1.0).abs() < 1e-9,
                "{x} {degrees}: {found}, not {expected}"
            );
        }
        assert_eq!([survival(0.0, 3), survival(-1.0, 3), survival(5.0, 0)], [1.0; 3]);
        assert_eq!([2, 3, 6].map(|k| survival(f64::INFINITY, k)), [0.0; 3]);
        assert_eq!(survival(1e5, 5), 0.0);
        assert!(survival(f64::NAN, 6).is_nan());
    }

    #[test]
    fn both_ways_to_the_error_function_meet() {
        let (below, above) = (erfc(2.0 - 1e-13), erfc(2.0));
        assert!((below / above - 1.0).abs() < 1e-11, "{below} {above}");
        assert!((above / 0.004_677_734_981_047_266 - 1.0).abs() < 1e-12);
    }
}
