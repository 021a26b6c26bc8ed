use std::fs;

use tactile_core::space::Planar;
use tactile_core::wire::TrackerKind;

use super::*;
use crate::link::session::settings_for;
use crate::link::{Patience, Recorder, Session, virtual_board};
use crate::log::GraspLog;
use crate::view::scene::{Packed, Seven, seven};

fn bundled() -> GraspLog {
    let text = include_str!("../../assets/bundled.jsonl");
    GraspLog::parse(text.as_bytes(), "bundled".as_ref()).unwrap()
}

/// The bundled log through the board's code, and the poses that came back.
fn recorded() -> (Vec<u8>, Vec<Pose>) {
    let log = bundled();
    let mut bytes = Vec::new();
    let header = Header::new(2, log.fingers.clone(), String::new());
    let board = virtual_board::start(2, TrackerKind::Hypotheses).unwrap();
    let link = Recorder::new(board, &mut bytes, &header).unwrap();
    let session = Session::<Planar, _>::open(link, Patience::default()).unwrap();
    let outcome = session.run(&log, settings_for(&log, 0), |_, _| ()).unwrap();
    (bytes, outcome.poses())
}

fn scene_of(bytes: &[u8]) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.tac");
    fs::write(&path, bytes).unwrap();
    Recorded::read(&path, &|_, _| ()).unwrap().scene()
}

#[test]
fn a_recording_shows_what_the_board_made_of_it() {
    let (bytes, poses) = recorded();
    let scene = scene_of(&bytes);
    assert_eq!(scene.meta.title, "session.tac");
    assert_eq!(scene.meta.missing, Vec::<String>::new());
    assert_eq!(scene.meta.grasps, Some(10));
    assert_eq!(scene.meta.tracker.as_deref(), Some("hypotheses on the board"));
    let shown: Vec<Seven> = scene.grasps.iter().map(|g| g.pose.unwrap()).collect();
    assert_eq!(shown, poses.iter().map(seven).collect::<Vec<_>>());
    assert!(scene.grasps.iter().all(|g| g.touched == 5 && g.contacts.0.len() == 30));
    assert!(scene.grasps[1..].iter().all(|g| g.deviations.is_some() && g.entropy.is_none()));
    // The block is a triangle of some ten centimetres.
    let last = scene.surfaces.last().unwrap();
    assert_eq!(last.after, 9);
    let wide = |axis| {
        let all = last.shape.vertices.0.iter().skip(axis).step_by(3);
        all.clone().fold(f32::MIN, |a, &b| a.max(b)) - all.fold(f32::MAX, |a, &b| a.min(b))
    };
    assert!(
        (0.08..0.2).contains(&wide(0)) && (0.08..0.2).contains(&wide(1)),
        "{} {}",
        wide(0),
        wide(1)
    );
    assert!(scene.surfaces.is_sorted_by_key(|s| s.after) && scene.surfaces.len() > 3);
}

#[test]
fn what_a_damaged_recording_lacks_is_said() {
    let (bytes, _) = recorded();
    let cut = scene_of(&bytes[..bytes.len() * 2 / 3]);
    assert!(cut.grasps.len() < 10 && !cut.grasps.is_empty());
    assert!(cut.meta.missing[0].contains("ends within a piece"), "{:?}", cut.meta.missing);

    let mut bad = bytes.clone();
    let middle = bytes.len() / 2;
    bad[middle] ^= 0x55;
    let said = scene_of(&bad).meta.missing.join(" ");
    assert!(said.contains("damaged pieces are left out"), "{said}");

    let header = bytes.iter().position(|&b| b == 0).unwrap() + 1;
    let empty = scene_of(&bytes[..header]);
    assert_eq!(empty.meta.missing, ["There is no whole grasp in the recording."]);
    assert!(empty.grasps.is_empty() && empty.surfaces.is_empty());
}

#[test]
fn a_recording_becomes_a_film_with_its_surface_growing() {
    let (bytes, poses) = recorded();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.tac");
    fs::write(&path, &bytes).unwrap();
    let mut film = Vec::new();
    let recorded = Recorded::film(&path, &mut film, &|_, _| ()).unwrap();
    assert_eq!((recorded.count, recorded.missing), (10, vec![]));
    let mut times: std::collections::BTreeMap<String, Vec<u64>> = Default::default();
    for message in ::mcap::MessageStream::new(&film).unwrap() {
        let message = message.unwrap();
        times.entry(message.channel.topic.clone()).or_default().push(message.log_time);
    }
    for topic in ["/contacts", "/pose", "/pose_with_covariance"] {
        assert_eq!(times[topic].len(), poses.len(), "{topic}");
        assert!(times[topic].is_sorted());
    }
    // Each with the last grasp it is made of, and the last at the end.
    let surfaces = &times["/surface"];
    assert!(surfaces.len() > 3 && surfaces.is_sorted(), "{surfaces:?}");
    assert!(surfaces[0] < times["/pose"][5]);
    assert_eq!(surfaces.last(), times["/pose"].last());
    // Contacts are coloured from the first grasp to the last, though nobody said how many would come.
    let reds: Vec<u8> = contacts_of(&film).iter().map(|data| red(data)).collect();
    assert!(reds[0] > 0xe0 && reds[9] < 0x50 && reds.is_sorted_by(|a, b| a >= b), "{reds:x?}");
    // When the board begins anew, contacts of the object before are taken away, and its grasps stay.
    let header = bytes.iter().position(|&b| b == 0).unwrap() + 1;
    let twice = [&bytes[..], &bytes[header..]].concat();
    fs::write(&path, twice).unwrap();
    let mut again = Vec::new();
    let recorded = Recorded::film(&path, &mut again, &|_, _| ()).unwrap();
    assert_eq!(recorded.count, 10, "of the last object");
    assert_eq!(contacts_of(&again).len(), 20);
    // Without a grasp there is no film.
    fs::write(&path, &bytes[..header]).unwrap();
    let mut none = Vec::new();
    let error = Recorded::film(&path, &mut none, &|_, _| ()).unwrap_err();
    assert!(error.to_string().contains("at least one whole grasp") && none.is_empty());
    // A disk that is full is told.
    struct Full;
    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    fs::write(&path, &bytes).unwrap();
    match Recorded::film(&path, Full, &|_, _| ()) {
        Err(FilmError::Film(error)) => assert_eq!(error.kind(), io::ErrorKind::StorageFull),
        other => panic!("{other:?}"),
    }
}

#[test]
fn grasps_that_were_lost_among_very_many_take_no_others_along() {
    let grasp = |number: u64| {
        let is_lost = number % 20 == 7;
        // What a lost one felt is far away.
        let x = if is_lost { 9.0 } else { 0.05 };
        Grasp {
            grasp: number,
            merged: 1,
            pose: Some(seven(&Pose::identity())),
            status: Some(if is_lost { "lost" } else { "tracking" }),
            touched: 1,
            contacts: Packed(vec![x, 0.0, 0.0, 1.0, 0.0, 0.0]),
            fingers: Packed(vec![0]),
            ..Grasp::default()
        }
    };
    for count in [200, 20_000] {
        let mut timeline = Timeline::default();
        (0..count).for_each(|number| timeline.push(grasp(number)));
        let (grasps, mut placed) = (timeline.into_grasps(), Vec::new());
        for (at, grasp) in grasps.iter().enumerate() {
            placed_contacts(&mut placed, at, grasp, &Noise::default());
        }
        let mut felt: Vec<usize> = placed.iter().map(|p| p.grasp).collect();
        felt.dedup();
        assert!(20 * felt.len() >= 19 * grasps.len(), "{} of {}", felt.len(), grasps.len());
        assert!(placed.iter().all(|p| p.contact.point.x < 0.1));
    }
}

/// The messages of `/contacts`.
fn contacts_of(film: &[u8]) -> Vec<Vec<u8>> {
    let messages = ::mcap::MessageStream::new(film).unwrap().map(Result::unwrap);
    messages.filter(|m| m.channel.topic == "/contacts").map(|m| m.data.to_vec()).collect()
}

/// How red the first of the five points is: 44 bytes each, before the byte that ends the message.
fn red(cloud: &[u8]) -> u8 {
    cloud[cloud.len() - 1 - 5 * 44 + 24 + 2]
}
