//! The mean over graphs that differ in what is parallel or square.
//!
//! Whether two faces are square is often open: the odds are two or five, not a hundred. To take the
//! likelier graph then moves faces by the whole of what may be wrong; the mean over both, each as
//! plausible as it is, errs least in the mean square (Bayesian model averaging over the models in
//! Occam's window: Madigan & Raftery, Journal of the American Statistical Association 89, 1994).

use nalgebra::{DMatrix, DVector, SVector};

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
        let own = &apart.turned * &inverse.faces * apart.turned.transpose();
        covariance.faces += (own + &off * off.transpose()) * *share;
    }

    let moved = best.state.poses.iter().zip(&means).map(|(pose, mean)| retract(pose, mean));
    let turned = |(face, mean): (&Face, &[f64])| face.retract(dimension, mean);
    let faces = best.state.faces.iter().zip(mean_faces.as_slice().chunks(dimension)).map(turned);
    let faces: Vec<Face> = faces.collect();
    let told = seen_from(dimension, &best.state.faces, &faces);
    covariance.faces = &told * &covariance.faces * told.transpose();
    let state = State { poses: moved.collect(), faces, relations: Vec::new() };
    Some(Averaged { state, covariance })
}

/// What takes one graph to another: tangents of the poses; turns and offsets of the faces.
struct Apart<const D: usize> {
    poses: Vec<Tangent>,
    faces: DVector<f64>,
    /// What the other's changes of its faces are in the tangents of the one's.
    turned: DMatrix<f64>,
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
        let turned = seen_from(dimension, &to.state.faces, &from.state.faces);
        Apart { poses: poses.collect(), faces, turned }
    }
}

/// What turns and offsets of the faces `from` are in the tangents of nearly the same faces `to`: a normal
/// that turns a little may have other [tangents](Face::tangents), a quarter turn away.
fn seen_from(dimension: usize, from: &[Face], to: &[Face]) -> DMatrix<f64> {
    let mut all = DMatrix::identity(dimension * from.len(), dimension * from.len());
    for (j, (one, other)) in from.iter().zip(to).enumerate() {
        let [old, new] = [one, other].map(|face| face.tangents(dimension));
        for i in 0..dimension - 1 {
            for k in 0..dimension - 1 {
                all[(dimension * j + i, dimension * j + k)] = new[i].dot(&old[k]);
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Point;

    #[test]
    fn turns_stay_what_they_are_in_other_tangents() {
        // Which of y and z is the least component differs.
        let face =
            |y: f64, z: f64| Face { normal: Point::new(1.0, y, z).normalize(), offset: 0.05 };
        let (one, other) = (face(0.004, 0.005), face(0.005, 0.004));
        let [old, new] = [one, other].map(|f| f.tangents(3));
        assert!(old[0].dot(&new[0]).abs() < 0.01, "{old:?} {new:?}");
        let told = seen_from(3, &[one], &[other]);
        let covariance =
            DMatrix::from_row_slice(3, 3, &[4.0, 1.0, 0.5, 1.0, 9.0, 0.2, 0.5, 0.2, 1.0]);
        let turned = &told * &covariance * told.transpose();
        let variance = |of: &DMatrix<f64>, tangents: &[Point; 2], along: Point| {
            let h = DVector::from_vec(vec![tangents[0].dot(&along), tangents[1].dot(&along), 1.0]);
            (h.transpose() * of * h)[0]
        };
        for along in [Point::y(), Point::z(), Point::new(0.0, 3.0, -2.0)] {
            let (before, after) =
                (variance(&covariance, &old, along), variance(&turned, &new, along));
            assert!((before - after).abs() < 0.01 * before, "{along}: {before} {after}");
        }
    }
}
