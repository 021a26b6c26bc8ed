//! The core in single precision, incremental and bounded, against the dense double-precision
//! reference that was written apart from it: the same contacts must give the same surface.

#[path = "core_against_reference/models.rs"]
mod models;

use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use tactile_core::contact::{Contact, GraspView};
use tactile_core::matrix::Square;
use tactile_core::space::{Planar, Spatial};
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{
    self, Ball, Map, Matern32, Prior, SquaredExponential, Surface, ThinPlate,
};
use tactile_core::track::likelihood::log_likelihood;
use tactile_core::track::{MotionNoise, Tracker, bootstrap};
use tactile_host::reference::gpis::Evaluation;
use tactile_host::reference::{self, Kernel, Training, filter};
use tactile_host::space::{Bridge, Point, Pose};

/// Room for forty contacts in either training and dimension.
const SITES: usize = 120;
const ROWS: usize = 160;

type Core<S, K> = surface::Gpis<S, K, Ball<S>, SITES, ROWS, { packed(ROWS) }>;

const SMOOTH: SquaredExponential = SquaredExponential { amplitude: 0.03, lengthscale: 0.05 };
const ROUGH: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

const POINT_DEVIATION: f32 = 1e-3;
const NORMAL_DEVIATION: f32 = 0.0873;

/// The largest errors of the core on one case.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    /// Of the mean, metres.
    mean: f64,
    /// Of its gradient.
    gradient: f64,
    /// Of the variance, in parts of what is allowed.
    variance: f64,
    /// Of the log marginal likelihood, nats.
    likelihood: f64,
}

/// Everything about one random test: contacts and where to ask.
#[derive(Clone, Debug)]
struct Case {
    contacts: Vec<reference::Contact>,
    queries: Vec<Point>,
}

/// Two standard normal numbers from two uniform ones.
fn normal(u: f64, v: f64) -> [f64; 2] {
    let (radius, turn) = ((-2.0 * (1.0 - u).ln()).sqrt(), std::f64::consts::TAU * v);
    [radius * turn.cos(), radius * turn.sin()]
}

/// A point on the surface of an ellipsoid (ellipse) or box (rectangle) with these half axes, and
/// its normal there.
fn place(dimension: usize, round: bool, half: &Point, u: [f64; 3]) -> (Point, Point) {
    let height = if dimension == 3 { 2.0 * u[1] - 1.0 } else { 0.0 };
    if round {
        let (sin, cos) = (std::f64::consts::TAU * u[0]).sin_cos();
        let ring = (1.0 - height * height).sqrt();
        let unit = Point::new(ring * cos, ring * sin, height);
        (unit.component_mul(half), unit.component_div(half).normalize())
    } else {
        let face = (u[2] * 2.0 * dimension as f64) as usize;
        let (axis, side) = (face / 2, if face.is_multiple_of(2) { 1.0 } else { -1.0 });
        let mut unit = Point::new(2.0 * u[0] - 1.0, height, 0.0);
        let mut normal = Point::zeros();
        // The face's own axis is fixed; the others take the two coordinates.
        let free = unit;
        for (i, k) in (0..dimension).filter(|k| *k != axis).enumerate() {
            unit[k] = free[i];
        }
        unit[axis] = side;
        normal[axis] = side;
        (unit.component_mul(half), normal)
    }
}

/// 5 to 40 contacts, 1 mm and 5° off, on a shape of 40 to 160 mm, in the frame of their centroid as
/// the tracker places it; questions within 30 mm of them.
fn case(dimension: usize) -> impl Strategy<Value = Case> {
    case_with_noise(dimension, POINT_DEVIATION, NORMAL_DEVIATION)
}

/// The same with these standard deviations, metres and radians.
fn case_with_noise(
    dimension: usize,
    point_deviation: f32,
    normal_deviation: f32,
) -> impl Strategy<Value = Case> {
    let contact = proptest::array::uniform10(0.0f64..1.0);
    let half = proptest::array::uniform3(0.02f64..0.08).prop_map(Point::from);
    let turn = proptest::array::uniform3(-3.0f64..3.0).prop_map(Vector3::from);
    (any::<bool>(), half, turn, proptest::collection::vec(contact, 5..=40)).prop_map(
        move |(round, half, turn, draws)| {
            let spatial = dimension == 3;
            let flat = |p: Point| if spatial { p } else { Point::new(p.x, p.y, 0.0) };
            let turn = if spatial { turn } else { Vector3::new(0.0, 0.0, turn.z) };
            let turn = UnitQuaternion::from_scaled_axis(turn);
            let (mut contacts, mut queries) = (Vec::new(), Vec::new());
            for u in &draws {
                let (point, n) = place(dimension, round, &half, [u[0], u[1], u[2]]);
                let [a, b] = normal(u[3], u[4]);
                let [c, d] = normal(u[5], u[6]);
                let point = point + flat(Point::new(a, b, c)) * f64::from(point_deviation);
                let off = flat(Point::new(d, a, b)) * f64::from(normal_deviation);
                let n = (n + off - n * n.dot(&off)).normalize();
                contacts.push((turn * point, turn * n));
                let offset = Point::new(u[7], u[8], u[9]) * 2.0 - Point::repeat(1.0);
                queries.push(turn * (point + flat(offset) * 0.017));
            }
            let centroid = contacts.iter().map(|(p, _)| p).sum::<Point>() / contacts.len() as f64;
            // Both sides get the numbers as single precision holds them.
            let single = |p: Point| flat(p.map(|x| f64::from(x as f32)));
            Case {
                contacts: contacts
                    .into_iter()
                    .map(|(p, n)| reference::Contact {
                        point: single(p - centroid),
                        normal: Some(single(n)),
                        point_deviation: f64::from(point_deviation),
                        normal_deviation: f64::from(normal_deviation),
                    })
                    .collect(),
                queries: queries.into_iter().map(|q| single(q - centroid)).collect(),
            }
        },
    )
}

fn to_core<S: Bridge>(contact: &reference::Contact) -> Contact<S> {
    Contact {
        point: S::vector(&contact.point),
        normal: contact.normal.map(|n| S::vector(&n)),
        point_deviation: contact.point_deviation as f32,
        normal_deviation: contact.normal_deviation as f32,
        finger: 0,
    }
}

fn core_surface<S: Bridge, K: surface::Kernel>(
    kernel: K,
    training: surface::Training,
    contacts: &[reference::Contact],
) -> Box<Core<S, K>> {
    let mut gpis = Box::new(Core::<S, K>::new());
    gpis.configure(kernel, Ball::UNSET, training);
    for contact in contacts {
        gpis.insert(&to_core(contact).checked().unwrap());
    }
    gpis.refit();
    assert_eq!(gpis.contacts(), contacts.len(), "the core refused a contact");
    gpis
}

/// What the variance may be off, square metres: 1 %, and (0.05 mm)² for single precision itself,
/// which subtracts two numbers near k(0) = (30 to 50 mm)² to find a variance below (1 mm)². A
/// doubt of 1 mm moves by a micrometre.
fn allowed(variance: f64) -> f64 {
    0.01 * variance + 2.5e-9
}

/// The largest errors over both trainings of one kernel.
fn compare<S: Bridge, K: surface::Kernel>(case: &Case, core: K, kernel: Kernel) -> Errors {
    let mut worst = Errors::default();
    let distance = 0.01f32;
    for (core_training, training) in [
        (surface::Training::Normals, Training::Derivative),
        (
            surface::Training::OffSurface(distance),
            Training::OffSurface { distance: distance.into() },
        ),
    ] {
        let ours = core_surface::<S, K>(core, core_training, &case.contacts);
        let prior = reference::Prior::fitted(&case.contacts).unwrap();
        let truth =
            reference::Gpis::fit(S::DIMENSION, kernel, prior, training, &case.contacts).unwrap();
        let nats = f64::from(ours.log_likelihood()) - truth.log_marginal_likelihood();
        worst.likelihood = worst.likelihood.max(nats.abs());
        for (query, truth) in case.queries.iter().zip(truth.evaluate(&case.queries)) {
            let point = S::vector(query);
            let probe = ours.probe(point);
            assert_eq!(probe.value, ours.values(&[point])[0]);
            let gradient = (S::point(&probe.gradient) - truth.gradient).norm();
            let variance = (f64::from(ours.variance(point)) - truth.variance).abs();
            worst.mean = worst.mean.max((f64::from(probe.value) - truth.value).abs());
            worst.gradient = worst.gradient.max(gradient);
            worst.variance = worst.variance.max(variance / allowed(truth.variance));
            // The quick variances of a probe are upper bounds.
            assert!(f64::from(probe.variance) > truth.variance - allowed(truth.variance));
            assert!(f64::from(probe.slope_variance) > 0.99 * truth.gradient_variance);
        }
    }
    worst
}

/// Every kernel, with lengths that suit objects of a hand's size.
fn check<S: Bridge>(case: &Case) -> Result<(), TestCaseError> {
    let f = |x: f32| f64::from(x);
    let points = || case.contacts.iter().map(|c| c.point);
    let diameter = points().flat_map(|a| points().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let SquaredExponential { amplitude: s, lengthscale: l } = SMOOTH;
    let smooth = Kernel::SquaredExponential { amplitude: f(s), lengthscale: f(l) };
    let Matern32 { amplitude: s, lengthscale: l } = ROUGH;
    let rough = Kernel::Matern32 { amplitude: f(s), lengthscale: f(l) };
    // The range that data and queries within 30 mm of it need.
    let plate = ThinPlate { amplitude: 0.05, range: (1.5 * (diameter + 0.06)) as f32 };
    let thin = Kernel::ThinPlate { amplitude: f(plate.amplitude), range: f(plate.range) };
    for errors in [
        compare::<S, _>(case, SMOOTH, smooth),
        compare::<S, _>(case, ROUGH, rough),
        compare::<S, _>(case, plate, thin),
    ] {
        prop_assert!(errors.mean < 5e-5, "{errors:?}");
        prop_assert!(errors.gradient < 5e-3, "{errors:?}");
        prop_assert!(errors.variance < 1.0, "{errors:?}");
        prop_assert!(errors.likelihood < 0.5, "{errors:?}");
    }
    Ok(())
}

/// Log likelihoods of a contact by the core and by the reference when a probe says the same, each
/// relative to a perfect fit on a perfectly known surface: the core leaves constants out.
fn likelihoods<S: Bridge>(
    value: f32,
    gradient: &Point,
    (variance, slope_variance): (f32, f32),
    normal: Option<Point>,
) -> (f64, f64) {
    let flat = |p: &Point| S::point(&S::vector(p));
    let touch = reference::Contact {
        point: Point::zeros(),
        normal: normal.map(|n| flat(&n).try_normalize(1e-3).unwrap_or(Point::x())),
        point_deviation: POINT_DEVIATION.into(),
        normal_deviation: NORMAL_DEVIATION.into(),
    };
    let contact = to_core::<S>(&touch);
    let both = |value: f32, gradient: Point, variance: f32, slope_variance: f32| {
        let probe = surface::Probe::<S> {
            value,
            gradient: S::vector(&gradient),
            variance,
            slope_variance,
            nearest: 0.0,
        };
        let evaluation = Evaluation {
            value: value.into(),
            gradient: flat(&gradient),
            variance: variance.into(),
            gradient_variance: slope_variance.into(),
        };
        let core = f64::from(log_likelihood(&probe, contact.normal, &contact));
        (core, filter::log_likelihood(S::DIMENSION, &touch, &evaluation))
    };
    let perfect = both(0.0, touch.normal.unwrap_or(Point::x()), 0.0, 0.0);
    let given = both(value, *gradient, variance, slope_variance);
    (given.0 - perfect.0, given.1 - perfect.1)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn same_likelihood_of_a_contact(
        value in -0.03f32..0.03,
        slopes in proptest::array::uniform3(-1.5f32..1.5),
        variances in (0.0f32..1e-4, 0.0f32..0.5),
        normal in (-3.0f64..3.0, 0.0f64..3.0),
    ) {
        let turn = UnitQuaternion::from_euler_angles(normal.1, 0.0, normal.0);
        for normal in [None, Some(turn * Point::x())] {
            let gradient = Point::from(slopes.map(f64::from));
            let (planar, spatial) = (
                likelihoods::<Planar>(value, &gradient, variances, normal),
                likelihoods::<Spatial>(value, &gradient, variances, normal),
            );
            for (core, reference) in [planar, spatial] {
                prop_assert!((core - reference).abs() < 1e-3, "{core} {reference}");
            }
        }
    }

    #[test]
    fn same_surface_in_the_plane(case in case(2)) {
        check::<Planar>(&case)?;
    }

    #[test]
    fn same_surface_in_space(case in case(3)) {
        check::<Spatial>(&case)?;
    }
}

/// Contacts on an ellipse of 120 × 60 mm or an ellipsoid 80 mm high, spread evenly: the `k`-th of
/// `count` at a golden-angle spiral, so that different counts touch different places.
fn touches(dimension: usize, count: usize) -> Vec<reference::Contact> {
    let half = Point::new(0.06, 0.03, 0.04);
    (0..count)
        .map(|k| {
            let part = (k as f64 + 0.5) / count as f64;
            let around = if dimension == 3 { 0.618_034 * k as f64 % 1.0 } else { part };
            let (point, normal) = place(dimension, true, &half, [around, part, 0.0]);
            reference::Contact {
                point,
                normal: Some(normal),
                point_deviation: 4e-3,
                normal_deviation: 0.3,
            }
        })
        .collect()
}

/// One grasp fixes the object, a second one finds how it moved: core and reference, with random
/// numbers of their own, must believe the same.
fn same_belief<S: Bridge>(gated: bool) {
    const PARTICLES: usize = 4000;
    let first = touches(S::DIMENSION, 24);
    // Near known contacts the core's quick variances are close to the exact ones.
    let second: Vec<_> = first.iter().copied().skip(1).step_by(4).collect();
    let centroid = first.iter().map(|c| c.point).sum::<Point>() / first.len() as f64;
    let start = Pose::translation(centroid.x, centroid.y, centroid.z);
    let motion = tactile_host::space::planar(0.03, -0.02, 0.5);
    // The hand meant `motion`; the object moved a little more.
    let extra: Vec<f64> =
        (0..S::FREEDOM).map(|k| if k < S::DIMENSION { 0.003 } else { -0.04 }).collect();
    let moved = filter::retract(S::DIMENSION, &(motion * start), &extra.into());
    let second: Vec<_> =
        second.iter().map(|c| c.transformed(&start.inverse()).transformed(&moved)).collect();
    let noise = MotionNoise { translation: 0.004, rotation: 0.06 };

    let mut core =
        Box::new(bootstrap::Bootstrap::<S, Core<S, Matern32>, PARTICLES>::new(Core::new()));
    core.map_mut().configure(ROUGH, Ball::UNSET, surface::Training::Normals);
    core.configure(bootstrap::Settings {
        motion: noise,
        gate: gated.then_some(bootstrap::Gate { contacts: 4, distance: 4e-3 }),
        seed: 5,
    });
    let felt = |contacts: &[reference::Contact]| -> Vec<Contact<S>> {
        contacts.iter().map(to_core).collect()
    };
    core.update(None, GraspView { contacts: &felt(&first), free: &[] });
    let motion_core = S::pose(&motion);
    let estimate =
        core.update(Some(&motion_core), GraspView { contacts: &felt(&second), free: &[] });
    assert!(estimate.corrected);

    let inverse = start.inverse();
    let map: Vec<_> = first.iter().map(|c| c.transformed(&inverse)).collect();
    let prior = reference::Prior::fitted(&map).unwrap();
    let kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 };
    let surface =
        reference::Gpis::fit(S::DIMENSION, kernel, prior, Training::Derivative, &map).unwrap();
    let gate = gated.then_some(reference::Gate { contacts: 4, distance: 4e-3 });
    let settings = reference::Settings {
        dimension: S::DIMENSION,
        particles: PARTICLES,
        translation: noise.translation.into(),
        rotation: noise.rotation.into(),
        gate,
        seed: 6,
    };
    let mut filter = reference::Filter::new(settings, start);
    filter.predict(Some(&motion));
    assert!(filter.weigh(&surface, &second));
    let (mean, covariance) = filter.mean();

    let off = filter::local(S::DIMENSION, &mean, &S::isometry(&estimate.pose));
    // What two sets of weighted samples of the same density may differ by, in its deviations.
    let chance = 1.0 / filter.effective() + 1.0 / f64::from(estimate.effective_particles);
    let chance = 4.0 * chance.sqrt() + 0.1;
    assert!(chance < 1.0, "too few samples to tell");
    for k in 0..S::FREEDOM {
        let deviation = covariance[(k, k)].sqrt();
        let ratio = f64::from(estimate.covariance.at(k, k)).sqrt() / deviation;
        assert!(off[k].abs() < chance * deviation, "{k}: {} against {deviation}", off[k]);
        assert!((ratio - 1.0).abs() < chance, "{k}: {ratio}");
    }
}

#[test]
fn same_belief_over_the_pose() {
    for gated in [false, true] {
        same_belief::<Planar>(gated);
        same_belief::<Spatial>(gated);
    }
}
