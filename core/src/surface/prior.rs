//! Prior means: what a surface model believes where nothing was touched.

use crate::matrix::Coordinates;
use crate::space::Space;

/// A prior mean with its gradient.
pub trait Prior<S: Space>: Copy + Send + Sync + 'static {
    /// All zero bits, so that a model can live in `.bss`.
    const UNSET: Self;

    /// Mean of f (metres) and of ∇f at `point` (object frame, metres).
    fn mean(&self, point: S::Vector) -> (f32, S::Vector);

    /// The prior that fits contact points best; `points` may be empty.
    fn fitted(&self, points: &[S::Vector]) -> Self;
}

/// The same value everywhere: positive says "outside unless told otherwise" (thesis figure 2.8b).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constant(
    /// f, metres.
    pub f32,
);

impl<S: Space> Prior<S> for Constant {
    const UNSET: Self = Constant(0.0);

    #[inline(always)]
    fn mean(&self, _point: S::Vector) -> (f32, S::Vector) {
        (self.0, S::Vector::ZERO)
    }

    fn fitted(&self, _points: &[S::Vector]) -> Self {
        *self
    }
}

/// A circle or sphere: (|p − c|²/R − R)/2, which has slope one on the surface. Thesis 2.18–2.20 with
/// equal axes and h = R.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball<S: Space> {
    /// c, metres.
    pub centre: S::Vector,
    /// R, metres.
    pub radius: f32,
}

impl<S: Space> Ball<S> {
    /// Radii below this would make the prior's curvature rule the surface: 5 mm.
    pub const LEAST_RADIUS: f32 = 0.005;
}

impl<S: Space> Prior<S> for Ball<S> {
    const UNSET: Self = Ball { centre: S::Vector::ZERO, radius: 0.0 };

    #[inline(always)]
    fn mean(&self, point: S::Vector) -> (f32, S::Vector) {
        let d = point - self.centre;
        let curvature = 1.0 / self.radius;
        (0.5 * (d.norm_squared() * curvature - self.radius), d * curvature)
    }

    /// Centre of the bounding box and mean distance to it.
    fn fitted(&self, points: &[S::Vector]) -> Self {
        let Some(&first) = points.first() else {
            return Ball { centre: S::Vector::ZERO, radius: Self::LEAST_RADIUS };
        };
        let (mut low, mut high) = (first, first);
        for p in points {
            for i in 0..S::DIMENSION {
                low[i] = low[i].min(p[i]);
                high[i] = high[i].max(p[i]);
            }
        }
        let centre = (low + high) * 0.5;
        let mut sum = 0.0;
        for p in points {
            sum += (*p - centre).norm();
        }
        Ball { centre, radius: (sum / points.len() as f32).max(Self::LEAST_RADIUS) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;

    #[test]
    fn ball_is_a_distance_near_its_surface() {
        let ball = Ball::<Planar>::UNSET.fitted(&[
            Vector([0.03, 0.0]),
            Vector([-0.03, 0.0]),
            Vector([0.0, 0.03]),
            Vector([0.0, -0.03]),
        ]);
        assert!((ball.radius - 0.03).abs() < 1e-7);
        let (value, slope) = ball.mean(Vector([0.0301, 0.0]));
        assert!((value - 1e-4).abs() < 1e-6 && (slope.norm() - 1.0).abs() < 0.01);
        assert_eq!(Ball::<Planar>::UNSET.fitted(&[]).radius, Ball::<Planar>::LEAST_RADIUS);
    }
}
