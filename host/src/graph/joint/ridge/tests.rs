use proptest::prelude::*;

use super::super::explain::{best, renamed, supported};
use super::super::planes::{Corrected, Effort, planes};
use super::super::problem::{Labels, State};
use super::super::tangent::{Tangent, retract};
use super::*;
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::random::Random;
use crate::sim::{Options, simulate};
use crate::slam::track;

const NONE: Deviation = Deviation { length: 0.0, angle: 0.0 };

/// The sides of the box between these corners; in the plane without top and bottom.
fn sides(dimension: usize, half: [f64; 3]) -> Vec<Face> {
    let axes = (0..dimension).flat_map(|i| [Point::ith(i, 1.0), Point::ith(i, -1.0)]);
    axes.map(|normal| Face { normal, offset: normal.abs().dot(&Point::from(half)) }).collect()
}

fn at(point: Point, normal: Point) -> Contact {
    Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.1 }
}

#[test]
fn on_a_ridge_the_normal_lies_between_the_faces() {
    let faces = sides(3, [0.05, 0.03, 0.02]);
    let edge = Ridge::new(&[faces[0], faces[2]]).unwrap();
    let corner = Ridge::new(&[faces[0], faces[2], faces[4]]).unwrap();
    let off = |ridge: &Ridge, contact: &Contact| {
        let residual = ridge.touch(&Pose::identity(), 3, contact).residual;
        [residual.fixed_rows::<3>(0).norm(), residual.fixed_rows::<3>(3).norm()]
    };
    let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-9;
    let middle = Point::new(0.6, 0.8, 0.0);
    assert!(near(off(&edge, &at(Point::new(0.05, 0.03, 0.01), middle)), [0.0, 0.0]));
    // Along the edge there is no place, across it two distances make one.
    assert!(near(off(&edge, &at(Point::new(0.053, 0.026, -0.4), middle)), [5.0, 0.0]));
    // Off the arc by 3 : 4, and beyond its end.
    let tilted = Point::new(0.64, 0.48, 0.6);
    assert!(near(off(&edge, &at(Point::new(0.05, 0.03, 0.01), tilted)), [0.0, 6.0]));
    let beyond = Point::new(-0.6, 0.8, 0.0);
    let chord = (beyond - Point::y()).norm() * 10.0;
    assert!(near(off(&edge, &at(Point::new(0.05, 0.03, 0.01), beyond)), [0.0, chord]));
    // In the corner that normal is as good as any; a little below, it is off the side's arc.
    assert!(near(off(&corner, &at(Point::new(0.05, 0.03, 0.02), tilted)), [0.0, 0.0]));
    let below = Point::new(0.64, 0.48, -0.6);
    assert!(near(off(&corner, &at(Point::new(0.05, 0.03, 0.025), below)), [5.0, 6.0]));
    // Faces that are nearly parallel do not meet, nor do opposite ones.
    let bent = Face { normal: Point::new(0.99, 0.02f64.sqrt(), 0.0).normalize(), offset: 0.05 };
    assert!(Ridge::new(&[faces[0], bent]).is_none());
    assert!(Ridge::new(&[faces[0], faces[1]]).is_none() && Ridge::new(&faces[..1]).is_none());
}

/// A contact of a finger of radius r whose centre is anywhere about a rectangle, and on how many sides it
/// is.
fn felt(random: &mut Random, half: [f64; 2]) -> (Contact, usize) {
    let straight = 4.0 * (half[0] + half[1]);
    let round = std::f64::consts::TAU * FINGERTIP;
    let along = random.unit() * (straight + round);
    let angle = random.unit() * std::f64::consts::FRAC_PI_2;
    let (place, normal, count) = if along > straight {
        (Point::new(half[0], half[1], 0.0), Point::new(angle.cos(), angle.sin(), 0.0), 2)
    } else if along < 4.0 * half[1] {
        (Point::new(half[0], (along / (4.0 * half[1])) * half[1], 0.0), Point::x(), 1)
    } else {
        (Point::new(random.unit() * half[0], half[1], 0.0), Point::y(), 1)
    };
    let [x, y] = random.normal_pair();
    let noise = Point::new(x, y, 0.0) * 1e-3;
    let turn = Pose::rotation(Point::z() * (0.0873 * random.normal_pair()[0]));
    let contact = Contact { normal_deviation: 0.0873, ..at(place + noise, turn * normal) };
    (contact, count)
}

#[test]
fn as_many_contacts_are_found_on_edges_as_round_fingers_have_there() {
    let log = simulate(&Options { ..Options::new("rectangle:0.06x0.04".parse().unwrap()) });
    let problem = Problem { edges: true, ..Problem::new(&log.unwrap().log) };
    let faces = sides(2, [0.03, 0.02, 0.0]);
    let mut random = Random::streams::<1>(5)[0].clone();
    let (mut truly, mut found, mut wrong) = (0, 0, 0);
    for _ in 0..4000 {
        let (contact, count) = felt(&mut random, [0.03, 0.02]);
        let Some(owner) = best(&problem, &faces, &contact, None) else { continue };
        truly += usize::from(count == 2);
        found += usize::from(owner.faces().len() == 2);
        wrong += usize::from(owner.faces().len() != count);
    }
    assert!(truly > 700 && truly < 900, "{truly}");
    let share = f64::from(found as u32) / f64::from(truly as u32);
    assert!((share - 1.0).abs() < 0.15 && wrong < 300, "{share} {wrong}");
}

/// The log with some contacts moved to where the object's faces meet, `which` says where.
fn moved(log: &GraspLog, which: impl Fn(usize) -> Option<(Point, Point)>) -> GraspLog {
    let mut log = log.clone();
    for (number, grasp) in log.grasps.iter_mut().enumerate() {
        let pose = grasp.truth.unwrap();
        if let Some((point, normal)) = which(number) {
            grasp.contacts[1].point = (pose * nalgebra::Point3::from(point)).coords;
            grasp.contacts[1].normal = Some(pose * normal);
        }
    }
    log
}

fn from_displaced(log: &GraspLog) -> Corrected {
    let mut steps = track::truth(log).unwrap();
    for (k, step) in steps.iter_mut().enumerate().skip(1) {
        let mut tangent = Tangent::zeros();
        for axis in if log.dimension == 2 { vec![0, 1, 5] } else { (0..6).collect() } {
            tangent[axis] = if axis < 3 { 1e-3 } else { 0.01 } * ((3 * k + axis) as f64).sin();
        }
        step.pose = retract(&step.pose, &tangent);
    }
    planes(log, &[&steps], Effort { rounds: 3, restarts: false, retrack: false }).unwrap()
}

#[test]
fn the_graph_is_exact_with_contacts_on_edges_and_corners() {
    let exact = |object: &str| {
        let options = Options {
            grasps: Some(12),
            contact_noise: NONE,
            motion_noise: NONE,
            ..Options::new(object.parse().unwrap())
        };
        simulate(&options).unwrap().log
    };
    let slanted = |k: usize| Pose::rotation(Point::z() * (0.35 + 0.08 * k as f64)) * Point::x();
    let flat = moved(&exact("rectangle:0.10x0.06"), |k| {
        (k % 2 == 1).then(|| (Point::new(0.05, 0.03, 0.0), slanted(k)))
    });
    let solid = moved(&exact("box:0.12x0.06x0.06"), |k| match k % 4 {
        1 => Some((Point::new(0.06, 0.03, 5e-3 * k as f64 - 0.03), slanted(k))),
        3 => Some((Point::new(0.06, 0.03, 0.03), (slanted(k) + Point::z()).normalize())),
        _ => None,
    });
    for (log, faces, corners) in [(flat, 4, 0), (solid, 6, 3)] {
        let corrected = from_displaced(&log);
        assert_eq!((corrected.faces.len(), corrected.explained()), (faces, 1.0));
        let on = |count: usize| {
            corrected.owners.iter().flatten().filter(|o| o.faces().len() == count).count()
        };
        assert_eq!((on(2), on(3)), (6 - corners, corners));
        let own: usize = corrected.faces.iter().map(|f| f.contacts).sum();
        assert_eq!(own, on(1));
        for (grasp, step) in log.grasps.iter().zip(&corrected.steps) {
            let off = super::super::tangent::local(&grasp.truth.unwrap(), &step.pose);
            assert!(off.norm() < 1e-6, "{off}");
        }
        assert!(corrected.per_degree < 1e-6);
        let shape = corrected.shape(&log).unwrap();
        assert_eq!(shape.owners, corrected.owners);
    }
}

fn direction() -> impl Strategy<Value = Point> {
    proptest::array::uniform3(-1.0f64..1.0)
        .prop_filter_map("too short", |v| Point::from(v).try_normalize(0.1))
}

proptest! {
    /// The gradient of half the squared residual is its slope, wherever the normal points.
    #[test]
    fn a_contact_on_a_ridge_has_the_derivatives_it_says(
        normals in proptest::array::uniform3(direction()),
        m in direction(),
        p in proptest::array::uniform3(-0.1f64..0.1),
        tangent in proptest::array::uniform6(-0.7f64..0.7),
        count in 2usize..4,
    ) {
        const H: f64 = 1e-6;
        let faces: Vec<Face> = normals.iter().take(count).map(|n| Face { normal: *n, offset: 0.02 }).collect();
        let pose = retract(&Pose::identity(), &Tangent::from(tangent));
        let contact = Contact { point_deviation: 0.5, normal_deviation: 0.3, ..at(Point::from(p), m) };
        let half = |faces: &[Face], pose: &Pose| {
            Some(0.5 * Ridge::new(faces)?.touch(pose, 3, &contact).residual.norm_squared())
        };
        prop_assume!(Ridge::new(&faces).is_some());
        let touch = Ridge::new(&faces).unwrap().touch(&pose, 3, &contact);
        let close = |slope: Option<f64>, said: f64| {
            slope.is_none_or(|s| (s - said).abs() < 1e-4 * (1.0 + said.abs()))
        };
        for k in 0..6 {
            let by = |h: f64| half(&faces, &retract(&pose, &Tangent::ith(k, h)));
            let slope = by(H).zip(by(-H)).map(|(a, b)| (a - b) / (2.0 * H));
            let said = touch.by_pose.column(k).dot(&touch.residual);
            prop_assert!(close(slope, said), "pose {k}: {slope:?} {said}");
        }
        for j in 0..count {
            for k in 0..3 {
                let by = |h: f64| {
                    let mut change = [0.0; 3];
                    change[k] = h;
                    let mut faces = faces.clone();
                    faces[j] = faces[j].retract(3, &change);
                    half(&faces, &pose)
                };
                let slope = by(H).zip(by(-H)).map(|(a, b)| (a - b) / (2.0 * H));
                let said = touch.by_face[j].column(k).dot(&touch.residual);
                prop_assert!(close(slope, said), "face {j} {k}: {slope:?} {said}");
            }
        }
    }
}

#[test]
fn faces_that_become_one_take_their_edges_along() {
    let number = |face: usize| [Some(0), Some(0), Some(1), None].get(face).copied().flatten();
    let renamed = |owner| renamed(owner, number);
    assert_eq!(renamed(Owner::Edge([0, 1])), Some(Owner::Face(0)));
    assert_eq!(renamed(Owner::Edge([1, 2])), Some(Owner::Edge([0, 1])));
    assert_eq!(renamed(Owner::Corner([0, 1, 2])), Some(Owner::Edge([0, 1])));
    assert_eq!(renamed(Owner::Edge([2, 3])), None);
}

#[test]
fn contacts_on_edges_support_a_face_that_was_felt() {
    let options = Options { grasps: Some(3), ..Options::new("box:0.1x0.07x0.05".parse().unwrap()) };
    let problem = Problem::new(&simulate(&options).unwrap().log);
    let state = State {
        poses: problem.poses(&[]),
        faces: sides(3, [0.05, 0.035, 0.025])[..3].to_vec(),
        relations: Vec::new(),
    };
    // The first was felt once and at two edges, the second twice, the third at edges alone.
    let owners = [
        Owner::Face(0),
        Owner::Edge([0, 1]),
        Owner::Face(1),
        Owner::Face(1),
        Owner::Edge([1, 2]),
        Owner::Edge([0, 2]),
    ];
    let mut labels: Labels = owners.into_iter().map(Some).collect();
    labels.resize(problem.felt.len(), None);
    let (state, kept) = supported(&problem, state, labels.clone());
    assert_eq!(state.faces.len(), 2);
    assert_eq!(kept[..4], labels[..4]);
    assert!(kept[4..].iter().all(Option::is_none));
}
