//! What turns a transducer's words into newtons, and which of them are credible.

use super::NoContact;
use super::detection::LARGEST_WORD;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Pose, SpatialPose};

/// Why a sensor cannot be configured so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationError {
    /// A number is NaN or infinite.
    NotFinite,
    /// The calibration matrix has no inverse, or none that single precision can trust: some load
    /// would not be felt.
    Singular,
    /// A standard deviation, length, mass, threshold or coefficient is not above zero (or is below
    /// it, where it may be zero).
    NotPositive,
    /// A lower limit is not below its upper one, a word's range leaves ±2²⁶, or a direction is not
    /// a unit vector.
    Range,
    /// The skin is not a convex surface.
    NotConvex,
    /// A number of readings to average or to wait for is zero or too large.
    Window,
}

impl core::fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            CalibrationError::NotFinite => "a calibration number is not finite",
            CalibrationError::Singular => "the calibration matrix is singular",
            CalibrationError::NotPositive => "deviations, lengths and thresholds must be positive",
            CalibrationError::Range => "a lower limit must be below its upper limit",
            CalibrationError::NotConvex => "the skin must be a convex surface",
            CalibrationError::Window => "none or too many readings to average",
        })
    }
}

impl core::error::Error for CalibrationError {}

/// A force and a moment about the origin of the frame they are given in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Newtons.
    pub force: Vector<3>,
    /// Newton metres.
    pub moment: Vector<3>,
}

impl Wrench {
    /// No load.
    pub const ZERO: Self = Wrench { force: Vector::ZERO, moment: Vector::ZERO };

    /// The same load about the origin of the frame in which this one's frame is at `pose`.
    #[inline]
    pub fn moved(&self, pose: &SpatialPose) -> Wrench {
        let force = pose.rotate(self.force);
        Wrench { force, moment: pose.rotate(self.moment) + pose.translation.cross(force) }
    }

    /// Whether every number is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.force.is_finite() && self.moment.is_finite()
    }
}

impl core::ops::Add for Wrench {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Wrench { force: self.force + other.force, moment: self.moment + other.moment }
    }
}

impl core::ops::Sub for Wrench {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Wrench { force: self.force - other.force, moment: self.moment - other.moment }
    }
}

/// What six strain gauges say of force and moment.
///
/// Nothing here knows the temperature: the range checks hold at any, and what it moves slowly is
/// left to taring and to following the bias.
///
/// ```
/// use tactile_core::matrix::Vector;
/// use tactile_core::sensing::calibration::{CalibrationError, GaugeCalibration};
///
/// // One gauge per component, a millinewton (or a micronewton metre) a word.
/// let mut matrix = [[0.0; 6]; 6];
/// for k in 0..6 {
///     matrix[k][k] = if k < 3 { 1e-3 } else { 1e-6 };
/// }
/// let full_scale = [12.0, 12.0, 17.0, 0.12, 0.12, 0.12];
/// let gauges = GaugeCalibration::new(matrix, (-8_000_000, 8_000_000), full_scale).unwrap();
/// let wrench = gauges.wrench(&[500.0, 0.0, 0.0, 0.0, -2000.0, 0.0]).unwrap();
/// assert_eq!(wrench.force, Vector([0.5, 0.0, 0.0]));
/// assert_eq!(wrench.moment, Vector([0.0, -0.002, 0.0]));
///
/// matrix[5] = matrix[4];
/// let refused = GaugeCalibration::new(matrix, (-8_000_000, 8_000_000), full_scale);
/// assert_eq!(refused, Err(CalibrationError::Singular));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugeCalibration {
    matrix: [[f32; 6]; 6],
    range: (i32, i32),
    full_scale: [f32; 6],
}

/// Smallest pivot of an equilibrated calibration matrix: below it, more than half the digits of
/// single precision are lost.
const LEAST_PIVOT: f32 = 1e-4;

impl GaugeCalibration {
    /// Believes nothing.
    pub(super) const UNSET: Self =
        GaugeCalibration { matrix: [[0.0; 6]; 6], range: (0, 0), full_scale: [0.0; 6] };

    /// The calibration of a transducer.
    ///
    /// `matrix` times words (free of bias) gives force, then moment about the sensor's origin:
    /// newtons and newton metres per word. Words are credible strictly between the two ends of
    /// `range`; a load is, up to `full_scale` in each component either way.
    ///
    /// # Errors
    /// A singular matrix, numbers that are not finite, an empty range or one beyond ±2²⁶, a full
    /// scale that is not positive.
    pub fn new(
        matrix: [[f32; 6]; 6],
        range: (i32, i32),
        full_scale: [f32; 6],
    ) -> Result<Self, CalibrationError> {
        let all = matrix.iter().flatten().chain(&full_scale);
        if all.clone().any(|v| !v.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        if full_scale.iter().any(|v| !(*v > 0.0)) {
            return Err(CalibrationError::NotPositive);
        }
        if range.0 >= range.1 || range.0 < -LARGEST_WORD || range.1 > LARGEST_WORD {
            return Err(CalibrationError::Range);
        }
        if is_singular(matrix, &full_scale) {
            return Err(CalibrationError::Singular);
        }
        Ok(GaugeCalibration { matrix, range, full_scale })
    }

    /// Checks the words of one reading.
    ///
    /// # Errors
    /// [`NoContact::Saturated`] with the first channel whose word is at or beyond an end of the
    /// range.
    #[inline]
    pub fn check(&self, words: &[i32; 6]) -> Result<(), NoContact> {
        let (low, high) = self.range;
        match words.iter().position(|w| *w <= low || *w >= high) {
            Some(channel) => Err(NoContact::Saturated { channel: channel as u8 }),
            None => Ok(()),
        }
    }

    /// The wrench, in the sensor's frame, of words from which the bias was taken.
    ///
    /// # Errors
    /// [`NoContact::NotFinite`]; [`NoContact::Saturated`] with the component (force x, y, z, moment
    /// x, y, z) beyond its full scale.
    #[inline]
    pub fn wrench(&self, words: &[f32; 6]) -> Result<Wrench, NoContact> {
        let mut load = [0.0; 6];
        for (component, row) in load.iter_mut().zip(&self.matrix) {
            for (c, w) in row.iter().zip(words) {
                *component += c * w;
            }
        }
        for (channel, (value, limit)) in load.iter().zip(&self.full_scale).enumerate() {
            if !(value.abs() <= *limit) {
                return Err(if value.is_finite() {
                    NoContact::Saturated { channel: channel as u8 }
                } else {
                    NoContact::NotFinite
                });
            }
        }
        let [fx, fy, fz, mx, my, mz] = load;
        Ok(Wrench { force: Vector([fx, fy, fz]), moment: Vector([mx, my, mz]) })
    }
}

/// Whether Gaussian elimination runs out of pivots: rows in units of their full scale, rows and
/// then columns scaled to a largest entry of one.
fn is_singular(mut m: [[f32; 6]; 6], full_scale: &[f32; 6]) -> bool {
    let largest = |values: [f32; 6]| values.iter().fold(0.0f32, |a, v| a.max(v.abs()));
    for (row, scale) in m.iter_mut().zip(full_scale) {
        *row = row.map(|v| v / scale);
    }
    // Twice, as scaling columns disturbs the rows.
    for _ in 0..2 {
        for row in &mut m {
            let size = largest(*row);
            *row = row.map(|v| v / size);
        }
        for j in 0..6 {
            let size = largest(core::array::from_fn(|i| m[i][j]));
            for row in &mut m {
                row[j] /= size;
            }
        }
    }
    for k in 0..6 {
        // Complete pivoting: the pivots tell the rank.
        let (mut at, mut size) = ((k, k), 0.0);
        for i in k..6 {
            for j in k..6 {
                if m[i][j].abs() > size {
                    (at, size) = ((i, j), m[i][j].abs());
                }
            }
        }
        // A row or column of zeros was divided by zero, so that nothing is larger.
        if !(size >= LEAST_PIVOT) || !size.is_finite() {
            return true;
        }
        m.swap(k, at.0);
        for row in &mut m {
            row.swap(k, at.1);
        }
        for i in k + 1..6 {
            let factor = m[i][k] / m[k][k];
            for j in k..6 {
                m[i][j] -= factor * m[k][j];
            }
        }
    }
    false
}

/// What hangs on a sensor beside the object: the fingertip's own shell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// Kilograms; zero for nothing.
    pub mass: f32,
    /// Centre of mass in the fingertip frame, metres.
    pub centre: Vector<3>,
}

impl Weight {
    /// Nothing.
    pub const NONE: Self = Weight { mass: 0.0, centre: Vector::ZERO };

    /// What it loads the sensor with where gravity is `gravity` (m/s², fingertip frame), about the
    /// frame's origin.
    #[inline]
    pub fn load(&self, gravity: Vector<3>) -> Wrench {
        let force = gravity * self.mass;
        Wrench { force, moment: self.centre.cross(force) }
    }

    /// The same, if it makes sense.
    ///
    /// # Errors
    /// A mass below zero, numbers that are not finite.
    pub fn checked(self) -> Result<Self, CalibrationError> {
        if !(self.mass.is_finite() && self.centre.is_finite()) {
            Err(CalibrationError::NotFinite)
        } else if self.mass < 0.0 {
            Err(CalibrationError::NotPositive)
        } else {
            Ok(self)
        }
    }
}

/// Covariance of the wrench in the fingertip frame, force first, of a sensor at `sensor` whose
/// components scatter independently with `deviations` (force x, y, z, moment x, y, z).
pub(super) fn noise(deviations: &[f32; 6], sensor: &SpatialPose) -> Matrix<6> {
    let mut covariance = Matrix::<6>::ZERO;
    for (k, deviation) in deviations.iter().enumerate() {
        let unit = |from: usize| Vector::from_fn(|i| (i + from == k) as u8 as f32);
        let one = Wrench { force: unit(0), moment: unit(3) }.moved(sensor);
        let (f, m) = (one.force, one.moment);
        let column = Vector([f[0], f[1], f[2], m[0], m[1], m[2]]);
        covariance.add_outer(deviation * deviation, column, column);
    }
    covariance
}
