//! Motions of the object that the contacts do not see (thesis 3.3.2, with turns counted at the
//! object's radius and centred, Gelfand 2003): weak eigenvectors of the information, then followed
//! to see how far they really lead.

use nalgebra::{SymmetricEigen, Vector6};

use super::Surface;
use super::likelihood::Evidence;
use crate::shape::symmetry::Symmetry;
use crate::space::{Point, Pose};

/// A direction is tried when it is known no better than to this part of the object's radius: the sides of a mesh that
/// is nearly round tell a place among them, and not which of them it is.
const WEAK: f64 = 0.01;

/// It is free when it can be followed over this part of the radius (turns: radians), both ways
/// together ...
const REACH: f64 = 0.5;

/// ... without costing more than this, nats.
const COST: f64 = 2.0;

/// Least cosine between two axes that are one.
const ALIKE: f64 = 0.97;

/// Strides for that.
const STEPS: usize = 10;

/// A motion of the object that the contacts cannot tell from none, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Freedom {
    /// A shift along this unit vector.
    Shift {
        /// Unit vector.
        along: Point,
    },
    /// A turn about this axis, screwing forward by `pitch` metres a radian.
    Turn {
        /// Unit vector.
        about: Point,
        /// A point of the axis, metres.
        through: Point,
        /// Metres a radian along `about`.
        pitch: f64,
    },
}

/// All free directions at `seen` (world to object), freest first.
pub(super) fn freedoms<S: Surface>(
    surface: &S,
    evidence: &Evidence,
    seen: &Pose,
    misfit: f64,
) -> Vec<Freedom> {
    let eigen = SymmetricEigen::new(evidence.information(surface, seen, misfit));
    let mut order: Vec<usize> = (0..6).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let weak = 1.0 / (WEAK * evidence.radius).powi(2);
    let follow = |k: usize| {
        let valley: Vector6<f64> = eigen.eigenvectors.column(k).into_owned();
        let followed = |way: f64| followed(surface, evidence, seen, &(valley * way), misfit);
        let free = eigen.eigenvalues[k] < weak && followed(1.0) + followed(-1.0) >= STEPS;
        free.then(|| named(evidence, &valley))
    };
    order.into_iter().filter_map(follow).collect()
}

/// How many strides of [`REACH`]/[`STEPS`] the valley can be followed, at most [`STEPS`]: a stride
/// along it, then one back to its floor.
fn followed<S: Surface>(
    surface: &S,
    evidence: &Evidence,
    seen: &Pose,
    valley: &Vector6<f64>,
    misfit: f64,
) -> usize {
    let allowed = evidence.nats(surface, seen, 1.0) + COST * misfit;
    let stride = valley * (REACH * evidence.radius / STEPS as f64);
    let mut seen = *seen;
    for done in 0..STEPS {
        seen = evidence.moved(&seen, &stride);
        let here = evidence.about(surface, &seen, 1.0);
        let mut nats = here.nats;
        if let Some(back) = here.step_across(valley)
            && back.norm() < REACH * evidence.radius
        {
            let tried = evidence.moved(&seen, &back);
            let better = evidence.nats(surface, &tried, 1.0);
            if better < nats {
                (seen, nats) = (tried, better);
            }
        }
        if !(nats <= allowed) {
            return done;
        }
    }
    STEPS
}

/// The turn about the axis of an object that is round.
pub(super) fn round(symmetry: &Symmetry) -> Option<Freedom> {
    let about = symmetry.axis()?.into_inner();
    Some(Freedom::Turn { about, through: symmetry.centre(), pitch: 0.0 })
}

/// Whether both are turns about the same axis, or nearly so.
pub(super) fn are_alike(a: &Freedom, b: &Freedom) -> bool {
    match (a, b) {
        (Freedom::Turn { about, .. }, Freedom::Turn { about: other, .. }) => {
            about.dot(other).abs() > ALIKE
        }
        _ => false,
    }
}

/// In words of geometry. The direction moves the contacts in the object frame; the object moves
/// under them the other way, along the same line or about the same axis.
fn named(evidence: &Evidence, valley: &Vector6<f64>) -> Freedom {
    let shift = Point::new(valley[0], valley[1], valley[2]);
    let turn = Point::new(valley[3], valley[4], valley[5]) / evidence.radius;
    // Less than a tenth of the motion of the rim: no axis worth a name.
    let Some(about) = turn.try_normalize(0.1 / evidence.radius) else {
        return Freedom::Shift { along: shift.normalize() };
    };
    let rate = turn.norm();
    let through = evidence.centre + about.cross(&shift) / rate;
    Freedom::Turn { about, through, pitch: about.dot(&shift) / rate }
}
