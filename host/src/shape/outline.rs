//! Closed polygons in the plane.

use super::ShapeError;
use crate::space::{Point, Pose};

/// Outlines of up to so many vertices are taken whatever their shape. Larger ones are too, unless most of
/// their edges lie beside each other both in x and in y, as those of a comb that stands askew.
pub const MOST_VERTICES: usize = 20_000;

/// Pairs of edges that are compared at most: all of [`MOST_VERTICES`].
const MOST_PAIRS: usize = MOST_VERTICES * MOST_VERTICES / 2;

/// Simple closed polygons: outer boundaries counter-clockwise, holes clockwise, so that the inside
/// is always on the left of an edge. No loops at all is the outline of nothing.
///
/// Queries take the point's x and y and ignore z.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Each a closed polygon without repeating its first vertex, metres. [`Outline::new`] makes
    /// polygons of unknown origin into this; code that fills it directly must keep the order.
    pub loops: Vec<Vec<[f64; 2]>>,
}

impl Outline {
    /// The outline with these boundaries, in any order and orientation; a boundary inside another
    /// is a hole. Vertices that repeat their predecessor (or close the loop again) are dropped.
    ///
    /// # Errors
    /// When a coordinate is not finite, a loop has fewer than three distinct vertices or no area,
    /// two edges cross, in a vertex or elsewhere, or so many edges lie beside each other, or so many loops,
    /// that finding out would take very long: never with up to [`MOST_VERTICES`] vertices.
    pub fn new(loops: Vec<Vec<[f64; 2]>>) -> Result<Outline, ShapeError> {
        let mut loops = loops;
        let mut flat = None;
        for (number, vertices) in loops.iter_mut().enumerate() {
            if let Some(vertex) = vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
                return Err(ShapeError::Coordinate { vertex });
            }
            vertices.dedup();
            while vertices.len() > 1 && vertices.first() == vertices.last() {
                vertices.pop();
            }
            if vertices.len() < 3 {
                return Err(ShapeError::FewVertices { number, vertices: vertices.len() });
            }
            let extent = vertices.iter().fold(0.0, |e: f64, v| {
                e.max((v[0] - vertices[0][0]).abs()).max((v[1] - vertices[0][1]).abs())
            });
            // Below this the sign of the area is rounding.
            if signed_area(vertices).abs() <= 1e-12 * extent * extent {
                flat = flat.or(Some(number));
            }
        }
        // First, since the areas on both sides of a crossing may cancel.
        check_simple(&loops)?;
        if let Some(number) = flat {
            return Err(ShapeError::NoArea { number });
        }
        let boxes: Vec<[[f64; 2]; 2]> = loops.iter().map(|l| box_of(l)).collect();
        let is_in = |i: usize, j: usize| {
            let ([low, high], [outer_low, outer_high]) = (boxes[i], boxes[j]);
            let fits = (0..2).all(|k| outer_low[k] <= low[k] && high[k] <= outer_high[k]);
            j != i && fits && is_within(&loops[i], &loops[j])
        };
        let depths: Vec<usize> =
            (0..loops.len()).map(|i| (0..loops.len()).filter(|j| is_in(i, *j)).count()).collect();
        for (vertices, depth) in loops.iter_mut().zip(depths) {
            if (signed_area(vertices) > 0.0) != (depth % 2 == 0) {
                vertices.reverse();
            }
        }
        Ok(Outline { loops })
    }

    /// The same shape moved by `pose` (a planar one).
    pub fn transformed(&self, pose: &Pose) -> Outline {
        let moved = |v: &[f64; 2]| {
            let p = pose * nalgebra::Point3::new(v[0], v[1], 0.0);
            [p.x, p.y]
        };
        Outline { loops: self.loops.iter().map(|l| l.iter().map(moved).collect()).collect() }
    }

    /// Unsigned distance from `point` to the boundary, metres; infinite when there is none.
    pub fn distance(&self, point: &Point) -> f64 {
        let p = [point.x, point.y];
        self.edges().map(|(a, b)| squared_distance(p, a, b)).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// The point of the boundary nearest to `point` (z = 0); `point` itself when there is none.
    pub fn closest(&self, point: &Point) -> Point {
        let p = [point.x, point.y];
        let mut nearest = (f64::INFINITY, *point);
        for (a, b) in self.edges() {
            let s = nearest_share(p, a, b);
            let (x, y) = (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]));
            let square = (p[0] - x).powi(2) + (p[1] - y).powi(2);
            if square < nearest.0 {
                nearest = (square, Point::new(x, y, 0.0));
            }
        }
        nearest.1
    }

    /// Distance to the boundary, metres, negative inside.
    pub fn signed_distance(&self, point: &Point) -> f64 {
        let distance = self.distance(point);
        if self.contains(point) { -distance } else { distance }
    }

    /// Whether `point` is inside (even-odd rule: not in a hole).
    pub fn contains(&self, point: &Point) -> bool {
        self.loops.iter().filter(|l| winds_around(l, [point.x, point.y])).count() % 2 == 1
    }

    /// Least and greatest corner of the bounding box; both zero when there is nothing.
    pub fn bounds(&self) -> (Point, Point) {
        super::bounds(self.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)))
    }

    /// `count` points at equal steps of arc length, each with the outward unit normal of its edge;
    /// none when there is no boundary.
    pub fn samples(&self, count: usize) -> Vec<(Point, Point)> {
        let step = self.perimeter() / count as f64;
        let mut samples = Vec::with_capacity(count);
        let mut start = 0.0;
        for (a, b) in self.edges() {
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            while samples.len() < count {
                let along = (samples.len() as f64 + 0.5) * step - start;
                if along >= length {
                    break;
                }
                let s = along / length;
                let p = Point::new(a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), 0.0);
                samples.push((p, normal(a, b)));
            }
            start += length;
        }
        samples
    }

    /// The first hit of the ray from `origin` along the unit `direction` within `reach` metres on
    /// an edge whose outside faces the ray: distance along the ray and outward unit normal there.
    pub fn cast(&self, origin: &Point, direction: &Point, reach: f64) -> Option<(f64, Point)> {
        let (o, d) = ([origin.x, origin.y], [direction.x, direction.y]);
        let mut hit: Option<(f64, Point)> = None;
        for (a, b) in self.edges() {
            let edge = [b[0] - a[0], b[1] - a[1]];
            let facing = cross(d, edge);
            if facing >= 0.0 {
                continue;
            }
            let offset = [a[0] - o[0], a[1] - o[1]];
            let (t, s) = (cross(offset, edge) / facing, cross(offset, d) / facing);
            // Closed at both ends: no ray slips through a vertex.
            let nearer = hit.is_none_or(|(best, _)| t < best);
            if (0.0..=reach).contains(&t) && (0.0..=1.0).contains(&s) && nearer {
                hit = Some((t, normal(a, b)));
            }
        }
        hit
    }

    /// Length of all boundaries, metres.
    pub fn perimeter(&self) -> f64 {
        self.edges().map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
    }

    /// Enclosed area, square metres, holes subtracted.
    pub fn area(&self) -> f64 {
        self.loops.iter().map(|l| signed_area(l)).sum()
    }

    /// Centre of the area; the origin when there is none.
    pub fn centroid(&self) -> Point {
        // Relative to one vertex, so that nothing cancels far from the origin.
        let Some(&[ox, oy]) = self.loops.first().and_then(|l| l.first()) else {
            return Point::zeros();
        };
        let (mut x, mut y, mut twice) = (0.0, 0.0, 0.0);
        for (a, b) in self.edges() {
            let (a, b) = ([a[0] - ox, a[1] - oy], [b[0] - ox, b[1] - oy]);
            let c = cross(a, b);
            x += (a[0] + b[0]) * c;
            y += (a[1] + b[1]) * c;
            twice += c;
        }
        if twice == 0.0 {
            return Point::zeros();
        }
        Point::new(ox + x / (3.0 * twice), oy + y / (3.0 * twice), 0.0)
    }

    /// Every edge in order, from vertex to vertex.
    fn edges(&self) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
        self.loops.iter().flat_map(|l| (0..l.len()).map(move |i| (l[i], l[(i + 1) % l.len()])))
    }
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Outward: to the right of the edge.
fn normal(a: [f64; 2], b: [f64; 2]) -> Point {
    Point::new(b[1] - a[1], a[0] - b[0], 0.0).normalize()
}

/// Positive counter-clockwise, square metres; relative to the first vertex, so that nothing cancels.
pub(super) fn signed_area(vertices: &[[f64; 2]]) -> f64 {
    let from = |v: [f64; 2]| [v[0] - vertices[0][0], v[1] - vertices[0][1]];
    vertices.windows(2).map(|w| cross(from(w[0]), from(w[1]))).sum::<f64>() / 2.0
}

fn squared_distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let s = nearest_share(p, a, b);
    (p[0] - a[0] - s * (b[0] - a[0])).powi(2) + (p[1] - a[1] - s * (b[1] - a[1])).powi(2)
}

/// How far along the edge from `a` (0) to `b` (1) the point nearest to `p` lies.
fn nearest_share(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (edge, to) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = edge[0] * edge[0] + edge[1] * edge[1];
    let s = if length > 0.0 { (to[0] * edge[0] + to[1] * edge[1]) / length } else { 0.0 };
    s.clamp(0.0, 1.0)
}

/// Least and greatest corner of the box about vertices.
fn box_of(vertices: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let around = |[low, high]: [[f64; 2]; 2], v: &[f64; 2]| {
        [[low[0].min(v[0]), low[1].min(v[1])], [high[0].max(v[0]), high[1].max(v[1])]]
    };
    vertices.iter().fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], around)
}

/// Whether a loop lies within another, which it does not cross but may touch: a vertex or the middle of an
/// edge tells that is not on the other's boundary.
fn is_within(inner: &[[f64; 2]], outer: &[[f64; 2]]) -> bool {
    let [low, high] = box_of(outer);
    let touching = 1e-9 * (high[0] - low[0]).max(high[1] - low[1]);
    let next = |vertices: &[[f64; 2]], i: usize| vertices[(i + 1) % vertices.len()];
    let is_off = |p: &[f64; 2]| {
        let mut edges = outer.iter().enumerate().map(|(i, a)| (*a, next(outer, i)));
        edges.all(|(a, b)| squared_distance(*p, a, b) > touching * touching)
    };
    let middle = |(i, a): (usize, &[f64; 2])| {
        let b = next(inner, i);
        [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]
    };
    let mut places = inner.iter().copied().chain(inner.iter().enumerate().map(middle));
    winds_around(outer, places.find(is_off).unwrap_or(inner[0]))
}

/// Whether a ray from `p` along +x crosses the polygon an odd number of times.
pub(super) fn winds_around(vertices: &[[f64; 2]], p: [f64; 2]) -> bool {
    let mut inside = false;
    for (i, b) in vertices.iter().enumerate() {
        let a = vertices[(i + vertices.len() - 1) % vertices.len()];
        if (a[1] > p[1]) != (b[1] > p[1]) {
            let x = a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            inside ^= p[0] < x;
        }
    }
    inside
}

/// An edge with the box around it and the position of its first vertex, counted over all loops.
struct Edge {
    ends: [[f64; 2]; 2],
    /// Where the next edge ends.
    beyond: [f64; 2],
    low: [f64; 2],
    high: [f64; 2],
    first: usize,
}

/// Whether no two edges properly cross, and no boundary another in a vertex. Touching is allowed: contours of
/// a field may meet at a saddle.
fn check_simple(loops: &[Vec<[f64; 2]>]) -> Result<(), ShapeError> {
    let mut edges: Vec<Edge> = Vec::new();
    for l in loops {
        let first = edges.len();
        edges.extend((0..l.len()).map(|i| {
            let [a, b, beyond] = [0, 1, 2].map(|k| l[(i + k) % l.len()]);
            let [low, high] = [f64::min, f64::max].map(|f| [f(a[0], b[0]), f(a[1], b[1])]);
            Edge { ends: [a, b], beyond, low, high, first: first + i }
        }));
    }
    // A sweep along x, or along y where fewer edges lie beside each other: only those are compared.
    let along = |edges: &mut [Edge], axis: usize| -> usize {
        edges.sort_by(|e, f| e.low[axis].total_cmp(&f.low[axis]));
        (0..edges.len()).map(|i| beside(edges, i, axis).len()).sum()
    };
    let pairs = [0, 1].map(|axis| along(&mut edges, axis));
    let axis = usize::from(pairs[1] < pairs[0]);
    // Afterwards every loop is compared with every vertex.
    if pairs[axis].max(loops.len() * edges.len()) > MOST_PAIRS {
        return Err(ShapeError::Intricate { vertices: edges.len(), loops: loops.len() });
    }
    along(&mut edges, axis);
    let parts = |e: &Edge, f: &Edge| side(e.ends, f.ends[0]) * side(e.ends, f.ends[1]) < 0.0;
    let across = 1 - axis;
    for (i, e) in edges.iter().enumerate() {
        for f in beside(&edges, i, axis) {
            let near = e.low[across] <= f.high[across] && f.low[across] <= e.high[across];
            let crosses = || parts(e, f) && parts(f, e) || ends_across(e, f) || ends_across(f, e);
            if near && crosses() {
                let (a, b) = (e.first.min(f.first), e.first.max(f.first));
                return Err(ShapeError::Crossing { a, b });
            }
        }
    }
    Ok(())
}

/// On which side of the line from `a` to `b` a point is: positive on the left.
fn side([a, b]: [[f64; 2]; 2], p: [f64; 2]) -> f64 {
    cross([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]])
}

/// Whether the boundary passes to the other side of `f` in the vertex where `e` ends.
fn ends_across(e: &Edge, f: &Edge) -> bool {
    let ([from, vertex], [start, end]) = (e.ends, f.ends);
    let is_between = || {
        let is_near = (0..2).all(|k| f.low[k] <= vertex[k] && vertex[k] <= f.high[k]);
        is_near && start != vertex && side(f.ends, vertex) == 0.0
    };
    let onward = if end == vertex {
        f.beyond
    } else if is_between() {
        end
    } else {
        return false;
    };
    // Left of the way through the vertex, right of it, or on it.
    let is_left_turn = side([from, vertex], e.beyond) > 0.0;
    let around = |p: [f64; 2]| {
        let (before, after) = (side([from, vertex], p), side([vertex, e.beyond], p));
        if is_left_turn { before.min(after) } else { before.max(after) }
    };
    around(start) * around(onward) < 0.0
}

/// Of edges sorted by their lower ends along an axis, those behind the `i`-th that begin before it ends.
fn beside(edges: &[Edge], i: usize, axis: usize) -> &[Edge] {
    let behind = &edges[i + 1..];
    &behind[..behind.partition_point(|e| e.low[axis] <= edges[i].high[axis])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::planar;
    use proptest::prelude::*;

    fn rectangle() -> Outline {
        Outline::new(vec![vec![[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]])
            .unwrap()
    }

    /// A 4 × 4 square with a 2 × 2 hole, the outer loop given clockwise, the first vertex twice.
    fn ring() -> Outline {
        Outline::new(vec![
            vec![[2.0, 2.0], [2.0, -2.0], [-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0]],
            vec![[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]],
        ])
        .unwrap()
    }

    fn p(x: f64, y: f64) -> Point {
        Point::new(x, y, 0.0)
    }

    #[test]
    fn loops_are_oriented_and_closed_once() {
        let ring = ring();
        assert_eq!(ring.loops[0].len(), 4);
        assert!(signed_area(&ring.loops[0]) > 0.0 && signed_area(&ring.loops[1]) < 0.0);
        assert!((ring.area() - 12.0).abs() < 1e-12);
        assert!((ring.perimeter() - 24.0).abs() < 1e-12);
        assert!(ring.centroid().norm() < 1e-12);
    }

    #[test]
    fn distances_of_a_rectangle() {
        let r = rectangle();
        assert!((r.signed_distance(&p(0.0, 0.0)) + 0.03).abs() < 1e-15);
        assert!((r.signed_distance(&p(0.09, 0.07)) - 0.05).abs() < 1e-15);
        assert!((r.distance(&p(0.05, 0.01)) - 0.01).abs() < 1e-15);
        assert!(r.contains(&p(0.059, 0.029)) && !r.contains(&p(0.061, 0.0)));
        let (low, high) = r.bounds();
        assert_eq!((low, high), (p(-0.06, -0.03), p(0.06, 0.03)));
    }

    #[test]
    fn a_hole_is_outside_and_its_normals_point_into_it() {
        let ring = ring();
        assert!(!ring.contains(&p(0.0, 0.0)) && ring.contains(&p(1.5, 0.0)));
        assert!((ring.signed_distance(&p(0.2, 0.0)) - 0.8).abs() < 1e-12);
        for (at, normal) in ring.samples(96) {
            assert!(ring.contains(&(at - 1e-6 * normal)) && !ring.contains(&(at + 1e-6 * normal)));
        }
    }

    #[test]
    fn rays_stop_at_sides_that_face_them() {
        let r = rectangle();
        let (t, n) = r.cast(&p(0.2, 0.01), &p(-1.0, 0.0), 1.0).unwrap();
        assert!((t - 0.14).abs() < 1e-12 && (n - p(1.0, 0.0)).norm() < 1e-12);
        assert!(r.cast(&p(0.2, 0.01), &p(-1.0, 0.0), 0.13).is_none());
        assert!(r.cast(&p(0.2, 0.04), &p(-1.0, 0.0), 1.0).is_none());
        assert!(r.cast(&p(0.0, 0.0), &p(-1.0, 0.0), 1.0).is_none(), "from inside");
        let (t, _) = ring().cast(&p(0.0, 0.0), &p(0.0, 1.0), 9.0).unwrap();
        assert!((t - 1.0).abs() < 1e-12, "from the hole");
        let corner = p(-1.0, -1.0).normalize();
        assert!(r.cast(&(p(0.06, 0.03) - corner), &corner, 2.0).is_some(), "through a vertex");
    }

    #[test]
    fn nothing_is_infinitely_far() {
        let nothing = Outline::new(vec![]).unwrap();
        assert_eq!(nothing.distance(&p(0.0, 0.0)), f64::INFINITY);
        assert_eq!(nothing.signed_distance(&p(0.0, 0.0)), f64::INFINITY);
        assert!(nothing.samples(10).is_empty() && !nothing.contains(&p(0.0, 0.0)));
        assert!(nothing.cast(&p(0.0, 0.0), &p(1.0, 0.0), 1.0).is_none());
        assert_eq!(nothing.bounds(), (Point::zeros(), Point::zeros()));
    }

    #[test]
    fn what_is_no_polygon_is_refused() {
        let new = |l: &[[f64; 2]]| Outline::new(vec![l.to_vec()]);
        let bad = new(&[[0.0, 0.0], [1.0, f64::NAN], [0.0, 1.0]]);
        assert!(matches!(bad, Err(ShapeError::Coordinate { vertex: 1 })), "{bad:?}");
        let bad = new(&[[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 0.0]]);
        assert!(matches!(bad, Err(ShapeError::FewVertices { vertices: 2, .. })), "{bad:?}");
        let bad = new(&[[0.0, 0.0], [0.1, 0.3], [0.2, 0.6]]);
        assert!(matches!(bad, Err(ShapeError::NoArea { number: 0 })), "{bad:?}");
        let bow = new(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]);
        assert!(matches!(bow, Err(ShapeError::Crossing { a: 0, b: 2 })), "{bow:?}");
        let bad = new(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.2]]);
        assert!(matches!(bad, Err(ShapeError::Crossing { a: 0, b: 2 })), "{bad:?}");
    }

    #[test]
    fn boundaries_may_meet_in_a_vertex_and_not_cross_there() {
        let new = |l: &[[f64; 2]]| Outline::new(vec![l.to_vec()]);
        // Two triangles with a tip in common, around both in turn and around one of them the wrong way.
        let [a, b, tip, c, d] = [[-1.0, -1.0], [-1.0, 1.0], [0.0, 0.0], [2.0, 1.0], [2.0, -1.0]];
        let meeting = new(&[a, tip, d, c, tip, b]).unwrap();
        assert!((meeting.area() - 3.0).abs() < 1e-12);
        let bow = new(&[a, tip, c, d, tip, b]);
        assert!(matches!(bow, Err(ShapeError::Crossing { a: 0, b: 3 })), "{bow:?}");
        // A vertex in the middle of an edge, from one side to the other and back from it.
        let through = new(&[[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [2.0, 0.0], [1.0, -2.0]]);
        assert!(matches!(through, Err(ShapeError::Crossing { .. })), "{through:?}");
        let dent = new(&[[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [2.0, 0.0], [0.0, 1.0]]).unwrap();
        assert!((dent.area() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_hole_may_touch_what_it_is_in() {
        let square = |half: f64| vec![[half, half], [-half, half], [-half, -half], [half, -half]];
        // From each of its corners on, which are on the boundary or not.
        for first in 0..4 {
            let mut hole = vec![[2.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, -1.0]];
            hole.rotate_left(first);
            let outline = Outline::new(vec![square(2.0), hole]).unwrap();
            assert!((outline.area() - 14.0).abs() < 1e-12, "{first}: {}", outline.area());
        }
        // All of its corners.
        let diamond = vec![[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, -2.0]];
        let outline = Outline::new(vec![diamond, square(2.0)]).unwrap();
        assert!((outline.area() - 8.0).abs() < 1e-12);
        // Beside each other, with a side in common.
        let beside = square(2.0).iter().map(|[x, y]| [x + 4.0, *y]).collect();
        assert!((Outline::new(vec![square(2.0), beside]).unwrap().area() - 32.0).abs() < 1e-12);
    }

    /// A line that goes to and fro, `width` wide, `count` times, and back on the left.
    fn comb(count: usize, width: f64) -> Vec<[f64; 2]> {
        let tooth = |i: usize| [if i.is_multiple_of(2) { 0.0 } else { width }, i as f64];
        let back = [[-1.0, count as f64], [-1.0, -1.0]];
        (0..count).map(tooth).chain(back).collect()
    }

    #[test]
    fn long_outlines_are_taken_where_few_edges_lie_beside_each_other() {
        for turned in [false, true] {
            let turn = |[x, y]: [f64; 2]| if turned { [-y, x] } else { [x, y] };
            let mut vertices: Vec<[f64; 2]> = comb(200_000, 1e3).into_iter().map(turn).collect();
            assert_eq!(Outline::new(vec![vertices.clone()]).unwrap().loops[0].len(), 200_002);
            vertices.swap(100_000, 100_002);
            let crossed = Outline::new(vec![vertices]);
            assert!(
                matches!(crossed, Err(ShapeError::Crossing { a: 99_999..100_003, .. })),
                "{crossed:?}"
            );
        }
    }

    #[test]
    fn what_cannot_be_checked_in_time_is_refused() {
        let askew = |count: usize| {
            comb(count, 1e6).into_iter().map(|[x, y]| [x - y, x + y]).collect::<Vec<_>>()
        };
        assert!(Outline::new(vec![askew(2_000)]).is_ok());
        let error = Outline::new(vec![askew(100_000)]).unwrap_err();
        assert_eq!(error, ShapeError::Intricate { vertices: 100_002, loops: 1 });
        assert!(error.to_string().contains("expected at most 20000"), "{error}");
        let triangle = |i: usize| vec![[i as f64, 0.0], [i as f64 + 0.5, 0.0], [i as f64, 0.5]];
        let many = Outline::new((0..30_000).map(triangle).collect());
        assert_eq!(many, Err(ShapeError::Intricate { vertices: 90_000, loops: 30_000 }));
    }

    proptest! {
        #[test]
        fn samples_lie_on_the_boundary_and_rays_find_them(
            x in -0.2..0.2, y in -0.2..0.2, turn in -4.0..4.0, count in 1usize..60,
            radii in proptest::collection::vec(0.02..0.09, 3..12),
        ) {
            let n = radii.len() as f64;
            let vertices = radii.iter().enumerate().map(|(i, r)| {
                let (s, c) = (std::f64::consts::TAU * i as f64 / n).sin_cos();
                [r * c, r * s]
            });
            let outline = Outline::new(vec![vertices.collect()]).unwrap();
            let pose = planar(x, y, turn);
            let moved = outline.transformed(&pose);
            prop_assert!((moved.area() - outline.area()).abs() < 1e-12);
            let samples = moved.samples(count);
            prop_assert_eq!(samples.len(), count);
            for (at, normal) in samples {
                prop_assert!(moved.distance(&at) < 1e-12);
                prop_assert!((normal.norm() - 1.0).abs() < 1e-12);
                // The last metre of a ray along the inward normal ends no later than here.
                let (t, _) = moved.cast(&(at + normal), &-normal, 2.0).unwrap();
                prop_assert!(t < 1.0 + 1e-9);
                prop_assert!(moved.distance(&(at + normal * (1.0 - t))) < 1e-9);
            }
            let probe = Point::new(x, -y, 0.0);
            let there = pose * nalgebra::Point3::from(probe);
            let difference = moved.signed_distance(&there.coords) - outline.signed_distance(&probe);
            prop_assert!(difference.abs() < 1e-12);
        }

        #[test]
        fn samples_are_even(count in 4usize..200) {
            let samples = rectangle().samples(count);
            let upper = samples.iter().filter(|(_, n)| n.y > 0.5).count() as f64;
            prop_assert!((upper - count as f64 / 3.0).abs() <= 1.0);
        }
    }
}
