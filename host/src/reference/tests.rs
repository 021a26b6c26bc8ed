//! The dense surface against a plain one, closed forms, finite differences and symmetries.

use proptest::prelude::*;

use super::gpis::Error;
use super::*;
use crate::model::body::Body;
use crate::shape::Field;
use nalgebra::{UnitQuaternion, Vector3};

const KERNELS: [Kernel; 4] = [
    Kernel::SquaredExponential { amplitude: 0.03, lengthscale: 0.05 },
    Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.08 },
    Kernel::Matern52 { amplitude: 0.03, lengthscale: 0.08 },
    Kernel::ThinPlate { amplitude: 0.2, range: 0.8 },
];

const TRAININGS: [Training; 2] = [Training::Derivative, Training::OffSurface { distance: 0.01 }];

fn contact(point: Point, normal: Point) -> Contact {
    Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.0873 }
}

/// Contacts on an ellipse or ellipsoid, at pseudo-random places given by `seed`.
fn ellipsoid(dimension: usize, count: usize, seed: u64) -> Vec<Contact> {
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let axes = Point::new(0.06, 0.03, 0.04);
    (0..count)
        .map(|_| {
            let (turn, z) = (std::f64::consts::TAU * uniform(), 1.8 * uniform() - 0.9);
            let z = if dimension == 3 { z } else { 0.0 };
            let ring = (1.0 - z * z).sqrt();
            let unit = Point::new(ring * turn.cos(), ring * turn.sin(), z);
            contact(unit.component_mul(&axes), unit.component_div(&axes).normalize())
        })
        .collect()
}

fn fit(dimension: usize, kernel: Kernel, training: Training, contacts: &[Contact]) -> Gpis {
    let prior = Prior::about(contacts.iter().map(|c| c.point)).unwrap();
    Gpis::fit(dimension, kernel, prior, training, contacts).unwrap()
}

/// Every model on its own contacts.
fn models(seed: u64) -> impl Iterator<Item = (Gpis, Vec<Contact>)> {
    [2, 3].into_iter().flat_map(move |dimension| {
        TRAININGS.into_iter().flat_map(move |training| {
            KERNELS.into_iter().map(move |kernel| {
                let contacts = ellipsoid(dimension, 9, seed);
                (fit(dimension, kernel, training, &contacts), contacts)
            })
        })
    })
}

#[test]
fn one_contact_by_hand() {
    // One contact at the origin with normal +x: value and slopes there are uncorrelated, so the
    // slope along x alone carries the mean.
    let (s, l, point, normal) = (0.04, 0.05, 0.001, 0.1);
    let touch = Contact {
        point: Point::zeros(),
        normal: Some(Point::x()),
        point_deviation: point,
        normal_deviation: normal,
    };
    let kernel = Kernel::SquaredExponential { amplitude: s, lengthscale: l };
    let prior = Prior::Constant(0.0);
    let surface = Gpis::fit(2, kernel, prior, Training::Derivative, &[touch]).unwrap();
    let (x, y) = (0.013, -0.007);
    let k = s * s * (-(x * x + y * y) / (2.0 * l * l)).exp();
    let slope = s * s / (l * l) + normal * normal;
    let p = [Point::new(x, y, 0.0)];
    assert!((surface.values(&p)[0] - k * x / (l * l) / slope).abs() < 1e-15);
    let variance =
        s * s - k * k / (s * s + point * point) - (k / (l * l)).powi(2) * (x * x + y * y) / slope;
    assert!((surface.variances(&p)[0] - variance).abs() < 1e-15);
    let at_contact = s * s / (l * l) - (s * s / (l * l)).powi(2) / slope;
    assert!((surface.gradient_variances(&[Point::zeros()])[0] - at_contact).abs() < 1e-12);
    let expected = -0.5
        * (1.0 / slope
            + (s * s + point * point).ln()
            + 2.0 * slope.ln()
            + 3.0 * std::f64::consts::TAU.ln());
    assert!((surface.log_marginal_likelihood() - expected).abs() < 1e-12);
}

#[test]
fn off_surface_by_hand() {
    // Far apart compared with the lengthscale, the three values do not know of each other.
    let kernel = Kernel::Matern32 { amplitude: 0.02, lengthscale: 1e-4 };
    let training = Training::OffSurface { distance: 0.02 };
    let touch = contact(Point::new(0.01, 0.02, 0.03), Point::z());
    let surface = Gpis::fit(3, kernel, Prior::Constant(0.005), training, &[touch]).unwrap();
    assert_eq!(surface.rows(), 3);
    let gain = 4e-4 / (4e-4 + 1e-6);
    for (height, target) in [(0.03, 0.0), (0.05, 0.02), (0.01, -0.02)] {
        let f = surface.values(&[Point::new(0.01, 0.02, height)])[0];
        assert!((f - (0.005 + gain * (target - 0.005))).abs() < 1e-12, "{height}: {f}");
    }
}

#[test]
fn without_contacts_the_prior_speaks() {
    let ball = Prior::Ball { centre: Point::new(0.01, 0.0, 0.0), radius: 0.04 };
    let surface = Gpis::fit(3, KERNELS[1], ball, Training::Derivative, &[]).unwrap();
    let on = [Point::new(0.01, 0.04, 0.0)];
    assert!(surface.values(&on)[0].abs() < 1e-15);
    assert!((surface.gradients(&on)[0] - Point::y()).norm() < 1e-12);
    assert!((surface.variances(&on)[0] - 0.03f64.powi(2)).abs() < 1e-15);
    assert!((surface.deviations(&on)[0] - 0.03).abs() < 1e-12);
    assert_eq!(surface.log_marginal_likelihood(), 0.0);
}

#[test]
fn contacts_are_interpolated_without_noise() {
    for dimension in [2, 3] {
        let mut contacts = ellipsoid(dimension, 8, 5);
        for c in &mut contacts {
            (c.point_deviation, c.normal_deviation) = (1e-6, 1e-4);
        }
        let surface = fit(dimension, KERNELS[1], Training::Derivative, &contacts);
        for c in &contacts {
            let e = surface.evaluate(&[c.point])[0];
            assert!(e.value.abs() < 1e-6, "{e:?}");
            assert!((e.gradient - c.normal.unwrap()).norm() < 1e-3, "{e:?}");
            assert!(e.variance < 2e-12 && e.gradient_variance < 2e-8, "{e:?}");
        }
    }
}

#[test]
fn variance_returns_to_the_prior_far_away() {
    for kernel in &KERNELS[..3] {
        let surface = fit(3, *kernel, Training::Derivative, &ellipsoid(3, 9, 1));
        let near = surface.variances(&[Point::new(0.06, 0.0, 0.0)])[0];
        let far = surface.variances(&[Point::new(2.0, 0.0, 0.0)])[0];
        assert!(near < 0.5 * far && (far - 0.03f64.powi(2)).abs() < 1e-9, "{near} {far}");
    }
}

#[test]
fn both_trainings_find_a_circle() {
    let radius = 0.05;
    let contacts: Vec<Contact> = (0..40)
        .map(|i| f64::from(i) * std::f64::consts::TAU / 40.0)
        .map(|a| Point::new(a.cos(), a.sin(), 0.0))
        .map(|n| Contact {
            point_deviation: 1e-4,
            normal_deviation: 0.01,
            ..contact(n * radius, n)
        })
        .collect();
    // The wrong prior: half the size, beside the middle.
    let prior = Prior::Ball { centre: Point::new(0.005, 0.0, 0.0), radius: 0.025 };
    for kernel in KERNELS {
        let fits = TRAININGS.map(|t| Gpis::fit(2, kernel, prior, t, &contacts).unwrap());
        for i in 0..100 {
            let a = f64::from(i) * 0.0628;
            let n = Point::new(a.cos(), a.sin(), 0.0);
            for (distance, tolerance) in [(-0.005, 1.5e-3), (0.0, 5e-5), (0.005, 1.5e-3)] {
                let p = [n * (radius + distance)];
                let [one, other] = [fits[0].values(&p)[0], fits[1].values(&p)[0]];
                assert!((one - distance).abs() < tolerance, "{kernel:?} at {distance}: {one}");
                assert!((one - other).abs() < tolerance, "{kernel:?} at {distance}: {one} {other}");
            }
        }
    }
}

#[test]
fn bad_input_is_named() {
    let good = ellipsoid(2, 5, 3);
    let fit = |dimension, kernel, contacts: &[Contact]| {
        Gpis::fit(dimension, kernel, Prior::Constant(0.0), Training::Derivative, contacts)
            .unwrap_err()
    };
    let small = Kernel::ThinPlate { amplitude: 0.05, range: 0.1 };
    match fit(2, small, &good) {
        Error::Range { range, least } => assert!(range == 0.1 && least > 0.1, "{least}"),
        other => panic!("{other}"),
    }
    let zero = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.0 };
    assert_eq!(fit(2, zero, &good), Error::Parameter { name: "lengthscale", value: 0.0 });
    assert_eq!(fit(4, KERNELS[0], &good), Error::Dimension(4));
    let spoiled = |spoil: fn(&mut Contact)| {
        let mut contacts = good.clone();
        spoil(&mut contacts[3]);
        fit(2, KERNELS[0], &contacts).to_string()
    };
    assert!(spoiled(|c| c.point.x = f64::NAN).starts_with("contact 3: the point"));
    assert!(spoiled(|c| c.point.z = 0.1).contains("z zero in the plane"));
    assert!(spoiled(|c| c.normal = Some(Point::x() * 1.1)).contains("length 1"));
    assert!(spoiled(|c| c.normal_deviation = 0.0).contains("positive"));
    let many = vec![good[0]; Gpis::MOST_ROWS / 3 + 1];
    assert!(matches!(fit(2, KERNELS[0], &many), Error::TooLarge { .. }));
    // The same contact twice, as good as without noise.
    let mut twice = vec![good[0], good[1], good[0]];
    twice.iter_mut().for_each(|c| c.point_deviation = 1e-12);
    assert_eq!(fit(2, KERNELS[0], &twice), Error::NotPositiveDefinite { row: 6, contact: 2 });
}

#[test]
fn the_default_ball_stands_about_the_contacts() {
    let points =
        [Point::new(0.0, 0.0, 0.0), Point::new(0.08, 0.0, 0.0), Point::new(0.04, 0.06, 0.0)];
    let Some(Prior::Ball { centre, radius }) = Prior::about(points) else { panic!() };
    assert!((centre - Point::new(0.04, 0.03, 0.0)).norm() < 1e-15);
    assert!((radius - (0.05 + 0.05 + 0.03) / 3.0).abs() < 1e-15);
    assert_eq!(Prior::about([]), None);
    let Some(Prior::Ball { radius, .. }) = Prior::about([points[1]; 3]) else { panic!() };
    assert_eq!(radius, Prior::LEAST_RADIUS);
}

#[test]
fn small_objects_have_the_balls_of_large_ones() {
    let scaled = |contacts: &[Contact], by: f64| -> Vec<Contact> {
        let scaled = |c: &Contact| Contact {
            point: by * c.point,
            point_deviation: by * c.point_deviation,
            ..*c
        };
        contacts.iter().map(scaled).collect()
    };
    let ball = |contacts: &[Contact]| match Prior::fitted(contacts) {
        Some(Prior::Ball { centre, radius }) => (centre, radius),
        _ => panic!(),
    };
    // By their normals, and where these are too few to decide it.
    let bare = |c: Contact| Contact { normal: None, ..c };
    let felt = ellipsoid(3, 13, 5);
    for contacts in [felt.clone(), felt.into_iter().map(bare).collect()] {
        let (centre, radius) = ball(&contacts);
        let whole = Ellipsoid::fitted(3, &contacts);
        for by in [0.1, 0.01] {
            let small = scaled(&contacts, by);
            let (at, of) = ball(&small);
            assert!((at - by * centre).norm() < 1e-9 * by && (of - by * radius).abs() < 1e-9 * by);
            let axes = |found: &Option<Ellipsoid>| found.map(|e| Point::from(e.half_axes()));
            if let Some(axes) = axes(&whole) {
                let found = Ellipsoid::fitted(3, &small).unwrap();
                assert!((Point::from(found.half_axes()) - by * axes).norm() < 1e-9 * by);
            }
        }
    }
    // The upper half of a ball, in contacts as exact as usual.
    let touch = |i: i32| {
        let (turn, up) = (2.4 * f64::from(i), f64::from(i) / 12.0);
        let ring = (1.0 - up * up).sqrt();
        let normal = Point::new(ring * turn.cos(), ring * turn.sin(), up);
        let point = 4.9e-3 * normal;
        Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.1 }
    };
    let half: Vec<Contact> = (0..12).map(touch).collect();
    let (centre, radius) = ball(&half);
    assert!(centre.norm() < 1e-12 && (radius - 4.9e-3).abs() < 1e-12, "{centre} {radius}");
    // One place, felt again and again, does not say how large the object is.
    let again = [0.0, 2e-4].map(|x| Contact { point: Point::new(x, 0.0, 0.0), ..half[0] });
    assert_eq!(ball(&again).1, Prior::LEAST_RADIUS);
}

#[test]
fn without_contacts_it_is_the_prior_with_its_doubt() {
    let body = Body::doubtful_ball(2, &ellipsoid(2, 8, 1)).unwrap();
    let p = Point::new(0.05, 0.02, 0.0);
    let doubt: f64 = body.modes(&p).iter().map(|mode| mode.0.powi(2)).sum();
    let expected = KERNELS[0].radial(0.0).value + doubt;
    let value = body.value(&p);
    let surface = Gpis::fit(2, KERNELS[0], body, Training::Derivative, &[]).unwrap();
    let (mean, covariance) = surface.joint(&[p]);
    assert!(doubt > 1e-6 && (covariance[(0, 0)] - expected).abs() < 1e-12);
    assert!((surface.variances(&[p])[0] - expected).abs() < 1e-12);
    assert_eq!((mean[0], surface.shifts().iter().all(|z| *z == 0.0)), (value, true));
}

fn point() -> impl Strategy<Value = Point> {
    proptest::array::uniform3(-0.08..0.08).prop_map(Point::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn gradient_is_the_derivative(seed in any::<u64>(), p in point()) {
        for (surface, _) in models(seed) {
            let g = surface.gradients(&[p])[0];
            for axis in 0..3 {
                let mut step = Point::zeros();
                step[axis] = 1e-5;
                let ends = surface.values(&[p + step, p - step]);
                prop_assert!((g[axis] - (ends[0] - ends[1]) / 2e-5).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn gradient_variance_is_the_variance_of_a_difference(seed in any::<u64>(), p in point()) {
        // Only the squared exponential is smooth enough to compare with a finite difference. On a
        // surface that has been told f(p), f(p ± h) is uncertain by the slope alone.
        let contacts = ellipsoid(2, 6, seed);
        let surface = fit(2, KERNELS[0], Training::Derivative, &contacts);
        let told = Contact { point: Point::new(p.x, p.y, 0.0), normal: None, point_deviation: 1e-7, normal_deviation: 0.1 };
        let prior = Prior::about(contacts.iter().map(|c| c.point)).unwrap();
        let mut more = contacts.clone();
        more.push(told);
        let knowing = Gpis::fit(2, KERNELS[0], prior, Training::Derivative, &more).unwrap();
        let h = 1e-3;
        let mut sum = 0.0;
        for step in [Point::x(), -Point::x(), Point::y(), -Point::y()] {
            sum += knowing.variances(&[p + step * h])[0] / (h * h) / 4.0;
        }
        let direct = knowing.gradient_variances(&[p])[0];
        prop_assert!((sum / direct - 1.0).abs() < 0.02, "{sum} {direct}");
        prop_assert!(direct <= surface.gradient_variances(&[p])[0] + 1e-12);
    }

    #[test]
    fn variance_is_between_nothing_and_the_prior(seed in any::<u64>(), p in point()) {
        let priors = [0.03f64, 0.03, 0.03, 0.2].map(|s| s * s);
        for ((surface, _), prior) in models(seed).zip(priors.into_iter().cycle()) {
            let v = surface.variances(&[p])[0];
            prop_assert!(v > 0.0 && v <= prior, "{v}");
            prop_assert!(surface.deviations(&[p])[0] > 0.0);
        }
    }

    #[test]
    fn more_contacts_never_make_it_less_certain(seed in any::<u64>(), p in point()) {
        let contacts = ellipsoid(3, 9, seed);
        for kernel in KERNELS {
            let few = fit(3, kernel, Training::Derivative, &contacts[..5]).variances(&[p])[0];
            let all = fit(3, kernel, Training::Derivative, &contacts).variances(&[p])[0];
            prop_assert!(all <= few + 1e-12, "{all} {few}");
        }
    }

    #[test]
    fn moving_everything_moves_the_surface(
        seed in any::<u64>(),
        p in point(),
        t in point(),
        turn in proptest::array::uniform3(-2.0..2.0f64),
    ) {
        for (surface, contacts) in models(seed) {
            let planar = surface.dimension() == 2;
            let turn = Vector3::from(turn);
            let turn = if planar { Vector3::new(0.0, 0.0, turn.z) } else { turn };
            let t = if planar { Point::new(t.x, t.y, 0.0) } else { t };
            let p = if planar { Point::new(p.x, p.y, 0.0) } else { p };
            let pose = Pose::from_parts(t.into(), UnitQuaternion::from_scaled_axis(turn));
            let moved: Vec<Contact> = contacts.iter().map(|c| c.transformed(&pose)).collect();
            // A bounding box turns differently: take the middle of the contacts along instead.
            let middle = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len() as f64;
            for kernel in KERNELS {
                let fit = |centre, contacts: &[Contact]| {
                    let prior = Prior::Ball { centre, radius: 0.04 };
                    Gpis::fit(surface.dimension(), kernel, prior, Training::Derivative, contacts)
                        .unwrap()
                };
                let here = fit(middle, &contacts);
                let there = fit(pose.rotation * middle + t, &moved);
                let q = pose.rotation * p + t;
                let (a, b) = (here.evaluate(&[p])[0], there.evaluate(&[q])[0]);
                prop_assert!((a.value - b.value).abs() < 1e-9);
                prop_assert!((pose.rotation * a.gradient - b.gradient).norm() < 1e-7);
                prop_assert!((a.variance - b.variance).abs() < 1e-10);
                prop_assert!((a.gradient_variance - b.gradient_variance).abs() < 1e-7);
                prop_assert!((here.log_marginal_likelihood() - there.log_marginal_likelihood()).abs() < 1e-6);
            }
        }
    }
}

/// The surface again, entry by entry from the definitions: what the fast one is held against.
mod plain {
    use nalgebra::{DMatrix, DVector};

    use super::super::cholesky::Cholesky;
    use super::super::gpis::{Observation, Part};
    use super::*;

    fn covariance(kernel: &Kernel, a: (Point, Part), b: (Point, Part)) -> f64 {
        let e = a.0 - b.0;
        let k = kernel.radial(e.norm());
        entry(&k, &e, a.1, b.1)
    }

    fn entry(k: &kernel::Radial, e: &Point, a: Part, b: Part) -> f64 {
        match (a, b) {
            (Part::Value, Part::Value) => k.value,
            (Part::Slope(i), Part::Value) => k.slope * e[i],
            (Part::Value, Part::Slope(j)) => -k.slope * e[j],
            (Part::Slope(i), Part::Slope(j)) => {
                -(k.bend * e[i] * e[j] + if i == j { k.slope } else { 0.0 })
            }
        }
    }

    pub struct Plain<'a> {
        surface: &'a Gpis,
        cholesky: Cholesky,
        weights: DVector<f64>,
        pub log_marginal_likelihood: f64,
    }

    impl<'a> Plain<'a> {
        pub fn of(surface: &'a Gpis) -> Self {
            let rows = &surface.observations;
            let n = rows.len();
            let matrix = DMatrix::from_fn(n, n, |i, j| {
                let noise = if i == j { rows[i].variance } else { 0.0 };
                let (a, b) = (&rows[i], &rows[j]);
                covariance(&surface.kernel, (a.point, a.part), (b.point, b.part)) + noise
            });
            let cholesky = Cholesky::new(matrix).unwrap();
            let targets = DVector::from_iterator(n, rows.iter().map(|o| o.target));
            let weights = cholesky.solve(&targets);
            let log_marginal_likelihood = -0.5
                * (targets.dot(&weights)
                    + cholesky.log_determinant()
                    + n as f64 * std::f64::consts::TAU.ln());
            Plain { surface, cholesky, weights, log_marginal_likelihood }
        }

        fn column(&self, p: &Point, part: Part) -> DVector<f64> {
            let row =
                |o: &Observation| covariance(&self.surface.kernel, (o.point, o.part), (*p, part));
            let rows = &self.surface.observations;
            DVector::from_iterator(rows.len(), rows.iter().map(row))
        }

        /// What the contacts add to the prior's value or slope at `p`.
        pub fn mean(&self, p: &Point, part: Part) -> f64 {
            self.column(p, part).dot(&self.weights)
        }

        pub fn variance(&self, p: &Point, part: Part) -> f64 {
            let column = self.column(p, part);
            let prior = covariance(&self.surface.kernel, (*p, part), (*p, part));
            prior - column.dot(&self.cholesky.solve(&column))
        }

        /// ½ Σ (wᵢwⱼ − K⁻¹ᵢⱼ) ∂Kᵢⱼ/∂ln ℓ.
        pub fn lengthscale_slope(&self) -> Option<f64> {
            let inverse = self.cholesky.inverse();
            let rows = &self.surface.observations;
            let mut sum = 0.0;
            for (i, a) in rows.iter().enumerate() {
                for (j, b) in rows.iter().enumerate() {
                    let e = a.point - b.point;
                    let k = self.surface.kernel.radial_by_log_lengthscale(e.norm())?;
                    let gain = self.weights[i] * self.weights[j] - inverse[(i, j)];
                    sum += 0.5 * gain * entry(&k, &e, a.part, b.part);
                }
            }
            Some(sum)
        }
    }
}

#[test]
fn the_fast_surface_is_the_plain_one() {
    use super::gpis::Part;
    let queries: Vec<Point> = (0..230)
        .map(f64::from)
        .map(|i| Point::new((0.7 * i).sin(), (1.1 * i).cos(), (1.7 * i + 1.0).sin()) * 0.08)
        .collect();
    for dimension in [2, 3] {
        for training in TRAININGS {
            for kernel in KERNELS {
                let mut contacts = ellipsoid(dimension, 13, 77);
                // Sites of one row among sites of several.
                contacts[4].normal = None;
                let surface = fit(dimension, kernel, training, &contacts);
                let plain = plain::Plain::of(&surface);
                let close = |ours: f64, theirs: f64, scale: f64| {
                    assert!(
                        (ours - theirs).abs() < 1e-9 * scale,
                        "{kernel:?} {training:?} {dimension}: {ours} {theirs}"
                    );
                };
                let (ours, theirs) =
                    (surface.log_marginal_likelihood(), plain.log_marginal_likelihood);
                close(ours, theirs, theirs.abs());
                let slopes = surface.log_marginal_likelihood_slopes();
                assert_eq!(slopes.lengthscale.is_some(), plain.lengthscale_slope().is_some());
                if let (Some(a), Some(b)) = (slopes.lengthscale, plain.lengthscale_slope()) {
                    // The terms of the sum cancel; the matrix decides how well they are known.
                    close(a, b, 100.0 * (1.0 + b.abs()));
                }
                let groups = [queries[..2].to_vec(), Vec::new(), queries[1..].to_vec()];
                for (group, covariance) in groups.iter().zip(surface.joint_each(&groups)) {
                    let (_, alone) = surface.joint(group);
                    assert_eq!(covariance.shape(), (group.len(), group.len()));
                    for (a, b) in covariance.iter().zip(alone.iter()) {
                        close(*a, *b, 1.0);
                    }
                }
                // Training points themselves are among the queries: distance zero.
                let mut points = queries.clone();
                points.extend(contacts.iter().map(|c| c.point));
                let found = surface.evaluate(&points);
                let means = surface.means(&points);
                for ((p, e), mean) in points.iter().zip(&found).zip(means) {
                    let p = if dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p };
                    let prior = Prior::about(contacts.iter().map(|c| c.point)).unwrap();
                    close(e.value, prior.value(&p) + plain.mean(&p, Part::Value), 1.0);
                    close(mean, e.value, 1.0);
                    let mut variance = 0.0;
                    for axis in 0..dimension {
                        let slope = plain.mean(&p, Part::Slope(axis));
                        close(e.gradient[axis], prior.gradient(&p)[axis] + slope, 10.0);
                        variance += plain.variance(&p, Part::Slope(axis)) / dimension as f64;
                    }
                    close(e.gradient_variance, variance, 10.0);
                    close(e.variance, plain.variance(&p, Part::Value), 1.0);
                }
            }
        }
    }
}
