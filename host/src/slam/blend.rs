//! Several surfaces of the same contacts as one, each with its probability.

use crate::reference::Gpis;
use crate::shape::Field;
use crate::space::Point;

/// The mean of the fields of several Gaussian processes, weighted by how probable they are (Bayesian
/// model averaging; Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999). Where they
/// disagree, what the blend shows lies between them, and is as uncertain as they are apart.
#[derive(Clone, Debug)]
pub struct Blend {
    /// With weights that add up to 1.
    parts: Vec<(f64, Gpis)>,
}

impl Blend {
    /// Of surfaces and their weights, positive numbers up to a common factor.
    pub fn new(parts: Vec<(f64, Gpis)>) -> Blend {
        let all: f64 = parts.iter().map(|(weight, _)| weight).sum();
        Blend { parts: parts.into_iter().map(|(weight, part)| (weight / all, part)).collect() }
    }
}

impl Field for Blend {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        let mut mean = vec![0.0; points.len()];
        for (weight, part) in &self.parts {
            for (sum, value) in mean.iter_mut().zip(part.values(points)) {
                *sum += weight * value;
            }
        }
        mean
    }

    /// What the parts leave open, and how far they are apart: fields are distances near the surface.
    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        if let [(_, alone)] = &self.parts[..] {
            return alone.deviations(points);
        }
        let mean = self.values(points);
        let mut variances = vec![0.0; points.len()];
        for (weight, part) in &self.parts {
            let own = part.values(points).into_iter().zip(part.deviations(points));
            for ((sum, mean), (value, deviation)) in variances.iter_mut().zip(&mean).zip(own) {
                *sum += weight * (deviation.powi(2) + (value - mean).powi(2));
            }
        }
        variances.into_iter().map(f64::sqrt).collect()
    }

    fn first_order(&self, points: &[Point], step: f64) -> Vec<(f64, Point)> {
        let mut mean = vec![(0.0, Point::zeros()); points.len()];
        for (weight, part) in &self.parts {
            for (sum, (value, gradient)) in mean.iter_mut().zip(part.first_order(points, step)) {
                sum.0 += weight * value;
                sum.1 += gradient * *weight;
            }
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{Contact, Kernel, Prior, Training};

    /// About a ball of so many metres, felt at the right.
    fn about(radius: f64) -> Gpis {
        let contact = Contact {
            point: Point::new(0.04, 0.0, 0.0),
            normal: Some(Point::x()),
            point_deviation: 1e-3,
            normal_deviation: 0.05,
        };
        let kernel = Kernel::Matern32 { amplitude: 0.01, lengthscale: 0.03 };
        let ball = Prior::Ball { centre: Point::new(0.04 - radius, 0.0, 0.0), radius };
        Gpis::fit(2, kernel, ball, Training::Derivative, &[contact]).unwrap()
    }

    #[test]
    fn what_parts_agree_on_is_certain_and_the_rest_as_uncertain_as_they_differ() {
        let (small, large) = (about(0.04), about(0.06));
        let blend = Blend::new(vec![(1.0, small.clone()), (3.0, large.clone())]);
        // At the contact, and across from it, where one ends 8 cm away and the other 12 cm.
        let points = [Point::new(0.04, 0.0, 0.0), Point::new(-0.07, 0.0, 0.0)];
        let (values, deviations) = (blend.values(&points), blend.deviations(&points));
        let (a, b) = (small.values(&points), large.values(&points));
        for i in 0..2 {
            assert!((values[i] - (0.25 * a[i] + 0.75 * b[i])).abs() < 1e-15);
        }
        assert!(deviations[0] < 1.1e-3, "{deviations:?}");
        // Apart by √(w (1 − w)) of what is between them, and open by the parts' own deviations.
        let apart = (a[1] - b[1]).abs() * (0.25f64 * 0.75).sqrt();
        let (own_a, own_b) = (small.deviations(&points)[1], large.deviations(&points)[1]);
        let expected = (apart.powi(2) + 0.25 * own_a.powi(2) + 0.75 * own_b.powi(2)).sqrt();
        assert!(apart > 0.01 && (deviations[1] - expected).abs() < 1e-12, "{deviations:?}");
    }

    #[test]
    fn gradients_are_those_of_its_values() {
        let blend = Blend::new(vec![(2.0, about(0.04)), (1.0, about(0.06))]);
        let point = Point::new(0.01, 0.035, 0.0);
        let (value, gradient) = blend.first_order(&[point], 1e-6)[0];
        assert!((value - blend.values(&[point])[0]).abs() < 1e-12);
        for axis in [Point::x(), Point::y()] {
            let ends = blend.values(&[point + axis * 1e-6, point - axis * 1e-6]);
            assert!((gradient.dot(&axis) - (ends[0] - ends[1]) / 2e-6).abs() < 1e-6);
        }
    }
}
