//! The faces of a mesh, with normals that are smooth where the surface is.

use crate::shape::Mesh;
use crate::space::Point;

/// Faces that meet at less than 30° are parts of one smooth surface: cosine of that.
const SMOOTH: f64 = 0.866;

/// A triangle with an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Counter-clockwise seen from outside, metres.
    pub corners: [Point; 3],
    /// Unit vector, outward.
    pub normal: Point,
    /// Normal at each corner: the mean, by area, over the faces there that continue this one
    /// smoothly. Those of a scan jump from face to face, the surface does not.
    smooth: [Point; 3],
}

/// The triangles of `mesh` that have an area.
pub fn faces(mesh: &Mesh) -> Vec<Face> {
    let mut faces = Vec::with_capacity(mesh.triangles().len());
    let mut areas = Vec::with_capacity(mesh.triangles().len());
    let mut around: Vec<Vec<usize>> = vec![Vec::new(); mesh.vertices().len()];
    let mut kept = Vec::with_capacity(mesh.triangles().len());
    for triangle in mesh.triangles() {
        let corners = triangle.map(|v| mesh.vertices()[v as usize]);
        let [a, b, c] = corners;
        let area = (b - a).cross(&(c - a));
        if let Some(normal) = area.try_normalize(0.0) {
            for v in triangle {
                around[*v as usize].push(faces.len());
            }
            faces.push(Face { corners, normal, smooth: [normal; 3] });
            areas.push(area);
            kept.push(triangle);
        }
    }
    for k in 0..faces.len() {
        let normal = faces[k].normal;
        faces[k].smooth = kept[k].map(|v| {
            let beside =
                around[v as usize].iter().filter(|f| faces[**f].normal.dot(&normal) > SMOOTH);
            let sum: Point = beside.map(|f| areas[*f]).sum();
            sum.try_normalize(0.0).unwrap_or(normal)
        });
    }
    faces
}

impl Face {
    /// The outward unit normal of the surface at a point of the triangle.
    pub fn normal_at(&self, p: &Point) -> Point {
        let [a, b, c] = self.corners;
        let part = |u: &Point, v: &Point| (u - p).cross(&(v - p)).dot(&self.normal);
        let [x, y, z] = self.smooth;
        (x * part(&b, &c) + y * part(&c, &a) + z * part(&a, &b))
            .try_normalize(0.0)
            .unwrap_or(self.normal)
    }

    /// The nearest point of the triangle (Ericson 2005, 5.1.5).
    pub fn closest(&self, p: &Point) -> Point {
        let [a, b, c] = self.corners;
        let (ab, ac, ap) = (b - a, c - a, p - a);
        let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return a;
        }
        let bp = p - b;
        let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
        if d3 >= 0.0 && d4 <= d3 {
            return b;
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return a + ab * (d1 / (d1 - d3));
        }
        let cp = p - c;
        let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
        if d6 >= 0.0 && d5 <= d6 {
            return c;
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return a + ac * (d2 / (d2 - d6));
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
        }
        let whole = va + vb + vc;
        a + ab * (vb / whole) + ac * (vc / whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::mesh::tests::cuboid;

    #[test]
    fn edges_stay_sharp_and_facets_become_round() {
        for face in faces(&cuboid([0.05; 3])) {
            assert_eq!(face.smooth, [face.normal; 3]);
        }
        // Two strips that meet at 20°.
        let tilt = 20f64.to_radians();
        let [up, down] = [[0.1, 0.0], [0.1 * tilt.cos(), -0.1 * tilt.sin()]];
        let at = |y: f64, [x, z]: [f64; 2]| Point::new(x, y, z);
        let vertices = vec![
            at(0.0, [0.0, 0.0]),
            at(1.0, [0.0, 0.0]),
            at(0.0, [-up[0], up[1]]),
            at(1.0, [-up[0], up[1]]),
            at(0.0, down),
            at(1.0, down),
        ];
        let triangles = vec![[0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1]];
        let faces = faces(&Mesh::new(vertices, triangles).unwrap());
        let between = faces[0].normal_at(&Point::new(0.0, 0.5, 0.0));
        assert!((between - faces[3].normal_at(&Point::new(0.0, 0.5, 0.0))).norm() < 1e-9);
        let angle = between.angle(&faces[0].normal);
        assert!((angle - tilt / 2.0).abs() < 0.06, "{angle}");
        let far = faces[1].normal_at(&Point::new(-0.1, 0.0, 0.0));
        assert!((far - faces[1].normal).norm() < 1e-9);
    }

    #[test]
    fn triangles_without_area_are_left_out() {
        let line = vec![Point::zeros(), Point::x(), 2.0 * Point::x(), Point::y()];
        let mesh = Mesh::new(line, vec![[0, 1, 2], [0, 0, 3], [0, 1, 3]]).unwrap();
        assert_eq!(faces(&mesh).len(), 1);
    }
}
