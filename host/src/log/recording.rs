//! Recordings (`*.tac`): the frames of a link, both directions, with the host's time.
//!
//! A file is a sequence of pieces, each sealed like a frame on the wire: content and CRC-32,
//! COBS-stuffed, ended by a zero byte ([`tactile_core::wire::seal`]). The first byte of the content
//! says what follows:
//!
//! | byte | content |
//! |---|---|
//! | 0 | the header, once and first: JSON with `format` "tactile-recording", `version` 1, `protocol`, `dimension`, `fingers`, `description` |
//! | 1 | microseconds since the start (8 bytes, least significant first), then bytes from the board as they came |
//! | 2 | the same, bytes to the board |
//!
//! Pieces are only ever appended, so that a crash costs at most the piece being written: the reader
//! reports and skips a torn last piece, and any damaged one. Where another recording was put behind one, with a
//! header of its own, the one ends. The pieces of one direction, joined,
//! are the link's bytes exactly, damaged frames included.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Map, Value, json};
use tactile_core::wire::{PROTOCOL, seal, unseal};

use super::MAX_FINGERS;

const FORMAT: &str = "tactile-recording";
const VERSION: u64 = 1;
/// Kind, time, stuffing, CRC and delimiter of a piece.
const OVERHEAD: usize = 32;

/// Which way bytes went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Board to host.
    FromBoard,
    /// Host to board.
    ToBoard,
}

/// What a recording is of.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Version of the wire protocol.
    pub protocol: u8,
    /// 2 or 3.
    pub dimension: usize,
    /// Names of the fingers.
    pub fingers: Vec<String>,
    /// What it is, in words.
    pub description: String,
}

impl Header {
    /// A header of this program's protocol.
    pub fn new(dimension: usize, fingers: Vec<String>, description: String) -> Self {
        Header { protocol: PROTOCOL, dimension, fingers, description }
    }

    fn to_json(&self) -> Value {
        json!({
            "format": FORMAT, "version": VERSION, "protocol": self.protocol,
            "dimension": self.dimension, "fingers": self.fingers, "description": self.description,
        })
    }

    fn from_json(content: &[u8]) -> Result<Self, String> {
        let fields: Map<String, Value> =
            serde_json::from_slice(content).map_err(|e| format!("the header is no object: {e}"))?;
        let whole = |name: &str| fields.get(name).and_then(Value::as_u64);
        let text = |name: &str| fields.get(name).and_then(Value::as_str);
        if text("format") != Some(FORMAT) {
            return Err(format!("field `format`: expected \"{FORMAT}\""));
        }
        match whole("version") {
            Some(VERSION) => {}
            Some(other) => return Err(format!("version {other}, this program reads {VERSION}")),
            None => return Err("field `version`: expected a number".into()),
        }
        let protocol = match whole("protocol") {
            Some(p) if p == u64::from(PROTOCOL) => PROTOCOL,
            Some(p) => return Err(format!("protocol {p}, this program speaks {PROTOCOL}")),
            None => return Err("field `protocol`: expected a number".into()),
        };
        let dimension = match whole("dimension") {
            Some(2) => 2,
            Some(3) => 3,
            _ => return Err("field `dimension`: expected 2 or 3".into()),
        };
        // One left out would give all after it another's name.
        let names = || "field `fingers`: expected at most 255 names, each once".to_string();
        let fingers: Vec<String> = match fields.get("fingers") {
            None | Some(Value::Null) => Vec::new(),
            Some(value) => serde_json::from_value(value.clone()).map_err(|_| names())?,
        };
        let is_new = |(i, name): (usize, &String)| !fingers[..i].contains(name);
        if fingers.len() > MAX_FINGERS || !fingers.iter().enumerate().all(is_new) {
            return Err(names());
        }
        Ok(Header {
            protocol,
            dimension,
            fingers,
            description: text("description").unwrap_or_default().to_owned(),
        })
    }
}

/// Appends pieces to a file; every piece is handed to the file at once.
pub struct RecordingWriter<W: Write> {
    file: W,
    sealed: Vec<u8>,
    content: Vec<u8>,
}

impl<W: Write> RecordingWriter<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn new(file: W, header: &Header) -> io::Result<Self> {
        let mut writer = RecordingWriter { file, sealed: Vec::new(), content: Vec::new() };
        writer.content.push(0);
        writer.content.extend(header.to_json().to_string().as_bytes());
        writer.put()?;
        Ok(writer)
    }

    /// Appends bytes that passed `time` after the start.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, time: Duration, way: Direction, bytes: &[u8]) -> io::Result<()> {
        self.content.clear();
        self.content.push(match way {
            Direction::FromBoard => 1,
            Direction::ToBoard => 2,
        });
        self.content.extend((time.as_micros() as u64).to_le_bytes());
        self.content.extend(bytes);
        self.put()
    }

    fn put(&mut self) -> io::Result<()> {
        self.sealed.resize(self.content.len() + self.content.len() / 254 + OVERHEAD, 0);
        let piece = seal(&self.content, &mut self.sealed)
            .ok_or_else(|| io::Error::other("a piece did not fit its buffer"))?;
        self.file.write_all(piece)?;
        self.file.flush()
    }
}

/// Why a file is not a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file system refused.
    #[error("{}: cannot read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// It does not start with a header.
    #[error("{}: not a recording: {problem}", file.display())]
    Header {
        /// The file.
        file: PathBuf,
        /// What is wrong and what was expected.
        problem: String,
    },
}

/// Bytes that passed in one piece.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// Since the start of the recording.
    pub time: Duration,
    /// Which way.
    pub way: Direction,
    /// As they passed.
    pub bytes: Vec<u8>,
}

impl Piece {
    /// Nothing, at the start, from the board.
    pub const EMPTY: Piece =
        Piece { time: Duration::ZERO, way: Direction::FromBoard, bytes: Vec::new() };
}

/// A recording in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What it is of.
    pub header: Header,
    /// What passed, in order.
    pub pieces: Vec<Piece>,
    /// Bytes of an unfinished last piece, which was skipped.
    pub torn: usize,
    /// Pieces in the middle that could not be read, which were skipped.
    pub damaged: usize,
    /// The byte at which another recording begins, which was not read.
    pub another: Option<u64>,
}

impl Recording {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read or does not start with a whole header of this version.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let mut pieces = Pieces::open(path)?;
        let all: Result<Vec<Piece>, _> = pieces.by_ref().collect();
        let all = all.map_err(|source| RecordingError::Read { file: path.into(), source })?;
        Ok(pieces.with(all))
    }

    /// Reads the bytes of a file; the error says what is wrong with the header.
    ///
    /// # Errors
    /// When they do not start with a whole header of this version.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut pieces = Pieces::new(bytes).map_err(|e| e.to_string())??;
        let all: Result<Vec<Piece>, _> = pieces.by_ref().collect();
        Ok(pieces.with(all.map_err(|e| e.to_string())?))
    }
}

/// Most bytes of a sealed piece: far above what a link hands over at once.
const LONGEST: u64 = 1 << 24;

/// The pieces of a recording one after the other, so that a long one needs little memory. Damaged ones
/// are skipped and counted.
#[derive(Debug)]
pub struct Pieces<R> {
    /// What the recording is of.
    pub header: Header,
    /// Bytes of an unfinished last piece, once the end was reached.
    pub torn: usize,
    /// Pieces so far that could not be read.
    pub damaged: usize,
    /// The byte at which another recording begins, once it was reached: there this one ends.
    pub another: Option<u64>,
    /// Bytes so far, and of all where that is known.
    pub bytes: (u64, Option<u64>),
    reader: R,
    sealed: Vec<u8>,
}

impl Pieces<BufReader<File>> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// When it cannot be read or does not start with a whole header of this version.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let unreadable = |source| RecordingError::Read { file: path.into(), source };
        let file = File::open(path).map_err(unreadable)?;
        let all = file.metadata().ok().map(|m| m.len());
        let pieces = Pieces::new(BufReader::with_capacity(1 << 16, file)).map_err(unreadable)?;
        let pieces = pieces.map(|p| Pieces { bytes: (p.bytes.0, all), ..p });
        pieces.map_err(|problem| RecordingError::Header { file: path.into(), problem })
    }
}

impl<R: BufRead> Pieces<R> {
    /// Reads the header; the inner error says what is wrong with it.
    ///
    /// # Errors
    /// When the reader fails.
    pub fn new(mut reader: R) -> io::Result<Result<Self, String>> {
        let mut sealed = Vec::new();
        reader.by_ref().take(LONGEST).read_until(0, &mut sealed)?;
        let header = match sealed.split_last() {
            None => Err("it is empty".into()),
            Some((0, body)) => {
                match unseal(&mut body.to_vec()).ok().and_then(<[u8]>::split_first) {
                    Some((0, content)) => Header::from_json(content),
                    _ => Err("it does not start with a header".into()),
                }
            }
            Some(_) if sealed.trim_ascii_start().starts_with(b"{\"") => {
                Err("it is text, as a grasp log (.jsonl) is".into())
            }
            Some(_) if sealed.len() as u64 == LONGEST => {
                Err("it does not start with a header".into())
            }
            Some(_) => Err("it ends within its header".into()),
        };
        let bytes = (sealed.len() as u64, None);
        Ok(header.map(|header| Pieces {
            header,
            torn: 0,
            damaged: 0,
            another: None,
            bytes,
            reader,
            sealed,
        }))
    }

    /// The next piece in the place of `piece`, whose memory serves again; whether there is one.
    ///
    /// # Errors
    /// When the reader fails.
    pub fn read(&mut self, piece: &mut Piece) -> io::Result<bool> {
        while self.another.is_none() {
            let start = self.bytes.0;
            self.sealed.clear();
            match self.reader.by_ref().take(LONGEST).read_until(0, &mut self.sealed)? {
                0 => return Ok(false),
                read => self.bytes.0 += read as u64,
            }
            let whole = self.sealed.pop_if(|last| *last == 0).is_some();
            if !whole && self.sealed.len() as u64 != LONGEST {
                self.torn = self.sealed.len();
                return Ok(false);
            }
            let content = unseal(&mut self.sealed).ok().and_then(<[u8]>::split_first);
            match content {
                Some((&kind @ 1..=2, rest)) if whole && rest.len() >= 8 => {
                    let (time, bytes) = rest.split_at(8);
                    let time = time.iter().rev().fold(0, |t, &b| t << 8 | u64::from(b));
                    piece.time = Duration::from_micros(time);
                    piece.way = if kind == 1 { Direction::FromBoard } else { Direction::ToBoard };
                    piece.bytes.clear();
                    piece.bytes.extend_from_slice(bytes);
                    return Ok(true);
                }
                Some((0, _)) if whole => self.another = Some(start),
                _ => self.damaged += 1,
            }
        }
        Ok(false)
    }

    fn with(self, pieces: Vec<Piece>) -> Recording {
        let Pieces { header, torn, damaged, another, .. } = self;
        Recording { header, pieces, torn, damaged, another }
    }
}

impl<R: BufRead> Iterator for Pieces<R> {
    type Item = io::Result<Piece>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut piece = Piece::EMPTY;
        self.read(&mut piece).map(|there| there.then_some(piece)).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn write(pieces: &[(u64, bool, Vec<u8>)]) -> (Vec<u8>, Vec<usize>) {
        let header = Header::new(3, vec!["thumb".into()], "a test".into());
        let mut bytes = Vec::new();
        let mut ends = Vec::new();
        RecordingWriter::new(&mut bytes, &header).unwrap();
        ends.push(bytes.len());
        for (time, from, content) in pieces {
            let mut writer =
                RecordingWriter { file: &mut bytes, sealed: Vec::new(), content: Vec::new() };
            let way = if *from { Direction::FromBoard } else { Direction::ToBoard };
            writer.append(Duration::from_micros(*time), way, content).unwrap();
            ends.push(bytes.len());
        }
        (bytes, ends)
    }

    fn pieces() -> impl Strategy<Value = Vec<(u64, bool, Vec<u8>)>> {
        let bytes = proptest::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 0..300);
        proptest::collection::vec((any::<u64>(), any::<bool>(), bytes), 0..8)
    }

    #[test]
    fn one_recording_ends_where_another_begins() {
        let (first, _) = write(&[(1, true, vec![1, 0, 2]), (2, false, vec![3])]);
        let (second, _) = write(&[(0, true, vec![4])]);
        let alone = Recording::parse(&first).unwrap();
        assert_eq!((alone.another, alone.pieces.len()), (None, 2));
        let both = Recording::parse(&[&first[..], &second[..]].concat()).unwrap();
        assert_eq!(both, Recording { another: Some(first.len() as u64), ..alone });
        // Nor is what follows it: not even the end of a piece.
        let torn = Recording::parse(&[&first[..], &second[..], &[7]].concat()).unwrap();
        assert_eq!(torn, both);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn a_crash_at_any_byte_costs_the_last_piece(pieces in pieces()) {
            let (bytes, ends) = write(&pieces);
            for cut in 0..=bytes.len() {
                let read = Recording::parse(&bytes[..cut]);
                let whole = ends.iter().filter(|&&end| end <= cut).count();
                if whole == 0 {
                    prop_assert!(read.is_err());
                    continue;
                }
                let read = read.unwrap();
                prop_assert_eq!(&read.header.description, "a test");
                prop_assert_eq!((read.pieces.len(), read.damaged), (whole - 1, 0));
                prop_assert_eq!(read.torn, cut - ends[whole - 1]);
                for (piece, (time, from, content)) in read.pieces.iter().zip(&pieces) {
                    prop_assert_eq!(piece.time, Duration::from_micros(*time));
                    prop_assert_eq!(piece.way == Direction::FromBoard, *from);
                    prop_assert_eq!(&piece.bytes, content);
                }
            }
        }

        #[test]
        fn damage_costs_the_pieces_it_hits(pieces in pieces(), at in any::<prop::sample::Index>(), bits in 1u8..) {
            let (mut bytes, ends) = write(&pieces);
            prop_assume!(!pieces.is_empty());
            let at = ends[0] + at.index(bytes.len() - ends[0]);
            bytes[at] ^= bits;
            let read = Recording::parse(&bytes).unwrap();
            // At most two: when a delimiter is hit, two pieces become one.
            prop_assert!(read.pieces.len() + 2 >= pieces.len());
            prop_assert!(read.damaged > 0 || read.torn > 0);
        }

        #[test]
        fn other_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(Recording::parse(&bytes).is_err());
        }
    }

    #[test]
    fn a_grasp_log_is_no_recording() {
        let error = Recording::parse(b"{\"format\":\"tactile-grasp-log\"}\n").unwrap_err();
        assert!(error.to_string().contains("it is text, as a grasp log"), "{error}");
    }

    #[test]
    fn headers_are_checked() {
        let refuse = |text: &str| Header::from_json(text.as_bytes()).unwrap_err();
        let good = Header::new(2, vec![], String::new()).to_json().to_string();
        assert!(Header::from_json(good.as_bytes()).is_ok());
        assert!(refuse("[]").contains("object"));
        assert!(refuse("{}").contains("format"));
        assert!(refuse(&good.replace("\"version\":1", "\"version\":9")).contains('9'));
        let ours = format!("\"protocol\":{PROTOCOL}");
        assert!(refuse(&good.replace(&ours, "\"protocol\":77")).contains("77"));
        assert!(refuse(&good.replace("\"dimension\":2", "\"dimension\":4")).contains("2 or 3"));
        let named = |names: &str| good.replace("\"fingers\":[]", &format!("\"fingers\":{names}"));
        let header = Header::from_json(named("[\"ff\",\"rf\"]").as_bytes()).unwrap();
        assert_eq!(header.fingers, ["ff", "rf"]);
        for wrong in ["[\"ff\",null,\"rf\"]", "[\"ff\",\"ff\"]", "\"ff\""] {
            assert!(refuse(&named(wrong)).contains("`fingers`"), "{wrong}");
        }
    }
}
