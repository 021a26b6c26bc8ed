//! The local implicit surface: thesis 2.21–2.23, after Ottenhaus, Miller, Schiebener, Vahrenkamp and
//! Asfour, *Local implicit surface estimation for haptic exploration*, Humanoids 2016.
//!
//! Every contact is a plane, yᵢ(p) = nᵢ·(p − cᵢ), that speaks for its surroundings. Between planes
//! that meet convexly the greater speaks, between planes that meet in a hollow the lesser, so that
//! edges and corners stay sharp where a Gaussian process rounds them:
//!
//! F(p) = Σ ωᵢ kᵢ(p) yᵢ(p) βᵢ(p), βᵢ = 1 + sign(yᵢ) β*ᵢ.
//!
//! The thesis leaves ω, k, φ and β* open. Here
//! - ωᵢ = 1/σᵢ², from the contact's point deviation;
//! - kᵢ = (1 + |p − cᵢ|²/ℓ²)⁻² with an ℓ that follows the spacing of the contacts: its tail lets planes
//!   speak where nobody touched, where a squared exponential leaves all to the nearest and grows fins;
//! - bᵢⱼ ∈ (−1, 1) says how contacts i and j meet: t/√(t² + τ²) of t = (nⱼ − nᵢ)·(cⱼ − cᵢ)/|cⱼ − cᵢ|,
//!   positive on a convex, negative on a concave and zero on a flat piece; τ² = 0.1² + (2σ_θ)² of
//!   both normals, and the points' noise in the distance, keep noise from looking like an edge;
//! - φᵢⱼ(p) = ((1 + cos α)/2)⁴, with α the angle, in the tangent plane of i, between the directions to
//!   p and to cⱼ: the neighbours on that side of i count;
//! - β*ᵢ = 0.95 Σⱼ ωⱼ kⱼ (φᵢⱼ + 0.01) bᵢⱼ / (Σⱼ ωⱼ kⱼ (φᵢⱼ + 0.01) + 10⁻⁶ Σ ω k), j over the other
//!   contacts and the last sum over all: near ±1 where the neighbours towards p say edge, and about 0 where
//!   they say flat, so that contacts of one face average their noise, or where i alone speaks.
//!
//! F vanishes on the surface but has slope 1 ± β* beside it. The value reported is
//! f = F / Σ ωᵢ kᵢ (1 + sign(F) β*ᵢ): the same zeros, and slope one at every contact on both sides.
//!
//! f is continuous; its gradient jumps where one of the planes or f changes sign, as it does at a real edge.

use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Insertion, Map, Probe, Surface};

/// β* where all neighbours agree: 1 would leave the surface undecided between planes.
const SHARPNESS: f32 = 0.95;

/// Part of φ that is the same all around.
const ALL_AROUND: f32 = 0.01;

/// Weight of "flat" beside the neighbours: decides where all are too far to matter.
const FLAT: f32 = 1e-6;

/// Least ℓ over the point deviation.
const LEAST_LENGTHSCALE: f32 = 5.0;

/// Within this part of ℓ about a contact its sides blend.
const BLEND: f32 = 0.25;

/// τ² without noise.
const LEAST_TURN: f32 = 0.01;

/// Radius of curvature that must be reckoned with, in ℓ, however flat the contacts look.
const STRAIGHTEST: f32 = 4.0;

/// A contact as plane.
#[derive(Clone, Copy, Debug)]
struct Plane<S: Space> {
    point: S::Vector,
    normal: S::Vector,
    /// σ², square metres, and radians² per axis.
    point_variance: f32,
    normal_variance: f32,
}

impl<S: Space> Plane<S> {
    const UNSET: Self = Plane {
        point: S::Vector::ZERO,
        normal: S::Vector::ZERO,
        point_variance: 0.0,
        normal_variance: 0.0,
    };

    /// bᵢⱼ: how this plane and `other` meet.
    fn meets(&self, other: &Self) -> f32 {
        let apart = other.point - self.point;
        let noise = 4.0 * (self.point_variance + other.point_variance);
        let turn =
            (other.normal - self.normal).dot(apart) / math::sqrt(apart.norm_squared() + noise);
        let doubt = LEAST_TURN + 4.0 * (self.normal_variance + other.normal_variance);
        turn / math::sqrt(turn * turn + doubt)
    }

    /// Direction in the tangent plane towards `other`; zero when that is straight above or below.
    fn towards(&self, other: &Self) -> S::Vector {
        let apart = other.point - self.point;
        let flat = apart - self.normal * self.normal.dot(apart);
        let length2 = flat.norm_squared();
        if length2 > 1e-8 * apart.norm_squared() {
            flat * (1.0 / math::sqrt(length2))
        } else {
            S::Vector::ZERO
        }
    }
}

/// A local implicit surface of at most `CONTACTS` contacts; a probe costs about 40 multiplications
/// and two square roots per pair of them. [`Grid`](super::Grid) makes that a constant.
///
/// Contacts without a normal have no plane and are dropped, as are contacts that are not valid
/// ([`Contact::checked`]). At capacity the two contacts closest to each other (in place, and in
/// normal times ℓ) have one too many: the new one is dropped, or takes the place of the older of
/// two others. Coincident points with opposite normals cancel: f and its gradient are near zero
/// about them. Without contacts nothing is known: value and gradient zero, variance infinite.
///
/// ```
/// use tactile_core::contact::Contact;
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::Planar;
/// use tactile_core::surface::{Local, Map, Surface};
///
/// // Two touches on the top and one on the side of a corner at the origin.
/// let mut corner = Local::<Planar, 8>::new();
/// for (point, normal) in [([-0.03, 0.0], [0.0, 1.0]), ([-0.01, 0.0], [0.0, 1.0]), ([0.0, -0.01], [1.0, 0.0])] {
///     corner.insert(&Contact {
///         point: Vector(point),
///         normal: Some(Vector(normal)),
///         point_deviation: 1e-3,
///         normal_deviation: 0.09,
///         finger: 0,
///     });
/// }
/// corner.refit();
/// assert!(corner.probe(Vector([0.001, 0.001])).value > 0.0);
/// assert!(corner.probe(Vector([-0.001, -0.001])).value < 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct Local<S: Space, const CONTACTS: usize> {
    planes: [Plane<S>; CONTACTS],
    count: usize,
    /// As configured; zero follows the contacts.
    given: f32,
    /// ℓ in force, metres, and the variance of the surface's curvature, per square metre.
    lengthscale: f32,
    curvature: f32,
}

impl<S: Space, const CONTACTS: usize> Local<S, CONTACTS> {
    /// No contacts yet, all zero bits.
    pub const fn new() -> Self {
        Local {
            planes: [Plane::UNSET; CONTACTS],
            count: 0,
            given: 0.0,
            lengthscale: 0.0,
            curvature: 0.0,
        }
    }

    /// Sets ℓ in metres and forgets every contact. `None` (or what is no positive number) is the
    /// default: the root mean squared distance between nearest contacts, at least five point
    /// deviations, found anew by every refit.
    pub fn configure(&mut self, lengthscale: Option<f32>) {
        self.clear();
        self.given = lengthscale.filter(|l| *l > 0.0 && l.is_finite()).unwrap_or(0.0);
    }

    /// ℓ in force, metres: found by the last refit.
    pub fn lengthscale(&self) -> f32 {
        self.lengthscale
    }

    fn planes(&self) -> &[Plane<S>] {
        self.planes.get(..self.count).unwrap_or(&[])
    }

    /// How far apart two contacts are for the capacity policy: square metres.
    fn apart(&self, a: &Plane<S>, b: &Plane<S>) -> f32 {
        let turn = (a.normal - b.normal).norm_squared();
        (a.point - b.point).norm_squared() + self.lengthscale * self.lengthscale * turn
    }

    /// β*ᵢ at `point`, and its gradient, where `shares` are all ω k with their gradients, and `total`
    /// is their sum.
    fn convexity(
        &self,
        number: usize,
        point: S::Vector,
        shares: &[Share<S>; CONTACTS],
        total: &Share<S>,
    ) -> (f32, S::Vector) {
        let Some(own) = self.planes().get(number) else { return (0.0, S::Vector::ZERO) };
        let e = point - own.point;
        let flat = e - own.normal * own.normal.dot(e);
        let blend = BLEND * self.lengthscale;
        let inverse_reach = 1.0 / math::sqrt(flat.norm_squared() + blend * blend);
        let (mut above, mut above_slope) = (0.0, S::Vector::ZERO);
        let (mut below, mut below_slope) = (FLAT * total.weight, total.slope * FLAT);
        for (other, (plane, share)) in self.planes().iter().zip(shares).enumerate() {
            if other == number {
                continue;
            }
            let direction = own.towards(plane);
            let cos = direction.dot(flat) * inverse_reach;
            let half = 0.5 + 0.5 * cos;
            let cube = half * half * half;
            let angular = cube * half + ALL_AROUND;
            let cos_slope = (direction - flat * (cos * inverse_reach)) * inverse_reach;
            let weight = share.weight * angular;
            let slope = share.slope * angular + cos_slope * (2.0 * share.weight * cube);
            let meets = own.meets(plane);
            above += weight * meets;
            above_slope += slope * meets;
            below += weight;
            below_slope += slope;
        }
        let mean = above / below;
        (SHARPNESS * mean, (above_slope - below_slope * mean) * (SHARPNESS / below))
    }
}

/// What ω k of one contact is at a point.
#[derive(Clone, Copy, Debug)]
struct Share<S: Space> {
    weight: f32,
    slope: S::Vector,
}

impl<S: Space> Share<S> {
    const NONE: Self = Share { weight: 0.0, slope: S::Vector::ZERO };
}

impl<S: Space, const CONTACTS: usize> Default for Local<S, CONTACTS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<S: Space, const CONTACTS: usize> Surface<S> for Local<S, CONTACTS> {
    /// Value and gradient as the module says. The variance is the weighted mean of the planes'
    /// σ_p² + σ_θ²d² + κ²d⁴/4 at the distance d from their contacts, and the slope's of
    /// σ_θ² + κ²d²; κ² is measured between nearest contacts and at least (1/4ℓ)².
    fn probe(&self, point: S::Vector) -> Probe<S> {
        let mut nearest: Option<(f32, &Plane<S>)> = None;
        for plane in self.planes() {
            let d2 = (point - plane.point).norm_squared();
            if nearest.is_none_or(|(least, _)| d2 < least) {
                nearest = Some((d2, plane));
            }
        }
        let mut probe = Probe {
            value: 0.0,
            gradient: S::Vector::ZERO,
            variance: f32::INFINITY,
            slope_variance: 1.0,
            nearest: nearest.map_or(f32::INFINITY, |(d2, _)| math::sqrt(d2)),
        };
        let Some((least, near)) = nearest.filter(|_| self.lengthscale > 0.0) else { return probe };

        // A factor common to all weights changes nothing: the nearest contact's k is one everywhere,
        // and what is left of the gradients does not cancel.
        let rate = 1.0 / (self.lengthscale * self.lengthscale);
        let highest = 1.0 + least * rate;
        let fall = |e: S::Vector, height: f32| e * (-4.0 * rate / height);
        let near_fall = fall(point - near.point, highest);
        let mut shares = [Share::<S>::NONE; CONTACTS];
        let mut total = Share::<S>::NONE;
        for (share, plane) in shares.iter_mut().zip(self.planes()) {
            let e = point - plane.point;
            let height = 1.0 + e.norm_squared() * rate;
            let root = highest / height;
            share.weight = root * root / plane.point_variance;
            share.slope = (fall(e, height) - near_fall) * share.weight;
            total.weight += share.weight;
            total.slope += share.slope;
        }

        // F, and the two sums whose sum or difference divides it.
        let (mut field, mut field_slope) = (0.0, S::Vector::ZERO);
        let (mut bent, mut bent_slope) = (0.0, S::Vector::ZERO);
        let mut convexities = [0.0; CONTACTS];
        for (number, (plane, share)) in self.planes().iter().zip(&shares).enumerate() {
            let (convexity, slope) = self.convexity(number, point, &shares, &total);
            convexities[number] = convexity;
            let y = plane.normal.dot(point - plane.point);
            let sign = if y >= 0.0 { 1.0 } else { -1.0 };
            let weighted = y + convexity * sign * y;
            let turned = plane.normal * (1.0 + convexity * sign) + slope * (sign * y);
            field += share.weight * weighted;
            field_slope += share.slope * weighted + turned * share.weight;
            bent += share.weight * convexity;
            bent_slope += share.slope * convexity + slope * share.weight;
        }
        let sign = if field >= 0.0 { 1.0 } else { -1.0 };
        let scale = 1.0 / (total.weight + sign * bent);
        probe.value = field * scale;
        probe.gradient = (field_slope - (total.slope + bent_slope * sign) * probe.value) * scale;

        (probe.variance, probe.slope_variance) = (0.0, 0.0);
        for ((plane, share), convexity) in self.planes().iter().zip(&shares).zip(convexities) {
            let share = share.weight * (1.0 + sign * convexity) * scale;
            let d2 = (point - plane.point).norm_squared();
            let bend = self.curvature * d2;
            probe.slope_variance += share * (plane.normal_variance + bend);
            probe.variance +=
                share * (plane.point_variance + d2 * (plane.normal_variance + 0.25 * bend));
        }
        probe
    }
}

impl<S: Space, const CONTACTS: usize> Map<S> for Local<S, CONTACTS> {
    fn insert(&mut self, contact: &Contact<S>) -> Insertion {
        let Ok(contact) = contact.checked() else { return Insertion::Dropped };
        let Some(normal) = contact.normal else { return Insertion::Dropped };
        let new = Plane {
            point: contact.point,
            normal,
            point_variance: contact.point_deviation * contact.point_deviation,
            normal_variance: contact.normal_deviation * contact.normal_deviation,
        };
        // Deviations so small that their squares vanish would weigh infinitely.
        if !(new.point_variance >= f32::MIN_POSITIVE) {
            return Insertion::Dropped;
        }
        if let Some(free) = self.planes.get_mut(self.count) {
            *free = new;
            self.count += 1;
            return Insertion::Stored;
        }
        let mut least =
            self.planes().iter().map(|p| self.apart(p, &new)).fold(f32::INFINITY, math::min);
        let mut redundant = None;
        for (number, plane) in self.planes().iter().enumerate() {
            for later in self.planes().iter().skip(number + 1) {
                let apart = self.apart(plane, later);
                if apart < least {
                    (least, redundant) = (apart, Some(number));
                }
            }
        }
        let Some(number) = redundant else { return Insertion::Dropped };
        self.planes.copy_within(number + 1.., number);
        if let Some(last) = self.planes.last_mut() {
            *last = new;
        }
        Insertion::Replaced(1)
    }

    /// Finds ℓ and the curvature: n² distances.
    fn refit(&mut self) {
        let (mut spacing, mut noise, mut bent, mut reach) = (0.0, 0.0, 0.0, 0.0);
        for (number, plane) in self.planes().iter().enumerate() {
            noise += plane.point_variance;
            let mut nearest: Option<(f32, &Plane<S>)> = None;
            for (other, neighbour) in self.planes().iter().enumerate() {
                let d2 = (neighbour.point - plane.point).norm_squared();
                if other != number && nearest.is_none_or(|(least, _)| d2 < least) {
                    nearest = Some((d2, neighbour));
                }
            }
            let Some((d2, neighbour)) = nearest else { continue };
            let height = plane.normal.dot(neighbour.point - plane.point);
            let by_noise =
                plane.point_variance + neighbour.point_variance + plane.normal_variance * d2;
            spacing += d2;
            bent += math::max(height * height - by_noise, 0.0);
            reach += d2 * d2;
        }
        if self.count == 0 {
            return;
        }
        let share = 1.0 / self.count as f32;
        self.lengthscale = if self.given > 0.0 {
            self.given
        } else {
            math::max(math::sqrt(spacing * share), LEAST_LENGTHSCALE * math::sqrt(noise * share))
        };
        let least = STRAIGHTEST * self.lengthscale;
        let measured = if reach > f32::MIN_POSITIVE { 4.0 * bent / reach } else { 0.0 };
        self.curvature = math::max(measured, 1.0 / (least * least));
    }

    fn clear(&mut self) {
        self.count = 0;
        (self.lengthscale, self.curvature) = (0.0, 0.0);
    }

    fn contacts(&self) -> usize {
        self.count
    }
}

#[cfg(test)]
mod tests;
