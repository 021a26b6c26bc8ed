//! The thesis' figures about pose graphs (3.3.3, 3.5.2, 3.6): its pairwise graph as printed and as we have
//! it, and the joint graph beside it.
//!
//! Pictures of shapes show seed 0; the numbers are over all seeds.

mod drawings;

use std::fmt;
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;

use super::figure::{Drawn, FigureError};
use super::tracking::judge::{Judgement, Truth};
use super::tracking::{Followed, full_noise, mujoco};
use super::{Spread, with_room};
use crate::graph;
use crate::graph::pairwise::{self, constraints::Rules};
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::track::Step;
use crate::slam::trackers::Kind;
use crate::view::curves::{self, Curve, Mark, Plot, Scale};
use crate::view::drawing::Drawing;

/// Whose poses the graphs correct.
const TRACKER: Kind = Kind::Hypotheses;

/// What a figure shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// As the command line names it.
    pub name: &'static str,
    title: &'static str,
    objects: &'static [&'static str],
    view: View,
    /// What the thesis says.
    thesis: &'static str,
}

#[derive(Clone, Copy, Debug)]
enum View {
    /// Nodes and edges.
    Graph,
    /// Contacts by face.
    Faces,
    /// Two grasps before and after registration.
    Alignment,
    /// Error against the number of constraints.
    Constraints(&'static [usize]),
    /// Error before and after the graphs, against the motion's noise in percent.
    Before(&'static [f64]),
    /// The same on recordings in this many dimensions.
    Recorded(usize),
}

const PLANAR: &[&str] = &[
    "rectangle:0.10x0.06",
    "hexagon:0.045",
    "corners:-0.05x-0.03,0.045x-0.035,0.055x0.02,-0.03x0.04",
];

/// All of them, in the thesis' order.
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "figure-3.7",
        title: "Figure 3.7: a pose graph, every node a grasp, every line a relative pose",
        objects: PLANAR,
        view: View::Graph,
        thesis: "drawing only",
    },
    Figure {
        name: "figure-3.8",
        title: "Figure 3.8: contacts segmented into faces (Appendix A)",
        objects: &["box:0.12x0.06x0.06", "lshape:0.09x0.09x0.035x0.05", "prism:0.08,hexagon:0.04"],
        view: View::Faces,
        thesis: "picture only",
    },
    Figure {
        name: "figure-3.9",
        title: "Figure 3.9: two grasps laid on each other's faces",
        objects: PLANAR,
        view: View::Alignment,
        thesis: "picture only",
    },
    Figure {
        name: "figure-3.15",
        title: "Figure 3.15: error against the number of constraints, 16 grasps at 100 % noise",
        objects: PLANAR,
        view: View::Constraints(&[0, 2, 4, 8, 16, 32, 64, 120]),
        thesis: "“the more constraints in the graph, the better the accuracy”",
    },
    Figure {
        name: "figure-3.16",
        title: "Figure 3.16: three planar objects before and after the graphs, 16 grasps",
        objects: PLANAR,
        view: View::Before(&[50.0, 100.0]),
        thesis: "“significantly improves the accuracy of the reconstruction”",
    },
    Figure {
        name: "figure-3.20",
        title: "Figure 3.20: outlines of recorded grasps before and after the graphs",
        objects: &[],
        view: View::Recorded(2),
        thesis: "real hand; small errors accumulate, the graph reduces them",
    },
    Figure {
        name: "figure-3.21",
        title: "Figure 3.21: bodies of recorded grasps before and after the graphs",
        objects: &[],
        view: View::Recorded(3),
        thesis: "real hand; the filter builds separate parts only, the graph joins them",
    },
];

/// The figure of that name.
pub fn figure(name: &str) -> Option<&'static Figure> {
    FIGURES.iter().find(|f| f.name == name)
}

/// What happens to the tracker's poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    /// Nothing.
    Filter,
    /// The pairwise graph as the thesis has it.
    Printed,
    /// The pairwise graph as we have it.
    Pairwise,
    /// The joint graph.
    Planes,
}

const METHODS: [Method; 4] = [Method::Filter, Method::Printed, Method::Pairwise, Method::Planes];

impl Method {
    fn name(self) -> &'static str {
        match self {
            Method::Filter => "filter only",
            Method::Printed => "as printed",
            Method::Pairwise => "pairwise",
            Method::Planes => "planes",
        }
    }

    /// The poses, and how many constraints made them and whether others are as likely.
    fn poses(self, log: &GraspLog, steps: &[Step], most: usize) -> Poses {
        let rules = Rules { most, as_printed: self == Method::Printed };
        let found = match self {
            Method::Filter => None,
            Method::Planes => {
                let followed = Followed::corrected(graph::Kind::Planes, log, steps.to_vec());
                return Poses { followed, constraints: 0, ambiguous: false };
            }
            Method::Printed | Method::Pairwise => pairwise::correct_by(log, steps, rules)
                .map(|c| (c.relative(), c.edges.len(), c.is_ambiguous())),
        };
        let (steps, constraints, ambiguous) = found.unwrap_or_else(|| (steps.to_vec(), 0, false));
        Poses { followed: steps.into(), constraints, ambiguous }
    }
}

struct Poses {
    followed: Followed,
    constraints: usize,
    ambiguous: bool,
}

/// One line of a figure's numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// What was grasped.
    pub object: String,
    /// By which graph.
    pub method: String,
    /// Constraints allowed, percent of noise, or nothing.
    pub at: Option<f64>,
    /// Runs.
    pub runs: usize,
    /// After the best rigid alignment, millimetres.
    pub hausdorff_mm: Option<Spread>,
    /// Contacts at the estimated poses to the true surface, root mean square, millimetres.
    pub contacts_mm: Option<Spread>,
    /// Root mean square error of all poses, millimetres.
    pub rms_mm: Option<Spread>,
    /// The same in degrees, up to symmetry.
    pub rms_deg: Option<Spread>,
    /// Constraints between similar grasps.
    pub constraints: Option<Spread>,
    /// Part of the runs that ended with several explanations.
    pub ambiguous: f64,
}

/// The numbers of a figure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Numbers {
    /// What the third column is.
    pub along: &'static str,
    /// Row by row.
    pub lines: Vec<Line>,
    /// What else there is to say, one line each.
    pub notes: Vec<String>,
}

/// An object and its simulation.
struct Subject {
    truth: Truth,
    options: Options,
}

impl Subject {
    /// At so many percent of the thesis' motion noise.
    fn new(object: &str, percent: f64) -> Result<Subject, SimError> {
        let spec: ObjectSpec = object.parse()?;
        let full = full_noise(spec.dimension());
        let part = percent / 100.0;
        let motion_noise = Deviation { length: part * full.length, angle: part * full.angle };
        let truth = Truth::new(spec.geometry()?);
        Ok(Subject { truth, options: Options { motion_noise, ..Options::new(spec) } })
    }

    /// The log of a seed and what the tracker makes of it.
    fn tracked(&self, seed: u64) -> Result<(GraspLog, Vec<Step>), SimError> {
        let log = simulate(&Options { seed, ..self.options.clone() })?.log;
        let steps = TRACKER.follow(&log, seed);
        Ok((log, steps))
    }
}

impl Figure {
    /// Makes the figure with seeds from 0 on; recordings are below `data`/mujoco.
    ///
    /// # Errors
    /// When an object cannot be simulated, recordings are missing or the picture cannot be drawn.
    pub fn draw(&self, data: Option<&Path>, seeds: u64) -> Result<Drawn<Numbers>, FigureError> {
        let mut drawn = Drawn {
            title: self.title,
            thesis: self.thesis,
            numbers: Numbers::default(),
            picture: Drawing::default(),
        };
        match self.view {
            View::Graph => drawings::graph(self.title, self.objects, &mut drawn)?,
            View::Faces => drawings::faces(self.title, self.objects, seeds, &mut drawn)?,
            View::Alignment => drawings::alignment(self.title, self.objects, seeds, &mut drawn)?,
            View::Constraints(most) => self.constraints(most, seeds, &mut drawn)?,
            View::Before(percents) => self.before(percents, seeds, &mut drawn)?,
            View::Recorded(dimension) => recorded(data, dimension, &mut drawn)?,
        }
        Ok(drawn)
    }

    fn constraints(
        &self,
        most: &[usize],
        seeds: u64,
        drawn: &mut Drawn<Numbers>,
    ) -> Result<(), FigureError> {
        drawn.numbers.along = "constraints";
        let mut plots = Vec::new();
        for object in self.objects {
            let subject = Subject::new(object, 100.0)?;
            let runs = tracked(&subject, seeds)?;
            let mut curves = Vec::new();
            for method in [Method::Printed, Method::Pairwise] {
                let mut marks = Vec::new();
                for &most in most {
                    let line = line(object, method, Some(most as f64), &subject.truth, &runs, most);
                    marks.extend(line.hausdorff_mm.map(|s| mark(most as f64, s)));
                    drawn.numbers.lines.push(line);
                }
                curves.push(Curve { name: method.name().into(), marks });
            }
            plots.push(plot(object, "constraints allowed", curves));
        }
        drawn.picture = curves::render(&plots)?;
        Ok(())
    }

    fn before(
        &self,
        percents: &[f64],
        seeds: u64,
        drawn: &mut Drawn<Numbers>,
    ) -> Result<(), FigureError> {
        drawn.numbers.along = "noise %";
        let mut plots = Vec::new();
        for object in self.objects {
            let mut curves: Vec<Curve> =
                METHODS.map(|m| Curve { name: m.name().into(), marks: Vec::new() }).into();
            for percent in percents {
                let subject = Subject::new(object, *percent)?;
                let runs = tracked(&subject, seeds)?;
                for (curve, method) in curves.iter_mut().zip(METHODS) {
                    let at = Some(*percent);
                    let line = line(object, method, at, &subject.truth, &runs, usize::MAX);
                    curve.marks.extend(line.hausdorff_mm.map(|s| mark(*percent, s)));
                    drawn.numbers.lines.push(line);
                }
            }
            plots.push(plot(object, "motion noise, % of 10 mm and 20°", curves));
        }
        drawn.picture = curves::render(&plots)?;
        Ok(())
    }
}

/// Logs and what the tracker makes of them, by seed.
fn tracked(subject: &Subject, seeds: u64) -> Result<Vec<(GraspLog, Vec<Step>)>, SimError> {
    with_room(|| (0..seeds).into_par_iter().map(|seed| subject.tracked(seed)).collect())
}

/// Recordings of a Shadow Hand in MuJoCo, those with noise.
fn recorded(
    data: Option<&Path>,
    dimension: usize,
    drawn: &mut Drawn<Numbers>,
) -> Result<(), FigureError> {
    drawn.numbers.along = "grasps";
    let mut curves: Vec<Curve> =
        METHODS.map(|m| Curve { name: m.name().into(), marks: Vec::new() }).into();
    let mut number = 0.0;
    for file in mujoco::recordings(data, &[])? {
        let name = mujoco::name(&file);
        if name.ends_with(".clean") || !name.contains(&format!("_{dimension}d_")) {
            continue;
        }
        let recording = mujoco::read(&file)?;
        number += 1.0;
        let steps = with_room(|| TRACKER.follow(&recording.log, 0));
        let grasps = Some(recording.log.grasps.len() as f64);
        let run = [(recording.log, steps)];
        for (curve, method) in curves.iter_mut().zip(METHODS) {
            let line = line(&recording.name, method, grasps, &recording.truth, &run, usize::MAX);
            curve.marks.extend(line.hausdorff_mm.map(|s| mark(number, s)));
            drawn.numbers.lines.push(line);
        }
    }
    for method in METHODS {
        let of = |l: &&Line| l.method == method.name();
        let medians = |f: fn(&Line) -> Option<Spread>| {
            let all = drawn.numbers.lines.iter().filter(of).filter_map(f).map(|s| s.median);
            Spread::of(all).map_or("–".to_owned(), |s| s.to_string())
        };
        drawn.numbers.notes.push(format!(
            "{}: Hausdorff {}, contacts {}, poses {} mm over all recordings",
            method.name(),
            medians(|l| l.hausdorff_mm),
            medians(|l| l.contacts_mm),
            medians(|l| l.rms_mm)
        ));
    }
    drawn.picture = curves::render(&[plot("recordings", "number of the recording", curves)])?;
    Ok(())
}

/// What a method makes of runs.
fn line(
    object: &str,
    method: Method,
    at: Option<f64>,
    truth: &Truth,
    runs: &[(GraspLog, Vec<Step>)],
    most: usize,
) -> Line {
    let one = |(log, steps): &(GraspLog, Vec<Step>)| {
        let poses = method.poses(log, steps, most);
        (poses.followed.judged(log, truth), poses)
    };
    let found: Vec<(Option<Judgement>, Poses)> = with_room(|| runs.par_iter().map(one).collect());
    let judged: Vec<Judgement> = found.iter().filter_map(|f| f.0).collect();
    let spread = |f: fn(&Judgement) -> Option<f64>| Spread::of(judged.iter().filter_map(f));
    let graph = matches!(method, Method::Printed | Method::Pairwise);
    let ambiguous = found.iter().filter(|f| f.1.ambiguous).count();
    Line {
        object: object.into(),
        method: method.name().into(),
        at,
        runs: found.len(),
        hausdorff_mm: spread(|j| Some(1e3 * j.hausdorff?)),
        contacts_mm: spread(|j| Some(1e3 * j.contacts)),
        rms_mm: spread(|j| Some(1e3 * j.rms.translation)),
        rms_deg: spread(|j| Some(j.rms.rotation.to_degrees())),
        constraints: Spread::of(found.iter().filter(|_| graph).map(|f| f.1.constraints as f64)),
        ambiguous: ambiguous as f64 / found.len().max(1) as f64,
    }
}

fn mark(x: f64, spread: Spread) -> Mark {
    Mark { x, low: spread.low, median: spread.median, high: spread.high }
}

fn plot(title: &str, across: &str, curves: Vec<Curve>) -> Plot {
    Plot {
        title: title.into(),
        across: across.into(),
        up: "Hausdorff distance, mm: median and quartiles".into(),
        scales: [Scale::Linear, Scale::Logarithmic],
        curves,
    }
}

impl fmt::Display for Numbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, note) in self.notes.iter().enumerate() {
            write!(f, "{}  {note}", if i > 0 { "\n" } else { "" })?;
        }
        if self.lines.is_empty() {
            return Ok(());
        }
        write!(
            f,
            "{}  {:<30}{:<13}{:>11}{:>6}  {:<22}{:<20}{:<22}{:<22}{:<14}ambiguous",
            if self.notes.is_empty() { "" } else { "\n" },
            "object",
            "graph",
            self.along,
            "runs",
            "Hausdorff mm",
            "contacts mm",
            "poses mm",
            "poses °",
            "constraints"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        for line in &self.lines {
            let object: String = line.object.chars().take(28).collect();
            write!(
                f,
                "\n  {object:<29} {:<13}{:>11}{:>6}  {:<22}{:<20}{:<22}{:<22}{:<14}{:.0} %",
                line.method,
                line.at.map_or("–".to_owned(), |at| at.to_string()),
                line.runs,
                show(&line.hausdorff_mm),
                show(&line.contacts_mm),
                show(&line.rms_mm),
                show(&line.rms_deg),
                line.constraints.map_or("–".to_owned(), |s| format!("{:.0}", s.median)),
                100.0 * line.ambiguous,
            )?;
        }
        write!(
            f,
            "\n  median [quartiles]; tracker {}; Hausdorff after the best rigid alignment; contacts and \
             poses: root mean squares,\n  contacts to the true surface, poses up to the object's symmetry",
            TRACKER.name()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_thesis_own() {
        for number in [7, 8, 9, 15, 16, 20, 21] {
            assert!(figure(&format!("figure-3.{number}")).is_some());
        }
        assert!(figure("figure-3.14").is_none());
    }

    #[test]
    fn every_method_is_judged_on_the_same_runs() {
        let subject = Subject::new("rectangle:0.10x0.06", 50.0).unwrap();
        let runs = tracked(&subject, 2).unwrap();
        let of = |method| line("rectangle", method, None, &subject.truth, &runs, 6);
        let [filter, printed, pairwise] =
            [Method::Filter, Method::Printed, Method::Pairwise].map(of);
        assert_eq!((filter.runs, filter.constraints), (2, None));
        for line in [&printed, &pairwise] {
            assert!(line.constraints.unwrap().high <= 6.0, "{line:?}");
            assert!(line.contacts_mm.unwrap().median < 4.0, "{line:?}");
        }
        // No constraints: the tracker's poses.
        let none = line("rectangle", Method::Pairwise, None, &subject.truth, &runs, 0);
        assert_eq!(none.hausdorff_mm, filter.hausdorff_mm);
    }

    #[test]
    fn recordings_that_are_not_there_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let error = figure("figure-3.20").unwrap().draw(Some(folder.path()), 1).unwrap_err();
        assert!(error.to_string().contains("mujoco"), "{error}");
    }
}
