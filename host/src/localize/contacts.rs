//! Contacts on an object at rest, from logs and lists.

use std::path::Path;

use nalgebra::Point3;

use crate::log::import::{self, Options};
use crate::log::{GraspLog, LogError};
use crate::reference::Contact;
use crate::slam::deviations;
use crate::space::{Point, Pose};

/// Endings of the files that hold contacts.
pub const ENDINGS: &str = ".jsonl, .csv or .off";

/// Whether to believe a log that its object moved between grasps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fixed {
    /// It did not move, whatever the log says.
    Yes,
    /// It moved as the log says.
    No,
}

/// Why a file gives no contacts.
#[derive(Debug, thiserror::Error)]
pub enum ContactsError {
    /// It cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The ending names no format.
    #[error("{file}: expected a file of contacts ending in {ENDINGS}")]
    Ending {
        /// Which file.
        file: String,
    },
    /// A planar log.
    #[error("expected contacts in space (dimension 3), found a planar log (dimension 2)")]
    Planar,
    /// Where the object was before is not known.
    #[error("grasp {grasp}, field `motion`: expected how the object moved, found none; if it did not move, say --fixed")]
    Motion {
        /// Its number.
        grasp: u64,
    },
}

/// Reads contacts: a grasp log (`.jsonl`), a table (`.csv`) or a list of points (`.off`), the
/// latter two of an object that did not move. See [`from_log`].
///
/// # Errors
/// Naming the file, line and field and what was expected there.
pub fn read(path: &Path, fixed: Fixed) -> Result<(GraspLog, Vec<Contact>), ContactsError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let at_rest = Options { fixed: true, ..Options::default() };
    let log = match ending.as_str() {
        "jsonl" => GraspLog::read(path)?,
        "csv" => import::csv::import(path, &at_rest)?,
        "off" => import::off::import(path, &at_rest)?,
        _ => return Err(ContactsError::Ending { file: path.display().to_string() }),
    };
    let contacts = from_log(&log, fixed)?;
    Ok((log, contacts))
}

/// All contacts of a log where the object was at its **last** grasp, world frame.
///
/// Contacts of earlier grasps are carried along by the motions that the log states, and the noise
/// it states for these widens their deviations: by nσ² after n motions, turns counted at the
/// contact's distance from the middle of its grasp. That these errors are common to the contacts of
/// a grasp is not used.
///
/// # Errors
/// For planar logs, and where a motion is unknown and the object not said to be fixed.
pub fn from_log(log: &GraspLog, fixed: Fixed) -> Result<Vec<Contact>, ContactsError> {
    if log.dimension != 3 {
        return Err(ContactsError::Planar);
    }
    let mut contacts = Vec::new();
    // From the grasp at hand to the last.
    let mut onwards = Pose::identity();
    let mut motions = 0.0;
    for (k, grasp) in log.grasps.iter().enumerate().rev() {
        let middle = grasp.contacts.iter().map(|c| c.point).sum::<Point>()
            / grasp.contacts.len().max(1) as f64;
        let placed = grasp.contacts.iter().map(|c| {
            let (point, normal) = deviations(c, &log.noise);
            let shift = log.noise.translation.unwrap_or(0.0);
            let turn = log.noise.rotation.unwrap_or(0.0);
            let at_rim = turn * (c.point - middle).norm();
            let moved = motions * (shift * shift + at_rim * at_rim);
            Contact {
                point: (onwards * Point3::from(c.point)).coords,
                normal: c.normal.map(|n| onwards.rotation * n),
                point_deviation: (point * point + moved).sqrt(),
                normal_deviation: (normal * normal + motions * turn * turn).sqrt(),
            }
        });
        contacts.extend(placed);
        if k > 0 && fixed == Fixed::No {
            let motion = grasp.motion.ok_or(ContactsError::Motion { grasp: grasp.index })?;
            onwards *= motion;
            onwards.rotation.renormalize();
            motions += 1.0;
        }
    }
    Ok(contacts)
}
