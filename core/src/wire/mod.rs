//! Frames between board and host: the whole format, byte by byte.
//!
//! A link is two independent byte streams: the host sends [`Command`]s, the board sends
//! [`Report`]s. Both speak of one space, planar or spatial, which [`Hello`] names; the types here
//! are therefore generic over [`WireSpace`], and a frame carries no dimension.
//!
//! # From bytes to a frame
//!
//! ```text
//! wire     = COBS( payload, CRC ) 00
//! payload  = sequence(1) time(4) message
//! CRC      = CRC-32/ISO-HDLC (zlib's) of the payload, 4 bytes, least significant first
//! ```
//!
//! * **Delimiter.** `00` ends a frame and appears nowhere else. An empty frame (two delimiters in a
//!   row) means nothing; a sender that lost its place sends one first.
//! * **COBS** (consistent overhead byte stuffing). A code byte *c* is followed by *c* − 1 bytes that
//!   are not zero; unless *c* = 255 or the frame ends there, a zero follows them in the content.
//! * **sequence**: counts frames of this direction, wrapping at 256. A frame that is sent again
//!   keeps its number.
//! * **time**: microseconds of the sender's clock, 4 bytes, least significant first; wraps after
//!   71.6 minutes.
//! * **message**: the number of the variant of [`Command`] or [`Report`] as one byte, then its
//!   fields in the order of their declaration, as *postcard* writes them:
//!   * `u8`, `bool`: one byte (`bool` 0 or 1);
//!   * `u16`, `u32`, `u64`: a varint, seven bits a byte from the lowest, the top bit set on all but
//!     the last byte;
//!   * `i32`: zig-zag (0, −1, 1, −2 … become 0, 1, 2, 3 …), then as a varint;
//!   * `f32`: four bytes, IEEE 754, least significant first;
//!   * `[T; N]` and nested structs: their elements, nothing between; an enum: one byte, the
//!     number of the variant, then its fields; `Option`: 0, or 1 and the value;
//!   * [`Fraction`]: two bytes, least significant first: an `i16` that stands for value / 32767;
//!   * [`Clock`]: four bytes, least significant first.
//!
//! Sizes on the wire, delimiter included: a contact with a normal at most 23 (planar) or 28 bytes
//! (spatial) while its coordinates stay within ±1.048 m; an estimate at most 63 or 127 bytes for
//! the first two million grasps and up to 16 383 particles.
//!
//! Message 0 is `Hello` in both directions and its first field is the version of the protocol;
//! that holds for every version, so that a receiver can always name the version it refuses.
//!
//! # Conversation
//!
//! The host sends one command and waits for the [`Reply`] that carries the command's sequence
//! number before it sends the next; what the command asked for (`Hello`, `Estimate`, `Health`,
//! `Mode`, `Face`, `Finger`, `Choice`) comes before that reply. When nothing comes, the host sends
//! the same frame again, and a board that has already obeyed it repeats its answer, byte for byte,
//! without obeying twice. So a lost, damaged or doubled frame costs time and nothing else, and a
//! UART without a FIFO never has to take a byte while it computes. Only `Hello` may start anew with
//! any sequence number, and a board that has started obeys nothing before it.
//!
//! An ambiguous estimate names its heaviest pose; the others are asked for one by one
//! ([`Topic::Mode`]), and so are the faces of the shape ([`Topic::Face`]).
//!
//! A host that knows better teaches the board: `Believe` replaces pose and covariance and forgets the
//! faces, then one `Face` for each face it knows. The object frame is the host's from then on; the
//! grasps are counted on. A board with any other tracker than [`TrackerKind::Hypotheses`] refuses.
//!
//! # Fingertip sensors
//!
//! A board may read the fingertips' sensors itself ([`Hello::fingers`]). The host then tells it
//! their calibration ([`SensorFrame`]) and, before each grasp, where the fingertips are
//! ([`FingertipFrame`]); on [`Command::Commit`] the contacts that are felt at that moment are part
//! of the grasp, and named in the answer ([`Report::Felt`]). A board without real sensors is given
//! their words ([`WordsFrame`]).
//!
//! [`Command::Stream`] asks for contacts as they are felt ([`Report::Contact`]): frames that answer
//! no command and are not repeated. A contact takes at most 28 bytes, so that five fingers at 200 Hz
//! take 5 · 200 · 28 · 10 = 280 000 bits a second, 30 % of a line of 921 600 baud.
//!
//! # The next grasp
//!
//! A host that could make one of a few grasps asks which of them teaches most about the shape, by what
//! the board believes: one `Consider` for each, numbered from 0 (number 0 begins a new list, a number
//! that has come before replaces), then [`Topic::BestCandidate`], which is answered by
//! [`Report::Choice`] as often as it is asked. `Commit`, `Reset`, `Configure` and `Believe` forget the
//! list, for it was about another belief. A board whose firmware is older than these messages counts
//! them as damaged and does not answer.
//!
//! # What a receiver counts
//!
//! [`Decoder`] takes any bytes, never panics, holds at most one frame, and finds its place again at
//! the next delimiter. [`Counters`] says how many frames were damaged and how, and how many were
//! lost, doubled or late by their sequence numbers.

mod candidate;
mod codec;
mod estimate;
mod frame;
mod grasp;
mod quantity;
mod sensor;

pub use candidate::{CandidateFrame, ChoiceFrame, StrokeFrame};
pub use codec::{
    Arrival, Counters, Decoder, EncodeError, FrameError, MAX_FRAME, Received, encode, seal, unseal,
};
pub use estimate::{BeliefFrame, EstimateFrame, FaceFrame, FaceSummary, ModeFrame};
pub use frame::{
    BoardKind, Command, Frame, Health, Hello, PROTOCOL, Refusal, Reply, Report, SHORTEST_STREAM,
    Settings, Topic, TrackerKind,
};
pub use grasp::{ContactFrame, FreeFrame, MotionFrame};
pub use quantity::{Clock, Field, Fraction, WireSpace};
pub use sensor::{
    FingerFrame, FingerState, FingertipFrame, SensorFault, SensorFrame, SensorPart, Skin, Words,
    WordsFrame,
};
