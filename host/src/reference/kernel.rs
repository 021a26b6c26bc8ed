//! Covariances that depend on distance alone, with what derivatives need of them.

use super::gpis::Error;

/// Covariance k(d) of the field's values at two points d metres apart. Amplitudes are standard
/// deviations of the field in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// s² exp(−d²/2ℓ²). Thesis 2.15 writes exp(−d²/σ²): its σ is √2·ℓ.
    SquaredExponential {
        /// s, metres.
        amplitude: f64,
        /// ℓ, metres.
        lengthscale: f64,
    },
    /// s² (1 + u) e⁻ᵘ with u = √3 d/ℓ.
    Matern32 {
        /// s, metres.
        amplitude: f64,
        /// ℓ, metres.
        lengthscale: f64,
    },
    /// s² (1 + u + u²/3) e⁻ᵘ with u = √5 d/ℓ.
    Matern52 {
        /// s, metres.
        amplitude: f64,
        /// ℓ, metres.
        lengthscale: f64,
    },
    /// s² (2d³ − 3Rd² + R³)/R³, thesis 2.17 with R a constant of the model. It is a covariance
    /// only among points well within R of each other: R must be at least
    /// [`Kernel::LEAST_RANGE`] times the diameter of data and queries together.
    ThinPlate {
        /// s, metres.
        amplitude: f64,
        /// R, metres.
        range: f64,
    },
}

/// A radial covariance at one distance. With e = x − y and d = |e|:
/// cov(f(x), f(y)) = `value`, cov(∂ᵢf(x), f(y)) = `slope`·eᵢ,
/// cov(∂ᵢf(x), ∂ⱼf(y)) = −(`slope`·δᵢⱼ + `bend`·eᵢeⱼ).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radial {
    /// k(d).
    pub value: f64,
    /// k′(d)/d.
    pub slope: f64,
    /// (k′(d)/d)′/d. At d = 0 it may diverge as 1/d; there it is multiplied by eᵢeⱼ = 0 and given
    /// as 0.
    pub bend: f64,
}

impl Kernel {
    /// Least thin-plate range as a multiple of the diameter of the data.
    pub const LEAST_RANGE: f64 = 1.5;

    /// The covariance `distance` metres apart.
    pub fn radial(&self, distance: f64) -> Radial {
        let d = distance;
        let over_distance = if d > 0.0 { 1.0 / d } else { 0.0 };
        match *self {
            Kernel::SquaredExponential { amplitude, lengthscale } => {
                let q = 1.0 / (lengthscale * lengthscale);
                let value = amplitude * amplitude * (-0.5 * d * d * q).exp();
                Radial { value, slope: -q * value, bend: q * q * value }
            }
            Kernel::Matern32 { amplitude, lengthscale } => {
                let c = 3f64.sqrt() / lengthscale;
                let decay = amplitude * amplitude * (-c * d).exp();
                Radial {
                    value: (1.0 + c * d) * decay,
                    slope: -c * c * decay,
                    bend: c * c * c * decay * over_distance,
                }
            }
            Kernel::Matern52 { amplitude, lengthscale } => {
                let c = 5f64.sqrt() / lengthscale;
                let u = c * d;
                let decay = amplitude * amplitude * (-u).exp();
                Radial {
                    value: (1.0 + u + u * u / 3.0) * decay,
                    slope: -c * c / 3.0 * (1.0 + u) * decay,
                    bend: c.powi(4) / 3.0 * decay,
                }
            }
            Kernel::ThinPlate { amplitude, range } => {
                let scale = amplitude * amplitude / range.powi(3);
                Radial {
                    value: scale * (2.0 * d.powi(3) - 3.0 * range * d * d + range.powi(3)),
                    slope: scale * 6.0 * (d - range),
                    bend: scale * 6.0 * over_distance,
                }
            }
        }
    }

    /// What [`radial`](Self::radial) gains per unit of log lengthscale: ∂/∂ln ℓ of each entry,
    /// with the same convention at d = 0. `None` for the thin plate, whose range is fixed.
    pub fn radial_by_log_lengthscale(&self, distance: f64) -> Option<Radial> {
        let d = distance;
        let over_distance = if d > 0.0 { 1.0 / d } else { 0.0 };
        match *self {
            Kernel::SquaredExponential { amplitude, lengthscale } => {
                let q = 1.0 / (lengthscale * lengthscale);
                let u = d * d * q;
                let value = amplitude * amplitude * (-0.5 * u).exp();
                Some(Radial {
                    value: u * value,
                    slope: q * (2.0 - u) * value,
                    bend: q * q * (u - 4.0) * value,
                })
            }
            Kernel::Matern32 { amplitude, lengthscale } => {
                let c = 3f64.sqrt() / lengthscale;
                let u = c * d;
                let decay = amplitude * amplitude * (-u).exp();
                Some(Radial {
                    value: u * u * decay,
                    slope: c * c * (2.0 - u) * decay,
                    bend: c * c * c * (u - 3.0) * decay * over_distance,
                })
            }
            Kernel::Matern52 { amplitude, lengthscale } => {
                let c = 5f64.sqrt() / lengthscale;
                let u = c * d;
                let decay = amplitude * amplitude * (-u).exp();
                Some(Radial {
                    value: u * u * (1.0 + u) / 3.0 * decay,
                    slope: c * c / 3.0 * (2.0 + 2.0 * u - u * u) * decay,
                    bend: c.powi(4) / 3.0 * (u - 4.0) * decay,
                })
            }
            Kernel::ThinPlate { .. } => None,
        }
    }

    /// The same kernel with amplitude and lengths `unit` times as large: what it is when its numbers
    /// were multiples of `unit` metres.
    pub fn scaled(&self, unit: f64) -> Kernel {
        match *self {
            Kernel::SquaredExponential { amplitude, lengthscale } => Kernel::SquaredExponential {
                amplitude: amplitude * unit,
                lengthscale: lengthscale * unit,
            },
            Kernel::Matern32 { amplitude, lengthscale } => {
                Kernel::Matern32 { amplitude: amplitude * unit, lengthscale: lengthscale * unit }
            }
            Kernel::Matern52 { amplitude, lengthscale } => {
                Kernel::Matern52 { amplitude: amplitude * unit, lengthscale: lengthscale * unit }
            }
            Kernel::ThinPlate { amplitude, range } => {
                Kernel::ThinPlate { amplitude: amplitude * unit, range: range * unit }
            }
        }
    }

    /// Refuses parameters that are not finite and positive.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the parameter and its value.
    pub fn check(&self) -> Result<(), Error> {
        let (amplitude, (name, length)) = match *self {
            Kernel::SquaredExponential { amplitude, lengthscale }
            | Kernel::Matern32 { amplitude, lengthscale }
            | Kernel::Matern52 { amplitude, lengthscale } => {
                (amplitude, ("lengthscale", lengthscale))
            }
            Kernel::ThinPlate { amplitude, range } => (amplitude, ("range", range)),
        };
        for (name, value) in [("amplitude", amplitude), (name, length)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::Parameter { name, value });
            }
        }
        Ok(())
    }
}
