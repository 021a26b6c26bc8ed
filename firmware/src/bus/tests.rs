//! The bus against an imitation of SPI1, DMA2 and the port, which obeys the reference manual's rules
//! and complains where they are broken, with five emulated ADS131M08 on it.

use std::cell::RefCell;
use std::rc::Rc;

use tactile_core::driver::ads131m08::{Ads131m08, CHANNELS, FRAME, Overlapped, Settings};
use tactile_core::driver::emulated::{Ads131m08Chip, Fault};
use tactile_core::driver::{DriverError, Sampler};

use super::*;

const SPI1: u32 = 0x4001_3000;

/// What is wrong with the DMA controller.
#[derive(Clone, Copy, PartialEq)]
enum Controller {
    Works,
    /// Writes are lost and everything reads zero, as in QEMU.
    Absent,
    /// No byte is ever carried.
    Stalls,
    /// It reports an error by this flag.
    Fails(u32),
}

/// What is wrong with the SPI.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Peripheral {
    Works,
    /// A byte is lost.
    Overruns,
    /// Another master holds the line.
    Faults,
    /// Never takes a byte.
    NeverEmpty,
    /// No byte ever comes in.
    NeverFull,
    /// The last bit never goes out.
    Busy,
}

struct Hardware {
    spi: [u32; 4],
    dma: [u32; 52],
    /// Which lines are high.
    lines: u32,
    chips: Vec<Ads131m08Chip>,
    controller: Controller,
    peripheral: Peripheral,
    /// The data register was read: reading the status now clears an overrun.
    drained: bool,
    /// Looks at a stream's settings until it is off that was switched off on its way.
    stopping: [u32; 2],
    /// Looks at the flags until a frame is through, and those left now.
    slow: u32,
    left: u32,
    /// What the selected chip says, and the bytes that the processor has sent it.
    answer: [u8; FRAME],
    heard: Vec<u8>,
    /// All bytes that the processor ever sent.
    sent: Vec<u8>,
    by_processor: usize,
    by_dma: usize,
    /// Every write, by register: for the order.
    written: Vec<(char, usize, u32)>,
    /// The bus's memory, once it is known.
    memory: Option<(&'static [AtomicU8], &'static [AtomicU8])>,
}

impl Hardware {
    fn selected(&self) -> Option<usize> {
        let low = !self.lines & 0x1f;
        assert!(low.count_ones() <= 1, "more than one chip is selected: {low:05b}");
        (low != 0).then(|| low.trailing_zeros() as usize)
    }

    /// The chip's side of a whole frame.
    fn whole(&mut self, line: usize, sent: &[u8]) -> Vec<u8> {
        let mut bytes = sent.to_vec();
        self.chips[line].transfer_in_place(&mut bytes).unwrap();
        bytes
    }

    fn set_lines(&mut self, value: u32) {
        let before = self.selected();
        self.lines = (self.lines & !(value >> 16)) | (value & 0xffff);
        let now = self.selected();
        if before == now {
            return;
        }
        assert_eq!(self.spi[1], 0, "selection changes while the SPI asks for DMA");
        for stream in [dma::IN, dma::OUT] {
            let running = self.stream(stream, dma::CR) & dma::ENABLE != 0;
            assert!(!running, "selection changes under a stream");
        }
        if let Some(line) = before {
            let heard = std::mem::take(&mut self.heard);
            if !heard.is_empty() {
                self.whole(line, &heard);
            }
        }
        if let Some(line) = now {
            // A chip's answer does not depend on what it hears meanwhile.
            let answer = self.chips[line].clone().answer_to_nothing();
            self.answer = answer;
        }
    }

    fn spi_read(&mut self, offset: usize) -> u32 {
        match offset {
            spi::SR => {
                let status = self.spi[2];
                if std::mem::take(&mut self.drained) {
                    self.spi[2] &= !spi::OVERRUN;
                }
                match self.peripheral {
                    Peripheral::NeverEmpty => status,
                    Peripheral::NeverFull => spi::TX_EMPTY | status & !spi::RX_NOT_EMPTY,
                    Peripheral::Faults => spi::TX_EMPTY | spi::MODE_FAULT | status,
                    Peripheral::Busy => spi::TX_EMPTY | spi::BUSY | status,
                    Peripheral::Works | Peripheral::Overruns => spi::TX_EMPTY | status,
                }
            }
            spi::DR => {
                self.spi[2] &= !spi::RX_NOT_EMPTY;
                self.drained = true;
                self.spi[3]
            }
            other => self.spi[other / 4],
        }
    }

    fn spi_write(&mut self, offset: usize, value: u32) {
        match offset {
            spi::DR => {
                assert!(self.selected().is_some(), "nobody listens");
                assert_ne!(self.spi[0] & 1 << 6, 0, "the SPI is off");
                self.spi[3] = self.answer[self.heard.len()].into();
                self.heard.push(value as u8);
                self.sent.push(value as u8);
                self.spi[2] |= spi::RX_NOT_EMPTY;
                if self.peripheral == Peripheral::Overruns {
                    self.spi[2] |= spi::OVERRUN;
                }
                self.by_processor += 1;
            }
            spi::CR2 => {
                self.spi[1] = value;
                if value & spi::TX_DMA != 0 {
                    self.check_streams();
                    self.left = self.slow;
                }
            }
            other => self.spi[other / 4] = value,
        }
    }

    fn stream(&self, at: usize, register: usize) -> u32 {
        self.dma[(at + register) / 4]
    }

    /// Both streams are ready before the first byte is asked for.
    fn check_streams(&self) {
        assert!(self.selected().is_some(), "nobody listens");
        assert_eq!(self.spi[1], spi::RX_DMA | spi::TX_DMA);
        assert_eq!(self.dma[0], 0, "flags of an earlier frame");
        let (out, back) = self.memory.unwrap();
        for (stream, settings, memory) in
            [(dma::IN, 0x0602_0401, back), (dma::OUT, 0x0601_0441, out)]
        {
            assert_eq!(self.stream(stream, dma::CR), settings);
            assert_eq!(self.stream(stream, dma::COUNT), FRAME as u32);
            assert_eq!(self.stream(stream, dma::PERIPHERAL), SPI1 + 0x0c);
            assert_eq!(self.stream(stream, dma::MEMORY), memory.as_ptr() as usize as u32);
        }
    }

    fn dma_read(&mut self, offset: usize) -> u32 {
        if offset == dma::FLAGS && self.spi[1] & spi::TX_DMA != 0 {
            match self.controller {
                Controller::Works if self.left == 0 => self.carry(),
                Controller::Works => {
                    self.left -= 1;
                    // Half way, of both.
                    self.dma[0] |= 0b01_0000 | 0b01_0000 << 22;
                }
                Controller::Fails(flag) => self.dma[0] |= flag,
                // What was to be taken in by then was not.
                Controller::Stalls => self.spi[2] |= spi::RX_NOT_EMPTY | spi::OVERRUN,
                Controller::Absent => {}
            }
        }
        for (stream, left) in [dma::IN, dma::OUT].into_iter().zip(&mut self.stopping) {
            if offset == stream && *left > 0 {
                *left -= 1;
                if *left == 0 {
                    self.dma[offset / 4] &= !dma::ENABLE;
                }
            }
        }
        self.dma[offset / 4]
    }

    fn carry(&mut self) {
        let (out, back) = self.memory.unwrap();
        let count = self.stream(dma::OUT, dma::COUNT) as usize;
        let sent: Vec<u8> = out[..count].iter().map(|b| b.load(Ordering::Relaxed)).collect();
        let line = self.selected().unwrap();
        for (byte, back) in self.whole(line, &sent).into_iter().zip(back) {
            back.store(byte, Ordering::Relaxed);
        }
        self.by_dma += count;
        for stream in [dma::IN, dma::OUT] {
            self.dma[(stream + dma::CR) / 4] &= !dma::ENABLE;
            self.dma[(stream + dma::COUNT) / 4] = 0;
        }
        // All that came in was taken.
        self.spi[2] = 0;
        // Complete and half way, of both.
        self.dma[0] |= 0b11_0000 | 0b11_0000 << 22;
    }

    fn dma_write(&mut self, offset: usize, value: u32) {
        if self.controller == Controller::Absent {
            return;
        }
        match offset {
            dma::CLEAR => self.dma[0] &= !value,
            _ => {
                for (k, stream) in [dma::IN, dma::OUT].into_iter().enumerate() {
                    let running = self.stream(stream, dma::CR) & dma::ENABLE != 0;
                    let inside = (stream..stream + 0x18).contains(&offset);
                    if inside && running {
                        let stops = offset == stream && value & dma::ENABLE == 0;
                        assert!(stops, "a running stream is changed");
                        // It ends the byte that it is at.
                        self.stopping[k] = 3;
                        return;
                    }
                }
                self.dma[offset / 4] = value;
            }
        }
    }
}

/// What a chip sends in its next frame.
trait Answer {
    fn answer_to_nothing(self) -> [u8; FRAME];
}

impl Answer for Ads131m08Chip {
    fn answer_to_nothing(mut self) -> [u8; FRAME] {
        let mut bytes = [0; FRAME];
        self.transfer_in_place(&mut bytes).unwrap();
        bytes
    }
}

/// One of the three blocks of registers.
#[derive(Clone)]
struct Imitation {
    name: char,
    hardware: Rc<RefCell<Hardware>>,
}

impl Block for Imitation {
    fn read(&self, offset: usize) -> u32 {
        let mut hardware = self.hardware.borrow_mut();
        match self.name {
            's' => hardware.spi_read(offset),
            'd' => hardware.dma_read(offset),
            _ => panic!("the port is not read"),
        }
    }

    fn write(&self, offset: usize, value: u32) {
        let mut hardware = self.hardware.borrow_mut();
        hardware.written.push((self.name, offset, value));
        match self.name {
            's' => hardware.spi_write(offset, value),
            'd' => hardware.dma_write(offset, value),
            _ => {
                assert_eq!(offset, BSRR);
                hardware.set_lines(value);
            }
        }
    }

    fn address(&self, offset: usize) -> u32 {
        assert_eq!(self.name, 's');
        SPI1 + offset as u32
    }
}

#[derive(Clone, Copy)]
struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

type Gauges = Overlapped<Chip<'static, Imitation, NoDelay>, NoDelay>;

fn counts(line: i32) -> [i32; CHANNELS] {
    [line, -line - 1, 100 * line, 7, -8, 0x7f_ffff, 0, 0]
}

fn built(controller: Controller) -> (&'static Bus<Imitation>, Rc<RefCell<Hardware>>) {
    let hardware = Rc::new(RefCell::new(Hardware {
        spi: [0; 4],
        dma: [0; 52],
        lines: 0,
        chips: (0..5).map(|line| Ads131m08Chip::showing(counts(line))).collect(),
        controller,
        peripheral: Peripheral::Works,
        drained: false,
        stopping: [0; 2],
        slow: 3,
        left: 0,
        answer: [0; FRAME],
        heard: Vec::new(),
        sent: Vec::new(),
        by_processor: 0,
        by_dma: 0,
        written: Vec::new(),
        memory: None,
    }));
    hardware.borrow_mut().lines = 0x1f;
    let block = |name| Imitation { name, hardware: hardware.clone() };
    // As on a board, the bus is there for ever.
    let bus: &'static Bus<Imitation> =
        Box::leak(Box::new(Bus::new(block('s'), block('d'), block('p'))));
    hardware.borrow_mut().memory = Some((bus.buffers().out(), bus.buffers().back()));
    bus.start();
    (bus, hardware)
}

/// Five chips that were started.
fn hand(controller: Controller) -> ([Gauges; 5], Rc<RefCell<Hardware>>) {
    let (bus, hardware) = built(controller);
    let chips = [0, 1, 2, 3, 4].map(|line| {
        let chip = Chip::new(bus, line, NoDelay);
        let mut gauges = Overlapped::new(Ads131m08::polled(chip, NoDelay, Settings::GAUGES));
        gauges.start().unwrap();
        gauges
    });
    hardware.borrow_mut().by_processor = 0;
    (chips, hardware)
}

/// Polls all in turn until each has given `readings`.
fn read(chips: &mut [Gauges; 5], readings: usize) {
    let mut got = [0; 5];
    for _ in 0..200 * readings {
        for (line, chip) in chips.iter_mut().enumerate() {
            if let Some(channels) = chip.poll().unwrap() {
                assert_eq!(channels, counts(line as i32));
                got[line] += 1;
            }
        }
        if got.iter().all(|count| *count >= readings) {
            return;
        }
    }
    panic!("{got:?} of {readings} readings");
}

#[test]
fn five_chips_are_read_without_the_processor() {
    for slow in [0, 1, 3, 17] {
        let (mut chips, hardware) = hand(Controller::Works);
        hardware.borrow_mut().slow = slow;
        read(&mut chips, 20);
        let hardware = hardware.borrow();
        assert_eq!(hardware.by_processor, 0, "but for starting them");
        assert!(hardware.by_dma >= 100 * FRAME);
    }
}

#[test]
fn a_frame_is_exactly_these_writes() {
    let (bus, hardware) = built(Controller::Works);
    let mut chip = Chip::new(bus, 2, NoDelay);
    hardware.borrow_mut().written.clear();
    let frame: [u8; FRAME] = core::array::from_fn(|i| i as u8);
    assert_eq!(chip.begin(&frame), Ok(true));
    let memory = |bytes: &[AtomicU8]| bytes.as_ptr() as usize as u32;
    let begun = [
        // PC2 low; the SPI may ask for what came in.
        ('p', 0x18, 1 << 18),
        ('s', 0x04, 1),
        // All flags of streams 0 and 3.
        ('d', 0x08, 0x0f40_003d),
        // Stream 0: channel 3, high priority, memory counts up, from the peripheral.
        ('d', 0x10, 0x0602_0400),
        ('d', 0x14, 30),
        ('d', 0x18, 0x4001_300c),
        ('d', 0x1c, memory(bus.buffers().back())),
        ('d', 0x24, 0),
        ('d', 0x10, 0x0602_0401),
        // Stream 3: channel 3, medium priority, memory counts up, to the peripheral.
        ('d', 0x58, 0x0601_0440),
        ('d', 0x5c, 30),
        ('d', 0x60, 0x4001_300c),
        ('d', 0x64, memory(bus.buffers().out())),
        ('d', 0x6c, 0),
        ('d', 0x58, 0x0601_0441),
        // Now the first byte is asked for.
        ('s', 0x04, 3),
    ];
    assert_eq!(std::mem::take(&mut hardware.borrow_mut().written), begun);
    let mut back = [0; FRAME];
    while !chip.fetch(&mut back).unwrap() {}
    assert_eq!(hardware.borrow().written, [('s', 0x04, 0), ('p', 0x18, 0x1f)]);
    assert_eq!(back[..2], [0xff, 0x28], "a chip that has just begun says that it is ready");
    // It is fetched once, and only by whom it is for.
    assert_eq!(chip.fetch(&mut back), Err(ErrorKind::Other));
}

#[test]
fn without_a_controller_the_processor_carries_frames() {
    let (mut chips, hardware) = hand(Controller::Absent);
    read(&mut chips, 5);
    let hardware = hardware.borrow();
    assert!(hardware.by_dma == 0 && hardware.by_processor >= 25 * FRAME);
}

#[test]
fn a_transaction_waits_for_the_frame_of_another() {
    let (bus, hardware) = built(Controller::Works);
    let [mut first, mut second] = [0, 1].map(|line| Chip::new(bus, line, NoDelay));
    hardware.borrow_mut().chips[0].show([5; 8]);
    let mut expected = hardware.borrow().chips[0].clone().answer_to_nothing();
    assert_eq!(first.begin(&[0; FRAME]), Ok(true));
    assert_eq!(second.begin(&[0; FRAME]), Ok(false), "the bus is taken");
    assert_eq!(second.fetch(&mut [0; FRAME]), Err(ErrorKind::Other), "nothing was begun");
    let mut other = hardware.borrow().chips[1].clone().answer_to_nothing();
    let mut bytes = [0; FRAME];
    second.transfer_in_place(&mut bytes).unwrap();
    assert_eq!(bytes, other);
    assert_eq!(second.begin(&[0; FRAME]), Ok(false), "it was not fetched yet");
    assert_eq!(first.fetch(&mut bytes), Ok(true));
    assert_eq!(bytes, expected);
    // A frame that is begun again is another one.
    hardware.borrow_mut().chips[0].show([6; 8]);
    assert_eq!(first.begin(&[0; FRAME]), Ok(true));
    hardware.borrow_mut().chips[0].show([7; 8]);
    expected = hardware.borrow().chips[0].clone().answer_to_nothing();
    assert_eq!(first.begin(&[0; FRAME]), Ok(true));
    while !first.fetch(&mut bytes).unwrap() {}
    assert_eq!(bytes[3..27], expected[3..27]);
    other[0] = 0;
    for frame in [&other[..0], &[0; LONGEST + 1]] {
        assert_eq!(first.begin(frame), Err(ErrorKind::Other));
    }
}

#[test]
fn what_goes_wrong_is_told_and_mended() {
    let (mut chips, hardware) = hand(Controller::Works);
    // Transfer and direct mode, of the stream that comes in and of that which goes out.
    let failed = Err(DriverError::Bus(ErrorKind::Overrun));
    for flag in [3, 2, 25, 24] {
        hardware.borrow_mut().controller = Controller::Fails(1 << flag);
        assert_eq!(chips[3].poll(), Ok(None));
        assert_eq!((chips[3].poll(), hardware.borrow().selected()), (failed, None), "{flag}");
    }
    // One that stands still for ever is the others' wait until its own driver starts anew.
    hardware.borrow_mut().controller = Controller::Stalls;
    for _ in 0..3 {
        assert_eq!((chips[1].poll(), chips[2].poll()), (Ok(None), Ok(None)));
    }
    assert!(chips[1].is_under_way() && !chips[2].is_under_way());
    hardware.borrow_mut().controller = Controller::Works;
    hardware.borrow_mut().slow = u32::MAX;
    chips[1].start().unwrap();
    hardware.borrow_mut().slow = 2;
    read(&mut chips, 3);
    // So it is when another one starts: the frame is lost, and that is said.
    hardware.borrow_mut().controller = Controller::Stalls;
    assert_eq!(chips[1].poll(), Ok(None));
    chips[2].start().unwrap();
    assert_eq!(chips[1].poll(), failed);
    hardware.borrow_mut().controller = Controller::Works;
    // Noise and absence are seen through DMA as they are otherwise.
    hardware.borrow_mut().chips[4].set_fault(Fault::Noise);
    let error = (0..50).find_map(|_| chips[4].poll().err());
    assert!(matches!(error, Some(DriverError::Crc { .. })), "{error:?}");
    hardware.borrow_mut().chips[4].set_fault(Fault::Missing);
    let error = (0..50).find_map(|_| chips[4].poll().err());
    assert_eq!(error, Some(DriverError::Missing));
    hardware.borrow_mut().chips[4].set_fault(Fault::None);
    read(&mut chips, 3);
}

#[test]
fn a_chip_that_cannot_be_started_again_leaves_the_bus_to_the_others() {
    for controller in [Controller::Works, Controller::Stalls] {
        let (mut chips, hardware) = hand(Controller::Works);
        hardware.borrow_mut().controller = controller;
        assert_eq!(chips[0].poll(), Ok(None));
        assert!(chips[0].is_under_way());
        hardware.borrow_mut().chips[0].set_fault(Fault::Missing);
        assert_eq!(chips[0].start(), Err(DriverError::Missing));
        hardware.borrow_mut().controller = Controller::Works;
        assert_eq!(chips[1].poll(), Ok(None));
        assert!(chips[1].is_under_way());
    }
}

#[test]
fn starting_is_exactly_these_writes() {
    let (_, hardware) = built(Controller::Works);
    // Everybody deselected; master, second edge, an eighth of the clock, software selection; then on.
    let started = [('p', 0x18, 0x1f), ('s', 0x00, 0x315), ('s', 0x00, 0x355)];
    assert_eq!(hardware.borrow().written, started);
}

/// Adds up what is waited.
#[derive(Clone, Default)]
struct Watch(Rc<RefCell<u32>>);

impl DelayNs for Watch {
    fn delay_ns(&mut self, ns: u32) {
        *self.0.borrow_mut() += ns;
    }
}

#[test]
fn a_transaction_is_its_operations_in_order() {
    let (bus, hardware) = built(Controller::Works);
    let watch = Watch::default();
    // There are five lines: a larger number stands for the last.
    let mut chip = Chip::new(bus, 7, watch.clone());
    let answer = hardware.borrow().chips[4].clone().answer_to_nothing();
    let (mut read, mut more, mut less, mut both) = ([0; 3], [0; 4], [0; 1], [9, 8]);
    let outcome = chip.transaction(&mut [
        Operation::Read(&mut read),
        Operation::Write(&[1, 2]),
        Operation::DelayNs(700),
        Operation::Transfer(&mut more, &[3]),
        Operation::Transfer(&mut less, &[4, 5, 6]),
        Operation::TransferInPlace(&mut both),
    ]);
    assert_eq!((outcome, *watch.0.borrow()), (Ok(()), 700));
    let hardware = hardware.borrow();
    assert_eq!(hardware.sent, [0, 0, 0, 1, 2, 3, 0, 0, 0, 4, 5, 6, 9, 8]);
    assert_eq!((&read[..], &more[..]), (&answer[..3], &answer[5..9]));
    assert_eq!((&less[..], &both[..]), (&answer[9..10], &answer[12..14]));
    let lines: Vec<u32> = hardware.written.iter().filter(|w| w.0 == 'p').map(|w| w.2).collect();
    assert_eq!(lines, [0x1f, 1 << 20, 0x1f]);
}

#[test]
fn what_is_wrong_with_the_spi_is_told() {
    let faults = [
        (Peripheral::Overruns, ErrorKind::Overrun),
        (Peripheral::Faults, ErrorKind::ModeFault),
        (Peripheral::NeverEmpty, ErrorKind::Other),
        (Peripheral::NeverFull, ErrorKind::Other),
        (Peripheral::Busy, ErrorKind::Other),
    ];
    for controller in [Controller::Works, Controller::Absent] {
        for (fault, error) in faults {
            let (bus, hardware) = built(controller);
            let [mut first, mut second] = [0, 1].map(|line| Chip::new(bus, line, NoDelay));
            hardware.borrow_mut().peripheral = fault;
            let mut bytes = [0; FRAME];
            assert_eq!(first.transfer_in_place(&mut bytes), Err(error), "{fault:?}");
            assert_eq!(hardware.borrow().selected(), None, "{fault:?}");
            if fault == Peripheral::NeverEmpty {
                assert_eq!(hardware.borrow().by_processor, 0, "written to a full register");
            }
            // A frame that the processor carries fails at once, one by DMA where its end is awaited.
            let begun = first.begin(&[0; FRAME]);
            if controller == Controller::Absent {
                assert_eq!(begun, Err(error), "{fault:?}");
                assert_eq!(first.fetch(&mut bytes), Err(ErrorKind::Other), "{fault:?}");
            } else if fault == Peripheral::Busy {
                assert_eq!(begun, Ok(true));
                let end = (0..10).find_map(|_| first.fetch(&mut bytes).err());
                assert_eq!(end, Some(ErrorKind::Overrun));
            } else {
                continue;
            }
            assert_eq!(hardware.borrow().selected(), None, "{fault:?}");
            // The bus is another's at once, and works.
            hardware.borrow_mut().peripheral = Peripheral::Works;
            hardware.borrow_mut().spi[2] = 0;
            assert_eq!(second.begin(&[0; FRAME]), Ok(true), "{fault:?}");
            let answer = hardware.borrow().chips[1].clone().answer_to_nothing();
            while !second.fetch(&mut bytes).unwrap() {}
            assert_eq!(bytes[3..27], answer[3..27], "{fault:?}");
        }
    }
}
