//! Graduated non-convexity: the optimum of the measurements that agree, whatever the others say
//! (Yang, Antonante, Tzoumas & Carlone 2020).
//!
//! Robust costs have many minima. Their surrogate with a parameter μ is convex at first and becomes the
//! robust cost as μ goes to its end; each round solves a least-squares problem with one weight per
//! edge and then sets the weights from the errors. By itself that fails on pose graphs: a false closure across
//! the map bends it until right ones look wrong, fills the factor, and no fixed error
//! divides right from wrong where information claims too much. So annealing is the second step of three:
//!
//! 1. the start is what short cycles support (`cycles`): closures that agree with odometry or with those of
//!    another look, by odds against chance, under the scale of errors at which all cycles together
//!    are most probable;
//! 2. where some of these contradict the others, and they are many, they are annealed, every round from the
//!    chordal relaxation with its weights, which stands for the global solver that the method
//!    asks for; a few are left out one after the other;
//! 3. every edge is judged by its odds (`evidence`): the density of its error if it is right, given
//!    the others and how uncertain they leave it, against that of a random closure. What is
//!    more probably right is taken in, what is certainly wrong is left out, until nothing changes
//!    (`consensus`).

use nalgebra::SVector;

use super::consensus::Search;
use super::cycles::{agreeing, supported};
use super::evidence::Chance;
use super::odometry::{odometry, odometry_edges, ranks};
use super::rigid::Rigid;
use super::{Error, PoseGraph};

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
    /// None. Poses are then held by edges in short cycles (of four at most) that close. Where these leave
    /// a part of the map loose and several other edges disagree about its place, the answer is
    /// [`Error::Undecided`]: trust odometry where there is any.
    Nothing,
}

/// How outliers are found.
#[derive(Clone, Debug, PartialEq)]
pub struct Gnc {
    /// The robust cost.
    pub surrogate: Surrogate,
    /// c²: an edge is an outlier from this squared error on, in units of the variance that is
    /// expected of it. Default: odds decide; the surrogate has the quantile of χ² with D
    /// degrees of freedom that one inlier in 10 000 exceeds.
    pub barrier: Option<f64>,
    /// Factor by which μ changes from round to round, above 1.
    pub growth: f64,
    /// Which edges are inliers for certain.
    pub trust: Trust,
}

impl Gnc {
    /// c² of the robust cost for errors of that many numbers.
    pub(super) fn barrier(&self, degrees: usize) -> f64 {
        self.barrier.unwrap_or(if degrees == 3 { 21.1 } else { 27.9 })
    }
}

impl Default for Gnc {
    fn default() -> Self {
        Gnc { surrogate: Surrogate::default(), barrier: None, growth: 2.0, trust: Trust::default() }
    }
}

/// What was found, beside the poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Inliers {
    /// Weight of each edge in the least-squares problem whose optimum the poses are: 0 or 1, of trusted ones 1.
    pub weights: Vec<f64>,
    /// How much more probable each edge is if it is right than if it is random, as natural logarithm,
    /// given the others; of trusted ones infinite.
    pub odds: Vec<f64>,
    /// Variance of the inliers' errors in units of what their information claims.
    pub variance: f64,
    /// Least-squares problems solved.
    pub rounds: usize,
}

impl Inliers {
    /// Whether an edge agrees with the others.
    pub fn is_inlier(&self, edge: usize) -> bool {
        self.weights.get(edge).is_some_and(|&weight| weight > 0.5)
    }
}

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
/// See [`Error`]: numbers out of range, poses that inliers leave undetermined, or
/// [`Error::Undecided`].
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
    for (option, value, least) in
        [("the barrier", options.barrier(D), 0.0), ("the growth", options.growth, 1.0)]
    {
        if !(value > least && value.is_finite()) {
            return Err(Error::Option {
                option,
                value,
                expected: "a finite number above its least",
            });
        }
    }
    let mut start = graph.clone();
    start.poses = odometry(graph)?;
    // The extent of the map, as far as it is known before it is solved.
    let lengths = graph.edges.iter().map(|edge| edge.measured.translation_vector().norm());
    let count = start.poses.len().max(1) as f64;
    let middle = start.poses.iter().map(G::translation_vector).sum::<SVector<f64, N>>() / count;
    let radii = start.poses.iter().map(|pose| (pose.translation_vector() - middle).norm());
    let mut chance = Chance::new::<D, N>(lengths.chain(radii).fold(0.0, f64::max));
    let support = match options.trust {
        Trust::Nothing => agreeing(graph, &chance),
        _ => supported(graph, &ranks(graph), &trusted, &chance),
    };
    chance.variance = support.variance;
    let mut search = Search::new(&start, options, &trusted, support, chance);
    search.run::<N>().map_err(|error| match error {
        // What was left out had held the pose.
        Error::Unconstrained { id, .. } if options.trust == Trust::Nothing => {
            Error::Undecided { id }
        }
        other => other,
    })?;
    if let Some(id) = search.undecided() {
        return Err(Error::Undecided { id });
    }
    graph.poses = search.graph.poses;
    Ok(Inliers {
        weights: search.accepted.iter().map(|&accepted| f64::from(accepted)).collect(),
        odds: search.odds,
        variance: search.chance.variance,
        rounds: search.rounds,
    })
}

/// A surrogate on its way to the robust cost.
pub(super) struct Annealing {
    surrogate: Surrogate,
    barrier: f64,
    mu: f64,
}

impl Annealing {
    /// Convex where no squared error is above `worst`.
    pub fn new(options: &Gnc, barrier: f64, worst: f64) -> Self {
        let mu = match options.surrogate {
            Surrogate::TruncatedLeastSquares => {
                barrier / (2.0 * worst - barrier).max(1e-9 * barrier)
            }
            Surrogate::GemanMcClure => (2.0 * worst / barrier).max(1.0),
        };
        Annealing { surrogate: options.surrogate, barrier, mu }
    }

    /// Of an edge with this squared error.
    pub fn weight(&self, squared: f64) -> f64 {
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
    pub fn is_last(&self) -> bool {
        self.surrogate == Surrogate::GemanMcClure && self.mu <= 1.0
    }

    /// A step towards it.
    pub fn proceed(&mut self, growth: f64) {
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
    use super::super::{Edge, Group, Options, Se2, Se3, optimize};
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

    /// Random closures added to a grid, a share of all closures: how many, and how many passed for right.
    /// In a world of a few hundred noise deviations one lies by chance now and then where right ones
    /// err, too; where none does, the map is the clean one.
    fn recovers<G: Rigid<D, N>, const D: usize, const N: usize>(
        seed: u64,
        share: f64,
        options: &Gnc,
    ) -> (usize, usize) {
        let (clean, mut spoiled) = spoiled::<G, D, N>(seed, share);
        let right = clean.edges.len();
        let found = gnc(&mut spoiled, options).unwrap();
        let passed: Vec<usize> =
            (right..spoiled.edges.len()).filter(|&edge| found.is_inlier(edge)).collect();
        let lost = (0..right).filter(|&edge| !found.is_inlier(edge)).count();
        assert!(lost <= 1, "{lost} lost");
        let apart = distance(&spoiled.poses, &clean.poses);
        assert!(apart < 1e-3 || !passed.is_empty(), "{apart}");
        // Right ones have odds of ten and more.
        assert!(passed.iter().all(|&edge| found.odds[edge] < 8.0), "{found:?}");
        (spoiled.edges.len() - right, passed.len())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn random_closures_are_rejected(seed in 0u64..500, share in 0.05f64..0.5) {
            let robust = Gnc::default();
            let surrogate = Surrogate::GemanMcClure;
            for (_, passed) in [
                recovers::<Se2, 3, 2>(seed, share, &robust),
                recovers::<Se3, 6, 3>(seed, share, &robust),
                recovers::<Se2, 3, 2>(seed, share, &Gnc { surrogate, ..robust.clone() }),
            ] {
                prop_assert!(passed <= 2, "{passed}");
            }
        }
    }

    #[test]
    fn hardly_any_random_closure_passes_for_a_right_one() {
        let (mut all, mut passed) = (0, 0);
        for seed in 0..24 {
            let of = recovers::<Se2, 3, 2>(seed, 0.4, &Gnc::default());
            (all, passed) = (all + of.0, passed + of.1);
        }
        assert!(100 * passed <= all, "{passed} of {all}");
    }

    /// Three in a row that agree: one place is taken for another for a while.
    fn alike<G: Rigid<D, N>, const D: usize, const N: usize>(seed: u64, groups: usize) {
        let mut clean = grid::<G, D>(seed, 14, 0.02);
        optimize(&mut clean, &Options::default()).unwrap();
        let mut spoiled = clean.clone();
        let mut random = Random::new(seed);
        let information = clean.edges[0].information;
        for _ in 0..groups {
            let (a, b) = (random.index(90), 100 + random.index(90));
            let motion: G = random.anywhere(10.0);
            for step in 0..3 {
                let before = clean.poses[a + step].between(&clean.poses[a]);
                let after = clean.poses[b].between(&clean.poses[b + step]);
                let measured = before.compose(&motion).compose(&after);
                spoiled.edges.push(Edge { from: a + step, to: b + step, measured, information });
            }
        }
        spoiled.poses.fill(G::identity());
        spoiled.poses[0] = clean.poses[0];
        let found = gnc(&mut spoiled, &Gnc::default()).unwrap();
        let right = clean.edges.len();
        let passed = (right..spoiled.edges.len()).filter(|&edge| found.is_inlier(edge)).count();
        let lost = (0..right).filter(|&edge| !found.is_inlier(edge)).count();
        let apart = distance(&spoiled.poses, &clean.poses);
        assert!(passed == 0 && lost <= 1 && apart < 1e-3, "{seed}: {passed} {lost} {apart}");
    }

    #[test]
    fn false_closures_that_agree_are_found_out() {
        for seed in 0..6 {
            alike::<Se2, 3, 2>(seed, 20);
            alike::<Se3, 6, 3>(seed, 20);
        }
    }

    #[test]
    fn without_trusted_odometry_the_answer_is_right_or_refused() {
        let options = Gnc { trust: Trust::Nothing, ..Gnc::default() };
        let mut refused = 0;
        for seed in 0..12 {
            let (clean, mut spoiled) = spoiled::<Se2, 3, 2>(seed, 0.1);
            let right = clean.edges.len();
            match gnc(&mut spoiled, &options) {
                Ok(found) => {
                    assert!((right..spoiled.edges.len()).all(|edge| !found.is_inlier(edge)));
                    let apart = distance(&spoiled.poses, &clean.poses);
                    assert!(apart < 1e-3, "{seed}: {apart}");
                }
                Err(Error::Undecided { .. }) => refused += 1,
                Err(other) => panic!("{seed}: {other}"),
            }
        }
        assert!(refused <= 3, "{refused}");
    }

    #[test]
    fn where_nothing_can_be_decided_that_is_said() {
        // Two edges say differently where the second pose is.
        let edge = |x: f64| Edge {
            from: 0,
            to: 1,
            measured: Se2::new(x, 0.0, 0.0),
            information: nalgebra::Matrix3::identity() * 100.0,
        };
        let poses = vec![Se2::identity(); 2];
        let edges = vec![edge(1.0), edge(-5.0)];
        let mut graph = PoseGraph { ids: vec![3, 4], poses, edges, fixed: vec![] };
        let options = Gnc { trust: Trust::Nothing, ..Gnc::default() };
        assert_eq!(gnc(&mut graph, &options), Err(Error::Undecided { id: 4 }));
        // The shorter one passes for odometry.
        let found = gnc(&mut graph, &Gnc::default()).unwrap();
        assert_eq!(found.weights, [1.0, 0.0]);
    }

    /// A closure is judged by what it says of poses that drifted, not by how far they are off.
    #[test]
    fn the_only_closure_of_a_long_way_is_kept_unless_it_is_impossible() {
        let mut random = Random::new(1000);
        let (side, noise) = (25, 0.01);
        let step = |k: usize| {
            let turn = if k % side == side - 1 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            Se2::new(1.0, 0.0, turn)
        };
        let information = nalgebra::Matrix3::identity() / (noise * noise);
        let edge = |from, to, measured| Edge { from, to, measured, information };
        let mut edges: Vec<_> = (0..4 * side - 1)
            .map(|k| edge(k, k + 1, step(k).retract(&random.tangent(noise))))
            .collect();
        let poses = vec![Se2::identity(); 4 * side];
        edges.push(edge(4 * side - 1, 0, step(4 * side - 1)));
        let ids = (0..4 * side as u64).collect();
        let mut ring = PoseGraph { ids, poses, edges, fixed: vec![] };
        // Composed odometry ends many standard deviations of one measurement away.
        ring.poses = odometry(&ring).unwrap();
        assert!(ring.chi2() > 1000.0, "{}", ring.chi2());
        let found = gnc(&mut ring.clone(), &Gnc::default()).unwrap();
        assert!(found.is_inlier(4 * side - 1) && found.odds[4 * side - 1] > 0.0, "{found:?}");
        let last = ring.edges.len() - 1;
        ring.edges[last].measured = Se2::new(40.0, 0.0, 3.0);
        assert!(!gnc(&mut ring, &Gnc::default()).unwrap().is_inlier(last));
    }

    #[test]
    fn false_closures_between_poses_that_follow_each_other_are_none_of_odometry() {
        let (clean, mut spoiled) = spoiled::<Se2, 3, 2>(1001, 0.1);
        let right = clean.edges.len();
        let measured = Se2::new(5.0, 4.0, 2.0);
        let wrong = Edge { from: 11, to: 10, measured, ..clean.edges[0].clone() };
        spoiled.edges.insert(0, wrong);
        let found = gnc(&mut spoiled, &Gnc::default()).unwrap();
        assert!(!found.is_inlier(0) && (1..=right).all(|edge| found.is_inlier(edge)));
        assert!(distance(&spoiled.poses, &clean.poses) < 1e-12);
    }

    /// Edges that alone say where their poses are: nothing can contradict them, whatever is no odometry by its ids.
    #[test]
    fn the_only_measurement_of_a_pose_is_kept() {
        let edge = |to: usize, y: f64| Edge {
            from: 0,
            to,
            measured: Se2::new(1.0, y, 0.2),
            information: nalgebra::Matrix3::identity() * 100.0,
        };
        let poses = vec![Se2::identity(); 4];
        let edges = vec![edge(1, 0.0), edge(2, 3.0), edge(3, -4.0)];
        let star = PoseGraph { ids: (0..4).collect(), poses, edges, fixed: vec![] };
        for trust in [Trust::Odometry, Trust::Nothing] {
            let mut star = star.clone();
            let found = gnc(&mut star, &Gnc { trust, ..Gnc::default() }).unwrap();
            assert_eq!(found.weights, [1.0; 3]);
            assert!(star.chi2() < 1e-12);
        }
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
