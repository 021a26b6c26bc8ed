//! Faces that are parallel or square, where the whole graph is more plausible with them so.
//!
//! Made things have such faces, and grasps that see few of them leave their angles, and with them the
//! poses, half open. Li et al. (GlobFit, ACM Transactions on Graphics 30(4), 2011) align primitives
//! that nearly are aligned; here a relation is a factor between two faces and stays if the evidence
//! with it is higher, so that it corrects poses as well. [`Faces::regular`] does the same for faces
//! fitted to contacts at given poses.
//!
//! [`Faces::regular`]: crate::reference::Faces::regular

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use nalgebra::{DMatrix, DVector};

use super::explain::attempt;
use super::problem::{Problem, State};
use super::solve::Solved;
use super::tangent::Face;
use crate::reference::faces::regular::EXACT;

/// −ln of how readily two faces are believed to be related before anything is known of them.
const DOUBT: f64 = 1.1;

/// A relation whose two faces are off it by more than so many squared deviations is not tried.
const HOPELESS: f64 = 25.0;

/// More faces than this are curved, and their pairs would take long.
const MOST_FACES: usize = 24;

/// How two faces lie to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Relation {
    /// Which.
    pub faces: [usize; 2],
    /// At right angles, else parallel.
    pub square: bool,
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
    /// What the faces as they lie are nearer to.
    fn nearest(faces: &[Face], i: usize, j: usize) -> Relation {
        let square = faces[i].normal.dot(&faces[j].normal).abs() < FRAC_1_SQRT_2;
        Relation { faces: [i, j], square }
    }

    /// How far the faces are from it.
    pub fn miss(&self, faces: &[Face], dimension: usize) -> Miss {
        let [a, b] = self.faces.map(|i| &faces[i]);
        let (s, t) = (a.tangents(dimension), b.tangents(dimension));
        let unit = 1.0 / EXACT;
        let mut miss = Miss { count: 1, residual: [0.0; 2], by_turns: [[[0.0; 2]; 2]; 2] };
        if self.square {
            miss.residual[0] = unit * a.normal.dot(&b.normal);
            for l in 0..dimension - 1 {
                miss.by_turns[0][0][l] = unit * s[l].dot(&b.normal);
                miss.by_turns[0][1][l] = unit * t[l].dot(&a.normal);
            }
            return miss;
        }
        miss.count = dimension - 1;
        for k in 0..miss.count {
            miss.residual[k] = unit * s[k].dot(&b.normal);
            // A tangent turns with its own normal only.
            miss.by_turns[k][0][k] = -unit * a.normal.dot(&b.normal);
            for l in 0..dimension - 1 {
                miss.by_turns[k][1][l] = unit * s[k].dot(&t[l]);
            }
        }
        miss
    }

    /// What the relation costs beside half the squared miss: −ln of the density of exact relations over
    /// that of faces that lie anyhow, which is uniform over directions (parallel) or over the cosine in
    /// space and the angle in the plane (square).
    pub fn worth(&self, dimension: usize) -> f64 {
        let (count, range): (f64, f64) = match (self.square, dimension) {
            (_, 2) => (1.0, PI),
            (true, _) => (1.0, 2.0),
            (false, _) => (2.0, TAU),
        };
        0.5 * count * (TAU * EXACT * EXACT).ln() - range.ln() + DOUBT
    }
}

/// Relates faces one pair after the other, the most plausible first, as long as the cost falls.
pub fn regular<const D: usize>(problem: &Problem, best: &mut Solved<D>) {
    let count = best.state.faces.len();
    if count > MOST_FACES {
        return;
    }
    let mut open: Vec<(usize, usize)> =
        (0..count).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
    while let Some((at, relation)) = likeliest(problem, best, &open) {
        open.swap_remove(at);
        let mut state = best.state.clone();
        state.relations.push(relation);
        attempt(problem, best, state, best.labels.clone());
        if best.state.faces.len() != count {
            break;
        }
    }
}

/// The pair that is nearest to a relation that does not follow from those there are.
fn likeliest<const D: usize>(
    problem: &Problem,
    best: &Solved<D>,
    open: &[(usize, usize)],
) -> Option<(usize, Relation)> {
    let (dimension, faces) = (problem.dimension, &best.state.faces);
    let covariance = best.factor.faces();
    let known = directions(&best.state, dimension);
    let squared = |(at, (i, j)): (usize, &(usize, usize))| {
        let relation = Relation::nearest(faces, *i, *j);
        if follows(&best.state.relations, &known, &relation) {
            return None;
        }
        let miss = relation.miss(faces, dimension);
        let rows = DMatrix::from_fn(miss.count, covariance.ncols(), |k, column| {
            let (face, turn) = (column / dimension, column % dimension);
            match relation.faces.iter().position(|f| *f == face) {
                Some(side) if turn < dimension - 1 => miss.by_turns[k][side][turn],
                _ => 0.0,
            }
        });
        let spread =
            &rows * &covariance * rows.transpose() + DMatrix::identity(miss.count, miss.count);
        let residual = DVector::from_row_slice(&miss.residual[..miss.count]);
        let chi = residual.dot(&spread.cholesky()?.solve(&residual));
        (chi < HOPELESS).then_some((at, relation, chi))
    };
    let least = open.iter().enumerate().filter_map(squared).min_by(|a, b| a.2.total_cmp(&b.2));
    least.map(|(at, relation, _)| (at, relation))
}

/// Faces by direction: those with the same number are parallel, in the plane parallel or square,
/// because of relations.
fn directions(state: &State, dimension: usize) -> Vec<usize> {
    let mut class: Vec<usize> = (0..state.faces.len()).collect();
    for relation in state.relations.iter().filter(|r| dimension == 2 || !r.square) {
        let [a, b] = relation.faces.map(|i| class[i]);
        class.iter_mut().filter(|c| **c == a).for_each(|c| *c = b);
    }
    class
}

/// Whether a relation says what others say already.
fn follows(relations: &[Relation], class: &[usize], relation: &Relation) -> bool {
    let [a, b] = relation.faces.map(|i| class[i]);
    let alike = |r: &Relation| {
        let [c, d] = r.faces.map(|i| class[i]);
        r.square && relation.square && ((a, b) == (c, d) || (a, b) == (d, c))
    };
    a == b || relations.iter().any(alike)
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
            square in any::<bool>(),
            dimension in 2usize..4,
            side in 0usize..2,
        ) {
            let flat = if dimension == 2 { 0.0 } else { 1.0 };
            let faces = [face(a[0], a[1], flat * a[2]), face(b[0], b[1], flat * b[2])];
            let relation = Relation { faces: [0, 1], square };
            let miss = relation.miss(&faces, dimension);
            for turn in 0..dimension - 1 {
                let at = |h: f64| {
                    let mut change = [0.0; 3];
                    change[turn] = h;
                    let mut moved = faces;
                    moved[side] = faces[side].retract(dimension, &change);
                    // In the first face's own directions, which turn with it.
                    let kept = faces[0].tangents(dimension);
                    if square {
                        return [moved[0].normal.dot(&moved[1].normal) / EXACT, 0.0];
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

    #[test]
    fn what_follows_is_not_said_twice() {
        let parallel = |i, j| Relation { faces: [i, j], square: false };
        let square = |i, j| Relation { faces: [i, j], square: true };
        let faces = vec![face(1.0, 0.0, 0.0); 4];
        let state = |relations| State { poses: Vec::new(), faces: faces.clone(), relations };
        let flat = state(vec![square(0, 1), parallel(0, 2)]);
        let known = directions(&flat, 2);
        assert!(follows(&flat.relations, &known, &square(1, 2)));
        assert!(!follows(&flat.relations, &known, &square(1, 3)));
        let solid = state(vec![square(0, 1), parallel(0, 2)]);
        let known = directions(&solid, 3);
        assert!(follows(&solid.relations, &known, &square(2, 1)));
        assert!(follows(&solid.relations, &known, &parallel(2, 0)));
        assert!(!follows(&solid.relations, &known, &square(0, 3)));
        assert!(!follows(&solid.relations, &known, &parallel(1, 3)));
    }
}
