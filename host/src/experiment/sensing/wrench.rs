//! Contacts from a force/torque transducer: error against force, and whether its covariance is
//! honest.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;
use tactile_core::sensing::calibration::{CalibrationError, GaugeCalibration};
use tactile_core::sensing::detection::Hysteresis;
use tactile_core::sensing::{
    ContactEstimator, GaugeReading, NoContact, Tolerance, Touch, WrenchEstimator, WrenchSettings,
};

use super::single::{Hold, Search};
use super::{Miss, fingertip, rms};
use crate::sim::random::Random;
use crate::sim::sensors::gauges::{FULL_SCALE, Options, WORD};
use crate::sim::sensors::{Push, Skin, Transducer};
use crate::space::Point;

/// Skins that are pressed, metres.
const SKINS: [(&str, Skin); 2] = [
    ("ellipsoid 24 × 18 × 16 mm", Skin::Ellipsoid([12e-3, 9e-3, 8e-3])),
    ("cylinder ⌀ 16 mm with cap", Skin::Finger { radius: 8e-3, length: 0.02 }),
];

/// Newtons.
const FORCES: [f64; 9] = [0.05, 0.1, 0.15, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// Readings averaged.
const WINDOWS: [u8; 2] = [1, 8];

/// Pushes per seed, skin, force and window.
const PUSHES: usize = 100;

/// Tangential force over normal force, and torsion per newton (metres), at most.
const SLIDE: f64 = 0.5;
const TWIST: f64 = 1e-3;

/// Pairs of pushes per seed and skin.
const PAIRS: usize = 25;

/// What a contact is taken to hold when pairs are judged: the usual settings, and exactly what the
/// pushes use.
const HOLDS: [Hold; 2] =
    [Hold { friction: 1.2, torsion: 2e-3 }, Hold { friction: SLIDE, torsion: TWIST }];

/// Standard deviations beyond which a wrench is not explained.
const BEYOND: f64 = 3.0;

/// Between readings, seconds.
const STEP: f64 = 1e-3;

/// One skin, force and window over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Which skin.
    pub skin: &'static str,
    /// Normal force, newtons.
    pub newtons: f64,
    /// Readings averaged.
    pub window: u8,
    /// Pushes.
    pub pushes: usize,
    /// Share that an estimator with its usual thresholds reports.
    pub reported: f64,
    /// Root mean square error of the contact point over those, millimetres; `None` of none.
    pub reported_mm: Option<f64>,
    /// Root mean square error of the point without any threshold, millimetres.
    pub point_mm: f64,
    /// The same of the normal, degrees.
    pub normal_deg: f64,
    /// Mean error along the skin squared, in units of its covariance: two if that is honest.
    pub squared: f64,
    /// Half width of the 95 % band around two for as many independent errors.
    pub band: f64,
}

/// What two contacts at once give.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Several {
    /// What a contact is taken to hold: coefficient of friction, and torsion per newton, millimetres.
    pub friction: f64,
    /// See `friction`.
    pub torsion_mm: f64,
    /// Pairs of pushes of 1 N at random points at least 8 mm apart.
    pub pairs: usize,
    /// Share refused as inconsistent or off the skin.
    pub refused: f64,
    /// Share that no single contact explains within three standard deviations, by a search of its
    /// own: no estimator can tell more of them from single contacts by one reading.
    pub bound: f64,
}

/// The whole experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// In order of skin, window, force.
    pub rows: Vec<Row>,
    /// Per skin.
    pub several: Vec<(&'static str, Several)>,
}

/// Presses both skins with all forces.
///
/// # Errors
/// None but those of a sensor that cannot be calibrated, which these can.
pub fn run(seeds: u64) -> Result<Table, CalibrationError> {
    let mut rows = Vec::new();
    let mut several = Vec::new();
    for (name, skin) in SKINS {
        for window in WINDOWS {
            for newtons in FORCES {
                let pushes: Vec<Pressed> = (0..seeds)
                    .into_par_iter()
                    .map(|seed| press(&skin, newtons, window, seed))
                    .collect::<Result<Vec<_>, _>>()?
                    .into_iter()
                    .flatten()
                    .collect();
                rows.push(row(name, newtons, window, &pushes));
            }
        }
        for hold in HOLDS {
            let pairs: Vec<Pair> = (0..seeds)
                .into_par_iter()
                .map(|seed| pairs(&skin, hold, seed))
                .collect::<Result<Vec<_>, _>>()?
                .into_iter()
                .flatten()
                .collect();
            let share = |is: fn(&Pair) -> bool| {
                pairs.iter().filter(|pair| is(pair)).count() as f64 / pairs.len() as f64
            };
            several.push((
                name,
                Several {
                    friction: hold.friction,
                    torsion_mm: 1e3 * hold.torsion,
                    pairs: pairs.len(),
                    refused: share(|pair| pair.refused),
                    bound: share(|pair| pair.impossible),
                },
            ));
        }
    }
    Ok(Table { rows, several })
}

/// Two pushes at once: whether the estimator refuses them, and whether no single contact could be
/// the cause.
struct Pair {
    refused: bool,
    impossible: bool,
}

/// One push: what an estimator without thresholds makes of it, and whether one with them reports it.
struct Pressed {
    miss: Option<Miss>,
    reported: bool,
}

fn row(skin: &'static str, newtons: f64, window: u8, pushes: &[Pressed]) -> Row {
    let misses = || pushes.iter().filter_map(|p| p.miss);
    let reported = || pushes.iter().filter(|p| p.reported).filter_map(|p| p.miss);
    let count = misses().count() as f64;
    Row {
        skin,
        newtons,
        window,
        pushes: pushes.len(),
        reported: reported().count() as f64 / pushes.len() as f64,
        reported_mm: (reported().count() > 0).then(|| 1e3 * rms(reported().map(|m| m.point))),
        point_mm: 1e3 * rms(misses().map(|m| m.point)),
        normal_deg: rms(misses().map(|m| m.normal)).to_degrees(),
        squared: misses().map(|m| m.squared).sum::<f64>() / count,
        // Of the mean of n exponential numbers, which a squared error in two directions is.
        band: 2.0 * 1.96 / count.sqrt(),
    }
}

/// A transducer and its estimator, tared; thresholds as usual, or none.
struct Bench {
    transducer: Transducer,
    estimator: WrenchEstimator,
    /// Microseconds.
    time: u32,
}

impl Bench {
    fn new(
        skin: &Skin,
        window: u8,
        thresholds: bool,
        seed: u64,
    ) -> Result<Bench, CalibrationError> {
        Self::holding(skin, window, thresholds, HOLDS[0], seed)
    }

    fn holding(
        skin: &Skin,
        window: u8,
        thresholds: bool,
        hold: Hold,
        seed: u64,
    ) -> Result<Bench, CalibrationError> {
        let transducer = Transducer::new(Options::default(), seed);
        let matrix = transducer.calibration().ok_or(CalibrationError::Singular)?;
        let gauges = GaugeCalibration::new(
            matrix.map(|row| row.map(|v| v as f32)),
            (-WORD as i32 - 1, WORD as i32),
            FULL_SCALE.map(|v| v as f32),
        )?;
        let mut settings = WrenchSettings::nano17(gauges, fingertip(skin));
        settings.sampling.window = window;
        (settings.friction, settings.torsion) = (hold.friction as f32, hold.torsion as f32);
        settings.detection.begin_readings = 1;
        if !thresholds {
            // The skin is exactly what the estimator takes it for.
            settings.tolerance = Tolerance { point: 0.0, normal: 0.0 };
            settings.detection = Hysteresis { begin: 1e-3, end: 1e-3, ..settings.detection };
            settings.precision = 1.0;
            // Who feels the slightest force never sees its zero, which stays where it is here.
            settings.creep = 0.0;
        }
        let mut estimator = WrenchEstimator::new();
        estimator.configure(&settings)?;
        let mut bench = Bench { transducer, estimator, time: 0 };
        while bench.read(&[]) == Err(NoContact::Taring) {}
        Ok(bench)
    }

    fn read(&mut self, pushes: &[Push]) -> Result<Touch, NoContact> {
        self.time = self.time.wrapping_add((1e6 * STEP) as u32);
        let words = self.transducer.sample(pushes, Point::zeros(), STEP);
        self.estimator.estimate(&GaugeReading(words), self.time)
    }

    /// What is felt once a window of readings was taken under the pushes.
    fn feel(&mut self, pushes: &[Push], window: u8) -> Result<Touch, NoContact> {
        self.pause();
        let mut felt = Err(NoContact::TooLight);
        for _ in 0..window {
            felt = self.read(pushes);
        }
        felt
    }

    /// So that nothing from before is averaged.
    fn pause(&mut self) {
        self.time = self.time.wrapping_add(1_000_000);
    }

    /// Free for long enough that it is believed.
    fn rest(&mut self) {
        self.pause();
        for _ in 0..4 {
            let _free = self.read(&[]);
        }
    }
}

fn press(
    skin: &Skin,
    newtons: f64,
    window: u8,
    seed: u64,
) -> Result<Vec<Pressed>, CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0x5eed);
    let mut bare = Bench::new(skin, window, false, seed)?;
    let mut usual = Bench::new(skin, window, true, seed)?;
    let one = |_| {
        let push = push(skin, newtons, &mut random);
        let felt = bare.feel(&[push], window);
        // The sensors are one and the same, so that their noise is too.
        let reported = usual.feel(&[push], window).is_ok();
        bare.rest();
        usual.rest();
        Pressed { miss: felt.ok().map(|touch| Miss::of(&touch, &push)), reported }
    };
    Ok((0..PUSHES).map(one).collect())
}

fn push(skin: &Skin, newtons: f64, random: &mut Random) -> Push {
    let at = skin.sample(random);
    let slide = SLIDE * random.unit();
    let along = random.direction(3);
    Push::new(at, newtons, slide, along).twisted(random.around_zero(TWIST * newtons))
}

fn pairs(skin: &Skin, hold: Hold, seed: u64) -> Result<Vec<Pair>, CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0x9a14);
    let mut bench = Bench::holding(skin, 8, true, hold, seed)?;
    // Of eight readings and a tare.
    let share = 1.0 / 8.0 + 1.0 / f64::from(WrenchSettings::NANO17_SAMPLING.tare);
    let noise = FULL_SCALE.map(|full| Options::default().noise * full * share.sqrt());
    let search = Search::new(skin, hold, noise);
    let mut pairs = Vec::new();
    while pairs.len() < PAIRS {
        let two = [push(skin, 1.0, &mut random), push(skin, 1.0, &mut random)];
        if (two[0].point - two[1].point).norm() < 8e-3 {
            continue;
        }
        let refused = bench.feel(&two, 8).is_err();
        let [a, b] = two.map(|push| push.wrench());
        let both = std::array::from_fn(|k| a[k] + b[k]);
        let impossible = search.distance(&both, BEYOND) > 0.0;
        pairs.push(Pair { refused, impossible });
        bench.rest();
    }
    Ok(pairs)
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Contacts from a Nano17 with 0.3 % of full scale noise (thesis: 2.2 mm, 8°)")?;
        writeln!(
            f,
            "  {:<28}{:>7}{:>8}{:>9}{:>10}{:>12}{:>10}{:>10}{:>16}",
            "skin",
            "window",
            "force N",
            "pushes",
            "reported",
            "of these mm",
            "point mm",
            "normal °",
            "normalised ²"
        )?;
        for r in &self.rows {
            writeln!(
                f,
                "  {:<28}{:>7}{:>8.2}{:>9}{:>8.1} %{:>12}{:>10.3}{:>10.2}{:>9.2} (2 ± {:.2})",
                r.skin,
                r.window,
                r.newtons,
                r.pushes,
                100.0 * r.reported,
                r.reported_mm.map_or("–".into(), |v| format!("{v:.3}")),
                r.point_mm,
                r.normal_deg,
                r.squared,
                r.band,
            )?;
        }
        for (skin, s) in &self.several {
            writeln!(
                f,
                "  {skin}, friction {} and {} mm: of {} pairs of contacts at once, {:.0} % refused; \
                 no single one explains {:.0} %",
                s.friction,
                s.torsion_mm,
                s.pairs,
                100.0 * s.refused,
                100.0 * s.bound
            )?;
        }
        write!(f, "  root mean squares; goal at 1 N: 0.5 mm and 2.5°")
    }
}
