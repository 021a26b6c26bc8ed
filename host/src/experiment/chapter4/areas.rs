//! Figure 4.3: the uncertain parts of a surface, divided into contact areas.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::{FigureError, touched};
use crate::experiment::Spread;
use crate::explore::areas::{areas, facing};
use crate::explore::clustering::{Area, Linkage, Settings, Weights};
use crate::explore::prediction::predict;
use crate::sim::{Options, SimError};
use crate::space::Point;
use crate::view::drawing::Drawing;
use crate::view::sheet::{self, Panel, Sheet};

const OBJECTS: [&str; 3] =
    ["box:0.06x0.06x0.06", "cylinder:0.06x0.1", "lshape:0.09x0.09x0.035x0.05"];

/// Grasps made before.
const GRASPS: usize = 2;

/// Ways to divide, the first one ours.
const WAYS: [(&str, Linkage, Weights); 4] = [
    ("complete, 4.19", Linkage::Complete, Weights::THESIS),
    ("complete, B.2", Linkage::Complete, Weights::APPENDIX),
    ("average, 4.19", Linkage::Average, Weights::THESIS),
    ("single, 4.19", Linkage::Single, Weights::THESIS),
];

/// How one way divides one object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Division {
    /// What was touched twice.
    pub object: &'static str,
    /// Linkage, and weights by their place in the thesis.
    pub way: &'static str,
    /// Runs that made a surface, of how many.
    pub runs: (usize, usize),
    /// Contact areas.
    pub areas: Option<Spread>,
    /// Greatest distance between two points of one area, millimetres.
    pub widest_mm: Option<Spread>,
    /// Greatest angle between two normals of one area, degrees.
    pub bent_deg: Option<Spread>,
    /// Share of areas that one of the grasps that face them is expected to touch.
    pub touched: Option<Spread>,
}

fn options(object: &str, seed: u64) -> Result<Options, FigureError> {
    let object = object.parse().map_err(SimError::from)?;
    Ok(Options { grasps: Some(GRASPS), seed, ..Options::new(object) })
}

fn settings(way: usize) -> Settings {
    Settings { linkage: WAYS[way].1, weights: WAYS[way].2, ..Settings::default() }
}

/// One row for each object and way.
pub(super) fn divide(seeds: u64) -> Result<Vec<Division>, FigureError> {
    let mut lines = Vec::new();
    for object in OBJECTS {
        options(object, 0)?;
        let one = |seed| {
            let (belief, _) = touched(&options(object, seed).ok()?).ok()?;
            Some([0, 1, 2, 3].map(|way| {
                let (points, areas) = areas(&belief, &settings(way));
                let (widest, bent) = extent(&points, &areas);
                let met = areas.iter().filter(|area| {
                    let near =
                        |p: Point| area.members.iter().any(|m| (points[*m].0 - p).norm() < 0.01);
                    predict(&belief, &facing(&belief, area)).iter().flatten().any(|e| near(e.point))
                });
                let met = met.count() as f64 / areas.len() as f64;
                [areas.len() as f64, 1e3 * widest, bent.to_degrees(), met]
            }))
        };
        let runs: Vec<Option<[[f64; 4]; 4]>> = (0..seeds).into_par_iter().map(one).collect();
        for (way, (name, ..)) in WAYS.iter().enumerate() {
            let spread = |k: usize| Spread::of(runs.iter().flatten().map(|run| run[way][k]));
            lines.push(Division {
                object,
                way: name,
                runs: (runs.iter().flatten().count(), runs.len()),
                areas: spread(0),
                widest_mm: spread(1),
                bent_deg: spread(2),
                touched: spread(3),
            });
        }
    }
    Ok(lines)
}

/// Greatest distance and greatest angle within an area, metres and radians.
fn extent(points: &[(Point, Point)], areas: &[Area]) -> (f64, f64) {
    let pairs = areas.iter().flat_map(|area| {
        area.members.iter().flat_map(|i| area.members.iter().map(move |j| (*i, *j)))
    });
    pairs.fold((0.0, 0.0), |(wide, bent): (f64, f64), (i, j)| {
        let ((p, n), (q, m)) = (&points[i], &points[j]);
        (wide.max((p - q).norm()), bent.max(n.angle(m)))
    })
}

/// Seed 0 of each object, divided by complete and by single linkage.
pub(super) fn picture(title: &str) -> Result<Drawing, FigureError> {
    let mut panels = Vec::new();
    for object in OBJECTS {
        let (belief, truth) = touched(&options(object, 0)?)?;
        for way in [0, 3] {
            let (points, areas) = areas(&belief, &settings(way));
            let (widest, bent) = extent(&points, &areas);
            let dots = areas
                .iter()
                .enumerate()
                .flat_map(|(number, area)| area.members.iter().map(move |m| (*m, number)));
            let (contacts, groups) = dots.map(|(m, number)| ((points[m].0, None), number)).unzip();
            panels.push(Panel {
                title: format!("{object}, {}", WAYS[way].0),
                note: format!(
                    "{} areas, up to {:.0} mm and {:.0}°",
                    areas.len(),
                    1e3 * widest,
                    bent.to_degrees()
                ),
                truth: truth.clone(),
                deviations: Vec::new(),
                estimate: Some(belief.geometry.clone()),
                contacts,
                groups,
                links: Vec::new(),
            });
        }
    }
    Ok(sheet::render(&Sheet { title: title.into(), columns: 2, panels })?)
}

pub(super) fn show(f: &mut fmt::Formatter<'_>, lines: &[Division]) -> fmt::Result {
    writeln!(
        f,
        "  {:<30}{:<16}{:>7}  {:<24}{:<26}{:<26}areas met",
        "object", "linkage, weights", "runs", "areas", "widest mm", "bent °"
    )?;
    let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
    for line in lines {
        writeln!(
            f,
            "  {:<30}{:<16}{:>7}  {:<24}{:<26}{:<26}{}",
            line.object,
            line.way,
            format!("{}/{}", line.runs.0, line.runs.1),
            show(&line.areas),
            show(&line.widest_mm),
            show(&line.bent_deg),
            show(&line.touched)
        )?;
    }
    write!(
        f,
        "  median [quartiles] over seeds; widest and bent: of the least alike points of one area; met: \
         share of areas that a grasp facing them is expected to touch"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complete_linkage_spreads_less_than_single_linkage() {
        let (belief, _) = touched(&options(OBJECTS[0], 0).unwrap()).unwrap();
        let [complete, single] = [0, 3].map(|way| {
            let (points, areas) = areas(&belief, &settings(way));
            (areas.len(), extent(&points, &areas))
        });
        assert!(complete.0 >= 4, "{complete:?}");
        let ((wide, bent), (wider, more_bent)) = (complete.1, single.1);
        assert!(wide < 0.7 * wider && bent < more_bent, "{complete:?} {single:?}");
    }
}
