//! What is believed of an object that contacts show to be hollow: that it fills a box along its sides.

use super::{Body, Part, Plane};
use crate::model::Faces;
use crate::model::faces::Face;
use crate::reference::{Contact, Prior};
use crate::space::Point;

/// How far contacts lie beyond the tangent plane of another, in radii of the ball that fits them, where
/// no convex body will do. On a convex one they lie on it or behind it, up to noise.
const HOLLOW: f64 = 0.5;

/// Least radius for that, in mean distances of the contacts from their middle: the ball that fits a plate, whose
/// normals nearly all point the same two ways, lies within it.
const FLAT: f64 = 0.5;

/// Deviations of that distance, and share of the contacts, that may do so all the same.
const NOISE: f64 = 2.0;
const WILD: f64 = 0.05;

/// The box ends so many radii beyond the outermost contacts.
const MARGIN: f64 = 0.2;

/// Cosine of the angle between faces of which one is no side of a box along the other.
const OBLIQUE: f64 = 0.5;

impl Body {
    /// Nothing within a box along the sides that most contacts lie on (a mean of zero: on the surface
    /// unless contacts tell otherwise), and outside beyond it. `None` unless contacts rule out every
    /// convex body, by lying far beyond the tangent planes of others. A ball or a quadric that fits
    /// these least badly is none that says what lies between them.
    pub fn hollow(dimension: usize, contacts: &[Contact], faces: &Faces) -> Option<Body> {
        let Prior::Ball { radius, .. } = Prior::fitted(contacts)? else { return None };
        let Prior::Ball { radius: about, .. } = Prior::about(contacts.iter().map(|c| c.point))?
        else {
            return None;
        };
        let size = radius.max(FLAT * about);
        let contradicted = contacts.iter().filter(|c| is_contradicted(c, contacts, size)).count();
        if contradicted as f64 <= WILD * contacts.len() as f64 {
            return None;
        }
        let end = |normal: Point| {
            let along = contacts.iter().map(|c| normal.dot(&c.point));
            let outermost = along.fold(f64::NEG_INFINITY, f64::max);
            Part::Plane(Plane { normal, offset: outermost + MARGIN * radius })
        };
        let ends = axes(dimension, &faces.faces).into_iter().flat_map(|n| [end(n), end(-n)]);
        let parts: Vec<Part> =
            std::iter::once(Part::Prior(Prior::Constant(0.0))).chain(ends).collect();
        let nothing = Body { parts, modes: vec![], oddity: 0.0, chi_squared: 0.0, degrees: 0.0 };
        let chi_squared = contacts.iter().map(|c| nothing.chi_squared_of(c)).sum();
        let measured = |c: &Contact| if c.normal.is_some() { dimension } else { 1 };
        let degrees = contacts.iter().map(measured).sum::<usize>() as f64;
        Some(Body { chi_squared, degrees, ..nothing })
    }

    fn chi_squared_of(&self, contact: &Contact) -> f64 {
        let (value, gradient) = self.touched(contact).1;
        let turn = contact.normal.map_or(0.0, |n| (gradient - n).norm() / contact.normal_deviation);
        (value / contact.point_deviation).powi(2) + turn.powi(2)
    }
}

/// Whether another contact lies so far beyond the tangent plane of this one that the object is not
/// convex there.
fn is_contradicted(contact: &Contact, contacts: &[Contact], size: f64) -> bool {
    let Some(normal) = contact.normal else { return false };
    contacts.iter().any(|other| {
        let away = other.point - contact.point;
        let points = contact.point_deviation.hypot(other.point_deviation);
        let noise = points.hypot(contact.normal_deviation * away.norm());
        normal.dot(&away) > HOLLOW * size + NOISE * noise
    })
}

/// Axes of the box, unit and square to each other: the normal of the face with most contacts, then of
/// the one most contacts lie on that crosses it.
fn axes(dimension: usize, faces: &[Face]) -> Vec<Point> {
    let mut sides: Vec<&Face> = faces.iter().collect();
    sides.sort_by_key(|face| std::cmp::Reverse(face.contacts));
    let first = sides.first().map_or(Point::x(), |face| face.normal);
    if dimension == 2 {
        return vec![first, Point::new(-first.y, first.x, 0.0)];
    }
    let crossing = sides.iter().map(|face| face.normal).find(|n| n.dot(&first).abs() < OBLIQUE);
    let second = crossing.unwrap_or_else(|| Point::ith(first.iamin(), 1.0));
    let second = (second - first * first.dot(&second)).normalize();
    vec![first, second, first.cross(&second)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Mean;
    use proptest::prelude::*;

    fn contact(point: Point, normal: Point) -> Contact {
        Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.0873 }
    }

    /// Two touches on every side of an L of 90 × 90 mm with arms of 35 mm, turned and moved.
    fn touched(turn: f64) -> Vec<Contact> {
        let corners =
            [[0.0, 0.0], [0.09, 0.0], [0.09, 0.035], [0.035, 0.035], [0.035, 0.09], [0.0, 0.09]];
        let place = nalgebra::Rotation3::from_axis_angle(&Point::z_axis(), turn);
        let side = |i: usize| {
            let [from, to] =
                [corners[i], corners[(i + 1) % 6]].map(|c| Point::new(c[0], c[1], 0.0));
            let along = to - from;
            let normal = Point::new(along.y, -along.x, 0.0).normalize();
            [0.3, 0.6].map(|share| {
                contact(place * (from + along * share) + Point::new(0.2, -0.1, 0.0), place * normal)
            })
        };
        (0..6).flat_map(side).collect()
    }

    fn hollow(contacts: &[Contact]) -> Option<Body> {
        Body::hollow(2, contacts, &Faces::fit(2, contacts)?)
    }

    proptest! {
        #[test]
        fn the_box_lies_along_the_sides(turn in 0.0..6.2) {
            let contacts = touched(turn);
            let body = hollow(&contacts).unwrap();
            prop_assert_eq!(body.parts().len(), 5);
            let normals: Vec<Point> = contacts.iter().filter_map(|c| c.normal).collect();
            for part in body.parts() {
                let Part::Plane(plane) = part else { continue };
                let side = normals.iter().map(|n| n.dot(&plane.normal)).fold(0.0, f64::max);
                prop_assert!(side > 0.999, "{}", side);
                let along = contacts.iter().map(|c| plane.normal.dot(&c.point));
                let margin = plane.offset - along.fold(f64::NEG_INFINITY, f64::max);
                prop_assert!((0.005..0.02).contains(&margin), "{}", margin);
                // Outside beyond it by as much as it is away, on the surface within.
                let deep = plane.normal * 0.01;
                let foot = contacts[0].point
                    + plane.normal * (plane.offset - plane.normal.dot(&contacts[0].point));
                prop_assert!((body.value(&(foot + deep)) - 0.01).abs() < 1e-9);
                prop_assert!(body.value(&(foot - deep)).abs() < 1e-12);
            }
            prop_assert!(contacts.iter().all(|c| body.value(&c.point).abs() < 1e-12));
            prop_assert!(body.misfit() > 10.0);
        }

        /// Neither are points up to three deviations off, and normals off by two.
        #[test]
        fn what_is_convex_is_not_hollow(count in 3..40, half in 0.01..0.08, noise in -1.0..1.0) {
            let around = |i: i32| {
                let angle = std::f64::consts::TAU * f64::from(i) / f64::from(count);
                let (sin, cos) = angle.sin_cos();
                let normal = Point::new(cos / 0.06, sin / half, 0.0).normalize();
                let off = noise * (5.0 * f64::from(i)).sin();
                let turn = nalgebra::Rotation3::from_axis_angle(&Point::z_axis(), 0.17 * off);
                let point = Point::new(0.06 * cos, half * sin, 0.0) + normal * (3e-3 * off);
                contact(point, turn * normal)
            };
            let contacts: Vec<Contact> = (0..count).map(around).collect();
            prop_assert!(hollow(&contacts).is_none());
        }
    }

    #[test]
    fn one_wild_normal_is_no_hollow() {
        let around = |wild: i32| {
            let touch = move |i: i32| {
                let (sin, cos) = (0.21 * f64::from(i)).sin_cos();
                let normal = Point::new(cos, sin, 0.0);
                contact(normal * 0.05, if i % wild == 3 { -normal } else { normal })
            };
            (0..30).map(touch).collect::<Vec<Contact>>()
        };
        assert!(hollow(&around(30)).is_none());
        assert!(hollow(&around(7)).is_some());
    }

    #[test]
    fn normals_that_may_be_far_off_contradict_nothing() {
        let turn = nalgebra::Rotation3::from_axis_angle(&Point::z_axis(), 1.2);
        let around = |normal_deviation: f64| {
            let touch = move |i: i32| {
                let (sin, cos) = (0.63 * f64::from(i)).sin_cos();
                let out = Point::new(cos, sin, 0.0);
                Contact { normal_deviation, ..contact(out * 0.05, turn * out) }
            };
            (0..10).map(touch).collect::<Vec<Contact>>()
        };
        assert!(hollow(&around(0.6)).is_none());
        assert!(hollow(&around(0.05)).is_some());
    }

    #[test]
    fn a_plate_is_not_hollow_for_the_normals_of_its_rim() {
        let side = |way: f64| {
            let touch = move |i: i32| {
                let (x, y) = (2.4 * f64::from(i)).sin_cos();
                contact(Point::new(0.1 * x, 0.06 * y, 0.003 * way), Point::z() * way)
            };
            (0..10).map(touch)
        };
        // As far off as one in a hundred is, so that the plane there cuts the far end.
        let rim = (0..3).map(|i| {
            let turn = nalgebra::Rotation3::from_axis_angle(&Point::z_axis(), 0.22);
            contact(Point::new(-0.09 + 0.02 * f64::from(i), 0.06, 0.0), turn * Point::y())
        });
        let contacts: Vec<Contact> = side(1.0).chain(side(-1.0)).chain(rim).collect();
        let Some(Prior::Ball { radius, .. }) = Prior::fitted(&contacts) else { panic!() };
        assert!((Prior::LEAST_RADIUS..0.012).contains(&radius), "{radius}");
        assert_eq!(Body::hollow(3, &contacts, &Faces::fit(3, &contacts).unwrap()), None);
    }

    #[test]
    fn the_box_is_square_whatever_crosses() {
        let floor =
            |x: f64, z: f64| contact(Point::new(x, 0.0, z), Point::new(0.0, 0.0, z.signum()));
        // A step: felt from above at two heights, and nothing else; or a slope beside it, too.
        let step = [floor(0.0, 0.05), floor(0.01, 0.05), floor(0.05, 0.001), floor(0.06, 0.001)];
        let slope = contact(Point::new(0.09, 0.0, 0.0), Point::new(0.9, 0.0, 0.19f64.sqrt()));
        for contacts in [step.to_vec(), [&step[..], &[slope]].concat()] {
            let body = Body::hollow(3, &contacts, &Faces::fit(3, &contacts).unwrap()).unwrap();
            assert_eq!(body.parts().len(), 7);
            let far = body.value(&Point::new(1.0, 1.0, 1.0));
            assert!(far.is_finite() && far > 0.5);
            let normals: Vec<Point> = body
                .parts()
                .iter()
                .filter_map(|part| if let Part::Plane(p) = part { Some(p.normal) } else { None })
                .collect();
            for (one, other) in normals.iter().flat_map(|a| normals.iter().map(move |b| (a, b))) {
                let cosine = one.dot(other).abs();
                assert!(cosine < 1e-9 || (cosine - 1.0).abs() < 1e-9, "{cosine}");
            }
        }
    }
}
