//! What others make of our MCAP files: Foxglove's Python reader decodes every message by the schemas
//! in the file. Needs `pip install mcap-ros2-support`; `TACTILE_PYTHON` names another interpreter.

use std::fs;
use std::path::Path;
use std::process::{Command, ExitCode};

use clap::Parser;
use serde_json::Value;
use tactile_host::cli::Cli;

/// What the script says of a file; `None` without the packages.
fn read(file: &Path) -> Option<Value> {
    let python = std::env::var_os("TACTILE_PYTHON").unwrap_or("python3".into());
    let present = Command::new(&python).args(["-c", "import mcap_ros2"]).output();
    if !present.is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: needs Python with mcap-ros2-support (see TACTILE_PYTHON)");
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/mcap_reader.py");
    let output = Command::new(python).arg(script).arg(file).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn another_reader_finds_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let runs =
        [("rectangle:0.12x0.06", 5, ("contour", 8)), ("box:0.12x0.06x0.06", 11, ("shape", 36))];
    for (object, kind, (shape, corners)) in runs {
        let simulate = format!(
            "tactile simulate --object {object} --touch uniform --grasps 8 --contacts 6 -o {}",
            at("log.jsonl")
        );
        let slam = format!("tactile slam {} --poses truth --out {}", at("log.jsonl"), at(shape));
        for line in [simulate, slam] {
            assert_eq!(Cli::parse_from(line.split(' ')).run(), ExitCode::SUCCESS, "{line}");
        }
        let Some(found) = read(&Path::new(&at(shape)).join("replay.mcap")) else { return };
        let report = fs::read(Path::new(&at(shape)).join("report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        assert_eq!(found["hausdorff_mm"], report["surface"]["hausdorff_mm"]);
        assert_eq!(found["contacts"], report["contacts"]);
        for topic in ["/contacts", "/pose", "/pose_with_covariance", "/tf", "/truth/pose"] {
            assert_eq!(found["topics"][topic], 8, "{topic}");
        }
        assert_eq!(found["frames"], serde_json::json!(["object", "world"]));
        assert_eq!(found["children"], serde_json::json!(["object", "object_truth"]));
        let unit = |value: &Value| (value.as_f64().unwrap() - 1.0).abs() < 1e-6;
        assert!(
            unit(&found["quaternion"]) && found["normals"].as_array().unwrap().iter().all(unit)
        );
        let marker = &found["marker"];
        assert_eq!(marker[0], kind);
        assert_eq!(marker[1], marker[2]);
        assert!(marker[1].as_u64().unwrap() >= corners, "{marker}");
        let trajectory = fs::read_to_string(Path::new(&at(shape)).join("trajectory.tum")).unwrap();
        let last: Vec<f64> =
            trajectory.lines().last().unwrap().split(' ').map(|w| w.parse().unwrap()).collect();
        for (axis, value) in last[1..4].iter().enumerate() {
            assert!((found["position"][axis].as_f64().unwrap() - value).abs() < 1e-8);
        }
    }
}
