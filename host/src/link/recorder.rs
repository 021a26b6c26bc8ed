//! A link that writes down what passes.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use crate::log::recording::{Direction, Header, RecordingWriter};

use super::Link;

/// Bytes without a delimiter after which they are written down as they are.
const LONGEST: usize = 1024;

/// A link whose frames go into a recording, both directions, with the host's time.
pub struct Recorder<L, W: Write> {
    link: L,
    writer: RecordingWriter<W>,
    start: Instant,
    /// What has come since the last delimiter.
    partial: Vec<u8>,
}

impl<L: Link, W: Write> Recorder<L, W> {
    /// Wraps `link`; the header is written at once.
    ///
    /// # Errors
    /// When `file` cannot be written.
    pub fn new(link: L, file: W, header: &Header) -> io::Result<Self> {
        let writer = RecordingWriter::new(file, header)?;
        Ok(Recorder { link, writer, start: Instant::now(), partial: Vec::new() })
    }

    fn now(&self) -> Duration {
        self.start.elapsed()
    }
}

impl<L: Link, W: Write> Link for Recorder<L, W> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.writer.append(self.now(), Direction::ToBoard, bytes)?;
        self.link.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.link.receive(bytes, timeout)?;
        for &byte in bytes.get(..count).unwrap_or(&[]) {
            self.partial.push(byte);
            if byte == 0 || self.partial.len() == LONGEST {
                let now = self.now();
                self.writer.append(now, Direction::FromBoard, &self.partial)?;
                self.partial.clear();
            }
        }
        Ok(count)
    }
}
