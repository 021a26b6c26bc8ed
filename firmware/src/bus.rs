//! An SPI bus of an STM32F4 whose frames are carried by DMA (reference manual RM0090, chapters 10
//! and 28): `SPI1` with streams 0 (in) and 3 (out) of `DMA2`, channel 3, one chip-select line for
//! each device.
//!
//! ```text
//! begin   select, both streams on, the SPI asks for bytes   ~0.5 µs of the processor
//!         … 23 µs at 10.5 MHz in which it does something else …
//! fetch   the last byte is in: deselect, copy
//! ```
//!
//! Where there is no DMA controller, as in QEMU, the processor carries the frames itself. Nothing
//! here waits without a bound, and no interrupt is used: the state is that of the main loop.
//!
//! Erratum 2.1.10 of the F405 ("DMA2 data corruption when managing AHB and APB2 peripherals in a
//! concurrent way") does not arise as long as `DMA2` serves no peripheral but this one.

use core::sync::atomic::{AtomicU8, Ordering, fence};

use tactile_core::driver::background::BackgroundDevice;
use tactile_core::driver::embedded_hal::delay::DelayNs;
use tactile_core::driver::embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use crate::registers::Block;

/// Chip-select lines: pins 0 to 4 of their port.
pub const LINES: u32 = 5;
const SELECTS: u32 = (1 << LINES) - 1;
/// Longest frame that DMA carries, bytes: an ADS131M08's has 30.
pub const LONGEST: usize = 32;

/// Registers of the SPI and their bits.
mod spi {
    pub const CR1: usize = 0x00;
    pub const CR2: usize = 0x04;
    pub const SR: usize = 0x08;
    pub const DR: usize = 0x0c;
    pub const RX_DMA: u32 = 1;
    pub const TX_DMA: u32 = 1 << 1;
    pub const RX_NOT_EMPTY: u32 = 1;
    pub const TX_EMPTY: u32 = 1 << 1;
    pub const MODE_FAULT: u32 = 1 << 5;
    pub const OVERRUN: u32 = 1 << 6;
    pub const BUSY: u32 = 1 << 7;
}

/// Registers of the DMA controller, its two streams and their bits.
mod dma {
    /// Flags of streams 0 to 3.
    pub const FLAGS: usize = 0x00;
    pub const CLEAR: usize = 0x08;
    /// First register of a stream.
    pub const IN: usize = 0x10;
    pub const OUT: usize = 0x10 + 3 * 0x18;
    /// Of a stream: settings, number of bytes, peripheral, memory, queue.
    pub const CR: usize = 0x00;
    pub const COUNT: usize = 0x04;
    pub const PERIPHERAL: usize = 0x08;
    pub const MEMORY: usize = 0x0c;
    pub const QUEUE: usize = 0x14;
    pub const ENABLE: u32 = 1;
    /// Channel 3, bytes, memory address counts up; the stream that comes in goes first.
    pub const FROM_SPI: u32 = 3 << 25 | 0b10 << 16 | 1 << 10;
    pub const TO_SPI: u32 = 3 << 25 | 0b01 << 16 | 1 << 10 | 0b01 << 6;
    /// Flags of streams 0 and 3: all, transfer complete of the former, errors of transfer and of
    /// direct mode of both.
    pub const ALL: u32 = 0x3d | 0x3d << 22;
    pub const COMPLETE: u32 = 1 << 5;
    pub const ERRORS: u32 = 0b1100 | 0b1100 << 22;
}

/// Readings of a flag before it is given up: a byte takes 0.8 µs, some ten readings; a frame some
/// five hundred.
const TRIES: u32 = 10_000;

/// What DMA reads and writes, in memory that it reaches.
pub struct Buffers {
    out: [AtomicU8; LONGEST],
    back: [AtomicU8; LONGEST],
}

impl Buffers {
    /// Zeros.
    pub const fn new() -> Self {
        let zeros = [const { AtomicU8::new(0) }; LONGEST];
        Buffers { out: zeros, back: [const { AtomicU8::new(0) }; LONGEST] }
    }

    /// What goes out, byte by byte.
    pub fn out(&self) -> &[AtomicU8] {
        &self.out
    }

    /// What comes back.
    pub fn back(&self) -> &[AtomicU8] {
        &self.back
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self::new()
    }
}

/// How the frame fares that DMA carries.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Phase {
    Idle,
    Running,
    Done,
    Failed,
}

/// The bus: SPI, DMA controller and the port of the chip-select lines. Belongs to one thread, which
/// the atomics only say to the compiler.
pub struct Bus<R> {
    spi: R,
    dma: R,
    port: R,
    buffers: Buffers,
    phase: AtomicU8,
    line: AtomicU8,
}

impl<R: Block> Bus<R> {
    /// The bus of an SPI, `DMA2` and the port of the chip-select lines.
    pub const fn new(spi: R, dma: R, port: R) -> Self {
        let (phase, line) = (AtomicU8::new(Phase::Idle as u8), AtomicU8::new(0));
        Bus { spi, dma, port, buffers: Buffers::new(), phase, line }
    }

    /// Deselects everybody and switches the SPI on: master, mode 1, most significant bit first, an
    /// eighth of its clock, which is 10.5 MHz at 84 MHz. The clocks of all three must run.
    pub fn start(&self) {
        self.port.write(BSRR, SELECTS);
        self.spi.write(spi::CR1, 1 | 1 << 2 | 0b010 << 3 | 1 << 8 | 1 << 9);
        self.spi.change(spi::CR1, 0, 1 << 6);
    }

    /// What DMA reads and writes.
    pub fn buffers(&self) -> &Buffers {
        &self.buffers
    }

    fn phase(&self) -> Phase {
        match self.phase.load(Ordering::Relaxed) {
            1 => Phase::Running,
            2 => Phase::Done,
            3 => Phase::Failed,
            _ => Phase::Idle,
        }
    }

    fn enter(&self, phase: Phase) -> Phase {
        self.phase.store(phase as u8, Ordering::Relaxed);
        phase
    }

    fn is_owner(&self, line: u32) -> bool {
        u32::from(self.line.load(Ordering::Relaxed)) == line
    }

    fn select(&self, line: u32) {
        self.port.write(BSRR, 1 << (16 + line));
    }

    /// Ends the selection when the last bit is out; whether that happens in time.
    fn deselect(&self) -> bool {
        let idle = (0..TRIES).any(|_| self.spi.read(spi::SR) & spi::BUSY == 0);
        self.port.write(BSRR, SELECTS);
        idle
    }

    /// One byte out, one in, by the processor.
    fn exchange(&self, byte: u8) -> Result<u8, ErrorKind> {
        if !self.spi.becomes(spi::SR, spi::TX_EMPTY, TRIES) {
            return Err(ErrorKind::Other);
        }
        self.spi.write(spi::DR, byte.into());
        if !self.spi.becomes(spi::SR, spi::RX_NOT_EMPTY, TRIES) {
            return Err(ErrorKind::Other);
        }
        let byte = self.spi.read(spi::DR) as u8;
        match self.spi.read(spi::SR) {
            status if status & spi::OVERRUN != 0 => Err(ErrorKind::Overrun),
            status if status & spi::MODE_FAULT != 0 => Err(ErrorKind::ModeFault),
            _ => Ok(byte),
        }
    }

    /// A stream's settings, all but that it is on.
    fn prepare(&self, stream: usize, settings: u32, memory: &[AtomicU8], count: usize) {
        self.dma.write(stream + dma::CR, settings);
        self.dma.write(stream + dma::COUNT, count as u32);
        self.dma.write(stream + dma::PERIPHERAL, self.spi.address(spi::DR));
        self.dma.write(stream + dma::MEMORY, memory.as_ptr() as usize as u32);
        self.dma.write(stream + dma::QUEUE, 0);
        self.dma.write(stream + dma::CR, settings | dma::ENABLE);
    }

    fn begin(&self, line: u32, frame: &[u8]) -> Result<bool, ErrorKind> {
        if !(1..=LONGEST).contains(&frame.len()) {
            return Err(ErrorKind::Other);
        }
        if self.phase() != Phase::Idle {
            if !self.is_owner(line) {
                return Ok(false);
            }
            self.claim(line);
        }
        for (out, byte) in self.buffers.out.iter().zip(frame) {
            out.store(*byte, Ordering::Relaxed);
        }
        self.line.store(line as u8, Ordering::Relaxed);
        self.select(line);
        // In this order nothing is asked for before both streams can serve it.
        self.spi.write(spi::CR2, spi::RX_DMA);
        self.dma.write(dma::CLEAR, dma::ALL);
        self.prepare(dma::IN, dma::FROM_SPI, &self.buffers.back, frame.len());
        if self.dma.read(dma::IN + dma::CR) & dma::ENABLE == 0 {
            return self.carry(frame).map(|()| true);
        }
        self.prepare(dma::OUT, dma::TO_SPI, &self.buffers.out, frame.len());
        // What was stored above is in memory before it is read from there.
        fence(Ordering::Release);
        self.enter(Phase::Running);
        self.spi.write(spi::CR2, spi::RX_DMA | spi::TX_DMA);
        Ok(true)
    }

    /// The whole frame by the processor, where there is no DMA.
    fn carry(&self, frame: &[u8]) -> Result<(), ErrorKind> {
        self.spi.write(spi::CR2, 0);
        let mut outcome = Ok(());
        for (back, byte) in self.buffers.back.iter().zip(frame) {
            match self.exchange(*byte) {
                Ok(byte) => back.store(byte, Ordering::Relaxed),
                Err(error) => outcome = outcome.and(Err(error)),
            }
        }
        let idle = self.deselect();
        self.enter(if outcome.is_ok() && idle { Phase::Done } else { Phase::Idle });
        outcome.and(if idle { Ok(()) } else { Err(ErrorKind::Other) })
    }

    /// Looks how the frame fares, and ends the selection once it is through.
    fn settle(&self) -> Phase {
        let phase = self.phase();
        if phase != Phase::Running {
            return phase;
        }
        let flags = self.dma.read(dma::FLAGS);
        if flags & dma::ERRORS != 0 {
            return self.stop();
        }
        if flags & dma::COMPLETE == 0 {
            return Phase::Running;
        }
        // Streams switch themselves off at their end.
        self.spi.write(spi::CR2, 0);
        fence(Ordering::Acquire);
        let idle = self.deselect();
        self.enter(if idle { Phase::Done } else { Phase::Failed })
    }

    /// Cuts the frame short.
    fn stop(&self) -> Phase {
        for stream in [dma::OUT, dma::IN] {
            self.dma.change(stream + dma::CR, dma::ENABLE, 0);
            // A stream ends the byte that it is at.
            let _off = (0..TRIES).any(|_| self.dma.read(stream + dma::CR) & dma::ENABLE == 0);
        }
        self.spi.write(spi::CR2, 0);
        self.deselect();
        // A byte that nobody took, and with it an overrun.
        self.spi.read(spi::DR);
        self.spi.read(spi::SR);
        self.enter(Phase::Failed)
    }

    fn fetch(&self, line: u32, frame: &mut [u8]) -> Result<bool, ErrorKind> {
        if !self.is_owner(line) {
            return Err(ErrorKind::Other);
        }
        match self.settle() {
            Phase::Running => Ok(false),
            Phase::Done => {
                for (byte, back) in frame.iter_mut().zip(&self.buffers.back) {
                    *byte = back.load(Ordering::Relaxed);
                }
                self.enter(Phase::Idle);
                Ok(true)
            }
            Phase::Failed => {
                self.enter(Phase::Idle);
                Err(ErrorKind::Overrun)
            }
            Phase::Idle => Err(ErrorKind::Other),
        }
    }

    /// Has the bus for the processor: waits for a frame that is under way, and cuts it short when it
    /// does not end. One of `line` itself is given up: it would keep the others waiting to be fetched.
    fn claim(&self, line: u32) {
        if (0..TRIES).all(|_| self.settle() == Phase::Running) {
            self.stop();
        }
        if self.is_owner(line) {
            self.enter(Phase::Idle);
        }
    }
}

/// Atomic set (lower half) and reset (upper half) of a port's pins.
const BSRR: usize = 0x18;

/// A sensor on the bus. Make one only for each line.
#[derive(Debug)]
pub struct Chip<'a, R, D> {
    bus: &'a Bus<R>,
    line: u32,
    delay: D,
}

impl<R> core::fmt::Debug for Bus<R> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Bus").field("line", &self.line).finish_non_exhaustive()
    }
}

impl<'a, R: Block, D: DelayNs> Chip<'a, R, D> {
    /// The sensor behind chip-select line 0 to 4; a larger number stands for the last.
    pub const fn new(bus: &'a Bus<R>, line: u32, delay: D) -> Self {
        Chip { bus, line: if line < LINES { line } else { LINES - 1 }, delay }
    }

    fn run(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let bus = self.bus;
        for operation in operations {
            match operation {
                Operation::Read(read) => {
                    for r in read.iter_mut() {
                        *r = bus.exchange(0)?;
                    }
                }
                Operation::Write(write) => {
                    for w in write.iter() {
                        bus.exchange(*w)?;
                    }
                }
                Operation::Transfer(read, write) => {
                    for i in 0..read.len().max(write.len()) {
                        let answer = bus.exchange(write.get(i).copied().unwrap_or(0))?;
                        if let Some(r) = read.get_mut(i) {
                            *r = answer;
                        }
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    for b in bytes.iter_mut() {
                        *b = bus.exchange(*b)?;
                    }
                }
                Operation::DelayNs(ns) => self.delay.delay_ns(*ns),
            }
        }
        Ok(())
    }
}

impl<R, D> ErrorType for Chip<'_, R, D> {
    type Error = ErrorKind;
}

impl<R: Block, D: DelayNs> SpiDevice for Chip<'_, R, D> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.bus.claim(self.line);
        self.bus.select(self.line);
        let outcome = self.run(operations);
        let idle = self.bus.deselect();
        outcome.and(if idle { Ok(()) } else { Err(ErrorKind::Other) })
    }
}

impl<R: Block, D: DelayNs> BackgroundDevice for Chip<'_, R, D> {
    fn begin(&mut self, frame: &[u8]) -> Result<bool, ErrorKind> {
        self.bus.begin(self.line, frame)
    }

    fn fetch(&mut self, frame: &mut [u8]) -> Result<bool, ErrorKind> {
        self.bus.fetch(self.line, frame)
    }
}

#[cfg(test)]
mod tests;
