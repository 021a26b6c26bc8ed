//! Which of the alternatives hold: a few sets of poses, each with its own choice per constraint.
//!
//! For given poses every constraint takes its likeliest choice or is refused (max-mixture: Olson and
//! Agarwal, IJRR 2013), for given choices the pose graph is solved, and so on until nothing changes.
//! That descends into the nearest valley only. So each alternative of a step is also followed
//! explicitly, with all grasps behind it moved along, and what costs little more than the best stays.

use super::constraints::{Constraint, Constraints};
use super::motion::Motion;
use crate::graph::joint::tangent::local;
use crate::graph::pose::{Options, PoseGraph, optimize};
use crate::space::Pose;

/// Rounds of choosing and solving.
const ROUNDS: usize = 10;

/// Rounds of following alternatives, how many are solved in each, and by how many nats poses as they
/// were may be worse after an alternative before it is not tried.
const BRANCHINGS: usize = 3;
const TRIED: usize = 16;
const HOPELESS: f64 = 40.0;

/// Hypotheses kept, and nats behind the best at which one is given up.
const KEPT: usize = 8;
const PRUNED: f64 = 7.0;

/// Sets of poses that differ nowhere by more than this (metres, radians) are one.
const SAME: [f64; 2] = [5e-3, 0.1];

/// A set of poses and the choices that they go with.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis<G> {
    /// Grasp frames in the object's.
    pub nodes: Vec<G>,
    /// Of each step.
    pub followed: Vec<Option<usize>>,
    /// Of each pair of similar grasps; `None` where it is refused.
    pub similar: Vec<Option<usize>>,
    /// Nats.
    pub cost: f64,
}

impl<G: Motion<D>, const D: usize> Constraints<G, D> {
    /// What poses cost, and the choices.
    fn judged(&self, nodes: Vec<G>) -> Hypothesis<G> {
        let mut cost = 0.0;
        let mut choose = |all: &[Constraint<G, D>]| -> Vec<Option<usize>> {
            let one = |c: &Constraint<G, D>| {
                let (choice, own) = c.best(&nodes);
                cost += own;
                choice
            };
            all.iter().map(one).collect()
        };
        let (followed, similar) = (choose(&self.followed), choose(&self.similar));
        Hypothesis { nodes, followed, similar, cost }
    }

    /// The graph of the chosen edges.
    pub fn graph(&self, hypothesis: &Hypothesis<G>) -> PoseGraph<G, D> {
        let chosen = |all: &[Constraint<G, D>], choices: &[Option<usize>]| {
            let edges = all.iter().zip(choices).filter_map(|(c, choice)| Some(c.edge((*choice)?)));
            edges.collect::<Vec<_>>()
        };
        let mut edges = chosen(&self.followed, &hypothesis.followed);
        edges.extend(chosen(&self.similar, &hypothesis.similar));
        PoseGraph {
            ids: (0..hypothesis.nodes.len() as u64).collect(),
            poses: hypothesis.nodes.clone(),
            edges,
            fixed: vec![0],
        }
    }

    /// Chooses and solves from these poses until nothing changes; `None` where the graph cannot be
    /// solved.
    pub fn settled(&self, nodes: Vec<G>) -> Option<Hypothesis<G>> {
        let mut best = self.judged(nodes);
        for _ in 0..ROUNDS {
            let mut graph = self.graph(&best);
            optimize(&mut graph, &Options::default()).ok()?;
            let next = self.judged(graph.poses);
            let done = next.followed == best.followed && next.similar == best.similar;
            if next.cost.is_finite() && next.cost <= best.cost + 1e-9 {
                best = next;
            } else {
                break;
            }
            if done {
                break;
            }
        }
        best.cost.is_finite().then_some(best)
    }

    /// The hypotheses that explain all grasps about as well as the best, which comes first.
    pub fn hypotheses(&self, start: Vec<G>) -> Vec<Hypothesis<G>> {
        let mut kept: Vec<Hypothesis<G>> = self.settled(start).into_iter().collect();
        let mut open = kept.clone();
        for _ in 0..BRANCHINGS {
            let mut found = Vec::new();
            for from in &open {
                let mut moves = self.moves(from);
                moves.sort_by(|a, b| a.cost.total_cmp(&b.cost));
                moves.truncate(TRIED);
                found.extend(moves.into_iter().filter_map(|m| self.settled(m.nodes)));
            }
            let before = kept.clone();
            kept.extend(found);
            pruned(&mut kept);
            open = kept.iter().filter(|k| !before.iter().any(|b| alike(b, k))).cloned().collect();
            if open.is_empty() {
                break;
            }
        }
        kept
    }

    /// The poses after one step went another way: all behind it with it, or that grasp alone.
    fn moves(&self, from: &Hypothesis<G>) -> Vec<Hypothesis<G>> {
        let mut found = Vec::new();
        for (step, now) in self.followed.iter().zip(&from.followed) {
            for (number, choice) in step.choices.iter().enumerate() {
                if Some(number) == *now {
                    continue;
                }
                let edge = &choice.edge;
                let there = from.nodes[edge.from].compose(&edge.measured);
                let shift = there.compose(&from.nodes[edge.to].inverse());
                for all_after in [true, false] {
                    let mut nodes = from.nodes.clone();
                    let last = if all_after { nodes.len() } else { edge.to + 1 };
                    for node in &mut nodes[edge.to..last] {
                        *node = shift.compose(node);
                    }
                    let judged = self.judged(nodes);
                    if judged.cost < from.cost + HOPELESS {
                        found.push(judged);
                    }
                }
            }
        }
        found
    }
}

fn alike<G: Motion<D>, const D: usize>(a: &Hypothesis<G>, b: &Hypothesis<G>) -> bool {
    let apart = |(a, b): (&G, &G)| {
        let tangent = local(&a.pose(), &b.pose());
        tangent.fixed_rows::<3>(0).norm() < SAME[0] && tangent.fixed_rows::<3>(3).norm() < SAME[1]
    };
    a.nodes.iter().zip(&b.nodes).all(apart)
}

/// Sorts by cost and leaves the cheapest of those that say the same, and none that is hopeless.
fn pruned<G: Motion<D>, const D: usize>(all: &mut Vec<Hypothesis<G>>) {
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let best = all.first().map_or(0.0, |h| h.cost);
    let mut kept: Vec<Hypothesis<G>> = Vec::new();
    for one in all.drain(..) {
        if one.cost < best + PRUNED && kept.len() < KEPT && !kept.iter().any(|k| alike(k, &one)) {
            kept.push(one);
        }
    }
    *all = kept;
}

/// How much each hypothesis is believed, in their order; they sum to one.
pub fn weights<G>(all: &[Hypothesis<G>]) -> Vec<f64> {
    let best = all.first().map_or(0.0, |h| h.cost);
    let weights: Vec<f64> = all.iter().map(|h| (best - h.cost).exp()).collect();
    let total: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / total).collect()
}

/// The object's poses that a hypothesis stands for.
pub fn poses<G: Motion<D>, const D: usize>(frames: &[Pose], nodes: &[G]) -> Vec<Pose> {
    let pose = |(frame, node): (&Pose, &G)| {
        let mut pose = frame * node.pose().inverse();
        pose.rotation.renormalize();
        pose
    };
    frames.iter().zip(nodes).map(pose).collect()
}
