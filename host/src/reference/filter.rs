//! Algorithm 3.1 in double precision: a bootstrap particle filter over the object's pose.
//!
//! Corrections to the thesis: weights multiply the previous weights, because resampling is
//! conditional; the pose is averaged on the manifold, not as numbers; and the likelihood (3.9) is
//! calibrated, see [`log_likelihood`]. The algorithm's last line, the update of the shape, is in
//! [`tracker`](super::tracker).

use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

use super::gpis::Evaluation;
use super::{Contact, Gpis};
use crate::space::{Point, Pose};

/// How the object moves and how many particles follow it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// 2 or 3.
    pub dimension: usize,
    /// How many particles.
    pub particles: usize,
    /// Standard deviation of the translation per grasp, metres per axis of the object.
    pub translation: f64,
    /// Standard deviation of the rotation per grasp, radians per axis of the object.
    pub rotation: f64,
    /// The thesis' condition on a pose, if it is wanted.
    pub gate: Option<Gate>,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// A pose is possible only if enough contacts of the grasp lie close to contacts the surface was
/// learnt from (thesis 3.5.1); of a grasp with fewer contacts, all must.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// How many contacts; four in the thesis.
    pub contacts: usize,
    /// How close, metres.
    pub distance: f64,
}

/// One hypothesis about the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Particle {
    /// Object to world.
    pub pose: Pose,
    /// All weights sum to one.
    pub weight: f64,
}

/// The belief over the pose: weighted particles, all at the identity at first.
#[derive(Clone, Debug)]
pub struct Filter {
    settings: Settings,
    particles: Vec<Particle>,
    random: Xoshiro256PlusPlus,
}

/// Least length of the gradient when a value is turned into a distance.
pub const LEAST_GRADIENT: f64 = 0.3;

impl Filter {
    /// All particles at `pose`, equally heavy.
    pub fn new(settings: Settings, pose: Pose) -> Self {
        let count = settings.particles.max(1);
        Filter {
            settings,
            particles: vec![Particle { pose, weight: 1.0 / count as f64 }; count],
            random: Xoshiro256PlusPlus::seed_from_u64(settings.seed),
        }
    }

    /// The particles; their weights sum to one.
    pub fn particles(&self) -> &[Particle] {
        &self.particles
    }

    /// Thesis 3.7–3.8: every particle moves with `motion` (world to world; none stays) and is then
    /// displaced by the noise, in object axes about the object's origin.
    pub fn predict(&mut self, motion: Option<&Pose>) {
        let Settings { dimension, translation, rotation, .. } = self.settings;
        for i in 0..self.particles.len() {
            let mut noise = DVector::zeros(freedom(dimension));
            for k in 0..noise.len() {
                let deviation = if k < dimension { translation } else { rotation };
                noise[k] = deviation * self.normal();
            }
            let particle = &mut self.particles[i];
            let moved = motion.map_or(particle.pose, |m| m * particle.pose);
            particle.pose = retract(dimension, &moved, &noise);
        }
    }

    /// Multiplies every weight by the likelihood of `contacts` (world frame) on `surface` (object
    /// frame) and normalises. False, with the weights as they were, when no particle explains the
    /// contacts at all.
    pub fn weigh(&mut self, surface: &Gpis, contacts: &[Contact]) -> bool {
        let log_weights: Vec<f64> = self
            .particles
            .par_iter()
            .map(|particle| {
                let inverse = particle.pose.inverse();
                let felt: Vec<Contact> = contacts.iter().map(|c| c.transformed(&inverse)).collect();
                let points: Vec<Point> = felt.iter().map(|c| c.point).collect();
                if let Some(gate) = self.settings.gate {
                    let close = points.iter().filter(|p| surface.nearest(p) < gate.distance);
                    if close.count() < gate.contacts.min(points.len()) {
                        return f64::NEG_INFINITY;
                    }
                }
                let evidence: f64 = felt
                    .iter()
                    .zip(surface.evaluate(&points))
                    .map(|(c, e)| log_likelihood(self.settings.dimension, c, &e))
                    .sum();
                particle.weight.ln() + evidence
            })
            .collect();
        let best = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !best.is_finite() {
            return false;
        }
        let total: f64 = log_weights.iter().map(|w| (w - best).exp()).sum();
        for (particle, w) in self.particles.iter_mut().zip(log_weights) {
            particle.weight = (w - best).exp() / total;
        }
        true
    }

    /// Weighted mean of the poses and their covariance (3.23) in tangent coordinates there: object
    /// axes, translation (metres) before rotation (radians).
    pub fn mean(&self) -> (Pose, DMatrix<f64>) {
        mean(self.settings.dimension, &self.particles)
    }

    /// Effective number of particles, 1/Σw².
    pub fn effective(&self) -> f64 {
        1.0 / self.particles.iter().map(|p| p.weight * p.weight).sum::<f64>()
    }

    /// Resamples systematically when fewer than half of the particles are effective; whether it did.
    pub fn resample(&mut self) -> bool {
        let n = self.particles.len();
        if self.effective() >= 0.5 * n as f64 {
            return false;
        }
        let offset = self.uniform();
        let weights: Vec<f64> = self.particles.iter().map(|p| p.weight).collect();
        let weight = 1.0 / n as f64;
        self.particles = systematic(&weights, offset)
            .into_iter()
            .map(|i| Particle { pose: self.particles[i].pose, weight })
            .collect();
        true
    }

    /// Uniform in (0, 1).
    fn uniform(&mut self) -> f64 {
        ((self.random.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Standard normal, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Log density of one contact (object frame) on a surface that is known as `at` its point.
///
/// Thesis 3.9 has no scale. Here the distance to the surface is r = f/|g| with variance
/// σ_p² + V/|g|², and the normal is off the gradient g by an angle whose variance per axis is
/// σ_θ² + V_g/|g|², V and V_g the posterior variances of value and slope; |g| is at least
/// [`LEAST_GRADIENT`]. Both follow Student's t with four degrees of freedom, so that a few wild
/// contacts do not decide alone.
pub fn log_likelihood(dimension: usize, contact: &Contact, at: &Evaluation) -> f64 {
    let slope = at.gradient.norm().max(LEAST_GRADIENT);
    let distance = at.value / slope;
    let variance = contact.point_deviation.powi(2) + at.variance / (slope * slope);
    let mut log = log_student(distance, variance, 1);
    if let Some(normal) = contact.normal {
        let angle = at.gradient.angle(&normal);
        let variance = contact.normal_deviation.powi(2) + at.gradient_variance / (slope * slope);
        log += log_student(angle, variance, dimension - 1);
    }
    log
}

/// Log density of Student's t with ν = 4 in d = 1 or 2 dimensions at distance x from its centre:
/// Γ((ν+d)/2) / (Γ(ν/2) (πν·variance)^{d/2}) · (1 + x²/(ν·variance))^{−(ν+d)/2}.
fn log_student(x: f64, variance: f64, dimensions: usize) -> f64 {
    let d = dimensions as f64;
    // The quotient of the gamma functions over (πν)^{d/2}.
    let scale: f64 = if dimensions == 1 { 3.0 / 8.0 } else { 1.0 / std::f64::consts::TAU };
    scale.ln() - 0.5 * d * variance.ln() - 0.5 * (4.0 + d) * (x * x / (4.0 * variance)).ln_1p()
}

/// Degrees of freedom of a rigid body.
fn freedom(dimension: usize) -> usize {
    if dimension == 2 { 3 } else { 6 }
}

/// `pose` displaced by a tangent in object axes: translation, then rotation.
pub fn retract(dimension: usize, pose: &Pose, tangent: &DVector<f64>) -> Pose {
    let (t, w) = if dimension == 2 {
        (Vector3::new(tangent[0], tangent[1], 0.0), Vector3::new(0.0, 0.0, tangent[2]))
    } else {
        (
            Vector3::new(tangent[0], tangent[1], tangent[2]),
            Vector3::new(tangent[3], tangent[4], tangent[5]),
        )
    };
    pose * Pose::from_parts(t.into(), UnitQuaternion::from_scaled_axis(w))
}

/// The tangent that retracts `pose` to `other`, its rotation at most half a turn.
pub fn local(dimension: usize, pose: &Pose, other: &Pose) -> DVector<f64> {
    let step = pose.inv_mul(other);
    let (t, w) = (step.translation.vector, step.rotation.scaled_axis());
    if dimension == 2 {
        DVector::from_column_slice(&[t.x, t.y, w.z])
    } else {
        DVector::from_column_slice(&[t.x, t.y, t.z, w.x, w.y, w.z])
    }
}

/// Karcher mean of weighted poses, found from the heaviest, and the covariance about it. Weights
/// sum to one.
pub fn mean(dimension: usize, particles: &[Particle]) -> (Pose, DMatrix<f64>) {
    let mut covariance = DMatrix::zeros(freedom(dimension), freedom(dimension));
    let heaviest = particles.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    let Some(mut mean) = heaviest.map(|p| p.pose) else {
        return (Pose::identity(), covariance);
    };
    for _ in 0..50 {
        let mut step = DVector::zeros(freedom(dimension));
        for p in particles {
            step += local(dimension, &mean, &p.pose) * p.weight;
        }
        mean = retract(dimension, &mean, &step);
        if step.norm() < 1e-12 {
            break;
        }
    }
    for p in particles {
        let d = local(dimension, &mean, &p.pose);
        covariance += p.weight * &d * d.transpose();
    }
    (mean, covariance)
}

/// Systematic resampling: which particle each of as many equal shares of the weight falls on, the
/// shares shifted by `offset` in (0, 1). Weights sum to one.
pub fn systematic(weights: &[f64], offset: f64) -> Vec<usize> {
    let n = weights.len();
    let mut chosen = Vec::with_capacity(n);
    let (mut i, mut reached) = (0, weights.first().copied().unwrap_or(0.0));
    for k in 0..n {
        let mark = (k as f64 + offset) / n as f64;
        while reached < mark && i + 1 < n {
            i += 1;
            reached += weights[i];
        }
        chosen.push(i);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::super::{Kernel, Prior, Training};
    use super::*;
    use crate::space::{angle, planar};
    use proptest::prelude::*;

    const SETTINGS: Settings = Settings {
        dimension: 2,
        particles: 500,
        translation: 0.01,
        rotation: 0.2,
        gate: None,
        seed: 3,
    };

    /// Contacts all around a planar ellipse, object frame.
    fn ellipse(count: usize) -> Vec<Contact> {
        (0..count)
            .map(|i| {
                let a = (i as f64 + 0.3) * std::f64::consts::TAU / count as f64;
                let n = Point::new(a.cos() / 0.06, a.sin() / 0.03, 0.0).normalize();
                Contact {
                    point: Point::new(0.06 * a.cos(), 0.03 * a.sin(), 0.0),
                    normal: Some(n),
                    point_deviation: 1e-3,
                    normal_deviation: 0.0873,
                }
            })
            .collect()
    }

    fn surface() -> Gpis {
        let contacts = ellipse(16);
        let kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.08 };
        let prior = Prior::fitted(&contacts).unwrap();
        Gpis::fit(2, kernel, prior, Training::Derivative, &contacts).unwrap()
    }

    #[test]
    fn finds_where_the_object_went() {
        let surface = surface();
        let start = planar(0.2, -0.1, 3.0);
        let motion = planar(0.05, 0.02, 0.4);
        let truth = retract(2, &(motion * start), &DVector::from_vec(vec![0.008, -0.006, 0.15]));
        let mut filter = Filter::new(Settings { particles: 4000, ..SETTINGS }, start);
        filter.predict(Some(&motion));
        let contacts: Vec<Contact> =
            ellipse(16).iter().skip(1).step_by(3).map(|c| c.transformed(&truth)).collect();
        assert!(filter.weigh(&surface, &contacts));
        let (mean, covariance) = filter.mean();
        let off = local(2, &truth, &mean);
        assert!(off.rows(0, 2).norm() < 2e-3 && off[2].abs() < 0.05, "{off}");
        for k in 0..3 {
            assert!(off[k].abs() < 4.0 * covariance[(k, k)].sqrt(), "{off} {covariance}");
        }
        assert!(covariance[(2, 2)].sqrt() < 0.1 && filter.effective() < 400.0);
        assert!(filter.resample() && filter.effective() > 3999.0);
        let after = local(2, &mean, &filter.mean().0);
        assert!(after.norm() < 5e-3, "resampling moved the mean by {after}");
        assert!(!filter.resample());
    }

    #[test]
    fn prediction_spreads_as_told_about_the_origin_of_the_object() {
        for dimension in [2, 3] {
            let start = planar(1.0, 2.0, 2.5);
            let mut filter =
                Filter::new(Settings { dimension, particles: 20_000, ..SETTINGS }, start);
            let motion = planar(0.1, 0.0, 1.2);
            filter.predict(Some(&motion));
            let (mean, covariance) = filter.mean();
            assert!(local(dimension, &(motion * start), &mean).norm() < 0.01);
            for k in 0..covariance.nrows() {
                let expected = if k < dimension { 0.01 } else { 0.2 };
                let ratio = covariance[(k, k)].sqrt() / expected;
                assert!((ratio - 1.0).abs() < 0.02, "{dimension} {k}: {ratio}");
            }
        }
    }

    #[test]
    fn weights_multiply() {
        let surface = surface();
        let contacts = ellipse(5);
        let mut once = Filter::new(SETTINGS, Pose::identity());
        once.predict(None);
        let mut apart = once.clone();
        assert!(once.weigh(&surface, &contacts));
        assert!(apart.weigh(&surface, &contacts[..2]) && apart.weigh(&surface, &contacts[2..]));
        for (a, b) in once.particles().iter().zip(apart.particles()) {
            assert!((a.weight - b.weight).abs() < 1e-12);
        }
        let spoiled = [Contact { point_deviation: f64::NAN, ..contacts[0] }];
        let before = once.particles().to_vec();
        assert!(!once.weigh(&surface, &spoiled));
        assert_eq!(once.particles(), before);
    }

    #[test]
    fn likelihood_is_a_density() {
        // Over distance and, in the plane, angle: integrates to one but for the tails, which hold
        // 2·10⁻⁵ beyond 20 standard deviations.
        let touch = ellipse(1)[0];
        let n = touch.normal.unwrap();
        let at = |distance: f64, angle: f64| Evaluation {
            value: 2.0 * distance,
            gradient: UnitQuaternion::from_scaled_axis(Vector3::z() * angle) * n * 2.0,
            variance: 4e-6,
            gradient_variance: 0.002,
        };
        let density = |distance, angle| log_likelihood(2, &touch, &at(distance, angle)).exp();
        let (over, wide) = (1e-4, 5e-3);
        let line = |f: &dyn Fn(f64) -> f64| -> f64 { (-600..=600).map(f64::from).map(f).sum() };
        let distances = line(&|i| density(i * over, 0.0)) * over;
        let angles = line(&|i| density(0.0, i * wide)) * wide;
        // Density factors, so the integral over both is the product of those along the axes.
        let integral = distances * angles / density(0.0, 0.0);
        assert!((integral - 1.0).abs() < 1e-3, "{integral}");
    }

    #[test]
    fn likelihood_in_space_is_a_density() {
        let n = Point::z();
        let touch = Contact { normal: Some(n), ..ellipse(1)[0] };
        // The normal's two angles in the tangent plane: rings of circumference 2πα.
        let step = 1e-3;
        let mut sum = 0.0;
        for i in 0..3000 {
            let angle = (f64::from(i) + 0.5) * step;
            let at = Evaluation {
                value: 0.0,
                gradient: UnitQuaternion::from_scaled_axis(Vector3::x() * angle) * n,
                variance: 0.0,
                gradient_variance: 0.0,
            };
            let both = log_likelihood(3, &touch, &at).exp();
            let distance = log_likelihood(3, &Contact { normal: None, ..touch }, &at).exp();
            sum += both / distance * std::f64::consts::TAU * angle * step;
        }
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
    }

    #[test]
    fn the_gate_asks_for_contacts_close_to_known_ones() {
        let surface = surface();
        let mut contacts = ellipse(16)[..5].to_vec();
        // Still on the surface, but half way to the next contact; a tight gate shuts both of them out.
        let far: Vec<Contact> = ellipse(48).into_iter().skip(1).step_by(3).collect();
        (contacts[3], contacts[4]) = (far[3], far[4]);
        let gated = |count| {
            let gate = Some(Gate { contacts: count, distance: 2e-3 });
            let mut filter = Filter::new(Settings { gate, ..SETTINGS }, Pose::identity());
            filter.weigh(&surface, &contacts)
        };
        assert!(gated(3) && !gated(4));
    }

    #[test]
    fn mean_crosses_the_seam() {
        let at = |a| Particle { pose: planar(0.0, 0.0, a), weight: 0.5 };
        let (mean, covariance) = mean(2, &[at(3.1), at(-3.1)]);
        assert!((angle(&mean).abs() - std::f64::consts::PI).abs() < 1e-9);
        assert!((covariance[(2, 2)].sqrt() - (std::f64::consts::PI - 3.1)).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn local_undoes_retract(t in proptest::collection::vec(-1.5f64..1.5, 6), a in -3.0..3.0) {
            let pose = planar(0.3, -0.2, a);
            for dimension in [2, 3] {
                let tangent = DVector::from_column_slice(&t[..freedom(dimension)]);
                let back = local(dimension, &pose, &retract(dimension, &pose, &tangent));
                prop_assert!((back - tangent).norm() < 1e-9);
            }
        }

        #[test]
        fn systematic_gives_everyone_its_share(
            raw in proptest::collection::vec(0.0f64..1.0, 1..40),
            offset in 0.001..0.999,
        ) {
            let total: f64 = raw.iter().sum::<f64>() + 1e-9;
            let weights: Vec<f64> = raw.iter().map(|w| (w + 1e-9 / raw.len() as f64) / total).collect();
            let chosen = systematic(&weights, offset);
            prop_assert_eq!(chosen.len(), weights.len());
            for (i, w) in weights.iter().enumerate() {
                let copies = chosen.iter().filter(|&&c| c == i).count() as f64;
                prop_assert!((copies - w * weights.len() as f64).abs() < 1.0 + 1e-6);
            }
        }
    }
}
