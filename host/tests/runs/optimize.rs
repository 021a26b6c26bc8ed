//! `tactile optimize`: small graphs made here, in whole runs.

use std::fmt::Write as _;

use crate::binary::Place;

/// A square ring of `4·n` poses a metre apart, whose poses in the file drift away from a start at
/// (1, 2) that stays; measurements are exact but for what `extra` adds.
fn ring(n: usize, extra: &str) -> String {
    let mut text = "# a square\nPARAMS_SE2OFFSET 0 0 0 0\n".to_owned();
    let count = 4 * n;
    for k in 0..count {
        let (side, step) = (k / n, (k % n) as f64);
        let (x, y) =
            [(step, 0.0), (n as f64, step), (n as f64 - step, n as f64), (0.0, n as f64 - step)]
                [side];
        let drift = 0.02 * k as f64;
        let angle = std::f64::consts::FRAC_PI_2 * side as f64 + 0.3 * drift;
        writeln!(text, "VERTEX_SE2 {} {} {} {angle}", 10 * k, 1.0 + x + drift, 2.0 + y - drift)
            .unwrap();
    }
    for k in 0..count {
        let turn = if k % n == n - 1 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
        let next = 10 * ((k + 1) % count);
        writeln!(text, "EDGE_SE2 {} {next} 1 0 {turn} 100 0 0 100 0 400", 10 * k).unwrap();
    }
    text + "FIX 0\n" + extra
}

/// Closures between poses two and three steps apart, all in agreement.
fn closures() -> String {
    let mut text = String::new();
    for k in [0, 1, 2, 5, 6, 7, 10, 11, 12, 15, 16, 17] {
        writeln!(text, "EDGE_SE2 {} {} 2 0 0 100 0 0 100 0 400", 10 * k, 10 * (k + 2)).unwrap();
    }
    text
}

/// Numbers of the line that begins so.
fn numbers(text: &str, start: &str) -> Vec<f64> {
    let line =
        text.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start}"));
    line[start.len()..].split_whitespace().map(|word| word.parse().unwrap()).collect()
}

#[test]
fn a_drifted_ring_is_closed() {
    let place = Place::new();
    place.put("ring.g2o", ring(5, ""));
    for options in
        ["", "--init file", "--init odometry --method dogleg", "--method levenberg-marquardt"]
    {
        let run =
            place.tactile(&format!("optimize ring.g2o -o closed.g2o --json {options}")).done();
        let run = run.says(&["ring.g2o: 1 lines PARAMS_SE2OFFSET are not understood", "line 2"]);
        let json = run.json();
        let fields: Vec<_> = json.as_object().unwrap().keys().take(5).map(String::as_str).collect();
        assert_eq!(fields, ["initial_chi2", "final_chi2", "iterations", "seconds", "certified"]);
        assert!(json["initial_chi2"].as_f64().unwrap() > 10.0, "{json}");
        assert!(json["final_chi2"].as_f64().unwrap() < 1e-12, "{json}");
        assert!(json["seconds"].as_f64().unwrap() > 0.0);
        assert_eq!(json["certified"], true, "{json}");
        assert_eq!(
            (&json["poses"], &json["edges"], &json["dimension"]),
            (&20.into(), &20.into(), &2.into())
        );

        let text = std::fs::read_to_string(place.at("closed.g2o")).unwrap();
        // Ids, order, what stays, the edges and what is not understood are as they were.
        assert_eq!(text.lines().next(), Some("PARAMS_SE2OFFSET 0 0 0 0"));
        let kinds: Vec<&str> = text.lines().skip(1).map(|l| l.split(' ').next().unwrap()).collect();
        assert_eq!(
            [kinds[0], kinds[19], kinds[20], kinds[21], kinds[40]],
            ["VERTEX_SE2", "VERTEX_SE2", "FIX", "EDGE_SE2", "EDGE_SE2"]
        );
        assert_eq!(numbers(&text, "FIX"), [0.0]);
        assert_eq!(numbers(&text, "VERTEX_SE2 0 "), [1.0, 2.0, 0.0]);
        let corner = numbers(&text, "VERTEX_SE2 100 ");
        assert!((corner[0] - 6.0).abs() < 1e-6 && (corner[1] - 7.0).abs() < 1e-6, "{corner:?}");
        assert_eq!(numbers(&text, "EDGE_SE2 190 0 ")[3..], [100.0, 0.0, 0.0, 100.0, 0.0, 400.0]);
    }
    // The result is a graph like any other, and the file may be written over itself.
    let again = place.tactile("optimize closed.g2o -o closed.g2o").done();
    for words in [
        "20 poses, 20 edges in 2 dimensions",
        "certified",
        "graph with its new poses in closed.g2o",
    ] {
        assert!(again.out.contains(words), "{}", again.out);
    }
}

#[test]
fn what_is_not_understood_stays_in_the_graph() {
    let place = Place::new();
    let landmark = "VERTEX_XY 7 1.50 2\n EDGE_SE2_XY 0 7 1 2 1 0 1\n";
    place.put("ring.g2o", ring(2, landmark));
    let run = place.tactile("optimize ring.g2o -o out.g2o").done();
    run.says(&["VERTEX_XY are not understood", "out.g2o: has the lines", "as they were"]);
    let text = std::fs::read_to_string(place.at("out.g2o")).unwrap();
    let at = |line: &str| text.lines().position(|l| l == line).unwrap_or_else(|| panic!("{text}"));
    assert!(at("VERTEX_XY 7 1.50 2") < at("FIX 0"), "{text}");
    assert!(at(" EDGE_SE2_XY 0 7 1 2 1 0 1") > at("FIX 0"), "{text}");
}

#[test]
fn edges_alone_and_space_will_do() {
    let place = Place::new();
    let edge = |from: u32, to: u32| {
        format!(
            "EDGE_SE3:QUAT {from} {to} 1 0 0 0 0 1 0 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n"
        )
    };
    // A half turn about z on the way there and another on the way back.
    place.put("two.g2o", edge(3, 8) + &edge(8, 3));
    let json = place.tactile("optimize two.g2o -o out.g2o --json").done().json();
    assert!(json["final_chi2"].as_f64().unwrap() < 1e-12, "{json}");
    let text = std::fs::read_to_string(place.at("out.g2o")).unwrap();
    assert!((numbers(&text, "VERTEX_SE3:QUAT 8 ")[0] - 1.0).abs() < 1e-9, "{text}");
    place
        .tactile("optimize two.g2o --init file")
        .refused(&["--init file: two.g2o has edges alone"]);
    place.put("one.g2o", "VERTEX_SE2 5 1 2 3\n");
    let json = place.tactile("optimize one.g2o --json").done().json();
    assert_eq!((&json["final_chi2"], &json["certified"]), (&0.0.into(), &true.into()));
}

#[test]
fn a_wrong_loop_is_named_and_robustness_ignores_it() {
    let place = Place::new();
    let wrong = "EDGE_SE2 0 100 1 1 0 1 0 0 1 0 1\n";
    place.put("wrong.g2o", ring(5, wrong));
    let corner = || {
        let text = std::fs::read_to_string(place.at("out.g2o")).unwrap();
        let corner = numbers(&text, "VERTEX_SE2 100 ");
        (corner[0] - 6.0).hypot(corner[1] - 7.0)
    };
    let plain = place.tactile("optimize wrong.g2o -o out.g2o --json").done();
    let plain = plain.says(&["edges disagree", "the worst is 0 → 100"]);
    assert_eq!(plain.json()["worst_edges"][0]["to"], 100);
    let dragged = corner();
    for robust in ["geman-mcclure", "tukey:6", "dcs", "cauchy:1"] {
        let line = format!("optimize wrong.g2o -o out.g2o --init file --json --robust {robust}");
        let json = place.tactile(&line).done().json();
        assert!(corner() < 0.5 * dragged, "{robust}: {} {json}", corner());
        assert_eq!(json["certified"], false);
    }
}

#[test]
fn wrong_closures_are_left_out() {
    let place = Place::new();
    let wrong =
        "EDGE_SE2 20 100 1 1 0 100 0 0 100 0 400\nEDGE_SE2 150 60 0 0 2 100 0 0 100 0 400\n";
    place.put("wrong.g2o", ring(5, &(closures() + wrong)));
    let json = place.tactile("optimize wrong.g2o -o out.g2o --robust gnc --json").done().json();
    let outliers = json["outliers"].as_array().unwrap();
    for (from, to) in [(20, 100), (150, 60)] {
        assert!(outliers.iter().any(|o| o["from"] == from && o["to"] == to), "{json}");
    }
    // And nothing else: the ring's own closure, 190 → 0, stays.
    assert_eq!(outliers.len(), 2, "{json}");
    assert!(json["final_cost"].as_f64().unwrap() < 1e-9, "{json}");
    assert_eq!(json["certified"], true);
    let text = std::fs::read_to_string(place.at("out.g2o")).unwrap();
    let corner = numbers(&text, "VERTEX_SE2 100 ");
    assert!((corner[0] - 6.0).hypot(corner[1] - 7.0) < 1e-5, "{corner:?}");
    for (option, value) in [("--init", "file"), ("--method", "dogleg"), ("--iterations", "5")] {
        let line = format!("optimize wrong.g2o --robust gnc {option} {value}");
        place.tactile(&line).refused(&[&format!("{option}: --robust gnc")]);
    }
}

#[test]
fn bad_graphs_are_refused_and_odd_ones_remarked() {
    let place = Place::new();
    for (content, words) in [
        ("", &["bad.g2o: expected lines VERTEX_SE2", "found none"] as &[_]),
        ("VERTEX_SE2 0 0 0 nan\n", &["bad.g2o, line 1, angle: expected a finite number"]),
        (
            "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n",
            &["bad.g2o, line 2, to: ", "found 1"],
        ),
        (
            &ring(5, "EDGE_SE2 0 50 1 0 0 1 9 0 1 0 1\n"),
            &["bad.g2o, line 44, information: 1 of 21 edges", "0 → 50"],
        ),
        (&ring(5, "VERTEX_SE3:QUAT 7 0 0 0 0 0 0 1\n"), &["bad.g2o, line 44, kind: ", "not both"]),
    ] {
        place.put("bad.g2o", content);
        place.tactile("optimize bad.g2o -o out.g2o --json").refused(words);
    }
    place.put("ring.g2o", ring(2, ""));
    place.tactile("optimize missing.g2o").refused(&["missing.g2o: cannot read"]);
    place.tactile("optimize ring.g2o -o none/out.g2o").refused(&["the folder none does not exist"]);
    place.tactile("optimize ring.g2o -o .").refused(&["it is a folder"]);
    place.tactile("optimize ring.g2o --robust huber:0").refused(&["huber:K with a number K > 0"]);
    place.tactile("optimize ring.g2o --robust l1").refused(&["expected none, huber, cauchy"]);

    // Poses that nothing connects stay where they are, and it is said.
    let far: String = (1..9).map(|k| format!("VERTEX_SE2 9{k} 5 5 0\n")).collect();
    place.put("parts.g2o", ring(2, &far));
    let run = place.tactile("optimize parts.g2o --json").done();
    let run = run.says(&["no edge connects 8 poses to the other 8"]);
    assert_eq!(run.json()["parts"].as_array().unwrap().len(), 9);
}
