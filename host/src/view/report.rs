//! The report of a run: how well the shape and the poses came out.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tactile_core::track::Status;

use crate::log::write::write_atomically;
use crate::shape::symmetry::Symmetry;
use crate::shape::{Geometry, align, metrics};
use crate::space::{Point, Pose};

/// `report.json`. Errors are `None` (`null`) where the truth or the estimate is missing; lengths in
/// millimetres and angles in degrees, rounded to a thousandth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Grasps in the log.
    pub grasps: usize,
    /// Contacts in all of them.
    pub contacts: usize,
    /// 2 or 3.
    pub dimension: usize,
    /// Which tracker estimated the poses.
    pub tracker: String,
    /// The shape against the true one.
    pub surface: SurfaceErrors,
    /// The poses against the true ones.
    pub pose: PoseErrors,
    /// Root mean square distance from the estimated surface to the contacts, taken to the object
    /// frame by the estimated poses, those of lost grasps left out: needs no truth.
    pub contact_rms_mm: Option<f64>,
    /// Contacts that the shape does not explain: wild ones, or those of grasps at wrong poses.
    #[serde(default)]
    pub unexplained: Unexplained,
    /// Wall-clock time of each stage.
    pub seconds: BTreeMap<String, f64>,
    /// Grasps that the tracker could not explain and no graph found.
    pub lost: Vec<u64>,
    /// Grasps that fit at several poses.
    #[serde(default)]
    pub ambiguous: Vec<u64>,
}

/// Contacts much farther from the shape than they are uncertain and than the others lie.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unexplained {
    /// How many.
    pub contacts: usize,
    /// Numbers of the grasps that felt them.
    pub grasps: Vec<u64>,
    /// Those of them that felt several contacts and nothing else: where the object was then, the shape does not say.
    pub wholly: Vec<u64>,
}

/// Distances between the estimated and the true surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceErrors {
    /// Which surface model made the estimate.
    pub model: String,
    /// In how many planes the object was taken to be its own mirror image.
    #[serde(default)]
    pub mirrors: usize,
    /// Hausdorff distance in the true object frame.
    pub hausdorff_mm: Option<f64>,
    /// Hausdorff distance after the best rigid alignment.
    pub hausdorff_aligned_mm: Option<f64>,
    /// Mean distance in the true object frame.
    pub mean_mm: Option<f64>,
    /// Root mean square distance in the true object frame.
    pub rms_mm: Option<f64>,
}

/// Errors of the poses: up to turns that map the true shape to itself, where that is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseErrors {
    /// One entry per grasp whose true pose is known.
    pub per_grasp: Vec<PoseError>,
    /// Translation error of the last of them.
    pub final_translation_mm: Option<f64>,
    /// Rotation error of the last of them.
    pub final_rotation_deg: Option<f64>,
    /// Root mean square over all of them.
    pub rms_translation_mm: Option<f64>,
    /// Root mean square over all of them.
    pub rms_rotation_deg: Option<f64>,
}

/// How far one estimated pose is from the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseError {
    /// The grasp's number in the log.
    pub grasp: u64,
    /// Length of the translation between them.
    pub translation_mm: f64,
    /// Angle of the rotation between them.
    pub rotation_deg: f64,
}

/// One grasp of a finished run.
#[derive(Clone, Debug)]
pub struct JudgedGrasp {
    /// The grasp's number in the log.
    pub index: u64,
    /// Estimated pose: estimated object frame to world.
    pub estimate: Pose,
    /// True pose: true object frame to world, where known.
    pub truth: Option<Pose>,
    /// Contact points in the world frame, metres.
    pub contacts: Vec<Point>,
    /// How much the tracker thought its estimate worth.
    pub status: Status,
}

/// Everything a report is made from.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// 2 or 3.
    pub dimension: usize,
    /// Which tracker estimated the poses.
    pub tracker: &'a str,
    /// Which surface model made the estimate.
    pub model: &'a str,
    /// In how many planes the object was taken to be its own mirror image.
    pub mirrors: usize,
    /// The grasps in time order.
    pub grasps: &'a [JudgedGrasp],
    /// The estimated shape in the estimated object frame.
    pub estimate: Option<&'a Geometry>,
    /// The true shape in the true object frame.
    pub truth: Option<&'a Geometry>,
    /// Contacts that the estimate does not explain.
    pub unexplained: &'a Unexplained,
    /// Wall-clock time of each stage, seconds.
    pub seconds: &'a [(&'a str, f64)],
}

/// Maps the true object frame to the estimated one: the two are free to differ, so they are made to
/// agree at the first grasp with a contact whose true pose is known: before, nobody knows where the object is. Where
/// nothing was felt, at the first whose true pose is known; `None` if none is.
pub fn gauge(grasps: &[JudgedGrasp]) -> Option<Pose> {
    agreed(grasps.iter().map(|g| (g.estimate, g.truth, !g.contacts.is_empty())))
}

/// The same from each grasp's estimated pose, its true one, and whether anything was felt.
pub fn agreed(grasps: impl Iterator<Item = (Pose, Option<Pose>, bool)> + Clone) -> Option<Pose> {
    let known = grasps.filter_map(|(pose, truth, felt)| Some((pose.inverse() * truth?, felt)));
    known.clone().find(|(_, felt)| *felt).or_else(|| known.clone().next()).map(|(gauge, _)| gauge)
}

/// The error of every pose that has a true one, given the [`gauge`]: the motion from the true pose
/// to the estimated one, seen from the true object frame, but for turns that nobody can see. Where the frames
/// agree it is zero by construction.
pub fn pose_errors(grasps: &[JudgedGrasp], gauge: &Pose, symmetry: &Symmetry) -> Vec<PoseError> {
    grasps
        .iter()
        .filter_map(|g| {
            let error = symmetry.rest(&(g.truth?.inverse() * g.estimate * gauge));
            Some(PoseError {
                grasp: g.index,
                translation_mm: error.translation.vector.norm() * 1e3,
                rotation_deg: error.rotation.angle().to_degrees(),
            })
        })
        .collect()
}

/// Root mean square distance from `surface` (estimated object frame) to all contacts but those of lost grasps, metres.
/// `None` without contacts or surface.
pub fn contact_rms(grasps: &[JudgedGrasp], surface: &Geometry) -> Option<f64> {
    if metrics::is_empty(surface) {
        return None;
    }
    let squares: Vec<f64> = grasps
        .iter()
        .filter(|g| g.status != Status::Lost)
        .flat_map(|g| {
            let to_object = g.estimate.inverse();
            g.contacts.iter().map(move |c| to_object * nalgebra::Point3::from(*c))
        })
        .map(|p| surface.distance(&p.coords).powi(2))
        .collect();
    root_mean(&squares)
}

impl Report {
    /// Judges a run. Shapes are compared in the true object frame, reached through the [`gauge`];
    /// without any true pose the frames cannot be related and the shape's errors stay `None`.
    pub fn new(run: &Run) -> Report {
        let gauge = gauge(run.grasps);
        let symmetry = || run.truth.map_or_else(Symmetry::none, Symmetry::of);
        let errors = gauge.map(|g| pose_errors(run.grasps, &g, &symmetry())).unwrap_or_default();
        let translations: Vec<f64> = errors.iter().map(|e| e.translation_mm.powi(2)).collect();
        let rotations: Vec<f64> = errors.iter().map(|e| e.rotation_deg.powi(2)).collect();
        let last = errors.last().copied();
        let shapes = match (run.estimate, run.truth, gauge) {
            (Some(estimate), Some(truth), Some(gauge)) => {
                Some((estimate.transformed(&gauge.inverse()), truth))
            }
            _ => None,
        };
        let plain = shapes.as_ref().and_then(|(e, t)| metrics::compare(e, t));
        let aligned =
            shapes.as_ref().and_then(|(e, t)| metrics::compare_at(e, &align::align(e, t), t));
        let millimetres = |metres: f64| rounded(metres * 1e3);
        let with = |status| {
            run.grasps.iter().filter(|g| g.status == status).map(|g| g.index).collect::<Vec<_>>()
        };
        Report {
            grasps: run.grasps.len(),
            contacts: run.grasps.iter().map(|g| g.contacts.len()).sum(),
            dimension: run.dimension,
            tracker: run.tracker.into(),
            surface: SurfaceErrors {
                model: run.model.into(),
                mirrors: run.mirrors,
                hausdorff_mm: plain.map(|d| millimetres(d.hausdorff)),
                hausdorff_aligned_mm: aligned.map(|d| millimetres(d.hausdorff)),
                mean_mm: plain.map(|d| millimetres(d.mean)),
                rms_mm: plain.map(|d| millimetres(d.rms)),
            },
            pose: PoseErrors {
                final_translation_mm: last.map(|e| rounded(e.translation_mm)),
                final_rotation_deg: last.map(|e| rounded(e.rotation_deg)),
                rms_translation_mm: root_mean(&translations).map(rounded),
                rms_rotation_deg: root_mean(&rotations).map(rounded),
                per_grasp: errors
                    .into_iter()
                    .map(|e| PoseError {
                        grasp: e.grasp,
                        translation_mm: rounded(e.translation_mm),
                        rotation_deg: rounded(e.rotation_deg),
                    })
                    .collect(),
            },
            contact_rms_mm: run.estimate.and_then(|e| contact_rms(run.grasps, e)).map(millimetres),
            unexplained: run.unexplained.clone(),
            seconds: run.seconds.iter().map(|(k, s)| (k.to_string(), rounded(*s))).collect(),
            lost: with(Status::Lost),
            ambiguous: with(Status::Ambiguous),
        }
    }

    /// As `report.json` holds it: indented, with a final line feed.
    pub fn to_json(&self) -> serde_json::Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Writes `report.json`, fully or not at all.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let text = self.to_json().map_err(std::io::Error::other)?;
        write_atomically(path, |out| out.write_all(text.as_bytes()))
    }
}

fn root_mean(squares: &[f64]) -> Option<f64> {
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty() && mean.is_finite()).then(|| mean.sqrt())
}

/// To a thousandth, without a negative zero.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3 + 0.0
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |value: Option<f64>, unit: &str| match value {
            Some(v) => format!("{v:.2} {unit}"),
            None => "–".into(),
        };
        writeln!(
            f,
            "{} grasps, {} contacts, {}D, tracker {}, surface {}",
            self.grasps, self.contacts, self.dimension, self.tracker, self.surface.model
        )?;
        match self.surface.mirrors {
            0 => {}
            1 => writeln!(f, "  taken to be its own mirror image in a plane")?,
            several => writeln!(f, "  taken to be its own mirror image in {several} planes")?,
        }
        let mut row = |name: &str, value: String, note: &str| {
            writeln!(f, "{}", format!("  {name:<22}{value:>12}  {note}").trim_end())
        };
        let s = &self.surface;
        row("shape, Hausdorff", show(s.hausdorff_aligned_mm, "mm"), "after the best alignment")?;
        row("", show(s.hausdorff_mm, "mm"), "in the object frame")?;
        row("shape, mean", show(s.mean_mm, "mm"), "in the object frame")?;
        let p = &self.pose;
        let turn = |degrees| format!("{:>10}", show(degrees, "°"));
        row("pose, last grasp", show(p.final_translation_mm, "mm"), &turn(p.final_rotation_deg))?;
        row("pose, rms", show(p.rms_translation_mm, "mm"), &turn(p.rms_rotation_deg))?;
        row("contacts to surface", show(self.contact_rms_mm, "mm"), "rms")?;
        let total: f64 = self.seconds.values().sum();
        row("time", show(Some(total), "s"), "")?;
        let list = |grasps: &[u64]| {
            let numbers: Vec<String> = grasps.iter().map(u64::to_string).collect();
            numbers.join(", ")
        };
        for (name, grasps) in [("lost grasps", &self.lost), ("ambiguous grasps", &self.ambiguous)] {
            if !grasps.is_empty() {
                row(name, grasps.len().to_string(), &list(grasps))?;
            }
        }
        let Unexplained { contacts, grasps, .. } = &self.unexplained;
        if *contacts > 0 {
            let note = format!("far from the shape, in grasp {}", list(grasps));
            row("unexplained contacts", contacts.to_string(), &note)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::Outline;
    use crate::space::planar;

    fn square(half: f64) -> Geometry {
        let loops = vec![vec![[-half, -half], [half, -half], [half, half], [-half, half]]];
        Geometry::Outline(Outline { loops })
    }

    /// Two grasps of a square whose estimated frame is `gauge` away from the true one; the second
    /// pose is 3 mm and 2° off, and what was felt there far from the surface.
    fn grasps(gauge: Pose) -> Vec<JudgedGrasp> {
        let truth = [planar(0.1, 0.2, 0.3), planar(0.15, 0.2, 1.0)];
        let error = planar(0.003, 0.0, 2.0_f64.to_radians());
        let estimate = [truth[0] * gauge.inverse(), truth[1] * error * gauge.inverse()];
        let felt = nalgebra::Point3::new(0.02, 0.001, 0.0);
        (0..2)
            .map(|k| JudgedGrasp {
                index: k as u64,
                estimate: estimate[k],
                truth: Some(truth[k]),
                contacts: vec![(estimate[k] * gauge * felt).coords + k as f64 * Point::x()],
                status: if k == 1 { Status::Lost } else { Status::Ambiguous },
            })
            .collect()
    }

    #[test]
    fn the_report_is_the_documented_json() {
        let gauge = planar(0.01, -0.02, 0.5);
        let grasps = grasps(gauge);
        let estimate = square(0.021).transformed(&gauge);
        let report = Report::new(&Run {
            dimension: 2,
            tracker: "bootstrap",
            model: "gp",
            mirrors: 0,
            grasps: &grasps,
            estimate: Some(&estimate),
            truth: Some(&square(0.02)),
            unexplained: &Unexplained { contacts: 1, grasps: vec![1], wholly: vec![] },
            seconds: &[("track", 0.25), ("surface", 0.0001)],
        });
        // √2 mm from corner to corner; every point of the inner square is 1 mm from the outer, the
        // outer's points up to the corner's √2.
        assert_eq!(report.surface.hausdorff_mm, Some(1.414));
        let mean = report.surface.mean_mm.unwrap();
        assert!(mean > 1.0 && mean < 1.02, "{mean}");
        let mut fixed = report.clone();
        fixed.surface.mean_mm = Some(1.005);
        fixed.surface.rms_mm = Some(1.006);
        let expected = r#"{
  "grasps": 2,
  "contacts": 2,
  "dimension": 2,
  "tracker": "bootstrap",
  "surface": {
    "model": "gp",
    "mirrors": 0,
    "hausdorff_mm": 1.414,
    "hausdorff_aligned_mm": 1.414,
    "mean_mm": 1.005,
    "rms_mm": 1.006
  },
  "pose": {
    "per_grasp": [
      {
        "grasp": 0,
        "translation_mm": 0.0,
        "rotation_deg": 0.0
      },
      {
        "grasp": 1,
        "translation_mm": 3.0,
        "rotation_deg": 2.0
      }
    ],
    "final_translation_mm": 3.0,
    "final_rotation_deg": 2.0,
    "rms_translation_mm": 2.121,
    "rms_rotation_deg": 1.414
  },
  "contact_rms_mm": 1.0,
  "unexplained": {
    "contacts": 1,
    "grasps": [
      1
    ],
    "wholly": []
  },
  "seconds": {
    "surface": 0.0,
    "track": 0.25
  },
  "lost": [
    1
  ],
  "ambiguous": [
    0
  ]
}
"#;
        assert_eq!(fixed.to_json().unwrap(), expected);
        let again: Report = serde_json::from_str(expected).unwrap();
        assert_eq!(again, fixed);
    }

    #[test]
    fn frames_agree_where_something_was_felt() {
        let mut grasps = grasps(planar(0.01, -0.02, 0.5));
        let felt = gauge(&grasps).unwrap();
        // A slip that nobody felt, before.
        let slipped = grasps[0].truth.map(|truth| truth * planar(0.03, 0.0, 0.4));
        let empty = JudgedGrasp { truth: slipped, contacts: vec![], ..grasps[0].clone() };
        grasps.insert(0, empty);
        assert_eq!(gauge(&grasps), Some(felt));
        let errors = pose_errors(&grasps, &felt, &Symmetry::none());
        assert!((errors[0].translation_mm - 30.0).abs() < 1e-6 && errors[1].translation_mm < 1e-6);
        // Where nothing was, somewhere.
        grasps.truncate(1);
        assert!(gauge(&grasps).is_some());
    }

    #[test]
    fn without_truth_errors_are_null() {
        let mut grasps = grasps(planar(0.0, 0.0, 0.0));
        grasps.iter_mut().for_each(|g| g.truth = None);
        let estimate = square(0.021);
        let mut run = Run {
            dimension: 2,
            tracker: "bootstrap",
            model: "gp",
            mirrors: 0,
            grasps: &grasps,
            estimate: Some(&estimate),
            truth: None,
            unexplained: &Unexplained::default(),
            seconds: &[],
        };
        let report = Report::new(&run);
        assert!(report.to_json().unwrap().contains("\"hausdorff_aligned_mm\": null"));
        assert!(report.pose.per_grasp.is_empty());
        assert_eq!(report.pose.rms_translation_mm, None);
        assert_eq!(report.contact_rms_mm, Some(1.0));

        let nothing = Geometry::Outline(Outline { loops: vec![] });
        run.estimate = Some(&nothing);
        let truth = square(0.02);
        run.truth = Some(&truth);
        let report = Report::new(&run);
        assert_eq!(report.surface.hausdorff_mm, None);
        assert_eq!(report.contact_rms_mm, None);
    }

    #[test]
    fn the_gauge_is_taken_where_truth_begins() {
        let mut grasps = grasps(planar(0.01, 0.0, 0.2));
        grasps[0].truth = None;
        let gauge = gauge(&grasps).unwrap();
        let errors = pose_errors(&grasps, &gauge, &Symmetry::none());
        assert_eq!(errors.len(), 1);
        assert_eq!(errors[0].grasp, 1);
        assert!(errors[0].translation_mm < 1e-9 && errors[0].rotation_deg < 1e-6);
    }

    #[test]
    fn a_turn_that_nobody_can_see_is_no_error() {
        let mut grasps = grasps(planar(0.01, -0.02, 0.5));
        // A quarter turn about the middle of a square that is not where the frame is.
        let beside = planar(0.005, 0.01, 0.0);
        let gauge = gauge(&grasps).unwrap();
        let turn = beside * planar(0.0, 0.0, std::f64::consts::FRAC_PI_2) * beside.inverse();
        grasps[1].estimate =
            grasps[1].truth.unwrap() * turn * planar(0.003, 0.0, 0.02) * gauge.inverse();
        let errors = |symmetry| pose_errors(&grasps, &gauge, &symmetry)[1];
        let seen = errors(Symmetry::of(&square(0.02).transformed(&beside)));
        // Turned by a quarter the middle is 3 mm to the other side.
        assert!((seen.rotation_deg - 0.02_f64.to_degrees()).abs() < 1e-9, "{seen:?}");
        assert!((seen.translation_mm - 3.0).abs() < 0.5, "{seen:?}");
        assert!(errors(Symmetry::none()).rotation_deg > 89.0);
    }

    #[test]
    fn the_table_names_every_figure_and_its_unit() {
        let report = Report::new(&Run {
            dimension: 2,
            tracker: "bootstrap",
            model: "gp",
            mirrors: 0,
            grasps: &grasps(planar(0.0, 0.0, 0.0)),
            estimate: None,
            truth: None,
            unexplained: &Unexplained::default(),
            seconds: &[("track", 1.5)],
        });
        let text = report.to_string();
        assert!(text.lines().all(|l| l == l.trim_end()), "{text}");
        assert!(text.starts_with("2 grasps, 2 contacts, 2D, tracker bootstrap, surface gp\n"));
        assert!(text.contains("3.00 mm") && text.contains("2.00 °") && text.contains("1.50 s"));
        assert!(
            text.contains("lost grasps") && text.contains("ambiguous grasps") && text.contains('–')
        );
    }

    #[test]
    fn a_report_that_cannot_be_written_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let report = Report::new(&Run {
            dimension: 2,
            tracker: "bootstrap",
            model: "gp",
            mirrors: 0,
            grasps: &[],
            estimate: None,
            truth: None,
            unexplained: &Unexplained::default(),
            seconds: &[],
        });
        assert!(report.write(&folder.path().join("absent").join("report.json")).is_err());
        report.write(&folder.path().join("report.json")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
