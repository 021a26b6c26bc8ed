//! Where the object frame of an estimate lies in the true one.

use nalgebra::{Matrix6, Point3, Translation3, UnitQuaternion, Vector6};

use crate::log::GraspLog;
use crate::shape::Geometry;
use crate::slam::track::Step;
use crate::space::{Point, Pose, centroid};
use crate::view::report;

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

/// Takes the true object frame to the estimated one as reports have it ([`report::gauge`]): by the first grasp that
/// felt something.
pub fn at_start(log: &GraspLog, steps: &[Step]) -> Option<Pose> {
    let grasps = log.grasps.iter().zip(steps);
    report::agreed(grasps.map(|(g, step)| (step.pose, g.truth, !g.contacts.is_empty())))
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
    let centre = centroid(points.iter().copied());
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
