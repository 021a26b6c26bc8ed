//! The nested lattices that hold both summaries and experts.

use crate::space::Point;

/// A cubic (square) cell: level l has sides of 2^l units, and each cell has eight (four) children.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cell {
    /// Sides are 2^level units; negative levels are finer.
    pub level: i32,
    /// Along each axis; 0 along z in the plane.
    pub index: [i64; 3],
}

/// Where the lattices lie.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    dimension: usize,
    origin: Point,
    unit: f64,
    top: i32,
}

/// Cells farther than this from the origin are not numbered.
const FARTHEST: f64 = (1u64 << 50) as f64;

impl Grid {
    /// Lattices of levels up to `top`, such that `centre` is the middle of a cell of the top level;
    /// `unit` is the side of level 0, metres.
    pub fn new(dimension: usize, centre: &Point, unit: f64, top: i32) -> Grid {
        let mut grid = Grid { dimension, origin: Point::zeros(), unit, top };
        for axis in 0..dimension {
            grid.origin[axis] = centre[axis] - 0.5 * grid.side(top);
        }
        grid
    }

    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The coarsest level.
    pub fn top(&self) -> i32 {
        self.top
    }

    /// Side of a cell, metres.
    pub fn side(&self, level: i32) -> f64 {
        self.unit * 2f64.powi(level)
    }

    /// The cell a point is in; `None` where the point is not finite or absurdly far away.
    pub fn cell(&self, point: &Point, level: i32) -> Option<Cell> {
        let mut index = [0; 3];
        for axis in 0..self.dimension {
            let steps = (point[axis] - self.origin[axis]) / self.side(level);
            if !(steps.abs() < FARTHEST) {
                return None;
            }
            index[axis] = steps.floor() as i64;
        }
        Some(Cell { level, index })
    }

    /// Middle of a cell, metres.
    pub fn centre(&self, cell: &Cell) -> Point {
        let mut centre = Point::zeros();
        for axis in 0..self.dimension {
            centre[axis] =
                self.origin[axis] + (cell.index[axis] as f64 + 0.5) * self.side(cell.level);
        }
        centre
    }

    /// Children of a cell, in the order of [`Grid::octant`].
    pub fn children(&self, cell: &Cell) -> impl Iterator<Item = Cell> + use<> {
        let Cell { level, index } = *cell;
        let dimension = self.dimension;
        (0..1usize << dimension).map(move |octant| {
            let mut child = index;
            for (axis, i) in child.iter_mut().enumerate().take(dimension) {
                *i = 2 * *i + (octant >> axis & 1) as i64;
            }
            Cell { level: level - 1, index: child }
        })
    }

    /// Which child of its parent a cell is.
    pub fn octant(&self, cell: &Cell) -> usize {
        (0..self.dimension).map(|axis| ((cell.index[axis] & 1) as usize) << axis).sum()
    }

    /// The cell and all that touch it, in a fixed order.
    pub fn around(&self, cell: &Cell) -> impl Iterator<Item = Cell> + use<> {
        let Cell { level, index } = *cell;
        let dimension = self.dimension;
        (0..3usize.pow(dimension as u32)).map(move |mut which| {
            let mut near = index;
            for i in near.iter_mut().take(dimension) {
                *i += (which % 3) as i64 - 1;
                which /= 3;
            }
            Cell { level, index: near }
        })
    }

    /// Largest coordinate of `point` − `centre` along an axis there is, metres.
    pub fn reach(&self, point: &Point, centre: &Point) -> f64 {
        (0..self.dimension).map(|axis| (point[axis] - centre[axis]).abs()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn children_tile_their_parent(
            dimension in 2usize..=3,
            p in proptest::array::uniform3(-10.0f64..10.0),
            level in -3i32..6,
        ) {
            let p = Point::new(p[0], p[1], if dimension == 3 { p[2] } else { 0.0 });
            let grid = Grid::new(dimension, &Point::new(0.1, 0.2, 0.0), 0.01, 6);
            let parent = grid.cell(&p, level + 1).unwrap();
            let cell = grid.cell(&p, level).unwrap();
            prop_assert_eq!(grid.children(&parent).nth(grid.octant(&cell)), Some(cell));
            prop_assert!(grid.reach(&p, &grid.centre(&cell)) <= 0.5001 * grid.side(level));
            prop_assert_eq!(grid.around(&cell).filter(|c| *c == cell).count(), 1);
        }
    }

    #[test]
    fn points_that_are_nowhere_have_no_cell() {
        let grid = Grid::new(3, &Point::zeros(), 0.01, 6);
        assert_eq!(grid.cell(&Point::new(f64::NAN, 0.0, 0.0), 0), None);
        assert_eq!(grid.cell(&Point::new(0.0, 1e300, 0.0), 0), None);
        assert_eq!(grid.cell(&Point::zeros(), 6).unwrap().index, [0; 3]);
    }
}
