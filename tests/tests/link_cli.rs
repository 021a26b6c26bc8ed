//! `tactile live`, `replay` and `inspect` on recordings: what they write, and what they refuse.

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use clap::Parser;
use tactile_core::space::{Planar, Spatial};
use tactile_host::cli::Cli;
use tactile_host::log::GraspLog;
use tactile_host::log::inspection::inspect_recording;
use tactile_tests::Sample;

/// Runs `tactile` with words in which `@` stands for the folder.
fn tactile(folder: &Path, line: &str) -> ExitCode {
    let words = line.split(' ').map(|w| w.replace('@', &format!("{}/", folder.display())));
    Cli::parse_from(std::iter::once("tactile".to_owned()).chain(words)).run()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn live_and_back<S: Sample>() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    S::log(8).write(&here.join("log.jsonl")).unwrap();
    let line = "live --port virtual --log @log.jsonl --record @live.tac --out @out --seed 4 --json";
    assert_eq!(tactile(here, line), ExitCode::SUCCESS);
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(here.join("out/report.json")).unwrap()).unwrap();
    assert_eq!((&report["grasps"], &report["contacts"]), (&8.into(), &40.into()));
    assert_eq!(report["tracker"], "auto on the board");
    let worst = report["pose"]["rms_translation_mm"].as_f64().unwrap();
    assert!(worst < 6.0, "{worst}");

    let inspection = inspect_recording(&here.join("live.tac")).unwrap();
    assert_eq!((inspection.torn, inspection.damaged), (0, 0));
    assert_eq!(inspection.replayed.estimates.len(), 8);
    assert_eq!(inspection.replayed.health.unwrap().grasps, 8);
    let said = inspection.to_string();
    assert!(said.contains("8 grasps, 40 contacts, 8 estimates"), "{said}");
    assert_eq!(inspection.to_json()["contacts"], 40);
    assert_eq!(tactile(here, "inspect @live.tac"), ExitCode::SUCCESS);

    assert_eq!(tactile(here, "replay @live.tac -o @back.jsonl"), ExitCode::SUCCESS);
    let back = GraspLog::read(&here.join("back.jsonl")).unwrap();
    assert_eq!((back.dimension, back.grasps.len()), (S::DIMENSION, 8));
    assert!(back.grasps[7].unknown.contains_key("estimate"));
    assert_eq!(tactile(here, "replay @live.tac --to csv -o @back.csv"), ExitCode::SUCCESS);
    assert_eq!(fs::read_to_string(here.join("back.csv")).unwrap().lines().count(), 9);

    // One file for viewers from the recording with its estimates, one from the log without any.
    for (from, mcap, estimated) in
        [("live.tac", "tac.mcap", true), ("log.jsonl", "log.mcap", false)]
    {
        let line = format!("replay @{from} --to mcap -o @{mcap}");
        assert_eq!(tactile(here, &line), ExitCode::SUCCESS);
        let file = fs::read(here.join(mcap)).unwrap();
        assert!(file.ends_with(b"\x89MCAP0\r\n"));
        // The summary at the end names the topics.
        let has = |topic: &[u8]| file.windows(topic.len()).any(|w| w == topic);
        assert_eq!((has(b"/contacts"), has(b"/pose_with_covariance")), (true, estimated), "{from}");
    }
    assert_eq!(tactile(here, "replay @log.jsonl --to csv -o @no.csv"), ExitCode::from(2));

    // Fed again, the log that came back gives the same trajectory.
    let again = "live --port virtual --log @back.jsonl --out @again --seed 4";
    assert_eq!(tactile(here, again), ExitCode::SUCCESS);
    let poses = |out: &str| {
        let text = fs::read_to_string(here.join(out).join("trajectory.tum")).unwrap();
        let pose = |line: &str| line.split_once(' ').map(|(_, pose)| pose.to_owned());
        text.lines().filter(|l| !l.starts_with('#')).map(pose).collect::<Vec<_>>()
    };
    assert_eq!(poses("out"), poses("again"));

    // A crash in the middle leaves a recording that replays up to there.
    let bytes = fs::read(here.join("live.tac")).unwrap();
    fs::write(here.join("cut.tac"), &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(tactile(here, "replay @cut.tac -o @cut.jsonl"), ExitCode::SUCCESS);
    let cut = GraspLog::read(&here.join("cut.jsonl")).unwrap().grasps.len();
    assert!((2..8).contains(&cut), "{cut}");
    assert_eq!(cut, inspect_recording(&here.join("cut.tac")).unwrap().replayed.estimates.len());
}

#[test]
fn a_planar_log_goes_through_a_board_and_back() {
    live_and_back::<Planar>();
}

#[test]
fn a_spatial_log_goes_through_a_board_and_back() {
    live_and_back::<Spatial>();
}

#[test]
fn bad_input_is_refused_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    Planar::log(2).write(&here.join("log.jsonl")).unwrap();
    fs::write(here.join("noise.tac"), [1, 2, 3, 0, 4, 5]).unwrap();
    fs::write(here.join("empty.tac"), []).unwrap();
    let before = names(here);
    for line in [
        "live --port virtual --log @missing.jsonl --out @out",
        "live --port virtual --log @noise.tac --out @out",
        "live --port virtual --log @log.jsonl --record @no/such/folder.tac --out @out",
        "live --port virtual --log @log.jsonl --record @out/report.json --out @out",
        "reproduce tracking --first-seed 18446744073709551615 --seeds 2",
        "replay @noise.tac -o @back.jsonl",
        "replay @empty.tac -o @back.jsonl",
        "replay @missing.tac -o @back.jsonl",
        "inspect @noise.tac",
        "inspect @missing.tac",
    ] {
        assert_eq!(tactile(here, line), ExitCode::from(2), "{line}");
        assert_eq!(names(here), before, "{line}");
    }
    for line in ["live --port serial:x", "live --port tcp:7000", "live"] {
        let words = std::iter::once("tactile").chain(line.split(' '));
        assert_eq!(Cli::try_parse_from(words).unwrap_err().exit_code(), 2, "{line}");
    }
}

#[test]
fn a_port_where_nobody_listens_fails_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    Planar::log(2).write(&here.join("log.jsonl")).unwrap();
    let free = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap();
    let line = format!("live --port tcp:{free} --log @log.jsonl --record @live.tac --out @out");
    assert_eq!(tactile(here, &line), ExitCode::FAILURE);
    assert_eq!(names(here), ["log.jsonl"]);
    // An old recording stays as it is.
    fs::write(here.join("live.tac"), "precious").unwrap();
    assert_eq!(tactile(here, &line), ExitCode::FAILURE);
    assert_eq!(names(here), ["live.tac", "log.jsonl"]);
    assert_eq!(fs::read(here.join("live.tac")).unwrap(), b"precious");
}
