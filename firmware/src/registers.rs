//! Reading and writing a peripheral's registers: with the stack's ends, every access to memory by its address.

#[cfg(target_os = "none")]
use core::ptr;

/// The 32-bit registers of a peripheral, each by its offset in bytes. A board has `Registers`, a
/// test an imitation.
pub trait Block {
    /// The register's value.
    fn read(&self, offset: usize) -> u32;

    /// Sets the register.
    fn write(&self, offset: usize, value: u32);

    /// Where the register is, for a DMA controller.
    fn address(&self, offset: usize) -> u32;

    /// Clears the bits of `clear`, then sets those of `set`.
    #[inline(always)]
    fn change(&self, offset: usize, clear: u32, set: u32) {
        self.write(offset, (self.read(offset) & !clear) | set);
    }

    /// Whether all bits of `mask` become 1 within `tries` readings. Never waits for ever: an
    /// emulator's clock control, or a missing crystal, never answers.
    fn becomes(&self, offset: usize, mask: u32, tries: u32) -> bool {
        (0..tries).any(|_| self.read(offset) & mask == mask)
    }
}

/// A block of registers of this chip.
#[cfg(target_os = "none")]
#[derive(Clone, Copy)]
pub struct Registers {
    base: usize,
}

#[cfg(target_os = "none")]
impl Registers {
    /// The block that starts at `base`.
    ///
    /// # Safety
    /// The offsets later used must be registers of a peripheral of this chip, and nobody else may
    /// use them in a way that the owner does not expect.
    pub const unsafe fn at(base: usize) -> Self {
        Registers { base }
    }
}

#[cfg(target_os = "none")]
impl Block for Registers {
    #[inline(always)]
    fn read(&self, offset: usize) -> u32 {
        // SAFETY: a register of this block, by the contract of `at`; 32-bit aligned.
        unsafe { ptr::read_volatile((self.base + offset) as *const u32) }
    }

    #[inline(always)]
    fn write(&self, offset: usize, value: u32) {
        // SAFETY: as for `read`.
        unsafe { ptr::write_volatile((self.base + offset) as *mut u32, value) }
    }

    #[inline(always)]
    fn address(&self, offset: usize) -> u32 {
        (self.base + offset) as u32
    }
}

/// Lets interrupt `number` call the default handler.
#[cfg(all(target_os = "none", feature = "stm32f405"))]
pub fn listen(number: usize) {
    enable(number);
    // SAFETY: the handlers share nothing with the main loop but atomics.
    unsafe { cortex_m::interrupt::enable() };
}

/// Sets an interrupt's bit and returns the register's offset and the bit.
#[cfg(target_os = "none")]
fn enable(number: usize) -> (Registers, usize, u32) {
    // SAFETY: the set-enable and clear-pending registers of the NVIC, which no one else uses.
    let controller = unsafe { Registers::at(0xe000_e100) };
    let (word, bit) = (4 * (number / 32), 1 << (number % 32));
    controller.write(word, bit);
    (controller, word, bit)
}

/// The interrupt controller, used only to wake the processor: no handler ever runs.
#[cfg(all(target_os = "none", feature = "mps2-an386"))]
pub struct Wake {
    controller: Registers,
    word: usize,
    bit: u32,
}

#[cfg(all(target_os = "none", feature = "mps2-an386"))]
impl Wake {
    /// Lets interrupt `number` wake the processor, with all handlers masked.
    pub fn on(number: usize) -> Self {
        cortex_m::interrupt::disable();
        let (controller, word, bit) = enable(number);
        Wake { controller, word, bit }
    }

    /// Sleeps until the interrupt is pending; returns at once when it already is.
    pub fn sleep(&self) {
        cortex_m::asm::wfi();
        self.controller.write(0x180 + self.word, self.bit);
    }
}
