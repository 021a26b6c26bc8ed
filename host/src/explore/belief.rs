//! What is known of the object: a surface with uncertainty, and where it is.

use nalgebra::{Matrix3, Matrix6, Point3, Vector6};

use super::turning::Turning;
use crate::log::{GraspLog, LoggedGrasp};
use crate::reference::{Contact, Gpis};
use crate::shape::{Field, Geometry};
use crate::sim::Hand;
use crate::slam::fit::{self, Model};
use crate::slam::place::{free, place};
use crate::slam::reconstruct::{self, extract, extract_at};
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
    /// What touches: the idealised hand until told otherwise.
    pub hand: Hand,
    /// Height of the table that the object stands on, world frame, metres: none until told otherwise.
    pub table: Option<f64>,
    /// What the surface is about, with its hyper-parameters, and how many contacts chose it.
    model: Model,
    chosen_by: usize,
}

/// Contacts of a spatial object that choose what its surface is about, and its hyper-parameters, at
/// most: those that come after say where the surface is, and little more about its kind.
const DECIDING: [usize; 2] = [40, 40];

/// A model is kept until there are so many times as many contacts as chose it.
const KEPT: f64 = 1.3;

/// Lattice cells across the contacts' bounding box in space: rays need no finer surface.
const CELLS: f64 = 24.0;

impl Belief {
    /// From everything felt so far and the poses found for it, with the covariances that say how
    /// contacts lie beside each other ([`beside_each_other`]).
    ///
    /// # Errors
    /// Without contacts, or when they make no surface.
    pub fn new(log: &GraspLog, steps: &[Step]) -> Result<Belief, reconstruct::Error> {
        Self::build(log, steps, None)
    }

    /// The same after one more grasp of the object at poses that stay as they were. In space, what the
    /// surface is about, and its hyper-parameters, are only sought again when there are a third more
    /// contacts than at the last time.
    ///
    /// # Errors
    /// As [`Belief::new`].
    pub fn after(&self, log: &GraspLog, steps: &[Step]) -> Result<Belief, reconstruct::Error> {
        Self::build(log, steps, Some(self))
    }

    fn build(
        log: &GraspLog,
        steps: &[Step],
        before: Option<&Belief>,
    ) -> Result<Belief, reconstruct::Error> {
        let dimension = log.dimension;
        let Some(last) = steps.last() else { return Err(reconstruct::Error::NoContacts) };
        let mut contacts: Vec<Contact> = place(log, steps).iter().map(|p| p.contact).collect();
        let still =
            |b: &&Belief| dimension == 3 && (contacts.len() as f64) < KEPT * b.chosen_by as f64;
        let (model, chosen_by) = match before.filter(still) {
            Some(before) => (before.model.clone(), before.chosen_by),
            None if dimension == 2 => (fit::model(dimension, &contacts)?, contacts.len()),
            None => (fit::model_of(dimension, &contacts, DECIDING)?, contacts.len()),
        };
        let surface = model.opened(dimension, &contacts, &free(log, steps))?;
        let certain = Certain(&surface);
        let (geometry, _) = match dimension {
            2 => extract(dimension, &certain, &contacts)?,
            _ => extract_at(dimension, &certain, &contacts, CELLS)?,
        };
        // Makes the tree that rays are cast into, so that no choice waits for it.
        let _ = geometry.distance(&Point::zeros());
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
            hand: Hand::Idealised,
            table: None,
            model,
            chosen_by,
        })
    }
}

/// A surface whose deviations nobody asks for: at every vertex of a mesh they would take longer than
/// the mesh.
struct Certain<'a>(&'a Gpis);

impl Field for Certain<'_> {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.0.values(points)
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        vec![0.0; points.len()]
    }

    fn first_order(&self, points: &[Point], step: f64) -> Vec<(f64, Point)> {
        self.0.first_order(points, step)
    }
}

/// The steps with the covariance of each pose if the shape were known: what a contact's place beside
/// the other contacts hangs on. The tracker's own covariances also hold how uncertain all of them
/// together are with respect to the first grasp, which no touch changes and which does not matter for
/// the shape. A Kalman filter over the poses whose measurements are the contacts' distances and
/// normals, these as the surface bends that was believed `before`; without any it has faces.
pub fn beside_each_other(log: &GraspLog, steps: &[Step], before: Option<&Belief>) -> Vec<Step> {
    let moved = motion(log);
    let mut covariance = Matrix6::identity();
    let one = |(index, (grasp, step)): (usize, (&LoggedGrasp, &Step))| {
        let at = step.pose.inverse();
        let points: Vec<Point> =
            grasp.contacts.iter().map(|c| (at * Point3::from(c.point)).coords).collect();
        let flat = || vec![Matrix3::zeros(); points.len()];
        let bends = before.map_or_else(flat, |before| before.bends(&points));
        if index > 0 {
            covariance += moved;
        }
        for ((contact, p), bend) in grasp.contacts.iter().zip(&points).zip(&bends) {
            let (point, turn) = deviations(contact, &log.noise);
            let Some(normal) = contact.normal else { continue };
            let n = at.rotation * normal;
            let m = p.cross(&n);
            seen(&mut covariance, Vector6::new(n.x, n.y, n.z, m.x, m.y, m.z), point * point);
            for Turning { row, .. } in Turning::of(log.dimension, p, &n, bend) {
                seen(&mut covariance, row, turn * turn);
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
            let steps = beside_each_other(&log, &track::truth(&log).unwrap(), None);
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

    #[test]
    fn in_space_a_model_is_kept_until_much_more_is_felt() {
        let seen = |object: &str, counts: [usize; 3]| {
            let options = Options { grasps: Some(12), ..Options::new(object.parse().unwrap()) };
            let log = simulate(&options).unwrap().log;
            let first = |grasps: usize| {
                let log = GraspLog { grasps: log.grasps[..grasps].to_vec(), ..log.clone() };
                let steps = track::truth(&log).unwrap();
                (log, steps)
            };
            let (log, steps) = first(counts[0]);
            let mut belief = Belief::new(&log, &steps).unwrap();
            let mut chosen = vec![belief.chosen_by];
            for count in &counts[1..] {
                let (log, steps) = first(*count);
                belief = belief.after(&log, &steps).unwrap();
                chosen.push(belief.chosen_by);
                // Whoever chose the model, the surface goes through everything felt.
                for c in &belief.contacts {
                    assert!(belief.geometry.distance(&c.point) < 8e-3, "{object}");
                }
            }
            (chosen, belief.contacts.len())
        };
        let (chosen, contacts) = seen("prism:0.06,hexagon:0.04", [6, 7, 12]);
        assert_eq!(chosen[0], chosen[1]);
        assert!(chosen[2] > chosen[1] && chosen[2] == contacts, "{chosen:?}");
        let (chosen, contacts) = seen("hexagon:0.04", [6, 7, 8]);
        assert!(chosen[0] < chosen[1] && chosen[2] == contacts, "{chosen:?}");
    }
}
