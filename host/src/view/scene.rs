//! A run or a recording as a scene that plays: what a viewer is told, in the order it happened.
//!
//! A scene is a list of [`Message`]s, JSON objects told apart by their `type`: one `meta`, then a
//! `grasp` for every grasp, after some of them the `surface` as it was known then and the `choice` of
//! the next one among candidates, and an `end`. A page
//! holds them all, one a line ([`super::html`]); a live view sends them one by one as they come about,
//! and again from the start to a viewer that connects later. A `meta` clears what was shown before.
//!
//! Lengths are metres and angles radians unless a name says otherwise; points of contacts and poses are
//! in the world frame, surfaces in the estimated object frame, the true shape in its own. Long lists of
//! numbers travel as base64 of their little-endian bytes ([`Packed`]).

use nalgebra::Matrix6;
use serde::{Serialize, Serializer};

use crate::log::LoggedGrasp;
use crate::shape::Geometry;
use crate::slam::track::Step;
use crate::space::{Point, Pose};

/// The value of the `format` field of [`Meta`].
pub const FORMAT: &str = "tactile-scene";

/// The only version of the format there is.
pub const VERSION: u32 = 1;

/// The number of a finger that has none.
const NO_FINGER: u8 = u8::MAX;

/// Numbers that travel as base64 of their little-endian bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed<T>(pub Vec<T>);

/// A number of four bytes or one.
pub trait Bytes: Copy {
    /// Appends its bytes, the least significant first.
    fn append(self, bytes: &mut Vec<u8>);
}

impl Bytes for f32 {
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl Bytes for u32 {
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl Bytes for u8 {
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.push(self);
    }
}

impl<T: Bytes> Serialize for Packed<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = Vec::with_capacity(self.0.len() * size_of::<T>());
        self.0.iter().for_each(|number| number.append(&mut bytes));
        serializer.serialize_str(&base64(&bytes))
    }
}

/// RFC 4648, with padding.
pub(super) fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i > three.len() { '=' } else { char::from(letter) });
        }
    }
    text
}

/// What a viewer is told.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Message<'a> {
    /// A scene begins: what it is of.
    Meta(&'a Meta),
    /// The hand closed once more.
    Grasp(&'a Grasp),
    /// The surface as it is known after a grasp.
    Surface(&'a Surface),
    /// What an exploration knew after a grasp, and among what it chose the next one.
    Choice(&'a Choice),
    /// Nothing more will come.
    End,
}

impl Message<'_> {
    /// One line of JSON.
    ///
    /// # Errors
    /// None that these types can cause; passed on from the serialiser.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }
}

/// What a scene is of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Meta {
    /// [`FORMAT`].
    pub format: &'static str,
    /// [`VERSION`].
    pub version: u32,
    /// 2 or 3.
    pub dimension: usize,
    /// The headline.
    pub title: String,
    /// Who estimated the poses; `None` where nobody did.
    pub tracker: Option<String>,
    /// What the last surface was made with.
    pub model: Option<String>,
    /// Names of the fingers; [`Grasp::fingers`] are indices into it.
    pub fingers: Vec<String>,
    /// Grasps that will come, where that is known.
    pub grasps: Option<u64>,
    /// The true shape, true object frame.
    pub truth: Option<Shape>,
    /// Key figures as name and value with unit.
    pub figures: Vec<(String, String)>,
    /// What the source lacks or has damaged, one sentence each.
    pub missing: Vec<String>,
}

impl Meta {
    /// Of something of which only title and dimension are known.
    pub fn new(dimension: usize, title: impl Into<String>) -> Self {
        Meta {
            format: FORMAT,
            version: VERSION,
            dimension,
            title: title.into(),
            tracker: None,
            model: None,
            fingers: Vec::new(),
            grasps: None,
            truth: None,
            figures: Vec::new(),
            missing: Vec::new(),
        }
    }
}

/// A pose as position and quaternion: x, y, z, qx, qy, qz, qw.
pub type Seven = [f64; 7];

/// The numbers of a pose.
pub fn seven(pose: &Pose) -> Seven {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// One grasp, or several that follow one another closely ([`super::timeline`]).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Grasp {
    /// Its number in the log; of several, the last one's.
    pub grasp: u64,
    /// How many grasps this stands for.
    pub merged: u64,
    /// Seconds since the start.
    pub time: Option<f64>,
    /// Estimated object frame to world.
    pub pose: Option<Seven>,
    /// True object frame to world.
    pub truth: Option<Seven>,
    /// How much the estimate is worth, see [`tactile_core::track::Status::name`].
    pub status: Option<&'static str>,
    /// The poses held possible, heaviest first, each followed by its share of the belief.
    pub modes: Vec<[f64; 8]>,
    /// Standard deviations of the pose, object axes: three of the position, three of the rotation;
    /// zero where the plane has none.
    pub deviations: Option<[f64; 6]>,
    /// Differential entropy of the pose's normal distribution in nats (of metres and radians).
    pub entropy: Option<f64>,
    /// Effective number of particles or hypotheses.
    pub particles: Option<f64>,
    /// Contacts felt; more than are shown where grasps were merged.
    pub touched: u64,
    /// Six numbers each: position in the world, and unit normal out of the object, zeros where it was
    /// not measured.
    pub contacts: Packed<f32>,
    /// One number for each contact, 255 where the log does not say.
    pub fingers: Packed<u8>,
    /// Three numbers each: where a fingertip touched nothing, world frame.
    pub free: Packed<f32>,
}

impl Grasp {
    /// What was felt, without an estimate.
    pub fn felt(logged: &LoggedGrasp) -> Self {
        let mut contacts = Vec::with_capacity(6 * logged.contacts.len());
        for contact in &logged.contacts {
            let normal = contact.normal.unwrap_or_default();
            contacts.extend(contact.point.iter().chain(normal.iter()).map(|&v| v as f32));
        }
        let finger = |finger: Option<usize>| finger.map_or(NO_FINGER, |f| f.min(254) as u8);
        Grasp {
            grasp: logged.index,
            merged: 1,
            time: logged.time,
            truth: logged.truth.as_ref().map(seven),
            touched: logged.contacts.len() as u64,
            contacts: Packed(contacts),
            fingers: Packed(logged.contacts.iter().map(|c| finger(c.finger)).collect()),
            free: Packed(
                logged.free.iter().flat_map(|f| f.point.map(|v| v as f32).data.0[0]).collect(),
            ),
            ..Grasp::default()
        }
    }

    /// What was felt, and what was made of it, in `dimension` dimensions.
    pub fn estimated(logged: &LoggedGrasp, step: &Step, dimension: usize) -> Self {
        let known = step.covariance.iter().any(|v| *v != 0.0);
        Grasp {
            pose: Some(seven(&step.pose)),
            status: Some(step.status.name()),
            modes: step.modes.iter().map(|(pose, weight)| mode(pose, *weight)).collect(),
            deviations: known
                .then(|| std::array::from_fn(|i| step.covariance[(i, i)].max(0.0).sqrt())),
            entropy: entropy(&step.covariance, dimension),
            particles: (step.effective_particles > 0.0).then_some(step.effective_particles),
            ..Grasp::felt(logged)
        }
    }
}

/// A pose and its share of the belief.
pub fn mode(pose: &Pose, weight: f64) -> [f64; 8] {
    let [x, y, z, qx, qy, qz, qw] = seven(pose);
    [x, y, z, qx, qy, qz, qw, weight]
}

/// Differential entropy of a normal distribution over the directions a pose of this dimension has,
/// ½ ln((2πe)ⁿ det Σ) in nats. `None` where one of them has no variance.
pub fn entropy(covariance: &Matrix6<f64>, dimension: usize) -> Option<f64> {
    let axes: &[usize] = if dimension == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let n = axes.len();
    let own = nalgebra::DMatrix::from_fn(n, n, |i, j| covariance[(axes[i], axes[j])]);
    let factor = own.cholesky()?;
    let half_log_det: f64 = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
    let each = (std::f64::consts::TAU * std::f64::consts::E).ln();
    Some(0.5 * n as f64 * each + half_log_det).filter(|h| h.is_finite())
}

/// Closed polygons or triangles.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Shape {
    /// Three numbers each; z is 0 in the plane.
    pub vertices: Packed<f32>,
    /// In the plane: the number of vertices of each loop.
    pub loops: Packed<u32>,
    /// In space: three indices each, counter-clockwise from outside.
    pub triangles: Packed<u32>,
}

impl Shape {
    /// The same shape in numbers.
    pub fn new(geometry: &Geometry) -> Self {
        let packed = |p: &Point| p.map(|v| v as f32).data.0[0];
        match geometry {
            Geometry::Outline(outline) => {
                let flat = outline.loops.iter().flatten();
                Shape {
                    vertices: Packed(flat.flat_map(|v| [v[0] as f32, v[1] as f32, 0.0]).collect()),
                    loops: Packed(outline.loops.iter().map(|l| l.len() as u32).collect()),
                    triangles: Packed::default(),
                }
            }
            Geometry::Mesh(mesh) => Shape {
                vertices: Packed(mesh.vertices().iter().flat_map(packed).collect()),
                loops: Packed::default(),
                triangles: Packed(mesh.triangles().as_flattened().to_vec()),
            },
        }
    }
}

/// The surface as it is known after a grasp.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Surface {
    /// The number of the last grasp it is made of.
    pub after: u64,
    /// Outline or mesh, estimated object frame.
    #[serde(flatten)]
    pub shape: Shape,
    /// Standard deviation along the normal at each vertex; not a number where unknown.
    pub deviations: Packed<f32>,
    /// Hausdorff distance to the true shape in the true object frame.
    pub hausdorff_mm: Option<f64>,
    /// Mean distance to it.
    pub mean_mm: Option<f64>,
}

impl Surface {
    /// A shape in the estimated object frame, and the standard deviation at each of its vertices
    /// (metres), not yet judged.
    pub fn new(geometry: &Geometry, deviations: &[f64], after: u64) -> Self {
        Surface {
            after,
            shape: Shape::new(geometry),
            deviations: Packed(deviations.iter().map(|&d| d as f32).collect()),
            ..Surface::default()
        }
    }
}

/// What an exploration knew after a grasp, and among what it chose the next one.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Choice {
    /// The number of the grasp it comes after.
    pub after: u64,
    /// Share of the surface that counts as known.
    pub known: f64,
    /// Seven numbers for each candidate, estimated object frame: the middle of the hand, the unit
    /// direction in which its four fingers close, and what it promises, not a number where nobody asked.
    pub candidates: Packed<f32>,
    /// Which of them; `None` where the exploration ended.
    pub chosen: Option<usize>,
}

impl Choice {
    /// Appends a candidate: its hand in the estimated object frame, whose fingers close against its y
    /// axis, and what it promises.
    pub fn offer(&mut self, hand: &Pose, gain: Option<f64>) {
        let middle = hand.translation.vector;
        let closing = hand.rotation * -Point::y();
        let numbers = middle.iter().chain(closing.iter()).map(|v| *v as f32);
        self.candidates.0.extend(numbers.chain([gain.map_or(f32::NAN, |g| g as f32)]));
    }
}

/// A whole scene, for a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// What it is of.
    pub meta: Meta,
    /// In the order of their numbers.
    pub grasps: Vec<Grasp>,
    /// In the order of the grasps they come after.
    pub surfaces: Vec<Surface>,
    /// The same of an exploration's choices.
    pub choices: Vec<Choice>,
}

impl Scene {
    /// Everything a viewer is told, in order: each surface directly after its grasp, then the choice.
    pub fn messages(&self) -> Vec<Message<'_>> {
        let mut messages = vec![Message::Meta(&self.meta)];
        let mut surfaces = self.surfaces.iter().peekable();
        let mut choices = self.choices.iter().peekable();
        for grasp in &self.grasps {
            messages.push(Message::Grasp(grasp));
            while let Some(surface) = surfaces.next_if(|s| s.after <= grasp.grasp) {
                messages.push(Message::Surface(surface));
            }
            while let Some(choice) = choices.next_if(|c| c.after <= grasp.grasp) {
                messages.push(Message::Choice(choice));
            }
        }
        messages.extend(surfaces.map(Message::Surface));
        messages.extend(choices.map(Message::Choice));
        messages.push(Message::End);
        messages
    }
}
