//! Parallel and square faces, where the contacts agree.
//!
//! Li et al. (GlobFit, ACM Transactions on Graphics 30(4), 2011) align fitted primitives where they
//! nearly are. Here "nearly" is a Bayes factor: the density of the measured angle if the two faces are
//! parallel (or square) over its density if they lie anyhow. One relation at a time, the most plausible
//! first, corrects all faces with their joint covariance, so that what follows is tested against what
//! was accepted before.

use nalgebra::{DMatrix, DVector};

use super::{Face, Faces};
use crate::reference::Contact;
use crate::space::{Point, across};

/// ln of the Bayes factor from which on a relation is taken to hold: 3, “positive” by Kass & Raftery
/// (1995).
const POSITIVE: f64 = 1.1;

/// χ² that a relation may cost at most, however plausible.
const GATE: f64 = 9.0;

/// How parallel or square the faces of made things are, radians.
pub const EXACT: f64 = 0.005;

/// Faces of many more are curved, and their pairs would take long.
const MOST_FACES: usize = 32;

/// How much all normals turn, in tangents, with their covariance.
struct State {
    faces: Vec<Face>,
    /// Two tangents of each normal; in the plane one (the other is zero).
    tangents: Vec<[Point; 2]>,
    covariance: DMatrix<f64>,
}

/// What a relation says: `residual` is linear in the turns and zero if it holds.
struct Relation {
    residual: DVector<f64>,
    rows: DMatrix<f64>,
    /// ln of the residual's density where faces lie anyhow.
    anyhow: f64,
}

impl State {
    fn of(faces: &[Face], dimension: usize) -> State {
        let tangents: Vec<[Point; 2]> =
            faces.iter().map(|face| across(dimension, &face.normal)).collect();
        let mut covariance = DMatrix::zeros(2 * faces.len(), 2 * faces.len());
        for (i, face) in faces.iter().enumerate() {
            for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                covariance[(2 * i + a, 2 * i + b)] =
                    tangents[i][a].dot(&(face.normal_covariance * tangents[i][b]));
            }
        }
        State { faces: faces.to_vec(), tangents, covariance }
    }

    fn relation(&self, i: usize, j: usize, dimension: usize) -> Relation {
        let (a, b) = (self.faces[i].normal, self.faces[j].normal);
        let mut rows = DMatrix::zeros(if dimension == 2 { 1 } else { 2 }, 2 * self.faces.len());
        if a.dot(&b).abs() > std::f64::consts::FRAC_1_SQRT_2 {
            let sign = a.dot(&b).signum();
            let residual =
                DVector::from_fn(dimension - 1, |k, _| self.tangents[i][k].dot(&b) * sign);
            for k in 0..dimension - 1 {
                for l in 0..2 {
                    rows[(k, 2 * j + l)] = sign * self.tangents[i][k].dot(&self.tangents[j][l]);
                }
                rows[(k, 2 * i + k)] -= 1.0;
            }
            let directions = if dimension == 2 { 1.0 } else { 2.0 } * std::f64::consts::PI;
            return Relation { residual, rows, anyhow: -directions.ln() };
        }
        let mut rows = rows.rows(0, 1).into_owned();
        for l in 0..2 {
            rows[(0, 2 * i + l)] = self.tangents[i][l].dot(&b);
            rows[(0, 2 * j + l)] = self.tangents[j][l].dot(&a);
        }
        // The cosine of any two directions: uniform in space, the angle in the plane.
        let range = if dimension == 2 { std::f64::consts::PI } else { 2.0 };
        Relation { residual: DVector::from_element(1, a.dot(&b)), rows, anyhow: -f64::ln(range) }
    }

    /// ln of the Bayes factor for the relation; `None` where it is not plausible.
    fn plausible(&self, relation: &Relation) -> Option<f64> {
        let spread = self.innovation(relation);
        let inverse = spread.clone().try_inverse()?;
        let chi = (relation.residual.transpose() * inverse * &relation.residual)[0];
        let scaled = spread * std::f64::consts::TAU;
        let factor = -0.5 * chi - 0.5 * scaled.determinant().ln() - relation.anyhow;
        (chi < GATE && factor > POSITIVE).then_some(factor)
    }

    fn innovation(&self, relation: &Relation) -> DMatrix<f64> {
        let size = relation.residual.len();
        &relation.rows * &self.covariance * relation.rows.transpose()
            + DMatrix::identity(size, size) * (EXACT * EXACT)
    }

    /// Corrects all normals; how many numbers the relation fixed that were open.
    fn correct(&mut self, relation: &Relation) -> usize {
        let spread = self.innovation(relation);
        let open = spread.diagonal().iter().filter(|v| **v > 4.0 * EXACT * EXACT).count();
        let Some(inverse) = spread.try_inverse() else { return 0 };
        let gain = &self.covariance * relation.rows.transpose() * inverse;
        let turns = -(&gain * &relation.residual);
        self.covariance -= &gain * &relation.rows * &self.covariance;
        for (i, face) in self.faces.iter_mut().enumerate() {
            let [t, u] = self.tangents[i];
            let normal = (face.normal + t * turns[2 * i] + u * turns[2 * i + 1]).normalize();
            face.normal = normal;
            // Tangents follow, so that the covariance keeps its meaning.
            self.tangents[i] = [t, u].map(|x| {
                (x - normal * normal.dot(&x)).try_normalize(1e-9).unwrap_or(Point::zeros())
            });
        }
        open
    }
}

impl Faces {
    /// The faces with those parallel or square that plausibly are; each turns about the centroid of
    /// its contacts.
    pub fn regular(&self, contacts: &[Contact]) -> Faces {
        let count = self.faces.len();
        if count > MOST_FACES || contacts.len() != self.owners.len() {
            return self.clone();
        }
        let mut state = State::of(&self.faces, self.dimension);
        let mut pairs: Vec<(usize, usize)> =
            (0..count).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
        let (mut fixed, mut order) = (0, 0.0);
        loop {
            let best = pairs
                .iter()
                .enumerate()
                .filter_map(|(at, (i, j))| {
                    let relation = state.relation(*i, *j, self.dimension);
                    Some((at, state.plausible(&relation)?, relation))
                })
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((at, factor, relation)) = best else { break };
            pairs.swap_remove(at);
            let open = state.correct(&relation);
            fixed += open;
            // What earlier relations fixed is no evidence again.
            order += factor * open as f64 / relation.residual.len() as f64;
        }
        for (i, face) in state.faces.iter_mut().enumerate() {
            face.offset = face.normal.dot(&face.centroid);
            face.normal_covariance.fill(0.0);
            for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let [t, u] = [state.tangents[i][a], state.tangents[i][b]];
                face.normal_covariance +=
                    t * u.transpose() * state.covariance[(2 * i + a, 2 * i + b)];
            }
        }
        let mut faces =
            Faces::explaining(self.dimension, contacts, state.faces, self.owners.clone());
        faces.degrees += fixed as f64;
        faces.order = order;
        faces
    }
}
