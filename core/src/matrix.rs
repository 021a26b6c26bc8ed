//! Vectors and square matrices of two to six rows: all the linear algebra the core needs beside
//! its packed Cholesky factor.
//!
//! Sums run in index order and nothing is fused, so results do not depend on the target. (nalgebra
//! switches to a SIMD kernel with fused multiply-add for 6×6 products when any crate in the build
//! turns its `std` feature on, which would break that.)

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Index, IndexMut, Mul, Neg, Sub};

use crate::math;

/// A column of `N` numbers: a point, a direction or a tangent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vector<const N: usize>(pub [f32; N]);

/// A square matrix, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matrix<const N: usize>(pub [[f32; N]; N]);

/// What generic code may do with a [`Vector`] whose length it does not know.
pub trait Coordinates:
    Copy
    + Debug
    + Default
    + PartialEq
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Neg<Output = Self>
    + Mul<f32, Output = Self>
    + Index<usize, Output = f32>
    + IndexMut<usize>
    + 'static
{
    /// Number of coordinates.
    const LEN: usize;
    /// The origin.
    const ZERO: Self;

    /// The vector whose `i`-th coordinate is `f(i)`.
    fn from_fn(f: impl FnMut(usize) -> f32) -> Self;

    /// The coordinates as a slice of [`Self::LEN`] numbers.
    fn as_slice(&self) -> &[f32];

    /// Scalar product.
    #[inline(always)]
    fn dot(self, other: Self) -> f32 {
        let mut sum = self[0] * other[0];
        for i in 1..Self::LEN {
            sum += self[i] * other[i];
        }
        sum
    }

    /// Squared Euclidean length.
    #[inline(always)]
    fn norm_squared(self) -> f32 {
        self.dot(self)
    }

    /// Euclidean length.
    #[inline(always)]
    fn norm(self) -> f32 {
        math::sqrt(self.norm_squared())
    }

    /// The vector scaled to length one, or `None` when it is shorter than 10⁻¹² or not finite.
    #[inline]
    fn normalized(self) -> Option<Self> {
        let n = self.norm();
        (n > 1e-12 && n.is_finite()).then(|| self * (1.0 / n))
    }

    /// Whether every coordinate is finite.
    #[inline]
    fn is_finite(&self) -> bool {
        self.as_slice().iter().all(|v| v.is_finite())
    }
}

impl<const N: usize> Coordinates for Vector<N> {
    const LEN: usize = N;
    const ZERO: Self = Vector([0.0; N]);

    #[inline(always)]
    fn from_fn(f: impl FnMut(usize) -> f32) -> Self {
        Vector(core::array::from_fn(f))
    }

    #[inline(always)]
    fn as_slice(&self) -> &[f32] {
        &self.0
    }
}

impl<const N: usize> Default for Vector<N> {
    fn default() -> Self {
        Self::ZERO
    }
}

impl<const N: usize> Index<usize> for Vector<N> {
    type Output = f32;
    #[inline(always)]
    fn index(&self, i: usize) -> &f32 {
        &self.0[i]
    }
}

impl<const N: usize> IndexMut<usize> for Vector<N> {
    #[inline(always)]
    fn index_mut(&mut self, i: usize) -> &mut f32 {
        &mut self.0[i]
    }
}

impl<const N: usize> Add for Vector<N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::from_fn(|i| self[i] + other[i])
    }
}

impl<const N: usize> AddAssign for Vector<N> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const N: usize> Sub for Vector<N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::from_fn(|i| self[i] - other[i])
    }
}

impl<const N: usize> Neg for Vector<N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::from_fn(|i| -self[i])
    }
}

impl<const N: usize> Mul<f32> for Vector<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: f32) -> Self {
        Self::from_fn(|i| self[i] * s)
    }
}

impl Vector<3> {
    /// Vector product, right-handed.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        Vector([
            self[1] * o[2] - self[2] * o[1],
            self[2] * o[0] - self[0] * o[2],
            self[0] * o[1] - self[1] * o[0],
        ])
    }

    /// Two unit vectors that make a right-handed frame with this one, which must have length one (Duff
    /// et al., *Building an orthonormal basis, revisited*, 2017).
    #[inline(always)]
    pub fn tangents(self) -> [Self; 2] {
        let n = self;
        let sign = if n[2] < 0.0 { -1.0 } else { 1.0 };
        let a = -1.0 / (sign + n[2]);
        let b = n[0] * n[1] * a;
        [
            Vector([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]]),
            Vector([b, sign + n[1] * n[1] * a, -n[1]]),
        ]
    }
}

/// What generic code may do with a [`Matrix`] whose size it does not know.
pub trait Square: Copy + Debug + PartialEq + Send + Sync + 'static {
    /// A row or a column.
    type Vector: Coordinates;
    /// All zero.
    const ZERO: Self;
    /// Ones on the diagonal.
    const IDENTITY: Self;

    /// Entry in `row`, `column`.
    fn at(&self, row: usize, column: usize) -> f32;

    /// Writable entry in `row`, `column`.
    fn at_mut(&mut self, row: usize, column: usize) -> &mut f32;

    /// Adds `weight · a·bᵀ`.
    fn add_outer(&mut self, weight: f32, a: Self::Vector, b: Self::Vector) {
        for i in 0..Self::Vector::LEN {
            for j in 0..Self::Vector::LEN {
                *self.at_mut(i, j) += weight * a[i] * b[j];
            }
        }
    }

    /// Multiplies every entry by `s`.
    fn scale(&mut self, s: f32) {
        for i in 0..Self::Vector::LEN {
            for j in 0..Self::Vector::LEN {
                *self.at_mut(i, j) *= s;
            }
        }
    }

    /// Whether every entry is finite.
    fn is_finite(&self) -> bool {
        (0..Self::Vector::LEN).all(|i| (0..Self::Vector::LEN).all(|j| self.at(i, j).is_finite()))
    }

    /// Eigenvalues in ascending order and the eigenvectors as *columns* in the same order, of the
    /// symmetric part of the matrix, by cyclic Jacobi rotations (at most twelve sweeps; relative
    /// error about 10⁻⁶ of the largest eigenvalue). A matrix that is not finite gives zeros and the
    /// identity.
    fn symmetric_eigen(&self) -> (Self::Vector, Self) {
        let n = Self::Vector::LEN;
        let mut vectors = Self::IDENTITY;
        if !self.is_finite() {
            return (Self::Vector::ZERO, vectors);
        }
        let mut a = Self::ZERO;
        for i in 0..n {
            for j in 0..n {
                *a.at_mut(i, j) = 0.5 * (self.at(i, j) + self.at(j, i));
            }
        }
        for _sweep in 0..12 {
            let (mut off, mut on) = (0.0, 0.0);
            for i in 0..n {
                on += a.at(i, i) * a.at(i, i);
                for j in 0..i {
                    off += a.at(i, j) * a.at(i, j);
                }
            }
            if off <= 1e-14 * on {
                break;
            }
            for p in 0..n {
                for q in p + 1..n {
                    jacobi_rotate(&mut a, &mut vectors, p, q);
                }
            }
        }
        sort_eigen(&a, &vectors)
    }
}

/// One Jacobi rotation that zeroes entry (p, q) of the symmetric `a`, accumulated in `v`.
fn jacobi_rotate<M: Square>(a: &mut M, v: &mut M, p: usize, q: usize) {
    let apq = a.at(p, q);
    if apq == 0.0 {
        return;
    }
    let tau = (a.at(q, q) - a.at(p, p)) / (2.0 * apq);
    let t = if tau.is_finite() {
        let s = if tau < 0.0 { -1.0 } else { 1.0 };
        s / (tau * s + math::sqrt(1.0 + tau * tau))
    } else {
        0.0
    };
    let c = 1.0 / math::sqrt(1.0 + t * t);
    let s = t * c;
    for k in 0..M::Vector::LEN {
        let (x, y) = (a.at(k, p), a.at(k, q));
        *a.at_mut(k, p) = c * x - s * y;
        *a.at_mut(k, q) = s * x + c * y;
    }
    for k in 0..M::Vector::LEN {
        let (x, y) = (a.at(p, k), a.at(q, k));
        *a.at_mut(p, k) = c * x - s * y;
        *a.at_mut(q, k) = s * x + c * y;
        let (x, y) = (v.at(k, p), v.at(k, q));
        *v.at_mut(k, p) = c * x - s * y;
        *v.at_mut(k, q) = s * x + c * y;
    }
}

/// Diagonal of `a` ascending, with the columns of `v` in the same order.
fn sort_eigen<M: Square>(a: &M, v: &M) -> (M::Vector, M) {
    let n = M::Vector::LEN;
    let mut values = M::Vector::from_fn(|i| a.at(i, i));
    let mut vectors = *v;
    for i in 0..n {
        let mut least = i;
        for j in i + 1..n {
            if values[j] < values[least] {
                least = j;
            }
        }
        if least != i {
            let swap = values[i];
            values[i] = values[least];
            values[least] = swap;
            for k in 0..n {
                let swap = vectors.at(k, i);
                *vectors.at_mut(k, i) = vectors.at(k, least);
                *vectors.at_mut(k, least) = swap;
            }
        }
    }
    (values, vectors)
}

impl<const N: usize> Square for Matrix<N> {
    type Vector = Vector<N>;
    const ZERO: Self = Matrix([[0.0; N]; N]);
    const IDENTITY: Self = {
        let mut m = [[0.0; N]; N];
        let mut i = 0;
        while i < N {
            m[i][i] = 1.0;
            i += 1;
        }
        Matrix(m)
    };

    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> f32 {
        self.0[row][column]
    }

    #[inline(always)]
    fn at_mut(&mut self, row: usize, column: usize) -> &mut f32 {
        &mut self.0[row][column]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn eigen_reconstructs(v in proptest::array::uniform6(proptest::array::uniform6(-3.0f32..3.0))) {
            let mut a = Matrix::<6>::ZERO;
            for i in 0..6 { for j in 0..6 { a.0[i][j] = v[i][j] + v[j][i]; } }
            let (w, u) = a.symmetric_eigen();
            for i in 0..6 {
                prop_assert!(i == 0 || w[i - 1] <= w[i]);
                for j in 0..6 {
                    let mut back = 0.0;
                    let mut orth = 0.0;
                    for k in 0..6 {
                        back += u.0[i][k] * w[k] * u.0[j][k];
                        orth += u.0[k][i] * u.0[k][j];
                    }
                    prop_assert!((back - a.0[i][j]).abs() < 2e-4);
                    let want = f32::from(u8::from(i == j));
                    prop_assert!((orth - want).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn eigen_of_nan_is_harmless() {
        let (w, u) = Matrix([[f32::NAN; 3]; 3]).symmetric_eigen();
        assert_eq!(w, Vector::ZERO);
        assert_eq!(u, Matrix::IDENTITY);
    }
}
