//! Gaussian-process regression of a blob in double precision on one thread: fit, means on a grid of
//! 64³ points, 10 000 variances, and a mesh of the zero set at the same resolution.
//! `cargo bench -p tactile-host --bench gp`.

use divan::Bencher;
use nalgebra::{DMatrix, DVector};
use tactile_host::dense::{Cholesky, Functional, Sites, Weighted};
use tactile_host::reference::Kernel;
use tactile_host::shape::{Field, surface};
use tactile_host::space::Point;

const KERNEL: Kernel = Kernel::Matern52 { amplitude: 1.0, lengthscale: 0.4 };
const NOISE: f64 = 1e-4;
const RESOLUTION: usize = 64;
/// Numbers of training rows.
const ROWS: [usize; 2] = [100, 600];

/// Nine tenths of the rows lie on the blob and are zero there, half of the others 0.4 around it,
/// half −0.4 in the middle of it.
fn data(rows: usize) -> (Vec<Point>, Vec<f64>) {
    let mut uniform = uniform();
    let on = rows * 9 / 10;
    let around = (rows - on) / 2;
    let touch = |k: usize| {
        let k = k as f64 + 0.5;
        let down = (1.0 - 2.0 * k / on as f64).acos();
        let turn = std::f64::consts::PI * (1.0 + 5f64.sqrt()) * k;
        let unit = Point::new(turn.cos() * down.sin(), turn.sin() * down.sin(), down.cos());
        let bulge = 1.0 + 0.15 * (3.0 * turn).sin() * down.sin();
        (unit * bulge).component_mul(&Point::new(0.5, 0.4, 0.6))
    };
    let control = |i: usize| {
        let unit = Point::from_fn(|_, _| uniform()).normalize();
        if i < around { (unit * 0.95, 0.4) } else { (unit * 0.05, -0.4) }
    };
    let controls: Vec<(Point, f64)> = (0..rows - on).map(control).collect();
    (0..on).map(|k| (touch(k), 0.0)).chain(controls).unzip()
}

/// Numbers from −1 to 1, the same ones every time.
fn uniform() -> impl FnMut() -> f64 {
    let mut state = 1u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    }
}

struct Regression {
    sites: Sites,
    cholesky: Cholesky,
    weighted: Weighted,
}

impl Regression {
    fn fit(points: &[Point], targets: &[f64]) -> Self {
        let mut sites = Sites::default();
        points.iter().for_each(|p| sites.push(*p, None));
        let mut matrix = sites.covariance(&KERNEL);
        (0..points.len()).for_each(|i| *matrix.at(i, i) += NOISE);
        let cholesky = Cholesky::of(matrix).expect("positive definite");
        let weights = cholesky.solve(&DVector::from_column_slice(targets));
        let weighted = sites.weighted(weights.as_slice());
        Regression { sites, cholesky, weighted }
    }

    fn of(rows: usize) -> Self {
        let (points, targets) = data(rows);
        Self::fit(&points, &targets)
    }

    fn variances(&self, points: &[Point]) -> Vec<f64> {
        let asked: Vec<Functional> = points
            .iter()
            .map(|p| Functional { point: *p, value: 1.0, slopes: Point::zeros() })
            .collect();
        let none = DMatrix::zeros(0, 0);
        let explained = self.cholesky.explained(&self.sites, &KERNEL, &asked, (&none, &none));
        explained.into_iter().map(|e| (1.0 - e).max(0.0)).collect()
    }
}

impl Field for Regression {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        self.weighted.values(&KERNEL, points)
    }

    fn first_order(&self, points: &[Point], _step: f64) -> Vec<(f64, Point)> {
        let (values, gradients) = self.weighted.gradients(&KERNEL, points);
        values.into_iter().zip(gradients).collect()
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        let (_, slopes) = self.weighted.gradients(&KERNEL, points);
        let deviations = self.variances(points).into_iter().map(f64::sqrt);
        deviations.zip(slopes).map(|(d, slope)| d / slope.norm()).collect()
    }
}

fn grid() -> Vec<Point> {
    let place = |i: usize| 2.0 * i as f64 / (RESOLUTION - 1) as f64 - 1.0;
    let count = RESOLUTION * RESOLUTION * RESOLUTION;
    (0..count)
        .map(|i| [i / (RESOLUTION * RESOLUTION), i / RESOLUTION % RESOLUTION, i % RESOLUTION])
        .map(|node| Point::from(node.map(place)))
        .collect()
}

#[divan::bench(args = ROWS, sample_count = 50)]
fn fit(bencher: Bencher, rows: usize) {
    let (points, targets) = data(rows);
    bencher.bench(|| Regression::fit(&points, &targets));
}

#[divan::bench(args = ROWS, sample_count = 5)]
fn means(bencher: Bencher, rows: usize) {
    let (model, grid) = (Regression::of(rows), grid());
    bencher.bench(|| model.values(&grid));
}

#[divan::bench(args = ROWS, sample_count = 10)]
fn variances(bencher: Bencher, rows: usize) {
    let (model, mut uniform) = (Regression::of(rows), uniform());
    let points: Vec<Point> = (0..10_000).map(|_| Point::from_fn(|_, _| uniform())).collect();
    bencher.bench(|| model.variances(&points));
}

#[divan::bench(args = ROWS, sample_count = 10)]
fn mesh(bencher: Bencher, rows: usize) {
    let model = Regression::of(rows);
    let corner = Point::from([1.0; 3]);
    let spacing = 2.0 / (RESOLUTION - 1) as f64;
    bencher.bench(|| surface::mesh(&model, (-corner, corner), spacing).expect("a lattice"));
}

#[divan::bench(args = ROWS, sample_count = 10)]
fn mesh_with_deviations(bencher: Bencher, rows: usize) {
    let model = Regression::of(rows);
    let corner = Point::from([1.0; 3]);
    let spacing = 2.0 / (RESOLUTION - 1) as f64;
    bencher.bench(|| surface::extract(&model, (-corner, corner), spacing).expect("a lattice"));
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("one thread");
    // From within the pool, so that no work changes threads.
    rayon::scope(|_| divan::main());
}
