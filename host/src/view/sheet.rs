//! A sheet of small pictures side by side: one reconstruction each, as the thesis' figures show them.

use super::canvas::{Anchor, Canvas, Frame, Style};
use super::chart::label;
use super::colour::{self, INK, PAPER, QUIET, TRUTH};
use super::drawing::{Drawing, PictureError};
use super::summary::{Shown, Summary, bar, scale_end};
use super::{model, plane};
use crate::shape::{Geometry, Mesh, Outline};
use crate::space::Point;

/// One picture of a sheet, all in one frame, SI units.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Above the picture: what was done.
    pub title: String,
    /// Below the title: what came of it.
    pub note: String,
    /// The true shape.
    pub truth: Geometry,
    /// The estimated shape; `None` where the model gave none.
    pub estimate: Option<Geometry>,
    /// Standard deviation at each vertex of the estimate, metres; may be empty.
    pub deviations: Vec<f64>,
    /// Contact points with unit normals where measured.
    pub contacts: Vec<(Point, Option<Point>)>,
    /// What each contact belongs to, from 0 on, which gives it its colour; may be empty.
    pub groups: Vec<usize>,
    /// Lines between places, in the plane only.
    pub links: Vec<[Point; 2]>,
}

/// Panels in rows under one headline, with one scale of colours.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// The headline.
    pub title: String,
    /// Panels in a row; at least one.
    pub columns: usize,
    /// Row by row.
    pub panels: Vec<Panel>,
}

/// Width and height of a panel with its texts, and the gap between two, pixels.
const PANEL: (f32, f32) = (440.0, 370.0);
const GAP: f32 = 20.0;

/// Above and below the panels, pixels.
const HEAD: f32 = 96.0;
const FOOT: f32 = 76.0;

/// Panels on one sheet at most: 10 000 pixels each way.
const MOST: usize = 400;

/// Draws the sheet and returns it. Panels beyond 400 are left out.
///
/// # Errors
/// When the picture cannot be made, see [`PictureError`].
pub fn render(sheet: &Sheet) -> Result<Drawing, PictureError> {
    let panels = &sheet.panels;
    let known =
        panels.iter().flat_map(|p| p.deviations.iter().copied()).map(|d| d.min(cap(panels)));
    let end = scale_end(&known.collect::<Vec<f64>>());
    assemble(sheet, end, &format!("standard deviation, 0 to {} mm", label(end * 1e3)))
}

/// The same for a quantity with another meaning, `deviations` being shares of each panel's own greatest
/// value, 0 to 1, and `caption` what the colours say. For meshes: outlines show a band in metres.
///
/// # Errors
/// As [`render`].
pub fn render_shares(sheet: &Sheet, caption: &str) -> Result<Drawing, PictureError> {
    assemble(sheet, 1.0, caption)
}

fn assemble(sheet: &Sheet, end: f64, caption: &str) -> Result<Drawing, PictureError> {
    let panels = &sheet.panels[..sheet.panels.len().min(MOST)];
    let columns = sheet.columns.clamp(1, 20);
    let rows = panels.len().div_ceil(columns);
    let width = 2.0 * GAP + columns as f32 * (PANEL.0 + GAP);
    let height = HEAD + rows as f32 * (PANEL.1 + GAP) + FOOT;
    let mut canvas = Canvas::new(width as u32, height as u32, PAPER)?;
    let headline = Style::new(26.0, INK).bold();
    let title = canvas.fitted(headline, &sheet.title, width - 3.0 * GAP);
    canvas.text([1.5 * GAP, 52.0], headline, &title);

    for (i, panel) in panels.iter().enumerate() {
        let frame = Frame {
            left: 1.5 * GAP + (i % columns) as f32 * (PANEL.0 + GAP),
            top: HEAD + (i / columns) as f32 * (PANEL.1 + GAP),
            width: PANEL.0,
            height: PANEL.1,
        };
        draw(&mut canvas, &frame, panel, end)?;
    }
    let coloured = panels.iter().any(|p| !p.deviations.is_empty());
    legend(&mut canvas, [1.5 * GAP, height - FOOT + 18.0], coloured.then_some(caption));
    Ok(canvas.finish())
}

/// What is uncertain by more than a tenth of an object is not known at all: the scale of colours
/// ends there, metres.
fn cap(panels: &[Panel]) -> f64 {
    let size = |p: &Panel| {
        let (low, high) = p.truth.bounds();
        (high - low).norm()
    };
    0.1 * panels.iter().map(size).fold(0.0, f64::max)
}

/// Draws one panel; its picture on a canvas of its own, which cuts off what leaves it.
fn draw(canvas: &mut Canvas, frame: &Frame, panel: &Panel, end: f64) -> Result<(), PictureError> {
    let (title, note) = (Style::new(17.0, INK).bold(), Style::new(14.0, QUIET));
    let fitted = canvas.fitted(title, &panel.title, frame.width);
    canvas.text([frame.left, frame.top + 18.0], title, &fitted);
    let fitted = canvas.fitted(note, &panel.note, frame.width);
    canvas.text([frame.left, frame.top + 40.0], note, &fitted);
    let within = frame.inset(0.0, 52.0, 0.0, 0.0);
    let mut own = Canvas::new(within.width as u32, within.height as u32, PAPER)?;
    let picture = Frame { left: 0.0, top: 0.0, ..within };
    let empty = match panel.truth {
        Geometry::Outline(_) => Geometry::Outline(Outline { loops: Vec::new() }),
        Geometry::Mesh(_) => Geometry::Mesh(Mesh::default()),
    };
    let scene = Summary {
        title: String::new(),
        figures: Vec::new(),
        truth: Some(panel.truth.clone()),
        estimate: panel.estimate.clone().unwrap_or(empty),
        deviations: panel.deviations.clone(),
        contacts: panel
            .contacts
            .iter()
            .enumerate()
            .map(|(i, (p, n))| (*p, *n, panel.groups.get(i).copied().unwrap_or(0)))
            .collect(),
        pose_errors: None,
    };
    let shown = Shown { scale_end: end, ..Shown::new(&scene) };
    match (&scene.estimate, &panel.truth) {
        (Geometry::Outline(estimate), Geometry::Outline(truth)) => {
            plane::draw(&mut own, &picture, &shown, estimate, Some(truth));
            plane::link(&mut own, &picture, &shown, &panel.links);
        }
        (Geometry::Mesh(estimate), Geometry::Mesh(truth)) => {
            model::draw_small(&mut own, &picture, &shown, estimate, Some(truth));
        }
        // A plane and a space have no common picture.
        _ => {}
    }
    let bare = panel.links.is_empty() && panel.groups.is_empty();
    if bare && panel.estimate.as_ref().is_none_or(crate::shape::metrics::is_empty) {
        let at = [picture.left + picture.width / 2.0, picture.top + picture.height / 2.0];
        own.text(at, Style::new(17.0, QUIET).anchored(Anchor::Middle), "no surface");
    }
    canvas.place([within.left, within.top], own);
    Ok(())
}

/// What the line means and, where panels are coloured, what the colours say.
fn legend(canvas: &mut Canvas, at: [f32; 2], caption: Option<&str>) {
    let [left, top] = at;
    let style = Style::new(14.0, QUIET);
    canvas.line(&[[left, top + 8.0], [left + 34.0, top + 8.0]], 2.2, TRUTH);
    canvas.text([left + 46.0, top + 13.0], style, "true shape");
    let Some(caption) = caption else { return };
    let (from, width) = (left + 150.0, 200.0);
    bar(canvas, Frame { left: from, top, width, height: 14.0 }, colour::uncertainty);
    canvas.text([from, top + 34.0], style, caption);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::mesh::tests::cuboid;

    fn outline(size: f64) -> Geometry {
        let corners = vec![[-size, -size], [size, -size], [size, size], [-size, size]];
        Geometry::Outline(Outline { loops: vec![corners] })
    }

    fn panel(truth: Geometry, estimate: Option<Geometry>) -> Panel {
        Panel {
            title: "10 contacts".into(),
            note: "Hausdorff 3.2 mm".into(),
            truth,
            estimate,
            deviations: vec![1e-3; 4],
            contacts: vec![(Point::new(0.03, 0.0, 0.0), Some(Point::x()))],
            groups: Vec::new(),
            links: vec![[Point::zeros(), Point::new(0.03, 0.0, 0.0)]],
        }
    }

    #[test]
    fn sheets_grow_with_their_panels() {
        let planar = panel(outline(0.03), Some(outline(0.031)));
        let solid = Geometry::Mesh(cuboid([0.03, 0.02, 0.01]));
        let spatial = panel(solid.clone(), Some(solid));
        let sheet = |panels: Vec<Panel>| Sheet { title: "A figure".into(), columns: 3, panels };
        let one = render(&sheet(vec![planar.clone()])).unwrap().size();
        let four = [planar.clone(), spatial, panel(outline(0.03), None), planar];
        let two = render(&sheet(four.into())).unwrap();
        assert_eq!(crate::view::drawing::elements(&two.svg()).unwrap()[0].name, "svg");
        let two = two.size();
        assert_eq!(one.0, two.0);
        assert_eq!(two.1 - one.1, (PANEL.1 + GAP) as u32);
        assert!(render(&sheet(Vec::new())).unwrap().png().is_ok());
    }
}
