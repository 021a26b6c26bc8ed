//! What is around a hand, and how far its links are from it.

use nalgebra::Point3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::{ClosestPoints, closest_points};
use parry3d_f64::shape::SupportMap;

use super::urdf::Link;
use crate::shape::Mesh;
use crate::shape::mesh::parry;
use crate::space::{Point, Pose};

/// Nearer than this is contact where things are as they are, metres.
const TOUCHING: f64 = 4e-5;

/// What a hand can run into.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The object, and where it is (object to world). Only a mesh's outside can be told from its inside,
    /// so that an object without inside (not watertight) is a shell.
    pub object: Option<(&'a Mesh, Pose)>,
    /// Height of the table's top, metres: all of the world with a smaller z is table.
    pub table: Option<f64>,
    /// Nearer than this is contact, metres. Where the object is only believed to be there more is no
    /// less true, and takes fewer steps.
    pub touching: f64,
}

/// How near a link is to the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Metres; 0 when they meet.
    pub distance: f64,
    /// The nearest point of the object's surface, object frame.
    pub point: Point,
    /// Out of the object towards the link, unit, object frame.
    pub normal: Point,
}

impl<'a> Surroundings<'a> {
    /// Things as they are: contact is contact.
    pub fn new(object: Option<(&'a Mesh, Pose)>, table: Option<f64>) -> Surroundings<'a> {
        Surroundings { object, table, touching: TOUCHING }
    }

    /// How near a link at `pose` (link to world) is to the object; `None` when it is further than
    /// `within` metres.
    pub fn object_near(&self, link: &Link, pose: &Pose, within: f64) -> Option<Near> {
        let (mesh, object) = self.object?;
        let frame = object.inverse() * pose;
        let mut nearest: Option<Near> = None;
        for solid in &link.solids {
            let at = frame * solid.origin;
            // A ball around the solid, first: most links are far away.
            let middle = at.translation.vector;
            let reach = nearest.map_or(within, |n| n.distance.min(within));
            if mesh.distance(&middle) > reach + solid.radius {
                continue;
            }
            let Some((point, other)) = mesh.nearest(&*solid.shape, &at, reach) else { continue };
            let apart = other - point;
            let outwards = || {
                // They meet: away from the surface at the middle of the solid.
                let inside = mesh.signed_distance(&middle).is_some_and(|d| d < 0.0);
                let away = middle - mesh.closest(&middle);
                (if inside { -away } else { away }).try_normalize(0.0)
            };
            let normal = apart.try_normalize(1e-9).or_else(outwards).unwrap_or_else(Point::z);
            let near = Near { distance: apart.norm(), point, normal };
            if nearest.is_none_or(|n| near.distance < n.distance) {
                nearest = Some(near);
            }
        }
        nearest
    }

    /// How far a link at `pose` (link to world) is from the object at least, by the balls around its solids,
    /// metres; may be below zero. Infinite without object or solids.
    pub fn apart(&self, link: &Link, pose: &Pose) -> f64 {
        let Some((mesh, object)) = self.object else { return f64::INFINITY };
        let frame = object.inverse() * pose;
        let balls = link.solids.iter().map(|s| ((frame * s.origin).translation.vector, s.radius));
        balls.map(|(at, radius)| mesh.distance(&at) - radius).fold(f64::INFINITY, f64::min)
    }

    /// Whether a link lies within the object, at least its middle.
    pub fn inside_object(&self, link: &Link, pose: &Pose) -> bool {
        let Some((mesh, object)) = self.object else { return false };
        let frame = object.inverse() * pose;
        link.solids.iter().any(|solid| {
            let middle = (frame * solid.origin).translation.vector;
            mesh.signed_distance(&middle).is_some_and(|d| d < 0.0)
        })
    }

    /// How far above the table the lowest point of a link at `pose` (link to world) is, metres; infinite
    /// without a table.
    pub fn above_table(&self, link: &Link, pose: &Pose) -> f64 {
        let Some(height) = self.table else { return f64::INFINITY };
        let lowest = link.solids.iter().map(|solid| lowest(solid, &(pose * solid.origin)));
        lowest.fold(f64::INFINITY, f64::min) - height
    }
}

fn lowest(solid: &super::urdf::Solid, pose: &Pose) -> f64 {
    let down = pose.rotation.inverse() * -Point::z();
    let Some(shape) = solid.shape.as_support_map() else {
        return pose.translation.z - solid.radius;
    };
    let p = SupportMap::local_support_point(shape, Vector::new(down.x, down.y, down.z));
    (pose * Point3::new(p.x, p.y, p.z)).z
}

/// The distance between two links, metres, 0 when they meet; `None` when it is above `within`.
pub fn links_near(
    (a, at_a): (&Link, &Pose),
    (b, at_b): (&Link, &Pose),
    within: f64,
) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for one in &a.solids {
        let pose_one = at_a * one.origin;
        for other in &b.solids {
            let pose_other = at_b * other.origin;
            let middles = pose_one.translation.vector - pose_other.translation.vector;
            let reach = nearest.map_or(within, |n| n.min(within));
            if middles.norm() - one.radius - other.radius > reach {
                continue;
            }
            let (p, q) = (parry(&pose_one), parry(&pose_other));
            let distance = match closest_points(&p, &*one.shape, &q, &*other.shape, reach) {
                Ok(ClosestPoints::WithinMargin(x, y)) => (x - y).length(),
                Ok(ClosestPoints::Intersecting) => 0.0,
                Ok(ClosestPoints::Disjoint) | Err(_) => continue,
            };
            nearest = Some(nearest.map_or(distance, |n| n.min(distance)));
        }
    }
    nearest
}
