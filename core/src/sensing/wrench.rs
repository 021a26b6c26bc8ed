//! A six-axis transducer inside a fingertip: strain gauges to contacts.

use super::calibration::{self, CalibrationError, GaugeCalibration, Weight, Wrench};
use super::detection::{Detector, Held, Hysteresis, Phase, Sampling, Tare, Window};
use super::fingertip::{Fingertip, Shape};
use super::intrinsic::{self, Press, Scatter};
use super::{ContactEstimator, GaugeReading, NoContact, Tolerance, Touch, spread_on};
use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Pose, SpatialPose};

/// What a [`WrenchEstimator`] knows of its sensor and what it asks of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchSettings {
    /// Words to newtons.
    pub gauges: GaugeCalibration,
    /// The sensor's frame in the fingertip frame.
    pub sensor: SpatialPose,
    /// Standard deviation of one reading: force x, y, z (N), moment x, y, z (N m), sensor frame.
    pub noise: [f32; 6],
    /// What hangs on the sensor.
    pub weight: Weight,
    /// The skin.
    pub fingertip: Fingertip,
    /// How well the skin is known.
    pub tolerance: Tolerance,
    /// Tangential over normal force that no contact exceeds.
    pub friction: f32,
    /// Torsion over normal force that no contact exceeds, metres: about the coefficient of friction
    /// times two thirds of the radius of the area that touches.
    pub torsion: f32,
    /// Standard deviation of the point above which a contact is not reported, metres.
    pub precision: f32,
    /// When a contact begins and ends: newtons.
    pub detection: Hysteresis,
    /// Averaging and taring.
    pub sampling: Sampling,
    /// Share of the remaining load that the bias takes over with each reading while nothing touches:
    /// zero for a bias that is never followed.
    pub drift: f32,
    /// How far the bias may move in a second while something touches and it cannot be followed, in
    /// deviations of one reading: the covariance grows by it.
    pub creep: f32,
}

impl WrenchSettings {
    /// Full scale of an ATI Nano17 SI-12-0.12 by its data sheet: newtons and newton metres.
    pub const NANO17: [f32; 6] = [12.0, 12.0, 17.0, 0.12, 0.12, 0.12];

    /// A Nano17-type transducer at the fingertip's origin, its axes those of the frame: noise of
    /// 0.3 % of full scale, eight readings averaged, contacts from 0.15 N on, friction up to 1.2,
    /// torsion up to 2 N mm per newton, a bias that moves as in a finger that warms up by a kelvin a
    /// minute.
    pub const fn nano17(gauges: GaugeCalibration, fingertip: Fingertip) -> Self {
        WrenchSettings {
            gauges,
            sensor: SpatialPose::IDENTITY,
            noise: [0.036, 0.036, 0.051, 3.6e-4, 3.6e-4, 3.6e-4],
            weight: Weight::NONE,
            fingertip,
            tolerance: Tolerance { point: 1e-4, normal: 0.01 },
            friction: 1.2,
            torsion: 2e-3,
            precision: 2.5e-3,
            detection: Hysteresis { begin: 0.15, end: 0.08, begin_readings: 3, end_readings: 3 },
            sampling: Self::NANO17_SAMPLING,
            drift: 1e-4,
            creep: 0.01,
        }
    }

    /// Its averaging and taring, at a reading a millisecond.
    pub const NANO17_SAMPLING: Sampling =
        Sampling { window: 8, gap: 20_000, tare: 256, spread: 1 << 20 };

    const UNSET: Self = WrenchSettings {
        gauges: GaugeCalibration::UNSET,
        sensor: SpatialPose::UNSET,
        noise: [0.0; 6],
        weight: Weight::NONE,
        fingertip: Fingertip { shape: Shape::Sphere { radius: 0.0 }, edge: None },
        tolerance: Tolerance { point: 0.0, normal: 0.0 },
        friction: 0.0,
        torsion: 0.0,
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
        let positive = self.noise.iter().chain([&self.friction, &self.torsion, &self.precision]);
        if positive.clone().any(|v| !v.is_finite())
            || !self.sensor.is_finite()
            || !(self.drift.is_finite() && self.creep.is_finite())
        {
            return Err(CalibrationError::NotFinite);
        }
        if positive.clone().any(|v| !(*v > 0.0)) {
            return Err(CalibrationError::NotPositive);
        }
        if !(0.0..=1.0).contains(&self.drift) || self.creep < 0.0 {
            return Err(CalibrationError::Range);
        }
        self.fingertip = self.fingertip.checked()?;
        self.tolerance = self.tolerance.checked()?;
        self.weight = self.weight.checked()?;
        self.detection = self.detection.checked()?;
        self.sampling = self.sampling.checked()?;
        Ok(self)
    }
}

/// Contacts from the strain gauges of a force/torque transducer under a known skin: calibration,
/// gravity, averaging, detection, then [`intrinsic`] contact sensing and what speaks against its
/// answer. About one kilobyte, all zero until configured.
///
/// ```
/// use tactile_core::sensing::calibration::GaugeCalibration;
/// use tactile_core::sensing::fingertip::{Fingertip, Shape};
/// use tactile_core::sensing::wrench::{WrenchEstimator, WrenchSettings};
/// use tactile_core::sensing::{ContactEstimator, GaugeReading, NoContact};
///
/// let mut matrix = [[0.0; 6]; 6];
/// for k in 0..6 {
///     matrix[k][k] = WrenchSettings::NANO17[k] / 8e6; // a gauge for each component
/// }
/// let range = (-8_388_608, 8_388_607);
/// let gauges = GaugeCalibration::new(matrix, range, WrenchSettings::NANO17).unwrap();
/// let shape = Shape::CappedCylinder { radius: 0.008, length: 0.02 };
/// let settings = WrenchSettings::nano17(gauges, Fingertip { shape, edge: None });
/// let mut estimator = WrenchEstimator::new();
/// estimator.configure(&settings).unwrap();
///
/// // Free for a quarter of a second, then pressed with 1 N at its very tip.
/// let mut last = Err(NoContact::Taring);
/// for time in 0..300 {
///     let word = if time < 256 { 0 } else { -(8e6 / 12.0) as i32 };
///     last = estimator.estimate(&GaugeReading([word, 0, 0, 0, 0, 0]), 1000 * time);
/// }
/// let touch = last.unwrap();
/// assert!((touch.point[0] - 0.008).abs() < 1e-6 && touch.normal[0] < -0.9999);
/// assert!((touch.force[0] + 1.0).abs() < 1e-3);
/// ```
#[derive(Clone, Debug)]
pub struct WrenchEstimator {
    settings: WrenchSettings,
    configured: bool,
    taring: bool,
    /// Whether the sensor's frame is the fingertip's.
    aligned: bool,
    /// Covariance of one reading, fingertip frame.
    noise: Matrix<6>,
    bias: [i32; 6],
    tare: Tare<6>,
    window: Window<6>,
    detector: Detector,
    held: Held,
    gravity: Option<Vector<3>>,
    /// Weight at the time of the tare, which the bias holds.
    tared: Wrench,
    /// What a free fingertip reads beyond the bias: weight and drift.
    rest: Wrench,
    drifted: Wrench,
}

impl Default for WrenchEstimator {
    fn default() -> Self {
        Self::new()
    }
}

impl WrenchEstimator {
    /// Knows nothing of its sensor.
    pub const fn new() -> Self {
        WrenchEstimator {
            settings: WrenchSettings::UNSET,
            configured: false,
            taring: false,
            aligned: false,
            noise: Matrix([[0.0; 6]; 6]),
            bias: [0; 6],
            tare: Tare::new(),
            window: Window::new(),
            detector: Detector::new(),
            held: Held::new(),
            gravity: None,
            tared: Wrench::ZERO,
            rest: Wrench::ZERO,
            drifted: Wrench::ZERO,
        }
    }

    /// Takes settings over and begins to tare. Where they are refused nothing changes.
    ///
    /// # Errors
    /// See [`WrenchSettings::checked`].
    pub fn configure(&mut self, settings: &WrenchSettings) -> Result<(), CalibrationError> {
        let settings = settings.checked()?;
        self.settings = settings;
        self.aligned = settings.sensor == SpatialPose::IDENTITY;
        self.noise = calibration::noise(&settings.noise, &settings.sensor);
        self.configured = true;
        self.tare();
        Ok(())
    }

    /// The bias that was found at the last tare, words.
    pub fn bias(&self) -> [i32; 6] {
        self.bias
    }

    /// Load of the object in the fingertip frame, averaged over the window.
    #[inline]
    fn load(&self) -> Result<Wrench, NoContact> {
        let count = self.window.count();
        let share = 1.0 / count as f32;
        let sums = self.window.sums();
        let net: [f32; 6] = core::array::from_fn(|k| {
            sums[k].saturating_sub(self.bias[k] * count as i32) as f32 * share
        });
        let wrench = self.settings.gauges.wrench(&net)?;
        let wrench = if self.aligned { wrench } else { wrench.moved(&self.settings.sensor) };
        Ok(wrench - self.rest)
    }

    /// What gravity and drift leave at rest.
    fn settle(&mut self) {
        let weight = self.gravity.map_or(self.tared, |g| self.settings.weight.load(g));
        self.rest = weight - self.tared + self.drifted;
    }

    /// While nothing touches, what remains is taken for the sensor's drift.
    #[inline]
    fn follow(&mut self, load: &Wrench) {
        let rate = self.settings.drift;
        if rate > 0.0 && load.is_finite() {
            let step = Wrench { force: load.force * rate, moment: load.moment * rate };
            self.drifted = self.drifted + step;
            self.rest = self.rest + step;
        }
    }

    /// The touch of a press, unless something speaks against it.
    #[inline]
    fn judge(&self, press: &Press, load: &Wrench) -> Result<Touch, NoContact> {
        let settings = &self.settings;
        // The bias is as uncertain as the mean of the readings that made it.
        let share = 1.0 / self.window.count() as f32 + 1.0 / settings.sampling.tare as f32;
        let crept = settings.creep * self.held.seconds();
        let share = share + crept * crept;
        let Scatter { point, torsion } = press.scatter(&self.noise);
        let spread = point.map(|v| v * share);
        let force = share * (self.noise.at(0, 0) + self.noise.at(1, 1) + self.noise.at(2, 2));
        // Three standard deviations past what friction holds.
        let slide = settings.friction * press.push + 3.0 * math::sqrt(force);
        let twist = settings.torsion * press.push + 3.0 * math::sqrt(share * torsion);
        if press.tangential > slide || press.torsion.abs() > twist {
            return Err(NoContact::Inconsistent);
        }
        let variance = spread[0] + spread[2];
        if !(variance <= settings.precision * settings.precision) {
            return Err(NoContact::IllConditioned);
        }
        let (covariance, normal_deviation) = spread_on(&press.patch, spread, &settings.tolerance);
        Ok(Touch {
            time: self.window.middle(),
            point: press.patch.point,
            normal: -press.patch.outward,
            force: load.force,
            covariance,
            normal_deviation,
            slip: Some(press.tangential / press.push),
        })
    }
}

impl ContactEstimator for WrenchEstimator {
    type Reading = GaugeReading;

    fn estimate(&mut self, reading: &GaugeReading, time: u32) -> Result<Touch, NoContact> {
        if !self.configured {
            return Err(NoContact::NotCalibrated);
        }
        let words = &reading.0;
        if let Err(why) = self.settings.gauges.check(words) {
            self.window.clear();
            self.tare = Tare::new();
            return Err(why);
        }
        let sampling = self.settings.sampling;
        if self.taring {
            if let Some(mean) = self.tare.push(words, sampling.tare, sampling.spread) {
                self.bias = mean.map(|w| if w < 0.0 { w - 0.5 } else { w + 0.5 } as i32);
                self.tared = self.gravity.map_or(Wrench::ZERO, |g| self.settings.weight.load(g));
                self.drifted = Wrench::ZERO;
                self.settle();
                self.held.pass(time);
                self.held.release();
                self.taring = false;
            }
            return Err(NoContact::Taring);
        }
        self.window.push(words, time, sampling.window, sampling.gap);
        self.held.pass(time);
        let load = self.load()?;
        match self.detector.update(load.force.norm(), &self.settings.detection) {
            Phase::Touching => {}
            Phase::Free => {
                self.held.release();
                self.follow(&load);
                return Err(NoContact::TooLight);
            }
            Phase::Ending => return Err(NoContact::TooLight),
            Phase::Beginning => return Err(NoContact::Settling),
        }
        let press = intrinsic::locate(&self.settings.fingertip, &load)?;
        self.judge(&press, &load)
    }

    fn tare(&mut self) {
        self.taring = true;
        self.tare = Tare::new();
        self.window.clear();
        self.detector = Detector::new();
    }

    fn set_gravity(&mut self, gravity: Vector<3>) {
        if !gravity.is_finite() {
            return;
        }
        if self.gravity.is_none() {
            // The bias holds the weight as it was; until now nobody said that it changed.
            self.tared = self.settings.weight.load(gravity);
        }
        self.gravity = Some(gravity);
        self.settle();
    }
}
