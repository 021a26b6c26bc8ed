//! How long one model is enough, and what the other has to learn when it is not.

use super::all_short_by;
use crate::contact::{Grasp, GraspView};
use crate::space::Space;
use crate::track::{Estimate, Status, Tracker};

/// Nats by which each number felt (a distance, an angle) may be less expected than if surface and pose
/// had been known, and what is beyond that before patience ends.
///
/// Of a motion that errs by ten times what contacts do, nearly half of this is the pose's own: six
/// numbers of it in the fifteen of five contacts. In space flat faces fall behind by 0.9 nats on boxes and by
/// 1.5 to 1.6 on ellipsoids, at a quarter of that noise by 0.7 and 1.5; by 1.2 on cylinders and on prisms
/// with an L for a base.
const ALLOWED: f32 = 1.25;
const ENOUGH: f32 = 10.0;

/// What a normal deviate of one costs on average.
const USUAL: f32 = 0.5;

/// How badly a model has foretold the latest grasps: a cumulative sum (Page 1954), which forgets what was
/// bad before what was good.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// Nats, at least 0.
    behind: f32,
    /// Grasps that felt the object.
    tests: usize,
}

impl Patience {
    pub const fn new() -> Self {
        Patience { behind: 0.0, tests: 0 }
    }

    /// How many of the grasps taken in felt the object.
    pub fn tests(&self) -> usize {
        self.tests
    }

    /// Takes one grasp in, of which the model gained this much evidence; whether it is not enough.
    #[inline(never)]
    pub fn is_over<S: Space>(
        &mut self,
        estimate: &Estimate<S>,
        grasp: &GraspView<'_, S>,
        gained: f32,
    ) -> bool {
        self.tests += usize::from(estimate.contacts > 0);
        // The first grasp is foretold by nobody.
        if estimate.status != Status::Started {
            self.behind += all_short_by(grasp, 0..usize::MAX, USUAL + ALLOWED) - gained;
            if self.behind < 0.0 {
                self.behind = 0.0;
            }
        }
        // NaN is no foretelling either.
        !(self.behind <= ENOUGH)
    }
}

/// Grasps that a tracker has not learnt yet, with the motions before them.
#[derive(Clone, Debug)]
pub(super) struct Held<S: Space, const GRASPS: usize, const CONTACTS: usize> {
    motions: [Option<S::Pose>; GRASPS],
    grasps: [Grasp<S, CONTACTS>; GRASPS],
    count: usize,
}

impl<S: Space, const GRASPS: usize, const CONTACTS: usize> Held<S, GRASPS, CONTACTS> {
    pub const fn new() -> Self {
        Held {
            motions: [const { None }; GRASPS],
            grasps: [const { Grasp::new() }; GRASPS],
            count: 0,
        }
    }

    pub fn clear(&mut self) {
        self.count = 0;
    }

    pub fn is_full(&self) -> bool {
        self.count == GRASPS
    }

    /// Keeps a grasp; false, and nothing is kept, where it has no room.
    pub fn push(&mut self, motion: Option<&S::Pose>, grasp: &GraspView<'_, S>) -> bool {
        let most = grasp.contacts.len().max(grasp.free.len());
        let Some(place) = self.grasps.get_mut(self.count).filter(|_| most <= CONTACTS) else {
            return false;
        };
        place.clear();
        place.contacts.extend(grasp.contacts.iter().copied());
        place.free.extend(grasp.free.iter().copied());
        self.motions[self.count] = motion.copied();
        self.count += 1;
        true
    }

    /// Teaches a tracker all of them; what it says of the last. None are held afterwards.
    pub fn learnt(&mut self, tracker: &mut impl Tracker<S>) -> Option<Estimate<S>> {
        let held = self.motions.iter().zip(&self.grasps).take(self.count);
        let last = held.map(|(motion, grasp)| tracker.update(motion.as_ref(), grasp.view())).last();
        self.count = 0;
        last
    }
}
