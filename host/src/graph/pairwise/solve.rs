//! INTERIM: dense Gauss-Newton until the pose graph optimiser is merged.
use nalgebra::{DMatrix, DVector, SVector};

use crate::graph::pose::{Group, PoseGraph};

fn normal<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> (DMatrix<f64>, DVector<f64>) {
    let n = graph.poses.len() * D;
    let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for edge in &graph.edges {
        let (x, y) = (graph.poses[edge.from], graph.poses[edge.to]);
        let e = G::error(&x, &y, &edge.measured);
        let mut j = nalgebra::DMatrix::<f64>::zeros(D, 2 * D);
        for k in 0..D {
            let step = 1e-6;
            let t = SVector::<f64, D>::from_fn(|i, _| if i == k { step } else { 0.0 });
            let a = (G::error(&x.retract(&t), &y, &edge.measured) - G::error(&x.retract(&-t), &y, &edge.measured)) / (2.0 * step);
            let b = (G::error(&x, &y.retract(&t), &edge.measured) - G::error(&x, &y.retract(&-t), &edge.measured)) / (2.0 * step);
            for r in 0..D { j[(r, k)] = a[r]; j[(r, D + k)] = b[r]; }
        }
        let om = DMatrix::from_fn(D, D, |r, c| edge.information[(r, c)]);
        let ev = DVector::from_fn(D, |r, _| e[r]);
        let hh = j.transpose() * &om * &j;
        let gg = j.transpose() * &om * &ev;
        let at = |k: usize| if k < D { edge.from * D + k } else { edge.to * D + k - D };
        for r in 0..2 * D { g[at(r)] += gg[r]; for c in 0..2 * D { h[(at(r), at(c))] += hh[(r, c)]; } }
    }
    for f in &graph.fixed { for k in 0..D { let i = f * D + k; for c in 0..n { h[(i, c)] = 0.0; h[(c, i)] = 0.0; } h[(i, i)] = 1.0; g[i] = 0.0; } }
    (h, g)
}

pub fn solve<G: Group<D>, const D: usize>(graph: &mut PoseGraph<G, D>) -> Option<()> {
    for _ in 0..20 {
        let (h, g) = normal(graph);
        let step = h.cholesky()?.solve(&g);
        let before = graph.chi2();
        let poses = graph.poses.clone();
        let mut part = 1.0;
        loop {
            for (i, p) in poses.iter().enumerate() {
                graph.poses[i] = p.retract(&SVector::<f64, D>::from_fn(|k, _| -part * step[i * D + k]));
            }
            if graph.chi2() <= before * (1.0 + 1e-12) || part < 1e-3 { break; }
            part *= 0.5;
        }
        if step.norm() < 1e-10 { break; }
    }
    Some(())
}

/// Marginal covariance of every pose, and its covariance if all others were known.
pub fn covariances<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Option<Vec<[nalgebra::SMatrix<f64, D, D>; 2]>> {
    let (h, _) = normal(graph);
    let inverse = h.clone().cholesky()?.inverse();
    (0..graph.poses.len()).map(|i| {
        if graph.fixed.contains(&i) { return Some([nalgebra::SMatrix::zeros(); 2]); }
        let own = nalgebra::SMatrix::<f64, D, D>::from_fn(|r, c| h[(i * D + r, i * D + c)]);
        let m = nalgebra::SMatrix::<f64, D, D>::from_fn(|r, c| inverse[(i * D + r, i * D + c)]);
        Some([m, own.cholesky()?.inverse()])
    }).collect()
}
