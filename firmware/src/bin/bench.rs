//! What the core costs in instructions, counted exactly by QEMU (`cargo fw count bench`).
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {}

#[cfg(all(target_os = "none", not(feature = "mps2-an386")))]
compile_error!("only the mps2-an386 board counts instructions");

#[cfg(all(target_os = "none", feature = "mps2-an386"))]
mod firmware {
    use core::hint::black_box;
    use core::sync::atomic::{AtomicU32, Ordering};

    use cortex_m_semihosting::{debug, hprintln};
    use tactile_core::contact::{Contact, GraspView};
    use tactile_core::device::{
        Board, Fingers, Onboard, PlanarHypotheses, PlanarTracker, Sensing, SpatialHypotheses,
        SpatialTracker,
    };
    use tactile_core::driver::Sampler;
    use tactile_core::driver::ads131m08::{self, Ads131m08, Overlapped};
    use tactile_core::driver::background::BackgroundDevice;
    use tactile_core::driver::biotac::{self, BioTac};
    use tactile_core::driver::embedded_hal::delay::DelayNs;
    use tactile_core::driver::embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
    use tactile_core::driver::emulated::{Ads131m08Chip, BioTacChip};
    use tactile_core::explore::{Candidate, Criterion, Stroke};
    use tactile_core::matrix::{Coordinates, Vector};
    use tactile_core::random::Random;
    use tactile_core::sensing::calibration::GaugeCalibration;
    use tactile_core::sensing::fingertip::{Fingertip, Shape};
    use tactile_core::sensing::{
        ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, GaugeReading,
        WrenchEstimator, WrenchSettings,
    };
    use tactile_core::space::{Planar, Spatial, SpatialPose};
    use tactile_core::space::{Pose, Space};
    use tactile_core::surface::cholesky::packed;
    use tactile_core::surface::{Ball, Gpis, Map, Prior, Surface, ThinPlate, Training};
    use tactile_core::track::{Bootstrap, MotionNoise, Tracker};
    use tactile_core::wire::{FingertipFrame, SensorFrame, SensorPart, Skin};
    use tactile_firmware::board::{Selected, instruction_timer};
    use tactile_firmware::bus::{Bus, Chip};
    use tactile_firmware::registers::Block;

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

    /// Registers that are memory: what is written stays, and nothing happens.
    struct Still<const N: usize>([AtomicU32; N]);

    impl<const N: usize> Still<N> {
        const fn new() -> Self {
            Still([const { AtomicU32::new(0) }; N])
        }
    }

    impl<const N: usize> Block for &'static Still<N> {
        #[inline(always)]
        fn read(&self, offset: usize) -> u32 {
            self.0[offset / 4].load(Ordering::Relaxed)
        }

        #[inline(always)]
        fn write(&self, offset: usize, value: u32) {
            self.0[offset / 4].store(value, Ordering::Relaxed);
        }

        #[inline(always)]
        fn address(&self, offset: usize) -> u32 {
            self.0.as_ptr() as usize as u32 + offset as u32
        }
    }

    /// As many as the DMA controller has up to its fourth stream.
    type Still64 = &'static Still<64>;

    /// An emulated chip; or a line that repeats bytes, so that what is left is the driver; or a chip
    /// whose frames are carried by the STM32's bus with DMA, over registers that are memory.
    enum Line<C> {
        Chip(C),
        Repeated([u8; ads131m08::FRAME]),
        Carried(C, Chip<'static, Still64, NoDelay>),
    }

    impl<C> ErrorType for Line<C> {
        type Error = ErrorKind;
    }

    impl<C: SpiDevice<Error = core::convert::Infallible>> SpiDevice for Line<C> {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
            let bytes = match self {
                Line::Chip(chip) | Line::Carried(chip, _) => {
                    return chip.transaction(operations).map_err(|never| match never {});
                }
                Line::Repeated(bytes) => bytes,
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

    impl<C: SpiDevice<Error = core::convert::Infallible>> BackgroundDevice for Line<C> {
        fn begin(&mut self, frame: &[u8]) -> Result<bool, ErrorKind> {
            match self {
                Line::Carried(_, bus) => bus.begin(frame),
                _ => Err(ErrorKind::Other),
            }
        }

        fn fetch(&mut self, frame: &mut [u8]) -> Result<bool, ErrorKind> {
            match self {
                Line::Carried(_, bus) => bus.fetch(frame),
                _ => Err(ErrorKind::Other),
            }
        }
    }

    struct NoDelay;

    impl DelayNs for NoDelay {
        fn delay_ns(&mut self, _: u32) {}
    }

    fn unlike(what: &impl core::fmt::Debug) {
        hprintln!("not what was to be counted: {:?}", what);
        debug::exit(debug::EXIT_FAILURE);
    }

    /// What a driver spends on one reading, beside the transfer itself.
    #[inline(never)]
    fn drivers(counter: &Counter) {
        let chip = Ads131m08Chip::showing([1000, -2000, 3000, -4000, 5000, -6000, 0, 0]);
        let mut gauges = Ads131m08::polled(Line::Chip(chip), NoDelay, ads131m08::Settings::GAUGES);
        let started = gauges.start();
        let frame = answered(gauges.spi());
        *gauges.spi() = Line::Repeated(frame);
        let mut read = Ok(None);
        hprintln!("drivers, one reading, without the transfer:");
        counter.report("  ADS131M08, a frame of eight channels", || read = gauges.poll());
        let mut bytes = [0; ads131m08::FRAME];
        bytes[..2].copy_from_slice(&biotac::encode(2893));
        let mut sensor = BioTac::new(Line::<BioTacChip>::Repeated(bytes), NoDelay);
        let mut whole = Ok(biotac::Frame::ZERO);
        counter.report("  BioTac, a frame of 44 slots", || whole = sensor.sample());
        if !matches!((started, read, whole), (Ok(()), Ok(Some(_)), Ok(_))) {
            unlike(&(started, read, whole));
        }
    }

    /// What the chip answers to no command, whose checksum this is.
    fn answered(line: &mut impl SpiDevice) -> [u8; ads131m08::FRAME] {
        let mut frame = [0; ads131m08::FRAME];
        [frame[3], frame[4]] = [0xcc, 0x9c];
        let _ = line.transfer_in_place(&mut frame);
        frame
    }

    /// Feeds an estimator a tare, then presses; counts a reading once its window is full.
    fn press<E: ContactEstimator>(
        counter: &Counter,
        name: &str,
        estimator: &mut E,
        (free, pressed): (E::Reading, E::Reading),
    ) {
        let mut time = 0;
        for _ in 0..300 {
            time += 1000;
            black_box(estimator.estimate(&free, time)).ok();
        }
        for _ in 0..20 {
            time += 1000;
            black_box(estimator.estimate(&pressed, time)).ok();
        }
        let mut felt = Ok(());
        let spent = counter
            .count(|| felt = black_box(&estimator.estimate(&pressed, time + 1000)).map(|_| ()));
        if felt.is_err() {
            unlike(&felt);
        }
        hprintln!("{:<48} {:>10}", name, spent);
        for _ in 0..20 {
            time += 1000;
            black_box(estimator.estimate(&free, time)).ok();
        }
        let free =
            counter.count(|| felt = black_box(&estimator.estimate(&free, time + 1000)).map(|_| ()));
        hprintln!("{:<48} {:>10}", "    while nothing touches", free);
    }

    /// From readings to contacts.
    #[inline(never)]
    fn estimators(
        counter: &Counter,
        wrench: &mut WrenchEstimator,
        electrodes: &mut ElectrodeEstimator,
    ) {
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
        for (name, shape) in shapes {
            let range = (-0x80_0000, 0x7f_ffff);
            let Ok(gauges) = GaugeCalibration::new(matrix, range, WrenchSettings::NANO17) else {
                return;
            };
            let settings = WrenchSettings::nano17(gauges, Fingertip { shape, edge: None });
            if let Err(error) = wrench.configure(&settings) {
                return unlike(&error);
            }
            // 1.5 N on the side that faces down, a little of it along the finger.
            let (point, force) = (Vector([0.0, 0.0, -0.007]), Vector([0.2, 0.0, 1.5]));
            let moment = point.cross(force);
            let load = [force[0], force[1], force[2], moment[0], moment[1], moment[2]];
            let words =
                core::array::from_fn(|k| (load[k] / WrenchSettings::NANO17[k] * 8e6) as i32);
            press(counter, name, wrench, (GaugeReading([0; 6]), GaugeReading(words)));
        }
        if let Err(error) = electrodes.configure(&ElectrodeSettings::BIOTAC) {
            return unlike(&error);
        }
        // Five electrodes rise on average under a newton of the simulated film, eight at most.
        let mut pressed = [3000; 19];
        for (electrode, word) in [(16, 2000), (1, 2800), (11, 2800), (9, 2900), (17, 2950)] {
            pressed[electrode] = word;
        }
        let readings = (ElectrodeReading([3000; 19]), ElectrodeReading(pressed));
        press(counter, "  electrodes, five rise", electrodes, readings);
        for (electrode, word) in [(2, 2900), (12, 2900), (7, 2970)] {
            pressed[electrode] = word;
        }
        let readings = (ElectrodeReading([3000; 19]), ElectrodeReading(pressed));
        press(counter, "  electrodes, eight rise", electrodes, readings);
    }

    /// What a finger that touches spends on a reading, from the sensor's registers to a contact in the
    /// world, and what five of them take at 1 kHz.
    #[inline(never)]
    fn hand(counter: &Counter, board: Selected, fingers: &mut Fingers<Spatial, 1>) {
        static SPI: Still<64> = Still::new();
        static DMA: Still<64> = Still::new();
        static PORT: Still<64> = Still::new();
        static BUS: Bus<Still64> = Bus::new(&SPI, &DMA, &PORT);
        // Ready for a byte, a byte is there; the frame is through.
        SPI.0[2].store(0b11, Ordering::Relaxed);
        DMA.0[0].store(1 << 5, Ordering::Relaxed);

        let load: [f32; 6] = [0.2, 0.0, 1.5, 0.0, -0.0014, 0.0];
        let words = core::array::from_fn(|k| match load.get(k) {
            Some(load) => (load / WrenchSettings::NANO17[k] * 8e6) as i32,
            None => 0,
        });
        // What a chip that is set up sends, free and pressed.
        let chip = Line::Chip(Ads131m08Chip::showing([0; ads131m08::CHANNELS]));
        let mut example = Ads131m08::polled(chip, NoDelay, ads131m08::Settings::GAUGES);
        let started = example.start();
        let free = answered(example.spi());
        if let Line::Chip(chip) = example.spi() {
            chip.show(words);
        }
        let pressed = answered(example.spi());

        let chip = Ads131m08Chip::showing([0; ads131m08::CHANNELS]);
        let line = Line::Carried(chip, Chip::new(&BUS, 0, NoDelay));
        let chip = Ads131m08::polled(line, NoDelay, ads131m08::Settings::GAUGES);
        let mut board = Sensing::new(board, [Overlapped::new(chip)]);
        let show = |bytes: &[u8; ads131m08::FRAME]| {
            for (back, byte) in BUS.buffers().back().iter().zip(bytes) {
                back.store(*byte, Ordering::Relaxed);
            }
        };

        let rows = core::array::from_fn::<_, 6, _>(|row| {
            let mut numbers = [0.0; 6];
            numbers[row] = WrenchSettings::NANO17[row] / 8e6;
            SensorPart::Row { row: row as u8, numbers }
        });
        let skin = SensorPart::Skin(Skin::CappedCylinder { radius: 0.008, length: 0.02 });
        for part in [SensorPart::Gauges].into_iter().chain(rows).chain([skin, SensorPart::Use]) {
            if let Err(refusal) = fingers.tell(&SensorFrame { finger: 0, part }) {
                return unlike(&refusal);
            }
        }
        let placed = fingers.place(&FingertipFrame::new(0, &SpatialPose::IDENTITY));

        show(&free);
        // Begun and fetched, three hundred readings.
        for _ in 0..600 {
            fingers.feel(0, board.sample(0));
        }
        show(&pressed);
        for _ in 0..40 {
            fingers.feel(0, board.sample(0));
        }
        let mut felt = None;
        let spent = counter.count(|| {
            black_box(fingers.feel(0, board.sample(0)));
            felt = fingers.feel(0, board.sample(0));
        });
        if started.is_err() || placed.is_err() || felt.is_none() {
            return unlike(&(started, placed, fingers.report(0)));
        }
        hprintln!("a finger with gauges, from DMA to a contact in the world:");
        hprintln!("{:<48} {:>10}", "  one reading, begun and fetched", spent);
        // Of 168 million a second, in hundredths of a percent.
        let share = u64::from(5 * 1000 * spent) * 10_000 / 168_000_000;
        hprintln!(
            "  five at 1 kHz: {}.{:02} instructions for every 100 cycles of 168 MHz",
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
        static mut SENSORS: (WrenchEstimator, ElectrodeEstimator) =
            (WrenchEstimator::new(), ElectrodeEstimator::new());
        static mut FINGERTIP: Fingers<Spatial, 1> = Fingers::new();
        let board = Selected::start();
        let counter = Counter::new();
        hprintln!("instructions, Cortex-M4F, counted by QEMU");
        thin_plate(&counter, PLATE);
        update::<Planar, _, _>(&counter, "planar", PLANAR);
        update::<Spatial, _, _>(&counter, "spatial", SPATIAL);
        follow::<Planar, _>(&counter, "planar hypotheses", PLANAR_HYPOTHESES);
        follow::<Spatial, _>(&counter, "spatial hypotheses", SPATIAL_HYPOTHESES);
        drivers(&counter);
        estimators(&counter, &mut SENSORS.0, &mut SENSORS.1);
        hand(&counter, board, FINGERTIP);
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }
}
