//! A link that writes down what passes.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use crate::log::recording::{Direction, Header, RecordingWriter};

use super::Link;

/// Bytes without a delimiter after which they are written down as they are.
const LONGEST: usize = 1024;

/// A link whose frames go into a recording, both directions, with the host's time. What has come of a
/// frame when the link fails, or when this is dropped, is written down, too.
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
}

impl<L, W: Write> Recorder<L, W> {
    /// Writes down what has come since the last delimiter.
    fn write_down(&mut self) -> io::Result<()> {
        if !self.partial.is_empty() {
            let passed = self.start.elapsed();
            let written = self.writer.append(passed, Direction::FromBoard, &self.partial);
            written.map_err(unwritable)?;
            self.partial.clear();
        }
        Ok(())
    }
}

/// It is the recording that fails, and not the link.
fn unwritable(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("the recording cannot be written: {error}"))
}

impl<L: Link, W: Write> Link for Recorder<L, W> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let written = self.writer.append(self.start.elapsed(), Direction::ToBoard, bytes);
        written.map_err(unwritable)?;
        self.link.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let received = self.link.receive(bytes, timeout);
        if received.is_err() {
            // Why the link failed says more than that the file did.
            let _ = self.write_down();
        }
        let count = received?;
        for &byte in bytes.get(..count).unwrap_or(&[]) {
            self.partial.push(byte);
            if byte == 0 || self.partial.len() == LONGEST {
                self.write_down()?;
            }
        }
        Ok(count)
    }
}

impl<L, W: Write> Drop for Recorder<L, W> {
    fn drop(&mut self) {
        // Nobody is left to be told of an error.
        let _ = self.write_down();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::recording::Recording;

    /// A file that takes its first bytes, and no more.
    struct Full(usize);

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let left = self.0.checked_sub(bytes.len());
            self.0 = left.ok_or_else(|| io::Error::from(io::ErrorKind::StorageFull))?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A line that brings these bytes, then nothing for a while, and is then closed.
    struct Closing(Vec<u8>, u32);

    impl Link for Closing {
        fn send(&mut self, _: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, bytes: &mut [u8], _: Duration) -> io::Result<usize> {
            let count = bytes.len().min(self.0.len());
            bytes.iter_mut().zip(self.0.drain(..count)).for_each(|(to, from)| *to = from);
            if count == 0 {
                let left = self.1.checked_sub(1);
                self.1 = left.ok_or_else(|| io::Error::from(io::ErrorKind::UnexpectedEof))?;
            }
            Ok(count)
        }
    }

    /// What a recording has from the board, piece by piece.
    fn pieces(file: &[u8]) -> Vec<Vec<u8>> {
        let recording = Recording::parse(file).unwrap();
        assert_eq!((recording.torn, recording.damaged), (0, 0));
        let mine = recording.pieces.into_iter().filter(|p| p.way == Direction::FromBoard);
        mine.map(|p| p.bytes).collect()
    }

    fn sent() -> Vec<u8> {
        let mut sent = vec![b'A'; LONGEST];
        sent.extend([1, 2, 0, 3, 4, 5]);
        sent
    }

    #[test]
    fn a_full_disk_is_the_recordings_fault() {
        let header = Header::new(2, Vec::new(), String::new());
        let mut recorder = Recorder::new(Closing(sent(), 4), Full(300), &header).unwrap();
        let sending = (0..300).find_map(|_| recorder.send(&[7, 0]).err()).unwrap();
        let receiving = (0..9).find_map(|_| recorder.receive(&mut [0; 500], Duration::ZERO).err());
        for error in [sending, receiving.unwrap()] {
            assert_eq!(error.kind(), io::ErrorKind::StorageFull);
            assert!(error.to_string().contains("the recording cannot be written"), "{error}");
        }
    }

    #[test]
    fn what_came_of_a_frame_before_the_link_failed_is_recorded() {
        let mut file = Vec::new();
        let header = Header::new(2, Vec::new(), String::new());
        let mut recorder = Recorder::new(Closing(sent(), 0), &mut file, &header).unwrap();
        let mut bytes = [0; 7];
        let error = loop {
            if let Err(error) = recorder.receive(&mut bytes, Duration::ZERO) {
                break error;
            }
        };
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
        // Also if the recorder is never dropped.
        std::mem::forget(recorder);
        assert_eq!(pieces(&file).concat(), sent());
    }

    #[test]
    fn what_came_of_a_frame_is_recorded_when_the_recorder_goes_and_is_not_cut_before() {
        let mut file = Vec::new();
        let header = Header::new(2, Vec::new(), String::new());
        let mut recorder = Recorder::new(Closing(sent(), 4), &mut file, &header).unwrap();
        let mut bytes = [0];
        for _ in 0..sent().len() + 3 {
            recorder.receive(&mut bytes, Duration::ZERO).unwrap();
            recorder.send(&[7, 0]).unwrap();
        }
        drop(recorder);
        let pieces = pieces(&file);
        assert_eq!(pieces.concat(), sent());
        let lengths: Vec<usize> = pieces.iter().map(Vec::len).collect();
        assert_eq!(lengths, [LONGEST, 3, 3]);
    }
}
