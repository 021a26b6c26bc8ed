//! Shapes as geometry: outlines and meshes, extracted from an implicit surface or given as truth,
//! and the distances between them.

pub mod align;
pub mod arrangement;
pub mod boundary;
pub mod cloud;
pub mod contour;
pub mod files;
pub mod lattice;
mod mend;
pub mod mesh;
pub mod metrics;
pub mod min_cut;
pub mod nagata;
mod near;
pub mod occupancy;
pub mod outline;
pub mod polytope;
mod settle;
mod sharpen;
mod sheets;
pub mod superquadric;
pub mod surface;
pub mod symmetry;

pub use mesh::{Flaws, Mesh};
pub use outline::Outline;

use crate::space::{Point, Pose};

/// A shape in one frame, metres: closed polygons in the plane, or a triangle mesh.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Dimension 2.
    Outline(Outline),
    /// Dimension 3.
    Mesh(Mesh),
}

/// A scalar field with f > 0 outside the object, f < 0 inside, scaled as a signed distance in
/// metres near the surface. Planar fields ignore z.
pub trait Field: Sync {
    /// Value at each point, metres.
    fn values(&self, points: &[Point]) -> Vec<f64>;
    /// Standard deviation of the surface's position along its normal near each point, metres.
    fn deviations(&self, points: &[Point]) -> Vec<f64>;
    /// Value, metres, and gradient at each point. Fields without a formula of their own take
    /// differences over `step` metres to both sides.
    fn first_order(&self, points: &[Point], step: f64) -> Vec<(f64, Point)> {
        let ends = |p: &Point| {
            let p = *p;
            let beside = (0..3).flat_map(move |axis| {
                let mut aside = Point::zeros();
                aside[axis] = step;
                [p + aside, p - aside]
            });
            beside.chain([p])
        };
        let around: Vec<Point> = points.iter().flat_map(ends).collect();
        let values = self.values(&around);
        let one = |f: &[f64]| {
            let across = Point::new(f[0] - f[1], f[2] - f[3], f[4] - f[5]);
            (f[6], across / (2.0 * step))
        };
        values.chunks_exact(7).map(one).collect()
    }
}

impl Geometry {
    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        match self {
            Geometry::Outline(_) => 2,
            Geometry::Mesh(_) => 3,
        }
    }

    /// All vertices, metres: of an outline loop after loop, in the plane z = 0.
    pub fn vertices(&self) -> Vec<Point> {
        match self {
            Geometry::Outline(outline) => {
                outline.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect()
            }
            Geometry::Mesh(mesh) => mesh.vertices().to_vec(),
        }
    }

    /// Outward unit normal at each of the [`vertices`](Geometry::vertices), the mean of those that meet there, weighed
    /// by length or area; zero where they cancel.
    pub fn normals(&self) -> Vec<Point> {
        let mut sums = match self {
            Geometry::Outline(outline) => {
                outline.loops.iter().flat_map(|l| corner_normals(l)).collect()
            }
            Geometry::Mesh(mesh) => {
                let vertices = mesh.vertices();
                let mut sums = vec![Point::zeros(); vertices.len()];
                for triangle in mesh.triangles() {
                    let [a, b, c] = triangle.map(|v| vertices[v as usize]);
                    let normal = (b - a).cross(&(c - a));
                    triangle.iter().for_each(|v| sums[*v as usize] += normal);
                }
                sums
            }
        };
        for sum in &mut sums {
            *sum = sum.try_normalize(0.0).unwrap_or_default();
        }
        sums
    }

    /// The same shape moved by `pose`.
    pub fn transformed(&self, pose: &Pose) -> Geometry {
        match self {
            Geometry::Outline(o) => Geometry::Outline(o.transformed(pose)),
            Geometry::Mesh(m) => Geometry::Mesh(m.transformed(pose)),
        }
    }

    /// The middle of the area or volume inside.
    pub fn centroid(&self) -> Point {
        match self {
            Geometry::Outline(o) => o.centroid(),
            Geometry::Mesh(m) => m.centroid(),
        }
    }

    /// How much surface there is: the length of an outline, metres, or the area of a mesh, square metres.
    pub fn size(&self) -> f64 {
        match self {
            Geometry::Outline(o) => o.perimeter(),
            Geometry::Mesh(m) => m.area(),
        }
    }

    /// Unsigned distance from `point` to the surface, metres.
    pub fn distance(&self, point: &Point) -> f64 {
        match self {
            Geometry::Outline(o) => o.distance(point),
            Geometry::Mesh(m) => m.distance(point),
        }
    }

    /// The point of the surface nearest to `point`; `point` itself when there is no surface.
    pub fn closest(&self, point: &Point) -> Point {
        match self {
            Geometry::Outline(o) => o.closest(point),
            Geometry::Mesh(m) => m.closest(point),
        }
    }

    /// Least and greatest corner of the axis-aligned bounding box.
    pub fn bounds(&self) -> (Point, Point) {
        match self {
            Geometry::Outline(o) => o.bounds(),
            Geometry::Mesh(m) => m.bounds(),
        }
    }

    /// About `count` points spread evenly over the surface, each with its outward unit normal;
    /// the same points on every call.
    pub fn samples(&self, count: usize) -> Vec<(Point, Point)> {
        match self {
            Geometry::Outline(o) => o.samples(count),
            Geometry::Mesh(m) => m.samples(count),
        }
    }

    /// The first hit of the ray from `origin` along the unit `direction` within `reach` metres, on
    /// a side that faces the ray: distance along the ray and outward unit normal there.
    pub fn cast(&self, origin: &Point, direction: &Point, reach: f64) -> Option<(f64, Point)> {
        match self {
            Geometry::Outline(o) => o.cast(origin, direction, reach),
            Geometry::Mesh(m) => m.cast(origin, direction, reach),
        }
    }
}

/// At each corner of a loop the sum of the normals of both edges, as long as these.
fn corner_normals(corners: &[[f64; 2]]) -> Vec<Point> {
    let count = corners.len();
    let beside = |i: usize| (corners[(i + count - 1) % count], corners[(i + 1) % count]);
    // Both edges turned by a quarter are the way between their far ends turned so.
    let normal = |i: usize| {
        let (before, after) = beside(i);
        Point::new(after[1] - before[1], before[0] - after[0], 0.0)
    };
    (0..count).map(normal).collect()
}

/// Why vertices do not make a shape.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ShapeError {
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex}: coordinates must be finite")]
    Coordinate {
        /// Which, from 0 (in its loop).
        vertex: usize,
    },
    /// A polygon needs three corners.
    #[error("loop {number}: {vertices} distinct vertices, a polygon needs at least 3")]
    FewVertices {
        /// Which loop, from 0.
        number: usize,
        /// How many there are.
        vertices: usize,
    },
    /// All vertices on one line.
    #[error("loop {number}: the vertices lie on one line and enclose no area")]
    NoArea {
        /// Which loop, from 0.
        number: usize,
    },
    /// The polygon is not simple.
    #[error("the edges that start at vertices {a} and {b} cross, expected a simple polygon")]
    Crossing {
        /// The first vertex of one edge, counted from 0 over all loops.
        a: usize,
        /// The first vertex of the other.
        b: usize,
    },
    /// Whether the polygon is simple cannot be told in reasonable time.
    #[error(
        "{vertices} vertices in {loops} loops, expected at most {} of so intricate a shape",
        outline::MOST_VERTICES
    )]
    Intricate {
        /// Over all loops.
        vertices: usize,
        /// How many loops there are.
        loops: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names a vertex that is not among the {vertices}")]
    Index {
        /// Which triangle, from 0.
        triangle: usize,
        /// How many vertices there are.
        vertices: usize,
    },
}

/// Least and greatest corner of the box around the points; both zero when there are none.
fn bounds(points: impl Iterator<Item = Point>) -> (Point, Point) {
    points
        .map(|p| (p, p))
        .reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)))
        .unwrap_or((Point::zeros(), Point::zeros()))
}
