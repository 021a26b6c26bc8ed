//! What a box less smaller boxes may be next in a chain. Every move says how much more often its way back is drawn.

use nalgebra::Rotation3;

use super::chain::{Chains, Replica};
use super::folded::Folded;
use super::{Felt, MOST, Notch, Notched, SQUARE, Side, Span};

/// What there is, and how often.
#[derive(Clone, Copy)]
enum Move {
    /// One notch more.
    Cut,
    /// One notch less.
    Fill,
    /// A side a little farther in or out.
    Shift,
    /// A side where a contact is, or anywhere.
    Place,
    /// All a little turned.
    Turn,
    /// A mirror more or less.
    Fold,
    /// A mirror instead of a notch, or a notch instead of a mirror.
    Exchange,
    /// A notch where its image is.
    Flip,
    /// A notch at a corner instead of one in a side, or the other way.
    Open,
}

const MOVES: [(Move, f64); 9] = [
    (Move::Cut, 0.2),
    (Move::Fill, 0.2),
    (Move::Shift, 0.27),
    (Move::Place, 0.13),
    (Move::Turn, 0.04),
    (Move::Fold, 0.04),
    (Move::Exchange, 0.04),
    (Move::Flip, 0.04),
    (Move::Open, 0.04),
];

/// Notches that a box has before any contact, on average.
const RATE: f64 = 2.0;

/// Share of boxes that have one before any contact: their number is Poisson's, up to the most there are. A little less
/// have, for those that leave nothing between them are none.
pub(super) fn notched_before() -> f64 {
    let mut odds = 1.0;
    let all = (1..=MOST).map(|count| {
        odds *= RATE / count as f64;
        odds
    });
    let notched: f64 = all.sum();
    notched / (1.0 + notched)
}

/// How often a notch is one in a side, not at a corner, and in space one of all three dimensions.
const POCKET: f64 = 0.25;
const SOLID: f64 = 0.2;

/// Small moves, in contacts' deviations and radii of what they span.
const FINE: f64 = 0.5;
const COARSE: f64 = 0.2;

/// Turns, radians.
const TURN: f64 = 0.01;

const OPEN: Span = [f64::NEG_INFINITY, f64::INFINITY];

/// What may be next, and the log of how much more often the way back is drawn, prior numbers and kinds of notches
/// included. What is no box less smaller boxes may be among it.
type Proposal = (Folded, f64);

impl Chains<'_> {
    /// `None` where there is nothing that the move could change.
    pub(super) fn proposed(&mut self, now: &Replica) -> Option<Proposal> {
        let mut left = self.random.unit();
        let mut all = MOVES.into_iter();
        let is_it = |(_, share): &(Move, f64)| {
            left -= share;
            left < 0.0
        };
        let (chosen, _) = all.find(is_it).unwrap_or(MOVES[0]);
        match chosen {
            Move::Cut => self.cut(&now.felt, now.solid.clone()),
            Move::Fill => self.filled(&now.felt, now.solid.clone()),
            Move::Shift => Some(self.shifted(&now.solid)),
            Move::Place => Some(self.placed(now)),
            Move::Turn => Some(self.turned(&now.solid)),
            Move::Fold => Some(self.folded(&now.solid)),
            Move::Exchange => self.exchanged(now),
            Move::Flip => self.flipped(&now.solid),
            Move::Open => self.opened(now),
        }
    }

    fn pick(&mut self, count: usize) -> usize {
        ((self.random.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    fn side(&mut self, solid: &Folded) -> Side {
        let sides = solid.part.sides();
        sides[self.pick(sides.len())]
    }

    fn notch(&mut self, solid: &Folded) -> Option<usize> {
        let count = solid.part.notches.len();
        (count > 0).then(|| self.pick(count))
    }

    fn shifted(&mut self, solid: &Folded) -> Proposal {
        let side = self.side(solid);
        let steps = [FINE * self.deviation, 4.0 * self.deviation, COARSE * self.radius];
        let step = steps[self.pick(3)] * self.random.normal_pair()[0];
        (solid.moved(side, solid.part.at(side) + step), 0.0)
    }

    fn placed(&mut self, now: &Replica) -> Proposal {
        let side = self.side(&now.solid);
        let places = Places::of(self, &now.felt, &now.solid, side);
        let to = places.drawn(self);
        let odds = places.density(now.solid.part.at(side)).ln() - places.density(to).ln();
        (now.solid.moved(side, to), odds)
    }

    fn turned(&mut self, solid: &Folded) -> Proposal {
        let mut turn = self.random.normal3() * TURN;
        if solid.part.dimension == 2 {
            (turn.x, turn.y) = (0.0, 0.0);
        }
        let part = Notched { frame: Rotation3::new(turn) * solid.part.frame, ..solid.part.clone() };
        (Folded { part, ..*solid }, 0.0)
    }

    fn folded(&mut self, solid: &Folded) -> Proposal {
        let (axis, is_over) = (self.pick(solid.part.dimension), self.pick(2) == 1);
        (solid.toggled(axis, is_over), 0.0)
    }

    fn exchanged(&mut self, now: &Replica) -> Option<Proposal> {
        let (axis, is_over) = (self.pick(now.solid.part.dimension), self.pick(2) == 1);
        if now.solid.mirrored[axis] {
            return self.cut(&now.felt, now.solid.toggled(axis, is_over));
        }
        let (solid, odds) = self.filled(&now.felt, now.solid.clone())?;
        Some((solid.toggled(axis, is_over), odds))
    }

    fn flipped(&mut self, solid: &Folded) -> Option<Proposal> {
        let axis = self.pick(solid.part.dimension);
        let notch = self.notch(solid)?;
        let mut flipped = solid.clone();
        flipped.part.notches[notch] = solid.part.flipped(notch, axis);
        Some((flipped, 0.0))
    }

    fn opened(&mut self, now: &Replica) -> Option<Proposal> {
        let number = self.notch(&now.solid)?;
        let spans = now.solid.part.notches[number].spans;
        let ends = spans.map(|span| span.iter().filter(|at| at.is_finite()).count());
        let rarer = (POCKET / (1.0 - POCKET)).ln();
        // Either end of a pocket is opened, either side of a corner closed, as often.
        if let Some(axis) = ends.iter().position(|count| *count == 2) {
            let side = Side { notch: Some(number), axis, end: self.pick(2) };
            let density =
                Places::of(self, &now.felt, &now.solid, side).density(now.solid.part.at(side));
            return Some((now.solid.moved(side, OPEN[side.end]), density.ln() - rarer));
        }
        let closed: Vec<usize> = (0..3).filter(|axis| ends[*axis] == 1).collect();
        if closed.len() != 2 {
            return None;
        }
        let axis = closed[self.pick(2)];
        let side =
            Side { notch: Some(number), axis, end: usize::from(spans[axis][1].is_infinite()) };
        let places = Places::of(self, &now.felt, &now.solid, side);
        let to = places.drawn(self);
        Some((now.solid.moved(side, to), rarer - places.density(to).ln()))
    }

    fn cut(&mut self, felt: &[Felt], mut solid: Folded) -> Option<Proposal> {
        let count = solid.part.notches.len();
        if count == MOST {
            return None;
        }
        let spans = self.kind(solid.part.dimension);
        solid.part.notches.push(Notch { spans });
        for side in solid.part.sides().into_iter().filter(|side| side.notch == Some(count)) {
            let to = Places::of(self, felt, &solid, side).drawn(self);
            solid = solid.moved(side, to);
        }
        let odds = RATE.ln() - (count as f64 + 1.0).ln() - self.drawn(felt, &solid, count);
        Some((solid, odds))
    }

    fn filled(&mut self, felt: &[Felt], mut solid: Folded) -> Option<Proposal> {
        let notch = self.notch(&solid)?;
        let count = solid.part.notches.len() as f64;
        let odds = count.ln() - RATE.ln() + self.drawn(felt, &solid, notch);
        solid.part.notches.remove(notch);
        Some((solid, odds))
    }

    /// Log density with which a notch's sides are drawn.
    fn drawn(&self, felt: &[Felt], solid: &Folded, notch: usize) -> f64 {
        let own = solid.part.sides().into_iter().filter(|side| side.notch == Some(notch));
        own.map(|side| Places::of(self, felt, solid, side).density(solid.part.at(side)).ln()).sum()
    }

    /// Where a notch has sides (at zero), and where it is open.
    fn kind(&mut self, dimension: usize) -> [Span; 3] {
        let mut spans = [OPEN; 3];
        let through = if dimension == 3 && self.random.unit() < SOLID {
            3
        } else if dimension == 3 {
            self.pick(3)
        } else {
            2
        };
        for axis in (0..dimension).filter(|axis| *axis != through) {
            spans[axis][self.pick(2)] = 0.0;
        }
        if through < 3 && self.random.unit() < POCKET {
            let axes: Vec<usize> = (0..dimension).filter(|axis| *axis != through).collect();
            spans[axes[self.pick(axes.len())]] = [0.0; 2];
        }
        spans
    }
}

/// Where a side may be: where contacts with its normal are, and anywhere about them.
struct Places {
    felt: Vec<f64>,
    deviation: f64,
    window: Span,
}

impl Places {
    /// A contact on the other side of a mirror counts where its image is. A mirror is as far from the outer box's side as
    /// from a contact on that side's image.
    fn of(chains: &Chains<'_>, felt: &[Felt], solid: &Folded, side: Side) -> Places {
        let axis = side.axis;
        let [low, high] = solid.part.outer[axis];
        let place = |felt: &Felt| {
            let (at, along) = (felt.point[axis], side.sign() * felt.normal[axis]);
            if solid.is_mirror(side) {
                (along > SQUARE).then_some(0.5 * (at + high))
            } else if solid.mirrored[axis] && along < -SQUARE {
                Some(2.0 * low - at)
            } else {
                (along > SQUARE).then_some(at)
            }
        };
        let window = [-3.0, 3.0].map(|by| chains.middle[axis] + by * chains.radius);
        Places {
            felt: felt.iter().filter_map(place).collect(),
            deviation: chains.deviation,
            window,
        }
    }

    fn drawn(&self, chains: &mut Chains<'_>) -> f64 {
        if self.felt.is_empty() || chains.random.unit() < 0.5 {
            let [low, high] = self.window;
            return low + (high - low) * chains.random.unit();
        }
        self.felt[chains.pick(self.felt.len())] + self.deviation * chains.random.normal_pair()[0]
    }

    fn density(&self, at: f64) -> f64 {
        let [low, high] = self.window;
        let anywhere = if (low..high).contains(&at) { 1.0 / (high - low) } else { 0.0 };
        if self.felt.is_empty() {
            return anywhere;
        }
        let near = |felt: &f64| (-0.5 * ((at - felt) / self.deviation).powi(2)).exp();
        let scale = self.deviation * std::f64::consts::TAU.sqrt() * self.felt.len() as f64;
        0.5 * anywhere + 0.5 * self.felt.iter().map(near).sum::<f64>() / scale
    }
}
