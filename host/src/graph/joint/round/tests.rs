use tactile_core::track::Status;

use super::body::{ROUGH, SHAPE, Side};
use super::descent::touches;
use super::parts::candidates;
use super::*;
use crate::experiment::tracking::judge::{Judgement, Truth, judge};
use crate::graph::Kind;
use crate::graph::joint::tangent::{Face, local};
use crate::log::GraspLog;
use crate::quantity::{Deviation, Displacement};
use crate::sim::{Options, Simulation, simulate};
use crate::slam::track::{Step, truth};

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

fn found(log: &GraspLog) -> Vec<Followed> {
    let problem = Problem::new(log);
    match log.dimension {
        2 => trajectories::<3>(&problem, &[], true),
        _ => trajectories::<6>(&problem, &[], true),
    }
}

/// Near the true poses.
fn near_truth(log: &GraspLog) -> Vec<Followed> {
    let problem = Problem::new(log);
    let truth: Vec<Pose> = log.grasps.iter().map(|g| g.truth.unwrap()).collect();
    match log.dimension {
        2 => trajectories::<3>(&problem, &[truth], false),
        _ => trajectories::<6>(&problem, &[truth], false),
    }
}

fn judged(simulation: &Simulation) -> Judgement {
    let Followed { poses, .. } = found(&simulation.log).swap_remove(0);
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
        descend::<6>(&problem, &mut one, 1, Free::All);
        assert!(one.cost <= before + 1e-9);
        before = one.cost;
    }
    let settled = one.clone();
    descend::<6>(&problem, &mut one, FINALLY, Free::All);
    assert!(settled.cost - one.cost < 0.2 * settled.cost);
    assert_eq!(one.poses[0], settled.poses[0]);
}

#[test]
fn an_end_that_single_contacts_felt_is_found() {
    // From no trajectory at all, at least as likely a one as near the truth.
    let log = slipping("cylinder:0.05x0.08", 10, 309, 0.0).log;
    let [found, near] = [found(&log), near_truth(&log)].map(|mut all| all.swap_remove(0));
    assert!(found.cost < near.cost + 1.0, "{} {}", found.cost, near.cost);
    assert!(found.is_body() && near.is_body(), "{found:?}");
}

#[test]
fn one_contact_is_reason_for_an_end() {
    let problem = Problem::new(&slipping("cylinder:0.06x0.08", 1, 1, 0.0).log);
    let touch = |point: Point, normal: Point| {
        let contact =
            Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.09 };
        crate::graph::joint::problem::Felt::new(0, contact)
    };
    let mut felt: Vec<_> = (0..6)
        .map(|i| {
            let (sin, cos) = f64::from(i).sin_cos();
            let normal = Point::new(cos, sin, 0.0);
            touch(normal * 0.03 + Point::z() * 0.01 * (f64::from(i) - 2.0), normal)
        })
        .collect();
    let of = |felt: &[_]| {
        let problem =
            Problem { felt: felt.to_vec(), starts: vec![0, felt.len()], ..problem.clone() };
        let body = Round {
            centre: Point::zeros(),
            side: Side::Cylinder(Point::z(), 0.03),
            ends: Vec::new(),
            rough: ROUGH[0],
        };
        let ball = (Point::zeros(), 0.04);
        let poses = vec![Pose::identity()];
        candidates(&problem, &Hypothesis { poses, body, ball, bounded: true, cost: 0.0 })
    };
    assert!(of(&felt).is_empty());
    felt.push(touch(Point::new(0.01, 0.0, 0.04), Point::z()));
    let [end] = of(&felt)[..] else { panic!("one end") };
    assert!((end.normal - Point::z()).norm() < 1e-9 && (end.offset - 0.04).abs() < 1e-9);
}

#[test]
fn only_what_is_round_is_a_round_body() {
    let is_body = |object: &str, outliers: f64| {
        let log = slipping(object, 8, 3, outliers).log;
        let both = found(&log).into_iter().chain(near_truth(&log));
        both.map(|found| found.is_body()).collect::<Vec<_>>()
    };
    assert!(is_body("ellipse:0.1x0.06", 0.0).contains(&true));
    assert!(is_body("ellipse:0.1x0.06", 0.05).contains(&true));
    // Two parallel sides are a quadric, and two ends close it; but a superquadric has all four.
    let log = slipping("rectangle:0.1x0.06", 8, 3, 0.0).log;
    let is_quadric = |found: &Followed| found.is_body() && !found.superquadric;
    assert!(!found(&log).iter().chain(&near_truth(&log)).any(is_quadric));
    assert!(near_truth(&log).iter().all(|found| found.superquadric && !found.is_plain()));
}

/// Corners of |x/a|⁴ + |y/b|⁴ = 1: no ellipse, and without flat sides.
fn squircle() -> String {
    let corner = |i: u32| {
        let (sin, cos) = (f64::from(i) / 64.0 * std::f64::consts::TAU).sin_cos();
        let out = (cos.powi(4) + sin.powi(4)).powf(-0.25);
        format!("{}x{}", 0.05 * out * cos, 0.03 * out * sin)
    };
    format!("corners:{}", (0..64).map(corner).collect::<Vec<_>>().join(","))
}

#[test]
fn motions_that_say_nothing_speak_neither_for_a_body_nor_against_it() {
    let simulated = |seed: u64, carried: Option<Displacement>| {
        let motion_noise = Deviation { length: 2.5e-3, angle: 0.0873 };
        let options = Options::new("ellipse:0.1x0.06".parse().unwrap());
        simulate(&Options { seed, motion_noise, carried, ..options }).unwrap().log
    };
    let seeds = 61..65;
    let fit = |log: &GraspLog| near_truth(log).swap_remove(0).per_degree;
    let mean =
        |log: &dyn Fn(u64) -> GraspLog| seeds.clone().map(|s| fit(&log(s))).sum::<f64>() / 4.0;
    let measured = mean(&|seed| simulated(seed, None));
    let unmeasured = mean(&|seed| {
        let mut log = simulated(seed, None);
        log.grasps.iter_mut().for_each(|grasp| grasp.motion = None);
        log
    });
    let carried = mean(&|seed| simulated(seed, Some(Displacement { length: 0.3, angle: 1.0 })));
    for fit in [measured, unmeasured, carried] {
        assert!((0.85..1.15).contains(&fit), "{measured} {unmeasured} {carried}");
    }
}

#[test]
fn what_no_quadric_explains_is_followed_as_a_superquadric() {
    let simulation = slipping(&squircle(), 12, 51, 0.0);
    let best = found(&simulation.log).swap_remove(0);
    assert!(best.superquadric && best.is_body() && best.is_start(), "{best:?}");
    let judgement = judged(&simulation);
    assert!(judgement.rms.rotation < 0.1, "{judgement:?}");
    assert!(judgement.touched.unwrap().mean < 1.2e-3, "{judgement:?}");
    // And what is believed of the object is that, neither faces nor an ellipse.
    let steps: Vec<Step> = best.poses.into_iter().map(Step::certain).collect();
    let corrected = crate::graph::joint::correct(&simulation.log, &steps).unwrap();
    assert!(corrected.faces.is_empty() && corrected.cost < best.cost + 1.0);
}

#[test]
fn a_block_is_faces_though_a_superquadric_explains_it() {
    for object in ["rectangle:0.1x0.06", "box:0.1x0.07x0.05"] {
        let log = slipping(object, 12, 8, 0.0).log;
        let best = near_truth(&log).swap_remove(0);
        assert!(best.superquadric && best.is_body(), "{object} {best:?}");
        let truth: Vec<Step> = log.grasps.iter().map(|g| Step::certain(g.truth.unwrap())).collect();
        let corrected = crate::graph::joint::refine(&log, &truth).unwrap();
        assert_eq!(corrected.faces.len(), 2 * log.dimension, "{object}");
    }
}

#[test]
fn a_change_of_one_number_is_seen_in_that_number() {
    let spread = |count: usize| -> Vec<Contact> {
        let contact = |i: usize| {
            let (around, up) = ((i as f64).sin_cos(), (0.37 * i as f64).sin());
            let normal = Point::new(around.1, around.0, up).normalize();
            let point = normal.component_mul(&Point::new(0.05, 0.04, 0.03));
            Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.1 }
        };
        (0..count).map(contact).collect()
    };
    let ball = (Point::new(0.01, 0.0, -0.01), 0.04);
    let quadric = Round::ball(3, &ball);
    let superquadric = quadric.superquadric(3, &spread(40)).unwrap();
    let cylinder = quadric.cylinders().swap_remove(0);
    for body in [quadric, cylinder, superquadric] {
        // Seen from its own centre, for a turn about another one shifts it, too.
        let ball = (body.centre, ball.1);
        assert!(body.is_like(&body) && body.is_round(ball.1));
        let before = body.oddity(3, &ball);
        for number in 0..body.width(3) {
            let mut by = nalgebra::DVector::zeros(body.width(3));
            by[number] = 1e-5;
            let mut seen = body.nudged(3, ball.1, &by).oddity(3, &ball) - &before;
            let drawn = if body.is_drawn(3, number) { 1e-5 / SHAPE } else { 0.0 };
            seen[number] -= drawn;
            assert!(seen.amax() < 1e-8, "{number} {seen} {body:?}");
        }
    }
}

#[test]
fn wild_contacts_neither_bend_the_trajectory_nor_make_normals_rough() {
    let log = slipping("ellipsoid:0.1x0.07x0.05", 12, 700, 0.15).log;
    let [found, near] = [found(&log), near_truth(&log)].map(|mut all| all.swap_remove(0));
    assert!(found.cost < near.cost + 1.0, "{} {}", found.cost, near.cost);
    assert!(!found.rough && found.per_degree < 1.2 && found.wild > 0.05, "{found:?}");
}

#[test]
fn at_the_true_poses_stay_the_body_alone_is_fitted() {
    let log = slipping("ellipsoid:0.1x0.08x0.05", 8, 7, 0.0).log;
    let problem = Problem::new(&log);
    let poses: Vec<Pose> = log.grasps.iter().map(|g| g.truth.unwrap()).collect();
    let ball = ball(&problem, &poses).unwrap();
    let body = Round::ball(3, &ball);
    let cost = f64::INFINITY;
    let mut one = Hypothesis { poses: poses.clone(), body, ball, bounded: true, cost };
    descend::<6>(&problem, &mut one, FINALLY, Free::Body);
    assert!(one.poses.iter().zip(&poses).all(|(a, b)| local(a, b).norm() < 1e-12));
    assert!(touches(&problem, &one).iter().all(|touched| touched.misfit < 9.0));
    let Side::Quadric(root) = one.body.side else { panic!("a quadric") };
    let mut axes: Vec<f64> = nalgebra::SymmetricEigen::new(root * root.transpose())
        .eigenvalues
        .iter()
        .map(|inverse| 2.0 / inverse.sqrt())
        .collect();
    axes.sort_by(f64::total_cmp);
    for (axis, truly) in axes.iter().zip([0.05, 0.08, 0.1]) {
        assert!((axis - truly).abs() < 5e-3, "{axes:?}");
    }
}

#[test]
fn a_body_is_the_same_in_another_frame() {
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1);
    let frame = Pose::from_parts(Point::new(0.02, -0.01, 0.03).into(), turn);
    let end = Face { normal: Point::new(0.0, 0.6, 0.8), offset: 0.03 };
    let root = nalgebra::Matrix3::new(20.0, 0.0, 0.0, 3.0, 30.0, 0.0, -4.0, 5.0, 25.0);
    let centre = Point::new(0.01, 0.0, -0.02);
    let axis = Point::new(0.0, 0.6, 0.8);
    let touches: Vec<Contact> = (0..20)
        .map(|i| {
            let (sin, cos) = f64::from(i).sin_cos();
            let normal = Point::new(cos, sin, 0.5 * (2.0 * f64::from(i)).sin()).normalize();
            let point = centre + normal.component_mul(&Point::new(0.05, 0.03, 0.04));
            Contact { point, normal: None, point_deviation: 1e-3, normal_deviation: 0.1 }
        })
        .collect();
    let superquadric = Round::ball(3, &(centre, 0.04)).superquadric(3, &touches).unwrap().side;
    for side in [Side::Quadric(root), Side::Cylinder(axis, 0.03), superquadric] {
        let body = Round { centre, side, ends: vec![end], rough: ROUGH[0] };
        let moved = body.transformed(3, &frame).unwrap();
        let [here, there] = [&body, &moved].map(|body| body.field(0.04).unwrap());
        for (x, y) in [(0.05, 0.01), (-0.03, 0.04), (0.0, -0.05)] {
            let normal = Some(Point::new(x, y, 0.02).normalize());
            let felt = Contact {
                point: Point::new(x, y, 0.02),
                normal,
                point_deviation: 1e-3,
                normal_deviation: 0.1,
            };
            let [a, b] = [here.residual(&felt), there.residual(&felt.transformed(&frame))];
            assert!((a[0] - b[0]).abs() < 1e-5 * (1.0 + a[0].abs()), "{a} {b}");
            assert!((a.norm() - b.norm()).abs() < 1e-5 * (1.0 + a.norm()), "{a} {b}");
        }
    }
    let flat = Round::ball(2, &(centre, 0.03)).transformed(2, &Pose::rotation(Point::z() * 0.5));
    let Side::Quadric(root) = flat.unwrap().side else { panic!("a quadric") };
    assert!(root.row(2).norm() == 0.0 && root.column(2).norm() == 0.0);
}

#[test]
fn a_reversed_problem_foretells_the_same_poses() {
    let mut log = slipping("ellipse:0.1x0.06", 5, 2, 0.0).log;
    for grasp in 1..5 {
        let [before, after] = [grasp - 1, grasp].map(|k| log.grasps[k].truth.unwrap());
        log.grasps[grasp].motion = Some(after * before.inverse());
    }
    let problem = Problem::new(&log);
    let back = problem.reversed();
    let last = log.grasps[4].truth;
    for (found, grasp) in back.poses(&[last]).iter().zip(log.grasps.iter().rev()) {
        assert!(local(found, &grasp.truth.unwrap()).norm() < 1e-9);
    }
    assert_eq!(back.of(0).len(), problem.of(4).len());
    assert_eq!(back.felt[0].contact, problem.felt[problem.starts[4]].contact);
    assert!(back.felt.iter().all(|f| !back.of(f.grasp).is_empty()));
    assert_eq!(back.reversed().felt, problem.felt);
}

/// What a contact with exact point and normal costs a cylinder of 30 mm with an end at 50 mm.
fn of_a_can(point: Point, normal: Point) -> f64 {
    let end = Face { normal: Point::z(), offset: 0.05 };
    let side = Side::Cylinder(Point::z(), 0.03);
    let can = Round { centre: Point::zeros(), side, ends: vec![end], rough: ROUGH[0] };
    let contact = Contact {
        point,
        normal: Some(normal.normalize()),
        point_deviation: 1e-4,
        normal_deviation: 1e-3,
    };
    can.field(0.05).unwrap().residual(&contact).norm()
}

#[test]
fn on_an_edge_the_normal_lies_between_the_parts() {
    let edge = Point::new(0.03, 0.0, 0.05);
    let between = Point::new(1.0, 0.0, 0.7);
    // No more than that edges are rare.
    assert!(of_a_can(edge, between) < 2.5);
    assert!(of_a_can(edge, Point::x()) < 1e-6 && of_a_can(edge, Point::z()) < 1e-6);
    // Neither beside the edge, nor with a normal that is not between them.
    assert!(of_a_can(Point::new(0.03, 0.0, 0.04), between) > 20.0);
    assert!(of_a_can(Point::new(0.02, 0.0, 0.05), between) > 20.0);
    for outside in
        [Point::new(1.0, 0.5, 0.7), Point::new(1.0, 0.0, -0.5), Point::new(-0.5, 0.0, 1.0)]
    {
        assert!(of_a_can(edge, outside) > 20.0, "{outside}");
    }
}

#[test]
fn normals_need_not_be_as_exact_as_they_are_said_to_be() {
    let options = Options {
        grasps: Some(6),
        seed: 310,
        motion_noise: Deviation { length: 0.01, angle: 0.2007 },
        contact_noise: Deviation { length: 1e-3, angle: 0.05 },
        ..Options::new("cylinder:0.06x0.09".parse().unwrap())
    };
    let Simulation { mut log, geometry, .. } = simulate(&options).unwrap();
    let rough = |log: &GraspLog| {
        let poses: Vec<Pose> = log.grasps.iter().map(|g| g.truth.unwrap()).collect();
        near::<6>(&Problem::new(log), &poses).unwrap().body.rough
    };
    assert_eq!(rough(&log), ROUGH[0]);
    log.noise.normal = Some(1e-3);
    for contact in log.grasps.iter_mut().flat_map(|grasp| &mut grasp.contacts) {
        contact.normal_noise = None;
    }
    assert_eq!(rough(&log), ROUGH[2]);
    let best = found(&log).swap_remove(0);
    assert!(best.is_body(), "{best:?}");
    let steps: Vec<Step> = best.poses.into_iter().map(Step::certain).collect();
    let judgement = judge(&log, &steps, &Truth::new(geometry)).unwrap();
    assert!(judgement.rms.rotation < 0.1, "{judgement:?}");
}

#[test]
fn the_log_backwards_tells_what_it_does_not_forwards() {
    let log = slipping("cylinder:0.05x0.08", 8, 405, 0.0).log;
    let problem = Problem::new(&log);
    let first = log.grasps[0].truth;
    let least = |all: &[Hypothesis]| all.first().map_or(f64::INFINITY, |one| one.cost);
    let ahead = least(&follow::<6>(&problem, first));
    let back = backwards::<6>(&problem, first);
    assert!(least(&back) < ahead - 5.0, "{ahead} {}", least(&back));
    // In the frame of the first grasp, as if the log had been followed forwards.
    assert_eq!(Some(back[0].poses[0]), first);
    let near = trajectories::<6>(&problem, &[back[0].poses.clone()], false);
    let all = trajectories::<6>(&problem, &[], true);
    assert!(near[0].cost < least(&back) + 1.0 && all[0].cost < near[0].cost + 1.0);
}

/// A contact without a normal says one number, how far it lies off.
#[test]
fn without_normals_the_right_body_fits_to_noise_and_another_does_not() {
    let bare = |object: &str, seed| {
        let mut log = slipping(object, 16, seed, 0.0).log;
        log.grasps.iter_mut().flat_map(|g| &mut g.contacts).for_each(|c| c.normal = None);
        near_truth(&log).swap_remove(0)
    };
    let mean = |object: &str| (1..5).map(|seed| bare(object, seed).per_degree).sum::<f64>() / 4.0;
    let [ellipse, octagon] = ["ellipse:0.1x0.06", "ngon:8,0.045"].map(mean);
    assert!((0.75..1.2).contains(&ellipse) && octagon > 1.3, "{ellipse} {octagon}");
}

/// As flat faces say it: not every grasp that is given a pose was felt there.
#[test]
fn a_grasp_of_something_else_stays_lost_beside_a_ball() {
    const ELSEWHERE: usize = 9;
    let motion_noise = Deviation { length: 3e-3, angle: 5f64.to_radians() };
    let spec = "sphere:0.07".parse().unwrap();
    let options = Options { grasps: Some(12), motion_noise, seed: 2, ..Options::new(spec) };
    let mut log = simulate(&options).unwrap().log;
    for contact in &mut log.grasps[ELSEWHERE].contacts {
        contact.point += Point::new(0.5, 0.1, -0.2);
        contact.normal = contact.normal.map(|normal| Point::new(normal.y, normal.z, normal.x));
    }
    let mut steps = truth(&log).unwrap();
    steps[ELSEWHERE].status = Status::Lost;
    steps[4].status = Status::Lost;
    let corrected = Kind::Planes.correct(&log, &steps).unwrap();
    assert!(corrected.faces.is_none());
    let lost: Vec<usize> = (0..12).filter(|k| corrected.steps[*k].status == Status::Lost).collect();
    assert_eq!(lost, [ELSEWHERE]);
}
