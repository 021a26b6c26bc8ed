//! How the world lies must not matter.

use super::planes::{Effort, planes};
use super::tangent::local;
use crate::log::GraspLog;
use crate::sim::{Options, simulate};
use crate::space::{Point, Pose, planar};

/// The same grasps in a world that lies differently.
fn moved(log: &GraspLog, world: &Pose) -> GraspLog {
    let mut log = log.clone();
    for grasp in &mut log.grasps {
        let free = grasp.free.iter_mut().map(|free| &mut free.point);
        for point in grasp.contacts.iter_mut().map(|c| &mut c.point).chain(free) {
            *point = world.rotation * *point + world.translation.vector;
        }
        for normal in grasp.contacts.iter_mut().filter_map(|c| c.normal.as_mut()) {
            *normal = world.rotation * *normal;
        }
        grasp.motion = grasp.motion.map(|motion| world * motion * world.inverse());
        grasp.truth = grasp.truth.map(|truth| world * truth);
    }
    log
}

#[test]
fn how_the_world_lies_does_not_matter() {
    let world = planar(0.3, -0.2, 0.65);
    for seed in [3, 5] {
        let object = "lshape:0.09x0.09x0.035".parse().unwrap();
        let options = Options { seed, grasps: Some(16), ..Options::new(object) };
        let log = simulate(&options).unwrap().log;
        let here = planes(&log, &[], Effort::default()).unwrap();
        let there = planes(&moved(&log, &world), &[], Effort::default()).unwrap();
        assert_eq!(here.faces.len(), there.faces.len());
        // The object's axes are along the world's in the first grasp.
        let frame = Pose::from_parts(Point::zeros().into(), world.rotation);
        for (k, (a, b)) in here.steps.iter().zip(&there.steps).enumerate() {
            let off = local(&(world * a.pose * frame.inverse()), &b.pose);
            assert!(off.norm() < 2e-3, "{seed}, grasp {k}: {off}");
        }
    }
}
