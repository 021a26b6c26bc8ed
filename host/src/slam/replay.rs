//! Runs, recordings and logs as scenes that play.

use std::io;
use std::path::Path;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::log::recording::{Pieces, RecordingError};
use crate::log::replayed::{Heard, listen};
use crate::log::{GraspLog, Noise};
use crate::reference::Contact;
use crate::shape::{Geometry, metrics};
use crate::slam::choose::Choice;
use crate::slam::free::Free;
use crate::slam::output::Outcome;
use crate::slam::reconstruct::{Placed, Reconstruction, doubt, free, shape};
use crate::slam::track::Step;
use crate::slam::usual_deviations;
use crate::space::{Point, Pose};
use crate::view::growth::{Grown, grow, shown};
use crate::view::scene::{Grasp, Meta, Scene, Shape, Surface};
use crate::view::timeline::Timeline;

/// Contacts that the surface of a recording is fitted to at most, in the plane and in space.
const CONTACTS: [usize; 2] = [300, 200];

/// Grasps with contacts from which a recording shows a surface.
const LEAST_GRASPS: usize = 2;

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
    let gauge = log
        .grasps
        .iter()
        .zip(&outcome.steps)
        .find_map(|(g, step)| g.truth.map(|truth| step.pose.inverse() * truth));
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

/// A recording: what was sent, what the board made of it, and the surface that its poses make of the
/// contacts. Read as it goes, in bounded memory: of a long recording, grasps that follow one another
/// closely become one. What is torn, damaged or missing is said in the scene.
///
/// # Errors
/// When the file cannot be read or does not start with a whole header.
pub fn of_recording(path: &Path) -> Result<Scene, RecordingError> {
    let mut pieces = Pieces::open(path)?;
    let header = pieces.header.clone();
    let dimension = header.dimension;
    let mut timeline = Timeline::default();
    let mut count = 0;
    let mut failed: Option<io::Error> = None;
    let mut sound = pieces.by_ref().map_while(|piece| piece.map_err(|e| failed = Some(e)).ok());
    let rest = listen(&header, &mut sound, &mut |heard| match heard {
        Heard::Forgotten => {
            timeline = Timeline::default();
            count = 0;
        }
        Heard::Grasp(grasp, estimate) => {
            count += 1;
            timeline.push(match estimate {
                // Of the covariance only the diagonal is recorded: the entropy is not known.
                Some(estimate) => Grasp {
                    entropy: None,
                    ..Grasp::estimated(&grasp, &Step::from(&estimate), dimension)
                },
                None => Grasp::felt(&grasp),
            });
        }
    });
    let mut missing = Vec::new();
    if let Some(error) = failed {
        missing.push(format!("The recording could not be read to its end: {error}."));
    }
    if pieces.torn > 0 {
        missing.push(format!(
            "The recording ends within a piece: its last {} bytes are left out.",
            pieces.torn
        ));
    }
    if pieces.damaged > 0 {
        missing.push(format!("{} damaged pieces are left out.", pieces.damaged));
    }
    let bad = rest.from_board.damaged() + rest.to_board.damaged();
    if bad > 0 {
        missing.push(format!("{bad} frames of the link were damaged and are left out."));
    }
    if count == 0 {
        missing.push("There is no whole grasp in the recording.".into());
    }
    if timeline.stride() > 1 {
        missing.push(format!(
            "{count} grasps are shown {} at a time, with a part of their contacts.",
            timeline.stride()
        ));
    }
    let grasps = timeline.into_grasps();
    if count > 0 && grasps.iter().all(|g| g.pose.is_none()) {
        missing.push("The board answered no grasp: there are no poses.".into());
    }
    let (model, surfaces) = recorded_surfaces(dimension, &grasps, &rest.noise);
    let title = if header.description.is_empty() {
        path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    } else {
        header.description
    };
    let meta = Meta {
        tracker: rest.hello.map(|h| format!("{:?} on the board", h.tracker).to_lowercase()),
        model,
        fingers: header.fingers,
        grasps: Some(count),
        figures: vec![
            ("grasps".into(), count.to_string()),
            ("contacts".into(), grasps.iter().map(|g| g.touched).sum::<u64>().to_string()),
        ],
        missing,
        ..Meta::new(dimension, title)
    };
    Ok(Scene { meta, grasps, surfaces, choices: Vec::new() })
}

/// Surfaces of the contacts that the timeline holds, at its poses, and the name of their model; none
/// where nothing fits them.
fn recorded_surfaces(
    dimension: usize,
    grasps: &[Grasp],
    noise: &Noise,
) -> (Option<String>, Vec<Surface>) {
    let mut placed: Vec<Placed> = Vec::new();
    for (at, grasp) in grasps.iter().enumerate() {
        placed_contacts(&mut placed, at, grasp, noise);
    }
    let most = CONTACTS[usize::from(dimension == 3)];
    let stride = placed.len().div_ceil(most).max(1);
    let contacts: Vec<Placed> = placed.into_iter().step_by(stride).collect();
    let touching = contacts.iter().map(|p| p.grasp).collect::<std::collections::BTreeSet<_>>();
    if touching.len() < LEAST_GRASPS {
        return (None, Vec::new());
    }
    let all: Vec<Contact> = contacts.iter().map(|p| p.contact).collect();
    let none: Vec<Free> = Vec::new();
    let Ok((model, geometry, deviations)) = shape(dimension, &all, &none, Choice::Auto, &|_, _| ())
    else {
        return (None, Vec::new());
    };
    let name = model.name().to_owned();
    let reconstruction = Reconstruction { geometry, deviations, contacts, model };
    let grown = grow(dimension, &reconstruction, &|_| Vec::new());
    let surfaces = grown
        .iter()
        .map(|grown| {
            let after = grasps.get(grown.grasp).map_or(0, |g| g.grasp);
            Surface::new(&grown.geometry, &grown.deviations, after)
        })
        .collect();
    (Some(name), surfaces)
}

/// Appends the grasp's contacts in the object frame, the doubt about the pose in their deviations.
fn placed_contacts(placed: &mut Vec<Placed>, at: usize, grasp: &Grasp, noise: &Noise) {
    let (point_deviation, normal_deviation) = usual_deviations(noise);
    let Some([x, y, z, qx, qy, qz, qw]) = grasp.pose else { return };
    // A lost grasp says nothing about the shape.
    if grasp.status == Some("lost") {
        return;
    }
    let turn = UnitQuaternion::new_normalize(Quaternion::new(qw, qx, qy, qz));
    let to_object = Pose::from_parts(Translation3::new(x, y, z), turn).inverse();
    let deviations = grasp.deviations.unwrap_or_default();
    let covariance =
        nalgebra::Matrix6::from_fn(|i, j| if i == j { deviations[i].powi(2) } else { 0.0 });
    for numbers in grasp.contacts.0.chunks_exact(6) {
        let [x, y, z, nx, ny, nz] = [0, 1, 2, 3, 4, 5].map(|i| f64::from(numbers[i]));
        let point: Point = (to_object * Point3::new(x, y, z)).coords;
        let normal = (to_object.rotation * Vector3::new(nx, ny, nz)).try_normalize(0.5);
        let contact = Contact { point, normal, point_deviation, normal_deviation };
        placed.push(Placed { contact: doubt(contact, &covariance), grasp: at });
    }
}

#[cfg(test)]
#[path = "replay_tests.rs"]
mod tests;
