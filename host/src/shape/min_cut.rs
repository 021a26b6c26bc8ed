//! Minimum cuts of small graphs: which nodes belong to the source when the rest belongs to the sink
//! and what is cut costs least (Dinic's algorithm, Soviet Math. Doklady 11, 1970).

use std::collections::VecDeque;

/// What is left of a capacity below this share of the greatest is rounding.
const ROUNDING: f64 = 1e-12;

/// A directed graph between a source and a sink.
///
/// ```
/// # use tactile_host::shape::min_cut::Graph;
/// let mut graph = Graph::new(2);
/// graph.from_source(0, 3.0);
/// graph.to_sink(1, 2.0);
/// graph.connect(0, 1, 1.0, 0.0);
/// assert_eq!(graph.cut(), (1.0, vec![true, false]));
/// ```
#[derive(Clone, Debug)]
pub struct Graph {
    /// Of every node, source and sink last, the arcs that leave it.
    leaving: Vec<Vec<usize>>,
    /// Where each arc leads; arc `i ^ 1` is its reverse.
    ends: Vec<usize>,
    /// What each arc still takes.
    rest: Vec<f64>,
}

impl Graph {
    /// `nodes` nodes without arcs.
    pub fn new(nodes: usize) -> Graph {
        Graph { leaving: vec![Vec::new(); nodes + 2], ends: Vec::new(), rest: Vec::new() }
    }

    fn source(&self) -> usize {
        self.leaving.len() - 2
    }

    fn sink(&self) -> usize {
        self.leaving.len() - 1
    }

    fn arc(&mut self, from: usize, to: usize, there: f64, back: f64) {
        // What is not a number, or negative, takes nothing.
        for (from, to, capacity) in [(from, to, there), (to, from, back)] {
            self.leaving[from].push(self.ends.len());
            self.ends.push(to);
            self.rest.push(capacity.max(0.0));
        }
    }

    /// Costs `there` when `from` is on the source's side and `to` on the sink's, `back` the other
    /// way round. Nodes that do not exist are left out.
    pub fn connect(&mut self, from: usize, to: usize, there: f64, back: f64) {
        if from.max(to) < self.source() {
            self.arc(from, to, there, back);
        }
    }

    /// Costs `capacity` when `node` is on the sink's side.
    pub fn from_source(&mut self, node: usize, capacity: f64) {
        if node < self.source() {
            self.arc(self.source(), node, capacity, 0.0);
        }
    }

    /// Costs `capacity` when `node` is on the source's side.
    pub fn to_sink(&mut self, node: usize, capacity: f64) {
        if node < self.source() {
            self.arc(node, self.sink(), capacity, 0.0);
        }
    }

    /// The least cost, and which nodes are then on the source's side (as few as possible).
    pub fn cut(mut self) -> (f64, Vec<bool>) {
        let least =
            ROUNDING * self.rest.iter().copied().filter(|c| c.is_finite()).fold(0.0, f64::max);
        let mut total = 0.0;
        loop {
            let levels = self.levels(least);
            if levels[self.sink()] == usize::MAX {
                let nodes = self.source();
                return (total, levels[..nodes].iter().map(|l| *l != usize::MAX).collect());
            }
            let mut next = vec![0; self.leaving.len()];
            loop {
                let pushed = self.augment(&levels, &mut next, least);
                if pushed <= 0.0 {
                    break;
                }
                total += pushed;
            }
        }
    }

    /// Arcs from the source to each node along arcs that are not full.
    fn levels(&self, least: f64) -> Vec<usize> {
        let mut levels = vec![usize::MAX; self.leaving.len()];
        levels[self.source()] = 0;
        let mut queue = VecDeque::from([self.source()]);
        while let Some(node) = queue.pop_front() {
            for &arc in &self.leaving[node] {
                let end = self.ends[arc];
                if self.rest[arc] > least && levels[end] == usize::MAX {
                    levels[end] = levels[node] + 1;
                    queue.push_back(end);
                }
            }
        }
        levels
    }

    /// Sends what one way from source to sink takes; zero when there is no way left.
    fn augment(&mut self, levels: &[usize], next: &mut [usize], least: f64) -> f64 {
        let (source, sink) = (self.source(), self.sink());
        let mut way: Vec<usize> = Vec::new();
        loop {
            let node = way.last().map_or(source, |arc| self.ends[*arc]);
            if node == sink {
                let flow = way.iter().map(|arc| self.rest[*arc]).fold(f64::INFINITY, f64::min);
                for arc in &way {
                    self.rest[*arc] -= flow;
                    self.rest[arc ^ 1] += flow;
                }
                return flow;
            }
            let found = (next[node]..self.leaving[node].len()).find(|i| {
                let arc = self.leaving[node][*i];
                self.rest[arc] > least && levels[self.ends[arc]] == levels[node] + 1
            });
            match found {
                Some(i) => {
                    next[node] = i;
                    way.push(self.leaving[node][i]);
                }
                None => {
                    next[node] = self.leaving[node].len();
                    let Some(arc) = way.pop() else { return 0.0 };
                    let before = way.last().map_or(source, |a| self.ends[*a]);
                    debug_assert_eq!(self.leaving[before][next[before]], arc);
                    next[before] += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn graphs_without_arcs_or_nodes_cost_nothing() {
        assert_eq!(Graph::new(0).cut(), (0.0, vec![]));
        let mut graph = Graph::new(1);
        graph.to_sink(0, 1.0);
        graph.connect(0, 7, 1.0, 1.0);
        graph.from_source(0, f64::NAN);
        assert_eq!(graph.cut(), (0.0, vec![false]));
    }

    proptest! {
        /// Against every labelling of a small graph.
        #[test]
        fn no_labelling_costs_less(
            unary in prop::collection::vec((0.0f64..3.0, 0.0f64..3.0), 6),
            pairs in prop::collection::vec((0usize..6, 0usize..6, 0.0f64..2.0, 0.0f64..2.0), 0..15),
        ) {
            let mut graph = Graph::new(6);
            for (node, (source, sink)) in unary.iter().enumerate() {
                graph.from_source(node, *source);
                graph.to_sink(node, *sink);
            }
            for (a, b, there, back) in &pairs {
                graph.connect(*a, *b, *there, *back);
            }
            let cost = |inside: &dyn Fn(usize) -> bool| {
                let single = unary.iter().enumerate();
                let single: f64 = single.map(|(i, (s, t))| if inside(i) { t } else { s }).sum();
                let pair = pairs.iter().map(|(a, b, there, back)| match (inside(*a), inside(*b)) {
                    (true, false) => *there,
                    (false, true) => *back,
                    _ => 0.0,
                });
                single + pair.sum::<f64>()
            };
            let (least, labels) = graph.cut();
            prop_assert!((cost(&|i| labels[i]) - least).abs() < 1e-9);
            for set in 0..64_usize {
                prop_assert!(cost(&|i| set >> i & 1 == 1) > least - 1e-9);
            }
        }
    }
}
