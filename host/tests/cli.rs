//! Whole runs of `tactile`: what it prints, writes, refuses and leaves behind. They live here
//! because Cargo names the binary only to its own package's tests.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// A folder of its own to run in.
struct Bench(TempDir);

impl Bench {
    fn new() -> Self {
        Bench(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.at(name), content).unwrap();
    }

    fn run(&self, line: &str) -> Output {
        self.run_words(&line.split_whitespace().collect::<Vec<_>>())
    }

    fn run_words(&self, words: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactile"));
        command.args(words).current_dir(self.0.path()).output().unwrap()
    }

    /// A run that must succeed; its standard output.
    fn does(&self, line: &str) -> String {
        let output = self.run(line);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{line}\n{error}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn report(&self, line: &str) -> Value {
        serde_json::from_str(&self.does(line)).unwrap()
    }

    /// A run that must end with code 2, say all of `words`, and leave the folder as it was.
    fn refuses(&self, line: &str, words: &[&str]) {
        let before = self.names();
        let output = self.run(line);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{line}\n{error}");
        for word in words {
            assert!(error.contains(word), "{line}: {word:?} is not in\n{error}");
        }
        assert!(!error.contains("panicked"), "{error}");
        assert!(output.stdout.is_empty(), "{line} printed");
        assert_eq!(self.names(), before, "{line} left something behind");
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn the_main_job_needs_no_arguments() {
    let bench = Bench::new();
    let said = bench.does("slam");
    assert!(said.contains("10 grasps, 50 contacts"), "{said}");
    for name in [
        "report.json",
        "contour.csv",
        "trajectory.tum",
        "summary.png",
        "summary.svg",
        "replay.mcap",
    ] {
        assert!(bench.at("out").join(name).is_file(), "{name}");
    }
    let report: Value =
        serde_json::from_slice(&fs::read(bench.at("out/report.json")).unwrap()).unwrap();
    assert!(number(&report["surface"]["mean_mm"]) < 4.0, "{report}");
    assert_eq!(report["pose"]["per_grasp"].as_array().unwrap().len(), 10);
}

/// The page is shown by the program that `BROWSER` names.
#[cfg(unix)]
#[test]
fn the_replay_opens_in_the_browser() {
    use std::os::unix::fs::PermissionsExt;
    let bench = Bench::new();
    // Whole or not at all, so that who looks sees no half a name.
    let script = "#!/bin/sh\nprintf %s \"$1\" > opened.part && mv opened.part opened\n";
    bench.write("browser", script);
    fs::set_permissions(bench.at("browser"), fs::Permissions::from_mode(0o755)).unwrap();
    let run = |browser: PathBuf| {
        let words = ["replay", "log.jsonl", "--to", "html", "-o", "page.html", "--open"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactile"));
        command.args(words).current_dir(bench.0.path()).env("BROWSER", browser).output().unwrap()
    };
    bench.does("simulate --object hexagon:0.05 --grasps 2 -o log.jsonl");
    assert!(run(bench.at("browser")).status.success());
    let start = std::time::Instant::now();
    while !bench.at("opened").exists() && start.elapsed().as_secs() < 30 {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let opened = fs::read_to_string(bench.at("opened")).unwrap();
    assert_eq!(fs::canonicalize(opened).unwrap(), fs::canonicalize(bench.at("page.html")).unwrap());
    // Without a browser the page is there all the same.
    let output = run(bench.at("none"));
    assert!(output.status.success());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("no browser could be started") && said.contains("page.html"), "{said}");
    bench.refuses("replay log.jsonl --to mcap -o no.mcap --open", &["--open", "--to html"]);
    bench.refuses("slam log.jsonl --bundled prism --out no", &["--bundled"]);
}

#[test]
fn known_poses_give_the_shape() {
    let bench = Bench::new();
    bench.does(
        "simulate --object ellipse:0.12x0.06 --touch uniform --grasps 1 --contacts 30 --seed 5 -o e.jsonl",
    );
    let report = bench.report("slam e.jsonl --poses truth --out e --json");
    assert!(number(&report["surface"]["hausdorff_aligned_mm"]) < 4.0, "{report}");
    assert_eq!(report["pose"]["rms_translation_mm"], 0.0);
    assert_eq!(report["tracker"], "truth");

    bench.does(
        "simulate --object box:0.12x0.06x0.06 --touch uniform --grasps 1 --contacts 60 -o b.jsonl",
    );
    assert!(bench.at("b.ply").is_file(), "the true mesh stands beside the log");
    let report = bench.report("slam b.jsonl --poses truth --out b --mesh stl,obj --json");
    assert!(number(&report["surface"]["mean_mm"]) < 4.0, "{report}");
    for ending in ["ply", "stl", "obj"] {
        assert!(bench.at("b/shape").with_extension(ending).is_file(), "{ending}");
    }
    bench.refuses("slam e.jsonl --mesh stl --out no", &["e.jsonl", "no mesh"]);
    // Quiet means nothing but what was asked for.
    assert_eq!(bench.does("slam e.jsonl --poses truth --out e --quiet"), "");
    let report = bench.report("-q slam e.jsonl --poses truth --out e --json");
    assert_eq!(report["tracker"], "truth");
    let said = bench.does("slam e.jsonl --poses truth --out e");
    assert!(!said.contains('\x1b') && said.contains("results in e"), "no colours in a pipe");
}

#[test]
fn tracking_repeats_for_a_seed_and_follows_the_object() {
    let bench = Bench::new();
    bench.does("simulate --object hexagon:45mm --motion-noise 3mm,5deg --seed 2 -o h.jsonl");
    let figures = |options: &str| {
        let mut report = bench.report(&format!("slam h.jsonl {options} --out h --json"));
        report.as_object_mut().unwrap().remove("seconds");
        report
    };
    for tracker in ["auto", "hypotheses", "rao-blackwell", "bootstrap"] {
        let options = format!("--tracker {tracker}");
        let first = figures(&options);
        assert!(number(&first["surface"]["hausdorff_aligned_mm"]) < 9.0, "{first}");
        assert!(first["lost"].as_array().unwrap().is_empty());
        assert_eq!(first, figures(&options));
    }
    // Particles are drawn; the answers of `auto` and of the graph are not.
    let drawn = |seed: u32| figures(&format!("--tracker bootstrap --graph none --seed {seed}"));
    assert_ne!(drawn(1), drawn(7));
    assert_eq!(figures("--seed 1"), figures("--seed 7"));
}

#[test]
fn every_object_can_be_simulated_and_inspected() {
    let bench = Bench::new();
    for (object, dimension) in [
        ("rectangle:0.12x0.06", 2),
        ("triangle:60mm", 2),
        ("hexagon:0.045", 2),
        ("ellipse:0.1x0.06", 2),
        ("box:0.12x0.06x0.06", 3),
        ("cylinder:0.06x0.1", 3),
        ("sphere:8cm", 3),
        ("ellipsoid:0.1x0.08x0.06", 3),
    ] {
        bench.does(&format!("simulate --object {object} --grasps 3 -o log.jsonl"));
        let seen = bench.report("inspect log.jsonl --json");
        assert_eq!(seen["dimension"], dimension, "{object}");
        assert_eq!(seen["grasps"]["count"], 3, "{object}");
    }
    bench.write("outline.csv", "0,0\n0.1,0\n0.1,0.04\n0.04,0.04\n0.04,0.09\n0,0.09\n");
    bench.does("simulate --object polygon:outline.csv -o log.jsonl");
}

const HEADER: &str =
    r#"{"format":"tactile-grasp-log","version":1,"dimension":2,"frame":"world","fingers":["ff"]}"#;

fn log(second: &str) -> String {
    format!("{HEADER}\n{second}\n")
}

#[test]
fn bad_logs_are_refused_with_file_line_and_field() {
    let many: Vec<String> =
        (0..10_000).map(|i| format!(r#"{{"point":[{},0]}}"#, 1e-3 * f64::from(i))).collect();
    let cases: Vec<(String, &[&str])> = vec![
        (String::new(), &["bad.jsonl"]),
        ("garbage".into(), &["bad.jsonl", "line 1"]),
        (HEADER.into(), &["bad.jsonl", "grasp"]),
        (HEADER.replace("\"version\":1", "\"version\":9"), &["line 1", "version", "9"]),
        (HEADER.replace(":2", ":4"), &["line 1", "dimension", "4"]),
        (HEADER.replace("grasp-log", "other"), &["line 1", "format"]),
        (log("{"), &["line 2"]),
        (log(r#"{"grasp":0,"contacts":[{"point":[0,0"#), &["line 2"]),
        (log(r#"{"grasp":0}"#), &["line 2", "contacts"]),
        (log(r#"{"contacts":[]}"#), &["line 2", "grasp"]),
        (log(r#"{"grasp":0,"contacts":[{}]}"#), &["line 2", "contacts[0]", "point"]),
        (log(r#"{"grasp":0,"contacts":[{"point":[0,0,1]}]}"#), &["line 2", "contacts[0].point"]),
        (log(r#"{"grasp":0,"contacts":[{"point":[0,1e999]}]}"#), &["line 2"]),
        (log(r#"{"grasp":0,"contacts":[{"point":[0,NaN]}]}"#), &["line 2"]),
        (
            log(r#"{"grasp":0,"contacts":[{"point":[0,0],"normal":[0,0]}]}"#),
            &["line 2", "contacts[0].normal", "length"],
        ),
        (
            log(r#"{"grasp":0,"contacts":[{"point":[0,0],"normal":[0.9,0]}]}"#),
            &["line 2", "contacts[0].normal", "0.001"],
        ),
        (
            log(r#"{"grasp":0,"contacts":[{"point":[0,0],"finger":"thumb"}]}"#),
            &["line 2", "contacts[0].finger", "thumb"],
        ),
        (
            log(&format!(r#"{{"grasp":0,"contacts":[{}]}}"#, many.join(","))),
            &["line 2", "contacts", "1024", "10000"],
        ),
        (log("{\"grasp\":0,\"contacts\":[]}\n{\"grasp\":0,\"contacts\":[]}"), &["line 3", "grasp"]),
        (log(r#"{"grasp":0,"contacts":[]}"#), &["bad.jsonl", "no contacts"]),
    ];
    let bench = Bench::new();
    for (content, words) in cases {
        bench.write("bad.jsonl", content);
        bench.refuses("slam bad.jsonl --out results", words);
    }
    bench.write("bad.jsonl", [0xffu8, 0xfe, 0, 1, 2]);
    bench.refuses("slam bad.jsonl --out results", &["bad.jsonl", "UTF-8"]);
}

#[test]
fn few_contacts_still_give_something() {
    let bench = Bench::new();
    for grasp in [
        r#"{"grasp":0,"contacts":[{"point":[0,0],"normal":[1,0]}]}"#,
        r#"{"grasp":0,"contacts":[{"point":[0.01,0.01]},{"point":[0.02,0.01]}]}"#,
        r#"{"grasp":0,"contacts":[{"point":[1,1]},{"point":[1,1]},{"point":[1,1]}]}"#,
        r#"{"grasp":3,"contacts":[{"point":[5e-9,0],"normal":[1,0]},{"point":[-5e-9,0],"normal":[-1,0]}]}"#,
    ] {
        bench.write("few.jsonl", log(grasp));
        let report = bench.report("slam few.jsonl --json");
        assert_eq!(report["surface"]["hausdorff_mm"], Value::Null);
    }
}

#[test]
fn bad_arguments_are_refused() {
    let bench = Bench::new();
    bench.write("good.jsonl", log(r#"{"grasp":0,"contacts":[{"point":[0,0],"normal":[1,0]}]}"#));
    bench.write("file", "");
    for (line, words) in [
        ("simulate --object dodecahedron:1 -o x.jsonl", &["dodecahedron", "rectangle:WxH"] as &[_]),
        ("simulate --object box:1x1 -o x.jsonl", &["box:XxYxZ"]),
        ("simulate --object sphere:8kg -o x.jsonl", &["kg"]),
        ("simulate --object sphere:-1 -o x.jsonl", &["-1"]),
        ("simulate --object sphere:8cm --contact-noise 5deg,1mm -o x.jsonl", &["5deg"]),
        ("simulate --object sphere:8cm --grasps 0 -o x.jsonl", &["grasps"]),
        ("simulate --object polygon:missing.csv -o x.jsonl", &["missing.csv"]),
        ("simulate --object missing.ply -o x.jsonl", &["missing.ply"]),
        ("simulate --object sphere:8cm -o missing/x.jsonl", &["missing"]),
        ("simulate --object sphere:8cm -o file/x.jsonl", &["file"]),
        ("slam missing.jsonl --out results", &["missing.jsonl"]),
        ("slam . --out results", &["folder"]),
        ("slam good.jsonl --out file", &["file", "folder"]),
        ("slam good.jsonl --out file/results", &["file"]),
        ("slam good.jsonl --poses truth --out results", &["grasp 0", "truth.pose"]),
        ("slam good.jsonl --tracker magic", &["magic", "bootstrap"]),
        ("slam good.jsonl --seed -1", &["-1"]),
        ("inspect good.txt", &["good.txt"]),
        ("inspect file", &["file"]),
        ("import csv missing.csv -o x.jsonl", &["missing.csv"]),
        ("import push file --poses truth -o x.jsonl", &["file"]),
        ("live --port bluetooth --log good.jsonl", &["bluetooth", "virtual"]),
        ("live --port tcp:nowhere --log good.jsonl", &["tcp:nowhere"]),
        ("replay file -o x.jsonl", &["file"]),
        ("reproduce figure-9.9", &["figure-9.9", "figure-2.7"]),
        ("reproduce figure-2.9 --seeds 1 --out file", &["file", "write"]),
        ("reproduce push --contacts 5", &["--contacts", "shapes", "push"]),
        ("reproduce figure-2.5 --noise 1mm,2deg", &["--noise", "shapes"]),
        ("reproduce shapes --tracker bootstrap", &["--tracker", "tracking", "shapes"]),
        ("reproduce shapes --noise loud", &["--noise", "loud"]),
        ("reproduce tracking --tracker best", &["best", "oracle", "bootstrap", "literal"]),
        ("reproduce tracking --noise 25,loud", &["--noise", "loud", "25,50,100"]),
        ("reproduce tracking --object cube", &["cube", "rectangle"]),
        ("reproduce tracking --outliers 2 --seeds 1", &["--outliers", "2"]),
        ("reproduce mujoco --object anvil", &["mujoco"]),
        ("reproduce shapes --object ycb/anvil", &["--object ycb/anvil"]),
        ("dance", &["dance"]),
    ] {
        bench.refuses(line, words);
    }
}

#[test]
fn a_missing_true_mesh_is_a_warning() {
    let bench = Bench::new();
    bench.does("simulate --object sphere:8cm --grasps 2 -o s.jsonl");
    fs::remove_file(bench.at("s.ply")).unwrap();
    let output = bench.run("slam s.jsonl --poses truth --out s --json");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("warning") && said.contains("s.ply"), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["surface"]["mean_mm"], Value::Null);
}

#[test]
fn contacts_come_from_tables() {
    let bench = Bench::new();
    bench.write("c.csv", "x,y,nx,ny\n30,0,1,0\n0,20,0,1\n-30,0,-1,0\n0,-20,0,-1\n");
    bench.does("import csv c.csv --unit mm --fixed -o c.jsonl");
    let report = bench.report("slam c.jsonl --poses truth --out c --json");
    assert!(number(&report["contact_rms_mm"]) < 2.0, "{report}");
    bench.write("c.csv", "x,y\n1,2\n3,pear\n");
    bench.refuses("import csv c.csv -o d.jsonl", &["c.csv", "line 3", "pear"]);
}

#[test]
fn figures_are_numbers_and_pictures() {
    let bench = Bench::new();
    let said = bench.does("reproduce figure-2.9 --seeds 1 --json --out figures");
    let numbers: Value = serde_json::from_str(&said).unwrap();
    let lines = numbers[0]["lines"].as_array().unwrap();
    assert!(lines.iter().any(|l| l["model"] == "thesis SE" && l["contacts"] == 3), "{numbers}");
    assert!(lines.iter().all(|l| number(&l["hausdorff_mm"]["median"]) < 60.0), "{numbers}");
    let picture = fs::read(bench.at("figures/figure-2.9.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG"));
    let written: Value =
        serde_json::from_slice(&fs::read(bench.at("figures/figure-2.9.json")).unwrap()).unwrap();
    assert_eq!(written, numbers[0]);
}

/// Mean distance ≤ 2.5 mm to the true triangle on every recording of real pushes.
#[test]
fn real_pushes_give_the_block() {
    let folder = tactile_host::data::folder().map(|d| d.join("push")).filter(|d| d.is_dir());
    let Some(folder) = folder else {
        eprintln!("skipped: no push in $TACTILE_DATA");
        return;
    };
    let bench = Bench::new();
    let recordings = tactile_host::experiment::push::recordings(&folder);
    assert!(!recordings.is_empty(), "no pushes in {}", folder.display());
    for file in recordings {
        let path = |p: &Path| p.display().to_string();
        let words = ["import", "push", &path(&file), "--poses", "truth", "-o", "p.jsonl"];
        assert_eq!(bench.run_words(&words).status.code(), Some(0));
        let report = bench.report("slam p.jsonl --poses truth --out p --json");
        let mean = number(&report["surface"]["mean_mm"]);
        assert!(mean <= 2.5, "{}: {mean} mm", file.display());
    }
}

#[test]
fn help_shows_an_example_of_every_subcommand() {
    let bench = Bench::new();
    for name in [
        "slam",
        "simulate",
        "import",
        "live",
        "replay",
        "inspect",
        "explore",
        "localize",
        "optimize",
        "reproduce",
    ] {
        let help = bench.does(&format!("{name} --help"));
        assert!(help.contains("Example"), "{name}");
    }
    assert!(bench.does("--version").contains(env!("CARGO_PKG_VERSION")));
}
