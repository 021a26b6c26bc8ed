//! The comparisons' tables as pictures.

use super::localization::{self, Moved, Recorded, Simulated};
use super::memory::{MemoryRow, MemoryTable};
use super::proportion::Proportion;
use super::tracking::{self, consistency, mujoco};
use super::{Row, Spread, Table, calibration, outliers, pose_graphs, shapes};
use crate::view::bars::{self, Bars, Interval, Series};
use crate::view::curves::{self, Curve, Mark, Plot, Scale};
use crate::view::drawing::{Drawing, PictureError};

mod explorations;

impl From<Spread> for Interval {
    fn from(Spread { low, median, high, .. }: Spread) -> Interval {
        Interval { low, value: median, high }
    }
}

/// In percent, with Wilson's interval.
impl From<&Proportion> for Interval {
    fn from(share: &Proportion) -> Interval {
        let (low, high) = share.interval();
        let value = share.successes as f64 / share.of.max(1) as f64;
        Interval { low: 100.0 * low, value: 100.0 * value, high: 100.0 * high }
    }
}

/// Of each row one value.
fn series<R>(name: &str, rows: &[R], value: impl Fn(&R) -> Option<Interval>) -> Series {
    Series { name: name.into(), values: rows.iter().map(value).collect() }
}

fn of(spread: Option<Spread>) -> Option<Interval> {
    spread.map(Interval::from)
}

fn exact(value: Option<f64>) -> Option<Interval> {
    value.map(Interval::exact)
}

/// A mark of a curve.
fn mark(x: f64, Interval { low, value, high }: Interval) -> Mark {
    Mark { x, low, median: value, high }
}

/// A plot for every object, in it a curve for everyone who is compared; each item is object, who, and
/// the mark where there is one.
fn by_object<'a>(
    items: impl Iterator<Item = (&'a str, &'a str, Option<Mark>)>,
    across: &str,
    up: &str,
    scales: [Scale; 2],
) -> Vec<Plot> {
    let mut plots: Vec<Plot> = Vec::new();
    for (object, who, mark) in items {
        let at = plots.iter().position(|p| p.title == object).unwrap_or_else(|| {
            let (title, across, up) = (object.to_owned(), across.to_owned(), up.to_owned());
            plots.push(Plot { title, across, up, scales, curves: Vec::new() });
            plots.len() - 1
        });
        let curves = &mut plots[at].curves;
        let at = curves.iter().position(|c| c.name == who).unwrap_or_else(|| {
            curves.push(Curve { name: who.to_owned(), marks: Vec::new() });
            curves.len() - 1
        });
        curves[at].marks.extend(mark);
    }
    for curve in plots.iter_mut().flat_map(|p| &mut p.curves) {
        curve.marks.sort_by(|a, b| a.x.total_cmp(&b.x));
    }
    plots
}

impl Table {
    /// Distances of all cases.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let panel = Bars {
            title: "Estimated against true surface".into(),
            along: "distance, mm: median and quartiles".into(),
            scale: Scale::Linear,
            cases: self.rows.iter().map(|r| r.case.clone()).collect(),
            series: vec![
                series("Hausdorff, aligned", &self.rows, |r: &Row| of(r.hausdorff_mm)),
                series("mean", &self.rows, |r: &Row| of(r.mean_mm)),
            ],
            references: Vec::new(),
        };
        bars::render(&self.title, &[panel])
    }
}

impl shapes::Comparison {
    /// Hausdorff distance against the number of contacts, a plot for every object.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let items = self.rows.iter().flat_map(|row| {
            row.cells.iter().map(|cell| {
                let mark = of(cell.hausdorff_mm).map(|i| mark(row.contacts as f64, i));
                (row.object.as_str(), cell.model, mark)
            })
        });
        let up = "Hausdorff distance, mm: median and quartiles";
        let scales = [Scale::Linear, Scale::Logarithmic];
        curves::render(&by_object(items, "contacts", up, scales))
    }
}

impl tracking::Comparison {
    /// Success against motion noise, a plot for every object.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let items = self.rows.iter().map(|row| {
            let mark = mark(row.noise, Interval::from(&row.success));
            (row.object.as_str(), row.tracker, Some(mark))
        });
        let up = "success, %, with Wilson's 95 % interval";
        let across = "motion noise, % of the full one";
        curves::render(&by_object(items, across, up, [Scale::Linear; 2]))
    }
}

impl consistency::Table {
    /// Beliefs within their 95 % band against motion noise, a plot for every object.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let items = self.rows.iter().map(|row| {
            // Where no belief has one answer there is nothing to judge.
            let judged = row.on_map.within.of > 0;
            let mark = judged.then(|| mark(row.noise, Interval::from(&row.on_map.within)));
            (row.object.as_str(), row.tracker, mark)
        });
        let up = "last poses within their 95 % band, %, with Wilson's interval";
        let across = "motion noise, % of the full one";
        curves::render(&by_object(items, across, up, [Scale::Linear; 2]))
    }
}

impl mujoco::Table {
    /// Pose error, its rotation, and distance of the shape, recording by recording.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let mut cases: Vec<String> = Vec::new();
        let mut trackers: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !cases.contains(&row.recording) {
                cases.push(row.recording.clone());
            }
            if !trackers.contains(&row.tracker) {
                trackers.push(row.tracker);
            }
        }
        let panel = |title: &str, along: &str, value: fn(&mujoco::Row) -> Option<f64>| Bars {
            title: title.into(),
            along: along.into(),
            scale: Scale::Logarithmic,
            cases: cases.clone(),
            series: trackers
                .iter()
                .map(|tracker| {
                    series(tracker, &cases, |case| {
                        let own = |r: &&mujoco::Row| r.tracker == *tracker && r.recording == *case;
                        exact(self.rows.iter().find(own).and_then(value))
                    })
                })
                .collect(),
            references: Vec::new(),
        };
        let panels = [
            panel("Position of all poses", "root mean square error, mm", |r| r.rms_mm),
            panel("Rotation of all poses", "root mean square error, °", |r| r.rms_deg),
            panel("Shape, aligned", "Hausdorff distance, mm", |r| r.hausdorff_mm),
        ];
        bars::render("Tracking the Shadow Hand's objects in MuJoCo", &panels)
    }
}

impl pose_graphs::Table {
    /// Time, and what is left of the cost above the lowest known.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let cases: Vec<String> = self
            .rows
            .iter()
            .map(|r| format!("{}, {} poses, {} edges", r.graph, r.poses, r.edges))
            .collect();
        let ms =
            |s: Spread| Interval { low: 1e3 * s.low, value: 1e3 * s.median, high: 1e3 * s.high };
        let time = Bars {
            title: "Time from the file's poses to the end".into(),
            along: "milliseconds, one thread: median and quartiles".into(),
            scale: Scale::Logarithmic,
            cases: cases.clone(),
            series: vec![
                series("descent", &self.rows, |r: &pose_graphs::Row| Some(ms(r.seconds))),
                series("certificate", &self.rows, |r: &pose_graphs::Row| {
                    exact(Some(1e3 * r.certificate_seconds))
                }),
            ],
            references: Vec::new(),
        };
        let ratio = |cost: Option<f64>, r: &pose_graphs::Row| {
            exact(cost.zip(r.best_known).map(|(cost, best)| cost / best))
        };
        let cost = Bars {
            title: "Cost against the lowest known".into(),
            along: "χ² / lowest known χ²".into(),
            scale: Scale::Logarithmic,
            cases,
            series: vec![
                series("at the start", &self.rows, |r| ratio(r.initial_chi2, r)),
                series("at the end", &self.rows, |r| ratio(Some(r.final_chi2), r)),
            ],
            references: vec![(1.0, "lowest known".into())],
        };
        bars::render("Standard pose graphs", &[time, cost])
    }
}

impl outliers::Table {
    /// How far the poses are from the clean optimum, what of the closures was kept, and the time.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let case = |r: &outliers::Row| {
            let kind = match r.kind {
                outliers::Kind::Random => "at random",
                outliers::Kind::Grouped => "that agree",
            };
            format!("{}, {} % false, {kind}", r.graph, r.share)
        };
        let cases: Vec<String> = self.rows.iter().map(case).collect();
        let panel = |title: &str, along: &str, scale, series, references| Bars {
            title: title.into(),
            along: along.into(),
            scale,
            cases: cases.clone(),
            series,
            references,
        };
        let percent = |s: Spread| Interval {
            low: 100.0 * s.low,
            value: 100.0 * s.median,
            high: 100.0 * s.high,
        };
        type Row = outliers::Row;
        let panels = [
            panel(
                "Distance from the clean optimum",
                "root mean square, posterior standard deviations: median and quartiles",
                Scale::Logarithmic,
                vec![series("positions", &self.rows, |r: &Row| of(Some(r.relative)))],
                vec![(0.1, "as good as clean".into())],
            ),
            panel(
                "Closures that are kept",
                "%: median and quartiles",
                Scale::Linear,
                vec![
                    series("right among the kept", &self.rows, |r: &Row| {
                        Some(percent(r.precision))
                    }),
                    series("kept among the right", &self.rows, |r: &Row| Some(percent(r.recall))),
                ],
                Vec::new(),
            ),
            panel(
                "Time",
                "multiples of the clean graph's: median and quartiles",
                Scale::Logarithmic,
                vec![series("time", &self.rows, |r: &Row| of(Some(r.time)))],
                Vec::new(),
            ),
        ];
        bars::render("Standard pose graphs with false closures", &panels)
    }
}

impl calibration::Table {
    /// What the band covers where the surface was touched, and misses where it was not.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let percent = |share: Option<f64>| exact(share.map(|s| 100.0 * s));
        let cases: Vec<String> =
            self.rows.iter().map(|r| format!("{}: {}", r.class, r.case)).collect();
        let share = Bars {
            title: "The true surface and the 95 % band".into(),
            along: "share of the surface, %".into(),
            scale: Scale::Linear,
            cases: cases.clone(),
            series: vec![
                series("touched, within the band", &self.rows, |r: &calibration::Row| {
                    percent(r.covered)
                }),
                series("untouched, outside it", &self.rows, |r: &calibration::Row| {
                    percent(r.overconfident)
                }),
            ],
            references: vec![(90.0, "goal: from".into()), (98.0, "goal: to".into())],
        };
        let size = Bars {
            title: "Deviation and error".into(),
            along: "mm: median and quartiles".into(),
            scale: Scale::Logarithmic,
            cases,
            series: vec![
                series("σ where touched", &self.rows, |r: &calibration::Row| {
                    of(r.deviation_touched_mm)
                }),
                series("error where touched", &self.rows, |r: &calibration::Row| {
                    of(r.error_touched_mm)
                }),
                series("σ where untouched", &self.rows, |r: &calibration::Row| {
                    of(r.deviation_untouched_mm)
                }),
            ],
            references: Vec::new(),
        };
        bars::render("Calibration of the surface's uncertainty", &[share, size])
    }
}

impl MemoryTable {
    /// Distances with all contacts, with the process in a bounded memory and with the board's map, and the ratio of
    /// the first two.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let cases: Vec<String> =
            self.rows.iter().map(|r| format!("{}, {} kept", r.object, r.capacity)).collect();
        type Of = fn(&MemoryRow) -> Option<Spread>;
        let panel = |title: &str, [all, bounded, truncated]: [Of; 3]| Bars {
            title: title.into(),
            along: "distance from the true surface, mm: median and quartiles".into(),
            scale: Scale::Linear,
            cases: cases.clone(),
            series: vec![
                series("all contacts kept", &self.rows, |r| of(all(r))),
                series("the process in as many places as a board has", &self.rows, |r| {
                    of(bounded(r))
                }),
                series("the board's map, with faces", &self.rows, |r| of(truncated(r))),
            ],
            references: Vec::new(),
        };
        let ratio = Bars {
            title: "The process in bounded memory over all contacts".into(),
            along: "ratio, seed by seed: median and quartiles".into(),
            scale: Scale::Linear,
            cases: cases.clone(),
            series: vec![
                series("mean", &self.rows, |r: &MemoryRow| of(r.mean_ratio)),
                series("greatest", &self.rows, |r: &MemoryRow| of(r.hausdorff_ratio)),
            ],
            references: vec![(1.1, "goal: at most".into())],
        };
        let panels = [
            panel(
                "Mean",
                [|r| r.unlimited_mean_mm, |r| r.bounded_mean_mm, |r| r.truncated_mean_mm],
            ),
            panel(
                "Greatest, from the true surface to the estimated one",
                [
                    |r| r.unlimited_hausdorff_mm,
                    |r| r.bounded_hausdorff_mm,
                    |r| r.truncated_hausdorff_mm,
                ],
            ),
            ratio,
        ];
        let title = format!("Bounded memory: streams of {} contacts", self.stream);
        bars::render(&title, &panels)
    }
}

impl localization::Table {
    /// Its three parts, and the time.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let Self { recorded, moved, simulated, .. } = self;
        let named: Vec<String> =
            recorded.iter().map(|r| format!("{}, {} contacts", r.name, r.contacts)).collect();
        let panel = |title: &str, along: &str, scale, cases: Vec<String>, series| Bars {
            title: title.into(),
            along: along.into(),
            scale,
            cases,
            series,
            references: Vec::new(),
        };
        let fit = vec![
            series("found", recorded, |r: &Recorded| of(r.mean_mm)),
            series("best pose known", recorded, |r: &Recorded| exact(Some(r.exhaustive_mm))),
        ];
        let ms =
            |s: Spread| Interval { low: 1e3 * s.low, value: 1e3 * s.median, high: 1e3 * s.high };
        let time = vec![series("search", recorded, |r: &Recorded| r.seconds.map(ms))];
        let last = vec![
            series("first answer", moved, |m: &Moved| exact(Some(m.first_mm))),
            series("best answer", moved, |m: &Moved| exact(Some(m.listed_mm))),
            series("odometry", moved, |m: &Moved| exact(Some(m.odometry_mm))),
        ];
        let percent = |share: f64| exact(Some(100.0 * share));
        let right = vec![
            series("first answer right", simulated, |s: &Simulated| percent(s.first)),
            series("right one listed", simulated, |s: &Simulated| percent(s.listed)),
            series("as likely as the truth", simulated, |s: &Simulated| percent(s.optimal)),
        ];
        let case = |s: &Simulated| {
            let with = if s.normals { "with" } else { "without" };
            format!("{}, {} contacts {with} normals", s.object, s.contacts)
        };
        let panels = [
            panel(
                "Contacts on objects at rest",
                "mean distance from the surface, mm: median and quartiles",
                Scale::Linear,
                named.clone(),
                fit,
            ),
            panel("Its time", "ms: median and quartiles", Scale::Linear, named, time),
            panel(
                "Last pose of an object that moved",
                "mean distance between the surfaces at the pose found and the true one, mm",
                Scale::Logarithmic,
                moved.iter().map(|m| format!("{}, {} contacts", m.name, m.contacts)).collect(),
                last,
            ),
            panel(
                "Random poses",
                "share of the runs, %",
                Scale::Linear,
                simulated.iter().map(case).collect(),
                right,
            ),
        ];
        bars::render("Table 3.1: global localization of a fixed object", &panels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_object_has_a_plot_and_each_contender_a_curve_in_order() {
        let at = |x: f64| Some(mark(x, Interval::exact(x)));
        let items = [
            ("box", "gp", at(20.0)),
            ("box", "gp", at(10.0)),
            ("box", "faces", None),
            ("ball", "gp", at(5.0)),
        ];
        let plots = by_object(items.into_iter(), "contacts", "mm", [Scale::Linear; 2]);
        assert_eq!(plots.len(), 2);
        let of = |c: &Curve| c.marks.iter().map(|m| m.x).collect::<Vec<_>>();
        assert_eq!(of(&plots[0].curves[0]), [10.0, 20.0]);
        // Who has nothing to show is named all the same.
        assert_eq!(plots[0].curves[1].name, "faces");
        assert_eq!(plots[1].curves.len(), 1);
    }

    #[test]
    fn shares_are_percent_with_their_interval() {
        let half = Interval::from(&Proportion { successes: 5, of: 10 });
        assert!(half.value == 50.0 && half.low < 30.0 && half.high > 70.0, "{half:?}");
        assert_eq!(Interval::from(&Proportion { successes: 0, of: 0 }).value, 0.0);
    }

    #[test]
    fn a_table_of_nothing_is_a_picture_too() {
        let empty = Table { title: "nothing".into(), rows: Vec::new() };
        assert!(empty.picture().unwrap().svg().contains("nothing to show"));
        let graphs = pose_graphs::Table { rows: Vec::new() };
        assert!(graphs.picture().unwrap().png().is_ok());
    }
}
