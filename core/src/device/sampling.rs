//! Sensors on a board: real ones that are watched, and scripted ones.

use embedded_hal::delay::DelayNs;

use super::{Board, Vitals};
use crate::driver::ads131m08::{self, Ads131m08};
use crate::driver::biotac::{self, BioTac};
use crate::driver::emulated::{Ads131m08Chip, BioTacChip};
use crate::driver::{DriverError, Sampler};
use crate::sensing::{ElectrodeReading, GaugeReading};
use crate::wire::{BoardKind, Words, WordsFrame};

/// What one of a fingertip's sensors said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// A force/torque transducer.
    Gauges(GaugeReading),
    /// An array of electrodes.
    Electrodes(ElectrodeReading),
}

impl From<[i32; ads131m08::CHANNELS]> for Reading {
    /// The gauges are on the first six channels.
    fn from([a, b, c, d, e, f, ..]: [i32; ads131m08::CHANNELS]) -> Self {
        Reading::Gauges(GaugeReading([a, b, c, d, e, f]))
    }
}

impl From<biotac::Frame> for Reading {
    fn from(frame: biotac::Frame) -> Self {
        Reading::Electrodes(ElectrodeReading(frame.electrodes))
    }
}

/// A reading and when it was taken: microseconds, wrapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When.
    pub time: u32,
    /// What.
    pub reading: Reading,
}

/// Microseconds without a reading after which a sensor counts as stuck; a BioTac's frame takes
/// 10 ms.
const PATIENCE_US: u32 = 50_000;
/// Microseconds between attempts to start a sensor.
const RETRY_US: u32 = 100_000;

/// A sensor that is started, and started again after it has failed, without ever being waited for.
#[derive(Clone, Debug)]
pub struct Watched<P> {
    sensor: P,
    stage: Stage,
    /// When it was last tried, started or heard of.
    since: u32,
    /// When it was last polled.
    polled: u32,
    /// When the reading that is on its way was sampled.
    begun: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    New,
    Failed,
    Running,
}

impl<P> Watched<P> {
    /// A sensor that was not started yet.
    pub const fn new(sensor: P) -> Self {
        Watched { sensor, stage: Stage::New, since: 0, polled: 0, begun: None }
    }
}

impl<P: Sampler> Watched<P> {
    /// The next reading, if there is one, and when it was sampled; `now` in microseconds.
    ///
    /// # Errors
    /// Whatever the driver says, once: until a sensor that failed is tried again there is nothing.
    /// [`DriverError::Timeout`] for one that runs and gives no reading for 50 ms in which it was
    /// polled.
    pub fn poll(&mut self, now: u32) -> Result<Option<(u32, P::Reading)>, DriverError> {
        // Who was not asked, as while a tracker computes, is not late.
        if now.wrapping_sub(self.polled) >= PATIENCE_US && self.stage == Stage::Running {
            self.since = now;
        }
        self.polled = now;
        let rests = self.stage == Stage::Failed && now.wrapping_sub(self.since) < RETRY_US;
        // A frame that nobody fetches would keep the bus from the other sensors.
        if rests && !self.sensor.is_under_way() {
            return Ok(None);
        }
        if !rests && self.stage != Stage::Running {
            (self.stage, self.since) = (Stage::Failed, now);
            self.begun = None;
            self.sensor.start()?;
            self.stage = Stage::Running;
        }
        // Called in one place, so that it is compiled into it.
        let polled = self.sensor.poll();
        if rests {
            return Ok(None);
        }
        let outcome =
            match polled {
                Ok(Some(reading)) => Ok(Some(reading)),
                // Noise without end is no answer either.
                Ok(None)
                | Err(
                    DriverError::Crc { .. } | DriverError::Parity { .. } | DriverError::Command,
                ) if now.wrapping_sub(self.since) >= PATIENCE_US => Err(DriverError::Timeout),
                other => other,
            };
        let time = self.begun.unwrap_or(now);
        self.begun = self.sensor.is_under_way().then_some(time);
        match &outcome {
            Ok(Some(_)) => self.since = now,
            Ok(None) => {}
            // Noise on the line passes.
            Err(DriverError::Crc { .. } | DriverError::Parity { .. } | DriverError::Command) => {}
            Err(_) => (self.stage, self.since) = (Stage::Failed, now),
        }
        Ok(outcome?.map(|reading| (time, reading)))
    }
}

/// A board with a sensor on each of its fingers.
pub struct Sensing<B, P, const FINGERS: usize> {
    board: B,
    sensors: [Watched<P>; FINGERS],
}

impl<B: Board, P, const FINGERS: usize> Sensing<B, P, FINGERS> {
    /// Gives `board` its sensors, one for each finger.
    pub fn new(board: B, sensors: [P; FINGERS]) -> Self {
        Sensing { board, sensors: sensors.map(Watched::new) }
    }
}

impl<B: Board, P: Sampler<Reading: Into<Reading>>, const FINGERS: usize> Board
    for Sensing<B, P, FINGERS>
{
    const KIND: BoardKind = B::KIND;

    fn now(&mut self) -> u32 {
        self.board.now()
    }

    fn receive(&mut self, bytes: &mut [u8], wait: bool) -> usize {
        self.board.receive(bytes, wait)
    }

    fn send(&mut self, bytes: &[u8]) {
        self.board.send(bytes);
    }

    fn vitals(&mut self) -> Vitals {
        self.board.vitals()
    }

    fn is_sampling(&mut self) -> bool {
        true
    }

    fn sample(&mut self, finger: u8) -> Result<Option<Sample>, DriverError> {
        let now = self.board.now();
        let Some(sensor) = self.sensors.get_mut(usize::from(finger)) else { return Ok(None) };
        Ok(sensor.poll(now)?.map(|(time, reading)| Sample { time, reading: reading.into() }))
    }
}

/// A board whose fingers have emulated sensors that show what a host scripts: the drivers' words,
/// checks and errors are those of real ones.
pub struct Scripted<B, const FINGERS: usize> {
    board: B,
    fingers: [ScriptedFinger; FINGERS],
}

/// Microseconds between samples.
const PERIOD_US: u32 = 1000;

struct ScriptedFinger {
    gauges: Ads131m08<Ads131m08Chip, NoDelay>,
    electrodes: BioTac<BioTacChip, NoDelay>,
    /// Which of the two is there.
    kind: Kind,
    /// Samples left to show.
    left: u32,
    /// When the next is, by the script's clock.
    time: u32,
    /// When the last was shown, by the board's clock.
    shown: u32,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    None,
    Gauges,
    Electrodes,
}

/// An emulated chip needs no time.
#[derive(Clone, Copy, Debug)]
struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

impl ScriptedFinger {
    fn new() -> Self {
        let gauges = Ads131m08Chip::showing([0; ads131m08::CHANNELS]);
        let settings = ads131m08::Settings::GAUGES;
        ScriptedFinger {
            gauges: Ads131m08::polled(gauges, NoDelay, settings),
            electrodes: BioTac::new(BioTacChip::showing(biotac::Frame::ZERO), NoDelay),
            kind: Kind::None,
            left: 0,
            time: 0,
            shown: 0,
        }
    }

    fn show(&mut self, frame: &WordsFrame, now: u32) {
        let kind = match frame.words {
            Words::Gauges([a, b, c, d, e, f]) => {
                let chip = self.gauges.spi();
                chip.set_fault(frame.fault);
                chip.show([a, b, c, d, e, f, 0, 0]);
                Kind::Gauges
            }
            Words::Electrodes { electrodes, pressure, vibration, temperature, heat_flow } => {
                let chip = self.electrodes.spi();
                chip.set_fault(frame.fault);
                chip.show(&biotac::Frame {
                    electrodes,
                    pac: [vibration; biotac::PRESSURES],
                    pdc: pressure,
                    tac: heat_flow,
                    tdc: temperature,
                });
                Kind::Electrodes
            }
        };
        self.kind = kind;
        self.left = u32::from(frame.repeats) + 1;
        self.time = frame.time.0;
        // The first is due at once.
        self.shown = now.wrapping_sub(PERIOD_US);
    }

    fn sample(&mut self, now: u32) -> Result<Option<Sample>, DriverError> {
        if self.left == 0 || now.wrapping_sub(self.shown) < PERIOD_US {
            return Ok(None);
        }
        self.left -= 1;
        self.shown = now;
        let time = self.time;
        self.time = time.wrapping_add(PERIOD_US);
        let reading = match self.kind {
            Kind::None => return Ok(None),
            Kind::Gauges => sampled(&mut self.gauges)?.into(),
            Kind::Electrodes => sampled(&mut self.electrodes)?.into(),
        };
        Ok(Some(Sample { time, reading }))
    }
}

/// A reading, after setting the sensor up where that is what it lacks.
fn sampled<P: Sampler>(sensor: &mut P) -> Result<P::Reading, DriverError> {
    match sensor.sample() {
        Err(DriverError::Restarted) => {
            sensor.start()?;
            sensor.sample()
        }
        other => other,
    }
}

impl<B: Board, const FINGERS: usize> Scripted<B, FINGERS> {
    /// Gives `board` sensors that show nothing yet.
    pub fn new(board: B) -> Self {
        Scripted { board, fingers: core::array::from_fn(|_| ScriptedFinger::new()) }
    }

    /// The board without its sensors.
    pub fn board(&mut self) -> &mut B {
        &mut self.board
    }
}

impl<B: Board, const FINGERS: usize> Board for Scripted<B, FINGERS> {
    const KIND: BoardKind = B::KIND;

    fn now(&mut self) -> u32 {
        self.board.now()
    }

    fn receive(&mut self, bytes: &mut [u8], wait: bool) -> usize {
        self.board.receive(bytes, wait)
    }

    fn send(&mut self, bytes: &[u8]) {
        self.board.send(bytes);
    }

    fn vitals(&mut self) -> Vitals {
        self.board.vitals()
    }

    fn is_sampling(&mut self) -> bool {
        self.fingers.iter().any(|finger| finger.left > 0)
    }

    fn sample(&mut self, finger: u8) -> Result<Option<Sample>, DriverError> {
        let now = self.board.now();
        match self.fingers.get_mut(usize::from(finger)) {
            Some(finger) => finger.sample(now),
            None => Ok(None),
        }
    }

    fn show(&mut self, words: &WordsFrame) -> bool {
        let now = self.board.now();
        let finger = self.fingers.get_mut(usize::from(words.finger));
        finger.map(|finger| finger.show(words, now)).is_some()
    }
}

#[cfg(test)]
mod tests;
