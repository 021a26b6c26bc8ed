//! The pose of one grasp while all else stays as it is.

use nalgebra::{Cholesky, Matrix6, SMatrix, SVector, Vector6};

use super::factors;
use super::problem::Problem;
use super::tangent::{Tangent, axes, retract};
use crate::space::{Point, Pose};

/// Steps at most, and those from a damping to a greater one.
const STEPS: usize = 8;
const DAMPED: usize = 4;

/// Nats that a step must gain for another to be worth while.
const ENOUGH: f64 = 1e-2;

/// JᵀJ and Jᵀr by the tangent of the pose.
pub(super) type Normal<const D: usize> = (SMatrix<f64, D, D>, SVector<f64, D>);

/// The motions to a grasp and from it.
pub(super) struct Between<'a> {
    problem: &'a Problem,
    grasp: usize,
    before: &'a Pose,
    after: Option<&'a Pose>,
    /// What slips turn about, object frame.
    centre: Point,
}

impl<'a> Between<'a> {
    /// Of a grasp after the first, which may be the one after the last of the poses.
    pub fn new(problem: &'a Problem, poses: &'a [Pose], grasp: usize) -> Option<Between<'a>> {
        let (before, after) = (poses.get(grasp.checked_sub(1)?)?, poses.get(grasp + 1));
        Some(Between { problem, grasp, before, after, centre: problem.middle(poses) })
    }

    /// The motion to the grasp alone, of grasps that move with all after them.
    pub fn without_later(self) -> Between<'a> {
        Between { after: None, ..self }
    }

    /// What they cost where the grasp was made at this pose, nats.
    pub fn cost(&self, pose: &Pose) -> f64 {
        let moved =
            |k: usize, from: &Pose, to: &Pose| self.problem.moved(k, from, to, &self.centre);
        moved(self.grasp, self.before, pose)
            + self.after.map_or(0.0, |after| moved(self.grasp + 1, pose, after))
    }

    /// Of both together.
    pub fn normal<const D: usize>(&self, pose: &Pose) -> Normal<D> {
        let (mut square, mut slope) = (SMatrix::zeros(), SVector::zeros());
        let chosen = axes::<D>();
        let mut add = |k: usize, residual: &Vector6<f64>, by: &Matrix6<f64>| {
            let weight = self.problem.slip(k, residual.norm_squared()).1;
            let rows = SMatrix::<f64, 6, D>::from_fn(|r, c| by[(r, chosen[c])]);
            square += rows.tr_mul(&rows) * weight;
            slope += rows.tr_mul(residual) * weight;
        };
        let step = |k: usize, from: &Pose, to: &Pose| {
            let motion = &self.problem.motions[k];
            factors::step(from, to, &motion.pose, motion.deviations, &self.centre)
        };
        let to = step(self.grasp, self.before, pose);
        add(self.grasp, &to.residual, &to.by_after);
        if let Some(after) = self.after {
            let from = step(self.grasp + 1, pose, after);
            add(self.grasp + 1, &from.residual, &from.by_before);
        }
        (square, slope)
    }
}

/// The pose of least cost from `start` on, with its cost, by Levenberg–Marquardt; `None` where a number is
/// not finite.
pub(super) fn least<const D: usize>(
    start: Pose,
    cost: impl Fn(&Pose) -> f64,
    normal: impl Fn(&Pose) -> Normal<D>,
) -> Option<(f64, Pose)> {
    let (mut pose, mut least, mut damping) = (start, cost(&start), 1e-3);
    for _ in 0..STEPS {
        let (square, slope) = normal(&pose);
        let mut gained = 0.0;
        for _ in 0..DAMPED {
            let mut damped = square;
            for i in 0..D {
                damped[(i, i)] *= 1.0 + damping;
            }
            let moved = displaced(&pose, &-Cholesky::new(damped)?.solve(&slope));
            let lower = cost(&moved);
            if lower < least {
                gained = least - lower;
                (pose, least) = (moved, lower);
                damping = (0.1 * damping).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if gained < ENOUGH {
            break;
        }
    }
    least.is_finite().then_some((least, pose))
}

/// The pose displaced by `D` numbers of a tangent.
pub(super) fn displaced<const D: usize>(pose: &Pose, step: &SVector<f64, D>) -> Pose {
    let mut tangent = Tangent::zeros();
    for (i, axis) in axes::<D>().into_iter().enumerate() {
        tangent[axis] = step[i];
    }
    retract(pose, &tangent)
}
