//! What is kept of contacts that lie closer together than their noise can tell apart.

use crate::reference::{Contact, Kernel, Prior};
use crate::space::Point;

/// Additive moments of any number of contacts: two sets merge by adding theirs. They are all that
/// a Gaussian process would use if the contacts were at one point, and nearly all if the field
/// between them is close to linear; what is lost then is bounded by [`Moments::observation`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// How many contacts.
    pub count: u64,
    /// Σ 1/σ_p².
    weight: f64,
    /// Mean of the points, weighted by 1/σ_p², metres.
    pub centroid: Point,
    /// Σ |p − centroid|²/σ_p².
    scatter: f64,
    /// Weighted mean of the prior at the points, metres.
    prior: f64,
    /// Σ 1/σ_θ² over the contacts with a normal.
    normal_weight: f64,
    /// Mean of the normals less the prior's gradient, weighted by 1/σ_θ².
    slope: Point,
    /// Mean of the normals, weighted so.
    normal: Point,
}

/// One summary as the Gaussian process of the residual f − prior sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Where, metres.
    pub point: Point,
    /// Value of the residual, metres, and its variance.
    pub value: (f64, f64),
    /// Gradient of the residual and the variance of each of its components, where there is one.
    pub slope: Option<(Point, f64)>,
}

impl Moments {
    /// One contact, whose numbers have been checked.
    pub fn of(contact: &Contact, prior: &Prior) -> Moments {
        let normal = contact.normal.map(|n| n.normalize());
        Moments {
            count: 1,
            weight: contact.point_deviation.powi(-2),
            centroid: contact.point,
            scatter: 0.0,
            prior: prior.value(&contact.point),
            normal_weight: normal.map_or(0.0, |_| contact.normal_deviation.powi(-2)),
            slope: normal.map_or(Point::zeros(), |n| n - prior.gradient(&contact.point)),
            normal: normal.unwrap_or_default(),
        }
    }

    /// Takes the contacts of `other` in.
    pub fn add(&mut self, other: &Moments) {
        let weight = self.weight + other.weight;
        let share = other.weight / weight;
        let apart = other.centroid - self.centroid;
        self.count += other.count;
        self.scatter += other.scatter + apart.norm_squared() * self.weight * share;
        self.centroid += apart * share;
        self.prior += (other.prior - self.prior) * share;
        self.weight = weight;
        if other.normal_weight > 0.0 {
            self.normal_weight += other.normal_weight;
            let share = other.normal_weight / self.normal_weight;
            self.slope += (other.slope - self.slope) * share;
            self.normal += (other.normal - self.normal) * share;
        }
    }

    /// Direction of the mean normal; `None` without normals, or where they cancel.
    pub fn direction(&self) -> Option<Point> {
        self.normal.try_normalize(1e-3)
    }

    /// The contacts' mean value and gradient, taken for those at their centroid.
    ///
    /// The mean of f over points scattered by r (root mean square) differs from f at their centroid
    /// by a number of variance k(0) − 2k(r) + k(√2 r): pairs of the points are √2 r apart, and what
    /// is linear cancels. That is added to the variance of the mean, and the like for gradients;
    /// the prior, known exactly, is averaged over the points themselves.
    pub fn observation(&self, kernel: &Kernel, dimension: usize) -> Observation {
        let spread = (self.scatter / self.weight).sqrt();
        let value = (-self.prior, 1.0 / self.weight + remainder(kernel, spread));
        let slope = (self.normal_weight > 0.0).then(|| {
            let blur = slope_remainder(kernel, spread, dimension);
            (self.slope, 1.0 / self.normal_weight + blur)
        });
        Observation { point: self.centroid, value, slope }
    }
}

/// Variance of the mean of the field over points scattered by `spread` metres (root mean square)
/// about its value at their centroid, m².
pub fn remainder(kernel: &Kernel, spread: f64) -> f64 {
    let k = |d: f64| kernel.radial(d).value;
    (k(0.0) - 2.0 * k(spread) + k(std::f64::consts::SQRT_2 * spread)).max(0.0)
}

/// The same for one component of the gradient.
fn slope_remainder(kernel: &Kernel, spread: f64, dimension: usize) -> f64 {
    let k = |d: f64| {
        let k = kernel.radial(d);
        -(k.slope + k.bend * d * d / dimension as f64)
    };
    (k(0.0) - 2.0 * k(spread) + k(std::f64::consts::SQRT_2 * spread)).max(0.0)
}

/// The largest spread whose [`remainder`] stays below `variance` (m²), metres: by bisection, for
/// the remainder grows with the spread. At most one lengthscale.
pub fn widest(kernel: &Kernel, lengthscale: f64, variance: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if remainder(kernel, middle * lengthscale) < variance {
            low = middle
        } else {
            high = middle
        }
    }
    low * lengthscale
}

/// Contacts taken for one.
#[derive(Clone, Copy, Debug)]
pub struct Site {
    /// Where its first contact was: the site's place in the partition, which never moves.
    pub seat: Point,
    /// All its contacts.
    pub live: Moments,
    /// As experts farther away see it: brought up to date when it has grown by a quarter.
    pub shown: Moments,
}

impl Site {
    /// Of one contact.
    pub fn new(moments: Moments) -> Site {
        Site { seat: moments.centroid, live: moments, shown: moments }
    }
}

/// Brings what is shown up to date where it lags by a quarter of the contacts.
pub fn show(live: &Moments, shown: &mut Moments) {
    if 4 * live.count >= 5 * shown.count {
        *shown = *live;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.08 };
    const BALL: Prior = Prior::Ball { centre: Point::new(0.0, 0.01, 0.0), radius: 0.04 };

    fn contact(u: &[f64; 5]) -> Contact {
        Contact {
            point: Point::new(u[0], u[1], u[2]) * 0.01,
            normal: (u[3] > 0.2).then(|| Point::new(u[3], u[4], 0.3).normalize()),
            point_deviation: 1e-3 * (0.5 + u[4]),
            normal_deviation: 0.1 * (0.5 + u[0]),
        }
    }

    proptest! {
        #[test]
        fn moments_are_those_of_the_definition_however_they_are_added(
            draws in proptest::collection::vec(proptest::array::uniform5(0.0f64..1.0), 2..20),
            cut in 0usize..20,
        ) {
            let contacts: Vec<Contact> = draws.iter().map(contact).collect();
            let sum = |contacts: &[Contact]| {
                contacts.iter().map(|c| Moments::of(c, &BALL)).reduce(|mut a, b| {
                    a.add(&b);
                    a
                })
            };
            let cut = 1 + cut % (contacts.len() - 1);
            let mut parts = sum(&contacts[..cut]).unwrap();
            parts.add(&sum(&contacts[cut..]).unwrap());
            let weights: Vec<f64> = contacts.iter().map(|c| c.point_deviation.powi(-2)).collect();
            let total: f64 = weights.iter().sum();
            let mean: Point =
                contacts.iter().zip(&weights).map(|(c, w)| c.point * *w).sum::<Point>() / total;
            let scatter: f64 = contacts
                .iter()
                .zip(&weights)
                .map(|(c, w)| w * (c.point - mean).norm_squared())
                .sum();
            prop_assert_eq!(parts.count, contacts.len() as u64);
            prop_assert!((parts.weight / total - 1.0).abs() < 1e-12);
            prop_assert!((parts.centroid - mean).norm() < 1e-14);
            prop_assert!((parts.scatter / scatter - 1.0).abs() < 1e-9);
            // The prior is quadratic: its mean over the points exceeds that at their mean.
            let excess = scatter / total / (2.0 * 0.04);
            prop_assert!((parts.prior - BALL.value(&mean) - excess).abs() < 1e-12);
            let felt = contacts.iter().filter_map(|c| {
                let w = c.normal_deviation.powi(-2);
                c.normal.map(|n| ((n - BALL.gradient(&c.point)) * w, w))
            });
            let (slope, weight) =
                felt.fold((Point::zeros(), 0.0), |(s, w), (a, b)| (s + a, w + b));
            prop_assert!((parts.normal_weight - weight).abs() <= 1e-9 * weight);
            if weight > 0.0 {
                prop_assert!((parts.slope - slope / weight).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn points_that_coincide_lose_nothing_and_scattered_ones_what_the_field_bends() {
        let mut one = Moments::of(&contact(&[0.5, 0.5, 0.5, 0.9, 0.5]), &BALL);
        one.add(&one.clone());
        let seen = one.observation(&KERNEL, 3);
        assert!((seen.value.1 - 0.5e-6).abs() < 1e-18);
        assert!((seen.slope.unwrap().1 - 0.005).abs() < 1e-12);
        // Matérn-3/2 for small u = √3 r/ℓ: (2√2 − 2)/3 s²u³.
        let u: f64 = 0.01;
        let exact = (8f64.sqrt() - 2.0) / 3.0 * 0.03 * 0.03 * u.powi(3);
        assert!((remainder(&KERNEL, u * 0.08 / 3f64.sqrt()) / exact - 1.0).abs() < 0.03);
        let spread = widest(&KERNEL, 0.08, 1e-8);
        assert!((remainder(&KERNEL, spread) / 1e-8 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_remainder_is_the_variance_of_the_mean_about_the_centre() {
        // Four points on a ring of radius r: pairs are √2 r apart in the mean square.
        for kernel in [KERNEL, Kernel::SquaredExponential { amplitude: 0.03, lengthscale: 0.02 }] {
            let r = 0.004;
            let ring: Vec<Point> = (0..12)
                .map(|i| (f64::from(i) * std::f64::consts::FRAC_PI_6).sin_cos())
                .map(|(s, c)| Point::new(r * c, r * s, 0.0))
                .collect();
            let k = |a: &Point, b: &Point| kernel.radial((a - b).norm()).value;
            let pairs: f64 = ring.iter().flat_map(|a| ring.iter().map(move |b| k(a, b))).sum();
            let exact = pairs / 144.0 - 2.0 * kernel.radial(r).value + kernel.radial(0.0).value;
            let ours = remainder(&kernel, r);
            assert!((0.5..2.0).contains(&(ours / exact)), "{ours:e} {exact:e}");
        }
    }
}
