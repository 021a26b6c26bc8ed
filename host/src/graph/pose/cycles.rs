//! Which loop closures agree with others nearby: evidence from short cycles, before anything is solved.
//!
//! A robot that returns to a place usually sees it for a while: closures come side by side. Two of them and
//! the odometry between their ends make a cycle, which closes up to noise where both are right and
//! hardly ever where one is random (as in Latif, Cadena & Neira 2013). How much an agreement says is
//! weighed against chance: cycles with long odometry close loosely and say little.
//!
//! A robot that takes one place for another does so for a while, too: agreement within one look is no evidence
//! that it is right. It says what is right or wrong together; the evidence is agreement with odometry alone
//! or with closures of another look.

use std::collections::{BTreeMap, HashMap};

use nalgebra::SVector;

use super::chordal::harmonic_mean;
use super::evidence::Chance;
use super::odometry::Sets;
use super::rigid::Rigid;
use super::{Edge, PoseGraph};

/// Cycles looked at for each closure: with its nearest neighbours outside of its look,
const NEIGHBOURS: usize = 16;

/// and in it.
const MATES: usize = 8;

/// Steps at both ends together within which two closures are one look: a robot that takes one place for
/// another does so as long as it sees it, and the closures of that time agree whether they are right or
/// not.
const LOOKS: [usize; 5] = [16, 8, 4, 2, 0];

/// A shorter look is assumed where the longer one leaves fewer than one in so many of the closures that agree
/// with any other: where odometry is too poor to compare what lies farther apart, there is
/// nothing else to begin with.
const FEW: usize = 8;

/// Of these, the nearest ones that tell how large errors are.
const NEAREST: usize = 2;

/// Log odds from which a closure counts as supported whatever the number of cycles: a chance of about
/// 1 in 150. Where there are more cycles, none is expected to close so well by chance.
const ODDS: f64 = 5.0;

/// Odometry composed along the order of the poses.
struct Chain<G> {
    poses: Vec<G>,
    /// Along the chain to each pose: number of steps that are missing, variances of translation and
    /// rotation, length of the way. The last three are sums up to there.
    missing: Vec<usize>,
    translation: Vec<f64>,
    rotation: Vec<f64>,
    length: Vec<f64>,
}

/// How uncertain a way is: variances per axis of translation (m²) and rotation (of the error's
/// coordinates), and its length in metres.
#[derive(Clone, Copy)]
struct Doubt {
    translation: f64,
    rotation: f64,
    length: f64,
}

/// Variance of a turn from which on nothing is known of it, rad²; and how many times as large as the least a
/// variance may be in a sum.
const UNTURNED: f64 = 10.0;
const DROWNS: f64 = 1e9;

impl<G> Chain<G> {
    fn new<const D: usize, const N: usize>(
        graph: &PoseGraph<G, D>,
        rank: &[usize],
        trusted: &[bool],
    ) -> Self
    where
        G: Rigid<D, N>,
    {
        let count = graph.poses.len();
        let mut steps: Vec<Option<(&Edge<G, D>, bool)>> = vec![None; count];
        for (edge, _) in graph.edges.iter().zip(trusted).filter(|(_, trusted)| **trusted) {
            let (a, b) = (rank[edge.from], rank[edge.to]);
            if a.abs_diff(b) == 1 {
                steps[a.max(b)].get_or_insert((edge, b > a));
            }
        }
        let mut chain = Chain {
            poses: Vec::with_capacity(count),
            missing: Vec::with_capacity(count),
            translation: Vec::with_capacity(count),
            rotation: Vec::with_capacity(count),
            length: Vec::with_capacity(count),
        };
        let least = steps.iter().flatten().map(|(edge, _)| doubt(edge).translation);
        let least = least.fold(f64::INFINITY, f64::min);
        // A step that says next to nothing would drown all others in the sums.
        let says = |edge: &Edge<G, D>| {
            let Doubt { translation, rotation, .. } = doubt(edge);
            rotation < UNTURNED && translation <= DROWNS * least && translation.is_finite()
        };
        let mut at = (G::identity(), 0, 0.0, 0.0, 0.0);
        for step in steps {
            match step.filter(|(edge, _)| says(edge)) {
                Some((edge, forward)) => {
                    let step = if forward { edge.measured } else { edge.measured.inverse() };
                    let doubt = doubt(edge);
                    at.0 = at.0.compose(&step);
                    at.2 += doubt.translation;
                    at.3 += doubt.rotation;
                    at.4 += step.translation_vector().norm();
                }
                None => at.1 += 1,
            }
            chain.poses.push(at.0);
            chain.missing.push(at.1);
            chain.translation.push(at.2);
            chain.rotation.push(at.3);
            chain.length.push(at.4);
        }
        chain
    }

    /// The way between two ranks, if no step is missing.
    fn way<const D: usize, const N: usize>(&self, from: usize, to: usize) -> Option<(G, Doubt)>
    where
        G: Rigid<D, N>,
    {
        if self.missing[from] != self.missing[to] {
            return None;
        }
        let doubt = Doubt {
            translation: (self.translation[from] - self.translation[to]).abs(),
            rotation: (self.rotation[from] - self.rotation[to]).abs(),
            length: (self.length[from] - self.length[to]).abs(),
        };
        Some((self.poses[from].between(&self.poses[to]), doubt))
    }
}

/// Of one measurement: mean variances.
fn doubt<G: Rigid<D, N>, const D: usize, const N: usize>(edge: &Edge<G, D>) -> Doubt {
    let variance =
        |information: f64| if information > 0.0 { 1.0 / information } else { f64::INFINITY };
    Doubt {
        translation: variance(harmonic_mean(&edge.information, 0, N)),
        rotation: variance(harmonic_mean(&edge.information, N, D - N)),
        length: edge.measured.translation_vector().norm(),
    }
}

/// Agreement of short cycles.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Support {
    /// Which edges belong to a cycle that closes better than by chance, with odometry alone or with
    /// a closure of another look.
    pub edges: Vec<bool>,
    /// For every edge those of its look that it agrees with: they are right or wrong together.
    pub mates: Vec<Vec<usize>>,
    /// Variance of errors in units of what information claims, as the cycles show it.
    pub variance: f64,
}

/// A cycle's error.
#[derive(Clone, Copy)]
struct Closing {
    /// The edges it is evidence for.
    edges: [usize; 2],
    /// Squared, of translation and rotation.
    squared: [f64; 2],
    /// Variances per axis of the same, as claimed.
    claimed: [f64; 2],
    /// Steps between them at both ends together; none where the cycle is of odometry alone.
    apart: usize,
}

impl Closing {
    fn new<const D: usize, const N: usize>(
        edges: [usize; 2],
        error: &SVector<f64, D>,
        cycle: &[Doubt],
    ) -> Self {
        let length: f64 = cycle.iter().map(|part| part.length).sum();
        // In space the error's coordinates are half the angle that a lever turns by.
        let turn = if N == 2 { 1.0 } else { 4.0 };
        let rotation: f64 = cycle.iter().map(|part| part.rotation).sum();
        let lever: f64 = cycle.iter().map(|part| part.rotation * (length - part.length)).sum();
        let translation: f64 = cycle.iter().map(|part| part.translation).sum();
        let translation = translation + turn * lever * length / 4.0;
        let squared = [error.rows(0, N).norm_squared(), error.rows(N, D - N).norm_squared()];
        Closing { edges, squared, claimed: [translation, rotation], apart: usize::MAX }
    }
}

/// The variance under which cycles, half of them random, are the most probable.
fn variance<const D: usize, const N: usize>(chance: &Chance, cycles: &[Closing]) -> f64 {
    let log_likelihood = |variance: f64| -> f64 {
        // That information is right within some powers of ten needs no proof.
        let prior = -0.5 * (variance.ln() / 10f64.ln()).powi(2);
        let of = |cycle: &Closing| {
            let odds = chance.isotropic::<D, N>(cycle.squared, cycle.claimed, variance);
            // ln(1 + e^odds)
            odds.max(0.0) + (-odds.abs()).exp().ln_1p()
        };
        prior + cycles.iter().map(of).sum::<f64>()
    };
    let steps = (-9..=4).map(|power| 4f64.powi(power));
    let tried = steps.map(|variance| (variance, log_likelihood(variance)));
    let best = tried.max_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|best| best.1 > log_likelihood(1.0)).map_or(1.0, |best| best.0)
}

/// What the cycles say.
fn conclude<const D: usize, const N: usize>(
    edges: usize,
    chance: &Chance,
    near: &[Closing],
    all: &[Closing],
) -> Support {
    let variance = variance::<D, N>(chance, near);
    let least = ODDS.max((all.len() as f64).ln());
    let odds: Vec<f64> = all
        .iter()
        .map(|cycle| chance.isotropic::<D, N>(cycle.squared, cycle.claimed, variance))
        .collect();
    let agreeing = |least: f64| {
        let pairs = all.iter().zip(&odds).filter(move |(_, odds)| **odds > least);
        pairs.map(|(cycle, _)| (cycle.edges, cycle.apart))
    };
    let support_with = |look: usize| support(edges, agreeing(least), look);
    let count = |edges: &[bool]| edges.iter().filter(|&&edge| edge).count();
    let [longest, shorter @ ..] = LOOKS;
    let (mut look, mut supported) = (longest, support_with(longest));
    let most = count(&support_with(0));
    for shorter in shorter {
        if FEW * count(&supported) >= most {
            break;
        }
        (look, supported) = (shorter, support_with(shorter));
    }
    let mut mates = vec![Vec::new(); edges];
    for ([edge, other], _) in agreeing(ODDS).filter(|(_, apart)| *apart <= look) {
        mates[edge].push(other);
        mates[other].push(edge);
    }
    for mates in &mut mates {
        mates.sort_unstable();
        mates.dedup();
    }
    Support { edges: supported, mates, variance }
}

/// Which edges agree with odometry or with one of another look, by themselves or through those of their own.
fn support(
    edges: usize,
    agreeing: impl Iterator<Item = ([usize; 2], usize)>,
    look: usize,
) -> Vec<bool> {
    let mut from_outside = vec![false; edges];
    let mut sure = Sets::new(edges);
    for ([edge, other], apart) in agreeing {
        if apart <= look {
            sure.join(edge, other);
        } else {
            (from_outside[edge], from_outside[other]) = (true, true);
        }
    }
    let mut supported = vec![false; edges];
    (0..edges)
        .filter(|&edge| from_outside[edge])
        .for_each(|edge| supported[sure.root(edge)] = true);
    (0..edges).map(|edge| supported[sure.root(edge)]).collect()
}

/// Which edges that are not trusted agree with another one nearby or, over few steps, with the
/// odometry itself. `rank` is each pose's place in the order of time.
pub(super) fn supported<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    rank: &[usize],
    trusted: &[bool],
    chance: &Chance,
) -> Support {
    let chain = Chain::new(graph, rank, trusted);
    // Every closure as from the earlier to the later pose.
    let mut closures = Vec::new();
    for (index, edge) in graph.edges.iter().enumerate().filter(|(index, _)| !trusted[*index]) {
        let (from, to) = (rank[edge.from], rank[edge.to]);
        let forward = from < to;
        let measured = if forward { edge.measured } else { edge.measured.inverse() };
        closures.push((index, from.min(to), from.max(to), measured, doubt(edge)));
    }
    // So wide that the cells around a closure would hold some neighbours if all were spread evenly.
    let even = (NEIGHBOURS as f64 / (18.0 * closures.len().max(1) as f64)).sqrt();
    let width = ((even * graph.poses.len() as f64) as usize).max(NEIGHBOURS);
    let mut cells: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
    for (at, closure) in closures.iter().enumerate() {
        cells.entry((closure.1 / width, closure.2 / width)).or_default().push(at);
    }
    let (mut near, mut all) = (Vec::new(), Vec::new());
    let mut around = Vec::new();
    for (at, &(index, from, to, measured, own)) in closures.iter().enumerate() {
        if let Some((way, doubt)) = chain.way(from, to) {
            let error = G::error(&G::identity(), &way, &measured);
            all.push(Closing::new::<D, N>([index; 2], &error, &[own, doubt]));
        }
        let (row, column) = (from / width, to / width);
        around.clear();
        for row in row.saturating_sub(1)..=row + 1 {
            for column in column.saturating_sub(1)..=column + 1 {
                let others = cells.get(&(row, column)).into_iter().flatten();
                around.extend(others.filter(|&&other| other != at).map(|&other| {
                    let (_, start, end, ..) = closures[other];
                    (start.abs_diff(from) + end.abs_diff(to), other)
                }));
            }
        }
        around.sort_unstable();
        let within = around.partition_point(|&(apart, _)| apart <= LOOKS[0]);
        let (look, others) = around.split_at(within);
        let mut told = 0;
        for &(apart, other) in look.iter().take(MATES).chain(others.iter().take(NEIGHBOURS)) {
            let (second, start, end, between, doubt) = closures[other];
            let ways = chain.way(from, start).zip(chain.way(end, to));
            let Some(((before, first), (after, last))) = ways else { continue };
            let around = before.compose(&between).compose(&after);
            let error = G::error(&G::identity(), &around, &measured);
            let parts = [own, first, doubt, last];
            let cycle = Closing { apart, ..Closing::new::<D, N>([index, second], &error, &parts) };
            if told < NEAREST {
                near.push(cycle);
                told += 1;
            }
            // From the other's side it may be seen again: that changes nothing.
            all.push(cycle);
        }
    }
    conclude::<D, N>(graph.edges.len(), chance, &near, &all)
}

/// Which edges belong to cycles of at most four that close, when no odometry is known.
pub(super) fn agreeing<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    chance: &Chance,
) -> Support {
    // Motions to the neighbours of each pose, with the edge that measures it.
    let mut ways: Vec<Vec<(usize, usize, G)>> = vec![Vec::new(); graph.poses.len()];
    let mut between: BTreeMap<(usize, usize), Vec<(usize, G)>> = BTreeMap::new();
    for (index, edge) in graph.edges.iter().enumerate() {
        let back = edge.measured.inverse();
        ways[edge.from].push((index, edge.to, edge.measured));
        ways[edge.to].push((index, edge.from, back));
        between.entry((edge.from, edge.to)).or_default().push((index, edge.measured));
        between.entry((edge.to, edge.from)).or_default().push((index, back));
    }
    let mut all = Vec::new();
    for (index, edge) in graph.edges.iter().enumerate() {
        let own = doubt(edge);
        let mut close = |path: &[usize], way: G| {
            let error = G::error(&G::identity(), &way, &edge.measured);
            let mut cycle = vec![own];
            cycle.extend(path.iter().map(|&edge| doubt(&graph.edges[edge])));
            for &other in path {
                all.push(Closing::new::<D, N>([index, other], &error, &cycle));
            }
        };
        for (direct, way) in between.get(&(edge.from, edge.to)).into_iter().flatten() {
            if *direct != index {
                close(&[*direct], *way);
            }
        }
        for (first, a, before) in ways[edge.from].iter().take(NEIGHBOURS) {
            if *first == index {
                continue;
            }
            for (second, after) in between.get(&(*a, edge.to)).into_iter().flatten() {
                if *second != index && second != first {
                    close(&[*first, *second], before.compose(after));
                }
            }
            for (last, b, back) in ways[edge.to].iter().take(NEIGHBOURS) {
                if *last == index || last == first || b == a || *b == edge.from || *a == edge.to {
                    continue;
                }
                for (middle, way) in between.get(&(*a, *b)).into_iter().flatten() {
                    let around = before.compose(way).compose(&back.inverse());
                    close(&[*first, *middle, *last], around);
                }
            }
        }
    }
    conclude::<D, N>(graph.edges.len(), chance, &all, &all)
}

#[cfg(test)]
mod tests {
    use super::super::odometry::{odometry_edges, ranks};
    use super::super::{Group, Se2};
    use super::*;

    const STEPS: usize = 60;

    /// Rounds of a square of four times fifteen metres with exact odometry, and closures between these steps of the
    /// first and second round, displaced by so many metres.
    fn rounds(closures: &[(usize, usize, f64)]) -> (PoseGraph<Se2, 3>, Vec<bool>) {
        let step = |k: usize| {
            let turn = if k % 15 == 14 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            Se2::new(1.0, 0.0, turn)
        };
        let information = nalgebra::Matrix3::identity() * 1e4;
        let edge = |from, to, measured| Edge { from, to, measured, information };
        let mut edges: Vec<_> = (1..2 * STEPS).map(|k| edge(k - 1, k, step(k - 1))).collect();
        for &(from, to, off) in closures {
            let way = (from..STEPS + to).fold(Se2::identity(), |pose, k| pose.compose(&step(k)));
            edges.push(edge(from, STEPS + to, Se2::new(off, 0.0, 0.0).compose(&way)));
        }
        let poses = vec![Se2::identity(); 2 * STEPS];
        let graph = PoseGraph { ids: (0..2 * STEPS as u64).collect(), poses, edges, fixed: vec![] };
        let trusted = odometry_edges(&graph);
        (graph, trusted)
    }

    fn supports(closures: &[(usize, usize, f64)]) -> Support {
        let (graph, trusted) = rounds(closures);
        let chance = Chance::new::<3, 2>(15.0);
        let Support { edges, mates, variance } =
            supported(&graph, &ranks(&graph), &trusted, &chance);
        let own = 2 * STEPS - 1;
        let mates = mates[own..].iter().map(|mates| mates.iter().map(|m| m - own).collect());
        Support { edges: edges[own..].to_vec(), mates: mates.collect(), variance }
    }

    #[test]
    fn one_look_does_not_support_itself_and_others_do() {
        // Two looks that are right, and one that is off by five metres.
        let right = [(0, 0, 0.0), (1, 1, 0.0), (30, 30, 0.0), (31, 31, 0.0)];
        let wrong = [(45, 20, 5.0), (46, 21, 5.0), (47, 22, 5.0)];
        let found = supports(&[&right[..], &wrong[..]].concat());
        assert_eq!(found.edges, [true, true, true, true, false, false, false]);
        let mates: Vec<Vec<usize>> =
            vec![vec![1], vec![0], vec![3], vec![2], vec![5, 6], vec![4, 6], vec![4, 5]];
        assert_eq!(found.mates, mates);
    }

    #[test]
    fn a_step_that_says_nothing_takes_no_support_from_those_after_it() {
        let closures = [(30, 30, 0.0), (31, 31, 0.0), (50, 50, 0.0), (51, 51, 0.0)];
        let chance = Chance::new::<3, 2>(15.0);
        let unturned = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(1e4, 1e4, 0.0));
        for weak in [nalgebra::Matrix3::identity() * 1e-12, unturned] {
            let (mut graph, trusted) = rounds(&closures);
            graph.edges[5].information = weak;
            let found = supported(&graph, &ranks(&graph), &trusted, &chance);
            assert_eq!(found.edges[2 * STEPS - 1..], [true; 4]);
        }
    }

    #[test]
    fn a_closure_that_disagrees_with_its_look_is_no_mate() {
        let closures = [(0, 0, 0.0), (1, 1, 0.0), (2, 2, 7.0), (30, 30, 0.0), (31, 31, 0.0)];
        let found = supports(&closures);
        assert_eq!(found.edges, [true, true, false, true, true]);
        assert!(found.mates[2].is_empty() && found.mates[0] == [1]);
    }

    #[test]
    fn support_is_shared_within_a_look() {
        let pairs = [([0, 1], 2), ([1, 2], 4), ([2, 5], 30), ([3, 4], 2)];
        let within = |look: usize| support(6, pairs.into_iter(), look);
        assert_eq!(within(16), [true, true, true, false, false, true]);
        // What is farther apart than a look is another one.
        assert_eq!(within(3), [true, true, true, false, false, true]);
        assert_eq!(within(0), [true; 6]);
        assert_eq!(within(30), [false; 6]);
        // With odometry alone.
        assert_eq!(support(2, [([1, 1], usize::MAX)].into_iter(), 16), [false, true]);
    }

    #[test]
    fn nothing_supports_what_is_alone_or_not_there() {
        assert_eq!(supports(&[(10, 40, 6.0)]).edges, [false]);
        let none = supports(&[]);
        assert!(none.edges.is_empty() && none.mates.is_empty() && none.variance == 1.0);
    }
}
