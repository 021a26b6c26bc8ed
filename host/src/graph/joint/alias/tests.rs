use super::*;
use crate::graph::joint::explain::{assigned, settle};
use crate::graph::joint::planes::{Effort, planes};
use crate::graph::joint::problem::Motion;
use crate::graph::joint::solve::solve;
use crate::graph::joint::tests::at_truth;
use crate::quantity::Deviation;
use crate::sim::{Options, simulate};
use crate::slam::trackers::Kind;

#[test]
fn lone_contacts_suggest_planes_as_uncertain_as_they_are() {
    let log = simulate(&Options::new("rectangle:0.10x0.06".parse().unwrap())).unwrap().log;
    let (problem, state, mut labels) = at_truth(&log);
    labels[7] = None;
    let solved = solve::<3>(&problem, state, labels).unwrap();
    let all = targets(&problem, &solved);
    let lone = all.iter().find(|target| target.contact == Some(7)).unwrap();
    let variance = problem.felt[7].contact.normal_deviation.powi(2);
    assert!((lone.plane.normal_covariance.trace() / variance - 1.0).abs() < 1e-9);
}

/// What a grasp's contacts suggest themselves is no reason to stay, for it or for those that it takes along.
#[test]
fn a_move_of_contacts_that_no_face_explains_promises_what_it_gains() {
    let motion_noise = Deviation { length: 2e-4, angle: 4e-3 };
    let object = "rectangle:0.10x0.06".parse().unwrap();
    let log = simulate(&Options { motion_noise, ..Options::new(object) }).unwrap().log;
    let (problem, state, labels) = at_truth(&log);
    let best = settle::<3>(&problem, state.clone(), labels).unwrap();
    for until in [6, 8] {
        let (mut wrong, mut labels) = (state.clone(), best.labels.clone());
        for k in 6..=until {
            wrong.poses[k] *= Pose::rotation(Point::z() * 0.5);
            problem.of(k).for_each(|i| labels[i] = None);
        }
        // Where the motions lead.
        let mut problem = problem.clone();
        for k in [6, until + 1] {
            let pose = wrong.poses[k] * wrong.poses[k - 1].inverse();
            problem.motions[k] = Motion { pose, deviations: [0.01, 0.3], measured: true };
        }
        let wrong = solve::<3>(&problem, wrong, labels).unwrap();
        let moves = moves(&problem, &wrong, &targets(&problem, &wrong), &|_| true);
        let back = moves.iter().filter(|m| m.moved == (6..=until)).map(|m| m.change);
        let promised = back.fold(0.0, f64::min);
        let contacts = (problem.starts[until + 1] - problem.starts[6]) as f64;
        assert!(promised < -4.0 * contacts, "{until}: {promised} of {contacts}");
    }
}

/// A wrong first motion by 200 mm and 86°: all others agree where the object is, and the first grasp was made there.
#[test]
fn a_grasp_made_far_from_where_motions_lead_is_found_on_the_object() {
    for (object, seed) in [("rectangle:0.12x0.06", 0), ("triangle:0.06", 0), ("triangle:0.06", 1)] {
        let motion_noise = Deviation { length: 5e-3, angle: 10f64.to_radians() };
        let options = Options { motion_noise, seed, ..Options::new(object.parse().unwrap()) };
        let mut log = simulate(&options).unwrap().log;
        let wrong = Pose::translation(0.2, 0.0, 0.0) * Pose::rotation(Point::z() * 1.5);
        log.grasps[1].motion = log.grasps[1].motion.map(|motion| wrong * motion);
        let steps = Kind::Automatic.follow(&log, 0);
        let found = planes(&log, &[&steps], Effort::default()).unwrap();
        let first = log.grasps[0].contacts.len();
        let on_faces = found.owners[..first].iter().filter(|owner| owner.is_some()).count();
        assert!(on_faces + 1 >= first, "{object} {seed}: {on_faces} of {first}");
        // As far off as a turn by which it looks the same moves its frame, and no farther.
        let frames = [0, 9].map(|k| log.grasps[k].truth.unwrap().inverse() * found.steps[k].pose);
        let off = (frames[0].inverse() * frames[1]).translation.vector.norm();
        assert!(off < 0.1, "{object} {seed}: {off} m");
    }
}

/// The first grasps define the object frame, but may be as wrong as any.
#[test]
fn the_first_grasps_at_a_look_alike_pose_come_back() {
    let motion_noise = Deviation { length: 3e-3, angle: 0.1 };
    let object = "lshape:0.09x0.09x0.035".parse().unwrap();
    let options = Options { motion_noise, grasps: Some(12), ..Options::new(object) };
    let log = simulate(&options).unwrap().log;
    let (problem, state, labels) = at_truth(&log);
    let best = settle::<3>(&problem, state.clone(), labels).unwrap();
    for until in [0, 3] {
        let mut wrong = state.clone();
        for pose in &mut wrong.poses[..=until] {
            *pose *= Pose::rotation(Point::z() * std::f64::consts::FRAC_PI_2);
        }
        let labels = assigned(&problem, &wrong);
        let mut found = settle::<3>(&problem, wrong.clone(), labels).unwrap();
        assert!(found.cost > best.cost + 5.0, "{} {}", found.cost, best.cost);
        while restart(&problem, &mut found) {}
        assert!(found.cost < best.cost + 0.5, "{until}: {} {}", found.cost, best.cost);
        // The frame is where it was put, and the grasps are to each other as they should be.
        assert_eq!(found.state.poses[0], wrong.poses[0]);
        for (found, best) in found.state.poses.iter().zip(&best.state.poses) {
            let [found, best] = [(found, &wrong.poses[0]), (best, &state.poses[0])]
                .map(|(pose, first)| pose * first.inverse());
            assert!(are_near(&found, &best, SAME), "{until}: {found} {best}");
        }
    }
}
