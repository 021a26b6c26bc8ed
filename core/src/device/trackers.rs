//! The trackers that boards carry: one size for the plane, one for space, chosen to fit an
//! STM32F405's memory and time. A virtual board carries the same.

use super::{Device, Onboard};
use crate::space::{Planar, Spatial};
use crate::surface::cholesky::packed;
use crate::surface::{Ball, Gpis, Matern32, Prior, Training};
use crate::track::rao_blackwell::Faceted;
use crate::track::{Bootstrap, RaoBlackwell};
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
/// Another for a planar board: every particle with its own faces, 27 kB.
pub type PlanarFacedTracker = RaoBlackwell<Planar, 64, 12, 0>;
/// Another for a spatial board, 32 kB.
pub type SpatialFacedTracker = RaoBlackwell<Spatial, 64, 8, 0>;
/// A planar board.
pub type PlanarDevice = Device<PlanarTracker, Planar, CONTACTS>;
/// A spatial board.
pub type SpatialDevice = Device<SpatialTracker, Spatial, CONTACTS>;
/// A planar board whose particles have faces.
pub type PlanarFacedDevice = Device<PlanarFacedTracker, Planar, CONTACTS>;
/// A spatial board whose particles have faces.
pub type SpatialFacedDevice = Device<SpatialFacedTracker, Spatial, CONTACTS>;

impl PlanarDevice {
    /// A planar board that has heard nothing; all zero bits.
    pub const PLANAR: Self = Device::new(Bootstrap::new(Gpis::new()));
}

impl SpatialDevice {
    /// A spatial board that has heard nothing; all zero bits.
    pub const SPATIAL: Self = Device::new(Bootstrap::new(Gpis::new()));
}

impl PlanarFacedDevice {
    /// A planar board that has heard nothing; all zero bits.
    pub const PLANAR_FACED: Self = Device::new(RaoBlackwell::new());
}

impl SpatialFacedDevice {
    /// A spatial board that has heard nothing; all zero bits.
    pub const SPATIAL_FACED: Self = Device::new(RaoBlackwell::new());
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

impl<S: WireSpace + Faceted, const PARTICLES: usize, const FACES: usize, const HISTORY: usize>
    Onboard<S> for RaoBlackwell<S, PARTICLES, FACES, HISTORY>
{
    /// Faces, each of any number of contacts.
    const MAP: usize = FACES;
    const PARTICLES: usize = PARTICLES;

    /// Nothing to set: faces have no model beside the contacts' noise.
    fn prepare(&mut self) {}
}
