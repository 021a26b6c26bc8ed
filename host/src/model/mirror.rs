//! Planes that an object is its own mirror image in.

use nalgebra::Matrix3;

use crate::reference::Contact;
use crate::space::{Point, Pose};

/// The plane n·p = d, in two dimensions the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    /// n, unit.
    pub normal: Point,
    /// d, metres.
    pub offset: f64,
}

impl Mirror {
    /// The same plane of an object that was moved by `pose`.
    pub fn transformed(&self, pose: &Pose) -> Mirror {
        let normal = pose.rotation * self.normal;
        Mirror { normal, offset: self.offset + normal.dot(&pose.translation.vector) }
    }

    /// What it does to points.
    pub fn image(&self) -> Image {
        let turn = Matrix3::identity() - self.normal * self.normal.transpose() * 2.0;
        Image { turn, shift: self.normal * (2.0 * self.offset) }
    }
}

/// A reflection, or several one after the other: p ↦ turn·p + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image {
    turn: Matrix3<f64>,
    shift: Point,
}

impl Image {
    /// Of a point, metres.
    pub fn point(&self, p: &Point) -> Point {
        self.turn * p + self.shift
    }

    /// Of a direction.
    pub fn direction(&self, v: &Point) -> Point {
        self.turn * v
    }

    /// The direction that this is the image of.
    pub fn back(&self, v: &Point) -> Point {
        self.turn.tr_mul(v)
    }

    /// Of a contact, as uncertain.
    pub fn contact(&self, contact: &Contact) -> Contact {
        let normal = contact.normal.map(|n| self.direction(&n));
        Contact { point: self.point(&contact.point), normal, ..*contact }
    }

    /// The same in one more mirror.
    fn and(&self, mirror: &Mirror) -> Image {
        let last = mirror.image();
        Image { turn: last.turn * self.turn, shift: last.point(&self.shift) }
    }
}

/// Every image in some of the mirrors, which are square to each other; first that in none of them, where all is
/// where it is. Each is its own reverse.
pub fn images(mirrors: &[Mirror]) -> Vec<Image> {
    let mut all = vec![Image { turn: Matrix3::identity(), shift: Point::zeros() }];
    for mirror in mirrors {
        let more: Vec<Image> = all.iter().map(|image| image.and(mirror)).collect();
        all.extend(more);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_image_is_its_own_reverse_and_keeps_distances(
            turn in prop::array::uniform3(-3.0..3.0), offsets in prop::array::uniform3(-0.1..0.1),
            p in prop::array::uniform3(-0.2..0.2), q in prop::array::uniform3(-0.2..0.2),
        ) {
            let turn = nalgebra::Rotation3::new(Point::from(turn));
            let mirror = |i: usize| Mirror { normal: turn * Point::ith(i, 1.0), offset: offsets[i] };
            let images = images(&[mirror(0), mirror(1), mirror(2)]);
            prop_assert_eq!(images.len(), 8);
            let (p, q) = (Point::from(p), Point::from(q));
            prop_assert_eq!(images[0].point(&p), p);
            for image in &images {
                let (seen, other) = (image.point(&p), image.point(&q));
                prop_assert!((image.point(&seen) - p).norm() < 1e-12);
                prop_assert!(((seen - other).norm() - (p - q).norm()).abs() < 1e-12);
                prop_assert!((image.direction(&(p - q)) - (seen - other)).norm() < 1e-12);
                prop_assert!((image.back(&(seen - other)) - (p - q)).norm() < 1e-12);
            }
            let moved = mirror(0).transformed(&Pose::new(q, Point::new(0.3, 0.2, -0.1)));
            let carried = Pose::new(q, Point::new(0.3, 0.2, -0.1));
            let carry = |p: &Point| carried.rotation * p + carried.translation.vector;
            prop_assert!((moved.image().point(&carry(&p)) - carry(&images[1].point(&p))).norm() < 1e-12);
            // The first mirror alone: what lies on it stays, what lies beside it changes sides.
            let beside = |p: &Point| mirror(0).normal.dot(p) - mirror(0).offset;
            prop_assert!((beside(&images[1].point(&p)) + beside(&p)).abs() < 1e-12);
        }
    }
}
