//! `tactile live --view`: what a browser would be told, by the program itself in front of a virtual
//! board and of the firmware in QEMU.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// A running session; ended with the test.
struct Running {
    child: Child,
    stderr: BufReader<std::process::ChildStderr>,
    _folder: tempfile::TempDir,
    address: String,
}

impl Running {
    fn start(options: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_tactile"))
            .args("live --view 0 --json --out out".split(' ').chain(options.split(' ')))
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        stderr.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("live view at http://").expect(&line);
        let address = address.trim_end_matches('/').to_owned();
        Running { child, stderr, _folder: folder, address }
    }

    fn connect(&self) -> WebSocket<MaybeTlsStream<TcpStream>> {
        tungstenite::connect(format!("ws://{}/live", self.address)).unwrap().0
    }

    /// Everything until the scene ends; what was said on the way down if it never does.
    fn scene(&mut self) -> Result<Vec<Value>, String> {
        let mut client = self.connect();
        let mut messages: Vec<Value> = Vec::new();
        while messages.last().is_none_or(|m| m["type"] != "end") {
            match client.read() {
                Ok(Message::Text(text)) => messages.push(serde_json::from_str(&text).unwrap()),
                Ok(_) => {}
                Err(_) => {
                    let mut said = String::new();
                    self.stderr.read_to_string(&mut said).unwrap();
                    return Err(said);
                }
            }
        }
        Ok(messages)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The bundled recording: ten grasps of five contacts.
fn is_the_session(messages: &[Value]) {
    let of = |kind: &str| messages.iter().filter(|m| m["type"] == kind).collect::<Vec<_>>();
    let meta = &messages[0];
    assert_eq!((&meta["type"], &meta["grasps"]), (&"meta".into(), &10.into()));
    assert!(meta["tracker"].as_str().unwrap().contains("on the board"), "{meta}");
    let grasps = of("grasp");
    let numbers: Vec<u64> = grasps.iter().filter_map(|g| g["grasp"].as_u64()).collect();
    assert_eq!(numbers, (0..10).collect::<Vec<_>>());
    assert!(grasps.iter().all(|g| g["touched"] == 5 && g["pose"].is_array()));
    let surfaces = of("surface");
    let last = surfaces.last().expect("a surface");
    assert!(last["after"] == 9 && last["hausdorff_mm"].as_f64().unwrap() < 9.0, "{last}");
    assert_eq!(of("end").len(), 1);
}

#[test]
fn a_browser_sees_the_session_while_it_runs_and_after() {
    let mut session = Running::start("--port virtual --tracker hypotheses --pace 0.05");
    is_the_session(&session.scene().unwrap());
    // Who comes when it is over finds the same.
    is_the_session(&session.scene().unwrap());
    assert!(session.child.try_wait().unwrap().is_none(), "the view stays");
}

#[test]
fn a_browser_sees_the_firmware_at_work() {
    let mut session = Running::start("--port qemu --tracker hypotheses");
    match session.scene() {
        Ok(messages) => is_the_session(&messages),
        Err(said) => {
            let required = std::env::var_os("TACTILE_REQUIRE_FIRMWARE").is_some_and(|v| v == "1");
            assert!(said.contains("install") && !required, "{said}");
            eprintln!("skipped: {said}");
        }
    }
}
