//! Tables 4.2 and 4.3: how many actions until 90 % of the contour of a 10 × 6 cm rectangle is known, and
//! the same for other objects and criteria; where the object slips, with its last pose.

use std::fmt;
use std::ops::Range;
use std::time::Instant;

use clap::ValueEnum;
use rayon::prelude::*;
use serde::Serialize;

use super::mean::mean;
use super::proportion::Proportion;
use super::{Spread, with_room};
use crate::explore::{End, Episode, Planning, Settings, explore};
use crate::graph;
use crate::quantity::Deviation;
use crate::sim::{Bench, ObjectError, Options};
use crate::slam::trackers::Kind;

mod cases;

pub use cases::{Among, Goal, Selection};
use cases::{Case, cases};

/// Actions after which a run is given up.
const MOST_ACTIONS: usize = 60;

/// Slip at every grasp of a moving object.
const SLIP: Deviation = Deviation { length: 5e-3, angle: 10.0 * std::f64::consts::PI / 180.0 };

/// What the last pose must be within.
const POSE: Deviation = Deviation { length: 3e-3, angle: 3.0 * std::f64::consts::PI / 180.0 };

/// One of the two tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableOf {
    /// 4.2: the object stays where it is.
    Fixed,
    /// 4.3: the object slips and is tracked.
    Moving,
}

/// One row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was explored.
    pub object: String,
    /// Who followed it; `None` where it stayed where it was.
    pub tracker: Option<&'static str>,
    /// What corrected the poses afterwards; `None` where nothing did.
    pub graph: Option<&'static str>,
    /// What decided.
    pub criterion: String,
    /// Among what.
    pub candidates: &'static str,
    /// When enough was known, of the shape and of the pose.
    pub until: String,
    /// Mean number of actions, those that were given up counted as 60.
    pub actions: f64,
    /// Half of the 95 % interval of that mean.
    pub plus_minus: f64,
    /// Mean number of actions until the shape was known for the first time, likewise.
    pub shape_actions: f64,
    /// Runs that got there.
    pub reached: Proportion,
    /// Runs that got there with a last pose within 3 mm and 3°, of all runs.
    pub pose: Proportion,
    /// Error of the last pose, millimetres and degrees, of the runs that got there.
    pub pose_mm: Option<Spread>,
    /// See `pose_mm`.
    pub pose_deg: Option<Spread>,
    /// How far the shape had to be moved to be laid on the true one, millimetres: what alignment forgives.
    pub drift_mm: Option<Spread>,
    /// The same in degrees.
    pub drift_deg: Option<Spread>,
    /// Share of the surface called known whose error is within two standard deviations, on average.
    pub honesty: Option<f64>,
    /// Why runs did not get there: the hand met nothing or made no surface, a grasp was lost, else.
    pub failures: [usize; 3],
    /// Runs that ended since there was no grasp to choose.
    pub nothing_left: usize,
    /// Actions a run that nearly repeat one before, on average.
    pub repeats: f64,
    /// Median time of one choice, milliseconds.
    pub choosing_ms: f64,
    /// Median time of making tracker and surface of one grasp, milliseconds.
    pub learning_ms: f64,
    /// The row took so long, seconds.
    pub seconds: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What is shown.
    pub title: &'static str,
    /// First and last seed.
    pub seeds: (u64, u64),
    /// One per case.
    pub rows: Vec<Row>,
}

/// Runs the cases of a table that are selected, and tells `watch` of each row as it is done.
///
/// # Errors
/// When an object does not exist.
pub fn run(
    of: TableOf,
    selection: &Selection,
    seeds: Range<u64>,
    mut watch: impl FnMut(&Row),
) -> Result<Table, ObjectError> {
    let cases = cases(of, selection)?;
    for case in &cases {
        case.object.geometry()?;
    }
    let mut rows = Vec::new();
    for case in &cases {
        let row = with_room(|| row(case, seeds.clone()));
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
    Ok(Table { title, seeds: (seeds.start, seeds.end.saturating_sub(1)), rows })
}

fn row(case: &Case, seeds: Range<u64>) -> Row {
    let start = Instant::now();
    let runs: Vec<Option<Episode>> =
        seeds.into_par_iter().map(|seed| episode(case, seed)).collect();
    let count = |k: Option<usize>| k.unwrap_or(MOST_ACTIONS) as f64;
    let there = |e: &Option<Episode>| e.as_ref().is_some_and(Episode::reached);
    let actions: Vec<f64> = runs
        .iter()
        .map(|e| count(e.as_ref().filter(|e| e.reached()).map(|e| e.actions.len())))
        .collect();
    let share = crate::explore::coverage::SHARE;
    let shape_actions: Vec<f64> = runs
        .iter()
        .map(|e| {
            let first = e.iter().flat_map(|e| &e.actions).position(|a| a.known >= share);
            count(first.map(|k| k + 1))
        })
        .collect();
    let (actions, plus_minus) = mean(actions);
    let good =
        |e: &Episode| e.reached() && e.pose_error.0 <= POSE.length && e.pose_error.1 <= POSE.angle;
    let arrived: Vec<&Episode> = runs.iter().flatten().filter(|e| e.reached()).collect();
    let spread = |f: &dyn Fn(&Episode) -> f64| Spread::of(arrived.iter().map(|e| f(e)));
    let honesty: Vec<f64> = arrived.iter().filter_map(|e| e.honesty).collect();
    let failed = runs.iter().filter(|e| !there(e));
    let failures = failed.fold([0; 3], |[missed, lost, other], e| match e {
        None => [missed + 1, lost, other],
        Some(e) if e.lost > 0 => [missed, lost + 1, other],
        Some(_) => [missed, lost, other + 1],
    });
    let actions_of = || runs.iter().flatten().flat_map(|e| &e.actions);
    let choices = Spread::of(actions_of().filter(|a| a.choosing > 0.0).map(|a| 1e3 * a.choosing));
    let learnt = Spread::of(actions_of().map(|a| 1e3 * a.learning));
    let n = runs.len().max(1) as f64;
    Row {
        object: case.object.to_string(),
        tracker: case.tracker.map(Kind::name),
        graph: match case.graph {
            graph::Kind::Planes => Some("planes"),
            graph::Kind::Pairwise => Some("pairwise"),
            graph::Kind::None => None,
        },
        criterion: case
            .criterion
            .to_possible_value()
            .map_or_else(String::new, |v| v.get_name().into()),
        candidates: case.among.name(),
        until: case.goal.to_string(),
        actions,
        plus_minus,
        shape_actions: mean(shape_actions).0,
        reached: Proportion::of(runs.iter().map(there)),
        pose: Proportion::of(runs.iter().map(|e| e.as_ref().is_some_and(good))),
        pose_mm: spread(&|e| 1e3 * e.pose_error.0),
        pose_deg: spread(&|e| e.pose_error.1.to_degrees()),
        drift_mm: spread(&|e| 1e3 * e.drift.0),
        drift_deg: spread(&|e| e.drift.1.to_degrees()),
        honesty: (!honesty.is_empty()).then(|| mean(honesty).0),
        failures,
        nothing_left: runs.iter().flatten().filter(|e| e.end == End::NoCandidate).count(),
        repeats: runs.iter().flatten().map(|e| e.repeats as f64).sum::<f64>() / n,
        choosing_ms: choices.map_or(0.0, |s| s.median),
        learning_ms: learnt.map_or(0.0, |s| s.median),
        seconds: start.elapsed().as_secs_f64(),
    }
}

/// One run; `None` where the hand never met the object or what it felt made no surface.
fn episode(case: &Case, seed: u64) -> Option<Episode> {
    let still = Deviation { length: 0.0, angle: 0.0 };
    let motion_noise = if case.tracker.is_some() { SLIP } else { still };
    let options = Options { motion_noise, seed, ..Options::new(case.object.clone()) };
    let mut bench = Bench::new(options).ok()?;
    let settings = Settings {
        criterion: case.criterion,
        candidates: case.among.candidates(),
        planning: Planning::default(),
        tracker: case.tracker,
        graph: case.graph,
        until: case.goal.until,
        pose: case.goal.pose.then_some(POSE),
        most_actions: MOST_ACTIONS,
        seed,
    };
    explore(&mut bench, &settings, |_| ()).ok()
}

/// The head of the table.
pub fn heading() -> String {
    format!(
        "  {:<24}{:<20}{:<14}{:<12}{:<14}{:>13}{:>7}  {:<17}{:<17}{:>10}{:>10}{:>6}{:>9}{:>8}{:>10}{:>7}",
        "object",
        "tracker",
        "criterion",
        "candidates",
        "until",
        "actions",
        "shape",
        "reached",
        "pose right",
        "pose",
        "drift",
        "2σ",
        "failed",
        "repeats",
        "choose ms",
        "time"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pair = |a: &Option<Spread>, b: &Option<Spread>| match (a, b) {
            (Some(a), Some(b)) if self.tracker.is_some() => {
                format!("{:.1}, {:.1}", a.median, b.median)
            }
            _ => "–".to_owned(),
        };
        let [missed, lost, other] = self.failures;
        write!(
            f,
            "  {:<23} {:<20}{:<14}{:<12}{:<14}{:>6.1} ± {:<4.1}{:>7.1}  {:<17}{:<17}{:>10}{:>10}{:>6}{:>9}{:>8.1}{:>10.1}{:>5.0} s",
            self.object,
            [
                self.tracker.unwrap_or("–"),
                self.graph.map_or("", |_| ", "),
                self.graph.unwrap_or("")
            ]
            .concat(),
            self.criterion,
            self.candidates,
            self.until,
            self.actions,
            self.plus_minus,
            self.shape_actions,
            self.reached.to_string(),
            self.pose.to_string(),
            pair(&self.pose_mm, &self.pose_deg),
            pair(&self.drift_mm, &self.drift_deg),
            self.honesty.map_or("–".to_owned(), |h| format!("{:.0} %", 100.0 * h)),
            format!("{missed}/{lost}/{other}"),
            self.repeats,
            self.choosing_ms,
            self.seconds
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (first, last) = self.seeds;
        writeln!(f, "{}, seeds {first} to {last}\n{}", self.title, heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  actions: mean and its 95 % interval (Student), runs given up counted as {MOST_ACTIONS}; shape: \
             actions until the shape alone was known; Wilson intervals\n  \
             until: strict is a standard deviation and a true error of at most 1.8 mm on 90 % of the true \
             surface, lenient 2.5 mm and 3 mm; +pose: and by the explorer's own account the pose within 3 mm \
             and 3° with 95 %\n  \
             tracker: who followed what moved, and what corrected its poses; what moved is judged after the best rigid alignment, whose size is drift (median mm, °), by \
             deviations that hold how contacts lie beside each other and not where all of them are; \
             2σ: share of what is called known that is within two of its deviations\n  \
             pose right: runs that got there with a last pose within 3 mm and 3°, of all; pose: its median \
             error in mm, ° (of the aligned shape)\n  \
             failed: nothing felt or no surface / a grasp lost / other; repeats: actions a run; choose: \
             median of one choice"
        )
    }
}
