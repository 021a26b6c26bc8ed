//! What a recording tells: the grasps that were sent, and what the board made of them.

use std::time::Duration;

use serde_json::Map;
use tactile_core::space::{Planar, Spatial};
use tactile_core::track::Status;
use tactile_core::wire::{
    Arrival, Command, ContactFrame, Counters, Decoder, EstimateFrame, Frame, Health, Hello,
    ModeFrame, Received, Report, Settings, Topic, WireSpace,
};

use super::recording::{Direction, Header, Piece, Recording};
use super::{GraspLog, LoggedContact, LoggedFree, LoggedGrasp, Noise};
use crate::space::{Bridge, Point, Pose};

#[cfg(test)]
mod damage_tests;
mod left_out;
#[cfg(test)]
mod tests;
mod written;

pub use left_out::LeftOut;
use left_out::{joined, tells};

/// A recording, understood.
#[derive(Clone, Debug, PartialEq)]
pub struct Replayed {
    /// What the host sent and the board accepted, as a grasp log; every grasp carries the board's
    /// estimate, if it came, in the field `estimate`, which no estimator reads.
    pub log: GraspLog,
    /// What the board answered: one for every grasp whose answer is in the recording.
    pub estimates: Vec<RecordedEstimate>,
    /// Who answered.
    pub hello: Option<Hello>,
    /// What the board said last about itself.
    pub health: Option<Health>,
    /// Frames from the board.
    pub from_board: Counters,
    /// Frames to the board; those sent again count as doubled.
    pub to_board: Counters,
    /// Commands the board refused.
    pub refused: usize,
    /// What damage took from the log.
    pub left_out: LeftOut,
    /// From the start to the last piece; see [`listen`] for times that run backwards.
    pub duration: Duration,
}

/// One estimate without its dimension.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEstimate {
    /// Since the start of the recording.
    pub time: Duration,
    /// The board's number of the grasp.
    pub grasp: u32,
    /// Object to world.
    pub pose: Pose,
    /// Standard deviations in tangent coordinates, metres and radians.
    pub deviations: Vec<f32>,
    /// How much it is worth.
    pub status: Status,
    /// The poses held possible and their shares, heaviest first, where they were asked for.
    pub modes: Vec<(Pose, f32)>,
    /// Effective number of particles or hypotheses.
    pub effective_particles: u16,
    /// Contacts used, with bad numbers, and let go by the map.
    pub contacts: [u8; 3],
    /// Whether the grasp corrected the pose.
    pub corrected: bool,
    /// Whether the particles were resampled.
    pub resampled: bool,
}

impl Recording {
    /// Decodes both directions and pairs commands with replies.
    pub fn replay(&self) -> Replayed {
        let header = &self.header;
        let mut log = GraspLog {
            dimension: header.dimension,
            description: header.description.clone(),
            fingers: header.fingers.clone(),
            noise: Noise::default(),
            shape: None,
            grasps: Vec::new(),
            unknown: Map::new(),
        };
        let mut estimates = Vec::new();
        let pieces = |ear: &mut dyn FnMut(&Piece)| self.pieces.iter().for_each(ear);
        let rest = listen(header, pieces, &mut |heard| match heard {
            Heard::Forgotten => {
                log.grasps.clear();
                estimates.clear();
            }
            Heard::Grasp(mut grasp, estimate) => {
                if let Some(estimate) = estimate {
                    grasp.unknown.insert("estimate".into(), estimate.to_json(header.dimension));
                    estimates.push(estimate);
                }
                log.grasps.push(*grasp);
            }
        });
        let Rest { noise, hello, health, from_board, to_board, refused, left_out, duration } = rest;
        log.noise = noise;
        Replayed {
            log,
            estimates,
            hello,
            health,
            from_board,
            to_board,
            refused,
            left_out,
            duration,
        }
    }
}

/// What a recording tells one after the other.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// The board was told to begin anew: what came before is of another object.
    Forgotten,
    /// A grasp that the board accepted, and what it made of it, where the recording tells.
    Grasp(Box<LoggedGrasp>, Option<RecordedEstimate>),
}

/// What a recording tells besides.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// As the board was last told.
    pub noise: Noise,
    /// Who answered.
    pub hello: Option<Hello>,
    /// What the board said last about itself.
    pub health: Option<Health>,
    /// Frames from the board.
    pub from_board: Counters,
    /// Frames to the board; those sent again count as doubled.
    pub to_board: Counters,
    /// Commands the board refused.
    pub refused: usize,
    /// What damage took from the log.
    pub left_out: LeftOut,
    /// From the start to the last piece; see [`listen`] for times that run backwards.
    pub duration: Duration,
}

/// Decodes both directions, pairs commands with replies, and tells `hear` of every grasp as it comes
/// about: for recordings that are too long to be held at once. `pieces` puts one after the other to the
/// ear that it is given.
///
/// Grasps are numbered and told apart as the board counts them, so that pieces that are missing cost what was
/// in them: of a commit that was lost, the board's answer tells. What damage leaves in doubt is left out, and a
/// motion since a grasp that is not in the log is unknown.
///
/// Times never run backwards: a step back in the pieces' times, as where two recordings were joined, takes
/// no time, and steps forwards count from there.
pub fn listen(
    header: &Header,
    pieces: impl FnOnce(&mut dyn FnMut(&Piece)),
    hear: &mut dyn FnMut(Heard),
) -> Rest {
    match header.dimension {
        2 => listen_in::<Planar>(header, pieces, hear),
        _ => listen_in::<Spatial>(header, pieces, hear),
    }
}

/// The commands of the grasp that is being collected.
struct Collector<'a, S: WireSpace> {
    hear: &'a mut dyn FnMut(Heard),
    rest: Rest,
    fingers: usize,
    settings: Settings,
    /// Sequence number of the last command.
    sequence: Option<u8>,
    /// What was told of a grasp since the last commit or loss, and between losses before.
    grasp: LoggedGrasp,
    earlier: Vec<LoggedGrasp>,
    /// The number that follows that of the last grasp.
    due: u64,
    /// What the board made of the grasp that it is about to answer, and what it added to it.
    estimate: Option<EstimateFrame<S>>,
    felt: Vec<ContactFrame<S>>,
    /// When the board spoke last.
    heard_at: Duration,
    /// The last grasp, whose other answers may yet come.
    done: Option<(LoggedGrasp, Option<RecordedEstimate>)>,
}

/// The number with the fewest digits that is still this `f32`, so that 0.001 stays 0.001.
fn shortest(value: f32) -> f64 {
    const POWERS: [f64; 13] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12];
    let exact = f64::from(value);
    // Long recordings hold many. Whole numbers and powers of ten are exact, their quotient is rounded as it
    // is when the digits are read, and where some digits are enough, more are.
    if (1e-4..1e4).contains(&exact.abs()) {
        let short = |power: &f64| (exact * power).round() / power;
        let enough = POWERS.partition_point(|power| short(power) as f32 != value);
        if let Some(power) = POWERS.get(enough) {
            return short(power);
        }
    }
    value.to_string().parse().unwrap_or(exact)
}

fn shortest_point<S: Bridge>(vector: &S::Vector) -> Point {
    S::point(vector).map(|v| shortest(v as f32))
}

/// What a log says of settings that a board accepted. A board may be told that motions are exact; a log's
/// deviations are positive, and without one a usual motion would be taken. The least says the same as zero:
/// models that need a positive one take it for zero.
fn noise(settings: &Settings) -> Noise {
    let or_least = |deviation: f32, least: f64| match deviation {
        0.0 => Some(least),
        positive => Some(shortest(positive)),
    };
    Noise {
        point: Some(shortest(settings.point)),
        normal: Some(shortest(settings.normal)),
        translation: or_least(settings.translation, Noise::LEAST_TRANSLATION),
        rotation: or_least(settings.rotation, Noise::LEAST_ROTATION),
    }
}

fn listen_in<S: Bridge + WireSpace>(
    header: &Header,
    pieces: impl FnOnce(&mut dyn FnMut(&Piece)),
    hear: &mut dyn FnMut(Heard),
) -> Rest {
    let mut collector = Collector::<S> {
        hear,
        rest: Rest {
            noise: Noise::default(),
            hello: None,
            health: None,
            from_board: Counters::NONE,
            to_board: Counters::NONE,
            refused: 0,
            left_out: LeftOut::default(),
            duration: Duration::ZERO,
        },
        fingers: header.fingers.len(),
        settings: Settings::DEFAULT,
        sequence: None,
        grasp: LoggedGrasp::default(),
        earlier: Vec::new(),
        due: 0,
        estimate: None,
        felt: Vec::new(),
        heard_at: Duration::ZERO,
        done: None,
    };
    let mut to_board = Decoder::<Command<S>>::new();
    let mut from_board = Decoder::<Report<S>>::new();
    let mut pending: Option<(u8, Command<S>)> = None;
    let mut last = Duration::ZERO;
    pieces(&mut |piece| {
        let passed = piece.time.saturating_sub(last);
        collector.rest.duration = collector.rest.duration.saturating_add(passed);
        last = piece.time;
        let mut left = &piece.bytes[..];
        while !left.is_empty() {
            match piece.way {
                Direction::ToBoard => {
                    let (taken, rest) = to_board.take(left);
                    left = rest;
                    if let Some(Ok(Received { frame, arrival: Arrival::New })) = taken {
                        collector.asked(frame, &mut pending);
                    }
                }
                Direction::FromBoard => {
                    let (taken, rest) = from_board.take(left);
                    left = rest;
                    if let Some(Ok(received)) = taken {
                        collector.answered(received, &mut pending);
                    }
                }
            }
        }
    });
    collector.commit_unheard();
    collector.tell();
    collector.rest.to_board = *to_board.counters();
    collector.rest.from_board = *from_board.counters();
    let is_told = collector.rest.noise != Noise::default();
    collector.rest.left_out.noise = !is_told && to_board.counters().lost > 0;
    collector.rest
}

impl<S: Bridge + WireSpace> Collector<'_, S> {
    /// A command, which is `pending` from now on.
    fn asked(&mut self, frame: Frame<Command<S>>, pending: &mut Option<(u8, Command<S>)>) {
        let greets = matches!(frame.message, Command::Hello { .. });
        let before = pending.replace((frame.sequence, frame.message));
        // Who greets may have given up on what was asked before, and counts from anywhere.
        self.presume(before.filter(|_| !greets));
        self.commit_unheard();
        if greets {
            self.sequence = None;
        }
        self.follow(frame.sequence);
    }

    /// The reply to a command is not in the recording, but the host went on, as it does after a reply: what
    /// the board had no reason to refuse was obeyed.
    fn presume(&mut self, unanswered: Option<(u8, Command<S>)>) {
        let Some((_, command)) = unanswered else { return };
        let room = self.rest.hello.map_or(usize::MAX, |hello| hello.contacts.into());
        let is_refused = match &command {
            Command::Motion(_) => self.grasp.motion.is_some(),
            Command::Contact(_) => self.grasp.contacts.len() >= room,
            Command::Free(_) => self.grasp.free.len() >= room,
            Command::Configure(settings) => !settings.is_valid(),
            _ => false,
        };
        if !is_refused {
            self.obeyed(command);
        }
    }

    /// A command of this sequence number was sent. A commit may be among those that are missing before it: the
    /// board's next number will tell.
    fn follow(&mut self, sequence: u8) {
        let last = self.sequence.replace(sequence);
        if last.is_some_and(|last| last.wrapping_add(1) != sequence) {
            let time = Some(self.heard_at.as_secs_f64());
            self.earlier.push(LoggedGrasp { time, ..std::mem::take(&mut self.grasp) });
        }
    }

    /// The board's answer to a commit tells of it where neither it nor its reply was heard.
    fn commit_unheard(&mut self) {
        if self.is_committed() {
            self.commit();
        }
    }

    /// Whether the board has begun to answer a commit.
    fn is_committed(&self) -> bool {
        self.estimate.is_some() || !self.felt.is_empty()
    }

    /// Whether the answer that has begun is to the next grasp, as far as is known.
    fn is_of_due(&self) -> bool {
        self.estimate.as_ref().is_none_or(|estimate| u64::from(estimate.grasp) <= self.due)
    }

    /// What the board says; a reply is to the command that is `pending`.
    fn answered(&mut self, received: Received<Report<S>>, pending: &mut Option<(u8, Command<S>)>) {
        self.heard_at = self.rest.duration;
        let is_new = received.arrival == Arrival::New;
        let answers_commit =
            matches!(received.frame.message, Report::Estimate(_) | Report::Felt(_));
        if is_new && answers_commit && self.estimate.is_some() {
            // An answer has one estimate, which comes last of these: this is another answer.
            self.presume(pending.take());
            self.commit_unheard();
        }
        // Before the reply to a commit these are of that grasp. After it the answer was sent again, as the
        // host had missed a part of it: what comes for the first time then is of the last grasp.
        let committing = matches!(pending, Some((_, Command::Commit)));
        let asking = matches!(pending, Some((_, Command::Query(Topic::Estimate))));
        let asks_mode = matches!(pending, Some((_, Command::Query(Topic::Mode(_)))));
        match received.frame.message {
            Report::Hello(hello) => self.rest.hello = Some(hello),
            Report::Health(health) => self.rest.health = Some(health),
            Report::Estimate(_) | Report::Felt(_) if received.arrival == Arrival::Doubled => {}
            Report::Estimate(estimate) => {
                // Of another grasp than the last: its commit was lost.
                let next = u64::from(estimate.grasp) + 1;
                let another = next > self.due || (is_new && next < self.due);
                if committing || (another && !asking) {
                    self.estimate = Some(estimate);
                } else {
                    self.estimated(&estimate);
                }
            }
            // Of the last grasp, unless its commit may be missing.
            Report::Mode(frame) if self.earlier.is_empty() && (asks_mode || !is_new) => {
                self.mode(&frame);
            }
            Report::Mode(_) => {}
            Report::Face(_) | Report::Contact(_) | Report::Finger(_) | Report::Choice(_) => {}
            Report::Felt(frame) if committing || is_new => self.felt.push(frame),
            Report::Felt(frame) => {
                let contact = self.logged(&frame);
                if let Some((grasp, _)) = &mut self.done {
                    grasp.contacts.push(contact);
                }
            }
            Report::Reply(reply) => match pending.take_if(|(sequence, _)| *sequence == reply.to) {
                Some((_, command)) if reply.refusal.is_none() => self.obeyed(command),
                Some(_) => self.rest.refused += 1,
                // To a command that was lost, and so was the end of the answer to the pending commit, if one is.
                None if is_new && committing && self.is_of_due() => self.presume(pending.take()),
                // To a commit that was lost.
                None if is_new && self.is_committed() => {
                    let answer = (self.estimate.take(), std::mem::take(&mut self.felt));
                    self.presume(pending.take());
                    self.follow(reply.to);
                    (self.estimate, self.felt) = answer;
                    self.commit();
                }
                None => {}
            },
        }
    }

    fn obeyed(&mut self, command: Command<S>) {
        match command {
            Command::Hello { .. } | Command::Ping | Command::Query(_) => {}
            // Of no account to what was felt: the estimates that follow show it.
            Command::Believe(_) | Command::Face(_) => {}
            Command::FingertipPose(_)
            | Command::Sensor(_)
            | Command::Tare { .. }
            | Command::Stream { .. }
            | Command::Words(_)
            | Command::Consider(_) => {}
            Command::Configure(settings) => {
                // Boards refuse what is not valid.
                if settings.is_valid() {
                    self.settings = settings;
                    self.rest.noise = noise(&settings);
                }
                self.forget();
            }
            Command::Reset => self.forget(),
            Command::Motion(frame) => {
                self.grasp.motion = frame.motion().map(|m| S::isometry(&m));
            }
            Command::Contact(frame) => self.grasp.contacts.push(self.logged(&frame)),
            Command::Free(frame) => {
                let free = frame.free_point();
                let finger = self.finger(free.finger);
                self.grasp.free.push(LoggedFree {
                    finger,
                    point: shortest_point::<S>(&free.point),
                    unknown: Map::new(),
                });
            }
            Command::Commit => self.commit(),
        }
    }

    /// A contact of the grasp, sent by the host or felt by the board.
    fn logged(&self, frame: &ContactFrame<S>) -> LoggedContact {
        let contact = frame.contact(&self.settings);
        let own = contact.normal_deviation != self.settings.normal;
        LoggedContact {
            finger: self.finger(contact.finger),
            point: shortest_point::<S>(&contact.point),
            normal: contact.normal.map(|n| shortest_point::<S>(&n)),
            normal_noise: own.then_some(shortest(contact.normal_deviation)),
            force: None,
            unknown: Map::new(),
        }
    }

    /// One of the answers of the last estimate.
    fn mode(&mut self, frame: &ModeFrame<S>) {
        if let (Some(mode), Some((_, Some(estimate)))) = (frame.mode(), &mut self.done)
            && estimate.modes.len() == usize::from(frame.number)
        {
            estimate.modes.push((S::isometry(&mode.pose), mode.weight));
        }
    }

    /// An index only where the log can name it.
    fn finger(&self, finger: u8) -> Option<usize> {
        Some(usize::from(finger)).filter(|&f| f < self.fingers)
    }

    /// A board that forgets starts a new log: the last object is what a recording is of.
    fn forget(&mut self) {
        self.tell();
        self.grasp = LoggedGrasp::default();
        self.earlier.clear();
        self.due = 0;
        self.estimate = None;
        self.felt.clear();
        self.rest.left_out = LeftOut::default();
        (self.hear)(Heard::Forgotten);
    }

    /// Nothing more will come about the last grasp.
    fn tell(&mut self) {
        if let Some((grasp, estimate)) = self.done.take() {
            if let Some(RecordedEstimate { contacts: [used, rejected, _], .. }) = estimate {
                let counted = u64::from(used) + u64::from(rejected);
                self.rest.left_out.contacts += counted.saturating_sub(grasp.contacts.len() as u64);
            }
            (self.hear)(Heard::Grasp(Box::new(grasp), estimate));
        }
    }

    /// The board counts another grasp. Where something of what was told before was lost, its number says whose
    /// that was; without it only what was told last is certainly this grasp's.
    fn commit(&mut self) {
        let estimate = self.estimate.take();
        let felt = std::mem::take(&mut self.felt);
        let last = std::mem::take(&mut self.grasp);
        let counted = estimate.as_ref().map(|estimate| u64::from(estimate.grasp));
        if counted.is_some_and(|number| number < self.due) {
            // That the board was told to begin anew was lost.
            self.forget();
        }
        let mut earlier = std::mem::take(&mut self.earlier);
        let is_torn = !earlier.is_empty();
        let mut grasp = match counted {
            Some(number) if number == self.due => joined(earlier, last),
            Some(_) => {
                // Where nothing was seen to be lost in between, it was lost after all that was told; a recording
                // may begin with any grasp.
                let last = if is_torn || self.due == 0 {
                    last
                } else {
                    let time = Some(self.heard_at.as_secs_f64());
                    earlier.push(LoggedGrasp { time, ..last });
                    LoggedGrasp::default()
                };
                if let Some(first) = earlier.into_iter().next().filter(tells) {
                    self.add(first, self.due, true);
                }
                last
            }
            // Since which grasp the motion is, is not known.
            None if is_torn => LoggedGrasp { motion: None, ..last },
            None => last,
        };
        grasp.contacts.extend(felt.iter().map(|frame| self.logged(frame)));
        grasp.time = Some(self.heard_at.as_secs_f64());
        self.add(grasp, counted.unwrap_or(self.due), is_torn);
        if let Some(estimate) = estimate {
            self.estimated(&estimate);
        }
    }

    /// The grasp of this number, of which something may have been lost.
    fn add(&mut self, mut grasp: LoggedGrasp, number: u64, is_torn: bool) {
        self.tell();
        let skipped = number.saturating_sub(self.due);
        self.rest.left_out.grasps += skipped;
        if skipped > 0 {
            grasp.motion = None;
        }
        if self.due > 0 && grasp.motion.is_none() && (is_torn || skipped > 0) {
            self.rest.left_out.motions.push(number);
        }
        grasp.index = number;
        self.due = number + 1;
        self.done = Some((grasp, None));
    }

    /// What the board made of the last grasp, if that is not known yet.
    fn estimated(&mut self, estimate: &EstimateFrame<S>) {
        let time = self.heard_at;
        if let (Some((grasp, told @ None)), Some(pose)) = (&mut self.done, estimate.pose())
            && grasp.index == u64::from(estimate.grasp)
        {
            *told = Some(RecordedEstimate {
                time,
                grasp: estimate.grasp,
                pose: S::isometry(&pose),
                status: estimate.status(),
                modes: Vec::new(),
                deviations: AsRef::<[f32]>::as_ref(&estimate.deviations).to_vec(),
                effective_particles: estimate.effective_particles,
                contacts: [estimate.contacts, estimate.rejected, estimate.dropped],
                corrected: estimate.corrected(),
                resampled: estimate.resampled(),
            });
        }
    }
}
