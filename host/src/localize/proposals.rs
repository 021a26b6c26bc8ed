//! Poses worth a look, before anything is known but the sizes of things.

use nalgebra::{Quaternion, UnitQuaternion};

use super::likelihood::Evidence;
use crate::shape::Mesh;
use crate::sim::random::Random;
use crate::space::{Point, Pose};

/// Points of the surface that a contact with a normal is laid on.
const PLACES: usize = 512;

/// Contacts may lie this part of the object's radius outside its bounding box.
const SLACK: f64 = 0.1;

/// Draws poses (world to object) at which the contacts can lie on the object.
pub(super) struct Proposals {
    /// Of the object.
    low: Point,
    high: Point,
    /// Points of the surface and outward normals, object frame.
    places: Vec<(Point, Point)>,
    random: Random,
}

impl Proposals {
    pub fn new(mesh: &Mesh, radius: f64, seed: u64) -> Proposals {
        let (low, high) = mesh.bounds();
        let [random] = Random::streams(seed);
        let slack = SLACK * radius;
        Proposals {
            low: low.add_scalar(-slack),
            high: high.add_scalar(slack),
            places: mesh.samples(PLACES),
            random,
        }
    }

    /// One pose. Without normals any rotation, and a shift that puts the contacts' box into the
    /// object's where it fits. With normals every second time one contact is laid on a point of the
    /// surface, normal on normal, and turned about it.
    pub fn draw(&mut self, evidence: &Evidence) -> Pose {
        let on_surface = self.random.unit() < 0.5;
        let chosen = self.pick(evidence.contacts.len()).and_then(|k| evidence.contacts.get(k));
        if on_surface
            && let Some(contact) = chosen
            && let Some(normal) = contact.normal
            && let Some((place, outward)) =
                self.pick(self.places.len()).and_then(|k| self.places.get(k)).copied()
        {
            let spin = UnitQuaternion::from_scaled_axis(
                outward * self.random.around_zero(std::f64::consts::PI),
            );
            // Half a turn about any axis across takes a normal to its opposite.
            let across = || {
                let axis = nalgebra::Unit::new_normalize(normal.cross(&any_across(&normal)));
                UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI)
            };
            let onto = UnitQuaternion::rotation_between(&normal, &outward).unwrap_or_else(across);
            let rotation = spin * onto;
            return Pose::from_parts((place - rotation * contact.point).into(), rotation);
        }
        let rotation = self.rotation();
        let turned = || evidence.contacts.iter().map(|c| rotation * c.point);
        let least = turned().fold(Point::repeat(f64::INFINITY), |a, b| a.inf(&b));
        let greatest = turned().fold(Point::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b));
        let mut shift = Point::zeros();
        for axis in 0..3 {
            let (a, b) = (self.low[axis] - least[axis], self.high[axis] - greatest[axis]);
            // Where the box is too long for the object (a > b) it hangs over on both sides.
            shift[axis] = if a < b { a + (b - a) * self.random.unit() } else { (a + b) / 2.0 };
        }
        Pose::from_parts(shift.into(), rotation)
    }

    fn pick(&mut self, count: usize) -> Option<usize> {
        (count > 0).then(|| ((self.random.unit() * count as f64) as usize).min(count - 1))
    }

    /// Uniform over all rotations.
    fn rotation(&mut self) -> UnitQuaternion<f64> {
        loop {
            let [[a, b], [c, d]] = [self.random.normal_pair(), self.random.normal_pair()];
            let q = Quaternion::new(a, b, c, d);
            if q.norm() > 1e-3 {
                return UnitQuaternion::new_normalize(q);
            }
        }
    }
}

/// Some direction that is not along `v`.
fn any_across(v: &Point) -> Point {
    if v.x.abs() < 0.6 { Point::x() } else { Point::y() }
}
