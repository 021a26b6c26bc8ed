use std::fmt::Write as _;

use nalgebra::SMatrix;
use proptest::prelude::*;

use super::*;
use crate::graph::pose::{Edge, PoseGraph, Se2, Se3};

fn file(text: &str) -> Result<G2o, G2oError> {
    parse(text.as_bytes(), "a.g2o".as_ref())
}

fn planar(text: &str) -> PoseGraph2 {
    match file(text).unwrap().graph {
        Graph::Planar(graph) => graph,
        Graph::Spatial(_) => panic!("spatial"),
    }
}

fn spatial(text: &str) -> PoseGraph3 {
    match file(text).unwrap().graph {
        Graph::Planar(_) => panic!("planar"),
        Graph::Spatial(graph) => graph,
    }
}

const TWO: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n";
const EDGE: &str = "EDGE_SE2 0 1 1 2 3 11 12 13 22 23 33\n";

#[test]
fn every_number_goes_to_its_place() {
    let graph = planar(&format!("{TWO}{EDGE}FIX 1\n"));
    assert_eq!(graph.ids, [0, 1]);
    assert_eq!(graph.poses, [Se2::new(0.0, 0.0, 0.0), Se2::new(1.0, 0.0, 0.0)]);
    assert_eq!(graph.fixed, [1]);
    let [edge] = &graph.edges[..] else { panic!("{:?}", graph.edges) };
    assert_eq!((edge.from, edge.to, edge.measured), (0, 1, Se2::new(1.0, 2.0, 3.0)));
    let rows = [11.0, 12.0, 13.0, 12.0, 22.0, 23.0, 13.0, 23.0, 33.0];
    assert_eq!(edge.information, SMatrix::<f64, 3, 3>::from_row_slice(&rows));

    let mut text = "VERTEX_SE3:QUAT 5 1 2 3 0 0 1 0\nVERTEX_SE3:QUAT 6 0 0 0 0 0 0 2\n".to_owned();
    text += "EDGE_SE3:QUAT 6 5 1 2 3 0.5 -0.5 0.5 0.5";
    (1..=21).for_each(|i| write!(text, " {i}").unwrap());
    let graph = spatial(&text);
    assert_eq!(graph.poses[0], Se3::new([1.0, 2.0, 3.0], [0.0, 0.0, 1.0, 0.0]));
    let edge = &graph.edges[0];
    assert_eq!((edge.from, edge.to), (1, 0));
    assert_eq!(edge.measured.rotation.quaternion().coords.as_slice(), [0.5, -0.5, 0.5, 0.5]);
    let omega = edge.information;
    assert_eq!(omega, omega.transpose());
    assert_eq!(
        [omega[(0, 5)], omega[(1, 1)], omega[(4, 4)], omega[(5, 4)]],
        [6.0, 7.0, 19.0, 20.0]
    );
    assert_eq!(file(&text).unwrap().normalised, 1);
}

#[test]
fn order_blanks_comments_and_line_ends_do_not_matter() {
    let plain = planar(&format!("{TWO}{EDGE}FIX 1\n"));
    let odd = "# a graph\r\n\r\n  EDGE_SE2\t0 1 1 2 3 11 12 13 22 23 33 # measured\r\nFIX 1 1 # held\r\n \
               FIX 1\r\nVERTEX_SE2 0 0 0 0\r\nVERTEX_SE2 +1 1e0 0.0 -0";
    assert_eq!(planar(odd), plain);
    // Poses stay in the order of their lines, whatever their ids.
    let ids = planar(
        "VERTEX_SE2 9 0 0 0\nVERTEX_SE2 18446744073709551615 0 0 0\nVERTEX_SE2 3 1 0 0\nEDGE_SE2 3 9 0 0 0 1 0 0 1 0 1\n",
    );
    assert_eq!(ids.ids, [9, u64::MAX, 3]);
    assert_eq!((ids.edges[0].from, ids.edges[0].to), (2, 0));
}

#[test]
fn edges_alone_name_their_poses() {
    let read =
        file("EDGE_SE2 7 3 0 0 0 1 0 0 1 0 1\nEDGE_SE2 3 5 0 0 0 1 0 0 1 0 1\nFIX 5\n").unwrap();
    assert!(!read.has_poses);
    assert_eq!(read.edge_lines, [1, 2]);
    let Graph::Planar(graph) = read.graph else { panic!() };
    assert_eq!((graph.ids, graph.fixed), (vec![3, 5, 7], vec![1]));
    assert_eq!(graph.poses.len(), 3);
}

#[test]
fn one_pose_is_a_graph_and_measurements_may_repeat() {
    assert_eq!(planar("VERTEX_SE2 4 1 2 3").chi2(), 0.0);
    assert_eq!(planar(&format!("{TWO}{EDGE}{EDGE}")).edges.len(), 2);
}

#[test]
fn unknown_lines_are_counted_by_kind() {
    let text =
        format!("PARAMS 0\n{TWO}VERTEX_XY 2 1 1\nEDGE_SE2_XY 0 2 1 1 1 0 1\nVERTEX_XY 3 nan\n");
    let kinds: Vec<_> =
        file(&text).unwrap().skipped.into_iter().map(|s| (s.kind, s.count, s.line)).collect();
    let expected = [("PARAMS", 1, 1), ("VERTEX_XY", 2, 4), ("EDGE_SE2_XY", 1, 5)];
    assert_eq!(kinds, expected.map(|(kind, count, line)| (kind.to_owned(), count, line)));

    // A file of another kind does not fill the memory with its words.
    let words: String = (0..1000).map(|i| format!("word{i} and more\n")).collect();
    let skipped = file(&format!("{words}{TWO}")).unwrap().skipped;
    assert_eq!(skipped.len(), 17);
    assert_eq!((skipped[16].kind.as_str(), skipped[16].count), ("others", 984));
}

#[test]
fn what_rotations_needed_is_counted() {
    let read = file("VERTEX_SE2 0 0 0 90\nVERTEX_SE2 1 0 0 6.2\n").unwrap();
    assert_eq!((read.wide_angles, read.normalised), (1, 0));
    let text = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0.9999\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 -3\n";
    let read = file(text).unwrap();
    assert_eq!((read.wide_angles, read.normalised), (0, 1));
    let Graph::Spatial(graph) = read.graph else { panic!() };
    assert!(graph.poses.iter().all(|p| p.rotation.quaternion().norm() == 1.0));
}

#[test]
fn what_is_wrong_is_named_with_line_and_field() {
    let edge3 = "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    let long = format!("# {}", "x".repeat(1 << 16));
    for (text, words) in [
        ("", &["a.g2o: expected lines VERTEX_SE2", "found none"] as &[_]),
        ("# nothing\n\n", &["found none"]),
        ("VERTEX2 0 0 0 0\nFIX 0", &["expected lines VERTEX_SE2", "none, but VERTEX2 in line 1"]),
        ("FIX 0\n", &["expected lines VERTEX_SE2"]),
        ("VERTEX_SE2\n", &["line 1, id: ", "id of a pose", "the end of the line"]),
        ("VERTEX_SE2 -1 0 0 0", &["line 1, id: ", "\"-1\""]),
        ("VERTEX_SE2 1.5 0 0 0", &["line 1, id: ", "\"1.5\""]),
        ("VERTEX_SE2 18446744073709551616 0 0 0", &["line 1, id: "]),
        ("VERTEX_SE2 0 0 0", &["line 1, angle: expected a finite number", "the end of the line"]),
        ("VERTEX_SE2 0 0 0 0 0", &["line 1, after the last number: expected the end", "\"0\""]),
        ("VERTEX_SE2 0 0 nan 0", &["line 1, y: expected a finite number", "\"nan\""]),
        ("VERTEX_SE2 0 inf 0 0", &["line 1, x: ", "finite", "\"inf\""]),
        ("VERTEX_SE2 0 1e999 0 0", &["line 1, x: ", "finite", "\"1e999\""]),
        ("VERTEX_SE2 0 1e13 0 0", &["line 1, x: ", "within ±1e12", "\"1e13\""]),
        ("VERTEX_SE2 0 0 0 1e7", &["line 1, angle: ", "within ±1e6"]),
        ("VERTEX_SE2 0 0,5 0 0", &["line 1, x: ", "\"0,5\""]),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0", &["line 1, qx to qw: expected a unit quaternion"]),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 1", &["line 1, qw: ", "the end of the line"]),
        (
            &format!("{TWO}VERTEX_SE2 0 0 0 0"),
            &["line 3, id: expected an id not used before (line 1)"],
        ),
        (&format!("{TWO}VERTEX_SE2 1 1 0 0"), &["line 3, id: ", "(line 2), found 1"]),
        (
            &format!("{TWO}{EDGE}EDGE_SE2 0 7 0 0 0 1 0 0 1 0 1"),
            &["line 4, to: ", "7, which has none"],
        ),
        (&format!("EDGE_SE2 8 1 0 0 0 1 0 0 1 0 1\n{TWO}"), &["line 1, from: ", "VERTEX_SE2 line"]),
        (&format!("{TWO}FIX 2"), &["line 3, id: ", "2, which has none"]),
        (&format!("{TWO}FIX"), &["line 3, id: ", "the end of the line"]),
        (&format!("{TWO}FIX 0 x"), &["line 3, id: ", "\"x\""]),
        (&format!("{TWO}EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1"), &["line 3, from and to: ", "1 twice"]),
        (&format!("{TWO}EDGE_SE2 0 1 0 0 0 1 0 0 1 0"), &["line 3, information I33: "]),
        (&format!("{TWO}EDGE_SE2 0 1 0 0 0 1 0 NaN 1 0 1"), &["line 3, information I13: ", "NaN"]),
        (&format!("{TWO}EDGE_SE2 0 1 0 0 0 1e101 0 0 1 0 1"), &["information I11: ", "±1e100"]),
        (&format!("{TWO}{edge3}"), &["line 3, kind: ", "not both", "EDGE_SE3:QUAT"]),
        (&format!("{edge3}\n{EDGE}"), &["line 2, kind: ", "not both"]),
        (&format!("{edge3} 0"), &["line 1, after the last number: "]),
        (&format!("{TWO}{long}"), &["line 3, length: expected at most 65536 bytes"]),
        ("VERTEX_SE2 0 0 0 \u{0661}", &["line 1, angle: "]),
    ] {
        let message = file(text).expect_err(text).to_string();
        assert!(message.starts_with("a.g2o"), "{message}");
        for word in words {
            assert!(message.contains(word), "{text:?}\nlacks {word:?}: {message}");
        }
    }
    let error = parse(&b"VERTEX_SE2 0 0 0 \xff\n"[..], "b.g2o".as_ref()).unwrap_err();
    assert!(error.to_string().starts_with("b.g2o, line 1, angle: "), "{error}");
}

#[test]
fn any_cut_of_a_file_is_read_or_refused() {
    let text = format!("{TWO}{EDGE}FIX 1\n");
    for end in 0..text.len() {
        // Cut within a number it may be another number, but never more than there was.
        if let Ok(read) = file(&text[..end]) {
            let Graph::Planar(graph) = read.graph else { panic!() };
            assert!(graph.poses.len() <= 2 && graph.edges.len() <= 1);
        }
    }
}

#[test]
fn files_that_cannot_be_opened_or_written_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing").join("a.g2o");
    let error = read(&missing).unwrap_err().to_string();
    assert!(error.contains("a.g2o: cannot read: "), "{error}");
    assert!(read(folder.path()).is_err());
    let graph = Graph::Planar(planar(TWO));
    let error = write(&missing, &graph, &[]).unwrap_err().to_string();
    assert!(error.contains("a.g2o: cannot write: "), "{error}");
    let broken = Graph::Planar(PoseGraph { fixed: vec![2], ..planar(TWO) });
    let path = folder.path().join("b.g2o");
    assert!(write(&path, &broken, &[]).is_err());
    assert!(!path.exists());
}

#[test]
fn small_and_big_numbers_are_short() {
    let text = "VERTEX_SE2 0 1e-300 -12345678901 0\nVERTEX_SE2 1 0.1 -0 1e-7\n";
    let mut written = Vec::new();
    write_to(&mut written, &file(text).unwrap().graph).unwrap();
    assert_eq!(String::from_utf8(written).unwrap(), text);
}

fn number(bound: f64) -> impl Strategy<Value = f64> + Clone {
    prop_oneof![
        -bound..bound,
        -1.0f64..1.0,
        Just(0.0),
        Just(-0.0),
        (-300f64..9.0).prop_map(|e| 10f64.powf(e))
    ]
}

/// Ids all different, edges between different poses.
fn graph<G: std::fmt::Debug + Clone, const D: usize>(
    pose: impl Strategy<Value = G> + Clone,
) -> impl Strategy<Value = PoseGraph<G, D>> {
    let ids = proptest::collection::hash_set(any::<u64>(), 2..12);
    let poses = proptest::collection::vec(pose.clone(), 12);
    let information = proptest::collection::vec(number(1e9), D * D);
    let edge = (0usize..12, 1usize..12, pose, information);
    let fixed = proptest::collection::btree_set(0usize..12, 0..4);
    (ids, poses, proptest::collection::vec(edge, 0..20), fixed).prop_map(
        |(ids, mut poses, edges, fixed)| {
            let n = ids.len();
            poses.truncate(n);
            let edges = edges.into_iter().map(|(from, step, measured, entries)| {
                let (from, entries) = (from % n, SMatrix::<f64, D, D>::from_vec(entries));
                let to = (from + 1 + (step - 1) % (n - 1)) % n;
                let information = SMatrix::from_fn(|i, j| entries[(i.min(j), i.max(j))]);
                Edge { from, to, measured, information }
            });
            PoseGraph {
                ids: ids.into_iter().collect(),
                poses,
                edges: edges.collect(),
                fixed: fixed.into_iter().filter(|&i| i < n).collect(),
            }
        },
    )
}

fn survives(graph: Graph) -> Result<(), TestCaseError> {
    let mut text = Vec::new();
    write_to(&mut text, &graph).unwrap();
    let read = parse(&text[..], "a.g2o".as_ref()).unwrap();
    prop_assert!(read.has_poses && read.skipped.is_empty() && read.normalised == 0);
    prop_assert_eq!(&read.graph, &graph);
    // −0 is equal to 0: the text decides.
    let mut again = Vec::new();
    write_to(&mut again, &read.graph).unwrap();
    prop_assert_eq!(text, again);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn what_is_written_is_what_is_read(
        flat in graph::<Se2, 3>([number(1e6), number(1e6), number(3.1)].prop_map(|[x, y, a]| Se2::new(x, y, a))),
        solid in graph::<Se3, 6>((proptest::array::uniform3(number(1e6)), proptest::array::uniform4(-1.0f64..1.0))
            .prop_map(|(t, q)| Se3::new(t, [q[0], q[1], q[2], q[3] + 1.5f64.copysign(q[3])]))),
    ) {
        survives(Graph::Planar(flat))?;
        survives(Graph::Spatial(solid))?;
    }

    #[test]
    fn no_text_is_too_odd(text in "((VERTEX_SE2|EDGE_SE2|VERTEX_SE3:QUAT|FIX|#|0|1|2|nan|-1e5|\\.|x|é|\r)[ \n]){0,60}") {
        let _ = file(&text);
    }
}

#[test]
fn a_hundred_thousand_edges_in_any_order() {
    // A ring whose edges come first and whose ids run backwards, as bytes made while they are read.
    const N: u64 = 50_000;
    let lines =
        (0..2 * N).map(|i| format!("EDGE_SE2 {} {} 1 0 0.001 1 0 0 1 0 1\n", i % N, (i + 1) % N));
    let lines = lines.chain((0..N).rev().map(|i| format!("VERTEX_SE2 {i} {i}.5 0 0\n")));
    let text: String = lines.collect();
    let graph = planar(&text);
    assert_eq!((graph.poses.len(), graph.edges.len()), (N as usize, 2 * N as usize));
    assert_eq!(graph.ids[graph.edges[7].from], 7);
    assert_eq!(graph.poses[graph.edges[7].from].translation.x, 7.5);
}
