//! Estimators from words to touches, and what no word, force or setting may do.

use std::vec::Vec as List;

use proptest::prelude::*;

use super::calibration::{GaugeCalibration, Weight, Wrench};
use super::detection::{Detector, Hysteresis, Phase, Tare, Window};
use super::fingertip::{Edge, Fingertip, Shape};
use super::intrinsic::{Scatter, locate};
use super::*;
use crate::space::{Planar, PlanarPose, Spatial};

const FINGER: Fingertip =
    Fingertip { shape: Shape::CappedCylinder { radius: 8e-3, length: 0.02 }, edge: None };

/// One gauge for every component, 10⁻⁶ of full scale a word.
fn gauges() -> GaugeCalibration {
    let mut matrix = [[0.0; 6]; 6];
    for k in 0..6 {
        matrix[k][k] = WrenchSettings::NANO17[k] * 1e-6;
    }
    GaugeCalibration::new(matrix, (-1_000_001, 1_000_001), WrenchSettings::NANO17).unwrap()
}

fn words(wrench: &Wrench) -> GaugeReading {
    let (f, m) = (wrench.force, wrench.moment);
    let load = [f[0], f[1], f[2], m[0], m[1], m[2]];
    GaugeReading(core::array::from_fn(|k| (load[k] / WrenchSettings::NANO17[k] * 1e6) as i32))
}

fn push(point: Vector<3>, force: Vector<3>) -> Wrench {
    Wrench { force, moment: point.cross(force) }
}

/// A tared estimator and its clock.
struct Bench(WrenchEstimator, u32);

impl Bench {
    fn new(settings: &WrenchSettings) -> Bench {
        let mut bench = Bench(WrenchEstimator::new(), 0);
        bench.0.configure(settings).unwrap();
        bench.settle(&Wrench::ZERO);
        bench
    }

    fn read(&mut self, wrench: &Wrench) -> Result<Touch, NoContact> {
        self.1 = self.1.wrapping_add(1000);
        self.0.estimate(&words(wrench), self.1)
    }

    fn settle(&mut self, wrench: &Wrench) {
        while self.read(wrench) == Err(NoContact::Taring) {}
    }

    fn feel(&mut self, wrench: &Wrench) -> Result<Touch, NoContact> {
        (0..16).map(|_| self.read(wrench)).last().unwrap()
    }
}

fn settings() -> WrenchSettings {
    WrenchSettings::nano17(gauges(), FINGER)
}

#[test]
fn a_push_becomes_a_contact_in_the_world() {
    let mut bench = Bench::new(&settings());
    let at = Vector([-0.01, 0.0, -8e-3]);
    let touch = bench.feel(&push(at, Vector([0.2, 0.0, 1.0]))).unwrap();
    assert!((touch.point - at).norm() < 2e-6, "{touch:?}");
    assert!((touch.normal - Vector([0.0, 0.0, 1.0])).norm() < 1e-3);
    assert!((touch.slip.unwrap() - 0.2).abs() < 1e-3);
    assert!((touch.force - Vector([0.2, 0.0, 1.0])).norm() < 1e-4);
    // Eight readings, a millisecond apart, the last just now.
    assert_eq!(touch.time, bench.1 - 3500);
    // 0.36 N mm and 36 mN of noise eight times averaged, on a lever of 8 and 10 mm, at 1 N.
    let deviation = math::sqrt(touch.covariance.at(0, 0));
    assert!((1e-4..3e-4).contains(&deviation), "{deviation}");
    assert!((touch.covariance.at(2, 2) - 1e-8).abs() < 1e-9, "the skin's tolerance");

    // A quarter turn about x brings −z to y.
    let h = core::f32::consts::FRAC_1_SQRT_2;
    let fingertip = SpatialPose::new(Vector([0.1, 0.2, 0.3]), [h, 0.0, 0.0, h]);
    let contact = touch.contact::<Spatial>(&fingertip, 3).unwrap();
    assert!((contact.point - Vector([0.09, 0.208, 0.3])).norm() < 1e-5, "{contact:?}");
    assert!((contact.normal.unwrap() - Vector([0.0, -1.0, 0.0])).norm() < 1e-3);
    assert!((contact.point_deviation - 1e-4).abs() < 1e-5 && contact.finger == 3);
}

#[test]
fn a_touch_lies_in_the_plane_only_if_its_normal_does() {
    let mut bench = Bench::new(&settings());
    let touch = bench.feel(&push(Vector([8e-3, 0.0, 0.0]), Vector([-1.0, 0.0, 0.0]))).unwrap();
    let quarter = PlanarPose::new(Vector([0.5, 0.0]), core::f32::consts::FRAC_PI_2);
    let contact = touch.contact::<Planar>(&quarter, 0).unwrap();
    assert!((contact.point - Vector([0.5, 8e-3])).norm() < 1e-5);
    assert!((contact.normal.unwrap() - Vector([0.0, -1.0])).norm() < 1e-3);
    // Turned so that x stands on the plane, nothing is left in it.
    let h = core::f32::consts::FRAC_1_SQRT_2;
    let upright = touch.moved(&SpatialPose::new(Vector::ZERO, [0.0, h, 0.0, h]));
    assert!((upright.point - Vector([0.0, 0.0, -8e-3])).norm() < 1e-5, "{upright:?}");
    assert!((upright.covariance.at(2, 2) - touch.covariance.at(0, 0)).abs() < 1e-10);
    assert_eq!(upright.contact::<Planar>(&quarter, 0), None);
    let broken = Touch { point: Vector([f32::NAN, 0.0, 0.0]), ..touch };
    assert_eq!(broken.contact::<Spatial>(&SpatialPose::IDENTITY, 0), None);
}

#[test]
fn reasons_are_told_apart() {
    let mut fresh = WrenchEstimator::new();
    assert_eq!(fresh.estimate(&GaugeReading([0; 6]), 0), Err(NoContact::NotCalibrated));
    let mut electrodes = ElectrodeEstimator::new();
    let reading = ElectrodeReading([3000; 19]);
    assert_eq!(electrodes.estimate(&reading, 0), Err(NoContact::NotCalibrated));

    let edge = Edge { normal: Vector([0.0, 0.0, -1.0]), offset: 0.0 };
    let fingertip = Fingertip { edge: Some(edge), ..FINGER };
    let mut bench = Bench::new(&WrenchSettings { fingertip, ..settings() });
    let below = Vector([-0.01, 0.0, -8e-3]);
    assert_eq!(bench.feel(&push(below, Vector([0.0, 0.0, 0.05]))), Err(NoContact::TooLight));
    assert_eq!(bench.read(&push(below, Vector([0.0, 0.0, 8.0]))), Err(NoContact::Settling));
    assert!(bench.feel(&push(below, Vector([0.0, 0.0, 1.0]))).is_ok());
    // As if glued: what pushes on the finger's back could as well pull at its pad.
    assert_eq!(bench.feel(&push(below, Vector([0.0, 0.0, -1.0]))), Err(NoContact::Pulling));
    let beside = Vector([-0.01, 0.02, 0.0]);
    assert_eq!(bench.feel(&push(beside, Vector([0.0, 0.0, 1.0]))), Err(NoContact::OutsideSkin));
    let behind = Vector([-0.05, 0.0, -8e-3]);
    assert_eq!(bench.feel(&push(behind, Vector([0.0, 0.0, 1.0]))), Err(NoContact::OutsideSkin));
    // More friction, more torsion than one contact holds.
    assert_eq!(bench.feel(&push(below, Vector([1.6, 0.0, 1.0]))), Err(NoContact::Inconsistent));
    let mut twisted = push(below, Vector([0.0, 0.0, 1.0]));
    twisted.moment[2] += 4e-3;
    assert_eq!(bench.feel(&twisted), Err(NoContact::Inconsistent));
    // Every word is credible, but together they weigh more than the sensor bears.
    let mut double = [[0.0; 6]; 6];
    for k in 0..6 {
        double[k][k] = WrenchSettings::NANO17[k] * 2e-6;
    }
    let double = GaugeCalibration::new(double, (-1_000_001, 1_000_001), WrenchSettings::NANO17);
    let heavy = double.unwrap().wrench(&[0.0, 0.0, 4e5, 6e5, 0.0, 0.0]);
    assert_eq!(heavy, Err(NoContact::Saturated { channel: 3 }));
    let mut broken = words(&Wrench::ZERO);
    broken.0[4] = i32::MIN;
    assert_eq!(bench.0.estimate(&broken, 0), Err(NoContact::Saturated { channel: 4 }));
    // A less certain point than is asked for.
    let mut strict = Bench::new(&WrenchSettings { precision: 1e-4, ..settings() });
    let light = push(below, Vector([0.0, 0.0, 0.3]));
    assert_eq!(strict.feel(&light), Err(NoContact::IllConditioned));
}

#[test]
fn the_fingertips_own_weight_is_taken_off() {
    let weight = Weight { mass: 0.03, centre: Vector([4e-3, 0.0, 0.0]) };
    let mut bench = Bench(WrenchEstimator::new(), 0);
    bench.0.configure(&WrenchSettings { weight, drift: 0.0, ..settings() }).unwrap();
    let down = |x: f32, z: f32| Vector([9.81 * x, 0.0, 9.81 * z]);
    bench.0.set_gravity(down(0.0, -1.0));
    bench.settle(&weight.load(down(0.0, -1.0)));
    // Turned over: 0.59 N of the tip's own would be taken for a contact.
    bench.0.set_gravity(down(1.0, 0.0));
    bench.0.set_gravity(Vector([f32::NAN; 3]));
    assert_eq!(bench.feel(&weight.load(down(1.0, 0.0))), Err(NoContact::TooLight));
    assert!(bench.feel(&weight.load(down(0.0, 1.0))).is_ok(), "as nobody said that it turned");
    bench.0.set_gravity(down(0.0, 1.0));
    let at = Vector([-5e-3, 8e-3, 0.0]);
    let load = push(at, Vector([0.0, -0.5, 0.0])) + weight.load(down(0.0, 1.0));
    let touch = bench.feel(&load).unwrap();
    assert!((touch.point - at).norm() < 1e-5, "{touch:?}");
}

#[test]
fn a_sensor_elsewhere_is_as_good() {
    let h = core::f32::consts::FRAC_1_SQRT_2;
    let sensor = SpatialPose::new(Vector([-0.03, 2e-3, 0.0]), [0.0, h, 0.0, h]);
    let mut bench = Bench::new(&WrenchSettings { sensor, ..settings() });
    let mut aligned = Bench::new(&settings());
    let load = push(Vector([-5e-3, 8e-3, 0.0]), Vector([0.1, -0.8, 0.2]));
    let touch = bench.feel(&load.moved(&sensor.inverse())).unwrap();
    let other = aligned.feel(&load).unwrap();
    assert!((touch.point - other.point).norm() < 1e-5, "{touch:?}");
    // The longer lever makes the same noise worse.
    assert!(touch.covariance.at(0, 0) > 2.0 * other.covariance.at(0, 0));
}

#[test]
fn drift_is_followed_while_nothing_touches() {
    let drift = |rate| {
        let mut bench = Bench::new(&WrenchSettings { drift: rate, ..settings() });
        let mut load = Wrench::ZERO;
        for k in 0..4000 {
            load.force = Vector([0.0, 5e-5, 0.0]) * k as f32;
            let _free = bench.read(&load);
        }
        bench.feel(&load)
    };
    assert!(drift(0.0).is_ok(), "0.2 N are a contact");
    assert_eq!(drift(1e-2), Err(NoContact::TooLight));
}

#[test]
fn matrices_that_feel_too_little_are_refused() {
    let range = (-8_388_608, 8_388_607);
    let full = WrenchSettings::NANO17;
    let unit: [[f32; 6]; 6] =
        core::array::from_fn(|i| core::array::from_fn(|j| (i == j) as u8 as f32 * 1e-6));
    let refused = |matrix| GaugeCalibration::new(matrix, range, full).unwrap_err();
    assert!(GaugeCalibration::new(unit, range, full).is_ok());
    assert_eq!(refused([[0.0; 6]; 6]), CalibrationError::Singular);
    let mut twice = unit;
    twice[3] = twice[0].map(|v| 17.0 * v);
    assert_eq!(refused(twice), CalibrationError::Singular);
    let mut sum = unit;
    sum[5] = core::array::from_fn(|j| unit[0][j] - 2.0 * unit[1][j] + 0.5 * unit[2][j]);
    assert_eq!(refused(sum), CalibrationError::Singular);
    let mut column = unit;
    column[2][2] = 0.0;
    assert_eq!(refused(column), CalibrationError::Singular);
    let mut broken = unit;
    broken[1][4] = f32::NAN;
    assert_eq!(refused(broken), CalibrationError::NotFinite);
    // Scales that differ by much are not singular.
    let mut scaled = unit;
    for (k, row) in scaled.iter_mut().enumerate() {
        *row = row.map(|v| v * 10f32.powi(3 * k as i32 - 9));
    }
    assert!(GaugeCalibration::new(scaled, range, full).is_ok());
    assert_eq!(GaugeCalibration::new(unit, (5, 5), full), Err(CalibrationError::Range));
    assert_eq!(GaugeCalibration::new(unit, (i32::MIN, 0), full), Err(CalibrationError::Range));
    assert_eq!(GaugeCalibration::new(unit, range, [0.0; 6]), Err(CalibrationError::NotPositive));
}

#[test]
fn settings_that_make_no_sense_change_nothing() {
    let good = settings();
    let mut bench = Bench::new(&good);
    let bad = [
        (WrenchSettings { friction: 0.0, ..good }, CalibrationError::NotPositive),
        (WrenchSettings { torsion: f32::NAN, ..good }, CalibrationError::NotFinite),
        (WrenchSettings { drift: 2.0, ..good }, CalibrationError::Range),
        (
            WrenchSettings { detection: Hysteresis { end: 1.0, ..good.detection }, ..good },
            CalibrationError::Range,
        ),
        (
            WrenchSettings {
                sampling: detection::Sampling { window: 17, ..good.sampling },
                ..good
            },
            CalibrationError::Window,
        ),
        (
            WrenchSettings {
                fingertip: Fingertip { shape: Shape::Sphere { radius: -1.0 }, edge: None },
                ..good
            },
            CalibrationError::NotPositive,
        ),
        (
            WrenchSettings { weight: Weight { mass: -1.0, centre: Vector::ZERO }, ..good },
            CalibrationError::NotPositive,
        ),
    ];
    for (settings, why) in bad {
        assert_eq!(bench.0.configure(&settings), Err(why));
    }
    let below = push(Vector([0.0, 0.0, -8e-3]), Vector([0.0, 0.0, 1.0]));
    assert!(bench.feel(&below).is_ok(), "still tared and configured");
    let electrodes = ElectrodeSettings { footprint: -1.0, ..ElectrodeSettings::BIOTAC };
    let refused = ElectrodeEstimator::new().configure(&electrodes);
    assert_eq!(refused, Err(CalibrationError::NotPositive));
    let mut adrift = ElectrodeSettings::BIOTAC;
    adrift.positions[7] = Vector::ZERO;
    assert_eq!(ElectrodeEstimator::new().configure(&adrift), Err(CalibrationError::Range));
}

#[test]
fn contacts_begin_and_end_with_hysteresis() {
    let hysteresis = Hysteresis { begin: 2.0, end: 1.0, begin_readings: 2, end_readings: 3 };
    let mut detector = Detector::new();
    let levels = [0.0, 2.5, 1.5, 2.0, 2.0, 1.5, 1.0, 0.9, 0.5, 1.0, 0.9, f32::NAN, 0.1, 1.9, 0.0];
    let phases: List<Phase> = levels.iter().map(|l| detector.update(*l, &hysteresis)).collect();
    use Phase::*;
    let expected = [
        Free, Beginning, Free, Beginning, Touching, Touching, Touching, Ending, Ending, Touching,
        Ending, Ending, Free, Free, Free,
    ];
    assert_eq!(phases, expected);
}

#[test]
fn windows_forget_what_is_old_or_out_of_order() {
    let mut window = Window::<1>::new();
    assert_eq!((window.count(), window.middle()), (0, 0));
    let sum = |window: &Window<1>| (window.sums()[0], window.count(), window.middle());
    let start = u32::MAX - 150;
    for k in 0..5u32 {
        window.push(&[1 << k], start.wrapping_add(100 * k), 3, 250);
    }
    // The last three, across the clock's end.
    assert_eq!(sum(&window), (4 + 8 + 16, 3, start.wrapping_add(300)));
    window.push(&[100], start.wrapping_add(400), 3, 250);
    assert_eq!(sum(&window), (100, 1, start.wrapping_add(400)), "the same time again");
    window.push(&[1], start, 3, 250);
    assert_eq!(sum(&window), (1, 1, start), "time that goes back");
    window.push(&[2], start.wrapping_add(250), 3, 250);
    assert_eq!(sum(&window), (3, 2, start.wrapping_add(125)));
    window.push(&[4], start.wrapping_add(501), 3, 250);
    assert_eq!(sum(&window), (4, 1, start.wrapping_add(501)), "a pause");
}

#[test]
fn a_tare_starts_again_when_readings_disagree() {
    let mut tare = Tare::<2>::new();
    assert_eq!(tare.push(&[10, 0], 3, 5), None);
    assert_eq!(tare.push(&[14, 0], 3, 5), None);
    assert_eq!(tare.push(&[16, 0], 3, 5), None, "six apart");
    assert_eq!(tare.push(&[16, 1], 3, 5), None);
    assert_eq!(tare.push(&[17, 2], 3, 5), None);
    assert_eq!(tare.push(&[18, 3], 3, 5), Some([17.0, 2.0]));
    let mut tare = Tare::<1>::new();
    assert_eq!(tare.push(&[i32::MIN], 2, 5), None);
    assert_eq!(tare.push(&[i32::MAX], 2, 5), None);
}

/// Words of electrodes that follow the estimator's own bell around `middle`.
fn bell(middles: &[Vector<3>], height: f32) -> [u16; ELECTRODES] {
    let settings = ElectrodeSettings::BIOTAC;
    core::array::from_fn(|k| {
        let above = settings.fingertip.project(settings.positions[k]).unwrap().point;
        let change = |middle: &Vector<3>| {
            let away = (above - *middle).norm() / settings.footprint;
            height * math::exp(-0.5 * away * away)
        };
        // Impedance at 3000 words, raised.
        let rise: f32 = middles.iter().map(change).sum();
        let impedance = 1095.0 / 3000.0 * (1.0 + rise);
        (4095.0 / (1.0 + impedance)) as u16
    })
}

fn electrodes() -> ElectrodeEstimator {
    let mut estimator = ElectrodeEstimator::new();
    estimator.configure(&ElectrodeSettings::BIOTAC).unwrap();
    for time in 0..64 {
        let free = estimator.estimate(&ElectrodeReading(bell(&[], 0.0)), 1000 * time);
        assert_eq!(free, Err(NoContact::Taring));
    }
    estimator
}

fn press(estimator: &mut ElectrodeEstimator, words: [u16; ELECTRODES]) -> Result<Touch, NoContact> {
    (0..12).map(|k| estimator.estimate(&ElectrodeReading(words), 64_000 + 1000 * k)).last().unwrap()
}

#[test]
fn a_bell_is_found_where_the_centroid_is_drawn_away() {
    for (x, angle) in [(-5e-3f32, 0.0f32), (-9e-3, 0.7), (-12e-3, -1.0), (2e-3, 0.3)] {
        let (sin, cos) = math::sin_cos(angle);
        let outward = Vector([0.0, sin, -cos]);
        let middle = if x > 0.0 {
            BIOTAC_TEST_SKIN.project(outward * 6e-3 + Vector([x, 0.0, 0.0])).unwrap().point
        } else {
            outward * 7e-3 + Vector([x, 0.0, 0.0])
        };
        let words = bell(&[middle], 0.6);
        let touch = press(&mut electrodes(), words).unwrap();
        let error = (touch.point - middle).norm();
        assert!(error < 0.6e-3, "{middle:?} {touch:?}");
        let changes = words.map(|w| 3000.0 - w as f32);
        let plain = electrodes::centroid(&changes, &ElectrodeSettings::BIOTAC.positions).unwrap();
        let plain = BIOTAC_TEST_SKIN.project(plain).unwrap().point;
        assert!(error < 0.6 * (plain - middle).norm(), "{error} {plain:?} {middle:?}");
    }
}

const BIOTAC_TEST_SKIN: Fingertip = electrodes::BIOTAC_SKIN;

#[test]
fn two_bells_are_not_one_contact() {
    let two = [Vector([-1e-3, 6.7e-3, -2e-3]), Vector([-0.012, -6.7e-3, -2e-3])];
    assert_eq!(press(&mut electrodes(), bell(&two, 0.8)), Err(NoContact::Inconsistent));
}

#[test]
fn electrodes_drift_and_saturate() {
    let mut words = bell(&[], 0.0);
    // A word every five seconds, twelve in all.
    let drift = |rate: f32| {
        let mut estimator = ElectrodeEstimator::new();
        let settings = ElectrodeSettings { drift: rate, ..ElectrodeSettings::BIOTAC };
        estimator.configure(&settings).unwrap();
        let felt = (0..6000u32).map(|k| {
            let drifted = words.map(|w| w - (k / 500) as u16);
            estimator.estimate(&ElectrodeReading(drifted), 10_000 * k)
        });
        felt.skip(64).any(|felt| felt != Err(NoContact::TooLight))
    };
    assert!(!drift(1e-3), "followed");
    assert!(drift(0.0), "taken for a contact");
    let mut estimator = electrodes();
    words[3] = 4095;
    let full = estimator.estimate(&ElectrodeReading(words), 0);
    assert_eq!(full, Err(NoContact::Saturated { channel: 3 }));
    words[3] = 0;
    let none = estimator.estimate(&ElectrodeReading(words), 0);
    assert_eq!(none, Err(NoContact::Saturated { channel: 3 }));
}

fn any_float() -> impl Strategy<Value = f32> {
    prop_oneof![any::<u32>().prop_map(f32::from_bits), -2.0f32..2.0, Just(0.0)]
}

fn any_vector() -> impl Strategy<Value = Vector<3>> {
    proptest::array::uniform3(any_float()).prop_map(Vector)
}

fn shapes() -> [Shape; 4] {
    let mut matrix = Matrix::IDENTITY;
    *matrix.at_mut(0, 1) = 0.3;
    *matrix.at_mut(1, 0) = 0.3;
    [
        Shape::Sphere { radius: 8e-3 },
        Shape::Ellipsoid { half_axes: Vector([12e-3, 9e-3, 8e-3]) },
        Shape::CappedCylinder { radius: 8e-3, length: 0.02 },
        Shape::Quadric { matrix, linear: Vector([1e-3, 0.0, 2e-3]), constant: 6e-5 },
    ]
}

/// A unit vector.
fn direction() -> impl Strategy<Value = Vector<3>> {
    proptest::array::uniform3(-1.0f32..1.0)
        .prop_filter_map("no direction", |v| Vector(v).normalized())
}

proptest! {
    #[test]
    fn no_force_makes_locating_panic(force in any_vector(), moment in any_vector(), k in 0usize..4, edge in any::<bool>()) {
        let edge = edge.then_some(Edge { normal: Vector([1.0, 0.0, 0.0]), offset: 0.0 });
        let fingertip = Fingertip { shape: shapes()[k], edge };
        if let Ok(press) = locate(&fingertip, &Wrench { force, moment }) {
            prop_assert!(press.patch.point.is_finite() && press.push > 0.0);
            prop_assert!((press.patch.outward.norm() - 1.0).abs() < 1e-3, "{:?}", press);
            let _scatter = press.scatter(&Matrix::IDENTITY);
        }
    }

    #[test]
    fn no_words_make_an_estimator_panic(readings in proptest::collection::vec((any::<[i32; 6]>(), any::<u32>(), 0u32..64), 1..40)) {
        let mut bench = Bench::new(&settings());
        for (words, time, shift) in readings {
            let reading = GaugeReading(words.map(|w| w >> (shift % 32)));
            if let Ok(touch) = bench.0.estimate(&reading, time) {
                prop_assert!(touch.contact::<Spatial>(&SpatialPose::IDENTITY, 0).is_some(), "{:?}", touch);
            }
        }
    }

    #[test]
    fn no_words_make_electrodes_panic(readings in proptest::collection::vec((proptest::collection::vec(any::<u16>(), 19), any::<u32>(), 0u32..8), 1..40)) {
        let mut estimator = electrodes();
        for (words, time, shift) in readings {
            let mut reading = ElectrodeReading::default();
            for (to, from) in reading.0.iter_mut().zip(&words) {
                *to = from >> shift;
            }
            if let Ok(touch) = estimator.estimate(&reading, time) {
                prop_assert!(touch.contact::<Spatial>(&SpatialPose::IDENTITY, 0).is_some(), "{:?}", touch);
            }
        }
    }

    #[test]
    fn no_matrix_makes_calibration_panic(matrix in proptest::collection::vec(any_float(), 36), low in any::<i32>(), high in any::<i32>(), words in proptest::array::uniform6(any_float())) {
        let rows = core::array::from_fn(|i| core::array::from_fn(|j| matrix[6 * i + j]));
        let gauges = GaugeCalibration::new(rows, (low, high), WrenchSettings::NANO17);
        if let Some(Ok(wrench)) = gauges.ok().map(|gauges| gauges.wrench(&words)) {
            prop_assert!(wrench.is_finite());
        }
    }

    #[test]
    fn a_push_is_found_on_every_shape(k in 0usize..4, at in direction(), along in direction(), slide in 0.0f32..0.8, twist in -1.5e-3f32..1.5e-3, newtons in 0.05f32..15.0) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let patch = fingertip.project(at * 0.012).unwrap();
        let tangent = along - patch.outward * patch.outward.dot(along);
        let force = (tangent * slide - patch.outward) * newtons;
        let moment = patch.point.cross(force) + patch.outward * (twist * newtons);
        let press = locate(&fingertip, &Wrench { force, moment });
        if !fingertip.covers(patch.point) {
            prop_assert!(press.is_err());
            return Ok(());
        }
        let press = press.unwrap();
        prop_assert!((press.patch.point - patch.point).norm() < 5e-6, "{:?} {:?}", press, patch);
        prop_assert!((press.torsion - twist * newtons).abs() < 5e-6 * newtons);
        prop_assert!((press.push - newtons).abs() < 1e-3 * newtons);
        // The same whatever the unit of force.
        let double = locate(&fingertip, &Wrench { force: force * 2.0, moment: moment * 2.0 }).unwrap();
        prop_assert!((double.patch.point - press.patch.point).norm() < 1e-7);
    }

    #[test]
    fn scatter_is_the_derivative(k in 0usize..4, at in direction(), along in direction(), twist in -1e-3f32..1e-3, component in 0usize..6) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let patch = fingertip.project(at * 0.012).unwrap();
        // Clear of the seam between cylinder and cap, where curvature jumps.
        prop_assume!(fingertip.covers(patch.point) && patch.point[0].abs() > 1e-3);
        let tangent = along - patch.outward * patch.outward.dot(along);
        let force = tangent * 0.4 - patch.outward;
        let moment = patch.point.cross(force) + patch.outward * twist;
        let here = locate(&fingertip, &Wrench { force, moment }).unwrap();
        let step = if component < 3 { 2e-2 } else { 2e-4 };
        let moved = |sign: f32| {
            let mut wrench = Wrench { force, moment };
            if component < 3 { wrench.force[component] += sign * step } else { wrench.moment[component - 3] += sign * step }
            locate(&fingertip, &wrench).unwrap().patch.point
        };
        prop_assume!(patch.point[0].abs() > 2e-3);
        let slope = (moved(1.0) - moved(-1.0)) * (0.5 / step);
        let mut noise = Matrix::<6>::ZERO;
        *noise.at_mut(component, component) = 1.0;
        let Scatter { point: [uu, uv, vv], .. } = here.scatter(&noise);
        let [u, v] = here.patch.tangents.map(|t| t.dot(slope));
        let size = 1e-9 + 0.02 * (uu + vv);
        prop_assert!((uu - u * u).abs() < size && (uv - u * v).abs() < size && (vv - v * v).abs() < size, "{} {} {} {} {}", uu, uv, vv, u, v);
    }

    #[test]
    fn projecting_lands_on_the_skin_at_a_right_angle(k in 0usize..4, at in direction(), far in 0.7f32..2.0) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let point = fingertip.project(at * 0.01).unwrap().point * far;
        let patch = fingertip.project(point).unwrap();
        prop_assert!(fingertip.height(patch.point).abs() < 1e-6);
        let away = point - patch.point;
        prop_assert!(away.cross(patch.outward).norm() < 2e-5, "{:?} {:?}", away, patch);
        let [u, v] = patch.tangents;
        prop_assert!((u.cross(v) - patch.outward).norm() < 1e-5);
    }
}

#[test]
fn quadrics_must_be_convex_and_real() {
    let quadric = |diagonal: [f32; 3], linear: [f32; 3], constant: f32| {
        let mut matrix = Matrix::ZERO;
        for k in 0..3 {
            *matrix.at_mut(k, k) = diagonal[k];
        }
        let shape = Shape::Quadric { matrix, linear: Vector(linear), constant };
        Fingertip { shape, edge: None }.checked().map(|_| ())
    };
    let refused = Err(CalibrationError::NotConvex);
    assert_eq!(quadric([1.0, 1.0, 1.0], [0.0; 3], 6e-5), Ok(()));
    assert_eq!(quadric([1.0, 1.0, 0.0], [0.0; 3], 6e-5), Ok(()), "a cylinder");
    assert_eq!(quadric([1.0, 2.0, 0.0], [0.0, 0.0, 5e-3], 0.0), Ok(()), "a paraboloid");
    assert_eq!(quadric([1.0, 1.0, -1.0], [0.0; 3], 6e-5), refused, "a hyperboloid");
    assert_eq!(quadric([1.0, 0.0, 0.0], [0.0; 3], 6e-5), refused, "a slab");
    assert_eq!(quadric([1.0, 1.0, 1.0], [0.0; 3], -6e-5), refused, "nothing");
    assert_eq!(quadric([0.0; 3], [0.0; 3], 0.0), refused);
    assert_eq!(quadric([f32::NAN, 1.0, 1.0], [0.0; 3], 1.0), Err(CalibrationError::NotFinite));
}

/// A paraboloid and a cylinder have no closed form here: both are found by Newton's method alone.
#[test]
fn open_quadrics_are_found_too() {
    let mut matrix = Matrix::ZERO;
    *matrix.at_mut(1, 1) = 1.0;
    *matrix.at_mut(2, 2) = 1.5;
    // y² + 1.5 z² + 2·0.004 x = 0, open towards −x.
    let shape = Shape::Quadric { matrix, linear: Vector([4e-3, 0.0, 0.0]), constant: 0.0 };
    let tip = Fingertip { shape, edge: None }.checked().unwrap();
    let (y, z) = (3e-3, -2e-3);
    let patch = tip.patch(Vector([-(y * y + 1.5 * z * z) / 8e-3, y, z]));
    assert!(tip.height(patch.point).abs() < 1e-8);
    let force = patch.outward * -2.0 + patch.tangents[0] * 0.7;
    let moment = patch.point.cross(force) + patch.outward * 2e-3;
    let press = locate(&tip, &Wrench { force, moment }).unwrap();
    assert!((press.patch.point - patch.point).norm() < 2e-6, "{press:?}");
    assert!((press.torsion - 2e-3).abs() < 1e-5);
    // Straight out of its open end nothing touches.
    let out = Wrench { force: Vector([1.0, 0.0, 0.0]), moment: Vector::ZERO };
    assert_eq!(locate(&tip, &out), Err(NoContact::OutsideSkin));
}

/// The same words give the same bits on every target.
#[test]
fn touches_are_golden() {
    let shapes = shapes();
    let golden = shapes[..].iter().map(|shape| {
        let fingertip = Fingertip { shape: *shape, edge: None };
        let mut bench = Bench::new(&WrenchSettings { fingertip, ..settings() });
        let at = Vector([-1e-3, 4e-3, -6e-3]);
        let touch = bench.feel(&push(at, Vector([0.1, -0.4, 0.9]))).unwrap();
        let [x, y, z] = touch.point.0.map(f32::to_bits);
        [x, y, z, touch.covariance.at(0, 1).to_bits(), touch.normal_deviation.to_bits()]
    });
    let expected = [
        [3129785083, 999078862, 3151649027, 810993402, 1019503331],
        [3130041980, 999335763, 3152227058, 2942779294, 1016421069],
        [3129848959, 999142738, 3151792754, 2954985123, 1016703436],
        [3131564238, 1000858070, 3154884443, 2974443672, 1020824932],
    ];
    assert_eq!(golden.collect::<List<_>>(), expected);
    let middle = Vector([-7e-3, 4.2e-3, -5.6e-3]);
    let touch = press(&mut electrodes(), bell(&[middle], 0.4)).unwrap();
    let [x, y, z] = touch.point.0.map(f32::to_bits);
    let bits = [x, y, z, touch.covariance.at(0, 1).to_bits(), touch.force[2].to_bits()];
    assert_eq!(bits, [3152348662, 998840690, 3149391087, 827208852, 1049765702]);
}

#[test]
fn five_fingers_fit_a_small_memory() {
    assert!(size_of::<WrenchEstimator>() <= 1280, "{}", size_of::<WrenchEstimator>());
    assert!(size_of::<ElectrodeEstimator>() <= 2560, "{}", size_of::<ElectrodeEstimator>());
}
