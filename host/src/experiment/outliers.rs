//! False loop closures on the standard pose graphs: is the solution without them found again?
//!
//! A false closure joins two uniformly random poses, says that one is uniformly anywhere in a ball around
//! the other whose radius is half the diagonal of the map, turned uniformly, and claims the
//! information of one of the graph's own closures. Grouped ones are harder: five in a row that agree with
//! each other, as where one corridor looks like another.
//!
//! What is found is compared with the optimum of the graph before it was spoiled. Both hold the
//! same pose, and how far positions may be apart is measured by how uncertain that optimum is anyway: the root
//! mean square of its posterior standard deviations, with information scaled by what χ² shows. 10 %
//! of it adds 0.5 % to the error that the clean solution has.

use std::fmt;
use std::path::Path;
use std::time::Instant;

use nalgebra::SVector;
use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;

use super::pose_graphs::{Error, files, name};
use crate::experiment::Spread;
use crate::graph::pose::g2o::{self, Graph};
use crate::graph::pose::global::optimize_globally;
use crate::graph::pose::gnc::{Gnc, gnc};
use crate::graph::pose::odometry::odometry_edges;
use crate::graph::pose::{self, Edge, Group, Options, PoseGraph, Rigid, Start, marginals};

/// Which false closures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Each by itself.
    Random,
    /// Five in a row that agree.
    Grouped,
}

/// False closures in a group.
const GROUP: usize = 5;

/// Shares of false closures in all closures, percent.
const SHARES: [(Kind, u32); 5] = [
    (Kind::Random, 10),
    (Kind::Random, 30),
    (Kind::Random, 50),
    (Kind::Grouped, 10),
    (Kind::Grouped, 30),
];

/// Times are compared with that of the clean solution, the median of at most this many runs in at most
/// so many seconds.
const CLEAN_RUNS: usize = 5;
const CLEAN_SECONDS: f64 = 0.2;

/// The distance that counts as found again, in posterior standard deviations.
const NEAR: f64 = 0.1;

/// One graph with one share of false closures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of its file.
    pub graph: String,
    /// What was added.
    pub kind: Kind,
    /// Percent of all closures that are false.
    pub share: u32,
    /// Right closures.
    pub right: usize,
    /// False closures.
    pub wrong: usize,
    /// Right ones among those kept.
    pub precision: Spread,
    /// Kept ones among those that are right.
    pub recall: Spread,
    /// Root mean square distance of positions from the clean optimum, metres.
    pub rmse: Spread,
    /// The same in posterior standard deviations of the clean optimum.
    pub relative: Spread,
    /// χ² of all right edges by that of the clean optimum.
    pub chi2: Spread,
    /// Seconds by those of the clean graph's solution.
    pub time: Spread,
    /// Runs with a distance of at most a tenth of a posterior standard deviation.
    pub found: usize,
    /// Runs that ended in an error; in the other columns these are left out.
    pub failed: usize,
    /// All runs.
    pub runs: u64,
}

/// All of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// In order of the graphs' names.
    pub rows: Vec<Row>,
}

/// The heading of the rows.
pub fn heading() -> String {
    format!(
        "{:<24}{:<9}{:>4}{:>7}{:>7}  {:<10}{:<10}{:<10}{:<12}{:<10}{:<18}{:<8}",
        "graph",
        "kind",
        "%",
        "right",
        "false",
        "precision",
        "recall",
        "RMSE (m)",
        "RMSE/std",
        "χ²/clean",
        "time/clean",
        "within 10 %"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            Kind::Random => "random",
            Kind::Grouped => "grouped",
        };
        let time = format!("{:.1} [{:.1}, {:.1}]", self.time.median, self.time.low, self.time.high);
        let failed = match self.failed {
            0 => String::new(),
            failed => format!(", {failed} errors"),
        };
        let well = format!("{}/{}{failed}", self.found, self.runs);
        write!(
            f,
            "{:<24}{:<9}{:>4}{:>7}{:>7}  {:<10.4}{:<10.4}{:<10.1e}{:<12.1e}{:<10.5}{:<18}{}",
            self.graph,
            kind,
            self.share,
            self.right,
            self.wrong,
            self.precision.median,
            self.recall.median,
            self.rmse.median,
            self.relative.median,
            self.chi2.median,
            time,
            well
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Pose graphs with false loop closures, odometry trusted; medians, one thread")?;
        writeln!(f, "{}", heading())?;
        self.rows.iter().try_for_each(|row| writeln!(f, "{row}"))?;
        write!(
            f,
            "%: false among all closures; RMSE: of positions from the clean optimum; std: its posterior \
             standard deviation; χ²: of all right edges; time/clean: [quartiles]; within 10 %: runs \
             with RMSE/std ≤ {NEAR}"
        )
    }
}

/// Spoils every graph in `data`/g2o whose name contains one of `wanted` (all without any) once for each
/// of `seeds` and every share of false closures, or only `share` percent of them; `watch` sees the rows
/// as they are done. A graph with so few closures that the share is not one has no row.
///
/// # Errors
/// Without graphs, or when one cannot be read, or not be optimised before it is spoiled.
pub fn run(
    data: Option<&Path>,
    wanted: &[String],
    share: Option<u32>,
    seeds: std::ops::Range<u64>,
    mut watch: impl FnMut(&Row),
) -> Result<Table, Error> {
    let mut rows = Vec::new();
    let shares = match share {
        Some(share) => vec![(Kind::Random, share), (Kind::Grouped, share)],
        None => SHARES.to_vec(),
    };
    for file in files(data, wanted)? {
        let read = g2o::read(&file)?;
        for &(kind, share) in &shares {
            let row = match &read.graph {
                Graph::Planar(graph) => row(graph, read.has_poses, kind, share, seeds.clone()),
                Graph::Spatial(graph) => row(graph, read.has_poses, kind, share, seeds.clone()),
            };
            let row = row.map_err(|source| Error::Graph { file: file.clone(), source })?;
            if let Some(row) = row {
                let row = Row { graph: name(&file), ..row };
                watch(&row);
                rows.push(row);
            }
        }
    }
    Ok(Table { rows })
}

/// What one run gave.
struct Outcome {
    precision: f64,
    recall: f64,
    rmse: f64,
    chi2: f64,
    time: f64,
}

fn row<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    has_poses: bool,
    kind: Kind,
    share: u32,
    seeds: std::ops::Range<u64>,
) -> Result<Option<Row>, pose::Error> {
    let mut given = graph.clone();
    if !has_poses {
        Start::Odometry.place(&mut given)?;
    }
    let mut clean = given.clone();
    optimize_globally(&mut clean, &Options::default(), &mut |_| ())?;
    let odometry = odometry_edges(&clean);
    let right = odometry.iter().filter(|odometry| !**odometry).count();
    let share_of_all = f64::from(share) / 100.0;
    let mut wrong = (right as f64 * share_of_all / (1.0 - share_of_all)).round() as usize;
    if kind == Kind::Grouped {
        wrong = wrong.next_multiple_of(GROUP) * usize::from(wrong > 0);
    }
    if wrong == 0 || clean.poses.len() < 2 * GROUP {
        return Ok(None);
    }
    let uncertainty = uncertainty(&clean)?;
    let mut outcomes = Vec::new();
    let runs = seeds.end.saturating_sub(seeds.start);
    for seed in seeds {
        let plain = clean_seconds(&given)?;
        let mut spoiled = given.clone();
        spoiled.edges.extend(false_closures(&clean, &odometry, kind, wrong, seed));
        let clock = Instant::now();
        let Ok(found) = gnc(&mut spoiled, &Gnc::default()) else { continue };
        let time = clock.elapsed().as_secs_f64() / plain;
        let all = 0..given.edges.len();
        let closures = all.filter(|&edge| !odometry[edge]);
        let kept = closures.filter(|&edge| found.is_inlier(edge)).count() as f64;
        let false_ones = given.edges.len()..spoiled.edges.len();
        let false_kept = false_ones.filter(|&edge| found.is_inlier(edge)).count() as f64;
        spoiled.edges.truncate(given.edges.len());
        outcomes.push(Outcome {
            precision: if kept + false_kept > 0.0 { kept / (kept + false_kept) } else { 1.0 },
            recall: kept / right as f64,
            rmse: distance(&spoiled.poses, &clean.poses),
            chi2: spoiled.chi2() / clean.chi2(),
            time,
        });
    }
    let nothing = Spread { low: f64::NAN, median: f64::NAN, high: f64::NAN, count: 0 };
    let spread = |of: &dyn Fn(&Outcome) -> f64| {
        Spread::of(outcomes.iter().map(of).collect::<Vec<_>>()).unwrap_or(nothing)
    };
    Ok(Some(Row {
        graph: String::new(),
        kind,
        share,
        right,
        wrong,
        precision: spread(&|o| o.precision),
        recall: spread(&|o| o.recall),
        rmse: spread(&|o| o.rmse),
        relative: spread(&|o| o.rmse / uncertainty),
        chi2: spread(&|o| o.chi2),
        time: spread(&|o| o.time),
        found: outcomes.iter().filter(|o| o.rmse <= NEAR * uncertainty).count(),
        failed: (runs as usize).saturating_sub(outcomes.len()),
        runs,
    }))
}

/// How long the clean solution takes, beside every run, since other work on the machine comes and goes.
fn clean_seconds<G: Rigid<D, N>, const D: usize, const N: usize>(
    given: &PoseGraph<G, D>,
) -> Result<f64, pose::Error> {
    let mut seconds = Vec::new();
    while seconds.len() < CLEAN_RUNS && seconds.iter().sum::<f64>() < CLEAN_SECONDS {
        let mut again = given.clone();
        let clock = Instant::now();
        let found = optimize_globally(&mut again, &Options::default(), &mut |_| ())?;
        // Rejection certifies nothing.
        seconds.push((clock.elapsed() - found.certifying).as_secs_f64());
    }
    Ok(Spread::of(seconds).map_or(f64::NAN, |seconds| seconds.median))
}

/// Root mean square distance of positions, metres.
fn distance<G: Rigid<D, N>, const D: usize, const N: usize>(a: &[G], b: &[G]) -> f64 {
    let squared =
        |(a, b): (&G, &G)| (a.translation_vector() - b.translation_vector()).norm_squared();
    (a.iter().zip(b).map(squared).sum::<f64>() / a.len().max(1) as f64).sqrt()
}

/// Root mean square of the standard deviations of positions, metres, information scaled so that χ² is
/// what its degrees of freedom let expect.
fn uncertainty<G: Rigid<D, N>, const D: usize, const N: usize>(
    clean: &PoseGraph<G, D>,
) -> Result<f64, pose::Error> {
    let marginals = marginals(clean)?;
    let variance = |pose: usize| marginals.pose(pose).fixed_view::<N, N>(0, 0).trace();
    let mean = (0..clean.poses.len()).map(variance).sum::<f64>() / clean.poses.len() as f64;
    let degrees = D * (clean.edges.len() + 1).saturating_sub(clean.poses.len());
    Ok((mean * clean.chi2() / degrees.max(1) as f64).sqrt())
}

/// Random numbers of a seed.
struct Random(Xoshiro256PlusPlus);

impl Random {
    /// In (0, 1).
    fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count - 1)
    }

    /// Any rotation, and a place within `radius` metres, both uniform.
    fn anywhere<G: Group<D>, const D: usize>(&mut self, radius: f64) -> G {
        let (place, turn) = (G::DIMENSION, D - G::DIMENSION);
        let ball = |random: &mut Self, dimensions: usize| loop {
            let point: Vec<f64> = (0..dimensions).map(|_| 2.0 * random.uniform() - 1.0).collect();
            if point.iter().map(|x| x * x).sum::<f64>() <= 1.0 {
                break point;
            }
        };
        let mut tangent = SVector::<f64, D>::zeros();
        for (k, x) in ball(self, place).into_iter().enumerate() {
            tangent[k] = radius * x;
        }
        let moved = G::identity().retract(&tangent);
        let mut tangent = SVector::<f64, D>::zeros();
        if turn == 1 {
            tangent[place] = std::f64::consts::PI * (2.0 * self.uniform() - 1.0);
        } else {
            // Rotation vectors are uniform over rotations when accepted by sin²(θ/2) / (θ/2)².
            loop {
                let turn = ball(self, turn).into_iter().map(|x| std::f64::consts::PI * x);
                let turn: Vec<f64> = turn.collect();
                let half = 0.5 * turn.iter().map(|x| x * x).sum::<f64>().sqrt();
                if self.uniform() * half * half <= half.sin().powi(2) {
                    (0..turn.len()).for_each(|k| tangent[place + k] = turn[k]);
                    break;
                }
            }
        }
        moved.retract(&tangent)
    }
}

/// `count` false closures for a graph at its optimum.
fn false_closures<G: Rigid<D, N>, const D: usize, const N: usize>(
    clean: &PoseGraph<G, D>,
    odometry: &[bool],
    kind: Kind,
    count: usize,
    seed: u64,
) -> Vec<Edge<G, D>> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let closures: Vec<usize> = (0..odometry.len()).filter(|&edge| !odometry[edge]).collect();
    let (mut low, mut high) = (SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros());
    for (k, pose) in clean.poses.iter().enumerate() {
        let place = pose.translation_vector();
        (low, high) = if k == 0 { (place, place) } else { (low.inf(&place), high.sup(&place)) };
    }
    let radius = 0.5 * (high - low).norm();
    let mut order: Vec<usize> = (0..clean.poses.len()).collect();
    order.sort_by_key(|&pose| clean.ids[pose]);
    let poses = &clean.poses;
    let size = if kind == Kind::Grouped { GROUP } else { 1 };
    let mut edges = Vec::with_capacity(count);
    while edges.len() < count {
        let (a, b) = (random.below(order.len()), random.below(order.len()));
        if a == b || a.max(b) + size > order.len() {
            continue;
        }
        let motion: G = random.anywhere(radius);
        for step in 0..size {
            let (from, to) = (order[a + step], order[b + step]);
            let before = poses[from].between(&poses[order[a]]);
            let after = poses[order[b]].between(&poses[to]);
            let measured = before.compose(&motion).compose(&after);
            let information = clean.edges[closures[random.below(closures.len())]].information;
            edges.push(Edge { from, to, measured, information });
        }
    }
    edges.truncate(count);
    edges
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data;

    #[test]
    fn a_small_graph_is_found_again() {
        let data = data::folder();
        if data.as_ref().is_none_or(|d| !d.join("g2o").is_dir()) {
            eprintln!("skipped: no pose graphs");
            return;
        }
        let wanted = ["smallGrid3D".to_owned(), "tinyGrid3D".to_owned()];
        let mut seen = 0;
        let table = run(data.as_deref(), &wanted, None, 1000..1002, |_| seen += 1).unwrap();
        // The tiny one has three closures and too few poses.
        assert_eq!((table.rows.len(), seen), (SHARES.len(), SHARES.len()));
        for row in table.rows.iter().filter(|row| row.share < 50) {
            assert!(row.found == 2 && row.precision.median == 1.0, "{row}");
        }
        assert!(table.to_string().contains("smallGrid3D"));
        let one = run(data.as_deref(), &wanted, Some(20), 1000..1001, |_| ()).unwrap();
        let kinds = one.rows.iter().map(|row| (row.kind, row.share, row.wrong));
        assert!(kinds.eq([(Kind::Random, 20, 43), (Kind::Grouped, 20, 45)]), "{one}");
    }

    #[test]
    fn false_closures_are_spread_over_the_map() {
        let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(1000));
        let count = 4000;
        let (mut inside, mut turns) = (0, 0.0);
        for _ in 0..count {
            let motion: pose::Se3 = random.anywhere(2.0);
            let length = motion.translation.norm();
            assert!(length <= 2.0);
            inside += usize::from(length < 2.0 * 0.5f64.cbrt());
            turns += motion.rotation.angle();
        }
        let share = f64::from(inside as u32) / f64::from(count);
        assert!((share - 0.5).abs() < 0.03, "{share}");
        // The mean angle of uniform rotations is π/2 + 2/π.
        let expected = std::f64::consts::FRAC_PI_2 + std::f64::consts::FRAC_2_PI;
        assert!((turns / f64::from(count) - expected).abs() < 0.05, "{turns}");
    }
}
