//! A box less smaller boxes: an L, a T, a U, a plus, their prisms, a block with a step.
//!
//! Much of what people make has no sides but those square to each other, and few of them. Faces alone say what was
//! felt; where a side was not, they do not close, or close around too much. That all sides belong to one box and
//! what is cut out of it says which are missing, and that contacts fall anywhere on the surface alike how far away
//! they may be.

mod chain;
mod found;

use nalgebra::Rotation3;

use super::Contact;
use crate::space::Point;

pub use found::Found;

/// Two places along an axis, the lower first, metres; infinite where something has no end.
type Span = [f64; 2];

/// Most boxes that are cut out.
const MOST: usize = 4;

/// Least part of the outer box that an inner one leaves along an axis, and takes.
const LEAST: f64 = 0.06;

/// How probable a contact is at least, relative to one where and as the surface has it: it may be wild.
const WILD: f64 = 1e-7;

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

/// The cells into which all sides cut the outer box.
struct Cells {
    cuts: [Vec<(f64, Option<Side>)>; 3],
    filled: Vec<bool>,
}

impl Cells {
    fn counts(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| self.cuts[axis].len() - 1)
    }

    fn index(&self, cell: [usize; 3]) -> usize {
        let [x, y, _] = self.counts();
        cell[0] + x * (cell[1] + y * cell[2])
    }

    fn all(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [x, y, z] = self.counts();
        (0..z).flat_map(move |k| (0..y).flat_map(move |j| (0..x).map(move |i| [i, j, k])))
    }

    fn span(&self, axis: usize, cell: usize) -> Span {
        [self.cuts[axis][cell].0, self.cuts[axis][cell + 1].0]
    }

    /// The next one along an axis, if it is within the box.
    fn beside(&self, cell: [usize; 3], axis: usize, end: usize) -> Option<[usize; 3]> {
        let mut next = cell;
        next[axis] = if end == 1 { cell[axis] + 1 } else { cell[axis].checked_sub(1)? };
        (next[axis] < self.counts()[axis]).then_some(next)
    }

    /// Whether what is filled is one piece.
    fn is_connected(&self) -> bool {
        let mut left: Vec<bool> = self.filled.clone();
        let Some(first) = self.all().find(|cell| left[self.index(*cell)]) else { return false };
        left[self.index(first)] = false;
        let mut open = vec![first];
        while let Some(cell) = open.pop() {
            for (axis, end) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)] {
                let Some(next) = self.beside(cell, axis, end) else { continue };
                if std::mem::take(&mut left[self.index(next)]) {
                    open.push(next);
                }
            }
        }
        !left.contains(&true)
    }
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
                point: self.frame * (c.point - self.middle),
                normal: self.frame * c.normal?,
                deviations: (c.point_deviation, c.normal_deviation),
            })
        };
        contacts.iter().filter_map(felt).collect()
    }

    /// Whether a point (object frame, metres) is inside; one that is no number is not.
    pub fn contains(&self, point: &Point) -> bool {
        let p = self.frame * (point - self.middle);
        let within = |spans: &[Span; 3]| {
            (0..self.dimension).all(|axis| spans[axis][0] < p[axis] && p[axis] < spans[axis][1])
        };
        within(&self.outer) && !self.notches.iter().any(|notch| within(&notch.spans))
    }

    /// `None` where it is not what it says: where something is too thin, in pieces, where the outer box has no side, or
    /// a notch cuts nothing out.
    fn cells(&self) -> Option<Cells> {
        let is_positive = (0..self.dimension).all(|axis| self.size(axis) > 0.0);
        if !is_positive || !self.notches.iter().all(|notch| self.holds(notch)) {
            return None;
        }
        let cuts = [0, 1, 2].map(|axis| {
            if axis == self.dimension {
                return vec![(-0.5, None), (0.5, None)];
            }
            let own = self.sides().into_iter().filter(|side| side.axis == axis);
            let mut cuts: Vec<_> = own.map(|side| (self.at(side), Some(side))).collect();
            cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
            cuts
        });
        let mut cells = Cells { cuts, filled: vec![] };
        let mut alone = [false; MOST];
        for cell in cells.all() {
            let middle = [0, 1, 2].map(|axis| {
                let [low, high] = cells.span(axis, cell[axis]);
                0.5 * (low + high)
            });
            let is_of = |notch: &Notch| {
                (0..self.dimension).all(|axis| {
                    (notch.spans[axis][0]..notch.spans[axis][1]).contains(&middle[axis])
                })
            };
            let mut own = self.notches.iter().enumerate().filter(|(_, notch)| is_of(notch));
            let (first, second) = (own.next(), own.next());
            if let (Some((notch, _)), None) = (first, second) {
                alone[notch] = true;
            }
            cells.filled.push(first.is_none());
        }
        let is_needed = alone.iter().take(self.notches.len()).all(|alone| *alone);
        (is_needed && self.is_full(&cells) && cells.is_connected()).then_some(cells)
    }

    /// Whether a notch lies within the outer box and leaves some of it.
    fn holds(&self, notch: &Notch) -> bool {
        (0..self.dimension).all(|axis| {
            let ([low, high], least) = (self.outer[axis], LEAST * self.size(axis));
            let [from, to] = notch.spans[axis];
            let is_within = |at: f64| at.is_infinite() || at > low + least && at < high - least;
            is_within(from) && is_within(to) && to.min(high) - from.max(low) > least
        })
    }

    /// Whether every side of the outer box is one.
    fn is_full(&self, cells: &Cells) -> bool {
        let counts = cells.counts();
        (0..self.dimension).all(|axis| {
            [0, counts[axis] - 1].into_iter().all(|layer| {
                cells.all().any(|cell| cell[axis] == layer && cells.filled[cells.index(cell)])
            })
        })
    }

    /// Its surface; `None` where it is not what it says.
    fn facets(&self) -> Option<Vec<Facet>> {
        let cells = self.cells()?;
        let mut facets = Vec::new();
        for cell in cells.all().filter(|cell| cells.filled[cells.index(*cell)]) {
            for axis in 0..self.dimension {
                for end in [0, 1] {
                    let next = cells.beside(cell, axis, end);
                    if next.is_some_and(|next| cells.filled[cells.index(next)]) {
                        continue;
                    }
                    let (at, side) = cells.cuts[axis][cell[axis] + end];
                    let spans = [0, 1, 2].map(|axis| cells.span(axis, cell[axis]));
                    facets.push(Facet { side: side?, at, spans });
                }
            }
        }
        Some(facets)
    }

    /// Log probability of contacts that fall anywhere on the surface alike; `None` where it is not what it says.
    fn likelihood(&self, felt: &[Felt]) -> Option<f64> {
        let facets = self.facets()?;
        let area: f64 = facets.iter().map(|facet| self.area(facet)).sum();
        let one = |felt: &Felt| {
            let on = facets.iter().map(|facet| self.touched(facet, felt)).sum::<f64>();
            (on + WILD).ln()
        };
        Some(felt.iter().map(one).sum::<f64>() - felt.len() as f64 * area.ln())
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
                facet.spans[other].map(|at| below((felt.point[other] - at) / felt.deviations.0));
            low - high
        });
        within.product::<f64>() * (-0.5 * cost).exp()
    }
}

/// The normal distribution's share below so many deviations, within 0.01 (Camilli, Journal of Educational and Behavioral
/// Statistics 19, 1994).
fn below(deviations: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * deviations).exp())
}

#[cfg(test)]
mod tests;
