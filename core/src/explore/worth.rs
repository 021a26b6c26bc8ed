//! From doubts about distances to nats.

use super::FINGERS;
use crate::math;

/// Covariances of the distances between fingertips and surface at some foretold contacts, square
/// metres; rows and columns beyond their number are not used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubts {
    /// Of shape and pose together: S + JΣJᵀ where they are independent.
    pub all: [[f32; FINGERS]; FINGERS],
    /// What of it is left if the shape were known: JΣJᵀ.
    pub pose: [[f32; FINGERS]; FINGERS],
}

impl Doubts {
    /// Nothing in doubt.
    pub const NONE: Self =
        Doubts { all: [[0.0; FINGERS]; FINGERS], pose: [[0.0; FINGERS]; FINGERS] };

    /// Probability that contact `i` comes about: that the distance errs by less than the `depth` to
    /// which the finger would go (metres). No other than [`FINGERS`] ever does.
    pub fn likely(&self, i: usize, depth: f32) -> f32 {
        if i >= FINGERS {
            return 0.0;
        }
        let deviation = math::sqrt(math::max(self.all[i][i], 0.0));
        math::normal(depth / math::max(deviation, 1e-6)).1
    }

    /// Thesis 4.20: the sum of the shape's variances, times the chances to see them.
    pub fn variance_sum(&self, chances: &[f32]) -> f32 {
        let shape = |i: usize| math::max(self.all[i][i] - self.pose[i][i], 0.0);
        chances.iter().enumerate().take(FINGERS).map(|(i, chance)| chance * shape(i)).sum()
    }

    /// Expected nats about the shape from contacts that come about with these probabilities, each by
    /// itself, and measure distances to within `noise` (metres).
    pub fn information(&self, chances: &[f32], noise: f32) -> f32 {
        let chances = &chances[..chances.len().min(FINGERS)];
        let unit = 1.0 / (noise * noise);
        let mut sum = 0.0;
        // Every set of contacts, a bit each.
        for set in 1u32..1 << chances.len() {
            let mut share = 1.0;
            for (i, chance) in chances.iter().enumerate() {
                share *= if set >> i & 1 == 1 { *chance } else { 1.0 - chance };
            }
            if share > 1e-4 {
                sum += share * self.together(set, unit);
            }
        }
        sum
    }

    /// ½ log det(I + all·unit) − ½ log det(I + pose·unit) over the contacts of a set.
    fn together(&self, set: u32, unit: f32) -> f32 {
        let mut members = [0; FINGERS];
        let mut count = 0;
        for i in 0..FINGERS {
            if set >> i & 1 == 1 {
                members[count] = i;
                count += 1;
            }
        }
        let members = &members[..count];
        let (all, pose) = (pivots(&self.all, members, unit), pivots(&self.pose, members, unit));
        let mut sum = 0.0;
        for (a, b) in all.iter().zip(&pose).take(count) {
            sum += math::ln(a / b);
        }
        0.5 * sum
    }
}

/// The squared diagonal of the Cholesky factor of I + unit·A over some rows of A. None is below one, as
/// A is positive semidefinite.
fn pivots(a: &[[f32; FINGERS]; FINGERS], members: &[usize], unit: f32) -> [f32; FINGERS] {
    let mut l = [[0.0f32; FINGERS]; FINGERS];
    let mut pivots = [1.0; FINGERS];
    for (i, row) in members.iter().enumerate() {
        for (j, column) in members.iter().enumerate().take(i + 1) {
            let mut sum = unit * a[*row][*column];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            if i == j {
                pivots[i] = math::max(sum + 1.0, 1.0);
                l[i][i] = 1.0 / math::sqrt(pivots[i]);
            } else {
                l[i][j] = sum * l[j][j];
            }
        }
    }
    pivots
}
