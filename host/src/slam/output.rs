//! What a run leaves behind: `report.json`, the shape, the trajectory, its pose graph and a picture.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::graph::pose::g2o::{self, Graph};
use crate::log::{GraspLog, TrueShape};
use crate::model::Faces;
use crate::shape::files::{self, FileError, Plain};
use crate::shape::{Geometry, Outline, ShapeError, metrics};
use crate::slam::Progress;
use crate::slam::choose::Choice;
use crate::slam::misses::Misses;
use crate::slam::odometry_graph::odometry_graph;
use crate::slam::reconstruct::{self, Reconstruction, reconstruct_known};
use crate::slam::replay;
use crate::slam::track::Step;
use crate::view::drawing::PictureError;
use crate::view::report::{JudgedGrasp, Report, Run, gauge};
use crate::view::summary::{self, Summary};
use crate::view::{html, mcap, scene, trajectory};

/// The true shape of a log cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The mesh file.
    #[error("truth.shape.mesh: {0}")]
    Mesh(#[from] FileError),
    /// The polygon in the header.
    #[error("truth.shape.polygon: {0}")]
    Outline(#[from] ShapeError),
}

/// The log's true shape as geometry in the true object frame, `None` where it has none.
///
/// # Errors
/// When the mesh cannot be read or the polygon is not simple.
pub fn true_shape(log: &GraspLog) -> Result<Option<Geometry>, TruthError> {
    Ok(match &log.shape {
        None => None,
        Some(TrueShape::Polygon(vertices)) => {
            Some(Geometry::Outline(Outline::new(vec![vertices.clone()])?))
        }
        Some(TrueShape::Mesh { file, .. }) => Some(Geometry::Mesh(files::read_mesh(file)?)),
    })
}

/// A finished run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Figures.
    pub report: Report,
    /// The shape in the estimated object frame.
    pub reconstruction: Reconstruction,
    /// How far contacts lie from it.
    pub misses: Misses,
    /// The poses.
    pub steps: Vec<Step>,
    /// The poses and the motions between them.
    pub graph: Graph,
    /// Of an exploration: what it knew and chose among, for the replay; empty of anything else.
    pub choices: Vec<scene::Choice>,
    /// Everything the picture shows, in one frame.
    summary: Summary,
    /// Seconds of each grasp, or its number where the log does not have all times.
    times: Vec<f64>,
}

/// What the graph did between tracker and surface.
#[derive(Clone, Copy)]
pub struct Correction<'a> {
    /// How long it took, seconds.
    pub seconds: f64,
    /// The steps with the covariances that say how uncertain contacts are beside each other
    /// ([`crate::graph::Corrected`]); `None` where the graph left the tracker's.
    pub relative: Option<&'a [Step]>,
    /// The faces that it estimated, if any.
    pub faces: Option<&'a Faces>,
}

/// How a run came about, for its report.
#[derive(Clone, Copy)]
pub struct Provenance<'a> {
    /// Title of the picture.
    pub title: &'a str,
    /// Which tracker estimated the poses.
    pub tracker: &'a str,
    /// Which surface model is wanted.
    pub surface: Choice,
    /// How long the tracker took, seconds.
    pub tracking_seconds: f64,
    /// What was corrected after the tracker, if anything was.
    pub graph: Option<Correction<'a>>,
    /// Told how far the reconstruction is, where it takes long.
    pub progress: Progress<'a>,
}

/// Reconstructs the object from a log and the poses found for it, and judges both where the truth is
/// known.
///
/// # Errors
/// When there is nothing to reconstruct; see [`reconstruct_known`].
pub fn conclude(
    log: &GraspLog,
    truth: Option<&Geometry>,
    steps: Vec<Step>,
    provenance: Provenance<'_>,
) -> Result<Outcome, reconstruct::Error> {
    let start = Instant::now();
    let placing = provenance.graph.and_then(|g| g.relative).unwrap_or(&steps);
    let known = provenance.graph.and_then(|g| g.faces);
    let reconstruction =
        reconstruct_known(log, placing, known, provenance.surface, provenance.progress)?;
    let mut seconds =
        vec![("track", provenance.tracking_seconds), ("surface", start.elapsed().as_secs_f64())];
    seconds.extend(provenance.graph.map(|g| ("graph", g.seconds)));
    let grasps = judged(log, &steps);
    let misses = Misses::of(&reconstruction.contacts, &reconstruction.geometry);
    let report = Report::new(&Run {
        dimension: log.dimension,
        tracker: provenance.tracker,
        model: reconstruction.model.name(),
        mirrors: reconstruction.mirrors.len(),
        grasps: &grasps,
        estimate: Some(&reconstruction.geometry),
        truth,
        unexplained: &misses.unexplained(log),
        seconds: &seconds,
    });
    let summary = summarise(provenance.title, &report, &grasps, &reconstruction, truth);
    let times = times(log);
    let graph = odometry_graph(log, &steps);
    let choices = Vec::new();
    Ok(Outcome { report, reconstruction, misses, steps, graph, choices, summary, times })
}

/// Seconds of each grasp; the numbers of all where one has none, for both together would run backwards.
fn times(log: &GraspLog) -> Vec<f64> {
    let times: Option<Vec<f64>> = log.grasps.iter().map(|g| g.time).collect();
    times.unwrap_or_else(|| log.grasps.iter().map(|g| g.index as f64).collect())
}

/// Log and poses side by side.
fn judged(log: &GraspLog, steps: &[Step]) -> Vec<JudgedGrasp> {
    log.grasps
        .iter()
        .zip(steps)
        .map(|(grasp, step)| JudgedGrasp {
            index: grasp.index,
            estimate: step.pose,
            truth: grasp.truth,
            contacts: grasp.contacts.iter().map(|c| c.point).collect(),
            status: step.status,
        })
        .collect()
}

/// The picture's content: in the true object frame where that is known, else in the estimated one.
fn summarise(
    title: &str,
    report: &Report,
    grasps: &[JudgedGrasp],
    reconstruction: &Reconstruction,
    truth: Option<&Geometry>,
) -> Summary {
    let gauge = gauge(grasps);
    let shown = match gauge {
        Some(gauge) => reconstruction.transformed(&gauge.inverse()),
        None => reconstruction.clone(),
    };
    let figure = |name: &str, value: Option<f64>, unit: &str| {
        value.map(|v| (name.to_owned(), format!("{v:.2} {unit}")))
    };
    let figures = [
        Some(("grasps".to_owned(), report.grasps.to_string())),
        Some(("contacts".to_owned(), report.contacts.to_string())),
        figure("Hausdorff (aligned)", report.surface.hausdorff_aligned_mm, "mm"),
        figure("mean distance", report.surface.mean_mm, "mm"),
        figure("pose rms", report.pose.rms_translation_mm, "mm"),
        figure("rotation rms", report.pose.rms_rotation_deg, "°"),
        figure("contacts to surface", report.contact_rms_mm, "mm"),
    ];
    Summary {
        title: title.to_owned(),
        figures: figures.into_iter().flatten().collect(),
        truth: gauge.and(truth.cloned()),
        estimate: shown.geometry,
        deviations: shown.deviations,
        contacts: shown
            .contacts
            .iter()
            .map(|p| (p.contact.point, p.contact.normal, p.grasp))
            .collect(),
        pose_errors: gauge.map(|_| {
            let errors = &report.pose.per_grasp;
            errors.iter().map(|e| (e.translation_mm, e.rotation_deg)).collect()
        }),
    }
}

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Report, trajectory, picture or folder.
    #[error("{}: cannot write: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The shape.
    #[error(transparent)]
    Shape(#[from] FileError),
}

impl WriteError {
    fn at(path: &Path) -> impl FnOnce(io::Error) -> WriteError + use<> {
        let path = path.to_owned();
        move |source| WriteError::Io { path, source }
    }
}

/// The names of everything that [`Outcome::write`] may leave.
pub const RESULTS: [&str; 11] = [
    "contour.csv",
    "shape.ply",
    "shape.stl",
    "shape.obj",
    "trajectory.tum",
    "graph.g2o",
    "replay.mcap",
    "replay.html",
    "summary.png",
    "summary.svg",
    REPORT,
];

/// Those of them that hold the shape.
const SHAPES: [&str; 4] = ["contour.csv", "shape.ply", "shape.stl", "shape.obj"];

/// Written last and removed first, so that a report means that everything is there.
const REPORT: &str = "report.json";

/// Refuses a folder that [`Outcome::write`] could not fill, before anything long is begun, and leaves it
/// as it is.
///
/// # Errors
/// When a file is where the folder, one above it, or a folder where one of the results would be; when
/// nothing can be written there.
pub fn check_folder(folder: &Path) -> Result<(), WriteError> {
    check_folder_for(folder, &RESULTS)
}

/// As [`check_folder`], for files of these names.
///
/// # Errors
/// As [`check_folder`].
pub fn check_folder_for(folder: &Path, names: &[impl AsRef<str>]) -> Result<(), WriteError> {
    let refuse = |path: &Path, problem| {
        Err(WriteError::at(path)(io::Error::new(io::ErrorKind::InvalidInput, problem)))
    };
    // Of a path such as `out` the last ancestor has no name: it is the current folder.
    let named = |path: &Path| if path == Path::new("") { PathBuf::from(".") } else { path.into() };
    if let Some(above) = folder.ancestors().map(named).find(|p| p.exists()) {
        if !above.is_dir() {
            return refuse(&above, "expected a folder for the results, found a file");
        }
        // What can be made there can be made in a folder that is still to be made.
        tempfile::Builder::new()
            .prefix(".tactile-")
            .tempfile_in(&above)
            .map_err(WriteError::at(&above))?;
    }
    for name in names {
        let path = folder.join(name.as_ref());
        if path.is_dir() {
            return refuse(&path, "expected a file or nothing, found a folder");
        }
    }
    Ok(())
}

/// Makes the folder and removes the report and the shape of an earlier run from it, before anything else is written
/// there; whether there was one. Files of such names that no report is beside are somebody else's.
///
/// # Errors
/// Names what could not be made or removed.
pub fn begin(folder: &Path) -> Result<bool, WriteError> {
    std::fs::create_dir_all(folder).map_err(WriteError::at(folder))?;
    let report = folder.join(REPORT);
    let is_again = report.is_file();
    remove(&report)?;
    if is_again {
        SHAPES.iter().try_for_each(|name| remove(&folder.join(name)))?;
    }
    Ok(is_again)
}

/// Removes a file, if it is there.
pub(crate) fn remove(path: &Path) -> Result<(), WriteError> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(WriteError::at(path)(e)),
        _ => Ok(()),
    }
}

impl Outcome {
    /// Whether no surface passes near any contact, so that the shape is empty.
    pub fn is_empty(&self) -> bool {
        metrics::is_empty(&self.reconstruction.geometry)
    }

    /// The diagonal of the box around all contacts, object frame, metres.
    pub fn extent(&self) -> f64 {
        let points = || self.reconstruction.contacts.iter().map(|p| p.contact.point);
        let low = points().reduce(|a, b| a.inf(&b));
        let high = points().reduce(|a, b| a.sup(&b));
        low.zip(high).map_or(0.0, |(low, high)| (high - low).norm())
    }

    /// The headline.
    pub fn title(&self) -> &str {
        &self.summary.title
    }

    /// Key figures as name and value with unit.
    pub fn figures(&self) -> Vec<(String, String)> {
        self.summary.figures.clone()
    }

    /// Writes `report.json`, `contour.csv` or `shape.ply`, `trajectory.tum`, `graph.g2o`,
    /// `replay.mcap`, `replay.html`, `summary.png` and `summary.svg` into `folder`, which is made if need
    /// be, and a mesh in the `plain` formats too, as `shape.stl` or `shape.obj`. Everything is computed
    /// before the first file appears, and each file appears whole. Shapes that an earlier run left under
    /// other of these names are removed. `log` and `truth` are those it was concluded from.
    ///
    /// # Errors
    /// Names the file that could not be written; there is no report then.
    pub fn write(
        &self,
        folder: &Path,
        log: &GraspLog,
        truth: Option<&Geometry>,
        plain: &[Plain],
    ) -> Result<(), WriteError> {
        let unpaintable =
            |e| WriteError::at(&folder.join("summary.png"))(io::Error::other::<PictureError>(e));
        let picture = summary::render(&self.summary).map_err(unpaintable)?;
        let pixels = picture.png().map_err(unpaintable)?;
        let grown = replay::growth(log, self);
        let replay = replay::of_run(log, self, truth, &grown);
        begin(folder)?;
        self.write_shape(folder, plain)?;

        let path = folder.join("trajectory.tum");
        let poses: Vec<_> = self.steps.iter().map(|s| s.pose).collect();
        trajectory::write_tum(&path, &self.times, &poses).map_err(WriteError::at(&path))?;
        let path = folder.join("graph.g2o");
        crate::log::write::write_atomically(&path, |out| g2o::write_to(out, &self.graph))
            .map_err(WriteError::at(&path))?;
        let path = folder.join("replay.mcap");
        let steps: Vec<_> = self.steps.iter().cloned().map(Some).collect();
        let contents = mcap::Contents {
            title: &self.summary.title,
            log,
            steps: &steps,
            surfaces: &grown,
            truth,
            report: Some(&self.report),
        };
        mcap::write(&path, &contents).map_err(WriteError::at(&path))?;
        let path = folder.join("replay.html");
        crate::log::write::write_atomically(&path, |out| html::write(&replay, out))
            .map_err(WriteError::at(&path))?;
        for (name, content) in
            [("summary.png", pixels.as_slice()), ("summary.svg", picture.svg().as_bytes())]
        {
            let path = folder.join(name);
            crate::log::write::write_atomically(&path, |out| out.write_all(content))
                .map_err(WriteError::at(&path))?;
        }
        let path = folder.join(REPORT);
        self.report.write(&path).map_err(WriteError::at(&path))
    }

    fn write_shape(&self, folder: &Path, plain: &[Plain]) -> Result<(), WriteError> {
        let deviations = Some(&self.reconstruction.deviations[..]);
        match &self.reconstruction.geometry {
            Geometry::Outline(outline) => {
                files::write_contour(&folder.join("contour.csv"), outline, deviations)?;
            }
            Geometry::Mesh(mesh) => {
                files::write_ply(&folder.join("shape.ply"), mesh, None, deviations)?;
                for format in plain {
                    let name = format!("shape.{}", format.ending());
                    files::write_plain(&folder.join(name), mesh, *format)?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_one_time_is_missing_the_trajectory_does_not_run_backwards() {
        let text = include_str!("../../assets/bundled.jsonl");
        let mut log = GraspLog::parse(text.as_bytes(), "bundled".as_ref()).unwrap();
        for (k, grasp) in log.grasps.iter_mut().enumerate() {
            grasp.time = Some(1e3 + 0.25 * k as f64);
        }
        assert_eq!(times(&log)[1], 1000.25);
        log.grasps[4].time = None;
        assert_eq!(times(&log), (0..10).map(f64::from).collect::<Vec<_>>());
    }
}
