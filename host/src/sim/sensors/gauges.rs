//! A six-axis transducer of strain gauges, such as an ATI Nano17 (thesis figure 2.13).

use nalgebra::{Matrix6, Vector6};

use super::Push;
use crate::sim::random::Random;
use crate::space::Point;

/// How a transducer misbehaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Noise of one sample: standard deviation of each component over its full scale.
    pub noise: f64,
    /// Whether readings are rounded to the data sheet's resolution.
    pub quantised: bool,
    /// Zero shift that accumulates: standard deviation over full scale after one second.
    pub wander: f64,
    /// Warming since it was switched on, kelvin, reached as 1 − e^(−t/600 s).
    pub warming: f64,
    /// Mass of the fingertip on it, kilograms, and its centre.
    pub weight: (f64, Point),
}

impl Default for Options {
    /// 0.3 % of noise and the data sheet's resolution; no drift, no weight.
    fn default() -> Self {
        Options {
            noise: 0.003,
            quantised: true,
            wander: 0.0,
            warming: 0.0,
            weight: (0.0, Point::zeros()),
        }
    }
}

/// A transducer at the fingertip's origin.
#[derive(Clone, Debug)]
pub struct Transducer {
    options: Options,
    /// Words per newton and newton metre.
    gauges: Matrix6<f64>,
    offset: Vector6<f64>,
    /// How far each gauge shifts per kelvin, words.
    thermal: Vector6<f64>,
    wandered: Vector6<f64>,
    seconds: f64,
    random: Random,
}

/// Full scale of an ATI Nano17 SI-12-0.12: newtons and newton metres.
pub const FULL_SCALE: [f64; 6] = [12.0, 12.0, 17.0, 0.12, 0.12, 0.12];

/// Its resolution: 1/320 N and 1/64 N mm.
pub const RESOLUTION: [f64; 6] =
    [1.0 / 320.0, 1.0 / 320.0, 1.0 / 320.0, 1e-3 / 64.0, 1e-3 / 64.0, 1e-3 / 64.0];

/// Largest word of a 24-bit converter.
pub const WORD: f64 = 8_388_607.0;

/// Radius at which the three beams carry the load, metres.
const BEAMS: f64 = 5.5e-3;

impl Transducer {
    /// One specimen; `seed` decides its gauges' gains, crosstalk, offsets and noise.
    pub fn new(options: Options, seed: u64) -> Transducer {
        let [mut build, random] = Random::streams(seed);
        let mut gauges = Matrix6::zeros();
        for beam in 0..3 {
            let (sin, cos) = (std::f64::consts::TAU * beam as f64 / 3.0).sin_cos();
            // A beam bends along the axis with its share of Fz and of the moments across, and
            // around the axis with its share of the forces across and of Mz.
            let axial =
                [0.0, 0.0, 1.0 / 3.0, 2.0 / 3.0 * sin / BEAMS, -2.0 / 3.0 * cos / BEAMS, 0.0];
            let around = [-2.0 / 3.0 * sin, 2.0 / 3.0 * cos, 0.0, 0.0, 0.0, 1.0 / (3.0 * BEAMS)];
            for (row, response) in [(2 * beam, axial), (2 * beam + 1, around)] {
                // All components at full scale together reach three quarters of the range.
                let most: f64 = response.iter().zip(FULL_SCALE).map(|(r, f)| r.abs() * f).sum();
                let gain = 0.75 * WORD / most * (1.0 + build.around_zero(0.05));
                for (column, r) in response.iter().enumerate() {
                    let crosstalk = build.around_zero(0.01) * most / FULL_SCALE[column];
                    gauges[(row, column)] = gain * (r + crosstalk);
                }
            }
        }
        let mut spread = |reach: f64| Vector6::from_fn(|_, _| build.around_zero(reach * WORD));
        let (offset, thermal) = (spread(0.05), spread(0.001));
        Transducer {
            options,
            gauges,
            offset,
            thermal,
            wandered: Vector6::zeros(),
            seconds: 0.0,
            random,
        }
    }

    /// What its maker writes down: newtons and newton metres per word. `None` if its gauges do not
    /// tell all loads apart, which these do.
    pub fn calibration(&self) -> Option<[[f64; 6]; 6]> {
        let inverse = self.gauges.try_inverse()?;
        Some(std::array::from_fn(|i| std::array::from_fn(|j| inverse[(i, j)])))
    }

    /// The words of a sample taken `step` seconds after the last, under these pushes, with gravity
    /// (m/s²) along this direction of the fingertip frame.
    pub fn sample(&mut self, pushes: &[Push], gravity: Point, step: f64) -> [i32; 6] {
        let (mass, centre) = self.options.weight;
        let weight = gravity * mass;
        let turn = centre.cross(&weight);
        let mut load = Vector6::new(weight.x, weight.y, weight.z, turn.x, turn.y, turn.z);
        for push in pushes {
            load += Vector6::from(push.wrench());
        }
        let normal = self.normal();
        for k in 0..6 {
            load[k] += self.options.noise * FULL_SCALE[k] * normal[k];
            if self.options.quantised {
                load[k] = (load[k] / RESOLUTION[k]).round() * RESOLUTION[k];
            }
        }
        self.seconds += step;
        let walk = self.options.wander * WORD * step.max(0.0).sqrt();
        let shift = self.normal() * walk;
        self.wandered += shift;
        let warmth = self.options.warming * (1.0 - (-self.seconds / 600.0).exp());
        let words = self.gauges * load + self.offset + self.thermal * warmth + self.wandered;
        std::array::from_fn(|k| words[k].round().clamp(-WORD - 1.0, WORD) as i32)
    }

    fn normal(&mut self) -> Vector6<f64> {
        let (a, b) = (self.random.normal3(), self.random.normal3());
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    }
}
