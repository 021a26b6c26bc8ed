//! What was felt, and where nothing was, in the object frame: world to object by the poses, with the
//! doubt about these.

use nalgebra::{Matrix6, Vector6};
use tactile_core::track::Status;

use crate::log::{GraspLog, LoggedGrasp};
use crate::reference::Contact;
use crate::slam::free::Free;
use crate::slam::track::Step;
use crate::slam::{deviations, usual_deviations};
use crate::space::Point;

/// A contact in the object frame, as the surface was fitted to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Position, normal and deviations, the doubt about the pose included.
    pub contact: Contact,
    /// Position in the log of the grasp that felt it.
    pub grasp: usize,
}

/// The log's contacts in the object frame, but for those of grasps that were lost: where they are, nobody
/// knows. The doubt about a pose along a contact's normal, and about its rotation, goes into the contact's
/// deviations, as the core's tracker has it.
pub fn place(log: &GraspLog, steps: &[Step]) -> Vec<Placed> {
    let mut placed = Vec::new();
    for (grasp, logged, step) in found(log, steps) {
        for c in &logged.contacts {
            let (point_deviation, normal_deviation) = deviations(c, &log.noise);
            let world =
                Contact { point: c.point, normal: c.normal, point_deviation, normal_deviation };
            let contact = doubt(world.transformed(&step.pose.inverse()), &step.covariance);
            placed.push(Placed { contact, grasp });
        }
    }
    placed
}

/// The grasps that were not lost, with their positions in the log.
fn found<'a>(
    log: &'a GraspLog,
    steps: &'a [Step],
) -> impl Iterator<Item = (usize, &'a LoggedGrasp, &'a Step)> {
    let all = log.grasps.iter().zip(steps).enumerate();
    all.map(|(k, (logged, step))| (k, logged, step)).filter(|(.., s)| s.status != Status::Lost)
}

/// The contact with the uncertainty of its pose added: along the normal, in all directions alike without
/// one.
pub(crate) fn doubt(contact: Contact, covariance: &Matrix6<f64>) -> Contact {
    let variance = |n: &Point| {
        let m = contact.point.cross(n);
        let h = Vector6::new(n.x, n.y, n.z, m.x, m.y, m.z);
        (h.transpose() * covariance * h)[0].max(0.0)
    };
    let along = match &contact.normal {
        Some(normal) => variance(normal),
        // A planar pose has no variance along z.
        None => {
            let axes = [Point::x(), Point::y(), Point::z()].map(|axis| variance(&axis));
            let count = if covariance[(2, 2)] > 0.0 { 3.0 } else { 2.0 };
            axes.iter().sum::<f64>() / count
        }
    };
    // A planar pose turns about one axis only.
    let turns: Vec<f64> = (3..6).map(|i| covariance[(i, i)]).filter(|v| *v > 0.0).collect();
    let turn = turns.iter().sum::<f64>() / turns.len().max(1) as f64;
    Contact {
        point_deviation: (contact.point_deviation.powi(2) + along).sqrt(),
        normal_deviation: (contact.normal_deviation.powi(2) + turn).sqrt(),
        ..contact
    }
}

/// Where fingertips of the log touched nothing in grasps that were not lost, in the object frame, with the
/// doubt about the poses as a [placed](place) contact without a normal has it.
pub fn free(log: &GraspLog, steps: &[Step]) -> Vec<Free> {
    let own = usual_deviations(&log.noise).0;
    let mut free = Vec::new();
    for (_, logged, step) in found(log, steps) {
        for f in &logged.free {
            let world = Contact {
                point: f.point,
                normal: None,
                point_deviation: own,
                normal_deviation: 0.0,
            };
            let here = doubt(world.transformed(&step.pose.inverse()), &step.covariance);
            free.push(Free { point: here.point, deviation: here.point_deviation });
        }
    }
    free
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};
    use crate::slam::track::truth;

    #[test]
    fn what_a_lost_grasp_felt_is_nowhere_until_a_graph_finds_it() {
        let log = simulate(&Options::new("triangle:0.06".parse().unwrap())).unwrap().log;
        let known = truth(&log).unwrap();
        let all = place(&log, &known);
        let mut steps = known.clone();
        steps[2].status = Status::Lost;
        let left = place(&log, &steps);
        assert!(all.iter().filter(|p| p.grasp != 2).eq(&left) && left.len() < all.len());
        let (pose, covariance) = (known[2].pose, known[2].covariance);
        assert_eq!(steps[2].at(pose, covariance, false).status, Status::Lost);
        steps[2] = steps[2].at(pose, covariance, true);
        assert_eq!(place(&log, &steps), all);
    }
}
