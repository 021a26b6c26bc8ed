//! Hyper-parameters by marginal likelihood: thesis 2.16 as corrected, with its gradient.
//!
//! What is sought are logarithms: of the kernel's amplitude and lengthscale and, when asked for, of
//! a common factor on every standard deviation the contacts state. Five contacts decide little, so
//! each logarithm has a normal prior about what suits most objects of the given radius, and bounds.

use std::sync::Arc;

use nalgebra::{DVector, Matrix3, Vector3};

use super::gpis::Error;
use super::{Contact, Gpis, Kernel, Mean, Training};

/// Gradient of the log marginal likelihood, nats per unit of each parameter's logarithm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slopes {
    /// By the logarithm of the kernel's amplitude.
    pub amplitude: f64,
    /// By the logarithm of its lengthscale; `None` for the thin plate, whose range is fixed.
    pub lengthscale: Option<f64>,
    /// By the logarithm of a common factor on all standard deviations: of the contacts, and of readings where
    /// there are some.
    pub noise: f64,
}

impl Gpis {
    /// Gradient of [`log_marginal_likelihood`](Gpis::log_marginal_likelihood), analytically:
    /// ½ (αᵀ ∂K α − tr K⁻¹ ∂K) with α = K⁻¹ y. Costs a few factorisations.
    pub fn log_marginal_likelihood_slopes(&self) -> Slopes {
        let rows = &self.observations;
        let targets = DVector::from_iterator(rows.len(), rows.iter().map(|o| o.target));
        let weights = self.cholesky.solve(&targets);
        let inverse = self.cholesky.inverse_lower();
        // Amplitude and noise scale one summand of K = S + N + ΦΦᵀ each (Φ the mean's modes), so
        // their traces collapse.
        let mut noise = 0.0;
        for (i, o) in rows.iter().enumerate() {
            noise += o.variance * (weights[i] * weights[i] - inverse.get(i, i));
        }
        let mut modes = self.modes.clone();
        self.cholesky.forward(&mut modes);
        let fixed = self.modes.tr_mul(&weights).norm_squared() - modes.norm_squared();
        let amplitude = targets.dot(&weights) - rows.len() as f64 - noise - fixed;
        let lengthscale = self
            .sites
            .covariance_by_log_lengthscale(&self.kernel)
            .map(|change| 0.5 * change.contract(weights.as_slice(), &inverse));
        Slopes { amplitude, lengthscale, noise }
    }
}

/// What is believed about one parameter before the contacts speak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Its likeliest value.
    pub mode: f64,
    /// Standard deviation of its natural logarithm.
    pub deviation: f64,
    /// Least and greatest value allowed.
    pub bounds: (f64, f64),
}

/// How the most plausible parameters are sought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// Of the amplitude, in multiples of the object's radius.
    pub amplitude: Belief,
    /// Of the lengthscale, in multiples of the object's radius.
    pub lengthscale: Belief,
    /// Of the common factor on all standard deviations; `None` takes the contacts at their word.
    pub noise: Option<Belief>,
}

/// As wide as objects differ: a quarter to four times the mode is within two standard deviations.
/// Contacts may be wrong about their noise by a factor of e as likely.
impl Default for Search {
    fn default() -> Self {
        Search {
            amplitude: Belief { mode: 0.6, deviation: 0.7, bounds: (0.02, 10.0) },
            lengthscale: Belief { mode: 2.0, deviation: 0.7, bounds: (0.2, 10.0) },
            noise: Some(Belief { mode: 1.0, deviation: 0.5, bounds: (0.2, 10.0) }),
        }
    }
}

/// The most plausible parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The kernel of the family asked for.
    pub kernel: Kernel,
    /// Factor on all standard deviations of the contacts; 1 unless it was sought.
    pub noise: f64,
    /// Log marginal likelihood of the contacts there, nats; the prior's share is not in it.
    pub log_likelihood: f64,
    /// The same with the beliefs about the parameters, as densities of their logarithms that sum to one but
    /// for the bounds.
    pub log_posterior: f64,
}

/// Climbing ends when no free logarithm gains more than this, nats.
const FLAT: f64 = 0.01;
/// No logarithm moves further in one step.
const STRIDE: f64 = 1.0;
/// Steps of one climb, and halvings of one step. In two or three smooth dimensions ten steps do.
const STEPS: usize = 30;
const HALVINGS: usize = 12;
/// Multiples of each mode that the search looks at first.
const LOOKS: [f64; 3] = [1.0 / 3.0, 1.0, 3.0];
/// Climbs start at this many of the best looks.
const CLIMBS: usize = 2;

/// One value of the parameters' logarithms with what there is to gain.
#[derive(Clone, Copy, Debug)]
struct Height {
    at: Vector3<f64>,
    /// Log posterior up to a constant.
    value: f64,
    slope: Vector3<f64>,
    found: Found,
}

struct Hill<'a> {
    dimension: usize,
    family: Kernel,
    prior: Arc<dyn Mean>,
    training: Training,
    contacts: &'a [Contact],
    radius: f64,
    /// Amplitude, lengthscale, noise; `None` stays as the family and the contacts have it.
    beliefs: [Option<Belief>; 3],
}

impl Search {
    /// The parameters of greatest posterior density for the kernel's family: of `family`, only the
    /// thin plate's range counts. `radius` is the object's, metres, and gives the scale of
    /// amplitude and lengthscale. The same input gives the same answer: nothing is drawn.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a radius or belief that is not finite and positive, or bounds that
    /// do not hold the mode; otherwise as [`Gpis::fit`], when no parameters that were looked at
    /// give a surface.
    pub fn run(
        &self,
        dimension: usize,
        family: Kernel,
        prior: impl Into<Arc<dyn Mean>>,
        training: Training,
        contacts: &[Contact],
        radius: f64,
    ) -> Result<Found, Error> {
        let usable = |x: f64| x > 0.0 && x.is_finite();
        if !usable(radius) {
            return Err(Error::Parameter { name: "radius", value: radius });
        }
        let lengthscale = match family {
            Kernel::ThinPlate { .. } => None,
            _ => Some(self.lengthscale),
        };
        let beliefs = [Some(self.amplitude), lengthscale, self.noise];
        for belief in beliefs.iter().flatten() {
            let (low, high) = belief.bounds;
            for (name, value) in [
                ("deviation of a belief", belief.deviation),
                ("lower bound of a belief", low),
                ("upper bound of a belief over its mode", high / belief.mode),
            ] {
                if !usable(value) {
                    return Err(Error::Parameter { name, value });
                }
            }
            if !(low <= belief.mode && belief.mode <= high) {
                return Err(Error::Parameter {
                    name: "mode within its bounds",
                    value: belief.mode,
                });
            }
        }
        let prior = prior.into();
        Hill { dimension, family, prior, training, contacts, radius, beliefs }.search()
    }
}

impl Hill<'_> {
    fn search(&self) -> Result<Found, Error> {
        let looks = |belief: &Option<Belief>| -> Vec<f64> {
            let multiples: &[f64] = if belief.is_some() { &LOOKS } else { &[1.0] };
            multiples.iter().map(|m| belief.map_or(0.0, |b| (m * b.mode).ln())).collect()
        };
        let (mut seen, mut failure) = (Vec::new(), None);
        for amplitude in looks(&self.beliefs[0]) {
            for lengthscale in looks(&self.beliefs[1]) {
                // Noise starts at its mode: contacts mostly say the truth about themselves.
                let noise = self.beliefs[2].map_or(0.0, |b| b.mode.ln());
                let at = self.clamped(Vector3::new(amplitude, lengthscale, noise));
                match self.fit(at) {
                    Ok((value, _, _)) => seen.push((value, at)),
                    Err(error) => failure = Some(error),
                }
            }
        }
        seen.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Option<Height> = None;
        for (_, at) in seen.into_iter().take(CLIMBS) {
            let top = self.climb(at)?;
            if best.is_none_or(|b| top.value > b.value) {
                best = Some(top);
            }
        }
        let none = Error::Parameter { name: "log marginal likelihood", value: f64::NAN };
        best.map(|b| b.found).ok_or(failure.unwrap_or(none))
    }

    /// Quasi-Newton ascent (BFGS) within the bounds.
    fn climb(&self, start: Vector3<f64>) -> Result<Height, Error> {
        let mut here = self.height(start)?;
        // Approximates minus the inverse of the Hessian; the beliefs' variances to begin with.
        let cautious = Matrix3::from_diagonal(&Vector3::from(
            self.beliefs.map(|b| b.map_or(0.0, |b| 0.1 * b.deviation * b.deviation)),
        ));
        let mut inverse = cautious;
        for _ in 0..STEPS {
            let free = self.free(&here);
            let uphill = here.slope.component_mul(&free);
            if uphill.amax() < FLAT {
                break;
            }
            let mut step = (inverse * uphill).component_mul(&free);
            if step.dot(&uphill) <= 0.0 {
                inverse = cautious;
                step = inverse * uphill;
            }
            step *= (STRIDE / step.amax()).min(1.0);
            let Some(next) = self.higher(&here, step) else { break };
            let (s, y) = (next.at - here.at, here.slope - next.slope);
            let along = s.dot(&y);
            if along > 1e-9 {
                let turn = Matrix3::identity() - s * y.transpose() / along;
                inverse = turn * inverse * turn.transpose() + s * s.transpose() / along;
            }
            here = next;
        }
        Ok(here)
    }

    /// The first point along the step, halved as often as needed, that is high enough.
    fn higher(&self, here: &Height, mut step: Vector3<f64>) -> Option<Height> {
        for _ in 0..HALVINGS {
            let at = self.clamped(here.at + step);
            let promised = here.slope.dot(&(at - here.at));
            // A covariance that cannot be factored is no better than a low place.
            if let Ok(next) = self.height(at)
                && next.value > here.value + 1e-4 * promised
            {
                return Some(next);
            }
            step *= 0.5;
        }
        None
    }

    /// 1 for the logarithms that may move the way the slope points, 0 for the others.
    fn free(&self, here: &Height) -> Vector3<f64> {
        Vector3::from_fn(|i, _| {
            let Some(belief) = self.beliefs[i] else { return 0.0 };
            let (low, high) = (belief.bounds.0.ln(), belief.bounds.1.ln());
            let (x, slope) = (here.at[i], here.slope[i]);
            if (x <= low && slope < 0.0) || (x >= high && slope > 0.0) { 0.0 } else { 1.0 }
        })
    }

    fn clamped(&self, at: Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| match self.beliefs[i] {
            Some(Belief { bounds: (low, high), .. }) => at[i].clamp(low.ln(), high.ln()),
            None => at[i],
        })
    }

    fn height(&self, at: Vector3<f64>) -> Result<Height, Error> {
        let (value, gpis, found) = self.fit(at)?;
        let slopes = gpis.log_marginal_likelihood_slopes();
        let slopes = [slopes.amplitude, slopes.lengthscale.unwrap_or(0.0), slopes.noise];
        let slope = Vector3::from_fn(|i, _| match self.beliefs[i] {
            Some(b) => slopes[i] - (at[i] - b.mode.ln()) / (b.deviation * b.deviation),
            None => 0.0,
        });
        Ok(Height { at, value, slope, found })
    }

    /// Log posterior up to a constant, and what it was made of.
    fn fit(&self, at: Vector3<f64>) -> Result<(f64, Gpis, Found), Error> {
        let [amplitude, lengthscale, noise] = [at.x.exp(), at.y.exp(), at.z.exp()];
        let (amplitude, lengthscale) = (amplitude * self.radius, lengthscale * self.radius);
        let kernel = match self.family {
            Kernel::SquaredExponential { .. } => {
                Kernel::SquaredExponential { amplitude, lengthscale }
            }
            Kernel::Matern32 { .. } => Kernel::Matern32 { amplitude, lengthscale },
            Kernel::Matern52 { .. } => Kernel::Matern52 { amplitude, lengthscale },
            Kernel::ThinPlate { range, .. } => Kernel::ThinPlate { amplitude, range },
        };
        let contacts: Vec<Contact> = self.contacts.iter().map(|c| c.with_noise(noise)).collect();
        let gpis = Gpis::fit(self.dimension, kernel, self.prior.clone(), self.training, &contacts)?;
        let log_likelihood = gpis.log_marginal_likelihood();
        let mut value = log_likelihood;
        for (belief, x) in self.beliefs.iter().zip(at.iter()) {
            if let Some(b) = belief {
                value -= 0.5 * ((x - b.mode.ln()) / b.deviation).powi(2);
            }
        }
        // What it takes to make the beliefs densities.
        let root = std::f64::consts::TAU.sqrt();
        let widths = self.beliefs.iter().flatten().map(|b| (root * b.deviation).ln());
        let log_posterior = value - widths.sum::<f64>();
        Ok((value, gpis, Found { kernel, noise, log_likelihood, log_posterior }))
    }
}

impl Contact {
    /// The same contact with both standard deviations `factor` times as large.
    pub fn with_noise(&self, factor: f64) -> Contact {
        Contact {
            point_deviation: self.point_deviation * factor,
            normal_deviation: self.normal_deviation * factor,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Prior;
    use crate::space::Point;
    use proptest::prelude::*;

    const RADIUS: f64 = 0.04;

    /// Contacts about an ellipse or ellipsoid from uniform numbers; the third has no normal.
    fn touches(dimension: usize, draws: &[[f64; 5]]) -> Vec<Contact> {
        let axes = Point::new(0.06, 0.03, 0.04);
        let touch = |(index, u): (usize, &[f64; 5])| {
            let turn = std::f64::consts::TAU * u[0];
            let z = if dimension == 3 { 1.8 * u[1] - 0.9 } else { 0.0 };
            let ring = (1.0 - z * z).sqrt();
            let unit = Point::new(ring * turn.cos(), ring * turn.sin(), z);
            let normal = unit.component_div(&axes).normalize();
            let off = 0.004 * (u[2] - 0.5);
            Contact {
                point: unit.component_mul(&axes) + normal * off,
                normal: (index != 2).then_some(normal),
                point_deviation: 1e-3 * (0.5 + u[3]),
                normal_deviation: 0.1 * (0.5 + u[4]),
            }
        };
        draws.iter().enumerate().map(touch).collect()
    }

    /// Pseudo-random numbers for [`touches`].
    fn draws(count: usize, seed: u64) -> Vec<[f64; 5]> {
        let mut state = seed.wrapping_mul(2).wrapping_add(1);
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        (0..count).map(|_| std::array::from_fn(|_| uniform())).collect()
    }

    fn family(which: usize, amplitude: f64, lengthscale: f64) -> Kernel {
        match which {
            0 => Kernel::SquaredExponential { amplitude, lengthscale },
            1 => Kernel::Matern32 { amplitude, lengthscale },
            2 => Kernel::Matern52 { amplitude, lengthscale },
            _ => Kernel::ThinPlate { amplitude, range: 0.6 },
        }
    }

    const BALL: Prior = Prior::Ball { centre: Point::new(0.003, 0.0, 0.0), radius: RADIUS };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn slopes_are_the_derivatives_of_the_likelihood(
            dimension in 2usize..=3,
            which in 0usize..4,
            off_surface in any::<bool>(),
            draws in proptest::collection::vec(proptest::array::uniform5(0.0f64..1.0), 1..10),
            logs in (-4.5f64..-2.0, -3.5f64..-2.0, -0.5f64..0.5),
        ) {
            let training = if off_surface {
                Training::OffSurface { distance: 0.01 }
            } else {
                Training::Derivative
            };
            let contacts = touches(dimension, &draws);
            let at = |[a, l, n]: [f64; 3]| {
                let contacts: Vec<Contact> =
                    contacts.iter().map(|c| c.with_noise(n.exp())).collect();
                Gpis::fit(dimension, family(which, a.exp(), l.exp()), BALL, training, &contacts)
            };
            let logs = [logs.0, logs.1, logs.2];
            let slopes = at(logs).unwrap().log_marginal_likelihood_slopes();
            let sought = [Some(slopes.amplitude), slopes.lengthscale, Some(slopes.noise)];
            for (i, analytic) in sought.into_iter().enumerate() {
                let h = 1e-4;
                let (mut more, mut less) = (logs, logs);
                (more[i], less[i]) = (more[i] + h, less[i] - h);
                let rise = at(more).unwrap().log_marginal_likelihood()
                    - at(less).unwrap().log_marginal_likelihood();
                // The thin plate's range is no parameter: nothing may depend on the second one.
                let analytic = analytic.unwrap_or(0.0);
                let allowed = 1e-4 * (1.0 + analytic.abs());
                prop_assert!((rise / (2.0 * h) - analytic).abs() < allowed, "{i}: {analytic}");
            }
        }
    }

    /// Log posterior up to a constant, from its definition.
    fn posterior(search: &Search, found: &Found, contacts: &[Contact], logs: [f64; 3]) -> f64 {
        let contacts: Vec<Contact> =
            contacts.iter().map(|c| c.with_noise(found.noise * logs[2].exp())).collect();
        let (kernel, terms) = match found.kernel {
            Kernel::Matern32 { amplitude, lengthscale } => {
                let (a, l) = (amplitude * logs[0].exp(), lengthscale * logs[1].exp());
                let kernel = Kernel::Matern32 { amplitude: a, lengthscale: l };
                (kernel, vec![(search.amplitude, a / RADIUS), (search.lengthscale, l / RADIUS)])
            }
            kernel => (kernel, vec![]),
        };
        let noise = search.noise.map(|b| (b, found.noise * logs[2].exp()));
        let believed = |(b, x): (Belief, f64)| -0.5 * ((x / b.mode).ln() / b.deviation).powi(2);
        Gpis::fit(2, kernel, BALL, Training::Derivative, &contacts)
            .unwrap()
            .log_marginal_likelihood()
            + terms.into_iter().chain(noise).map(believed).sum::<f64>()
    }

    #[test]
    fn nothing_near_is_more_plausible() {
        let noise = Belief { mode: 1.0, deviation: 0.5, bounds: (0.2, 10.0) };
        for (count, noise) in [(1, None), (5, None), (5, Some(noise)), (25, Some(noise))] {
            let search = Search { noise, ..Search::default() };
            let contacts = touches(2, &draws(count, 11));
            let family = family(1, 1.0, 1.0);
            let found =
                search.run(2, family, BALL, Training::Derivative, &contacts, RADIUS).unwrap();
            let top = posterior(&search, &found, &contacts, [0.0; 3]);
            let beliefs = [Some(search.amplitude), Some(search.lengthscale), noise];
            let peak = |b: &Belief| -(std::f64::consts::TAU.sqrt() * b.deviation).ln();
            let densities = top + beliefs.iter().flatten().map(peak).sum::<f64>();
            assert!((found.log_posterior - densities).abs() < 1e-6, "{found:?} {densities}");
            for i in 0..if noise.is_some() { 3 } else { 2 } {
                for step in [-0.5, -0.1, 0.1, 0.5] {
                    let mut logs = [0.0; 3];
                    logs[i] = step;
                    let there = posterior(&search, &found, &contacts, logs);
                    assert!(there < top, "{count} contacts, parameter {i} by {step}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn contacts_that_understate_their_noise_are_found_out() {
        let noise = Belief { mode: 1.0, deviation: 1.0, bounds: (0.1, 20.0) };
        let search = Search { noise: Some(noise), ..Search::default() };
        let run = |factor: f64| {
            let contacts: Vec<Contact> =
                touches(2, &draws(60, 3)).iter().map(|c| c.with_noise(factor)).collect();
            let family = family(0, 1.0, 1.0);
            search.run(2, family, BALL, Training::Derivative, &contacts, RADIUS).unwrap().noise
        };
        // The same contacts, their word a quarter as large: four times the factor, less the pull of
        // the belief.
        let ratio = run(0.25) / run(1.0);
        assert!((3.5..4.05).contains(&ratio), "{ratio}");
    }

    #[test]
    fn bounds_hold_and_nonsense_is_refused() {
        let contacts = touches(2, &draws(12, 5));
        let tight = Belief { mode: 0.5, deviation: 1.0, bounds: (0.45, 0.55) };
        let search = Search { lengthscale: tight, ..Search::default() };
        let run = |search: &Search, contacts: &[Contact], radius: f64| {
            search.run(2, family(1, 1.0, 1.0), BALL, Training::Derivative, contacts, radius)
        };
        let Kernel::Matern32 { lengthscale, .. } = run(&search, &contacts, RADIUS).unwrap().kernel
        else {
            panic!()
        };
        assert!((0.449..=0.551).contains(&(lengthscale / RADIUS)), "{lengthscale}");
        for radius in [0.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                run(&search, &contacts, radius),
                Err(Error::Parameter { name: "radius", .. })
            ));
        }
        let outside = Belief { mode: 0.4, ..tight };
        let search = Search { lengthscale: outside, ..Search::default() };
        assert!(matches!(run(&search, &contacts, RADIUS), Err(Error::Parameter { .. })));
        let mut broken = contacts.clone();
        broken[1].point.x = f64::NAN;
        assert!(matches!(
            run(&Search::default(), &broken, RADIUS),
            Err(Error::Contact { index: 1, .. })
        ));
    }

    #[test]
    fn without_contacts_the_beliefs_stand() {
        let search = Search::default();
        let found = search.run(3, family(1, 1.0, 1.0), BALL, Training::Derivative, &[], RADIUS);
        let Kernel::Matern32 { amplitude, lengthscale } = found.unwrap().kernel else { panic!() };
        assert!((amplitude / RADIUS / search.amplitude.mode).ln().abs() < 0.01);
        assert!((lengthscale / RADIUS / search.lengthscale.mode).ln().abs() < 0.01);
    }
}
