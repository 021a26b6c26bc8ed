//! Graphs with a known truth for tests: a robot's way through a grid, row by row and back, with loop
//! closures between neighbouring rows.

use nalgebra::{SMatrix, SVector};
use proptest::strategy::Strategy;
use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Edge, Group, PoseGraph, Se2, Se3};

/// Random numbers of a seed.
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// Of `seed`.
    pub fn new(seed: u64) -> Self {
        Random(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// In (0, 1).
    pub fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Below `count`.
    pub fn index(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count - 1)
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// With standard deviation `sigma` in each component.
    pub fn tangent<const D: usize>(&mut self, sigma: f64) -> SVector<f64, D> {
        SVector::from_fn(|_, _| self.normal() * sigma)
    }

    /// A place within `extent` metres and any rotation.
    pub fn anywhere<G: Group<D>, const D: usize>(&mut self, extent: f64) -> G {
        let translation = G::DIMENSION;
        let tangent = SVector::from_fn(|k, _| {
            let range = if k < translation { extent } else { std::f64::consts::PI };
            (self.uniform() * 2.0 - 1.0) * range
        });
        G::identity().retract(&tangent)
    }
}

/// A noise-free graph on a `side` × `side` grid of metres, turning by random angles, at its true poses
/// in a random frame; `noise` displaces measurements by so many radians, and metres.
pub fn grid<G: Group<D>, const D: usize>(seed: u64, side: usize, noise: f64) -> PoseGraph<G, D> {
    let mut random = Random::new(seed);
    let frame: G = random.anywhere(5.0);
    let mut poses = Vec::with_capacity(side * side);
    for row in 0..side {
        for step in 0..side {
            let column = if row % 2 == 0 { step } else { side - 1 - step };
            let mut place = SVector::<f64, D>::zeros();
            (place[0], place[1]) = (column as f64, row as f64);
            let mut turn: SVector<f64, D> = random.tangent(1.0);
            turn.rows_mut(0, G::DIMENSION).fill(0.0);
            poses.push(frame.compose(&G::identity().retract(&place).retract(&turn)));
        }
    }
    let mut pairs: Vec<(usize, usize)> = (1..poses.len()).map(|k| (k - 1, k)).collect();
    for row in 1..side {
        // Neighbours across two rows of a way that comes back.
        pairs.extend((0..side).map(|step| (row * side - 1 - step, row * side + step)).skip(1));
    }
    let weight = 1.0 / noise.max(0.01).powi(2);
    let mut measure = |(from, to): (usize, usize)| {
        let exact = G::between(&poses[from], &poses[to]);
        let measured = exact.retract(&random.tangent(noise));
        Edge { from, to, measured, information: SMatrix::identity() * weight }
    };
    let edges = pairs.into_iter().map(&mut measure).collect();
    PoseGraph {
        ids: (0..poses.len() as u64).map(|id| 7 + 3 * id).collect(),
        poses,
        edges,
        fixed: vec![],
    }
}

/// Planar [`grid`]s.
pub fn planar(noise: f64) -> impl Strategy<Value = PoseGraph<Se2, 3>> {
    (0u64..1000, 2usize..7).prop_map(move |(seed, side)| grid(seed, side, noise))
}

/// Spatial [`grid`]s.
pub fn spatial(noise: f64) -> impl Strategy<Value = PoseGraph<Se3, 6>> {
    (0u64..1000, 2usize..6).prop_map(move |(seed, side)| grid(seed, side, noise))
}

/// Mean squared error between poses and others, in metres² and squared radians (in space halves).
pub fn distance<G: Group<D>, const D: usize>(a: &[G], b: &[G]) -> f64 {
    let square = |(a, b): (&G, &G)| G::error(a, b, &G::identity()).norm_squared();
    a.iter().zip(b).map(square).sum::<f64>() / a.len().max(1) as f64
}
