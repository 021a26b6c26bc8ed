//! A drawing in pixels, anti-aliased.

use ab_glyph::{Outline, OutlineCurve};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PixmapPaint, Rect, Stroke,
    Transform,
};

use super::typeface::Typeface;
use super::{Drawing, Image, Operation, PictureError, Shape};
use crate::view::canvas::{Anchor, Pixel, Style};
use crate::view::colour::Colour;

pub(super) fn encode(drawing: &Drawing) -> Result<Vec<u8>, PictureError> {
    let pixmap = paint(drawing, &Typeface::new()?)?;
    pixmap.encode_png().map_err(|e| PictureError::Encode(e.to_string()))
}

/// Pixels as a picture of their own, for a place inside another.
pub(super) fn encode_image(image: &Image) -> Option<Vec<u8>> {
    pixels(image)?.encode_png().ok()
}

fn paint(drawing: &Drawing, typeface: &Typeface) -> Result<Pixmap, PictureError> {
    let (width, height) = drawing.size();
    let mut pixmap = Pixmap::new(width, height).ok_or(PictureError::Size { width, height })?;
    for operation in &drawing.operations {
        match operation {
            Operation::Fill(Shape::Frame(f, radius), colour) if *radius == 0.0 => {
                if let Some(rect) = Rect::from_xywh(f.left, f.top, f.width, f.height) {
                    pixmap.fill_rect(rect, &ink(*colour), Transform::identity(), None);
                }
            }
            Operation::Fill(shape, colour) => {
                if let Some(path) = path(shape) {
                    let rule = FillRule::EvenOdd;
                    pixmap.fill_path(&path, &ink(*colour), rule, Transform::identity(), None);
                }
            }
            Operation::Stroke(shape, width, colour) => {
                if let Some(path) = path(shape) {
                    let (line_cap, line_join) = (LineCap::Round, LineJoin::Round);
                    let how = Stroke { width: *width, line_cap, line_join, ..Stroke::default() };
                    pixmap.stroke_path(&path, &ink(*colour), &how, Transform::identity(), None);
                }
            }
            Operation::Text(at, style, text) => {
                if let Some(path) = letters(typeface, *at, *style, text) {
                    let (colour, rule) = (ink(style.colour), FillRule::Winding);
                    pixmap.fill_path(&path, &colour, rule, Transform::identity(), None);
                }
            }
            Operation::Image(image) => {
                if let Some(layer) = pixels(image) {
                    lay(&mut pixmap, [image.left, image.top], &layer);
                }
            }
            Operation::Inset(at, drawing) => lay(&mut pixmap, *at, &paint(drawing, typeface)?),
        }
    }
    Ok(pixmap)
}

fn lay(pixmap: &mut Pixmap, at: Pixel, layer: &Pixmap) {
    let [left, top] = at.map(|v| v.round() as i32);
    let how = PixmapPaint::default();
    pixmap.draw_pixmap(left, top, layer.as_ref(), &how, Transform::identity(), None);
}

fn pixels(image: &Image) -> Option<Pixmap> {
    let mut layer = Pixmap::new(image.width, image.height())?;
    for (to, [r, g, b, a]) in layer.pixels_mut().iter_mut().zip(&image.pixels) {
        *to = tiny_skia::ColorU8::from_rgba(*r, *g, *b, *a).premultiply();
    }
    Some(layer)
}

fn ink(colour: Colour) -> Paint<'static> {
    let [r, g, b, a] = colour.bytes();
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, a);
    paint.anti_alias = true;
    paint
}

fn path(shape: &Shape) -> Option<Path> {
    let mut path = PathBuilder::new();
    match shape {
        Shape::Frame(frame, radius) => {
            let (l, t, r, b) = (frame.left, frame.top, frame.right(), frame.bottom());
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
        }
        Shape::Circle(centre, radius) => {
            return PathBuilder::from_circle(centre[0], centre[1], *radius);
        }
        Shape::Line(vertices) => follow(&mut path, vertices),
        Shape::Loops(loops) => {
            for vertices in loops {
                follow(&mut path, vertices);
                path.close();
            }
        }
    }
    path.finish()
}

fn follow(path: &mut PathBuilder, vertices: &[Pixel]) {
    for (i, v) in vertices.iter().enumerate() {
        if i == 0 {
            path.move_to(v[0], v[1]);
        } else {
            path.line_to(v[0], v[1]);
        }
    }
}

/// The outlines of a text.
fn letters(typeface: &Typeface, at: Pixel, style: Style, text: &str) -> Option<Path> {
    let width = typeface.width(style, text);
    let start = match style.anchor {
        Anchor::Start => at[0],
        Anchor::Middle => at[0] - width / 2.0,
        Anchor::End => at[0] - width,
    };
    let mut path = PathBuilder::new();
    for letter in typeface.letters(style, text) {
        if let Some(outline) = &letter.outline {
            add(&mut path, outline, typeface.scale(style), [start + letter.offset, at[1]]);
        }
    }
    path.finish()
}

fn add(path: &mut PathBuilder, outline: &Outline, scale: f32, at: Pixel) {
    let place = |p: ab_glyph::Point| (at[0] + p.x * scale, at[1] - p.y * scale);
    let mut last = None;
    for curve in &outline.curves {
        let (from, to) = match curve {
            OutlineCurve::Line(a, b) => (*a, *b),
            OutlineCurve::Quad(a, _, b) => (*a, *b),
            OutlineCurve::Cubic(a, _, _, b) => (*a, *b),
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
                let (cx, cy) = place(*c);
                path.quad_to(cx, cy, x, y);
            }
            OutlineCurve::Cubic(_, c, d, _) => {
                let ((cx, cy), (dx, dy)) = (place(*c), place(*d));
                path.cubic_to(cx, cy, dx, dy, x, y);
            }
        }
        last = Some(to);
    }
    if last.is_some() {
        path.close();
    }
}
