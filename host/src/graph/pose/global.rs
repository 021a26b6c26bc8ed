//! The global optimum: from the best of several starts, with a certificate.

use std::time::{Duration, Instant};

use super::certificate::Certificate;
use super::chordal::chordal_in;
use super::kernel::Kernel;
use super::odometry::odometry;
use super::optimizer::{Iteration, Method, Optimizer, Options, Summary};
use super::rigid::Rigid;
use super::start::Start;
use super::{Error, PoseGraph};

/// What [`optimize_globally`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimum {
    /// The start that led there.
    pub start: Start,
    /// Its descent.
    pub summary: Summary,
    /// Whether it is the global optimum; `None` where a kernel weighs edges, so that χ² is not what was
    /// minimised.
    pub certificate: Option<Certificate>,
    /// The starts that were tried, in this order.
    pub tried: Vec<Start>,
    /// How much of the time went into certificates.
    pub certifying: Duration,
}

/// Steps that a start has to come below the best end so far.
const TRIAL: usize = 8;

/// Moves the poses of `graph` to the best minimum of χ² that it finds, telling `watch` of every step.
///
/// It starts at the poses as given if they agree with their measurements as well as noise lets any (χ² at
/// most the measured numbers less those that the poses need) or are cheaper than the chordal
/// relaxation; else there, near the global minimum where odometry ends in a local one. Only where the end is
/// not certified to be the global minimum, the other starts are tried, odometry among them, and the
/// cheapest end is kept; each has a few steps to come below the best so far.
///
/// With a kernel there is no certificate, hence one descent; where there are outliers, use
/// [`gnc`](super::gnc::gnc).
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
/// let optimum = optimize_globally(&mut ring, &Options::default(), &mut |_| ())?;
/// assert!(optimum.certificate.is_some_and(|c| c.is_certified()) && ring.chi2() < 1e-12);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range, or measurements that leave a pose undetermined.
pub fn optimize_globally<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    options: &Options,
    watch: &mut dyn FnMut(&Iteration),
) -> Result<Optimum, Error> {
    graph.check()?;
    let optimizer = Optimizer::new(graph)?;
    let given = graph.poses.clone();
    let mut search = Search { graph, optimizer, options, watch, best: None, tried: Vec::new() };
    let outcome = search.run(&given);
    let (best, tried) = (search.best, search.tried);
    let Some(best) = best else {
        graph.poses = given;
        // Where no start led anywhere, one of them failed.
        return Err(outcome.err().unwrap_or(Error::Overflow { edge: 0 }));
    };
    graph.poses = best.poses;
    Ok(Optimum {
        start: best.start,
        summary: best.summary,
        certificate: best.certificate,
        tried,
        certifying: best.certifying,
    })
}

/// The end of a descent.
struct End<G> {
    start: Start,
    poses: Vec<G>,
    summary: Summary,
    certificate: Option<Certificate>,
    /// Of this and all before.
    certifying: Duration,
}

struct Search<'a, G: Rigid<D, N>, const D: usize, const N: usize> {
    graph: &'a mut PoseGraph<G, D>,
    optimizer: Optimizer<D>,
    options: &'a Options,
    watch: &'a mut dyn FnMut(&Iteration),
    best: Option<End<G>>,
    tried: Vec<Start>,
}

impl<G: Rigid<D, N>, const D: usize, const N: usize> Search<'_, G, D, N> {
    /// Tries one start after the other until an end is certified. The error is the first start's that failed.
    fn run(&mut self, given: &[G]) -> Result<(), Error> {
        let mut outcome = Ok(());
        let fits = |chi2: f64, graph: &PoseGraph<G, D>| {
            let degrees = D * (graph.edges.len() + 1).saturating_sub(graph.poses.len());
            chi2 <= degrees as f64
        };
        let at_given = self.graph.chi2();
        let mut relaxed = None;
        let mut starts = vec![Start::File];
        if !fits(at_given, self.graph) {
            match chordal_in(self.graph, &self.optimizer.layout, None) {
                Ok(poses) => {
                    self.graph.poses.clone_from(&poses);
                    if self.graph.chi2() <= at_given {
                        starts = vec![];
                    }
                    relaxed = Some(poses);
                }
                Err(error) => outcome = Err(error),
            }
        }
        for start in [Start::Chordal, Start::Odometry, Start::File] {
            if !starts.contains(&start) {
                starts.push(start);
            }
        }
        for start in starts {
            let poses = match start {
                Start::File => Ok(given.to_vec()),
                Start::Chordal => match relaxed.take() {
                    Some(poses) => Ok(poses),
                    None if outcome.is_err() => continue,
                    None => chordal_in(self.graph, &self.optimizer.layout, None),
                },
                // Of edges alone, these are the poses as given.
                Start::Odometry => match odometry(self.graph) {
                    Ok(poses) if poses == given => continue,
                    poses => poses,
                },
            };
            let tried = poses.and_then(|poses| self.try_start(start, poses));
            if let Err(error) = tried {
                outcome = outcome.and(Err(error));
            }
            let done = |end: &End<G>| end.certificate.is_none_or(|c| c.is_certified());
            if self.best.as_ref().is_some_and(done) {
                break;
            }
        }
        outcome
    }

    /// Descends from `poses` and keeps the end if it is the best so far.
    fn try_start(&mut self, start: Start, poses: Vec<G>) -> Result<(), Error> {
        self.graph.poses = poses;
        self.tried.push(start);
        let to_beat = self.best.as_ref().map(|best| best.summary.final_cost);
        let max_iterations = to_beat.map_or(self.options.max_iterations, |_| TRIAL);
        let mut summary = self.descend(Options { max_iterations, ..*self.options })?;
        // Far from the minimum, whole steps may lead anywhere.
        if to_beat.is_none() && !summary.converged() && self.options.method == Method::GaussNewton {
            let method = Method::LevenbergMarquardt;
            summary = summary.followed_by(self.descend(Options { method, ..*self.options })?);
        }
        if let Some(cost) = to_beat {
            if summary.final_cost >= cost {
                return Ok(());
            }
            summary = summary.followed_by(self.descend(*self.options)?);
        }
        let clock = Instant::now();
        let mut certificate = self.certificate()?;
        let mut certifying = clock.elapsed();
        if let Some(Certificate::Bounded { .. }) = certificate {
            // What is left of the gradient may be all that is missing.
            summary = summary.followed_by(self.descend(Options { tolerance: 0.0, ..*self.options })?);
            let clock = Instant::now();
            certificate = self.certificate()?;
            certifying += clock.elapsed();
        }
        certifying += self.best.as_ref().map_or(Duration::ZERO, |best| best.certifying);
        let poses = self.graph.poses.clone();
        self.best = Some(End { start, poses, summary, certificate, certifying });
        Ok(())
    }

    fn descend(&mut self, options: Options) -> Result<Summary, Error> {
        self.optimizer.optimize_weighted(self.graph, None, &options, self.watch)
    }

    fn certificate(&self) -> Result<Option<Certificate>, Error> {
        let plain = self.options.kernel == Kernel::Identity;
        plain.then(|| G::certify(self.graph, &self.optimizer.layout)).transpose()
    }
}
