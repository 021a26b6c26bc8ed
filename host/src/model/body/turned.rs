//! Bodies turned on a lathe, or drawn out of an oval: cans, cups and cones between flat ends square to
//! their axis.

use nalgebra::{DVector, Matrix3, SymmetricEigen};

use super::end::{Side, USUAL};
use super::fit::{Felt, Fit, Problem, Round, STEPS, TRIAL};
use super::{Body, Part, Plane, Quadric};
use crate::model::Faces;
use crate::reference::Contact;
use crate::space::{self, Point, centroid, scatter};

/// Numbers measured per parameter from which a turned body is more than a guess.
const DECIDED: f64 = 2.0;

/// Cosine of the angle to another axis up to which one is the same, and to the axis up to which a normal is
/// that of a flat end.
const SAME: f64 = 0.97;
const END: f64 = 0.9;

/// Axes that are tried at most.
const AXES: usize = 12;

/// What holds where a turned body is begun to the ball where contacts do not say, in equations.
const HOLD: f64 = 0.1;

/// Least radius it is begun with.
const THIN: f64 = 0.2;

/// Which body is sought. Its numbers, in radii of the ball about the contacts: a centre and an axis, the
/// inverse radius, how much wider it gets per length along the axis, the distances of its ends, and by how
/// much a cross-section is not round.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Turned {
    /// Unit; where the axis was begun, and what a cross-section's directions are told from.
    axis: Point,
    /// Whether there is a flat end where the axis leaves, and across.
    ends: [bool; 2],
    is_oval: bool,
}

/// Where its numbers are.
const AXIS: usize = 3;
const INVERSE: usize = 6;
const WIDENING: usize = 7;
const LENGTHS: usize = 8;

impl Body {
    /// The cylinder or cone that fits best, round or, `is_oval`, of elliptic cross-section, between flat
    /// ends square to its axis: where contacts have such normals, and beyond the contacts where not.
    /// `None` in the plane, without contacts, or when fewer than two numbers were measured per parameter.
    pub fn turned(
        dimension: usize,
        contacts: &[Contact],
        faces: &Faces,
        is_oval: bool,
    ) -> Option<Body> {
        if dimension != 3 {
            return None;
        }
        let problem = Problem::of(dimension, contacts)?;
        let fits = axes(contacts, faces).into_iter().map(|axis| {
            let has = |way: f64| {
                contacts.iter().filter_map(|c| c.normal).any(|n| way * n.dot(&axis) > END)
            };
            let turned = Turned { axis, ends: [has(1.0), has(-1.0)], is_oval };
            (turned, problem.climb(turned.begun(problem.felt()), TRIAL))
        });
        let (turned, best) = fits.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))?;
        let fit = problem.climb(best, STEPS);
        let body = problem.body(&fit)?;
        let measured = problem.measured() as f64;
        if measured < DECIDED * (measured - body.degrees) {
            return None;
        }
        Some(turned.ended(body, fit.parameters(), &problem).closed(dimension, contacts, &[]))
    }
}

impl Turned {
    pub(super) fn count(&self) -> usize {
        LENGTHS + self.lengths() + if self.is_oval { 2 } else { 0 }
    }

    /// Numbers that change nothing: the centre along the axis, as far as the sides are parallel, and the
    /// axis's length.
    pub(super) const IDLE: usize = 2;

    /// Ways along the axis that end flat.
    fn felt_ends(&self) -> impl Iterator<Item = f64> {
        [1.0, -1.0].into_iter().zip(self.ends).filter_map(|(way, is_flat)| is_flat.then_some(way))
    }

    fn lengths(&self) -> usize {
        self.felt_ends().count()
    }

    /// What most bodies have: those of a cylinder as wide and as long as the ball.
    pub(super) fn usual(&self) -> DVector<f64> {
        let mut numbers = DVector::zeros(self.count());
        numbers.rows_mut(AXIS, 3).copy_from(&self.axis);
        numbers[INVERSE] = 1.0;
        numbers.rows_mut(LENGTHS, self.lengths()).fill(USUAL.0);
        numbers
    }

    fn axis_of(&self, numbers: &DVector<f64>) -> Option<Point> {
        Point::from_fn(|i, _| numbers[AXIS + i]).try_normalize(1e-9)
    }

    /// By how much a cross-section is no circle, as the root of its form has it: along the two directions
    /// across, and between them.
    fn oval(&self, numbers: &DVector<f64>) -> (f64, f64) {
        let first = LENGTHS + self.lengths();
        if self.is_oval { (numbers[first], numbers[first + 1]) } else { (0.0, 0.0) }
    }

    /// The side first; `None` where numbers stand for nothing.
    pub(super) fn parts(&self, numbers: &DVector<f64>) -> Option<Vec<Part>> {
        let axis = self.axis_of(numbers)?;
        let (inverse, lengths) = (numbers[INVERSE], self.lengths());
        let (long, askew) = self.oval(numbers);
        if !(inverse > long.hypot(askew)) {
            return None;
        }
        let [first, second] = space::across(3, &self.axis);
        let root = Matrix3::identity() * inverse
            + (first * first.transpose() - second * second.transpose()) * long
            + (first * second.transpose() + second * first.transpose()) * askew;
        let root = (Matrix3::identity() - axis * axis.transpose()) * root;
        let centre = Point::from_fn(|i, _| numbers[i]);
        let taper = axis * (numbers[WIDENING] * inverse);
        let side = Quadric::tapered(centre, root * root.transpose(), taper)?;
        let normals = self.felt_ends().map(|way| axis * way);
        let offsets = numbers.rows(LENGTHS, lengths).into_owned();
        let end = |(normal, offset): (Point, &f64)| Part::Plane(Plane { normal, offset: *offset });
        let ends = normals.zip(offsets.iter()).map(end);
        Some([Part::Quadric(side)].into_iter().chain(ends).collect())
    }

    /// The body cut where no flat end was felt.
    fn ended(&self, mut body: Body, numbers: &DVector<f64>, problem: &Problem) -> Body {
        let Some(axis) = self.axis_of(numbers) else { return body };
        let centre = Point::from_fn(|i, _| numbers[i]);
        let (long, askew) = self.oval(numbers);
        // Of a circle as large as the cross-section, and by how much that gets wider.
        let radius = (numbers[INVERSE].powi(2) - long.powi(2) - askew.powi(2)).sqrt().recip();
        let wider = numbers[WIDENING] * numbers[INVERSE] * radius;
        for (out, is_felt) in [axis, -axis].into_iter().zip(self.ends) {
            if is_felt {
                continue;
            }
            let widening = out.dot(&axis) * wider;
            let along = problem.felt().iter().map(|felt| out.dot(&(felt.point - centre)));
            let low = along.clone().fold(f64::INFINITY, f64::min);
            let high = along.fold(f64::NEG_INFINITY, f64::max);
            let side = Side { radius, widening, low, high, pointed: 1.0 };
            let middle = -out.dot(&centre);
            let Some((end, deviation)) = side.end(problem.places(), middle) else { continue };
            if let Some(plane) = problem.placed_plane(out, end - middle) {
                body.end(plane, deviation * problem.radius());
            }
        }
        body
    }

    /// Where contacts place it to first order if this is its axis: normals of the side say how it widens,
    /// and by how much their lines miss the axis where that is; a flat end is where it was felt.
    fn begun(&self, felt: &[Felt]) -> Fit {
        let mut numbers = self.usual();
        let along = |felt: &Felt| felt.normal.map_or(0.0, |n| n.dot(&self.axis));
        let sides: Vec<&Felt> =
            felt.iter().filter(|f| f.normal.is_some() && along(f).abs() <= END).collect();
        let slope = sides.iter().map(|f| along(f)).sum::<f64>() / sides.len().max(1) as f64;
        let widening = -slope / (1.0 - slope * slope).sqrt();
        numbers[WIDENING] = widening;
        // A contact lies in the direction of its normal from the axis, as far as the body is wide there:
        // linear in the centre across the axis and the radius.
        let (mut square, mut right) = (Matrix3::identity() * HOLD, Point::z() * HOLD);
        let [first, second] = space::across(3, &self.axis);
        for felt in sides {
            let Some(normal) = felt.normal else { continue };
            let out = (normal.dot(&first), normal.dot(&second));
            let length = out.0.hypot(out.1);
            let wider = widening * felt.point.dot(&self.axis);
            for (direction, out, axis) in [(first, out.0, 0), (second, out.1, 1)] {
                let mut row = Point::ith(axis, 1.0);
                row.z = out / length;
                square += row * row.transpose();
                right += row * (felt.point.dot(&direction) - wider * row.z);
            }
        }
        if let Some(found) = square.cholesky().map(|factor| factor.solve(&right)) {
            let centre = first * found.x + second * found.y;
            numbers.rows_mut(0, 3).copy_from(&centre);
            numbers[INVERSE] = found.z.max(THIN).recip();
        }
        for (length, way) in self.felt_ends().enumerate() {
            let end = felt.iter().filter(|f| way * along(f) > END);
            let offsets = end.clone().map(|f| way * f.point.dot(&self.axis));
            numbers[LENGTHS + length] = offsets.sum::<f64>() / end.count().max(1) as f64;
        }
        Fit::begun(Round::Turned(*self), numbers)
    }
}

/// Directions, unit, that a body may have been turned about: those in which normals differ least and most,
/// and the normals of `faces`, those with most contacts first.
pub(super) fn axes(contacts: &[Contact], faces: &Faces) -> Vec<Point> {
    let normals = contacts.iter().filter_map(|c| c.normal);
    let middle = centroid(normals.clone());
    let eigen = SymmetricEigen::new(scatter(normals, &middle));
    let spread = [eigen.eigenvalues.imin(), eigen.eigenvalues.imax()];
    let mut sides: Vec<_> = faces.faces.iter().collect();
    sides.sort_by_key(|face| std::cmp::Reverse(face.contacts));
    let spread = spread.map(|which| Point::from(eigen.eigenvectors.column(which)));
    let mut axes: Vec<Point> = vec![];
    for axis in spread.into_iter().chain(sides.iter().map(|face| face.normal)) {
        if axes.len() < AXES && axes.iter().all(|other| other.dot(&axis).abs() < SAME) {
            axes.push(axis);
        }
    }
    axes
}

#[cfg(test)]
pub(super) mod tests;
