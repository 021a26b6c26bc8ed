//! What the commands do with good input.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde_json::Value;
use tactile_host::log::GraspLog;
use tactile_host::shape::files;

use crate::binary::Place;

/// Every object description there is, its dimension, and a bound of the coordinates of its contacts
/// in the object frame, metres: half its largest extent and some noise.
const OBJECTS: [(&str, u64, f64); 10] = [
    ("rectangle:0.12x0.06", 2, 0.07),
    ("triangle:60mm", 2, 0.07),
    ("hexagon:45mm", 2, 0.055),
    ("ngon:5,0.05", 2, 0.06),
    ("ellipse:12cmx0.06", 2, 0.07),
    ("polygon:house.csv", 2, 0.11),
    ("box:0.12x0.06x0.06", 3, 0.07),
    ("cylinder:0.06x0.12", 3, 0.07),
    ("sphere:0.08", 3, 0.05),
    ("ellipsoid:0.1x0.08x0.06", 3, 0.06),
];

/// The fields of report.json in their documented order.
const REPORT: [&str; 11] = [
    "grasps",
    "contacts",
    "dimension",
    "tracker",
    "surface",
    "pose",
    "contact_rms_mm",
    "unexplained",
    "seconds",
    "lost",
    "ambiguous",
];

fn figure(report: &Value, path: &str) -> f64 {
    let value = report.pointer(path).unwrap_or_else(|| panic!("{path} is missing: {report}"));
    value.as_f64().unwrap_or_else(|| panic!("{path}: {value}"))
}

/// The report without what differs from run to run.
fn timeless(mut report: Value) -> Value {
    assert!(report["seconds"].as_object().is_some_and(|s| !s.is_empty()));
    report["seconds"] = Value::Null;
    report
}

/// Checks that a folder has all results of a run with known truth, and gives its report.
fn results(place: &Place, folder: &str, printed: &Value) -> Value {
    let at = |name: &str| place.at(folder).join(name);
    let report: Value = serde_json::from_slice(&std::fs::read(at("report.json")).unwrap()).unwrap();
    assert_eq!(&report, printed, "printed and written report");
    let fields: Vec<_> = report.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(fields, REPORT);
    for field in ["hausdorff_mm", "hausdorff_aligned_mm", "mean_mm", "rms_mm"] {
        assert!(figure(&report, &format!("/surface/{field}")) > 0.0, "{field}");
    }
    let (mean, rms) = (figure(&report, "/surface/mean_mm"), figure(&report, "/surface/rms_mm"));
    assert!(mean <= rms && rms <= figure(&report, "/surface/hausdorff_mm"), "{report}");
    let grasps = report["grasps"].as_u64().unwrap() as usize;
    let poses = report["pose"]["per_grasp"].as_array().unwrap();
    assert_eq!(poses.len(), grasps);
    let last = poses.last().unwrap();
    assert_eq!(last["translation_mm"], report["pose"]["final_translation_mm"]);
    assert_eq!(last["rotation_deg"], report["pose"]["final_rotation_deg"]);
    for field in ["rms_translation_mm", "rms_rotation_deg"] {
        assert!(figure(&report, &format!("/pose/{field}")) >= 0.0);
    }

    let trajectory = std::fs::read_to_string(at("trajectory.tum")).unwrap();
    let poses: Vec<&str> = trajectory.lines().filter(|l| !l.starts_with('#')).collect();
    assert_eq!(poses.len(), grasps);
    for pose in poses {
        let numbers: Vec<f64> = pose.split(' ').map(|n| n.parse().unwrap()).collect();
        assert!(numbers.len() == 8 && numbers.iter().all(|n| n.is_finite()), "{pose}");
        let length = numbers[4..].iter().map(|n| n * n).sum::<f64>();
        assert!((length - 1.0).abs() < 1e-6, "{pose}");
    }
    let graph = std::fs::read_to_string(at("graph.g2o")).unwrap();
    let count = |kind: &str| graph.lines().filter(|line| line.starts_with(kind)).count();
    assert_eq!([count("VERTEX_SE"), count("EDGE_SE"), count("FIX")], [grasps, grasps - 1, 1]);

    let picture = std::fs::read(at("summary.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG\r\n") && picture.len() > 10_000);
    if report["dimension"] == 2 {
        let outline = files::read_outline(&at("contour.csv")).unwrap();
        // A polygon of faces has as few as three corners.
        assert!(outline.loops.iter().map(Vec::len).sum::<usize>() >= 3);
        assert!(!at("shape.ply").exists());
    } else {
        let mesh = files::read_mesh(&at("shape.ply")).unwrap();
        assert!(mesh.triangles().len() >= 4);
        assert!(!at("contour.csv").exists());
    }
    report
}

/// `simulate`, `inspect` and `slam` of one object.
fn simulated(object: &str, dimension: u64, reach: f64) {
    let place = Place::new();
    place.put("house.csv", "0,0\n0.1,0\n0.1,0.05\n0.05,0.08\n0,0.05\n");
    place.tactile(&format!("simulate --object {object} --grasps 4 --seed 3 -o a.jsonl")).done();
    let inspected = place.tactile("inspect a.jsonl --json").done().json();
    assert_eq!(
        (&inspected["dimension"], &inspected["grasps"]["count"]),
        (&dimension.into(), &4.into())
    );
    let contacts = inspected["contacts"]["count"].as_u64().unwrap();
    assert!(contacts >= 12 && inspected["contacts"]["with_normal"] == contacts, "{contacts}");
    assert_eq!(
        (&inspected["truth"]["poses"], &inspected["motion"]["known"]),
        (&4.into(), &3.into())
    );
    for corner in inspected["contacts"]["object"].as_array().unwrap() {
        for x in corner.as_array().unwrap() {
            assert!(x.as_f64().unwrap().abs() < reach, "{object}: {corner}");
        }
    }
    let printed = place.tactile("slam a.jsonl --seed 5 --out r --json").done().says(&[]).json();
    let report = results(&place, "r", &printed);
    assert_eq!((&report["contacts"], &report["tracker"]), (&contacts.into(), &"auto".into()));
    assert!(figure(&report, "/surface/hausdorff_aligned_mm") < 60.0, "{report}");
    assert!(figure(&report, "/contact_rms_mm") < 15.0, "{report}");
}

#[test]
fn planar_objects_go_all_the_way() {
    for (object, dimension, reach) in OBJECTS.into_iter().filter(|o| o.1 == 2) {
        simulated(object, dimension, reach);
    }
}

#[test]
fn spatial_objects_go_all_the_way() {
    for (object, dimension, reach) in OBJECTS.into_iter().filter(|o| o.1 == 3) {
        simulated(object, dimension, reach);
    }
}

#[test]
fn a_mesh_file_is_an_object_too() {
    let place = Place::new();
    place.tactile("simulate --object box:0.12x0.06x0.06 --grasps 2 -o box.jsonl").done();
    let line = "simulate --object box.ply --grasps 3 --seed 1 -o again.jsonl";
    place.tactile(line).done();
    let log = GraspLog::read(&place.at("again.jsonl")).unwrap();
    assert_eq!((log.dimension, log.grasps.len()), (3, 3));
    let text = place.tactile("inspect again.jsonl").done().out;
    assert!(text.contains("3 poses") && !text.contains("missing"), "{text}");
}

#[test]
fn the_same_seed_gives_the_same_figures() {
    let place = Place::new();
    for (object, name) in [("hexagon:0.05", "h"), ("sphere:0.08", "s")] {
        for (seed, copy) in [(7, "a"), (7, "b"), (8, "c")] {
            let line = format!(
                "simulate --object {object} --grasps 4 --seed {seed} -o {name}{copy}.jsonl"
            );
            place.tactile(&line).done();
        }
        // The description names the seed and the mesh's name the file: the numbers are compared.
        let grasps =
            |copy: &str| GraspLog::read(&place.at(&format!("{name}{copy}.jsonl"))).unwrap().grasps;
        assert_eq!(grasps("a"), grasps("b"));
        assert_ne!(grasps("a"), grasps("c"));
        let slam = |seed: u64| {
            let line =
                format!("slam {name}a.jsonl --tracker bootstrap --seed {seed} --out r --json");
            timeless(place.tactile(&line).done().json())
        };
        let first = slam(4);
        assert_eq!(first, slam(4));
        assert_ne!(first, slam(5), "the seed reaches the tracker");
    }
}

#[test]
fn true_poses_give_the_true_shape() {
    let place = Place::new();
    let touch = "--touch uniform --grasps 1 --seed 2";
    place
        .tactile(&format!("simulate --object ellipse:120mmx60mm --contacts 15 {touch} -o e.jsonl"))
        .done();
    let printed = place.tactile("slam e.jsonl --poses truth --out e --json").done().json();
    let report = results(&place, "e", &printed);
    assert_eq!((&report["tracker"], &report["contacts"]), (&"truth".into(), &15.into()));
    assert!(figure(&report, "/surface/hausdorff_aligned_mm") < 6.0, "{report}");
    assert!(figure(&report, "/surface/mean_mm") < 2.0, "{report}");

    // With motion between grasps, true poses are exact and estimated ones are not.
    let line =
        "simulate --object box:0.12x0.06x0.06 --touch uniform --contacts 12 --grasps 5 -o b.jsonl";
    place.tactile(line).done();
    let printed = place.tactile("slam b.jsonl --poses truth --out b --json").done().json();
    let report = results(&place, "b", &printed);
    assert_eq!(figure(&report, "/pose/rms_translation_mm"), 0.0);
    assert_eq!(figure(&report, "/pose/rms_rotation_deg"), 0.0);
    assert!(figure(&report, "/surface/mean_mm") < 5.0, "{report}");
    assert!(figure(&report, "/contact_rms_mm") < 3.0, "{report}");
    let estimated = place.tactile("slam b.jsonl --out c --json").done().json();
    assert!(figure(&estimated, "/pose/rms_translation_mm") > 0.0);
}

#[test]
fn more_contacts_than_a_dense_surface_takes_are_no_obstacle() {
    let place = Place::new();
    let touch = "--touch uniform --contacts 1000 --grasps 8 --seed 4";
    place.tactile(&format!("simulate --object ellipse:120mmx60mm {touch} -o e.jsonl")).done();
    let printed = place.tactile("slam e.jsonl --poses truth --out e --json").done().json();
    let report = results(&place, "e", &printed);
    assert_eq!((&report["contacts"], &report["surface"]["model"]), (&8000.into(), &"gp".into()));
    // A millimetre of noise, averaged away.
    assert!(figure(&report, "/surface/hausdorff_aligned_mm") < 0.7, "{report}");
    assert!(figure(&report, "/surface/mean_mm") < 0.15, "{report}");
}

/// A push file of a block at changing poses, touched at the middle of its lower edge and along it.
fn pushes(count: usize) -> String {
    let mut text = format!("{count}\n");
    for k in 0..count {
        let (x, y, yaw) = (500.0 + 8.0 * k as f64, 100.0 - 5.0 * k as f64, 0.2 * k as f64);
        let (sin, cos) = yaw.sin_cos();
        let pose =
            |x: f64, y: f64, half: f64| format!("{x} {y} 10 {} 0 0 {}", half.cos(), half.sin());
        let along = 20.0 + 100.0 * k as f64 / (count - 1) as f64;
        let (tip_x, tip_y) = (x + along * cos, y + along * sin);
        // 3 N towards the block's +y, in the tool's frame, whose matrix is its own inverse.
        let s = -3.0 * std::f64::consts::FRAC_1_SQRT_2;
        let (fx, fy) = (s * (cos - sin), s * (-sin - cos));
        let start = 1e9 + 20.0 * k as f64;
        writeln!(text, "{}\n{}", pose(x, y - 9.0, yaw / 2.0), pose(x, y, yaw / 2.0)).unwrap();
        writeln!(text, "20").unwrap();
        for i in 0..20 {
            let on = if i < 8 { 0.0 } else { 1.0 };
            writeln!(text, "{} {} {}", start + 0.01 * i as f64, on * fx, on * fy).unwrap();
        }
        writeln!(text, "2\n{start} {}", pose(tip_x, tip_y - 9.0, 0.0)).unwrap();
        writeln!(text, "{} {}", start + 0.19, pose(tip_x, tip_y, 0.0)).unwrap();
    }
    text
}

#[test]
fn pushes_become_a_log_with_their_poses() {
    let place = Place::new();
    place.put("p.txt", pushes(11));
    place.tactile("import push p.txt -o p.jsonl").done();
    let log = GraspLog::read(&place.at("p.jsonl")).unwrap();
    assert_eq!((log.dimension, log.grasps.len()), (2, 11));
    for (k, grasp) in log.grasps.iter().enumerate() {
        let contact = &grasp.contacts[0];
        let pose = grasp.truth.unwrap();
        let local = pose.inverse_transform_point(&contact.point.into());
        assert!((local.x - 0.02 - 0.01 * k as f64).abs() < 1e-6 && local.y.abs() < 1e-6, "{local}");
        let normal = pose.inverse_transform_vector(&contact.normal.unwrap());
        assert!(normal.y < -0.99, "outward is away from the probe's push: {normal}");
    }
    let report = place.tactile("slam p.jsonl --poses truth --out p --json").done().json();
    assert_eq!(figure(&report, "/pose/rms_translation_mm"), 0.0);
    assert!(figure(&report, "/contact_rms_mm") < 1.0, "{report}");

    let noisy = "import push p.txt --poses noisy --motion-noise 10mm,20deg --group 5 --seed";
    let read = |name: &str| GraspLog::read(&place.at(name)).unwrap();
    for (seed, name) in [(1, "a.jsonl"), (1, "b.jsonl"), (2, "c.jsonl")] {
        place.tactile(&format!("{noisy} {seed} -o {name}")).done();
    }
    let grouped = read("a.jsonl");
    assert!(grouped.grasps.iter().all(|g| g.contacts.len() <= 5) && grouped.grasps.len() >= 2);
    assert_eq!(grouped, read("b.jsonl"));
    assert_ne!(grouped.grasps, read("c.jsonl").grasps);
    place.tactile("slam a.jsonl --out a --json").done();
}

#[test]
fn a_table_of_contacts_becomes_a_shape() {
    let place = Place::new();
    let mut table = String::from("x,y,z,nx,ny,nz,grasp,finger\n");
    for k in 0..24 {
        let (sin, cos) = (2.4 * k as f64).sin_cos();
        let z = (k as f64 - 11.5) / 12.0;
        let r = (1.0 - z * z).sqrt();
        let (x, y) = (r * cos, r * sin);
        let (px, py, pz, grasp) = (40.0 * x, 40.0 * y, 40.0 * z, k / 8);
        writeln!(table, "{px},{py},{pz},{x},{y},{z},{grasp},f{}", k % 8).unwrap();
    }
    place.put("ball.csv", table);
    let line = "import csv ball.csv --unit mm --contact-noise 1mm,5deg --fixed -o ball.jsonl";
    place.tactile(line).done();
    let report = place.tactile("slam ball.jsonl --poses truth --out o --json").done().json();
    assert_eq!((&report["grasps"], &report["contacts"]), (&3.into(), &24.into()));
    // No true shape: its errors are null, those of the poses are not.
    assert_eq!(report["surface"]["mean_mm"], Value::Null);
    assert_eq!(figure(&report, "/pose/final_translation_mm"), 0.0);
    let mesh = files::read_mesh(&place.at("o/shape.ply")).unwrap();
    for vertex in mesh.vertices() {
        assert!((vertex.norm() - 0.04).abs() < 0.004, "{vertex}");
    }
}

/// Where real recordings of a kind are, or a plain word that there are none.
fn data(kind: &str) -> Option<PathBuf> {
    let folder = tactile_host::data::folder().map(|d| d.join(kind)).filter(|d| d.is_dir());
    if folder.is_none() {
        eprintln!("skipped: no {kind} in $TACTILE_DATA");
    }
    folder
}

#[test]
fn real_contacts_with_a_moving_block_are_tracked() {
    let Some(folder) = data("push") else { return };
    let Some(file) = tactile_host::experiment::push::recordings(&folder).into_iter().next() else {
        return;
    };
    let place = Place::new();
    std::fs::copy(&file, place.at("p.txt")).unwrap();
    let line =
        "import push p.txt --poses noisy --motion-noise 10mm,20deg --group 5 --seed 3 -o p.jsonl";
    place.tactile(line).done();
    let printed = place.tactile("slam p.jsonl --seed 3 --out p --json").done().json();
    let report = results(&place, "p", &printed);
    assert!(figure(&report, "/pose/rms_translation_mm") < 60.0, "{report}");
}

#[test]
fn grasps_by_foreign_physics_run_to_the_end() {
    let Some(folder) = data("mujoco") else { return };
    let place = Place::new();
    for name in ["box_2d_s1", "hex_2d_s1", "box_3d_s1", "sphere_3d_s1"] {
        let file = folder.join(format!("{name}.jsonl"));
        if !file.exists() {
            eprintln!("skipped: no {}", file.display());
            continue;
        }
        std::fs::copy(&file, place.at("m.jsonl")).unwrap();
        let mesh = format!("{}.ply", name.split('_').next().unwrap_or(name));
        if folder.join(&mesh).exists() {
            std::fs::copy(folder.join(&mesh), place.at(&mesh)).unwrap();
        }
        let run = place.tactile("slam m.jsonl --out m --json").done();
        assert_eq!(run.err, "", "{name}");
        let report = run.json();
        for path in ["/surface/mean_mm", "/pose/rms_translation_mm", "/contact_rms_mm"] {
            assert!(figure(&report, path).is_finite(), "{name}: {path}");
        }
        std::fs::remove_dir_all(place.at("m")).unwrap();
    }
}

#[test]
fn an_exploration_leaves_a_log_that_slam_goes_on_from() {
    let place = Place::new();
    let line = "explore --object ellipse:0.1x0.06 --count 30 --until lenient --max-actions 6 \
                --moving --seed 1 --out explored --json";
    let result = place.tactile(line).done().json();
    assert_eq!(
        place.tactile(&line.replace("explored", "again")).done().json()["actions"],
        result["actions"]
    );
    let actions = result["actions"].as_u64().unwrap() as usize;
    assert_eq!(result["history"].as_array().unwrap().len(), actions);
    assert_eq!(
        result["reached"],
        figure(&result, &format!("/history/{}/known", actions - 1)) >= 0.9
    );
    assert!(figure(&result, "/surface/hausdorff_aligned_mm") < 20.0);
    assert_eq!(result["pose"]["per_grasp"].as_array().unwrap().len(), actions);
    for name in ["report.json", "contour.csv", "trajectory.tum", "summary.png", "log.jsonl"] {
        assert!(place.at("explored").join(name).exists(), "{name}");
    }
    let report = std::fs::read(place.at("explored").join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert!(report["seconds"]["graph"].is_number(), "{report}");
    let log = GraspLog::read(&place.at("explored").join("log.jsonl")).unwrap();
    assert_eq!(log.grasps.len(), actions);
    let again = place
        .tactile("slam explored/log.jsonl --tracker hypotheses --graph none --out slam --json");
    assert_eq!(again.done().json()["grasps"], actions);
}

#[test]
fn every_command_explains_itself() {
    let place = Place::new();
    let help = place.tactile("--help").done().out;
    let mut commands = vec![String::new()];
    let listed = help.split("Commands:\n").nth(1).unwrap().lines();
    // Deeper lines go on with what the one above is for.
    let listed = listed.take_while(|l| l.starts_with("  ")).filter(|l| !l.starts_with("   "));
    let listed = listed.filter_map(|l| l.split_whitespace().next());
    commands.extend(listed.filter(|c| *c != "help").map(str::to_owned));
    for known in ["slam", "simulate", "explore", "import", "live", "replay", "inspect", "reproduce"]
    {
        assert!(commands.iter().any(|c| c == known), "{known} is not in\n{help}");
    }
    commands.extend(["import push", "import csv", "import off"].map(str::to_owned));
    for command in commands {
        let help = place.tactile(&format!("{command} --help")).done().out;
        assert!(help.contains("Usage: tactile"), "{command}:\n{help}");
        let (_, example) =
            help.split_once("Example:").unwrap_or_else(|| panic!("{command}:\n{help}"));
        assert!(example.contains(&format!("tactile {command}")), "{command}:\n{help}");
    }
    let version = place.tactile("--version").done().out;
    assert_eq!(version.trim(), format!("tactile {}", env!("CARGO_PKG_VERSION")));
    assert!(place.names().is_empty());
}
