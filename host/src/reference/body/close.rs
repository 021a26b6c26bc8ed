//! Ends for a body that contacts leave open: a can whose bottom nobody touched goes on for ever, and
//! two sides that are nearly parallel meet far away.

use std::f64::consts::TAU;

use super::{Body, Mode, Part, Plane};
use crate::reference::Contact;
use crate::space::Point;

/// A body is open in a direction when it still holds the point this many times the distance from the
/// contacts' centre to the farthest of them beyond where it would end.
const OPEN: f64 = 1.0;

/// The same where contacts do not say how far the body goes.
const UNDECIDED: f64 = 0.05;

/// Standard deviation of where it ends, in the same distances: a side that nobody touched.
const DOUBT: f64 = 0.2;

/// Directions that are looked at in the plane and in space, and planes that are added at most.
const DIRECTIONS: [usize; 2] = [96, 400];
const MOST: usize = 8;

/// Difference of an offset for its slope, metres.
const NUDGE: f64 = 1e-6;

impl Body {
    /// The same body cut by planes beyond the outermost contacts until it is closed: first along the
    /// `undecided` directions, then always where it reaches furthest. How far out the planes lie is
    /// a guess, and a mode: of contacts spread evenly over a length the last is as far from its end
    /// as they are from each other.
    pub(super) fn closed(
        mut self,
        dimension: usize,
        contacts: &[Contact],
        undecided: &[Point],
    ) -> Body {
        let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len().max(1) as f64;
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        if !(reach > 0.0 && reach.is_finite()) {
            return self;
        }
        let offset = |normal: &Point| {
            let along = contacts.iter().map(|c| normal.dot(&c.point));
            let low = along.clone().fold(f64::INFINITY, f64::min);
            let high = along.fold(f64::NEG_INFINITY, f64::max);
            high + (high - low) / contacts.len() as f64
        };
        // How deep inside the body a point beyond the contacts is.
        let depth = |body: &Body, normal: &Point, share: f64| {
            let beyond = offset(normal) - normal.dot(&centre) + share * reach;
            -body.active(&(centre + normal * beyond)).1.0
        };
        let end = |body: &mut Body, normal: Point| {
            let at = |by: f64| Part::Plane(Plane { normal, offset: offset(&normal) + by });
            body.modes.push(Mode {
                part: body.parts.len(),
                more: at(NUDGE),
                less: at(-NUDGE),
                scale: DOUBT * reach / (2.0 * NUDGE),
            });
            body.parts.push(at(0.0));
        };
        for normal in undecided {
            if depth(&self, normal, UNDECIDED) > 0.0 {
                end(&mut self, *normal);
            }
        }
        let directions = directions(dimension);
        for _ in 0..MOST {
            let depths = directions.iter().map(|normal| (depth(&self, normal, OPEN), normal));
            let Some((depth, normal)) = depths.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            if !(depth > 0.0) {
                break;
            }
            end(&mut self, *normal);
        }
        self
    }
}

/// Evenly spread: equal angles, or a golden spiral from pole to pole.
fn directions(dimension: usize) -> Vec<Point> {
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let count = DIRECTIONS[usize::from(dimension == 3)];
    let direction = |i: usize| {
        if dimension == 2 {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            return Point::new(cos, sin, 0.0);
        }
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (TAU * golden * i as f64).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        Point::new(ring * cos, ring * sin, z)
    };
    (0..count).map(direction).collect()
}
