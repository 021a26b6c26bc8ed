//! What a surface of experts says at points. Points are sorted by the experts that have a say
//! there, so that each is looked up once and answers for many points at a time.

use rayon::prelude::*;

use super::Experts;
use super::partition::Share;
use crate::reference::Gpis;
use crate::shape::Field;
use crate::space::Point;

/// Points sorted together: what is kept of them meanwhile is a few megabytes.
const BATCH: usize = 16_384;

/// Points that one task asks one expert for.
const BLOCK: usize = 384;

/// A leaf, and the number of a point and of the leaf's share among those at the point.
type Asked = (u32, u32, u32);

impl Experts {
    /// Posterior mean of the field at each point, metres.
    pub fn means(&self, points: &[Point]) -> Vec<f64> {
        let residuals = |leaf: u32, at: &[Point]| self.fitted(leaf).expert.means(at);
        self.blended(points, 0.0, residuals, |p, said| {
            let residual = |(share, mean): &(Share, f64)| share.weight * mean;
            self.settings().prior.value(p) + said.iter().map(residual).sum::<f64>()
        })
    }

    /// Gradient of the mean at each point.
    pub fn gradients(&self, points: &[Point]) -> Vec<Point> {
        self.means_and_gradients(points).into_iter().map(|(_, gradient)| gradient).collect()
    }

    /// Posterior mean, metres, and its gradient at each point.
    pub fn means_and_gradients(&self, points: &[Point]) -> Vec<(f64, Point)> {
        let silent = (0.0, Point::zeros());
        let residuals = |leaf: u32, at: &[Point]| self.fitted(leaf).expert.means_and_gradients(at);
        self.blended(points, silent, residuals, |p, said| {
            let prior = self.settings().prior;
            let mut sum = (prior.value(p), prior.gradient(p));
            for (share, (value, gradient)) in said {
                sum.0 += share.weight * value;
                sum.1 += gradient * share.weight + share.slope * *value;
            }
            (sum.0, self.flat(&sum.1))
        })
    }

    /// Variance of the field at each point, m²: that of the mixture of the experts.
    pub fn variances(&self, points: &[Point]) -> Vec<f64> {
        let silent = (0.0, self.settings().kernel.radial(0.0).value);
        let moments = |leaf: u32, at: &[Point]| {
            let fitted = self.fitted(leaf);
            let variances = fitted.expert.variances(&self.factor(leaf, &fitted), at);
            fitted.expert.means(at).into_iter().zip(variances).collect()
        };
        self.blended(points, silent, moments, |_, said| {
            let mean: f64 = said.iter().map(|(share, (mean, _))| share.weight * mean).sum();
            said.iter().map(|(share, (m, v))| share.weight * (v + (m - mean).powi(2))).sum()
        })
    }

    /// At each point, `blend` of the shares there with what `answer` says for their leaves, or
    /// `silent` where there is no expert.
    fn blended<T: Copy + Send + Sync, U: Send>(
        &self,
        points: &[Point],
        silent: T,
        answer: impl Fn(u32, &[Point]) -> Vec<T> + Sync,
        blend: impl Fn(&Point, &[(Share, T)]) -> U + Sync,
    ) -> Vec<U> {
        let batch = |points: &[Point]| -> Vec<U> {
            let points: Vec<Point> = points.iter().map(|p| self.flat(p)).collect();
            let said = self.said(&points, silent, &answer);
            points.par_iter().zip(&said).map(|(p, said)| blend(p, said)).collect()
        };
        points.chunks(BATCH).flat_map(batch).collect()
    }

    /// The shares at each point with what was said for them.
    fn said<T: Copy + Send + Sync>(
        &self,
        points: &[Point],
        silent: T,
        answer: &(impl Fn(u32, &[Point]) -> Vec<T> + Sync),
    ) -> Vec<Vec<(Share, T)>> {
        let shares = |p: &Point| -> Vec<(Share, T)> {
            self.partition.shares(p).into_iter().map(|share| (share, silent)).collect()
        };
        let mut said: Vec<Vec<(Share, T)>> = points.par_iter().map(shares).collect();
        let mut asked: Vec<Asked> = Vec::new();
        for (point, shares) in said.iter().enumerate() {
            let leaves = shares.iter().enumerate();
            asked.extend(leaves.filter_map(|(i, s)| Some((s.0.leaf?, point as u32, i as u32))));
        }
        asked.sort_unstable();
        let tasks: Vec<&[Asked]> =
            asked.chunk_by(|a, b| a.0 == b.0).flat_map(|same| same.chunks(BLOCK)).collect();
        let answers: Vec<Vec<T>> = tasks
            .par_iter()
            .map(|task| {
                let at: Vec<Point> = task.iter().map(|(_, p, _)| points[*p as usize]).collect();
                answer(task[0].0, &at)
            })
            .collect();
        for ((_, point, place), answer) in asked.iter().zip(answers.into_iter().flatten()) {
            said[*point as usize][*place as usize].1 = answer;
        }
        said
    }

    /// Planar fields ignore z.
    fn flat(&self, p: &Point) -> Point {
        if self.settings().dimension == 2 { Point::new(p.x, p.y, 0.0) } else { *p }
    }
}

impl Field for Experts {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.means(points)
    }

    fn first_order(&self, points: &[Point], _step: f64) -> Vec<(f64, Point)> {
        self.means_and_gradients(points)
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let slopes = self.gradients(points);
        let slopes = slopes.into_iter().map(|g| g.norm().max(Gpis::LEAST_GRADIENT));
        self.variances(points).into_iter().zip(slopes).map(|(v, slope)| v.sqrt() / slope).collect()
    }
}
