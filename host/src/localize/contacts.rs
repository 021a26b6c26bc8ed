//! Contacts on an object at rest, from logs and lists.

use std::path::Path;

use nalgebra::Point3;
use tactile_core::track::MotionNoise;

use crate::log::import::{self, Options};
use crate::log::{GraspLog, LogError};
use crate::quantity::Deviation;
use crate::reference::Contact;
use crate::slam::deviations;
use crate::space::{Pose, centroid};

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
    #[error(
        "grasp {grasp}, field `motion`: expected how the object moved, found none; if it did not move, say --fixed"
    )]
    Motion {
        /// Its number.
        grasp: u64,
    },
}

/// Reads contacts: a grasp log (`.jsonl`), a table (`.csv`) or a list of points (`.off`), the
/// latter two of an object that did not move; where `noise` is given, all as exact as that instead of what
/// the file says. See [`from_log`].
///
/// # Errors
/// Naming the file, line and field and what was expected there.
pub fn read(
    path: &Path,
    fixed: Fixed,
    noise: Option<Deviation>,
) -> Result<(GraspLog, Vec<Contact>), ContactsError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let at_rest = Options { fixed: true, ..Options::default() };
    let mut log = match ending.as_str() {
        "jsonl" => GraspLog::read(path)?,
        "csv" => import::csv::import(path, &at_rest)?,
        "off" => import::off::import(path, &at_rest)?,
        _ => return Err(ContactsError::Ending { file: path.display().to_string() }),
    };
    let fixed = if ending == "jsonl" { fixed } else { Fixed::Yes };
    if let Some(Deviation { length, angle }) = noise {
        (log.noise.point, log.noise.normal) = (Some(length), Some(angle));
        let contacts = log.grasps.iter_mut().flat_map(|grasp| &mut grasp.contacts);
        contacts.for_each(|contact| contact.normal_noise = None);
    }
    let contacts = from_log(&log, fixed)?;
    Ok((log, contacts))
}

/// All contacts of a log where the object was at its **last** grasp, world frame: those of that grasp first,
/// then those of the one before it, and so on.
///
/// Contacts of earlier grasps are carried along by the motions that the log states, and the noise
/// it states for these ([`MotionNoise::THESIS`] where it does not) widens their deviations: by nσ² after n
/// motions, turns counted at the contact's distance from the middle of all. These errors are common to the m contacts
/// of a grasp, which together say no more of the pose than one: each is widened by m times that.
///
/// # Errors
/// For planar logs, and where a motion is unknown and the object not said to be fixed.
pub fn from_log(log: &GraspLog, fixed: Fixed) -> Result<Vec<Contact>, ContactsError> {
    if log.dimension != 3 {
        return Err(ContactsError::Planar);
    }
    // With the number of motions since each was felt, times those that share their errors.
    let mut contacts: Vec<(Contact, f64)> = Vec::new();
    // From the grasp at hand to the last.
    let mut onwards = Pose::identity();
    let mut motions = 0.0;
    for (k, grasp) in log.grasps.iter().enumerate().rev() {
        let placed = grasp.contacts.iter().map(|c| {
            let (point_deviation, normal_deviation) = deviations(c, &log.noise);
            let point = (onwards * Point3::from(c.point)).coords;
            let normal = c.normal.map(|n| onwards.rotation * n);
            let contact = Contact { point, normal, point_deviation, normal_deviation };
            (contact, motions * grasp.contacts.len() as f64)
        });
        contacts.extend(placed);
        if k > 0 && fixed == Fixed::No {
            let motion = grasp.motion.ok_or(ContactsError::Motion { grasp: grasp.index })?;
            onwards *= motion;
            onwards.rotation.renormalize();
            motions += 1.0;
        }
    }
    let middle = centroid(contacts.iter().map(|(c, _)| c.point));
    let usual = MotionNoise::THESIS;
    let shift = log.noise.translation.unwrap_or(f64::from(usual.translation));
    let turn = log.noise.rotation.unwrap_or(f64::from(usual.rotation));
    let widened = contacts.into_iter().map(|(contact, motions)| {
        let root = motions.sqrt();
        let moved = root * shift.hypot(turn * (contact.point - middle).norm());
        Contact {
            point_deviation: contact.point_deviation.hypot(moved),
            normal_deviation: contact.normal_deviation.hypot(root * turn),
            ..contact
        }
    });
    Ok(widened.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{LoggedContact, LoggedGrasp};
    use crate::space::Point;

    fn grasp(index: u64, motion: Option<Pose>, point: Point) -> LoggedGrasp {
        let contact = LoggedContact { point, normal: Some(Point::x()), ..LoggedContact::default() };
        LoggedGrasp { index, motion, contacts: vec![contact], ..LoggedGrasp::default() }
    }

    fn log(grasps: Vec<LoggedGrasp>) -> GraspLog {
        let line = r#"{"format":"tactile-grasp-log","version":1,"dimension":3,
            "noise":{"point":0.002,"translation":0.003,"rotation":1e-9}}"#
            .replace('\n', "");
        let text = format!("{line}\n{{\"grasp\":0,\"contacts\":[]}}\n");
        GraspLog { grasps, ..GraspLog::parse(text.as_bytes(), "some.jsonl".as_ref()).unwrap() }
    }

    #[test]
    fn earlier_contacts_move_with_the_object() {
        let quarter =
            Pose::new(Point::new(1.0, 0.0, 0.0), Point::z() * std::f64::consts::FRAC_PI_2);
        let up = Pose::translation(0.0, 0.0, 0.5);
        let log = log(vec![
            grasp(0, None, Point::new(0.1, 0.0, 0.0)),
            grasp(1, Some(quarter), Point::new(0.2, 0.0, 0.0)),
            grasp(2, Some(up), Point::new(0.3, 0.0, 0.0)),
        ]);
        let contacts = from_log(&log, Fixed::No).unwrap();
        let order: Vec<f64> = contacts.iter().map(|c| c.point.norm()).collect();
        assert!(order.is_sorted_by_key(|x| (x - 0.3).abs() > 1e-12), "{order:?}");
        let at = |x: f64| contacts.iter().find(|c| (c.point.norm() - x).abs() < 1e-12).unwrap();
        // The last stays, the one before is lifted, the first turned and lifted.
        assert_eq!(at(0.3).point_deviation, 0.002);
        let second = contacts.iter().find(|c| (c.point.x - 0.2).abs() < 1e-12).unwrap();
        assert_eq!((second.point.z, second.normal), (0.5, Some(Point::x())));
        assert!((second.point_deviation - 0.002f64.hypot(0.003)).abs() < 1e-12);
        let first = contacts.iter().find(|c| (c.point.x - 1.0).abs() < 1e-12).unwrap();
        assert!((first.point - Point::new(1.0, 0.1, 0.5)).norm() < 1e-12);
        assert!((first.normal.unwrap() - Point::y()).norm() < 1e-12);
        assert!(first.point_deviation > second.point_deviation);
        // Or all stay.
        let still = from_log(&log, Fixed::Yes).unwrap();
        assert!(still.iter().all(|c| c.point.z == 0.0 && c.point_deviation == 0.002));
    }

    /// What the user says of contacts says nothing of the motions since.
    #[test]
    fn noise_that_is_told_is_that_of_contacts_alone() {
        let up = Some(Pose::translation(0.0, 0.0, 0.5));
        let mut log = log(vec![grasp(0, None, Point::x() * 0.1), grasp(1, up, Point::x() * 0.1)]);
        log.grasps[1].contacts[0].normal_noise = Some(0.5);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        log.write(&path).unwrap();
        let told = Some(Deviation { length: 4e-3, angle: 0.2 });
        let (_, contacts) = read(&path, Fixed::No, told).unwrap();
        let [last, first] = &contacts[..] else { panic!("{contacts:?}") };
        assert_eq!((last.point_deviation, last.normal_deviation), (0.004, 0.2));
        assert!((first.point_deviation - 0.005).abs() < 1e-9, "{first:?}");
        let (_, contacts) = read(&path, Fixed::Yes, told).unwrap();
        assert!(contacts.iter().all(|c| (c.point_deviation, c.normal_deviation) == (0.004, 0.2)));
    }

    #[test]
    fn contacts_that_share_an_error_say_as_much_as_one() {
        let still = Some(Pose::identity());
        let mut log =
            log(vec![grasp(0, None, Point::x() * 0.1), grasp(1, still, Point::x() * 0.1)]);
        let first = log.grasps[0].contacts[0].clone();
        log.grasps[0].contacts = vec![first; 4];
        let contacts = from_log(&log, Fixed::No).unwrap();
        let added = |c: &Contact| c.point_deviation.powi(2) - 0.002f64.powi(2);
        assert!(added(&contacts[0]).abs() < 1e-12, "{contacts:?}");
        let information: f64 = contacts[1..].iter().map(|c| 1.0 / added(c)).sum();
        assert!((information * 0.003f64.powi(2) - 1.0).abs() < 1e-9, "{contacts:?}");
    }

    /// Fingers that touch in turn turn about the object's middle, not each about itself.
    #[test]
    fn turns_count_where_contacts_are_far_apart() {
        let still = Some(Pose::identity());
        let [left, right] = [-0.05, 0.05].map(|x| Point::new(x, 0.0, 0.0));
        let grasps = vec![grasp(0, None, left), grasp(1, still, right), grasp(2, still, left)];
        let mut log = log(grasps);
        log.noise.rotation = Some(0.3);
        let contacts = from_log(&log, Fixed::No).unwrap();
        let mut deviations: Vec<f64> = contacts.iter().map(|c| c.point_deviation).collect();
        deviations.sort_by(f64::total_cmp);
        let middle: f64 = -0.05 / 3.0;
        let after = |n: f64, x: f64| (4e-6 + n * (9e-6 + (0.3 * (x - middle)).powi(2))).sqrt();
        let expected = [0.002, after(2.0, -0.05), after(1.0, 0.05)];
        for (found, expected) in deviations.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{deviations:?}");
        }
    }

    #[test]
    fn unknown_motions_and_planar_logs_are_refused() {
        let unknown = log(vec![grasp(0, None, Point::x()), grasp(4, None, Point::x())]);
        let error = from_log(&unknown, Fixed::No).unwrap_err().to_string();
        assert!(error.contains("grasp 4, field `motion`") && error.contains("--fixed"), "{error}");
        assert_eq!(from_log(&unknown, Fixed::Yes).unwrap().len(), 2);
        let planar = GraspLog { dimension: 2, ..unknown };
        assert!(matches!(from_log(&planar, Fixed::Yes), Err(ContactsError::Planar)));
    }
}
