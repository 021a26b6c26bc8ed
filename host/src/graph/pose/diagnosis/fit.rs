//! How well a graph fits together at its poses.

use std::collections::HashSet;

use serde::Serialize;

use super::chi_squared::survival;
use super::information::nullity;
use super::{Kind, Name, parts};
use crate::graph::pose::{Group, PoseGraph};

/// An edge that contradicts the poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Disagreement {
    /// Which.
    #[serde(flatten)]
    pub name: Name,
    /// Its eᵀ Ω e.
    pub chi2: f64,
    /// How probable it is that noise of its covariance makes one this large.
    pub p: f64,
}

/// What the edges say of the poses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// Σ eᵀ Ω e.
    pub chi2: f64,
    /// How many numbers were measured beyond those that the poses need: the χ² to expect at the optimum
    /// if information is the noise's.
    pub degrees: usize,
    /// How many edges noise alone would hardly have made: less than 0.01 of them are expected among as
    /// many edges.
    pub improbable: usize,
    /// The edges with the largest χ², the worst first.
    pub worst: Vec<Disagreement>,
}

/// As many of all edges may be called improbable by mistake.
const MISTAKES: f64 = 0.01;

impl Fit {
    /// Of a graph at its current poses, which should be the optimum, with the `count` worst edges.
    pub fn of<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>, count: usize) -> Fit {
        let mut edges: Vec<(f64, usize)> = graph
            .edges
            .iter()
            .enumerate()
            .map(|(index, edge)| (edge.chi2(&graph.poses), index))
            .collect();
        let chi2 = edges.iter().map(|(chi2, _)| chi2).sum();
        edges.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let judged = |&(chi2, edge): &(f64, usize)| {
            let information = &graph.edges[edge].information;
            let p = match Kind::of(information) {
                Kind::Definite => survival(chi2, D),
                Kind::Semidefinite => survival(chi2, D - nullity(information)),
                Kind::Zero => 1.0,
                Kind::Indefinite { .. } => f64::NAN,
            };
            Disagreement { name: graph.name(edge), chi2, p }
        };
        let all = edges.len() as f64;
        // p falls as χ² rises, but for edges of lower rank: these are too few to be looked for. Indefinite ones have none.
        let is_mistaken = |e: &Disagreement| e.p * all < MISTAKES;
        let with_p = edges.iter().map(judged).filter(|e| !e.p.is_nan());
        let improbable = with_p.take_while(is_mistaken).count();
        Fit {
            chi2,
            degrees: degrees(graph),
            improbable,
            worst: edges.iter().take(count).map(judged).collect(),
        }
    }

    /// χ² over what is expected; `None` where nothing was measured twice.
    pub fn per_degree(&self) -> Option<f64> {
        (self.degrees > 0).then(|| self.chi2 / self.degrees as f64)
    }

    /// What the graph's owner should know, a sentence each.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        match self.per_degree() {
            Some(ratio) if ratio > 100.0 => remarks.push(format!(
                "errors are {} times what the information says: edges that contradict each other, a \
                 local minimum, or information in another unit",
                factor(ratio.sqrt())
            )),
            Some(ratio) if ratio < 1e-4 => remarks.push(format!(
                "errors are {} times smaller than the information says: information in another unit, \
                 or edges made from the poses",
                factor(1.0 / ratio.sqrt().max(f64::MIN_POSITIVE))
            )),
            _ => (),
        }
        if let Some(first) = self.worst.first()
            && self.improbable > 0
        {
            remarks.push(format!(
                "{} edges disagree with the others more than their noise explains; the worst is {}, χ² \
                 {:.4} (p = {:.1e})",
                self.improbable, first.name, first.chi2, first.p
            ));
        }
        remarks
    }
}

/// A factor as it is read best.
fn factor(factor: f64) -> String {
    if factor < 1e6 { format!("{factor:.0}") } else { format!("{factor:.0e}") }
}

/// Measured numbers less those that the poses need.
fn degrees<G: Group<D>, const D: usize>(graph: &PoseGraph<G, D>) -> usize {
    let kinds: Vec<Kind> = graph.edges.iter().map(|e| Kind::of(&e.information)).collect();
    let rank = |(index, kind): (usize, &Kind)| match kind {
        Kind::Zero => 0,
        Kind::Semidefinite => D - nullity(&graph.edges[index].information),
        Kind::Definite | Kind::Indefinite { .. } => D,
    };
    let measured: usize = kinds.iter().enumerate().map(rank).sum();
    let parts = parts::of(graph, |edge| kinds[edge] != Kind::Zero);
    // A part that nothing holds is held at one of its poses.
    let fixed: HashSet<usize> = graph.fixed.iter().copied().collect();
    let held = fixed.len() + parts.iter().filter(|part| !part.fixed).count();
    measured.saturating_sub(D * graph.poses.len().saturating_sub(held))
}
