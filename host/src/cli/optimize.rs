//! `tactile optimize`: a pose graph in, its best poses out.

mod robust;
mod told;

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};

use self::robust::Robust;
use self::told::Told;
use crate::cli::Error;
use crate::cli::terminal::{say, tell};
use crate::graph::pose::certificate::{Certificate, certify};
use crate::graph::pose::diagnosis::{Diagnosis, Fit};
use crate::graph::pose::g2o::{self, G2o, Graph};
use crate::graph::pose::{Iteration, Method, Optimizer, Options, PoseGraph, Rigid, Start, Summary};

/// Find the best poses of a pose graph (.g2o, 2D or 3D).
///
/// Minimises χ² = Σ eᵀ Ω e (without ½) over all poses; those that FIX names stay, else the first one.
/// Says what is wrong with the graph: parts that nothing connects, poses that nothing holds,
/// information that makes no sense, edges that disagree.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  tactile optimize sphere2500.g2o -o optimized.g2o\n  tactile optimize outliers.g2o --robust gnc --json"
)]
pub struct OptimizeArgs {
    /// The graph: VERTEX_SE2 and EDGE_SE2 or VERTEX_SE3:QUAT and EDGE_SE3:QUAT, and FIX; edges alone will
    /// do
    #[arg(value_name = "GRAPH.g2o")]
    graph: PathBuf,
    /// Where to write the graph with its new poses
    #[arg(short, long, value_name = "OUT.g2o")]
    out: Option<PathBuf>,
    /// What wrong edges may cost: none (no edge is wrong), huber, cauchy, geman-mcclure, tukey, dcs, or
    /// gnc (wrong edges are found and left out); with :K, an edge counts less from an error of K standard
    /// deviations on [default of K: what 5 % of good edges exceed]
    #[arg(long, value_name = "KIND[:K]", default_value = "none")]
    robust: Robust,
    /// Where to start [default: the file's poses if they fit their measurements already, else the
    /// cheaper of chordal and file]
    #[arg(long, value_enum)]
    init: Option<Start>,
    /// How to descend
    #[arg(long, value_enum, default_value_t = Descent::GaussNewton)]
    method: Descent,
    /// Steps at most
    #[arg(long, value_name = "N", default_value_t = 100)]
    iterations: usize,
    /// Print the result as JSON; initial_chi2 is at the file's poses
    #[arg(long)]
    json: bool,
}

/// The methods on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Descent {
    /// Whole steps to the minimum of the linearised cost, shorter ones where that fails
    GaussNewton,
    /// Steps that are damped as long as they disappoint
    LevenbergMarquardt,
    /// Between steepest descent and Gauss-Newton, within a radius of trust
    Dogleg,
}

impl From<Descent> for Method {
    fn from(descent: Descent) -> Method {
        match descent {
            Descent::GaussNewton => Method::GaussNewton,
            Descent::LevenbergMarquardt => Method::LevenbergMarquardt,
            Descent::Dogleg => Method::Dogleg,
        }
    }
}

/// What was found for a graph.
struct Solved {
    /// χ² at the file's poses, of edges alone at the odometry's.
    initial_chi2: f64,
    start: Start,
    start_chi2: f64,
    summary: Summary,
    /// Initial values and descent.
    seconds: f64,
    /// `None` where edges were weighed: then χ² is not what was minimised.
    certificate: Option<Certificate>,
    fit: Fit,
}

/// How many of the edges that disagree most are shown.
const WORST: usize = 5;

/// Runs the subcommand.
///
/// # Errors
/// A file that is no pose graph, a graph that has no best poses, a place that cannot be written to.
pub fn run(args: &OptimizeArgs) -> Result<(), Error> {
    let name = args.graph.display();
    if let Some(out) = &args.out {
        writable(out)?;
    }
    let start = Instant::now();
    let mut file = g2o::read(&args.graph).map_err(Error::input)?;
    let reading = start.elapsed().as_secs_f64();
    for remark in told::remarks(&file) {
        eprintln!("warning: {name}: {remark}");
    }
    if args.init == Some(Start::File) && !file.has_poses {
        return Err(Error::Input(format!("--init file: {name} has edges alone, no poses")));
    }
    let diagnosis = match &file.graph {
        Graph::Planar(graph) => Diagnosis::of(graph),
        Graph::Spatial(graph) => Diagnosis::of(graph),
    };
    if let Some(first) = diagnosis.indefinite.first() {
        let line = file.edge_lines.get(first.name.edge).copied().unwrap_or_default();
        return Err(Error::Input(format!(
            "{name}, line {line}, information: {}",
            diagnosis.remarks().swap_remove(0)
        )));
    }
    for remark in diagnosis.remarks() {
        eprintln!("warning: {name}: {remark}");
    }
    let G2o { graph, has_poses, .. } = &mut file;
    let solved = match graph {
        Graph::Planar(graph) => solve(graph, *has_poses, args),
        Graph::Spatial(graph) => solve(graph, *has_poses, args),
    }?;
    for remark in solved.fit.remarks() {
        eprintln!("warning: {name}: {remark}");
    }
    if let Some(out) = &args.out {
        g2o::write(out, &file.graph).map_err(Error::input)?;
    }
    let told = Told { file: &file, diagnosis: &diagnosis, solved: &solved, reading };
    if args.json {
        say(serde_json::to_string_pretty(&told.json()).map_err(Error::failure)?);
    } else {
        tell(told.text());
        if let Some(out) = &args.out {
            tell(format!("graph with its new poses in {}", out.display()));
        }
    }
    Ok(())
}

/// Refuses, before anything long is begun, a file that could not be written.
fn writable(out: &Path) -> Result<(), Error> {
    let folder = out.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."));
    let problem = match () {
        () if out.is_dir() => "it is a folder".into(),
        () if !folder.is_dir() => format!("the folder {} does not exist", folder.display()),
        () => return Ok(()),
    };
    Err(Error::Input(format!("{}: cannot write: {problem}", out.display())))
}

fn solve<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    has_poses: bool,
    args: &OptimizeArgs,
) -> Result<Solved, Error> {
    let input =
        |error: &dyn std::fmt::Display| Error::Input(format!("{}: {error}", args.graph.display()));
    if !has_poses {
        Start::Odometry.place(graph).map_err(|e| input(&e))?;
    }
    let initial_chi2 = graph.chi2();
    let clock = Instant::now();
    let start = match args.init {
        Some(start) => {
            start.place(graph).map_err(|e| input(&e))?;
            start
        }
        None => match Start::best(graph) {
            Start::File if !has_poses => Start::Odometry,
            start => start,
        },
    };
    let start_chi2 = graph.chi2();
    let options = Options {
        method: args.method.into(),
        kernel: args.robust.kernel(D),
        max_iterations: args.iterations,
        ..Options::default()
    };
    let mut progress = Progress::default();
    let summary = Optimizer::new(graph)
        .and_then(|mut optimizer| {
            optimizer.optimize_weighted(graph, None, &options, &mut |step| progress.show(step))
        })
        .map_err(|e| input(&e))?;
    let seconds = clock.elapsed().as_secs_f64();
    progress.wipe();
    let plain = args.robust.is_none();
    let certificate = plain.then(|| certify(graph)).transpose().map_err(|e| input(&e))?;
    let fit = Fit::of(graph, WORST);
    Ok(Solved { initial_chi2, start, start_chi2, summary, seconds, certificate, fit })
}

/// One line on standard error that says how far the descent is, if somebody is looking.
#[derive(Default)]
struct Progress {
    width: usize,
}

impl Progress {
    fn show(&mut self, step: &Iteration) {
        if std::io::stderr().is_terminal() {
            let line = format!("iteration {}: cost {:.6e}", step.number + 1, step.cost);
            let _ = write!(std::io::stderr(), "\r{line:<width$}", width = self.width);
            self.width = line.len();
        }
    }

    fn wipe(&mut self) {
        if self.width > 0 {
            let _ = write!(std::io::stderr(), "\r{:width$}\r", "", width = self.width);
            self.width = 0;
        }
    }
}
