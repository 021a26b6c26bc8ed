//! Sheets of a surface that meet in an edge or a vertex of its nets, taken apart.
//!
//! Nets have one vertex in a cell, however many sheets of the surface cross it, and four triangles at the
//! edge between two cells where of the nodes of their common side one and that across from it lie in the
//! object. Each sheet gets vertices of its own there, as in dual marching cubes (Nielson, IEEE Visualization
//! 2004).

use std::iter::once;

use super::surface::Groups;

/// A side of a triangle: its ends, the lesser first, and the corner where it starts.
type Side = (u64, u32);

/// Of a corner its triangle and its place there.
fn place(corner: u32) -> (usize, usize) {
    (corner as usize / 3, corner as usize % 3)
}

/// Names the corners of triangles anew, so that every edge has two triangles and those at a vertex are one
/// fan. Gives, of each new name, the old one of the same place, or two old ones that it is halfway between.
///
/// Triangles come in pairs, each a quadrilateral of the nets; `outside` has of each the node of the lattice
/// on its outside. The object hangs together at an edge, the outside does not: a sheet goes around one node.
pub(super) fn separate(triangles: &mut Vec<[u32; 3]>, outside: &[usize]) -> Vec<[u32; 2]> {
    let mut sides: Vec<Side> = Vec::with_capacity(3 * triangles.len());
    for [a, b, c] in triangles.iter() {
        for [a, b] in [[a, b], [b, c], [c, a]].map(|[a, b]| [*a.min(b), *a.max(b)].map(u64::from)) {
            sides.push((a << 32 | b, sides.len() as u32));
        }
    }
    sides.sort_unstable();
    // Each corner is a vertex of its own until a side joins it to that of another triangle.
    let mut corners = Groups::new(3 * triangles.len());
    let next = |corner: u32| if corner % 3 == 2 { corner - 2 } else { corner + 1 };
    let mut join = |one: &Side, two: &Side| {
        corners.join(one.1, next(two.1));
        corners.join(next(one.1), two.1);
    };
    let mut met = Vec::new();
    for meeting in sides.chunk_by(|a, b| a.0 == b.0) {
        if let [one, two] = meeting {
            join(one, two);
        } else if let Some(pairs) = paired(meeting, outside) {
            pairs.iter().for_each(|[one, two]| join(one, two));
            met.push(pairs);
        }
    }
    let mut names = vec![u32::MAX; 3 * triangles.len()];
    let mut old: Vec<[u32; 2]> = Vec::new();
    for (corner, v) in (0..).zip(triangles.iter_mut().flatten()) {
        let name = &mut names[corners.root(corner) as usize];
        if *name == u32::MAX {
            *name = old.len() as u32;
            old.push([*v; 2]);
        }
        *v = *name;
    }
    if !met.is_empty() {
        halve(triangles, &met, &mut old);
    }
    old
}

/// Which of four sides with the same ends belong to one sheet.
fn paired(meeting: &[Side], outside: &[usize]) -> Option<[[Side; 2]; 2]> {
    let node = |side: &Side| outside[side.1 as usize / 6];
    let first = meeting.first()?;
    let (own, other): (Vec<Side>, Vec<Side>) =
        meeting.iter().partition(|side| node(side) == node(first));
    Some([own.try_into().ok()?, other.try_into().ok()?])
}

/// Where sheets that met at a side still have both its ends in common, one of them gets a vertex halfway.
fn halve(triangles: &mut Vec<[u32; 3]>, met: &[[[Side; 2]; 2]], old: &mut Vec<[u32; 2]>) {
    let whole = triangles.clone();
    let from_to = |side: &Side| {
        let (t, i) = place(side.1);
        [whole[t][i], whole[t][(i + 1) % 3]]
    };
    // Of each triangle that is added the one that it was a part of.
    let mut parents = Vec::new();
    for [one, two] in met {
        let [mut ours, mut theirs] = [one, two].map(|pair| from_to(&pair[0]));
        ours.sort_unstable();
        theirs.sort_unstable();
        if ours != theirs {
            continue;
        }
        let middle = old.len() as u32;
        old.push([(two[0].0 >> 32) as u32, two[0].0 as u32]);
        for side in two {
            let [from, to] = from_to(side);
            let t = place(side.1).0;
            let parts = (whole.len()..).zip(&parents).filter(|part| *part.1 == t);
            let mut parts = once(t).chain(parts.map(|part| part.0));
            let start = |part: usize| {
                let corners = triangles[part];
                let is_start = |i: &usize| corners[*i] == from && corners[(i + 1) % 3] == to;
                Some((part, (0..3).find(is_start)?))
            };
            let Some((part, i)) = parts.find_map(start) else { continue };
            let third = triangles[part][(i + 2) % 3];
            triangles[part][(i + 1) % 3] = middle;
            triangles.push([middle, to, third]);
            parents.push(t);
        }
    }
}
