//! Quadrics and cylinders between flat ends, and superquadrics, by few numbers.

use std::mem::discriminant;

use nalgebra::{Cholesky, DVector, Matrix3, Point3, SVector, SymmetricEigen};

use crate::graph::joint::tangent::Face;
use crate::model::body::{Part, Quadric};
use crate::reference::Contact;
use crate::shape::superquadric::{Form, Number, Superquadric};
use crate::space::{Point, Pose};

/// What no body fits exactly: a deviation added to the points', in radii of the object.
const MISFIT: f64 = 0.003;

/// The same for normals, radians: how far they err beyond what is said of them is found with the body, for
/// a hand that knows points well need not know normals as well.
pub(super) const ROUGH: [f64; 3] = [0.01, 0.02, 0.05];

/// Nats that a contact on an edge costs: few are. About the logarithm of how many deviations of a point
/// the object is wide, less that of the normal's in a right angle.
const EDGE: f64 = 2.0;

/// Squared sine between two parts below which they have no edge.
const SHARP: f64 = 0.05;

/// What a contact differs by, in deviations: its distance, the three of its normal, the distance from
/// the second part of an edge, and what being on an edge costs, which nothing changes.
pub(super) type Residual = SVector<f64, 6>;

/// Standard deviation of the sides' numbers before any contact, in radii and inverse radii of the ball
/// about the contacts.
pub(super) const SHAPE: f64 = 0.7;

/// Semi-axis, in radii of the object, beyond which a side counts as straight.
const LONGEST: f64 = 2.0;

/// (p − c)ᵀ R Rᵀ (p − c) ≤ 1 between flat ends, or a superquadric, which has its own; object frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Round {
    pub centre: Point,
    pub side: Side,
    pub ends: Vec<Face>,
    /// Deviation added to the normals', one of [`ROUGH`].
    pub rough: f64,
}

/// What is between the ends.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Side {
    /// Any quadric: the lower triangle R, 1/m.
    Quadric(Matrix3<f64>),
    /// A round cylinder, its ends square to the axis: unit axis, and radius, metres.
    Cylinder(Point, f64),
    /// Between ellipsoid, box and cylinder.
    Superquadric(Form),
}

/// No logarithm, exponent or turn of a superquadric changes by more in one step.
const STRIDE: f64 = 0.5;

/// The root of a ball of radius 1.
fn usual(dimension: usize) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| if r == c && r < dimension { 1.0 } else { 0.0 })
}

impl Round {
    /// The ball of this centre and radius.
    pub fn ball(dimension: usize, (centre, radius): &(Point, f64)) -> Round {
        let side = Side::Quadric(usual(dimension) / *radius);
        Round { centre: *centre, side, ends: Vec::new(), rough: ROUGH[0] }
    }

    /// The same body in another frame: points p become `frame` p. `None` where numbers are none of a body.
    pub fn transformed(&self, dimension: usize, frame: &Pose) -> Option<Round> {
        let centre = (frame * Point3::from(self.centre)).coords;
        let side = match &self.side {
            Side::Quadric(root) => {
                let turn = frame.rotation.to_rotation_matrix();
                let form = turn * (root * root.transpose()) * turn.inverse();
                // A body may be without end, which a factor need not be.
                let least = 1e-9 * form.trace();
                let hold = Matrix3::from_fn(|r, c| if r == c { least } else { 0.0 });
                let full = Cholesky::new(form + hold)?.l();
                Side::Quadric(Matrix3::from_fn(|r, c| {
                    if r < dimension && c < dimension { full[(r, c)] } else { 0.0 }
                }))
            }
            Side::Cylinder(axis, radius) => Side::Cylinder(frame.rotation * axis, *radius),
            Side::Superquadric(form) => Side::Superquadric(form.transformed(frame)),
        };
        let ends = self.ends.iter().map(|end| {
            let normal = frame.rotation * end.normal;
            Face { normal, offset: end.offset + normal.dot(&frame.translation.vector) }
        });
        Some(Round { centre, side, ends: ends.collect(), rough: self.rough })
    }

    /// How many numbers the sides have, and each end.
    pub fn numbers(&self, dimension: usize) -> (usize, usize) {
        match &self.side {
            Side::Quadric(_) => (dimension * (dimension + 3) / 2, dimension),
            Side::Cylinder(..) => (6, 1),
            Side::Superquadric(form) => (form.numbers().count(), dimension),
        }
    }

    pub fn width(&self, dimension: usize) -> usize {
        let (sides, end) = self.numbers(dimension);
        sides + end * self.ends.len()
    }

    pub fn is_cylinder(&self) -> bool {
        matches!(self.side, Side::Cylinder(..))
    }

    pub fn is_superquadric(&self) -> bool {
        matches!(self.side, Side::Superquadric(_))
    }

    /// Whether both have sides of one kind.
    pub fn is_like(&self, other: &Round) -> bool {
        discriminant(&self.side) == discriminant(&other.side)
    }

    /// Whether the sides go around an object of this radius, unlike a pair of parallel faces.
    pub fn is_round(&self, radius: f64) -> bool {
        let longest = LONGEST * radius;
        let short = match &self.side {
            Side::Quadric(root) => {
                let curved = SymmetricEigen::new(root * root.transpose()).eigenvalues;
                curved.iter().filter(|inverse| **inverse > longest.powi(-2)).count()
            }
            Side::Superquadric(form) => {
                form.half().iter().take(form.axes().len()).filter(|half| **half < longest).count()
            }
            Side::Cylinder(..) => return true,
        };
        short >= 2
    }

    /// How many of the numbers mean something: along its axis a cylinder has no place.
    pub fn freedom(&self, dimension: usize) -> usize {
        self.width(dimension) - usize::from(self.is_cylinder()) + usize::from(self.rough > ROUGH[0])
    }

    /// The body with its numbers changed, in radii: centre, root or axis and radius, then turns and
    /// offset of every end; or those of a superquadric.
    pub fn nudged(&self, dimension: usize, radius: f64, by: &DVector<f64>) -> Round {
        let mut body = self.clone();
        let mut at = 0;
        let mut next = || {
            at += 1;
            by[at - 1]
        };
        if !self.is_superquadric() {
            for axis in 0..dimension {
                body.centre[axis] += radius * next();
            }
        }
        match &mut body.side {
            Side::Quadric(root) => {
                for row in 0..dimension {
                    for column in 0..=row {
                        root[(row, column)] += next() / radius;
                    }
                }
                for end in &mut body.ends {
                    let tangents = end.tangents(dimension);
                    let mut normal = end.normal;
                    for tangent in tangents.iter().take(dimension - 1) {
                        normal += tangent * next();
                    }
                    end.normal = normal.try_normalize(1e-9).unwrap_or(end.normal);
                    end.offset += radius * next();
                }
            }
            Side::Cylinder(axis, r) => {
                let tangents = Face { normal: *axis, offset: 0.0 }.tangents(3);
                let turned = *axis + tangents[0] * next() + tangents[1] * next();
                let turned = turned.try_normalize(1e-9).unwrap_or(*axis);
                *r *= next().clamp(-1.0, 1.0).exp();
                for end in &mut body.ends {
                    let away = end.offset - end.normal.dot(&self.centre);
                    end.normal = turned * end.normal.dot(axis).signum();
                    end.offset = away + radius * next() + end.normal.dot(&body.centre);
                }
                *axis = turned;
            }
            Side::Superquadric(form) => {
                let change = |number: Number| match number {
                    Number::Shift(_) => radius * next(),
                    Number::Half(_) | Number::Exponent(_) | Number::Turn(_) => {
                        next().clamp(-STRIDE, STRIDE)
                    }
                };
                let by: Vec<f64> = form.numbers().map(change).collect();
                *form = form.changed(&by);
                body.centre = form.centre();
            }
        }
        body
    }

    /// What the numbers of the sides differ by from those of the ball, in deviations; zero for the rest.
    pub fn oddity(&self, dimension: usize, ball: &(Point, f64)) -> DVector<f64> {
        let mut all = DVector::zeros(self.width(dimension));
        if let Side::Superquadric(form) = &self.side {
            let away = form.pose().rotation.inverse() * (form.centre() - ball.0);
            for (off, number) in all.iter_mut().zip(form.numbers()) {
                let odd = match number {
                    Number::Half(axis) => (form.half()[axis] / ball.1).ln(),
                    Number::Exponent(which) => form.exponents()[which] - 1.0,
                    Number::Turn(_) => 0.0,
                    Number::Shift(axis) => away[axis] / ball.1,
                };
                *off = odd / SHAPE;
            }
            return all;
        }
        let usual = usual(dimension);
        for axis in 0..dimension {
            all[axis] = (self.centre[axis] - ball.0[axis]) / (ball.1 * SHAPE);
        }
        match &self.side {
            Side::Quadric(root) => {
                let mut at = dimension;
                for row in 0..dimension {
                    for column in 0..=row {
                        all[at] = (root[(row, column)] * ball.1 - usual[(row, column)]) / SHAPE;
                        at += 1;
                    }
                }
            }
            Side::Cylinder(_, r) => all[5] = (r / ball.1).ln() / SHAPE,
            Side::Superquadric(_) => {}
        }
        all
    }

    /// Whether a number is drawn to the ball's.
    pub fn is_drawn(&self, dimension: usize, number: usize) -> bool {
        match &self.side {
            Side::Quadric(_) => number < self.numbers(dimension).0,
            Side::Cylinder(..) => number < 3 || number == 5,
            Side::Superquadric(form) => {
                form.numbers().nth(number).is_some_and(|n| !matches!(n, Number::Turn(_)))
            }
        }
    }

    /// The body of an object of this radius, ready to be asked; `None` where its numbers are none of a
    /// body.
    pub fn field(&self, radius: f64) -> Option<Field<'_>> {
        let quadric = |form| Quadric::new(self.centre, form).map(Part::Quadric);
        let sides = match &self.side {
            Side::Quadric(root) => quadric(root * root.transpose())?,
            Side::Cylinder(axis, r) => {
                quadric((Matrix3::identity() - axis * axis.transpose()) / (r * r))?
            }
            Side::Superquadric(form) => Part::Superquadric(*form),
        };
        Some(Field { sides, ends: &self.ends, misfit: MISFIT * radius, rough: self.rough })
    }

    /// The superquadric that explains these contacts, with normals as rough as here.
    pub fn superquadric(&self, dimension: usize, contacts: &[Contact]) -> Option<Round> {
        let side = Superquadric::fit(dimension, contacts).ok()?.form();
        let (centre, side) = (side.centre(), Side::Superquadric(side));
        Some(Round { centre, side, ends: Vec::new(), rough: self.rough })
    }

    /// The round cylinders that are most like it.
    pub fn cylinders(&self) -> Vec<Round> {
        let Side::Quadric(root) = &self.side else { return Vec::new() };
        let split = SymmetricEigen::new(root * root.transpose());
        let cylinder = |along: usize| {
            let axis: Point = split.eigenvectors.column(along).into_owned();
            let across: f64 = (0..3).filter(|i| *i != along).map(|i| split.eigenvalues[i]).sum();
            let radius = (0.5 * across).sqrt().recip();
            let ends = self.ends.iter().filter(|e| e.normal.dot(&axis).abs() > 0.9).map(|e| {
                let normal = axis * e.normal.dot(&axis).signum();
                let foot = self.centre + e.normal * (e.offset - e.normal.dot(&self.centre));
                Face { normal, offset: normal.dot(&foot) }
            });
            let body = Round {
                centre: self.centre,
                side: Side::Cylinder(axis, radius),
                ends: ends.collect(),
                rough: self.rough,
            };
            (radius.is_finite() && axis.norm() > 0.5).then_some(body)
        };
        (0..3).filter_map(cylinder).collect()
    }
}

/// A body ready to be asked.
pub(super) struct Field<'a> {
    sides: Part,
    ends: &'a [Face],
    /// Metres: what is added to the deviation of points.
    misfit: f64,
    /// Radians: what is added to that of normals.
    rough: f64,
}

impl Field<'_> {
    /// A contact with the deviations that its residual is in, and with those where normals are as exact as
    /// they usually are.
    pub fn widened(&self, contact: &Contact) -> [Contact; 2] {
        [self.rough, ROUGH[0]].map(|rough| Contact {
            point_deviation: contact.point_deviation.hypot(self.misfit),
            normal_deviation: contact.normal_deviation.hypot(rough),
            ..*contact
        })
    }

    /// Distance of a contact (object frame) from the body's surface and the difference of its normal
    /// from that of the part it suits best, which may be the edge between the sides and an end.
    pub fn residual(&self, contact: &Contact) -> Residual {
        let [Contact { point_deviation, normal_deviation, .. }, _] = self.widened(contact);
        let [exact, turned] = [point_deviation.recip(), normal_deviation.recip()];
        let sides = self.sides.at(&contact.point);
        let ends = self.ends.iter().map(|end| (end.value(&contact.point), end.normal));
        let most = ends.clone().map(|end| end.0).fold(sides.0, f64::max);
        let mut residual = Residual::zeros();
        residual[0] = most * exact;
        let Some(normal) = contact.normal else { return residual };
        let (mut least, mut off) = (f64::INFINITY, Point::zeros());
        for (value, slope) in std::iter::once(sides).chain(ends.clone()) {
            let apart = slope - normal;
            let cost = (exact * value).powi(2) + apart.norm_squared() * turned * turned;
            if cost < least {
                (least, off) = (cost, apart);
            }
        }
        residual.fixed_rows_mut::<3>(1).copy_from(&(off * turned));
        for end in ends {
            let Some(between) = between(&sides.1, &end.1, &normal) else { continue };
            let mut other = Residual::zeros();
            (other[0], other[4], other[5]) = (sides.0 * exact, end.0 * exact, (2.0 * EDGE).sqrt());
            other.fixed_rows_mut::<3>(1).copy_from(&((between - normal) * turned));
            if other.norm_squared() < least {
                least = other.norm_squared();
                residual = other;
            }
        }
        residual
    }
}

/// The direction nearest to `normal` that an edge between two parts of these normals can have, where
/// it is neither's own.
fn between(one: &Point, other: &Point, normal: &Point) -> Option<Point> {
    let (cosine, by_one, by_other) = (one.dot(other), one.dot(normal), other.dot(normal));
    let (one_part, other_part) = (by_one - cosine * by_other, by_other - cosine * by_one);
    if one_part <= 0.0 || other_part <= 0.0 || 1.0 - cosine * cosine < SHARP {
        return None;
    }
    (one * one_part + other * other_part).try_normalize(1e-9)
}
