//! The messages, and how the core's types become messages and back. Their bytes are explained in
//! [`crate::wire`].

use serde::{Deserialize, Serialize};

use super::candidate::{CandidateFrame, ChoiceFrame};
use super::codec::Counters;
use super::quantity::{Clock, Fraction, WireSpace, nearest};
use super::sensor::{FingerFrame, FingertipFrame, SensorFrame, WordsFrame};
use crate::contact::{Contact, FreePoint};
use crate::explore::Criterion;
use crate::math;
use crate::matrix::{Coordinates, Square};
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
    /// [`Report::Mode`] of this number, 0 the heaviest, after the last grasp.
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
    /// Contacts the map can hold.
    pub map: u16,
    /// Particles or hypotheses of the tracker.
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

    /// Whether every deviation is finite, the contact's above zero and the motion's not below.
    pub fn is_valid(&self) -> bool {
        let finite = [self.point, self.normal, self.translation, self.rotation]
            .iter()
            .all(|v| v.is_finite());
        finite
            && self.point > 0.0
            && self.normal > 0.0
            && self.translation >= 0.0
            && self.rotation >= 0.0
    }
}

/// A motion, world to world: predicted pose = motion ∘ previous pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct MotionFrame<S: WireSpace> {
    /// The pose's numbers.
    pub numbers: S::Numbers,
}

impl<S: WireSpace> MotionFrame<S> {
    /// Packs a motion.
    pub fn new(motion: &S::Pose) -> Self {
        MotionFrame { numbers: S::pack_pose(motion) }
    }

    /// The motion, or `None` when a number is not finite.
    pub fn motion(&self) -> Option<S::Pose> {
        S::unpack_pose(self.numbers)
    }
}

/// A contact in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct ContactFrame<S: WireSpace> {
    /// Which finger.
    pub finger: u8,
    /// Where, micrometres.
    pub point: S::Point,
    /// The unit normal out of the object and its standard deviation in quarter degrees, where 0
    /// stands for [`Settings::normal`].
    pub normal: Option<(S::Normal, u8)>,
}

const QUARTER_DEGREE: f32 = core::f32::consts::PI / 720.0;

impl<S: WireSpace> ContactFrame<S> {
    /// Packs a contact. Its own normal deviation is sent (to the nearest quarter degree, at least
    /// one and at most 63.75°) only where it differs from the `usual` one; the point's deviation is
    /// always the configured one.
    pub fn new(contact: &Contact<S>, usual: f32) -> Self {
        let deviation = if contact.normal_deviation == usual {
            0
        } else {
            nearest(contact.normal_deviation / QUARTER_DEGREE).clamp(1, 255) as u8
        };
        ContactFrame {
            finger: contact.finger,
            point: S::pack_point(contact.point),
            normal: contact.normal.map(|n| (S::pack_normal(n), deviation)),
        }
    }

    /// The contact, with the deviations of `settings` where the frame has none.
    pub fn contact(&self, settings: &Settings) -> Contact<S> {
        let deviation = match self.normal {
            Some((_, quarters)) if quarters > 0 => quarters as f32 * QUARTER_DEGREE,
            _ => settings.normal,
        };
        Contact {
            point: S::unpack_point(self.point),
            normal: self.normal.map(|(n, _)| S::unpack_normal(n)),
            point_deviation: settings.point,
            normal_deviation: deviation,
            finger: self.finger,
        }
    }
}

/// A free fingertip in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct FreeFrame<S: WireSpace> {
    /// Which finger.
    pub finger: u8,
    /// Where, micrometres.
    pub point: S::Point,
}

impl<S: WireSpace> FreeFrame<S> {
    /// Packs a free point.
    pub fn new(free: &FreePoint<S>) -> Self {
        FreeFrame { finger: free.finger, point: S::pack_point(free.point) }
    }

    /// The free point.
    pub fn free_point(&self) -> FreePoint<S> {
        FreePoint { point: S::unpack_point(self.point), finger: self.finger }
    }
}

/// The belief after one grasp. Of the observability only the eigenvalues and the weakest direction
/// travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct EstimateFrame<S: WireSpace> {
    /// Number of the grasp since the last reset, from 0.
    pub grasp: u32,
    /// Object to world.
    pub pose: S::Numbers,
    /// Standard deviations of the pose in tangent coordinates, metres and radians.
    pub deviations: S::Deviations,
    /// Correlations of the tangent coordinates, the lower triangle row by row.
    pub correlations: S::Correlations,
    /// Effective number of particles, to the nearest whole number.
    pub effective_particles: u16,
    /// Half the eigenvalues of the observability, ascending.
    pub eigenvalues: S::Fractions,
    /// The eigenvector of the least eigenvalue.
    pub weakest: S::Fractions,
    /// Contacts that corrected the pose, at most 255.
    pub contacts: u8,
    /// Contacts of this grasp with bad numbers, at most 255.
    pub rejected: u8,
    /// Contacts the bounded map let go in this update, at most 255.
    pub dropped: u8,
    /// Bit 0: the grasp corrected the pose. Bit 1: the particles were resampled. Bits 2 to 4: the
    /// [`track::Status`] in the order of its variants.
    pub flags: u8,
}

impl<S: WireSpace> EstimateFrame<S> {
    /// Packs what the tracker believes.
    pub fn new(estimate: &track::Estimate<S>) -> Self {
        let mut frame = EstimateFrame {
            grasp: estimate.grasp,
            pose: S::pack_pose(&estimate.pose),
            deviations: S::Deviations::default(),
            correlations: S::Correlations::default(),
            effective_particles: nearest(estimate.effective_particles).clamp(0, u16::MAX as i32)
                as u16,
            eigenvalues: S::Fractions::default(),
            weakest: S::Fractions::default(),
            contacts: estimate.contacts.min(255) as u8,
            rejected: estimate.rejected.min(255) as u8,
            dropped: estimate.dropped.min(255) as u8,
            flags: estimate.corrected as u8
                | (estimate.resampled as u8) << 1
                | (estimate.status as u8) << 2,
        };
        (frame.deviations, frame.correlations) = packed::<S>(&estimate.covariance);
        let seen = &estimate.observability;
        for (i, e) in AsMut::<[Fraction]>::as_mut(&mut frame.eigenvalues).iter_mut().enumerate() {
            *e = Fraction::new(0.5 * seen.eigenvalues[i]);
        }
        for (i, w) in AsMut::<[Fraction]>::as_mut(&mut frame.weakest).iter_mut().enumerate() {
            *w = Fraction::new(seen.directions.at(i, 0));
        }
        frame
    }

    /// Object to world, or `None` when a number is not finite.
    pub fn pose(&self) -> Option<S::Pose> {
        S::unpack_pose(self.pose)
    }

    /// Covariance of the pose in tangent coordinates, metres and radians.
    pub fn covariance(&self) -> S::Covariance {
        unpacked::<S>(&self.deviations, &self.correlations)
    }

    /// Eigenvalues of the observability, ascending, each in [0, 2].
    pub fn eigenvalues(&self) -> S::Tangent {
        let e = self.eigenvalues;
        S::Tangent::from_fn(|i| e.as_ref().get(i).map_or(0.0, |v| 2.0 * v.value()))
    }

    /// The direction this grasp saw least (see [`track::Observability::directions`]).
    pub fn weakest(&self) -> S::Tangent {
        let w = self.weakest;
        S::Tangent::from_fn(|i| w.as_ref().get(i).map_or(0.0, |v| v.value()))
    }

    /// Whether the grasp corrected the pose.
    pub fn corrected(&self) -> bool {
        self.flags & 1 != 0
    }

    /// Whether the particles were resampled.
    pub fn resampled(&self) -> bool {
        self.flags & 2 != 0
    }

    /// How much the estimate is worth; a status this version does not know counts as lost.
    pub fn status(&self) -> track::Status {
        match self.flags >> 2 & 7 {
            0 => track::Status::Started,
            1 => track::Status::Tracking,
            2 => track::Status::Predicted,
            3 => track::Status::Ambiguous,
            _ => track::Status::Lost,
        }
    }
}

/// One of the poses that the belief held possible after the last grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct ModeFrame<S: WireSpace> {
    /// Its number, 0 the heaviest.
    pub number: u8,
    /// How many there are.
    pub of: u8,
    /// Its share of the belief.
    pub weight: Fraction,
    /// Object to world.
    pub pose: S::Numbers,
}

impl<S: WireSpace> ModeFrame<S> {
    /// Packs the mode of this number; `None` where there are not so many.
    pub fn new(modes: &track::Modes<S>, number: u8) -> Option<Self> {
        let all = modes.as_slice();
        let mode = all.get(usize::from(number))?;
        Some(ModeFrame {
            number,
            of: all.len() as u8,
            weight: Fraction::new(mode.weight),
            pose: S::pack_pose(&mode.pose),
        })
    }

    /// The mode, or `None` when a number is not finite.
    pub fn mode(&self) -> Option<track::Mode<S>> {
        Some(track::Mode { pose: S::unpack_pose(self.pose)?, weight: self.weight.value() })
    }
}

/// What a board says of a face, in the object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceSummary<S: WireSpace> {
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// A point on the face, near the middle of its contacts, metres.
    pub centroid: S::Vector,
    /// Standard deviation along the normal there, metres.
    pub deviation: f32,
    /// Standard deviation of the normal, radians per axis.
    pub tilt: f32,
    /// Contacts it was fitted to.
    pub contacts: u16,
}

/// One face of the object, in the object frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct FaceFrame<S: WireSpace> {
    /// Its number, from 0.
    pub number: u8,
    /// How many there are.
    pub of: u8,
    /// Contacts it was fitted to, at most 65 535.
    pub contacts: u16,
    /// Unit, out of the object.
    pub normal: S::Normal,
    /// A point on the face, near the middle of its contacts, micrometres.
    pub centroid: S::Point,
    /// Standard deviation along the normal there, micrometres, at most 65 535.
    pub deviation: u16,
    /// Standard deviation of the normal, 10⁻⁴ radians per axis, at most 65 535.
    pub tilt: u16,
}

impl<S: WireSpace> FaceFrame<S> {
    /// Packs face `number` of so many.
    pub fn new(face: &FaceSummary<S>, number: u8, of: u8) -> Self {
        let counted = |v: f32| nearest(v).clamp(0, u16::MAX.into()) as u16;
        FaceFrame {
            number,
            of,
            contacts: face.contacts,
            normal: S::pack_normal(face.normal),
            centroid: S::pack_point(face.centroid),
            deviation: counted(face.deviation * 1e6),
            tilt: counted(face.tilt * 1e4),
        }
    }

    /// The face.
    pub fn face(&self) -> FaceSummary<S> {
        FaceSummary {
            normal: S::unpack_normal(self.normal),
            centroid: S::unpack_point(self.centroid),
            deviation: f32::from(self.deviation) * 1e-6,
            tilt: f32::from(self.tilt) * 1e-4,
            contacts: self.contacts,
        }
    }
}

/// Where the object is, as somebody else believes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct BeliefFrame<S: WireSpace> {
    /// Object to world.
    pub pose: S::Numbers,
    /// Standard deviations of the pose in tangent coordinates, metres and radians.
    pub deviations: S::Deviations,
    /// Correlations of the tangent coordinates, the lower triangle row by row.
    pub correlations: S::Correlations,
}

impl<S: WireSpace> BeliefFrame<S> {
    /// Packs a pose and its covariance.
    pub fn new(pose: &S::Pose, covariance: &S::Covariance) -> Self {
        let (deviations, correlations) = packed::<S>(covariance);
        BeliefFrame { pose: S::pack_pose(pose), deviations, correlations }
    }

    /// The pose and its covariance, or `None` when a number is not finite.
    pub fn belief(&self) -> Option<(S::Pose, S::Covariance)> {
        let finite = self.deviations.as_ref().iter().all(|d| d.is_finite());
        let pose = S::unpack_pose(self.pose).filter(|_| finite)?;
        Some((pose, unpacked::<S>(&self.deviations, &self.correlations)))
    }
}

/// Standard deviations and correlations of a covariance.
fn packed<S: WireSpace>(covariance: &S::Covariance) -> (S::Deviations, S::Correlations) {
    let deviation = |i| math::sqrt(covariance.at(i, i).max(0.0));
    let (mut deviations, mut correlations) = (S::Deviations::default(), S::Correlations::default());
    for (i, d) in AsMut::<[f32]>::as_mut(&mut deviations).iter_mut().enumerate() {
        *d = deviation(i);
    }
    let pairs = (0..S::FREEDOM).flat_map(|i| (0..i).map(move |j| (i, j)));
    for ((i, j), c) in pairs.zip(AsMut::<[Fraction]>::as_mut(&mut correlations)) {
        let scale = deviation(i) * deviation(j);
        *c = Fraction::new(if scale > 0.0 { covariance.at(i, j) / scale } else { 0.0 });
    }
    (deviations, correlations)
}

/// The covariance of standard deviations and correlations.
fn unpacked<S: WireSpace>(
    deviations: &S::Deviations,
    correlations: &S::Correlations,
) -> S::Covariance {
    let d = deviations.as_ref();
    let mut covariance = S::Covariance::ZERO;
    for (i, &deviation) in d.iter().enumerate() {
        *covariance.at_mut(i, i) = deviation * deviation;
    }
    let pairs = (0..S::FREEDOM).flat_map(|i| (0..i).map(move |j| (i, j)));
    for ((i, j), c) in pairs.zip(correlations.as_ref()) {
        let entry = c.value() * covariance_scale(d, i, j);
        *covariance.at_mut(i, j) = entry;
        *covariance.at_mut(j, i) = entry;
    }
    covariance
}

fn covariance_scale(deviations: &[f32], i: usize, j: usize) -> f32 {
    deviations.get(i).zip(deviations.get(j)).map_or(0.0, |(a, b)| a * b)
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
    /// Deviations must be finite, a contact's above zero and a motion's not below.
    Settings,
    /// This grasp already has a motion; the first one stays.
    MotionTwice,
    /// A number of the motion is not finite.
    Motion,
    /// The grasp holds as many contacts (or free points) as it can; those it has stay.
    Full,
    /// No grasp has been committed since the last reset.
    NoEstimate,
    /// There is no mode, face or finger of this number, or no candidate of the one before.
    NoSuch,
    /// A number of a belief or face cannot be used, or a face came before any belief.
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
    /// This part is not of the kind of sensor that was begun last for this finger.
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
            Refusal::Settings => "a standard deviation is not positive and finite",
            Refusal::MotionTwice => "the grasp already has a motion",
            Refusal::Motion => "the motion is not finite",
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
