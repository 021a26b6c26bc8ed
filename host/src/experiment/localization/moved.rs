//! Objects that a hand moved between grasps, by physics nobody here wrote: all contacts are carried
//! to the last grasp by the log's odometry, drift and all.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use serde::Serialize;

use super::Error;
use crate::localize::contacts::{Fixed, read};
use crate::localize::{Settings, localize};
use crate::log::TrueShape;
use crate::shape::files::read_mesh;
use crate::space::{Point, Pose};

/// One recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moved {
    /// Of its file.
    pub name: String,
    /// Of all grasps.
    pub contacts: usize,
    /// Mean distance between the object's surface at the first mode and at its true last pose,
    /// millimetres: symmetries do not count.
    pub first_mm: f64,
    /// The same for the best of the modes.
    pub listed_mm: f64,
    /// What the first mode says of itself, see [`crate::localize::Mode::deviation`], millimetres.
    pub deviation_mm: f64,
    /// How many.
    pub modes: usize,
    /// Odometry alone: the first grasp's true pose carried to the last, millimetres likewise.
    pub odometry_mm: f64,
}

/// All spatial logs with sensor noise in `data`/mujoco.
pub(super) fn run(data: Option<&Path>, skipped: &mut Vec<String>) -> Result<Vec<Moved>, Error> {
    let folder = data.map(|d| d.join("mujoco"));
    let listed = folder.and_then(|f| std::fs::read_dir(f).ok()).into_iter().flatten().flatten();
    let spatial = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.contains("_3d_") && name.ends_with(".jsonl") && !name.ends_with(".clean.jsonl")
    };
    let mut logs: Vec<PathBuf> = listed.map(|e| e.path()).filter(spatial).collect();
    logs.sort();
    if logs.is_empty() {
        skipped.push("moved objects: none in $TACTILE_DATA/mujoco".into());
    }
    let rows: Vec<Option<Moved>> = logs.iter().map(|l| one(l)).collect::<Result<_, _>>()?;
    Ok(rows.into_iter().flatten().collect())
}

/// `None` for a log without a true shape and poses.
fn one(path: &Path) -> Result<Option<Moved>, Error> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (log, contacts) = read(path, Fixed::No, None)?;
    let Some(TrueShape::Mesh { file, .. }) = &log.shape else { return Ok(None) };
    let ends = (log.grasps.first().and_then(|g| g.truth), log.grasps.last().and_then(|g| g.truth));
    let (Some(start), Some(truth)) = ends else { return Ok(None) };
    let mesh = read_mesh(file)?;
    let found = localize(&mesh, &contacts, &Settings::default())
        .map_err(|source| Error::Localize { name: name.clone(), source })?;
    let samples: Vec<Point> = mesh.samples(500).into_iter().map(|s| s.0).collect();
    let apart = |pose: &Pose| {
        let off = truth.inverse() * pose;
        let away = |p: &Point| mesh.distance(&(off * Point3::from(*p)).coords);
        1e3 * samples.iter().map(away).sum::<f64>() / samples.len().max(1) as f64
    };
    // The first motion led to where it starts.
    let motions = log.grasps.iter().skip(1).filter_map(|g| g.motion);
    let carried = motions.fold(start, |pose, m| m * pose);
    let errors = found.modes.iter().map(|m| apart(&m.pose));
    Ok(Some(Moved {
        contacts: contacts.len(),
        first_mm: found.modes.first().map_or(f64::NAN, |m| apart(&m.pose)),
        listed_mm: errors.fold(f64::INFINITY, f64::min),
        deviation_mm: found.modes.first().map_or(f64::NAN, |m| 1e3 * m.deviation),
        modes: found.modes.len(),
        odometry_mm: apart(&carried),
        name,
    }))
}
