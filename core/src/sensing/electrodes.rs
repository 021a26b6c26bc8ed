//! An array of electrodes under a fluid-filled skin: impedances to contacts.

use super::detection::{Detector, Held, Phase, Sampling, Tare, Window};
use super::fingertip::Patch;
use super::{
    CalibrationError, ContactEstimator, ELECTRODES, ElectrodeReading, NoContact, Touch, spread_on,
};
use crate::math;
use crate::matrix::{Coordinates, Vector};

mod settings;

pub use settings::{BIOTAC_CORE, BIOTAC_SKIN, ElectrodeSettings};

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

/// Electrodes that change by less than a share of the strongest say little about where it is: the
/// logarithm of 4 %.
const FAINT: f32 = -3.218_876;

/// Electrodes that change by less than this many standard deviations say nothing.
const NOISE_FLOOR: f32 = 4.0;

/// How many times faster what all electrodes have in common is followed than each of them.
const COMMON: f32 = 16.0;

/// Mean squared misfit, in variances, above which one contact does not explain the changes.
const MISFIT: f32 = 6.0;

/// Contacts from the electrodes of a BioTac: taring, drift, averaging, detection, and the centre of
/// the bell that the changes form on the skin.
///
/// The centroid of thesis 2.24 ([`centroid`]) is biased: it depends on which electrodes there are.
/// Near a contact at p the change eᵢ of an electrode at Xᵢ falls like A·exp(−|p − Xᵢ|²/2s²), so that
/// ln eᵢ + |Xᵢ − q|²/2s² is linear in the way from any place q to p whatever the layout. Least
/// squares over it about the electrode that changes most, with how far contacts stray from there as
/// prior, give p and its covariance in one pass. The residual tells whether one bell explains the
/// changes.
///
/// Not quite four kilobytes, all zero until configured.
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
    fit: Terms,
    /// The skin above each electrode.
    above: [Patch; ELECTRODES],
    sites: [Site; ELECTRODES],
    /// Words at rest.
    baseline: [f32; ELECTRODES],
    tare: Tare<ELECTRODES>,
    window: Window<ELECTRODES>,
    scale: Scale,
    /// Of the electrodes that rise.
    rises: [Rise; ELECTRODES],
    detector: Detector,
    held: Held,
}

impl Default for ElectrodeEstimator {
    fn default() -> Self {
        Self::new()
    }
}

/// What the settings alone make of the fit.
#[derive(Clone, Copy, Debug)]
struct Terms {
    /// One over the squares of footprint and stray, per m².
    bell: f32,
    prior: f32,
    /// The squared mismatch.
    mismatch: f32,
    /// Words that creeping impedances move an electrode by in a second at most: in the middle of
    /// the range.
    creep: f32,
}

/// What the fit needs of the skin above an electrode, in one place.
#[derive(Clone, Copy, Debug)]
struct Site {
    /// Metres.
    point: [f32; 3],
    /// Half its squared distance from the origin over that of the footprint.
    square: f32,
}

/// What the readings averaged and the baseline make of electrodes; renewed where these change.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// Readings averaged, and one over their number.
    count: u8,
    share: f32,
    full: f32,
    /// Standard deviation of a word less its baseline.
    noise: f32,
    /// An electrode whose words add up to less rises by more than the noise.
    limits: [i32; ELECTRODES],
}

/// An electrode whose impedance rises.
#[derive(Clone, Copy, Debug)]
struct Rise {
    /// Logarithm of its relative change, but for a constant.
    log: f32,
    /// One over the variance of that.
    weight: f32,
}

/// Which electrodes' impedances rise by more than the noise.
#[derive(Clone, Copy)]
struct Changes {
    /// Such electrodes, a bit each.
    set: u32,
    /// Sum of their relative changes.
    level: f32,
    /// The electrode that changes most, and the logarithm of its change.
    strongest: usize,
    largest: f32,
}

/// A bit for every electrode.
const ALL: u32 = (1 << ELECTRODES) - 1;

/// The electrodes' numbers of a set.
#[inline(always)]
fn members(set: u32) -> impl Iterator<Item = usize> {
    let mut left = set;
    core::iter::from_fn(move || {
        let next = left.trailing_zeros() as usize;
        left &= left.wrapping_sub(1);
        (next < ELECTRODES).then_some(next)
    })
}

impl ElectrodeEstimator {
    /// Knows nothing of its sensor.
    pub const fn new() -> Self {
        ElectrodeEstimator {
            settings: ElectrodeSettings::UNSET,
            configured: false,
            taring: false,
            fit: Terms { bell: 0.0, prior: 0.0, mismatch: 0.0, creep: 0.0 },
            above: [Patch::UNSET; ELECTRODES],
            sites: [Site { point: [0.0; 3], square: 0.0 }; ELECTRODES],
            baseline: [0.0; ELECTRODES],
            tare: Tare::new(),
            window: Window::new(),
            scale: Scale { count: 0, share: 0.0, full: 0.0, noise: 0.0, limits: [0; ELECTRODES] },
            rises: [Rise { log: 0.0, weight: 0.0 }; ELECTRODES],
            detector: Detector::new(),
            held: Held::new(),
        }
    }

    /// Takes settings over and begins to tare. Where they are refused nothing changes.
    ///
    /// # Errors
    /// See [`ElectrodeSettings::checked`]; [`CalibrationError::Range`] too where an electrode has no
    /// skin above it.
    pub fn configure(&mut self, settings: &ElectrodeSettings) -> Result<(), CalibrationError> {
        let settings = settings.checked()?;
        let mut above = [Patch::UNSET; ELECTRODES];
        for (patch, position) in above.iter_mut().zip(&settings.positions) {
            *patch = settings.fingertip.project(*position).ok_or(CalibrationError::Range)?;
        }
        self.fit = Terms {
            bell: 1.0 / (settings.footprint * settings.footprint),
            prior: 1.0 / (settings.stray * settings.stray),
            mismatch: settings.mismatch * settings.mismatch,
            creep: 0.25 * settings.creep * f32::from(settings.full_scale),
        };
        self.sites = above.map(|patch| {
            let square = 0.5 * self.fit.bell * patch.point.norm_squared();
            Site { point: patch.point.0, square }
        });
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

    /// Takes the words into the window. Which electrodes rise, or the first whose word is not
    /// credible.
    #[inline]
    fn take(&mut self, reading: &ElectrodeReading, time: u32) -> Result<u32, usize> {
        let Sampling { window, gap, .. } = self.settings.sampling;
        if !self.is_credible(reading) {
            return Err(self.outside(reading).unwrap_or(0));
        }
        let limits = &self.scale.limits;
        let word = |k: usize| i32::from(reading.0[k]);
        // Negative differences, whose highest bit is set, tell without a branch. In the end that of
        // the last electrode is the highest.
        let set = self.window.push_each(word, time, window, gap, 0, |set: u32, k, sum| {
            set >> 1 | (sum.wrapping_sub(limits[k]) as u32 & 1 << 31)
        });
        let mut set = set >> (u32::BITS - ELECTRODES as u32);
        if self.window.count() != self.scale.count {
            self.rescale();
            set = self.risen(&self.baseline);
        }
        Ok(set)
    }

    /// Whether all words lie strictly between both ends. Two at a time, in the halves of a register:
    /// their highest bits tell.
    #[inline(never)]
    fn is_credible(&self, reading: &ElectrodeReading) -> bool {
        const BOTH: u32 = 0x1_0001;
        const HIGHEST: u32 = 0x8000 * BOTH;
        let (low, high) = self.settings.range;
        // What is added carries words from `high` on, and no others, to the highest bit; what is
        // taken away borrows it from words up to `low`.
        let (add, take) = (BOTH * (0x8000 - u32::from(high)), BOTH * (u32::from(low) + 1));
        let mut wrong = 0;
        let mut look = |words: u32| {
            wrong |= words | words.wrapping_add(add) | !(words | HIGHEST).wrapping_sub(take);
        };
        let (pairs, rest) = reading.0.as_chunks();
        for [first, second] in pairs {
            look(u32::from(*first) | u32::from(*second) << 16);
        }
        for word in rest {
            look(BOTH * u32::from(*word));
        }
        wrong & HIGHEST == 0
    }

    /// The first electrode whose word does not lie strictly between both ends.
    #[cold]
    fn outside(&self, reading: &ElectrodeReading) -> Option<usize> {
        let (low, high) = self.settings.range;
        reading.0.iter().position(|word| *word <= low || *word >= high)
    }

    /// What follows from the window's length and from the baseline.
    #[inline(never)]
    fn rescale(&mut self) {
        let count = self.window.count();
        let share = 1.0 / f32::from(count.max(1));
        // The baseline is as uncertain as the mean of the readings that made it.
        let variance = share + 1.0 / f32::from(self.settings.sampling.tare);
        self.scale.count = count;
        self.scale.share = share;
        self.scale.full = f32::from(self.settings.full_scale);
        self.scale.noise = self.settings.noise * math::sqrt(variance);
        self.limit();
    }

    /// The sums below which electrodes rise.
    fn limit(&mut self) {
        let floor = NOISE_FLOOR * self.scale.noise;
        let count = f32::from(self.scale.count);
        for (limit, rest) in self.scale.limits.iter_mut().zip(&self.baseline) {
            // The next whole number.
            let bound = count * (*rest - floor);
            let whole = bound as i32;
            *limit = whole + i32::from((whole as f32) < bound);
        }
    }

    /// Which electrodes rise above a baseline.
    #[cold]
    #[inline(never)]
    fn risen(&self, baseline: &[f32; ELECTRODES]) -> u32 {
        let Scale { share, noise, .. } = self.scale;
        let mut set = 0;
        for (k, (sum, rest)) in self.window.sums().iter().zip(baseline).enumerate() {
            let fall = rest - *sum as f32 * share;
            set |= u32::from(fall > NOISE_FLOOR * noise) << k;
        }
        set
    }

    /// What the electrodes say. A contact squeezes fluid under the rest of the skin, so that some
    /// electrodes always fall or stay. Where all rise, the fluid conducts worse: the least of their
    /// changes is the drift of all.
    #[inline]
    fn changes(&mut self, set: u32) -> Changes {
        let share = self.scale.share;
        let falls = |k: usize| (self.window.sums()[k] as f32 * share) < self.baseline[k];
        if members(ALL & !set).all(falls) { self.changes_beyond_drift() } else { self.rise(set) }
    }

    #[cold]
    #[inline(never)]
    fn changes_beyond_drift(&mut self) -> Changes {
        let Scale { share, full, .. } = self.scale;
        let mut least = f32::INFINITY;
        for (sum, rest) in self.window.sums().iter().zip(&self.baseline) {
            let word = *sum as f32 * share;
            least = math::min(least, (full - word) * rest / (word * (full - rest)));
        }
        let drift = least - 1.0;
        // The word of an electrode when its impedance has grown by the drift, relatively.
        let drifted = self.baseline.map(|rest| full * rest / (full + drift * (full - rest)));
        let baseline = core::mem::replace(&mut self.baseline, drifted);
        let changes = self.rise(self.risen(&self.baseline));
        self.baseline = baseline;
        changes
    }

    /// How far the electrodes of a set rise, and how surely.
    ///
    /// From rest w₀ to w the impedance changes by R/R₀ − 1 = full·(w₀ − w)/(w·(full − w₀)); the
    /// relative deviation of that is σ·w₀/((w₀ − w)·w).
    #[inline]
    fn rise(&mut self, set: u32) -> Changes {
        let Scale { share, full, noise, .. } = self.scale;
        let Terms { mismatch, creep, .. } = self.fit;
        let crept = creep * self.held.seconds();
        let noise = noise * noise + crept * crept;
        let mut changes = Changes { set, level: 0.0, strongest: 0, largest: f32::MIN };
        for k in members(set) {
            let (word, rest) = (self.window.sums()[k] as f32 * share, self.baseline[k]);
            let (fall, left) = (rest - word, word * (full - rest));
            let product = fall * word;
            let square = product * product;
            let variance = noise * (rest * rest) + mismatch * square;
            // One division for both.
            let inverse = 1.0 / (left * variance);
            // Over full scale, which adds a constant to all logarithms.
            let change = fall * (variance * inverse);
            let log = log(change);
            self.rises[k] = Rise { log, weight: square * (left * inverse) };
            changes.level += change;
            if log > changes.largest {
                (changes.strongest, changes.largest) = (k, log);
            }
        }
        changes.level *= full;
        changes
    }

    /// A reading for the tare.
    #[cold]
    fn settle(&mut self, reading: &ElectrodeReading) -> NoContact {
        if let Some(channel) = self.outside(reading) {
            self.tare = Tare::new();
            return NoContact::Saturated { channel: channel as u8 };
        }
        let Sampling { tare, spread, .. } = self.settings.sampling;
        if let Some(mean) = self.tare.push(&reading.0.map(i32::from), tare, spread) {
            self.baseline = mean;
            self.taring = false;
        }
        NoContact::Taring
    }

    /// While nothing touches, the baseline goes after the words: each electrode's slowly, and what
    /// all have in common, as they do when the fluid warms up, faster, since it is better known.
    fn follow(&mut self) {
        let rate = self.settings.drift;
        if !(rate > 0.0) {
            return;
        }
        let Scale { share, full, .. } = self.scale;
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
        self.limit();
    }

    /// The middle of the bell.
    #[inline]
    fn locate(&self, changes: &Changes) -> Result<Touch, NoContact> {
        let settings = &self.settings;
        let fingertip = &settings.fingertip;
        let start = &self.above[changes.strongest];
        let fit = self.fit(changes, start);
        if fit.freedom > 0.0 && fit.misfit > MISFIT * fit.freedom * fit.weight {
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
        let (covariance, normal_deviation) = spread_on(start, fit.spread, &settings.tolerance);
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
    fn fit(&self, changes: &Changes, start: &Patch) -> Fit {
        let Terms { bell, prior, .. } = self.fit;
        let [u, v] = start.tangents;
        let (mut weight, mut used) = (0.0, 0);
        let (mut p, mut q, mut r) = (0.0, 0.0, 0.0);
        let (mut pp, mut pq, mut qq, mut pr, mut qr, mut rr) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let floor = changes.largest + FAINT;
        // Of the distances from the start, what is the same for all electrodes is left out: the
        // bell's height takes it.
        let (along, across, towards) = (u * bell, v * bell, start.point * bell);
        for k in members(changes.set) {
            let Rise { log, weight: w } = self.rises[k];
            if !(log > floor) {
                continue;
            }
            let Site { point: [x, y, z], square } = self.sites[k];
            let a = along[0] * x + along[1] * y + along[2] * z;
            let b = across[0] * x + across[1] * y + across[2] * z;
            let c = log + (square - (towards[0] * x + towards[1] * y + towards[2] * z));
            weight += w;
            used += 1;
            let (wa, wb, wc) = (w * a, w * b, w * c);
            p += wa;
            q += wb;
            r += wc;
            pp += wa * a;
            pq += wa * b;
            qq += wb * b;
            pr += wa * c;
            qr += wb * c;
            rr += wc * c;
        }
        // The height's elimination, times the weight: one division for all.
        pp = weight * pp - p * p;
        pq = weight * pq - p * q;
        qq = weight * qq - q * q;
        pr = weight * pr - p * r;
        qr = weight * qr - q * r;
        rr = weight * rr - r * r;
        let prior = weight * prior;
        let (a, b, c) = (pp + prior, pq, qq + prior);
        let scale = 1.0 / (a * c - b * b);
        let step = [scale * (c * pr - b * qr), scale * (a * qr - b * pr)];
        let [s, t] = step;
        let misfit = rr - 2.0 * (s * pr + t * qr) + s * s * pp + 2.0 * s * t * pq + t * t * qq;
        let scale = weight * scale;
        let spread = [c * scale, -b * scale, a * scale];
        Fit { step, spread, misfit, weight, freedom: (used - 3) as f32 }
    }
}

/// Natural logarithm of a positive normal number, absolute error below 9·10⁻⁵: changes are known to
/// a few percent. A third of [`math::ln`], which knows special cases and divides.
#[inline(always)]
pub(super) fn log(x: f32) -> f32 {
    // x = m · 2ᵉ with m in [√½, √2).
    let bits = x.to_bits().wrapping_sub(0x3f35_04f3);
    let t = f32::from_bits((bits & 0x007f_ffff) + 0x3f35_04f3) - 1.0;
    let e = (bits as i32 >> 23) as f32;
    let [zeroth, first, second, third, fourth] = LOG;
    let z = t * t;
    e * core::f32::consts::LN_2 + zeroth + t * first + z * (second + t * third + z * fourth)
}

/// The polynomial in t that is nearest to ln(1 + t) where √½ ≤ 1 + t < √2.
const LOG: [f32; 5] = [4.547722e-05, 0.9994026, -0.5040479, 0.3574114, -0.2174837];

/// Where the bell's middle is seen from the strongest electrode.
struct Fit {
    /// Along both tangents, metres.
    step: [f32; 2],
    /// Its covariance, m².
    spread: [f32; 3],
    /// Squared residual in units of its variance, times the weight of all electrodes; and how many
    /// such squares are expected.
    misfit: f32,
    weight: f32,
    freedom: f32,
}

impl ContactEstimator for ElectrodeEstimator {
    type Reading = ElectrodeReading;

    fn estimate(&mut self, reading: &ElectrodeReading, time: u32) -> Result<Touch, NoContact> {
        if !self.configured {
            return Err(NoContact::NotCalibrated);
        }
        if self.taring {
            self.held.pass(time);
            self.held.release();
            return Err(self.settle(reading));
        }
        let set = match self.take(reading, time) {
            Ok(set) => set,
            Err(channel) => {
                self.window.clear();
                return Err(NoContact::Saturated { channel: channel as u8 });
            }
        };
        self.held.pass(time);
        let changes = self.changes(set);
        match self.detector.update(changes.level, &self.settings.detection) {
            Phase::Touching => self.locate(&changes),
            Phase::Free => {
                self.held.release();
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
        self.scale.count = 0;
        self.detector = Detector::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What whole numbers say without a branch is what the definition says.
    #[test]
    fn which_electrodes_rise_is_told_by_whole_numbers() {
        let mut estimator = ElectrodeEstimator::new();
        estimator.configure(&ElectrodeSettings::BIOTAC).unwrap();
        estimator.baseline = core::array::from_fn(|k| 2500.0 + 37.0 * k as f32);
        let mut state = 1u32;
        let mut some = 0;
        for time in 0..200 {
            let words = core::array::from_fn(|k| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (2200 + 37 * k as u32 + (state >> 16) % 600) as u16
            });
            let set = estimator.take(&ElectrodeReading(words), 1000 * time).unwrap();
            assert_eq!(set, estimator.risen(&estimator.baseline), "{time}");
            some += u32::from(set != 0 && set != ALL);
        }
        assert!(some > 100);
    }
}
