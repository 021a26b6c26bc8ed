//! The distance to a mesh, exact, from its tree of boxes.

use super::{Near, Surface};
use crate::shape::Mesh;
use crate::space::Point;

/// A mesh that has an area, with its faces' normals.
pub struct Exact<'a> {
    mesh: &'a Mesh,
    normals: Vec<Point>,
}

impl<'a> Exact<'a> {
    /// `None` when the mesh has no area.
    pub fn new(mesh: &'a Mesh) -> Option<Exact<'a>> {
        let normal = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.vertices()[v as usize]);
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default()
        };
        let normals: Vec<Point> = mesh.triangles().iter().map(normal).collect();
        (mesh.area() > 0.0 && mesh.nearest(&Point::zeros()).is_some())
            .then_some(Exact { mesh, normals })
    }
}

impl Surface for Exact<'_> {
    fn near(&self, point: &Point) -> Near {
        let (closest, place) = self.mesh.nearest(point).unwrap_or((*point, 0));
        let away = point - closest;
        let distance = away.norm();
        let mut near = Near { distance, gradient: away / distance, place };
        if distance < 1e-9 {
            // On the surface the distance grows along the normal.
            near.gradient = self.normal(&near);
        }
        near
    }

    fn normal(&self, near: &Near) -> Point {
        self.normals.get(near.place).copied().unwrap_or_default()
    }
}
