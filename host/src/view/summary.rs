//! `summary.png` and `summary.svg`: a run at a glance.

use super::canvas::{Anchor, Canvas, Frame, Style};
use super::chart::{self, label, round_step};
use super::colour::{self, INK, PANEL, PAPER, QUIET, TRUTH, UNKNOWN};
use super::drawing::{Drawing, PictureError};
use super::{model, plane};
use crate::shape::Geometry;
use crate::space::Point;

/// Width and height of the picture in pixels.
pub const SIZE: (u32, u32) = (1600, 900);

/// What the picture shows, all in one frame (the true object frame if there is a truth), SI units.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The headline.
    pub title: String,
    /// Key figures as name and value with unit; about six fit.
    pub figures: Vec<(String, String)>,
    /// The true shape.
    pub truth: Option<Geometry>,
    /// The estimated shape.
    pub estimate: Geometry,
    /// Standard deviation at each vertex of the estimate, metres (loop after loop for an outline);
    /// missing or not finite is drawn as unknown.
    pub deviations: Vec<f64>,
    /// Contact points, unit normals where measured, and the grasp each belongs to, from 0.
    pub contacts: Vec<(Point, Option<Point>, usize)>,
    /// Translation in millimetres and rotation in degrees after each grasp, against the truth.
    pub pose_errors: Option<Vec<(f64, f64)>>,
}

/// One contact that lies in the picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    pub point: Point,
    pub normal: Option<Point>,
    pub grasp: usize,
}

/// What the scenes of either dimension need.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    /// Corners of the box the picture covers, metres.
    pub bounds: (Point, Point),
    /// The deviation at the end of the colour scale, metres.
    pub scale_end: f64,
    pub deviations: Vec<f64>,
    pub touches: Vec<Touch>,
    /// Contacts too far away to be in the picture.
    pub left_out: usize,
    pub grasps: usize,
}

impl Shown {
    pub fn new(summary: &Summary) -> Self {
        let mut shapes = summary.estimate.vertices();
        shapes.extend(summary.truth.iter().flat_map(Geometry::vertices));
        let points: Vec<Point> = summary.contacts.iter().map(|c| c.0).collect();
        let (least, greatest) = match corners(&shapes).or_else(|| corners(&points)) {
            Some(bounds) => bounds,
            None => (Point::repeat(-0.05), Point::repeat(0.05)),
        };
        // Contacts may widen the picture by a quarter of the object; those farther out are
        // outliers and must not shrink everything else.
        let room = (0.25 * (greatest - least).norm()).max(0.01);
        let near =
            |p: &Point| (0..3).all(|a| p[a] >= least[a] - room && p[a] <= greatest[a] + room);
        let touches: Vec<Touch> = summary
            .contacts
            .iter()
            .filter(|c| near(&c.0))
            .map(|(point, normal, grasp)| Touch {
                point: *point,
                normal: normal.filter(|n| n.iter().all(|c| c.is_finite())),
                grasp: *grasp,
            })
            .collect();
        shapes.extend(touches.iter().map(|t| t.point));
        let (least, greatest) = corners(&shapes).unwrap_or((least, greatest));
        let thin = Point::repeat(5e-3);
        let deviations: Vec<f64> = summary
            .deviations
            .iter()
            .map(|d| if d.is_finite() && *d >= 0.0 { *d } else { f64::NAN })
            .collect();
        Self {
            bounds: (least - thin, greatest + thin),
            scale_end: scale_end(&deviations),
            deviations,
            left_out: summary.contacts.len() - touches.len(),
            grasps: summary.contacts.iter().map(|c| c.2 + 1).max().unwrap_or(0),
            touches,
        }
    }

    /// Of a vertex of the estimate, metres; not a number where unknown.
    pub fn deviation(&self, vertex: usize) -> f64 {
        self.deviations.get(vertex).copied().unwrap_or(f64::NAN)
    }
}

/// Draws the summary, a picture of [`SIZE`]. Empty shapes, missing or undefined deviations and absurd
/// coordinates are drawn as far as they make sense, never an error.
///
/// # Errors
/// When the bundled typeface cannot be read.
pub fn render(summary: &Summary) -> Result<Drawing, PictureError> {
    let (width, height) = SIZE;
    let mut canvas = Canvas::new(width, height, PAPER)?;
    let shown = Shown::new(summary);

    // A long title is set smaller before it is cut.
    let sizes = [30.0, 26.0, 22.0, 19.0];
    let headlines = sizes.map(|size| Style::new(size, INK).bold());
    let fits = |style: &&Style| canvas.text_width(**style, &summary.title) <= 1520.0;
    let headline = *headlines.iter().find(fits).unwrap_or(&headlines[sizes.len() - 1]);
    let title = canvas.fitted(headline, &summary.title, 1520.0);
    canvas.text([40.0, 58.0], headline, &title);
    figures(&mut canvas, &summary.figures);

    let main = Frame { left: 40.0, top: 160.0, width: 1050.0, height: 704.0 };
    match (&summary.estimate, &summary.truth) {
        (Geometry::Outline(estimate), truth) => {
            let truth = match truth {
                Some(Geometry::Outline(t)) => Some(t),
                _ => None,
            };
            plane::draw(&mut canvas, &main, &shown, estimate, truth);
        }
        (Geometry::Mesh(estimate), truth) => {
            let truth = match truth {
                Some(Geometry::Mesh(t)) => Some(t),
                _ => None,
            };
            model::draw(&mut canvas, &main, &shown, estimate, truth);
        }
    }

    let side = Frame { left: 1114.0, width: 446.0, ..main };
    legend(&mut canvas, &Frame { height: 296.0, ..side }, summary, &shown);
    let below = side.inset(0.0, 320.0, 0.0, 0.0);
    match &summary.pose_errors {
        Some(errors) if !errors.is_empty() => chart::pose_errors(&mut canvas, &below, errors),
        _ => chart::uncertainty(&mut canvas, &below, &shown.deviations, shown.scale_end),
    }
    Ok(canvas.finish())
}

/// Name above value, side by side.
fn figures(canvas: &mut Canvas, figures: &[(String, String)]) {
    let name_style = Style::new(14.0, QUIET);
    let value_style = Style::new(22.0, INK).bold();
    let mut x = 40.0;
    for (name, value) in figures {
        let wide = canvas.text_width(name_style, name).max(canvas.text_width(value_style, value));
        if x + wide > 1560.0 {
            break;
        }
        canvas.text([x, 98.0], name_style, name);
        canvas.text([x, 128.0], value_style, value);
        x += wide + 44.0;
    }
}

fn legend(canvas: &mut Canvas, frame: &Frame, summary: &Summary, shown: &Shown) {
    canvas.fill_card(frame, 10.0, PANEL);
    let (left, width) = (frame.left + 22.0, frame.width - 44.0);
    let name = Style::new(16.0, INK);
    let note = Style::new(13.0, QUIET);
    let mut y = frame.top + 36.0;

    canvas.text([left, y], name, "estimated surface, by standard deviation");
    let end = shown.scale_end * 1e3;
    bar(canvas, Frame { left, top: y + 12.0, width, height: 14.0 }, colour::uncertainty);
    for (share, anchor) in [(0.0, Anchor::Start), (0.5, Anchor::Middle), (1.0, Anchor::End)] {
        let at = [left + width * share as f32, y + 44.0];
        let mut text = label(end * share) + " mm";
        if share == 1.0 && shown.deviations.iter().any(|d| *d > shown.scale_end * 1.001) {
            text = format!("≥ {text}");
        }
        canvas.text(at, note.anchored(anchor), &text);
    }
    y += 82.0;

    canvas.text([left, y], name, "contacts, by grasp");
    bar(canvas, Frame { left, top: y + 12.0, width, height: 14.0 }, |share| {
        let last = shown.grasps.saturating_sub(1);
        colour::grasp((share * last as f64).round() as usize, shown.grasps)
    });
    canvas.text([left, y + 44.0], note, "first");
    let count = match shown.grasps {
        0 => "no contacts".into(),
        1 => "1 grasp".into(),
        n => format!("last of {n} grasps"),
    };
    canvas.text([left + width, y + 44.0], note.anchored(Anchor::End), &count);
    y += 80.0;

    let sample = |y: f32| [[left, y - 6.0], [left + 34.0, y - 6.0]];
    if summary.truth.is_some() {
        canvas.line(&sample(y), 2.2, TRUTH);
        let text = match summary.estimate {
            Geometry::Outline(_) => "true shape",
            Geometry::Mesh(_) => "true shape (faint where hidden)",
        };
        canvas.text([left + 48.0, y], name, text);
        y += 30.0;
    }
    if let Geometry::Outline(_) = summary.estimate {
        let pale = colour::uncertainty(0.35);
        canvas.line(&sample(y), 14.0, pale.mixed(PAPER, 0.72));
        canvas.line(&sample(y), 5.0, pale);
        canvas.text([left + 48.0, y], name, "estimate ± 2 standard deviations");
        y += 30.0;
    }
    let unknown = shown.deviations.iter().filter(|d| d.is_nan()).count();
    if crate::shape::metrics::is_empty(&summary.estimate) {
        canvas.text([left, y], name, "no surface was estimated");
        y += 30.0;
    } else if unknown > 0 || shown.deviations.is_empty() {
        canvas.line(&sample(y), 6.0, UNKNOWN);
        canvas.text([left + 48.0, y], name, "uncertainty unknown");
        y += 30.0;
    }
    if shown.left_out > 0 {
        let text = format!("{} contacts lie outside the picture", shown.left_out);
        canvas.text([left, y], name, &text);
    }
}

pub(super) fn bar(canvas: &mut Canvas, frame: Frame, tint: impl Fn(f64) -> colour::Colour) {
    let (columns, rows) = (frame.width as usize, frame.height as usize);
    let row: Vec<[f32; 4]> =
        (0..columns).map(|i| tint((i as f64 + 0.5) / columns as f64).0).collect();
    canvas.overlay(frame.left, frame.top, columns as u32, &row.repeat(rows));
}

/// A round end for the colour scale: 95 % of the surface lies below it.
pub(super) fn scale_end(deviations: &[f64]) -> f64 {
    let mut known: Vec<f64> = deviations.iter().copied().filter(|d| d.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    let wanted = known.get(known.len() * 95 / 100).copied().unwrap_or(0.0) * 1e3;
    let step = if wanted > 1e-3 { round_step(wanted / 2.0) } else { 0.5 };
    2.0 * step / 1e3
}

/// Of the finite points among `points`; `None` if there are none.
fn corners(points: &[Point]) -> Option<(Point, Point)> {
    let finite = points.iter().filter(|p| p.iter().all(|c| c.is_finite()));
    finite.fold(None, |bounds: Option<(Point, Point)>, p| {
        Some(bounds.map_or((*p, *p), |(least, greatest)| (least.inf(p), greatest.sup(p))))
    })
}

#[cfg(test)]
#[path = "summary_tests.rs"]
mod tests;
