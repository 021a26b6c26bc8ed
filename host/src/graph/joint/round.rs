//! A round body as the map: poses and the body solved together, grasp by grasp.
//!
//! What hands hold is mostly a quadric (ball, ellipsoid, cylinder) with a few flat ends, or a superquadric:
//! boxes whose sides bulge and whose edges are round, cans with a rim. Such a body has so few numbers that
//! all poses and the body fit into one least-squares problem, as they do for faces, and so a trajectory can
//! be found even where a tracker that learns the surface point by point is lost. Several hypotheses go from
//! grasp to grasp, each solved as a whole, with flat ends that come and go by the Bayesian information
//! criterion. Where the body explains the contacts to their noise, there is nothing left to say about them;
//! else what comes of it is a start for [`surface`](super::surface).
//!
//! How exact normals are is found with the body: half-way between two parts a finger on their edge feels
//! neither's, and a hand that knows points to a tenth of a millimetre need not know directions as well.
//! Believed to be exact, a few normals bend the whole trajectory.
//!
//! A contact may be wild: then it costs what that is worth and has no say. A kernel that only weakens what is
//! far off lets a tenth of the contacts bend body and normals until a wrong trajectory is the likeliest. But
//! what is far off in poses that are not yet known is not wild, so a new grasp's pose, and poses that were
//! given, are first sought where every contact pulls.
//!
//! An object's end may be felt by one contact of a grasp, and elsewhere by another grasp, for along its
//! sides nobody knew where it was. So one contact that the sides do not explain is reason enough for an
//! end, which then tells where the other grasps were.

use nalgebra::{Matrix6, Point3};
use rayon::prelude::*;

use super::problem::Problem;
use super::tangent::{SAME, Tangent, are_near, axes, retract};
use crate::reference::{Contact, Prior};
use crate::space::{Point, Pose};

mod body;
mod descent;
mod parts;
#[cfg(test)]
mod tests;

use body::Round;
use descent::{Free, alone, descend, followed, wild};
use parts::{ENDS, kinds, with_ends};

/// Most grasps and contacts: every grasp solves all before it again.
const MOST: [usize; 2] = [48, 400];

/// Hypotheses kept, and continuations taken of each.
const KEPT: usize = 4;
const CONTINUED: usize = 3;

/// Steps of a whole hypothesis at every grasp, and at the end.
const TOGETHER: usize = 6;
const FINALLY: usize = 30;

/// Hypotheses revised at the end, and how often at most.
const REVISED: usize = 3;
const ROUNDS: usize = 3;

/// Nats behind the best at which a hypothesis is given up.
const HOPELESS: f64 = 30.0;

/// The object is no such body where every hypothesis of so many grasps, or more, has parallel faces for
/// sides or leaves more than this share of the contacts unexplained.
const SOON: usize = 6;
const STRANGE: f64 = 0.2;

/// An object is such a body where at most this share of the contacts is not explained (and it need not be
/// compared with flat faces where it is even fewer), and χ² per degree of freedom of the others is at most
/// so much.
const WILD: f64 = 0.1;
const PLAIN: f64 = 0.02;
const MISFIT: f64 = 1.2;

/// A trajectory of the first grasps and the body it makes.
#[derive(Clone, Debug)]
struct Hypothesis {
    poses: Vec<Pose>,
    body: Round,
    /// Centre and radius of the ball about the contacts, to which the body is drawn.
    ball: (Point, f64),
    /// Whether contacts may be wild, which cost so much and pull no more.
    bounded: bool,
    /// Nats: contacts, motions, the pull to the ball, and the price of the body's numbers.
    cost: f64,
}

/// A trajectory and the body that its contacts make.
#[derive(Clone, Debug)]
pub struct Followed {
    /// Object to world, one per grasp, the first as given.
    pub poses: Vec<Pose>,
    /// Negative log evidence of contacts, motions and body, nats, as the Bayesian information criterion
    /// has it.
    pub cost: f64,
    /// Which contacts the body explains.
    pub explained: Vec<bool>,
    /// Share of the contacts that no part of it does.
    pub wild: f64,
    /// χ² of all other contacts and of the motions that were measured, per degree of freedom: about 1 for
    /// such a body.
    pub per_degree: f64,
    /// Whether its sides are: two parallel faces are a quadric too.
    pub round: bool,
    /// Whether normals err more than any body's would.
    pub rough: bool,
    /// Whether it is a superquadric; boxes pass for one, too.
    pub superquadric: bool,
    /// Covariance of each pose but the first, with the body as uncertain as it is.
    pub covariance: Vec<Matrix6<f64>>,
    /// The same if the body were known.
    pub given_body: Vec<Matrix6<f64>>,
}

impl Followed {
    /// Whether nothing but such a body need be considered: it explains nearly every contact, and flat faces
    /// would not.
    pub fn is_plain(&self) -> bool {
        self.is_body() && !self.superquadric && self.wild <= PLAIN
    }

    /// Whether another model of the object may start from its poses. A body that has to take normals for
    /// rough and still does not explain the contacts is the wrong one, and has bent them to itself.
    pub fn is_start(&self) -> bool {
        self.explains() || !self.rough
    }

    /// Whether the object is such a body. A superquadric that has to take normals for rough is only nearly the
    /// object, of which a smooth surface says more.
    pub fn is_body(&self) -> bool {
        self.explains() && !(self.superquadric && self.rough)
    }

    /// Whether it explains the contacts to their noise, but for a few.
    fn explains(&self) -> bool {
        self.round && self.wild <= WILD && self.per_degree <= MISFIT
    }
}

/// The likeliest trajectories of an object that is a quadric with flat ends or a superquadric, best first,
/// near those that are `given`, which all have the same first pose; none for longer logs than would be quick,
/// or where a number is not finite. With `search` the log is also followed without them, forwards and
/// backwards, and single grasps are tried at other poses.
pub fn trajectories<const D: usize>(
    problem: &Problem,
    given: &[Vec<Pose>],
    search: bool,
) -> Vec<Followed> {
    let most = [problem.grasps(), problem.felt.len()];
    if most.iter().zip(MOST).any(|(have, most)| *have > most) || problem.grasps() == 0 {
        return Vec::new();
    }
    let mut kept: Vec<Hypothesis> =
        given.par_iter().flat_map_iter(|poses| near::<D>(problem, poses)).collect();
    if search {
        let first = given.first().and_then(|poses| poses.first()).copied();
        let (ahead, back) =
            rayon::join(|| follow::<D>(problem, first), || backwards::<D>(problem, first));
        kept.extend(ahead);
        kept.extend(back);
        best(&mut kept);
        kept.truncate(REVISED);
        kept.par_iter_mut().for_each(|one| {
            revise::<D>(problem, one);
            descend::<D>(problem, one, FINALLY, Free::All);
        });
    }
    best(&mut kept);
    kept.iter().filter_map(|one| followed::<D>(problem, one)).collect()
}

/// Hypotheses of the whole log, grasp by grasp.
fn follow<const D: usize>(problem: &Problem, first: Option<Pose>) -> Vec<Hypothesis> {
    let Some(start) = begin(problem, first) else { return Vec::new() };
    let mut kept = vec![start];
    for grasp in 1..problem.grasps() {
        let mut next: Vec<Hypothesis> = kept
            .par_iter()
            .flat_map_iter(|one| continued::<D>(problem, one, grasp))
            .flat_map_iter(|one| kinds::<D>(problem, one, Free::All))
            .map(|one| with_ends::<D>(problem, one, Free::All))
            .collect();
        best(&mut next);
        kept = next;
        let likely =
            |one: &Hypothesis| one.body.is_round(one.ball.1) && wild(problem, one) <= STRANGE;
        if grasp >= SOON && !kept.iter().any(likely) {
            return Vec::new();
        }
    }
    kept.par_iter_mut().for_each(|one| descend::<D>(problem, one, FINALLY, Free::All));
    best(&mut kept);
    kept
}

/// The same from the last grasp to the first: what early grasps leave open, late ones may decide at
/// once. Its poses are as those of [`follow`], relative to the first.
fn backwards<const D: usize>(problem: &Problem, first: Option<Pose>) -> Vec<Hypothesis> {
    let Some(first) = problem.poses(&[first]).first().copied() else { return Vec::new() };
    let mut found = follow::<D>(&problem.reversed(), None);
    for one in &mut found {
        one.poses.reverse();
        let Some(frame) = one.poses.first().map(|pose| pose.inverse() * first) else { continue };
        for pose in &mut one.poses {
            *pose *= frame;
        }
        let Some(body) = one.body.transformed(problem.dimension, &frame.inverse()) else {
            one.cost = f64::INFINITY;
            continue;
        };
        one.body = body;
        one.ball.0 = (frame.inverse() * Point3::from(one.ball.0)).coords;
        // Where it was, up to rounding.
        if let Some(pose) = one.poses.first_mut() {
            *pose = first;
        }
        descend::<D>(problem, one, FINALLY, Free::All);
    }
    found
}

/// The likeliest hypothesis near these poses: the body is fitted to them first, so that it does not pull
/// them to what it begins as.
fn near<const D: usize>(problem: &Problem, poses: &[Pose]) -> Option<Hypothesis> {
    if poses.len() != problem.grasps() {
        return None;
    }
    let ball = ball(problem, poses)?;
    // Where poses are off by more than contacts err, all of them look wild: then every contact pulls first.
    let both = [false, true].map(|bounded| {
        let body = Round::ball(problem.dimension, &ball);
        let poses = poses.to_vec();
        let one = Hypothesis { poses, body, ball, bounded, cost: f64::INFINITY };
        settled::<D>(problem, one)
    });
    let mut all = both.concat();
    best(&mut all);
    all.into_iter().next()
}

/// A ball's hypothesis with the sides and ends that its poses ask for, and then the likeliest near it.
fn settled<const D: usize>(problem: &Problem, mut ball: Hypothesis) -> Vec<Hypothesis> {
    descend::<D>(problem, &mut ball, FINALLY, Free::Body);
    let mut all = kinds::<D>(problem, ball, Free::Body);
    for one in &mut all {
        for _ in 0..ENDS {
            let before = one.body.ends.len();
            *one = with_ends::<D>(problem, one.clone(), Free::Body);
            if one.body.ends.len() == before {
                break;
            }
        }
        descend::<D>(problem, one, FINALLY, Free::All);
        one.bounded = true;
        // What it costs so, to be compared.
        descend::<D>(problem, one, TOGETHER, Free::All);
        *one = with_ends::<D>(problem, one.clone(), Free::All);
        descend::<D>(problem, one, FINALLY, Free::All);
    }
    all
}

/// The ball about the first grasp's contacts.
fn begin(problem: &Problem, first: Option<Pose>) -> Option<Hypothesis> {
    let pose = *problem.poses(&[first]).first()?;
    let poses = vec![pose];
    let ball = ball(problem, &poses)?;
    let body = Round::ball(problem.dimension, &ball);
    Some(Hypothesis { poses, body, ball, bounded: true, cost: f64::INFINITY })
}

fn ball(problem: &Problem, poses: &[Pose]) -> Option<(Point, f64)> {
    let contacts: Vec<Contact> =
        (0..problem.starts[poses.len()]).map(|i| problem.placed(poses, i)).collect();
    match Prior::fitted(&contacts)? {
        Prior::Ball { centre, radius } if radius.is_finite() && radius > 0.0 => {
            Some((centre, radius))
        }
        _ => None,
    }
}

/// The hypothesis with one grasp more, at each of the poses where it fits best.
fn continued<const D: usize>(problem: &Problem, one: &Hypothesis, grasp: usize) -> Vec<Hypothesis> {
    let motion = &problem.motions[grasp];
    let Some(predicted) = one.poses.last().map(|last| motion.pose * last) else {
        return Vec::new();
    };
    let middle = problem.middle(&one.poses);
    let mut found: Vec<(f64, Pose)> = spread::<D>(&predicted, &middle, motion.deviations)
        .into_iter()
        .filter_map(|start| alone::<D>(problem, one, grasp, start))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut apart: Vec<Pose> = Vec::new();
    for (_, pose) in found {
        if apart.len() < CONTINUED && !apart.iter().any(|other| are_near(other, &pose, SAME)) {
            apart.push(pose);
        }
    }
    let mut next = Vec::new();
    for pose in apart {
        let mut more = one.clone();
        more.poses.push(pose);
        if let Some(ball) = ball(problem, &more.poses) {
            more.ball = ball;
            descend::<D>(problem, &mut more, TOGETHER, Free::All);
            next.push(more);
        }
    }
    next
}

/// Poses about the predicted one, as far apart as motions err: each axis turned and moved both ways,
/// about the `middle` of what was felt.
pub(super) fn spread<const D: usize>(
    predicted: &Pose,
    middle: &Point,
    deviations: [f64; 2],
) -> Vec<Pose> {
    let middle = Point3::from(*middle);
    let mut starts = vec![*predicted];
    for axis in axes::<D>().into_iter().rev() {
        for sign in [1.5, -1.5] {
            let mut tangent = Tangent::zeros();
            tangent[axis] = sign * deviations[usize::from(axis >= 3)];
            let mut moved = retract(predicted, &tangent);
            if axis >= 3 {
                moved.translation.vector += predicted * middle - moved * middle;
            }
            starts.push(moved);
        }
    }
    starts
}

/// Leaves the likeliest few that differ in the last pose or in their flat ends.
fn best(all: &mut Vec<Hypothesis>) {
    all.retain(|h| h.cost.is_finite());
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let least = all.first().map_or(0.0, |h| h.cost);
    let mut kept: Vec<Hypothesis> = Vec::new();
    for one in all.drain(..) {
        let known = |other: &Hypothesis| {
            one.body.width(3) == other.body.width(3)
                && one.poses.iter().zip(&other.poses).all(|(a, b)| are_near(a, b, SAME))
        };
        let rivals = kept.iter().filter(|k| k.body.is_like(&one.body));
        if rivals.count() < KEPT && one.cost < least + HOPELESS && !kept.iter().any(known) {
            kept.push(one);
        }
    }
    *all = kept;
}

/// With every grasp at another pose where all of it is likelier so: what an early grasp meant may show
/// only when the body is known.
fn revise<const D: usize>(problem: &Problem, one: &mut Hypothesis) {
    for _ in 0..ROUNDS {
        let before = one.cost;
        for grasp in 1..one.poses.len() {
            let motion = &problem.motions[grasp];
            let middle = problem.middle(&one.poses);
            let predicted = motion.pose * one.poses[grasp - 1];
            let other = spread::<D>(&predicted, &middle, motion.deviations)
                .into_iter()
                .chain(spread::<D>(&one.poses[grasp], &middle, motion.deviations))
                .filter_map(|start| alone::<D>(problem, one, grasp, start))
                .filter(|(_, pose)| !are_near(pose, &one.poses[grasp], SAME))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, pose)) = other else { continue };
            let mut moved = one.clone();
            moved.poses[grasp] = pose;
            descend::<D>(problem, &mut moved, TOGETHER, Free::All);
            if moved.cost < one.cost {
                *one = moved;
            }
        }
        *one = with_ends::<D>(problem, one.clone(), Free::All);
        if before - one.cost < 0.5 {
            break;
        }
    }
}
