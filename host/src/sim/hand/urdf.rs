//! Hands as the URDF describes them: links, the joints between them, and what they are made of.

use std::path::Path;

use nalgebra::{Unit, Vector3};
use parry3d_f64::shape::SharedShape;

use crate::space::Pose;

mod drives;
mod problem;
mod solids;
mod tree;

pub use problem::{HandError, Problem};
pub(super) use solids::cuboid;

/// Lengths beyond this are no hand's, metres.
const LONGEST: f64 = 10.0;

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
        tree::parse(text, folder)
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
