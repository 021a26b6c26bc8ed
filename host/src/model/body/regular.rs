//! Regular polygons and, in space, the prisms and pyramids over them: equal sides all around an axis, between ends
//! square to it.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use nalgebra::{DVector, Matrix3, Rotation2, Rotation3};

use super::end::{Side, USUAL};
use super::fit::{Felt, Fit, Problem, Round, SHAPE, STEPS, TRIAL};
use super::turned::axes;
use super::{Body, Part, Plane};
use crate::model::Faces;
use crate::reference::Contact;
use crate::space::{self, Point};

/// How many sides there are. With more it is hardly another thing than round.
const SIDES: RangeInclusive<usize> = 3..=8;

/// Numbers of sides that are kept: a triangle and a hexagon explain the same few contacts.
const KEPT: usize = 2;

/// Numbers measured per parameter from which it is more than a guess: it has few.
const DECIDED: f64 = 1.5;

/// Cosine to the axis from which a normal is that of an end, where sides are parallel to it and where not.
const END: f64 = 0.7;
const END_TAPERED: f64 = 0.85;

/// How many times as probable it is before any contact that sides meet in a tip as that they are cut off before: a cut
/// is a side more, of which nobody felt anything.
const POINTED: f64 = 10.0;

/// What holds where it is begun to the ball where contacts do not say, in equations.
const HOLD: f64 = 0.1;

/// How many sides it has, and whether they may lean.
#[derive(Clone, Copy, PartialEq)]
struct Kind {
    sides: usize,
    is_tapered: bool,
}

/// Which one is sought. Its numbers, in radii of the ball about the contacts: by how much it is turned, radians,
/// where its middle is across the axis, how far out the sides are from there, by how much farther per length along
/// the axis, if it tapers, and the ends that were felt.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Regular {
    dimension: usize,
    kind: Kind,
    /// Unit and square to each other, where it was begun: out of a side, across, and its axis.
    axes: [Point; 3],
    /// Whether a contact is on the end where the axis leaves, and across.
    ends: [bool; 2],
}

impl Body {
    /// The regular prisms that fit best, polygons in the plane, of three to eight sides: of the two numbers of sides
    /// that are most probable, first with parallel sides, then, in space, with sides that lean. Ends that nobody felt
    /// lie beyond the contacts. None without contacts or normals, and where fewer than one and a half numbers were
    /// measured per parameter.
    ///
    /// Each number of sides is as probable before any contact; contacts that may fall anywhere on the
    /// surface are the less likely the larger that is, and any turn is as likely up to that of one side.
    pub fn regulars(dimension: usize, contacts: &[Contact], faces: &Faces) -> Vec<Body> {
        let Some(problem) = Problem::of(dimension, contacts) else { return vec![] };
        let axes = if dimension == 2 { vec![Point::z()] } else { axes(contacts, faces) };
        let mut bodies = Regular::likeliest(&problem, false, &axes);
        if dimension == 3 {
            bodies.extend(Regular::likeliest(&problem, true, &axes));
        }
        bodies
    }
}

impl Kind {
    /// Cosine to the axis from which a normal is that of an end.
    fn end(&self) -> f64 {
        if self.is_tapered { END_TAPERED } else { END }
    }

    /// By how much farther it is around than out to the sides.
    fn around(&self) -> f64 {
        let sides = self.sides as f64;
        2.0 * sides * (0.5 * TAU / sides).tan()
    }
}

impl Regular {
    /// Of the numbers of sides that are most probable.
    fn likeliest(problem: &Problem, is_tapered: bool, axes: &[Point]) -> Vec<Body> {
        let best = |sides| Regular::best(problem, Kind { sides, is_tapered }, axes);
        let mut found: Vec<(f64, f64, Body)> = SIDES.filter_map(best).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(KEPT);
        let kinds = (SIDES.count() as f64).ln();
        let body = |(_, turn, body): (f64, f64, Body)| {
            let oddity = body.oddity + turn + kinds;
            Body { oddity, ..body }
        };
        found.into_iter().map(body).collect()
    }

    /// Of so many sides about one of the axes, with what speaks against it, nats up to a constant, and how much of
    /// that its turn is.
    fn best(problem: &Problem, kind: Kind, axes: &[Point]) -> Option<(f64, f64, Body)> {
        let begun = |axis: &Point| {
            let regular = Regular::of(problem, kind, *axis)?;
            Some((regular, problem.climb(regular.begun(problem.felt()), TRIAL)))
        };
        let fits = axes.iter().filter_map(begun);
        let (regular, best) = fits.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))?;
        let fit = problem.climb(best, STEPS);
        let body = problem.body(&fit)?;
        let measured = problem.measured() as f64;
        if measured < DECIDED * (measured - body.degrees) {
            return None;
        }
        let turn = regular.turn();
        let against = 0.5 * fit.cost + regular.rarity(fit.parameters(), problem) + turn;
        let body = regular.ended(body, fit.parameters(), problem);
        against.is_finite().then_some((against, turn, body))
    }

    /// About the axis, turned as normals across it say.
    fn of(problem: &Problem, kind: Kind, axis: Point) -> Option<Regular> {
        let sides = kind.sides as f64;
        let [across, third] = space::across(3, &axis);
        let normals = problem.felt().iter().filter_map(|felt| felt.normal);
        let (mut sin, mut cos) = (0.0, 0.0);
        for normal in normals.clone().filter(|n| n.dot(&axis).abs() <= kind.end()) {
            let angle = sides * normal.dot(&third).atan2(normal.dot(&across));
            sin += angle.sin();
            cos += angle.cos();
        }
        if sin == 0.0 && cos == 0.0 {
            return None;
        }
        let (sin, cos) = (sin.atan2(cos) / sides).sin_cos();
        let axes = [across * cos + third * sin, third * cos - across * sin, axis];
        let ends = [1.0, -1.0].map(|way| normals.clone().any(|n| way * n.dot(&axis) > kind.end()));
        Some(Regular { dimension: problem.dimension(), kind, axes, ends })
    }

    /// Cosine and sine of the way from the middle out of each side.
    fn ways(&self) -> impl Iterator<Item = (f64, f64)> {
        let sides = self.kind.sides;
        (0..sides).map(move |side| {
            let (sin, cos) = (TAU * side as f64 / sides as f64).sin_cos();
            (cos, sin)
        })
    }

    fn felt_ends(&self) -> impl Iterator<Item = f64> {
        [1.0, -1.0].into_iter().zip(self.ends).filter_map(|(way, is_felt)| is_felt.then_some(way))
    }

    /// How many numbers say how it is turned; the middle is next, how far out the sides are, how much farther along
    /// the axis, then the ends.
    fn turns(&self) -> usize {
        if self.dimension == 2 { 1 } else { 3 }
    }

    /// Where the ends' numbers begin.
    fn lengths(&self) -> usize {
        self.turns() + 3 + usize::from(self.kind.is_tapered)
    }

    pub(super) fn count(&self) -> usize {
        self.lengths() + self.felt_ends().count()
    }

    /// By how much farther out the sides are per length along the axis.
    fn widening(&self, numbers: &DVector<f64>) -> f64 {
        if self.kind.is_tapered { numbers[self.turns() + 3] } else { 0.0 }
    }

    /// What most have: those of one as wide every way as the ball.
    pub(super) fn usual(&self) -> DVector<f64> {
        let (far, lengths) = (self.turns() + 2, self.lengths());
        let is_long = |i| i == far || i >= lengths;
        DVector::from_fn(self.count(), |i, _| if is_long(i) { USUAL.0 } else { 0.0 })
    }

    fn turned(&self, numbers: &DVector<f64>, out: Point) -> Point {
        if self.dimension == 2 {
            let turned = Rotation2::new(numbers[0]) * out.xy();
            return Point::new(turned.x, turned.y, 0.0);
        }
        Rotation3::new(Point::new(numbers[0], numbers[1], numbers[2])) * out
    }

    /// `None` where its sides enclose nothing.
    pub(super) fn parts(&self, numbers: &DVector<f64>) -> Option<Vec<Part>> {
        let at = self.turns();
        let (first, second, far) = (numbers[at], numbers[at + 1], numbers[at + 2]);
        let widening = self.widening(numbers);
        let slant = 1.0_f64.hypot(widening);
        let side = |(cos, sin): (f64, f64)| {
            let out = self.axes[0] * cos + self.axes[1] * sin - self.axes[2] * widening;
            let offset = (far + first * cos + second * sin) / slant;
            Part::Plane(Plane { normal: self.turned(numbers, out / slant), offset })
        };
        let end = |(way, offset): (f64, &f64)| {
            let normal = self.turned(numbers, self.axes[2] * way);
            Part::Plane(Plane { normal, offset: *offset })
        };
        let ends = self.felt_ends().zip(numbers.iter().skip(self.lengths())).map(end);
        (far > 0.0).then(|| self.ways().map(side).chain(ends).collect())
    }

    /// Where contacts place it if these are its axes: linear in the middle and how far out the sides are.
    fn begun(&self, felt: &[Felt]) -> Fit {
        let mut numbers = self.usual();
        let (at, axis) = (self.turns(), self.axes[2]);
        let is_side = |n: &Point| n.dot(&axis).abs() <= self.kind.end();
        let slopes = felt.iter().filter_map(|f| f.normal.filter(is_side)).map(|n| n.dot(&axis));
        let slope = slopes.clone().sum::<f64>() / slopes.count().max(1) as f64;
        let widening =
            if self.kind.is_tapered { -slope / (1.0 - slope * slope).sqrt() } else { 0.0 };
        let (mut square, mut right) = (Matrix3::identity() * HOLD, Point::z() * HOLD);
        for felt in felt {
            let Some(normal) = felt.normal.filter(is_side) else { continue };
            let out = (normal.dot(&self.axes[0]), normal.dot(&self.axes[1]));
            let along = |(cos, sin): &(f64, f64)| cos * out.0 + sin * out.1;
            let ways = self.ways();
            let Some((cos, sin)) = ways.max_by(|a, b| along(a).total_cmp(&along(b))) else {
                continue;
            };
            let row = Point::new(cos, sin, 1.0);
            let out = self.axes[0] * cos + self.axes[1] * sin - axis * widening;
            let offset = out.dot(&felt.point);
            square += row * row.transpose();
            right += row * offset;
        }
        if let Some(found) = square.cholesky().map(|factor| factor.solve(&right)) {
            numbers.rows_mut(at, 3).copy_from(&found);
        }
        if self.kind.is_tapered {
            numbers[at + 3] = widening;
        }
        for (end, way) in self.felt_ends().enumerate() {
            let out = axis * way;
            let on =
                felt.iter().filter(|f| f.normal.is_some_and(|n| n.dot(&out) > self.kind.end()));
            let sum: f64 = on.clone().map(|f| out.dot(&f.point)).sum();
            numbers[self.lengths() + end] = sum / on.count().max(1) as f64;
        }
        Fit::begun(Round::Regular(*self), numbers)
    }

    /// How far the ends are along the axis and against it: where they were felt, else as far as the contacts.
    fn reach(&self, numbers: &DVector<f64>, felt: &[Felt]) -> [f64; 2] {
        let mut known = numbers.iter().skip(self.lengths()).copied();
        [1.0, -1.0].map(|way| {
            let out = self.turned(numbers, self.axes[2] * way);
            let outermost =
                felt.iter().map(|f| out.dot(&f.point)).fold(f64::NEG_INFINITY, f64::max);
            let is_felt = self.felt_ends().any(|felt| felt == way);
            if is_felt { known.next().unwrap_or(outermost) } else { outermost }
        })
    }

    /// How much less likely the turn is than among as many as a parameter has before any contact, nats: those up to
    /// that of one side are alike.
    fn turn(&self) -> f64 {
        -(self.kind.sides as f64 * SHAPE / TAU.sqrt()).ln()
    }

    /// How little likely contacts are on a surface as large, nats.
    fn rarity(&self, numbers: &DVector<f64>, problem: &Problem) -> f64 {
        let around = self.kind.around();
        let size = if self.dimension == 2 {
            around * numbers[self.turns() + 2]
        } else {
            let side = self.side(numbers, problem.felt(), 1.0);
            0.5 * around * side.area(side.high)
        };
        problem.places() as f64 * size.ln()
    }

    /// Its sides towards the end along the axis or, where `way` is -1, against it, as those of a round body.
    fn side(&self, numbers: &DVector<f64>, felt: &[Felt], way: f64) -> Side {
        let reach = self.reach(numbers, felt);
        let [far, near] = if way > 0.0 { reach } else { [reach[1], reach[0]] };
        let (radius, widening) = (numbers[self.turns() + 2], self.widening(numbers));
        Side { radius, widening: way * widening, low: -near, high: far, pointed: POINTED }
    }

    /// The body cut where no end was felt.
    fn ended(&self, mut body: Body, numbers: &DVector<f64>, problem: &Problem) -> Body {
        if self.dimension == 2 {
            return body;
        }
        for (way, is_felt) in [1.0, -1.0].into_iter().zip(self.ends) {
            if is_felt {
                continue;
            }
            let side = self.side(numbers, problem.felt(), way);
            let Some((offset, deviation)) = side.end(problem.places(), 0.0) else { continue };
            let normal = self.turned(numbers, self.axes[2] * way);
            if let Some(plane) = problem.placed_plane(normal, offset) {
                body.end(plane, deviation * problem.radius());
            }
        }
        body
    }
}

#[cfg(test)]
mod tests;
