//! The boundary of a union of cells as an outline or a mesh with no more vertices than it needs.

use std::collections::{BTreeMap, HashMap, HashSet};

use super::{Geometry, Mesh, Outline};
use crate::space::Point;

/// A polygon of the boundary.
#[derive(Clone, Debug)]
pub struct Side {
    /// The plane it lies in.
    pub plane: usize,
    /// Whether the outside is behind the plane.
    pub flipped: bool,
    /// Indices of its vertices, counter-clockwise seen from outside.
    pub ring: Vec<usize>,
}

/// A plane and which of its sides is outside.
type Key = (usize, bool);

/// What was found.
#[derive(Clone, Debug)]
pub struct Boundary {
    /// Closed and outward.
    pub geometry: Geometry,
    /// The vertices of `geometry`, metres.
    pub vertices: Vec<Point>,
    /// Of each vertex the planes that meet there.
    pub meeting: Vec<Vec<Key>>,
    /// Triangles with the plane each lies in; edges of an outline as a, b, b.
    pub pieces: Vec<(usize, [Point; 3])>,
}

/// The outline of upright sides, from their edges below z = 0. `None` when two corners touch or
/// nothing is enclosed.
pub fn outline(vertices: &[Point], sides: &[Side]) -> Option<Boundary> {
    let mut next: BTreeMap<usize, (usize, Key)> = BTreeMap::new();
    for side in sides {
        for (a, b) in edges(&side.ring) {
            if vertices[a].z < 0.0 && vertices[b].z < 0.0 {
                let taken = next.insert(a, (b, (side.plane, side.flipped)));
                if taken.is_some() {
                    return None;
                }
            }
        }
    }
    let mut loops: Vec<Vec<(usize, Key)>> = Vec::new();
    while let Some((&first, _)) = next.first_key_value() {
        let mut ring: Vec<(usize, Key)> = Vec::new();
        let mut at = first;
        while let Some((to, key)) = next.remove(&at) {
            ring.push((at, key));
            at = to;
        }
        if at != first {
            return None;
        }
        // Where the plane stays the same there is no corner.
        let corner = |i: &usize| ring[*i].1 != ring[(*i + ring.len() - 1) % ring.len()].1;
        loops.push((0..ring.len()).filter(corner).map(|i| ring[i]).collect());
    }
    let flat = |v: usize| Point::new(vertices[v].x, vertices[v].y, 0.0);
    let polygons =
        loops.iter().map(|l| l.iter().map(|(v, _)| [vertices[*v].x, vertices[*v].y]).collect());
    let outline = Outline::new(polygons.collect()).ok()?;
    // Where vertices coincided the outline has fewer, and a loop may have been turned.
    let mut found = Boundary {
        geometry: Geometry::Outline(Outline { loops: vec![] }),
        vertices: vec![],
        meeting: vec![],
        pieces: vec![],
    };
    for (kept, ring) in outline.loops.iter().zip(&loops) {
        for v in kept {
            let at = ring.iter().position(|(i, _)| [vertices[*i].x, vertices[*i].y] == *v)?;
            let before = ring[(at + ring.len() - 1) % ring.len()].1;
            found.vertices.push(flat(ring[at].0));
            found.meeting.push(vec![before, ring[at].1]);
        }
        for (i, (v, key)) in ring.iter().enumerate() {
            let (a, b) = (flat(*v), flat(ring[(i + 1) % ring.len()].0));
            found.pieces.push((key.0, [a, b, b]));
        }
    }
    found.geometry = Geometry::Outline(outline);
    Some(found)
}

/// The mesh of the sides. Those in one plane are joined where that leaves no hole in them. `None` when
/// it is not closed, or edges touch.
pub fn mesh(vertices: &[Point], sides: &[Side]) -> Option<Boundary> {
    let mut planes_at: HashMap<usize, HashSet<Key>> = HashMap::new();
    let mut groups: BTreeMap<Key, Vec<&Side>> = BTreeMap::new();
    for side in sides {
        let key = (side.plane, side.flipped);
        groups.entry(key).or_default().push(side);
        for v in &side.ring {
            planes_at.entry(*v).or_default().insert(key);
        }
    }
    let corner = |v: &usize| planes_at.get(v).is_some_and(|p| p.len() > 2);
    let joined: Option<Vec<(Key, [usize; 3])>> = groups
        .iter()
        .map(|(key, group)| Some(join(vertices, group, corner)?.into_iter().map(|t| (*key, t))))
        .collect::<Option<Vec<_>>>()
        .map(|parts| parts.into_iter().flatten().collect());
    let fans = || {
        let fan = |s: &Side| {
            let (key, ring) = ((s.plane, s.flipped), s.ring.clone());
            (2..ring.len()).map(move |i| (key, [ring[0], ring[i - 1], ring[i]]))
        };
        sides.iter().flat_map(fan).collect::<Vec<_>>()
    };
    let closed = joined.and_then(|triangles| collect(vertices, &triangles));
    closed.or_else(|| collect(vertices, &fans()))
}

/// The mesh of these triangles, if it is watertight.
fn collect(vertices: &[Point], triangles: &[(Key, [usize; 3])]) -> Option<Boundary> {
    let mut renamed: HashMap<usize, u32> = HashMap::new();
    let (mut used, mut meeting): (Vec<Point>, Vec<Vec<Key>>) = (Vec::new(), Vec::new());
    let mut named = Vec::with_capacity(triangles.len());
    for (key, corners) in triangles {
        named.push(corners.map(|v| {
            let name = *renamed.entry(v).or_insert_with(|| {
                used.push(vertices[v]);
                meeting.push(Vec::new());
                used.len() as u32 - 1
            });
            let keys = &mut meeting[name as usize];
            if !keys.contains(key) {
                keys.push(*key);
            }
            name
        }));
    }
    let pieces = triangles.iter().map(|((plane, _), t)| (*plane, t.map(|v| vertices[v]))).collect();
    let mesh = Mesh::new(used.clone(), named).ok()?;
    (mesh.is_watertight() && mesh.volume() > 0.0).then_some(Boundary {
        geometry: Geometry::Mesh(mesh),
        vertices: used,
        meeting,
        pieces,
    })
}

fn edges(ring: &[usize]) -> impl Iterator<Item = (usize, usize)> + '_ {
    (0..ring.len()).map(|i| (ring[i], ring[(i + 1) % ring.len()]))
}

/// Triangles of the union of sides in one plane with the corners that `keep` says; `None` when there
/// is a hole in it.
fn join(
    vertices: &[Point],
    sides: &[&Side],
    keep: impl Fn(&usize) -> bool,
) -> Option<Vec<[usize; 3]>> {
    let all: HashSet<(usize, usize)> = sides.iter().flat_map(|s| edges(&s.ring)).collect();
    let mut next: BTreeMap<usize, usize> = BTreeMap::new();
    for (a, b) in &all {
        if !all.contains(&(*b, *a)) && next.insert(*a, *b).is_some() {
            return None;
        }
    }
    let normal = |ring: &[usize]| -> Point {
        let origin = vertices[ring[0]];
        edges(ring).map(|(a, b)| (vertices[a] - origin).cross(&(vertices[b] - origin))).sum()
    };
    let outward: Point = sides.iter().map(|s| normal(&s.ring)).sum();
    let outward = outward.try_normalize(0.0)?;
    let mut triangles = Vec::new();
    while let Some((&first, _)) = next.first_key_value() {
        let mut ring = Vec::new();
        let mut at = first;
        while let Some(to) = next.remove(&at) {
            ring.push(at);
            at = to;
        }
        if at != first || normal(&ring).dot(&outward) <= 0.0 {
            return None;
        }
        ring.retain(&keep);
        triangles.extend(clip_ears(vertices, ring, &outward)?);
    }
    Some(triangles)
}

/// Triangles of a simple polygon, counter-clockwise about `outward` (Meisters 1975).
fn clip_ears(vertices: &[Point], ring: Vec<usize>, outward: &Point) -> Option<Vec<[usize; 3]>> {
    let twice = |a: usize, b: usize, c: usize| {
        outward.dot(&(vertices[b] - vertices[a]).cross(&(vertices[c] - vertices[a])))
    };
    let mut ring = ring;
    let mut triangles = Vec::new();
    while ring.len() > 3 {
        let count = ring.len();
        let ear = (0..count)
            .filter_map(|i| {
                let (a, b, c) = (ring[(i + count - 1) % count], ring[i], ring[(i + 1) % count]);
                let area = twice(a, b, c);
                let within = |v: &usize| {
                    let v = *v;
                    v != a
                        && v != b
                        && v != c
                        && twice(a, b, v) >= 0.0
                        && twice(b, c, v) >= 0.0
                        && twice(c, a, v) >= 0.0
                };
                (area > 0.0 && !ring.iter().any(within)).then(|| {
                    // The fattest first: no needless slivers.
                    let longest = (vertices[a] - vertices[c]).norm_squared();
                    (i, area / longest.max(f64::MIN_POSITIVE))
                })
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))?
            .0;
        triangles.push([ring[(ear + count - 1) % count], ring[ear], ring[(ear + 1) % count]]);
        ring.remove(ear);
    }
    if ring.len() < 3 {
        return None;
    }
    triangles.push([ring[0], ring[1], ring[2]]);
    Some(triangles)
}

/// The point of a triangle nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5); of an edge
/// when two corners are the same.
pub fn closest(p: &Point, [a, b, c]: &[Point; 3]) -> Point {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(&(p - a)), ac.dot(&(p - a)));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let (d3, d4) = (ab.dot(&(p - b)), ac.dot(&(p - b)));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let (d5, d6) = (ab.dot(&(p - c)), ac.dot(&(p - c)));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    a + (ab * vb + ac * vc) / (va + vb + vc)
}
