//! Contacts from electrodes.

use super::*;
use crate::sensing::electrodes::{BIOTAC_SKIN, centroid, log};

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

pub(super) fn tared() -> ElectrodeEstimator {
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
            BIOTAC_SKIN.project(outward * 6e-3 + Vector([x, 0.0, 0.0])).unwrap().point
        } else {
            outward * 7e-3 + Vector([x, 0.0, 0.0])
        };
        let words = bell(&[middle], 0.6);
        let touch = press(&mut tared(), words).unwrap();
        let error = (touch.point - middle).norm();
        assert!(error < 0.6e-3, "{middle:?} {touch:?}");
        let changes = words.map(|w| 3000.0 - w as f32);
        let plain = centroid(&changes, &ElectrodeSettings::BIOTAC.positions).unwrap();
        let plain = BIOTAC_SKIN.project(plain).unwrap().point;
        assert!(error < 0.6 * (plain - middle).norm(), "{error} {plain:?} {middle:?}");
    }
}

#[test]
fn two_bells_are_not_one_contact() {
    let two = [Vector([-1e-3, 6.7e-3, -2e-3]), Vector([-0.012, -6.7e-3, -2e-3])];
    assert_eq!(press(&mut tared(), bell(&two, 0.8)), Err(NoContact::Inconsistent));
}

#[test]
fn drift_of_single_electrodes_is_followed_while_nothing_touches() {
    let words = bell(&[], 0.0);
    // Seven electrodes by a word every five seconds, twelve in all.
    let felt = |rate: f32| {
        let mut estimator = ElectrodeEstimator::new();
        let settings = ElectrodeSettings { drift: rate, ..ElectrodeSettings::BIOTAC };
        estimator.configure(&settings).unwrap();
        let felt = (0..6000u32).map(|k| {
            let drifted =
                core::array::from_fn(|e| words[e] - if e < 7 { k as u16 / 500 } else { 0 });
            estimator.estimate(&ElectrodeReading(drifted), 10_000 * k)
        });
        felt.skip(64).any(|felt| felt != Err(NoContact::TooLight))
    };
    assert!(!felt(1e-3), "followed");
    assert!(felt(0.0), "taken for a contact");
}

/// The same words where the fluid conducts less by this factor.
fn colder(words: [u16; ELECTRODES], factor: f32) -> [u16; ELECTRODES] {
    words.map(|w| (4095.0 / (1.0 + (4095.0 / w as f32 - 1.0) * factor) + 0.5) as u16)
}

#[test]
fn a_finger_that_cools_down_or_warms_up_is_no_contact() {
    let middle = Vector([-9e-3, 0.0, -7e-3]);
    let pressed = bell(&[middle], 0.6);
    let error = |touch: &Touch| (touch.point - middle).norm();
    let cold = error(&press(&mut tared(), pressed).unwrap());
    for factor in [0.8, 0.95, 1.05, 1.2] {
        let mut estimator = tared();
        let mut time = 64_000;
        let mut read = |words| {
            time += 1000;
            estimator.estimate(&ElectrodeReading(words), time)
        };
        // Touched, and left when all impedances have changed: nothing is felt from the moment on at
        // which the window and the detector have seen it.
        for _ in 0..20 {
            let _touch = read(pressed);
        }
        let left: List<_> = (0..600).map(|_| read(colder(bell(&[], 0.0), factor))).collect();
        assert!(left[12..].iter().all(|felt| *felt == Err(NoContact::TooLight)), "{factor}");
        // Followed meanwhile, so that a touch is found as before.
        let touch = (0..12).map(|_| read(colder(pressed, factor))).last().unwrap().unwrap();
        assert!((error(&touch) - cold).abs() < 0.1e-3, "{factor} {touch:?}");
    }
}

/// A finger that cools down while it is touched: by 0.9 % of all impedances in a minute, but where the
/// fluid goes that the touch displaces.
#[test]
fn impedances_that_creep_under_a_touch_do_not_deceive() {
    let middle = Vector([-9e-3, 2e-3, -6.7e-3]);
    let pressed = bell(&[middle], 0.4);
    let lasts = |creep: f32| {
        let mut estimator = ElectrodeEstimator::new();
        let settings = ElectrodeSettings { creep, ..ElectrodeSettings::BIOTAC };
        estimator.configure(&settings).unwrap();
        let felt = (0..6064u32).map(|k| {
            let mut words = match k {
                0..64 => bell(&[], 0.0),
                _ => colder(pressed, 1.0 + 9e-3 * (k - 64) as f32 / 6000.0),
            };
            words[5] = 3000;
            estimator.estimate(&ElectrodeReading(words), 10_000 * k)
        });
        felt.collect::<List<_>>()
    };
    let felt = lasts(ElectrodeSettings::BIOTAC.creep);
    let (first, last) = (felt[80].unwrap(), felt[6063].unwrap());
    let error = |touch: Touch| (touch.point - middle).norm();
    let unaware = lasts(0.0)[6063].unwrap();
    assert!(error(last) < 0.6 * error(unaware), "{} {}", error(last), error(unaware));
    let trace = |t: &Touch| t.covariance.at(0, 0) + t.covariance.at(1, 1) + t.covariance.at(2, 2);
    assert!(trace(&last) > 1.5 * trace(&first), "{} {}", trace(&last), trace(&first));
}

#[test]
fn a_word_at_an_end_is_named() {
    let mut estimator = tared();
    let mut words = bell(&[], 0.0);
    for end in [4095, 4087, 8, 0] {
        words[3] = end;
        let felt = estimator.estimate(&ElectrodeReading(words), 0);
        assert_eq!(felt, Err(NoContact::Saturated { channel: 3 }));
    }
    words[3] = 3000;
    for channel in 0..ELECTRODES {
        for wrong in [8, 4087, 0x7fff, 0x8000, 0xffff] {
            let mut words = words;
            words[channel] = wrong;
            let felt = estimator.estimate(&ElectrodeReading(words), 0);
            let channel = channel as u8;
            assert_eq!(felt, Err(NoContact::Saturated { channel }), "{wrong}");
        }
    }
    for inside in [9, 4086] {
        words[3] = inside;
        let felt = estimator.estimate(&ElectrodeReading(words), 0);
        assert!(!matches!(felt, Err(NoContact::Saturated { .. })), "{inside}");
    }
}

#[test]
fn a_touch_is_golden() {
    let middle = Vector([-7e-3, 4.2e-3, -5.6e-3]);
    let touch = press(&mut tared(), bell(&[middle], 0.4)).unwrap();
    let [x, y, z] = touch.point.0.map(f32::to_bits);
    let bits = [x, y, z, touch.covariance.at(0, 1).to_bits(), touch.force[2].to_bits()];
    assert_eq!(bits, [3152338604, 998842694, 3149389592, 827043772, 1049764512]);
}

#[test]
fn logarithms_of_changes_are_near() {
    for k in 0..4000 {
        let x = math::exp(k as f32 * 5e-3 - 12.0);
        let want = f64::from(x).ln();
        assert!((f64::from(log(x)) - want).abs() < 9e-5, "{x}");
    }
}

#[test]
fn what_the_noise_may_be_is_no_rise() {
    // Eight readings and a tare of 64: four deviations are three words.
    let detection = Hysteresis { begin: 1e-3, end: 5e-4, begin_readings: 1, end_readings: 1 };
    let settings = ElectrodeSettings { detection, drift: 0.0, ..ElectrodeSettings::BIOTAC };
    let felt = |fall: u16| {
        let mut estimator = ElectrodeEstimator::new();
        estimator.configure(&settings).unwrap();
        let words = core::array::from_fn(|k| if k == 16 { 3000 - fall } else { 3000 });
        let read = |k: u32| ElectrodeReading(if k < 64 { [3000; 19] } else { words });
        (0..80).map(|k| estimator.estimate(&read(k), 1000 * k)).collect::<List<_>>()
    };
    assert!(felt(3)[64..].iter().all(|felt| *felt == Err(NoContact::TooLight)));
    assert_ne!(felt(4)[79], Err(NoContact::TooLight));
    // Of a single reading one deviation is two words.
    assert_eq!(felt(8)[64], Err(NoContact::TooLight));
    assert_ne!(felt(9)[64], Err(NoContact::TooLight));
}
