//! Boards for curved objects, and for objects of which nobody knows whether they are curved.

use super::{AMPLITUDE, CONTACTS, LENGTHSCALE, PlanarHypotheses, SpatialHypotheses};
use crate::device::{Device, Onboard};
use crate::explore::{Candidate, Choice, Criterion};
use crate::space::{Planar, Spatial};
use crate::surface::cholesky::packed;
use crate::surface::{Ellipsoid, Gpis, Matern32, Prior, Training};
use crate::track::automatic::{Evidence, Meant};
use crate::track::curved::{Curved, Settings};
use crate::track::{Automatic, Hypotheses};
use crate::wire::{FaceSummary, Refusal, TrackerKind, WireSpace};

/// Trajectories; the grasps and the contacts that can still be revised; and the contacts of the map, among
/// them those of older grasps.
const TRAJECTORIES: usize = 4;
const PLANAR_REVISED: usize = 6;
const PLANAR_TOUCHES: usize = 25;
const PLANAR_SITES: usize = 32;
const PLANAR_ROWS: usize = 3 * PLANAR_SITES;
const SPATIAL_REVISED: usize = 5;
const SPATIAL_TOUCHES: usize = 20;
const SPATIAL_SITES: usize = 24;
const SPATIAL_ROWS: usize = 4 * SPATIAL_SITES;

/// Grasps that wait while faces are enough, and contacts that each may have: one with more wakes the
/// curved half.
const HELD: usize = 12;
const HELD_CONTACTS: usize = 8;

/// The surface of a curved object in the plane: 32 contacts with normals.
pub type PlanarCurvedMap =
    Gpis<Planar, Matern32, Ellipsoid<Planar>, PLANAR_SITES, PLANAR_ROWS, { packed(PLANAR_ROWS) }>;
/// The surface of a curved object in space: 24 contacts with normals.
pub type SpatialCurvedMap = Gpis<
    Spatial,
    Matern32,
    Ellipsoid<Spatial>,
    SPATIAL_SITES,
    SPATIAL_ROWS,
    { packed(SPATIAL_ROWS) },
>;
/// Four trajectories of the last six grasps, for a planar board.
pub type PlanarCurved =
    Curved<Planar, PlanarCurvedMap, TRAJECTORIES, PLANAR_REVISED, PLANAR_TOUCHES, PLANAR_ROWS>;
/// Four trajectories of the last five grasps, for a spatial board.
pub type SpatialCurved =
    Curved<Spatial, SpatialCurvedMap, TRAJECTORIES, SPATIAL_REVISED, SPATIAL_TOUCHES, SPATIAL_ROWS>;
/// Faces, and curved where they do not foretell what is felt, for a planar board.
pub type PlanarAutomatic = Automatic<Planar, PlanarHypotheses, PlanarCurved, HELD, HELD_CONTACTS>;
/// The same for a spatial board.
pub type SpatialAutomatic =
    Automatic<Spatial, SpatialHypotheses, SpatialCurved, HELD, HELD_CONTACTS>;
/// A planar board for curved objects.
pub type PlanarCurvedDevice = Device<PlanarCurved, Planar, CONTACTS>;
/// A spatial board for curved objects.
pub type SpatialCurvedDevice = Device<SpatialCurved, Spatial, CONTACTS>;
/// A planar board for objects that may be flat-faced or curved.
pub type PlanarAutomaticDevice = Device<PlanarAutomatic, Planar, CONTACTS>;
/// A spatial board for objects that may be flat-faced or curved.
pub type SpatialAutomaticDevice = Device<SpatialAutomatic, Spatial, CONTACTS>;

impl PlanarCurvedDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Curved::new(Gpis::new()));
}

impl SpatialCurvedDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Curved::new(Gpis::new()));
}

impl PlanarAutomaticDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self =
        Device::new(Automatic::new(Hypotheses::new(), Curved::new(Gpis::new())));
}

impl SpatialAutomaticDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self =
        Device::new(Automatic::new(Hypotheses::new(), Curved::new(Gpis::new())));
}

impl<
    S: WireSpace,
    P: Prior<S>,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const K: usize,
    const GRASPS: usize,
    const TOUCHES: usize,
> Onboard<S> for Curved<S, Gpis<S, Matern32, P, SITES, ROWS, PACKED>, K, GRASPS, TOUCHES, ROWS>
{
    const MAP: usize = SITES;
    const PARTICLES: usize = K;
    const KIND: TrackerKind = TrackerKind::Curved;

    fn prepare(&mut self) {
        let kernel = Matern32 { amplitude: AMPLITUDE, lengthscale: LENGTHSCALE };
        self.map_mut().configure(kernel, P::UNSET, Training::Normals);
        self.configure(Settings::DEFAULT);
    }
}

impl<S: WireSpace, A, B, const GRASPS: usize, const TOUCHES: usize> Onboard<S>
    for Automatic<S, A, B, GRASPS, TOUCHES>
where
    A: Onboard<S> + Evidence<S>,
    B: Onboard<S> + Evidence<S>,
{
    /// Of the first, whose faces can be asked for.
    const MAP: usize = A::MAP;
    const PARTICLES: usize = A::PARTICLES + B::PARTICLES;
    const KIND: TrackerKind = TrackerKind::Automatic;

    fn prepare(&mut self) {
        self.first_mut().prepare();
        self.second_mut().prepare();
    }

    fn face(&self, number: u8) -> Option<(FaceSummary<S>, u8)> {
        match self.meant() {
            Meant::First => self.first().face(number),
            Meant::Second => self.second().face(number),
        }
    }

    fn choose(
        &mut self,
        motion: Option<&S::Pose>,
        candidates: &[Candidate<S>],
        criterion: Criterion,
        noise: f32,
    ) -> Result<Choice, Refusal> {
        match self.meant() {
            Meant::First => self.first_mut().choose(motion, candidates, criterion, noise),
            Meant::Second => self.second_mut().choose(motion, candidates, criterion, noise),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::{Contact, GraspView};
    use crate::matrix::{Coordinates, Vector};
    use crate::random::Random;
    use crate::space::{PlanarPose, Pose};
    use crate::track::{MotionNoise, Status, Tracker};
    use std::boxed::Box;

    const NOISE: MotionNoise = MotionNoise { translation: 0.005, rotation: 0.17 };

    /// Ten grasps of five contacts with 1 mm and 5° of noise, of an object that slips; which half of a
    /// planar board's tracker is meant, how far off it is in the end, and how many contacts it let go.
    fn follow(touch: impl Fn(usize, f32) -> (Vector<2>, Vector<2>)) -> (Meant, f32, u16) {
        let mut tracker =
            Box::new(PlanarAutomatic::new(Hypotheses::new(), Curved::new(Gpis::new())));
        tracker.prepare();
        tracker.set_motion_noise(NOISE);
        tracker.reset(1);
        let mut random = Random::new(4);
        let (mut truth, mut gauge) = (PlanarPose::IDENTITY, PlanarPose::IDENTITY);
        let (mut apart, mut dropped) = (f32::INFINITY, 0);
        for grasp in 0..10 {
            if grasp > 0 {
                truth = NOISE.disturb::<Planar>(&truth, &mut random);
            }
            let contacts: [Contact<Planar>; 5] = core::array::from_fn(|finger| {
                let (point, normal) = touch(grasp + finger, random.uniform());
                let felt = normal + random.normal::<Vector<2>>() * 0.087;
                Contact {
                    point: truth.transform(point) + random.normal::<Vector<2>>() * 1e-3,
                    normal: felt.normalized().map(|n| truth.rotate(n)),
                    point_deviation: 1e-3,
                    normal_deviation: 0.087,
                    finger: finger as u8,
                }
            });
            let motion = (grasp > 0).then_some(&PlanarPose::IDENTITY);
            let estimate = tracker.update(motion, GraspView { contacts: &contacts, free: &[] });
            assert_ne!(estimate.status, Status::Lost);
            if grasp == 0 {
                gauge = estimate.pose;
            }
            let off = truth.compose(&gauge).local(&estimate.pose);
            apart = off[0].hypot(off[1]);
            dropped += estimate.dropped;
        }
        (tracker.meant(), apart, dropped)
    }

    #[test]
    fn a_board_tells_curved_objects_from_flat_ones() {
        let ellipse = |place: usize, along: f32| {
            let (sin, cos) = (1.3 * place as f32 + along).sin_cos();
            let normal = Vector([cos / 0.05, sin / 0.03]).normalized().unwrap_or(Vector::ZERO);
            (Vector([0.05 * cos, 0.03 * sin]), normal)
        };
        let rectangle = |place: usize, along: f32| {
            let (long, sign) = (place.is_multiple_of(2), if place % 4 < 2 { 1.0 } else { -1.0 });
            let t = 1.6 * along - 0.8;
            if long {
                (Vector([0.05 * t, 0.03 * sign]), Vector([0.0, sign]))
            } else {
                (Vector([0.05 * sign, 0.03 * t]), Vector([sign, 0.0]))
            }
        };
        let (meant, apart, _) = follow(ellipse);
        assert!(meant == Meant::Second && apart < 0.006, "{meant:?} {apart}");
        let (meant, apart, dropped) = follow(rectangle);
        assert!(meant == Meant::First && apart < 0.006 && dropped == 0, "{meant:?} {apart}");
    }
}
