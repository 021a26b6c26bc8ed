//! Counts instructions in QEMU, for the images that print what the core costs.

use cortex_m::asm;
use cortex_m_semihosting::{debug, hprintln};

use crate::board::instruction_timer;

/// Counts instructions: under `-icount` every instruction takes the same time.
///
/// What is counted stands between two `SEV`, which nothing else here executes and which do nothing
/// on a single core: a trace of the run shows what every printed number was counted over.
pub struct Counter {
    empty: u32,
    ticks_per_instruction: f32,
}

impl Counter {
    /// Finds out how fast the timer runs; start the board first.
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        let empty = ticks(|| ());
        // Three thousand instructions that no compiler removes.
        let known = ticks(|| {
            for _ in 0..1000 {
                asm::nop();
            }
        });
        Counter { empty, ticks_per_instruction: (known - empty) as f32 / 3000.0 }
    }

    /// Instructions that `run` takes.
    pub fn count(&self, run: impl FnOnce()) -> u32 {
        let spent = ticks(run).wrapping_sub(self.empty);
        (spent as f32 / self.ticks_per_instruction) as u32
    }

    /// Prints instructions that `run` takes.
    pub fn report(&self, what: &str, run: impl FnOnce()) {
        print(what, self.count(run));
    }
}

#[inline(never)]
fn ticks(run: impl FnOnce()) -> u32 {
    let start = instruction_timer();
    asm::sev();
    run();
    asm::sev();
    instruction_timer().wrapping_sub(start)
}

/// One line of the table, as every count is printed.
pub fn print(what: &str, count: u32) {
    hprintln!("{:<48} {:>10}", what, count);
}

/// One line of a table with a column before the count, as [`print`] prints it.
pub fn print_beside(what: &str, floor: usize, count: impl FnOnce() -> u32) {
    hprintln!("{:<48} {:>10} {:>10}", what, floor, count());
}

/// Ends the run as failed: what was counted is not what should have been.
pub fn unlike(what: &impl core::fmt::Debug) {
    hprintln!("not what was to be counted: {:?}", what);
    debug::exit(debug::EXIT_FAILURE);
}
