//! ROS 2 messages as bytes.

use nalgebra::Matrix6;

use super::cdr::Cdr;
use crate::space::{Point, Pose};
use crate::view::colour::Colour;

/// A message and the name of its type.
pub(super) struct Message {
    pub kind: &'static str,
    pub data: Vec<u8>,
}

impl Message {
    fn new(kind: &'static str, fill: impl FnOnce(&mut Cdr)) -> Self {
        let mut cdr = Cdr::new();
        fill(&mut cdr);
        Message { kind, data: cdr.into_bytes() }
    }
}

/// When, in nanoseconds since the start, and in which frame.
#[derive(Clone, Copy)]
pub(super) struct Stamp<'a> {
    pub time: u64,
    pub frame: &'a str,
}

/// The pose of `child` in `stamp.frame`, as `tf2_msgs/TFMessage`.
pub(super) fn transforms(stamp: Stamp<'_>, children: &[(&str, Pose)]) -> Message {
    Message::new("tf2_msgs/msg/TFMessage", |cdr| {
        cdr.sequence(children, |cdr, (child, pose)| {
            header(cdr, stamp);
            cdr.string(child);
            placement(cdr, pose);
        });
    })
}

/// `geometry_msgs/PoseStamped`.
pub(super) fn pose_stamped(stamp: Stamp<'_>, pose: &Pose) -> Message {
    Message::new("geometry_msgs/msg/PoseStamped", |cdr| {
        header(cdr, stamp);
        placement(cdr, pose);
    })
}

/// `geometry_msgs/PoseWithCovarianceStamped`. `covariance` is of translation, then rotation, both in
/// the object's axes; ROS wants them in the axes of the frame.
pub(super) fn pose_with_covariance(
    stamp: Stamp<'_>,
    pose: &Pose,
    covariance: &Matrix6<f64>,
) -> Message {
    let turn = pose.rotation.to_rotation_matrix();
    let mut turns = Matrix6::zeros();
    turns.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    turns.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
    let turned = turns * covariance * turns.transpose();
    Message::new("geometry_msgs/msg/PoseWithCovarianceStamped", |cdr| {
        header(cdr, stamp);
        placement(cdr, pose);
        cdr.f64s(turned.transpose().iter().copied());
    })
}

/// `geometry_msgs/PoseArray`.
pub(super) fn poses(stamp: Stamp<'_>, poses: &[Pose]) -> Message {
    Message::new("geometry_msgs/msg/PoseArray", |cdr| {
        header(cdr, stamp);
        cdr.sequence(poses, placement);
    })
}

/// `std_msgs/Float64`.
pub(super) fn number(value: f64) -> Message {
    Message::new("std_msgs/msg/Float64", |cdr| cdr.f64(value))
}

/// `std_msgs/String`.
pub(super) fn text(value: &str) -> Message {
    Message::new("std_msgs/msg/String", |cdr| cdr.string(value))
}

/// One field of a point, four bytes long.
#[derive(Clone, Copy)]
pub(super) enum Field {
    Float(&'static str),
    Signed(&'static str),
    Unsigned(&'static str),
}

/// Points, each with the same fields.
pub(super) struct Cloud {
    fields: &'static [Field],
    data: Vec<u8>,
    /// Whether every number of every point is one.
    whole: bool,
}

impl Cloud {
    pub fn new(fields: &'static [Field]) -> Self {
        Cloud { fields, data: Vec::new(), whole: true }
    }

    pub fn floats(&mut self, values: impl IntoIterator<Item = f64>) -> &mut Self {
        for value in values {
            self.whole &= value.is_finite();
            self.data.extend_from_slice(&(value as f32).to_le_bytes());
        }
        self
    }

    pub fn signed(&mut self, value: i32) -> &mut Self {
        self.data.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub fn unsigned(&mut self, value: u32) -> &mut Self {
        self.data.extend_from_slice(&value.to_le_bytes());
        self
    }

    /// The fields `rgba`, as RViz and Foxglove read it, and `colors`, which Rerun takes for its own.
    pub fn colour(&mut self, colour: Colour) -> &mut Self {
        let [r, g, b, a] = colour.0.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u32);
        self.unsigned(a << 24 | r << 16 | g << 8 | b).unsigned(r << 24 | g << 16 | b << 8 | a)
    }

    /// How many whole points there are.
    pub fn len(&self) -> usize {
        self.data.len() / self.step()
    }

    fn step(&self) -> usize {
        4 * self.fields.len().max(1)
    }

    /// Adds those points of a cloud of the same fields that are `wanted`, by their positions in it.
    pub fn append(&mut self, other: &Cloud, wanted: impl Fn(usize) -> bool) {
        for (i, point) in other.data.chunks_exact(self.step()).enumerate() {
            if wanted(i) {
                self.data.extend_from_slice(point);
            }
        }
        self.whole &= other.whole;
    }

    /// `sensor_msgs/PointCloud2`.
    pub fn message(&self, stamp: Stamp<'_>) -> Message {
        Message::new("sensor_msgs/msg/PointCloud2", |cdr| {
            header(cdr, stamp);
            cdr.u32(1);
            cdr.u32(self.len() as u32);
            let mut offset = 0;
            cdr.sequence(self.fields, |cdr, field| {
                let (name, datatype) = match field {
                    Field::Signed(name) => (name, 5),
                    Field::Unsigned(name) => (name, 6),
                    Field::Float(name) => (name, 7),
                };
                cdr.string(name);
                cdr.u32(offset);
                cdr.u8(datatype);
                cdr.u32(1);
                offset += 4;
            });
            cdr.bool(false);
            cdr.u32(self.step() as u32);
            cdr.u32(self.data.len() as u32);
            cdr.bytes(&self.data);
            cdr.bool(self.whole);
        })
    }
}

/// What a marker's points make.
#[derive(Clone, Copy)]
pub(super) enum Primitive {
    /// Two points a line, so wide (metres).
    Lines(f64),
    /// Three points a triangle, counter-clockwise seen from outside.
    Triangles,
}

/// One `visualization_msgs/Marker` in a `MarkerArray`: number 0 of `name`, replacing the one before.
pub(super) fn marker(
    stamp: Stamp<'_>,
    name: &str,
    primitive: Primitive,
    vertices: &[(Point, Colour)],
) -> Message {
    let (kind, scale) = match primitive {
        Primitive::Lines(width) => (5, [width, 0.0, 0.0]),
        Primitive::Triangles => (11, [1.0; 3]),
    };
    Message::new("visualization_msgs/msg/MarkerArray", |cdr| {
        cdr.u32(1);
        header(cdr, stamp);
        cdr.string(name);
        cdr.i32(0);
        cdr.i32(kind);
        cdr.i32(0);
        placement(cdr, &Pose::identity());
        cdr.f64s(scale);
        colour(cdr, &Colour([1.0; 4]));
        // Stays until replaced, and moves with its frame.
        cdr.i32(0);
        cdr.u32(0);
        cdr.bool(true);
        cdr.sequence(vertices, |cdr, (p, _)| cdr.f64s([p.x, p.y, p.z]));
        cdr.sequence(vertices, |cdr, (_, c)| colour(cdr, c));
        // No texture, text or mesh file.
        cdr.string("");
        header(cdr, Stamp { time: 0, frame: "" });
        cdr.string("");
        cdr.bytes(&[]);
        cdr.u32(0);
        cdr.string("");
        cdr.string("");
        cdr.string("");
        cdr.bytes(&[]);
        cdr.bool(false);
    })
}

fn header(cdr: &mut Cdr, stamp: Stamp<'_>) {
    cdr.i32(i32::try_from(stamp.time / 1_000_000_000).unwrap_or(i32::MAX));
    cdr.u32((stamp.time % 1_000_000_000) as u32);
    cdr.string(stamp.frame);
}

/// A `Pose` or a `Transform`: both are position, then quaternion.
fn placement(cdr: &mut Cdr, pose: &Pose) {
    cdr.f64s(pose.translation.vector.iter().copied());
    cdr.f64s(pose.rotation.coords.iter().copied());
}

fn colour(cdr: &mut Cdr, colour: &Colour) {
    colour.0.iter().for_each(|c| cdr.f32(*c));
}
