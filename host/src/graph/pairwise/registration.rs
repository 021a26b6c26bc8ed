//! The relative pose of two grasps that felt the same faces: symmetric point-to-plane registration.
//!
//! T* = argmin Σ w \[((T p − q)·(R n_p + n_q))² / V + |R n_p − n_q|² / V_n\] over pairs of contacts on one
//! face (thesis 3.26, which lacks the square; Rusinkiewicz, SIGGRAPH 2019). Where two contacts lie on
//! one plane, or on one circle or sphere, the first residual is zero wherever on it they lie. The
//! second tells the rotation, which five contacts alone hardly do.
//!
//! V is the variance of the first residual: that of the two points, and that of the two normals
//! times how far the points lie apart across them.

use nalgebra::{Matrix6, RowVector6, SMatrix, SVector, Vector6};

use crate::graph::joint::tangent::{axes, retract, six_by_six};
use crate::reference::Contact;
use crate::space::{Point, Pose};

use super::covariance;

/// Iterations at most; four or five are usual.
const ITERATIONS: usize = 30;

/// A step below this many metres and radians ends the iteration.
const SETTLED: f64 = 1e-9;

/// Halvings of a step that does not lower the cost.
const HALVINGS: usize = 8;

/// Least ratio of the smallest to the largest pivot of the scaled information at which every direction
/// counts as seen.
const SEEN: f64 = 1e-5;

/// Two contacts on one face, each with a normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// p and n_p, in the frame that is moved.
    pub from: Contact,
    /// q and n_q, in the frame it is moved into.
    pub to: Contact,
    /// What the pair counts: 1 for contacts that are in no other pair.
    pub weight: f64,
}

/// A relative pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registered {
    /// T: takes points of the one frame into the other.
    pub pose: Pose,
    /// Of T, in tangent coordinates in its own axes (translation in metres, then rotation in radians):
    /// thesis 3.23. In the plane, zero where there is no freedom.
    pub covariance: Matrix6<f64>,
    /// Weighted squares at T.
    pub chi2: f64,
    /// How many of them are more than the pose can fit.
    pub degrees: f64,
}

/// Why there is no relative pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// Not one pair.
    #[error("no pairs of contacts to register")]
    Empty,
    /// A number in a pair cannot be used.
    #[error("pair {pair}: expected finite points, unit normals, positive deviations and weight")]
    Number {
        /// From 0.
        pair: usize,
    },
    /// A contact has no normal.
    #[error("pair {pair}: expected a normal on both contacts")]
    NoNormal {
        /// From 0.
        pair: usize,
    },
    /// The pose to start from has numbers that are not finite.
    #[error("the pose to start from is not finite")]
    Start,
    /// The pairs leave a direction open.
    #[error("the pairs do not determine the relative pose: a direction is free")]
    Unobservable,
    /// The iteration does not end.
    #[error("the registration did not converge in {ITERATIONS} iterations")]
    Diverged,
}

/// The pose that lays the one grasp's contacts on the other's faces, nearest to `start`.
///
/// # Errors
/// Without pairs, with unusable numbers, where a direction is free, or without convergence.
///
/// ```
/// use tactile_host::graph::pairwise::registration::{Pair, register};
/// use tactile_host::reference::Contact;
/// use tactile_host::space::{Point, planar};
/// let truth = planar(0.004, -0.002, 0.1);
/// let touch = |x: f64, y: f64, nx: f64, ny: f64| Contact {
///     point: Point::new(x, y, 0.0),
///     normal: Some(Point::new(nx, ny, 0.0)),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
/// };
/// // Three sides of a square, felt at other places the second time.
/// let first = [touch(0.03, 0.01, 1.0, 0.0), touch(0.0, 0.03, 0.0, 1.0), touch(-0.03, 0.0, -1.0, 0.0)];
/// let second = [touch(0.03, -0.02, 1.0, 0.0), touch(0.01, 0.03, 0.0, 1.0), touch(-0.03, 0.02, -1.0, 0.0)];
/// let pairs: Vec<Pair> = first
///     .iter()
///     .zip(&second)
///     .map(|(from, to)| Pair { from: *from, to: to.transformed(&truth), weight: 1.0 })
///     .collect();
/// let found = register(2, &pairs, planar(0.0, 0.0, 0.0))?;
/// assert!((found.pose.translation.vector - truth.translation.vector).norm() < 1e-9);
/// # Ok::<(), tactile_host::graph::pairwise::registration::RegistrationError>(())
/// ```
pub fn register(
    dimension: usize,
    pairs: &[Pair],
    start: Pose,
) -> Result<Registered, RegistrationError> {
    if dimension == 2 {
        descend::<3>(dimension, pairs, start)
    } else {
        descend::<6>(dimension, pairs, start)
    }
}

/// Two points and normals, checked.
#[derive(Clone, Copy, Debug)]
struct Match {
    p: Point,
    q: Point,
    from: Point,
    to: Point,
    /// Variances of the two points together and of the two normals together.
    points: f64,
    normals: f64,
    weight: f64,
}

fn checked(pairs: &[Pair]) -> Result<Vec<Match>, RegistrationError> {
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let one = |(number, pair): (usize, &Pair)| {
        let (Some(from), Some(to)) = (pair.from.normal, pair.to.normal) else {
            return Err(RegistrationError::NoNormal { pair: number });
        };
        let both = [&pair.from, &pair.to];
        let fine = both.iter().all(|c| {
            c.point.iter().all(|v| v.is_finite())
                && positive(c.point_deviation)
                && positive(c.normal_deviation)
        });
        let unit = [from, to].iter().all(|n| (n.norm() - 1.0).abs() < 1e-3);
        if !(fine && unit && positive(pair.weight)) {
            return Err(RegistrationError::Number { pair: number });
        }
        let sum = |f: fn(&Contact) -> f64| f(&pair.from).powi(2) + f(&pair.to).powi(2);
        Ok(Match {
            p: pair.from.point,
            q: pair.to.point,
            from,
            to,
            points: sum(|c| c.point_deviation),
            normals: sum(|c| c.normal_deviation),
            weight: pair.weight,
        })
    };
    pairs.iter().enumerate().map(one).collect()
}

/// How a pair fits at a pose.
struct Fit {
    /// (T p − q)·(R n_p + n_q), metres.
    off: f64,
    /// Its derivatives by a displacement of the pose.
    by_off: RowVector6<f64>,
    /// R n_p − n_q.
    turned: Point,
    by_turned: SMatrix<f64, 3, 6>,
    /// Information of both.
    weights: [f64; 2],
}

impl Match {
    fn at(&self, pose: &Pose) -> Fit {
        let rotation = pose.rotation.to_rotation_matrix();
        let r = rotation.matrix();
        let apart = r * self.p + pose.translation.vector - self.q;
        let normal = r * self.from;
        let sum = normal + self.to;
        let mut by_off = RowVector6::zeros();
        let turn_point = -(r * self.p.cross_matrix());
        let turn_normal = -(r * self.from.cross_matrix());
        by_off.fixed_columns_mut::<3>(0).copy_from(&(sum.transpose() * r));
        by_off
            .fixed_columns_mut::<3>(3)
            .copy_from(&(sum.transpose() * turn_point + apart.transpose() * turn_normal));
        let mut by_turned = SMatrix::<f64, 3, 6>::zeros();
        by_turned.fixed_columns_mut::<3>(3).copy_from(&turn_normal);
        let square = sum.norm_squared();
        let across = apart.norm_squared() - apart.dot(&sum).powi(2) / square.max(1e-12);
        let variance = square * self.points + across.max(0.0) * self.normals;
        Fit {
            off: apart.dot(&sum),
            by_off,
            turned: normal - self.to,
            by_turned,
            weights: [self.weight / variance.max(1e-18), self.weight / self.normals],
        }
    }

    /// Weighted squares at a pose, with weights of another one.
    fn cost(&self, pose: &Pose, weights: [f64; 2]) -> f64 {
        let normal = pose.rotation * self.from;
        let apart = pose.rotation * self.p + pose.translation.vector - self.q;
        weights[0] * apart.dot(&(normal + self.to)).powi(2)
            + weights[1] * (normal - self.to).norm_squared()
    }
}

/// A displacement of `D` numbers among the six.
pub(super) fn displaced<const D: usize>(pose: &Pose, by: &SVector<f64, D>) -> Pose {
    let mut tangent = Vector6::zeros();
    for (i, axis) in axes::<D>().into_iter().enumerate() {
        tangent[axis] = by[i];
    }
    retract(pose, &tangent)
}

/// Gauss–Newton, the weights renewed at every step.
fn descend<const D: usize>(
    dimension: usize,
    pairs: &[Pair],
    start: Pose,
) -> Result<Registered, RegistrationError> {
    let matches = checked(pairs)?;
    if matches.is_empty() {
        return Err(RegistrationError::Empty);
    }
    if !start.to_homogeneous().iter().all(|v| v.is_finite()) {
        return Err(RegistrationError::Start);
    }
    let chosen = axes::<D>();
    let mut pose = start;
    for _ in 0..ITERATIONS {
        let fits: Vec<Fit> = matches.iter().map(|m| m.at(&pose)).collect();
        let mut h = SMatrix::<f64, D, D>::zeros();
        let mut g = SVector::<f64, D>::zeros();
        for fit in &fits {
            let by_off = SMatrix::<f64, 1, D>::from_fn(|_, c| fit.by_off[chosen[c]]);
            let by_turned = SMatrix::<f64, 3, D>::from_fn(|r, c| fit.by_turned[(r, chosen[c])]);
            h += by_off.tr_mul(&by_off) * fit.weights[0]
                + by_turned.tr_mul(&by_turned) * fit.weights[1];
            g += by_off.transpose() * (fit.weights[0] * fit.off)
                + by_turned.tr_mul(&fit.turned) * fit.weights[1];
        }
        let factor = sure(&h).ok_or(RegistrationError::Unobservable)?;
        let step = -factor.solve(&g);
        let cost = |pose: &Pose| -> f64 {
            matches.iter().zip(&fits).map(|(m, f)| m.cost(pose, f.weights)).sum()
        };
        let now = cost(&pose);
        let mut part = 1.0;
        let mut next = displaced(&pose, &step);
        for _ in 0..HALVINGS {
            if cost(&next) <= now {
                break;
            }
            part *= 0.5;
            next = displaced(&pose, &(step * part));
        }
        if step.norm() < SETTLED || part < 1e-2 && step.norm() * part < 1e-6 {
            let covariance =
                covariance::sampled(&factor.inverse(), |x| cost(&displaced(&pose, x)) - now)
                    .ok_or(RegistrationError::Unobservable)?;
            // A pair tells one offset and dimension − 1 turns; what it shares with others counts once.
            let told: f64 = matches.iter().map(|m| m.weight * dimension as f64).sum();
            return Ok(Registered {
                pose,
                covariance: six_by_six(&covariance),
                chi2: now,
                degrees: told - D as f64,
            });
        }
        if !(cost(&next) <= now) {
            break;
        }
        pose = next;
    }
    Err(RegistrationError::Diverged)
}

/// The factor of an information matrix that sees every direction.
fn sure<const D: usize>(
    h: &SMatrix<f64, D, D>,
) -> Option<nalgebra::Cholesky<f64, nalgebra::Const<D>>> {
    // Metres and radians side by side: scaled to a unit diagonal.
    let scale = SVector::<f64, D>::from_fn(|i, _| h[(i, i)].max(0.0).sqrt());
    if !scale.iter().all(|s| *s > 0.0 && s.is_finite()) {
        return None;
    }
    let unit = SMatrix::<f64, D, D>::from_fn(|i, j| h[(i, j)] / (scale[i] * scale[j]));
    let pivots = unit.cholesky()?.l_dirty().diagonal().map(|v| v * v);
    (pivots.min() > SEEN * pivots.max()).then(|| h.cholesky())?
}

#[cfg(test)]
mod tests;
