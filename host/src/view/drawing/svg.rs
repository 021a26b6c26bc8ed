//! A drawing as SVG 1.1: shapes stay shapes and text stays text, which can be searched and edited.

use std::fmt::Write;

use super::{Drawing, Image, Operation, Shape, png};
use crate::view::canvas::{Anchor, Pixel, Style};
use crate::view::colour::Colour;
use crate::view::scene::base64;

/// Letters as wide as those the layout was made with come first; Verdana's nearly are.
const TYPEFACES: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";

pub(super) fn write(drawing: &Drawing) -> String {
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let (width, height) = drawing.size();
    // Writing into a string does not fail, here and below.
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
         version=\"1.1\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"{TYPEFACES}\" stroke-linecap=\"round\" stroke-linejoin=\"round\">"
    );
    draw(&mut out, drawing);
    out.push_str("</svg>\n");
    out
}

fn draw(out: &mut String, drawing: &Drawing) {
    for operation in &drawing.operations {
        match operation {
            Operation::Fill(shape, colour) => {
                element(
                    out,
                    shape,
                    &format!("fill=\"{}\"{}", hex(*colour), opacity("fill", *colour)),
                );
            }
            Operation::Stroke(shape, width, colour) => {
                let tint = format!("{}\"{}", hex(*colour), opacity("stroke", *colour));
                let width = number(*width);
                element(
                    out,
                    shape,
                    &format!("fill=\"none\" stroke=\"{tint} stroke-width=\"{width}\""),
                );
            }
            Operation::Text(at, style, text) => write_text(out, *at, *style, text),
            Operation::Image(image) => write_image(out, image),
            // Cuts off what leaves it, as nested drawings do.
            Operation::Inset(at, inner) => {
                let [x, y] = at.map(|v| v.round());
                let (width, height) = inner.size();
                let _ = writeln!(
                    out,
                    "<svg x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" \
                     overflow=\"hidden\">"
                );
                draw(out, inner);
                out.push_str("</svg>\n");
            }
        }
    }
}

fn element(out: &mut String, shape: &Shape, how: &str) {
    let _ = match shape {
        Shape::Frame(frame, radius) => {
            let [x, y, wide, high] = [frame.left, frame.top, frame.width, frame.height].map(number);
            let round =
                if *radius > 0.0 { format!(" rx=\"{}\"", number(*radius)) } else { "".into() };
            writeln!(
                out,
                "<rect x=\"{x}\" y=\"{y}\" width=\"{wide}\" height=\"{high}\"{round} {how}/>"
            )
        }
        Shape::Circle(centre, radius) => {
            let [x, y, r] = [centre[0], centre[1], *radius].map(number);
            writeln!(out, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{r}\" {how}/>")
        }
        Shape::Line(vertices) => {
            writeln!(out, "<path d=\"{}\" {how}/>", steps(vertices))
        }
        Shape::Loops(loops) => {
            let all: String = loops.iter().map(|l| steps(l) + "Z").collect();
            writeln!(out, "<path d=\"{all}\" fill-rule=\"evenodd\" {how}/>")
        }
    };
}

/// From vertex to vertex; a place alone is a line to itself, which its round ends make a dot.
fn steps(vertices: &[Pixel]) -> String {
    let mut steps = String::new();
    for (i, [x, y]) in vertices.iter().enumerate() {
        let command = if i == 0 { 'M' } else { 'L' };
        let _ = write!(steps, "{command}{} {}", number(*x), number(*y));
    }
    if let [[x, y]] = vertices {
        let _ = write!(steps, "L{} {}", number(*x), number(*y));
    }
    steps
}

fn write_text(out: &mut String, at: Pixel, style: Style, text: &str) {
    let anchor = match style.anchor {
        Anchor::Start => "",
        Anchor::Middle => " text-anchor=\"middle\"",
        Anchor::End => " text-anchor=\"end\"",
    };
    let weight = if style.bold { " font-weight=\"bold\"" } else { "" };
    let [x, y, size] = [at[0], at[1], style.size].map(number);
    let (fill, faint) = (hex(style.colour), opacity("fill", style.colour));
    let text = escaped(text);
    let _ = writeln!(
        out,
        "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\"{weight}{anchor} fill=\"{fill}\"{faint} \
         xml:space=\"preserve\">{text}</text>"
    );
}

fn write_image(out: &mut String, image: &Image) {
    let Some(content) = png::encode_image(image) else { return };
    let [x, y] = [image.left, image.top].map(|v| v.round());
    let (width, height) = (image.width, image.height());
    let _ = writeln!(
        out,
        "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" \
         xlink:href=\"data:image/png;base64,{}\"/>",
        base64(&content)
    );
}

fn hex(colour: Colour) -> String {
    let [r, g, b, _] = colour.bytes();
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Nothing where it is opaque.
fn opacity(of: &str, colour: Colour) -> String {
    match colour.bytes()[3] {
        255 => String::new(),
        a => format!(" {of}-opacity=\"{}\"", number(f32::from(a) / 255.0)),
    }
}

/// To a hundredth of a pixel.
fn number(value: f32) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// As XML has it; what XML cannot have at all becomes a replacement character.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\t' | '\n' | '\r' => safe.push(' '),
            '\u{0}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => safe.push('\u{fffd}'),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
#[path = "svg_tests.rs"]
pub(super) mod tests;
