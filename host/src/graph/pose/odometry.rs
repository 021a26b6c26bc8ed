//! Initial values from relative measurements alone: a tree of edges composed outwards from the poses
//! that are held.

use std::collections::VecDeque;

use super::{Error, Group, PoseGraph};

/// Sets that grow together (Tarjan 1975).
#[derive(Clone, Debug)]
pub(super) struct Sets(Vec<usize>);

impl Sets {
    /// Of one member each.
    pub fn new(count: usize) -> Self {
        Sets((0..count).collect())
    }

    /// The first member of a member's set.
    pub fn root(&mut self, mut item: usize) -> usize {
        while self.0[item] != item {
            self.0[item] = self.0[self.0[item]];
            item = self.0[item];
        }
        item
    }

    /// Whether they were two sets.
    pub fn join(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        // The lower index is the root: a set is known by its first member.
        self.0[a.max(b)] = a.min(b);
        a != b
    }
}

/// Indices of the poses that stay where they are.
fn held<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> impl Iterator<Item = usize> {
    graph.held().into_iter().enumerate().filter_map(|(pose, held)| held.then_some(pose))
}

/// Which edges are odometry: those between poses whose names follow each other in the ascending order
/// of all names. One entry per edge.
///
/// A file numbers its poses in order of time, consecutively or not, so that these are the
/// measurements of a robot's own motion; all others close loops. Where several edges measure
/// the same step, one is odometry: that of the shortest motion, as a robot moves little in one step and
/// false closures lead anywhere; of equals the first.
pub fn odometry_edges<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Vec<bool> {
    let ranks = ranks(graph);
    let mut step: Vec<Option<(f64, usize)>> = vec![None; graph.poses.len()];
    for (index, edge) in graph.edges.iter().enumerate() {
        let Some((&a, &b)) = ranks.get(edge.from).zip(ranks.get(edge.to)) else { continue };
        if a.abs_diff(b) == 1 {
            let motion = G::identity().local(&edge.measured);
            let length = motion.rows(0, G::DIMENSION).norm();
            let best = &mut step[a.min(b)];
            if best.is_none_or(|(shortest, _)| length < shortest) {
                *best = Some((length, index));
            }
        }
    }
    let mut odometry = vec![false; graph.edges.len()];
    step.into_iter().flatten().for_each(|(_, edge)| odometry[edge] = true);
    odometry
}

/// The place of every pose in the ascending order of names.
pub(super) fn ranks<G, const D: usize>(graph: &PoseGraph<G, D>) -> Vec<usize> {
    let mut order: Vec<usize> = (0..graph.poses.len()).collect();
    order.sort_by_key(|&pose| graph.ids.get(pose));
    let mut ranks = vec![0; order.len()];
    for (at, &pose) in order.iter().enumerate() {
        ranks[pose] = at;
    }
    ranks
}

/// Initial values of all poses by composing measurements outwards from those that are held: the
/// fixed ones and, in every connected part without one, the first.
///
/// Odometry ([`odometry_edges`]) is followed where there is any; what it leaves in separate pieces
/// is joined by other edges, in the order of the graph. The cost is linear in the numbers of poses and
/// edges. Information plays no part.
///
/// ```
/// use tactile_host::graph::pose::odometry::odometry;
/// use tactile_host::graph::pose::{Edge, PoseGraph2, Se2};
///
/// let step = |from, to| Edge {
///     from,
///     to,
///     measured: Se2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2),
///     information: nalgebra::Matrix3::identity(),
/// };
/// let poses = vec![Se2::new(0.0, 0.0, 0.0); 4];
/// let edges = vec![step(0, 1), step(1, 2), step(2, 3), step(3, 0)];
/// let square = PoseGraph2 { ids: vec![3, 5, 8, 9], poses, edges, fixed: vec![] };
/// let poses = odometry(&square)?;
/// assert!((poses[2].translation - nalgebra::Vector2::new(1.0, 1.0)).norm() < 1e-12);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// Indices that lead nowhere, numbers that are not finite, information that is none.
pub fn odometry<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Result<Vec<G>, Error> {
    graph.check()?;
    let held: Vec<usize> = held(graph).collect();
    let mut sets = Sets::new(graph.poses.len());
    for pair in held.windows(2) {
        sets.join(pair[0], pair[1]);
    }
    let mut branches = vec![vec![]; graph.poses.len()];
    let chain = odometry_edges(graph);
    let first = (0..graph.edges.len()).filter(|&edge| chain[edge]);
    let then = (0..graph.edges.len()).filter(|&edge| !chain[edge]);
    for index in first.chain(then) {
        let edge = &graph.edges[index];
        if sets.join(edge.from, edge.to) {
            branches[edge.from].push(index);
            branches[edge.to].push(index);
        }
    }

    let mut poses = graph.poses.clone();
    let mut reached = vec![false; poses.len()];
    for &pose in &held {
        reached[pose] = true;
    }
    let mut queue = VecDeque::from(held);
    while let Some(pose) = queue.pop_front() {
        for &index in &branches[pose] {
            let edge = &graph.edges[index];
            let (next, place) = if edge.from == pose {
                (edge.to, poses[pose].compose(&edge.measured))
            } else {
                (edge.from, poses[pose].compose(&edge.measured.inverse()))
            };
            if !reached[next] {
                reached[next] = true;
                poses[next] = place;
                queue.push_back(next);
            }
        }
    }
    Ok(poses)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::Se2;
    use super::super::grid::{distance, grid, planar, spatial};
    use super::*;

    /// `graph` with estimates forgotten, but for those held.
    fn forgotten<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> PoseGraph<G, D> {
        let mut start = graph.clone();
        start.poses.fill(G::identity());
        for pose in held(graph) {
            start.poses[pose] = graph.poses[pose];
        }
        start
    }

    fn exact<G: Group<D>, const D: usize>(mut graph: PoseGraph<G, D>, fixed: usize) {
        graph.fixed = vec![fixed % graph.poses.len(), (7 * fixed) % graph.poses.len()];
        let found = odometry(&forgotten(&graph)).unwrap();
        assert!(distance(&found, &graph.poses) < 1e-18);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn exact_measurements_give_the_truth(
            plane in planar(0.0), space in spatial(0.0), fixed in 0usize..40,
        ) {
            exact(plane, fixed);
            exact(space, fixed);
        }
    }

    #[test]
    fn odometry_goes_before_loop_closures() {
        let mut graph = grid::<Se2, 3>(1, 5, 0.0);
        let truth = graph.poses.clone();
        let chain = odometry_edges(&graph);
        assert_eq!(chain.iter().filter(|&&follows| follows).count(), graph.poses.len() - 1);
        for (edge, _) in graph.edges.iter_mut().zip(&chain).filter(|(_, chain)| !**chain) {
            edge.measured = Se2::new(100.0, 100.0, 2.0);
        }
        // Where an edge stands in the file does not matter, nor does the order of the poses.
        graph.edges.reverse();
        assert!(distance(&odometry(&graph).unwrap(), &truth) < 1e-18);
        let back = |index: &mut usize| *index = truth.len() - 1 - *index;
        graph.ids.reverse();
        graph.poses.reverse();
        graph.edges.iter_mut().for_each(|edge| (back(&mut edge.from), back(&mut edge.to)).0);
        let mut reversed = odometry(&graph).unwrap();
        reversed.reverse();
        assert!(distance(&reversed, &truth) < 1e-18);
    }

    #[test]
    fn every_part_stands_on_its_first_pose() {
        let mut graph = grid::<Se2, 3>(2, 3, 0.0);
        let other = grid::<Se2, 3>(3, 2, 0.0);
        graph.edges.extend(other.edges.iter().map(|edge| {
            let mut edge = edge.clone();
            edge.from += 9;
            edge.to += 9;
            edge
        }));
        graph.poses.extend(&other.poses);
        graph.ids.extend(1000..1004);
        graph.poses.push(Se2::new(4.0, 5.0, 6.0));
        graph.ids.push(0);
        assert!(held(&graph).eq([0, 9, 13]));
        assert!(distance(&odometry(&forgotten(&graph)).unwrap(), &graph.poses) < 1e-18);
        graph.fixed = vec![4, 2, 4];
        assert!(held(&graph).eq([2, 4, 9, 13]));
    }

    #[test]
    fn little_or_nothing_is_returned_as_it_is() {
        let none: PoseGraph<Se2, 3> =
            PoseGraph { ids: vec![], poses: vec![], edges: vec![], fixed: vec![] };
        assert_eq!(odometry(&none), Ok(vec![]));
        let one = PoseGraph { ids: vec![5], poses: vec![Se2::new(1.0, 2.0, 3.0)], ..none };
        assert_eq!(odometry(&one), Ok(one.poses.clone()));
    }

    #[test]
    fn wrong_graphs_are_refused() {
        let graph = grid::<Se2, 3>(4, 3, 0.0);
        let refused = |change: fn(&mut PoseGraph<Se2, 3>)| {
            let mut graph = graph.clone();
            change(&mut graph);
            odometry(&graph).unwrap_err()
        };
        let poses = 9;
        let missing = refused(|graph| graph.edges[3].to = 9);
        assert_eq!(missing, Error::MissingPose { edge: 3, pose: 9, poses });
        assert_eq!(refused(|graph| graph.edges[3].to = 3), Error::Loop { edge: 3, id: 16 });
        let missing = refused(|graph| graph.fixed = vec![9]);
        assert_eq!(missing, Error::MissingFixed { pose: 9, poses });
        let not_finite = Error::EdgeNotFinite { edge: 1, from: 10, to: 13 };
        assert_eq!(refused(|graph| graph.edges[1].measured.angle = f64::NAN), not_finite);
        let not_finite = refused(|graph| graph.poses[0].translation.x = f64::NAN);
        assert_eq!(not_finite, Error::PoseNotFinite { id: 7 });
    }
}
