use super::*;
use crate::matrix::Vector;
use crate::random::Random;
use crate::space::{Planar, PlanarPose, Pose, Spatial, SpatialPose};
use crate::surface::cholesky::packed;
use crate::surface::{Ball, Gpis, Matern32, Prior, ThinPlate, Training};
use proptest::prelude::*;
use std::vec::Vec;

fn touch<S: Space>(point: S::Vector, normal: S::Vector) -> Contact<S> {
    Contact {
        point,
        normal: Some(normal),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
        finger: 0,
    }
}

fn learnt<S: Space, const N: usize>(contacts: &[Contact<S>]) -> Local<S, N> {
    let mut local = Local::new();
    for contact in contacts {
        assert_eq!(local.insert(contact), Insertion::Stored);
    }
    local.refit();
    local
}

/// Thesis figure 2.9: a corner at the origin from three contacts, two above and one to the right.
fn corner() -> [Contact<Planar>; 3] {
    let (up, right) = (Vector([0.0, 1.0]), Vector([1.0, 0.0]));
    [
        touch(Vector([-0.04, 0.0]), up),
        touch(Vector([-0.015, 0.0]), up),
        touch(Vector([0.0, -0.015]), right),
    ]
}

/// How far along the diagonal from (−10, −10) mm to (10, 10) mm the surface is, from the corner.
fn roundness<S: Space>(surface: &impl Surface<S>, diagonal: S::Vector) -> f32 {
    let at = |s: f32| surface.probe(diagonal * s).value;
    assert!(at(-0.015) < 0.0 && at(0.015) > 0.0, "{} {}", at(-0.015), at(0.015));
    let (mut low, mut high) = (-0.015f32, 0.015f32);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if at(middle) < 0.0 { low = middle } else { high = middle }
    }
    low.abs() * diagonal.norm()
}

#[test]
fn a_corner_from_three_contacts_is_sharper_than_by_the_gp() {
    let local = learnt::<Planar, 4>(&corner());
    let sharp = roundness(&local, Vector([1.0, 1.0]));
    assert!(sharp < 1e-3, "{sharp}");
    // Ours and the thesis' own.
    let mut ours = Gpis::<Planar, Matern32, Ball<Planar>, 4, 12, { packed(12) }>::new();
    ours.configure(Matern32 { amplitude: 0.03, lengthscale: 0.1 }, Ball::UNSET, Training::Normals);
    let mut thesis = Gpis::<Planar, ThinPlate, Ball<Planar>, 12, 12, { packed(12) }>::new();
    thesis.configure(
        ThinPlate { amplitude: 0.05, range: 0.2 },
        Ball::UNSET,
        Training::OffSurface(0.01),
    );
    for contact in corner() {
        ours.insert(&contact);
        thesis.insert(&contact);
    }
    ours.refit();
    thesis.refit();
    for gp in [roundness(&ours, Vector([1.0, 1.0])), roundness(&thesis, Vector([1.0, 1.0]))] {
        assert!(gp > 2.0 * sharp, "{gp} against {sharp}");
    }
}

#[test]
fn corners_of_a_box_and_hollows_are_sharp_too() {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Vector);
    // Three faces meet in the origin; each is touched once, 15 mm from the others' edges.
    let all = Vector([1.0, 1.0, 1.0]);
    let contacts = axes.map(|n| touch((n - all) * 0.015, n));
    assert!(roundness(&learnt::<Spatial, 4>(&contacts), all) < 2e-3);
    // The same planes as a hollow corner: normals and places turned over.
    let hollow = corner().map(|c| Contact { point: -c.point, ..c });
    assert!(roundness(&learnt::<Planar, 4>(&hollow), Vector([1.0, 1.0])) < 1e-3);
}

#[test]
fn one_contact_is_its_plane() {
    let local = learnt::<Planar, 1>(&corner()[..1]);
    let probe = local.probe(Vector([-0.03, 0.007]));
    assert!((probe.value - 0.007).abs() < 1e-8);
    assert!((probe.gradient - Vector([0.0, 1.0])).norm() < 1e-5);
    let (near, far) = (local.probe(Vector([-0.04, 0.0])), local.probe(Vector([0.1, 0.0])));
    assert!((near.variance - 1e-6).abs() < 1e-9 && far.variance > 1e-4);
    assert!((near.slope_variance - 0.0873 * 0.0873).abs() < 1e-6);
    assert_eq!((near.nearest, local.contacts()), (0.0, 1));
}

#[test]
fn a_face_averages_its_noise() {
    let mut random = Random::new(4);
    let contacts: Vec<Contact<Planar>> = (0..12)
        .map(|i| {
            let tilt = 0.0873 * random.normal_pair().0;
            let (sin, cos) = crate::math::sin_cos(tilt);
            touch(Vector([0.005 * i as f32, 1e-3 * random.normal_pair().0]), Vector([sin, cos]))
        })
        .collect();
    let local = learnt::<Planar, 12>(&contacts);
    for i in 0..20 {
        let probe = local.probe(Vector([0.0025 * i as f32, 0.0]));
        assert!(probe.value.abs() < 1.2e-3, "{}", probe.value);
    }
}

#[test]
fn capacity_keeps_what_is_apart() {
    let up = Vector([0.0, 1.0]);
    let at = |x: f32| touch(Vector([x, 0.0]), up);
    let mut local = learnt::<Planar, 3>(&[at(0.0), at(0.02), at(0.021)]);
    assert_eq!(local.insert(&at(0.0005)), Insertion::Dropped);
    assert_eq!(local.insert(&at(0.05)), Insertion::Replaced(1));
    let kept: Vec<f32> = local.planes().iter().map(|p| p.point[0]).collect();
    assert_eq!(kept, [0.0, 0.021, 0.05]);
    assert_eq!(Local::<Planar, 0>::new().insert(&at(0.0)), Insertion::Dropped);
    local.clear();
    assert!(local.probe(Vector([0.0, 0.0])).variance.is_infinite());
}

/// Contacts anywhere, in units of `scale`.
fn anywhere(seed: u64, count: usize, scale: f32) -> Vec<Contact<Spatial>> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| {
            let normal = random.normal::<Vector<3>>().normalized().unwrap();
            let point = random.normal::<Vector<3>>() * scale;
            Contact { point_deviation: 0.02 * scale, ..touch(point, normal) }
        })
        .collect()
}

proptest! {
    #[test]
    fn gradient_is_the_slope_of_the_value(seed in any::<u64>(), q in proptest::array::uniform3(-1.5f32..1.5)) {
        let local = learnt::<Spatial, 6>(&anywhere(seed, 6, 0.04));
        let q = Vector(q) * 0.04;
        let probe = local.probe(q);
        for k in 0..3 {
            let slope = |step: f32| {
                let step_along = Vector::<3>::from_fn(|i| if i == k { step } else { 0.0 });
                (local.probe(q + step_along).value - probe.value) / step
            };
            let sides = [2e-4, -2e-4, 1e-4, -1e-4].map(slope);
            // Not across a kink, nor in a sliver between two.
            if sides.iter().all(|side| (side - sides[0]).abs() < 0.02) {
                let slope = 0.5 * (sides[0] + sides[1]);
                prop_assert!((slope - probe.gradient[k]).abs() < 0.02, "{slope} {probe:?}");
            }
        }
    }

    #[test]
    fn moving_the_contacts_moves_the_surface(
        seed in any::<u64>(),
        t in proptest::array::uniform6(-0.5f32..0.5),
        q in proptest::array::uniform3(-1.0f32..1.0),
    ) {
        let pose = SpatialPose::IDENTITY.retract(Vector(t));
        let contacts = anywhere(seed, 8, 0.04);
        let moved: Vec<_> = contacts
            .iter()
            .map(|c| Contact { point: pose.transform(c.point), normal: c.normal.map(|n| pose.rotate(n)), ..*c })
            .collect();
        let q = Vector(q) * 0.05;
        let here = learnt::<Spatial, 8>(&contacts).probe(q);
        let there = learnt::<Spatial, 8>(&moved).probe(pose.transform(q));
        prop_assert!((here.value - there.value).abs() < 5e-5);
        prop_assert!((here.variance / there.variance - 1.0).abs() < 1e-2);
    }

    #[test]
    fn scale_does_not_matter(seed in any::<u64>(), q in proptest::array::uniform3(-1.5f32..1.5)) {
        let q = Vector(q);
        let unit = learnt::<Spatial, 8>(&anywhere(seed, 8, 1.0)).probe(q);
        prop_assert!(unit.value.is_finite() && unit.gradient.is_finite());
        prop_assert!(unit.value.abs() < 20.0 && unit.variance > 0.0);
        for scale in [5e-4, 5.0] {
            let probe = learnt::<Spatial, 8>(&anywhere(seed, 8, scale)).probe(q * scale);
            prop_assert!((probe.value / scale - unit.value).abs() < 2e-3);
        }
    }

    #[test]
    fn untouched_places_are_not_certain(angle in -3.0f32..3.0, distance in 0.05f32..0.5) {
        // Five contacts about one corner: what lies 50 mm off may be anything.
        let pose = PlanarPose::new(Vector([0.0, 0.0]), angle);
        let local = learnt::<Planar, 4>(&corner());
        let probe = local.probe(pose.rotate(Vector([distance, 0.0])));
        prop_assert!(probe.variance > 0.003 * 0.003, "{}", probe.variance);
    }
}
