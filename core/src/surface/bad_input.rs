//! Every model of a surface against what a sensor may deliver at its worst.

use std::boxed::Box;
use std::vec::Vec;

use super::cholesky::packed;
use super::*;
use crate::matrix::Coordinates;
use crate::random::Random;
use crate::space::{Planar, Spatial};

const SITES: usize = 72;
const ROWS: usize = 160;

fn unit<S: Space>(axis: usize) -> S::Vector {
    S::Vector::from_fn(|i| if i == axis { 1.0 } else { 0.0 })
}

/// Contacts on a ball of this radius, with noise of 2 % and 5°.
fn ball<S: Space>(count: usize, radius: f32, random: &mut Random) -> Vec<Contact<S>> {
    (0..count)
        .filter_map(|_| {
            let normal = random.normal::<S::Vector>().normalized()?;
            let tilted = (normal + random.normal::<S::Vector>() * 0.0873).normalized();
            Some(Contact {
                point: normal * (radius * (1.0 + 0.02 * random.normal_pair().0)),
                normal: tilted,
                point_deviation: 0.02 * radius,
                normal_deviation: 0.0873,
                finger: 0,
            })
        })
        .collect()
}

/// Named sets of contacts, for an object of about `scale` metres.
fn sets<S: Space>(scale: f32) -> Vec<(&'static str, Vec<Contact<S>>)> {
    let random = &mut Random::new(11);
    let good = ball::<S>(8, 0.5 * scale, random);
    let one = good[0];
    let with = |change: &dyn Fn(usize, &mut Contact<S>)| {
        let mut contacts = good.clone();
        contacts.iter_mut().enumerate().for_each(|(i, c)| change(i, c));
        contacts
    };
    let spread = |i: usize| scale * (i as f32 / 7.0 - 0.5);
    std::vec![
        ("none", Vec::new()),
        ("good", good.clone()),
        ("one", std::vec![one]),
        ("one without a normal", std::vec![Contact { normal: None, ..one }]),
        ("no normals", with(&|_, c| c.normal = None)),
        ("one eight times", std::vec![one; 8]),
        (
            "one eight times, all but exact",
            std::vec![Contact { point_deviation: 1e-9, normal_deviation: 1e-9, ..one }; 8]
        ),
        ("each twice", good.iter().chain(&good).copied().collect()),
        (
            "opposite normals at one point",
            with(&|i, c| {
                c.point = one.point;
                c.normal = Some(unit::<S>(0) * if i % 2 == 0 { 1.0 } else { -1.0 });
            })
        ),
        (
            "both sides of a sheet",
            with(&|i, c| {
                c.point = unit::<S>(0) * spread(i / 2);
                c.normal = Some(unit::<S>(1) * if i % 2 == 0 { 1.0 } else { -1.0 });
            })
        ),
        (
            "on a line, normals across",
            with(&|i, c| {
                c.point = unit::<S>(0) * spread(i);
                c.normal = Some(unit::<S>(1));
            })
        ),
        (
            "on a line, normals along",
            with(&|i, c| {
                c.point = unit::<S>(0) * spread(i);
                c.normal = Some(unit::<S>(0));
            })
        ),
        (
            "on a plane",
            with(&|_, c| {
                c.point[1] = 0.0;
                c.normal = Some(unit::<S>(1));
            })
        ),
        ("on a plane, normals anyhow", with(&|_, c| c.point[1] = 0.0)),
        ("inside out", with(&|_, c| c.normal = c.normal.map(|n| -n))),
        ("no noise", with(&|_, c| (c.point_deviation, c.normal_deviation) = (0.0, 0.0))),
        ("hardly any noise", with(&|_, c| (c.point_deviation, c.normal_deviation) = (1e-9, 1e-9))),
        ("noise beyond reason", with(&|_, c| (c.point_deviation, c.normal_deviation) = (1e6, 1e6))),
        (
            "noise of every size",
            with(&|i, c| {
                let size = [1e-30, 1e-20, 1e-9, 1e-3, 1e6, 1e15, 1e19, 1e38][i % 8];
                (c.point_deviation, c.normal_deviation) = (size, size);
            })
        ),
        (
            "NaN noise",
            with(&|i, c| if i == 2 {
                c.point_deviation = f32::NAN
            })
        ),
        (
            "NaN in a point",
            with(&|i, c| if i % 3 == 1 {
                c.point[0] = f32::NAN
            })
        ),
        (
            "an infinite point",
            with(&|i, c| if i == 3 {
                c.point[1] = f32::NEG_INFINITY
            })
        ),
        (
            "NaN in a normal",
            with(&|i, c| if i == 0 {
                c.normal = Some(S::Vector::from_fn(|_| f32::NAN))
            })
        ),
        (
            "a zero normal",
            with(&|i, c| if i == 5 {
                c.normal = Some(S::Vector::ZERO)
            })
        ),
        ("far from the origin", with(&|_, c| c.point += unit::<S>(0) * (20.0 * scale))),
        ("more than fit", ball::<S>(100, 0.5 * scale, random)),
    ]
}

/// What every model owes: whatever came, finite values, no negative variance, and only valid
/// contacts held.
fn survives<S: Space, M: Map<S>>(name: &str, map: &mut M) {
    for scale in [1e-3f32, 0.1, 10.0] {
        for (set, contacts) in sets::<S>(scale) {
            map.clear();
            let mut valid = 0;
            for contact in &contacts {
                let outcome = map.insert(contact);
                if contact.checked().is_ok() {
                    valid += 1;
                } else {
                    assert_eq!(outcome, Insertion::Dropped, "{name}: {set}");
                }
            }
            map.refit();
            assert!(map.contacts() <= valid, "{name}: {set}");
            let mut random = Random::new(5);
            let near = contacts.iter().map(|c| c.point).filter(|p| p.is_finite());
            let around = (0..20).map(|_| random.normal::<S::Vector>() * scale);
            for p in near.chain(around).chain([S::Vector::ZERO, unit::<S>(0) * 100.0]) {
                let probe = map.probe(p);
                let good = probe.value.is_finite()
                    && probe.gradient.is_finite()
                    && probe.variance >= 0.0
                    && probe.slope_variance >= 0.0
                    && probe.nearest >= 0.0;
                assert!(good, "{name}: {set} at {scale} m: {probe:?} at {p:?}");
            }
        }
    }
}

type Model<S, K, P> = Gpis<S, K, P, SITES, ROWS, { packed(ROWS) }>;

/// One kernel and prior with every training.
fn every_training<S: Space, K: Kernel, P: Prior<S>>(name: &str, kernel: K, prior: P) {
    let mut gpis = Box::new(Model::<S, K, P>::new());
    for training in [Training::Normals, Training::OffSurface(0.01), Training::Spheres(Spheres::FEW)]
    {
        gpis.configure(kernel, prior, training);
        survives::<S, _>(&std::format!("{name}, {training:?}"), &mut *gpis);
    }
}

fn every_model<S: Space>() {
    let rough = Matern32 { amplitude: 0.03, lengthscale: 0.1 };
    let smooth = SquaredExponential { amplitude: 0.03, lengthscale: 0.05 };
    let thin = ThinPlate { amplitude: 0.05, range: 0.7 };
    let unset = Shape::<Polytope<S, 4>>::UNSET;
    every_training::<S, _, _>("rough, ball", rough, Ball::<S>::UNSET);
    every_training::<S, _, _>("smooth, ellipsoid", smooth, Ellipsoid::<S>::UNSET);
    every_training::<S, _, _>("thin, constant", thin, Constant(0.0));
    every_training::<S, _, _>("rough, no shape", rough, unset);
    survives::<S, _>("faces", &mut Faces::<S, 8>::new());
    let mut truncated = Box::new(Truncated::<S, Matern32, SITES, ROWS, { packed(ROWS) }, 8>::new());
    truncated.configure(rough);
    survives::<S, _>("truncated", &mut *truncated);
    survives::<S, _>("local", &mut Local::<S, 24>::new());
    let mut fixed = Local::<S, 24>::new();
    fixed.configure(Some(0.02));
    survives::<S, _>("local of 20 mm", &mut fixed);
}

#[test]
fn every_model_survives_in_the_plane() {
    every_model::<Planar>();
}

#[test]
fn every_model_survives_in_space() {
    every_model::<Spatial>();
}

/// Largest error of f beside a ball of 30 contacts, in parts of its radius.
fn misses<S: Space>(map: &mut impl Map<S>, radius: f32) -> f32 {
    map.clear();
    for contact in ball::<S>(30, radius, &mut Random::new(3)) {
        assert_eq!(map.insert(&contact), Insertion::Stored);
    }
    map.refit();
    let mut random = Random::new(8);
    let mut worst: f32 = 0.0;
    for _ in 0..60 {
        let direction = random.normal::<S::Vector>().normalized().unwrap_or(unit::<S>(0));
        let distance = 0.1 * (random.uniform() - 0.5);
        let f = map.probe(direction * (radius * (1.0 + distance))).value / radius;
        worst = worst.max((f - distance).abs());
    }
    worst
}

/// Radii of half a millimetre, 50 mm and 5 m: errors below `limit` radii, and the same at each
/// within `alike`.
fn same_at_every_scale<S: Space, M: Map<S>>(
    limit: f32,
    alike: f32,
    mut make: impl FnMut(f32) -> Box<M>,
) {
    let errors = [5e-4f32, 0.05, 5.0].map(|radius| misses(&mut *make(radius), radius));
    for error in errors {
        assert!(error < limit && (error - errors[1]).abs() < alike, "{errors:?}");
    }
}

fn every_scale<S: Space>() {
    let rough = Matern32 { amplitude: 1.0, lengthscale: 2.0 };
    // The prior ball is never smaller than 5 mm, which shows at half a millimetre.
    same_at_every_scale::<S, _>(0.08, 0.03, |radius| {
        let mut gpis = Box::new(Model::<S, Matern32, Ball<S>>::new());
        gpis.configure(rough.scaled(radius), Ball::UNSET, Training::Normals);
        gpis
    });
    // Normalised: one kernel for all. f is steeper than a distance here.
    same_at_every_scale::<S, _>(0.15, 2e-3, |_| {
        let mut gpis = Box::new(Gpis::<S, ThinPlate, Constant, 128, 128, { packed(128) }>::new());
        let thin = ThinPlate { amplitude: 1.0, range: 6.5 };
        gpis.configure(thin, Constant(0.0), Training::Spheres(Spheres::FEW));
        gpis
    });
    // Thirty planes leave a ball coarse: here only the scale is asked about.
    same_at_every_scale::<S, _>(0.6, 2e-3, |_| Box::new(Local::<S, 30>::new()));
}

#[test]
fn from_a_millimetre_to_ten_metres_the_same_surface() {
    every_scale::<Planar>();
    every_scale::<Spatial>();
}

/// Asked before it was fitted to anything, and again when that was forgotten.
fn answers_unasked<S: Space, M: Map<S>>(name: &str, map: &mut M) {
    for _ in 0..2 {
        map.clear();
        for p in [S::Vector::ZERO, unit::<S>(0) * 0.03] {
            let probe = map.probe(p);
            let finite = probe.value.is_finite() && probe.gradient.is_finite();
            assert!(finite && probe.variance >= 0.0, "{name}: {probe:?}");
        }
        ball::<S>(8, 0.03, &mut Random::new(2)).iter().for_each(|contact| {
            map.insert(contact);
        });
        map.refit();
    }
}

fn every_unfitted<S: Space>() {
    let rough = Matern32 { amplitude: 0.03, lengthscale: 0.1 };
    let mut gpis = Box::new(Model::<S, _, Ball<S>>::new());
    gpis.configure(rough, Ball::UNSET, Training::Normals);
    answers_unasked::<S, _>("ball", &mut *gpis);
    let mut gpis = Box::new(Model::<S, _, Ellipsoid<S>>::new());
    gpis.configure(rough, Ellipsoid::UNSET, Training::Normals);
    answers_unasked::<S, _>("ellipsoid", &mut *gpis);
    let mut truncated = Box::new(Truncated::<S, Matern32, SITES, ROWS, { packed(ROWS) }, 8>::new());
    truncated.configure(rough);
    answers_unasked::<S, _>("truncated", &mut *truncated);
}

#[test]
fn before_anything_is_fitted_nothing_is_said() {
    every_unfitted::<Planar>();
    every_unfitted::<Spatial>();
}
