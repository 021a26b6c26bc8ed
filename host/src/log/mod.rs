//! Grasp logs: the interchange format with researchers, in memory and as JSON lines.
//!
//! One JSON object a line, SI units, world frame: a header, then one line per grasp. What may be
//! left out has a question mark.
//!
//! ```text
//! header   format: "tactile-grasp-log", version: 1, dimension: 2 or 3, frame?: "world",
//!          description?, fingers?: [name, …],
//!          noise?: {point?, normal?, translation?, rotation?}          m, rad, m, rad
//!          truth?: {shape?: {polygon: [[x, y], …]} or {mesh: FILE}}    object frame, m
//! grasp    grasp: 0, 1, …, contacts: [contact, …], motion?: pose, time?: s,
//!          free?: [{finger?, point}, …], truth?: {pose?: pose}
//! contact  point: [x, y(, z)], normal?: unit, out of the object, normal_noise?: rad,
//!          finger?: name, force?: N
//! pose     translation: [x, y(, z)], rotation: angle, or in space quaternion [x, y, z, w]
//! ```
//!
//! A true pose maps object to world, a motion world to world: predicted pose = motion · previous
//! pose. Without a motion there was none before the first grasp; later it is unknown. A mesh file
//! is named relative to the log. Where the noise is not stated, readers take 1 mm and 5° of
//! contacts ([`crate::slam::POINT_DEVIATION`], [`crate::slam::NORMAL_DEVIATION`]), 10 mm and 20° of
//! motions ([`tactile_core::track::MotionNoise::THESIS`]), and never less than [`Noise`] says.
//!
//! [`GraspLog::read`] says what is checked, [`words`] what fingertip sensors add, [`replayed`] what
//! a recording does. `docs/formats.md` has all of it with examples.

pub mod import;
pub mod inspection;
pub mod read;
pub mod recording;
pub mod replayed;
pub mod words;
pub mod write;

use std::path::PathBuf;

use crate::quantity::Deviation;
use crate::space::{Point, Pose};

pub use read::LogError;

/// The value of the header's `format`.
pub const FORMAT: &str = "tactile-grasp-log";

/// The only version of the format there is.
pub const VERSION: u64 = 1;

/// Most contacts, and most free points, one grasp may have: far above any hand, low enough that a
/// damaged or hostile log cannot exhaust memory downstream.
pub const MAX_CONTACTS: usize = 1024;

/// Most fingers a log may name: the core numbers them with one byte.
pub const MAX_FINGERS: usize = 255;

/// Coordinates beyond this many metres are refused: they are another unit or damage, and would not
/// survive single precision.
pub const MAX_COORDINATE: f64 = 1e4;

/// A whole log: header and grasps in time order.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspLog {
    /// 2 or 3.
    pub dimension: usize,
    /// What it is, in words.
    pub description: String,
    /// Names of the fingers; [`LoggedContact::finger`] is an index into it.
    pub fingers: Vec<String>,
    /// Standard deviations of what was measured, where the recorder knew them.
    pub noise: Noise,
    /// The true shape, for evaluation only.
    pub shape: Option<TrueShape>,
    /// The grasps.
    pub grasps: Vec<LoggedGrasp>,
    /// Header fields this version does not know, kept on rewrite. Those inside `noise` and `truth`
    /// are here under the same name.
    pub unknown: serde_json::Map<String, serde_json::Value>,
}

/// Standard deviations; `None` where the log does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Contact point, metres per axis.
    pub point: Option<f64>,
    /// Contact normal, radians per axis.
    pub normal: Option<f64>,
    /// Translation of the object between grasps, metres per axis.
    pub translation: Option<f64>,
    /// Rotation of the object between grasps, radians per axis.
    pub rotation: Option<f64>,
}

impl Noise {
    /// The least that models take of points, so that contacts without errors make nothing singular: 0.1 mm, in metres.
    pub const LEAST_POINT: f64 = 1e-4;
    /// Of normals: 0.5°, in radians.
    pub const LEAST_NORMAL: f64 = 0.0087;
    /// Of translations, so that particles differ: 0.1 mm, in metres.
    pub const LEAST_TRANSLATION: f64 = 1e-4;
    /// Of rotations: 0.06°, in radians.
    pub const LEAST_ROTATION: f64 = 1e-3;

    /// What a header says of contacts (points and normals) and motions with these deviations: where they have no errors
    /// the least that models take, for what a header does not say is taken to be usual.
    pub fn stated(contact: Option<Deviation>, motion: Option<Deviation>) -> Noise {
        Noise {
            point: contact.map(|d| d.length.max(Self::LEAST_POINT)),
            normal: contact.map(|d| d.angle.max(Self::LEAST_NORMAL)),
            translation: motion.map(|d| d.length.max(Self::LEAST_TRANSLATION)),
            rotation: motion.map(|d| d.angle.max(Self::LEAST_ROTATION)),
        }
    }
}

/// The true shape in the object frame, as the header names it.
#[derive(Clone, Debug, PartialEq)]
pub enum TrueShape {
    /// Vertices of a simple polygon in order, metres (dimension 2).
    Polygon(Vec<[f64; 2]>),
    /// A mesh file (dimension 3). `path` is as written in the log; `file` is where it is.
    Mesh {
        /// As written: relative to the log.
        path: String,
        /// Resolved against the log's folder.
        file: PathBuf,
    },
}

/// One grasp: what the hand did, felt and did not feel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoggedGrasp {
    /// The grasp's number in the log, ascending.
    pub index: u64,
    /// Seconds since the start of the recording.
    pub time: Option<f64>,
    /// World-to-world motion since the previous grasp: predicted pose = motion · previous pose.
    /// `None` on the first grasp means none; later, unknown.
    pub motion: Option<Pose>,
    /// What was felt.
    pub contacts: Vec<LoggedContact>,
    /// Fingertips that closed on nothing.
    pub free: Vec<LoggedFree>,
    /// True pose of the object, for evaluation only.
    pub truth: Option<Pose>,
    /// Fields this version does not know, kept on rewrite. Those inside `truth` are here under the
    /// same name.
    pub unknown: serde_json::Map<String, serde_json::Value>,
}

/// One contact in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoggedContact {
    /// Index into [`GraspLog::fingers`].
    pub finger: Option<usize>,
    /// Where, metres.
    pub point: Point,
    /// Unit normal out of the object, where it was measured.
    pub normal: Option<Point>,
    /// Standard deviation of this normal in radians, where it differs from [`Noise::normal`]
    /// (field `normal_noise`).
    pub normal_noise: Option<f64>,
    /// Force in newtons.
    pub force: Option<f64>,
    /// Fields this version does not know, kept on rewrite.
    pub unknown: serde_json::Map<String, serde_json::Value>,
}

/// A fingertip position that touched nothing, world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoggedFree {
    /// Index into [`GraspLog::fingers`].
    pub finger: Option<usize>,
    /// Where, metres.
    pub point: Point,
    /// Fields this version does not know, kept on rewrite.
    pub unknown: serde_json::Map<String, serde_json::Value>,
}

#[cfg(test)]
mod tests;
