//! Contacts from a BioTac's electrodes: error over the skin, of the centroid and of the estimator.

use std::f64::consts::PI;
use std::fmt;

use rayon::prelude::*;
use serde::Serialize;
use tactile_core::sensing::electrodes::{BIOTAC_CORE, BIOTAC_SKIN, centroid};
use tactile_core::sensing::{
    CalibrationError, ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings,
    NoContact, Touch,
};

use super::{Miss, point, rms};
use crate::sim::random::Random;
use crate::sim::sensors::film::Options;
use crate::sim::sensors::{FluidFinger, Push, Skin};
use crate::space::Point;

/// Newtons.
const FORCES: [f64; 6] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0];

/// The force of the maps.
pub(super) const MAPPED: f64 = 1.0;

/// Places along the skin, from the tip, and around it: metres and radians. A finger's pad ends where
/// its electrodes do.
pub(super) const ALONG: (f64, f64, usize) = (1e-3, 0.026, 26);
pub(super) const AROUND: (f64, f64, usize) = (-0.5 * PI, 0.5 * PI, 25);

/// Readings averaged.
const WINDOW: usize = 8;

/// Between readings, seconds.
const STEP: f64 = 0.01;

/// Tangential force over normal force, at most.
const SLIDE: f64 = 0.3;

/// All places and seeds at one force.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Normal force, newtons.
    pub newtons: f64,
    /// Pushes.
    pub pushes: usize,
    /// Share that is reported.
    pub reported: f64,
    /// Root mean square error of the centroid (thesis 2.24) on the skin, millimetres; over the
    /// reported pushes, as is all that follows.
    pub centroid_mm: f64,
    /// Of these, what is the same for all seeds: root mean square over the skin of the mean error.
    pub centroid_bias_mm: f64,
    /// Root mean square error of the centroid of what rises only, millimetres: the skin bulges
    /// where it is not pressed, and 2.24 takes that for pressure.
    pub rising_mm: f64,
    /// Root mean square error of the estimator, millimetres.
    pub point_mm: f64,
    /// Its part that is the same for all seeds.
    pub point_bias_mm: f64,
    /// Root mean square error of the estimator's normal, degrees.
    pub normal_deg: f64,
    /// Mean error along the skin squared, in units of its covariance: two if that is honest.
    pub squared: f64,
}

/// One place of the skin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Place {
    /// Over the skin from the tip, millimetres.
    pub along_mm: f64,
    /// From the middle of the pad, degrees.
    pub around_deg: f64,
    /// Root mean square error of the centroid, millimetres; NaN where nothing was reported.
    pub centroid_mm: f64,
    /// The same of the centroid of what rises.
    pub rising_mm: f64,
    /// The same of the estimator.
    pub point_mm: f64,
}

/// The whole experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// By force.
    pub rows: Vec<Row>,
    /// At the map's force, where the estimator takes the bell for this many times as wide as its
    /// usual setting.
    pub misjudged: Vec<(f64, Row)>,
    /// Of the map's force, place by place along, then around.
    pub places: Vec<Place>,
    /// Pairs of pushes of 1 N at random places at least 8 mm apart.
    pub pairs: usize,
    /// Share of them that is refused.
    pub refused: f64,
}

/// Factors by which the bell's width is misjudged.
const MISJUDGED: [f64; 2] = [0.8, 1.2];

/// Presses a finger of every seed at every place with every force.
///
/// # Errors
/// None but those of settings that make no sense, which the BioTac's do.
pub fn run(seeds: u64) -> Result<Table, CalibrationError> {
    let usual = ElectrodeSettings::BIOTAC;
    let all = |settings: &ElectrodeSettings, newtons: f64| {
        let felt = (0..seeds).into_par_iter().map(|seed| press(settings, newtons, seed));
        felt.collect::<Result<Vec<_>, _>>()
    };
    let (mut rows, mut places) = (Vec::new(), Vec::new());
    for newtons in FORCES {
        let felt = all(&usual, newtons)?;
        rows.push(row(newtons, &felt));
        if newtons == MAPPED {
            places = (0..ALONG.2 * AROUND.2).map(|i| place(i, &felt)).collect();
        }
    }
    let mut misjudged = Vec::new();
    for factor in MISJUDGED {
        let footprint = usual.footprint * factor as f32;
        let settings = ElectrodeSettings { footprint, ..usual };
        misjudged.push((factor, row(MAPPED, &all(&settings, MAPPED)?)));
    }
    let pairs: Vec<bool> = (0..seeds)
        .into_par_iter()
        .map(|seed| pairs(&usual, seed))
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .flatten()
        .collect();
    let refused = pairs.iter().filter(|r| **r).count() as f64 / pairs.len() as f64;
    Ok(Table { rows, misjudged, places, pairs: pairs.len(), refused })
}

/// What became of one push.
#[derive(Clone, Copy)]
struct Felt {
    miss: Miss,
    /// Error of the estimator and of both centroids on the skin, metres.
    point: Point,
    centroid: Point,
    rising: Point,
}

/// Where the map's place number `i` is: along, around.
fn site(i: usize) -> (f64, f64) {
    let step = |(from, to, count): (f64, f64, usize), k: usize| {
        from + (to - from) * k as f64 / (count - 1) as f64
    };
    (step(ALONG, i / AROUND.2), step(AROUND, i % AROUND.2))
}

fn row(newtons: f64, felt: &[Vec<Option<Felt>>]) -> Row {
    let all = || felt.iter().flatten().flatten();
    let count = all().count();
    let bias = |error: fn(&Felt) -> Point| {
        let place = |i: usize| {
            let here = || felt.iter().filter_map(move |seed| seed[i].as_ref()).map(error);
            here().sum::<Point>() / here().count() as f64
        };
        let means = (0..ALONG.2 * AROUND.2).map(place).map(|m| m.norm());
        1e3 * rms(means.filter(|m| m.is_finite()))
    };
    Row {
        newtons,
        pushes: felt.len() * ALONG.2 * AROUND.2,
        reported: count as f64 / (felt.len() * ALONG.2 * AROUND.2) as f64,
        centroid_mm: 1e3 * rms(all().map(|f| f.centroid.norm())),
        centroid_bias_mm: bias(|f| f.centroid),
        rising_mm: 1e3 * rms(all().map(|f| f.rising.norm())),
        point_mm: 1e3 * rms(all().map(|f| f.miss.point)),
        point_bias_mm: bias(|f| f.point),
        normal_deg: rms(all().map(|f| f.miss.normal)).to_degrees(),
        squared: all().map(|f| f.miss.squared).sum::<f64>() / count as f64,
    }
}

fn place(i: usize, felt: &[Vec<Option<Felt>>]) -> Place {
    let here = || felt.iter().filter_map(move |seed| seed[i]);
    let (along, around) = site(i);
    Place {
        along_mm: 1e3 * along,
        around_deg: around.to_degrees(),
        centroid_mm: 1e3 * rms(here().map(|f| f.centroid.norm())),
        rising_mm: 1e3 * rms(here().map(|f| f.rising.norm())),
        point_mm: 1e3 * rms(here().map(|f| f.miss.point)),
    }
}

/// A finger and its estimator, tared.
struct Bench {
    finger: FluidFinger,
    estimator: ElectrodeEstimator,
    time: u32,
}

impl Bench {
    fn new(settings: &ElectrodeSettings, seed: u64) -> Result<Bench, CalibrationError> {
        let mut estimator = ElectrodeEstimator::new();
        let mut settings = *settings;
        settings.detection.begin_readings = 1;
        estimator.configure(&settings)?;
        let finger = FluidFinger::new(Options::default(), seed);
        let mut bench = Bench { finger, estimator, time: 0 };
        while bench.read(&[]).1 == Err(NoContact::Taring) {}
        Ok(bench)
    }

    fn read(&mut self, pushes: &[Push]) -> ([u16; 19], Result<Touch, NoContact>) {
        self.time = self.time.wrapping_add((1e6 * STEP) as u32);
        let words = self.finger.sample(pushes, STEP);
        (words, self.estimator.estimate(&ElectrodeReading(words), self.time))
    }

    /// The mean words under a push, and what is felt.
    fn feel(&mut self, pushes: &[Push]) -> ([f64; 19], Result<Touch, NoContact>) {
        self.pause();
        let (mut mean, mut felt) = ([0.0; 19], Err(NoContact::TooLight));
        for _ in 0..WINDOW {
            let (words, result) = self.read(pushes);
            mean = std::array::from_fn(|k| mean[k] + f64::from(words[k]) / WINDOW as f64);
            felt = result;
        }
        (mean, felt)
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

    /// Equation 2.24 as it stands: magnitudes of the words' changes, positions on the core; then the
    /// skin's nearest point. And the same of the electrodes whose impedance rises.
    fn centroids(&self, words: &[f64; 19]) -> Option<[Point; 2]> {
        let baseline = self.estimator.baseline();
        let changes = std::array::from_fn(|k| baseline[k] - words[k] as f32);
        let on_skin = |changes: [f32; 19]| {
            let patch = BIOTAC_SKIN.project(centroid(&changes, &BIOTAC_CORE)?)?;
            Some(point(&patch.point))
        };
        Some([on_skin(changes)?, on_skin(changes.map(|c| c.max(0.0)))?])
    }
}

fn press(
    settings: &ElectrodeSettings,
    newtons: f64,
    seed: u64,
) -> Result<Vec<Option<Felt>>, CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0xb10);
    let mut bench = Bench::new(settings, seed)?;
    let mut felt = Vec::new();
    for i in 0..ALONG.2 * AROUND.2 {
        let (along, around) = site(i);
        let at = Skin::BIOTAC.at(along, around);
        let push = Push::new(at, newtons, SLIDE * random.unit(), random.direction(3));
        let (words, touch) = bench.feel(&[push]);
        felt.push(touch.ok().zip(bench.centroids(&words)).map(|(touch, [all, rising])| Felt {
            miss: Miss::of(&touch, &push),
            point: point(&touch.point) - push.point,
            centroid: all - push.point,
            rising: rising - push.point,
        }));
        bench.rest();
    }
    Ok(felt)
}

fn pairs(settings: &ElectrodeSettings, seed: u64) -> Result<Vec<bool>, CalibrationError> {
    let [mut random] = Random::streams(seed ^ 0x9a14);
    let mut bench = Bench::new(settings, seed)?;
    let mut refused = Vec::new();
    while refused.len() < 50 {
        let two = [(); 2].map(|()| {
            let (along, around) = (ALONG.1 * random.unit(), random.around_zero(AROUND.1));
            Push::new(Skin::BIOTAC.at(along, around), 1.0, 0.0, Point::zeros())
        });
        if (two[0].point - two[1].point).norm() < 8e-3 {
            continue;
        }
        refused.push(bench.feel(&two).1.is_err());
        bench.rest();
    }
    Ok(refused)
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "  {:>8.2}{:>9}{:>9.1} %{:>14.2}{:>9.2}{:>12.2}{:>14.2}{:>9.2}{:>10.1}{:>14.2}",
            self.newtons,
            self.pushes,
            100.0 * self.reported,
            self.centroid_mm,
            self.centroid_bias_mm,
            self.rising_mm,
            self.point_mm,
            self.point_bias_mm,
            self.normal_deg,
            self.squared,
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Contacts from a BioTac's electrodes, over its pad (thesis: 2.2 mm, 8°)")?;
        writeln!(
            f,
            "  {:>8}{:>9}{:>11}{:>14}{:>9}{:>12}{:>14}{:>9}{:>10}{:>14}",
            "force N",
            "pushes",
            "reported",
            "centroid mm",
            "bias mm",
            "rising mm",
            "estimator mm",
            "bias mm",
            "normal °",
            "normalised ²"
        )?;
        for r in &self.rows {
            writeln!(f, "{r}")?;
        }
        for (factor, r) in &self.misjudged {
            writeln!(f, "{r}  width × {factor}")?;
        }
        writeln!(
            f,
            "  of {} pairs of contacts at once, {:.0} % refused",
            self.pairs,
            100.0 * self.refused
        )?;
        write!(
            f,
            "  root mean squares on the skin over what is reported; centroid: thesis 2.24; rising: of what rises"
        )
    }
}
