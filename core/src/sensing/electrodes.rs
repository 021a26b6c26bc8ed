//! An array of electrodes under a fluid-filled skin: impedances to contacts.

use super::detection::{Detector, Hysteresis, Phase, Sampling, Tare, Window};
use super::fingertip::{Edge, Fingertip, Patch, Shape};
use super::{
    CalibrationError, ContactEstimator, ELECTRODES, ElectrodeReading, NoContact, Tolerance, Touch,
    spread_on,
};
use crate::math;
use crate::matrix::{Coordinates, Vector};

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

/// What an [`ElectrodeEstimator`] knows of its sensor and what it asks of a contact.
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
    /// Largest word of the converter, which an electrode without impedance would give.
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
    /// How far the centroid strays from the contact, standard deviation per axis, metres.
    pub centroid: f32,
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
    /// Share of what remains that the baseline takes over with each reading while nothing touches:
    /// zero for a baseline that is never followed.
    pub drift: f32,
}

impl ElectrodeSettings {
    /// A BioTac. Positions, skin and converter are published; the numbers that describe how the skin
    /// gives way (footprint, mismatch, centroid, stiffness) fit a film of fluid under it, and a real
    /// finger should be pressed at a few known places to replace them.
    pub const BIOTAC: Self = ElectrodeSettings {
        positions: BIOTAC_CORE,
        fingertip: BIOTAC_SKIN,
        full_scale: 4095,
        range: (8, 4087),
        noise: 2.0,
        footprint: 2.5e-3,
        mismatch: 0.2,
        centroid: 2e-3,
        stiffness: 0.5,
        tolerance: Tolerance { point: 2e-4, normal: 0.02 },
        precision: 3e-3,
        detection: Hysteresis { begin: 0.02, end: 0.012, begin_readings: 3, end_readings: 3 },
        sampling: Sampling { window: 8, gap: 50_000, tare: 64, spread: 64 },
        drift: 1e-3,
    };

    const UNSET: Self = ElectrodeSettings {
        positions: [Vector([0.0; 3]); ELECTRODES],
        fingertip: Fingertip { shape: Shape::Sphere { radius: 0.0 }, edge: None },
        full_scale: 0,
        range: (0, 0),
        noise: 0.0,
        footprint: 0.0,
        mismatch: 0.0,
        centroid: 0.0,
        stiffness: 0.0,
        tolerance: Tolerance { point: 0.0, normal: 0.0 },
        precision: 0.0,
        detection: Hysteresis { begin: 0.0, end: 0.0, begin_readings: 0, end_readings: 0 },
        sampling: Sampling { window: 0, gap: 0, tare: 0, spread: 0 },
        drift: 0.0,
    };

    /// The same, if it makes sense.
    ///
    /// # Errors
    /// What is not finite, not positive where it must be, or out of order.
    pub fn checked(mut self) -> Result<Self, CalibrationError> {
        let positive = [
            self.noise,
            self.footprint,
            self.mismatch,
            self.centroid,
            self.stiffness,
            self.precision,
        ];
        if positive.iter().chain([&self.drift]).any(|v| !v.is_finite())
            || self.positions.iter().any(|p| !p.is_finite())
        {
            return Err(CalibrationError::NotFinite);
        }
        if positive.iter().any(|v| !(*v > 0.0)) {
            return Err(CalibrationError::NotPositive);
        }
        let (low, high) = self.range;
        if !(0.0..=1.0).contains(&self.drift) || low >= high || high >= self.full_scale {
            return Err(CalibrationError::Range);
        }
        self.fingertip = self.fingertip.checked()?;
        self.tolerance = self.tolerance.checked()?;
        self.detection = self.detection.checked()?;
        self.sampling = self.sampling.checked()?;
        Ok(self)
    }
}

/// The mean of the electrodes' positions, weighted by the magnitude of their changes: thesis 2.24.
/// `None` where nothing changed or a number is not finite.
///
/// It lies among the electrodes: drawn to their middle, to where they stand dense, and below the
/// skin.
pub fn centroid(
    changes: &[f32; ELECTRODES],
    positions: &[Vector<3>; ELECTRODES],
) -> Option<Vector<3>> {
    weighted_mean(changes.iter().map(|change| change.abs()).zip(positions.iter().copied()))
}

/// The mean of some positions, weighted.
fn weighted_mean(weighted: impl Iterator<Item = (f32, Vector<3>)>) -> Option<Vector<3>> {
    let (mut sum, mut all) = (Vector::<3>::ZERO, 0.0);
    for (weight, position) in weighted {
        sum += position * weight;
        all += weight;
    }
    let mean = sum * (1.0 / all);
    (all > 0.0 && mean.is_finite()).then_some(mean)
}

/// Electrodes that change by less than this share of the strongest say little about where it is.
const FAINT: f32 = 0.04;

/// Electrodes that change by less than this many standard deviations say nothing.
const NOISE_FLOOR: f32 = 4.0;

/// Mean squared misfit, in variances, above which one contact does not explain the changes.
const MISFIT: f32 = 6.0;

/// Contacts from the electrodes of a BioTac: taring, drift, averaging, detection; the centroid of
/// thesis 2.24; and from there to the centre of the bell that the changes form.
///
/// The centroid is biased: it depends on which electrodes there are. Near a contact at p the change
/// of an electrode at Xᵢ falls like A·exp(−|p − Xᵢ|²/2s²), so that ln eᵢ + |Xᵢ − q|²/2s² is linear
/// in the way from the centroid q to p whatever the layout, and least squares over it, with what is
/// known of the centroid as prior, give p and its covariance in one pass. Its residual tells whether
/// one bell explains the changes.
///
/// About two and a half kilobytes, all zero until configured.
///
/// ```
/// use tactile_core::sensing::{
///     ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, NoContact,
/// };
///
/// let mut estimator = ElectrodeEstimator::new();
/// estimator.configure(&ElectrodeSettings::BIOTAC).unwrap();
/// let (free, mut pressed) = ([3000; 19], [3000; 19]);
/// pressed[16] = 2000; // E17, in the middle of the pad
/// pressed[1] = 2800;
/// pressed[11] = 2800;
/// let mut last = Err(NoContact::Taring);
/// for time in 0..80 {
///     let words = if time < 64 { free } else { pressed };
///     last = estimator.estimate(&ElectrodeReading(words), 10_000 * time);
/// }
/// let touch = last.unwrap();
/// assert!(touch.point[1].abs() < 1e-5 && touch.normal[2] > 0.99);
/// ```
#[derive(Clone, Debug)]
pub struct ElectrodeEstimator {
    settings: ElectrodeSettings,
    configured: bool,
    taring: bool,
    /// The skin above each electrode.
    above: [Vector<3>; ELECTRODES],
    /// Words at rest.
    baseline: [f32; ELECTRODES],
    /// 1/R₀ of each electrode, over the divider's other arm.
    conductance: [f32; ELECTRODES],
    tare: Tare<ELECTRODES>,
    window: Window<ELECTRODES>,
    detector: Detector,
}

impl Default for ElectrodeEstimator {
    fn default() -> Self {
        Self::new()
    }
}

/// Which electrodes change by more than the noise, and by how much.
#[derive(Clone, Copy)]
struct Changes {
    /// Such electrodes, a bit each.
    set: u32,
    /// Sum of their relative changes.
    level: f32,
    largest: f32,
    /// One over the readings averaged.
    share: f32,
    /// Standard deviation of the average times the full scale, words².
    noise: f32,
}

impl Changes {
    /// The electrodes' numbers.
    fn electrodes(&self) -> impl Iterator<Item = usize> {
        let mut left = self.set;
        core::iter::from_fn(move || {
            let next = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (next < ELECTRODES).then_some(next)
        })
    }
}

impl ElectrodeEstimator {
    /// Knows nothing of its sensor.
    pub const fn new() -> Self {
        ElectrodeEstimator {
            settings: ElectrodeSettings::UNSET,
            configured: false,
            taring: false,
            above: [Vector([0.0; 3]); ELECTRODES],
            baseline: [0.0; ELECTRODES],
            conductance: [0.0; ELECTRODES],
            tare: Tare::new(),
            window: Window::new(),
            detector: Detector::new(),
        }
    }

    /// Takes settings over and begins to tare. Where they are refused nothing changes.
    ///
    /// # Errors
    /// See [`ElectrodeSettings::checked`]; [`CalibrationError::Range`] too where an electrode has no
    /// skin above it.
    pub fn configure(&mut self, settings: &ElectrodeSettings) -> Result<(), CalibrationError> {
        let settings = settings.checked()?;
        let mut above = settings.positions;
        for position in &mut above {
            let patch = settings.fingertip.project(*position).ok_or(CalibrationError::Range)?;
            *position = patch.point;
        }
        self.settings = settings;
        self.above = above;
        self.configured = true;
        self.tare();
        Ok(())
    }

    /// The words the electrodes give at rest, as far as is known.
    pub fn baseline(&self) -> [f32; ELECTRODES] {
        self.baseline
    }

    fn rest(&mut self, electrode: usize, word: f32) {
        self.baseline[electrode] = word;
        self.conductance[electrode] = word / (self.settings.full_scale as f32 - word);
    }

    #[inline]
    fn changes(&self) -> Changes {
        let share = 1.0 / self.window.count() as f32;
        let full = self.settings.full_scale as f32;
        // The baseline is as uncertain as the mean of the readings that made it.
        let variance = share + 1.0 / self.settings.sampling.tare as f32;
        let noise = self.settings.noise * math::sqrt(variance) * full;
        let floor = NOISE_FLOOR * noise;
        let mut changes = Changes { set: 0, level: 0.0, largest: 0.0, share, noise };
        for (k, (sum, conductance)) in self.window.sums().iter().zip(&self.conductance).enumerate()
        {
            // The change is R/R₀ − 1 = rise/w and its deviation noise·conductance/w², since
            // d(R/R₀)/dw = −(full/w)·(conductance/w): most electrodes rest and need no division.
            let word = *sum as f32 * share;
            let rise = (full - word) * conductance - word;
            if rise * word > floor * conductance {
                let value = rise / word;
                changes.set |= 1 << k;
                changes.level += value;
                changes.largest = math::max(changes.largest, value);
            }
        }
        changes
    }

    /// Relative change of one electrode, and its variance over its square.
    #[inline]
    fn change(&self, electrode: usize, changes: &Changes) -> (f32, f32) {
        let word = self.window.sums()[electrode] as f32 * changes.share;
        let conductance = self.conductance[electrode];
        let rise = (self.settings.full_scale as f32 - word) * conductance - word;
        let relative = changes.noise * conductance / (rise * word);
        (rise / word, relative * relative)
    }

    /// While nothing touches, the baseline goes after the words.
    fn follow(&mut self) {
        let rate = self.settings.drift;
        if rate > 0.0 {
            let share = 1.0 / self.window.count() as f32;
            for k in 0..ELECTRODES {
                let word = self.window.sums()[k] as f32 * share;
                self.rest(k, self.baseline[k] + rate * (word - self.baseline[k]));
            }
        }
    }

    /// The middle of the bell.
    #[inline]
    fn locate(&self, changes: &Changes) -> Result<Touch, NoContact> {
        let settings = &self.settings;
        let fingertip = &settings.fingertip;
        let rising = changes.electrodes().map(|k| (self.change(k, changes).0, self.above[k]));
        let mean = weighted_mean(rising).ok_or(NoContact::TooLight)?;
        let start = fingertip.project(mean).ok_or(NoContact::IllConditioned)?;
        let fit = self.fit(changes, &start);
        if fit.freedom > 0.0 && fit.misfit > MISFIT * fit.freedom {
            return Err(NoContact::Inconsistent);
        }
        let [u, v] = start.tangents;
        let point = start.point + u * fit.step[0] + v * fit.step[1];
        let patch = fingertip.project(point).ok_or(NoContact::NotFinite)?;
        if !fingertip.covers(patch.point) {
            return Err(NoContact::OutsideSkin);
        }
        if !(fit.spread[0] + fit.spread[2] <= settings.precision * settings.precision) {
            return Err(NoContact::IllConditioned);
        }
        // The start's tangents stand for the patch's, which are turned a little.
        let frame = Patch { tangents: start.tangents, outward: start.outward, ..start };
        let (covariance, normal_deviation) = spread_on(&frame, fit.spread, &settings.tolerance);
        Ok(Touch {
            time: self.window.middle(),
            point: patch.point,
            normal: -patch.outward,
            force: patch.outward * (-settings.stiffness * changes.level),
            covariance,
            normal_deviation,
            slip: None,
        })
    }

    /// Least squares for the bell's height and middle.
    #[inline]
    fn fit(&self, changes: &Changes, start: &Patch) -> Fit {
        let settings = &self.settings;
        let inverse = 1.0 / (settings.footprint * settings.footprint);
        let [u, v] = start.tangents;
        let (mut weight, mut used) = (0.0, 0.0);
        let (mut p, mut q, mut y) = (0.0, 0.0, 0.0);
        let (mut pp, mut pq, mut qq, mut py, mut qy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let floor = FAINT * changes.largest;
        let mismatch = settings.mismatch * settings.mismatch;
        for k in changes.electrodes() {
            let (change, doubt) = self.change(k, changes);
            if !(change > floor) {
                continue;
            }
            let away = self.above[k] - start.point;
            let w = 1.0 / (doubt + mismatch);
            let (a, b) = (inverse * u.dot(away), inverse * v.dot(away));
            let c = math::ln(change) + 0.5 * inverse * away.norm_squared();
            weight += w;
            used += 1.0;
            let (wa, wb, wc) = (w * a, w * b, w * c);
            p += wa;
            q += wb;
            y += wc;
            pp += wa * a;
            pq += wa * b;
            qq += wb * b;
            py += wa * c;
            qy += wb * c;
            yy += wc * c;
        }
        let scale = 1.0 / weight;
        pp -= p * p * scale;
        pq -= p * q * scale;
        qq -= q * q * scale;
        py -= p * y * scale;
        qy -= q * y * scale;
        yy -= y * y * scale;
        let prior = 1.0 / (settings.centroid * settings.centroid);
        let (a, b, c) = (pp + prior, pq, qq + prior);
        let scale = 1.0 / (a * c - b * b);
        let step = [scale * (c * py - b * qy), scale * (a * qy - b * py)];
        let [s, t] = step;
        let misfit = yy - 2.0 * (s * py + t * qy) + s * s * pp + 2.0 * s * t * pq + t * t * qq;
        Fit { step, spread: [c * scale, -b * scale, a * scale], misfit, freedom: used - 3.0 }
    }
}

/// Where the bell's middle is seen from the centroid.
struct Fit {
    /// Along both tangents, metres.
    step: [f32; 2],
    /// Its covariance, m².
    spread: [f32; 3],
    /// Squared residual in units of its variance, and how many such squares are expected.
    misfit: f32,
    freedom: f32,
}

impl ContactEstimator for ElectrodeEstimator {
    type Reading = ElectrodeReading;

    fn estimate(&mut self, reading: &ElectrodeReading, time: u32) -> Result<Touch, NoContact> {
        if !self.configured {
            return Err(NoContact::NotCalibrated);
        }
        let (low, high) = self.settings.range;
        if let Some(channel) = reading.0.iter().position(|w| *w <= low || *w >= high) {
            self.window.clear();
            return Err(NoContact::Saturated { channel: channel as u8 });
        }
        let words = reading.0.map(i32::from);
        let sampling = self.settings.sampling;
        if self.taring {
            if let Some(mean) = self.tare.push(&words, sampling.tare, sampling.spread) {
                for (k, word) in mean.into_iter().enumerate() {
                    self.rest(k, word);
                }
                self.taring = false;
            }
            return Err(NoContact::Taring);
        }
        self.window.push(&words, time, sampling.window, sampling.gap);
        let changes = self.changes();
        match self.detector.update(changes.level, &self.settings.detection) {
            Phase::Touching => self.locate(&changes),
            Phase::Free => {
                self.follow();
                Err(NoContact::TooLight)
            }
            Phase::Ending => Err(NoContact::TooLight),
            Phase::Beginning => Err(NoContact::Settling),
        }
    }

    fn tare(&mut self) {
        self.taring = true;
        self.tare = Tare::new();
        self.window.clear();
        self.detector = Detector::new();
    }
}
