//! Hands as the URDF describes them: links, the joints between them, and what they are made of.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::{Translation3, Unit, UnitQuaternion, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::shape::SharedShape;
use urdf_rs::JointType;

use crate::shape::files::{FileError, read_mesh};
use crate::space::{Point, Pose};

/// Greatest size of a description, bytes.
const MOST_BYTES: usize = 16 << 20;

/// How deep its elements may lie in each other; a URDF needs five levels.
const MOST_LEVELS: usize = 64;

/// Links of a hand at most.
const MOST_LINKS: usize = 256;

/// Lengths beyond this are no hand's, metres.
const LONGEST: f64 = 10.0;

/// Why a description is no hand.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct HandError {
    /// Where the description is from.
    pub file: String,
    /// What is wrong with it.
    pub problem: Box<Problem>,
}

/// What is wrong with a description.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The system says no.
    #[error("cannot read: {0}")]
    Io(std::io::Error),
    /// No URDF.
    #[error("not a URDF: {0}")]
    Text(String),
    /// A macro file.
    #[error("this is a xacro file, expected a URDF: run `xacro FILE > hand.urdf` first")]
    Xacro,
    /// Nothing in it.
    #[error("it has no links, expected a palm and fingers")]
    Empty,
    /// More than any hand has.
    #[error("{found} {what}, expected at most {most}")]
    Many {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// A name is used twice.
    #[error("{what} {name:?} is there twice")]
    Twice {
        /// `link` or `joint`.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A joint names a link that does not exist.
    #[error("joint {joint:?}: there is no link {link:?}")]
    NoLink {
        /// The joint.
        joint: String,
        /// What it names.
        link: String,
    },
    /// A link hangs on two joints.
    #[error("link {link:?} is the child of joints {first:?} and {second:?}, expected one parent")]
    TwoParents {
        /// The link.
        link: String,
        /// One joint.
        first: String,
        /// The other.
        second: String,
    },
    /// Every link is a child: there is no palm to begin at.
    #[error("every link is the child of another, expected one root, the palm")]
    NoRoot,
    /// Parts that do not hang together.
    #[error("links {0} are no joint's child, expected one root, the palm")]
    Roots(String),
    /// Links that hang on themselves.
    #[error("link {link:?} hangs on itself in a loop of joints")]
    Loop {
        /// One of them.
        link: String,
    },
    /// A joint that this model does not have.
    #[error("joint {joint:?} is {kind}, expected revolute, continuous, prismatic or fixed")]
    Kind {
        /// The joint.
        joint: String,
        /// Its type.
        kind: &'static str,
    },
    /// No axis.
    #[error("joint {joint:?}: axis {axis:?}, expected a finite direction that is not zero")]
    Axis {
        /// The joint.
        joint: String,
        /// What is there.
        axis: [f64; 3],
    },
    /// Limits that are no interval.
    #[error(
        "joint {joint:?}: limits from {lower} to {upper}, expected finite ones in rising order"
    )]
    Limits {
        /// The joint.
        joint: String,
        /// What is there.
        lower: f64,
        /// What is there.
        upper: f64,
    },
    /// A joint that follows one it cannot follow.
    #[error("joint {joint:?} mimics {of:?}: {problem}")]
    Mimic {
        /// The joint.
        joint: String,
        /// Whom it follows.
        of: String,
        /// Why it cannot.
        problem: &'static str,
    },
    /// A number that is not finite or out of all proportion.
    #[error("{place}: {what} {found:?}, expected finite numbers of at most {LONGEST} m")]
    Number {
        /// Link or joint.
        place: String,
        /// Which quantity.
        what: &'static str,
        /// What is there.
        found: Vec<f64>,
    },
    /// A solid without size.
    #[error("link {link:?}: {what} {found:?}, expected sizes above zero")]
    Size {
        /// The link.
        link: String,
        /// Which solid.
        what: &'static str,
        /// What is there.
        found: Vec<f64>,
    },
    /// A mesh that cannot be read.
    #[error("link {link:?}: mesh {source}")]
    Mesh {
        /// The link.
        link: String,
        /// Why not.
        source: FileError,
    },
    /// A mesh that encloses nothing.
    #[error("link {link:?}: mesh {}: its points span no volume", file.display())]
    Flat {
        /// The link.
        link: String,
        /// The mesh.
        file: PathBuf,
    },
    /// A mesh whose place is not known.
    #[error(
        "link {link:?}: mesh {uri:?} is in no folder above the URDF; expected a path relative to the \
         URDF, or its package's folder beside or above it"
    )]
    Package {
        /// The link.
        link: String,
        /// As written.
        uri: String,
    },
    /// Nothing to touch with.
    #[error(
        "no fingertip: expected a link with collision geometry that a joint moves and that carries \
         no other such link"
    )]
    NoTips,
    /// A fingertip that was asked for is none.
    #[error("fingertip {name:?}: {problem}")]
    Tip {
        /// As asked for.
        name: String,
        /// Why it is none.
        problem: &'static str,
    },
}

/// A hand as a tree of links, the root (the palm) first and every other link after the one it hangs on.
#[derive(Clone, Debug)]
pub struct Model {
    /// The robot's name.
    pub name: String,
    /// At least one.
    pub links: Vec<Link>,
    /// What moves independently; joints that mimic another have no coordinate of their own.
    pub coordinates: Vec<Coordinate>,
}

/// A rigid part.
#[derive(Clone, Debug)]
pub struct Link {
    /// Unique.
    pub name: String,
    /// What it hangs on; `None` for the root alone.
    pub joint: Option<Joint>,
    /// Its collision geometry.
    pub solids: Vec<Solid>,
}

/// What holds a link.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Unique.
    pub name: String,
    /// Index of the link that it is fixed on, smaller than that of the link it holds.
    pub parent: usize,
    /// Of the joint on the parent, at value zero.
    pub origin: Pose,
    /// How it moves.
    pub motion: Motion,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Not at all.
    Fixed,
    /// About an axis of its frame, radians.
    Turn(Unit<Vector3<f64>>, Drive),
    /// Along an axis of its frame, metres.
    Slide(Unit<Vector3<f64>>, Drive),
}

/// The value of a joint: `factor` · coordinate + `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Index of the coordinate.
    pub coordinate: usize,
    /// 1 but for joints that mimic another.
    pub factor: f64,
    /// 0 but for joints that mimic another.
    pub offset: f64,
}

/// An independent coordinate: the value of one joint, radians or metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Coordinate {
    /// The joint's name.
    pub joint: String,
    /// Least value: where this joint, or one that mimics it, ends.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
}

/// A convex body fixed on a link.
#[derive(Clone)]
pub struct Solid {
    /// Body to link.
    pub origin: Pose,
    /// Sphere, capsule, cylinder, box, or the convex hull of a mesh.
    pub shape: SharedShape,
    /// The farthest of its points from its origin, metres.
    pub radius: f64,
}

impl std::fmt::Debug for Solid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?} at {:?}", self.shape.shape_type(), self.origin)
    }
}

impl Model {
    /// Reads a file; meshes are looked for relative to it.
    ///
    /// # Errors
    /// When it cannot be read or describes no hand.
    pub fn read(file: &Path) -> Result<Model, HandError> {
        let name = file.display().to_string();
        let text = std::fs::read_to_string(file)
            .map_err(|e| HandError { file: name.clone(), problem: Box::new(Problem::Io(e)) })?;
        Model::parse(&text, &name, file.parent())
    }

    /// Parses a description; `file` is its name in errors, `folder` where its meshes are.
    ///
    /// # Errors
    /// When it describes no tree of links.
    ///
    /// ```
    /// use tactile_host::sim::hand::urdf::Model;
    /// let text = r#"<robot name="stick"><link name="palm"/><link name="tip"/>
    ///     <joint name="j" type="revolute"><parent link="palm"/><child link="tip"/>
    ///     <axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"#;
    /// let model = Model::parse(text, "stick.urdf", None).unwrap();
    /// assert_eq!((model.links.len(), model.coordinates.len()), (2, 1));
    /// ```
    pub fn parse(text: &str, file: &str, folder: Option<&Path>) -> Result<Model, HandError> {
        parse(text, folder)
            .map_err(|problem| HandError { file: file.into(), problem: problem.into() })
    }

    /// The link of this name.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|l| l.name == name)
    }

    /// The links from the root to `link`, both included.
    pub fn chain(&self, link: usize) -> Vec<usize> {
        let mut chain = vec![link];
        let mut at = link;
        while let Some(joint) = self.links.get(at).and_then(|l| l.joint.as_ref()) {
            at = joint.parent;
            chain.push(at);
        }
        chain.reverse();
        chain
    }

    /// The fingertips: links with solids that a joint moves and that carry no other link with solids,
    /// in the order of the description; or, where names are given, those links.
    ///
    /// # Errors
    /// When there are none, or a named link is none.
    pub fn tips(&self, names: &[String]) -> Result<Vec<usize>, Problem> {
        let moved = |link: usize| {
            self.chain(link)
                .iter()
                .any(|l| matches!(&self.links[*l].joint, Some(j) if j.motion != Motion::Fixed))
        };
        if !names.is_empty() {
            let one = |name: &String| {
                let refuse = |problem| Problem::Tip { name: name.clone(), problem };
                let link = self.link(name).ok_or_else(|| refuse("there is no such link"))?;
                if self.links[link].solids.is_empty() {
                    return Err(refuse("it has no collision geometry to touch with"));
                }
                if !moved(link) {
                    return Err(refuse("no joint moves it"));
                }
                Ok(link)
            };
            return names.iter().map(one).collect();
        }
        let mut carries = vec![false; self.links.len()];
        let mut tips = Vec::new();
        for (index, link) in self.links.iter().enumerate().rev() {
            let solid = !link.solids.is_empty();
            if solid && !carries[index] && moved(index) {
                tips.push(index);
            }
            if let Some(joint) = &link.joint {
                carries[joint.parent] |= solid || carries[index];
            }
        }
        tips.reverse();
        if tips.is_empty() { Err(Problem::NoTips) } else { Ok(tips) }
    }
}

fn parse(text: &str, folder: Option<&Path>) -> Result<Model, Problem> {
    if text.len() > MOST_BYTES {
        return Err(Problem::Many { what: "bytes", found: text.len(), most: MOST_BYTES });
    }
    // The parser calls itself for every level.
    let deep = levels(text);
    if deep > MOST_LEVELS {
        return Err(Problem::Many { what: "levels of elements", found: deep, most: MOST_LEVELS });
    }
    if text.contains("<xacro:") {
        return Err(Problem::Xacro);
    }
    let robot = urdf_rs::read_from_string(text).map_err(|e| Problem::Text(e.to_string()))?;
    if robot.links.is_empty() {
        return Err(Problem::Empty);
    }
    if robot.links.len() > MOST_LINKS {
        return Err(Problem::Many { what: "links", found: robot.links.len(), most: MOST_LINKS });
    }
    let mut index = HashMap::new();
    for (i, link) in robot.links.iter().enumerate() {
        if index.insert(link.name.as_str(), i).is_some() {
            return Err(Problem::Twice { what: "link", name: link.name.clone() });
        }
    }
    let order = order(&robot, &index)?;
    let drives = Drives::new(&robot.joints)?;

    let mut place = vec![0; robot.links.len()];
    let mut links = Vec::with_capacity(order.len());
    for (new, (old, joint)) in order.into_iter().enumerate() {
        place[old] = new;
        let link = &robot.links[old];
        let joint = match joint {
            None => None,
            Some(number) => {
                let joint = &robot.joints[number];
                let parent = index.get(joint.parent.link.as_str()).map_or(0, |p| place[*p]);
                Some(Joint {
                    name: joint.name.clone(),
                    parent,
                    origin: pose(&joint.origin, || format!("joint {:?}", joint.name))?,
                    motion: motion(joint, drives.of[number])?,
                })
            }
        };
        let solids = link.collision.iter().map(|c| solid(c, &link.name, folder));
        links.push(Link {
            name: link.name.clone(),
            joint,
            solids: solids.collect::<Result<_, _>>()?,
        });
    }
    Ok(Model { name: robot.name, links, coordinates: drives.coordinates })
}

/// How deep elements lie in each other, comments and the like left out.
fn levels(text: &str) -> usize {
    let (mut depth, mut deepest) = (0usize, 0);
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let skip = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">")];
        if let Some((_, end)) = skip.iter().find(|(start, _)| rest.starts_with(start)) {
            match rest.find(end) {
                Some(at) => rest = &rest[at + end.len()..],
                None => break,
            }
            continue;
        }
        let end = rest.find('>').unwrap_or(rest.len());
        if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !rest[..end].ends_with('/') {
            depth += 1;
            deepest = deepest.max(depth);
        }
        rest = &rest[end.max(1)..];
    }
    deepest
}

/// The links, every one after its parent, each with the number of the joint that it hangs on.
fn order(
    robot: &urdf_rs::Robot,
    index: &HashMap<&str, usize>,
) -> Result<Vec<(usize, Option<usize>)>, Problem> {
    let count = robot.links.len();
    let mut holder: Vec<Option<usize>> = vec![None; count];
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (number, joint) in robot.joints.iter().enumerate() {
        let find = |link: &String| {
            index
                .get(link.as_str())
                .copied()
                .ok_or_else(|| Problem::NoLink { joint: joint.name.clone(), link: link.clone() })
        };
        let (parent, child) = (find(&joint.parent.link)?, find(&joint.child.link)?);
        if let Some(first) = holder[child].replace(number) {
            return Err(Problem::TwoParents {
                link: joint.child.link.clone(),
                first: robot.joints[first].name.clone(),
                second: joint.name.clone(),
            });
        }
        children[parent].push(child);
    }
    let roots: Vec<usize> = (0..count).filter(|l| holder[*l].is_none()).collect();
    let root = match roots[..] {
        [] => return Err(Problem::NoRoot),
        [root] => root,
        _ => {
            let names: Vec<&str> = roots.iter().map(|r| robot.links[*r].name.as_str()).collect();
            return Err(Problem::Roots(names.join(", ")));
        }
    };
    let mut order = Vec::with_capacity(count);
    let mut reached = vec![false; count];
    let mut open = vec![root];
    while let Some(link) = open.pop() {
        reached[link] = true;
        order.push((link, holder[link]));
        open.extend(children[link].iter().rev());
    }
    // What no root carries hangs on itself.
    match reached.iter().position(|r| !r) {
        Some(lost) => Err(Problem::Loop { link: robot.links[lost].name.clone() }),
        None => Ok(order),
    }
}

/// Which coordinate moves each joint.
struct Drives {
    coordinates: Vec<Coordinate>,
    of: Vec<Option<Drive>>,
}

impl Drives {
    fn new(joints: &[urdf_rs::Joint]) -> Result<Drives, Problem> {
        let mut index = HashMap::new();
        for (i, joint) in joints.iter().enumerate() {
            if index.insert(joint.name.as_str(), i).is_some() {
                return Err(Problem::Twice { what: "joint", name: joint.name.clone() });
            }
        }
        let moves = |j: &urdf_rs::Joint| j.joint_type != JointType::Fixed;
        let mut drives = Drives { coordinates: Vec::new(), of: vec![None; joints.len()] };
        for (i, joint) in joints.iter().enumerate() {
            if moves(joint) && joint.mimic.is_none() {
                let (lower, upper) = limits(joint)?;
                let coordinate = drives.coordinates.len();
                drives.coordinates.push(Coordinate { joint: joint.name.clone(), lower, upper });
                drives.of[i] = Some(Drive { coordinate, factor: 1.0, offset: 0.0 });
            }
        }
        for (i, joint) in joints.iter().enumerate() {
            if moves(joint) && joint.mimic.is_some() {
                let drive = drives.followed(joints, &index, i)?;
                drives.of[i] = Some(drive);
                drives.narrow(joint, drive)?;
            }
        }
        Ok(drives)
    }

    /// The drive of a joint that mimics another, which may itself mimic one.
    fn followed(
        &self,
        joints: &[urdf_rs::Joint],
        index: &HashMap<&str, usize>,
        first: usize,
    ) -> Result<Drive, Problem> {
        let (mut factor, mut offset) = (1.0, 0.0);
        let mut at = first;
        for _ in 0..=joints.len() {
            let joint = &joints[at];
            let Some(mimic) = &joint.mimic else {
                let Some(Drive { coordinate, .. }) = self.of[at] else { break };
                return Ok(Drive { coordinate, factor, offset });
            };
            let refuse = |problem| {
                Err(Problem::Mimic { joint: joint.name.clone(), of: mimic.joint.clone(), problem })
            };
            let (f, o) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
            if !f.is_finite() || !o.is_finite() || f == 0.0 || f.abs().max(o.abs()) > 1e3 {
                return refuse("expected a finite multiplier that is not zero and a finite offset");
            }
            offset += factor * o;
            factor *= f;
            let Some(next) = index.get(mimic.joint.as_str()) else {
                return refuse("there is no such joint");
            };
            at = *next;
            if joints[at].joint_type == JointType::Fixed {
                return refuse("that joint is fixed");
            }
        }
        let joint = &joints[first];
        let of = joint.mimic.as_ref().map_or_else(String::new, |m| m.joint.clone());
        Err(Problem::Mimic { joint: joint.name.clone(), of, problem: "it follows itself" })
    }

    /// A joint that follows ends where it ends.
    fn narrow(&mut self, joint: &urdf_rs::Joint, drive: Drive) -> Result<(), Problem> {
        let (lower, upper) = limits(joint)?;
        // Descriptions often leave the limits of a follower at their default: no limits then.
        if lower == upper {
            return Ok(());
        }
        let ends = [lower, upper].map(|end| (end - drive.offset) / drive.factor);
        let leader = &mut self.coordinates[drive.coordinate];
        let lower = leader.lower.max(ends[0].min(ends[1]));
        let upper = leader.upper.min(ends[0].max(ends[1]));
        if lower > upper {
            return Err(Problem::Mimic {
                joint: joint.name.clone(),
                of: leader.joint.clone(),
                problem: "their limits leave no place",
            });
        }
        (leader.lower, leader.upper) = (lower, upper);
        Ok(())
    }
}

/// Where a joint ends: as described; one turn where there is no limit to turning.
fn limits(joint: &urdf_rs::Joint) -> Result<(f64, f64), Problem> {
    const TURN: f64 = std::f64::consts::PI;
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    let refuse = || Problem::Limits { joint: joint.name.clone(), lower, upper };
    let fine = |most: f64| lower <= upper && lower.abs().max(upper.abs()) <= most;
    match joint.joint_type {
        JointType::Continuous => Ok((-TURN, TURN)),
        JointType::Revolute if lower == f64::NEG_INFINITY && upper == f64::INFINITY => {
            Ok((-TURN, TURN))
        }
        JointType::Revolute if fine(4.0 * TURN) => Ok((lower, upper)),
        JointType::Prismatic if fine(LONGEST) => Ok((lower, upper)),
        JointType::Revolute | JointType::Prismatic => Err(refuse()),
        JointType::Fixed => Ok((0.0, 0.0)),
        JointType::Floating => Err(Problem::Kind { joint: joint.name.clone(), kind: "floating" }),
        JointType::Planar => Err(Problem::Kind { joint: joint.name.clone(), kind: "planar" }),
        JointType::Spherical => Err(Problem::Kind { joint: joint.name.clone(), kind: "spherical" }),
    }
}

fn motion(joint: &urdf_rs::Joint, drive: Option<Drive>) -> Result<Motion, Problem> {
    let Some(drive) = drive else { return Ok(Motion::Fixed) };
    let axis = joint.axis.xyz.0;
    let unit = Unit::try_new(Vector3::from(axis), 1e-9)
        .filter(|u| u.iter().all(|x| x.is_finite()))
        .ok_or_else(|| Problem::Axis { joint: joint.name.clone(), axis })?;
    Ok(match joint.joint_type {
        JointType::Prismatic => Motion::Slide(unit, drive),
        _ => Motion::Turn(unit, drive),
    })
}

fn pose(pose: &urdf_rs::Pose, place: impl Fn() -> String) -> Result<Pose, Problem> {
    let (xyz, rpy) = (pose.xyz.0, pose.rpy.0);
    if !xyz.iter().all(|x| x.abs() <= LONGEST) {
        return Err(Problem::Number { place: place(), what: "xyz", found: xyz.to_vec() });
    }
    if !rpy.iter().all(|x| x.abs() <= 1e3) {
        return Err(Problem::Number { place: place(), what: "rpy", found: rpy.to_vec() });
    }
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Pose::from_parts(Translation3::from(Point::from(xyz)), rotation))
}

fn solid(
    collision: &urdf_rs::Collision,
    link: &str,
    folder: Option<&Path>,
) -> Result<Solid, Problem> {
    let origin = pose(&collision.origin, || format!("link {link:?}"))?;
    let sizes = |what: &'static str, found: &[f64]| {
        if found.iter().all(|x| *x > 0.0 && *x <= LONGEST) {
            return Ok(());
        }
        Err(Problem::Size { link: link.into(), what, found: found.to_vec() })
    };
    // parry's cylinders and capsules stand along y, those of the URDF along z.
    let upright =
        origin * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    Ok(match &collision.geometry {
        urdf_rs::Geometry::Box { size } => {
            sizes("box", &size.0)?;
            let half = Vector3::from(size.0) / 2.0;
            let shape = cuboid(&half).ok_or_else(|| Problem::Size {
                link: link.into(),
                what: "box",
                found: size.to_vec(),
            })?;
            Solid { origin, shape, radius: half.norm() }
        }
        urdf_rs::Geometry::Cylinder { radius, length } => {
            sizes("cylinder", &[*radius, *length])?;
            let shape = SharedShape::cylinder(length / 2.0, *radius);
            Solid { origin: upright, shape, radius: (length / 2.0).hypot(*radius) }
        }
        urdf_rs::Geometry::Capsule { radius, length } => {
            sizes("capsule", &[*radius, *length])?;
            let shape = SharedShape::capsule_y(length / 2.0, *radius);
            Solid { origin: upright, shape, radius: length / 2.0 + radius }
        }
        urdf_rs::Geometry::Sphere { radius } => {
            sizes("sphere", &[*radius])?;
            Solid { origin, shape: SharedShape::ball(*radius), radius: *radius }
        }
        urdf_rs::Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |s| s.0);
            if !scale.iter().all(|s| s.is_finite() && *s != 0.0) {
                return Err(Problem::Size {
                    link: link.into(),
                    what: "scale",
                    found: scale.into(),
                });
            }
            let file = locate(filename, folder)
                .ok_or_else(|| Problem::Package { link: link.into(), uri: filename.clone() })?;
            let mesh =
                read_mesh(&file).map_err(|source| Problem::Mesh { link: link.into(), source })?;
            let scaled = |v: &Point| Vector::new(v.x * scale[0], v.y * scale[1], v.z * scale[2]);
            let points: Vec<Vector> = mesh.vertices().iter().map(scaled).collect();
            let radius = points.iter().map(|p| p.length()).fold(0.0, f64::max);
            if radius > LONGEST {
                return Err(Problem::Number {
                    place: format!("link {link:?}"),
                    what: "mesh of radius",
                    found: vec![radius],
                });
            }
            let flat = || Problem::Flat { link: link.into(), file: file.clone() };
            if !spans_volume(&points) {
                return Err(flat());
            }
            let shape = SharedShape::convex_hull(&points).ok_or_else(flat)?;
            Solid { origin, shape, radius }
        }
    })
}

/// A box as the hull of its corners: to parry's own boxes [`crate::shape::Mesh::nearest`] has no true
/// distance.
pub(super) fn cuboid(half: &Point) -> Option<SharedShape> {
    let side = |i: usize, axis: usize| if i >> axis & 1 == 1 { half[axis] } else { -half[axis] };
    let corners: Vec<Vector> =
        (0..8).map(|i| Vector::new(side(i, 0), side(i, 1), side(i, 2))).collect();
    SharedShape::convex_hull(&corners)
}

/// Whether the points are no plane: the least of their principal extents is above a hundredth of a
/// millimetre.
fn spans_volume(points: &[Vector]) -> bool {
    let n = points.len().max(1) as f64;
    let mean = points.iter().fold(Point::zeros(), |m, p| m + Point::new(p.x, p.y, p.z)) / n;
    let mut covariance = nalgebra::Matrix3::zeros();
    for p in points {
        let d = Point::new(p.x, p.y, p.z) - mean;
        covariance += d * d.transpose() / n;
    }
    points.len() >= 4 && covariance.symmetric_eigenvalues().min() > 1e-10
}

/// The file that a URDF means: relative to its folder, or in a package that lies there or above.
fn locate(uri: &str, folder: Option<&Path>) -> Option<PathBuf> {
    let here = folder.unwrap_or(Path::new(""));
    let Some(inside) = uri.strip_prefix("package://") else {
        return Some(here.join(uri.strip_prefix("file://").unwrap_or(uri)));
    };
    let (package, rest) = inside.split_once('/')?;
    let here = here.canonicalize().unwrap_or_else(|_| here.into());
    here.ancestors()
        .flat_map(|up| {
            let named = up.file_name().is_some_and(|n| n == package).then(|| up.join(rest));
            named.into_iter().chain([up.join(package).join(rest)])
        })
        .find(|file| file.is_file())
}
