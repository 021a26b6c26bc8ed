//! The distance to a mesh, to first order about the centres of a grid's cells: one fetch where the
//! exact answer walks a tree.

use super::faces::Face;
use super::{Near, Surface};
use crate::space::Point;

/// About so many cells, whatever the shape of the box: 28 along each side of a compact object. At 16
/// bytes each they stay in a core's cache.
const CELLS: f64 = 22_000.0;

/// The grid reaches this part of the mesh's longest side beyond it, on every side. Farther out the
/// outermost cells are extrapolated.
const MARGIN: f64 = 0.08;

/// No cell.
const NOWHERE: u32 = u32::MAX;

/// What the distance is about the centre of a cell: `offset` + gradient · point.
#[derive(Clone, Copy)]
struct Cell {
    gradient: [f32; 3],
    offset: f32,
}

/// Distances to a mesh on a grid.
///
/// A cell holds the distance d₀ ≥ 0 at its centre p₀ and the unit vector g away from the surface;
/// nearby the distance is d₀ + g·(p − p₀). Where a cell straddles the surface this runs through zero
/// to negative values, so that its square has no kink there: the mesh needs no inside.
pub struct Grid {
    low: Point,
    per_metre: f64,
    counts: [usize; 3],
    cells: Vec<Cell>,
    /// Of the face nearest to each cell.
    normals: Vec<[f32; 3]>,
}

impl Grid {
    /// The grid of `faces`: exact in the cells along the surface; from there nearest faces spread
    /// from cell to cell by sweeps along the axes (Danielsson 1980; Bridson's closest triangles).
    pub fn new(faces: &[Face]) -> Grid {
        let corners = || faces.iter().flat_map(|f| f.corners);
        let Some(first) = corners().next() else {
            let nowhere = Cell { gradient: [0.0; 3], offset: f32::INFINITY };
            let (cells, normals) = (vec![nowhere], vec![[0.0; 3]]);
            return Grid { low: Point::zeros(), per_metre: 1.0, counts: [1; 3], cells, normals };
        };
        let (least, greatest) =
            corners().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        let extent = greatest - least;
        let margin = (MARGIN * extent.max()).max(1e-6);
        let low = least.add_scalar(-margin);
        let size = extent.add_scalar(2.0 * margin);
        let spacing = (size.product() / CELLS).cbrt();
        let counts = [0, 1, 2].map(|a| ((size[a] / spacing).ceil() as usize).max(2));
        let mut sweep = Sweep {
            faces,
            low,
            spacing,
            counts,
            nearest: vec![NOWHERE; counts.iter().product()],
            closest: vec![Point::zeros(); counts.iter().product()],
            squared: vec![f64::INFINITY; counts.iter().product()],
        };
        sweep.seed();
        sweep.spread();
        let (cells, normals) = sweep.cells();
        Grid { low, per_metre: 1.0 / spacing, counts, cells, normals }
    }
}

impl Surface for Grid {
    #[inline]
    fn near(&self, point: &Point) -> Near {
        // The cast takes what is below the grid, and NaN, to its first cells.
        let at = |axis: usize| {
            let place = (point[axis] - self.low[axis]) * self.per_metre;
            (place as usize).min(self.counts[axis] - 1)
        };
        let place = (at(2) * self.counts[1] + at(1)) * self.counts[0] + at(0);
        let Cell { gradient: [x, y, z], offset } = self.cells[place];
        let gradient = Point::new(x.into(), y.into(), z.into());
        let along = gradient.x * point.x + gradient.y * point.y + gradient.z * point.z;
        Near { distance: f64::from(offset) + along, gradient, place }
    }

    #[inline]
    fn normal(&self, near: &Near, _: &Point) -> Point {
        let [x, y, z] = self.normals[near.place];
        Point::new(x.into(), y.into(), z.into())
    }
}

/// The nearest face of every cell, being found.
struct Sweep<'a> {
    faces: &'a [Face],
    low: Point,
    spacing: f64,
    counts: [usize; 3],
    nearest: Vec<u32>,
    closest: Vec<Point>,
    squared: Vec<f64>,
}

impl Sweep<'_> {
    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.counts[1] + j) * self.counts[0] + i
    }

    fn centre(&self, cell: [usize; 3]) -> Point {
        self.low + Point::from(cell.map(|i| (i as f64 + 0.5) * self.spacing))
    }

    /// Takes the face for the cell if it is nearer than what was known.
    fn offer(&mut self, cell: [usize; 3], face: u32) {
        let at = self.index(cell);
        let centre = self.centre(cell);
        let closest = self.faces[face as usize].closest(&centre);
        let squared = (centre - closest).norm_squared();
        if squared < self.squared[at] {
            (self.nearest[at], self.closest[at], self.squared[at]) = (face, closest, squared);
        }
    }

    /// Offers every face to the cells that it passes through or beside.
    fn seed(&mut self) {
        let reach = 0.9 * self.spacing;
        for number in 0..self.faces.len() {
            let Face { corners: [a, b, c], normal, .. } = self.faces[number];
            let (low, high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
            let range = |axis: usize| {
                let place = |x: f64| ((x - self.low[axis]) / self.spacing - 0.5).max(0.0);
                let last = self.counts[axis] - 1;
                let first = place(low[axis] - reach).ceil() as usize;
                first.min(last)..=(place(high[axis] + reach) as usize).min(last)
            };
            let [is, js, ks] = [range(0), range(1), range(2)];
            for k in ks {
                for j in js.clone() {
                    for i in is.clone() {
                        let off = normal.dot(&(self.centre([i, j, k]) - a));
                        if off.abs() <= reach {
                            self.offer([i, j, k], number as u32);
                        }
                    }
                }
            }
        }
    }

    /// Hands nearest faces on along the axes, once in each of the eight directions.
    fn spread(&mut self) {
        let [nx, ny, nz] = self.counts;
        let strides = [1, nx, nx * ny];
        for direction in 0..8usize {
            let walk = |axis: usize, step: usize| match direction >> axis & 1 {
                0 => step,
                _ => self.counts[axis] - 1 - step,
            };
            let back = |axis: usize, at: usize| match direction >> axis & 1 {
                0 => at - strides[axis],
                _ => at + strides[axis],
            };
            for c in 0..nz {
                for b in 0..ny {
                    for a in 0..nx {
                        let cell = [walk(0, a), walk(1, b), walk(2, c)];
                        let here = self.index(cell);
                        let centre = self.centre(cell);
                        for (axis, step) in [a, b, c].into_iter().enumerate() {
                            if step == 0 {
                                continue;
                            }
                            let there = back(axis, here);
                            // A bound that costs nothing; only a face that passes it is asked.
                            let bound = (centre - self.closest[there]).norm_squared();
                            if bound < self.squared[here]
                                && self.nearest[there] != self.nearest[here]
                                && self.nearest[there] != NOWHERE
                            {
                                let face = self.nearest[there];
                                let closest = self.faces[face as usize].closest(&centre);
                                let squared = (centre - closest).norm_squared();
                                if squared < self.squared[here] {
                                    self.nearest[here] = face;
                                    self.closest[here] = closest;
                                    self.squared[here] = squared;
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    fn cells(&self) -> (Vec<Cell>, Vec<[f32; 3]>) {
        let [nx, ny, nz] = self.counts;
        let mut cells = Vec::with_capacity(self.nearest.len());
        let mut normals = Vec::with_capacity(self.nearest.len());
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let at = self.index([i, j, k]);
                    let face = self.faces.get(self.nearest[at] as usize);
                    let normal = face.map_or(Point::zeros(), |f| f.normal_at(&self.closest[at]));
                    let away = self.centre([i, j, k]) - self.closest[at];
                    let distance = away.norm();
                    let on = distance < 1e-6 * self.spacing;
                    let gradient = if on { normal } else { away / distance };
                    // The distance is zero at the nearest point and grows along the gradient.
                    let offset = -gradient.dot(&self.closest[at]) as f32;
                    cells.push(Cell { gradient: gradient.map(|x| x as f32).into(), offset });
                    normals.push(normal.map(|x| x as f32).into());
                }
            }
        }
        (cells, normals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::localize::Exact;
    use crate::localize::faces::faces;
    use crate::shape::Mesh;
    use crate::shape::mesh::tests::cuboid;
    use crate::sim::random::Random;

    #[test]
    fn distances_are_the_meshs() {
        let mesh = cuboid([0.06, 0.04, 0.02]);
        let (grid, exact) = (Grid::new(&faces(&mesh)), Exact::new(faces(&mesh)).unwrap());
        let [mut random] = Random::streams(3);
        let mut errors = Vec::new();
        for _ in 0..2000 {
            let p = Point::from([0.07, 0.05, 0.03].map(|reach| random.around_zero(reach)));
            let (approximate, truth) = (grid.near(&p), exact.near(&p));
            errors.push((approximate.distance.abs() - truth.distance.abs()).abs());
        }
        errors.sort_by(f64::total_cmp);
        // Exact but in the cells that the medial surface or an edge's fan divides.
        assert!(errors[1500] < 2e-4, "{}", errors[1500]);
        assert!(errors[1999] < 4e-3, "{}", errors[1999]);
    }

    #[test]
    fn beyond_the_grid_distances_go_on() {
        let grid = Grid::new(&faces(&cuboid([0.05; 3])));
        let far = grid.near(&Point::new(0.01, -0.02, 1.05));
        assert!((far.distance - 1.0).abs() < 1e-3, "{}", far.distance);
        assert!((far.gradient - Point::z()).norm() < 1e-3);
        assert!(grid.near(&Point::from([f64::NAN; 3])).distance.is_nan());
    }

    #[test]
    fn a_flat_mesh_has_distances_too() {
        let corners = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
        let vertices = corners.map(|[x, y]| Point::new(x, y, 0.0)).to_vec();
        let mesh = Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let near = Grid::new(&faces(&mesh)).near(&Point::new(0.05, 0.02, 0.003));
        assert!((near.distance.abs() - 0.003).abs() < 1e-6, "{}", near.distance);
    }
}
