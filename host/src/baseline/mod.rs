//! Trackers of other schools, in double precision and as plain as they come: what the core's trackers
//! are compared with.
//!
//! All of them follow one object with one shared surface, as the thesis does (Algorithm 3.1): predict
//! the pose with the motion, correct it with the grasp on the surface so far, add the grasp to the
//! surface at the corrected pose. They differ in the belief over the pose and, the literal filter, in
//! the surface.

pub mod kalman;
pub mod literal;
pub mod manifold;

use nalgebra::{DMatrix, Matrix6, UnitQuaternion};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::Rng;
use tactile_core::track::Status;

use crate::log::GraspLog;
use crate::reference::filter::systematic;
use crate::reference::tracker::placed;
use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::slam::deviations;
use crate::slam::track::{Step, settings};
use crate::space::{Pose, centroid};
use kalman::{Kalman, Transform};
use literal::Literal;
use manifold::Manifold;

/// The trackers to compare with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// Algorithm 3.1 as it is printed, with 10 000 particles.
    Literal,
    /// The extended Kalman filter.
    Extended,
    /// The unscented Kalman filter.
    Unscented,
    /// The manifold particle filter.
    Manifold,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Baseline; 4] =
        [Baseline::Literal, Baseline::Extended, Baseline::Unscented, Baseline::Manifold];

    /// As tables name it.
    pub fn name(self) -> &'static str {
        match self {
            Baseline::Literal => "literal",
            Baseline::Extended => "ekf",
            Baseline::Unscented => "ukf",
            Baseline::Manifold => "manifold",
        }
    }

    /// Follows the object through the log: one step per grasp, the same for the same seed.
    pub fn follow(self, log: &GraspLog, seed: u64) -> Vec<Step> {
        let motion = Motion::of(log);
        match self {
            Baseline::Literal => literal(log, literal::PARTICLES, seed),
            Baseline::Extended => {
                follow(log, &CALIBRATED, &mut Kalman::new(motion, Transform::Linear))
            }
            Baseline::Unscented => {
                follow(log, &CALIBRATED, &mut Kalman::new(motion, Transform::Unscented))
            }
            Baseline::Manifold => {
                follow(log, &CALIBRATED, &mut Manifold::new(motion, manifold::PARTICLES, seed))
            }
        }
    }
}

/// Follows the object with the literal filter of so many particles.
pub fn literal(log: &GraspLog, particles: usize, seed: u64) -> Vec<Step> {
    follow(log, &literal::MODEL, &mut Literal::new(Motion::of(log), particles, seed))
}

/// How far the object moves beyond what the hand meant, per grasp and axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// 2 or 3.
    pub dimension: usize,
    /// Standard deviation, metres.
    pub translation: f64,
    /// Standard deviation, radians.
    pub rotation: f64,
}

impl Motion {
    /// As the log says, or the thesis where it does not.
    pub fn of(log: &GraspLog) -> Motion {
        let noise = settings(log, 0).motion;
        Motion {
            dimension: log.dimension,
            translation: noise.translation.into(),
            rotation: noise.rotation.into(),
        }
    }

    /// Degrees of freedom of a pose: translations before rotations.
    pub fn freedom(&self) -> usize {
        if self.dimension == 2 { 3 } else { 6 }
    }

    /// Standard deviation of a degree of freedom.
    pub fn deviation(&self, degree: usize) -> f64 {
        if degree < self.dimension { self.translation } else { self.rotation }
    }
}

/// A belief over the pose, object to world.
pub trait Belief {
    /// Nothing but this pose is possible.
    fn start(&mut self, pose: Pose);
    /// The object moved by `motion` (world to world; none: it stayed), and some more.
    fn predict(&mut self, motion: Option<&Pose>);
    /// Weighs the contacts of a grasp (world frame) on the surface (object frame). False where they fit
    /// nowhere, or there are none.
    fn correct(&mut self, surface: &Gpis, contacts: &[Contact]) -> bool;
    /// Pose and covariance in tangent coordinates there: object axes, translation before rotation.
    fn mean(&self) -> (Pose, DMatrix<f64>);
    /// Effective number of particles, where there are any.
    fn effective(&self) -> f64 {
        1.0
    }
}

/// How contacts become a surface.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// Covariance.
    pub kernel: Kernel,
    /// What a contact teaches.
    pub training: Training,
    /// The mean before any.
    pub prior: fn(&[Contact]) -> Prior,
    /// Whether the doubt about the pose goes into a contact's noise.
    pub doubts: bool,
}

/// The corrected surface, as the core's bootstrap filter has it.
const CALIBRATED: Model = Model {
    kernel: Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 },
    training: Training::Derivative,
    prior: |contacts| Prior::fitted(contacts).unwrap_or(Prior::Constant(0.0)),
    doubts: true,
};

/// The surface so far, object frame.
struct Map<'a> {
    model: &'a Model,
    dimension: usize,
    contacts: Vec<Contact>,
    surface: Option<Gpis>,
}

impl Map<'_> {
    /// Adds contacts of the object frame. A surface that cannot be fitted leaves the last one.
    fn learn(&mut self, contacts: impl Iterator<Item = Contact>) {
        self.contacts.extend(contacts);
        let Model { kernel, training, prior, .. } = *self.model;
        let prior = prior(&self.contacts);
        if let Ok(surface) = Gpis::fit(self.dimension, kernel, prior, training, &self.contacts) {
            self.surface = Some(surface);
        }
    }
}

/// Algorithm 3.1 with any belief and any model of the surface. The first grasp fixes the object
/// frame: its origin at the centroid of the contacts, its axes along the world's.
fn follow(log: &GraspLog, model: &Model, belief: &mut dyn Belief) -> Vec<Step> {
    let mut map = Map { model, dimension: log.dimension, contacts: Vec::new(), surface: None };
    let mut started = false;
    let mut steps = Vec::with_capacity(log.grasps.len());
    belief.start(Pose::identity());
    for grasp in &log.grasps {
        let contacts: Vec<Contact> = grasp
            .contacts
            .iter()
            .filter(|c| c.point.iter().chain(c.normal.iter().flatten()).all(|x| x.is_finite()))
            .map(|c| {
                let (point_deviation, normal_deviation) = deviations(c, &log.noise);
                Contact { point: c.point, normal: c.normal, point_deviation, normal_deviation }
            })
            .collect();
        let mut status = Status::Started;
        if started {
            belief.predict(grasp.motion.as_ref());
            status = match &map.surface {
                Some(surface) if !contacts.is_empty() => {
                    let fits = belief.correct(surface, &contacts);
                    if fits { Status::Tracking } else { Status::Lost }
                }
                _ => Status::Predicted,
            };
        } else if !contacts.is_empty() {
            let centroid = centroid(contacts.iter().map(|c| c.point));
            belief.start(Pose::from_parts(centroid.into(), UnitQuaternion::identity()));
            started = true;
        }
        let (pose, covariance) = belief.mean();
        if !contacts.is_empty() {
            let to_object = pose.inverse();
            map.learn(contacts.iter().map(|c| match model.doubts {
                true => placed(log.dimension, c, &pose, &covariance),
                false => c.transformed(&to_object),
            }));
        }
        steps.push(Step {
            covariance: six_by_six(log.dimension, &covariance),
            status,
            modes: vec![(pose, 1.0)],
            effective_particles: belief.effective(),
            corrected: status == Status::Tracking,
            contacts: [contacts.len(), grasp.contacts.len() - contacts.len(), 0],
            ..Step::certain(pose)
        });
    }
    steps
}

/// In the axes of [`Step::covariance`].
fn six_by_six(dimension: usize, covariance: &DMatrix<f64>) -> Matrix6<f64> {
    let axes: &[usize] = if dimension == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let mut all = Matrix6::zeros();
    for (i, &row) in axes.iter().enumerate() {
        for (j, &column) in axes.iter().enumerate() {
            all[(row, column)] = covariance[(i, j)];
        }
    }
    all
}

/// Effective number of particles, 1/Σw².
fn effective(weights: impl Iterator<Item = f64>) -> f64 {
    1.0 / weights.map(|w| w * w).sum::<f64>()
}

/// Which particles survive, where fewer than half of them are effective.
fn resampled(weights: &[f64], random: &mut Xoshiro256PlusPlus) -> Option<Vec<usize>> {
    let poor = effective(weights.iter().copied()) < 0.5 * weights.len() as f64;
    poor.then(|| systematic(weights, uniform(random)))
}

/// Uniform in (0, 1).
fn uniform(random: &mut Xoshiro256PlusPlus) -> f64 {
    ((random.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
}

/// Standard normal, by Box and Muller.
fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    let radius = (-2.0 * uniform(random).ln()).sqrt();
    radius * (std::f64::consts::TAU * uniform(random)).cos()
}

#[cfg(test)]
mod tests;
