//! The exponential function on vectors.

use super::simd::Simd;

/// Arguments above this count as this: the result is 3·10⁻³⁰⁸ where it should be smaller still.
const MOST: f64 = 708.0;

/// 1.5·2⁵²: adding it rounds a number to an integer, held in the lowest bits of the sum.
const SHIFT: f64 = 6_755_399_441_055_744.0;

/// ln 2 in two parts; the first has 32 bits, so that its product with any exponent is exact.
const LN_2: [f64; 2] = [0.693_147_180_601_954_5, -4.200_915_072_681_084_6e-11];

/// Interpolates exp(−r) at the Chebyshev nodes of |r| ≤ ln 2 / 2, within 1.7·10⁻¹⁷ relative: the
/// coefficients of even and of odd powers.
const POLYNOMIAL: [[f64; 2]; 6] = [
    [1.0, -1.0],
    [0.5000000000000019, -0.1666666666666668],
    [0.04166666666648795, -0.008333333333319589],
    [0.0013888888952352863, -0.00019841269890076403],
    [2.4801485441561313e-05, -2.755724088722987e-06],
    [2.763265472252779e-07, -2.5110049204818658e-08],
];

/// exp(−u) for u ≥ 0, within 5·10⁻¹⁶ relative up to [`MOST`]; NaN stays NaN. Even and odd powers
/// are summed side by side: one sum would wait for eleven products in turn.
#[inline(always)]
pub(super) fn decay<S: Simd, const G: usize>(s: S, u: [S::Vector; G]) -> [S::Vector; G] {
    let mut found = u;
    for g in 0..G {
        let u = s.at_most(u[g], s.splat(MOST));
        let shifted = s.mul_sub(u, s.splat(std::f64::consts::LOG2_E), s.splat(SHIFT));
        let n = s.sub(shifted, s.splat(SHIFT));
        let r = s.mul_add(n, s.splat(LN_2[0]), u);
        let r = s.mul_add(n, s.splat(LN_2[1]), r);
        let square = s.mul(r, r);
        let [mut even, mut odd] = POLYNOMIAL[5].map(|c| s.splat(c));
        for [a, b] in POLYNOMIAL[..5].iter().rev() {
            even = s.mul_add(even, square, s.splat(*a));
            odd = s.mul_add(odd, square, s.splat(*b));
        }
        found[g] = s.times_power(s.mul_add(odd, r, even), shifted);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Instructions, Work, run_with};
    use super::*;

    struct Decay<'a>(&'a [f64], &'a mut [f64]);

    impl Work for Decay<'_> {
        type Output = ();
        #[inline(always)]
        fn with<S: Simd>(self, s: S) {
            for (x, y) in self.0.chunks_exact(S::LANES).zip(self.1.chunks_exact_mut(S::LANES)) {
                let [e] = decay(s, [s.load(x)]);
                s.store(e, y);
            }
        }
    }

    #[test]
    fn agrees_with_the_standard_library_on_every_path() {
        let x: Vec<f64> =
            (0..200_000).map(|i| 708.0 * (f64::from(i) / 199_999.0).powi(3)).collect();
        for most in [Instructions::Portable, Instructions::Avx2, Instructions::Avx512] {
            let mut y = vec![0.0; x.len()];
            run_with(most, Decay(&x, &mut y));
            for (x, y) in x.iter().zip(y) {
                assert!((y / (-x).exp() - 1.0).abs() < 1e-15, "{most:?}: exp −{x} = {y:e}");
            }
        }
    }

    #[test]
    fn the_ends_are_decided() {
        for most in [Instructions::Portable, Instructions::Avx2, Instructions::Avx512] {
            let x = [0.0, -0.0, f64::INFINITY, f64::NAN, 1e9, 1e-300, 708.0, 1.0];
            let mut y = [7.0; 8];
            run_with(most, Decay(&x, &mut y));
            assert_eq!((y[0], y[1], y[5]), (1.0, 1.0, 1.0));
            assert!(y[2] < 1e-307 && y[4] < 1e-307 && y[3].is_nan(), "{most:?}: {y:?}");
        }
    }
}
