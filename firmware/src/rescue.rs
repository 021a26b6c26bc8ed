//! What happens when something cannot go on: restart, or tell QEMU.

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, exception};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    give_up(info)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    give_up(frame)
}

#[cfg(not(feature = "semihosting"))]
fn give_up<T>(_: &T) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

#[cfg(feature = "semihosting")]
fn give_up<T: core::fmt::Debug>(reason: &T) -> ! {
    use cortex_m_semihosting::{debug, hprintln};
    hprintln!("{:?}", reason);
    loop {
        debug::exit(debug::EXIT_FAILURE);
    }
}
