//! A curved body truncated by flat faces: the bounded map of objects that have both.
//!
//! A Gaussian process of bounded memory cannot hold edges: it would need contacts all along them. Flat
//! faces take no memory to speak of, whatever the number of their contacts, and make edges where they
//! meet. So the object is the intersection of a body and half-spaces,
//!
//! ```text
//! f(p) = max(g(p), n₁·p − ρ₁, n₂·p − ρ₂, …)
//! ```
//!
//! with g a Gaussian process. Every contact goes to [`Faces`] first. A face whose contacts say that it
//! is flat, and outside which nothing was touched, truncates the body; its contacts give up their
//! places in the process, and later ones need none. All other contacts are the body's, whatever else
//! they are: round, hollow, or too few to tell. A face that turns out to be bent, or to have something
//! outside it, gives its contacts back, a few that say together what its moments do.

mod joint;
mod uncut;

pub use uncut::Uncut;

use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::faces::Evidence;
use crate::surface::{Face, Faces, Gpis, Insertion, Kernel, Map, Probe, Surface, Training};

/// A [`Gpis`] of `SITES` contacts in `ROWS` rows (`PACKED` is
/// [`packed`](super::cholesky::packed)`(ROWS)`) behind at most `FACES` faces; see the module.
///
/// ```
/// use tactile_core::contact::Contact;
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::Planar;
/// use tactile_core::surface::{Map, Matern32, Surface, Truncated, cholesky::packed};
///
/// // Forty touches around a half disc of radius 40 mm, half of them on its straight side, into a
/// // map of 24 places.
/// let mut half = Truncated::<Planar, Matern32, 24, 72, { packed(72) }, 8>::new();
/// half.configure(Matern32 { amplitude: 0.03, lengthscale: 0.1 });
/// for k in 0..20 {
///     let (sin, cos) = (k as f32 * 0.165).sin_cos();
///     let touches = [
///         (Vector([0.04 * cos, 0.04 * sin]), Vector([cos, sin])),
///         (Vector([0.004 * k as f32 - 0.038, 0.0]), Vector([0.0, -1.0])),
///     ];
///     for (point, normal) in touches {
///         half.insert(&Contact {
///             point,
///             normal: Some(normal),
///             point_deviation: 1e-3,
///             normal_deviation: 0.09,
///             finger: 0,
///         });
///     }
/// }
/// half.refit();
/// assert_eq!(half.cuts().count(), 1);
/// // The corner is sharp: 2 mm beside it, inside and outside of both sides.
/// assert!(half.probe(Vector([0.038, 0.002])).value < 0.0);
/// assert!(half.probe(Vector([0.038, -0.002])).value > 0.001);
/// assert!(half.probe(Vector([0.042, 0.002])).value > 0.001);
/// ```
#[derive(Clone, Debug)]
pub struct Truncated<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> {
    body: Gpis<S, K, Uncut<S>, SITES, ROWS, PACKED>,
    faces: Faces<S, FACES>,
    kernel: K,
    /// The contacts, those on faces among them, lie in a ball about here.
    centre: S::Vector,
    /// Its radius, metres.
    radius: f32,
    /// Whether there is a contact in it.
    touched: bool,
}

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    /// An empty surface, all zero bits; [`configure`](Self::configure) it before use.
    pub const fn new() -> Self {
        Truncated {
            body: Gpis::new(),
            faces: Faces::new(),
            kernel: K::UNSET,
            centre: S::Vector::ZERO,
            radius: 0.0,
            touched: false,
        }
    }

    /// Sets the body's kernel and forgets every contact.
    pub fn configure(&mut self, kernel: K) {
        self.kernel = kernel;
        self.body.configure(kernel, Uncut::UNSET, Training::Normals);
        self.faces.clear();
        (self.centre, self.radius, self.touched) = (S::Vector::ZERO, 0.0, false);
    }

    /// The body without its faces.
    pub fn body(&self) -> &Gpis<S, K, Uncut<S>, SITES, ROWS, PACKED> {
        &self.body
    }

    /// The faces that truncate it.
    pub fn cuts(&self) -> impl Iterator<Item = &Face<S>> + Clone + '_ {
        self.faces.cutting().map(|(_, face)| face)
    }

    /// Part of the prior variance that is open where a face is this far beyond its contacts.
    fn open(&self, beyond: f32) -> f32 {
        let known = self.kernel.value(beyond * beyond) / self.kernel.variance();
        math::max(1.0 - known * known, 0.0)
    }

    /// Makes the ball about all contacts hold this one, too (Ritter, *An efficient bounding sphere*,
    /// 1990).
    fn enclose(&mut self, point: S::Vector) {
        if !self.touched {
            (self.centre, self.radius, self.touched) = (point, 0.0, true);
        }
        let out = point - self.centre;
        let distance = out.norm();
        if distance > self.radius && distance.is_finite() {
            let radius = 0.5 * (distance + self.radius);
            self.centre += out * ((radius - self.radius) / distance);
            self.radius = radius;
        }
    }

    /// Gives a contact to the faces; the number of the one that has it. (Not inlined: a board's stack
    /// need not hold its frame while the body learns.)
    #[inline(never)]
    fn file(&mut self, contact: &Contact<S>) -> Option<usize> {
        self.enclose(contact.point);
        self.faces.make_room();
        self.faces.learn(contact).1
    }

    /// Decides which faces truncate the body, now that `contact` is one of the `owner`'s.
    fn review(&mut self, owner: Option<usize>, contact: &Contact<S>) {
        for number in 0..self.faces.faces().len() {
            let is_beyond = self.faces.is_beyond(number, contact.point, contact.point_deviation);
            if self.faces.cuts(number) && Some(number) != owner && is_beyond {
                self.restore(number);
            }
        }
        let Some(number) = owner else { return };
        let is_flat = match self.faces.evidence(number) {
            Evidence::Flat => true,
            Evidence::Open => self.faces.cuts(number),
            Evidence::Bent => false,
        };
        if is_flat && self.faces.is_outermost(number) && self.has_nothing_outside(number) {
            self.cut(number);
        } else if self.faces.cuts(number) {
            self.restore(number);
        }
    }

    /// Whether no contact of the body is outside a face.
    fn has_nothing_outside(&self, number: usize) -> bool {
        let faces = &self.faces;
        self.body.held().all(|c| !faces.is_beyond(number, c.point, c.point_deviation))
    }

    /// Truncates the body by a face, whose contacts are the body's no more.
    fn cut(&mut self, number: usize) {
        self.faces.set_cuts(number, true);
        let faces = &self.faces;
        self.body.forget(|contact| faces.explains(number, contact));
    }

    /// Truncates the body no more by a face, whose contacts are the body's again.
    fn restore(&mut self, number: usize) {
        self.faces.set_cuts(number, false);
        for contact in self.faces.summary(number).iter().flatten() {
            self.body.insert(contact);
        }
    }
}

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Default for Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Map<S> for Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    /// A contact on a face that truncates the body is stored whatever the number of others. One that
    /// such a face all but explains waits until others are like it, as do wild ones. What becomes of
    /// the rest is up to the body.
    fn insert(&mut self, contact: &Contact<S>) -> Insertion {
        let Ok(contact) = contact.checked() else { return Insertion::Dropped };
        let owner = self.file(&contact);
        let cut = owner.is_some_and(|number| self.faces.cuts(number));
        self.review(owner, &contact);
        // Given back with its face, if that is bent.
        if cut || owner.is_some_and(|number| self.faces.cuts(number)) {
            return Insertion::Stored;
        }
        if owner.is_some_and(|number| self.faces.is_wild(number, &contact)) {
            return Insertion::Merged;
        }
        self.body.insert(&contact)
    }

    fn refit(&mut self) {
        let is_cut = self.cuts().next().is_some();
        let about = Uncut::about(self.centre, self.radius);
        self.body.assume(if is_cut { about } else { Uncut::UNSET });
        self.body.refit();
    }

    fn clear(&mut self) {
        self.configure(self.kernel);
    }

    fn contacts(&self) -> usize {
        self.body.contacts() + self.cuts().map(|face| usize::from(face.contacts)).sum::<usize>()
    }
}

impl<
    S: Space,
    K: Kernel,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
> Surface<S> for Truncated<S, K, SITES, ROWS, PACKED, FACES>
{
    /// Of the body or of a face, whichever attains the maximum. A face may end beyond its contacts:
    /// there it gets as uncertain, with the distance from them, as the body does from one contact. Among
    /// them it is no surer than one of them, as the body is: those of a grasp err together.
    /// [`Joint::joint`](super::Joint::joint) is exact.
    fn probe(&self, point: S::Vector) -> Probe<S> {
        let mut probe = self.body.probe(point);
        for (number, face) in self.faces.cutting() {
            let value = face.value(point);
            let beyond = self.faces.beyond(number, point);
            let away = math::sqrt(value * value + beyond * beyond);
            probe.nearest = math::min(probe.nearest, away);
            if value > probe.value {
                let open = self.open(beyond);
                let trace: f32 = (0..S::DIMENSION).map(|i| face.covariance[i][i]).sum();
                let tilt = trace * (1.0 / S::DIMENSION as f32);
                let (place, turn) = self.faces.single(number);
                probe.value = value;
                probe.gradient = face.normal;
                probe.variance =
                    math::max(face.variance(point), place) + open * self.kernel.variance();
                probe.slope_variance = math::max(tilt, turn) + open * self.kernel.slope_variance();
            }
        }
        probe
    }
}

#[cfg(test)]
mod tests;
