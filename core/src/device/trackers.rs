//! The trackers that boards carry: one size for the plane, one for space, chosen to fit an
//! STM32F405's memory and time. A virtual board carries the same.

use super::{Device, Onboard};
use crate::space::{Planar, Spatial};
use crate::surface::cholesky::packed;
use crate::surface::{Ball, Gpis, Matern32, Prior, Training};
use crate::track::Bootstrap;
use crate::track::hypotheses::{self, Chart, Hypotheses};
use crate::wire::WireSpace;

/// Standard deviation of the surface about its prior ball, metres.
const AMPLITUDE: f32 = 0.03;
/// Distance over which the surface keeps its height, metres.
const LENGTHSCALE: f32 = 0.1;

/// Contacts, and free points, that one grasp may have.
pub const CONTACTS: usize = 16;
const PLANAR_MAP: usize = 40;
const PLANAR_ROWS: usize = 3 * PLANAR_MAP;
const SPATIAL_MAP: usize = 33;
const SPATIAL_ROWS: usize = 4 * SPATIAL_MAP;

/// The surface a planar board holds: 40 contacts with normals.
pub type PlanarMap =
    Gpis<Planar, Matern32, Ball<Planar>, PLANAR_MAP, PLANAR_ROWS, { packed(PLANAR_ROWS) }>;
/// The surface a spatial board holds: 33 contacts with normals.
pub type SpatialMap =
    Gpis<Spatial, Matern32, Ball<Spatial>, SPATIAL_MAP, SPATIAL_ROWS, { packed(SPATIAL_ROWS) }>;
/// The tracker of a planar board.
pub type PlanarTracker = Bootstrap<Planar, PlanarMap, 250>;
/// The tracker of a spatial board.
pub type SpatialTracker = Bootstrap<Spatial, SpatialMap, 400>;
const PLANAR_FACES: usize = 10;
const PLANAR_JOINT: usize = hypotheses::rows::<Planar>(PLANAR_FACES);
const SPATIAL_FACES: usize = 10;
const SPATIAL_JOINT: usize = hypotheses::rows::<Spatial>(SPATIAL_FACES);
/// Grasps that a board's hypotheses remember: a board reports poses as it goes.
const GRASPS: usize = 0;

/// Four joint hypotheses of the pose and ten faces, for a planar board.
pub type PlanarHypotheses =
    Hypotheses<Planar, 4, PLANAR_FACES, PLANAR_JOINT, { packed(PLANAR_JOINT) }, GRASPS>;
/// The same for a spatial board.
pub type SpatialHypotheses =
    Hypotheses<Spatial, 4, SPATIAL_FACES, SPATIAL_JOINT, { packed(SPATIAL_JOINT) }, GRASPS>;
/// A planar board.
pub type PlanarDevice = Device<PlanarTracker, Planar, CONTACTS>;
/// A spatial board.
pub type SpatialDevice = Device<SpatialTracker, Spatial, CONTACTS>;

impl PlanarDevice {
    /// A planar board that has heard nothing; all zero bits.
    pub const PLANAR: Self = Device::new(Bootstrap::new(Gpis::new()));
}

impl SpatialDevice {
    /// A spatial board that has heard nothing; all zero bits.
    pub const SPATIAL: Self = Device::new(Bootstrap::new(Gpis::new()));
}

impl<S: WireSpace, const SITES: usize, const ROWS: usize, const PACKED: usize, const N: usize>
    Onboard<S> for Bootstrap<S, Gpis<S, Matern32, Ball<S>, SITES, ROWS, PACKED>, N>
{
    const MAP: usize = SITES;
    const PARTICLES: usize = N;

    fn prepare(&mut self) {
        self.map_mut().configure(
            Matern32 { amplitude: AMPLITUDE, lengthscale: LENGTHSCALE },
            Ball::UNSET,
            Training::Normals,
        );
    }
}

impl<
    S: WireSpace + Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Onboard<S> for Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    /// Faces: contacts are not kept.
    const MAP: usize = FACES;
    const PARTICLES: usize = K;

    fn prepare(&mut self) {
        self.configure(hypotheses::Settings::DEFAULT);
    }
}
