//! The host's side of the conversation: one command, one reply, and again when nothing comes.
//!
//! Why one at a time: an STM32's UART holds a single received byte, and the board computes for
//! milliseconds. Because the host only speaks after the board's reply, and the board replies when it
//! is ready to listen, no byte can be lost to a busy board at any speed of the line. At 115 200 baud
//! a five-finger grasp and its answer spend 32 ms (planar) or 41 ms (spatial) on the line, at
//! 921 600 baud an eighth of that.

use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

use tactile_core::contact::{Contact, FreePoint};
use tactile_core::explore::{Candidate, CandidateError, Criterion};
use tactile_core::track::Status;
use tactile_core::wire::{
    Arrival, CandidateFrame, ChoiceFrame, Clock, Command, ContactFrame, Counters, Decoder,
    EstimateFrame, FaceFrame, FingerFrame, FingertipFrame, Frame, FrameError, FreeFrame, Health,
    Hello, MAX_FRAME, ModeFrame, MotionFrame, PROTOCOL, Refusal, Report, SensorFrame, SensorPart,
    Settings, Topic, WireSpace, WordsFrame, encode,
};

use super::Link;
use super::lesson::Lesson;

mod log;
mod outcome;
mod patience;
mod sensed;
#[cfg(test)]
mod tests;

pub use log::settings_for;
pub use outcome::{FeltContact, GraspOutcome, LogOutcome, steps};
pub use patience::Patience;
pub use sensed::SensedError;

/// Bytes of a board's longest answer.
const ANSWER: usize = 4 * MAX_FRAME;

/// Contacts kept for [`Session::contacts`] at most, the latest: five minutes of five fingers at 200 Hz.
const KEPT: usize = 300_000;

/// Why a conversation ended.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The bytes do not move.
    #[error("the link failed: {0}")]
    Link(#[from] io::Error),
    /// Nobody answers.
    #[error("the board did not answer `{command}`, sent {attempts} times ({counters})")]
    Silent {
        /// What was asked.
        command: &'static str,
        /// How often.
        attempts: u32,
        /// What did come, in words.
        counters: String,
    },
    /// Two versions.
    #[error("the board speaks protocol version {board}, this program version {host}")]
    Version {
        /// The board's.
        board: u8,
        /// Ours.
        host: u8,
    },
    /// A planar log for a spatial board or the other way round.
    #[error("the board tracks in {board} dimensions, the log has {log}")]
    Dimension {
        /// The board's.
        board: u8,
        /// The log's.
        log: usize,
    },
    /// A command was not obeyed.
    #[error("the board refused `{command}`: {refusal}")]
    Refused {
        /// What was asked.
        command: &'static str,
        /// Why not.
        refusal: Refusal,
    },
    /// The board does not know us any more.
    #[error("the board restarted during `{command}`: its belief is gone")]
    Restarted {
        /// What was asked.
        command: &'static str,
    },
    /// Another estimate than the one that was due.
    #[error("grasp {due} was committed, the board answered with grasp {got}")]
    WrongGrasp {
        /// Number of grasps committed before.
        due: u32,
        /// Number in the estimate.
        got: u32,
    },
    /// A grasp that is none.
    #[error("candidate {number}: {error}")]
    Candidate {
        /// Its place in the list, from 0.
        number: usize,
        /// What is wrong.
        error: CandidateError,
    },
    /// The estimate's pose is not a number.
    #[error("the estimate of grasp {grasp} is not finite")]
    NotFinite {
        /// Which.
        grasp: u32,
    },
}

/// A conversation with one board.
pub struct Session<S: WireSpace, L> {
    link: L,
    decoder: Decoder<Report<S>>,
    patience: Patience,
    start: Instant,
    next: u8,
    hello: Option<Hello>,
    settings: Settings,
    committed: u32,
    repeated: u32,
    contacts: VecDeque<FeltContact<S>>,
    /// Contacts heard in all.
    heard: u64,
    /// What a commit took at most.
    longest: Duration,
}

/// What came with a reply.
struct Answer<S: WireSpace> {
    hello: Option<Hello>,
    estimate: Option<EstimateFrame<S>>,
    health: Option<Health>,
    mode: Option<ModeFrame<S>>,
    face: Option<FaceFrame<S>>,
    finger: Option<FingerFrame>,
    choice: Option<ChoiceFrame>,
    felt: Vec<ContactFrame<S>>,
}

impl<S: WireSpace> Default for Answer<S> {
    fn default() -> Self {
        Answer {
            hello: None,
            estimate: None,
            health: None,
            mode: None,
            face: None,
            finger: None,
            choice: None,
            felt: Vec::new(),
        }
    }
}

impl<S: WireSpace, L: Link> Session<S, L> {
    /// Greets the board.
    ///
    /// # Errors
    /// When nobody answers, or somebody of another version or dimension.
    pub fn open(link: L, patience: Patience) -> Result<Self, SessionError> {
        let mut session = Session {
            link,
            decoder: Decoder::new(),
            patience,
            start: Instant::now(),
            next: 0,
            hello: None,
            settings: Settings::DEFAULT,
            committed: 0,
            repeated: 0,
            contacts: VecDeque::new(),
            heard: 0,
            longest: Duration::ZERO,
        };
        let answer = session.ask("hello", Command::Hello { protocol: PROTOCOL })?;
        if let Some(hello) = answer.hello
            && usize::from(hello.dimension) != S::DIMENSION
        {
            return Err(SessionError::Dimension { board: hello.dimension, log: S::DIMENSION });
        }
        session.hello = answer.hello;
        Ok(session)
    }

    /// Who answered.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// What has been seen of the board's frames.
    pub fn received(&self) -> &Counters {
        self.decoder.counters()
    }

    /// How often a command was sent again.
    pub fn repeated(&self) -> u32 {
        self.repeated
    }

    /// Sets noise and seed; the board forgets the object.
    ///
    /// # Errors
    /// As every command: no answer, or a refusal.
    pub fn configure(&mut self, settings: Settings) -> Result<(), SessionError> {
        self.ask("configure", Command::Configure(settings))?;
        self.settings = settings;
        self.committed = 0;
        Ok(())
    }

    /// Makes the board forget the object, and what it was told of a grasp that was not finished.
    ///
    /// # Errors
    /// No answer.
    pub fn reset(&mut self) -> Result<(), SessionError> {
        self.ask("reset", Command::Reset)?;
        self.committed = 0;
        Ok(())
    }

    /// Asks for an answer and nothing else.
    ///
    /// # Errors
    /// No answer.
    pub fn ping(&mut self) -> Result<(), SessionError> {
        self.ask("ping", Command::Ping).map(|_| ())
    }

    /// How the board fares.
    ///
    /// # Errors
    /// No answer.
    pub fn health(&mut self) -> Result<Health, SessionError> {
        self.wanted("health", Command::Query(Topic::Health), |answer| answer.health)
    }

    /// The poses that the board held possible after the last grasp, heaviest first.
    ///
    /// # Errors
    /// No answer, or no grasp committed yet.
    pub fn modes(&mut self) -> Result<Vec<ModeFrame<S>>, SessionError> {
        let mut modes = Vec::new();
        loop {
            let number = modes.len() as u8;
            let topic = Command::Query(Topic::Mode(number));
            let mode =
                self.wanted("mode", topic, |a| a.mode.take().filter(|m| m.number == number))?;
            modes.push(mode);
            if modes.len() >= usize::from(mode.of) {
                return Ok(modes);
            }
        }
    }

    /// The faces of the object as the board has them now, in the object frame; none where its
    /// tracker has no faces.
    ///
    /// # Errors
    /// No answer.
    pub fn faces(&mut self) -> Result<Vec<FaceFrame<S>>, SessionError> {
        let mut faces = Vec::new();
        loop {
            let number = faces.len() as u8;
            let topic = Command::Query(Topic::Face(number));
            let found =
                self.wanted("face", topic, |a| a.face.take().filter(|f| f.number == number));
            let face = match found {
                Err(SessionError::Refused { refusal: Refusal::NoSuch, .. }) => return Ok(faces),
                other => other?,
            };
            faces.push(face);
            if faces.len() >= usize::from(face.of) {
                return Ok(faces);
            }
        }
    }

    /// Tells the board where a fingertip is, in the world.
    ///
    /// # Errors
    /// No answer, no such finger, a pose that is not finite.
    pub fn place_fingertip(&mut self, finger: u8, pose: &S::Pose) -> Result<(), SessionError> {
        let frame = FingertipFrame::new(finger, pose);
        self.ask("fingertip pose", Command::FingertipPose(frame)).map(|_| ())
    }

    /// Tells a finger's sensor its settings, part by part, and puts them to use.
    ///
    /// # Errors
    /// No answer, or a refusal: [`Refusal::Singular`] for a calibration matrix without inverse.
    pub fn set_up_sensor(&mut self, finger: u8, parts: &[SensorPart]) -> Result<(), SessionError> {
        for &part in parts.iter().chain([&SensorPart::Use]) {
            self.ask("sensor", Command::Sensor(SensorFrame { finger, part }))?;
        }
        Ok(())
    }

    /// Takes a finger for free.
    ///
    /// # Errors
    /// No answer, or no such finger.
    pub fn tare(&mut self, finger: u8) -> Result<(), SessionError> {
        self.ask("tare", Command::Tare { finger }).map(|_| ())
    }

    /// Asks for contacts as they are felt, at most one of each finger in `period` microseconds; 0
    /// for no more. They are collected as the session hears them: see [`Session::contacts`].
    ///
    /// # Errors
    /// No answer, or a period that is too short.
    pub fn stream(&mut self, period: u32) -> Result<(), SessionError> {
        self.ask("stream", Command::Stream { period }).map(|_| ())
    }

    /// Listens for `time`, without asking anything. What has come of a frame by then is kept for
    /// whoever listens next.
    ///
    /// # Errors
    /// When the link fails.
    pub fn listen(&mut self, time: Duration) -> Result<(), SessionError> {
        let mut answer = Answer::default();
        // Replies to nothing are ignored: this ends when the time is over.
        self.hear("listen", None, Instant::now() + time, &mut answer).map(|_| ())
    }

    /// Takes out what was felt and heard since the last call, in the order it came.
    pub fn contacts(&mut self) -> Vec<FeltContact<S>> {
        std::mem::take(&mut self.contacts).into()
    }

    /// Has a scripted sensor show words; gives what it feels then, if the finger touches.
    ///
    /// # Errors
    /// No answer, no such finger, or one whose sensor is real.
    pub fn show(&mut self, words: WordsFrame) -> Result<Option<FeltContact<S>>, SessionError> {
        let before = self.heard;
        self.ask("words", Command::Words(words))?;
        let new = (self.heard - before) as usize;
        let mine = |felt: &FeltContact<S>| {
            felt.contact.finger == words.finger && felt.time == words.time.0
        };
        Ok(self.contacts.iter().rev().take(new).copied().find(mine))
    }

    /// How a finger of the board fares.
    ///
    /// # Errors
    /// No answer, or no such finger.
    pub fn finger(&mut self, number: u8) -> Result<FingerFrame, SessionError> {
        self.wanted("finger", Command::Query(Topic::Finger(number)), |a| {
            a.finger.filter(|f| f.finger == number)
        })
    }

    /// Which of some grasps (at most [`tactile_core::device::CANDIDATES`]) the board would make next.
    ///
    /// # Errors
    /// No answer; a candidate that is none; a refusal: none or too many candidates, a board that has
    /// felt nothing yet, or whose tracker does not foresee contacts.
    pub fn choose(
        &mut self,
        criterion: Criterion,
        candidates: &[Candidate<S>],
    ) -> Result<ChoiceFrame, SessionError> {
        const NAME: &str = "best candidate";
        if candidates.is_empty() {
            // The board may have a list of old.
            return Err(SessionError::Refused { command: NAME, refusal: Refusal::NoCandidate });
        }
        for (number, candidate) in candidates.iter().enumerate() {
            let frame = CandidateFrame::new(number.min(255) as u8, candidate)
                .map_err(|error| SessionError::Candidate { number, error })?;
            self.ask("consider", Command::Consider(frame))?;
        }
        let topic = Command::Query(Topic::BestCandidate(criterion));
        self.wanted(NAME, topic, |answer| answer.choice)
    }

    /// One grasp: motion since the last (`None`: unknown), what was felt and what was not, world
    /// frame.
    ///
    /// # Errors
    /// No answer, a refusal, or an answer to another grasp. What the board was told of the grasp before
    /// stays with it: told again, the motion is refused and contacts are doubled. It forgets them only
    /// together with the object, by [`reset`](Self::reset) or [`configure`](Self::configure).
    pub fn grasp(
        &mut self,
        motion: Option<&S::Pose>,
        contacts: &[Contact<S>],
        free: &[FreePoint<S>],
    ) -> Result<GraspOutcome<S>, SessionError> {
        let start = Instant::now();
        if let Some(motion) = motion {
            self.ask("motion", Command::Motion(MotionFrame::new(motion)))?;
        }
        let room = self.hello.map_or(usize::MAX, |h| h.contacts.into());
        for contact in contacts.iter().take(room) {
            let frame = ContactFrame::new(contact, self.settings.normal);
            self.ask("contact", Command::Contact(frame))?;
        }
        for free in free.iter().take(room) {
            self.ask("free point", Command::Free(FreeFrame::new(free)))?;
        }
        let due = self.committed;
        let (estimate, health, felt) = self.wanted("commit", Command::Commit, |answer| {
            let (estimate, health) =
                answer.estimate.zip(answer.health).filter(|(e, _)| e.grasp >= due)?;
            Some((estimate, health, std::mem::take(&mut answer.felt)))
        })?;
        if estimate.grasp != due {
            return Err(SessionError::WrongGrasp { due, got: estimate.grasp });
        }
        if estimate.pose().is_none() {
            return Err(SessionError::NotFinite { grasp: due });
        }
        self.committed += 1;
        let elapsed = start.elapsed();
        let modes = match estimate.status() {
            Status::Ambiguous => self.modes()?,
            _ => Vec::new(),
        };
        let [not_sent, free_not_sent] =
            [contacts.len(), free.len()].map(|all| all.saturating_sub(room));
        Ok(GraspOutcome { estimate, modes, health, not_sent, free_not_sent, elapsed, felt })
    }

    /// Replaces what the board believes by what the host knows better.
    ///
    /// # Errors
    /// No answer, or a refusal: of a tracker without faces, of numbers it cannot use. What was taught
    /// before the refusal stays.
    pub fn teach(&mut self, lesson: &Lesson<S>) -> Result<(), SessionError> {
        self.ask("believe", Command::Believe(lesson.belief))?;
        for face in &lesson.faces {
            self.ask("face", Command::Face(*face))?;
        }
        Ok(())
    }

    /// Sends a command until its reply comes; gives what came with it.
    fn ask(&mut self, name: &'static str, command: Command<S>) -> Result<Answer<S>, SessionError> {
        let hello = matches!(command, Command::Hello { .. });
        self.wanted(name, command, |answer| {
            (!hello || answer.hello.is_some()).then(|| std::mem::take(answer))
        })
    }

    /// Sends a command until its reply has come and `found` finds what was asked for among what came
    /// before it.
    fn wanted<R>(
        &mut self,
        name: &'static str,
        command: Command<S>,
        mut found: impl FnMut(&mut Answer<S>) -> Option<R>,
    ) -> Result<R, SessionError> {
        let sequence = self.next;
        self.next = self.next.wrapping_add(1);
        let time = Clock(self.start.elapsed().as_micros() as u32);
        let mut buffer = [0; MAX_FRAME];
        let wire = encode(&Frame { sequence, time, message: command }, &mut buffer)
            .map_err(io::Error::other)?;
        let mut again = Vec::with_capacity(wire.len() + 1);
        // What the board has of a damaged frame ends here.
        again.push(0);
        again.extend_from_slice(wire);
        // Nothing else tells that what was felt is missing from an answer.
        let may_hold_contacts = matches!(command, Command::Commit | Command::Words(_));
        let mut answer = Answer::default();
        for attempt in 0..self.patience.attempts {
            self.repeated += u32::from(attempt > 0);
            // The first greeting may also find a board with half a frame.
            let first = attempt == 0 && !matches!(command, Command::Hello { .. });
            self.link.send(if first { wire } else { &again })?;
            let deadline = Instant::now() + self.patience.wait(&command, attempt, self.longest);
            // What came with an answer that was cut short comes again.
            answer.felt.clear();
            let (sent, damaged) = (Instant::now(), self.decoder.counters().damaged());
            if self.hear(name, Some(sequence), deadline, &mut answer)?
                && !(may_hold_contacts && self.decoder.counters().damaged() > damaged)
                && let Some(result) = found(&mut answer)
            {
                if let Command::Commit = command {
                    self.longest = self.longest.max(sent.elapsed());
                }
                return Ok(result);
            }
        }
        let counters = self.decoder.counters();
        Err(SessionError::Silent {
            command: name,
            attempts: self.patience.attempts,
            counters: format!(
                "{} good frames came, {} damaged",
                counters.frames,
                counters.damaged()
            ),
        })
    }

    /// Collects reports until the reply to `sequence`, if any: true. False when the time is over; what
    /// has come by then of a frame, and what was not taken yet, is heard next time.
    fn hear(
        &mut self,
        name: &'static str,
        sequence: Option<u8>,
        deadline: Instant,
        answer: &mut Answer<S>,
    ) -> Result<bool, SessionError> {
        let mut taken = 0;
        loop {
            // One byte at a time, so that nothing after the reply is taken with it.
            let mut byte = [0];
            let left = deadline.saturating_duration_since(Instant::now());
            // An answer that is there is heard at any patience. A line on which bytes come without end
            // must not hold this one.
            let is_over = left.is_zero() && taken >= ANSWER;
            if is_over || self.link.receive(&mut byte, left)? == 0 {
                return Ok(false);
            }
            taken += 1;
            let received = match self.decoder.push(byte[0]) {
                Some(Ok(received)) => received,
                Some(Err(FrameError::Version { theirs, .. })) => {
                    return Err(SessionError::Version { board: theirs, host: PROTOCOL });
                }
                Some(Err(_)) | None => continue,
            };
            match received.frame.message {
                Report::Hello(hello) => answer.hello = Some(hello),
                Report::Estimate(estimate) => answer.estimate = Some(estimate),
                Report::Health(health) => answer.health = Some(health),
                Report::Mode(mode) => answer.mode = Some(mode),
                Report::Face(face) => answer.face = Some(face),
                Report::Finger(finger) => answer.finger = Some(finger),
                Report::Choice(choice) => answer.choice = Some(choice),
                Report::Felt(contact) => answer.felt.push(contact),
                Report::Contact(_) if received.arrival == Arrival::Doubled => {}
                Report::Contact(contact) => {
                    let time = received.frame.time.0;
                    if self.contacts.len() >= KEPT {
                        self.contacts.pop_front();
                    }
                    self.contacts.push_back(FeltContact { time, contact });
                    self.heard += 1;
                }
                Report::Reply(reply) if Some(reply.to) == sequence => {
                    return match reply.refusal {
                        None => Ok(true),
                        Some(Refusal::NotGreeted) => Err(SessionError::Restarted { command: name }),
                        Some(refusal) => Err(SessionError::Refused { command: name, refusal }),
                    };
                }
                Report::Reply(_) => {}
            }
        }
    }
}
