//! What a grasp would say about the pose, by imagined measurements: each of some poses that the belief
//! holds possible is taken for the true one in turn, the contacts it would give are weighed under all
//! of them, and the posterior is compared with the prior (thesis 4.5.2.2).

use nalgebra::{Matrix6, Vector6};

use super::belief::Belief;
use super::criterion::{normals_see, root, row};
use super::entropy::{divergence, renyi, shannon};
use super::prediction::Prediction;
use crate::graph::joint::tangent::{local, retract};
use crate::sim::random::Random;

/// Poses drawn from the belief, and how many of them are taken for the true one.
const POSES: usize = 64;
const IMAGINED: usize = 16;

/// How prior and posterior are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseMeasure {
    /// Fall of the Shannon entropy Σ −p log p (4.2).
    Shannon,
    /// Fall of the Rényi entropy log(Σ pᵅ)/(1 − α) (4.4, as corrected).
    Renyi(f64),
    /// KL(posterior ‖ prior) (4.6; the printed direction has no bound).
    Divergence,
    /// Fall of ½ log det Σ (4.21).
    Determinant,
}

/// The expected gain of each grasp, nats. The draws are the same for every grasp and on every call.
pub fn gains(belief: &Belief, prediction: &Prediction, measure: PoseMeasure) -> Vec<f64> {
    let Prediction { contacts: grasps, covariances } = prediction;
    let draws = draws(belief);
    if draws.len() < 2 {
        return vec![0.0; grasps.len()];
    }
    let radius = belief.radius;
    grasps
        .iter()
        .zip(covariances)
        .map(|(contacts, covariance)| {
            let rows: Vec<(Vector6<f64>, f64)> = contacts
                .iter()
                .zip(covariance.diagonal().iter())
                .map(|(e, v)| (row(e), e.chance / (belief.noise.0.powi(2) + v.max(0.0))))
                .collect();
            if rows.is_empty() {
                return 0.0;
            }
            expected_gain(&draws, &rows, &normals_see(belief, contacts), measure, radius)
        })
        .collect()
}

/// Poses held possible, as tangents at the belief's pose, all of one weight: from each mode in
/// proportion to its weight, with the belief's covariance about it.
fn draws(belief: &Belief) -> Vec<Vector6<f64>> {
    let Some(root) = root(&belief.covariance) else { return Vec::new() };
    let [mut random] = Random::streams(0);
    let total: f64 = belief.modes.iter().map(|m| m.1).sum();
    (0..POSES)
        .map(|k| {
            let at = (k as f64 + 0.5) / POSES as f64 * total;
            let mut sum = 0.0;
            let mode = belief.modes.iter().find(|m| {
                sum += m.1;
                sum >= at
            });
            let (a, b) = (random.normal3(), random.normal3());
            let spread = root * Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z);
            match mode {
                Some((pose, _)) => local(&belief.pose, &retract(pose, &spread)),
                None => spread,
            }
        })
        .collect()
}

fn expected_gain(
    draws: &[Vector6<f64>],
    rows: &[(Vector6<f64>, f64)],
    normals: &Matrix6<f64>,
    measure: PoseMeasure,
    radius: f64,
) -> f64 {
    let n = draws.len();
    let seen: Vec<Vec<f64>> =
        draws.iter().map(|d| rows.iter().map(|(h, _)| h.dot(d)).collect()).collect();
    let uniform = vec![1.0 / n as f64; n];
    let mut sum = 0.0;
    let step = n.div_ceil(IMAGINED).max(1);
    let imagined = (0..n).step_by(step);
    let count = imagined.len() as f64;
    for truth in imagined {
        let mut weights: Vec<f64> = (0..n)
            .map(|k| {
                let distances: f64 = (0..rows.len())
                    .map(|i| rows[i].1 * (seen[k][i] - seen[truth][i]).powi(2))
                    .sum();
                let apart = draws[k] - draws[truth];
                (-0.5 * (distances + apart.dot(&(normals * apart)))).exp()
            })
            .collect();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        sum += compare(draws, &uniform, &weights, measure, radius);
    }
    sum / count
}

fn compare(
    draws: &[Vector6<f64>],
    prior: &[f64],
    posterior: &[f64],
    measure: PoseMeasure,
    radius: f64,
) -> f64 {
    match measure {
        PoseMeasure::Shannon => shannon(prior) - shannon(posterior),
        PoseMeasure::Renyi(alpha) => renyi(prior, alpha) - renyi(posterior, alpha),
        PoseMeasure::Divergence => divergence(posterior, prior),
        PoseMeasure::Determinant => {
            log_deviation(draws, prior, radius) - log_deviation(draws, posterior, radius)
        }
    }
}

/// ½ log det of the weighted covariance of the draws (4.21, whose 1 − Σw² is left out: it would call
/// one heavy pose uncertain), rotations as arcs at `radius`, each deviation at least 0.1 mm.
fn log_deviation(draws: &[Vector6<f64>], weights: &[f64], radius: f64) -> f64 {
    let scaled = |d: &Vector6<f64>| {
        let mut s = *d;
        s.fixed_rows_mut::<3>(3).scale_mut(radius);
        s
    };
    let mean: Vector6<f64> = draws.iter().zip(weights).map(|(d, w)| scaled(d) * *w).sum();
    let mut covariance = Matrix6::identity() * 1e-8;
    for (d, w) in draws.iter().zip(weights) {
        let e = scaled(d) - mean;
        covariance += e * e.transpose() * *w;
    }
    // Nothing is below 0.1 mm by construction, so that the root never fails but for NaN.
    let Some(root) = covariance.cholesky() else { return f64::NAN };
    root.l_dirty().diagonal().iter().map(|d| d.ln()).sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::ArrayStorage;

    use super::*;

    /// Contacts without normals.
    const UNSEEN: Matrix6<f64> = Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6]));

    #[test]
    fn normals_say_nothing_of_a_turn_about_themselves() {
        let turned = |axis: usize| -> Vec<Vector6<f64>> {
            (0..16).map(|k| Vector6::ith(axis, 0.1 * (k as f64 - 7.5))).collect()
        };
        let rows = [(Vector6::ith(2, 1.0), 1e6)];
        let gain = |axis: usize, normals: &Matrix6<f64>| {
            expected_gain(&turned(axis), &rows, normals, PoseMeasure::Shannon, 0.05)
        };
        let seen = |axes: [f64; 3], weight: f64| {
            let [x, y, z] = axes;
            Matrix6::from_diagonal(&(Vector6::new(0.0, 0.0, 0.0, x, y, z) * weight))
        };
        let flat = seen([1.0, 1.0, 0.0], 5.0 / 0.09f64.powi(2));
        assert!(gain(3, &flat) > 0.5 && gain(5, &flat).abs() < 1e-9);
        // In the plane a face's normals see the one turn there is; unlikely contacts see less.
        let planar = |chance: f64| seen([0.0, 0.0, 1.0], chance / 0.3f64.powi(2));
        let [sure, unsure] = [1.0, 0.1].map(|chance| gain(5, &planar(chance)));
        assert!(sure > 1.5 * unsure && unsure > 0.0, "{sure} {unsure}");
    }

    fn line() -> Vec<Vector6<f64>> {
        (0..16).map(|k| Vector6::new(0.002 * (k as f64 - 7.5), 0.0, 0.0, 0.0, 0.0, 0.0)).collect()
    }

    #[test]
    fn a_grasp_along_the_doubt_is_worth_more_than_one_across() {
        let draws = line();
        let along = [(Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1e6)];
        let across = [(Vector6::new(0.0, 1.0, 0.0, 0.0, 0.0, 0.0), 1e6)];
        for measure in [
            PoseMeasure::Shannon,
            PoseMeasure::Renyi(2.0),
            PoseMeasure::Renyi(1.0),
            PoseMeasure::Divergence,
            PoseMeasure::Determinant,
        ] {
            let [a, b] = [along, across].map(|r| expected_gain(&draws, &r, &UNSEEN, measure, 0.05));
            assert!(a > 0.5 && b.abs() < 1e-9, "{measure:?}: {a} {b}");
        }
    }

    #[test]
    fn against_a_uniform_prior_the_divergence_is_the_fall_of_entropy() {
        let draws = line();
        let rows = [(Vector6::new(1.0, 0.2, 0.0, 0.0, 0.0, 0.0), 1e5)];
        let [a, b] = [PoseMeasure::Shannon, PoseMeasure::Divergence]
            .map(|m| expected_gain(&draws, &rows, &UNSEEN, m, 0.05));
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}
