//! What contacts leave open about a surface, whatever model suits them.
//!
//! Contacts choose a model where they lie; whether it holds beyond them, on sides nobody touched,
//! they cannot say: a ball that fits five touches may be the end of something long, and four flat
//! faces may have a fifth. So the surface that is reported is one of two: with most of the
//! probability the model's, else anything that passes through the contacts, a Gaussian process about a
//! ball of unknown centre and radius. The deviation reported is that of both together about the
//! surface shown, as Bayesian model averaging has it (Hoeting, Madigan, Raftery and Volinsky,
//! Statistical Science 14, 1999), with weights that do not fall with the evidence of the contacts, of
//! which none speaks of what was not touched.

use crate::reference::Gpis;
use crate::space::Point;

/// The other surface that may be, and how likely it is.
#[derive(Clone, Debug)]
pub struct Doubt {
    surface: Gpis,
    share: f64,
}

impl Doubt {
    /// That with probability `share` (0 to 1; anything else counts as the nearer of them, NaN as 1)
    /// the surface is `surface`'s.
    pub fn new(surface: Gpis, share: f64) -> Doubt {
        let share = if share.is_nan() { 1.0 } else { share.clamp(0.0, 1.0) };
        Doubt { surface, share }
    }

    /// Probability that a model which suits `contacts` of an object does not hold beyond them: as if
    /// as many contacts as a ball has unknowns had spoken against it. The rule of succession with
    /// that much belief beforehand.
    pub fn share(dimension: usize, contacts: usize) -> f64 {
        let against = dimension as f64 + 1.0;
        against / (contacts as f64 + against)
    }

    /// Standard deviations along the normal about the surface shown, metres: `points` of it, with the
    /// `deviations` that its own model gives them. The other surface counts by its variance and by
    /// its distance, to first order.
    pub fn widened(&self, points: &[Point], deviations: &[f64]) -> Vec<f64> {
        let variances = self.surface.variances(points);
        let means = self.surface.means_and_gradients(points);
        let other = means.into_iter().zip(variances).map(|((value, gradient), variance)| {
            (variance + value * value) / gradient.norm().max(Gpis::LEAST_GRADIENT).powi(2)
        });
        let both = |(own, other): (&f64, f64)| {
            // What has no weight may be infinite.
            let own = if self.share < 1.0 { (1.0 - self.share) * own * own } else { 0.0 };
            (own + self.share * other).sqrt()
        };
        deviations.iter().zip(other).map(both).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{Contact, Kernel, Prior, Training};

    /// Of three touches on the right half of a circle of 50 mm.
    fn doubt(share: f64) -> Doubt {
        let touch = |i: i32| {
            let (sin, cos) = (0.6 * f64::from(i)).sin_cos();
            let normal = Point::new(cos, sin, 0.0);
            Contact {
                point: 0.05 * normal,
                normal: Some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.09,
            }
        };
        let contacts: Vec<Contact> = (-1..=1).map(touch).collect();
        let kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 };
        let prior = Prior::Ball { centre: Point::zeros(), radius: 0.05 };
        Doubt::new(Gpis::fit(2, kernel, prior, Training::Derivative, &contacts).unwrap(), share)
    }

    #[test]
    fn a_touched_place_stays_certain_and_an_untouched_one_is_not() {
        let points = [Point::new(0.05, 0.0, 0.0), Point::new(-0.05, 0.0, 0.0)];
        let [near, far] = doubt(0.2).widened(&points, &[5e-4; 2])[..] else { panic!() };
        assert!((4e-4..1e-3).contains(&near), "{near}");
        assert!(far > 5e-3, "{far}");
    }

    #[test]
    fn the_share_weighs_the_two_and_a_distance_counts() {
        // 20 mm outside of where the other surface is.
        let point = [Point::new(0.07, 0.0, 0.0)];
        let own = doubt(0.0).widened(&point, &[1e-3])[0];
        assert!((own - 1e-3).abs() < 1e-12);
        let other = doubt(1.0).widened(&point, &[1e-3])[0];
        assert!(other > 0.015, "{other}");
        let half = doubt(0.5).widened(&point, &[1e-3])[0];
        assert!((half * half - 0.5 * (own * own + other * other)).abs() < 1e-12);
        assert_eq!(doubt(f64::NAN).widened(&point, &[1e-3])[0], other);
        assert!(doubt(0.5).widened(&[], &[]).is_empty());
    }

    #[test]
    fn contacts_speak_for_a_model_one_by_one() {
        assert_eq!(Doubt::share(2, 0), 1.0);
        assert_eq!(Doubt::share(2, 3), 0.5);
        assert_eq!(Doubt::share(3, 36), 0.1);
    }
}
