//! What trackers and maps cost in instructions, counted exactly by QEMU (`cargo fw count bench`).
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {}

#[cfg(all(target_os = "none", not(feature = "mps2-an386")))]
compile_error!("only the mps2-an386 board counts instructions");

#[cfg(all(target_os = "none", feature = "mps2-an386"))]
mod firmware {
    use core::hint::black_box;

    use cortex_m_semihosting::{debug, hprintln};
    use tactile_core::contact::{Contact, GraspView};
    use tactile_core::device::{
        Onboard, PlanarCurved, PlanarHypotheses, PlanarRaoBlackwell, PlanarTracker, SpatialCurved,
        SpatialHypotheses, SpatialRaoBlackwell, SpatialTracker,
    };
    use tactile_core::explore::{Candidate, Criterion, Stroke};
    use tactile_core::matrix::{Coordinates, Vector};
    use tactile_core::random::Random;
    use tactile_core::space::{Planar, Pose, Space, Spatial};
    use tactile_core::surface::cholesky::packed;
    use tactile_core::surface::{Ball, Gpis, Map, Prior, Surface, ThinPlate, Training, Truncated};
    use tactile_core::track::{Bootstrap, MotionNoise, Tracker};
    use tactile_firmware::board::Selected;
    use tactile_firmware::counter::{Counter, print, unlike};

    /// Contacts in one grasp.
    const FINGERS: usize = 5;
    const ROWS: usize = 96;

    type Plate = Gpis<Spatial, ThinPlate, Ball<Spatial>, ROWS, ROWS, { packed(ROWS) }>;

    /// Contacts spread over a ball of 40 mm, felt with 1 mm and 5° of noise.
    fn touch<S: Space>(random: &mut Random) -> Contact<S> {
        let normal = random.normal::<S::Vector>().normalized().unwrap_or(S::Vector::ZERO);
        Contact {
            point: normal * 0.04,
            normal: Some(normal),
            point_deviation: 1e-3,
            normal_deviation: 0.087,
            finger: 0,
        }
    }

    fn grasp<S: Space>(random: &mut Random) -> [Contact<S>; FINGERS] {
        core::array::from_fn(|_| touch(random))
    }

    /// Ten hands about an object, none of which is turned as another: four fingers from one side, the
    /// thumb from the other.
    fn hands<S: Space>(object: &S::Pose) -> [Candidate<S>; 10] {
        core::array::from_fn(|k| {
            let mut turn = S::Tangent::ZERO;
            for i in S::DIMENSION..S::FREEDOM {
                turn[i] = 0.628 * k as f32 / (S::FREEDOM - i) as f32;
            }
            let mut hand = Candidate::new(object.retract(turn));
            for (finger, stroke) in hand.strokes.iter_mut().enumerate() {
                let side = if finger == 4 { -1.0 } else { 1.0 };
                let mut start = S::Vector::ZERO;
                start[0] = if finger == 4 { 0.0 } else { 0.02 * finger as f32 - 0.03 };
                start[1] = 0.12 * side;
                let mut direction = S::Vector::ZERO;
                direction[1] = -side;
                *stroke = Some(Stroke { start, direction, travel: 0.16 });
            }
            hand
        })
    }

    /// What choosing among ten grasps takes by the belief a tracker has now.
    #[inline(never)]
    fn choose<S: tactile_core::wire::WireSpace, T: Onboard<S>>(
        counter: &Counter,
        object: &S::Pose,
        tracker: &mut T,
    ) {
        let hands = hands::<S>(object);
        for (name, criterion) in [
            ("  best of 10 grasps by information", Criterion::Information),
            ("  best of 10 grasps by variance sum (4.20)", Criterion::VarianceSum),
        ] {
            let mut choice = None;
            let spent =
                counter.count(|| choice = tracker.choose(None, &hands, criterion, 1e-3).ok());
            if choice.is_none_or(|choice| choice.contacts < 3) {
                return unlike(&choice);
            }
            print(name, spent);
        }
    }

    /// One update of a tracker whose map is full, so that contacts are also let go.
    #[inline(never)]
    fn update<S, M, const N: usize>(counter: &Counter, name: &str, tracker: &mut Bootstrap<S, M, N>)
    where
        S: tactile_core::wire::WireSpace,
        M: Map<S>,
        Bootstrap<S, M, N>: Onboard<S>,
    {
        let mut random = Random::new(1);
        tracker.prepare();
        tracker.reset(1);
        let mut number = 0u32;
        while tracker.map().contacts() + FINGERS <= <Bootstrap<S, M, N> as Onboard<S>>::MAP {
            let contacts = grasp(&mut random);
            let view = GraspView { contacts: &contacts, free: &[] };
            if number == 1 {
                hprintln!("{} tracker, {} particles, {} contacts in the map:", name, N, FINGERS);
                counter.report("  grasp update, 5 contacts", || {
                    black_box(tracker.update(Some(&S::Pose::IDENTITY), view));
                });
            } else {
                tracker.update(Some(&S::Pose::IDENTITY), view);
            }
            number += 1;
        }
        hprintln!(
            "{} tracker, {} particles, {} contacts in the map:",
            name,
            N,
            tracker.map().contacts()
        );
        let contacts = grasp(&mut random);
        let view = GraspView { contacts: &contacts, free: &[] };
        counter.report("  grasp update, 5 contacts", || {
            black_box(tracker.update(Some(&S::Pose::IDENTITY), view));
        });
        choose::<S, _>(counter, &S::Pose::IDENTITY, tracker);
        let point = black_box(contacts[0].point);
        counter.report("  map: value, gradient and variances at a point", || {
            black_box(tracker.map().probe(point));
        });
        // Where the map was never touched, and there again.
        let novel = Contact { point: contacts[1].point * 2.0, ..contacts[1] };
        counter.report("  map: one contact more, another's place let go", || {
            black_box(tracker.map_mut().insert(&novel));
        });
        counter.report("  map: one contact merged into the others", || {
            black_box(tracker.map_mut().insert(&novel));
        });
        counter.report("  map: refit", || tracker.map_mut().refit());
    }

    /// The thesis' surface: thin plate, values only.
    #[inline(never)]
    fn thin_plate(counter: &Counter, plate: &mut Plate) {
        let mut random = Random::new(2);
        plate.configure(ThinPlate { amplitude: 0.03, range: 0.3 }, Ball::UNSET, Training::Normals);
        for _ in 0..ROWS - 1 {
            plate.insert(&Contact { normal: None, ..touch(&mut random) });
        }
        hprintln!("thin plate, 96 contacts by value:");
        let last = Contact { normal: None, ..touch(&mut random) };
        counter.report("  append the 96th row", || {
            black_box(plate.insert(&last));
        });
        counter.report("  refit", || plate.refit());
        let point = black_box(Vector([0.03, 0.01, -0.02]));
        counter.report("  mean at a point", || {
            black_box(plate.values(&[point]));
        });
        counter.report("  mean, gradient and variances at a point", || {
            black_box(plate.probe(point));
        });
        counter.report("  exact variance at a point", || {
            black_box(plate.variance(point));
        });
    }

    /// Contacts on a box of 100 × 60 (× 40) mm at `pose`, one on every second face in turn, 1 mm and 5°
    /// of noise.
    fn touch_box<S: Space>(
        pose: &S::Pose,
        number: u32,
        random: &mut Random,
    ) -> [Contact<S>; FINGERS] {
        const HALF: [f32; 3] = [0.05, 0.03, 0.02];
        core::array::from_fn(|finger| {
            let face = (number as usize + 3 * finger) % (2 * S::DIMENSION);
            let (axis, sign) = (face / 2, [1.0, -1.0][face & 1]);
            let mut normal = S::Vector::ZERO;
            normal[axis] = sign;
            let mut point = S::Vector::from_fn(|i| {
                HALF[i] * if i == axis { sign } else { 1.6 * random.uniform() - 0.8 }
            });
            point += random.normal::<S::Vector>() * 1e-3;
            let felt = normal + random.normal::<S::Vector>() * 0.087;
            Contact {
                point: pose.transform(point),
                normal: felt.normalized().map(|n| pose.rotate(n)),
                point_deviation: 1e-3,
                normal_deviation: 0.087,
                finger: finger as u8,
            }
        })
    }

    /// Sixteen grasps of a box that slips by the thesis' noise: the updates' mean and longest. Where it
    /// is in the end.
    #[inline(never)]
    fn follow<S: tactile_core::wire::WireSpace, T: Onboard<S>>(
        counter: &Counter,
        name: &str,
        tracker: &mut T,
    ) -> S::Pose {
        let mut random = Random::new(3);
        tracker.prepare();
        tracker.set_motion_noise(MotionNoise::THESIS);
        tracker.reset(1);
        let mut pose = S::Pose::IDENTITY;
        let (mut sum, mut longest) = (0u64, 0);
        for number in 0..16 {
            if number > 0 {
                pose = MotionNoise::THESIS.disturb::<S>(&pose, &mut random);
            }
            let contacts = touch_box::<S>(&pose, number, &mut random);
            let view = GraspView { contacts: &contacts, free: &[] };
            let spent = counter.count(|| {
                black_box(tracker.update(Some(&S::Pose::IDENTITY), view));
            });
            sum += u64::from(spent);
            longest = longest.max(spent);
        }
        hprintln!("{} tracker, {} in all, 16 grasps of a box:", name, T::PARTICLES);
        print("  grasp update, 5 contacts, mean", (sum / 16) as u32);
        print("  grasp update, 5 contacts, longest", longest);
        pose
    }

    /// One grasp more, after somebody put the box 300 mm away and turned it by 60°.
    #[inline(never)]
    fn carry<S: tactile_core::wire::WireSpace, T: Onboard<S>>(
        counter: &Counter,
        pose: &S::Pose,
        tracker: &mut T,
    ) {
        let mut away = S::Tangent::ZERO;
        (away[0], away[S::FREEDOM - 1]) = (0.3, 1.05);
        let contacts = touch_box::<S>(&pose.retract(away), 16, &mut Random::new(4));
        counter.report("  grasp update, carried away", || {
            let view = GraspView { contacts: &contacts, free: &[] };
            black_box(tracker.update(Some(&S::Pose::IDENTITY), view));
        });
    }

    // `entry` makes an argument of each static.
    #[allow(clippy::too_many_arguments)]
    #[cortex_m_rt::entry]
    fn main() -> ! {
        static mut PLATE: Plate = Plate::new();
        static mut PLANAR: PlanarTracker = PlanarTracker::new(Truncated::new());
        static mut SPATIAL: SpatialTracker = SpatialTracker::new(Truncated::new());
        static mut PLANAR_HYPOTHESES: PlanarHypotheses = PlanarHypotheses::new();
        static mut SPATIAL_HYPOTHESES: SpatialHypotheses = SpatialHypotheses::new();
        static mut PLANAR_PARTICLES: PlanarRaoBlackwell = PlanarRaoBlackwell::new();
        static mut SPATIAL_PARTICLES: SpatialRaoBlackwell = SpatialRaoBlackwell::new();
        static mut PLANAR_CURVED: PlanarCurved = PlanarCurved::new(Gpis::new());
        static mut SPATIAL_CURVED: SpatialCurved = SpatialCurved::new(Gpis::new());
        Selected::start();
        let counter = Counter::new();
        hprintln!("instructions, Cortex-M4F, counted by QEMU");
        thin_plate(&counter, PLATE);
        update::<Planar, _, _>(&counter, "planar", PLANAR);
        update::<Spatial, _, _>(&counter, "spatial", SPATIAL);
        let pose = follow::<Planar, _>(&counter, "planar hypotheses", PLANAR_HYPOTHESES);
        choose::<Planar, _>(&counter, &pose, PLANAR_HYPOTHESES);
        carry::<Planar, _>(&counter, &pose, PLANAR_HYPOTHESES);
        let pose = follow::<Spatial, _>(&counter, "spatial hypotheses", SPATIAL_HYPOTHESES);
        choose::<Spatial, _>(&counter, &pose, SPATIAL_HYPOTHESES);
        carry::<Spatial, _>(&counter, &pose, SPATIAL_HYPOTHESES);
        follow::<Planar, _>(&counter, "planar rao-blackwell", PLANAR_PARTICLES);
        follow::<Spatial, _>(&counter, "spatial rao-blackwell", SPATIAL_PARTICLES);
        follow::<Planar, _>(&counter, "planar curved", PLANAR_CURVED);
        follow::<Spatial, _>(&counter, "spatial curved", SPATIAL_CURVED);
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }
}
