//! Maps whose latest contacts can be taken back and learnt again elsewhere, with errors in common.
//!
//! The contacts of one grasp share the error of its pose. To first order a pose in error by ξ shifts
//! every observation of the grasp (the value at a contact, each component of its normal) by J·ξ. With
//! ξ ~ N(0, P), the observations y of all contacts are
//!
//! ```text
//! y − m ~ N(offset, K + Σ + J P Jᵀ)
//! ```
//!
//! a Gaussian process still, whose noise is correlated within a grasp and between grasps. Its
//! posterior is that of surface and poses together, both marginalised exactly, and its likelihood is
//! what surface, contacts and motion say of the trajectory (Rasmussen & Williams 2006, 2.7; the
//! poses are the "explicit basis functions").

use crate::contact::Contact;
use crate::space::Space;
use crate::surface::{Map, Probe};

/// What the pose does to the rows of one contact (value, then slopes), see the module.
#[derive(Clone, Copy, Debug)]
pub struct Shared<'a, S: Space> {
    /// Expected shift, what the pose's error adds to each row on average: taken off the observation.
    pub offset: [f32; 4],
    /// J, one tangent per row.
    pub lever: &'a [S::Tangent],
    /// J P of every row since `since`, those of this contact last: its product with a row of
    /// `lever` is the covariance of the two.
    pub spread: &'a [S::Tangent],
    /// The first row with noise in common; contacts before are independent of the pose.
    pub since: usize,
}

/// ∇f and its slopes, see the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend<S: Space> {
    /// ∇f, no unit.
    pub gradient: S::Vector,
    /// Slopes of ∇f, one row per axis; as many as the space has, per metre.
    pub curvature: [S::Vector; 3],
}

/// A [`Map`] that can go back.
pub trait Revisable<S: Space>: Map<S> {
    /// Rows in use: observations, in the order of their contacts.
    fn rows(&self) -> usize;

    /// Appends a contact (object frame) whose noise is shared as said; the number of its rows, 0 when
    /// it has no room or tells nothing new in single precision. [`Map::refit`] makes it count.
    /// `workspace` must hold four numbers for each row in use; with less the contact finds no room.
    fn append(
        &mut self,
        contact: &Contact<S>,
        shared: &Shared<'_, S>,
        workspace: &mut [f32],
    ) -> usize;

    /// Takes back all contacts appended after there were this many rows.
    fn withdraw(&mut self, rows: usize);

    /// Forgets every contact and goes on with the configured kernel made rougher by this factor
    /// ([`Kernel::rougher`](crate::surface::Kernel::rougher)); [`Map::clear`] sets it back to one.
    fn roughen(&mut self, factor: f32);

    /// [`Map::insert`] that keeps room for as many contacts more: for good, the surface may hand what
    /// it says to others. Nothing appended may be there.
    fn settle(&mut self, contact: &Contact<S>, room: usize);

    /// Log density of the observations since `row`, given those before, under the prior mean of
    /// the last [`Map::refit`] (natural logarithm; metres and no unit).
    fn log_density_since(&self, row: usize) -> f32;

    /// (K + Σ + J P Jᵀ)⁻¹ (y − m) of every row, since the last refit.
    fn weights(&self) -> &[f32];

    /// x ← L⁻¹ x for C vectors, with L the Cholesky factor of the observations' covariance. They are
    /// zero before row `first`, from which on `x` holds their numbers, row by row.
    fn whiten<const C: usize>(&self, first: usize, x: &mut [[f32; C]]);

    /// The block of (K + Σ + J P Jᵀ)⁻¹ of `count` rows from `first` on, at most `N`; `None` where those
    /// rows do not exist, or `workspace` does not hold `N` numbers for each row from there on.
    fn precision<const N: usize>(
        &self,
        first: usize,
        count: usize,
        workspace: &mut [f32],
    ) -> Option<[[f32; N]; N]>;

    /// ∇f at `point` and its slopes.
    fn bend(&self, point: S::Vector) -> Bend<S>;

    /// [`Surface::probe`](crate::surface::Surface::probe) and [`bend`](Self::bend) in one pass over the
    /// contacts.
    fn sense(&self, point: S::Vector) -> (Probe<S>, Bend<S>);
}
