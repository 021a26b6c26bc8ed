//! Every tracker on every object at every noise: how often it keeps the object, and what it costs.

pub mod bound;
pub mod consistency;
pub mod judge;
pub mod mujoco;

use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use std::time::Instant;

use clap::ValueEnum;
use rayon::prelude::*;
use serde::Serialize;

use crate::baseline::Baseline;
use crate::experiment::proportion::Proportion;
use crate::experiment::{Spread, with_room};
use crate::graph;
use crate::log::GraspLog;
use crate::model::Faces;
use crate::quantity::{Deviation, Displacement};
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::track::{Step, truth};
use crate::slam::trackers::Kind;
use crate::space::{Point, Pose};
use judge::{Judgement, Truth, judge_known};

/// Objects in the plane and in space that need no file.
const OBJECTS: [&str; 12] = [
    "rectangle:0.10x0.06",
    "triangle:0.06",
    "corners:-0.05x-0.03,0.045x-0.035,0.055x0.02,-0.03x0.04",
    "ellipse:0.10x0.06",
    "hexagon:0.045",
    "lshape:0.09x0.09x0.035",
    "box:0.12x0.06x0.06",
    "prism:0.06,corners:-0.03x-0.0217,0.06x-0.0217,-0.03x0.0433",
    "prism:0.08,hexagon:0.04",
    "lshape:0.09x0.09x0.035x0.05",
    "cylinder:0.06x0.1",
    "ellipsoid:0.12x0.08x0.06",
];

/// Parts of 100 % that are tried unless told otherwise.
const NOISE: [f64; 3] = [25.0, 50.0, 100.0];

/// The motion noise called 100 %, per axis: 10 mm, and 20° in the plane (thesis 3.4) or 11.5° in
/// space, where there are three axes (20°/√3).
pub fn full_noise(dimension: usize) -> Deviation {
    let degrees: f64 = if dimension == 2 { 20.0 } else { 11.5 };
    Deviation { length: 0.01, angle: degrees.to_radians() }
}

/// Whose poses are judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contender {
    /// The true poses: what the shape model alone leaves to be wished for.
    Oracle,
    /// The joint graph from the true poses: what the likeliest poses and surface leave to be wished for
    /// where nothing was ever taken for something else.
    Batch,
    /// Draws from what an estimator could know that was told the faces: what grasps cannot feel.
    Bound,
    /// The intended motions one after the other: what there is without touch.
    Odometry,
    /// A tracker on offer.
    Tracker(Kind),
    /// A tracker of another school.
    Baseline(Baseline),
}

/// No contender has that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown tracker {text:?}: expected {}", names(", "))]
pub struct UnknownContender {
    text: String,
}

fn names(between: &str) -> String {
    Contender::all().map(Contender::name).collect::<Vec<_>>().join(between)
}

impl FromStr for Contender {
    type Err = UnknownContender;

    fn from_str(text: &str) -> Result<Self, UnknownContender> {
        Contender::all()
            .find(|c| c.name() == text)
            .ok_or_else(|| UnknownContender { text: text.into() })
    }
}

impl Contender {
    /// All of them, in the table's order.
    pub fn all() -> impl Iterator<Item = Contender> {
        let trackers = Kind::value_variants().iter().map(|kind| Contender::Tracker(*kind));
        let baselines = Baseline::ALL.into_iter().map(Contender::Baseline);
        let given = [Contender::Oracle, Contender::Batch, Contender::Bound, Contender::Odometry];
        given.into_iter().chain(trackers).chain(baselines)
    }

    /// As tables and the command line name it.
    pub fn name(self) -> &'static str {
        match self {
            Contender::Oracle => "oracle",
            Contender::Batch => "batch",
            Contender::Bound => "bound",
            Contender::Odometry => "odometry",
            Contender::Tracker(kind) => kind.name(),
            Contender::Baseline(baseline) => baseline.name(),
        }
    }

    /// One step per grasp; none where the oracle has no true poses, and none of the bound, which has to
    /// be told the object ([`bound::follow`]). The batch's are the true poses, to start from.
    pub fn follow(self, log: &GraspLog, seed: u64) -> Vec<Step> {
        match self {
            Contender::Oracle | Contender::Batch => truth(log).unwrap_or_default(),
            Contender::Bound => Vec::new(),
            Contender::Odometry => odometry(log),
            Contender::Tracker(kind) => kind.follow(log, seed),
            Contender::Baseline(baseline) => baseline.follow(log, seed),
        }
    }

    /// Whether it estimates anything.
    pub fn is_tracker(self) -> bool {
        matches!(self, Contender::Tracker(_) | Contender::Baseline(_))
    }
}

/// Dead reckoning from the first true pose, or the origin: unknown motions stay.
fn odometry(log: &GraspLog) -> Vec<Step> {
    let mut pose = log.grasps.first().and_then(|g| g.truth).unwrap_or_else(Pose::identity);
    let moved = log.grasps.iter().enumerate().map(|(i, grasp)| {
        if let Some(motion) = grasp.motion.filter(|_| i > 0) {
            pose = motion * pose;
            pose.rotation.renormalize();
        }
        Step::certain(pose)
    });
    moved.collect()
}

/// Which part of the comparison to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// As [`ObjectSpec`] reads them, or parts of the usual objects' names; all usual ones where empty.
    pub objects: Vec<String>,
    /// Motion noise in percent of [`full_noise`]; the usual where empty.
    pub noise: Vec<f64>,
    /// Who takes part; all where empty.
    pub contenders: Vec<Contender>,
    /// What corrects the trackers' poses afterwards.
    pub graph: graph::Kind,
    /// How far the object is carried half-way, which no log says.
    pub carried: Option<Displacement>,
    /// Part of the contacts that is wild.
    pub outliers: f64,
    /// How many in each run; as the simulator has it where `None`.
    pub grasps: Option<usize>,
    /// Runs of each case.
    pub seeds: u64,
    /// The first of the seeds.
    pub first_seed: u64,
}

impl Selection {
    /// The seeds.
    fn range(&self) -> Range<u64> {
        self.first_seed..self.first_seed.saturating_add(self.seeds)
    }

    /// The noise, or the usual.
    fn percents(&self) -> &[f64] {
        if self.noise.is_empty() { &NOISE } else { &self.noise }
    }
}

/// One contender on one object at one noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// As the simulator has it.
    pub object: String,
    /// Percent of [`full_noise`].
    pub noise: f64,
    /// Who.
    pub tracker: &'static str,
    /// Runs with the right shape and last pose, see [`Judgement::is_success`].
    pub success: Proportion,
    /// Aligned, millimetres.
    pub hausdorff_mm: Option<Spread>,
    /// Error of the last pose.
    pub last_mm: Option<Spread>,
    /// In degrees, up to symmetry.
    pub last_deg: Option<Spread>,
    /// Root mean square error of all poses.
    pub rms_mm: Option<Spread>,
    /// In degrees, up to symmetry.
    pub rms_deg: Option<Spread>,
    /// Contacts at the estimated poses to the true surface, root mean square, millimetres.
    pub contacts_mm: Option<Spread>,
    /// Lost grasps in a run, on average.
    pub lost: f64,
    /// The tracker, and the graph where there is one, milliseconds per grasp.
    pub milliseconds: Option<Spread>,
    /// The whole row took so long, seconds.
    pub seconds: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Seeds, outliers and what else was made of the objects.
    pub title: String,
    /// One per case and contender.
    pub rows: Vec<Row>,
    /// One per noise and contender, over all objects, spreads of their medians; none where there is one object.
    pub overall: Vec<Row>,
}

/// Compares the contenders on what is selected. `done` is told each row as soon as there is one.
///
/// # Errors
/// When an object does not exist or cannot be simulated.
pub fn run(selection: &Selection, mut done: impl FnMut(&Row)) -> Result<Comparison, SimError> {
    let mut rows = Vec::new();
    let contenders = match &selection.contenders[..] {
        [] => Contender::all().collect(),
        chosen => chosen.to_vec(),
    };
    for spec in objects(&selection.objects)? {
        let truth = Truth::new(spec.geometry()?);
        let faces = bound::directions(&truth.geometry);
        for percent in selection.percents() {
            for contender in &contenders {
                if *contender == Contender::Bound && faces.is_none() {
                    continue;
                }
                let row =
                    compare(&spec, &truth, faces.as_deref(), *percent, *contender, selection)?;
                done(&row);
                rows.push(row);
            }
        }
    }
    let Selection { carried, outliers, first_seed, .. } = selection;
    let title = format!(
        "Tracking{}: contacts 1 mm and 5°, {:.0} % of them wild{}, seeds {first_seed} to {}",
        match selection.graph {
            graph::Kind::Planes => ", corrected by the joint graph",
            graph::Kind::Pairwise => ", corrected by the pairwise graph",
            graph::Kind::None => "",
        },
        100.0 * outliers,
        carried.map_or(String::new(), |by| format!(", objects carried {by} away half-way")),
        selection.range().end.saturating_sub(1)
    );
    let overall = overall(&rows);
    Ok(Comparison { title, rows, overall })
}

/// What rows of the same noise and contender have in common.
fn overall(rows: &[Row]) -> Vec<Row> {
    let mut cases: Vec<(f64, &'static str)> = Vec::new();
    for row in rows {
        let case = (row.noise, row.tracker);
        if !cases.contains(&case) {
            cases.push(case);
        }
    }
    let sum_up = |(noise, tracker): (f64, &'static str)| {
        let of: Vec<&Row> =
            rows.iter().filter(|r| r.noise == noise && r.tracker == tracker).collect();
        let medians = |spread: fn(&Row) -> Option<Spread>| {
            Spread::of(of.iter().filter_map(|r| spread(r)).map(|s| s.median))
        };
        (of.len() > 1).then(|| Row {
            object: format!("all {} objects", of.len()),
            noise,
            tracker,
            success: of.iter().map(|r| r.success).sum(),
            hausdorff_mm: medians(|r| r.hausdorff_mm),
            last_mm: medians(|r| r.last_mm),
            last_deg: medians(|r| r.last_deg),
            rms_mm: medians(|r| r.rms_mm),
            rms_deg: medians(|r| r.rms_deg),
            contacts_mm: medians(|r| r.contacts_mm),
            lost: of.iter().map(|r| r.lost).sum::<f64>() / of.len() as f64,
            milliseconds: medians(|r| r.milliseconds),
            seconds: of.iter().map(|r| r.seconds).sum(),
        })
    };
    cases.into_iter().filter_map(sum_up).collect()
}

/// The usual objects that are wanted, and the others.
fn objects(wanted: &[String]) -> Result<Vec<ObjectSpec>, SimError> {
    let is_wanted = |name: &&&str| wanted.is_empty() || wanted.iter().any(|w| name.contains(&**w));
    let usual = OBJECTS.iter().filter(is_wanted).map(|name| Ok(name.parse()?));
    let is_other = |w: &&String| !OBJECTS.iter().any(|name| name.contains(&***w));
    usual.chain(wanted.iter().filter(is_other).map(|text| Ok(text.parse()?))).collect()
}

/// What one seed gave.
pub(super) struct Run {
    /// `None` where there is nothing to judge by.
    pub(super) judgement: Option<Judgement>,
    /// Per grasp.
    milliseconds: f64,
}

fn compare(
    spec: &ObjectSpec,
    truth: &Truth,
    faces: Option<&[Point]>,
    noise: f64,
    contender: Contender,
    selection: &Selection,
) -> Result<Row, SimError> {
    let start = Instant::now();
    let options = options(spec, noise, selection);
    let follow = |log: &GraspLog, seed| {
        let steps = match (contender, faces) {
            (Contender::Bound, Some(faces)) => bound::follow(log, faces, seed),
            _ => contender.follow(log, seed),
        };
        Followed::after(contender, selection.graph, log, steps)
    };
    let runs = runs(&options, truth, selection.range(), &follow)?;
    let judged: Vec<Judgement> = runs.iter().filter_map(|r| r.judgement).collect();
    let spread = |f: fn(&Judgement) -> f64| Spread::of(judged.iter().map(f));
    let times = runs.iter().map(|r| r.milliseconds).filter(|_| contender.is_tracker());
    Ok(Row {
        object: spec.to_string(),
        noise,
        tracker: contender.name(),
        success: Proportion::of(runs.iter().map(|r| r.judgement.is_some_and(|j| j.is_success()))),
        hausdorff_mm: Spread::of(judged.iter().filter_map(|j| Some(1e3 * j.hausdorff?))),
        last_mm: spread(|j| 1e3 * j.last.translation),
        last_deg: spread(|j| j.last.rotation.to_degrees()),
        rms_mm: spread(|j| 1e3 * j.rms.translation),
        rms_deg: spread(|j| j.rms.rotation.to_degrees()),
        contacts_mm: spread(|j| 1e3 * j.contacts),
        lost: judged.iter().map(|j| j.lost as f64).sum::<f64>() / judged.len().max(1) as f64,
        milliseconds: Spread::of(times),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// The simulation of an object at so many percent of [`full_noise`].
fn options(spec: &ObjectSpec, percent: f64, selection: &Selection) -> Options {
    let full = full_noise(spec.dimension());
    let part = percent / 100.0;
    Options {
        motion_noise: Deviation { length: full.length * part, angle: full.angle * part },
        carried: selection.carried,
        outliers: selection.outliers,
        grasps: selection.grasps,
        ..Options::new(spec.clone())
    }
}

/// The poses that a run is judged by, and the faces where a graph estimated them too.
pub(super) struct Followed {
    pub(super) steps: Vec<Step>,
    pub(super) faces: Option<Faces>,
}

impl From<Vec<Step>> for Followed {
    fn from(steps: Vec<Step>) -> Followed {
        Followed { steps, faces: None }
    }
}

impl Followed {
    /// A tracker's steps after the graph.
    pub(super) fn corrected(graph: graph::Kind, log: &GraspLog, steps: Vec<Step>) -> Followed {
        Followed::instead(graph.correct(log, &steps), steps)
    }

    /// A contender's steps: a tracker's after the graph, and the batch's, which is one.
    pub(super) fn after(
        contender: Contender,
        graph: graph::Kind,
        log: &GraspLog,
        steps: Vec<Step>,
    ) -> Followed {
        let found = match contender {
            Contender::Batch => {
                graph::joint::refine(log, &steps).map(|found| graph::Corrected::jointly(log, found))
            }
            Contender::Tracker(_) | Contender::Baseline(_) => graph.correct(log, &steps),
            Contender::Oracle | Contender::Bound | Contender::Odometry => None,
        };
        Followed::instead(found, steps)
    }

    /// What was found, else the steps as they are.
    fn instead(found: Option<graph::Corrected>, steps: Vec<Step>) -> Followed {
        match found {
            Some(found) => Followed { steps: found.relative, faces: found.faces },
            None => steps.into(),
        }
    }

    /// `None` where there is nothing to judge by.
    pub(super) fn judged(&self, log: &GraspLog, truth: &Truth) -> Option<Judgement> {
        judge_known(log, &self.steps, self.faces.as_ref(), truth)
    }
}

/// Simulates, follows and judges, a run for each seed; the tracker's seed is the simulation's.
///
/// # Errors
/// When the object cannot be simulated.
pub(super) fn runs<F: Into<Followed>>(
    options: &Options,
    truth: &Truth,
    seeds: Range<u64>,
    follow: &(dyn Fn(&GraspLog, u64) -> F + Sync),
) -> Result<Vec<Run>, SimError> {
    let one = |seed| {
        let log = simulate(&Options { seed, ..options.clone() })?.log;
        let start = Instant::now();
        let followed = follow(&log, seed).into();
        let milliseconds = 1e3 * start.elapsed().as_secs_f64() / log.grasps.len().max(1) as f64;
        Ok(Run { judgement: followed.judged(&log, truth), milliseconds })
    };
    with_room(|| seeds.into_par_iter().map(one).collect())
}

/// The line above the rows.
pub fn heading() -> String {
    format!(
        "  {:<34}{:>6}  {:<16}{:<19}{:<20}{:<19}{:<19}{:<14}{:<7}{:>5}{:>9}{:>8}",
        "object",
        "noise",
        "tracker",
        "success",
        "Hausdorff mm",
        "last mm",
        "last °",
        "rms mm, °",
        "touch",
        "lost",
        "ms/grasp",
        "time"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |s: &Option<Spread>| {
            s.map_or("–".to_owned(), |s| format!("{:.1} [{:.1}, {:.1}]", s.median, s.low, s.high))
        };
        let median =
            |s: &Option<Spread>| s.map_or("–".to_owned(), |s| format!("{:.1}", s.median));
        // An object's corners need not be read out.
        let object: String = self.object.chars().take(32).collect();
        write!(
            f,
            "  {object:<34}{:>4} %  {:<16}{:<19}{:<20}{:<19}{:<19}{:<14}{:<7}{:>5.1}{:>9}{:>6.0} s",
            self.noise,
            self.tracker,
            self.success.to_string(),
            show(&self.hausdorff_mm),
            show(&self.last_mm),
            show(&self.last_deg),
            format!("{}, {}", median(&self.rms_mm), median(&self.rms_deg)),
            median(&self.contacts_mm),
            self.lost,
            self.milliseconds.map_or("–".to_owned(), |s| format!("{:.2}", s.median)),
            self.seconds
        )
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n{}", self.title, heading())?;
        for row in self.rows.iter().chain(&self.overall) {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  all objects: successes of all runs; medians and quartiles of the objects' medians\n  \
             success: Hausdorff < 9 mm and last pose within 5 mm and 5°, with Wilson's 95 % interval; \
             others: median [quartiles]\n  \
             noise: 100 % is 10 mm and 20° a grasp in the plane, 10 mm and 11.5° per axis in space\n  \
             frames agree where the contacts at the estimated poses fit the true surface best; \
             rotations count up to the object's symmetry\n  \
             Hausdorff: of the surface that slam makes of the contacts at the estimated poses, after \
             the best rigid alignment\n  \
             bound: poses as well known as the grasps allow an estimator that was told the faces (not \
             for curved objects)\n  \
             touch: contacts at the estimated poses to the true surface, rms mm; lost: grasps a run; \
             ms/grasp: the tracker and, where there is one, the graph"
        )
    }
}

#[cfg(test)]
mod tests;
