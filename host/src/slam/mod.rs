//! The main job: a grasp log in, the object's poses and shape out.
//!
//! [`track`] follows the object with one of the core's [`trackers`] (or takes the log's true poses),
//! [`reconstruct`] builds the surface that [`choose`] finds fit from all contacts at those poses, but
//! for those that [`sift`] finds wild, and their images where [`mirrors`] finds the object its own, and [`output`]
//! evaluates and writes what a reader wants: report, shape, trajectory and picture, [`replay`] makes a scene that
//! plays, [`recorded`] one of a link's recording.

pub mod blend;
pub mod choose;
mod extraction;
pub mod fit;
pub mod free;
pub mod gauge;
pub mod mirrors;
pub mod misses;
pub mod odometry_graph;
pub mod output;
pub mod place;
pub mod reconstruct;
pub mod recorded;
pub mod replay;
pub mod sift;
pub mod track;
pub mod trackers;

use crate::log::{LoggedContact, Noise};

/// Told how far long work is: parts done, and of how many. From any thread.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// Standard deviation of a contact point where the log does not say: 1 mm (thesis 3.4).
pub const POINT_DEVIATION: f64 = 1e-3;

/// Standard deviation of a normal where the log does not say: 5° (thesis 3.4), radians.
pub const NORMAL_DEVIATION: f64 = 0.0873;

/// What the models assume of one contact: deviations of the point (metres) and of the normal
/// (radians).
pub fn deviations(contact: &LoggedContact, noise: &Noise) -> (f64, f64) {
    let (point, normal) = usual_deviations(noise);
    (point, contact.normal_noise.map_or(normal, |n| n.max(Noise::LEAST_NORMAL)))
}

/// The same for a contact that says nothing of its own.
pub fn usual_deviations(noise: &Noise) -> (f64, f64) {
    let point = noise.point.unwrap_or(POINT_DEVIATION);
    let normal = noise.normal.unwrap_or(NORMAL_DEVIATION);
    (point.max(Noise::LEAST_POINT), normal.max(Noise::LEAST_NORMAL))
}
