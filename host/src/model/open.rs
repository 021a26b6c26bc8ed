//! Where nothing that was felt says how far an object reaches.
//!
//! A contact says that no part of a convex object lies beyond it. Where none does, as at the ends of a bottle
//! that a hand closed about, where the object ends is a guess, however many contacts there are elsewhere:
//! contacts would show it only if they fell anywhere alike, and those of a hand do not.

use crate::reference::Contact;
use crate::space::Point;
use crate::thin::evenly;

/// Cosine of the angle between a normal and a direction up to which a contact bounds an object that way.
const FACING: f64 = 0.5;

/// How far beyond a place a contact may leave the object room and still bound it there, how far beyond the contact that
/// place may be (the inner side of one arm does not bound another), and how uncertain the object's end is where none
/// bounds it: shares of the contacts' extent that way, or of this share of their extent in all.
const BOUNDED: f64 = 0.2;
const BEYOND: f64 = 0.1;
const OPEN: f64 = 0.3;
const THIN: f64 = 0.3;

/// Contacts that are looked at for each place at most.
const MOST: usize = 500;

/// What bounds an object.
#[derive(Clone, Debug)]
pub struct Open {
    points: Vec<Point>,
    /// From corner to corner of the box about them.
    size: f64,
    /// Those that have normals: point and normal.
    bounds: Vec<(Point, Point)>,
}

impl Open {
    /// By these contacts.
    pub fn of(contacts: &[Contact]) -> Open {
        let few = evenly(contacts, MOST);
        let usable = || few.iter().filter_map(Contact::checked);
        let points: Vec<Point> = usable().map(|c| c.point).collect();
        let first = points.first().copied().unwrap_or_default();
        let wider = |(low, high): (Point, Point), p: &Point| (low.inf(p), high.sup(p));
        let (low, high) = points.iter().fold((first, first), wider);
        Open {
            points,
            size: (high - low).norm(),
            bounds: usable().filter_map(|c| Some((c.point, c.normal?))).collect(),
        }
    }

    /// Standard deviation of the surface at a `point` of it that looks along the unit `normal`, as far as it is
    /// open how far the object reaches that way, metres: zero where a contact bounds it, and where no contact
    /// has a normal, for none then says which way it looks.
    pub fn deviation(&self, point: &Point, normal: &Point) -> f64 {
        if self.bounds.is_empty() {
            return 0.0;
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for touched in &self.points {
            let along = normal.dot(touched);
            (low, high) = (low.min(along), high.max(along));
        }
        let extent = (high - low).max(THIN * self.size);
        let is_bound = |(touched, felt): &(Point, Point)| {
            let facing = felt.dot(normal);
            let room = felt.dot(&(touched - point));
            facing > FACING && (-BEYOND * extent..BOUNDED * extent * facing).contains(&room)
        };
        if self.bounds.iter().any(is_bound) { 0.0 } else { OPEN * extent }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Touches around the middle of a can of 60 mm that is longer than `high` on either side.
    fn can(high: f64, normals: bool) -> Vec<Contact> {
        let touch = |i: i32| {
            let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
            let normal = Point::new(cos, sin, 0.0);
            Contact {
                point: 0.03 * normal + Point::z() * high * f64::from(i - 10) / 10.0,
                normal: normals.then_some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.09,
            }
        };
        (0..=20).map(touch).collect()
    }

    #[test]
    fn ends_that_nobody_touched_are_open_and_sides_are_not() {
        let mut contacts = can(0.075, true);
        let deviation =
            |contacts: &[Contact], point, normal| Open::of(contacts).deviation(&point, &normal);
        // Touched on one side only, it may be as thick as anything.
        let one_sided: Vec<Contact> = (0..9)
            .map(|i| Contact {
                point: Point::new(0.01 * f64::from(i % 3), 0.01 * f64::from(i / 3), 0.0),
                normal: Some(Point::z()),
                ..contacts[0]
            })
            .collect();
        assert!(deviation(&one_sided, Point::new(0.01, 0.01, -1e-3), -Point::z()) > 2e-3);
        let end = (Point::new(0.0, 0.0, 0.08), Point::z());
        assert!((deviation(&contacts, end.0, end.1) - 0.3 * 0.15).abs() < 1e-9);
        assert_eq!(deviation(&contacts, Point::new(0.03, 0.0, 0.02), Point::x()), 0.0);
        // A touch on the end bounds that end, and not the other.
        let cap = Contact {
            point: Point::new(0.01, 0.0, 0.079),
            normal: Some(Point::z()),
            ..contacts[0]
        };
        contacts.push(cap);
        assert_eq!(deviation(&contacts, end.0, end.1), 0.0);
        assert!(deviation(&contacts, -end.0, -end.1) > 0.04);
        // One that bounds it far away hardly does.
        assert!(deviation(&contacts, Point::new(0.0, 0.0, -0.08), Point::z()) > 0.04);
    }

    /// An L of two arms 100 mm long and 10 mm thick, of which one end was touched.
    #[test]
    fn the_inner_side_of_one_arm_does_not_bound_the_other() {
        let touch = |x: f64, y: f64, normal: Point| Contact {
            point: Point::new(x, y, 0.0),
            normal: Some(normal),
            point_deviation: 1e-3,
            normal_deviation: 0.09,
        };
        let (right, up) = (Point::x(), Point::y());
        let mut contacts = vec![touch(0.005, 0.1, up)];
        for i in 1..9 {
            let along = 0.01 * f64::from(i);
            contacts.extend([touch(along, 0.0, -up), touch(0.0, along, -right)]);
            contacts.extend([touch(0.01 + along, 0.01, up), touch(0.01, 0.01 + along, right)]);
        }
        let open = Open::of(&contacts);
        assert!(open.deviation(&Point::new(0.095, 0.005, 0.0), &right) > 0.02);
        assert_eq!(open.deviation(&Point::new(0.005, 0.1, 0.0), &up), 0.0);
        assert_eq!(open.deviation(&Point::new(0.01, 0.06, 0.0), &right), 0.0);
    }

    #[test]
    fn contacts_without_normals_and_none_say_nothing() {
        for contacts in [can(0.075, false), vec![]] {
            assert_eq!(Open::of(&contacts).deviation(&Point::zeros(), &Point::z()), 0.0);
        }
    }
}
