//! `tactile optimize`: a pose graph in, its best poses out.

mod robust;
mod solve;
mod told;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};

use self::robust::Robust;
use self::solve::solve;
use self::told::Told;
use crate::cli::Error;
use crate::cli::terminal::{say, tell, warn};
use crate::graph::pose::diagnosis::Diagnosis;
use crate::graph::pose::g2o::{self, G2o, Graph};
use crate::graph::pose::{Method, Start};

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
    /// deviations on [default of K: what 5 % of good edges exceed, for tukey 1.96 times that; for gnc
    /// what one in 10 000 exceeds]
    #[arg(long, value_name = "KIND[:K]", default_value = "none")]
    robust: Robust,
    /// Where to start, once [default: the file's poses if they fit their measurements already, else the
    /// cheaper of chordal and file; then the others unless that ends certified; the cheapest is kept]
    #[arg(long, value_enum)]
    init: Option<Start>,
    /// How to descend [default: gauss-newton]
    #[arg(long, value_enum)]
    method: Option<Descent>,
    /// Steps at most in each descent, of which one start may take several [default: 100]
    #[arg(long, value_name = "N")]
    iterations: Option<usize>,
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
        warn(format_args!("{name}: {remark}"));
    }
    if args.init == Some(Start::File) && !file.has_poses {
        return Err(Error::Input(format!("--init file: {name} has edges alone, no poses")));
    }
    for (option, is_given) in [
        ("--init", args.init.is_some()),
        ("--method", args.method.is_some()),
        ("--iterations", args.iterations.is_some()),
    ] {
        if is_given && args.robust.is_gnc() {
            let message = format!("{option}: --robust gnc chooses its starts and steps itself");
            return Err(Error::Input(message));
        }
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
        warn(format_args!("{name}: {remark}"));
    }
    let G2o { graph, has_poses, .. } = &mut file;
    let solved = match graph {
        Graph::Planar(graph) => solve(graph, *has_poses, args),
        Graph::Spatial(graph) => solve(graph, *has_poses, args),
    }?;
    for remark in solved.remarks() {
        warn(format_args!("{name}: {remark}"));
    }
    if let Some(out) = &args.out {
        g2o::write(out, &file.graph, &file.unknown).map_err(Error::input)?;
        if !file.unknown.is_empty() {
            let out = out.display();
            warn(format_args!("{out}: has the lines that are not understood as they were"));
        }
    }
    let told = Told { file: &file, diagnosis: &diagnosis, solved: &solved, reading };
    if args.json {
        say(serde_json::to_string_pretty(&told.json()).map_err(Error::failure)?)?;
    } else {
        tell(told.text())?;
        if let Some(out) = &args.out {
            tell(format!("graph with its new poses in {}", out.display()))?;
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
