use core::cell::Cell;
use std::rc::Rc;
use std::vec::Vec;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Look};

use super::*;
use crate::driver::ads131m08::Settings;
use crate::driver::emulated::{Ads131m08Chip, Fault};

/// An emulated chip on a bus that needs `slow` fetches for a frame, or is busy, or fails.
struct Carried {
    chip: Ads131m08Chip,
    slow: u32,
    busy: u32,
    fails: bool,
    frame: Option<(u32, Vec<u8>)>,
    begun: Vec<Vec<u8>>,
    transactions: u32,
}

impl Carried {
    fn new(channels: [i32; 8]) -> Self {
        let chip = Ads131m08Chip::showing(channels);
        let (frame, begun) = (None, Vec::new());
        Carried { chip, slow: 0, busy: 0, fails: false, frame, begun, transactions: 0 }
    }
}

impl ErrorType for Carried {
    type Error = ErrorKind;
}

impl SpiDevice for Carried {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.transactions += 1;
        self.chip.transaction(operations).map_err(|never| match never {})
    }
}

impl BackgroundDevice for Carried {
    fn begin(&mut self, frame: &[u8]) -> Result<bool, ErrorKind> {
        if self.busy > 0 {
            self.busy -= 1;
            return Ok(false);
        }
        self.begun.push(frame.into());
        let mut bytes = frame.to_vec();
        self.chip.transfer_in_place(&mut bytes).map_err(|never| match never {})?;
        self.frame = Some((self.slow, bytes));
        Ok(true)
    }

    fn fetch(&mut self, frame: &mut [u8]) -> Result<bool, ErrorKind> {
        let (left, bytes) = self.frame.as_mut().ok_or(ErrorKind::Other)?;
        if self.fails {
            self.frame = None;
            return Err(ErrorKind::Overrun);
        }
        if *left > 0 {
            *left -= 1;
            return Ok(false);
        }
        frame.copy_from_slice(bytes);
        self.frame = None;
        Ok(true)
    }
}

const COUNTS: [i32; 8] = [1, -2, 3, -4, 5, -6, 0, 0];

fn started() -> Overlapped<Carried, NoopDelay> {
    let chip = Ads131m08::polled(Carried::new(COUNTS), NoopDelay::new(), Settings::GAUGES);
    let mut gauges = Overlapped::new(chip);
    assert_eq!(gauges.poll(), Err(DriverError::Restarted));
    gauges.start().unwrap();
    gauges.spi().transactions = 0;
    gauges
}

#[test]
fn a_frame_is_begun_and_fetched_later() {
    let mut gauges = started();
    gauges.spi().slow = 2;
    let polls: Vec<_> = (0..8).map(|_| (gauges.poll(), gauges.is_under_way())).collect();
    let (waits, there) = ((Ok(None), true), (Ok(Some(COUNTS)), false));
    assert_eq!(polls, [waits, waits, waits, there, waits, waits, waits, there]);
    // No command, with its checksum, and nothing that the processor waited for.
    let mut nothing = [0; FRAME];
    [nothing[3], nothing[4]] = [0xcc, 0x9c];
    assert_eq!(gauges.spi().begun, [nothing, nothing]);
    assert_eq!(gauges.spi().transactions, 0);
    assert_eq!(gauges.sample(), Ok(COUNTS));
}

#[test]
fn a_bus_that_is_busy_is_asked_again() {
    let mut gauges = started();
    gauges.spi().busy = 2;
    for _ in 0..2 {
        assert_eq!((gauges.poll(), gauges.is_under_way()), (Ok(None), false));
    }
    assert_eq!((gauges.poll(), gauges.is_under_way()), (Ok(None), true));
    assert_eq!(gauges.poll(), Ok(Some(COUNTS)));
}

#[test]
fn the_pin_spares_the_bus() {
    let mut pin = Pin::new(&[State::High, State::High, State::Low].map(Look::get));
    let (bus, delay) = (Carried::new(COUNTS), NoopDelay::new());
    let mut gauges = Overlapped::new(Ads131m08::new(bus, delay, pin.clone(), Settings::GAUGES));
    gauges.start().unwrap();
    for begun in [0, 0, 1] {
        assert_eq!(gauges.poll(), Ok(None));
        assert_eq!(gauges.spi().begun.len(), begun);
    }
    // On its way the pin is not looked at.
    assert_eq!(gauges.poll(), Ok(Some(COUNTS)));
    pin.done();
}

/// Adds up what is waited.
#[derive(Clone, Default)]
struct Watch(Rc<Cell<u32>>);

impl DelayNs for Watch {
    fn delay_ns(&mut self, ns: u32) {
        self.0.set(self.0.get() + ns);
    }
}

#[test]
fn two_periods_are_waited_and_no_longer() {
    let watch = Watch::default();
    let chip = Ads131m08::polled(Carried::new(COUNTS), watch.clone(), Settings::GAUGES);
    let mut gauges = Overlapped::new(chip);
    gauges.start().unwrap();
    gauges.spi().chip.set_fault(Fault::Stuck);
    watch.0.set(0);
    gauges.spi().begun.clear();
    assert_eq!(gauges.sample(), Err(DriverError::Timeout));
    // 2 · 1000 µs in steps of 20 µs, and two looks more; every second one fetches.
    assert_eq!(watch.0.get(), 102 * 20_000);
    assert_eq!(gauges.spi().begun.len(), 51);
}

#[test]
fn what_goes_wrong_is_told_once_and_over() {
    let mut gauges = started();
    gauges.spi().chip.set_fault(Fault::Noise);
    assert_eq!(gauges.poll(), Ok(None));
    let error = gauges.poll().unwrap_err();
    assert!(matches!(error, DriverError::Crc { .. }), "{error}");
    gauges.spi().chip.set_fault(Fault::Missing);
    assert_eq!((gauges.poll(), gauges.poll()), (Ok(None), Err(DriverError::Missing)));
    gauges.spi().chip.set_fault(Fault::Stuck);
    assert_eq!(gauges.sample(), Err(DriverError::Timeout));
    gauges.start().unwrap();
    gauges.spi().chip.set_fault(Fault::None);
    gauges.spi().fails = true;
    assert_eq!(gauges.poll(), Ok(None));
    assert_eq!(gauges.poll(), Err(DriverError::Bus(ErrorKind::Overrun)));
    assert!(!gauges.is_under_way());
    gauges.spi().fails = false;
    assert_eq!(gauges.sample(), Ok(COUNTS));
    // A frame from before the chip was set up anew is not fetched.
    assert_eq!(gauges.poll(), Ok(None));
    gauges.start().unwrap();
    assert!(!gauges.is_under_way());
    gauges.spi().chip.restart();
    assert_eq!((gauges.poll(), gauges.poll()), (Ok(None), Err(DriverError::Restarted)));
}
