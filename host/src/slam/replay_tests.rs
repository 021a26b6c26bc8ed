use std::fs;

use tactile_core::space::Planar;
use tactile_core::wire::TrackerKind;

use super::*;
use crate::link::session::settings_for;
use crate::link::{Patience, Recorder, Session, virtual_board};
use crate::log::recording::Header;
use crate::shape::Outline;
use crate::slam::output::{Provenance, conclude, true_shape};
use crate::slam::track;
use crate::view::scene::{Seven, seven};

fn bundled() -> GraspLog {
    let text = include_str!("../../assets/bundled.jsonl");
    GraspLog::parse(text.as_bytes(), "bundled".as_ref()).unwrap()
}

/// The bundled log through the board's code, and the poses that came back.
fn recorded() -> (Vec<u8>, Vec<Pose>) {
    let log = bundled();
    let mut bytes = Vec::new();
    let header = Header::new(2, log.fingers.clone(), String::new());
    let board = virtual_board::start(2, TrackerKind::Hypotheses).unwrap();
    let link = Recorder::new(board, &mut bytes, &header).unwrap();
    let session = Session::<Planar, _>::open(link, Patience::default()).unwrap();
    let outcome = session.run(&log, settings_for(&log, 0), |_, _| ()).unwrap();
    (bytes, outcome.poses())
}

fn scene_of(bytes: &[u8]) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.tac");
    fs::write(&path, bytes).unwrap();
    of_recording(&path).unwrap()
}

#[test]
fn a_recording_shows_what_the_board_made_of_it() {
    let (bytes, poses) = recorded();
    let scene = scene_of(&bytes);
    assert_eq!(scene.meta.title, "session.tac");
    assert_eq!(scene.meta.missing, Vec::<String>::new());
    assert_eq!(scene.meta.grasps, Some(10));
    assert_eq!(scene.meta.tracker.as_deref(), Some("hypotheses on the board"));
    let shown: Vec<Seven> = scene.grasps.iter().map(|g| g.pose.unwrap()).collect();
    assert_eq!(shown, poses.iter().map(seven).collect::<Vec<_>>());
    assert!(scene.grasps.iter().all(|g| g.touched == 5 && g.contacts.0.len() == 30));
    assert!(scene.grasps[1..].iter().all(|g| g.deviations.is_some() && g.entropy.is_none()));
    // The block is a triangle of some ten centimetres.
    let last = scene.surfaces.last().unwrap();
    assert_eq!(last.after, 9);
    let wide = |axis| {
        let all = last.shape.vertices.0.iter().skip(axis).step_by(3);
        all.clone().fold(f32::MIN, |a, &b| a.max(b)) - all.fold(f32::MAX, |a, &b| a.min(b))
    };
    assert!(
        (0.08..0.2).contains(&wide(0)) && (0.08..0.2).contains(&wide(1)),
        "{} {}",
        wide(0),
        wide(1)
    );
    assert!(scene.surfaces.is_sorted_by_key(|s| s.after) && scene.surfaces.len() > 3);
}

#[test]
fn what_a_damaged_recording_lacks_is_said() {
    let (bytes, _) = recorded();
    let cut = scene_of(&bytes[..bytes.len() * 2 / 3]);
    assert!(cut.grasps.len() < 10 && !cut.grasps.is_empty());
    assert!(cut.meta.missing[0].contains("ends within a piece"), "{:?}", cut.meta.missing);

    let mut bad = bytes.clone();
    let middle = bytes.len() / 2;
    bad[middle] ^= 0x55;
    let said = scene_of(&bad).meta.missing.join(" ");
    assert!(said.contains("damaged pieces are left out"), "{said}");

    let header = bytes.iter().position(|&b| b == 0).unwrap() + 1;
    let empty = scene_of(&bytes[..header]);
    assert_eq!(empty.meta.missing, ["There is no whole grasp in the recording."]);
    assert!(empty.grasps.is_empty() && empty.surfaces.is_empty());
}

#[test]
fn a_run_shows_its_surface_growing_and_ends_with_the_reports_figures() {
    let log = bundled();
    let truth = true_shape(&log).unwrap();
    let steps = track::truth(&log).unwrap();
    let provenance = Provenance {
        title: "a block",
        tracker: "truth",
        surface: Choice::Auto,
        tracking_seconds: 0.0,
        graph: None,
        progress: &|_, _| (),
    };
    let outcome = conclude(&log, truth.as_ref(), steps, provenance).unwrap();
    let scene = of_run(&log, &outcome, truth.as_ref(), &growth(&log, &outcome));
    assert_eq!((scene.meta.title.as_str(), scene.meta.grasps), ("a block", Some(10)));
    assert_eq!(scene.grasps.len(), 10);
    assert!(scene.grasps.iter().all(|g| g.truth == g.pose && g.entropy.is_none()));
    let last = scene.surfaces.last().unwrap();
    assert_eq!(last.after, 9);
    assert_eq!(last.hausdorff_mm, outcome.report.surface.hausdorff_mm);
    assert_eq!(last.deviations.0.len() * 3, last.shape.vertices.0.len());
    // More contacts, a better shape.
    let first = scene.surfaces[0].mean_mm.unwrap();
    assert!(last.mean_mm.unwrap() < 0.2 * first, "{first} {:?}", last.mean_mm);
    assert!(scene.surfaces.len() > 4);
}

#[test]
fn a_log_shows_contacts_and_truth_and_what_could_not_be_read() {
    let log = bundled();
    let square = Outline { loops: vec![vec![[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]] };
    let truth = Geometry::Outline(square);
    let scene = of_log(&log, "felt", Some(&truth), vec!["line 3".into()]);
    assert_eq!(scene.meta.missing, ["line 3"]);
    assert_eq!(scene.meta.truth.as_ref().map(|t| t.loops.0.clone()), Some(vec![3]));
    assert!(scene.surfaces.is_empty());
    assert!(scene.grasps.iter().all(|g| g.pose.is_none() && g.truth.is_some() && g.touched == 5));
}
