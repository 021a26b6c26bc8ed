//! Reading pushes and making grasps of them.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::*;

/// A push of the block at (x, y) m and `yaw` rad that ends with the tip at `local` in the block's
/// frame and the force `on` (newtons, block's frame) on the block; written as the robot would.
struct Fixture {
    at: (f64, f64, f64),
    local: (f64, f64),
    on: (f64, f64),
    start: f64,
}

impl Fixture {
    fn text(&self) -> String {
        let (x, y, yaw) = self.at;
        let turn =
            |a: f64, (u, v): (f64, f64)| (a.cos() * u - a.sin() * v, a.sin() * u + a.cos() * v);
        let mut text = String::new();
        let pose = |x: f64, y: f64, a: f64| {
            format!("{} {} 10 {} 0 0 {}", x * 1e3, y * 1e3, (a / 2.0).cos(), (a / 2.0).sin())
        };
        writeln!(text, "{}\n{}", pose(x - 0.01, y, yaw - 0.1), pose(x, y, yaw)).unwrap();
        // The tool is turned by 0.7; the matrix −1/√2 [[1,1],[1,−1]] is its own inverse.
        let (fx, fy) = turn(yaw - 0.7, self.on);
        let s = -std::f64::consts::FRAC_1_SQRT_2;
        let (fx, fy) = (s * (fx + fy), s * (fx - fy));
        writeln!(text, "40").unwrap();
        for k in 0..40 {
            // Offsets of 0.3 and −0.2 N, then the load.
            let load = if k < 15 { 0.0 } else { 1.0 };
            let time = self.start + 0.01 * k as f64;
            writeln!(text, "{time} {} {}", 0.3 + load * fx, -0.2 + load * fy).unwrap();
        }
        let (tx, ty) = turn(yaw, self.local);
        writeln!(text, "2").unwrap();
        writeln!(text, "{} {}", self.start, pose(x + tx - 0.02, y + ty, 0.7)).unwrap();
        writeln!(text, "{} {}", self.start + 0.35, pose(x + tx, y + ty, 0.7)).unwrap();
        text
    }
}

fn file(pushes: &[Fixture]) -> String {
    pushes.iter().fold(format!("{}\n", pushes.len()), |text, push| text + &push.text())
}

/// Ten contacts along the lower edge and three on the left one, at changing poses.
fn fixtures() -> Vec<Fixture> {
    let lower = (0..10).map(|k| {
        let k = k as f64;
        let at = (0.5 + 0.01 * k, 0.1 - 0.02 * k, 0.3 * k);
        Fixture { at, local: (0.02 + 0.008 * k, 0.0), on: (1.0, 3.0), start: 1e9 + 10.0 * k }
    });
    let left = (0..3).map(|k| Fixture {
        at: (0.4, 0.2, -0.5),
        local: (0.0, 0.05 + 0.03 * k as f64),
        on: (2.0, 0.0),
        start: 1e9 + 1e3 + k as f64,
    });
    lower.chain(left).collect()
}

fn pushes() -> Vec<Push> {
    parse(&file(&fixtures()), Path::new("some.txt")).unwrap()
}

#[test]
fn forces_and_poses_are_those_of_the_recording() {
    for (push, fixture) in pushes().iter().zip(fixtures()) {
        let pose = push.pose();
        let (x, y, yaw) = fixture.at;
        assert!((pose.translation.vector - Point::new(x, y, 0.0)).norm() < 1e-9);
        assert!((pose.rotation.angle_to(&space::planar(0.0, 0.0, yaw).rotation)) < 1e-7);
        let force = pose.inverse_transform_vector(&push.force().unwrap());
        let expected = Point::new(fixture.on.0, fixture.on.1, 0.0);
        assert!((force - expected).norm() < 1e-6, "{force} {expected}");
    }
}

#[test]
fn each_push_is_a_grasp_with_the_recorded_motion() {
    let log = log(&pushes(), &Motion::Recorded, Normals::Force, "d");
    assert_eq!((log.dimension, log.grasps.len(), &*log.fingers), (2, 13, &["probe".into()][..]));
    for (grasp, fixture) in log.grasps.iter().zip(fixtures()) {
        let [contact] = &grasp.contacts[..] else { panic!() };
        let truth = grasp.truth.unwrap();
        let local = truth.inverse_transform_point(&contact.point.into()).coords;
        assert!((local - Point::new(fixture.local.0, fixture.local.1, 0.0)).norm() < 1e-9);
        assert_eq!(contact.normal_noise, Some(FORCE_NOISE));
        let outward = -Point::new(fixture.on.0, fixture.on.1, 0.0).normalize();
        let normal = truth.inverse_transform_vector(&contact.normal.unwrap());
        assert!(normal.angle(&outward) < 1e-6);
        assert!((grasp.time.unwrap() - (fixture.start - 1e9 + 0.35)).abs() < 1e-6);
    }
    assert_eq!(log.grasps[0].motion, None);
    for pair in log.grasps.windows(2) {
        let predicted = pair[1].motion.unwrap() * pair[0].truth.unwrap();
        let error = predicted.inverse() * pair[1].truth.unwrap();
        assert!(error.translation.vector.norm() < 1e-12 && error.rotation.angle() < 1e-7);
    }
    let mut bytes = Vec::new();
    log.to_writer(&mut bytes).unwrap();
    GraspLog::parse(&bytes[..], Path::new("x")).expect("what is written can be read");
}

#[test]
fn normals_come_from_where_they_were_asked() {
    let normal = |normals, k: usize| {
        let log = log(&pushes(), &Motion::Recorded, normals, "");
        let truth = log.grasps[k].truth.unwrap();
        let contact = &log.grasps[k].contacts[0];
        contact.normal.map(|n| (truth.inverse_transform_vector(&n), contact.normal_noise.unwrap()))
    };
    // The lower edge has neighbours; the force on it is 18° off.
    for normals in [Normals::Auto, Normals::Geometry] {
        let (n, deviation) = normal(normals, 4).unwrap();
        assert!(n.angle(&-Point::y()) < 1e-6 && deviation < 0.1);
    }
    let (n, deviation) = normal(Normals::Force, 4).unwrap();
    assert!((n.angle(&-Point::y()).tan() - 1.0 / 3.0).abs() < 1e-6 && deviation == FORCE_NOISE);
    // The left edge has too few.
    let (n, deviation) = normal(Normals::Auto, 11).unwrap();
    assert!(n.angle(&-Point::x()) < 1e-6 && deviation == FORCE_NOISE);
    assert_eq!(normal(Normals::Geometry, 11), None);
    assert_eq!(normal(Normals::None, 4), None);
}

fn invented(noise: Deviation, group: usize, seed: u64) -> GraspLog {
    log(&pushes(), &Motion::Invented { noise, group, seed }, Normals::Force, "")
}

const NOISE: Deviation = Deviation { length: 0.01, angle: 0.35 };

#[test]
fn groups_use_every_contact_once() {
    // Thirteen contacts: with six in a grasp one is left over, with five three.
    for (group, sizes) in [(5, vec![5, 5, 3]), (6, vec![6, 6]), (13, vec![13]), (40, vec![13])] {
        let log = invented(NOISE, group, 3);
        assert_eq!(log.grasps.iter().map(|g| g.contacts.len()).collect::<Vec<_>>(), sizes);
        let mut found: Vec<(i64, i64)> = Vec::new();
        for grasp in &log.grasps {
            let truth = grasp.truth.unwrap();
            for contact in &grasp.contacts {
                let p = truth.inverse_transform_point(&contact.point.into());
                found.push(((p.x * 1e6).round() as i64, (p.y * 1e6).round() as i64));
            }
        }
        let mut all: Vec<(i64, i64)> = fixtures()
            .iter()
            .map(|f| ((f.local.0 * 1e6).round() as i64, (f.local.1 * 1e6).round() as i64))
            .collect();
        let count = found.len();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found.len(), count, "no contact twice");
        all.retain(|p| found.contains(p));
        assert_eq!(all.len(), count, "only real contacts");
    }
    assert_eq!(invented(NOISE, 5, 3), invented(NOISE, 5, 3));
    assert_ne!(invented(NOISE, 5, 3), invented(NOISE, 5, 4));
}

#[test]
fn the_object_turns_and_slips_about_its_centroid() {
    let centroid = Point::new(0.05, 0.05, 0.0);
    let (mut count, mut length, mut angle) = (0.0, 0.0, 0.0);
    for seed in 0..400 {
        let log = invented(NOISE, 3, seed);
        assert_eq!((log.noise.translation, log.noise.rotation), (Some(0.01), Some(0.35)));
        let start = log.grasps[0].truth.unwrap().transform_point(&centroid.into());
        assert!(start.coords.norm() < 1e-12 && log.grasps[0].motion.is_none());
        for pair in log.grasps.windows(2) {
            let (before, after) = (pair[0].truth.unwrap(), pair[1].truth.unwrap());
            let motion = pair[1].motion.unwrap();
            let centre = before.transform_point(&centroid.into());
            assert!((motion.transform_point(&centre) - centre).norm() < 1e-12, "turned in place");
            assert!((space::angle(&motion) - REORIENTATION).abs() < 1e-12);
            let slip = after.transform_point(&centroid.into()) - centre;
            let turned = space::angle(&((motion * before).inverse() * after));
            count += 1.0;
            length += slip.norm_squared() / 2.0;
            angle += turned * turned;
        }
    }
    assert!(((length / count).sqrt() / 0.01 - 1.0).abs() < 0.05);
    assert!(((angle / count).sqrt() / 0.35 - 1.0).abs() < 0.05);
    let still = invented(Deviation { length: 0.0, angle: 0.0 }, 3, 1);
    let least = [Noise::LEAST_TRANSLATION, Noise::LEAST_ROTATION].map(Some);
    assert_eq!([still.noise.translation, still.noise.rotation], least);
    for (k, grasp) in still.grasps.iter().enumerate() {
        let yaw = space::angle(&grasp.truth.unwrap());
        assert!((yaw - k as f64 * REORIENTATION).abs() < 1e-9);
    }
}

#[test]
fn wrong_recordings_are_refused_with_their_place() {
    let good = file(&fixtures()[..2]);
    let refused = |text: &str, expected: &str| {
        let error = parse(text, Path::new("some.txt")).unwrap_err().to_string();
        assert!(error.starts_with("some.txt, line ") && error.contains(expected), "{error}");
    };
    refused("", "line 1: expected the number of pushes, found the end of the file");
    refused("0\n", "expected at least one push");
    refused("many", "line 1: column 1: expected the number of pushes (a whole number), found");
    refused("99999999999", "expected the number of pushes");
    refused("OFF 3 0 0", "expected the number of pushes");
    let cut = &good[..good.len() - 3];
    refused(cut.rsplit_once(' ').unwrap().0, "push 1 of 2: tip position 1 of 2: qz, found the end");
    let lines: Vec<&str> = good.lines().collect();
    refused(&lines[..20].join("\n"), "line 20: expected push 0 of 2: time of force reading 16");
    let changed = |line: usize, to: &str| {
        let mut lines = lines.clone();
        lines[line - 1] = to;
        lines.join("\n")
    };
    refused(&changed(2, "1 2 x 1 0 0 0"), "line 2: column 5: expected push 0 of 2: pose before: z");
    refused(&changed(2, "1 2 inf 1 0 0 0"), "pose before: z (a finite number), found \"inf\"");
    refused(&changed(3, "1 2 3 1 1 0 0"), "line 3: push 0 of 2: pose after: expected a quaternion");
    refused(&changed(3, "1e9 2 3 1 0 0 0"), "pose after: expected a position within");
    refused(&changed(4, "40.5"), "line 4: column 1: expected push 0 of 2: the number of force");
    refused(&changed(4, "-1"), "the number of force readings");
    refused(&changed(45, "0"), "line 45: push 0 of 2: expected at least one tip position");
    refused(&(good.clone() + "7"), "column 1: expected the end of the file after 2 pushes");
    // One reading more than there are shifts everything: it must not pass.
    refused(&changed(4, "41"), "push 0 of 2");
}

#[test]
fn a_push_without_force_has_no_normal() {
    let mut pushes = pushes();
    pushes[0].forces.clear();
    for (_, force) in &mut pushes[1].forces {
        *force = [0.3, -0.2];
    }
    let log = log(&pushes, &Motion::Recorded, Normals::Auto, "");
    let [first, second] = [&log.grasps[0].contacts[0], &log.grasps[1].contacts[0]];
    assert_eq!((first.force, first.normal, first.normal_noise), (None, None, None));
    assert!(second.force.unwrap() < 1e-9 && second.normal.is_none());
}

/// The recordings, with their names.
fn real() -> Option<Vec<(String, Vec<Push>)>> {
    let folder = crate::data::for_test("push")?;
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap().path();
        if entry.is_dir() {
            files.extend(std::fs::read_dir(&entry).unwrap().map(|f| f.unwrap().path()));
        }
    }
    files.retain(|f| f.file_name().unwrap().to_string_lossy().starts_with("exp_"));
    files.sort();
    assert!(!files.is_empty());
    Some(files.iter().map(|f| (f.display().to_string(), read(f).unwrap())).collect())
}

/// Signed distance to the nearest edge of the true triangle, and that edge's outward normal.
fn edge(p: &Point) -> (f64, Point) {
    let s = std::f64::consts::FRAC_1_SQRT_2;
    [(-p.y, -Point::y()), ((p.x + p.y - 0.15) * s, Point::new(s, s, 0.0)), (-p.x, -Point::x())]
        .into_iter()
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap()
}

/// Root mean square.
fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(q * (sorted.len() - 1) as f64) as usize]
}

#[test]
fn real_contacts_lie_on_the_block_and_normals_are_as_good_as_they_claim() {
    let Some(files) = real() else { return };
    let mut count = 0;
    let mut distances = Vec::new();
    let (mut force, mut line, mut line_claimed) = (Vec::new(), Vec::new(), Vec::new());
    for (name, pushes) in &files {
        let mut here = Vec::new();
        for touch in touches(pushes, Normals::Force) {
            let (distance, normal) = edge(&touch.bare.point);
            here.push(distance);
            force.push(touch.normal.unwrap().0.angle(&normal).to_degrees());
        }
        assert!(here.iter().all(|d| d.abs() < 2.5e-3), "{name}: a contact off the block");
        for touch in touches(pushes, Normals::Geometry) {
            count += 1;
            if let Some((n, deviation)) = touch.normal {
                let error = n.angle(&edge(&touch.bare.point).1);
                line.push(error.to_degrees());
                line_claimed.push(error / deviation);
            }
        }
        distances.extend(here);
    }
    println!(
        "{count} contacts of {} files: distance to the edge rms {:.2} mm\n\
         normal from force: median {:.1}°, 90 % {:.1}°, rms {:.1}°\n\
         normal from geometry: {} of them, median {:.1}°, 90 % {:.1}°, largest {:.1}°, rms of error over claim {:.2}",
        files.len(),
        rms(&distances) * 1e3,
        quantile(&force, 0.5),
        quantile(&force, 0.9),
        rms(&force),
        line.len(),
        quantile(&line, 0.5),
        quantile(&line, 0.9),
        quantile(&line, 1.0),
        rms(&line_claimed),
    );
    assert!((rms(&distances) / POINT_NOISE - 1.0).abs() < 0.05);
    assert!((rms(&force).to_radians() / FORCE_NOISE - 1.0).abs() < 0.05);
    assert!(line.len() * 4 > count * 3, "geometry serves most contacts");
    assert!(quantile(&line, 0.9) < 4.0 && quantile(&line, 1.0) < 10.0);
    assert!(rms(&line_claimed) < 1.0);
}

#[test]
fn real_pushes_become_logs() {
    let Some(files) = real() else { return };
    for (name, pushes) in &files {
        let recorded = log(pushes, &Motion::Recorded, Normals::Auto, name);
        assert_eq!(recorded.grasps.len(), pushes.len());
        assert!(recorded.grasps.iter().all(|g| g.time.is_some() && g.contacts.len() == 1));
        let motion = Motion::Invented { noise: NOISE, group: 5, seed: 1 };
        let moved = log(pushes, &motion, Normals::Auto, name);
        assert_eq!(moved.grasps.len(), pushes.len() / 5);
        for log in [recorded, moved] {
            for grasp in &log.grasps {
                let truth = grasp.truth.unwrap();
                for contact in &grasp.contacts {
                    let p = truth.inverse_transform_point(&contact.point.into()).coords;
                    let (distance, normal) = edge(&p);
                    assert!(distance.abs() < 2.5e-3, "{name}");
                    let n = truth.inverse_transform_vector(&contact.normal.unwrap());
                    assert!(n.angle(&normal).to_degrees() < 50.0, "{name}");
                }
            }
            let mut bytes = Vec::new();
            log.to_writer(&mut bytes).unwrap();
            GraspLog::parse(&bytes[..], Path::new("x")).expect("what is written can be read");
        }
    }
}
