//! The additive moments of a face's contacts, and the plane that follows from them.

use super::Face;
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;

/// Room for three dimensions; a planar face leaves the last row and column zero.
pub(super) type Symmetric = [[f32; 3]; 3];

/// A contact that a face remembers, to hold other faces against it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Witness<S: Space> {
    pub point: S::Vector,
    pub variance: f32,
}

/// What a face keeps of its contacts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moments<S: Space> {
    pub contacts: u16,
    /// Numbers that were measured: 1 per point, dimension − 1 per normal.
    pub measured: u16,
    /// Σ 1/σ_p².
    pub weight: f32,
    /// Weighted mean of the points.
    pub centroid: S::Vector,
    /// Σ (p − centroid)(p − centroid)ᵀ/σ_p².
    pub scatter: Symmetric,
    /// Σ N/σ_θ².
    normals: S::Vector,
    /// Σ 1/σ_θ².
    pub normal_weight: f32,
    /// Σ (p − centroid) Nᵀ/σ_θ²: how normals turn along the face.
    pub turns: Symmetric,
    /// The two contacts farthest from each other, as far as they were seen together.
    pub ends: [Witness<S>; 2],
    /// Whether the face truncates a body.
    pub cuts: bool,
}

/// Contacts after which a face starts to forget: an endless stream neither overflows nor drowns in
/// rounding errors.
const MEMORY: u16 = 8192;

impl<S: Space> Moments<S> {
    pub const NONE: Self = Moments {
        contacts: 0,
        measured: 0,
        weight: 0.0,
        centroid: S::Vector::ZERO,
        scatter: [[0.0; 3]; 3],
        normals: S::Vector::ZERO,
        normal_weight: 0.0,
        turns: [[0.0; 3]; 3],
        cuts: false,
        ends: [Witness { point: S::Vector::ZERO, variance: 0.0 }; 2],
    };

    pub fn of(contact: &Contact<S>) -> Self {
        let variance = contact.point_deviation * contact.point_deviation;
        let end = Witness { point: contact.point, variance };
        let mut moments = Moments {
            contacts: 1,
            measured: 1,
            weight: 1.0 / variance,
            centroid: contact.point,
            ends: [end; 2],
            ..Self::NONE
        };
        if let Some(normal) = contact.normal {
            moments.normal_weight = 1.0 / (contact.normal_deviation * contact.normal_deviation);
            moments.normals = normal * moments.normal_weight;
            moments.measured = S::DIMENSION as u16;
        }
        moments
    }

    pub fn plus(&self, other: &Self) -> Self {
        let weight = self.weight + other.weight;
        let apart = other.centroid - self.centroid;
        let share = other.weight / weight;
        let centroid = self.centroid + apart * share;
        let (mut scatter, mut turns) = (self.scatter, self.turns);
        for i in 0..S::DIMENSION {
            for j in 0..S::DIMENSION {
                scatter[i][j] += other.scatter[i][j] + self.weight * share * apart[i] * apart[j];
                turns[i][j] += other.turns[i][j]
                    + (self.centroid[i] - centroid[i]) * self.normals[j]
                    + (other.centroid[i] - centroid[i]) * other.normals[j];
            }
        }
        let all = [self.ends[0], self.ends[1], other.ends[0], other.ends[1]];
        let mut ends = self.ends;
        let mut farthest = -1.0;
        for i in 0..4 {
            for j in 0..i {
                let distance = (all[i].point - all[j].point).norm_squared();
                if distance > farthest {
                    (farthest, ends) = (distance, [all[j], all[i]]);
                }
            }
        }
        Moments {
            contacts: self.contacts.saturating_add(other.contacts),
            measured: self.measured.saturating_add(other.measured),
            weight,
            centroid,
            scatter,
            turns,
            cuts: self.cuts || other.cuts,
            normals: self.normals + other.normals,
            normal_weight: self.normal_weight + other.normal_weight,
            ends,
        }
    }

    /// The same with all weights by half where there are [`MEMORY`] contacts.
    pub fn faded(mut self) -> Self {
        if self.contacts >= MEMORY {
            self.contacts /= 2;
            self.measured /= 2;
            self.weight *= 0.5;
            self.normals = self.normals * 0.5;
            self.normal_weight *= 0.5;
            for row in self.scatter.iter_mut().chain(&mut self.turns) {
                for x in row {
                    *x *= 0.5;
                }
            }
        }
        self
    }

    fn times(&self, n: S::Vector) -> S::Vector {
        let mut product = S::Vector::ZERO;
        for i in 0..S::DIMENSION {
            for j in 0..S::DIMENSION {
                product[i] += self.scatter[i][j] * n[j];
            }
        }
        product
    }

    /// The plane of least cost: (S + λ)n = Σ N/σ_θ² with the λ that makes |n| = 1, by safeguarded
    /// Newton steps on 1/|n|. `None` when the normals cancel.
    pub fn fit(&self) -> Option<Face<S>> {
        let length = self.normals.norm();
        if !(length > 1e-6 * self.normal_weight && length.is_finite()) {
            return None;
        }
        let mut trace = 0.0;
        for i in 0..S::DIMENSION {
            trace += self.scatter[i][i];
        }
        let (mut low, mut high) = (length - trace, length);
        let mut lambda = high;
        let mut found = None;
        for _ in 0..40 {
            let factor = factor::<S>(&self.scatter, lambda);
            let Some(factor) = factor else {
                low = lambda;
                lambda = 0.5 * (low + high);
                continue;
            };
            let u = solve::<S>(&factor, self.normals);
            let norm = u.norm();
            found = u.normalized().or(found);
            if !((norm - 1.0).abs() > 1e-6) {
                break;
            }
            if norm > 1.0 {
                low = low.max(lambda)
            } else {
                high = high.min(lambda)
            }
            let curvature = u.dot(solve::<S>(&factor, u));
            lambda += norm * norm / curvature * (norm - 1.0);
            if !(lambda > low && lambda < high) {
                lambda = 0.5 * (low + high);
            }
        }
        let normal = found?;
        let pressed = self.times(normal);
        // Normals that contradict the points leave little or negative λ; a thousandth of their
        // weight keeps the covariance finite.
        let lambda = normal.dot(self.normals - pressed).max(1e-3 * self.normal_weight);
        let cost = normal.dot(pressed) + 2.0 * (self.normal_weight - normal.dot(self.normals));
        let covariance = tangent_inverse::<S>(&self.scatter, normal, pressed, lambda)?;
        Some(Face {
            normal,
            offset: normal.dot(self.centroid),
            centroid: self.centroid,
            offset_variance: 1.0 / self.weight,
            covariance,
            contacts: self.contacts,
            cost: cost.max(0.0),
        })
    }
}

/// The lower Cholesky factor of `a` + `shift`, or `None` when that is not positive definite.
fn factor<S: Space>(a: &Symmetric, shift: f32) -> Option<Symmetric> {
    let mut l = [[0.0; 3]; 3];
    for i in 0..S::DIMENSION {
        for j in 0..=i {
            let mut sum = a[i][j];
            if i == j {
                sum += shift;
            }
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            if i != j {
                l[i][j] = sum / l[j][j];
            } else if sum > 0.0 && sum.is_finite() {
                l[i][i] = math::sqrt(sum);
            } else {
                return None;
            }
        }
    }
    Some(l)
}

/// x with L Lᵀ x = b.
fn solve<S: Space>(l: &Symmetric, b: S::Vector) -> S::Vector {
    let mut x = b;
    for i in 0..S::DIMENSION {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    for i in (0..S::DIMENSION).rev() {
        for k in i + 1..S::DIMENSION {
            x[i] -= l[k][i] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

/// Covariance of the normal: the inverse of T(S + λ)T among the tangents, T = 1 − nnᵀ.
fn tangent_inverse<S: Space>(
    scatter: &Symmetric,
    normal: S::Vector,
    pressed: S::Vector,
    lambda: f32,
) -> Option<Symmetric> {
    let along = normal.dot(pressed);
    let mut m = [[0.0; 3]; 3];
    for i in 0..S::DIMENSION {
        for j in 0..S::DIMENSION {
            m[i][j] = scatter[i][j] - normal[i] * pressed[j] - pressed[i] * normal[j]
                + along * normal[i] * normal[j];
        }
    }
    let factor = factor::<S>(&m, lambda)?;
    let mut covariance = [[0.0; 3]; 3];
    for j in 0..S::DIMENSION {
        let axis = S::Vector::from_fn(|i| if i == j { 1.0 } else { 0.0 });
        let column = solve::<S>(&factor, axis - normal * normal[j]);
        for i in 0..S::DIMENSION {
            covariance[i][j] = column[i];
        }
    }
    Some(covariance)
}
