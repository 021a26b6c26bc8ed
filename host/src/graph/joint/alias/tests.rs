use super::*;
use crate::graph::joint::explain::{assigned, settle};
use crate::graph::joint::planes::{Effort, planes};
use crate::quantity::Deviation;
use crate::sim::{Options, simulate};
use crate::slam::track;

/// The first grasps define the object frame, but may be as wrong as any.
#[test]
fn the_first_grasps_at_a_look_alike_pose_come_back() {
    let motion_noise = Deviation { length: 3e-3, angle: 0.1 };
    let object = "lshape:0.09x0.09x0.035".parse().unwrap();
    let options = Options { motion_noise, grasps: Some(12), ..Options::new(object) };
    let log = simulate(&options).unwrap().log;
    let problem = Problem::new(&log);
    let truth = track::truth(&log).unwrap();
    let plain = Effort { rounds: 3, restarts: false, retrack: false };
    let right = planes(&log, &[&truth], plain).unwrap();
    let faces: Vec<Face> =
        right.faces.iter().map(|f| Face { normal: f.normal, offset: f.offset }).collect();
    let poses: Vec<Pose> = right.steps.iter().map(|step| step.pose).collect();
    let state = State { poses, faces, relations: Vec::new() };
    let best = settle::<3>(&problem, state.clone(), right.owners.clone()).unwrap();
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
