//! Real contacts: the pushed triangular block with motion-capture poses.

use std::path::{Path, PathBuf};

use crate::experiment::{Row, Table, evaluate};
use crate::log::LogError;
use crate::log::import::push::{Motion, Normals, log, read};
use crate::slam::choose::Choice;
use crate::slam::output::true_shape;
use crate::slam::track;

/// Why the experiment could not run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The recordings are not part of the project.
    #[error("push recordings not found: expected */exp_*.txt in $TACTILE_DATA/push")]
    NoData,
    /// A recording cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// All recordings below `folder`, in order of their names.
pub fn recordings(folder: &Path) -> Vec<PathBuf> {
    let list = |folder: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect()
    };
    let named = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("exp_") && name.ends_with(".txt")
    };
    let mut files: Vec<PathBuf> =
        list(folder).iter().flat_map(|sub| list(sub)).filter(named).collect();
    files.sort();
    files
}

/// Reconstructs the block from every recording in `data`/push with the motion-captured poses.
///
/// # Errors
/// Without recordings, or when one cannot be read.
pub fn run(data: Option<&Path>) -> Result<Table, Error> {
    let files = data.map(|d| recordings(&d.join("push"))).unwrap_or_default();
    if files.is_empty() {
        return Err(Error::NoData);
    }
    let mut rows = Vec::new();
    for file in files {
        let pushes = read(&file)?;
        let log = log(&pushes, &Motion::Recorded, Normals::Auto, "push");
        let truth = true_shape(&log).ok().flatten();
        let steps = track::truth(&log).unwrap_or_default();
        let folder = file.parent().and_then(Path::file_name).unwrap_or_default();
        for (name, choice) in [("gp", Choice::Gp), ("auto", Choice::Auto)] {
            let result = evaluate(&log, truth.as_ref(), steps.clone(), "truth", choice);
            let case = format!("{}, {} pushes, {name}", folder.to_string_lossy(), pushes.len());
            let mut row = Row::of(case, result.as_slice(), 1);
            (row.pose_mm, row.pose_deg) = (None, None);
            row.reference = "goal: Hausdorff ≤ 3, mean ≤ 0.8 mm".into();
            rows.push(row);
        }
    }
    Ok(Table { title: "Real pushes on a triangular block, motion-captured poses".into(), rows })
}
