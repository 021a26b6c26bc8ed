//! What one action of exploration in space costs on one thread: the belief from all contacts, the
//! contacts that 120 candidates promise, and what those are worth by each criterion.
//! `cargo bench -p tactile-host --bench explore`.

use std::f64::consts::PI;

use divan::Bencher;
use nalgebra::{Translation3, UnitQuaternion};
use tactile_host::explore::placement::Placement;
use tactile_host::explore::prediction::foresee;
use tactile_host::explore::{Belief, Criterion};
use tactile_host::log::GraspLog;
use tactile_host::sim::{Options, Touch, simulate};
use tactile_host::slam::track;
use tactile_host::space::{Point, Pose};

/// What is touched: a hexagonal prism, 80 mm tall and across.
const OBJECT: &str = "prism:0.08,hexagon:0.04";

/// Candidates of one choice.
const CANDIDATES: usize = 120;

/// Contacts felt so far.
const CONTACTS: [usize; 4] = [25, 60, 100, 150];

const CRITERIA: [Criterion; 10] = [
    Criterion::Information,
    Criterion::Entropy,
    Criterion::VarianceSum,
    Criterion::Variance,
    Criterion::Igef,
    Criterion::Shannon,
    Criterion::Renyi,
    Criterion::MutualInformation,
    Criterion::Kl,
    Criterion::DetSigma,
];

fn main() {
    // One core is what the figures are about.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("one thread");
    // From within the pool, so that no work changes threads.
    rayon::scope(|_| divan::main());
}

/// So many contacts in grasps of five, spread over the whole object.
fn felt(contacts: usize) -> GraspLog {
    let options = Options {
        grasps: Some(contacts / 5),
        contacts: 5,
        touch: Touch::Uniform,
        seed: 1000,
        ..Options::new(OBJECT.parse().expect("an object"))
    };
    simulate(&options).expect("a log").log
}

fn believed(contacts: usize) -> Belief {
    let log = felt(contacts);
    let steps = track::truth(&log).expect("true poses");
    Belief::new(&log, &steps).expect("a belief")
}

/// Palms and turns all around the object, off its middle by up to half of its radius, as exploration
/// draws them.
fn candidates(belief: &Belief) -> Vec<Placement> {
    let mut state = 1u64;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    };
    let one = |k: usize| {
        let off = Point::from_fn(|_, _| 0.5 * belief.radius * uniform());
        let turn = UnitQuaternion::from_scaled_axis(Point::from_fn(|_, _| PI * uniform()));
        let hand = Pose::from_parts(Translation3::from(belief.centre + off), turn);
        Placement { hand, spread: [0.5, 0.75, 1.0][k % 3] }
    };
    (0..CANDIDATES).map(one).collect()
}

#[divan::bench(args = CONTACTS, sample_count = 5, sample_size = 1)]
fn belief(bencher: Bencher, contacts: usize) {
    let log = felt(contacts);
    let steps = track::truth(&log).expect("true poses");
    bencher.bench_local(|| Belief::new(&log, &steps).expect("a belief"));
}

#[divan::bench(args = CONTACTS, sample_count = 20, sample_size = 1)]
fn prediction(bencher: Bencher, contacts: usize) {
    let belief = believed(contacts);
    let candidates = candidates(&belief);
    bencher.bench_local(|| foresee(&belief, &candidates));
}

#[divan::bench(args = CRITERIA, consts = CONTACTS, sample_count = 20, sample_size = 1)]
fn scores<const N: usize>(bencher: Bencher, criterion: Criterion) {
    let belief = believed(N);
    let grasps = foresee(&belief, &candidates(&belief));
    bencher.bench_local(|| criterion.worth(&belief, &grasps));
}

/// Both, with the information about the shape: what a choice takes.
#[divan::bench(args = CONTACTS, sample_count = 20, sample_size = 1)]
fn choice(bencher: Bencher, contacts: usize) {
    let belief = believed(contacts);
    let candidates = candidates(&belief);
    bencher.bench_local(|| Criterion::Information.worth(&belief, &foresee(&belief, &candidates)));
}
