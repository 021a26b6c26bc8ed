//! From grasps to a belief over the object's pose, and the shape it implies.

pub mod automatic;
mod blurred;
pub mod bootstrap;
pub mod curved;
pub mod hypotheses;
pub mod likelihood;
pub mod modes;
pub mod motion;
pub mod observability;
pub mod particles;
pub mod rao_blackwell;

pub use automatic::{Automatic, Evidence, Learning, Meant};
pub use bootstrap::{Bootstrap, Gate, Settings};
pub use curved::Curved;
pub use hypotheses::Hypotheses;
pub use modes::{Mode, Modes, Separation};
pub use motion::MotionNoise;
pub use observability::Observability;
pub use rao_blackwell::RaoBlackwell;

use crate::contact::GraspView;
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

/// One grasp in, one estimate out. The first grasp fixes the object frame: its origin at the
/// centroid of the contacts, its axes along the world's.
pub trait Tracker<S: Space> {
    /// Predicts with `motion`, weighs and corrects with the grasp, then adds its contacts to the
    /// shape. `motion` maps world to world (predicted pose = motion ∘ previous pose); `None`, or one that
    /// is not finite or goes further than 10 km, means unknown (the object rested, with
    /// twice the noise or more), and on the first grasp nothing.
    ///
    /// Contacts that are not finite or not normalised are dropped and counted; an empty grasp only
    /// predicts.
    fn update(&mut self, motion: Option<&S::Pose>, grasp: GraspView<'_, S>) -> Estimate<S>;

    /// Forgets the object and restarts the random numbers from `seed`.
    fn reset(&mut self, seed: u64);

    /// How much the object moves beyond what the hand intended, from now on.
    fn set_motion_noise(&mut self, noise: MotionNoise);

    /// What the tracker now believes the object's pose was at an earlier grasp (numbered as in
    /// [`Estimate::grasp`]): later grasps may have taught it better. `None` where it does not
    /// remember; then the estimate of that time stands.
    fn recall(&self, _grasp: u32) -> Option<S::Pose> {
        None
    }
}

/// Whether the hand can have meant a motion: finite, and so near that no pose overflows.
pub(crate) fn is_plausible<S: Space>(motion: &S::Pose) -> bool {
    const FURTHEST: f32 = 1e4;
    motion.is_finite() && motion.translation().norm_squared() <= FURTHEST * FURTHEST
}

/// How much an estimate is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// Nothing has been touched yet, or this grasp fixed the object frame.
    #[default]
    Started,
    /// The grasp fits the shape at one pose.
    Tracking,
    /// Nothing usable was felt, or only where nothing had been touched before: the pose is the prediction, and what was
    /// felt was learnt there.
    Predicted,
    /// The grasp fits at several poses, see [`Estimate::modes`]; the pose is the heaviest one's. Or at one,
    /// but only had the object slipped there, and the next grasp has yet to agree.
    Ambiguous,
    /// The grasp fits nowhere. The pose is the prediction and the shape was left alone; later grasps
    /// may find the object again.
    Lost,
}

impl Status {
    /// In one lower-case word, as tables and reports have it.
    pub const fn name(self) -> &'static str {
        match self {
            Status::Started => "started",
            Status::Tracking => "tracking",
            Status::Predicted => "predicted",
            Status::Ambiguous => "ambiguous",
            Status::Lost => "lost",
        }
    }
}

/// What a tracker believes after one grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate<S: Space> {
    /// Number of the grasp since the last reset, from 0.
    pub grasp: u32,
    /// Object to world: the mean of the particles, or the best of a few hypotheses.
    pub pose: S::Pose,
    /// Covariance of the pose in tangent coordinates (object axes; metres and radians).
    pub covariance: S::Covariance,
    /// How much this is worth.
    pub status: Status,
    /// The poses that the belief holds possible, heaviest first.
    pub modes: Modes<S>,
    /// Effective number of particles or hypotheses, 1/Σw²; their whole number when all weigh the
    /// same.
    pub effective_particles: f32,
    /// Which directions of the pose this grasp can see.
    pub observability: Observability<S>,
    /// Contacts of this grasp that can be used, whether or not they corrected the pose.
    pub contacts: u16,
    /// Contacts dropped because a number in them was bad.
    pub rejected: u16,
    /// Contacts (of this or earlier grasps) that the bounded map let go in this update, and those that nothing
    /// explains.
    pub dropped: u16,
    /// Whether the grasp corrected the pose. False on the first grasp, on an empty one, when it fits nowhere, and
    /// when it was felt only where nothing had been touched; the pose is then the prediction.
    pub corrected: bool,
    /// Whether the particles were resampled.
    pub resampled: bool,
}

impl<S: Space> Estimate<S> {
    /// What every tracker says in the same way of a grasp and a belief after it. Samples, what the map
    /// let go and resampling are the tracker's to add.
    fn after(
        number: u32,
        grasp: &GraspView<'_, S>,
        (pose, covariance): (S::Pose, S::Covariance),
        status: Status,
        modes: Modes<S>,
    ) -> Self {
        let contacts = grasp.usable().count();
        let count = |n: usize| n.min(usize::from(u16::MAX)) as u16;
        Estimate {
            grasp: number,
            pose,
            covariance,
            status,
            modes,
            effective_particles: 0.0,
            observability: Observability::of(grasp.felt_from(&pose)),
            contacts: count(contacts),
            rejected: count(grasp.contacts.len() - contacts),
            dropped: 0,
            corrected: matches!(status, Status::Tracking | Status::Ambiguous),
            resampled: false,
        }
    }
}

#[cfg(test)]
mod tests;
