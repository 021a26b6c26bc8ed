//! What is said of an optimised graph, to people and to programs.

use serde_json::{Value, json};

use super::solve::Solved;
use crate::experiment::peak_memory;
use crate::graph::pose::Start;
use crate::graph::pose::certificate::Certificate;
use crate::graph::pose::diagnosis::Diagnosis;
use crate::graph::pose::g2o::{G2o, Graph};

/// What the reader noticed, a sentence each.
pub(super) fn remarks(file: &G2o) -> Vec<String> {
    let mut remarks: Vec<String> = file
        .skipped
        .iter()
        .map(|s| {
            format!(
                "{} lines {} are not understood (the first is line {})",
                s.count, s.kind, s.line
            )
        })
        .collect();
    if file.normalised > 0 {
        remarks.push(format!("{} quaternions are not of length 1; made so", file.normalised));
    }
    if file.wide_angles > 0 {
        remarks.push(format!(
            "{} angles are beyond a full turn: expected radians; wrapped",
            file.wide_angles
        ));
    }
    remarks
}

/// Everything there is to say.
pub(super) struct Told<'a> {
    pub file: &'a G2o,
    pub diagnosis: &'a Diagnosis,
    pub solved: &'a Solved,
    /// How long reading took, seconds.
    pub reading: f64,
}

impl Told<'_> {
    fn is_certified(&self) -> bool {
        self.solved.certificate.is_some_and(|c| c.is_certified())
    }

    fn dimension(&self) -> usize {
        match self.file.graph {
            Graph::Planar(_) => 2,
            Graph::Spatial(_) => 3,
        }
    }

    /// For programs.
    pub fn json(&self) -> Value {
        let Told { file, diagnosis, solved, reading } = self;
        let skipped = file.skipped.iter();
        json!({
            "initial_chi2": solved.initial_chi2,
            "final_chi2": solved.final_chi2,
            "iterations": solved.iterations,
            "seconds": solved.seconds,
            "certified": self.is_certified(),
            "lower_bound": solved.certificate.map(|c| c.lower_bound()),
            "certificate_eigenvalue": solved.certificate.and_then(|c| c.eigenvalue()),
            "certificate_seconds": solved.certifying,
            "converged": solved.converged,
            "start": solved.start.map(Start::name),
            "start_chi2": solved.start_chi2,
            "final_cost": solved.final_cost,
            "degrees_of_freedom": solved.fit.degrees,
            "reading_seconds": reading,
            "peak_memory_bytes": peak_memory(),
            "dimension": self.dimension(),
            "poses": diagnosis.poses,
            "edges": diagnosis.edges,
            "outliers": solved.outliers,
            "improbable_edges": solved.fit.improbable,
            "worst_edges": solved.fit.worst,
            "remarks": diagnosis.remarks().into_iter().chain(solved.remarks()).collect::<Vec<_>>(),
            "parts": diagnosis.parts.iter().map(|part| json!({
                "poses": part.ids.len(),
                "first": part.ids.first(),
                "fixed": part.fixed,
            })).collect::<Vec<_>>(),
            "unconstrained": diagnosis.unconstrained,
            "repeated": diagnosis.repeated.len(),
            "skipped": skipped.map(|s| json!({
                "kind": s.kind, "count": s.count, "line": s.line,
            })).collect::<Vec<_>>(),
        })
    }

    /// For people.
    pub fn text(&self) -> String {
        let Told { diagnosis, solved, reading, .. } = self;
        let mut lines = vec![format!(
            "{} poses, {} edges in {} dimensions, read in {reading:.3} s",
            diagnosis.poses,
            diagnosis.edges,
            self.dimension()
        )];
        let initial = match self.file.has_poses {
            true => "at the file's poses",
            false => "at poses from odometry, since the file has none",
        };
        lines.push(format!("χ² {:.6} {initial}", solved.initial_chi2));
        if let Some(start) = solved.start
            && solved.start_chi2 != solved.initial_chi2
        {
            lines.push(format!("χ² {:.6} at the {} start", solved.start_chi2, start.name()));
        }
        let end = if solved.converged { "" } else { ", not converged" };
        lines.push(format!(
            "χ² {:.6} after {} iterations, {:.4} s{end}",
            solved.final_chi2, solved.iterations, solved.seconds
        ));
        if let Some(outliers) = &solved.outliers {
            lines.push(format!(
                "{} edges are left out; χ² {:.6} of the others",
                outliers.len(),
                solved.fit.chi2
            ));
        }
        lines.push(match solved.fit.per_degree() {
            Some(ratio) => format!("{ratio:.3} per degree of freedom ({})", solved.fit.degrees),
            None => "no degrees of freedom: nothing is measured twice, and χ² says nothing of these poses".into(),
        });
        lines.push(match solved.certificate {
            None => "no certificate: edges were weighed".into(),
            Some(Certificate::Certified { .. }) => "certified: no poses have a lower χ²".into(),
            Some(Certificate::Undecided { .. }) => {
                "not certified: the graph is too densely connected for a certificate".into()
            }
            Some(other) if other.lower_bound() > 0.0 => {
                format!("not certified: no poses have a χ² below {:.6}", other.lower_bound())
            }
            Some(_) => "not certified: there may be poses with a lower χ²".into(),
        });
        lines.push("edges that disagree most:".into());
        for edge in &solved.fit.worst {
            lines.push(format!("  {}  χ² {:.3}, p {:.2e}", edge.name, edge.chi2, edge.p));
        }
        if solved.fit.worst.is_empty() {
            lines.pop();
        }
        lines.join("\n")
    }
}
