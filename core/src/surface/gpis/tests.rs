use super::*;
use crate::matrix::Vector;
use crate::space::{Planar, Pose, Space, Spatial, SpatialPose};
use crate::surface::cholesky::packed;
use crate::surface::revisable::{Revisable, Shared};
use crate::surface::{Ball, Constant, Matern32, SquaredExponential, ThinPlate};
use proptest::prelude::*;
use std::vec::Vec;

type Plane<K> = Gpis<Planar, K, Ball<Planar>, 24, 72, { packed(72) }>;

fn circle(count: usize, radius: f32) -> Vec<Contact<Planar>> {
    (0..count)
        .map(|i| {
            let (s, c) = (core::f32::consts::TAU * (i as f32 + 0.3) / count as f32).sin_cos();
            Contact {
                point: Vector([0.01 + radius * c, -0.02 + radius * s]),
                normal: Some(Vector([c, s])),
                point_deviation: 1e-3,
                normal_deviation: 0.0873,
                finger: 0,
            }
        })
        .collect()
}

fn learnt<K: Kernel>(kernel: K, training: Training, contacts: &[Contact<Planar>]) -> Plane<K> {
    let mut map = Plane::new();
    map.configure(kernel, Ball::UNSET, training);
    for c in contacts {
        assert_eq!(map.insert(c), Insertion::Stored);
    }
    map.refit();
    map
}

const MATERN: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

fn reproduces_circle<K: Kernel>(kernel: K, training: Training) {
    let contacts = circle(8, 0.03);
    let map = learnt(kernel, training, &contacts);
    for angle in 0..20 {
        let (s, c) = (angle as f32 * 0.314).sin_cos();
        let probe = map.probe(Vector([0.01 + 0.033 * c, -0.02 + 0.033 * s]));
        // Off-surface points of a curved contour pull the field a little.
        let tolerance = if training == Training::Normals { 6e-4 } else { 1e-3 };
        assert!((probe.value - 0.003).abs() < tolerance, "{} {training:?}", probe.value);
        assert!((probe.gradient.dot(Vector([c, s])) - 1.0).abs() < 0.15);
    }
}

#[test]
fn every_kernel_and_training_reproduces_a_circle() {
    for training in [Training::Normals, Training::OffSurface(0.01)] {
        reproduces_circle(MATERN, training);
        reproduces_circle(SquaredExponential { amplitude: 0.03, lengthscale: 0.04 }, training);
        reproduces_circle(ThinPlate { amplitude: 0.05, range: 0.3 }, training);
    }
}

#[test]
fn batches_have_the_same_bits() {
    let map = learnt(MATERN, Training::Normals, &circle(11, 0.03));
    let points: [Vector<2>; 8] = core::array::from_fn(|i| Vector([0.01 * i as f32, 0.02]));
    let together = map.values(&points);
    for (p, f) in points.iter().zip(together) {
        assert_eq!(map.values(&[*p])[0].to_bits(), f.to_bits());
        assert!((map.probe(*p).value - f).abs() < 1e-6);
    }
}

proptest! {
    #[test]
    fn gradient_is_the_slope_of_the_value(x in -0.06f32..0.06, y in -0.06f32..0.06) {
        let map = learnt(MATERN, Training::Normals, &circle(9, 0.03));
        let h = 1e-3;
        let probe = map.probe(Vector([x, y]));
        let dx = (map.probe(Vector([x + h, y])).value - map.probe(Vector([x - h, y])).value) / (2.0 * h);
        let dy = (map.probe(Vector([x, y + h])).value - map.probe(Vector([x, y - h])).value) / (2.0 * h);
        prop_assert!((probe.gradient - Vector([dx, dy])).norm() < 0.02);
    }

    /// Beside contacts too, where only the bend is smoothed.
    #[test]
    fn sensing_is_probing(
        x in -0.06f32..0.06, y in -0.06f32..0.06, aside in 0.0f32..0.003, count in 1usize..12,
    ) {
        let contacts = circle(count, 0.03);
        let map = learnt(MATERN, Training::Normals, &contacts);
        for p in [Vector([x, y]), contacts[0].point + Vector([aside, -aside])] {
            let (probe, (sensed, _)) = (map.probe(p), Revisable::sense(&map, p));
            prop_assert!((probe.value - sensed.value).abs() < 1e-6, "{probe:?} {sensed:?}");
            prop_assert!((probe.gradient - sensed.gradient).norm() < 0.02, "{probe:?} {sensed:?}");
            let close = |a: f32, b: f32| (a - b).abs() < 1e-4 * a.max(b) + 1e-9;
            prop_assert!(close(probe.variance, sensed.variance), "{probe:?} {sensed:?}");
            prop_assert!((probe.slope_variance / sensed.slope_variance - 1.0).abs() < 0.2);
        }
    }

    #[test]
    fn bound_is_a_bound(x in -0.08f32..0.08, y in -0.08f32..0.08, count in 1usize..12) {
        let map = learnt(MATERN, Training::Normals, &circle(count, 0.03));
        let p = Vector([x, y]);
        prop_assert!(map.probe(p).variance >= map.variance(p) - 1e-8);
    }

    #[test]
    fn moving_the_contacts_moves_the_surface(t in proptest::array::uniform6(-0.5f32..0.5)) {
        let pose = SpatialPose::IDENTITY.retract(Vector(t));
        let learn = |pose: &SpatialPose| {
            let mut map = Gpis::<Spatial, Matern32, Constant, 6, 24, { packed(24) }>::new();
            map.configure(MATERN, Constant(0.01), Training::Normals);
            for (p, n) in [([0.03, 0.0, 0.0], [1.0, 0.0, 0.0]), ([0.0, 0.02, 0.01], [0.0, 1.0, 0.0]), ([0.0, 0.0, -0.03], [0.0, 0.0, -1.0])] {
                map.insert(&Contact {
                    point: pose.transform(Vector(p)),
                    normal: Some(pose.rotate(Vector(n))),
                    point_deviation: 1e-3,
                    normal_deviation: 0.09,
                    finger: 0,
                });
            }
            map.refit();
            map
        };
        let q = Vector([0.01, -0.02, 0.03]);
        let (here, there) = (learn(&SpatialPose::IDENTITY), learn(&pose));
        prop_assert!((here.probe(q).value - there.probe(pose.transform(q)).value).abs() < 1e-5);
        prop_assert!((here.variance(q) - there.variance(pose.transform(q))).abs() < 2e-7);
    }
}

#[test]
fn far_away_the_prior_returns() {
    let map = learnt(MATERN, Training::Normals, &circle(5, 0.03));
    let probe = map.probe(Vector([2.0, 0.0]));
    assert!((probe.value - map.prior().mean(Vector([2.0, 0.0])).0).abs() < 1e-5);
    assert!((probe.variance - MATERN.variance()).abs() < 1e-8);
    assert_eq!(Plane::<Matern32>::new().probe(Vector([1.0, 0.0])).nearest, f32::INFINITY);
}

#[test]
fn at_capacity_the_most_redundant_goes() {
    for (training, count) in [(Training::Normals, 24), (Training::OffSurface(0.01), 8)] {
        let contacts = circle(count, 0.03);
        let mut map = learnt(MATERN, training, &contacts);
        // A touch 0.1 mm from an old one tells nothing.
        let mut repeat = contacts[3];
        repeat.point += Vector([1e-4, 0.0]);
        let before = map.contacts();
        assert_eq!(map.insert(&repeat), Insertion::Merged);
        // A touch elsewhere does.
        let novel = Contact { point: Vector([0.09, 0.0]), ..repeat };
        assert_eq!(map.insert(&novel), Insertion::Replaced(1));
        map.refit();
        assert_eq!(map.contacts(), before);
        let probe = map.probe(novel.point);
        assert!(probe.value.abs() < 1e-3 && map.variance(novel.point) < 2e-6);
    }
}

/// Largest difference between what the sites say beyond the mean there and Σ·w, their share of the
/// noise: both are the same when the factor is that of K + Σ.
fn inconsistency<S: Space, const N: usize, const R: usize, const Q: usize>(
    map: &Gpis<S, Matern32, Ball<S>, N, R, Q>,
) -> (f32, f32)
where
    Ball<S>: Prior<S>,
{
    let (mut value, mut slope) = (0.0f32, 0.0f32);
    for site in map.sites() {
        let probe = map.probe(site.point);
        let share = |row: usize| -> f32 {
            (0..map.rows()).map(|j| map.noise(row, j) * map.weights[j]).sum()
        };
        let row = usize::from(site.row);
        value = value.max((site.value + site.value_offset - probe.value - share(row)).abs());
        for j in 0..site.rows() - 1 {
            let seen = site.normal[j] + site.slope_offset[j];
            let left = seen - probe.gradient[j] - share(row + 1 + j);
            slope = slope.max(left.abs());
        }
    }
    (value, slope)
}

#[test]
fn neighbours_take_over_what_a_released_contact_knew() {
    let contacts = circle(14, 0.03);
    let before = learnt(MATERN, Training::Normals, &contacts);
    let mut map = before.clone();
    map.release(4);
    map.refit();
    assert_eq!((map.contacts(), map.rows()), (13, 39));
    let (value, slope) = inconsistency(&map);
    assert!(value < 5e-6 && slope < 1e-3, "{value} {slope}");
    let rest: Vec<_> =
        contacts.iter().enumerate().filter(|(i, _)| *i != 4).map(|(_, c)| *c).collect();
    let fresh = learnt(MATERN, Training::Normals, &rest);
    // More certain beside the gap than those who never knew of it; a little more even than all
    // together, since what they interpolate there is taken for the truth.
    for neighbour in [contacts[3].point, contacts[5].point] {
        assert!(map.variance(neighbour) < 0.97 * fresh.variance(neighbour));
        assert!(map.variance(neighbour) > 0.6 * before.variance(neighbour));
        assert!((map.probe(neighbour).value - before.probe(neighbour).value).abs() < 1e-4);
    }
}

#[test]
fn contacts_without_normals_count_as_points() {
    let mut contacts = circle(10, 0.03);
    for c in &mut contacts[5..] {
        c.normal = None;
    }
    let map = learnt(MATERN, Training::Normals, &contacts);
    assert_eq!(map.rows(), 5 * 3 + 5);
    assert!(contacts.iter().all(|c| map.probe(c.point).value.abs() < 5e-4));
}

/// Noisy contacts on an ellipse of 100 × 60 mm.
fn ellipse(count: usize, seed: u64) -> impl Iterator<Item = Contact<Planar>> {
    let mut random = crate::random::Random::new(seed);
    (0..count).map(move |_| {
        let (s, c) = crate::math::sin_cos(core::f32::consts::TAU * random.uniform());
        let noise: Vector<2> = random.normal();
        let turn = 0.0873 * random.normal_pair().0;
        let normal = Vector([c / 0.05 - turn * s / 0.03, s / 0.03 + turn * c / 0.05]);
        Contact {
            point: Vector([0.05 * c, 0.03 * s]) + noise * 1e-3,
            normal: normal.normalized(),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
            finger: 0,
        }
    })
}

/// Mean of |f| around the ellipse, metres.
fn off(map: &Plane<Matern32>) -> f32 {
    let at = |i: u8| {
        let (s, c) = (0.0628 * f32::from(i)).sin_cos();
        map.probe(Vector([0.05 * c, 0.03 * s])).value.abs()
    };
    (0..100).map(at).sum::<f32>() / 100.0
}

#[test]
fn an_endless_stream_only_sharpens_the_surface() {
    let mut map = Plane::<Matern32>::new();
    map.configure(MATERN, Ball::UNSET, Training::Normals);
    let (mut merged, mut replaced, mut few) = (0, 0, f32::NAN);
    for (number, contact) in ellipse(3000, 9).enumerate() {
        match map.insert(&contact) {
            Insertion::Merged => merged += 1,
            Insertion::Replaced(1) => replaced += 1,
            other => assert!(other == Insertion::Stored && number < 24, "{other:?}"),
        }
        if number == 23 {
            map.refit();
            few = off(&map);
        }
    }
    map.refit();
    assert!(merged > 2000 && replaced > 10, "{merged} {replaced}");
    assert_eq!((map.contacts(), map.rows()), (24, 72));
    let (value, slope) = inconsistency(&map);
    assert!(value < 2e-5 && slope < 5e-3, "{value} {slope}");
    // A subset of 24 keeps the noise of 24.
    assert!(off(&map) < 0.3 * few && off(&map) < 2e-4, "{few} {}", off(&map));
    for i in 0..60 {
        let (s, c) = (0.1047 * i as f32).sin_cos();
        let q = Vector([0.055 * c, 0.033 * s]);
        assert!(map.probe(q).variance >= 0.99 * map.variance(q) - 1e-8);
    }
}

#[test]
fn every_training_takes_an_endless_stream() {
    let mut map = Plane::<Matern32>::new();
    map.configure(MATERN, Ball::UNSET, Training::OffSurface(0.01));
    for (number, mut contact) in ellipse(200, 3).enumerate() {
        if number % 5 == 0 {
            contact.normal = None;
        }
        assert_ne!(map.insert(&contact), Insertion::Dropped);
    }
    map.refit();
    let (value, _) = inconsistency(&map);
    assert!(value < 5e-5, "{value}");
    assert!(off(&map) < 3e-3, "{}", off(&map));
    // Full of points, and of one point only.
    let mut bare = Gpis::<Planar, Matern32, Ball<Planar>, 3, 9, { packed(9) }>::new();
    bare.configure(MATERN, Ball::UNSET, Training::Normals);
    let contact = ellipse(1, 1).next().unwrap();
    for _ in 0..20 {
        let _ = bare.insert(&Contact { normal: None, ..contact });
        let _ = bare.insert(&contact);
    }
    bare.refit();
    assert!(bare.probe(contact.point).value.abs() < 1e-4);
    let mut tiny = Gpis::<Planar, Matern32, Ball<Planar>, 1, 1, 1>::new();
    tiny.configure(MATERN, Ball::UNSET, Training::Normals);
    assert_eq!(tiny.insert(&contact), Insertion::Dropped);
    for contact in ellipse(9, 2) {
        assert_ne!(tiny.insert(&Contact { normal: None, ..contact }), Insertion::Dropped);
    }
    tiny.refit();
    assert!(tiny.probe(Vector::ZERO).value.is_finite());
}

/// Appends all contacts but the first with errors in common, and compares the model with what it is to be.
fn in_common<S: Space, const N: usize, const R: usize, const Q: usize>(
    mut map: Gpis<S, Matern32, Ball<S>, N, R, Q>,
    contacts: &[Contact<S>],
) where
    Ball<S>: Prior<S>,
{
    map.configure(MATERN, Ball::UNSET, Training::Normals);
    map.insert(&contacts[0]);
    let since = map.rows();
    let mut random = crate::random::Random::new(5);
    let (mut levers, mut spreads) = (Vec::new(), Vec::new());
    for (number, contact) in contacts.iter().enumerate().skip(1) {
        let contact = &Contact { normal: contact.normal.filter(|_| number % 3 > 0), ..*contact };
        let rows = if contact.normal.is_some() { 1 + S::DIMENSION } else { 1 };
        for _ in 0..rows {
            levers.push(S::Tangent::from_fn(|_| random.normal_pair().0));
        }
        let lever = &levers[levers.len() - rows..];
        spreads.extend(lever.iter().map(|lever| *lever * 1e-6));
        let offset = [5e-4, 0.01, -0.02, 0.03];
        let shared = Shared { offset, lever, spread: &spreads, since };
        let before = map.rows();
        let mut workspace = std::vec![7.0; 4 * before];
        if contact.normal.is_some() {
            let short = &mut workspace[..4 * before - 1];
            assert_eq!(
                (Revisable::append(&mut map, contact, &shared, short), map.rows()),
                (0, before)
            );
        }
        assert_eq!(Revisable::append(&mut map, contact, &shared, &mut workspace), rows);
    }
    map.refit();
    for i in since..map.rows() {
        for j in since..i {
            let expected = spreads[j - since].dot(levers[i - since]);
            assert!((map.noise(i, j) - expected).abs() < 1e-12);
        }
        assert_eq!(map.noise(i, 0), 0.0);
    }
    let (value, slope) = inconsistency(&map);
    assert!(value < 5e-6 && slope < 1e-3, "{value} {slope}");
    let (first, mut workspace) = (map.rows() - 5, [7.0; 10]);
    assert!(map.precision::<2>(first, 2, &mut workspace).is_some());
    assert!(map.precision::<2>(first, 2, &mut workspace[..9]).is_none());
}

#[test]
fn errors_in_common_are_part_of_the_model() {
    let contacts: Vec<_> = ellipse(9, 3).collect();
    in_common(Plane::new(), &contacts);
    let mut random = crate::random::Random::new(4);
    let ellipsoid = |_| {
        let n: Vector<3> = random.normal();
        let n = n.normalized().unwrap_or(Vector([1.0, 0.0, 0.0]));
        let point = Vector([0.05 * n[0], 0.04 * n[1], 0.03 * n[2]]);
        let normal = Vector([n[0] / 0.05, n[1] / 0.04, n[2] / 0.03]).normalized();
        Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.0873, finger: 0 }
    };
    let contacts: Vec<Contact<Spatial>> = (0..9).map(ellipsoid).collect();
    in_common(Gpis::<Spatial, _, _, 24, 96, { packed(96) }>::new(), &contacts);
}

#[test]
fn a_full_map_survives_places_known_far_better_than_others() {
    type Few = Gpis<Planar, Matern32, Ball<Planar>, 14, 42, { packed(42) }>;
    // A finger at rest without normals, now and then a hundred times as exact; then others.
    for seed in 0..40 {
        let mut random = crate::random::Random::new(seed);
        let mut few = Few::new();
        few.configure(MATERN, Ball::UNSET, Training::Normals);
        let mut touch = |point, normal| {
            let point_deviation = if random.uniform() < 0.5 { 1e-5 } else { 1e-3 };
            let normal_deviation = if random.uniform() < 0.5 { 0.01 } else { 0.09 };
            few.insert(&Contact { point, normal, point_deviation, normal_deviation, finger: 0 });
            few.refit();
            let probe = few.probe(Vector([0.01, 0.02]));
            assert!(probe.value.abs() < 1.0 && probe.gradient.is_finite(), "{seed}: {probe:?}");
            random.normal::<Vector<2>>()
        };
        let mut place = Vector([-0.034, -0.008]);
        for _ in 0..16 {
            touch(place, None);
        }
        for _ in 0..20 {
            let next = touch(place, None);
            place = next * 0.04;
            let Some(normal) = next.normalized() else { continue };
            touch(normal * 0.04, Some(normal));
        }
    }
}

#[test]
fn rows_made_anew_say_the_same() {
    for training in [Training::Normals, Training::OffSurface(0.01)] {
        let contacts = circle(8, 0.03);
        let mut map = learnt(MATERN, training, &contacts);
        for number in 0..5 {
            let angle = 0.7 + number as f32;
            let (s, c) = angle.sin_cos();
            let point = Vector([0.01 + 0.0303 * c, -0.02 + 0.0303 * s]);
            map.condense(&Contact { point, normal: Some(Vector([c, s])), ..contacts[0] });
        }
        map.refit();
        let at = [Vector([0.045, -0.02]), Vector([0.01, 0.0]), Vector([0.02, -0.03])];
        let before = at.map(|p| map.probe(p));
        for _ in 0..2 {
            map.renew();
            map.refit();
            assert_eq!(map.contacts(), 8);
            for (p, before) in at.iter().zip(&before) {
                let after = map.probe(*p);
                assert!(
                    (after.value - before.value).abs() < 1e-6,
                    "{training:?} {after:?} {before:?}"
                );
                let apart = after.variance / before.variance;
                assert!((apart - 1.0).abs() < 1e-2, "{training:?} {after:?} {before:?}");
            }
        }
    }
}
