//! Tables 4.2 and 4.3: how many actions until 90 % of the contour of a 10 × 6 cm rectangle is known, and
//! the same for other objects and criteria.

use std::fmt;

use clap::ValueEnum;
use rayon::prelude::*;
use serde::Serialize;

use super::proportion::Proportion;
use super::with_room;
use crate::explore::{Candidates, Criterion, Episode, Planning, Settings, Until, explore};
use crate::graph;
use crate::quantity::Deviation;
use crate::sim::{Bench, ObjectError, ObjectSpec, Options};
use crate::slam::trackers::Kind;

/// The thesis' object.
const RECTANGLE: &str = "rectangle:0.10x0.06";

/// Actions after which a run is given up.
const MOST_ACTIONS: usize = 60;

/// New candidates at every choice.
const CANDIDATES: usize = 120;

/// Slip at every grasp of a moving object.
const SLIP: Deviation = Deviation { length: 5e-3, angle: 10.0 * std::f64::consts::PI / 180.0 };

/// One of the two tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableOf {
    /// 4.2: the object stays where it is.
    Fixed,
    /// 4.3: the object slips and is tracked.
    Moving,
}

/// A case of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Case {
    criterion: Criterion,
    candidates: Candidates,
    until: Until,
}

/// One row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What decided.
    pub criterion: String,
    /// Among what.
    pub candidates: &'static str,
    /// When enough was known.
    pub until: String,
    /// Runs that got there.
    pub reached: Proportion,
    /// Mean number of actions, those that were given up counted as 60.
    pub actions: f64,
    /// Half of the 95 % interval of that mean.
    pub plus_minus: f64,
    /// Runs with a last pose within 3 mm and 3°.
    pub pose: Proportion,
    /// Mean time of one choice, milliseconds.
    pub choosing_ms: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What was explored.
    pub object: String,
    /// What is shown.
    pub title: &'static str,
    /// One per case.
    pub rows: Vec<Row>,
}

/// Runs the cases of a table on an object (the thesis' rectangle where there is none), and tells `watch`
/// of each row as it is done.
///
/// # Errors
/// When the object does not exist.
pub fn run(
    of: TableOf,
    object: Option<&str>,
    seeds: std::ops::Range<u64>,
    mut watch: impl FnMut(&Row),
) -> Result<Table, ObjectError> {
    let object: ObjectSpec = object.unwrap_or(RECTANGLE).parse()?;
    object.geometry()?;
    let mut rows = Vec::new();
    for case in cases(of) {
        let row = with_room(|| row(of, &object, case, seeds.clone()));
        watch(&row);
        rows.push(row);
    }
    let title = match of {
        TableOf::Fixed => {
            "actions until 90 % is known, fixed object (thesis table 4.2: random 22.1, active 16.3)"
        }
        TableOf::Moving => {
            "actions until 90 % is known, object that slips by 5 mm and 10° at every grasp \
             (thesis table 4.3: random 56.7, det Σ 25.8, KL 26.4)"
        }
    };
    Ok(Table { object: object.to_string(), title, rows })
}

fn cases(of: TableOf) -> Vec<Case> {
    use Criterion::*;
    let criteria: &[Criterion] = match of {
        TableOf::Fixed => &[Random, NoRepeat, VarianceSum, Igef, Entropy, Information],
        TableOf::Moving => &[Random, NoRepeat, DetSigma, Kl, Entropy, Information],
    };
    let mut cases = Vec::new();
    for until in [Until::Lenient, Until::Strict] {
        for candidates in [Candidates::Fixed, Candidates::Continuous(CANDIDATES)] {
            for &criterion in criteria {
                // Continuous draws never repeat.
                if (criterion, candidates) != (NoRepeat, Candidates::Continuous(CANDIDATES)) {
                    cases.push(Case { criterion, candidates, until });
                }
            }
        }
    }
    cases
}

fn row(of: TableOf, object: &ObjectSpec, case: Case, seeds: std::ops::Range<u64>) -> Row {
    let episodes: Vec<Option<Episode>> =
        seeds.into_par_iter().map(|seed| episode(of, object, case, seed)).collect();
    let actions: Vec<f64> = episodes
        .iter()
        .map(|e| match e {
            Some(e) if e.reached => e.actions.len() as f64,
            _ => MOST_ACTIONS as f64,
        })
        .collect();
    let n = actions.len().max(1) as f64;
    let mean = actions.iter().sum::<f64>() / n;
    let variance = actions.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let good = |e: &Episode| e.pose_error.0 < 3e-3 && e.pose_error.1 < 3f64.to_radians();
    let choices: Vec<f64> = episodes
        .iter()
        .flatten()
        .flat_map(|e| e.actions.iter().skip(1))
        .map(|a| a.choosing)
        .collect();
    Row {
        criterion: case
            .criterion
            .to_possible_value()
            .map_or_else(String::new, |v| v.get_name().into()),
        candidates: match case.candidates {
            Candidates::Fixed => "fixed",
            Candidates::Continuous(_) => "continuous",
            Candidates::Clusters(_) => "clusters",
        },
        until: case.until.to_string(),
        reached: Proportion::of(episodes.iter().map(|e| e.as_ref().is_some_and(|e| e.reached))),
        actions: mean,
        plus_minus: 1.96 * (variance / n).sqrt(),
        pose: Proportion::of(episodes.iter().map(|e| e.as_ref().is_some_and(good))),
        choosing_ms: 1e3 * choices.iter().sum::<f64>() / choices.len().max(1) as f64,
    }
}

/// One run; `None` where the hand never met the object or what it felt made no surface.
fn episode(of: TableOf, object: &ObjectSpec, case: Case, seed: u64) -> Option<Episode> {
    let still = Deviation { length: 0.0, angle: 0.0 };
    let motion_noise = if of == TableOf::Moving { SLIP } else { still };
    let mut bench =
        Bench::new(Options { motion_noise, seed, ..Options::new(object.clone()) }).ok()?;
    let settings = Settings {
        criterion: case.criterion,
        candidates: case.candidates,
        planning: Planning::default(),
        tracker: (of == TableOf::Moving).then_some(Kind::Hypotheses),
        graph: graph::Kind::None,
        until: case.until,
        most_actions: MOST_ACTIONS,
        seed,
    };
    explore(&mut bench, &settings, |_| ()).ok()
}

/// The head of the table.
pub fn heading() -> String {
    format!(
        "  {:<20}{:<12}{:<10}{:>14}  {:<22}{:<22}{:>12}",
        "criterion", "candidates", "until", "actions", "reached", "pose < 3 mm, 3°", "choice ms"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "  {:<20}{:<12}{:<10}{:>7.1} ± {:<4.1}  {:<22}{:<22}{:>12.1}",
            self.criterion,
            self.candidates,
            self.until,
            self.actions,
            self.plus_minus,
            self.reached.to_string(),
            self.pose.to_string(),
            self.choosing_ms
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}\n{}", self.object, self.title, heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  mean and its 95 % interval, runs given up counted as {MOST_ACTIONS}; Wilson intervals"
        )
    }
}
