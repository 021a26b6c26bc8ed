//! Live views and large scenes in a real browser in real time: Chromium without a screen, told what to
//! do over its DevTools protocol. Without Chromium the tests say that they were skipped;
//! `TACTILE_REQUIRE_BROWSER=1` makes that a failure.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use tactile_host::view::html;
use tactile_host::view::live::LiveView;
use tactile_host::view::scene::{Grasp, Meta, Packed, Scene, Shape, Surface};
use tempfile::TempDir;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// The names Chromium goes by.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// How long something may take that happens on a page.
const PATIENCE: Duration = Duration::from_secs(60);

/// A process that ends with the test.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A page in a browser.
struct Page {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    number: u64,
    session: Value,
    /// What went wrong on the page by itself.
    complaints: Vec<Value>,
    _browser: Ends,
    _profile: TempDir,
}

impl Page {
    /// `None` where there is no browser and none is required.
    fn open(url: &str) -> Option<Page> {
        let runs = |name: &&str| Command::new(name).arg("--version").output().is_ok();
        let Some(browser) = BROWSERS.into_iter().find(runs) else {
            let required = std::env::var_os("TACTILE_REQUIRE_BROWSER").is_some_and(|v| v == "1");
            assert!(!required, "no browser found, tried {BROWSERS:?}");
            eprintln!("skipped: no browser found, tried {BROWSERS:?}");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        let said = profile.path().join("said.txt");
        let child = Command::new(browser)
            .args(["--headless", "--no-sandbox", "--disable-extensions", "--disable-dev-shm-usage"])
            .args(["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .args(["--remote-debugging-port=0", "--window-size=800,600"])
            .arg(format!("--user-data-dir={}", profile.path().join("profile").display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(File::create(&said).unwrap())
            .spawn()
            .unwrap();
        let browser = Ends(child);
        let start = Instant::now();
        let address = loop {
            let text = fs::read_to_string(&said).unwrap();
            let listening = text.lines().find_map(|l| l.strip_prefix("DevTools listening on "));
            if let Some(address) = listening {
                break address.to_owned();
            }
            assert!(start.elapsed() < PATIENCE, "{text}");
            std::thread::sleep(Duration::from_millis(50));
        };
        let (socket, _) = tungstenite::connect(address).unwrap();
        let (session, complaints) = (Value::Null, Vec::new());
        let mut page =
            Page { socket, number: 0, session, complaints, _browser: browser, _profile: profile };
        let target = page.call("Target.createTarget", json!({ "url": "about:blank" }));
        let id = &target["targetId"];
        let attached =
            page.call("Target.attachToTarget", json!({ "targetId": id, "flatten": true }));
        page.session = attached["sessionId"].clone();
        page.call("Runtime.enable", json!({}));
        page.call("Page.enable", json!({}));
        page.call("Page.navigate", json!({ "url": url }));
        Some(page)
    }

    fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let mut call = json!({ "id": self.number, "method": method, "params": parameters });
        if !self.session.is_null() {
            call["sessionId"] = self.session.clone();
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == self.number {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            if answer["method"] == "Runtime.exceptionThrown" {
                self.complaints.push(answer["params"].clone());
            }
        }
    }

    /// The value of an expression, waited for where it is a promise; null where it throws.
    fn value(&mut self, expression: &str) -> Value {
        let wanted = json!({
            "expression": expression, "awaitPromise": true, "returnByValue": true,
        });
        self.call("Runtime.evaluate", wanted)["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    fn until(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(expression) != Value::Bool(true) {
            let state = "[player.scene.grasps.length, player.notes, \
                         document.getElementById('live').textContent].toString()";
            let ready = start.elapsed() < PATIENCE;
            assert!(ready, "{expression}: {} {:?}", self.value(state), self.complaints);
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// A session with a live view, and what it says on standard error after the view's address.
struct Session {
    running: Ends,
    address: String,
    said: BufReader<ChildStderr>,
}

impl Session {
    /// `tactile live` on the bundled recording, ten grasps of five contacts.
    fn live(folder: &Path, options: &str) -> Session {
        Session::start(folder, &format!("live --tracker hypotheses {options}"))
    }

    fn start(folder: &Path, line: &str) -> Session {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tactile"))
            .args(line.split(' '))
            .args(["--quiet", "--json", "--out", "out"])
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let running = Ends(child);
        let mut line = String::new();
        said.read_line(&mut line).unwrap();
        // Nobody finds the view without: said however quiet it should be.
        let address = line.trim().strip_prefix("live view at ").expect(&line).to_owned();
        Session { running, address, said }
    }
}

#[test]
fn a_page_shows_a_session_and_connects_again_to_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let first = Session::live(folder.path(), "--port virtual --pace 600 --view 0");
    let address = first.address.clone();
    let Some(mut page) = Page::open(&address) else { return };
    // The first grasp, and then the hand rests.
    page.until("player.scene.grasps.length === 1 && player.drawn?.points === 5");
    assert_eq!(page.value("document.getElementById('live').textContent"), "live");
    drop(first);
    page.until("document.getElementById('live').textContent === 'connecting again'");
    assert_eq!(page.value("player.scene.grasps.length"), 1, "what was told stays");

    let port = address.trim_end_matches('/').rsplit_once(':').unwrap().1;
    let options = format!("--port virtual --pace 0.02 --view {port}");
    let second = Session::live(folder.path(), &options);
    assert_eq!(second.address, address);
    page.until("player.scene.ended && player.scene.grasps.length === 10");
    page.until("player.drawn.points === 50 && player.scene.surfaces.length > 0");
    assert_eq!(page.value("document.getElementById('live').textContent"), "ended");
    assert_eq!(page.value("player.notes"), json!([]));
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);
}

#[test]
fn a_page_shows_the_firmware_at_work() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::live(folder.path(), "--port qemu --view 0");
    let Some(mut page) = Page::open(&session.address) else { return };
    let start = Instant::now();
    while page.value("player.scene.ended") != true {
        if session.running.0.try_wait().unwrap().is_some() {
            let mut said = String::new();
            session.said.read_to_string(&mut said).unwrap();
            let required = std::env::var_os("TACTILE_REQUIRE_FIRMWARE").is_some_and(|v| v == "1");
            assert!(said.contains("install") && !required, "{said}");
            eprintln!("skipped: {said}");
            return;
        }
        assert!(start.elapsed() < 3 * PATIENCE, "{}", page.value("player.scene.grasps.length"));
        std::thread::sleep(Duration::from_millis(100));
    }
    page.until("player.drawn.points === 50 && player.scene.surfaces.length > 0");
    assert_eq!(page.value("player.scene.grasps.every((g) => g.pose && g.touched === 5)"), true);
    let tracker = page.value("player.scene.meta.tracker");
    assert_eq!(tracker, "hypotheses on the board");
    assert_eq!(page.value("player.notes"), json!([]));
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);
}

/// Says how long it takes from a grasp to its picture.
#[test]
fn pages_follow_what_is_told_grasp_by_grasp() {
    const GRASPS: u64 = 60;
    let view = LiveView::open("127.0.0.1", 0).unwrap();
    view.begin(&Meta::new(2, "touches"));
    let Some(mut first) = Page::open(&view.url()) else { return };
    let mut second = Page::open(&view.url()).unwrap();
    for page in [&mut first, &mut second] {
        page.until("player.scene.meta !== null");
        // When each grasp was on the canvas.
        page.value(
            "(() => { \
               window.seen = []; \
               const frame = player.frame.bind(player); \
               player.frame = (now) => { \
                 frame(now); \
                 while (seen.length < player.scene.grasps.length) seen.push(Date.now()); \
               }; \
             })()",
        );
    }
    assert_eq!(view.viewers(), 2);
    let mut told = Vec::new();
    for number in 0..GRASPS {
        let at = 0.001 * number as f32;
        told.push(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64() * 1e3);
        view.grasp(Grasp {
            grasp: number,
            merged: 1,
            touched: 1,
            pose: Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            contacts: Packed(vec![at, 0.02, 0.0, 0.0, 1.0, 0.0]),
            fingers: Packed(vec![0]),
            ..Grasp::default()
        });
        std::thread::sleep(Duration::from_millis(20));
    }
    view.end();
    for page in [&mut first, &mut second] {
        page.until(&format!("player.scene.ended && seen.length === {GRASPS}"));
        assert_eq!(page.value("player.drawn.points"), GRASPS);
        assert_eq!(page.value("player.notes"), json!([]));
        let seen = page.value("seen");
        let seen = seen.as_array().unwrap().iter().filter_map(Value::as_f64);
        let mut late: Vec<f64> = seen.zip(&told).map(|(seen, told)| seen - told).collect();
        late.sort_by(f64::total_cmp);
        eprintln!(
            "from a grasp to its picture: median {:.0} ms, at most {:.0} ms",
            late[late.len() / 2],
            late[late.len() - 1]
        );
    }
}

#[test]
fn a_page_shows_an_exploration_with_its_candidates() {
    let folder = tempfile::tempdir().unwrap();
    let line = "explore --object rectangle:0.10x0.06 --count 20 --seed 1 --view 0";
    let session = Session::start(folder.path(), line);
    let Some(mut page) = Page::open(&session.address) else { return };
    page.until("player.scene.ended");
    let choices = page.value("player.scene.choices.length").as_u64().unwrap();
    // Closings at the start that felt nothing are grasps too, but nobody chose after them.
    let grasps = page.value("player.scene.grasps.length").as_u64().unwrap();
    assert!((2..=grasps).contains(&choices), "{choices} of {grasps}");
    assert_eq!(page.value("player.scene.choices[0].candidates.length"), 20);
    let best = "(({ chosen, candidates, most }) => candidates[chosen].gain === most)";
    assert_eq!(page.value(&format!("{best}(player.scene.choices[0])")), true);
    // Charts follow the scene with the next frame.
    let titles = "player.charts.cards.map((c) => c.chart.title)";
    page.until(&format!("{titles}.includes('Gain of the next touch')"));
    // The candidates are lines of the scene, and go when nobody wants them.
    let segments = |shown: bool| {
        format!(
            "player.picture.shown.candidates = {shown}; player.go(0); \
             player.frame(performance.now()); player.drawn.segments"
        )
    };
    let with = page.value(&segments(true)).as_u64().unwrap();
    let without = page.value(&segments(false)).as_u64().unwrap();
    assert_eq!(with - without, 21, "and the chosen one once more");
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);
}

/// Ten thousand contacts on a ball of a hundred thousand triangles.
fn large() -> Scene {
    let (rings, around) = (250u32, 200u32);
    let on = |ring: u32, turn: u32| {
        let (up, along) = (f64::from(ring) / f64::from(rings), f64::from(turn) / f64::from(around));
        let (rise, turn) = (std::f64::consts::PI * up, std::f64::consts::TAU * along);
        [turn.cos() * rise.sin(), turn.sin() * rise.sin(), rise.cos()].map(|v| 0.05 * v as f32)
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for turn in 0..around {
            let (a, b) = (ring * around + turn, ring * around + (turn + 1) % around);
            triangles.extend([a, a + around, b, b, a + around, b + around]);
        }
    }
    let vertices: Vec<f32> =
        (0..=rings).flat_map(|ring| (0..around).flat_map(move |turn| on(ring, turn))).collect();
    let deviations = (0..vertices.len() / 3).map(|i| 1e-3 + 1e-7 * i as f32).collect();
    let grasp = |number: u64| {
        let contact = |k: u64| {
            let [x, y, z] = on((13 * (5 * number + k) % 251) as u32, (7 * number + 40 * k) as u32);
            [x, y, z, 20.0 * x, 20.0 * y, 20.0 * z]
        };
        Grasp {
            grasp: number,
            merged: 1,
            pose: Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            touched: 5,
            contacts: Packed((0..5).flat_map(contact).collect()),
            fingers: Packed((0..5).collect()),
            ..Grasp::default()
        }
    };
    let shape = Shape {
        vertices: Packed(vertices),
        loops: Packed::default(),
        triangles: Packed(triangles),
    };
    let deviations = Packed(deviations);
    Scene {
        meta: Meta::new(3, "large"),
        grasps: (0..2_000).map(grasp).collect(),
        surfaces: vec![Surface { after: 0, shape, deviations, ..Surface::default() }],
        choices: Vec::new(),
    }
}

/// Adds up what is sent to the graphics card: calls that draw, and bytes of vertices; and waits for it
/// where asked.
const COUNTED: &str = "(() => { \
    const { gl } = player.renderer; \
    const sent = { calls: 0, bytes: 0, finish: () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)) }; \
    const count = (name, add) => { \
      const own = gl[name].bind(gl); \
      gl[name] = (...all) => { add(all); return own(...all); }; \
    }; \
    for (const name of ['drawArrays', 'drawArraysInstanced', 'drawElements', 'drawElementsInstanced']) { \
      count(name, () => (sent.calls += 1)); \
    } \
    count('bufferData', ([, data]) => (sent.bytes += data.byteLength ?? data)); \
    count('bufferSubData', ([, , data, , length]) => (sent.bytes += length === undefined ? data.byteLength : 4 * length)); \
    count('texImage2D', () => (sent.bytes += Infinity)); \
    window.sent = sent; \
  })()";

/// Says what a frame costs the page's script. How long the graphics card takes is another matter, and no
/// test machine need have one: it is told so little that it can.
#[test]
fn a_large_scene_is_drawn_whole_frame_by_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.html");
    html::write(&large(), &mut File::create(&path).unwrap()).unwrap();
    let Some(mut page) = Page::open(&format!("file://{}#play=0", path.display())) else { return };
    page.until("player.scene.ended && player.frames.count > 0");
    assert_eq!(page.value("player.scene.grasps.length"), 2_000);
    let walk = "(async () => { \
        const costs = []; \
        for (let i = 0; i < 11; i++) { \
          player.time = 1999 - 11 + i + 0.5; \
          player.camera.orbit(0.05, 0); \
          const before = player.frames.milliseconds; \
          player.frame(performance.now()); \
          costs.push(player.frames.milliseconds - before); \
          await new Promise((done) => setTimeout(done, 0)); \
        } \
        costs.sort((a, b) => a - b); \
        return { median: costs[5], most: costs[10], drawn: player.drawn }; \
      })()";
    let seen = page.value(walk);
    eprintln!("script a frame: median {} ms, at most {} ms", seen["median"], seen["most"]);
    assert!(seen["drawn"]["triangles"].as_u64().unwrap() >= 100_000, "{seen}");
    assert!(seen["drawn"]["points"].as_u64().unwrap() >= 9_990, "{seen}");

    // Turning the view sends nothing but a few matrices; playing, what is new of every grasp.
    let frames = |change: &str| {
        format!(
            "(() => {{ \
               player.frame(performance.now()); \
               const [calls, bytes, start] = [sent.calls, sent.bytes, performance.now()]; \
               for (let i = 0; i < 3; i++) {{ {change}; player.frame(performance.now()); }} \
               const script = performance.now() - start; \
               sent.finish(); \
               return {{ calls: (sent.calls - calls) / 3, bytes: (sent.bytes - bytes) / 3, \
                        script: script / 3, whole: (performance.now() - start) / 3 }}; \
             }})()"
        )
    };
    page.value(COUNTED);
    let turned = page.value(&frames("player.camera.orbit(0.05, 0)"));
    eprintln!("a frame while turning: {turned}");
    assert!((1.0..=12.0).contains(&turned["calls"].as_f64().unwrap()), "{turned}");
    assert_eq!(turned["bytes"], 0, "{turned}");
    let played = page.value(&frames("player.time = 1900 + i + 0.25"));
    eprintln!("a frame while playing: {played}");
    assert!((1.0..=12.0).contains(&played["calls"].as_f64().unwrap()), "{played}");
    assert!((1.0..=1_000.0).contains(&played["bytes"].as_f64().unwrap()), "{played}");
    // A grasp that comes costs what it holds, and not what came before.
    let grasp = "player.receive(JSON.stringify({ type: 'grasp', grasp: 2000 + i, merged: 1, touched: 5, \
                 pose: [0, 0, 0, 0, 0, 0, 1], contacts: btoa(String.fromCharCode(...new Uint8Array( \
                 new Float32Array(30).fill(0.05).buffer))), fingers: btoa('\\0\\1\\2\\3\\4') }))";
    let came = page.value(&frames(grasp));
    eprintln!("a frame with a new grasp: {came}");
    assert_eq!(page.value("player.scene.grasps.length"), 2_003);
    assert_eq!(page.value("player.scene.contacts.count"), 10_015);
    assert_eq!(page.value("player.notes"), json!([]));
    // Its contacts, their normals and the path of the object: 40 bytes a grasp.
    assert!(came["bytes"].as_f64().unwrap() <= 100_000.0, "{came}");
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);
}
