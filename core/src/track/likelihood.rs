//! How well a contact fits a surface at a pose: thesis 3.9 with a scale.
//!
//! The thesis weighs by exp(−Σ|f|). That has no unit, forgets that the surface is uncertain where
//! nothing was touched, and rewards drifting to where |f| is small. Here a contact is compared with
//! the surface as a measurement is with its prediction. With f, ∇f, their variances V and V′ per
//! component, and g = max(|∇f|, 0.3):
//!
//! ```text
//! distance   r = f/g            variance  σ_p² + V/g²
//! normal     α = ∠(∇f, n)       variance  σ_θ² + V′/g²   per axis
//! ```
//!
//! Both are scored by Student's t with four degrees of freedom, which keeps a few wild contacts from
//! deciding alone.

use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::Probe;

/// Degrees of freedom of Student's t.
pub const FREEDOM: f32 = 4.0;

/// Gradients shorter than this count as this long: where the field is flat, f/|∇f| means nothing.
pub const LEAST_SLOPE: f32 = 0.3;

/// Log likelihood, up to a constant, of a contact whose position in the object frame was probed and
/// whose `normal` is in object axes.
#[inline]
pub fn log_likelihood<S: Space>(
    probe: &Probe<S>,
    normal: Option<S::Vector>,
    contact: &Contact<S>,
) -> f32 {
    let slope = probe.gradient.norm().max(LEAST_SLOPE);
    let scale = 1.0 / (slope * slope);
    let spread = contact.point_deviation * contact.point_deviation + probe.variance * scale;
    let distance = student(probe.value * probe.value * scale, spread, 1.0);
    let Some(normal) = normal else {
        return distance;
    };
    let angle = S::angle_between(probe.gradient, normal);
    let spread = contact.normal_deviation * contact.normal_deviation + probe.slope_variance * scale;
    distance + student(angle * angle, spread, (S::DIMENSION - 1) as f32)
}

/// Deviations beyond which a contact is nowhere near where the surface is known to be. A Gaussian
/// process knows little away from its contacts: 15 mm above one it allows for 3 to 5 mm.
const STRANGE: f32 = 3.0;

/// Least probability, of what it would be otherwise, of a fingertip that met nothing inside the
/// object: the fingertip is not a point, and the hand may have moved the object.
const FREE_DOUBT: f32 = 0.05;

/// Standard deviation of the place of a fingertip that met nothing, metres.
const FREE_DEVIATION: f32 = 2e-3;

/// Whether a contact contradicts the surface where it was probed: farther from it than three standard
/// deviations of both, or on its other side. Where nothing was touched nothing is strange.
pub fn is_strange<S: Space>(
    probe: &Probe<S>,
    normal: Option<S::Vector>,
    contact: &Contact<S>,
) -> bool {
    let slope = probe.gradient.norm().max(LEAST_SLOPE);
    let scale = 1.0 / (slope * slope);
    let spread = contact.point_deviation * contact.point_deviation + probe.variance * scale;
    let far = !(probe.value * probe.value * scale <= STRANGE * STRANGE * spread);
    let behind =
        normal.is_some_and(|n| probe.gradient.dot(n) < 0.0) && probe.slope_variance * scale < 0.25;
    far || behind
}

/// Log probability, up to a constant, that a fingertip met nothing where the surface was probed:
/// zero outside the object, falling with the depth inside to a bound.
#[inline]
pub fn log_free<S: Space>(probe: &Probe<S>) -> f32 {
    if !(probe.value < 0.0) {
        return 0.0;
    }
    let slope = probe.gradient.norm().max(LEAST_SLOPE);
    let scale = 1.0 / (slope * slope);
    let spread = FREE_DEVIATION * FREE_DEVIATION + probe.variance * scale;
    let depth = probe.value * probe.value * scale / spread;
    math::ln(FREE_DOUBT + (1.0 - FREE_DOUBT) * math::exp(-0.5 * depth))
}

/// Log density, up to a constant, of a residual of `axes` components with this squared length and
/// variance per component.
#[inline(always)]
fn student(squared: f32, variance: f32, axes: f32) -> f32 {
    let tail = 0.5 * (FREEDOM + axes) * math::ln(1.0 + squared / (FREEDOM * variance));
    let log = -tail - 0.5 * axes * math::ln(variance);
    // What is no number fits nothing.
    if squared.is_finite() { log } else { f32::NEG_INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;

    fn probe(value: f32, variance: f32) -> Probe<Planar> {
        let gradient = Vector([0.0, 1.0]);
        Probe { value, gradient, variance, slope_variance: 0.01, nearest: 0.0 }
    }

    const CONTACT: Contact<Planar> = Contact {
        point: Vector([0.0, 0.0]),
        normal: Some(Vector([0.0, 1.0])),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
        finger: 0,
    };

    #[test]
    fn nearer_is_likelier_and_uncertain_surfaces_forgive() {
        let at = |value, variance| log_likelihood(&probe(value, variance), None, &CONTACT);
        assert!(at(0.0, 1e-6) > at(0.002, 1e-6));
        let drop = |variance| at(0.0, variance) - at(0.01, variance);
        assert!(drop(1e-6) > 4.0 * drop(1e-4));
        // Robust: ten times as far costs a logarithm, not a square.
        assert!(at(0.01, 1e-6) - at(0.1, 1e-6) < 13.0);
        // What is no number fits nothing.
        assert_eq!(at(f32::NAN, 1e-6), f32::NEG_INFINITY);
        // The surface scale cancels: 2f with twice the slope is the same contact.
        let steep = Probe { gradient: Vector([0.0, 2.0]), ..probe(0.004, 4e-6) };
        assert!((log_likelihood(&steep, None, &CONTACT) - at(0.002, 1e-6)).abs() < 1e-5);
    }

    #[test]
    fn what_contradicts_the_surface_is_strange() {
        let strange = |value, variance, n: [f32; 2]| {
            is_strange(&probe(value, variance), Some(Vector(n)), &CONTACT)
        };
        assert!(!strange(0.004, 1e-6, [0.0, 1.0]) && strange(0.02, 1e-6, [0.0, 1.0]));
        assert!(!strange(0.02, 1e-4, [0.0, 1.0]) && !strange(0.0, 1e-6, [0.9, 0.1]));
        assert!(strange(0.0, 1e-6, [0.0, -1.0]));
        assert!(strange(f32::NAN, 1e-6, [0.0, 1.0]));
    }

    #[test]
    fn fingers_meet_nothing_outside_rather_than_inside() {
        let free = |value, variance| log_free(&probe(value, variance));
        assert_eq!((free(0.01, 1e-6), free(f32::NAN, 1e-6)), (0.0, 0.0));
        assert!(free(-0.001, 1e-6) > -0.2 && free(-0.02, 1e-6) < -2.9);
        // Where the surface is not known, neither is its inside.
        assert!(free(-0.02, 1e-3) > -0.3 && free(-1.0, 1e-6) > -3.1);
    }

    #[test]
    fn opposite_normals_are_unlikely() {
        let with = |normal| log_likelihood(&probe(0.0, 1e-6), Some(normal), &CONTACT);
        assert!(with(Vector([0.0, 1.0])) - with(Vector([0.0, -1.0])) > 8.0);
        assert!(with(Vector([0.1, 0.995])) < with(Vector([0.0, 1.0])));
    }
}
