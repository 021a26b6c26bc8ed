//! Faces end where others begin: contacts lie on the part of a plane that is surface, and fingers that
//! touched nothing outside of all.
//!
//! A grasp that feels two parallel sides may slide along them, as far as planes can tell: infinitely far.
//! But its contacts lie on sides that end, and once the others are known, so is where. Each contact that
//! lies beyond the end of its face is held back by the face that ends it, with the contact's own
//! deviation and in one direction only; so is a finger that touched nothing and lies within. What that
//! costs, and what still lies elsewhere, tells sound sets of faces from those whose contacts hang in the
//! air.
//!
//! The faces stay where they are: an inequality pushes one way, and would make objects grow. So do the
//! covariances, as if faces were endless: of a pose that is held back that is rather too much doubt.

use super::arrow::Arrow;
use super::factors;
use super::planes::{Plane, known};
use super::problem::{Felt, Labels, Problem, State};
use super::solve::{ENOUGH, descend, linearise};
use super::tangent::Face;
use crate::model::faces::Owner;
use crate::reference::Contact;
use crate::shape::Field;
use crate::shape::polytope::Polytope;
use crate::slam::choose;
use crate::space::Pose;

/// Rounds of finding contacts beyond the ends of their faces: what is held back here may slide beyond
/// another end.
const ROUNDS: usize = 6;

/// How far beyond the end of its face a contact may lie, in its deviations.
const LEAST: f64 = 0.2;

/// How near to a plane its points are, metres.
const ON: f64 = 1e-6;

/// What was felt, or not, does not lie on this side of this face.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Side {
    felt: Felt,
    face: usize,
    /// +1 outside of the plane, as where corners are convex; −1 behind it, as in a hollow.
    sign: f64,
}

/// Poses with contacts where their faces are surface, and fingers that touched nothing outside.
#[derive(Clone, Debug)]
pub(super) struct Confined {
    /// As it was but for the poses.
    pub state: State,
    /// What it cost to bring them there, and those that still lie elsewhere, nats.
    pub cost: f64,
    /// What each grasp would spare at most if it were made at another pose: what its contacts cost that lie
    /// elsewhere or on nothing, and what its motions came to cost more, nats.
    pub hanging: Vec<f64>,
}

/// Holds contacts on the surface and free fingers off it. Where the faces make no closed object, no contact
/// lies on it, and the poses are as they were.
pub(super) fn confined<const D: usize>(
    problem: &Problem,
    state: &State,
    labels: &Labels,
    planes: &[Plane],
) -> Confined {
    let begun = state;
    let mut state = state.clone();
    let mut sides: Vec<Side> = Vec::new();
    let centre = problem.middle(&state.poses);
    let before = linearise::<D>(problem, &state, labels, &centre).0;
    let mut shape = closed(problem, &state, labels, planes);
    for _ in 0..ROUNDS {
        let Some(now) = &shape else { break };
        let wrong = beyond(problem, &state, labels, now).chain(within(problem, &state, now));
        let new: Vec<Side> = wrong.filter(|side| !sides.contains(side)).collect();
        if new.is_empty() {
            break;
        }
        sides.extend(new);
        let centre = problem.middle(&state.poses);
        descend::<D>(problem.dimension, (&mut state, &mut 0), ENOUGH, |state| {
            let (mut cost, mut arrow) = linearise::<D>(problem, state, labels, &centre);
            cost += sides.iter().map(|side| side.add(&mut arrow, problem, state)).sum::<f64>();
            arrow.hold_faces();
            (cost, arrow)
        });
        shape = closed(problem, &state, labels, planes);
    }
    let centre = problem.middle(&state.poses);
    let after = linearise::<D>(problem, &state, labels, &centre).0;
    let mut hanging = elsewhere(problem, &state, labels, shape.as_ref());
    let left: f64 = hanging.iter().sum();
    for (contact, _) in labels.iter().enumerate().filter(|(_, label)| label.is_none()) {
        let felt = &problem.felt[contact];
        hanging[felt.grasp] += spared(problem, &felt.contact);
    }
    for k in 1..state.poses.len() {
        let cost = |poses: &[Pose]| problem.moved(k, &poses[k - 1], &poses[k], &centre);
        let rise = (cost(&state.poses) - cost(&begun.poses)).max(0.0);
        hanging[k - 1] += rise;
        hanging[k] += rise;
    }
    Confined { state, cost: after - before + left, hanging }
}

/// What a contact on nothing costs more than one that fits, nats.
fn spared(problem: &Problem, contact: &Contact) -> f64 {
    (problem.unexplained(contact) - problem.exact(contact)).max(0.0)
}

/// What contacts cost, grasp by grasp, that lie off the surface of their faces, and free fingers within:
/// each at most what an unexplained contact does.
fn elsewhere(
    problem: &Problem,
    state: &State,
    labels: &Labels,
    shape: Option<&Polytope>,
) -> Vec<f64> {
    let mut costs = vec![0.0; state.poses.len()];
    let cost = |contact: &Contact, squared: f64| {
        let off = problem.kernel.cost(squared / contact.point_deviation.powi(2)).0;
        off.min(spared(problem, contact))
    };
    for (contact, label) in labels.iter().enumerate() {
        let Some(Owner::Face(own)) = label else { continue };
        let felt = problem.placed(&state.poses, contact);
        let nearest = shape.and_then(|shape| shape.nearest(&felt.point, Some(*own)));
        let off = state.faces[*own].value(&felt.point);
        let along = nearest.map_or(f64::INFINITY, |(.., distance)| distance.powi(2) - off.powi(2));
        costs[problem.felt[contact].grasp] += cost(&felt, along.max(0.0));
    }
    for felt in &problem.free {
        let within = shape.and_then(|shape| depth(felt, state, shape));
        costs[felt.grasp] += within.map_or(0.0, |(_, depth)| cost(&felt.contact, depth.powi(2)));
    }
    costs
}

impl Side {
    /// Adds that the contact is on the other side of the face; what it costs.
    fn add<const D: usize>(&self, arrow: &mut Arrow<D>, problem: &Problem, state: &State) -> f64 {
        let Felt { grasp, contact, .. } = self.felt;
        let bare = Contact { normal: None, ..contact };
        let (pose, face) = (&state.poses[grasp], &state.faces[self.face]);
        let touch = factors::touch(pose, face, problem.dimension, &bare);
        if self.sign * touch.residual[0] <= 0.0 {
            return 0.0;
        }
        let (cost, weight) = problem.kernel.cost(touch.residual[0].powi(2));
        let root = weight.sqrt();
        arrow.add_touch(grasp, &(touch.residual * root), &(touch.by_pose * root), &[]);
        cost
    }
}

/// The object that the faces make with the contacts at these poses.
fn closed(problem: &Problem, state: &State, labels: &Labels, planes: &[Plane]) -> Option<Polytope> {
    let placed: Vec<Contact> = (0..labels.len()).map(|i| problem.placed(&state.poses, i)).collect();
    let faces = known(problem.dimension, planes, &placed, labels.clone());
    choose::close(&faces, &placed, &[]).ok()
}

/// Which contacts lie beyond the ends of their faces, and of which others.
fn beyond(
    problem: &Problem,
    state: &State,
    labels: &Labels,
    shape: &Polytope,
) -> impl Iterator<Item = Side> {
    labels.iter().enumerate().filter_map(|(contact, label)| {
        let Some(Owner::Face(own)) = label else { return None };
        let felt = problem.placed(&state.poses, contact);
        let (_, end, distance) = shape.nearest(&felt.point, Some(*own))?;
        let off = state.faces[*own].value(&felt.point);
        if distance * distance - off * off < (LEAST * felt.point_deviation).powi(2) {
            return None;
        }
        let ends = |(_, face): &(usize, &Face)| face.value(&end).abs() < ON;
        let others = state.faces.iter().enumerate().filter(|(face, _)| face != own).filter(ends);
        let values = others.map(|(face, plane)| (face, plane.value(&felt.point)));
        // Of a corner's faces the one that the contact is outside of, if it is outside of any.
        let (face, value) = values.max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Side { felt: problem.felt[contact], face, sign: value.signum() })
    })
}

/// Which fingertips that touched nothing lie within the object, and below which faces.
fn within(problem: &Problem, state: &State, shape: &Polytope) -> impl Iterator<Item = Side> {
    problem.free.iter().filter_map(|felt| {
        let (face, depth) = depth(felt, state, shape)?;
        let counts = depth > LEAST * felt.contact.point_deviation && face < state.faces.len();
        counts.then_some(Side { felt: *felt, face, sign: -1.0 })
    })
}

/// How deep in the object a fingertip lies (metres), and below which of its planes; `None` outside.
fn depth(felt: &Felt, state: &State, shape: &Polytope) -> Option<(usize, f64)> {
    let placed = felt.contact.transformed(&state.poses.get(felt.grasp)?.inverse());
    let inside = shape.values(&[placed.point]).first().is_some_and(|value| *value < 0.0);
    let (plane, _, depth) = shape.nearest(&placed.point, None).filter(|_| inside)?;
    Some((plane, depth))
}

#[cfg(test)]
mod tests;
