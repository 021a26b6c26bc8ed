//! Systems too densely connected to be factorised.

use super::{BlockMatrix, Factor, Structure};

/// How an iterative solution ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reached {
    /// Products with the matrix.
    pub steps: usize,
    /// Whether the accuracy asked for was reached.
    pub accurate: bool,
}

/// Steps at most.
const STEPS: usize = 600;

/// Replaces `x`, a vector by position, by A⁻¹ x, where the diagonal of A is that of `matrix` times
/// 1 + `damping`, as in `factor`.
///
/// Where the structure is complete that is the factor's solution. Else it is by conjugate gradients
/// (Hestenes and Stiefel 1952), preconditioned by the factor: that of the diagonal, to which all
/// measurements contribute, and of the pairs inside. It is exact for trees, and near A for graphs so
/// densely connected that single pairs matter little beside the diagonal. Ends when the residual has fallen to
/// `accuracy` of what it was, in the norm of the factor.
pub fn conjugate_gradients<const B: usize>(
    structure: &Structure,
    factor: &Factor<B>,
    matrix: &BlockMatrix<B>,
    damping: f64,
    x: &mut [f64],
    accuracy: f64,
) -> Reached {
    if structure.is_complete() {
        factor.solve(structure, x);
        return Reached { steps: 0, accurate: true };
    }
    let mut residual = x.to_vec();
    x.fill(0.0);
    let mut direction = residual.clone();
    factor.solve(structure, &mut direction);
    let mut size = dot(&residual, &direction);
    let enough = size * accuracy * accuracy;
    for steps in 0..STEPS {
        if !(size > enough) {
            return Reached { steps, accurate: size.is_finite() };
        }
        let mut product = matrix.times(structure, &direction);
        if damping > 0.0 {
            let diagonals = matrix.diagonal.iter().zip(direction.chunks_exact(B));
            for (own, (block, x)) in product.chunks_exact_mut(B).zip(diagonals) {
                (0..B).for_each(|r| own[r] += damping * block[(r, r)] * x[r]);
            }
        }
        let bend = dot(&direction, &product);
        if !(bend > 0.0) {
            // Rounding has used up what the matrix distinguishes.
            return Reached { steps, accurate: false };
        }
        let share = size / bend;
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += share * d);
        residual.iter_mut().zip(&product).for_each(|(r, p)| *r -= share * p);
        product.copy_from_slice(&residual);
        factor.solve(structure, &mut product);
        let before = std::mem::replace(&mut size, dot(&residual, &product));
        let turn = size / before;
        direction.iter_mut().zip(&product).for_each(|(d, z)| *d = z + turn * *d);
    }
    Reached { steps: STEPS, accurate: false }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
