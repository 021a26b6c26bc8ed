//! Implicit surfaces: f > 0 outside the object, f < 0 inside, f = 0 on it, scaled as a signed
//! distance in metres, in the object frame.

pub mod baked;
pub mod cholesky;
pub mod faces;
pub mod gpis;
pub mod grid;
pub mod kernel;
pub mod local;
pub mod prior;
pub mod revisable;
pub mod truncated;

pub use baked::Baked;
pub use faces::{Face, Faces};
pub use gpis::{Gpis, Spheres, Training};
pub use grid::Grid;
pub use kernel::{Kernel, Matern32, SquaredExponential, ThinPlate};
pub use local::Local;
pub use prior::{Ball, Constant, Ellipsoid, Polytope, Prior, Shape, SignedDistance};
pub use revisable::{Bend, Revisable, Shared};
pub use truncated::Truncated;

use crate::contact::Contact;
use crate::space::Space;

/// What a surface says about one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe<S: Space> {
    /// f, metres.
    pub value: f32,
    /// ∇f, no unit; length near one close to the surface.
    pub gradient: S::Vector,
    /// Variance of f, square metres.
    pub variance: f32,
    /// Variance of one component of ∇f, averaged over the components.
    pub slope_variance: f32,
    /// Distance to the nearest contact the surface was learnt from, metres; infinite without one.
    pub nearest: f32,
}

/// A surface that can be asked.
pub trait Surface<S: Space> {
    /// Value, gradient and uncertainty at `point` (object frame, metres).
    fn probe(&self, point: S::Vector) -> Probe<S>;
}

/// A surface that learns from contacts within bounded memory.
pub trait Map<S: Space>: Surface<S> {
    /// Adds a contact given in the object frame; at capacity, the contact that its neighbours make
    /// most redundant loses its place, which may be the new one. [`refit`](Self::refit) makes it
    /// count.
    fn insert(&mut self, contact: &Contact<S>) -> Insertion;

    /// Brings the surface up to date after insertions: once per grasp.
    fn refit(&mut self);

    /// Forgets every contact.
    fn clear(&mut self);

    /// Number of contacts held.
    fn contacts(&self) -> usize;
}

/// A map that answers for several points at once: what foretelling a grasp takes.
pub trait Joint<S: Space>: Map<S> {
    /// f at `L` points, metres: to the bit what [`Surface::probe`] says.
    fn values<const L: usize>(&self, points: &[S::Vector; L]) -> [f32; L];

    /// Covariance of f at the first `N` of some points, square metres; rows and columns beyond their
    /// number are zero.
    fn joint<const N: usize>(&self, points: &[S::Vector]) -> [[f32; N]; N];

    /// Where contacts have been learnt: enough points to say how far the object reaches.
    fn touched(&self) -> impl Iterator<Item = S::Vector> + Clone + '_;
}

/// What became of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// There was room.
    Stored,
    /// It took the place of one or more contacts that others explain. (A [`Gpis`] hands on what it
    /// learnt from them.)
    Replaced(u16),
    /// There was no room and others explain this contact best: what it says went to them.
    Merged,
    /// The map is full and learnt nothing from it, or its covariance row was not positive definite
    /// in `f32` (an exact repetition with no noise).
    Dropped,
}

#[cfg(test)]
mod bad_input;
