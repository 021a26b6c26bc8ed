//! A trajectory of the graph's own: grasp by grasp, several hypotheses, each solved as a whole.
//!
//! Where the tracker lost the object, its poses are no start for anything. This search takes the same
//! grasps in the same order, but keeps the few likeliest graphs of all grasps so far, so that what an
//! early grasp means may still change when a later one tells.

use nalgebra::{Const, DimMin};

use super::alias::{candidates, relabel, targets};
use super::explain::{fitted, improve, settle};
use super::problem::{Problem, State};
use super::solve::Solved;
use super::tangent::local;
use crate::reference::Contact;
use crate::space::Pose;

/// Most grasps: every one solves all before it again.
const MOST: usize = 48;

/// Hypotheses kept, and continuations tried of each.
const KEPT: usize = 4;
const CONTINUED: usize = 3;

/// Nats behind the best at which a hypothesis is given up.
const HOPELESS: f64 = 25.0;

/// The cheapest graph found grasp by grasp, from the first pose if there is one; `None` for longer logs
/// than would be quick, or where a number is not finite.
pub fn retrack<const D: usize>(problem: &Problem, first: Option<Pose>) -> Option<Solved<D>>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    if problem.grasps() > MOST {
        return None;
    }
    let poses = problem.poses(&[first]);
    let first = State { poses: vec![*poses.first()?], faces: Vec::new(), relations: Vec::new() };
    let contacts: Vec<Option<Contact>> =
        problem.of(0).map(|i| Some(problem.placed(&first.poses, i))).collect();
    let (faces, labels) = fitted(problem.dimension, &contacts);
    let mut kept: Vec<Solved<D>> = vec![settle(problem, State { faces, ..first }, labels)?];
    for grasp in 1..problem.grasps() {
        let mut next: Vec<Solved<D>> = Vec::new();
        for hypothesis in &kept {
            let all = targets(problem, hypothesis);
            let before = *hypothesis.state.poses.last()?;
            let centre = problem.middle(&hypothesis.state.poses);
            let found = candidates::<D>(problem, &all, grasp, &before, &centre);
            for candidate in found.into_iter().take(CONTINUED) {
                let mut state = hypothesis.state.clone();
                let mut labels = hypothesis.labels.clone();
                labels.resize(problem.starts[grasp + 1], None);
                relabel(problem, &all, grasp, &candidate, &mut state, &mut labels);
                state.poses.push(candidate.pose);
                next.extend(settle::<D>(problem, state, labels));
            }
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        distinct(&mut next);
        next.truncate(KEPT);
        for hypothesis in &mut next {
            improve(problem, hypothesis);
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        distinct(&mut next);
        kept = next;
    }
    kept.into_iter().next()
}

/// The same from the last grasp to the first, which stays where it was: what early grasps leave open, late
/// ones may decide at once.
pub fn backwards<const D: usize>(problem: &Problem, first: Option<Pose>) -> Option<Solved<D>>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let first = *problem.poses(&[first]).first()?;
    let reversed = problem.reversed();
    let Solved { mut state, labels, .. } = retrack::<D>(&reversed, None)?;
    state.poses.reverse();
    state.begin_at(&first);
    let labels = (0..reversed.grasps()).rev().flat_map(|k| labels[reversed.of(k)].to_vec());
    settle(problem, state, labels.collect())
}

/// Leaves the cheapest of those that say the same, and none that is hopeless.
fn distinct<const D: usize>(sorted: &mut Vec<Solved<D>>) {
    let best = sorted.first().map_or(0.0, |s| s.cost);
    let mut kept: Vec<Solved<D>> = Vec::new();
    for one in sorted.drain(..) {
        let same = |other: &Solved<D>| {
            let apart = one.state.poses.iter().zip(&other.state.poses).map(|(a, b)| local(a, b));
            one.labels == other.labels
                || apart.fold(0.0, |worst: f64, t| {
                    worst
                        .max(t.fixed_rows::<3>(0).norm() / 2e-3)
                        .max(t.fixed_rows::<3>(3).norm() / 0.05)
                }) < 1.0
        };
        if one.cost < best + HOPELESS && !kept.iter().any(same) {
            kept.push(one);
        }
    }
    *sorted = kept;
}
