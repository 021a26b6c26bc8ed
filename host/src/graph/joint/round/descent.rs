//! From a hypothesis to the likeliest one near it: one pose alone, or all poses and the body together.

use nalgebra::{Const, DVector, Dyn, OMatrix, SMatrix};

use super::body::{Field, ROUGH, Residual, Round, SHAPE};
use super::{Followed, Hypothesis};
use crate::graph::joint::arrow::{Arrow, Row};
use crate::graph::joint::factors;
use crate::graph::joint::lone::{Between, displaced, least};
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::{Tangent, axes, retract, six_by_six};
use crate::reference::Contact;
use crate::space::Pose;

/// Difference of a number for its slope, in metres, radians or parts of a radius.
const NUDGE: f64 = 1e-6;

/// What a contact costs, which is of the body or wild.
pub(super) struct Touched {
    /// Nats, about zero for one that fits exactly, with normals as exact as they usually are.
    pub(super) cost: f64,
    /// Of it, what its residual would cost if it were of the body.
    pub(super) misfit: f64,
    /// Of its distance and its normal, in least squares of the same gradient.
    weights: [f64; 2],
}

/// The cost of a residual of this contact, `bounded` by the contact's being wild. Without that, what is far
/// off still pulls, as it should on the way to what is not yet known.
fn touched(
    problem: &Problem,
    field: &Field<'_>,
    contact: &Contact,
    residual: &Residual,
    bounded: bool,
) -> Touched {
    let off = problem.kernel.cost(residual[0].powi(2) + residual[4].powi(2));
    let turned = problem.kernel.cost(residual.fixed_rows::<3>(1).norm_squared());
    let misfit = off.0 + turned.0 + 0.5 * residual[5].powi(2);
    let [contact, usual] = field.widened(contact);
    let on = misfit + problem.exact(&contact);
    let (cost, chance) = if bounded { problem.or_wild(&contact, on) } else { (on, 1.0) };
    let weights = [off.1, turned.1].map(|weight| (chance * weight).sqrt());
    Touched { cost: cost - problem.exact(&usual), misfit, weights }
}

fn weighted<const C: usize>(mut rows: SMatrix<f64, 6, C>, weights: [f64; 2]) -> SMatrix<f64, 6, C> {
    for r in 0..6 {
        rows.row_mut(r).scale_mut(weights[usize::from((1..4).contains(&r))]);
    }
    rows
}

/// Residual of a contact by the tangent of its pose.
fn by_pose<const D: usize>(
    field: &Field<'_>,
    felt: &Contact,
    pose: &Pose,
    at: &Residual,
) -> SMatrix<f64, 6, D> {
    let mut rows = SMatrix::<f64, 6, D>::zeros();
    for (column, axis) in axes::<D>().into_iter().enumerate() {
        let mut tangent = Tangent::zeros();
        tangent[axis] = NUDGE;
        let moved = felt.transformed(&retract(pose, &tangent).inverse());
        rows.set_column(column, &((field.residual(&moved) - at) / NUDGE));
    }
    rows
}

/// A grasp's pose of least cost from `start` on, the body and all other poses as they are; with its
/// cost. The grasp may be the one after the hypothesis' last.
pub(super) fn alone<const D: usize>(
    problem: &Problem,
    one: &Hypothesis,
    grasp: usize,
    start: Pose,
) -> Option<(f64, Pose)> {
    let field = one.body.field(one.ball.1)?;
    let between = Between::new(problem, &one.poses, grasp)?;
    let felt = |i: usize| &problem.felt[i].contact;
    let from = |start: Pose, bounded: bool| {
        let cost = |pose: &Pose| {
            let inverse = pose.inverse();
            let contact = |i: usize| {
                let placed = felt(i).transformed(&inverse);
                touched(problem, &field, &placed, &field.residual(&placed), bounded).cost
            };
            problem.of(grasp).map(contact).sum::<f64>() + between.cost(pose)
        };
        let normal = |pose: &Pose| {
            let (mut square, mut slope) = between.normal::<D>(pose);
            let inverse = pose.inverse();
            for i in problem.of(grasp) {
                let placed = felt(i).transformed(&inverse);
                let residual = field.residual(&placed);
                let Touched { weights, .. } = touched(problem, &field, &placed, &residual, bounded);
                let rows = weighted(by_pose::<D>(&field, felt(i), pose, &residual), weights);
                square += rows.tr_mul(&rows);
                slope += rows.tr_mul(&weighted(residual, weights));
            }
            (square, slope)
        };
        least(start, cost, normal)
    };
    from(from(start, false)?.1, true)
}

/// What so many numbers of a body cost that so many grasps felt, nats (Bayesian information criterion).
pub(super) fn price(problem: &Problem, grasps: usize, numbers: usize) -> f64 {
    let measured = problem.measured(problem.starts[grasps]) as f64;
    0.5 * numbers as f64 * measured.ln()
}

/// What every contact costs; none where the body is none.
pub(super) fn touches(problem: &Problem, one: &Hypothesis) -> Vec<Touched> {
    let Some(field) = one.body.field(one.ball.1) else { return Vec::new() };
    let touched = |i| {
        let placed = problem.placed(&one.poses, i);
        touched(problem, &field, &placed, &field.residual(&placed), one.bounded)
    };
    (0..problem.starts[one.poses.len()]).map(touched).collect()
}

/// Nats from which on a contact is not explained: four deviations, by distance or normal.
const WILD: f64 = 5.5;

/// Share of the contacts that it does not explain.
pub(super) fn wild(problem: &Problem, one: &Hypothesis) -> f64 {
    share_wild(&touches(problem, one))
}

fn is_wild(touched: &Touched) -> bool {
    !(touched.misfit < WILD)
}

fn share_wild(touches: &[Touched]) -> f64 {
    let wild = touches.iter().filter(|touched| is_wild(touched)).count();
    wild as f64 / touches.len().max(1) as f64
}

/// A hypothesis of the whole log with its covariances, and how well it explains the contacts; `None`
/// where those are not finite.
pub(super) fn followed<const D: usize>(problem: &Problem, one: &Hypothesis) -> Option<Followed> {
    let touches = touches(problem, one);
    let (mut misfit, mut measured) = (0.0, 0);
    for (touched, felt) in touches.iter().zip(&problem.felt).filter(|(t, _)| !is_wild(t)) {
        misfit += touched.misfit;
        measured += problem.numbers(&felt.contact);
    }
    let field = one.body.field(one.ball.1)?;
    let centre = problem.middle(&one.poses);
    let mut degrees = measured as f64 - one.body.freedom(problem.dimension) as f64;
    for k in 1..one.poses.len() {
        let felt = || {
            let felt = problem.of(k).filter(|i| !is_wild(&touches[*i])).map(|i| {
                let (felt, pose) = (&problem.felt[i].contact, &one.poses[k]);
                let residual = field.residual(&felt.transformed(&pose.inverse()));
                let rows =
                    weighted(by_pose::<D>(&field, felt, pose, &residual), touches[i].weights);
                rows.tr_mul(&rows)
            });
            felt.sum()
        };
        let (slipped, spent) = problem.told::<D>(k, &one.poses, &centre, felt);
        misfit += 0.5 * slipped;
        degrees -= spent;
    }
    let inverse = linearise::<D>(problem, one)?.factor(0.0)?.inverse()?;
    let blocks = |all: &[SMatrix<f64, D, D>]| all.iter().map(six_by_six).collect();
    // Other models' costs begin at contacts that are as exact as they say.
    let widening = |c: &Contact| problem.exact(&field.widened(c)[1]) - problem.exact(c);
    let widened: f64 = problem.felt.iter().map(|felt| widening(&felt.contact)).sum();
    Some(Followed {
        poses: one.poses.clone(),
        cost: one.cost + widened,
        explained: touches.iter().map(|touched| !is_wild(touched)).collect(),
        wild: share_wild(&touches),
        per_degree: 2.0 * misfit / degrees.max(1.0),
        round: one.body.is_round(one.ball.1),
        rough: one.body.rough > ROUGH[0],
        superquadric: one.body.is_superquadric(),
        covariance: blocks(&inverse.poses),
        given_body: blocks(&inverse.given_faces),
    })
}

/// With normals as exact as is likeliest, and what all of it costs then.
fn roughened(problem: &Problem, one: &mut Hypothesis) -> Option<f64> {
    let tried = ROUGH.into_iter().filter_map(|rough| {
        let body = Round { rough, ..one.body.clone() };
        Some((cost(problem, one, &one.poses, &body)?, rough))
    });
    let (least, rough) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    one.body.rough = rough;
    Some(least)
}

/// What a hypothesis costs at these poses and with this body.
fn cost(problem: &Problem, one: &Hypothesis, poses: &[Pose], body: &Round) -> Option<f64> {
    let field = body.field(one.ball.1)?;
    let inverses: Vec<Pose> = poses.iter().map(Pose::inverse).collect();
    let count = problem.starts[poses.len()];
    let contacts: f64 = problem.felt[..count]
        .iter()
        .map(|felt| {
            let placed = felt.contact.transformed(&inverses[felt.grasp]);
            touched(problem, &field, &placed, &field.residual(&placed), one.bounded).cost
        })
        .sum();
    let centre = problem.middle(poses);
    let motions: f64 =
        (1..poses.len()).map(|k| problem.moved(k, &poses[k - 1], &poses[k], &centre)).sum();
    let price = price(problem, poses.len(), body.freedom(problem.dimension));
    let oddity = 0.5 * body.oddity(problem.dimension, &one.ball).norm_squared();
    let total = contacts + motions + oddity + price;
    total.is_finite().then_some(total)
}

/// What a descent may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    /// All poses but the first, and the body.
    All,
    /// The body alone.
    Body,
}

/// Poses and body of least cost, by Levenberg–Marquardt.
pub(super) fn descend<const D: usize>(
    problem: &Problem,
    one: &mut Hypothesis,
    steps: usize,
    free: Free,
) {
    let Some(mut least) = roughened(problem, one) else {
        one.cost = f64::INFINITY;
        return;
    };
    let mut damping = 1e-3;
    for _ in 0..steps {
        let Some(mut arrow) = linearise::<D>(problem, one) else { break };
        if free == Free::Body {
            arrow.chain.iter_mut().for_each(|slope| slope.fill(0.0));
            arrow.border.iter_mut().for_each(|rows| rows.fill(0.0));
        }
        let mut gained = 0.0;
        for _ in 0..5 {
            let tried = arrow.factor(damping).and_then(|factor| {
                let (turns, numbers) = factor.step(&arrow)?;
                let body = one.body.nudged(problem.dimension, one.ball.1, &numbers);
                let mut poses = one.poses.clone();
                for (pose, step) in poses.iter_mut().skip(1).zip(&turns) {
                    *pose = displaced(pose, step);
                }
                let lower = cost(problem, one, &poses, &body)?;
                (lower < least).then_some((lower, poses, body))
            });
            if let Some((lower, poses, body)) = tried {
                gained = least - lower;
                (least, one.poses, one.body) = (lower, poses, body);
                damping = (0.2 * damping).max(1e-9);
                break;
            }
            damping *= 8.0;
        }
        if gained < 1e-2 {
            break;
        }
    }
    one.cost = least;
}

fn linearise<const D: usize>(problem: &Problem, one: &Hypothesis) -> Option<Arrow<D>> {
    let (dimension, radius) = (problem.dimension, one.ball.1);
    let width = one.body.width(dimension);
    let mut arrow = Arrow::<D>::zeros(one.poses.len() - 1, width);
    let field = one.body.field(one.ball.1)?;
    let nudged: Vec<Round> = (0..width)
        .map(|j| {
            let mut by = DVector::zeros(width);
            by[j] = NUDGE;
            one.body.nudged(dimension, radius, &by)
        })
        .collect();
    let fields: Vec<Field<'_>> =
        nudged.iter().map(|body| body.field(radius)).collect::<Option<_>>()?;
    for felt in &problem.felt[..problem.starts[one.poses.len()]] {
        let pose = &one.poses[felt.grasp];
        let placed = felt.contact.transformed(&pose.inverse());
        let residual = field.residual(&placed);
        let Touched { weights, .. } = touched(problem, &field, &placed, &residual, one.bounded);
        let mut by_body = OMatrix::<f64, Const<6>, Dyn>::zeros(width);
        for (j, other) in fields.iter().enumerate() {
            by_body.set_column(j, &weighted((other.residual(&placed) - residual) / NUDGE, weights));
        }
        let target = weighted(residual, weights);
        arrow.corner.gemm_tr(1.0, &by_body, &by_body, 1.0);
        arrow.rest.gemv_tr(1.0, &by_body, &target, 1.0);
        if felt.grasp > 0 {
            let k = felt.grasp - 1;
            let rows = weighted(by_pose::<D>(&field, &felt.contact, pose, &residual), weights);
            arrow.diagonal[k] += rows.tr_mul(&rows);
            arrow.chain[k] += rows.tr_mul(&target);
            let coupled: Row<D> = rows.transpose() * &by_body;
            arrow.border[k] += coupled;
        }
    }
    let oddity = one.body.oddity(dimension, &one.ball);
    for j in 0..width {
        // What nobody feels may change as it likes, slowly.
        arrow.corner[(j, j)] += if one.body.is_drawn(dimension, j) { SHAPE.powi(-2) } else { 1.0 };
        arrow.rest[j] += oddity[j] / SHAPE;
    }
    let centre = problem.middle(&one.poses);
    for k in 1..one.poses.len() {
        let motion = &problem.motions[k];
        let step = factors::step(
            &one.poses[k - 1],
            &one.poses[k],
            &motion.pose,
            motion.deviations,
            &centre,
        );
        let weight = problem.slip(k, step.residual.norm_squared()).1;
        arrow.add_step(k, &step, weight);
    }
    Some(arrow)
}
