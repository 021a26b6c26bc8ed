//! Estimators from words to touches.

mod electrodes;
mod properties;

use std::vec::Vec as List;

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
    assert!((contact.normal_deviation - touch.normal_deviation).abs() < 1e-6);
    // Out of the plane by 30°, it turns more easily in it.
    let (sin, cos) = 0.5f32.asin().sin_cos();
    let tilted = Touch { normal: Vector([-cos, 0.0, sin]), ..touch };
    let looser = tilted.contact::<Planar>(&quarter, 0).unwrap().normal_deviation;
    assert!((looser * cos - touch.normal_deviation).abs() < 1e-6, "{looser}");
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

/// Nobody can tell a bias that moves from a load that does: a touch is the less certain the longer
/// it lasts, until the finger is free again.
#[test]
fn a_touch_that_lasts_is_less_certain() {
    let mut bench = Bench::new(&settings());
    let load = push(Vector([-0.01, 0.0, -8e-3]), Vector([0.2, 0.0, 1.0]));
    let skin = |touch: Touch| touch.covariance.at(0, 0);
    let first = skin(bench.feel(&load).unwrap());
    let mut last = first;
    for _ in 0..6000 {
        bench.1 += 9_000;
        last = skin(bench.read(&load).unwrap());
    }
    // A minute at a hundredth of a reading's deviation a second, beside eight readings and a tare.
    let once = 1.0 / 8.0 + 1.0 / 256.0;
    let ratio = (once + 0.36) / once;
    assert!((last / first - ratio).abs() < 0.02 * ratio, "{last} {first}");
    for _ in 0..20 {
        let _free = bench.read(&Wrench::ZERO);
    }
    let again = skin(bench.feel(&load).unwrap());
    assert!((again / first - 1.0).abs() < 0.02, "{again} {first}");
}

#[test]
fn how_long_a_touch_lasts_survives_any_clock() {
    let mut held = detection::Held::new();
    let seconds = |held: &mut detection::Held, time: u32| {
        held.pass(time);
        held.seconds()
    };
    held.pass(u32::MAX - 500_000);
    held.release();
    assert_eq!(held.seconds(), 0.0);
    // Over the clock's end, then back, which adds nothing, and on.
    assert!((seconds(&mut held, 499_999) - 1.0).abs() < 1e-6);
    assert!((seconds(&mut held, 399_999) - 1.0).abs() < 1e-6);
    assert!((seconds(&mut held, 1_399_999) - 2.0).abs() < 1e-6);
    // Three half hours are as long as can be told, not none.
    for k in 1..4u32 {
        held.pass(1_399_999u32.wrapping_add(k.wrapping_mul(1_800_000_000)));
    }
    assert!((held.seconds() - 4294.967).abs() < 1.0, "{}", held.seconds());
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
        (WrenchSettings { creep: -0.1, ..good }, CalibrationError::Range),
        (WrenchSettings { creep: f32::INFINITY, ..good }, CalibrationError::NotFinite),
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

/// The same words give the same bits on every target.
#[test]
fn touches_are_golden() {
    let shapes = properties::shapes();
    let golden = shapes[..].iter().map(|shape| {
        let fingertip = Fingertip { shape: *shape, edge: None };
        let mut bench = Bench::new(&WrenchSettings { fingertip, ..settings() });
        let at = Vector([-1e-3, 4e-3, -6e-3]);
        let touch = bench.feel(&push(at, Vector([0.1, -0.4, 0.9]))).unwrap();
        let [x, y, z] = touch.point.0.map(f32::to_bits);
        [x, y, z, touch.covariance.at(0, 1).to_bits(), touch.normal_deviation.to_bits()]
    });
    let expected = [
        [3129785083, 999078862, 3151649027, 810993408, 1019503332],
        [3130041980, 999335763, 3152227058, 2942779294, 1016421070],
        [3129848959, 999142738, 3151792754, 2954985126, 1016703437],
        [3131564238, 1000858070, 3154884443, 2974443676, 1020824933],
    ];
    assert_eq!(golden.collect::<List<_>>(), expected);
}

#[test]
fn five_fingers_fit_a_small_memory() {
    assert!(size_of::<WrenchEstimator>() <= 1280, "{}", size_of::<WrenchEstimator>());
    assert!(size_of::<ElectrodeEstimator>() <= 3840, "{}", size_of::<ElectrodeEstimator>());
}

#[test]
fn a_tare_starts_again_where_a_reading_is_out_of_range() {
    let mut bench = Bench(WrenchEstimator::new(), 0);
    bench.0.configure(&settings()).unwrap();
    let needed = settings().sampling.tare;
    let taring = |bench: &mut Bench| bench.read(&Wrench::ZERO) == Err(NoContact::Taring);
    assert!((1..needed).all(|_| taring(&mut bench)));
    let broken = GaugeReading([0, 0, 0, 0, i32::MAX, 0]);
    assert_eq!(bench.0.estimate(&broken, 0), Err(NoContact::Saturated { channel: 4 }));
    assert!((0..needed).all(|_| taring(&mut bench)) && !taring(&mut bench));

    let mut electrodes = ElectrodeEstimator::new();
    electrodes.configure(&ElectrodeSettings::BIOTAC).unwrap();
    let mut taring = |words| {
        let felt = electrodes.estimate(&ElectrodeReading(words), 0);
        felt == Err(NoContact::Taring)
    };
    let needed = ElectrodeSettings::BIOTAC.sampling.tare;
    assert!((1..needed).all(|_| taring([3000; ELECTRODES])));
    assert!(!taring([0; ELECTRODES]));
    assert!((0..needed).all(|_| taring([3000; ELECTRODES])) && !taring([3000; ELECTRODES]));
}
