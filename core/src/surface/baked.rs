//! A map whose field is baked on a grid once per grasp: what a probe costs does not depend on the
//! number of contacts, and a filter that asks tens of thousands of times saves most of its time.

use crate::contact::Contact;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::{Grid, Insertion, Map, Probe, Surface};

/// How far beyond its contacts the field is baked, metres: where particles put the contacts of the
/// next grasp, three times the thesis' motion noise.
const MARGIN: f32 = 0.03;

/// The same at most, in halves of the contacts' extent: beside a small object a cell would be as large as it.
const WIDEST: f32 = 4.0;

/// The map `M`, asked through a [`Grid`] of `NODES` nodes about its contacts; exactly as before
/// outside the grid, and until the first [`refit`](Map::refit). [`Grid::bound`] and
/// [`Grid::error`] say what interpolation costs. A map does not say which contacts it let go: the grid is
/// about all since it was cleared, and one far away leaves it coarse until then.
///
/// ```
/// use tactile_core::contact::Contact;
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::Planar;
/// use tactile_core::surface::{Baked, Faces, Map, Surface};
///
/// let mut map = Baked::<Planar, Faces<Planar, 4>, 400>::new(Faces::new());
/// map.insert(&Contact {
///     point: Vector([0.02, 0.0]),
///     normal: Some(Vector([1.0, 0.0])),
///     point_deviation: 1e-3,
///     normal_deviation: 0.09,
///     finger: 0,
/// });
/// map.refit();
/// assert!((map.probe(Vector([0.03, 0.005])).value - 0.01).abs() < 1e-6);
/// ```
#[derive(Clone, Debug)]
pub struct Baked<S: Space, M, const NODES: usize> {
    map: M,
    grid: Grid<S, NODES>,
    /// Corners of the box about the contacts.
    low: S::Vector,
    high: S::Vector,
    /// Whether there is a contact in the box.
    touched: bool,
    /// Half the grid's width; zero until there is one.
    reach: f32,
}

impl<S: Space, M, const NODES: usize> Baked<S, M, NODES> {
    /// Around an empty `map`; all zero bits when that is.
    pub const fn new(map: M) -> Self {
        Baked {
            map,
            grid: Grid::new(),
            low: S::Vector::ZERO,
            high: S::Vector::ZERO,
            touched: false,
            reach: 0.0,
        }
    }

    /// What is baked.
    pub fn map(&self) -> &M {
        &self.map
    }

    /// The same, to set its model; [`clear`](Map::clear) afterwards.
    pub fn map_mut(&mut self) -> &mut M {
        &mut self.map
    }

    /// What it was baked into.
    pub fn grid(&self) -> &Grid<S, NODES> {
        &self.grid
    }

    fn centre(&self) -> S::Vector {
        (self.low + self.high) * 0.5
    }

    fn covers(&self, point: S::Vector) -> bool {
        let from = point - self.centre();
        (0..S::DIMENSION).all(|axis| from[axis].abs() < self.reach)
    }
}

impl<S: Space, M: Map<S>, const NODES: usize> Surface<S> for Baked<S, M, NODES> {
    fn probe(&self, point: S::Vector) -> Probe<S> {
        if self.covers(point) { self.grid.probe(point) } else { self.map.probe(point) }
    }
}

impl<S: Space, M: Map<S>, const NODES: usize> Map<S> for Baked<S, M, NODES> {
    fn insert(&mut self, contact: &Contact<S>) -> Insertion {
        let insertion = self.map.insert(contact);
        if insertion != Insertion::Dropped && contact.point.is_finite() {
            // Until the refit the field that was baked is that of other contacts.
            self.reach = 0.0;
            for axis in 0..S::DIMENSION {
                let x = contact.point[axis];
                let (low, high) = (self.low[axis], self.high[axis]);
                self.low[axis] = if self.touched { low.min(x) } else { x };
                self.high[axis] = if self.touched { high.max(x) } else { x };
            }
            self.touched = true;
        }
        insertion
    }

    fn refit(&mut self) {
        self.map.refit();
        if !self.touched || Grid::<S, NODES>::capacity() < 2 {
            return;
        }
        let mut half: f32 = 0.0;
        for axis in 0..S::DIMENSION {
            half = half.max(0.5 * (self.high[axis] - self.low[axis]));
        }
        self.reach = half + if half > 0.0 { MARGIN.min(WIDEST * half) } else { MARGIN };
        self.grid.bake(&self.map, self.centre(), self.reach);
    }

    fn clear(&mut self) {
        self.map.clear();
        self.touched = false;
        self.reach = 0.0;
    }

    fn contacts(&self) -> usize {
        self.map.contacts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;
    use crate::surface::cholesky::packed;
    use crate::surface::{Ball, Gpis, Matern32, Prior, Training};
    use std::boxed::Box;

    type Exact = Gpis<Planar, Matern32, Ball<Planar>, 14, 42, { packed(42) }>;

    /// An ellipse of 100 mm by 60 mm, or of so many times that.
    fn touched(size: f32) -> Box<Baked<Planar, Exact, 2500>> {
        let mut map = Box::new(Baked::<Planar, Exact, 2500>::new(Exact::new()));
        let kernel = Matern32 { amplitude: 0.03 * size, lengthscale: 0.1 * size };
        map.map_mut().configure(kernel, Ball::UNSET, Training::Normals);
        for k in 0..14 {
            let (sin, cos) = (0.45 * k as f32 + 0.3).sin_cos();
            map.insert(&Contact {
                point: Vector([0.05 * cos + 0.2, 0.03 * sin]) * size,
                normal: Vector([cos / 0.05, sin / 0.03]).normalized(),
                point_deviation: 1e-3 * size,
                normal_deviation: 0.0873,
                finger: 0,
            });
        }
        map.refit();
        map
    }

    #[test]
    fn probes_are_within_the_grids_bound_and_exact_outside() {
        let map = touched(1.0);
        let (value, gradient) = map.grid().bound(map.map());
        let far = Vector([0.2, 0.2]);
        assert_eq!(map.probe(far), map.map().probe(far));
        let mut worst: f32 = 0.0;
        for i in 0..400 {
            let p = Vector([0.13 + 0.007 * (i % 20) as f32, -0.07 + 0.007 * (i / 20) as f32]);
            let (got, want) = (map.probe(p), map.map().probe(p));
            worst = worst.max((got.value - want.value).abs());
            assert!((got.value - want.value).abs() <= value);
            assert!((got.gradient - want.gradient).norm() <= gradient);
        }
        assert!(worst > 0.0 && worst < 3e-4, "{worst}");
    }

    #[test]
    fn a_small_object_is_many_cells_wide() {
        let map = touched(0.01);
        for i in 0..400 {
            let p =
                Vector([0.13 + 0.007 * (i % 20) as f32, -0.07 + 0.007 * (i / 20) as f32]) * 0.01;
            let (got, want) = (map.probe(p), map.map().probe(p));
            assert!((got.value - want.value).abs() < 2e-5, "{p:?}: {got:?} for {want:?}");
        }
    }

    #[test]
    fn it_is_exact_until_refitted_and_after_clearing() {
        let mut map = touched(1.0);
        let at = Vector([0.23, 0.02]);
        let contact = Contact {
            point: Vector([0.26, 0.0]),
            normal: Some(Vector([1.0, 0.0])),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
            finger: 0,
        };
        assert_ne!(map.probe(at), map.map().probe(at));
        map.insert(&contact);
        assert_eq!(map.probe(at), map.map().probe(at));
        map.clear();
        assert_eq!((map.contacts(), map.probe(at)), (0, map.map().probe(at)));
        map.refit();
        assert!(map.probe(at).value.is_finite());
        let bad = Contact { point: Vector([f32::NAN, 0.0]), ..contact };
        assert_eq!(map.insert(&bad), Insertion::Dropped);
        map.refit();
        assert_eq!(map.contacts(), 0);
    }
}
