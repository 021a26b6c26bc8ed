//! What is known of the object: a surface with uncertainty, and where it is.

use nalgebra::{Matrix6, Point3, Vector6};

use crate::log::{GraspLog, LoggedGrasp};
use crate::reference::{Contact, Gpis};
use crate::shape::Geometry;
use crate::slam::fit::fit;
use crate::slam::reconstruct::{self, extract, free, place};
use crate::slam::track::Step;
use crate::slam::{deviations, usual_deviations};
use crate::space::{Point, Pose};

/// Shape and pose as they are believed to be after some grasps.
#[derive(Clone, Debug)]
pub struct Belief {
    /// 2 or 3.
    pub dimension: usize,
    /// The Gaussian process through all contacts, object frame.
    pub surface: Gpis,
    /// Its zero set.
    pub geometry: Geometry,
    /// Middle of the contacts' bounding box, object frame, and how far its corners are, metres.
    pub centre: Point,
    /// See `centre`.
    pub radius: f64,
    /// Where each contact was felt last to first, object frame.
    pub contacts: Vec<Contact>,
    /// Object to world, as known after the last grasp.
    pub pose: Pose,
    /// The poses held possible and their weights: one, or as many as the tracker names.
    pub modes: Vec<(Pose, f64)>,
    /// Covariance of the pose *at the next grasp*: the last one's and the motion noise; object axes,
    /// translation then rotation.
    pub covariance: Matrix6<f64>,
    /// Standard deviations of a contact: metres and radians.
    pub noise: (f64, f64),
}

impl Belief {
    /// From everything felt so far and the poses found for it, with the covariances that say how
    /// contacts lie beside each other ([`beside_each_other`]).
    ///
    /// # Errors
    /// Without contacts, or when they make no surface.
    pub fn new(log: &GraspLog, steps: &[Step]) -> Result<Belief, reconstruct::Error> {
        let dimension = log.dimension;
        let Some(last) = steps.last() else { return Err(reconstruct::Error::NoContacts) };
        let mut contacts: Vec<Contact> = place(log, steps).iter().map(|p| p.contact).collect();
        let (_, surface) = fit(dimension, &contacts, &free(log, steps))?;
        let (geometry, _) = extract(dimension, &surface, &contacts)?;
        let points = contacts.iter().map(|c| (c.point, c.point));
        let (low, high) = points
            .reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)))
            .ok_or(reconstruct::Error::NoContacts)?;
        contacts.reverse();
        let modes = if last.modes.is_empty() { vec![(last.pose, 1.0)] } else { last.modes.clone() };
        Ok(Belief {
            dimension,
            surface,
            geometry,
            centre: (low + high) / 2.0,
            radius: ((high - low) / 2.0).norm().max(0.02),
            contacts,
            pose: last.pose,
            modes,
            covariance: last.covariance + motion(log),
            noise: usual_deviations(&log.noise),
        })
    }
}

/// The steps with the covariance of each pose if the shape were known: what a contact's place beside
/// the other contacts hangs on. The tracker's own covariances also hold how uncertain all of them
/// together are with respect to the first grasp, which no touch changes and which does not matter for
/// the shape. A Kalman filter over the poses whose measurements are the contacts' distances and
/// normals.
pub fn beside_each_other(log: &GraspLog, steps: &[Step]) -> Vec<Step> {
    let moved = motion(log);
    let mut covariance = Matrix6::identity();
    let one = |(index, (grasp, step)): (usize, (&LoggedGrasp, &Step))| {
        if index > 0 {
            covariance += moved;
        }
        for contact in &grasp.contacts {
            let (point, turn) = deviations(contact, &log.noise);
            let Some(normal) = contact.normal else { continue };
            let at = step.pose.inverse();
            let n = at.rotation * normal;
            let p = (at * Point3::from(contact.point)).coords;
            let m = p.cross(&n);
            seen(&mut covariance, Vector6::new(n.x, n.y, n.z, m.x, m.y, m.z), point * point);
            for axis in across(&n, log.dimension) {
                seen(
                    &mut covariance,
                    Vector6::new(0.0, 0.0, 0.0, axis.x, axis.y, axis.z),
                    turn * turn,
                );
            }
        }
        Step { covariance: only(log.dimension, covariance), ..step.clone() }
    };
    log.grasps.iter().zip(steps).enumerate().map(one).collect()
}

/// The covariance after one measurement hᵀδ with this variance.
fn seen(covariance: &mut Matrix6<f64>, h: Vector6<f64>, variance: f64) {
    let column = *covariance * h;
    *covariance -= column * column.transpose() / (h.dot(&column) + variance);
}

/// The axes about which a turn moves the normal.
pub(super) fn across(normal: &Point, dimension: usize) -> Vec<Point> {
    if dimension == 2 {
        return vec![Point::z()];
    }
    let first = normal.cross(&Point::ith(normal.iamin(), 1.0));
    match first.try_normalize(1e-9) {
        Some(first) => vec![first, normal.cross(&first)],
        None => Vec::new(),
    }
}

/// A planar pose has no other covariance than that of x, y and the turn about z.
fn only(dimension: usize, covariance: Matrix6<f64>) -> Matrix6<f64> {
    let has = |axis: usize| dimension == 3 || matches!(axis, 0 | 1 | 5);
    covariance.map_with_location(|i, j, v| if has(i) && has(j) { v } else { 0.0 })
}

/// What the motion before the next grasp adds to the pose's covariance.
pub(super) fn motion(log: &GraspLog) -> Matrix6<f64> {
    let shift = log.noise.translation.unwrap_or(0.0).powi(2);
    let turn = log.noise.rotation.unwrap_or(0.0).powi(2);
    let moves = |axis: usize| log.dimension == 3 || matches!(axis, 0 | 1 | 5);
    Matrix6::from_fn(|i, j| match i {
        _ if i != j || !moves(i) => 0.0,
        0..3 => shift,
        _ => turn,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    #[test]
    fn poses_on_a_known_shape_are_as_certain_as_what_they_feel() {
        for (object, planar) in [("rectangle:0.1x0.06", true), ("box:0.1x0.06x0.08", false)] {
            let log = simulate(&Options::new(object.parse().unwrap())).unwrap().log;
            let steps = beside_each_other(&log, &track::truth(&log).unwrap());
            for (k, step) in steps.iter().enumerate() {
                let turn = step.covariance[(5, 5)].sqrt();
                // A grasp that feels top and bottom leaves the turn about z to the motion noise.
                assert!(turn > 1e-3 && turn < 0.4, "{object} {k}: {turn}");
                assert_eq!(step.covariance[(2, 2)] == 0.0, planar);
                // Never more than one motion's noise on top of the grasp before.
                if k > 0 {
                    let more = step.covariance - steps[k - 1].covariance - motion(&log);
                    assert!(more.trace() <= 1e-9, "{object} {k}");
                }
            }
        }
    }
}
