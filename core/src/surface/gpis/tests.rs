use super::*;
use crate::matrix::Vector;
use crate::space::{Planar, Pose, Spatial, SpatialPose};
use crate::surface::cholesky::packed;
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
        assert_eq!(map.insert(&repeat), Insertion::Dropped);
        // A touch elsewhere does.
        let novel = Contact { point: Vector([0.09, 0.0]), ..repeat };
        assert_eq!(map.insert(&novel), Insertion::Replaced(1));
        map.refit();
        assert_eq!(map.contacts(), before);
        let probe = map.probe(novel.point);
        assert!(probe.value.abs() < 1e-3 && map.variance(novel.point) < 2e-6);
    }
}

#[test]
fn removal_leaves_what_a_fresh_surface_would_be() {
    let contacts = circle(9, 0.03);
    let mut map = learnt(MATERN, Training::Normals, &contacts);
    map.remove(4);
    map.refit();
    let rest: Vec<_> =
        contacts.iter().enumerate().filter(|(i, _)| *i != 4).map(|(_, c)| *c).collect();
    let fresh = learnt(MATERN, Training::Normals, &rest);
    let q = Vector([0.02, 0.02]);
    assert!((map.probe(q).value - fresh.probe(q).value).abs() < 1e-6);
    assert!((map.variance(q) - fresh.variance(q)).abs() < 1e-7);
    assert!((map.log_likelihood() - fresh.log_likelihood()).abs() < 1e-2);
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

proptest! {
    #[test]
    fn novelty_is_kept_up_to_date(
        places in proptest::collection::vec((-0.05f32..0.05, -0.05f32..0.05), 30),
    ) {
        // Thirty contacts through room for twelve: what is kept must be what a fresh look says.
        let mut map = Gpis::<Planar, Matern32, Ball<Planar>, 12, 36, { packed(36) }>::new();
        map.configure(MATERN, Ball::UNSET, Training::Normals);
        let template = circle(1, 0.03)[0];
        for (x, y) in places {
            let _ = map.insert(&Contact { point: Vector([x, y]), ..template });
            for leader in map.leaders() {
                let (novelty, _) = map.novelty(map.sites[leader].point, Some(leader));
                prop_assert!((map.sites[leader].novelty - novelty).abs() < 1e-9);
            }
        }
        map.refit();
        prop_assert!(map.probe(Vector([0.0, 0.0])).value.is_finite());
    }
}

#[test]
fn an_endless_stream_does_not_wear_the_factor_out() {
    let mut map = Plane::<Matern32>::new();
    map.configure(MATERN, Ball::UNSET, Training::Normals);
    let mut random = crate::random::Random::new(9);
    let mut replaced = 0;
    for _ in 0..3000 {
        let (s, c) = crate::math::sin_cos(core::f32::consts::TAU * random.uniform());
        let noise: Vector<2> = random.normal();
        let contact = Contact {
            point: Vector([0.05 * c, 0.03 * s]) + noise * 1e-3,
            normal: Vector([c / 0.05, s / 0.03]).normalized(),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
            finger: 0,
        };
        replaced += usize::from(map.insert(&contact) == Insertion::Replaced(1));
    }
    map.refit();
    assert!(replaced > 20, "{replaced}");
    let kept: Vec<Contact<Planar>> = map
        .sites()
        .iter()
        .map(|site| Contact { point: site.point, normal: Some(site.normal), ..circle(1, 0.03)[0] })
        .collect();
    let fresh = learnt(MATERN, Training::Normals, &kept);
    for i in 0..40 {
        let (s, c) = (0.157 * i as f32).sin_cos();
        let q = Vector([0.06 * c, 0.04 * s]);
        assert!((map.probe(q).value - fresh.probe(q).value).abs() < 5e-6);
        assert!((map.variance(q) - fresh.variance(q)).abs() < 1e-8 + 0.01 * fresh.variance(q));
    }
}
