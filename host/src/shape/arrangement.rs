//! The cells into which planes cut a box, and the facets between them.
//!
//! Every plane goes right through, so facets of neighbouring cells are the same facets and any union
//! of cells has a closed surface. A vertex is on one side of a plane or the other, never on it, and
//! each edge is cut once for all cells along it: the combinatorics hold whatever rounding does.

use std::collections::{BTreeSet, HashMap};

use crate::space::Point;

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
    /// the distance to its nearest side, negative outside it, metres.
    pub fn clearance(&self, facet: &Facet, normal: &Point, point: &Point) -> f64 {
        let corners: Vec<Point> = self.corners(facet).collect();
        (0..corners.len())
            .filter_map(|i| {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                Some(normal.cross(&(b - a)).try_normalize(1e-12)?.dot(&(point - a)))
            })
            .fold(f64::INFINITY, f64::min)
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
        let sides: Vec<bool> = self.planes.iter().map(|(n, rho)| n.dot(point) > *rho).collect();
        (0..self.cells.len()).filter(|_| inside_box).find(|c| {
            let middle = centre(&self.cells[*c]);
            let same = self.planes.iter().zip(&sides);
            same.fold(true, |all, ((n, rho), side)| all && (n.dot(&middle) > *rho) == *side)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
