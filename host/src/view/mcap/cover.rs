//! A surface as points: flat faces have few vertices, and not every viewer draws markers.

use crate::shape::Geometry;
use crate::space::Point;

/// About how many points cover a surface, besides its vertices.
const POINTS: f64 = 5_000.0;

/// Points about evenly spread over a shape, its vertices among them, each with its standard deviation
/// between those of the vertices around it; `deviation` tells those (not a number where unknown).
pub(super) fn cover(geometry: &Geometry, deviation: impl Fn(usize) -> f64) -> Vec<(Point, f64)> {
    match geometry {
        Geometry::Outline(outline) => {
            let spacing = outline.perimeter() / POINTS;
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
            // A triangle in n² parts of its own form holds about n²/2 points that no other has.
            let spacing = (2.0 * mesh.area() / POINTS).sqrt();
            let corner = |v: u32| (mesh.vertices()[v as usize], deviation(v as usize));
            let mut points: Vec<_> = (0..mesh.vertices().len() as u32).map(corner).collect();
            for &[a, b, c] in mesh.triangles() {
                let [a, b, c] = [a, b, c].map(corner);
                let longest = [(a, b), (b, c), (c, a)].map(|(p, q)| (q.0 - p.0).norm());
                let steps = steps(longest.into_iter().fold(0.0, f64::max), spacing);
                for row in 1..steps {
                    let share = row as f64 / steps as f64;
                    let (left, right) = (between(a, b, share), between(a, c, share));
                    points.extend((0..=row).map(|k| between(left, right, k as f64 / row as f64)));
                }
                points.extend((1..steps).map(|k| between(b, c, k as f64 / steps as f64)));
            }
            points
        }
    }
}

/// Into how many parts a length is cut, one at least.
fn steps(length: f64, spacing: f64) -> usize {
    ((length / spacing).round() as usize).clamp(1, POINTS as usize)
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
        assert!((2_500..10_000).contains(&points.len()), "{}", points.len());
        assert!(points.iter().all(|(_, d)| *d == 1e-3));
        for probe in [[0.3, 0.2], [0.2, 0.7], [0.99, 0.5]] {
            let probe = Point::new(probe[0], probe[1], 0.0);
            let nearest = points.iter().map(|(p, _)| (p - probe).norm()).fold(1.0, f64::min);
            assert!(nearest < 0.03, "{nearest}");
        }
        assert!(cover(&Geometry::Outline(Outline { loops: vec![] }), |_| 0.0).is_empty());
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
