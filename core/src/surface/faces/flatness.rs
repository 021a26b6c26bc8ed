//! What a face's contacts say about its being one: whether it is flat, and outermost.

use super::moments::{Moments, Symmetric, Witness};
use super::{Face, Faces, GATE};
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;

/// Contacts before a face is judged.
const FEWEST: u16 = 8;

/// Deviations by which χ² and the turning of normals may differ from those of a flat face: to be
/// called flat, and to be called so no more. With 1.5 most flat faces of eight contacts are found, and
/// few bent ones.
const FLAT: f32 = 1.5;
const BENT: f32 = 3.5;

/// As many degrees of freedom as χ² is believed of: noise 14 % larger than said bends no face, however
/// many contacts there are.
const BELIEVED: f32 = 256.0;

/// A bulge below this part of a contact's deviation bends no face either.
const BULGE: f32 = 0.1;

/// Deviations beyond which something lies outside a face: never by noise.
const OUTSIDE: f32 = 6.0;

/// χ² beyond which a contact cannot be a face's, in gates: never by noise.
const WILD: f32 = 2.0;

/// Contacts of a face of which one may be wild.
const WILD_EVERY: u16 = 1000;

/// Part of a number that single precision does not tell.
const ROUNDING: f32 = 1e-6;

/// Square of the deviations along each axis of a face within which contacts lie that are spread evenly.
const EXTENT: f32 = 3.0;

/// Contacts that say together what a face's moments do.
const SUMMARY: usize = 4;

/// See [`Faces::evidence`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::surface) enum Evidence {
    Flat,
    /// Undecided.
    Open,
    Bent,
}

impl<S: Space> Moments<S> {
    /// How normals turn with the place: along each principal axis e of the contacts, Σ (a·e)(N·e)/σ_θ²
    /// over its standard deviation is N(0, 1) on a flat face, positive on a convex one. The sum
    /// over the axes is the trace of A^(−½) T, with A = Σ a aᵀ/σ_θ² and T = Σ a Nᵀ/σ_θ² among the
    /// tangents; √axes is taken off, so that this is N(0, 1), too. Both noises are taken as
    /// proportional to each other.
    fn bending(&self, normal: S::Vector) -> f32 {
        let [u, v] = S::tangents(normal);
        let ratio = self.normal_weight / self.weight;
        let (a, t) = (ratio * product::<S>(&self.scatter, u, u), product::<S>(&self.turns, u, u));
        if S::DIMENSION < 3 {
            return if a > 0.0 { t / math::sqrt(a) } else { 0.0 };
        }
        let b = ratio * product::<S>(&self.scatter, u, v);
        let c = ratio * product::<S>(&self.scatter, v, v);
        let across = product::<S>(&self.turns, u, v) + product::<S>(&self.turns, v, u);
        let d = product::<S>(&self.turns, v, v);
        let square = a * c - b * b;
        if !(square > 1e-6 * (a + c) * (a + c)) {
            return if a + c > 0.0 { (t + d) / math::sqrt(a + c) } else { 0.0 };
        }
        let s = math::sqrt(square);
        let turned = (c + s) * t - b * across + (a + s) * d;
        turned / (s * math::sqrt(2.0 * (a + c + 2.0 * s)))
    }

    /// Variance of the contacts along two tangents, square metres.
    fn spread(&self, [u, v]: [S::Vector; 2]) -> Spread {
        let along = |a, b| product::<S>(&self.scatter, a, b) / self.weight;
        (along(u, u), along(v, v), along(u, v))
    }

    /// How far a point is beyond the contacts along the face: the part of its way from their centroid
    /// that is outside the ellipse of [`EXTENT`] deviations.
    fn beyond(&self, normal: S::Vector, point: S::Vector) -> f32 {
        let tangents = S::tangents(normal);
        let axes = S::DIMENSION - 1;
        let (a, b, c) = self.spread(tangents);
        let way = point - self.centroid;
        let [x, y] = tangents.map(|t| way.dot(t));
        let square = if axes == 1 {
            x * x / a
        } else {
            (x * x * b - 2.0 * x * y * c + y * y * a) / (a * b - c * c)
        };
        // Of contacts in one place, or in a line, the rest of the face is beyond.
        let within = EXTENT * axes as f32 / square;
        let within = if within > 0.0 { math::sqrt(math::min(within, 1.0)) } else { 0.0 };
        math::sqrt(x * x + y * y) * (1.0 - within)
    }

    /// How far a face that bends by so many deviations rises over the distance over which its contacts
    /// are spread, in deviations of a contact.
    fn bulge(&self, bending: f32) -> f32 {
        let mut spread = 0.0;
        for i in 0..S::DIMENSION {
            spread += self.scatter[i][i];
        }
        // Each normal says so much about a slope at an arm √(spread/weight); half the slope times the
        // arm is the rise, √(contacts/weight) a contact's deviation.
        let rise = 0.5 * bending * math::sqrt(spread / (self.weight * self.normal_weight));
        rise * math::sqrt(self.weight / f32::from(self.contacts))
    }
}

/// A symmetric matrix of two rows: its diagonal, and what is beside it.
type Spread = (f32, f32, f32);

/// aᵀ M b.
fn product<S: Space>(m: &Symmetric, a: S::Vector, b: S::Vector) -> f32 {
    let mut sum = 0.0;
    for i in 0..S::DIMENSION {
        for j in 0..S::DIMENSION {
            sum += a[i] * m[i][j] * b[j];
        }
    }
    sum
}

fn gate<S: Space>() -> f32 {
    GATE[S::DIMENSION.clamp(2, 3) - 2]
}

/// χ² of a contact on a face that has not got it.
fn misfit<S: Space>(face: &Face<S>, contact: &Contact<S>) -> f32 {
    let value = face.value(contact.point);
    let place = face.variance(contact.point)
        + contact.point_deviation * contact.point_deviation
        + ROUNDING * ROUNDING * contact.point.norm_squared();
    let turn = contact.normal.map_or(0.0, |n| (n - face.normal).norm_squared());
    let direction = contact.normal_deviation * contact.normal_deviation + ROUNDING * ROUNDING;
    value * value / place + turn / direction
}

impl<S: Space, const FACES: usize> Faces<S, FACES> {
    /// Where there is no room for another face, forgets one of a single contact, else the bent one of the
    /// fewest contacts.
    pub(in crate::surface) fn make_room(&mut self) {
        if self.count < FACES {
            return;
        }
        let contacts = |number: usize| self.moments.get(number).map_or(0, |m| m.contacts);
        let is_spare = |&number: &usize| {
            let is_bent = self.evidence(number) == Evidence::Bent;
            !self.cuts(number) && (contacts(number) == 1 || is_bent)
        };
        if let Some(number) = (0..self.count).filter(is_spare).min_by_key(|n| contacts(*n)) {
            self.remove(number);
        }
    }

    /// What the contacts of a face say about its being flat: χ², which grows with any bend, the turning
    /// of normals, and both together.
    pub(in crate::surface) fn evidence(&self, number: usize) -> Evidence {
        let (Some(moments), Some(face)) = (self.moments.get(number), self.faces().get(number))
        else {
            return Evidence::Open;
        };
        let degrees = f32::from(moments.measured) - S::DIMENSION as f32;
        if !(degrees > 0.0) {
            return Evidence::Open;
        }
        let believed = math::sqrt(0.5 * math::min(degrees, BELIEVED));
        let excess = (face.cost / degrees - 1.0) * believed;
        let bending = moments.bending(face.normal).abs();
        let worst = |bending: f32| {
            let both = core::f32::consts::FRAC_1_SQRT_2 * (excess + bending);
            math::max(math::max(excess, bending), both)
        };
        let bulging = if moments.bulge(bending) < BULGE { 0.0 } else { bending };
        if moments.contacts >= FEWEST && worst(bending) < FLAT {
            Evidence::Flat
        } else if worst(bulging) < BENT {
            Evidence::Open
        } else {
            Evidence::Bent
        }
    }

    /// Faces that truncate a body, with their numbers.
    pub(in crate::surface) fn cutting(&self) -> impl Iterator<Item = (usize, &Face<S>)> + Clone {
        let numbered = self.faces().iter().zip(&self.moments).enumerate();
        numbered.filter(|(_, (_, m))| m.cuts).map(|(number, (face, _))| (number, face))
    }

    /// The two contacts farthest apart of each of them.
    pub(in crate::surface) fn ends(&self) -> impl Iterator<Item = S::Vector> + Clone + '_ {
        let cutting = self.moments.iter().take(self.count).filter(|m| m.cuts);
        cutting.flat_map(|m| m.ends.map(|end| end.point))
    }

    /// Variances of the place and of the normal of one of a face's contacts, on average.
    pub(in crate::surface) fn single(&self, number: usize) -> (f32, f32) {
        self.moments.get(number).map_or((f32::INFINITY, f32::INFINITY), |m| {
            let contacts = f32::from(m.contacts);
            (contacts / m.weight, contacts / m.normal_weight)
        })
    }

    /// How far a point is beyond the contacts of a face, along it, metres.
    pub(in crate::surface) fn beyond(&self, number: usize, point: S::Vector) -> f32 {
        match (self.moments.get(number), self.faces().get(number)) {
            (Some(moments), Some(face)) => moments.beyond(face.normal, point),
            _ => f32::INFINITY,
        }
    }

    pub(in crate::surface) fn cuts(&self, number: usize) -> bool {
        self.moments.get(number).is_some_and(|m| m.cuts)
    }

    pub(in crate::surface) fn set_cuts(&mut self, number: usize, cuts: bool) {
        if let Some(moments) = self.moments.get_mut(number) {
            moments.cuts = cuts;
        }
    }

    /// Whether a point known so well lies outside a face beyond doubt.
    pub(in crate::surface) fn is_beyond(
        &self,
        number: usize,
        point: S::Vector,
        deviation: f32,
    ) -> bool {
        self.faces().get(number).is_some_and(|face| {
            let variance = face.variance(point) + deviation * deviation;
            face.value(point) > OUTSIDE * math::sqrt(variance)
        })
    }

    /// Whether no other face has anything outside this one but what may be wild.
    pub(in crate::surface) fn is_outermost(&self, number: usize) -> bool {
        let wild = self.faces().get(number).map_or(0, |face| face.contacts / WILD_EVERY);
        let others = self.moments.iter().take(self.count).enumerate();
        let mut others = others.filter(|(other, m)| *other != number && m.contacts > wild);
        others.all(|(_, owner)| {
            let centre = Witness { point: owner.centroid, variance: 1.0 / owner.weight };
            let witnesses = [centre, owner.ends[0], owner.ends[1]];
            witnesses.iter().all(|w| !self.is_beyond(number, w.point, math::sqrt(w.variance)))
        })
    }

    /// Whether a contact can be one of this face.
    pub(in crate::surface) fn explains(&self, number: usize, contact: &Contact<S>) -> bool {
        self.faces().get(number).is_some_and(|face| misfit(face, contact) < gate::<S>())
    }

    /// Whether a contact can be a wild one of a face that truncates a body, its `owner` having no more
    /// contacts than there may be wild ones.
    pub(in crate::surface) fn is_wild(&self, owner: usize, contact: &Contact<S>) -> bool {
        let contacts = self.faces().get(owner).map_or(0, |face| face.contacts);
        self.cutting().any(|(_, face)| {
            contacts <= (face.contacts / WILD_EVERY).max(1)
                && misfit(face, contact) < WILD * gate::<S>()
        })
    }

    /// Contacts that say together what those of a face did: in its middle, and a little way along
    /// both tangents.
    pub(in crate::surface) fn summary(&self, number: usize) -> [Option<Contact<S>>; SUMMARY] {
        let mut contacts = [None; SUMMARY];
        let (Some(moments), Some(face)) = (self.moments.get(number), self.faces().get(number))
        else {
            return contacts;
        };
        let [u, v] = S::tangents(face.normal);
        let count = 2 * (S::DIMENSION - 1);
        // The factor of the contacts' spread along the tangents: one deviation each way.
        let (a, b, c) = moments.spread([u, v]);
        let uu = math::sqrt(math::max(a, 0.0));
        let uv = if uu > 0.0 { c / uu } else { 0.0 };
        let vv = math::sqrt(math::max(b - uv * uv, 0.0));
        for (slot, contact) in contacts[..count].iter_mut().enumerate() {
            let a = if slot % 2 == 0 { 1.0 } else { -1.0 };
            let b = if slot < 2 { 1.0 } else { -1.0 };
            *contact = Some(Contact {
                point: face.centroid + u * (a * uu) + v * (a * uv + b * vv),
                normal: Some(face.normal),
                point_deviation: math::sqrt(count as f32 / moments.weight),
                normal_deviation: math::sqrt(count as f32 / moments.normal_weight),
                finger: 0,
            });
        }
        contacts
    }
}

#[cfg(test)]
mod tests;
