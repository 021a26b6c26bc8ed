use std::boxed::Box;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::contact::{Contact, GraspView};
use crate::explore::Stroke;
use crate::matrix::{Coordinates, Square, Vector};
use crate::space::{Planar, PlanarPose, Pose};

use crate::surface::Truncated;
use crate::track::{Bootstrap, Estimate, Hypotheses, Modes, Observability, RaoBlackwell, Status};
use crate::wire::{BeliefFrame, CandidateFrame, ContactFrame};

/// Composes the motions and counts what it is given.
struct Counting {
    pose: PlanarPose,
    grasps: u32,
    seed: u64,
    noise: MotionNoise,
    prepared: u32,
}

impl Counting {
    fn new() -> Self {
        Counting {
            pose: PlanarPose::IDENTITY,
            grasps: 0,
            seed: 0,
            noise: MotionNoise { translation: 0.0, rotation: 0.0 },
            prepared: 0,
        }
    }
}

impl Tracker<Planar> for Counting {
    fn update(
        &mut self,
        motion: Option<&PlanarPose>,
        grasp: GraspView<'_, Planar>,
    ) -> Estimate<Planar> {
        if let Some(motion) = motion {
            self.pose = motion.compose(&self.pose);
        }
        self.grasps += 1;
        Estimate {
            grasp: self.grasps - 1,
            pose: self.pose,
            covariance: Square::ZERO,
            status: Status::Tracking,
            modes: Modes::one(self.pose),
            effective_particles: self.seed as f32,
            observability: Observability::NONE,
            contacts: grasp.contacts.len() as u16,
            rejected: grasp.free.len() as u16,
            dropped: 0,
            corrected: true,
            resampled: false,
        }
    }

    fn reset(&mut self, seed: u64) {
        self.pose = PlanarPose::IDENTITY;
        self.grasps = 0;
        self.seed = seed;
    }

    fn set_motion_noise(&mut self, noise: MotionNoise) {
        self.noise = noise;
    }
}

impl Onboard<Planar> for Counting {
    const MAP: usize = 40;
    const PARTICLES: usize = 300;
    const KIND: TrackerKind = TrackerKind::Hypotheses;

    fn face(&self, number: u8) -> Option<(FaceSummary<Planar>, u8)> {
        let face = FaceSummary {
            normal: Vector([0.6, -0.8]),
            centroid: Vector([0.012, -0.016]),
            deviation: 2e-4,
            tilt: 0.01,
            contacts: 7,
        };
        (number < 2).then_some((face, 2))
    }

    fn prepare(&mut self) {
        self.prepared += 1;
    }
}

/// Keeps what is sent; every look at the clock takes a microsecond.
#[derive(Default)]
struct Bench {
    clock: u32,
    sent: Vec<u8>,
}

impl Board for Bench {
    const KIND: BoardKind = BoardKind::Virtual;

    fn now(&mut self) -> u32 {
        self.clock += 1;
        self.clock
    }

    fn receive(&mut self, _: &mut [u8], _: bool) -> usize {
        0
    }

    fn send(&mut self, bytes: &[u8]) {
        self.sent.extend_from_slice(bytes);
    }

    fn vitals(&mut self) -> Vitals {
        Vitals { overruns: 1, peak_stack: 2, stack: 3 }
    }
}

struct Rig {
    device: Device<Counting, Planar, 3>,
    board: Bench,
    decoder: Decoder<Report<Planar>>,
    next: u8,
}

impl Rig {
    /// A device that has just started.
    fn cold() -> Self {
        Rig {
            device: Device::new(Counting::new()),
            board: Bench::default(),
            decoder: Decoder::new(),
            next: 0,
        }
    }

    /// A device that has been greeted.
    fn new() -> Self {
        let mut rig = Rig::cold();
        rig.send(0, Command::Hello { protocol: PROTOCOL });
        rig
    }

    fn send(&mut self, sequence: u8, message: Command<Planar>) -> Vec<Report<Planar>> {
        let mut buffer = [0; MAX_FRAME];
        let frame = Frame { sequence, time: Clock(0), message };
        self.device.take(encode(&frame, &mut buffer).unwrap(), &mut self.board);
        self.reports()
    }

    fn reports(&mut self) -> Vec<Report<Planar>> {
        let sent = std::mem::take(&mut self.board.sent);
        sent.iter()
            .filter_map(|&b| self.decoder.push(b))
            .map(|r| r.unwrap().frame.message)
            .collect()
    }

    fn say(&mut self, message: Command<Planar>) -> Vec<Report<Planar>> {
        self.next += 1;
        self.send(self.next, message)
    }

    fn health(&mut self) -> Health {
        match self.say(Command::Query(Topic::Health))[..] {
            [Report::Health(health), Report::Reply(Reply { refusal: None, .. })] => health,
            ref other => panic!("{other:?}"),
        }
    }
}

fn motion(x: f32) -> Command<Planar> {
    Command::Motion(crate::wire::MotionFrame::new(&PlanarPose::new(Vector([x, 0.0]), 0.0)))
}

fn contact() -> Command<Planar> {
    Command::Contact(crate::wire::ContactFrame::new(
        &Contact {
            point: Vector([0.1, 0.2]),
            normal: None,
            point_deviation: 1e-3,
            normal_deviation: 0.1,
            finger: 0,
        },
        0.1,
    ))
}

fn done(to: u8) -> Report<Planar> {
    Report::Reply(Reply { to, refusal: None })
}

fn refused(to: u8, refusal: Refusal) -> Report<Planar> {
    Report::Reply(Reply { to, refusal: Some(refusal) })
}

#[test]
fn introduces_itself() {
    let mut rig = Rig::cold();
    rig.device.announce(&mut rig.board);
    let unasked = rig.reports();
    let asked = rig.send(9, Command::Hello { protocol: PROTOCOL });
    let [Report::Hello(hello), reply] = asked[..] else { panic!("{asked:?}") };
    assert_eq!((unasked, reply), (std::vec![Report::Hello(hello)], done(9)));
    assert_eq!((hello.dimension, hello.contacts, hello.map, hello.particles), (2, 3, 40, 300));
    // Asked again with the number it was asked with, it answers again.
    assert_eq!(rig.send(9, Command::Hello { protocol: PROTOCOL }), asked);
}

#[test]
fn a_board_that_has_started_obeys_nobody_before_a_greeting() {
    let mut rig = Rig::cold();
    assert_eq!(rig.say(Command::Commit), [refused(1, Refusal::NotGreeted)]);
    assert_eq!(rig.say(Command::Ping), [refused(2, Refusal::NotGreeted)]);
    assert_eq!(rig.device.tracker.grasps, 0);
    rig.say(Command::Hello { protocol: PROTOCOL });
    assert_eq!(rig.say(Command::Ping), [done(4)]);
}

#[test]
fn refuses_another_version_by_name() {
    let mut rig = Rig::new();
    let answer = rig.send(4, Command::Hello { protocol: PROTOCOL + 1 });
    assert!(matches!(answer[0], Report::Hello(Hello { protocol: PROTOCOL, .. })));
    assert_eq!(answer[1], refused(4, Refusal::Version));
}

#[test]
fn a_grasp_is_collected_and_answered() {
    let mut rig = Rig::new();
    let settings = Settings { seed: 77, ..Settings::DEFAULT };
    assert_eq!(rig.say(Command::Configure(settings)), [done(1)]);
    assert_eq!(rig.device.tracker.noise, MotionNoise::THESIS);
    for (n, x) in [(0, 0.25), (1, 0.5)] {
        rig.say(motion(x));
        rig.say(contact());
        rig.say(contact());
        rig.say(Command::Free(crate::wire::FreeFrame { finger: 0, point: [1, 2] }));
        let answer = rig.say(Command::Commit);
        let [Report::Estimate(e), Report::Health(h), Report::Reply(_)] = answer[..] else {
            panic!("{answer:?}")
        };
        assert_eq!((e.grasp, e.contacts, e.rejected, e.effective_particles), (n, 2, 1, 77));
        assert_eq!(e.pose().unwrap().translation()[0], if n == 0 { 0.25 } else { 0.75 });
        assert_eq!((h.grasps, h.update, h.peak_stack, h.overruns), (n + 1, 1, 2, 1));
        let again = rig.say(Command::Query(Topic::Estimate));
        assert_eq!(again[0], Report::Estimate(e));
    }
    let Report::Mode(mode) = rig.say(Command::Query(Topic::Mode(0)))[0] else { panic!() };
    assert_eq!((mode.number, mode.of), (0, 1));
    let mode = mode.mode().unwrap();
    assert_eq!((mode.weight, mode.pose.translation()[0]), (1.0, 0.75));
    let Report::Face(face) = rig.say(Command::Query(Topic::Face(1)))[0] else { panic!() };
    assert_eq!((face.number, face.of, face.contacts), (1, 2, 7));
    assert_eq!((face.deviation, face.tilt), (200, 100));
    let face = face.face();
    assert!((face.normal - Vector([0.6, -0.8])).norm() < 1e-4);
    assert_eq!(face.centroid, Vector([0.012, -0.016]));
    for topic in [Topic::Mode(1), Topic::Face(2)] {
        let to = rig.next + 1;
        assert_eq!(rig.say(Command::Query(topic)), [refused(to, Refusal::NoSuch)]);
    }
    rig.say(Command::Reset);
    assert_eq!((rig.device.tracker.grasps, rig.device.tracker.prepared), (0, 1));
    let to = rig.next + 1;
    assert_eq!(rig.say(Command::Query(Topic::Mode(0))), [refused(to, Refusal::NoSuch)]);
    let to = rig.next + 1;
    assert_eq!(rig.say(Command::Query(Topic::Estimate)), [refused(to, Refusal::NoEstimate)]);
}

#[test]
fn what_is_sent_twice_is_obeyed_once() {
    let mut rig = Rig::new();
    rig.send(1, motion(0.5));
    assert_eq!(rig.send(1, motion(0.5)), [done(1)]);
    rig.send(2, contact());
    rig.send(2, contact());
    let first = rig.send(3, Command::Commit);
    let before = rig.device.tracker.grasps;
    assert_eq!(rig.send(3, Command::Commit), first);
    // Late or long past: no answer, nothing done.
    assert_eq!(rig.send(2, contact()), []);
    assert_eq!(rig.send(255, Command::Reset), []);
    assert_eq!(rig.device.tracker.grasps, before);
    let Report::Estimate(e) = first[0] else { panic!("{first:?}") };
    assert_eq!(e.contacts, 1);
}

#[test]
fn nonsense_is_refused_and_counted() {
    let mut rig = Rig::new();
    let bad = Settings { point: 0.0, ..Settings::DEFAULT };
    assert_eq!(rig.say(Command::Configure(bad)), [refused(1, Refusal::Settings)]);
    assert_eq!(rig.say(motion(f32::NAN)), [refused(2, Refusal::Motion)]);
    assert_eq!(rig.say(motion(0.5)), [done(3)]);
    assert_eq!(rig.say(motion(7.0)), [refused(4, Refusal::MotionTwice)]);
    for n in 5..8 {
        assert_eq!(rig.say(contact()), [done(n)]);
    }
    assert_eq!(rig.say(contact()), [refused(8, Refusal::Full)]);
    let committed = rig.say(Command::Commit);
    let Report::Estimate(e) = committed[0] else { panic!("{committed:?}") };
    assert_eq!((e.contacts, e.pose().unwrap().translation()[0]), (3, 0.5));
    // Nothing felt, nothing moved: the tracker decides what an empty grasp means.
    let empty = rig.say(Command::Commit);
    assert!(matches!(empty[0], Report::Estimate(e) if e.grasp == 1 && e.contacts == 0));
    let health = rig.health();
    assert_eq!((health.refused, health.overfull, health.empty, health.grasps), (4, 1, 1, 2));
}

/// Whether a tracker read out of memory that is all zero is a new one.
macro_rules! assert_zero {
    ($($new:expr => $tracker:ty),+ $(,)?) => {$({
        let new: Box<$tracker> = Box::new($new);
        // SAFETY: made of numbers, booleans, options and arrays of them, for which zero bits are a
        // value; that they are the right one is what is asserted.
        #[allow(unsafe_code)]
        let zero: Box<$tracker> = unsafe { Box::new_zeroed().assume_init() };
        assert!(std::format!("{new:?}") == std::format!("{zero:?}"), stringify!($tracker));
    })+};
}

/// Such a board takes no flash for its statics.
#[test]
fn zero_bits_are_a_new_tracker() {
    assert_zero!(
        Bootstrap::new(Truncated::new()) => PlanarTracker,
        Bootstrap::new(Truncated::new()) => SpatialTracker,
        Hypotheses::new() => PlanarHypotheses,
        Hypotheses::new() => SpatialHypotheses,
        RaoBlackwell::new() => PlanarRaoBlackwell,
        RaoBlackwell::new() => SpatialRaoBlackwell,
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn noise_is_survived_and_counted(noise in proptest::collection::vec(any::<u8>(), 0..600)) {
        let mut rig = Rig::new();
        rig.send(1, motion(0.5));
        rig.device.take(&noise, &mut rig.board);
        rig.device.take(&[0], &mut rig.board);
        rig.reports();
        prop_assert_eq!(rig.send(2, Command::Ping), [done(2)]);
        let health = rig.send(3, Command::Query(Topic::Health));
        let Report::Health(health) = health[0] else { panic!("{health:?}") };
        let pieces = noise.split(|&b| b == 0).filter(|p| !p.is_empty()).count();
        prop_assert_eq!(health.received.damaged() as usize, pieces);
    }
}

#[test]
fn a_host_that_knows_better_is_believed() {
    let mut device = Box::new(PlanarHypothesesDevice::START);
    let mut board = Bench::default();
    let mut decoder = Decoder::<Report<Planar>>::new();
    let mut next = 0;
    let mut say = |message: Command<Planar>| -> Vec<Report<Planar>> {
        let mut buffer = [0; MAX_FRAME];
        let frame = Frame { sequence: next, time: Clock(0), message };
        next += 1;
        board.sent.clear();
        device.take(encode(&frame, &mut buffer).unwrap(), &mut board);
        let frames = board.sent.iter().filter_map(|b| decoder.push(*b));
        frames.map(|f| f.unwrap().frame.message).collect()
    };
    let refused = |answer: &[Report<Planar>]| match answer.last() {
        Some(Report::Reply(reply)) => reply.refusal,
        other => panic!("{other:?}"),
    };
    say(Command::Hello { protocol: PROTOCOL });
    let pose = PlanarPose::new(Vector([0.2, 0.1]), 0.5);
    let covariance = crate::matrix::Matrix([[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-4]]);
    let face = |x: f32, y: f32| {
        let face = FaceSummary {
            normal: Vector([x, y]),
            centroid: Vector([0.05 * x, 0.03 * y]),
            deviation: 2e-4,
            tilt: 0.01,
            contacts: 7,
        };
        FaceFrame::new(&face, 0, 4)
    };
    // A face before any belief has no frame to be in.
    assert_eq!(refused(&say(Command::Face(face(1.0, 0.0)))), Some(Refusal::Belief));
    let belief = BeliefFrame::new(&pose, &covariance);
    assert_eq!(refused(&say(Command::Believe(belief))), None);
    for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
        assert_eq!(refused(&say(Command::Face(face(x, y)))), None);
    }
    let mut bad = belief;
    bad.deviations[0] = f32::NAN;
    assert_eq!(refused(&say(Command::Believe(bad))), Some(Refusal::Belief));
    // The board has the faces, and finds the next grasp on them.
    let told = say(Command::Query(Topic::Face(2)));
    let Report::Face(third) = told[0] else { panic!("{told:?}") };
    assert_eq!((third.of, third.face().contacts), (4, 7));
    let moved = PlanarPose::new(Vector([0.204, 0.098]), 0.6);
    for (x, y) in [(1.0f32, 0.0f32), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
        let contact = Contact {
            point: moved.transform(Vector([0.05 * x - 0.01 * y, 0.03 * y + 0.01 * x])),
            normal: Some(moved.rotate(Vector([x, y]))),
            point_deviation: 1e-3,
            normal_deviation: Settings::DEFAULT.normal,
            finger: 0,
        };
        say(Command::Contact(ContactFrame::new(&contact, Settings::DEFAULT.normal)));
    }
    let answer = say(Command::Commit);
    let Report::Estimate(estimate) = answer[0] else { panic!("{answer:?}") };
    let apart = moved.local(&estimate.pose().unwrap());
    assert!(apart.norm() < 0.02, "{apart:?}");
    assert_eq!((estimate.status(), estimate.grasp), (Status::Tracking, 0));
    assert!(matches!(say(Command::Query(Topic::Estimate))[0], Report::Estimate(_)));
    // Of another object frame than what is told next.
    assert_eq!(refused(&say(Command::Believe(belief))), None);
    assert_eq!(refused(&say(Command::Query(Topic::Estimate))), Some(Refusal::NoEstimate));
}

/// A pinch of two fingers from both sides along `along`, about the world's origin.
fn pinch(along: [f32; 2]) -> Candidate<Planar> {
    let along = Vector(along);
    let mut pinch = Candidate::new(PlanarPose::IDENTITY);
    for (finger, side) in [1.0, -1.0].into_iter().enumerate() {
        let start = along * (0.1 * side);
        pinch.strokes[finger] = Some(Stroke { start, direction: along * -side, travel: 0.1 });
    }
    pinch
}

fn consider(number: u8, candidate: &Candidate<Planar>) -> Command<Planar> {
    Command::Consider(CandidateFrame::new(number, candidate).unwrap())
}

/// Says something to a board, and what it answers.
struct Talk<T, const CONTACTS: usize> {
    device: Box<Device<T, Planar, CONTACTS>>,
    board: Bench,
    decoder: Decoder<Report<Planar>>,
    next: u8,
}

impl<T: Onboard<Planar>, const CONTACTS: usize> Talk<T, CONTACTS> {
    fn new(device: Device<T, Planar, CONTACTS>) -> Self {
        let (device, decoder) = (Box::new(device), Decoder::new());
        let mut talk = Talk { device, board: Bench::default(), decoder, next: 0 };
        talk.say(Command::Hello { protocol: PROTOCOL });
        talk
    }

    fn say(&mut self, message: Command<Planar>) -> Vec<Report<Planar>> {
        let mut buffer = [0; MAX_FRAME];
        let frame = Frame { sequence: self.next, time: Clock(0), message };
        self.next = self.next.wrapping_add(1);
        self.board.sent.clear();
        self.device.take(encode(&frame, &mut buffer).unwrap(), &mut self.board);
        let frames = self.board.sent.iter().filter_map(|b| self.decoder.push(*b));
        frames.map(|f| f.unwrap().frame.message).collect()
    }

    fn refusal(&mut self, message: Command<Planar>) -> Option<Refusal> {
        match self.say(message).last() {
            Some(Report::Reply(reply)) => reply.refusal,
            other => panic!("{other:?}"),
        }
    }

    fn choice(&mut self, criterion: Criterion) -> Result<ChoiceFrame, Refusal> {
        match self.say(Command::Query(Topic::BestCandidate(criterion)))[..] {
            [Report::Choice(choice), Report::Reply(Reply { refusal: None, .. })] => Ok(choice),
            [Report::Reply(Reply { refusal: Some(refusal), .. })] => Err(refusal),
            ref other => panic!("{other:?}"),
        }
    }

    /// A slab of 40 mm that was felt above and below.
    fn feel(&mut self) {
        for (x, y) in [(-0.01, 1.0f32), (0.01, 1.0), (-0.01, -1.0), (0.01, -1.0)] {
            let contact = Contact {
                point: Vector([x, 0.02 * y]),
                normal: Some(Vector([0.0, y])),
                point_deviation: 1e-3,
                normal_deviation: Settings::DEFAULT.normal,
                finger: 0,
            };
            let frame = ContactFrame::new(&contact, Settings::DEFAULT.normal);
            assert_eq!(self.refusal(Command::Contact(frame)), None);
        }
        self.say(Command::Commit);
    }
}

fn a_board_chooses<T: Onboard<Planar>>(device: Device<T, Planar, 16>) {
    let mut talk = Talk::new(device);
    let (felt, untouched) = (pinch([0.0, 1.0]), pinch([1.0, 0.0]));
    let steady = Settings { translation: 1e-3, rotation: 0.02, ..Settings::DEFAULT };
    talk.say(Command::Configure(steady));
    assert_eq!(talk.choice(Criterion::Information), Err(Refusal::NoCandidate));
    assert_eq!(talk.refusal(consider(0, &felt)), None);
    assert_eq!(talk.choice(Criterion::Information), Err(Refusal::NoShape));
    // What is felt is about another belief than the list was.
    talk.feel();
    assert_eq!(talk.choice(Criterion::Information), Err(Refusal::NoCandidate));
    assert_eq!(talk.refusal(consider(0, &felt)), None);
    let alone = talk.choice(Criterion::Information).unwrap();
    assert_eq!((alone.number, alone.considered, alone.contacts), (0, 1, 2));
    assert_eq!(talk.refusal(consider(1, &untouched)), None);
    for criterion in [Criterion::Information, Criterion::VarianceSum] {
        let choice = talk.choice(criterion).unwrap();
        assert_eq!((choice.number, choice.considered, choice.criterion), (1, 2, criterion));
        assert!(choice.gain.is_finite() && choice.gain > 0.0);
        assert_eq!(talk.choice(criterion), Ok(choice));
    }
    let choice = talk.choice(Criterion::Information).unwrap();
    assert!(choice.gain > alone.gain);

    // A gap, more than there is room for, one that cannot be: the list stays as it was.
    assert_eq!(talk.refusal(consider(3, &felt)), Some(Refusal::NoSuch));
    let mut bad = CandidateFrame::new(1, &felt).unwrap();
    bad.hand[0] = f32::NAN;
    assert_eq!(talk.refusal(Command::Consider(bad)), Some(Refusal::Candidate));
    bad = CandidateFrame::new(1, &felt).unwrap();
    bad.strokes = [None; 5];
    assert_eq!(talk.refusal(Command::Consider(bad)), Some(Refusal::Candidate));
    assert_eq!(talk.choice(Criterion::Information), Ok(choice));
    for number in 2..16 {
        assert_eq!(talk.refusal(consider(number, &felt)), None);
    }
    assert_eq!(talk.refusal(consider(16, &untouched)), Some(Refusal::TooMany));
    let of_sixteen = talk.choice(Criterion::Information).unwrap();
    assert_eq!((of_sixteen.number, of_sixteen.considered), (1, 16));
    assert_eq!(of_sixteen.gain, choice.gain);
    // The first of equals, and a replaced one counts as it is now.
    assert_eq!(talk.refusal(consider(1, &felt)), None);
    let equal = talk.choice(Criterion::Information).unwrap();
    assert_eq!((equal.number, equal.gain), (0, alone.gain));

    // Number 0 begins anew; what misses the object is worth nothing and is chosen if it must be.
    let mut miss = pinch([1.0, 0.0]);
    miss.hand = PlanarPose::new(Vector([0.0, 0.7]), 0.0);
    assert_eq!(talk.refusal(consider(0, &miss)), None);
    let missed = talk.choice(Criterion::Information).unwrap();
    assert_eq!((missed.number, missed.considered), (0, 1));
    assert_eq!((missed.contacts, missed.gain), (0, 0.0));
    // A motion that has been told moves the object under the hand.
    let motion = PlanarPose::new(Vector([0.0, 0.7]), 0.0);
    talk.say(Command::Motion(crate::wire::MotionFrame::new(&motion)));
    assert!(talk.choice(Criterion::Information).unwrap().gain > alone.gain);
    talk.say(Command::Reset);
    assert_eq!(talk.choice(Criterion::Information), Err(Refusal::NoCandidate));
}

#[test]
fn hypotheses_choose_where_nothing_was_touched() {
    a_board_chooses(PlanarHypothesesDevice::START);
}

#[test]
fn a_map_chooses_where_nothing_was_touched() {
    a_board_chooses(PlanarDevice::START);
}

#[test]
fn a_tracker_without_foresight_says_so() {
    let mut talk = Talk::new(Device::<_, Planar, 3>::new(Counting::new()));
    assert_eq!(talk.refusal(consider(0, &pinch([1.0, 0.0]))), None);
    assert_eq!(talk.choice(Criterion::Information), Err(Refusal::NoForesight));
}

#[test]
fn a_tracker_without_faces_says_so() {
    let mut rig = Rig::new();
    let pose = PlanarPose::IDENTITY;
    let belief = BeliefFrame::new(&pose, &crate::matrix::Matrix([[0.0; 3]; 3]));
    let answer = rig.say(Command::Believe(belief));
    assert!(matches!(
        answer.last(),
        Some(Report::Reply(Reply { refusal: Some(Refusal::Fixed), .. }))
    ));
}
