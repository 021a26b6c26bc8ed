//! Grasps of a hand of links and joints until an object on a table is known (thesis 4.5.1).
//!
//! A part of the surface is known here when it lies within 3 mm of the believed surface *and* the belief
//! says that it does, its standard deviation being below 2.5 mm there. What can be known is all but the
//! bottom and what lies so near to the table that no fingertip fits between.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use clap::ValueEnum;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use super::{NEAR, SHARE, settings};
use crate::experiment::mean::mean;
use crate::experiment::proportion::Proportion;
use crate::experiment::{Spread, with_room};
use crate::explore::{Belief, Criterion, Episode, Settings, explore_until};
use crate::quantity::Deviation;
use crate::shape::Field;
use crate::sim::hand::{Articulated, HandError};
use crate::sim::{Bench, Hand, ObjectSpec, Options, SimError};
use crate::space::{Point, Pose};

/// What is explored. The approach was developed on the first three.
const OBJECTS: [&str; 5] = [
    "box:0.07x0.07x0.07",
    "box:0.10x0.06x0.08",
    "cylinder:0.06x0.1",
    "prism:0.06,hexagon:0.04",
    "lshape:0.09x0.09x0.035x0.05",
];

/// Who chooses.
const CRITERIA: [Criterion; 3] = [Criterion::Random, Criterion::VarianceSum, Criterion::Entropy];

/// Actions after which a run is given up.
const MOST_ACTIONS: usize = 30;

/// Standard deviation up to which the belief takes a part of the surface for known, metres.
const SURE: f64 = 2.5e-3;

/// Points of the surface that are looked at.
const SAMPLES: usize = 320;

/// Why there is no table.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No hand.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// No object.
    #[error(transparent)]
    Simulation(#[from] SimError),
}

/// One object, one criterion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was explored.
    pub object: String,
    /// What decided.
    pub criterion: String,
    /// Mean number of actions, the probing first, those of runs that were given up counted as 30.
    pub actions: f64,
    /// Half of the 95 % interval of that mean.
    pub plus_minus: f64,
    /// Mean number of contacts of a grasp, the probing not counted.
    pub contacts: f64,
    /// Grasps that could not be made.
    pub refused: Proportion,
    /// Runs that got there.
    pub reached: Proportion,
    /// Share of the surface that was known in the end, percent.
    pub known: Option<Spread>,
    /// How far the true surface was, at most, from a believed one that the belief is sure of, in the end,
    /// millimetres.
    pub wrong_mm: Option<Spread>,
    /// Mean time of a choice among 120, milliseconds, with as many runs at once as there are cores.
    pub choosing_ms: Option<f64>,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// One per object and criterion.
    pub rows: Vec<Row>,
}

/// What is known, judged by the truth and by the belief itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Known {
    /// Share of the surface.
    share: f64,
    /// Greatest error of what the belief is sure of, metres.
    wrong: f64,
}

impl Known {
    /// Of points of the true surface, the true object frame being at `frame` in the believed one.
    fn of(belief: &Belief, surface: &[(Point, Point)], frame: &Pose) -> Known {
        let points = surface.iter().map(|(p, _)| (frame * Point3::from(*p)).coords);
        let points: Vec<Point> = points.collect();
        let closest: Vec<Point> = points.iter().map(|p| belief.geometry.closest(p)).collect();
        let deviations = belief.surface.deviations(&closest);
        let errors = points.iter().zip(&closest).map(|(p, c)| (p - c).norm());
        let sure = errors.zip(deviations).filter(|(_, d)| *d < SURE).map(|(error, _)| error);
        let sure: Vec<f64> = sure.collect();
        let near = sure.iter().filter(|error| **error < NEAR).count();
        Known {
            share: near as f64 / points.len().max(1) as f64,
            wrong: sure.into_iter().fold(0.0, f64::max),
        }
    }
}

/// Runs the objects whose names hold one of `wanted`, all where there are none, one that matches none being
/// an object of its own; tells `watch` of each row as it is done.
///
/// # Errors
/// When an object does not exist or is a planar one.
pub fn run(
    wanted: &[String],
    seeds: Range<u64>,
    mut watch: impl FnMut(&Row),
) -> Result<Table, Error> {
    let hand = Hand::Articulated(Arc::new(Articulated::five_finger()?));
    let ours = OBJECTS.map(String::from);
    let others = wanted.iter().filter(|w| !ours.iter().any(|o| o.contains(w.as_str())));
    let chosen = |o: &&String| wanted.is_empty() || wanted.iter().any(|w| o.contains(w.as_str()));
    let objects: Vec<&String> = ours.iter().filter(chosen).chain(others).collect();
    let mut rows = Vec::new();
    for object in objects {
        let spec: ObjectSpec = object.parse().map_err(SimError::from)?;
        // Refused before anything long is begun.
        bench(&spec, &hand, 0)?;
        for criterion in CRITERIA {
            let row = with_room(|| row(&spec, &hand, criterion, seeds.clone()));
            watch(&row);
            rows.push(row);
        }
    }
    Ok(Table { rows })
}

fn bench(spec: &ObjectSpec, hand: &Hand, seed: u64) -> Result<Bench, SimError> {
    let motion_noise = Deviation { length: 0.0, angle: 0.0 };
    let options = Options { motion_noise, seed, ..Options::new(spec.clone()) };
    Bench::with_hand(options, hand.clone(), true)
}

fn row(spec: &ObjectSpec, hand: &Hand, criterion: Criterion, seeds: Range<u64>) -> Row {
    let one = |seed| {
        let mut bench = bench(spec, hand, seed).ok()?;
        let surface = bench.reachable(SAMPLES);
        let settings = Settings { most_actions: MOST_ACTIONS, ..settings(criterion, None, seed) };
        let mut last = Known::default();
        let judge = |belief: &Belief, frame: &Pose| {
            last = Known::of(belief, &surface, frame);
            (last.share, SHARE)
        };
        let episode = explore_until(&mut bench, &settings, judge, |_| ()).ok()?;
        Some((episode, last))
    };
    let runs: Vec<Option<(Episode, Known)>> = seeds.into_par_iter().map(one).collect();
    let counts = runs.iter().map(|run| match run {
        Some((episode, _)) if episode.reached() => episode.actions.len() as f64,
        _ => MOST_ACTIONS as f64,
    });
    let (actions, plus_minus) = mean(counts);
    let grasps = || runs.iter().flatten().flat_map(|(e, _)| e.actions.iter().skip(1));
    let choices: Vec<f64> = grasps().filter(|a| a.gain.is_some()).map(|a| a.choosing).collect();
    let contacts: usize = grasps().map(|a| a.contacts).sum();
    let ended = |of: fn(&Known) -> f64| Spread::of(runs.iter().flatten().map(|(_, k)| of(k)));
    Row {
        object: spec.to_string(),
        criterion: criterion.to_possible_value().map_or_else(String::new, |v| v.get_name().into()),
        actions,
        plus_minus,
        contacts: contacts as f64 / grasps().count().max(1) as f64,
        refused: Proportion::of(grasps().map(|a| a.refused.is_some())),
        reached: Proportion::of(
            runs.iter().map(|r| r.as_ref().is_some_and(|(episode, _)| episode.reached())),
        ),
        known: ended(|k| 100.0 * k.share),
        wrong_mm: ended(|k| 1e3 * k.wrong),
        choosing_ms: (!choices.is_empty())
            .then(|| 1e3 * choices.iter().sum::<f64>() / choices.len() as f64),
    }
}

/// The head of the table.
pub fn heading() -> String {
    format!(
        "  {:<30}{:<14}{:>14}{:>16}  {:<16}{:<20}{:<24}{:<22}{:>9}",
        "object",
        "criterion",
        "actions",
        "contacts/grasp",
        "refused",
        "reached",
        "known in the end, %",
        "wrong at most, mm",
        "choice ms"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        write!(
            f,
            "  {:<30}{:<14}{:>7.1} ± {:<4.1}{:>16.1}  {:<16}{:<20}{:<24}{:<22}{:>9}",
            self.object,
            self.criterion,
            self.actions,
            self.plus_minus,
            self.contacts,
            format!("{} of {}", self.refused.successes, self.refused.of),
            self.reached.to_string(),
            show(&self.known),
            show(&self.wrong_mm),
            self.choosing_ms.map_or("–".to_owned(), |ms| format!("{ms:.0}")),
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "actions of a five-finger hand of links and joints (probing, then grasps) until 90 % of the surface \
             of an object on a table is known:\nwithin 3 mm of the believed surface, which the belief is \
             sure of to 2.5 mm (thesis 4.5.1: a cube, more than 80 grasps)"
        )?;
        writeln!(f, "{}", heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  mean and its 95 % interval, runs given up counted as {MOST_ACTIONS}; Wilson intervals; median \
             [quartiles]; wrong: greatest error of what the belief is sure of"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_is_what_is_near_and_believed_and_planar_objects_are_refused() {
        let hand = Hand::Articulated(Arc::new(Articulated::five_finger().unwrap()));
        let planar = run(&["rectangle:0.1x0.06".into()], 0..1, |_| ()).unwrap_err();
        assert!(planar.to_string().contains("planar"), "{planar}");
        let spec: ObjectSpec = "box:0.06x0.06x0.06".parse().unwrap();
        let mut bench = bench(&spec, &hand, 1000).unwrap();
        let surface = bench.reachable(SAMPLES);
        let settings = Settings { most_actions: 3, ..settings(Criterion::Entropy, None, 1000) };
        let mut seen = Vec::new();
        let judge = |belief: &Belief, frame: &Pose| {
            let here = Known::of(belief, &surface, frame);
            let away = Pose::translation(0.5, 0.0, 0.0) * frame;
            assert_eq!(Known::of(belief, &surface, &away).share, 0.0);
            assert!(here.wrong < 0.1 && Known::of(belief, &surface, &away).wrong < 1.0);
            seen.push(here.share);
            (here.share, 2.0)
        };
        explore_until(&mut bench, &settings, judge, |_| ()).unwrap();
        assert!(seen.len() == 3 && seen[2] > seen[0] + 0.3, "{seen:?}");
    }
}
