//! How uncertain the poses of a small graph are, each for itself and beside the others.

use nalgebra::{Const, OMatrix, SMatrix};

use super::motion::{Motion, adjoint};
use crate::graph::joint::tangent::axes;
use crate::graph::pose::{self, PoseGraph};

/// Metres that count as a radian where poses are compared: half the size of what a hand grasps.
const RADIUS: f64 = 0.05;

/// The covariance of a pose in tangent coordinates, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt<const D: usize> {
    /// In the frame of the fixed poses.
    pub marginal: SMatrix<f64, D, D>,
    /// Beside the other poses, whatever all of them together are in the frame of the fixed ones: in
    /// the frame in which they move least (inner constraints: Meissl 1962).
    pub beside: SMatrix<f64, D, D>,
}

/// Of every pose, no marginal for the fixed ones; `None` where the graph leaves a pose open.
pub fn marginals<G: Motion<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Option<Vec<Doubt<D>>> {
    let count = graph.poses.len();
    let found = pose::marginals(graph).ok()?;
    // A part without a fixed pose would be held by its first.
    let open = |pose: &usize| found.pose(*pose).amax() == 0.0 && !graph.fixed.contains(pose);
    if (0..count).any(|pose| open(&pose)) {
        return None;
    }
    let covariance = found.joint(&(0..count).collect::<Vec<_>>());
    // How every pose moves, in its own axes, when all move together.
    let mut together = OMatrix::<f64, nalgebra::Dyn, Const<D>>::zeros(D * count);
    let mut weighed = together.clone();
    for (i, pose) in graph.poses.iter().enumerate() {
        let ad = adjoint(&pose.pose().inverse());
        let axes = axes::<D>();
        for row in 0..D {
            let weight = if row < G::DIMENSION { 1.0 } else { RADIUS * RADIUS };
            for column in 0..D {
                let entry = ad[(axes[row], axes[column])];
                together[(D * i + row, column)] = entry;
                weighed[(D * i + row, column)] = weight * entry;
            }
        }
    }
    let normal: SMatrix<f64, D, D> = weighed.tr_mul(&together);
    let common = normal.cholesky()?.inverse() * weighed.transpose();
    // P C Pᵀ with P = I − N A.
    let shared = &common * &covariance;
    let total: SMatrix<f64, D, D> = &shared * common.transpose();
    let doubt = |i: usize| {
        let marginal: SMatrix<f64, D, D> = covariance.fixed_view::<D, D>(D * i, D * i).into_owned();
        let own: SMatrix<f64, D, D> = together.fixed_rows::<D>(D * i).into_owned();
        let with: SMatrix<f64, D, D> = own * shared.fixed_columns::<D>(D * i);
        let beside = marginal - with - with.transpose() + own * total * own.transpose();
        Doubt { marginal, beside }
    };
    Some((0..count).map(doubt).collect())
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::graph::pose::{Edge, Group, Se2};

    #[test]
    fn variances_add_along_a_chain_and_a_loop_closes_them() {
        let edge = |from, to, weight: f64| Edge {
            from,
            to,
            measured: Se2::identity(),
            information: Matrix3::identity() * weight,
        };
        let mut graph = PoseGraph {
            ids: vec![0, 1, 2],
            poses: vec![Se2::identity(); 3],
            edges: vec![edge(0, 1, 4.0), edge(1, 2, 2.0)],
            fixed: vec![0],
        };
        let chain = marginals(&graph).unwrap();
        assert_eq!(chain[0].marginal, Matrix3::zeros());
        assert!((chain[1].marginal - Matrix3::identity() * 0.25).norm() < 1e-12);
        assert!((chain[2].marginal - Matrix3::identity() * 0.75).norm() < 1e-12);
        // The middle of three is known best beside the others: translations have the mean of all
        // taken out of them, here of 0, a and a + b with variances 1/4 and 1/2.
        let [first, middle, last] = [0, 1, 2].map(|i| chain[i].beside[(0, 0)]);
        assert!((first - 0.75 / 9.0 * 2.0).abs() < 1e-9, "{first}");
        assert!(middle < first && first < last && last < chain[2].marginal[(0, 0)], "{chain:?}");
        graph.edges.push(edge(0, 2, 4.0));
        // 1/(1/0.75 + 4).
        let closed = marginals(&graph).unwrap();
        assert!((closed[2].marginal[(0, 0)] - 0.1875).abs() < 1e-12);
        graph.edges.truncate(1);
        assert!(marginals(&graph).is_none(), "nothing holds the third");
    }
}
