//! `tactile slam`: a grasp log in, shape and poses out.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};

use crate::cli::bundled::Bundled;
use crate::cli::terminal::{Progress, say, tell, tell_report, warn};
use crate::cli::{Error, browser, closed, files, level, normals, units};
use crate::graph;
use crate::log::{GraspLog, TrueShape};
use crate::shape::Geometry;
use crate::shape::files::Plain;
use crate::slam::choose::Choice;
use crate::slam::output::{Correction, Outcome, Provenance, check_folder, conclude, true_shape};
use crate::slam::trackers::Kind;
use crate::slam::{reconstruct, track, usual_deviations};

/// Reconstruct an object and its poses from a grasp log.
///
/// Writes report.json, contour.csv (2D) or shape.ply (3D), trajectory.tum, graph.g2o, summary.png and .svg,
/// replay.html (a moving scene for any browser) and replay.mcap (for Foxglove, Rerun and RViz).
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile slam --bundled prism --open\n  tactile simulate --object ellipse:0.12x0.06 --seed 3 -o ellipse.jsonl\n  tactile slam ellipse.jsonl --out ellipse"
)]
pub struct SlamArgs {
    /// Grasp log; without one, a bundled recording
    log: Option<PathBuf>,
    /// Which of the bundled recordings
    #[arg(long, value_enum, value_name = "NAME", default_value_t, conflicts_with = "log")]
    bundled: Bundled,
    /// How poses are estimated [default: auto]
    #[arg(long, value_enum)]
    tracker: Option<Kind>,
    /// Correction of all poses together, after the tracker [default: planes, for --poses truth none]
    #[arg(long, value_enum)]
    graph: Option<graph::Kind>,
    /// Surface model
    #[arg(long, value_enum, default_value_t = SurfaceKind::Auto)]
    surface: SurfaceKind,
    /// Where poses come from: the tracker, or the log's truth (an experiment)
    #[arg(long, value_enum, default_value_t = Poses::Estimated)]
    poses: Poses,
    /// Seed of the tracker's random numbers [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// Folder for the results
    #[arg(long, default_value = "out")]
    out: PathBuf,
    /// Write the mesh in these formats too, beside shape.ply, which alone holds its uncertainty
    #[arg(long, value_enum, value_name = "FORMAT", value_delimiter = ',')]
    mesh: Vec<Plain>,
    /// Show replay.html in the browser (that `BROWSER` names, else the system's) when it is done
    #[arg(long)]
    open: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Surface models on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SurfaceKind {
    /// Fitted faces where the contacts show flat ones that close, else the Gaussian process
    Auto,
    /// Fitted faces: planes that meet in sharp edges; refused where they leave the object open
    Faces,
    /// Gaussian process implicit surface
    Gp,
}

/// Where poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Poses {
    /// The tracker
    Estimated,
    /// The log's true poses
    Truth,
}

/// What a run starts from.
pub(super) struct Input {
    pub log: GraspLog,
    /// What to call the log in messages.
    pub name: String,
    pub truth: Option<Geometry>,
}

impl Input {
    /// Reads the log (without a path a bundled one) and its true shape, and refuses what could not be
    /// finished before anything long is begun.
    pub fn open(path: Option<&Path>, bundled: Bundled, out: &Path) -> Result<Input, Error> {
        let (log, name, truth) = match path {
            None => {
                let (log, truth) = bundled.read()?;
                (log, bundled.name().to_owned(), truth)
            }
            Some(path) => {
                let log = GraspLog::read(path).map_err(Error::input)?;
                files::spare(path, out)?;
                if let Some(TrueShape::Mesh { file, .. }) = &log.shape {
                    files::spare(file, out)?;
                }
                let name = path.display().to_string();
                let truth = true_shape(&log).unwrap_or_else(|error| {
                    warn(format_args!("{name}: {error}; errors against the truth are left out"));
                    None
                });
                (log, name, truth)
            }
        };
        reconstruct::check(&log).map_err(|e| Error::Input(format!("{name}: {e}")))?;
        check_folder(out).map_err(Error::input)?;
        let of_truth = truth.as_ref().and_then(|shape| units::truth(&log, shape));
        let open =
            truth.as_ref().and_then(closed::of).map(|doubt| format!("the true shape: {doubt}"));
        for doubt in
            [normals::doubt(&log), units::noise(&log), of_truth, open].into_iter().flatten()
        {
            warn(format_args!("{name}: {doubt}"));
        }
        Ok(Input { log, name, truth })
    }

    /// Writes the results, with the mesh in these formats too, and says where a shape is missing.
    pub fn write(&self, outcome: &Outcome, out: &Path, meshes: &[Plain]) -> Result<(), Error> {
        let truth = self.truth.as_ref();
        outcome.write(out, &self.log, truth, meshes).map_err(Error::failure)?;
        if outcome.is_empty() {
            warn(format_args!(
                "{}: no surface passes near a contact: the shape is empty",
                self.name
            ));
        }
        let (deviation, _) = usual_deviations(&self.log.noise);
        let contacts = &outcome.reconstruction.contacts;
        let doubts = [
            units::doubt(outcome.extent(), outcome.misses.usual(), deviation),
            level::doubt(self.log.dimension, contacts),
            strangers(&outcome.report.unexplained.wholly),
        ];
        for doubt in doubts.into_iter().flatten() {
            warn(format_args!("{}: {doubt}", self.name));
        }
        Ok(())
    }

    /// Title of the picture.
    pub fn title(&self) -> &str {
        if self.log.description.is_empty() { &self.name } else { &self.log.description }
    }
}

/// What is to be said of grasps none of whose contacts the shape explains.
fn strangers(grasps: &[u64]) -> Option<String> {
    let numbers: Vec<String> = grasps.iter().map(u64::to_string).collect();
    (!grasps.is_empty()).then(|| {
        format!(
            "no contact of grasp {} is near the shape: they are of another object, or a motion is wrong",
            numbers.join(", ")
        )
    })
}

/// Why a graph that was asked for corrected nothing.
fn idle(kind: graph::Kind, log: &GraspLog) -> Option<String> {
    const LEAST: usize = graph::joint::LEAST_GRASPS;
    let (why, option) = match kind {
        graph::Kind::None => return None,
        graph::Kind::Pairwise => {
            ("no two grasps felt faces that tell their relative pose".into(), "pairwise")
        }
        graph::Kind::Planes if log.grasps.len() < LEAST => {
            (format!("{} grasps, expected {LEAST} at least", log.grasps.len()), "planes")
        }
        graph::Kind::Planes => (
            "no shape explains all grasps, or their contacts are too many for a smooth one".into(),
            "planes",
        ),
    };
    Some(format!("{why}: --graph {option} corrects nothing"))
}

/// Runs the subcommand.
///
/// # Errors
/// Bad input before anything is written; unwritable results.
pub fn run(args: &SlamArgs) -> Result<(), Error> {
    for (is_given, option) in
        [(args.tracker.is_some(), "--tracker"), (args.seed.is_some(), "--seed")]
    {
        if is_given && args.poses == Poses::Truth {
            return Err(Error::Input(format!(
                "{option} has a meaning only with --poses estimated"
            )));
        }
    }
    let input = Input::open(args.log.as_deref(), args.bundled, &args.out)?;
    let Input { log, name, truth } = &input;
    if log.dimension == 2 && !args.mesh.is_empty() {
        let message = "--mesh: a planar log has an outline, contour.csv, and no mesh";
        return Err(Error::Input(format!("{name}: {message}")));
    }
    let start = Instant::now();
    let (steps, tracker) = match args.poses {
        Poses::Truth => {
            let steps = track::truth(log).map_err(|e| Error::Input(format!("{name}: {e}")))?;
            (steps, "truth")
        }
        Poses::Estimated => {
            let progress = Progress::new("poses", "grasps");
            let told = |done, all| progress.at(done, all);
            let tracker = args.tracker.unwrap_or(Kind::Automatic);
            (tracker.follow_told(log, args.seed.unwrap_or(0), &told), tracker.name())
        }
    };
    let tracking_seconds = start.elapsed().as_secs_f64();
    let kind = args.graph.unwrap_or(match args.poses {
        Poses::Truth => graph::Kind::None,
        Poses::Estimated => graph::Kind::Planes,
    });
    let start = Instant::now();
    let corrected = kind.correct(log, &steps);
    let graph_seconds = start.elapsed().as_secs_f64();
    if let Some(why) = args.graph.filter(|_| corrected.is_none()).and_then(|kind| idle(kind, log)) {
        warn(format_args!("{name}: {why}"));
    }
    let (steps, relative, faces) = match corrected {
        Some(graph::Corrected { steps, relative, faces }) => (steps, Some(relative), faces),
        None => (steps, None, None),
    };
    let surface = match args.surface {
        SurfaceKind::Auto => Choice::Auto,
        SurfaceKind::Faces => Choice::Faces,
        SurfaceKind::Gp => Choice::Gp,
    };
    let progress = Progress::new("surface", "local experts");
    let provenance = Provenance {
        title: input.title(),
        tracker,
        surface,
        tracking_seconds,
        graph: (kind != graph::Kind::None).then_some(Correction {
            seconds: graph_seconds,
            relative: relative.as_deref(),
            faces: faces.as_ref(),
        }),
        progress: &|done, all| progress.at(done, all),
    };
    let outcome = conclude(log, truth.as_ref(), steps, provenance)
        .map_err(|e| Error::Input(format!("{name}: {e}")))?;
    drop(progress);
    input.write(&outcome, &args.out, &args.mesh)?;
    if args.json {
        say(outcome.report.to_json().map_err(Error::failure)?.trim_end())?;
    } else {
        tell_report(&outcome.report)?;
        tell(format_args!("results in {}", args.out.display()))?;
    }
    if args.open {
        browser::show(&args.out.join("replay.html"));
    }
    Ok(())
}
