//! Whether trackers know how wrong they are: the normalised estimation error squared of the last pose.
//!
//! With the error δ in tangent coordinates and the tracker's own covariance P, δᵀP⁻¹δ of an honest
//! Gaussian belief follows χ² with as many degrees of freedom as the pose has (Bar-Shalom, Li &
//! Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4). A covariance is
//! about the frame that the tracker chose; there are two ways to say where that lies. By its first
//! grasp: then the error holds all drift since. By its map, as [`judge`](super::judge::judge): then it holds
//! what the last grasp did not settle.

use std::fmt;

use nalgebra::{DMatrix, Translation3};
use rayon::prelude::*;
use serde::Serialize;
use tactile_core::track::Status;

use super::judge::{Truth, gauge};
use super::{Contender, Selection, objects, options};
use crate::experiment::proportion::Proportion;
use crate::experiment::{Spread, with_room};
use crate::reference::filter::local;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::track::Step;
use crate::space::Pose;

/// A second answer with no more than this share of the belief leaves it unimodal.
const SECOND: f64 = 0.05;

/// Between them lie 95 % of χ² with 3 and with 6 degrees of freedom.
const BANDS: [(f64, f64); 2] = [(0.2158, 9.3484), (1.2373, 14.4494)];

/// Errors in deviations, over the runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Runs within the 95 % band.
    pub within: Proportion,
    /// Runs that claim to know a direction exactly. They are outside the band, and in no figure below.
    pub singular: usize,
    /// Of δᵀP⁻¹δ over its degrees of freedom: 0.79 in the plane and 0.89 in space where honest.
    pub per_degree: Option<Spread>,
    /// Mean of the same, 1 where honest; NaN of none.
    pub mean: f64,
}

/// One tracker on one object at one noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// As the simulator has it.
    pub object: String,
    /// Percent of [`full_noise`](super::full_noise).
    pub noise: f64,
    /// Who.
    pub tracker: &'static str,
    /// Runs whose last belief has one answer, of all.
    pub unimodal: Proportion,
    /// Of those, the frames agreeing at the first grasp.
    pub since_first: Consistency,
    /// The frames agreeing where the contacts fit the true surface.
    pub on_map: Consistency,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// One per case and tracker.
    pub rows: Vec<Row>,
}

/// Judges the covariances of all trackers on what is selected. `done` is told each row as soon as
/// there is one. Objects that turn freely are left out: their poses have fewer degrees of freedom.
///
/// # Errors
/// When an object does not exist or cannot be simulated.
pub fn run(selection: &Selection, mut done: impl FnMut(&Row)) -> Result<Table, SimError> {
    let contenders: Vec<Contender> = match &selection.contenders[..] {
        [] => Contender::all().collect(),
        chosen => chosen.to_vec(),
    };
    let mut rows = Vec::new();
    for spec in objects(&selection.objects)? {
        let truth = Truth::new(spec.geometry()?);
        if truth.symmetry.order().is_none() {
            continue;
        }
        for percent in selection.percents() {
            for contender in contenders.iter().filter(|c| c.is_tracker()) {
                let row = examine(&spec, &truth, *percent, *contender, selection)?;
                done(&row);
                rows.push(row);
            }
        }
    }
    Ok(Table { rows })
}

fn examine(
    spec: &ObjectSpec,
    truth: &Truth,
    noise: f64,
    contender: Contender,
    selection: &Selection,
) -> Result<Row, SimError> {
    let options = options(spec, noise, selection);
    // Of one run, where the belief has one answer: since the first grasp, and on the map.
    let one = |seed| {
        let log = simulate(&Options { seed, ..options.clone() })?.log;
        let steps = contender.follow(&log, seed);
        let ends = || {
            let (first, last) = (steps.first()?, steps.last()?);
            let (start, end) = (log.grasps.first()?.truth?, log.grasps.last()?.truth?);
            let off = |frame: &Pose| normalised_error(log.dimension, last, &end, frame, truth);
            let map = gauge(&log, &steps, &truth.geometry)?;
            is_unimodal(last).then(|| [off(&(start.inverse() * first.pose)), off(&map)])
        };
        Ok(ends())
    };
    let runs: Vec<Option<[Option<f64>; 2]>> =
        with_room(|| selection.range().into_par_iter().map(one).collect::<Result<_, SimError>>())?;
    let sample = |i: usize| runs.iter().flatten().filter_map(move |pair| pair[i]);
    let dimension = spec.dimension();
    Ok(Row {
        object: spec.to_string(),
        noise,
        tracker: contender.name(),
        unimodal: Proportion::of(runs.iter().map(Option::is_some)),
        since_first: Consistency::of(dimension, sample(0)),
        on_map: Consistency::of(dimension, sample(1)),
    })
}

fn is_unimodal(step: &Step) -> bool {
    step.status == Status::Tracking && step.modes.get(1).is_none_or(|second| second.1 <= SECOND)
}

/// δᵀP⁻¹δ of an estimated pose, given its true one and the `frame`: the estimated object frame to the
/// true one. Infinite where the covariance has no inverse, for then there is a direction without any doubt; `None` where
/// it is zero, which says nothing.
fn normalised_error(
    dimension: usize,
    step: &Step,
    truly: &Pose,
    frame: &Pose,
    truth: &Truth,
) -> Option<f64> {
    // Of all poses at which the object looks the same, the nearest.
    let error = truly.inverse() * step.pose * frame.inverse();
    let turn = truth.symmetry.nearest(&error.rotation);
    let centre = truth.symmetry.centre();
    let turned = Translation3::from(centre) * turn * Translation3::from(-centre);
    let off = local(dimension, &step.pose, &(truly * turned * frame));
    let axes: &[usize] = if dimension == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let covariance =
        DMatrix::from_fn(axes.len(), axes.len(), |i, j| step.covariance[(axes[i], axes[j])]);
    if covariance.iter().all(|c| *c == 0.0) {
        return None;
    }
    let error = covariance.cholesky().map(|c| off.dot(&c.solve(&off)));
    Some(error.filter(|error| error.is_finite()).unwrap_or(f64::INFINITY))
}

impl Consistency {
    fn of(dimension: usize, sample: impl Iterator<Item = f64>) -> Consistency {
        let (low, high) = BANDS[usize::from(dimension == 3)];
        let freedom = if dimension == 2 { 3.0 } else { 6.0 };
        let sample: Vec<f64> = sample.collect();
        let finite: Vec<f64> = sample.iter().copied().filter(|e| e.is_finite()).collect();
        Consistency {
            within: Proportion::of(sample.iter().map(|e| (low..=high).contains(e))),
            singular: sample.len() - finite.len(),
            per_degree: Spread::of(sample.iter().map(|e| e / freedom)),
            mean: finite.iter().sum::<f64>() / (freedom * finite.len() as f64),
        }
    }
}

/// The line above the rows.
pub fn heading() -> String {
    format!(
        "  {:<34}{:>6}  {:<16}{:<19}  {:<58}{}\n  {:<76}  {:<19}{:<25}{:<14}{:<19}{:<25}mean",
        "object",
        "noise",
        "tracker",
        "unimodal",
        "since the first grasp",
        "on the map",
        "",
        "within 95 %",
        "error² per degree",
        "mean",
        "within 95 %",
        "error² per degree"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let object: String = self.object.chars().take(32).collect();
        let Row { noise, tracker, .. } = self;
        let unimodal = self.unimodal.to_string();
        write!(f, "  {object:<34}{noise:>4} %  {tracker:<16}{unimodal:<19}  ")?;
        for c in [&self.since_first, &self.on_map] {
            let spread = c.per_degree.map_or("–".to_owned(), |s| s.to_string());
            let mean = match (c.per_degree, c.singular) {
                (None, 0) => "–".to_owned(),
                (None, singular) => format!("{singular} × ∞"),
                (Some(_), 0) => format!("{:.2}", c.mean),
                (Some(_), singular) => format!("{:.2}, {singular} × ∞", c.mean),
            };
            write!(f, "{:<19}{spread:<25}{mean:<14}", c.within.to_string())?;
        }
        Ok(())
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Normalised estimation error squared of the last pose\n{}", heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        write!(
            f,
            "  of runs whose last belief has one answer; errors up to the object's symmetry, in the \
             tracker's own covariance;\n  an honest belief is within 95 % of the time, its median \
             per degree 0.79 (plane) or 0.89 (space), its mean 1"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::filter::retract;
    use crate::space::planar;

    #[test]
    fn an_error_of_one_deviation_counts_one_whatever_the_symmetry_and_frame() {
        let truth = Truth::new("hexagon:0.045".parse::<ObjectSpec>().unwrap().geometry().unwrap());
        let (truly, frame) = (planar(0.1, 0.2, 0.7), planar(0.01, 0.02, -0.4));
        for sixths in 0..6 {
            // A pose at which the hexagon looks as it does, in a frame of the tracker's own…
            let same = truly * planar(0.0, 0.0, f64::from(sixths) * std::f64::consts::TAU / 6.0);
            // …and an estimate one deviation off it in two directions.
            let mut step = Step::certain(Pose::identity());
            step.pose = retract(2, &(same * frame), &vec![-1e-3, 0.0, 0.02].into());
            step.covariance[(0, 0)] = 1e-6;
            step.covariance[(1, 1)] = 1e-6;
            step.covariance[(5, 5)] = 4e-4;
            let error = normalised_error(2, &step, &truly, &frame, &truth).unwrap();
            assert!((error - 2.0).abs() < 0.05, "{sixths}: {error}");
        }
        let certain = Step::certain(truly);
        assert_eq!(normalised_error(2, &certain, &truly, &frame, &truth), None);
        // Sure of all but one direction: as wrong as can be.
        let mut sure = certain;
        sure.covariance[(0, 0)] = 1e-6;
        assert_eq!(normalised_error(2, &sure, &truly, &frame, &truth), Some(f64::INFINITY));
        let some = Consistency::of(2, [f64::INFINITY, 3.0].into_iter());
        assert_eq!(some.within, Proportion::of([false, true]));
        assert_eq!((some.per_degree.unwrap().median, some.mean), (1.0, 1.0));
    }

    #[test]
    fn ambiguous_and_lost_beliefs_are_left_out() {
        let mut step = Step::certain(Pose::identity());
        step.modes = vec![(step.pose, 0.97), (step.pose, 0.03)];
        assert!(is_unimodal(&step));
        step.modes = vec![(step.pose, 0.8), (step.pose, 0.2)];
        assert!(!is_unimodal(&step));
        step.modes.truncate(1);
        step.status = Status::Lost;
        assert!(!is_unimodal(&step));
    }

    #[test]
    fn bands_hold_95_percent_of_their_distribution() {
        // χ² of 3 degrees as sums of squares of the normal distribution's deciles would be tedious:
        // the closed form of 2k degrees does for space, P(X > x) = e^(−x/2) Σ (x/2)^i / i!.
        let above = |x: f64| (-x / 2.0).exp() * (1.0 + x / 2.0 + (x / 2.0).powi(2) / 2.0);
        let (low, high) = BANDS[1];
        assert!((above(low) - 0.975).abs() < 1e-4 && (above(high) - 0.025).abs() < 1e-4);
        let c = Consistency::of(2, [1.0, 2.0, 30.0].into_iter());
        assert_eq!(c.within, Proportion { successes: 2, of: 3 });
        assert!((c.mean - 11.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn kalman_filters_are_examined() {
        let selection = Selection {
            graph: crate::graph::Kind::None,
            objects: vec!["rectangle:0.10".into(), "ellipse:0.06x0.06".into()],
            noise: vec![25.0],
            contenders: vec![Contender::Oracle, "ekf".parse().unwrap()],
            carried: None,
            outliers: 0.0,
            grasps: Some(5),
            seeds: 3,
            first_seed: 0,
        };
        let table = run(&selection, |_| ()).unwrap();
        let [row] = &table.rows[..] else { panic!("{table}") };
        assert_eq!((row.tracker, row.unimodal.of), ("ekf", 3));
        assert!(row.on_map.per_degree.unwrap().median.is_finite());
    }
}
