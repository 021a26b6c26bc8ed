//! Closed meshes whose vertices were moved: short edges are contracted, and what was folded over is unfolded.
//!
//! An edge is contracted only where its ends have no neighbours in common but the two across it (the link
//! condition of Dey, Edelsbrunner, Guha and Nekhayev, Publications de l'Institut Mathématique 66, 1999), and
//! flipped only where no edge runs between these two yet: what is watertight stays so.

use super::settle::ON_SURFACE;
use crate::space::Point;

/// Edges shorter than this, in spacings, are contracted.
const SHORTEST: f64 = 1e-3;

/// Cosine between the normals of neighbouring triangles (120°) below which one may have been turned over.
const FOLDED: f64 = -0.5;

/// By how much that must be less than the cosine between the field's normals on both sides of their edge,
/// which is no greater where the surface itself is as sharp.
const ALIKE: f64 = 0.4;

/// What a fold costs beside the area of the triangles, in that of a cell's side.
const FOLD: f64 = 0.1;

/// What a change saves at least, likewise.
const LEAST: f64 = 1e-9;

/// How far the surface may move when it is unfolded, in spacings: first, and where folds are left.
const MOST_OFF: [f64; 2] = [0.1, 0.5];

/// How long edges may get by it, likewise.
const LONGEST: f64 = 3.0;

/// Contracts short edges and unfolds what is folded over. `normals` are those of the field beside the
/// vertices, not a number where there is none. The mesh must be watertight and the triangles at each vertex
/// one fan.
pub(super) fn mend(
    spacing: f64,
    vertices: Vec<Point>,
    normals: Vec<Point>,
    triangles: Vec<[u32; 3]>,
) -> (Vec<Point>, Vec<[u32; 3]>) {
    let mut fans = vec![Vec::new(); vertices.len()];
    for (name, triangle) in triangles.iter().enumerate() {
        triangle.iter().for_each(|v| fans[*v as usize].push(name as u32));
    }
    let mut net = Net { spacing, vertices, normals, triangles, fans, doubtful: Vec::new() };
    net.doubtful = net.bent();
    // What was in the way of the one the other may have taken away.
    let [near, far] = MOST_OFF.map(|share| share * spacing);
    for (most_off, cuts) in [(near, false), (far, false), (far, true)] {
        while net.shorten(cuts) | net.unfold(most_off) {}
    }
    net.left()
}

/// A mesh that is changed in place.
struct Net {
    spacing: f64,
    vertices: Vec<Point>,
    normals: Vec<Point>,
    /// All corners of those that are gone are equal.
    triangles: Vec<[u32; 3]>,
    /// The triangles at each vertex.
    fans: Vec<Vec<u32>>,
    /// Edges that may be folded.
    doubtful: Vec<[u32; 2]>,
}

/// New triangles in the place of others.
struct Change {
    gone: Vec<u32>,
    new: Vec<[u32; 3]>,
}

impl Net {
    fn places(&self, triangle: &[u32; 3]) -> [Point; 3] {
        triangle.map(|v| self.vertices[v as usize])
    }

    /// Twice the area, along the normal.
    fn area(&self, triangle: &[u32; 3]) -> Point {
        let [a, b, c] = self.places(triangle);
        (b - a).cross(&(c - a))
    }

    fn length(&self, [a, b]: [u32; 2]) -> f64 {
        (self.vertices[a as usize] - self.vertices[b as usize]).norm()
    }

    fn is_short(&self, ends: [u32; 2]) -> bool {
        self.length(ends) < SHORTEST * self.spacing
    }

    /// The triangles at a vertex, each with its other corners in order.
    fn fan(&self, vertex: u32) -> impl Iterator<Item = (u32, [u32; 2])> + '_ {
        let others = move |name: &u32| {
            let [a, b, c] = self.triangles[*name as usize];
            let others = [[b, c], [c, a], [a, b]];
            (*name, others[[a, b].iter().position(|v| *v == vertex).unwrap_or(2)])
        };
        self.fans[vertex as usize].iter().map(others)
    }

    /// The triangle with a side from `a` to `b`, and its third corner.
    fn beside(&self, [a, b]: [u32; 2]) -> Option<(u32, u32)> {
        self.fan(a).find(|(_, others)| others[0] == b).map(|(name, others)| (name, others[1]))
    }

    /// The vertex `gone` moved along an edge onto the other end.
    fn contraction(&self, [gone, kept]: [u32; 2]) -> Option<Change> {
        let ring: Vec<u32> = self.fan(kept).map(|(_, others)| others[0]).collect();
        let common = self.fan(gone).filter(|(_, others)| ring.contains(&others[0])).count();
        if !ring.contains(&gone) || common != 2 || self.is_tetrahedron([gone, kept]) {
            return None;
        }
        let stay = self.fan(gone).filter(|(_, others)| !others.contains(&kept));
        let new = stay.map(|(_, [a, b])| [kept, a, b]).collect();
        Some(Change { gone: self.fans[gone as usize].clone(), new })
    }

    /// Whether the component of an edge has four vertices.
    fn is_tetrahedron(&self, ends: [u32; 2]) -> bool {
        ends.iter().all(|v| self.fans[*v as usize].len() == 3)
    }

    /// Whether a vertex has but three triangles, one of them at an edge.
    fn is_fin(&self, vertex: u32, [a, b]: [u32; 2]) -> bool {
        let is_at = |(_, others): (u32, [u32; 2])| others == [a, b] || others == [b, a];
        self.fans[vertex as usize].len() == 3 && self.fan(vertex).any(is_at)
    }

    /// The edge from `a` to `b` in the place of which one runs between the corners across it.
    fn flip(&self, [a, b]: [u32; 2]) -> Option<Change> {
        let (left, c) = self.beside([a, b])?;
        let (right, d) = self.beside([b, a])?;
        let is_free = c != d && self.beside([c, d]).is_none();
        is_free.then(|| Change { gone: vec![left, right], new: vec![[a, d, c], [d, b, c]] })
    }

    fn apply(&mut self, change: &Change) {
        for name in &change.gone {
            for v in std::mem::take(&mut self.triangles[*name as usize]) {
                self.fans[v as usize].retain(|other| other != name);
            }
        }
        let more = self.triangles.len() as u32..;
        for (name, triangle) in change.gone.iter().copied().chain(more).zip(&change.new) {
            if name as usize == self.triangles.len() {
                self.triangles.push(*triangle);
            } else {
                self.triangles[name as usize] = *triangle;
            }
            triangle.iter().for_each(|v| self.fans[*v as usize].push(name));
            self.doubtful.extend(sides(triangle).map(|[a, b, _]| [a, b]));
        }
    }

    fn triangles_of(&self, names: &[u32]) -> Vec<[u32; 3]> {
        names.iter().map(|name| self.triangles[*name as usize]).collect()
    }

    /// Every edge once.
    fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        let sides = self.triangles.iter().flat_map(sides);
        sides.filter(|[a, b, _]| a < b).map(|[a, b, _]| [a, b])
    }

    /// Contracts short edges where no triangle turns over by it, and whether there were any. Tetrahedra that
    /// have one vanish; necks that consist of one are cut where asked for.
    fn shorten(&mut self, cuts: bool) -> bool {
        for round in 0.. {
            let short: Vec<[u32; 2]> = self.edges().filter(|ends| self.is_short(*ends)).collect();
            let mut is_done = true;
            for [a, b] in short {
                // Another one may have taken it along.
                let change = if self.beside([a, b]).is_none() {
                    None
                } else if self.is_tetrahedron([a, b]) {
                    let mut gone: Vec<u32> = self.fan(a).chain(self.fan(b)).map(|f| f.0).collect();
                    gone.sort_unstable();
                    gone.dedup();
                    Some(Change { gone, new: Vec::new() })
                } else {
                    let moved = |[gone, kept]: [u32; 2]| {
                        self.contraction([gone, kept])
                            .filter(|change| cuts || !self.turns(change, gone))
                    };
                    // Else what stands out between two triangles back to back may be in the way.
                    let fin = || {
                        let mut ring = self.fan(b).map(|(_, others)| others[0]);
                        self.contraction([ring.find(|v| self.is_fin(*v, [a, b]))?, a])
                    };
                    let found = moved([b, a]).or_else(|| moved([a, b])).or_else(fin);
                    if cuts { found.or_else(|| self.cut([a, b])) } else { found }
                };
                if let Some(change) = change {
                    self.apply(&change);
                    is_done = false;
                }
            }
            if is_done {
                return round > 0;
            }
        }
        false
    }

    /// The surface cut at a neck around an edge and one other vertex, and closed on both sides.
    fn cut(&mut self, [a, b]: [u32; 2]) -> Option<Change> {
        let ((_, left), (_, right)) = self.beside([a, b]).zip(self.beside([b, a]))?;
        let ring: Vec<u32> = self.fan(a).map(|(_, others)| others[0]).collect();
        let is_common = |v: &u32| ring.contains(v) && ![left, right].contains(v);
        let c = self.fan(b).map(|(_, others)| others[0]).find(is_common)?;
        // The triangles on the left of the way around it.
        let mut gone = Vec::new();
        for [last, at, next] in sides(&[a, b, c]) {
            let mut spoke = next;
            while spoke != last {
                let (name, third) = self.beside([at, spoke])?;
                gone.push(name);
                spoke = third;
            }
        }
        gone.sort_unstable();
        gone.dedup();
        let first = self.vertices.len() as u32;
        let renamed =
            |v| [a, b, c].iter().zip(first..).find(|(old, _)| **old == v).map_or(v, |n| n.1);
        let mut new: Vec<[u32; 3]> =
            self.triangles_of(&gone).into_iter().map(|t| t.map(renamed)).collect();
        new.extend([[a, b, c], [first + 1, first, first + 2]]);
        for v in [a, b, c] {
            self.vertices.push(self.vertices[v as usize]);
            self.normals.push(self.normals[v as usize]);
            self.fans.push(Vec::new());
        }
        Some(Change { gone, new })
    }

    /// Whether a contraction turns over one of the triangles at the vertex that is moved.
    fn turns(&self, change: &Change, moved: u32) -> bool {
        change.new.iter().any(|new| {
            let old = [moved, new[1], new[2]];
            self.area(&old).dot(&self.area(new)) < 0.0
        })
    }

    /// Edges between triangles with very different normals.
    fn bent(&self) -> Vec<[u32; 2]> {
        let units: Vec<Point> = self.triangles.iter().map(|t| unit(&self.area(t))).collect();
        let is_bent = |(t, [a, b, _]): (usize, [u32; 3])| {
            let other = if a < b { self.beside([b, a]) } else { None };
            other.filter(|(name, _)| units[t].dot(&units[*name as usize]) < FOLDED).map(|_| [a, b])
        };
        let all =
            self.triangles.iter().enumerate().flat_map(|(t, c)| sides(c).map(|side| (t, side)));
        all.filter_map(is_bent).collect()
    }

    /// Contracts and flips edges of folds while that makes the surface smaller and leaves it where it is, and
    /// whether there were any.
    fn unfold(&mut self, most_off: f64) -> bool {
        let mut is_changed = false;
        let mut left_over = Vec::new();
        while let Some([a, b]) = self.doubtful.pop() {
            let [left, right] = [[a, b], [b, a]].map(|side| self.beside(side));
            let Some(((_, c), (_, d))) = left.zip(right) else { continue };
            if !self.is_folded(&[a, b, c], d) {
                continue;
            }
            match self.unfolding(most_off, [[a, b], [b, c], [c, a], [a, d], [d, b]]) {
                Some(change) => {
                    self.apply(&change);
                    is_changed = true;
                }
                None => left_over.push([a, b]),
            }
        }
        self.doubtful = left_over;
        is_changed
    }

    /// Of the changes to these edges that help the one that moves the surface least; of those that do not
    /// move it the one that helps most.
    fn unfolding(&self, most_off: f64, edges: [[u32; 2]; 5]) -> Option<Change> {
        let square = self.spacing.powi(2);
        let changes = edges.into_iter().flat_map(|[a, b]| {
            [self.flip([a, b]), self.contraction([a, b]), self.contraction([b, a])]
        });
        let found = changes.flatten().filter_map(|change| {
            let old = self.triangles_of(&change.gone);
            let [now, then] = [&old, &change.new].map(|t| self.cost(t, &change.gone));
            let mut sides = change.new.iter().flat_map(sides);
            let is_good = then < now - LEAST * square
                && self.flat(&change.new) <= self.flat(&old)
                && sides.all(|[a, b, _]| self.length([a, b]) < LONGEST * self.spacing);
            let off = if is_good { self.off(&change, most_off)? } else { return None };
            Some((off.max(ON_SURFACE * self.spacing), then - now, change))
        });
        let best = found.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        best.map(|(_, _, change)| change)
    }

    /// How many triangles have no area, other than those with a short side, which will vanish.
    fn flat(&self, triangles: &[[u32; 3]]) -> usize {
        let is_flat = |t: &&[u32; 3]| {
            self.area(t).norm() < LEAST * self.spacing.powi(2)
                && sides(t).iter().all(|[a, b, _]| !self.is_short([*a, *b]))
        };
        triangles.iter().filter(is_flat).count()
    }

    /// Whether the triangle and that over its first side, of which `d` is a corner, lie on one another.
    fn is_folded(&self, [a, b, c]: &[u32; 3], d: u32) -> bool {
        let cosine = unit(&self.area(&[*a, *b, *c])).dot(&unit(&self.area(&[*b, *a, d])));
        let [near, far] = [*c, d].map(|v| self.normals[v as usize]);
        cosine < FOLDED && !(near.dot(&far) < cosine + ALIKE)
    }

    /// Twice the area of triangles in the place of those that are gone, and what their folds cost.
    fn cost(&self, triangles: &[[u32; 3]], gone: &[u32]) -> f64 {
        let all: Vec<[u32; 3]> = triangles.iter().flat_map(sides).collect();
        let is_folded = |one: &&[u32; 3]| {
            let [a, b, _] = **one;
            if let Some(other) = all.iter().find(|other| other[..2] == [b, a]) {
                // Counted once.
                return a < b && self.is_folded(one, other[2]);
            }
            let outside = self.fan(b).find(|(name, others)| others[0] == a && !gone.contains(name));
            outside.is_some_and(|(_, others)| self.is_folded(one, others[1]))
        };
        let folds = all.iter().filter(is_folded).count() as f64;
        let area: f64 = triangles.iter().map(|t| self.area(t).norm()).sum();
        area + FOLD * self.spacing.powi(2) * folds
    }

    /// How far the surface moves by a change, metres, unless that is too far: corners and the middles of
    /// sides, from the old to the new and back.
    fn off(&self, change: &Change, most: f64) -> Option<f64> {
        let old = self.triangles_of(&change.gone);
        let mut beside: Vec<u32> =
            old.iter().flatten().flat_map(|v| &self.fans[*v as usize]).copied().collect();
        beside.sort_unstable();
        beside.dedup();
        beside.retain(|name| !change.gone.contains(name));
        let places = |triangles: &[[u32; 3]]| -> Vec<[Point; 3]> {
            triangles.iter().map(|t| self.places(t)).collect()
        };
        let beside = places(&self.triangles_of(&beside));
        let (old, new) = (places(&old), places(&change.new));
        let mut worst = 0.0;
        for (from, to) in [(&old, &new), (&new, &old)] {
            let points = from
                .iter()
                .flat_map(|[a, b, c]| [*a, *b, *c, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]);
            for point in points {
                let mut off = f64::INFINITY;
                for triangle in to.iter().chain(&beside) {
                    off = distance(triangle, &point).min(off);
                    if off <= worst {
                        break;
                    }
                }
                worst = off.max(worst);
                if worst > most {
                    return None;
                }
            }
        }
        Some(worst)
    }

    /// What is left, without vertices that have no triangles.
    fn left(mut self) -> (Vec<Point>, Vec<[u32; 3]>) {
        self.triangles.retain(|[a, b, _]| a != b);
        let mut renamed = vec![u32::MAX; self.vertices.len()];
        let mut vertices = Vec::new();
        for v in self.triangles.iter_mut().flatten() {
            let name = &mut renamed[*v as usize];
            if *name == u32::MAX {
                *name = vertices.len() as u32;
                vertices.push(self.vertices[*v as usize]);
            }
            *v = *name;
        }
        (vertices, self.triangles)
    }
}

/// Of a triangle the ends of each side and the corner across it.
fn sides([a, b, c]: &[u32; 3]) -> [[u32; 3]; 3] {
    [[*a, *b, *c], [*b, *c, *a], [*c, *a, *b]]
}

/// Zero of nothing.
fn unit(normal: &Point) -> Point {
    normal.try_normalize(0.0).unwrap_or_default()
}

/// From a triangle to a point, metres.
fn distance([a, b, c]: &[Point; 3], p: &Point) -> f64 {
    let normal = unit(&(b - a).cross(&(c - a)));
    let sides = [[a, b], [b, c], [c, a]];
    let is_inward = |[from, to]: &[&Point; 2]| normal.dot(&(*to - *from).cross(&(p - *from))) > 0.0;
    if sides.iter().all(is_inward) {
        return normal.dot(&(p - a)).abs();
    }
    let to_side = |[from, to]: [&Point; 2]| {
        let along = to - from;
        let share = along.dot(&(p - from)) / along.norm_squared().max(f64::MIN_POSITIVE);
        (from + along * share.clamp(0.0, 1.0) - p).norm()
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::mesh::tests::folds;
    use crate::shape::{Field, Mesh, surface};

    struct Ball;

    impl Field for Ball {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| p.norm() - 0.02).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            vec![0.0; points.len()]
        }
    }

    fn mended(vertices: &[Point], triangles: &[[u32; 3]]) -> Mesh {
        let normals = vertices.iter().map(|p| p.normalize()).collect();
        let (vertices, triangles) = mend(0.002, vertices.to_vec(), normals, triangles.to_vec());
        Mesh::new(vertices, triangles).unwrap()
    }

    #[test]
    fn vertices_beyond_their_neighbours_leave_no_fold() {
        let corner = Point::repeat(0.025);
        let (ball, _) = surface::mesh(&Ball, (-corner, corner), 0.002).unwrap();
        assert_eq!(mended(ball.vertices(), ball.triangles()).triangles(), ball.triangles());
        for moved in (0..ball.vertices().len()).step_by(97) {
            let mut vertices = ball.vertices().to_vec();
            let along = vertices[moved].cross(&Point::new(0.3, 0.5, 0.7)).normalize();
            vertices[moved] = (vertices[moved] + along * 0.003).normalize() * 0.02;
            let folded = Mesh::new(vertices.clone(), ball.triangles().to_vec()).unwrap();
            assert!(folds(&folded) > 0);
            let mesh = mended(&vertices, ball.triangles());
            assert!(mesh.is_watertight());
            assert_eq!(folds(&mesh), 0);
            assert!((mesh.volume() / ball.volume() - 1.0).abs() < 1e-3);
        }
    }

    /// Rings of three vertices one above the other, closed at both ends.
    fn tube(rings: &[[Point; 3]]) -> (Vec<Point>, Vec<[u32; 3]>) {
        let last = 3 * (rings.len() as u32 - 1);
        let mut triangles = vec![[0, 2, 1], [last, last + 1, last + 2]];
        for ring in 0..rings.len() as u32 - 1 {
            for i in 0..3 {
                let [a, b] = [3 * ring + i, 3 * ring + (i + 1) % 3];
                triangles.extend([[a, b, b + 3], [a, b + 3, a + 3]]);
            }
        }
        (rings.concat(), triangles)
    }

    #[test]
    fn a_short_edge_around_a_neck_parts_it() {
        let ring = |z: f64, width: f64| {
            [Point::new(0.01, width, z), Point::new(0.0, 0.02, z), Point::new(0.01, -width, z)]
                .map(|p| p - Point::new(0.005, 0.0, 0.0))
        };
        let (vertices, triangles) = tube(&[ring(-0.01, 0.01), ring(0.0, 1e-9), ring(0.01, 0.01)]);
        let before = Mesh::new(vertices.clone(), triangles.clone()).unwrap();
        assert!(before.is_watertight());
        let mesh = mended(&vertices, &triangles);
        assert!(mesh.is_watertight());
        // Two bodies, each with an edge in the place of the neck.
        assert_eq!((mesh.vertices().len(), mesh.triangles().len()), (10, 12));
        assert!((mesh.volume() / before.volume() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn what_is_too_small_vanishes() {
        let at = |x: f64, y: f64, z: f64| Point::new(x, y, z) * 1e-7;
        let vertices = [at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(0.0, 1.0, 0.0), at(0.0, 0.0, 1.0)];
        let triangles = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert!(mended(&vertices.map(|p| p + Point::x()), &triangles).triangles().is_empty());
    }
}
