//! Skins by their parameters.

use std::f64::consts::{PI, TAU};

use crate::sim::random::Random;
use crate::space::Point;

/// A fingertip's skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Skin {
    /// Half axes along x, y, z, metres, about the origin.
    Ellipsoid([f64; 3]),
    /// A cylinder about x from −`length` to 0 with half a ball about the origin.
    Finger {
        /// Of both, metres.
        radius: f64,
        /// Of the cylinder, metres.
        length: f64,
    },
}

impl Skin {
    /// The skin of a BioTac.
    pub const BIOTAC: Skin = Skin::Finger { radius: 7e-3, length: 0.018 };

    /// Point and unit outward normal at `along` the skin and `around` it.
    ///
    /// On a finger `along` is the way over the skin from its very tip, metres, and `around` the
    /// angle from −z towards y. On an ellipsoid `along` is an angle from the end of x.
    pub fn at(&self, along: f64, around: f64) -> (Point, Point) {
        let (sin, cos) = around.sin_cos();
        match *self {
            Skin::Ellipsoid([a, b, c]) => {
                let (s, t) = along.sin_cos();
                let point = Point::new(a * t, b * s * sin, -c * s * cos);
                let by_along = Point::new(-a * s, b * t * sin, -c * t * cos);
                let by_around = Point::new(0.0, b * cos, c * sin);
                let normal = by_along.cross(&by_around);
                (point, normal.try_normalize(0.0).unwrap_or(Point::x() * t.signum()))
            }
            Skin::Finger { radius, .. } => {
                let quarter = 0.5 * PI * radius;
                let round = |x: f64| Point::new(x, sin, -cos);
                if along < quarter {
                    let (s, t) = (along / radius).sin_cos();
                    let normal = Point::new(t, s * sin, -s * cos);
                    (normal * radius, normal)
                } else {
                    let normal = round(0.0);
                    (normal * radius - Point::x() * (along - quarter), normal)
                }
            }
        }
    }

    /// Where a point of the skin is: along and around, as [`Skin::at`] takes them.
    pub fn place(&self, point: &Point) -> (f64, f64) {
        let around = point.y.atan2(-point.z);
        match *self {
            Skin::Ellipsoid([a, b, c]) => {
                let across = (point.y / b).hypot(point.z / c);
                (across.atan2(point.x / a), (point.y / b).atan2(-point.z / c))
            }
            Skin::Finger { radius, .. } if point.x > 0.0 => {
                (radius * point.y.hypot(point.z).atan2(point.x), around)
            }
            Skin::Finger { radius, .. } => (0.5 * PI * radius - point.x, around),
        }
    }

    /// A point spread evenly over the skin, with its normal.
    pub fn sample(&self, random: &mut Random) -> (Point, Point) {
        match *self {
            Skin::Ellipsoid([a, b, c]) => loop {
                // Evenly over the ball, kept as the ellipsoid's area there is to the largest.
                let d = random.direction(3);
                let stretch = Point::new(d.x / a, d.y / b, d.z / c).norm() * a.min(b).min(c);
                if random.unit() < stretch {
                    let around = d.y.atan2(-d.z);
                    return self.at(d.x.clamp(-1.0, 1.0).acos(), around);
                }
            },
            Skin::Finger { radius, length } => {
                // Ball and cylinder have the same area per length of axis.
                let x = random.unit() * (radius + length) - length;
                let quarter = 0.5 * PI * radius;
                let along = if x > 0.0 { radius * (x / radius).acos() } else { quarter - x };
                self.at(along, TAU * random.unit())
            }
        }
    }
}
