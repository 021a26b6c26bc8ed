//! Faces that are parallel or square, where the whole graph is more plausible with them so.
//!
//! Made things have such faces, and grasps that see few of them leave their angles, and with them the
//! poses, half open. Li et al. (GlobFit, ACM Transactions on Graphics 30(4), 2011) align primitives
//! that nearly are aligned; here a relation is a factor between two faces and stays if the evidence
//! with it is higher, so that it corrects poses as well. [`Faces::regular`] does the same for faces
//! fitted to contacts at given poses.
//!
//! Evidence for one relation alone is weak: of any object some two faces are a few degrees from
//! square, which is as little as grasps tell. What is regular is so as a whole: that all
//! faces agree is hardly ever a coincidence. So an order of the whole is believed as readily as none,
//! and a relation that stands alone only where the odds are strong.
//!
//! [`Faces::regular`]: crate::model::Faces::regular

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};

use super::explain::settle;
use super::problem::{Problem, State};
use super::relation::{Angle, Relation};
use super::solve::Solved;
use super::tangent::Face;

/// −ln of how readily two faces are believed to be related on their own: odds of 20, “strong” by Kass &
/// Raftery (Journal of the American Statistical Association 90, 1995).
const ALONE: f64 = 3.0;

/// −ln of how readily an object is believed to have one of the three orders there are.
const WHOLE: f64 = 1.1;

/// Relations that the faces miss by more squared deviations than so many, and one for every number,
/// are not tried.
const HOPELESS: f64 = 25.0;

/// More faces than this are curved, and their pairs would take long.
pub(super) const MOST_FACES: usize = 24;

/// Faces turned from the opposite of each other by more than this are no pair, cosine.
const OPPOSITE: f64 = 0.8;

/// Gives the faces the order that the evidence is highest with, if any, and then relates faces one pair
/// after the other, the most plausible first, as long as the cost falls. Returns the other graphs that
/// were tried.
pub fn regular<const D: usize>(problem: &Problem, best: &mut Solved<D>) -> Vec<Solved<D>> {
    let mut others = Vec::new();
    if best.state.faces.len() > MOST_FACES {
        return others;
    }
    order(problem, best, &mut others);
    let count = best.state.faces.len();
    let mut open: Vec<(usize, usize)> =
        (0..count).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
    while let Some((at, relation)) = likeliest(problem, best, &open) {
        open.swap_remove(at);
        let mut state = best.state.clone();
        state.relations.push(relation);
        let labels = best.labels.clone();
        compete(best, settle(problem, state, labels), &mut others);
        if best.state.faces.len() != count {
            break;
        }
    }
    others
}

/// Takes the order of the whole with the least cost, if that is less than without one.
fn order<const D: usize>(problem: &Problem, best: &mut Solved<D>, others: &mut Vec<Solved<D>>) {
    let free = best.clone();
    let covariance = free.factor.faces();
    for mut relations in wholes(&free.state.faces, problem.dimension) {
        let share = WHOLE / relations.len().max(1) as f64;
        relations.iter_mut().for_each(|r| r.doubt = share);
        let near = chi(problem.dimension, &free.state, &covariance, &relations)
            .is_some_and(|(chi, count)| chi < HOPELESS + count as f64);
        if !near {
            continue;
        }
        let state = State { relations, ..free.state.clone() };
        compete(best, settle(problem, state, free.labels.clone()), others);
    }
}

/// The cheaper one is the best, the dearer one of the others.
fn compete<const D: usize>(
    best: &mut Solved<D>,
    next: Option<Solved<D>>,
    others: &mut Vec<Solved<D>>,
) {
    let Some(mut next) = next else { return };
    if next.cost < best.cost - 1e-6 {
        std::mem::swap(best, &mut next);
    }
    others.push(next);
}

/// The ways in which all faces of an object may be in order, each as relations of which none follows
/// from the others: all parallel or square; in parallel pairs; in the plane as those of a regular
/// polygon, and in space as those of a prism. Those that the faces are not near to may be left out.
fn wholes(faces: &[Face], dimension: usize) -> Vec<Vec<Relation>> {
    let all = if dimension == 2 {
        let count = faces.len();
        [even(faces, 4), even(faces, count).filter(|_| count != 4), paired(faces)]
    } else {
        [framed(faces), extruded(faces), paired(faces)]
    };
    all.into_iter().flatten().filter(|relations| relations.len() > 1).collect()
}

/// All normals are multiples of a part of a turn from each other. Four parts hold as many faces as
/// there are, more or fewer one each.
fn even(faces: &[Face], parts: usize) -> Option<Vec<Relation>> {
    if faces.len() < 3 || parts < 3 {
        return None;
    }
    let relations: Vec<Relation> =
        (1..faces.len()).map(|j| Relation::turned(faces, 0, j, parts, 0.0)).collect();
    let taken = |r: &Relation| match r.angle {
        Angle::Turned { by, of } => (by / TAU * of as f64).round().rem_euclid(of as f64) as usize,
        _ => 0,
    };
    let mut own: Vec<usize> = relations.iter().map(taken).chain([0]).collect();
    own.sort_unstable();
    own.dedup();
    (parts == 4 || own.len() == faces.len()).then_some(relations)
}

/// Every face has one that is parallel and looks the other way.
fn paired(faces: &[Face]) -> Option<Vec<Relation>> {
    let mut open: Vec<(usize, usize)> =
        (0..faces.len()).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
    let along = |p: &(usize, usize)| faces[p.0].normal.dot(&faces[p.1].normal);
    let mut relations = Vec::new();
    while let Some(pair) = open.iter().copied().min_by(|a, b| along(a).total_cmp(&along(b))) {
        if along(&pair) > -OPPOSITE {
            break;
        }
        relations.push(Relation { faces: [pair.0, pair.1], angle: Angle::Parallel, doubt: 0.0 });
        open.retain(|p| ![p.0, p.1].iter().any(|f| [pair.0, pair.1].contains(f)));
    }
    (2 * relations.len() == faces.len()).then_some(relations)
}

/// In space: all faces are parallel or square to each other.
fn framed(faces: &[Face]) -> Option<Vec<Relation>> {
    let along = |i: usize, j: usize| faces[i].normal.dot(&faces[j].normal).abs();
    let second = (1..faces.len()).min_by(|a, b| along(0, *a).total_cmp(&along(0, *b)))?;
    let third = faces[0].normal.cross(&faces[second].normal).try_normalize(1e-6)?;
    let related = |i, j| Relation::nearest(faces, i, j, 0.0);
    let mut relations = vec![related(0, second)];
    let mut last = None;
    for i in (1..faces.len()).filter(|i| *i != second) {
        let off = third.dot(&faces[i].normal).abs();
        if off > along(0, i).max(along(second, i)) {
            match last {
                None => relations.extend([related(0, i), related(second, i)]),
                Some(other) => relations.push(related(other, i)),
            }
            last = last.or(Some(i));
        } else {
            let axis = if along(0, i) > along(second, i) { 0 } else { second };
            relations.push(related(axis, i));
        }
    }
    Some(relations)
}

/// In space: all faces are parallel or square to one of them, the base of a prism.
fn extruded(faces: &[Face]) -> Option<Vec<Relation>> {
    let off = |base: usize| -> f64 {
        let cosines = faces.iter().map(|f| f.normal.dot(&faces[base].normal).abs());
        cosines.map(|c| c.min((1.0 - c * c).max(0.0).sqrt()).powi(2)).sum()
    };
    let base = (0..faces.len()).min_by(|a, b| off(*a).total_cmp(&off(*b)))?;
    let others = (0..faces.len()).filter(|i| *i != base);
    Some(others.map(|i| Relation::nearest(faces, base, i, 0.0)).collect())
}

/// χ² of relations where the faces are as uncertain as `covariance`, and of how many numbers.
fn chi(
    dimension: usize,
    state: &State,
    covariance: &DMatrix<f64>,
    relations: &[Relation],
) -> Option<(f64, usize)> {
    let (rows, misses) = stacked(relations, &state.faces, dimension, covariance.ncols());
    let count = misses.len();
    let spread = &rows * covariance * rows.transpose() + DMatrix::identity(count, count);
    Some((misses.dot(&spread.cholesky()?.solve(&misses)), count))
}

/// By how much faces miss all of the relations, and the derivatives by the `width` numbers of all faces.
fn stacked(
    relations: &[Relation],
    faces: &[Face],
    dimension: usize,
    width: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let all: Vec<_> = relations.iter().map(|r| (r.faces, r.miss(faces, dimension))).collect();
    let lines = all.iter().flat_map(|(faces, miss)| (0..miss.count).map(move |k| (faces, miss, k)));
    let count = lines.clone().count();
    let (mut rows, mut misses) = (DMatrix::zeros(count, width), DVector::zeros(count));
    for (line, (faces, miss, k)) in lines.enumerate() {
        misses[line] = miss.residual[k];
        for (side, face) in faces.iter().enumerate() {
            for turn in 0..dimension - 1 {
                rows[(line, dimension * face + turn)] = miss.by_turns[k][side][turn];
            }
        }
    }
    (rows, misses)
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
        let relation = Relation::nearest(faces, *i, *j, ALONE);
        if follows(&best.state.relations, &known, &relation) {
            return None;
        }
        let (chi, _) = chi(dimension, &best.state, &covariance, &[relation])?;
        (chi < HOPELESS).then_some((at, relation, chi))
    };
    let least = open.iter().enumerate().filter_map(squared).min_by(|a, b| a.2.total_cmp(&b.2));
    least.map(|(at, relation, _)| (at, relation))
}

/// Faces by direction: those with the same number are parallel, in the plane parallel, square or
/// turned, because of relations.
fn directions(state: &State, dimension: usize) -> Vec<usize> {
    let mut class: Vec<usize> = (0..state.faces.len()).collect();
    let fixed = |r: &&Relation| dimension == 2 || r.angle == Angle::Parallel;
    for relation in state.relations.iter().filter(fixed) {
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
        let square = r.angle == Angle::Square && relation.angle == Angle::Square;
        square && ((a, b) == (c, d) || (a, b) == (d, c))
    };
    a == b || relations.iter().any(alike)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Point;

    fn face(x: f64, y: f64, z: f64) -> Face {
        Face { normal: Point::new(x, y, z).normalize(), offset: 0.02 }
    }

    /// Normals at these angles, degrees.
    fn polygon(angles: &[f64]) -> Vec<Face> {
        let at = |a: &f64| a.to_radians().sin_cos();
        angles.iter().map(at).map(|(sin, cos)| face(cos, sin, 0.0)).collect()
    }

    /// How many numbers the relations fix, and by how much the faces miss them at most.
    fn fixed(relations: &[Relation], faces: &[Face], dimension: usize) -> (usize, f64) {
        let (rows, misses) = stacked(relations, faces, dimension, dimension * faces.len());
        let worst = misses.amax();
        let all = rows;
        assert_eq!(all.clone().rank(1e-6), all.nrows(), "a relation follows from others");
        (all.nrows(), worst)
    }

    #[test]
    fn an_order_of_the_whole_leaves_faces_one_turn() {
        let hexagon = polygon(&[10.0, 70.0, 130.0, 190.0, 250.0, 310.0]);
        let orders = wholes(&hexagon, 2);
        let found: Vec<(usize, bool)> = orders
            .iter()
            .map(|o| fixed(o, &hexagon, 2))
            .map(|(count, off)| (count, off < 1e-9))
            .collect();
        // Right angles do not suit it; as a hexagon all but one turn is fixed, in pairs three.
        assert_eq!(found, [(5, false), (5, true), (3, true)]);
        let rectangle = polygon(&[200.0, 20.0, 110.0, 290.0]);
        let orders = wholes(&rectangle, 2);
        assert_eq!(orders.len(), 2);
        assert_eq!(fixed(&orders[0], &rectangle, 2).0, 3);
        assert!(fixed(&orders[0], &rectangle, 2).1 < 1e-9);
        // A step has several faces in one direction.
        let step = polygon(&[0.0, 90.0, 0.0, 90.0, 180.0, 270.0]);
        assert!(fixed(&wholes(&step, 2)[0], &step, 2).1 < 1e-9);
        // Two sides in one direction are not those of a regular pentagon.
        assert!(even(&polygon(&[0.0, 5.0, 144.0, 216.0, 288.0]), 5).is_none());
        assert!(paired(&polygon(&[0.0, 120.0, 180.0, 260.0])).is_none());
        assert!(wholes(&polygon(&[0.0, 180.0]), 2).is_empty());
    }

    #[test]
    fn boxes_and_prisms_have_orders_in_space() {
        let cube: Vec<Face> = [
            face(1.0, 0.0, 0.0),
            face(0.0, 0.0, 1.0),
            face(-1.0, 0.0, 0.0),
            face(0.0, -1.0, 0.0),
            face(0.0, 0.0, -1.0),
            face(0.0, 1.0, 0.0),
        ]
        .to_vec();
        // Twelve turns less the three of the whole.
        let orders = wholes(&cube, 3);
        assert_eq!(fixed(&orders[0], &cube, 3).0, 9);
        assert!(orders.iter().all(|o| fixed(o, &cube, 3).1 < 1e-9));
        let mut prism = polygon(&[10.0, 130.0, 250.0]);
        prism.extend([face(0.0, 0.0, 1.0), face(0.0, 0.0, -1.0)]);
        let base = extruded(&prism).unwrap();
        let (count, off) = fixed(&base, &prism, 3);
        assert!(count == 5 && off < 1e-9);
        assert!(fixed(&framed(&prism).unwrap(), &prism, 3).1 > 10.0);
    }

    #[test]
    fn what_follows_is_not_said_twice() {
        let parallel = |i, j| Relation { faces: [i, j], angle: Angle::Parallel, doubt: 0.0 };
        let square = |i, j| Relation { faces: [i, j], angle: Angle::Square, doubt: 0.0 };
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
