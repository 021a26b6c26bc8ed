//! Grasps until a spatial object is known: active against random, by each criterion (thesis 4.5.1, which
//! needs more than 80 grasps for a cube).
//!
//! Known is what of the reachable surface lies within 3 mm of the believed one. Reachable is what the
//! fingers of ten thousand random grasps about the object meet.

use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use clap::ValueEnum;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use self::bound::{Bound, Outlook};
use super::mean::mean;
use super::proportion::Proportion;
use super::{Spread, with_room};
use crate::explore::placement::drawn;
use crate::explore::{
    Belief, Candidates, Criterion, Episode, Planning, Settings, Until, explore_until,
};
use crate::graph;
use crate::quantity::Deviation;
use crate::shape::Geometry;
use crate::sim::random::Random;
use crate::sim::{Bench, ObjectError, ObjectSpec, Options, SimError};
use crate::slam::trackers::Kind;
use crate::space::{Point, Pose};

pub mod bound;
pub mod figures;
pub mod on_table;

/// Objects that need no file.
const PRIMITIVES: [&str; 4] = [
    "box:0.07x0.07x0.07",
    "box:0.10x0.06x0.08",
    "cylinder:0.06x0.1",
    "lshape:0.09x0.09x0.035x0.05",
];

/// Meshes of the YCB set (Calli et al., IEEE Robotics & Automation Magazine 22, 2015).
const MESHES: [&str; 4] = ["banana", "mustard_bottle", "power_drill", "tomato_soup_can"];

/// Of a fixed object. Where the pose is known there is nothing to learn about it: the criteria about the
/// pose leave every choice to 4.20, and the information that is left when the pose must be learnt too is
/// the joint entropy.
const FIXED: [Criterion; 5] = [
    Criterion::Random,
    Criterion::VarianceSum,
    Criterion::Variance,
    Criterion::Igef,
    Criterion::Entropy,
];

/// Of one that moves.
const MOVING: [Criterion; 10] = [
    Criterion::Random,
    Criterion::VarianceSum,
    Criterion::Igef,
    Criterion::Shannon,
    Criterion::Renyi,
    Criterion::MutualInformation,
    Criterion::Kl,
    Criterion::DetSigma,
    Criterion::Entropy,
    Criterion::Information,
];

/// Grasps after which a run is given up.
const MOST_GRASPS: usize = 60;

/// New candidates at every choice.
const CANDIDATES: usize = 120;

/// Slip at every grasp of a moving object, per axis.
const SLIP: Deviation = Deviation { length: 5e-3, angle: 10.0 * std::f64::consts::PI / 180.0 };

/// How near the last pose of an object that slips is wanted.
const TOLERANCE: Deviation = Deviation { length: 3e-3, angle: 3.0 * std::f64::consts::PI / 180.0 };

/// Share of the reachable surface that must be known, and how near the believed one must be to it,
/// metres.
const SHARE: f64 = 0.9;
const NEAR: f64 = 3e-3;

/// The part of a surface that a hand can touch, as points.
#[derive(Clone, Debug, PartialEq)]
pub struct Reachable {
    /// True object frame, metres.
    pub points: Vec<Point>,
    /// Of so many, spread evenly over the whole surface.
    pub of: usize,
}

impl Reachable {
    /// Points looked at, and hands that try to touch them.
    const SAMPLES: usize = 400;
    const HANDS: usize = 10_000;

    /// Of an object in free space: within 3 mm of where a finger of some grasp as exploration draws
    /// them meets a surface that faces the same way.
    pub fn of(geometry: &Geometry) -> Reachable {
        let (dimension, centre) = (geometry.dimension(), geometry.centroid());
        let (low, high) = geometry.bounds();
        let radius = ((high - low) / 2.0).norm();
        let [mut random] = Random::streams(0);
        let mut met: Vec<(Point, Point)> = Vec::new();
        for _ in 0..Self::HANDS {
            let placement = drawn(dimension, &centre, radius, &mut random);
            for stroke in placement.strokes(dimension, 2.0 * radius) {
                let start = (placement.hand * Point3::from(stroke.start)).coords;
                let direction = placement.hand.rotation * stroke.direction;
                let hit = geometry.cast(&start, &direction, stroke.travel);
                met.extend(hit.map(|(along, normal)| (start + along * direction, normal)));
            }
        }
        let reached = |(point, normal): &(Point, Point)| {
            met.iter().any(|(p, n)| (p - point).norm_squared() < NEAR * NEAR && n.dot(normal) > 0.5)
        };
        let samples = geometry.samples(Self::SAMPLES);
        let of = samples.len();
        let points = samples.into_par_iter().filter(reached).map(|(point, _)| point).collect();
        Reachable { points, of }
    }

    /// The share that is within 3 mm of the believed surface, the true object frame being at `frame`
    /// in the believed one.
    pub fn known(&self, belief: &Belief, frame: &Pose) -> f64 {
        let near =
            |p: &&Point| belief.geometry.distance(&(frame * Point3::from(**p)).coords) < NEAR;
        self.points.iter().filter(near).count() as f64 / self.points.len().max(1) as f64
    }
}

/// Which part of the comparison to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Only objects whose name holds one of these; one that matches none is an object of its own.
    pub objects: Vec<String>,
    /// One run each.
    pub seeds: Range<u64>,
    /// Whether the object slips by 5 mm and 10° at every grasp, and who follows it then.
    pub moving: Option<Kind>,
}

/// One object, one criterion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was explored.
    pub object: String,
    /// Share of its surface that a hand reaches.
    pub reachable: f64,
    /// What decided.
    pub criterion: String,
    /// Mean number of grasps, those of runs that were given up counted as 60.
    pub grasps: f64,
    /// Half of the 95 % interval of that mean.
    pub plus_minus: f64,
    /// Mean number of contacts that they felt.
    pub contacts: f64,
    /// Runs that got there.
    pub reached: Proportion,
    /// Runs with a last pose within 3 mm and 3°.
    pub pose: Proportion,
    /// Share of runs that would have such a pose after their last grasp had the shape, and the pose before
    /// the slip, been known exactly ([`Bound`]), percent; `None` of an object that stays where it is.
    pub possible: Option<f64>,
    /// Error of the last pose, millimetres.
    pub pose_mm: Option<Spread>,
    /// The same in degrees, without regard to symmetry.
    pub pose_deg: Option<Spread>,
    /// Mean time of a choice among 120, milliseconds, with as many runs at once as there are cores;
    /// `None` where chance chose.
    pub choosing_ms: Option<f64>,
    /// Mean time of a whole action: belief, choice, and what is known.
    pub action_ms: f64,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Who followed the objects; none where they stayed where they were.
    pub tracker: Option<&'static str>,
    /// One per object and criterion.
    pub rows: Vec<Row>,
    /// Of each object that slips, how probable a pose within 3 mm and 3° is after one grasp of a known shape.
    pub outlooks: Vec<(String, Outlook)>,
    /// What was left out and why.
    pub skipped: Vec<String>,
}

struct Object {
    name: String,
    spec: ObjectSpec,
}

/// Runs what is selected, meshes from `data`/ycb, and tells `watch` of each row as it is done.
///
/// # Errors
/// When an object does not exist or is a planar one.
pub fn run(
    data: Option<&Path>,
    selection: &Selection,
    mut watch: impl FnMut(&Row),
) -> Result<Table, ObjectError> {
    let (objects, skipped) = objects(data, &selection.objects)?;
    let criteria: &[Criterion] = if selection.moving.is_some() { &MOVING } else { &FIXED };
    let (mut rows, mut outlooks) = (Vec::new(), Vec::new());
    for object in &objects {
        let geometry = object.spec.geometry()?;
        let reachable = with_room(|| Reachable::of(&geometry));
        if selection.moving.is_some() {
            let outlook = with_room(|| bound(&object.spec, &geometry).outlook(&geometry));
            outlooks.push((object.name.clone(), outlook));
        }
        for criterion in criteria {
            let row = with_room(|| row(object, &reachable, *criterion, selection));
            watch(&row);
            rows.push(row);
        }
    }
    Ok(Table { tracker: selection.moving.map(Kind::name), rows, outlooks, skipped })
}

fn objects(
    data: Option<&Path>,
    wanted: &[String],
) -> Result<(Vec<Object>, Vec<String>), ObjectError> {
    let mut objects = Vec::new();
    let mut skipped = Vec::new();
    for text in PRIMITIVES {
        objects.push(Object { name: text.into(), spec: text.parse()? });
    }
    for mesh in MESHES {
        let path = data.map(|d| d.join("ycb").join(mesh).with_extension("ply"));
        match path.filter(|p| p.is_file()) {
            Some(path) => {
                objects.push(Object { name: format!("ycb/{mesh}"), spec: ObjectSpec::Mesh(path) });
            }
            None => skipped.push(format!("ycb/{mesh}: not in $TACTILE_DATA")),
        }
    }
    if wanted.is_empty() {
        return Ok((objects, skipped));
    }
    let holds = |name: &str| wanted.iter().any(|w| name.contains(w.as_str()));
    let mut others = Vec::new();
    for text in wanted {
        let mut known =
            objects.iter().map(|o| o.name.as_str()).chain(skipped.iter().map(String::as_str));
        if !known.any(|name| name.contains(text.as_str())) {
            let spec: ObjectSpec = text.parse()?;
            if spec.dimension() != 3 {
                let (expected, found) = ("an object in space".into(), "one in the plane".into());
                return Err(ObjectError::Size { text: text.clone(), expected, found });
            }
            others.push(Object { name: text.clone(), spec });
        }
    }
    objects.retain(|o| holds(&o.name));
    skipped.retain(|s| holds(s));
    objects.extend(others);
    Ok((objects, skipped))
}

/// What decides how well the pose of an object that slips can be known.
fn bound(spec: &ObjectSpec, geometry: &Geometry) -> Bound {
    Bound {
        contact: Options::new(spec.clone()).contact_noise,
        slip: SLIP,
        centre: geometry.centroid(),
        tolerance: TOLERANCE,
    }
}

/// How probable a pose within the tolerance is after the last grasp of a log at best.
fn possible(bench: &Bench, spec: &ObjectSpec) -> f64 {
    let Some((grasp, truth)) = bench.log().grasps.last().and_then(|g| Some((g, g.truth?))) else {
        return 0.0;
    };
    let back = truth.inverse();
    let felt = grasp
        .contacts
        .iter()
        .filter_map(|c| Some(((back * Point3::from(c.point)).coords, back.rotation * c.normal?)));
    bound(spec, bench.geometry()).chance(&felt.collect::<Vec<_>>())
}

/// One run and how long it took, seconds.
struct Run {
    episode: Episode,
    /// [`possible`], where the object slips.
    possible: Option<f64>,
    seconds: f64,
}

fn row(object: &Object, reachable: &Reachable, criterion: Criterion, selection: &Selection) -> Row {
    let seeds = selection.seeds.clone().into_par_iter();
    let runs: Vec<Option<Run>> = seeds
        .map(|seed| {
            let start = Instant::now();
            let mut bench = bench(&object.spec, selection.moving.is_some(), seed).ok()?;
            let settings = settings(criterion, selection.moving, seed);
            let episode = episode(&mut bench, &settings, reachable)?;
            let seconds = start.elapsed().as_secs_f64();
            let possible = selection.moving.map(|_| possible(&bench, &object.spec));
            Some(Run { episode, possible, seconds })
        })
        .collect();
    let reached = |r: &Option<Run>| r.as_ref().is_some_and(|r| r.episode.reached());
    let grasps: Vec<f64> = runs
        .iter()
        .map(|run| match run {
            Some(Run { episode, .. }) if episode.reached() => episode.actions.len() as f64,
            _ => MOST_GRASPS as f64,
        })
        .collect();
    let n = runs.len().max(1) as f64;
    let (grasps, plus_minus) = mean(grasps);
    let actions = || runs.iter().flatten().flat_map(|r| &r.episode.actions);
    let count = actions().count().max(1) as f64;
    let choices: Vec<f64> = actions().filter(|a| a.gain.is_some()).map(|a| a.choosing).collect();
    let ended = |of: fn(&Episode) -> f64| Spread::of(runs.iter().flatten().map(|r| of(&r.episode)));
    let good = |r: &Run| {
        let (metres, radians) = r.episode.pose_error;
        metres < TOLERANCE.length && radians < TOLERANCE.angle
    };
    let chances: Vec<f64> = runs.iter().flatten().filter_map(|r| r.possible).collect();
    Row {
        object: object.name.clone(),
        reachable: reachable.points.len() as f64 / reachable.of.max(1) as f64,
        criterion: criterion.to_possible_value().map_or_else(String::new, |v| v.get_name().into()),
        grasps,
        plus_minus,
        contacts: actions().map(|a| a.contacts as f64).sum::<f64>() / n,
        reached: Proportion::of(runs.iter().map(reached)),
        pose: Proportion::of(runs.iter().map(|r| r.as_ref().is_some_and(good))),
        possible: (!chances.is_empty())
            .then(|| 100.0 * chances.iter().sum::<f64>() / chances.len() as f64),
        pose_mm: ended(|e| 1e3 * e.pose_error.0),
        pose_deg: ended(|e| e.pose_error.1.to_degrees()),
        choosing_ms: (!choices.is_empty())
            .then(|| 1e3 * choices.iter().sum::<f64>() / choices.len() as f64),
        action_ms: 1e3 * runs.iter().flatten().map(|r| r.seconds).sum::<f64>() / count,
    }
}

fn bench(spec: &ObjectSpec, moving: bool, seed: u64) -> Result<Bench, SimError> {
    let still = Deviation { length: 0.0, angle: 0.0 };
    let motion_noise = if moving { SLIP } else { still };
    Bench::new(Options { motion_noise, seed, ..Options::new(spec.clone()) })
}

fn settings(criterion: Criterion, tracker: Option<Kind>, seed: u64) -> Settings {
    Settings {
        criterion,
        candidates: Candidates::Continuous(CANDIDATES),
        planning: Planning::default(),
        tracker,
        graph: graph::Kind::None,
        // What is known is measured otherwise.
        until: Until::Lenient,
        pose: None,
        most_actions: MOST_GRASPS,
        seed,
    }
}

/// `None` where the hand never met the object or what it felt made no surface.
fn episode(bench: &mut Bench, settings: &Settings, reachable: &Reachable) -> Option<Episode> {
    let known = |belief: &Belief, frame: &Pose| (reachable.known(belief, frame), SHARE);
    explore_until(bench, settings, known, |_| ()).ok()
}

/// The head of the table.
pub fn heading() -> String {
    format!(
        "  {:<30}{:>10}  {:<20}{:>14}{:>10}  {:<20}{:<18}{:>9}  {:<20}{:<22}{:>9}{:>11}",
        "object",
        "reachable",
        "criterion",
        "grasps",
        "contacts",
        "reached",
        "pose < 3 mm, 3°",
        "possible",
        "pose mm",
        "pose °",
        "choice ms",
        "action ms"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        write!(
            f,
            "  {:<30}{:>8.0} %  {:<20}{:>7.1} ± {:<4.1}{:>10.0}  {:<20}{:<18}{:>9}  {:<20}{:<22}{:>9}{:>11.0}",
            self.object,
            100.0 * self.reachable,
            self.criterion,
            self.grasps,
            self.plus_minus,
            self.contacts,
            self.reached.to_string(),
            self.pose.to_string(),
            self.possible.map_or("–".to_owned(), |share| format!("{share:.0} %")),
            show(&self.pose_mm),
            show(&self.pose_deg),
            self.choosing_ms.map_or("–".to_owned(), |ms| format!("{ms:.1}")),
            self.action_ms
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let object = match self.tracker {
            None => "fixed object".to_owned(),
            Some(tracker) => {
                format!("object that slips by 5 mm and 10° per axis, tracker {tracker}")
            }
        };
        writeln!(
            f,
            "grasps of five fingers until 90 % of the reachable surface is within 3 mm of the believed \
             one, {object} (thesis 4.5.1: a cube, more than 80 grasps, 165 contacts)"
        )?;
        writeln!(f, "{}", heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        for skipped in &self.skipped {
            writeln!(f, "  skipped {skipped}")?;
        }
        for (object, Outlook { usual, best }) in &self.outlooks {
            writeln!(
                f,
                "  {object}: had the shape and the pose before the slip been known exactly, a usual grasp would \
                 leave the pose within 3 mm and 3° in {:.0} % of cases, the best of a thousand in {:.0} %",
                100.0 * usual,
                100.0 * best
            )?;
        }
        if self.tracker.is_none() {
            writeln!(
                f,
                "  at a known pose information is entropy; shannon, renyi, mutual-information, kl and \
                 det-sigma leave all to variance-sum"
            )?;
        }
        write!(
            f,
            "  mean and its 95 % interval, runs given up counted as {MOST_GRASPS}; Wilson intervals; \
             poses: median [quartiles]"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::Mesh;
    use crate::shape::mesh::tests::cuboid;

    #[test]
    fn a_convex_object_is_all_within_reach_and_what_is_inside_another_is_not() {
        let of =
            |text: &str| Reachable::of(&text.parse::<ObjectSpec>().unwrap().geometry().unwrap());
        let prism = of("prism:0.08,hexagon:0.04");
        assert_eq!(prism.of, Reachable::SAMPLES);
        assert!(prism.points.len() >= prism.of * 99 / 100, "{}", prism.points.len());
        // A hollow cube: the walls of its inside have a quarter of the area.
        let [outer, inner] = [0.04, 0.02].map(|half| cuboid([half; 3]));
        let turned = inner.triangles().iter().map(|t| [t[0] + 8, t[2] + 8, t[1] + 8]);
        let triangles = outer.triangles().iter().copied().chain(turned).collect();
        let vertices = [outer.vertices(), inner.vertices()].concat();
        let hollow = Mesh::new(vertices, triangles).unwrap();
        let within = Reachable::of(&Geometry::Mesh(hollow));
        assert!((within.points.len() as f64 / within.of as f64 - 0.8).abs() < 0.02);
        assert!(within.points.iter().all(|p| p.amax() > 0.03));
    }

    #[test]
    fn a_wedge_takes_fewer_grasps_than_contacts_and_planar_objects_are_refused() {
        let selection = |object: &str| Selection {
            objects: vec![object.into()],
            seeds: 1000..1001,
            moving: None,
        };
        let refused = run(None, &selection("rectangle:0.1x0.06"), |_| ()).unwrap_err();
        assert!(refused.to_string().contains("an object in space"), "{refused}");
        let (objects, skipped) = objects(None, &["mustard".into()]).unwrap();
        assert!(objects.is_empty() && skipped.len() == 1 && skipped[0].contains("mustard"));
        let object =
            Object { name: "wedge".into(), spec: "prism:0.06,triangle:0.05".parse().unwrap() };
        let reachable = Reachable::of(&object.spec.geometry().unwrap());
        let row = with_room(|| row(&object, &reachable, Criterion::Entropy, &selection("wedge")));
        assert_eq!(row.reached, Proportion { successes: 1, of: 1 });
        assert!(row.grasps <= 20.0 && row.contacts > row.grasps, "{row}");
    }
}
