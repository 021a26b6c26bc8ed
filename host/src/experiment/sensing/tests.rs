//! The goals of the experiments at a few seeds, and the core's single precision against double.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use tactile_core::matrix::{Coordinates, Matrix, Vector};
use tactile_core::sensing::calibration::Wrench;
use tactile_core::sensing::fingertip::{Fingertip, Shape};
use tactile_core::sensing::intrinsic::locate;

use super::{electrodes, fingertip, point, wrench};
use crate::sim::random::Random;
use crate::sim::sensors::{Push, Skin};
use crate::space::Point;

#[test]
fn a_newton_is_felt_within_half_a_millimetre() {
    let table = wrench::run(4).unwrap();
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
    assert!(table.to_string().contains("goal at 1 N"));
    assert!(table.picture().is_ok());
}

#[test]
fn electrodes_correct_the_centroid() {
    let table = electrodes::run(2).unwrap();
    for row in table.rows.iter().filter(|r| r.newtons >= 0.5) {
        assert!(row.reported > 0.95 && row.point_mm < 1.5, "{row:?}");
        assert!(row.point_mm < 0.5 * row.rising_mm && row.rising_mm < row.centroid_mm, "{row:?}");
    }
    assert!(table.refused > 0.8, "{}", table.refused);
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
