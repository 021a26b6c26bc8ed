//! How fast pose graphs are optimised, on synthetic worlds of the sizes that are common.
//!
//! `cargo bench --bench pose_graph`; one thread, structure and all.

use nalgebra::{SMatrix, SVector};
use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tactile_host::graph::pose::{
    Edge, Group, Incremental, Kernel, Optimizer, Options, PoseGraph, Se2, Se3, marginals,
};

fn main() {
    divan::main();
}

/// A walk over a grid of `side` × `side` places, line after line, that also measures to the place
/// passed on the line before.
fn grid<G: Group<D>, const D: usize>(side: usize) -> PoseGraph<G, D> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut number = move || (rng.next_u64() >> 11) as f64 / (1u64 << 52) as f64 - 1.0;
    let place = |i: usize| {
        let (line, along) = (i / side, i % side);
        let along = if line % 2 == 0 { along } else { side - 1 - along };
        let mut at = SVector::<f64, D>::zeros();
        (at[0], at[1]) = (along as f64, line as f64);
        G::identity().retract(&at)
    };
    let truth: Vec<G> = (0..side * side).map(place).collect();
    let mut pairs: Vec<_> = (1..truth.len()).map(|i| (i - 1, i)).collect();
    for i in side..truth.len() {
        let (line, along) = (i / side, i % side);
        pairs.push(((line - 1) * side + side - 1 - along, i));
    }
    let edges = pairs.into_iter().map(|(from, to)| {
        let noise = SVector::<f64, D>::from_fn(|_, _| 0.02 * number());
        let measured = truth[from].between(&truth[to]).retract(&noise);
        Edge { from, to, measured, information: SMatrix::identity() * 7500.0 }
    });
    let edges: Vec<_> = edges.collect();
    let mut poses = vec![truth[0]];
    for edge in &edges[..truth.len() - 1] {
        // Odometry drifts: half of its error, or the start would not be one descent starts from.
        let step = truth[edge.from].between(&truth[edge.to]);
        let half = step.local(&edge.measured) * 0.1;
        poses.push(poses[edge.from].compose(&step.retract(&half)));
    }
    PoseGraph { ids: (0..poses.len() as u64).collect(), poses, edges, fixed: vec![0] }
}

/// From the start to the minimum.
#[divan::bench(args = [10, 30, 60, 100])]
fn plane(bencher: divan::Bencher, side: usize) {
    let graph = grid::<Se2, 3>(side);
    bencher.with_inputs(|| graph.clone()).bench_refs(|graph| {
        Optimizer::new(graph).and_then(|mut o| o.optimize(graph, &Options::default()))
    });
}

/// From the start to the minimum.
#[divan::bench(args = [10, 30, 50])]
fn space(bencher: divan::Bencher, side: usize) {
    let graph = grid::<Se3, 6>(side);
    bencher.with_inputs(|| graph.clone()).bench_refs(|graph| {
        Optimizer::new(graph).and_then(|mut o| o.optimize(graph, &Options::default()))
    });
}

/// With a robust kernel.
#[divan::bench]
fn plane_60_cauchy(bencher: divan::Bencher) {
    let graph = grid::<Se2, 3>(60);
    let options = Options { kernel: Kernel::Cauchy(3.0), ..Options::default() };
    bencher
        .with_inputs(|| graph.clone())
        .bench_refs(|graph| Optimizer::new(graph).and_then(|mut o| o.optimize(graph, &options)));
}

/// Order of elimination and supernodes alone.
#[divan::bench(args = [30, 100])]
fn structure_plane(bencher: divan::Bencher, side: usize) {
    let graph = grid::<Se2, 3>(side);
    bencher.bench(|| Optimizer::new(&graph));
}

/// The covariance of every pose.
#[divan::bench(args = [10, 50])]
fn marginals_space(bencher: divan::Bencher, side: usize) {
    let graph = grid::<Se3, 6>(side);
    bencher.bench(|| marginals(&graph).map(|m| m.pose(graph.poses.len() - 1)));
}

/// One pose more, with two edges, after 400: structure, solution and all.
#[divan::bench]
fn grown_by_one_plane_400(bencher: divan::Bencher) {
    let graph = grid::<Se2, 3>(20);
    let last = graph.poses.len() - 1;
    let mut grown = Incremental::new(Options::default());
    let add = |grown: &mut Incremental<Se2, 3>, at: usize| {
        grown.add_pose(graph.ids[at], graph.poses[at])?;
        for e in graph.edges.iter().filter(|e| e.from.max(e.to) == at) {
            grown.add_edge(graph.ids[e.from], graph.ids[e.to], e.measured, e.information)?;
        }
        grown.update().map(|summary| summary.final_cost)
    };
    for at in 0..last {
        if add(&mut grown, at).is_err() {
            return;
        }
    }
    bencher.with_inputs(|| grown.clone()).bench_refs(|grown| add(grown, last));
}
