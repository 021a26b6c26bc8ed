//! An hour in which a fingertip warms up or cools down: contacts with and without following the
//! bias, or the baseline, while nothing touches.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;
use tactile_core::sensing::calibration::{CalibrationError, GaugeCalibration};
use tactile_core::sensing::{
    ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, GaugeReading,
    NoContact, Touch, WrenchEstimator, WrenchSettings,
};

use super::{Miss, fingertip, rms};
use crate::sim::random::Random;
use crate::sim::sensors::gauges::{FULL_SCALE, WORD};
use crate::sim::sensors::{FluidFinger, Push, Skin, Transducer, film, gauges};
use crate::space::Point;

/// What drifts, and by how many kelvin, reached as 1 − e^(−t/600 s).
const CASES: [(&str, Kind, f64); 3] = [
    ("Nano17, 10 K warmer", Kind::Wrench, 10.0),
    ("BioTac, 10 K warmer", Kind::Electrodes, 10.0),
    ("BioTac, 10 K colder", Kind::Electrodes, -10.0),
];

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Wrench,
    Electrodes,
}

/// How long, seconds, and in how many parts it is told.
pub const HOUR: f64 = 3600.0;
const PARTS: usize = 12;

/// Normal force of a push, newtons, and tangential over normal force at most.
const NEWTONS: f64 = 1.0;
const SLIDE: f64 = 0.3;

/// A push, and the rest after it, lasts this long, seconds, uniform.
const LASTS: [f64; 2] = [1.0, 8.0];

/// Readings after a push that are not judged: the window still holds it.
const SETTLES: usize = 20;

/// Seeds that are run at most: an hour has millions of readings.
pub const SEEDS: u64 = 4;

/// A part of the hour, all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What drifts.
    pub case: &'static str,
    /// Whether the estimator follows it.
    pub followed: bool,
    /// Middle of the part, minutes since the tare.
    pub minutes: f64,
    /// Pushes, and the share of them that was not reported at their end.
    pub pushes: usize,
    /// See `pushes`.
    pub missed: f64,
    /// Root mean square error of the contacts reported at the end of a push, millimetres; `None` of
    /// none.
    pub point_mm: Option<f64>,
    /// Share of the readings of a free finger that were taken for a contact.
    pub felt: f64,
}

/// Touches that last so long, while the sensor drifts fastest.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Lasting {
    /// What drifts.
    pub case: &'static str,
    /// Seconds since the touch began, which was as soon as the finger was tared.
    pub seconds: f64,
    /// Touches, and the share of them that is not reported then.
    pub touches: usize,
    /// See `touches`.
    pub missed: f64,
    /// Root mean square error of the contacts reported, millimetres; `None` of none.
    pub point_mm: Option<f64>,
    /// Mean error along the skin squared, in units of its covariance: two if that is honest.
    pub squared: Option<f64>,
}

/// The whole experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// By case, first followed, then not; by time.
    pub rows: Vec<Row>,
    /// By case and time.
    pub lasting: Vec<Lasting>,
}

/// Seconds after which a touch that lasts is looked at.
const LOOKED_AT: [f64; 4] = [0.1, 1.0, 10.0, 60.0];

/// Touches of a seed that last, each on a finger of its own.
const TOUCHES: u64 = 12;

/// Runs an hour, or as many `seconds` as are asked for, with up to four seeds.
///
/// # Errors
/// None but those of settings that make no sense, which these do.
pub fn run(seeds: u64, seconds: f64) -> Result<Table, CalibrationError> {
    let runs: Vec<(usize, bool, u64)> = (0..CASES.len())
        .flat_map(|case| [true, false].map(|followed| (case, followed)))
        .flat_map(|(case, followed)| (0..seeds.min(SEEDS)).map(move |seed| (case, followed, seed)))
        .collect();
    let tallies: Vec<[Tally; PARTS]> = runs
        .par_iter()
        .map(|(case, followed, seed)| hour(CASES[*case], *followed, seconds, *seed))
        .collect::<Result<_, _>>()?;
    let mut rows = Vec::new();
    for (number, (case, ..)) in CASES.into_iter().enumerate() {
        for followed in [true, false] {
            let mine = || {
                let all = runs.iter().zip(&tallies);
                all.filter(move |(run, _)| (run.0, run.1) == (number, followed)).map(|(_, t)| t)
            };
            for part in 0..PARTS {
                let sum =
                    |value: fn(&Tally) -> usize| mine().map(|t| value(&t[part])).sum::<usize>();
                let errors: Vec<f64> =
                    mine().flat_map(|t| t[part].errors.iter().copied()).collect();
                let (pushes, free) = (sum(|t| t.pushes), sum(|t| t.free));
                rows.push(Row {
                    case,
                    followed,
                    minutes: seconds / 60.0 * (part as f64 + 0.5) / PARTS as f64,
                    pushes,
                    missed: 1.0 - errors.len() as f64 / pushes as f64,
                    point_mm: (!errors.is_empty()).then(|| 1e3 * rms(errors.iter().copied())),
                    felt: sum(|t| t.felt) as f64 / free as f64,
                });
            }
        }
    }
    Ok(Table { rows, lasting: lasting(seeds.min(SEEDS))? })
}

/// Touches of 1 N that last, on a finger that drifts as fast as it ever does.
fn lasting(seeds: u64) -> Result<Vec<Lasting>, CalibrationError> {
    let mut table = Vec::new();
    for (case, kind, warming) in CASES {
        let touches: Vec<_> = (0..seeds * TOUCHES)
            .into_par_iter()
            .map(|seed| last(kind, warming, seed))
            .collect::<Result<_, _>>()?;
        for (k, seconds) in LOOKED_AT.into_iter().enumerate() {
            let felt = || touches.iter().filter_map(|misses: &[Option<Miss>; 4]| misses[k]);
            let count = felt().count();
            let some = |value: f64| (count > 0).then_some(value);
            table.push(Lasting {
                case,
                seconds,
                touches: touches.len(),
                missed: 1.0 - count as f64 / touches.len() as f64,
                point_mm: some(1e3 * rms(felt().map(|m| m.point))),
                squared: some(felt().map(|m| m.squared).sum::<f64>() / count as f64),
            });
        }
    }
    Ok(table)
}

/// One touch: what is felt when it is looked at.
fn last(kind: Kind, warming: f64, seed: u64) -> Result<[Option<Miss>; 4], CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0x1a57);
    let mut finger = Finger::new(kind, warming, true, seed)?;
    let place = finger.skin.at(0.004 + 0.016 * random.unit(), random.around_zero(1.0));
    let push = Push::new(place, NEWTONS, SLIDE * random.unit(), random.direction(3));
    let (begin, mut felt) = (finger.seconds(), Err(NoContact::TooLight));
    Ok(LOOKED_AT.map(|seconds| {
        while finger.seconds() < begin + seconds {
            felt = finger.read(&[push]);
        }
        felt.ok().map(|touch| Miss::of(&touch, &push))
    }))
}

#[derive(Clone, Default)]
struct Tally {
    pushes: usize,
    /// Metres, of the pushes that were reported.
    errors: Vec<f64>,
    /// Readings of a free finger, and those of them that were taken for a contact.
    free: usize,
    felt: usize,
}

/// A sensor with its estimator, tared.
struct Finger {
    sensor: Sensor,
    skin: Skin,
    /// Between readings, seconds.
    step: f64,
    readings: u32,
}

enum Sensor {
    Wrench(Box<(Transducer, WrenchEstimator)>),
    Electrodes(Box<(FluidFinger, ElectrodeEstimator)>),
}

impl Finger {
    fn new(kind: Kind, warming: f64, follows: bool, seed: u64) -> Result<Finger, CalibrationError> {
        let (sensor, skin, step) = match kind {
            Kind::Wrench => {
                let options = gauges::Options { warming, ..gauges::Options::default() };
                let transducer = Transducer::new(options, seed);
                let matrix = transducer.calibration().ok_or(CalibrationError::Singular)?;
                let gauges = GaugeCalibration::new(
                    matrix.map(|row| row.map(|v| v as f32)),
                    (-WORD as i32 - 1, WORD as i32),
                    FULL_SCALE.map(|v| v as f32),
                )?;
                let skin = Skin::Finger { radius: 8e-3, length: 0.02 };
                let mut settings = WrenchSettings::nano17(gauges, fingertip(&skin));
                if !follows {
                    settings.drift = 0.0;
                }
                let mut estimator = WrenchEstimator::new();
                estimator.configure(&settings)?;
                (Sensor::Wrench(Box::new((transducer, estimator))), skin, 1e-3)
            }
            Kind::Electrodes => {
                let options = film::Options { warming, ..film::Options::default() };
                let mut settings = ElectrodeSettings::BIOTAC;
                if !follows {
                    settings.drift = 0.0;
                }
                let mut estimator = ElectrodeEstimator::new();
                estimator.configure(&settings)?;
                let finger = FluidFinger::new(options, seed);
                (Sensor::Electrodes(Box::new((finger, estimator))), Skin::BIOTAC, 1e-2)
            }
        };
        let mut finger = Finger { sensor, skin, step, readings: 0 };
        while finger.read(&[]) == Err(NoContact::Taring) {}
        Ok(finger)
    }

    fn read(&mut self, pushes: &[Push]) -> Result<Touch, NoContact> {
        self.readings += 1;
        let time = self.readings.wrapping_mul((1e6 * self.step) as u32);
        match &mut self.sensor {
            Sensor::Wrench(wrench) => {
                let (transducer, estimator) = &mut **wrench;
                let words = transducer.sample(pushes, Point::zeros(), self.step);
                estimator.estimate(&GaugeReading(words), time)
            }
            Sensor::Electrodes(electrodes) => {
                let (finger, estimator) = &mut **electrodes;
                estimator.estimate(&ElectrodeReading(finger.sample(pushes, self.step)), time)
            }
        }
    }

    fn seconds(&self) -> f64 {
        f64::from(self.readings) * self.step
    }
}

/// Pushes and rests in turn, at places of the pad.
fn hour(
    (_, kind, warming): (&str, Kind, f64),
    followed: bool,
    seconds: f64,
    seed: u64,
) -> Result<[Tally; PARTS], CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0xd21f7);
    let mut finger = Finger::new(kind, warming, followed, seed)?;
    let mut tallies: [Tally; PARTS] = Default::default();
    let [shortest, longest] = LASTS;
    while finger.seconds() < seconds {
        let part = (finger.seconds() / seconds * PARTS as f64) as usize;
        let tally = &mut tallies[part.min(PARTS - 1)];
        let mut readings =
            || ((shortest + (longest - shortest) * random.unit()) / finger.step) as usize;
        let (rest, press) = (readings(), readings());
        for reading in 0..rest {
            let felt = finger.read(&[]).is_ok();
            if reading >= SETTLES {
                tally.free += 1;
                tally.felt += usize::from(felt);
            }
        }
        let place = finger.skin.at(0.004 + 0.016 * random.unit(), random.around_zero(1.0));
        let push = Push::new(place, NEWTONS, SLIDE * random.unit(), random.direction(3));
        let mut felt = Err(NoContact::TooLight);
        for _ in 0..press {
            felt = finger.read(&[push]);
        }
        tally.pushes += 1;
        tally.errors.extend(felt.ok().map(|touch| Miss::of(&touch, &push).point));
    }
    Ok(tallies)
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Pushes of 1 N, of 1 to 8 s with as long between, on a finger that drifts")?;
        writeln!(
            f,
            "  {:<22}{:>10}{:>9}{:>9}{:>10}{:>11}{:>15}",
            "sensor", "followed", "minutes", "pushes", "missed", "error mm", "felt when free"
        )?;
        for r in &self.rows {
            writeln!(
                f,
                "  {:<22}{:>10}{:>9.1}{:>9}{:>8.1} %{:>11}{:>13.2} %",
                r.case,
                if r.followed { "yes" } else { "no" },
                r.minutes,
                r.pushes,
                100.0 * r.missed,
                r.point_mm.map_or("–".into(), |v| format!("{v:.2}")),
                100.0 * r.felt,
            )?;
        }
        writeln!(f, "  root mean squares over what is reported at the end of a push")?;
        writeln!(f, "Touches of 1 N that last, from the tare on")?;
        writeln!(
            f,
            "  {:<22}{:>9}{:>9}{:>10}{:>11}{:>15}",
            "sensor", "seconds", "touches", "missed", "error mm", "normalised ²"
        )?;
        for l in &self.lasting {
            let number = |v: Option<f64>| v.map_or("–".into(), |v| format!("{v:.2}"));
            writeln!(
                f,
                "  {:<22}{:>9.1}{:>9}{:>8.1} %{:>11}{:>15}",
                l.case,
                l.seconds,
                l.touches,
                100.0 * l.missed,
                number(l.point_mm),
                number(l.squared),
            )?;
        }
        write!(f, "  normalised: by the covariance; two if that is honest")
    }
}
