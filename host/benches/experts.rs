//! Adding a contact to a surface of 1 000, 10 000 and 100 000, and asking it: neither may grow.
//! `cargo bench -p tactile-host --bench experts`.
//!
//! `grown` is an object of one size, touched ever more densely; `wide` an object that grows with the
//! number of contacts, so that none can be merged. Every sample of `add_and_ask` adds a contact and
//! asks for mean and variance beside it, which fits the experts there anew.
//!
//! What a query costs is what one costs that comes alone, at a random place (`one_…`), or among
//! others of the same few millimetres (`variance_patch_…`, as meshes ask). Points of a batch that is
//! spread over the object share experts, the more the fewer experts there are: at 1 000 contacts a
//! batch of 4096 asks each of 300 experts for 50 points at a time, at 100 000 each of 1 700 for 9.

use std::hint::black_box;

use divan::Bencher;
use divan::counter::ItemsCount;
use tactile_host::experts::{Experts, Settings};
use tactile_host::reference::{Contact, Kernel, Prior};
use tactile_host::space::Point;

const COUNTS: [usize; 3] = [1_000, 10_000, 100_000];
/// Standard deviation of a contact, metres.
const NOISE: f64 = 1e-3;
/// Points of a batch.
const BATCH: usize = 4096;

fn main() {
    // Not when a test run only wants to see that it works.
    if std::env::args().any(|a| a == "--bench") {
        table();
    }
    divan::main();
}

/// Sizes, times and memory of whole surfaces.
fn table() {
    for wide in [false, true] {
        for count in COUNTS {
            if wide && count > 10_000 {
                continue; // Minutes: every contact is a site of its own.
            }
            let start = std::time::Instant::now();
            let surface = surface(count, wide);
            let filled = start.elapsed().as_secs_f64();
            surface.settle(|_, _| ());
            eprintln!(
                "{count} contacts{}: {} sites, {} experts; filled in {filled:.2} s, all fitted \
                 after {:.2} s; factors {:.0} MB, process {:.0} MB at most so far",
                if wide { " on a growing object" } else { "" },
                surface.sites(),
                surface.experts(),
                start.elapsed().as_secs_f64(),
                surface.memory() as f64 / 1e6,
                peak_megabytes(),
            );
        }
    }
}

/// Peak resident memory as Linux tells it; not a number elsewhere.
fn peak_megabytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kb| kb / 1e3)
}

/// Semi-axes of the ellipsoid, metres: those of a 120 × 60 × 80 mm object at 1 000 contacts.
fn axes(count: usize, wide: bool) -> Point {
    let scale = if wide { (count as f64 / 1000.0).sqrt() } else { 1.0 };
    Point::new(0.06, 0.03, 0.04) * scale
}

/// The `i`-th of evenly but irregularly spread contacts, off by up to √3 standard deviations.
fn contact(i: usize, axes: &Point) -> Contact {
    let share = |step: f64| (i as f64 * step).fract();
    let z = 2.0 * share(0.754_877_666_246_693) - 1.0;
    let (sin, cos) = (std::f64::consts::TAU * share(0.569_840_290_998_053)).sin_cos();
    let ring = (1.0 - z * z).sqrt();
    let unit = Point::new(ring * cos, ring * sin, z);
    let normal = unit.component_div(axes).normalize();
    let off = 12f64.sqrt() * NOISE * (share(0.437_016_024_448_821) - 0.5);
    Contact {
        point: unit.component_mul(axes) + normal * off,
        normal: Some(normal),
        point_deviation: NOISE,
        normal_deviation: 0.0873,
    }
}

fn surface(count: usize, wide: bool) -> Experts {
    let axes = axes(count, wide);
    // The kernel of the object of 1 000 contacts: a larger object has no larger details.
    let kernel = Kernel::Matern32 { amplitude: 0.025, lengthscale: 0.08 };
    let prior = Prior::Ball { centre: Point::zeros(), radius: axes.mean() };
    let mut settings = Settings::new(3, kernel, prior, NOISE);
    if wide {
        settings.reach = 0.0;
    }
    let mut surface = Experts::new(settings).unwrap();
    for i in 0..count {
        surface.insert(&contact(i, &axes)).unwrap();
    }
    surface
}

/// Points near the surface, far from one another.
fn asked(count: usize, wide: bool) -> Vec<Point> {
    let axes = axes(count, wide);
    (0..BATCH).map(|i| contact(7 * i + 3, &axes).point * 1.01).collect()
}

fn settled(count: usize, wide: bool) -> Experts {
    let surface = surface(count, wide);
    surface.settle(|_, _| ());
    surface
}

fn add(bencher: Bencher<'_, '_>, count: usize, wide: bool) {
    let (mut surface, axes) = (surface(count, wide), axes(count, wide));
    let mut next = count;
    bencher.bench_local(|| {
        surface.insert(&contact(next, &axes)).unwrap();
        next += 1;
    });
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn add_grown(bencher: Bencher<'_, '_>, count: usize) {
    add(bencher, count, false);
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn add_wide(bencher: Bencher<'_, '_>, count: usize) {
    add(bencher, count, true);
}

#[divan::bench(args = COUNTS, max_time = 2)]
fn add_and_ask_grown(bencher: Bencher<'_, '_>, count: usize) {
    let (mut surface, axes) = (settled(count, false), axes(count, false));
    let mut next = count;
    bencher.bench_local(|| {
        let contact = contact(next, &axes);
        next += 1;
        surface.insert(&contact).unwrap();
        (surface.means(&[contact.point]), surface.variances(&[contact.point]))
    });
}

fn ask(bencher: Bencher<'_, '_>, count: usize, wide: bool, variance: bool, threads: usize) {
    // The experts that will be asked, fitted before anything is timed.
    let surface = surface(count, wide);
    let mut points = asked(count, wide);
    points.truncate(if wide { BATCH / 16 } else { BATCH });
    surface.variances(&points);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let batch = &points[..if variance { points.len() / 8 } else { points.len() }];
    bencher.counter(ItemsCount::new(batch.len())).bench_local(|| {
        let points = black_box(batch);
        pool.install(|| if variance { surface.variances(points) } else { surface.means(points) })
    });
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn mean_grown_one_thread(bencher: Bencher<'_, '_>, count: usize) {
    ask(bencher, count, false, false, 1);
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn mean_grown_all_threads(bencher: Bencher<'_, '_>, count: usize) {
    ask(bencher, count, false, false, 0);
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn mean_wide_one_thread(bencher: Bencher<'_, '_>, count: usize) {
    ask(bencher, count, true, false, 1);
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn variance_grown_one_thread(bencher: Bencher<'_, '_>, count: usize) {
    ask(bencher, count, false, true, 1);
}

#[divan::bench(args = COUNTS, max_time = 1)]
fn variance_grown_all_threads(bencher: Bencher<'_, '_>, count: usize) {
    ask(bencher, count, false, true, 0);
}

/// Neighbouring points: a cube of 4 mm at the surface.
#[divan::bench(args = COUNTS, max_time = 1)]
fn variance_patch_one_thread(bencher: Bencher<'_, '_>, count: usize) {
    let (surface, corner) = (surface(count, false), asked(count, false)[5]);
    let place = |i: usize| Point::new((i % 8) as f64, (i / 8 % 8) as f64, (i / 64) as f64);
    let patch: Vec<Point> = (0..512).map(|i| corner + 5e-4 * place(i)).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    surface.variances(&patch);
    bencher
        .counter(ItemsCount::new(patch.len()))
        .bench_local(|| pool.install(|| surface.variances(black_box(&patch))));
}

/// One point at a time, here and there: what a tracker would ask.
fn one<T>(bencher: Bencher<'_, '_>, count: usize, ask: impl Fn(&Experts, &[Point]) -> T) {
    let (surface, points) = (surface(count, false), asked(count, false));
    surface.variances(&points);
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % BATCH;
        ask(&surface, &points[next..=next])
    });
}

#[divan::bench(args = COUNTS, sample_count = 2000)]
fn one_mean_grown(bencher: Bencher<'_, '_>, count: usize) {
    one(bencher, count, Experts::means);
}

#[divan::bench(args = COUNTS, sample_count = 2000)]
fn one_variance_grown(bencher: Bencher<'_, '_>, count: usize) {
    one(bencher, count, Experts::variances);
}
