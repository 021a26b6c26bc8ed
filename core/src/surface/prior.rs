//! Prior means: what a surface model believes where nothing was touched.

mod ellipsoid;
mod shape;

pub use ellipsoid::Ellipsoid;
pub use shape::{Polytope, Shape, SignedDistance};

use crate::matrix::Coordinates;
use crate::space::Space;

/// A prior mean with its gradient.
pub trait Prior<S: Space>: Copy + Send + Sync + 'static {
    /// All zero bits, so that a model can live in `.bss`; before it is fitted or set.
    const UNSET: Self;

    /// Mean of f (metres) and of ∇f at `point` (object frame, metres).
    fn mean(&self, point: S::Vector) -> (f32, S::Vector);

    /// Slopes of ∇f at `point`, one row per axis (per metre): by central differences unless the prior
    /// knows better.
    fn curvature(&self, point: S::Vector) -> [S::Vector; 3] {
        const STEP: f32 = 1e-3;
        let mut rows = [S::Vector::ZERO; 3];
        for axis in 0..S::DIMENSION {
            let mut step = S::Vector::ZERO;
            step[axis] = STEP;
            let rise = self.mean(point + step).1 - self.mean(point - step).1;
            rows[axis] = rise * (0.5 / STEP);
        }
        rows
    }

    /// How badly the mean interpolates: as [`Kernel::interpolation`](super::Kernel::interpolation),
    /// the largest errors themselves. Infinite where nothing is known.
    fn interpolation(&self, _spread: f32) -> (f32, f32) {
        (f32::INFINITY, f32::INFINITY)
    }

    /// The prior that fits contacts best, given as points (metres) with their unit normals where
    /// known; there may be none.
    fn fitted(
        &self,
        contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self;
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

    fn interpolation(&self, _spread: f32) -> (f32, f32) {
        (0.0, 0.0)
    }

    fn fitted(
        &self,
        _contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self {
        *self
    }
}

/// A circle or sphere: (|p − c|²/R − R)/2, which has slope one on the surface. Thesis 2.18–2.20 with
/// equal axes and h = R.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball<S: Space> {
    /// c, metres.
    pub centre: S::Vector,
    /// R, metres; 0, as before it is fitted, for f = 0 everywhere.
    pub radius: f32,
}

impl<S: Space> Ball<S> {
    /// Radii below this would make the prior's curvature rule the surface: 5 mm.
    pub const LEAST_RADIUS: f32 = 0.005;

    /// Normals that spread less than this (mean squared distance from their mean; 1 when they point
    /// everywhere) do not say how far away the centre is.
    const LEAST_SPREAD: f32 = 0.2;

    /// The ball whose surface has these points with these normals, in least squares: pᵢ ≈ c + R·nᵢ
    /// is linear in c and R. `None` when the normals do not decide it.
    fn through(pairs: impl Iterator<Item = (S::Vector, S::Vector)> + Clone) -> Option<Self> {
        let (mut point, mut normal, mut count) = (S::Vector::ZERO, S::Vector::ZERO, 0.0);
        for (p, n) in pairs.clone() {
            point += p;
            normal += n;
            count += 1.0;
        }
        if count < 2.0 {
            return None;
        }
        (point, normal) = (point * (1.0 / count), normal * (1.0 / count));
        let (mut covariance, mut spread) = (0.0, 0.0);
        for (p, n) in pairs {
            covariance += (p - point).dot(n - normal);
            spread += (n - normal).norm_squared();
        }
        let radius = covariance / spread;
        (spread > Self::LEAST_SPREAD * count && radius > Self::LEAST_RADIUS)
            .then(|| Ball { centre: point - normal * radius, radius })
    }

    /// `what` by the radius.
    #[inline(always)]
    fn over_radius(&self, what: f32) -> f32 {
        if self.radius > 0.0 { what / self.radius } else { 0.0 }
    }

    /// Centre of the bounding box and mean distance to it.
    fn around(points: impl Iterator<Item = S::Vector> + Clone) -> Self {
        let Some(first) = points.clone().next() else {
            return Ball { centre: S::Vector::ZERO, radius: Self::LEAST_RADIUS };
        };
        let (mut low, mut high) = (first, first);
        for p in points.clone() {
            for i in 0..S::DIMENSION {
                low[i] = low[i].min(p[i]);
                high[i] = high[i].max(p[i]);
            }
        }
        let centre = (low + high) * 0.5;
        let (mut sum, mut count) = (0.0, 0.0);
        for p in points {
            sum += (p - centre).norm();
            count += 1.0;
        }
        Ball { centre, radius: (sum / count).max(Self::LEAST_RADIUS) }
    }
}

impl<S: Space> Prior<S> for Ball<S> {
    const UNSET: Self = Ball { centre: S::Vector::ZERO, radius: 0.0 };

    #[inline(always)]
    fn mean(&self, point: S::Vector) -> (f32, S::Vector) {
        let d = point - self.centre;
        let curvature = self.over_radius(1.0);
        (0.5 * (d.norm_squared() * curvature - self.radius), d * curvature)
    }

    fn curvature(&self, _point: S::Vector) -> [S::Vector; 3] {
        let mut rows = [S::Vector::ZERO; 3];
        for axis in 0..S::DIMENSION {
            rows[axis][axis] = self.over_radius(1.0);
        }
        rows
    }

    /// Of a square; its gradient is linear.
    fn interpolation(&self, spread: f32) -> (f32, f32) {
        (self.over_radius(0.5 * spread * spread), 0.0)
    }

    /// The least-squares ball through points and normals; where the normals do not decide it (a
    /// single face, a concavity), the centre of the bounding box and the mean distance to it.
    fn fitted(
        &self,
        contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self {
        let pairs = contacts.clone().filter_map(|(p, n)| Some((p, n?)));
        Self::through(pairs).unwrap_or_else(|| Self::around(contacts.map(|(p, _)| p)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;
    use core::f32::consts::PI;

    type Felt = (Vector<2>, Option<Vector<2>>);

    fn fitted(contacts: &[Felt]) -> Ball<Planar> {
        Ball::<Planar>::UNSET.fitted(contacts.iter().copied())
    }

    /// On a circle of 30 mm about (0.1, 0).
    fn on_circle(angle: f32) -> Felt {
        let n = Vector([angle.cos(), angle.sin()]);
        (n * 0.03 + Vector([0.1, 0.0]), Some(n))
    }

    #[test]
    fn normals_find_a_ball_from_one_side() {
        let ball = fitted(&[on_circle(0.0), on_circle(0.8), on_circle(1.6)]);
        assert!((ball.radius - 0.03).abs() < 1e-6);
        assert!((ball.centre - Vector([0.1, 0.0])).norm() < 1e-6);
        let (value, slope) = ball.mean(Vector([0.1301, 0.0]));
        assert!((value - 1e-4).abs() < 1e-6 && (slope.norm() - 1.0).abs() < 0.01);
    }

    #[test]
    fn undecided_normals_leave_it_to_the_points() {
        let bare = [0.0, 0.5, 1.0, 1.5].map(|half| (on_circle(half * PI).0, None));
        assert!((fitted(&bare).radius - 0.03).abs() < 1e-5);
        // One flat face, and a concave corner.
        let up = Some(Vector([0.0, 1.0]));
        let flat = fitted(&[(Vector([-0.02, 0.0]), up), (Vector([0.02, 0.0]), up)]);
        assert!((flat.radius - 0.02).abs() < 1e-6 && flat.centre.norm() < 1e-6);
        let concave = [
            (on_circle(0.0).0, Some(Vector([-1.0, 0.0]))),
            (on_circle(PI).0, Some(Vector([1.0, 0.0]))),
        ];
        assert!((fitted(&concave).radius - 0.03).abs() < 1e-4);
        assert_eq!(fitted(&[]).radius, Ball::<Planar>::LEAST_RADIUS);
    }
}
