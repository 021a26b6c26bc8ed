//! The trackers on offer: the core's, in the sizes of a desktop.

use tactile_core::space::{Planar, Space, Spatial};
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{Baked, Ball, Ellipsoid, Gpis, Matern32, Prior, Training};
use tactile_core::track::curved::{self, Curved};
use tactile_core::track::hypotheses::{self, Hypotheses};
use tactile_core::track::{Automatic, Bootstrap, MotionNoise, RaoBlackwell, Settings};
use tactile_core::wire::TrackerKind;

use crate::log::GraspLog;
use crate::slam::Progress;
use crate::slam::track::{Follower, Step, settings};

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

    /// The same on a board.
    pub fn on_board(self) -> TrackerKind {
        match self {
            Kind::Bootstrap => TrackerKind::Bootstrap,
            Kind::Hypotheses => TrackerKind::Hypotheses,
            Kind::RaoBlackwell => TrackerKind::RaoBlackwell,
            Kind::Curved => TrackerKind::Curved,
            Kind::Automatic => TrackerKind::Automatic,
        }
    }

    /// What a board says that it runs.
    pub fn of_board(tracker: TrackerKind) -> Kind {
        match tracker {
            TrackerKind::Bootstrap => Kind::Bootstrap,
            TrackerKind::Hypotheses => Kind::Hypotheses,
            TrackerKind::RaoBlackwell => Kind::RaoBlackwell,
            TrackerKind::Curved => Kind::Curved,
            TrackerKind::Automatic => Kind::Automatic,
        }
    }

    /// Follows the object through the log: one step per grasp, the same for the same seed on every
    /// machine.
    pub fn follow(self, log: &GraspLog, seed: u64) -> Vec<Step> {
        self.follow_told(log, seed, &|_, _| ())
    }

    /// Like [`Kind::follow`]; `told` hears after each grasp how many are done, and of how many.
    pub fn follow_told(self, log: &GraspLog, seed: u64, told: Progress<'_>) -> Vec<Step> {
        let mut follower = self.start(log, seed);
        for (number, grasp) in (1..).zip(&log.grasps) {
            follower.take(grasp, &log.noise);
            told(number, log.grasps.len());
        }
        follower.steps()
    }

    /// The tracker before the first grasp of a log, of which the dimension and the noise count.
    pub fn start(self, log: &GraspLog, seed: u64) -> Follower {
        let (dimension, settings) = (log.dimension, settings(log, seed));
        roomy(|| match self {
            Kind::Bootstrap => bootstrap(dimension, &settings),
            Kind::Curved => curved(dimension, settings.motion),
            Kind::Hypotheses => several_hypotheses(dimension, settings.motion),
            Kind::RaoBlackwell => rao_blackwell(dimension, &settings),
            Kind::Automatic => automatic(dimension, settings.motion),
        })
    }
}

/// Bytes of stack that a tracker is built on.
const ROOM: usize = 64 << 20;

/// What is large passes over a stack on its way into its box: over one with room for it, whatever the caller's has.
fn roomy<T: Send>(build: impl Fn() -> T + Sync) -> T {
    let built = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(ROOM).spawn_scoped(scope, &build);
        thread.ok()?.join().ok()
    });
    built.unwrap_or_else(build)
}

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
const TRAJECTORIES: usize = 8;
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

/// The bootstrap filter (thesis 3.3.1, corrected).
fn bootstrap(dimension: usize, settings: &Settings) -> Follower {
    if dimension == 2 {
        type Filter = Bootstrap<Planar, BakedMap, PLANAR_PARTICLES>;
        // Made by the compiler: the stack has no room for every part on its way into the whole.
        let mut tracker = Box::new(const { Filter::new(BakedMap::new(PlanarMap::new())) });
        tracker.map_mut().map_mut().configure(KERNEL, Ball::UNSET, Training::Normals);
        tracker.configure(*settings);
        Follower::new(tracker)
    } else {
        let mut tracker =
            Box::new(Bootstrap::<Spatial, SpatialMap, SPATIAL_PARTICLES>::new(SpatialMap::new()));
        tracker.map_mut().configure(KERNEL, Ball::UNSET, Training::Normals);
        tracker.configure(*settings);
        Follower::new(tracker)
    }
}

/// A curved object.
fn curved(dimension: usize, motion: MotionNoise) -> Follower {
    if dimension == 2 {
        let mut tracker = Box::new(PlanarCurved::new(Gpis::new()));
        expect_curved(&mut tracker, motion);
        Follower::new(tracker)
    } else {
        let mut tracker = Box::new(SpatialCurved::new(Gpis::new()));
        expect_curved(&mut tracker, motion);
        Follower::new(tracker)
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

/// Most contacts of a grasp that the curved tracker can wait with.
const FELT: usize = 16;

/// Flat faces, and curved where they do not foretell what is felt.
type EitherWay<S, A, B> = Automatic<S, A, B, REVISED, FELT>;

/// An object of which nobody knows whether it is curved.
fn automatic(dimension: usize, motion: MotionNoise) -> Follower {
    let faces = hypotheses::Settings { motion, ..hypotheses::Settings::DEFAULT };
    if dimension == 2 {
        let mut tracker =
            Box::new(EitherWay::new(PlanarHypotheses::new(), PlanarCurved::new(Gpis::new())));
        tracker.first_mut().configure(faces);
        expect_curved(tracker.second_mut(), motion);
        Follower::new(tracker)
    } else {
        let mut tracker =
            Box::new(EitherWay::new(SpatialHypotheses::new(), SpatialCurved::new(Gpis::new())));
        tracker.first_mut().configure(faces);
        expect_curved(tracker.second_mut(), motion);
        Follower::new(tracker)
    }
}

/// Joint hypotheses of pose and faces.
fn several_hypotheses(dimension: usize, motion: MotionNoise) -> Follower {
    let settings = hypotheses::Settings { motion, ..hypotheses::Settings::DEFAULT };
    if dimension == 2 {
        let mut tracker = Box::new(PlanarHypotheses::new());
        tracker.configure(settings);
        Follower::new(tracker)
    } else {
        let mut tracker = Box::new(SpatialHypotheses::new());
        tracker.configure(settings);
        Follower::new(tracker)
    }
}

/// Particles of the Rao-Blackwellised filter, faces that each can have, and grasps whose poses it
/// can still correct.
const FACED_PARTICLES: usize = 64;
const PLANAR_FACES: usize = 16;
const SPATIAL_FACES: usize = 16;
const HISTORY: usize = 256;

/// The Rao-Blackwellised particle filter.
fn rao_blackwell(dimension: usize, settings: &Settings) -> Follower {
    if dimension == 2 {
        type Filter = RaoBlackwell<Planar, FACED_PARTICLES, PLANAR_FACES, HISTORY>;
        let mut tracker = Box::new(Filter::new());
        tracker.configure(settings.motion, settings.seed);
        Follower::new(tracker)
    } else {
        type Filter = RaoBlackwell<Spatial, FACED_PARTICLES, SPATIAL_FACES, HISTORY>;
        let mut tracker = Box::new(Filter::new());
        tracker.configure(settings.motion, settings.seed);
        Follower::new(tracker)
    }
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;
    use crate::sim::{Options, simulate};

    /// A thread's usual stack is enough for every tracker.
    #[test]
    fn trackers_need_no_stack_of_their_caller() {
        for object in ["rectangle:0.1x0.06", "box:0.1x0.06x0.05"] {
            let options = Options { grasps: Some(2), ..Options::new(object.parse().unwrap()) };
            let log = simulate(&options).unwrap().log;
            let small = std::thread::Builder::new().stack_size(1 << 20);
            let followed = move || {
                let follow = |kind: &Kind| kind.follow(&log, 1).len();
                Kind::value_variants().iter().map(follow).collect::<Vec<_>>()
            };
            assert_eq!(small.spawn(followed).unwrap().join().unwrap(), [2; 5], "{object}");
        }
    }

    #[test]
    fn one_grasp_after_the_other_is_as_good_as_all_at_once() {
        let options =
            Options { grasps: Some(5), ..Options::new("rectangle:0.1x0.06".parse().unwrap()) };
        let log = simulate(&options).unwrap().log;
        let mut follower = Kind::Hypotheses.start(&log, 3);
        assert!(follower.steps().is_empty());
        for (k, grasp) in log.grasps.iter().enumerate() {
            follower.take(grasp, &log.noise);
            let so_far = GraspLog { grasps: log.grasps[..=k].to_vec(), ..log.clone() };
            assert_eq!(follower.steps(), Kind::Hypotheses.follow(&so_far, 3), "{k}");
        }
    }
}
