//! What planning ahead is worth: one grasp at a time beside batches, looking ahead, contact areas and
//! choosing by gain per second. The criterion is the same everywhere.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::mean::mean;
use super::proportion::Proportion;
use super::with_room;
use crate::explore::{
    Candidates, Cost, Criterion, Episode, NextArea, Planning, Settings, Until, explore,
};
use crate::graph;
use crate::quantity::Deviation;
use crate::sim::{Bench, ObjectError, ObjectSpec, Options};
use crate::slam::trackers::Kind;

/// Candidates of a choice that draws them.
const CANDIDATES: usize = 120;

/// Actions after which a run is given up.
const MOST_ACTIONS: usize = 40;

/// Slip at every grasp of a moving object.
const SLIP: Deviation = Deviation { length: 5e-3, angle: 10.0 * std::f64::consts::PI / 180.0 };

/// What is explored, whether it slips, and when it is known.
const SUBJECTS: [(&str, bool, Until); 4] = [
    ("rectangle:0.10x0.06", false, Until::Strict),
    ("ellipse:0.12x0.06", false, Until::Strict),
    ("rectangle:0.10x0.06", true, Until::Lenient),
    ("box:0.08x0.06x0.06", false, Until::Lenient),
];

/// How it is explored.
#[derive(Clone, Copy, Debug)]
struct Strategy {
    name: &'static str,
    candidates: Candidates,
    planning: Planning,
}

fn strategies() -> Vec<Strategy> {
    let one = Planning::default();
    let drawn = Candidates::Continuous(CANDIDATES);
    let of = |name, candidates, planning| Strategy { name, candidates, planning };
    let paid = Some(Cost::default());
    vec![
        of("single", drawn, one),
        of("batch of 2", drawn, Planning { batch: 2, ..one }),
        of("batch of 3", drawn, Planning { batch: 3, ..one }),
        of("lookahead", drawn, Planning { lookahead: true, ..one }),
        of("per second", drawn, Planning { cost: paid, ..one }),
        of("per second, lookahead", drawn, Planning { cost: paid, lookahead: true, ..one }),
        of("nearest area", Candidates::Clusters(NextArea::Near), one),
        of("any area", Candidates::Clusters(NextArea::Gain), one),
        of(
            "any area, per second",
            Candidates::Clusters(NextArea::Gain),
            Planning { cost: paid, ..one },
        ),
    ]
}

/// One row. Runs that were given up count with what they had spent, and as 40 actions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was explored, and when it was known.
    pub object: String,
    /// How.
    pub strategy: &'static str,
    /// Runs that got there.
    pub reached: Proportion,
    /// Mean number of actions and half of its 95 % interval.
    pub actions: (f64, f64),
    /// Mean number of decisions.
    pub decisions: f64,
    /// Mean time that the actions take, by [`Cost::default`], and half of its 95 % interval, seconds.
    pub seconds: (f64, f64),
    /// Mean way of the hand and its turns, metres and radians.
    pub way: (f64, f64),
    /// Median time of a decision, milliseconds.
    pub choosing_ms: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// One per object and strategy.
    pub rows: Vec<Row>,
}

/// Explores the subjects (those whose name holds one of `objects`, all where there are none, and other
/// objects of that name, fixed and until they are known as [`Until::Lenient`] says) in all ways, and
/// tells `watch` of each row as it is done.
///
/// # Errors
/// When an object does not exist.
pub fn run(
    objects: &[String],
    seeds: std::ops::Range<u64>,
    mut watch: impl FnMut(&Row),
) -> Result<Table, ObjectError> {
    let mut subjects: Vec<(ObjectSpec, bool, Until)> = Vec::new();
    for (name, slips, until) in SUBJECTS {
        if objects.is_empty() || objects.iter().any(|o| name.contains(o.as_str())) {
            subjects.push((name.parse()?, slips, until));
        }
    }
    for other in objects.iter().filter(|o| !SUBJECTS.iter().any(|s| s.0.contains(o.as_str()))) {
        let object: ObjectSpec = other.parse()?;
        object.geometry()?;
        subjects.push((object, false, Until::Lenient));
    }
    let mut rows = Vec::new();
    for (object, slips, until) in &subjects {
        for strategy in strategies() {
            let row = with_room(|| row(object, *slips, *until, &strategy, seeds.clone()));
            watch(&row);
            rows.push(row);
        }
    }
    Ok(Table { rows })
}

fn row(
    object: &ObjectSpec,
    slips: bool,
    until: Until,
    strategy: &Strategy,
    seeds: std::ops::Range<u64>,
) -> Row {
    let runs: Vec<Option<Episode>> =
        seeds.into_par_iter().map(|seed| episode(object, slips, until, strategy, seed)).collect();
    let episodes = || runs.iter().flatten();
    let reached = |e: &Episode| e.reached();
    let actions = runs.iter().map(|e| match e {
        Some(e) if e.reached() => e.actions.len() as f64,
        _ => MOST_ACTIONS as f64,
    });
    let decided = |e: &Episode| e.actions.iter().filter(|a| a.choosing > 0.0).count() as f64;
    let ways: Vec<(f64, f64, f64)> = episodes().map(spent).collect();
    let mut choices: Vec<f64> =
        episodes().flat_map(|e| &e.actions).map(|a| a.choosing).filter(|c| *c > 0.0).collect();
    choices.sort_by(f64::total_cmp);
    Row {
        object: format!("{object}{}, {until}", if slips { ", slips" } else { "" }),
        strategy: strategy.name,
        reached: Proportion::of(runs.iter().map(|e| e.as_ref().is_some_and(reached))),
        actions: mean(actions),
        decisions: mean(episodes().map(decided)).0,
        seconds: mean(ways.iter().map(|w| w.0)),
        way: (mean(ways.iter().map(|w| w.1)).0, mean(ways.iter().map(|w| w.2)).0),
        choosing_ms: 1e3 * choices.get(choices.len() / 2).copied().unwrap_or(0.0),
    }
}

/// Seconds, metres and radians of an exploration.
fn spent(episode: &Episode) -> (f64, f64, f64) {
    let cost = Cost::default();
    let mut from = None;
    let mut sum = (0.0, 0.0, 0.0);
    for action in &episode.actions {
        let to = &action.placement;
        sum.0 += cost.between(from, to) + if action.contacts == 0 { cost.miss } else { 0.0 };
        if let Some(from) = from {
            let moved = to.hand.translation.vector - from.hand.translation.vector;
            sum.1 += moved.norm();
            sum.2 += from.hand.rotation.angle_to(&to.hand.rotation);
        }
        from = Some(to);
    }
    sum
}

/// One run; `None` where the hand never met the object or what it felt made no surface.
fn episode(
    object: &ObjectSpec,
    slips: bool,
    until: Until,
    strategy: &Strategy,
    seed: u64,
) -> Option<Episode> {
    let still = Deviation { length: 0.0, angle: 0.0 };
    let motion_noise = if slips { SLIP } else { still };
    let mut bench =
        Bench::new(Options { motion_noise, seed, ..Options::new(object.clone()) }).ok()?;
    let settings = Settings {
        criterion: Criterion::Information,
        candidates: strategy.candidates,
        planning: strategy.planning,
        tracker: slips.then_some(Kind::Hypotheses),
        graph: graph::Kind::None,
        until,
        pose: None,
        most_actions: MOST_ACTIONS,
        seed,
    };
    explore(&mut bench, &settings, |_| ()).ok()
}

/// The head of the table.
pub fn heading() -> String {
    format!(
        "  {:<38}{:<24}{:>13}{:>11}{:>16}{:>8}{:>8}  {:<22}{:>10}",
        "object", "strategy", "actions", "decisions", "seconds", "m", "rad", "reached", "choice ms"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "  {:<38}{:<24}{:>7.1} ± {:<3.1}{:>11.1}{:>9.1} ± {:<4.1}{:>8.2}{:>8.1}  {:<22}{:>10.1}",
            self.object,
            self.strategy,
            self.actions.0,
            self.actions.1,
            self.decisions,
            self.seconds.0,
            self.seconds.1,
            self.way.0,
            self.way.1,
            self.reached.to_string(),
            self.choosing_ms
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "planning ahead, criterion information, {CANDIDATES} candidates\n{}",
            heading()
        )?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  means and their 95 % intervals, runs given up counted as {MOST_ACTIONS} actions; seconds \
             by {};\n  m and rad: way and turns of the hand; choice: median time of a decision",
            Cost::default()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_count_decisions_and_seconds() {
        let object: ObjectSpec = "rectangle:0.10x0.06".parse().unwrap();
        let batch = Strategy {
            name: "batch of 3",
            candidates: Candidates::Continuous(20),
            planning: Planning { batch: 3, ..Planning::default() },
        };
        let row = row(&object, false, Until::Lenient, &batch, 0..2);
        assert_eq!(row.reached, Proportion { successes: 2, of: 2 });
        // The first grasp is drawn, every third one after it decided.
        assert!(row.decisions >= 1.0 && row.decisions <= row.actions.0 / 3.0 + 1.0, "{row}");
        let cost = Cost::default();
        let least = cost.action * row.actions.0;
        let way = cost.travel * row.way.0 + cost.turn * row.way.1;
        assert!(row.seconds.0 >= least + way - 1e-6, "{row}");
    }

    #[test]
    fn an_object_that_does_not_exist_is_named() {
        assert!(run(&["teapot:1".into()], 0..1, |_| ()).is_err());
    }
}
