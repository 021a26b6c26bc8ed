use std::collections::BTreeMap;

use nalgebra::{Matrix6, Vector6};
use tactile_core::track::Status;

use super::*;
use crate::log::{LoggedContact, LoggedFree};
use crate::shape::{Mesh, Outline};
use crate::space::planar;

/// Reads what [`cdr::Cdr`] writes, by the rules of the standard and not by its code.
struct Reader<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn new(data: &'a [u8]) -> Self {
        assert_eq!(data[..4], [0, 1, 0, 0]);
        Reader { body: &data[4..], at: 0 }
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.at = self.at.div_ceil(N) * N;
        self.at += N;
        self.body[self.at - N..self.at].try_into().unwrap()
    }

    fn u8(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn i32(&mut self) -> i32 {
        i32::from_le_bytes(self.take())
    }

    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }

    fn f64s<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.f64())
    }

    fn bytes(&mut self) -> &'a [u8] {
        let length = self.u32() as usize;
        self.at += length;
        &self.body[self.at - length..self.at]
    }

    fn string(&mut self) -> &'a str {
        std::str::from_utf8(self.bytes().strip_suffix(&[0]).unwrap()).unwrap()
    }

    /// Seconds and frame.
    fn header(&mut self) -> (f64, &'a str) {
        let (seconds, nanoseconds) = (self.i32(), self.u32());
        (f64::from(seconds) + f64::from(nanoseconds) * 1e-9, self.string())
    }

    fn pose(&mut self) -> Pose {
        let [x, y, z] = self.f64s();
        let [i, j, k, w] = self.f64s();
        Pose::from_parts(
            nalgebra::Translation3::new(x, y, z),
            nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, i, j, k)),
        )
    }

    fn done(self) {
        assert_eq!(self.at, self.body.len(), "nothing is left");
    }
}

/// Messages by topic: time in seconds, type, content.
type Topics = BTreeMap<String, Vec<(f64, String, Vec<u8>)>>;

fn topics(file: &[u8]) -> Topics {
    let mut topics = Topics::new();
    for message in mcap::MessageStream::new(file).unwrap() {
        let message = message.unwrap();
        let channel = &message.channel;
        assert_eq!(channel.message_encoding, "cdr");
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!(schema.encoding, "ros2msg");
        assert!(!schema.data.is_empty(), "{}", schema.name);
        let messages = topics.entry(channel.topic.clone()).or_default();
        assert_eq!(message.sequence as usize, messages.len(), "{}", channel.topic);
        let time = message.log_time as f64 * 1e-9;
        messages.push((time, schema.name.clone(), message.data.to_vec()));
    }
    topics
}

/// The four bytes of each field of a point.
type Fields<'a> = BTreeMap<&'a str, [u8; 4]>;

/// Header, points, and whether all of them are finite.
fn cloud(data: &[u8]) -> ((f64, &str), Vec<Fields<'_>>, bool) {
    let mut reader = Reader::new(data);
    let header = reader.header();
    assert_eq!(reader.u32(), 1, "height");
    let width = reader.u32() as usize;
    let fields: Vec<(&str, usize)> = (0..reader.u32())
        .map(|_| {
            let field = (reader.string(), reader.u32() as usize);
            assert!((5..=7).contains(&reader.u8()) && reader.u32() == 1);
            field
        })
        .collect();
    assert_eq!(reader.u8(), 0, "little-endian");
    let step = reader.u32() as usize;
    assert_eq!(reader.u32() as usize, step * width);
    let data = reader.bytes();
    assert_eq!(data.len(), step * width);
    let point = |point: &'_ [u8]| -> BTreeMap<&str, [u8; 4]> {
        fields.iter().map(|(name, at)| (*name, point[*at..at + 4].try_into().unwrap())).collect()
    };
    let points = data.chunks(step).map(point).collect();
    let whole = reader.u8() == 1;
    reader.done();
    (header, points, whole)
}

fn float(point: &BTreeMap<&str, [u8; 4]>, name: &str) -> f32 {
    f32::from_le_bytes(point[name])
}

fn contact(x: f64, y: f64, finger: Option<usize>) -> LoggedContact {
    let normal = finger.map(|_| Point::new(0.0, 1.0, 0.0));
    LoggedContact { finger, point: Point::new(x, y, 0.0), normal, ..LoggedContact::default() }
}

fn step(pose: Pose) -> Step {
    let covariance = Matrix6::from_diagonal(&Vector6::new(4e-6, 1e-6, 0.0, 0.0, 0.0, 0.01));
    Step {
        covariance,
        status: Status::Ambiguous,
        modes: vec![(pose, 0.75), (planar(0.0, 0.0, 2.0), 0.25)],
        ..Step::certain(pose)
    }
}

/// Two grasps of an object that lies at 90° in truth.
fn run() -> (GraspLog, Vec<Option<Step>>) {
    let quarter = std::f64::consts::FRAC_PI_2;
    let truths = [planar(0.1, 0.0, 0.0), planar(0.1, 0.02, quarter)];
    let grasps = truths.iter().enumerate().map(|(i, truth)| LoggedGrasp {
        index: i as u64,
        time: Some(0.5 + i as f64),
        contacts: vec![contact(0.1, 0.2, Some(i)), contact(-0.1, 0.2, None)],
        free: vec![LoggedFree { point: Point::new(0.3, 0.0, 0.0), ..LoggedFree::default() }],
        truth: Some(*truth),
        ..LoggedGrasp::default()
    });
    let log = GraspLog {
        dimension: 2,
        description: "two grasps".into(),
        fingers: vec!["ff".into(), "th".into()],
        noise: Default::default(),
        shape: None,
        grasps: grasps.collect(),
        unknown: Default::default(),
    };
    // The first estimate sets the object's frame; the second is 3 mm and 0.1 rad off.
    let steps =
        vec![Some(step(planar(0.0, 0.0, 0.0))), Some(step(planar(-0.003, 0.02, quarter + 0.1)))];
    (log, steps)
}

fn file(contents: &Contents<'_>) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    write(&path, contents).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    std::fs::read(path).unwrap()
}

fn square() -> Geometry {
    let side = 0.01;
    let corners = vec![[side, side], [-side, side], [-side, -side], [side, -side]];
    Geometry::Outline(Outline::new(vec![corners]).unwrap())
}

fn whole_run() -> Vec<u8> {
    let (log, steps) = run();
    let shape = square();
    let deviations = vec![1e-3, 1e-3, 2e-3, f64::NAN];
    let grown = |grasp| Grown { grasp, geometry: square(), deviations: deviations.clone() };
    file(&Contents {
        title: "a run",
        log: &log,
        steps: &steps,
        surfaces: &[grown(0), grown(1)],
        truth: Some(&shape),
        report: None,
    })
}

#[test]
fn the_file_is_indexed_compressed_and_says_what_it_is() {
    let file = whole_run();
    let summary = mcap::Summary::read(&file).unwrap().expect("a summary");
    assert!(summary.chunk_indexes.iter().all(|c| c.compression == "lz4"));
    assert!(!summary.chunk_indexes.is_empty());
    let counted = summary.stats.as_ref().unwrap().message_count;
    assert_eq!(counted, topics(&file).values().map(Vec::len).sum::<usize>() as u64);
    assert_eq!(summary.metadata_indexes[0].name, "tactile");
    let header = mcap::read::LinearReader::new(&file).unwrap().next().unwrap().unwrap();
    match header {
        mcap::records::Record::Header(header) => assert_eq!(header.profile, "ros2"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn contacts_come_back_as_they_were_felt() {
    let topics = topics(&whole_run());
    let contacts = &topics["/contacts"];
    assert_eq!(contacts.len(), 2);
    let (time, kind, data) = &contacts[1];
    assert_eq!((*time, kind.as_str()), (1.5, "sensor_msgs/msg/PointCloud2"));
    let (header, points, whole) = cloud(data);
    assert_eq!(header, (1.5, "world"));
    assert!(!whole, "the second contact has no normal");
    assert_eq!(points.len(), 2);
    let first = &points[0];
    assert_eq!(["x", "y", "z"].map(|n| float(first, n)), [0.1, 0.2, 0.0]);
    assert_eq!(["normal_x", "normal_y"].map(|n| float(first, n)), [0.0, 1.0]);
    assert_eq!(u32::from_le_bytes(first["grasp"]), 1);
    assert_eq!(i32::from_le_bytes(first["finger"]), 1);
    assert_eq!(i32::from_le_bytes(points[1]["finger"]), -1);
    assert!(float(&points[1], "normal_x").is_nan() && float(first, "force").is_nan());
    let ([blue, green, red, opaque], [opaque_too, b, g, r]) = (first["rgba"], first["colors"]);
    assert_eq!((red, green, blue, opaque), (r, g, b, opaque_too));
    assert_eq!((red, green, blue, opaque), (0x3d, 0x12, 0x78, 255), "the last grasp's");
    let (_, free, _) = cloud(&topics["/free"][0].2);
    assert_eq!(float(&free[0], "x"), 0.3);
}

#[test]
fn contacts_so_far_are_in_the_objects_frame() {
    let topics = topics(&whole_run());
    let (_, _, data) = topics["/object/contacts"].last().unwrap();
    let (header, points, _) = cloud(data);
    assert_eq!(header, (1.5, "object"));
    assert_eq!(points.len(), 4);
    let pose = run().1[1].as_ref().unwrap().pose;
    let expected = pose.inverse() * nalgebra::Point3::new(0.1, 0.2, 0.0);
    assert!((float(&points[2], "x") - expected.x as f32).abs() < 1e-6);
    let normal = pose.inverse() * Point::new(0.0, 1.0, 0.0);
    assert!((float(&points[2], "normal_x") - normal.x as f32).abs() < 1e-6);
}

#[test]
fn poses_have_covariances_in_the_axes_of_the_world() {
    let topics = topics(&whole_run());
    let (log, steps) = run();
    let expected = steps[1].as_ref().unwrap();
    let mut reader = Reader::new(&topics["/pose"][1].2);
    assert_eq!(reader.header(), (1.5, "world"));
    assert!((reader.pose().inverse() * expected.pose).translation.vector.norm() < 1e-12);
    reader.done();

    let mut reader = Reader::new(&topics["/pose_with_covariance"][1].2);
    reader.header();
    reader.pose();
    let covariance: [f64; 36] = reader.f64s();
    reader.done();
    // The object is turned by almost a right angle: what is uncertain along its x is so along y.
    let turn = std::f64::consts::FRAC_PI_2 + 0.1;
    let along_y = 4e-6 * turn.sin().powi(2) + 1e-6 * turn.cos().powi(2);
    assert!((covariance[7] - along_y).abs() < 1e-12, "{}", covariance[7]);
    assert!((covariance[35] - 0.01).abs() < 1e-12);
    assert!((covariance[1] - covariance[6]).abs() < 1e-15 && covariance[1].abs() > 1e-8);

    let mut reader = Reader::new(&topics["/tf"][1].2);
    assert_eq!(reader.u32(), 2);
    assert_eq!((reader.header().1, reader.string()), ("world", "object"));
    assert!((reader.pose().inverse() * expected.pose).rotation.angle() < 1e-9);
    assert_eq!((reader.header().1, reader.string()), ("world", "object_truth"));
    assert!((reader.pose().inverse() * log.grasps[1].truth.unwrap()).rotation.angle() < 1e-9);
    reader.done();

    let mut reader = Reader::new(&topics["/modes"][0].2);
    reader.header();
    assert_eq!(reader.u32(), 2);
    let mut reader = Reader::new(&topics["/status"][0].2);
    assert_eq!(reader.string(), "ambiguous");
}

#[test]
fn errors_are_measured_from_the_first_pose() {
    let topics = topics(&whole_run());
    let value = |topic: &str, at: usize| Reader::new(&topics[topic][at].2).f64();
    assert!(value("/error/translation_mm", 0) < 1e-9);
    assert!((value("/error/rotation_deg", 1) - 0.1f64.to_degrees()).abs() < 1e-6);
    assert!((value("/deviation/translation_mm", 0) - 2.0).abs() < 1e-9);
    assert!((value("/deviation/rotation_deg", 0) - 0.1f64.to_degrees()).abs() < 1e-9);
    let mut reader = Reader::new(&topics["/truth/pose"][0].2);
    reader.header();
    assert!(reader.pose().translation.vector.norm() < 1e-12, "both begin at the estimate");
}

#[test]
fn an_outline_is_lines_with_a_colour_at_each_end() {
    let topics = topics(&whole_run());
    let (time, kind, data) = &topics["/surface"][0];
    assert_eq!((*time, kind.as_str()), (0.5, "visualization_msgs/msg/MarkerArray"));
    let (header, kind, points, colours) = marker(data);
    assert_eq!((header, kind), ("object", 5));
    assert_eq!(topics["/surface"].len(), 2, "it comes again as it grows");
    assert!(topics["/surface"][1].0 > *time);
    assert_eq!(points.len(), 8, "four sides of two ends");
    assert_eq!(points[7], points[0], "it closes");
    assert_eq!(colours[0], colours[2], "as certain");
    assert_eq!(colours[6][..3], colour::UNKNOWN.0[..3]);
    let (_, points, whole) = cloud(&topics["/surface/points"][0].2);
    assert!(!whole && points.len() == 5_000);
    assert_eq!(float(&points[0], "deviation"), 1e-3);
    assert_eq!(float(&points[2_500], "deviation"), 2e-3);
    assert_eq!(marker(&topics["/truth/surface"][0].2).0, "object_truth");
}

/// Frame, type, points and colours of the only marker.
fn marker(data: &[u8]) -> (&str, i32, Vec<[f64; 3]>, Vec<[f32; 4]>) {
    let mut reader = Reader::new(data);
    assert_eq!(reader.u32(), 1);
    let (_, frame) = reader.header();
    reader.string();
    let (id, kind, action) = (reader.i32(), reader.i32(), reader.i32());
    assert_eq!((id, action), (0, 0));
    reader.pose();
    let scale: [f64; 3] = reader.f64s();
    assert!(scale[0] > 0.0);
    (0..4).for_each(|_| assert_eq!(reader.f32(), 1.0));
    assert_eq!((reader.i32(), reader.u32(), reader.u8()), (0, 0, 1));
    let points = (0..reader.u32()).map(|_| reader.f64s()).collect();
    let colours = (0..reader.u32()).map(|_| std::array::from_fn(|_| reader.f32())).collect();
    assert_eq!(reader.string(), "");
    reader.header();
    assert_eq!((reader.string(), reader.bytes()), ("", &[][..]));
    assert_eq!((reader.u32(), reader.string(), reader.string()), (0, "", ""));
    assert_eq!((reader.string(), reader.bytes(), reader.u8()), ("", &[][..], 0));
    reader.done();
    (frame, kind, points, colours)
}

#[test]
fn a_mesh_is_triangles() {
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let mesh = Mesh::new(corners.map(Point::from).to_vec(), triangles).unwrap();
    let mut bytes = Vec::new();
    let mut recording = Recording::new(&mut bytes, &Heading::default()).unwrap();
    recording.surface(&Geometry::Mesh(mesh), &[]).unwrap();
    recording.finish().unwrap();
    let topics = topics(&bytes);
    let (_, kind, points, colours) = marker(&topics["/surface"][0].2);
    assert_eq!((kind, points.len(), colours.len()), (11, 12, 12));
    assert_eq!(points[1], [0.0, 1.0, 0.0]);
}

#[test]
fn a_log_without_estimates_shows_its_contacts_and_its_truth() {
    let (mut log, _) = run();
    log.grasps[1].truth = None;
    log.grasps[1].contacts.clear();
    let none =
        Contents { title: "", log: &log, steps: &[], surfaces: &[], truth: None, report: None };
    let topics = topics(&file(&none));
    assert_eq!(topics["/contacts"].len(), 2);
    assert!(cloud(&topics["/contacts"][1].2).1.is_empty());
    assert_eq!(topics["/tf"].len(), 1);
    assert!(!topics.contains_key("/pose") && !topics.contains_key("/object/contacts"));
}

#[test]
fn absurd_times_stay_in_order() {
    let mut bytes = Vec::new();
    let mut recording = Recording::new(&mut bytes, &Heading::default()).unwrap();
    let times = [Some(2.0), None, Some(f64::NAN), Some(-1.0), Some(1e300)];
    for (i, time) in times.into_iter().enumerate() {
        let grasp = LoggedGrasp { index: i as u64, time, ..LoggedGrasp::default() };
        recording.grasp(&grasp, None).unwrap();
    }
    recording.finish().unwrap();
    let topics = topics(&bytes);
    let times: Vec<f64> = topics["/contacts"].iter().map(|m| m.0).collect();
    assert_eq!(times[..4], [2.0; 4]);
    assert!(times[4] > 1e10);
}

/// Contacts so far are sent so seldom that a long recording grows with its length, not its square.
#[test]
fn a_long_recording_is_not_held_or_repeated() {
    struct Counting(usize);
    impl Write for Counting {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 += bytes.len();
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut out = Counting(0);
    let mut recording = Recording::new(&mut out, &Heading::default()).unwrap();
    let step = step(planar(0.0, 0.0, 0.1));
    let grasps = 9_000;
    let mut sent = 0;
    for index in 0..grasps {
        let contacts = vec![contact(index as f64 * 1e-5, 0.0, Some(0)); 5];
        let grasp = LoggedGrasp { index, contacts, ..LoggedGrasp::default() };
        recording.grasp(&grasp, Some(&step)).unwrap();
        sent = sent.max(recording.topics["/object/contacts"].1);
    }
    // Of 45 000 contacts every fourth is kept, every grasp's among them.
    assert_eq!((recording.felt, recording.stride), (45_000, 4));
    assert_eq!(recording.placed.len(), 11_250);
    assert!((40..100).contains(&sent), "{sent}");
    assert_eq!(recording.topics["/status"].1, 1, "it never changed");
    assert_eq!(recording.topics["/modes"].1, grasps as u32, "several poses all the time");
    recording.finish().unwrap();
    assert!(out.0 < 16_000_000, "{}", out.0);
}

#[test]
fn a_full_disk_is_an_error() {
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.0 == 0 {
                return Err(io::Error::from(io::ErrorKind::StorageFull));
            }
            let taken = bytes.len().min(self.0);
            self.0 -= taken;
            Ok(taken)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let (log, steps) = run();
    // Chunks are flushed when they are full or at the end: every room below the whole is too little.
    let written = |room: usize| {
        let mut recording = Recording::new(Full(room), &Heading::default())?;
        for (grasp, step) in log.grasps.iter().zip(&steps) {
            recording.grasp(grasp, step.as_ref())?;
        }
        recording.finish()
    };
    let enough = (0..).map(|k| 256 << k).find(|room| written(*room).is_ok()).unwrap();
    for room in [0, 5, 100, 300, enough / 2] {
        assert_eq!(written(room).unwrap_err().kind(), io::ErrorKind::StorageFull, "{room}");
    }
}
