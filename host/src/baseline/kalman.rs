//! Kalman filters over the pose on the shared surface: what linearising costs.
//!
//! A contact measures that its distance to the surface, r = f/|g|, is zero with variance
//! σ_p² + V/|g|², and that the turn from the surface's gradient g to its normal is zero with variance
//! σ_θ² + V_g/|g|² per axis (thesis 3.9 with a scale). The extended filter differentiates these by
//! hand, the unscented one (Julier & Uhlmann, Proceedings of the IEEE 92, 2004) by sigma points in the
//! tangent space at the mean.

use nalgebra::{DMatrix, DVector};

use super::{Belief, Motion};
use crate::reference::filter::{LEAST_GRADIENT, retract};
use crate::reference::gpis::Evaluation;
use crate::reference::{Contact, Gpis};
use crate::space::{Point, Pose};

/// How the belief goes through the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transform {
    /// By the derivative at the mean.
    Linear,
    /// By sigma points about the mean.
    Unscented,
}

/// A Gaussian belief.
#[derive(Clone, Debug)]
pub struct Kalman {
    motion: Motion,
    transform: Transform,
    pose: Pose,
    /// Tangent coordinates at the pose.
    covariance: DMatrix<f64>,
}

/// What the contacts should measure, and how that goes with the pose.
struct Predicted {
    mean: DVector<f64>,
    /// Of the measurement, without its noise.
    covariance: DMatrix<f64>,
    /// Of pose (rows) and measurement.
    cross: DMatrix<f64>,
    /// Variances of the measurement's noise.
    noise: DVector<f64>,
}

/// κ of Julier and Uhlmann: the middle sigma point weighs 2κ times any other.
const KAPPA: f64 = 1.0;

impl Kalman {
    /// At the origin, without doubt.
    pub fn new(motion: Motion, transform: Transform) -> Kalman {
        let n = motion.freedom();
        Kalman { motion, transform, pose: Pose::identity(), covariance: DMatrix::zeros(n, n) }
    }

    /// Axes of rotation: in the plane the last one only.
    fn axes(&self) -> std::ops::Range<usize> {
        if self.motion.dimension == 2 { 2..3 } else { 0..3 }
    }

    /// What the contacts measure at `pose`: distances, then turns in world axes.
    fn residuals(&self, pose: &Pose, contacts: &[Contact], at: &[Evaluation]) -> DVector<f64> {
        let mut all = Vec::new();
        let inverse = pose.inverse();
        for (c, e) in contacts.iter().zip(at) {
            all.push(e.value / slope(e));
            if let Some(normal) = c.normal {
                let turn = pose.rotation * turn_between(&e.gradient, &(inverse.rotation * normal));
                all.extend(self.axes().map(|i| turn[i]));
            }
        }
        DVector::from_vec(all)
    }

    /// Their variances.
    fn noise(&self, contacts: &[Contact], at: &[Evaluation]) -> DVector<f64> {
        let mut all = Vec::new();
        for (c, e) in contacts.iter().zip(at) {
            let scale = slope(e).powi(-2);
            all.push(c.point_deviation.powi(2) + e.variance * scale);
            if c.normal.is_some() {
                let turn = c.normal_deviation.powi(2) + e.gradient_variance * scale;
                all.extend(self.axes().map(|_| turn));
            }
        }
        DVector::from_vec(all)
    }

    /// Derivative of [`residuals`](Self::residuals) with respect to the tangent at the mean; the
    /// surface's curvature is left out.
    fn derivative(&self, contacts: &[Contact], at: &[Evaluation]) -> DMatrix<f64> {
        let (dimension, n) = (self.motion.dimension, self.motion.freedom());
        let inverse = self.pose.inverse();
        let mut rows: Vec<f64> = Vec::new();
        for (c, e) in contacts.iter().zip(at) {
            let out = e.gradient / slope(e);
            let lever = c.transformed(&inverse).point.cross(&out);
            rows.extend((0..dimension).map(|i| -out[i]));
            rows.extend(self.axes().map(|i| -lever[i]));
            if c.normal.is_some() {
                // The normal turns against the object, but for turns about itself; in world axes.
                let unit = out.try_normalize(1e-9).unwrap_or_else(Point::zeros);
                for i in self.axes() {
                    let to_world = self.pose.rotation.to_rotation_matrix();
                    rows.extend((0..dimension).map(|_| 0.0));
                    rows.extend(self.axes().map(|j| {
                        let axis = Point::ith(j, 1.0);
                        -(to_world * (axis - unit * unit[j]))[i]
                    }));
                }
            }
        }
        DMatrix::from_row_slice(rows.len() / n, n, &rows)
    }

    fn predicted(&self, surface: &Gpis, contacts: &[Contact]) -> Option<Predicted> {
        let at = evaluate(surface, contacts, &self.pose);
        let noise = self.noise(contacts, &at);
        let middle = self.residuals(&self.pose, contacts, &at);
        if self.transform == Transform::Linear {
            let h = self.derivative(contacts, &at);
            let cross = &self.covariance * h.transpose();
            return Some(Predicted { mean: middle, covariance: &h * &cross, cross, noise });
        }
        let n = self.motion.freedom();
        let tiny = DMatrix::identity(n, n) * 1e-14;
        let root = (&self.covariance + tiny).cholesky()?.unpack() * (n as f64 + KAPPA).sqrt();
        let mut points = vec![(DVector::zeros(n), middle)];
        for i in 0..2 * n {
            let sign = if i < n { 1.0 } else { -1.0 };
            let offset = root.column(i % n) * sign;
            let pose = retract(self.motion.dimension, &self.pose, &offset);
            let seen = self.residuals(&pose, contacts, &evaluate(surface, contacts, &pose));
            points.push((offset, seen));
        }
        let weight = |i: usize| match i {
            0 => KAPPA / (n as f64 + KAPPA),
            _ => 0.5 / (n as f64 + KAPPA),
        };
        let m = noise.len();
        let mut mean = DVector::zeros(m);
        for (i, (_, seen)) in points.iter().enumerate() {
            mean += seen * weight(i);
        }
        let (mut covariance, mut cross) = (DMatrix::zeros(m, m), DMatrix::zeros(n, m));
        for (i, (offset, seen)) in points.iter().enumerate() {
            let off = seen - &mean;
            covariance += weight(i) * &off * off.transpose();
            cross += weight(i) * offset * off.transpose();
        }
        Some(Predicted { mean, covariance, cross, noise })
    }
}

impl Belief for Kalman {
    fn start(&mut self, pose: Pose) {
        self.pose = pose;
        self.covariance.fill(0.0);
    }

    fn predict(&mut self, motion: Option<&Pose>) {
        // A motion of the world leaves the tangent, which is in object axes, as it is.
        self.pose = motion.map_or(self.pose, |m| m * self.pose);
        self.pose.rotation.renormalize();
        for i in 0..self.motion.freedom() {
            self.covariance[(i, i)] += self.motion.deviation(i).powi(2);
        }
    }

    fn correct(&mut self, surface: &Gpis, contacts: &[Contact]) -> bool {
        if contacts.is_empty() {
            return false;
        }
        let Some(predicted) = self.predicted(surface, contacts) else { return false };
        let Predicted { mean, covariance, cross, noise } = predicted;
        let whole = (covariance + DMatrix::from_diagonal(&noise)).cholesky();
        let Some(whole) = whole else { return false };
        // The gain is cross·whole⁻¹; what should be seen is zero.
        let gain = whole.solve(&cross.transpose()).transpose();
        let step = -(&gain * mean);
        let less = &gain * cross.transpose();
        if !step.iter().chain(less.iter()).all(|x| x.is_finite()) {
            return false;
        }
        self.pose = retract(self.motion.dimension, &self.pose, &step);
        self.covariance -= less;
        self.covariance = (&self.covariance + self.covariance.transpose()) * 0.5;
        true
    }

    fn mean(&self) -> (Pose, DMatrix<f64>) {
        (self.pose, self.covariance.clone())
    }
}

fn evaluate(surface: &Gpis, contacts: &[Contact], pose: &Pose) -> Vec<Evaluation> {
    let inverse = pose.inverse();
    let points: Vec<Point> = contacts.iter().map(|c| c.transformed(&inverse).point).collect();
    surface.evaluate(&points)
}

fn slope(at: &Evaluation) -> f64 {
    at.gradient.norm().max(LEAST_GRADIENT)
}

/// The rotation vector that takes the direction of `a` to that of `b`.
fn turn_between(a: &Point, b: &Point) -> Point {
    let axis = a.cross(b);
    let sin = axis.norm();
    let angle = sin.atan2(a.dot(b));
    if sin > 1e-12 { axis * (angle / sin) } else { Point::zeros() }
}
