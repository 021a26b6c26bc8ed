//! A box less smaller boxes: an L, a T, a U, a plus, their prisms, a block with a step.
//!
//! Much of what people make has no sides but those square to each other, and few of them. Faces alone say what was
//! felt; where a side was not, they do not close, or close around too much. That all sides belong to one box and
//! what is cut out of it says which are missing, and that contacts fall anywhere on the surface alike how far away
//! they may be. Much is its own mirror image, too: then half of it, or a quarter, has fewer sides to be known.

mod axes;
mod cells;
mod chain;
mod folded;
mod found;
mod moves;
mod wild;

use nalgebra::Rotation3;

use crate::reference::Contact;
use crate::space::Point;

use cells::Cells;
pub use found::Found;
use wild::{RARE, Wild};

/// Two places along an axis, the lower first, metres; infinite where something has no end.
type Span = [f64; 2];

/// Most boxes that are cut out, their mirror images not counted.
const MOST: usize = 4;

/// Least part of the outer box that an inner one leaves along an axis, and takes.
const LEAST: f64 = 0.06;

/// Least cosine between a normal and the side that it may be of.
const SQUARE: f64 = 0.7;

/// What is cut out, open where it leaves the outer box.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Notch {
    spans: [Span; 3],
}

/// A side: of the outer box or of a numbered notch, square to an axis, the lower or the higher one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Side {
    notch: Option<usize>,
    axis: usize,
    end: usize,
}

impl Side {
    /// Which way along the axis out of the object is.
    fn sign(&self) -> f64 {
        if (self.end == 1) == self.notch.is_none() { 1.0 } else { -1.0 }
    }
}

/// A rectangle (in the plane: a line) of the surface.
#[derive(Clone, Copy, Debug)]
struct Facet {
    side: Side,
    at: f64,
    /// Those of the two other axes count.
    spans: [Span; 3],
}

/// A contact as the box sees it.
#[derive(Clone, Copy, Debug)]
struct Felt {
    point: Point,
    normal: Point,
    deviations: (f64, f64),
}

/// A box less smaller boxes, in the object frame.
#[derive(Clone, Debug)]
pub struct Notched {
    dimension: usize,
    /// From the object's axes to the box's, about the middle of the contacts.
    frame: Rotation3<f64>,
    middle: Point,
    outer: [Span; 3],
    notches: Vec<Notch>,
}

impl Notched {
    /// The outer box's length along an axis.
    fn size(&self, axis: usize) -> f64 {
        self.outer[axis][1] - self.outer[axis][0]
    }

    fn spans(&self, notch: Option<usize>) -> &[Span; 3] {
        notch.map_or(&self.outer, |notch| &self.notches[notch].spans)
    }

    fn at(&self, side: Side) -> f64 {
        self.spans(side.notch)[side.axis][side.end]
    }

    fn moved(&self, side: Side, to: f64) -> Notched {
        let mut moved = self.clone();
        let spans = match side.notch {
            Some(notch) => &mut moved.notches[notch].spans,
            None => &mut moved.outer,
        };
        spans[side.axis][side.end] = to;
        moved
    }

    /// A notch's image in the middle of the outer box.
    fn flipped(&self, notch: usize, axis: usize) -> Notch {
        let [low, high] = self.outer[axis];
        let mut flipped = self.notches[notch];
        flipped.spans[axis] = image(flipped.spans[axis], 0.5 * (low + high));
        flipped
    }

    /// All that it has: those of the outer box, then those of the notches.
    fn sides(&self) -> Vec<Side> {
        let mut sides = Vec::new();
        for notch in std::iter::once(None).chain((0..self.notches.len()).map(Some)) {
            for axis in 0..self.dimension {
                let ends = [0, 1].map(|end| Side { notch, axis, end });
                sides.extend(ends.into_iter().filter(|side| self.at(*side).is_finite()));
            }
        }
        sides
    }

    /// Contacts as the box sees them. Those without a normal are left out.
    fn felt(&self, contacts: &[Contact]) -> Vec<Felt> {
        let felt = |c: &Contact| {
            Some(Felt {
                point: self.seen(&c.point),
                normal: self.frame * c.normal?,
                deviations: (c.point_deviation, c.normal_deviation),
            })
        };
        contacts.iter().filter_map(felt).collect()
    }

    /// A point (object frame, metres) as the box sees it.
    fn seen(&self, point: &Point) -> Point {
        self.frame * (point - self.middle)
    }

    /// Whether a point (object frame, metres) is inside; one that is no number is not.
    pub fn contains(&self, point: &Point) -> bool {
        self.holds(&self.seen(point))
    }

    /// Whether a point as the box sees it is inside.
    fn holds(&self, seen: &Point) -> bool {
        let within = |spans: &[Span; 3]| {
            (0..self.dimension)
                .all(|axis| spans[axis][0] < seen[axis] && seen[axis] < spans[axis][1])
        };
        within(&self.outer) && !self.notches.iter().any(|notch| within(&notch.spans))
    }

    /// Its surface; `None` where it is not what it says: where something is too thin, in pieces, where the outer box has
    /// no side, or a notch cuts nothing out.
    fn facets(&self) -> Option<Vec<Facet>> {
        let least = [0, 1, 2].map(|axis| LEAST * self.size(axis));
        let cells = Cells::of(self, least)?;
        cells.is_connected().then(|| cells.facets())
    }

    fn area(&self, facet: &Facet) -> f64 {
        let across = (0..self.dimension).filter(|axis| *axis != facet.side.axis);
        across.map(|axis| facet.spans[axis][1] - facet.spans[axis][0]).product()
    }

    /// How probable a contact is on a facet, relative to one that is where and as that has it.
    fn touched(&self, facet: &Facet, felt: &Felt) -> f64 {
        let (axis, sign) = (facet.side.axis, facet.side.sign());
        if sign * felt.normal[axis] < SQUARE {
            return 0.0;
        }
        let off = (felt.point[axis] - facet.at) / felt.deviations.0;
        let turned = 2.0 * (1.0 - sign * felt.normal[axis]) / felt.deviations.1.powi(2);
        let cost = off * off + turned;
        if cost > 60.0 {
            return 0.0;
        }
        let across = (0..self.dimension).filter(|other| *other != axis);
        let within = across.map(|other| {
            let [low, high] =
                facet.spans[other].map(|at| (felt.point[other] - at) / felt.deviations.0);
            // Far above both ends the shares below are nearly 1, and their difference all rounding.
            if high > 0.0 { below(-high) - below(-low) } else { below(low) - below(high) }
        });
        within.product::<f64>() * (-0.5 * cost).exp()
    }
}

/// A span's image in a mirror.
fn image(span: Span, mirror: f64) -> Span {
    [2.0 * mirror - span[1], 2.0 * mirror - span[0]]
}

/// The normal distribution's share below so many deviations, within 0.01 (Camilli, Journal of Educational and Behavioral
/// Statistics 19, 1994).
fn below(deviations: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * deviations).exp())
}

#[cfg(test)]
mod tests;
