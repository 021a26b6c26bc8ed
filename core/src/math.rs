//! The scalar functions of the core: one definition for every target, so that results agree to the
//! last bit. `sqrt` is correctly rounded everywhere; the others are polynomials in `f32` without
//! fused multiply-add, accurate to a few units in the last place, without tables or branches that
//! would keep a compiler from vectorising them.

use core::f32::consts::{FRAC_PI_2, LN_2, LOG2_E, PI};

/// Square root, correctly rounded; NaN for a negative number.
///
/// One instruction on Cortex-M4F and x86-64, where a compiler may also vectorise it;
/// `libm::sqrtf` (55 instructions on a Cortex-M4F) elsewhere.
#[inline(always)]
pub fn sqrt(x: f32) -> f32 {
    square_root::sqrt(x)
}

#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
#[allow(unsafe_code)]
mod square_root {
    /// The FPU's `vsqrt.f32`. The value passes through a core register because stable compilers
    /// refuse single-precision register operands on single-precision FPUs.
    #[inline(always)]
    pub fn sqrt(x: f32) -> f32 {
        let mut bits = x.to_bits();
        // SAFETY: three register moves and a square root; `s0` is declared clobbered, memory, stack
        // and condition flags are untouched, and every bit pattern is a valid operand and result.
        unsafe {
            core::arch::asm!(
                "vmov s0, {bits}",
                "vsqrt.f32 s0, s0",
                "vmov {bits}, s0",
                bits = inout(reg) bits,
                out("s0") _,
                options(pure, nomem, nostack, preserves_flags)
            );
        }
        f32::from_bits(bits)
    }
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod square_root {
    use core::arch::x86_64::{_mm_cvtss_f32, _mm_set_ss, _mm_sqrt_ss};

    #[inline(always)]
    pub fn sqrt(x: f32) -> f32 {
        // SAFETY: the intrinsics touch registers only and need SSE, which is part of the x86-64
        // baseline.
        unsafe { _mm_cvtss_f32(_mm_sqrt_ss(_mm_set_ss(x))) }
    }
}

#[cfg(not(any(target_arch = "x86_64", all(target_arch = "arm", target_abi = "eabihf"))))]
mod square_root {
    pub use libm::sqrtf as sqrt;
}

/// The smaller of two numbers; the second when either is NaN. (`f32::min` spends twice the
/// instructions on NaN.)
#[inline(always)]
pub fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger of two numbers; the second when either is NaN.
#[inline(always)]
pub fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Adding this to a number below 2²² rounds it to the nearest integer, which then stands in the
/// lowest bits: 1.5 · 2²³.
const ROUND: f32 = 12_582_912.0;

/// eˣ for x ≤ 88, relative error below 2·10⁻⁷; below −87 it stays at e⁻⁸⁷ ≈ 1.6·10⁻³⁸ rather than
/// reach zero. (Cody–Waite reduction and Cephes' polynomial.)
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let [y] = decays([-min(max(x, -87.0), 88.0)]);
    y
}

/// e⁻ᵘ, the bits of [`exp`], of several numbers u from −88 to 87 together.
#[inline(always)]
pub fn decays<const N: usize>(u: [f32; N]) -> [f32; N] {
    const FIRST: f32 = 1.987_569_1e-4;
    const REST: [f32; 5] = [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5];
    let shifted = u.map(|u| ROUND - u * LOG2_E);
    let halvings = shifted.map(|shifted| ROUND - shifted);
    let r: [f32; N] = core::array::from_fn(|k| halvings[k] * 0.693_359_4 - u[k]);
    let r: [f32; N] = core::array::from_fn(|k| r[k] - halvings[k] * 2.121_944_4e-4);
    let mut p = [FIRST; N];
    for coefficient in REST {
        p = core::array::from_fn(|k| p[k] * r[k] + coefficient);
    }
    let y: [f32; N] = core::array::from_fn(|k| p[k] * (r[k] * r[k]) + r[k] + 1.0);
    core::array::from_fn(|k| {
        let n = shifted[k].to_bits().wrapping_sub(ROUND.to_bits());
        f32::from_bits(y[k].to_bits().wrapping_add(n << 23))
    })
}

/// Natural logarithm of a positive normal number, absolute error below 2·10⁻⁷ + 1.5·10⁻⁷·|ln x|; minus
/// infinity for zero, negative and subnormal numbers and NaN.
#[inline]
pub fn ln(x: f32) -> f32 {
    if !(x >= f32::MIN_POSITIVE) {
        return f32::NEG_INFINITY;
    }
    if x == f32::INFINITY {
        return x;
    }
    // x = m · 2ᵉ with m in [√½, √2); ln m by the series of atanh.
    let bits = x.to_bits().wrapping_sub(0x3f35_04f3);
    let e = (bits as i32) >> 23;
    let m = f32::from_bits((bits & 0x007f_ffff) + 0x3f35_04f3);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let p = z * (1.0 / 9.0) + 1.0 / 7.0;
    let p = p * z + 0.2;
    let p = p * z + 1.0 / 3.0;
    let log = 2.0 * (s + s * z * p);
    e as f32 * LN_2 + log
}

/// Largest angle that [`sin_cos`] knows, radians.
pub const LARGEST_ANGLE: f32 = 1e5;

/// Sine and cosine of an angle in radians, absolute error below 2·10⁻⁷ for |x| ≤ 100 and growing in
/// proportion to |x| after that; (0, 1) when the angle is not finite or larger than [`LARGEST_ANGLE`].
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    if !(-LARGEST_ANGLE..=LARGEST_ANGLE).contains(&x) {
        return (0.0, 1.0);
    }
    let shifted = x * (2.0 / PI) + ROUND;
    let quadrant = shifted.to_bits() & 3;
    let whole = shifted - ROUND;
    // π/2 in three parts, the first two with trailing zero bits so that the products are exact.
    let r = x - whole * 1.570_312_5;
    let r = r - whole * 4.837_513e-4;
    let r = r - whole * 7.549_79e-8;
    let z = r * r;
    let s = -1.951_529_6e-4 * z + 8.332_161e-3;
    let s = s * z - 1.666_665_5e-1;
    let s = s * z * r + r;
    let c = 2.443_315_7e-5 * z - 1.388_731_6e-3;
    let c = c * z + 4.166_664_6e-2;
    let c = c * z * z - 0.5 * z + 1.0;
    match quadrant {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// The angle of the point (x, y) in (−π, π], absolute error below 4·10⁻⁷; 0 for the origin and
/// when a coordinate is NaN.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (large, small) = if ax > ay { (ax, ay) } else { (ay, ax) };
    if !(large > 0.0 && small >= 0.0) || large == f32::INFINITY {
        return 0.0;
    }
    let t = small / large;
    // atan on [0, tan π/8], the rest by atan t = π/4 + atan((t−1)/(t+1)).
    let (base, t) = if t > 0.414_213_57 {
        (core::f32::consts::FRAC_PI_4, (t - 1.0) / (t + 1.0))
    } else {
        (0.0, t)
    };
    let z = t * t;
    let p = 8.053_744_5e-2 * z - 1.387_768_6e-1;
    let p = p * z + 1.997_771e-1;
    let p = p * z - 3.333_295e-1;
    let angle = base + (p * z * t + t);
    let angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

/// The standard normal density at `z`, and the distribution function there (absolute error below
/// 10⁻⁶; Abramowitz and Stegun 26.2.17).
pub fn normal(z: f32) -> (f32, f32) {
    let density = 0.398_942_3 * exp(-0.5 * z * z);
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let tail = density
        * t
        * (0.319_381_53
            + t * (-0.356_563_78 + t * (1.781_477_9 + t * (-1.821_256 + t * 1.330_274_4))));
    (density, if z < 0.0 { tail } else { 1.0 - tail })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn exp_is_close(x in -86.9f32..87.9) {
            let want = (x as f64).exp();
            prop_assert!((exp(x) as f64 / want - 1.0).abs() < 2e-7 + 1e-9 * x.abs() as f64);
        }
        #[test]
        fn ln_is_close(e in -37.0f32..38.0) {
            let x = 10f32.powf(e);
            let want = (x as f64).ln();
            prop_assert!((ln(x) as f64 - want).abs() < 2e-7 + 1.5e-7 * want.abs());
        }
        #[test]
        fn sin_cos_is_close(x in -100.0f32..100.0) {
            let (s, c) = sin_cos(x);
            prop_assert!((s as f64 - (x as f64).sin()).abs() < 2e-7, "{} {}", s, (x as f64).sin());
            prop_assert!((c as f64 - (x as f64).cos()).abs() < 2e-7);
        }
        #[test]
        fn atan2_is_close(y in -3.0f32..3.0, x in -3.0f32..3.0) {
            prop_assert!((atan2(y, x) as f64 - (y as f64).atan2(x as f64)).abs() < 4e-7);
        }
    }

    #[test]
    fn edges_are_decided() {
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(f32::NEG_INFINITY) < 1e-37 && exp(f32::INFINITY).is_finite());
        assert!(exp(f32::NAN).is_finite());
        assert_eq!(decays([0.0, 1.7, 86.9]), [1.0, exp(-1.7), exp(-86.9)]);
        assert_eq!(ln(1.0), 0.0);
        assert_eq!(ln(0.0), f32::NEG_INFINITY);
        assert_eq!(ln(f32::NAN), f32::NEG_INFINITY);
        assert_eq!(ln(f32::INFINITY), f32::INFINITY);
        assert_eq!(sin_cos(f32::NAN), (0.0, 1.0));
        assert_eq!(sin_cos(f32::INFINITY), (0.0, 1.0));
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert_eq!((atan2(f32::NAN, 1.0), atan2(1.0, f32::NAN)), (0.0, 0.0));
        assert!((atan2(0.0, -1.0) - PI).abs() < 1e-6);
        assert!(sqrt(-1.0).is_nan());
    }
}
