//! The file of `--record`: what it held before stays until a board has answered.

use std::cell::{Cell, RefCell};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

use tactile_core::wire::{Decoder, Report, WireSpace};

use crate::cli::Error;
use crate::link::{Link, Recorder};
use crate::log::recording::Header;

/// A file for a recording, which is held back until the first good frame has come from the board, and then takes
/// the place of what the file held. If none comes, a file that was there is as it was; a new one has the bytes that
/// are no frames, for who asks why, and goes if there are none.
pub(super) struct Target<'a> {
    path: &'a Path,
    file: File,
    is_new: bool,
    /// What is held back; `None` once a frame has come.
    held: RefCell<Option<Vec<u8>>>,
    /// Whether a byte has come.
    is_heard: Cell<bool>,
}

impl<'a> Target<'a> {
    /// Opens the file and leaves it as it is, or makes it.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn open(path: &'a Path) -> Result<Self, Error> {
        let is_new = path.symlink_metadata().is_err();
        let file = File::options().write(true).create(true).truncate(false).open(path);
        let file =
            file.map_err(|e| Error::Input(format!("{}: cannot write: {e}", path.display())))?;
        let held = RefCell::new(Some(Vec::new()));
        Ok(Target { path, file, is_new, held, is_heard: Cell::new(false) })
    }

    /// Wraps a link, of which all frames go into the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn record<S: WireSpace, L: Link>(&self, link: L, header: &Header) -> io::Result<impl Link> {
        let decoder = Decoder::<Report<S>>::new();
        Recorder::new(Heard { link, target: self, decoder }, self, header)
    }

    /// A frame has come.
    fn begin(&self) -> io::Result<()> {
        let Some(held) = self.held.take() else { return Ok(()) };
        // Devices and pipes have no length.
        if self.file.metadata()?.is_file() {
            self.file.set_len(0)?;
        }
        (&self.file).write_all(&held)
    }
}

impl Write for &Target<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut *self.held.borrow_mut() {
            Some(held) => held.write(bytes),
            None => (&self.file).write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        (&self.file).flush()
    }
}

impl Drop for Target<'_> {
    fn drop(&mut self) {
        if !self.is_new || self.held.get_mut().is_none() {
            return;
        }
        // Nobody is left to be told of an error.
        let _ = if self.is_heard.get() { self.begin() } else { fs::remove_file(self.path) };
    }
}

/// A link that says when a frame has come.
struct Heard<'a, S: WireSpace, L> {
    link: L,
    target: &'a Target<'a>,
    decoder: Decoder<Report<S>>,
}

impl<S: WireSpace, L: Link> Link for Heard<'_, S, L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.link.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.link.receive(bytes, timeout)?;
        for &byte in bytes.get(..count).unwrap_or(&[]) {
            self.target.is_heard.set(true);
            if matches!(self.decoder.push(byte), Some(Ok(_))) {
                self.target.begin()?;
            }
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use tactile_core::space::Planar;
    use tactile_core::wire::{Frame, Health, MAX_FRAME, encode};

    use super::*;
    use crate::cli::Cli;
    use crate::log::recording::{Direction, Recording};

    /// A line that brings these bytes.
    struct Line(Vec<u8>);

    impl Link for Line {
        fn send(&mut self, _: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, bytes: &mut [u8], _: Duration) -> io::Result<usize> {
            let count = bytes.len().min(self.0.len());
            bytes.iter_mut().zip(self.0.drain(..count)).for_each(|(to, from)| *to = from);
            Ok(count)
        }
    }

    /// Speaks to a line and listens, recording into the file.
    fn talk(path: &Path, line: &[u8]) {
        let target = Target::open(path).unwrap();
        let header = Header::new(2, Vec::new(), "new".into());
        let mut link = target.record::<Planar, _>(Line(line.to_vec()), &header).unwrap();
        for _ in 0..30 {
            link.send(&[1, 2, 0]).unwrap();
            link.receive(&mut [0; 2], Duration::ZERO).unwrap();
        }
    }

    /// What a board says.
    fn answer() -> Vec<u8> {
        let message = Report::<Planar>::Health(Health::NONE);
        let frame = Frame { sequence: 0, time: Default::default(), message };
        encode(&frame, &mut [0; MAX_FRAME]).unwrap().to_vec()
    }

    /// All that a recording has from the board.
    fn heard(path: &Path) -> Vec<u8> {
        let recording = Recording::read(path).unwrap();
        assert_eq!((recording.torn, recording.damaged), (0, 0));
        assert_eq!(recording.header.description, "new");
        let mine = recording.pieces.iter().filter(|p| p.way == Direction::FromBoard);
        mine.flat_map(|p| p.bytes.clone()).collect()
    }

    #[test]
    fn an_old_recording_stays_where_no_frame_comes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.tac");
        talk(&path, b"");
        assert!(!path.exists(), "a new one goes");
        let mut damaged = answer();
        damaged[3] ^= 1;
        talk(&path, &damaged);
        assert_eq!(heard(&path), damaged);
        for line in [&b""[..], b"\x05\0login:\0\0", &damaged] {
            fs::write(&path, "precious").unwrap();
            talk(&path, line);
            assert_eq!(fs::read(&path).unwrap(), b"precious", "{line:?}");
        }
    }

    #[test]
    fn an_old_recording_is_replaced_by_all_that_passed_when_a_frame_comes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.tac");
        fs::write(&path, [7; 10_000]).unwrap();
        let passed = [&[5, 0, 6, 0], &answer()[..], &[6]].concat();
        talk(&path, &passed);
        assert_eq!(heard(&path), passed);
        let sent = Recording::read(&path).unwrap().pieces.into_iter();
        assert_eq!(sent.filter(|p| p.bytes == [1, 2, 0]).count(), 30);
    }

    #[test]
    fn an_old_recording_stays_where_there_is_no_board() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.tac");
        fs::write(&path, "precious").unwrap();
        let free = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap();
        let (port, out) = (format!("tcp:{free}"), folder.path().join("out"));
        let words = ["tactile", "live", "--port", &port, "--record"].map(Into::into);
        let words = words.into_iter().chain([path.clone().into(), "--out".into(), out.into()]);
        let code = Cli::parse_from(words.collect::<Vec<std::ffi::OsString>>()).run();
        assert_eq!(code, std::process::ExitCode::FAILURE);
        assert_eq!(fs::read(&path).unwrap(), b"precious");
    }
}
