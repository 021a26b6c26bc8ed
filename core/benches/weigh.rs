//! Weighing 20 000 spatial particles by five contacts on a surface of 100 contacts without normals:
//! ten million kernel evaluations when done exactly, a hundred thousand interpolations from a baked
//! grid. `cargo bench -p tactile-core`.

use std::hint::black_box;

use divan::Bencher;
use tactile_core::contact::Contact;
use tactile_core::math;
use tactile_core::matrix::{Coordinates, Vector};
use tactile_core::random::Random;
use tactile_core::space::{Pose, Spatial, SpatialPose};
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{Ball, Gpis, Grid, Map, Matern32, Training};

const POINTS: usize = 100;
const PARTICLES: usize = 20_000;
const CONTACTS: usize = 5;
/// Particles weighed side by side.
const LANES: usize = 16;
/// Standard deviation of a contact, metres.
const DEVIATION: f32 = 1e-3;

type Exact = Gpis<Spatial, Matern32, Ball<Spatial>, POINTS, POINTS, { packed(POINTS) }>;
type Baked = Grid<Spatial, { 48 * 48 * 48 }>;

/// A point on an ellipsoid of 120 × 60 × 80 mm.
fn touch(random: &mut Random) -> Vector<3> {
    let n = random.normal::<Vector<3>>().normalized().unwrap_or(Vector([1.0, 0.0, 0.0]));
    Vector([0.06 * n[0], 0.03 * n[1], 0.04 * n[2]])
}

struct Work {
    surface: Box<Exact>,
    grid: Box<Baked>,
    particles: Vec<SpatialPose>,
    contacts: [Vector<3>; CONTACTS],
    weights: Vec<f32>,
}

impl Work {
    fn new() -> Self {
        let mut random = Random::new(1);
        let mut surface = Box::new(Exact::new());
        let kernel = Matern32 { amplitude: 0.03, lengthscale: 0.1 };
        surface.configure(kernel, Ball { centre: Vector::ZERO, radius: 0.0 }, Training::Normals);
        for _ in 0..POINTS {
            surface.insert(&Contact {
                point: touch(&mut random),
                normal: None,
                point_deviation: DEVIATION,
                normal_deviation: 0.1,
                finger: 0,
            });
        }
        surface.refit();
        let mut grid = Box::new(Baked::new());
        grid.bake(&*surface, Vector::ZERO, 0.1);
        let contacts = [0; CONTACTS].map(|_| touch(&mut random));
        let particles = (0..PARTICLES)
            .map(|_| {
                let t: Vector<6> = random.normal();
                SpatialPose::IDENTITY.retract(Vector([
                    0.01 * t[0],
                    0.01 * t[1],
                    0.01 * t[2],
                    0.35 * t[3],
                    0.35 * t[4],
                    0.35 * t[5],
                ]))
            })
            .collect();
        Work { surface, grid, particles, contacts, weights: vec![0.0; PARTICLES] }
    }
}

/// A field many points wide. A closure would do, but nothing makes sure it is inlined where the
/// instruction set is chosen.
trait Field {
    fn values(&self, points: &[Vector<3>; LANES]) -> [f32; LANES];
}

impl Field for Exact {
    #[inline(always)]
    fn values(&self, points: &[Vector<3>; LANES]) -> [f32; LANES] {
        Gpis::values(self, points)
    }
}

impl Field for Baked {
    #[inline(always)]
    fn values(&self, points: &[Vector<3>; LANES]) -> [f32; LANES] {
        Grid::values(self, points)
    }
}

/// Weights of all particles from the field at their contacts; they sum to one.
#[inline(always)]
fn weigh(
    particles: &[SpatialPose],
    contacts: &[Vector<3>; CONTACTS],
    weights: &mut [f32],
    field: &impl Field,
) -> f32 {
    let mut greatest = f32::NEG_INFINITY;
    let (poses, _) = particles.as_chunks::<LANES>();
    let (chunks, _) = weights.as_chunks_mut::<LANES>();
    for (poses, logs) in poses.iter().zip(chunks) {
        let mut squares = [0.0; LANES];
        for contact in contacts {
            let mut points = [Vector::ZERO; LANES];
            for (point, pose) in points.iter_mut().zip(poses) {
                *point = pose.untransform(*contact);
            }
            for (square, f) in squares.iter_mut().zip(field.values(&points)) {
                *square += f * f;
            }
        }
        for (log, square) in logs.iter_mut().zip(squares) {
            *log = square * (-0.5 / (DEVIATION * DEVIATION));
            greatest = if *log > greatest { *log } else { greatest };
        }
    }
    let mut total = 0.0;
    for weight in weights.iter_mut() {
        *weight = math::exp(*weight - greatest);
        total += *weight;
    }
    let scale = 1.0 / total;
    weights.iter_mut().for_each(|w| *w *= scale);
    weights[0]
}

#[inline(always)]
fn exactly(work: &mut Work) -> f32 {
    weigh(&work.particles, &work.contacts, &mut work.weights, &*work.surface)
}

#[inline(always)]
fn from_grid(work: &mut Work) -> f32 {
    weigh(&work.particles, &work.contacts, &mut work.weights, &*work.grid)
}

/// The same operations, eight at a time: without fused multiply-add the bits stay the same.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn exactly_avx2(work: &mut Work) -> f32 {
    exactly(work)
}

/// Sixteen at a time.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
fn exactly_avx512(work: &mut Work) -> f32 {
    exactly(work)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn from_grid_avx2(work: &mut Work) -> f32 {
    from_grid(work)
}

#[divan::bench]
fn exact(bencher: Bencher) {
    let mut work = Work::new();
    bencher.bench_local(|| exactly(black_box(&mut work)));
}

#[divan::bench]
fn grid(bencher: Bencher) {
    let mut work = Work::new();
    bencher.bench_local(|| from_grid(black_box(&mut work)));
}

#[cfg(target_arch = "x86_64")]
#[divan::bench]
fn exact_avx2(bencher: Bencher) {
    let mut work = Work::new();
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        bencher.bench_local(|| unsafe { exactly_avx2(black_box(&mut work)) });
    }
}

#[cfg(target_arch = "x86_64")]
#[divan::bench]
fn exact_avx512(bencher: Bencher) {
    let mut work = Work::new();
    if has_avx512() {
        // SAFETY: the processor has these instructions.
        bencher.bench_local(|| unsafe { exactly_avx512(black_box(&mut work)) });
    }
}

#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    std::is_x86_feature_detected!("avx512f")
        && std::is_x86_feature_detected!("avx512bw")
        && std::is_x86_feature_detected!("avx512dq")
        && std::is_x86_feature_detected!("avx512vl")
}

#[cfg(target_arch = "x86_64")]
#[divan::bench]
fn grid_avx2(bencher: Bencher) {
    let mut work = Work::new();
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        bencher.bench_local(|| unsafe { from_grid_avx2(black_box(&mut work)) });
    }
}

/// Wider instructions must not change a bit.
#[cfg(target_arch = "x86_64")]
fn check_bits(work: &mut Work) {
    exactly(work);
    let narrow = work.weights.clone();
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        unsafe { exactly_avx2(work) };
        assert_eq!(narrow, work.weights);
    }
    if has_avx512() {
        // SAFETY: the processor has these instructions.
        unsafe { exactly_avx512(work) };
        assert_eq!(narrow, work.weights);
    }
}

fn main() {
    let mut work = Work::new();
    #[cfg(target_arch = "x86_64")]
    check_bits(&mut work);
    exactly(&mut work);
    let exact = work.weights.clone();
    from_grid(&mut work);
    let moved: f32 = exact.iter().zip(&work.weights).map(|(a, b)| (a - b).abs()).sum();
    let error = work.grid.error(&*work.surface);
    println!(
        "{PARTICLES} particles x {CONTACTS} contacts against {POINTS} points\n\
         grid of {} nodes, {:.1} mm apart: value off by at most {:.3} mm at the centres of {} cells \
         near the surface; it moves {:.1} % of the weight",
        Baked::capacity().pow(3),
        work.grid.spacing() * 1e3,
        error.value * 1e3,
        error.cells,
        moved * 50.0,
    );
    divan::main();
}
