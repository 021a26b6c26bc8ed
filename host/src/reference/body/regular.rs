//! Regular polygons and, in space, the prisms over them: equal sides all around an axis, between ends square to it.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use nalgebra::{DVector, Matrix3, Rotation2, Rotation3};

use super::end::{Side, USUAL};
use super::fit::{Felt, Fit, Problem, Round, SHAPE, STEPS, TRIAL};
use super::turned::axes;
use super::{Body, Part, Plane};
use crate::reference::{Contact, Faces};
use crate::space::Point;

/// How many sides there are. With more it is hardly another thing than round.
const SIDES: RangeInclusive<usize> = 3..=8;

/// Numbers of sides that are kept: a triangle and a hexagon explain the same few contacts.
const KEPT: usize = 2;

/// Numbers measured per parameter from which it is more than a guess: it has few.
const DECIDED: f64 = 1.5;

/// Cosine to the axis from which a normal is that of an end.
const END: f64 = 0.7;

/// What holds where it is begun to the ball where contacts do not say, in equations.
const HOLD: f64 = 0.1;

/// Which one is sought. Its numbers, in radii of the ball about the contacts: by how much it is turned, radians,
/// where its middle is across the axis, how far out the sides are from there, and the ends that were felt.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Regular {
    dimension: usize,
    sides: usize,
    /// Unit and square to each other, where it was begun: out of a side, across, and its axis.
    axes: [Point; 3],
    /// Whether a contact is on the end where the axis leaves, and across.
    ends: [bool; 2],
}

impl Body {
    /// The regular prisms that fit best, polygons in the plane, of three to eight sides: of the two numbers of sides
    /// that are most probable. Ends that nobody felt lie beyond the contacts. None without contacts or normals,
    /// and where fewer than one and a half numbers were measured per parameter.
    ///
    /// Each number of sides is as probable before any contact; contacts that may fall anywhere on the
    /// surface are the less likely the larger that is, and any turn is as likely up to that of one side.
    pub fn regulars(dimension: usize, contacts: &[Contact], faces: &Faces) -> Vec<Body> {
        let Some(problem) = Problem::of(dimension, contacts) else { return vec![] };
        let axes = if dimension == 2 { vec![Point::z()] } else { axes(contacts, faces) };
        let mut found: Vec<(f64, f64, Body)> =
            SIDES.filter_map(|sides| Regular::best(&problem, sides, &axes)).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(KEPT);
        let Some(first) = found.first().map(|(_, rarity, _)| *rarity) else { return vec![] };
        let kinds = (SIDES.count() as f64).ln();
        let body = |(_, rarity, body): (f64, f64, Body)| {
            let oddity = body.oddity + rarity - first + kinds;
            Body { oddity, ..body }
        };
        found.into_iter().map(body).collect()
    }
}

impl Regular {
    /// Of so many sides about one of the axes, with what speaks against it and how much of that the contacts'
    /// places are, nats up to a constant.
    fn best(problem: &Problem, sides: usize, axes: &[Point]) -> Option<(f64, f64, Body)> {
        let begun = |axis: &Point| {
            let regular = Regular::of(problem, sides, *axis)?;
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
        let rarity = regular.rarity(fit.parameters(), problem.felt());
        let against = 0.5 * fit.cost + rarity;
        let body = regular.ended(body, fit.parameters(), problem);
        against.is_finite().then_some((against, rarity, body))
    }

    /// About the axis, turned as normals across it say.
    fn of(problem: &Problem, sides: usize, axis: Point) -> Option<Regular> {
        let across = axis.cross(&Point::ith(axis.iamin(), 1.0)).normalize();
        let third = axis.cross(&across);
        let normals = problem.felt().iter().filter_map(|felt| felt.normal);
        let (mut sin, mut cos) = (0.0, 0.0);
        for normal in normals.clone().filter(|n| n.dot(&axis).abs() <= END) {
            let angle = sides as f64 * normal.dot(&third).atan2(normal.dot(&across));
            sin += angle.sin();
            cos += angle.cos();
        }
        if sin == 0.0 && cos == 0.0 {
            return None;
        }
        let (sin, cos) = (sin.atan2(cos) / sides as f64).sin_cos();
        let axes = [across * cos + third * sin, third * cos - across * sin, axis];
        let ends = [1.0, -1.0].map(|way| normals.clone().any(|n| way * n.dot(&axis) > END));
        Some(Regular { dimension: problem.dimension(), sides, axes, ends })
    }

    /// Cosine and sine of the way from the middle out of each side.
    fn ways(&self) -> impl Iterator<Item = (f64, f64)> {
        let sides = self.sides;
        (0..sides).map(move |side| {
            let (sin, cos) = (TAU * side as f64 / sides as f64).sin_cos();
            (cos, sin)
        })
    }

    fn felt_ends(&self) -> impl Iterator<Item = f64> {
        [1.0, -1.0].into_iter().zip(self.ends).filter_map(|(way, is_felt)| is_felt.then_some(way))
    }

    /// How many numbers say how it is turned; the middle is next, how far out the sides are, then the ends.
    fn turns(&self) -> usize {
        if self.dimension == 2 { 1 } else { 3 }
    }

    pub(super) fn count(&self) -> usize {
        self.turns() + 3 + self.felt_ends().count()
    }

    /// What most have: those of one as wide every way as the ball.
    pub(super) fn usual(&self) -> DVector<f64> {
        let far = self.turns() + 2;
        DVector::from_fn(self.count(), |i, _| if i < far { 0.0 } else { USUAL.0 })
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
        let side = |(cos, sin): (f64, f64)| {
            let normal = self.turned(numbers, self.axes[0] * cos + self.axes[1] * sin);
            Part::Plane(Plane { normal, offset: far + first * cos + second * sin })
        };
        let end = |(way, offset): (f64, &f64)| {
            let normal = self.turned(numbers, self.axes[2] * way);
            Part::Plane(Plane { normal, offset: *offset })
        };
        let ends = self.felt_ends().zip(numbers.iter().skip(at + 3)).map(end);
        (far > 0.0).then(|| self.ways().map(side).chain(ends).collect())
    }

    /// Where contacts place it if these are its axes: linear in the middle and how far out the sides are.
    fn begun(&self, felt: &[Felt]) -> Fit {
        let mut numbers = self.usual();
        let at = self.turns();
        let (mut square, mut right) = (Matrix3::identity() * HOLD, Point::z() * HOLD);
        for felt in felt {
            let Some(normal) = felt.normal.filter(|n| n.dot(&self.axes[2]).abs() <= END) else {
                continue;
            };
            let out = (normal.dot(&self.axes[0]), normal.dot(&self.axes[1]));
            let along = |(cos, sin): &(f64, f64)| cos * out.0 + sin * out.1;
            let ways = self.ways();
            let Some((cos, sin)) = ways.max_by(|a, b| along(a).total_cmp(&along(b))) else {
                continue;
            };
            let row = Point::new(cos, sin, 1.0);
            let offset = (self.axes[0] * cos + self.axes[1] * sin).dot(&felt.point);
            square += row * row.transpose();
            right += row * offset;
        }
        if let Some(found) = square.cholesky().map(|factor| factor.solve(&right)) {
            numbers.rows_mut(at, 3).copy_from(&found);
        }
        for (end, way) in self.felt_ends().enumerate() {
            let out = self.axes[2] * way;
            let on = felt.iter().filter(|f| f.normal.is_some_and(|n| n.dot(&out) > END));
            let sum: f64 = on.clone().map(|f| out.dot(&f.point)).sum();
            numbers[at + 3 + end] = sum / on.count().max(1) as f64;
        }
        Fit::begun(Round::Regular(*self), numbers)
    }

    /// How far the ends are along the axis and against it: where they were felt, else as far as the contacts.
    fn reach(&self, numbers: &DVector<f64>, felt: &[Felt]) -> [f64; 2] {
        let mut known = numbers.iter().skip(self.turns() + 3).copied();
        [1.0, -1.0].map(|way| {
            let out = self.turned(numbers, self.axes[2] * way);
            let outermost =
                felt.iter().map(|f| out.dot(&f.point)).fold(f64::NEG_INFINITY, f64::max);
            let is_felt = self.felt_ends().any(|felt| felt == way);
            if is_felt { known.next().unwrap_or(outermost) } else { outermost }
        })
    }

    /// How little likely contacts are on a surface as large, and how likely the turn among as few, nats.
    fn rarity(&self, numbers: &DVector<f64>, felt: &[Felt]) -> f64 {
        let sides = self.sides as f64;
        let far = numbers[self.turns() + 2];
        let around = 2.0 * sides * far * (0.5 * TAU / sides).tan();
        // Both ends together are as large as sides that are as high as they are far out.
        let high = if self.dimension == 2 {
            1.0
        } else {
            self.reach(numbers, felt).iter().sum::<f64>() + far
        };
        let turn = sides * SHAPE / TAU.sqrt();
        felt.len() as f64 * (around * high).ln() - turn.ln()
    }

    /// The body cut where no end was felt.
    fn ended(&self, mut body: Body, numbers: &DVector<f64>, problem: &Problem) -> Body {
        if self.dimension == 2 {
            return body;
        }
        let reach = self.reach(numbers, problem.felt());
        // Of a round body whose ends are as large a part of its surface.
        let radius = numbers[self.turns() + 2];
        for (end, way) in [1.0, -1.0].into_iter().enumerate().filter(|(end, _)| !self.ends[*end]) {
            let side = Side { radius, widening: 0.0, low: -reach[1 - end], high: reach[end] };
            let Some((offset, deviation)) = side.end(problem.felt().len(), 0.0) else { continue };
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
