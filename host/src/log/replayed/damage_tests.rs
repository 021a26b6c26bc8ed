//! What is left of recordings that lack pieces.

use tactile_core::space::Planar;
use tactile_core::wire::{Command, Decoder, Report};

use super::tests::{places, recorded};
use super::*;

/// A recording without some pieces, replayed.
fn without(recording: &Recording, lost: impl IntoIterator<Item = usize>) -> Replayed {
    let mut recording = recording.clone();
    let lost: Vec<usize> = lost.into_iter().collect();
    let mut place = 0..;
    recording.pieces.retain(|_| place.next().is_none_or(|at| !lost.contains(&at)));
    recording.replay()
}

/// Where the pieces with these reports are.
fn reports(recording: &Recording, is: impl Fn(&Report<Planar>) -> bool) -> Vec<usize> {
    let mut decoder = Decoder::<Report<Planar>>::new();
    let mut found = |piece: &Piece| {
        let (taken, _) = decoder.take(&piece.bytes);
        taken.is_some_and(|received| is(&received.unwrap().frame.message))
    };
    let pieces = recording.pieces.iter().enumerate();
    pieces.filter(|(_, p)| p.way == Direction::FromBoard && found(p)).map(|(at, _)| at).collect()
}

fn commits(recording: &Recording) -> Vec<usize> {
    places(recording, |command| matches!(command, Command::Commit))
}

fn estimates(recording: &Recording) -> Vec<usize> {
    reports(recording, |report| matches!(report, Report::Estimate(_)))
}

fn numbers(replayed: &Replayed) -> Vec<u64> {
    replayed.log.grasps.iter().map(|grasp| grasp.index).collect()
}

/// Every grasp has the board's number, its own contacts, and no motion but the true one since the grasp before
/// in the log.
fn assert_sound(replayed: &Replayed, clean: &Replayed, lost: &str) {
    let mut before: Option<usize> = None;
    for grasp in &replayed.log.grasps {
        let number = grasp.index as usize;
        let original = &clean.log.grasps[number];
        assert!(before.is_none_or(|before| before < number), "{lost}: {:?}", numbers(replayed));
        let own = |contact| original.contacts.contains(contact);
        assert!(grasp.contacts.iter().all(own), "{lost}: contacts of grasp {number}");
        if let (Some(before), Some(motion)) = (before, grasp.motion) {
            let between = &clean.log.grasps[before + 1..=number];
            let truth = between.iter().fold(Pose::identity(), |all, g| g.motion.unwrap() * all);
            let off = truth.inverse() * motion;
            let is_true = off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9;
            assert!(is_true, "{lost}: motion of grasp {number}");
        }
        before = Some(number);
    }
    for estimate in &replayed.estimates {
        let original = &clean.estimates[estimate.grasp as usize];
        assert_eq!((estimate.grasp, estimate.pose), (original.grasp, original.pose), "{lost}");
    }
    read_back(&replayed.log);
}

/// The log as a reader has it, which is strict.
fn read_back(log: &GraspLog) {
    let mut text = Vec::new();
    log.to_writer(&mut text).unwrap();
    GraspLog::parse(&text[..], "back".as_ref()).unwrap();
}

#[test]
fn a_whole_recording_leaves_nothing_out() {
    let clean = recorded().replay();
    assert_eq!(numbers(&clean), [0, 1, 2, 3]);
    assert_eq!(clean.left_out, LeftOut::default());
    assert_eq!(clean.left_out.sentences(), Vec::<String>::new());
}

#[test]
fn any_piece_that_is_lost_leaves_all_grasps_with_what_is_theirs() {
    let recording = recorded();
    let clean = recording.replay();
    let first = places(&recording, |command| matches!(command, Command::Contact(_)))[0];
    for at in first..recording.pieces.len() {
        let replayed = without(&recording, [at]);
        assert_sound(&replayed, &clean, &format!("piece {at}"));
        assert_eq!(numbers(&replayed), [0, 1, 2, 3], "piece {at}");
        assert_eq!(replayed.left_out.grasps, 0, "piece {at}");
    }
}

#[test]
fn any_two_pieces_that_are_lost_together_mix_no_grasps() {
    let recording = recorded();
    let clean = recording.replay();
    let first = places(&recording, |command| matches!(command, Command::Contact(_)))[0];
    for at in first..recording.pieces.len() - 1 {
        let replayed = without(&recording, [at, at + 1]);
        assert_sound(&replayed, &clean, &format!("pieces {at} and {}", at + 1));
        // Of the last commit and its estimate nothing tells.
        assert!(numbers(&replayed).starts_with(&[0, 1, 2]), "pieces {at} and {}", at + 1);
    }
}

#[test]
fn many_pieces_that_are_lost_mix_no_grasps() {
    let recording = recorded();
    let clean = recording.replay();
    let first = places(&recording, |command| matches!(command, Command::Contact(_)))[0];
    for start in first..recording.pieces.len() {
        for length in 3..40 {
            let replayed = without(&recording, start..start + length);
            assert_sound(&replayed, &clean, &format!("{length} pieces from {start}"));
        }
    }
}

#[test]
fn noise_that_was_lost_is_missed() {
    let recording = recorded();
    let [told] = places(&recording, |command| matches!(command, Command::Configure(_)))[..] else {
        panic!("configured once");
    };
    let replayed = without(&recording, [told]);
    assert_eq!(replayed.log.noise, Noise::default());
    assert_eq!(replayed.left_out, LeftOut { noise: true, ..LeftOut::default() });
    let said = "The noise that the board was told may have been lost: the log states none.";
    assert_eq!(replayed.left_out.sentences(), [said]);
    // Where something else was, it is there.
    assert!(!without(&recording, [told + 2]).left_out.noise);
}

#[test]
fn a_lost_commit_is_told_by_its_estimate() {
    let recording = recorded();
    let clean = recording.replay();
    for at in commits(&recording) {
        let replayed = without(&recording, [at]);
        assert_eq!(replayed.log.grasps, clean.log.grasps);
        assert_eq!(replayed.estimates, clean.estimates);
        assert_eq!(replayed.left_out, LeftOut::default());
    }
}

#[test]
fn a_lost_commit_without_its_estimate_is_told_by_the_next_number() {
    let recording = recorded();
    let clean = recording.replay();
    let replayed = without(&recording, [commits(&recording)[1], estimates(&recording)[1]]);
    assert_eq!(numbers(&replayed), [0, 1, 2, 3]);
    for (grasp, original) in replayed.log.grasps.iter().zip(&clean.log.grasps) {
        assert_eq!((grasp.motion, &grasp.contacts), (original.motion, &original.contacts));
    }
    let told: Vec<u32> = replayed.estimates.iter().map(|e| e.grasp).collect();
    assert_eq!(told, [0, 2, 3]);
    assert_eq!(replayed.left_out, LeftOut::default());
}

#[test]
fn a_commit_whose_answer_is_lost_with_the_next_commit_keeps_its_contacts() {
    let recording = recorded();
    let clean = recording.replay();
    let (commits, estimates) = (commits(&recording), estimates(&recording));
    for number in 0..3 {
        // What is left of the next grasp is the board's answer.
        let replayed = without(&recording, estimates[number]..=commits[number + 1]);
        assert_sound(&replayed, &clean, &format!("answer {number}"));
        assert_eq!(numbers(&replayed), [0, 1, 2, 3]);
        assert_eq!(replayed.log.grasps[number].contacts, clean.log.grasps[number].contacts);
        assert_eq!(replayed.left_out.motions, [number as u64 + 1]);
    }
}

#[test]
fn a_lost_estimate_costs_only_the_estimate() {
    let recording = recorded();
    let clean = recording.replay();
    for (number, at) in estimates(&recording).into_iter().enumerate() {
        let replayed = without(&recording, [at]);
        for (grasp, original) in replayed.log.grasps.iter().zip(&clean.log.grasps) {
            assert_eq!((grasp.motion, &grasp.contacts), (original.motion, &original.contacts));
        }
        assert_eq!(numbers(&replayed), [0, 1, 2, 3]);
        assert!(replayed.estimates.iter().all(|e| e.grasp as usize != number));
        assert_eq!(replayed.estimates.len(), 3);
    }
}

#[test]
fn a_lost_reply_costs_nothing() {
    let recording = recorded();
    let clean = recording.replay();
    for at in reports(&recording, |report| matches!(report, Report::Reply(_))) {
        let replayed = without(&recording, [at]);
        assert_eq!(replayed.log.noise, clean.log.noise);
        assert_eq!(replayed.log.grasps.len(), clean.log.grasps.len(), "piece {at}");
        for (grasp, original) in replayed.log.grasps.iter().zip(&clean.log.grasps) {
            assert_eq!((grasp.motion, &grasp.contacts), (original.motion, &original.contacts));
        }
        assert_eq!(replayed.left_out, LeftOut::default(), "piece {at}");
    }
}

#[test]
fn a_lost_contact_is_missed() {
    let recording = recorded();
    for at in places(&recording, |command| matches!(command, Command::Contact(_))) {
        let left_out = without(&recording, [at]).left_out;
        assert_eq!((left_out.grasps, left_out.contacts), (0, 1), "piece {at}");
        assert_eq!(left_out.sentences()[0], "1 contact that the board counted is left out.");
    }
}

#[test]
fn a_lost_motion_is_unknown() {
    let recording = recorded();
    let motions = places(&recording, |command| matches!(command, Command::Motion(_)));
    for &at in motions.iter().rev().take(3) {
        let number = commits(&recording).iter().filter(|commit| **commit < at).count() as u64;
        let replayed = without(&recording, [at]);
        assert_eq!(replayed.log.grasps[number as usize].motion, None);
        let expected = LeftOut { motions: vec![number], ..LeftOut::default() };
        assert_eq!(replayed.left_out, expected);
        let said = format!("The motion before grasp {number} is unknown.");
        assert_eq!(replayed.left_out.sentences(), [said]);
    }
}

#[test]
fn the_motion_since_a_grasp_that_is_not_there_is_unknown() {
    let recording = recorded();
    let clean = recording.replay();
    let motions = places(&recording, |command| matches!(command, Command::Motion(_)));
    let [second, .., last] = motions[motions.len() - 3..] else { panic!() };
    let replayed = without(&recording, second..last);
    assert_eq!(numbers(&replayed), [0, 3]);
    assert_eq!(replayed.log.grasps[1].motion, None);
    assert_eq!(replayed.log.grasps[1].contacts, clean.log.grasps[3].contacts);
    assert_eq!(replayed.left_out, LeftOut { grasps: 2, motions: vec![3], ..LeftOut::default() });
    let said =
        ["2 grasps that the board counted are left out.", "The motion before grasp 3 is unknown."];
    assert_eq!(replayed.left_out.sentences(), said);
}

#[test]
fn numbers_that_begin_anew_are_of_another_object() {
    let mut twice = recorded();
    let clean = twice.replay();
    let mut again = twice.pieces.clone();
    again.remove(places(&twice, |command| matches!(command, Command::Configure(_)))[0]);
    twice.pieces.extend(again);
    let replayed = twice.replay();
    assert_eq!(numbers(&replayed), [0, 1, 2, 3]);
    for (grasp, original) in replayed.log.grasps.iter().zip(&clean.log.grasps) {
        assert_eq!((grasp.motion, &grasp.contacts), (original.motion, &original.contacts));
    }
    assert_eq!(replayed.estimates.len(), 4);
}

#[test]
fn of_many_unknown_motions_some_are_named() {
    let left_out = LeftOut { motions: (1..10).collect(), ..LeftOut::default() };
    let said = ["The motion before grasps 1, 2, 3, 4, 5, 6 and 3 more is unknown."];
    assert_eq!(left_out.sentences(), said);
}
