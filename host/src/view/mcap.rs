//! Runs as MCAP files with ROS 2 messages, for Foxglove, Rerun, RViz and whatever else reads them.
//!
//! Profile `ros2`, messages in CDR, schemas in `ros2msg`, chunks of a megabyte compressed by LZ4,
//! indexed. Metres, radians and unit quaternions as ROS has them; lengths in millimetres and angles
//! in degrees where a topic's name says so. Times are seconds since the start of the recording.
//! Messages are in the order of their times but for the surfaces of a recording of a link, which are known when
//! it was read to its end, and stand there with the times at which they were so.
//! Points carry their colour twice: `rgba` as RViz and Foxglove read it, `colors` as Rerun does.
//!
//! | topic | type | frame | what |
//! |---|---|---|---|
//! | `/tf` | `tf2_msgs/TFMessage` | `world` | frames `object` (estimate) and `object_truth` |
//! | `/contacts`, `/free` | `sensor_msgs/PointCloud2` | `world` | of each grasp: contacts with `normal_*`, `grasp`, `finger` (its number, −1 unknown), `force`; fingertips that touched nothing |
//! | `/object/contacts` | `sensor_msgs/PointCloud2` | `object` | the contacts so far, of many every n-th; sent again when a tenth more came |
//! | `/pose`, `/pose_with_covariance` | `geometry_msgs/PoseStamped`, `PoseWithCovarianceStamped` | `world` | the estimate |
//! | `/modes` | `geometry_msgs/PoseArray` | `world` | the poses held possible, heaviest first, where there is more than one; empty when there no longer is |
//! | `/status` | `std_msgs/String` | | what the estimate is worth, when it changes |
//! | `/truth/pose` | `geometry_msgs/PoseStamped` | `world` | where `/pose` should be |
//! | `/surface`, `/truth/surface` | `visualization_msgs/MarkerArray` | `object`, `object_truth` | mesh or outline, the estimate coloured by its standard deviation |
//! | `/surface/points` | `sensor_msgs/PointCloud2` | `object` | points of it with `deviation`, for viewers without markers |
//! | `/deviation/*`, `/error/*`, `/report/*` | `std_msgs/Float64` | | standard deviation of the pose (greatest of its axes), its error, figures of the report |

mod cdr;
mod cover;
mod messages;
mod schema;

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use self::messages::{Cloud, Field, Message, Primitive, Stamp};
use super::colour::{self, Colour, TRUTH};
use super::growth::Grown;
use super::report::Report;
use super::summary::scale_end;
use crate::log::write::write_atomically;
use crate::log::{GraspLog, LoggedGrasp};
use crate::shape::Geometry;
use crate::slam::track::Step;
use crate::space::{Point, Pose};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use tactile_core::track::Status;

/// Frames of the recording.
const WORLD: &str = "world";
const OBJECT: &str = "object";
const TRUE_OBJECT: &str = "object_truth";

/// Contacts that `/object/contacts` shows at most: more are not told apart, and each message has them all.
const PLACED: usize = 20_000;

/// Width of an outline, metres.
const LINE: f64 = 1e-3;

/// A point of `/contacts`, `/free` and `/object/contacts`.
const FELT: [Field; 11] = [
    Field::Float("x"),
    Field::Float("y"),
    Field::Float("z"),
    Field::Float("normal_x"),
    Field::Float("normal_y"),
    Field::Float("normal_z"),
    Field::Unsigned("rgba"),
    Field::Unsigned("colors"),
    Field::Unsigned("grasp"),
    Field::Signed("finger"),
    Field::Float("force"),
];

/// A point of `/surface/points`.
const COVER: [Field; 6] = [
    Field::Float("x"),
    Field::Float("y"),
    Field::Float("z"),
    Field::Unsigned("rgba"),
    Field::Unsigned("colors"),
    Field::Float("deviation"),
];

/// What is known of a recording before its first grasp.
#[derive(Clone, Debug, Default)]
pub struct Heading<'a> {
    /// What it is, in words.
    pub title: &'a str,
    /// Names of the fingers, in the order of their numbers.
    pub fingers: &'a [String],
    /// How many grasps will come, as far as that is known: contacts are coloured along them.
    pub grasps: usize,
}

/// A whole run, or a recording of one.
#[derive(Clone, Copy)]
pub struct Contents<'a> {
    /// What it is, in words.
    pub title: &'a str,
    /// What was felt.
    pub log: &'a GraspLog,
    /// What was made of each grasp, as far as anything was.
    pub steps: &'a [Option<Step>],
    /// The shape as it grew, in the order of the grasps.
    pub surfaces: &'a [Grown],
    /// The true shape.
    pub truth: Option<&'a Geometry>,
    /// Figures.
    pub report: Option<&'a Report>,
}

/// Writes a run to `path`, fully or not at all. Each surface comes with the last grasp it was made of,
/// and stays until the next.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, contents: &Contents<'_>) -> io::Result<()> {
    write_atomically(path, |out| {
        let Contents { title, log, steps, surfaces, truth, report } = *contents;
        let heading = Heading { title, fingers: &log.fingers, grasps: log.grasps.len() };
        let mut recording = Recording::new(out, &heading)?;
        for (number, grasp) in log.grasps.iter().enumerate() {
            recording.grasp(grasp, steps.get(number).and_then(Option::as_ref))?;
            if let Some(truth) = truth.filter(|_| number == 0) {
                recording.true_surface(truth)?;
            }
            for grown in surfaces.iter().filter(|s| s.grasp == number) {
                recording.surface(&grown.geometry, &grown.deviations)?;
            }
        }
        report.map_or(Ok(()), |report| recording.report(report))?;
        recording.finish()
    })
}

/// An MCAP file while it is written. What was given is on its way to the file at once: no more than
/// a chunk and the contacts of the object are held.
///
/// ```
/// use tactile_host::log::LoggedGrasp;
/// use tactile_host::view::mcap::{Heading, Recording};
///
/// let mut file = Vec::new();
/// let mut recording = Recording::new(&mut file, &Heading::default())?;
/// recording.grasp(&LoggedGrasp { time: Some(0.5), ..LoggedGrasp::default() }, None)?;
/// recording.finish()?;
/// assert!(file.starts_with(b"\x89MCAP0\r\n") && file.ends_with(b"\x89MCAP0\r\n"));
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct Recording<W: Write> {
    writer: Writer<NoSeek<W>>,
    /// Channel and number of the next message of each topic.
    topics: BTreeMap<String, (u16, u32)>,
    /// The status that was sent last, and whether there were several poses.
    status: Option<Status>,
    several: bool,
    /// How many grasps are expected, and how many came.
    expected: usize,
    grasps: usize,
    /// Nanoseconds of the last grasp.
    now: u64,
    /// Contacts in the object's frame, one of every so many; all so far, and when they were sent.
    placed: Cloud,
    stride: usize,
    felt: usize,
    sent: usize,
    /// True object frame to estimated one ([`super::report::gauge`]).
    gauge: Option<Pose>,
}

impl<W: Write> Recording<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// When `out` does.
    pub fn new(out: W, heading: &Heading<'_>) -> io::Result<Self> {
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .profile("ros2")
            .library(concat!("tactile ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true)
            .create(NoSeek::new(out))
            .map_err(io_error)?;
        let about = [("title", heading.title.to_owned()), ("fingers", heading.fingers.join(","))];
        let metadata = about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        writer.write_metadata(&Metadata { name: "tactile".into(), metadata }).map_err(io_error)?;
        Ok(Recording {
            writer,
            topics: BTreeMap::new(),
            status: None,
            several: false,
            expected: heading.grasps,
            grasps: 0,
            now: 0,
            placed: Cloud::new(&FELT),
            stride: 1,
            felt: 0,
            sent: 0,
            gauge: None,
        })
    }

    /// How many grasps will come in all, as it looks now.
    pub fn expect(&mut self, grasps: usize) {
        self.expected = grasps;
    }

    /// What follows is of another object: contacts and frame of the one before count no longer.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn begin_anew(&mut self) -> io::Result<()> {
        let felt = std::mem::take(&mut self.felt);
        (self.sent, self.stride, self.status, self.gauge) = (0, 1, None, None);
        self.placed = Cloud::new(&FELT);
        if felt > 0 { self.contacts_so_far() } else { Ok(()) }
    }

    /// One grasp: what was felt, in the world frame, and what was made of it. A grasp without a time
    /// happens at the second of its number; time never runs backwards.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn grasp(&mut self, grasp: &LoggedGrasp, estimate: Option<&Step>) -> io::Result<()> {
        self.now = self.now.max(nanoseconds(grasp.time.unwrap_or(grasp.index as f64)));
        let world = Stamp { time: self.now, frame: WORLD };
        let tint = colour::grasp(self.grasps, self.expected);
        self.grasps += 1;

        let felt = felt(grasp, &Pose::identity(), tint);
        self.send("/contacts", felt.message(world))?;
        if !grasp.free.is_empty() {
            let mut free = Cloud::new(&FELT);
            for f in &grasp.free {
                free.floats(f.point.iter().copied()).floats([f64::NAN; 3]);
                free.colour(colour::UNKNOWN).unsigned(number(grasp.index));
                free.signed(finger(f.finger)).floats([f64::NAN]);
            }
            self.send("/free", free.message(world))?;
        }

        let mut frames = Vec::new();
        if let Some(estimate) = estimate {
            frames.push((OBJECT, estimate.pose));
        }
        if let Some(truth) = grasp.truth {
            frames.push((TRUE_OBJECT, truth));
        }
        if !frames.is_empty() {
            self.send("/tf", messages::transforms(world, &frames))?;
        }
        if let Some(estimate) = estimate {
            self.estimate(grasp, estimate)?;
            self.place(&self::felt(grasp, &estimate.pose.inverse(), tint));
            if self.felt > self.sent + self.sent / 10 {
                self.contacts_so_far()?;
            }
        }
        Ok(())
    }

    fn estimate(&mut self, grasp: &LoggedGrasp, step: &Step) -> io::Result<()> {
        let Step { pose, covariance, status, modes, .. } = step;
        let world = Stamp { time: self.now, frame: WORLD };
        self.send("/pose", messages::pose_stamped(world, pose))?;
        let message = messages::pose_with_covariance(world, pose, covariance);
        self.send("/pose_with_covariance", message)?;
        // An empty one takes away those of the grasp before.
        let several = if modes.len() > 1 { &modes[..] } else { &[] };
        if self.several || !several.is_empty() {
            let poses: Vec<Pose> = several.iter().map(|m| m.0).collect();
            self.send("/modes", messages::poses(world, &poses))?;
            self.several = !several.is_empty();
        }
        if self.status != Some(*status) {
            self.send("/status", messages::text(status.name()))?;
            self.status = Some(*status);
        }
        let greatest = |from: usize| {
            let variances = (from..from + 3).map(|i| covariance[(i, i)]);
            variances.fold(0.0, f64::max).sqrt()
        };
        self.send("/deviation/translation_mm", messages::number(greatest(0) * 1e3))?;
        self.send("/deviation/rotation_deg", messages::number(greatest(3).to_degrees()))?;
        let Some(truth) = grasp.truth else { return Ok(()) };
        // Before anything was felt nobody knows where the object is.
        if self.gauge.is_none() && grasp.contacts.is_empty() {
            return Ok(());
        }
        let gauge = *self.gauge.get_or_insert(pose.inverse() * truth);
        let target = truth * gauge.inverse();
        self.send("/truth/pose", messages::pose_stamped(world, &target))?;
        let error = truth.inverse() * pose * gauge;
        let (distance, angle) = (error.translation.vector.norm(), error.rotation.angle());
        self.send("/error/translation_mm", messages::number(distance * 1e3))?;
        self.send("/error/rotation_deg", messages::number(angle.to_degrees()))
    }

    /// Keeps every `stride`-th contact, and every second of those when there are too many.
    fn place(&mut self, contacts: &Cloud) {
        let (felt, stride) = (self.felt, self.stride);
        self.placed.append(contacts, |i| (felt + i).is_multiple_of(stride));
        self.felt += contacts.len();
        while self.placed.len() > PLACED {
            let all = std::mem::replace(&mut self.placed, Cloud::new(&FELT));
            self.placed.append(&all, |i| i.is_multiple_of(2));
            self.stride *= 2;
        }
    }

    /// All contacts at the poses found for them by now.
    fn contacts_so_far(&mut self) -> io::Result<()> {
        let message = self.placed.message(Stamp { time: self.now, frame: OBJECT });
        self.sent = self.felt;
        self.send("/object/contacts", message)
    }

    /// The estimated shape in the object's frame, from now on. `deviations` holds one standard
    /// deviation per vertex in metres, loop after loop for an outline; missing or not a number is
    /// unknown.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn surface(&mut self, geometry: &Geometry, deviations: &[f64]) -> io::Result<()> {
        let stamp = Stamp { time: self.now, frame: OBJECT };
        let end = scale_end(deviations);
        let deviation = |vertex: usize| deviations.get(vertex).copied().unwrap_or(f64::NAN);
        let tint = |vertex: usize| colour::uncertainty(deviation(vertex) / end);
        self.send("/surface", drawn(stamp, "surface", geometry, tint))?;
        let mut cloud = Cloud::new(&COVER);
        for (point, deviation) in cover::cover(geometry, deviation) {
            cloud.floats(point.iter().copied()).colour(colour::uncertainty(deviation / end));
            cloud.floats([deviation]);
        }
        self.send("/surface/points", cloud.message(stamp))
    }

    /// The estimated shape as it was known at a time that is over, in seconds as grasps have it: which
    /// it was is often known in the end only. Readers go by the times of messages, not by their places
    /// in the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn earlier_surface(
        &mut self,
        seconds: f64,
        geometry: &Geometry,
        deviations: &[f64],
    ) -> io::Result<()> {
        let now = self.now;
        self.now = nanoseconds(seconds).min(now);
        let written = self.surface(geometry, deviations);
        self.now = now;
        written
    }

    /// The true shape in its own frame.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn true_surface(&mut self, geometry: &Geometry) -> io::Result<()> {
        let stamp = Stamp { time: self.now, frame: TRUE_OBJECT };
        let opacity = if geometry.dimension() == 2 { 1.0 } else { 0.25 };
        let tint = |_| TRUTH.faded(opacity);
        self.send("/truth/surface", drawn(stamp, "truth", geometry, tint))
    }

    /// The figures of a run, at the time of the last grasp.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn report(&mut self, report: &Report) -> io::Result<()> {
        let Report { surface, pose, contact_rms_mm, .. } = report;
        for (name, value) in [
            ("hausdorff_mm", surface.hausdorff_mm),
            ("hausdorff_aligned_mm", surface.hausdorff_aligned_mm),
            ("mean_mm", surface.mean_mm),
            ("rms_mm", surface.rms_mm),
            ("contact_rms_mm", *contact_rms_mm),
            ("rms_translation_mm", pose.rms_translation_mm),
            ("rms_rotation_deg", pose.rms_rotation_deg),
        ] {
            if let Some(value) = value {
                self.send(&format!("/report/{name}"), messages::number(value))?;
            }
        }
        Ok(())
    }

    /// Ends the file: without this it has no index.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        if self.felt > self.sent {
            self.contacts_so_far()?;
        }
        self.writer.finish().map_err(io_error)?;
        self.writer.into_inner().into_inner().flush()
    }

    fn send(&mut self, topic: &str, message: Message) -> io::Result<()> {
        let (channel_id, sequence) = match self.topics.get_mut(topic) {
            Some((channel, next)) => {
                let sequence = *next;
                *next = next.wrapping_add(1);
                (*channel, sequence)
            }
            None => {
                let definition = schema::definition(message.kind);
                let schema = self
                    .writer
                    .add_schema(message.kind, "ros2msg", definition.as_bytes())
                    .map_err(io_error)?;
                let channel = self
                    .writer
                    .add_channel(schema, topic, "cdr", &BTreeMap::new())
                    .map_err(io_error)?;
                self.topics.insert(topic.to_owned(), (channel, 1));
                (channel, 0)
            }
        };
        let header =
            MessageHeader { channel_id, sequence, log_time: self.now, publish_time: self.now };
        self.writer.write_to_known_channel(&header, &message.data).map_err(io_error)
    }
}

/// The contacts of a grasp, moved by `pose`.
fn felt(grasp: &LoggedGrasp, pose: &Pose, tint: Colour) -> Cloud {
    let mut cloud = Cloud::new(&FELT);
    for contact in &grasp.contacts {
        let point = pose * nalgebra::Point3::from(contact.point);
        let normal = contact.normal.map_or(Point::repeat(f64::NAN), |n| pose * n);
        cloud.floats(point.iter().copied()).floats(normal.iter().copied());
        cloud.colour(tint).unsigned(number(grasp.index)).signed(finger(contact.finger));
        cloud.floats([contact.force.unwrap_or(f64::NAN)]);
    }
    cloud
}

/// A shape as a marker, `tint` telling the colour of each vertex.
fn drawn(
    stamp: Stamp<'_>,
    name: &str,
    geometry: &Geometry,
    tint: impl Fn(usize) -> Colour,
) -> Message {
    match geometry {
        Geometry::Outline(outline) => {
            let mut ends = Vec::new();
            let mut first = 0;
            for vertices in &outline.loops {
                let count = vertices.len();
                let corner = |i: usize| {
                    let [x, y] = vertices[i % count];
                    (Point::new(x, y, 0.0), tint(first + i % count))
                };
                ends.extend((0..count).flat_map(|i| [corner(i), corner(i + 1)]));
                first += count;
            }
            messages::marker(stamp, name, Primitive::Lines(LINE), &ends)
        }
        Geometry::Mesh(mesh) => {
            let corner = |v: &u32| (mesh.vertices()[*v as usize], tint(*v as usize));
            let corners: Vec<_> = mesh.triangles().iter().flatten().map(corner).collect();
            messages::marker(stamp, name, Primitive::Triangles, &corners)
        }
    }
}

/// A grasp's number as a field of a point.
fn number(index: u64) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

/// A finger's number as a field of a point.
fn finger(index: Option<usize>) -> i32 {
    index.and_then(|f| i32::try_from(f).ok()).unwrap_or(-1)
}

/// What is not a time since the start is the start.
fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests;
