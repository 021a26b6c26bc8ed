//! One face of a particle's object: a plane and how well its contacts fix it.
//!
//! At a known pose a contact (p, a) on the plane through c with normal n measures two things: the
//! normal, a = n + Bδ + noise, and the height, n·(p − c) = 0 + noise. Kept about the centroid of
//! its contacts, the plane's tilt δ and height are uncorrelated, and all that is known is additive: the
//! weights of points and normals, the centroid, and the scatter of the points along the plane. A
//! contact is absorbed exactly as a Kalman filter would, without a matrix that could lose its
//! positive definiteness.

use crate::contact::Contact;
use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Planar, Pose, Space, Spatial};

/// A space with planes in it: lines in the plane, planes in space.
pub trait Faceted: Space {
    /// Coordinates along a plane: one fewer than of a point.
    type Along: Coordinates;
    /// A symmetric matrix in these.
    type Spread: Square<Vector = Self::Along>;
}

impl Faceted for Planar {
    type Along = Vector<1>;
    type Spread = Matrix<1>;
}

impl Faceted for Spatial {
    type Along = Vector<2>;
    type Spread = Matrix<2>;
}

/// The coordinates of `v` along `basis`.
#[inline(always)]
pub(super) fn along<S: Faceted>(basis: &[S::Vector; 2], v: S::Vector) -> S::Along {
    S::Along::from_fn(|k| basis[k & 1].dot(v))
}

/// mᵀ·v for a symmetric m.
#[inline(always)]
pub(super) fn times<M: Square>(m: &M, v: M::Vector) -> M::Vector {
    M::Vector::from_fn(|i| {
        let mut sum = 0.0;
        for j in 0..M::Vector::LEN {
            sum += m.at(i, j) * v[j];
        }
        sum
    })
}

/// Inverse and determinant of a symmetric positive definite matrix of one or two rows.
#[inline(always)]
pub(super) fn inverse<M: Square>(m: &M) -> (M, f32) {
    let mut inverse = M::ZERO;
    if M::Vector::LEN == 1 {
        *inverse.at_mut(0, 0) = 1.0 / m.at(0, 0);
        return (inverse, m.at(0, 0));
    }
    let determinant = m.at(0, 0) * m.at(1, 1) - m.at(0, 1) * m.at(1, 0);
    let scale = 1.0 / determinant;
    *inverse.at_mut(0, 0) = m.at(1, 1) * scale;
    *inverse.at_mut(1, 1) = m.at(0, 0) * scale;
    *inverse.at_mut(0, 1) = -m.at(0, 1) * scale;
    *inverse.at_mut(1, 0) = -m.at(1, 0) * scale;
    (inverse, determinant)
}

/// A contact in the object frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Felt<S: Space> {
    pub point: S::Vector,
    pub normal: Option<S::Vector>,
    /// σ_p², square metres.
    pub point_variance: f32,
    /// σ_θ², radians².
    pub normal_variance: f32,
}

impl<S: Space> Felt<S> {
    /// What a valid contact says about the object at `pose`.
    #[inline(always)]
    pub fn at(pose: &S::Pose, contact: &Contact<S>) -> Self {
        Felt {
            point: pose.untransform(contact.point),
            normal: contact.normal.map(|n| pose.unrotate(n)),
            // No fingertip is better, and single precision has no more.
            point_variance: math::max(contact.point_deviation * contact.point_deviation, 1e-10),
            normal_variance: math::max(contact.normal_deviation * contact.normal_deviation, 1e-4),
        }
    }
}

/// A plane in the object frame, learnt from contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face<S: Faceted> {
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// Weighted mean of the contacts, metres: a point of the plane.
    pub centroid: S::Vector,
    /// Σ 1/σ_p² of the contacts, per square metre.
    pub(super) weight: f32,
    /// Σ 1/σ_θ².
    pub(super) normal_weight: f32,
    /// Σ t·tᵀ/σ_p² of the contacts' places t along the plane, about the centroid.
    pub(super) scatter: S::Spread,
    /// How many contacts it was learnt from.
    pub contacts: u16,
    /// The grasp that last touched it.
    pub(super) touched: u16,
}

impl<S: Faceted> Face<S> {
    /// All zero bits.
    pub(super) const UNSET: Self = Face {
        normal: S::Vector::ZERO,
        centroid: S::Vector::ZERO,
        weight: 0.0,
        normal_weight: 0.0,
        scatter: S::Spread::ZERO,
        contacts: 0,
        touched: 0,
    };

    /// The face that a first contact opens; `None` for a contact without a normal.
    pub(super) fn open(felt: &Felt<S>, grasp: u16) -> Option<Self> {
        Some(Face {
            normal: felt.normal?,
            centroid: felt.point,
            weight: 1.0 / felt.point_variance,
            normal_weight: 1.0 / felt.normal_variance,
            scatter: S::Spread::ZERO,
            contacts: 1,
            touched: grasp,
        })
    }

    /// Offset ρ of the plane n·p = ρ, metres.
    pub fn offset(&self) -> f32 {
        self.normal.dot(self.centroid)
    }

    /// Standard deviation along the normal at the centroid, metres.
    pub fn deviation(&self) -> f32 {
        1.0 / math::sqrt(self.weight)
    }

    /// Covariance of the tilt δ along the basis of the normal: what normals and places say together.
    pub fn tilt(&self) -> S::Spread {
        let mut information = self.scatter;
        for k in 0..S::Along::LEN {
            *information.at_mut(k, k) += self.normal_weight;
        }
        inverse(&information).0
    }

    /// Learns from one more contact: the Kalman update of tilt and height, then the plane passes
    /// through the new centroid.
    pub(super) fn absorb(&mut self, felt: &Felt<S>, grasp: u16) {
        let basis = S::tangents(self.normal);
        let arm = felt.point - self.centroid;
        let (height, place) = (self.normal.dot(arm), along::<S>(&basis, arm));
        let weight = 1.0 / felt.point_variance;
        let total = self.weight + weight;
        // The centroid's own height is in doubt, too.
        let pair = self.weight * weight / total;
        let mut right = place * (-pair * height);
        self.scatter.add_outer(pair, place, place);
        if let Some(normal) = felt.normal {
            let weight = 1.0 / felt.normal_variance;
            self.normal_weight += weight;
            right += along::<S>(&basis, normal) * weight;
        }
        let tilt = times(&self.tilt(), right);
        let mut tilted = self.normal;
        for (k, direction) in basis.iter().enumerate().take(S::Along::LEN) {
            tilted += *direction * tilt[k];
        }
        if let Some(normal) = tilted.normalized() {
            self.normal = normal;
            self.turn_scatter(&basis);
        }
        self.centroid += arm * (weight / total);
        self.weight = total;
        self.contacts = self.contacts.saturating_add(1);
        self.touched = grasp;
    }

    /// Writes the scatter, given in `old` axes, in the axes of the present normal.
    fn turn_scatter(&mut self, old: &[S::Vector; 2]) {
        let new = S::tangents(self.normal);
        let mut turned = S::Spread::ZERO;
        for i in 0..S::Along::LEN {
            for j in 0..S::Along::LEN {
                // One column of the old matrix after the other, each direction seen from the new.
                for k in 0..S::Along::LEN {
                    for l in 0..S::Along::LEN {
                        *turned.at_mut(i, j) += new[i & 1].dot(old[k & 1])
                            * self.scatter.at(k, l)
                            * new[j & 1].dot(old[l & 1]);
                    }
                }
            }
        }
        self.scatter = turned;
    }

    /// How far along `direction` the face's contacts reach from `origin`, at least, metres: to one
    /// standard deviation of theirs beyond the centroid, which of any two contacts one attains.
    pub(super) fn reach(&self, origin: S::Vector, direction: S::Vector) -> f32 {
        let d = along::<S>(&S::tangents(self.normal), direction);
        let spread = d.dot(times(&self.scatter, d)) / self.weight;
        direction.dot(self.centroid - origin) + math::sqrt(math::max(spread, 0.0))
    }
}
