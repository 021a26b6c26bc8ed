//! The graph of a curved object: poses coupled through the surface of a Gaussian process.
//!
//! Curved objects have no faces to estimate beside the poses, but their contacts lie on one smooth
//! surface. So poses and surface take turns. Every grasp is matched with the surface of all other
//! grasps' contacts, never with its own (which would hold it where it is), and all poses are solved
//! together with the motions between them. A turn counts only if it makes contacts and motions
//! likelier: the process' log evidence and the motions' cost say so. Where that ends, `revise` tries single
//! grasps at other poses.

use std::ops::Range;

use nalgebra::{Matrix6, SMatrix};
use rayon::prelude::*;

use super::arrow::Arrow;
use super::factors;
use super::planes::Corrected;
use super::problem::Problem;
use super::tangent::{Tangent, axes, local, retract, six_by_six};
use crate::log::GraspLog;
use crate::reference::{Contact, Gpis};
use crate::slam::choose::only;
use crate::slam::fit::{Model, model};
use crate::slam::sift;
use crate::slam::track::Step;
use crate::space::Pose;

mod revise;
mod touch;

use touch::normal;

/// Turns of surface and poses.
const TURNS: usize = 6;

/// Iterations of the poses against surfaces that stay.
const ITERATIONS: usize = 3;

/// Nats that a turn must gain for another to be worth while.
const ENOUGH: f64 = 0.1;

/// Parts of a step that are tried.
const PARTS: [f64; 3] = [1.0, 0.4, 0.15];

/// Contacts of which a dense surface is still quick to fit once for every grasp.
const MOST: usize = 200;

/// Nats by which a wild contact is dearer than one of the surface is on average.
const WILD: f64 = 5.5;

/// Nats by which the surface from a guessed trajectory must be likelier than the one from the tracker's, which
/// knows more than the surface does: of poses that are as likely, its own stand.
const DECISIVE: f64 = 3.0;

/// Likeliest trajectories from each of which single grasps are tried elsewhere: the one that ends best at
/// times was not the likeliest before.
const REVISED: usize = 3;

/// A trajectory and what it is worth.
struct Fitted<const D: usize> {
    poses: Vec<Pose>,
    /// That explains its contacts best.
    model: Model,
    /// Which contacts the surface is made of.
    trusted: Vec<bool>,
    /// Negative log evidence of contacts, and the motions' cost.
    cost: f64,
    /// Blocks of the poses' covariance.
    covariance: Vec<SMatrix<f64, D, D>>,
}

/// The poses (object to world, one per grasp) of least cost from any of the trajectories, the first of which is
/// the tracker's, for an object with a smooth surface; those `guessed` must be likelier by a clear margin. Poses
/// that are missing or not finite are predicted from the ones before. With `search` single grasps are then tried
/// at other poses, from each of the likeliest trajectories. `None` without contacts, or when they are too many.
pub fn smooth(
    log: &GraspLog,
    trajectories: &[&[Step]],
    guessed: &[Vec<Pose>],
    search: bool,
) -> Option<Corrected> {
    let problem = Problem::new(log);
    if problem.felt.is_empty() || problem.felt.len() > MOST {
        return None;
    }
    if log.dimension == 2 {
        run::<3>(&problem, trajectories, guessed, search)
    } else {
        run::<6>(&problem, trajectories, guessed, search)
    }
}

fn run<const D: usize>(
    problem: &Problem,
    trajectories: &[&[Step]],
    guessed: &[Vec<Pose>],
    search: bool,
) -> Option<Corrected> {
    let known =
        trajectories.iter().map(|steps| (steps.iter().map(|s| Some(s.pose)).collect(), 0.0));
    let guesses = guessed.iter().map(|poses| (poses.iter().copied().map(Some).collect(), DECISIVE));
    let all: Vec<(Vec<Option<Pose>>, f64)> = known.chain(guesses).collect();
    let settled = all.into_par_iter().filter_map(|(given, handicap)| {
        Some((settle::<D>(problem, problem.poses(&given))?, handicap))
    });
    let mut settled: Vec<(Fitted<D>, f64)> = settled.collect();
    let handicapped = |(fitted, handicap): &(Fitted<D>, f64)| fitted.cost + handicap;
    settled.sort_by(|a, b| handicapped(a).total_cmp(&handicapped(b)));
    settled.truncate(if search { REVISED } else { 1 });
    if search {
        let revise = |(fitted, handicap)| (revise::revised(problem, fitted), handicap);
        settled = settled.into_par_iter().map(revise).collect();
    }
    let best = settled.into_iter().min_by(|a, b| handicapped(a).total_cmp(&handicapped(b)))?.0;
    let first = std::iter::once(Matrix6::zeros());
    let covariance: Vec<Matrix6<f64>> =
        first.chain(best.covariance.iter().map(six_by_six)).collect();
    let before = trajectories.first().copied().unwrap_or_default();
    let poses = best.poses.iter().zip(&covariance).enumerate();
    let steps = poses.map(|(k, (pose, covariance))| match before.get(k) {
        Some(before) => before.at(*pose, *covariance, problem.is_found(k, |i| best.trusted[i])),
        None => Step { covariance: *covariance, ..Step::certain(*pose) },
    });
    Some(Corrected {
        steps: steps.collect(),
        given_faces: covariance,
        faces: Vec::new(),
        owners: vec![None; problem.felt.len()],
        cost: best.cost,
        per_degree: best.model.body.misfit(),
    })
}

/// Poses and surface in turns with one model, which is then chosen anew.
fn settle<const D: usize>(problem: &Problem, poses: Vec<Pose>) -> Option<Fitted<D>> {
    let mut start = fitted::<D>(problem, poses)?;
    let mut poses = start.poses.clone();
    let mut cost = worth(problem, &start, &poses)?;
    for _ in 0..TURNS {
        let Some((target, covariance)) = matched::<D>(problem, &start, &poses) else { break };
        start.covariance = covariance;
        let shorter = PARTS.iter().find_map(|part| {
            let along = |(pose, to): (&Pose, &Pose)| retract(pose, &(local(pose, to) * *part));
            let moved: Vec<Pose> = poses.iter().zip(&target).map(along).collect();
            let lower = worth(problem, &start, &moved)?;
            (lower < cost).then_some((moved, lower))
        });
        let Some((moved, lower)) = shorter else { break };
        let gained = cost - lower;
        (poses, cost) = (moved, lower);
        if gained < ENOUGH {
            break;
        }
    }
    match fitted::<D>(problem, poses) {
        Some(end) if end.cost < start.cost => Some(Fitted { covariance: start.covariance, ..end }),
        _ => Some(start),
    }
}

/// Contacts where the poses put them.
fn placed(problem: &Problem, poses: &[Pose]) -> Vec<Contact> {
    (0..problem.felt.len()).map(|i| problem.placed(poses, i)).collect()
}

/// Cost of trusted contacts and of motions for the model that is known.
fn worth<const D: usize>(problem: &Problem, known: &Fitted<D>, poses: &[Pose]) -> Option<f64> {
    let contacts = only(&placed(problem, poses), &known.trusted);
    let surface = known.model.surface(problem.dimension, &contacts).ok()?;
    let cost = motions(problem, poses) - surface.log_marginal_likelihood();
    cost.is_finite().then_some(cost)
}

/// Cost of the motions between the poses.
fn motions(problem: &Problem, poses: &[Pose]) -> f64 {
    let centre = problem.middle(poses);
    (1..poses.len()).map(|k| problem.moved(k, &poses[k - 1], &poses[k], &centre)).sum()
}

/// The model that suits the contacts best where the poses put them, and what all of it costs.
fn fitted<const D: usize>(problem: &Problem, poses: Vec<Pose>) -> Option<Fitted<D>> {
    let placed = placed(problem, &poses);
    let trusted = sift::trusted(problem.dimension, &placed);
    let contacts = only(&placed, &trusted);
    let model = model(problem.dimension, &contacts).ok()?;
    // Wild ones are paid for as if they were on the surface, and for being wild besides.
    let felt = model.evidence_per_contact * placed.len() as f64;
    let wild = WILD * (placed.len() - contacts.len()) as f64;
    let cost = motions(problem, &poses) - felt + wild;
    let covariance = vec![SMatrix::zeros(); poses.len().saturating_sub(1)];
    cost.is_finite().then_some(Fitted { poses, model, trusted, cost, covariance })
}

/// The surface of all contacts but these; `None` where there are none of either.
fn without<const D: usize>(
    problem: &Problem,
    known: &Fitted<D>,
    placed: &[Contact],
    own: Range<usize>,
) -> Option<Gpis> {
    let is_other = |i: &usize| known.trusted[*i] && !own.contains(i);
    let others: Vec<Contact> = (0..placed.len()).filter(is_other).map(|i| placed[i]).collect();
    (!own.is_empty() && !others.is_empty())
        .then(|| known.model.surface(problem.dimension, &others).ok())?
}

/// All poses where every grasp suits the surface of the others, and their covariances.
fn matched<const D: usize>(
    problem: &Problem,
    known: &Fitted<D>,
    poses: &[Pose],
) -> Option<(Vec<Pose>, Vec<SMatrix<f64, D, D>>)> {
    let mut poses = poses.to_vec();
    let placed = placed(problem, &poses);
    let surfaces: Vec<Option<Gpis>> = (0..poses.len())
        .into_par_iter()
        .map(|k| without(problem, known, &placed, problem.of(k)))
        .collect();
    let mut covariance = Vec::new();
    for _ in 0..ITERATIONS {
        let arrow = linearise(problem, known, &poses, &surfaces);
        let factor = arrow.factor(1e-6)?;
        let (steps, _) = factor.step(&arrow)?;
        for (pose, step) in poses.iter_mut().skip(1).zip(&steps) {
            let mut tangent = Tangent::zeros();
            for (i, axis) in axes::<D>().into_iter().enumerate() {
                tangent[axis] = step[i];
            }
            *pose = retract(pose, &tangent);
        }
        covariance = factor.inverse()?.poses;
    }
    poses.iter().all(|p| p.translation.vector.norm().is_finite()).then_some((poses, covariance))
}

fn linearise<const D: usize>(
    problem: &Problem,
    known: &Fitted<D>,
    poses: &[Pose],
    surfaces: &[Option<Gpis>],
) -> Arrow<D> {
    let mut arrow = Arrow::<D>::zeros(poses.len().saturating_sub(1), 0);
    for k in 1..poses.len() {
        let Some(surface) = &surfaces[k] else { continue };
        let (square, slope) = normal(problem, surface, &contacts(problem, known, k), &poses[k]);
        arrow.diagonal[k - 1] += square;
        arrow.chain[k - 1] += slope;
    }
    let centre = problem.middle(poses);
    for k in 1..poses.len() {
        let motion = &problem.motions[k];
        let step =
            factors::step(&poses[k - 1], &poses[k], &motion.pose, motion.deviations, &centre);
        let weight = problem.slip(k, step.residual.norm_squared()).1;
        arrow.add_step(k, &step, weight);
    }
    arrow
}

/// A grasp's contacts that are trusted, world frame.
fn contacts<const D: usize>(problem: &Problem, known: &Fitted<D>, grasp: usize) -> Vec<Contact> {
    let trusted = problem.of(grasp).filter(|i| known.trusted[*i]);
    trusted.map(|i| problem.felt[i].contact).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::Deviation;
    use crate::sim::{Options, simulate};
    use crate::slam::track;
    use crate::space::Point;

    #[test]
    fn an_ellipse_pulls_displaced_grasps_together() {
        let options = Options {
            grasps: Some(7),
            motion_noise: Deviation { length: 3e-3, angle: 0.05 },
            ..Options::new("ellipse:0.12x0.06".parse().unwrap())
        };
        let log = simulate(&options).unwrap().log;
        let truth = track::truth(&log).unwrap();
        let mut steps = truth.clone();
        for (k, step) in steps.iter_mut().enumerate().skip(1) {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            let off = Tangent::new(4e-3 * sign, -3e-3 * sign, 0.0, 0.0, 0.0, 0.05 * sign);
            step.pose = retract(&step.pose, &off);
        }
        let error = |steps: &[Step]| -> f64 {
            let off = truth.iter().zip(steps).map(|(t, s)| local(&t.pose, &s.pose));
            off.map(|t| t.fixed_rows::<3>(0).norm_squared() + (0.05 * t[5]).powi(2)).sum()
        };
        let corrected = smooth(&log, &[&steps], &[], false).unwrap();
        let [before, after] = [error(&steps), error(&corrected.steps)];
        let at = |steps: &[Step]| {
            let problem = Problem::new(&log);
            fitted::<3>(&problem, steps.iter().map(|s| s.pose).collect()).unwrap().cost
        };
        assert!(after < 0.8 * before, "{before} {after}");
        // As plausible as the truth, or nearly; what is left is what contacts cannot see.
        let [displaced, true_cost] = [at(&steps), at(&truth)];
        assert!(displaced > true_cost + 100.0 && corrected.cost < true_cost + 12.0);
        assert_eq!(corrected.steps[0].pose, steps[0].pose);
        assert!(corrected.steps[3].covariance[(5, 5)] > 0.0);
        // Guesses of any length, and of no numbers.
        let nan = Pose::translation(f64::NAN, 0.0, 0.0);
        let guesses = [vec![], vec![Pose::identity(); 40], vec![nan; 7]];
        let steps = smooth(&log, &[&steps], &guesses, false).unwrap().steps;
        assert!(steps.len() == 7 && steps.iter().all(|s| s.pose.translation.vector.norm() < 1.0));
        let none = GraspLog { grasps: Vec::new(), ..log };
        assert!(smooth(&none, &[&[]], &[], true).is_none());
    }

    #[test]
    fn what_is_not_trusted_does_not_pull() {
        let options = Options::new("ellipse:0.12x0.06".parse().unwrap());
        let mut log = simulate(&options).unwrap().log;
        log.grasps[3].contacts[1].point += Point::new(0.03, -0.05, 0.0);
        let problem = Problem::new(&log);
        let poses = track::truth(&log).unwrap().iter().map(|s| s.pose).collect();
        let known = fitted::<3>(&problem, poses).unwrap();
        assert!(!known.trusted[problem.starts[3] + 1]);
        assert_eq!(contacts(&problem, &known, 3).len(), log.grasps[3].contacts.len() - 1);
        assert_eq!(contacts(&problem, &known, 4).len(), log.grasps[4].contacts.len());
    }
}
