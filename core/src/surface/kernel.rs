//! Isotropic covariance functions, with the derivatives that gradient observations need.
//!
//! For d = p − q and r = |d| a kernel gives k(r), a = k′/r and b = (k″ − k′/r)/r², from which
//!
//! ```text
//! cov(f(p), f(q))       = k
//! cov(∂ᵢf(p), f(q))     = a dᵢ
//! cov(f(p), ∂ⱼf(q))     = −a dⱼ
//! cov(∂ᵢf(p), ∂ⱼf(q))   = −(b dᵢ dⱼ + a δᵢⱼ)
//! ```

use crate::math;

/// A covariance function of the distance.
pub trait Kernel: Copy + Send + Sync + 'static {
    /// All zero bits, so that a model can live in `.bss`; not a kernel to work with.
    const UNSET: Self;

    /// Whether k alone takes much less than k and a.
    const IS_CHEAPER_ALONE: bool = false;

    /// k, a and b at the squared distance `r2` (square metres).
    fn radial(&self, r2: f32) -> Radial;

    /// The same at several distances together, which a processor with a pipeline finds easier.
    #[inline(always)]
    fn radials<const N: usize>(&self, r2: [f32; N]) -> [Radial; N] {
        r2.map(|r2| self.radial(r2))
    }

    /// k alone, the same bits.
    fn value(&self, r2: f32) -> f32;

    /// The same at several distances together.
    #[inline(always)]
    fn values<const N: usize>(&self, r2: [f32; N]) -> [f32; N] {
        r2.map(|r2| self.value(r2))
    }

    /// b′/r at the squared distance `r2`, with which ∇f has slopes (per metre to the fourth).
    fn third(&self, r2: f32) -> f32;

    /// [`radials`](Self::radials), each with [`third`](Self::third).
    #[inline(always)]
    fn radials_and_thirds<const N: usize>(&self, r2: [f32; N]) -> [(Radial, f32); N] {
        r2.map(|r2| (self.radial(r2), self.third(r2)))
    }

    /// Variance of f: k(0), square metres.
    fn variance(&self) -> f32;

    /// Variance of each component of ∇f: −a(0), no unit.
    fn slope_variance(&self) -> f32;

    /// The same kernel with amplitude and lengths this many times as large: what the kernel is when
    /// its numbers were multiples of `unit` metres.
    fn scaled(&self, unit: f32) -> Self;

    /// The same kernel with the amplitude this many times as large: how far the surface strays from its
    /// prior mean.
    fn rougher(&self, factor: f32) -> Self;

    /// How badly functions of this kernel interpolate. A point x that is the mean of random points X
    /// with E|X − x|² ≤ `spread`² (metres) has |E f(X) − f(x)| ≤ value·‖f‖ and
    /// |E ∇f(X) − ∇f(x)| ≤ gradient·‖f‖, with ‖f‖ the norm in the kernel's space.
    ///
    /// By Cauchy and Schwarz the first is the length of E[k_X − k_x − ∇k_x·(X − x)], whose linear part
    /// is zero, and with r = |X − x| a single one has the square 2 (k(0) − k(r) + a r²) − a(0) r²; the
    /// second is that of E[∂k_X − ∂k_x], at most 2 (−a(0) + max(a, a + b r²)) squared, or with a linear
    /// part taken off where ∇f has slopes. In the spectrum, with θ = ω·(X − x), they are
    /// E |e^{iθ} − 1 − iθ|² ≤ E θ⁴/4, and the same times ω² for the gradient. Each kernel bounds these
    /// by powers of r whose roots are concave in r², so that the mean comes under them.
    fn interpolation(&self, spread: f32) -> (f32, f32);
}

/// A kernel at one distance; see the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radial {
    /// k, square metres.
    pub k: f32,
    /// k′/r, no unit.
    pub a: f32,
    /// (k″ − k′/r)/r², per square metre.
    pub b: f32,
}

/// Distances are kept at least this far from zero (squared, square metres) where a kernel divides
/// by them: 1 µm.
const NEAR: f32 = 1e-12;
/// The same, not squared, metres.
const NEAREST: f32 = 1e-6;

/// s² exp(−r²/2ℓ²): thesis 2.15 in the standard form (its σ is √2·ℓ).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquaredExponential {
    /// Standard deviation s of f, metres.
    pub amplitude: f32,
    /// ℓ, metres.
    pub lengthscale: f32,
}

impl Kernel for SquaredExponential {
    const UNSET: Self = SquaredExponential { amplitude: 0.0, lengthscale: 0.0 };

    #[inline(always)]
    fn radial(&self, r2: f32) -> Radial {
        let k = self.value(r2);
        let w = 1.0 / (self.lengthscale * self.lengthscale);
        Radial { k, a: -k * w, b: k * w * w }
    }

    #[inline(always)]
    fn value(&self, r2: f32) -> f32 {
        let w = 1.0 / (self.lengthscale * self.lengthscale);
        self.amplitude * self.amplitude * math::exp(-0.5 * r2 * w)
    }

    #[inline(always)]
    fn third(&self, r2: f32) -> f32 {
        -self.radial(r2).b / (self.lengthscale * self.lengthscale)
    }

    fn scaled(&self, unit: f32) -> Self {
        SquaredExponential {
            amplitude: self.amplitude * unit,
            lengthscale: self.lengthscale * unit,
        }
    }

    fn rougher(&self, factor: f32) -> Self {
        SquaredExponential { amplitude: self.amplitude * factor, ..*self }
    }

    #[inline(always)]
    fn variance(&self) -> f32 {
        self.amplitude * self.amplitude
    }

    #[inline(always)]
    fn slope_variance(&self) -> f32 {
        self.variance() / (self.lengthscale * self.lengthscale)
    }

    /// E θ⁴/4 over the spectrum is 3 s²r⁴/4ℓ⁴, E ω²θ⁴/4 at most 15 s²r⁴/4ℓ⁶.
    fn interpolation(&self, spread: f32) -> (f32, f32) {
        let u2 = spread * spread / (self.lengthscale * self.lengthscale);
        let value = 0.5 * SQRT_3 * self.amplitude * u2;
        (value, SQRT_5 * value / self.lengthscale)
    }
}

/// s² (1 + u) e⁻ᵘ with u = √3 r/ℓ: once differentiable, the default. It follows corners better
/// than the smoother kernels and is the best conditioned of the three in `f32`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matern32 {
    /// Standard deviation s of f, metres.
    pub amplitude: f32,
    /// ℓ, metres.
    pub lengthscale: f32,
}

impl Kernel for Matern32 {
    const UNSET: Self = Matern32 { amplitude: 0.0, lengthscale: 0.0 };

    #[inline(always)]
    fn radial(&self, r2: f32) -> Radial {
        let [radial] = self.radials([r2]);
        radial
    }

    #[inline(always)]
    fn radials<const N: usize>(&self, r2: [f32; N]) -> [Radial; N] {
        let rate = SQRT_3 / self.lengthscale;
        // Positive numbers compare as their bits do, which are in a core register. Farther away e⁻⁸⁷ is left.
        let most = (87.0 / rate).to_bits();
        let r = r2.map(|r2| f32::from_bits(math::sqrt(r2).to_bits().min(most)));
        let u = r.map(|r| rate * r);
        let e = math::decays(u);
        let e = e.map(|e| self.amplitude * self.amplitude * e);
        let a = e.map(|e| -rate * rate * e);
        let k: [f32; N] = core::array::from_fn(|n| (1.0 + u[n]) * e[n]);
        core::array::from_fn(|n| {
            let b = -a[n] * rate / math::max(r[n], NEAREST);
            Radial { k: k[n], a: a[n], b }
        })
    }

    #[inline(always)]
    fn value(&self, r2: f32) -> f32 {
        self.radial(r2).k
    }

    #[inline(always)]
    fn values<const N: usize>(&self, r2: [f32; N]) -> [f32; N] {
        self.radials(r2).map(|radial| radial.k)
    }

    #[inline(always)]
    fn third(&self, r2: f32) -> f32 {
        let [(_, third)] = self.radials_and_thirds([r2]);
        third
    }

    #[inline(always)]
    fn radials_and_thirds<const N: usize>(&self, r2: [f32; N]) -> [(Radial, f32); N] {
        let rate = SQRT_3 / self.lengthscale;
        let radials = self.radials(r2);
        core::array::from_fn(|n| {
            let r2 = math::max(r2[n], NEAR);
            (radials[n], -radials[n].b * (rate * math::sqrt(r2) + 1.0) / r2)
        })
    }

    fn scaled(&self, unit: f32) -> Self {
        Matern32 { amplitude: self.amplitude * unit, lengthscale: self.lengthscale * unit }
    }

    fn rougher(&self, factor: f32) -> Self {
        Matern32 { amplitude: self.amplitude * factor, ..*self }
    }

    #[inline(always)]
    fn variance(&self) -> f32 {
        self.amplitude * self.amplitude
    }

    #[inline(always)]
    fn slope_variance(&self) -> f32 {
        3.0 * self.variance() / (self.lengthscale * self.lengthscale)
    }

    /// With u = √3 r/ℓ: 2 − 2(1 + u)e⁻ᵘ + u² − 2u²e⁻ᵘ ≤ 4u³/3, whose slope is
    /// 2u (1 − e⁻ᵘ + u e⁻ᵘ) ≤ 4u², and 1 − e⁻ᵘ (1 − u) ≤ 2u.
    fn interpolation(&self, spread: f32) -> (f32, f32) {
        let u = SQRT_3 / self.lengthscale * spread;
        let cube = math::sqrt(4.0 / 3.0 * u * u * u);
        (cube * self.amplitude, 2.0 * math::sqrt(self.slope_variance() * u))
    }
}

const SQRT_3: f32 = 1.732_050_8;
const SQRT_5: f32 = 2.236_068;

/// s² (2r³ − 3R r² + R³)/R³: thesis 2.17 with a *constant* range R. It is positive definite only
/// while every distance stays below R; keep R ≥ 1.5 times the diameter of the data and of the region
/// that is asked about, for the model's whole life.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinPlate {
    /// Standard deviation s of f, metres.
    pub amplitude: f32,
    /// R, metres.
    pub range: f32,
}

impl Kernel for ThinPlate {
    const UNSET: Self = ThinPlate { amplitude: 0.0, range: 0.0 };

    const IS_CHEAPER_ALONE: bool = true;

    #[inline(always)]
    fn radial(&self, r2: f32) -> Radial {
        let r = math::sqrt(math::max(r2, NEAR));
        // What depends on the kernel alone is worked out once outside a loop over contacts.
        let scale = self.amplitude * self.amplitude / (self.range * self.range * self.range);
        let k = self.amplitude * self.amplitude + scale * (r2 * (2.0 * r - 3.0 * self.range));
        Radial { k, a: 6.0 * scale * (r - self.range), b: 6.0 * scale / r }
    }

    #[inline(always)]
    fn value(&self, r2: f32) -> f32 {
        let [k] = self.values([r2]);
        k
    }

    #[inline(always)]
    fn values<const N: usize>(&self, r2: [f32; N]) -> [f32; N] {
        // The bits of `radial`: what it adds to r nearest to zero is lost in k.
        let r = r2.map(math::sqrt);
        let scale = self.amplitude * self.amplitude / (self.range * self.range * self.range);
        let bent = r.map(|r| 2.0 * r - 3.0 * self.range);
        let bent: [f32; N] = core::array::from_fn(|n| r2[n] * bent[n]);
        let bent = bent.map(|bent| scale * bent);
        bent.map(|bent| self.amplitude * self.amplitude + bent)
    }

    #[inline(always)]
    fn third(&self, r2: f32) -> f32 {
        let r2 = math::max(r2, NEAR);
        -self.radial(r2).b / r2
    }

    fn scaled(&self, unit: f32) -> Self {
        ThinPlate { amplitude: self.amplitude * unit, range: self.range * unit }
    }

    fn rougher(&self, factor: f32) -> Self {
        ThinPlate { amplitude: self.amplitude * factor, ..*self }
    }

    #[inline(always)]
    fn variance(&self) -> f32 {
        self.amplitude * self.amplitude
    }

    #[inline(always)]
    fn slope_variance(&self) -> f32 {
        6.0 * self.variance() / (self.range * self.range)
    }

    /// With v = r/R: 8v³ exactly, and at most 24v/R².
    fn interpolation(&self, spread: f32) -> (f32, f32) {
        let v = spread / self.range;
        let scale = self.amplitude / self.range;
        (math::sqrt(8.0 * v * v * v) * self.amplitude, math::sqrt(24.0 * v) * scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// a and b against central differences of k in double precision steps.
    fn check(kernel: impl Kernel, r: f32) -> Result<(), TestCaseError> {
        let h = 2e-3f32;
        let k = |x: f32| f64::from(kernel.value(x * x));
        let first = (k(r + h) - k(r - h)) / f64::from(2.0 * h);
        let second = (k(r + h) - 2.0 * k(r) + k(r - h)) / f64::from(h * h);
        let got = kernel.radial(r * r);
        let scale = f64::from(kernel.slope_variance());
        let r = f64::from(r);
        prop_assert!((f64::from(got.k) - k(r as f32)).abs() < 1e-6 * f64::from(kernel.variance()));
        prop_assert!((f64::from(got.a) - first / r).abs() < 0.01 * scale);
        prop_assert!((f64::from(got.b) * r * r - (second - first / r)).abs() < 0.03 * scale);
        let b = |x: f64| f64::from(kernel.radial((x * x) as f32).b);
        let third = (b(1.001 * r) - b(0.999 * r)) / (0.002 * r * r);
        let got_third = f64::from(kernel.third((r * r) as f32));
        prop_assert!((got_third / third - 1.0).abs() < 0.02, "{} {}", got_third, third);
        Ok(())
    }

    proptest! {
        #[test]
        fn derivatives_match(r in 0.02f32..0.2) {
            check(SquaredExponential { amplitude: 0.03, lengthscale: 0.1 }, r)?;
            check(Matern32 { amplitude: 0.03, lengthscale: 0.1 }, r)?;
            check(ThinPlate { amplitude: 0.1, range: 0.3 }, r)?;
        }
    }

    #[test]
    fn limits_at_zero() {
        let m = Matern32 { amplitude: 0.03, lengthscale: 0.1 };
        let at = m.radial(0.0);
        assert!((at.k - m.variance()).abs() < 1e-8);
        assert!((at.a + m.slope_variance()).abs() < 1e-4);
        assert!(at.b.is_finite());
        let far = m.radial(1e6);
        assert!(far.k >= 0.0 && far.k < 1e-30 && far.a.abs() < 1e-30 && far.b.abs() < 1e-30);
        assert!(ThinPlate { amplitude: 0.1, range: 0.3 }.radial(0.0).b.is_finite());
    }
}
