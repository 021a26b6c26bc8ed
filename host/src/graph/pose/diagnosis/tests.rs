use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};
use proptest::prelude::*;

use super::*;
use crate::graph::pose::{PoseGraph2, PoseGraph3, Se2, Se3};

/// A chain of `n` poses a metre apart with a loop at its end, which fits exactly.
fn chain(n: usize) -> PoseGraph2 {
    let poses: Vec<Se2> = (0..n).map(|i| Se2::new(i as f64, 0.0, 0.1 * i as f64)).collect();
    let edge = |from: usize, to: usize| Edge {
        from,
        to,
        measured: poses[from].between(&poses[to]),
        information: Matrix3::from_diagonal(&Vector3::new(100.0, 100.0, 400.0)),
    };
    let mut edges: Vec<_> = (1..n).map(|i| edge(i - 1, i)).collect();
    edges.push(edge(0, n - 1));
    PoseGraph { ids: (0..n as u64).map(|i| 10 + i).collect(), poses, edges, fixed: vec![] }
}

fn space(information: Matrix6<f64>) -> PoseGraph3 {
    let poses: Vec<Se3> = (0..4)
        .map(|i| Se3::new([i as f64, 0.3, -0.2 * i as f64], [0.1 * i as f64, 0.2, 0.0, 1.0]))
        .collect();
    let edge = |from: usize, to: usize| Edge {
        from,
        to,
        measured: poses[from].between(&poses[to]),
        information,
    };
    let edges = vec![edge(0, 1), edge(1, 2), edge(2, 3)];
    PoseGraph { ids: vec![0, 1, 2, 3], poses, edges, fixed: vec![] }
}

#[test]
fn nothing_is_wrong_with_a_good_graph() {
    let diagnosis = Diagnosis::of(&chain(6));
    assert_eq!(diagnosis.remarks(), Vec::<String>::new());
    assert!(diagnosis.is_bounded());
    assert_eq!((diagnosis.poses, diagnosis.edges), (6, 6));
    assert_eq!(diagnosis.parts.len(), 1);
    assert_eq!(diagnosis.information, Some([100.0, 400.0]));
    assert!((diagnosis.stretch.unwrap() - 1.0).abs() < 1e-12);
    let fit = Fit::of(&chain(6), 3);
    assert_eq!((fit.degrees, fit.improbable, fit.worst.len()), (3, 0, 3));
    assert!(fit.chi2 < 1e-20, "{}", fit.chi2);

    assert_eq!(Diagnosis::of(&space(Matrix6::identity())).remarks(), Vec::<String>::new());
    assert_eq!(Fit::of(&space(Matrix6::identity()), 3).degrees, 0);
}

#[test]
fn empty_and_single_graphs_are_in_order() {
    let empty = PoseGraph { ids: vec![], poses: vec![], edges: vec![], fixed: vec![] };
    for graph in [empty, PoseGraph { edges: vec![], ..chain(1) }] {
        let diagnosis = Diagnosis::of(&graph);
        assert_eq!(diagnosis.remarks(), Vec::<String>::new());
        assert_eq!((diagnosis.information, diagnosis.stretch), (None, None));
        let fit = Fit::of(&graph, 3);
        assert_eq!((fit.chi2, fit.degrees, fit.worst.len()), (0.0, 0, 0));
        assert_eq!(fit.remarks(), Vec::<String>::new());
    }
}

#[test]
fn parts_are_named_by_their_poses() {
    let mut graph = chain(9);
    graph.edges.retain(|e| (e.from, e.to) != (2, 3) && e.from != 0 && (e.from, e.to) != (7, 8));
    graph.fixed = vec![4];
    let diagnosis = Diagnosis::of(&graph);
    let parts: Vec<(&[u64], bool)> =
        diagnosis.parts.iter().map(|part| (&part.ids[..], part.fixed)).collect();
    let expected: [(&[u64], bool); 4] =
        [(&[13, 14, 15, 16, 17], true), (&[11, 12], false), (&[10], false), (&[18], false)];
    assert_eq!(parts, expected);
    let remarks = diagnosis.remarks().join("\n");
    for words in ["no edge connects 4 poses to the other 5", "4 parts", "11, 12; 10; 18"] {
        assert!(remarks.contains(words), "{remarks}");
    }
}

#[test]
fn factors_are_told_in_few_digits() {
    let mut graph = chain(5);
    for edge in &mut graph.edges {
        edge.information *= 1e-300;
    }
    graph.poses[4] = graph.poses[0];
    let remarks = Fit::of(&graph, 3).remarks();
    assert!(remarks[0].contains(" times smaller") && remarks[0].len() < 150, "{remarks:?}");
}

#[test]
fn edges_without_weight_connect_nothing() {
    let mut graph = chain(4);
    graph.edges.truncate(3);
    graph.edges[1].information = Matrix3::zeros();
    let diagnosis = Diagnosis::of(&graph);
    assert_eq!(diagnosis.weightless, [Name { edge: 1, from: 11, to: 12 }]);
    assert_eq!(diagnosis.parts.len(), 2);
    assert_eq!(diagnosis.remarks().len(), 2);
}

#[test]
fn indefinite_information_is_named_by_its_edge() {
    let mut graph = chain(5);
    graph.edges[2].information[(0, 1)] = 150.0;
    graph.edges[2].information[(1, 0)] = 150.0;
    graph.edges[4].information[(2, 2)] = -3.0;
    graph.edges[1].information[(0, 0)] = f64::NAN;
    let diagnosis = Diagnosis::of(&graph);
    assert!(!diagnosis.is_bounded());
    let found: Vec<_> = diagnosis.indefinite.iter().map(|i| (i.name.from, i.name.to)).collect();
    assert_eq!(found, [(11, 12), (12, 13), (10, 14)]);
    assert!(diagnosis.indefinite[0].eigenvalue.is_nan());
    assert!((diagnosis.indefinite[1].eigenvalue + 50.0).abs() < 1e-9);
    assert!((diagnosis.indefinite[2].eigenvalue + 3.0).abs() < 1e-9);
    let remarks = diagnosis.remarks();
    assert!(remarks[0].starts_with("3 of 5 edges have an information matrix"), "{remarks:?}");
}

#[test]
fn units_do_not_make_information_indefinite() {
    let of = |rows: [f64; 9]| Kind::of(&Matrix3::from_row_slice(&rows));
    assert_eq!(of([1e-9, 0.0, 0.0, 0.0, 1e12, 0.0, 0.0, 0.0, 1.0]), Kind::Definite);
    // Singular but for the sixth digit.
    assert_eq!(of([1.0, 1.000001, 0.0, 1.000001, 1.0, 0.0, 0.0, 0.0, 1.0]), Kind::Semidefinite);
    assert_eq!(of([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), Kind::Semidefinite);
    assert_eq!(of([0.0; 9]), Kind::Zero);
    // No weight of its own, yet with another direction.
    let mixed = of([1.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0]);
    assert!(matches!(mixed, Kind::Indefinite { eigenvalue } if eigenvalue < 0.0), "{mixed:?}");
    // Only the symmetric part counts in eᵀΩe.
    assert_eq!(of([1.0, 0.9, 0.0, -0.9, 1.0, 0.0, 0.0, 0.0, 1.0]), Kind::Definite);
}

#[test]
fn poses_that_can_move_unnoticed_are_found() {
    // Only places are measured. A pose between two others feels its turns in where it sees its successor,
    // but for one about the line of sight; at the ends three numbers hold six directions.
    let places = Matrix6::from_diagonal(&[1.0, 1.0, 1.0, 0.0, 0.0, 0.0].into());
    let diagnosis = Diagnosis::of(&space(places));
    let free: Vec<_> = diagnosis.unconstrained.iter().map(|u| (u.id, u.directions)).collect();
    assert_eq!(free, [(0, 3), (1, 1), (2, 1), (3, 3)]);
    assert!(diagnosis.remarks()[0].starts_with("4 poses can move"), "{:?}", diagnosis.remarks());

    // Held in place, or by a second measurement, they are not.
    let mut graph = space(places);
    graph.fixed = vec![3];
    graph.edges[0].information = Matrix6::identity();
    let free: Vec<_> = Diagnosis::of(&graph).unconstrained.iter().map(|u| u.id).collect();
    assert_eq!(free, [2]);
}

#[test]
fn repeated_edges_are_counted_and_copies_told_apart() {
    let mut graph = chain(5);
    let (copy, mut other) = (graph.edges[1].clone(), graph.edges[1].clone());
    other.measured = Se2::new(1.1, 0.0, 0.1);
    let back = Edge { from: copy.to, to: copy.from, measured: copy.measured.inverse(), ..copy };
    graph.edges.extend([copy, other, back]);
    let diagnosis = Diagnosis::of(&graph);
    let name = Name { edge: 1, from: 11, to: 12 };
    assert_eq!(diagnosis.repeated, [Repeated { name, edges: 4, copies: 1 }]);
    assert!(diagnosis.remarks()[0].starts_with("1 edges are the same as one before"));
}

#[test]
fn odd_scales_are_remarked() {
    let mut graph = chain(5);
    graph.edges.iter_mut().for_each(|e| e.measured.translation *= 1000.0);
    graph.edges[0].information[(0, 0)] = 1e-14;
    let remarks = Diagnosis::of(&graph).remarks().join("\n");
    assert!(remarks.contains("information goes from 1.0e-14 to 4.0e2"), "{remarks}");
    assert!(remarks.contains("1.00e3 times those between their poses"), "{remarks}");
}

#[test]
fn the_edge_that_disagrees_is_named_with_its_probability() {
    let mut graph = chain(6);
    graph.edges[3].measured.translation.x += 0.5;
    graph.edges[1].measured.translation.x += 0.05;
    let fit = Fit::of(&graph, 2);
    let found: Vec<_> = fit.worst.iter().map(|d| (d.name.from, d.name.to)).collect();
    assert_eq!(found, [(13, 14), (11, 12)]);
    assert!((fit.worst[0].chi2 - 25.0).abs() < 1e-9 && (fit.worst[1].chi2 - 0.25).abs() < 1e-9);
    // Of three degrees.
    assert!((fit.worst[0].p - 1.54e-5).abs() < 1e-7, "{}", fit.worst[0].p);
    assert!((fit.worst[1].p - 0.9691).abs() < 1e-4, "{}", fit.worst[1].p);
    assert_eq!(fit.improbable, 1);
    // One that rewards disagreement has no probability, and hides no other.
    let mut rewarding = graph.clone();
    rewarding.edges[5].measured.translation.x += 5.0;
    rewarding.edges[5].information[(1, 1)] = -1.0;
    let both = Fit::of(&rewarding, 1);
    assert!(both.worst[0].p.is_nan() && both.improbable == 1);
    assert!(fit.remarks()[0].contains("the worst is 13 → 14, χ² 25.0000"), "{:?}", fit.remarks());
    graph.edges[3].measured.translation.x += 50.0;
    assert!(Fit::of(&graph, 2).remarks()[0].contains("times what the information says"));
}

proptest! {
    #[test]
    fn squares_are_never_indefinite_and_their_opposites_always(
        entries in proptest::collection::vec(-1.0f64..1.0, 36), scale in -6f64..6.0,
    ) {
        let root = SMatrix::<f64, 6, 6>::from_row_slice(&entries) * 10f64.powf(scale);
        let square = root.transpose() * root;
        let rewarded = matches!(Kind::of(&square), Kind::Indefinite { .. });
        prop_assert!(!rewarded);
        let negative = Kind::of(&-square);
        let rewarded = matches!(negative, Kind::Indefinite { eigenvalue } if eigenvalue < 0.0);
        prop_assert!(rewarded);
    }

    #[test]
    fn parts_hold_every_pose_once(ends in proptest::collection::vec((0usize..20, 0usize..20), 0..30)) {
        let graph = PoseGraph {
            edges: ends
                .into_iter()
                .filter(|(a, b)| a != b)
                .map(|(from, to)| Edge { from, to, ..chain(2).edges.remove(0) })
                .collect(),
            ..chain(20)
        };
        let parts = Diagnosis::of(&graph).parts;
        let place = |pose: usize| parts.iter().position(|p| p.ids.contains(&graph.ids[pose])).unwrap();
        prop_assert!(graph.edges.iter().all(|e| place(e.from) == place(e.to)));
        prop_assert_eq!(parts.iter().map(|p| p.ids.len()).sum::<usize>(), 20);
        prop_assert!(parts.is_sorted_by(|a, b| a.ids.len() >= b.ids.len()));
        // No more edges than a forest needs are needed: as many parts as poses less joins.
        let mut joined = vec![usize::MAX; 20];
        (0..20).for_each(|p| joined[p] = p);
        for e in &graph.edges {
            let (a, b) = (joined[e.from], joined[e.to]);
            joined.iter_mut().filter(|j| **j == a).for_each(|j| *j = b);
        }
        joined.sort_unstable();
        joined.dedup();
        prop_assert_eq!(parts.len(), joined.len());
    }
}
