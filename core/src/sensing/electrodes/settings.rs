//! What an array of electrodes is told about itself.

use crate::matrix::{Coordinates, Vector};
use crate::sensing::detection::{Hysteresis, Sampling};
use crate::sensing::fingertip::{Edge, Fingertip, Shape};
use crate::sensing::{CalibrationError, ELECTRODES, Tolerance};

/// Positions of a BioTac's electrodes E1 to E19 on its core, metres, in its own frame: x towards
/// the tip, z out of the nail, the origin in the centre of the half ball that closes the finger.
/// Published by Lin et al., "Estimating point of contact, force and torque in a biomimetic tactile
/// sensor with deformable skin" (2013).
pub const BIOTAC_CORE: [Vector<3>; ELECTRODES] = [
    Vector([0.993e-3, -4.855e-3, -1.116e-3]),
    Vector([-2.700e-3, -3.513e-3, -3.670e-3]),
    Vector([-6.200e-3, -3.513e-3, -3.670e-3]),
    Vector([-8.000e-3, -4.956e-3, -1.116e-3]),
    Vector([-10.500e-3, -3.513e-3, -3.670e-3]),
    Vector([-13.400e-3, -4.956e-3, -1.116e-3]),
    Vector([4.763e-3, 0.0, -2.330e-3]),
    Vector([3.031e-3, -1.950e-3, -3.330e-3]),
    Vector([3.031e-3, 1.950e-3, -3.330e-3]),
    Vector([1.299e-3, 0.0, -4.330e-3]),
    Vector([0.993e-3, 4.855e-3, -1.116e-3]),
    Vector([-2.700e-3, 3.513e-3, -3.670e-3]),
    Vector([-6.200e-3, 3.513e-3, -3.670e-3]),
    Vector([-8.000e-3, 4.956e-3, -1.116e-3]),
    Vector([-10.500e-3, 3.513e-3, -3.670e-3]),
    Vector([-13.400e-3, 4.956e-3, -1.116e-3]),
    Vector([-2.800e-3, 0.0, -5.080e-3]),
    Vector([-9.800e-3, 0.0, -5.080e-3]),
    Vector([-13.600e-3, 0.0, -5.080e-3]),
];

/// A BioTac's skin: 7 mm about the axis of the finger, closed by a half ball, up to 2 mm past the
/// middle of its sides.
pub const BIOTAC_SKIN: Fingertip = Fingertip {
    shape: Shape::CappedCylinder { radius: 7e-3, length: 0.018 },
    edge: Some(Edge { normal: Vector([0.0, 0.0, -1.0]), offset: -2e-3 }),
};

/// What an [`ElectrodeEstimator`](super::ElectrodeEstimator) knows of its sensor and what it asks of a contact.
///
/// Strength is counted in *relative change of impedance*, R/R₀ − 1, summed over the electrodes: it
/// needs neither an electrode's size nor the converter's reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElectrodeSettings {
    /// Where the electrodes are, fingertip frame, metres: the calibration table. They may lie under
    /// the skin.
    pub positions: [Vector<3>; ELECTRODES],
    /// The skin.
    pub fingertip: Fingertip,
    /// Largest word of the converter, which an electrode without impedance would give; at most 2¹⁵.
    pub full_scale: u16,
    /// Words are credible strictly between these.
    pub range: (u16, u16),
    /// Standard deviation of one word.
    pub noise: f32,
    /// How far around a contact impedances rise: standard deviation of the bell that the change
    /// follows near it, metres.
    pub footprint: f32,
    /// How far, relatively, electrodes stray from that bell.
    pub mismatch: f32,
    /// How far contacts stray from the electrode that changes most, standard deviation per axis,
    /// metres.
    pub stray: f32,
    /// Newtons of normal force per summed relative change.
    pub stiffness: f32,
    /// How well the skin is known.
    pub tolerance: Tolerance,
    /// Standard deviation of the point above which a contact is not reported, metres.
    pub precision: f32,
    /// When a contact begins and ends: summed relative change.
    pub detection: Hysteresis,
    /// Averaging and taring.
    pub sampling: Sampling,
    /// Share of what remains that the baseline takes over with each reading while nothing touches,
    /// and sixteen times as much of what all electrodes have in common, as when the fluid warms up:
    /// zero for a baseline that is never followed.
    pub drift: f32,
    /// How far, relatively, all impedances may move in a second while something touches and the
    /// baseline cannot be followed: electrodes are trusted the less, and the weak ones least.
    pub creep: f32,
}

impl ElectrodeSettings {
    /// A BioTac. Positions, skin and converter are published; the numbers that describe how the skin
    /// gives way (footprint, mismatch, stray, stiffness) fit a film of fluid under it, and a real
    /// finger should be pressed at a few known places to replace them.
    pub const BIOTAC: Self = ElectrodeSettings {
        positions: BIOTAC_CORE,
        fingertip: BIOTAC_SKIN,
        full_scale: 4095,
        range: (8, 4087),
        noise: 2.0,
        footprint: 2.5e-3,
        mismatch: 0.2,
        stray: 2e-3,
        stiffness: 0.5,
        tolerance: Tolerance { point: 2e-4, normal: 0.02 },
        precision: 3e-3,
        detection: Hysteresis { begin: 0.02, end: 0.012, begin_readings: 3, end_readings: 3 },
        sampling: Sampling { window: 8, gap: 50_000, tare: 64, spread: 64 },
        drift: 1e-3,
        // Two percent per kelvin, a kelvin a minute.
        creep: 3.3e-4,
    };

    pub(super) const UNSET: Self = ElectrodeSettings {
        positions: [Vector([0.0; 3]); ELECTRODES],
        fingertip: Fingertip { shape: Shape::Sphere { radius: 0.0 }, edge: None },
        full_scale: 0,
        range: (0, 0),
        noise: 0.0,
        footprint: 0.0,
        mismatch: 0.0,
        stray: 0.0,
        stiffness: 0.0,
        tolerance: Tolerance { point: 0.0, normal: 0.0 },
        precision: 0.0,
        detection: Hysteresis { begin: 0.0, end: 0.0, begin_readings: 0, end_readings: 0 },
        sampling: Sampling { window: 0, gap: 0, tare: 0, spread: 0 },
        drift: 0.0,
        creep: 0.0,
    };

    /// The same, if it makes sense.
    ///
    /// # Errors
    /// What is not finite, not positive where it must be, or out of order.
    pub fn checked(mut self) -> Result<Self, CalibrationError> {
        let positive =
            [self.noise, self.footprint, self.mismatch, self.stray, self.stiffness, self.precision];
        if positive.iter().chain([&self.drift, &self.creep]).any(|v| !v.is_finite())
            || self.positions.iter().any(|p| !p.is_finite())
        {
            return Err(CalibrationError::NotFinite);
        }
        if positive.iter().any(|v| !(*v > 0.0)) {
            return Err(CalibrationError::NotPositive);
        }
        let (low, high) = self.range;
        if !(0.0..=1.0).contains(&self.drift)
            || self.creep < 0.0
            || low >= high
            || high >= self.full_scale
            || self.full_scale > 1 << 15
        {
            return Err(CalibrationError::Range);
        }
        self.fingertip = self.fingertip.checked()?;
        self.tolerance = self.tolerance.checked()?;
        self.detection = self.detection.checked()?;
        self.sampling = self.sampling.checked()?;
        Ok(self)
    }
}
