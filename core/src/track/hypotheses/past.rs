//! Where the object was at earlier grasps, as one hypothesis has it.

use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};

/// What a hypothesis remembers of a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Past<S: Space> {
    /// Before the grasp, and the variances that the motion to there added to each translation and
    /// rotation.
    pub predicted: S::Pose,
    pub noise: [f32; 2],
    /// After it.
    pub pose: S::Pose,
    pub covariance: S::Covariance,
}

impl<S: Space> Past<S> {
    pub const UNSET: Self = Past {
        predicted: S::Pose::UNSET,
        noise: [0.0; 2],
        pose: S::Pose::UNSET,
        covariance: S::Covariance::ZERO,
    };

    /// The pose, knowing that the one after `next` was `later` (Rauch, Tung and Striebel 1965, the
    /// planes held): x ⊞ P·(P + Q)⁻¹·(predicted → later).
    pub fn smoothed(&self, next: &Self, later: &S::Pose) -> S::Pose {
        let error = next.predicted.local(later);
        let n = S::FREEDOM;
        let mut total = self.covariance;
        for i in 0..n {
            *total.at_mut(i, i) += next.noise[usize::from(i >= S::DIMENSION)];
        }
        // Cholesky, in place: at most six rows.
        for i in 0..n {
            for j in 0..=i {
                let mut sum = total.at(i, j);
                for k in 0..j {
                    sum -= total.at(i, k) * total.at(j, k);
                }
                if i > j {
                    *total.at_mut(i, j) = sum / total.at(j, j);
                } else if sum > 0.0 {
                    *total.at_mut(i, i) = math::sqrt(sum);
                } else {
                    return self.pose;
                }
            }
        }
        let mut x = error;
        for i in 0..n {
            for k in 0..i {
                x[i] -= total.at(i, k) * x[k];
            }
            x[i] /= total.at(i, i);
        }
        for i in (0..n).rev() {
            for k in i + 1..n {
                x[i] -= total.at(k, i) * x[k];
            }
            x[i] /= total.at(i, i);
        }
        let step = S::Tangent::from_fn(|i| (0..n).map(|j| self.covariance.at(i, j) * x[j]).sum());
        if step.is_finite() { self.pose.retract(step) } else { self.pose }
    }
}
