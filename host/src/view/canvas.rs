//! A drawing surface: lines, areas, dots and text, anti-aliased, coordinates in pixels from the
//! upper left corner.

use ab_glyph::{Font, FontRef, GlyphId, OutlineCurve};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PixmapPaint, Rect, Stroke,
    Transform,
};

use super::colour::Colour;
use super::summary::PictureError;

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
#[derive(Clone, Copy, Debug)]
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
    pixmap: Pixmap,
    regular: FontRef<'static>,
    bold: FontRef<'static>,
}

impl Canvas {
    pub fn new(width: u32, height: u32, background: Colour) -> Result<Self, PictureError> {
        let mut pixmap = Pixmap::new(width, height).ok_or(PictureError::Size { width, height })?;
        pixmap.fill(colour_of(background));
        let font = |bytes| FontRef::try_from_slice(bytes).map_err(|_| PictureError::Font);
        Ok(Self {
            pixmap,
            regular: font(dejavu::sans::regular())?,
            bold: font(dejavu::sans::bold())?,
        })
    }

    /// The picture as PNG.
    pub fn encode(&self) -> Result<Vec<u8>, PictureError> {
        self.pixmap.encode_png().map_err(|e| PictureError::Encode(e.to_string()))
    }

    pub fn fill_frame(&mut self, frame: &Frame, colour: Colour) {
        if let Some(rect) = Rect::from_xywh(frame.left, frame.top, frame.width, frame.height) {
            self.pixmap.fill_rect(rect, &paint(colour), Transform::identity(), None);
        }
    }

    /// A rectangle with rounded corners.
    pub fn fill_card(&mut self, frame: &Frame, radius: f32, colour: Colour) {
        let (l, t, r, b) = (frame.left, frame.top, frame.right(), frame.bottom());
        let mut path = PathBuilder::new();
        path.move_to(l + radius, t);
        path.line_to(r - radius, t);
        path.quad_to(r, t, r, t + radius);
        path.line_to(r, b - radius);
        path.quad_to(r, b, r - radius, b);
        path.line_to(l + radius, b);
        path.quad_to(l, b, l, b - radius);
        path.line_to(l, t + radius);
        path.quad_to(l, t, l + radius, t);
        path.close();
        self.fill(path.finish(), colour);
    }

    /// The area inside closed polygons, holes left out.
    pub fn fill_area(&mut self, loops: &[Vec<Pixel>], colour: Colour) {
        let mut path = PathBuilder::new();
        for vertices in loops {
            add_polyline(&mut path, vertices);
            path.close();
        }
        self.fill_by(path.finish(), FillRule::EvenOdd, colour);
    }

    pub fn fill_dot(&mut self, centre: Pixel, radius: f32, colour: Colour) {
        self.fill(PathBuilder::from_circle(centre[0], centre[1], radius), colour);
    }

    pub fn ring(&mut self, centre: Pixel, radius: f32, width: f32, colour: Colour) {
        self.stroke(PathBuilder::from_circle(centre[0], centre[1], radius), width, colour);
    }

    /// Lines from vertex to vertex with round ends.
    pub fn line(&mut self, vertices: &[Pixel], width: f32, colour: Colour) {
        let mut path = PathBuilder::new();
        add_polyline(&mut path, vertices);
        self.stroke(path.finish(), width, colour);
    }

    /// Like [`Canvas::line`], back to the first vertex.
    pub fn closed_line(&mut self, vertices: &[Pixel], width: f32, colour: Colour) {
        let mut path = PathBuilder::new();
        add_polyline(&mut path, vertices);
        path.close();
        self.stroke(path.finish(), width, colour);
    }

    /// Lays another picture (straight RGBA, row by row) over this one.
    pub fn overlay(&mut self, left: i32, top: i32, width: u32, rows: &[[f32; 4]]) {
        let height = rows.len() as u32 / width.max(1);
        let Some(mut layer) = Pixmap::new(width, height) else { return };
        for (to, from) in layer.pixels_mut().iter_mut().zip(rows) {
            *to = colour_of(Colour(*from)).premultiply().to_color_u8();
        }
        let how = PixmapPaint::default();
        self.pixmap.draw_pixmap(left, top, layer.as_ref(), &how, Transform::identity(), None);
    }

    /// Lays a smaller canvas over this one, what does not fit cut off.
    pub fn place(&mut self, left: i32, top: i32, other: &Canvas) {
        let how = PixmapPaint::default();
        self.pixmap.draw_pixmap(
            left,
            top,
            other.pixmap.as_ref(),
            &how,
            Transform::identity(),
            None,
        );
    }

    /// Writes one line; `at` is on the baseline. Returns its width in pixels.
    pub fn text(&mut self, at: Pixel, style: Style, text: &str) -> f32 {
        let width = self.text_width(style, text);
        let mut x = match style.anchor {
            Anchor::Start => at[0],
            Anchor::Middle => at[0] - width / 2.0,
            Anchor::End => at[0] - width,
        };
        let mut path = PathBuilder::new();
        let font = if style.bold { &self.bold } else { &self.regular };
        let scale = em(font, style.size);
        for glyph in text.chars().map(|c| font.glyph_id(c)) {
            add_glyph(&mut path, font, glyph, scale, [x, at[1]]);
            x += font.h_advance_unscaled(glyph) * scale;
        }
        self.fill(path.finish(), style.colour);
        width
    }

    /// How wide a text would be, pixels.
    pub fn text_width(&self, style: Style, text: &str) -> f32 {
        let font = if style.bold { &self.bold } else { &self.regular };
        let scale = em(font, style.size);
        text.chars().map(|c| font.h_advance_unscaled(font.glyph_id(c)) * scale).sum()
    }

    /// `text`, cut with an ellipsis where it would be wider than `width` pixels.
    pub fn fitted(&self, style: Style, text: &str, width: f32) -> String {
        if self.text_width(style, text) <= width {
            return text.into();
        }
        let mut short: Vec<char> = text.chars().collect();
        while short.pop().is_some() {
            let cut: String = short.iter().collect::<String>() + "…";
            if self.text_width(style, &cut) <= width {
                return cut;
            }
        }
        String::new()
    }

    fn fill(&mut self, path: Option<Path>, colour: Colour) {
        self.fill_by(path, FillRule::Winding, colour);
    }

    fn fill_by(&mut self, path: Option<Path>, rule: FillRule, colour: Colour) {
        if let Some(path) = path {
            self.pixmap.fill_path(&path, &paint(colour), rule, Transform::identity(), None);
        }
    }

    fn stroke(&mut self, path: Option<Path>, width: f32, colour: Colour) {
        if let Some(path) = path {
            let (line_cap, line_join) = (LineCap::Round, LineJoin::Round);
            let stroke = Stroke { width, line_cap, line_join, ..Stroke::default() };
            self.pixmap.stroke_path(&path, &paint(colour), &stroke, Transform::identity(), None);
        }
    }
}

fn paint(colour: Colour) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color(colour_of(colour));
    paint.anti_alias = true;
    paint
}

fn colour_of(colour: Colour) -> tiny_skia::Color {
    let [r, g, b, a] = colour.0.map(|c| if c.is_nan() { 0.0 } else { c.clamp(0.0, 1.0) });
    tiny_skia::Color::from_rgba(r, g, b, a).unwrap_or(tiny_skia::Color::BLACK)
}

fn add_polyline(path: &mut PathBuilder, vertices: &[Pixel]) {
    for (i, v) in vertices.iter().enumerate() {
        if i == 0 {
            path.move_to(v[0], v[1]);
        } else {
            path.line_to(v[0], v[1]);
        }
    }
}

/// Pixels per font unit.
fn em(font: &FontRef, size: f32) -> f32 {
    size / font.units_per_em().unwrap_or(2048.0)
}

fn add_glyph(path: &mut PathBuilder, font: &FontRef, glyph: GlyphId, scale: f32, at: Pixel) {
    let Some(outline) = font.outline(glyph) else { return };
    let place = |p: ab_glyph::Point| (at[0] + p.x * scale, at[1] - p.y * scale);
    let mut last = None;
    for curve in outline.curves {
        let (from, to) = match curve {
            OutlineCurve::Line(a, b) => (a, b),
            OutlineCurve::Quad(a, _, b) => (a, b),
            OutlineCurve::Cubic(a, _, _, b) => (a, b),
        };
        if last != Some(from) {
            if last.is_some() {
                path.close();
            }
            let (x, y) = place(from);
            path.move_to(x, y);
        }
        let (x, y) = place(to);
        match curve {
            OutlineCurve::Line(..) => path.line_to(x, y),
            OutlineCurve::Quad(_, c, _) => {
                let (cx, cy) = place(c);
                path.quad_to(cx, cy, x, y);
            }
            OutlineCurve::Cubic(_, c, d, _) => {
                let ((cx, cy), (dx, dy)) = (place(c), place(d));
                path.cubic_to(cx, cy, dx, dy, x, y);
            }
        }
        last = Some(to);
    }
    if last.is_some() {
        path.close();
    }
}
