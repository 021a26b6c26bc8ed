//! The global optimum: from the best of several starts, with a certificate.

use std::time::{Duration, Instant};

use super::certificate::Certificate;
use super::chordal::chordal_in;
use super::kernel::Kernel;
use super::normal::Cost;
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
/// With a kernel there is no certificate: where edges disagree at the end, all starts are tried. Where there
/// are outliers, use [`gnc`](super::gnc::gnc).
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
        let cost = Cost { kernel: self.options.kernel, weights: None };
        let mut relaxed = None;
        let mut starts = vec![Start::File];
        if !fits(self.graph.chi2(), self.graph) {
            match chordal_in(self.graph, &self.optimizer.layout, None) {
                Ok(poses) => {
                    if cost.total(self.graph, &poses) <= cost.total(self.graph, given) {
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
            self.tried.push(start);
            let tried = poses.and_then(|poses| self.try_start(start, poses));
            if let Err(error) = tried {
                outcome = outcome.and(Err(error));
            }
            let done = |end: &End<G>| match end.certificate {
                // Without a factor every try takes long, and nothing says whether it was worth it.
                Some(Certificate::Certified { .. } | Certificate::Undecided { .. }) => true,
                Some(_) => false,
                // A kernel leaves many minima, of which nothing tells the least but that nothing disagrees.
                None => fits(end.summary.final_chi2, self.graph),
            };
            if self.best.as_ref().is_some_and(done) {
                return outcome;
            }
        }
        outcome
    }

    /// Descends from `poses` and keeps the end if it is the best so far.
    fn try_start(&mut self, start: Start, poses: Vec<G>) -> Result<(), Error> {
        self.graph.poses = poses;
        let to_beat = self.best.as_ref().map(|best| best.summary.final_cost);
        let most = self.options.max_iterations;
        let max_iterations = to_beat.map_or(most, |_| TRIAL.min(most));
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
            summary =
                summary.followed_by(self.descend(Options { tolerance: 0.0, ..*self.options })?);
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

#[cfg(test)]
mod tests {
    use super::super::grid::{Random, grid};
    use super::super::{Edge, Group, Limit, Se2, Se3, optimize};
    use super::*;

    const OPTIONS: Options = Options {
        method: Method::GaussNewton,
        kernel: Kernel::Identity,
        max_iterations: 100,
        tolerance: 1e-8,
    };

    fn found<G: Rigid<D, N>, const D: usize, const N: usize>(
        graph: &mut PoseGraph<G, D>,
        options: &Options,
    ) -> Optimum {
        optimize_globally(graph, options, &mut |_| ()).unwrap()
    }

    #[test]
    fn wherever_it_starts_the_end_is_the_same() {
        for seed in 0..5 {
            let mut from_truth = grid::<Se3, 6>(seed, 5, 0.05);
            let mut from_anywhere = from_truth.clone();
            let mut random = Random::new(seed);
            for pose in &mut from_anywhere.poses[1..] {
                *pose = random.anywhere(5.0);
            }
            let (near, far) =
                (found(&mut from_truth, &OPTIONS), found(&mut from_anywhere, &OPTIONS));
            assert!(near.certificate.is_some_and(|c| c.is_certified()));
            assert_eq!((far.start, far.tried.as_slice()), (Start::Chordal, &[Start::Chordal][..]));
            let difference = near.summary.final_chi2 / far.summary.final_chi2 - 1.0;
            assert!(difference.abs() < 1e-9, "{difference}");
        }
    }

    #[test]
    fn poses_that_fit_stay_and_others_are_left() {
        let mut graph = grid::<Se2, 3>(1, 5, 0.02);
        optimize(&mut graph, &OPTIONS).unwrap();
        assert_eq!(found(&mut graph, &OPTIONS).tried, [Start::File]);
        // Half the poses turned round: descent from there ends elsewhere, and it is noticed.
        for pose in &mut graph.poses[13..] {
            *pose = pose.compose(&Se2::new(0.0, 0.0, 3.0));
        }
        assert_eq!(found(&mut graph, &OPTIONS).start, Start::Chordal);
    }

    #[test]
    fn what_is_not_certified_is_tried_from_everywhere_and_the_cheapest_kept() {
        let mut tried_all = 0;
        for seed in 0..12 {
            let graph = grid::<Se3, 6>(seed, 4, 0.7);
            let mut best = graph.clone();
            let optimum = found(&mut best, &OPTIONS);
            assert!((best.chi2() / optimum.summary.final_chi2 - 1.0).abs() < 1e-12);
            if optimum.certificate.is_some_and(|c| c.is_certified()) {
                continue;
            }
            assert!(optimum.tried.len() >= 3, "{:?}", optimum.tried);
            tried_all += 1;
            let mut alone = graph.clone();
            Start::Chordal.place(&mut alone).unwrap();
            let alone = optimize(&mut alone, &OPTIONS).unwrap();
            assert!(optimum.summary.final_chi2 <= alone.final_chi2 * (1.0 + 1e-9));
        }
        assert!(tried_all > 0);
    }

    #[test]
    fn without_steps_nothing_moves_from_where_it_starts() {
        let mut graph = grid::<Se2, 3>(0, 4, 0.4);
        let given = graph.chi2();
        let optimum = found(&mut graph, &Options { max_iterations: 0, ..OPTIONS });
        assert_eq!(optimum.summary.iterations(), 0);
        assert!(graph.chi2() <= given);
    }

    #[test]
    fn kernels_have_no_certificate_and_open_graphs_no_optimum() {
        let mut graph = grid::<Se2, 3>(2, 4, 0.02);
        let options = Options { kernel: Kernel::Huber(1.0), ..OPTIONS };
        let optimum = found(&mut graph, &options);
        assert!(optimum.certificate.is_none());
        let given = graph.poses.clone();
        graph.edges.iter_mut().for_each(|edge| edge.information[(2, 2)] = 0.0);
        let error = optimize_globally(&mut graph, &OPTIONS, &mut |_| ()).unwrap_err();
        assert!(matches!(error, Error::Unconstrained { .. }), "{error}");
        assert_eq!(graph.poses, given);
        let mut none = PoseGraph::<Se2, 3>::default();
        assert!(found(&mut none, &OPTIONS).certificate.is_some_and(|c| c.is_certified()));
    }

    #[test]
    fn a_kernel_starts_where_it_is_cheapest() {
        // A chain whose ends a wrong edge bends together: spread over all edges the error is small everywhere, and
        // to a kernel that lets go of great ones still dear.
        let place = |k: u32| Se2::new(f64::from(k), 0.0, 0.0);
        let information = nalgebra::Matrix3::identity() * 100.0;
        let edge = |from: usize, to: usize, by| Edge { from, to, measured: place(by), information };
        let chain = (0..20).map(|k| edge(k, k + 1, 1));
        let mut graph = PoseGraph::<Se2, 3> {
            ids: (0..21).collect(),
            poses: (0..21).map(place).collect(),
            edges: chain.chain([edge(0, 20, 15)]).collect(),
            fixed: vec![],
        };
        let options = Options { kernel: Kernel::Tukey(5.49), ..OPTIONS };
        let optimum = found(&mut graph, &options);
        assert!(optimum.summary.final_cost < 10.1, "{:?}", optimum.summary);
        assert!(graph.poses[20].between(&place(20)).translation_vector().norm() < 1e-3);
    }

    #[test]
    fn graphs_beyond_the_limit_are_solved_without_their_factor() {
        for seed in 0..4 {
            let mut direct = grid::<Se3, 6>(seed, 6, 0.03);
            let mut random = Random::new(seed);
            for _ in 0..200 {
                let (from, to) = (random.index(36), random.index(36));
                if from != to {
                    let exact = direct.poses[from].between(&direct.poses[to]);
                    let measured = exact.retract(&random.tangent(0.03));
                    let information = direct.edges[0].information;
                    direct.edges.push(Edge { from, to, measured, information });
                }
            }
            let mut iterative = direct.clone();
            let limit = Limit { bytes: 1000, products: 1e3 };
            let mut optimizer = Optimizer::with_limit(&iterative, limit).unwrap();
            assert!(!optimizer.layout.structure.is_complete());
            let relaxed = chordal_in(&iterative, &optimizer.layout, None).unwrap();
            let certificate = Se3::certify(&iterative, &optimizer.layout).unwrap();
            assert!(matches!(certificate, Certificate::Undecided { .. }));
            assert_eq!(
                optimizer.marginals(&iterative, None, &OPTIONS).unwrap_err(),
                Error::TooDense
            );
            iterative.poses = relaxed;
            for method in [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg] {
                let mut iterative = iterative.clone();
                let summary =
                    optimizer.optimize(&mut iterative, &Options { method, ..OPTIONS }).unwrap();
                let direct = optimize(&mut direct, &OPTIONS).unwrap();
                assert!(summary.converged(), "{method:?} {:?}", summary.stop);
                let difference = summary.final_chi2 / direct.final_chi2 - 1.0;
                assert!(difference.abs() < 1e-7, "{method:?}: {difference}");
            }
        }
    }
}
