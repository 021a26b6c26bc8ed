//! Frames to bytes and back. The format is explained in [`crate::wire`].

use core::marker::PhantomData;

use heapless::Vec;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::frame::{Frame, PROTOCOL};

/// Bytes of the longest frame on the wire, delimiter included.
pub const MAX_FRAME: usize = 160;

/// A host that reads long recordings has room for a table of 16 kB, a board for 1 kB; both give the same.
#[cfg(not(target_os = "none"))]
static CRC: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);
#[cfg(target_os = "none")]
static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// A frame did not fit in [`MAX_FRAME`] bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the frame is longer than {MAX_FRAME} bytes")
    }
}

impl core::error::Error for EncodeError {}

/// The frame as it goes over the wire, delimiter included.
///
/// # Errors
/// When it does not fit: of this protocol only candidates with strokes that begin far from the hand's origin are that
/// long ([`CandidateFrame`](super::CandidateFrame)).
pub fn encode<'a, M: Serialize>(
    frame: &Frame<M>,
    buffer: &'a mut [u8; MAX_FRAME],
) -> Result<&'a [u8], EncodeError> {
    let mut payload = [0; MAX_FRAME];
    let payload = postcard::to_slice(frame, &mut payload).map_err(|_| EncodeError)?;
    seal(payload, buffer).ok_or(EncodeError)
}

/// Appends the CRC to `payload`, stuffs the whole and ends it with the delimiter. `None` when
/// `out` is too short: at most ⌈(n + 5)/254⌉ + 1 bytes more than the n + 4 of payload and CRC.
pub fn seal<'a>(payload: &[u8], out: &'a mut [u8]) -> Option<&'a [u8]> {
    let crc = CRC.checksum(payload).to_le_bytes();
    let (mut code, mut run, mut end) = (0, 1u8, 1);
    for &byte in payload.iter().chain(&crc) {
        if byte != 0 {
            *out.get_mut(end)? = byte;
            end += 1;
            run += 1;
        }
        if byte == 0 || run == 255 {
            *out.get_mut(code)? = run;
            (code, run) = (end, 1);
            end += 1;
        }
    }
    *out.get_mut(code)? = run;
    *out.get_mut(end)? = 0;
    out.get(..=end)
}

/// Undoes [`seal`] in place; `frame` is what stood before the delimiter.
///
/// # Errors
/// [`FrameError::Cobs`] or [`FrameError::Crc`].
pub fn unseal(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let (mut read, mut write) = (0, 0);
    while let Some(&code) = frame.get(read) {
        let end = read + code as usize;
        if code == 0 || end > frame.len() {
            return Err(FrameError::Cobs);
        }
        frame.copy_within(read + 1..end, write);
        write += code as usize - 1;
        read = end;
        if code < 255 && read < frame.len() {
            // The write position is behind the read position: every block has its code byte.
            frame[write] = 0;
            write += 1;
        }
    }
    let (payload, crc) = frame[..write].split_last_chunk::<4>().ok_or(FrameError::Crc)?;
    if CRC.checksum(payload) == u32::from_le_bytes(*crc) {
        Ok(payload)
    } else {
        Err(FrameError::Crc)
    }
}

/// Why bytes between two delimiters are no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than [`MAX_FRAME`].
    Oversize,
    /// The stuffing is inconsistent: bytes were lost or damaged.
    Cobs,
    /// The checksum does not match.
    Crc,
    /// The checksum matches but the message is unknown or a field cannot be read.
    Malformed,
    /// The checksum matches but bytes are left after the message.
    Trailing,
    /// The sender speaks another version of the protocol.
    Version {
        /// Its version; ours is [`PROTOCOL`].
        theirs: u8,
        /// The frame's sequence number.
        sequence: u8,
    },
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            FrameError::Oversize => write!(f, "frame longer than {MAX_FRAME} bytes"),
            FrameError::Cobs => f.write_str("bad byte stuffing"),
            FrameError::Crc => f.write_str("bad checksum"),
            FrameError::Malformed => f.write_str("unknown message"),
            FrameError::Trailing => f.write_str("bytes after the message"),
            FrameError::Version { theirs, .. } => {
                write!(f, "the sender speaks protocol {theirs}, this side {PROTOCOL}")
            }
        }
    }
}

impl core::error::Error for FrameError {}

/// What a receiver has seen since it started. Counts stop at their largest value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Good frames, doubled and late ones included.
    pub frames: u32,
    /// [`FrameError::Oversize`].
    pub oversize: u32,
    /// [`FrameError::Cobs`].
    pub cobs: u32,
    /// [`FrameError::Crc`].
    pub crc: u32,
    /// [`FrameError::Malformed`] and [`FrameError::Trailing`].
    pub malformed: u32,
    /// [`FrameError::Version`].
    pub version: u32,
    /// Sequence numbers that never came.
    pub lost: u32,
    /// Frames whose sequence number had come before.
    pub doubled: u32,
    /// Frames that came after a later one.
    pub late: u32,
}

impl Counters {
    /// Nothing seen.
    pub const NONE: Self = Counters {
        frames: 0,
        oversize: 0,
        cobs: 0,
        crc: 0,
        malformed: 0,
        version: 0,
        lost: 0,
        doubled: 0,
        late: 0,
    };

    /// Frames that could not be read.
    pub fn damaged(&self) -> u32 {
        [self.oversize, self.cobs, self.crc, self.malformed, self.version]
            .iter()
            .fold(0, |sum: u32, &n| sum.saturating_add(n))
    }
}

/// A frame's place among those that came before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Later than any before, or the first.
    New,
    /// Its sequence number has come before.
    Doubled,
    /// A later one came before it.
    Late,
}

/// A good frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received<M> {
    /// The frame.
    pub frame: Frame<M>,
    /// Its place among those before.
    pub arrival: Arrival,
}

/// The last 64 sequence numbers.
#[derive(Clone, Debug, Default)]
struct Window {
    /// Bit i: number `newest` − i has come. Zero before the first frame.
    seen: u64,
    newest: u8,
}

impl Window {
    fn arrive(&mut self, sequence: u8, starts_anew: bool, counters: &mut Counters) -> Arrival {
        let ahead = sequence.wrapping_sub(self.newest);
        if self.seen == 0 || (starts_anew && ahead != 0) {
            (self.seen, self.newest) = (1, sequence);
            return Arrival::New;
        }
        if (1..=128).contains(&ahead) {
            counters.lost = counters.lost.saturating_add(ahead as u32 - 1);
            self.seen = self.seen.checked_shl(ahead as u32).unwrap_or(0) | 1;
            self.newest = sequence;
            return Arrival::New;
        }
        let bit = 1u64.checked_shl(ahead.wrapping_neg() as u32).unwrap_or(0);
        if self.seen & bit != 0 {
            counters.doubled = counters.doubled.saturating_add(1);
            return Arrival::Doubled;
        }
        self.seen |= bit;
        counters.lost = counters.lost.saturating_sub(1);
        counters.late = counters.late.saturating_add(1);
        Arrival::Late
    }
}

/// Takes bytes, gives frames whose message is `M` ([`super::Command`] on the board,
/// [`super::Report`] on the host).
#[derive(Clone, Debug)]
pub struct Decoder<M> {
    buffer: Vec<u8, MAX_FRAME>,
    oversize: bool,
    window: Window,
    counters: Counters,
    message: PhantomData<fn() -> M>,
}

impl<M: DeserializeOwned> Decoder<M> {
    /// A decoder at the start of a stream.
    pub const fn new() -> Self {
        Decoder {
            buffer: Vec::new(),
            oversize: false,
            window: Window { seen: 0, newest: 0 },
            counters: Counters::NONE,
            message: PhantomData,
        }
    }

    /// What has been seen.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Whether bytes of an unfinished frame are waiting.
    pub fn is_inside_frame(&self) -> bool {
        self.oversize || !self.buffer.is_empty()
    }

    /// Takes one byte; gives what a delimiter completes.
    pub fn push(&mut self, byte: u8) -> Option<Result<Received<M>, FrameError>> {
        if byte != 0 {
            self.oversize |= self.buffer.push(byte).is_err();
            return None;
        }
        if !self.is_inside_frame() {
            return None;
        }
        let outcome = self.finish();
        self.buffer.clear();
        self.oversize = false;
        let count = match &outcome {
            Ok(_) => &mut self.counters.frames,
            Err(FrameError::Oversize) => &mut self.counters.oversize,
            Err(FrameError::Cobs) => &mut self.counters.cobs,
            Err(FrameError::Crc) => &mut self.counters.crc,
            Err(FrameError::Malformed | FrameError::Trailing) => &mut self.counters.malformed,
            Err(FrameError::Version { .. }) => &mut self.counters.version,
        };
        *count = count.saturating_add(1);
        Some(outcome)
    }

    /// Takes bytes to the end of a frame, or all where none ends; gives what the delimiter completes,
    /// and the bytes after it. As [`Self::push`] of one after the other, and faster.
    ///
    /// ```
    /// use tactile_core::space::Planar;
    /// use tactile_core::wire::{Command, Decoder, Frame, MAX_FRAME, encode};
    ///
    /// let ping = Frame { sequence: 7, time: Default::default(), message: Command::<Planar>::Ping };
    /// let mut buffer = [0; MAX_FRAME];
    /// let sent = encode(&ping, &mut buffer).unwrap();
    /// let mut decoder = Decoder::<Command<Planar>>::new();
    /// let (received, rest) = decoder.take(sent);
    /// assert_eq!(received.unwrap().unwrap().frame, ping);
    /// assert!(rest.is_empty());
    /// ```
    pub fn take<'a>(
        &mut self,
        bytes: &'a [u8],
    ) -> (Option<Result<Received<M>, FrameError>>, &'a [u8]) {
        let end = bytes.iter().position(|byte| *byte == 0);
        let (inside, rest) = bytes.split_at(end.unwrap_or(bytes.len()));
        self.oversize |= self.buffer.extend_from_slice(inside).is_err();
        match rest.split_first() {
            Some((delimiter, rest)) => (self.push(*delimiter), rest),
            None => (None, rest),
        }
    }

    fn finish(&mut self) -> Result<Received<M>, FrameError> {
        if self.oversize {
            return Err(FrameError::Oversize);
        }
        let payload = unseal(&mut self.buffer)?;
        let &[sequence, _, _, _, _, message, ..] = payload else {
            return Err(FrameError::Malformed);
        };
        // A number of a message spread over more bytes than it needs would get past the look at the version.
        if message & 0x80 != 0 {
            return Err(FrameError::Malformed);
        }
        let hello = message == 0;
        if hello {
            // Of an unknown version, nothing but this may be read.
            let theirs = *payload.get(6).ok_or(FrameError::Malformed)?;
            if theirs != PROTOCOL {
                return Err(FrameError::Version { theirs, sequence });
            }
        }
        let (frame, rest) =
            postcard::take_from_bytes::<Frame<M>>(payload).map_err(|_| FrameError::Malformed)?;
        if !rest.is_empty() {
            return Err(FrameError::Trailing);
        }
        let arrival = self.window.arrive(sequence, hello, &mut self.counters);
        Ok(Received { frame, arrival })
    }
}

impl<M: DeserializeOwned> Default for Decoder<M> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
