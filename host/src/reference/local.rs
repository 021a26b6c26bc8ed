//! The local implicit surface: thesis 2.21–2.23, after Ottenhaus, Miller, Schiebener, Vahrenkamp and
//! Asfour, *Local implicit surface estimation for haptic exploration*, Humanoids 2016.
//!
//! Contacts are planes yᵢ(p) = nᵢ·(p − cᵢ), blended: F = Σ ωᵢ kᵢ yᵢ βᵢ with βᵢ = 1 + sign(yᵢ) β*ᵢ. Where
//! neighbouring contacts meet convexly, β* near one lets the greatest plane speak, in a hollow β*
//! near minus one the least, so that edges and corners stay sharp; on a face, β* near zero averages
//! noise. What the thesis leaves open is decided thus:
//!
//! - ωᵢ = 1/σ_p², kᵢ = (1 + |p − cᵢ|²/ℓ²)⁻², ℓ from the spacing of the contacts;
//! - bᵢⱼ = t/√(t² + τ²) with t = (nⱼ − nᵢ)·(cⱼ − cᵢ)/√(|cⱼ − cᵢ|² + 4(σ_p² + σ_p²)) says how i and j meet,
//!   in units of what noise could feign: τ² = 0.1² + 4(σ_θ² + σ_θ²), variances of both;
//! - φᵢⱼ(p) = ((1 + cos α)/2)⁴, α between the directions from cᵢ to p and to cⱼ within the tangent plane
//!   at cᵢ; within ℓ/4 of cᵢ cos α goes to zero;
//! - β*ᵢ = 0.95 Σ kⱼ(φᵢⱼ + 0.01) bᵢⱼ / (Σ kⱼ(φᵢⱼ + 0.01) + 10⁻⁶ Σ kⱼ), the last sum over all contacts,
//!   the others over j ≠ i; k includes ω;
//! - f = F / Σ ωᵢ kᵢ (1 + sign(F) β*ᵢ): the zeros of F, with slope one at every contact.

use rayon::prelude::*;

use super::Contact;
use super::gpis::Error;
use crate::shape::Field;
use crate::space::Point;

/// β* where all neighbours agree.
const SHARPNESS: f64 = 0.95;

/// Weights below this part of the greatest change nothing.
const NEGLIGIBLE: f64 = 1e-13;

/// How one contact sees another.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// b: 1 convex, −1 concave.
    meets: f64,
    /// Unit, in the tangent plane of the first; zero when the second is straight above or below.
    towards: Point,
}

/// The surface of contacts in the object frame.
#[derive(Clone, Debug)]
pub struct Local {
    dimension: usize,
    /// Those with normals.
    contacts: Vec<Contact>,
    /// Row by row.
    pairs: Vec<Pair>,
    lengthscale: f64,
    curvature: f64,
}

/// Value and variance at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalEvaluation {
    /// f, metres.
    pub value: f64,
    /// Weighted mean of σ_p² + σ_θ²d² + κ²d⁴/4 over the contacts, d metres away: m².
    pub variance: f64,
    /// Weighted mean of σ_θ² + κ²d².
    pub slope_variance: f64,
}

impl Local {
    /// Most contacts: pairs are kept.
    pub const MOST_CONTACTS: usize = 3000;

    /// The surface of `contacts`; those without a normal have no plane and are left out. ℓ is
    /// `lengthscale` (metres) or the root mean squared distance between nearest contacts, at least
    /// five point deviations. Without contacts f is zero and its deviation infinite.
    ///
    /// # Errors
    /// When a number is unusable or there are too many contacts.
    pub fn fit(
        dimension: usize,
        lengthscale: Option<f64>,
        contacts: &[Contact],
    ) -> Result<Self, Error> {
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        if let Some(value) = lengthscale
            && !(value > 0.0 && value.is_finite())
        {
            return Err(Error::Parameter { name: "lengthscale", value });
        }
        for (index, contact) in contacts.iter().enumerate() {
            contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
        }
        let contacts: Vec<Contact> = contacts
            .iter()
            .filter_map(|c| Some(Contact { normal: Some(c.normal?.normalize()), ..*c }))
            .collect();
        if contacts.len() > Self::MOST_CONTACTS {
            return Err(Error::TooLarge { rows: contacts.len() });
        }
        let pairs = contacts.iter().flat_map(|a| contacts.iter().map(|b| pair(a, b))).collect();

        // Nearest neighbours: spacing, and how far the surface bends away from a plane up to there.
        let (mut spacing, mut bent, mut reach) = (0.0, 0.0, 0.0);
        for (i, a) in contacts.iter().enumerate() {
            let others = contacts.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, b)| b);
            let far = |b: &Contact| (b.point - a.point).norm_squared();
            let Some(b) = others.min_by(|b, c| far(b).total_cmp(&far(c))) else { continue };
            let square = far(b);
            let height = normal(a).dot(&(b.point - a.point));
            let noise = a.point_deviation.powi(2)
                + b.point_deviation.powi(2)
                + a.normal_deviation.powi(2) * square;
            spacing += square;
            bent += (height * height - noise).max(0.0);
            reach += square * square;
        }
        let count = contacts.len().max(1) as f64;
        let noise = contacts.iter().map(|c| c.point_deviation.powi(2)).sum::<f64>() / count;
        let lengthscale = lengthscale.unwrap_or((spacing / count).sqrt().max(5.0 * noise.sqrt()));
        let measured = if reach > 0.0 { 4.0 * bent / reach } else { 0.0 };
        let curvature = measured.max((4.0 * lengthscale).powi(-2));
        Ok(Local { dimension, contacts, pairs, lengthscale, curvature })
    }

    /// ℓ, metres.
    pub fn lengthscale(&self) -> f64 {
        self.lengthscale
    }

    /// Everything at each point.
    pub fn evaluate(&self, points: &[Point]) -> Vec<LocalEvaluation> {
        points.par_iter().with_min_len(64).map(|p| self.at(p)).collect()
    }

    fn at(&self, p: &Point) -> LocalEvaluation {
        let p = if self.dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p };
        let distance = |c: &Contact| (p - c.point).norm_squared();
        let nearest = self.contacts.iter().map(distance).fold(f64::INFINITY, f64::min);
        let q = 1.0 / (self.lengthscale * self.lengthscale);
        // A common factor changes nothing: the nearest contact's k is one.
        let near: Vec<(usize, f64)> = self
            .contacts
            .iter()
            .enumerate()
            .map(|(i, c)| {
                let k = ((1.0 + nearest * q) / (1.0 + distance(c) * q)).powi(2);
                (i, k / c.point_deviation.powi(2))
            })
            .collect();
        let total: f64 = near.iter().map(|n| n.1).sum();
        let near: Vec<(usize, f64)> =
            near.into_iter().filter(|n| n.1 > NEGLIGIBLE * total).collect();
        if near.is_empty() {
            return LocalEvaluation { value: 0.0, variance: f64::INFINITY, slope_variance: 1.0 };
        }

        let convexities: Vec<f64> =
            near.iter().map(|&(i, _)| self.convexity(i, &p, &near, total)).collect();
        let both = || near.iter().zip(&convexities);
        let field: f64 = both()
            .map(|(&(i, weight), convexity)| {
                let y = normal(&self.contacts[i]).dot(&(p - self.contacts[i].point));
                weight * y * (1.0 + y.signum() * convexity)
            })
            .sum();
        let shares: Vec<f64> =
            both().map(|((_, weight), c)| weight * (1.0 + field.signum() * c)).collect();
        let scale: f64 = shares.iter().sum();
        let (mut variance, mut slope_variance) = (0.0, 0.0);
        for (&(i, _), share) in near.iter().zip(&shares) {
            let contact = &self.contacts[i];
            let square = distance(contact);
            let turn = contact.normal_deviation.powi(2);
            variance += share / scale
                * (contact.point_deviation.powi(2)
                    + turn * square
                    + 0.25 * self.curvature * square * square);
            slope_variance += share / scale * (turn + self.curvature * square);
        }
        LocalEvaluation { value: field / scale, variance, slope_variance }
    }

    /// β*ᵢ at `p`, among contacts of the given weights.
    fn convexity(&self, i: usize, p: &Point, near: &[(usize, f64)], total: f64) -> f64 {
        let own = &self.contacts[i];
        let e = p - own.point;
        let flat = e - normal(own) * normal(own).dot(&e);
        let reach = flat.norm().hypot(0.25 * self.lengthscale);
        let (mut above, mut below) = (0.0, 1e-6 * total);
        for &(j, weight) in near {
            if j != i {
                let Pair { meets, towards } = self.pairs[i * self.contacts.len() + j];
                let angular = (0.5 + 0.5 * towards.dot(&flat) / reach).powi(4);
                above += weight * (angular + 0.01) * meets;
                below += weight * (angular + 0.01);
            }
        }
        SHARPNESS * above / below
    }
}

impl Field for Local {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.evaluate(points).into_iter().map(|e| e.value).collect()
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        self.evaluate(points).into_iter().map(|e| e.variance.sqrt()).collect()
    }
}

/// Only contacts with normals are kept.
fn normal(contact: &Contact) -> Point {
    contact.normal.unwrap_or_else(Point::zeros)
}

fn pair(a: &Contact, b: &Contact) -> Pair {
    let apart = b.point - a.point;
    let variance = |f: fn(&Contact) -> f64| f(a).powi(2) + f(b).powi(2);
    let length = (apart.norm_squared() + 4.0 * variance(|c| c.point_deviation)).sqrt();
    let turn = (normal(b) - normal(a)).dot(&apart) / length;
    let doubt = (0.01 + 4.0 * variance(|c| c.normal_deviation)).sqrt();
    let flat = apart - normal(a) * normal(a).dot(&apart);
    Pair {
        meets: turn / turn.hypot(doubt),
        towards: flat.try_normalize(1e-4 * apart.norm()).unwrap_or_else(Point::zeros),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Gpis, Kernel, Prior, Training};
    use super::*;
    use crate::shape::contour;

    fn touch(x: f64, y: f64, normal: Point) -> Contact {
        Contact {
            point: Point::new(x, y, 0.0),
            normal: Some(normal),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    }

    /// The four corners of a square of 80 mm that the outline comes no nearer to, metres.
    fn roundness(field: &dyn Field) -> f64 {
        let bounds = (Point::new(-0.06, -0.06, 0.0), Point::new(0.06, 0.06, 0.0));
        let outline = contour::extract(field, bounds, 0.001).unwrap().outline;
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let gaps = corners.map(|(x, y)| outline.distance(&Point::new(0.04 * x, 0.04 * y, 0.0)));
        gaps.into_iter().fold(0.0, f64::max)
    }

    #[test]
    fn a_square_keeps_its_corners_where_the_gp_rounds_them() {
        // Two contacts on each side, none nearer to a corner than 15 mm.
        let mut contacts = Vec::new();
        for s in [-0.04, 0.04] {
            for t in [-0.025, 0.015] {
                contacts.push(touch(s, t, Point::x() * f64::signum(s)));
                contacts.push(touch(t, s, Point::y() * f64::signum(s)));
            }
        }
        let local = Local::fit(2, None, &contacts).unwrap();
        let sharp = roundness(&local);
        assert!(sharp < 1.5e-3, "{sharp}");
        for (kernel, training) in [
            (Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 }, Training::Derivative),
            (
                Kernel::SquaredExponential { amplitude: 0.03, lengthscale: 0.04 },
                Training::OffSurface { distance: 0.01 },
            ),
        ] {
            let prior = Prior::fitted(&contacts).unwrap();
            let gp = roundness(&Gpis::fit(2, kernel, prior, training, &contacts).unwrap());
            assert!(gp > 2.0 * sharp, "{gp} against {sharp}");
        }
    }

    #[test]
    fn unusable_input_is_named() {
        let good = touch(0.0, 0.0, Point::x());
        assert_eq!(Local::fit(4, None, &[]).unwrap_err(), Error::Dimension(4));
        assert!(Local::fit(2, Some(0.0), &[good]).unwrap_err().to_string().contains("lengthscale"));
        let bad = Contact { point: Point::new(f64::NAN, 0.0, 0.0), ..good };
        assert!(
            Local::fit(2, None, &[good, bad]).unwrap_err().to_string().starts_with("contact 1")
        );
        let empty = Local::fit(3, None, &[Contact { normal: None, ..good }]).unwrap();
        let e = empty.evaluate(&[Point::x()])[0];
        assert!(e.value == 0.0 && e.variance.is_infinite());
        // Coincident points with opposite normals cancel.
        let thin = Local::fit(2, None, &[good, touch(0.0, 0.0, -Point::x())]).unwrap();
        assert!(thin.values(&[Point::new(0.01, 0.0, 0.0)])[0].abs() < 1e-12);
        let twice = Local::fit(2, None, &[good; 3]).unwrap();
        assert!((twice.values(&[Point::new(0.01, 0.3, 0.0)])[0] - 0.01).abs() < 1e-12);
    }
}
