//! Vertices onto the surface, and onto its edges and corners.
//!
//! Where the surface is smooth, a step along the gradient takes a vertex there. An edge or a corner between
//! two vertices they would cut off; it lies where the planes meet that touch the surface at both (Kobbelt,
//! Botsch, Schwanecke and Seidel, SIGGRAPH 2001; Ju, Losasso, Schaefer and Warren, SIGGRAPH 2002).

use nalgebra::{Matrix3, SymmetricEigen};

use super::Field;
use super::lattice::{first_order_at, values_at};
use crate::space::Point;

/// Field value at which a vertex counts as on the surface, in spacings.
pub(super) const ON_SURFACE: f64 = 1e-4;

/// Steps of each vertex towards the field at most.
const MOST_STEPS: usize = 5;

/// How far a vertex may move from where the lattice put it, in spacings: it stays in its cell's
/// neighbourhood, so that triangles do not turn over.
const REACH: f64 = 0.5;

/// Difference for the gradient of a field without a formula, in spacings.
const NUDGE: f64 = 0.02;

/// Cosine between normals of neighbours (26°) below which the surface has an edge between them.
const EDGE: f64 = 0.9;

/// Share of the greatest eigenvalue below which planes leave a direction open: along an edge.
const OPEN: f64 = 0.02;

/// Moves the vertices named by `free` onto the field: Newton steps along the gradient at the
/// start, each kept only if it lowers the field's magnitude, else tried again at half the length.
/// Gives the gradient at each start.
pub(super) fn settle(
    field: &dyn Field,
    spacing: f64,
    free: &[usize],
    vertices: &mut [Point],
) -> Vec<Point> {
    let reach = REACH * spacing;
    let on_surface = ON_SURFACE * spacing;
    let starts: Vec<Point> = free.iter().map(|v| vertices[*v]).collect();
    struct Walk {
        vertex: usize,
        start: Point,
        value: f64,
        /// Metres to go per metre of field value.
        slope: Point,
        share: f64,
    }
    let local = first_order_at(field, &starts, NUDGE * spacing);
    let mut walks: Vec<Walk> = free
        .iter()
        .zip(&local)
        .map(|(v, (value, gradient))| {
            let slope = gradient / gradient.norm_squared();
            Walk { vertex: *v, start: vertices[*v], value: *value, slope, share: 1.0 }
        })
        .filter(|w| w.value.is_finite() && w.slope.iter().all(|s| s.is_finite()))
        .collect();
    for _ in 0..MOST_STEPS {
        walks.retain(|w| w.value.abs() > on_surface);
        let tries: Vec<Point> = walks
            .iter()
            .map(|w| {
                let target = vertices[w.vertex] - w.slope * (w.value * w.share);
                w.start + (target - w.start).cap_magnitude(reach)
            })
            .collect();
        for ((walk, point), value) in walks.iter_mut().zip(&tries).zip(values_at(field, &tries)) {
            if value.abs() < walk.value.abs() {
                vertices[walk.vertex] = *point;
                walk.value = value;
            } else {
                walk.share *= 0.5;
            }
        }
    }
    local.into_iter().map(|(_, gradient)| gradient).collect()
}

/// The plane n·p = ρ that touches the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tangent {
    /// n: unit, out of the object.
    normal: Point,
    /// ρ, metres.
    offset: f64,
}

impl Tangent {
    /// Whether the surface has an edge between this and the other.
    pub(super) fn is_over_edge(&self, other: &Tangent) -> bool {
        is_edge(&self.normal, &other.normal)
    }

    /// How far a point lies beyond it, metres.
    pub(super) fn distance(&self, p: &Point) -> f64 {
        self.normal.dot(p) - self.offset
    }
}

/// What touches the surface beside each of the points; nothing where the field has no slope.
pub(super) fn tangents(field: &dyn Field, spacing: f64, points: &[Point]) -> Vec<Option<Tangent>> {
    let local = first_order_at(field, points, NUDGE * spacing);
    let tangent = |(p, (value, gradient)): (&Point, (f64, Point))| {
        let slope = gradient.norm();
        let normal = gradient / slope;
        let offset = normal.dot(p) - value / slope;
        (slope > 0.0 && offset.is_finite()).then_some(Tangent { normal, offset })
    };
    points.iter().zip(local).map(tangent).collect()
}

/// Whether a surface with these unit normals at two neighbours has an edge between them.
pub(super) fn is_edge(a: &Point, b: &Point) -> bool {
    a.dot(b) < EDGE
}

/// Where tangents meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    /// Of the places that they leave open the nearest, metres.
    pub(super) point: Point,
    /// Whether they leave none: a corner.
    pub(super) is_corner: bool,
}

/// Where tangents meet, nearest to a point.
pub(super) fn meeting(tangents: &[Tangent], near: &Point) -> Meeting {
    let (mut squares, mut pull) = (Matrix3::zeros(), Point::zeros());
    for tangent in tangents {
        squares += tangent.normal * tangent.normal.transpose();
        pull -= tangent.normal * tangent.distance(near);
    }
    let eigen = SymmetricEigen::new(squares);
    let least = OPEN * eigen.eigenvalues.max();
    let along = eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues);
    let steps = along.filter(|(_, value)| **value > least);
    Meeting {
        point: steps.fold(*near, |at, (axis, value)| at + axis * (axis.dot(&pull) / value)),
        is_corner: eigen.eigenvalues.min() > least,
    }
}
