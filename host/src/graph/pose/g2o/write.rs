//! Writing: every number with the digits that bring it back exactly.

use std::io::{Error, ErrorKind, Write};
use std::path::Path;

use super::entry::Entry;
use super::{G2oError, Graph};
use crate::graph::pose::PoseGraph;
use crate::log::write::write_atomically;

/// Writes a graph, fully or not at all: poses in their order, those that stay, edges in their order.
/// What [`super::read`] makes of it is the same graph, to the last bit. `unknown` lines of edges follow, others
/// come first: parameters are before what refers to them.
///
/// # Errors
/// When the file cannot be written, or (`InvalidInput`) the graph's indices name no pose.
pub fn write(path: &Path, graph: &Graph, unknown: &[String]) -> Result<(), G2oError> {
    let (last, first): (Vec<_>, Vec<_>) =
        unknown.iter().partition(|l| l.trim_start().starts_with("EDGE"));
    write_atomically(path, |out| {
        first.iter().try_for_each(|line| writeln!(out, "{line}"))?;
        write_to(out, graph)?;
        last.iter().try_for_each(|line| writeln!(out, "{line}"))
    })
    .map_err(|source| G2oError::Io { file: path.into(), action: "write", source })
}

/// As [`write()`] of a graph alone, to anything that can be written to.
///
/// # Errors
/// When the writer fails, or (`InvalidInput`) the graph's indices name no pose.
pub fn write_to(out: &mut dyn Write, graph: &Graph) -> std::io::Result<()> {
    match graph {
        Graph::Planar(graph) => lines(out, graph),
        Graph::Spatial(graph) => lines(out, graph),
    }
}

fn lines<G: Entry<D>, const D: usize>(
    out: &mut dyn Write,
    graph: &PoseGraph<G, D>,
) -> std::io::Result<()> {
    let ends = graph.edges.iter().flat_map(|edge| [edge.from, edge.to]);
    let poses = graph.poses.len();
    if graph.ids.len() != poses || ends.chain(graph.fixed.iter().copied()).any(|i| i >= poses) {
        let message = "expected one id per pose, and edges between poses that are there";
        return Err(Error::new(ErrorKind::InvalidInput, message));
    }
    for (id, pose) in graph.ids.iter().zip(&graph.poses) {
        write!(out, "{} {id}", G::VERTEX)?;
        numbers(out, &pose.numbers()[..G::FIELDS.len()])?;
        writeln!(out)?;
    }
    for &pose in &graph.fixed {
        writeln!(out, "FIX {}", graph.ids[pose])?;
    }
    for edge in &graph.edges {
        write!(out, "{} {} {}", G::EDGE, graph.ids[edge.from], graph.ids[edge.to])?;
        numbers(out, &edge.measured.numbers()[..G::FIELDS.len()])?;
        let information = &edge.information;
        for row in 0..D {
            for column in row..D {
                let mean = 0.5 * (information[(row, column)] + information[(column, row)]);
                numbers(out, &[mean])?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// The shortest decimals that are read back as the same numbers; with a power of ten where they would
/// be long.
fn numbers(out: &mut dyn Write, values: &[f64]) -> std::io::Result<()> {
    for &value in values {
        if value == 0.0 || (1e-5..1e16).contains(&value.abs()) {
            write!(out, " {value}")?;
        } else {
            write!(out, " {value:e}")?;
        }
    }
    Ok(())
}
