//! Closed outlines of a planar field: marching squares, then a root search along every crossed
//! lattice edge, and the corners between them.

use std::collections::BTreeMap;

use super::lattice::{Lattice, LatticeError, Samples, deviations_at, values_at};
use super::outline::{signed_area, winds_around};
use super::settle::{self, Tangent, meeting, settle, tangents};
use super::{Field, Outline};
use crate::space::Point;

/// Field value at which a vertex counts as on the surface, metres.
const ON_SURFACE: f64 = 1e-7;

/// Evaluations spent on one crossing at most; regula falsi needs about four.
const MOST_STEPS: usize = 24;

/// How far out of the box a cut-off outline is closed, in lattice spacings.
const CUT: f64 = 0.01;

/// How far a corner may lie from the middle between two crossings, in lattice spacings. The field is asked
/// there, so that this may be generous: the tip of a corner of 60° may be at 1.3.
const TIP: f64 = 2.0;

/// Vertices nearer than this, in spacings, are one, and loops around less, in squares of it, are none.
const SAME: f64 = 1e-6;

/// The least share of the contacts that makes a component part of the object.
const LEAST_SHARE: f64 = 0.1;

const NONE: u32 = u32::MAX;

/// The zero set of a planar field.
#[derive(Clone, Debug)]
pub struct Contour {
    /// Object boundaries counter-clockwise, boundaries of holes clockwise, metres.
    pub outline: Outline,
    /// Standard deviation along the normal at each vertex, metres: loop after loop, as the field
    /// gives it.
    pub deviations: Vec<f64>,
    /// Whether the object reaches the edge of the box and was cut off there.
    pub clipped: bool,
}

/// The whole zero set of `field` within the box `bounds` (corners, metres; z is ignored) on a
/// lattice `spacing` metres apart. Vertices are on the field to 0.1 µm where it is continuous, or to
/// 1 µm where so many steps do not take them nearer, with one on each corner of more than 26° that lies
/// between two crossings of the lattice, to 1 µm or 10⁻⁴ of the spacing, whichever is more. An object that
/// reaches the edge of the box is closed along it, by vertices that are not on the field. Features
/// thinner than `spacing` can be missed; every component is kept, see [`Contour::touched`].
pub fn extract(
    field: &dyn Field,
    bounds: (Point, Point),
    spacing: f64,
) -> Result<Contour, LatticeError> {
    let lattice = Lattice::new(bounds, spacing, 2)?;
    let (outline, clipped) = trace(field, &lattice, &lattice.sample(field));
    let flat: Vec<Point> =
        outline.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect();
    let deviations = deviations_at(field, &flat);
    Ok(Contour { outline, deviations, clipped })
}

/// The closed loops between the crossed edges of the lattice.
fn trace(field: &dyn Field, lattice: &Lattice, samples: &Samples) -> (Outline, bool) {
    let successors = link(field, lattice, samples);
    let crossed: Vec<u32> = (0..successors.len() as u32)
        .filter(|e| successors.get(*e as usize).is_some_and(|s| *s != NONE))
        .collect();
    let found = cross(field, lattice, samples, &crossed);
    let mut place = vec![NONE; successors.len()];
    for (at, edge) in crossed.iter().enumerate() {
        place[*edge as usize] = at as u32;
    }

    let mut loops = Vec::new();
    for &start in &crossed {
        let mut vertices: Vec<[f64; 2]> = Vec::new();
        let mut edge = start as usize;
        while place[edge] != NONE {
            let p = found[place[edge] as usize];
            place[edge] = NONE;
            vertices.push([p.x, p.y]);
            edge = successors[edge] as usize;
        }
        // A crossing at a node itself is found by up to four edges.
        let apart = |a: &[f64; 2], b: &[f64; 2]| {
            (a[0] - b[0]).hypot(a[1] - b[1]) > SAME * lattice.spacing()
        };
        vertices.dedup_by(|b, a| !apart(a, b));
        while vertices.len() > 1 && !apart(&vertices[0], &vertices[vertices.len() - 1]) {
            vertices.pop();
        }
        // Where the field is zero along a row of nodes it runs there and back, around nothing.
        if signed_area(&vertices).abs() > SAME * lattice.spacing().powi(2) {
            loops.push(vertices);
        }
    }
    add_corners(field, lattice, &mut loops);
    (Outline { loops }, samples.clipped)
}

/// Puts a vertex on each corner that the outline has between two crossings.
fn add_corners(field: &dyn Field, lattice: &Lattice, loops: &mut [Vec<[f64; 2]>]) {
    let mut sides = Vec::new();
    for vertices in loops.iter() {
        let (first, count) = (sides.len(), vertices.len());
        sides.extend((0..count).map(|at| [first + at, first + (at + 1) % count]));
    }
    let vertices: Vec<Point> =
        loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect();
    let corners = corners(field, lattice.spacing(), &vertices, &sides);
    let mut names = 0..;
    for vertices in loops {
        let with_corner = |vertex: [f64; 2]| {
            let corner = names.next().and_then(|name| corners.get(&name));
            [vertex].into_iter().chain(corner.map(|p| [p.x, p.y]))
        };
        *vertices = std::mem::take(vertices).into_iter().flat_map(with_corner).collect();
    }
}

/// The corners between the ends of sides, each by the first of these.
fn corners(
    field: &dyn Field,
    spacing: f64,
    vertices: &[Point],
    sides: &[[usize; 2]],
) -> BTreeMap<usize, Point> {
    // Where the object was cut off, vertices are not on the field.
    let is_on = |t: &Tangent, vertex: &Point| t.distance(vertex).abs() < CUT * spacing;
    let touching = tangents(field, spacing, vertices).into_iter().zip(vertices);
    let touching: Vec<_> = touching.map(|(t, vertex)| t.filter(|t| is_on(t, vertex))).collect();
    let corner = |side: &[usize; 2]| {
        let [one, other] = side.map(|v| touching[v]);
        let (one, other) = (one?, other?);
        let middle = 0.5 * (vertices[side[0]] + vertices[side[1]]);
        let point = meeting(&[one, other], &middle).point;
        let is_corner = one.is_over_edge(&other) && (point - middle).norm() <= TIP * spacing;
        is_corner.then_some((*side, point))
    };
    let (sides, mut found): (Vec<_>, Vec<Point>) = sides.iter().filter_map(corner).unzip();
    settle(field, spacing, &(0..found.len()).collect::<Vec<_>>(), &mut found);
    let values = values_at(field, &found);
    let settled = (10.0 * ON_SURFACE).max(settle::ON_SURFACE * spacing);
    let is_new = |point: &Point, side: &[usize; 2]| {
        side.iter().all(|v| (point - vertices[*v]).norm() > SAME * spacing)
    };
    let judged = sides.into_iter().zip(found).zip(values);
    judged
        .filter(|((side, point), value)| value.abs() <= settled && is_new(point, side))
        .map(|((side, point), _)| (side[0], point))
        .collect()
}

impl Contour {
    /// Only the components that were touched: each contact (object frame, metres) votes for the
    /// loop it is nearest to, and loops with a tenth of the votes stay, as does the loop with the
    /// most, and what the holes among them are holes of. What a field makes up where nobody has felt
    /// anything goes, and so do the pockets it leaves inside. Without contacts, the largest loop.
    pub fn touched(&self, contacts: &[Point]) -> Contour {
        let clouds: Vec<Vec<Point>> = self
            .outline
            .loops
            .iter()
            .map(|l| l.iter().map(|v| Point::new(v[0], v[1], 0.0)).collect())
            .collect();
        let sizes: Vec<f64> = self.outline.loops.iter().map(|l| signed_area(l)).collect();
        let mut keep = components_touched(&clouds, &sizes, contacts);
        let loops = &self.outline.loops;
        let holes: Vec<usize> = (0..loops.len()).filter(|i| keep[*i] && sizes[*i] < 0.0).collect();
        for hole in holes {
            let is_around = |i: &usize| sizes[*i] > 0.0 && winds_around(&loops[*i], loops[hole][0]);
            let around = (0..loops.len()).filter(is_around);
            if let Some(nearest) = around.min_by(|a, b| sizes[*a].total_cmp(&sizes[*b])) {
                keep[nearest] = true;
            }
        }
        self.select(|i| keep[i])
    }

    /// Only the loop around the largest area.
    pub fn largest(&self) -> Contour {
        self.touched(&[])
    }

    fn select(&self, keep: impl Fn(usize) -> bool) -> Contour {
        let mut loops = Vec::new();
        let mut deviations = Vec::new();
        let mut first = 0;
        for (i, vertices) in self.outline.loops.iter().enumerate() {
            let end = first + vertices.len();
            if keep(i) {
                loops.push(vertices.clone());
                deviations.extend_from_slice(&self.deviations[first..end]);
            }
            first = end;
        }
        Contour { outline: Outline { loops }, deviations, clipped: self.clipped }
    }
}

/// Which components (clouds of vertices with a size each) the contacts speak for; see
/// [`Contour::touched`].
pub(super) fn components_touched(
    clouds: &[Vec<Point>],
    sizes: &[f64],
    contacts: &[Point],
) -> Vec<bool> {
    let mut votes = vec![0usize; clouds.len()];
    for contact in contacts {
        let nearest = clouds
            .iter()
            .enumerate()
            .filter_map(|(i, cloud)| {
                let distances = cloud.iter().map(|p| (p - contact).norm_squared());
                distances.min_by(f64::total_cmp).map(|d| (d, i))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, i)) = nearest {
            votes[i] += 1;
        }
    }
    // The most votes, then the largest.
    let first = (0..clouds.len())
        .max_by(|a, b| votes[*a].cmp(&votes[*b]).then(sizes[*a].total_cmp(&sizes[*b])));
    let least = (LEAST_SHARE * contacts.len() as f64).max(1.0);
    (0..clouds.len()).map(|i| Some(i) == first || votes[i] as f64 >= least).collect()
}

/// The edge from node (i, j) to its right neighbour is 2·index, to its upper neighbour 2·index + 1.
fn edge_nodes(lattice: &Lattice, edge: u32) -> ([usize; 3], [usize; 3]) {
    let width = lattice.counts()[0];
    let node = edge as usize / 2;
    let (i, j) = (node % width, node / width);
    if edge.is_multiple_of(2) { ([i, j, 0], [i + 1, j, 0]) } else { ([i, j, 0], [i, j + 1, 0]) }
}

/// For every crossed edge the next one along the outline, the object on the left.
fn link(field: &dyn Field, lattice: &Lattice, samples: &Samples) -> Vec<u32> {
    let [nx, ny, _] = lattice.counts();
    let inside = |i: usize, j: usize| samples.values[lattice.index([i, j, 0])] < 0.0;
    let mut saddles = Vec::new();
    let mut successors = vec![NONE; 2 * nx * ny];
    let mut connect = |i: usize, j: usize, centre: Option<bool>| {
        let corners = [inside(i, j), inside(i + 1, j), inside(i + 1, j + 1), inside(i, j + 1)];
        let edges = [
            2 * lattice.index([i, j, 0]),
            2 * lattice.index([i + 1, j, 0]) + 1,
            2 * lattice.index([i, j + 1, 0]),
            2 * lattice.index([i, j, 0]) + 1,
        ];
        let leaves = |k: usize| corners[k] && !corners[(k + 1) % 4];
        let enters = |k: usize| !corners[k] && corners[(k + 1) % 4];
        let exits = (0..4).filter(|k| leaves(*k)).count();
        if exits == 2 && centre.is_none() {
            return true;
        }
        // Around a cell counter-clockwise, the outline runs from where the object is left to where
        // it is entered. In a saddle that is the next edge if the object's halves meet, else the
        // one before.
        for k in (0..4).filter(|k| leaves(*k)) {
            let target = match centre {
                Some(true) => Some((k + 1) % 4),
                Some(false) => Some((k + 3) % 4),
                None => (0..4).find(|t| enters(*t)),
            };
            if let Some(t) = target {
                successors[edges[k]] = edges[t] as u32;
            }
        }
        false
    };
    for j in 0..ny - 1 {
        for i in 0..nx - 1 {
            if connect(i, j, None) {
                saddles.push((i, j));
            }
        }
    }
    let centres: Vec<Point> = saddles
        .iter()
        .map(|(i, j)| lattice.position([*i as f64 + 0.5, *j as f64 + 0.5, 0.0]))
        .collect();
    for ((i, j), centre) in saddles.into_iter().zip(values_at(field, &centres)) {
        connect(i, j, Some(centre < 0.0));
    }
    successors
}

/// One crossing under search: the bracket along its edge from inside (0) to outside (1).
struct Bracket {
    inner: Point,
    outer: Point,
    low: (f64, f64),
    high: (f64, f64),
    best: (f64, f64),
    moved: Option<Side>,
}

/// The end of a bracket that moved last.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Low,
    High,
}

impl Bracket {
    fn position(&self, t: f64) -> Point {
        self.inner + (self.outer - self.inner) * t
    }
}

/// Where the field vanishes on each of the edges: regula falsi with the Illinois rule, all edges
/// at once, every fourth step a bisection.
fn cross(field: &dyn Field, lattice: &Lattice, samples: &Samples, edges: &[u32]) -> Vec<Point> {
    let mut active = Vec::new();
    let mut brackets: Vec<Bracket> = Vec::with_capacity(edges.len());
    for (at, edge) in edges.iter().enumerate() {
        let (mut inner, mut outer) = edge_nodes(lattice, *edge);
        if samples.values[lattice.index(inner)] >= 0.0 {
            std::mem::swap(&mut inner, &mut outer);
        }
        let low = samples.values[lattice.index(inner)];
        let high = samples.values[lattice.index(outer)];
        let best = if lattice.is_within(1, outer) {
            (CUT, 0.0)
        } else {
            active.push(at);
            if high < -low { (1.0, high) } else { (0.0, low) }
        };
        brackets.push(Bracket {
            inner: lattice.node(inner),
            outer: lattice.node(outer),
            low: (0.0, low),
            high: (1.0, high),
            best,
            moved: None,
        });
    }
    let narrow = 1e-9 / lattice.spacing();
    for step in 0..MOST_STEPS {
        active.retain(|at| {
            let b = &brackets[*at];
            b.best.1.abs() > ON_SURFACE && b.high.0 - b.low.0 > narrow
        });
        if active.is_empty() {
            break;
        }
        let guesses: Vec<f64> = active
            .iter()
            .map(|at| {
                let Bracket { low, high, .. } = &brackets[*at];
                let chord = low.0 + (high.0 - low.0) * low.1 / (low.1 - high.1);
                let middle = 0.5 * (low.0 + high.0);
                if step % 4 == 3 || !chord.is_finite() { middle } else { chord }
            })
            .collect();
        let points: Vec<Point> =
            active.iter().zip(&guesses).map(|(at, t)| brackets[*at].position(*t)).collect();
        for ((at, t), value) in active.iter().zip(guesses).zip(values_at(field, &points)) {
            let b = &mut brackets[*at];
            // Halving the value of an end that stays twice keeps the chord from creeping.
            if value < 0.0 {
                b.low = (t, value);
                b.high.1 *= if b.moved == Some(Side::Low) { 0.5 } else { 1.0 };
                b.moved = Some(Side::Low);
            } else {
                b.high = (t, if value.is_finite() { value } else { lattice.spacing() });
                b.low.1 *= if b.moved == Some(Side::High) { 0.5 } else { 1.0 };
                b.moved = Some(Side::High);
            }
            if value.abs() < b.best.1.abs() {
                b.best = (t, value);
            }
        }
    }
    // A field that jumps has no zero: the middle of the narrowed bracket is where it changes sign.
    brackets
        .iter()
        .map(|b| {
            let found = b.best.1.abs() <= 10.0 * ON_SURFACE;
            b.position(if found { b.best.0 } else { 0.5 * (b.low.0 + b.high.0) })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Analytic<F>(F);

    impl<F: Fn(f64, f64) -> f64 + Sync> Field for Analytic<F> {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| (self.0)(p.x, p.y)).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            points.iter().map(|p| p.x.abs()).collect()
        }
    }

    fn trace(f: impl Fn(f64, f64) -> f64 + Sync, spacing: f64) -> Contour {
        let bounds = (Point::new(-0.1, -0.08, 0.0), Point::new(0.1, 0.08, 0.0));
        extract(&Analytic(f), bounds, spacing).unwrap()
    }

    fn areas(contour: &Contour) -> Vec<f64> {
        contour.outline.loops.iter().map(|l| signed_area(l)).collect()
    }

    #[test]
    fn a_circle_is_one_counter_clockwise_loop_on_the_field() {
        let contour = trace(|x, y| x.hypot(y) - 0.05, 0.004);
        assert_eq!(contour.outline.loops.len(), 1);
        assert!(!contour.clipped);
        for v in &contour.outline.loops[0] {
            assert!((v[0].hypot(v[1]) - 0.05).abs() < 1e-6);
        }
        let area = areas(&contour)[0];
        let circle = std::f64::consts::PI * 0.0025;
        assert!(area < circle && area > 0.995 * circle, "{area}");
        assert_eq!(contour.deviations.len(), contour.outline.loops[0].len());
        assert_eq!(contour.deviations[3], contour.outline.loops[0][3][0].abs());
    }

    #[test]
    fn a_field_that_is_zero_along_a_row_encloses_nothing_there() {
        let f = |x: f64, y: f64| if x.abs() < 0.05 { y.abs() } else { 0.01 + y.abs() };
        assert_eq!(areas(&trace(f, 0.004)), Vec::<f64>::new());
    }

    #[test]
    fn a_field_far_from_a_distance_still_gets_its_roots() {
        // An ellipse in algebraic form, steep and curved along the edges.
        let f = |x: f64, y: f64| ((x / 0.06).powi(2) + (y / 0.03).powi(2)).powi(3) - 1.0;
        let contour = trace(f, 0.005);
        assert_eq!(contour.outline.loops.len(), 1);
        for v in &contour.outline.loops[0] {
            assert!(f(v[0], v[1]).abs() < 1e-6);
        }
        let exact = std::f64::consts::PI * 0.06 * 0.03;
        assert!((areas(&contour)[0] / exact - 1.0).abs() < 0.02);
    }

    #[test]
    fn a_rounded_box_keeps_its_sides() {
        let f = |x: f64, y: f64| {
            let (a, b) = (x.abs() - 0.05, y.abs() - 0.02);
            a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0) - 0.01
        };
        let contour = trace(f, 0.002);
        let exact = 0.12 * 0.06 - (4.0 - std::f64::consts::PI) * 1e-4;
        assert!((areas(&contour)[0] / exact - 1.0).abs() < 2e-3);
        let widest = contour.outline.loops[0].iter().map(|v| v[0]).fold(0.0, f64::max);
        assert!((widest - 0.06).abs() < 1e-6);
    }

    #[test]
    fn corners_are_vertices() {
        // An L askew: five corners out, one in.
        let (sin, cos) = 0.4_f64.sin_cos();
        let f = |x: f64, y: f64| {
            let (x, y) = (cos * x + sin * y, cos * y - sin * x);
            (x.abs() - 0.06).max(y.abs() - 0.04).max(x.min(y) - 0.0012)
        };
        let contour = trace(f, 0.004);
        let exact = 0.12 * 0.08 - (0.06 - 0.0012) * (0.04 - 0.0012);
        assert!((areas(&contour)[0] / exact - 1.0).abs() < 1e-6, "{:?} {exact}", areas(&contour));
        assert_eq!(contour.deviations.len(), contour.outline.loops[0].len());
        assert!(contour.outline.loops[0].iter().all(|v| f(v[0], v[1]).abs() < 1e-6));
    }

    #[test]
    fn pointed_corners_are_vertices() {
        // Triangles askew, and nodes of the lattice anywhere about their tips.
        for turn in 0..12 {
            let shift = 3e-4 * f64::from(turn);
            let f = |x: f64, y: f64| {
                let side = |i: i32| {
                    let angle = 0.1 * f64::from(turn) + std::f64::consts::TAU * f64::from(i) / 3.0;
                    (x - shift) * angle.cos() + y * angle.sin() - 0.03
                };
                side(0).max(side(1)).max(side(2))
            };
            let area = areas(&trace(f, 0.004))[0];
            let exact = 3.0 * 3.0_f64.sqrt() * 9e-4;
            assert!((area / exact - 1.0).abs() < 1e-6, "{turn}: {area} {exact}");
        }
    }

    #[test]
    fn a_ring_has_a_clockwise_hole() {
        let contour = trace(|x, y| (x.hypot(y) - 0.045).abs() - 0.015, 0.003);
        let mut areas = areas(&contour);
        areas.sort_by(f64::total_cmp);
        assert_eq!(areas.len(), 2);
        assert!((areas[0] / (std::f64::consts::PI * 9e-4) + 1.0).abs() < 0.01);
        assert!((areas[1] / (std::f64::consts::PI * 36e-4) - 1.0).abs() < 0.01);
    }

    #[test]
    fn the_centre_decides_a_saddle() {
        // The lattice has a node at the origin's four diagonal neighbours, the saddle between them.
        let bounds = (Point::new(-0.0105, -0.0105, 0.0), Point::new(0.0105, 0.0105, 0.0));
        for (level, loops) in [(2e-3_f64, 2), (-2e-3, 1)] {
            let f = move |x: f64, y: f64| {
                let lobe = |cx: f64| (x - cx).hypot(y - cx) - 0.004;
                let bridge = lobe(0.0035).min(lobe(-0.0035));
                if x.hypot(y) < 1e-4 { level } else { bridge }
            };
            let contour = extract(&Analytic(f), bounds, 0.003).unwrap();
            assert_eq!(contour.outline.loops.len(), loops, "centre {level}");
        }
    }

    #[test]
    fn an_object_that_reaches_the_edge_is_closed_there() {
        let contour = trace(|x, _| x - 0.03, 0.005);
        assert!(contour.clipped);
        assert_eq!(contour.outline.loops.len(), 1);
        assert!((areas(&contour)[0] / (0.13 * 0.16) - 1.0).abs() < 0.01);
    }

    #[test]
    fn nothing_and_not_a_number_are_empty_outlines() {
        assert!(trace(|_, _| 1.0, 0.005).outline.loops.is_empty());
        assert!(trace(|_, _| f64::NAN, 0.005).outline.loops.is_empty());
    }

    #[test]
    fn a_jump_is_found_between_its_sides() {
        let contour = trace(|x, y| if x.hypot(y) < 0.05 { -1.0 } else { 1.0 }, 0.004);
        for v in &contour.outline.loops[0] {
            assert!((v[0].hypot(v[1]) - 0.05).abs() < 1e-6);
        }
    }

    #[test]
    fn only_touched_components_stay() {
        let two = |x: f64, y: f64| (x + 0.05).hypot(y).min((x - 0.04).hypot(y) * 0.8) - 0.02;
        let contour = trace(two, 0.002);
        assert_eq!(contour.outline.loops.len(), 2);
        let on_left: Vec<Point> = (0..12)
            .map(|i| Point::new(-0.05 + 0.02 * (i as f64).cos(), 0.02 * (i as f64).sin(), 0.0))
            .collect();
        let left = contour.touched(&on_left);
        assert_eq!(left.outline.loops.len(), 1);
        assert!(left.outline.loops[0].iter().all(|v| v[0] < 0.0));
        assert_eq!(left.deviations.len(), left.outline.loops[0].len());
        assert_eq!(left.deviations[0], left.outline.loops[0][0][0].abs());
        // One stray contact does not bring the other back, two of four do.
        let stray = Point::new(0.07, 0.0, 0.0);
        let with_stray = [&on_left[..], &[stray]].concat();
        assert_eq!(contour.touched(&with_stray).outline.loops.len(), 1);
        let balanced = [on_left[0], on_left[1], stray, stray];
        assert_eq!(contour.touched(&balanced).outline.loops.len(), 2);
        assert!(contour.largest().outline.loops[0].iter().all(|v| v[0] > 0.0));
    }

    #[test]
    fn a_hole_that_was_touched_is_one_of_something() {
        let contour = trace(|x, y| (x.hypot(y) - 0.045).abs() - 0.015, 0.003);
        let within: Vec<Point> = (0..9)
            .map(|i| 0.03 * Point::new(f64::from(i).cos(), f64::from(i).sin(), 0.0))
            .collect();
        let touched = contour.touched(&within);
        assert_eq!(touched.outline.loops.len(), 2);
        assert!(!touched.outline.contains(&Point::zeros()));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_landscape_is_traced_on_the_field_and_around_its_area(
            waves in proptest::array::uniform4((20.0..90.0, 20.0..90.0, 0.0..6.3)), level in -0.4..0.4,
        ) {
            // Islands, lakes and saddles, cut off wherever they reach the edge.
            let f = |x: f64, y: f64| {
                let wave = |(a, b, phase): &(f64, f64, f64)| (a * x + phase).sin() * (b * y).cos();
                0.01 * (waves.iter().map(wave).sum::<f64>() - level)
            };
            let contour = trace(f, 0.002);
            for v in contour.outline.loops.iter().flatten() {
                let inner = v[0].abs() < 0.0999 && v[1].abs() < 0.0799;
                prop_assert!(!inner || f(v[0], v[1]).abs() < 1e-6);
            }
            let fine = |i: usize, n: usize, half: f64| half * ((2 * i + 1) as f64 / n as f64 - 1.0);
            let inside = (0..400)
                .flat_map(|i| (0..320).map(move |j| (i, j)))
                .filter(|(i, j)| f(fine(*i, 400, 0.1), fine(*j, 320, 0.08)) < 0.0)
                .count();
            let expected = inside as f64 * 0.0005 * 0.0005;
            prop_assert!((contour.outline.area() - expected).abs() < 0.01 * 0.2 * 0.16);
        }
    }
}
