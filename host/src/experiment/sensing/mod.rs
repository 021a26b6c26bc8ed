//! How well fingertips feel: the core's estimators against sensors simulated forwards.

pub mod drift;
pub mod electrodes;
mod figures;
mod single;
#[cfg(test)]
mod tests;
pub mod wrench;

use tactile_core::matrix::Vector;
use tactile_core::sensing::Touch;
use tactile_core::sensing::fingertip::{Fingertip, Shape};

use crate::sim::sensors::{Push, Skin};
use crate::space::Point;

/// The estimators' description of a simulated skin.
fn fingertip(skin: &Skin) -> Fingertip {
    let shape = match *skin {
        Skin::Ellipsoid(half_axes) => {
            Shape::Ellipsoid { half_axes: Vector(half_axes.map(|a| a as f32)) }
        }
        Skin::Finger { radius, length } => {
            Shape::CappedCylinder { radius: radius as f32, length: length as f32 }
        }
    };
    Fingertip { shape, edge: None }
}

fn point(v: &Vector<3>) -> Point {
    Point::from(v.0.map(f64::from))
}

/// How far a touch is from the push that made it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Miss {
    /// Metres.
    point: f64,
    /// Between the normals, radians.
    normal: f64,
    /// Error along the skin, squared, in units of its covariance: two on average, if that is honest.
    squared: f64,
}

impl Miss {
    fn of(touch: &Touch, push: &Push) -> Miss {
        let away = point(&touch.point) - push.point;
        let outward = -point(&touch.normal);
        let axis = Point::from_fn(|i, _| (i == outward.iamin()) as u8 as f64);
        let u = outward.cross(&axis).normalize();
        let v = outward.cross(&u);
        let covariance = nalgebra::Matrix3::from_fn(|i, j| f64::from(touch.covariance.0[i][j]));
        let form = |a: &Point, b: &Point| a.dot(&(covariance * b));
        let (a, b, c) = (form(&u, &u), form(&u, &v), form(&v, &v));
        let (s, t) = (u.dot(&away), v.dot(&away));
        let squared = (c * s * s - 2.0 * b * s * t + a * t * t) / (a * c - b * b);
        // Well conditioned for small angles too.
        let normal = outward.cross(&push.outward).norm().atan2(outward.dot(&push.outward));
        Miss { point: away.norm(), normal, squared }
    }
}

/// Root of the mean square; NaN of nothing.
fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
    (values.clone().map(|v| v * v).sum::<f64>() / values.count() as f64).sqrt()
}
