//! Replays in a real browser: Chromium without a screen, WebGL in software. Each page plays itself
//! (`#selftest`) and says what it saw. Without Chromium the tests say that they were skipped;
//! `TACTILE_REQUIRE_BROWSER=1` makes that a failure.

use std::collections::HashMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;
use tiny_skia::Pixmap;

/// The names Chromium goes by.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// What every start needs: no sandbox, as the user may be root in a container, and WebGL in software.
const ALWAYS: [&str; 9] = [
    "--headless",
    "--no-sandbox",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--enable-logging=stderr",
];

/// How long a page may take, and how often a browser that hangs is started.
const PATIENCE: Duration = Duration::from_secs(60);
const STARTS: usize = 3;

/// A browser and a folder for what it is to see.
struct Bench {
    browser: &'static str,
    folder: TempDir,
}

/// What a page said of itself, and how it looked.
struct Visit {
    seen: Value,
    picture: Pixmap,
}

impl Bench {
    /// `None` where there is no browser and none is required.
    fn new() -> Option<Bench> {
        let runs = |name: &&str| Command::new(name).arg("--version").output().is_ok();
        let Some(browser) = BROWSERS.into_iter().find(runs) else {
            let required = std::env::var_os("TACTILE_REQUIRE_BROWSER").is_some_and(|v| v == "1");
            assert!(!required, "no browser found, tried {BROWSERS:?}");
            eprintln!("skipped: no browser found, tried {BROWSERS:?}");
            return None;
        };
        Some(Bench { browser, folder: tempfile::tempdir().unwrap() })
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn tactile(&self, line: &str) {
        let output = Command::new(env!("CARGO_BIN_EXE_tactile"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{line}\n{}", String::from_utf8_lossy(&output.stderr));
    }

    /// What a command writes on standard output and error, through files, so that no pipe fills up;
    /// `None` where it had to be stopped.
    fn finished(&self, mut command: Command) -> Option<(Vec<u8>, Vec<u8>)> {
        let [out, err] = ["out.txt", "err.txt"].map(|name| self.at(name));
        command.stdout(File::create(&out).unwrap()).stderr(File::create(&err).unwrap());
        let mut child = command.spawn().unwrap();
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > PATIENCE {
                child.kill().unwrap();
                child.wait().unwrap();
                eprintln!("stopped: {command:?}");
                return None;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        Some((fs::read(out).unwrap(), fs::read(err).unwrap()))
    }

    /// What the browser says of an address, asked for with `wish`. One that hangs is started anew.
    fn browse(&self, address: &str, wish: &[&str]) -> (Vec<u8>, Vec<u8>) {
        let mut said = (0..STARTS).filter_map(|_| {
            let profile = tempfile::tempdir_in(self.folder.path()).unwrap();
            let mut command = Command::new(self.browser);
            command
                .args(ALWAYS)
                .arg(format!("--user-data-dir={}", profile.path().display()))
                .args(wish)
                .arg(address);
            self.finished(command)
        });
        said.next().unwrap_or_else(|| panic!("{address}: the browser hung {STARTS} times"))
    }

    /// How an address looks, `width,height`. Never in one start with a time budget of its own: a
    /// browser that is out of budget waits for its next frame for ever, about one time in ten.
    fn picture(&self, address: &str, size: &str) -> Pixmap {
        let path = self.at("picture.png");
        let [screenshot, size] =
            [format!("--screenshot={}", path.display()), format!("--window-size={size}")];
        self.browse(address, &[&screenshot, &size]);
        let png = fs::read(&path).unwrap();
        // So that a browser that draws nothing leaves nothing to be read.
        fs::remove_file(path).unwrap();
        Pixmap::decode_png(&png).unwrap()
    }

    /// Opens a page with these words after its `#`: lets it play itself, and looks at its end.
    fn visit(&self, page: &Path, words: &str, size: &str) -> Visit {
        let address = format!("file://{}#{words}", page.display());
        let window = format!("--window-size={size}");
        let wish = ["--virtual-time-budget=3000", "--dump-dom", &window];
        let (out, err) = self.browse(&format!("{address}&selftest"), &wish);
        let log = String::from_utf8_lossy(&err);
        let spoke: Vec<&str> = log.lines().filter(|l| l.contains("CONSOLE")).collect();
        assert!(spoke.is_empty(), "{}: the console says {spoke:?}", page.display());
        let dom = String::from_utf8_lossy(&out);
        let said = dom.split_once("id=\"selftest\" hidden=\"\">").map(|(_, rest)| rest);
        let Some((said, _)) = said.and_then(|s| s.split_once("</pre>")) else {
            panic!("{}: the page did not finish its test\n{log}", page.display())
        };
        let said = said.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
        let seen: Value = serde_json::from_str(&said).unwrap();
        assert_eq!(seen["errors"], Value::Array(vec![]), "{}", page.display());
        Visit { seen, picture: self.picture(&format!("{address}&at=9999"), size) }
    }
}

impl Visit {
    fn number(&self, name: &str) -> f64 {
        self.seen[name].as_f64().unwrap_or_else(|| panic!("{name} in {}", self.seen))
    }

    fn notes(&self) -> String {
        self.seen["notes"].to_string()
    }

    /// Plays, steps, scrubs, turns, and shows every contact at the end and one grasp's at the start.
    fn does_what_a_replay_does(&self, grasps: f64, contacts: f64, of_the_first: f64) {
        assert_eq!(self.seen["renderer"], "WebGl");
        assert_eq!(self.number("grasps"), grasps);
        assert_eq!(self.number("touched"), contacts);
        assert!(self.number("played") > 0.3, "it did not play: {}", self.seen);
        assert_eq!(self.number("end"), grasps - 1.0);
        assert_eq!(self.number("stepped"), grasps - 2.0);
        assert_eq!(self.number("scrubbed"), 0.0);
        assert_eq!(self.number("pointsAtEnd"), contacts);
        assert_eq!(self.number("pointsAtStart"), of_the_first);
        assert_eq!(self.seen["cameraMoved"], true);
        assert_eq!(self.seen["riding"], true);
    }

    /// Different colours in the middle of the scene, where they are a share of the picture at least.
    fn colours(&self) -> usize {
        let (wide, high) = (self.picture.width(), self.picture.height());
        let mut count = HashMap::new();
        for y in high / 5..high * 3 / 5 {
            for x in wide / 5..wide * 3 / 5 {
                let p = self.picture.pixel(x, y).unwrap();
                // Sixteen levels of each, so that smoothed edges count little.
                *count.entry([p.red() >> 4, p.green() >> 4, p.blue() >> 4]).or_insert(0) += 1;
            }
        }
        let least = (wide * high / 50_000).max(3);
        count.into_values().filter(|&n: &u32| n >= least).count()
    }
}

#[test]
fn a_flat_run_plays() {
    let Some(bench) = Bench::new() else { return };
    bench.tactile("slam --out flat");
    let visit = bench.visit(&bench.at("flat/replay.html"), "theme=light", "800,500");
    visit.does_what_a_replay_does(10.0, 50.0, 5.0);
    assert_eq!(visit.notes(), "[]");
    assert!(visit.number("surfaces") >= 4.0);
    assert!(visit.colours() > 12, "{} colours", visit.colours());
    // The page works out the last pose's error from the poses: as the report has it.
    let report = fs::read(bench.at("flat/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    for (ours, theirs) in
        [("translation", "final_translation_mm"), ("rotation", "final_rotation_deg")]
    {
        let ours = visit.seen["lastError"][ours].as_f64().unwrap();
        assert!((ours - report["pose"][theirs].as_f64().unwrap()).abs() < 1e-3, "{theirs}");
    }
}

/// What a newcomer does: one command, and the page opens.
#[test]
fn the_bundled_prism_grows_in_space_until_its_surface_is_whole() {
    let Some(bench) = Bench::new() else { return };
    bench.tactile("slam --bundled prism --out prism");
    let report = fs::read(bench.at("prism/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let aligned = report["surface"]["hausdorff_aligned_mm"].as_f64().unwrap();
    assert!(aligned < 2.0, "the L was not found: {report}");
    let page = bench.at("prism/replay.html");
    let visit = bench.visit(&page, "theme=light", "900,600");
    visit.does_what_a_replay_does(32.0, 159.0, 5.0);
    assert_eq!(visit.notes(), "[]");
    assert_eq!(visit.seen["truth"], true);
    assert!(visit.number("surfaces") >= 6.0, "it does not grow: {}", visit.seen);
    // The true L drawn beside it has a few triangles only; the estimate is closed and coloured.
    assert!(visit.number("trianglesAtEnd") > 500.0, "{}", visit.seen);
    assert!(visit.colours() > 12, "{} colours", visit.colours());
}

#[test]
fn a_run_in_space_plays_cut_off_and_without_webgl_too() {
    let Some(bench) = Bench::new() else { return };
    bench.tactile("simulate --object box:0.12x0.06x0.06 --grasps 8 --seed 3 -o box.jsonl");
    bench.tactile("slam box.jsonl --out space");
    let page = bench.at("space/replay.html");
    let whole = bench.visit(&page, "theme=dark", "500,700");
    whole.does_what_a_replay_does(8.0, 40.0, 5.0);
    assert!(whole.number("trianglesAtEnd") > 100.0);
    assert!(whole.colours() > 12, "{} colours", whole.colours());

    // Cut off near its end, and a number that is none.
    let text = fs::read_to_string(&page).unwrap();
    let damaged = bench.at("damaged.html");
    let bad = text.replacen("\"grasp\":3,\"merged\"", "\"grasp\":\"three\",\"merged\"", 1);
    fs::write(&damaged, &bad[..bad.len() * 9 / 10]).unwrap();
    let damaged = bench.visit(&damaged, "theme=light", "500,600");
    assert!(damaged.notes().contains("grasp.grasp: expected a number"), "{}", damaged.notes());
    assert!(damaged.notes().contains("ends early"), "{}", damaged.notes());
    assert!((3.0..8.0).contains(&damaged.number("grasps")), "{}", damaged.seen);

    let plain = bench.visit(&page, "draw=plain", "500,600");
    assert_eq!(plain.seen["renderer"], "Painter");
    assert!(plain.colours() > 8, "{} colours", plain.colours());
}

#[test]
fn a_picture_is_the_same_in_lines_and_letters_as_in_pixels() {
    let Some(bench) = Bench::new() else { return };
    bench.tactile("slam --out flat");
    let vector = format!("file://{}", bench.at("flat/summary.svg").display());
    let seen = bench.picture(&vector, "1600,900");
    let drawn = Pixmap::decode_png(&fs::read(bench.at("flat/summary.png")).unwrap()).unwrap();
    // Letters are set a little differently by everyone: mean colours of squares are compared.
    const SIDE: u32 = 20;
    let mean = |picture: &Pixmap, column: u32, row: u32| {
        let mut sums = [0u32; 3];
        for y in row * SIDE..(row + 1) * SIDE {
            for x in column * SIDE..(column + 1) * SIDE {
                let p = picture.pixel(x, y).unwrap();
                for (sum, part) in sums.iter_mut().zip([p.red(), p.green(), p.blue()]) {
                    *sum += u32::from(part);
                }
            }
        }
        sums.map(|sum| sum / (SIDE * SIDE))
    };
    let (columns, rows) = (1600 / SIDE, 900 / SIDE);
    let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let differ = |&(column, row): &(u32, u32)| {
        let (a, b) = (mean(&seen, column, row), mean(&drawn, column, row));
        a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > 12)
    };
    let count = places.filter(differ).count();
    // Where the page's letters are others than the bundled ones, headline and figures differ.
    assert!(count < (columns * rows / 50) as usize, "{count} of {}", columns * rows);
}
