//! The pairwise graph, as the thesis has it (3.3.3): grasps that felt the same faces know their
//! relative pose.
//!
//! The tracker's poses make a shape, the shape has faces ([`segmentation`] in the plane, [`clustering`]
//! in space), grasps that share three of them are [similar](similarity), [`registration`] lays their
//! contacts on each other with the [`covariance`] of equation 3.23, and a pose graph reconciles these
//! relative poses with the tracker's steps. Where several relative poses explain two grasps, all of
//! them are [`alternatives`] of one of the [`constraints`], and [`hypotheses`] keeps those sets of poses
//! that the evidence does not tell apart (thesis 5.2.4).
//!
//! Two things differ from the thesis, which [`Rules::as_printed`] restores: an edge may be refused, and
//! edges that use the same contacts do not count as if each had its own.

pub mod alternatives;
pub mod clustering;
pub mod constraints;
pub mod covariance;
pub mod hypotheses;
pub mod marginals;
pub mod motion;
pub mod registration;
pub mod segmentation;
pub mod similarity;

use nalgebra::Matrix6;
use tactile_core::track::Status;

use self::constraints::{Front, Rules, frames};
use self::hypotheses::{poses, weights};
use self::marginals::marginals;
use self::motion::{Motion, adjoint, carried};
use self::similarity::{Touched, similar};
use super::joint::problem::Problem;
use super::joint::tangent::{are_near, six_by_six};
use super::pose::{Se2, Se3};
use crate::log::GraspLog;
use crate::reference::Contact;
use crate::shape::Geometry;
use crate::slam::choose::Choice;
use crate::slam::place::doubt;
use crate::slam::reconstruct::{Poses, Shape, shape};
use crate::slam::track::Step;
use crate::slam::usual_deviations;
use crate::space::Pose;

/// Rounds of finding faces and solving: the second finds them at corrected poses.
const ROUNDS: usize = 2;

/// Pairwise constraints for each grasp at most; beyond that they tell little new.
const MOST: usize = 24;

/// Deviations of contact points, metres, that Douglas and Peucker's tolerance is.
const TOLERANCE: f64 = 2.5;

/// A hypothesis with this share of the belief makes a pose ambiguous.
const DOUBTED: f64 = 0.05;

/// Poses of one grasp nearer than this (metres, radians) are one.
const SAME: [f64; 2] = [5e-3, 0.1];

/// A set of poses that explains all grasps.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// Object to world, one per grasp.
    pub poses: Vec<Pose>,
    /// Its share of the belief, in (0, 1].
    pub weight: f64,
}

/// What the graph made of a log.
#[derive(Clone, Debug)]
pub struct Corrected {
    /// The steps with the poses of the likeliest explanation and their marginal covariances. A grasp
    /// that other explanations see elsewhere is ambiguous, and its modes are theirs.
    pub steps: Vec<Step>,
    /// Covariance of each pose beside the others, whatever they all are in the frame of the first.
    pub beside: Vec<Matrix6<f64>>,
    /// The likeliest explanations, the likeliest first.
    pub explanations: Vec<Explanation>,
    /// The face of each usable contact in the log's order; `None` where it lies on none.
    pub faces: Vec<Option<usize>>,
    /// The pairs of grasps that edges join.
    pub edges: Vec<[usize; 2]>,
    /// How many edges the likeliest explanation refuses.
    pub refused: usize,
}

impl Corrected {
    /// The steps with the covariances of [`Corrected::beside`]: to place contacts side by side.
    pub fn relative(&self) -> Vec<Step> {
        let with = |(step, covariance): (&Step, &Matrix6<f64>)| Step {
            covariance: *covariance,
            ..step.clone()
        };
        self.steps.iter().zip(&self.beside).map(with).collect()
    }

    /// Whether more than one explanation is left.
    pub fn is_ambiguous(&self) -> bool {
        self.explanations.iter().skip(1).any(|e| e.weight > DOUBTED)
    }
}

/// The log's steps corrected by relative poses between similar grasps; `None` where no two are similar.
pub fn correct(log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
    let rules = Rules { most: MOST * log.grasps.len(), as_printed: false };
    correct_by(log, steps, rules)
}

/// The same by other rules.
///
/// ```
/// use tactile_host::graph::pairwise::{constraints::Rules, correct_by};
/// use tactile_host::sim::{Options, simulate};
/// use tactile_host::slam::track;
/// let log = simulate(&Options::new("rectangle:0.10x0.06".parse()?))?.log;
/// let truth = track::truth(&log)?;
/// let corrected = correct_by(&log, &truth, Rules { most: 20, as_printed: false }).unwrap();
/// assert_eq!(corrected.steps.len(), 16);
/// assert!((1..=20).contains(&corrected.edges.len()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn correct_by(log: &GraspLog, steps: &[Step], rules: Rules) -> Option<Corrected> {
    if steps.len() != log.grasps.len() || log.grasps.len() < 2 || rules.most == 0 {
        return None;
    }
    let mut best: Option<Corrected> = None;
    for _ in 0..ROUNDS {
        let (from, placing) = match &best {
            None => (steps.to_vec(), steps.to_vec()),
            Some(b) => (b.steps.clone(), b.relative()),
        };
        let round = if log.dimension == 2 {
            once::<Se2, 3>(log, steps, &from, &placing, rules)
        } else {
            once::<Se3, 6>(log, steps, &from, &placing, rules)
        };
        match round {
            Some(found) => best = Some(found),
            None => break,
        }
    }
    best
}

/// Covariance of a step whose pose was seen; `None` where the motion alone says where it is.
fn known(step: &Step) -> Option<Matrix6<f64>> {
    let told = matches!(step.status, Status::Tracking | Status::Ambiguous) && step.corrected;
    let is_known = step.is_certain() || told;
    (is_known && step.covariance.iter().all(|v| v.is_finite())).then_some(step.covariance)
}

/// Faces at the poses of `from`, a graph of them, and its solution.
fn once<G: Motion<D>, const D: usize>(
    log: &GraspLog,
    steps: &[Step],
    from: &[Step],
    placing: &[Step],
    rules: Rules,
) -> Option<Corrected> {
    let problem = Problem::new(log);
    let given: Vec<Option<Pose>> = from.iter().map(|s| Some(s.pose)).collect();
    let start = problem.poses(&given);
    let faces = faces(log, &problem, &start, placing);
    let frames = frames(&problem, &start);
    let touched = touched(&problem, &frames, &faces);
    let similar = similar(problem.dimension, &touched);
    // What the tracker knows of a step, wherever the poses are by now.
    let tracked = problem.poses(&steps.iter().map(|s| Some(s.pose)).collect::<Vec<_>>());
    let covariances: Vec<Option<Matrix6<f64>>> = steps.iter().map(known).collect();
    let front = Front {
        problem: &problem,
        steps,
        poses: &start,
        tracked: &tracked,
        covariances: &covariances,
        touched: &touched,
        frames: &frames,
        similar: &similar,
    };
    let constraints = front.constraints::<G, D>(rules);
    if constraints.similar.is_empty() {
        return None;
    }
    let found = if rules.as_printed {
        vec![constraints.settled(front.nodes())?]
    } else {
        constraints.hypotheses(front.nodes())
    };
    let best = found.first()?;
    let doubts = marginals(&constraints.graph(best))?;
    let explanations: Vec<Explanation> = found
        .iter()
        .zip(weights(&found))
        .map(|(h, weight)| Explanation { poses: poses(&frames, &h.nodes), weight })
        .collect();
    let (mut corrected, mut beside) = (Vec::new(), Vec::new());
    for (k, step) in steps.iter().enumerate() {
        // x = C y⁻¹: what moves y in its own axes moves x in the object's.
        let ad = adjoint(&best.nodes[k].pose());
        let turned = |own| carried(&six_by_six(&own), &ad);
        beside.push(turned(doubts[k].beside));
        corrected.push(judged(step, k, &explanations, turned(doubts[k].marginal)));
    }
    let ends =
        |c: &constraints::Constraint<G, D>| c.choices.first().map(|c| [c.edge.from, c.edge.to]);
    Some(Corrected {
        steps: corrected,
        beside,
        explanations,
        faces,
        edges: constraints.similar.iter().filter_map(ends).collect(),
        refused: best.similar.iter().filter(|c| c.is_none()).count(),
    })
}

/// A step as the explanations have it.
fn judged(step: &Step, k: usize, explanations: &[Explanation], covariance: Matrix6<f64>) -> Step {
    let mut modes: Vec<(Pose, f64)> = Vec::new();
    for explanation in explanations {
        let pose = explanation.poses[k];
        match modes.iter_mut().find(|(other, _)| are_near(other, &pose, SAME)) {
            Some(mode) => mode.1 += explanation.weight,
            None => modes.push((pose, explanation.weight)),
        }
    }
    let doubted = modes.iter().skip(1).any(|m| m.1 > DOUBTED);
    let pose = modes.first().map_or(step.pose, |m| m.0);
    let status = match step.status {
        Status::Started => Status::Started,
        _ if doubted => Status::Ambiguous,
        Status::Ambiguous => Status::Tracking,
        other => other,
    };
    Step { pose, covariance, status, modes, ..step.clone() }
}

/// The face of every usable contact, where the poses of `placing` put it as surely as they say.
fn faces(
    log: &GraspLog,
    problem: &Problem,
    poses: &[Pose],
    placing: &[Step],
) -> Vec<Option<usize>> {
    let placed = |i: usize| -> Contact {
        let contact = problem.placed(poses, i);
        match placing.get(problem.felt[i].grasp) {
            Some(step) if step.covariance.iter().all(|v| v.is_finite()) => {
                doubt(contact, &step.covariance)
            }
            _ => contact,
        }
    };
    let contacts: Vec<Contact> = (0..problem.felt.len()).map(placed).collect();
    faces_at(log, &contacts)
}

/// The face of every contact (object frame): a segment of the outline in the plane, a cluster in space.
pub fn faces_at(log: &GraspLog, contacts: &[Contact]) -> Vec<Option<usize>> {
    if log.dimension == 3 {
        return clustering::clusters(contacts);
    }
    let tolerance = TOLERANCE * usual_deviations(&log.noise).0;
    let segments =
        match shape(log.dimension, contacts, &[], Poses::Estimated, Choice::Auto, &|_, _| ()) {
            Ok(Shape { geometry: Geometry::Outline(outline), .. }) => {
                segmentation::segments(&outline, tolerance).unwrap_or_default()
            }
            _ => Vec::new(),
        };
    contacts.iter().map(|c| segmentation::assigned(&segments, c, tolerance)).collect()
}

/// The contacts with normals, by grasp, in the grasps' frames.
pub fn touched(problem: &Problem, frames: &[Pose], faces: &[Option<usize>]) -> Vec<Touched> {
    let of = |k: usize| {
        let mut own = Touched::default();
        for i in problem.of(k) {
            let contact = problem.felt[i].contact.transformed(&frames[k].inverse());
            if contact.normal.is_some() {
                own.contacts.push(contact);
                own.faces.push(faces[i]);
            }
        }
        own
    };
    (0..problem.grasps()).map(of).collect()
}

#[cfg(test)]
mod tests;
