//! The whole way from a sensor's words to a pose: words over the link, an emulated chip behind the
//! board's driver, its estimator, contacts, grasp, tracker; on a virtual board and in QEMU.

use std::cell::Cell;
use std::io;
use std::time::Duration;

use nalgebra::{Rotation3, Translation3, UnitQuaternion};
use tactile_core::driver::emulated::Fault;
use tactile_core::sensing::electrodes::BIOTAC_CORE;
use tactile_core::sensing::{ElectrodeSettings, NoContact, WrenchSettings};
use tactile_core::space::Spatial;
use tactile_core::wire::{
    Clock, FingerState, Frame, MAX_FRAME, Refusal, Report, SensorFault, SensorPart, Settings, Skin,
    Words, WordsFrame, encode,
};
use tactile_host::link::firmware::{self, Machine};
use tactile_host::link::qemu::Qemu;
use tactile_host::link::{Link, Patience, Session, SessionError, virtual_board};
use tactile_host::space::{Bridge, Point, Pose};
use tactile_tests::{built, unless_missing};

const FINGERS: u8 = 5;
/// The finger that has electrodes; the others have gauges.
const ELECTRODES: u8 = 3;
const RADIUS: f64 = 0.007;
/// Readings of a free finger that make a tare here.
const TARE: u16 = 8;

fn emulated(image: &str) -> Option<Qemu> {
    let elf = built(image, Machine::Stm32f405)?;
    unless_missing(Qemu::start(&elf, Machine::Stm32f405, Duration::from_secs(120)))
}

/// A transducer with one gauge for each component: newtons and newton metres of a count.
fn per_count(k: usize) -> f64 {
    f64::from(WrenchSettings::NANO17[k]) / 4e6
}

/// What a finger with gauges is told.
fn gauges() -> Vec<SensorPart> {
    let row = |row: usize| {
        let numbers = std::array::from_fn(|k| if k == row { per_count(k) as f32 } else { 0.0 });
        SensorPart::Row { row: row as u8, numbers }
    };
    let mut parts = vec![SensorPart::Gauges];
    parts.extend((0..6).map(row));
    parts.extend([
        SensorPart::Skin(Skin::CappedCylinder { radius: RADIUS as f32, length: 0.02 }),
        SensorPart::Sampling { window: 2, gap: 20_000, tare: TARE, spread: 1 << 16 },
        SensorPart::Detection { begin: 0.15, end: 0.08, begin_readings: 1, end_readings: 1 },
    ]);
    parts
}

fn electrodes() -> Vec<SensorPart> {
    vec![
        SensorPart::Electrodes,
        SensorPart::Sampling { window: 2, gap: 20_000, tare: TARE, spread: 64 },
        SensorPart::Detection { begin: 0.05, end: 0.03, begin_readings: 1, end_readings: 1 },
    ]
}

/// The words of a transducer whose fingertip is pressed at `point` with `force` (fingertip frame).
fn gauge_words(point: &Point, force: &Point) -> Words {
    let moment = point.cross(force);
    let load = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
    Words::Gauges(std::array::from_fn(|k| (load[k] / per_count(k)).round() as i32))
}

/// The words of electrodes under a skin that gives way about `point`; `None`: nothing touches.
fn electrode_words(point: Option<&Point>) -> Words {
    let settings = ElectrodeSettings::BIOTAC;
    let word = |at: Point| {
        let away = point.map_or(f64::INFINITY, |p| (at - p).norm());
        let bell = (-0.5 * (away / f64::from(settings.footprint)).powi(2)).exp();
        let full = f64::from(settings.full_scale);
        let rest = full / 3000.0 - 1.0;
        (full / (1.0 + rest * (1.0 + 0.8 * bell))).round() as u16
    };
    let above = |k: usize| settings.fingertip.project(BIOTAC_CORE[k]).unwrap().point;
    Words::Electrodes {
        electrodes: std::array::from_fn(|k| word(Spatial::point(&above(k)))),
        pressure: 1500,
        vibration: 2000,
        temperature: 2500,
        heat_flow: 2600,
    }
}

/// Where on its skin, and which way out of it, a finger touches in a grasp.
fn skin(finger: u8, grasp: usize) -> (Point, Point) {
    if finger == ELECTRODES {
        return (Point::new(-0.0028, 0.0, -RADIUS), Point::new(0.0, 0.0, -1.0));
    }
    let around = 0.4 * f64::from(finger) + 0.3 * grasp as f64;
    let outward = Point::new(0.0, around.sin(), -around.cos());
    (outward * RADIUS + Point::new(-0.002 * (grasp % 4) as f64, 0.0, 0.0), outward)
}

/// A box of 100 × 60 × 40 mm that turns in the hand: its pose, and a place on one of its faces for
/// every finger with the normal there.
fn touched(pose: &Pose, finger: u8, grasp: usize) -> (Point, Point) {
    const HALF: [f64; 3] = [0.05, 0.03, 0.02];
    let face = (grasp + 3 * usize::from(finger)) % 6;
    let (axis, sign) = (face / 2, [1.0, -1.0][face % 2]);
    let mut normal = Point::zeros();
    normal[axis] = sign;
    let point = Point::from_fn(|i, _| {
        let across = (1.7 * f64::from(finger) + 2.3 * grasp as f64 + i as f64).sin() * 0.7;
        HALF[i] * if i == axis { sign } else { across }
    });
    ((pose * nalgebra::Point3::from(point)).coords, pose.rotation * normal)
}

/// Where the fingertip is that touches the world at `point` with `place` of its skin.
fn fingertip(point: &Point, normal: &Point, (place, outward): &(Point, Point)) -> Pose {
    let turn = Rotation3::rotation_between(outward, &-normal)
        .unwrap_or_else(|| Rotation3::new(Point::x() * std::f64::consts::PI));
    Pose::from_parts(Translation3::from(point - turn * place), UnitQuaternion::from(turn))
}

/// A session with a board whose fingers are set up and tared.
fn ready<L: Link>(link: L) -> Session<Spatial, L> {
    let mut session = Session::<Spatial, _>::open(link, Patience::default()).unwrap();
    assert_eq!(session.hello().unwrap().fingers, FINGERS);
    let settings = Settings { translation: 2e-3, rotation: 0.05, seed: 3, ..Settings::DEFAULT };
    session.configure(settings).unwrap();
    for finger in 0..FINGERS {
        let parts = if finger == ELECTRODES { electrodes() } else { gauges() };
        session.set_up_sensor(finger, &parts).unwrap();
        let words = match finger {
            ELECTRODES => electrode_words(None),
            _ => Words::Gauges([100, -200, 300, -400, 500, -600]),
        };
        let show = |time: u32| WordsFrame {
            finger,
            time: Clock(1000 * time),
            repeats: 0,
            words,
            fault: Fault::None,
        };
        for time in 0..u32::from(TARE) {
            assert_eq!(session.show(show(time)).unwrap(), None);
            let state = session.finger(finger).unwrap().state;
            assert_eq!(state, FingerState::Free(NoContact::Taring));
        }
        assert_eq!(session.show(show(100)).unwrap(), None);
        let state = session.finger(finger).unwrap().state;
        assert_eq!(state, FingerState::Free(NoContact::TooLight));
    }
    session
}

/// Adds what the gauges read at rest.
fn biased(words: Words) -> Words {
    match words {
        Words::Gauges(w) => {
            let bias = [100, -200, 300, -400, 500, -600];
            Words::Gauges(std::array::from_fn(|k| w[k] + bias[k]))
        }
        other => other,
    }
}

/// Everything a board said of grasps, as bytes.
struct Told {
    contacts: Vec<Vec<u8>>,
    estimates: Vec<Vec<u8>>,
    stack: (u32, u32),
}

fn bytes(message: Report<Spatial>) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode(&Frame { sequence: 0, time: Clock(0), message }, &mut buffer).unwrap().to_vec()
}

/// Twelve grasps of which the host says where the fingertips are and what their sensors read.
fn follow<L: Link>(link: L) -> Told {
    let mut session = ready(link);
    let step = Pose::new(Point::new(0.002, -0.001, 0.001), Point::new(0.03, 0.05, -0.04));
    let (mut pose, mut gauge) = (Pose::identity(), None);
    let mut told = Told { contacts: Vec::new(), estimates: Vec::new(), stack: (0, 0) };
    for grasp in 0..12 {
        for finger in 0..FINGERS {
            let (point, normal) = touched(&pose, finger, grasp);
            let place = skin(finger, grasp);
            let tip = fingertip(&point, &normal, &place);
            session.place_fingertip(finger, &Spatial::pose(&tip)).unwrap();
            let words = match finger {
                ELECTRODES => electrode_words(Some(&place.0)),
                _ => biased(gauge_words(&place.0, &(place.1 * -1.5))),
            };
            let mut felt = None;
            // Twice, as the window holds two readings of which the first is of the grasp before.
            for reading in 0..2 {
                let time = Clock(1_000_000 * (grasp as u32 + 1) + 1000 * reading);
                let frame = WordsFrame { finger, time, repeats: 0, words, fault: Fault::None };
                felt = session.show(frame).unwrap();
            }
            let felt = felt.unwrap_or_else(|| panic!("{finger}: {:?}", session.finger(finger)));
            let contact = felt.contact.contact(&Settings::DEFAULT);
            let error = (Spatial::point(&contact.point) - point).norm();
            let tilt = Spatial::point(&contact.normal.unwrap()).angle(&normal);
            let (most, tilted) = if finger == ELECTRODES { (1e-3, 0.1) } else { (1e-4, 0.01) };
            assert!(error < most && tilt < tilted, "finger {finger}: {error} m, {tilt} rad");
            told.contacts.push(bytes(Report::Contact(felt.contact)));
        }
        let motion = (grasp > 0).then(|| Spatial::pose(&step));
        let outcome = session.grasp(motion.as_ref(), &[], &[]).unwrap();
        assert_eq!((outcome.estimate.contacts, outcome.felt.len()), (5, 5));
        told.contacts.extend(outcome.felt.into_iter().map(|f| bytes(Report::Felt(f))));
        told.estimates.push(bytes(Report::Estimate(outcome.estimate)));
        told.stack = (outcome.health.peak_stack, outcome.health.stack);
        let estimated = Spatial::isometry(&outcome.estimate.pose().unwrap());
        // The object frame is fixed by the first grasp.
        let gauge = *gauge.get_or_insert(pose.inverse() * estimated);
        let error = (pose * gauge).inverse() * estimated;
        let (away, turned) = (error.translation.vector.norm(), error.rotation.angle());
        assert!(away < 3e-3 && turned < 0.05, "grasp {grasp}: {away} m, {turned} rad");
        pose = step * pose;
    }
    // What is felt is part of one grasp only.
    let empty = session.grasp(None, &[], &[]).unwrap();
    assert_eq!((empty.estimate.contacts, empty.felt.len()), (0, 0));
    assert_eq!(session.received().damaged(), 0);
    told
}

#[test]
fn words_become_poses_on_a_virtual_board() {
    follow(virtual_board::start_sensing());
}

#[test]
fn words_become_poses_in_qemu_bit_for_bit() {
    let Some(board) = emulated(firmware::SENSING) else { return };
    let there = follow(board);
    let here = follow(virtual_board::start_sensing());
    assert_eq!(there.contacts, here.contacts);
    assert_eq!(there.estimates, here.estimates);
    let elf = firmware::build(firmware::SENSING, Machine::Stm32f405).unwrap();
    let footprint = firmware::footprint(&elf).unwrap();
    eprintln!("{footprint:?}, deepest stack {} of {} B", there.stack.0, there.stack.1);
    assert!(footprint.initialised < 64, "{footprint:?}");
    assert!(footprint.flash < 256 << 10 && footprint.ram < 96 << 10, "{footprint:?}");
    assert!(there.stack.0 < 8 << 10);
}

/// What is refused, and that a sensor that is refused its settings keeps those it has.
fn refuses<L: Link>(link: L) {
    let mut session = ready(link);
    let refusal = |outcome: Result<(), SessionError>| match outcome {
        Err(SessionError::Refused { refusal, .. }) => refusal,
        other => panic!("{other:?}"),
    };
    // Two components that the gauges cannot tell apart.
    let mut singular = gauges();
    let Some(SensorPart::Row { numbers, .. }) = singular.get(1).copied() else { panic!() };
    singular[2] = SensorPart::Row { row: 1, numbers };
    assert_eq!(refusal(session.set_up_sensor(0, &singular)), Refusal::Singular);
    // No calibration at all.
    assert_eq!(refusal(session.set_up_sensor(0, &[SensorPart::Gauges])), Refusal::Singular);
    let mut flat = gauges();
    flat.push(SensorPart::Skin(Skin::Sphere(0.0)));
    assert_eq!(refusal(session.set_up_sensor(0, &flat)), Refusal::Sensor);
    let mut infinite = gauges();
    infinite.push(SensorPart::Noise([f32::INFINITY; 6]));
    assert_eq!(refusal(session.set_up_sensor(0, &infinite)), Refusal::Sensor);
    // A part of another kind, or of nothing that was begun.
    let drift = SensorPart::Electrode { number: 0, position: [0.0; 3] };
    assert_eq!(refusal(session.set_up_sensor(0, &[SensorPart::Gauges, drift])), Refusal::Part);
    assert_eq!(refusal(session.set_up_sensor(1, &[])), Refusal::Part);
    assert_eq!(refusal(session.tare(FINGERS)), Refusal::NoSuch);
    let nowhere = Spatial::pose(&Pose::translation(f64::NAN, 0.0, 0.0));
    assert_eq!(refusal(session.place_fingertip(0, &nowhere)), Refusal::Pose);
    assert_eq!(refusal(session.stream(4999)), Refusal::Rate);
    // The sensor is as it was: tared and calibrated.
    let words = biased(gauge_words(&(Point::x() * RADIUS), &(Point::x() * -2.0)));
    let show = |time, fault| WordsFrame { finger: 0, time: Clock(time), repeats: 0, words, fault };
    session.place_fingertip(0, &Spatial::pose(&Pose::identity())).unwrap();
    let felt = session.show(show(5_000_000, Fault::None)).unwrap().expect("a contact");
    let contact = felt.contact.contact(&Settings::DEFAULT);
    assert!((Spatial::point(&contact.point) - Point::x() * RADIUS).norm() < 1e-5);
    let FingerState::Touching { force, slip } = session.finger(0).unwrap().state else { panic!() };
    assert!((f64::from(force[0]) + 2.0).abs() < 1e-3 && slip.unwrap() < 1e-3, "{force:?}");
    // A sensor that fails says how, and is well again when it is.
    let faults = [
        (Fault::Noise, SensorFault::Crc),
        (Fault::Missing, SensorFault::Missing),
        (Fault::Stuck, SensorFault::Timeout),
    ];
    for (fault, want) in faults {
        assert_eq!(session.show(show(6_000_000, fault)).unwrap(), None);
        assert_eq!(session.finger(0).unwrap().state, FingerState::Fault(want));
    }
    assert_eq!(session.finger(0).unwrap().faults, 3);
    assert!(session.show(show(7_000_000, Fault::None)).unwrap().is_some());
}

#[test]
fn what_cannot_be_is_refused_by_a_virtual_board() {
    refuses(virtual_board::start_sensing());
}

/// A line that flips a bit of the next frame from the board when it is told to.
struct Flips<'a> {
    line: Box<dyn Link>,
    next: &'a Cell<bool>,
}

impl Link for Flips<'_> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.line.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.line.receive(bytes, timeout)?;
        // Neither a mark between frames nor one that becomes such.
        if let Some(byte) = bytes[..count].iter_mut().find(|byte| **byte > 1)
            && self.next.replace(false)
        {
            *byte ^= 1;
        }
        Ok(count)
    }
}

/// A damaged frame costs time and nothing else, even where nothing tells that it is missing: the contact that
/// answers words, and what was felt of a grasp.
#[test]
fn what_was_felt_is_heard_whatever_frame_is_damaged() {
    let next = Cell::new(false);
    let line: Box<dyn Link> = Box::new(virtual_board::start_sensing());
    let mut session = ready(Flips { line, next: &next });
    let words = biased(gauge_words(&(Point::x() * RADIUS), &(Point::x() * -2.0)));
    for finger in [0, 1] {
        session.place_fingertip(finger, &Spatial::pose(&Pose::identity())).unwrap();
        let time = Clock(1_000_000);
        next.set(true);
        let frame = WordsFrame { finger, time, repeats: 0, words, fault: Fault::None };
        let felt = session.show(frame).unwrap().expect("a contact");
        assert_eq!((felt.contact.finger, next.get()), (finger, false));
    }
    next.set(true);
    let outcome = session.grasp(None, &[], &[]).unwrap();
    assert_eq!((outcome.felt.len(), outcome.estimate.contacts), (2, 2));
    assert_eq!((session.repeated(), session.received().damaged()), (3, 3));
}

/// A second of all five fingers at a thousand samples each, streamed at 200 Hz.
fn streams<L: Link>(link: L) {
    let mut session = ready(link);
    let words = biased(gauge_words(&(Point::x() * RADIUS), &(Point::x() * -2.0)));
    for finger in 0..FINGERS {
        session.place_fingertip(finger, &Spatial::pose(&Pose::identity())).unwrap();
        session.set_up_sensor(finger, &gauges()).unwrap();
        let rest = Words::Gauges([100, -200, 300, -400, 500, -600]);
        for time in 0..=u32::from(TARE) {
            let time = Clock(1000 * time);
            let frame = WordsFrame { finger, time, repeats: 0, words: rest, fault: Fault::None };
            session.show(frame).unwrap();
        }
    }
    let before = session.health().unwrap();
    session.stream(5000).unwrap();
    for finger in 0..FINGERS {
        let time = Clock(1_000_000);
        let frame = WordsFrame { finger, time, repeats: 999, words, fault: Fault::None };
        session.show(frame).unwrap().expect("a contact");
    }
    let start = std::time::Instant::now();
    let mut contacts = session.contacts();
    while contacts.len() < 1005 && start.elapsed() < Duration::from_secs(60) {
        session.listen(Duration::from_millis(20)).unwrap();
        contacts.extend(session.contacts());
    }
    for finger in 0..FINGERS {
        let times: Vec<u32> =
            contacts.iter().filter(|c| c.contact.finger == finger).map(|c| c.time).collect();
        // The answer to the words, then every fifth of the 999 samples that follow.
        let streamed = (0..200).map(|k| 1_001_000 + 5000 * k);
        let want: Vec<u32> = [1_000_000].into_iter().chain(streamed).collect();
        assert_eq!(times, want, "finger {finger}");
    }
    let received = session.received();
    assert_eq!((received.lost, received.damaged()), (0, 0), "{received:?}");
    // It was still listening.
    session.stream(0).unwrap();
    let health = session.health().unwrap();
    // Nothing is damaged while streaming; a greeting may be, by a board that begins to listen.
    assert_eq!((health.overruns, health.received.damaged()), (0, before.received.damaged()));
    assert!(before.received.damaged() <= 1, "{before:?}");
}

#[test]
fn a_virtual_board_streams_without_loss() {
    streams(virtual_board::start_sensing());
}

#[test]
fn firmware_refuses_and_streams_as_a_virtual_board() {
    let Some(board) = emulated(firmware::SENSING) else { return };
    refuses(board);
    let Some(board) = emulated(firmware::SENSING) else { return };
    streams(board);
}

/// An emulated SPI without a sensor: the driver ends in time and says so, and the board goes on.
#[test]
fn firmware_for_real_sensors_says_that_there_are_none() {
    let Some(board) = emulated(firmware::GAUGES) else { return };
    let mut session = Session::<Spatial, _>::open(board, Patience::default()).unwrap();
    assert_eq!(session.hello().unwrap().fingers, FINGERS);
    session.set_up_sensor(0, &gauges()).unwrap();
    let start = std::time::Instant::now();
    while session.finger(4).unwrap().faults < 3 && start.elapsed() < Duration::from_secs(30) {
        session.listen(Duration::from_millis(20)).unwrap();
    }
    let finger = session.finger(4).unwrap();
    assert_eq!(finger.state, FingerState::Fault(SensorFault::Missing));
    assert!(finger.faults >= 3 && finger.readings == 0, "{finger:?}");
    let words = WordsFrame {
        finger: 0,
        time: Clock(0),
        repeats: 0,
        words: Words::Gauges([0; 6]),
        fault: Fault::None,
    };
    let refused = session.show(words).unwrap_err();
    assert!(
        matches!(refused, SessionError::Refused { refusal: Refusal::NotScripted, .. }),
        "{refused}"
    );
}
