//! What the commands refuse, in which words, and what they leave behind: nothing. [`Place::tactile`]
//! checks every run for panics and left-overs.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::binary::Place;

/// A log: its header with `extra` fields, and one line for each grasp.
fn log(dimension: usize, extra: Value, grasps: &[Value]) -> String {
    let mut header = json!({"format": "tactile-grasp-log", "version": 1, "dimension": dimension});
    header.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
    grasps.iter().fold(header.to_string(), |text, grasp| format!("{text}\n{grasp}"))
}

/// A header and raw text below it.
fn below(text: &str) -> String {
    format!("{}\n{text}\n", log(2, json!({}), &[]))
}

/// Contacts on a circle or ball of this radius in metres, normals outward.
fn round(dimension: usize, radius: f64, count: usize) -> Vec<Value> {
    let contact = |k: usize| {
        let z = if dimension == 2 { 0.0 } else { (2 * k + 1) as f64 / count as f64 - 1.0 };
        let (sin, cos) = (2.4 * k as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let normal = [r * cos, r * sin, z];
        let point = normal.map(|x| radius * x);
        json!({"point": point[..dimension], "normal": normal[..dimension]})
    };
    (0..count).map(contact).collect()
}

fn grasp(number: usize, contacts: &[Value]) -> Value {
    json!({"grasp": number, "contacts": contacts})
}

/// A log that is fine.
fn good() -> String {
    log(2, json!({}), &[grasp(0, &round(2, 0.05, 8))])
}

#[test]
fn explorations_that_cannot_be_are_refused() {
    let place = Place::new();
    for (options, words) in [
        ("--object cube:0.1", &["unknown object", "cube:0.1"][..]),
        ("--object ellipse:0.1x0.06 --until soon", &["--until", "strict, lenient"]),
        ("--object ellipse:0.1x0.06 --until coverage:1.2", &["coverage:SHARE"]),
        ("--object ellipse:0.1x0.06 --motion-noise 5mm,10deg", &["--moving"]),
        ("--object ellipse:0.1x0.06 --tracker curved", &["--moving"]),
        ("--object ellipse:0.1x0.06 --pose 3mm,3deg", &["--moving"]),
        ("--object ellipse:0.1x0.06 --max-actions 0", &["--max-actions"]),
        ("--object ellipse:0.1x0.06 --criterion hunch", &["--criterion", "information"]),
        ("--object missing.ply", &["missing.ply"]),
        ("--object ellipse:0.1x0.06 --cost turn=-1", &["--cost", "seconds", "-1"]),
        ("--object ellipse:0.1x0.06 --cost trave=1", &["--cost", "travel=", "\"trave=1\""]),
        ("--object ellipse:0.1x0.06 --batch 0", &["--batch", "1..=20"]),
        ("--object ellipse:0.1x0.06 --alpha 0", &["--alpha", "above 0"]),
        ("--object ellipse:0.1x0.06 --alpha -1", &["--alpha", "above 0", "-1"]),
        ("--object ellipse:0.1x0.06 --cost action=5,action=600", &["--cost", "action", "once"]),
        ("--object ellipse:0.1x0.06 --area near", &["--area", "--candidates clusters"]),
        ("--object ellipse:0.1x0.06 --alpha 3", &["--alpha", "--criterion renyi"]),
        ("--object ellipse:0.1x0.06 --candidates fixed --count 5", &["--count", "continuous"]),
        ("--object ellipse:0.1x0.06 --board virtual --lookahead", &["--board", "--lookahead"]),
        ("--object ellipse:0.1x0.06 --board virtual --cost turn=1", &["--board", "--cost"]),
        ("--object ellipse:0.1x0.06 --board virtual --batch 2", &["--board", "--batch"]),
        ("--object ellipse:0.1x0.06 --board virtual --candidates clusters", &["--board", "fixed"]),
        (
            "--object box:0.1x0.06x0.08 --hand five-finger --board virtual --count 16",
            &["--board", "--hand idealised"],
        ),
        (
            "--object ellipse:0.1x0.06 --criterion variance --until gain:0.1",
            &["gain:0.1", "nats", "variance"],
        ),
    ] {
        place.tactile(&format!("explore {options} --out out")).refused(words);
    }
    assert!(place.names().is_empty());
}

#[test]
fn what_is_wrong_is_named_with_its_field() {
    let place = Place::new();
    let grasp = |contact: &str| below(&format!(r#"{{"grasp":0,"contacts":[{contact}]}}"#));
    let moved = |fields: &str| below(&format!(r#"{{"grasp":0,"contacts":[],{fields}}}"#));
    let header = |fields: Value| log(2, fields, &[json!({"grasp": 0, "contacts": []})]);
    for (content, words) in [
        (grasp(r#"{"point":[1e999,0]}"#), &["line 2", "field `point`", "finite number"] as &[_]),
        (grasp(r#"{"point":[0,NaN]}"#), &["line 2", "field `point`", "finite number"]),
        (grasp(r#"{"point":[0,-Infinity]}"#), &["line 2", "column", "field `point`"]),
        (grasp(r#"{"point":[0,null]}"#), &["field `contacts[0].point[1]`", "finite number"]),
        (grasp(r#"{"point":[0,"1"]}"#), &["field `contacts[0].point[1]`", "found \"1\""]),
        (grasp(r#"{"point":[0,1e6]}"#), &["field `contacts[0].point`", "within ±10000"]),
        (grasp(r#"{"point":[0,0]},{"point":[0]}"#), &["`contacts[1].point`", "[x, y]"]),
        (grasp(r#"{"point":[0,0],"normal":[0,0,1]}"#), &["`contacts[0].normal`", "[x, y]"]),
        (grasp(r#"{"point":[0,0],"normal_noise":0}"#), &["`contacts[0].normal_noise`", "positive"]),
        (grasp("7"), &["field `contacts[0]`", "expected an object", "found 7"]),
        (moved(r#""motion":{"translation":[0,0]}"#), &["`motion.rotation`", "radians", "nothing"]),
        (moved(r#""motion":{"translation":[0,0],"rotation":[0,0,0,1]}"#), &["`motion.rotation`"]),
        (moved(r#""truth":{"pose":{"rotation":0}}"#), &["`truth.pose.translation`", "nothing"]),
        (moved(r#""free":[{"point":[0,0,0]}]"#), &["`free[0].point`", "an array of 3"]),
        (moved(r#""time":-1"#), &["line 2", "field `time`", "not negative"]),
        (header(json!({"noise": {"point": -1}})), &["line 1", "`noise.point`", "positive"]),
        (header(json!({"noise": {"point": 1e300}})), &["line 1", "`noise.point`", "up to 10000"]),
        (header(json!({"frame": "hand"})), &["line 1", "`frame`", "\"world\""]),
        (header(json!({"fingers": ["ff", "ff"]})), &["`fingers[1]`", "not used before"]),
        (header(json!({"truth": {"shape": {"mesh": "a.ply"}}})), &["`truth.shape.polygon`"]),
        (below(r#"{"grasp":-1,"contacts":[]}"#), &["line 2", "`grasp`", "found -1"]),
        (below(r#"{"grasp":0,"contacts":[]} x"#), &["line 2", "trailing characters"]),
        (below(&"[".repeat(100_000)), &["line 2", "recursion limit"]),
        (below(&"x".repeat(17 << 20)), &["line 2", "longer than 16777216 bytes"]),
    ] {
        place.put("bad.jsonl", content);
        for command in ["slam bad.jsonl --out r", "inspect bad.jsonl"] {
            place.tactile(command).refused(&["bad.jsonl, line"]).says(words);
        }
    }
    let broken = log(
        3,
        json!({}),
        &[json!({"grasp": 0, "contacts": [], "motion":
        {"translation": [0, 0, 0], "rotation": [0, 0, 0, 2]}})],
    );
    place.put("bad.jsonl", broken);
    let words = ["field `motion.rotation`", "unit quaternion", "length 2"];
    place.tactile("slam bad.jsonl --out r").refused(&words);
    let live = "live --port virtual --log bad.jsonl --out r --record r.tac";
    place.tactile(live).refused(&words);
}

#[test]
fn a_normal_within_a_thousandth_is_made_one() {
    let place = Place::new();
    let stretched = |by: f64| {
        let mut contacts = round(2, 0.05, 8);
        for contact in &mut contacts {
            for x in contact["normal"].as_array_mut().unwrap() {
                *x = json!(x.as_f64().unwrap() * by);
            }
        }
        log(2, json!({}), &[grasp(0, &contacts)])
    };
    let contour = |by: f64| {
        place.put("n.jsonl", stretched(by));
        place.tactile("slam n.jsonl --out r").done();
        let outline = tactile_host::shape::files::read_outline(&place.at("r/contour.csv")).unwrap();
        outline.loops.concat()
    };
    let (exact, longer) = (contour(1.0), contour(1.0009));
    assert!(exact.len() > 50 && exact.len() == longer.len());
    for (a, b) in exact.iter().zip(&longer) {
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-8, "{a:?} {b:?}");
    }
    place.put("n.jsonl", stretched(1.0011));
    place
        .tactile("slam n.jsonl --out r")
        .refused(&["`contacts[0].normal`", "length 1 within 0.001"]);
}

#[test]
fn noise_of_bytes_is_no_log_and_no_table() {
    let place = Place::new();
    let mut state = 1u32;
    let bytes: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
    .take(20_000)
    .collect();
    for name in ["b.jsonl", "b.tac", "b.txt", "b.ply", "b.stl", "b.obj", "b.off"] {
        place.put(name, &bytes);
    }
    place.put("half.jsonl", [good().as_bytes(), b"\n", &bytes].concat());
    for line in [
        "slam b.jsonl --out r",
        "slam half.jsonl --out r",
        "live --port virtual --log b.jsonl --out r --record r.tac",
        "inspect b.jsonl",
        "inspect b.tac",
        "replay b.tac -o r.jsonl",
        "replay b.tac --to csv -o r.csv",
        "import push b.txt -o r.jsonl",
        "import csv b.txt -o r.jsonl",
        "import off b.off -o r.jsonl",
        "simulate --object polygon:b.txt -o r.jsonl",
        "simulate --object b.ply -o r.jsonl",
        "simulate --object b.stl -o r.jsonl",
        "simulate --object b.obj -o r.jsonl",
        "simulate --object b.off -o r.jsonl",
    ] {
        let file = if line.contains("half") { "half.jsonl, line 3" } else { "b." };
        place.tactile(line).refused(&["error: ", file]);
    }
}

#[test]
fn what_cannot_be_read_is_named() {
    let place = Place::new();
    place.put("file", "x");
    std::fs::create_dir(place.at("folder.jsonl")).unwrap();
    for (input, why) in [
        ("none.jsonl", "cannot read"),
        ("file/below.jsonl", "cannot read"),
        ("/dev/no/such.jsonl", "cannot read"),
        ("folder.jsonl", "folder"),
    ] {
        for line in [format!("slam {input} --out r"), format!("inspect {input}")] {
            place.tactile(&line).refused(&[input, why]);
        }
    }
    for input in ["none", "file/below", "folder.jsonl", "/dev/no/such"] {
        for line in [
            format!("import push {input} -o r.jsonl"),
            format!("import csv {input} -o r.jsonl"),
            format!("import off {input} -o r.jsonl"),
            format!("simulate --object polygon:{input} -o r.jsonl"),
        ] {
            place.tactile(&line).refused(&[input, "cannot read"]);
        }
        let why = if input == "folder.jsonl" { "is a folder" } else { "cannot read" };
        place.tactile(&format!("replay {input} -o r.jsonl")).refused(&[input, why]);
    }
}

#[test]
fn what_cannot_be_written_is_named_and_nothing_else_is_written() {
    let place = Place::new();
    place.put("good.jsonl", good());
    place.put("points.csv", "x,y\n0.1,0\n0,0.1\n-0.1,0\n");
    place.put("file", "x");
    std::fs::create_dir(place.at("folder")).unwrap();
    for output in ["folder", "file/below.jsonl", "none/below.jsonl", "/dev/no/such.jsonl"] {
        for line in [
            format!("simulate --object hexagon:0.05 -o {output}"),
            format!("simulate --object sphere:0.05 -o {output}"),
            format!("import csv points.csv -o {output}"),
        ] {
            place.tactile(&line).refused(&[output.trim_end_matches(".jsonl")]);
        }
    }
    for (out, named) in [("file", "file:"), ("file/below", "file:"), ("file/a/b", "file:")] {
        for line in ["slam good.jsonl", "live --port virtual --log good.jsonl --record r.tac"] {
            let words = [named, "expected a folder for the results, found a file"];
            place.tactile(&format!("{line} --out {out}")).refused(&words);
        }
    }
    // A folder where one of the results would be: not even the others are written.
    for name in
        ["report.json", "contour.csv", "trajectory.tum", "graph.g2o", "summary.png", "replay.mcap"]
    {
        std::fs::create_dir_all(place.at("r").join(name)).unwrap();
        place.tactile("slam good.jsonl --out r").refused(&[name, "found a folder"]);
        std::fs::remove_dir_all(place.at("r")).unwrap();
    }
    assert_eq!(std::fs::read_to_string(place.at("file")).unwrap(), "x");
    // Folders that do not exist yet are made.
    place.tactile("slam good.jsonl --out a/b/c").done();
    assert!(place.at("a/b/c/report.json").is_file());
}

#[test]
fn a_refused_run_keeps_the_results_of_the_one_before() {
    let place = Place::new();
    place.put("good.jsonl", good());
    place.tactile("slam good.jsonl --out r").done();
    let report = || std::fs::read(place.at("r/report.json")).unwrap();
    let before = report();
    place.put("bad.jsonl", below("garbage"));
    place.tactile("slam bad.jsonl --out r").refused(&["bad.jsonl, line 2"]);
    place.tactile("slam good.jsonl --poses truth --out r").refused(&["truth.pose is missing"]);
    for option in ["--tracker curved", "--seed 5"] {
        let line = format!("slam good.jsonl --poses truth {option} --out r");
        place.tactile(&line).refused(&["only with --poses estimated"]);
    }
    assert_eq!(report(), before);
    place.tactile("import csv bad.jsonl -o good.jsonl").refused(&["bad.jsonl, line 1"]);
    assert_eq!(std::fs::read_to_string(place.at("good.jsonl")).unwrap(), good());
}

#[test]
fn logs_without_contacts_have_nothing_to_show() {
    let place = Place::new();
    place.put("empty.jsonl", log(3, json!({}), &[grasp(0, &[]), grasp(1, &[])]));
    place.tactile("slam empty.jsonl --out r").refused(&["empty.jsonl: no contacts"]);
    place.tactile("inspect empty.jsonl").done();
    // One grasp that closed on nothing is no fault.
    let ball = round(3, 0.05, 12);
    place.put("some.jsonl", log(3, json!({}), &[grasp(0, &[]), grasp(1, &ball), grasp(2, &[])]));
    let report = place.tactile("slam some.jsonl --json").done().json();
    assert_eq!((&report["grasps"], &report["contacts"]), (&json!(3), &json!(12)));
    assert_eq!(report["lost"], json!([]));
}

#[test]
fn poor_contacts_end_well() {
    let place = Place::new();
    let same = |normal: Value| -> Vec<Value> {
        (0..5).map(|_| json!({"point": [0.02, 0.0], "normal": normal})).collect()
    };
    let line: Vec<Value> = (0..8).map(|i| json!({"point": [0.01 * f64::from(i), 0.0]})).collect();
    let apart = [
        json!({"point": [-9e3, 0], "normal": [-1, 0]}),
        json!({"point": [9e3, 0], "normal": [1, 0]}),
    ];
    let mut inward = round(2, 0.05, 8);
    for contact in &mut inward {
        for x in contact["normal"].as_array_mut().unwrap() {
            *x = json!(-x.as_f64().unwrap());
        }
    }
    for (what, contacts) in [
        ("one point", same(json!([1, 0]))),
        ("one point, no normals", same(Value::Null)),
        ("a line, no normals", line),
        ("18 km apart", apart.to_vec()),
        ("normals inward", inward),
    ] {
        let second = json!({"grasp": 1, "contacts": contacts,
            "motion": {"translation": [1e-3, 0], "rotation": -6.2}});
        place.put("poor.jsonl", log(2, json!({}), &[grasp(0, &contacts), second]));
        let report = place.tactile("slam poor.jsonl --json").done().json();
        assert_eq!(report["contacts"], 2 * contacts.len(), "{what}");
    }
    let tiny = json!({"noise": {"point": 1e-300, "normal": 1e-300, "translation": 1e-300,
        "rotation": 1e-300}});
    let ring = round(2, 0.05, 8);
    place.put("sure.jsonl", log(2, tiny, &[grasp(0, &ring), grasp(1, &ring)]));
    let report = place.tactile("slam sure.jsonl --json").done().json();
    assert!(report["contact_rms_mm"].as_f64().unwrap() < 1.0, "{report}");
}

#[test]
fn absurd_sizes_end_well() {
    let place = Place::new();
    for radius in [1e-9, 1e-4, 1e3] {
        for dimension in [2, 3] {
            let grasps =
                [grasp(0, &round(dimension, radius, 12)), grasp(1, &round(dimension, radius, 12))];
            place.put("size.jsonl", log(dimension, json!({}), &grasps));
            let run = place.tactile("slam size.jsonl --out r --json").done();
            // Where contacts a thousand times finer than their noise leave no surface, it says so.
            let nothing = run.json()["contact_rms_mm"].is_null();
            assert_eq!(run.err.contains("the shape is empty"), nothing, "{radius}: {}", run.err);
            assert!(!nothing || radius < 1e-2, "{radius} m");
        }
    }
}

#[test]
fn a_true_shape_that_cannot_be_used_is_a_warning() {
    let place = Place::new();
    let ball = [json!({"grasp": 0, "contacts": round(3, 0.05, 12),
        "truth": {"pose": {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}}})];
    place.put("bad.ply", "ply\nnonsense");
    for mesh in ["none.ply", "bad.ply"] {
        place.put("t.jsonl", log(3, json!({"truth": {"shape": {"mesh": mesh}}}), &ball));
        let run = place.tactile("slam t.jsonl --json").done();
        let run = run.says(&["warning: t.jsonl: truth.shape.mesh", mesh, "left out"]);
        let report = run.json();
        for field in ["hausdorff_mm", "hausdorff_aligned_mm", "mean_mm", "rms_mm"] {
            assert_eq!(report["surface"].get(field), Some(&Value::Null), "{field}");
        }
        assert_eq!(report["pose"]["final_translation_mm"], 0.0, "poses have their truth still");
    }
    let flat = json!({"truth": {"shape": {"polygon": [[0, 0], [1, 0], [2, 0]]}}});
    place.put("t.jsonl", log(2, flat, &[grasp(0, &round(2, 0.05, 8))]));
    place.tactile("slam t.jsonl --json").done().says(&["warning", "truth.shape.polygon"]);
}

#[test]
fn no_truth_gives_null_errors() {
    let place = Place::new();
    place.put("good.jsonl", good());
    let run = place.tactile("slam good.jsonl --json").done();
    assert_eq!(run.err, "");
    let report = run.json();
    assert_eq!(report["pose"]["per_grasp"], json!([]));
    for field in
        ["final_translation_mm", "final_rotation_deg", "rms_translation_mm", "rms_rotation_deg"]
    {
        assert_eq!(report["pose"].get(field), Some(&Value::Null), "{field}");
    }
}

#[test]
fn contacts_that_the_shape_does_not_explain_are_told() {
    let place = Place::new();
    let at = |pose: Value, mut grasp: Value| {
        grasp["truth"] = json!({ "pose": pose });
        grasp
    };
    let flat = json!({"translation": [0, 0], "rotation": 0});
    let ring = round(2, 0.05, 24);
    let mut grasps: Vec<Value> =
        (0..3).map(|k| at(flat.clone(), grasp(k, &ring[8 * k..][..8]))).collect();
    let inside = [([0.01, 0.0], [0, 1]), ([-0.01, 0.005], [1, 0]), ([0.0, -0.01], [-1, 0])];
    let inside = inside.map(|(point, normal)| json!({"point": point, "normal": normal}));
    grasps.push(at(flat, grasp(7, &inside)));
    place.put("odd.jsonl", log(2, json!({}), &grasps));
    let run = place.tactile("slam odd.jsonl --poses truth --out r").done();
    assert!(run.err.contains("no contact of grasp 7 is near the shape"), "{}", run.err);
    assert!(run.out.contains("unexplained contacts             3  far from the shape, in grasp 7"));
    let report = place.tactile("slam odd.jsonl --poses truth --json --out r").done().json();
    let expected = json!({"contacts": 3, "grasps": [7], "wholly": [7]});
    assert_eq!(report["unexplained"], expected);
    // In space, and all at one height.
    let level = json!({"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]});
    let raised: Vec<Value> = ring
        .iter()
        .map(|c| {
            let up = |v: &Value| json!([v[0], v[1], 0]);
            json!({"point": up(&c["point"]), "normal": up(&c["normal"])})
        })
        .collect();
    place.put("flat.jsonl", log(3, json!({}), &[at(level, grasp(0, &raised))]));
    let run = place.tactile("slam flat.jsonl --poses truth --out r").done();
    assert!(run.err.contains("all contacts lie in one plane"), "{}", run.err);
}

#[test]
fn many_contacts_in_one_grasp_fit_or_are_refused() {
    let place = Place::new();
    // The most a grasp may have, far more than the tracker keeps.
    place.put("full.jsonl", log(2, json!({}), &[grasp(0, &round(2, 0.05, 1024))]));
    let report = place.tactile("slam full.jsonl --json").done().json();
    assert_eq!(report["contacts"], 1024);
    assert!(report["contact_rms_mm"].as_f64().unwrap() < 0.5, "{report}");
    place.put("over.jsonl", log(2, json!({}), &[grasp(0, &round(2, 0.05, 1025))]));
    let words = ["line 2, field `contacts`", "at most 1024 contacts", "found 1025"];
    place.tactile("slam over.jsonl --out r").refused(&words);
    let mut table = String::from("x,y\n");
    for k in 0..10_000 {
        writeln!(table, "0.1,{}", 1e-5 * f64::from(k)).unwrap();
    }
    place.put("over.csv", table);
    let words = ["over.csv, line 1026", "at most 1024 contacts"];
    place.tactile("import csv over.csv -o r.jsonl").refused(&words);
}

#[test]
fn quantities_have_their_units_and_bounds() {
    let place = Place::new();
    let simulate = |words: &str, expected: &[&str]| {
        place
            .tactile(&format!("simulate --object sphere:0.1 -o r.jsonl {words}"))
            .refused(expected);
    };
    simulate("--contact-noise 5deg,1mm", &["--contact-noise", "5deg", "which is an angle"]);
    simulate("--contact-noise 1mm", &["--contact-noise", "a length and an angle"]);
    simulate("--contact-noise=-1mm,5deg", &["--contact-noise", "not negative"]);
    simulate("--contact-noise -1mm,5deg", &["--contact-noise", "not negative"]);
    simulate("--motion-noise -1mm,5deg", &["--motion-noise", "not negative"]);
    simulate("--outliers -0.1", &["--outliers", "from 0 to 1"]);
    simulate("--motion-noise nan,1", &["--motion-noise", "nan"]);
    simulate("--motion-noise 1furlong,1", &["--motion-noise", "furlong", "mm, cm"]);
    // Contacts that far off would make a log that no reader takes.
    simulate("--motion-noise 1e9,1", &["--motion-noise", "up to 1 m"]);
    simulate("--contact-noise 1mm,1e9", &["--contact-noise", "360°"]);
    simulate("--outliers 1.5", &["--outliers", "from 0 to 1"]);
    simulate("--contacts 6", &["--contacts", "at most 5 with --touch hand"]);
    simulate("--grasps 100000000", &["--grasps", "10 000 000"]);
    simulate("--seed 1.5", &["--seed"]);
    for (object, expected) in [
        ("sphere:5deg", "which is an angle"),
        ("sphere:10parsec", "parsec"),
        ("sphere:1e-9", "from 0.1 mm to 10 m"),
        ("sphere:1e3", "from 0.1 mm to 10 m"),
        ("sphere:0", "above zero"),
        ("rectangle:1", "rectangle:WxH"),
        ("ellipse:infx1", "inf"),
        ("ngon:2,0.1", "3 to 1000 corners"),
        ("hexagon:", "hexagon:R"),
        ("teapot", "unknown object"),
    ] {
        let line = format!("simulate --object {object} -o r.jsonl");
        place.tactile(&line).refused(&["--object", object, expected]);
    }
    place.put("c.csv", "x,y\n1,2\n");
    place.tactile("import csv c.csv --unit rad -o r.jsonl").refused(&["--unit", "unit of length"]);
    place.tactile("import csv c.csv --contact-noise 2,1 -o r.jsonl").refused(&["up to 1 m"]);
}

#[test]
fn bad_tables_and_recordings_are_refused_with_their_line() {
    let place = Place::new();
    for (kind, content, words) in [
        ("csv", "", &["is empty"] as &[_]),
        ("csv", "x,y\n", &["line 1", "one line per contact"]),
        ("csv", "x,y\n1,2\nnan,3\n", &["line 3", "column `x`", "finite number"]),
        ("csv", "x,y\n1,2\n3,1e999\n", &["line 3", "column `y`", "finite number"]),
        ("csv", "x,y,nx,ny\n1,2,0,0\n", &["line 2", "column `nx`", "length 1 within 0.001"]),
        ("csv", "x,y,z\n1,2\n", &["line 2", "expected 3 cells"]),
        ("off", "", &["line 1", "the word OFF"]),
        ("off", "OFF\n9999 0 0\n", &["line 2", "at most 1024"]),
        ("off", "OFF\n1 0 0\n1 2 nan\n", &["line 3", "z of point 0"]),
        ("push", "", &["line 1", "the number of pushes"]),
        ("push", "0\n", &["line 1", "at least one push"]),
        ("push", "99999999999\n", &["line 1", "the number of pushes"]),
        ("push", "1\n1 2 3\n", &["line 2", "push 0 of 1", "the end of the file"]),
    ] {
        place.put("t.txt", content);
        place.tactile(&format!("import {kind} t.txt -o r.jsonl")).refused(&["t.txt"]).says(words);
    }
    for content in ["", "tac", &good()] {
        place.put("t.tac", content);
        place.tactile("replay t.tac -o r.jsonl").refused(&["t.tac: not a recording"]);
        place.tactile("inspect t.tac").refused(&["t.tac: not a recording"]);
        place.tactile("replay t.tac --to mcap -o r.mcap").refused(&["t.tac: not a recording"]);
    }
}

/// Whoever opens the page learns what is the matter with the file.
#[test]
fn a_page_says_that_there_is_nothing_to_show() {
    let place = Place::new();
    for (file, content, words) in [
        ("t.tac", "tac", "t.tac: not a recording"),
        ("t.tac", "", "it is empty"),
        ("t.jsonl", "", "is empty; expected a header line"),
        ("t.jsonl", &good()[..40], "line 1: is cut off"),
    ] {
        place.put(file, content);
        place.tactile(&format!("replay {file} --to html -o t.html")).done().says(&[words]);
        let page = std::fs::read_to_string(place.at("t.html")).unwrap();
        let scene = page.split_once("id=\"scene\">").unwrap().1;
        assert!(scene.contains("There is nothing to show.") && scene.contains(words), "{scene}");
    }
    place.tactile("replay none.tac --to html -o none.html").refused(&["none.tac: cannot read"]);
}
