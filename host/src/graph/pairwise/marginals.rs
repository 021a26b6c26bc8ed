//! How uncertain the poses of a small graph are. Grasps are few: the information matrix is inverted as
//! it is.

use nalgebra::{DMatrix, SMatrix};

use crate::graph::pose::{Group, PoseGraph};

/// The covariance of a pose in tangent coordinates, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt<const D: usize> {
    /// In the frame of the fixed poses.
    pub marginal: SMatrix<f64, D, D>,
    /// If all other poses were known.
    pub given_others: SMatrix<f64, D, D>,
}

/// Of every pose, none for the fixed ones; `None` where the graph leaves a pose open.
pub fn marginals<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Option<Vec<Doubt<D>>> {
    let free: Vec<Option<usize>> = {
        let mut next = 0;
        let mut number = |pose: usize| {
            let free = !graph.fixed.contains(&pose);
            next += usize::from(free);
            free.then(|| next - 1)
        };
        (0..graph.poses.len()).map(&mut number).collect()
    };
    let unknown = D * free.iter().flatten().count();
    let mut information = DMatrix::<f64>::zeros(unknown, unknown);
    for edge in &graph.edges {
        let (from, to) = (graph.poses.get(edge.from)?, graph.poses.get(edge.to)?);
        let by = G::linearise(from, to, &edge.measured);
        let ends = [(free[edge.from], by.from), (free[edge.to], by.to)];
        for (row, left) in &ends {
            for (column, right) in &ends {
                if let (Some(row), Some(column)) = (row, column) {
                    let mut block = information.fixed_view_mut::<D, D>(D * row, D * column);
                    block += left.transpose() * edge.information * right;
                }
            }
        }
    }
    let inverse = information.clone().cholesky()?.inverse();
    let none = Doubt { marginal: SMatrix::zeros(), given_others: SMatrix::zeros() };
    let doubt = |free: &Option<usize>| {
        let Some(at) = free.map(|f| D * f) else { return Some(none) };
        let own: SMatrix<f64, D, D> = information.fixed_view::<D, D>(at, at).into_owned();
        Some(Doubt {
            marginal: inverse.fixed_view::<D, D>(at, at).into_owned(),
            given_others: own.cholesky()?.inverse(),
        })
    };
    free.iter().map(doubt).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::graph::pose::{Edge, Se2};

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
        assert!((chain[1].given_others - Matrix3::identity() / 6.0).norm() < 1e-12);
        graph.edges.push(edge(0, 2, 4.0));
        // 1/(1/0.75 + 4).
        let closed = marginals(&graph).unwrap();
        assert!((closed[2].marginal[(0, 0)] - 0.1875).abs() < 1e-12);
        graph.edges.truncate(1);
        assert!(marginals(&graph).is_none(), "nothing holds the third");
    }
}
