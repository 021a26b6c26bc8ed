//! At which of several look-alike poses a grasp was made.
//!
//! A tracker that took a contact for one on the next face stays beside the truth: no descent leads
//! back. So poses are sought again from starts all over the motion's uncertainty, against the faces
//! and against what single contacts say, and tried on the whole graph: for the grasp alone, or for it
//! and those next to it that share its mistake. The first grasps are no surer than others, though they
//! define the object frame.

use std::ops::RangeInclusive;

use nalgebra::{Const, DMatrix, DimMin, Matrix3, SMatrix, SVector};

use super::explain::{attempt, renamed, supported};
use super::factors;
use super::problem::{Labels, Problem, State};
use super::solve::{Solved, face_variance};
use super::tangent::{Face, SAME, Tangent, are_near, axes, retract};
use crate::model::faces::{self, Owner};
use crate::space::{Point, Pose, across};

mod aim;

use aim::{aim, pull};

/// Starts: turns about each axis, in deviations of the motion.
const TURNS: [f64; 4] = [0.8, 1.6, 2.4, 3.2];

/// Where an object was put elsewhere: half turns about each axis come in so many parts, and the contacts of a grasp
/// lie so much of the object's extent from where its middle is expected.
const PARTS: u32 = 4;
const ELSEWHERE: f64 = 0.5;

/// By how much deviations are enlarged, iteration by iteration.
const SLACK: [f64; 9] = [8.0, 6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 1.0, 1.0];

/// Moves tried on the whole graph at most, and the nats by which the quick estimate may call them
/// worse: faces are there as the mistake left them.
const TRIED: usize = 6;
const WORSE: f64 = 25.0;

/// Grasps that are moved together at most.
const TOGETHER: usize = 48;

/// Something a contact can lie on: a face, or the plane that one contact which no face explains
/// suggests.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// With its uncertainty.
    pub plane: faces::Face,
    /// The contact that suggests it, if it is not a face.
    pub contact: Option<usize>,
}

/// A pose a grasp may have been made at.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Object to world.
    pub pose: Pose,
    /// The target of each of its contacts, or those where it lies on an edge.
    pub targets: Vec<Option<Owner>>,
    /// Cost of its contacts.
    pub cost: f64,
}

/// All faces, in their order, and then the contacts without one.
pub fn targets<const D: usize>(problem: &Problem, solved: &Solved<D>) -> Vec<Target> {
    let state = &solved.state;
    let covariance = solved.factor.faces();
    let mut centres = vec![(Point::zeros(), 0usize); state.faces.len()];
    let mut lone = Vec::new();
    for (i, label) in solved.labels.iter().enumerate() {
        let contact = problem.placed(&state.poses, i);
        match (label, contact.normal) {
            (Some(Owner::Face(face)), _) => {
                centres[*face].0 += contact.point;
                centres[*face].1 += 1;
            }
            (None, Some(normal)) => lone.push((i, contact, normal)),
            _ => {}
        }
    }
    let known = state.faces.iter().zip(centres).enumerate().map(|(j, (face, (sum, contacts)))| {
        let centroid = sum / contacts.max(1) as f64;
        Target {
            plane: faces::Face {
                normal: face.normal,
                offset: face.offset,
                centroid,
                offset_variance: face_variance(problem.dimension, state, &covariance, j, &centroid),
                normal_covariance: turning(problem.dimension, face, &covariance, j),
                contacts,
            },
            contact: None,
        }
    });
    let lone = lone.into_iter().map(|(i, contact, normal)| {
        let turns = across(problem.dimension, &normal).map(|t| t * t.transpose());
        Target {
            plane: faces::Face {
                normal,
                offset: normal.dot(&contact.point),
                centroid: contact.point,
                offset_variance: contact.point_deviation.powi(2),
                normal_covariance: (turns[0] + turns[1]) * contact.normal_deviation.powi(2),
                contacts: 1,
            },
            contact: Some(i),
        }
    });
    known.chain(lone).collect()
}

/// Covariance of a face's normal.
fn turning(
    dimension: usize,
    face: &Face,
    covariance: &DMatrix<f64>,
    number: usize,
) -> Matrix3<f64> {
    let tangents = face.tangents(dimension);
    let at = dimension * number;
    let mut sum = Matrix3::zeros();
    for a in 0..dimension - 1 {
        for b in 0..dimension - 1 {
            sum += tangents[a] * tangents[b].transpose() * covariance[(at + a, at + b)];
        }
    }
    sum
}

/// What a grasp's contacts cost at a pose.
fn cost_at(problem: &Problem, targets: &[Target], grasp: usize, pose: &Pose) -> f64 {
    let inverse = pose.inverse();
    problem
        .of(grasp)
        .map(|i| aim(problem, targets, &problem.felt[i].contact.transformed(&inverse), 1.0).1)
        .sum()
}

/// The pose near `start` at which the grasp's contacts suit the targets, held by the motion from the
/// pose `before`.
pub fn seek<const D: usize>(
    problem: &Problem,
    targets: &[Target],
    grasp: usize,
    before: &Pose,
    start: Pose,
    centre: &Point,
) -> Option<Candidate>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let chosen = axes::<D>();
    let motion = &problem.motions[grasp];
    let mut pose = start;
    for slack in SLACK {
        let mut h = SMatrix::<f64, D, D>::zeros();
        let mut g = SVector::<f64, D>::zeros();
        let step = factors::step(before, &pose, &motion.pose, motion.deviations, centre);
        let weight = problem.slip(grasp, step.residual.norm_squared()).1;
        let after = SMatrix::<f64, 6, D>::from_fn(|r, c| step.by_after[(r, chosen[c])]);
        h += after.tr_mul(&after) * weight;
        g += after.tr_mul(&step.residual) * weight;
        let inverse = pose.inverse();
        for i in problem.of(grasp) {
            let world = &problem.felt[i].contact;
            let contact = world.transformed(&inverse);
            let Some(owner) = aim(problem, targets, &contact, slack).0 else { continue };
            let Some((residual, by_pose)) = pull(problem, targets, &owner, &pose, world, slack)
            else {
                continue;
            };
            let by_pose = SMatrix::<f64, 6, D>::from_fn(|r, c| by_pose[(r, chosen[c])]);
            h += by_pose.tr_mul(&by_pose);
            g += by_pose.tr_mul(&residual);
        }
        let change = -(h.cholesky()?.solve(&g));
        let mut tangent = Tangent::zeros();
        for (i, axis) in chosen.into_iter().enumerate() {
            tangent[axis] = change[i];
        }
        pose = retract(&pose, &tangent);
    }
    let inverse = pose.inverse();
    let (mut found, mut cost) = (Vec::new(), 0.0);
    for i in problem.of(grasp) {
        let contact = problem.felt[i].contact.transformed(&inverse);
        let (target, own) = aim(problem, targets, &contact, 1.0);
        found.push(target);
        cost += own;
    }
    cost.is_finite().then_some(Candidate { pose, targets: found, cost })
}

/// The distinct poses found from all starts, the likeliest first (contacts and motion).
pub fn candidates<const D: usize>(
    problem: &Problem,
    targets: &[Target],
    grasp: usize,
    before: &Pose,
    centre: &Point,
) -> Vec<Candidate>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let motion = &problem.motions[grasp];
    let predicted = motion.pose * before;
    let axes: &[usize] = if problem.dimension == 2 { &[5] } else { &[3, 4, 5] };
    let mut starts = vec![predicted];
    for axis in axes {
        for turn in TURNS {
            let angle = (turn * motion.deviations[1]).min(std::f64::consts::PI);
            for sign in [-1.0, 1.0] {
                starts.push(turned(&predicted, *axis, sign * angle, centre));
            }
        }
    }
    let sought = |start| seek::<D>(problem, targets, grasp, before, start, centre);
    let near = starts.into_iter().filter_map(sought);
    // Faces have no ends here, along which a grasp that no motion holds would slide away.
    let is_about = |c: &Candidate| away(problem, grasp, &c.pose, centre).norm() < problem.extent;
    let carried = carried(problem, grasp, &predicted, centre).into_iter();
    let carried = carried.filter_map(sought).filter(is_about);
    let mut found: Vec<(f64, Candidate)> = Vec::new();
    for candidate in near.chain(carried) {
        let total = candidate.cost + problem.moved(grasp, before, &candidate.pose, centre);
        match found.iter_mut().find(|(_, other)| are_near(&other.pose, &candidate.pose, SAME)) {
            Some(other) if total < other.0 => *other = (total, candidate),
            Some(_) => {}
            None => found.push((total, candidate)),
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, candidate)| candidate).collect()
}

/// Poses all around of an object that is touched far from where it is `predicted`, so that somebody put it there: its
/// middle is where the contacts' is, for a hand closes about it.
fn carried(problem: &Problem, grasp: usize, predicted: &Pose, centre: &Point) -> Vec<Pose> {
    let off = away(problem, grasp, predicted, centre);
    if problem.of(grasp).is_empty() || off.norm() < ELSEWHERE * problem.extent {
        return vec![];
    }
    let there = Pose::from_parts(off.into(), Default::default()) * predicted;
    let axes: &[usize] = if problem.dimension == 2 { &[5] } else { &[3, 4, 5] };
    let part = std::f64::consts::PI / f64::from(PARTS);
    let turns = (1..2 * PARTS).map(|turn| part * f64::from(turn));
    let around = axes.iter().flat_map(|axis| turns.clone().map(move |angle| (*axis, angle)));
    let around = around.map(|(axis, angle)| turned(&there, axis, angle, centre));
    std::iter::once(there).chain(around).collect()
}

/// From the object's middle at a pose to that of a grasp's contacts, world frame.
fn away(problem: &Problem, grasp: usize, pose: &Pose, centre: &Point) -> Point {
    let middle = pose * nalgebra::Point3::from(*centre);
    problem.centre(grasp) - middle.coords
}

/// `pose` with the object turned about its centre and one of its axes (3 to 5).
fn turned(pose: &Pose, axis: usize, angle: f64, centre: &Point) -> Pose {
    let shift = Pose::from_parts((*centre).into(), Default::default());
    retract(&(pose * shift), &Tangent::ith(axis, angle)) * shift.inverse()
}

/// Labels of one grasp's contacts as a candidate has them. A contact aimed at another contact's plane
/// makes a face with it.
pub fn relabel(
    problem: &Problem,
    targets: &[Target],
    grasp: usize,
    candidate: &Candidate,
    state: &mut State,
    labels: &mut Labels,
) {
    for (i, target) in problem.of(grasp).zip(&candidate.targets) {
        labels[i] = target.map(|owner| match owner {
            Owner::Face(j) => match targets[j].contact {
                None => owner,
                Some(other) => *labels[other].get_or_insert_with(|| {
                    state.faces.push(targets[j].face());
                    Owner::Face(state.faces.len() - 1)
                }),
            },
            // Only faces have edges, and they come first.
            _ => owner,
        });
    }
}

/// A grasp, or several in a row, at another pose.
pub(super) struct Move {
    /// From which grasp to which.
    pub moved: RangeInclusive<usize>,
    /// The one at an end of them that the candidate is for; the others go along.
    grasp: usize,
    candidate: Candidate,
    /// Estimated change of the cost.
    pub change: f64,
}

/// Tries the most promising other poses; whether one lowered the cost.
pub fn restart<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> bool
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let all = targets(problem, best);
    // Those that begin and end somewhere in between are many and alike, and would leave no room for others.
    let last = best.state.poses.len().saturating_sub(1);
    let mut moves = moves(problem, best, &all, &|moved| {
        moved.start() == moved.end() || *moved.start() == 0 || *moved.end() == last
    });
    moves.sort_by(|a, b| a.change.total_cmp(&b.change));
    moves.into_iter().take(TRIED).any(|m| {
        let (state, labels) = m.made(problem, best, &all);
        attempt(problem, best, state, labels)
    })
}

/// Other poses at which a grasp, or several in a row, may have been made: it and some after it where the
/// motion from the grasp before leads, or it and all before it, to the first, where the motion to the next
/// one leads back. Of these ranges of grasps those that `is_wanted`.
pub(super) fn moves<const D: usize>(
    problem: &Problem,
    best: &Solved<D>,
    all: &[Target],
    is_wanted: &dyn Fn(&RangeInclusive<usize>) -> bool,
) -> Vec<Move>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let poses = &best.state.poses;
    let last = match poses.len() {
        // One pose is the frame, and no motion says where it was instead.
        0 | 1 => return Vec::new(),
        several => several - 1,
    };
    let mut moves = along::<D>(problem, problem, poses, all, |k| k, is_wanted);
    let back: Vec<Pose> = poses.iter().rev().copied().collect();
    let is_first = |moved: &RangeInclusive<usize>| *moved.start() == 0 && is_wanted(moved);
    moves.extend(along::<D>(problem, &problem.reversed(), &back, all, |k| last - k, &is_first));
    moves
}

/// Those of a grasp and some after it in the order of `problem`, which is the `log`'s or the other way round;
/// `told` is a grasp's number in the log.
fn along<const D: usize>(
    log: &Problem,
    problem: &Problem,
    poses: &[Pose],
    all: &[Target],
    told: impl Fn(usize) -> usize,
    is_wanted: &dyn Fn(&RangeInclusive<usize>) -> bool,
) -> Vec<Move>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let centre = problem.middle(poses);
    // Those moved along are held to faces only, as in [`Move::made`].
    let faces: Vec<Target> = all.iter().filter(|t| t.contact.is_none()).copied().collect();
    let at_faces = |k: usize, pose: &Pose| cost_at(problem, &faces, k, pose);
    let now: Vec<f64> = (0..poses.len()).map(|k| at_faces(k, &poses[k])).collect();
    let mut moves = Vec::new();
    for k in 1..poses.len() {
        if problem.of(k).is_empty() {
            continue;
        }
        // Its own contacts that no face explains are no evidence for staying.
        let felt = log.of(told(k));
        let others = all.iter().filter(|t| t.contact.is_none_or(|i| !felt.contains(&i)));
        let others: Vec<Target> = others.copied().collect();
        let stays = cost_at(problem, &others, k, &poses[k]);
        let step =
            |grasp: usize, before: &Pose, pose: &Pose| problem.moved(grasp, before, pose, &centre);
        for mut candidate in candidates::<D>(problem, &others, k, &poses[k - 1], &centre) {
            if are_near(&candidate.pose, &poses[k], SAME) {
                continue;
            }
            let mut own = candidate.cost - stays + step(k, &poses[k - 1], &candidate.pose)
                - step(k, &poses[k - 1], &poses[k]);
            let shift = poses[k].inverse() * candidate.pose;
            // Back to the numbers of all targets.
            let number = |j: usize| all.iter().position(|t| same_target(t, &others[j]));
            candidate.targets = candidate.targets.iter().map(|t| renamed((*t)?, number)).collect();
            for until in k..poses.len().min(k + TOGETHER) {
                if until > k {
                    own += at_faces(until, &(poses[until] * shift)) - now[until];
                }
                let next = poses.get(until + 1).map_or(0.0, |next| {
                    step(until + 1, &(poses[until] * shift), next)
                        - step(until + 1, &poses[until], next)
                });
                let change = own + next;
                let (grasp, until) = (told(k), told(until));
                let moved = grasp.min(until)..=grasp.max(until);
                if change < WORSE && is_wanted(&moved) {
                    moves.push(Move { moved, grasp, candidate: candidate.clone(), change });
                }
            }
        }
    }
    moves
}

impl Move {
    /// What it makes of a graph.
    pub(super) fn made<const D: usize>(
        &self,
        problem: &Problem,
        best: &Solved<D>,
        all: &[Target],
    ) -> (State, Labels) {
        let (mut state, mut labels) = (best.state.clone(), best.labels.clone());
        let poses = &best.state.poses;
        let shift = poses[self.grasp].inverse() * self.candidate.pose;
        relabel(problem, all, self.grasp, &self.candidate, &mut state, &mut labels);
        state.poses[self.grasp] = self.candidate.pose;
        for k in self.moved.clone().filter(|k| *k != self.grasp) {
            state.poses[k] = poses[k] * shift;
            for i in problem.of(k) {
                let contact = problem.placed(&state.poses, i);
                let known = &all[..best.state.faces.len()];
                labels[i] = aim(problem, known, &contact, 1.0).0;
            }
        }
        if let Some(first) = poses.first() {
            state.begin_at(first);
        }
        supported(problem, state, labels)
    }
}

fn same_target(a: &Target, b: &Target) -> bool {
    a.contact == b.contact && a.plane.normal == b.plane.normal && a.plane.offset == b.plane.offset
}

#[cfg(test)]
mod tests;
