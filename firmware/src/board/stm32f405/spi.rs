//! `SPI1` as the bus of the fingertips' sensors: clock PA5, in PA6, out PA7, and one chip-select line
//! for each sensor, PC0 to PC4. Mode 1, an eighth of the bus clock, no DMA: the processor waits for
//! every byte, 23 µs for a frame of an ADS131M08.

use tactile_core::driver::embedded_hal::delay::DelayNs;
use tactile_core::driver::embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use super::{AHB1ENR, APB2ENR, COUNT, GPIOA, RCC, TIM2};
use crate::registers::Registers;

// SAFETY: base addresses from the memory map of RM0090; this file is the only user of each.
const SPI1: Registers = unsafe { Registers::at(0x4001_3000) };
// SAFETY: as above.
const GPIOC: Registers = unsafe { Registers::at(0x4002_0800) };

const CR1: usize = 0x00;
const SR: usize = 0x08;
const DR: usize = 0x0c;
const RX_NOT_EMPTY: u32 = 1;
const TX_EMPTY: u32 = 1 << 1;
const MODE_FAULT: u32 = 1 << 5;
const OVERRUN: u32 = 1 << 6;
const BUSY: u32 = 1 << 7;
/// Atomic set (lower half) and reset (upper half) of a port's pins.
const BSRR: usize = 0x18;
/// Chip-select lines: pins 0 to 4.
const SELECTS: u32 = 0b1_1111;
/// Readings of a flag before it is given up: a byte takes 0.8 µs, some ten readings.
const TRIES: u32 = 10_000;

/// Sets up pins and peripheral; the clocks of its ports' timers run already.
pub(super) fn start() {
    RCC.change(AHB1ENR, 0, 1 | 1 << 2);
    RCC.change(APB2ENR, 0, 1 << 12);
    // The second access lets the first take effect (erratum).
    let _ = RCC.read(APB2ENR);
    // PA5 to PA7 to alternate function 5, fast.
    GPIOA.change(0x00, 0x3f << 10, 0b10_1010 << 10);
    GPIOA.change(0x08, 0x3f << 10, 0b10_1010 << 10);
    GPIOA.change(0x20, 0xfff << 20, 0x555 << 20);
    // Nobody is selected; then the lines become outputs.
    GPIOC.write(BSRR, SELECTS);
    GPIOC.change(0x00, 0x3ff, 0b01_0101_0101);
    // Master, software chip select, phase 1, divided by eight: 10.5 MHz at full clock.
    SPI1.write(CR1, 1 | 1 << 2 | 0b010 << 3 | 1 << 8 | 1 << 9);
    SPI1.change(CR1, 0, 1 << 6);
}

/// A sensor on the bus. Make one only for each line.
#[derive(Debug)]
pub struct Chip {
    select: u32,
}

impl Chip {
    /// The sensor behind chip-select line 0 to 4; a larger number stands for the last.
    pub fn new(line: u32) -> Self {
        Chip { select: 1 << line.min(4) }
    }

    fn run(operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        for operation in operations {
            match operation {
                Operation::Read(read) => {
                    for r in read.iter_mut() {
                        *r = exchange(0)?;
                    }
                }
                Operation::Write(write) => {
                    for w in write.iter() {
                        exchange(*w)?;
                    }
                }
                Operation::Transfer(read, write) => {
                    for i in 0..read.len().max(write.len()) {
                        let answer = exchange(write.get(i).copied().unwrap_or(0))?;
                        if let Some(r) = read.get_mut(i) {
                            *r = answer;
                        }
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    for b in bytes.iter_mut() {
                        *b = exchange(*b)?;
                    }
                }
                Operation::DelayNs(ns) => Delay.delay_ns(*ns),
            }
        }
        Ok(())
    }
}

/// One byte out, one in.
fn exchange(byte: u8) -> Result<u8, ErrorKind> {
    if !SPI1.becomes(SR, TX_EMPTY, TRIES) {
        return Err(ErrorKind::Other);
    }
    SPI1.write(DR, byte.into());
    if !SPI1.becomes(SR, RX_NOT_EMPTY, TRIES) {
        return Err(ErrorKind::Other);
    }
    let byte = SPI1.read(DR) as u8;
    match SPI1.read(SR) {
        status if status & OVERRUN != 0 => Err(ErrorKind::Overrun),
        status if status & MODE_FAULT != 0 => Err(ErrorKind::ModeFault),
        _ => Ok(byte),
    }
}

impl ErrorType for Chip {
    type Error = ErrorKind;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        GPIOC.write(BSRR, self.select << 16);
        let outcome = Self::run(operations);
        let idle = (0..TRIES).any(|_| SPI1.read(SR) & BUSY == 0);
        GPIOC.write(BSRR, self.select);
        outcome.and(if idle { Ok(()) } else { Err(ErrorKind::Other) })
    }
}

/// Waits by the microsecond clock, and never longer than its readings take.
#[derive(Clone, Copy, Debug)]
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        let us = ns.div_ceil(1000).saturating_add(1);
        let start = TIM2.read(COUNT);
        // A reading takes several cycles of 168 MHz.
        for _ in 0..us.saturating_mul(168) {
            if TIM2.read(COUNT).wrapping_sub(start) >= us {
                return;
            }
        }
    }
}
