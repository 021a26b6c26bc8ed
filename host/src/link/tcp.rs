//! A board behind a TCP connection: an emulator, or a serial port that another program serves.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::Link;

const SEND: Duration = Duration::from_secs(10);

/// A connected stream.
#[derive(Debug)]
pub struct Tcp {
    stream: TcpStream,
}

impl Tcp {
    /// Connects to `host:port` within `timeout` per address.
    ///
    /// # Errors
    /// When the name is unknown or nobody answers.
    pub fn connect(address: &str, timeout: Duration) -> io::Result<Self> {
        let mut failure = io::Error::new(ErrorKind::NotFound, "the name has no address");
        for address in address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, timeout) {
                Ok(stream) => return Self::new(stream),
                Err(error) => failure = error,
            }
        }
        Err(failure)
    }

    /// A stream that is already connected.
    ///
    /// # Errors
    /// When the stream cannot be set up.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        // Frames are small and every one is waited for.
        stream.set_nodelay(true)?;
        stream.set_nonblocking(false)?;
        // A side that takes nothing must not hold this one for ever.
        stream.set_write_timeout(Some(SEND))?;
        Ok(Tcp { stream })
    }
}

impl Link for Tcp {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let deadline = Instant::now() + timeout;
        loop {
            // A timeout of zero would mean for ever.
            let left = deadline.saturating_duration_since(Instant::now());
            self.stream.set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
            return match self.stream.read(bytes) {
                Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "the board closed the link")),
                Ok(count) => Ok(count),
                // A stopped program goes on listening.
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    Ok(0)
                }
                Err(error) => Err(error),
            };
        }
    }
}
