//! Grasps whose contacts hang in the air are made elsewhere.
//!
//! Endless planes explain a contact wherever it lies along them, so that a grasp on the wrong one of
//! several parallel faces costs hardly more than on the right one. Where faces end tells them apart, and
//! with it the whole cost: here poses at which single grasps, or several in a row, may have been made
//! instead are tried and judged by all of it, where [`restart`](super::alias::restart) asks the planes
//! alone. The steepest descent over such moves.

use nalgebra::{Const, DimMin};
use rayon::prelude::*;

use super::alias::{moves, targets};
use super::explain::settle;
use super::planes::{Corrected, corrected};
use super::problem::Problem;
use super::regular::regular;
use super::solve::Solved;
use crate::slam::track::Step;

/// Moves made at most, and tried for each.
const ROUNDS: usize = 8;
const TRIED: usize = 12;

/// Nats that hang in the air from which on other poses are sought.
const HANGING: f64 = 3.0;

/// A move must spare so many nats.
const LEAST: f64 = 0.1;

/// A graph with its faces as a whole object.
pub(super) struct Seated<const D: usize> {
    /// With endless faces.
    pub solved: Solved<D>,
    /// What is made of it.
    pub corrected: Corrected,
    /// As [`super::confine::Confined::hanging`].
    pub hanging: Vec<f64>,
}

impl<const D: usize> Seated<D> {
    /// Whether next to nothing that was felt contradicts the object.
    pub fn is_sound(&self) -> bool {
        self.hanging.iter().sum::<f64>() < HANGING
    }
}

/// The whole object of a graph (and of `others`, where it is open how its faces lie to each other), with
/// grasps elsewhere for as long as that makes all of it cheaper; `None` where a covariance does not exist.
pub(super) fn seated<const D: usize>(
    problem: &Problem,
    solved: Solved<D>,
    others: &[Solved<D>],
    steps: &[Step],
) -> Option<Seated<D>>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let mut best = corrected(problem, solved, others, steps)?;
    for _ in 0..ROUNDS {
        if best.is_sound() {
            break;
        }
        match elsewhere(problem, &best, steps) {
            Some(next) if next.corrected.cost < best.corrected.cost - LEAST => best = next,
            _ => break,
        }
    }
    Some(best)
}

/// The cheapest that comes of the most promising moves.
fn elsewhere<const D: usize>(
    problem: &Problem,
    best: &Seated<D>,
    steps: &[Step],
) -> Option<Seated<D>>
where
    Const<D>: DimMin<Const<D>, Output = Const<D>>,
{
    let all = targets(problem, &best.solved);
    let mut moves = moves(problem, &best.solved, &all, &|_| true);
    for one in &mut moves {
        // At best nothing of the grasps hangs in the air afterwards.
        one.change -= best.hanging[one.moved.clone()].iter().sum::<f64>();
    }
    moves.sort_by(|a, b| a.change.total_cmp(&b.change));
    moves.truncate(TRIED);
    let made: Vec<Seated<D>> = moves
        .par_iter()
        .filter_map(|one| {
            let (mut state, labels) = one.made(problem, &best.solved, &all);
            state.relations.clear();
            let mut solved = settle(problem, state, labels)?;
            let others = regular(problem, &mut solved);
            corrected(problem, solved, &others, steps)
        })
        .collect();
    made.into_iter().min_by(|a, b| a.corrected.cost.total_cmp(&b.corrected.cost))
}

#[cfg(test)]
mod tests;
