//! The goals of the experiments at a few seeds, and the core's single precision against double.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use tactile_core::matrix::{Coordinates, Matrix, Vector};
use tactile_core::sensing::calibration::Wrench;
use tactile_core::sensing::fingertip::{Fingertip, Shape};
use tactile_core::sensing::intrinsic::locate;
use tactile_core::sensing::{
    ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, NoContact,
};

use super::{drift, electrodes, fingertip, point, wrench};
use crate::sim::random::Random;
use crate::sim::sensors::film::Options;
use crate::sim::sensors::{FluidFinger, Push, Skin};
use crate::space::Point;

#[test]
fn a_newton_is_felt_within_half_a_millimetre() {
    let table = wrench::run(2).unwrap();
    let averaged =
        |newtons: f64| table.rows.iter().filter(move |r| r.window == 8 && r.newtons == newtons);
    assert_eq!(averaged(1.0).count(), 2);
    for row in averaged(1.0) {
        assert!(row.point_mm <= 0.5 && row.normal_deg <= 2.5 && row.reported > 0.98, "{row:?}");
    }
    for row in table.rows.iter().filter(|r| r.window == 8 && r.newtons >= 0.5) {
        assert!((row.squared - 2.0).abs() < row.band, "the covariance is honest: {row:?}");
    }
    for row in averaged(0.05) {
        assert!(row.reported < 0.01, "too light to be located: {row:?}");
    }
    // Errors fall as the force grows.
    for pair in
        table.rows.windows(2).filter(|p| p[0].window == p[1].window && p[0].skin == p[1].skin)
    {
        assert!(pair[0].newtons < 0.15 || pair[1].point_mm < pair[0].point_mm, "{pair:?}");
    }
    // Of two contacts at once all are refused that can be told from one.
    assert_eq!(table.several.len(), 4);
    for (skin, several) in &table.several {
        assert!((several.refused - several.bound).abs() <= 0.05, "{skin} {several:?}");
        assert!((0.2..0.9).contains(&several.bound), "{skin} {several:?}");
    }
    assert!(table.to_string().contains("goal at 1 N"));
    assert!(table.picture().is_ok());
}

#[test]
fn electrodes_correct_the_centroid() {
    let table = electrodes::run(2).unwrap();
    for row in table.rows.iter().filter(|r| r.newtons >= 0.5) {
        assert!(row.reported > 0.95 && row.point_mm < 1.5, "{row:?}");
        assert!(row.point_mm < 0.25 * row.centroid_mm, "{row:?}");
        assert!(row.point_mm < 0.8 * row.rising_mm, "{row:?}");
    }
    assert!(table.refused > 0.8, "{}", table.refused);
    assert!(table.picture().is_ok());
}

#[test]
fn drift_that_is_followed_does_no_harm() {
    // Five minutes, in which it drifts fastest: twelve parts, and the last six of them judged.
    let table = drift::run(1, 300.0).unwrap();
    assert_eq!(table.rows.len(), 3 * 2 * 12);
    // A touch that lasts is reported all the time, and its covariance holds.
    assert_eq!(table.lasting.len(), 3 * 4);
    for touch in &table.lasting {
        assert!(touch.missed == 0.0 && touch.squared.unwrap() < 3.5, "{touch:?}");
    }
    for case in table.rows.chunks(24) {
        let sum = |rows: &[drift::Row]| {
            let missed: f64 = rows.iter().map(|r| r.missed * r.pushes as f64).sum();
            let all = rows.iter().map(|r| r.pushes as f64).sum::<f64>() - missed;
            let reported = |r: &drift::Row| (1.0 - r.missed) * r.pushes as f64;
            let square = rows.iter().filter_map(|r| Some(reported(r) * r.point_mm?.powi(2)));
            let error = (square.sum::<f64>() / all.max(1.0)).sqrt();
            (missed, error, rows.iter().map(|r| r.felt).sum::<f64>())
        };
        let (followed, not) = (sum(&case[6..12]), sum(&case[18..24]));
        let name = case[0].case;
        assert!(case[6].followed && !case[18].followed && case[6].case == case[18].case);
        assert!(followed.0 == 0.0 && followed.1 < 0.4 && followed.2 == 0.0, "{name} {followed:?}");
        // The transducer's contacts move; the electrodes' are mostly not reported any more.
        assert!(not.0 > 3.0 || not.1 > 1.5 * followed.1, "{name} {not:?}");
    }
    assert!(table.picture().is_ok());
}

/// c and k of M = c × F + k∇S(c), S(c) = 0 for S = cᵀQc + 2b·c − d, by Newton's method on the four
/// equations as they stand, in double precision, from the true contact.
fn reference(q: &Matrix3<f64>, b: &Point, d: f64, wrench: &[f64; 6], start: &Push) -> Point {
    let [fx, fy, fz, mx, my, mz] = *wrench;
    let (force, moment) = (Point::new(fx, fy, fz), Point::new(mx, my, mz));
    let gradient = |c: &Point| 2.0 * (q * c + b);
    let mut c = start.point;
    let mut k = start.torsion / gradient(&c).norm();
    for _ in 0..30 {
        let g = gradient(&c);
        let rest: Vector3<f64> = moment - c.cross(&force) - g * k;
        let value = c.dot(&(q * c)) + 2.0 * b.dot(&c) - d;
        let mut jacobian = Matrix4::zeros();
        let block = 2.0 * k * q - force.cross_matrix();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&block);
        jacobian.fixed_view_mut::<3, 1>(0, 3).copy_from(&g);
        jacobian.fixed_view_mut::<1, 3>(3, 0).copy_from(&g.transpose());
        let right = Vector4::new(rest.x, rest.y, rest.z, -value);
        let step = jacobian.lu().solve(&right).unwrap();
        c += step.fixed_rows::<3>(0);
        k += step[3];
    }
    c
}

#[test]
fn single_precision_agrees_with_double() {
    let [mut random] = Random::streams(11);
    let [a, b, c] = [12e-3f64, 9e-3, 8e-3];
    let skin = Skin::Ellipsoid([a, b, c]);
    let q = Matrix3::from_diagonal(&Point::new(a.powi(-2), b.powi(-2), c.powi(-2)));
    // The same ellipsoid as a general quadric, shifted.
    let shift = Point::new(1e-3, -2e-3, 0.5e-3);
    let linear = -(q * shift);
    let constant = 1.0 - shift.dot(&(q * shift));
    let single = |v: &Point| Vector([v.x as f32, v.y as f32, v.z as f32]);
    let quadric = Fingertip {
        shape: Shape::Quadric {
            matrix: Matrix(std::array::from_fn(|i| std::array::from_fn(|j| q[(i, j)] as f32))),
            linear: single(&linear),
            constant: constant as f32,
        },
        edge: None,
    }
    .checked()
    .unwrap();
    let mut worst = [0.0f64; 2];
    for _ in 0..300 {
        let newtons = 10f64.powf(random.around_zero(1.0));
        let slide = 0.8 * random.unit();
        let push = Push::new(skin.sample(&mut random), newtons, slide, random.direction(3));
        let push = push.twisted(random.around_zero(1.5e-3) * newtons);
        // Noise takes the wrench off what any contact was put in for.
        let noise: [f64; 6] = std::array::from_fn(|k| {
            random.around_zero(0.05) * newtons * if k < 3 { 1.0 } else { 0.01 }
        });
        let load = push.wrench();
        let load: [f64; 6] = std::array::from_fn(|k| load[k] + noise[k]);
        let wrench = |w: &[f64; 6]| Wrench {
            force: Vector([w[0] as f32, w[1] as f32, w[2] as f32]),
            moment: Vector([w[3] as f32, w[4] as f32, w[5] as f32]),
        };
        let truth = reference(&q, &Point::zeros(), 1.0, &load, &push);
        let found = locate(&fingertip(&skin), &wrench(&load)).unwrap();
        worst[0] = worst[0].max((point(&found.patch.point) - truth).norm());

        let force = Point::new(load[0], load[1], load[2]);
        let turn = shift.cross(&force);
        let mut moved = load;
        for k in 0..3 {
            moved[3 + k] += turn[k];
        }
        let found = locate(&quadric, &wrench(&moved)).unwrap();
        worst[1] = worst[1].max((point(&found.patch.point) - shift - truth).norm());
        assert!(found.patch.outward.is_finite());
    }
    assert!(worst[0] < 2e-7 && worst[1] < 2e-6, "{worst:?} m");
}

/// The electrodes' least squares in double precision, as a system of three unknowns.
#[test]
fn electrodes_agree_with_double_precision() {
    let settings = ElectrodeSettings::BIOTAC;
    let mut finger = FluidFinger::new(Options { noise: 0.0, ..Options::default() }, 5);
    let free = finger.sample(&[], 0.01);
    for (along, around, newtons) in [(0.016, 0.3, 1.0), (0.021, -0.8, 0.5), (0.006, 0.1, 3.0)] {
        let mut estimator = ElectrodeEstimator::new();
        estimator.configure(&settings).unwrap();
        let push = Push::new(Skin::BIOTAC.at(along, around), newtons, 0.0, Point::zeros());
        let pressed = finger.sample(&[push], 0.01);
        let mut felt = Err(NoContact::Taring);
        for time in 0..90 {
            let words = if time < 64 { free } else { pressed };
            felt = estimator.estimate(&ElectrodeReading(words), 1000 * time);
        }
        let touch = felt.unwrap();

        let (above, footprint) = (FluidFinger::above(), f64::from(settings.footprint));
        let scale = 1.0 / 8.0 + 1.0 / 64.0;
        let (mut used, mut largest) = (Vec::new(), 0.0f64);
        for k in 0..19 {
            let ohms = |word: u16| (4095.0 - f64::from(word)) / f64::from(word);
            let (rest, now) = (ohms(free[k]), ohms(pressed[k]));
            let change = now / rest - 1.0;
            let slope = 4095.0 / f64::from(pressed[k]).powi(2) / rest;
            let noise = f64::from(settings.noise) * f64::sqrt(scale) * slope;
            if change > 4.0 * noise {
                used.push((above[k], change, noise));
                largest = largest.max(change);
            }
        }
        let strongest = used.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
        let (foot, outward) = {
            let (along, around) = Skin::BIOTAC.place(&strongest);
            Skin::BIOTAC.at(along, around)
        };
        let u = outward.cross(&Point::x()).try_normalize(1e-6).unwrap_or(Point::y());
        let v = outward.cross(&u);
        let prior = f64::from(settings.stray).powi(-2);
        let mut normal = Matrix3::from_diagonal(&Point::new(0.0, prior, prior));
        let mut right = Point::zeros();
        for (at, change, noise) in used.iter().filter(|u| u.1 > 0.04 * largest) {
            let away = at - foot;
            let square = footprint * footprint;
            let row = Point::new(1.0, u.dot(&away) / square, v.dot(&away) / square);
            let value = change.ln() + 0.5 * away.norm_squared() / square;
            let mismatch = f64::from(settings.mismatch);
            let weight = 1.0 / ((noise / change).powi(2) + mismatch * mismatch);
            normal += row * row.transpose() * weight;
            right += row * value * weight;
        }
        let solution = normal.lu().solve(&right).unwrap();
        let middle = foot + u * solution[1] + v * solution[2];
        let (along, around) = Skin::BIOTAC.place(&middle);
        let expected = Skin::BIOTAC.at(along, around).0;
        let error = (point(&touch.point) - expected).norm();
        assert!(error < 2e-6, "{error} m at {along}, {around}");
        let spread = normal.try_inverse().unwrap();
        let single = |a: &Point| {
            let c = Matrix3::from_fn(|i, j| f64::from(touch.covariance.0[i][j]));
            a.dot(&(c * a))
        };
        assert!((single(&u) / spread[(1, 1)] - 1.0).abs() < 1e-3);
        assert!((single(&v) / spread[(2, 2)] - 1.0).abs() < 1e-3);
    }
}
