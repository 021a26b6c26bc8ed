//! Sensors of a fingertip, forwards: the words they send when their skin is pressed.
//!
//! They share nothing with the estimators of [`tactile_core::sensing`] but the published facts
//! about the devices: skins are parametrised here and implicit there, arithmetic is double, and the
//! electrodes obey a thin film of fluid that the estimators know nothing of.
//!
//! Everything is in the fingertip frame, x along the finger towards its tip, SI units.

pub mod film;
pub mod gauges;
pub mod skin;
#[cfg(test)]
mod tests;

pub use film::FluidFinger;
pub use gauges::Transducer;
pub use skin::Skin;

use crate::space::Point;

/// Something that presses on the skin at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Where on the skin, metres.
    pub point: Point,
    /// Unit normal out of the fingertip there.
    pub outward: Point,
    /// Force on the fingertip, newtons.
    pub force: Point,
    /// Torsion about the outward normal, newton metres.
    pub torsion: f64,
}

impl Push {
    /// A push of `newtons` along the inward normal, and `slide` times that along the skin, in the
    /// direction `along` (which is projected onto the skin; zero for none).
    pub fn new((point, outward): (Point, Point), newtons: f64, slide: f64, along: Point) -> Push {
        let tangent = along - outward * outward.dot(&along);
        let tangent = tangent.try_normalize(1e-12).unwrap_or_default();
        let force = (tangent * slide - outward) * newtons;
        Push { point, outward, force, torsion: 0.0 }
    }

    /// The same with a torsion, newton metres.
    pub fn twisted(self, torsion: f64) -> Push {
        Push { torsion, ..self }
    }

    /// Force, then moment about the origin.
    pub fn wrench(&self) -> [f64; 6] {
        let moment = self.point.cross(&self.force) + self.outward * self.torsion;
        [self.force.x, self.force.y, self.force.z, moment.x, moment.y, moment.z]
    }
}
