//! Whole runs of `tactile localize`: what it prints and what it refuses.

use std::fs;
use std::process::{Command, Output};

use serde_json::{Value, json};
use tempfile::TempDir;

/// A folder to run in, with a box of 12 × 8 × 5 cm in it.
struct Bench(TempDir);

/// Corners of the box, and its faces, outward.
const CORNERS: &str =
    "0 0 0\n.12 0 0\n.12 .08 0\n0 .08 0\n0 0 .05\n.12 0 .05\n.12 .08 .05\n0 .08 .05\n";
const FACES: &str = "4 3 2 1 0\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";

impl Bench {
    fn new() -> Bench {
        let bench = Bench(tempfile::tempdir().unwrap());
        bench.write("box.off", format!("OFF\n8 6 0\n{CORNERS}{FACES}"));
        bench
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.0.path().join(name), content).unwrap();
    }

    fn run(&self, line: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactile"));
        command.arg("localize").args(line.split_whitespace());
        command.current_dir(self.0.path()).output().unwrap()
    }

    fn does(&self, line: &str) -> String {
        let output = self.run(line);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{line}\n{error}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn report(&self, line: &str) -> Value {
        serde_json::from_str(&self.does(line)).unwrap()
    }

    /// Ends with code 2 and says all of `words`.
    fn refuses(&self, line: &str, words: &[&str]) {
        let output = self.run(line);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{line}\n{error}");
        assert!(output.stdout.is_empty() && !error.contains("panicked"), "{line}\n{error}");
        for word in words {
            assert!(error.contains(word), "{line}: {word:?} is not in\n{error}");
        }
    }
}

/// Points on the box and outward normals, the box turned by a quarter about z and moved by
/// (1, 2, 3): (x, y, z) is at (1 − y, 2 + x, 3 + z).
fn touches() -> Vec<([f64; 3], [f64; 3])> {
    let on_box = [
        ([0.0, 0.02, 0.01], [-1.0, 0.0, 0.0]),
        ([0.0, 0.06, 0.04], [-1.0, 0.0, 0.0]),
        ([0.12, 0.03, 0.03], [1.0, 0.0, 0.0]),
        ([0.12, 0.05, 0.01], [1.0, 0.0, 0.0]),
        ([0.03, 0.0, 0.02], [0.0, -1.0, 0.0]),
        ([0.09, 0.0, 0.04], [0.0, -1.0, 0.0]),
        ([0.02, 0.08, 0.03], [0.0, 1.0, 0.0]),
        ([0.10, 0.08, 0.02], [0.0, 1.0, 0.0]),
        ([0.04, 0.02, 0.0], [0.0, 0.0, -1.0]),
        ([0.10, 0.06, 0.0], [0.0, 0.0, -1.0]),
        ([0.01, 0.07, 0.05], [0.0, 0.0, 1.0]),
        ([0.11, 0.01, 0.05], [0.0, 0.0, 1.0]),
    ];
    let turned = |[x, y, z]: [f64; 3]| [-y, x, z];
    let moved = |[x, y, z]: [f64; 3]| [1.0 + x, 2.0 + y, 3.0 + z];
    on_box.iter().map(|(p, n)| (moved(turned(*p)), turned(*n))).collect()
}

/// A log with these contacts in two grasps, the object at rest.
fn log(extra: Value, second: Value) -> String {
    let mut header = json!({"format": "tactile-grasp-log", "version": 1, "dimension": 3});
    header.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
    let contacts: Vec<Value> =
        touches().iter().map(|(p, n)| json!({"point": p, "normal": n})).collect();
    let mut later = json!({"grasp": 1, "contacts": contacts[6..]});
    later.as_object_mut().unwrap().extend(second.as_object().unwrap().clone());
    format!("{header}\n{}\n{later}\n", json!({"grasp": 0, "contacts": contacts[..6]}))
}

fn points() -> String {
    let lines = touches().into_iter().map(|([x, y, z], _)| format!("{x} {y} {z}\n"));
    format!("OFF\n12 0 0\n{}", lines.collect::<String>())
}

/// The four ways the box can lie, one of them the true one, and how well it is known.
fn check(report: &Value) {
    let modes = report["modes"].as_array().unwrap();
    assert_eq!(modes.len(), 4, "{report:#}");
    let total: f64 = modes.iter().map(|m| m["weight"].as_f64().unwrap()).sum();
    assert!((total - 1.0).abs() < 1e-9, "{report:#}");
    let turn = std::f64::consts::FRAC_1_SQRT_2;
    let near = |values: &Value, expected: &[f64]| {
        let values = values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
        values.zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-3
    };
    let here = modes.iter().any(|m| {
        let q = &m["pose"]["rotation"];
        near(&m["pose"]["translation"], &[1.0, 2.0, 3.0])
            && (near(q, &[0.0, 0.0, turn, turn]) || near(q, &[0.0, 0.0, -turn, -turn]))
    });
    assert!(here, "{report:#}");
    assert!(report["mean_mm"].as_f64().unwrap() < 0.05, "{report:#}");
    assert_eq!(report["mean_mm"], modes[0]["mean_mm"]);
    assert!(report["seconds"].as_f64().unwrap() > 0.0);
    assert_eq!(report["unobservable"], json!([]));
}

#[test]
fn a_box_is_found_from_every_kind_of_file() {
    let bench = Bench::new();
    bench.write(
        "still.jsonl",
        log(
            json!({}),
            json!({"motion": {
        "translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}}),
        ),
    );
    bench.write("points.off", points());
    let rows = touches().into_iter().map(|(p, n)| {
        let [x, y, z] = p;
        let [nx, ny, nz] = n;
        format!("{x},{y},{z},{nx},{ny},{nz}\n")
    });
    bench.write("table.csv", format!("x,y,z,nx,ny,nz\n{}", rows.collect::<String>()));
    let report = bench.report("--model box.off still.jsonl --json");
    check(&report);
    assert_eq!((&report["contacts"], &report["normals"]), (&json!(12), &json!(12)));
    check(&bench.report("--model box.off points.off --json"));
    check(&bench.report("--model box.off table.csv --json --seed 5"));
    let without = bench.report("--model box.off table.csv --json --no-normals");
    check(&without);
    assert_eq!(without["normals"], 0);
    let said = bench.does("--model box.off points.off");
    assert!(said.contains("12 contacts lie 0.00 mm") && said.contains("25.0%"), "{said}");
}

#[test]
fn an_object_that_moved_is_found_where_it_was_last() {
    let bench = Bench::new();
    // The log says that the object rose by 1 m before the second grasp: then the contacts of the
    // second grasp are a metre higher.
    let mut moved = log(
        json!({}),
        json!({"motion": {
        "translation": [0, 0, 1], "rotation": [0, 0, 0, 1]}}),
    );
    let (head, last) = moved.trim_end().rsplit_once('\n').unwrap();
    let mut grasp: Value = serde_json::from_str(last).unwrap();
    for contact in grasp["contacts"].as_array_mut().unwrap() {
        contact["point"][2] = json!(contact["point"][2].as_f64().unwrap() + 1.0);
    }
    moved = format!("{head}\n{grasp}\n");
    bench.write("moved.jsonl", moved);
    let mut report = bench.report("--model box.off moved.jsonl --json");
    for mode in report["modes"].as_array_mut().unwrap() {
        let z = mode["pose"]["translation"][2].as_f64().unwrap();
        mode["pose"]["translation"][2] = json!(z - 1.0);
    }
    check(&report);
    // Taken as at rest, the contacts fit no box.
    let fixed = bench.report("--model box.off moved.jsonl --fixed --json");
    assert!(fixed["mean_mm"].as_f64().unwrap() > 50.0, "{fixed:#}");
}

#[test]
fn bad_input_is_refused_with_its_place() {
    let bench = Bench::new();
    bench.write("points.off", points());
    bench.refuses("--model none.ply points.off", &["none.ply: cannot read"]);
    bench.refuses("--model box.off none.jsonl", &["none.jsonl: cannot read"]);
    bench.refuses("--model box.txt points.off", &["box.txt: expected a mesh file ending in"]);
    bench.refuses("--model box.off points.xyz", &["points.xyz", ".jsonl, .csv or .off"]);
    bench.refuses("--model points.off points.off", &["points.off", "at least one triangle"]);
    bench.refuses("--model box.off box.off", &["box.off, line 2", "found a mesh of 6 faces"]);
    bench.refuses("points.off", &["--model"]);

    bench.write("empty.off", "OFF\n0 0 0\n");
    bench.refuses("--model box.off empty.off", &["empty.off, line 2", "at least one point"]);
    bench.write("one.off", "OFF\n1 0 0\n0 0 0\n");
    bench.refuses("--model box.off one.off", &["one.off: expected at least 3 contacts, found 1"]);
    bench.write("nan.off", "OFF\n3 0 0\n0 0 0\n0 nan 0\n1 1 1\n");
    bench.refuses("--model box.off nan.off", &["nan.off, line 4: column 3", "y of point 1 of 3"]);
    bench.write("flat.csv", "x,y\n1,2\n3,4\n5,6\n");
    bench.refuses("--model box.off flat.csv", &["flat.csv", "dimension 3", "planar"]);
    bench.write("bad.csv", "x,y,z\n1,2,3\n1,inf,3\n");
    bench.refuses("--model box.off bad.csv", &["bad.csv, line 3: column `y`"]);
    bench.write("empty.csv", "");
    bench.refuses("--model box.off empty.csv", &["empty.csv", "is empty"]);

    bench.write("unknown.jsonl", log(json!({}), json!({"motion": null})));
    let words = ["unknown.jsonl: grasp 1, field `motion`", "--fixed"];
    bench.refuses("--model box.off unknown.jsonl", &words);
    check(&bench.report("--model box.off unknown.jsonl --fixed --json"));
    bench.write("planar.jsonl", log(json!({"dimension": 2}), json!({})));
    bench.refuses("--model box.off planar.jsonl", &["planar.jsonl, line 2", "field `contacts[0]"]);
    bench.write("none.csv", "x,y,z\n");
    bench.refuses("--model box.off none.csv", &["none.csv"]);

    bench.write("hole.off", format!("OFF\n8 1 0\n{}4 3 2 1 0\n", CORNERS.replace(".12", "nan")));
    bench.refuses("--model hole.off points.off", &["hole.off", "vertex 1", "finite"]);
    bench.write("line.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n");
    bench.refuses("--model line.off points.off", &["line.off", "no area"]);
    let noise = "--model box.off points.off --contact-noise 0mm,5deg";
    bench.refuses(noise, &["--contact-noise", "above zero"]);
}

#[test]
fn help_shows_an_example() {
    let said = Bench::new().does("--help");
    assert!(said.contains("Example:") && said.contains("tactile localize --model"), "{said}");
}
