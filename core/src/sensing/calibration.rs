//! What turns a sensor's words into newtons, and which of them are credible.

/// Why a sensor cannot be configured so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationError {
    /// A number is NaN or infinite.
    NotFinite,
    /// The calibration matrix has no inverse, or none that single precision can trust: some load
    /// would not be felt.
    Singular,
    /// A standard deviation, length, mass, threshold or coefficient is not above zero (or below it,
    /// where it may be zero).
    NotPositive,
    /// A lower limit is not below its upper one.
    Range,
    /// The skin is not convex.
    NotConvex,
    /// A window, or a number of readings, is zero or longer than there is room for.
    Window,
}

impl core::fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            CalibrationError::NotFinite => "a calibration number is not finite",
            CalibrationError::Singular => "the calibration matrix is singular",
            CalibrationError::NotPositive => "deviations, lengths and thresholds must be positive",
            CalibrationError::Range => "a lower limit must be below its upper limit",
            CalibrationError::NotConvex => "the skin must be convex",
            CalibrationError::Window => "too many or no readings to average",
        })
    }
}

impl core::error::Error for CalibrationError {}
