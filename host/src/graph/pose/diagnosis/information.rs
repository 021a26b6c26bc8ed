//! Whether information matrices make sense.

use nalgebra::{Cholesky, DMatrix, SMatrix};

use crate::graph::pose::{Group, PoseGraph};

/// What an information matrix does to errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Every error costs.
    Definite,
    /// Some errors cost, none is rewarded.
    Semidefinite,
    /// None costs.
    Zero,
    /// Some are rewarded, or it holds what is no finite number: χ² has no minimum.
    Indefinite {
        /// The most negative eigenvalue of its symmetric part; NaN where an entry is not finite.
        eigenvalue: f64,
    },
}

/// Between this and its negative an eigenvalue is zero but for the six digits that files have. Of the
/// matrix with ones on its diagonal, so that units do not matter.
const ROUNDING: f64 = 1e-5;

impl Kind {
    /// Of `information`.
    pub fn of<const D: usize>(information: &SMatrix<f64, D, D>) -> Kind {
        if information.iter().any(|v| !v.is_finite()) {
            return Kind::Indefinite { eigenvalue: f64::NAN };
        }
        if information.iter().all(|&v| v == 0.0) {
            return Kind::Zero;
        }
        let scaled = scaled(information);
        // Nearly always, and a small part of the work.
        if Cholesky::new(scaled - SMatrix::identity() * ROUNDING).is_some() {
            return Kind::Definite;
        }
        if smallest(&scaled) >= -ROUNDING {
            return Kind::Semidefinite;
        }
        Kind::Indefinite { eigenvalue: smallest(&(0.5 * (information + information.transpose()))) }
    }
}

/// The symmetric part with its rows and columns scaled so that the diagonal is 1, −1 or 0.
fn scaled<const D: usize>(information: &SMatrix<f64, D, D>) -> SMatrix<f64, D, D> {
    let scale = |i: usize| match information[(i, i)].abs().sqrt() {
        // A direction without weight must have no weight with others either.
        0.0 => 1.0,
        root => 1.0 / root,
    };
    SMatrix::from_fn(|i, j| 0.5 * (information[(i, j)] + information[(j, i)]) * scale(i) * scale(j))
}

fn smallest<const D: usize>(symmetric: &SMatrix<f64, D, D>) -> f64 {
    DMatrix::from_column_slice(D, D, symmetric.as_slice()).symmetric_eigenvalues().min()
}

/// In how many directions a sum of informations says nothing.
pub(super) fn nullity<const D: usize>(sum: &SMatrix<f64, D, D>) -> usize {
    let scaled = scaled(sum);
    let eigenvalues = DMatrix::from_column_slice(D, D, scaled.as_slice()).symmetric_eigenvalues();
    eigenvalues.iter().filter(|&&v| v <= ROUNDING).count()
}

/// The smallest and the largest of the positive entries on any diagonal.
pub(super) fn range<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Option<[f64; 2]> {
    let entries = graph.edges.iter().flat_map(|e| (0..D).map(|i| e.information[(i, i)]));
    let positive = entries.filter(|v| *v > 0.0 && v.is_finite());
    let [low, high] =
        positive.fold([f64::INFINITY, 0.0f64], |[low, high], v| [low.min(v), high.max(v)]);
    (low <= high).then_some([low, high])
}
