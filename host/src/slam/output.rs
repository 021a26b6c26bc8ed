//! What a run leaves behind: `report.json`, the shape, the trajectory, its pose graph and a picture.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::graph::pose::g2o::{self, Graph};
use crate::log::{GraspLog, TrueShape};
use crate::reference::Faces;
use crate::shape::files::{self, FileError, Plain};
use crate::shape::{Geometry, Outline, ShapeError, metrics};
use crate::slam::Progress;
use crate::slam::choose::Choice;
use crate::slam::odometry_graph::odometry_graph;
use crate::slam::reconstruct::{self, Reconstruction, reconstruct_known};
use crate::slam::replay;
use crate::slam::track::Step;
use crate::view::drawing::PictureError;
use crate::view::report::{JudgedGrasp, Report, Run, gauge, pose_errors};
use crate::view::summary::{self, Summary};
use crate::view::{html, mcap, scene, trajectory};

/// The file that says what came of a run.
const REPORT: &str = "report.json";

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
    /// The poses.
    pub steps: Vec<Step>,
    /// The poses and the motions between them.
    pub graph: Graph,
    /// Of an exploration: what it knew and chose among, for the replay; empty of anything else.
    pub choices: Vec<scene::Choice>,
    /// Everything the picture shows, in one frame.
    summary: Summary,
    /// Seconds of each grasp, or its number where the log has no times.
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
    let report = Report::new(&Run {
        dimension: log.dimension,
        tracker: provenance.tracker,
        model: reconstruction.model.name(),
        mirrors: reconstruction.mirrors.len(),
        grasps: &grasps,
        estimate: Some(&reconstruction.geometry),
        truth,
        seconds: &seconds,
    });
    let summary = summarise(provenance.title, &report, &grasps, &reconstruction, truth);
    let times = log.grasps.iter().map(|g| g.time.unwrap_or(g.index as f64)).collect();
    let graph = odometry_graph(log, &steps);
    Ok(Outcome { report, reconstruction, steps, graph, choices: Vec::new(), summary, times })
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
        pose_errors: gauge.map(|gauge| {
            let errors = pose_errors(grasps, &gauge);
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

/// Refuses a folder that [`Outcome::write`] could not fill, before anything long is begun.
///
/// # Errors
/// When a file is where the folder, one above it, or a folder where one of the results would be.
pub fn check_folder(folder: &Path) -> Result<(), WriteError> {
    let refuse = |path: &Path, problem| {
        Err(WriteError::at(path)(io::Error::new(io::ErrorKind::InvalidInput, problem)))
    };
    if let Some(above) = folder.ancestors().find(|p| p.exists())
        && !above.is_dir()
    {
        return refuse(above, "expected a folder for the results, found a file");
    }
    for name in [
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
    ] {
        let path = folder.join(name);
        if path.is_dir() {
            return refuse(&path, "expected a file or nothing, found a folder");
        }
    }
    Ok(())
}

/// Makes the folder, and takes out the report of the run before: it would stand beside files that
/// are not its own if this run were broken off.
fn begin(folder: &Path) -> Result<(), WriteError> {
    std::fs::create_dir_all(folder).map_err(WriteError::at(folder))?;
    let report = folder.join(REPORT);
    match std::fs::remove_file(&report) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(WriteError::at(&report)(e)),
        _ => Ok(()),
    }
}

impl Outcome {
    /// Whether no surface passes near any contact, so that the shape is empty.
    pub fn is_empty(&self) -> bool {
        metrics::is_empty(&self.reconstruction.geometry)
    }

    /// The headline.
    pub fn title(&self) -> &str {
        &self.summary.title
    }

    /// Key figures as name and value with unit.
    pub fn figures(&self) -> Vec<(String, String)> {
        self.summary.figures.clone()
    }

    /// Writes the mesh as `shape.stl` or `shape.obj` into `folder`, which is made if need be; an
    /// outline has none.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn write_plain(&self, folder: &Path, format: Plain) -> Result<(), WriteError> {
        let Geometry::Mesh(mesh) = &self.reconstruction.geometry else { return Ok(()) };
        begin(folder)?;
        let path = folder.join("shape").with_extension(format.ending());
        Ok(files::write_plain(&path, mesh, format)?)
    }

    /// Writes `report.json`, `contour.csv` or `shape.ply`, `trajectory.tum`, `graph.g2o`,
    /// `replay.mcap`, `replay.html`, `summary.png` and `summary.svg` into `folder`, which is made if need
    /// be. Everything is computed before the first file appears, and each file appears whole: a report that is
    /// there already goes first, the new one comes last. `log` and `truth` are those it was concluded from.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn write(
        &self,
        folder: &Path,
        log: &GraspLog,
        truth: Option<&Geometry>,
    ) -> Result<(), WriteError> {
        let unpaintable =
            |e| WriteError::at(&folder.join("summary.png"))(io::Error::other::<PictureError>(e));
        let picture = summary::render(&self.summary).map_err(unpaintable)?;
        let pixels = picture.png().map_err(unpaintable)?;
        let grown = replay::growth(log, self);
        let replay = replay::of_run(log, self, truth, &grown);
        begin(folder)?;

        let shape = folder.join(match self.reconstruction.geometry {
            Geometry::Outline(_) => "contour.csv",
            Geometry::Mesh(_) => "shape.ply",
        });
        match &self.reconstruction.geometry {
            Geometry::Outline(o) => {
                files::write_contour(&shape, o, Some(&self.reconstruction.deviations))
            }
            Geometry::Mesh(m) => {
                files::write_ply(&shape, m, None, Some(&self.reconstruction.deviations))
            }
        }?;

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
        // Last, so that a report means that everything is there.
        let path = folder.join(REPORT);
        self.report.write(&path).map_err(WriteError::at(&path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::track;

    #[test]
    fn no_report_stands_beside_the_files_of_a_run_that_was_broken_off() {
        // A square, touched once in the middle of each side.
        let text = r#"{"format":"tactile-grasp-log","version":1,"dimension":2}
            {"grasp":0,"contacts":[{"point":[0.05,0],"normal":[1,0]},{"point":[0,0.05],"normal":[0,1]},{"point":[-0.05,0],"normal":[-1,0]},{"point":[0,-0.05],"normal":[0,-1]}],"truth":{"pose":{"translation":[0,0],"rotation":0}}}"#;
        let log = GraspLog::parse(text.as_bytes(), Path::new("square")).unwrap();
        let provenance = Provenance {
            title: "a square",
            tracker: "truth",
            surface: Choice::Auto,
            tracking_seconds: 0.0,
            graph: None,
            progress: &|_, _| (),
        };
        let outcome = conclude(&log, None, track::truth(&log).unwrap(), provenance).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let report = folder.path().join("report.json");
        outcome.write(folder.path(), &log, None).unwrap();
        assert!(report.is_file());
        // The next one fails halfway.
        std::fs::remove_file(folder.path().join("trajectory.tum")).unwrap();
        std::fs::create_dir(folder.path().join("trajectory.tum")).unwrap();
        assert!(outcome.write(folder.path(), &log, None).is_err());
        assert!(!report.exists() && folder.path().join("contour.csv").is_file());
    }
}
