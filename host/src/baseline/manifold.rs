//! The manifold particle filter: poses drawn where the object is in contact.
//!
//! A motion model puts next to no particles on the thin set of poses at which a contact lies on the
//! surface; a precise sensor then leaves almost none of them (thesis 5.2.2). Koval, Pollard &
//! Srinivasa (International Journal of Robotics Research 34, 2015) draw from that set instead and
//! weigh by the motion model; with a share of particles drawn the usual way, as they do, nothing is
//! excluded. Here a particle is drawn from a widened motion model, moved onto the set of one contact
//! of the grasp, chosen at random, along the shortest way in deviations of the motion, and weighed by
//! motion and all other contacts over the density it was drawn with.

use nalgebra::{DMatrix, DVector};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

use super::{Belief, Motion, effective, normal, resampled, uniform};
use crate::reference::filter::{LEAST_GRADIENT, Particle, local, log_likelihood, mean, retract};
use crate::reference::{Contact, Gpis};
use crate::space::{Point, Pose};

/// Particles of the comparison.
pub const PARTICLES: usize = 500;

/// Share that is drawn from the motion model alone.
const USUAL: f64 = 0.25;

/// How much wider than the motion model poses are drawn before they are moved.
const WIDER: f64 = 1.5;

/// Newton steps onto the set.
const STEPS: usize = 4;

/// The belief: weighted particles.
#[derive(Clone, Debug)]
pub struct Manifold {
    motion: Motion,
    particles: Vec<Particle>,
    /// Where the hand meant each of them to be.
    meant: Vec<Pose>,
    random: Xoshiro256PlusPlus,
}

/// A pose that is drawn: from where, by which contact, and how.
struct Draw {
    /// Where the hand meant it to be.
    meant: Pose,
    pose: Pose,
    /// The contact that it was moved onto.
    contact: Option<usize>,
    log_weight: f64,
}

impl Manifold {
    /// So many particles (at least one), at the origin.
    pub fn new(motion: Motion, particles: usize, seed: u64) -> Manifold {
        let count = particles.max(1);
        let one = Particle { pose: Pose::identity(), weight: 1.0 / count as f64 };
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let (particles, meant) = (vec![one; count], vec![one.pose; count]);
        Manifold { motion, particles, meant, random }
    }

    /// `pose` displaced by the motion noise times `wider`.
    fn disturbed(&mut self, pose: &Pose, wider: f64) -> Pose {
        let n = self.motion.freedom();
        let noise: Vec<f64> =
            (0..n).map(|i| wider * self.motion.deviation(i) * normal(&mut self.random)).collect();
        retract(self.motion.dimension, pose, &DVector::from_vec(noise))
    }

    /// A tangent in deviations of the motion.
    fn whitened(&self, mut tangent: DVector<f64>) -> DVector<f64> {
        for i in 0..tangent.len() {
            tangent[i] /= self.motion.deviation(i);
        }
        tangent
    }

    /// Moves every draw that has a contact onto the poses at which this lies on the surface, and says
    /// how the distance changes there, per deviation of the motion.
    fn project(
        &self,
        draws: &mut [Draw],
        surface: &Gpis,
        contacts: &[Contact],
    ) -> Vec<DVector<f64>> {
        let (dimension, n) = (self.motion.dimension, self.motion.freedom());
        let mut slopes = vec![DVector::zeros(n); draws.len()];
        for _ in 0..STEPS {
            let points: Vec<Point> = draws
                .iter()
                .map(|d| {
                    let inverse = d.pose.inverse();
                    d.contact.map_or(Point::zeros(), |c| contacts[c].transformed(&inverse).point)
                })
                .collect();
            let fields = surface.means_and_gradients(&points).into_iter();
            for (((draw, point), (value, gradient)), slope) in
                draws.iter_mut().zip(&points).zip(fields).zip(&mut slopes)
            {
                if draw.contact.is_none() {
                    continue;
                }
                let length = gradient.norm().max(LEAST_GRADIENT);
                let out = gradient / length;
                let lever = point.cross(&out);
                let row = match dimension {
                    2 => vec![-out.x, -out.y, -lever.z],
                    _ => vec![-out.x, -out.y, -out.z, -lever.x, -lever.y, -lever.z],
                };
                for i in 0..n {
                    slope[i] = row[i] * self.motion.deviation(i);
                }
                // The shortest way in deviations, and no farther than three of them.
                let mut way = &*slope * (-(value / length) / slope.norm_squared().max(1e-18));
                way *= (3.0 / way.norm().max(1e-12)).min(1.0);
                for i in 0..n {
                    way[i] *= self.motion.deviation(i);
                }
                draw.pose = retract(dimension, &draw.pose, &way);
            }
        }
        slopes
    }

    /// Log of the motion's density over the one a moved pose was drawn with, but for the contact it
    /// was moved onto: that one's likelihood integrates to one across the set.
    fn correction(&self, draw: &Draw, slope: &DVector<f64>) -> f64 {
        let n = self.motion.freedom() as f64;
        let off = self.whitened(local(self.motion.dimension, &draw.meant, &draw.pose));
        let steep = slope.norm().max(1e-9);
        let across = slope.dot(&off) / steep;
        let along = off.norm_squared() - across * across;
        -0.5 * off.norm_squared() + 0.5 * along / (WIDER * WIDER) + (n - 1.0) * WIDER.ln()
            - 0.5 * std::f64::consts::TAU.ln()
            - steep.ln()
    }
}

impl Belief for Manifold {
    fn start(&mut self, pose: Pose) {
        let weight = 1.0 / self.particles.len() as f64;
        self.particles.fill(Particle { pose, weight });
    }

    fn predict(&mut self, motion: Option<&Pose>) {
        let weights: Vec<f64> = self.particles.iter().map(|p| p.weight).collect();
        if let Some(chosen) = resampled(&weights, &mut self.random) {
            let weight = 1.0 / weights.len() as f64;
            let copy = |i| Particle { weight, ..self.particles[i] };
            self.particles = chosen.into_iter().map(copy).collect();
        }
        for i in 0..self.particles.len() {
            let pose = self.particles[i].pose;
            self.meant[i] = motion.map_or(pose, |m| m * pose);
            self.particles[i].pose = self.disturbed(&self.meant[i].clone(), 1.0);
        }
    }

    fn correct(&mut self, surface: &Gpis, contacts: &[Contact]) -> bool {
        let mut draws = Vec::with_capacity(self.particles.len());
        for i in 0..self.particles.len() {
            let (Particle { mut pose, weight }, meant) = (self.particles[i], self.meant[i]);
            let mut contact = None;
            if uniform(&mut self.random) > USUAL {
                pose = self.disturbed(&meant, WIDER);
                let pick = (uniform(&mut self.random) * contacts.len() as f64) as usize;
                contact = Some(pick.min(contacts.len().saturating_sub(1)));
            }
            draws.push(Draw { meant, pose, contact, log_weight: weight.ln() });
        }
        let slopes = self.project(&mut draws, surface, contacts);
        let felt: Vec<Contact> = draws
            .iter()
            .flat_map(|d| {
                let inverse = d.pose.inverse();
                contacts.iter().map(move |c| c.transformed(&inverse))
            })
            .collect();
        let points: Vec<Point> = felt.iter().map(|c| c.point).collect();
        let evaluations = surface.evaluate(&points);
        let dimension = self.motion.dimension;
        let each = felt.chunks(contacts.len()).zip(evaluations.chunks(contacts.len()));
        for ((draw, slope), (felt, at)) in draws.iter_mut().zip(&slopes).zip(each) {
            let evidence = felt.iter().zip(at).map(|(c, e)| log_likelihood(dimension, c, e));
            let mut log = evidence.sum::<f64>();
            if let Some(chosen) = draw.contact {
                let bare = Contact { normal: None, ..felt[chosen] };
                log -= log_likelihood(dimension, &bare, &at[chosen]);
                log += self.correction(draw, slope);
            }
            draw.log_weight += log;
        }
        let best = draws.iter().map(|d| d.log_weight).fold(f64::NEG_INFINITY, f64::max);
        if !best.is_finite() {
            return false;
        }
        let total: f64 = draws.iter().map(|d| (d.log_weight - best).exp()).sum();
        let particles = draws
            .iter()
            .map(|d| Particle { pose: d.pose, weight: (d.log_weight - best).exp() / total });
        self.particles = particles.collect();
        true
    }

    fn mean(&self) -> (Pose, DMatrix<f64>) {
        mean(self.motion.dimension, &self.particles)
    }

    fn effective(&self) -> f64 {
        effective(self.particles.iter().map(|p| p.weight))
    }
}
