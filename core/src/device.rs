//! The board's behaviour: commands in, a tracker in the middle, reports out. The same code runs on
//! a microcontroller, in QEMU and inside a host process, so all three answer the same.

mod draft;
mod fingers;
mod sampling;
mod trackers;

use core::marker::PhantomData;

use heapless::Vec;

use crate::contact::Grasp;
use crate::driver::DriverError;
use crate::explore::{Candidate, Candidates, Choice, Criterion, ListError};
use crate::track::{Modes, MotionNoise, Tracker};
use crate::wire::{
    Arrival, BoardKind, ChoiceFrame, Clock, Command, ContactFrame, Decoder, EstimateFrame,
    FaceFrame, FaceSummary, Frame, FrameError, Health, Hello, MAX_FRAME, ModeFrame, PROTOCOL,
    Received, Refusal, Reply, Report, Settings, Topic, TrackerKind, WireSpace, WordsFrame, encode,
};

pub use fingers::Fingers;
pub use sampling::{Reading, Sample, Scripted, Sensing, Watched};
pub use trackers::{
    CANDIDATES, CONTACTS, FINGERS, PlanarAutomatic, PlanarAutomaticDevice, PlanarCurved,
    PlanarCurvedDevice, PlanarCurvedMap, PlanarDevice, PlanarHypotheses, PlanarHypothesesDevice,
    PlanarMap, PlanarRaoBlackwell, PlanarRaoBlackwellDevice, PlanarTracker, SpatialAutomatic,
    SpatialAutomaticDevice, SpatialCurved, SpatialCurvedDevice, SpatialCurvedMap, SpatialDevice,
    SpatialHypotheses, SpatialHypothesesDevice, SpatialMap, SpatialRaoBlackwell,
    SpatialRaoBlackwellDevice, SpatialSensingDevice, SpatialTracker,
};

/// What a device needs of the hardware.
pub trait Board {
    /// What it is.
    const KIND: BoardKind;

    /// Microseconds since some moment, wrapping.
    fn now(&mut self) -> u32;

    /// Moves what has come into `bytes` and returns how many. Where `wait` is set it waits until at
    /// least one byte has come; a board inside a host process returns 0 instead of waiting.
    fn receive(&mut self, bytes: &mut [u8], wait: bool) -> usize;

    /// Sends all bytes.
    fn send(&mut self, bytes: &[u8]);

    /// What only the hardware knows.
    fn vitals(&mut self) -> Vitals;

    /// Whether sensors have to be looked at even when no byte comes.
    fn is_sampling(&mut self) -> bool {
        false
    }

    /// What the sensor of a finger has to say, without waiting for it; `None` when that is nothing.
    ///
    /// # Errors
    /// When the sensor cannot be read.
    fn sample(&mut self, _finger: u8) -> Result<Option<Sample>, DriverError> {
        Ok(None)
    }

    /// Has a scripted sensor show words; false where the finger has none.
    fn show(&mut self, _words: &WordsFrame) -> bool {
        false
    }
}

/// What only the hardware knows; zero where it is not measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Vitals {
    /// Bytes the UART lost since the start.
    pub overruns: u32,
    /// Deepest stack since the start, bytes.
    pub peak_stack: u32,
    /// Stack there is, bytes.
    pub stack: u32,
}

/// A tracker that can live on a board.
pub trait Onboard<S: WireSpace>: Tracker<S> {
    /// Contacts the map can hold; faces, where the tracker keeps only those.
    const MAP: usize;
    /// Particles, hypotheses or trajectories.
    const PARTICLES: usize;
    /// How it follows the object.
    const KIND: TrackerKind;

    /// Sets the model of the surface; called before the first use.
    fn prepare(&mut self);

    /// Face `number` of the shape and how many there are; `None` beyond them, or where the shape has
    /// no faces.
    fn face(&self, _number: u8) -> Option<(FaceSummary<S>, u8)> {
        None
    }

    /// Replaces the belief by another's, without faces.
    ///
    /// # Errors
    /// [`Refusal::Fixed`] where the tracker cannot, [`Refusal::Belief`] with unusable numbers; the
    /// belief is then as before.
    fn believe(&mut self, _pose: &S::Pose, _covariance: &S::Covariance) -> Result<(), Refusal> {
        Err(Refusal::Fixed)
    }

    /// Adds a face to a belief that was replaced.
    ///
    /// # Errors
    /// As [`believe`](Self::believe), and [`Refusal::MapFull`].
    fn learn(&mut self, _face: &FaceSummary<S>) -> Result<(), Refusal> {
        Err(Refusal::Fixed)
    }

    /// Which of some grasps, at least one, is worth most when the object is moved by `motion` before
    /// it (see [`crate::explore`]); `noise` is the deviation of a contact's point, metres.
    ///
    /// # Errors
    /// [`Refusal::NoForesight`] where the tracker cannot tell, [`Refusal::NoShape`] before it has felt
    /// anything, [`Refusal::NoCandidate`].
    fn choose(
        &mut self,
        _motion: Option<&S::Pose>,
        _candidates: &[Candidate<S>],
        _criterion: Criterion,
        _noise: f32,
    ) -> Result<Choice, Refusal> {
        Err(Refusal::NoForesight)
    }
}

/// A tracker behind a link. `CONTACTS` contacts, and as many free points, fit in one grasp.
///
/// Decisions about what a host may send, all of them counted in [`Health`]:
/// * a frame that cannot be read is dropped without an answer: the host sends it again;
/// * a frame that is sent again is answered again, and not obeyed again;
/// * a frame older than the one last obeyed is dropped;
/// * before the first `Hello` everything else is refused;
/// * a second motion, a contact beyond `CONTACTS` and impossible settings are refused;
/// * a commit without contacts is an empty grasp: the tracker only predicts;
/// * a belief and faces that a host knows better are taken by trackers that can, and refused otherwise;
/// * candidates are a list for the next grasp, of at most [`CANDIDATES`]: whatever changes the belief
///   forgets it, and one that cannot be used is refused and leaves it as it was.
///
/// A device with `FINGERS` sensors also estimates contacts from what its [`Board`] samples. Those
/// felt when a grasp is committed are part of it, of each finger of which the host has sent none.
pub struct Device<T, S: WireSpace, const CONTACTS: usize, const FINGERS: usize = 0> {
    tracker: T,
    decoder: Decoder<Command<S>>,
    grasp: Grasp<S, CONTACTS>,
    motion: Option<S::Pose>,
    /// `None` stands for the defaults, so that a new device is all zero bits.
    settings: Option<Settings>,
    health: Health,
    estimate: Option<EstimateFrame<S>>,
    modes: Modes<S>,
    candidates: Candidates<S, CANDIDATES>,
    fingers: Fingers<S, FINGERS>,
    answer: Answer<S>,
    /// Whether a host has said `Hello`.
    greeted: bool,
    /// Whether the tracker has its model and settings.
    ready: bool,
}

/// The frames that answer the last command, kept to be sent again.
struct Answer<S> {
    bytes: Vec<u8, { 4 * MAX_FRAME }>,
    /// Sequence number of the command.
    to: u8,
    /// Sequence number of the next frame.
    next: u8,
    space: PhantomData<S>,
}

impl<S: WireSpace> Answer<S> {
    fn add(&mut self, now: u32, message: Report<S>) {
        let mut buffer = [0; MAX_FRAME];
        let frame = Frame { sequence: self.next, time: Clock(now), message };
        // Health, estimate, reply and a contact of every finger fit, and no answer has more.
        if let Ok(bytes) = encode(&frame, &mut buffer) {
            let _ = self.bytes.extend_from_slice(bytes);
        }
        self.next = self.next.wrapping_add(1);
    }
}

impl<T: Onboard<S>, S: WireSpace, const CONTACTS: usize, const FINGERS: usize>
    Device<T, S, CONTACTS, FINGERS>
{
    /// A commit's answer holds a contact of every finger.
    const FITS: () = assert!(FINGERS <= 5, "an answer has room for the contacts of five fingers");

    /// A device that has heard nothing yet. All zero bits when the tracker is, so that a static one
    /// takes no flash.
    pub const fn new(tracker: T) -> Self {
        let () = Self::FITS;
        Device {
            tracker,
            decoder: Decoder::new(),
            grasp: Grasp::new(),
            motion: None,
            settings: None,
            health: Health::NONE,
            estimate: None,
            modes: Modes::NONE,
            candidates: Candidates::new(),
            fingers: Fingers::new(),
            answer: Answer { bytes: Vec::new(), to: 0, next: 0, space: PhantomData },
            greeted: false,
            ready: false,
        }
    }

    /// Introduces the board, then obeys what `board` receives and samples its sensors. Returns when
    /// it waits and receives nothing, which hardware never does.
    pub fn run(&mut self, board: &mut impl Board) {
        self.announce(board);
        let mut bytes = [0; 32];
        loop {
            let wait = !board.is_sampling();
            let count = board.receive(&mut bytes, wait);
            if wait && count == 0 {
                return;
            }
            self.take(bytes.get(..count).unwrap_or(&[]), board);
            self.sense(board);
        }
    }

    /// Samples every sensor once and streams what is felt, where that is asked for.
    pub fn sense<B: Board>(&mut self, board: &mut B) {
        for finger in 0..self.fingers.count() {
            let Some((time, contact)) = self.feel(finger, board) else { continue };
            if self.greeted && self.fingers.is_due(finger, time) {
                let frame = Frame {
                    sequence: self.answer.next,
                    time: Clock(time),
                    message: Report::Contact(contact),
                };
                self.answer.next = self.answer.next.wrapping_add(1);
                let mut buffer = [0; MAX_FRAME];
                if let Ok(bytes) = encode(&frame, &mut buffer) {
                    board.send(bytes);
                }
            }
        }
    }

    /// Samples a finger's sensor: when, and what it feels.
    fn feel<B: Board>(&mut self, finger: u8, board: &mut B) -> Option<(u32, ContactFrame<S>)> {
        let outcome = board.sample(finger);
        let time = outcome.map_or(None, |sample| sample).map_or(0, |sample| sample.time);
        let contact = self.fingers.feel(finger, outcome)?;
        let usual = self.settings.unwrap_or(Settings::DEFAULT).normal;
        Some((time, ContactFrame::new(&contact, usual)))
    }

    /// Sends [`Report::Hello`] unasked, for whoever watches the line.
    pub fn announce<B: Board>(&mut self, board: &mut B) {
        self.answer.bytes.clear();
        self.answer.add(board.now(), Report::Hello(self.hello::<B>()));
        board.send(&self.answer.bytes);
    }

    /// Takes bytes in pieces of any size and answers the commands they complete.
    pub fn take<B: Board>(&mut self, bytes: &[u8], board: &mut B) {
        for &byte in bytes {
            match self.decoder.push(byte) {
                Some(Ok(received)) => self.hear(received, board),
                Some(Err(FrameError::Version { sequence, .. })) => {
                    self.answer.bytes.clear();
                    self.answer.add(board.now(), Report::Hello(self.hello::<B>()));
                    self.reply(sequence, Err(Refusal::Version), board);
                }
                Some(Err(_)) | None => {}
            }
        }
    }

    fn hear<B: Board>(&mut self, received: Received<Command<S>>, board: &mut B) {
        let Frame { sequence, message, .. } = received.frame;
        let hello = matches!(message, Command::Hello { .. });
        match received.arrival {
            Arrival::New => {}
            Arrival::Doubled if hello => {}
            Arrival::Doubled if sequence == self.answer.to => {
                board.send(&self.answer.bytes);
                return;
            }
            Arrival::Doubled | Arrival::Late => return,
        }
        self.answer.bytes.clear();
        let outcome = self.obey(message, board);
        self.reply(sequence, outcome, board);
    }

    fn reply(&mut self, to: u8, outcome: Result<(), Refusal>, board: &mut impl Board) {
        if outcome.is_err() {
            self.health.refused = self.health.refused.saturating_add(1);
        }
        self.answer.to = to;
        self.answer.add(board.now(), Report::Reply(Reply { to, refusal: outcome.err() }));
        board.send(&self.answer.bytes);
    }

    fn obey<B: Board>(&mut self, command: Command<S>, board: &mut B) -> Result<(), Refusal> {
        if !self.greeted && !matches!(command, Command::Hello { .. }) {
            return Err(Refusal::NotGreeted);
        }
        match command {
            Command::Hello { .. } => {
                self.greeted = true;
                // Who greets has asked for no contacts yet, whoever did before.
                self.fingers.set_stream(0)?;
                self.answer.add(board.now(), Report::Hello(self.hello::<B>()));
            }
            Command::Ping => {}
            Command::Configure(settings) => {
                if !settings.is_valid() {
                    return Err(Refusal::Settings);
                }
                self.settings = Some(settings);
                self.reset();
            }
            Command::Reset => self.reset(),
            Command::Motion(frame) => {
                if self.motion.is_some() {
                    return Err(Refusal::MotionTwice);
                }
                self.motion = Some(frame.motion().ok_or(Refusal::Motion)?);
            }
            Command::Contact(frame) => {
                let contact = frame.contact(&self.settings.unwrap_or(Settings::DEFAULT));
                self.grasp.contacts.push(contact).map_err(|_| self.overfull())?;
            }
            Command::Free(frame) => {
                self.grasp.free.push(frame.free_point()).map_err(|_| self.overfull())?;
            }
            Command::Commit => self.commit(board),
            Command::Query(Topic::Estimate) => {
                let estimate = self.estimate.ok_or(Refusal::NoEstimate)?;
                self.answer.add(board.now(), Report::Estimate(estimate));
            }
            Command::Query(Topic::Health) => self.report_health(board),
            Command::Query(Topic::Mode(number)) => {
                let mode = ModeFrame::new(&self.modes, number).ok_or(Refusal::NoSuch)?;
                self.answer.add(board.now(), Report::Mode(mode));
            }
            Command::Query(Topic::Face(number)) => {
                let (face, of) = self.tracker.face(number).ok_or(Refusal::NoSuch)?;
                self.answer.add(board.now(), Report::Face(FaceFrame::new(&face, number, of)));
            }
            Command::Believe(frame) => {
                let (pose, covariance) = frame.belief().ok_or(Refusal::Belief)?;
                if !self.ready {
                    self.start();
                }
                self.tracker.believe(&pose, &covariance)?;
                self.candidates.clear();
                self.modes = Modes::one(pose);
                // It is of another object frame.
                self.estimate = None;
            }
            Command::Face(frame) => {
                self.tracker.learn(&frame.face())?;
                self.candidates.clear();
            }
            Command::Query(Topic::Finger(number)) => {
                let finger = self.fingers.report(number).ok_or(Refusal::NoSuch)?;
                self.answer.add(board.now(), Report::Finger(finger));
            }
            Command::Query(Topic::BestCandidate(criterion)) => {
                let candidates = self.candidates.as_slice();
                if candidates.is_empty() {
                    return Err(Refusal::NoCandidate);
                }
                let noise = self.settings.unwrap_or(Settings::DEFAULT).point;
                let motion = self.motion.as_ref();
                let choice = self.tracker.choose(motion, candidates, criterion, noise)?;
                let frame = ChoiceFrame::new(&choice, criterion);
                self.answer.add(board.now(), Report::Choice(frame));
            }
            Command::Consider(frame) => {
                let candidate = frame.candidate().map_err(|_| Refusal::Candidate)?;
                self.candidates.put(frame.number.into(), candidate).map_err(
                    |error| match error {
                        ListError::Gap => Refusal::NoSuch,
                        ListError::Full => Refusal::TooMany,
                    },
                )?;
            }
            Command::FingertipPose(frame) => self.fingers.place(&frame)?,
            Command::Sensor(frame) => self.fingers.tell(&frame)?,
            Command::Tare { finger } => self.fingers.tare(finger)?,
            Command::Stream { period } => self.fingers.set_stream(period)?,
            Command::Words(frame) => {
                if frame.finger >= self.fingers.count() {
                    return Err(Refusal::NoSuch);
                }
                if !board.show(&frame) {
                    return Err(Refusal::NotScripted);
                }
                if let Some((time, contact)) = self.feel(frame.finger, board) {
                    self.answer.add(time, Report::Contact(contact));
                }
            }
        }
        Ok(())
    }

    fn commit(&mut self, board: &mut impl Board) {
        if !self.ready {
            self.start();
        }
        self.add_felt(board);
        if self.grasp.contacts.is_empty() {
            self.health.empty = self.health.empty.saturating_add(1);
        }
        let start = board.now();
        let estimate = self.tracker.update(self.motion.as_ref(), self.grasp.view());
        let spent = board.now().wrapping_sub(start);
        self.health.grasps = self.health.grasps.saturating_add(1);
        self.health.update = spent;
        self.health.worst_update = self.health.worst_update.max(spent);
        self.grasp.clear();
        self.candidates.clear();
        self.motion = None;
        let frame = EstimateFrame::new(&estimate);
        self.estimate = Some(frame);
        self.modes = estimate.modes;
        self.answer.add(board.now(), Report::Estimate(frame));
        self.report_health(board);
    }

    /// Adds what the board's own sensors feel to the grasp.
    fn add_felt(&mut self, board: &mut impl Board) {
        let usual = self.settings.unwrap_or(Settings::DEFAULT).normal;
        for finger in 0..self.fingers.count() {
            let Some(contact) = self.fingers.take(finger) else { continue };
            if self.grasp.contacts.iter().any(|sent| sent.finger == finger) {
                continue;
            }
            match self.grasp.contacts.push(contact) {
                Ok(()) => {
                    let frame = ContactFrame::new(&contact, usual);
                    self.answer.add(board.now(), Report::Felt(frame));
                }
                Err(_) => drop(self.overfull()),
            }
        }
    }

    fn report_health(&mut self, board: &mut impl Board) {
        let vitals = board.vitals();
        self.health.overruns = vitals.overruns;
        self.health.peak_stack = vitals.peak_stack;
        self.health.stack = vitals.stack;
        self.health.received = *self.decoder.counters();
        self.answer.add(board.now(), Report::Health(self.health));
    }

    fn reset(&mut self) {
        self.grasp.clear();
        self.candidates.clear();
        self.motion = None;
        self.estimate = None;
        self.modes = Modes::NONE;
        self.fingers.forget();
        self.start();
    }

    fn start(&mut self) {
        let settings = self.settings.unwrap_or(Settings::DEFAULT);
        if !self.ready {
            self.tracker.prepare();
            self.ready = true;
        }
        self.tracker.set_motion_noise(MotionNoise {
            translation: settings.translation,
            rotation: settings.rotation,
        });
        self.tracker.reset(settings.seed);
    }

    fn overfull(&mut self) -> Refusal {
        self.health.overfull = self.health.overfull.saturating_add(1);
        Refusal::Full
    }

    fn hello<B: Board>(&self) -> Hello {
        Hello {
            protocol: PROTOCOL,
            firmware: FIRMWARE,
            board: B::KIND,
            tracker: T::KIND,
            dimension: S::DIMENSION as u8,
            contacts: CONTACTS.min(u16::MAX as usize) as u16,
            map: T::MAP.min(u16::MAX as usize) as u16,
            particles: T::PARTICLES.min(u16::MAX as usize) as u16,
            fingers: self.fingers.count(),
        }
    }
}

/// Version of the package: major, minor, patch.
const FIRMWARE: [u8; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];

const fn number(digits: &str) -> u8 {
    let (bytes, mut value, mut i) = (digits.as_bytes(), 0, 0);
    while i < bytes.len() {
        value = value * 10 + (bytes[i] - b'0');
        i += 1;
    }
    value
}

#[cfg(test)]
mod tests;
