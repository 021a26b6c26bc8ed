//! Harness of the cross-crate tests: finds data, builds firmware and runs it in QEMU.

use std::path::PathBuf;
use std::sync::Once;
use std::time::Duration;

use serde_json::Map;
use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::{TrackerKind, WireSpace};
use tactile_host::link::firmware::{self, FirmwareError, Machine};
use tactile_host::link::qemu::Qemu;
use tactile_host::log::{GraspLog, LoggedContact, LoggedFree, LoggedGrasp, Noise};
use tactile_host::space::{Bridge, Point, Pose, planar};

/// Whether a missing compiler or emulator is a failure rather than a reason to skip: it is where
/// `TACTILE_REQUIRE_FIRMWARE` is 1, as continuous integration does.
pub fn firmware_is_required() -> bool {
    std::env::var_os("TACTILE_REQUIRE_FIRMWARE").is_some_and(|v| v == "1")
}

/// The outcome, or `None` and a plain message when something has to be installed first.
///
/// # Panics
/// When anything else went wrong, or when firmware is required.
pub fn unless_missing<T>(outcome: Result<T, FirmwareError>) -> Option<T> {
    match outcome {
        Ok(done) => Some(done),
        Err(error) if error.is_missing() && !firmware_is_required() => {
            eprintln!("skipped: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// An image, or `None` when something has to be installed first.
///
/// # Panics
/// When the compiler refuses it.
pub fn built(image: &str, machine: Machine) -> Option<PathBuf> {
    static AHEAD: Once = Once::new();
    // Where all tests run, most images are needed.
    if firmware_is_required() {
        AHEAD.call_once(|| {
            let images = firmware::IMAGES.map(|(name, ..)| name);
            unless_missing(firmware::build_ahead(&images, Machine::Stm32f405));
            unless_missing(firmware::build_ahead(&firmware::BENCHES, Machine::Mps2An386));
        });
    }
    unless_missing(firmware::build(image, machine))
}

/// An image and a running emulator with it, or `None` when something has to be installed first.
///
/// # Panics
/// When no image follows objects so.
pub fn board<S: WireSpace>(machine: Machine, tracker: TrackerKind) -> Option<(PathBuf, Qemu)> {
    let image = firmware::image_for(S::DIMENSION, tracker).expect("an image with this tracker");
    let elf = built(image, machine)?;
    let board = unless_missing(Qemu::start(&elf, machine, Duration::from_secs(300)))?;
    Some((elf, board))
}

/// A space with a grasp log made by arithmetic alone, the same everywhere.
pub trait Sample: Bridge + WireSpace {
    /// Grasps of a 100 × 60 mm ellipse or a 50 mm ball that turns in the hand: five contacts and
    /// one free point each, and one contact with a noise of its own.
    fn log(grasps: usize) -> GraspLog;

    /// The same of a box of 100 × 60 (× 80) mm, whose sides a map of few places takes for flat.
    fn flat(grasps: usize) -> GraspLog;
}

/// Contact `c` of grasp `k` on a box: a grasp feels five sides at most.
fn on_box(dimension: usize, k: usize, c: usize) -> (Point, Point) {
    const HALF: [f64; 3] = [0.05, 0.03, 0.04];
    let side = (c + k) % (2 * dimension);
    let (axis, sign) = (side / 2, [1.0, -1.0][side & 1]);
    let mut point = Point::zeros();
    for i in 0..dimension {
        let along = (1.7 * (5 * k + c) as f64 + 2.3 * i as f64).sin();
        point[i] = HALF[i] * if i == axis { sign } else { 0.8 * along };
    }
    let mut normal = Point::zeros();
    normal[axis] = sign;
    (point, normal)
}

impl Sample for Planar {
    fn log(grasps: usize) -> GraspLog {
        let contact = |k: usize, c: usize| {
            let (sin, cos) = (1.1 * c as f64 + 0.37 * k as f64).sin_cos();
            let normal = Point::new(cos / 0.05, sin / 0.03, 0.0).normalize();
            (Point::new(0.05 * cos, 0.03 * sin, 0.0), normal)
        };
        log(2, grasps, planar(0.002, -0.001, 0.15), contact)
    }

    fn flat(grasps: usize) -> GraspLog {
        log(2, grasps, planar(0.002, -0.001, 0.15), |k, c| on_box(2, k, c))
    }
}

impl Sample for Spatial {
    fn log(grasps: usize) -> GraspLog {
        let contact = |k: usize, c: usize| {
            let (sin, cos) = (1.3 * c as f64 + 0.61 * k as f64).sin_cos();
            let z = (0.7 * (c * 3 + k) as f64).sin() * 0.9;
            let r = (1.0 - z * z).sqrt();
            let normal = Point::new(r * cos, r * sin, z);
            (normal * 0.05, normal)
        };
        let turn = Pose::new(Point::new(0.002, -0.001, 0.001), Point::new(0.05, 0.1, -0.08));
        log(3, grasps, turn, contact)
    }

    fn flat(grasps: usize) -> GraspLog {
        let turn = Pose::new(Point::new(0.002, -0.001, 0.001), Point::new(0.05, 0.1, -0.08));
        log(3, grasps, turn, |k, c| on_box(3, k, c))
    }
}

fn log(
    dimension: usize,
    grasps: usize,
    motion: Pose,
    contact: impl Fn(usize, usize) -> (Point, Point),
) -> GraspLog {
    let mut pose = Pose::identity();
    let grasps = (0..grasps)
        .map(|k| {
            if k > 0 {
                pose = motion * pose;
            }
            let contacts = (0..5)
                .map(|c| {
                    let (point, normal) = contact(k, c);
                    LoggedContact {
                        finger: Some(c),
                        point: (pose * nalgebra::Point3::from(point)).coords,
                        normal: Some(pose.rotation * normal),
                        normal_noise: (c == 3).then_some(0.3),
                        force: None,
                        unknown: Map::new(),
                    }
                })
                .collect();
            let outside = Point::new(0.2, 0.01 * k as f64, 0.0);
            let free = vec![LoggedFree { finger: Some(0), point: outside, unknown: Map::new() }];
            LoggedGrasp {
                index: k as u64,
                time: Some(k as f64),
                motion: (k > 0).then_some(motion),
                contacts,
                free,
                truth: Some(pose),
                unknown: Map::new(),
            }
        })
        .collect();
    GraspLog {
        dimension,
        description: "made by arithmetic".into(),
        fingers: ["ff", "mf", "rf", "lf", "th"].map(str::to_owned).to_vec(),
        noise: Noise {
            point: Some(1e-3),
            normal: Some(0.087),
            translation: Some(2e-3),
            rotation: Some(0.05),
        },
        shape: None,
        grasps,
        unknown: Map::new(),
    }
}
