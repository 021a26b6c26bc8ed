use super::*;
use crate::matrix::Vector;
use crate::random::Random;
use crate::space::{Planar, PlanarPose, Pose, Spatial, SpatialPose};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::vec::Vec;

const POINT: f32 = 1e-3;
const NORMAL: f32 = 0.0873;

/// A face of the truth: centre, outward normal, and half its extents along tangents.
struct Side<S: Space> {
    centre: S::Vector,
    normal: S::Vector,
    tangents: Vec<S::Vector>,
}

/// `each` noisy contacts on every side, side by side or one side after the other.
fn touch<S: Space>(sides: &[Side<S>], each: usize, random: &mut Random) -> Vec<Contact<S>> {
    let mut contacts = Vec::new();
    for _ in 0..each {
        for side in sides {
            let mut point = side.centre + side.normal * (POINT * random.normal_pair().0);
            let mut normal = side.normal;
            for t in &side.tangents {
                point += *t * (2.0 * random.uniform() - 1.0);
                normal += *t * (NORMAL * random.normal_pair().0 / t.norm());
            }
            contacts.push(Contact {
                point,
                normal: normal.normalized(),
                point_deviation: POINT,
                normal_deviation: NORMAL,
                finger: 0,
            });
        }
    }
    contacts
}

fn polygon(corners: &[[f32; 2]]) -> Vec<Side<Planar>> {
    (0..corners.len())
        .map(|i| {
            let (a, b) = (Vector(corners[i]), Vector(corners[(i + 1) % corners.len()]));
            let along = (b - a) * 0.5;
            let normal = Vector([along[1], -along[0]]).normalized().unwrap();
            Side { centre: (a + b) * 0.5, normal, tangents: std::vec![along] }
        })
        .collect()
}

fn rectangle() -> Vec<Side<Planar>> {
    polygon(&[[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]])
}

fn cuboid(half: [f32; 3]) -> Vec<Side<Spatial>> {
    (0..6)
        .map(|i| {
            let (axis, sign) = (i / 2, if i % 2 == 0 { 1.0 } else { -1.0 });
            let unit = |a: usize| Vector::<3>::from_fn(|k| if k == a { 1.0 } else { 0.0 });
            let others = (0..3).filter(|a| *a != axis);
            Side {
                centre: unit(axis) * (sign * half[axis]),
                normal: unit(axis) * sign,
                tangents: others.map(|a| unit(a) * half[a]).collect(),
            }
        })
        .collect()
}

fn learnt<S: Space, const FACES: usize>(contacts: &[Contact<S>]) -> Faces<S, FACES> {
    let mut faces = Faces::new();
    for contact in contacts {
        assert_ne!(faces.insert(contact), Insertion::Dropped);
    }
    faces
}

/// Every true side has one face, whose error at the side's centre and over its half extents is
/// within `sigmas` of what it says of itself; no other faces.
fn explains<S: Space, const N: usize>(faces: &Faces<S, N>, sides: &[Side<S>], sigmas: f32) {
    assert_eq!(faces.faces().len(), sides.len());
    for side in sides {
        let face = faces
            .faces()
            .iter()
            .max_by(|a, b| a.normal.dot(side.normal).total_cmp(&b.normal.dot(side.normal)));
        let face = face.unwrap();
        for t in core::iter::once(S::Vector::ZERO).chain(side.tangents.iter().copied()) {
            let at = side.centre + t;
            let deviation = math::sqrt(face.variance(at));
            assert!(deviation < 4e-3 && face.value(at).abs() < sigmas * deviation, "{face:?}");
        }
    }
}

proptest! {
    // The gate lets noise make two faces of one once in some thousand sets: the cases are fixed.
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: RngSeed::Fixed(1), ..Default::default() })]

    #[test]
    fn polytopes_are_found_in_any_order_and_frame(
        seed in 0u64..10_000,
        angle in -3.0f32..3.0,
        shift in prop::array::uniform2(-0.3f32..0.3),
    ) {
        let mut random = Random::new(seed);
        let triangle = polygon(&[[0.0, 0.06], [-0.052, -0.03], [0.052, -0.03]]);
        for sides in [rectangle(), triangle] {
            let contacts = touch(&sides, 8, &mut random);
            let forward = learnt::<Planar, 16>(&contacts);
            explains(&forward, &sides, 5.0);
            prop_assert!(forward.is_convex());
            let per_degree = forward.chi_squared() / forward.degrees() as f32;
            prop_assert!((0.2..2.2).contains(&per_degree), "{}", per_degree);

            // The last contact first; and everything somewhere else.
            let backward: Vec<_> = contacts.iter().rev().copied().collect();
            explains(&learnt::<Planar, 16>(&backward), &sides, 5.0);
            let pose = PlanarPose::new(Vector(shift), angle);
            let moved: Vec<_> = contacts
                .iter()
                .map(|c| Contact {
                    point: pose.transform(c.point),
                    normal: c.normal.map(|n| pose.rotate(n)),
                    ..*c
                })
                .collect();
            let moved = learnt::<Planar, 16>(&moved);
            for k in 0..12 {
                let p = Vector([0.08 * (k as f32).cos(), 0.08 * (k as f32).sin()]);
                let (here, there) = (forward.probe(p), moved.probe(pose.transform(p)));
                prop_assert!((here.value - there.value).abs() < 2e-5);
                prop_assert!((pose.rotate(here.gradient) - there.gradient).norm() < 2e-4);
                prop_assert!((here.variance / there.variance - 1.0).abs() < 2e-2);
            }
        }
    }

    #[test]
    fn boxes_are_found_in_any_frame(seed in 0u64..10_000, turn in prop::array::uniform4(-1.0f32..1.0)) {
        let mut random = Random::new(seed);
        let sides = cuboid([0.06, 0.03, 0.03]);
        let contacts = touch(&sides, 10, &mut random);
        let faces = learnt::<Spatial, 16>(&contacts);
        explains(&faces, &sides, 5.5);
        prop_assert!(faces.is_convex());
        let pose = SpatialPose::new(Vector([0.1, -0.2, 0.05]), turn);
        let moved: Vec<_> = contacts
            .iter()
            .map(|c| Contact {
                point: pose.transform(c.point),
                normal: c.normal.map(|n| pose.rotate(n)),
                ..*c
            })
            .collect();
        let moved = learnt::<Spatial, 16>(&moved);
        for k in 0..12 {
            let (s, c) = (k as f32).sin_cos();
            let p = Vector([0.08 * c, 0.05 * s, 0.03 * c * s]);
            let (here, there) = (faces.probe(p), moved.probe(pose.transform(p)));
            prop_assert!((here.value - there.value).abs() < 2e-5);
        }
    }

    #[test]
    fn nothing_finite_or_not_breaks_it(
        numbers in prop::collection::vec(prop::num::f32::ANY, 6 * 12),
        exponent in -20i32..8,
    ) {
        let mut faces = Faces::<Spatial, 4>::new();
        for n in numbers.chunks_exact(6) {
            let normal = Vector([n[3], n[4], n[5]]).normalized();
            let point = Vector([n[0], n[1], n[2]]);
            for point in [point, Vector::from_fn(|i| (point[i] % 1.0) * 2f32.powi(exponent))] {
                let _ = faces.insert(&Contact {
                    point,
                    normal,
                    point_deviation: 1e-3,
                    normal_deviation: n[0].abs(),
                    finger: 0,
                });
            }
        }
        let _ = (faces.protrusion(), faces.chi_squared(), faces.degrees(), faces.probe(Vector::ZERO));
    }
}

#[test]
fn a_curve_does_not_fit_and_a_hollow_shows() {
    let circle: Vec<Contact<Planar>> = (0..40)
        .map(|i| {
            let (s, c) = (i as f32 * 2.4).sin_cos();
            let n = Vector([c, s]);
            Contact {
                point: n * 0.04,
                normal: Some(n),
                point_deviation: POINT,
                normal_deviation: NORMAL,
                finger: 0,
            }
        })
        .collect();
    let faces = learnt::<Planar, 32>(&circle);
    assert!(faces.is_convex());
    let per_degree = faces.chi_squared() / faces.degrees() as f32;
    assert!(per_degree > 1.4 || faces.faces().len() > 12, "{per_degree}");

    // A T: the stem's sides run through the bar, and the bar's ends lie outside them.
    let tee = polygon(&[
        [-0.01, -0.05],
        [0.01, -0.05],
        [0.01, 0.01],
        [0.05, 0.01],
        [0.05, 0.03],
        [-0.05, 0.03],
        [-0.05, 0.01],
        [-0.01, 0.01],
    ]);
    for seed in 0..20 {
        let faces = learnt::<Planar, 16>(&touch(&tee, 3, &mut Random::new(seed)));
        assert!(!faces.is_convex() && faces.protrusion() > 10.0, "seed {seed}: {faces:?}");
    }
}

#[test]
fn capacity_keeps_faces_with_support_and_says_what_it_refused() {
    let contacts = touch(&rectangle(), 5, &mut Random::new(3));
    let mut faces = learnt::<Planar, 4>(&contacts);
    let odd =
        Contact { normal: Some(Vector([0.8, 0.6])), point: Vector([0.07, 0.05]), ..contacts[0] };
    assert_eq!(faces.insert(&odd), Insertion::Dropped);
    assert_eq!((faces.refused(), faces.is_convex(), faces.contacts()), (1, false, 20));

    let mut full = Faces::<Planar, 3>::new();
    for contact in &contacts[..3] {
        assert_eq!(full.insert(contact), Insertion::Stored);
    }
    assert_eq!(full.insert(&contacts[3]), Insertion::Replaced(1));
    assert_eq!((full.faces().len(), full.contacts()), (3, 3));
    full.clear();
    assert_eq!(full.contacts(), 0);
    assert!(full.probe(Vector::ZERO).variance.is_infinite());
}

#[test]
fn points_without_normals_refine_faces_and_open_none() {
    let contacts = touch(&rectangle(), 2, &mut Random::new(5));
    let bare = |c: &Contact<Planar>| Contact { normal: None, ..*c };
    let mut faces = Faces::<Planar, 8>::new();
    assert_eq!(faces.insert(&bare(&contacts[0])), Insertion::Dropped);
    for contact in &contacts {
        faces.insert(contact);
    }
    let side = rectangle();
    let before = faces.faces().iter().map(|f| f.variance(side[0].centre)).sum::<f32>();
    for contact in touch(&rectangle(), 6, &mut Random::new(6)) {
        let _ = faces.insert(&bare(&contact));
    }
    explains(&faces, &side, 5.0);
    assert!(faces.faces().iter().map(|f| f.variance(side[0].centre)).sum::<f32>() < 0.5 * before);
}

/// How far the normal of the face with most contacts is off at the ends of a square side, in deviations of its
/// contacts, the part of the contacts which that face has, and χ² per degree of freedom.
fn side_of(size: f32, deviation: f32, seed: u64) -> [f32; 3] {
    let random = &mut Random::new(seed);
    let normal = random.normal::<Vector<3>>().normalized().unwrap();
    let [u, v] = Spatial::tangents(normal);
    let mut faces = Faces::<Spatial, 16>::new();
    for _ in 0..200 {
        let across = [u, v].map(|t| t * (size * (random.uniform() - 0.5)));
        let [turn, tilt] = [u, v].map(|t| t * (NORMAL * random.normal_pair().0));
        faces.insert(&Contact {
            point: normal * (0.5 * size + deviation * random.normal_pair().0)
                + across[0]
                + across[1],
            normal: (normal + turn + tilt).normalized(),
            point_deviation: deviation,
            normal_deviation: NORMAL,
            finger: 0,
        });
    }
    let largest = faces.faces().iter().max_by_key(|f| f.contacts).unwrap();
    let off = 0.5 * (largest.normal - normal).norm() * size / deviation;
    [off, f32::from(largest.contacts) / 200.0, faces.chi_squared() / faces.degrees() as f32]
}

#[test]
fn from_a_millimetre_to_ten_metres_planes_are_as_good_as_their_contacts() {
    for seed in 0..10 {
        for (size, deviation) in
            [(1e-3, 1e-5), (0.1, 1e-3), (0.3, 1e-4), (10.0, 1e-2), (10.0, 3.5e-3)]
        {
            let [off, share, misfit] = side_of(size, deviation, seed);
            assert!(
                off < 0.6 && share == 1.0 && (misfit - 1.0).abs() < 0.3,
                "{size}: {off} {misfit}"
            );
        }
        for (size, deviation) in [(1.0, 1e-5), (10.0, 1e-3), (10.0, 1e-4)] {
            let [off, share, misfit] = side_of(size, deviation, seed);
            assert!(
                off < 0.6 && share > 0.9 && misfit.is_finite(),
                "{size}: {off} {share} {misfit}"
            );
        }
    }
}

/// The least variances of a model of contacts whose normals say next to nothing.
fn least_variances<S: Space>(seed: u64) -> [f32; 2] {
    let mut random = Random::new(seed);
    let mut faces = Faces::<S, 7>::new();
    let mut least = [f32::INFINITY; 2];
    for _ in 0..60 {
        let Some(normal) = random.normal::<S::Vector>().normalized() else { continue };
        faces.insert(&Contact {
            point: normal * 0.04 + random.normal::<S::Vector>() * 0.01,
            normal: Some(normal),
            point_deviation: if random.uniform() < 0.5 { 1e-4 } else { 1e-3 },
            normal_deviation: if random.uniform() < 0.5 { 0.3 } else { 1.1 },
            finger: 0,
        });
        for _ in 0..6 {
            let probe = faces.probe(random.normal::<S::Vector>() * 0.1);
            least = [least[0].min(probe.variance), least[1].min(probe.slope_variance)];
        }
        assert!(!faces.protrusion().is_nan());
    }
    least
}

#[test]
fn no_variance_is_below_zero() {
    for seed in 0..40 {
        for [value, slope] in [least_variances::<Planar>(seed), least_variances::<Spatial>(seed)] {
            assert!(value > 0.0 && slope >= 0.0, "{seed}: {value} {slope}");
        }
    }
}
