//! From a grasp log to poses: the core's tracker in double the comfort of a desktop.

use std::marker::PhantomData;

use nalgebra::Matrix6;
use tactile_core::contact::{Contact, FreePoint, GraspView};
use tactile_core::matrix::Square;
use tactile_core::track::{Estimate, MotionNoise, Settings, Status, Tracker};

use crate::log::replayed::RecordedEstimate;
use crate::log::{GraspLog, LoggedGrasp, Noise};
use crate::slam::deviations;
use crate::space::{Bridge, Pose};

/// What is known of the object after one grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Object to world.
    pub pose: Pose,
    /// Covariance of the pose in tangent coordinates (object axes): translation, then rotation;
    /// zero for poses taken from the log. Planar poses fill x, y and the rotation about z.
    pub covariance: Matrix6<f64>,
    /// How much it is worth.
    pub status: Status,
    /// The poses held possible and their shares of the belief, heaviest first; empty for poses taken
    /// from the log.
    pub modes: Vec<(Pose, f64)>,
    /// Effective number of particles or hypotheses; 0 for poses taken from the log.
    pub effective_particles: f64,
    /// Whether the grasp corrected the pose; false for the first grasp and for one that did not fit
    /// the shape anywhere.
    pub corrected: bool,
    /// Number of directions of the pose that the grasp can see.
    pub observed: usize,
    /// Contacts that were used, refused for bad numbers, and let go by the bounded map.
    pub contacts: [usize; 3],
}

impl Step {
    /// A pose known without doubt.
    pub fn certain(pose: Pose) -> Self {
        Step {
            pose,
            covariance: Matrix6::zeros(),
            status: Status::Tracking,
            modes: Vec::new(),
            effective_particles: 0.0,
            corrected: false,
            observed: 0,
            contacts: [0; 3],
        }
    }

    /// Whether it is [`certain`](Step::certain), or of a first grasp, whose pose is the frame.
    pub fn is_certain(&self) -> bool {
        self.status == Status::Tracking && !self.corrected && self.covariance == Matrix6::zeros()
    }

    /// The same at the pose that all grasps together say; the other poses that the tracker held possible stay where
    /// they are beside its best one. One that had been lost is so no longer where it `is_found`: most of what it felt
    /// lies on the object there.
    pub fn at(&self, pose: Pose, covariance: Matrix6<f64>, is_found: bool) -> Self {
        let moved = pose * self.pose.inverse();
        let modes = self.modes.iter().map(|(mode, weight)| (moved * mode, *weight)).collect();
        let step = Step { pose, covariance, modes, ..self.clone() };
        if self.status == Status::Lost && is_found {
            Step { status: Status::Tracking, corrected: true, modes: Vec::new(), ..step }
        } else {
            step
        }
    }

    /// From what the core reports.
    pub fn from_estimate<S: Bridge>(estimate: &Estimate<S>) -> Self {
        Step {
            pose: S::isometry(&estimate.pose),
            covariance: six_by_six::<S>(&estimate.covariance),
            status: estimate.status,
            modes: estimate
                .modes
                .as_slice()
                .iter()
                .map(|m| (S::isometry(&m.pose), f64::from(m.weight)))
                .collect(),
            effective_particles: f64::from(estimate.effective_particles),
            corrected: estimate.corrected,
            observed: estimate.observability.rank(),
            contacts: [estimate.contacts, estimate.rejected, estimate.dropped].map(usize::from),
        }
    }
}

impl From<&RecordedEstimate> for Step {
    /// From what a recording tells: of the covariance only its diagonal, of the directions seen none.
    fn from(recorded: &RecordedEstimate) -> Self {
        let axes: &[usize] = if recorded.deviations.len() == 3 { &PLANAR } else { &SPATIAL };
        let mut covariance = Matrix6::zeros();
        for (&axis, &deviation) in axes.iter().zip(&recorded.deviations) {
            covariance[(axis, axis)] = f64::from(deviation).powi(2);
        }
        Step {
            pose: recorded.pose,
            covariance,
            status: recorded.status,
            modes: recorded.modes.iter().map(|(p, w)| (*p, f64::from(*w))).collect(),
            effective_particles: f64::from(recorded.effective_particles),
            corrected: recorded.corrected,
            observed: 0,
            contacts: recorded.contacts.map(usize::from),
        }
    }
}

/// The axes of [`Step::covariance`] that a dimension has.
const PLANAR: [usize; 3] = [0, 1, 5];
const SPATIAL: [usize; 6] = [0, 1, 2, 3, 4, 5];

/// A core covariance in the axes of [`Step::covariance`].
pub fn six_by_six<S: Bridge>(core: &S::Covariance) -> Matrix6<f64> {
    let axes: &[usize] = if S::DIMENSION == 2 { &PLANAR } else { &SPATIAL };
    let mut covariance = Matrix6::zeros();
    for (i, &row) in axes.iter().enumerate() {
        for (j, &column) in axes.iter().enumerate() {
            covariance[(row, column)] = f64::from(core.at(i, j));
        }
    }
    covariance
}

/// The log has no true pose where one was asked for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("grasp {grasp}: truth.pose is missing; true poses were asked for")]
pub struct NoTruth {
    /// The grasp's number in the log.
    pub grasp: u64,
}

/// The log's own true poses, one step per grasp.
///
/// # Errors
/// When a grasp has none.
pub fn truth(log: &GraspLog) -> Result<Vec<Step>, NoTruth> {
    log.grasps
        .iter()
        .map(|g| g.truth.map(Step::certain).ok_or(NoTruth { grasp: g.index }))
        .collect()
}

/// The filter's settings for a log: its motion noise where it says, but no less than what makes particles differ, else
/// the thesis' 100 %.
pub fn settings(log: &GraspLog, seed: u64) -> Settings {
    let thesis = MotionNoise::THESIS;
    let said = |noise: Option<f64>, least: f64| noise.map(|noise| noise.max(least) as f32);
    let motion = MotionNoise {
        translation: said(log.noise.translation, Noise::LEAST_TRANSLATION)
            .unwrap_or(thesis.translation),
        rotation: said(log.noise.rotation, Noise::LEAST_ROTATION).unwrap_or(thesis.rotation),
    };
    Settings { motion, seed, ..Settings::DEFAULT }
}

/// Feeds a log through any tracker. Poses that the tracker came to know better later
/// ([`Tracker::recall`]) are as it knows them in the end.
pub fn follow<S: Bridge>(tracker: &mut impl Tracker<S>, log: &GraspLog) -> Vec<Step> {
    let mut steps = online(tracker, log);
    recalled(tracker, &mut steps);
    steps
}

/// Feeds a log through any tracker: each step as it was known at the time.
pub fn online<S: Bridge>(tracker: &mut impl Tracker<S>, log: &GraspLog) -> Vec<Step> {
    log.grasps.iter().map(|grasp| take(tracker, grasp, &log.noise)).collect()
}

fn take<S: Bridge>(tracker: &mut impl Tracker<S>, grasp: &LoggedGrasp, noise: &Noise) -> Step {
    let motion = grasp.motion.as_ref().map(S::pose);
    let contacts = contacts::<S>(grasp, noise);
    let free = free_points::<S>(grasp);
    let view = GraspView { contacts: &contacts, free: &free };
    Step::from_estimate(&tracker.update(motion.as_ref(), view))
}

fn recalled<S: Bridge>(tracker: &impl Tracker<S>, steps: &mut [Step]) {
    for (grasp, step) in (0..).zip(steps) {
        if let Some(pose) = tracker.recall(grasp) {
            step.pose = S::isometry(&pose);
        }
    }
}

/// Any tracker, planar or spatial, and what it made of the grasps so far.
pub struct Follower {
    tracker: Box<dyn Follow>,
    steps: Vec<Step>,
}

/// A tracker without its space.
trait Follow: Send {
    fn take(&mut self, grasp: &LoggedGrasp, noise: &Noise) -> Step;
    fn recalled(&self, steps: &mut [Step]);
}

struct In<S, T> {
    tracker: Box<T>,
    space: PhantomData<S>,
}

impl<S: Bridge + Send, T: Tracker<S> + Send> Follow for In<S, T> {
    fn take(&mut self, grasp: &LoggedGrasp, noise: &Noise) -> Step {
        take(&mut *self.tracker, grasp, noise)
    }

    fn recalled(&self, steps: &mut [Step]) {
        recalled(&*self.tracker, steps);
    }
}

impl Follower {
    /// With a tracker that has seen nothing.
    pub fn new<S: Bridge + Send + 'static>(
        tracker: Box<impl Tracker<S> + Send + 'static>,
    ) -> Follower {
        Follower { tracker: Box::new(In { tracker, space: PhantomData }), steps: Vec::new() }
    }

    /// Takes the next grasp, whose contacts have the noise of its log where they state none.
    pub fn take(&mut self, grasp: &LoggedGrasp, noise: &Noise) {
        let step = self.tracker.take(grasp, noise);
        self.steps.push(step);
    }

    /// One step per grasp taken, the poses as the tracker knows them by now ([`Tracker::recall`]).
    pub fn steps(&self) -> Vec<Step> {
        let mut steps = self.steps.clone();
        self.tracker.recalled(&mut steps);
        steps
    }
}

/// The contacts of a grasp as the core takes them.
pub fn contacts<S: Bridge>(grasp: &LoggedGrasp, noise: &Noise) -> Vec<Contact<S>> {
    grasp
        .contacts
        .iter()
        .map(|c| {
            let (point, normal) = deviations(c, noise);
            Contact {
                point: S::vector(&c.point),
                normal: c.normal.as_ref().map(S::vector),
                point_deviation: point as f32,
                normal_deviation: normal as f32,
                finger: c.finger.map_or(u8::MAX, |f| f.min(254) as u8),
            }
        })
        .collect()
}

/// The free fingertips of a grasp as the core takes them.
pub fn free_points<S: Bridge>(grasp: &LoggedGrasp) -> Vec<FreePoint<S>> {
    grasp
        .free
        .iter()
        .map(|f| FreePoint {
            point: S::vector(&f.point),
            finger: f.finger.map_or(u8::MAX, |f| f.min(254) as u8),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_stay_beside_the_best_one() {
        let at = |x: f64, turn: f64| {
            let turn = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, turn);
            Pose::from_parts(nalgebra::Translation3::new(x, 0.0, 0.0), turn)
        };
        let step = Step {
            modes: vec![(at(0.1, 0.2), 0.7), (at(0.1, 0.5), 0.3)],
            ..Step::certain(at(0.1, 0.2))
        };
        let moved = step.at(at(0.2, 1.0), step.covariance, true);
        let [(best, _), (other, weight)] = moved.modes[..] else { panic!("two modes") };
        assert!((best.translation.vector.x - 0.2).abs() < 1e-12);
        assert!((other.rotation.angle() - 1.3).abs() < 1e-12 && weight == 0.3);
    }
}
