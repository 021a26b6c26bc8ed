//! What fingertip sensors cost, driver to contact (`cargo fw count bench-sensing`).
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
    use tactile_core::device::{Board, Fingers, Sensing};
    use tactile_core::driver::Sampler;
    use tactile_core::driver::ads131m08::{self, Ads131m08, Overlapped};
    use tactile_core::driver::background::BackgroundDevice;
    use tactile_core::driver::biotac::{self, BioTac};
    use tactile_core::driver::embedded_hal::delay::DelayNs;
    use tactile_core::driver::embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
    use tactile_core::driver::emulated::{Ads131m08Chip, BioTacChip};
    use tactile_core::matrix::Vector;
    use tactile_core::sensing::calibration::GaugeCalibration;
    use tactile_core::sensing::fingertip::{Fingertip, Shape};
    use tactile_core::sensing::{
        ContactEstimator, ElectrodeEstimator, ElectrodeReading, ElectrodeSettings, GaugeReading,
        WrenchEstimator, WrenchSettings,
    };
    use tactile_core::space::{Pose, Spatial, SpatialPose};
    use tactile_core::wire::{FingertipFrame, SensorFrame, SensorPart, Skin};
    use tactile_firmware::board::Selected;
    use tactile_firmware::bus::{Bus, Chip};
    use tactile_firmware::counter::{Counter, print, unlike};
    use tactile_firmware::registers::Block;

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
        print(name, spent);
        for _ in 0..20 {
            time += 1000;
            black_box(estimator.estimate(&free, time)).ok();
        }
        let free =
            counter.count(|| felt = black_box(&estimator.estimate(&free, time + 1000)).map(|_| ()));
        print("    while nothing touches", free);
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
        // Five electrodes rise on average under a newton of the simulated film, eight at most; all
        // eight belong to the bell.
        let mut pressed = [3000; 19];
        for (electrode, word) in [(16, 2000), (1, 2800), (11, 2800), (9, 2900), (17, 2950)] {
            pressed[electrode] = word;
        }
        let readings = (ElectrodeReading([3000; 19]), ElectrodeReading(pressed));
        press(counter, "  electrodes, five rise", electrodes, readings);
        let mut pressed = [3000; 19];
        for (pair, word) in [([16, 17], 2700), ([2, 12], 2912), ([1, 11], 2962), ([4, 14], 2982)] {
            for electrode in pair {
                pressed[electrode] = word;
            }
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
        print("  one reading, begun and fetched", spent);
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        static mut SENSORS: (WrenchEstimator, ElectrodeEstimator) =
            (WrenchEstimator::new(), ElectrodeEstimator::new());
        static mut FINGERTIP: Fingers<Spatial, 1> = Fingers::new();
        let board = Selected::start();
        let counter = Counter::new();
        drivers(&counter);
        estimators(&counter, &mut SENSORS.0, &mut SENSORS.1);
        hand(&counter, board, FINGERTIP);
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }
}
