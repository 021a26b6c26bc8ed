//! Reading and writing grasp logs.

use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use serde_json::{Map, Value, json};

use super::write::write_atomically;
use super::*;
use crate::space::planar;

const HEADER2: &str = r#"{"format":"tactile-grasp-log","version":1,"dimension":2,"frame":"world","fingers":["ff","th"]}"#;
const HEADER3: &str = r#"{"format":"tactile-grasp-log","version":1,"dimension":3,"frame":"world","fingers":["ff","th"]}"#;
const GRASP2: &str = r#"{"grasp":0,"time":1.5,"motion":null,"contacts":[{"finger":"th","point":[0.1,-0.2],"normal":[0.6,0.8],"force":1.2}]}"#;

fn parse(text: &str) -> Result<GraspLog, LogError> {
    GraspLog::parse(text.as_bytes(), Path::new("folder/some.jsonl"))
}

fn lines(lines: &[&str]) -> Result<GraspLog, LogError> {
    parse(&lines.join("\n"))
}

/// The error of a log whose line `line` is wrong in `field`, which must say `expected`.
fn refused(log: &[&str], line: usize, field: &str, expected: &str) {
    let error = lines(log).expect_err(&format!("{log:?} should be refused"));
    let text = error.to_string();
    let place = format!("folder/some.jsonl, line {line}, field `{field}`: expected ");
    assert!(text.starts_with(&place) && text.contains(expected), "{text}\nnot {place}…{expected}");
}

/// The same for a third line, dimension 2, behind a good header and grasp.
fn refused_grasp(grasp: &str, field: &str, expected: &str) {
    refused(&[HEADER2, GRASP2, grasp], 3, field, expected);
}

#[test]
fn a_good_log_says_what_is_in_it() {
    let log = lines(&[
        HEADER2,
        "",
        GRASP2,
        r#"{"grasp":4,"contacts":[],"motion":{"translation":[1,2],"rotation":4},"free":[{"finger":"ff","point":[3,4]}],"truth":{"pose":{"translation":[5,6],"rotation":-0.5}}}"#,
    ])
    .unwrap();
    assert_eq!((log.dimension, log.fingers.len(), log.grasps.len()), (2, 2, 2));
    let [first, second] = &log.grasps[..] else { panic!() };
    assert_eq!((first.index, first.time, first.motion, first.truth), (0, Some(1.5), None, None));
    let contact = &first.contacts[0];
    assert_eq!((contact.finger, contact.point), (Some(1), Point::new(0.1, -0.2, 0.0)));
    assert_eq!((contact.normal, contact.force), (Some(Point::new(0.6, 0.8, 0.0)), Some(1.2)));
    assert_eq!((second.index, second.time, second.contacts.len()), (4, None, 0));
    assert_eq!(second.free[0].point, Point::new(3.0, 4.0, 0.0));
    assert_eq!(second.truth, Some(planar(5.0, 6.0, -0.5)));
    let motion = second.motion.unwrap();
    assert!((crate::space::angle(&motion) - (4.0 - std::f64::consts::TAU)).abs() < 1e-12);
}

#[test]
fn spatial_rotations_are_x_y_z_w() {
    let grasp = r#"{"grasp":0,"contacts":[],"truth":{"pose":{"translation":[1,2,3],"rotation":[0,0,0.70710678,0.70710678]}}}"#;
    let pose = lines(&[HEADER3, grasp]).unwrap().grasps[0].truth.unwrap();
    let turned = pose * nalgebra::Point3::new(1.0, 0.0, 0.0);
    assert!((turned.coords - Point::new(1.0, 3.0, 3.0)).norm() < 1e-7);
    assert!((pose.rotation.norm() - 1.0).abs() < 1e-15, "normalised");
}

#[test]
fn normals_are_normalised_or_refused() {
    let with = |normal: &str| {
        lines(&[HEADER2, &GRASP2.replace("[0.6,0.8]", normal)])
            .map(|log| log.grasps[0].contacts[0].normal)
    };
    let normal = with("[0.6004,0.8004]").unwrap().unwrap();
    assert!((normal.norm() - 1.0).abs() < 1e-15);
    assert_eq!(with("null").unwrap(), None);
    for (bad, found) in [("[0,0]", "length 0"), ("[0.61,0.81]", "length 1.01"), ("[3,4]", "5")] {
        let text = with(bad).unwrap_err().to_string();
        assert!(text.contains("`contacts[0].normal`: expected a vector of length 1"), "{text}");
        assert!(text.contains(found), "{text}");
    }
}

#[test]
fn files_that_are_not_logs_are_refused() {
    let is = |text: &str, expected: &str| {
        let error = parse(text).unwrap_err().to_string();
        assert!(error.contains(expected) && error.starts_with("folder/some.jsonl"), "{error}");
    };
    is("", "is empty; expected a header");
    is("\n  \n", "is empty");
    is(HEADER2, "has a header but no grasp");
    is("OFF\n3 0 0\n", "line 1: malformed JSON at column 1: expected one JSON object");
    is("[1,2]", "line 1: expected one JSON object, found an array of 2");
    is(&format!("{HEADER2}\n{HEADER2}"), "line 2: is a second header");
    is(&format!("{HEADER2}\n{GRASP2} {GRASP2}"), "line 2: malformed JSON at column");
    let cut = &GRASP2[..GRASP2.len() - 20];
    is(&format!("{HEADER2}\n{GRASP2}\n{cut}"), "line 3: is cut off");
    is(&format!("{HEADER2}\n{GRASP2}\n{{\"gra\r\n"), "line 3: is cut off");
    is(
        &format!("{HEADER2}\n{}", GRASP2.replace("1.5", "1e999")),
        "`: expected a finite number, found",
    );
    is(
        &format!("{HEADER2}\n{}", GRASP2.replace("1.5", "NaN")),
        "`: expected a finite number, a text",
    );
    let twice = GRASP2.replace("\"contacts\"", "\"contacts\":[],\"contacts\"");
    is(&format!("{HEADER2}\n{twice}"), ": \"contacts\" stands here twice");
    is(&"[".repeat(100_000), "line 1: malformed JSON");
    let error = GraspLog::parse(&b"{\"a\":\"\xff\"}"[..], Path::new("x")).unwrap_err();
    assert!(error.to_string().contains("line 1: is not UTF-8 text (byte 7"), "{error}");
}

#[test]
fn a_line_without_end_is_refused_before_memory_is_full() {
    let endless = std::io::BufReader::new(std::io::repeat(b' '));
    let error = GraspLog::parse(endless, Path::new("x")).unwrap_err().to_string();
    assert!(error.contains("line 1: is longer than"), "{error}");
}

#[test]
fn a_line_that_is_too_long_is_left_out_as_one() {
    let long = format!("{{\"padding\":\"{}\"}}", "x".repeat(33 << 20));
    let text = format!("{HEADER2}\n{long}\n{GRASP2}\nno grasp\n");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.jsonl");
    std::fs::write(&path, text).unwrap();
    let (log, left_out) = GraspLog::salvage(&path).unwrap();
    assert_eq!((log.grasps.len(), left_out.len()), (1, 2));
    assert!(left_out[0].to_string().contains("line 2: is longer"), "{}", left_out[0]);
    assert!(left_out[1].to_string().contains("line 4: "), "{}", left_out[1]);
}

#[test]
fn headers_are_checked() {
    let header = |from: &str, to: &str, field: &str, expected: &str| {
        let changed = HEADER2.replace(from, to);
        assert_ne!(changed, HEADER2);
        refused(&[&changed, GRASP2], 1, field, expected);
    };
    refused(&[GRASP2], 1, "format", "\"tactile-grasp-log\" in the header");
    header("tactile-grasp-log", "rosbag", "format", "found \"rosbag\"");
    header("\"version\":1", "\"version\":2", "version", "1, the version this program reads");
    header("\"version\":1,", "", "version", "found nothing");
    header("\"dimension\":2", "\"dimension\":4", "dimension", "2 or 3, found 4");
    header("\"dimension\":2,", "", "dimension", "2 or 3, found nothing");
    header("\"world\"", "\"hand\"", "frame", "\"world\"");
    header("[\"ff\",\"th\"]", "[\"ff\",\"ff\"]", "fingers[1]", "a name not used before");
    header("[\"ff\",\"th\"]", "[\"ff\",7]", "fingers[1]", "a name, found 7");
    header("[\"ff\",\"th\"]", "\"ff\"", "fingers", "an array of names");
    let many = (0..300).map(|i| format!("\"f{i}\"")).collect::<Vec<_>>().join(",");
    header("\"ff\",\"th\"", &many, "fingers", "at most 255 names, found an array of 300");
    let noise = |noise: &str, field: &str, expected: &str| {
        header("\"frame\"", &format!("\"noise\":{noise},\"frame\""), field, expected);
    };
    noise("{\"point\":0}", "noise.point", "a positive number");
    noise("{\"rotation\":-1}", "noise.rotation", "a positive number");
    noise("{\"point\":1e300}", "noise.point", "a positive number up to 10000");
    noise("{\"normal\":\"5deg\"}", "noise.normal", "a finite number");
    noise("3", "noise", "an object of standard deviations");
    let shape = |shape: &str, field: &str, expected: &str| {
        let truth = format!("\"truth\":{{\"shape\":{shape}}},\"frame\"");
        header("\"frame\"", &truth, field, expected);
    };
    shape("{\"polygon\":[[0,0],[1,1]]}", "truth.shape.polygon", "at least 3 vertices");
    shape("{\"polygon\":[[0,0],[1,1],[2]]}", "truth.shape.polygon[2]", "[x, y], found an array");
    shape("{\"mesh\":\"box.ply\"}", "truth.shape.polygon", "found nothing");
    let truth = HEADER3.replace("\"frame\"", "\"truth\":{\"shape\":{\"mesh\":5}},\"frame\"");
    refused(&[&truth], 1, "truth.shape.mesh", "the name of a mesh file, found 5");
}

#[test]
fn grasps_are_checked() {
    let wrong = refused_grasp;
    wrong(r#"{"contacts":[]}"#, "grasp", "the grasp's number");
    wrong(r#"{"grasp":-1,"contacts":[]}"#, "grasp", "found -1");
    wrong(r#"{"grasp":0,"contacts":[]}"#, "grasp", "a number above 0");
    wrong(r#"{"grasp":1.5,"contacts":[]}"#, "grasp", "found 1.5");
    wrong(r#"{"grasp":1}"#, "contacts", "an array of contacts, possibly empty, found nothing");
    wrong(r#"{"grasp":1,"contacts":3}"#, "contacts", "an array of contacts");
    wrong(r#"{"grasp":1,"contacts":[4]}"#, "contacts[0]", "an object");
    wrong(r#"{"grasp":1,"time":1.4,"contacts":[]}"#, "time", "at least 1.5 s");
    refused(&[HEADER2, r#"{"grasp":0,"time":-1,"contacts":[]}"#], 2, "time", "not negative");
    wrong(r#"{"grasp":1,"contacts":[{"finger":"ff"}]}"#, "contacts[0].point", "found nothing");
    wrong(r#"{"grasp":1,"contacts":[{"point":[1,2,3]}]}"#, "contacts[0].point", "[x, y], found");
    wrong(r#"{"grasp":1,"contacts":[{"point":[1,"b"]}]}"#, "contacts[0].point[1]", "finite");
    wrong(r#"{"grasp":1,"contacts":[{"point":[1,null]}]}"#, "contacts[0].point[1]", "finite");
    wrong(r#"{"grasp":1,"contacts":[{"point":[1,1e300]}]}"#, "contacts[0].point", "in metres");
    let contact = |rest: &str| {
        format!(r#"{{"grasp":1,"contacts":[{{"point":[0,0]}},{{"point":[0,0],{rest}}}]}}"#)
    };
    let wrong_in = |rest: &str, field: &str, expected: &str| {
        refused_grasp(&contact(rest), &format!("contacts[1].{field}"), expected);
    };
    wrong_in(r#""normal":[0,0,1]"#, "normal", "a unit vector [x, y]");
    wrong_in(r#""finger":"mf""#, "finger", "one of the header's fingers (ff, th), found \"mf\"");
    wrong_in(r#""finger":1"#, "finger", "one of the header's fingers");
    wrong_in(r#""force":"1N""#, "force", "a finite number");
    wrong_in(r#""normal_noise":0"#, "normal_noise", "a positive number");
    wrong(r#"{"grasp":1,"contacts":[],"free":[{}]}"#, "free[0].point", "found nothing");
    wrong(r#"{"grasp":1,"contacts":[],"motion":[1,2,3]}"#, "motion", "an object");
    let motion = |pose: &str, field: &str, expected: &str| {
        let grasp = format!(r#"{{"grasp":1,"contacts":[],"motion":{pose}}}"#);
        refused_grasp(&grasp, &format!("motion.{field}"), expected);
    };
    motion(r#"{"translation":[1,2]}"#, "rotation", "an angle in radians");
    motion(r#"{"translation":[1,2],"rotation":[0,0,0,1]}"#, "rotation", "a finite number");
    motion(r#"{"translation":[1,2,3],"rotation":0}"#, "translation", "[x, y]");
    motion(
        r#"{"translation":[0,0],"rotation":-12}"#,
        "rotation",
        "radians, of a full turn at most",
    );
    let spatial = |rotation: &str, expected: &str| {
        let grasp = format!(
            r#"{{"grasp":1,"contacts":[],"truth":{{"pose":{{"translation":[1,2,3],"rotation":{rotation}}}}}}}"#
        );
        refused(&[HEADER3, &grasp], 2, "truth.pose.rotation", expected);
    };
    spatial("[0,0,0,1.002]", "a unit quaternion [x, y, z, w] of length 1 within 0.001, found");
    spatial("[0,0,0,0]", "found length 0");
    spatial("0.5", "a unit quaternion [x, y, z, w], found 0.5");
    spatial("[0,0,1]", "found an array of 3");
}

#[test]
fn too_many_contacts_are_refused_and_the_limit_is_named() {
    let grasp = |n: usize| {
        let contacts = vec![r#"{"point":[0,0]}"#; n].join(",");
        format!(r#"{{"grasp":1,"contacts":[{contacts}]}}"#)
    };
    let log = lines(&[HEADER2, &grasp(MAX_CONTACTS)]).unwrap();
    assert_eq!(log.grasps[0].contacts.len(), MAX_CONTACTS);
    refused_grasp(&grasp(10_000), "contacts", "at most 1024 contacts in one grasp, found 10000");
    let free = grasp(1025).replace("\"contacts\"", "\"contacts\":[],\"free\"");
    refused_grasp(&free, "free", "at most 1024 free points");
}

#[test]
fn unknown_fields_survive_a_rewrite_in_order() {
    let header = r#"{"format":"tactile-grasp-log","version":1,"dimension":2,"frame":"world","description":"d","fingers":["ff"],"noise":{"point":0.001,"lag":2.0},"truth":{"shape":{"polygon":[[0.0,0.0],[1.0,0.0],[0.0,1.0]],"by":"hand"},"mass":1.5},"zeta":[1,{"a":null}],"alpha":"x"}"#;
    let grasp = r#"{"grasp":3,"motion":{"translation":[0.5,0.0],"rotation":0.2,"covariance":[1]},"contacts":[{"finger":"ff","point":[0.1,0.2],"patch":7}],"free":[{"point":[1.0,2.0],"near":true}],"truth":{"pose":{"translation":[0.0,0.0],"rotation":0.1,"source":"mocap"},"slip":0.3},"note":"n"}"#;
    let mut log = lines(&[header, grasp]).unwrap();
    let text = |log: &GraspLog| {
        let mut written = Vec::new();
        log.to_writer(&mut written).unwrap();
        String::from_utf8(written).unwrap()
    };
    assert_eq!(text(&log), format!("{header}\n{grasp}\n"));
    // What is gone takes with it what was in it.
    (log.shape, log.grasps[0].motion, log.grasps[0].truth) = (None, None, None);
    let rest = text(&log);
    assert!(rest.contains(r#""truth":{"mass":1.5}"#) && rest.contains(r#""truth":{"slip":0.3}"#));
    assert!(rest.contains(r#""motion":null"#) && !rest.contains("mocap"), "{rest}");
}

#[test]
fn meshes_are_found_beside_the_log_and_stay_found() {
    let header =
        HEADER3.replace("\"frame\"", "\"truth\":{\"shape\":{\"mesh\":\"box.ply\"}},\"frame\"");
    let log = lines(&[&header, r#"{"grasp":0,"contacts":[]}"#]).unwrap();
    let file = PathBuf::from("folder/box.ply");
    assert_eq!(log.shape, Some(TrueShape::Mesh { path: "box.ply".into(), file: file.clone() }));
    let elsewhere = tempfile::tempdir().unwrap();
    let path = elsewhere.path().join("moved.jsonl");
    log.write(&path).unwrap();
    let Some(TrueShape::Mesh { file: found, .. }) = GraspLog::read(&path).unwrap().shape else {
        panic!("the mesh is gone");
    };
    assert_eq!(found, std::path::absolute(file).unwrap());
}

#[test]
fn what_a_log_cannot_hold_is_not_written() {
    let mut log = lines(&[HEADER2, GRASP2]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.jsonl");
    log.grasps[0].contacts[0].point.x = f64::NAN;
    let error = log.write(&path).unwrap_err().to_string();
    assert!(error.contains("log.jsonl: cannot write: grasp 0: NaN is not a finite"), "{error}");
    log.grasps[0].contacts[0].point.x = 0.0;
    log.grasps[0].contacts[0].finger = Some(9);
    assert!(log.write(&path).unwrap_err().to_string().contains("finger 9 has no name"));
    // Nor what could be written, but not read again.
    log.grasps[0].contacts[0].finger = None;
    type Spoil = fn(&mut GraspLog);
    let unsound: [(Spoil, &str); 6] = [
        (|log| log.grasps[0].contacts[0].normal_noise = Some(0.0), "[0].normal_noise`: expected a"),
        (|log| log.grasps[0].contacts[0].normal = Some(Point::x() * 2.0), "length 1 within"),
        (|log| log.grasps[0].contacts[0].point.x = 1e5, "[0].point`: expected coordinates"),
        (|log| log.grasps.push(LoggedGrasp::default()), "line 3, field `grasp`"),
        (|log| log.dimension = 4, "line 1, field `dimension`"),
        (
            |log| {
                log.grasps[0].contacts[0].normal = None;
                log.grasps[0].contacts[0].unknown.insert("normal".into(), json!(1.5));
            },
            "contacts[0].normal`: expected a unit vector",
        ),
    ];
    for (spoil, expected) in unsound {
        let mut log = log.clone();
        spoil(&mut log);
        let error = log.write(&path).unwrap_err().to_string();
        assert!(error.contains("cannot write: the log, line "), "{error}");
        assert!(error.contains(expected), "{error}");
    }
    log.write(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
}

#[test]
fn files_are_written_fully_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.txt");
    write_atomically(&path, |w| w.write_all(b"old")).unwrap();
    let failed = write_atomically(&path, |w| {
        w.write_all(b"half of the ne")?;
        Err(std::io::Error::other("the disk is full"))
    });
    assert_eq!(failed.unwrap_err().to_string(), "the disk is full");
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    write_atomically(&path, |w| w.write_all(b"new")).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary files");

    let refused = |path: &Path| write_atomically(path, |_| Ok(())).unwrap_err().to_string();
    let missing = folder.path().join("missing/out.txt");
    assert!(refused(&missing).contains("missing does not exist"));
    assert!(!folder.path().join("missing").exists());
    assert!(refused(&path.join("below")).contains("out.txt is not a folder"));
    assert!(refused(folder.path()).contains("is a folder"));
}

#[test]
fn unreadable_paths_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = GraspLog::read(&folder.path().join("none.jsonl")).unwrap_err().to_string();
    assert!(error.contains("none.jsonl: cannot read"), "{error}");
    let error = GraspLog::read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("is a folder"), "{error}");
}

fn finite() -> impl Strategy<Value = f64> {
    // Every magnitude a coordinate may have, and ordinary ones often.
    prop_oneof![-1.0f64..1.0, any::<f64>().prop_filter("in range", |x| x.abs() <= MAX_COORDINATE)]
}

fn point(dimension: usize) -> impl Strategy<Value = Point> {
    (finite(), finite(), finite())
        .prop_map(move |(x, y, z)| Point::new(x, y, if dimension == 2 { 0.0 } else { z }))
}

fn pose(dimension: usize) -> impl Strategy<Value = Pose> {
    (point(dimension), -3.1f64..3.1, proptest::array::uniform4(0.1f64..1.0)).prop_map(
        move |(p, angle, [x, y, z, w])| {
            if dimension == 2 {
                planar(p.x, p.y, angle)
            } else {
                let q = UnitQuaternion::new_normalize(Quaternion::new(w, -x, y, -z));
                Pose::from_parts(Translation3::from(p), q)
            }
        },
    )
}

fn normal(dimension: usize) -> impl Strategy<Value = Point> {
    (0.1f64..1.0, -1.0f64..1.0, -1.0f64..1.0).prop_map(move |(x, y, z)| {
        Point::new(x, y, if dimension == 2 { 0.0 } else { z }).normalize()
    })
}

fn unknown() -> impl Strategy<Value = Map<String, Value>> {
    vec(("x_[a-z]{1,6}", finite()), 0..3).prop_map(|fields| {
        fields.into_iter().map(|(k, v)| (k, json!({ "v": [v, "é\n"] }))).collect()
    })
}

fn contact(d: usize) -> impl Strategy<Value = LoggedContact> {
    let parts = (
        option::of(0usize..3),
        point(d),
        option::of(normal(d)),
        option::of(1e-6f64..1.0),
        option::of(finite()),
        unknown(),
    );
    parts.prop_map(|(finger, point, normal, normal_noise, force, unknown)| LoggedContact {
        finger,
        point,
        normal,
        normal_noise,
        force,
        unknown,
    })
}

fn log() -> impl Strategy<Value = GraspLog> {
    prop_oneof![Just(2usize), Just(3usize)].prop_flat_map(|d| {
        let free = (option::of(0usize..3), point(d), unknown())
            .prop_map(|(finger, point, unknown)| LoggedFree { finger, point, unknown });
        let grasp = (
            1u64..5,
            option::of(0.0f64..10.0),
            option::of(pose(d)),
            vec(contact(d), 0..4),
            vec(free, 0..3),
            option::of(pose(d)),
            unknown(),
        );
        let shape = if d == 2 {
            vec([finite(), finite()], 3..6).prop_map(TrueShape::Polygon).boxed()
        } else {
            Just(TrueShape::Mesh { path: "a.ply".into(), file: "folder/a.ply".into() }).boxed()
        };
        let noise = proptest::array::uniform4(option::of(1e-9f64..1.0));
        let parts = (vec(grasp, 1..5), ".{0,20}", option::of(shape), noise, unknown());
        parts.prop_map(move |(grasps, description, shape, noise, unknown)| {
            let (mut index, mut clock) = (0, 0.0);
            let grasps =
                grasps.into_iter().map(|(step, wait, motion, contacts, free, truth, u)| {
                    index += step;
                    let time = wait.map(|wait| {
                        clock += wait;
                        clock
                    });
                    LoggedGrasp { index, time, motion, contacts, free, truth, unknown: u }
                });
            let [point, normal, translation, rotation] = noise;
            GraspLog {
                dimension: d,
                description,
                fingers: vec!["ff".into(), "mf \"x\"".into(), "th".into()],
                noise: Noise { point, normal, translation, rotation },
                shape,
                grasps: grasps.collect(),
                unknown,
            }
        })
    })
}

proptest! {
    #[test]
    fn written_logs_read_back_the_same(log in log()) {
        let mut bytes = Vec::new();
        log.to_writer(&mut bytes).unwrap();
        let back = GraspLog::parse(&bytes[..], Path::new("folder/some.jsonl")).unwrap();
        prop_assert_eq!(&back, &log);
        let mut again = Vec::new();
        back.to_writer(&mut again).unwrap();
        prop_assert_eq!(bytes, again);
    }

    #[test]
    fn a_damaged_log_never_panics(log in log(), at in 0.0f64..1.0, byte: u8, cut: bool) {
        let mut bytes = Vec::new();
        log.to_writer(&mut bytes).unwrap();
        let place = (at * bytes.len() as f64) as usize;
        if cut { bytes.truncate(place) } else { bytes[place] = byte }
        if let Ok(log) = GraspLog::parse(&bytes[..], Path::new("x.jsonl")) {
            prop_assert!(!log.grasps.is_empty());
        }
    }
}

#[test]
fn real_logs_are_read() {
    let Some(folder) = crate::data::for_test("mujoco") else { return };
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "jsonl") {
            continue;
        }
        let log = GraspLog::read(&path).unwrap();
        let grasps = if log.dimension == 2 { 16 } else { 20 };
        assert!(log.grasps.len() >= grasps - 2 && log.shape.is_some(), "{}", path.display());
        if let Some(TrueShape::Mesh { file, .. }) = &log.shape {
            assert!(file.is_file(), "{} is missing", file.display());
        }
        let mut bytes = Vec::new();
        log.to_writer(&mut bytes).unwrap();
        assert_eq!(GraspLog::parse(&bytes[..], &path).unwrap(), log);
        count += 1;
    }
    assert!(count > 0, "no logs in the data folder");
}

#[cfg(unix)]
#[test]
fn a_private_file_stays_private() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    let log = parse(&format!("{HEADER2}\n{GRASP2}")).unwrap();
    log.write(&path).unwrap();
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).unwrap();
    log.write(&path).unwrap();
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
}

#[test]
fn a_recording_is_called_one_and_a_log_of_that_name_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tac");
    std::fs::write(&path, [7, 0xff, 0xfe, 0, 3, 0]).unwrap();
    let error = GraspLog::read(&path).unwrap_err().to_string();
    assert!(error.contains("a.tac") && error.contains("is a recording (.tac)"), "{error}");
    std::fs::write(&path, include_str!("../../assets/bundled.jsonl")).unwrap();
    assert_eq!(GraspLog::read(&path).unwrap().grasps.len(), 10);
}
