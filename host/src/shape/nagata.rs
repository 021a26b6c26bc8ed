//! Nagata patches: a surface through the contacts, bent by their normals.
//!
//! Between two contacts runs the quadratic curve that is perpendicular to both normals and bends
//! least; three such curves bound the quadratic patch of thesis 2.2 (Nagata 2005). The
//! patches need a triangulation: contacts are seen from their mean, in the plane in order of
//! angle, in space as the convex hull of the directions (the Delaunay triangulation of the sphere).
//! So the shape is taken to be star-shaped about that mean, and what nobody touched is closed by
//! patches from the nearest contacts. The surface passes through every contact, noise and
//! all; of contacts within three deviations of each other, through their mean.

use std::collections::HashMap;

use super::{Geometry, Mesh, Outline};
use crate::reference::Contact;
use crate::space::{Point, centroid};

/// Straight pieces along each edge of a patch.
const PIECES: usize = 6;

/// Pieces of a planar curve.
const PLANAR_PIECES: usize = 16;

/// Contacts within this many point deviations of one another are one vertex: the direction from one
/// to the other is noise.
const APART: f64 = 3.0;

/// A curve bends away from its chord by at most half the chord: the corner of an equilateral
/// triangle needs 0.43. A quarter of the bend c.
const MOST_BEND: f64 = 2.0;

/// Where a curve starts or ends nearly across its chord, its normal contradicts the chord: this part
/// of the chord may be taken back by the bend.
const FORWARDS: f64 = 0.95;

/// Normals closer than this to parallel (one less their cosine squared) leave the curve open.
const PARALLEL: f64 = 1e-4;

/// Contacts that are triangulated at most: the effort grows with the square.
const MOST_CONTACTS: usize = 5000;

/// Why contacts give no surface.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Neither planar nor spatial.
    #[error("the dimension must be 2 or 3, not {0}")]
    Dimension(usize),
    /// A number of a contact is unusable.
    #[error("contact {index}: {what}")]
    Contact {
        /// Counted from 0.
        index: usize,
        /// What is wrong and what was expected.
        what: &'static str,
    },
    /// Too few for a closed shape.
    #[error("{distinct} contacts at distinct places: a closed shape needs at least {needed}")]
    Few {
        /// Contacts further apart than their noise.
        distinct: usize,
        /// 3 in the plane, 4 in space.
        needed: usize,
    },
    /// Too many to triangulate.
    #[error("{0} contacts are more than are triangulated ({MOST_CONTACTS})")]
    Many(usize),
    /// Seen from their mean, all on one circle or line.
    #[error("the contacts enclose nothing: seen from their mean they lie on one line or circle")]
    Flat,
}

/// A place to interpolate, and its normal where one was felt.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    point: Point,
    normal: Option<Point>,
}

/// The closed surface of Nagata patches through contacts: an outline or a watertight mesh. Contacts
/// closer together than their noise become one; edges whose normals are missing, nearly parallel or
/// contradict the edge are straight.
///
/// ```
/// use tactile_host::reference::Contact;
/// use tactile_host::shape::{Geometry, nagata};
/// use tactile_host::space::Point;
///
/// // Four touches of a circle of 40 mm radius.
/// let contacts = [Point::x(), Point::y(), -Point::x(), -Point::y()].map(|normal| Contact {
///     point: 0.04 * normal,
///     normal: Some(normal),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
/// });
/// let Geometry::Outline(outline) = nagata::interpolate(2, &contacts)? else { unreachable!() };
/// let circle = std::f64::consts::PI * 0.04 * 0.04;
/// assert!((outline.area() / circle - 1.0).abs() < 0.1);
/// # Ok::<(), tactile_host::shape::nagata::Error>(())
/// ```
///
/// # Errors
/// When a number is unusable, there are too few distinct contacts (3 in the plane, 4 in space) or
/// more than 5000, or they enclose nothing.
pub fn interpolate(dimension: usize, contacts: &[Contact]) -> Result<Geometry, Error> {
    if !(2..=3).contains(&dimension) {
        return Err(Error::Dimension(dimension));
    }
    for (index, contact) in contacts.iter().enumerate() {
        contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
    }
    if contacts.len() > MOST_CONTACTS {
        return Err(Error::Many(contacts.len()));
    }
    let vertices = merged(contacts);
    let needed = dimension + 1;
    if vertices.len() < needed {
        return Err(Error::Few { distinct: vertices.len(), needed });
    }
    let centre = centroid(vertices.iter().map(|v| v.point));
    if dimension == 2 { outline(vertices, &centre) } else { mesh(&vertices, &centre) }
}

/// Contacts closer together than their noise, each group as its mean.
fn merged(contacts: &[Contact]) -> Vec<Vertex> {
    struct Group {
        first: Point,
        points: Point,
        normals: Point,
        count: f64,
    }
    let mut groups: Vec<Group> = Vec::new();
    for contact in contacts {
        let near = APART * contact.point_deviation;
        let normal = contact.normal.unwrap_or_default();
        match groups.iter_mut().find(|g| (g.first - contact.point).norm() < near) {
            Some(group) => {
                group.points += contact.point;
                group.normals += normal;
                group.count += 1.0;
            }
            None => groups.push(Group {
                first: contact.point,
                points: contact.point,
                normals: normal,
                count: 1.0,
            }),
        }
    }
    let vertex = |g: Group| Vertex {
        point: g.points / g.count,
        // Normals that cancel say nothing.
        normal: g.normals.try_normalize(0.1),
    };
    groups.into_iter().map(vertex).collect()
}

/// Nagata's c of the curve x₀ + (d − c)ξ + cξ² between two vertices: the shortest vector with
/// n₀·(d − c) = 0 and n₁·(d + c) = 0. Zero, a straight edge, where that is not to be trusted.
fn bend(from: &Vertex, to: &Vertex) -> Point {
    let (Some(n0), Some(n1)) = (from.normal, to.normal) else { return Point::zeros() };
    let d = to.point - from.point;
    let cosine = n0.dot(&n1);
    let sine = 1.0 - cosine * cosine;
    if sine < PARALLEL {
        return Point::zeros();
    }
    let (at_start, at_end) = (n0.dot(&d), -n1.dot(&d));
    let c = (n0 * (at_start - cosine * at_end) + n1 * (at_end - cosine * at_start)) / sine;
    // Both ends must lead forwards.
    let forwards = c.dot(&d).abs() < FORWARDS * d.norm_squared();
    if forwards && c.norm() <= MOST_BEND * d.norm() { c } else { Point::zeros() }
}

/// A point of the curve.
fn along(from: &Vertex, to: &Vertex, c: &Point, share: f64) -> Point {
    let d = to.point - from.point;
    from.point + (d - c) * share + c * (share * share)
}

fn outline(mut vertices: Vec<Vertex>, centre: &Point) -> Result<Geometry, Error> {
    let angle = |v: &Vertex| (v.point.y - centre.y).atan2(v.point.x - centre.x);
    vertices.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    let ring = |bent: bool| {
        let mut ring = Vec::new();
        for (i, from) in vertices.iter().enumerate() {
            let to = &vertices[(i + 1) % vertices.len()];
            let c = if bent { bend(from, to) } else { Point::zeros() };
            let pieces = if c == Point::zeros() { 1 } else { PLANAR_PIECES };
            ring.extend((0..pieces).map(|k| {
                let p = along(from, to, &c, k as f64 / pieces as f64);
                [p.x, p.y]
            }));
        }
        Outline::new(vec![ring])
    };
    // Curves of neighbouring edges may cross where normals contradict the order; chords do not.
    let outline = ring(true).or_else(|_| ring(false)).map_err(|_| Error::Flat)?;
    Ok(Geometry::Outline(outline))
}

fn mesh(vertices: &[Vertex], centre: &Point) -> Result<Geometry, Error> {
    let seen: Option<Vec<Point>> =
        vertices.iter().map(|v| (v.point - centre).try_normalize(1e-9)).collect();
    let patches = hull(&seen.ok_or(Error::Flat)?).ok_or(Error::Flat)?;
    let mut points: Vec<Point> = vertices.iter().map(|v| v.point).collect();
    // Points inside an edge, by its ends in order: shared by the two patches along it.
    let mut edges: HashMap<(u32, u32), (Point, u32)> = HashMap::new();
    for [a, b] in patches.iter().flat_map(|p| [[p[0], p[1]], [p[1], p[2]], [p[2], p[0]]]) {
        if a < b {
            let (from, to) = (&vertices[a as usize], &vertices[b as usize]);
            let c = bend(from, to);
            edges.insert((a, b), (c, points.len() as u32));
            let inner = (1..PIECES).map(|k| along(from, to, &c, k as f64 / PIECES as f64));
            points.extend(inner);
        }
    }
    let mut triangles = Vec::new();
    for patch in &patches {
        let patch = Patch::new(*patch, vertices, &edges);
        let inside = points.len() as u32;
        for i in 2..PIECES {
            for j in 1..i {
                points.push(patch.point(i as f64 / PIECES as f64, j as f64 / PIECES as f64));
            }
        }
        let name = |i: usize, j: usize| patch.name(i, j, inside);
        for i in 0..PIECES {
            for j in 0..=i {
                triangles.push([name(i, j), name(i + 1, j), name(i + 1, j + 1)]);
                if j < i {
                    triangles.push([name(i, j), name(i + 1, j + 1), name(i, j + 1)]);
                }
            }
        }
    }
    Ok(Geometry::Mesh(Mesh::trusted(points, triangles)))
}

/// Thesis 2.2 with 0 ≤ ξ ≤ η ≤ 1; corners at (η, ξ) = (0, 0), (1, 0) and (1, 1).
struct Patch {
    corners: [u32; 3],
    /// First inner point of the edges from corner 0 to 1, 1 to 2 and 0 to 2, and whether it runs
    /// the other way.
    edges: [(u32, bool); 3],
    /// c₀₀, c₁₀, c₀₁, c₁₁, c₂₀, c₀₂.
    coefficients: [Point; 6],
}

impl Patch {
    fn new(
        corners: [u32; 3],
        vertices: &[Vertex],
        shared: &HashMap<(u32, u32), (Point, u32)>,
    ) -> Patch {
        let [x0, x1, x2] = corners.map(|v| vertices[v as usize].point);
        let ends = [(0, 1), (1, 2), (0, 2)].map(|(a, b)| (corners[a], corners[b]));
        let edge = ends.map(|(a, b)| {
            // Every edge of a closed triangulation runs once in each direction.
            let (c, first) = shared.get(&(a.min(b), a.max(b))).copied().unwrap_or_default();
            (c, (first, a > b))
        });
        // c is the same from either end.
        let [c1, c2, c3] = edge.map(|(c, _)| c);
        Patch {
            corners,
            edges: edge.map(|(_, place)| place),
            coefficients: [x0, x1 - x0 - c1, x2 - x1 + c1 - c3, c3 - c1 - c2, c1, c2],
        }
    }

    fn point(&self, eta: f64, xi: f64) -> Point {
        let [c00, c10, c01, c11, c20, c02] = self.coefficients;
        c00 + c10 * eta + c01 * xi + c11 * (eta * xi) + c20 * (eta * eta) + c02 * (xi * xi)
    }

    /// The vertex at (`i`, `j`) pieces, whose inner points start at `inside`.
    fn name(&self, i: usize, j: usize, inside: u32) -> u32 {
        let on = |(first, reversed): (u32, bool), k: usize| {
            first + if reversed { PIECES - k - 1 } else { k - 1 } as u32
        };
        match (i, j) {
            (0, 0) => self.corners[0],
            (PIECES, 0) => self.corners[1],
            (PIECES, PIECES) => self.corners[2],
            (i, 0) => on(self.edges[0], i),
            (PIECES, j) => on(self.edges[1], j),
            (i, j) if i == j => on(self.edges[2], i),
            (i, j) => inside + ((i - 1) * (i - 2) / 2 + j - 1) as u32,
        }
    }
}

/// The convex hull of unit vectors, triangles counter-clockwise seen from outside; `None` when they
/// lie on one circle. Vectors that coincide with an earlier one to rounding are left out.
fn hull(directions: &[Point]) -> Option<Vec<[u32; 3]>> {
    /// Below this a volume is rounding.
    const FLAT: f64 = 1e-12;
    let at = |v: u32| directions[v as usize];
    let volume = |t: &[u32; 3], p: &Point| {
        let [a, b, c] = t.map(at);
        (b - a).cross(&(c - a)).dot(&(p - a))
    };
    let farthest = |measure: &dyn Fn(&Point) -> f64| {
        let all = (0..directions.len() as u32).map(|v| (measure(&at(v)), v));
        all.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let (_, b) = farthest(&|p| (p - at(0)).norm())?;
    let (_, c) = farthest(&|p| (p - at(0)).cross(&(at(b) - at(0))).norm())?;
    let (height, d) = farthest(&|p| volume(&[0, b, c], p).abs())?;
    if !(height > FLAT) {
        return None;
    }
    let mut faces = if volume(&[0, b, c], &at(d)) > 0.0 {
        vec![[0, c, b], [0, b, d], [b, c, d], [c, 0, d]]
    } else {
        vec![[0, b, c], [0, d, b], [b, d, c], [c, d, 0]]
    };
    for next in (0..directions.len() as u32).filter(|v| ![0, b, c, d].contains(v)) {
        let p = at(next);
        let (visible, hidden): (Vec<_>, Vec<_>) = faces.iter().partition(|t| volume(t, &p) > FLAT);
        if visible.is_empty() {
            continue;
        }
        let edges = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])];
        let lit: Vec<(u32, u32)> = visible.iter().flat_map(edges).collect();
        let horizon = lit.iter().filter(|(a, b)| !lit.contains(&(*b, *a)));
        let cone: Vec<[u32; 3]> = horizon.map(|(a, b)| [*a, *b, next]).collect();
        faces = hidden;
        faces.extend(cone);
    }
    Some(faces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::metrics::compare;
    use crate::sim::ObjectSpec;
    use proptest::prelude::*;

    fn contact(point: Point, normal: Option<Point>) -> Contact {
        Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.0873 }
    }

    fn touches(object: &str, count: usize) -> (Geometry, Vec<Contact>) {
        let truth = object.parse::<ObjectSpec>().unwrap().geometry().unwrap();
        let contacts = truth.samples(count).into_iter().map(|(p, n)| contact(p, Some(n)));
        let contacts = contacts.collect();
        (truth, contacts)
    }

    fn watertight(geometry: &Geometry) -> &Mesh {
        let Geometry::Mesh(mesh) = geometry else { panic!() };
        assert!(mesh.is_watertight());
        mesh
    }

    #[test]
    fn curves_obey_both_normals() {
        let (n0, n1) =
            (Point::new(0.1, 1.0, 0.2).normalize(), Point::new(0.8, 0.6, 0.1).normalize());
        let from = Vertex { point: Point::zeros(), normal: Some(n0) };
        let to = Vertex { point: Point::new(0.03, -0.01, 0.002), normal: Some(n1) };
        let c = bend(&from, &to);
        let d = to.point - from.point;
        assert!(c.norm() > 1e-3);
        assert!(n0.dot(&(d - c)).abs() < 1e-15 && n1.dot(&(d + c)).abs() < 1e-15);
        assert!((bend(&to, &from) - c).norm() < 1e-15);
        assert_eq!(along(&from, &to, &c, 1.0), to.point);
        // Parallel or opposite normals, none, or one along the edge: straight.
        let with = |normal| Vertex { normal, ..to };
        for normal in [Some(n0), Some(-n0), None, Some(d.normalize())] {
            assert_eq!(bend(&from, &with(normal)), Point::zeros());
        }
    }

    #[test]
    fn a_smooth_shape_is_met_with_few_contacts() {
        let (truth, contacts) = touches("ellipse:0.12x0.06", 12);
        let curved = compare(&interpolate(2, &contacts).unwrap(), &truth).unwrap();
        let bare: Vec<_> = contacts.iter().map(|c| contact(c.point, None)).collect();
        let chords = compare(&interpolate(2, &bare).unwrap(), &truth).unwrap();
        assert!(curved.hausdorff < 1e-3 && chords.hausdorff > 3.0 * curved.hausdorff);

        let (truth, contacts) = touches("ellipsoid:0.12x0.08x0.06", 60);
        let found = interpolate(3, &contacts).unwrap();
        assert!(watertight(&found).volume() > 0.0);
        let curved = compare(&found, &truth).unwrap();
        let bare: Vec<_> = contacts.iter().map(|c| contact(c.point, None)).collect();
        let chords = compare(&interpolate(3, &bare).unwrap(), &truth).unwrap();
        assert!(curved.mean < 1e-3 && chords.mean > 1.5 * curved.mean, "{curved:?} {chords:?}");
    }

    #[test]
    fn every_contact_is_on_the_surface() {
        for (object, dimension) in [("rectangle:0.12x0.06", 2), ("box:0.12x0.06x0.06", 3)] {
            let (_, contacts) = touches(object, 30);
            let found = interpolate(dimension, &contacts).unwrap();
            for c in &contacts {
                assert!(found.distance(&c.point) < 1e-12);
            }
        }
    }

    #[test]
    fn coplanar_and_one_sided_contacts_stay_closed() {
        // The corners of a cube: four directions at a time lie on one circle.
        let corners: Vec<Contact> = (0..8)
            .map(|i| {
                let side = |bit: usize| if i >> bit & 1 == 1 { 0.03 } else { -0.03 };
                contact(Point::new(side(0), side(1), side(2)), None)
            })
            .collect();
        let cube = interpolate(3, &corners).unwrap();
        assert!((watertight(&cube).volume() - 0.06_f64.powi(3)).abs() < 1e-12);
        let (_, contacts) = touches("sphere:0.1", 100);
        let cap: Vec<Contact> = contacts.into_iter().filter(|c| c.point.z > 0.02).collect();
        watertight(&interpolate(3, &cap).unwrap());
    }

    #[test]
    fn what_encloses_nothing_is_refused_by_name() {
        assert_eq!(interpolate(1, &[]).unwrap_err(), Error::Dimension(1));
        assert_eq!(interpolate(2, &[]).unwrap_err(), Error::Few { distinct: 0, needed: 3 });
        let one = contact(Point::x() * 0.01, Some(Point::x()));
        let error = interpolate(3, &[one; 9]).unwrap_err();
        assert_eq!(error, Error::Few { distinct: 1, needed: 4 });
        let line: Vec<_> =
            (0..6).map(|i| contact(Point::x() * 0.01 * f64::from(i), None)).collect();
        assert_eq!(interpolate(2, &line).unwrap_err(), Error::Flat);
        assert_eq!(interpolate(3, &line).unwrap_err(), Error::Flat);
        let (_, ring) = touches("ellipse:0.12x0.06", 9);
        assert_eq!(interpolate(3, &ring).unwrap_err(), Error::Flat);
        let nan = contact(Point::new(0.0, f64::NAN, 0.0), None);
        assert!(matches!(interpolate(2, &[one, nan]), Err(Error::Contact { index: 1, .. })));
        assert_eq!(interpolate(2, &[one; 5001]).unwrap_err(), Error::Many(5001));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn whatever_the_contacts_the_surface_is_closed(
            draws in prop::collection::vec(prop::array::uniform6(-1.0..1.0), 4..40),
        ) {
            let contacts: Vec<Contact> = draws
                .iter()
                .map(|[x, y, z, a, b, c]| {
                    contact(Point::new(*x, *y, *z) * 0.05, Point::new(*a, *b, *c).try_normalize(1e-3))
                })
                .collect();
            match interpolate(3, &contacts) {
                Ok(Geometry::Mesh(mesh)) => {
                    prop_assert!(mesh.is_watertight());
                    prop_assert!(mesh.vertices().iter().all(|v| v.norm() < 0.5));
                }
                Ok(_) => prop_assert!(false),
                Err(error) => prop_assert!(matches!(error, Error::Few { .. } | Error::Flat), "{error}"),
            }
        }
    }
}
