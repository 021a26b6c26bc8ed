use super::*;

fn options(object: &str, seed: u64) -> Options {
    Options { seed, ..Options::new(object.parse().unwrap()) }
}

fn noiseless(object: &str, seed: u64) -> Options {
    let none = Deviation { length: 0.0, angle: 0.0 };
    Options { contact_noise: none, motion_noise: none, ..options(object, seed) }
}

/// Every contact of a log with the truth of its grasp, in the object frame.
fn touches(simulation: &Simulation) -> Vec<(Point, Point)> {
    let grasps = simulation.log.grasps.iter();
    let contacts = grasps.flat_map(|g| g.contacts.iter().map(|c| (g.truth.unwrap().inverse(), c)));
    contacts
        .map(|(to, c)| ((to * Point3::from(c.point)).coords, to.rotation * c.normal.unwrap()))
        .collect()
}

const OBJECTS: [&str; 8] = [
    "rectangle:0.12x0.06",
    "triangle:0.06",
    "hexagon:0.045",
    "ellipse:0.12x0.06",
    "box:0.12x0.06x0.06",
    "cylinder:0.06x0.12",
    "sphere:0.08",
    "ellipsoid:0.12x0.08x0.06",
];

#[test]
fn without_noise_contacts_lie_on_the_surface_and_normals_point_out() {
    for object in OBJECTS {
        for touch in [Touch::Hand, Touch::Uniform] {
            let simulation = simulate(&Options { touch, ..noiseless(object, 3) }).unwrap();
            let log = &simulation.log;
            assert_eq!(log.grasps.len(), if log.dimension == 2 { 16 } else { 20 });
            let touches = touches(&simulation);
            assert!(touches.len() >= 3 * log.grasps.len(), "{object}: {}", touches.len());
            for (point, normal) in touches {
                assert!(simulation.geometry.distance(&point) < 1e-12, "{object}");
                assert!(simulation.geometry.distance(&(point + 1e-4 * normal)) > 0.99e-4);
                assert!(normal.dot(&point) > 0.0, "{object}: these are star-shaped");
            }
            // Whoever reads that nothing is said takes it for usual noise.
            let least = Noise {
                point: Some(Noise::LEAST_POINT),
                normal: Some(Noise::LEAST_NORMAL),
                translation: Some(Noise::LEAST_TRANSLATION),
                rotation: Some(Noise::LEAST_ROTATION),
            };
            assert_eq!(log.noise, least);
        }
    }
}

#[test]
fn motions_and_slips_give_the_true_poses() {
    for object in ["rectangle:0.12x0.06", "box:0.12x0.06x0.06"] {
        let exact = simulate(&noiseless(object, 8)).unwrap().log;
        assert!(exact.grasps[0].motion.is_none());
        for pair in exact.grasps.windows(2) {
            let predicted = pair[1].motion.unwrap() * pair[0].truth.unwrap();
            let truth = pair[1].truth.unwrap();
            assert!((predicted.translation.vector - truth.translation.vector).norm() < 1e-12);
            assert!(predicted.rotation.angle_to(&truth.rotation) < 1e-7);
            let turned = pair[1].motion.unwrap().rotation.angle().to_degrees();
            assert!([22.5, 30.0, 45.0].iter().any(|a| (a - turned).abs() < 1e-9), "{turned}");
        }
    }
    // The slip's statistics, per axis of the object frame.
    for (object, axes) in [("rectangle:0.12x0.06", 1.0), ("box:0.12x0.06x0.06", 3.0)] {
        let many = Options { grasps: Some(800), ..options(object, 4) };
        let log = simulate(&many).unwrap().log;
        let (mut shift, mut turn) = (Point::zeros(), 0.0);
        for pair in log.grasps.windows(2) {
            let predicted = pair[1].motion.unwrap() * pair[0].truth.unwrap();
            let slip = predicted.inverse() * pair[1].truth.unwrap();
            shift += slip.translation.vector.component_mul(&slip.translation.vector) / 799.0;
            turn += slip.rotation.scaled_axis().norm_squared() / (799.0 * axes);
        }
        for axis in 0..log.dimension {
            assert!((shift[axis].sqrt() - 0.01).abs() < 1e-3, "{object}: {shift}");
        }
        let turn = turn.sqrt().to_degrees();
        assert!((turn - 20.0).abs() < 1.5, "{object}: {turn}");
    }
}

#[test]
fn contact_noise_has_its_deviations_and_touches_the_same_places() {
    for (object, axes) in [("rectangle:0.12x0.06", 1.0), ("box:0.12x0.06x0.06", 2.0)] {
        let noisy = Options { grasps: Some(400), ..options(object, 6) };
        let none = Deviation { length: 0.0, angle: 0.0 };
        let clean = simulate(&Options { contact_noise: none, ..noisy.clone() }).unwrap();
        let noisy = simulate(&noisy).unwrap();
        let (clean, noisy) = (touches(&clean), touches(&noisy));
        assert_eq!(clean.len(), noisy.len());
        let n = clean.len() as f64;
        let (mut point, mut angle) = (Point::zeros(), 0.0);
        for ((p, a), (q, b)) in clean.iter().zip(&noisy) {
            point += (q - p).component_mul(&(q - p)) / n;
            angle += a.angle(b).powi(2) / (n * axes);
            assert!((b.norm() - 1.0).abs() < 1e-12);
        }
        for axis in 0..(axes as usize + 1) {
            assert!((point[axis].sqrt() - 1e-3).abs() < 5e-5, "{object}: {point}");
        }
        assert!((angle.sqrt().to_degrees() - 5.0).abs() < 0.3, "{object}: {angle}");
    }
}

#[test]
fn a_carried_object_is_elsewhere_from_the_middle_on_and_nothing_else_changes() {
    let by = Displacement { length: 0.3, angle: 1.0 };
    for object in ["rectangle:0.12x0.06", "lshape:0.09x0.09x0.035x0.05"] {
        let plain = simulate(&options(object, 5)).unwrap();
        let moved = simulate(&Options { carried: Some(by), ..options(object, 5) }).unwrap();
        let centre = plain.geometry.centroid();
        let middle = plain.log.grasps.len() / 2;
        for (a, b) in plain.log.grasps.iter().zip(&moved.log.grasps).take(middle) {
            assert_eq!(a, b);
        }
        let (a, b) = (&plain.log.grasps[middle], &moved.log.grasps[middle]);
        assert_eq!(a.motion, b.motion);
        let (a, b) = (a.truth.unwrap(), b.truth.unwrap());
        let shift = (b * Point3::from(centre) - a * Point3::from(centre)).norm();
        assert!((shift - 0.3).abs() < 1e-9, "{shift}");
        assert!((b.rotation.angle_to(&a.rotation) - 1.0).abs() < 1e-9);
        // Nothing but the usual happens later.
        for pair in moved.log.grasps.windows(2).skip(middle) {
            let predicted = pair[1].motion.unwrap() * pair[0].truth.unwrap();
            let slip = predicted.inverse() * pair[1].truth.unwrap() * Point3::from(centre) - centre;
            assert!(slip.coords.norm() < 0.06, "{slip}");
        }
    }
}

#[test]
fn outliers_come_in_their_proportion_and_stay_near() {
    let wild = Options { outliers: 0.2, grasps: Some(300), ..noiseless("box:0.12x0.06x0.06", 2) };
    let simulation = simulate(&wild).unwrap();
    let touches = touches(&simulation);
    let distances = touches.iter().map(|(p, _)| simulation.geometry.distance(p));
    let off: Vec<f64> = distances.filter(|d| *d > 1e-9).collect();
    let share = off.len() as f64 / touches.len() as f64;
    assert!((share - 0.2).abs() < 0.04, "{share}");
    assert!(off.iter().all(|d| *d <= WILD) && off.iter().any(|d| *d > 0.02));
}

#[test]
fn free_points_are_outside_the_object() {
    // Small enough that the outer fingers often miss.
    let simulation = simulate(&noiseless("sphere:0.04", 5)).unwrap();
    let mut count = 0;
    for grasp in &simulation.log.grasps {
        assert_eq!(grasp.contacts.len() + grasp.free.len(), 5, "every finger ends somewhere");
        for free in &grasp.free {
            let local = (grasp.truth.unwrap().inverse() * Point3::from(free.point)).coords;
            assert!(local.norm() > 0.02, "{local}");
            assert!(grasp.contacts.iter().all(|c| c.finger != free.finger));
            count += 1;
        }
    }
    assert!(count > 5, "{count}");
    let silent = Options { free: false, ..noiseless("sphere:0.04", 5) };
    assert!(simulate(&silent).unwrap().log.grasps.iter().all(|g| g.free.is_empty()));
}

#[test]
fn reorientation_reaches_every_side() {
    let simulation = simulate(&options("box:0.12x0.06x0.06", 1)).unwrap();
    let touches = touches(&simulation);
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let face = Point::ith(axis, sign);
            let count = touches.iter().filter(|(_, n)| n.dot(&face) > 0.9).count();
            assert!(count >= 3, "{face}: {count}");
        }
    }
}

#[test]
fn a_seed_is_a_log() {
    for object in ["hexagon:0.045", "ellipsoid:0.12x0.08x0.06"] {
        let log = simulate(&options(object, 7)).unwrap().log;
        assert_eq!(log, simulate(&options(object, 7)).unwrap().log);
        assert_ne!(log, simulate(&options(object, 8)).unwrap().log);
    }
}

#[test]
fn options_out_of_range_are_refused() {
    let good = options("rectangle:0.12x0.06", 1);
    let cases = [
        (Options { grasps: Some(0), ..good.clone() }, "--grasps: expected at least 1, found 0"),
        (Options { contacts: 0, ..good.clone() }, "--contacts: expected from 1 to 1024, found 0"),
        (Options { contacts: 6, ..good.clone() }, "at most 5 with --touch hand"),
        (
            Options { contacts: 10_000, touch: Touch::Uniform, ..good.clone() },
            "--contacts: expected from 1 to 1024, found 10000",
        ),
        (Options { grasps: Some(usize::MAX), ..good.clone() }, "at most 10 000 000 contacts"),
        (Options { outliers: 1.5, ..good.clone() }, "--outliers: expected a fraction"),
        (Options { outliers: f64::NAN, ..good.clone() }, "--outliers: expected a fraction"),
        (
            Options { motion_noise: Deviation { length: f64::NAN, angle: 0.0 }, ..good.clone() },
            "--motion-noise: expected standard deviations",
        ),
        (
            Options {
                carried: Some(Displacement { length: 1.0, angle: f64::NAN }),
                ..good.clone()
            },
            "--carried: expected a length and an angle",
        ),
        (
            Options {
                carried: Some(Displacement { length: 1.0, angle: 0.0 }),
                grasps: Some(1),
                ..good.clone()
            },
            "--carried: expected at least 2 grasps",
        ),
    ];
    for (options, expected) in cases {
        let error = simulate(&options).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let speck = Options { contacts: 2, ..options("sphere:0.1mm", 1) };
    let error = simulate(&speck).unwrap_err().to_string();
    assert!(error.contains("the hand closed on nothing in 50 attempts"), "{error}");
}

#[test]
fn a_log_and_its_mesh_are_written_together_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.jsonl");
    let simulation = simulate(&options("box:0.12x0.06x0.06", 1)).unwrap();
    simulation.write(&path).unwrap();
    let read = GraspLog::read(&path).unwrap();
    let Some(TrueShape::Mesh { path: name, file }) = &read.shape else {
        panic!("{:?}", read.shape);
    };
    assert_eq!((name.as_str(), file), ("box.ply", &folder.path().join("box.ply")));
    assert_eq!(read.noise, simulation.log.noise);
    // Poses survive the file to the last digits.
    for (a, b) in read.grasps.iter().zip(&simulation.log.grasps) {
        assert_eq!(a.contacts.len(), b.contacts.len());
        let (a, b) = (a.truth.unwrap(), b.truth.unwrap());
        assert!((a.translation.vector - b.translation.vector).norm() < 1e-12);
    }

    // The user's own mesh is named, not overwritten.
    let mug = folder.path().join("mug.ply");
    std::fs::copy(file, &mug).unwrap();
    let before = std::fs::metadata(&mug).unwrap().modified().unwrap();
    let mesh = simulate(&options(mug.to_str().unwrap(), 1)).unwrap();
    assert!(mesh.log.description.starts_with("simulated mug.ply: 20"), "{}", mesh.log.description);
    mesh.write(&folder.path().join("mug.jsonl")).unwrap();
    assert_eq!(std::fs::metadata(&mug).unwrap().modified().unwrap(), before);
    assert!(GraspLog::read(&folder.path().join("mug.jsonl")).unwrap().shape.is_some());

    // Nor when another object is simulated there, though the log names it; what an earlier one wrote is replaced.
    let ball = simulate(&options("sphere:0.08", 1)).unwrap();
    for taken in ["mug", "own"] {
        std::fs::write(folder.path().join("own.ply"), "mine").unwrap();
        let error = ball.write(&folder.path().join(taken).with_extension("jsonl")).unwrap_err();
        assert!(matches!(error, SimError::Taken { .. }), "{error}");
        assert!(error.to_string().contains(&format!("{taken}.ply is there already")), "{error}");
    }
    assert_eq!(std::fs::read(folder.path().join("own.ply")).unwrap(), b"mine");
    ball.write(&path).unwrap();
    assert_ne!(std::fs::read(file).unwrap(), std::fs::read(&mug).unwrap());
    // The same mesh without its log may be said again.
    std::fs::remove_file(&path).unwrap();
    ball.write(&path).unwrap();

    // A log that cannot be written leaves no mesh, a mesh that cannot be written no log.
    let count = || std::fs::read_dir(folder.path()).unwrap().count();
    let before = count();
    assert!(simulation.write(folder.path()).is_err());
    assert!(simulation.write(&folder.path().join("none/a.jsonl")).is_err());
    std::fs::create_dir(folder.path().join("full.ply")).unwrap();
    assert!(simulation.write(&folder.path().join("full.jsonl")).is_err());
    assert!(simulation.write(&folder.path().join("a.ply")).is_err());
    assert_eq!(count(), before + 1);
}
