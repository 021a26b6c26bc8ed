//! A bounded set of weighted poses.

use crate::math;
use crate::random::Random;
use crate::space::{self, Pose, Space};
use crate::track::{Modes, Separation};

/// `N` poses with weights that sum to one.
#[derive(Clone, Debug)]
pub struct Particles<S: Space, const N: usize> {
    poses: [S::Pose; N],
    weights: [f32; N],
    /// Log weights while weighing, numbers of children while resampling.
    scratch: [f32; N],
}

impl<S: Space, const N: usize> Particles<S, N> {
    /// Child counts are whole numbers in `f32`.
    const SIZE_FITS: () = assert!(N > 0 && N <= 1 << 24, "1 to 2²⁴ particles");

    /// All zero bits; [`place`](Self::place) them before use.
    pub const fn new() -> Self {
        let () = Self::SIZE_FITS;
        Particles { poses: [S::Pose::UNSET; N], weights: [0.0; N], scratch: [0.0; N] }
    }

    /// Puts every particle at `pose` with equal weight.
    pub fn place(&mut self, pose: S::Pose) {
        self.poses.fill(pose);
        self.weights.fill(1.0 / N as f32);
    }

    /// The poses.
    pub fn poses(&self) -> &[S::Pose] {
        &self.poses
    }

    /// The poses, to be moved.
    pub fn poses_mut(&mut self) -> &mut [S::Pose] {
        &mut self.poses
    }

    /// The weights, summing to one.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Multiplies every weight by exp(`log_likelihood`(pose)) and normalises (Algorithm 3.1,
    /// corrected: earlier weights count). `None` marks a pose as impossible. When all are
    /// impossible nothing changes and the answer is false.
    pub fn weigh(&mut self, log_likelihood: impl FnMut(&S::Pose) -> Option<f32>) -> bool {
        self.compare(log_likelihood).is_some() && self.accept()
    }

    /// Log likelihoods of all poses, kept for [`accept`](Self::accept); the pose that is most
    /// probable with them, or `None` when all are impossible.
    pub fn compare(
        &mut self,
        mut log_likelihood: impl FnMut(&S::Pose) -> Option<f32>,
    ) -> Option<S::Pose> {
        let mut best = (f32::NEG_INFINITY, None);
        for ((pose, weight), log) in self.poses.iter().zip(&self.weights).zip(&mut self.scratch) {
            *log = log_likelihood(pose).unwrap_or(f32::NEG_INFINITY);
            let both = *log + math::ln(*weight);
            if both > best.0 {
                best = (both, Some(*pose));
            }
        }
        best.1
    }

    /// Multiplies the weights by what [`compare`](Self::compare) found; once.
    pub fn accept(&mut self) -> bool {
        multiply(&mut self.weights, &mut self.scratch)
    }

    /// Effective number of particles 1/Σw², from 1 to `N`.
    pub fn effective(&self) -> f32 {
        effective(&self.weights)
    }

    /// Weighted mean on the manifold and covariance in its tangent coordinates.
    pub fn mean(&self) -> (S::Pose, S::Covariance) {
        let mut heaviest = 0;
        for (i, w) in self.weights.iter().enumerate() {
            if *w > self.weights[heaviest] {
                heaviest = i;
            }
        }
        let weighted = self.weights.iter().copied().zip(self.poses.iter().copied());
        space::mean::<S>(weighted, self.poses[heaviest])
    }

    /// The poses held possible.
    pub fn modes(&self, separation: &Separation) -> Modes<S> {
        Modes::of(self.weights.iter().copied().zip(self.poses.iter().copied()), separation)
    }

    /// The same of the particles within `separation` of `pose` alone.
    pub fn mean_near(&self, pose: S::Pose, separation: &Separation) -> (S::Pose, S::Covariance) {
        let near = self.weights.iter().copied().zip(self.poses.iter().copied());
        let near = near.filter(|(_, other)| separation.between::<S>(&pose, other) < 1.0);
        space::mean::<S>(near, pose)
    }

    /// Systematic resampling in place: every particle gets as many children as its weight earns,
    /// ±1, and equal weights follow.
    pub fn resample(&mut self, random: &mut Random) {
        let poses = &mut self.poses;
        resample(&mut self.weights, &mut self.scratch, random, |from, to| poses[to] = poses[from]);
    }
}

/// Multiplies every weight by the exponential of its logarithm in `logs` and normalises; what is not
/// finite counts as impossible. When all are impossible nothing changes and the answer is false.
/// Leaves `logs` spoilt.
pub(super) fn multiply(weights: &mut [f32], logs: &mut [f32]) -> bool {
    let mut greatest = f32::NEG_INFINITY;
    for (weight, log) in weights.iter().zip(logs.iter_mut()) {
        *log = if log.is_finite() { *log + math::ln(*weight) } else { f32::NEG_INFINITY };
        greatest = greatest.max(*log);
    }
    if greatest == f32::NEG_INFINITY {
        return false;
    }
    let mut total = 0.0;
    for (weight, log) in weights.iter_mut().zip(logs.iter()) {
        let below = log - greatest;
        // e⁻⁸⁰ of the heaviest is nothing, and `exp` never reaches zero by itself.
        *weight = if below > -80.0 { math::exp(below) } else { 0.0 };
        total += *weight;
    }
    let scale = 1.0 / total;
    for weight in weights {
        *weight *= scale;
    }
    true
}

/// Effective number of particles 1/Σw², from 1 to their number.
pub(super) fn effective(weights: &[f32]) -> f32 {
    let mut sum = 0.0;
    for w in weights {
        sum += w * w;
    }
    1.0 / sum
}

/// Systematic resampling in place: every particle gets as many children as its weight earns, ±1, and
/// equal weights follow. `copy(from, to)` puts a child of one particle in the place of another that
/// has none; parents stay where they are. `children` is room for as many numbers as there are
/// weights.
pub(super) fn resample(
    weights: &mut [f32],
    children: &mut [f32],
    random: &mut Random,
    mut copy: impl FnMut(usize, usize),
) {
    let number = weights.len().min(children.len());
    let count = number as f32;
    let mut comb = random.uniform();
    let mut cumulative = 0.0;
    let mut drawn = 0;
    for (weight, children) in weights.iter().zip(children.iter_mut()) {
        cumulative += weight * count;
        *children = 0.0;
        while comb <= cumulative && drawn < number {
            *children += 1.0;
            comb += 1.0;
            drawn += 1;
        }
    }
    // Rounding may leave the last teeth of the comb beyond the sum: they are the last's.
    if drawn < number
        && let Some(last) = children.iter().rposition(|&children| children > 0.0)
    {
        children[last] += (number - drawn) as f32;
    }
    let mut vacant = 0;
    for parent in 0..number {
        while children[parent] > 1.0 {
            while vacant < number && children[vacant] != 0.0 {
                vacant += 1;
            }
            if vacant == number {
                break;
            }
            copy(parent, vacant);
            children[vacant] = 1.0;
            children[parent] -= 1.0;
        }
    }
    weights.fill(1.0 / count);
}

impl<S: Space, const N: usize> Default for Particles<S, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::{Planar, PlanarPose};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn spread(weights: &[f32; 16]) -> Particles<Planar, 16> {
        let mut particles = Particles::new();
        particles.place(PlanarPose::IDENTITY);
        for (i, pose) in particles.poses_mut().iter_mut().enumerate() {
            *pose = PlanarPose::from_translation(Vector([i as f32, 0.0]));
        }
        let logs = weights.map(math::ln);
        assert!(particles.weigh(|p: &PlanarPose| Some(logs[p.translation[0] as usize])));
        particles
    }

    proptest! {
        #[test]
        fn resampling_is_fair(weights in proptest::array::uniform16(0.001f32..1.0), seed in 0u64..1000) {
            let mut particles = spread(&weights);
            let before: Vec<f32> = particles.weights().to_vec();
            prop_assert!((before.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            particles.resample(&mut Random::new(seed));
            for (i, w) in before.iter().enumerate() {
                let children = particles.poses().iter().filter(|p| p.translation[0] == i as f32).count();
                prop_assert!((children as f32 - 16.0 * w).abs() < 1.001, "{} {}", children, 16.0 * w);
            }
            prop_assert!((particles.effective() - 16.0).abs() < 1e-3);
        }
    }

    #[test]
    fn weights_multiply() {
        let mut particles = spread(&[1.0; 16]);
        for _ in 0..2 {
            assert!(particles.weigh(|p: &PlanarPose| Some(if p.translation[0] == 3.0 {
                1.0
            } else {
                0.0
            })));
        }
        let ratio = particles.weights()[3] / particles.weights()[4];
        assert!((ratio - 1.0f32.exp().powi(2)).abs() < 1e-3);
    }

    #[test]
    fn impossible_everywhere_changes_nothing() {
        let mut particles = spread(&[1.0; 16]);
        assert!(particles.weigh(|p: &PlanarPose| (p.translation[0] < 8.0).then_some(0.0)));
        let before = particles.clone();
        assert!(!particles.weigh(|_| None));
        assert!(!particles.weigh(|_| Some(f32::NAN)));
        assert_eq!(particles.weights(), before.weights());
        assert!((particles.effective() - 8.0).abs() < 1e-3);
        assert!((particles.mean().0.translation[0] - 3.5).abs() < 1e-4);
    }
}
