//! From a sensor's words to contacts: what a fingertip felt, where, and how surely (thesis 2.3.1).
//!
//! ```text
//! words (driver) → Reading → ContactEstimator → Touch (fingertip) → Contact (world) → Grasp
//! ```
//!
//! A [`ContactEstimator`] takes every reading of its sensor with the time it was sampled at, and
//! says what was touched or why nothing can be said. It tares itself at rest, averages a short
//! window and decides with hysteresis when a contact begins and ends.
//!
//! **Frame.** Everything is in the *fingertip frame* of the skin's geometry ([`fingertip`]): x
//! along the finger towards its tip. Where a sensor sits elsewhere its estimator is told, once.
//!
//! **Signs.** Forces are those of the object on the fingertip. Normals point out of the *object*,
//! as everywhere: at a contact that is into the fingertip, against the skin's own outward normal,
//! so that a pushing force has a positive component along [`Touch::normal`].

pub mod calibration;
pub mod detection;
pub mod electrodes;
pub mod fingertip;
pub mod intrinsic;
#[cfg(test)]
mod tests;
pub mod wrench;

pub use calibration::CalibrationError;
pub use electrodes::{ElectrodeEstimator, ElectrodeSettings};

pub use wrench::{WrenchEstimator, WrenchSettings};

use fingertip::Patch;

use crate::contact::Contact;
use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Pose, Space, SpatialPose};

/// Electrodes of a BioTac.
pub const ELECTRODES: usize = 19;

/// Six strain gauges of a force/torque transducer, sampled at once: the words of its converter,
/// sign extended. Any bits are a reading; which are credible is decided by the calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GaugeReading(pub [i32; 6]);

/// The electrodes E1 to E19 of a BioTac in this order: the words of its converter (12 bits), which
/// fall as the impedance rises. Any bits are a reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ElectrodeReading(pub [u16; ELECTRODES]);

/// From readings of one sensor to contacts.
///
/// An estimator that was never configured answers [`NoContact::NotCalibrated`], and no reading
/// makes it panic.
pub trait ContactEstimator {
    /// What the sensor's driver gives.
    type Reading;

    /// Takes the next reading, sampled at `time` (microseconds, wrapping). Where time stands still,
    /// goes back, or jumps by more than the window allows, averaging starts again.
    ///
    /// # Errors
    /// The reason why there is no contact to report.
    fn estimate(&mut self, reading: &Self::Reading, time: u32) -> Result<Touch, NoContact>;

    /// Takes the readings that follow for those of a free fingertip, until enough of them agreed;
    /// meanwhile [`NoContact::Taring`].
    fn tare(&mut self);

    /// Says which way gravity pulls: m/s² in the fingertip frame, e.g.
    /// `pose.unrotate(Vector([0.0, 0.0, -9.81]))` for a fingertip at `pose` over a level world.
    /// What is not finite is ignored. Sensors that do not weigh their fingertip ignore it all.
    fn set_gravity(&mut self, _gravity: Vector<3>) {}
}

/// A fingertip on the object, in the fingertip frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Middle of the averaged readings, microseconds, wrapping.
    pub time: u32,
    /// Where on the skin, metres.
    pub point: Vector<3>,
    /// Unit normal out of the object, which is into the fingertip.
    pub normal: Vector<3>,
    /// Force of the object on the fingertip, newtons. Electrodes give its normal part only, and
    /// roughly.
    pub force: Vector<3>,
    /// Covariance of the point, m²: along the skin from the sensor's noise, along the normal from
    /// the skin's tolerance.
    pub covariance: Matrix<3>,
    /// Standard deviation of the normal's direction, radians per axis.
    pub normal_deviation: f32,
    /// Tangential over normal force: nears the coefficient of friction as the finger begins to
    /// slip. `None` where the sensor does not feel tangential force.
    pub slip: Option<f32>,
}

impl Touch {
    /// Least standard deviation of a contact that is handed on: 1 µm and 10⁻³ rad, as a contact's
    /// must not vanish.
    const LEAST: (f32, f32) = (1e-6, 1e-3);

    /// The same touch seen from the frame in which the fingertip is at `mount`.
    pub fn moved(&self, mount: &SpatialPose) -> Touch {
        let axes: [Vector<3>; 3] =
            core::array::from_fn(|k| mount.rotate(Vector::from_fn(|i| (i == k) as u8 as f32)));
        let mut covariance = Matrix::<3>::ZERO;
        for i in 0..3 {
            for j in 0..3 {
                covariance.add_outer(self.covariance.at(i, j), axes[i], axes[j]);
            }
        }
        Touch {
            point: mount.transform(self.point),
            normal: mount.rotate(self.normal),
            force: mount.rotate(self.force),
            covariance,
            ..*self
        }
    }

    /// The contact in the world of the fingertip `finger` at `fingertip`. In the plane the third
    /// coordinate is dropped, so that the fingertip frame's z must stand on the plane (see
    /// [`Touch::moved`]).
    ///
    /// The point's deviation is that along the normal; in the plane the normal's is greater by 1/cos of the
    /// angle at which it leaves the plane. `None` in the plane when that is more than 45°, as such a touch
    /// says little about an outline; and when a number is not finite.
    ///
    /// ```
    /// use tactile_core::matrix::{Matrix, Square, Vector};
    /// use tactile_core::sensing::Touch;
    /// use tactile_core::space::{Pose, Spatial, SpatialPose};
    ///
    /// let touch = Touch {
    ///     time: 0,
    ///     point: Vector([0.007, 0.0, 0.0]),
    ///     normal: Vector([-1.0, 0.0, 0.0]),
    ///     force: Vector([-1.0, 0.0, 0.0]),
    ///     covariance: Matrix::ZERO,
    ///     normal_deviation: 0.02,
    ///     slip: Some(0.0),
    /// };
    /// let fingertip = SpatialPose::from_translation(Vector([0.1, 0.0, 0.2]));
    /// let contact = touch.contact::<Spatial>(&fingertip, 2).unwrap();
    /// assert_eq!(contact.point, Vector([0.107, 0.0, 0.2]));
    /// assert!(contact.checked().is_ok());
    /// ```
    pub fn contact<S: Space>(&self, fingertip: &S::Pose, finger: u8) -> Option<Contact<S>> {
        let part = |v: Vector<3>| S::Vector::from_fn(|i| if i < 3 { v[i] } else { 0.0 });
        let normal = part(self.normal);
        let length = normal.norm();
        if !(length * length >= 0.5) {
            return None;
        }
        let stretch = 1.0 / length;
        let normal = normal * stretch;
        let mut variance = 0.0;
        for i in 0..S::DIMENSION.min(3) {
            for j in 0..S::DIMENSION.min(3) {
                variance += normal[i] * self.covariance.at(i, j) * normal[j];
            }
        }
        let (point, direction) = Self::LEAST;
        Contact {
            point: fingertip.transform(part(self.point)),
            normal: Some(fingertip.rotate(normal)),
            point_deviation: math::max(math::sqrt(math::max(variance, 0.0)), point),
            normal_deviation: math::max(self.normal_deviation * stretch, direction),
            finger,
        }
        .checked()
        .ok()
    }
}

/// How well a skin is known: standard deviations of what its drawing does not tell, such as wear
/// and a soft skin that gives way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Of the skin along its normal, metres.
    pub point: f32,
    /// Of its normal, radians per axis.
    pub normal: f32,
}

impl Tolerance {
    /// The same, if it makes sense.
    ///
    /// # Errors
    /// Numbers below zero or not finite.
    pub fn checked(self) -> Result<Self, CalibrationError> {
        if !(self.point.is_finite() && self.normal.is_finite()) {
            Err(CalibrationError::NotFinite)
        } else if self.point < 0.0 || self.normal < 0.0 {
            Err(CalibrationError::NotPositive)
        } else {
            Ok(self)
        }
    }
}

/// Covariance of a point in space and deviation of the normal there, from the point's variance
/// along the first tangent, between both, along the second: as the point moves the normal turns
/// with the skin's curvature.
#[inline]
fn spread_on(patch: &Patch, [a, b, c]: [f32; 3], tolerance: &Tolerance) -> (Matrix<3>, f32) {
    let [u, v] = patch.tangents;
    let (along, across) = (u * a + v * b, u * b + v * c);
    let outward = patch.outward;
    let off = outward * (tolerance.point * tolerance.point);
    let entry = |i: usize, j: usize| along[i] * u[j] + across[i] * v[j] + off[i] * outward[j];
    let [xx, xy, xz] = [entry(0, 0), entry(0, 1), entry(0, 2)];
    let [yy, yz, zz] = [entry(1, 1), entry(1, 2), entry(2, 2)];
    let covariance = Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]);
    let [uu, uv, vv] = patch.curvature;
    // Trace of κPκ.
    let turned = (uu * uu + uv * uv) * a + 2.0 * uv * (uu + vv) * b + (uv * uv + vv * vv) * c;
    let variance = 0.5 * turned + tolerance.normal * tolerance.normal;
    (covariance, math::sqrt(variance))
}

/// Why a reading gives no contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum NoContact {
    /// The estimator was not configured.
    NotCalibrated,
    /// Readings of the free fingertip are being collected.
    Taring,
    /// A word stands at, or beyond, an end of its converter's range, or the load leaves the
    /// sensor's: channel, from 0.
    Saturated {
        /// Gauge, component of the wrench, or electrode.
        channel: u8,
    },
    /// A number is not finite.
    NotFinite,
    /// Nothing touches, or less strongly than can be located.
    TooLight,
    /// A contact has begun, but not for long enough to be believed.
    Settling,
    /// The force pulls: no single contact does that.
    Pulling,
    /// The force's line of action misses the skin, or the contact is off its edge.
    OutsideSkin,
    /// Tangential force or torsion beyond what friction holds, or readings that no single contact
    /// explains: several contacts, or something that holds the fingertip elsewhere.
    Inconsistent,
    /// The point would be less certain than is allowed.
    IllConditioned,
}

impl core::fmt::Display for NoContact {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            NoContact::NotCalibrated => "the sensor is not calibrated",
            NoContact::Taring => "the sensor is being tared",
            NoContact::Saturated { channel } => {
                return write!(f, "channel {channel} is at the end of its range");
            }
            NoContact::NotFinite => "a number is not finite",
            NoContact::TooLight => "nothing touches, or too lightly to be located",
            NoContact::Settling => "a contact has only just begun",
            NoContact::Pulling => "the force pulls, which no contact does",
            NoContact::OutsideSkin => "the force does not pass through the skin",
            NoContact::Inconsistent => "no single contact explains the reading",
            NoContact::IllConditioned => "the contact cannot be located as precisely as is asked",
        })
    }
}

impl core::error::Error for NoContact {}
