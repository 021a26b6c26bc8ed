//! How well a track is, whatever frame the tracker chose and whatever the object's symmetry.

use nalgebra::Point3;
use tactile_core::track::Status;

use crate::log::GraspLog;
use crate::model::Faces;
use crate::shape::symmetry::Symmetry;
use crate::shape::{Geometry, align, metrics};
use crate::slam::choose::Choice;
pub use crate::slam::gauge::gauge;
use crate::slam::reconstruct::reconstruct_known;
use crate::slam::track::Step;
use crate::space::{Point, Pose};

/// The object as it is.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Object frame.
    pub geometry: Geometry,
    /// Its own.
    pub symmetry: Symmetry,
}

impl Truth {
    /// With the symmetry that the shape has.
    pub fn new(geometry: Geometry) -> Truth {
        let symmetry = Symmetry::of(&geometry);
        Truth { geometry, symmetry }
    }
}

/// Translation at the object's centroid (metres) and rotation (radians).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offset {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// Distances to the estimate from the true surface within 10 mm of a contact, metres; the rest of the
/// object is a guess. The shapes lie as the contacts have it: no alignment but the frame's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touched {
    /// On average.
    pub mean: f64,
    /// At most.
    pub greatest: f64,
}

/// What one run is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Hausdorff distance after the best rigid alignment, metres; `None` where there is no shape.
    pub hausdorff: Option<f64>,
    /// Of the touched part of the true surface to the estimate; `None` where there is no shape.
    pub touched: Option<Touched>,
    /// Of the last pose.
    pub last: Offset,
    /// Root mean square over all poses.
    pub rms: Offset,
    /// Root mean square distance from the contacts at the estimated poses to the true surface, wild
    /// ones left out, metres.
    pub contacts: f64,
    /// Grasps the tracker could not explain.
    pub lost: usize,
}

/// A run succeeds with an aligned Hausdorff distance below the thesis' 9 mm (3.5.1)…
const SHAPE: f64 = 9e-3;

/// …and a last pose within 5 mm and 5°.
const POSE: Offset = Offset { translation: 5e-3, rotation: 0.087_266_462_6 };

impl Judgement {
    /// Whether shape and last pose are right.
    pub fn is_success(&self) -> bool {
        self.hausdorff.is_some_and(|h| h < SHAPE)
            && self.last.translation < POSE.translation
            && self.last.rotation < POSE.rotation
    }
}

/// Judges the poses of `steps`; `None` where the log has no true pose to judge by, or no contact.
pub fn judge(log: &GraspLog, steps: &[Step], truth: &Truth) -> Option<Judgement> {
    judge_known(log, steps, None, truth)
}

/// The same where faces were estimated together with the poses: the shape is made of them.
pub fn judge_known(
    log: &GraspLog,
    steps: &[Step],
    faces: Option<&Faces>,
    truth: &Truth,
) -> Option<Judgement> {
    let gauge = gauge(log, steps, &truth.geometry)?;
    let offsets = offsets(log, steps, truth, &gauge);
    let last = *offsets.last()?;
    let square = |f: fn(&Offset) -> f64| {
        (offsets.iter().map(|o| f(o).powi(2)).sum::<f64>() / offsets.len() as f64).sqrt()
    };
    let rms = Offset { translation: square(|o| o.translation), rotation: square(|o| o.rotation) };
    let shape = reconstruct_known(log, steps, faces, Choice::Auto, &|_, _| {}).ok();
    let shape = shape.map(|s| s.geometry.transformed(&gauge)).filter(|s| !metrics::is_empty(s));
    let aligned = shape.as_ref().and_then(|estimate| {
        let pose = align::align(estimate, &truth.geometry);
        metrics::compare_at(estimate, &pose, &truth.geometry)
    });
    Some(Judgement {
        hausdorff: aligned.map(|d| d.hausdorff),
        touched: shape.and_then(|estimate| touched(log, truth, &estimate)),
        last,
        rms,
        contacts: contact_rms(log, steps, truth, &gauge),
        lost: steps.iter().filter(|s| s.status == Status::Lost).count(),
    })
}

/// The error of every estimated pose whose true one is known, in time order: the motion from the
/// true pose to the estimated one in the true object frame, and how far it is from being a symmetry.
pub fn offsets(log: &GraspLog, steps: &[Step], truth: &Truth, gauge: &Pose) -> Vec<Offset> {
    let centre = Point3::from(truth.symmetry.centre());
    let pairs = log.grasps.iter().zip(steps).filter_map(|(g, s)| Some((g.truth?, s.pose)));
    pairs
        .map(|(truly, estimate)| {
            let error = truly.inverse() * estimate * gauge.inverse();
            Offset {
                translation: (error * centre - centre).norm(),
                rotation: truth.symmetry.angle(&error.rotation),
            }
        })
        .collect()
}

/// Wild contacts are left out of the root mean square: those that even at the true pose lie this far
/// from the surface, metres.
const WILD: f64 = 5e-3;

fn contact_rms(log: &GraspLog, steps: &[Step], truth: &Truth, gauge: &Pose) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (grasp, step) in log.grasps.iter().zip(steps) {
        let to_object = gauge * step.pose.inverse();
        for contact in &grasp.contacts {
            let distance =
                |pose: &Pose| truth.geometry.distance(&(pose * Point3::from(contact.point)).coords);
            if grasp.truth.is_none_or(|t| distance(&t.inverse()) < WILD) {
                sum += distance(&to_object).powi(2);
                count += 1;
            }
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// A point of the true surface no farther than this from where it was touched is touched, metres.
const NEAR: f64 = 0.01;

/// Points drawn from the true surface to find its touched part.
const SAMPLES: usize = 3000;

fn touched(log: &GraspLog, truth: &Truth, estimate: &Geometry) -> Option<Touched> {
    let felt: Vec<Point> = log
        .grasps
        .iter()
        .filter_map(|g| Some((g, g.truth?.inverse())))
        .flat_map(|(g, to_object)| {
            g.contacts.iter().map(move |c| (to_object * Point3::from(c.point)).coords)
        })
        .collect();
    let distances: Vec<f64> = truth
        .geometry
        .samples(SAMPLES)
        .into_iter()
        .filter(|(p, _)| felt.iter().any(|c| (c - p).norm() < NEAR))
        .map(|(p, _)| estimate.distance(&p))
        .collect();
    (!distances.is_empty()).then(|| Touched {
        mean: distances.iter().sum::<f64>() / distances.len() as f64,
        greatest: distances.iter().copied().fold(0.0, f64::max),
    })
}
