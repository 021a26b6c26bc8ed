//! The graph's edges: what is known of the relative poses of two grasps, with all its alternatives.
//!
//! A node is the frame of a grasp (at the middle of its contacts, axes along the world's) in the
//! object's frame: y = x⁻¹ C for the object's pose x. Two grasps that felt the same faces then measure
//! y_i⁻¹ y_j whatever the object's pose.

use nalgebra::{Matrix6, Point3, Vector6};
use tactile_core::track::Status;

use super::alternatives::{Allowed, Alternative, alternatives, labelled};
use super::motion::{Motion, adjoint, carried};
use super::similarity::{Similar, Touched};
use crate::graph::joint::factors;
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::are_near;
use crate::graph::pose::Edge;
use crate::slam::track::Step;
use crate::space::{Pose, centroid};

/// Deviations within which an alternative may lie from what the motions say.
const REACH: f64 = 4.0;

/// How far beyond that a rotation about the object's middle moves the middle of a grasp, metres; farther where
/// the grasp is far from it.
const LEVER: f64 = 0.05;

/// Least deviations of a tracker's step, metres and radians: it counts what it cannot see as none.
const LEAST: [f64; 2] = [2e-4, 4e-3];

/// Relative poses nearer than this (metres, radians) are one.
const SAME: [f64; 2] = [0.01, 0.2];

/// Nats for a pose that a tracker does not hold possible which is sure of another: it knows the whole
/// shape, two grasps do not. It would have said so of a twentieth.
const DISMISSED: f64 = 3.0;

/// Nats above its best fit at which two grasps are held not to have felt the same faces: χ² of three
/// degrees of freedom exceeds twice that once in a thousand.
const REFUSED: f64 = 8.0;

/// Pairs tried for each constraint that there may be: in a long log of contacts that fit nowhere there is no
/// end of them.
const TRIED: usize = 4;

/// One relative pose that two grasps may have.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice<G, const D: usize> {
    /// Where it is, and how surely.
    pub edge: Edge<G, D>,
    /// Nats by which it is less likely than the best, before any other grasp is asked.
    pub cost: f64,
}

/// What two grasps know of each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint<G, const D: usize> {
    /// At least one.
    pub choices: Vec<Choice<G, D>>,
    /// Nats for believing none of them; infinite where the graph needs the edge to hang together.
    pub refused: f64,
    /// Part by which it counts, because others use the same contacts.
    pub weight: f64,
}

impl<G: Motion<D>, const D: usize> Constraint<G, D> {
    /// The likeliest choice at these nodes and what it costs; no choice where refusing costs less.
    pub fn best(&self, nodes: &[G]) -> (Option<usize>, f64) {
        let mut best = (None, self.weight * self.refused);
        for (number, choice) in self.choices.iter().enumerate() {
            let cost = self.weight * (0.5 * choice.edge.chi2(nodes) + choice.cost);
            if cost < best.1 || best.1.is_infinite() {
                best = (Some(number), cost);
            }
        }
        best
    }

    /// A choice as the optimiser takes it.
    pub fn edge(&self, choice: usize) -> Edge<G, D> {
        let edge = &self.choices[choice].edge;
        Edge { information: edge.information * self.weight, ..edge.clone() }
    }
}

/// How grasps are made into constraints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Pairwise constraints at most.
    pub most: usize,
    /// As the thesis has it: one relative pose per pair, by the segmentation, believed whatever it
    /// says and as if its contacts were used once.
    pub as_printed: bool,
}

/// The graph before it is solved.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraints<G, const D: usize> {
    /// The frame of each grasp, grasp to world.
    pub frames: Vec<Pose>,
    /// From each grasp to the next, as the tracker has it.
    pub followed: Vec<Constraint<G, D>>,
    /// Between similar grasps.
    pub similar: Vec<Constraint<G, D>>,
}

/// Grasps and what the front end makes of them.
pub struct Front<'a> {
    /// The log's measurements.
    pub problem: &'a Problem,
    /// The tracker's steps, of which status and modes are used.
    pub steps: &'a [Step],
    /// The poses the graph starts from, object to world.
    pub poses: &'a [Pose],
    /// The tracker's.
    pub tracked: &'a [Pose],
    /// Covariance of each, where the tracker corrected the pose.
    pub covariances: &'a [Option<Matrix6<f64>>],
    /// Contacts in their grasp's frame with their faces.
    pub touched: &'a [Touched],
    /// Grasp to world.
    pub frames: &'a [Pose],
    /// Pairs of grasps that share faces.
    pub similar: &'a [Similar],
}

impl Front<'_> {
    /// The nodes at the poses to start from.
    pub fn nodes<G: Motion<D>, const D: usize>(&self) -> Vec<G> {
        self.poses.iter().zip(self.frames).map(|(x, c)| G::of(&(x.inverse() * c))).collect()
    }

    /// All constraints.
    pub fn constraints<G: Motion<D>, const D: usize>(&self, rules: Rules) -> Constraints<G, D> {
        let mut similar: Vec<Constraint<G, D>> = Vec::new();
        for pair in scattered(self.similar, rules.most) {
            if similar.len() == rules.most {
                break;
            }
            similar.extend(self.between(pair, rules.as_printed));
        }
        if !rules.as_printed {
            share(self.poses.len(), &mut similar);
        }
        let followed = (1..self.poses.len()).filter_map(|k| self.step(k, rules.as_printed));
        Constraints { frames: self.frames.to_vec(), followed: followed.collect(), similar }
    }

    /// Grasp frame j in grasp frame i by poses of the object.
    fn relative(&self, i: usize, from: &Pose, j: usize, to: &Pose) -> Pose {
        self.frames[i].inverse() * from * to.inverse() * self.frames[j]
    }

    /// Two similar grasps; `None` where their contacts fit at no relative pose.
    fn between<G: Motion<D>, const D: usize>(
        &self,
        pair: &Similar,
        as_printed: bool,
    ) -> Option<Constraint<G, D>> {
        let [i, j] = pair.grasps;
        let (a, b) = (&self.touched[i], &self.touched[j]);
        let guess = self.relative(i, &self.poses[i], j, &self.poses[j]);
        let dimension = self.problem.dimension;
        if as_printed {
            let found = labelled(dimension, a, b, &pair.faces, &guess).ok()?;
            let choice = choice([i, j], &found.pose, &found.covariance, 0.0)?;
            return Some(Constraint { choices: vec![choice], refused: f64::INFINITY, weight: 1.0 });
        }
        // The tracker may have gone as far astray one way as the object the other.
        let Allowed { translation, rotation } = self.allowed(i, j, &self.poses[j]);
        let allowed = Allowed { translation: 2.0 * translation, rotation: 2.0 * rotation };
        let found = alternatives(dimension, a, b, &guess, &allowed);
        let least = least(&found);
        let choices: Vec<Choice<G, D>> = found
            .iter()
            .filter_map(|f| {
                let r = &f.registered;
                choice([i, j], &r.pose, &r.covariance, 0.5 * (r.chi2 - least))
            })
            .collect();
        (!choices.is_empty()).then_some(Constraint { choices, refused: REFUSED, weight: 1.0 })
    }

    /// How far the motions between two grasps may have gone astray, the second of them made near `pose`.
    fn allowed(&self, i: usize, j: usize, pose: &Pose) -> Allowed {
        let (mut shift, mut turn) = (0.0, 0.0);
        for motion in &self.problem.motions[i + 1..=j] {
            shift += motion.deviations[0].powi(2);
            turn += motion.deviations[1].powi(2);
        }
        let rotation = REACH * turn.sqrt();
        let middle = Point3::from(self.problem.middle(self.poses));
        let lever = (self.frames[j].translation.vector - (pose * middle).coords).norm();
        // Half a turn moves it to the other side.
        let turned = rotation.min(2.0) * lever;
        Allowed { translation: REACH * shift.sqrt() + turned.max(LEVER), rotation }
    }

    /// From a grasp to the next: the tracker's step, and whatever else explains both grasps.
    fn step<G: Motion<D>, const D: usize>(
        &self,
        k: usize,
        as_printed: bool,
    ) -> Option<Constraint<G, D>> {
        let (before, after) = (self.tracked[k - 1], self.tracked[k]);
        let motion = &self.problem.motions[k];
        let predicted = motion.pose * before;
        let centre = self.problem.middle(self.poses);
        // What the motion costs that takes the object to a pose.
        let astray = |to: &Pose| {
            let step = factors::step(&before, to, &motion.pose, motion.deviations, &centre);
            self.problem.slip(k, step.residual.norm_squared()).0
        };
        let moved = |to: &Pose| self.relative(k - 1, &before, k, to);
        let pair = [k - 1, k];
        let mut poses = Vec::new();
        let (followed, covariance) = match &self.covariances[k] {
            Some(known) => (after, *known),
            // Nobody saw where it went: the motion alone.
            None => {
                let [shift, turn] = motion.deviations.map(|d| d * d);
                let spread =
                    Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn));
                let about = Pose::from_parts(centre.into(), Default::default());
                (predicted, carried(&spread, &adjoint(&about)))
            }
        };
        // Seen from the grasp: y Exp(−Ad(y⁻¹) δ) for x Exp(δ).
        let node = followed.inverse() * self.frames[k];
        let seen = carried(&covariance, &adjoint(&node.inverse()));
        let mut choices: Vec<Choice<G, D>> = Vec::new();
        choices.extend(choice(pair, &moved(&followed), &seen, astray(&followed)));
        poses.push(moved(&followed));
        if !as_printed {
            let modes = self.steps.get(k).map_or(&[][..], |s| &s.modes[..]);
            let own = modes.iter().map(|m| m.1).fold(0.0, f64::max).max(1e-9);
            for (pose, weight) in modes {
                let to = moved(pose);
                if poses.iter().all(|p| !are_near(p, &to, SAME)) && *weight > 0.0 && finite(&to) {
                    let cost = astray(&followed) - (weight / own).min(1.0).ln();
                    choices.extend(choice(pair, &to, &seen, cost));
                    poses.push(to);
                }
            }
            let guess = moved(&predicted);
            let (a, b) = (&self.touched[k - 1], &self.touched[k]);
            let allowed = self.allowed(k - 1, k, &predicted);
            let found = alternatives(self.problem.dimension, a, b, &guess, &allowed);
            let least = least(&found);
            let sure = self.steps.get(k).is_some_and(|s| s.status == Status::Tracking);
            let dismissed = if sure && self.covariances[k].is_some() { DISMISSED } else { 0.0 };
            for other in &found {
                let r = &other.registered;
                if poses.iter().all(|p| !are_near(p, &r.pose, SAME)) {
                    // The object's pose after that step.
                    let to =
                        self.frames[k] * r.pose.inverse() * self.frames[k - 1].inverse() * before;
                    let cost = astray(&to) + 0.5 * (r.chi2 - least) + dismissed;
                    choices.extend(choice(pair, &r.pose, &r.covariance, cost));
                    poses.push(r.pose);
                }
            }
        }
        (!choices.is_empty()).then_some(Constraint { choices, refused: f64::INFINITY, weight: 1.0 })
    }
}

fn finite(pose: &Pose) -> bool {
    pose.to_homogeneous().iter().all(|v| v.is_finite())
}

fn least(found: &[Alternative]) -> f64 {
    found.iter().map(|f| f.registered.chi2).fold(f64::INFINITY, f64::min)
}

/// A relative pose as an edge; `None` where its covariance is of no use.
fn choice<G: Motion<D>, const D: usize>(
    [from, to]: [usize; 2],
    measured: &Pose,
    covariance: &Matrix6<f64>,
    cost: f64,
) -> Option<Choice<G, D>> {
    let [shift, turn] = LEAST.map(|d| d * d);
    let floor = Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn));
    let information = G::information(&(covariance + floor))?;
    let measured = G::of(measured);
    let edge = Edge { from, to, measured, information };
    (measured.is_finite() && cost.is_finite()).then_some(Choice { edge, cost })
}

/// The pairs that share most faces first, and among these in an order that takes near and far ones as
/// they come: as many as are tried for at most so many constraints.
fn scattered(similar: &[Similar], most: usize) -> Vec<&Similar> {
    let mixed = |pair: &Similar| {
        let [i, j] = pair.grasps.map(|g| g as u64);
        (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ j.wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
            .wrapping_mul(0xd6e8_feb8_6659_fd93)
            >> 20
    };
    let mut order: Vec<&Similar> = similar.iter().collect();
    order.sort_by_key(|pair| (usize::MAX - pair.faces.len(), mixed(pair), pair.grasps));
    order.truncate(most.saturating_mul(TRIED));
    order
}

/// Divides what contacts say among the constraints that use them. Among n grasps of the same faces
/// there are n (n − 1)/2 pairs, but only n measurements: with 2/n each, their sum is exactly what the
/// n say of their common mean.
fn share<G, const D: usize>(grasps: usize, similar: &mut [Constraint<G, D>]) {
    let mut uses = vec![0.0; grasps];
    let ends = |c: &Constraint<G, D>| c.choices.first().map(|c| [c.edge.from, c.edge.to]);
    for [from, to] in similar.iter().filter_map(ends) {
        uses[from] += 1.0;
        uses[to] += 1.0;
    }
    for constraint in similar {
        if let Some([from, to]) = ends(constraint) {
            let both: f64 = (uses[from] + 1.0) * (uses[to] + 1.0);
            constraint.weight = 2.0 / both.sqrt();
        }
    }
}

/// The frame of each grasp: at the middle of its contacts, or of the object where it has none.
pub fn frames(problem: &Problem, poses: &[Pose]) -> Vec<Pose> {
    let centre = |k: usize| {
        let own = problem.of(k);
        if own.is_empty() {
            return poses[k].translation.vector;
        }
        centroid(problem.felt[own].iter().map(|f| f.contact.point))
    };
    (0..poses.len()).map(|k| Pose::from_parts(centre(k).into(), Default::default())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};

    #[test]
    fn no_more_pairs_are_tried_than_there_may_be_constraints_for() {
        let pair = |k: usize| Similar { grasps: [k, k + 1], faces: vec![0; 3 + k % 3] };
        let pairs: Vec<Similar> = (0..100).map(pair).collect();
        assert_eq!(scattered(&pairs, usize::MAX).len(), 100);
        let tried = scattered(&pairs, 5);
        assert_eq!(tried.len(), 5 * TRIED);
        assert!(tried.iter().all(|pair| pair.faces.len() == 5));
    }

    #[test]
    fn a_turn_moves_grasps_by_how_far_they_are_from_the_middle() {
        let log = simulate(&Options::new("rectangle:0.10x0.06".parse().unwrap())).unwrap().log;
        let problem = Problem::new(&log);
        let poses: Vec<Pose> = log.grasps.iter().map(|g| g.truth.unwrap()).collect();
        let mut frames = frames(&problem, &poses);
        frames[4].translation.vector.x += 2.0;
        let front = Front {
            problem: &problem,
            steps: &[],
            poses: &poses,
            tracked: &poses,
            covariances: &[],
            touched: &[],
            frames: &frames,
            similar: &[],
        };
        let [near, far] = [3, 4].map(|j| front.allowed(j - 1, j, &poses[j]));
        let usual = REACH * problem.motions[3].deviations[0] + LEVER;
        assert!((near.translation - usual).abs() < 1e-9, "{near:?}");
        let beyond = far.translation - near.translation;
        assert!(beyond > 1.8 * far.rotation.min(2.0) - LEVER, "{near:?} {far:?}");
    }
}
