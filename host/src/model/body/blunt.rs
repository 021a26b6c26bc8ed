//! Corners that a side cuts off which nobody touched.
//!
//! Where a side was missed, its neighbours are drawn out to where they meet. Contacts that fall anywhere on
//! the surface alike would hardly leave so much of it bare: each is the less likely the larger the surface.

use nalgebra::Matrix3;

use super::close::Ray;
use super::{Body, Plane};
use crate::model::places::places;
use crate::reference::Contact;
use crate::space::{Point, centroid};

/// How probable a cut is before any contact for a corner as far beyond the contacts as they reach, to none.
/// Of hexagons, quadrilaterals and triangles of 5 to 20 contacts hardly one has a corner with more that is none,
/// or less where a side was missed.
const ODDS: f64 = 0.5;

/// Places of a cut that are tried.
const PLACES: u32 = 20;

/// A cut across a corner.
struct Cut {
    plane: Plane,
    /// Of its offset, metres.
    deviation: f64,
    /// By how much it is more probable than none, nats, and how much of that it is because the surface is smaller.
    gain: f64,
    smaller: f64,
}

/// What a cut is judged by.
struct Sharp {
    dimension: usize,
    /// That were touched.
    places: usize,
    /// Of the contacts, and how far they reach from there, metres.
    centre: Point,
    reach: f64,
    rays: Vec<Ray>,
}

impl Body {
    /// The same with a plane across the corner, in space the edge, of two of its planes at less than a right angle:
    /// where one is most probable, beyond the outermost contacts. By how much for other reasons than its
    /// [size](Body::size) is part of its oddity, and where the plane lies a mode. `None` where none is more probable
    /// than not.
    pub(super) fn blunted(&self, dimension: usize, contacts: &[Contact]) -> Option<Body> {
        let centre = centroid(contacts.iter().map(|c| c.point));
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        let rays = self.rays(dimension, &centre);
        let sharp = Sharp { dimension, places: places(contacts), centre, reach, rays };
        let planes: Vec<Plane> = self.planes().collect();
        let pairs = planes.iter().enumerate().flat_map(|(i, one)| {
            let others = planes.iter().skip(i + 1);
            others
                .filter(|other| one.normal.dot(&other.normal) < 0.0)
                .map(move |other| (one, other))
        });
        let cuts = pairs.filter_map(|(one, other)| {
            let normal = (one.normal + other.normal).try_normalize(1e-3)?;
            let along = contacts.iter().map(|c| normal.dot(&c.point));
            let near = along.fold(f64::NEG_INFINITY, f64::max);
            sharp.cut(normal, near, normal.dot(&meeting(one, other, &centre, &planes)?))
        });
        let cut = cuts.filter(|cut| cut.gain > 0.0).max_by(|a, b| a.gain.total_cmp(&b.gain))?;
        let mut body = self.clone();
        body.end(cut.plane, cut.deviation);
        body.oddity -= cut.gain - cut.smaller;
        Some(body)
    }
}

impl Sharp {
    /// Anywhere between the offset of the outermost contact and that of the corner, as likely as the surface is
    /// then smaller.
    fn cut(&self, normal: Point, near: f64, far: f64) -> Option<Cut> {
        // Of the surface within a plane so far from the centre.
        let area = |depth: f64| -> f64 {
            self.rays.iter().map(|ray| ray.cut(&normal, depth).area(self.dimension)).sum()
        };
        let whole = area(f64::INFINITY);
        let smaller = |offset: f64| {
            let left = area(offset - normal.dot(&self.centre));
            (whole / left).ln() * self.places as f64
        };
        let place = |step: u32| {
            let offset = near + (far - near) * (f64::from(step) + 0.5) / f64::from(PLACES);
            (offset, smaller(offset))
        };
        let places: Vec<(f64, f64)> = (0..PLACES).map(place).collect();
        // Of many contacts the likelihoods themselves are no numbers.
        let most = places.iter().map(|(_, nats)| *nats).fold(f64::NEG_INFINITY, f64::max);
        let places = places.into_iter().map(|(offset, nats)| (offset, (nats - most).exp()));
        let places: Vec<(f64, f64)> = places.collect();
        let sum: f64 = places.iter().map(|(_, likelihood)| likelihood).sum();
        let mean = |of: &dyn Fn(f64) -> f64| {
            places.iter().map(|(offset, likelihood)| of(*offset) * likelihood).sum::<f64>() / sum
        };
        let offset = mean(&|offset| offset);
        let deviation = mean(&|other| (other - offset).powi(2)).sqrt();
        let gain = (ODDS * (far - near) / self.reach * sum / f64::from(PLACES)).ln() + most;
        let is_usable = gain.is_finite() && deviation.is_finite();
        let plane = Plane { normal, offset };
        is_usable.then(|| Cut { plane, deviation, gain, smaller: smaller(offset) })
    }
}

/// A point where two of the planes meet within all others.
fn meeting(one: &Plane, other: &Plane, centre: &Point, planes: &[Plane]) -> Option<Point> {
    let along = one.normal.cross(&other.normal).try_normalize(1e-6)?;
    let rows = [one.normal, other.normal, along].map(|normal| normal.transpose());
    let offsets = Point::new(one.offset, other.offset, along.dot(centre));
    let point = Matrix3::from_rows(&rows).lu().solve(&offsets)?;
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for plane in planes.iter().filter(|plane| *plane != one && *plane != other) {
        let slope = plane.normal.dot(&along);
        let room = plane.offset - plane.normal.dot(&point);
        if slope.abs() < 1e-9 {
            if room < 0.0 {
                return None;
            }
        } else if slope > 0.0 {
            high = high.min(room / slope);
        } else {
            low = low.max(room / slope);
        }
    }
    (low < high).then_some(point + along * low.max(high.min(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Faces;
    use crate::model::body::tests::touch;
    use std::f64::consts::TAU;

    /// Touches of so many sides, each 30 mm from the middle, of a prism with so many in all: `each` of every side,
    /// from one end of it to the other, and in space as often of top and bottom.
    fn prism(dimension: usize, sides: u32, felt: u32, each: u32) -> Vec<Contact> {
        let share = |k: u32| 1.8 * (f64::from(k) + 0.5) / f64::from(each) - 0.9;
        let side = |i: u32| {
            let angle = TAU * f64::from(i) / f64::from(sides);
            let out = Point::new(angle.cos(), angle.sin(), 0.0);
            let half = 0.03 * (0.5 * TAU / f64::from(sides)).tan();
            (0..each).map(move |k| {
                let up = if dimension == 3 { 0.02 * share((5 * k + i) % each) } else { 0.0 };
                touch(
                    out * 0.03 + Point::new(-out.y, out.x, 0.0) * half * share(k) + Point::z() * up,
                    out,
                )
            })
        };
        let end = |way: f64| {
            (0..each).map(move |k| {
                touch(Point::new(0.02 * share(k), 0.01 * way, 0.025 * way), Point::z() * way)
            })
        };
        let ends = if dimension == 3 { vec![1.0, -1.0] } else { vec![] };
        (0..felt).flat_map(side).chain(ends.into_iter().flat_map(end)).collect()
    }

    fn flat(dimension: usize, contacts: &[Contact]) -> Body {
        Body::flat(dimension, contacts, &Faces::fit(dimension, contacts).unwrap()).unwrap().0
    }

    #[test]
    fn a_side_that_was_missed_is_where_its_neighbours_are_drawn_out() {
        for (dimension, each) in [(2, 3), (3, 3)] {
            let contacts = prism(dimension, 6, 5, each);
            let body = flat(dimension, &contacts);
            let blunted = body.blunted(dimension, &contacts).unwrap();
            let cut = blunted.planes().last().unwrap();
            assert_eq!(blunted.parts().len(), body.parts().len() + 1);
            // Nobody felt the sixth, across from the third.
            let missed = Point::new(0.5, -0.75f64.sqrt(), 0.0);
            assert!(cut.normal.dot(&missed) > 0.99, "{cut:?}");
            assert!((0.028..0.045).contains(&cut.offset), "{cut:?}");
            // What speaks against it is less than how much smaller it is.
            let gain = |body: &Body, blunted: &Body, contacts: &[Contact]| {
                let [more, less] = [body, blunted].map(|b| b.size(dimension, contacts).unwrap());
                let smaller = places(contacts) as f64 * (more / less).ln();
                smaller + body.oddity() - blunted.oddity()
            };
            let gained = gain(&body, &blunted, &contacts);
            assert!(blunted.oddity() > body.oddity() && gained > 0.0, "{gained}");
            // More contacts are surer of it, and that it lies further in.
            let many = prism(dimension, 6, 5, 3 * each);
            let whole = flat(dimension, &many);
            let sure = whole.blunted(dimension, &many).unwrap();
            assert!(gain(&whole, &sure, &many) > gained);
            assert!(sure.planes().last().unwrap().offset < cut.offset);
            assert_eq!(blunted.blunted(dimension, &contacts), None);
            // But those of the same places are not.
            let again = body.blunted(dimension, &contacts.repeat(1_000)).unwrap();
            assert!((again.oddity() - blunted.oddity()).abs() < 1e-6);
        }
    }

    #[test]
    fn corners_that_contacts_come_near_are_none() {
        for (dimension, sides) in [(2, 3), (2, 4), (2, 6), (3, 3), (3, 6)] {
            let contacts = prism(dimension, sides, sides, 4);
            assert_eq!(flat(dimension, &contacts).blunted(dimension, &contacts), None, "{sides}");
        }
    }

    #[test]
    fn nothing_is_cut_off_what_is_no_polytope() {
        let contacts = prism(2, 6, 5, 3);
        let ball = Body::ball(2, &contacts).unwrap();
        assert_eq!(ball.blunted(2, &contacts), None);
        assert_eq!(flat(2, &contacts).blunted(2, &[]), None);
        let same = vec![contacts[0]; 9];
        let body = flat(2, &contacts).blunted(2, &same);
        assert!(body.is_none_or(|b| b.planes().all(|p| p.offset.is_finite())));
    }
}
