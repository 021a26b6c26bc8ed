//! Every tracker on recordings of a Shadow Hand in MuJoCo: physics that nobody here wrote.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use super::judge::{Judgement, Truth};
use super::{Contender, Followed};
use crate::experiment::{Spread, with_room};
use crate::graph;
use crate::log::{GraspLog, LogError};
use crate::slam::output::{TruthError, true_shape};

/// Why the experiment could not run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The recordings are not part of the project.
    #[error("recordings not found: expected *.jsonl in $TACTILE_DATA/mujoco")]
    NoData,
    /// No recording has such a name.
    #[error("no recording in mujoco has a name that holds {0:?}")]
    NoneWanted(String),
    /// A recording cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// Its true shape cannot be used.
    #[error("{}: {source}", file.display())]
    Shape {
        /// Which recording.
        file: PathBuf,
        /// What is wrong.
        source: TruthError,
    },
    /// It has none.
    #[error("{}: expected a true shape and true poses", file.display())]
    NoTruth {
        /// Which recording.
        file: PathBuf,
    },
}

/// Which part of the table to make.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Only recordings whose name holds one of these; all where empty.
    pub names: Vec<String>,
    /// Who takes part; all where empty.
    pub contenders: Vec<Contender>,
    /// What corrects the trackers' poses afterwards.
    pub graph: graph::Kind,
    /// Seeds of each tracker, from 0 on.
    pub seeds: u64,
}

/// One tracker on one recording: medians over the seeds, lengths in millimetres.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Its name, without the ending.
    pub recording: String,
    /// 2 or 3.
    pub dimension: usize,
    /// Whether no sensor noise was added.
    pub clean: bool,
    /// Who.
    pub tracker: &'static str,
    /// Root mean square error of all poses.
    pub rms_mm: Option<f64>,
    /// In degrees, up to symmetry.
    pub rms_deg: Option<f64>,
    /// Error of the last pose.
    pub last_mm: Option<f64>,
    /// In degrees, up to symmetry.
    pub last_deg: Option<f64>,
    /// Grasps that the tracker could not explain, on average.
    pub lost: f64,
    /// Contacts at the estimated poses to the true surface, root mean square.
    pub contacts_mm: Option<f64>,
    /// Mean distance from the touched part of the true surface to the estimate.
    pub touched_mean_mm: Option<f64>,
    /// The greatest such distance.
    pub touched_greatest_mm: Option<f64>,
    /// Hausdorff distance of the whole shapes, aligned.
    pub hausdorff_mm: Option<f64>,
    /// The tracker and, where there is one, the graph, per grasp.
    pub milliseconds: Option<f64>,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Recording by recording.
    pub rows: Vec<Row>,
}

/// A recording and the object as it is.
pub(crate) struct Recording {
    pub(crate) name: String,
    pub(crate) log: GraspLog,
    pub(crate) truth: Truth,
}

/// Follows the object through every recording in `data`/mujoco that is wanted. `done` is told each
/// row as soon as there is one.
///
/// # Errors
/// Without recordings, or when one cannot be read or judged.
pub fn run(
    data: Option<&Path>,
    selection: &Selection,
    mut done: impl FnMut(&Row),
) -> Result<Table, Error> {
    let contenders = match &selection.contenders[..] {
        [] => Contender::all().filter(|c| *c != Contender::Bound).collect(),
        chosen => chosen.to_vec(),
    };
    let mut rows = Vec::new();
    for file in recordings(data, &selection.names)? {
        let recording = read(&file)?;
        for contender in &contenders {
            let row = follow(&recording, *contender, selection);
            done(&row);
            rows.push(row);
        }
    }
    Ok(Table { rows })
}

pub(crate) fn recordings(data: Option<&Path>, wanted: &[String]) -> Result<Vec<PathBuf>, Error> {
    let folder = data.map(|d| d.join("mujoco"));
    let listed = folder.and_then(|f| std::fs::read_dir(f).ok()).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = listed.map(|entry| entry.path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "jsonl"));
    if files.is_empty() {
        return Err(Error::NoData);
    }
    if let Some(none) = wanted.iter().find(|w| !files.iter().any(|f| name(f).contains(&***w))) {
        return Err(Error::NoneWanted(none.clone()));
    }
    files.retain(|f| wanted.is_empty() || wanted.iter().any(|w| name(f).contains(&**w)));
    files.sort_by_key(|f| name(f));
    Ok(files)
}

/// Of a file, without its ending.
pub(crate) fn name(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

pub(crate) fn read(file: &Path) -> Result<Recording, Error> {
    let log = GraspLog::read(file)?;
    let shape = true_shape(&log).map_err(|source| Error::Shape { file: file.into(), source })?;
    match shape {
        Some(shape) if log.grasps.iter().any(|g| g.truth.is_some()) => {
            Ok(Recording { name: name(file), log, truth: Truth::new(shape) })
        }
        _ => Err(Error::NoTruth { file: file.into() }),
    }
}

fn follow(recording: &Recording, contender: Contender, selection: &Selection) -> Row {
    let Recording { name, log, truth } = recording;
    let one = |seed| {
        let start = Instant::now();
        let steps = contender.follow(log, seed);
        let followed = Followed::after(contender, selection.graph, log, steps);
        let milliseconds = 1e3 * start.elapsed().as_secs_f64() / log.grasps.len().max(1) as f64;
        Some((followed.judged(log, truth)?, milliseconds))
    };
    // Another seed is the same run of what draws nothing.
    let seeds = match contender.is_tracker() {
        true => selection.seeds,
        false => selection.seeds.min(1),
    };
    let runs: Vec<(Judgement, f64)> =
        with_room(|| (0..seeds).into_par_iter().filter_map(one).collect());
    let median = |f: fn(&Judgement) -> Option<f64>| {
        Spread::of(runs.iter().filter_map(|(j, _)| f(j))).map(|s| s.median)
    };
    let times = runs.iter().map(|r| r.1).filter(|_| contender.is_tracker());
    Row {
        recording: name.clone(),
        dimension: log.dimension,
        clean: name.ends_with(".clean"),
        tracker: contender.name(),
        rms_mm: median(|j| Some(1e3 * j.rms.translation)),
        rms_deg: median(|j| Some(j.rms.rotation.to_degrees())),
        last_mm: median(|j| Some(1e3 * j.last.translation)),
        last_deg: median(|j| Some(j.last.rotation.to_degrees())),
        lost: runs.iter().map(|r| r.0.lost as f64).sum::<f64>() / runs.len().max(1) as f64,
        contacts_mm: median(|j| Some(1e3 * j.contacts)),
        touched_mean_mm: median(|j| Some(1e3 * j.touched?.mean)),
        touched_greatest_mm: median(|j| Some(1e3 * j.touched?.greatest)),
        hausdorff_mm: median(|j| Some(1e3 * j.hausdorff?)),
        milliseconds: Spread::of(times).map(|s| s.median),
    }
}

/// The line above the rows.
pub fn heading() -> String {
    format!(
        "  {:<32}{:<16}{:>16}{:>16}{:>6}{:>10}{:>16}{:>12}{:>10}",
        "recording",
        "tracker",
        "rms mm, °",
        "last mm, °",
        "lost",
        "touch mm",
        "touched part mm",
        "Hausdorff",
        "ms/grasp"
    )
}

impl Row {
    /// Its figures under another name, as one line.
    fn line(&self, name: &str, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:.1}"));
        let pair = |a, b| format!("{}, {}", show(a), show(b));
        write!(
            f,
            "  {name:<32}{:<16}{:>16}{:>16}{:>6.1}{:>10}{:>16}{:>12}{:>10}",
            self.tracker,
            pair(self.rms_mm, self.rms_deg),
            pair(self.last_mm, self.last_deg),
            self.lost,
            show(self.contacts_mm),
            pair(self.touched_mean_mm, self.touched_greatest_mm),
            show(self.hausdorff_mm),
            self.milliseconds.map_or("–".to_owned(), |v| format!("{v:.2}")),
        )
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.line(&self.recording, f)
    }
}

impl Table {
    /// Medians over recordings of one kind by one tracker; `lost` is the mean.
    fn summary(&self, dimension: usize, clean: bool, tracker: &'static str) -> Option<Row> {
        let of =
            |row: &&Row| (row.dimension, row.clean, row.tracker) == (dimension, clean, tracker);
        let rows: Vec<&Row> = self.rows.iter().filter(of).collect();
        let median = |f: fn(&Row) -> Option<f64>| {
            Spread::of(rows.iter().filter_map(|r| f(r))).map(|s| s.median)
        };
        let noise = if clean { "clean" } else { "1 mm, 5°" };
        (!rows.is_empty()).then(|| Row {
            recording: format!("{} recordings, {dimension}D, {noise}", rows.len()),
            dimension,
            clean,
            tracker,
            rms_mm: median(|r| r.rms_mm),
            rms_deg: median(|r| r.rms_deg),
            last_mm: median(|r| r.last_mm),
            last_deg: median(|r| r.last_deg),
            lost: rows.iter().map(|r| r.lost).sum::<f64>() / rows.len() as f64,
            contacts_mm: median(|r| r.contacts_mm),
            touched_mean_mm: median(|r| r.touched_mean_mm),
            touched_greatest_mm: median(|r| r.touched_greatest_mm),
            hausdorff_mm: median(|r| r.hausdorff_mm),
            milliseconds: median(|r| r.milliseconds),
        })
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Tracking the Shadow Hand's objects in MuJoCo\n{}", heading())?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        writeln!(f, "  medians over recordings; lost: mean")?;
        let mut trackers: Vec<&'static str> = Vec::new();
        for row in &self.rows {
            if !trackers.contains(&row.tracker) {
                trackers.push(row.tracker);
            }
        }
        for (dimension, clean) in [(2, false), (2, true), (3, false), (3, true)] {
            for tracker in &trackers {
                if let Some(row) = self.summary(dimension, clean, tracker) {
                    writeln!(f, "{row}")?;
                }
            }
        }
        write!(
            f,
            "  poses: up to the object's symmetry, frames made to agree where the contacts fit the \
             true surface best\n  \
             touch: contacts at the estimated poses to the true surface, rms; touched part: mean and \
             greatest distance\n  \
             from the true surface within 10 mm of a contact to the estimate; Hausdorff: of all, \
             aligned"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data;

    fn selection(name: &str) -> Selection {
        let contenders = vec![Contender::Oracle, Contender::Odometry];
        Selection { names: vec![name.into()], contenders, graph: graph::Kind::None, seeds: 1 }
    }

    #[test]
    fn no_recordings_is_said_plainly() {
        let folder = tempfile::tempdir().unwrap();
        for data in [None, Some(folder.path())] {
            let error = run(data, &selection("box"), |_| ()).unwrap_err().to_string();
            assert!(error.contains("$TACTILE_DATA/mujoco"), "{error}");
        }
    }

    #[test]
    fn a_recording_without_truth_cannot_be_judged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mujoco");
        std::fs::create_dir(&path).unwrap();
        let header = r#"{"format":"tactile-grasp-log","version":1,"dimension":2,"frame":"world"}"#;
        let grasp = r#"{"grasp":0,"contacts":[{"point":[0,0]}]}"#;
        std::fs::write(path.join("bare.jsonl"), format!("{header}\n{grasp}\n")).unwrap();
        let error = run(Some(folder.path()), &selection("bare"), |_| ()).unwrap_err();
        assert!(matches!(error, Error::NoTruth { .. }), "{error}");
    }

    #[test]
    fn recordings_show_what_dead_reckoning_loses() {
        let Some(folder) = data::for_test("mujoco") else { return };
        let data = folder.parent();
        let mut told = Vec::new();
        let table = run(data, &selection("box_2d_s1"), |r| told.push(r.clone())).unwrap();
        assert_eq!(told, table.rows);
        assert_eq!(table.rows.len(), 4);
        for rows in table.rows.chunks(2) {
            let [oracle, odometry] = rows else { panic!() };
            assert!(oracle.rms_mm.unwrap() < 1.5 && oracle.rms_deg.unwrap() < 1.5, "{oracle}");
            assert!(odometry.rms_deg.unwrap() > 3.0 * oracle.rms_deg.unwrap(), "{odometry}");
            assert!(oracle.touched_mean_mm.unwrap() < 2.0, "{oracle}");
        }
        assert!(table.to_string().contains("1 recordings, 2D, clean"));
        let error = run(data, &selection("anvil"), |_| ()).unwrap_err().to_string();
        assert!(error.contains("anvil"), "{error}");
    }
}
