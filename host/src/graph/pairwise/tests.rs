use nalgebra::Point3;

use super::alternatives::{Allowed, alternatives};
use super::constraints::Rules;
use super::*;
use crate::graph::joint::tangent::local;
use crate::log::LoggedGrasp;
use crate::quantity::Deviation;
use crate::sim::{Options, Touch, simulate};
use crate::slam::track::truth;
use crate::space::{Point, planar};

fn options(object: &str, seed: u64) -> Options {
    Options { seed, ..Options::new(object.parse().unwrap()) }
}

/// Contacts all over the object in every grasp.
fn everywhere(object: &str, contacts: usize, seed: u64) -> Options {
    Options { touch: Touch::Uniform, contacts, ..options(object, seed) }
}

/// True poses that walk off, as a tracker's do that adds up its errors.
fn drifting(log: &GraspLog, shift: f64, turn: f64) -> Vec<Step> {
    let mut steps = truth(log).unwrap();
    let mut off = Pose::identity();
    for (k, step) in steps.iter_mut().enumerate() {
        let sway = |a: f64| (a * k as f64).sin();
        if k > 0 {
            off *= planar(shift * sway(1.3), shift * sway(2.1), turn * sway(0.7));
            step.corrected = true;
        }
        step.pose *= off;
        let spread = [shift, shift, 0.0, 0.0, 0.0, turn];
        step.covariance = Matrix6::from_fn(|i, j| if i == j { spread[i].powi(2) } else { 0.0 });
    }
    steps
}

/// Errors of the poses with respect to the first, metres at the object's middle and radians.
fn errors(log: &GraspLog, poses: impl Iterator<Item = Pose>) -> Vec<[f64; 2]> {
    let poses: Vec<Pose> = poses.collect();
    let gauge = poses[0].inverse() * log.grasps[0].truth.unwrap();
    let error = |(grasp, pose): (&LoggedGrasp, &Pose)| {
        let off = grasp.truth.unwrap().inverse() * pose * gauge;
        [off.translation.vector.norm(), off.rotation.angle()]
    };
    log.grasps.iter().zip(&poses).map(error).collect()
}

fn mean(errors: &[[f64; 2]], which: usize) -> f64 {
    errors.iter().map(|e| e[which]).sum::<f64>() / errors.len() as f64
}

#[test]
fn a_drift_is_corrected() {
    for object in ["rectangle:0.10x0.06", "corners:-0.05x-0.03,0.045x-0.035,0.055x0.02,-0.03x0.04"]
    {
        let log = simulate(&everywhere(object, 8, 3)).unwrap().log;
        let steps = drifting(&log, 3e-3, 0.04);
        let found = correct(&log, &steps).unwrap();
        let before = errors(&log, steps.iter().map(|s| s.pose));
        let after = errors(&log, found.steps.iter().map(|s| s.pose));
        assert!(mean(&after, 0) < 0.7 * mean(&before, 0), "{object}: {before:?} {after:?}");
        assert!(mean(&after, 1) < 0.6 * mean(&before, 1), "{object}: {before:?} {after:?}");
        assert!(!found.is_ambiguous() && found.explanations[0].weight > 0.9, "{object}");
        // The first pose defines the frame; no other is more certain than it was.
        assert!(local(&found.steps[0].pose, &steps[0].pose).norm() < 1e-9);
        assert!(found.steps[5].covariance[(5, 5)] < steps[5].covariance[(5, 5)]);
        assert!(found.beside[0][(5, 5)] > 0.0 && found.beside[5][(5, 5)] < 4e-3);
    }
}

#[test]
fn true_poses_stay_whatever_the_hand_says_it_did() {
    for seed in [3, 5] {
        let mut with = options("rectangle:0.12x0.06", seed);
        with.motion_noise = Deviation { length: 5e-3, angle: 0.17 };
        let log = simulate(&with).unwrap().log;
        let found = correct(&log, &truth(&log).unwrap()).unwrap();
        for [shift, turn] in errors(&log, found.steps.iter().map(|s| s.pose)) {
            assert!(shift < 5e-4 && turn < 5e-3, "{seed}: {shift} {turn}");
        }
    }
}

#[test]
fn similar_grasps_are_found_and_their_faces_are_true() {
    let log = simulate(&everywhere("rectangle:0.10x0.06", 6, 1)).unwrap().log;
    let found = correct(&log, &truth(&log).unwrap()).unwrap();
    assert!(found.edges.len() > 20, "{}", found.edges.len());
    // Contacts of one face have one true side.
    let mut sides = std::collections::BTreeMap::new();
    let mut wrong = 0;
    let contacts = log.grasps.iter().flat_map(|g| g.contacts.iter().map(move |c| (g, c)));
    for ((grasp, contact), face) in contacts.zip(&found.faces) {
        let Some(face) = face else { continue };
        let n = grasp.truth.unwrap().rotation.inverse() * contact.normal.unwrap();
        let side = (n.y.atan2(n.x) / std::f64::consts::FRAC_PI_2).round() as i32 & 3;
        wrong += usize::from(*sides.entry(*face).or_insert(side) != side);
    }
    assert_eq!((sides.len(), wrong), (4, 0));
    assert!(found.faces.iter().flatten().count() > 80);
}

#[test]
fn a_box_in_space_is_corrected() {
    let mut with = everywhere("box:0.12x0.06x0.06", 12, 2);
    with.grasps = Some(8);
    with.motion_noise = Deviation { length: 1e-3, angle: 0.01 };
    let log = simulate(&with).unwrap().log;
    let steps = drifting(&log, 1.5e-3, 0.03);
    let found = correct(&log, &steps).unwrap();
    let before = errors(&log, steps.iter().map(|s| s.pose));
    let after = errors(&log, found.steps.iter().map(|s| s.pose));
    assert!(found.edges.len() >= 8, "{:?}", found.edges);
    assert!(mean(&after, 1) < 0.7 * mean(&before, 1), "{before:?} {after:?}");
}

/// Every side of a regular polygon once, in the grasp's frame.
fn around(sides: usize, turned: f64) -> similarity::Touched {
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / sides as f64 + turned;
    let contact = |k: usize| {
        let n = Point::new(angle(k).cos(), angle(k).sin(), 0.0);
        let along = Point::new(-n.y, n.x, 0.0) * (5e-3 * (k as f64).sin());
        Contact {
            point: n * 0.039 + along,
            normal: Some(n),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    };
    similarity::Touched {
        contacts: (0..sides).map(contact).collect(),
        faces: (0..sides).map(Some).collect(),
    }
}

#[test]
fn a_hexagon_fits_every_sixty_degrees() {
    let (first, second) = (around(6, 0.0), around(6, 0.2));
    let wide = Allowed { translation: 0.05, rotation: 4.0 };
    let guess = planar(0.0, 0.0, 0.0);
    let found = alternatives(2, &first, &second, &guess, &wide);
    assert_eq!(found.len(), 6, "{found:?}");
    assert!(found[0].as_labelled() && !found[1].as_labelled());
    for one in &found {
        let turns = (crate::space::angle(&one.registered.pose) + 0.2) / std::f64::consts::FRAC_PI_3;
        assert!((turns - turns.round()).abs() < 1e-6);
    }
    // The motion may leave only some of them.
    let narrow = Allowed { translation: 0.05, rotation: 1.4 };
    assert_eq!(alternatives(2, &first, &second, &guess, &narrow).len(), 3);
    // A rectangle's sides only fit after half a turn.
    let mut oblong = [around(4, 0.0), around(4, 0.2)];
    for touched in &mut oblong {
        for c in touched.contacts.iter_mut().step_by(2) {
            c.point += c.normal.unwrap() * 0.02;
        }
    }
    assert_eq!(alternatives(2, &oblong[0], &oblong[1], &guess, &wide).len(), 2);
}

#[test]
fn grasps_that_say_too_little_have_no_alternatives() {
    let wide = Allowed { translation: 0.05, rotation: 4.0 };
    let guess = Pose::identity();
    let full = around(6, 0.0);
    let mut two = full.clone();
    two.contacts.truncate(2);
    two.faces.truncate(2);
    let mut bare = full.clone();
    bare.contacts.iter_mut().for_each(|c| c.normal = None);
    let mut broken = full.clone();
    broken.contacts.iter_mut().for_each(|c| c.point.x = f64::NAN);
    for other in [two, bare, broken, similarity::Touched::default()] {
        assert!(alternatives(2, &full, &other, &guess, &wide).is_empty());
        assert!(alternatives(2, &other, &full, &guess, &wide).is_empty());
    }
}

/// Grasps of all six sides of a hexagon that slips by `slip` before the fifth.
fn slipping(slip: f64) -> (GraspLog, Vec<Step>) {
    let mut log = simulate(&options("hexagon:0.045", 0)).unwrap().log;
    log.grasps.truncate(10);
    log.noise.rotation = Some(0.2);
    log.noise.translation = Some(0.01);
    let mut steps = Vec::new();
    for (k, grasp) in log.grasps.iter_mut().enumerate() {
        let pose = planar(0.0, 0.0, 0.1 * k as f64 + if k >= 5 { slip } else { 0.0 });
        grasp.motion = (k > 0).then(|| planar(0.0, 0.0, 0.1));
        grasp.truth = Some(pose);
        grasp.free.clear();
        let touched = around(6, 0.0);
        let template = grasp.contacts[0].clone();
        grasp.contacts = touched
            .contacts
            .iter()
            .map(|c| {
                let mut contact = template.clone();
                contact.point = (pose * Point3::from(c.point)).coords;
                contact.normal = c.normal.map(|n| pose.rotation * n);
                contact
            })
            .collect();
        let mut step = Step::certain(pose);
        step.corrected = k > 0;
        step.status = Status::Ambiguous;
        step.covariance = Matrix6::from_diagonal_element(1e-6);
        steps.push(step);
    }
    (log, steps)
}

#[test]
fn an_ambiguous_hexagon_keeps_its_alternatives() {
    // Half way between two sides: nobody can tell which way it slipped.
    let (log, steps) = slipping(std::f64::consts::FRAC_PI_6);
    let found = correct(&log, &steps).unwrap();
    assert!(found.is_ambiguous(), "{:?}", found.explanations);
    let [first, second] = [&found.explanations[0], &found.explanations[1]];
    assert!((first.weight - second.weight).abs() < 0.1, "{} {}", first.weight, second.weight);
    let apart = |k: usize| (first.poses[k].rotation.inverse() * second.poses[k].rotation).angle();
    assert!(apart(4) < 0.02 && (apart(5) - std::f64::consts::FRAC_PI_3).abs() < 0.02);
    assert_eq!(found.steps[9].status, Status::Ambiguous);
    let [a, b] = [&found.steps[9].modes[0], &found.steps[9].modes[1]];
    assert!(a.1 > 0.4 && b.1 > 0.4, "{a:?} {b:?}");
    assert_ne!(found.steps[3].status, Status::Ambiguous);
    // A tracker that is sure knows more than two grasps do.
    let sure = steps.iter().map(|s| Step { status: Status::Tracking, ..s.clone() });
    let found = correct(&log, &sure.collect::<Vec<_>>()).unwrap();
    assert!(found.explanations[0].weight > 0.9, "{:?}", found.explanations);
    // Where it moved as it should, another side is far less likely.
    let (log, steps) = slipping(0.0);
    let sure = correct(&log, &steps).unwrap();
    assert!(!sure.is_ambiguous() && sure.explanations[0].weight > 0.95, "{:?}", sure.explanations);
}

#[test]
fn as_printed_there_is_one_relative_pose_for_each_pair() {
    let (log, steps) = slipping(std::f64::consts::FRAC_PI_6);
    let rules = Rules { most: usize::MAX, as_printed: true };
    let found = correct_by(&log, &steps, rules).unwrap();
    assert_eq!((found.explanations.len(), found.refused), (1, 0));
    assert_eq!(found.edges.len(), 45);
    let few = correct_by(&log, &steps, Rules { most: 7, as_printed: true }).unwrap();
    assert_eq!(few.edges, found.edges[..7]);
}

#[test]
fn logs_without_similar_grasps_stay() {
    let log = simulate(&options("rectangle:0.10x0.06", 4)).unwrap().log;
    let steps = truth(&log).unwrap();
    let none = |change: fn(&mut GraspLog)| {
        let mut log = log.clone();
        change(&mut log);
        correct(&log, &steps[..log.grasps.len()]).is_none()
    };
    assert!(none(|l| l.grasps.clear()));
    assert!(none(|l| l.grasps.truncate(1)));
    assert!(none(|l| l.grasps.iter_mut().for_each(|g| g.contacts.truncate(2))));
    assert!(none(|l| l.grasps.iter_mut().for_each(|g| g.contacts.clear())));
    assert!(none(|l| {
        l.grasps.iter_mut().flat_map(|g| &mut g.contacts).for_each(|c| c.normal = None);
    }));
    assert!(correct(&log, &steps[1..]).is_none());
    // One grasp of numbers that are no numbers does not hurt the others.
    let mut broken = log.clone();
    broken.grasps[6].contacts.iter_mut().for_each(|c| c.point.x = f64::NAN);
    let mut lost = steps.clone();
    lost[9].pose.translation.x = f64::NAN;
    lost[9].covariance[(0, 0)] = f64::NAN;
    let found = correct(&broken, &lost).unwrap();
    assert!(found.edges.iter().flatten().all(|g| *g != 6));
    assert!(found.steps.iter().all(|s| s.pose.translation.vector.iter().all(|v| v.is_finite())));
}
