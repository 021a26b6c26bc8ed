//! Runs and logs as scenes that play. Recordings are in [`recorded`](super::recorded).

use crate::log::GraspLog;
use crate::shape::{Geometry, metrics};
use crate::slam::gauge::at_start;
use crate::slam::output::Outcome;
use crate::slam::place::free;
use crate::view::growth::{Grown, grow, shown};
use crate::view::scene::{Grasp, Meta, Scene, Shape, Surface};
use crate::view::timeline::Timeline;

/// The surface of a finished run as it grew. `log` is that which the run was concluded from.
pub fn growth(log: &GraspLog, outcome: &Outcome) -> Vec<Grown> {
    let until = |count: usize| free(log, &outcome.steps[..count.min(outcome.steps.len())]);
    grow(log.dimension, &outcome.reconstruction, &until)
}

/// A finished run. `log` and `truth` are those it was concluded from, `grown` is its [`growth`].
pub fn of_run(
    log: &GraspLog,
    outcome: &Outcome,
    truth: Option<&Geometry>,
    grown: &[Grown],
) -> Scene {
    let mut timeline = Timeline::default();
    for (grasp, step) in log.grasps.iter().zip(&outcome.steps) {
        timeline.push(Grasp::estimated(grasp, step, log.dimension));
    }
    let grasps = timeline.into_grasps();
    let gauge = at_start(log, &outcome.steps);
    let judge = |geometry: &Geometry| {
        let (gauge, truth) = gauge.zip(truth)?;
        metrics::compare(&geometry.transformed(&gauge.inverse()), truth)
    };
    let final_grasp = grown.len().saturating_sub(1);
    let surfaces = grown
        .iter()
        .enumerate()
        .map(|(i, grown)| {
            let after = log.grasps.get(grown.grasp).map_or(0, |g| g.index);
            let mut surface = Surface::new(&grown.geometry, &grown.deviations, after);
            if i == final_grasp {
                // As the report has it.
                let judged = &outcome.report.surface;
                (surface.hausdorff_mm, surface.mean_mm) = (judged.hausdorff_mm, judged.mean_mm);
            } else if let Some(found) = judge(&grown.geometry) {
                surface.hausdorff_mm = Some(1e3 * found.hausdorff);
                surface.mean_mm = Some(1e3 * found.mean);
            }
            surface
        })
        .collect();
    let meta = Meta {
        tracker: Some(outcome.report.tracker.clone()),
        model: Some(outcome.reconstruction.model.name().to_owned()),
        fingers: log.fingers.clone(),
        grasps: Some(log.grasps.len() as u64),
        truth: truth.map(|t| Shape::new(&shown(t))),
        figures: outcome.figures(),
        ..Meta::new(log.dimension, outcome.title())
    };
    Scene { meta, grasps, surfaces, choices: outcome.choices.clone() }
}

/// A grasp log as it is: what was felt where, and what is known of the truth. `missing` says what of
/// it could not be read.
pub fn of_log(
    log: &GraspLog,
    title: &str,
    truth: Option<&Geometry>,
    missing: Vec<String>,
) -> Scene {
    let mut timeline = Timeline::default();
    log.grasps.iter().for_each(|grasp| timeline.push(Grasp::felt(grasp)));
    let meta = Meta {
        fingers: log.fingers.clone(),
        grasps: Some(log.grasps.len() as u64),
        truth: truth.map(|t| Shape::new(&shown(t))),
        missing,
        ..Meta::new(log.dimension, title)
    };
    Scene { meta, grasps: timeline.into_grasps(), surfaces: Vec::new(), choices: Vec::new() }
}

#[cfg(test)]
#[path = "replay_tests.rs"]
mod tests;
