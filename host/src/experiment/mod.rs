//! Experiments behind the figures we publish: many seeds, the thesis' number beside ours. Where
//! `tactile reproduce NAME` is:
//!
//! | name | module |
//! |---|---|
//! | `figure-2.5` to `figure-2.15` but 2.13, a photograph | [`chapter2`] |
//! | `figure-3.7` to `figure-3.9`, `figure-3.15`, `figure-3.16`, `figure-3.20`, `figure-3.21` | [`graphs`] |
//! | `figure-3.11` to `figure-3.14` | [`chapter3`] |
//! | `figure-4.1`, `figure-4.3`, `figure-4.6`, `figure-4.7` | [`chapter4`] |
//! | `figure-4.2` | [`probing`] |
//! | `figure-4.4`, `figure-4.5` | [`solids::figures`] |
//! | `table-3.1` | [`localization`] |
//! | `table-4.2`, `table-4.3` | [`exploration`] |
//! | `shapes`, `calibration`, `memory`, `push`, `planning` | the module of that name |
//! | `solids` and `solids-moving`; `solids-hand` | [`solids`]; [`solids::on_table`] |
//! | `tracking`; `tracking-calibration` | [`tracking`]; [`tracking::consistency`] |
//! | `mujoco` | [`tracking::mujoco`] |
//! | `pose-graphs`; `pose-graph-outliers` | [`pose_graphs`]; [`outliers`] |
//! | `sensing-wrench`, `sensing-electrodes`, `sensing-drift` | the modules of [`sensing`] |
//!
//! The others are shared: [`figure`] is what a figure comes as, [`touches`] are contacts at known poses,
//! [`model`] are the shape models that are compared, [`proportion`] says how often something succeeded.

pub mod calibration;
pub mod chapter2;
pub mod chapter3;
pub mod chapter4;
pub mod exploration;
pub mod figure;
pub mod graphs;
pub mod localization;
mod mean;
pub mod memory;
pub mod model;
pub mod outliers;
mod peak;
mod pictures;
pub mod planning;
pub mod pose_graphs;
pub mod probing;
pub mod proportion;
pub mod push;
pub mod sensing;
pub mod shapes;
pub mod solids;
pub mod touches;
pub mod tracking;

pub use peak::{forget_peak, peak_memory};

use std::fmt;

use serde::Serialize;

use crate::log::GraspLog;
use crate::shape::Geometry;
use crate::slam::choose::Choice;
use crate::slam::output::{Provenance, conclude};
use crate::slam::track::Step;
use crate::view::report::Report;

/// Reconstructs from the poses of `steps` and judges against the truth; `None` when there is nothing
/// to reconstruct.
fn evaluate(
    log: &GraspLog,
    truth: Option<&Geometry>,
    steps: Vec<Step>,
    tracker: &str,
    surface: Choice,
) -> Option<Report> {
    let provenance = Provenance {
        title: "",
        tracker,
        surface,
        tracking_seconds: 0.0,
        graph: None,
        progress: &|_, _| (),
    };
    conclude(log, truth, steps, provenance).ok().map(|outcome| outcome.report)
}

/// Runs `work`, its parallel parts on threads with room for a tracker, which is built in place, and
/// for the runs that a waiting thread takes up meanwhile.
pub(crate) fn with_room<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    const STACK: usize = 256 << 20;
    match rayon::ThreadPoolBuilder::new().stack_size(STACK).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

/// Median and quartiles of a sample, ignoring what is not finite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Quarter of the sample below.
    pub low: f64,
    /// Half of the sample below.
    pub median: f64,
    /// Quarter of the sample above.
    pub high: f64,
    /// Finite values in the sample.
    pub count: usize,
}

impl Spread {
    /// Of a sample; `None` when nothing in it is finite.
    pub fn of(sample: impl IntoIterator<Item = f64>) -> Option<Spread> {
        let mut sorted: Vec<f64> = sample.into_iter().filter(|v| v.is_finite()).collect();
        if sorted.is_empty() {
            return None;
        }
        sorted.sort_by(f64::total_cmp);
        // Linear interpolation between order statistics.
        let quantile = |q: f64| {
            let at = q * (sorted.len() - 1) as f64;
            let (low, part) = (at.floor() as usize, at.fract());
            let high = (low + 1).min(sorted.len() - 1);
            sorted[low] + part * (sorted[high] - sorted[low])
        };
        Some(Spread {
            low: quantile(0.25),
            median: quantile(0.5),
            high: quantile(0.75),
            count: sorted.len(),
        })
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} [{:.2}, {:.2}]", self.median, self.low, self.high)
    }
}

/// One row of an experiment's table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was varied.
    pub case: String,
    /// Runs that gave a result, of how many.
    pub runs: (usize, usize),
    /// Hausdorff distance after the best rigid alignment, millimetres.
    pub hausdorff_mm: Option<Spread>,
    /// Mean distance between the surfaces, millimetres.
    pub mean_mm: Option<Spread>,
    /// Root mean square pose error, millimetres; `None` where poses were known.
    pub pose_mm: Option<Spread>,
    /// The same in degrees.
    pub pose_deg: Option<Spread>,
    /// Runs with an aligned Hausdorff distance below 9 mm (the thesis' bound), as a fraction.
    pub success: Option<f64>,
    /// Runs for which faces were the surface model, as a fraction of those that gave a result.
    pub faces: Option<f64>,
    /// What the thesis or our goal says, in words.
    pub reference: String,
}

impl Row {
    /// The row of a case that was run with `seeds` seeds and gave these reports.
    fn of(case: String, reports: &[Report], seeds: u64) -> Row {
        let spread = |f: fn(&Report) -> Option<f64>| Spread::of(reports.iter().filter_map(f));
        let good = |r: &&Report| r.surface.hausdorff_aligned_mm.is_some_and(|h| h < 9.0);
        Row {
            case,
            runs: (reports.len(), seeds as usize),
            hausdorff_mm: spread(|r| r.surface.hausdorff_aligned_mm),
            mean_mm: spread(|r| r.surface.mean_mm),
            pose_mm: spread(|r| r.pose.rms_translation_mm),
            pose_deg: spread(|r| r.pose.rms_rotation_deg),
            success: (seeds > 0).then(|| reports.iter().filter(good).count() as f64 / seeds as f64),
            faces: (!reports.is_empty()).then(|| {
                let faces = reports.iter().filter(|r| r.surface.model == "faces").count();
                faces as f64 / reports.len() as f64
            }),
            reference: String::new(),
        }
    }
}

/// An experiment's table, as it is printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What is shown.
    pub title: String,
    /// One per case.
    pub rows: Vec<Row>,
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.title)?;
        writeln!(
            f,
            "  {:<44}{:>7}  {:<22}{:<20}{:<22}{:<22}{:>8}{:>8}  reference",
            "case", "runs", "Hausdorff mm", "mean mm", "pose mm", "pose °", "< 9 mm", "faces"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        let share = |s: Option<f64>| s.map_or("–".to_owned(), |s| format!("{:.0} %", 100.0 * s));
        for row in &self.rows {
            writeln!(
                f,
                "  {:<44}{:>7}  {:<22}{:<20}{:<22}{:<22}{:>8}{:>8}  {}",
                row.case,
                format!("{}/{}", row.runs.0, row.runs.1),
                show(&row.hausdorff_mm),
                show(&row.mean_mm),
                show(&row.pose_mm),
                show(&row.pose_deg),
                share(row.success),
                share(row.faces),
                row.reference
            )?;
        }
        write!(f, "  median [quartiles]; Hausdorff after the best rigid alignment")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_interpolate_and_ignore_the_infinite() {
        let spread = Spread::of([4.0, 1.0, f64::INFINITY, 3.0, 2.0, f64::NAN]).unwrap();
        assert_eq!((spread.low, spread.median, spread.high, spread.count), (1.75, 2.5, 3.25, 4));
        assert_eq!(Spread::of([f64::NAN]), None);
    }
}
