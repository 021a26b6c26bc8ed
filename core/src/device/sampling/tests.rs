use std::collections::VecDeque;
use std::vec::Vec;

use super::*;
use crate::device::{Device, FINGERS, Fingers, SpatialHypotheses};
use crate::driver::emulated::Fault;
use crate::space::{Pose, Spatial, SpatialPose};
use crate::track::hypotheses::Hypotheses;
use crate::wire::{
    Clock, Command, Decoder, FingertipFrame, Frame, MAX_FRAME, PROTOCOL, Reply, Report,
    SensorFrame, SensorPart, Skin, encode,
};

/// A sensor whose driver says what the test wrote down; afterwards that nothing is new.
struct Told {
    starts: VecDeque<Result<(), DriverError>>,
    polls: VecDeque<Result<Option<i32>, DriverError>>,
    started: u32,
}

impl Sampler for Told {
    type Reading = i32;

    fn start(&mut self) -> Result<(), DriverError> {
        self.started += 1;
        self.starts.pop_front().unwrap_or(Ok(()))
    }

    fn poll(&mut self) -> Result<Option<i32>, DriverError> {
        self.polls.pop_front().unwrap_or(Ok(None))
    }

    fn sample(&mut self) -> Result<i32, DriverError> {
        Err(DriverError::Timeout)
    }
}

fn watched<const S: usize, const P: usize>(
    starts: [Result<(), DriverError>; S],
    polls: [Result<Option<i32>, DriverError>; P],
) -> Watched<Told> {
    Watched::new(Told { starts: starts.into(), polls: polls.into(), started: 0 })
}

#[test]
fn a_sensor_is_started_once_and_read() {
    let mut sensor = watched([], [Ok(Some(1)), Ok(None), Ok(Some(2))]);
    assert_eq!([10, 20, 30].map(|t| sensor.poll(t)), [Ok(Some(1)), Ok(None), Ok(Some(2))]);
    assert_eq!(sensor.sensor.started, 1);
}

#[test]
fn one_that_is_missing_is_tried_ten_times_a_second() {
    let missing = Err(DriverError::Missing);
    let mut sensor = watched([missing, missing], [Ok(Some(3))]);
    // The clock wraps meanwhile.
    let start = u32::MAX - 150_000;
    let mut said = Vec::new();
    for step in 0..25 {
        let now = start.wrapping_add(10_000 * step);
        match sensor.poll(now) {
            Ok(None) => {}
            other => said.push((step, other)),
        }
    }
    let gone = Err(DriverError::Missing);
    assert_eq!(said, [(0, gone), (10, gone), (20, Ok(Some(3)))]);
    assert_eq!(sensor.sensor.started, 3);
}

#[test]
fn noise_passes_but_a_restart_is_mended() {
    let crc = Err(DriverError::Crc { computed: 1, received: 2 });
    let polls = [crc, Ok(Some(1)), Err(DriverError::Restarted), Ok(Some(2))];
    let mut sensor = watched([], polls);
    assert_eq!((sensor.poll(0), sensor.poll(1000)), (crc, Ok(Some(1))));
    assert_eq!(sensor.poll(2000), Err(DriverError::Restarted));
    assert_eq!(sensor.poll(3000), Ok(None));
    assert_eq!(sensor.poll(102_000), Ok(Some(2)));
    assert_eq!(sensor.sensor.started, 2);
}

#[test]
fn one_that_is_stuck_is_noticed_without_waiting() {
    let mut sensor = watched([], []);
    assert_eq!(sensor.poll(0), Ok(None));
    assert_eq!(sensor.poll(49_999), Ok(None));
    assert_eq!(sensor.poll(50_000), Err(DriverError::Timeout));
    assert_eq!(sensor.poll(60_000), Ok(None));
}

/// A board without hardware whose clock the test turns.
#[derive(Default)]
struct Bare {
    clock: u32,
    sent: Vec<u8>,
}

impl Board for Bare {
    const KIND: BoardKind = BoardKind::Virtual;

    fn now(&mut self) -> u32 {
        self.clock
    }

    fn receive(&mut self, _: &mut [u8], _: bool) -> usize {
        0
    }

    fn send(&mut self, bytes: &[u8]) {
        self.sent.extend_from_slice(bytes);
    }

    fn vitals(&mut self) -> Vitals {
        Vitals::default()
    }
}

fn show(finger: u8, time: u32, repeats: u16, words: Words) -> WordsFrame {
    WordsFrame { finger, time: Clock(time), repeats, words, fault: Fault::None }
}

#[test]
fn a_script_runs_at_the_boards_pace_and_by_its_own_clock() {
    let mut board = Scripted::<_, 2>::new(Bare::default());
    assert!(!board.is_sampling() && board.sample(0) == Ok(None));
    let words = Words::Gauges([1, -1, 0x7f_ffff, -0x80_0000, 5, 6]);
    assert!(board.show(&show(1, u32::MAX, 2, words)) && !board.show(&show(2, 0, 0, words)));
    let sample = |time| {
        let reading = Reading::Gauges(GaugeReading([1, -1, 0x7f_ffff, -0x80_0000, 5, 6]));
        Ok(Some(Sample { time, reading }))
    };
    assert_eq!((board.sample(1), board.sample(1)), (sample(u32::MAX), Ok(None)));
    board.board().clock = 999;
    assert_eq!((board.sample(1), board.sample(0)), (Ok(None), Ok(None)));
    board.board().clock = 1500;
    assert_eq!(board.sample(1), sample(999));
    board.board().clock = 9000;
    assert!(board.is_sampling());
    assert_eq!((board.sample(1), board.sample(1)), (sample(1999), Ok(None)));
    assert!(!board.is_sampling());
    // The other kind of sensor, on the same finger.
    let words = Words::Electrodes {
        electrodes: core::array::from_fn(|k| 3000 + k as u16),
        pressure: 1,
        vibration: 2,
        temperature: 3,
        heat_flow: 4,
    };
    assert!(board.show(&show(1, 7, 0, words)));
    let reading = Reading::Electrodes(ElectrodeReading(core::array::from_fn(|k| 3000 + k as u16)));
    assert_eq!(board.sample(1), Ok(Some(Sample { time: 7, reading })));
}

/// Five fingers whose sensors touch for a second, asked to stream every `period` microseconds: the
/// bytes on the line and the reports.
fn second(period: u32) -> (usize, Vec<Report<Spatial>>) {
    let mut device = std::boxed::Box::new(Device::<SpatialHypotheses, Spatial, 16, FINGERS>::new(
        Hypotheses::new(),
    ));
    let mut board = Scripted::<_, FINGERS>::new(Bare::default());
    let mut sequence = 0;
    let mut say = |device: &mut Device<_, _, 16, FINGERS>, board: &mut _, message| {
        let mut buffer = [0; MAX_FRAME];
        let frame = Frame { sequence, time: Clock(0), message };
        sequence += 1;
        device.take(encode::<Command<Spatial>>(&frame, &mut buffer).unwrap(), board);
    };
    say(&mut device, &mut board, Command::Hello { protocol: PROTOCOL });
    for finger in 0..FINGERS as u8 {
        let mut parts = std::vec![SensorPart::Gauges, SensorPart::Skin(Skin::Sphere(0.01))];
        for row in 0..6 {
            let mut numbers = [0.0; 6];
            numbers[usize::from(row)] = 1e-6;
            parts.push(SensorPart::Row { row, numbers });
        }
        parts.push(SensorPart::Sampling { window: 1, gap: 20_000, tare: 1, spread: 1 });
        parts.push(SensorPart::Use);
        for part in parts {
            say(&mut device, &mut board, Command::Sensor(SensorFrame { finger, part }));
        }
        let pose = SpatialPose::from_translation(crate::matrix::Vector([1.03; 3]));
        say(&mut device, &mut board, Command::FingertipPose(FingertipFrame::new(finger, &pose)));
        say(&mut device, &mut board, Command::Words(show(finger, 0, 0, Words::Gauges([0; 6]))));
        // A newton into the fingertip's side.
        let pressed = Words::Gauges([0, -1_000_000, 0, 0, 0, 0]);
        say(&mut device, &mut board, Command::Words(show(finger, 1000, 1002, pressed)));
    }
    say(&mut device, &mut board, Command::Stream { period });
    let mut decoder = Decoder::<Report<Spatial>>::new();
    for byte in std::mem::take(&mut board.board().sent) {
        let report = decoder.push(byte).map(|r| r.unwrap().frame.message);
        assert!(!matches!(report, Some(Report::Reply(Reply { refusal: Some(_), .. }))));
    }
    // The contacts begin with the third reading.
    for _ in 0..1002 {
        board.board().clock += 1000;
        device.sense(&mut board);
    }
    let sent = std::mem::take(&mut board.board().sent);
    let heard = sent.iter().filter_map(|&b| decoder.push(b));
    let reports = heard.map(|r| r.unwrap().frame.message).collect();
    assert_eq!((decoder.counters().lost, decoder.counters().damaged()), (0, 0));
    (sent.len(), reports)
}

#[test]
fn five_fingers_at_200_hertz_take_a_third_of_the_line() {
    let (bytes, reports) = second(5000);
    assert!(reports.iter().all(|r| matches!(r, Report::Contact(_))));
    let of = |finger| {
        let mine = |r: &&Report<Spatial>| matches!(r, Report::Contact(c) if c.finger == finger);
        reports.iter().filter(mine).count()
    };
    assert_eq!([0, 1, 2, 3, 4].map(of), [201; 5]);
    // Start bit, eight bits and stop bit.
    let bits = 10 * bytes;
    assert!(bytes <= 28 * reports.len() && bits < 921_600 / 3, "{bits} bits");
    // Not asked for, nothing is sent.
    assert_eq!(second(0).0, 0);
}

#[test]
fn fingers_begin_as_zero_bits() {
    let new = std::boxed::Box::new(Fingers::<Spatial, FINGERS>::new());
    let size = size_of_val(&*new);
    assert!(size < 24 << 10, "{size}");
    // SAFETY: made of numbers, booleans, options of numbers and enums with an explicit tag, for which
    // zero bits are a value; that they are the right one is what is asserted.
    #[allow(unsafe_code)]
    let zero: std::boxed::Box<Fingers<Spatial, FINGERS>> =
        unsafe { std::boxed::Box::new_zeroed().assume_init() };
    assert_eq!(std::format!("{new:?}"), std::format!("{zero:?}"));
}
