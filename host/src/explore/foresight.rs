//! What grasps will still be worth once others have been made, without making them: the covariances of
//! surface and pose are conditioned on the contacts to be expected. Conditioning needs no measured
//! values, and no surface is fitted again.

use std::borrow::Cow;
use std::ops::Range;

use nalgebra::{DMatrix, Matrix6};

use super::belief::Belief;
use super::criterion::{About, Criterion, pose_information, root};
use super::prediction::{Expected, Prediction};
use crate::reference::Contact;

/// Some grasps, and what was imagined of them so far.
///
/// Every grasp has a doubt about the pose of its own, since an object that is followed slips between
/// two grasps. Given the shape, grasps then say nothing about each other, and [`Criterion::Entropy`]
/// and [`Criterion::Information`] of a set of them are submodular: what a grasp adds never grows when
/// another one is taken before it (Krause & Guestrin 2005).
///
/// What criteria about the pose see of it: its covariance after the imagined contacts, the shape's own
/// doubt staying as it is, and one mode, the imagined contacts having told several apart.
#[derive(Clone, Debug)]
pub struct Foresight<'a> {
    criterion: Criterion,
    alpha: f64,
    belief: Cow<'a, Belief>,
    grasps: &'a [Vec<Expected>],
    /// Where each grasp's contacts are among all, and where they end.
    starts: Vec<usize>,
    /// Of the surface at all contacts of all grasps, m².
    covariance: DMatrix<f64>,
}

impl<'a> Foresight<'a> {
    /// Before anything is imagined. `alpha` is the order of the Rényi entropy. The memory needed is the
    /// square of the number of all contacts.
    pub fn new(
        criterion: Criterion,
        alpha: f64,
        belief: &'a Belief,
        grasps: &'a [Vec<Expected>],
    ) -> Foresight<'a> {
        let points: Vec<_> = grasps.iter().flatten().map(|e| e.point).collect();
        let mut starts = vec![0];
        starts.extend(grasps.iter().scan(0, |end, g| {
            *end += g.len();
            Some(*end)
        }));
        let covariance = belief.surface.joint(&points).1;
        Foresight { criterion, alpha, belief: Cow::Borrowed(belief), grasps, starts, covariance }
    }

    /// What each grasp is worth now, as [`Criterion::worth`].
    pub fn scores(&self) -> Vec<f64> {
        let blocks = (0..self.grasps.len()).map(|g| {
            let at = self.range(g);
            self.covariance.view((at.start, at.start), (at.len(), at.len())).into_owned()
        });
        let prediction =
            Prediction { contacts: self.grasps.to_vec(), covariances: blocks.collect() };
        self.criterion.worth_of_order(self.alpha, &self.belief, &prediction)
    }

    /// Imagines that the grasp is made; nothing where there is none of that number.
    pub fn take(&mut self, grasp: usize) {
        let Some(contacts) = self.grasps.get(grasp).filter(|g| !g.is_empty()) else { return };
        let at = self.range(grasp);
        let own = self.covariance.view((at.start, at.start), (at.len(), at.len())).into_owned();
        if self.criterion.about() == About::Pose {
            return self.settle_pose(contacts, &own);
        }
        if self.criterion == Criterion::Igef {
            return self.mark(contacts);
        }
        let noise = self.criterion.noise(&self.belief, contacts);
        let seen = self.covariance.columns_range(at).into_owned();
        // Noise makes it positive definite, unless the covariance is not a number.
        if let Some(factor) = (own + noise).cholesky() {
            let mut half = seen.transpose();
            if factor.l_dirty().solve_lower_triangular_mut(&mut half) {
                self.covariance.gemm_tr(-1.0, &half, &half, 1.0);
            }
        }
    }

    fn range(&self, grasp: usize) -> Range<usize> {
        self.starts[grasp]..self.starts[grasp + 1]
    }

    /// Σ − ΣA(I + ΣA)⁻¹Σ of the pose, A the contacts' information, by a root of Σ.
    fn settle_pose(&mut self, contacts: &[Expected], surface: &DMatrix<f64>) {
        let information = pose_information(&self.belief, contacts, surface);
        let Some(root) = root(&self.belief.covariance) else { return };
        let seen = Matrix6::identity() + root.transpose() * information * root;
        let Some(factor) = seen.cholesky() else { return };
        let belief = self.belief.to_mut();
        belief.covariance = root * factor.inverse() * root.transpose();
        belief.modes = vec![(belief.pose, 1.0)];
    }

    fn mark(&mut self, contacts: &[Expected]) {
        let noise = self.belief.noise;
        let felt = contacts.iter().map(|e| Contact {
            point: e.point,
            normal: Some(e.normal),
            point_deviation: noise.0,
            normal_deviation: noise.1,
        });
        self.belief.to_mut().contacts.extend(felt);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use clap::ValueEnum;
    use nalgebra::Vector6;

    use super::*;
    use crate::explore::placement::fixed;
    use crate::explore::prediction::predict;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    pub(in crate::explore) fn belief() -> Belief {
        let options =
            Options { grasps: Some(1), ..Options::new("ellipse:0.1x0.06".parse().unwrap()) };
        let log = simulate(&options).unwrap().log;
        let mut belief = Belief::new(&log, &track::truth(&log).unwrap()).unwrap();
        belief.covariance = Matrix6::from_diagonal(&Vector6::new(2e-5, 2e-5, 0.0, 0.0, 0.0, 0.01));
        belief
    }

    #[test]
    fn before_anything_is_imagined_scores_are_the_criterions() {
        let belief = belief();
        let mut grasps = predict(&belief, &fixed(2, &belief.centre));
        grasps.push(Vec::new());
        for criterion in Criterion::value_variants() {
            let plain = criterion.scores(&belief, &grasps);
            let mut foresight = Foresight::new(*criterion, 2.0, &belief, &grasps);
            for (a, b) in foresight.scores().iter().zip(&plain) {
                assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "{criterion:?}: {a} {b}");
            }
            // Nothing felt, nothing learnt; no such grasp, nothing done.
            foresight.take(10);
            foresight.take(1000);
            assert!(foresight.scores().iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-6));
        }
    }

    #[test]
    fn conditioning_is_what_the_whole_covariance_says() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        // ½ log det of both together less that of the first is what the second adds.
        let together = |both: &[usize]| {
            let felt: Vec<Expected> = both.iter().flat_map(|g| grasps[*g].clone()).collect();
            Criterion::Entropy.scores(&belief, &[felt])[0]
        };
        for (a, b) in [(0, 1), (3, 8), (5, 5)] {
            let mut foresight = Foresight::new(Criterion::Entropy, 2.0, &belief, &grasps);
            foresight.take(a);
            let added = foresight.scores()[b];
            assert!((together(&[a, b]) - together(&[a]) - added).abs() < 1e-6, "{a} {b} {added}");
        }
    }

    #[test]
    fn nothing_is_worth_more_after_something_else() {
        let belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        for criterion in [
            Criterion::Entropy,
            Criterion::Information,
            Criterion::VarianceSum,
            Criterion::Variance,
            Criterion::MutualInformation,
        ] {
            let mut foresight = Foresight::new(criterion, 2.0, &belief, &grasps);
            let mut before = foresight.scores();
            for taken in [2, 7, 4] {
                foresight.take(taken);
                let after = foresight.scores();
                for (a, b) in after.iter().zip(&before) {
                    assert!(*a <= b + 1e-9 && *a >= -1e-12, "{criterion:?} {a} {b}");
                }
                // With a pose of its own, even the same grasp says something new, and what is known
                // to half its noise is known little better after it was felt again.
                let most = if criterion == Criterion::Information { 0.99 } else { 0.9 };
                assert!(after[taken] < most * before[taken].max(1e-12), "{criterion:?} {taken}");
                before = after;
            }
        }
    }
}
