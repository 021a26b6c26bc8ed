//! The standard pose graphs of the field: cost and time of the optimiser from the files' poses.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use crate::experiment::{Spread, forget_peak, peak_memory};
use crate::graph::pose::g2o::{self, G2oError, Graph};
use crate::graph::pose::global::optimize_globally;
use crate::graph::pose::{self, Options, PoseGraph, Rigid, Start};

/// Why the experiment could not run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The graphs are not part of the project.
    #[error("pose graphs not found: expected *.g2o in $TACTILE_DATA/g2o")]
    NoData,
    /// None is named as wanted.
    #[error("no pose graph in {} is called {wanted}", folder.display())]
    NoGraph {
        /// Where they are.
        folder: PathBuf,
        /// What was asked for.
        wanted: String,
    },
    /// A graph cannot be read.
    #[error(transparent)]
    File(#[from] G2oError),
    /// A graph cannot be optimised.
    #[error("{}: {source}", file.display())]
    Graph {
        /// Which.
        file: PathBuf,
        /// Why.
        source: pose::Error,
    },
}

/// One graph.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of its file.
    pub graph: String,
    /// 2 or 3.
    pub dimension: usize,
    /// How many poses.
    pub poses: usize,
    /// How many measurements.
    pub edges: usize,
    /// Σ eᵀ Ω e at the file's poses; `None` where it has none.
    pub initial_chi2: Option<f64>,
    /// Where the descent started.
    pub start: &'static str,
    /// Σ eᵀ Ω e at the end.
    pub final_chi2: f64,
    /// The lowest that is known, beside the graphs in optima.json.
    pub best_known: Option<f64>,
    /// Steps of the descent.
    pub iterations: usize,
    /// Whether no poses have a lower cost, for certain.
    pub certified: bool,
    /// Seconds from the file's poses to the end.
    pub seconds: Spread,
    /// Seconds for certificates.
    pub certificate_seconds: f64,
    /// The most bytes that the process held, of this graph from reading it on; `None` where the
    /// system does not say.
    pub peak_memory: Option<u64>,
}

/// All of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// In order of their names.
    pub rows: Vec<Row>,
}

/// The heading of the rows.
pub fn heading() -> String {
    format!(
        "{:<26}{:>3}{:>8}{:>8}{:>16}{:>17}{:>17}{:>6}  {:<24}{:<10}{:<16}{:>6}",
        "graph",
        "D",
        "poses",
        "edges",
        "initial χ²",
        "final χ²",
        "best known",
        "steps",
        "ms",
        "start",
        "certified (ms)",
        "MB"
    )
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |x: Option<f64>| x.map_or("–".into(), |x| format!("{x:.6}"));
        let ms = |s: f64| format!("{:.1}", 1e3 * s);
        let Spread { low, median, high, .. } = self.seconds;
        write!(
            f,
            "{:<26}{:>3}{:>8}{:>8}{:>16}{:>17}{:>17}{:>6}  {:<24}{:<10}{:<16}{:>6}",
            self.graph,
            self.dimension,
            self.poses,
            self.edges,
            self.initial_chi2.map_or("–".into(), |x| format!("{x:.1}")),
            number(Some(self.final_chi2)),
            number(self.best_known),
            self.iterations,
            format!("{} [{}, {}]", ms(median), ms(low), ms(high)),
            self.start,
            format!(
                "{} ({})",
                if self.certified { "yes" } else { "no" },
                ms(self.certificate_seconds)
            ),
            self.peak_memory.map_or("–".into(), |bytes| format!("{:.0}", bytes as f64 / 1e6)),
        )
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Pose graphs from the files' poses; χ² = Σ eᵀ Ω e; one thread")?;
        writeln!(f, "{}", heading())?;
        self.rows.iter().try_for_each(|row| writeln!(f, "{row}"))?;
        write!(
            f,
            "ms: median [quartiles] of {} runs, without certificates; MB: most memory of the process at once",
            self.rows.first().map_or(0, |r| r.seconds.count)
        )
    }
}

/// Optimises every graph in `data`/g2o whose name contains one of `wanted` (all without any), `runs`
/// times; `watch` sees the rows as they are done.
///
/// # Errors
/// Without graphs, or when one cannot be read or optimised.
pub fn run(
    data: Option<&Path>,
    wanted: &[String],
    runs: u64,
    mut watch: impl FnMut(&Row),
) -> Result<Table, Error> {
    let files = files(data, wanted)?;
    let optima = optima(data);
    let mut rows = Vec::new();
    for file in files {
        forget_peak();
        let read = g2o::read(&file)?;
        let has_poses = read.has_poses;
        let row = match &read.graph {
            Graph::Planar(graph) => row(graph, has_poses, runs),
            Graph::Spatial(graph) => row(graph, has_poses, runs),
        };
        let row = row.map_err(|source| Error::Graph { file: file.clone(), source })?;
        let graph = name(&file);
        let best_known = optima.get(&graph).and_then(|v| v.as_f64());
        let row = Row { graph, best_known, peak_memory: peak_memory(), ..row };
        watch(&row);
        rows.push(row);
    }
    Ok(Table { rows })
}

/// The graphs in `data`/g2o whose name contains one of `wanted`, all without any, by name.
pub(super) fn files(data: Option<&Path>, wanted: &[String]) -> Result<Vec<PathBuf>, Error> {
    let folder = data.map(|data| data.join("g2o")).ok_or(Error::NoData)?;
    let entries = std::fs::read_dir(&folder).map_err(|_| Error::NoData)?;
    let mut files: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "g2o"))
        .collect();
    if files.is_empty() {
        return Err(Error::NoData);
    }
    files.retain(|file| wanted.is_empty() || wanted.iter().any(|w| name(file).contains(w)));
    if files.is_empty() {
        return Err(Error::NoGraph { folder, wanted: wanted.join(" or ") });
    }
    files.sort();
    Ok(files)
}

/// What a graph is called.
pub(super) fn name(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The lowest known cost by name, where there is a list.
fn optima(data: Option<&Path>) -> serde_json::Value {
    data.and_then(|data| std::fs::read(data.join("g2o/optima.json")).ok())
        .and_then(|text| serde_json::from_slice::<serde_json::Value>(&text).ok())
        .map(|mut list| list["g2o_chi2_best_known_full_no_half"].take())
        .unwrap_or_default()
}

fn row<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    has_poses: bool,
    runs: u64,
) -> Result<Row, pose::Error> {
    let mut graph = graph.clone();
    if !has_poses {
        Start::Odometry.place(&mut graph)?;
    }
    let given = graph.clone();
    let mut seconds = Vec::new();
    let mut last = None;
    for _ in 0..runs.max(1) {
        graph.poses.clone_from(&given.poses);
        let clock = Instant::now();
        let found = optimize_globally(&mut graph, &Options::default(), &mut |_| ())?;
        seconds.push((clock.elapsed() - found.certifying).as_secs_f64());
        last = Some(found);
    }
    let (start, iterations, final_chi2) = match &last {
        Some(found) => (found.start, found.summary.iterations(), found.summary.final_chi2),
        None => (Start::File, 0, given.chi2()),
    };
    let certificate = last.as_ref().and_then(|found| found.certificate);
    let nothing = Spread { low: 0.0, median: 0.0, high: 0.0, count: 0 };
    Ok(Row {
        graph: String::new(),
        dimension: N,
        poses: graph.poses.len(),
        edges: graph.edges.len(),
        initial_chi2: has_poses.then(|| given.chi2()),
        start: match start {
            Start::File if !has_poses => Start::Odometry.name(),
            start => start.name(),
        },
        final_chi2,
        best_known: None,
        iterations,
        certified: certificate.is_some_and(|c| c.is_certified()),
        seconds: Spread::of(seconds).unwrap_or(nothing),
        certificate_seconds: last.map_or(0.0, |found| found.certifying.as_secs_f64()),
        peak_memory: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data;

    #[test]
    fn small_graphs_end_at_their_known_optimum() {
        let data = data::folder();
        if data.as_ref().is_none_or(|d| !d.join("g2o").is_dir()) {
            eprintln!("skipped: no pose graphs");
            return;
        }
        let wanted = ["MIT", "smallGrid3D"].map(str::to_owned);
        let mut seen = 0;
        let table = run(data.as_deref(), &wanted, 1, |_| seen += 1).unwrap();
        assert_eq!((table.rows.len(), seen), (2, 2));
        for row in &table.rows {
            let best = row.best_known.unwrap();
            assert!((row.final_chi2 / best - 1.0).abs() < 1e-6, "{row}");
            assert!(row.initial_chi2.unwrap() > 100.0 * best, "{row}");
        }
        assert!(table.to_string().lines().count() == 5, "{table}");
        let none = run(data.as_deref(), &["nothing".to_owned()], 1, |_| ()).unwrap_err();
        assert!(none.to_string().contains("is called nothing"), "{none}");
    }

    #[test]
    fn without_graphs_there_is_no_experiment() {
        let empty = tempfile::tempdir().unwrap();
        assert!(matches!(run(None, &[], 1, |_| ()), Err(Error::NoData)));
        assert!(matches!(run(Some(empty.path()), &[], 1, |_| ()), Err(Error::NoData)));
    }
}
