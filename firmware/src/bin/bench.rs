//! What the core costs in instructions, counted exactly by QEMU (`cargo fw count bench`).
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
        Onboard, PlanarHypotheses, PlanarTracker, SpatialHypotheses, SpatialTracker,
    };
    use tactile_core::driver::Sampler;
    use tactile_core::driver::ads131m08::{self, Ads131m08};
    use tactile_core::driver::biotac::{self, BioTac};
    use tactile_core::driver::embedded_hal::delay::DelayNs;
    use tactile_core::driver::embedded_hal::spi::{ErrorType, Operation, SpiDevice};
    use tactile_core::driver::emulated::{Ads131m08Chip, BioTacChip};
    use tactile_core::explore::{Candidate, Criterion, Stroke};
    use tactile_core::matrix::{Coordinates, Matrix, Vector};
    use tactile_core::random::Random;
    use tactile_core::sensing::calibration::GaugeCalibration;
    use tactile_core::sensing::fingertip::{Fingertip, Shape};
    use tactile_core::sensing::{
        ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, GaugeReading,
        Touch, WrenchEstimator, WrenchSettings,
    };
    use tactile_core::space::{Planar, Spatial, SpatialPose};
    use tactile_core::space::{Pose, Space};
    use tactile_core::surface::cholesky::packed;
    use tactile_core::surface::{Ball, Gpis, Map, Prior, Surface, ThinPlate, Training};
    use tactile_core::track::{Bootstrap, MotionNoise, Tracker};
    use tactile_firmware::board::{Selected, instruction_timer};

    /// Contacts in one grasp.
    const FINGERS: usize = 5;
    const ROWS: usize = 96;

    type Plate = Gpis<Spatial, ThinPlate, Ball<Spatial>, ROWS, ROWS, { packed(ROWS) }>;

    /// Counts instructions: under `-icount` every instruction takes the same time.
    struct Counter {
        empty: u32,
        ticks_per_instruction: f32,
    }

    impl Counter {
        fn new() -> Self {
            let empty = ticks(|| ());
            // Three thousand instructions that no compiler removes.
            let known = ticks(|| {
                for _ in 0..1000 {
                    cortex_m::asm::nop();
                }
            });
            Counter { empty, ticks_per_instruction: (known - empty) as f32 / 3000.0 }
        }

        fn count(&self, run: impl FnOnce()) -> u32 {
            let spent = ticks(run).wrapping_sub(self.empty);
            (spent as f32 / self.ticks_per_instruction) as u32
        }

        fn report(&self, what: &str, run: impl FnOnce()) {
            hprintln!("{:<48} {:>10}", what, self.count(run));
        }
    }

    #[inline(never)]
    fn ticks(run: impl FnOnce()) -> u32 {
        let start = instruction_timer();
        run();
        instruction_timer().wrapping_sub(start)
    }

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
                hprintln!("not what was to be counted: {:?}", choice);
                return debug::exit(debug::EXIT_FAILURE);
            }
            hprintln!("{:<48} {:>10}", name, spent);
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

    /// Sixteen grasps of a box that slips by the thesis' noise: the updates' mean and longest.
    #[inline(never)]
    fn follow<S: tactile_core::wire::WireSpace, T: Onboard<S>>(
        counter: &Counter,
        name: &str,
        tracker: &mut T,
    ) {
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
        hprintln!("{:<48} {:>10}", "  grasp update, 5 contacts, mean", (sum / 16) as u32);
        hprintln!("{:<48} {:>10}", "  grasp update, 5 contacts, longest", longest);
        choose::<S, _>(counter, &pose, tracker);
    }

    /// An emulated chip, or afterwards a line that repeats bytes: what is left is the driver.
    enum Bus<C> {
        Chip(C),
        Repeated([u8; ads131m08::FRAME]),
    }

    impl<C> ErrorType for Bus<C> {
        type Error = core::convert::Infallible;
    }

    impl<C: SpiDevice<Error = core::convert::Infallible>> SpiDevice for Bus<C> {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            let bytes = match self {
                Bus::Chip(chip) => return chip.transaction(operations),
                Bus::Repeated(bytes) => bytes,
            };
            for operation in operations {
                if let Operation::TransferInPlace(out) = operation {
                    for (out, byte) in out.iter_mut().zip(bytes.iter()) {
                        *out = *byte;
                    }
                }
            }
            Ok(())
        }
    }

    struct NoDelay;

    impl DelayNs for NoDelay {
        fn delay_ns(&mut self, _: u32) {}
    }

    /// What a driver spends on one reading, beside the transfer itself.
    #[inline(never)]
    fn drivers(counter: &Counter) -> u32 {
        let chip = Ads131m08Chip::showing([1000, -2000, 3000, -4000, 5000, -6000, 0, 0]);
        let mut gauges = Ads131m08::polled(Bus::Chip(chip), NoDelay, ads131m08::Settings::GAUGES);
        let started = gauges.start();
        // What the chip answers to no command, whose checksum this is.
        let mut frame = [0; ads131m08::FRAME];
        [frame[3], frame[4]] = [0xcc, 0x9c];
        let _ = gauges.spi().transfer_in_place(&mut frame);
        *gauges.spi() = Bus::Repeated(frame);
        let mut read = Ok(None);
        hprintln!("drivers, one reading, without the transfer:");
        let spent = counter.count(|| read = gauges.poll());
        hprintln!("{:<48} {:>10}", "  ADS131M08, a frame of eight channels", spent);
        let mut bytes = [0; ads131m08::FRAME];
        bytes[..2].copy_from_slice(&biotac::encode(2893));
        let mut sensor = BioTac::new(Bus::<BioTacChip>::Repeated(bytes), NoDelay);
        let mut whole = Ok(biotac::Frame::ZERO);
        counter.report("  BioTac, a frame of 44 slots", || whole = sensor.sample());
        if !matches!((started, read, whole), (Ok(()), Ok(Some(_)), Ok(_))) {
            hprintln!("not what was to be counted: {:?} {:?} {:?}", started, read, whole);
            debug::exit(debug::EXIT_FAILURE);
        }
        spent
    }

    /// Feeds an estimator a tare, then presses; counts a reading once its window is full.
    fn press<E: ContactEstimator>(
        counter: &Counter,
        name: &str,
        estimator: &mut E,
        (free, pressed): (E::Reading, E::Reading),
    ) -> u32 {
        let mut time = 0;
        for _ in 0..300 {
            time += 1000;
            black_box(estimator.estimate(&free, time)).ok();
        }
        for _ in 0..20 {
            time += 1000;
            black_box(estimator.estimate(&pressed, time)).ok();
        }
        let mut touch = Err(tactile_core::sensing::NoContact::Taring);
        let spent = counter.count(|| touch = estimator.estimate(&pressed, time + 1000));
        if touch.is_err() {
            hprintln!("not what was to be counted: {:?}", touch);
            debug::exit(debug::EXIT_FAILURE);
        }
        hprintln!("{:<48} {:>10}", name, spent);
        for _ in 0..20 {
            time += 1000;
            black_box(estimator.estimate(&free, time)).ok();
        }
        let free = counter.count(|| touch = estimator.estimate(&free, time + 1000));
        hprintln!("{:<48} {:>10}", "    while nothing touches", free);
        spent
    }

    /// From readings to contacts, and what a hand of five fingers spends on them.
    #[inline(never)]
    fn estimators(
        counter: &Counter,
        wrench: &mut WrenchEstimator,
        electrodes: &mut ElectrodeEstimator,
    ) -> u32 {
        hprintln!("estimators, one reading of a finger that touches:");
        let shapes = [
            ("  wrench, sphere", Shape::Sphere { radius: 0.008 }),
            ("  wrench, ellipsoid", Shape::Ellipsoid { half_axes: Vector([0.012, 0.008, 0.007]) }),
            ("  wrench, cylinder with cap", Shape::CappedCylinder { radius: 0.008, length: 0.02 }),
        ];
        let mut matrix = [[0.0; 6]; 6];
        for (k, row) in matrix.iter_mut().enumerate() {
            row[k] = WrenchSettings::NANO17[k] / 8e6;
        }
        let mut most = 0;
        for (name, shape) in shapes {
            let range = (-0x80_0000, 0x7f_ffff);
            let Ok(gauges) = GaugeCalibration::new(matrix, range, WrenchSettings::NANO17) else {
                return 0;
            };
            let settings = WrenchSettings::nano17(gauges, Fingertip { shape, edge: None });
            if wrench.configure(&settings).is_err() {
                return 0;
            }
            // 1.5 N on the side that faces down, a little of it along the finger.
            let (point, force) = (Vector([0.0, 0.0, -0.007]), Vector([0.2, 0.0, 1.5]));
            let moment = point.cross(force);
            let load = [force[0], force[1], force[2], moment[0], moment[1], moment[2]];
            let words =
                core::array::from_fn(|k| (load[k] / WrenchSettings::NANO17[k] * 8e6) as i32);
            most =
                most.max(press(counter, name, wrench, (GaugeReading([0; 6]), GaugeReading(words))));
        }
        if electrodes.configure(&ElectrodeSettings::BIOTAC).is_err() {
            return 0;
        }
        let mut pressed = [3000; 19];
        for (electrode, word) in [(16, 2000), (1, 2800), (11, 2800), (9, 2900), (17, 2950)] {
            pressed[electrode] = word;
        }
        let readings = (ElectrodeReading([3000; 19]), ElectrodeReading(pressed));
        press(counter, "  electrodes", electrodes, readings);
        most
    }

    /// What a fingertip spends on its place in the world, and five on everything at 1 kHz.
    #[inline(never)]
    fn hand(counter: &Counter, driver: u32, estimator: u32) {
        let touch = Touch {
            time: 0,
            point: Vector([0.0, 0.0, -0.008]),
            normal: Vector([0.0, 0.0, 1.0]),
            force: Vector([0.0, 0.0, 1.5]),
            covariance: Matrix([[1e-8, 0.0, 0.0], [0.0, 1e-8, 0.0], [0.0, 0.0, 1e-8]]),
            normal_deviation: 0.01,
            slip: None,
        };
        let (touch, pose) = black_box((touch, SpatialPose::IDENTITY));
        let mut contact = None;
        let placing = counter.count(|| contact = touch.contact::<Spatial>(&pose, 0));
        black_box(contact);
        hprintln!("{:<48} {:>10}", "  a contact in the world", placing);
        // Of 168 million a second, in hundredths of a percent.
        let share = u64::from(5 * 1000 * (driver + estimator + placing)) * 10_000 / 168_000_000;
        hprintln!("five fingers with gauges at 1 kHz, without the transfers:");
        hprintln!(
            "  driver, estimator, contact: {}.{:02} instructions for every 100 cycles of 168 MHz",
            share / 100,
            share % 100
        );
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        static mut PLATE: Plate = Plate::new();
        static mut PLANAR: PlanarTracker = PlanarTracker::new(Gpis::new());
        static mut SPATIAL: SpatialTracker = SpatialTracker::new(Gpis::new());
        static mut PLANAR_HYPOTHESES: PlanarHypotheses = PlanarHypotheses::new();
        static mut SPATIAL_HYPOTHESES: SpatialHypotheses = SpatialHypotheses::new();
        static mut WRENCH: WrenchEstimator = WrenchEstimator::new();
        static mut ELECTRODES: ElectrodeEstimator = ElectrodeEstimator::new();
        let _board = Selected::start();
        let counter = Counter::new();
        hprintln!("instructions, Cortex-M4F, counted by QEMU");
        thin_plate(&counter, PLATE);
        update::<Planar, _, _>(&counter, "planar", PLANAR);
        update::<Spatial, _, _>(&counter, "spatial", SPATIAL);
        follow::<Planar, _>(&counter, "planar hypotheses", PLANAR_HYPOTHESES);
        follow::<Spatial, _>(&counter, "spatial hypotheses", SPATIAL_HYPOTHESES);
        let driver = drivers(&counter);
        let estimator = estimators(&counter, WRENCH, ELECTRODES);
        hand(&counter, driver, estimator);
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }
}
