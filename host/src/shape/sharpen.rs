//! Edges and corners of a surface that has them, in the mesh that nets gave it.
//!
//! A side of a triangle between two vertices whose tangent planes differ cuts off the edge between them. It
//! no longer does once one of the two lies on that edge: which ones do is chosen for all sides together, so
//! that each moves as little as possible. In contrast to dual contouring within each cell (Ju, Losasso,
//! Schaefer and Warren, SIGGRAPH 2002), no edge is lost that passes between the sides of a cell.

use std::collections::{BTreeMap, BTreeSet};

use super::Field;
use super::settle::{Meeting, Tangent, is_edge, meeting, settle, tangents};
use crate::space::Point;

/// Share of a quadrilateral's area below which one of its triangles has none.
const FLAT: f64 = 0.01;

/// Cosine of less than half the angle that makes an edge.
const BENT: f64 = 0.98;

/// Moves vertices onto the corners and edges of the surface and turns diagonals that this leaves without
/// area. Triangles come in pairs, each a quadrilateral of the nets; `normals` are those of the field beside
/// the vertices, not a number where there is none, so that no edge is beside these.
pub(super) fn sharpen(
    field: &dyn Field,
    spacing: f64,
    normals: &[Point],
    vertices: &mut [Point],
    triangles: &mut [[u32; 3]],
) {
    let neighbours = beside_edges(normals, triangles);
    if neighbours.is_empty() {
        return;
    }
    let names: Vec<usize> = neighbours.keys().copied().collect();
    let places: Vec<Point> = names.iter().map(|v| vertices[*v]).collect();
    let touching = names.into_iter().zip(tangents(field, spacing, &places));
    let touching: BTreeMap<usize, Tangent> =
        touching.filter_map(|(vertex, tangent)| Some((vertex, tangent?))).collect();
    let moved = Edges { spacing, vertices, neighbours, touching }.cover();
    moved.iter().for_each(|(vertex, point)| vertices[*vertex] = *point);
    settle(field, spacing, &moved.keys().copied().collect::<Vec<_>>(), vertices);
    split_again(vertices, &moved, triangles);
}

/// Vertices on both sides of edges, and their neighbours, each with its own neighbours: all others of the
/// quadrilaterals that it is a corner of, since an edge may run along either diagonal.
fn beside_edges(normals: &[Point], triangles: &[[u32; 3]]) -> BTreeMap<usize, BTreeSet<usize>> {
    let corners = |pair: &[[u32; 3]]| {
        let [a, b, c] = pair[0].map(|v| v as usize);
        let across = pair[1].iter().find(|v| !pair[0].contains(v));
        [a, b, c, across.map_or(a, |v| *v as usize)]
    };
    let quadrilaterals = || triangles.chunks_exact(2).map(corners);
    // No two are far apart that are both near a third.
    let is_bent = |[a, b, c, d]: &[usize; 4]| {
        let is_near_first = |v: &usize| normals[*a].dot(&normals[*v]) > BENT;
        ![b, c, d].into_iter().all(is_near_first)
    };
    let mut is_beside = vec![false; normals.len()];
    let bent = quadrilaterals().filter(is_bent).flat_map(sides);
    for side in bent.filter(|[a, b]| is_edge(&normals[*a], &normals[*b])) {
        side.iter().for_each(|v| is_beside[*v] = true);
    }
    let mut neighbours: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    let is_near = |corners: &[usize; 4]| corners.iter().any(|v| is_beside[*v]);
    let near = quadrilaterals().filter(is_near).flat_map(sides);
    for [a, b] in near.filter(|[a, b]| a != b && (is_beside[*a] || is_beside[*b])) {
        neighbours.entry(a).or_default().insert(b);
        neighbours.entry(b).or_default().insert(a);
    }
    neighbours
}

/// Each corner with each other.
fn sides([a, b, c, d]: [usize; 4]) -> [[usize; 2]; 6] {
    [[a, b], [b, c], [c, a], [a, d], [b, d], [c, d]]
}

/// What lies beside the edges of the surface.
struct Edges<'a> {
    spacing: f64,
    vertices: &'a [Point],
    neighbours: BTreeMap<usize, BTreeSet<usize>>,
    touching: BTreeMap<usize, Tangent>,
}

impl Edges<'_> {
    /// Where vertices move, so that of any two neighbours over an edge one does: corners first, then those
    /// that are nearest. Every round moves one at least.
    fn cover(&self) -> BTreeMap<usize, Point> {
        let mut moved = BTreeMap::new();
        loop {
            let target = |vertex: &usize| Some((self.target(*vertex, &moved)?, *vertex));
            let mut order: Vec<_> = self.touching.keys().filter_map(target).collect();
            if order.is_empty() {
                return moved;
            }
            let key = |((distance, at), _): &((f64, Meeting), usize)| (!at.is_corner, *distance);
            order.sort_by(|a, b| {
                let ((a, near), (b, far)) = (key(a), key(b));
                a.cmp(&b).then(near.total_cmp(&far))
            });
            // What is left over once others were moved may meet elsewhere.
            for (_, vertex) in order {
                if let Some((_, meeting)) = self.target(vertex, &moved) {
                    moved.insert(vertex, meeting.point);
                }
            }
        }
    }

    /// Where the surface at a vertex meets that at neighbours over an edge, and how far off; all of those
    /// that were not moved or, where that is too far, the nearest.
    fn target(&self, vertex: usize, moved: &BTreeMap<usize, Point>) -> Option<(f64, Meeting)> {
        if moved.contains_key(&vertex) {
            return None;
        }
        let own = self.touching.get(&vertex)?;
        let place = &self.vertices[vertex];
        let others = self.neighbours.get(&vertex)?.iter().filter(|v| !moved.contains_key(v));
        let others = others.filter_map(|v| self.touching.get(v)).filter(|t| own.is_over_edge(t));
        let all: Vec<Tangent> = others.copied().collect();
        let with = |others: &[Tangent]| {
            let meeting = meeting(&[others, &[*own]].concat(), place);
            ((meeting.point - place).norm(), meeting)
        };
        let is_near = |found: &(f64, Meeting)| found.0 <= self.spacing;
        if all.is_empty() {
            return None;
        }
        Some(with(&all)).filter(is_near).or_else(|| {
            let each = all.iter().map(|other| with(&[*other])).filter(is_near);
            each.min_by(|a, b| a.0.total_cmp(&b.0))
        })
    }
}

/// Cuts quadrilaterals of the nets, two triangles each, along the other diagonal where one of the two has
/// three vertices that were `moved` onto a straight edge, and no area.
fn split_again(vertices: &[Point], moved: &BTreeMap<usize, Point>, triangles: &mut [[u32; 3]]) {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| vertices[v as usize]);
        (b - a).cross(&(c - a)).norm()
    };
    let smaller = |pair: &[[u32; 3]]| pair.iter().map(area).fold(f64::INFINITY, f64::min);
    let is_moved = |v: &u32| moved.contains_key(&(*v as usize));
    for pair in triangles.chunks_exact_mut(2) {
        let is_on_edge = pair.iter().any(|triangle| triangle.iter().all(is_moved));
        if !is_on_edge || smaller(pair) > FLAT * pair.iter().map(area).sum::<f64>() {
            continue;
        }
        let Some(alone) = pair[0].iter().position(|v| !pair[1].contains(v)) else { continue };
        let Some(&across) = pair[1].iter().find(|v| !pair[0].contains(v)) else { continue };
        let [first, second, third] = [0, 1, 2].map(|i| pair[0][(alone + i) % 3]);
        let other = [[first, second, across], [first, across, third]];
        if smaller(&other) > smaller(pair) {
            pair.copy_from_slice(&other);
        }
    }
}
