use super::*;
use crate::shape::Outline;
use crate::slam::choose::Choice;
use crate::slam::output::{Provenance, conclude, true_shape};
use crate::slam::track;

fn bundled() -> GraspLog {
    let text = include_str!("../../assets/bundled.jsonl");
    GraspLog::parse(text.as_bytes(), "bundled".as_ref()).unwrap()
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
