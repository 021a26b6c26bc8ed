//! Where a particle may have gone, given its faces and the grasp: FastSLAM 2.0's proposal.
//!
//! From several starts about the predicted pose, Gauss–Newton steps climb to the nearest maximum of
//! the posterior; contacts choose their faces anew at every step, at first as if contacts were
//! blurred (annealing). The Laplace approximations at the maxima, each in proportion to its
//! evidence, are the proposal that the new pose is drawn from. Its weight is then exact:
//! likelihood × motion prior / proposal density (Montemerlo et al. 2003).

use super::face::{Faceted, Felt};
use super::shape::{Residual, View};
use crate::contact::GraspView;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::random::Random;
use crate::space::{Pose, Space};
use crate::track::MotionNoise;

/// Starts of the search, one of them the predicted pose.
pub(super) const STARTS: usize = 3;

/// Blur of the contacts in parts of the motion's variance, step by step.
const BLUR: [f32; 6] = [0.3, 0.06, 0.01, 0.0, 0.0, 0.0];

/// Least weight of a contact's nearest face while contacts are blurred: a weak pull.
const PULL: f32 = 0.02;

/// Longest step: metres and radians.
const STEP: [f32; 2] = [0.03, 0.35];

/// A step shorter than this (standard deviations, squared) is the last: a hundredth of what the draw
/// adds to the pose.
const SETTLED: f32 = 0.01;

/// Proposals are this much wider than the Laplace approximation (variance): tails that are too thin
/// make weights wild.
const WIDER: f32 = 1.2;

/// Least share of the motion alone in a proposal, of that of the likeliest maximum.
const DEFENCE: f32 = 0.01;

/// Maxima closer than this (standard deviations, squared) are one.
const SAME: f32 = 1.0;

/// Gaussian belief about a pose before the grasp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior<S: Space> {
    pub mean: S::Pose,
    pub noise: MotionNoise,
}

impl<S: Space> Prior<S> {
    /// A motion without noise is taken to have 10 µm and 0.006°.
    fn information(&self, axis: usize) -> f32 {
        let deviation = if axis < S::DIMENSION {
            math::max(self.noise.translation, 1e-5)
        } else {
            math::max(self.noise.rotation, 1e-4)
        };
        1.0 / (deviation * deviation)
    }

    /// Log density with respect to the volume of poses.
    pub fn log_density(&self, pose: &S::Pose) -> f32 {
        let apart = self.mean.local(pose);
        let mut log = 0.0;
        for axis in 0..S::FREEDOM {
            let information = self.information(axis);
            log -= 0.5 * (apart[axis] * apart[axis] * information - math::ln(information));
        }
        log - S::FREEDOM as f32 * HALF_LN_TAU - log_volume::<S>(apart)
    }
}

const HALF_LN_TAU: f32 = 0.918_938_5;

/// Logarithm of the volume of rotations that a unit volume of rotation vectors at `tangent` covers:
/// 2(1 − cos θ)/θ² in space, 1 in the plane.
fn log_volume<S: Space>(tangent: S::Tangent) -> f32 {
    if S::DIMENSION == 2 {
        return 0.0;
    }
    let mut squared = 0.0;
    for axis in S::DIMENSION..S::FREEDOM {
        squared += tangent[axis] * tangent[axis];
    }
    if squared < 1e-2 {
        return squared * (-1.0 / 12.0);
    }
    let (sin, _) = math::sin_cos(0.5 * math::sqrt(squared));
    math::ln(4.0 * sin * sin / squared)
}

/// How a grasp goes together with a shape at a pose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Agreement {
    /// Log likelihood.
    pub log: f32,
    /// Contacts that lie on known faces, and those that nothing explains.
    pub fitting: u32,
    /// See [`Explanation::strange`](super::shape::Explanation).
    pub strange: u32,
}

/// The likelihood of a grasp: its contacts and where fingers met nothing.
pub(super) fn agreement<S: Faceted, const FACES: usize>(
    view: &View<S, FACES>,
    pose: &S::Pose,
    grasp: &GraspView<'_, S>,
) -> Agreement {
    let mut agreement = Agreement::default();
    for contact in grasp.usable() {
        let explained = view.explain(&Felt::at(pose, &contact));
        agreement.log += explained.log;
        agreement.fitting += u32::from(explained.fits);
        agreement.strange += u32::from(explained.strange);
    }
    agreement.log += free::<S, FACES>(view, pose, grasp);
    agreement
}

/// Log likelihood of the fingers that met nothing.
pub(super) fn free<S: Faceted, const FACES: usize>(
    view: &View<S, FACES>,
    pose: &S::Pose,
    grasp: &GraspView<'_, S>,
) -> f32 {
    let points = grasp.free.iter().map(|f| f.point).filter(|p| p.is_finite());
    points.map(|p| view.free(pose.untransform(p))).sum()
}

/// One maximum of the posterior and its Laplace approximation.
#[derive(Clone, Copy, Debug)]
struct Peak<S: Space> {
    pose: S::Pose,
    /// Lower Cholesky factor of the information.
    factor: S::Covariance,
    /// ln √det of the information.
    log_root: f32,
    /// Evidence of this maximum, then its share.
    share: f32,
}

impl<S: Space> Peak<S> {
    const UNSET: Self =
        Peak { pose: S::Pose::UNSET, factor: S::Covariance::ZERO, log_root: 0.0, share: 0.0 };

    /// The motion prior itself.
    fn of(prior: &Prior<S>) -> Self {
        let mut peak = Peak { pose: prior.mean, ..Self::UNSET };
        for axis in 0..S::FREEDOM {
            let root = math::sqrt(prior.information(axis));
            *peak.factor.at_mut(axis, axis) = root;
            peak.log_root += math::ln(root);
        }
        peak
    }

    /// Squared distance of a pose in standard deviations.
    fn distance(&self, tangent: S::Tangent) -> f32 {
        transposed::<S>(&self.factor, tangent).norm_squared()
    }

    fn log_density(&self, pose: &S::Pose) -> f32 {
        let apart = self.pose.local(pose);
        let freedom = S::FREEDOM as f32;
        self.log_root
            - 0.5 * self.distance(apart) / WIDER
            - freedom * (HALF_LN_TAU + 0.5 * math::ln(WIDER))
            - log_volume::<S>(apart)
    }
}

/// A pose drawn for a particle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn<S: Space> {
    pub pose: S::Pose,
    /// ln(likelihood × prior / proposal density): what it changes the particle's weight by.
    pub log_weight: f32,
    pub agreement: Agreement,
}

/// Draws a new pose for a particle that knows `view`. `start(k)` is where the k-th search begins.
pub(super) fn draw<S: Faceted, const FACES: usize>(
    view: &View<S, FACES>,
    prior: &Prior<S>,
    grasp: &GraspView<'_, S>,
    random: &mut Random,
    mut start: impl FnMut(usize, &mut Random) -> S::Pose,
) -> Option<Drawn<S>> {
    let mut peaks = [Peak::<S>::UNSET; STARTS + 1];
    let mut count = 0;
    for k in 0..STARTS {
        let start = start(k, random);
        let Some(mut peak) = climb(view, prior, grasp, start) else { continue };
        let known = peaks.iter().take(count);
        if known.clone().any(|p| p.distance(p.pose.local(&peak.pose)) < SAME) {
            continue;
        }
        // Laplace's evidence: the height of the maximum times the volume below it.
        peak.share = agreement(view, &peak.pose, grasp).log + prior.log_density(&peak.pose)
            - peak.log_root
            + S::FREEDOM as f32 * HALF_LN_TAU;
        if peak.share.is_finite() {
            peaks[count] = peak;
            count += 1;
        }
    }
    // The motion alone, as if no contact were on a known face: never much less probable than all else,
    // so that no pose is left without a proposal.
    let mut alone = Peak::of(prior);
    let unknown = math::ln(view.unknown());
    alone.share = grasp.usable().map(|_| unknown).sum::<f32>() + free(view, &alone.pose, grasp);
    let greatest = peaks.iter().take(count).fold(alone.share, |most, p| math::max(most, p.share));
    alone.share = math::max(alone.share, greatest + math::ln(DEFENCE));
    peaks[count] = alone;
    let peaks = peaks.get_mut(..count + 1)?;
    let mut total = 0.0;
    for peak in peaks.iter_mut() {
        peak.share = math::exp(peak.share - greatest);
        total += peak.share;
    }
    let mut ticket = random.uniform() * total;
    let deviate: S::Tangent = random.normal();
    let mut chosen = peaks.first()?;
    for peak in peaks.iter() {
        chosen = peak;
        ticket -= peak.share;
        if ticket <= 0.0 {
            break;
        }
    }
    let step = back_substituted::<S>(&chosen.factor, deviate) * math::sqrt(WIDER);
    let pose = chosen.pose.retract(step);
    let mut density = 0.0;
    let own = chosen.log_density(&pose);
    for peak in peaks.iter() {
        density += peak.share / total * math::exp(math::min(peak.log_density(&pose) - own, 80.0));
    }
    let agreement = agreement(view, &pose, grasp);
    let log_weight = agreement.log + prior.log_density(&pose) - own - math::ln(density);
    (log_weight.is_finite() && pose.is_finite()).then_some(Drawn { pose, log_weight, agreement })
}

/// Gauss–Newton from `start`; `None` when the numbers fail.
fn climb<S: Faceted, const FACES: usize>(
    view: &View<S, FACES>,
    prior: &Prior<S>,
    grasp: &GraspView<'_, S>,
    start: S::Pose,
) -> Option<Peak<S>> {
    let mut pose = start;
    let mut settled = None;
    for blur in BLUR {
        let (information, right) = normal_equations(view, prior, grasp, &pose, blur);
        let factor = cholesky::<S>(&information)?;
        let mut step = back_substituted::<S>(&factor, substituted::<S>(&factor, right));
        let moved = transposed::<S>(&factor, step).norm_squared();
        let lengths = split::<S>(step);
        let mut shorten: f32 = 1.0;
        for (length, longest) in lengths.iter().zip(STEP) {
            if *length > longest {
                shorten = math::min(shorten, longest / length);
            }
        }
        step = step * shorten;
        pose = pose.retract(step);
        if blur == 0.0 && moved < SETTLED {
            settled = Some(factor);
            break;
        }
    }
    let factor = match settled {
        Some(factor) => factor,
        None => cholesky::<S>(&normal_equations(view, prior, grasp, &pose, 0.0).0)?,
    };
    let mut log_root = 0.0;
    for i in 0..S::FREEDOM {
        log_root += math::ln(factor.at(i, i));
    }
    (pose.is_finite() && log_root.is_finite()).then_some(Peak {
        pose,
        factor,
        log_root,
        share: 0.0,
    })
}

/// Lengths of a tangent's translation and rotation.
fn split<S: Space>(tangent: S::Tangent) -> [f32; 2] {
    let mut squares = [0.0; 2];
    for axis in 0..S::FREEDOM {
        squares[usize::from(axis >= S::DIMENSION)] += tangent[axis] * tangent[axis];
    }
    squares.map(math::sqrt)
}

/// Information (lower triangle) and right-hand side of a Gauss–Newton step in the tangent at `pose`.
fn normal_equations<S: Faceted, const FACES: usize>(
    view: &View<S, FACES>,
    prior: &Prior<S>,
    grasp: &GraspView<'_, S>,
    pose: &S::Pose,
    blur: f32,
) -> (S::Covariance, S::Tangent) {
    let mut information = S::Covariance::ZERO;
    let back = pose.local(&prior.mean);
    let mut right = S::Tangent::ZERO;
    for axis in 0..S::FREEDOM {
        let weight = prior.information(axis);
        *information.at_mut(axis, axis) = weight;
        right[axis] = weight * back[axis];
    }
    let MotionNoise { translation, rotation } = prior.noise;
    let turned = blur * rotation * rotation;
    let moved = blur * translation * translation;
    for contact in grasp.usable() {
        let felt = Felt::at(pose, &contact);
        let blurred = [moved + turned * felt.point.norm_squared(), turned];
        let Some((plane, residual, mut share)) = view.nearest(&felt, blurred) else { continue };
        if blur > 0.0 {
            share = math::max(share, PULL);
        }
        let lever = S::lever(felt.point, plane.normal());
        let mut row = -lever;
        let mut rest = residual.height;
        if let Some(normal) = felt.normal {
            let rows = turns::<S>(normal, plane.basis());
            add_normal(&mut information, &mut right, &rows, &residual, share);
            for (k, turn) in rows.iter().enumerate().take(S::Along::LEN) {
                row += *turn * -residual.regression[k];
            }
            rest -= residual.regression.dot(residual.normal);
        }
        let weight = share / residual.variance[1];
        for i in 0..S::FREEDOM {
            for j in 0..=i {
                *information.at_mut(i, j) += weight * row[i] * row[j];
            }
            right[i] += -weight * row[i] * rest;
        }
    }
    (information, right)
}

/// How the coordinates of `normal` along `basis` change with the pose's tangent.
fn turns<S: Faceted>(normal: S::Vector, basis: &[S::Vector; 2]) -> [S::Tangent; 2] {
    basis.map(|b| {
        let mut turn = -S::lever(normal, b);
        for axis in 0..S::DIMENSION {
            turn[axis] = 0.0;
        }
        turn
    })
}

/// Adds the residual of a normal to the normal equations.
fn add_normal<S: Faceted>(
    information: &mut S::Covariance,
    right: &mut S::Tangent,
    rows: &[S::Tangent; 2],
    residual: &Residual<S>,
    share: f32,
) {
    for (k, a) in rows.iter().enumerate().take(S::Along::LEN) {
        for (l, b) in rows.iter().enumerate().take(S::Along::LEN) {
            let weight = share * residual.information.at(k, l);
            for i in S::DIMENSION..S::FREEDOM {
                for j in S::DIMENSION..=i {
                    *information.at_mut(i, j) += weight * a[i] * b[j];
                }
                right[i] += -weight * a[i] * residual.normal[l];
            }
        }
    }
}

/// Lower Cholesky factor of the matrix whose lower triangle is given.
fn cholesky<S: Space>(a: &S::Covariance) -> Option<S::Covariance> {
    let mut l = S::Covariance::ZERO;
    for i in 0..S::FREEDOM {
        for j in 0..=i {
            let mut sum = a.at(i, j);
            for k in 0..j {
                sum -= l.at(i, k) * l.at(j, k);
            }
            *l.at_mut(i, j) = if i != j {
                sum / l.at(j, j)
            } else if sum > 0.0 && sum.is_finite() {
                math::sqrt(sum)
            } else {
                return None;
            };
        }
    }
    Some(l)
}

/// L⁻¹b.
fn substituted<S: Space>(l: &S::Covariance, b: S::Tangent) -> S::Tangent {
    let mut x = b;
    for i in 0..S::FREEDOM {
        for k in 0..i {
            x[i] -= l.at(i, k) * x[k];
        }
        x[i] /= l.at(i, i);
    }
    x
}

/// L⁻ᵀb.
fn back_substituted<S: Space>(l: &S::Covariance, b: S::Tangent) -> S::Tangent {
    let mut x = b;
    for i in (0..S::FREEDOM).rev() {
        for k in i + 1..S::FREEDOM {
            x[i] -= l.at(k, i) * x[k];
        }
        x[i] /= l.at(i, i);
    }
    x
}

/// Lᵀv.
fn transposed<S: Space>(l: &S::Covariance, v: S::Tangent) -> S::Tangent {
    S::Tangent::from_fn(|i| {
        let mut sum = 0.0;
        for k in i..S::FREEDOM {
            sum += l.at(k, i) * v[k];
        }
        sum
    })
}
