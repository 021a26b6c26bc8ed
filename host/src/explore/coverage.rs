//! When enough is known. The thesis stops at "90 % of the contour" and does not say when a part of it
//! counts; since the number of actions hangs on that, the choice has a name. Where the pose is tracked,
//! the true shape is first laid on the believed one: as in the thesis, a common displacement is no
//! error of the shape.

use std::str::FromStr;

use super::belief::Belief;
use crate::shape::{Field, Geometry};
use crate::space::{Point, Pose};

/// Points of the true surface that are looked at.
pub(super) const SAMPLES: usize = 320;

/// Share of the surface that must be known.
pub const SHARE: f64 = 0.9;

/// Field slopes below this do not make a value a distance.
const LEAST_SLOPE: f64 = 0.3;

/// What counts as known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// Standard deviation at most 1.8 mm and true error at most 1.8 mm on 90 % of the surface.
    Strict,
    /// 2.5 mm and 3 mm.
    Lenient,
    /// A contact within 5 mm of this share of the surface, whatever the model makes of it.
    Coverage(f64),
    /// No candidate promises more than so many nats: what a robot can decide without the truth. Criteria
    /// in other units promise none, and it never ends so
    /// ([`Criterion::is_in_nats`](super::Criterion::is_in_nats)).
    Gain(f64),
}

impl FromStr for Until {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let expected = "strict, lenient, coverage:SHARE (0 to 1) or gain:NATS";
        let number = |text: &str| text.parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
        match text.split_once(':') {
            None if text == "strict" => Some(Until::Strict),
            None if text == "lenient" => Some(Until::Lenient),
            Some(("coverage", share)) => number(share).filter(|s| *s <= 1.0).map(Until::Coverage),
            Some(("gain", nats)) => number(nats).map(Until::Gain),
            _ => None,
        }
        .ok_or_else(|| format!("expected {expected}, found {text:?}"))
    }
}

impl std::fmt::Display for Until {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Until::Strict => f.write_str("strict"),
            Until::Lenient => f.write_str("lenient"),
            Until::Coverage(share) => write!(f, "coverage:{share}"),
            Until::Gain(nats) => write!(f, "gain:{nats}"),
        }
    }
}

impl Until {
    /// The standard deviation up to which it takes a part of the surface for known, metres.
    pub fn deviation(&self) -> f64 {
        match self {
            Until::Lenient => 2.5e-3,
            Until::Strict | Until::Gain(_) | Until::Coverage(_) => 1.8e-3,
        }
    }

    /// The share of the surface that counts as known, and how much of it must be: the true shape at
    /// `truth` (true object frame to believed object frame). `Gain` looks as `Strict` does and asks
    /// for nothing.
    pub fn known(&self, belief: &Belief, shape: &Geometry, truth: &Pose) -> (f64, f64) {
        self.known_of(belief, &shape.samples(SAMPLES), truth)
    }

    /// The same of a part of the surface, given as points with their normals.
    pub fn known_of(&self, belief: &Belief, part: &[(Point, Point)], truth: &Pose) -> (f64, f64) {
        let points = believed(part, truth);
        let (deviation, error) = match self {
            Until::Coverage(share) => {
                let near =
                    |p: &&Point| belief.contacts.iter().any(|c| (c.point - **p).norm() < 5e-3);
                let count = points.iter().filter(near).count();
                return (count as f64 / points.len().max(1) as f64, *share);
            }
            Until::Strict | Until::Gain(_) => (1.8e-3, 1.8e-3),
            Until::Lenient => (2.5e-3, 3e-3),
        };
        let deviations = belief.surface.deviations(&points);
        let fields = belief.surface.means_and_gradients(&points);
        let known = fields.iter().zip(deviations).filter(|((value, gradient), d)| {
            *d < deviation && value.abs() < error * gradient.norm().max(LEAST_SLOPE)
        });
        let share = if matches!(self, Until::Gain(_)) { f64::INFINITY } else { SHARE };
        (known.count() as f64 / points.len().max(1) as f64, share)
    }
}

/// Share of the believed surface whose standard deviation is at most this, metres: how much the belief
/// itself takes for known.
pub fn believed_share(belief: &Belief, deviation: f64) -> f64 {
    let points: Vec<Point> =
        belief.geometry.samples(SAMPLES / 4).into_iter().map(|s| s.0).collect();
    let known = belief.surface.deviations(&points).into_iter().filter(|d| *d < deviation).count();
    known as f64 / points.len().max(1) as f64
}

/// Points of the true surface in the believed object frame.
fn believed(part: &[(Point, Point)], truth: &Pose) -> Vec<Point> {
    let place = |(p, _): &(Point, Point)| (truth * nalgebra::Point3::from(*p)).coords;
    part.iter().map(place).collect()
}

/// Share of the true surface, of what the belief calls known to 1.8 mm, whose error is within two of
/// the belief's standard deviations: about 95 % where these are honest. `None` where it calls nothing
/// known.
pub fn honesty(belief: &Belief, shape: &Geometry, truth: &Pose) -> Option<f64> {
    let points = believed(&shape.samples(SAMPLES), truth);
    let deviations = belief.surface.deviations(&points);
    let fields = belief.surface.means_and_gradients(&points);
    let (mut within, mut called) = (0, 0);
    for ((value, gradient), deviation) in fields.iter().zip(deviations) {
        if deviation < 1.8e-3 {
            called += 1;
            let error = value.abs() / gradient.norm().max(LEAST_SLOPE);
            within += usize::from(error <= 2.0 * deviation);
        }
    }
    (called > 0).then(|| within as f64 / called as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for text in ["strict", "lenient", "coverage:0.9", "gain:1.5"] {
            assert_eq!(text.parse::<Until>().unwrap().to_string(), text);
        }
        for text in ["", "stric", "coverage:0", "coverage:2", "coverage:nan", "gain:-1", "gain:"] {
            assert!(text.parse::<Until>().is_err(), "{text}");
        }
    }
}
