//! Boards for `tactile_core::device::Device`: clock, UART, stack. On a host there is only what needs
//! no hardware, for its tests.
//!
//! A panic or a fault restarts the board, which then refuses commands until it is greeted: the host
//! knows that the belief is gone.
#![cfg_attr(target_os = "none", no_std)]

#[cfg(target_os = "none")]
pub mod board;
pub mod bus;
#[cfg(all(target_os = "none", feature = "mps2-an386", feature = "semihosting"))]
pub mod counter;
#[cfg(all(target_os = "none", feature = "stm32f405"))]
mod inbox;
pub mod registers;
#[cfg(target_os = "none")]
mod rescue;
#[cfg(target_os = "none")]
pub mod stack;

/// A whole image: a device of this type obeys the board's UART for ever. With a second argument,
/// what turns the board into one with sensors. On a host an empty `main`.
#[macro_export]
macro_rules! image {
    ($device:ident) => {
        $crate::image!($device, core::convert::identity);
    };
    ($device:ident, $sensors:expr) => {
        #[cfg(not(target_os = "none"))]
        fn main() {}

        #[cfg(target_os = "none")]
        mod firmware {
            use tactile_core::device::$device;
            use tactile_firmware::board::Selected;

            #[cortex_m_rt::entry]
            fn main() -> ! {
                static mut DEVICE: $device = $device::START;
                let mut board = ($sensors)(Selected::start());
                loop {
                    DEVICE.run(&mut board);
                }
            }
        }
    };
}
