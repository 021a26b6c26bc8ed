//! Explorations: how soon objects are known, case by case.

use super::{exact, of, series};
use crate::experiment::{exploration, planning, solids};
use crate::view::bars::{self, Bars, Interval};
use crate::view::curves::Scale;
use crate::view::drawing::{Drawing, PictureError};

impl exploration::Table {
    /// Actions until what is asked for is known, how often that is and the last pose right, case by case.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let cases: Vec<String> = self
            .rows
            .iter()
            .map(|r| {
                let means = [r.tracker, r.graph].into_iter().flatten();
                let means: String = means.map(|name| format!(", {name}")).collect();
                format!("{}: {}, {}, {}{means}", r.object, r.criterion, r.candidates, r.until)
            })
            .collect();
        let actions = |r: &exploration::Row| mean((r.actions, r.plus_minus));
        let panels = [
            Bars {
                title: "Actions until what is asked for is known".into(),
                along: "actions: mean and its 95 % interval".into(),
                scale: Scale::Linear,
                cases: cases.clone(),
                series: vec![series("actions", &self.rows, actions)],
                references: Vec::new(),
            },
            Bars {
                title: "Runs that end well".into(),
                along: "share of the runs, %, with Wilson's 95 % interval".into(),
                scale: Scale::Linear,
                cases,
                series: vec![
                    series("known", &self.rows, |r: &exploration::Row| {
                        Some(Interval::from(&r.reached))
                    }),
                    series("last pose right", &self.rows, |r: &exploration::Row| {
                        Some(Interval::from(&r.pose))
                    }),
                ],
                references: Vec::new(),
            },
        ];
        bars::render(self.title, &panels)
    }
}

/// A mean and half of its 95 % interval; one run has none.
fn mean((value, half): (f64, f64)) -> Option<Interval> {
    let half = if half.is_finite() { half } else { 0.0 };
    Some(Interval { low: value - half, value, high: value + half })
}

impl solids::Table {
    /// Grasps until the surface is known, and how often it is and the last pose right, case by case.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let cases: Vec<String> =
            self.rows.iter().map(|r| format!("{}: {}", r.object, r.criterion)).collect();
        let grasps = Bars {
            title: "Grasps until 90 % of the reachable surface is known to 3 mm".into(),
            along: "grasps: mean and its 95 % interval; contacts: mean".into(),
            scale: Scale::Logarithmic,
            cases: cases.clone(),
            series: vec![
                series("grasps", &self.rows, |r: &solids::Row| mean((r.grasps, r.plus_minus))),
                series("contacts", &self.rows, |r: &solids::Row| exact(Some(r.contacts))),
            ],
            references: Vec::new(),
        };
        let reached =
            series("surface known", &self.rows, |r: &solids::Row| Some(Interval::from(&r.reached)));
        let pose =
            series("last pose right", &self.rows, |r: &solids::Row| Some(Interval::from(&r.pose)));
        let ends = Bars {
            title: "Runs that end well".into(),
            along: "share of the runs, %, with Wilson's 95 % interval; a right pose: 3 mm and 3°"
                .into(),
            scale: Scale::Linear,
            cases,
            // Of an object at rest the pose is known.
            series: if self.tracker.is_some() { vec![reached, pose] } else { vec![reached] },
            references: Vec::new(),
        };
        let title = match self.tracker {
            Some(tracker) => {
                format!("Exploring solids that slip at every grasp, tracker {tracker}")
            }
            None => "Exploring solids that stay where they are".into(),
        };
        bars::render(&title, &[grasps, ends])
    }
}

impl solids::on_table::Table {
    /// Actions until the surface is known over a table, how often that is reached and what is wrong of
    /// what seems known, case by case.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        use solids::on_table::Row;
        let cases: Vec<String> =
            self.rows.iter().map(|r| format!("{}: {}", r.object, r.criterion)).collect();
        let panel = |title: &str, along: &str, series| Bars {
            title: title.into(),
            along: along.into(),
            scale: Scale::Linear,
            cases: cases.clone(),
            series: vec![series],
            references: Vec::new(),
        };
        let panels = [
            panel(
                "Actions until the surface is known",
                "mean and its 95 % interval",
                series("actions, probing included", &self.rows, |r: &Row| {
                    mean((r.actions, r.plus_minus))
                }),
            ),
            panel(
                "Runs that get there",
                "share of the runs, %, with Wilson's 95 % interval",
                series("surface known", &self.rows, |r: &Row| Some(Interval::from(&r.reached))),
            ),
            panel(
                "Greatest error of what seems known",
                "mm: median and quartiles",
                series("in the end", &self.rows, |r: &Row| of(r.wrong_mm)),
            ),
        ];
        bars::render("Exploring with an articulated hand over a table", &panels)
    }
}

impl planning::Table {
    /// Seconds, actions and decisions until the object is known, case by case.
    ///
    /// # Errors
    /// When the picture cannot be made.
    pub fn picture(&self) -> Result<Drawing, PictureError> {
        let cases: Vec<String> =
            self.rows.iter().map(|r| format!("{}: {}", r.object, r.strategy)).collect();
        let panel = |title: &str, along: &str, series| Bars {
            title: title.into(),
            along: along.into(),
            scale: Scale::Linear,
            cases: cases.clone(),
            series,
            references: Vec::new(),
        };
        let seconds = vec![series("seconds", &self.rows, |r: &planning::Row| mean(r.seconds))];
        let actions = vec![
            series("actions", &self.rows, |r: &planning::Row| mean(r.actions)),
            series("decisions", &self.rows, |r: &planning::Row| exact(Some(r.decisions))),
        ];
        let reached =
            series("known", &self.rows, |r: &planning::Row| Some(Interval::from(&r.reached)));
        let share = "share of the runs, %, with Wilson's 95 % interval";
        let panels = [
            panel("Time of all actions", "seconds: mean and its 95 % interval", seconds),
            panel(
                "Actions until the object is known",
                "mean; of actions its 95 % interval",
                actions,
            ),
            panel("Runs that get there", share, vec![reached]),
        ];
        bars::render("What planning ahead is worth", &panels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::proportion::Proportion;

    #[test]
    fn solids_and_strategies_are_named_with_their_intervals() {
        let row = solids::Row {
            object: "box:0.07".into(),
            reachable: 1.0,
            criterion: "entropy".into(),
            grasps: 3.0,
            plus_minus: 0.5,
            contacts: 15.0,
            reached: Proportion { successes: 10, of: 10 },
            pose: Proportion { successes: 1, of: 10 },
            pose_mm: None,
            pose_deg: None,
            possible: None,
            choosing_ms: None,
            action_ms: 1.0,
        };
        let of = |tracker| solids::Table {
            tracker,
            rows: vec![row.clone()],
            outlooks: Vec::new(),
            skipped: Vec::new(),
        };
        let fixed = of(None).picture().unwrap().svg();
        assert!(fixed.contains(">box:0.07: entropy</text>") && fixed.contains("15"));
        assert!(!fixed.contains("last pose"), "an object at rest has no pose to find");
        let moving = of(Some("hypotheses")).picture().unwrap().svg();
        assert!(moving.contains("last pose right") && moving.contains("hypotheses"));

        let row = planning::Row {
            object: "ellipse:0.12x0.06, strict".into(),
            strategy: "lookahead",
            reached: Proportion { successes: 2, of: 4 },
            actions: (7.0, 1.0),
            decisions: 6.0,
            seconds: (31.5, 4.0),
            way: (1.0, 2.0),
            choosing_ms: 5.0,
        };
        let planned = planning::Table { rows: vec![row] }.picture().unwrap().svg();
        assert!(planned.contains(">ellipse:0.12x0.06, strict: lookahead</text>"));
        assert!(planned.contains("31.5"), "its value is written");
    }
}
