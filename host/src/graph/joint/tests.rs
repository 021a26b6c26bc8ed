use nalgebra::SVector;
use proptest::prelude::*;

use super::alias::restart;
use super::average::averaged;
use super::explain::{improve, settle};
use super::planes::{Corrected, Effort, Plane, criterion, planes};
use super::problem::{Labels, Problem, State};
use super::relation::Relation;
use super::retrack::backwards;
use super::solve::{linearise, solve};
use super::tangent::{Tangent, axes, local, retract};
use crate::graph::Kind;
use crate::log::{GraspLog, LoggedContact, LoggedFree};
use crate::model::faces::Owner;
use crate::quantity::Deviation;
use crate::shape::Geometry;
use crate::sim::{Options, simulate};
use crate::slam::choose::Choice;
use crate::slam::reconstruct::reconstruct_known;
use crate::slam::track::{self, Step};
use crate::space::{Point, Pose};

const NONE: Deviation = Deviation { length: 0.0, angle: 0.0 };

const PLAIN: Effort = Effort { rounds: 3, restarts: false, retrack: false };

fn options(object: &str, grasps: usize) -> Options {
    Options { grasps: Some(grasps), ..Options::new(object.parse().unwrap()) }
}

/// Contacts and motions without noise.
pub(super) fn exact(object: &str, grasps: usize) -> GraspLog {
    let options = Options { contact_noise: NONE, motion_noise: NONE, ..options(object, grasps) };
    simulate(&options).unwrap().log
}

/// The true poses, each but the first displaced by less than `reach` (metres; radians tenfold).
fn displaced(log: &GraspLog, reach: f64) -> Vec<Step> {
    let mut state = 7u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        reach * ((state >> 40) as f64 / f64::from(1 << 23) - 1.0)
    };
    let planar = log.dimension == 2;
    let mut steps = track::truth(log).unwrap();
    for step in steps.iter_mut().skip(1) {
        let mut t = Tangent::from_fn(|i, _| if i < 3 { next() } else { 10.0 * next() });
        if planar {
            t[2] = 0.0;
            t[3] = 0.0;
            t[4] = 0.0;
        }
        step.pose = retract(&step.pose, &t);
    }
    steps
}

/// Largest difference to the true poses: metres, radians.
fn errors(log: &GraspLog, steps: &[Step]) -> (f64, f64) {
    let apart = log.grasps.iter().zip(steps).map(|(g, s)| local(&g.truth.unwrap(), &s.pose));
    apart.fold((0.0, 0.0), |(t, w), e| {
        (t.max(e.fixed_rows::<3>(0).norm()), w.max(e.fixed_rows::<3>(3).norm()))
    })
}

fn from_truth(log: &GraspLog) -> Corrected {
    planes(log, &[&track::truth(log).unwrap()], PLAIN).unwrap()
}

#[test]
fn displaced_poses_are_recovered_exactly_without_noise() {
    for object in ["rectangle:0.10x0.06", "hexagon:0.045", "box:0.12x0.06x0.06"] {
        let log = exact(object, 10);
        let corrected = planes(&log, &[&displaced(&log, 2e-3)], PLAIN).unwrap();
        let (t, w) = errors(&log, &corrected.steps);
        assert!(t < 1e-6 && w < 1e-6, "{object}: {t} m, {w} rad");
        assert!(corrected.per_degree < 1e-6 && corrected.explained() == 1.0);
        assert_eq!(corrected.steps[0].pose, log.grasps[0].truth.unwrap());
    }
}

#[test]
fn a_trajectory_is_found_without_any_tracker() {
    for (object, faces) in [("triangle:0.06", 3), ("rectangle:0.10x0.06", 4)] {
        let log = simulate(&options(object, 12)).unwrap().log;
        let corrected = planes(&log, &[], Effort::default()).unwrap();
        assert_eq!(corrected.faces.len(), faces, "{object}");
        assert_eq!(corrected.explained(), 1.0);
        let best = from_truth(&log);
        assert!(corrected.per_degree < 1.6 * best.per_degree.max(1.0), "{}", corrected.per_degree);
    }
}

#[test]
fn the_log_backwards_has_the_same_faces_and_first_pose() {
    let log = exact("triangle:0.06", 10);
    let problem = Problem::new(&log);
    let first = log.grasps[0].truth.unwrap();
    let found = backwards::<3>(&problem, Some(first)).unwrap();
    assert_eq!(found.state.poses[0], first);
    assert_eq!(found.labels.iter().flatten().count(), found.labels.len());
    let steps: Vec<Step> = found.state.poses.iter().map(|pose| Step::certain(*pose)).collect();
    let (t, w) = errors(&log, &steps);
    assert!(t < 1e-6 && w < 1e-6, "{t} {w}");
    let known = from_truth(&log);
    assert_eq!(found.state.faces.len(), 3);
    for face in &found.state.faces {
        let same = |other: &Plane| {
            (face.normal - other.normal).norm() < 1e-6 && (face.offset - other.offset).abs() < 1e-6
        };
        assert!(known.faces.iter().any(same), "{face:?}");
    }
}

#[test]
fn the_faces_are_the_objects() {
    let log = exact("rectangle:0.10x0.06", 10);
    let corrected = from_truth(&log);
    let mut offsets: Vec<f64> = corrected.faces.iter().map(|f| f.offset).collect();
    offsets.sort_by(f64::total_cmp);
    assert_eq!(offsets.len(), 4);
    for (found, known) in offsets.iter().zip([0.03, 0.03, 0.05, 0.05]) {
        assert!((found - known).abs() < 1e-9);
    }
    assert_eq!(corrected.faces.iter().map(|f| f.contacts).sum::<usize>(), 50);
    for face in &corrected.faces {
        assert!(face.covariance[(2, 2)] > 0.0 && face.covariance[(1, 1)] == 0.0);
    }
}

#[test]
fn a_wrong_label_is_repaired() {
    let log = simulate(&options("rectangle:0.10x0.06", 10)).unwrap().log;
    let (problem, state, labels) = at_truth(&log);
    let right = settle::<3>(&problem, state, labels).unwrap();
    for contact in [3, 17, 40] {
        let mut labels = right.labels.clone();
        let other = |owner: Owner| (owner.faces()[0] + 1) % right.state.faces.len();
        labels[contact] = labels[contact].map(|owner| Owner::Face(other(owner)));
        let again = settle::<3>(&problem, right.state.clone(), labels).unwrap();
        assert_eq!(again.labels, right.labels);
        assert!((again.cost - right.cost).abs() < 0.02);
    }
}

/// Problem, state and labels at the true poses.
pub(super) fn at_truth(log: &GraspLog) -> (Problem, State, Labels) {
    let problem = Problem::new(log);
    let corrected = from_truth(log);
    let poses = corrected.steps.iter().map(|s| s.pose).collect();
    let face = |p: &super::Plane| super::tangent::Face { normal: p.normal, offset: p.offset };
    let faces = corrected.faces.iter().map(face).collect();
    (problem, State { poses, faces, relations: Vec::new() }, corrected.owners)
}

#[test]
fn faces_that_are_one_merge_and_what_was_merged_parts() {
    let log = simulate(&options("rectangle:0.10x0.06", 10)).unwrap().log;
    let (problem, state, labels) = at_truth(&log);
    let right = settle::<3>(&problem, state.clone(), labels.clone()).unwrap();
    // Every other contact of the first face makes a face of its own.
    let mut doubled = state.clone();
    doubled.faces.push(state.faces[0]);
    let mut parted = labels.clone();
    for (i, label) in parted.iter_mut().enumerate() {
        if *label == Some(Owner::Face(0)) && i % 2 == 0 {
            *label = Some(Owner::Face(4));
        }
    }
    let mut best = solve::<3>(&problem, doubled, parted).unwrap();
    assert!(best.cost > right.cost + 3.0);
    while improve(&problem, &mut best) {}
    assert!(best.cost < right.cost + 0.02, "{} {}", best.cost, right.cost);
    assert_eq!(best.state.faces.len(), 4);
    // Two faces at a right angle as one.
    let near = (1..4).find(|j| state.faces[*j].normal.dot(&state.faces[0].normal).abs() < 0.5);
    let near = near.unwrap();
    let [near, first] = [near, 0].map(|face| Some(Owner::Face(face)));
    let merged = labels.iter().map(|l| if *l == near { first } else { *l }).collect();
    let mut best = settle::<3>(&problem, state, merged).unwrap();
    assert!(best.cost > right.cost + 3.0);
    while improve(&problem, &mut best) || restart(&problem, &mut best) {}
    assert!(best.cost < right.cost + 0.02, "{} {}", best.cost, right.cost);
    assert_eq!(best.state.faces.len(), 4);
}

#[test]
fn a_grasp_at_a_look_alike_pose_comes_back() {
    let log = simulate(&Options {
        motion_noise: Deviation { length: 3e-3, angle: 0.1 },
        ..options("triangle:0.06", 12)
    })
    .unwrap()
    .log;
    let best = from_truth(&log);
    let turn = 120f64.to_radians();
    let centre = Pose::translation(0.0, 0.0, 0.0);
    for all_after in [false, true] {
        let mut steps = best.steps.clone();
        let last = if all_after { steps.len() } else { 6 };
        for step in &mut steps[5..last] {
            step.pose = step.pose * centre * Pose::rotation(Point::z() * turn);
        }
        let effort = Effort { restarts: true, ..PLAIN };
        let stuck = planes(&log, &[&steps], PLAIN).unwrap();
        let corrected = planes(&log, &[&steps], effort).unwrap();
        assert!(stuck.cost > best.cost + 5.0, "{} {}", stuck.cost, best.cost);
        assert!(corrected.cost < best.cost + 0.5, "{} {}", corrected.cost, best.cost);
        let (t, w) = errors(&log, &corrected.steps);
        assert!(t < 6e-3 && w < 0.12, "{t} {w}");
    }
}

#[test]
fn wild_contacts_bend_nothing() {
    for object in ["rectangle:0.10x0.06", "box:0.12x0.06x0.06"] {
        let clean = simulate(&options(object, 12)).unwrap().log;
        let wild = simulate(&Options { outliers: 0.1, ..options(object, 12) }).unwrap().log;
        let (before, after) = (from_truth(&clean), from_truth(&wild));
        assert_eq!(before.faces.len(), after.faces.len(), "{object}");
        assert!(after.explained() > 0.8 && after.explained() < 0.97, "{}", after.explained());
        for (a, b) in before.steps.iter().zip(&after.steps) {
            let apart = local(&a.pose, &b.pose);
            let doubt = b.covariance.trace().sqrt() + a.covariance.trace().sqrt();
            assert!(apart.norm() < 3.0 * doubt + 1e-9, "{apart} {doubt}");
        }
    }
}

#[test]
fn unknown_motions_are_no_evidence() {
    let mut log = exact("triangle:0.06", 8);
    for k in [2, 3, 6] {
        log.grasps[k].motion = None;
    }
    log.grasps[5].motion = Some(Pose::translation(f64::NAN, 0.0, 0.0));
    let corrected = planes(&log, &[&displaced(&log, 2e-3)], PLAIN).unwrap();
    // Five contacts on three faces leave nothing open.
    let (t, w) = errors(&log, &corrected.steps);
    assert!(t < 1e-4 && w < 1e-3, "{t} {w}");
    let known = planes(&exact("triangle:0.06", 8), &[&displaced(&log, 2e-3)], PLAIN).unwrap();
    let doubt = |c: &Corrected, k: usize| c.given_faces[k].trace();
    for k in [2, 3, 5, 6] {
        assert!(doubt(&corrected, k) < 0.01 && doubt(&corrected, k) > doubt(&known, k));
    }
}

#[test]
fn a_grasp_slides_no_farther_than_its_sides() {
    let mut log = exact("rectangle:0.10x0.06", 10);
    log.noise.translation = Some(0.02);
    let truth = track::truth(&log).unwrap();
    // The fifth grasp felt the long sides only, and is said to have slid along them by 70 mm.
    let (before, there, after) = (truth[3].pose, truth[4].pose, truth[5].pose);
    let slid = there * Pose::translation(0.07, 0.0, 0.0);
    let mut felt = log.grasps[4].contacts[..3].to_vec();
    for (contact, [x, side]) in felt.iter_mut().zip([[-0.01, 1.0], [0.012, 1.0], [0.0, -1.0]]) {
        contact.point = (there * nalgebra::Point3::new(x, 0.03 * side, 0.0)).coords;
        contact.normal = Some(there.rotation * Point::y() * side);
    }
    log.grasps[4].contacts = felt;
    log.grasps[4].motion = Some(slid * before.inverse());
    log.grasps[5].motion = Some(after * slid.inverse());
    let mut steps = truth.clone();
    steps[4].pose = slid;
    let corrected = planes(&log, &[&steps], PLAIN).unwrap();
    let placed = |steps: &[Step]| {
        let inverse = steps[4].pose.inverse();
        let place = move |c: &LoggedContact| (inverse * nalgebra::Point3::from(c.point)).coords;
        log.grasps[4].contacts.iter().map(place).collect::<Vec<_>>()
    };
    assert!(placed(&steps).iter().all(|p| p.x < -0.057));
    let held = placed(&corrected.steps);
    assert!(held.iter().all(|p| p.x > -0.051 && (p.y.abs() - 0.03).abs() < 5e-4), "{held:?}");
    assert!(held.iter().any(|p| p.x < -0.049), "{held:?}");
}

#[test]
fn free_fingertips_keep_their_grasp() {
    let mut log = exact("rectangle:0.10x0.06", 4);
    let at = |x: f64| LoggedFree { point: Point::new(x, 0.1, 0.0), ..Default::default() };
    log.grasps[1].free = vec![at(0.2), at(f64::NAN)];
    log.grasps[3].free = vec![at(0.3)];
    let problem = Problem::new(&log);
    let free = |problem: &Problem| -> Vec<(usize, f64)> {
        problem.free.iter().map(|f| (f.grasp, f.contact.point.x)).collect()
    };
    assert_eq!(free(&problem), [(1, 0.2), (3, 0.3)]);
    assert!(problem.free.iter().all(|f| f.contact.normal.is_none()));
    assert_eq!(free(&problem.reversed()), [(2, 0.2), (0, 0.3)]);
}

#[test]
fn what_contradicts_the_shape_is_part_of_the_cost() {
    let mut log = exact("rectangle:0.10x0.06", 10);
    let sound = from_truth(&log);
    // In the first grasp, whose pose cannot give way, a fingertip that felt nothing, amid the object.
    let inside = log.grasps[0].truth.unwrap() * nalgebra::Point3::new(0.01, 0.0, 0.0);
    log.grasps[0].free = vec![LoggedFree { point: inside.coords, ..Default::default() }];
    let (odd, problem) = (from_truth(&log), Problem::new(&log));
    let wild =
        problem.unexplained(&problem.free[0].contact) - problem.exact(&problem.free[0].contact);
    assert_eq!(odd.steps, sound.steps);
    assert!((odd.cost - sound.cost - wild).abs() < 1e-6, "{} {} {wild}", odd.cost, sound.cost);
}

#[test]
fn grasps_that_felt_nothing_are_bridged() {
    let mut log = exact("triangle:0.06", 8);
    (log.noise.translation, log.noise.rotation) = (Some(0.01), Some(0.35));
    log.grasps[3].contacts.clear();
    log.grasps[7].contacts.clear();
    let corrected = planes(&log, &[&displaced(&log, 2e-3)], PLAIN).unwrap();
    let (t, w) = errors(&log, &corrected.steps);
    assert!(t < 1e-6 && w < 1e-6, "{t} {w}");
    // Nothing else holds them than the motions.
    let doubt = |k: usize| corrected.steps[k].covariance.trace();
    assert!(doubt(3) > 3.0 * doubt(2) && doubt(7) > 3.0 * doubt(6));
    // The first too.
    log.grasps[0].contacts.clear();
    assert!(planes(&log, &[], Effort::default()).is_some());
}

#[test]
fn contacts_without_normals_lie_on_known_faces() {
    let mut log = simulate(&options("rectangle:0.10x0.06", 10)).unwrap().log;
    let whole = from_truth(&log);
    for grasp in &mut log.grasps {
        for finger in [1, 3] {
            grasp.contacts[finger].normal = None;
        }
    }
    let part = from_truth(&log);
    assert_eq!(part.faces.len(), 4);
    assert!(part.explained() > 0.9);
    let doubt = |c: &Corrected| c.given_faces.iter().map(|m| m[(5, 5)]).sum::<f64>();
    assert!(doubt(&part) > doubt(&whole));
    for contact in log.grasps.iter_mut().flat_map(|g| &mut g.contacts) {
        contact.normal = None;
    }
    assert!(planes(&log, &[&track::truth(&log).unwrap()], Effort::default()).is_none());
}

#[test]
fn what_is_open_is_taken_in_the_mean() {
    let log = simulate(&options("rectangle:0.10x0.06", 10)).unwrap().log;
    let (problem, state, labels) = at_truth(&log);
    let free = solve::<3>(&problem, state.clone(), labels.clone()).unwrap();
    let cosine = |s: &State, j: usize| s.faces[0].normal.dot(&s.faces[j].normal);
    let side = (1..4).find(|j| cosine(&free.state, *j).abs() < 0.5).unwrap();
    let square = Relation::nearest(&free.state.faces, 0, side, 0.0);
    let state = State { relations: vec![square], ..free.state.clone() };
    let mut related = solve::<3>(&problem, state, labels).unwrap();
    let alone = averaged(2, &free, &[]).unwrap();
    let same = |a: &State, b: &State| (cosine(a, side) - cosine(b, side)).abs() < 1e-12;
    assert!(same(&alone.state, &free.state));
    let angle = |s: &State| cosine(s, side).asin();
    let [open, exact] = [angle(&free.state), angle(&related.state)];
    assert!((open - exact).abs() > 1e-3);
    // Three times as plausible: a quarter of the way back.
    related.cost = free.cost - 3f64.ln();
    let mean = averaged(2, &related, std::slice::from_ref(&free)).unwrap();
    let expected = 0.75 * exact + 0.25 * open;
    assert!((angle(&mean.state) - expected).abs() < 0.02 * (open - exact).abs());
    let own = averaged(2, &related, &[]).unwrap();
    let width = |c: &super::average::Averaged<3>| c.covariance.faces[(0, 0)];
    assert!(width(&mean) > width(&own));
    // Far behind, or of other faces: no part of the mean.
    related.cost = free.cost - 20.0;
    let sure = averaged(2, &related, std::slice::from_ref(&free)).unwrap();
    assert!(same(&sure.state, &related.state));
}

#[test]
fn the_shape_is_made_of_the_graphs_faces() {
    let log = simulate(&options("rectangle:0.10x0.06", 12)).unwrap().log;
    let truth = track::truth(&log).unwrap();
    let corrected = Kind::Planes.correct(&log, &truth).unwrap();
    let faces = corrected.faces.unwrap();
    assert_eq!(faces.owners.len(), log.grasps.iter().map(|g| g.contacts.len()).sum::<usize>());
    for (i, a) in faces.faces.iter().enumerate() {
        for b in &faces.faces[..i] {
            let cosine = a.normal.dot(&b.normal);
            assert!(cosine.abs() < 0.06 || cosine < -0.998, "{cosine}");
        }
    }
    let made = |known| {
        let quiet: crate::slam::Progress<'_> = &|_, _| {};
        let steps = &corrected.relative;
        reconstruct_known(&log, steps, known, Choice::Auto, quiet).unwrap().geometry
    };
    let (Geometry::Outline(own), Geometry::Outline(other)) = (made(Some(&faces)), made(None))
    else {
        panic!()
    };
    assert!((own.area() - 0.006).abs() < 3e-4, "{}", own.area());
    let corner = |face: &crate::model::faces::Face, p: &[f64; 2]| {
        face.value(&Point::new(p[0], p[1], 0.0)).abs() < 1e-6
    };
    let on_two = |o: &crate::shape::Outline| {
        o.loops.iter().flatten().all(|p| faces.faces.iter().filter(|f| corner(f, p)).count() == 2)
    };
    assert!(on_two(&own) && !on_two(&other));
}

#[test]
fn little_or_bad_input_has_an_answer() {
    let log = simulate(&options("rectangle:0.10x0.06", 1)).unwrap().log;
    let truth = track::truth(&log).unwrap();
    if let Some(one) = planes(&log, &[&truth], Effort::default()) {
        assert_eq!(one.steps.len(), 1);
        assert_eq!(one.steps[0].pose, truth[0].pose);
        assert_eq!(one.steps[0].covariance.norm(), 0.0);
    }
    let none = GraspLog { grasps: Vec::new(), ..log.clone() };
    assert!(planes(&none, &[&[]], Effort::default()).is_none());
    let mut bare = simulate(&options("rectangle:0.10x0.06", 5)).unwrap().log;
    let mut steps = track::truth(&bare).unwrap();
    // A pose that is not a number, and contacts that are not.
    steps[2].pose = Pose::translation(f64::NAN, 0.0, 0.0);
    steps[3].covariance.fill(f64::NAN);
    bare.grasps[1].contacts[0].point.x = f64::INFINITY;
    bare.grasps[4].contacts[1].normal = Some(Point::zeros());
    let corrected = planes(&bare, &[&steps, &[]], Effort::default()).unwrap();
    assert_eq!((corrected.steps.len(), corrected.owners.len()), (5, 23));
    for step in &corrected.steps {
        let pose = step.pose.to_homogeneous();
        assert!(pose.iter().chain(step.covariance.iter()).all(|v| v.is_finite()));
    }
    for grasp in &mut bare.grasps {
        grasp.contacts.clear();
    }
    assert!(planes(&bare, &[&steps], Effort::default()).is_none());
}

#[test]
fn few_grasps_stay_where_the_tracker_saw_them() {
    // All four on the same two or three faces would be cheapest.
    let log = simulate(&Options { seed: 7, ..options("hexagon:0.05", 4) }).unwrap().log;
    let truth = track::truth(&log).unwrap();
    let collapsed = planes(&log, &[&truth], Effort::default()).unwrap();
    assert!(errors(&log, &collapsed.steps).1 > 0.8);
    assert!(Kind::Planes.correct(&log, &truth).is_none());
    let log = simulate(&options("rectangle:0.10x0.06", 12)).unwrap().log;
    let truth = track::truth(&log).unwrap();
    assert!(Kind::Planes.correct(&log, &truth).is_some());
    assert!(Kind::None.correct(&log, &truth).is_none());
}

#[test]
fn status_and_modes_are_the_trackers() {
    let log = simulate(&options("triangle:0.06", 4)).unwrap().log;
    let mut steps = track::truth(&log).unwrap();
    steps[2].status = tactile_core::track::Status::Ambiguous;
    steps[2].modes = vec![(steps[2].pose, 0.6)];
    let corrected = planes(&log, &[&steps], PLAIN).unwrap();
    assert_eq!(corrected.steps[2].status, steps[2].status);
    // Moved as the pose was.
    let [(mode, share)] = corrected.steps[2].modes[..] else { panic!("one mode") };
    let apart = local(&corrected.steps[2].pose, &mode);
    assert!(apart.norm() < 1e-12 && share == 0.6 && mode != steps[2].pose, "{apart}");
    assert_eq!(corrected.relative()[1].covariance, corrected.given_faces[1]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// The gradient of the robust cost is the slope of the robust cost.
    #[test]
    fn the_whole_has_the_gradient_it_says(seed in 0u64..1000, spatial in any::<bool>()) {
        let object = if spatial { "box:0.12x0.06x0.06" } else { "hexagon:0.045" };
        let log = simulate(&Options { seed, outliers: 0.1, ..options(object, 4) }).unwrap().log;
        let (problem, state, labels) = at_truth(&log);
        if spatial {
            slopes::<6>(&problem, &state, &labels)?;
        } else {
            slopes::<3>(&problem, &state, &labels)?;
        }
    }
}

fn slopes<const D: usize>(
    problem: &Problem,
    state: &State,
    labels: &Labels,
) -> Result<(), TestCaseError> {
    let centre = Point::new(0.01, -0.02, 0.0);
    // Off the optimum, where the gradient is zero.
    let mut state = state.clone();
    for (k, pose) in state.poses.iter_mut().enumerate() {
        let mut tangent = Tangent::zeros();
        for axis in axes::<D>() {
            tangent[axis] = if axis < 3 { 2e-3 } else { 0.03 } * ((k + axis) as f64).sin();
        }
        *pose = retract(pose, &tangent);
    }
    let cost = |state: &State| linearise::<D>(problem, state, labels, &centre).0;
    let (_, arrow) = linearise::<D>(problem, &state, labels, &centre);
    let h = 1e-6;
    for k in 1..state.poses.len() {
        let mut slope = SVector::<f64, D>::zeros();
        for (i, axis) in axes::<D>().into_iter().enumerate() {
            let at = |h: f64| {
                let mut moved = state.clone();
                moved.poses[k] = retract(&moved.poses[k], &Tangent::ith(axis, h));
                cost(&moved)
            };
            slope[i] = (at(h) - at(-h)) / (2.0 * h);
        }
        let scale = 1.0 + slope.norm();
        prop_assert!(
            (slope - arrow.chain[k - 1]).norm() < 1e-4 * scale,
            "{} {}",
            slope,
            arrow.chain[k - 1]
        );
    }
    let dimension = problem.dimension;
    for j in 0..state.faces.len() {
        for a in 0..dimension {
            let at = |h: f64| {
                let mut moved = state.clone();
                let mut change = [0.0; 3];
                change[a] = h;
                moved.faces[j] = moved.faces[j].retract(dimension, &change);
                cost(&moved)
            };
            let slope = (at(h) - at(-h)) / (2.0 * h);
            let said = arrow.rest[dimension * j + a];
            prop_assert!((slope - said).abs() < 1e-4 * (1.0 + slope.abs()), "{} {}", slope, said);
        }
    }
    Ok(())
}

#[test]
fn what_is_round_has_no_faces_and_what_is_flat_has() {
    let slipping = |object: &str| {
        let spec: crate::sim::ObjectSpec = object.parse().unwrap();
        let angle = if spec.dimension() == 2 { 0.35 } else { 0.2 };
        let motion_noise = crate::quantity::Deviation { length: 0.01, angle };
        let log = simulate(&Options { motion_noise, grasps: Some(12), ..Options::new(spec) });
        log.unwrap().log
    };
    for object in ["ellipse:0.1x0.06", "ellipsoid:0.1x0.08x0.06"] {
        let log = slipping(object);
        let truth = track::truth(&log).unwrap();
        let found = super::refine(&log, &truth).unwrap();
        assert!(found.faces.is_empty() && found.per_degree < 1.2, "{object} {}", found.per_degree);
        assert_eq!(found.steps[0].pose, truth[0].pose);
        let last = found.steps.last().unwrap();
        // Less certain than if the body were known.
        let known = found.given_faces.last().unwrap();
        assert!(known[(0, 0)] > 0.0 && last.covariance[(0, 0)] > known[(0, 0)], "{object}");
        assert!(found.shape(&log).is_none());
    }
    let log = slipping("hexagon:0.045");
    let found = super::refine(&log, &track::truth(&log).unwrap()).unwrap();
    assert_eq!(found.faces.len(), 6);
    // The criterion that decides between them says the same, and that every face has its price.
    for (object, is_flat) in [("hexagon:0.045", true), ("ellipse:0.1x0.06", false)] {
        let log = slipping(object);
        let truth = track::truth(&log).unwrap();
        let problem = Problem::new(&log);
        let flat = planes(&log, &[&truth], PLAIN).unwrap();
        let round = super::round_bodies(&problem, &[&truth], false);
        let worth = |numbers: usize| criterion(&problem, &flat, numbers);
        let [flat_cost, round_cost] = [worth(2 * flat.faces.len()), round[0].cost];
        assert_eq!(flat_cost < round_cost, is_flat, "{object} {flat_cost} {round_cost}");
        assert!(worth(2 * flat.faces.len() + 2) - flat_cost > 4.0);
    }
}

#[test]
fn on_an_edge_a_contact_is_outside_neither_face() {
    let log = exact("rectangle:0.10x0.06", 10);
    let (problem, state, labels) = at_truth(&log);
    let up = |i: usize, j: usize| state.faces[i].normal.dot(&state.faces[j].normal).abs() < 0.5;
    let other = (1..4).find(|j| up(0, *j)).unwrap();
    let [a, b] = [0, other].map(|j| state.faces[j]);
    // Where the two meet, and so far beyond both of them.
    let cost = |owner: Owner, beyond: f64| {
        let (mut problem, mut labels) = (problem.clone(), labels.clone());
        let height = |face: &super::tangent::Face| face.normal * (face.offset + beyond);
        let felt = &mut problem.felt[0];
        let normal = Some((a.normal + b.normal).normalize());
        let contact =
            crate::reference::Contact { point: height(&a) + height(&b), normal, ..felt.contact };
        felt.contact = contact.transformed(&state.poses[felt.grasp]);
        labels[0] = Some(owner);
        solve::<3>(&problem, state.clone(), labels).unwrap().cost
    };
    // Far enough that the descent does not draw it back onto the edge.
    let price = |owner: Owner| cost(owner, 8e-3) - cost(owner, -8e-3);
    assert!(price(Owner::Edge([0, other])).abs() < 0.5, "{}", price(Owner::Edge([0, other])));
    // On one face alone it is outside the other.
    assert!(price(Owner::Face(0)) > 1.5, "{}", price(Owner::Face(0)));
}
