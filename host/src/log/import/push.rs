//! A robot pushes a block on a table (PushExp of MLab_EXP): motion capture of the block before and
//! after each push, the force on the probe, and the path of its tip.
//!
//! The end of each push is one contact: the last position of the tip, which touches the block
//! while motion capture sees it, and the force there. Everything is taken in the plane of the
//! table: the world is the robot's base frame without z, the pose of the block is the yaw and the
//! position of its corner.

use std::path::Path;

use nalgebra::{Isometry3, Quaternion, Rotation2, Translation3, UnitQuaternion, Vector2};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::super::{
    GraspLog, LogError, LoggedContact, LoggedGrasp, MAX_COORDINATE, MAX_FINGERS, Noise, TrueShape,
};
use super::normals::{Bare, LineFit};
use super::text;
use super::tokens::Tokens;
use crate::quantity::Deviation;
use crate::space::{self, Point, Pose};

/// Standard deviation of a contact across the surface, metres: the root mean square distance of
/// the 330 recorded contacts to the block's true edges (mean absolute distance 0.6 mm). It holds
/// the errors of robot, motion capture and of taking a block tilted by up to 1.7° as planar.
pub const POINT_NOISE: f64 = 0.75e-3;

/// Standard deviation of the force direction as a normal, radians: the root mean square angle
/// (22.3°) between the two over the 330 pushes. The distribution is not Gaussian but two-sided, a
/// peak at either edge of the friction cone (median 22°, 90 % below 29°, largest 43°): a Gaussian
/// of this deviation has the right second moment, and its two deviations cover them all.
pub const FORCE_NOISE: f64 = 0.39;

/// Below this force, in newtons, its direction is noise: the sensor's own is 0.01 N, offsets drift
/// by a few times that, and the weakest push has 0.7 N.
const LEAST_FORCE: f64 = 0.2;

/// Half of the time over which the force at the end of a push is averaged, seconds.
const FORCE_WINDOW: f64 = 0.05;

/// Force readings before the probe moves that say what the sensor shows without a load.
const UNLOADED: usize = 10;

/// The block, metres in the frame of motion capture: a right triangle, origin at the right angle.
const TRIANGLE: [[f64; 2]; 3] = [[0.0, 0.0], [0.15, 0.0], [0.0, 0.15]];

/// Reorientation from one grasp to the next when the object is made to move, radians (22.5°, as in
/// the thesis' simulations).
const REORIENTATION: f64 = std::f64::consts::PI / 8.0;

/// One recorded push, as recorded but in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Push {
    /// The block before.
    pub before: Pose,
    /// The block after.
    pub after: Pose,
    /// Unix time in seconds, and the force in newtons in the tool's frame.
    pub forces: Vec<(f64, [f64; 2])>,
    /// Unix time in seconds, and the tool's pose in the base frame.
    pub tips: Vec<(f64, Pose)>,
}

/// Where normals come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Normals {
    /// From neighbouring contacts where they make a good line, else from the force
    Auto,
    /// From the force alone
    Force,
    /// From neighbouring contacts alone; other contacts have none
    Geometry,
    /// None at all
    None,
}

/// How the block moves between grasps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// As motion capture saw it; one grasp for each push.
    Recorded,
    /// Contacts of different pushes become grasps of an object that is turned by 22.5° about its
    /// centroid from grasp to grasp and slips on the way.
    Invented {
        /// Standard deviations of the slip in the axes of the object, about its centroid.
        noise: Deviation,
        /// Contacts in a grasp.
        group: usize,
        /// Of the slips, and of which contacts make a grasp.
        seed: u64,
    },
}

/// Reads a recording.
///
/// # Errors
/// Naming file, line and column, the push, and what was expected there.
pub fn read(path: &Path) -> Result<Vec<Push>, LogError> {
    parse(&text(path)?, path)
}

fn parse(text: &str, path: &Path) -> Result<Vec<Push>, LogError> {
    let mut tokens = Tokens::new(path, text);
    let count = tokens.count("the number of pushes")?;
    if count == 0 {
        return Err(tokens.wrong(None, "expected at least one push"));
    }
    let mut pushes = Vec::new();
    for k in 0..count {
        let push = |what: &str| format!("push {k} of {count}: {what}");
        let before = pose(&mut tokens, &push("pose before"))?;
        let after = pose(&mut tokens, &push("pose after"))?;
        let readings = tokens.count(push("the number of force readings"))?;
        let mut forces = Vec::new();
        for i in 0..readings {
            let reading = |what: &str| push(&format!("{what} of force reading {i} of {readings}"));
            let time = tokens.number(reading("time"))?;
            forces.push((time, [tokens.number(reading("x"))?, tokens.number(reading("y"))?]));
        }
        let positions = tokens.count(push("the number of tip positions"))?;
        if positions == 0 {
            let problem = push("expected at least one tip position, found 0");
            return Err(tokens.wrong(None, problem));
        }
        let mut tips = Vec::new();
        for i in 0..positions {
            let tip = push(&format!("tip position {i} of {positions}"));
            let time = tokens.number(format_args!("{tip}: time"))?;
            tips.push((time, pose(&mut tokens, &tip)?));
        }
        pushes.push(Push { before, after, forces, tips });
    }
    tokens.end(format_args!("{count} pushes"))?;
    Ok(pushes)
}

/// x y z in millimetres, qw qx qy qz.
fn pose(tokens: &mut Tokens<'_>, what: &str) -> Result<Pose, LogError> {
    let mut n = [0.0; 7];
    for (n, name) in n.iter_mut().zip(["x", "y", "z", "qw", "qx", "qy", "qz"]) {
        *n = tokens.number(format_args!("{what}: {name}"))?;
    }
    let [x, y, z, qw, qx, qy, qz] = n;
    if [x, y, z].iter().any(|v| v.abs() * 1e-3 > MAX_COORDINATE) {
        let problem = format!("{what}: expected a position within ±{MAX_COORDINATE} m");
        return Err(tokens.wrong(None, problem));
    }
    let q = Quaternion::new(qw, qx, qy, qz);
    if (q.norm() - 1.0).abs() > 1e-3 {
        let length = q.norm();
        let problem = format!("{what}: expected a quaternion of length 1, found length {length}");
        return Err(tokens.wrong(None, problem));
    }
    let translation = Translation3::new(x * 1e-3, y * 1e-3, z * 1e-3);
    Ok(Isometry3::from_parts(translation, UnitQuaternion::new_normalize(q)))
}

impl Push {
    /// The block after the push, in the plane.
    pub fn pose(&self) -> Pose {
        let (_, _, yaw) = self.after.rotation.euler_angles();
        space::planar(self.after.translation.x, self.after.translation.y, yaw)
    }

    /// The force on the block at the end of the push, newtons, in the plane of the world; `None`
    /// without readings.
    pub fn force(&self) -> Option<Point> {
        let (end, tool) = self.tips.last()?;
        let mean = |readings: &[(f64, [f64; 2])]| {
            let sum = readings.iter().map(|(_, f)| Vector2::from(*f)).sum::<Vector2<f64>>();
            (!readings.is_empty()).then(|| sum / readings.len() as f64)
        };
        let unloaded = mean(&self.forces[..self.forces.len().min(UNLOADED)])?;
        let at_end = |r: &&(f64, [f64; 2])| (r.0 - end).abs() <= FORCE_WINDOW;
        let at_end: Vec<_> = self.forces.iter().filter(at_end).copied().collect();
        let f = mean(&at_end)? - unloaded;
        // The sensor is mounted at 45° to the tool, and feels the reaction.
        let s = std::f64::consts::FRAC_1_SQRT_2;
        let tool = tool.rotation * Point::new(-s * (f.x + f.y), -s * (f.x - f.y), 0.0);
        Some(Point::new(tool.x, tool.y, 0.0))
    }
}

/// A contact in the frame of the block.
struct Touch {
    bare: Bare,
    /// Direction and deviation.
    normal: Option<(Point, f64)>,
    /// Newtons.
    force: Option<f64>,
}

/// The contact at the end of each push, with the normal asked for.
fn touches(pushes: &[Push], normals: Normals) -> Vec<Touch> {
    let mut touches: Vec<Touch> = Vec::new();
    for push in pushes {
        let Some((_, tip)) = push.tips.last() else { continue };
        let tip = Point::new(tip.translation.x, tip.translation.y, 0.0);
        let pose = push.pose();
        let force = push.force();
        let strong = force.filter(|f| f.norm() >= LEAST_FORCE);
        let bare = Bare {
            point: pose.inverse_transform_point(&tip.into()).coords,
            outward: strong.map(|f| -pose.inverse_transform_vector(&f).normalize()),
        };
        touches.push(Touch { bare, normal: None, force: force.map(|f| f.norm()) });
    }
    let bare: Vec<Bare> = touches.iter().map(|t| t.bare).collect();
    let fit = LineFit::new(POINT_NOISE);
    for (k, touch) in touches.iter_mut().enumerate() {
        let line = || fit.normal(&bare, k).map(|n| (n.direction, n.deviation));
        let force = touch.bare.outward.map(|n| (n, FORCE_NOISE));
        touch.normal = match normals {
            Normals::Auto => line().or(force),
            Normals::Force => force,
            Normals::Geometry => line(),
            Normals::None => None,
        };
    }
    touches
}

impl Touch {
    /// As felt with the block at `pose`.
    fn at(&self, pose: &Pose, finger: usize) -> LoggedContact {
        LoggedContact {
            finger: Some(finger),
            point: pose.transform_point(&self.bare.point.into()).coords,
            normal: self.normal.map(|(n, _)| pose.transform_vector(&n)),
            normal_noise: self.normal.map(|(_, deviation)| deviation),
            force: self.force,
            unknown: serde_json::Map::new(),
        }
    }
}

/// Makes a grasp log of the pushes. True poses and the true triangle are in it for evaluation; the
/// normals do not use them, but the neighbourhood of contacts is that of motion capture.
pub fn log(pushes: &[Push], motion: &Motion, normals: Normals, description: &str) -> GraspLog {
    let touches = touches(pushes, normals);
    let (grasps, fingers, noise) = match motion {
        Motion::Recorded => {
            // Motion capture's own error is part of what a contact misses the edge by, so this
            // bounds it: in translation, and in rotation over half an edge.
            let noise = Deviation { length: POINT_NOISE, angle: POINT_NOISE / 0.075 };
            (recorded(pushes, &touches), vec!["probe".to_string()], noise)
        }
        Motion::Invented { noise, group, seed } => {
            let group = (*group).clamp(1, MAX_FINGERS);
            let fingers = (1..=group).map(|k| format!("probe {k}")).collect();
            (invented(&touches, *noise, group, *seed), fingers, *noise)
        }
    };
    GraspLog {
        dimension: 2,
        description: description.into(),
        fingers,
        noise: Noise {
            point: Some(POINT_NOISE),
            normal: (normals != Normals::None).then_some(FORCE_NOISE),
            ..Noise::stated(None, Some(noise))
        },
        shape: Some(TrueShape::Polygon(TRIANGLE.to_vec())),
        grasps,
        unknown: serde_json::Map::new(),
    }
}

fn recorded(pushes: &[Push], touches: &[Touch]) -> Vec<LoggedGrasp> {
    let end = |push: &Push| push.tips.last().map(|(time, _)| *time);
    let start = pushes.first().and_then(|p| p.tips.first()).map_or(0.0, |(time, _)| *time);
    let times: Vec<f64> = pushes.iter().filter_map(end).map(|time| time - start).collect();
    // A log's clock does not run backwards; one that does says nothing.
    let clock = times.iter().all(|t| *t >= 0.0) && times.is_sorted();
    let mut grasps: Vec<LoggedGrasp> = Vec::new();
    for (k, (push, touch)) in pushes.iter().zip(touches).enumerate() {
        let pose = push.pose();
        let previous = grasps.last().and_then(|g| g.truth);
        grasps.push(LoggedGrasp {
            index: k as u64,
            time: times.get(k).copied().filter(|_| clock),
            motion: previous.map(|previous| pose * previous.inverse()),
            contacts: vec![touch.at(&pose, 0)],
            truth: Some(pose),
            ..LoggedGrasp::default()
        });
    }
    grasps
}

fn invented(touches: &[Touch], noise: Deviation, group: usize, seed: u64) -> Vec<LoggedGrasp> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..touches.len()).collect();
    for k in (1..order.len()).rev() {
        // The bias of the remainder is below 10⁻¹⁶.
        order.swap(k, (random.next_u64() % (k as u64 + 1)) as usize);
    }
    let [a, b, c] = TRIANGLE.map(|[x, y]| Point::new(x, y, 0.0));
    let centroid = (a + b + c) / 3.0;
    // The centroid starts at the origin of the world.
    let mut pose = space::planar(-centroid.x, -centroid.y, 0.0);
    let mut grasps: Vec<LoggedGrasp> = Vec::new();
    for members in order.chunks(group) {
        // A lone contact left over is no grasp, unless one contact is all there ever is.
        if members.len() < group.min(2) {
            continue;
        }
        let mut motion = None;
        if !grasps.is_empty() {
            let turned = turn_about(&pose.transform_point(&centroid.into()).coords, REORIENTATION);
            let (x, y) = normal_pair(&mut random);
            let (w, _) = normal_pair(&mut random);
            let slip = space::planar(noise.length * x, noise.length * y, noise.angle * w);
            // The slip turns the object about its centroid, not about the frame's origin.
            let to = Translation3::from(centroid);
            pose = turned * pose * to * slip * to.inverse();
            motion = Some(turned);
        }
        let contacts = members.iter().enumerate().map(|(f, k)| touches[*k].at(&pose, f));
        grasps.push(LoggedGrasp {
            index: grasps.len() as u64,
            motion,
            contacts: contacts.collect(),
            truth: Some(pose),
            ..LoggedGrasp::default()
        });
    }
    grasps
}

/// The planar turn that leaves `centre` where it is.
fn turn_about(centre: &Point, angle: f64) -> Pose {
    let centre = Vector2::new(centre.x, centre.y);
    let offset = centre - Rotation2::new(angle) * centre;
    space::planar(offset.x, offset.y, angle)
}

/// Two independent standard normal numbers.
fn normal_pair(random: &mut Xoshiro256PlusPlus) -> (f64, f64) {
    // In (0, 1): the logarithm of zero is not wanted.
    let mut uniform = || ((random.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let radius = (-2.0 * uniform().ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * uniform()).sin_cos();
    (radius * cos, radius * sin)
}

#[cfg(test)]
mod tests;
