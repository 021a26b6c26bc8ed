//! Radial covariances on vectors.

use super::exponential::decay;
use super::simd::Simd;
use crate::reference::Kernel;

/// [`Radial`](crate::reference::kernel::Radial) in every lane.
#[derive(Clone, Copy)]
pub(super) struct Radials<V> {
    pub value: V,
    pub slope: V,
    pub bend: V,
}

/// Which function of the distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Of {
    /// [`Kernel::radial`].
    Kernel,
    /// [`Kernel::radial_by_log_lengthscale`]; all zero for the thin plate.
    LogLengthscale,
}

/// The covariance at G vectors of squared distances. What the caller does not use of it costs
/// nothing.
#[inline(always)]
pub(super) fn radials<S: Simd, const G: usize>(
    s: S,
    kernel: &Kernel,
    of: Of,
    squared: [S::Vector; G],
) -> [Radials<S::Vector>; G] {
    let (zero, one) = (s.splat(0.0), s.splat(1.0));
    let mut found = [Radials { value: zero, slope: zero, bend: zero }; G];
    let by_lengthscale = of == Of::LogLengthscale;
    match *kernel {
        Kernel::SquaredExponential { amplitude, lengthscale } => {
            let q = 1.0 / (lengthscale * lengthscale);
            let mut x = squared;
            for g in 0..G {
                x[g] = s.mul(squared[g], s.splat(0.5 * q));
            }
            let decay = decay(s, x);
            for g in 0..G {
                let value = s.mul(decay[g], s.splat(amplitude * amplitude));
                let slope = s.mul(value, s.splat(-q));
                let bend = s.mul(value, s.splat(q * q));
                found[g] = if by_lengthscale {
                    let u = s.mul(squared[g], s.splat(q));
                    Radials {
                        value: s.mul(u, value),
                        slope: s.mul(s.sub(u, s.splat(2.0)), slope),
                        bend: s.mul(s.sub(u, s.splat(4.0)), bend),
                    }
                } else {
                    Radials { value, slope, bend }
                };
            }
        }
        Kernel::Matern32 { amplitude, lengthscale } => {
            let c = 3f64.sqrt() / lengthscale;
            let mut d = squared;
            let mut u = squared;
            for g in 0..G {
                d[g] = s.sqrt(squared[g]);
                u[g] = s.mul(d[g], s.splat(c));
            }
            let decay = decay(s, u);
            for g in 0..G {
                let u = u[g];
                let decay = s.mul(decay[g], s.splat(amplitude * amplitude));
                let cubed = s.splat(c * c * c);
                let steep = s.where_positive(d[g], s.div(s.mul(decay, cubed), d[g]));
                found[g] = if by_lengthscale {
                    Radials {
                        value: s.mul(s.mul(u, u), decay),
                        slope: s.mul(s.sub(s.splat(2.0), u), s.mul(decay, s.splat(c * c))),
                        bend: s.mul(s.sub(u, s.splat(3.0)), steep),
                    }
                } else {
                    Radials {
                        value: s.mul_add(u, decay, decay),
                        slope: s.mul(decay, s.splat(-c * c)),
                        bend: steep,
                    }
                };
            }
        }
        Kernel::Matern52 { amplitude, lengthscale } => {
            let c = 5f64.sqrt() / lengthscale;
            let mut u = squared;
            for g in 0..G {
                u[g] = s.mul(s.sqrt(squared[g]), s.splat(c));
            }
            let decay = decay(s, u);
            for g in 0..G {
                let u = u[g];
                let decay = s.mul(decay[g], s.splat(amplitude * amplitude));
                let more = s.mul_add(u, decay, decay);
                let flat = s.mul(decay, s.splat(c * c * c * c / 3.0));
                found[g] = if by_lengthscale {
                    let turn = s.mul_sub(u, u, s.mul_add(u, s.splat(2.0), s.splat(2.0)));
                    Radials {
                        value: s.mul(s.mul(s.mul(u, u), s.splat(1.0 / 3.0)), more),
                        slope: s.mul(turn, s.mul(decay, s.splat(c * c / 3.0))),
                        bend: s.mul(s.sub(u, s.splat(4.0)), flat),
                    }
                } else {
                    let rise = s.mul_add(u, s.mul_add(u, s.splat(1.0 / 3.0), one), one);
                    Radials {
                        value: s.mul(rise, decay),
                        slope: s.mul(more, s.splat(-c * c / 3.0)),
                        bend: flat,
                    }
                };
            }
        }
        Kernel::ThinPlate { .. } if by_lengthscale => {}
        Kernel::ThinPlate { amplitude, range } => {
            let scale = amplitude * amplitude / range.powi(3);
            for g in 0..G {
                let d = s.sqrt(squared[g]);
                let rise = s.sub(s.mul(d, s.splat(2.0)), s.splat(3.0 * range));
                let value = s.mul_add(rise, squared[g], s.splat(range.powi(3)));
                found[g] = Radials {
                    value: s.mul(value, s.splat(scale)),
                    slope: s.mul(s.sub(d, s.splat(range)), s.splat(scale * 6.0)),
                    bend: s.where_positive(d, s.div(s.splat(scale * 6.0), d)),
                };
            }
        }
    }
    found
}
