//! How two faces of an object lie to each other: parallel, square, or turned by a known angle.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use super::tangent::Face;
use crate::model::faces::regular::EXACT;
use crate::space::Point;

/// Which angle two faces make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Angle {
    /// None, or half a turn.
    Parallel,
    /// A quarter of a turn, either way.
    Square,
    /// In the plane: the second normal is the first turned by this (radians), one of so many
    /// directions that all faces have.
    Turned {
        /// Counter-clockwise.
        by: f64,
        /// Directions in a full turn.
        of: usize,
    },
}

/// An angle between two faces that is exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// Which.
    pub faces: [usize; 2],
    /// Between their normals.
    pub angle: Angle,
    /// −ln of how readily it is believed before anything is known of the faces.
    pub doubt: f64,
}

/// By how much two faces miss a relation, in units of [`EXACT`], with the derivative by their turns.
/// The first `count` rows are used.
#[derive(Clone, Copy, Debug)]
pub struct Miss {
    /// Numbers.
    pub count: usize,
    /// Of each number.
    pub residual: [f64; 2],
    /// Of each number, by the two turns of each of the two faces.
    pub by_turns: [[[f64; 2]; 2]; 2],
}

impl Relation {
    /// Parallel or square, whatever the faces as they lie are nearer to.
    pub fn nearest(faces: &[Face], i: usize, j: usize, doubt: f64) -> Relation {
        let square = faces[i].normal.dot(&faces[j].normal).abs() < FRAC_1_SQRT_2;
        let angle = if square { Angle::Square } else { Angle::Parallel };
        Relation { faces: [i, j], angle, doubt }
    }

    /// In the plane: the nearest of so many directions, of which the first face has one.
    pub fn turned(faces: &[Face], i: usize, j: usize, of: usize, doubt: f64) -> Relation {
        let [a, b] = [i, j].map(|k| faces[k].normal);
        let part = TAU / of as f64;
        let turn = (a.x * b.y - a.y * b.x).atan2(a.dot(&b));
        let by = (turn / part).round() * part;
        Relation { faces: [i, j], angle: Angle::Turned { by, of }, doubt }
    }

    /// How far the faces are from it.
    pub fn miss(&self, faces: &[Face], dimension: usize) -> Miss {
        let [a, b] = self.faces.map(|i| &faces[i]);
        let (s, t) = (a.tangents(dimension), b.tangents(dimension));
        let unit = 1.0 / EXACT;
        let mut miss = Miss { count: 1, residual: [0.0; 2], by_turns: [[[0.0; 2]; 2]; 2] };
        match self.angle {
            Angle::Square => {
                miss.residual[0] = unit * a.normal.dot(&b.normal);
                for l in 0..dimension - 1 {
                    miss.by_turns[0][0][l] = unit * s[l].dot(&b.normal);
                    miss.by_turns[0][1][l] = unit * t[l].dot(&a.normal);
                }
            }
            Angle::Parallel => {
                miss.count = dimension - 1;
                for k in 0..miss.count {
                    miss.residual[k] = unit * s[k].dot(&b.normal);
                    // A tangent turns with its own normal only.
                    miss.by_turns[k][0][k] = -unit * a.normal.dot(&b.normal);
                    for l in 0..dimension - 1 {
                        miss.by_turns[k][1][l] = unit * s[k].dot(&t[l]);
                    }
                }
            }
            Angle::Turned { by, .. } => {
                let (sin, cos) = by.sin_cos();
                let turned =
                    |p: Point| Point::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y, p.z);
                miss.residual[0] = unit * turned(s[0]).dot(&b.normal);
                miss.by_turns[0][0][0] = -unit * turned(a.normal).dot(&b.normal);
                miss.by_turns[0][1][0] = unit * turned(s[0]).dot(&t[0]);
            }
        }
        miss
    }

    /// What the relation costs beside half the squared miss: −ln of the density of exact relations over
    /// that of faces that lie anyhow, which is uniform over directions (parallel) or over the cosine in
    /// space and the angle in the plane (square, turned).
    pub fn worth(&self, dimension: usize) -> f64 {
        let (count, range): (f64, f64) = match (self.angle, dimension) {
            (Angle::Turned { of, .. }, _) => (1.0, TAU / of as f64),
            (_, 2) => (1.0, PI),
            (Angle::Square, _) => (1.0, 2.0),
            (Angle::Parallel, _) => (2.0, TAU),
        };
        0.5 * count * (TAU * EXACT * EXACT).ln() - range.ln() + self.doubt
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Point;
    use proptest::prelude::*;

    fn face(x: f64, y: f64, z: f64) -> Face {
        Face { normal: Point::new(x, y, z).normalize(), offset: 0.02 }
    }

    proptest! {
        #[test]
        fn misses_change_as_their_derivatives_say(
            a in proptest::array::uniform3(0.2f64..1.0),
            b in proptest::array::uniform3(-1.0f64..-0.2),
            kind in 0usize..3,
            dimension in 2usize..4,
            side in 0usize..2,
        ) {
            let flat = if dimension == 2 { 0.0 } else { 1.0 };
            let faces = [face(a[0], a[1], flat * a[2]), face(b[0], b[1], flat * b[2])];
            let angle = match (kind, dimension) {
                (0, _) => Angle::Square,
                (1, 2) => Angle::Turned { by: 2.1, of: 3 },
                _ => Angle::Parallel,
            };
            let relation = Relation { faces: [0, 1], angle, doubt: 0.0 };
            let miss = relation.miss(&faces, dimension);
            for turn in 0..dimension - 1 {
                let at = |h: f64| {
                    let mut change = [0.0; 3];
                    change[turn] = h;
                    let mut moved = faces;
                    moved[side] = faces[side].retract(dimension, &change);
                    // In the first face's own directions, which turn with it.
                    let kept = faces[0].tangents(dimension);
                    if angle == Angle::Square {
                        return [moved[0].normal.dot(&moved[1].normal) / EXACT, 0.0];
                    }
                    if let Angle::Turned { by, .. } = angle {
                        let turn = nalgebra::Rotation2::new(by);
                        let [a, b] = [moved[0], moved[1]].map(|f| f.normal.xy());
                        return [(turn * a).perp(&b) / EXACT, 0.0];
                    }
                    kept.map(|t| {
                        let turned = t - moved[0].normal * t.dot(&moved[0].normal);
                        turned.dot(&moved[1].normal) / EXACT
                    })
                };
                for k in 0..miss.count {
                    let slope = (at(1e-6)[k] - at(-1e-6)[k]) / 2e-6;
                    let exact = miss.by_turns[k][side][turn];
                    prop_assert!((slope - exact).abs() < 1e-3 * (1.0 + exact.abs()), "{slope} {exact}");
                }
            }
        }
    }
}
