//! Which experts answer for a point, and with what weight.
//!
//! Leaves of a tree of cells tile space. Each leaf's bump is 1 in the middle half of its cell and
//! falls, twice differentiably, to 0 a quarter of a side beyond it; bumps divided by their sum are
//! a partition of unity, as in Ohtake et al., "Multi-level partition of unity implicits", ACM TOG
//! 22 (2003). A leaf learns from the sites within a whole side of its middle, so that there are
//! some all around wherever it has a say. It is split when these become too many.

use std::collections::HashMap;

use super::grid::{Cell, Grid};
use crate::space::Point;

/// Half the width of an expert's surroundings, in sides of its cell.
const NEAR: f64 = 1.0;

/// Where a bump begins to fall and where it ends, in sides from the middle.
const FALL: (f64, f64) = (0.25, 0.75);

/// A cell of the tree.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Where.
    pub cell: Cell,
    /// Sites in its surroundings, counted while it is a leaf.
    pub near: usize,
    /// Number of its first child, the others follow; `None` for leaves.
    pub children: Option<u32>,
}

/// A leaf's say at a point. Weights add up to one, their gradients to zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Number of the leaf; `None` for the prior, where there is no tree.
    pub leaf: Option<u32>,
    /// w.
    pub weight: f64,
    /// ∇w, 1/m.
    pub slope: Point,
}

/// The tree of cells; grows under the sites it is told of.
#[derive(Clone, Debug)]
pub struct Partition {
    grid: Grid,
    nodes: Vec<Node>,
    tops: HashMap<[i64; 3], u32>,
    /// Sites a leaf takes.
    most: usize,
    /// Leaves are not split below this level.
    finest: i32,
}

impl Partition {
    /// Without sites. Leaves are split beyond `most` sites, but not below level `finest`.
    pub fn new(grid: Grid, most: usize, finest: i32) -> Partition {
        Partition { grid, nodes: Vec::new(), tops: HashMap::new(), most, finest }
    }

    /// All cells; those without children are the leaves.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The lattices its cells are of.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Half the width of the surroundings that a cell's expert learns from, metres.
    pub fn near(&self, cell: &Cell) -> f64 {
        NEAR * self.grid.side(cell.level)
    }

    /// Takes note of a new site. `count` says how many sites lie within so many metres of a cell's
    /// middle, the new one included.
    pub fn add(&mut self, seat: &Point, count: impl Fn(&Cell, f64) -> usize) {
        let Some(home) = self.grid.cell(seat, self.grid.top()) else { return };
        let mut open = Vec::new();
        for cell in self.grid.around(&home) {
            if self.is_near(&cell, seat) {
                let nodes = &mut self.nodes;
                open.push(*self.tops.entry(cell.index).or_insert_with(|| {
                    nodes.push(Node { cell, near: 0, children: None });
                    nodes.len() as u32 - 1
                }));
            }
        }
        while let Some(index) = open.pop() {
            let node = self.nodes[index as usize];
            if let Some(first) = node.children {
                let children = first..first + (1 << self.grid.dimension());
                open.extend(children.filter(|c| self.is_near(&self.nodes[*c as usize].cell, seat)));
                continue;
            }
            self.nodes[index as usize].near += 1;
            self.split(index, &count);
        }
    }

    fn is_near(&self, cell: &Cell, seat: &Point) -> bool {
        self.grid.reach(seat, &self.grid.centre(cell)) <= self.near(cell)
    }

    /// Splits a leaf, and its parts, as often as they are too full.
    fn split(&mut self, leaf: u32, count: &impl Fn(&Cell, f64) -> usize) {
        let mut full = vec![leaf];
        while let Some(index) = full.pop() {
            let node = self.nodes[index as usize];
            if node.near <= self.most || node.cell.level <= self.finest {
                continue;
            }
            let first = self.nodes.len() as u32;
            self.nodes[index as usize].children = Some(first);
            for cell in self.grid.children(&node.cell) {
                full.push(self.nodes.len() as u32);
                let near = count(&cell, self.near(&cell));
                self.nodes.push(Node { cell, near, children: None });
            }
        }
    }

    /// The leaves that have a say at `p`: a bounded number, the one whose cell `p` is in among
    /// them. Where numbers end, the prior alone.
    pub fn shares(&self, p: &Point) -> Vec<Share> {
        let prior = Share { leaf: None, weight: 1.0, slope: Point::zeros() };
        let Some(home) = self.grid.cell(p, self.grid.top()) else { return vec![prior] };
        let mut shares: Vec<Share> = Vec::with_capacity(8);
        let mut open = Vec::with_capacity(16);
        let around: Vec<Cell> = self.grid.around(&home).collect();
        for cell in around.iter().rev() {
            let Some((weight, slope)) = self.bump(cell, p) else { continue };
            match self.tops.get(&cell.index) {
                Some(top) => open.push(*top),
                None => shares.push(Share { leaf: None, weight, slope }),
            }
        }
        while let Some(index) = open.pop() {
            let node = &self.nodes[index as usize];
            let Some((weight, slope)) = self.bump(&node.cell, p) else { continue };
            match node.children {
                Some(first) => open.extend((first..first + (1 << self.grid.dimension())).rev()),
                None => shares.push(Share { leaf: Some(index), weight, slope }),
            }
        }
        let total: f64 = shares.iter().map(|s| s.weight).sum();
        let rise: Point = shares.iter().map(|s| s.slope).sum();
        for share in &mut shares {
            share.weight /= total;
            share.slope = (share.slope - rise * share.weight) / total;
        }
        shares
    }

    /// The cell's bump and its gradient; `None` where it is zero.
    fn bump(&self, cell: &Cell, p: &Point) -> Option<(f64, Point)> {
        let (centre, side) = (self.grid.centre(cell), self.grid.side(cell.level));
        let (mut factors, mut slopes) = ([1.0; 3], [0.0; 3]);
        for axis in 0..self.grid.dimension() {
            let x = (p[axis] - centre[axis]) / side;
            let s = (FALL.1 - x.abs()) / (FALL.1 - FALL.0);
            if s <= 0.0 {
                return None;
            }
            if s < 1.0 {
                factors[axis] = s * s * s * (10.0 - s * (15.0 - 6.0 * s));
                let fall = 30.0 * s * s * (1.0 - s) * (1.0 - s) / ((FALL.1 - FALL.0) * side);
                slopes[axis] = -fall * x.signum();
            }
        }
        let [a, b, c] = factors;
        let slope = Point::new(slopes[0] * b * c, a * slopes[1] * c, a * b * slopes[2]);
        Some((a * b * c, slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A tree over these sites.
    fn grown(dimension: usize, seats: &[Point]) -> Partition {
        let grid = Grid::new(dimension, &Point::zeros(), 0.01, 5);
        let mut partition = Partition::new(grid, 8, -3);
        for (i, seat) in seats.iter().enumerate() {
            partition.add(seat, |cell, half| {
                let near = |s: &&Point| grid.reach(s, &grid.centre(cell)) <= half;
                seats[..=i].iter().filter(near).count()
            });
        }
        partition
    }

    fn points(dimension: usize, draws: &[[f64; 3]]) -> Vec<Point> {
        let z = |z: f64| if dimension == 3 { z } else { 0.0 };
        draws.iter().map(|u| Point::new(u[0], u[1], z(u[2])) * 0.3).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn weights_are_a_differentiable_partition_of_unity(
            dimension in 2usize..=3,
            sites in proptest::collection::vec(proptest::array::uniform3(-1.0f64..1.0), 0..80),
            asked in proptest::collection::vec(proptest::array::uniform3(-1.5f64..1.5), 20),
        ) {
            let partition = grown(dimension, &points(dimension, &sites));
            for p in points(dimension, &asked) {
                let shares = partition.shares(&p);
                prop_assert!((shares.iter().map(|s| s.weight).sum::<f64>() - 1.0).abs() < 1e-12);
                let rise = shares.iter().map(|s| s.slope).sum::<Point>().norm();
                prop_assert!(rise < 1e-9, "{rise}");
                prop_assert!(shares.len() <= 40, "{}", shares.len());
                let weight = |p: &Point, leaf: Option<u32>| -> f64 {
                    partition.shares(p).iter().filter(|s| s.leaf == leaf).map(|s| s.weight).sum()
                };
                for share in shares.iter().filter(|s| s.leaf.is_some()) {
                    for axis in 0..dimension {
                        let mut step = Point::zeros();
                        step[axis] = 1e-7;
                        let (more, less) = (p + step, p - step);
                        let rise = weight(&more, share.leaf) - weight(&less, share.leaf);
                        prop_assert!((rise / 2e-7 - share.slope[axis]).abs() < 0.02);
                    }
                }
            }
        }

        #[test]
        fn leaves_know_how_many_sites_are_near(
            dimension in 2usize..=3,
            sites in proptest::collection::vec(proptest::array::uniform3(-1.0f64..1.0), 0..80),
        ) {
            let seats = points(dimension, &sites);
            let partition = grown(dimension, &seats);
            for node in partition.nodes().iter().filter(|n| n.children.is_none()) {
                let near = seats.iter().filter(|s| partition.is_near(&node.cell, s)).count();
                prop_assert_eq!(node.near, near);
                prop_assert!(near <= 8 || node.cell.level == -3);
            }
        }
    }
}
