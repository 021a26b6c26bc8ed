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
    per_degree::<3>(&Problem::new(&log), &state, &labels)
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
        per_degree::<3>(&Problem::new(&log), &state, &labels)
    };
    assert!((0.1..1.0).contains(&slipped(0.012)), "{}", slipped(0.012));
    // An object that was rather carried away says nothing at all.
    assert!(slipped(0.03).abs() < 1e-6, "{}", slipped(0.03));
}

#[test]
fn contacts_pay_for_poses_that_no_motion_tells() {
    let mut log = exact("rectangle:0.10x0.06", 10);
    let (_, state, labels) = at_truth(&log);
    (log.noise.point, log.noise.normal) = (Some(DEVIATION), Some(0.1));
    let contact = &mut log.grasps[0].contacts[0];
    contact.point += contact.normal.unwrap() * (3.0 * DEVIATION);
    let spent = |log: &GraspLog, labels: &Labels, motion: Option<Pose>| {
        let told = |log: &GraspLog| per_degree::<3>(&Problem::new(log), &state, labels);
        let mut untold = log.clone();
        untold.grasps[4].motion = motion;
        let numbers = 2.0 * labels.iter().flatten().count() as f64 - 8.0;
        numbers * (1.0 - told(log) / told(&untold))
    };
    let far = Some(Pose::translation(0.5, 0.0, 0.0));
    for motion in [None, far] {
        let all = spent(&log, &labels, motion);
        assert!((all - 3.0).abs() < 0.01, "{all}");
    }
    // One contact tells how far off its face is and how it is turned, and not where along it.
    let before: usize = log.grasps[..4].iter().map(|grasp| grasp.contacts.len()).sum();
    let mut fewer = labels.clone();
    fewer.drain(before + 1..before + log.grasps[4].contacts.len());
    log.grasps[4].contacts.truncate(1);
    for motion in [None, far] {
        let some = spent(&log, &fewer, motion);
        assert!((some - 2.0).abs() < 0.02, "{some}");
    }
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
