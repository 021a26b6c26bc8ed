//! How far a surface can lie from what is interpolated of it on a grid.

use super::Gpis;
use crate::math;
use crate::space::Space;
use crate::surface::cholesky::packed;
use crate::surface::kernel::Kernel;
use crate::surface::prior::Prior;

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// The largest possible errors of value (metres) and gradient when either is interpolated
    /// multilinearly between the corners of a cube with sides of `spacing` metres, anywhere in space,
    /// after the last refit: see [`Kernel::interpolation`]. The corners, weighed by the interpolation,
    /// have their mean at the point and a mean square distance of at most D·spacing²/4 from it. The
    /// norm of the mean without its prior is wᵀKw for the weights w = (K + Σ)⁻¹(y − m): what
    /// (y − m)ᵀw leaves beside wᵀΣw. The prior adds its own. In exact arithmetic;
    /// rounding adds some 10⁻⁶ of the values.
    pub fn interpolation_bound(&self, spacing: f32) -> (f32, f32) {
        let rows = self.factor.rows();
        let mut noise = 0.0;
        for i in 0..rows {
            let row = self.noise[packed(i)..packed(i + 1)].iter().zip(&self.weights);
            let sum: f32 = row.map(|(noise, w)| noise * w).sum();
            noise += self.weights[i] * (2.0 * sum - self.noise[packed(i) + i] * self.weights[i]);
        }
        // Single precision's part in the difference of two sums of this size.
        let square = math::max(self.misfit - noise, 0.0) + 1e-4 * self.misfit;
        let spread = 0.5 * math::sqrt(S::DIMENSION as f32) * spacing;
        let (value, gradient) = self.kernel.interpolation(spread);
        let (prior_value, prior_gradient) = self.prior.interpolation(spread);
        let norm = math::sqrt(square);
        (value * norm + prior_value, gradient * norm + prior_gradient)
    }
}
