//! Blocks: sides square to each other, each with its counterpart across.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{DVector, Rotation2, Rotation3};

use super::end::{Side, USUAL};
use super::fit::{Felt, Fit, MISFIT, Problem, Round, STEPS, TRIAL};
use super::{Body, Part, Plane};
use crate::model::Faces;
use crate::reference::Contact;
use crate::space::{self, Point};

/// Numbers measured per parameter from which a block is more than a guess: it has few, and all of them are usual.
const DECIDED: f64 = 1.5;

/// Cosine of the angle between faces up to which both may be sides of one block, and from which a frame's
/// axis is that of another.
const OBLIQUE: f64 = 0.5;
const SAME: f64 = 0.97;

/// Frames that are tried at most.
const FRAMES: usize = 12;

/// Directions that the smallest rectangle about the contacts of a plate is looked for in.
const WAYS: u32 = 180;

/// A side of a block.
#[derive(Clone, Copy, PartialEq)]
struct Place {
    axis: usize,
    way: f64,
}

/// Which block is sought. Its numbers, in radii of the ball about the contacts: by how much it is turned, radians,
/// and how far out each side is that was felt.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Block {
    dimension: usize,
    /// Unit and square to each other: its axes where it was begun; two in the plane.
    axes: [Point; 3],
    /// Whether a contact is on the side where each leaves, and across.
    is_felt: [[bool; 2]; 3],
}

impl Body {
    /// The block that fits best, a rectangle in the plane, with ends beyond the contacts where no side was felt.
    /// Of a plate felt on both broad sides alone the ends lie along the smallest rectangle about the contacts. `None`
    /// without contacts, where no two of the `faces` are square to one another and none is opposite to that with most
    /// contacts, or when fewer than one and a half numbers were measured per parameter.
    pub fn block(dimension: usize, contacts: &[Contact], faces: &Faces) -> Option<Body> {
        let problem = Problem::of(dimension, contacts)?;
        let fits = frames(dimension, faces, problem.felt()).into_iter().map(|axes| {
            let block = Block::of(dimension, axes, problem.felt());
            (block, problem.climb(block.begun(problem.felt()), TRIAL))
        });
        let (block, best) = fits.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))?;
        let fit = problem.climb(best, STEPS);
        let body = problem.body(&fit)?;
        let measured = problem.measured() as f64;
        if measured < DECIDED * (measured - body.degrees) {
            return None;
        }
        Some(block.ended(body, fit.parameters(), &problem))
    }
}

impl Block {
    fn of(dimension: usize, axes: [Point; 3], felt: &[Felt]) -> Block {
        let bare = Block { dimension, axes, is_felt: [[false; 2]; 3] };
        let mut is_felt = bare.is_felt;
        for place in felt.iter().filter_map(|felt| bare.nearest(felt)) {
            is_felt[place.axis][usize::from(place.way < 0.0)] = true;
        }
        Block { is_felt, ..bare }
    }

    /// The side whose normal is most like the contact's.
    fn nearest(&self, felt: &Felt) -> Option<Place> {
        let normal = felt.normal?;
        let along = |axis: &usize| self.axes[*axis].dot(&normal);
        let axis = (0..self.dimension).max_by(|a, b| along(a).abs().total_cmp(&along(b).abs()))?;
        Some(Place { axis, way: along(&axis).signum() })
    }

    fn places(&self) -> impl Iterator<Item = (Place, bool)> {
        let ways = [1.0, -1.0];
        (0..self.dimension).flat_map(move |axis| {
            ways.into_iter()
                .zip(self.is_felt[axis])
                .map(move |(way, is_felt)| (Place { axis, way }, is_felt))
        })
    }

    fn sides(&self) -> impl Iterator<Item = Place> {
        self.places().filter_map(|(place, is_felt)| is_felt.then_some(place))
    }

    /// How many numbers say how it is turned.
    fn turns(&self) -> usize {
        if self.dimension == 2 { 1 } else { 3 }
    }

    pub(super) fn count(&self) -> usize {
        self.turns() + self.sides().count()
    }

    /// What most have: those of a block as wide every way as the ball.
    pub(super) fn usual(&self) -> DVector<f64> {
        let turns = self.turns();
        DVector::from_fn(self.count(), |i, _| if i < turns { 0.0 } else { USUAL.0 })
    }

    fn normal(&self, numbers: &DVector<f64>, place: Place) -> Point {
        let out = self.axes[place.axis] * place.way;
        if self.dimension == 2 {
            let turned = Rotation2::new(numbers[0]) * out.xy();
            return Point::new(turned.x, turned.y, 0.0);
        }
        Rotation3::new(Point::new(numbers[0], numbers[1], numbers[2])) * out
    }

    pub(super) fn parts(&self, numbers: &DVector<f64>) -> Vec<Part> {
        let side = |(place, offset): (Place, &f64)| {
            Part::Plane(Plane { normal: self.normal(numbers, place), offset: *offset })
        };
        self.sides().zip(numbers.iter().skip(self.turns())).map(side).collect()
    }

    /// Where contacts place it if these are its axes.
    fn begun(&self, felt: &[Felt]) -> Fit {
        let mut numbers = self.usual();
        for (i, place) in self.sides().enumerate() {
            let out = self.axes[place.axis] * place.way;
            let on = felt.iter().filter(|felt| self.nearest(felt) == Some(place));
            let sum: f64 = on.clone().map(|felt| out.dot(&felt.point)).sum();
            numbers[self.turns() + i] = sum / on.count().max(1) as f64;
        }
        Fit::begun(Round::Block(*self), numbers)
    }

    /// The body cut where no side was felt.
    fn ended(&self, mut body: Body, numbers: &DVector<f64>, problem: &Problem) -> Body {
        let offsets: Vec<(Place, f64)> =
            self.sides().zip(numbers.iter().skip(self.turns()).copied()).collect();
        let outermost = |place: Place| {
            let out = self.normal(numbers, place);
            let along = problem.felt().iter().map(|felt| out.dot(&felt.point));
            along.fold(f64::NEG_INFINITY, f64::max)
        };
        let known = |place: Place| {
            let felt = offsets.iter().find(|(other, _)| *other == place);
            felt.map_or_else(|| outermost(place), |(_, offset)| *offset)
        };
        // No thinner than any body fits: contacts all at one height would leave it no surface.
        let width = |axis: usize| {
            let [one, other] = [1.0, -1.0].map(|way| known(Place { axis, way }));
            (one + other).max(MISFIT.0)
        };
        for (place, _) in self.places().filter(|(_, is_felt)| !is_felt) {
            let across: Vec<f64> =
                (0..self.dimension).filter(|axis| *axis != place.axis).map(width).collect();
            // Of a round body whose ends are as large a part of its surface.
            let radius = across.iter().map(|width| width.recip()).sum::<f64>().recip();
            let high = outermost(place);
            let low = high.min(-known(Place { way: -place.way, ..place }));
            let side = Side { radius, widening: 0.0, low, high, pointed: 1.0 };
            let Some((end, deviation)) = side.end(problem.places(), 0.0) else { continue };
            if let Some(plane) = problem.placed_plane(self.normal(numbers, place), end) {
                body.end(plane, deviation * problem.radius());
            }
        }
        body
    }
}

/// The direction, unit and square to `normal`, of a side of the smallest rectangle about the contacts as they are seen
/// along it (to half a degree): where they fell anywhere on a rectangle alike, the most probable one. `None` where
/// numbers are none.
fn outline(normal: &Point, felt: &[Felt]) -> Option<Point> {
    let [first, second] = space::across(3, normal);
    let width = |way: &Point| {
        let along = felt.iter().map(|felt| way.dot(&felt.point));
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let ways = (0..WAYS).map(|i| {
        let (sin, cos) = (FRAC_PI_2 * f64::from(i) / f64::from(WAYS)).sin_cos();
        let way = first * cos + second * sin;
        (width(&way) * width(&normal.cross(&way)), way)
    });
    let known = ways.filter(|(area, _)| area.is_finite());
    known.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, way)| way)
}

/// Axes that a block may have: the normal of a face and, in space, that of one across it; those of faces with most
/// contacts first. Where there is none across, but one opposite, those of a plate.
fn frames(dimension: usize, faces: &Faces, felt: &[Felt]) -> Vec<[Point; 3]> {
    let mut sides: Vec<_> = faces.faces.iter().collect();
    sides.sort_by_key(|face| std::cmp::Reverse(face.contacts));
    let mut frames: Vec<[Point; 3]> = vec![];
    let is_axis =
        |axes: &[Point; 3], normal: &Point| axes.iter().any(|a| a.dot(normal).abs() > SAME);
    for (i, first) in sides.iter().map(|face| face.normal).enumerate() {
        let seconds: Vec<Point> = if dimension == 2 {
            vec![Point::new(-first.y, first.x, 0.0)]
        } else {
            let across = |n: &Point| n.dot(&first).abs() < OBLIQUE;
            let others = sides.iter().skip(i + 1).map(|face| face.normal).filter(across);
            others.map(|n| (n - first * first.dot(&n)).normalize()).collect()
        };
        for second in seconds {
            let known = frames.iter().any(|axes| is_axis(axes, &first) && is_axis(axes, &second));
            if frames.len() < FRAMES && !known {
                frames.push([first, second, first.cross(&second)]);
            }
        }
    }
    let is_plate = |first: &Point| sides.iter().any(|face| face.normal.dot(first) < -SAME);
    if frames.is_empty()
        && let Some(first) = sides.first().map(|face| face.normal).filter(is_plate)
        && let Some(second) = outline(&first, felt)
    {
        frames.push([first, second, first.cross(&second)]);
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::body::tests::touch;
    use crate::reference::Mean;
    use proptest::prelude::*;

    const HALF: [f64; 3] = [0.06, 0.04, 0.025];

    /// Touches of a block about the origin, on each side where `on` has it so many.
    fn touched(dimension: usize, on: [[usize; 2]; 3]) -> Vec<Contact> {
        let mut contacts = Vec::new();
        for axis in 0..dimension {
            for (way, count) in [1.0, -1.0].into_iter().zip(on[axis]) {
                for _ in 0..count {
                    let spread = |other: usize| (2.4 * (contacts.len() + 3 * other) as f64).sin();
                    let inside =
                        |i: usize| if i < dimension { 0.9 * HALF[i] * spread(i) } else { 0.0 };
                    let mut point = Point::from_fn(|i, _| inside(i));
                    point[axis] = way * HALF[axis];
                    contacts.push(touch(point, Point::ith(axis, way)));
                }
            }
        }
        contacts
    }

    fn block(dimension: usize, contacts: &[Contact]) -> Option<Body> {
        Body::block(dimension, contacts, &Faces::fit(dimension, contacts)?)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// Wherever it is, whatever its size and however it is turned.
        #[test]
        fn one_touch_of_each_side_finds_it_anywhere(
            turn in prop::array::uniform3(-2f64..2.0),
            away in prop::array::uniform3(-1f64..1.0),
            size in 0.1f64..10.0,
        ) {
            let turn = Rotation3::new(Point::from(turn));
            let place = |p: Point| turn * p * size + Point::from(away);
            let place_touch = |c: &Contact| Contact {
                point: place(c.point),
                normal: c.normal.map(|n| turn * n),
                point_deviation: c.point_deviation * size,
                ..*c
            };
            let contacts: Vec<Contact> = touched(3, [[1; 2]; 3]).iter().map(place_touch).collect();
            let body = block(3, &contacts).unwrap();
            prop_assert_eq!(body.parts().len(), 6);
            prop_assert!(body.misfit() < 0.4, "{}", body.misfit());
            for corner in 0..8 {
                let way = |axis: usize| if corner >> axis & 1 == 0 { 1.0 } else { -1.0 };
                let corner = place(Point::from_fn(|axis, _| way(axis) * HALF[axis]));
                prop_assert!(body.value(&corner).abs() < 2e-3 * size, "{}", body.value(&corner));
            }
        }
    }

    #[test]
    fn sides_that_nobody_felt_lie_beyond_the_contacts_and_are_in_doubt() {
        for (dimension, on) in [(2, [[0, 2], [2, 2], [0, 0]]), (3, [[0, 2], [3, 3], [2, 0]])] {
            let contacts = touched(dimension, on);
            let body = block(dimension, &contacts).unwrap();
            assert_eq!(body.parts().len(), 2 * dimension);
            let last = contacts.iter().map(|c| c.point.x).fold(f64::NEG_INFINITY, f64::max);
            assert!(body.value(&(Point::x() * (last + 1e-3))) < 0.0);
            assert!(body.value(&(Point::x() * (last + 0.06))) > 0.0);
            let doubt = |p: Point| body.modes(&p).iter().map(|m| m.0 * m.0).sum::<f64>().sqrt();
            let (open, felt) = (doubt(Point::x() * 0.06), doubt(Point::x() * -0.06));
            assert!(open > 2e-3 && open < felt, "{open} {felt}");
            // The more contacts might have found more of it, the less there is.
            let many = on.map(|ways| ways.map(|count| 6 * count));
            let body = block(dimension, &touched(dimension, many)).unwrap();
            assert!(body.value(&(Point::x() * (HALF[0] + 0.008))) > 0.0);
        }
    }

    #[test]
    fn contacts_at_one_height_leave_a_block_its_thickness() {
        let doubt =
            |body: &Body, p: Point| body.modes(&p).iter().map(|m| m.0 * m.0).sum::<f64>().sqrt();
        let side = block(2, &touched(2, [[3, 0], [0; 2], [0; 2]])).unwrap();
        assert_eq!(side.parts().len(), 4);
        let within = |deep: f64| Point::x() * (HALF[0] - deep);
        assert!(side.value(&within(5e-3)) < 0.0 && side.value(&within(0.08)) > 0.0);
        assert!(doubt(&side, within(0.03)) > 5e-3);
        let level = touched(3, [[3, 0], [3, 0], [0; 2]]);
        let flat = |c: &Contact| Contact { point: Point::new(c.point.x, c.point.y, 0.0), ..*c };
        let level = block(3, &level.iter().map(flat).collect::<Vec<_>>()).unwrap();
        assert_eq!(level.parts().len(), 6);
        for up in [Point::z(), -Point::z()] {
            assert!(level.value(&(up * 5e-3)) < 0.0 && level.value(&(up * 0.05)) > 0.0);
            assert!(doubt(&level, up * 0.02) > 5e-3);
        }
    }

    #[test]
    fn a_plate_felt_on_both_broad_sides_ends_about_its_contacts() {
        // Out to the sides of a rectangle, which is turned.
        let turn = Rotation3::from_axis_angle(&Point::z_axis(), 0.5);
        let places = [[-1.0, -0.4], [1.0, 0.3], [-0.5, 1.0], [0.2, -1.0], [0.8, 0.8], [0.1, 0.2]];
        let contacts = places.iter().flat_map(|[x, y]| {
            [1.0, -1.0].map(|way| {
                let point = Point::new(0.1 * x * way, 0.06 * y, 0.004 * way);
                touch(turn * point, Point::z() * way)
            })
        });
        let contacts: Vec<Contact> = contacts.collect();
        let body = block(3, &contacts).unwrap();
        assert_eq!(body.parts().len(), 6);
        assert!(body.misfit() < 0.4, "{}", body.misfit());
        for (out, half) in [(Point::x(), 0.1), (Point::y(), 0.06)] {
            for way in [turn * out, -(turn * out)] {
                assert!(body.value(&(way * half)) < 0.0);
                assert!(body.value(&(way * (1.5 * half))) > 0.0);
                assert!(body.planes().any(|plane| plane.normal.dot(&way) > 0.999));
            }
        }
        // One broad side says nothing of how thick it is.
        let above: Vec<Contact> = contacts.into_iter().filter(|c| c.point.z > 0.0).collect();
        assert_eq!(block(3, &above), None);
    }

    #[test]
    fn turned_it_stays_square() {
        let body = block(3, &touched(3, [[1; 2]; 3])).unwrap();
        let mut by = vec![0.0; body.modes(&Point::zeros()).len()];
        by[..3].copy_from_slice(&[0.1, -0.2, 0.15]);
        let moved = body.moved(&by, &Point::zeros()).unwrap();
        let normals: Vec<Point> = moved.planes().map(|plane| plane.normal).collect();
        assert!(normals[0].dot(&Point::x()).abs() < 0.999);
        for pair in normals.chunks(2) {
            assert!(pair[0].dot(&pair[1]) < -0.999_99);
            let others = normals.iter().filter(|n| n.dot(&pair[0]).abs() < 0.9);
            assert!(
                others.clone().count() == 4
                    && others.fold(0.0, |m: f64, n| m.max(n.dot(&pair[0]).abs())) < 0.02
            );
        }
    }

    #[test]
    fn what_is_no_block_fits_none() {
        let hexagon = |i: i32| {
            let (sin, cos) = (std::f64::consts::FRAC_PI_3 * f64::from(i)).sin_cos();
            let out = Point::new(cos, sin, 0.0);
            touch(out * 0.04 + Point::new(-sin, cos, 0.0) * 0.01 * f64::from(i % 2), out)
        };
        let hexagon: Vec<Contact> = (0..12).map(hexagon).collect();
        assert!(block(2, &hexagon).unwrap().misfit() > 10.0);
        // All of one side, and without any normal.
        let side = touched(3, [[4, 0], [0; 2], [0; 2]]);
        assert_eq!(block(3, &side), None);
        let bare: Vec<Contact> = side.iter().map(|c| Contact { normal: None, ..*c }).collect();
        assert_eq!(block(3, &bare), None);
        assert_eq!(Body::block(3, &[], &Faces::fit(3, &side).unwrap()), None);
        // Three touches of two sides measure nine numbers for five.
        let three = touched(3, [[2, 0], [1, 0], [0; 2]]);
        assert!(block(3, &three).is_some());
        assert_eq!(block(3, &three[..2]), None);
        let same = vec![three[0]; 12];
        assert!(block(2, &same).is_none_or(|body| body.value(&Point::x()).is_finite()));
    }
}
