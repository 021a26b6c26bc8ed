//! A convex object as fitted planes: f(p) = maxⱼ (nⱼ·p − ρⱼ).
//!
//! A contact (p, N) with deviations σ_p and σ_θ on the plane (n, ρ) costs
//! (n·p − ρ)²/σ_p² + |N − n|²/σ_θ²: χ² for a small angle between N and n. Summed over a face this
//! depends on the contacts only through additive moments (weight, centroid, scatter, sum of
//! normals), so a face of any number of contacts takes the same memory, two faces are merged
//! by adding, and nothing is linearised. At the least cost ρ = n·centroid, and n solves a trust-region
//! problem on the unit sphere (Moré and Sorensen, *Computing a trust region step*, 1983). Moments are kept
//! about each face's centroid: no frame is special, and single precision suffices for planes of up to 100 000
//! σ_p across, 10 m at 0.1 mm. The cost is what is left of larger numbers: from some 3000 σ_p across it is
//! rounding, which may part a few contacts from their face, and says no more whether that is bent.
//!
//! Contacts join the face whose cost they raise least; faces are merged when their union costs no
//! more than noise would (χ² gate). Convexity is an assumption, so what the contacts say against it is
//! kept: [`Faces::protrusion`].

mod flatness;
mod moments;

use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Insertion, Map, Probe, Surface};
pub(super) use flatness::Evidence;
use moments::{Moments, Witness};

/// Cost above which two faces are not the same plane: χ² with as many degrees of freedom as the
/// space has dimensions exceeds it once in ten thousand.
const GATE: [f32; 2] = [18.4, 21.1];

/// The same for a contact without a normal: one degree of freedom.
const POINT_GATE: f32 = 15.1;

/// Deviations beyond which a contact shows a concavity: once in 30 000 by noise.
const CONCAVE: f32 = 4.0;

/// One plane n·p = ρ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face<S: Space> {
    /// Unit, out of the object (object frame).
    pub normal: S::Vector,
    /// ρ, metres.
    pub offset: f32,
    /// Weighted mean of the contacts, metres: ρ there and the normal are uncorrelated.
    pub centroid: S::Vector,
    /// Variance of ρ at the centroid, square metres.
    pub offset_variance: f32,
    /// Covariance of the normal, radians²: its first rows and columns, zero along the normal.
    pub covariance: [[f32; 3]; 3],
    /// How many contacts it was fitted to; beyond eight thousand a face starts to forget.
    pub contacts: u16,
    /// What these cost: χ² of the face.
    pub cost: f32,
}

impl<S: Space> Face<S> {
    const UNSET: Self = Face {
        normal: S::Vector::ZERO,
        offset: 0.0,
        centroid: S::Vector::ZERO,
        offset_variance: 0.0,
        covariance: [[0.0; 3]; 3],
        contacts: 0,
        cost: 0.0,
    };

    /// n·p − ρ, metres.
    pub fn value(&self, point: S::Vector) -> f32 {
        self.normal.dot(point - self.centroid)
    }

    /// Variance of that, square metres: least at the centroid.
    pub fn variance(&self, point: S::Vector) -> f32 {
        // A covariance that rounding has made indefinite takes no more than half away.
        math::max(self.joint(point, point), 0.5 * self.offset_variance)
    }

    /// Covariance of the values at two points, square metres.
    pub fn joint(&self, a: S::Vector, b: S::Vector) -> f32 {
        let (a, b) = (a - self.centroid, b - self.centroid);
        let mut covariance = self.offset_variance;
        for i in 0..S::DIMENSION {
            for j in 0..S::DIMENSION {
                covariance += a[i] * self.covariance[i][j] * b[j];
            }
        }
        covariance
    }
}

/// At most `FACES` planes, learnt one contact at a time; 16 take 2.9 kB in space.
///
/// ```
/// use tactile_core::contact::Contact;
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::Planar;
/// use tactile_core::surface::{Faces, Map, Surface};
///
/// // Two touches on each side of a square of 40 mm.
/// let mut square = Faces::<Planar, 8>::new();
/// for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
///     for along in [-0.01, 0.01] {
///         square.insert(&Contact {
///             point: Vector([0.02 * x - along * y, 0.02 * y + along * x]),
///             normal: Some(Vector([x, y])),
///             point_deviation: 1e-3,
///             normal_deviation: 0.09,
///             finger: 0,
///         });
///     }
/// }
/// assert_eq!(square.faces().len(), 4);
/// assert!(square.is_convex());
/// assert!((square.probe(Vector([0.025, 0.0])).value - 0.005).abs() < 1e-6);
/// ```
#[derive(Clone, Debug)]
pub struct Faces<S: Space, const FACES: usize> {
    moments: [Moments<S>; FACES],
    faces: [Face<S>; FACES],
    count: usize,
    refused: u32,
}

impl<S: Space, const FACES: usize> Faces<S, FACES> {
    /// No faces yet.
    pub const fn new() -> Self {
        Faces { moments: [Moments::NONE; FACES], faces: [Face::UNSET; FACES], count: 0, refused: 0 }
    }

    /// The planes, in no particular order.
    pub fn faces(&self) -> &[Face<S>] {
        self.faces.get(..self.count).unwrap_or(&[])
    }

    /// Sum of the faces' costs: χ² of the fit. On flat faces its expectation is
    /// [`degrees`](Self::degrees); a quotient above about 1.4 says that the object has none.
    pub fn chi_squared(&self) -> f32 {
        self.faces().iter().map(|f| f.cost).sum()
    }

    /// Numbers measured less numbers fitted.
    pub fn degrees(&self) -> u32 {
        let held = self.moments.iter().take(self.count);
        let measured: u32 = held.map(|m| u32::from(m.measured)).sum();
        measured.saturating_sub((self.count * S::DIMENSION) as u32)
    }

    /// The worst contradiction to convexity, in standard deviations: how far a contact that a face
    /// remembers, or its centroid, lies outside another face. A face remembers its two ends.
    pub fn protrusion(&self) -> f32 {
        let mut worst: f32 = 0.0;
        for (number, owner) in self.moments.iter().take(self.count).enumerate() {
            let centre = Witness { point: owner.centroid, variance: 1.0 / owner.weight };
            for witness in [centre, owner.ends[0], owner.ends[1]] {
                for (other, face) in self.faces().iter().enumerate() {
                    if other != number {
                        let variance = face.variance(witness.point) + witness.variance;
                        worst = worst.max(face.value(witness.point) / math::sqrt(variance));
                    }
                }
            }
        }
        worst
    }

    /// Whether no contact contradicts a convex object and none was refused for lack of room: where
    /// this is false, the maximum over the faces hides a hollow or a side.
    pub fn is_convex(&self) -> bool {
        self.refused == 0 && self.protrusion() < CONCAVE
    }

    /// Contacts that no face explains and for which there was no room.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// What adding `moments` to a face `among` some raises the cost by at least, that face's number, and
    /// the plane of the union.
    fn cheapest(
        &self,
        moments: &Moments<S>,
        among: impl Fn(usize) -> bool,
    ) -> Option<(f32, usize, Face<S>)> {
        let own = moments.fit().map_or(0.0, |f| f.cost);
        let mut best: Option<(f32, usize, Face<S>)> = None;
        for (number, (held, face)) in self.moments.iter().zip(self.faces()).enumerate() {
            if !among(number) {
                continue;
            }
            let Some(union) = held.plus(moments).fit() else { continue };
            let rise = union.cost - face.cost - own;
            if best.is_none_or(|(least, ..)| rise < least) {
                best = Some((rise, number, union));
            }
        }
        best
    }

    /// [`Map::insert`], and the number of the face that has the contact now.
    pub(super) fn learn(&mut self, contact: &Contact<S>) -> (Insertion, Option<usize>) {
        let dropped = (Insertion::Dropped, None);
        let Ok(contact) = contact.checked() else { return dropped };
        let moments = Moments::of(&contact);
        let gate = match contact.normal {
            Some(_) => GATE[S::DIMENSION.clamp(2, 3) - 2],
            None => POINT_GATE,
        };
        // Faces that truncate a body come first: else one that a wild contact opened beside such a face
        // would grow by what is that face's.
        let settled = self.cheapest(&moments, |number| self.cuts(number));
        let best = settled.filter(|(rise, ..)| *rise < gate);
        match best.or_else(|| self.cheapest(&moments, |number| !self.cuts(number))) {
            Some((rise, number, union)) if rise < gate => {
                let Some(held) = self.moments.get(number) else { return dropped };
                let all = held.plus(&moments);
                let faded = all.faded();
                let face = if faded.contacts < all.contacts { faded.fit() } else { Some(union) };
                self.set(number, faded, face.unwrap_or(union));
                return (Insertion::Stored, Some(self.settle(number)));
            }
            _ => {}
        }
        let Some(face) = moments.fit() else { return dropped };
        if self.count < FACES {
            self.set(self.count, moments, face);
            self.count += 1;
            return (Insertion::Stored, Some(self.count - 1));
        }
        match self.faces().iter().position(|f| f.contacts == 1) {
            Some(number) => {
                self.set(number, moments, face);
                (Insertion::Replaced(1), Some(number))
            }
            None => {
                self.refused = self.refused.saturating_add(1);
                dropped
            }
        }
    }

    fn set(&mut self, number: usize, moments: Moments<S>, face: Face<S>) {
        if let (Some(m), Some(f)) = (self.moments.get_mut(number), self.faces.get_mut(number)) {
            (*m, *f) = (moments, face);
        }
    }

    fn remove(&mut self, number: usize) {
        let last = self.count.saturating_sub(1);
        if let (Some(m), Some(f)) = (self.moments.get(last), self.faces.get(last)) {
            let (m, f) = (*m, *f);
            self.set(number, m, f);
            self.count = last;
        }
    }

    /// Merges face `number` with others that now agree with it; its number then.
    fn settle(&mut self, mut number: usize) -> usize {
        let gate = GATE[S::DIMENSION.clamp(2, 3) - 2];
        for _ in 0..FACES {
            let Some(changed) = self.moments.get(number).copied() else { return number };
            let Some((rise, other, union)) = self.cheapest(&changed, |other| other != number)
            else {
                return number;
            };
            let Some(kept) = self.moments.get(other).copied() else { return number };
            if !(rise < gate) {
                return number;
            }
            self.set(other, kept.plus(&changed), union);
            self.remove(number);
            // Removing moved the last face into the gap.
            number = if other == self.count { number } else { other };
        }
        number
    }
}

impl<S: Space, const FACES: usize> Default for Faces<S, FACES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<S: Space, const FACES: usize> Map<S> for Faces<S, FACES> {
    /// A contact that no face explains opens one. At capacity it takes the place of a face that a
    /// single contact opened; when every face has more, it is dropped and counted as
    /// [`refused`](Faces::refused). A contact without a normal opens no face. Contacts that are not
    /// valid ([`Contact::checked`]) are dropped.
    fn insert(&mut self, contact: &Contact<S>) -> Insertion {
        self.learn(contact).0
    }

    /// Nothing to do: faces are up to date after every contact.
    fn refit(&mut self) {}

    fn clear(&mut self) {
        *self = Self::new();
    }

    fn contacts(&self) -> usize {
        self.faces().iter().map(|f| usize::from(f.contacts)).sum()
    }
}

impl<S: Space, const FACES: usize> Surface<S> for Faces<S, FACES> {
    /// Value, gradient and variances of the face that attains the maximum. `nearest` is the distance
    /// to the nearest contact that a face remembers: its two ends or its centroid. Without faces
    /// nothing is known: value and gradient zero, variance infinite.
    fn probe(&self, point: S::Vector) -> Probe<S> {
        let mut probe = Probe {
            value: 0.0,
            gradient: S::Vector::ZERO,
            variance: f32::INFINITY,
            slope_variance: 1.0,
            nearest: f32::INFINITY,
        };
        let mut active: Option<(f32, &Face<S>)> = None;
        for (face, moments) in self.faces().iter().zip(&self.moments) {
            let value = face.value(point);
            if active.is_none_or(|(most, _)| value > most) {
                active = Some((value, face));
            }
            for known in [moments.centroid, moments.ends[0].point, moments.ends[1].point] {
                probe.nearest = probe.nearest.min((point - known).norm());
            }
        }
        if let Some((value, face)) = active {
            let trace: f32 = (0..S::DIMENSION).map(|i| face.covariance[i][i]).sum();
            probe.value = value;
            probe.gradient = face.normal;
            probe.variance = face.variance(point);
            probe.slope_variance = math::max(trace, 0.0) / S::DIMENSION as f32;
        }
        probe
    }
}

#[cfg(test)]
mod tests;
