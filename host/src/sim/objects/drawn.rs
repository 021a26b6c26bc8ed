//! Objects drawn at random, `random:D,SEED`: what nothing was chosen with.

use super::{Arms, ObjectSpec};
use crate::sim::random::Random;

/// Smallest and greatest extent, metres; extents between are as probable on a logarithmic scale.
const EXTENTS: [f64; 2] = [0.03, 0.15];

/// Apart from those of simulations with the same seed.
const STREAM: u64 = 0x0b1e_c750;

/// The object of that seed, of 2 or 3 dimensions, 30 to 150 mm across; in tenths of millimetres, so that its text is
/// short and exact.
pub(super) fn draw(dimension: usize, seed: u64) -> ObjectSpec {
    let [random] = Random::streams(seed ^ STREAM);
    let mut source = Source { random };
    if dimension == 2 { source.planar() } else { source.spatial() }
}

struct Source {
    random: Random,
}

impl Source {
    fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.random.unit()
    }

    /// From `low` to `high`, both included.
    fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((high - low + 1) as f64 * self.random.unit()) as usize
    }

    fn extent(&mut self) -> f64 {
        let [low, high] = EXTENTS.map(f64::ln);
        tenths(self.between([low, high]).exp())
    }

    fn extents<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.extent())
    }

    fn planar(&mut self) -> ObjectSpec {
        match self.count(0, 8) {
            0 | 1 => ObjectSpec::Rectangle(self.extents()),
            2 => ObjectSpec::Ellipse(self.extents()),
            3 => self.regular(),
            4 => ObjectSpec::Arms(self.arms(None)),
            5 | 6 => self.convex(),
            7 => self.star(),
            _ => self.skyline(),
        }
    }

    fn spatial(&mut self) -> ObjectSpec {
        match self.count(0, 10) {
            0..=2 => ObjectSpec::Cuboid(self.extents()),
            3 | 4 => ObjectSpec::Cylinder { diameter: self.extent(), height: self.extent() },
            5 => ObjectSpec::Ellipsoid(self.extents()),
            6 => ObjectSpec::Sphere(self.extent()),
            7 => {
                let height = Some(self.extent());
                ObjectSpec::Arms(self.arms(height))
            }
            8 | 9 => ObjectSpec::Prism { base: Box::new(self.planar()), height: self.extent() },
            _ => {
                let base = Box::new(self.regular());
                let top = if self.random.unit() < 0.5 {
                    0.0
                } else {
                    hundredths(self.between([0.3, 0.9]))
                };
                ObjectSpec::Pyramid { base, height: self.extent(), top }
            }
        }
    }

    fn regular(&mut self) -> ObjectSpec {
        ObjectSpec::Ngon { corners: self.count(3, 8), radius: tenths(self.extent() / 2.0) }
    }

    fn arms(&mut self, height: Option<f64>) -> Arms {
        let tee = self.random.unit() < 0.5;
        let size: [f64; 2] = self.extents();
        let width = tenths(size[0].min(size[1]) * self.between([0.25, 0.6]));
        Arms { tee, size, width, height }
    }

    /// Corners on an ellipse, none of them close together.
    fn convex(&mut self) -> ObjectSpec {
        let [a, b] = self.extents();
        self.around(4, 9, |_| [a / 2.0, b / 2.0])
    }

    /// Corners seen from the middle, at any distance.
    fn star(&mut self) -> ObjectSpec {
        let [a, b] = self.extents();
        self.around(5, 9, |source| {
            let share = source.between([0.5, 1.0]);
            [share * a / 2.0, share * b / 2.0]
        })
    }

    /// One corner in each of equal angles, in the middle half of it, on an ellipse that is asked for.
    fn around(
        &mut self,
        low: usize,
        high: usize,
        mut half: impl FnMut(&mut Self) -> [f64; 2],
    ) -> ObjectSpec {
        let count = self.count(low, high);
        let corner = |i: usize| {
            let part = i as f64 + self.between([0.25, 0.75]);
            let (sin, cos) = (std::f64::consts::TAU * part / count as f64).sin_cos();
            let [a, b] = half(self);
            [tenths(a * cos), tenths(b * sin)]
        };
        ObjectSpec::Corners((0..count).map(corner).collect())
    }

    /// Houses of two to four heights side by side.
    fn skyline(&mut self) -> ObjectSpec {
        let [width, height] = self.extents();
        let houses = self.count(2, 4);
        let mut corners = vec![[0.0, 0.0], [width, 0.0]];
        let mut last = None;
        for house in (0..houses).rev() {
            // A storey of a fifth, so that steps can be felt; never as high as the one beside it.
            let storeys = match last {
                None => self.count(2, 5),
                Some(last) => 2 + (last - 2 + self.count(1, 3)) % 4,
            };
            last = Some(storeys);
            let [left, right] =
                [house, house + 1].map(|i| tenths(width * i as f64 / houses as f64));
            let top = tenths(height * storeys as f64 / 5.0);
            corners.extend([[right, top], [left, top]]);
        }
        ObjectSpec::Corners(corners)
    }
}

fn tenths(metres: f64) -> f64 {
    (1e4 * metres).round() / 1e4
}

fn hundredths(share: f64) -> f64 {
    (100.0 * share).round() / 100.0
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::shape::Geometry;

    #[test]
    fn every_seed_is_an_object_whose_text_is_the_same_object() {
        for dimension in [2, 3] {
            let mut kinds = BTreeSet::new();
            for seed in 0..200 {
                let object = draw(dimension, seed);
                assert_eq!(object, draw(dimension, seed));
                let text = object.to_string();
                assert_eq!(text.parse::<ObjectSpec>().unwrap(), object, "{text}");
                assert_eq!(object.dimension(), dimension, "{text}");
                let geometry = object.geometry().unwrap();
                let (low, high) = geometry.bounds();
                for axis in 0..dimension {
                    let extent = high[axis] - low[axis];
                    assert!((0.005..0.16).contains(&extent), "{text}: {extent}");
                }
                if let Geometry::Mesh(mesh) = &geometry {
                    assert!(mesh.is_watertight() && mesh.volume() > 0.0, "{text}");
                }
                kinds.insert(text.split(':').next().unwrap().to_owned());
            }
            assert!(kinds.len() >= 7, "{kinds:?}");
        }
    }
}
