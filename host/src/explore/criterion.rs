//! What a grasp is worth (thesis 4.4, as corrected): one number for the contacts it would give.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::belief::Belief;
use super::pose_gain::{self, PoseMeasure};
use super::prediction::{Expected, Prediction};
use crate::reference::Contact;

/// α of the Rényi entropy: heavy hypotheses count more than with Shannon's.
const ALPHA: f64 = 2.0;

/// Constants of the IGEF (4.11–4.15), which the thesis tunes by hand: σ₁ and σ₃ as shares of the
/// object's radius, μ₃ as a share of it, σ₄ as a number.
const IGEF: [f64; 4] = [0.5, 0.7, 0.5, 1.0];

/// The criteria on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Criterion {
    /// Information about the shape that is left when the pose must be learnt from the same contacts
    Information,
    /// Information about the pose that is left when the shape must be learnt from the same contacts
    Pose,
    /// Information about shape and pose, each with the other unknown: where a pose tolerance is asked
    /// for, the chance to meet it in place of the second
    Both,
    /// Joint differential entropy of the surface at all contacts (4.8–4.10 over a whole grasp)
    Entropy,
    /// Sum of the surface's variances at the contacts (4.20)
    VarianceSum,
    /// Greatest variance of the surface at a contact (4.7)
    Variance,
    /// Information gain estimation function: far from contacts, near what is known (4.11-4.15)
    Igef,
    /// Expected fall of the Shannon entropy of the pose (4.2, 4.3)
    Shannon,
    /// Expected fall of the Rényi entropy of the pose, α = 2 (4.4)
    Renyi,
    /// Mutual information of pose and contacts, Gaussian (4.5)
    MutualInformation,
    /// Expected divergence of the posterior pose from the prior one (4.6)
    Kl,
    /// Expected fall of log det Σ of the pose (4.21)
    DetSigma,
    /// Any candidate, each as likely
    Random,
    /// Any candidate that was not chosen before, as long as there is one
    NoRepeat,
}

/// What a criterion is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum About {
    /// The shape, or shape and pose together.
    Shape,
    /// The pose alone: the thesis switches to such a criterion when the pose is uncertain.
    Pose,
    /// Nothing.
    Chance,
}

impl Criterion {
    /// What it is about.
    pub fn about(self) -> About {
        match self {
            Criterion::Information
            | Criterion::Both
            | Criterion::Entropy
            | Criterion::VarianceSum
            | Criterion::Variance
            | Criterion::Igef => About::Shape,
            Criterion::Shannon
            | Criterion::Renyi
            | Criterion::MutualInformation
            | Criterion::Pose
            | Criterion::Kl
            | Criterion::DetSigma => About::Pose,
            Criterion::Random | Criterion::NoRepeat => About::Chance,
        }
    }

    /// What each set of contacts is worth, the more the better; nats for the information criteria.
    /// A grasp that touches nothing is worth 0, and so is every grasp to chance.
    pub fn scores(self, belief: &Belief, grasps: &[Vec<Expected>]) -> Vec<f64> {
        match self {
            Criterion::Random | Criterion::NoRepeat => vec![0.0; grasps.len()],
            Criterion::Igef => grasps.iter().map(|g| igef(belief, g)).collect(),
            _ => self.worth(belief, &Prediction::of(&belief.surface, grasps.to_vec())),
        }
    }

    /// The same for grasps about whose contacts is known already what the surface says.
    pub fn worth(self, belief: &Belief, prediction: &Prediction) -> Vec<f64> {
        let Prediction { contacts: grasps, covariances } = prediction;
        let measured = |measure| pose_gain::gains(belief, prediction, measure);
        let pairs = grasps.iter().zip(covariances);
        match self {
            Criterion::Random | Criterion::NoRepeat => vec![0.0; grasps.len()],
            Criterion::Igef => grasps.iter().map(|g| igef(belief, g)).collect(),
            Criterion::MutualInformation => pairs.map(|(g, s)| about_pose(belief, g, s)).collect(),
            Criterion::Shannon => measured(PoseMeasure::Shannon),
            Criterion::Renyi => measured(PoseMeasure::Renyi(ALPHA)),
            Criterion::Kl => measured(PoseMeasure::Divergence),
            Criterion::DetSigma => measured(PoseMeasure::Determinant),
            Criterion::Variance | Criterion::VarianceSum => {
                pairs.map(|(g, s)| self.spread(g, s)).collect()
            }
            Criterion::Information | Criterion::Pose | Criterion::Both | Criterion::Entropy => {
                pairs.map(|(g, s)| self.information(belief, g, s.clone())).collect()
            }
        }
    }

    /// Variances times the chance to see them.
    fn spread(self, contacts: &[Expected], covariance: &DMatrix<f64>) -> f64 {
        let diagonal = covariance.diagonal();
        let worth = diagonal.iter().zip(contacts).map(|(v, e)| v.max(0.0) * e.chance);
        if self == Criterion::Variance { worth.fold(0.0, f64::max) } else { worth.sum() }
    }

    /// ½ log det(I + S + J Σ Jᵀ) − ½ log det(I + J Σ Jᵀ) in units of the contacts' noise, S the joint
    /// covariance of the surface at the contacts and J Σ Jᵀ what the doubt about the pose does to them:
    /// what the grasp says about the shape, the pose being a nuisance. Without that doubt it is the
    /// joint entropy. Of the pose, the shape being the nuisance, ½ log det(I + S + J Σ Jᵀ) −
    /// ½ log det(I + S).
    fn information(self, belief: &Belief, contacts: &[Expected], mut s: DMatrix<f64>) -> f64 {
        let noise = belief.noise.0;
        let unit: Vec<f64> = contacts.iter().map(|e| e.chance.max(1e-6).sqrt() / noise).collect();
        let moved = |i: usize, j: usize| match self {
            Criterion::Entropy => 0.0,
            _ => (row(&contacts[i]).transpose() * belief.covariance * row(&contacts[j]))[0],
        };
        let n = contacts.len();
        let pose = DMatrix::from_fn(n, n, |i, j| {
            moved(i, j) * unit[i] * unit[j] + f64::from(u8::from(i == j))
        });
        s.iter_mut().enumerate().for_each(|(k, v)| *v *= unit[k % n] * unit[k / n]);
        let all = half_log_determinant(&pose + &s);
        let about_pose = |s: DMatrix<f64>| all - half_log_determinant(s + DMatrix::identity(n, n));
        match self {
            Criterion::Pose => about_pose(s),
            Criterion::Both => all - half_log_determinant(pose) + about_pose(s),
            _ => all - half_log_determinant(pose),
        }
    }
}

/// How a contact's distance to the surface changes with the pose: translation, then rotation.
pub(super) fn row(expected: &Expected) -> Vector6<f64> {
    let (n, m) = (expected.normal, expected.point.cross(&expected.normal));
    Vector6::new(n.x, n.y, n.z, m.x, m.y, m.z)
}

/// ½ log det, 0 for a matrix that has none.
fn half_log_determinant(matrix: DMatrix<f64>) -> f64 {
    matrix.cholesky().map_or(0.0, |c| c.l_dirty().diagonal().iter().map(|d| d.ln()).sum())
}

/// Mutual information of the pose and the contacts of a grasp: ½ log det(I + Σ Jᵀ R⁻¹ J), the shape's
/// own doubt being part of R.
fn about_pose(belief: &Belief, contacts: &[Expected], covariance: &DMatrix<f64>) -> f64 {
    let (point, normal) = belief.noise;
    let mut information = Matrix6::zeros();
    for (e, v) in contacts.iter().zip(covariance.diagonal().iter()) {
        let h = row(e);
        information += h * h.transpose() * (e.chance / (point * point + v.max(0.0)));
        // The normal turns with the object about every axis but itself.
        let mut turns = Matrix6::zeros();
        let across = nalgebra::Matrix3::identity() - e.normal * e.normal.transpose();
        turns.fixed_view_mut::<3, 3>(3, 3).copy_from(&across);
        information += turns * (e.chance / (normal * normal));
    }
    let Some(root) = root(&belief.covariance) else { return 0.0 };
    let seen = Matrix6::identity() + root.transpose() * information * root;
    seen.cholesky().map_or(0.0, |c| c.l_dirty().diagonal().iter().map(|d| d.ln()).sum())
}

/// A square root of a covariance that may be singular.
pub(super) fn root(covariance: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let eigen = covariance.symmetric_eigen();
    let finite = eigen.eigenvalues.iter().all(|v| v.is_finite());
    finite.then(|| {
        eigen.eigenvectors * Matrix6::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()))
    })
}

/// Σ over the contacts of Ψ₁Ψ₂Ψ₃Ψ₄ (4.11–4.15). The current contact is the one felt nearest to the
/// target; the path over the surface from it is taken for the arc of a circle that has both normals,
/// and is in radii of the object.
fn igef(belief: &Belief, contacts: &[Expected]) -> f64 {
    let scale = belief.radius;
    let [sigma_1, sigma_3, mu_3, sigma_4] = IGEF;
    let one = |e: &Expected| {
        let nearest = belief
            .contacts
            .iter()
            .min_by(|a, b| (a.point - e.point).norm().total_cmp(&(b.point - e.point).norm()));
        let Some(Contact { point, normal, .. }) = nearest else { return 0.0 };
        let chord = (point - e.point).norm() / scale;
        let cosine = normal.map_or(1.0, |n| n.dot(&e.normal).clamp(-1.0, 1.0));
        let half = (0.5 * cosine.acos()).max(1e-3);
        let path = (chord * half / half.sin()).max(1e-2);
        let far = 1.0 - (-(chord / sigma_1).powi(2)).exp();
        let near = (-((chord - mu_3) / sigma_3).powi(2)).exp();
        // sin²(½ acos c) = (1 − c)/2
        let turn = (-(1.0 - cosine) / (sigma_4 * sigma_4)).exp();
        e.chance * far / path * near * turn
    };
    contacts.iter().map(one).sum()
}

/// The best of some scores, never one that is left out; ties by the lower index. `None` where nothing
/// is left.
pub fn best(scores: &[f64], left_out: impl Fn(usize) -> bool) -> Option<usize> {
    let open = (0..scores.len()).filter(|i| !left_out(*i) && !scores[*i].is_nan());
    open.reduce(|best, i| if scores[i] > scores[best] { i } else { best })
}

/// det of a pose's covariance, rotations as arcs at the object's radius, as the deviation in metres
/// of one degree of freedom: the (2·dof)-th root (4.21; the determinant itself mixes units).
pub fn pose_deviation(belief: &Belief, covariance: &Matrix6<f64>) -> f64 {
    let axes: &[usize] = if belief.dimension == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let scale = |axis: usize| if axis < 3 { 1.0 } else { belief.radius };
    let d = axes.len();
    let matrix = DMatrix::from_fn(d, d, |i, j| {
        let (a, b) = (axes[i], axes[j]);
        covariance[(a, b)] * scale(a) * scale(b)
    });
    let values: DVector<f64> = matrix.symmetric_eigenvalues();
    let product: f64 = values.iter().map(|v| v.max(0.0)).product();
    product.powf(0.5 / d as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::placement::fixed;
    use crate::explore::prediction::predict;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    fn belief() -> Belief {
        let options =
            Options { grasps: Some(1), ..Options::new("ellipse:0.1x0.06".parse().unwrap()) };
        let log = simulate(&options).unwrap().log;
        Belief::new(&log, &track::truth(&log).unwrap()).unwrap()
    }

    #[test]
    fn doubt_about_the_pose_leaves_less_to_learn_about_the_shape() {
        let mut belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        assert!(grasps.iter().any(|g| g.len() >= 3));
        assert!(grasps.iter().flatten().all(|e| (0.0..=1.0).contains(&e.chance)));
        belief.covariance = Matrix6::zeros();
        let entropy = Criterion::Entropy.scores(&belief, &grasps);
        let certain = Criterion::Information.scores(&belief, &grasps);
        belief.covariance = Matrix6::from_diagonal(&Vector6::new(1e-4, 1e-4, 0.0, 0.0, 0.0, 0.1));
        let doubtful = Criterion::Information.scores(&belief, &grasps);
        let pose = Criterion::MutualInformation.scores(&belief, &grasps);
        for i in 0..grasps.len() {
            assert!((entropy[i] - certain[i]).abs() < 1e-9);
            assert!(doubtful[i] >= 0.0 && doubtful[i] <= certain[i] + 1e-9, "{i}");
            assert!(pose[i] > 0.0 || grasps[i].is_empty());
        }
    }

    #[test]
    fn every_criterion_gives_numbers_and_nothing_for_nothing() {
        use clap::ValueEnum;
        let belief = belief();
        let mut grasps = predict(&belief, &fixed(2, &belief.centre));
        grasps.push(Vec::new());
        for criterion in Criterion::value_variants() {
            let scores = criterion.scores(&belief, &grasps);
            assert_eq!(scores.len(), grasps.len());
            assert!(
                scores.iter().all(|s| s.is_finite() && *s >= -1e-9),
                "{criterion:?} {scores:?}"
            );
            assert!(scores.last().unwrap().abs() < 1e-12, "{criterion:?}");
        }
    }

    #[test]
    fn what_is_already_felt_is_worth_less() {
        let belief = belief();
        let at = |c: &Contact| Expected {
            finger: 0,
            point: c.point,
            normal: c.normal.unwrap(),
            chance: 1.0,
        };
        let felt = belief.contacts.iter().map(at).collect::<Vec<_>>();
        let far: Vec<Expected> = belief
            .geometry
            .samples(60)
            .into_iter()
            .filter(|(p, _)| belief.contacts.iter().all(|c| (c.point - p).norm() > 0.02))
            .take(felt.len())
            .map(|(point, normal)| Expected { finger: 0, point, normal, chance: 1.0 })
            .collect();
        for criterion in [Criterion::Entropy, Criterion::VarianceSum, Criterion::Variance] {
            let scores = criterion.scores(&belief, &[felt.clone(), far.clone()]);
            assert!(scores[1] > 2.0 * scores[0], "{criterion:?} {scores:?}");
        }
    }

    #[test]
    fn best_takes_the_greatest_that_may_be_taken() {
        let scores = [1.0, 3.0, f64::NAN, 3.0, 2.0];
        assert_eq!(best(&scores, |_| false), Some(1));
        assert_eq!(best(&scores, |i| i == 1), Some(3));
        assert_eq!(best(&scores, |_| true), None);
        assert_eq!(best(&[], |_| false), None);
        assert_eq!(best(&[f64::NAN], |_| false), None);
    }
}
