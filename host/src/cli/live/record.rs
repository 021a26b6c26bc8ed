//! The file of `--record`: what it held before stays until a board has said something.

use std::cell::RefCell;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

use crate::cli::Error;
use crate::link::{Link, Recorder};
use crate::log::recording::Header;

/// A file for a recording, which is held back until the first byte has come from the board, and then takes
/// the place of what the file held. If none comes, a file that was there is as it was, and a new one goes.
pub(super) struct Target<'a> {
    path: &'a Path,
    file: File,
    is_new: bool,
    /// What is held back; `None` once a byte has come.
    held: RefCell<Option<Vec<u8>>>,
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
        Ok(Target { path, file, is_new, held: RefCell::new(Some(Vec::new())) })
    }

    /// Wraps a link, of which all frames go into the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn record<L: Link>(&self, link: L, header: &Header) -> io::Result<impl Link> {
        Recorder::new(Heard { link, target: self }, self, header)
    }

    /// A byte has come.
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
        if self.is_new && self.held.get_mut().is_some() {
            let _ = fs::remove_file(self.path);
        }
    }
}

/// A link that says when a byte has come.
struct Heard<'a, L> {
    link: L,
    target: &'a Target<'a>,
}

impl<L: Link> Link for Heard<'_, L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.link.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.link.receive(bytes, timeout)?;
        if count > 0 {
            self.target.begin()?;
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use clap::Parser;

    use super::*;
    use crate::cli::Cli;
    use crate::log::recording::Recording;

    /// A line that brings these bytes.
    struct Line(&'static [u8]);

    impl Link for Line {
        fn send(&mut self, _: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, bytes: &mut [u8], _: Duration) -> io::Result<usize> {
            self.0.read(bytes)
        }
    }

    /// Speaks to a line and listens, recording into the file.
    fn talk(path: &Path, line: &'static [u8]) {
        let target = Target::open(path).unwrap();
        let header = Header::new(2, Vec::new(), "new".into());
        let mut link = target.record(Line(line), &header).unwrap();
        for _ in 0..3 {
            link.send(&[1, 2, 0]).unwrap();
            link.receive(&mut [0; 2], Duration::ZERO).unwrap();
        }
    }

    #[test]
    fn an_old_recording_stays_where_no_byte_comes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.tac");
        talk(&path, b"");
        assert!(!path.exists(), "a new one goes");
        fs::write(&path, "precious").unwrap();
        talk(&path, b"");
        assert_eq!(fs::read(&path).unwrap(), b"precious");
    }

    #[test]
    fn an_old_recording_is_replaced_by_all_that_passed_when_a_byte_comes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.tac");
        fs::write(&path, [7; 10_000]).unwrap();
        talk(&path, &[5, 0, 6]);
        let recording = Recording::read(&path).unwrap();
        assert_eq!((recording.torn, recording.damaged), (0, 0));
        assert_eq!(recording.header.description, "new");
        let passed: Vec<&[u8]> = recording.pieces.iter().map(|p| &p.bytes[..]).collect();
        assert_eq!(passed, [&[1, 2, 0][..], &[5, 0], &[1, 2, 0], &[1, 2, 0], &[6]]);
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
