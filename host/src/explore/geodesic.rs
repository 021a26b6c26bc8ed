//! Lengths of paths over a surface: along the outline, or along the edges of a mesh (4.12 asks for the
//! length of the path, not of the chord).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::shape::{Geometry, Mesh, Outline};
use crate::space::Point;

/// The shortest paths from some places on a surface to everywhere on it.
///
/// On an outline they are exact. On a mesh they follow edges, which makes them longer than the
/// shortest ones by up to an eighth on the even meshes of estimated surfaces.
///
/// ```
/// use tactile_host::explore::geodesic::Paths;
/// use tactile_host::sim::ObjectSpec;
/// use tactile_host::space::Point;
///
/// let square = "rectangle:0.1x0.1".parse::<ObjectSpec>()?.geometry()?;
/// let felt = [Point::new(0.0, 0.05, 0.0)];
/// let paths = Paths::new(&square, &felt);
/// let (from, length) = paths.to(&Point::new(0.0, -0.05, 0.0)).ok_or("no path")?;
/// assert!(from == 0 && (length - 0.2).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Paths<'a> {
    geometry: &'a Geometry,
    sources: &'a [Point],
    found: Found,
}

#[derive(Debug)]
enum Found {
    /// Loop and length along it of each source.
    Along(Vec<(usize, f64)>),
    /// Source and distance of each vertex.
    Vertices(Vec<Option<(usize, f64)>>),
}

impl<'a> Paths<'a> {
    /// From `sources`, metres, taken to the surface's nearest points. Those that are not finite lead
    /// nowhere.
    pub fn new(geometry: &'a Geometry, sources: &'a [Point]) -> Paths<'a> {
        let found = match geometry {
            Geometry::Outline(o) => {
                let place = |p: &Point| along(o, p).unwrap_or((usize::MAX, 0.0));
                Found::Along(sources.iter().map(place).collect())
            }
            Geometry::Mesh(m) => Found::Vertices(spread(m, sources)),
        };
        Paths { geometry, sources, found }
    }

    /// The source with the shortest path to the surface's point nearest to `target`, and how long that
    /// is, metres. `None` where no path leads there.
    pub fn to(&self, target: &Point) -> Option<(usize, f64)> {
        match (&self.found, self.geometry) {
            (Found::Along(places), Geometry::Outline(o)) => {
                let (number, at) = along(o, target)?;
                let around = perimeter(o.loops.get(number)?);
                let same = places.iter().enumerate().filter(|(_, place)| place.0 == number);
                let length = same.map(|(i, (_, from))| {
                    let forth = (at - from).abs();
                    (i, forth.min(around - forth))
                });
                length.min_by(|a, b| a.1.total_cmp(&b.1))
            }
            (Found::Vertices(vertices), Geometry::Mesh(m)) => {
                let (vertex, rest) = nearest(m, target)?;
                let (source, length) = (*vertices.get(vertex)?)?;
                // Never shorter than the chord, and no detour by a vertex to a neighbour.
                let chord = (self.sources.get(source)? - target).norm();
                Some((source, if length <= 2.0 * rest { chord } else { chord.max(length) }))
            }
            _ => None,
        }
    }
}

/// The loop nearest to a point and how far along it that is.
fn along(outline: &Outline, p: &Point) -> Option<(usize, f64)> {
    let mut best: Option<(f64, usize, f64)> = None;
    for (number, vertices) in outline.loops.iter().enumerate() {
        let mut passed = 0.0;
        for (k, a) in vertices.iter().enumerate() {
            let b = vertices[(k + 1) % vertices.len()];
            let (edge, away) = ([b[0] - a[0], b[1] - a[1]], [p.x - a[0], p.y - a[1]]);
            let length = edge[0].hypot(edge[1]);
            let share = (edge[0] * away[0] + edge[1] * away[1]) / (length * length);
            let share = if length > 0.0 { share.clamp(0.0, 1.0) } else { 0.0 };
            let off = (away[0] - share * edge[0]).hypot(away[1] - share * edge[1]);
            if off.is_finite() && best.is_none_or(|(least, ..)| off < least) {
                best = Some((off, number, passed + share * length));
            }
            passed += length;
        }
    }
    best.map(|(_, number, at)| (number, at))
}

fn perimeter(vertices: &[[f64; 2]]) -> f64 {
    let next = vertices.iter().cycle().skip(1);
    vertices.iter().zip(next).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
}

/// The nearest vertex and its distance.
fn nearest(mesh: &Mesh, p: &Point) -> Option<(usize, f64)> {
    let squares = mesh.vertices().iter().map(|v| (v - p).norm_squared()).enumerate();
    let best = squares.filter(|(_, d)| d.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1));
    best.map(|(i, square)| (i, square.sqrt()))
}

/// Dijkstra's algorithm from all sources at once.
fn spread(mesh: &Mesh, sources: &[Point]) -> Vec<Option<(usize, f64)>> {
    let n = mesh.vertices().len();
    let mut beside: Vec<Vec<u32>> = vec![Vec::new(); n];
    for [a, b, c] in mesh.triangles() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            beside[*from as usize].push(*to);
            beside[*to as usize].push(*from);
        }
    }
    let mut found: Vec<Option<(usize, f64)>> = vec![None; n];
    // Lengths are not negative, so that their bits are in their order.
    let mut open = BinaryHeap::new();
    for (source, p) in sources.iter().enumerate() {
        if let Some((vertex, rest)) = nearest(mesh, p) {
            open.push(Reverse((rest.to_bits(), source, vertex)));
        }
    }
    while let Some(Reverse((bits, source, vertex))) = open.pop() {
        if found[vertex].is_some() {
            continue;
        }
        let length = f64::from_bits(bits);
        found[vertex] = Some((source, length));
        for &next in &beside[vertex] {
            let next = next as usize;
            if found[next].is_none() {
                let step = (mesh.vertices()[next] - mesh.vertices()[vertex]).norm();
                open.push(Reverse(((length + step).to_bits(), source, next)));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    fn geometry(text: &str) -> Geometry {
        text.parse::<ObjectSpec>().unwrap().geometry().unwrap()
    }

    #[test]
    fn the_shorter_way_round_and_from_the_nearer_source() {
        let outline = geometry("rectangle:0.1x0.06");
        let sources = [Point::new(0.05, 0.0, 0.0), Point::new(-0.05, 0.01, 0.0)];
        let paths = Paths::new(&outline, &sources);
        let (from, length) = paths.to(&Point::new(0.04, 0.03, 0.0)).unwrap();
        assert!(from == 0 && (length - 0.04).abs() < 1e-12);
        let (from, length) = paths.to(&Point::new(-0.05, -0.01, 0.0)).unwrap();
        assert!(from == 1 && (length - 0.02).abs() < 1e-12);
        assert!(Paths::new(&outline, &[]).to(&sources[0]).is_none());
        let nowhere = [Point::new(f64::NAN, 0.0, 0.0)];
        assert!(Paths::new(&outline, &nowhere).to(&sources[0]).is_none());
    }

    #[test]
    fn over_a_sphere_paths_are_arcs() {
        // An even mesh of a sphere with radius 0.05.
        let (rings, around) = (24u32, 48u32);
        let angle = |k: u32, n: u32| std::f64::consts::PI * f64::from(k) / f64::from(n);
        let mut vertices = Vec::new();
        for i in 0..=rings {
            for j in 0..around {
                let (t, p) = (angle(i, rings), 2.0 * angle(j, around));
                vertices.push(Point::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos()) * 0.05);
            }
        }
        let at = |i: u32, j: u32| i * around + j % around;
        let squares = (0..rings).flat_map(|i| (0..around).map(move |j| (i, j)));
        let triangles = squares.flat_map(|(i, j)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        });
        let sphere = Geometry::Mesh(Mesh::new(vertices, triangles.collect()).unwrap());
        let top = [Point::new(0.0, 0.0, 0.05)];
        let paths = Paths::new(&sphere, &top);
        for target in [Point::x() * 0.05, Point::new(0.03, 0.0, -0.04), Point::z() * -0.05] {
            let arc = 0.05 * target.angle(&top[0]);
            let (_, length) = paths.to(&target).unwrap();
            assert!(length > 0.97 * arc && length < 1.13 * arc, "{length} {arc}");
            assert!(length >= (target - top[0]).norm());
        }
    }
}
