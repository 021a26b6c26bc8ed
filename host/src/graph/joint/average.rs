//! The mean over graphs that differ in what is parallel or square.
//!
//! Whether two faces are square is often open: the odds are two or five, not a hundred. To take the
//! likelier graph then moves faces by the whole of what may be wrong; the mean over both, each as
//! plausible as it is, errs least in the mean square (Bayesian model averaging over the models in
//! Occam's window: Madigan & Raftery, Journal of the American Statistical Association 89, 1994).

use nalgebra::{DVector, SVector};

use super::arrow::Inverse;
use super::problem::State;
use super::solve::Solved;
use super::tangent::{Face, Tangent, axes, local, retract};

/// Nats behind the best from which on a graph is left out.
const WINDOW: f64 = 3.0;

/// Poses and faces in the mean, with their covariances, which hold how far the graphs are apart.
pub struct Averaged<const D: usize> {
    /// Without relations: in the mean they hold for a part only.
    pub state: State,
    /// Of poses, poses given the faces, and faces.
    pub covariance: Inverse<D>,
}

/// The mean of `best` and those `others` of the same faces and labels that are in its window. `None`
/// where a covariance does not exist.
pub fn averaged<const D: usize>(
    dimension: usize,
    best: &Solved<D>,
    others: &[Solved<D>],
) -> Option<Averaged<D>> {
    let alike = |other: &&Solved<D>| {
        other.labels == best.labels
            && other.state.faces.len() == best.state.faces.len()
            && other.cost < best.cost + WINDOW
    };
    let members: Vec<&Solved<D>> =
        std::iter::once(best).chain(others.iter().filter(alike)).collect();
    let weights: Vec<f64> = members.iter().map(|m| (best.cost - m.cost).exp()).collect();
    let total: f64 = weights.iter().sum();
    let inverses: Vec<Inverse<D>> =
        members.iter().map(|m| m.factor.inverse()).collect::<Option<_>>()?;
    let shares: Vec<f64> = weights.iter().map(|w| w / total).collect();

    let apart: Vec<Apart<D>> = members.iter().map(|m| Apart::of(dimension, best, m)).collect();
    let poses = best.state.poses.len();
    let mean_pose = |k: usize| -> Tangent {
        apart.iter().zip(&shares).map(|(a, share)| a.poses[k] * *share).sum()
    };
    let means: Vec<Tangent> = (0..poses).map(mean_pose).collect();
    let mut mean_faces = DVector::zeros(dimension * best.state.faces.len());
    for (a, share) in apart.iter().zip(&shares) {
        mean_faces += &a.faces * *share;
    }

    let mut covariance = inverses.first()?.clone();
    covariance.poses.iter_mut().chain(&mut covariance.given_faces).for_each(|c| c.fill(0.0));
    covariance.faces.fill(0.0);
    for ((inverse, apart), share) in inverses.iter().zip(&apart).zip(&shares) {
        for k in 1..poses {
            let off = apart.poses[k] - means[k];
            let off = SVector::<f64, D>::from_fn(|i, _| off[axes::<D>()[i]]);
            covariance.poses[k - 1] += (inverse.poses[k - 1] + off * off.transpose()) * *share;
            covariance.given_faces[k - 1] += inverse.given_faces[k - 1] * *share;
        }
        let off = &apart.faces - &mean_faces;
        covariance.faces += (&inverse.faces + &off * off.transpose()) * *share;
    }

    let moved = best.state.poses.iter().zip(&means).map(|(pose, mean)| retract(pose, mean));
    let turned = |(face, mean): (&Face, &[f64])| face.retract(dimension, mean);
    let faces = best.state.faces.iter().zip(mean_faces.as_slice().chunks(dimension)).map(turned);
    let state = State { poses: moved.collect(), faces: faces.collect(), relations: Vec::new() };
    Some(Averaged { state, covariance })
}

/// What takes one graph to another: tangents of the poses; turns and offsets of the faces.
struct Apart<const D: usize> {
    poses: Vec<Tangent>,
    faces: DVector<f64>,
}

impl<const D: usize> Apart<D> {
    fn of(dimension: usize, from: &Solved<D>, to: &Solved<D>) -> Apart<D> {
        let poses = from.state.poses.iter().zip(&to.state.poses).map(|(a, b)| local(a, b));
        let faces = from.state.faces.iter().zip(&to.state.faces).flat_map(|(a, b)| {
            let tangents = a.tangents(dimension);
            let turn = move |k: usize| {
                if k < dimension - 1 { tangents[k].dot(&b.normal) } else { b.offset - a.offset }
            };
            (0..dimension).map(turn)
        });
        let faces = DVector::from_iterator(dimension * from.state.faces.len(), faces);
        Apart { poses: poses.collect(), faces }
    }
}
