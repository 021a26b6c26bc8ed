//! What is known of several points together.

use super::Gpis;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::Joint;
use crate::surface::kernel::Kernel;
use crate::surface::prior::Prior;

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Joint<S> for Gpis<S, K, P, SITES, ROWS, PACKED>
{
    fn values<const L: usize>(&self, points: &[S::Vector; L]) -> [f32; L] {
        Gpis::values(self, points)
    }

    /// Exactly; takes `N`·`ROWS` numbers of stack and about n²/2 multiplications a point.
    fn joint<const N: usize>(&self, points: &[S::Vector]) -> [[f32; N]; N] {
        let mut white = [[0.0; ROWS]; N];
        for (row, point) in white.iter_mut().zip(points) {
            self.whiten(*point, 0, row);
        }
        let mut covariance = [[0.0; N]; N];
        for i in 0..points.len().min(N) {
            for j in 0..=i {
                let mut sum = self.kernel.value((points[i] - points[j]).norm_squared());
                for (a, b) in white[i].iter().zip(&white[j]).take(self.factor.rows()) {
                    sum -= a * b;
                }
                let sum = if i == j { sum.max(0.0) } else { sum };
                (covariance[i][j], covariance[j][i]) = (sum, sum);
            }
        }
        covariance
    }

    /// One point for each contact that is held.
    fn touched(&self) -> impl Iterator<Item = S::Vector> + Clone + '_ {
        self.leaders().map(|leader| self.sites[leader].point)
    }
}
