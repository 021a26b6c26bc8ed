//! The global optimum: from the best of several starts, with a certificate.

use super::certificate::{Certificate, certify};
use super::chordal::chordal_in;
use super::odometry::odometry;
use super::optimizer::{Method, Optimizer, Options, Summary};
use super::rigid::Rigid;
use super::{Error, PoseGraph};

/// Where a descent starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// At the graph's poses.
    Given,
    /// At the optimum of the chordal relaxation.
    Chordal,
    /// At composed odometry.
    Odometry,
}

/// What [`optimize_globally`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimum {
    /// The start that led there.
    pub start: Start,
    /// The descent from it.
    pub summary: Summary,
    /// Whether it is the global optimum.
    pub certificate: Certificate,
}

/// Moves the poses of `graph` to the best minimum of χ² that it finds: from the chordal relaxation and,
/// only where that is not certified to be the global one, from the poses as given and from odometry.
///
/// Kernels have no say in where it starts and in the certificate, which is of Σ eᵀ Ω e: use
/// [`gnc`](super::gnc::gnc) where there are outliers, and leave them out here.
///
/// ```
/// use tactile_host::graph::pose::global::optimize_globally;
/// use tactile_host::graph::pose::{Edge, Options, PoseGraph2, Se2};
///
/// // A ring of eight poses, given so badly that descent alone ends in a ring that winds twice.
/// let step = |angle: f64| Se2::new(1.0, 0.0, angle);
/// let edges = (0..8).map(|k| Edge {
///     from: k,
///     to: (k + 1) % 8,
///     measured: step(std::f64::consts::FRAC_PI_4),
///     information: nalgebra::Matrix3::identity(),
/// });
/// let mut poses = vec![Se2::new(0.0, 0.0, 0.0)];
/// for k in 0..7 {
///     poses.push(poses[k].compose(&step(std::f64::consts::FRAC_PI_2)));
/// }
/// # use tactile_host::graph::pose::Group;
/// let mut ring = PoseGraph2 { ids: (0..8).collect(), poses, edges: edges.collect(), fixed: vec![] };
/// let optimum = optimize_globally(&mut ring, &Options::default())?;
/// assert!(optimum.certificate.is_certified() && ring.chi2() < 1e-12);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range, or measurements that leave a pose undetermined.
pub fn optimize_globally<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    options: &Options,
) -> Result<Optimum, Error> {
    graph.check()?;
    let mut optimizer = Optimizer::new(graph)?;
    let given = graph.poses.clone();
    let mut best: Option<(Optimum, Vec<G>)> = None;
    let mut trouble = None;
    for start in [Start::Chordal, Start::Given, Start::Odometry] {
        let poses = match start {
            Start::Chordal => chordal_in(graph, &optimizer.layout, None),
            Start::Given => Ok(given.clone()),
            Start::Odometry => odometry(graph),
        };
        // Gauss–Newton is for starts that are near.
        let method =
            if start == Start::Chordal { options.method } else { Method::LevenbergMarquardt };
        let descend = || {
            graph.poses = poses?;
            let summary = optimizer.optimize(graph, &Options { method, ..*options })?;
            Ok::<_, Error>(Optimum { start, certificate: certify(graph)?, summary })
        };
        match descend() {
            Ok(found) => {
                let done = found.certificate.is_certified();
                let better = best
                    .as_ref()
                    .is_none_or(|(best, _)| found.summary.final_chi2 < best.summary.final_chi2);
                if better {
                    best = Some((found, graph.poses.clone()));
                }
                if done {
                    break;
                }
            }
            Err(error) => trouble = Some(error),
        }
    }
    graph.poses = given;
    match (best, trouble) {
        (Some((optimum, poses)), _) => {
            graph.poses = poses;
            Ok(optimum)
        }
        // Some start failed where none led anywhere; there is one.
        (None, Some(error)) => Err(error),
        (None, None) => Err(Error::Overflow { edge: 0 }),
    }
}
