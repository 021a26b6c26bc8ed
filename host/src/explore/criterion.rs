//! What a grasp is worth (thesis 4.4, as corrected): one number for the contacts it would give.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::belief::Belief;
use super::geodesic::Paths;
use super::pose_gain::{self, PoseMeasure};
use super::prediction::{Expected, Prediction};
use super::turning::Turning;
use crate::reference::Contact;
use crate::space::Point;

/// Usual order α of the Rényi entropy: heavy hypotheses count more than with Shannon's.
pub const ALPHA: f64 = 2.0;

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
    /// for and nothing is planned ahead, the chance to meet it in place of the second
    Both,
    /// Joint differential entropy of the surface at all contacts (4.8–4.10 over a whole grasp)
    Entropy,
    /// Sum of the surface's variances at the contacts (4.20)
    VarianceSum,
    /// Greatest variance of the surface at a contact (4.7)
    Variance,
    /// Information gain estimation function: far from contacts, near what is known (4.11–4.15), with
    /// the length of the path over the surface
    Igef,
    /// Expected fall of the Shannon entropy of the pose (4.2, 4.3)
    Shannon,
    /// Expected fall of the Rényi entropy of the pose (4.4), of the order --alpha
    Renyi,
    /// Mutual information of pose and contacts, Gaussian (4.5)
    MutualInformation,
    /// Expected divergence of the posterior pose from the prior one (4.6)
    Kl,
    /// Expected fall of ½ log det Σ of the pose (4.21)
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
            Criterion::Igef => igef(belief, grasps),
            _ => self.worth(belief, &Prediction::of(&belief.surface, grasps.to_vec())),
        }
    }

    /// Whether it counts in nats.
    pub fn is_in_nats(self) -> bool {
        !matches!(self, Criterion::VarianceSum | Criterion::Variance | Criterion::Igef)
            && self.about() != About::Chance
    }

    /// The same for grasps about whose contacts is known already what the surface says.
    pub fn worth(self, belief: &Belief, prediction: &Prediction) -> Vec<f64> {
        self.worth_of_order(ALPHA, belief, prediction)
    }

    /// The same with a Rényi entropy of order `alpha`, above 0.
    pub fn worth_of_order(self, alpha: f64, belief: &Belief, prediction: &Prediction) -> Vec<f64> {
        let Prediction { contacts: grasps, covariances } = prediction;
        let imagined = |measure| pose_gain::gains(belief, prediction, measure);
        match self {
            Criterion::Random | Criterion::NoRepeat => vec![0.0; grasps.len()],
            Criterion::Igef => igef(belief, grasps),
            Criterion::Shannon => imagined(PoseMeasure::Shannon),
            Criterion::Renyi => imagined(PoseMeasure::Renyi(alpha)),
            Criterion::Kl => imagined(PoseMeasure::Divergence),
            Criterion::DetSigma => imagined(PoseMeasure::Determinant),
            Criterion::Variance
            | Criterion::VarianceSum
            | Criterion::Information
            | Criterion::Pose
            | Criterion::Both
            | Criterion::Entropy
            | Criterion::MutualInformation => {
                let pairs = grasps.iter().zip(covariances);
                pairs.map(|(contacts, s)| self.of_surface(belief, contacts, s)).collect()
            }
        }
    }

    /// Of the criteria that look at the surface's covariance.
    fn of_surface(self, belief: &Belief, contacts: &[Expected], surface: &DMatrix<f64>) -> f64 {
        let variances = surface.diagonal();
        let seen = variances.iter().zip(contacts).map(|(v, e)| v.max(0.0) * e.chance);
        match self {
            Criterion::Variance => seen.fold(0.0, f64::max),
            Criterion::VarianceSum => seen.sum(),
            Criterion::MutualInformation => about_pose(belief, contacts, surface),
            _ => self.information(belief, contacts, surface.clone()),
        }
    }

    /// ½ log det(S + R) − ½ log det R, S the joint covariance of the surface at the contacts and R
    /// their [`noise`](Criterion::noise): with the doubt about the pose in R, what the grasp says about
    /// the shape, the pose being a nuisance; without it the joint entropy. Of the pose, the shape being
    /// the nuisance, ½ log det(S + R) − ½ log det(S + R₀), R₀ the contacts' own noise.
    fn information(self, belief: &Belief, contacts: &[Expected], mut s: DMatrix<f64>) -> f64 {
        // In units of the contacts' noise.
        let unit: Vec<f64> = contacts.iter().map(|e| 1.0 / deviation(belief, e)).collect();
        let n = contacts.len();
        let mut noise = self.noise(belief, contacts);
        noise.iter_mut().enumerate().for_each(|(k, v)| *v *= unit[k % n] * unit[k / n]);
        s.iter_mut().enumerate().for_each(|(k, v)| *v *= unit[k % n] * unit[k / n]);
        let all = half_log_determinant(&noise + &s);
        let about_pose = |s: DMatrix<f64>| all - half_log_determinant(s + DMatrix::identity(n, n));
        match self {
            Criterion::Pose => about_pose(s),
            Criterion::Both => all - half_log_determinant(noise) + about_pose(s),
            _ => all - half_log_determinant(noise),
        }
    }

    /// Covariance of what the contacts will say about the surface, m²: their own noise, and for
    /// [`Criterion::Information`] what the doubt about the pose does to them, J Σ Jᵀ.
    pub(super) fn noise(self, belief: &Belief, contacts: &[Expected]) -> DMatrix<f64> {
        let n = contacts.len();
        DMatrix::from_fn(n, n, |i, j| {
            let own = if i == j { deviation(belief, &contacts[i]).powi(2) } else { 0.0 };
            match self {
                Criterion::Information | Criterion::Pose | Criterion::Both => {
                    own + row(&contacts[i]).dot(&(belief.covariance * row(&contacts[j])))
                }
                _ => own,
            }
        })
    }
}

/// Of a contact's noise, metres; large where there may be no contact.
fn deviation(belief: &Belief, contact: &Expected) -> f64 {
    belief.noise.0 / contact.chance.max(1e-6).sqrt()
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
fn about_pose(belief: &Belief, contacts: &[Expected], surface: &DMatrix<f64>) -> f64 {
    let information = pose_information(belief, contacts, surface);
    let Some(root) = root(&belief.covariance) else { return 0.0 };
    let seen = Matrix6::identity() + root.transpose() * information * root;
    seen.cholesky().map_or(0.0, |c| c.l_dirty().diagonal().iter().map(|d| d.ln()).sum())
}

/// Jᵀ R⁻¹ J: what the contacts, distances and normals, say about the pose where the surface has this
/// covariance.
pub(super) fn pose_information(
    belief: &Belief,
    contacts: &[Expected],
    surface: &DMatrix<f64>,
) -> Matrix6<f64> {
    let (point, _) = belief.noise;
    let mut information = Matrix6::zeros();
    for (e, v) in contacts.iter().zip(surface.diagonal().iter()) {
        let h = row(e);
        information += h * h.transpose() * (e.chance / (point * point + v.max(0.0)));
    }
    information + normals_see(belief, contacts)
}

/// What the contacts' normals say about the pose, each as likely as its chance: [`Turning`].
pub(super) fn normals_see(belief: &Belief, contacts: &[Expected]) -> Matrix6<f64> {
    let points: Vec<Point> = contacts.iter().map(|e| e.point).collect();
    let mut information = Matrix6::zeros();
    for (e, bend) in contacts.iter().zip(belief.bends(&points)) {
        let weight = e.chance / belief.noise.1.powi(2);
        for Turning { row, .. } in Turning::of(belief.dimension, &e.point, &e.normal, &bend) {
            information += row * row.transpose() * weight;
        }
    }
    information
}

/// A square root of a covariance that may be singular.
pub(super) fn root(covariance: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    // The decomposition of what is not finite need not end.
    if !covariance.iter().all(|v| v.is_finite()) {
        return None;
    }
    let eigen = covariance.symmetric_eigen();
    Some(eigen.eigenvectors * Matrix6::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt())))
}

/// Σ over the contacts of each grasp of Ψ₁Ψ₂Ψ₃Ψ₄ (4.11–4.15). The current contact is the one felt
/// nearest to the target by the path over the believed surface; lengths are in radii of the object.
fn igef(belief: &Belief, grasps: &[Vec<Expected>]) -> Vec<f64> {
    let felt: Vec<Point> = belief.contacts.iter().map(|c| c.point).collect();
    let paths = Paths::new(&belief.geometry, &felt);
    let one = |e: &Expected| e.chance * igef_at(belief, &paths, &e.point, &e.normal);
    grasps.iter().map(|g| g.iter().map(one).sum()).collect()
}

/// Ψ (4.15) of a target on the believed surface with its unit normal; 0 where no path leads there. The
/// paths start at the contacts of the belief.
pub fn igef_at(belief: &Belief, paths: &Paths<'_>, target: &Point, normal: &Point) -> f64 {
    let [sigma_1, sigma_3, mu_3, sigma_4] = IGEF;
    let Some((from, path)) = paths.to(target) else { return 0.0 };
    let Some(Contact { point, normal: felt, .. }) = belief.contacts.get(from) else { return 0.0 };
    let chord = (point - target).norm() / belief.radius;
    let path = (path / belief.radius).max(1e-2);
    let cosine = felt.map_or(1.0, |n| n.dot(normal).clamp(-1.0, 1.0));
    let far = 1.0 - (-(chord / sigma_1).powi(2)).exp();
    let near = (-((chord - mu_3) / sigma_3).powi(2)).exp();
    // 2 sin²(½ acos c) = 1 − c
    let turn = (-(1.0 - cosine) / (sigma_4 * sigma_4)).exp();
    far / path * near * turn
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
    fn gains_are_never_losses_and_renyi_meets_shannon() {
        let mut belief = belief();
        let grasps = predict(&belief, &fixed(2, &belief.centre));
        for spread in [1e-6, 1e-5, 1e-4] {
            belief.covariance =
                Matrix6::from_diagonal(&Vector6::new(spread, 2.0 * spread, 0.0, 0.0, 0.0, 0.02));
            for criterion in [Criterion::MutualInformation, Criterion::Kl, Criterion::Information] {
                let scores = criterion.scores(&belief, &grasps);
                assert!(scores.iter().all(|s| *s >= 0.0), "{criterion:?} {scores:?}");
            }
            let shannon = Criterion::Shannon.scores(&belief, &grasps);
            let prediction = Prediction::of(&belief.surface, grasps.clone());
            let near = Criterion::Renyi.worth_of_order(1.0 + 1e-4, &belief, &prediction);
            let far = Criterion::Renyi.worth_of_order(5.0, &belief, &prediction);
            for i in 0..grasps.len() {
                assert!((near[i] - shannon[i]).abs() < 1e-3 * (1.0 + shannon[i]));
                // Against equally likely poses the fall grows with the order.
                assert!(far[i] >= shannon[i] - 1e-9);
            }
        }
    }

    #[test]
    fn the_poses_deviation_does_not_hang_on_the_frame_or_the_unit() {
        let mut belief = belief();
        let factor = Matrix6::from_fn(|i, j| ((i * 7 + j * 3) % 5) as f64 * 1e-3 - 1e-3);
        for dimension in [2, 3] {
            belief.dimension = dimension;
            belief.covariance = factor * factor.transpose() + Matrix6::identity() * 1e-6;
            let before = pose_deviation(&belief, &belief.covariance);
            assert!(before > 0.0);
            let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), 0.7);
            let mut turns = Matrix6::zeros();
            for at in [0, 3] {
                turns.fixed_view_mut::<3, 3>(at, at).copy_from(turn.matrix());
            }
            belief.covariance = turns * belief.covariance * turns.transpose();
            assert!(
                (pose_deviation(&belief, &belief.covariance) / before - 1.0).abs() < 1e-9,
                "{dimension}"
            );
            // Millimetres for metres: a thousand times the number.
            let unit = Matrix6::from_diagonal(&Vector6::new(1e3, 1e3, 1e3, 1.0, 1.0, 1.0));
            belief.covariance = unit * belief.covariance * unit;
            belief.radius *= 1e3;
            assert!(
                (pose_deviation(&belief, &belief.covariance) / before - 1e3).abs() < 1e-6,
                "{dimension}"
            );
            belief.radius /= 1e3;
        }
    }

    #[test]
    fn the_way_to_the_far_side_leads_round_the_object() {
        let belief = belief();
        let far = Expected {
            finger: 0,
            point: belief.contacts[0].point,
            normal: belief.contacts[0].normal.unwrap(),
            chance: 1.0,
        };
        let felt: Vec<Point> = belief.contacts.iter().map(|c| c.point).collect();
        let paths = Paths::new(&belief.geometry, &felt);
        for (point, normal) in belief.geometry.samples(40) {
            let (from, path) = paths.to(&point).unwrap();
            // The fitted surface passes contacts within a few of their deviations.
            assert!(path >= (felt[from] - point).norm() - 5e-3);
            assert!(igef_at(&belief, &paths, &point, &normal) >= 0.0);
        }
        // Where it was felt there is nothing to learn.
        assert!(Criterion::Igef.scores(&belief, &[vec![far]])[0] < 0.05);
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
