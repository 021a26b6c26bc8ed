//! A box less smaller boxes that may be its own mirror image: what is on one side of the mirrors says all.

use super::cells::Cells;
use super::{Felt, LEAST, Notch, Notched, Side, Span, Wild, image};
use crate::space::Point;

/// A box less smaller boxes of which one half, quarter or eighth is kept.
#[derive(Clone, Debug)]
pub(super) struct Folded {
    /// What is above the mirrors: where there is one, its outer box begins in it.
    pub(super) part: Notched,
    /// Axes along which there is one.
    pub(super) mirrored: [bool; 3],
}

impl Folded {
    /// One without mirrors.
    pub(super) fn of(solid: &Notched) -> Folded {
        Folded { part: solid.clone(), mirrored: [false; 3] }
    }

    pub(super) fn mirrors(&self) -> impl Iterator<Item = usize> + use<> {
        let mirrored = self.mirrored;
        (0..3).filter(move |axis| mirrored[*axis])
    }

    /// Whether this is where a mirror is, and no side.
    pub(super) fn is_mirror(&self, side: Side) -> bool {
        side.notch.is_none() && side.end == 0 && self.mirrored[side.axis]
    }

    /// The same with a side of the part elsewhere.
    pub(super) fn moved(&self, side: Side, to: f64) -> Folded {
        Folded { part: self.part.moved(side, to), mirrored: self.mirrored }
    }

    /// Both ends of the whole along an axis.
    pub(super) fn span(&self, axis: usize) -> Span {
        let [low, high] = self.part.outer[axis];
        if self.mirrored[axis] { [2.0 * low - high, high] } else { [low, high] }
    }

    /// With a mirror more or less in the middle of an axis. The box stays as large, and its notches where they are; or,
    /// turned over, where their images were while there was no mirror.
    pub(super) fn toggled(&self, axis: usize, is_over: bool) -> Folded {
        let [low, high] = self.span(axis);
        let middle = 0.5 * (low + high);
        let mut toggled = self.clone();
        toggled.mirrored[axis] = !self.mirrored[axis];
        toggled.part.outer[axis] =
            if toggled.mirrored[axis] { [middle, high] } else { [low, high] };
        for notch in toggled.part.notches.iter_mut().filter(|_| is_over) {
            notch.spans[axis] = image(notch.spans[axis], middle);
        }
        toggled
    }

    /// A contact, and where it would be felt on the other sides of the mirrors.
    fn images(&self, felt: &Felt) -> impl Iterator<Item = Felt> {
        let (mirrored, outer) = (self.mirrored, self.part.outer);
        // A bit for each axis that it is on the other side of.
        let is_one = move |over: &usize| (0..3).all(|axis| mirrored[axis] || over >> axis & 1 == 0);
        (0..8).filter(is_one).map(move |over| {
            let mut image = *felt;
            for axis in (0..3).filter(|axis| over >> axis & 1 == 1) {
                image.point[axis] = 2.0 * outer[axis][0] - image.point[axis];
                image.normal[axis] = -image.normal[axis];
            }
            image
        })
    }

    /// Whether a point (object frame, metres) is inside the whole.
    pub(super) fn contains(&self, point: &Point) -> bool {
        let mut seen = self.part.seen(point);
        for axis in self.mirrors() {
            let mirror = self.part.outer[axis][0];
            seen[axis] = mirror + (seen[axis] - mirror).abs();
        }
        self.part.holds(&seen)
    }

    /// Log probability of contacts that fall anywhere on the surface of the whole alike; `None` where this is not what
    /// it says, or less than `least`.
    pub(super) fn likelihood(&self, felt: &[Felt], wild: &Wild, least: f64) -> Option<f64> {
        let room = [0, 1, 2].map(|axis| LEAST * (self.span(axis)[1] - self.span(axis)[0]));
        let cells = Cells::of(&self.part, room)?;
        let mut facets = cells.facets();
        facets.retain(|facet| !self.is_mirror(facet.side));
        let copies = (1 << self.mirrors().count()) as f64;
        let area = copies * facets.iter().map(|facet| self.part.area(facet)).sum::<f64>();
        let mut log = -(felt.len() as f64) * area.ln();
        for felt in felt {
            let images = self.images(felt);
            let on =
                images.map(|felt| facets.iter().map(|f| self.part.touched(f, &felt)).sum::<f64>());
            // At most one, so that `log` only falls.
            log += (on.sum::<f64>().min(1.0 - wild.least) + wild.least).ln();
            if log < least {
                return None;
            }
        }
        (log >= least && cells.is_connected()).then_some(log)
    }

    /// All of it, mirrors or not.
    pub(super) fn whole(&self) -> Notched {
        let mut whole = self.part.clone();
        for axis in self.mirrors() {
            let mirror = self.part.outer[axis][0];
            whole.outer[axis] = self.span(axis);
            whole.notches =
                whole.notches.iter().flat_map(|notch| both(notch, axis, mirror)).collect();
        }
        whole
    }
}

/// A notch above a mirror and its image: one where they meet.
fn both(notch: &Notch, axis: usize, mirror: f64) -> impl Iterator<Item = Notch> {
    let own = notch.spans[axis];
    let other = image(own, mirror);
    let (first, second) =
        if own[0].is_finite() { (own, Some(other)) } else { ([other[0], own[1]], None) };
    let with = move |span: Span| {
        let mut spans = notch.spans;
        spans[axis] = span;
        Notch { spans }
    };
    [Some(first), second].into_iter().flatten().map(with)
}
