//! One expert: the exact Gaussian process of the residual f − prior over a bounded number of
//! summaries.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::{DMatrix, DVector};

use super::pyramid::Stamped;
use super::site::Observation;
use crate::dense::Cholesky;
use crate::reference::Kernel;
use crate::space::Point;

/// Least variance of a row in units of its prior variance: keeps the matrix well conditioned where
/// thousands of contacts coincide. If rounding still spoils it, the next of these is tried.
const FLOORS: [f64; 4] = [1e-9, 1e-7, 1e-5, 1e-3];

/// A summary's gradient is left out where its variance exceeds this share of the prior's.
const VAGUE: f64 = 0.06;

/// One point and what is known there.
#[derive(Clone, Copy, Debug)]
struct Node {
    point: Point,
    /// First row of the matrix: the value's, then the slopes' if there are any.
    row: usize,
    felt: bool,
    /// K⁻¹ y.
    value: f64,
    slopes: Point,
}

/// Bytes that factors may take together; what does not fit is computed anew for every batch.
#[derive(Clone, Debug)]
pub struct Budget {
    taken: Arc<AtomicUsize>,
    most: usize,
}

/// A factor within the budget.
#[derive(Debug)]
struct Kept {
    factor: Cholesky,
    bytes: usize,
    budget: Budget,
}

impl Drop for Kept {
    fn drop(&mut self) {
        self.budget.taken.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Budget {
    /// Of so many bytes.
    pub fn new(most: usize) -> Budget {
        Budget { taken: Arc::default(), most }
    }

    /// Bytes in use.
    pub fn taken(&self) -> usize {
        self.taken.load(Ordering::Relaxed)
    }

    fn keep(&self, factor: Cholesky) -> Option<Kept> {
        let bytes = 8 * factor.rows() * factor.rows();
        let room = |taken: usize| taken.checked_add(bytes).filter(|sum| *sum <= self.most);
        self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, room).ok()?;
        Some(Kept { factor, bytes, budget: self.clone() })
    }
}

/// A fitted expert.
#[derive(Debug)]
pub struct Expert {
    kernel: Kernel,
    dimension: usize,
    /// What it was made of.
    pub sources: Vec<Stamped>,
    nodes: Vec<Node>,
    noise: Vec<f64>,
    factor: Option<Kept>,
}

impl Expert {
    /// Fits the residual to observations: (whether its gradient counts however vague, what is
    /// seen).
    pub fn fit(
        kernel: Kernel,
        dimension: usize,
        sources: Vec<Stamped>,
        observations: &[(bool, Observation)],
        budget: &Budget,
    ) -> Expert {
        let origin = kernel.radial(0.0);
        let mut nodes = Vec::with_capacity(observations.len());
        let (mut noise, mut targets) = (Vec::new(), Vec::new());
        for (near, seen) in observations {
            let slope = seen.slope.filter(|(_, v)| *near || *v < -VAGUE * origin.slope);
            let row = noise.len();
            noise.push(seen.value.1);
            targets.push(seen.value.0);
            if let Some((slope, variance)) = slope {
                noise.extend((0..dimension).map(|_| variance));
                targets.extend((0..dimension).map(|axis| slope[axis]));
            }
            let (value, slopes) = (0.0, Point::zeros());
            nodes.push(Node { point: seen.point, row, felt: slope.is_some(), value, slopes });
        }
        let targets = DVector::from_vec(targets);
        let mut expert = Expert { kernel, dimension, sources, nodes, noise, factor: None };
        for floor in FLOORS {
            expert.floor(floor);
            let Some(factor) = expert.factor() else { continue };
            let weights = factor.solve(&targets);
            if !weights.iter().all(|w| w.is_finite()) {
                continue;
            }
            for node in &mut expert.nodes {
                node.value = weights[node.row];
                if node.felt {
                    for axis in 0..dimension {
                        node.slopes[axis] = weights[node.row + 1 + axis];
                    }
                }
            }
            expert.factor = budget.keep(factor);
            return expert;
        }
        // Not even with large noise: what is left is the prior.
        expert.nodes.clear();
        expert.noise.clear();
        expert
    }

    /// Rows of its matrix.
    pub fn rows(&self) -> usize {
        self.noise.len()
    }

    fn floor(&mut self, share: f64) {
        let origin = self.kernel.radial(0.0);
        for node in &self.nodes {
            let value = &mut self.noise[node.row];
            *value = value.max(share * origin.value);
            if node.felt {
                for v in &mut self.noise[node.row + 1..=node.row + self.dimension] {
                    *v = v.max(-share * origin.slope);
                }
            }
        }
    }

    fn factor(&self) -> Option<Cholesky> {
        let n = self.rows();
        let mut matrix = DMatrix::zeros(n, n);
        for (j, b) in self.nodes.iter().enumerate() {
            for a in &self.nodes[j..] {
                let e = a.point - b.point;
                let k = self.kernel.radial(e.norm());
                let (row, column) = (a.row, b.row);
                matrix[(row, column)] = k.value;
                for axis in 0..self.dimension {
                    if a.felt {
                        matrix[(row + 1 + axis, column)] = k.slope * e[axis];
                    }
                    if b.felt {
                        matrix[(row, column + 1 + axis)] = -k.slope * e[axis];
                    }
                    if a.felt && b.felt {
                        for other in 0..self.dimension {
                            let own = if axis == other { k.slope } else { 0.0 };
                            matrix[(row + 1 + axis, column + 1 + other)] =
                                -(k.bend * e[axis] * e[other] + own);
                        }
                    }
                }
            }
        }
        for (i, variance) in self.noise.iter().enumerate() {
            matrix[(i, i)] += variance;
        }
        Cholesky::new(matrix).ok()
    }

    /// Posterior mean of the residual and its gradient.
    pub fn residual(&self, p: &Point) -> (f64, Point) {
        let (mut value, mut gradient) = (0.0, Point::zeros());
        for node in &self.nodes {
            let e = p - node.point;
            let k = self.kernel.radial(e.norm());
            let along = e.dot(&node.slopes);
            value += k.value * node.value - k.slope * along;
            gradient += e * (k.slope * node.value - k.bend * along) - node.slopes * k.slope;
        }
        (value, gradient)
    }

    /// Posterior mean of the residual.
    pub fn mean(&self, p: &Point) -> f64 {
        let mut value = 0.0;
        for node in &self.nodes {
            let e = p - node.point;
            let k = self.kernel.radial(e.norm());
            value += k.value * node.value - k.slope * e.dot(&node.slopes);
        }
        value
    }

    /// Posterior variance of the value at each point, m².
    pub fn variances(&self, points: &[Point]) -> Vec<f64> {
        let prior = self.kernel.radial(0.0).value;
        let mut cross = DMatrix::zeros(self.rows(), points.len());
        for (p, mut column) in points.iter().zip(cross.column_iter_mut()) {
            for node in &self.nodes {
                let e = node.point - p;
                let k = self.kernel.radial(e.norm());
                column[node.row] = k.value;
                if node.felt {
                    for axis in 0..self.dimension {
                        column[node.row + 1 + axis] = k.slope * e[axis];
                    }
                }
            }
        }
        match &self.factor {
            Some(kept) => kept.factor.forward(&mut cross),
            // Factored before with the same numbers, so it can be again.
            None => match self.factor() {
                Some(factor) => factor.forward(&mut cross),
                None => cross.fill(0.0),
            },
        }
        cross.column_iter().map(|c| (prior - c.norm_squared()).max(0.0)).collect()
    }
}
