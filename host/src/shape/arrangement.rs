//! The cells into which planes cut a box, and the facets between them.
//!
//! Every plane goes right through, so facets of neighbouring cells are the same facets and any union
//! of cells has a closed surface. A vertex is on one side of a plane or the other, never on it, and
//! each edge is cut once for all cells along it: the combinatorics hold whatever rounding does, but where so many
//! planes meet in a point that it puts corners of one facet on wrong sides ([`Arrangement::of`] mends that).

use std::collections::{BTreeSet, HashMap};

use super::mesh::plastic;
use crate::space::Point;

/// How far planes are moved where more than three meet in a point, as a share of the box: much more than rounding, and
/// much less than anybody measures.
const APART: f64 = 1e-8;

/// Length of an edge that rounding alone may have made, metres.
const NO_EDGE: f64 = 1e-12;

/// One side of the box, or one of the planes.
pub type Plane = Option<usize>;

/// A convex polygon between two cells.
#[derive(Clone, Debug)]
pub struct Facet {
    /// Which plane it lies in.
    pub plane: Plane,
    /// Indices of its vertices, counter-clockwise seen from the front.
    pub ring: Vec<usize>,
    /// The cell where n·p < ρ; inside the box for its sides.
    pub back: usize,
    /// The cell where n·p > ρ; `None` outside the box.
    pub front: Plane,
}

/// A box cut by planes.
#[derive(Clone, Debug)]
pub struct Arrangement {
    /// Metres.
    pub vertices: Vec<Point>,
    /// All facets, those of the box too.
    pub facets: Vec<Facet>,
    /// Indices of every cell's facets.
    pub cells: Vec<Vec<usize>>,
    planes: Vec<(Point, f64)>,
}

/// What a plane does to a facet that it crosses.
struct Split {
    /// Index of the part in front.
    front: usize,
    /// New vertices: where the ring goes to the front and where it comes back.
    leaves: usize,
    enters: usize,
}

impl Arrangement {
    /// The cube of half side `reach` about `centre` (metres), cut by planes of this unit normal n and offset ρ each,
    /// n·p = ρ. Where many meet in a point, as at the tip of a pyramid, rounding may spoil facets; then each plane is
    /// moved by another little bit, at most a hundred-millionth of `reach`.
    ///
    /// `None` where a number is none.
    pub fn of(centre: &Point, reach: f64, planes: &[(Point, f64)]) -> Option<Arrangement> {
        let moved = |by: f64| {
            let mut arrangement = Arrangement::cube(centre, reach);
            for (number, (normal, offset)) in planes.iter().enumerate() {
                arrangement.cut(normal, offset + by * (plastic(number).0 - 0.5))?;
            }
            Some(arrangement)
        };
        moved(0.0).or_else(|| moved(APART * reach))
    }

    /// The cube of half side `reach` about `centre`, uncut.
    pub fn cube(centre: &Point, reach: f64) -> Arrangement {
        let corner = |i: usize| {
            let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
            centre + Point::new(sign(1), sign(2), sign(4)) * reach
        };
        let rings =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let side =
            |ring: [usize; 4]| Facet { plane: None, ring: ring.into(), back: 0, front: None };
        Arrangement {
            vertices: (0..8).map(corner).collect(),
            facets: rings.into_iter().map(side).collect(),
            cells: vec![(0..6).collect()],
            planes: Vec::new(),
        }
    }

    /// Cuts every cell that the plane n·p = ρ goes through. `None` where rounding spoils a facet;
    /// the arrangement is then of no further use.
    pub fn cut(&mut self, normal: &Point, offset: f64) -> Option<()> {
        let plane = self.planes.len();
        self.planes.push((*normal, offset));
        let values: Vec<f64> = self.vertices.iter().map(|v| normal.dot(v) - offset).collect();
        if !values.iter().all(|v| v.is_finite()) {
            return None;
        }
        let in_front = |v: usize| values[v] > 0.0;
        let mut cuts: HashMap<(usize, usize), usize> = HashMap::new();
        let mut splits: HashMap<usize, Split> = HashMap::new();
        for number in 0..self.facets.len() {
            let ring = std::mem::take(&mut self.facets[number].ring);
            let (mut back, mut front) = (Vec::new(), Vec::new());
            let (mut leaves, mut enters) = (None, None);
            for (i, &a) in ring.iter().enumerate() {
                let b = ring[(i + 1) % ring.len()];
                if in_front(a) {
                    front.push(a)
                } else {
                    back.push(a)
                }
                if in_front(a) == in_front(b) {
                    continue;
                }
                let (inner, outer) = if in_front(a) { (b, a) } else { (a, b) };
                let vertices = &mut self.vertices;
                let new = *cuts.entry((inner, outer)).or_insert_with(|| {
                    let share = values[inner] / (values[inner] - values[outer]);
                    vertices.push(vertices[inner] + (vertices[outer] - vertices[inner]) * share);
                    vertices.len() - 1
                });
                back.push(new);
                front.push(new);
                let end = if in_front(b) { &mut leaves } else { &mut enters };
                if end.replace(new).is_some() {
                    return None;
                }
            }
            self.facets[number].ring = if back.is_empty() { front.clone() } else { back };
            if let (Some(leaves), Some(enters)) = (leaves, enters) {
                let part = Facet { ring: front, ..self.facets[number].clone() };
                splits.insert(number, Split { front: self.facets.len(), leaves, enters });
                self.facets.push(part);
            }
        }
        for cell in 0..self.cells.len() {
            if self.cells[cell].iter().any(|f| splits.contains_key(f)) {
                self.halve(cell, plane, &splits, &in_front)?;
            }
        }
        Some(())
    }

    fn halve(
        &mut self,
        cell: usize,
        plane: usize,
        splits: &HashMap<usize, Split>,
        in_front: &impl Fn(usize) -> bool,
    ) -> Option<()> {
        let beyond = self.cells.len();
        let (mut back, mut front) = (Vec::new(), Vec::new());
        // From where the new facet's boundary continues to where.
        let mut next: HashMap<usize, usize> = HashMap::new();
        for number in std::mem::take(&mut self.cells[cell]) {
            let moved = match splits.get(&number) {
                Some(split) => {
                    let outward = self.facets[number].back == cell;
                    let (from, to) = if outward {
                        (split.enters, split.leaves)
                    } else {
                        (split.leaves, split.enters)
                    };
                    next.insert(from, to);
                    back.push(number);
                    split.front
                }
                None if in_front(self.facets[number].ring[0]) => number,
                None => {
                    back.push(number);
                    continue;
                }
            };
            front.push(moved);
            let facet = &mut self.facets[moved];
            if facet.back == cell { facet.back = beyond } else { facet.front = Some(beyond) }
        }
        let first = *next.keys().min()?;
        let mut ring = vec![first];
        while let Some(&v) = ring.last().and_then(|last| next.get(last)) {
            if v == first {
                break;
            }
            if ring.len() == next.len() {
                return None;
            }
            ring.push(v);
        }
        if ring.len() != next.len() || ring.len() < 3 {
            return None;
        }
        back.push(self.facets.len());
        front.push(self.facets.len());
        self.facets.push(Facet { plane: Some(plane), ring, back: cell, front: Some(beyond) });
        self.cells[cell] = back;
        self.cells.push(front);
        Some(())
    }

    /// The corners of a facet.
    pub fn corners<'a>(&'a self, facet: &'a Facet) -> impl Iterator<Item = Point> + 'a {
        facet.ring.iter().map(|v| self.vertices[*v])
    }

    /// How far `point`, projected into the facet's plane of this unit normal, lies inside the facet:
    /// the distance to its nearest side, negative outside it, metres; −∞ where rounding alone made the facet.
    pub fn clearance(&self, facet: &Facet, normal: &Point, point: &Point) -> f64 {
        let corners: Vec<Point> = self.corners(facet).collect();
        let clear = (0..corners.len()).filter_map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
            Some(normal.cross(&(b - a)).try_normalize(NO_EDGE)?.dot(&(point - a)))
        });
        clear.min_by(f64::total_cmp).unwrap_or(f64::NEG_INFINITY)
    }

    /// The mean of a cell's corners, which is inside it.
    pub fn middle(&self, cell: usize) -> Point {
        let rings = self.cells[cell].iter().flat_map(|facet| self.facets[*facet].ring.iter());
        let corners: BTreeSet<usize> = rings.copied().collect();
        corners.iter().map(|corner| self.vertices[*corner]).sum::<Point>()
            / corners.len().max(1) as f64
    }

    /// The cell that holds `point`; `None` outside the box.
    pub fn cell_at(&self, point: &Point) -> Plane {
        let centre = |cell: &[usize]| {
            let vertices = cell.iter().flat_map(|f| &self.facets[*f].ring);
            let (sum, count) =
                vertices.fold((Point::zeros(), 0.0), |(s, n), v| (s + self.vertices[*v], n + 1.0));
            sum / count
        };
        let inside_box = self.facets.iter().filter(|f| f.front.is_none()).all(|f| {
            let corners: Vec<Point> = self.corners(f).take(3).collect();
            (corners[1] - corners[0]).cross(&(corners[2] - corners[1])).dot(&(point - corners[0]))
                <= 0.0
        });
        // How far a cell's middle is beyond the plane that it is least far beyond, on the point's side of each: of
        // cells that rounding alone made it is nowhere.
        let depth = |cell: &usize| {
            let middle = centre(&self.cells[*cell]);
            let beyond = self.planes.iter().map(|(n, rho)| {
                (n.dot(&middle) - rho) * if n.dot(point) > *rho { 1.0 } else { -1.0 }
            });
            beyond.min_by(f64::total_cmp).unwrap_or(f64::INFINITY)
        };
        let depths = (0..self.cells.len()).filter(|_| inside_box).map(|cell| (depth(&cell), cell));
        let deepest = depths.max_by(|a, b| a.0.total_cmp(&b.0));
        deepest.filter(|(depth, _)| *depth >= 0.0).map(|(_, cell)| cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    fn volume(a: &Arrangement, cell: usize) -> f64 {
        let parts = a.cells[cell].iter().map(|f| {
            let facet = &a.facets[*f];
            let sign = if facet.back == cell { 1.0 } else { -1.0 };
            let corners: Vec<Point> = a.corners(facet).collect();
            let fan =
                (2..corners.len()).map(|i| corners[0].dot(&corners[i - 1].cross(&corners[i])));
            sign * fan.sum::<f64>() / 6.0
        });
        parts.sum()
    }

    #[test]
    fn three_planes_make_eight_cells() {
        let mut a = Arrangement::cube(&Point::zeros(), 1.0);
        for axis in 0..3 {
            let mut normal = Point::zeros();
            normal[axis] = 1.0;
            a.cut(&normal, 0.5).unwrap();
        }
        assert_eq!((a.cells.len(), a.vertices.len()), (8, 27));
        let cell = a.cell_at(&Point::new(0.9, 0.0, 0.7)).unwrap();
        assert!((volume(&a, cell) - 0.5 * 1.5 * 0.5).abs() < 1e-12);
        assert_eq!(a.cell_at(&Point::new(1.1, 0.0, 0.0)), None);
        assert!(a.cut(&Point::new(f64::NAN, 0.0, 0.0), 0.0).is_none());
    }

    proptest! {
        /// Sides of a pyramid meet in its tip, but for rounding: the cells are closed, and the pyramid is one of them.
        #[test]
        fn many_planes_may_meet_in_a_point(
            count in 4usize..10,
            tip in prop::array::uniform3(-0.2f64..0.2),
            turn in prop::array::uniform3(-2.0f64..2.0),
            points in prop::collection::vec(prop::array::uniform3(-0.9f64..0.9), 9),
        ) {
            let (tip, turn) = (Point::from(tip), Rotation3::new(Point::from(turn)));
            let step = std::f64::consts::TAU / count as f64;
            let angles = (0..count).map(|k| k as f64 * step);
            let sides = angles.map(|angle| Point::new(angle.cos(), angle.sin(), 0.6).normalize());
            let mut planes: Vec<(Point, f64)> =
                sides.map(|out| turn * out).map(|out| (out, out.dot(&tip))).collect();
            let down = turn * -Point::z();
            planes.push((down, down.dot(&tip) + 0.4));
            let a = Arrangement::of(&Point::zeros(), 1.0, &planes).unwrap();
            let volumes: Vec<f64> = (0..a.cells.len()).map(|cell| volume(&a, cell)).collect();
            prop_assert!((volumes.iter().sum::<f64>() - 8.0).abs() < 1e-9);
            let pyramid = a.cell_at(&(tip + down * 0.39)).unwrap();
            let base = count as f64 * 0.24f64.powi(2) * (step / 2.0).tan();
            prop_assert!((volumes[pyramid] - base * 0.4 / 3.0).abs() < 1e-7);
            prop_assert_eq!(a.cell_at(&(tip + down * 1e-3)), Some(pyramid));
            // None is in what rounding made.
            for point in points {
                prop_assert!(volumes[a.cell_at(&Point::from(point)).unwrap()] > 1e-9);
            }
        }

        /// Cells fill the cube, every facet has its cells on its two sides, and every cell is closed.
        #[test]
        fn cells_fill_the_cube(
            planes in prop::collection::vec((prop::array::uniform3(-1.0f64..1.0), -0.5f64..0.5), 1..12),
        ) {
            let mut a = Arrangement::cube(&Point::new(0.1, 0.0, -0.2), 1.0);
            let mut cut = 0;
            for (normal, offset) in planes {
                if let Some(normal) = Point::from(normal).try_normalize(0.1) {
                    a.cut(&normal, offset).unwrap();
                    cut += 1;
                }
            }
            prop_assert!(a.cells.len() > usize::from(cut > 0) );
            let volumes: Vec<f64> = (0..a.cells.len()).map(|c| volume(&a, c)).collect();
            prop_assert!(volumes.iter().all(|v| *v > -1e-12));
            prop_assert!((volumes.iter().sum::<f64>() - 8.0).abs() < 1e-9);
            for (number, facet) in a.facets.iter().enumerate() {
                prop_assert!(a.cells[facet.back].contains(&number));
                prop_assert!(facet.front.is_none_or(|c| a.cells[c].contains(&number)));
            }
            for cell in 0..a.cells.len() {
                let mut edges: HashMap<(usize, usize), usize> = HashMap::new();
                for f in &a.cells[cell] {
                    let ring = &a.facets[*f].ring;
                    for i in 0..ring.len() {
                        let (x, y) = (ring[i], ring[(i + 1) % ring.len()]);
                        let edge = if a.facets[*f].back == cell { (x, y) } else { (y, x) };
                        *edges.entry(edge).or_default() += 1;
                    }
                }
                prop_assert!(edges.iter().all(|((x, y), n)| *n == 1 && edges.contains_key(&(*y, *x))));
            }
        }
    }
}
