//! The thesis' figures of chapter 2 as pictures and numbers: its kernels, and ours beside them.
//!
//! A picture shows seed 0; the numbers are over all seeds. Figure 2.13 is a photograph of sensors,
//! and figures before 2.5 illustrate methods.

use rayon::prelude::*;
use serde::Serialize;

use super::Spread;
use super::figure::{Drawn, FigureError};
use super::model::{Model, Shape};
use super::touches::{Source, Touched};
use crate::shape::{align::align, metrics};
use crate::space::Point;
use crate::view::curves::{self, Curve, Mark, Plot, Scale};
use crate::view::sheet::{self, Panel, Sheet};

/// What a figure shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// As the command line names it.
    pub name: &'static str,
    title: &'static str,
    /// What is touched, how, and how often.
    subjects: &'static [(Source, &'static [usize])],
    models: &'static [Model],
    view: View,
    /// What the thesis says.
    thesis: &'static str,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum View {
    /// A sheet of reconstructions: a row for every model, or one for every subject where the number
    /// of contacts does not change.
    Sheet,
    /// Hausdorff distance against the number of contacts.
    Curves,
}

const RECTANGLE: Source = Source::Uniform("rectangle:0.12x0.06");
const BOX: Source = Source::Uniform("box:0.12x0.06x0.06");
const PROGRESS: &[usize] = &[4, 8, 12, 20, 32, 60];

/// All of them, in the thesis' order.
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "figure-2.5",
        title: "Figure 2.5: a rectangle, step by step, squared exponential",
        subjects: &[(RECTANGLE, PROGRESS)],
        models: &[Model::SquaredExponential, Model::Auto],
        view: View::Sheet,
        thesis: "edges rounded, overshoot at corners",
    },
    Figure {
        name: "figure-2.6",
        title: "Figure 2.6: a rectangle, step by step, thin plate",
        subjects: &[(RECTANGLE, PROGRESS)],
        models: &[Model::ThinPlate, Model::Auto],
        view: View::Sheet,
        thesis: "smooth curves between contacts",
    },
    Figure {
        name: "figure-2.7",
        title: "Figure 2.7: shape error against the number of contacts",
        subjects: &[
            (RECTANGLE, &[5, 10, 15, 20, 30, 40, 60]),
            (Source::Uniform("ellipse:0.12x0.06"), &[5, 10, 15, 20, 30, 40, 60]),
        ],
        models: &[Model::SquaredExponential, Model::ThinPlate, Model::Gp, Model::Auto],
        view: View::Curves,
        thesis: "TP better with few contacts, SE at corners; below 3 mm with many",
    },
    Figure {
        name: "figure-2.8",
        title: "Figure 2.8: an apple touched from one side, by prior mean",
        subjects: &[(Source::Apple, &[40])],
        models: &[Model::Outside, Model::Undecided, Model::Gp],
        view: View::Sheet,
        thesis: "outside: too small; zero: too large; sphere: coherent",
    },
    Figure {
        name: "figure-2.9",
        title: "Figure 2.9: a corner from three contacts",
        subjects: &[(Source::Corner, &[3])],
        models: &[Model::SquaredExponential, Model::Gp, Model::Local],
        view: View::Sheet,
        thesis: "local features keep the corner",
    },
    Figure {
        name: "figure-2.10",
        title: "Figure 2.10: part of a cube from a few contacts",
        subjects: &[(Source::Grasp("box:0.06x0.06x0.06"), &[5])],
        models: &[Model::ThinPlate, Model::Auto],
        view: View::Sheet,
        thesis: "picture only",
    },
    Figure {
        name: "figure-2.11",
        title: "Figure 2.11: a box of 12 × 6 × 6 cm, step by step",
        subjects: &[(BOX, &[10, 20, 40, 80])],
        models: &[Model::ThinPlate, Model::Auto],
        view: View::Sheet,
        thesis: "picture only",
    },
    Figure {
        name: "figure-2.12",
        title: "Figure 2.12: error of the box against the number of contacts",
        subjects: &[(BOX, &[10, 20, 30, 40, 60, 80, 120])],
        models: &[Model::SquaredExponential, Model::ThinPlate, Model::Gp, Model::Auto],
        view: View::Curves,
        thesis: "“approximately 80 contact points to obtain an accurate model”",
    },
    Figure {
        name: "figure-2.14",
        title: "Figure 2.14: parts of planar objects from one grasp",
        subjects: &[
            (Source::Grasp("rectangle:0.10x0.06"), &[5]),
            (Source::Grasp("triangle:0.06"), &[5]),
            (Source::Grasp("ellipse:0.12x0.06"), &[5]),
        ],
        models: &[Model::SquaredExponential, Model::ThinPlate, Model::Auto],
        view: View::Sheet,
        thesis: "SE straight between contacts, TP round",
    },
    Figure {
        name: "figure-2.15",
        title: "Figure 2.15: parts of a cube and a sphere from one grasp",
        subjects: &[
            (Source::Grasp("box:0.06x0.06x0.06"), &[5]),
            (Source::Grasp("sphere:0.07"), &[5]),
        ],
        models: &[Model::SquaredExponential, Model::ThinPlate, Model::Auto],
        view: View::Sheet,
        thesis: "SE flat, TP round between contacts",
    },
];

/// The figure of that name.
pub fn figure(name: &str) -> Option<&'static Figure> {
    FIGURES.iter().find(|f| f.name == name)
}

/// How far a shape is from the truth, millimetres, after the best rigid alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Error {
    hausdorff: f64,
    mean: f64,
    rms: f64,
    /// The greatest distance to the estimate from the touched part of the true surface, unaligned.
    touched: f64,
}

/// A true surface point no farther than this from a contact is touched, metres.
const TOUCHED: f64 = 0.01;

/// Points drawn from the true surface to find its touched part.
const SAMPLES: usize = 4000;

impl Error {
    fn of(shape: &Shape, touched: &Touched) -> Option<Error> {
        let pose = align(&shape.geometry, &touched.truth);
        let d = metrics::compare_at(&shape.geometry, &pose, &touched.truth)?;
        let near = |p: &Point| touched.contacts.iter().any(|c| (c.point - p).norm() < TOUCHED);
        let part = touched.truth.samples(SAMPLES).into_iter().map(|(p, _)| p).filter(near);
        let worst = part.map(|p| shape.geometry.distance(&p)).fold(0.0, f64::max);
        Some(Error {
            hausdorff: 1e3 * d.hausdorff,
            mean: 1e3 * d.mean,
            rms: 1e3 * d.rms,
            touched: 1e3 * worst,
        })
    }
}

/// One line of a figure's numbers; lengths in millimetres.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// What was touched.
    pub object: String,
    /// How often.
    pub contacts: usize,
    /// By which model.
    pub model: &'static str,
    /// Runs that gave a shape, of how many.
    pub runs: (usize, usize),
    /// Hausdorff distance (thesis C.1) after the best rigid alignment.
    pub hausdorff_mm: Option<Spread>,
    /// Mean distance.
    pub mean_mm: Option<Spread>,
    /// Root mean square distance.
    pub rms_mm: Option<Spread>,
    /// Greatest distance to the estimate from the true surface within 10 mm of a contact, unaligned.
    pub touched_mm: Option<Spread>,
}

/// The numbers of a figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Numbers {
    /// Row by row.
    pub lines: Vec<Line>,
}

/// One model on one set of contacts.
struct Run {
    shape: Option<Shape>,
    error: Option<Error>,
}

impl Figure {
    /// Makes the figure with seeds from 0 on.
    ///
    /// # Errors
    /// When an object cannot be simulated or the picture cannot be drawn.
    pub fn draw(&self, seeds: u64) -> Result<Drawn<Numbers>, FigureError> {
        let (mut lines, mut panels, mut plots) = (Vec::new(), Vec::new(), Vec::new());
        for (source, counts) in self.subjects {
            let most = counts.iter().copied().max().unwrap_or(0);
            let all: Vec<Touched> =
                (0..seeds).map(|seed| source.touch(most, seed)).collect::<Result<_, _>>()?;
            let mut curves = Vec::new();
            for model in self.models {
                let mut marks = Vec::new();
                for count in *counts {
                    let runs: Vec<Run> =
                        all.par_iter().map(|touched| run(model, &touched.first(*count))).collect();
                    let line = line(source, *count, model, &runs);
                    marks.extend(line.hausdorff_mm.map(|s| mark(*count, &s)));
                    if let (Some(run), Some(touched)) = (runs.into_iter().next(), all.first()) {
                        panels.push(panel(&line, run, &touched.first(*count)));
                    }
                    lines.push(line);
                }
                curves.push(Curve { name: model.name().into(), marks });
            }
            plots.push(Plot {
                title: source.name().into(),
                across: "contacts".into(),
                up: "Hausdorff distance, mm: median and quartiles".into(),
                scales: [Scale::Linear, Scale::Logarithmic],
                curves,
            });
        }
        let columns = match self.subjects {
            [(_, counts)] if counts.len() > 1 => counts.len(),
            _ => self.models.len(),
        };
        let picture = match self.view {
            View::Curves => curves::render(&plots)?,
            View::Sheet => sheet::render(&Sheet { title: self.title.into(), columns, panels })?,
        };
        let numbers = Numbers { lines };
        Ok(Drawn { title: self.title, thesis: self.thesis, numbers, picture })
    }
}

fn run(model: &Model, touched: &Touched) -> Run {
    let shape = model.reconstruct(touched.truth.dimension(), &touched.contacts);
    let error = shape.as_ref().and_then(|s| Error::of(s, touched));
    Run { shape, error }
}

fn line(source: &Source, contacts: usize, model: &Model, runs: &[Run]) -> Line {
    let errors = || runs.iter().filter_map(|r| r.error);
    Line {
        object: source.name().into(),
        contacts,
        model: model.name(),
        runs: (errors().count(), runs.len()),
        hausdorff_mm: Spread::of(errors().map(|e| e.hausdorff)),
        mean_mm: Spread::of(errors().map(|e| e.mean)),
        rms_mm: Spread::of(errors().map(|e| e.rms)),
        touched_mm: Spread::of(errors().map(|e| e.touched)),
    }
}

fn mark(contacts: usize, spread: &Spread) -> Mark {
    Mark { x: contacts as f64, low: spread.low, median: spread.median, high: spread.high }
}

fn panel(line: &Line, run: Run, touched: &Touched) -> Panel {
    let note = match run.error {
        Some(e) => format!("Hausdorff {:.1} mm, touched part {:.1} mm", e.hausdorff, e.touched),
        None => "no surface".into(),
    };
    let (estimate, deviations) = match run.shape {
        Some(shape) => (Some(shape.geometry), shape.deviations),
        None => (None, Vec::new()),
    };
    Panel {
        title: format!("{}, {} contacts", line.model, line.contacts),
        note,
        truth: touched.truth.clone(),
        estimate,
        deviations,
        contacts: touched.contacts.iter().map(|c| (c.point, c.normal)).collect(),
        groups: Vec::new(),
        links: Vec::new(),
    }
}

impl std::fmt::Display for Numbers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "  {:<24}{:>9}  {:<12}{:>7}  {:<22}{:<20}{:<20}touched part mm",
            "object", "contacts", "model", "runs", "Hausdorff mm", "mean mm", "rms mm"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        for line in &self.lines {
            writeln!(
                f,
                "  {:<24}{:>9}  {:<12}{:>7}  {:<22}{:<20}{:<20}{}",
                line.object,
                line.contacts,
                line.model,
                format!("{}/{}", line.runs.0, line.runs.1),
                show(&line.hausdorff_mm),
                show(&line.mean_mm),
                show(&line.rms_mm),
                show(&line.touched_mm),
            )?;
        }
        write!(f, "  median [quartiles]; Hausdorff, mean and rms after the best rigid alignment")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_thesis_own() {
        for number in [5, 6, 7, 8, 9, 10, 11, 12, 14, 15] {
            assert!(figure(&format!("figure-2.{number}")).is_some());
        }
        assert!(figure("figure-2.13").is_none());
    }

    #[test]
    fn a_figure_has_numbers_and_a_picture() {
        let drawn = figure("figure-2.14").unwrap().draw(2).unwrap();
        assert_eq!(drawn.numbers.lines.len(), 9);
        assert!(drawn.picture.svg().contains(">auto, 5 contacts</text>"));
        // Five contacts say little about the whole, but where they touched, the surface is known.
        for line in drawn.numbers.lines.iter().filter(|l| l.model == "auto") {
            assert_eq!(line.runs, (2, 2));
            assert!(line.touched_mm.unwrap().median < 8.0, "{line:?}");
        }
    }

    #[test]
    fn the_touched_part_is_near_contacts() {
        let touched = Source::Uniform("rectangle:0.12x0.06").touch(1, 0).unwrap();
        let c = touched.contacts[0];
        // The truth moved by 2 mm along the one contact's normal: 2 mm off there.
        let mut moved = crate::space::Pose::identity();
        moved.translation.vector = c.normal.unwrap() * 2e-3;
        let shape = Shape { geometry: touched.truth.transformed(&moved), deviations: Vec::new() };
        let error = Error::of(&shape, &touched).unwrap();
        assert!((1.5..3.0).contains(&error.touched), "{error:?}");
        assert!(error.hausdorff < 0.1);
    }
}
