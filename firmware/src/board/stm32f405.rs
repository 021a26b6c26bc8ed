//! STM32F405 (reference manual RM0090) by its registers: `USART1` on PA9 (out) and PA10 (in), `TIM2`
//! as the microsecond clock. The same image runs on silicon and on QEMU's `netduinoplus2`.

mod spi;

use cortex_m_rt::exception;
use tactile_core::device::{Board, Vitals};
use tactile_core::wire::BoardKind;

use crate::inbox::Inbox;
use crate::registers::{Block, Registers, listen};
use crate::stack;

pub use spi::{Chip, Delay, Ready, chip, ready};

/// Frequency of the crystal, for `TACTILE_HSE_HZ` at build time; 8 MHz on most boards.
const CRYSTAL: u32 = number(option_env!("TACTILE_HSE_HZ"), 8_000_000);
/// Speed of the UART, for `TACTILE_BAUD` at build time.
const BAUD: u32 = number(option_env!("TACTILE_BAUD"), 115_200);

// The PLL divides by whole megahertz; the UART by 16 to 65535, of 84 MHz and of the 16 MHz without the crystal.
const _: () = assert!(
    CRYSTAL.is_multiple_of(1_000_000) && CRYSTAL >= 4_000_000 && CRYSTAL <= 26_000_000,
    "TACTILE_HSE_HZ: a crystal of 4 to 26 whole megahertz"
);
const _: () = assert!(BAUD >= 1_300 && BAUD <= 1_000_000, "TACTILE_BAUD: from 1300 to 1000000");
/// Internal oscillator.
const INTERNAL: u32 = 16_000_000;
/// Readings of a flag before it is given up: milliseconds, several times what the manual asks.
const TRIES: u32 = 100_000;

// SAFETY: base addresses from the memory map of RM0090; this file is the only user of each.
const RCC: Registers = unsafe { Registers::at(0x4002_3800) };
// SAFETY: as above.
const FLASH: Registers = unsafe { Registers::at(0x4002_3c00) };
// SAFETY: as above.
const GPIOA: Registers = unsafe { Registers::at(0x4002_0000) };
// SAFETY: as above.
const USART1: Registers = unsafe { Registers::at(0x4001_1000) };
// SAFETY: as above.
const TIM2: Registers = unsafe { Registers::at(0x4000_0000) };

const CR: usize = 0x00;
const PLLCFGR: usize = 0x04;
const CFGR: usize = 0x08;
const AHB1ENR: usize = 0x30;
const APB1ENR: usize = 0x40;
const APB2ENR: usize = 0x44;
const HSI_READY: u32 = 1 << 1;
const HSE_ON: u32 = 1 << 16;
const HSE_READY: u32 = 1 << 17;
const PLL_ON: u32 = 1 << 24;
const PLL_READY: u32 = 1 << 25;

const SR: usize = 0x00;
const DR: usize = 0x04;
const BRR: usize = 0x08;
const CR1: usize = 0x0c;
const OVERRUN: u32 = 1 << 3;
const RX_NOT_EMPTY: u32 = 1 << 5;
const TX_EMPTY: u32 = 1 << 7;
const USART1_INTERRUPT: usize = 37;

const COUNT: usize = 0x24;

/// What has come, until the main loop has time: a sensor's estimate takes longer than a byte, and
/// a host may send its next command while contacts are streamed to it.
static INBOX: Inbox = Inbox::new();

/// Takes a byte out of the UART, which holds one only. The one interrupt that is enabled.
#[exception]
unsafe fn DefaultHandler(_number: i16) {
    let status = USART1.read(SR);
    if status & OVERRUN != 0 {
        INBOX.lose();
    }
    // Reading the data also clears the overrun.
    if status & (RX_NOT_EMPTY | OVERRUN) != 0 {
        INBOX.put(USART1.read(DR) as u8);
    }
}

/// The board. Make one only.
pub struct Stm32f405 {
    _private: (),
}

/// Frequencies after start, Hz.
struct Clocks {
    usart: u32,
    timer: u32,
}

impl Stm32f405 {
    /// Sets up clock, pins, UART and timer.
    pub fn start() -> Self {
        let clocks = start_clocks();
        RCC.change(AHB1ENR, 0, 1);
        RCC.change(APB2ENR, 0, 1 << 4);
        RCC.change(APB1ENR, 0, 1);
        // The second access to a peripheral's clock register lets the first take effect (erratum).
        let _ = RCC.read(APB1ENR);

        // TIM2: 32 bits, free running, one step a microsecond; the update event loads the divider.
        TIM2.write(0x28, clocks.timer / 1_000_000 - 1);
        TIM2.write(0x2c, u32::MAX);
        TIM2.write(0x14, 1);
        TIM2.write(CR, 1);

        // PA9 and PA10 to alternate function 7, PA10 pulled up so that an open line stays idle.
        GPIOA.change(0x00, 0xf << 18, 0b1010 << 18);
        GPIOA.change(0x0c, 0xf << 18, 0b0100 << 18);
        GPIOA.change(0x24, 0xff0, 0x770);
        USART1.write(BRR, (clocks.usart + BAUD / 2) / BAUD);
        // UART, transmitter, receiver, and the receiver's interrupt.
        USART1.write(CR1, 1 << 13 | 1 << 3 | 1 << 2 | RX_NOT_EMPTY);
        listen(USART1_INTERRUPT);
        spi::start();
        Stm32f405 { _private: () }
    }
}

/// 168 MHz from the crystal, or from the internal oscillator when the crystal does not start, or
/// 16 MHz when the PLL does not lock.
fn start_clocks() -> Clocks {
    if RCC.read(CR) & HSI_READY == 0 {
        // A chip that runs this line has its oscillator ready. QEMU's clock control reads zero, and
        // its timer counts nanoseconds.
        return Clocks { usart: INTERNAL, timer: 1_000_000_000 };
    }
    RCC.change(CR, 0, HSE_ON);
    let crystal = RCC.becomes(CR, HSE_READY, TRIES);
    let megahertz = if crystal { CRYSTAL } else { INTERNAL } / 1_000_000;
    // 1 MHz · 336 / 2 = 168 MHz; / 7 = 48 MHz.
    let source = if crystal { 1 << 22 } else { 0 };
    RCC.write(PLLCFGR, 7 << 24 | source | 336 << 6 | megahertz);
    RCC.change(CR, 0, PLL_ON);
    if !RCC.becomes(CR, PLL_READY, TRIES) {
        return Clocks { usart: INTERNAL, timer: INTERNAL };
    }
    // Five wait states, prefetch, instruction and data caches.
    FLASH.write(0x00, 5 | 1 << 8 | 1 << 9 | 1 << 10);
    // APB1 at 42 MHz (its timers at 84), APB2 at 84 MHz.
    RCC.change(CFGR, 0b111 << 10 | 0b111 << 13, 0b101 << 10 | 0b100 << 13);
    RCC.change(CFGR, 0b11, 0b10);
    if RCC.becomes(CFGR, 0b10 << 2, TRIES) {
        Clocks { usart: 84_000_000, timer: 84_000_000 }
    } else {
        // Still on the internal oscillator, behind the dividers just set.
        RCC.change(CFGR, 0b11 | 0b111 << 10 | 0b111 << 13, 0);
        Clocks { usart: INTERNAL, timer: INTERNAL }
    }
}

impl Board for Stm32f405 {
    const KIND: BoardKind = BoardKind::Stm32f405;

    fn now(&mut self) -> u32 {
        TIM2.read(COUNT)
    }

    fn receive(&mut self, bytes: &mut [u8], wait: bool) -> usize {
        let mut count = 0;
        while let Some(slot) = bytes.get_mut(count) {
            match INBOX.take() {
                Some(byte) => {
                    *slot = byte;
                    count += 1;
                }
                None if count > 0 || !wait => break,
                // With the handler held back a byte that comes before the sleep ends it at once.
                None => cortex_m::interrupt::free(|_| {
                    if INBOX.is_empty() {
                        cortex_m::asm::wfi();
                    }
                }),
            }
        }
        count
    }

    fn send(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            // A byte leaves within 11 bit times whatever the other side does: this wait ends.
            while USART1.read(SR) & TX_EMPTY == 0 {}
            USART1.write(DR, byte.into());
        }
    }

    fn vitals(&mut self) -> Vitals {
        Vitals { overruns: INBOX.lost(), peak_stack: stack::peak(), stack: stack::size() }
    }
}

/// A decimal number given at build time, or the default; not a number stops the build.
const fn number(digits: Option<&str>, default: u32) -> u32 {
    let Some(digits) = digits else { return default };
    let (bytes, mut value, mut i) = (digits.as_bytes(), 0_u32, 0);
    assert!(!bytes.is_empty(), "a whole number of hertz or baud");
    while i < bytes.len() {
        assert!(bytes[i].is_ascii_digit(), "a whole number of hertz or baud");
        value = value * 10 + (bytes[i] - b'0') as u32;
        i += 1;
    }
    value
}
