//! A finger whose skin floats on a film of conductive fluid over electrodes, such as a BioTac.
//!
//! A push thins the film under it: like the surface of an elastic half space under a small load,
//! δ/(1 + (d/w)²)^(3/2) at distance d, deeper and wider with the force, shifted where the skin is
//! dragged along; the fluid that is squeezed out lifts the skin everywhere else. The current of an
//! electrode spreads through the film around it, so that its impedance is ∫⟨1/h⟩ dr/r over the rings
//! around it with h the film's thickness, besides the way to the common return. It is read as one
//! arm of a divider by a 12-bit converter.

use super::{Push, Skin};
use crate::sim::random::Random;
use crate::space::Point;

/// How the electrodes misbehave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Noise of one sample, words.
    pub noise: f64,
    /// Warming since it was switched on, kelvin, reached as 1 − e^(−t/600 s): the fluid conducts
    /// 2 % better per kelvin.
    pub warming: f64,
    /// Share by which electrodes differ in size, at most.
    pub spread: f64,
}

impl Default for Options {
    /// Two words of noise, electrodes within 20 %, no drift.
    fn default() -> Self {
        Options { noise: 2.0, warming: 0.0, spread: 0.2 }
    }
}

/// Electrodes of a BioTac.
const COUNT: usize = 19;

/// Where they sit on the core, millimetres (Lin et al. 2013).
const CORE: [[f64; 3]; COUNT] = [
    [0.993, -4.855, -1.116],
    [-2.700, -3.513, -3.670],
    [-6.200, -3.513, -3.670],
    [-8.000, -4.956, -1.116],
    [-10.500, -3.513, -3.670],
    [-13.400, -4.956, -1.116],
    [4.763, 0.0, -2.330],
    [3.031, -1.950, -3.330],
    [3.031, 1.950, -3.330],
    [1.299, 0.0, -4.330],
    [0.993, 4.855, -1.116],
    [-2.700, 3.513, -3.670],
    [-6.200, 3.513, -3.670],
    [-8.000, 4.956, -1.116],
    [-10.500, 3.513, -3.670],
    [-13.400, 4.956, -1.116],
    [-2.800, 0.0, -5.080],
    [-9.800, 0.0, -5.080],
    [-13.600, 0.0, -5.080],
];

/// Thickness of the film at rest, and where the bumps inside the skin meet the core, metres.
const FILM: (f64, f64) = (0.8e-3, 0.08e-3);

/// Rings around an electrode: from its own radius to where the current has spread, metres.
const RINGS: (f64, f64) = (0.6e-3, 4e-3);

const RADII: usize = 8;
const ANGLES: usize = 8;

/// Force at which a push has thinned the film by 1 − 1/e of what it can, newtons.
const STIFFNESS: f64 = 3.0;

/// Share of the fluid under a push that lifts the skin elsewhere rather than stretch it at the
/// finger's back, and the area it lifts, m².
const LIFT: (f64, f64) = (0.5, 5e-4);

/// How far the skin is dragged over the core, metres per newton along it.
const DRAG: f64 = 0.1e-3;

/// Ohms: an electrode's film at rest, its way to the return, and the other arm of the divider.
const OHMS: (f64, f64, f64) = (2_500.0, 500.0, 10_000.0);

/// A BioTac-like finger.
#[derive(Clone, Debug)]
pub struct FluidFinger {
    options: Options,
    /// Points of the skin around each electrode, ring by ring.
    around: Vec<[[Point; ANGLES]; RADII]>,
    gains: [f64; COUNT],
    seconds: f64,
    random: Random,
}

/// A push as the film feels it.
struct Dent {
    at: Point,
    depth: f64,
    width: f64,
}

impl FluidFinger {
    /// One specimen; `seed` decides how its electrodes differ, and its noise.
    pub fn new(options: Options, seed: u64) -> FluidFinger {
        let [mut build, random] = Random::streams(seed);
        let gains = [(); COUNT].map(|()| 1.0 + build.around_zero(options.spread));
        let around = CORE.iter().map(|core| rings(Point::from(*core) * 1e-3)).collect();
        FluidFinger { options, around, gains, seconds: 0.0, random }
    }

    /// Where the skin is above each electrode.
    pub fn above() -> [Point; COUNT] {
        CORE.map(|core| onto(Point::from(core) * 1e-3).0)
    }

    /// The words of a sample taken `step` seconds after the last, under these pushes.
    pub fn sample(&mut self, pushes: &[Push], step: f64) -> [u16; COUNT] {
        self.seconds += step;
        let warmth = self.options.warming * (1.0 - (-self.seconds / 600.0).exp());
        let conducts = 1.0 + 0.02 * warmth;
        let dents: Vec<Dent> = pushes.iter().map(dent).collect();
        let lift: f64 = dents.iter().map(|d| d.depth * d.width * d.width).sum::<f64>()
            * std::f64::consts::TAU
            * LIFT.0
            / LIFT.1;
        let mut words = [0; COUNT];
        for (i, word) in words.iter_mut().enumerate() {
            let thin = crowding(&self.around[i], &dents, lift);
            let film = OHMS.0 * self.gains[i] * thin / conducts;
            let ohms = film + OHMS.1 / conducts;
            let value = 4095.0 * OHMS.2 / (OHMS.2 + ohms);
            let noise = self.options.noise * self.random.normal_pair()[0];
            *word = (value + noise).round().clamp(0.0, 4095.0) as u16;
        }
        words
    }
}

/// Impedance of the rings over what it is at rest: the mean of the film's thinness, every ring with
/// the same weight as they are spaced evenly in ln r.
fn crowding(rings: &[[Point; ANGLES]; RADII], dents: &[Dent], lift: f64) -> f64 {
    let mut sum = 0.0;
    for point in rings.iter().flatten() {
        let mut film = FILM.0 + lift;
        for d in dents {
            let away = (point - d.at).norm_squared() / (d.width * d.width);
            film -= d.depth / ((1.0 + away) * (1.0 + away).sqrt());
        }
        sum += FILM.0 / film.max(FILM.1);
    }
    sum / (RADII * ANGLES) as f64
}

fn dent(push: &Push) -> Dent {
    let newtons = (-push.force.dot(&push.outward)).max(0.0);
    let drag = push.force + push.outward * newtons;
    Dent {
        at: onto(push.point + drag * DRAG).0,
        depth: 0.9 * FILM.0 * (1.0 - (-newtons / STIFFNESS).exp()),
        width: 2e-3 + 0.6e-3 * newtons.cbrt(),
    }
}

/// The skin's nearest point and its normal.
fn onto(point: Point) -> (Point, Point) {
    let Skin::Finger { radius, .. } = Skin::BIOTAC else { return (point, Point::x()) };
    let axis = Point::x() * point.x.min(0.0);
    let normal = (point - axis).try_normalize(0.0).unwrap_or(-Point::z());
    (axis + normal * radius, normal)
}

fn rings(core: Point) -> [[Point; ANGLES]; RADII] {
    let (centre, normal) = onto(core);
    let u = normal.cross(&Point::x()).try_normalize(1e-9).unwrap_or(Point::y());
    let v = normal.cross(&u);
    std::array::from_fn(|i| {
        let part = (i as f64 + 0.5) / RADII as f64;
        let radius = RINGS.0 * (RINGS.1 / RINGS.0).powf(part);
        std::array::from_fn(|j| {
            let (sin, cos) = (std::f64::consts::TAU * j as f64 / ANGLES as f64).sin_cos();
            onto(centre + (u * cos + v * sin) * radius).0
        })
    })
}
