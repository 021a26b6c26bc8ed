use super::*;
use crate::matrix::Vector;
use crate::random::Random;
use crate::space::{Planar, Spatial};
use crate::surface::Map;
use std::vec::Vec;

const POINT: f32 = 1e-3;
const NORMAL: f32 = 0.08;

/// Contacts with noise on a face through the origin that bends by so much a metre along both tangents:
/// along the first of the `ways` up to its length, along the second up to its.
fn face<S: Space>(
    count: usize,
    normal: S::Vector,
    ways: [S::Vector; 2],
    bend: f32,
    random: &mut Random,
) -> Vec<Contact<S>> {
    let mut contacts = Vec::new();
    for _ in 0..count {
        let [a, b] = [0, 1].map(|_| 2.0 * random.uniform() - 1.0);
        let at = ways[0] * a + ways[1] * b;
        let turn: S::Vector = random.normal();
        let felt = normal + at * bend + (turn - normal * turn.dot(normal)) * NORMAL;
        contacts.push(Contact {
            point: at - normal * (0.5 * bend * at.norm_squared())
                + normal * (random.normal::<S::Vector>()[0] * POINT),
            normal: felt.normalized(),
            point_deviation: POINT,
            normal_deviation: NORMAL,
            finger: 0,
        });
    }
    contacts
}

fn gather<S: Space>(contacts: &[Contact<S>]) -> Moments<S> {
    contacts.iter().map(Moments::of).reduce(|a, b| a.plus(&b)).unwrap()
}

/// No axis of space, and two ways along its face that are no tangents either.
fn oblique() -> (Vector<3>, [Vector<3>; 2]) {
    let normal = Vector([0.48, 0.6, 0.64]);
    let [u, v] = Spatial::tangents(normal);
    (normal, [(u * 0.8 + v * 0.6) * 0.04, (v * 0.8 - u * 0.6) * 0.015])
}

/// Mean and mean square of the turning of normals over many faces.
fn turning<S: Space>(normal: S::Vector, ways: [S::Vector; 2], bend: f32) -> (f32, f32) {
    let mut random = Random::new(6);
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..800 {
        let moments = gather(&face::<S>(30, normal, ways, bend, &mut random));
        let bending = moments.bending(moments.fit().unwrap().normal);
        (sum, squares) = (sum + bending / 800.0, squares + bending * bending / 800.0);
    }
    (sum, squares)
}

#[test]
fn normals_of_flat_faces_turn_by_standard_noise() {
    let (normal, ways) = oblique();
    let planar = (Vector([0.6, 0.8]), [Vector([-0.032, 0.024]), Vector([0.0; 2])]);
    let (mean, square) = turning::<Spatial>(normal, ways, 0.0);
    assert!(mean.abs() < 0.12 && (square - 1.0).abs() < 0.15, "{mean} {square}");
    let (mean, square) = turning::<Planar>(planar.0, planar.1, 0.0);
    assert!(mean.abs() < 0.12 && (square - 1.0).abs() < 0.15, "{mean} {square}");
    // Convex ones turn outwards, hollow ones inwards.
    for bend in [6.0, -6.0] {
        let (space, _) = turning::<Spatial>(normal, ways, bend);
        let (plane, _) = turning::<Planar>(planar.0, planar.1, bend);
        assert!(space * bend > 12.0 && plane * bend > 12.0, "{space} {plane}");
    }
}

#[test]
fn a_summary_says_what_the_contacts_did() {
    let (normal, ways) = oblique();
    let contacts = face::<Spatial>(50, normal, ways, 0.0, &mut Random::new(2));
    let mut faces = Faces::<Spatial, 3>::new();
    for contact in &contacts {
        faces.insert(contact);
    }
    assert_eq!((faces.faces().len(), faces.contacts()), (1, 50));
    let summary: Vec<_> = faces.summary(0).into_iter().flatten().collect();
    assert_eq!(summary.len(), 4);
    let (all, few) = (gather(&contacts), gather(&summary));
    let close = |a: f32, b: f32, scale: f32| assert!((a - b).abs() < 2e-3 * scale, "{a} {b}");
    close(all.weight, few.weight, all.weight);
    close(all.normal_weight, few.normal_weight, all.normal_weight);
    assert!((all.centroid - few.centroid).norm() < 1e-6);
    let tangents = Spatial::tangents(faces.faces()[0].normal);
    let [a, b] = [all, few].map(|m| m.spread(tangents));
    let scale = a.0 + a.1;
    close(a.0, b.0, scale);
    close(a.1, b.1, scale);
    close(a.2, b.2, scale);
    assert!(a.2.abs() > 0.05 * scale, "nothing skew: {a:?}");
    let (place, turn) = faces.single(0);
    assert!((place / (POINT * POINT) - 1.0).abs() < 1e-3, "{place}");
    assert!((turn / (NORMAL * NORMAL) - 1.0).abs() < 1e-3, "{turn}");
}

#[test]
fn a_face_ends_where_its_contacts_do_along_any_way() {
    let (normal, ways) = oblique();
    let moments = gather(&face::<Spatial>(400, normal, ways, 0.0, &mut Random::new(3)));
    for way in ways {
        // Three deviations' square along each of two axes: of an even spread √2 of its length.
        let end = way * core::f32::consts::SQRT_2;
        assert_eq!(moments.beyond(normal, way * 1.1), 0.0);
        for more in [1.2, 2.0] {
            let beyond = moments.beyond(normal, end * more);
            let expected = (more - 1.0) * end.norm();
            assert!((beyond - expected).abs() < 0.1 * end.norm(), "{beyond} {expected}");
        }
    }
    let planar = face::<Planar>(
        400,
        Vector([0.0, 1.0]),
        [Vector([0.03, 0.0]), Vector([0.0; 2])],
        0.0,
        &mut Random::new(3),
    );
    let planar = gather(&planar);
    assert_eq!(planar.beyond(Vector([0.0, 1.0]), Vector([0.028, 0.0])), 0.0);
    let beyond = planar.beyond(Vector([0.0, 1.0]), Vector([0.05, 0.0]));
    assert!((beyond - 0.02).abs() < 3e-3, "{beyond}");
}

#[test]
fn evidence_waits_for_contacts_and_tells_bent_from_flat() {
    let (normal, ways) = oblique();
    let evidence = |count: usize, bend: f32, seed: u64| {
        let mut faces = Faces::<Spatial, 3>::new();
        let held = gather(&face::<Spatial>(count, normal, ways, bend, &mut Random::new(seed)));
        faces.set(0, held, held.fit().unwrap());
        faces.count = 1;
        faces.evidence(0)
    };
    let of_forty = |count: usize, bend: f32, what: Evidence| {
        (0..40).filter(|seed| evidence(count, bend, *seed) == what).count()
    };
    assert_eq!(of_forty(7, 0.0, Evidence::Open), 40);
    assert_eq!(of_forty(30, 0.0, Evidence::Bent), 0);
    assert!(of_forty(30, 0.0, Evidence::Flat) > 20);
    assert_eq!([12.0, -12.0].map(|bend| of_forty(30, bend, Evidence::Bent)), [40; 2]);
    assert_eq!(Faces::<Spatial, 3>::new().evidence(0), Evidence::Open);
}

#[test]
fn room_is_made_by_single_contacts_first_and_never_by_faces_that_cut() {
    let contact = |x: f32, y: f32| Contact::<Planar> {
        point: Vector([0.03 * x, 0.03 * y]),
        normal: Some(Vector([x, y])),
        point_deviation: POINT,
        normal_deviation: NORMAL,
        finger: 0,
    };
    let mut faces = Faces::<Planar, 3>::new();
    for (x, y, times) in [(1.0, 0.0, 1), (0.0, 1.0, 2), (-1.0, 0.0, 1)] {
        for _ in 0..times {
            faces.insert(&contact(x, y));
        }
    }
    faces.set_cuts(0, true);
    faces.make_room();
    assert_eq!(faces.faces().len(), 2);
    assert!(faces.cuts(0) && faces.faces()[0].normal[0] > 0.9);
    // Not full: nothing goes.
    faces.make_room();
    assert_eq!(faces.faces().len(), 2);
    // Neither the one that cuts nor the one of two contacts, which are not known to be bent.
    faces.insert(&contact(0.0, -1.0));
    faces.insert(&contact(0.0, -1.0));
    faces.make_room();
    assert_eq!(faces.faces().len(), 3);
}
