//! One board at a time, chosen by feature.

#[cfg(feature = "mps2-an386")]
mod mps2_an386;
#[cfg(feature = "stm32f405")]
mod stm32f405;

#[cfg(feature = "mps2-an386")]
pub use mps2_an386::{Mps2An386 as Selected, instruction_timer};
#[cfg(feature = "stm32f405")]
pub use stm32f405::{Chip, Delay, Ready, Stm32f405 as Selected, chip, ready};
