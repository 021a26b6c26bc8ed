//! What a recording tells: the grasps that were sent, and what the board made of them.

use std::io::{self, Write};
use std::time::Duration;

use serde_json::{Map, Value, json};
use tactile_core::space::{Planar, Spatial};
use tactile_core::track::Status;
use tactile_core::wire::{
    Arrival, Command, ContactFrame, Counters, Decoder, EstimateFrame, Health, Hello, ModeFrame,
    Received, Report, Settings, WireSpace,
};

use super::recording::{Direction, Header, Piece, Recording};
use super::{GraspLog, LoggedContact, LoggedFree, LoggedGrasp, Noise};
use crate::space::{self, Bridge, Point, Pose};

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
        let Rest { noise, hello, health, from_board, to_board, refused, duration } = rest;
        log.noise = noise;
        Replayed { log, estimates, hello, health, from_board, to_board, refused, duration }
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
    /// From the start to the last piece; see [`listen`] for times that run backwards.
    pub duration: Duration,
}

/// Decodes both directions, pairs commands with replies, and tells `hear` of every grasp as it comes
/// about: for recordings that are too long to be held at once. `pieces` puts one after the other to the
/// ear that it is given.
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
    grasp: LoggedGrasp,
    /// What the board made of the grasp that it is about to answer.
    estimate: Option<EstimateFrame<S>>,
    /// The last grasp, whose other answers may yet come.
    done: Option<(LoggedGrasp, Option<RecordedEstimate>)>,
    /// What the board added to the grasp that it is about to answer.
    felt: Vec<ContactFrame<S>>,
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

fn empty_grasp(index: u64) -> LoggedGrasp {
    LoggedGrasp {
        index,
        time: None,
        motion: None,
        contacts: Vec::new(),
        free: Vec::new(),
        truth: None,
        unknown: Map::new(),
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
            duration: Duration::ZERO,
        },
        fingers: header.fingers.len(),
        settings: Settings::DEFAULT,
        grasp: empty_grasp(0),
        estimate: None,
        done: None,
        felt: Vec::new(),
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
                        pending = Some((frame.sequence, frame.message));
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
    collector.tell();
    collector.rest.to_board = *to_board.counters();
    collector.rest.from_board = *from_board.counters();
    collector.rest
}

impl<S: Bridge + WireSpace> Collector<'_, S> {
    /// What the board says; a reply is to the command that is `pending`.
    fn answered(&mut self, received: Received<Report<S>>, pending: &mut Option<(u8, Command<S>)>) {
        // Before the reply to a commit these are of that grasp. After it the answer was sent again, as the
        // host had missed a part of it: what comes for the first time then is of the last grasp.
        let committing = matches!(pending, Some((_, Command::Commit)));
        match received.frame.message {
            Report::Hello(hello) => self.rest.hello = Some(hello),
            Report::Health(health) => self.rest.health = Some(health),
            Report::Estimate(_) | Report::Felt(_) if received.arrival == Arrival::Doubled => {}
            Report::Estimate(estimate) if committing => self.estimate = Some(estimate),
            Report::Estimate(estimate) => self.estimated(&estimate),
            Report::Mode(frame) => self.mode(&frame),
            Report::Face(_) | Report::Contact(_) | Report::Finger(_) | Report::Choice(_) => {}
            Report::Felt(frame) if committing => self.felt.push(frame),
            Report::Felt(frame) => {
                let contact = self.logged(&frame);
                if let Some((grasp, _)) = &mut self.done {
                    grasp.contacts.push(contact);
                }
            }
            Report::Reply(reply) => match pending.take_if(|(sequence, _)| *sequence == reply.to) {
                Some((_, command)) if reply.refusal.is_none() => self.obeyed(command),
                Some(_) => self.rest.refused += 1,
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
        self.grasp = empty_grasp(0);
        self.estimate = None;
        self.felt.clear();
        (self.hear)(Heard::Forgotten);
    }

    /// Nothing more will come about the last grasp.
    fn tell(&mut self) {
        if let Some((grasp, estimate)) = self.done.take() {
            (self.hear)(Heard::Grasp(Box::new(grasp), estimate));
        }
    }

    fn commit(&mut self) {
        self.tell();
        for frame in std::mem::take(&mut self.felt) {
            self.grasp.contacts.push(self.logged(&frame));
        }
        let next = self.grasp.index + 1;
        let mut grasp = std::mem::replace(&mut self.grasp, empty_grasp(next));
        grasp.time = Some(self.rest.duration.as_secs_f64());
        self.done = Some((grasp, None));
        if let Some(estimate) = self.estimate.take() {
            self.estimated(&estimate);
        }
    }

    /// What the board made of the last grasp, if that is not known yet.
    fn estimated(&mut self, estimate: &EstimateFrame<S>) {
        let time = self.rest.duration;
        if let (Some((_, told @ None)), Some(pose)) = (&mut self.done, estimate.pose()) {
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

impl RecordedEstimate {
    fn to_json(&self, dimension: usize) -> Value {
        let pose = |pose: &Pose| {
            let t = pose.translation.vector;
            let q = pose.rotation.coords;
            match dimension {
                2 => json!({ "translation": [t.x, t.y], "rotation": space::angle(pose) }),
                _ => json!({ "translation": [t.x, t.y, t.z], "rotation": [q.x, q.y, q.z, q.w] }),
            }
        };
        let modes = self.modes.iter().map(|(p, weight)| {
            let mut mode = pose(p);
            mode["weight"] = json!(weight);
            mode
        });
        json!({
            "pose": pose(&self.pose), "modes": modes.collect::<Vec<_>>(),
            "deviations": self.deviations, "effective_particles": self.effective_particles,
            "corrected": self.corrected, "status": self.status.name(),
        })
    }
}

impl Replayed {
    /// Writes one line per estimate: grasp, time (s), position (m), rotation (radians or quaternion
    /// x, y, z, w), standard deviations in object axes (m, rad), counts.
    ///
    /// # Errors
    /// When the writer fails.
    pub fn write_csv(&self, writer: &mut (impl Write + ?Sized)) -> io::Result<()> {
        let counts = "effective_particles,contacts,rejected,dropped,corrected,resampled,status";
        let planar = self.log.dimension == 2;
        if planar {
            writeln!(writer, "grasp,time,x,y,angle,sd_x,sd_y,sd_angle,{counts}")?;
        } else {
            let sd = "sd_x,sd_y,sd_z,sd_rx,sd_ry,sd_rz";
            writeln!(writer, "grasp,time,x,y,z,qx,qy,qz,qw,{sd},{counts}")?;
        }
        for e in &self.estimates {
            let t = e.pose.translation.vector;
            let q = e.pose.rotation.coords;
            write!(writer, "{},{:.6},", e.grasp, e.time.as_secs_f64())?;
            if planar {
                write!(writer, "{:.6},{:.6},{:.6}", t.x, t.y, space::angle(&e.pose))?;
            } else {
                write!(writer, "{:.6},{:.6},{:.6},", t.x, t.y, t.z)?;
                write!(writer, "{:.6},{:.6},{:.6},{:.6}", q.x, q.y, q.z, q.w)?;
            }
            for deviation in &e.deviations {
                write!(writer, ",{deviation:.6}")?;
            }
            let [contacts, rejected, dropped] = e.contacts;
            write!(writer, ",{},{contacts},{rejected},{dropped}", e.effective_particles)?;
            let (corrected, resampled) = (u8::from(e.corrected), u8::from(e.resampled));
            writeln!(writer, ",{corrected},{resampled},{}", e.status.name())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
