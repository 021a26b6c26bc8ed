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
