//! Triangle meshes.

use std::collections::HashMap;
use std::sync::OnceLock;

use parry3d_f64::math::Vector;
use parry3d_f64::query::{ClosestPoints, PointQuery, Ray, RayCullingMode, closest_points};
use parry3d_f64::shape::{Shape, TriMesh, TriMeshFlags};

use super::ShapeError;
use crate::space::{Point, Pose};

/// Indexed triangles, counter-clockwise seen from outside. No triangles at all is the mesh of
/// nothing.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    vertices: Vec<Point>,
    triangles: Vec<[u32; 3]>,
    /// The tree for queries, built at the first one; `None` when there are no triangles.
    tree: OnceLock<Option<Box<TriMesh>>>,
}

/// Edges at which a mesh is no closed surface with one side out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flaws {
    /// Edges of a single triangle.
    pub open: usize,
    /// Edges between two triangles of which one shows its outside where the other shows its inside.
    pub turned: usize,
    /// Edges of more than two triangles, or from a vertex to itself.
    pub crowded: usize,
}

impl Flaws {
    /// How many edges these are.
    pub fn count(&self) -> usize {
        self.open + self.turned + self.crowded
    }
}

impl Mesh {
    /// The mesh of these vertices (metres) and triangles (indices into them), kept as given.
    ///
    /// # Errors
    /// When a coordinate is not finite or an index is out of range.
    pub fn new(vertices: Vec<Point>, triangles: Vec<[u32; 3]>) -> Result<Mesh, ShapeError> {
        if let Some(vertex) = vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            return Err(ShapeError::Coordinate { vertex });
        }
        let outside = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= vertices.len());
        if let Some(triangle) = triangles.iter().position(outside) {
            return Err(ShapeError::Index { triangle, vertices: vertices.len() });
        }
        Ok(Mesh { vertices, triangles, tree: OnceLock::new() })
    }

    /// The mesh of vertices and triangles that are valid by construction.
    pub(super) fn trusted(vertices: Vec<Point>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh { vertices, triangles, tree: OnceLock::new() }
    }

    /// Metres.
    pub fn vertices(&self) -> &[Point] {
        &self.vertices
    }

    /// Indices into [`Mesh::vertices`].
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The same shape moved by `pose`.
    pub fn transformed(&self, pose: &Pose) -> Mesh {
        let vertices = self.vertices.iter().map(|v| pose.rotation * v + pose.translation.vector);
        Mesh {
            vertices: vertices.collect(),
            triangles: self.triangles.clone(),
            tree: OnceLock::new(),
        }
    }

    /// Unsigned distance from `point` to the surface, metres; infinite when there is none.
    pub fn distance(&self, point: &Point) -> f64 {
        self.tree()
            .map_or(f64::INFINITY, |tree| tree.distance_to_local_point(glam(point), false).abs())
    }

    /// The point of the surface nearest to `point`; `point` itself when there is none.
    pub fn closest(&self, point: &Point) -> Point {
        self.tree().map_or(*point, |tree| {
            let found = tree.project_local_point(glam(point), false).point;
            Point::new(found.x, found.y, found.z)
        })
    }

    /// Distance to the surface, metres, negative inside; `None` when the mesh is not watertight
    /// and so has no inside.
    pub fn signed_distance(&self, point: &Point) -> Option<f64> {
        let tree = self.tree().filter(|t| t.flags().contains(TriMeshFlags::ORIENTED))?;
        Some(tree.distance_to_local_point(glam(point), false))
    }

    /// Least and greatest corner of the bounding box; both zero when there is nothing.
    pub fn bounds(&self) -> (Point, Point) {
        super::bounds(self.triangles.iter().flatten().map(|&v| self.vertices[v as usize]))
    }

    /// `count` points spread evenly over the area, each with the outward unit normal of its face;
    /// none when there is no area.
    pub fn samples(&self, count: usize) -> Vec<(Point, Point)> {
        let sample = |(triangle, [s, t, u]): (usize, [f64; 3])| {
            let [a, b, c] = self.triangles[triangle].map(|v| self.vertices[v as usize]);
            let normal = (b - a).cross(&(c - a));
            (a * s + b * t + c * u, normal / normal.norm())
        };
        self.places(count).into_iter().map(sample).collect()
    }

    /// Where [`Mesh::samples`] are: in which triangle, and the shares of its corners in the point.
    /// Equal strips of the accumulated area each give one point, placed in its triangle by a
    /// low-discrepancy sequence.
    pub fn places(&self, count: usize) -> Vec<(usize, [f64; 3])> {
        let total = self.area();
        let mut places = Vec::with_capacity(count);
        let mut accumulated = 0.0;
        for (triangle, [a, b, c]) in self.faces().enumerate() {
            let area = (b - a).cross(&(c - a)).norm() / 2.0;
            accumulated += area;
            while area > 0.0
                && places.len() < count
                && (places.len() as f64 + 0.5) / count as f64 * total <= accumulated
            {
                let (u, v) = plastic(places.len());
                let root = u.sqrt();
                places.push((triangle, [1.0 - root, root * (1.0 - v), root * v]));
            }
        }
        places
    }

    /// The first hit of the ray from `origin` along the unit `direction` within `reach` metres on
    /// a face whose outside faces the ray: distance along the ray and outward unit normal there.
    pub fn cast(&self, origin: &Point, direction: &Point, reach: f64) -> Option<(f64, Point)> {
        let ray = Ray::new(glam(origin), glam(direction));
        let tree = self.tree()?;
        let hit = tree.cast_local_ray_with_culling(&ray, reach, RayCullingMode::IgnoreBackfaces)?;
        let normal = Point::new(hit.normal.x, hit.normal.y, hit.normal.z);
        Some((hit.time_of_impact, normal.try_normalize(0.0)?))
    }

    /// The nearest points of the surface and of a convex body at `pose` (body to mesh frame), mesh frame;
    /// `None` when they are more than `within` metres apart. Where the two meet, both are the point of the
    /// surface nearest to the body's middle. A body that lies inside meets nothing.
    ///
    /// The body must not be parry's cuboid, whose distance from a triangle is only an estimate there (the
    /// hull of its corners has a true one).
    pub fn nearest(&self, body: &dyn Shape, pose: &Pose, within: f64) -> Option<(Point, Point)> {
        let tree = self.tree()?;
        let origin = parry3d_f64::math::Pose::IDENTITY;
        match closest_points(&origin, tree, &parry(pose), body, within) {
            Ok(ClosestPoints::WithinMargin(a, b)) => {
                Some((Point::new(a.x, a.y, a.z), Point::new(b.x, b.y, b.z)))
            }
            Ok(ClosestPoints::Intersecting) => {
                let middle = body.compute_aabb(&parry(pose)).center();
                let at = self.closest(&Point::new(middle.x, middle.y, middle.z));
                Some((at, at))
            }
            Ok(ClosestPoints::Disjoint) | Err(_) => None,
        }
    }

    /// Whether every edge is shared by exactly two triangles that run it in opposite directions:
    /// a closed, consistently oriented surface. False for the mesh of nothing.
    pub fn is_watertight(&self) -> bool {
        !self.triangles.is_empty() && self.flaws() == Flaws::default()
    }

    /// The edges at which it is no closed, consistently oriented surface.
    pub fn flaws(&self) -> Flaws {
        let mut edges: HashMap<(u32, u32), [u32; 2]> = HashMap::new();
        for t in &self.triangles {
            for i in 0..3 {
                let (from, to) = (t[i], t[(i + 1) % 3]);
                let ways = edges.entry((from.min(to), from.max(to))).or_default();
                ways[usize::from(from > to)] += 1;
            }
        }
        let mut flaws = Flaws::default();
        for ((from, to), ways) in edges {
            match ways {
                [1, 1] if from != to => {}
                [1, 0] | [0, 1] => flaws.open += 1,
                [2, 0] | [0, 2] => flaws.turned += 1,
                _ => flaws.crowded += 1,
            }
        }
        flaws
    }

    /// Surface area, square metres.
    pub fn area(&self) -> f64 {
        self.faces().map(|[a, b, c]| (b - a).cross(&(c - a)).norm() / 2.0).sum()
    }

    /// Of each vertex, the angles of the triangles that meet there, together; radians. 2π where the surface is
    /// flat, less at a convex corner.
    pub fn angles(&self) -> Vec<f64> {
        let mut angles = vec![0.0; self.vertices.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|i| self.vertices[i as usize]);
            for (i, [at, to, and]) in [[a, b, c], [b, c, a], [c, a, b]].into_iter().enumerate() {
                angles[t[i] as usize] += (to - at).angle(&(and - at));
            }
        }
        angles
    }

    /// Enclosed volume, cubic metres: positive for outward faces, without meaning when the mesh is
    /// not watertight.
    pub fn volume(&self) -> f64 {
        self.moments().0
    }

    /// Centre of the enclosed volume; of the surface's area when the mesh is not watertight; the
    /// origin when there is neither.
    pub fn centroid(&self) -> Point {
        if self.is_watertight() {
            let (volume, first) = self.moments();
            let (low, high) = self.bounds();
            // Of a closed surface without thickness it is rounding.
            if volume.abs() > 1e-12 * (high - low).norm().powi(3) {
                return self.vertices[0] + first / volume;
            }
        }
        let area = self.area();
        if area == 0.0 {
            return Point::zeros();
        }
        let weighted =
            |[a, b, c]: [Point; 3]| (a + b + c) * ((b - a).cross(&(c - a)).norm() / (6.0 * area));
        self.faces().map(weighted).fold(Point::zeros(), |sum, x| sum + x)
    }

    /// The corners of every triangle.
    fn faces(&self) -> impl Iterator<Item = [Point; 3]> + '_ {
        self.triangles.iter().map(|t| t.map(|v| self.vertices[v as usize]))
    }

    /// Volume and its first moment about the first vertex (so that nothing cancels), from the
    /// tetrahedra that the faces span with it.
    fn moments(&self) -> (f64, Point) {
        let Some(&origin) = self.vertices.first() else { return (0.0, Point::zeros()) };
        self.faces().fold((0.0, Point::zeros()), |(volume, first), corners| {
            let [a, b, c] = corners.map(|p| p - origin);
            let part = a.dot(&b.cross(&c)) / 6.0;
            (volume + part, first + (a + b + c) * (part / 4.0))
        })
    }

    fn tree(&self) -> Option<&TriMesh> {
        let build = || {
            // Only a watertight mesh has the pseudo-normals that tell inside from outside.
            let flags =
                if self.is_watertight() { TriMeshFlags::ORIENTED } else { TriMeshFlags::empty() };
            let vertices = self.vertices.iter().map(glam).collect();
            TriMesh::with_flags(vertices, self.triangles.clone(), flags).ok().map(Box::new)
        };
        self.tree.get_or_init(build).as_deref()
    }
}

fn glam(p: &Point) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

/// The pose as parry has it.
pub fn parry(pose: &Pose) -> parry3d_f64::math::Pose {
    let q = pose.rotation.quaternion();
    parry3d_f64::math::Pose::from_parts(
        glam(&pose.translation.vector),
        parry3d_f64::math::Rotation::from_xyzw(q.i, q.j, q.k, q.w),
    )
}

/// The n-th point of the additive recurrence of the plastic number in the unit square.
pub(super) fn plastic(n: usize) -> (f64, f64) {
    const RATIO: f64 = 1.324_717_957_244_746;
    let n = n as f64;
    ((0.5 + n / RATIO).fract(), (0.5 + n / (RATIO * RATIO)).fract())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The box of these half extents, outward.
    pub(crate) fn cuboid(half: [f64; 3]) -> Mesh {
        let vertices = (0..8).map(|i| {
            let side = |bit: usize| if i >> bit & 1 == 1 { half[bit] } else { -half[bit] };
            Point::new(side(0), side(1), side(2))
        });
        let quads: [[u32; 4]; 6] =
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        Mesh::new(vertices.collect(), triangles.collect()).unwrap()
    }

    /// How many pairs of neighbouring triangles lie on one another; slivers do not count.
    pub(crate) fn folds(mesh: &Mesh) -> usize {
        let normal = |[a, b, c]: [Point; 3]| (b - a).cross(&(c - a));
        let normals: Vec<Point> = mesh.faces().map(normal).collect();
        let mut areas: Vec<f64> = normals.iter().map(Point::norm).collect();
        areas.sort_by(f64::total_cmp);
        let least = 1e-4 * areas[areas.len() / 2];
        let mut sides = HashMap::new();
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            for i in 0..3 {
                sides.insert((triangle[i], triangle[(i + 1) % 3]), t);
            }
        }
        let is_folded = |((a, b), t): (&(u32, u32), &usize)| {
            let [one, other] = [normals[*t], normals[sides[&(*b, *a)]]];
            a < b
                && one.norm().min(other.norm()) > least
                && one.normalize().dot(&other.normalize()) < -0.95
        };
        sides.iter().filter(|side| is_folded(*side)).count()
    }

    /// Signed distance to a box, from its definition.
    fn exact(half: [f64; 3], p: &Point) -> f64 {
        let q = [p.x.abs() - half[0], p.y.abs() - half[1], p.z.abs() - half[2]];
        let outside: f64 = q.iter().map(|x| x.max(0.0).powi(2)).sum();
        outside.sqrt() + q.iter().cloned().fold(f64::MIN, f64::max).min(0.0)
    }

    #[test]
    fn measures_of_a_box() {
        let mesh = cuboid([0.06, 0.03, 0.02]);
        assert!(mesh.is_watertight());
        assert!((mesh.volume() - 0.12 * 0.06 * 0.04).abs() < 1e-15);
        let area = 2.0 * (0.12 * 0.06 + 0.12 * 0.04 + 0.06 * 0.04);
        assert!((mesh.area() - area).abs() < 1e-15);
        let right = 1.5 * std::f64::consts::PI;
        assert!(mesh.angles().iter().all(|angle| (angle - right).abs() < 1e-12));
        let pose = Pose::new(Point::new(1.0, -2.0, 3.0), Point::new(0.3, 0.2, -0.1));
        let centre = mesh.transformed(&pose).centroid();
        assert!((centre - Point::new(1.0, -2.0, 3.0)).norm() < 1e-12);
        let (low, high) = mesh.bounds();
        assert_eq!((low, high), (Point::new(-0.06, -0.03, -0.02), Point::new(0.06, 0.03, 0.02)));
    }

    #[test]
    fn samples_cover_faces_by_area_and_corners_too() {
        let half = [0.06, 0.03, 0.02];
        let mesh = cuboid(half);
        let samples = mesh.samples(900);
        assert_eq!(samples.len(), 900);
        let share = |normal: Point| {
            samples.iter().filter(|(_, n)| (n - normal).norm() < 1e-9).count() as f64 / 900.0
        };
        assert!((share(Point::z()) - 0.25).abs() < 0.01);
        assert!((share(-Point::x()) - 1.0 / 12.0).abs() < 0.01);
        for (p, n) in &samples {
            assert!(mesh.distance(p) < 1e-12);
            assert!(exact(half, &(p + 1e-6 * n)) > 0.0);
        }
        // Evenness within a face: each quarter of the top has its share, none is far from a sample.
        let top: Vec<_> = samples.iter().filter(|(_, n)| n.z > 0.5).map(|s| s.0).collect();
        let quarter = top.iter().filter(|p| p.x > 0.0 && p.y > 0.0).count() as f64;
        assert!((quarter / top.len() as f64 - 0.25).abs() < 0.04);
        for corner in mesh.vertices().iter().filter(|v| v.z > 0.0) {
            let nearest = top.iter().map(|p| (p - corner).norm()).fold(f64::MAX, f64::min);
            assert!(nearest < 0.012, "{nearest}");
        }
    }

    #[test]
    fn an_open_mesh_has_distances_but_no_inside() {
        let mesh = cuboid([0.06, 0.03, 0.02]);
        let open = Mesh::new(mesh.vertices().to_vec(), mesh.triangles()[1..].to_vec()).unwrap();
        assert_eq!(open.flaws(), Flaws { open: 3, ..Flaws::default() });
        assert!(!open.is_watertight());
        assert_eq!(open.signed_distance(&Point::zeros()), None);
        assert!((open.distance(&Point::zeros()) - 0.02).abs() < 1e-12);
        let mut turned = mesh.triangles().to_vec();
        turned[3].swap(0, 1);
        let turned = Mesh::new(mesh.vertices().to_vec(), turned).unwrap();
        assert_eq!(turned.flaws(), Flaws { turned: 3, ..Flaws::default() });
        assert!(!turned.is_watertight());
        let twice = [mesh.triangles(), &mesh.triangles()[..1], &[[0, 0, 1]]].concat();
        let twice = Mesh::new(mesh.vertices().to_vec(), twice).unwrap();
        assert!(twice.flaws().crowded >= 4 && !twice.is_watertight(), "{:?}", twice.flaws());
    }

    #[test]
    fn nothing_is_infinitely_far() {
        let nothing = Mesh::new(vec![], vec![]).unwrap();
        assert_eq!(nothing.distance(&Point::zeros()), f64::INFINITY);
        assert!(nothing.samples(5).is_empty() && !nothing.is_watertight());
        assert!(nothing.cast(&Point::zeros(), &Point::x(), 1.0).is_none());
        assert_eq!(nothing.centroid(), Point::zeros());
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        let bad = Mesh::new(vec![Point::zeros(); 3], vec![[0, 1, 3]]);
        assert!(matches!(bad, Err(ShapeError::Index { triangle: 0, vertices: 3 })), "{bad:?}");
        let bad = Mesh::new(vec![Point::new(0.0, f64::INFINITY, 0.0)], vec![]);
        assert!(matches!(bad, Err(ShapeError::Coordinate { vertex: 0 })), "{bad:?}");
    }

    proptest! {
        #[test]
        fn distances_are_those_of_the_box(
            x in -0.1..0.1, y in -0.1..0.1, z in -0.1..0.1,
            turn in prop::array::uniform3(-2.0..2.0), shift in prop::array::uniform3(-0.5..0.5),
        ) {
            let half = [0.06, 0.03, 0.02];
            let mesh = cuboid(half);
            let p = Point::new(x, y, z);
            let expected = exact(half, &p);
            prop_assert!((mesh.signed_distance(&p).unwrap() - expected).abs() < 1e-9);
            prop_assert!((mesh.distance(&p) - expected.abs()).abs() < 1e-9);
            let pose = Pose::new(Point::from(shift), Point::from(turn));
            let there = (pose * nalgebra::Point3::from(p)).coords;
            let moved = mesh.transformed(&pose);
            prop_assert!((moved.signed_distance(&there).unwrap() - expected).abs() < 1e-9);
        }

        #[test]
        fn rays_end_on_the_surface_and_before_anything_else(
            origin in prop::array::uniform3(-0.2..0.2), target in prop::array::uniform3(-0.9..0.9),
        ) {
            let half = [0.06, 0.03, 0.02];
            let mesh = cuboid(half);
            let origin = Point::from(origin);
            let aim = Point::new(target[0] * half[0], target[1] * half[1], target[2] * half[2]);
            prop_assume!((aim - origin).norm() > 1e-3);
            let direction = (aim - origin).normalize();
            let hit = mesh.cast(&origin, &direction, 1.0);
            prop_assert_eq!(hit.is_some(), exact(half, &origin) > 0.0);
            if let Some((t, normal)) = hit {
                let at = origin + t * direction;
                prop_assert!(exact(half, &at).abs() < 1e-9);
                prop_assert!(normal.dot(&direction) < 0.0);
                prop_assert!(exact(half, &(at + 1e-6 * normal)) > 0.0);
                prop_assert!(exact(half, &(origin + 0.5 * t * direction)) > 0.0);
                prop_assert!(mesh.cast(&origin, &direction, 0.99 * t).is_none());
            }
        }
    }
}
