//! Positive definite systems of a pose's size.

use crate::matrix::{Coordinates, Square};
use crate::space::Space;
use crate::surface::cholesky::{Cholesky, packed};

/// The factor of a symmetric positive definite matrix over tangents.
pub(super) struct Definite<S: Space> {
    factor: Cholesky<6, { packed(6) }>,
    size: core::marker::PhantomData<S>,
}

impl<S: Space> Definite<S> {
    /// `None` where the matrix is not positive definite beyond rounding.
    pub fn new(matrix: &S::Covariance) -> Option<Self> {
        // Metres and radians differ by orders of magnitude, which costs no digits here: the factor of a
        // scaled matrix is the scaled factor.
        let mut factor = Cholesky::new();
        for i in 0..S::FREEDOM {
            for (j, entry) in factor.stage(0).iter_mut().enumerate() {
                *entry = 0.5 * (matrix.at(i, j) + matrix.at(j, i));
            }
            factor.append().ok()?;
        }
        Some(Definite { factor, size: core::marker::PhantomData })
    }

    /// The inverse times a tangent.
    pub fn solve(&self, tangent: S::Tangent) -> S::Tangent {
        let mut x = [0.0; 6];
        for (i, x) in x[..S::FREEDOM].iter_mut().enumerate() {
            *x = tangent[i];
        }
        self.factor.forward(&mut x);
        self.factor.backward(&mut x);
        S::Tangent::from_fn(|i| x[i])
    }

    pub fn inverse(&self) -> S::Covariance {
        let mut inverse = S::Covariance::ZERO;
        for i in 0..S::FREEDOM {
            let mut axis = S::Tangent::ZERO;
            axis[i] = 1.0;
            let column = self.solve(axis);
            for j in 0..S::FREEDOM {
                *inverse.at_mut(j, i) = column[j];
            }
        }
        inverse
    }

    pub fn half_log_determinant(&self) -> f32 {
        self.factor.half_log_determinant()
    }
}

/// matrix · tangent.
pub(super) fn times<S: Space>(matrix: &S::Covariance, tangent: S::Tangent) -> S::Tangent {
    S::Tangent::from_fn(|i| {
        let mut sum = 0.0;
        for j in 0..S::FREEDOM {
            sum += matrix.at(i, j) * tangent[j];
        }
        sum
    })
}

/// matrixᵀ · tangent.
pub(super) fn transposed_times<S: Space>(
    matrix: &S::Covariance,
    tangent: S::Tangent,
) -> S::Tangent {
    S::Tangent::from_fn(|j| {
        let mut sum = 0.0;
        for i in 0..S::FREEDOM {
            sum += matrix.at(i, j) * tangent[i];
        }
        sum
    })
}

/// a · b.
pub(super) fn product<S: Space>(a: &S::Covariance, b: &S::Covariance) -> S::Covariance {
    let mut product = S::Covariance::ZERO;
    for i in 0..S::FREEDOM {
        for j in 0..S::FREEDOM {
            for k in 0..S::FREEDOM {
                *product.at_mut(i, j) += a.at(i, k) * b.at(k, j);
            }
        }
    }
    product
}

/// a · m · aᵀ.
pub(super) fn carried<S: Space>(a: &S::Covariance, m: &S::Covariance) -> S::Covariance {
    let half = product::<S>(a, m);
    let mut carried = S::Covariance::ZERO;
    for i in 0..S::FREEDOM {
        for j in 0..S::FREEDOM {
            for k in 0..S::FREEDOM {
                *carried.at_mut(i, j) += half.at(i, k) * a.at(j, k);
            }
        }
    }
    carried
}
