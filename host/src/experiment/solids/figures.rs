//! Figures 4.4 and 4.5 of the thesis: a cube grows grasp by grasp.
//!
//! Pictures show seed 0; the numbers are over all seeds.

use std::fmt;

use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use super::{NEAR, Reachable, bench, settings};
use crate::experiment::figure::{Drawn, FigureError};
use crate::experiment::{Spread, with_room};
use crate::explore::{Belief, Criterion, Settings, explore_until};
use crate::shape::{Field, Geometry};
use crate::sim::{ObjectSpec, SimError};
use crate::slam::choose::Choice;
use crate::slam::reconstruct::{Poses, Shape, shape};
use crate::space::{Point, Pose};
use crate::view::sheet::{self, Panel, Sheet};

/// The thesis does not say how large its cube is.
const CUBE: &str = "box:0.07x0.07x0.07";

/// Who chooses: ours, and what it is measured by.
const CRITERIA: [Criterion; 2] = [Criterion::Entropy, Criterion::Random];

/// What a figure shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// As the command line names it.
    pub name: &'static str,
    title: &'static str,
    /// What the thesis says.
    thesis: &'static str,
    /// After which grasps the shape is looked at.
    grasps: &'static [usize],
    /// Whether the picture shows all of these, or the last alone, as a surface and as faces.
    progress: bool,
}

/// In the thesis' order. Figures 4.1 to 4.3, 4.6 and 4.7 are not about how a solid grows.
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "figure-4.4",
        title: "Figure 4.4: a cube, grasp by grasp",
        thesis: "pictures of the first three grasps, without numbers",
        grasps: &[1, 2, 3, 5, 8, 12],
        progress: true,
    },
    Figure {
        name: "figure-4.5",
        title: "Figure 4.5: a reconstructed cube",
        thesis: "more than 80 grasps, 165 contacts; “sometimes fails to reach some contact areas”",
        grasps: &[5, 10, 20, 33],
        progress: false,
    },
];

/// The figure of that name.
pub fn figure(name: &str) -> Option<&'static Figure> {
    FIGURES.iter().find(|f| f.name == name)
}

/// The cube after so many grasps, over all seeds: median and quartiles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// What decided.
    pub criterion: &'static str,
    /// How many.
    pub grasps: usize,
    /// Felt by them.
    pub contacts: Option<Spread>,
    /// Part of the surface within 3 mm of the believed one, percent.
    pub known: Option<Spread>,
    /// Mean distance from the true surface to the believed one, millimetres.
    pub mean_mm: Option<Spread>,
    /// The greatest.
    pub greatest_mm: Option<Spread>,
}

/// The numbers of a figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Numbers {
    /// What was explored.
    pub object: &'static str,
    /// Row by row.
    pub lines: Vec<Line>,
}

/// What was believed after some grasp.
struct Shot {
    grasps: usize,
    belief: Belief,
    /// From the true object frame to the believed one.
    frame: Pose,
    /// From points of the true surface to the believed one, metres.
    distances: Vec<f64>,
}

impl Figure {
    /// Makes the figure with seeds from 0 on.
    ///
    /// # Errors
    /// When nothing comes of an exploration, or the picture cannot be drawn.
    pub fn draw(&self, seeds: u64) -> Result<Drawn<Numbers>, FigureError> {
        let spec: ObjectSpec = CUBE.parse().map_err(SimError::from)?;
        let truth = spec.geometry().map_err(SimError::from)?;
        let reachable = with_room(|| Reachable::of(&truth));
        let explore = |criterion, seed| self.explore(&spec, &reachable, criterion, seed);
        let mut lines = Vec::new();
        for criterion in CRITERIA {
            let runs: Result<Vec<Vec<Shot>>, FigureError> = with_room(|| {
                (0..seeds).into_par_iter().map(|seed| explore(criterion, seed)).collect()
            });
            let shots: Vec<Shot> = runs?.into_iter().flatten().collect();
            lines.extend(self.grasps.iter().map(|grasps| line(criterion, *grasps, &shots)));
        }
        let shots = with_room(|| explore(CRITERIA[0], 0))?;
        let panels: Vec<Panel> = if self.progress {
            shots.iter().map(|shot| panel(shot, &truth)).collect()
        } else {
            shots.last().map(|shot| pair(shot, &truth)).into_iter().flatten().collect()
        };
        let columns = if self.progress { 3 } else { 2 };
        let picture = sheet::render(&Sheet { title: self.title.into(), columns, panels })?;
        let numbers = Numbers { object: CUBE, lines };
        Ok(Drawn { title: self.title, thesis: self.thesis, numbers, picture })
    }

    fn explore(
        &self,
        spec: &ObjectSpec,
        reachable: &Reachable,
        criterion: Criterion,
        seed: u64,
    ) -> Result<Vec<Shot>, FigureError> {
        let most_actions = self.grasps.iter().copied().max().unwrap_or(1);
        let settings = Settings { most_actions, ..settings(criterion, None, seed) };
        let (mut shots, mut grasps) = (Vec::new(), 0);
        let look = |belief: &Belief, frame: &Pose| {
            grasps += 1;
            if self.grasps.contains(&grasps) {
                let from = |p: &Point| belief.geometry.distance(&(frame * Point3::from(*p)).coords);
                let distances = reachable.points.iter().map(from).collect();
                shots.push(Shot { grasps, belief: belief.clone(), frame: *frame, distances });
            }
            // Never enough: all shots are wanted.
            (0.0, f64::INFINITY)
        };
        explore_until(&mut bench(spec, false, seed)?, &settings, look, |_| ())?;
        Ok(shots)
    }
}

impl Shot {
    /// Percent within 3 mm.
    fn known(&self) -> f64 {
        let near = self.distances.iter().filter(|d| **d < NEAR).count();
        100.0 * near as f64 / self.distances.len().max(1) as f64
    }

    fn mean_mm(&self) -> f64 {
        1e3 * self.distances.iter().sum::<f64>() / self.distances.len().max(1) as f64
    }

    fn greatest_mm(&self) -> f64 {
        1e3 * self.distances.iter().copied().fold(0.0, f64::max)
    }

    fn note(&self) -> String {
        format!(
            "{:.0} % within 3 mm, mean {:.1} mm, greatest {:.1} mm",
            self.known(),
            self.mean_mm(),
            self.greatest_mm()
        )
    }
}

fn line(criterion: Criterion, grasps: usize, shots: &[Shot]) -> Line {
    let at = || shots.iter().filter(|s| s.grasps == grasps);
    let name = if criterion == Criterion::Random { "random" } else { "entropy" };
    Line {
        criterion: name,
        grasps,
        contacts: Spread::of(at().map(|s| s.belief.contacts.len() as f64)),
        known: Spread::of(at().map(Shot::known)),
        mean_mm: Spread::of(at().map(Shot::mean_mm)),
        greatest_mm: Spread::of(at().map(Shot::greatest_mm)),
    }
}

/// The Gaussian process' surface, the contacts of the last grasp in another colour.
fn panel(shot: &Shot, truth: &Geometry) -> Panel {
    let Belief { geometry, surface, contacts, .. } = &shot.belief;
    let deviations = match geometry {
        Geometry::Mesh(mesh) => surface.deviations(mesh.vertices()),
        Geometry::Outline(_) => Vec::new(),
    };
    let plural = if shot.grasps == 1 { "" } else { "s" };
    Panel {
        title: format!("{} grasp{plural}, {} contacts", shot.grasps, contacts.len()),
        note: shot.note(),
        truth: truth.transformed(&shot.frame),
        estimate: Some(geometry.clone()),
        deviations,
        contacts: contacts.iter().map(|c| (c.point, c.normal)).collect(),
        groups: Vec::new(),
        links: Vec::new(),
    }
}

/// The surface and what the contacts make where faces may be chosen.
fn pair(shot: &Shot, truth: &Geometry) -> [Panel; 2] {
    let surface = panel(shot, truth);
    let chosen =
        shape(3, &shot.belief.contacts, &[], Poses::Estimated, Choice::Auto, &|_, _| ()).ok();
    let faces = match chosen {
        Some(Shape { geometry: estimate, deviations, .. }) => {
            let from = |p: Point| estimate.distance(&(shot.frame * Point3::from(p)).coords);
            let all: Vec<f64> = truth.samples(400).into_iter().map(|(p, _)| from(p)).collect();
            let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
            let greatest = all.iter().copied().fold(0.0, f64::max);
            Panel {
                title: "the same contacts, model by evidence".into(),
                note: format!("mean {:.1} mm, greatest {:.1} mm", 1e3 * mean, 1e3 * greatest),
                estimate: Some(estimate),
                deviations,
                ..surface.clone()
            }
        }
        None => Panel { title: "no model".into(), estimate: None, ..surface.clone() },
    };
    [surface, faces]
}

impl fmt::Display for Numbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  object: {}", self.object)?;
        writeln!(
            f,
            "  {:<12}{:>8}  {:<24}{:<24}{:<22}greatest mm",
            "criterion", "grasps", "contacts", "% within 3 mm", "mean mm"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        for line in &self.lines {
            writeln!(
                f,
                "  {:<12}{:>8}  {:<24}{:<24}{:<22}{}",
                line.criterion,
                line.grasps,
                show(&line.contacts),
                show(&line.known),
                show(&line.mean_mm),
                show(&line.greatest_mm)
            )?;
        }
        write!(f, "  median [quartiles]; distances from the true surface to the believed one")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cube_grows_grasp_by_grasp() {
        let spec: ObjectSpec = "box:0.05x0.06x0.05".parse().unwrap();
        let truth = spec.geometry().unwrap();
        let reachable = Reachable::of(&truth);
        let short = Figure { grasps: &[1, 4], ..FIGURES[0] };
        let shots =
            with_room(|| short.explore(&spec, &reachable, Criterion::Entropy, 1000)).unwrap();
        let [first, last] = &shots[..] else { panic!("{}", shots.len()) };
        assert_eq!((first.grasps, last.grasps), (1, 4));
        assert!(last.known() > first.known() + 10.0, "{} {}", first.known(), last.known());
        assert!(last.mean_mm() < first.mean_mm());
        let line = line(Criterion::Entropy, 4, &shots);
        assert_eq!(line.known.unwrap().count, 1);
        assert_eq!(line.contacts.unwrap().median, last.belief.contacts.len() as f64);
        let panel = panel(last, &truth);
        let Some(Geometry::Mesh(mesh)) = &panel.estimate else { panic!() };
        assert_eq!(panel.deviations.len(), mesh.vertices().len());
    }
}
