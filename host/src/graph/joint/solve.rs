//! Levenberg–Marquardt over poses and faces for given labels, and what the optimum is worth.

use nalgebra::{DMatrix, Matrix6x3};

use super::arrow::{Arrow, Factor};
use super::factors;
use super::problem::{Labels, Problem, State};
use super::relation::Relation;
use super::ridge::{FINGERTIP, Ridge, named};
use super::size;
use super::tangent::{Tangent, axes, retract};
use crate::model::faces::Owner;
use crate::reference::Contact;
use crate::space::Point;

/// Most iterations.
const ITERATIONS: usize = 40;

/// Descents with the centre about which objects slip where it then is, and how far it may move without
/// another, metres.
const PASSES: usize = 3;
const STILL: f64 = 1e-4;

/// Nats by which an iteration must lower the cost for another to be worth while.
pub(super) const ENOUGH: f64 = 1e-5;

/// The same where it need only be known about where the cost ends.
const ROUGHLY: f64 = 0.1;

/// Damping at first, and beyond which nothing lowers the cost any more.
const DAMPING: (f64, f64) = (1e-4, 1e9);

/// A contact outside a face that is not its own speaks against convexity: this share of half its
/// squared deviations, up to so many of these.
const OUTSIDE: (f64, f64) = (0.4, 9.0);

/// What it costs that an object is not convex, nats.
const CONCAVE: f64 = 12.0;

/// Nats that a contact costs on an edge of faces that became parallel.
const LOST: f64 = 30.0;

/// Least surface that counts, in (powers of) the extent: faces that enclose nothing have none.
const LEAST_SIZE: f64 = 0.5;

/// A graph at its optimum.
#[derive(Clone, Debug)]
pub struct Solved<const D: usize> {
    /// Where.
    pub state: State,
    /// What each contact lies on.
    pub labels: Labels,
    /// −ln of how plausible all of it is, nats, up to a constant: the contacts' and motions' costs,
    /// Laplace's approximation of the room that poses and faces have left, and the prior's.
    pub cost: f64,
    /// Of H at the optimum.
    pub factor: Factor<D>,
    /// Iterations it took.
    pub iterations: usize,
}

/// Poses and faces of least cost, near `state`. `None` where a number is not finite.
pub fn solve<const D: usize>(problem: &Problem, state: State, labels: Labels) -> Option<Solved<D>> {
    solve_until(problem, state, labels, (ENOUGH, PASSES))
}

/// The same only roughly: where an iteration gains less than [`ROUGHLY`], with slips about where the centre
/// was at first.
pub(super) fn rough<const D: usize>(
    problem: &Problem,
    state: State,
    labels: Labels,
) -> Option<Solved<D>> {
    solve_until(problem, state, labels, (ROUGHLY, 1))
}

fn solve_until<const D: usize>(
    problem: &Problem,
    mut state: State,
    labels: Labels,
    (enough, passes): (f64, usize),
) -> Option<Solved<D>> {
    let (mut arrow, mut cost, mut iterations) = (None, f64::INFINITY, 0);
    let mut centre = problem.middle(&state.poses);
    for _ in 0..passes {
        // The centre is held while descending, so that the cost has a gradient.
        let start = (&mut state, &mut iterations);
        let (least, at) = descend::<D>(problem.dimension, start, enough, |state| {
            linearise(problem, state, &labels, &centre)
        });
        (cost, arrow) = (least, Some(at));
        let moved = problem.middle(&state.poses);
        if (moved - centre).norm() < STILL {
            break;
        }
        centre = moved;
    }
    let factor = arrow?.factor(0.0)?;
    let cost = cost + worth(problem, &state, &labels, &factor);
    cost.is_finite().then_some(Solved { state, labels, cost, factor, iterations })
}

/// Takes a state to where `linearised`, a cost and its quadratic, is least, and says what it is there: until
/// an iteration, of which it counts how many there are, changes it by less than `enough`.
pub(super) fn descend<const D: usize>(
    dimension: usize,
    (state, iterations): (&mut State, &mut usize),
    enough: f64,
    linearised: impl Fn(&State) -> (f64, Arrow<D>),
) -> (f64, Arrow<D>) {
    let (mut cost, mut arrow) = linearised(state);
    let mut damping = DAMPING.0;
    for _ in 0..ITERATIONS {
        if !cost.is_finite() || damping > DAMPING.1 {
            break;
        }
        *iterations += 1;
        let Some((poses, faces)) = arrow.factor(damping).and_then(|f| f.step(&arrow)) else {
            damping *= 10.0;
            continue;
        };
        let next = displaced::<D>(dimension, state, &poses, faces.as_slice());
        let (lower, linear) = linearised(&next);
        let gained = cost - lower;
        if gained > 0.0 {
            (*state, cost, arrow) = (next, lower, linear);
            damping = (damping * 0.1).max(1e-9);
        } else {
            damping *= 10.0;
        }
        if gained.abs() < enough {
            break;
        }
    }
    (cost, arrow)
}

/// Moves every pose but the first, and every face.
fn displaced<const D: usize>(
    dimension: usize,
    state: &State,
    poses: &[nalgebra::SVector<f64, D>],
    faces: &[f64],
) -> State {
    let mut next = state.clone();
    for (pose, step) in next.poses.iter_mut().skip(1).zip(poses) {
        let mut tangent = Tangent::zeros();
        for (i, axis) in axes::<D>().into_iter().enumerate() {
            tangent[axis] = step[i];
        }
        *pose = retract(pose, &tangent);
    }
    for (face, change) in next.faces.iter_mut().zip(faces.chunks(dimension)) {
        *face = face.retract(dimension, change);
    }
    next
}

/// The robust cost of contacts and motions, and its quadratic. Motions slip about `centre`.
pub fn linearise<const D: usize>(
    problem: &Problem,
    state: &State,
    labels: &Labels,
    centre: &Point,
) -> (f64, Arrow<D>) {
    let dimension = problem.dimension;
    let poses = state.poses.len().saturating_sub(1);
    let mut arrow = Arrow::<D>::zeros(poses, dimension * state.faces.len());
    let mut cost = 0.0;
    for (felt, label) in problem.felt.iter().zip(labels) {
        let Some(owner) = label else { continue };
        let touched = (felt.grasp, &felt.contact);
        cost += match owner {
            Owner::Face(face) => add_face(&mut arrow, problem, state, *face, touched),
            _ => add_ridge(&mut arrow, problem, state, owner, touched),
        };
    }
    for relation in &state.relations {
        cost += add_relation(&mut arrow, state, relation, dimension);
    }
    for k in 1..state.poses.len() {
        let motion = &problem.motions[k];
        let (before, after) = (&state.poses[k - 1], &state.poses[k]);
        let step = factors::step(before, after, &motion.pose, motion.deviations, centre);
        let (own, weight) = problem.slip(k, step.residual.norm_squared());
        cost += own;
        arrow.add_step(k, &step, weight);
    }
    (cost, arrow)
}

/// Adds a contact on a face; what it costs.
fn add_face<const D: usize>(
    arrow: &mut Arrow<D>,
    problem: &Problem,
    state: &State,
    face: usize,
    (grasp, contact): (usize, &Contact),
) -> f64 {
    let pose = &state.poses[grasp];
    let mut touch = factors::touch(pose, &state.faces[face], problem.dimension, contact);
    let (off, off_weight) = problem.kernel.cost(touch.residual[0].powi(2));
    let turned = touch.residual.fixed_rows::<3>(1).norm_squared();
    let (turned, turned_weight) = problem.kernel.cost(turned);
    for row in 0..4 {
        let weight = if row == 0 { off_weight } else { turned_weight }.sqrt();
        touch.residual[row] *= weight;
        touch.by_pose.row_mut(row).scale_mut(weight);
        touch.by_face.row_mut(row).scale_mut(weight);
    }
    arrow.add_touch(grasp, &touch.residual, &touch.by_pose, &[(face, touch.by_face)]);
    off + turned
}

/// Adds a contact where faces meet; what it costs.
fn add_ridge<const D: usize>(
    arrow: &mut Arrow<D>,
    problem: &Problem,
    state: &State,
    owner: &Owner,
    (grasp, contact): (usize, &Contact),
) -> f64 {
    let Some(ridge) = Ridge::new(&named(owner, &state.faces)) else { return LOST };
    let mut touch = ridge.touch(&state.poses[grasp], problem.dimension, contact);
    let (off, off_weight) = problem.kernel.cost(touch.residual.fixed_rows::<3>(0).norm_squared());
    let turned = touch.residual.fixed_rows::<3>(3).norm_squared();
    let (turned, turned_weight) = problem.kernel.cost(turned);
    for row in 0..6 {
        let weight = if row < 3 { off_weight } else { turned_weight }.sqrt();
        touch.residual[row] *= weight;
        touch.by_pose.row_mut(row).scale_mut(weight);
        for by_face in &mut touch.by_face {
            by_face.row_mut(row).scale_mut(weight);
        }
    }
    let faces: Vec<(usize, Matrix6x3<f64>)> =
        owner.faces().iter().copied().zip(touch.by_face).collect();
    arrow.add_touch(grasp, &touch.residual, &touch.by_pose, &faces);
    off + turned
}

/// Adds what a relation says of its two faces; what it costs.
fn add_relation<const D: usize>(
    arrow: &mut Arrow<D>,
    state: &State,
    relation: &Relation,
    dimension: usize,
) -> f64 {
    let miss = relation.miss(&state.faces, dimension);
    let turns = |side: usize| (0..dimension - 1).map(move |l| (side, l));
    let at = |(side, turn): (usize, usize)| dimension * relation.faces[side] + turn;
    let mut cost = 0.0;
    for (residual, row) in miss.residual.iter().zip(&miss.by_turns).take(miss.count) {
        cost += 0.5 * residual * residual;
        for a in turns(0).chain(turns(1)) {
            arrow.rest[at(a)] += row[a.0][a.1] * residual;
            for b in turns(0).chain(turns(1)) {
                arrow.corner[(at(a), at(b))] += row[a.0][a.1] * row[b.0][b.1];
            }
        }
    }
    cost
}

/// What the cost of contacts and motions leaves out.
fn worth<const D: usize>(
    problem: &Problem,
    state: &State,
    labels: &Labels,
    factor: &Factor<D>,
) -> f64 {
    let contacts = problem.felt.iter().zip(labels).map(|(felt, label)| match label {
        Some(Owner::Face(_)) => problem.exact(&felt.contact),
        Some(owner) => match Ridge::new(&named(owner, &state.faces)) {
            Some(ridge) => ridge.exact(problem.dimension, &felt.contact),
            None => problem.unexplained(&felt.contact),
        },
        None => problem.unexplained(&felt.contact),
    });
    let faces = state.faces.len() as f64;
    let free = faces * problem.dimension as f64;
    contacts.sum::<f64>()
        + faces * problem.vague()
        + state.relations.iter().map(|r| r.worth(problem.dimension)).sum::<f64>()
        + 0.5 * (factor.log_determinant() - free * std::f64::consts::TAU.ln())
        + shape(problem, state, labels, &factor.faces())
}

/// What contacts say about the shape as a whole: the size of a convex one and how far they lie outside
/// it, or that it is not convex.
fn shape(problem: &Problem, state: &State, labels: &Labels, covariance: &DMatrix<f64>) -> f64 {
    let near = (0..labels.len()).filter(|i| !problem.felt[*i].astray);
    let near: Vec<(usize, Point)> =
        near.map(|i| (i, problem.placed(&state.poses, i).point)).collect();
    let mut outside = 0.0;
    for (i, point) in near.iter().map(|(i, point)| (*i, point)) {
        let noise = problem.felt[i].contact.point_deviation.powi(2);
        let mut worst: f64 = 0.0;
        for (j, face) in state.faces.iter().enumerate() {
            let height = face.value(point);
            let own = labels[i].is_some_and(|owner| owner.faces().contains(&j));
            if !own && height > 0.0 {
                let variance =
                    noise + face_variance(problem.dimension, state, covariance, j, point);
                worst = worst.max(height * height / variance);
            }
        }
        outside += OUTSIDE.0 * worst.min(OUTSIDE.1);
    }
    // In units of the extent, so that it is a number.
    let unit = problem.extent.powi(problem.dimension as i32 - 1);
    let points: Vec<Point> = near.into_iter().map(|(_, point)| point).collect();
    let count = problem.weight * points.len() as f64;
    let sides = size::sides(problem.dimension, &state.faces, &points);
    let round = if problem.edges {
        size::rounding(problem.dimension, sides, FINGERTIP) / unit
    } else {
        0.0
    };
    let surface = |size: f64| count * ((size / unit).max(LEAST_SIZE) + round).ln();
    let convex = outside + surface(size::convex(problem.dimension, &state.faces, &points));
    let concave = CONCAVE + surface(size::boxed(problem.dimension, sides));
    if convex.is_finite() { convex.min(concave) } else { concave }
}

/// Variance of n·p − ρ because of the face, square metres.
pub fn face_variance(
    dimension: usize,
    state: &State,
    covariance: &DMatrix<f64>,
    face: usize,
    point: &Point,
) -> f64 {
    let row = offset_row(dimension, state, face, point);
    let at = dimension * face;
    let mut sum = 0.0;
    for a in 0..dimension {
        for b in 0..dimension {
            sum += row[a] * covariance[(at + a, at + b)] * row[b];
        }
    }
    sum.max(0.0)
}

/// The derivative of n·p − ρ by a face's turns and offset; the first `dimension` numbers count.
pub fn offset_row(dimension: usize, state: &State, face: usize, point: &Point) -> [f64; 3] {
    let [t, u] = state.faces[face].tangents(dimension);
    if dimension == 2 { [t.dot(point), -1.0, 0.0] } else { [t.dot(point), u.dot(point), -1.0] }
}
