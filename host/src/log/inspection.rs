//! What is in a recording, in words and figures, for `tactile inspect`.

use std::fmt;
use std::path::Path;

use serde_json::{Value, json};
use tactile_core::wire::{Counters, Hello, TrackerKind};

use super::recording::{Header, Recording, RecordingError};
use super::replayed::Replayed;

/// The contents of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection {
    /// What it is of.
    pub header: Header,
    /// Number of pieces.
    pub pieces: usize,
    /// Bytes of a torn last piece.
    pub torn: usize,
    /// Unreadable pieces.
    pub damaged: usize,
    /// The byte at which another recording begins, of which nothing is told.
    pub another: Option<u64>,
    /// What they tell.
    pub replayed: Replayed,
}

/// Reads a recording and sums it up.
///
/// # Errors
/// When the file is not a recording.
pub fn inspect_recording(path: &Path) -> Result<Inspection, RecordingError> {
    let recording = Recording::read(path)?;
    let replayed = recording.replay();
    let Recording { header, pieces, torn, damaged, another } = recording;
    Ok(Inspection { header, pieces: pieces.len(), torn, damaged, another, replayed })
}

fn counters(c: &Counters) -> Value {
    json!({
        "frames": c.frames, "damaged": c.damaged(), "lost": c.lost, "doubled": c.doubled,
        "late": c.late,
    })
}

impl Inspection {
    /// The same as JSON.
    pub fn to_json(&self) -> Value {
        let r = &self.replayed;
        json!({
            "format": "tactile-recording", "protocol": self.header.protocol,
            "dimension": self.header.dimension, "description": self.header.description,
            "fingers": self.header.fingers, "seconds": r.duration.as_secs_f64(),
            "grasps": r.log.grasps.len(), "contacts": self.contacts(), "estimates": r.estimates.len(),
            "pieces": self.pieces, "torn_bytes": self.torn, "damaged_pieces": self.damaged,
            "another_recording_at": self.another,
            "from_board": counters(&r.from_board), "to_board": counters(&r.to_board),
            "refused": r.refused,
            "left_out": {
                "grasps": r.left_out.grasps, "contacts": r.left_out.contacts,
                "motions": r.left_out.motions, "noise": r.left_out.noise,
            },
        })
    }

    fn contacts(&self) -> usize {
        self.replayed.log.grasps.iter().map(|g| g.contacts.len()).sum()
    }
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (header, r) = (&self.header, &self.replayed);
        writeln!(
            f,
            "recording, {} dimensions, protocol {}, {:.2} s",
            header.dimension,
            header.protocol,
            r.duration.as_secs_f64()
        )?;
        if !header.description.is_empty() {
            writeln!(f, "  {}", header.description)?;
        }
        if let Some(hello) = r.hello {
            let [major, minor, patch] = hello.firmware;
            writeln!(
                f,
                "board: {:?}, firmware {major}.{minor}.{patch}: {:?}, {}, {} contacts a grasp",
                hello.board,
                hello.tracker,
                capacity(&hello),
                hello.contacts
            )?;
        }
        writeln!(
            f,
            "{} grasps, {} contacts, {} estimates, {} commands refused",
            r.log.grasps.len(),
            self.contacts(),
            r.estimates.len(),
            r.refused
        )?;
        for (name, c) in [("from the board", &r.from_board), ("to the board", &r.to_board)] {
            writeln!(
                f,
                "frames {name}: {} good, {} damaged, {} lost, {} doubled, {} late",
                c.frames,
                c.damaged(),
                c.lost,
                c.doubled,
                c.late
            )?;
        }
        write!(f, "{} pieces", self.pieces)?;
        if self.damaged > 0 {
            write!(f, ", {} damaged and skipped", self.damaged)?;
        }
        if self.torn > 0 {
            write!(f, ", a torn last one of {} bytes skipped", self.torn)?;
        }
        if let Some(at) = self.another {
            write!(f, ", another recording from byte {at} on left out")?;
        }
        writeln!(f)?;
        r.left_out.sentences().iter().try_for_each(|sentence| writeln!(f, "{sentence}"))
    }
}

/// What a board's tracker has room for, in words.
pub(crate) fn capacity(hello: &Hello) -> String {
    let Hello { particles, map, .. } = hello;
    match hello.tracker {
        TrackerKind::Bootstrap => format!("{particles} particles, map of {map} contacts"),
        TrackerKind::RaoBlackwell => format!("{particles} particles of {map} faces"),
        TrackerKind::Hypotheses => format!("{particles} hypotheses of {map} faces"),
        TrackerKind::Curved => format!("{particles} trajectories, map of {map} contacts"),
        TrackerKind::Automatic => format!("{particles} hypotheses and trajectories, {map} faces"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tactile_core::wire::{BoardKind, PROTOCOL};

    #[test]
    fn a_board_has_room_for_what_its_tracker_keeps() {
        let said = |tracker| {
            capacity(&Hello {
                protocol: PROTOCOL,
                firmware: [0, 1, 0],
                board: BoardKind::Virtual,
                tracker,
                dimension: 2,
                contacts: 16,
                map: 10,
                particles: 4,
                fingers: 0,
            })
        };
        assert_eq!(said(TrackerKind::Bootstrap), "4 particles, map of 10 contacts");
        assert_eq!(said(TrackerKind::Hypotheses), "4 hypotheses of 10 faces");
    }
}
