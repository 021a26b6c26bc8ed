//! How well a track is, whatever frame the tracker chose and whatever the object's symmetry.

use nalgebra::{Matrix6, Point3, Translation3, UnitQuaternion, Vector6};
use tactile_core::track::Status;

use crate::log::GraspLog;
use crate::shape::symmetry::Symmetry;
use crate::shape::{Geometry, align, metrics};
use crate::slam::choose::Choice;
use crate::slam::reconstruct::reconstruct;
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
    let gauge = gauge(log, steps, &truth.geometry)?;
    let offsets = offsets(log, steps, truth, &gauge);
    let last = *offsets.last()?;
    let square = |f: fn(&Offset) -> f64| {
        (offsets.iter().map(|o| f(o).powi(2)).sum::<f64>() / offsets.len() as f64).sqrt()
    };
    let rms = Offset { translation: square(|o| o.translation), rotation: square(|o| o.rotation) };
    let shape = reconstruct(log, steps, Choice::Auto, &|_, _| {}).ok();
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

/// Grasps whose true poses the search for the gauge starts from.
const STARTS: usize = 6;

/// Iterations from each start.
const ITERATIONS: usize = 30;

/// Scale of the robust cost, metres: contacts farther off than this count less and less.
const SCALE: f64 = 3e-3;

/// Takes the estimated object frame to the true one: the tracker fixed its frame at the first grasp,
/// and what it has learnt since may lie a little off in it. The contacts at the estimated poses are
/// fitted to the true surface (robust, so that a few misplaced grasps do not bend it), from where
/// each of several grasps alone would put the frame. `None` without a true pose or a contact.
pub fn gauge(log: &GraspLog, steps: &[Step], surface: &Geometry) -> Option<Pose> {
    let known: Vec<Pose> = log
        .grasps
        .iter()
        .zip(steps)
        .filter_map(|(grasp, step)| Some(grasp.truth?.inverse() * step.pose))
        .collect();
    let points: Vec<Point> = log
        .grasps
        .iter()
        .zip(steps)
        .flat_map(|(grasp, step)| {
            let to_object = step.pose.inverse();
            grasp.contacts.iter().map(move |c| (to_object * Point3::from(c.point)).coords)
        })
        .collect();
    if points.is_empty() || known.is_empty() {
        return None;
    }
    let count = STARTS.min(known.len());
    let starts = (0..count).map(|i| known[i * (known.len() - 1) / (count - 1).max(1)]);
    starts
        .map(|start| fitted(&points, surface, start))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, pose)| pose)
}

/// One contact's distance to the surface, where it lies and which way it is off.
struct Gap {
    distance: f64,
    point: Point,
    away: Point,
}

/// Levenberg–Marquardt from one start: least cost and where.
fn fitted(points: &[Point], surface: &Geometry, start: Pose) -> (f64, Pose) {
    let gaps = |pose: &Pose| -> Vec<Gap> {
        let one = |p: &Point| {
            let point = (pose * Point3::from(*p)).coords;
            let gap = point - surface.closest(&point);
            let distance = gap.norm();
            Gap { distance, point, away: gap / distance.max(1e-12) }
        };
        points.iter().map(one).collect()
    };
    let cost =
        |gaps: &[Gap]| -> f64 { gaps.iter().map(|g| (g.distance / SCALE).powi(2).ln_1p()).sum() };
    let centre = points.iter().sum::<Point>() / points.len() as f64;
    let rim = points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max).max(1e-3);
    let mut pose = start;
    let mut now = gaps(&pose);
    let mut least = cost(&now);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let middle = (pose * Point3::from(centre)).coords;
        let (mut square, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for g in &now {
            let lever = (g.point - middle).cross(&g.away) / rim;
            let row = Vector6::new(g.away.x, g.away.y, g.away.z, lever.x, lever.y, lever.z);
            let weight = 1.0 / (1.0 + (g.distance / SCALE).powi(2));
            square.syger(weight, &row, &row, 1.0);
            right.axpy(-weight * g.distance, &row, 1.0);
        }
        square.fill_upper_triangle_with_lower_triangle();
        let mean = (square.trace() / 6.0).max(1e-12);
        let damped = square + Matrix6::identity() * (damping * mean);
        let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else { break };
        let turn = Point::new(step[3], step[4], step[5]) / rim;
        let motion: Pose = Translation3::from(middle + step.fixed_rows::<3>(0))
            * UnitQuaternion::from_scaled_axis(turn)
            * Translation3::from(-middle);
        let tried = motion * pose;
        let then = gaps(&tried);
        let tried_cost = cost(&then);
        if tried_cost < least {
            let settled = least - tried_cost < 1e-6 * least;
            (pose, now, least) = (tried, then, tried_cost);
            damping = (damping * 0.2).max(1e-9);
            if settled {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    pose.rotation.renormalize();
    (least, pose)
}
