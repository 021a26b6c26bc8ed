use proptest::prelude::*;

use super::super::chordal::chordal;
use super::super::grid::{Random, grid};
use super::super::{Group, Options, Se2, Se3, optimize};
use super::*;

fn optimum<G: Rigid<D, N>, const D: usize, const N: usize>(
    seed: u64,
    noise: f64,
) -> PoseGraph<G, D> {
    let mut graph = grid::<G, D>(seed, 5, noise);
    let mut random = Random::new(seed);
    for edge in &mut graph.edges {
        let root =
            SMatrix::<f64, D, D>::from_fn(|_, _| random.normal() * 0.3) + SMatrix::identity();
        let mut information = root * root.transpose() * edge.information[(0, 0)];
        // Coupling of translation and rotation makes the bound loose.
        information.view_mut((0, N), (N, D - N)).fill(0.0);
        information.view_mut((N, 0), (D - N, N)).fill(0.0);
        edge.information = information;
    }
    solved(graph)
}

fn solved<G: Rigid<D, N>, const D: usize, const N: usize>(
    mut graph: PoseGraph<G, D>,
) -> PoseGraph<G, D> {
    graph.poses = chordal(&graph).unwrap();
    optimize(&mut graph, &Options::default()).unwrap();
    graph
}

/// The bound of each edge is below χ² everywhere and equal to it where it was made.
fn bounds<G: Rigid<D, N>, const D: usize, const N: usize, const H: usize>(seed: u64) {
    let mut random = Random::new(seed);
    let mut pose = || random.anywhere::<G, D>(1.0);
    let (from, to, measured) = (pose(), pose(), pose());
    let ends: Vec<(G, G)> = (0..50).map(|_| (pose(), pose())).collect();
    let root = SMatrix::<f64, D, D>::from_fn(|_, _| random.normal());
    let mut information = root * root.transpose();
    if N == 3 {
        information.view_mut((0, N), (N, D - N)).fill(0.0);
        information.view_mut((N, 0), (D - N, N)).fill(0.0);
    }
    let edge = Edge { from: 0, to: 1, measured, information };
    let error = G::error(&from, &to, &measured);
    let Some(bound) = Bound::<H>::new(&edge, &error) else { return };
    let value = |from: &G, to: &G| {
        let (a, b) = (lift::<G, D, N, H>(from), lift::<G, D, N, H>(to));
        a.dot(&(bound.from * a))
            + b.dot(&(bound.to * b))
            + 2.0 * b.dot(&(bound.coupling * a))
            + bound.constant
    };
    let here = edge.chi2(&[from, to]);
    // Near half a turn with coupling the plane's tangent is steep.
    let scale = 1e-9 * (1.0 + here.abs() + bound.constant.abs());
    if error.rows(N, D - N).norm() < 2.0 && N == 2 || N == 3 {
        assert!(value(&from, &to) <= here + scale);
        for (from, to) in &ends {
            assert!(value(from, to) <= edge.chi2(&[*from, *to]) + scale);
        }
    }
    if N == 3 || information[(0, 2)] == 0.0 {
        assert!((value(&from, &to) - here).abs() <= scale, "{} {here}", value(&from, &to));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn edges_are_bounded_from_below(seed in 0u64..100_000) {
        bounds::<Se2, 3, 2, 3>(seed);
        bounds::<Se3, 6, 3, 4>(seed);
    }

    #[test]
    fn moderate_noise_is_certified(seed in 0u64..1000) {
        let plane = certify(&solved(grid::<Se2, 3>(seed, 5, 0.03))).unwrap();
        prop_assert!(plane.is_certified(), "{plane:?}");
        let space = certify(&solved(grid::<Se3, 6>(seed, 5, 0.03))).unwrap();
        prop_assert!(space.is_certified(), "{space:?}");
    }

    #[test]
    fn poses_that_are_not_optimal_are_above_the_bound(seed in 0u64..1000) {
        let mut graph = optimum::<Se2, 3, 2>(seed, 0.03);
        let least = graph.chi2();
        let mut random = Random::new(seed);
        for pose in &mut graph.poses[1..] {
            *pose = pose.retract(&random.tangent(1e-3));
        }
        let certificate = certify(&graph).unwrap();
        prop_assert!(!certificate.is_certified());
        prop_assert!(certificate.lower_bound() <= least * (1.0 + 1e-12));
    }

    #[test]
    fn rings_that_wind_once_too_often_are_not_certified(
        count in 6usize..40, extra in prop::sample::select(vec![-1.0, 1.0]),
    ) {
        let turn = std::f64::consts::TAU / count as f64;
        let edge = |k: usize| Edge {
            from: k,
            to: (k + 1) % count,
            measured: Se2::new(1.0, 0.0, turn),
            information: SMatrix::identity(),
        };
        let step = Se2::new(1.0, 0.0, turn * (1.0 + extra));
        let mut poses = vec![Se2::new(0.0, 0.0, 0.0)];
        (1..count).for_each(|k| poses.push(poses[k - 1].compose(&step)));
        let ids = (0..count as u64).collect();
        let mut ring = PoseGraph { ids, poses, edges: (0..count).map(edge).collect(), fixed: vec![] };
        optimize(&mut ring, &Options::default()).unwrap();
        let certificate = certify(&ring).unwrap();
        prop_assert!(ring.chi2() < 1e-6 || !certificate.is_certified(), "{certificate:?}");
        // Measurements agree: the global minimum is 0, and the bound is below it.
        prop_assert!(certificate.lower_bound() < 1e-6, "{certificate:?}");
        let negative = certificate.eigenvalue().is_some_and(|value| value < 0.0);
        let stuck = matches!(certificate, Certificate::NotCertified { .. });
        prop_assert!(negative == stuck, "{certificate:?}");
        ring.poses = chordal(&ring).unwrap();
        prop_assert!(certify(&ring).unwrap().is_certified());
    }
}

#[test]
fn the_eigenvalue_is_what_is_missing() {
    // Too much noise for the relaxation, so that its matrix is not definite.
    let mut seen = 0;
    for seed in 0..20 {
        let graph = solved(grid::<Se3, 6>(seed, 4, 0.6));
        let layout = Layout::new(&graph, &graph.held(), Limit::default()).unwrap();
        let places = Places::new(&graph, &layout);
        let Ok(dual) = Dual::<4, 3>::new(&graph, &places) else { continue };
        let sizes = dual.rotation_sizes();
        let Some(found) = least(&dual.matrix, &sizes).filter(|&found| found < -1e-6) else {
            continue;
        };
        seen += 1;
        let positive = |share: f64| dual.matrix.raised(share, &sizes).factorised().is_ok();
        assert!(positive(-1.01 * found) && !positive(-0.99 * found), "{found:?}");
        let certificate = dual.certificate(&graph.ids);
        assert_eq!(certificate.eigenvalue(), Some(found));
        // The truth is no minimum but bounds it, and the bound is below that.
        let truth = grid::<Se3, 6>(seed, 4, 0.6).chi2();
        assert!(certificate.lower_bound() <= truth.min(graph.chi2()), "{certificate:?}");
    }
    assert!(seen > 3, "{seen}");
}

#[test]
fn weights_of_any_size_are_judged_alike() {
    let best = optimum::<Se2, 3, 2>(3, 0.03);
    let mut beside = best.clone();
    beside.poses[7] = beside.poses[7].compose(&Se2::new(1e-3, -1e-3, 1e-3));
    for scale in [1e-12, 1.0, 1e12] {
        let judged = |graph: &PoseGraph<Se2, 3>| {
            let mut graph = graph.clone();
            graph.edges.iter_mut().for_each(|edge| edge.information *= scale);
            certify(&graph).unwrap()
        };
        assert!(judged(&best).is_certified(), "{scale}");
        assert!(matches!(judged(&beside), Certificate::Bounded { .. }), "{scale}");
    }
}

#[test]
fn half_a_turn_has_no_bound_and_nothing_is_certain_about_nothing() {
    let poses = vec![Se2::new(0.0, 0.0, 0.0), Se2::new(0.0, 0.0, std::f64::consts::PI)];
    let measured = Se2::new(0.0, 0.0, 0.0);
    let edges = vec![Edge { from: 0, to: 1, measured, information: SMatrix::identity() }];
    let pair = PoseGraph { ids: vec![1, 2], poses, edges, fixed: vec![] };
    assert!(matches!(certify(&pair), Ok(Certificate::Unbounded { edge: 0, .. })));
    let none: PoseGraph<Se2, 3> = PoseGraph::default();
    assert_eq!(certify(&none), Ok(Certificate::Certified { chi2: 0.0, gap: 0.0 }));
}

#[test]
fn fixed_poses_are_part_of_the_problem() {
    let mut graph = optimum::<Se2, 3, 2>(3, 0.03);
    graph.fixed = vec![0, 24];
    graph.poses[24] = graph.poses[24].compose(&Se2::new(0.3, -0.2, 0.1));
    optimize(&mut graph, &Options::default()).unwrap();
    assert!(certify(&graph).unwrap().is_certified());
}
