//! Connected parts of a graph.

use super::Part;
use crate::graph::pose::{Group, PoseGraph};

/// The part of each pose, as the smallest index in it; edges that are not `counted` connect nothing.
fn roots<G: Group<D>, const D: usize>(
    graph: &PoseGraph<G, D>,
    counted: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..graph.poses.len()).collect();
    // The root of a tree, halving the way to it.
    let root = |parent: &mut [usize], mut pose: usize| {
        while parent[pose] != pose {
            parent[pose] = parent[parent[pose]];
            pose = parent[pose];
        }
        pose
    };
    for (index, edge) in graph.edges.iter().enumerate() {
        if counted(index) {
            let (a, b) = (root(&mut parent, edge.from), root(&mut parent, edge.to));
            // The smaller one stays a root.
            parent[a.max(b)] = a.min(b);
        }
    }
    (0..graph.poses.len()).map(|pose| root(&mut parent, pose)).collect()
}

/// The connected parts, the largest first, of equal ones the one whose first pose comes first.
pub(super) fn of<G: Group<D>, const D: usize>(
    graph: &PoseGraph<G, D>,
    counted: impl Fn(usize) -> bool,
) -> Vec<Part> {
    let mut fixed = vec![false; graph.poses.len()];
    graph.fixed.iter().for_each(|&pose| fixed[pose] = true);
    let roots = roots(graph, counted);
    let mut place = vec![usize::MAX; graph.poses.len()];
    let mut parts: Vec<Part> = Vec::new();
    for (pose, &root) in roots.iter().enumerate() {
        if place[root] == usize::MAX {
            place[root] = parts.len();
            parts.push(Part { ids: Vec::new(), fixed: false });
        }
        let part = &mut parts[place[root]];
        part.ids.push(graph.ids[pose]);
        part.fixed |= fixed[pose];
    }
    parts.sort_by_key(|part| std::cmp::Reverse(part.ids.len()));
    parts
}
