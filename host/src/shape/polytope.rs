//! Convex shapes with sharp corners: the intersection of half-spaces, as an outline or a mesh whose
//! vertices are exactly where the planes meet.

use std::collections::HashMap;

use super::{Geometry, Mesh, Outline};
use crate::reference::faces::{Face, Faces};
use crate::space::Point;

/// A closed convex shape.
#[derive(Clone, Debug)]
pub struct Polytope {
    /// Outline, or watertight mesh with outward triangles.
    pub geometry: Geometry,
    /// Standard deviation of each vertex along the mean of the normals that meet there, metres.
    pub deviations: Vec<f64>,
}

/// Which plane a facet or edge lies in: a face, or a side of the region that was started from.
type Plane = Option<usize>;

/// Intersects the half-spaces n·p ≤ ρ of the faces. `None` when they leave the shape open (it would
/// reach further than `reach` metres from `centre`) or when nothing is inside all of them.
pub fn intersect(faces: &Faces, centre: &Point, reach: f64) -> Option<Polytope> {
    if !(reach > 0.0 && reach.is_finite() && centre.iter().all(|x| x.is_finite())) {
        return None;
    }
    if faces.dimension == 2 {
        polygon(&faces.faces, centre, reach)
    } else {
        polyhedron(&faces.faces, centre, reach)
    }
}

/// A vertex moves by e_j along the normal of each plane j that meets there, so along their sum m by
/// Σe_j/|m|.
fn deviation(faces: &[Face], meeting: &[usize], vertex: &Point) -> f64 {
    let sum: Point = meeting.iter().map(|j| faces[*j].normal).sum();
    let variance: f64 = meeting.iter().map(|j| faces[*j].variance(vertex)).sum();
    variance.sqrt() / sum.norm().max(1e-6)
}

/// The share of the way from a (inside, value ≤ 0) to b (outside) at which the value is zero.
fn crossing(a: Point, value_a: f64, b: Point, value_b: f64) -> Point {
    a + (b - a) * (value_a / (value_a - value_b))
}

fn polygon(faces: &[Face], centre: &Point, reach: f64) -> Option<Polytope> {
    // Vertices with the plane of the edge that starts there.
    let corner = |x: f64, y: f64| (centre + Point::new(x, y, 0.0) * reach, None);
    let mut ring: Vec<(Point, Plane)> =
        vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    for (number, face) in faces.iter().enumerate() {
        let mut kept = Vec::with_capacity(ring.len() + 1);
        for (i, (a, plane)) in ring.iter().enumerate() {
            let (b, _) = ring[(i + 1) % ring.len()];
            let (value_a, value_b) = (face.value(a), face.value(&b));
            match (value_a <= 0.0, value_b <= 0.0) {
                (true, true) => kept.push((*a, *plane)),
                (true, false) => {
                    kept.push((*a, *plane));
                    kept.push((crossing(*a, value_a, b, value_b), Some(number)));
                }
                (false, true) => kept.push((crossing(b, value_b, *a, value_a), *plane)),
                (false, false) => {}
            }
        }
        ring = kept;
    }
    let planes: Vec<usize> = ring.iter().map(|(_, plane)| *plane).collect::<Option<_>>()?;
    let outline = Outline::new(vec![ring.iter().map(|(p, _)| [p.x, p.y]).collect()]).ok()?;
    // Where vertices coincided, the outline has fewer.
    let vertices = outline.loops.first()?;
    let deviations = vertices
        .iter()
        .map(|v| {
            let at = ring.iter().position(|(p, _)| [p.x, p.y] == *v)?;
            let before = planes[(at + planes.len() - 1) % planes.len()];
            let meeting =
                if before == planes[at] { vec![before] } else { vec![before, planes[at]] };
            Some(deviation(faces, &meeting, &Point::new(v[0], v[1], 0.0)))
        })
        .collect::<Option<_>>()?;
    Some(Polytope { geometry: Geometry::Outline(outline), deviations })
}

/// A face of the polyhedron: its plane and its vertices counter-clockwise seen from outside.
type Facet = (Plane, Vec<usize>);

fn polyhedron(faces: &[Face], centre: &Point, reach: f64) -> Option<Polytope> {
    let mut vertices: Vec<Point> = (0..8)
        .map(|i| {
            let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
            centre + Point::new(sign(1), sign(2), sign(4)) * reach
        })
        .collect();
    let mut facets: Vec<Facet> =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
            .into_iter()
            .map(|f| (None, f.to_vec()))
            .collect();
    for (number, face) in faces.iter().enumerate() {
        cut(&mut vertices, &mut facets, number, face);
    }
    if facets.len() < 4 || facets.iter().any(|(plane, _)| plane.is_none()) {
        return None;
    }
    let mut renamed: HashMap<usize, u32> = HashMap::new();
    let mut used: Vec<Point> = Vec::new();
    let mut meeting: Vec<Vec<usize>> = Vec::new();
    let mut triangles = Vec::new();
    for (plane, corners) in &facets {
        let corners: Vec<u32> = corners
            .iter()
            .map(|v| {
                *renamed.entry(*v).or_insert_with(|| {
                    used.push(vertices[*v]);
                    meeting.push(Vec::new());
                    used.len() as u32 - 1
                })
            })
            .collect();
        for c in &corners {
            meeting[*c as usize].extend(plane);
        }
        triangles.extend((2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]));
    }
    let deviations = used.iter().zip(&meeting).map(|(v, m)| deviation(faces, m, v)).collect();
    let mesh = Mesh::new(used, triangles).ok()?;
    mesh.is_watertight().then_some(Polytope { geometry: Geometry::Mesh(mesh), deviations })
}

/// Takes away what is outside `face`. Each edge that is cut gets one new vertex, shared by the two
/// facets along it, so the surface stays closed whatever rounding does.
fn cut(vertices: &mut Vec<Point>, facets: &mut Vec<Facet>, number: usize, face: &Face) {
    let values: Vec<f64> = vertices.iter().map(|v| face.value(v)).collect();
    if !facets.iter().flat_map(|(_, f)| f).any(|v| values[*v] > 0.0) {
        return;
    }
    let mut cuts: HashMap<(usize, usize), usize> = HashMap::new();
    // From where the new facet's boundary continues to where.
    let mut next: HashMap<usize, usize> = HashMap::new();
    for (_, corners) in facets.iter_mut() {
        let mut kept = Vec::with_capacity(corners.len() + 1);
        let (mut leaves, mut enters) = (None, None);
        for (i, &a) in corners.iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            let (inside_a, inside_b) = (values[a] <= 0.0, values[b] <= 0.0);
            if inside_a {
                kept.push(a);
            }
            if inside_a != inside_b {
                let (inner, outer) = if inside_a { (a, b) } else { (b, a) };
                let new = *cuts.entry((inner, outer)).or_insert_with(|| {
                    let (p, q) = (vertices[inner], vertices[outer]);
                    vertices.push(crossing(p, values[inner], q, values[outer]));
                    vertices.len() - 1
                });
                kept.push(new);
                *(if inside_a { &mut leaves } else { &mut enters }) = Some(new);
            }
        }
        if let (Some(leaves), Some(enters)) = (leaves, enters) {
            next.insert(enters, leaves);
        }
        *corners = kept;
    }
    facets.retain(|(_, corners)| corners.len() > 2);
    let Some(&first) = next.keys().min() else { return };
    let mut ring = vec![first];
    while let Some(&v) = ring.last().and_then(|last| next.get(last)) {
        if v == first || ring.len() > next.len() {
            break;
        }
        ring.push(v);
    }
    facets.push((Some(number), ring));
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    fn face(normal: Point, offset: f64) -> Face {
        Face {
            normal,
            offset,
            centroid: normal * offset,
            offset_variance: 1e-6,
            normal_covariance: Matrix3::zeros(),
            contacts: 3,
        }
    }

    fn of(dimension: usize, faces: Vec<Face>) -> Faces {
        Faces { dimension, faces, chi_squared: 0.0, degrees: 1.0, bending: 0.0, protrusion: 0.0 }
    }

    fn sides(half: &[f64]) -> Vec<Face> {
        let axis = |i: usize, sign: f64| {
            let mut n = Point::zeros();
            n[i] = sign;
            face(n, half[i])
        };
        (0..half.len()).flat_map(|i| [axis(i, 1.0), axis(i, -1.0)]).collect()
    }

    #[test]
    fn rectangles_and_boxes_are_exact() {
        let rectangle = intersect(&of(2, sides(&[0.06, 0.03])), &Point::zeros(), 0.2).unwrap();
        let Geometry::Outline(outline) = &rectangle.geometry else { panic!() };
        assert_eq!(outline.loops[0].len(), 4);
        assert!((outline.area() - 0.12 * 0.06).abs() < 1e-15);
        // Two independent millimetres over |n₁ + n₂| = √2.
        assert!(rectangle.deviations.iter().all(|d| (d - 1e-3).abs() < 1e-12));

        let cuboid = intersect(&of(3, sides(&[0.06, 0.03, 0.02])), &Point::zeros(), 0.2).unwrap();
        let Geometry::Mesh(mesh) = &cuboid.geometry else { panic!() };
        assert_eq!((mesh.vertices().len(), mesh.triangles().len()), (8, 12));
        assert!(mesh.is_watertight());
        assert!((mesh.volume() - 0.12 * 0.06 * 0.04).abs() < 1e-12);
        for v in mesh.vertices() {
            assert!((v.abs() - Point::new(0.06, 0.03, 0.02)).norm() < 1e-12);
        }
    }

    #[test]
    fn what_is_open_or_empty_is_refused() {
        let open = sides(&[0.06, 0.03])[..3].to_vec();
        assert!(intersect(&of(2, open), &Point::zeros(), 0.2).is_none());
        let open = sides(&[0.06, 0.03, 0.02])[..5].to_vec();
        assert!(intersect(&of(3, open), &Point::zeros(), 0.2).is_none());
        assert!(intersect(&of(2, sides(&[0.06, -0.03])), &Point::zeros(), 0.2).is_none());
        assert!(intersect(&of(3, sides(&[0.06, 0.03, -0.02])), &Point::zeros(), 0.2).is_none());
        assert!(intersect(&of(2, sides(&[0.06, 0.03])), &Point::zeros(), f64::NAN).is_none());
        assert!(intersect(&of(3, vec![]), &Point::zeros(), 0.2).is_none());
    }

    proptest! {
        /// Tangent planes of a sphere, well spread or not: where they close, the mesh is closed,
        /// outward, inside every half-space, and each vertex lies on three planes.
        #[test]
        fn tangent_planes_make_closed_meshes(
            normals in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 4..40),
        ) {
            let faces: Vec<Face> = normals
                .into_iter()
                .filter_map(|n| Some(face(Point::from(n).try_normalize(0.1)?, 0.05)))
                .collect();
            let faces = of(3, faces);
            if let Some(shape) = intersect(&faces, &Point::new(0.001, 0.0, 0.0), 0.5) {
                let Geometry::Mesh(mesh) = &shape.geometry else { panic!() };
                prop_assert!(mesh.is_watertight());
                prop_assert!(mesh.volume() > 4.0 / 3.0 * std::f64::consts::PI * 0.05f64.powi(3));
                prop_assert_eq!(mesh.vertices().len() as isize - mesh.triangles().len() as isize / 2, 2);
                for v in mesh.vertices() {
                    let on = faces.faces.iter().filter(|f| f.value(v).abs() < 1e-9).count();
                    prop_assert!(on >= 3 && faces.active(v).unwrap().0 < 1e-9);
                }
                prop_assert!(shape.deviations.iter().all(|d| d.is_finite() && *d > 0.0));
            }
        }
    }
}
