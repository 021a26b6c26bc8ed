//! Graduated non-convexity: the optimum of the measurements that agree, whatever the others say
//! (Yang, Antonante, Tzoumas & Carlone 2020).
//!
//! Robust costs have many minima. Their surrogate with a parameter μ is convex at first and becomes the
//! robust cost as μ goes to its end; each round solves a least-squares problem with one weight per
//! edge and then sets the weights from the errors. Three things make it work on pose graphs:
//!
//! 1. every round of the first pass starts from the chordal relaxation with its weights, which
//!    stands for the global solver that the method asks for: descent from where the last round ended
//!    stays in the minimum that outliers made;
//! 2. it begins with the loop closures that short cycles support (`cycles`) where odometry is
//!    trusted: random edges between distant poses fill the factor and cost more than all the rest;
//!    the others are judged later, at the poses that these give;
//! 3. the variance that information claims is seldom the true one. It is estimated from the inliers
//!    after each pass, and the error from which an edge is an outlier follows it.

use super::chordal::chordal_in;
use super::cycles::supported;
use super::odometry::{odometry, odometry_edges, ranks};
use super::optimizer::{Optimizer, Options};
use super::rigid::Rigid;
use super::{Edge, Error, Group, PoseGraph};

/// The robust cost of an edge with squared error s = eᵀ Ω e, in units of the error c² from which an edge
/// is an outlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Surrogate {
    /// min(s, c²): in the end an edge counts fully or not at all.
    #[default]
    TruncatedLeastSquares,
    /// c² s / (c² + s): outliers keep a little weight.
    GemanMcClure,
}

/// Which edges cannot be outliers.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum Trust {
    /// Those between poses that follow each other ([`odometry_edges`]).
    #[default]
    Odometry,
    /// One entry per edge.
    Edges(Vec<bool>),
    /// None. Where a pose hangs on a few edges only, as at the rim of a map, wrong ones can win, and
    /// good ones be lost until nothing holds a pose ([`Error::Unconstrained`]): trust odometry where
    /// there is any.
    Nothing,
}

/// How outliers are found.
#[derive(Clone, Debug, PartialEq)]
pub struct Gnc {
    /// The robust cost.
    pub surrogate: Surrogate,
    /// c²: an edge is an outlier from this squared error on, in units of the variance that the
    /// inliers show. Default: the quantile of χ² with D degrees of freedom that one inlier in 10 000
    /// exceeds.
    pub barrier: Option<f64>,
    /// Factor by which μ changes from round to round, above 1.
    pub growth: f64,
    /// Which edges are inliers for certain.
    pub trust: Trust,
}

impl Default for Gnc {
    fn default() -> Self {
        Gnc { surrogate: Surrogate::default(), barrier: None, growth: 2.0, trust: Trust::default() }
    }
}

/// What was found, beside the poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Inliers {
    /// Weight of each edge in the least-squares problem whose optimum the poses are: 0 to 1, of trusted ones 1.
    pub weights: Vec<f64>,
    /// Variance of the inliers' errors in units of what their information claims.
    pub variance: f64,
    /// The squared error from which an edge is an outlier.
    pub barrier: f64,
    /// Least-squares problems solved.
    pub rounds: usize,
}

impl Inliers {
    /// Whether an edge agrees with the others.
    pub fn is_inlier(&self, edge: usize) -> bool {
        self.weights.get(edge).is_some_and(|&weight| weight > 0.5)
    }
}

/// How far edges are looked for that may be inliers after all, in units of c².
const NEAR: [f64; 4] = [4.0, 32.0, 256.0, 2048.0];

/// Passes over the same edges at most.
const PASSES: usize = 4;

/// Steps towards the optimum of one set of weights.
const STEPS: usize = 3;

/// Rounds of one pass at most.
const ROUNDS: usize = 100;

/// The estimated variance starts from information being right, as sure as that many numbers.
const PRIOR: f64 = 10.0;

/// Moves the poses of `graph` to the optimum of its inliers, and says which these are.
///
/// ```
/// use tactile_host::graph::pose::gnc::{Gnc, gnc};
/// use tactile_host::graph::pose::{Edge, PoseGraph2, Se2};
///
/// // Twelve steps around a circle, twice, with closures between the rounds; one of them is false.
/// let step = Se2::new(1.0, 0.0, std::f64::consts::TAU / 12.0);
/// let edge = |from, to, measured| {
///     Edge { from, to, measured, information: nalgebra::Matrix3::identity() * 400.0 }
/// };
/// let mut edges: Vec<_> = (1..24).map(|k| edge(k - 1, k, step)).collect();
/// edges.extend((0..12).map(|k| edge(k, k + 12, Se2::new(0.0, 0.0, 0.0))));
/// edges.push(edge(2, 20, Se2::new(3.0, -2.0, 1.0)));
/// let poses = vec![Se2::new(0.0, 0.0, 0.0); 24];
/// let mut graph = PoseGraph2 { ids: (0..24).collect(), poses, edges, fixed: vec![] };
/// let found = gnc(&mut graph, &Gnc::default())?;
/// assert!((0..35).all(|edge| found.is_inlier(edge)) && !found.is_inlier(35));
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range, or poses that inliers leave undetermined.
pub fn gnc<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &mut PoseGraph<G, D>,
    options: &Gnc,
) -> Result<Inliers, Error> {
    graph.check()?;
    let trusted = match &options.trust {
        Trust::Nothing => vec![false; graph.edges.len()],
        Trust::Odometry => odometry_edges(graph),
        Trust::Edges(edges) => edges.clone(),
    };
    if trusted.len() != graph.edges.len() {
        return Err(Error::Weights { weights: trusted.len(), edges: graph.edges.len() });
    }
    let barrier = options.barrier.unwrap_or(if D == 3 { 21.1 } else { 27.9 });
    for (option, value, least) in
        [("the barrier", barrier, 0.0), ("the growth", options.growth, 1.0)]
    {
        if !(value > least && value.is_finite()) {
            return Err(Error::Option {
                option,
                value,
                expected: "a finite number above its least",
            });
        }
    }
    let all = vec![true; graph.edges.len()];
    graph.poses = odometry(graph)?;
    let search = |first: &[bool]| {
        let weights = first.iter().zip(&trusted).map(|(&a, &t)| f64::from(a || t)).collect();
        let (graph, trusted) = (graph.clone(), &trusted[..]);
        let mut search =
            Search { graph, options, trusted, barrier, variance: 1.0, weights, rounds: 0 };
        search.run::<N>().map(|()| search)
    };
    let found = if options.trust == Trust::Nothing {
        search(&all)?
    } else {
        let first = supported(graph, &ranks(graph), &trusted);
        let closures = trusted.iter().filter(|trusted| !**trusted).count();
        let enough = 2 * first.iter().filter(|first| **first).count() >= closures;
        let found = search(&first)?;
        if enough {
            found
        } else {
            // Where few closures are side by side, short cycles say little: all may be the better start.
            let other = search(&all)?;
            let variance = found.variance.max(other.variance);
            let rounds = found.rounds + other.rounds;
            let better = other.truncated(variance) < found.truncated(variance);
            Search { rounds, ..if better { other } else { found } }
        }
    };
    let Search { graph: moved, weights, variance, rounds, .. } = found;
    graph.poses = moved.poses;
    Ok(Inliers { weights, variance, barrier: barrier * variance, rounds })
}

/// A search under way.
#[derive(Clone, Debug)]
struct Search<'a, G, const D: usize> {
    graph: PoseGraph<G, D>,
    options: &'a Gnc,
    trusted: &'a [bool],
    /// c² in units of the variance.
    barrier: f64,
    variance: f64,
    weights: Vec<f64>,
    rounds: usize,
}

impl<G: Group<D>, const D: usize> Search<'_, G, D> {
    /// From edges whose weight is 1 to all inliers.
    fn run<const N: usize>(&mut self) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let open: Vec<bool> = self.trusted.iter().map(|trusted| !trusted).collect();
        self.anneal::<N>(&open, true)?;
        self.settle::<N>()?;
        for near in NEAR {
            for _ in 0..PASSES {
                let candidates = self.candidates(near);
                let count = candidates.iter().filter(|candidate| **candidate).count();
                if count == 0 || 10 * count > candidates.len() {
                    // None, or so many that they cannot be a few that were missed.
                    break;
                }
                let mut next = self.clone();
                for (weight, _) in next.weights.iter_mut().zip(&candidates).filter(|(_, new)| **new)
                {
                    *weight = 1.0;
                }
                next.anneal::<N>(&candidates, false)?;
                next.settle::<N>()?;
                self.rounds = next.rounds;
                // A new variance is no improvement by itself.
                if !(next.truncated(self.variance) < self.truncated(self.variance) * (1.0 - 1e-9)) {
                    break;
                }
                *self = next;
            }
        }
        self.solve::<N>(Options::default().max_iterations)
    }

    /// Sets the variance from the inliers and leaves out those that are none by it, until that changes
    /// nothing.
    fn settle<const N: usize>(&mut self) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        for _ in 0..PASSES {
            self.variance = self.estimated();
            if self.options.surrogate == Surrogate::GemanMcClure {
                break;
            }
            let barrier = self.barrier * self.variance;
            let mut changed = false;
            for ((edge, weight), _) in self
                .graph
                .edges
                .iter()
                .zip(&mut self.weights)
                .zip(self.trusted)
                .filter(|(_, trusted)| !**trusted)
            {
                let inlier = edge.chi2(&self.graph.poses) < barrier;
                changed |= *weight > 0.0 && !inlier;
                *weight = if inlier && *weight > 0.0 { 1.0 } else { 0.0 };
            }
            if !changed {
                break;
            }
            self.solve::<N>(STEPS)?;
        }
        Ok(())
    }

    /// Moves the poses towards the optimum of the weights.
    fn solve<const N: usize>(&mut self, iterations: usize) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let mut part = Part::new(&self.graph, &self.weights)?;
        part.solve(false, iterations)?;
        self.rounds += 1;
        self.graph.poses = part.graph.poses;
        Ok(())
    }

    /// Lets μ run from convex to robust over the `open` edges whose weight is not zero, from the relaxed
    /// optimum in every round (`relaxed`) or from the poses as they are; the others keep their weight.
    fn anneal<const N: usize>(&mut self, open: &[bool], relaxed: bool) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        let barrier = self.barrier * self.variance;
        let mut part = Part::new(&self.graph, &self.weights)?;
        if relaxed {
            part.solve(true, STEPS)?;
            self.rounds += 1;
        }
        let among = part.graph.edges.iter().zip(&part.edges).filter(|(_, edge)| open[**edge]);
        let worst = among.map(|(edge, _)| edge.chi2(&part.graph.poses)).fold(0.0, f64::max);
        let mut annealing = Annealing::new(self.options, barrier, worst);
        for _ in 0..ROUNDS {
            let mut settled = true;
            for (at, &edge) in part.edges.iter().enumerate().filter(|(_, edge)| open[**edge]) {
                let weight = annealing.weight(part.graph.edges[at].chi2(&part.graph.poses));
                settled &= weight == 0.0 || weight == 1.0 || annealing.is_last();
                part.weights[at] = weight;
                self.weights[edge] = weight;
            }
            let dropped = part.weights.iter().filter(|&&weight| weight == 0.0).count();
            if 20 * dropped > part.weights.len() {
                // Edges without weight still fill the factor.
                self.graph.poses = part.graph.poses;
                part = Part::new(&self.graph, &self.weights)?;
            }
            part.solve(relaxed && !settled, if settled { STEPS } else { 1 })?;
            self.rounds += 1;
            if settled {
                break;
            }
            let growth = self.options.growth;
            annealing.proceed(if relaxed { growth } else { growth.powi(3) });
        }
        self.graph.poses = part.graph.poses;
        Ok(())
    }

    /// Σ min(s, c²) over all edges.
    fn truncated(&self, variance: f64) -> f64 {
        let barrier = self.barrier * variance;
        let cost = |(edge, &trusted): (&Edge<G, D>, &bool)| {
            let squared = edge.chi2(&self.graph.poses);
            if trusted { squared } else { squared.min(barrier) }
        };
        self.graph.edges.iter().zip(self.trusted).map(cost).sum()
    }

    /// The variance that the inliers show: χ² by degrees of freedom, with a prior.
    fn estimated(&self) -> f64 {
        let weighted =
            self.graph.edges.iter().zip(&self.weights).filter(|(_, weight)| **weight > 0.0);
        let (mut chi2, mut measured) = (0.0, 0.0);
        for (edge, weight) in weighted {
            chi2 += weight * edge.chi2(&self.graph.poses);
            measured += weight * D as f64;
        }
        let free = self.graph.held().iter().filter(|held| !**held).count() * D;
        (PRIOR + chi2) / (PRIOR + (measured - free as f64).max(0.0))
    }

    /// Outliers whose squared error at these poses is less than `near` times that of an inlier. What
    /// took no part in the optimum fits it worse than it could.
    fn candidates(&self, near: f64) -> Vec<bool> {
        let near = near * self.barrier * self.variance;
        let out = |(edge, &weight): (&Edge<G, D>, &f64)| {
            weight <= 0.5 && edge.chi2(&self.graph.poses) < near
        };
        self.graph.edges.iter().zip(&self.weights).map(out).collect()
    }
}

/// The edges of a graph that have weight.
struct Part<G, const D: usize> {
    graph: PoseGraph<G, D>,
    /// Their indices in the whole graph.
    edges: Vec<usize>,
    weights: Vec<f64>,
    optimizer: Optimizer<D>,
}

impl<G: Group<D>, const D: usize> Part<G, D> {
    fn new(whole: &PoseGraph<G, D>, weights: &[f64]) -> Result<Self, Error> {
        let edges: Vec<usize> = (0..weights.len()).filter(|&edge| weights[edge] > 0.0).collect();
        let graph = PoseGraph {
            ids: whole.ids.clone(),
            poses: whole.poses.clone(),
            edges: edges.iter().map(|&edge| whole.edges[edge].clone()).collect(),
            fixed: whole.fixed.clone(),
        };
        let optimizer = Optimizer::new(&graph)?;
        let weights = edges.iter().map(|&edge| weights[edge]).collect();
        Ok(Part { graph, edges, weights, optimizer })
    }

    /// Moves the poses towards the optimum of the weighted edges.
    fn solve<const N: usize>(&mut self, relaxed: bool, iterations: usize) -> Result<(), Error>
    where
        G: Rigid<D, N>,
    {
        if relaxed {
            self.graph.poses =
                chordal_in(&self.graph, &self.optimizer.layout, Some(&self.weights))?;
        }
        let options = Options { max_iterations: iterations, ..Options::default() };
        let weights = Some(&self.weights[..]);
        self.optimizer.optimize_weighted(&mut self.graph, weights, &options, &mut |_| ())?;
        Ok(())
    }
}

/// A surrogate on its way to the robust cost.
struct Annealing {
    surrogate: Surrogate,
    barrier: f64,
    mu: f64,
}

impl Annealing {
    /// Convex where no squared error is above `worst`.
    fn new(options: &Gnc, barrier: f64, worst: f64) -> Self {
        let mu = match options.surrogate {
            Surrogate::TruncatedLeastSquares => {
                barrier / (2.0 * worst - barrier).max(1e-9 * barrier)
            }
            Surrogate::GemanMcClure => (2.0 * worst / barrier).max(1.0),
        };
        Annealing { surrogate: options.surrogate, barrier, mu }
    }

    fn weight(&self, squared: f64) -> f64 {
        let Annealing { barrier, mu, .. } = *self;
        match self.surrogate {
            Surrogate::TruncatedLeastSquares if squared >= (mu + 1.0) / mu * barrier => 0.0,
            Surrogate::TruncatedLeastSquares if squared <= mu / (mu + 1.0) * barrier => 1.0,
            Surrogate::TruncatedLeastSquares => {
                ((barrier * mu * (mu + 1.0) / squared).sqrt() - mu).clamp(0.0, 1.0)
            }
            Surrogate::GemanMcClure => (mu * barrier / (squared + mu * barrier)).powi(2),
        }
    }

    /// Whether the surrogate is the robust cost.
    fn is_last(&self) -> bool {
        self.surrogate == Surrogate::GemanMcClure && self.mu <= 1.0
    }

    fn proceed(&mut self, growth: f64) {
        match self.surrogate {
            Surrogate::TruncatedLeastSquares => self.mu *= growth,
            Surrogate::GemanMcClure => self.mu = (self.mu / growth).max(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::grid::{Random, distance, grid};
    use super::super::optimize;
    use super::super::{Se2, Se3};
    use super::*;

    /// A grid solved, and the same unsolved with random closures behind its edges, a share of all
    /// closures.
    fn spoiled<G: Rigid<D, N>, const D: usize, const N: usize>(
        seed: u64,
        share: f64,
    ) -> (PoseGraph<G, D>, PoseGraph<G, D>) {
        let mut clean = grid::<G, D>(seed, 8, 0.02);
        let closures = odometry_edges(&clean).iter().filter(|chain| !**chain).count();
        let mut spoiled = clean.clone();
        let mut random = Random::new(seed);
        for _ in 0..(closures as f64 * share / (1.0 - share)).round() as usize {
            let from = random.index(clean.poses.len() - 2);
            let to = from + 2 + random.index(clean.poses.len() - from - 2);
            let information = clean.edges[0].information;
            spoiled.edges.push(Edge { from, to, measured: random.anywhere(6.0), information });
        }
        optimize(&mut clean, &Options::default()).unwrap();
        spoiled.poses.fill(G::identity());
        spoiled.poses[0] = clean.poses[0];
        (clean, spoiled)
    }

    /// Random closures added to a grid, a share of all closures: all are found, and nothing else.
    fn recovers<G: Rigid<D, N>, const D: usize, const N: usize>(
        seed: u64,
        share: f64,
        options: &Gnc,
    ) {
        let (clean, mut spoiled) = spoiled::<G, D, N>(seed, share);
        let right = clean.edges.len();
        let found = gnc(&mut spoiled, options).unwrap();
        assert!((right..spoiled.edges.len()).all(|edge| !found.is_inlier(edge)), "{found:?}");
        let lost = (0..right).filter(|&edge| !found.is_inlier(edge)).count();
        assert!(lost <= 1, "{lost} lost");
        let apart = distance(&spoiled.poses, &clean.poses);
        assert!(apart < 1e-3, "{apart}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn random_closures_are_rejected(seed in 0u64..500, share in 0.05f64..0.5) {
            let robust = Gnc::default();
            recovers::<Se2, 3, 2>(seed, share, &robust);
            recovers::<Se3, 6, 3>(seed, share, &robust);
            let surrogate = Surrogate::GemanMcClure;
            recovers::<Se2, 3, 2>(seed, share, &Gnc { surrogate, ..robust.clone() });
        }
    }

    /// Not all, see [`Trust::Nothing`].
    #[test]
    fn without_trusted_odometry_most_random_closures_are_rejected() {
        let options = Gnc { trust: Trust::Nothing, ..Gnc::default() };
        let (mut wrong, mut rejected) = (0, 0);
        for seed in 0..12 {
            let (clean, mut spoiled) = spoiled::<Se2, 3, 2>(seed, 0.1);
            let planted = clean.edges.len()..spoiled.edges.len();
            match gnc(&mut spoiled, &options) {
                Ok(found) => {
                    wrong += planted.len();
                    rejected += planted.filter(|&edge| !found.is_inlier(edge)).count();
                }
                Err(error) => assert!(matches!(error, Error::Unconstrained { .. }), "{error}"),
            }
        }
        assert!(wrong > 20 && 4 * rejected > 3 * wrong, "{rejected} of {wrong}");
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let mut graph = grid::<Se2, 3>(1, 3, 0.0);
        let mut refused = |options| gnc(&mut graph, &options).unwrap_err();
        let error = refused(Gnc { barrier: Some(0.0), ..Gnc::default() });
        assert!(matches!(error, Error::Option { option: "the barrier", .. }));
        let error = refused(Gnc { growth: 1.0, ..Gnc::default() });
        assert!(matches!(error, Error::Option { option: "the growth", .. }));
        let error = refused(Gnc { trust: Trust::Edges(vec![true]), ..Gnc::default() });
        assert_eq!(error, Error::Weights { weights: 1, edges: graph.edges.len() });
    }

    #[test]
    fn little_or_nothing_has_no_outliers() {
        let mut none: PoseGraph<Se2, 3> = PoseGraph::default();
        assert_eq!(gnc(&mut none, &Gnc::default()).unwrap().weights, Vec::<f64>::new());
        let mut chain = grid::<Se2, 3>(1, 4, 0.0);
        chain.edges.truncate(15);
        assert_eq!(gnc(&mut chain, &Gnc::default()).unwrap().weights, vec![1.0; 15]);
    }
}
