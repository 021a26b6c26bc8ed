//! Behaviour of the whole: poses recovered, symmetries listed, freedoms named, nonsense refused.

use nalgebra::{Point3, Quaternion, UnitQuaternion};
use proptest::prelude::*;

use super::*;
use crate::shape::Geometry;
use crate::shape::mesh::tests::cuboid;
use crate::sim::random::Random;
use crate::sim::{ObjectSpec, Options, Touch, simulate};

/// Quick enough for a debug build.
const QUICK: Settings = Settings { seed: 1, rounds: 1, optima: 96 };

fn contact(point: Point, normal: Option<Point>) -> Contact {
    Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.0873 }
}

/// Contacts spread over `mesh` at `pose`, `noise` metres off.
fn touched(mesh: &Mesh, pose: &Pose, count: usize, noise: f64, normals: bool) -> Vec<Contact> {
    let [mut random] = Random::streams(7);
    let place = |(p, n): (Point, Point)| {
        let at = (pose * Point3::from(p + noise * random.normal3())).coords;
        contact(at, normals.then(|| pose.rotation * n))
    };
    mesh.samples(count).into_iter().map(place).collect()
}

fn pose(shift: [f64; 3], turn: [f64; 3]) -> Pose {
    Pose::new(Point::from(shift), Point::from(turn))
}

/// A prism over a scalene triangle: no symmetry.
fn wedge() -> Mesh {
    let corners = [[0.0, 0.0], [0.1, 0.0], [0.03, 0.06]];
    let vertices = [-0.02, 0.03].iter().flat_map(|z| corners.map(|[x, y]| Point::new(x, y, *z)));
    let sides = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]];
    let triangles = [[0, 2, 1], [3, 4, 5]].into_iter().chain(sides);
    Mesh::new(vertices.collect(), triangles.collect()).unwrap()
}

/// Upright, of `sides` faces.
fn cylinder(radius: f64, half: f64, sides: u32) -> Mesh {
    let mut vertices = vec![Point::new(0.0, 0.0, -half), Point::new(0.0, 0.0, half)];
    for k in 0..sides {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(sides)).sin_cos();
        vertices.push(Point::new(radius * cos, radius * sin, -half));
        vertices.push(Point::new(radius * cos, radius * sin, half));
    }
    let mut triangles = Vec::new();
    for k in 0..sides {
        let (a, b) = (2 + 2 * k, 2 + 2 * ((k + 1) % sides));
        triangles.extend([[0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]]);
    }
    Mesh::new(vertices, triangles).unwrap()
}

fn assert_near(found: &Pose, truth: &Pose, metres: f64, radians: f64) {
    let off = truth.inverse() * found;
    let (shift, turn) = (off.translation.vector.norm(), off.rotation.angle());
    assert!(shift < metres && turn < radians, "{shift} m, {turn} rad");
}

#[test]
fn an_object_without_symmetry_is_found_in_one_place() {
    let truth = pose([0.3, -0.2, 0.4], [1.0, -2.0, 0.5]);
    for normals in [false, true] {
        let contacts = touched(&wedge(), &truth, 24, 5e-4, normals);
        let found = localize(&wedge(), &contacts, &QUICK).unwrap();
        assert_near(&found.modes[0].pose, &truth, 2e-3, 0.03);
        assert!(found.modes[0].weight > 0.95, "{:?}", found.modes);
        assert!(found.modes[0].mean < 1e-3 && found.misfit < 1.5);
        assert!(found.freedoms.is_empty() && !found.more, "{:?}", found.freedoms);
    }
}

#[test]
fn a_cube_has_its_24_rotations() {
    let truth = pose([0.1, 0.0, -0.3], [0.3, 0.2, -0.9]);
    let mesh = cuboid([0.04; 3]);
    let found = localize(&mesh, &touched(&mesh, &truth, 30, 3e-4, false), &QUICK).unwrap();
    assert_eq!(found.modes.len(), 24);
    let total: f64 = found.modes.iter().map(|m| m.weight).sum();
    assert!((total - 1.0).abs() < 1e-9, "{total}");
    for mode in &found.modes {
        assert!((mode.weight - 1.0 / 24.0).abs() < 0.01, "{mode:?}");
        // Every one of them lays the cube where it is.
        let off = truth.inverse() * mode.pose;
        assert!(off.translation.vector.norm() < 1e-3, "{off}");
        for axis in 0..3 {
            let column = off.rotation.to_rotation_matrix().matrix().column(axis).abs();
            assert!(column.max() > 0.999, "{off}");
        }
    }
    for (k, a) in found.modes.iter().enumerate() {
        let turn = |b: &Mode| a.pose.rotation.angle_to(&b.pose.rotation);
        assert!(found.modes[..k].iter().all(|b| turn(b) > 1.0));
    }
}

/// A simulated object and what was felt of it, with errors.
fn simulated(object: &str, contacts: usize, seed: u64) -> (Mesh, Vec<Contact>) {
    let object: ObjectSpec = object.parse().unwrap();
    let (grasps, touch) = (Some(1), Touch::Uniform);
    let options = Options { grasps, contacts, touch, seed, ..Options::new(object) };
    let simulated = simulate(&options).unwrap();
    let Geometry::Mesh(mesh) = simulated.geometry else { panic!("expected a mesh") };
    (mesh, contacts::from_log(&simulated.log, contacts::Fixed::No).unwrap())
}

/// However surely contacts tell one side from the next: the sides are the mesh's.
#[test]
fn a_mesh_of_many_sides_stands_for_something_round() {
    for (sides, count, seed) in [(32, 12, 1), (32, 60, 9), (20, 60, 2), (100, 24, 0)] {
        let (mesh, contacts) = simulated(&format!("prism:0.1,ngon:{sides},0.03"), count, seed);
        let found = localize(&mesh, &contacts, &QUICK).unwrap();
        let [Freedom::Turn { about, .. }] = found.freedoms[..] else {
            panic!("{sides} sides, {count} contacts: {:?}", found.freedoms)
        };
        assert!(about.z.abs() > 0.99, "{about}");
        // Upside down or not.
        assert_eq!(found.modes.len(), 2, "{:?}", found.modes);
        assert!(found.modes.iter().all(|mode| mode.deviation > 0.05), "{:?}", found.modes);
    }
}

/// Errors put several optima beside one another, of which each image used to be left with another.
#[test]
fn images_of_a_symmetric_object_weigh_the_same_and_none_is_missing() {
    for (object, count, seed, images) in [
        ("box:0.12x0.06x0.04", 40, 3, 4),
        ("box:0.12x0.06x0.04", 40, 6, 4),
        ("box:0.12x0.06x0.04", 14, 5, 4),
        ("cylinder:0.06x0.1", 10, 6, 2),
    ] {
        let (mesh, contacts) = simulated(object, count, seed);
        for seed in [0, 1] {
            let found = localize(&mesh, &contacts, &Settings { seed, ..QUICK }).unwrap();
            let weights: Vec<f64> = found.modes.iter().map(|m| m.weight).collect();
            assert_eq!(weights.len() % images, 0, "{object} {weights:?}");
            for same in weights.chunks(images) {
                let unequal = same.iter().any(|w| (w - same[0]).abs() > 1e-3 * same[0]);
                assert!(!unequal, "{object} {weights:?}");
            }
            let first = &found.modes[..images];
            for (k, a) in first.iter().enumerate() {
                let turn = |b: &Mode| a.pose.rotation.angle_to(&b.pose.rotation);
                assert!(first[..k].iter().all(|b| turn(b) > 3.0), "{object} {first:?}");
            }
        }
    }
}

#[test]
fn what_is_only_nearly_symmetric_is_weighed_by_its_likelihood() {
    let cube = cuboid([0.06, 0.04, 0.02]);
    let wider = |v: &Point| Point::new(v.x, v.y * (1.0 + 0.6 * v.x), v.z);
    let vertices = cube.vertices().iter().map(wider).collect();
    let mesh = Mesh::new(vertices, cube.triangles().to_vec()).unwrap();
    let truth = pose([0.1, 0.2, 0.3], [-1.0, 0.4, 2.0]);
    let contacts = touched(&mesh, &truth, 30, 3e-4, false);
    let modes = localize(&mesh, &contacts, &QUICK).unwrap().modes;
    // Turned about its length, it is the same.
    let along = modes[0].pose.rotation.inverse() * truth.rotation * Point::x();
    assert!(modes.len() >= 2 && along.x > 0.99, "{modes:?}");
    assert!((modes[0].weight - modes[1].weight).abs() < 1e-3, "{modes:?}");
    assert!(modes.iter().skip(2).all(|m| m.weight < 0.8 * modes[0].weight), "{modes:?}");
}

#[test]
fn a_sheet_felt_from_one_side_lies_on_one_side() {
    let corners = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.06], [0.0, 0.06]];
    let vertices = corners.map(|[x, y]| Point::new(x, y, 0.0)).to_vec();
    let sheet = Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let felt = touched(&sheet, &Pose::identity(), 30, 1e-4, true);
    let found = localize(&sheet, &felt, &QUICK).unwrap();
    for mode in &found.modes {
        assert!((mode.pose.rotation * Point::z()).z > 0.9, "{:?}", found.modes);
    }
}

#[test]
fn a_cylinder_has_two_modes_and_a_free_turn() {
    let truth = pose([0.2, 0.1, 0.0], [0.7, -0.3, 0.2]);
    let mesh = cylinder(0.03, 0.06, 40);
    let found = localize(&mesh, &touched(&mesh, &truth, 40, 3e-4, false), &QUICK).unwrap();
    assert_eq!(found.modes.len(), 2, "{:?}", found.modes);
    let [Freedom::Turn { about, through, pitch }] = found.freedoms[..] else {
        panic!("{:?}", found.freedoms)
    };
    assert!(about.z.abs() > 0.999 && pitch.abs() < 1e-3, "{about} {pitch}");
    assert!(through.xy().norm() < 2e-3, "{through}");
    // Along the axis and across it everything is known.
    for mode in &found.modes {
        let off = truth.inverse() * mode.pose;
        assert!(
            (off.translation.vector.norm() < 2e-3) && (off.rotation * Point::z()).z.abs() > 0.999
        );
    }
}

#[test]
fn normals_turn_with_a_cylinder_and_say_nothing_of_its_turn() {
    let truth = pose([0.2, 0.1, 0.0], [0.7, -0.3, 0.2]);
    let mesh = cylinder(0.03, 0.06, 180);
    let found = localize(&mesh, &touched(&mesh, &truth, 40, 3e-4, true), &QUICK).unwrap();
    let [Freedom::Turn { about, .. }] = found.freedoms[..] else { panic!("{:?}", found.freedoms) };
    assert!(about.z.abs() > 0.999, "{about}");
    // It is as unknown as it can be: by a radian at the rim.
    assert!(found.modes.iter().all(|mode| mode.deviation > 0.06), "{:?}", found.modes);
    // A cube's normals do.
    let cube = cuboid([0.04; 3]);
    let found = localize(&cube, &touched(&cube, &truth, 40, 3e-4, true), &QUICK).unwrap();
    assert!(found.freedoms.is_empty() && found.modes.iter().all(|mode| mode.deviation < 1e-3));
}

#[test]
fn a_model_inside_out_is_refused_where_normals_were_felt() {
    let cube = cuboid([0.04; 3]);
    let turned = cube.triangles().iter().map(|[a, b, c]| [*b, *a, *c]).collect();
    let inside_out = Mesh::new(cube.vertices().to_vec(), turned).unwrap();
    let felt = touched(&cube, &Pose::identity(), 12, 1e-4, true);
    let error = localize(&inside_out, &felt, &QUICK).unwrap_err();
    assert!(matches!(error, LocalizeError::InsideOut(litres) if litres < 0.0), "{error}");
    let bare = touched(&cube, &Pose::identity(), 12, 1e-4, false);
    assert!(localize(&inside_out, &bare, &QUICK).is_ok());
}

#[test]
fn contacts_on_one_face_leave_it_free_to_slide() {
    let mesh = cuboid([0.06; 3]);
    let grid = (0..9).map(|k| [f64::from(k % 3) - 1.0, f64::from(k / 3) - 1.0]);
    let contacts: Vec<Contact> =
        grid.map(|[x, y]| contact(Point::new(0.01 * x, 0.01 * y, 0.0), None)).collect();
    let found = localize(&mesh, &contacts, &QUICK).unwrap();
    assert!(found.modes[0].mean < 1e-5);
    let turns = found.freedoms.iter().filter(|f| matches!(f, Freedom::Turn { .. })).count();
    assert_eq!((found.freedoms.len(), turns > 0), (3, true), "{:?}", found.freedoms);
}

#[test]
fn wild_contacts_do_not_move_it() {
    let truth = pose([0.0, 0.2, 0.1], [0.1, 2.0, 0.3]);
    let mut contacts = touched(&wedge(), &truth, 30, 3e-4, false);
    for k in [3, 14, 25] {
        contacts[k].point += Point::new(0.03, -0.02, 0.01);
    }
    let found = localize(&wedge(), &contacts, &QUICK).unwrap();
    assert_near(&found.modes[0].pose, &truth, 2e-3, 0.03);
}

#[test]
fn the_same_seed_gives_the_same_answer() {
    let contacts = touched(&wedge(), &Pose::identity(), 12, 1e-3, false);
    let answer = || localize(&wedge(), &contacts, &QUICK).unwrap();
    assert_eq!(answer(), answer());
}

#[test]
fn what_cannot_be_used_is_refused() {
    let mesh = cuboid([0.05; 3]);
    let few = touched(&mesh, &Pose::identity(), 2, 0.0, false);
    assert_eq!(localize(&mesh, &few, &QUICK), Err(LocalizeError::FewContacts(2)));
    assert_eq!(localize(&mesh, &[], &QUICK), Err(LocalizeError::FewContacts(0)));
    let good = touched(&mesh, &Pose::identity(), 8, 0.0, true);
    for spoil in [
        |c: &mut Contact| c.point.x = f64::NAN,
        |c: &mut Contact| c.point.z = f64::INFINITY,
        |c: &mut Contact| c.normal = Some(Point::zeros()),
        |c: &mut Contact| c.normal = Some(1.1 * Point::x()),
        |c: &mut Contact| c.point_deviation = 0.0,
        |c: &mut Contact| c.normal_deviation = f64::NAN,
    ] {
        let mut bad = good.clone();
        spoil(&mut bad[5]);
        assert_eq!(localize(&mesh, &bad, &QUICK), Err(LocalizeError::Contact(5)));
    }
    for (none, what) in
        [(Settings { rounds: 0, ..QUICK }, "round"), (Settings { optima: 0, ..QUICK }, "optimum")]
    {
        assert_eq!(localize(&mesh, &good, &none), Err(LocalizeError::Effort(what)));
    }
    assert_eq!(exhaustive(&mesh, &good, 0), Err(LocalizeError::Effort("start")));
    let line = vec![Point::zeros(), Point::x(), 2.0 * Point::x()];
    for nothing in [Mesh::default(), Mesh::new(line, vec![[0, 1, 2]]).unwrap()] {
        assert_eq!(localize(&nothing, &good, &QUICK), Err(LocalizeError::NoArea));
        assert_eq!(nats(&nothing, &good, &Pose::identity()), Err(LocalizeError::NoArea));
    }
}

#[test]
fn contacts_in_one_place_or_on_a_line_have_an_answer() {
    let mesh = cuboid([0.05, 0.04, 0.03]);
    let same = vec![contact(Point::new(1.0, 2.0, 3.0), None); 5];
    let line: Vec<Contact> =
        (0..5).map(|k| contact(Point::new(0.01 * f64::from(k), 0.0, 0.0), None)).collect();
    for contacts in [same, line] {
        let found = localize(&mesh, &contacts, &QUICK).unwrap();
        assert!(found.modes[0].mean < 1e-5 && !found.freedoms.is_empty(), "{found:?}");
    }
}

#[test]
fn the_search_reaches_what_plain_descent_from_everywhere_reaches() {
    let truth = pose([0.1, 0.2, 0.3], [-1.0, 0.4, 2.0]);
    // Few and noisy: many local optima.
    let contacts = touched(&wedge(), &truth, 9, 2e-3, false);
    let slow = exhaustive(&wedge(), &contacts, 1500).unwrap();
    let found = localize(&wedge(), &contacts, &QUICK).unwrap();
    let best = found.modes.iter().map(|m| m.nats).fold(f64::INFINITY, f64::min);
    assert!(best < slow.nats + 0.1, "{best} {}", slow.nats);
    // And the truth is no likelier than the answer.
    assert!(best < nats(&wedge(), &contacts, &truth).unwrap() + 0.1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]

    #[test]
    fn moving_the_contacts_moves_the_answer(
        shift in prop::array::uniform3(-0.5..0.5), turn in prop::array::uniform4(-1.0..1.0f64),
    ) {
        let q = Quaternion::from(turn);
        prop_assume!(q.norm() > 0.1);
        let motion = Pose::from_parts(Point::from(shift).into(), UnitQuaternion::new_normalize(q));
        let contacts = touched(&wedge(), &Pose::identity(), 24, 1e-3, true);
        let moved: Vec<Contact> = contacts.iter().map(|c| c.transformed(&motion)).collect();
        let at = |contacts: &[Contact]| localize(&wedge(), contacts, &QUICK).unwrap().modes[0].pose;
        let off = (motion * at(&contacts)).inverse() * at(&moved);
        // With normals a descent may stop short where the nearest face changes, at an edge.
        prop_assert!(off.translation.vector.norm() < 1e-3, "{}", off);
        prop_assert!(off.rotation.angle() < 0.035, "{}", off);
    }

    #[test]
    fn steps_follow_the_derivatives(
        shift in prop::array::uniform3(-0.01..0.01), turn in prop::array::uniform3(-0.1..0.1),
    ) {
        // Far from edges the distance is smooth: halving a small step halves what it gains.
        let mesh = cuboid([0.05; 3]);
        let pose = pose(shift, turn);
        let contacts = touched(&mesh, &pose, 30, 0.0, false);
        let evidence = evidence(&mesh, &contacts).unwrap();
        let exact = Exact::new(faces(&mesh)).unwrap();
        let here = evidence.about(&exact, &Pose::identity(), 1.0);
        prop_assert!((here.nats - evidence.nats(&exact, &Pose::identity(), 1.0)).abs() < 1e-9);
        if let Some(step) = here.step(1.0) {
            let there = evidence.moved(&Pose::identity(), &(step * 1e-3));
            prop_assert!(evidence.nats(&exact, &there, 1.0) < here.nats);
        }
    }
}
