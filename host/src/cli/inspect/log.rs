//! What is in a grasp log, as figures and in words.

use std::fmt::Write as _;

use serde::Serialize;

use crate::log::words::{self, Kind};
use crate::log::{FORMAT, GraspLog, LoggedContact, TrueShape, VERSION};
use crate::space::{Point, Pose};

/// What is in a grasp log. Lengths are metres and angles radians unless a name says otherwise;
/// `None` where the log does not say.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    format: &'static str,
    version: u64,
    dimension: usize,
    description: String,
    grasps: Grasps,
    contacts: Contacts,
    fingers: Vec<Finger>,
    /// Of the fingertips, where the log has their words.
    sensors: Option<Sensors>,
    noise: Noise,
    motion: Motion,
    truth: Truth,
}

#[derive(Debug, Serialize)]
struct Grasps {
    count: usize,
    /// Without a contact.
    empty: usize,
    first: u64,
    last: u64,
    /// Runs of numbers that are missing between the first and the last, both ends included.
    missing: Vec<[u64; 2]>,
    seconds: Option<Seconds>,
}

#[derive(Debug, Serialize)]
struct Seconds {
    first: f64,
    last: f64,
    longest_pause: f64,
    /// The grasp after it.
    longest_pause_before: u64,
}

#[derive(Debug, Serialize)]
struct Contacts {
    count: usize,
    fewest: usize,
    most: usize,
    with_normal: usize,
    with_force: usize,
    free: usize,
    /// Newtons.
    force: Option<Spread>,
    /// Standard deviations of single normals, where they differ from the log's.
    normal_noise: Option<Spread>,
    /// Least and greatest coordinates in the world.
    world: Option<[Vec<f64>; 2]>,
    /// The same in the frame of the object, where all true poses are known.
    object: Option<[Vec<f64>; 2]>,
}

#[derive(Debug, Serialize)]
struct Finger {
    /// `None` for contacts of no finger.
    name: Option<String>,
    contacts: usize,
    free: usize,
}

#[derive(Debug, Serialize)]
struct Sensors {
    kind: Kind,
    /// Microseconds between readings.
    period: u32,
    /// Readings at rest, of all fingers.
    rest: usize,
    /// Contacts with words.
    contacts: usize,
    /// Their readings.
    readings: usize,
    /// Contacts whose words cannot be read.
    unreadable: usize,
    /// Least and greatest word of each channel, contacts only.
    words: Vec<[i32; 2]>,
}

#[derive(Debug, Serialize)]
struct Noise {
    point: Option<f64>,
    normal: Option<f64>,
    translation: Option<f64>,
    rotation: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Motion {
    known: usize,
    /// After the first grasp.
    unknown: usize,
    /// How far the motion takes the centre of the contacts of the grasp before.
    translation: Option<Spread>,
    rotation: Option<Spread>,
    /// True pose against motion · previous true pose: at the origin of the object.
    translation_error: Option<Spread>,
    rotation_error: Option<Spread>,
}

#[derive(Debug, Serialize)]
struct Truth {
    poses: usize,
    /// Vertices of the true polygon.
    polygon: Option<usize>,
    /// The true mesh's file.
    mesh: Option<String>,
    mesh_exists: Option<bool>,
}

/// Of sizes, all positive.
#[derive(Debug, PartialEq, Serialize)]
struct Spread {
    least: f64,
    median: f64,
    rms: f64,
    greatest: f64,
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Option<Spread> {
        values.sort_by(f64::total_cmp);
        let (least, greatest) = (*values.first()?, *values.last()?);
        let n = values.len();
        let median = 0.5 * (values[(n - 1) / 2] + values[n / 2]);
        let rms = (values.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt();
        Some(Spread { least, median, rms, greatest })
    }
}

impl Summary {
    pub(super) fn of(log: &GraspLog) -> Summary {
        Summary {
            format: FORMAT,
            version: VERSION,
            dimension: log.dimension,
            description: log.description.clone(),
            grasps: Grasps::of(log),
            contacts: Contacts::of(log),
            fingers: fingers(log),
            sensors: Sensors::of(log),
            noise: Noise {
                point: log.noise.point,
                normal: log.noise.normal,
                translation: log.noise.translation,
                rotation: log.noise.rotation,
            },
            motion: Motion::of(log),
            truth: Truth::of(log),
        }
    }

    /// In words, one line for each thing.
    pub(super) fn text(&self) -> String {
        let mut lines = Lines(String::new());
        lines.add("what", format!("grasp log, version {VERSION}, {}D", self.dimension));
        if !self.description.is_empty() {
            lines.add("description", &self.description);
        }
        self.grasps.tell(&mut lines);
        self.felt(&mut lines);
        self.moved(&mut lines);
        let Truth { polygon, mesh, mesh_exists, poses } = &self.truth;
        let shape = match (polygon, mesh) {
            (Some(n), _) => format!("polygon of {n} vertices"),
            (_, Some(mesh)) if *mesh_exists == Some(true) => format!("mesh {mesh}"),
            (_, Some(mesh)) => format!("mesh {mesh}, which is missing"),
            _ => "no shape".into(),
        };
        lines.add("truth", format!("{shape}, {poses} poses"));
        lines.0
    }

    /// Contacts, who made them, and where they are.
    fn felt(&self, lines: &mut Lines) {
        let Contacts { count, fewest, most, with_normal, with_force, free, .. } = &self.contacts;
        lines.add("contacts", format!("{count}, {fewest}–{most} in a grasp, {with_normal} with normal, {with_force} with force, {free} free points"));
        for finger in &self.fingers {
            let name = finger.name.as_deref().unwrap_or("(no finger)");
            lines.add("", format!("{name}: {} contacts, {} free", finger.contacts, finger.free));
        }
        if let Some(sensors) = &self.sensors {
            lines.add("sensors", sensors.text());
            let ends: Vec<_> = sensors.words.iter().map(|[a, b]| format!("{a}…{b}")).collect();
            lines.add("", format!("words {}", ends.join(", ")));
        }
        if let Some(force) = &self.contacts.force {
            lines.add("force", force.text(1.0, "N"));
        }
        let spans =
            [("span in world", &self.contacts.world), ("span in object", &self.contacts.object)];
        for (name, span) in spans {
            let Some([least, greatest]) = span else { continue };
            let sides = least.iter().zip(greatest).map(|(a, b)| format!("{:.1}", (b - a) * 1e3));
            lines.add(name, format!("{} mm", sides.collect::<Vec<_>>().join(" × ")));
        }
    }

    /// What noise the log states, and how the object moved.
    fn moved(&self, lines: &mut Lines) {
        let Summary { noise, motion, .. } = self;
        let mm = |x: Option<f64>| x.map_or("unknown".into(), |x| format!("{:.3} mm", x * 1e3));
        let deg =
            |x: Option<f64>| x.map_or("unknown".into(), |x| format!("{:.2}°", x.to_degrees()));
        let (point, normal) = (mm(noise.point), deg(noise.normal));
        lines.add("contact noise", format!("point {point}, normal {normal}"));
        let angle = 1f64.to_degrees();
        if let Some(own) = &self.contacts.normal_noise {
            lines.add("", format!("own normal noise {}", own.text(angle, "°")));
        }
        let (translation, rotation) = (mm(noise.translation), deg(noise.rotation));
        lines.add("motion noise", format!("translation {translation}, rotation {rotation}"));
        let unknown = some(motion.unknown, " times unknown");
        lines.add("motion", format!("known {} times{unknown}", motion.known));
        for (name, spread, scale, unit) in [
            ("translation", &motion.translation, 1e3, "mm"),
            ("rotation", &motion.rotation, angle, "°"),
            ("translation error", &motion.translation_error, 1e3, "mm"),
            ("rotation error", &motion.rotation_error, angle, "°"),
        ] {
            if let Some(spread) = spread {
                lines.add("", format!("{name} {}", spread.text(scale, unit)));
            }
        }
    }
}

impl Sensors {
    /// `None` without sensors in the header, or with some that cannot be read.
    fn of(log: &GraspLog) -> Option<Sensors> {
        let words::Sensors { kind, period, rest, .. } = words::Sensors::of(log).ok().flatten()?;
        let mut sensors = Sensors {
            kind,
            period,
            rest: rest.iter().map(Vec::len).sum(),
            contacts: 0,
            readings: 0,
            unreadable: 0,
            words: vec![[i32::MAX, i32::MIN]; kind.channels()],
        };
        for contact in log.grasps.iter().flat_map(|g| &g.contacts) {
            match words::Words::of(contact) {
                Ok(Some(read)) => {
                    sensors.contacts += 1;
                    sensors.readings += read.words.len();
                    for reading in &read.words {
                        for ([least, most], &word) in sensors.words.iter_mut().zip(reading) {
                            (*least, *most) = ((*least).min(word), (*most).max(word));
                        }
                    }
                }
                Ok(None) => {}
                Err(_) => sensors.unreadable += 1,
            }
        }
        sensors.words.retain(|[least, most]| least <= most);
        Some(sensors)
    }

    fn text(&self) -> String {
        let kind = match self.kind {
            Kind::Wrench => "force/torque transducers",
            Kind::Electrodes => "electrode arrays",
        };
        format!(
            "{kind}, a reading every {} µs, {} readings of {} contacts, {} at rest{}",
            self.period,
            self.readings,
            self.contacts,
            self.rest,
            some(self.unreadable, " contacts with unreadable words")
        )
    }
}

impl Spread {
    fn text(&self, scale: f64, unit: &str) -> String {
        let [least, median, rms, greatest] =
            [self.least, self.median, self.rms, self.greatest].map(|x| x * scale);
        format!("{least:.2}–{greatest:.2} {unit}, median {median:.2}, rms {rms:.2}")
    }
}

/// Lines with their names in a column.
struct Lines(String);

impl Lines {
    fn add(&mut self, name: &str, value: impl std::fmt::Display) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{name:<15} {value}");
    }
}

fn some(count: usize, what: &str) -> String {
    if count == 0 { String::new() } else { format!(", {count}{what}") }
}

impl Grasps {
    fn tell(&self, lines: &mut Lines) {
        let empty = some(self.empty, " without contacts");
        lines.add("grasps", format!("{}, numbers {}–{}{empty}", self.count, self.first, self.last));
        if !self.missing.is_empty() {
            let run = |[a, b]: &[u64; 2]| if a == b { a.to_string() } else { format!("{a}–{b}") };
            let runs: Vec<_> = self.missing.iter().take(20).map(run).collect();
            let more = if self.missing.len() > 20 { ", …" } else { "" };
            lines.add("missing", format!("grasps {}{more}", runs.join(", ")));
        }
        let Some(Seconds { first, last, longest_pause, longest_pause_before }) = &self.seconds
        else {
            return;
        };
        let pause = if *longest_pause > 0.0 {
            format!(", longest pause {longest_pause:.2} s before grasp {longest_pause_before}")
        } else {
            String::new()
        };
        lines.add("time", format!("{first:.2}–{last:.2} s{pause}"));
    }

    fn of(log: &GraspLog) -> Grasps {
        let mut missing = Vec::new();
        let mut seconds: Option<Seconds> = None;
        for pair in log.grasps.windows(2) {
            if pair[1].index - pair[0].index > 1 {
                missing.push([pair[0].index + 1, pair[1].index - 1]);
            }
        }
        for grasp in &log.grasps {
            let Some(time) = grasp.time else { continue };
            let seconds = seconds.get_or_insert(Seconds {
                first: time,
                last: time,
                longest_pause: 0.0,
                longest_pause_before: grasp.index,
            });
            if time - seconds.last > seconds.longest_pause {
                seconds.longest_pause = time - seconds.last;
                seconds.longest_pause_before = grasp.index;
            }
            seconds.last = time;
        }
        Grasps {
            count: log.grasps.len(),
            empty: log.grasps.iter().filter(|g| g.contacts.is_empty()).count(),
            first: log.grasps.first().map_or(0, |g| g.index),
            last: log.grasps.last().map_or(0, |g| g.index),
            missing,
            seconds,
        }
    }
}

impl Contacts {
    fn of(log: &GraspLog) -> Contacts {
        let all = || log.grasps.iter().flat_map(|g| &g.contacts);
        let sizes = || log.grasps.iter().map(|g| g.contacts.len());
        let in_object = log.grasps.iter().map(|g| Some((g.truth?, &g.contacts)));
        let object =
            in_object.collect::<Option<Vec<(Pose, &Vec<LoggedContact>)>>>().map(|grasps| {
                let local = |pose: &Pose, c: &LoggedContact| {
                    pose.inverse_transform_point(&c.point.into()).coords
                };
                grasps.iter().flat_map(|(pose, c)| c.iter().map(|c| local(pose, c))).collect()
            });
        Contacts {
            count: all().count(),
            fewest: sizes().min().unwrap_or(0),
            most: sizes().max().unwrap_or(0),
            with_normal: all().filter(|c| c.normal.is_some()).count(),
            with_force: all().filter(|c| c.force.is_some()).count(),
            free: log.grasps.iter().map(|g| g.free.len()).sum(),
            force: Spread::of(all().filter_map(|c| c.force).collect()),
            normal_noise: Spread::of(all().filter_map(|c| c.normal_noise).collect()),
            world: span(all().map(|c| c.point).collect(), log.dimension),
            object: object.and_then(|points| span(points, log.dimension)),
        }
    }
}

/// Least and greatest coordinates.
fn span(points: Vec<Point>, dimension: usize) -> Option<[Vec<f64>; 2]> {
    let first = *points.first()?;
    let (least, greatest) = points.iter().fold((first, first), |(a, b), p| (a.inf(p), b.sup(p)));
    Some([least, greatest].map(|p| p.iter().take(dimension).copied().collect()))
}

fn fingers(log: &GraspLog) -> Vec<Finger> {
    let count = |finger: Option<usize>| {
        let contacts = log.grasps.iter().flat_map(|g| &g.contacts);
        let free = log.grasps.iter().flat_map(|g| &g.free);
        Finger {
            name: finger.and_then(|f| log.fingers.get(f).cloned()),
            contacts: contacts.filter(|c| c.finger == finger).count(),
            free: free.filter(|f| f.finger == finger).count(),
        }
    };
    let mut fingers: Vec<Finger> = (0..log.fingers.len()).map(|f| count(Some(f))).collect();
    let nameless = count(None);
    if nameless.contacts + nameless.free > 0 {
        fingers.push(nameless);
    }
    fingers
}

impl Motion {
    fn of(log: &GraspLog) -> Motion {
        let [mut translation, mut rotation, mut translation_error, mut rotation_error] =
            [const { Vec::new() }; 4];
        let mut centre = Point::zeros();
        let mut unknown = 0;
        for (k, grasp) in log.grasps.iter().enumerate() {
            if let Some(motion) = &grasp.motion {
                let moved = motion.transform_point(&centre.into()).coords;
                translation.push((moved - centre).norm());
                rotation.push(motion.rotation.angle());
                let before = k.checked_sub(1).and_then(|k| log.grasps[k].truth);
                if let (Some(before), Some(after)) = (before, grasp.truth) {
                    let error = (motion * before).inverse() * after;
                    translation_error.push(error.translation.vector.norm());
                    rotation_error.push(error.rotation.angle());
                }
            } else if k > 0 {
                unknown += 1;
            }
            if !grasp.contacts.is_empty() {
                let sum: Point = grasp.contacts.iter().map(|c| c.point).sum();
                centre = sum / grasp.contacts.len() as f64;
            }
        }
        Motion {
            known: translation.len(),
            unknown,
            translation: Spread::of(translation),
            rotation: Spread::of(rotation),
            translation_error: Spread::of(translation_error),
            rotation_error: Spread::of(rotation_error),
        }
    }
}

impl Truth {
    fn of(log: &GraspLog) -> Truth {
        let (polygon, mesh) = match &log.shape {
            Some(TrueShape::Polygon(vertices)) => (Some(vertices.len()), None),
            Some(TrueShape::Mesh { path, file }) => (None, Some((path.clone(), file.is_file()))),
            None => (None, None),
        };
        Truth {
            poses: log.grasps.iter().filter(|g| g.truth.is_some()).count(),
            polygon,
            mesh_exists: mesh.as_ref().map(|(_, exists)| *exists),
            mesh: mesh.map(|(path, _)| path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const LOG: &str = r#"{"format":"tactile-grasp-log","version":1,"dimension":2,"description":"a test","fingers":["ff","th"],"noise":{"point":0.001},"truth":{"shape":{"polygon":[[0,0],[1,0],[0,1]]}}}
{"grasp":2,"time":1,"contacts":[{"finger":"ff","point":[0.1,0.2],"normal":[1,0],"force":3},{"point":[0.3,0.2],"normal_noise":0.1}],"free":[{"finger":"th","point":[0,0]}],"truth":{"pose":{"translation":[0,0],"rotation":0}}}
{"grasp":5,"time":4,"motion":{"translation":[0.03,0.04],"rotation":0},"contacts":[],"truth":{"pose":{"translation":[0.03,0.05],"rotation":0.2}}}
{"grasp":6,"time":6,"contacts":[{"finger":"ff","point":[0.1,0.1],"force":4}],"truth":{"pose":{"translation":[0,0],"rotation":1.5707963267948966}}}
"#;

    fn summary() -> Summary {
        Summary::of(&GraspLog::parse(LOG.as_bytes(), Path::new("x")).unwrap())
    }

    #[test]
    fn the_figures_are_those_of_the_log() {
        let json = serde_json::to_value(summary()).unwrap();
        let is = |pointer: &str, expected: serde_json::Value| {
            let found = json.pointer(pointer).unwrap_or_else(|| panic!("no {pointer}"));
            match (found.as_f64(), expected.as_f64()) {
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-9, "{pointer}: {a}, not {b}"),
                _ => assert_eq!(*found, expected, "{pointer}"),
            }
        };
        use serde_json::json;
        is("/dimension", json!(2));
        is("/grasps/count", json!(3));
        is("/grasps/empty", json!(1));
        is("/grasps/missing", json!([[3, 4]]));
        is("/grasps/seconds/longest_pause", json!(3.0));
        is("/grasps/seconds/longest_pause_before", json!(5));
        is("/contacts/count", json!(3));
        is("/contacts/with_normal", json!(1));
        is("/contacts/free", json!(1));
        is("/contacts/force/median", json!(3.5));
        is("/contacts/world", json!([[0.1, 0.1], [0.3, 0.2]]));
        // The last contact, seen from the object turned by 90°, is at (0.1, −0.1).
        is("/contacts/object/0/1", json!(-0.1));
        is("/fingers/0/contacts", json!(2));
        is("/fingers/1/free", json!(1));
        is("/fingers/2/name", json!(null));
        is("/fingers/2/contacts", json!(1));
        is("/noise/point", json!(0.001));
        is("/noise/rotation", json!(null));
        is("/motion/known", json!(1));
        is("/motion/unknown", json!(1));
        is("/motion/translation/greatest", json!(0.05));
        is("/motion/translation_error/rms", json!(0.01));
        is("/motion/rotation_error/median", json!(0.2));
        is("/truth/poses", json!(3));
        is("/truth/polygon", json!(3));
    }

    #[test]
    fn the_words_name_gaps_and_unknowns() {
        let text = summary().text();
        for expected in [
            "grasps 3–4",
            "1 without contacts",
            "normal unknown",
            "1 times unknown",
            "polygon of 3",
        ] {
            assert!(text.contains(expected), "{expected:?} is not in\n{text}");
        }
    }
}
