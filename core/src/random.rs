//! The filter's random numbers: xoshiro128++ with a normal distribution of our own, so that a seed
//! gives the same particles on every target.

use rand_xoshiro::Xoshiro128PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::math;
use crate::matrix::Coordinates;

/// A seeded generator.
#[derive(Clone, Debug)]
pub struct Random {
    generator: Xoshiro128PlusPlus,
}

impl Random {
    /// The generator of this seed.
    pub fn new(seed: u64) -> Self {
        Random { generator: Xoshiro128PlusPlus::seed_from_u64(seed) }
    }

    /// Uniform in (0, 1), on a grid of 2⁻²³ offset by half a step.
    pub fn uniform(&mut self) -> f32 {
        ((self.generator.next_u32() >> 9) as f32 + 0.5) * (1.0 / 8_388_608.0)
    }

    /// Two independent standard normal numbers (Box–Muller: no rejection, so bounded time).
    pub fn normal_pair(&mut self) -> (f32, f32) {
        let radius = math::sqrt(-2.0 * math::ln(self.uniform()));
        let (sin, cos) = math::sin_cos(core::f32::consts::TAU * self.uniform());
        (radius * cos, radius * sin)
    }

    /// A vector of independent standard normal numbers.
    pub fn normal<V: Coordinates>(&mut self) -> V {
        let mut v = V::ZERO;
        let mut i = 0;
        while i < V::LEN {
            let (a, b) = self.normal_pair();
            v[i] = a;
            if i + 1 < V::LEN {
                v[i + 1] = b;
            }
            i += 2;
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;

    #[test]
    fn normal_has_its_moments_and_repeats() {
        let mut random = Random::new(7);
        let (mut sum, mut square, mut fourth) = (0.0f64, 0.0f64, 0.0f64);
        let n = 100_000;
        for _ in 0..n {
            let v: Vector<3> = random.normal();
            let x = v[2] as f64;
            sum += x;
            square += x * x;
            fourth += x * x * x * x;
        }
        let n = n as f64;
        assert!((sum / n).abs() < 0.01 && (square / n - 1.0).abs() < 0.02);
        assert!((fourth / n - 3.0).abs() < 0.15);
        assert_eq!(Random::new(3).normal_pair(), Random::new(3).normal_pair());
        assert_ne!(Random::new(3).uniform(), Random::new(4).uniform());
    }
}
