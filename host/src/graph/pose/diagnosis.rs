//! What is wrong with a pose graph, in words its owner understands: ids of poses, not rows of a matrix.
//!
//! A solver that fails on a bad graph can say no more than that a matrix is singular. Here is looked for
//! the causes, before solving ([`Diagnosis::of`]) and after ([`Fit::of`]).

mod chi_squared;
mod fit;
mod information;
mod parts;

pub use fit::{Disagreement, Fit};
pub use information::Kind;

use std::collections::BTreeMap;
use std::fmt;

use nalgebra::{SMatrix, SVector};
use serde::Serialize;

use super::{Edge, Group, PoseGraph};

/// An edge by the names of its poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Name {
    /// Its index in the graph.
    #[serde(skip)]
    pub edge: usize,
    /// Id of the pose it is seen from.
    pub from: u64,
    /// Id of the pose that is seen.
    pub to: u64,
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} → {}", self.from, self.to)
    }
}

/// An information matrix under which some errors are rewarded: χ² has no minimum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Indefinite {
    /// Whose.
    #[serde(flatten)]
    pub name: Name,
    /// Its most negative eigenvalue.
    pub eigenvalue: f64,
}

/// Poses that no weighted edge connects to the others: nothing says where they are beside these.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Part {
    /// Ids, in the order of the graph.
    pub ids: Vec<u64>,
    /// Whether one of them stays where it is.
    pub fixed: bool,
}

/// A pose that can move without any of its edges noticing, to first order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Unconstrained {
    /// Its id.
    pub id: u64,
    /// In how many of its 3 or 6 directions.
    pub directions: usize,
}

/// Several edges between the same two poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Repeated {
    /// The first of them.
    #[serde(flatten)]
    pub name: Name,
    /// How many there are, in both directions.
    pub edges: usize,
    /// How many of them equal one before in every number: most likely the same measurement twice.
    pub copies: usize,
}

/// What can be said of a graph without solving it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// How many poses there are.
    pub poses: usize,
    /// How many edges.
    pub edges: usize,
    /// Connected parts, the largest first; more than one means that their places beside each other are
    /// unknown.
    pub parts: Vec<Part>,
    /// Poses whose edges leave them free in some direction, where they have edges at all.
    pub unconstrained: Vec<Unconstrained>,
    /// Edges with an information matrix that is not positive semidefinite.
    pub indefinite: Vec<Indefinite>,
    /// Edges whose information is zero: they say nothing.
    pub weightless: Vec<Name>,
    /// Poses that were measured more than once against each other.
    pub repeated: Vec<Repeated>,
    /// The smallest and the largest positive entry on the diagonal of any information; `None` where none
    /// is positive.
    pub information: Option<[f64; 2]>,
    /// Median distance that edges measure over median distance of their poses now; `None` where a median
    /// is zero.
    pub stretch: Option<f64>,
}

/// Beyond this ratio of weights a solution has few digits left.
const ILL: f64 = 1e14;

/// Measured distances this far from those between the poses are most likely in another unit.
const STRETCHED: f64 = 30.0;

impl Diagnosis {
    /// Of a graph at its current poses. Takes time linear in its edges.
    pub fn of<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Diagnosis {
        let kinds: Vec<Kind> = graph.edges.iter().map(|edge| Kind::of(&edge.information)).collect();
        let named = |edge: usize| graph.name(edge);
        let indefinite = kinds.iter().enumerate().filter_map(|(edge, kind)| match *kind {
            Kind::Indefinite { eigenvalue } => Some(Indefinite { name: named(edge), eigenvalue }),
            _ => None,
        });
        let weightless = kinds
            .iter()
            .enumerate()
            .filter(|(_, kind)| **kind == Kind::Zero)
            .map(|(e, _)| named(e));
        Diagnosis {
            poses: graph.poses.len(),
            edges: graph.edges.len(),
            parts: parts::of(graph, |edge| kinds[edge] != Kind::Zero),
            unconstrained: unconstrained(graph, &kinds),
            indefinite: indefinite.collect(),
            weightless: weightless.collect(),
            repeated: repeated(graph),
            information: information::range(graph),
            stretch: stretch(graph),
        }
    }

    /// Whether χ² has a minimum at all: no information matrix is indefinite.
    pub fn is_bounded(&self) -> bool {
        self.indefinite.is_empty()
    }

    /// What its owner should know, a sentence each, the worst first.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(first) = self.indefinite.first() {
            remarks.push(format!(
                "{} of {} edges have an information matrix that is not positive semidefinite, so that χ² \
                 has no minimum; the first is {}, with eigenvalue {:.3e}",
                self.indefinite.len(),
                self.edges,
                first.name,
                first.eigenvalue
            ));
        }
        if let [largest, others @ ..] = &self.parts[..]
            && !others.is_empty()
        {
            let first = others.iter().take(3).map(|part| listed(&part.ids)).collect::<Vec<_>>();
            let more = if others.len() > 3 { " and others" } else { "" };
            remarks.push(format!(
                "no edge connects {} poses to the other {}, so that their places beside each other are \
                 not known; {} parts, the smaller ones: {}{more}",
                others.iter().map(|part| part.ids.len()).sum::<usize>(),
                largest.ids.len(),
                self.parts.len(),
                first.join("; "),
            ));
        }
        if !self.unconstrained.is_empty() {
            let ids: Vec<u64> = self.unconstrained.iter().map(|pose| pose.id).collect();
            remarks.push(format!(
                "{} poses can move without any of their edges noticing: {}",
                ids.len(),
                listed(&ids)
            ));
        }
        if let Some(first) = self.weightless.first() {
            remarks.push(format!(
                "{} edges have no information at all; the first is {first}",
                self.weightless.len()
            ));
        }
        let copies: usize = self.repeated.iter().map(|pair| pair.copies).sum();
        if let Some(first) = self.repeated.iter().find(|pair| pair.copies > 0) {
            remarks.push(format!(
                "{copies} edges are the same as one before in every number and count as often; the first \
                 is {}",
                first.name
            ));
        }
        if let Some([smallest, largest]) = self.information
            && largest > ILL * smallest
        {
            remarks.push(format!(
                "information goes from {smallest:.1e} to {largest:.1e}: of the digits of the solution few \
                 are sure"
            ));
        }
        if let Some(stretch) = self.stretch
            && !(1.0 / STRETCHED..STRETCHED).contains(&stretch)
        {
            remarks.push(format!(
                "edges measure distances {stretch:.2e} times those between their poses: not the same unit?"
            ));
        }
        remarks
    }
}

/// The first few ids of many.
fn listed(ids: &[u64]) -> String {
    const SHOWN: usize = 8;
    let first: Vec<String> = ids.iter().take(SHOWN).map(u64::to_string).collect();
    let more = ids.len().saturating_sub(SHOWN);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{rest}", first.join(", "))
}

impl<G: Group<D>, const D: usize> PoseGraph<G, D> {
    /// An edge, by the names of its poses.
    pub(crate) fn name(&self, edge: usize) -> Name {
        let Edge { from, to, .. } = self.edges[edge];
        Name { edge, from: self.ids[from], to: self.ids[to] }
    }
}

/// Poses none of whose edges has full rank may be free: the sum of what those measure says so.
fn unconstrained<G: Group<D>, const D: usize>(
    graph: &PoseGraph<G, D>,
    kinds: &[Kind],
) -> Vec<Unconstrained> {
    let mut held = vec![false; graph.poses.len()];
    graph.fixed.iter().for_each(|&pose| held[pose] = true);
    for (edge, kind) in graph.edges.iter().zip(kinds) {
        if matches!(kind, Kind::Definite) {
            held[edge.from] = true;
            held[edge.to] = true;
        }
    }
    let mut sums: BTreeMap<usize, SMatrix<f64, D, D>> = BTreeMap::new();
    for (edge, kind) in graph.edges.iter().zip(kinds) {
        for pose in [edge.from, edge.to] {
            if !held[pose] && *kind == Kind::Semidefinite {
                *sums.entry(pose).or_insert_with(SMatrix::zeros) +=
                    curvature(edge, &graph.poses, pose);
            }
        }
    }
    let free = |(pose, sum): (usize, SMatrix<f64, D, D>)| {
        let directions = information::nullity(&sum);
        (directions > 0).then(|| Unconstrained { id: graph.ids[pose], directions })
    };
    sums.into_iter().filter_map(free).collect()
}

/// JᵀΩJ of the error by one of its poses, by central differences: how the edge holds that pose.
fn curvature<G: Group<D>, const D: usize>(
    edge: &Edge<G, D>,
    poses: &[G],
    pose: usize,
) -> SMatrix<f64, D, D> {
    const STEP: f64 = 1e-6;
    let error = |tangent: SVector<f64, D>| {
        let moved = |i: usize| if i == pose { poses[i].retract(&tangent) } else { poses[i] };
        G::error(&moved(edge.from), &moved(edge.to), &edge.measured)
    };
    let columns: Vec<SVector<f64, D>> = (0..D)
        .map(|axis| {
            let mut step = SVector::<f64, D>::zeros();
            step[axis] = STEP;
            (error(step) - error(-step)) / (2.0 * STEP)
        })
        .collect();
    let jacobian = SMatrix::<f64, D, D>::from_columns(&columns);
    jacobian.transpose() * edge.information * jacobian
}

fn repeated<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Vec<Repeated> {
    let pair = |edge: usize| {
        let Edge { from, to, .. } = graph.edges[edge];
        (from.min(to), from.max(to))
    };
    let mut order: Vec<usize> = (0..graph.edges.len()).collect();
    order.sort_by_key(|&edge| (pair(edge), edge));
    let mut repeated: Vec<Repeated> = order
        .chunk_by(|&a, &b| pair(a) == pair(b))
        .filter(|edges| edges.len() > 1)
        .map(|edges| {
            let same = |&(i, &edge): &(usize, &usize)| {
                edges[..i].iter().any(|&before| graph.edges[before] == graph.edges[edge])
            };
            // Of very many measurements of one pair only the first are compared with each other.
            let copies = edges.iter().enumerate().take(100).filter(same).count();
            Repeated { name: graph.name(edges[0]), edges: edges.len(), copies }
        })
        .collect();
    repeated.sort_by_key(|pair| pair.name.edge);
    repeated
}

fn stretch<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> Option<f64> {
    let measured = median(graph.edges.iter().map(|edge| length(&edge.measured)))?;
    let between = |edge: &Edge<G, D>| graph.poses[edge.from].between(&graph.poses[edge.to]);
    let current = median(graph.edges.iter().map(|edge| length(&between(edge))))?;
    (measured > 0.0 && current > 0.0).then(|| measured / current)
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// How far a motion goes, metres: its error against no motion is the motion itself, translation first.
fn length<G: Group<D>, const D: usize>(motion: &G) -> f64 {
    G::error(&G::identity(), motion, &G::identity()).rows(0, G::DIMENSION).norm()
}

#[cfg(test)]
mod tests;
