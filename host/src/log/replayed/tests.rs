//! What recordings tell, damaged ones too.

use proptest::prelude::*;
use tactile_core::wire::{Clock, Frame, MAX_FRAME, TrackerKind, encode};

use super::*;
use crate::link::session::settings_for;
use crate::link::{Patience, Recorder, Session, virtual_board};
use crate::sim::{Options, simulate};

proptest! {
    #[test]
    fn numbers_have_the_fewest_digits(bits in any::<u32>(), near in -2.0f32..2.0) {
        for value in [f32::from_bits(bits), near, near * 1e-3] {
            let expected: f64 = value.to_string().parse().unwrap();
            prop_assert!(shortest(value).to_bits() == expected.to_bits() || value.is_nan(), "{value}");
        }
    }
}

#[test]
fn round_numbers_stay_round() {
    for (value, expected) in
        [(0.001f32, 0.001), (0.0, 0.0), (-0.25, -0.25), (1e-9, 1e-9), (0.0873, 0.0873)]
    {
        assert_eq!(shortest(value), expected);
    }
}

/// A few grasps of a planar object through a board, every frame a piece.
pub(super) fn recorded() -> Recording {
    recorded_with(|settings| settings)
}

/// The same with the board told other settings than the log's.
fn recorded_with(change: impl Fn(Settings) -> Settings) -> Recording {
    let object = "rectangle:0.10x0.06".parse().unwrap();
    let log = simulate(&Options { grasps: Some(4), ..Options::new(object) }).unwrap().log;
    let mut bytes = Vec::new();
    let header = Header::new(2, log.fingers.clone(), String::new());
    let board = virtual_board::start(2, TrackerKind::Bootstrap).unwrap();
    let link = Recorder::new(board, &mut bytes, &header).unwrap();
    let session = Session::<Planar, _>::open(link, Patience::default()).unwrap();
    session.run(&log, change(settings_for(&log, 0)), |_, _| ()).unwrap();
    Recording::parse(&bytes).unwrap()
}

/// Where the pieces with these commands are.
pub(super) fn places(recording: &Recording, is: impl Fn(&Command<Planar>) -> bool) -> Vec<usize> {
    let mut decoder = Decoder::<Command<Planar>>::new();
    let mut found = |piece: &Piece| {
        let (taken, _) = decoder.take(&piece.bytes);
        taken.is_some_and(|received| is(&received.unwrap().frame.message))
    };
    let pieces = recording.pieces.iter().enumerate();
    pieces.filter(|(_, p)| p.way == Direction::ToBoard && found(p)).map(|(at, _)| at).collect()
}

/// Damages the first frame of the answer to a grasp's commit; the host sends the commit again, if it does,
/// and is answered again.
fn miss_the_first(recording: &mut Recording, grasp: usize, is_sent_again: bool) {
    let at = places(recording, |command| matches!(command, Command::Commit))[grasp];
    let pieces = &mut recording.pieces;
    let from_board = |piece: &&Piece| piece.way == Direction::FromBoard;
    let answer: Vec<Piece> = pieces[at + 1..].iter().take_while(from_board).cloned().collect();
    let mut again = pieces[at].clone();
    again.bytes.insert(0, 0);
    let damaged = &mut pieces[at + 1].bytes[6];
    *damaged = if *damaged == 1 { 2 } else { *damaged ^ 1 };
    if is_sent_again {
        let end = at + 1 + answer.len();
        pieces.splice(end..end, std::iter::once(again).chain(answer));
    }
}

#[test]
fn an_estimate_that_comes_when_the_commit_is_sent_again_is_that_grasps() {
    let clean = recorded().replay();
    for grasp in 0..4 {
        let mut bad = recorded();
        miss_the_first(&mut bad, grasp, true);
        let replayed = bad.replay();
        assert_eq!(replayed.from_board.damaged(), 1);
        assert_eq!(replayed.log.grasps.len(), 4, "grasp {grasp}");
        for (a, b) in replayed.log.grasps.iter().zip(&clean.log.grasps) {
            assert_eq!((&a.motion, &a.contacts, &a.unknown), (&b.motion, &b.contacts, &b.unknown));
        }
        let numbers: Vec<u32> = replayed.estimates.iter().map(|e| e.grasp).collect();
        assert_eq!(numbers, [0, 1, 2, 3]);
    }
}

#[test]
fn a_grasp_without_an_answer_is_kept() {
    let clean = recorded().replay();
    let mut bad = recorded();
    miss_the_first(&mut bad, 1, false);
    let replayed = bad.replay();
    assert_eq!(replayed.log.grasps.len(), 4);
    let told: Vec<bool> =
        replayed.log.grasps.iter().map(|g| g.unknown.contains_key("estimate")).collect();
    assert_eq!(told, [true, false, true, true]);
    assert_eq!(replayed.log.grasps[1].motion, clean.log.grasps[1].motion);
    assert_eq!(replayed.log.grasps[1].contacts, clean.log.grasps[1].contacts);
    assert_eq!(replayed.estimates.len(), 3);
}

#[test]
fn a_contact_of_the_boards_that_comes_with_the_second_answer_is_that_grasps() {
    let mut recording = recorded();
    let logged = recording.replay().log.grasps[1].contacts.len();
    let at = places(&recording, |command| matches!(command, Command::Commit))[1];
    let contact = places(&recording, |command| matches!(command, Command::Contact(_)))[0];
    let mut decoder = Decoder::<Command<Planar>>::new();
    let (taken, _) = decoder.take(&recording.pieces[contact].bytes);
    let Command::Contact(felt) = taken.unwrap().unwrap().frame.message else { panic!() };
    let mut buffer = [0; MAX_FRAME];
    let frame = Frame { sequence: 200, time: Clock(0), message: Report::<Planar>::Felt(felt) };
    let bytes = encode(&frame, &mut buffer).unwrap().to_vec();
    let piece = Piece { bytes, ..recording.pieces[at + 1].clone() };
    recording.pieces.insert(at + 1, piece);
    miss_the_first(&mut recording, 1, true);
    let grasps = recording.replay().log.grasps;
    assert_eq!(grasps[1].contacts.len(), logged + 1);
    assert_eq!(grasps[1].contacts.last().unwrap().point, grasps[0].contacts[0].point);
    assert_eq!(grasps[2].contacts.len(), logged);
}

/// The log as a reader has it, which is strict.
fn read_back(log: &GraspLog) -> GraspLog {
    let mut text = Vec::new();
    log.to_writer(&mut text).unwrap();
    GraspLog::parse(&text[..], "back".as_ref()).unwrap()
}

#[test]
fn a_board_told_that_motions_are_exact_leaves_a_log_that_is_read() {
    let exact = |settings| Settings { translation: 0.0, rotation: 0.0, ..settings };
    let replayed = recorded_with(exact).replay();
    let noise = read_back(&replayed.log).noise;
    assert_eq!(noise.translation, Some(Noise::LEAST_TRANSLATION));
    assert_eq!(noise.rotation, Some(Noise::LEAST_ROTATION));
    assert!(noise.point.is_some() && noise.normal.is_some());
}

#[test]
fn times_that_run_backwards_leave_a_log_that_is_read() {
    let mut recording = recorded();
    let count = recording.pieces.len() as u64;
    for (piece, number) in recording.pieces.iter_mut().zip(1..) {
        // Once from the start again.
        let number = if number > count / 2 { number - count / 2 } else { number };
        piece.time = Duration::from_secs(number);
    }
    let replayed = recording.replay();
    let back = read_back(&replayed.log);
    let times: Vec<f64> = back.grasps.iter().map(|g| g.time.unwrap()).collect();
    assert!(times.is_sorted() && times[3] > times[1], "{times:?}");
    // The step back takes no time.
    assert_eq!(replayed.duration.as_secs(), count - 1);
    assert!(replayed.estimates.is_sorted_by_key(|e| e.time));
}
