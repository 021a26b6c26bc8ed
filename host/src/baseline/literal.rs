//! Algorithm 3.1 of the thesis as it is printed.
//!
//! Particles x + u + v with the noise v added to coordinates (3.7–3.8); likelihood exp(−Σ|f|) (3.9);
//! weights that replace, not multiply, the previous ones; a pose that is the weighted sum of
//! coordinates; resampling below half the effective particles. The likelihood is zero unless at least
//! four contacts lie within 10 mm of known ones (3.5.1; the distance is not printed). The surface is a
//! squared exponential about zero with values ±1 beside each contact (2.2.2). Where the print is
//! silent the kinder reading is taken: planar angles are summed without a seam, and quaternions with
//! one sign; where every weight is zero, the pose is the prediction.

use nalgebra::{DMatrix, Quaternion, UnitQuaternion};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

use super::{Belief, Model, Motion, effective, normal, resampled};
use crate::reference::filter::local;
use crate::reference::{Contact, Gate, Gpis, Kernel, Prior, Training};
use crate::space::{Point, Pose, angle, planar};

/// What the thesis needed in the plane (figure 3.14).
pub const PARTICLES: usize = 10_000;

/// How far beside a contact the surface is ±1, metres: the thesis does not say.
const BESIDE: f64 = 0.01;

/// The thesis' surface. The reference scales fields as distances, so that f = ±[`BESIDE`] here is
/// f = ±1 there.
pub(super) const MODEL: Model = Model {
    kernel: Kernel::SquaredExponential { amplitude: BESIDE, lengthscale: 0.025 },
    training: Training::OffSurface { distance: BESIDE },
    prior: |_| Prior::Constant(0.0),
    doubts: false,
};

/// Four contacts within 10 mm.
const GATE: Gate = Gate { contacts: 4, distance: 0.01 };

/// One hypothesis.
#[derive(Clone, Copy, Debug)]
struct Particle {
    pose: Pose,
    /// In the plane: the sum of all turns, without a seam.
    turn: f64,
    weight: f64,
}

/// The belief: weighted particles.
#[derive(Clone, Debug)]
pub struct Literal {
    motion: Motion,
    particles: Vec<Particle>,
    random: Xoshiro256PlusPlus,
}

impl Literal {
    /// So many particles (at least one), at the origin.
    pub fn new(motion: Motion, particles: usize, seed: u64) -> Literal {
        let count = particles.max(1);
        let one = Particle { pose: Pose::identity(), turn: 0.0, weight: 1.0 / count as f64 };
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Literal { motion, particles: vec![one; count], random }
    }

    /// The contacts' places in the object frame where the gate lets the particle through.
    fn seen(&self, pose: &Pose, surface: &Gpis, contacts: &[Contact]) -> Option<Vec<Point>> {
        let inverse = pose.inverse();
        let points: Vec<Point> = contacts.iter().map(|c| c.transformed(&inverse).point).collect();
        let close = points.iter().filter(|p| surface.nearest(p) < GATE.distance).count();
        (close >= GATE.contacts.min(points.len())).then_some(points)
    }
}

impl Belief for Literal {
    fn start(&mut self, pose: Pose) {
        let weight = 1.0 / self.particles.len() as f64;
        self.particles.fill(Particle { pose, turn: angle(&pose), weight });
    }

    fn predict(&mut self, motion: Option<&Pose>) {
        // The previous grasp's resampling: its weights were still those of its mean.
        let weights: Vec<f64> = self.particles.iter().map(|p| p.weight).collect();
        if let Some(chosen) = resampled(&weights, &mut self.random) {
            let weight = 1.0 / weights.len() as f64;
            let copy = |i| Particle { weight, ..self.particles[i] };
            self.particles = chosen.into_iter().map(copy).collect();
        }
        let Motion { dimension, translation, rotation } = self.motion;
        for particle in &mut self.particles {
            let moved = motion.map_or(particle.pose, |m| m * particle.pose);
            let mut draw = || normal(&mut self.random);
            let shift = Point::new(draw(), draw(), if dimension == 2 { 0.0 } else { draw() });
            let place = moved.translation.vector + shift * translation;
            if dimension == 2 {
                particle.turn += motion.map_or(0.0, angle) + rotation * draw();
                particle.pose = planar(place.x, place.y, particle.turn);
            } else {
                let turn = Point::new(draw(), draw(), draw()) * rotation;
                let turned = UnitQuaternion::from_scaled_axis(turn) * moved.rotation;
                particle.pose = Pose::from_parts(place.into(), turned);
            }
        }
    }

    fn correct(&mut self, surface: &Gpis, contacts: &[Contact]) -> bool {
        let seen: Vec<Option<Vec<Point>>> =
            self.particles.iter().map(|p| self.seen(&p.pose, surface, contacts)).collect();
        let points: Vec<Point> = seen.iter().flatten().flatten().copied().collect();
        let mut values = surface.means(&points).into_iter();
        let likelihoods: Vec<f64> = seen
            .iter()
            .map(|points| match points {
                Some(points) => {
                    let sum: f64 = values.by_ref().take(points.len()).map(f64::abs).sum();
                    (-sum / BESIDE).exp()
                }
                None => 0.0,
            })
            .collect();
        let total: f64 = likelihoods.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return false;
        }
        for (particle, likelihood) in self.particles.iter_mut().zip(likelihoods) {
            particle.weight = likelihood / total;
        }
        true
    }

    fn mean(&self) -> (Pose, DMatrix<f64>) {
        let (mut place, mut turn, mut sum) = (Point::zeros(), 0.0, Quaternion::identity() * 0.0);
        let first = self.particles[0].pose.rotation.into_inner();
        for p in &self.particles {
            place += p.pose.translation.vector * p.weight;
            turn += p.turn * p.weight;
            let q = p.pose.rotation.into_inner();
            sum += q * (p.weight * first.dot(&q).signum());
        }
        let mean = match self.motion.dimension {
            2 => planar(place.x, place.y, turn),
            _ => Pose::from_parts(place.into(), UnitQuaternion::new_normalize(sum)),
        };
        let freedom = self.motion.freedom();
        let mut covariance = DMatrix::zeros(freedom, freedom);
        for p in &self.particles {
            let d = local(self.motion.dimension, &mean, &p.pose);
            covariance += p.weight * &d * d.transpose();
        }
        (mean, covariance)
    }

    fn effective(&self) -> f64 {
        effective(self.particles.iter().map(|p| p.weight))
    }
}
