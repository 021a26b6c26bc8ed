//! From the file's poses to the best ones.

use std::io::{IsTerminal, Write};
use std::time::Instant;

use super::OptimizeArgs;
use crate::cli::Error;
use crate::graph::pose::certificate::{Certificate, certify};
use crate::graph::pose::diagnosis::{Fit, Name};
use crate::graph::pose::gnc::{Gnc, gnc};
use crate::graph::pose::{self, Iteration, Optimizer, Options, PoseGraph, Rigid, Start};

/// What was found for a graph.
pub(super) struct Solved {
    /// χ² at the file's poses, of edges alone at the odometry's.
    pub initial_chi2: f64,
    /// `None` where there was none to choose.
    pub start: Option<Start>,
    pub start_chi2: f64,
    /// Σ eᵀ Ω e of all edges.
    pub final_chi2: f64,
    /// What was minimised: the sum of what edges may cost, of those that are not left out.
    pub final_cost: f64,
    pub iterations: usize,
    pub converged: bool,
    /// Of initial values and descent.
    pub seconds: f64,
    /// Of the edges that are not left out; `None` where kernels weigh them, so that χ² is not what was
    /// minimised.
    pub certificate: Option<Certificate>,
    /// Edges that are left out; `None` where none were looked for.
    pub outliers: Option<Vec<Name>>,
    /// How the edges that are not left out agree.
    pub fit: Fit,
}

impl Solved {
    /// What the graph's owner should know, a sentence each.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.fit.remarks();
        if !self.converged {
            remarks.push(format!("not converged after {} iterations", self.iterations));
        }
        remarks
    }
}

/// How many of the edges that disagree most are shown.
const WORST: usize = 5;

/// Moves the poses of `graph` to the best ones.
pub(super) fn solve<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    has_poses: bool,
    args: &OptimizeArgs,
) -> Result<Solved, Error> {
    let found = if args.robust.is_gnc() {
        without_outliers(graph, has_poses, args)
    } else {
        with_all(graph, has_poses, args)
    };
    found.map_err(|error| Error::Input(format!("{}: {error}", args.graph.display())))
}

/// The best poses for all edges, each at what it may cost.
fn with_all<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    has_poses: bool,
    args: &OptimizeArgs,
) -> Result<Solved, pose::Error> {
    if !has_poses {
        Start::Odometry.place(graph)?;
    }
    let initial_chi2 = graph.chi2();
    let clock = Instant::now();
    let start = match args.init {
        Some(start) => {
            start.place(graph)?;
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
    let mut optimizer = Optimizer::new(graph)?;
    let summary =
        optimizer.optimize_weighted(graph, None, &options, &mut |step| progress.show(step));
    let seconds = clock.elapsed().as_secs_f64();
    progress.wipe();
    let summary = summary?;
    Ok(Solved {
        initial_chi2,
        start: Some(start),
        start_chi2,
        final_chi2: summary.final_chi2,
        final_cost: summary.final_cost,
        iterations: summary.iterations(),
        converged: summary.converged(),
        seconds,
        certificate: args.robust.is_none().then(|| certify(graph)).transpose()?,
        outliers: None,
        fit: Fit::of(graph, WORST),
    })
}

/// The best poses for the edges that agree with each other.
fn without_outliers<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    has_poses: bool,
    args: &OptimizeArgs,
) -> Result<Solved, pose::Error> {
    if !has_poses {
        Start::Odometry.place(graph)?;
    }
    let initial_chi2 = graph.chi2();
    let clock = Instant::now();
    let barrier = args.robust.width().map(|width| width * width);
    let found = gnc(graph, &Gnc { barrier, ..Gnc::default() })?;
    let seconds = clock.elapsed().as_secs_f64();
    let left_out = (0..graph.edges.len()).filter(|&edge| !found.is_inlier(edge));
    let outliers = left_out.map(|edge| graph.name(edge)).collect();
    let mut index = 0..;
    let mut kept = graph.clone();
    kept.edges.retain(|_| index.next().is_some_and(|edge| found.is_inlier(edge)));
    let fit = Fit::of(&kept, WORST);
    Ok(Solved {
        initial_chi2,
        start: None,
        start_chi2: initial_chi2,
        final_chi2: graph.chi2(),
        final_cost: fit.chi2,
        iterations: found.rounds,
        converged: true,
        seconds,
        certificate: Some(certify(&kept)?),
        outliers: Some(outliers),
        fit,
    })
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
