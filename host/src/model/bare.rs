//! Normals that nobody felt.
//!
//! Many fingertips know where they touch and not which way the surface faces. Points alone leave a smooth
//! surface nearly free, and whatever begins with normals cannot begin. But of all unit normals at the points
//! those are the most probable whose surface is the smoothest. A Gaussian process with f(pᵢ) = 0 and
//! ∇f(pᵢ) = nᵢ has log p(n) = −½ nᵀMn, where M is the inverse of the gradients' covariance given the values
//! (Huang, Carr and Ju, *Variational implicit point set surfaces*, ACM Transactions on Graphics 38, 2019, with
//! the thin plate's energy for M). Its least value over unit vectors is sought by Newton's method on the
//! spheres from two starts, and its curvature there says how sure each normal is. Which side is outside, points
//! do not say: normals that were felt do, else most point away from the middle.

use nalgebra::{DMatrix, DVector};

use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::space::{Point, across, centroid};
use crate::thin::evenly;

/// Contacts that normals are sought for together in the plane and in space; the others get them from the
/// surface of these.
const MOST: [usize; 2] = [160, 120];

/// Length scale of the process, in distances from the middle to the farthest contact: much longer than the
/// object, within which it is then as smooth as a thin plate.
const SCALE: f64 = 8.0;

/// Standard deviation by which gradients miss the process, beside 1: edges are no part of it.
const ROUGH: f64 = 0.02;

/// Steps from each start, and the relative gain below which they end.
const STEPS: usize = 60;
const ENOUGH: f64 = 1e-7;

/// What is believed of the variance that the curvature says: the process is taken for as rough everywhere as
/// it is at edges, and most contacts lie on none.
const SURER: f64 = 0.5;

/// Least and greatest standard deviation that a guess gets, radians.
const DEVIATION: [f64; 2] = [0.1, 0.8];

/// The contacts with the likeliest normals where none were felt, as uncertain as these are; contacts that
/// felt theirs, and unusable ones, stay as they are. `None` where all felt theirs, and where there are too few,
/// or all in one place, to say.
pub fn guessed(dimension: usize, contacts: &[Contact]) -> Option<Vec<Contact>> {
    let mut all = contacts.to_vec();
    let usable: Vec<usize> = (0..all.len()).filter(|i| all[*i].checked().is_some()).collect();
    let is_bare = |i: &usize| contacts[*i].normal.is_none();
    if !(2..=3).contains(&dimension) || usable.len() < 2 * dimension || !usable.iter().any(is_bare)
    {
        return None;
    }
    let anchors = anchors(&usable, is_bare, MOST[dimension - 2]);
    let sought =
        Sought::of(dimension, anchors.iter().filter_map(|i| contacts[*i].checked()).collect())?;
    let found = sought.found()?;
    for (i, (normal, deviation)) in anchors.iter().zip(&found) {
        if is_bare(i) {
            (all[*i].normal, all[*i].normal_deviation) = (Some(*normal), *deviation);
        }
    }
    let others: Vec<usize> = usable.into_iter().filter(|i| all[*i].normal.is_none()).collect();
    if !others.is_empty() {
        let known: Vec<Contact> = anchors.iter().map(|i| all[*i]).collect();
        for (i, normal) in others.iter().zip(sought.gradients(&known, contacts, &others)) {
            let apart = |c: &&Contact| (c.point - contacts[*i].point).norm_squared();
            let near = known.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
            if let (Some(normal), Some(near)) = (normal, near) {
                // A felt one beside it is no guess.
                let [least, most] = DEVIATION;
                let deviation = near.normal_deviation.clamp(least, most);
                (all[*i].normal, all[*i].normal_deviation) = (Some(normal), deviation);
            }
        }
    }
    Some(all)
}

/// Up to so many of these contacts, evenly through the list; half of them felt their normals, if so many did, which
/// then say where the surface faces.
fn anchors(usable: &[usize], is_bare: impl Fn(&usize) -> bool, most: usize) -> Vec<usize> {
    let (bare, felt): (Vec<usize>, Vec<usize>) = usable.iter().copied().partition(is_bare);
    let half = (most / 2).max(most.saturating_sub(bare.len())).min(felt.len());
    let mut anchors = [evenly(&felt, half), evenly(&bare, most - half)].concat();
    anchors.sort_unstable();
    anchors
}

/// Normals to be found.
struct Sought {
    dimension: usize,
    contacts: Vec<Contact>,
    /// Of the contacts, metres.
    middle: Point,
    /// M, of all contacts' gradients one after the other.
    energy: DMatrix<f64>,
    kernel: Kernel,
}

impl Sought {
    /// `None` where the points leave the surface no form, as in one place.
    fn of(dimension: usize, contacts: Vec<Contact>) -> Option<Sought> {
        let middle = centroid(contacts.iter().map(|c| c.point));
        let reach = contacts.iter().map(|c| (c.point - middle).norm()).fold(0.0, f64::max);
        let lengthscale = SCALE * reach;
        // Gradients vary by one along each axis before anything is known.
        let kernel = Kernel::Matern32 { amplitude: lengthscale / 3f64.sqrt(), lengthscale };
        let energy = energy(dimension, &contacts, &kernel)?;
        Some(Sought { dimension, contacts, middle, energy, kernel })
    }

    /// The normals of the least energy, with standard deviations.
    fn found(&self) -> Option<Vec<(Point, f64)>> {
        let starts = [self.smoothest(), self.outward()];
        let ends = starts.into_iter().map(|start| self.descended(start));
        let (_, best) = ends.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let is_felt = self.contacts.iter().any(|c| c.normal.is_some());
        let out: f64 =
            self.contacts.iter().zip(&best).map(|(c, n)| (c.point - self.middle).dot(n)).sum();
        let sign = if !is_felt && out < 0.0 { -1.0 } else { 1.0 };
        let deviations = self.deviations(&best);
        Some(best.into_iter().map(|n| n * sign).zip(deviations).collect())
    }

    /// Felt normals, and where there are none those away from the middle.
    fn outward(&self) -> Vec<Point> {
        let away = |c: &Contact| (c.point - self.middle).try_normalize(1e-9);
        let normal = |c: &Contact| c.normal.or_else(|| away(c)).unwrap_or_else(Point::x);
        self.contacts.iter().map(normal).collect()
    }

    /// Those of the gradients, of any length, that are likeliest with the felt ones; without any, of the
    /// gradients that vary most.
    fn smoothest(&self) -> Vec<Point> {
        let (n, d) = (self.contacts.len(), self.dimension);
        let free: Vec<usize> =
            (0..n * d).filter(|r| self.contacts[r / d].normal.is_none()).collect();
        let fixed: Vec<usize> =
            (0..n * d).filter(|r| self.contacts[r / d].normal.is_some()).collect();
        let mut gradients = stacked(d, &self.outward());
        let inner = self.energy.select_rows(&free).select_columns(&free);
        let solved = if fixed.is_empty() {
            let eigen = inner.symmetric_eigen();
            Some(eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned())
        } else {
            let felt = DVector::from_iterator(fixed.len(), fixed.iter().map(|r| gradients[*r]));
            let pull = self.energy.select_rows(&free).select_columns(&fixed) * felt;
            inner.cholesky().map(|c| -c.solve(&pull))
        };
        if let Some(solved) = solved {
            for (row, value) in free.iter().zip(solved.iter()) {
                gradients[*row] = *value;
            }
        }
        let outward = self.outward();
        let unit = |i: usize| normal_at(d, &gradients, i).try_normalize(1e-12);
        (0..n).map(|i| unit(i).unwrap_or(outward[i])).collect()
    }

    /// Energy and normals at the end of a descent, of which felt ones are no part.
    fn descended(&self, mut normals: Vec<Point>) -> (f64, Vec<Point>) {
        let mut least = self.cost(&normals);
        let mut damping = 1e-2;
        for _ in 0..STEPS {
            let (square, slope, tangents) = self.linearised(&normals);
            let mut gained = 0.0;
            for _ in 0..12 {
                let mut damped = square.clone();
                for (k, (i, _)) in tangents.iter().enumerate() {
                    damped[(k, k)] += damping * self.stiffness(*i);
                }
                if let Some(step) = damped.cholesky().map(|c| -c.solve(&slope)) {
                    let mut moved = normals.clone();
                    for (k, (i, axis)) in tangents.iter().enumerate() {
                        moved[*i] += axis * step[k];
                    }
                    moved.iter_mut().for_each(|n| *n = n.normalize());
                    let cost = self.cost(&moved);
                    if cost < least {
                        (gained, least, normals) = (least - cost, cost, moved);
                        damping = (0.3 * damping).max(1e-9);
                        break;
                    }
                }
                damping *= 6.0;
            }
            if gained <= ENOUGH * least {
                break;
            }
        }
        (least, normals)
    }

    /// What the energy has of one contact's gradient on its own, on average over its directions.
    fn stiffness(&self, i: usize) -> f64 {
        let d = self.dimension;
        (0..d).map(|a| self.energy[(i * d + a, i * d + a)].abs()).sum::<f64>() / d as f64
    }

    /// nᵀMn/2.
    fn cost(&self, normals: &[Point]) -> f64 {
        let all = stacked(self.dimension, normals);
        0.5 * all.dot(&(&self.energy * &all))
    }

    /// Curvature and slope of the energy along the tangents of normals that were not felt.
    fn linearised(&self, normals: &[Point]) -> (DMatrix<f64>, DVector<f64>, Vec<(usize, Point)>) {
        let d = self.dimension;
        let pull = &self.energy * stacked(d, normals);
        let mut tangents = Vec::new();
        for (i, normal) in normals.iter().enumerate() {
            if self.contacts[i].normal.is_none() {
                tangents.extend(across(d, normal).into_iter().take(d - 1).map(|axis| (i, axis)));
            }
        }
        let count = tangents.len();
        let mut wide = DMatrix::zeros(normals.len() * d, count);
        for (k, (i, axis)) in tangents.iter().enumerate() {
            for r in 0..d {
                wide[(i * d + r, k)] = axis[r];
            }
        }
        let slope = wide.tr_mul(&pull);
        let mut square = wide.tr_mul(&(&self.energy * &wide));
        for (k, (i, _)) in tangents.iter().enumerate() {
            square[(k, k)] -= normals[*i].dot(&normal_at(d, &pull, *i));
        }
        (square, slope, tangents)
    }

    /// How sure each is (Laplace), radians; the greatest where that cannot be told.
    fn deviations(&self, normals: &[Point]) -> Vec<f64> {
        let (square, _, tangents) = self.linearised(normals);
        let free = tangents.len().max(1) as f64;
        let unit = SURER * 2.0 * self.cost(normals) / free;
        let mut sums = vec![(0.0, 0.0); normals.len()];
        let inverse = square.cholesky().map(|c| c.inverse());
        for (k, (i, _)) in tangents.iter().enumerate() {
            let variance = inverse.as_ref().map_or(f64::INFINITY, |m| unit * m[(k, k)]);
            sums[*i] = (sums[*i].0 + variance, sums[*i].1 + 1.0);
        }
        let [least, most] = DEVIATION;
        sums.iter()
            .map(|(sum, count): &(f64, f64)| (sum / count.max(1.0)).sqrt().clamp(least, most))
            .collect()
    }

    /// Normals of the surface of these contacts at others.
    fn gradients(
        &self,
        known: &[Contact],
        contacts: &[Contact],
        others: &[usize],
    ) -> Vec<Option<Point>> {
        let zero = Prior::Constant(0.0);
        let Ok(surface) = Gpis::fit(self.dimension, self.kernel, zero, Training::Derivative, known)
        else {
            return vec![None; others.len()];
        };
        let points: Vec<Point> = others.iter().map(|i| contacts[*i].point).collect();
        surface.gradients(&points).iter().map(|g| g.try_normalize(1e-9)).collect()
    }
}

/// The inverse covariance of the gradients at the contacts where the surface goes through them all, to the
/// noise of their points.
fn energy(dimension: usize, contacts: &[Contact], kernel: &Kernel) -> Option<DMatrix<f64>> {
    let (n, d) = (contacts.len(), dimension);
    let mut values = DMatrix::zeros(n, n);
    let mut mixed = DMatrix::zeros(n * d, n);
    let mut slopes = DMatrix::zeros(n * d, n * d);
    for i in 0..n {
        for j in 0..n {
            let apart = contacts[i].point - contacts[j].point;
            let k = kernel.radial(apart.norm());
            values[(i, j)] = k.value;
            for a in 0..d {
                mixed[(i * d + a, j)] = k.slope * apart[a];
                for b in 0..d {
                    let same = if a == b { k.slope } else { 0.0 };
                    slopes[(i * d + a, j * d + b)] = -(same + k.bend * apart[a] * apart[b]);
                }
            }
        }
        values[(i, i)] += contacts[i].point_deviation.powi(2);
        for a in 0..d {
            slopes[(i * d + a, i * d + a)] += ROUGH * ROUGH;
        }
    }
    let solved = values.cholesky()?.solve(&mixed.transpose());
    let given = slopes - mixed * solved;
    Some((0.5 * (&given + given.transpose())).cholesky()?.inverse())
}

fn stacked(d: usize, normals: &[Point]) -> DVector<f64> {
    DVector::from_fn(normals.len() * d, |r, _| normals[r / d][r % d])
}

fn normal_at(d: usize, all: &DVector<f64>, i: usize) -> Point {
    Point::from_fn(|a, _| if a < d { all[i * d + a] } else { 0.0 })
}

#[cfg(test)]
mod tests;
