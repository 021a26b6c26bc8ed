//! `SPI1` as the bus of the fingertips' sensors: clock PA5, in PA6, out PA7; for each sensor one
//! chip-select line, PC0 to PC4, and one that says when data is ready, PB5 to PB9. Mode 1, an eighth
//! of the bus clock, frames by DMA.

use core::convert::Infallible;

use tactile_core::driver::embedded_hal::delay::DelayNs;
use tactile_core::driver::embedded_hal::digital::{ErrorType, InputPin};

use super::{AHB1ENR, APB2ENR, COUNT, GPIOA, RCC, TIM2};
use crate::bus::{self, Bus, LINES};
use crate::registers::{Block, Registers};

// SAFETY: base addresses from the memory map of RM0090; this file, and `BUS` in its name, is the only
// user of each.
const GPIOB: Registers = unsafe { Registers::at(0x4002_0400) };
// SAFETY: as above.
const GPIOC: Registers = unsafe { Registers::at(0x4002_0800) };
// SAFETY: as above.
const SPI1: Registers = unsafe { Registers::at(0x4001_3000) };
// SAFETY: as above.
const DMA2: Registers = unsafe { Registers::at(0x4002_6400) };

static BUS: Bus<Registers> = Bus::new(SPI1, DMA2, GPIOC);

/// First of the data-ready pins.
const READY: u32 = 5;
/// Levels of a port's pins.
const IDR: usize = 0x10;

/// A sensor on the bus.
pub type Chip = bus::Chip<'static, Registers, Delay>;

/// Sets up pins and peripherals.
pub(super) fn start() {
    // Ports A to C, and DMA2.
    RCC.change(AHB1ENR, 0, 0b111 | 1 << 22);
    RCC.change(APB2ENR, 0, 1 << 12);
    // The second access lets the first take effect (erratum).
    let _ = (RCC.read(AHB1ENR), RCC.read(APB2ENR));
    // PA5 to PA7 to alternate function 5, fast.
    GPIOA.change(0x00, 0x3f << 10, 0b10_1010 << 10);
    GPIOA.change(0x08, 0x3f << 10, 0b10_1010 << 10);
    GPIOA.change(0x20, 0xfff << 20, 0x555 << 20);
    // PB5 to PB9 are inputs, pulled up so that one that is not connected says that nothing is ready.
    GPIOB.change(0x00, 0x3ff << 10, 0);
    GPIOB.change(0x0c, 0x3ff << 10, 0b01_0101_0101 << 10);
    BUS.start();
    // Nobody is selected; now the lines become outputs.
    GPIOC.change(0x00, 0x3ff, 0b01_0101_0101);
}

/// The sensor behind chip-select line 0 to 4, a larger number stands for the last. Ask for each
/// only once.
pub fn chip(line: u32) -> Chip {
    bus::Chip::new(&BUS, line, Delay)
}

/// Data-ready line 0 to 4, a larger number stands for the last.
pub fn ready(line: u32) -> Ready {
    Ready { mask: 1 << (READY + line.min(LINES - 1)) }
}

/// A line that is low while data waits.
#[derive(Clone, Copy, Debug)]
pub struct Ready {
    mask: u32,
}

impl ErrorType for Ready {
    type Error = Infallible;
}

impl InputPin for Ready {
    #[inline]
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(GPIOB.read(IDR) & self.mask != 0)
    }

    #[inline]
    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
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
