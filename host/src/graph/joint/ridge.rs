//! Contacts where faces meet, on edges and corners: on all of them at once, with any normal between
//! theirs.
//!
//! A finger is round. Where its centre can be is a surface at its radius r about the object, and of that
//! surface each face has its area, each edge r times its length and the angle by which normals turn
//! there, each corner r² times their solid angle (Steiner's formula). So per length and radian a contact
//! on an edge is r times as dense as one on a face is per area. That surface is larger than the object's,
//! so a log without contacts on edges is likelier where fingers are points: whether they are
//! ([`Problem::edges`]) is found by evidence.

use nalgebra::{Matrix3, Matrix3x6, Matrix6, Matrix6x3, Vector6};

use super::problem::Problem;
use super::tangent::Face;
use crate::model::faces::Owner;
use crate::reference::Contact;
use crate::space::{Point, Pose};

/// Radius of a fingertip, metres.
pub(super) const FINGERTIP: f64 = 8e-3;

/// Determinant of the normals' inner products below which faces do not meet: sin² 13° at an edge.
const SHARP: f64 = 0.05;

/// Deviations from a face within which a contact may lie on its edges.
const NEAR: f64 = 4.0;

/// Where two or three faces meet.
#[derive(Clone, Copy, Debug)]
pub struct Ridge {
    /// The third may be blank.
    faces: [Face; 3],
    span: Span,
}

/// A contact on a ridge, with derivatives: three rows for the way from the ridge to the point, three for
/// how its normal differs from those between the faces'. They are zero for a contact without a normal.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// In standard deviations.
    pub residual: Vector6<f64>,
    /// By the pose's tangent.
    pub by_pose: Matrix6<f64>,
    /// By turns and offset of each of the faces.
    pub by_face: [Matrix6x3<f64>; 3],
}

/// What up to three normals span.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// In columns; zero where there is none.
    normals: Matrix3<f64>,
    /// Inverse of their inner products.
    inverse: Matrix3<f64>,
    /// How many there are.
    count: usize,
}

impl Span {
    fn new(normals: Matrix3<f64>) -> Option<Span> {
        let mut inner = normals.tr_mul(&normals);
        let mut count = 3;
        for i in 0..3 {
            if inner[(i, i)] == 0.0 {
                inner[(i, i)] = 1.0;
                count -= 1;
            }
        }
        let inverse = (inner.determinant() > SHARP).then(|| inner.try_inverse()).flatten()?;
        Some(Span { normals, inverse, count })
    }

    /// By how much of each normal a direction is made, as far as it is.
    fn shares(&self, direction: &Point) -> Point {
        self.inverse * self.normals.tr_mul(direction)
    }

    /// How a direction differs from those between the normals is `across` (d − Σ shares · normals); of
    /// one normal it is all of d − n, which is largest for the opposite one.
    fn difference(&self, direction: &Point) -> (Matrix3<f64>, Point) {
        if self.count == 1 {
            return (Matrix3::identity(), Point::repeat(1.0));
        }
        let across = Matrix3::identity() - self.normals * self.inverse * self.normals.transpose();
        (across, self.shares(direction))
    }

    /// The part nearest to a direction: of the cone between the normals a side, of that an end.
    fn nearest(mut self, direction: &Point) -> Span {
        while self.count > 1 {
            let shares = self.shares(direction);
            let odd = shares.imin();
            if shares[odd] >= 0.0 {
                break;
            }
            let mut fewer = self.normals;
            fewer.column_mut(odd).fill(0.0);
            let Some(next) = Span::new(fewer) else { break };
            self = next;
        }
        self
    }
}

impl Ridge {
    /// Where these faces meet; `None` for fewer than two or more than three of them, and for faces that
    /// are nearly parallel.
    pub fn new(faces: &[Face]) -> Option<Ridge> {
        if !(2..=3).contains(&faces.len()) {
            return None;
        }
        let blank = Face { normal: Point::zeros(), offset: 0.0 };
        let faces: [Face; 3] = std::array::from_fn(|i| faces.get(i).copied().unwrap_or(blank));
        let span = Span::new(Matrix3::from_columns(&faces.map(|f| f.normal)))?;
        Some(Ridge { faces, span })
    }

    /// Heights of a point over the faces, as shares of their normals: together the way from the ridge.
    fn way(&self, point: &Point) -> Point {
        self.span.inverse * Point::from_fn(|i, _| self.faces[i].value(point))
    }

    /// How a normal differs from those between the faces'.
    fn turned(&self, normal: &Point) -> Point {
        let part = self.span.nearest(normal);
        let (across, shares) = part.difference(normal);
        across * (normal - part.normals * shares)
    }

    /// −ln of the density of a contact with a normal that fits exactly, to be compared with
    /// [`Problem::exact`].
    pub fn exact(&self, dimension: usize, contact: &Contact) -> f64 {
        let root = std::f64::consts::TAU.sqrt();
        let count = self.span.count as f64;
        count * (root * contact.point_deviation).ln()
            + (dimension as f64 - count) * (root * contact.normal_deviation).ln()
            - (count - 1.0) * FINGERTIP.ln()
    }

    /// What a contact (object frame) costs here, robustly, where all deviations are larger by `slack`.
    pub fn cost(&self, problem: &Problem, contact: &Contact, slack: f64) -> f64 {
        let square = |x: f64| x * x;
        let off = (self.span.normals * self.way(&contact.point)).norm_squared()
            / square(slack * contact.point_deviation);
        let turned = contact.normal.map_or(0.0, |normal| {
            self.turned(&normal).norm_squared() / square(slack * contact.normal_deviation)
        });
        problem.kernel.cost(off).0
            + problem.kernel.cost(turned).0
            + self.exact(problem.dimension, contact)
    }

    /// A contact given in the world frame.
    pub fn touch(&self, pose: &Pose, dimension: usize, contact: &Contact) -> Touch {
        let felt = contact.transformed(&pose.inverse());
        let mut touch = Touch {
            residual: Vector6::zeros(),
            by_pose: Matrix6::zeros(),
            by_face: [Matrix6x3::zeros(); 3],
        };
        let exact = 1.0 / contact.point_deviation;
        let shares = self.way(&felt.point);
        let outward = self.span.normals * self.span.inverse;
        touch.residual.fixed_rows_mut::<3>(0).copy_from(&(self.span.normals * shares * exact));
        let mut by_pose = Matrix3x6::zeros();
        for (i, face) in self.faces.iter().enumerate().take(self.span.count) {
            let by = outward.column(i) * exact;
            by_pose.fixed_columns_mut::<3>(0).ger(-1.0, &by, &face.normal, 1.0);
            by_pose.fixed_columns_mut::<3>(3).ger(1.0, &by, &face.normal.cross(&felt.point), 1.0);
            for (k, t) in face.tangents(dimension).iter().enumerate() {
                let column = by * t.dot(&felt.point) - t * (shares[i] * exact);
                touch.by_face[i].fixed_view_mut::<3, 1>(0, k).copy_from(&column);
            }
            touch.by_face[i].fixed_view_mut::<3, 1>(0, 2).copy_from(&-by);
        }
        touch.by_pose.fixed_rows_mut::<3>(0).copy_from(&by_pose);
        if let Some(normal) = felt.normal {
            self.turn(&mut touch, dimension, &normal, 1.0 / contact.normal_deviation);
        }
        touch
    }

    /// Adds the rows of the normal (object frame), which is so exact.
    fn turn(&self, touch: &mut Touch, dimension: usize, normal: &Point, exact: f64) {
        let part = self.span.nearest(normal);
        let (across, shares) = part.difference(normal);
        let off = across * (normal - part.normals * shares);
        touch.residual.fixed_rows_mut::<3>(3).copy_from(&(off * exact));
        let by_turn = across * normal.cross_matrix() * exact;
        touch.by_pose.fixed_view_mut::<3, 3>(3, 3).copy_from(&by_turn);
        for (i, face) in self.faces.iter().enumerate() {
            if part.normals.column(i).norm_squared() == 0.0 {
                continue;
            }
            for (k, t) in face.tangents(dimension).iter().enumerate() {
                let column = across * t * (-shares[i] * exact);
                touch.by_face[i].fixed_view_mut::<3, 1>(3, k).copy_from(&column);
            }
        }
    }
}

/// The faces that an owner names.
pub fn named(owner: &Owner, faces: &[Face]) -> Vec<Face> {
    owner.faces().iter().map(|i| faces[*i]).collect()
}

/// The edges and corners on which a contact (object frame) may lie, where a face's deviation at the
/// contact is as `deviation` has it; none without a normal, and where fingers feel none.
pub fn near(
    problem: &Problem,
    faces: &[(usize, Face)],
    contact: &Contact,
    deviation: impl Fn(usize) -> f64,
) -> Vec<(Owner, Ridge)> {
    if contact.normal.is_none() || !problem.edges {
        return Vec::new();
    }
    let close = |(i, f): &&(usize, Face)| f.value(&contact.point).abs() < NEAR * deviation(*i);
    let close: Vec<(usize, Face)> = faces.iter().filter(close).copied().collect();
    let mut found = Vec::new();
    for (a, (i, first)) in close.iter().enumerate() {
        for (b, (j, second)) in close.iter().enumerate().skip(a + 1) {
            found.extend(Ridge::new(&[*first, *second]).map(|r| (Owner::Edge([*i, *j]), r)));
            for (k, third) in &close[b + 1..] {
                let corner = Ridge::new(&[*first, *second, *third]);
                found.extend(corner.map(|r| (Owner::Corner([*i, *j, *k]), r)));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests;
