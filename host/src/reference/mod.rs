//! Dense double-precision surfaces and filters: the independent yardstick of the core, and the host's own
//! surface when it extracts contours and meshes. What surfaces are about is in [`model`](mod@crate::model).
//!
//! Written from the mathematics, not from the core: the two share no code, so where they agree,
//! both are likely right. The surface does its linear algebra and its kernel sums in
//! [`dense`](mod@crate::dense); [`cholesky`] and the tests hold plain versions against it.
//!
//! Thesis 2.2 (surface) and 3.3 (filter), with the corrections that each item names. f > 0 outside,
//! f < 0 inside, scaled as a signed distance in metres; normals point out of the object; planar
//! data has z = 0 and the dimension, 2 or 3, decides how many derivatives there are.

pub mod cholesky;
pub mod ellipsoid;
pub mod filter;
pub mod foresight;
pub mod gpis;
pub mod hyper;
pub mod kernel;
pub mod local;
pub mod mean;
pub mod prior;
pub mod spheres;
pub mod tracker;

#[cfg(test)]
mod tests;

pub use ellipsoid::Ellipsoid;
pub use filter::{Filter, Gate, Settings};
pub use foresight::Foresight;
pub use gpis::{Gpis, Training};
pub use kernel::Kernel;
pub use local::Local;
pub use mean::Mean;
pub use prior::Prior;
pub use spheres::{Normalisation, Spheres};
pub use tracker::Tracker;

use crate::space::{Point, Pose};

/// One touch of the surface, in the object or the world frame as the user of it says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Where, metres.
    pub point: Point,
    /// Unit normal out of the object, where it was measured.
    pub normal: Option<Point>,
    /// Standard deviation of the point along the normal, metres.
    pub point_deviation: f64,
    /// Standard deviation of the normal's direction, radians per axis.
    pub normal_deviation: f64,
}

impl Contact {
    /// The same contact after the rigid motion `pose`: object to world with the object's pose,
    /// world to object with its inverse.
    pub fn transformed(&self, pose: &Pose) -> Contact {
        Contact {
            point: pose.rotation * self.point + pose.translation.vector,
            normal: self.normal.map(|n| pose.rotation * n),
            ..*self
        }
    }

    /// The contact with its normal at unit length; `None` where it cannot be used: a number that is
    /// not finite, a deviation that is not positive, a normal without length.
    pub fn checked(&self) -> Option<Contact> {
        let positive = |d: f64| d > 0.0 && d.is_finite();
        let fine = self.point.iter().all(|v| v.is_finite())
            && positive(self.point_deviation)
            && positive(self.normal_deviation);
        let normal = match self.normal {
            Some(normal) => {
                Some(normal.try_normalize(1e-3).filter(|n| n.iter().all(|v| v.is_finite()))?)
            }
            None => None,
        };
        fine.then_some(Contact { normal, ..*self })
    }
}
