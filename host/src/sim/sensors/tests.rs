//! Forward models are judged by what any such sensor obeys, not by the estimators.

use std::f64::consts::PI;

use super::film::{self, FluidFinger};
use super::gauges::{self, FULL_SCALE, RESOLUTION, Transducer, WORD};
use super::{Push, Skin};
use crate::sim::random::Random;
use crate::space::Point;

const SKINS: [Skin; 2] = [Skin::Ellipsoid([12e-3, 9e-3, 8e-3]), Skin::BIOTAC];

/// S(c) of the skin, zero on it.
fn implicit(skin: &Skin, p: &Point) -> f64 {
    match *skin {
        Skin::Ellipsoid([a, b, c]) => {
            (p.x / a).powi(2) + (p.y / b).powi(2) + (p.z / c).powi(2) - 1.0
        }
        Skin::Finger { radius, .. } => {
            Point::new(p.x.max(0.0), p.y, p.z).norm_squared() / (radius * radius) - 1.0
        }
    }
}

#[test]
fn samples_lie_on_the_skin_and_normals_stand_on_it() {
    let [mut random] = Random::streams(1);
    for skin in SKINS {
        for _ in 0..500 {
            let (point, normal) = skin.sample(&mut random);
            assert!(implicit(&skin, &point).abs() < 1e-9);
            // The gradient by differences.
            let h = 1e-7;
            let gradient = Point::from_fn(|i, _| {
                let e = Point::from_fn(|j, _| (i == j) as u8 as f64 * h);
                implicit(&skin, &(point + e)) - implicit(&skin, &(point - e))
            });
            assert!((normal - gradient.normalize()).norm() < 1e-5, "{point} {normal}");
            let (along, around) = skin.place(&point);
            assert!((skin.at(along, around).0 - point).norm() < 1e-9);
        }
    }
}

#[test]
fn samples_are_even() {
    let [mut random] = Random::streams(2);
    let n = 40_000;
    // Half of an ellipsoid's area lies on either side of the plane x = 0; of a nearly flat one
    // nearly a quarter of it within half the radius.
    let flat = Skin::Ellipsoid([1e-6, 1.0, 1.0]);
    let within = (0..n).filter(|_| flat.sample(&mut random).0.norm() < 0.5).count();
    assert!((within as f64 / n as f64 - 0.25).abs() < 0.01, "{within}");
    // The cap of a BioTac is 7 of its 25 mm of axis.
    let cap = (0..n).filter(|_| Skin::BIOTAC.sample(&mut random).0.x > 0.0).count();
    assert!((cap as f64 / n as f64 - 7.0 / 25.0).abs() < 0.01, "{cap}");
}

#[test]
fn words_times_the_calibration_are_the_load() {
    let quiet = gauges::Options { noise: 0.0, ..gauges::Options::default() };
    let mut transducer = Transducer::new(quiet, 4);
    let matrix = transducer.calibration().unwrap();
    let free = transducer.sample(&[], Point::zeros(), 1e-3);
    let push = Push::new(Skin::BIOTAC.at(0.01, 0.4), 2.0, 0.3, Point::x()).twisted(1e-3);
    let words = transducer.sample(&[push, push], Point::zeros(), 1e-3);
    for (k, row) in matrix.iter().enumerate() {
        let load: f64 = (0..6).map(|j| row[j] * f64::from(words[j] - free[j])).sum();
        // Within rounding to the data sheet's resolution and to words.
        assert!((load - 2.0 * push.wrench()[k]).abs() < 0.6 * RESOLUTION[k], "{k}");
    }
}

#[test]
fn noise_is_what_the_data_sheet_says() {
    let mut transducer = Transducer::new(gauges::Options::default(), 5);
    let matrix = transducer.calibration().unwrap();
    let n = 2000;
    let (mut sum, mut square) = ([0.0; 6], [0.0; 6]);
    for _ in 0..n {
        let words = transducer.sample(&[], Point::zeros(), 1e-3);
        for (k, row) in matrix.iter().enumerate() {
            let load: f64 = (0..6).map(|j| row[j] * f64::from(words[j])).sum();
            sum[k] += load / n as f64;
            square[k] += load * load / n as f64;
        }
    }
    for k in 0..6 {
        let deviation = (square[k] - sum[k] * sum[k]).sqrt();
        assert!((deviation / (0.003 * FULL_SCALE[k]) - 1.0).abs() < 0.08, "{k} {deviation}");
    }
}

#[test]
fn transducers_drift_weigh_and_saturate() {
    let options = gauges::Options { noise: 0.0, warming: 10.0, ..gauges::Options::default() };
    let mut transducer = Transducer::new(options, 6);
    let cold = transducer.sample(&[], Point::zeros(), 1e-3);
    let warm = transducer.sample(&[], Point::zeros(), 3600.0);
    let shift = cold.iter().zip(&warm).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    assert!(shift > 1e-3 * WORD && shift < 0.02 * WORD, "{shift}");

    let weight = (0.1, Point::new(0.02, 0.0, 0.0));
    let options = gauges::Options { noise: 0.0, weight, ..gauges::Options::default() };
    let mut heavy = Transducer::new(options, 6);
    let matrix = heavy.calibration().unwrap();
    let level = heavy.sample(&[], Point::zeros(), 1e-3);
    let hanging = heavy.sample(&[], Point::new(0.0, 0.0, -9.81), 1e-3);
    let load =
        |k: usize| (0..6).map(|j| matrix[k][j] * f64::from(hanging[j] - level[j])).sum::<f64>();
    assert!((load(2) + 0.981).abs() < RESOLUTION[2] && (load(4) - 0.01962).abs() < RESOLUTION[4]);

    let huge = Push::new(Skin::BIOTAC.at(0.0, 0.0), 1e9, 0.0, Point::zeros());
    let words = heavy.sample(&[huge], Point::zeros(), 1e-3);
    assert!(words.iter().any(|w| w.abs() >= 8_388_607), "{words:?}");
}

fn quiet() -> FluidFinger {
    FluidFinger::new(film::Options { noise: 0.0, warming: 0.0, spread: 0.2 }, 3)
}

#[test]
fn a_press_over_an_electrode_raises_its_impedance_most() {
    let mut finger = quiet();
    let rest = finger.sample(&[], 0.01);
    assert!(rest.iter().all(|w| (2800..3500).contains(w)), "{rest:?}");
    for (k, above) in FluidFinger::above().iter().enumerate() {
        let (along, around) = Skin::BIOTAC.place(above);
        let mut last = 0.0;
        for newtons in [0.1, 0.5, 2.0, 8.0] {
            let push = Push::new(Skin::BIOTAC.at(along, around), newtons, 0.0, Point::zeros());
            let words = finger.sample(&[push], 0.01);
            // Impedance over impedance at rest.
            let rise = |i: usize| {
                let ohms = |w: u16| 4095.0 / f64::from(w) - 1.0;
                ohms(words[i]) / ohms(rest[i])
            };
            let most = (0..19).max_by(|a, b| rise(*a).total_cmp(&rise(*b)));
            assert_eq!(most, Some(k), "{newtons} N");
            assert!(rise(k) > last && rise(k) > 1.0, "more force, more impedance");
            last = rise(k);
            // What is squeezed out lifts the skin far away.
            let far = (0..19).map(rise).fold(f64::INFINITY, f64::min);
            assert!(newtons < 0.5 || far < 1.0, "{far}");
        }
    }
}

#[test]
fn fingers_are_mirrored_and_repeat() {
    // With electrodes of one size a mirrored push gives mirrored words.
    let options = film::Options { noise: 0.0, warming: 0.0, spread: 0.0 };
    let words = |around: f64| {
        let push = Push::new(Skin::BIOTAC.at(0.016, around), 1.0, 0.0, Point::zeros());
        FluidFinger::new(options, 0).sample(&[push], 0.01)
    };
    let (left, right) = (words(0.6), words(-0.6));
    assert_eq!(left[0..6], right[10..16]);
    assert_eq!(left[7], right[8]);
    assert_ne!(left[1], left[11]);
    let noisy = |seed| FluidFinger::new(film::Options::default(), seed).sample(&[], 0.01);
    assert_eq!(noisy(7), noisy(7));
    assert_ne!(noisy(7), noisy(8));
    // Warm fluid conducts better: words rise.
    let mut warm = FluidFinger::new(film::Options { noise: 0.0, warming: 10.0, spread: 0.0 }, 0);
    let cold = warm.sample(&[], 0.01)[4];
    assert!(warm.sample(&[], 3600.0)[4] > cold + 20);
}

#[test]
fn an_ellipsoids_ends_have_normals() {
    let skin = SKINS[0];
    assert!((skin.at(0.0, 0.3).1 - Point::x()).norm() < 1e-9);
    assert!((skin.at(PI, 0.3).1 + Point::x()).norm() < 1e-9);
}
