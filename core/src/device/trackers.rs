//! The trackers that boards carry: one size for the plane, one for space, chosen to fit an
//! STM32F405's memory and time. A virtual board carries the same.

mod curved;

use super::{Device, Onboard};
use crate::explore::{self, Candidate, Choice, Criterion};
use crate::math;
use crate::matrix::Square;
use crate::space::{Planar, Spatial};
use crate::surface::cholesky::packed;
use crate::surface::{Matern32, Truncated};
use crate::track::hypotheses::{self, Chart, Disbelief, Hypotheses, ToldFace};
use crate::track::rao_blackwell::Faceted;
use crate::track::{Bootstrap, RaoBlackwell};
use crate::wire::{FaceSummary, Refusal, TrackerKind, WireSpace};

pub use curved::{
    PlanarAutomatic, PlanarAutomaticDevice, PlanarCurved, PlanarCurvedDevice, PlanarCurvedMap,
    SpatialAutomatic, SpatialAutomaticDevice, SpatialCurved, SpatialCurvedDevice, SpatialCurvedMap,
};

/// Standard deviation of the surface about its prior ball, metres.
const AMPLITUDE: f32 = 0.03;
/// Distance over which the surface keeps its height, metres.
const LENGTHSCALE: f32 = 0.1;

/// Contacts, and free points, that one grasp may have.
pub const CONTACTS: usize = 16;
/// Candidates among which a board chooses the next grasp.
pub const CANDIDATES: usize = 16;
const PLANAR_MAP: usize = 40;
const PLANAR_ROWS: usize = 3 * PLANAR_MAP;
const SPATIAL_MAP: usize = 33;
const SPATIAL_ROWS: usize = 4 * SPATIAL_MAP;

/// Flat faces beside them, each of any number of contacts.
const PLANAR_CUTS: usize = 10;
const SPATIAL_CUTS: usize = 12;

/// The surface a planar board holds: 40 contacts with normals, and what lies on ten flat faces.
pub type PlanarMap =
    Truncated<Planar, Matern32, PLANAR_MAP, PLANAR_ROWS, { packed(PLANAR_ROWS) }, PLANAR_CUTS>;
/// The surface a spatial board holds: 33 contacts with normals, and what lies on twelve flat faces.
pub type SpatialMap =
    Truncated<Spatial, Matern32, SPATIAL_MAP, SPATIAL_ROWS, { packed(SPATIAL_ROWS) }, SPATIAL_CUTS>;
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
/// Sixty-four particles with twelve faces each, for a planar board.
pub type PlanarRaoBlackwell = RaoBlackwell<Planar, 64, 12, 0>;
/// Sixty-four particles with eight faces each, for a spatial board.
pub type SpatialRaoBlackwell = RaoBlackwell<Spatial, 64, 8, 0>;
/// A planar board with a bootstrap filter.
pub type PlanarDevice = Device<PlanarTracker, Planar, CONTACTS>;
/// A spatial board with a bootstrap filter.
pub type SpatialDevice = Device<SpatialTracker, Spatial, CONTACTS>;
/// A planar board with hypotheses over pose and faces.
pub type PlanarHypothesesDevice = Device<PlanarHypotheses, Planar, CONTACTS>;
/// A spatial board with hypotheses over pose and faces.
pub type SpatialHypothesesDevice = Device<SpatialHypotheses, Spatial, CONTACTS>;
/// Fingertip sensors of a board that has any.
pub const FINGERS: usize = 5;
/// A spatial board with hypotheses over pose and faces and a sensor in each of five fingertips.
pub type SpatialSensingDevice = Device<SpatialHypotheses, Spatial, CONTACTS, FINGERS>;
/// A planar board whose particles own their faces.
pub type PlanarRaoBlackwellDevice = Device<PlanarRaoBlackwell, Planar, CONTACTS>;
/// A spatial board whose particles own their faces.
pub type SpatialRaoBlackwellDevice = Device<SpatialRaoBlackwell, Spatial, CONTACTS>;

impl PlanarDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Bootstrap::new(Truncated::new()));
}

impl SpatialDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Bootstrap::new(Truncated::new()));
}

impl PlanarHypothesesDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Hypotheses::new());
}

impl SpatialHypothesesDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Hypotheses::new());
}

impl SpatialSensingDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(Hypotheses::new());
}

impl PlanarRaoBlackwellDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(RaoBlackwell::new());
}

impl SpatialRaoBlackwellDevice {
    /// A board that has heard nothing; all zero bits.
    pub const START: Self = Device::new(RaoBlackwell::new());
}

impl<
    S: WireSpace,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const FACES: usize,
    const N: usize,
> Onboard<S> for Bootstrap<S, Truncated<S, Matern32, SITES, ROWS, PACKED, FACES>, N>
{
    /// Contacts beside those on faces.
    const MAP: usize = SITES;
    const PARTICLES: usize = N;
    const KIND: TrackerKind = TrackerKind::Bootstrap;

    fn prepare(&mut self) {
        let kernel = Matern32 { amplitude: AMPLITUDE, lengthscale: LENGTHSCALE };
        self.map_mut().configure(kernel);
    }

    fn choose(
        &mut self,
        motion: Option<&S::Pose>,
        candidates: &[Candidate<S>],
        criterion: Criterion,
        noise: f32,
    ) -> Result<Choice, Refusal> {
        let mut belief = self.foresee(motion).ok_or(Refusal::NoShape)?;
        explore::choose(&mut belief, candidates, criterion, noise).ok_or(Refusal::NoCandidate)
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
    const KIND: TrackerKind = TrackerKind::Hypotheses;

    fn prepare(&mut self) {
        self.configure(hypotheses::Settings::DEFAULT);
    }

    fn face(&self, number: u8) -> Option<(FaceSummary<S>, u8)> {
        let face = self.faces().nth(number.into())?;
        let summary = FaceSummary {
            normal: face.normal,
            centroid: face.centre,
            deviation: math::sqrt(math::max(face.variance, 0.0)),
            tilt: math::sqrt(math::max(face.normal_variance, 0.0)),
            contacts: face.contacts,
        };
        Some((summary, self.faces().count() as u8))
    }

    fn believe(&mut self, pose: &S::Pose, covariance: &S::Covariance) -> Result<(), Refusal> {
        Hypotheses::believe(self, pose, covariance).map_err(refusal)
    }

    fn learn(&mut self, face: &FaceSummary<S>) -> Result<(), Refusal> {
        let told = ToldFace {
            normal: face.normal,
            centre: face.centroid,
            deviation: face.deviation,
            tilt: face.tilt,
            contacts: face.contacts,
        };
        Hypotheses::learn(self, &told).map_err(refusal)
    }

    fn choose(
        &mut self,
        motion: Option<&S::Pose>,
        candidates: &[Candidate<S>],
        criterion: Criterion,
        noise: f32,
    ) -> Result<Choice, Refusal> {
        let mut belief = self.foresee(motion).ok_or(Refusal::NoShape)?;
        explore::choose(&mut belief, candidates, criterion, noise).ok_or(Refusal::NoCandidate)
    }
}

fn refusal(disbelief: Disbelief) -> Refusal {
    match disbelief {
        Disbelief::Number => Refusal::Belief,
        Disbelief::Full => Refusal::MapFull,
    }
}

impl<S: WireSpace + Faceted, const PARTICLES: usize, const FACES: usize, const HISTORY: usize>
    Onboard<S> for RaoBlackwell<S, PARTICLES, FACES, HISTORY>
{
    /// Faces, each of any number of contacts.
    const MAP: usize = FACES;
    const PARTICLES: usize = PARTICLES;
    const KIND: TrackerKind = TrackerKind::RaoBlackwell;

    /// Nothing to set: faces have no model beside the contacts' noise.
    fn prepare(&mut self) {}

    fn face(&self, number: u8) -> Option<(FaceSummary<S>, u8)> {
        let faces = self.shape().faces();
        let face = faces.get(usize::from(number))?;
        let spread = face.tilt();
        let axes = S::DIMENSION - 1;
        let mut tilt = 0.0;
        for axis in 0..axes {
            tilt += spread.at(axis, axis) / axes as f32;
        }
        let summary = FaceSummary {
            normal: face.normal,
            centroid: face.centroid,
            deviation: face.deviation(),
            tilt: math::sqrt(math::max(tilt, 0.0)),
            contacts: face.contacts,
        };
        Some((summary, faces.len() as u8))
    }
}
