//! From a grasp log to poses: the core's tracker in double the comfort of a desktop.

use nalgebra::Matrix6;
use tactile_core::contact::{Contact, FreePoint, GraspView};
use tactile_core::matrix::Square;
use tactile_core::space::{Planar, Space, Spatial};
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{Baked, Ball, Ellipsoid, Gpis, Matern32, Prior, Training};
use tactile_core::track::curved::{self, Curved};
use tactile_core::track::hypotheses::{self, Hypotheses};
use tactile_core::track::{
    Automatic, Bootstrap, Estimate, MotionNoise, RaoBlackwell, Settings, Status, Tracker,
};
use tactile_core::wire::TrackerKind;

use crate::log::{GraspLog, LoggedGrasp, Noise};
use crate::slam::deviations;
use crate::space::{Bridge, Pose};

/// Contacts the host's tracker keeps before it lets the redundant go.
const CONTACTS: usize = 128;

/// Particles of the host's planar filter: what the thesis needed (figure 3.14).
const PLANAR_PARTICLES: usize = 10_000;

/// Particles of the host's spatial filter: what the thesis used (3.4).
const SPATIAL_PARTICLES: usize = 20_000;

/// The surface a tracker follows: Matérn-3/2 about a fitted ball.
pub const KERNEL: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

/// Nodes per axis of the grid that the planar surface is baked into at every grasp: 3 mm apart on an
/// object of 120 mm. (In space a grid this fine has more nodes than the particles ask for points.)
const NODES: usize = 64;

type PlanarMap =
    Gpis<Planar, Matern32, Ball<Planar>, CONTACTS, { 3 * CONTACTS }, { packed(3 * CONTACTS) }>;
type BakedMap = Baked<Planar, PlanarMap, { NODES * NODES }>;
type SpatialMap =
    Gpis<Spatial, Matern32, Ball<Spatial>, CONTACTS, { 4 * CONTACTS }, { packed(4 * CONTACTS) }>;

/// Trajectories of the curved tracker; the grasps and contacts it keeps to revise; and the contacts of its
/// map, among them those of older grasps that are settled.
const TRAJECTORIES: usize = 12;
const REVISED: usize = 24;
const REVISED_CONTACTS: usize = 112;
const CURVED: usize = 144;

/// A curved object in the plane.
type PlanarCurved = Curved<
    Planar,
    Gpis<Planar, Matern32, Ellipsoid<Planar>, CURVED, { 3 * CURVED }, { packed(3 * CURVED) }>,
    TRAJECTORIES,
    REVISED,
    REVISED_CONTACTS,
    { 3 * CURVED },
>;

/// A curved object in space.
type SpatialCurved = Curved<
    Spatial,
    Gpis<Spatial, Matern32, Ellipsoid<Spatial>, CURVED, { 4 * CURVED }, { packed(4 * CURVED) }>,
    TRAJECTORIES,
    REVISED,
    REVISED_CONTACTS,
    { 4 * CURVED },
>;
/// Hypotheses of the host, the faces of each, and the grasps that each remembers.
const HYPOTHESES: usize = 12;
const FACES: usize = 20;
const GRASPS: usize = 128;

const PLANAR_ROWS: usize = hypotheses::rows::<Planar>(FACES);
const SPATIAL_ROWS: usize = hypotheses::rows::<Spatial>(FACES);

type PlanarHypotheses =
    Hypotheses<Planar, HYPOTHESES, FACES, PLANAR_ROWS, { packed(PLANAR_ROWS) }, GRASPS>;
type SpatialHypotheses =
    Hypotheses<Spatial, HYPOTHESES, FACES, SPATIAL_ROWS, { packed(SPATIAL_ROWS) }, GRASPS>;

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

/// A core covariance in the axes of [`Step::covariance`].
pub fn six_by_six<S: Bridge>(core: &S::Covariance) -> Matrix6<f64> {
    let axes: &[usize] = if S::DIMENSION == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let mut covariance = Matrix6::zeros();
    for (i, &row) in axes.iter().enumerate() {
        for (j, &column) in axes.iter().enumerate() {
            covariance[(row, column)] = f64::from(core.at(i, j));
        }
    }
    covariance
}

/// The trackers on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// Bootstrap particle filter over one shared map (thesis 3.3.1, corrected)
    Bootstrap,
    /// A few trajectories over one Gaussian-process surface, for curved objects
    Curved,
    /// Multi-hypothesis iterated Kalman filter over pose and faces
    Hypotheses,
    /// Rao-Blackwellised particle filter: 64 particles, each with its own faces
    RaoBlackwell,
    /// `hypotheses` and `curved` side by side: the one that foretells the grasps better
    #[value(name = "auto")]
    Automatic,
}

impl Kind {
    /// Its name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Bootstrap => "bootstrap",
            Kind::Curved => "curved",
            Kind::Hypotheses => "hypotheses",
            Kind::RaoBlackwell => "rao-blackwell",
            Kind::Automatic => "auto",
        }
    }

    /// The same on a board; `None` where boards carry no such tracker.
    pub fn on_board(self) -> Option<TrackerKind> {
        match self {
            Kind::Bootstrap => Some(TrackerKind::Bootstrap),
            Kind::Hypotheses => Some(TrackerKind::Hypotheses),
            Kind::RaoBlackwell => Some(TrackerKind::RaoBlackwell),
            Kind::Curved | Kind::Automatic => None,
        }
    }

    /// Follows the object through the log: one step per grasp, the same for the same seed on every
    /// machine.
    pub fn follow(self, log: &GraspLog, seed: u64) -> Vec<Step> {
        match self {
            Kind::Bootstrap => bootstrap(log, &settings(log, seed)),
            Kind::Curved => curved(log, settings(log, seed).motion),
            Kind::Hypotheses => several_hypotheses(log, settings(log, seed).motion),
            Kind::RaoBlackwell => rao_blackwell(log, &settings(log, seed)),
            Kind::Automatic => automatic(log, settings(log, seed).motion),
        }
    }
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

/// Follows the object through the log with the bootstrap filter (thesis 3.3.1, corrected): one step
/// per grasp, the same for the same seed on every machine.
pub fn bootstrap(log: &GraspLog, settings: &Settings) -> Vec<Step> {
    if log.dimension == 2 {
        type Filter = Bootstrap<Planar, BakedMap, PLANAR_PARTICLES>;
        // Made by the compiler: the stack has no room for every part on its way into the whole.
        let mut tracker = Box::new(const { Filter::new(BakedMap::new(PlanarMap::new())) });
        tracker.map_mut().map_mut().configure(KERNEL, Ball::UNSET, Training::Normals);
        tracker.configure(*settings);
        follow(&mut *tracker, log)
    } else {
        let mut tracker =
            Box::new(Bootstrap::<Spatial, SpatialMap, SPATIAL_PARTICLES>::new(SpatialMap::new()));
        tracker.map_mut().configure(KERNEL, Ball::UNSET, Training::Normals);
        tracker.configure(*settings);
        follow(&mut *tracker, log)
    }
}

/// Follows a curved object through the log: one step per grasp, the same on every machine.
pub fn curved(log: &GraspLog, motion: MotionNoise) -> Vec<Step> {
    if log.dimension == 2 {
        let mut tracker = Box::new(PlanarCurved::new(Gpis::new()));
        expect_curved(&mut tracker, motion);
        follow(&mut *tracker, log)
    } else {
        let mut tracker = Box::new(SpatialCurved::new(Gpis::new()));
        expect_curved(&mut tracker, motion);
        follow(&mut *tracker, log)
    }
}

/// Sets the model of a curved tracker.
fn expect_curved<
    S: Space,
    P: Prior<S>,
    const SITES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const K: usize,
    const GRASPS: usize,
    const TOUCHES: usize,
>(
    tracker: &mut Curved<S, Gpis<S, Matern32, P, SITES, ROWS, PACKED>, K, GRASPS, TOUCHES, ROWS>,
    motion: MotionNoise,
) {
    tracker.map_mut().configure(KERNEL, P::UNSET, Training::Normals);
    tracker.configure(curved::Settings { motion, ..curved::Settings::DEFAULT });
}

/// Follows an object of which nobody knows whether it is curved: one step per grasp, the same on
/// every machine.
pub fn automatic(log: &GraspLog, motion: MotionNoise) -> Vec<Step> {
    let faces = hypotheses::Settings { motion, ..hypotheses::Settings::DEFAULT };
    if log.dimension == 2 {
        let mut tracker =
            Box::new(Automatic::new(PlanarHypotheses::new(), PlanarCurved::new(Gpis::new())));
        tracker.first_mut().configure(faces);
        expect_curved(tracker.second_mut(), motion);
        follow(&mut *tracker, log)
    } else {
        let mut tracker =
            Box::new(Automatic::new(SpatialHypotheses::new(), SpatialCurved::new(Gpis::new())));
        tracker.first_mut().configure(faces);
        expect_curved(tracker.second_mut(), motion);
        follow(&mut *tracker, log)
    }
}

/// Follows the object through the log with joint hypotheses of pose and faces: one step per grasp, the
/// same on every machine.
pub fn several_hypotheses(log: &GraspLog, motion: MotionNoise) -> Vec<Step> {
    let settings = hypotheses::Settings { motion, ..hypotheses::Settings::DEFAULT };
    if log.dimension == 2 {
        let mut tracker = Box::new(PlanarHypotheses::new());
        tracker.configure(settings);
        follow(&mut *tracker, log)
    } else {
        let mut tracker = Box::new(SpatialHypotheses::new());
        tracker.configure(settings);
        follow(&mut *tracker, log)
    }
}

/// Particles of the Rao-Blackwellised filter, faces that each can have, and grasps whose poses it
/// can still correct.
const FACED_PARTICLES: usize = 64;
const PLANAR_FACES: usize = 16;
const SPATIAL_FACES: usize = 16;
const HISTORY: usize = 256;

/// Follows the object through the log with the Rao-Blackwellised particle filter.
fn rao_blackwell(log: &GraspLog, settings: &Settings) -> Vec<Step> {
    if log.dimension == 2 {
        type Filter = RaoBlackwell<Planar, FACED_PARTICLES, PLANAR_FACES, HISTORY>;
        let mut tracker = Box::new(Filter::new());
        tracker.configure(settings.motion, settings.seed);
        follow(&mut *tracker, log)
    } else {
        type Filter = RaoBlackwell<Spatial, FACED_PARTICLES, SPATIAL_FACES, HISTORY>;
        let mut tracker = Box::new(Filter::new());
        tracker.configure(settings.motion, settings.seed);
        follow(&mut *tracker, log)
    }
}

/// The filter's settings for a log: its motion noise where it says, else the thesis' 100 %, and no
/// less than 0.1 mm and 0.05° so that the particles differ.
pub fn settings(log: &GraspLog, seed: u64) -> Settings {
    let thesis = MotionNoise::THESIS;
    let motion = MotionNoise {
        translation: log.noise.translation.map_or(thesis.translation, |t| t.max(1e-4) as f32),
        rotation: log.noise.rotation.map_or(thesis.rotation, |r| r.max(1e-3) as f32),
    };
    Settings { motion, seed, ..Settings::DEFAULT }
}

/// Feeds a log through any tracker. Poses that the tracker came to know better later
/// ([`Tracker::recall`]) are as it knows them in the end.
pub fn follow<S: Bridge>(tracker: &mut impl Tracker<S>, log: &GraspLog) -> Vec<Step> {
    let mut steps = online(tracker, log);
    for (grasp, step) in (0..).zip(&mut steps) {
        if let Some(pose) = tracker.recall(grasp) {
            step.pose = S::isometry(&pose);
        }
    }
    steps
}

/// Feeds a log through any tracker: each step as it was known at the time.
pub fn online<S: Bridge>(tracker: &mut impl Tracker<S>, log: &GraspLog) -> Vec<Step> {
    log.grasps
        .iter()
        .map(|grasp| {
            let motion = grasp.motion.as_ref().map(S::pose);
            let contacts = contacts::<S>(grasp, &log.noise);
            let free = free_points::<S>(grasp);
            let view = GraspView { contacts: &contacts, free: &free };
            Step::from_estimate(&tracker.update(motion.as_ref(), view))
        })
        .collect()
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
