//! Every message: its bytes, its length, and that it comes back as it was.

use std::format;
use std::string::String;
use std::vec::Vec;

use super::super::super::*;
use super::{decode_all, wire};
use crate::contact::{Contact, FreePoint};
use crate::driver::emulated::Fault;
use crate::explore::{Candidate, CandidateError, Criterion, Stroke};
use crate::matrix::{Coordinates, Matrix, Vector};
use crate::sensing::NoContact;
use crate::space::{Planar, PlanarPose, Pose, Spatial, SpatialPose};
use crate::track::{Estimate, Mode, Modes, Observability, Status};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

pub(super) fn contact() -> Contact<Spatial> {
    Contact {
        point: Vector([1.04, -1.04, 1.04]),
        normal: Some(Vector([0.36, -0.48, 0.8])),
        point_deviation: 1e-3,
        normal_deviation: 0.3,
        finger: 4,
    }
}

fn planar_contact() -> Contact<Planar> {
    Contact {
        point: Vector([-1.04, 1.04]),
        normal: Some(Vector([0.6, -0.8])),
        point_deviation: 1e-3,
        normal_deviation: 0.3,
        finger: 4,
    }
}

fn spatial_estimate(grasp: u32) -> Estimate<Spatial> {
    let mut covariance = Matrix::<6>([[0.0; 6]; 6]);
    for i in 0..6 {
        for j in 0..6 {
            covariance.0[i][j] = if i == j { 1e-6 * (i + 1) as f32 } else { 2e-7 };
        }
    }
    Estimate {
        grasp,
        pose: SpatialPose::new(Vector([0.1, -0.2, 0.3]), [0.1, 0.2, -0.3, 0.9]),
        covariance,
        status: Status::Tracking,
        modes: Modes::NONE,
        effective_particles: 16_383.0,
        observability: Observability {
            eigenvalues: Vector([0.001, 0.1, 0.3, 0.5, 0.9, 1.9]),
            ..Observability::NONE
        },
        contacts: 5,
        rejected: 1,
        dropped: 2,
        corrected: true,
        resampled: true,
    }
}

fn planar_estimate(grasp: u32) -> Estimate<Planar> {
    Estimate {
        grasp,
        pose: PlanarPose::new(Vector([0.1, -0.2]), 2.5),
        covariance: Matrix([[4e-6, 1e-6, 0.0], [1e-6, 1e-6, -1e-7], [0.0, -1e-7, 1e-4]]),
        status: Status::Tracking,
        modes: Modes::NONE,
        effective_particles: 16_383.0,
        observability: Observability {
            eigenvalues: Vector([0.001, 0.1, 1.9]),
            ..Observability::NONE
        },
        contacts: 5,
        rejected: 0,
        dropped: 0,
        corrected: true,
        resampled: false,
    }
}

fn face() -> FaceSummary<Spatial> {
    FaceSummary {
        normal: Vector([0.0, 0.6, 0.8]),
        centroid: Vector([0.01, 0.03, 0.04]),
        deviation: 1e-4,
        tilt: 1e-3,
        contacts: 12,
    }
}

pub(super) const HELLO: Hello = Hello {
    protocol: PROTOCOL,
    firmware: [0, 1, 0],
    board: BoardKind::Stm32f405,
    tracker: TrackerKind::Hypotheses,
    dimension: 3,
    contacts: 16,
    map: 64,
    particles: 300,
    fingers: 5,
};

fn health() -> Health {
    Health {
        received: Counters {
            frames: 1,
            oversize: 2,
            cobs: 3,
            crc: 4,
            malformed: 5,
            version: 6,
            lost: 7,
            doubled: 8,
            late: 9,
        },
        overruns: 10,
        refused: 11,
        overfull: 12,
        empty: 13,
        grasps: 14,
        peak_stack: 7_000,
        stack: 40_000,
        update: 150_000,
        worst_update: 200_000,
    }
}

/// Every message once, with the bytes it has on the wire.
fn golden() -> Vec<(&'static str, Vec<u8>)> {
    let settings = Settings { seed: 300, ..Settings::DEFAULT };
    let motion = SpatialPose::new(Vector([0.01, 0.0, -0.02]), [0.0, 0.0, 0.6, 0.8]);
    let mut modes = Modes::one(motion);
    modes.push(Mode { pose: SpatialPose::IDENTITY, weight: 0.25 });
    let mode = ModeFrame::new(&modes, 1).unwrap();
    let free = FreePoint { point: Vector([0.0, 0.000_064, -0.000_001]), finger: 1 };
    let planar_free = FreePoint { point: Vector([0.001, -0.001]), finger: 0 };
    let unusual = ContactFrame::new(&contact(), 0.1);
    let usual = ContactFrame::new(&planar_contact(), 0.3);
    let bare = ContactFrame::new(&Contact { normal: None, ..contact() }, 0.1);
    let spread = spatial_estimate(0).covariance;
    type C = Command<Spatial>;
    type R = Report<Spatial>;
    std::vec![
        ("hello command", wire(0, 0, C::Hello { protocol: PROTOCOL })),
        ("ping", wire(1, 1, C::Ping)),
        ("configure", wire(2, 0x0102_0304, C::Configure(settings))),
        ("reset", wire(3, u32::MAX, C::Reset)),
        ("motion 3d", wire(4, 4, C::Motion(MotionFrame::new(&motion)))),
        (
            "motion 2d",
            wire(4, 4, Command::<Planar>::Motion(MotionFrame::new(&PlanarPose::IDENTITY))),
        ),
        ("contact 3d", wire(5, u32::MAX, C::Contact(unusual))),
        ("contact 3d without normal", wire(5, 5, C::Contact(bare))),
        ("contact 2d", wire(5, u32::MAX, Command::<Planar>::Contact(usual))),
        ("free 3d", wire(6, 6, C::Free(FreeFrame::new(&free)))),
        ("free 2d", wire(6, 6, Command::<Planar>::Free(FreeFrame::new(&planar_free)))),
        ("commit", wire(7, 7, C::Commit)),
        ("query estimate", wire(8, 8, C::Query(Topic::Estimate))),
        ("query health", wire(8, 8, C::Query(Topic::Health))),
        ("query mode", wire(8, 8, C::Query(Topic::Mode(1)))),
        ("query face", wire(8, 8, C::Query(Topic::Face(15)))),
        ("hello report", wire(9, 9, R::Hello(HELLO))),
        ("reply", wire(10, 10, R::Reply(Reply { to: 5, refusal: None }))),
        ("refusal", wire(11, 11, R::Reply(Reply { to: 5, refusal: Some(Refusal::Full) }))),
        (
            "estimate 3d",
            wire(12, u32::MAX, R::Estimate(EstimateFrame::new(&spatial_estimate(2_000_000)))),
        ),
        (
            "estimate 2d",
            wire(
                12,
                u32::MAX,
                Report::<Planar>::Estimate(EstimateFrame::new(&planar_estimate(2_000_000))),
            ),
        ),
        ("health", wire(13, 13, R::Health(health()))),
        ("mode 3d", wire(14, 14, R::Mode(mode))),
        ("face 3d", wire(15, 15, R::Face(FaceFrame::new(&face(), 3, 6)))),
        ("believe 3d", wire(16, 16, C::Believe(BeliefFrame::new(&motion, &spread)))),
        (
            "believe 2d",
            wire(
                16,
                16,
                Command::<Planar>::Believe(BeliefFrame::new(
                    &PlanarPose::new(Vector([0.1, -0.2]), 2.5),
                    &planar_estimate(0).covariance,
                )),
            ),
        ),
        ("face command 3d", wire(17, 17, C::Face(FaceFrame::new(&face(), 3, 6)))),
        ("query finger", wire(8, 8, C::Query(Topic::Finger(4)))),
        ("fingertip pose 3d", wire(16, 16, C::FingertipPose(FingertipFrame::new(2, &motion)))),
        (
            "fingertip pose 2d",
            wire(
                16,
                16,
                Command::<Planar>::FingertipPose(FingertipFrame::new(1, &PlanarPose::IDENTITY)),
            ),
        ),
        ("sensor gauges", sensor(SensorPart::Gauges)),
        ("sensor electrodes", sensor(SensorPart::Electrodes)),
        (
            "sensor row",
            sensor(SensorPart::Row { row: 5, numbers: [1.0, -2.0, 0.5, 0.25, -0.125, 1e-9] }),
        ),
        ("sensor range", sensor(SensorPart::Range { least: -0x80_0000, most: 0x7f_ffff })),
        ("sensor skin", sensor(SensorPart::Skin(QUADRIC))),
        ("sensor edge", sensor(SensorPart::Edge { normal: [0.0, 0.0, -1.0], offset: -2e-3 })),
        ("sensor sampling", sensor(SAMPLING)),
        ("sensor electrode", sensor(SensorPart::Electrode { number: 18, position: [1e-3; 3] })),
        ("sensor use", sensor(SensorPart::Use)),
        ("tare", wire(18, 18, C::Tare { finger: 3 })),
        ("stream", wire(19, 19, C::Stream { period: 5000 })),
        (
            "words of gauges",
            words(Words::Gauges([0x7f_ffff, -0x80_0000, 1, -1, 0, 64]), Fault::None),
        ),
        (
            "words of electrodes",
            words(
                Words::Electrodes {
                    electrodes: core::array::from_fn(|k| 2880 + k as u16),
                    pressure: 1500,
                    vibration: 2000,
                    temperature: 2500,
                    heat_flow: 4095,
                },
                Fault::Stuck,
            ),
        ),
        ("felt while touching 3d", wire(20, u32::MAX, R::Contact(unusual))),
        ("felt while touching 2d", wire(20, u32::MAX, Report::<Planar>::Contact(usual)),),
        ("felt by a grasp 3d", wire(21, 21, R::Felt(unusual))),
        ("finger waiting", finger(FingerState::Waiting)),
        ("finger at fault", finger(FingerState::Fault(SensorFault::Crc))),
        ("finger saturated", finger(FingerState::Free(NoContact::Saturated { channel: 5 }))),
        (
            "finger touching",
            finger(FingerState::Touching { force: [0.5, -0.25, 2.0], slip: Some(0.125) }),
        ),
        (
            "singular matrix",
            wire(11, 11, R::Reply(Reply { to: 5, refusal: Some(Refusal::Singular) })),
        ),
        ("consider 3d", consider(&candidate::<Spatial>(&motion))),
        ("consider 2d", consider(&candidate::<Planar>(&PlanarPose::new(Vector([0.1, -0.2]), 2.5))),),
        (
            "query best candidate",
            wire(8, 8, C::Query(Topic::BestCandidate(Criterion::VarianceSum))),
        ),
        ("choice", wire(23, 23, R::Choice(CHOICE))),
        (
            "no candidate",
            wire(11, 11, R::Reply(Reply { to: 5, refusal: Some(Refusal::NoCandidate) })),
        ),
    ]
}

const CHOICE: ChoiceFrame = ChoiceFrame {
    number: 9,
    considered: 10,
    contacts: 4,
    criterion: Criterion::Information,
    gain: 3.25,
};

/// A hand all of whose fingers close from almost a metre away.
fn candidate<S: WireSpace>(hand: &S::Pose) -> Candidate<S> {
    let mut candidate = Candidate::new(*hand);
    for (finger, stroke) in candidate.strokes.iter_mut().enumerate() {
        let sign = if finger == 4 { -1.0 } else { 1.0 };
        let mut direction = S::Vector::ZERO;
        (direction[0], direction[1]) = (0.6 * sign, -0.8);
        let start = S::Vector::from_fn(|i| if i == 0 { 0.1 * finger as f32 } else { sign * 1.04 });
        *stroke = Some(Stroke { start, direction, travel: 1.9 });
    }
    candidate
}

fn consider<S: WireSpace>(candidate: &Candidate<S>) -> Vec<u8> {
    let frame = CandidateFrame::new(9, candidate).unwrap();
    wire(24, u32::MAX, Command::<S>::Consider(frame))
}

const QUADRIC: Skin = Skin::Quadric {
    matrix: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    linear: [7.0, 8.0, 9.0],
    constant: 10.0,
};

const SAMPLING: SensorPart = SensorPart::Sampling { window: 8, gap: 20_000, tare: 256, spread: -1 };

fn sensor(part: SensorPart) -> Vec<u8> {
    wire(17, 17, Command::<Spatial>::Sensor(SensorFrame { finger: 4, part }))
}

fn words(words: Words, fault: Fault) -> Vec<u8> {
    let time = Clock(0x0102_0304);
    let frame = WordsFrame { finger: 4, time, repeats: 999, words, fault };
    wire(18, 18, Command::<Spatial>::Words(frame))
}

fn finger(state: FingerState) -> Vec<u8> {
    let frame = FingerFrame { finger: 4, state, readings: 1000, contacts: 200, faults: 3 };
    wire(22, 22, Report::<Spatial>::Finger(frame))
}

#[test]
fn bytes_do_not_change_by_accident() {
    let now: String = golden().iter().map(|(name, b)| format!("{name}: {}\n", hex(b))).collect();
    assert_eq!(now, include_str!("golden.txt"), "the format changed: raise PROTOCOL\n{now}");
}

#[test]
fn frames_stay_within_budget() {
    let length = |name| golden().iter().find(|(n, _)| *n == name).unwrap().1.len();
    assert!(length("contact 2d") <= 23);
    assert!(length("contact 3d") <= 28);
    assert!(length("felt while touching 2d") <= 23);
    assert!(length("felt while touching 3d") <= 28);
    assert!(length("estimate 2d") <= 63);
    assert!(length("estimate 3d") <= 127);
    // The largest messages there can be still fit.
    let mut worst = health();
    let u = u32::MAX;
    worst.received = Counters {
        frames: u,
        oversize: u,
        cobs: u,
        crc: u,
        malformed: u,
        version: u,
        lost: u,
        doubled: u,
        late: u,
    };
    worst = Health {
        overruns: u,
        refused: u,
        overfull: u,
        empty: u,
        grasps: u,
        peak_stack: u,
        stack: u,
        update: u,
        worst_update: u,
        ..worst
    };
    assert!(wire(255, u, Report::<Spatial>::Health(worst)).len() <= MAX_FRAME);
    // Of five fingers 200 times a second, ten bits a byte, on a line of 921 600 baud: less than a
    // third, which leaves the rest to answers. The sixth finger's bits would still fit thrice.
    let bits = 5 * 200 * length("felt while touching 3d") * 10;
    assert!(bits <= 280_000 && bits * 3 < 921_600, "{bits} bits a second");
    let most = SensorPart::Sampling { window: 255, gap: u, tare: u16::MAX, spread: i32::MIN };
    assert!(sensor(most).len() <= MAX_FRAME);
    let electrodes = [u16::MAX; 19];
    let [pressure, vibration, temperature, heat_flow] = [u16::MAX; 4];
    let longest = Words::Electrodes { electrodes, pressure, vibration, temperature, heat_flow };
    assert!(words(longest, Fault::Stuck).len() <= MAX_FRAME);
    assert!(length("consider 2d") <= 100 && length("consider 3d") <= 130);
    assert!(length("choice") <= 24);
    let mut far = candidate::<Spatial>(&SpatialPose::IDENTITY);
    for stroke in far.strokes.iter_mut().flatten() {
        (stroke.start, stroke.travel) = (Vector([-134.0; 3]), 260.0);
    }
    assert!(consider(&far).len() <= MAX_FRAME);
    let mut estimate = spatial_estimate(u);
    estimate.effective_particles = 1e9;
    assert!(
        wire(255, u, Report::<Spatial>::Estimate(EstimateFrame::new(&estimate))).len() <= MAX_FRAME
    );
}

#[test]
fn every_message_comes_back() {
    let bytes: Vec<u8> = golden()
        .into_iter()
        .filter(|(n, _)| ["estimate 3d", "hello report", "health", "refusal", "reply"].contains(n))
        .flat_map(|(_, b)| b)
        .collect();
    let (_, frames) = decode_all::<Report<Spatial>>(&bytes);
    let messages: Vec<_> = frames.into_iter().map(|f| f.unwrap().frame.message).collect();
    assert_eq!(messages[0], Report::Hello(HELLO));
    assert_eq!(messages[2], Report::Reply(Reply { to: 5, refusal: Some(Refusal::Full) }));
    assert_eq!(messages[4], Report::Health(health()));
    let Report::Estimate(estimate) = messages[3] else { panic!("{:?}", messages[3]) };
    let sent = spatial_estimate(2_000_000);
    let error = sent.pose.local(&estimate.pose().unwrap());
    assert!(error.norm() < 1e-6, "{error:?}");
    assert_eq!((estimate.grasp, estimate.effective_particles), (2_000_000, 16_383));
    assert!(estimate.corrected() && estimate.resampled());
    for i in 0..6 {
        for j in 0..6 {
            let (a, b) = (estimate.covariance().0[i][j], sent.covariance.0[i][j]);
            assert!((a - b).abs() < 5e-10, "{i} {j} {a} {b}");
        }
        assert!((estimate.eigenvalues()[i] - sent.observability.eigenvalues[i]).abs() < 1e-4);
    }
    assert_eq!(estimate.weakest(), Vector([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn beliefs_come_back() {
    let sent = spatial_estimate(0);
    let frame = BeliefFrame::<Spatial>::new(&sent.pose, &sent.covariance);
    let (pose, covariance) = frame.belief().unwrap();
    assert!(sent.pose.local(&pose).norm() < 1e-6);
    for i in 0..6 {
        for j in 0..6 {
            assert!((covariance.0[i][j] - sent.covariance.0[i][j]).abs() < 5e-10);
        }
    }
    let mut bad = frame;
    bad.deviations[3] = f32::NAN;
    assert!(bad.belief().is_none());
    bad = frame;
    bad.pose[0] = f32::INFINITY;
    assert!(bad.belief().is_none());
}

#[test]
fn sensor_messages_come_back() {
    let heard = |bytes: Vec<u8>| match decode_all::<Command<Spatial>>(&bytes).1[..] {
        [Ok(received)] => received.frame.message,
        ref other => panic!("{other:?}"),
    };
    let frame = SensorFrame { finger: 4, part: SensorPart::Skin(QUADRIC) };
    assert_eq!(heard(sensor(frame.part)), Command::Sensor(frame));
    assert_eq!(Skin::from(crate::sensing::fingertip::Shape::from(QUADRIC)), QUADRIC);
    for skin in [Skin::Sphere(0.01), Skin::Ellipsoid([0.01, 0.02, 0.03])] {
        assert_eq!(Skin::from(crate::sensing::fingertip::Shape::from(skin)), skin);
    }
    let gauges = Words::Gauges([0x7f_ffff, -0x80_0000, 1, -1, 0, 64]);
    let Command::Words(frame) = heard(words(gauges, Fault::Noise)) else { panic!() };
    assert_eq!((frame.words, frame.fault, frame.repeats), (gauges, Fault::Noise, 999));
    let pose = SpatialPose::new(Vector([0.01, 0.0, -0.02]), [0.0, 0.0, 0.6, 0.8]);
    let placed = FingertipFrame::<Spatial>::new(2, &pose);
    assert_eq!(placed.pose(), Some(pose));
    let state = FingerState::Touching { force: [0.5, -0.25, 2.0], slip: None };
    let (_, reports) = decode_all::<Report<Spatial>>(&finger(state));
    let Report::Finger(frame) = reports[0].unwrap().frame.message else { panic!() };
    assert_eq!((frame.state, frame.contacts), (state, 200));
}

#[test]
fn candidates_come_back() {
    let hand = SpatialPose::new(Vector([0.01, 0.0, -0.02]), [0.0, 0.0, 0.6, 0.8]);
    let mut sent = candidate::<Spatial>(&hand);
    sent.strokes[2] = None;
    let frame = CandidateFrame::new(3, &sent).unwrap();
    let back = frame.candidate().unwrap();
    assert_eq!((frame.number, back.hand), (3, hand));
    for (there, here) in back.strokes.iter().zip(&sent.strokes) {
        let (Some(there), Some(here)) = (there, here) else {
            assert!(there.is_none() && here.is_none());
            continue;
        };
        assert!((there.start - here.start).norm() < 2e-6);
        assert!((there.direction - here.direction).norm() < 1e-4);
        assert!((there.travel - here.travel).abs() < 1e-6);
    }
    let (_, reports) = decode_all::<Report<Planar>>(&wire(1, 1, Report::<Planar>::Choice(CHOICE)));
    assert_eq!(reports[0].unwrap().frame.message, Report::Choice(CHOICE));

    // What cannot be a grasp is told on either side of the line.
    let mut bad = sent;
    bad.strokes = [None; 5];
    assert_eq!(CandidateFrame::new(0, &bad), Err(CandidateError::Empty));
    type Case = (fn(&mut Stroke<Spatial>), CandidateError);
    let cases: [Case; 6] = [
        (|s| s.start[1] = f32::NAN, CandidateError::Start),
        (|s| s.direction = Vector([0.0; 3]), CandidateError::Direction),
        (|s| s.direction[0] = f32::INFINITY, CandidateError::Direction),
        (|s| s.travel = 0.0, CandidateError::Travel),
        (|s| s.travel = f32::NAN, CandidateError::Travel),
        // Nothing on the wire, where lengths are whole micrometres.
        (|s| s.travel = 1e-7, CandidateError::Travel),
    ];
    for (spoil, error) in cases {
        let mut bad = sent;
        bad.strokes[1].iter_mut().for_each(spoil);
        assert_eq!(CandidateFrame::new(0, &bad), Err(error));
    }
    let mut bad = frame;
    bad.hand[4] = f32::NAN;
    assert_eq!(bad.candidate(), Err(CandidateError::Hand));
    bad = frame;
    bad.strokes[0].iter_mut().for_each(|s| s.travel = 0);
    assert_eq!(bad.candidate(), Err(CandidateError::Travel));
}

/// Recordings of this version hold messages that were sent before some of today's existed.
#[test]
fn what_was_said_before_is_still_understood() {
    let before = include_str!("golden.txt").lines().take_while(|l| !l.starts_with("consider"));
    let mut count = 0;
    for line in before {
        let (name, hex) = line.split_once(": ").unwrap();
        let bytes: Vec<u8> = (0..hex.len() / 2)
            .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap())
            .collect();
        let heard = decode_all::<Command<Spatial>>(&bytes).1[0].is_ok()
            || decode_all::<Command<Planar>>(&bytes).1[0].is_ok()
            || decode_all::<Report<Spatial>>(&bytes).1[0].is_ok()
            || decode_all::<Report<Planar>>(&bytes).1[0].is_ok();
        assert!(heard, "{name}");
        count += 1;
    }
    assert!(count > 50);
}

#[test]
fn a_contact_keeps_its_own_noise_or_takes_the_usual() {
    let settings = Settings { normal: 0.1, point: 2e-3, ..Settings::DEFAULT };
    let own = ContactFrame::new(&contact(), 0.1).contact(&settings);
    assert!((own.normal_deviation - 0.3).abs() < 0.0022, "{}", own.normal_deviation);
    assert_eq!((own.point_deviation, own.finger), (2e-3, 4));
    assert!((own.normal.unwrap() - contact().normal.unwrap()).norm() < 1e-4);
    let usual = ContactFrame::new(&contact(), 0.3).contact(&settings);
    assert_eq!(usual.normal_deviation, 0.1);
    let small = Contact { normal_deviation: 1e-9, ..contact() };
    assert!(ContactFrame::new(&small, 0.1).contact(&settings).normal_deviation > 0.0);
}

#[test]
fn what_would_overflow_is_not_taken() {
    let mut settings = Settings { rotation: Settings::LARGEST, ..Settings::DEFAULT };
    assert!(settings.is_valid());
    for broken in [1e30, 1.1 * Settings::LARGEST, f32::INFINITY, f32::NAN, -1.0] {
        settings.translation = broken;
        assert!(!settings.is_valid(), "{broken}");
    }
    // Nor what no contact may have: all of them would be dropped.
    for (point, normal) in [(1e-10, 0.1), (1e-3, 1e-10), (0.0, 0.1), (1e-3, 0.0)] {
        assert!(!Settings { point, normal, ..Settings::DEFAULT }.is_valid());
    }
    assert!(Settings { point: 1e-9, normal: 1e-9, ..Settings::DEFAULT }.is_valid());
    assert!(MotionFrame::<Planar> { numbers: [9e3, 0.0, 0.7] }.motion().is_some());
    assert!(MotionFrame::<Planar> { numbers: [3e38, 3e38, 0.7] }.motion().is_none());
    let far = PlanarPose::new(Vector([3e38, 0.0]), 0.0);
    assert!(BeliefFrame::<Planar>::new(&far, &Matrix([[0.0; 3]; 3])).belief().is_none());
}

#[test]
fn what_is_not_known_is_not_said_to_be_certain() {
    let mut covariance = Matrix([[1e-4, 0.0, 0.0], [0.0, f32::NAN, 0.0], [0.0, 0.0, -1e-9]]);
    covariance.0[0][1] = f32::NAN;
    let frame = BeliefFrame::<Planar>::new(&PlanarPose::IDENTITY, &covariance);
    assert!((frame.deviations[0] - 0.01).abs() < 1e-8);
    assert!(frame.deviations[1].is_nan() && frame.deviations[2] == 0.0);
    let face = FaceSummary { deviation: f32::NAN, ..face() };
    assert_eq!(FaceFrame::new(&face, 0, 1).deviation, u16::MAX);
}
