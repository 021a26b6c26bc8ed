//! The faces of a mesh, with normals that are smooth where the surface is.

use std::collections::BTreeMap;

use crate::shape::Mesh;
use crate::space::Point;

/// Faces that meet at less than 30° are parts of one smooth surface: cosine of that.
const SMOOTH: f64 = 0.866;

/// More faces than this around one corner are not told apart where they look almost the same way.
const MANY: usize = 64;

/// Which is within a step of one over this in each component of the normal: some 4°.
const ALIKE: f64 = 16.0;

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
    for (v, around) in around.iter().enumerate() {
        let ways = ways(around.iter().map(|f| (faces[*f].normal, areas[*f])));
        for &f in around {
            let normal = faces[f].normal;
            let beside = ways.iter().filter(|(way, _)| way.dot(&normal) > SMOOTH);
            let sum: Point = beside.map(|(_, area)| area).sum();
            if let Some(corner) = kept[f].iter().position(|c| *c as usize == v) {
                faces[f].smooth[corner] = sum.try_normalize(0.0).unwrap_or(normal);
            }
        }
    }
    faces
}

/// The ways that faces around one corner look, with the area that looks there: of each face its own, but where
/// they are many, as in a fan, those that look almost the same way are one. Else each would be compared with each.
fn ways(around: impl ExactSizeIterator<Item = (Point, Point)>) -> Vec<(Point, Point)> {
    if around.len() <= MANY {
        return around.collect();
    }
    let mut cells: BTreeMap<[i64; 3], Point> = BTreeMap::new();
    for (normal, area) in around {
        let cell = (normal * ALIKE).map(|x| x.round() as i64);
        *cells.entry(cell.into()).or_default() += area;
    }
    cells.into_values().filter_map(|area| Some((area.try_normalize(0.0)?, area))).collect()
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

    /// A fan of `count` triangles around the origin, whose rim lies `drop` below it.
    fn fan(count: u32, drop: f64) -> Mesh {
        let rim = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
            Point::new(cos, sin, -drop)
        };
        let vertices = [Point::zeros()].into_iter().chain((0..count).map(rim)).collect();
        let triangles = (0..count).map(|i| [0, i + 1, (i + 1) % count + 1]).collect();
        Mesh::new(vertices, triangles).unwrap()
    }

    #[test]
    fn a_corner_of_very_many_faces_is_smooth_as_one_of_few() {
        let many = 200_000;
        for face in faces(&fan(many, 0.0)) {
            assert!(face.smooth.iter().all(|n| (n - Point::z()).norm() < 1e-9));
        }
        let (coarse, fine) = (faces(&fan(50, 1.0)), faces(&fan(many, 1.0)));
        for (i, face) in coarse.iter().enumerate() {
            let same = &fine[i * many as usize / 50 + many as usize / 100];
            let angle = face.smooth[0].angle(&same.smooth[0]).to_degrees();
            assert!(angle < 4.0, "{angle}° at {i}");
        }
    }

    #[test]
    fn triangles_without_area_are_left_out() {
        let line = vec![Point::zeros(), Point::x(), 2.0 * Point::x(), Point::y()];
        let mesh = Mesh::new(line, vec![[0, 1, 2], [0, 0, 3], [0, 1, 3]]).unwrap();
        assert_eq!(faces(&mesh).len(), 1);
    }
}
