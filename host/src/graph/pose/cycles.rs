//! Which loop closures agree with others nearby: evidence from short cycles, before anything is solved.
//!
//! A robot that returns to a place usually sees it for a while: closures come side by side. Two of them and
//! the odometry between their ends make a cycle, which closes up to noise where both are right and
//! hardly ever where one is random (as in Latif, Cadena & Neira 2013). How much an agreement says is
//! weighed against chance: cycles with long odometry close loosely and say little.

use std::collections::HashMap;

use nalgebra::SVector;

use super::chordal::harmonic_mean;
use super::rigid::Rigid;
use super::{Edge, PoseGraph};

/// Cycles may have this many steps of odometry at each end.
const REACH: usize = 12;

/// Neighbours asked at most for each closure.
const NEIGHBOURS: usize = 24;

/// Log odds from which a closure counts as supported: a chance of about 1 in 150.
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
        let mut at = (G::identity(), 0, 0.0, 0.0, 0.0);
        for step in steps {
            match step {
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

/// Which edges that are not trusted agree with another one nearby or, over few steps, with the
/// odometry itself. `rank` is each pose's place in the order of time. One entry per edge, false for trusted ones.
pub(super) fn supported<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    rank: &[usize],
    trusted: &[bool],
) -> Vec<bool> {
    let chain = Chain::new(graph, rank, trusted);
    // Every closure as from the earlier to the later pose.
    let mut closures = Vec::new();
    for (index, edge) in graph.edges.iter().enumerate().filter(|(index, _)| !trusted[*index]) {
        let (from, to) = (rank[edge.from], rank[edge.to]);
        let forward = from < to;
        let measured = if forward { edge.measured } else { edge.measured.inverse() };
        closures.push((index, from.min(to), from.max(to), measured, doubt(edge)));
    }
    let extent = closures.iter().map(|closure| closure.4.length).fold(0.0, f64::max);
    let chance = Chance::new::<D, N>(extent);

    let mut cells: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
    for (at, closure) in closures.iter().enumerate() {
        cells.entry((closure.1 / REACH, closure.2 / REACH)).or_default().push(at);
    }
    let mut supported = vec![false; graph.edges.len()];
    for (at, &(index, from, to, measured, own)) in closures.iter().enumerate() {
        let direct = (to - from <= REACH).then(|| chain.way(from, to)).flatten();
        if let Some((way, doubt)) = direct {
            let error = G::error(&G::identity(), &way, &measured);
            if chance.odds::<D, N>(&error, &[own, doubt]) > ODDS {
                supported[index] = true;
                continue;
            }
        }
        let (row, column) = (from / REACH, to / REACH);
        let rows = row.saturating_sub(1)..=row + 1;
        let around = rows.flat_map(|row| {
            (column.saturating_sub(1)..=column + 1).map(move |column| (row, column))
        });
        let near = around.filter_map(|cell| cells.get(&cell)).flatten();
        let near = near.filter(|&&other| {
            let (_, start, end, ..) = closures[other];
            other != at && start.abs_diff(from) + end.abs_diff(to) <= REACH
        });
        supported[index] = near.take(NEIGHBOURS).any(|&other| {
            let (_, start, end, between, doubt) = closures[other];
            let ways = chain.way(from, start).zip(chain.way(end, to));
            ways.is_some_and(|((before, first), (after, last))| {
                let around = before.compose(&between).compose(&after);
                let error = G::error(&G::identity(), &around, &measured);
                chance.odds::<D, N>(&error, &[own, first, doubt, last]) > ODDS
            })
        });
    }
    supported
}

/// What random closures look like: anywhere in a ball, any rotation.
struct Chance {
    log_density: f64,
}

impl Chance {
    fn new<const D: usize, const N: usize>(extent: f64) -> Self {
        use std::f64::consts::PI;
        let extent = extent.max(1e-9);
        // Volumes of the ball and of all rotations; in space in coordinates of half the angle.
        let volume = if N == 2 {
            PI * extent.powi(2) * 2.0 * PI
        } else {
            4.0 / 3.0 * PI * extent.powi(3) * PI.powi(2)
        };
        Chance { log_density: -volume.ln() }
    }

    /// How much more probable an error is for a cycle of right measurements than by chance: log of the
    /// ratio of densities.
    fn odds<const D: usize, const N: usize>(
        &self,
        error: &SVector<f64, D>,
        cycle: &[Doubt],
    ) -> f64 {
        let length: f64 = cycle.iter().map(|part| part.length).sum();
        // In space the error's coordinates are half the angle that a lever turns by.
        let turn = if N == 2 { 1.0 } else { 4.0 };
        let rotation: f64 = cycle.iter().map(|part| part.rotation).sum();
        let lever: f64 = cycle.iter().map(|part| part.rotation * (length - part.length)).sum();
        let translation: f64 = cycle.iter().map(|part| part.translation).sum();
        let translation = translation + turn * lever * length / 4.0;
        let t: f64 = error.rows(0, N).norm_squared();
        let r: f64 = error.rows(N, D - N).norm_squared();
        let log = |variance: f64| (2.0 * std::f64::consts::PI * variance).ln();
        let normal = -0.5 * (t / translation + r / rotation)
            - 0.5 * (N as f64 * log(translation) + (D - N) as f64 * log(rotation));
        let odds = normal - self.log_density;
        if odds.is_nan() { f64::NEG_INFINITY } else { odds }
    }
}
