//! A surface as points: flat faces have few vertices, and not every viewer draws markers.

use crate::shape::Geometry;
use crate::space::Point;

/// About how many points cover a surface, besides its vertices.
const POINTS: usize = 5_000;

/// Points about evenly spread over a shape, its vertices among them, each with its standard deviation
/// between those of the vertices around it; `deviation` tells those (not a number where unknown).
pub(super) fn cover(geometry: &Geometry, deviation: impl Fn(usize) -> f64) -> Vec<(Point, f64)> {
    match geometry {
        Geometry::Outline(outline) => {
            let spacing = outline.perimeter() / POINTS as f64;
            let mut points = Vec::new();
            let mut first = 0;
            for vertices in &outline.loops {
                let count = vertices.len();
                let corner = |i: usize| {
                    let [x, y] = vertices[i % count];
                    (Point::new(x, y, 0.0), deviation(first + i % count))
                };
                for i in 0..count {
                    let (from, to) = (corner(i), corner(i + 1));
                    let steps = steps((to.0 - from.0).norm(), spacing);
                    points.extend((0..steps).map(|k| between(from, to, k as f64 / steps as f64)));
                }
                first += count;
            }
            points
        }
        Geometry::Mesh(mesh) => {
            // By area, so that needles get no more than their share.
            let corner = |v: u32| (mesh.vertices()[v as usize], deviation(v as usize));
            let vertices = (0..mesh.vertices().len() as u32).map(corner);
            let places = mesh.places(POINTS).into_iter().map(|(triangle, shares)| {
                let corners = mesh.triangles()[triangle].map(corner).into_iter().zip(shares);
                corners.fold((Point::zeros(), 0.0), |(at, spread), ((p, deviation), share)| {
                    (at + p * share, spread + deviation * share)
                })
            });
            vertices.chain(places).collect()
        }
    }
}

/// Into how many parts a length is cut, one at least.
fn steps(length: f64, spacing: f64) -> usize {
    ((length / spacing).round() as usize).clamp(1, POINTS)
}

/// Between `from` (0) and `to` (1).
fn between(from: (Point, f64), to: (Point, f64), share: f64) -> (Point, f64) {
    // An end keeps its deviation where the other's is unknown.
    let deviation = if share == 0.0 { from.1 } else { from.1 + (to.1 - from.1) * share };
    (from.0 + (to.0 - from.0) * share, deviation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Mesh, Outline};

    #[test]
    fn a_square_is_covered_evenly_with_deviations_between_its_corners() {
        let corners = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let square = Geometry::Outline(Outline::new(vec![corners]).unwrap());
        let points = cover(&square, |vertex| vertex as f64);
        assert_eq!(points.len(), 5_000);
        assert!(points.iter().all(|(p, _)| square.distance(p) < 1e-12));
        let (p, deviation) = points[1_250 + 625];
        assert!((p - Point::new(1.0, 0.5, 0.0)).norm() < 1e-12 && (deviation - 1.5).abs() < 1e-12);
    }

    #[test]
    fn a_face_is_covered_and_a_fine_mesh_gets_little_more_than_its_vertices() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let face = |triangles| Mesh::new(corners.map(Point::from).to_vec(), triangles).unwrap();
        let square = Geometry::Mesh(face(vec![[0, 1, 2], [0, 2, 3]]));
        let points = cover(&square, |_| 1e-3);
        assert_eq!(points.len(), 4 + POINTS);
        assert!(points.iter().all(|(_, d)| (d - 1e-3).abs() < 1e-12));
        for probe in [[0.3, 0.2], [0.2, 0.7], [0.99, 0.5]] {
            let probe = Point::new(probe[0], probe[1], 0.0);
            let nearest = points.iter().map(|(p, _)| (p - probe).norm()).fold(1.0, f64::min);
            assert!(nearest < 0.03, "{nearest}");
        }
        assert!(cover(&Geometry::Outline(Outline { loops: vec![] }), |_| 0.0).is_empty());
    }

    #[test]
    fn a_rod_of_needles_gets_no_more_points_than_a_box() {
        // 180 sides of 0.2 by 600 mm.
        let sides = 180;
        let corner = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i / 2) / 180.0).sin_cos();
            Point::new(0.005 * cos, 0.005 * sin, if i.is_multiple_of(2) { 0.0 } else { 0.6 })
        };
        let side = |i: u32| {
            let [a, b] = [2 * i, 2 * ((i + 1) % sides)];
            [[a, b, b + 1], [a, b + 1, a + 1]]
        };
        let corners = (0..2 * sides).map(corner).collect();
        let rod = Mesh::new(corners, (0..sides).flat_map(side).collect()).unwrap();
        let points = cover(&Geometry::Mesh(rod), |vertex| (vertex % 2) as f64);
        assert_eq!(points.len(), 360 + POINTS);
        assert!(points.iter().all(|(p, d)| (p.z / 0.6 - d).abs() < 1e-9), "between the ends");
        for tenth in 0..10 {
            let low = 0.06 * f64::from(tenth);
            let here = points[360..].iter().filter(|(p, _)| (low..low + 0.06).contains(&p.z));
            let count = here.count();
            assert!((450..550).contains(&count), "{count} from {low} m");
        }
    }

    #[test]
    fn what_is_unknown_stays_with_its_vertex() {
        let corners = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let shape = Geometry::Outline(Outline::new(vec![corners]).unwrap());
        let points = cover(&shape, |vertex| if vertex == 1 { f64::NAN } else { 1.0 });
        assert_eq!(points[0].1, 1.0);
        assert!(points[1].1.is_nan());
        assert_eq!(points.last().unwrap().1, 1.0);
    }
}
