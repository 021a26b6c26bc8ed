//! A drawing surface: lines, areas, dots and text, coordinates in pixels from the upper left corner.
//! It keeps what is drawn on it as a [`Drawing`], and leaves out what is not a number.

use super::colour::Colour;
use super::drawing::typeface::Typeface;
use super::drawing::{Drawing, Image, Operation, PictureError, Shape};

/// A position in pixels.
pub(super) type Pixel = [f32; 2];

/// Which side of its position a text stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// How text looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Style {
    /// Pixels per em.
    pub size: f32,
    pub bold: bool,
    pub colour: Colour,
    pub anchor: Anchor,
}

impl Style {
    pub fn new(size: f32, colour: Colour) -> Self {
        Self { size, bold: false, colour, anchor: Anchor::Start }
    }

    pub fn bold(self) -> Self {
        Self { bold: true, ..self }
    }

    pub fn anchored(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }
}

/// A rectangle in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    pub left: f32,
    pub top: f32,
    pub width: f32,
    pub height: f32,
}

impl Frame {
    pub fn right(&self) -> f32 {
        self.left + self.width
    }

    pub fn bottom(&self) -> f32 {
        self.top + self.height
    }

    pub fn inset(&self, left: f32, top: f32, right: f32, bottom: f32) -> Frame {
        Frame {
            left: self.left + left,
            top: self.top + top,
            width: self.width - left - right,
            height: self.height - top - bottom,
        }
    }
}

pub(super) struct Canvas {
    drawing: Drawing,
    typeface: Typeface,
}

/// Farther out nothing can be seen, pixels.
const FAR: f32 = 1e5;

/// Where something is; `None` where it is nowhere.
fn placed(at: Pixel) -> Option<Pixel> {
    at.iter().all(|v| v.is_finite()).then(|| at.map(|v| v.clamp(-FAR, FAR)))
}

impl Canvas {
    /// A surface of one colour.
    ///
    /// # Errors
    /// When the bundled typeface cannot be read.
    pub fn new(width: u32, height: u32, background: Colour) -> Result<Self, PictureError> {
        let all = Frame { left: 0.0, top: 0.0, width: width as f32, height: height as f32 };
        let operations = vec![Operation::Fill(Shape::Frame(all, 0.0), background)];
        Ok(Self { drawing: Drawing { width, height, operations }, typeface: Typeface::new()? })
    }

    /// The picture.
    pub fn finish(self) -> Drawing {
        self.drawing
    }

    fn add(&mut self, operation: Operation) {
        self.drawing.operations.push(operation);
    }

    pub fn fill_frame(&mut self, frame: &Frame, colour: Colour) {
        self.fill_card(frame, 0.0, colour);
    }

    /// A rectangle with rounded corners.
    pub fn fill_card(&mut self, frame: &Frame, radius: f32, colour: Colour) {
        let ends = [[frame.left, frame.top], [frame.right(), frame.bottom()]].map(placed);
        if let [Some(_), Some(_)] = ends
            && frame.width > 0.0
            && frame.height > 0.0
        {
            self.add(Operation::Fill(Shape::Frame(*frame, radius), colour));
        }
    }

    /// The area inside closed polygons, holes left out.
    pub fn fill_area(&mut self, loops: &[Vec<Pixel>], colour: Colour) {
        let placed = |l: &Vec<Pixel>| l.iter().copied().filter_map(placed).collect::<Vec<Pixel>>();
        let loops: Vec<Vec<Pixel>> = loops.iter().map(placed).filter(|v| enough(v)).collect();
        if !loops.is_empty() {
            self.add(Operation::Fill(Shape::Loops(loops), colour));
        }
    }

    pub fn fill_dot(&mut self, centre: Pixel, radius: f32, colour: Colour) {
        if let Some(centre) = placed(centre).filter(|_| radius > 0.0 && radius < FAR) {
            self.add(Operation::Fill(Shape::Circle(centre, radius), colour));
        }
    }

    pub fn ring(&mut self, centre: Pixel, radius: f32, width: f32, colour: Colour) {
        if let Some(centre) = placed(centre).filter(|_| radius > 0.0 && radius < FAR) {
            self.add(Operation::Stroke(Shape::Circle(centre, radius), width, colour));
        }
    }

    /// Lines from vertex to vertex with round ends; none to and from where a vertex is not known.
    pub fn line(&mut self, vertices: &[Pixel], width: f32, colour: Colour) {
        let all: Vec<Option<Pixel>> = vertices.iter().copied().map(placed).collect();
        for piece in all.split(Option::is_none).filter(|piece| !piece.is_empty()) {
            let piece = piece.iter().copied().flatten().collect();
            self.add(Operation::Stroke(Shape::Line(piece), width, colour));
        }
    }

    /// Like [`Canvas::line`], back to the first vertex.
    pub fn closed_line(&mut self, vertices: &[Pixel], width: f32, colour: Colour) {
        let vertices: Vec<Pixel> = vertices.iter().copied().filter_map(placed).collect();
        if enough(&vertices) {
            self.add(Operation::Stroke(Shape::Loops(vec![vertices]), width, colour));
        }
    }

    /// Lays pixels (straight RGBA, row by row) over the picture.
    pub fn overlay(&mut self, left: f32, top: f32, width: u32, rows: &[[f32; 4]]) {
        if let Some([left, top]) = placed([left, top]) {
            let pixels = rows.iter().map(|p| Colour(*p).bytes()).collect();
            self.add(Operation::Image(Image { left, top, width, pixels }));
        }
    }

    /// Lays a smaller canvas over this one, what does not fit cut off.
    pub fn place(&mut self, at: Pixel, other: Canvas) {
        if let Some(at) = placed(at) {
            self.add(Operation::Inset(at, other.finish()));
        }
    }

    /// Writes one line; `at` is on the baseline. Returns its width in pixels.
    pub fn text(&mut self, at: Pixel, style: Style, text: &str) -> f32 {
        if let Some(at) = placed(at).filter(|_| !text.is_empty()) {
            self.add(Operation::Text(at, style, text.to_owned()));
        }
        self.text_width(style, text)
    }

    /// How wide a text would be, pixels.
    pub fn text_width(&self, style: Style, text: &str) -> f32 {
        self.typeface.width(style, text)
    }

    /// `text`, cut with an ellipsis where it would be wider than `width` pixels.
    pub fn fitted(&self, style: Style, text: &str, width: f32) -> String {
        if self.text_width(style, text) <= width {
            return text.into();
        }
        let ellipsis = self.text_width(style, "…");
        if ellipsis > width {
            return String::new();
        }
        // Letter by letter from the start: a text may be much longer than what fits.
        let mut taken = 0.0;
        let fits = |letter: &char| {
            taken += self.text_width(style, letter.encode_utf8(&mut [0; 4]));
            taken + ellipsis <= width
        };
        text.chars().take_while(fits).chain(['…']).collect()
    }
}

/// Whether these are the vertices of an area or of a line around one.
fn enough(vertices: &[Pixel]) -> bool {
    vertices.len() > 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::colour::{INK, PAPER};

    #[test]
    fn a_text_of_any_length_is_cut_to_what_fits() {
        let canvas = Canvas::new(100, 100, PAPER).unwrap();
        let style = Style::new(20.0, INK);
        assert_eq!(canvas.fitted(style, "short", 100.0), "short");
        // So long that nothing may be done per letter but look at it once.
        let long = "é wide ".repeat(100_000);
        let cut = canvas.fitted(style, &long, 300.0);
        assert!(cut.ends_with('…') && long.starts_with(cut.trim_end_matches('…')), "{cut}");
        let width = canvas.text_width(style, &cut);
        assert!((270.0..=300.0).contains(&width), "{width}");
        assert_eq!(canvas.fitted(style, &long, canvas.text_width(style, "…")), "…");
        assert_eq!(canvas.fitted(style, &long, 1.0), "");
    }
}
