//! The joint graph: all poses and the object's surface estimated together, after the tracker.
//!
//! Every contact is one measurement of one face (or of one smooth surface) from one pose, and poses,
//! faces and motions are solved in one least-squares problem (planar SLAM: Kaess, ICRA 2015; the
//! sparsity is that of bundle adjustment, Triggs et al. 2000).
//!
//! [`planes`](mod@planes) is the entrance, and [`held`] where poses are known and only faces are
//! sought. Below it, [`problem`] holds the measurements and the unknowns, `slip` what motions cost,
//! [`factors`] the residuals and their derivatives, [`solve`](mod@solve) the Levenberg–Marquardt
//! iteration on the structure that [`arrow`] exploits and the evidence of what it finds, to which
//! [`size`] belongs; `schur` makes the largest of their products. [`explain`] and [`alias`] decide which
//! contact lies on which face and at which of several look-alike poses a grasp was made, [`retrack`]
//! builds a trajectory of its own, [`regular`](mod@regular) gives faces an order by [`relation`]s such as
//! parallel and square, and [`average`] takes the mean where it is open which hold. `confine` keeps
//! contacts where faces are surface, and fingers that touched nothing outside; `seat` finds other poses
//! for grasps whose contacts still hang in the air. [`surface`] does for curved objects what faces do for
//! flat ones, from the tracker's trajectory or those that [`round`] finds, and then tries single grasps
//! elsewhere; `lone` finds the best pose of one grasp while all else stays. `supposed` has normals to
//! begin with where none were felt.

pub mod alias;
pub mod arrow;
pub mod average;
mod confine;
pub mod explain;
pub mod factors;
mod lone;
pub mod planes;
pub mod problem;
pub mod regular;
pub mod relation;
pub mod retrack;
pub mod ridge;
pub mod round;
mod schur;
mod seat;
pub mod size;
mod slip;
pub mod solve;
mod supposed;
pub mod surface;
pub mod tangent;

pub use planes::{Corrected, Effort, Plane, held, planes};

use nalgebra::Matrix6;

use crate::log::GraspLog;
use crate::model::bare;
use crate::reference::Contact;
use crate::slam::choose::{self, only};
use crate::slam::place::place;
use crate::slam::reconstruct::are_boxes;
use crate::slam::track::Step;
use crate::space::Pose;
use problem::Problem;
use supposed::supposed;

/// Grasps from which on poses are corrected. Of fewer, many sets of poses lay all contacts on a few
/// faces, the fewest faces win, and what comes of it looks more certain than it is.
pub const LEAST_GRASPS: usize = 8;

/// Numbers that make a block in the plane and in space. A superquadric has its axes square to each other, and
/// what it saves by that it must not gain over faces that are as much in order.
const BLOCK: [usize; 2] = [5, 9];

/// Trajectories of a round body from which the smooth surface starts.
const ROUND: usize = 2;

/// The log's steps corrected by faces where the object that they make is to be believed
/// ([`choose::judge`], or as a box less smaller boxes where contacts lie on no face), or by a round body or
/// superquadric that explains the contacts to their noise and with fewer numbers; else by the smooth surface of
/// least cost, whether it starts from the tracker's poses, from those of the faces or from those of a round body,
/// with grasps at other poses where that costs less. In the plane, contacts without normals that no body explains are
/// given some to begin with.
/// `None` where the tracker's poses stand: those of few grasps, and of a curved object in more contacts than
/// the smooth surface is quick for.
pub fn correct(log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
    corrected(log, steps, Effort::default())
}

/// The same without another trajectory than that of `steps`, and without grasps tried elsewhere: what is
/// likeliest near them. From the true poses it is what an estimator leaves that is never wrong about
/// which contact lies where.
pub fn refine(log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
    corrected(log, steps, Effort { restarts: false, retrack: false, ..Effort::default() })
}

fn corrected(log: &GraspLog, steps: &[Step], effort: Effort) -> Option<Corrected> {
    if log.grasps.len() < LEAST_GRASPS {
        return None;
    }
    let Some(told) = supposed(log) else { return modelled(log, steps, effort) };
    let problem = Problem::new(log);
    let round = round_bodies(&problem, &[steps], effort.retrack);
    match round.first().filter(|body| body.is_body()) {
        Some(body) => Some(bodily(&problem, body, steps)),
        None => modelled(&told, steps, effort),
    }
}

/// By the model that suits the contacts best.
fn modelled(log: &GraspLog, steps: &[Step], effort: Effort) -> Option<Corrected> {
    let problem = Problem::new(log);
    // In the plane faces are found at once, and an ellipse with two ends is nearly a hexagon.
    if log.dimension == 3 {
        let near = round_bodies(&problem, &[steps], false);
        if near.first().is_some_and(round::Followed::is_plain) {
            let round = if effort.retrack { round_bodies(&problem, &[steps], true) } else { near };
            return round.first().map(|body| bodily(&problem, body, steps));
        }
    }
    let flat = planes(log, &[steps], effort);
    let starts: Vec<&[Step]> =
        std::iter::once(steps).chain(flat.as_ref().map(|f| &f.steps[..])).collect();
    let believed = |flat: &Corrected| {
        let contacts = place(log, &flat.relative());
        let contacts: Vec<Contact> = contacts.into_iter().map(|p| p.contact).collect();
        let boxed = || {
            let guessed = bare::guessed(log.dimension, &contacts);
            are_boxes(log.dimension, guessed.as_deref().unwrap_or(&contacts))
        };
        let Some(faces) = flat.shape(log) else { return false };
        let trusted = only(&contacts, &choose::trusted(&faces, &contacts, &[]));
        if !choose::fit(flat.per_degree, &trusted) {
            return false;
        }
        choose::judge(log.dimension, &trusted, &[]).is_ok()
            || flat.owners.contains(&None) && boxed()
    };
    let is_flat = flat.as_ref().is_some_and(believed);
    let round = round_bodies(&problem, &starts, effort.retrack && !is_flat);
    let block = BLOCK[usize::from(log.dimension != 2)];
    let is_likelier = |body: &&round::Followed| match &flat {
        Some(flat) if is_flat => {
            let all = log.dimension * flat.faces.len();
            let numbers = if body.superquadric { all.min(block) } else { all };
            body.cost < planes::criterion(&problem, flat, numbers)
        }
        _ => true,
    };
    if let Some(body) = round.first().filter(|body| body.is_body()).filter(is_likelier) {
        return Some(bodily(&problem, body, steps));
    }
    if is_flat {
        return flat;
    }
    let round: Vec<Vec<Pose>> = round
        .into_iter()
        .filter(round::Followed::is_start)
        .take(if effort.retrack { ROUND } else { 0 })
        .map(|body| body.poses)
        .collect();
    // Poses of faces that are not believed are worse than the tracker's (of twelve logs of ellipses in sixty
    // grasps five are right by them, and eight by the tracker).
    surface::smooth(log, &starts, &round, effort.retrack)
}

/// The poses of a round body that leaves nothing for a smooth surface to explain.
fn bodily(problem: &Problem, body: &round::Followed, steps: &[Step]) -> Corrected {
    let first = || std::iter::once(Matrix6::zeros());
    let marginal = first().chain(body.covariance.iter().copied());
    let told = body.poses.iter().zip(marginal).zip(steps).enumerate();
    // What the tracker said of each grasp but for its pose.
    let steps = told.map(|(k, ((pose, covariance), step))| {
        step.at(*pose, covariance, problem.is_found(k, |i| body.explained[i]))
    });
    Corrected {
        steps: steps.collect(),
        given_faces: first().chain(body.given_body.iter().copied()).collect(),
        faces: Vec::new(),
        owners: vec![None; problem.felt.len()],
        cost: body.cost,
        per_degree: body.per_degree,
    }
}

/// The likeliest trajectories of a round body, from the first pose: near those given, and with `search`
/// wherever.
fn round_bodies(problem: &Problem, given: &[&[Step]], search: bool) -> Vec<round::Followed> {
    let poses = |steps: &&[Step]| {
        let poses: Vec<Option<Pose>> = steps.iter().map(|step| Some(step.pose)).collect();
        problem.poses(&poses)
    };
    let given: Vec<Vec<Pose>> = given.iter().map(poses).collect();
    match problem.dimension {
        2 => round::trajectories::<3>(problem, &given, search),
        _ => round::trajectories::<6>(problem, &given, search),
    }
}

#[cfg(test)]
mod frame_tests;
#[cfg(test)]
mod tests;
