use std::vec;
use std::vec::Vec;

use embedded_hal::spi::ErrorKind;
use embedded_hal_mock::eh1::MockError;
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Look};
use embedded_hal_mock::eh1::spi::{Mock, Transaction};
use proptest::prelude::*;

use super::*;
use crate::driver::emulated::{Ads131m08Chip, Fault};

/// CRC-16/CCITT bit by bit, independent of the driver's table.
fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |crc: u16, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |c, _| {
            if c & 0x8000 != 0 { c << 1 ^ 0x1021 } else { c << 1 }
        })
    })
}

/// A command's frame: its first bytes, checksum included, then zeros.
fn command(first: &[u8]) -> Vec<u8> {
    let mut bytes = first.to_vec();
    bytes.resize(30, 0);
    bytes
}

/// A chip's frame.
fn answer(answer: u16, channels: [i32; 8]) -> Vec<u8> {
    let mut bytes = answer.to_be_bytes().to_vec();
    bytes.push(0);
    for channel in channels {
        bytes.extend(&channel.to_be_bytes()[1..]);
    }
    let crc = crc(&bytes);
    bytes.extend(crc.to_be_bytes());
    bytes.push(0);
    bytes
}

fn exchange(sent: &[u8], received: Vec<u8>) -> Vec<Transaction<u8>> {
    vec![
        Transaction::transaction_start(),
        Transaction::transfer_in_place(command(sent), received),
        Transaction::transaction_end(),
    ]
}

// As the data sheet describes them, checksums worked out by hand-written code elsewhere.
const NOTHING: [u8; 5] = [0x00, 0x00, 0, 0xcc, 0x9c];
const RESETTING: [u8; 5] = [0x00, 0x11, 0, 0xfc, 0xde];
const READ_ID: [u8; 5] = [0xa0, 0x00, 0, 0x71, 0x00];

const COUNTS: [i32; 8] = [1, -1, 0x7f_ffff, -0x80_0000, 5, -6, 0, 0];
/// Word length 24, channels 0 to 5 new.
const NEW: u16 = 0x013f;
const OLD: u16 = 0x0100;
const NO_COUNTS: [i32; 8] = [0; 8];

/// Everything `start` says and hears of a healthy chip.
fn starting() -> Vec<Transaction<u8>> {
    let said = |sent: &[u8], heard: u16| exchange(sent, answer(heard, NO_COUNTS));
    let written = |write: &[u8], read: &[u8], value: u16, address: u16| {
        [said(write, OLD), said(read, WRITTEN | address << 7), said(&NOTHING, value)].concat()
    };
    [
        said(&RESETTING, 0x0500),
        said(&NOTHING, 0xff28),
        said(&READ_ID, 0x0500),
        said(&NOTHING, 0x2800),
        written(
            &[0x61, 0x00, 0, 0x11, 0x10, 0, 0x63, 0x88],
            &[0xa1, 0x00, 0, 0x46, 0x30],
            0x1110,
            2,
        ),
        written(
            &[0x61, 0x80, 0, 0x3f, 0x16, 0, 0x76, 0x39],
            &[0xa1, 0x80, 0, 0x5d, 0xa8],
            0x3f16,
            3,
        ),
        written(
            &[0x62, 0x00, 0, 0x55, 0x55, 0, 0x9e, 0x3c],
            &[0xa2, 0x00, 0, 0x1f, 0x60],
            0x5555,
            4,
        ),
        written(
            &[0x62, 0x80, 0, 0x55, 0x55, 0, 0xbc, 0xec],
            &[0xa2, 0x80, 0, 0x04, 0xf8],
            0x5555,
            5,
        ),
        said(&NOTHING, OLD),
        said(&NOTHING, OLD),
    ]
    .concat()
}

type Polled = Ads131m08<Mock<u8>, NoopDelay>;

/// A chip on a bus that expects `starting` and then `more`.
fn polled(more: Vec<Transaction<u8>>) -> (Polled, Mock<u8>) {
    let spi = Mock::new(&[starting(), more].concat());
    (Ads131m08::polled(spi.clone(), NoopDelay::new(), Settings::GAUGES), spi)
}

#[test]
fn starting_is_exactly_this() {
    let (mut gauges, mut spi) = polled(vec![]);
    assert_eq!(gauges.start(), Ok(()));
    spi.done();
}

#[test]
fn a_frame_is_read_when_its_channels_are_new() {
    let more = [
        exchange(&NOTHING, answer(OLD, NO_COUNTS)),
        exchange(&NOTHING, answer(0x011f, NO_COUNTS)),
        exchange(&NOTHING, answer(NEW, COUNTS)),
    ];
    // The last of them byte by byte.
    let bytes = answer(NEW, COUNTS);
    assert_eq!(&bytes[..12], [0x01, 0x3f, 0, 0, 0, 1, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff]);
    assert_eq!(&bytes[27..], [0x19, 0x67, 0]);
    let (mut gauges, mut spi) = polled(more.concat());
    assert_eq!(gauges.poll(), Err(DriverError::Restarted));
    gauges.start().unwrap();
    assert_eq!(gauges.poll(), Ok(None));
    assert_eq!(gauges.sample(), Ok(COUNTS));
    spi.done();
}

#[test]
fn the_pin_spares_the_bus() {
    let mut spi = Mock::new(&[starting(), exchange(&NOTHING, answer(NEW, COUNTS))].concat());
    let mut pin =
        Pin::new(&[Look::get(State::High), Look::get(State::High), Look::get(State::Low)]);
    let mut gauges = Ads131m08::new(spi.clone(), NoopDelay::new(), pin.clone(), Settings::GAUGES);
    gauges.start().unwrap();
    assert_eq!(gauges.poll(), Ok(None));
    assert_eq!(gauges.sample(), Ok(COUNTS));
    spi.done();
    pin.done();
}

#[test]
fn a_pin_that_never_falls_ends_in_time() {
    // 2 · 1000 µs in steps of 20 µs, and two looks more.
    let looks = vec![Look::get(State::High); 102];
    let (mut spi, mut pin) = (Mock::new(&starting()), Pin::new(&looks));
    let mut gauges = Ads131m08::new(spi.clone(), NoopDelay::new(), pin.clone(), Settings::GAUGES);
    gauges.start().unwrap();
    assert_eq!(gauges.sample(), Err(DriverError::Timeout));
    spi.done();
    pin.done();
}

#[test]
fn a_pin_that_cannot_be_read_is_named() {
    let broken = Look::get(State::High).with_error(MockError::Io(std::io::ErrorKind::Other));
    let (mut spi, mut pin) = (Mock::new(&starting()), Pin::new(&[broken]));
    let mut gauges = Ads131m08::new(spi.clone(), NoopDelay::new(), pin.clone(), Settings::GAUGES);
    gauges.start().unwrap();
    let error = gauges.sample().unwrap_err();
    assert!(matches!(error, DriverError::Pin(_)), "{error}");
    spi.done();
    pin.done();
}

#[test]
fn a_status_that_never_changes_ends_in_time() {
    let old: Vec<_> = (0..102).flat_map(|_| exchange(&NOTHING, answer(OLD, COUNTS))).collect();
    let (mut gauges, mut spi) = polled(old);
    gauges.start().unwrap();
    assert_eq!(gauges.sample(), Err(DriverError::Timeout));
    spi.done();
}

#[test]
fn a_damaged_frame_is_not_a_reading() {
    let mut bytes = answer(NEW, COUNTS);
    bytes[4] ^= 1;
    let (mut gauges, mut spi) = polled(
        [exchange(&NOTHING, bytes.clone()), exchange(&NOTHING, answer(NEW, COUNTS))].concat(),
    );
    gauges.start().unwrap();
    let computed = crc(&bytes[..27]);
    assert_eq!(gauges.sample(), Err(DriverError::Crc { computed, received: 0x1967 }));
    // The next one is again.
    assert_eq!(gauges.sample(), Ok(COUNTS));
    spi.done();
}

#[test]
fn nobody_and_somebody_else_are_told_apart() {
    let tried = |heard: Vec<u8>| {
        let attempt = [exchange(&RESETTING, heard.clone()), exchange(&NOTHING, heard)].concat();
        let mut spi = Mock::new(&[attempt.clone(), attempt.clone(), attempt].concat());
        let mut gauges = Ads131m08::polled(spi.clone(), NoopDelay::new(), Settings::GAUGES);
        let outcome = gauges.start();
        assert_eq!(gauges.sample(), Err(DriverError::Restarted));
        spi.done();
        outcome
    };
    assert_eq!(tried(vec![0; 30]), Err(DriverError::Missing));
    assert_eq!(tried(vec![0xff; 30]), Err(DriverError::Missing));
    // An ADS131M06 says that it is ready, too.
    let other = Err(DriverError::Device { answer: 0xff26 });
    assert_eq!(tried(answer(0xff26, NO_COUNTS)), other);
    let unlike = [
        exchange(&RESETTING, answer(OLD, NO_COUNTS)),
        exchange(&NOTHING, answer(READY, NO_COUNTS)),
    ];
    let identity =
        [exchange(&READ_ID, answer(OLD, NO_COUNTS)), exchange(&NOTHING, answer(0x2600, NO_COUNTS))];
    let mut spi = Mock::new(&[unlike.concat(), identity.concat()].concat());
    let mut gauges = Ads131m08::polled(spi.clone(), NoopDelay::new(), Settings::GAUGES);
    assert_eq!(gauges.start(), Err(DriverError::Device { answer: 0x2600 }));
    spi.done();
}

#[test]
fn a_register_that_forgets_is_named() {
    let (bus, wrong) = (starting(), answer(0x1111, NO_COUNTS));
    // The seventh exchange reads MODE back.
    let mut bus = bus[..3 * 6].to_vec();
    bus.extend(exchange(&NOTHING, wrong));
    let mut spi = Mock::new(&bus);
    let mut gauges = Ads131m08::polled(spi.clone(), NoopDelay::new(), Settings::GAUGES);
    let error = DriverError::Register { address: 2, written: 0x1110, read: 0x1111 };
    assert_eq!(gauges.start(), Err(error));
    spi.done();
}

#[test]
fn a_bus_that_fails_is_named() {
    let mut gauges =
        Ads131m08::polled(crate::driver::tests::Broken, NoopDelay::new(), Settings::GAUGES);
    assert_eq!(gauges.start(), Err(DriverError::Bus(ErrorKind::ModeFault)));
}

#[test]
fn sleeping_and_waking_are_acknowledged() {
    let standby = [0x00, 0x22, 0, 0xac, 0x18];
    let wake_up = [0x00, 0x33, 0, 0x9c, 0x5a];
    let said = |sent: &[u8], heard: u16| exchange(sent, answer(heard, NO_COUNTS));
    let mut spi = Mock::new(
        &[
            said(&standby, OLD),
            said(&NOTHING, 0x0022),
            said(&wake_up, OLD),
            said(&NOTHING, 0x0033),
            said(&NOTHING, OLD),
            said(&NOTHING, OLD),
            said(&standby, OLD),
            said(&NOTHING, OLD | STATUS_COMMAND_CRC),
        ]
        .concat(),
    );
    let mut gauges = Ads131m08::polled(spi.clone(), NoopDelay::new(), Settings::GAUGES);
    assert_eq!(gauges.stand_by(), Ok(()));
    assert_eq!(gauges.wake_up(), Ok(()));
    assert_eq!(gauges.stand_by(), Err(DriverError::Command));
    spi.done();
}

#[test]
fn settings_are_the_registers_of_the_data_sheet() {
    let gains =
        [Gain::X1, Gain::X2, Gain::X4, Gain::X8, Gain::X16, Gain::X32, Gain::X64, Gain::X128];
    let settings = Settings { channels: 0xff, gains, oversampling: Oversampling::By1024 };
    // The clock register after power-up.
    assert_eq!(settings.clock(), 0xff0e);
    assert_eq!((settings.gain(0), settings.gain(4)), (0x3210, 0x7654));
    assert_eq!(Oversampling::By1024.period_us(), 250);
    assert_eq!(Oversampling::By16256.period_us(), 3969);
    // A full scale of ±1.2 V, and of ±9.375 mV.
    assert!((Gain::X1.volts_per_count() * 8_388_608.0 - 1.2).abs() < 1e-6);
    assert!((Gain::X128.volts_per_count() * 8_388_608.0 - 9.375e-3).abs() < 1e-8);
}

#[test]
fn an_emulated_chip_speaks_the_same_protocol() {
    let mut gauges =
        Ads131m08::polled(Ads131m08Chip::showing(COUNTS), NoopDelay::new(), Settings::GAUGES);
    gauges.start().unwrap();
    assert_eq!(gauges.read_register(register::ID), Ok(0x2800));
    // Channels that are off show nothing.
    gauges.spi().show([9; 8]);
    assert_eq!(gauges.sample(), Ok([9, 9, 9, 9, 9, 9, 0, 0]));
    gauges.stand_by().unwrap();
    assert_eq!(gauges.sample(), Err(DriverError::Timeout));
    gauges.wake_up().unwrap();
    gauges.spi().show(COUNTS);
    assert_eq!(gauges.sample(), Ok(COUNTS));
    for (fault, error) in
        [(Fault::Missing, DriverError::Missing), (Fault::Stuck, DriverError::Timeout)]
    {
        gauges.spi().set_fault(fault);
        assert_eq!(gauges.sample(), Err(error));
    }
    gauges.spi().set_fault(Fault::Noise);
    let error = gauges.sample().unwrap_err();
    assert!(matches!(error, DriverError::Crc { .. }), "{error}");
    gauges.spi().set_fault(Fault::None);
    assert_eq!(gauges.sample(), Ok(COUNTS));
    // A chip that lost its power is noticed, and can be started again.
    gauges.spi().restart();
    assert_eq!(gauges.sample(), Err(DriverError::Restarted));
    assert_eq!(gauges.sample(), Err(DriverError::Restarted));
    gauges.start().unwrap();
    assert_eq!(gauges.sample(), Ok(COUNTS));
}

#[test]
fn an_emulated_chip_refuses_a_damaged_command() {
    let mut chip = Ads131m08Chip::showing(COUNTS);
    let mut gauges = Ads131m08::polled(&mut chip, NoopDelay::new(), Settings::GAUGES);
    gauges.start().unwrap();
    let mut damaged = command(&[0x61, 0x80, 0, 0x00, 0x00, 0, 0x76, 0x39]);
    gauges.spi().transfer_in_place(&mut damaged).unwrap();
    assert_eq!(gauges.poll(), Err(DriverError::Command));
    assert_eq!(gauges.sample(), Ok(COUNTS));
}

/// A chip whose answers are replaced from some transfer on.
fn noise() -> impl Strategy<Value = Vec<Vec<u8>>> {
    let word = prop_oneof![
        Just(vec![0; 30]),
        Just(vec![0xff; 30]),
        proptest::collection::vec(any::<u8>(), 0..31)
    ];
    let valid = (any::<u16>(), any::<[i32; 8]>()).prop_map(|(a, c)| answer(a, c));
    proptest::collection::vec(prop_oneof![word, valid], 0..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn twenty_four_bits_survive(counts in proptest::array::uniform8(-0x80_0000i32..0x80_0000), status in any::<u16>()) {
        let bytes: [u8; FRAME] = answer(status, counts).try_into().unwrap();
        prop_assert_eq!(Frame::parse(&bytes), Ok(Frame { answer: status, channels: counts }));
    }

    #[test]
    fn one_wrong_bit_is_seen(counts in proptest::array::uniform8(-0x80_0000i32..0x80_0000), bit in 0usize..232) {
        let mut bytes: [u8; FRAME] = answer(NEW, counts).try_into().unwrap();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let crc = matches!(Frame::parse(&bytes), Err(DriverError::Crc { .. }));
        prop_assert!(crc);
    }

    #[test]
    fn any_words_give_a_reading_or_an_error(words in noise()) {
        let mut bus = crate::driver::tests::Echo::new(words);
        let mut gauges = Ads131m08::polled(&mut bus, NoopDelay::new(), Settings::GAUGES);
        let _ = gauges.start();
        gauges.started = true;
        for _ in 0..3 {
            let _ = gauges.sample();
        }
        let _ = gauges.stand_by();
        let _ = gauges.wake_up();
    }
}
