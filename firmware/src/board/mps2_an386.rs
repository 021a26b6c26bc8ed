//! ARM MPS2 with the AN386 image, as QEMU emulates it: CMSDK UART 0 and timer 0 at 25 MHz. With
//! `-icount` the timer counts instructions, which is what this board is for.

use tactile_core::device::{Board, Vitals};
use tactile_core::wire::BoardKind;

use crate::registers::{Block, Registers, Wake};
use crate::stack;

const CLOCK: u32 = 25_000_000;
const BAUD: u32 = 115_200;
const UART_RX_INTERRUPT: usize = 0;

// SAFETY: base addresses of the AN386 memory map; this file is the only user of each.
const TIMER: Registers = unsafe { Registers::at(0x4000_0000) };
// SAFETY: as above.
const UART: Registers = unsafe { Registers::at(0x4000_4000) };

const DATA: usize = 0x00;
const STATE: usize = 0x04;
const CONTROL: usize = 0x08;
const INTERRUPT_CLEAR: usize = 0x0c;
const DIVIDER: usize = 0x10;
const TX_FULL: u32 = 1;
const RX_FULL: u32 = 1 << 1;
const RX_OVERRUN: u32 = 1 << 3;

/// The board. Make one only.
pub struct Mps2An386 {
    wake: Wake,
    overruns: u32,
    ticks: u32,
    /// Ticks of the timer since the start, beyond its 32 bits.
    elapsed: u64,
}

/// The timer, counting up at 25 MHz; start the board first.
#[inline(always)]
pub fn instruction_timer() -> u32 {
    !TIMER.read(0x04)
}

impl Mps2An386 {
    /// Sets up UART and timer.
    pub fn start() -> Self {
        TIMER.write(0x08, u32::MAX);
        TIMER.write(0x04, u32::MAX);
        TIMER.write(0x00, 1);
        UART.write(DIVIDER, CLOCK / BAUD);
        // Transmitter, receiver, and the receiver's interrupt to wake from sleep.
        UART.write(CONTROL, 1 | 1 << 1 | 1 << 3);
        Mps2An386 {
            wake: Wake::on(UART_RX_INTERRUPT),
            overruns: 0,
            ticks: instruction_timer(),
            elapsed: 0,
        }
    }
}

impl Board for Mps2An386 {
    const KIND: BoardKind = BoardKind::Mps2An386;

    fn now(&mut self) -> u32 {
        let ticks = instruction_timer();
        self.elapsed += u64::from(ticks.wrapping_sub(self.ticks));
        self.ticks = ticks;
        (self.elapsed / u64::from(CLOCK / 1_000_000)) as u32
    }

    fn receive(&mut self, bytes: &mut [u8], wait: bool) -> usize {
        let mut count = 0;
        while let Some(slot) = bytes.get_mut(count) {
            let state = UART.read(STATE);
            if state & RX_OVERRUN != 0 {
                self.overruns = self.overruns.saturating_add(1);
                UART.write(STATE, RX_OVERRUN);
            }
            if state & RX_FULL != 0 {
                *slot = UART.read(DATA) as u8;
                count += 1;
            } else if count > 0 || !wait {
                break;
            } else {
                self.wake.sleep();
                UART.write(INTERRUPT_CLEAR, 1 << 1);
            }
        }
        count
    }

    fn send(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            while UART.read(STATE) & TX_FULL != 0 {}
            UART.write(DATA, byte.into());
        }
    }

    fn vitals(&mut self) -> Vitals {
        Vitals { overruns: self.overruns, peak_stack: stack::peak(), stack: stack::size() }
    }
}
