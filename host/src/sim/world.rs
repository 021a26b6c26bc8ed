//! The contact world: an object that a hand grasps, turns, and loses its exact pose of.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use nalgebra::{Point3, Translation3, UnitQuaternion};

use super::objects::{ObjectError, ObjectSpec};
use super::random::Random;
use super::touch::{FINGERS, Felt, Hand, Touch};
use crate::log::words::WordsError;
use crate::log::write::{is_same_file, write_atomically};
use crate::log::{GraspLog, LogError, LoggedContact, LoggedGrasp, MAX_CONTACTS, Noise, TrueShape};
use crate::quantity::{Deviation, Displacement};
use crate::shape::files::{FileError, ply_to_writer};
use crate::shape::{Geometry, Mesh};
use crate::space::{Point, Pose};

/// Where the object first lies: within this of the world's origin, per axis, and turned by no more
/// than this about each axis.
pub(super) const FIRST_OFFSET: f64 = 0.01;
pub(super) const FIRST_TURN: f64 = PI / 12.0;

/// Wild contacts lie within this of the surface, metres.
const WILD: f64 = 0.03;

/// Attempts at one grasp: a hand that closed on nothing tries again elsewhere.
const ATTEMPTS: usize = 50;

/// What descriptions of logs begin with that were made here; the object is next.
pub(super) const SIMULATED: &str = "simulated ";
pub(super) const EXPLORED: &str = "explored ";

/// Contacts in a whole log.
const MOST_CONTACTS: usize = 10_000_000;

/// What to simulate.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// What is touched.
    pub object: ObjectSpec,
    /// How often; by default 16 in the plane and 20 in space, the 16 as in the thesis (3.4).
    pub grasps: Option<usize>,
    /// Contacts per grasp; for a hand, how many fingers close.
    pub contacts: usize,
    /// Where contacts come from.
    pub touch: Touch,
    /// Of contact points (metres per axis) and of normals (radians per axis).
    pub contact_noise: Deviation,
    /// Of the object's motion between grasps, per axis in the object frame about its centroid.
    pub motion_noise: Deviation,
    /// How far the object is carried before the middle grasp, in any direction and about any axis, of which
    /// the log says nothing.
    pub carried: Option<Displacement>,
    /// Which part of all contacts is wild: within 30 mm of the surface, with any normal.
    pub outliers: f64,
    /// Whether a hand reports fingertips that touched nothing.
    pub free: bool,
    /// The same seed gives the same log.
    pub seed: u64,
}

impl Options {
    /// Five-finger grasps of `object` with the thesis' noise: contacts 1 mm and 5°, motion 10 mm and
    /// 20°.
    pub fn new(object: ObjectSpec) -> Options {
        Options {
            object,
            grasps: None,
            contacts: 5,
            touch: Touch::Hand,
            contact_noise: Deviation { length: 1e-3, angle: 5f64.to_radians() },
            motion_noise: Deviation { length: 1e-2, angle: 20f64.to_radians() },
            carried: None,
            outliers: 0.0,
            free: true,
            seed: 0,
        }
    }
}

/// Why there is no simulation.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The object has no geometry.
    #[error(transparent)]
    Object(#[from] ObjectError),
    /// An option is out of its range.
    #[error("{option}: expected {expected}, found {found}")]
    Option {
        /// Which, as on the command line.
        option: &'static str,
        /// What would have been right.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// Where the true mesh goes there is another file.
    #[error(
        "{} is there already and no true mesh of {}; expected another name for the log",
        .file.display(), .log.display()
    )]
    Taken {
        /// What would be replaced.
        file: PathBuf,
        /// The log beside it.
        log: PathBuf,
    },
    /// A planar object for a hand that closes around solids.
    #[error(
        "{object} is planar, and an articulated hand closes around solids only: prism:HEIGHT,{object} \
         makes it one where it is convex, lshape and tshape take a height"
    )]
    Planar {
        /// The object.
        object: String,
    },
    /// No finger reaches the object.
    #[error(
        "grasp {grasp}: the hand closed on nothing in {ATTEMPTS} attempts; is {object} too small?"
    )]
    Missed {
        /// From 0.
        grasp: usize,
        /// What was to be grasped.
        object: String,
    },
    /// The true mesh has no place beside the log.
    #[error("{}: expected a file whose folder can take the true mesh beside it", file.display())]
    NoPlace {
        /// Where the log was to go.
        file: PathBuf,
    },
    /// The log cannot be written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The true mesh cannot be written.
    #[error(transparent)]
    Mesh(#[from] FileError),
    /// What the sensors read cannot be used.
    #[error(transparent)]
    Words(WordsError),
}

/// A simulated log and its truth.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// With true poses. A planar shape is in the header; a mesh gets its name there when
    /// [`Simulation::write`] gives it one.
    pub log: GraspLog,
    /// The true shape in the object frame.
    pub geometry: Geometry,
    /// What was simulated.
    pub object: ObjectSpec,
}

/// Simulates grasps of an object.
///
/// Between grasps the hand turns the object about the middle of the last grasp: in the plane by
/// 22.5°, in space by 30° about z and every fourth time by 45° about x or y. That is the log's
/// motion; the true pose then slips: T_k = (motion_k · T_{k−1}) ⊕ v with v drawn per axis of the
/// object frame about the object's centroid. An object that is carried is not only where that leaves it,
/// but elsewhere, and the hand follows it there.
///
/// # Errors
/// When an option is out of range, the object has no geometry, or no finger reaches it.
pub fn simulate(options: &Options) -> Result<Simulation, SimError> {
    check(options)?;
    let geometry = options.object.geometry()?;
    let dimension = geometry.dimension();
    let centre = geometry.centroid();
    let [mut slips, mut hands, mut noise, mut wild, mut elsewhere] = Random::streams(options.seed);

    let shift = uniform3(dimension, FIRST_OFFSET, &mut slips);
    let turned = turn(dimension, FIRST_TURN, &mut slips);
    let mut pose = Translation3::from(-centre) * about(&centre, shift, turned);
    let hand = Hand::new(options, &geometry, &mut hands);
    let mut middle = Point::zeros();
    let grasps = options.grasps.unwrap_or(if dimension == 2 { 16 } else { 20 });
    let mut logged = Vec::with_capacity(grasps);
    for index in 0..grasps {
        let mut motion = None;
        if index > 0 {
            let turned = about(&middle, Point::zeros(), reorientation(dimension, index));
            let slip = about(
                &centre,
                options.motion_noise.length * normal(dimension, &mut slips),
                options.motion_noise.angle * normal_turn(dimension, &mut slips),
            );
            pose = turned * pose * slip;
            if let Some(by) = options.carried.filter(|_| index == grasps / 2) {
                pose *= carried(dimension, &centre, by, &mut elsewhere);
            }
            pose.rotation.renormalize();
            motion = Some(turned);
        }
        let closed = (0..ATTEMPTS).find_map(|_| hand.close(&pose, &mut hands));
        let Some(closed) = closed else {
            return Err(SimError::Missed { grasp: index, object: options.object.to_string() });
        };
        middle = closed.middle;
        let contacts = closed
            .felt
            .into_iter()
            .map(|felt| sensed(&pose, felt, dimension, options, &mut noise, &mut wild));
        logged.push(LoggedGrasp {
            index: index as u64,
            time: None,
            motion,
            contacts: contacts.collect(),
            free: if options.free { closed.free } else { Vec::new() },
            truth: Some(pose),
            unknown: Default::default(),
        });
    }
    let log = GraspLog {
        dimension,
        description: description(options, grasps),
        fingers: FINGERS.map(String::from).to_vec(),
        noise: stated(options),
        shape: match &geometry {
            Geometry::Outline(o) => o.loops.first().map(|l| TrueShape::Polygon(l.clone())),
            Geometry::Mesh(_) => None,
        },
        grasps: logged,
        unknown: Default::default(),
    };
    Ok(Simulation { log, geometry, object: options.object.clone() })
}

impl Simulation {
    /// Writes the log to `path`, and in space the true mesh beside it as `NAME.ply`: both or
    /// neither. A mesh file that was simulated and already lies there is named, not written; the mesh
    /// of an earlier simulation there is replaced with its log, and no other file.
    ///
    /// # Errors
    /// When one of the two cannot be written, or there is no place for the mesh or another file in it.
    pub fn write(&self, path: &Path) -> Result<(), SimError> {
        write(&self.log, &self.geometry, &self.object, path)
    }
}

/// See [`Simulation::write`].
pub(super) fn write(
    log: &GraspLog,
    geometry: &Geometry,
    object: &ObjectSpec,
    path: &Path,
) -> Result<(), SimError> {
    let Geometry::Mesh(mesh) = geometry else { return Ok(log.write(path)?) };
    let no_place = || SimError::NoPlace { file: path.into() };
    if path.exists() && !path.is_file() {
        return Err(no_place());
    }
    let file = path.with_extension("ply");
    let name = file.file_name().and_then(|n| n.to_str()).ok_or_else(no_place)?;
    if file == path {
        return Err(no_place());
    }
    let mut log = log.clone();
    log.shape = Some(TrueShape::Mesh { path: name.into(), file: file.clone() });
    if let ObjectSpec::Mesh(source) = object
        && let (Ok(a), Ok(b)) = (source.canonicalize(), file.canonicalize())
        && a == b
    {
        return Ok(log.write(path)?);
    }
    if file.exists() && !is_written(&file, name, path) && !holds(&file, mesh) {
        return Err(SimError::Taken { file, log: path.into() });
    }
    // The mesh gets its name only after the log has got its own.
    let mut refused = None;
    let written = write_atomically(&file, |writer| {
        ply_to_writer(writer, mesh, None, None)?;
        log.write(path).map_err(|e| {
            refused = Some(e);
            std::io::ErrorKind::Other.into()
        })
    });
    match (refused, written) {
        (Some(error), _) => Err(error.into()),
        (None, Err(source)) => Err(FileError::Io { file, action: "write", source }.into()),
        (None, Ok(())) => Ok(()),
    }
}

/// Whether a mesh was written beside a log, damaged or not: by an earlier run, but of another object than that mesh
/// itself.
fn is_written(mesh: &Path, name: &str, log: &Path) -> bool {
    let Ok((log, _)) = GraspLog::salvage(log) else { return false };
    let made = [SIMULATED, EXPLORED].iter().find_map(|made| log.description.strip_prefix(made));
    let is_other =
        |object: &str| !object.strip_prefix(name).is_some_and(|rest| rest.starts_with([':', ',']));
    made.is_some_and(is_other)
        && matches!(log.shape, Some(TrueShape::Mesh { file, .. }) if is_same_file(&file, mesh))
}

/// Whether a file already holds what would be written.
fn holds(file: &Path, mesh: &Mesh) -> bool {
    let mut bytes = Vec::new();
    let is_made = ply_to_writer(&mut bytes, mesh, None, None).is_ok();
    is_made && std::fs::read(file).is_ok_and(|found| found == bytes)
}

pub(super) fn check(options: &Options) -> Result<(), SimError> {
    let refuse =
        |option, expected, found: String| Err(SimError::Option { option, expected, found });
    let grasps = options.grasps.unwrap_or(1);
    if grasps == 0 {
        return refuse("--grasps", "at least 1", "0".into());
    }
    if options.contacts == 0 || options.contacts > MAX_CONTACTS {
        return refuse("--contacts", "from 1 to 1024", options.contacts.to_string());
    }
    if options.touch == Touch::Hand && options.contacts > FINGERS.len() {
        let expected = "at most 5 with --touch hand (it has five fingers)";
        return refuse("--contacts", expected, options.contacts.to_string());
    }
    if grasps.saturating_mul(options.contacts) > MOST_CONTACTS {
        let found = format!("{grasps} × {}", options.contacts);
        return refuse("--grasps", "at most 10 000 000 contacts in all", found);
    }
    if !(0.0..=1.0).contains(&options.outliers) {
        return refuse("--outliers", "a fraction from 0 to 1", options.outliers.to_string());
    }
    for (option, deviation) in
        [("--contact-noise", options.contact_noise), ("--motion-noise", options.motion_noise)]
    {
        let fine = |x: f64| x >= 0.0 && x.is_finite();
        if !fine(deviation.length) || !fine(deviation.angle) {
            return refuse(option, "standard deviations from 0", deviation.to_string());
        }
    }
    if let Some(by) = options.carried
        && !(by.length >= 0.0 && by.length.is_finite() && by.angle >= 0.0 && by.angle.is_finite())
    {
        return refuse("--carried", "a length and an angle from 0", by.to_string());
    }
    if options.carried.is_some() && options.grasps == Some(1) {
        return refuse(
            "--carried",
            "at least 2 grasps, for the object is carried between two",
            "1".into(),
        );
    }
    Ok(())
}

/// A displacement of an object about its centroid, object frame.
fn carried(dimension: usize, centre: &Point, by: Displacement, random: &mut Random) -> Pose {
    let shift = by.length * random.direction(dimension);
    let axis = if dimension == 3 { random.direction(3) } else { Point::z() };
    about(centre, shift, by.angle * axis)
}

/// The motion that turns about `centre` and shifts.
pub(super) fn about(centre: &Point, shift: Point, turn: Point) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(turn);
    Pose::from_parts(Translation3::from(centre + shift - rotation * centre), rotation)
}

/// Uniform within `reach` of zero on every axis.
pub(super) fn uniform3(dimension: usize, reach: f64, random: &mut Random) -> Point {
    let (x, y) = (random.around_zero(reach), random.around_zero(reach));
    Point::new(x, y, if dimension == 3 { random.around_zero(reach) } else { 0.0 })
}

/// A rotation vector, uniform within `reach` of zero on every axis there is.
pub(super) fn turn(dimension: usize, reach: f64, random: &mut Random) -> Point {
    match dimension {
        2 => Point::new(0.0, 0.0, random.around_zero(reach)),
        _ => uniform3(3, reach, random),
    }
}

/// Standard normal on every axis there is.
pub(super) fn normal(dimension: usize, random: &mut Random) -> Point {
    let v = random.normal3();
    if dimension == 3 { v } else { Point::new(v.x, v.y, 0.0) }
}

/// A rotation vector, standard normal on every axis there is.
pub(super) fn normal_turn(dimension: usize, random: &mut Random) -> Point {
    let v = random.normal3();
    if dimension == 3 { v } else { Point::new(0.0, 0.0, v.z) }
}

/// How the hand turns the object before grasp `index`, a rotation vector.
fn reorientation(dimension: usize, index: usize) -> Point {
    let turn = |axis: Point, degrees: f64| axis * degrees.to_radians();
    match (dimension, index % 8) {
        (2, _) => turn(Point::z(), 22.5),
        (_, 4) => turn(Point::x(), 45.0),
        (_, 0) => turn(Point::y(), 45.0),
        _ => turn(Point::z(), 30.0),
    }
}

/// What a sensor says of a contact with the object at `pose`.
pub(super) fn sensed(
    pose: &Pose,
    felt: Felt,
    dimension: usize,
    options: &Options,
    noise: &mut Random,
    wild: &mut Random,
) -> LoggedContact {
    let at = ((pose * Point3::from(felt.point)).coords, pose.rotation * felt.normal);
    let (point, normal) = measured(dimension, at, options, noise, wild);
    LoggedContact {
        finger: felt.finger,
        point,
        normal: Some(normal),
        normal_noise: None,
        force: None,
        unknown: Default::default(),
    }
}

/// The contact as a sensor gives it. Every contact takes the same draws, whatever the noise, so
/// that a seed means the same touches at every noise.
fn measured(
    dimension: usize,
    (point, direction): (Point, Point),
    options: &Options,
    noise: &mut Random,
    wild: &mut Random,
) -> (Point, Point) {
    let shift = options.contact_noise.length * normal(dimension, noise);
    let angles = noise.normal_pair().map(|a| options.contact_noise.angle * a);
    let (chance, reach) = (wild.unit(), WILD * wild.unit());
    let (toward, any) = (wild.direction(dimension), wild.direction(dimension));
    if chance < options.outliers {
        return (point + reach * toward, any);
    }
    let turn = if dimension == 2 {
        Point::z() * angles[0]
    } else {
        // Any two axes across the normal will do: the distribution is the same.
        let least = direction.iamin();
        let across = direction.cross(&Point::ith(least, 1.0)).normalize();
        across * angles[0] + direction.cross(&across) * angles[1]
    };
    let turned = UnitQuaternion::from_scaled_axis(turn) * direction;
    (point + shift, turned.normalize())
}

/// What the header says.
pub(super) fn stated(options: &Options) -> Noise {
    Noise::stated(Some(options.contact_noise), Some(options.motion_noise))
}

fn description(options: &Options, grasps: usize) -> String {
    let Options { object, contacts, contact_noise, motion_noise, outliers, seed, .. } = options;
    let away = options.carried.map_or(String::new(), |by| format!(", carried {by} away half-way"));
    let touch = match options.touch {
        Touch::Hand => "a hand",
        Touch::Uniform => "uniform draws",
    };
    let object = object.without_folders();
    format!(
        "{SIMULATED}{object}: {grasps} grasps of {contacts} contacts by {touch}, contact noise \
         {contact_noise}, motion noise {motion_noise}{away}, outliers {outliers}, seed {seed}"
    )
}

#[cfg(test)]
mod tests;
