//! Other people's data as grasp logs: robot pushes, tables of contacts, bare contact points.

use std::path::Path;

use super::read::unmarked;
use super::{GraspLog, LogError, LoggedGrasp, MAX_CONTACTS, Noise};
use crate::quantity::Deviation;
use crate::space::Pose;

/// How far an object moves that does not.
const STILL: Deviation = Deviation { length: 0.0, angle: 0.0 };

pub mod csv;
pub mod normals;
pub mod off;
pub mod push;
mod tokens;

/// What a table or a list of contacts does not say itself.
#[derive(Clone, Debug)]
pub struct Options {
    /// Metres per unit of the coordinates.
    pub unit: f64,
    /// Standard deviations of the contacts, where known.
    pub contact_noise: Option<Deviation>,
    /// Standard deviations of the object's motion between grasps, where known.
    pub motion_noise: Option<Deviation>,
    /// The object did not move: motions and true poses become the identity, and the object frame
    /// is the world's.
    pub fixed: bool,
    /// What it is, in words.
    pub description: String,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            unit: 1.0,
            contact_noise: None,
            motion_noise: None,
            fixed: false,
            description: String::new(),
        }
    }
}

impl Options {
    /// The log of these grasps.
    fn log(
        &self,
        dimension: usize,
        fingers: Vec<String>,
        mut grasps: Vec<LoggedGrasp>,
    ) -> GraspLog {
        if self.fixed {
            for (k, grasp) in grasps.iter_mut().enumerate() {
                grasp.motion = (k > 0).then(Pose::identity);
                grasp.truth = Some(Pose::identity());
            }
        }
        GraspLog {
            dimension,
            description: self.description.clone(),
            fingers,
            // What does not move has no noise to make up for.
            noise: Noise::stated(
                self.contact_noise,
                self.motion_noise.or(self.fixed.then_some(STILL)),
            ),
            shape: None,
            grasps,
            unknown: serde_json::Map::new(),
        }
    }
}

/// The whole file as text.
fn text(path: &Path) -> Result<String, LogError> {
    let bytes = std::fs::read(path).map_err(|source| LogError::Io {
        file: path.into(),
        action: "read",
        source,
    })?;
    String::from_utf8(unmarked(&bytes).to_vec()).map_err(|e| {
        let before = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|b| **b == b'\n').count();
        LogError::Line { file: path.into(), line, problem: "is not UTF-8 text".into() }
    })
}

/// What more than [`MAX_CONTACTS`] contacts in one grasp get.
fn too_many(count: usize) -> String {
    format!("expected at most {MAX_CONTACTS} contacts in one grasp, found {count}")
}
