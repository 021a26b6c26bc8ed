use super::*;
use crate::experiment::tracking::judge::{Judgement, Truth, judge};
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::{Options, Simulation, simulate};
use crate::slam::track::Step;

/// A simulated object that slips by as much as the motions may err.
fn slipping(object: &str, grasps: usize, seed: u64, outliers: f64) -> Simulation {
    let spec: crate::sim::ObjectSpec = object.parse().unwrap();
    let angle = if spec.dimension() == 2 { 0.349 } else { 0.2007 };
    simulate(&Options {
        grasps: Some(grasps),
        seed,
        outliers,
        motion_noise: Deviation { length: 0.01, angle },
        ..Options::new(spec)
    })
    .unwrap()
}

fn found(log: &GraspLog) -> Vec<Vec<Pose>> {
    let problem = Problem::new(log);
    match log.dimension {
        2 => trajectories::<3>(&problem, None),
        _ => trajectories::<6>(&problem, None),
    }
}

fn judged(simulation: &Simulation) -> Judgement {
    let poses = found(&simulation.log).swap_remove(0);
    let steps: Vec<Step> = poses.into_iter().map(Step::certain).collect();
    judge(&simulation.log, &steps, &Truth::new(simulation.geometry.clone())).unwrap()
}

#[test]
fn an_ellipse_is_followed_through_slips() {
    for (seed, outliers) in [(21, 0.0), (22, 0.0), (23, 0.05)] {
        let judgement = judged(&slipping("ellipse:0.1x0.06", 12, seed, outliers));
        assert!(judgement.rms.translation < 6e-3, "{seed} {judgement:?}");
        assert!(judgement.rms.rotation < 0.15, "{seed} {judgement:?}");
    }
}

#[test]
fn a_cylinder_is_followed_through_slips() {
    let judgement = judged(&slipping("cylinder:0.06x0.1", 9, 31, 0.0));
    // Along the axis and about it, sides say nothing; where nobody felt an end, neither does the shape.
    assert!(judgement.rms.rotation < 0.1, "{judgement:?}");
    assert!(judgement.touched.unwrap().mean < 1.5e-3, "{judgement:?}");
}

#[test]
fn numbers_that_are_none_and_logs_that_are_long_give_nothing() {
    let simulation = slipping("ellipse:0.1x0.06", 4, 1, 0.0);
    let mut log = simulation.log.clone();
    for contact in log.grasps.iter_mut().flat_map(|g| &mut g.contacts) {
        contact.point.x = f64::NAN;
    }
    assert!(found(&log).is_empty());
    let mut long = simulation.log.clone();
    while long.grasps.len() <= MOST[0] {
        long.grasps.extend(simulation.log.grasps.clone());
    }
    assert!(found(&long).is_empty());
    assert!(found(&GraspLog { grasps: Vec::new(), ..simulation.log }).is_empty());
}

#[test]
fn steps_only_descend() {
    let simulation = slipping("ellipsoid:0.1x0.08x0.05", 4, 5, 0.0);
    let problem = Problem::new(&simulation.log);
    let mut one = begin(&problem, None).unwrap();
    for k in 1..4 {
        one.poses.push(problem.motions[k].pose * one.poses[k - 1]);
    }
    let mut before = f64::INFINITY;
    for _ in 0..12 {
        descend::<6>(&problem, &mut one, 1);
        assert!(one.cost <= before + 1e-9);
        before = one.cost;
    }
    let settled = one.clone();
    descend::<6>(&problem, &mut one, FINALLY);
    assert!(settled.cost - one.cost < 0.2 * settled.cost);
    assert_eq!(one.poses[0], settled.poses[0]);
}
