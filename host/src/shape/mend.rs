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

/// It was not where those of the field across their edge differ as much, to this; so they do at sharp edges.
const ALIKE: f64 = 0.4;

/// What a fold costs beside the area of the triangles, in that of a cell's side.
const FOLD: f64 = 0.1;

/// What a change saves at least, likewise.
const LEAST: f64 = 1e-9;

/// How far the surface may move when it is unfolded, in spacings.
const MOST_OFF: [f64; 2] = [0.1, 0.5];

/// How long edges may get by it, likewise.
const LONGEST: f64 = 3.0;

/// Contracts short edges and unfolds what is folded over. `normals` are those of the field beside the vertices,
/// not a number where there is none. The mesh must be watertight and the triangles at each vertex one fan.
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
    let mut net = Net { spacing, vertices, normals, triangles, fans };
    // What was in the way of the one the other may have taken away.
    for most_off in MOST_OFF {
        while net.shorten() | net.unfold(most_off * spacing) {}
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
            let others = if a == vertex {
                [b, c]
            } else if b == vertex {
                [c, a]
            } else {
                [a, b]
            };
            (*name, others)
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
        for (name, triangle) in change.gone.iter().zip(&change.new) {
            self.triangles[*name as usize] = *triangle;
            triangle.iter().for_each(|v| self.fans[*v as usize].push(*name));
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
    /// have one vanish.
    fn shorten(&mut self) -> bool {
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
                        self.contraction([gone, kept]).filter(|change| !self.turns(change, gone))
                    };
                    // Else perhaps what stands out between two triangles back to back.
                    let fin = || {
                        let ring = self.fan(b).map(|f| f.1[0]).find(|v| self.is_fin(*v, [a, b]))?;
                        self.contraction([ring, a])
                    };
                    moved([b, a]).or_else(|| moved([a, b])).or_else(fin)
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

    /// Whether a contraction turns over one of the triangles at the vertex that is moved.
    fn turns(&self, change: &Change, moved: u32) -> bool {
        change.new.iter().any(|new| {
            let old = [moved, new[1], new[2]];
            self.area(&old).dot(&self.area(new)) < 0.0
        })
    }

    /// Contracts and flips edges of folds while that makes the surface smaller and leaves it where it is.
    fn unfold(&mut self, most_off: f64) -> bool {
        let units: Vec<Point> = self.triangles.iter().map(|t| unit(&self.area(t))).collect();
        let may_be_folded = |[a, b]: &[u32; 2]| {
            let [left, right] = [[*a, *b], [*b, *a]].map(|side| self.beside(side));
            let cosine =
                left.zip(right).map(|(l, r)| units[l.0 as usize].dot(&units[r.0 as usize]));
            cosine.is_some_and(|cosine| cosine < FOLDED)
        };
        let mut edges: Vec<[u32; 2]> = self.edges().filter(may_be_folded).collect();
        let mut is_changed = false;
        while let Some([a, b]) = edges.pop() {
            let [left, right] = [[a, b], [b, a]].map(|side| self.beside(side));
            let Some(((_, c), (_, d))) = left.zip(right) else { continue };
            if self.is_folded(&[a, b, c], d)
                && let Some(change) =
                    self.unfolding(most_off, [[a, b], [b, c], [c, a], [a, d], [d, b]])
            {
                self.apply(&change);
                edges.extend(change.new.iter().flat_map(sides).map(|[a, b, _]| [a, b]));
                is_changed = true;
            }
        }
        is_changed
    }

    /// Of the changes to these edges that help the one that moves the surface least; of those that do not move
    /// it the one that helps most.
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
