//! Bytes to and from a board, and the conversation over them.
//!
//! A [`Link`] moves bytes: over [`tcp`], to a board emulated by [`qemu`], or to a
//! [`virtual_board`] in this process. [`Faulty`] and [`Recorder`] wrap any of them. A [`Session`]
//! speaks the protocol of [`tactile_core::wire`] over a link and feeds grasp logs through it.

pub mod cycles;
pub mod fault;
pub mod firmware;
pub mod lesson;
pub mod qemu;
pub mod recorder;
pub mod session;
pub mod tcp;
pub mod virtual_board;

use std::io;
use std::time::Duration;

pub use fault::{Faults, Faulty};
pub use lesson::Lesson;
pub use recorder::Recorder;
pub use session::{FeltContact, GraspOutcome, LogOutcome, Patience, Session, SessionError};

/// Bytes both ways.
pub trait Link {
    /// Sends all bytes.
    ///
    /// # Errors
    /// When the other side is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits at most `timeout` for bytes, moves what has come into `bytes` and returns how many;
    /// 0 when none came. A link that knows that nothing will come does not wait.
    ///
    /// # Errors
    /// When the other side is gone.
    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize>;
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        (**self).send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        (**self).receive(bytes, timeout)
    }
}

impl<L: Link + ?Sized> Link for &mut L {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        (**self).send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        (**self).receive(bytes, timeout)
    }
}
