//! Pose graphs as `.g2o` files, the format every tool of the field reads and writes.
//!
//! One line per thing, words separated by blanks, metres and radians:
//!
//! ```text
//! VERTEX_SE2 id x y angle
//! VERTEX_SE3:QUAT id x y z qx qy qz qw
//! EDGE_SE2 from to x y angle I11 I12 I13 I22 I23 I33
//! EDGE_SE3:QUAT from to x y z qx qy qz qw I11 I12 … I66
//! FIX id …
//! ```
//!
//! The upper triangle of the information Ω goes by rows: x, y, angle in the plane; x, y, z, qx, qy, qz
//! in space, so that Ω weighs the vector of the error's quaternion, half the angle. `#` starts a comment.
//! Lines of other kinds are skipped, counted, reported and written again as they are; everything else that
//! is not as above is an error that names line and field.
//!
//! ```
//! use tactile_host::graph::pose::g2o;
//!
//! let text = "VERTEX_SE2 7 0 0 0\nVERTEX_SE2 9 1 0 0\nEDGE_SE2 7 9 1.1 0 0 100 0 0 100 0 400\nFIX 7\n";
//! let file = g2o::parse(text.as_bytes(), "two.g2o".as_ref())?;
//! let g2o::Graph::Planar(graph) = file.graph else { unreachable!() };
//! assert_eq!((graph.ids, graph.fixed), (vec![7, 9], vec![0]));
//! # Ok::<(), g2o::G2oError>(())
//! ```

mod entry;
mod number;
mod read;
mod write;

pub use read::{parse, read};
pub use write::{write, write_to};

use std::path::{Path, PathBuf};

use super::{PoseGraph2, PoseGraph3};

/// A pose graph of the plane or of space.
#[derive(Clone, Debug, PartialEq)]
pub enum Graph {
    /// Of the plane.
    Planar(PoseGraph2),
    /// Of space.
    Spatial(PoseGraph3),
}

/// What a `.g2o` file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct G2o {
    /// The graph; poses in the order of their lines, or of their ids where the file has edges alone.
    pub graph: Graph,
    /// Whether the file says where the poses are. In a file of edges alone all are the identity, to be
    /// filled in from the edges.
    pub has_poses: bool,
    /// The line of each edge, from 1.
    pub edge_lines: Vec<usize>,
    /// Lines that were skipped, by kind, in the order they appear first.
    pub skipped: Vec<Skipped>,
    /// Those lines as they are, for [`write()`].
    pub unknown: Vec<String>,
    /// Quaternions whose length was more than 1 % off 1 and was corrected.
    pub normalised: usize,
    /// Angles beyond a full turn, which are wrapped: a hint that the file has degrees.
    pub wide_angles: usize,
}

/// Lines of a kind that the reader does not know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// Their first word.
    pub kind: String,
    /// How many.
    pub count: usize,
    /// The first of them, from 1.
    pub line: usize,
}

/// Why a `.g2o` file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum G2oError {
    /// The system says no.
    #[error("{}: cannot {action}: {source}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// `read` or `write`.
        action: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line is not what the format asks for.
    #[error("{}, line {line}, {field}: expected {expected}, found {found}", file.display())]
    Line {
        /// Which file.
        file: PathBuf,
        /// From 1.
        line: usize,
        /// Which part of it.
        field: String,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The file as a whole is no pose graph.
    #[error("{}: expected {expected}, found {found}", file.display())]
    Content {
        /// Which file.
        file: PathBuf,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
}

/// Something wrong in a file whose name the parser does not know.
#[derive(Debug)]
struct Wrong {
    /// `None` where no line is to blame.
    line: Option<usize>,
    field: String,
    expected: String,
    found: String,
}

impl Wrong {
    fn whole(expected: impl Into<String>, found: impl Into<String>) -> Wrong {
        Wrong { line: None, field: String::new(), expected: expected.into(), found: found.into() }
    }

    fn at(
        line: usize,
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Wrong {
        let (field, expected, found) = (field.into(), expected.into(), found.into());
        Wrong { line: Some(line), field, expected, found }
    }

    fn of(self, file: &Path) -> G2oError {
        let Wrong { line, field, expected, found } = self;
        let file = file.into();
        match line {
            Some(line) => G2oError::Line { file, line, field, expected, found },
            None => G2oError::Content { file, expected, found },
        }
    }
}

#[cfg(test)]
mod tests;
