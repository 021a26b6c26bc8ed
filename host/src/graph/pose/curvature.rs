//! The least eigenvalue of a certificate matrix.

use nalgebra::{DMatrix, SymmetricEigen};

use super::blocks::Blocks;

/// Vectors of Lanczos' iteration at most.
const STEPS: usize = 40;

/// Converged when an eigenvalue is known to this part.
const ACCURACY: f64 = 1e-3;

/// The least eigenvalue λ of S x = λ B x, to a small part of itself, where B is a diagonal without
/// negative `sizes`; `None` where B is
/// zero or S is not positive definite where B has no say.
///
/// S + σ B is factorised for growing σ until it is positive definite: then −σ is just below λ, and
/// Lanczos' iteration (1950) on B½ (S + σ B)⁻¹ B½, whose greatest eigenvalue is 1/(λ + σ), needs few
/// steps. Where B leaves translations out, λ is that of the matrix with them eliminated, as in
/// SE-Sync.
pub(super) fn least<const H: usize>(matrix: &Blocks<'_, H>, sizes: &[f64]) -> Option<f64> {
    if !sizes.iter().any(|&size| size > 0.0) {
        return None;
    }
    let mut shift = 1e-9;
    let factor = loop {
        match matrix.raised(shift, sizes).factorised() {
            Ok(factor) => break factor,
            Err(_) if shift < 1e3 => shift *= 8.0,
            Err(_) => return None,
        }
    };
    let roots: Vec<f64> = sizes.iter().map(|size| size.sqrt()).collect();
    let apply = |x: &[f64]| -> Vec<f64> {
        let mut product: Vec<f64> = x.iter().zip(&roots).map(|(x, root)| x * root).collect();
        factor.solve(&mut product);
        product.iter_mut().zip(&roots).for_each(|(x, root)| *x *= root);
        product
    };
    Some(1.0 / greatest(apply, &roots)? - shift)
}

/// The greatest eigenvalue of a symmetric positive semidefinite operator, from below, whose vectors are zero
/// where `support` is.
fn greatest(apply: impl Fn(&[f64]) -> Vec<f64>, support: &[f64]) -> Option<f64> {
    // Any start will do that is not orthogonal to what is sought: numbers without a pattern.
    let start = (0..support.len()).map(|k| ((k as f64 + 1.0) * 0.618_033_988_75).fract() - 0.5);
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let (mut diagonal, mut beside) = (Vec::new(), Vec::<f64>::new());
    let mut next: Vec<f64> =
        start.zip(support).map(|(x, &s)| if s > 0.0 { x } else { 0.0 }).collect();
    let mut best = None;
    for step in 0..STEPS {
        let length = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        if step > 0 {
            beside.push(length);
        }
        if !(length > 1e-300) || !length.is_finite() {
            break;
        }
        next.iter_mut().for_each(|x| *x /= length);
        let mut product = apply(&next);
        diagonal.push(dot(&product, &next));
        basis.push(next);
        // Twice is enough (Kahan).
        for _ in 0..2 {
            for own in &basis {
                let share = dot(&product, own);
                product.iter_mut().zip(own).for_each(|(x, own)| *x -= share * own);
            }
        }
        let rest = product.iter().map(|x| x * x).sum::<f64>().sqrt();
        next = product;
        let size = diagonal.len();
        let small = DMatrix::from_fn(size, size, |r, c| match r.abs_diff(c) {
            0 => diagonal[r],
            1 => beside[r.min(c)],
            _ => 0.0,
        });
        let eigen = SymmetricEigen::new(small);
        let at = eigen.eigenvalues.imax();
        let value = eigen.eigenvalues[at];
        best = Some(value);
        if rest * eigen.eigenvectors[(size - 1, at)].abs() <= ACCURACY * value {
            break;
        }
    }
    best.filter(|&value| value > 0.0)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
