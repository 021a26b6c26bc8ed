//! From the file's poses to the best ones.

use std::time::Instant;

use super::OptimizeArgs;
use crate::cli::Error;
use crate::cli::terminal::Progress;
use crate::graph::pose::certificate::{Certificate, certify};
use crate::graph::pose::diagnosis::{Fit, Name};
use crate::graph::pose::global::optimize_globally;
use crate::graph::pose::gnc::{Gnc, gnc};
use crate::graph::pose::{self, Iteration, Method, Optimizer, Options, PoseGraph, Rigid, Start};

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
    /// Of certificates.
    pub certifying: f64,
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
    let options = Options {
        method: args.method.map_or(Method::GaussNewton, Method::from),
        kernel: args.robust.kernel(D),
        max_iterations: args.iterations.unwrap_or(100),
        ..Options::default()
    };
    let progress = Progress::new("descent", "steps");
    let mut watch = |step: &Iteration| {
        progress.reached(step.number + 1, format_args!("cost {:.6e}", step.cost));
    };
    let clock = Instant::now();
    let (start, summary, certificate, certifying) = match args.init {
        None => {
            let found = optimize_globally(graph, &options, &mut watch)?;
            (found.start, found.summary, found.certificate, found.certifying.as_secs_f64())
        }
        Some(start) => {
            start.place(graph)?;
            let mut optimizer = Optimizer::new(graph)?;
            let summary = optimizer.optimize_weighted(graph, None, &options, &mut watch)?;
            let clock = Instant::now();
            let certificate = args.robust.is_none().then(|| certify(graph)).transpose()?;
            (start, summary, certificate, clock.elapsed().as_secs_f64())
        }
    };
    let seconds = clock.elapsed().as_secs_f64() - certifying;
    drop(progress);
    Ok(Solved {
        initial_chi2,
        start: Some(if start == Start::File && !has_poses { Start::Odometry } else { start }),
        start_chi2: summary.initial_chi2,
        final_chi2: summary.final_chi2,
        final_cost: summary.final_cost,
        iterations: summary.iterations(),
        converged: summary.converged(),
        seconds,
        certifying,
        certificate,
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
    let clock = Instant::now();
    let certificate = certify(&kept)?;
    Ok(Solved {
        initial_chi2,
        start: None,
        start_chi2: initial_chi2,
        final_chi2: graph.chi2(),
        final_cost: fit.chi2,
        iterations: found.rounds,
        converged: true,
        seconds,
        certifying: clock.elapsed().as_secs_f64(),
        certificate: Some(certificate),
        outliers: Some(outliers),
        fit,
    })
}
