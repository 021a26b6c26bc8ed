//! Boards for `tactile_core::device::Device`: clock, UART, stack; empty on a host.
//!
//! A panic or a fault restarts the board, which then refuses commands until it is greeted: the host
//! knows that the belief is gone.
#![cfg_attr(target_os = "none", no_std)]

#[cfg(target_os = "none")]
pub mod board;
#[cfg(target_os = "none")]
mod registers;
#[cfg(target_os = "none")]
mod rescue;
#[cfg(target_os = "none")]
pub mod stack;
