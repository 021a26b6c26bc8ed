use super::super::tests::{at_truth, exact};
use super::*;

/// Of a contact, metres.
const DEVIATION: f64 = 1e-3;

/// χ² per degree of freedom where so many of fifty contacts were felt that many deviations too far out.
fn misfit(strange: usize, deviations: f64) -> f64 {
    let mut log = exact("rectangle:0.10x0.06", 10);
    let (_, state, labels) = at_truth(&log);
    (log.noise.point, log.noise.normal) = (Some(DEVIATION), Some(0.1));
    let grasps = log.grasps.iter_mut();
    for contact in grasps.flat_map(|grasp| &mut grasp.contacts).take(strange) {
        contact.point += contact.normal.unwrap() * (deviations * DEVIATION);
    }
    per_degree(&Problem::new(&log), &state, &labels)
}

#[test]
fn faces_fit_with_a_few_strange_contacts_and_not_with_many() {
    assert!(misfit(0, 0.0) < 1e-6);
    assert!(misfit(1, 3.9) > 0.1);
    assert!(misfit(5, 4.1) < 1e-6 && misfit(5, 100.0) < 1e-6);
    assert!(misfit(6, 5.0) > 1.4);
}

#[test]
fn a_slip_does_not_speak_against_faces() {
    let slipped = |far: f64| {
        let mut log = exact("rectangle:0.10x0.06", 10);
        let (_, state, labels) = at_truth(&log);
        (log.noise.translation, log.noise.rotation) = (Some(2e-3), Some(0.05));
        let motion = log.grasps[4].motion.as_mut().unwrap();
        *motion = nalgebra::Translation3::new(far, 0.0, 0.0) * *motion;
        per_degree(&Problem::new(&log), &state, &labels)
    };
    assert!((0.1..1.0).contains(&slipped(0.012)), "{}", slipped(0.012));
    // An object that was rather carried away says nothing at all.
    assert!(slipped(0.03).abs() < 1e-6, "{}", slipped(0.03));
}

#[test]
fn poses_without_doubt_are_searched_from_once() {
    let log = exact("rectangle:0.10x0.06", 10);
    let steps = crate::slam::track::truth(&log).unwrap();
    let effort = Effort { retrack: false, ..Effort::default() };
    let problem = Problem::new(&log);
    let first = Some(steps[0].pose);
    assert_eq!(started::<3>(&problem, &[&steps, &steps], first, effort).len(), 1);
}
