//! Where the particles of today were at earlier grasps.

use crate::space::{self, Pose, Space};
use crate::track::Separation;

/// The poses of the last `HISTORY` grasps and who descends from whom; nothing is copied when particles
/// are resampled. All zero bits when new.
#[derive(Clone, Debug)]
pub(super) struct Genealogy<S: Space, const PARTICLES: usize, const HISTORY: usize> {
    poses: [[S::Pose; PARTICLES]; HISTORY],
    /// The place that each particle's parent had at the grasp before.
    parents: [[u16; PARTICLES]; HISTORY],
    /// Grasps recorded.
    grasps: u32,
}

impl<S: Space, const PARTICLES: usize, const HISTORY: usize> Genealogy<S, PARTICLES, HISTORY> {
    pub const fn new() -> Self {
        Genealogy {
            poses: [[S::Pose::UNSET; PARTICLES]; HISTORY],
            parents: [[0; PARTICLES]; HISTORY],
            grasps: 0,
        }
    }

    pub fn clear(&mut self) {
        self.grasps = 0;
    }

    /// Records the next grasp: each particle's pose and its parent's place.
    pub fn record(&mut self, particles: impl Iterator<Item = (S::Pose, u16)>) {
        let place = self.place(self.grasps);
        if let (Some(poses), Some(parents)) =
            (self.poses.get_mut(place), self.parents.get_mut(place))
        {
            for ((pose, parent), new) in poses.iter_mut().zip(parents).zip(particles) {
                (*pose, *parent) = new;
            }
        }
        self.grasps = self.grasps.saturating_add(1);
    }

    /// Where in memory a grasp is, or would be.
    fn place(&self, grasp: u32) -> usize {
        if HISTORY == 0 { 0 } else { (grasp as usize) % HISTORY }
    }

    fn remembers(&self, grasp: u32) -> bool {
        grasp < self.grasps && ((self.grasps - grasp) as usize) <= HISTORY
    }

    /// Where the particle now in `place` was at `grasp`.
    fn ancestor(&self, place: usize, grasp: u32) -> Option<S::Pose> {
        let mut place = place;
        for later in (grasp + 1..self.grasps).rev() {
            place = usize::from(*self.parents.get(self.place(later))?.get(place)?);
        }
        self.poses.get(self.place(grasp))?.get(place).copied()
    }

    /// Mean pose at `grasp` of the ancestors of particles of these weights, as far as they agree with
    /// the ancestor of particle `best`: one that came by another way does not count.
    pub fn mean(
        &self,
        grasp: u32,
        best: usize,
        weights: impl Iterator<Item = f32> + Clone,
    ) -> Option<S::Pose> {
        if !self.remembers(grasp) {
            return None;
        }
        let start = self.ancestor(best, grasp)?;
        let poses = weights.enumerate().filter_map(|(place, weight)| {
            let pose = if weight > 0.0 { self.ancestor(place, grasp)? } else { return None };
            (Separation::DEFAULT.between::<S>(&start, &pose) < 1.0).then_some((weight, pose))
        });
        Some(space::mean::<S>(poses, start).0)
    }
}
