//! The distance to a mesh, exact, from a tree of boxes.

use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};

use super::faces::Face;
use super::{Near, Surface};
use crate::space::Point;

/// Faces, ready to be asked. The tree knows no inside, which would take longer to find out than a
/// whole search takes.
pub struct Exact {
    tree: TriMesh,
    faces: Vec<Face>,
}

impl Exact {
    /// `None` without faces.
    pub fn new(faces: Vec<Face>) -> Option<Exact> {
        let vertices: Vec<Vector> =
            faces.iter().flat_map(|f| f.corners).map(|p| vector(&p)).collect();
        let triangles = (0..faces.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let tree = TriMesh::with_flags(vertices, triangles, TriMeshFlags::empty()).ok()?;
        Some(Exact { tree, faces })
    }
}

impl Surface for Exact {
    fn near(&self, point: &Point) -> Near {
        let (found, (triangle, _)) =
            self.tree.project_local_point_and_get_location(vector(point), false);
        let away = point - Point::new(found.point.x, found.point.y, found.point.z);
        let distance = away.norm();
        let place = triangle as usize;
        let mut near = Near { distance, gradient: away / distance, place };
        if distance < 1e-9 {
            // On the surface the distance grows along the normal.
            near.gradient = self.faces.get(place).map_or(Point::zeros(), |f| f.normal);
        }
        near
    }

    fn normal(&self, near: &Near, point: &Point) -> Point {
        let closest = point - near.gradient * near.distance;
        self.faces.get(near.place).map_or(Point::zeros(), |f| f.normal_at(&closest))
    }
}

fn vector(p: &Point) -> Vector {
    Vector::new(p.x, p.y, p.z)
}
