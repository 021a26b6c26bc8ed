//! Why a description is no hand.

use std::path::PathBuf;

use super::LONGEST;
use crate::shape::files::FileError;

/// Why a description is no hand.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct HandError {
    /// Where the description is from.
    pub file: String,
    /// What is wrong with it.
    pub problem: Box<Problem>,
}

/// What is wrong with a description.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The system says no.
    #[error("cannot read: {0}")]
    Io(std::io::Error),
    /// No URDF.
    #[error("not a URDF: {0}")]
    Text(String),
    /// A macro file.
    #[error("this is a xacro file, expected a URDF: run `xacro FILE > hand.urdf` first")]
    Xacro,
    /// Nothing in it.
    #[error("it has no links, expected a palm and fingers")]
    Empty,
    /// More than any hand has.
    #[error("{found} {what}, expected at most {most}")]
    Many {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// A name is used twice.
    #[error("{what} {name:?} is there twice")]
    Twice {
        /// `link` or `joint`.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A joint names a link that does not exist.
    #[error("joint {joint:?}: there is no link {link:?}")]
    NoLink {
        /// The joint.
        joint: String,
        /// What it names.
        link: String,
    },
    /// A link hangs on two joints.
    #[error("link {link:?} is the child of joints {first:?} and {second:?}, expected one parent")]
    TwoParents {
        /// The link.
        link: String,
        /// One joint.
        first: String,
        /// The other.
        second: String,
    },
    /// Every link is a child: there is no palm to begin at.
    #[error("every link is the child of another, expected one root, the palm")]
    NoRoot,
    /// Parts that do not hang together.
    #[error("links {0} are no joint's child, expected one root, the palm")]
    Roots(String),
    /// Links that hang on themselves.
    #[error("link {link:?} hangs on itself in a loop of joints")]
    Loop {
        /// One of them.
        link: String,
    },
    /// A joint that this model does not have.
    #[error("joint {joint:?} is {kind}, expected revolute, continuous, prismatic or fixed")]
    Kind {
        /// The joint.
        joint: String,
        /// Its type.
        kind: &'static str,
    },
    /// No axis.
    #[error("joint {joint:?}: axis {axis:?}, expected a finite direction that is not zero")]
    Axis {
        /// The joint.
        joint: String,
        /// What is there.
        axis: [f64; 3],
    },
    /// Limits that are no interval.
    #[error(
        "joint {joint:?}: limits from {lower} to {upper}, expected finite ones in rising order"
    )]
    Limits {
        /// The joint.
        joint: String,
        /// What is there.
        lower: f64,
        /// What is there.
        upper: f64,
    },
    /// A joint that follows one it cannot follow.
    #[error("joint {joint:?} mimics {of:?}: {problem}")]
    Mimic {
        /// The joint.
        joint: String,
        /// Whom it follows.
        of: String,
        /// Why it cannot.
        problem: &'static str,
    },
    /// A number that is not finite or out of all proportion.
    #[error("{place}: {what} {found:?}, expected finite numbers of at most {LONGEST} m")]
    Number {
        /// Link or joint.
        place: String,
        /// Which quantity.
        what: &'static str,
        /// What is there.
        found: Vec<f64>,
    },
    /// A solid without size.
    #[error("link {link:?}: {what} {found:?}, expected sizes above zero")]
    Size {
        /// The link.
        link: String,
        /// Which solid.
        what: &'static str,
        /// What is there.
        found: Vec<f64>,
    },
    /// A mesh that cannot be read.
    #[error("link {link:?}: mesh {source}")]
    Mesh {
        /// The link.
        link: String,
        /// Why not.
        source: FileError,
    },
    /// A mesh that encloses nothing.
    #[error("link {link:?}: mesh {}: its points span no volume", file.display())]
    Flat {
        /// The link.
        link: String,
        /// The mesh.
        file: PathBuf,
    },
    /// A mesh whose place is not known.
    #[error(
        "link {link:?}: mesh {uri:?} is in no folder above the URDF; expected a path relative to the \
         URDF, or its package's folder beside or above it"
    )]
    Package {
        /// The link.
        link: String,
        /// As written.
        uri: String,
    },
    /// Nothing to touch with.
    #[error(
        "no fingertip: expected a link with collision geometry that a joint moves and that carries \
         no other such link"
    )]
    NoTips,
    /// A fingertip that was asked for is none.
    #[error("fingertip {name:?}: {problem}")]
    Tip {
        /// As asked for.
        name: String,
        /// Why it is none.
        problem: &'static str,
    },
}
