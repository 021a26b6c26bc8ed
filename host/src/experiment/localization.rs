//! Table 3.1, "global localization of a fixed object": real and simulated fingertip contacts on
//! known objects beside published filters; recordings in which the object moved; and simulated
//! contacts at random poses.

mod moved;
mod recorded;
mod simulated;

use std::fmt;
use std::path::Path;

use serde::Serialize;

use crate::experiment::Spread;
use crate::localize::LocalizeError;
use crate::localize::contacts::ContactsError;
use crate::shape::ShapeError;
use crate::shape::files::FileError;
use crate::sim::SimError;

pub use moved::Moved;
pub use recorded::Recorded;
pub use simulated::Simulated;

use recorded::STARTS;

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Fingertip contacts on objects at rest, their pose unknown.
    pub recorded: Vec<Recorded>,
    /// Grasps of objects that moved in between, their last pose known.
    pub moved: Vec<Moved>,
    /// Random poses, known.
    pub simulated: Vec<Simulated>,
    /// What was left out and why.
    pub skipped: Vec<String>,
}

/// Why there is no table.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Contacts cannot be read.
    #[error(transparent)]
    Contacts(#[from] ContactsError),
    /// A mesh cannot be read.
    #[error(transparent)]
    Mesh(#[from] FileError),
    /// An object cannot be made.
    #[error(transparent)]
    Object(#[from] SimError),
    /// A shape cannot be made.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// It cannot be localised.
    #[error("{name}: {source}")]
    Localize {
        /// What was.
        name: String,
        /// Why.
        source: LocalizeError,
    },
}

/// All parts; recordings from `data`/touch and `data`/mujoco, meshes from `data`/ycb, where they
/// exist.
///
/// # Errors
/// When a file is there but cannot be read.
pub fn run(data: Option<&Path>, seeds: u64) -> Result<Table, Error> {
    let mut skipped = Vec::new();
    let recorded = recorded::run(data, seeds, &mut skipped)?;
    let moved = moved::run(data, &mut skipped)?;
    let simulated = simulated::run(data, seeds, &mut skipped)?;
    Ok(Table { recorded, moved, simulated, skipped })
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Table 3.1: global localization of a fixed object, 6 degrees of freedom")?;
        let show = |s: &Option<Spread>, unit: f64| {
            s.map_or("–".to_owned(), |s| {
                let Spread { low, median, high, .. } = s;
                format!("{:.2} [{:.2}, {:.2}]", unit * median, unit * low, unit * high)
            })
        };
        writeln!(
            f,
            "  {:<18}{:>9}  {:<20}{:<24}{:>6}{:>6}{:>10}{:>12}  published",
            "contacts of", "contacts", "mean mm", "time ms", "modes", "free", "optimum", "best mm"
        )?;
        for row in &self.recorded {
            writeln!(
                f,
                "  {:<18}{:>9}  {:<20}{:<24}{:>6}{:>6}{:>10}{:>12.2}  {}",
                row.name,
                row.contacts,
                show(&row.mean_mm, 1.0),
                show(&row.seconds, 1e3),
                row.modes,
                row.unobservable,
                format!("{}/{}", row.reached.0, row.reached.1),
                row.exhaustive_mm,
                row.reference
            )?;
        }
        writeln!(
            f,
            "  median [quartiles] over seeds of the search; optimum: runs that reach the best pose \
             known; best: of {STARTS} starts without pruning\n"
        )?;
        writeln!(
            f,
            "  {:<28}{:>9}{:>10}{:>11}{:>8}{:>7}{:>13}",
            "object that moved",
            "contacts",
            "first mm",
            "listed mm",
            "+- mm",
            "modes",
            "odometry mm"
        )?;
        for row in &self.moved {
            writeln!(
                f,
                "  {:<28}{:>9}{:>10.2}{:>11.2}{:>8.1}{:>7}{:>13.2}",
                row.name,
                row.contacts,
                row.first_mm,
                row.listed_mm,
                row.deviation_mm,
                row.modes,
                row.odometry_mm
            )?;
        }
        writeln!(
            f,
            "  mean distance between the surface at the pose found and at the true last one; +-: \
             deviation that the first mode states; odometry: the true first pose carried along\n"
        )?;
        writeln!(
            f,
            "  {:<28}{:>9}{:>9}{:>8}{:>8}{:>9}{:>15}{:>15}{:>6}",
            "object, random pose",
            "contacts",
            "normals",
            "first",
            "listed",
            "optimal",
            "weight, right",
            "weight, wrong",
            "runs"
        )?;
        let share = |s: f64| format!("{:.0} %", 100.0 * s);
        for row in &self.simulated {
            let weight = |k: usize| row.weights[k].map_or("–".into(), share);
            writeln!(
                f,
                "  {:<28}{:>9}{:>9}{:>8}{:>8}{:>9}{:>15}{:>15}{:>6}",
                row.object,
                row.contacts,
                if row.normals { "yes" } else { "no" },
                share(row.first),
                share(row.listed),
                share(row.optimal),
                weight(0),
                weight(1),
                row.runs
            )?;
        }
        write!(
            f,
            "  noise 1 mm and 5°; first, listed: the first mode, any mode, puts the whole surface \
             within 5 mm of the true one; optimal: a pose as likely as the true one was found"
        )?;
        self.skipped.iter().try_for_each(|s| write!(f, "\n  skipped: {s}"))
    }
}
