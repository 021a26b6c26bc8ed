use super::*;
use crate::matrix::Vector;
use crate::random::Random;
use crate::space::{Planar, PlanarPose, Pose, Spatial};
use crate::surface::cholesky::packed;
use crate::surface::{Ball, Joint, Matern32, Prior};
use std::boxed::Box;
use std::vec::Vec;

const POINT: f32 = 1e-3;
const NORMAL: f32 = 0.0873;
const KERNEL: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

type Plane<const N: usize, const R: usize, const Q: usize> =
    Truncated<Planar, Matern32, N, R, Q, 10>;
type Small = Plane<20, 60, { packed(60) }>;
type Large = Plane<160, 480, { packed(480) }>;
type Solid = Truncated<Spatial, Matern32, 24, 96, { packed(96) }, 12>;

/// A touch with noise at a place with this normal.
fn touch<S: Space>(point: S::Vector, normal: S::Vector, random: &mut Random) -> Contact<S> {
    let turn: S::Vector = random.normal();
    Contact {
        point: point + random.normal::<S::Vector>() * POINT,
        normal: (normal + (turn - normal * turn.dot(normal)) * NORMAL).normalized(),
        point_deviation: POINT,
        normal_deviation: NORMAL,
        finger: 0,
    }
}

/// A place on the outline through corners (metres, counter-clockwise) and its normal.
fn on(corners: &[[f32; 2]], random: &mut Random) -> (Vector<2>, Vector<2>) {
    let side = |i: usize| (Vector(corners[i]), Vector(corners[(i + 1) % corners.len()]));
    let all: f32 = (0..corners.len()).map(|i| (side(i).1 - side(i).0).norm()).sum();
    let mut left = all * random.uniform();
    let mut number = 0;
    while number + 1 < corners.len() && left > (side(number).1 - side(number).0).norm() {
        left -= (side(number).1 - side(number).0).norm();
        number += 1;
    }
    let (a, b) = side(number);
    let along = (b - a).normalized().unwrap();
    (a + along * left, Vector([along[1], -along[0]]))
}

/// A half disc of radius 40 mm, its straight side below.
fn half_disc(random: &mut Random) -> (Vector<2>, Vector<2>) {
    let half = core::f32::consts::PI;
    if random.uniform() * (half + 2.0) < 2.0 {
        return (Vector([0.08 * random.uniform() - 0.04, 0.0]), Vector([0.0, -1.0]));
    }
    let (sin, cos) = (half * random.uniform()).sin_cos();
    (Vector([0.04 * cos, 0.04 * sin]), Vector([cos, sin]))
}

/// A cylinder of radius 30 mm and height 80 mm.
fn cylinder(random: &mut Random) -> (Vector<3>, Vector<3>) {
    let (sin, cos) = (core::f32::consts::TAU * random.uniform()).sin_cos();
    if random.uniform() * (0.08 + 0.03) < 0.08 {
        let z = 0.08 * random.uniform() - 0.04;
        return (Vector([0.03 * cos, 0.03 * sin, z]), Vector([cos, sin, 0.0]));
    }
    let radius = 0.03 * crate::math::sqrt(random.uniform());
    let up = if random.uniform() < 0.5 { 1.0 } else { -1.0 };
    (Vector([radius * cos, radius * sin, 0.04 * up]), Vector([0.0, 0.0, up]))
}

const SQUARE: [[f32; 2]; 4] = [[-0.04, -0.04], [0.04, -0.04], [0.04, 0.04], [-0.04, 0.04]];

/// A stream of so many touches, five at a time.
fn learn<S: Space, M: Map<S>>(
    map: &mut M,
    count: usize,
    seed: u64,
    place: impl Fn(&mut Random) -> (S::Vector, S::Vector),
) {
    let mut random = Random::new(seed);
    for number in 1..=count {
        let (point, normal) = place(&mut random);
        assert_ne!(map.insert(&touch(point, normal, &mut random)), Insertion::Dropped);
        if number % 5 == 0 {
            map.refit();
        }
    }
}

fn small() -> Box<Small> {
    let mut map = Box::new(Small::new());
    map.configure(KERNEL);
    map
}

/// Mean of |f| at places of the true surface, metres.
fn off<S: Space>(
    map: &impl Surface<S>,
    place: impl Fn(&mut Random) -> (S::Vector, S::Vector),
) -> f32 {
    let mut random = Random::new(77);
    (0..300).map(|_| map.probe(place(&mut random).0).value.abs()).sum::<f32>() / 300.0
}

#[test]
fn polygons_are_faces_alone_and_sharp() {
    let triangle = [[0.0, 0.06], [-0.052, -0.03], [0.052, -0.03]];
    for corners in [&SQUARE[..], &triangle] {
        let mut map = small();
        learn(&mut *map, 150, 3, |r| on(corners, r));
        assert_eq!((map.cuts().count(), map.body().contacts()), (corners.len(), 0));
        assert_eq!(map.contacts(), 150);
        assert!(off(&*map, |r| on(corners, r)) < 2.5e-4);
        for corner in corners {
            let corner = Vector(*corner);
            assert!(map.probe(corner * 0.97).value < 0.0, "{corner:?}");
            assert!(map.probe(corner * 1.03).value > 0.0, "{corner:?}");
        }
    }
}

#[test]
fn round_and_hollow_objects_are_the_body() {
    let circle = |r: &mut Random| {
        let (sin, cos) = (core::f32::consts::TAU * r.uniform()).sin_cos();
        (Vector([0.01 + 0.03 * cos, 0.03 * sin]), Vector([cos, sin]))
    };
    let mut map = small();
    learn(&mut *map, 150, 5, circle);
    let mut alone = Box::new(Gpis::<_, _, Ball<Planar>, 20, 60, { packed(60) }>::new());
    alone.configure(KERNEL, Ball::UNSET, Training::Normals);
    learn(&mut *alone, 150, 5, circle);
    assert_eq!((map.cuts().count(), map.contacts()), (0, 20));
    for k in 0..20 {
        let p = Vector([0.002 * k as f32 - 0.01, 0.03]);
        // (A face that was thought flat for a while left its rounding.)
        assert!((map.probe(p).value - alone.probe(p).value).abs() < 1e-5);
    }
    // The sides of a notch have the rest of the object outside them.
    let notched = [
        [-0.04, -0.04],
        [0.04, -0.04],
        [0.04, 0.04],
        [0.015, 0.04],
        [0.015, 0.0],
        [-0.015, 0.0],
        [-0.015, 0.04],
        [-0.04, 0.04],
    ];
    let mut map = small();
    learn(&mut *map, 400, 6, |r| on(&notched, r));
    assert_eq!(map.cuts().count(), 4);
    assert!(map.cuts().all(|face| face.value(Vector([0.0, 0.0])) < -0.035));
    assert!(map.probe(Vector([0.0, 0.02])).value > 0.004);
    assert!(off(&*map, |r| on(&notched, r)) < 8e-4);
}

#[test]
fn bounded_memory_costs_little_where_faces_meet_curves() {
    let (mut bounded, mut unlimited) = (0.0, 0.0);
    for seed in 0..3 {
        let mut map = small();
        learn(&mut *map, 160, seed, half_disc);
        let straight = |f: &&Face<Planar>| f.normal[1] < -0.999 && f.contacts > 40;
        assert_eq!(map.cuts().filter(straight).count(), 1);
        bounded += off(&*map, half_disc);
        let mut all = Box::new(Large::new());
        all.configure(KERNEL);
        learn(&mut *all, 160, seed, half_disc);
        assert!(all.body().contacts() > 80);
        unlimited += off(&*all, half_disc);
    }
    assert!(bounded < 1.2 * unlimited, "{bounded} {unlimited}");
}

#[test]
fn a_cylinder_keeps_its_edges_in_few_places() {
    let mut map = Box::new(Solid::new());
    map.configure(KERNEL);
    learn(&mut *map, 250, 2, cylinder);
    assert_eq!(map.cuts().filter(|face| face.normal[2].abs() > 0.999).count(), 2);
    let error = off(&*map, cylinder);
    // The body alone would need contacts all along the edges.
    type Alone = Gpis<Spatial, Matern32, Ball<Spatial>, 24, 96, { packed(96) }>;
    let mut alone = Box::new(Alone::new());
    alone.configure(KERNEL, Ball::UNSET, Training::Normals);
    learn(&mut *alone, 250, 2, cylinder);
    let without = off(&*alone, cylinder);
    assert!(error < 6e-4 && error < 0.6 * without, "{error} {without}");
}

#[test]
fn a_face_that_turns_out_to_be_none_gives_its_contacts_back() {
    let mut random = Random::new(4);
    let mut map = small();
    let top = |r: &mut Random| (Vector([0.06 * r.uniform() - 0.03, 0.02]), Vector([0.0, 1.0]));
    for _ in 0..30 {
        let (point, normal) = top(&mut random);
        map.insert(&touch(point, normal, &mut random));
    }
    map.refit();
    assert_eq!((map.cuts().count(), map.body().contacts()), (1, 0));
    // Something stands on it.
    map.insert(&touch(Vector([0.0, 0.05]), Vector([0.0, 1.0]), &mut random));
    map.refit();
    assert_eq!((map.cuts().count(), map.body().contacts()), (0, 3));
    for x in [-0.017, 0.017] {
        let probe = map.probe(Vector([x, 0.0205]));
        assert!((probe.value - 5e-4).abs() < 6e-4 && probe.gradient[1] > 0.6, "{probe:?}");
        assert!(probe.variance < 4e-6);
    }
    let probe = map.probe(Vector([0.0, 0.05]));
    assert!(probe.value.abs() < 3e-3, "{probe:?}");
}

#[test]
fn beyond_its_contacts_a_face_is_uncertain() {
    let mut random = Random::new(8);
    let mut map = small();
    for _ in 0..40 {
        let at = Vector([0.04 * random.uniform() - 0.02, 0.0]);
        map.insert(&touch(at, Vector([0.0, 1.0]), &mut random));
    }
    map.insert(&touch(Vector([0.08, -0.02]), Vector([1.0, 0.0]), &mut random));
    map.refit();
    let at = |x: f32| map.probe(Vector([x, 0.0]));
    // Contacts together say more than one, which a probe does not count on.
    let known = |x: f32| map.joint::<1>(&[Vector([x, 0.0])])[0][0];
    assert!(known(0.0) < 2e-7 && known(0.018) < 1e-6);
    assert!((at(0.0).variance / (POINT * POINT) - 1.0).abs() < 0.01);
    assert!((at(0.0).slope_variance / (NORMAL * NORMAL) - 1.0).abs() < 0.01);
    let mut last = (at(0.018), known(0.018));
    for x in [0.026, 0.029, 0.032] {
        let (probe, exact) = (at(x), known(x));
        assert!(
            exact > 2.0 * last.1 && probe.nearest > last.0.nearest + 2e-3,
            "{last:?} {probe:?}"
        );
        assert!(
            probe.variance > 1.9 * last.0.variance && probe.variance > exact,
            "{last:?} {probe:?}"
        );
        last = (probe, exact);
    }
    // Ten millimetres away one does not know.
    assert!(at(0.03).variance > 4e-6 && (at(0.03).nearest - 0.01).abs() < 3e-3);
    // On the other side, where nothing was touched, the object ends somewhere.
    assert!(map.probe(Vector([0.0, -0.2])).value > 0.0);
    assert!(map.probe(Vector([0.0, -0.08])).variance > 2e-4);
}

#[test]
fn an_endless_stream_keeps_faces_and_accuracy() {
    let mut map = small();
    learn(&mut *map, 200, 9, |r| on(&SQUARE, r));
    let few = off(&*map, |r| on(&SQUARE, r));
    learn(&mut *map, 40_000, 10, |r| on(&SQUARE, r));
    // One contact in ten thousand is too far off for its face, and two early faces may be one side.
    assert!((4..6).contains(&map.cuts().count()) && map.body().contacts() < 5);
    assert!(map.cuts().all(|face| face.contacts < 8192));
    assert!(map.cuts().filter(|face| face.contacts >= 4000).count() >= 4);
    let many = off(&*map, |r| on(&SQUARE, r));
    assert!(many < 0.5 * few && many < 8e-5, "{few} {many}");
    map.clear();
    assert_eq!((map.contacts(), map.cuts().count()), (0, 0));
}

#[test]
fn another_frame_has_the_same_surface() {
    let pose = PlanarPose::new(Vector([0.2, -0.1]), 2.1);
    let mut random = Random::new(12);
    let contacts: Vec<Contact<Planar>> = (0..120)
        .map(|_| {
            let (point, normal) = half_disc(&mut random);
            touch(point, normal, &mut random)
        })
        .collect();
    let (mut here, mut there) = (small(), small());
    for contact in &contacts {
        here.insert(contact);
        there.insert(&Contact {
            point: pose.transform(contact.point),
            normal: contact.normal.map(|n| pose.rotate(n)),
            ..*contact
        });
    }
    here.refit();
    there.refit();
    assert_eq!((here.cuts().count(), there.cuts().count()), (1, 1));
    for k in 0..20 {
        let (sin, cos) = (k as f32 * 0.3).sin_cos();
        let p = Vector([0.035 * cos, 0.02 + 0.03 * sin]);
        let (a, b) = (here.probe(p), there.probe(pose.transform(p)));
        assert!((a.value - b.value).abs() < 2e-4, "{a:?} {b:?}");
    }
}

#[test]
fn several_points_at_once_are_what_each_is_alone() {
    let mut map = small();
    learn(&mut *map, 150, 3, half_disc);
    assert_eq!(map.cuts().count(), 1);
    // Two on the straight side, two on the round one, one far beyond the corner of the two.
    let points =
        [[0.01, 0.0], [0.013, 0.001], [0.0, 0.041], [-0.028, 0.028], [0.05, -0.03]].map(Vector);
    let values = map.values(&points);
    let together = map.joint::<5>(&points);
    for (i, point) in points.iter().enumerate() {
        let probe = map.probe(*point);
        assert_eq!(values[i].to_bits(), probe.value.to_bits());
        let on_face = map.cuts().any(|face| face.normal == probe.gradient);
        assert_eq!(on_face, [0, 1, 4].contains(&i), "{i} {probe:?}");
        let known = together[i][i];
        assert!(known > 0.0 && known <= 1.0001 * probe.variance, "{i} {known} {probe:?}");
        for (j, covariance) in together[i].iter().enumerate() {
            assert_eq!(*covariance, together[j][i]);
            assert!(covariance * covariance <= known * together[j][j] * 1.0001, "{i} {j}");
        }
    }
    assert_eq!([together[0][2], together[3][1], together[2][4]], [0.0; 3]);
    assert!(together[2][3] != 0.0);
    // Among its contacts a face errs as a whole; beyond them each stretch for itself.
    assert!(together[0][1] > 0.8 * together[0][0], "{together:?}");
    assert!(together[4][4] > 1e-5 && together[0][4] < 1e-2 * together[4][4], "{together:?}");
    let [beyond, beside] = [[0.05, -0.03], [0.055, -0.03]].map(Vector);
    let two = map.joint::<2>(&[beyond, beside]);
    let correlation = two[0][1] / (two[0][0] * two[1][1]).sqrt();
    assert!(correlation > 0.99 && correlation < 1.0, "{two:?}");
    assert_eq!(map.joint::<3>(&points[..1])[1..], [[0.0; 3]; 2]);
}

#[test]
fn touched_points_reach_to_the_ends_of_faces() {
    let mut map = small();
    learn(&mut *map, 150, 3, |r| on(&SQUARE, r));
    assert_eq!(map.body().contacts(), 0);
    let reach = |axis: usize, sign: f32| {
        map.touched().map(|p| p[axis] * sign).fold(f32::NEG_INFINITY, f32::max)
    };
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
        assert!((reach(axis, sign) - 0.04).abs() < 4e-3);
    }
    assert_eq!(map.touched().count(), 8);
}

#[test]
fn the_ball_about_all_contacts_holds_them_and_little_more() {
    let mut map = small();
    let mut random = Random::new(5);
    let mut points = Vec::new();
    for _ in 0..60 {
        let (point, normal) = half_disc(&mut random);
        points.push(point);
        map.insert(&Contact { point, ..touch(point, normal, &mut random) });
        let holds = |p: &Vector<2>| (*p - map.centre).norm() < map.radius + 1e-6;
        assert!(points.iter().all(holds));
    }
    // The half disc's own has a radius of 40 mm.
    assert!(map.radius < 0.048, "{}", map.radius);
    map.clear();
    let far = Vector([3.0, 4.0]);
    map.insert(&Contact { point: far, ..touch(far, Vector([1.0, 0.0]), &mut random) });
    assert_eq!((map.centre, map.radius), (far, 0.0));
}

#[test]
fn a_body_that_faces_cut_ends_beyond_all_contacts() {
    let prior = Uncut::<Planar>::about(Vector([0.01, 0.0]), 0.04);
    let (inside, outside) = (Vector([0.01, 0.044]), Vector([0.01, 0.052]));
    assert!(prior.mean(inside).0 < 0.0 && prior.mean(outside).0 > 0.0);
    let curvature = prior.curvature(outside);
    for axis in 0..2 {
        let step = Vector::from_fn(|i| if i == axis { 1e-3 } else { 0.0 });
        let slope = (prior.mean(outside + step).1 - prior.mean(outside - step).1) * 500.0;
        assert!((slope - curvature[axis]).norm() < 1e-2 * (1.0 + slope.norm()), "{slope:?}");
    }
}

#[test]
fn outside_corners_the_outermost_face_answers_and_faces_do_not_know_each_other() {
    let mut map = small();
    learn(&mut *map, 150, 3, |r| on(&SQUARE, r));
    let faces: Vec<_> = map.cuts().copied().collect();
    let mut random = Random::new(9);
    for _ in 0..200 {
        let point = random.normal::<Vector<2>>() * 0.05;
        let [value] = Joint::values(&*map, &[point]);
        if let Some(owner) = map.owner(point) {
            assert_eq!(faces[owner].value(point), value);
        }
        assert_eq!(map.probe(point).value, value);
    }
    let [right, top] = [Vector([0.042, 0.0]), Vector([0.0, 0.042])];
    assert_eq!(map.joint::<2>(&[right, top])[0][1], 0.0);
}

#[test]
fn what_is_open_beyond_a_faces_contacts_is_alike_only_nearby() {
    let mut map = small();
    learn(&mut *map, 150, 3, |r| on(&SQUARE, r));
    let along = |x: f32| Vector([x, 0.041]);
    let owner = map.owner(along(0.0)).unwrap();
    let beyond = |x: f32| map.faces.beyond(owner, along(x));
    // At one end of the face, and at both.
    let face = map.faces.faces()[owner];
    for (a, b) in [(0.06, 0.061), (0.06, -0.06)] {
        let open = |x: f32| map.open(beyond(x));
        let like = (map.along(owner, along(a), along(b)) - face.joint(along(a), along(b)))
            / (open(a) * open(b)).sqrt();
        let expected = KERNEL.value((a - b) * (a - b));
        assert!((like / expected - 1.0).abs() < 0.02, "{like} {expected}");
    }
}
