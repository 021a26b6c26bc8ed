//! Frames across a link: a virtual board, faults, recordings.

use std::time::Duration;

use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::{Refusal, Settings, TrackerKind};
use tactile_host::link::session::settings_for;
use tactile_host::link::{
    Faults, Faulty, Link, LogOutcome, Patience, Recorder, Session, SessionError, virtual_board,
};
use tactile_host::log::recording::{Header, Recording};
use tactile_tests::Sample;

fn quick() -> Patience {
    const NONE: Duration = Duration::ZERO;
    Patience { greeting: NONE, reply: NONE, update: NONE, attempts: 60 }
}

fn run<S: Sample>(link: impl Link, grasps: usize) -> LogOutcome<S> {
    let log = S::log(grasps);
    let session = Session::<S, _>::open(link, quick()).unwrap();
    session.run(&log, settings_for(&log, 7), |_, _| ()).unwrap()
}

fn board<S: Sample>() -> Box<dyn Link> {
    virtual_board::start(S::DIMENSION, TrackerKind::Bootstrap).unwrap()
}

fn estimates<S: Sample>(outcome: &LogOutcome<S>) -> Vec<tactile_core::wire::EstimateFrame<S>> {
    outcome.grasps.iter().map(|g| g.estimate).collect()
}

fn tracks<S: Sample>(tolerance: f64) {
    let outcome = run::<S>(board::<S>(), 8);
    let log = S::log(8);
    let poses = outcome.poses();
    assert_eq!(poses.len(), 8);
    // The object frame is fixed by the first grasp.
    let gauge = log.grasps[0].truth.unwrap().inverse() * poses[0];
    for (grasp, pose) in log.grasps.iter().zip(&poses) {
        let truth = grasp.truth.unwrap() * gauge;
        let error = (truth.translation.vector - pose.translation.vector).norm();
        assert!(error < tolerance, "grasp {}: {error}", grasp.index);
    }
    assert!(outcome.grasps[1..].iter().all(|g| g.estimate.corrected() && g.estimate.contacts == 5));
    assert_eq!((outcome.repeated, outcome.received.damaged()), (0, 0));
}

#[test]
fn a_virtual_board_tracks_in_the_plane() {
    tracks::<Planar>(0.006);
}

#[test]
fn a_virtual_board_tracks_in_space() {
    tracks::<Spatial>(0.006);
}

fn survives_faults<S: Sample>() {
    let clean = run::<S>(board::<S>(), 4);
    let faults = Faults { drop: 0.06, corrupt: 0.06, double: 0.06, reorder: 0.06 };
    for seed in 0..8 {
        let mut link = Faulty::new(board::<S>(), faults, seed);
        let outcome = {
            let log = S::log(4);
            let session = Session::<S, _>::open(&mut link, quick()).unwrap();
            session.run(&log, settings_for(&log, 7), |_, _| ()).unwrap()
        };
        assert!(link.injected() > 10, "{}", link.injected());
        assert!(outcome.repeated > 0);
        assert_eq!(estimates(&outcome), estimates(&clean), "seed {seed}");
        let health = outcome.grasps.last().unwrap().health;
        assert_eq!((health.grasps, health.refused), (4, 0), "seed {seed}");
    }
}

#[test]
fn faults_change_nothing_but_time_in_the_plane() {
    survives_faults::<Planar>();
}

#[test]
fn faults_change_nothing_but_time_in_space() {
    survives_faults::<Spatial>();
}

#[test]
fn a_dead_line_ends_with_a_message() {
    let faults = Faults { drop: 1.0, ..Faults::default() };
    let patience = Patience { attempts: 3, ..quick() };
    let dead = Faulty::new(board::<Planar>(), faults, 0);
    let error = Session::<Planar, _>::open(dead, patience).err().unwrap();
    assert!(matches!(error, SessionError::Silent { command: "hello", attempts: 3, .. }), "{error}");
    assert!(error.to_string().contains("3 times"), "{error}");
}

#[test]
fn the_wrong_board_is_named() {
    let error = Session::<Planar, _>::open(board::<Spatial>(), quick()).err().unwrap();
    assert!(matches!(error, SessionError::Dimension { board: 3, log: 2 }), "{error}");
    let session = Session::<Planar, _>::open(board::<Planar>(), quick()).unwrap();
    let error = session.run(&Spatial::log(1), Settings::DEFAULT, |_, _| ()).unwrap_err();
    assert!(matches!(error, SessionError::Dimension { board: 2, log: 3 }), "{error}");
}

#[test]
fn settings_that_cannot_be_are_refused() {
    let mut session = Session::<Planar, _>::open(board::<Planar>(), quick()).unwrap();
    let settings = Settings { point: f32::NAN, ..Settings::DEFAULT };
    let error = session.configure(settings).unwrap_err();
    assert!(matches!(error, SessionError::Refused { refusal: Refusal::Settings, .. }), "{error}");
    session.ping().unwrap();
    assert_eq!(session.health().unwrap().refused, 1);
}

#[test]
fn more_contacts_than_fit_are_counted_and_left_out() {
    let mut log = Planar::log(2);
    let contact = log.grasps[1].contacts[0].clone();
    log.grasps[1].contacts.resize(10_000, contact);
    log.grasps[0].contacts.clear();
    let session = Session::<Planar, _>::open(board::<Planar>(), quick()).unwrap();
    let outcome = session.run(&log, settings_for(&log, 1), |_, _| ()).unwrap();
    let room = usize::from(outcome.hello.contacts);
    assert_eq!(outcome.grasps[1].not_sent, 10_000 - room);
    assert_eq!(usize::from(outcome.grasps[1].estimate.contacts), room);
    assert_eq!((outcome.grasps[1].health.empty, outcome.grasps[1].health.overfull), (1, 0));
}

/// What a recording gives back is what was fed: to the micrometre, and whatever the line did.
fn records<S: Sample>(faults: Faults) {
    let log = S::log(5);
    let header = Header::new(log.dimension, log.fingers.clone(), log.description.clone());
    let mut file = Vec::new();
    let link = Faulty::new(board::<S>(), faults, 3);
    let recorder = Recorder::new(link, &mut file, &header).unwrap();
    let session = Session::<S, _>::open(recorder, quick()).unwrap();
    let outcome = session.run(&log, settings_for(&log, 7), |_, _| ()).unwrap();

    let recording = Recording::parse(&file).unwrap();
    assert_eq!((recording.torn, recording.damaged, &recording.header), (0, 0, &header));
    let replayed = recording.replay();
    assert_eq!(replayed.hello, Some(outcome.hello));
    assert_eq!(replayed.from_board, outcome.received);
    assert_eq!(replayed.to_board.doubled, outcome.repeated);
    assert_eq!(replayed.log.grasps.len(), 5);
    for (recorded, logged) in replayed.log.grasps.iter().zip(&log.grasps) {
        assert_eq!(recorded.index, logged.index);
        assert_eq!((recorded.contacts.len(), recorded.free.len()), (5, 1));
        assert_eq!(recorded.motion.is_some(), logged.motion.is_some());
        for (a, b) in recorded.contacts.iter().zip(&logged.contacts) {
            assert_eq!(a.finger, b.finger);
            assert!((a.point - b.point).norm() < 1.5e-6);
            assert!((a.normal.unwrap() - b.normal.unwrap()).norm() < 1e-4);
            assert_eq!(a.normal_noise.is_some(), b.normal_noise.is_some());
        }
    }
    let poses: Vec<_> = replayed.estimates.iter().map(|e| e.pose).collect();
    assert_eq!(poses, outcome.poses());

    // The recorded log, fed again, gives the same estimates to the bit.
    let again = Session::<S, _>::open(board::<S>(), quick())
        .unwrap()
        .run(&replayed.log, settings_for(&replayed.log, 7), |_, _| ())
        .unwrap();
    assert_eq!(estimates(&again), estimates(&outcome));

    let mut csv = Vec::new();
    replayed.write_csv(&mut csv).unwrap();
    let csv = String::from_utf8(csv).unwrap();
    let columns: Vec<usize> = csv.lines().map(|l| l.split(',').count()).collect();
    assert_eq!(columns, [if log.dimension == 2 { 15 } else { 22 }; 6]);
}

#[test]
fn recordings_hold_everything() {
    records::<Planar>(Faults::default());
    records::<Spatial>(Faults::default());
}

#[test]
fn recordings_of_a_bad_line_hold_everything() {
    let faults = Faults { drop: 0.05, corrupt: 0.05, double: 0.05, reorder: 0.05 };
    records::<Planar>(faults);
    records::<Spatial>(faults);
}

/// A virtual board that loses its power once, after so many frames from the host.
struct Unplugged {
    board: Box<dyn Link>,
    left: u32,
}

impl Link for Unplugged {
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        if self.left == 0 {
            self.board = board::<Planar>();
        }
        self.left = self.left.wrapping_sub(1);
        self.board.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        self.board.receive(bytes, timeout)
    }
}

#[test]
fn a_board_that_restarts_is_noticed() {
    for left in 2..20 {
        let link = Unplugged { board: board::<Planar>(), left };
        let session = Session::<Planar, _>::open(link, quick()).unwrap();
        let log = Planar::log(3);
        let error = session.run(&log, settings_for(&log, 1), |_, _| ()).unwrap_err();
        assert!(matches!(error, SessionError::Restarted { .. }), "{left}: {error}");
    }
}
