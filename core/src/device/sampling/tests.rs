use core::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec;
use std::vec::Vec;

use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use proptest::prelude::*;

use super::*;
use crate::device::{Device, FINGERS, Fingers, SpatialHypotheses};
use crate::driver::ads131m08::Overlapped;
use crate::driver::background::BackgroundDevice;
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
    /// Whether a poll without a reading has begun to read one.
    carried: bool,
    under_way: bool,
    started: u32,
}

impl Sampler for Told {
    type Reading = i32;

    fn start(&mut self) -> Result<(), DriverError> {
        self.started += 1;
        self.starts.pop_front().unwrap_or(Ok(()))
    }

    fn poll(&mut self) -> Result<Option<i32>, DriverError> {
        let said = self.polls.pop_front().unwrap_or(Ok(None));
        self.under_way = self.carried && said == Ok(None);
        said
    }

    fn is_under_way(&self) -> bool {
        self.under_way
    }

    fn sample(&mut self) -> Result<i32, DriverError> {
        Err(DriverError::Timeout)
    }
}

fn watched<const S: usize, const P: usize>(
    starts: [Result<(), DriverError>; S],
    polls: [Result<Option<i32>, DriverError>; P],
) -> Watched<Told> {
    let (starts, polls) = (starts.into(), polls.into());
    Watched::new(Told { starts, polls, carried: false, under_way: false, started: 0 })
}

#[test]
fn a_sensor_is_started_once_and_read() {
    let mut sensor = watched([], [Ok(Some(1)), Ok(None), Ok(Some(2))]);
    let said = [10, 20, 30].map(|t| sensor.poll(t));
    assert_eq!(said, [Ok(Some((10, 1))), Ok(None), Ok(Some((30, 2)))]);
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
    assert_eq!(said, [(0, gone), (10, gone), (20, Ok(Some((start.wrapping_add(200_000), 3))))]);
    assert_eq!(sensor.sensor.started, 3);
}

#[test]
fn noise_passes_but_a_restart_is_mended() {
    let crc = DriverError::Crc { computed: 1, received: 2 };
    let polls = [Err(crc), Ok(Some(1)), Err(DriverError::Restarted), Ok(Some(2))];
    let mut sensor = watched([], polls);
    assert_eq!((sensor.poll(0), sensor.poll(1000)), (Err(crc), Ok(Some((1000, 1)))));
    assert_eq!(sensor.poll(2000), Err(DriverError::Restarted));
    assert_eq!(sensor.poll(3000), Ok(None));
    assert_eq!(sensor.poll(102_000), Ok(Some((102_000, 2))));
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

#[test]
fn one_that_says_nothing_but_noise_is_started_again() {
    let crc = DriverError::Crc { computed: 1, received: 2 };
    let mut sensor = watched([], [Err(crc), Err(crc), Err(crc), Ok(Some(7))]);
    assert_eq!((sensor.poll(0), sensor.poll(49_999)), (Err(crc), Err(crc)));
    assert_eq!(sensor.poll(50_000), Err(DriverError::Timeout));
    assert_eq!(sensor.poll(150_000), Ok(Some((150_000, 7))));
    assert_eq!(sensor.sensor.started, 2);
}

#[test]
fn one_that_nobody_asked_is_not_late() {
    let mut sensor = watched([], [Ok(Some(1)), Ok(None), Ok(Some(2))]);
    assert_eq!(sensor.poll(0), Ok(Some((0, 1))));
    // A tracker computed for 70 ms.
    assert_eq!(sensor.poll(70_000), Ok(None));
    assert_eq!(sensor.poll(70_100), Ok(Some((70_100, 2))));
    assert_eq!(sensor.poll(119_000), Ok(None));
    assert_eq!(sensor.poll(120_100), Err(DriverError::Timeout));
}

#[test]
fn a_reading_belongs_to_when_it_was_begun() {
    let polls = [Ok(None), Ok(None), Ok(Some(1)), Ok(None), Ok(Some(2))];
    let mut sensor = watched([], polls);
    sensor.sensor.carried = true;
    let said = [10, 20, 30, 1000, 90_000].map(|t| sensor.poll(t));
    assert_eq!(said, [Ok(None), Ok(None), Ok(Some((10, 1))), Ok(None), Ok(Some((1000, 2)))]);
    // What was begun before the sensor was set up anew is not the next one's.
    let polls = [Ok(None), Err(DriverError::Restarted), Ok(Some(3))];
    let mut sensor = watched([], polls);
    sensor.sensor.carried = true;
    assert_eq!((sensor.poll(0), sensor.poll(10)), (Ok(None), Err(DriverError::Restarted)));
    assert_eq!(sensor.poll(200_000), Ok(Some((200_000, 3))));
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

/// Whose frame a bus carries, and what came back.
type Carried = Option<(usize, Vec<u8>)>;

/// An emulated chip on a bus that it shares.
struct Sharing {
    chip: Rc<RefCell<Ads131m08Chip>>,
    line: usize,
    bus: Rc<RefCell<Carried>>,
}

impl ErrorType for Sharing {
    type Error = ErrorKind;
}

impl SpiDevice for Sharing {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.bus.borrow_mut().take_if(|(line, _)| *line == self.line);
        self.chip.borrow_mut().transaction(operations).map_err(|never| match never {})
    }
}

impl BackgroundDevice for Sharing {
    fn begin(&mut self, frame: &[u8]) -> Result<bool, ErrorKind> {
        let mut bus = self.bus.borrow_mut();
        if bus.as_ref().is_some_and(|(line, _)| *line != self.line) {
            return Ok(false);
        }
        let mut bytes = frame.to_vec();
        self.chip.borrow_mut().transfer_in_place(&mut bytes).map_err(|never| match never {})?;
        *bus = Some((self.line, bytes));
        Ok(true)
    }

    fn fetch(&mut self, frame: &mut [u8]) -> Result<bool, ErrorKind> {
        let own = self.bus.borrow_mut().take_if(|(line, _)| *line == self.line);
        frame.copy_from_slice(&own.ok_or(ErrorKind::Other)?.1);
        Ok(true)
    }
}

#[test]
fn one_that_is_stuck_leaves_the_bus_to_the_others() {
    // It is given up at a poll that begins a frame, or at one that fetches it.
    for earlier in [0, 1] {
        let bus = Rc::new(RefCell::new(None));
        let chips = [1, 2].map(|n| Rc::new(RefCell::new(Ads131m08Chip::showing([n; 8]))));
        let sensors = [0, 1].map(|line| {
            let spi = Sharing { chip: chips[line].clone(), line, bus: bus.clone() };
            Overlapped::new(Ads131m08::polled(spi, NoDelay, ads131m08::Settings::GAUGES))
        });
        let mut board = Sensing::new(Bare::default(), sensors);
        for _ in 0..earlier {
            let _ = board.sample(0);
        }
        chips[0].borrow_mut().set_fault(Fault::Stuck);
        let mut stuck = 0;
        for _ in 0..1000 {
            board.board.clock += 100;
            stuck += u32::from(board.sample(0) == Err(DriverError::Timeout));
            let _ = board.sample(1);
        }
        assert!(stuck > 0, "{earlier}");
        let others = (0..10).filter(|_| {
            let _ = board.sample(0);
            board.sample(1).is_ok_and(|sample| sample.is_some())
        });
        assert!(others.count() >= 4, "{earlier}");
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
        let mut parts = vec![SensorPart::Gauges, SensorPart::Skin(Skin::Sphere(0.01))];
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
    assert!(size < 27 << 10, "{size}");
    // SAFETY: made of numbers, booleans, options of numbers and enums with an explicit tag, for which
    // zero bits are a value; that they are the right one is what is asserted.
    #[allow(unsafe_code)]
    let zero: std::boxed::Box<Fingers<Spatial, FINGERS>> =
        unsafe { std::boxed::Box::new_zeroed().assume_init() };
    assert_eq!(std::format!("{new:?}"), std::format!("{zero:?}"));
}

/// Any bits, and often a number that makes sense.
fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        -2.0f32..2.0,
        Just(0.0),
        Just(1e-6),
        Just(f32::MAX)
    ]
}

fn numbers<const N: usize>() -> impl Strategy<Value = [f32; N]> {
    proptest::collection::vec(number(), N).prop_map(|v| core::array::from_fn(|i| v[i]))
}

fn part() -> impl Strategy<Value = SensorPart> {
    prop_oneof![
        8 => (any::<u8>(), numbers()).prop_map(|(row, numbers)| SensorPart::Row { row: row % 7, numbers }),
        1 => (any::<i32>(), any::<i32>()).prop_map(|(least, most)| SensorPart::Range { least, most }),
        1 => numbers().prop_map(SensorPart::Capacity),
        1 => numbers().prop_map(SensorPart::Noise),
        1 => numbers().prop_map(SensorPart::Mount),
        1 => (number(), numbers()).prop_map(|(mass, centre)| SensorPart::Weight { mass, centre }),
        2 => number().prop_map(|r| SensorPart::Skin(Skin::Sphere(r))),
        1 => numbers().prop_map(|axes| SensorPart::Skin(Skin::Ellipsoid(axes))),
        1 => (number(), number())
            .prop_map(|(radius, length)| SensorPart::Skin(Skin::CappedCylinder { radius, length })),
        1 => (numbers(), numbers(), number()).prop_map(|(matrix, linear, constant)| {
            SensorPart::Skin(Skin::Quadric { matrix, linear, constant })
        }),
        1 => (numbers(), number()).prop_map(|(normal, offset)| SensorPart::Edge { normal, offset }),
        1 => (any::<u8>(), any::<u32>(), 0u16..4, any::<i32>())
            .prop_map(|(window, gap, tare, spread)| SensorPart::Sampling { window, gap, tare, spread }),
        1 => numbers().prop_map(|[begin, end]| {
            SensorPart::Detection { begin, end, begin_readings: 1, end_readings: 1 }
        }),
        1 => (any::<u8>(), numbers()).prop_map(|(number, position)| {
            SensorPart::Electrode { number: number % 20, position }
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_settings_and_any_words_are_survived(
        gauges in any::<bool>(),
        parts in proptest::collection::vec(part(), 0..24),
        pose in numbers::<7>(),
        words in proptest::collection::vec((any::<[i32; 6]>(), any::<[u16; 19]>(), any::<u32>()), 0..24),
    ) {
        let mut fingers = std::boxed::Box::new(Fingers::<Spatial, 1>::new());
        let begin = if gauges { SensorPart::Gauges } else { SensorPart::Electrodes };
        // A sensor that works, which the parts then change.
        let mut settings = vec![begin];
        if gauges {
            settings.push(SensorPart::Skin(Skin::Sphere(0.01)));
            for row in 0..6 {
                let mut numbers = [0.0; 6];
                numbers[usize::from(row)] = 1e-9;
                settings.push(SensorPart::Row { row, numbers });
            }
        }
        settings.push(SensorPart::Sampling { window: 2, gap: u32::MAX, tare: 1, spread: i32::MAX });
        settings.extend(parts);
        settings.push(SensorPart::Use);
        for part in settings {
            let _ = fingers.tell(&SensorFrame { finger: 0, part });
        }
        let _ = fingers.place(&FingertipFrame { finger: 0, numbers: pose });
        for (gauges, electrodes, time) in words {
            for reading in [
                Reading::Gauges(GaugeReading(gauges)),
                Reading::Electrodes(ElectrodeReading(electrodes)),
            ] {
                let felt = fingers.feel(0, Ok(Some(Sample { time, reading })));
                if let Some(contact) = felt {
                    prop_assert!(contact.checked().is_ok());
                }
            }
            fingers.report(0);
        }
    }
}
