use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use proptest::prelude::*;
use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;

/// Uniform in −1 … 1.
struct Numbers(Xoshiro256PlusPlus);

impl Numbers {
    fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    fn next(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn below(&mut self, n: usize) -> usize {
        (self.0.next_u64() % n as u64) as usize
    }

    fn tangent<const D: usize>(&mut self, size: f64) -> SVector<f64, D> {
        SVector::from_fn(|_, _| size * self.next())
    }
}

/// A walk with `closures` further edges between poses of it, measured with errors up to `noise`, and
/// the poses it was made from. The start is off by about `start`.
pub(super) fn walk<G: Group<D>, const D: usize>(
    poses: usize,
    closures: usize,
    noise: f64,
    start: f64,
    seed: u64,
) -> (PoseGraph<G, D>, Vec<G>) {
    let mut numbers = Numbers::new(seed);
    let mut truth = vec![G::identity()];
    for i in 1..poses {
        truth.push(truth[i - 1].retract(&numbers.tangent::<D>(1.0)));
    }
    let mut pairs: Vec<_> = (1..poses).map(|i| (i - 1, i)).collect();
    for _ in 0..if poses > 1 { closures } else { 0 } {
        let (a, b) = (numbers.below(poses), numbers.below(poses));
        pairs.push(if a == b { (a, (a + 1) % poses) } else { (a, b) });
    }
    let edges = pairs.into_iter().map(|(from, to)| {
        let root = SMatrix::<f64, D, D>::from_fn(|_, _| numbers.next());
        let information = root.transpose() * root + SMatrix::identity();
        let measured = truth[from].between(&truth[to]).retract(&numbers.tangent(noise));
        Edge { from, to, measured, information: information * (1.0 / (noise * noise).max(1e-4)) }
    });
    let edges = edges.collect();
    let off =
        |numbers: &mut Numbers, i: usize| if i == 0 { 0.0 } else { start * numbers.next().abs() };
    let poses = (0..poses).map(|i| {
        let size = off(&mut numbers, i);
        truth[i].retract(&numbers.tangent(size))
    });
    let poses: Vec<G> = poses.collect();
    (
        PoseGraph {
            ids: (0..poses.len() as u64).map(|i| 10 * i).collect(),
            poses,
            edges,
            fixed: vec![],
        },
        truth,
    )
}

/// H and g over all poses, by the formulas.
fn dense<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> (DMatrix<f64>, DVector<f64>) {
    let n = graph.poses.len() * D;
    let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for e in &graph.edges {
        let at = G::linearise(&graph.poses[e.from], &graph.poses[e.to], &e.measured);
        for (a, ja) in [(e.from, at.from), (e.to, at.to)] {
            let pull = ja.transpose() * e.information * at.error;
            let sum = g.rows(a * D, D) + pull;
            g.rows_mut(a * D, D).copy_from(&sum);
            for (b, jb) in [(e.from, at.from), (e.to, at.to)] {
                let block = ja.transpose() * e.information * jb;
                let sum = h.view((a * D, b * D), (D, D)) + block;
                h.view_mut((a * D, b * D), (D, D)).copy_from(&sum);
            }
        }
    }
    (h, g)
}

/// Plain Gauss–Newton with dense matrices, pose 0 held.
fn reference<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> PoseGraph<G, D> {
    let mut graph = graph.clone();
    for _ in 0..30 {
        let (h, g) = dense(&graph);
        let n = h.nrows() - D;
        if n == 0 {
            break;
        }
        let h = h.view((D, D), (n, n)).into_owned();
        let step = h.cholesky().unwrap().solve(&g.rows(D, n).into_owned());
        for i in 1..graph.poses.len() {
            let own = SVector::<f64, D>::from_fn(|r, _| -step[(i - 1) * D + r]);
            graph.poses[i] = graph.poses[i].retract(&own);
        }
    }
    graph
}

const METHODS: [Method; 3] = [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg];

fn agrees<G: Group<D>, const D: usize>(poses: usize, closures: usize, seed: u64) {
    let (graph, _) = walk::<G, D>(poses, closures, 0.05, 0.1, seed);
    let exact = reference(&graph);
    for method in METHODS {
        let mut ours = graph.clone();
        let mut last = f64::INFINITY;
        let options = Options { method, tolerance: 1e-14, ..Options::default() };
        let mut watch = |step: &Iteration| {
            assert!(step.cost <= last * (1.0 + 1e-9), "{method:?} {step:?} after {last}");
            last = step.cost;
        };
        let mut optimizer = Optimizer::new(&ours).unwrap();
        let summary = optimizer.optimize_weighted(&mut ours, None, &options, &mut watch).unwrap();
        assert!(summary.stop != Stop::Iterations, "{method:?} {summary:?}");
        assert!((summary.final_chi2 - ours.chi2()).abs() <= 1e-9 * (1.0 + ours.chi2()));
        assert!(
            summary.final_chi2 <= exact.chi2() * (1.0 + 1e-9) + 1e-12,
            "{method:?} {summary:?}"
        );
        for (a, b) in ours.poses.iter().zip(&exact.poses) {
            let off = G::error(a, b, &G::identity()).norm();
            assert!(off < 1e-5, "{method:?} off by {off}");
        }
        assert_eq!(ours.poses[0], graph.poses[0]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn all_methods_reach_the_dense_solution(poses in 1usize..25, closures in 0usize..30, seed: u64) {
        agrees::<Se2, 3>(poses, closures, seed);
        agrees::<Se3, 6>(poses, closures, seed);
    }

    #[test]
    fn marginals_are_blocks_of_the_dense_inverse(poses in 2usize..20, closures in 0usize..20, seed: u64) {
        covariances::<Se2, 3>(poses, closures, seed);
        covariances::<Se3, 6>(poses, closures, seed);
    }

    #[test]
    fn the_cost_never_rises_from_any_start(poses in 2usize..15, closures in 0usize..20, seed: u64) {
        for method in METHODS {
            for kernel in [Kernel::Identity, Kernel::Tukey(2.0), Kernel::Dcs(1.0)] {
                let (mut graph, _) = walk::<Se3, 6>(poses, closures, 0.2, 3.0, seed);
                let options = Options { method, kernel, max_iterations: 30, ..Options::default() };
                match optimize(&mut graph, &options) {
                    Ok(s) => prop_assert!(s.final_cost <= s.initial_cost * (1.0 + 1e-12), "{s:?}"),
                    // A kernel may give every edge of a pose no weight.
                    Err(Error::Unconstrained { .. }) => prop_assert!(kernel != Kernel::Identity),
                    Err(other) => prop_assert!(false, "{other}"),
                }
            }
        }
    }
}

fn covariances<G: Group<D>, const D: usize>(poses: usize, closures: usize, seed: u64) {
    let (mut graph, _) = walk::<G, D>(poses, closures, 0.05, 0.05, seed);
    optimize(&mut graph, &Options::default()).unwrap();
    let (h, _) = dense(&graph);
    let n = h.nrows() - D;
    let inverse = h.view((D, D), (n, n)).into_owned().cholesky().unwrap().inverse();
    let marginals = marginals(&graph).unwrap();
    let exact = |a: usize, b: usize| -> SMatrix<f64, D, D> {
        if a == 0 || b == 0 {
            return SMatrix::zeros();
        }
        inverse.fixed_view::<D, D>((a - 1) * D, (b - 1) * D).into_owned()
    };
    let all: Vec<usize> = (0..poses).collect();
    let joint = marginals.joint(&all);
    for a in 0..poses {
        for b in 0..poses {
            let scale = (exact(a, a).norm() * exact(b, b).norm()).sqrt();
            let off = (marginals.pair(a, b) - exact(a, b)).norm();
            assert!(off <= 1e-8 * scale, "{a} {b}: {off} of {scale}");
            let off = (joint.fixed_view::<D, D>(a * D, b * D) - exact(a, b)).norm();
            assert!(off <= 1e-8 * scale, "{a} {b}: {off} of {scale}");
        }
    }
}

#[test]
fn the_covariance_between_neighbours_of_a_chain_is_that_of_their_edge() {
    let (mut graph, _) = walk::<Se3, 6>(6, 0, 0.1, 0.1, 3);
    optimize(&mut graph, &Options::default()).unwrap();
    let marginals = marginals(&graph).unwrap();
    let (a, b) = ((2, &graph.poses[2]), (3, &graph.poses[3]));
    // The error of a measurement that is exact is the tangent with its rotation halved.
    let halves = SMatrix::<f64, 6, 6>::from_diagonal(&[1.0, 1.0, 1.0, 0.5, 0.5, 0.5].into());
    let exact = (halves * graph.edges[2].information * halves).try_inverse().unwrap();
    assert!((marginals.between(a, b) - exact).norm() < 1e-9 * exact.norm());
}

#[test]
fn an_outlier_is_resisted() {
    for kernel in [
        Kernel::Huber(2.0),
        Kernel::Cauchy(2.0),
        Kernel::GemanMcClure(3.0),
        Kernel::Tukey(5.0),
        Kernel::Dcs(2.0),
    ] {
        for method in METHODS {
            let (mut graph, truth) = walk::<Se2, 3>(30, 60, 0.02, 0.01, 5);
            let mut plain = graph.clone();
            let wrong = Edge {
                from: 3,
                to: 20,
                measured: Se2::new(4.0, -3.0, 1.0),
                information: SMatrix::identity() * 2500.0,
            };
            graph.edges.push(wrong.clone());
            plain.edges.push(wrong);
            let off = |graph: &PoseGraph2| {
                let pairs = graph.poses.iter().zip(&truth);
                pairs.map(|(a, b)| Se2::error(a, b, &Se2::identity()).norm()).fold(0.0, f64::max)
            };
            optimize(&mut plain, &Options { method, ..Options::default() }).unwrap();
            let summary = optimize(&mut graph, &Options { method, kernel, ..Options::default() });
            assert!(summary.unwrap().converged(), "{kernel:?} {method:?}");
            let (robust, plain) = (off(&graph), off(&plain));
            assert!(
                robust < 0.1 && robust < 0.3 * plain,
                "{kernel:?} {method:?}: {robust} {plain}"
            );
        }
    }
}

#[test]
fn weights_of_zero_remove_edges() {
    let (graph, _) = walk::<Se3, 6>(12, 10, 0.05, 0.1, 8);
    let mut weights = vec![1.0; graph.edges.len()];
    weights[14] = 0.0;
    weights[17] = 0.0;
    let mut less = graph.clone();
    less.edges.remove(17);
    less.edges.remove(14);
    let mut ours = graph.clone();
    let options = Options { tolerance: 1e-14, ..Options::default() };
    let mut optimizer = Optimizer::new(&ours).unwrap();
    // Once with other weights first: nothing of it may remain.
    optimizer.optimize(&mut ours, &options).unwrap();
    let summary =
        optimizer.optimize_weighted(&mut ours, Some(&weights), &options, &mut |_| {}).unwrap();
    optimize(&mut less, &options).unwrap();
    assert!((summary.final_cost - less.chi2()).abs() < 1e-9 * less.chi2());
    for (a, b) in ours.poses.iter().zip(&less.poses) {
        assert!(Se3::error(a, b, &Se3::identity()).norm() < 1e-6);
    }
}

#[test]
fn fixed_poses_stay_and_every_part_holds_one() {
    let (mut graph, _) = walk::<Se2, 3>(10, 5, 0.1, 0.3, 2);
    let (second, _) = walk::<Se2, 3>(7, 3, 0.1, 0.3, 3);
    let offset = graph.poses.len();
    graph.poses.extend(&second.poses);
    graph.ids.extend(second.ids.iter().map(|id| id + 1000));
    graph.edges.extend(second.edges.iter().cloned().map(|mut e| {
        e.from += offset;
        e.to += offset;
        e
    }));
    graph.fixed = vec![4, 6, 4];
    let before = graph.clone();
    for method in METHODS {
        let mut graph = before.clone();
        let summary = optimize(&mut graph, &Options { method, ..Options::default() }).unwrap();
        assert!(summary.converged() && summary.final_chi2 < 0.5 * summary.initial_chi2);
        for pose in [4, 6, offset] {
            assert_eq!(graph.poses[pose], before.poses[pose], "{method:?} {pose}");
        }
        assert_ne!(graph.poses[0], before.poses[0]);
        assert_ne!(graph.poses[offset + 1], before.poses[offset + 1]);
    }
}

#[test]
fn the_smallest_graphs_are_answered() {
    let mut graph = PoseGraph2::default();
    for poses in 0..3 {
        for method in METHODS {
            let mut own = graph.clone();
            let summary = optimize(&mut own, &Options { method, ..Options::default() }).unwrap();
            assert!(summary.converged() && summary.final_chi2 == 0.0, "{summary:?}");
            assert_eq!(own, graph);
            assert!(
                (0..poses)
                    .all(|p| marginals(&own).unwrap().pose(p) == SMatrix::<f64, 3, 3>::zeros())
            );
        }
        graph.ids.push(poses as u64);
        graph.poses.push(Se2::new(1.0, 2.0, 3.0));
    }
}

#[test]
fn every_edge_repeated_changes_nothing() {
    let (mut graph, _) = walk::<Se3, 6>(12, 8, 0.05, 0.1, 4);
    let mut doubled = graph.clone();
    doubled.edges.extend(graph.edges.clone().into_iter().rev());
    let options = Options { tolerance: 1e-13, ..Options::default() };
    let once = optimize(&mut graph, &options).unwrap().final_chi2;
    let twice = optimize(&mut doubled, &options).unwrap().final_chi2;
    assert!((twice - 2.0 * once).abs() < 1e-9 * once);
    for (a, b) in graph.poses.iter().zip(&doubled.poses) {
        assert!(Se3::error(a, b, &Se3::identity()).norm() < 1e-6);
    }
}

#[test]
fn bad_graphs_are_refused_by_name() {
    let (good, _) = walk::<Se2, 3>(5, 3, 0.1, 0.1, 1);
    let before = good.clone();
    let of = |change: &dyn Fn(&mut PoseGraph2)| {
        let mut graph = good.clone();
        change(&mut graph);
        let poses = graph.poses.clone();
        let error = optimize(&mut graph, &Options::default()).unwrap_err();
        assert!(graph.poses.iter().zip(&poses).all(|(a, b)| a == b || !b.is_finite()));
        error
    };
    assert_eq!(of(&|g| g.edges[2].to = 9), Error::MissingPose { edge: 2, pose: 9, poses: 5 });
    assert_eq!(of(&|g| g.edges[2].to = g.edges[2].from), Error::Loop { edge: 2, id: 20 });
    assert_eq!(of(&|g| g.fixed.push(5)), Error::MissingFixed { pose: 5, poses: 5 });
    assert_eq!(of(&|g| g.poses[3].angle = f64::NAN), Error::PoseNotFinite { id: 30 });
    assert_eq!(of(&|g| g.ids.truncate(2)), Error::Ids { ids: 2, poses: 5 });
    let edge = |edge: usize| (edge, 10 * edge as u64, 10 * edge as u64 + 10);
    let (edge, from, to) = edge(1);
    let bad = |g: &mut PoseGraph2| g.edges[1].measured.translation.x = f64::INFINITY;
    assert_eq!(of(&bad), Error::EdgeNotFinite { edge, from, to });
    let bad = |g: &mut PoseGraph2| g.edges[1].information[(0, 2)] += 1.0;
    assert_eq!(of(&bad), Error::Information { edge, from, to, problem: "not symmetric" });
    let problem = "not positive semidefinite";
    let bad = |g: &mut PoseGraph2| g.edges[1].information[(1, 1)] *= -1.0;
    assert_eq!(of(&bad), Error::Information { edge, from, to, problem });
    let huge = of(&|g| g.edges[1].information *= 1e300);
    assert!(matches!(huge, Error::Overflow { .. } | Error::Unconstrained { .. }), "{huge}");
    let lost = of(&|g| {
        g.edges.truncate(4);
        g.edges[3].information.fill(0.0);
        g.edges[3].information[(0, 0)] = 1.0;
    });
    assert!(matches!(lost, Error::Unconstrained { id: 40, .. }), "{lost}");
    let mut optimizer = Optimizer::new(&before).unwrap();
    let mut graph = before.clone();
    let mut weighted = |w: &[f64]| {
        optimizer
            .optimize_weighted(&mut graph, Some(w), &Options::default(), &mut |_| {})
            .unwrap_err()
    };
    assert_eq!(weighted(&[1.0]), Error::Weights { weights: 1, edges: 7 });
    assert!(matches!(weighted(&[f64::NAN; 7]), Error::Weight { edge: 0, .. }));
    let mut graph = before.clone();
    graph.edges.pop();
    let changed = optimizer.optimize(&mut graph, &Options::default()).unwrap_err();
    assert_eq!(changed, Error::Changed { what: "edges" });
    let options = Options { kernel: Kernel::Huber(-1.0), ..Options::default() };
    assert!(matches!(optimize(&mut graph, &options), Err(Error::Option { .. })));
}

#[test]
fn semidefinite_information_is_no_error_where_the_rest_determines_the_pose() {
    let (mut graph, _) = walk::<Se2, 3>(6, 8, 0.05, 0.05, 9);
    graph.edges[6].information = SMatrix::from_diagonal(&[1e4, 0.0, 0.0].into());
    assert!(optimize(&mut graph, &Options::default()).unwrap().converged());
}

#[test]
fn damping_helps_where_poses_go_together_and_not_where_nothing_is_measured() {
    let lost = |information: SMatrix<f64, 3, 3>| {
        let (mut graph, _) = walk::<Se2, 3>(2, 0, 0.05, 0.05, 9);
        graph.edges[0].information = information;
        let method = Method::LevenbergMarquardt;
        optimize(&mut graph, &Options { method, ..Options::default() })
    };
    // How far along one diagonal, and nothing along the other.
    let together = SMatrix::from([[1e2, 1e2, 0.0], [1e2, 1e2, 0.0], [0.0, 0.0, 1e2]]);
    assert!(lost(together).unwrap().final_chi2 < 1e-6);
    let nothing = SMatrix::from_diagonal(&[1e2, 1e2, 0.0].into());
    assert!(matches!(lost(nothing), Err(Error::Unconstrained { .. })));
}

#[test]
fn long_chains_take_no_recursion_and_little_time() {
    let (mut graph, _) = walk::<Se2, 3>(20_000, 0, 0.01, 0.01, 6);
    let summary = optimize(&mut graph, &Options::default()).unwrap();
    assert!(summary.converged() && summary.final_chi2 < 1e-6, "{}", summary.final_chi2);
}
