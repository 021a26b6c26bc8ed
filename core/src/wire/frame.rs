//! The messages of both directions, and what the board says about itself. Their bytes are explained
//! in [`crate::wire`].

use serde::{Deserialize, Serialize};

use super::candidate::{CandidateFrame, ChoiceFrame};
use super::codec::Counters;
use super::estimate::{BeliefFrame, EstimateFrame, FaceFrame, ModeFrame};
use super::grasp::{ContactFrame, FreeFrame, MotionFrame};
use super::quantity::{Clock, WireSpace};
use super::sensor::{FingerFrame, FingertipFrame, SensorFrame, WordsFrame};
use crate::contact::DEVIATIONS;
use crate::explore::Criterion;
use crate::track;

/// Version of the protocol. It changes whenever a golden vector changes; a message that is added at the
/// end changes none.
pub const PROTOCOL: u8 = 3;

/// One message with its place in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame<M> {
    /// Counts the frames of one direction, wrapping.
    pub sequence: u8,
    /// Microseconds of the sender's clock, wrapping.
    pub time: Clock,
    /// What is said.
    pub message: M,
}

/// Host to board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub enum Command<S: WireSpace> {
    /// Asks who is there; answered with [`Report::Hello`]. Starts a conversation: until then a
    /// board refuses everything else, so that a host notices a board that has started again.
    Hello {
        /// [`PROTOCOL`] of the host.
        protocol: u8,
    },
    /// Asks for a reply and nothing else.
    Ping,
    /// Sets noise and seed, and forgets the object.
    Configure(Settings),
    /// Forgets the object and starts again from the configured seed.
    Reset,
    /// How the hand moved the object since the previous grasp.
    Motion(MotionFrame<S>),
    /// Something touched, in the world frame.
    Contact(ContactFrame<S>),
    /// A fingertip that touched nothing, in the world frame.
    Free(FreeFrame<S>),
    /// The grasp is complete: update, and answer [`Report::Estimate`] and [`Report::Health`].
    Commit,
    /// Asks for something already known.
    Query(Topic),
    /// Where the object is now, as the host knows better: replaces the belief, and forgets the faces.
    Believe(BeliefFrame<S>),
    /// A face as the host knows it: adds to what [`Command::Believe`] began.
    Face(FaceFrame<S>),
    /// Where a fingertip is from now on.
    FingertipPose(FingertipFrame<S>),
    /// Tells a fingertip's sensor what it has to know.
    Sensor(SensorFrame),
    /// The fingertip is free: its sensor is tared.
    Tare {
        /// Which finger, from 0.
        finger: u8,
    },
    /// Asks for [`Report::Contact`] unasked from now on, of each finger that touches.
    Stream {
        /// Least microseconds from one to the next of the same finger: at least
        /// [`SHORTEST_STREAM`], or 0 for none.
        period: u32,
    },
    /// Has a scripted sensor show words; what it feels is answered with [`Report::Contact`].
    Words(WordsFrame),
    /// A grasp that could be made next.
    Consider(CandidateFrame<S>),
}

/// Least period of [`Command::Stream`], microseconds: 200 Hz.
pub const SHORTEST_STREAM: u32 = 5000;

/// Board to host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub enum Report<S: WireSpace> {
    /// Who is there: once after a start, and whenever asked.
    Hello(Hello),
    /// What became of a command.
    Reply(Reply),
    /// The belief after a grasp.
    Estimate(EstimateFrame<S>),
    /// How the board fares.
    Health(Health),
    /// One of the poses the belief holds possible.
    Mode(ModeFrame<S>),
    /// One of the object's faces.
    Face(FaceFrame<S>),
    /// What a finger feels, in the world frame; its time is that of the sample.
    Contact(ContactFrame<S>),
    /// A contact that the board felt itself and that is part of the grasp just committed.
    Felt(ContactFrame<S>),
    /// How a finger fares.
    Finger(FingerFrame),
    /// Which of the candidates to take.
    Choice(ChoiceFrame),
}

/// What [`Command::Query`] asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Topic {
    /// [`Report::Estimate`] of the last grasp.
    Estimate,
    /// [`Report::Health`].
    Health,
    /// [`Report::Mode`] of this number, 0 the heaviest, after the last grasp or belief.
    Mode(u8),
    /// [`Report::Face`] of this number, from 0, as the shape is now.
    Face(u8),
    /// [`Report::Finger`] of this number, from 0.
    Finger(u8),
    /// [`Report::Choice`] of the best candidate by this criterion.
    BestCandidate(Criterion),
}

/// Who is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// [`PROTOCOL`] of the board.
    pub protocol: u8,
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u8; 3],
    /// What the core runs on.
    pub board: BoardKind,
    /// How it follows the object.
    pub tracker: TrackerKind,
    /// 2 or 3.
    pub dimension: u8,
    /// Contacts, and as many free points, in one grasp.
    pub contacts: u16,
    /// Contacts the map can hold; faces, where the tracker keeps only those.
    pub map: u16,
    /// Particles, hypotheses or trajectories of the tracker.
    pub particles: u16,
    /// Fingertip sensors that the board reads itself.
    pub fingers: u8,
}

/// How a board follows the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrackerKind {
    /// [`track::Bootstrap`]: particles over one shared map.
    Bootstrap,
    /// Particles that each carry the object's faces.
    RaoBlackwell,
    /// A few hypotheses over pose and faces together.
    Hypotheses,
    /// A few hypotheses over the pose on a curved surface.
    Curved,
    /// Hypotheses over faces and on a curved surface, whichever explains the contacts better.
    Automatic,
}

/// What the core runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BoardKind {
    /// Inside a host process.
    Virtual,
    /// STM32F405, or QEMU's netduinoplus2.
    Stm32f405,
    /// QEMU's mps2-an386.
    Mps2An386,
}

/// Noise and seed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Standard deviation of a contact point along its normal, metres.
    pub point: f32,
    /// Standard deviation of a contact normal, radians per axis.
    pub normal: f32,
    /// Standard deviation of the object's translation between grasps, metres per axis.
    pub translation: f32,
    /// Standard deviation of the object's rotation between grasps, radians per axis.
    pub rotation: f32,
    /// Seed of the filter's random numbers.
    pub seed: u64,
}

impl Settings {
    /// 1 mm and 5° at a contact, 10 mm and 20° between grasps (the thesis' noise), seed 0.
    pub const DEFAULT: Self = Settings {
        point: 1e-3,
        normal: 0.087_266_46,
        translation: track::MotionNoise::THESIS.translation,
        rotation: track::MotionNoise::THESIS.rotation,
        seed: 0,
    };

    /// Largest deviation, metres or radians: nothing is known then, and squares are far from overflowing.
    pub const LARGEST: f32 = 1e3;

    /// Whether no deviation is above [`LARGEST`](Self::LARGEST), the contact's are such as a
    /// [`Contact`](crate::contact::Contact) may have, and the motion's not below zero.
    pub fn is_valid(&self) -> bool {
        let known = |v: f32| (0.0..=Self::LARGEST).contains(&v);
        [self.point, self.normal, self.translation, self.rotation].into_iter().all(known)
            && DEVIATIONS.contains(&self.point)
            && DEVIATIONS.contains(&self.normal)
    }
}

/// How the board fares: counts since it started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Health {
    /// What the decoder saw of the host's frames.
    pub received: Counters,
    /// Bytes the UART lost because nobody took them in time.
    pub overruns: u32,
    /// Commands refused, see [`Refusal`].
    pub refused: u32,
    /// Contacts and free points refused because the grasp was full.
    pub overfull: u32,
    /// Grasps committed without a contact.
    pub empty: u32,
    /// Grasps committed.
    pub grasps: u32,
    /// Deepest stack seen, bytes; 0 where it is not measured.
    pub peak_stack: u32,
    /// Stack there is, bytes; 0 where it is not measured.
    pub stack: u32,
    /// Last tracker update, microseconds.
    pub update: u32,
    /// Longest tracker update, microseconds.
    pub worst_update: u32,
}

impl Health {
    /// Just started.
    pub const NONE: Self = Health {
        received: Counters::NONE,
        overruns: 0,
        refused: 0,
        overfull: 0,
        empty: 0,
        grasps: 0,
        peak_stack: 0,
        stack: 0,
        update: 0,
        worst_update: 0,
    };
}

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// Sequence number of the command.
    pub to: u8,
    /// Nothing when it was obeyed.
    pub refusal: Option<Refusal>,
}

/// Why a command was not obeyed. The state of the board is then as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// Nobody has said `Hello` since the board started: what went before is forgotten.
    NotGreeted,
    /// The host speaks another version of the protocol; the `Hello` that comes along names ours.
    Version,
    /// Deviations must be at most [`Settings::LARGEST`], a contact's at least 10⁻⁹ and a motion's not below
    /// zero.
    Settings,
    /// This grasp already has a motion; the first one stays.
    MotionTwice,
    /// A number of the motion is not finite, or it goes further than 10 km or turns beyond 10⁵ radians.
    Motion,
    /// The grasp holds as many contacts (or free points) as it can; those it has stay.
    Full,
    /// No grasp has been committed since the last reset or belief.
    NoEstimate,
    /// There is no mode, face or finger of this number, or no candidate of the one before.
    NoSuch,
    /// A number of a belief or face cannot be used, or a face came before any belief and any grasp.
    Belief,
    /// The map has no room for another face; those it has stay.
    MapFull,
    /// This tracker's belief cannot be replaced.
    Fixed,
    /// A fingertip's pose is not finite.
    Pose,
    /// The sensor's calibration matrix is singular: some load would not be felt.
    Singular,
    /// A number of the sensor's settings is not finite, not positive where it must be, or out of
    /// order.
    Sensor,
    /// This part is not of the sensor that was begun last: another kind's, or another finger's. A board is told of one
    /// sensor at a time.
    Part,
    /// Contacts cannot be streamed that fast.
    Rate,
    /// The sensors are real: they show what they feel.
    NotScripted,
    /// A number of the candidate is not finite, a stroke has no length, or no finger closes.
    Candidate,
    /// The list of candidates has no such place.
    TooMany,
    /// No candidate has been named since the list was forgotten.
    NoCandidate,
    /// Nothing is known of the object's shape yet.
    NoShape,
    /// This tracker does not foresee contacts.
    NoForesight,
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Refusal::NotGreeted => "the board has started and was not greeted",
            Refusal::Version => "the protocol's version is another",
            Refusal::Settings => "a standard deviation is too small, or too large",
            Refusal::MotionTwice => "the grasp already has a motion",
            Refusal::Motion => "the motion is not finite, or too large",
            Refusal::Full => "the grasp is full",
            Refusal::NoEstimate => "no grasp has been committed yet",
            Refusal::NoSuch => "there are not so many",
            Refusal::Belief => "a number of the belief or face cannot be used",
            Refusal::MapFull => "the map has no room for another face",
            Refusal::Fixed => "the belief of this tracker cannot be replaced",
            Refusal::Pose => "the fingertip's pose is not finite",
            Refusal::Singular => "the calibration matrix is singular",
            Refusal::Sensor => "a number of the sensor's settings cannot be",
            Refusal::Part => "no sensor of that kind was begun for the finger",
            Refusal::Rate => "contacts cannot be streamed that fast",
            Refusal::NotScripted => "the finger has no scripted sensor",
            Refusal::Candidate => "the candidate is not finite, or no finger of it closes",
            Refusal::TooMany => "so many candidates cannot be considered",
            Refusal::NoCandidate => "no candidate has been named",
            Refusal::NoShape => "nothing is known of the shape yet",
            Refusal::NoForesight => "this tracker does not foresee contacts",
        })
    }
}
