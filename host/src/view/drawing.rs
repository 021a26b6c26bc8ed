//! A picture as the list of what is drawn on it: PNG and SVG are made of the same list, so that they
//! show the same.

mod png;
mod svg;
pub(super) mod typeface;

use thiserror::Error;

use super::canvas::{Frame, Pixel, Style};
use super::colour::Colour;

/// Why a picture could not be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PictureError {
    /// The picture could not be allocated.
    #[error("no memory for a picture of {width} × {height} pixels")]
    Size {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// The bundled typeface is damaged.
    #[error("the bundled typeface cannot be read")]
    Font,
    /// The PNG encoder failed.
    #[error("the picture cannot be encoded: {0}")]
    Encode(String),
}

/// A finished picture, which becomes PNG or SVG where it is asked for.
///
/// ```
/// use tactile_host::view::curves::{self, Curve, Mark, Plot, Scale};
///
/// let curve = Curve {
///     name: "thin plate".into(),
///     marks: vec![Mark { x: 10.0, low: 4.0, median: 5.0, high: 7.0 }],
/// };
/// let plot = Plot {
///     title: "box".into(),
///     across: "contacts".into(),
///     up: "Hausdorff distance, mm".into(),
///     scales: [Scale::Linear; 2],
///     curves: vec![curve],
/// };
/// let drawing = curves::render(&[plot])?;
/// assert!(drawing.png()?.starts_with(b"\x89PNG"));
/// assert!(drawing.svg().contains(">thin plate</text>"));
/// # Ok::<(), tactile_host::view::drawing::PictureError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) operations: Vec<Operation>,
}

impl Drawing {
    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The picture in pixels.
    ///
    /// # Errors
    /// Without memory for so many pixels.
    pub fn png(&self) -> Result<Vec<u8>, PictureError> {
        png::encode(self)
    }

    /// The picture in lines and letters, as large as in [`Drawing::png`] where nobody scales it. Shaded
    /// solids and fields of colours are pixels in there, all else is not.
    pub fn svg(&self) -> String {
        svg::write(self)
    }
}

/// One thing that is drawn. All numbers are finite.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Operation {
    /// A shape's inside.
    Fill(Shape, Colour),
    /// A line along a shape, so wide.
    Stroke(Shape, f32, Colour),
    /// One line of text; the position is on its baseline.
    Text(Pixel, Style, String),
    /// Pixels over what lies below.
    Image(Image),
    /// Another drawing, its left upper corner at this position, what leaves it cut off.
    Inset(Pixel, Drawing),
}

/// What can be filled and stroked.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// A rectangle, its corners rounded by a radius.
    Frame(Frame, f32),
    /// Centre and radius.
    Circle(Pixel, f32),
    /// From vertex to vertex.
    Line(Vec<Pixel>),
    /// Closed polygons, holes left out.
    Loops(Vec<Vec<Pixel>>),
}

/// Straight RGBA, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Image {
    pub left: f32,
    pub top: f32,
    pub width: u32,
    pub pixels: Vec<[u8; 4]>,
}

impl Image {
    pub fn height(&self) -> u32 {
        self.pixels.len() as u32 / self.width.max(1)
    }
}

#[cfg(test)]
pub(super) use self::svg::tests::elements;
