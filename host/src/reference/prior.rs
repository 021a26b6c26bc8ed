//! What the field is believed to be before any contact.

use nalgebra::{Matrix4, Vector4};

use super::gpis::Error;
use super::{Contact, Ellipsoid};
use crate::space::{Point, centroid};

/// Mean of the Gaussian process before data (thesis 2.18–2.20; the sign of 2.18 corrected: what is
/// subtracted from the targets is added to the prediction).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// The same value everywhere, metres; its gradient is zero.
    Constant(f64),
    /// (|p − c|²/R − R)/2: zero on the circle or sphere, gradient of length one there, growing
    /// away from the object, so that a pose that drifts off is punished.
    Ball {
        /// c, metres.
        centre: Point,
        /// R, metres.
        radius: f64,
    },
    /// A quadric that vanishes on an ellipsoid or ellipse.
    Ellipsoid(Ellipsoid),
}

impl Prior {
    /// Least radius of a ball about contacts that do not say how large their object is, metres; and, up to
    /// half of what they say, of a ball that fits them.
    pub const LEAST_RADIUS: f64 = 0.005;

    /// Mean distance from their middle up to which points are one: metres, and deviations of contacts.
    const ONE: (f64, f64) = (1e-6, 5.0);

    /// The ball about contact points: centred in their bounding box, its radius their mean distance
    /// from that centre; [`Prior::LEAST_RADIUS`] where all are one point. `None` without points.
    pub fn about(points: impl IntoIterator<Item = Point>) -> Option<Prior> {
        let (centre, mean) = middle(points)?;
        Some(Prior::Ball { centre, radius: Self::sized(mean, Self::ONE.0) })
    }

    /// Radius of the ball about points at that mean distance from their middle, which are `one` up to there.
    fn sized(mean: f64, one: f64) -> f64 {
        if mean > one { mean } else { mean.max(Self::LEAST_RADIUS) }
    }

    /// Mean distance up to which contacts are one.
    fn one(contacts: &[Contact]) -> f64 {
        let exact = contacts.iter().map(|c| c.point_deviation).fold(f64::INFINITY, f64::min);
        Self::ONE.0.max(Self::ONE.1 * exact)
    }

    /// Whether contacts are so near to each other that they do not say how large their object is.
    pub(super) fn are_one(contacts: &[Contact]) -> bool {
        middle(contacts.iter().map(|c| c.point)).is_none_or(|(_, mean)| mean <= Self::one(contacts))
    }

    /// The least radius beside one that contacts say, so that small objects are as large ones are.
    pub(super) fn least_radius(radius: f64) -> f64 {
        Self::LEAST_RADIUS.min(0.5 * radius)
    }

    /// The ball that fits contacts best: in least squares pᵢ ≈ c + R·nᵢ over those with a normal,
    /// solved as a linear system. Where the normals spread too little to decide it (mean squared
    /// distance from their mean below 0.2), or the radius comes out below [`Prior::LEAST_RADIUS`] and half of
    /// theirs, the ball [`about`](Prior::about) the points, which are one within five deviations of
    /// the most exact. `None` without contacts.
    pub fn fitted(contacts: &[Contact]) -> Option<Prior> {
        let (centre, mean) = middle(contacts.iter().map(|c| c.point))?;
        let radius = Self::sized(mean, Self::one(contacts));
        let felt: Vec<(Point, Point)> =
            contacts.iter().filter_map(|c| Some((c.point, c.normal?))).collect();
        // Unknowns (c, R); rows cₐ + R nₐ = pₐ for each axis a.
        let mut normal_matrix = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (point, normal) in &felt {
            for axis in 0..3 {
                let mut row = Vector4::zeros();
                row[axis] = 1.0;
                row[3] = normal[axis];
                normal_matrix += row * row.transpose();
                right += row * point[axis];
            }
        }
        let usual = centroid(felt.iter().map(|f| f.1));
        let spread = felt.iter().map(|f| (f.1 - usual).norm_squared()).sum::<f64>();
        let solution = normal_matrix.lu().solve(&right);
        match solution {
            Some(x)
                if felt.len() > 1
                    && spread > 0.2 * felt.len() as f64
                    && x[3] > Self::least_radius(radius) =>
            {
                Some(Prior::Ball { centre: x.xyz(), radius: x[3] })
            }
            _ => Some(Prior::Ball { centre, radius }),
        }
    }

    /// The ellipsoid (ellipse, when `dimension` is 2) that fits contacts best,
    /// [`Ellipsoid::fitted`]; where they do not decide one, the ball of [`fitted`](Prior::fitted).
    /// `None` without contacts.
    pub fn ellipsoid(dimension: usize, contacts: &[Contact]) -> Option<Prior> {
        let ellipsoid = Ellipsoid::fitted(dimension, contacts).map(Prior::Ellipsoid);
        ellipsoid.or_else(|| Prior::fitted(contacts))
    }

    /// Refuses parameters that are not finite, a radius that is not positive, or an ellipsoid that
    /// is none.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the parameter and its value.
    pub fn check(&self) -> Result<(), Error> {
        let bad = |name, value| Err(Error::Parameter { name, value });
        match self {
            Prior::Constant(value) if !value.is_finite() => bad("prior value", *value),
            Prior::Ball { centre, .. } if !centre.norm().is_finite() => {
                bad("distance of the prior's centre", centre.norm())
            }
            Prior::Ball { radius, .. } if !(*radius > 0.0 && radius.is_finite()) => {
                bad("prior radius", *radius)
            }
            Prior::Ellipsoid(e) if !(e.height > 0.0 && e.height.is_finite()) => {
                bad("height of the prior's ellipsoid", e.height)
            }
            Prior::Ellipsoid(e) if !e.centre.norm().is_finite() => {
                bad("distance of the prior's centre", e.centre.norm())
            }
            Prior::Ellipsoid(e)
                if !(e.curvature.norm() > 0.0 && e.curvature.norm().is_finite()) =>
            {
                bad("curvature of the prior's ellipsoid", e.curvature.norm())
            }
            _ => Ok(()),
        }
    }

    /// Value at `p`, metres.
    pub fn value(&self, p: &Point) -> f64 {
        match self {
            Prior::Constant(value) => *value,
            Prior::Ball { centre, radius } => 0.5 * ((p - centre).norm_squared() / radius - radius),
            Prior::Ellipsoid(ellipsoid) => ellipsoid.value(p),
        }
    }

    /// Gradient at `p`.
    pub fn gradient(&self, p: &Point) -> Point {
        match self {
            Prior::Constant(_) => Point::zeros(),
            Prior::Ball { centre, radius } => (p - centre) / *radius,
            Prior::Ellipsoid(ellipsoid) => ellipsoid.gradient(p),
        }
    }
}

/// Middle of the bounding box of points, and their mean distance from it.
fn middle(points: impl IntoIterator<Item = Point>) -> Option<(Point, f64)> {
    let points: Vec<Point> = points.into_iter().collect();
    let first = points.first()?;
    let low = points.iter().fold(*first, |low, p| low.inf(p));
    let high = points.iter().fold(*first, |high, p| high.sup(p));
    let centre = (low + high) / 2.0;
    let mean = points.iter().map(|p| (p - centre).norm()).sum::<f64>() / points.len() as f64;
    Some((centre, mean))
}
