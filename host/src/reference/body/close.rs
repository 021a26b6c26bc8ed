//! Ends for a body that contacts leave open: a can whose bottom nobody touched goes on for ever.

use nalgebra::SymmetricEigen;

use super::{Body, Mode, Part, Plane};
use crate::reference::Contact;
use crate::space::Point;

/// A body is open along a direction when it still holds the point this many times the distance from
/// the contacts' centre to the farthest of them beyond the outermost contact.
const OPEN: f64 = 0.5;

/// The same where contacts do not say how far the body goes.
const UNDECIDED: f64 = 0.05;

/// Standard deviation of where it ends, in the same distances: a side that nobody touched.
const DOUBT: f64 = 0.2;

/// Difference of an offset for its slope, metres.
const NUDGE: f64 = 1e-6;

impl Body {
    /// The same body cut by a plane at the outermost contact wherever it is open: along the axes of
    /// its round part and opposite to its planes, and along `undecided` directions if it goes on
    /// there at all. How far out the planes lie is a guess, and a mode.
    pub(super) fn closed(mut self, contacts: &[Contact], undecided: &[Point]) -> Body {
        let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len().max(1) as f64;
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        if !(reach > 0.0 && reach.is_finite()) {
            return self;
        }
        let open: Vec<Point> = self.parts.iter().flat_map(directions).collect();
        let open = open.into_iter().map(|normal| (normal, OPEN));
        for (normal, share) in undecided.iter().map(|normal| (*normal, UNDECIDED)).chain(open) {
            let outermost = contacts.iter().map(|c| normal.dot(&c.point));
            let offset = outermost.fold(f64::NEG_INFINITY, f64::max);
            let beyond = centre + normal * (offset - normal.dot(&centre) + share * reach);
            if self.active(&beyond).1.0 > 0.0 {
                continue;
            }
            let end = |by: f64| Part::Plane(Plane { normal, offset: offset + by });
            self.modes.push(Mode {
                part: self.parts.len(),
                more: end(NUDGE),
                less: end(-NUDGE),
                scale: DOUBT * reach / (2.0 * NUDGE),
            });
            self.parts.push(end(0.0));
        }
        self
    }
}

/// Where a part may be open.
fn directions(part: &Part) -> Vec<Point> {
    let both = |axis: Point| [axis, -axis];
    match part {
        Part::Prior(_) => vec![],
        Part::Quadric(quadric) => {
            let axes = SymmetricEigen::new(quadric.form()).eigenvectors;
            // In the plane z is no direction.
            let planar = quadric.form().column(2).norm() == 0.0;
            let axes = axes.column_iter().map(|a| a.into_owned());
            axes.filter(|a| !(planar && a.z.abs() > 0.5)).flat_map(both).collect()
        }
        Part::Superquadric(form) => form.axes().into_iter().flat_map(both).collect(),
        Part::Plane(plane) => vec![-plane.normal],
    }
}
