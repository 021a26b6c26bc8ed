//! The contacts that a grasp would give, by the belief: rays against the believed shape, with the
//! chance that a finger meets anything at all.

use nalgebra::{DMatrix, Point3};

use super::belief::Belief;
use super::placement::Placement;
use super::swept;
use crate::reference::Gpis;
use crate::sim::Hand;
use crate::sim::touch::Stroke;
use crate::space::Point;

/// Points along the rest of a ray at which its depth in the object is looked for.
pub(super) const DEPTHS: usize = 8;

/// A contact to be expected, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Which finger.
    pub finger: usize,
    /// Metres.
    pub point: Point,
    /// Unit, out of the object.
    pub normal: Point,
    /// Probability that the finger meets the object: how deep its ray goes into the believed shape, in
    /// standard deviations of the surface there. A contact that comes with probability p is worth one
    /// of 1/p times the noise variance, to first order.
    pub chance: f64,
}

/// What some grasps would feel, each on its own.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The contacts of each grasp.
    pub contacts: Vec<Vec<Expected>>,
    /// Joint covariance of the surface at them, m², one matrix a grasp.
    pub covariances: Vec<DMatrix<f64>>,
}

impl Prediction {
    /// Of contacts that are to be expected: what the believed surface says about them together.
    pub fn of(surface: &Gpis, contacts: Vec<Vec<Expected>>) -> Prediction {
        let points = |grasp: &Vec<Expected>| grasp.iter().map(|e| e.point).collect();
        let groups: Vec<Vec<Point>> = contacts.iter().map(points).collect();
        let covariances = surface.joint_each(&groups);
        Prediction { contacts, covariances }
    }
}

/// The contacts of the fingers whose rays meet the believed shape, for each placement.
pub fn predict(belief: &Belief, placements: &[Placement]) -> Vec<Vec<Expected>> {
    foresee(belief, placements).contacts
}

/// The same with what the surface says about the contacts of each placement together. All of them are
/// solved for at once, which is what the time of a choice goes into: criteria take it from here.
pub fn foresee(belief: &Belief, placements: &[Placement]) -> Prediction {
    let met: Vec<Vec<Met>> = match &belief.hand {
        Hand::Idealised => placements.iter().map(|p| along_rays(belief, p)).collect(),
        Hand::Articulated(hand) => swept::met(hand, belief, placements),
    };
    let depths: Vec<Point> = met.iter().flatten().flat_map(|m| m.deeper).collect();
    let radii: Vec<f64> = met.iter().flatten().map(|m| m.radius).collect();
    let contacts = |grasp: &Vec<Met>| grasp.iter().map(|m| m.contact).collect();
    let all = met.iter().map(contacts).collect();
    let mut prediction = Prediction::of(&belief.surface, all);
    let values = belief.surface.means(&depths);
    let deepest = values
        .chunks_exact(DEPTHS)
        .zip(radii)
        .map(|(d, radius)| d.iter().fold(0.0, |least: f64, v| least.min(v - radius)));
    let variances = prediction
        .covariances
        .iter()
        .flat_map(|c| c.diagonal().iter().copied().collect::<Vec<_>>());
    let chances = deepest
        .zip(variances)
        .map(|(deep, variance)| normal_below(-deep / variance.max(0.0).sqrt().max(1e-6)));
    let contacts = prediction.contacts.iter_mut().flatten();
    contacts.zip(chances).for_each(|(expected, chance)| expected.chance = chance);
    prediction
}

/// What a finger meets on its way, by the belief.
pub(super) struct Met {
    /// Its chance not yet known.
    pub contact: Expected,
    /// Places of the fingertip on the rest of its way, object frame.
    pub deeper: [Point; DEPTHS],
    /// Of the fingertip, metres.
    pub radius: f64,
}

/// What the fingers of the idealised hand meet.
fn along_rays(belief: &Belief, placement: &Placement) -> Vec<Met> {
    let off = (placement.hand.translation.vector - belief.centre).norm();
    let strokes = placement.strokes(belief.dimension, belief.radius + off);
    let met = |stroke: &Stroke| {
        let start = (placement.hand * Point3::from(stroke.start)).coords;
        let direction = placement.hand.rotation * stroke.direction;
        let (along, normal) = belief.geometry.cast(&start, &direction, stroke.travel)?;
        let point = start + along * direction;
        let step = (stroke.travel - along).min(belief.radius) / DEPTHS as f64;
        let deeper = std::array::from_fn(|k| point + direction * (step * (k + 1) as f64));
        let contact = Expected { finger: stroke.finger, point, normal, chance: 1.0 };
        Some(Met { contact, deeper, radius: 0.0 })
    };
    strokes.iter().filter_map(met).collect()
}

/// Φ(z) to three digits (logistic approximation of Bowling et al. 2009).
fn normal_below(z: f64) -> f64 {
    1.0 / (1.0 + (-(0.07056 * z * z * z + 1.5976 * z)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::Criterion;
    use crate::explore::placement::fixed;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    #[test]
    fn what_is_foreseen_together_is_what_the_surface_says_of_each() {
        for object in ["ellipse:0.1x0.06", "prism:0.06,triangle:0.05"] {
            let options = Options { grasps: Some(3), ..Options::new(object.parse().unwrap()) };
            let log = simulate(&options).unwrap().log;
            let belief = Belief::new(&log, &track::truth(&log).unwrap()).unwrap();
            let seen = foresee(&belief, &fixed(belief.dimension, &belief.centre));
            assert_eq!(seen.contacts.len(), seen.covariances.len());
            for (contacts, covariance) in seen.contacts.iter().zip(&seen.covariances) {
                let points: Vec<Point> = contacts.iter().map(|e| e.point).collect();
                let variances = belief.surface.variances(&points);
                assert_eq!(covariance.nrows(), variances.len());
                for (i, v) in variances.iter().enumerate() {
                    assert!((covariance[(i, i)] - v).abs() < 1e-9 * belief.radius.powi(2));
                }
                for p in &points {
                    assert!(belief.geometry.distance(p) < 1e-9);
                }
            }
            for criterion in [Criterion::Entropy, Criterion::VarianceSum, Criterion::DetSigma] {
                let apart = criterion.scores(&belief, &seen.contacts);
                let together = criterion.worth(&belief, &seen);
                assert!(together.iter().any(|s| *s > 0.0) || criterion == Criterion::DetSigma);
                for (a, b) in apart.iter().zip(&together) {
                    assert!((a - b).abs() <= 1e-6 * a.abs(), "{object} {criterion:?} {a} {b}");
                }
            }
        }
    }

    #[test]
    fn chances_are_those_of_the_normal_distribution() {
        for (z, p) in [(0.0, 0.5), (1.0, 0.8413), (-2.0, 0.0228), (3.0, 0.99865)] {
            assert!((normal_below(z) - p).abs() < 2e-3, "{z}");
        }
    }
}
