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
    /// Share of what remains that the baseline takes over with each reading while nothing touches,
    /// and sixteen times as much of what all electrodes have in common, as when the fluid warms up:
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
    let (mut sum, mut all) = (Vector::<3>::ZERO, 0.0);
    for (change, position) in changes.iter().zip(positions) {
        sum += *position * change.abs();
        all += change.abs();
    }
    let mean = sum * (1.0 / all);
    (all > 0.0 && mean.is_finite()).then_some(mean)
}

/// Electrodes that change by less than this share of the strongest say little about where it is.
const FAINT: f32 = 0.04;

/// Electrodes that change by less than this many standard deviations say nothing.
const NOISE_FLOOR: f32 = 4.0;

/// How many times faster what all electrodes have in common is followed than each of them.
const COMMON: f32 = 16.0;

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
    tare: Tare<ELECTRODES>,
    window: Window<ELECTRODES>,
    detector: Detector,
}

impl Default for ElectrodeEstimator {
    fn default() -> Self {
        Self::new()
    }
}

/// Which electrodes' impedances rise by more than the noise, and by how much.
#[derive(Clone, Copy)]
struct Changes {
    /// Such electrodes, a bit each.
    set: u32,
    /// Sum of their relative changes, and the same of the skin's places above them times these.
    level: f32,
    moment: Vector<3>,
    largest: f32,
    /// By how much all impedances at rest exceed those of the baseline, relative to these.
    drift: f32,
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

/// What the readings averaged make of electrodes.
#[derive(Clone, Copy)]
struct Scale {
    /// One over their number.
    share: f32,
    full: f32,
    /// Standard deviation of a word less its baseline.
    noise: f32,
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

    /// What the electrodes say. A contact squeezes fluid under the rest of the skin, so that some
    /// electrodes always fall or stay. Where all rise, the fluid conducts worse: the least of their
    /// changes is the drift of all.
    #[inline]
    fn changes(&self, scale: &Scale) -> Changes {
        match self.changes_from(&self.baseline, scale) {
            (changes, false) => changes,
            (_, true) => self.changes_beyond_drift(scale),
        }
    }

    #[cold]
    #[inline(never)]
    fn changes_beyond_drift(&self, scale: &Scale) -> Changes {
        let Scale { share, full, .. } = *scale;
        let mut least = f32::INFINITY;
        for (sum, rest) in self.window.sums().iter().zip(&self.baseline) {
            let word = *sum as f32 * share;
            least = math::min(least, (full - word) * rest / (word * (full - rest)));
        }
        let drift = least - 1.0;
        let baseline = self.baseline.map(|rest| drifted(rest, full, drift));
        Changes { drift, ..self.changes_from(&baseline, scale).0 }
    }

    #[inline]
    fn scale(&self) -> Scale {
        let share = 1.0 / self.window.count() as f32;
        // The baseline is as uncertain as the mean of the readings that made it.
        let variance = share + 1.0 / self.settings.sampling.tare as f32;
        let noise = self.settings.noise * math::sqrt(variance);
        Scale { share, full: self.settings.full_scale as f32, noise }
    }

    /// The changes from words at rest, and whether all impedances rise.
    #[inline]
    fn changes_from(&self, baseline: &[f32; ELECTRODES], scale: &Scale) -> (Changes, bool) {
        let Scale { share, full, noise } = *scale;
        let floor = -NOISE_FLOOR * noise;
        let (moment, drift) = (Vector::ZERO, 0.0);
        let mut changes = Changes { set: 0, level: 0.0, moment, largest: 0.0, drift };
        let mut signs = u32::MAX;
        for (k, (sum, rest)) in self.window.sums().iter().zip(baseline).enumerate() {
            let word = *sum as f32 * share;
            let lift = word - rest;
            signs &= lift.to_bits();
            if lift < floor {
                let change = full * lift / (word * (rest - full));
                changes.set |= 1 << k;
                changes.level += change;
                changes.moment += self.above[k] * change;
                changes.largest = math::max(changes.largest, change);
            }
        }
        (changes, signs >> 31 == 1)
    }

    /// Relative change of an electrode that rises, and one over the variance of its logarithm.
    ///
    /// From rest w₀ to w the impedance changes by R/R₀ − 1 = full·(w − w₀)/(w·(w₀ − full)); the
    /// relative deviation of that is σ·w₀/((w − w₀)·w).
    #[inline]
    fn change(&self, electrode: usize, changes: &Changes, scale: &Scale) -> (f32, f32) {
        let Scale { share, full, noise } = *scale;
        let mut rest = self.baseline[electrode];
        if changes.drift > 0.0 {
            rest = drifted(rest, full, changes.drift);
        }
        let word = self.window.sums()[electrode] as f32 * share;
        let product = (word - rest) * word;
        let change = full * product / (word * word * (rest - full));
        let (doubt, product) = (noise * rest, self.settings.mismatch * product);
        let square = product * product;
        let variance = self.settings.mismatch * self.settings.mismatch;
        (change, square / ((doubt * doubt + square) * variance))
    }

    /// While nothing touches, the baseline goes after the words: each electrode's slowly, and what
    /// all have in common, as they do when the fluid warms up, faster, since it is better known.
    fn follow(&mut self) {
        let rate = self.settings.drift;
        if !(rate > 0.0) {
            return;
        }
        let share = 1.0 / self.window.count() as f32;
        let full = self.settings.full_scale as f32;
        // A word falls by this much as all impedances grow by their like.
        let response = |rest: f32| rest * (1.0 - rest * (1.0 / full));
        let (mut falls, mut responses) = (0.0, 0.0);
        for (sum, rest) in self.window.sums().iter().zip(&self.baseline) {
            falls += rest - *sum as f32 * share;
            responses += response(*rest);
        }
        // Bounded, so that words at rest stay inside the range of words.
        let common = math::max(math::min(falls / responses, 0.5), -0.5);
        let common = math::min(COMMON * rate, 1.0) * common;
        for (sum, rest) in self.window.sums().iter().zip(&mut self.baseline) {
            let moved = *rest - common * response(*rest);
            *rest = moved + rate * (*sum as f32 * share - moved);
        }
    }

    /// The middle of the bell.
    #[inline]
    fn locate(&self, changes: &Changes, scale: &Scale) -> Result<Touch, NoContact> {
        let settings = &self.settings;
        let fingertip = &settings.fingertip;
        // The centroid of what rises; of nothing it is NaN.
        let mean = changes.moment * (1.0 / changes.level);
        let start = fingertip.project(mean).ok_or(NoContact::IllConditioned)?;
        let fit = self.fit(changes, scale, &start);
        if fit.freedom > 0.0 && fit.misfit > MISFIT * fit.freedom {
            return Err(NoContact::Inconsistent);
        }
        let [u, v] = start.tangents;
        let point = start.point + u * fit.step[0] + v * fit.step[1];
        let (point, outward) = fingertip.foot(point).ok_or(NoContact::NotFinite)?;
        if !fingertip.covers(point) {
            return Err(NoContact::OutsideSkin);
        }
        if !(fit.spread[0] + fit.spread[2] <= settings.precision * settings.precision) {
            return Err(NoContact::IllConditioned);
        }
        // The start's tangents stand for the point's, which are turned a little.
        let (covariance, normal_deviation) = spread_on(&start, fit.spread, &settings.tolerance);
        Ok(Touch {
            time: self.window.middle(),
            point,
            normal: -outward,
            force: outward * (-settings.stiffness * changes.level),
            covariance,
            normal_deviation,
            slip: None,
        })
    }

    /// Least squares for the bell's height and middle.
    #[inline]
    fn fit(&self, changes: &Changes, scale: &Scale, start: &Patch) -> Fit {
        let settings = &self.settings;
        let inverse = 1.0 / (settings.footprint * settings.footprint);
        let [u, v] = start.tangents;
        let (mut weight, mut used) = (0.0, 0.0);
        let (mut p, mut q, mut y) = (0.0, 0.0, 0.0);
        let (mut pp, mut pq, mut qq, mut py, mut qy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let floor = FAINT * changes.largest;
        for k in changes.electrodes() {
            let (change, w) = self.change(k, changes, scale);
            if !(change > floor) {
                continue;
            }
            let away = self.above[k] - start.point;
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

/// The word of an electrode at `rest` when its impedance has grown by `drift`, relatively.
#[inline]
fn drifted(rest: f32, full: f32, drift: f32) -> f32 {
    full * rest / (full + drift * (full - rest))
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
        // Strictly between both ends, in one comparison.
        let (low, high) = (u32::from(self.settings.range.0), u32::from(self.settings.range.1));
        let (first, count) = (low + 1, high.saturating_sub(low + 1));
        let outside = |word: &u16| u32::from(*word).wrapping_sub(first) >= count;
        if let Some(channel) = reading.0.iter().position(outside) {
            self.window.clear();
            return Err(NoContact::Saturated { channel: channel as u8 });
        }
        let words = reading.0.map(i32::from);
        let sampling = self.settings.sampling;
        if self.taring {
            if let Some(mean) = self.tare.push(&words, sampling.tare, sampling.spread) {
                self.baseline = mean;
                self.taring = false;
            }
            return Err(NoContact::Taring);
        }
        self.window.push(&words, time, sampling.window, sampling.gap);
        let scale = self.scale();
        let changes = self.changes(&scale);
        match self.detector.update(changes.level, &self.settings.detection) {
            Phase::Touching => self.locate(&changes, &scale),
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
