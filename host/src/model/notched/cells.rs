//! The surface of a box less smaller boxes, from the cells into which all sides cut the outer box.

use super::{Facet, Notch, Notched, Side, Span};

/// The cells, and which of them are left.
pub(super) struct Cells {
    dimension: usize,
    cuts: [Vec<(f64, Option<Side>)>; 3],
    filled: Vec<bool>,
}

impl Cells {
    /// `None` where a notch is within `least` of an end of the outer box, or thinner, or is in others, and where the outer
    /// box has no side.
    pub(super) fn of(solid: &Notched, least: [f64; 3]) -> Option<Cells> {
        let axes = 0..solid.dimension;
        let is_positive = axes.clone().all(|axis| solid.size(axis) > 0.0);
        if !is_positive || !solid.notches.iter().all(|notch| has_room(solid, notch, least)) {
            return None;
        }
        let mut cuts = [const { Vec::new() }; 3];
        for side in solid.sides() {
            cuts[side.axis].push((solid.at(side), Some(side)));
        }
        if solid.dimension == 2 {
            cuts[2] = vec![(-0.5, None), (0.5, None)];
        }
        for cuts in &mut cuts {
            cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let mut cells = Cells { dimension: solid.dimension, cuts, filled: vec![] };
        let mut alone = vec![false; solid.notches.len()];
        for cell in cells.all() {
            let middle = [0, 1, 2].map(|axis| {
                let [low, high] = cells.span(axis, cell[axis]);
                0.5 * (low + high)
            });
            let is_of = |notch: &Notch| {
                axes.clone().all(|axis| {
                    (notch.spans[axis][0]..notch.spans[axis][1]).contains(&middle[axis])
                })
            };
            let mut own = solid.notches.iter().enumerate().filter(|(_, notch)| is_of(notch));
            let (first, second) = (own.next(), own.next());
            if let (Some((notch, _)), None) = (first, second) {
                alone[notch] = true;
            }
            cells.filled.push(first.is_none());
        }
        (!alone.contains(&false) && cells.has_ends()).then_some(cells)
    }

    /// The surface of what is left.
    pub(super) fn facets(&self) -> Vec<Facet> {
        let mut facets = Vec::new();
        for cell in self.all().filter(|cell| self.is_filled(*cell)) {
            for (axis, end) in (0..self.dimension).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                if self.beside(cell, axis, end).is_some_and(|next| self.is_filled(next)) {
                    continue;
                }
                if let (at, Some(side)) = self.cuts[axis][cell[axis] + end] {
                    let spans = [0, 1, 2].map(|axis| self.span(axis, cell[axis]));
                    facets.push(Facet { side, at, spans });
                }
            }
        }
        facets
    }

    /// Whether what is left is one piece.
    pub(super) fn is_connected(&self) -> bool {
        let mut left: Vec<bool> = self.filled.clone();
        let Some(first) = self.all().find(|cell| self.is_filled(*cell)) else { return false };
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

    /// Whether something is left at every end of the outer box.
    fn has_ends(&self) -> bool {
        let counts = self.counts();
        (0..self.dimension).all(|axis| {
            [0, counts[axis] - 1]
                .into_iter()
                .all(|layer| self.all().any(|cell| cell[axis] == layer && self.is_filled(cell)))
        })
    }

    fn counts(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| self.cuts[axis].len() - 1)
    }

    fn index(&self, cell: [usize; 3]) -> usize {
        let [x, y, _] = self.counts();
        cell[0] + x * (cell[1] + y * cell[2])
    }

    fn is_filled(&self, cell: [usize; 3]) -> bool {
        self.filled[self.index(cell)]
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
}

/// Whether a notch lies within the outer box, leaves `least` of it at every end, and is no thinner.
fn has_room(solid: &Notched, notch: &Notch, least: [f64; 3]) -> bool {
    (0..solid.dimension).all(|axis| {
        let ([low, high], least) = (solid.outer[axis], least[axis]);
        let [from, to] = notch.spans[axis];
        let is_within = |at: f64| at.is_infinite() || at > low + least && at < high - least;
        is_within(from) && is_within(to) && to.min(high) - from.max(low) > least
    })
}
