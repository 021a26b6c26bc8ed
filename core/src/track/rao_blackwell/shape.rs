//! The faces a particle knows, and how well a contact fits them.
//!
//! A contact lies on a known face, opens a new one, or is wild. In units of what a contact anywhere,
//! with any normal, would have (the density 1/(2π·120 mm) in the plane, 1/(4π·120 mm) in space):
//!
//! ```text
//! (1 − ν − ε) Σⱼ mⱼ N(contact; face j) · h  +  ν · h′  +  ε
//! ```
//!
//! ν falls with the number of contacts already felt, as in a Chinese restaurant process. The factors h and h′
//! doubt what is not convex: h a contact that lies outside another face, h′ also a new face that
//! would cut off what was touched. They are bounded by the doubt about the other face, and ε
//! bounds both, so that contacts can overrule convexity: what is not explained opens a face of its own
//! all the same, and a second contact there confirms it.

use super::face::{Face, Faceted, Felt, along, inverse, times};
use crate::math;
use crate::matrix::{Coordinates, Square};

/// Share of wild contacts.
const WILD: f32 = 0.05;

/// New faces: ν = `NEW`/(`NEW` + contacts felt).
const NEW: f32 = 2.0;

/// Probability that a face of one, two or more contacts is not there.
const DOUBT: [f32; 3] = [0.3, 0.02, 0.005];

/// Contacts of a face beyond which it is not more likely to be touched again.
const USUAL: u16 = 3;

/// χ² beyond which a face does not explain a contact.
const FAR: f32 = 60.0;

/// Deviation of a free fingertip's place, metres.
const FREE: f32 = 2e-3;

/// How far a touched patch reaches, in standard deviations of its contacts' places (two contacts lie
/// at one, many spread evenly along a line within √3).
const PATCH: f32 = 1.5;

/// Least probability, of what it would be otherwise, of a fingertip that met nothing inside the object.
const FREE_DOUBT: f32 = 0.05;

/// At most `FACES` faces.
#[derive(Clone, Copy, Debug)]
pub struct Shape<S: Faceted, const FACES: usize> {
    faces: [Face<S>; FACES],
    count: u16,
    /// Contacts learnt.
    felt: u16,
}

impl<S: Faceted, const FACES: usize> Shape<S, FACES> {
    /// No faces; all zero bits.
    pub(super) const NONE: Self = Shape { faces: [Face::UNSET; FACES], count: 0, felt: 0 };

    /// The faces, in no particular order. One of a single contact may be a wild contact's.
    pub fn faces(&self) -> &[Face<S>] {
        self.faces.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// Ready to be compared with contacts.
    pub(super) fn view(&self) -> View<S, FACES> {
        let mut view = View { planes: [Plane::UNSET; FACES], count: 0, new: 1.0 - WILD };
        let mut total = 0.0;
        for (face, plane) in self.faces().iter().zip(&mut view.planes) {
            *plane = Plane::of(face);
            total += plane.share;
            view.count += 1;
        }
        if total > 0.0 {
            view.new *= NEW / (NEW + f32::from(self.felt));
            let scale = (1.0 - WILD - view.new) / total;
            for plane in view.planes.iter_mut().take(view.count) {
                plane.share *= scale;
            }
        }
        view
    }

    /// Learns from a contact at the particle's pose; the number of faces let go for it, or 1 when
    /// there was no room for the contact itself.
    pub(super) fn learn(&mut self, felt: &Felt<S>, grasp: u16) -> u16 {
        let explained = self.view().explain(felt);
        self.felt = self.felt.saturating_add(1);
        if explained.fits
            && let Some(face) = self.faces.get_mut(explained.face)
        {
            face.absorb(felt, grasp);
            return 0;
        }
        let Some(opened) = Face::open(felt, grasp) else { return 0 };
        if let Some(room) = self.faces.get_mut(usize::from(self.count)) {
            *room = opened;
            self.count += 1;
            return 0;
        }
        // The longest ago among those of a single contact: a wild one, as likely as not.
        let single = self.faces.iter_mut().filter(|f| f.contacts == 1 && f.touched != grasp);
        if let Some(face) = single.max_by_key(|f| grasp.wrapping_sub(f.touched)) {
            *face = opened;
        }
        1
    }

    /// Centre of what was touched: the mean of the faces' centroids, metres.
    pub(super) fn centre(&self) -> S::Vector {
        let mut sum = S::Vector::ZERO;
        for face in self.faces() {
            sum += face.centroid;
        }
        sum * (1.0 / f32::from(self.count.max(1)))
    }
}

/// How contacts go together with a shape.
#[derive(Clone, Copy, Debug)]
pub(super) struct Explanation {
    /// Log density of the contact, up to a constant.
    pub log: f32,
    /// The face that explains it best, if any.
    pub face: usize,
    /// Whether that face is the likeliest explanation.
    pub fits: bool,
    /// Whether neither a known face nor a new one of a convex object explains it.
    pub strange: bool,
}

/// One face as contacts see it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane<S: Faceted> {
    face: Face<S>,
    basis: [S::Vector; 2],
    /// Covariance of the tilt.
    tilt: S::Spread,
    /// Variance of the height at the centroid.
    height: f32,
    /// Probability that a contact is on this face.
    share: f32,
}

/// A contact against a plane: whitened residuals, all but their Jacobian.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual<S: Faceted> {
    /// Residual of the normal along the basis, radians.
    pub normal: S::Along,
    /// Its information.
    pub information: S::Spread,
    /// What the residual of the normal says about the height: the height less this times it is
    /// independent of it.
    pub regression: S::Along,
    /// n·(p − c), metres.
    pub height: f32,
    /// Variance of the height, and what is left of it when the normal is known.
    pub variance: [f32; 2],
    /// Of the density in units of a contact anywhere.
    pub log: f32,
}

impl<S: Faceted> Plane<S> {
    const UNSET: Self = Plane {
        face: Face::UNSET,
        basis: [S::Vector::ZERO; 2],
        tilt: S::Spread::ZERO,
        height: 0.0,
        share: 0.0,
    };

    /// Never inlined: within [`Shape::view`] LLVM 22's register allocator crashes on it for Cortex-M4F.
    #[inline(never)]
    fn of(face: &Face<S>) -> Self {
        Plane {
            face: *face,
            basis: S::tangents(face.normal),
            tilt: face.tilt(),
            height: 1.0 / face.weight,
            share: f32::from(face.contacts.min(USUAL)),
        }
    }

    /// Probability that the face is not there.
    fn doubt(&self) -> f32 {
        DOUBT[usize::from(self.face.contacts).clamp(1, DOUBT.len()) - 1]
    }

    pub fn normal(&self) -> S::Vector {
        self.face.normal
    }

    pub fn basis(&self) -> &[S::Vector; 2] {
        &self.basis
    }

    /// Compares a contact with the plane, both blurred by `blur` (variances of height and angle).
    #[inline]
    pub fn residual(&self, felt: &Felt<S>, blur: [f32; 2]) -> Residual<S> {
        let arm = felt.point - self.face.centroid;
        let height = self.face.normal.dot(arm);
        let place = along::<S>(&self.basis, arm);
        let lean = times(&self.tilt, place);
        let variance = place.dot(lean) + self.height + felt.point_variance + blur[0];
        let mut residual = Residual::<S> {
            normal: S::Along::ZERO,
            information: S::Spread::ZERO,
            regression: S::Along::ZERO,
            height,
            variance: [variance; 2],
            log: 0.0,
        };
        let mut chi = 0.0;
        let mut determinant = 1.0;
        if let Some(normal) = felt.normal {
            // The chord |a − n| in the direction of its shadow on the plane: closer to the angle than
            // the shadow, the sine.
            let cosine = normal.dot(self.face.normal);
            if cosine < 0.0 {
                residual.log = f32::NEG_INFINITY;
                return residual;
            }
            let stretch = math::sqrt(2.0 / (1.0 + cosine));
            let turned = along::<S>(&self.basis, normal) * stretch;
            residual.normal = turned;
            let mut covariance = self.tilt;
            for k in 0..S::Along::LEN {
                *covariance.at_mut(k, k) += felt.normal_variance + blur[1];
            }
            (residual.information, determinant) = inverse(&covariance);
            let regression: S::Along = times(&residual.information, -lean);
            residual.variance[1] = variance + regression.dot(lean);
            residual.regression = regression;
            chi = turned.dot(times(&residual.information, turned));
        }
        let rest = height - residual.regression.dot(residual.normal);
        chi += rest * rest / residual.variance[1];
        residual.log = f32::NEG_INFINITY;
        if chi < FAR {
            residual.log = -0.5 * chi - 0.5 * math::ln(determinant * residual.variance[1])
                + anywhere::<S>(felt.normal.is_some());
        }
        residual
    }
}

/// Logarithm of a normal distribution's constant in units of the density of a contact anywhere:
/// 1/(2π·120 mm) in the plane, 1/(4π·120 mm) in space, 1/120 mm without a normal.
fn anywhere<S: Faceted>(normal: bool) -> f32 {
    const LN_SIZE: f32 = -2.120_263_5;
    const HALF_LN_TAU: f32 = 0.918_938_5;
    match (normal, S::DIMENSION) {
        (false, _) => LN_SIZE - HALF_LN_TAU,
        (true, 2) => LN_SIZE,
        (true, _) => LN_SIZE - HALF_LN_TAU + core::f32::consts::LN_2,
    }
}

/// A shape ready to be compared with contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<S: Faceted, const FACES: usize> {
    planes: [Plane<S>; FACES],
    count: usize,
    /// ν, the probability of a new face.
    new: f32,
}

impl<S: Faceted, const FACES: usize> View<S, FACES> {
    fn planes(&self) -> &[Plane<S>] {
        self.planes.get(..self.count).unwrap_or(&[])
    }

    /// The plane that explains a contact best, how they differ, and the probability that it is the
    /// right one; with `blur` as in [`Plane::residual`].
    pub fn nearest(&self, felt: &Felt<S>, blur: [f32; 2]) -> Option<(&Plane<S>, Residual<S>, f32)> {
        let mut best: Option<(&Plane<S>, Residual<S>, f32)> = None;
        for plane in self.planes() {
            let residual = plane.residual(felt, blur);
            if residual.log == f32::NEG_INFINITY {
                continue;
            }
            let log = residual.log + math::ln(plane.share);
            if best.as_ref().is_none_or(|(.., most)| log > *most) {
                best = Some((plane, residual, log));
            }
        }
        best.map(|(plane, residual, log)| {
            let odds = math::exp(log);
            (plane, residual, odds / (odds + self.unknown()))
        })
    }

    /// What a contact has that no known face explains and convexity does not forbid.
    pub fn unknown(&self) -> f32 {
        self.new + WILD
    }

    /// How well the shape explains a contact.
    pub fn explain(&self, felt: &Felt<S>) -> Explanation {
        let (mut known, mut most, mut best) = (0.0, 0.0, usize::MAX);
        for (number, plane) in self.planes().iter().enumerate() {
            let log = plane.residual(felt, [0.0; 2]).log;
            if log > -40.0 {
                let odds = plane.share * math::exp(log);
                known += odds;
                if odds > most {
                    (most, best) = (odds, number);
                }
            }
        }
        known *= self.inside(felt, best);
        let new = if felt.normal.is_some() { self.admits(felt) } else { 0.0 };
        let unknown = self.new * new + WILD;
        Explanation {
            log: math::ln(known + unknown),
            face: best,
            fits: known > unknown,
            strange: known < WILD && new < 0.1,
        }
    }

    /// h: how well a contact on face `own` (none when out of range) agrees with the others'
    /// being convex.
    fn inside(&self, felt: &Felt<S>, own: usize) -> f32 {
        let mut least: f32 = 1.0;
        for (number, plane) in self.planes().iter().enumerate() {
            let arm = felt.point - plane.face.centroid;
            let mut height = plane.face.normal.dot(arm);
            if number == own || height <= 0.0 {
                continue;
            }
            // What already lies outside is no news.
            if let Some(other) = self.planes().get(own) {
                height -= math::max(other.face.reach(plane.face.centroid, plane.face.normal), 0.0);
            }
            if height > 0.0 {
                let place = along::<S>(&plane.basis, arm);
                let variance =
                    place.dot(times(&plane.tilt, place)) + plane.height + felt.point_variance;
                least = math::min(least, bounded(height * height / variance, plane.doubt()));
            }
        }
        least
    }

    /// h′: how well a new face through the contact agrees with a convex object.
    fn admits(&self, felt: &Felt<S>) -> f32 {
        let mut least = self.inside(felt, usize::MAX);
        let Some(normal) = felt.normal else { return least };
        for plane in self.planes() {
            let height = plane.face.reach(felt.point, normal);
            if height > 0.0 {
                let arm = plane.face.centroid - felt.point;
                let variance =
                    felt.normal_variance * arm.norm_squared() + plane.height + felt.point_variance;
                least = math::min(least, bounded(height * height / variance, plane.doubt()));
            }
        }
        least
    }

    /// Log probability, up to a constant, that a fingertip met nothing at `point` (object frame): low
    /// below a patch that was touched, where it could not have come.
    pub fn free(&self, point: S::Vector) -> f32 {
        let mut nearest: Option<(f32, &Plane<S>)> = None;
        for plane in self.planes() {
            let height = plane.face.normal.dot(point - plane.face.centroid);
            if height >= 0.0 {
                return 0.0;
            }
            if nearest.is_none_or(|(most, _)| height > most) {
                nearest = Some((height, plane));
            }
        }
        let Some((height, plane)) = nearest else { return 0.0 };
        if plane.face.contacts < 2 {
            return 0.0;
        }
        let place = along::<S>(&plane.basis, point - plane.face.centroid);
        let mut spread = plane.face.scatter;
        spread.scale(1.0 / plane.face.weight);
        for k in 0..S::Along::LEN {
            *spread.at_mut(k, k) += FREE * FREE;
        }
        if place.dot(times(&inverse(&spread).0, place)) > PATCH * PATCH {
            return 0.0;
        }
        let variance = place.dot(times(&plane.tilt, place)) + plane.height + FREE * FREE;
        math::ln(bounded(height * height / variance, FREE_DOUBT))
    }
}

/// exp(−χ²/2), but no less than `doubt`.
#[inline(always)]
fn bounded(chi_squared: f32, doubt: f32) -> f32 {
    doubt + (1.0 - doubt) * math::exp(-0.5 * chi_squared)
}
