//! Runs keep what they read, notice early where they cannot write, and say what became of the rest.

use std::fmt::Write as _;
use std::process::{Command, Stdio};

use tactile_host::log::GraspLog;

use crate::binary::Place;

#[test]
fn results_of_another_object_do_not_stay_beside_new_ones() {
    let place = Place::new();
    place.tactile("simulate --object sphere:0.08 --grasps 2 -o ball.jsonl").done();
    place.tactile("simulate --object hexagon:0.05 --grasps 2 -o hexagon.jsonl").done();
    place.tactile("slam ball.jsonl --poses truth --mesh stl,obj --out o").done();
    place.put("o/shape.txt", "mine");
    place.tactile("slam ball.jsonl --poses truth --mesh obj --out o").done();
    let there = |name: &str| place.at("o").join(name).exists();
    assert!(there("shape.ply") && there("shape.obj") && !there("shape.stl"));
    place.tactile("slam hexagon.jsonl --poses truth --out o").done();
    assert!(there("contour.csv") && !there("shape.ply") && !there("shape.obj"));
    place.tactile("slam ball.jsonl --poses truth --out o").done();
    assert!(there("shape.ply") && !there("contour.csv") && there("shape.txt"));
    // Files of such names in a folder without a report are somebody else's.
    std::fs::create_dir(place.at("p")).unwrap();
    place.put("p/shape.obj", "mine");
    place.put("p/log.ply", "mine");
    place.tactile("slam ball.jsonl --poses truth --out p").done();
    std::fs::remove_file(place.at("p/report.json")).unwrap();
    let explore = "explore --object rectangle:0.12x0.06 --max-actions 2 --seed 1 --out p";
    place.tactile(explore).done();
    for name in ["shape.obj", "log.ply"] {
        assert_eq!(std::fs::read(place.at("p").join(name)).unwrap(), b"mine", "{name}");
    }
    // True meshes that runs write are theirs.
    for object in ["sphere:0.08", "box:0.1x0.06x0.05"] {
        let explore = format!("explore --object {object} --max-actions 1 --seed 1 --out e");
        place.tactile(&explore).done();
    }
}

/// Each is said once, whatever else there is to say.
#[test]
fn what_meshes_logs_and_graphs_lack_is_said() {
    let place = Place::new();
    place.tactile("simulate --object box:0.12x0.06x0.05 --grasps 3 -o box.jsonl").done();
    let run = place.tactile("slam box.jsonl --graph planes --out r").done();
    run.says(&["3 grasps, expected 8 at least: --graph planes corrects nothing"]);
    let quiet = place.tactile("slam box.jsonl --out r").done();
    assert!(!quiet.err.contains("--graph"), "{}", quiet.err);

    let mut open = String::from("OFF\n4 3 0\n0 0 0\n0.1 0 0\n0 0.1 0\n0 0 0.1\n");
    open += "3 0 2 1\n3 0 1 3\n3 0 3 2\n";
    place.put("open.off", open);
    let doubt = "open.off: the mesh is no closed surface whose triangles all face out: 3 edges";
    let simulate = "simulate --object open.off --touch uniform --grasps 2 -o open.jsonl";
    place.tactile(simulate).done().says(&[doubt]);
    place.tactile("localize --model open.off open.jsonl").done().says(&[doubt]);
    place
        .tactile("slam open.jsonl --poses truth --out r")
        .done()
        .says(&["the true shape: the mesh is"]);
    // A mesh beside a log that nobody simulated.
    place.put("mine.ply", "mine");
    place
        .tactile("simulate --object sphere:0.08 --grasps 2 -o mine.jsonl")
        .refused(&["mine.ply is there already and no true mesh of mine.jsonl"]);
    assert_eq!(std::fs::read(place.at("mine.ply")).unwrap(), b"mine");
    place
        .tactile("explore --object sphere:0.0005 --out r")
        .refused(&["the hand closed on nothing"]);
}

#[test]
fn what_is_read_is_not_written_over() {
    let place = Place::new();
    place.tactile("simulate --object hexagon:0.05 --grasps 2 -o a.jsonl").done();
    place.put("a.csv", "x,y\n0.1,0\n0,0.1\n-0.1,0\n");
    place.put("a.off", "OFF\n1 0 0\n1 2 3\n");
    std::fs::create_dir(place.at("o")).unwrap();
    place.tactile("simulate --object sphere:0.08 --grasps 2 -o o/shape.jsonl").done();
    place.tactile("live --port virtual --log a.jsonl --record a.tac --out live").done();
    let files = ["a.jsonl", "a.csv", "a.off", "a.tac", "o/shape.ply"];
    let contents = || files.map(|name| std::fs::read(place.at(name)).unwrap());
    let before = contents();
    for (line, file) in [
        ("replay a.tac -o a.tac", "a.tac"),
        ("replay a.jsonl --to html -o ./a.jsonl", "a.jsonl"),
        ("replay a.jsonl --to mcap -o o/../a.jsonl", "a.jsonl"),
        ("import csv a.csv -o a.csv", "a.csv"),
        ("import off a.off -o a.off", "a.off"),
        ("simulate --object polygon:a.csv -o a.csv", "a.csv"),
        ("live --port virtual --log a.jsonl --record a.jsonl --out live", "a.jsonl"),
        ("live --port virtual --log o/shape.jsonl --record o/shape.ply", "o/shape.ply"),
        ("replay o/shape.jsonl --to html -o o/shape.ply", "o/shape.ply"),
        ("replay o/shape.jsonl -o o/../o/shape.ply", "o/shape.ply"),
        ("slam o/shape.jsonl --out o", "o/shape.ply"),
        ("explore --object o/shape.ply --out o", "o/shape.ply"),
    ] {
        place.tactile(line).refused(&[file, "is read and would be replaced"]);
    }
    assert_eq!(contents(), before);
    let same = "live --port virtual --log a.jsonl --record l --out ./l";
    place.tactile(same).refused(&["--record: l is the folder of the results"]);
}

#[test]
fn a_replay_that_nobody_named_replaces_nothing() {
    let place = Place::new();
    place.tactile("simulate --object hexagon:0.05 --grasps 2 -o a.jsonl").done();
    place.tactile("replay a.jsonl --to html").done();
    let page = std::fs::read(place.at("a.html")).unwrap();
    place.tactile("simulate --object hexagon:0.05 --grasps 3 -o a.jsonl").done();
    place.tactile("replay a.jsonl --to html").refused(&["a.html", "such a file", "--output"]);
    place.tactile("replay a.jsonl").refused(&["a.jsonl", "such a file"]);
    assert_eq!(std::fs::read(place.at("a.html")).unwrap(), page);
}

/// A device that takes nothing.
#[cfg(target_os = "linux")]
#[test]
fn what_is_not_written_is_said() {
    let place = Place::new();
    place.tactile("simulate --object hexagon:0.05 --grasps 2 -o a.jsonl").done();
    let run = |line: &str, out: Stdio| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactile"));
        command.args(line.split(' ')).current_dir(place.at(".")).stdout(out).output().unwrap()
    };
    let full = || Stdio::from(std::fs::File::options().write(true).open("/dev/full").unwrap());
    for line in ["inspect a.jsonl", "inspect a.jsonl --json", "slam a.jsonl --poses truth --json"] {
        let output = run(line, full());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}: {error}");
        assert!(error.contains("standard output: cannot write"), "{line}: {error}");
    }
    // A reader that has gone has what it wanted.
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    assert!(run("inspect a.jsonl", writer.into()).status.success());

    // Without all results there is no report, not even the one of the run before.
    assert!(place.at("out/report.json").exists());
    std::fs::remove_file(place.at("out/summary.svg")).unwrap();
    std::os::unix::fs::symlink("/dev/full", place.at("out/summary.svg")).unwrap();
    let output = run("slam a.jsonl --poses truth", Stdio::null());
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("out/summary.svg: cannot write"), "{error}");
    assert!(!place.at("out/report.json").exists());
}

/// No folder takes files there, whoever asks.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_takes_no_files_is_noticed_before_the_work() {
    let place = Place::new();
    for out in ["/proc", "/proc/none/of/these"] {
        for line in [
            "slam --bundled prism",
            "explore --object sphere:0.08",
            "live --port virtual --record r.tac",
        ] {
            place.tactile(&format!("{line} --out {out}")).refused(&["/proc: cannot write"]);
        }
    }
}

#[test]
fn a_mark_of_the_encoding_is_no_content() {
    let place = Place::new();
    let marked = |text: &str| format!("\u{feff}{text}");
    place.tactile("simulate --object box:0.1x0.06x0.06 --grasps 2 -o a.jsonl").done();
    let log = std::fs::read_to_string(place.at("a.jsonl")).unwrap();
    place.put("b.jsonl", marked(&log));
    assert_eq!(
        GraspLog::read(&place.at("a.jsonl")).unwrap(),
        GraspLog::read(&place.at("b.jsonl")).unwrap()
    );

    let edge = |from: u32, to: u32| format!("EDGE_SE2 {from} {to} 1 0 0 1 0 0 1 0 1\n");
    place.put("g.g2o", marked(&(edge(0, 1) + &edge(1, 2))));
    let run = place.tactile("optimize g.g2o --json").done();
    assert_eq!((&run.json()["edges"], run.err.as_str()), (&2.into(), ""));

    place.put("points.off", marked("OFF\n1 0 0\n1 2 3\n"));
    place.tactile("import off points.off -o points.jsonl").done();
    let mut solid = String::from("OFF\n4 4 6\n0 0 0\n0.1 0 0\n0 0.1 0\n0 0 0.1\n");
    solid += "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";
    place.put("solid.off", marked(&solid));
    place.tactile("simulate --object solid.off --touch uniform -o solid.jsonl").done();

    let mut push = String::from("1\n");
    write!(push, "1 2 3").unwrap();
    place.put("p.txt", marked(&push));
    // The count is read; what lacks is the push.
    place.tactile("import push p.txt -o p.jsonl").refused(&["push 0 of 1"]);
}

#[test]
fn lengths_without_their_unit_are_doubted() {
    let place = Place::new();
    let mut table = String::from("x,y,z,nx,ny,nz\n");
    for k in 0..30 {
        let (sin, cos) = (2.4 * f64::from(k)).sin_cos();
        let z = (f64::from(k) - 14.5) / 15.0;
        let r = (1.0 - z * z).sqrt();
        let (x, y) = (r * cos, r * sin);
        writeln!(table, "{},{},{},{x},{y},{z}", 30.0 * x, 30.0 * y, 30.0 * z).unwrap();
    }
    place.put("ball.csv", table);
    let doubt = "are they metres, or does a unit such as mm lack?";
    for (unit, is_doubted) in [("m", true), ("mm", false)] {
        let import = "import csv ball.csv --contact-noise 1mm,5deg --fixed -o ball.jsonl --unit";
        place.tactile(&format!("{import} {unit}")).done();
        for line in ["slam ball.jsonl --poses truth", "live --port virtual --log ball.jsonl"] {
            let run = place.tactile(line).done();
            assert_eq!(run.err.contains(doubt), is_doubted, "{line}, {unit}: {}", run.err);
        }
    }
    place.tactile("simulate --object sphere:0.06 --grasps 2 -o s.jsonl").done();
    let ball = std::fs::read_to_string(place.at("s.jsonl")).unwrap();
    assert!(ball.contains("s.ply"));
    let near = place.tactile("localize --model s.ply ball.jsonl").done();
    assert!(!near.err.contains(doubt), "{}", near.err);
    place.tactile("import csv ball.csv --contact-noise 1mm,5deg --fixed -o far.jsonl").done();
    place.tactile("localize --model s.ply far.jsonl").done().says(&[doubt]);
}

#[test]
fn normals_that_point_inwards_are_doubted() {
    let place = Place::new();
    place.tactile("simulate --object rectangle:0.12x0.06 --grasps 3 --seed 3 -o out.jsonl").done();
    let log = std::fs::read_to_string(place.at("out.jsonl")).unwrap();
    let mut turned = String::new();
    for line in log.lines() {
        let mut line: serde_json::Value = serde_json::from_str(line).unwrap();
        for contact in line["contacts"].as_array_mut().into_iter().flatten() {
            for x in contact["normal"].as_array_mut().into_iter().flatten() {
                *x = (-x.as_f64().unwrap()).into();
            }
        }
        writeln!(turned, "{line}").unwrap();
    }
    place.put("in.jsonl", turned);
    for (log, is_doubted) in [("out", false), ("in", true)] {
        for line in [format!("inspect {log}.jsonl"), format!("slam {log}.jsonl --poses truth")] {
            let run = place.tactile(&line).done();
            assert_eq!(run.err.contains("out of the object"), is_doubted, "{line}: {}", run.err);
        }
    }
}

#[test]
fn a_damaged_log_shows_what_is_sound_and_fails() {
    let place = Place::new();
    place.tactile("simulate --object hexagon:0.05 --grasps 3 -o a.jsonl").done();
    let log = std::fs::read_to_string(place.at("a.jsonl")).unwrap();
    place.put("cut.jsonl", &log[..log.len() - 20]);
    let run = place.tactile("inspect cut.jsonl");
    assert_eq!(run.code, Some(2), "{}", run.err);
    assert!(run.out.contains("2, numbers 0–1"), "{}", run.out);
    let run = run.says(&["cut.jsonl, line 4: is cut off", "1 line is left out"]);
    assert_eq!(run.out.lines().next(), Some("cut.jsonl"));
    let figures = place.tactile("inspect cut.jsonl --json");
    assert_eq!((figures.code, &figures.json()["grasps"]["count"]), (Some(2), &2.into()));
}
