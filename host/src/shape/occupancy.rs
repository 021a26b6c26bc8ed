//! Occupancy grid: space in cells, each occupied, free or unknown by the log-odds of what contacts
//! say of it (Moravec and Elfes 1985; numbers as in OctoMap, Hornung et al. 2013).
//!
//! A contact says that its cell is occupied, and where its normal was felt that the object goes on
//! one cell further in and that the way out is free. What was not touched is unknown and no part of
//! the shape: a grid does not interpolate. Its precision is its resolution (thesis 2.1).

use std::collections::{BTreeMap, HashMap};

use super::{Geometry, Mesh, Outline};
use crate::reference::Contact;
use crate::space::Point;

/// Log-odds that one observation adds: occupied with probability 0.7, free with 0.6.
const HIT: f64 = 0.847;
const MISS: f64 = -0.405;

/// Log-odds stay between probabilities 0.12 and 0.97, so that a cell can change its mind.
const LEAST: f64 = -2.0;
const MOST: f64 = 3.5;

/// Cells a ray passes at most.
const MOST_CELLS: f64 = 1000.0;

/// Steps of a ray within one cell's width: the corners that it cuts by less are missed.
const STEPS: f64 = 8.0;

/// How a grid is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Width of a cell, metres.
    pub resolution: f64,
    /// How far out along its normal a contact shows space to be free, metres.
    pub reach: f64,
}

/// Cells of 5 mm, as the thesis' grids have (2.2.2), and 20 mm of free space.
impl Default for Layout {
    fn default() -> Self {
        Layout { resolution: 5e-3, reach: 2e-2 }
    }
}

/// Why there is no grid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Neither planar nor spatial.
    #[error("the dimension must be 2 or 3, not {0}")]
    Dimension(usize),
    /// No usable cell width.
    #[error("resolution {0} m: expected a positive finite length")]
    Resolution(f64),
    /// No usable reach.
    #[error("reach {reach} m: expected from zero to {MOST_CELLS} cells of {resolution} m")]
    Reach {
        /// As given, metres.
        reach: f64,
        /// Of a cell, metres.
        resolution: f64,
    },
    /// A number of a contact is unusable.
    #[error("contact {index}: {what}")]
    Contact {
        /// Counted from 0.
        index: usize,
        /// What is wrong and what was expected.
        what: &'static str,
    },
    /// A free point is not finite, or too far from the origin for cells this small.
    #[error("free point {index}: expected finite coordinates within a billion cells")]
    Free {
        /// Counted from 0.
        index: usize,
    },
}

/// A cell: (i, j, k) reaches from (i, j, k) to (i + 1, j + 1, k + 1) times the resolution.
type Cell = [i32; 3];

/// A sparse grid: cells that nothing was said of are not kept.
///
/// ```
/// use tactile_host::reference::Contact;
/// use tactile_host::shape::occupancy::{Layout, Occupancy};
/// use tactile_host::space::Point;
///
/// let contact = Contact {
///     point: Point::new(0.051, 0.002, 0.0),
///     normal: Some(Point::x()),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
/// };
/// let grid = Occupancy::new(2, Layout::default(), &[contact], &[])?;
/// assert!(grid.probability(&contact.point) > 0.5);
/// assert!(grid.probability(&Point::new(0.06, 0.002, 0.0)) < 0.5);
/// assert_eq!(grid.probability(&Point::new(0.0, 0.05, 0.0)), 0.5);
/// # Ok::<(), tactile_host::shape::occupancy::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Occupancy {
    dimension: usize,
    resolution: f64,
    cells: BTreeMap<Cell, f64>,
}

impl Occupancy {
    /// The grid of `contacts` and of `free` points that lie outside the object (metres).
    ///
    /// # Errors
    /// When the layout or a number of a contact or free point is unusable.
    pub fn new(
        dimension: usize,
        layout: Layout,
        contacts: &[Contact],
        free: &[Point],
    ) -> Result<Occupancy, Error> {
        let Layout { resolution, reach } = layout;
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        if !(resolution > 0.0 && resolution.is_finite()) {
            return Err(Error::Resolution(resolution));
        }
        if !(0.0..=MOST_CELLS * resolution).contains(&reach) {
            return Err(Error::Reach { reach, resolution });
        }
        let mut grid = Occupancy { dimension, resolution, cells: BTreeMap::new() };
        for (index, contact) in contacts.iter().enumerate() {
            contact.check(dimension).map_err(|what| Error::Contact { index, what })?;
            if !grid.holds(&contact.point) {
                return Err(Error::Contact { index, what: "too far away for cells this small" });
            }
            let cell = grid.cell(&contact.point);
            grid.add(cell, HIT);
            let Some(normal) = contact.normal else { continue };
            for seen in grid.passed(&contact.point, &normal, reach) {
                grid.add(seen, MISS);
            }
            if let Some(behind) = grid.passed(&contact.point, &-normal, resolution).first() {
                grid.add(*behind, HIT);
            }
        }
        for (index, point) in free.iter().enumerate() {
            if !grid.holds(point) {
                return Err(Error::Free { index });
            }
            let cell = grid.cell(point);
            grid.add(cell, MISS);
        }
        Ok(grid)
    }

    /// Probability that the cell around `point` is occupied; one half where nothing was said.
    pub fn probability(&self, point: &Point) -> f64 {
        let odds = self.cells.get(&self.cell(point)).copied().unwrap_or(0.0).exp();
        odds / (1.0 + odds)
    }

    /// Boundary of all cells more likely occupied than not: an outline, or a closed mesh whose edges
    /// are shared by four triangles where cells touch along an edge only. Empty without contacts.
    pub fn geometry(&self) -> Geometry {
        let occupied: Vec<Cell> =
            self.cells.iter().filter(|(_, odds)| **odds > 0.0).map(|(cell, _)| *cell).collect();
        if self.dimension == 2 {
            Geometry::Outline(self.outline(&occupied))
        } else {
            Geometry::Mesh(self.mesh(&occupied))
        }
    }

    fn holds(&self, point: &Point) -> bool {
        point.iter().all(|x| (x / self.resolution).abs() < 1e9)
    }

    fn cell(&self, point: &Point) -> Cell {
        let axis = |i: usize| match i {
            2 if self.dimension == 2 => 0,
            _ => (point[i] / self.resolution).floor() as i32,
        };
        [axis(0), axis(1), axis(2)]
    }

    fn add(&mut self, cell: Cell, odds: f64) {
        let kept = self.cells.entry(cell).or_default();
        *kept = (*kept + odds).clamp(LEAST, MOST);
    }

    /// The cells along a ray, but not the one it starts in; each once.
    fn passed(&self, from: &Point, direction: &Point, reach: f64) -> Vec<Cell> {
        let mut cells = vec![self.cell(from)];
        let steps = (STEPS * reach / self.resolution).ceil();
        for step in 1..=steps as usize {
            let cell = self.cell(&(from + direction * (reach * step as f64 / steps)));
            if cells.last() != Some(&cell) {
                cells.push(cell);
            }
        }
        cells.remove(0);
        cells
    }

    fn is_occupied(&self, cell: &Cell) -> bool {
        self.cells.get(cell).is_some_and(|odds| *odds > 0.0)
    }

    /// Loops with the cells on their left, turning left where two cells touch at a corner.
    fn outline(&self, occupied: &[Cell]) -> Outline {
        // From each corner of the lattice to the next.
        let mut next: BTreeMap<[i32; 2], Vec<[i32; 2]>> = BTreeMap::new();
        for &[i, j, _] in occupied {
            let corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
            let beyond = [[i, j - 1, 0], [i + 1, j, 0], [i, j + 1, 0], [i - 1, j, 0]];
            for side in (0..4).filter(|s| !self.is_occupied(&beyond[*s])) {
                next.entry(corners[side]).or_default().push(corners[(side + 1) % 4]);
            }
        }
        let mut loops = Vec::new();
        while let Some(start) = next.keys().next().copied() {
            let mut ring: Vec<[i32; 2]> = Vec::new();
            let (mut at, mut heading) = (start, [0, 0]);
            while let Some(ways) = next.get_mut(&at) {
                let left =
                    |to: &[i32; 2]| heading[0] * (to[1] - at[1]) - heading[1] * (to[0] - at[0]);
                let Some(choice) = (0..ways.len()).max_by_key(|w| left(&ways[*w])) else { break };
                let to = ways.swap_remove(choice);
                if ways.is_empty() {
                    next.remove(&at);
                }
                let turned = [to[0] - at[0], to[1] - at[1]];
                if turned != heading {
                    ring.push(at);
                }
                (at, heading) = (to, turned);
            }
            let metres = |c: &[i32; 2]| c.map(|x| f64::from(x) * self.resolution);
            loops.push(ring.iter().map(metres).collect());
        }
        Outline { loops }
    }

    fn mesh(&self, occupied: &[Cell]) -> Mesh {
        let mut names: HashMap<Cell, u32> = HashMap::new();
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        for cell in occupied {
            for axis in 0..3 {
                for up in [false, true] {
                    let mut beyond = *cell;
                    beyond[axis] += if up { 1 } else { -1 };
                    if self.is_occupied(&beyond) {
                        continue;
                    }
                    // Around the face counter-clockwise seen from above.
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(along_u, along_v)| {
                        let mut corner = *cell;
                        corner[axis] += i32::from(up);
                        corner[u] += along_u;
                        corner[v] += along_v;
                        *names.entry(corner).or_insert_with(|| {
                            let metres = corner.map(|x| f64::from(x) * self.resolution);
                            vertices.push(Point::from(metres));
                            vertices.len() as u32 - 1
                        })
                    });
                    let [a, b, c, d] = quad;
                    triangles.extend(if up {
                        [[a, b, c], [a, c, d]]
                    } else {
                        [[a, c, b], [a, d, c]]
                    });
                }
            }
        }
        Mesh::trusted(vertices, triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::metrics::compare;
    use crate::sim::ObjectSpec;

    fn contact(point: Point, normal: Option<Point>) -> Contact {
        Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.0873 }
    }

    fn touches(object: &str, count: usize) -> (Geometry, Vec<Contact>) {
        let truth = object.parse::<ObjectSpec>().unwrap().geometry().unwrap();
        let contacts = truth.samples(count).into_iter().map(|(p, n)| contact(p, Some(n)));
        let contacts = contacts.collect();
        (truth, contacts)
    }

    fn grid(dimension: usize, contacts: &[Contact]) -> Occupancy {
        Occupancy::new(dimension, Layout::default(), contacts, &[]).unwrap()
    }

    #[test]
    fn one_contact_occupies_its_cell_and_the_one_behind() {
        let touch = contact(Point::new(0.0525, 0.0025, 0.0), Some(Point::x()));
        let Geometry::Outline(outline) = grid(2, &[touch]).geometry() else { panic!() };
        assert_eq!(outline.loops.len(), 1);
        assert_eq!(outline.loops[0].len(), 4);
        assert!((outline.area() - 2.0 * 25e-6).abs() < 1e-12);
        let bare = contact(touch.point, None);
        let Geometry::Mesh(mesh) = grid(3, &[bare]).geometry() else { panic!() };
        assert!(mesh.is_watertight());
        assert!((mesh.volume() - 125e-9).abs() < 1e-15);
    }

    #[test]
    fn evidence_adds_up_and_free_space_wins_where_it_is_seen_more_often() {
        let at = Point::new(0.0525, 0.0025, 0.0);
        let once = grid(2, &[contact(at, None)]).probability(&at);
        let twice = grid(2, &[contact(at, None); 2]).probability(&at);
        assert!((once - 0.7).abs() < 1e-3 && twice > once);
        assert!(grid(2, &[contact(at, None); 1000]).probability(&at) < 0.98);
        let wild = [contact(at, None)];
        let free = Occupancy::new(2, Layout::default(), &wild, &[at; 3]).unwrap();
        assert!(free.probability(&at) < 0.5);
        let Geometry::Outline(outline) = free.geometry() else { panic!() };
        assert!(outline.loops.is_empty());
    }

    #[test]
    fn the_error_is_the_resolution_once_everything_is_touched() {
        for (object, count) in [("ellipse:0.12x0.06", 400), ("box:0.12x0.06x0.06", 8000)] {
            let (truth, contacts) = touches(object, count);
            let found = grid(truth.dimension(), &contacts).geometry();
            let d = compare(&found, &truth).unwrap();
            assert!(d.hausdorff < 0.015 && d.hausdorff > 0.0025, "{object}: {d:?}");
            let (_, few) = touches(object, 10);
            let sparse = compare(&grid(truth.dimension(), &few).geometry(), &truth).unwrap();
            assert!(sparse.hausdorff > d.hausdorff, "{object}");
        }
    }

    #[test]
    fn the_boundary_is_closed_and_outward() {
        let (_, contacts) = touches("ellipse:0.12x0.06", 50);
        let grid2 = grid(2, &contacts);
        let Geometry::Outline(outline) = grid2.geometry() else { panic!() };
        let cells = grid2.cells.values().filter(|o| **o > 0.0).count() as f64;
        assert!((outline.area() - cells * 25e-6).abs() < 1e-12);
        let (_, contacts) = touches("sphere:0.08", 300);
        let grid3 = grid(3, &contacts);
        let Geometry::Mesh(mesh) = grid3.geometry() else { panic!() };
        let cells = grid3.cells.values().filter(|o| **o > 0.0).count() as f64;
        assert!((mesh.volume() - cells * 125e-9).abs() < 1e-12);
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for t in mesh.triangles() {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry((a, b)).or_default() += 1;
                *edges.entry((b, a)).or_default() -= 1;
            }
        }
        assert!(edges.values().all(|n| *n == 0));
    }

    #[test]
    fn cells_that_touch_at_a_corner_are_two_loops() {
        let diagonal = [[0.0025, 0.0025], [0.0075, 0.0075]];
        let contacts = diagonal.map(|[x, y]| contact(Point::new(x, y, 0.0), None));
        let Geometry::Outline(outline) = grid(2, &contacts).geometry() else { panic!() };
        assert_eq!(outline.loops.len(), 2);
        assert!(outline.loops.iter().all(|l| l.len() == 4));
    }

    #[test]
    fn what_is_no_grid_is_refused_by_name() {
        let at = contact(Point::new(0.05, 0.0, 0.0), None);
        let with = |resolution, reach| {
            Occupancy::new(2, Layout { resolution, reach }, &[at], &[]).unwrap_err()
        };
        assert_eq!(with(0.0, 0.01), Error::Resolution(0.0));
        assert!(matches!(with(f64::NAN, 0.01), Error::Resolution(_)));
        assert!(matches!(with(0.005, f64::NAN), Error::Reach { .. }));
        assert!(matches!(with(1e-6, 0.01), Error::Reach { .. }));
        assert!(matches!(with(1e-13, 1e-13), Error::Contact { index: 0, .. }));
        let layout = Layout::default();
        assert_eq!(Occupancy::new(5, layout, &[], &[]).unwrap_err(), Error::Dimension(5));
        let nan = contact(Point::new(f64::NAN, 0.0, 0.0), None);
        let error = Occupancy::new(2, layout, &[at, nan], &[]).unwrap_err();
        assert!(matches!(error, Error::Contact { index: 1, .. }));
        let far = Occupancy::new(2, layout, &[], &[Point::repeat(f64::INFINITY)]).unwrap_err();
        assert_eq!(far, Error::Free { index: 0 });
        let Geometry::Mesh(mesh) = grid(3, &[]).geometry() else { panic!() };
        assert!(mesh.triangles().is_empty());
    }
}
