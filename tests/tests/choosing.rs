//! The board's choice of the next grasp: against a double-precision reference written apart from it,
//! and bit for bit in QEMU.

use nalgebra::{Matrix6, Point3, Translation3, UnitQuaternion, Vector6};
use tactile_core::contact::{Contact, GraspView};
use tactile_core::device::{
    Onboard, PlanarHypotheses, PlanarTracker, SpatialHypotheses, SpatialTracker,
};
use tactile_core::explore::{Candidate, Choice, Criterion};
use tactile_core::matrix::Square;
use tactile_core::random::Random;
use tactile_core::space::{Planar, Spatial};
use tactile_core::surface::Truncated;
use tactile_core::track::MotionNoise;
use tactile_core::wire::{ChoiceFrame, FaceSummary, TrackerKind, WireSpace};
use tactile_host::explore::adviser::Closing;
use tactile_host::explore::placement::{Placement, fixed};
use tactile_host::link::firmware::Machine;
use tactile_host::link::session::settings_for;
use tactile_host::link::{Link, Patience, Session, virtual_board};
use tactile_host::reference::foresight::{Shape, ToldFace};
use tactile_host::reference::{self, Foresight, Kernel, Training};
use tactile_host::slam::track;
use tactile_host::space::{Bridge, Point, Pose, planar};
use tactile_tests::{Sample, board};

const NOISE: f64 = 1e-3;
const CANDIDATES: usize = 10;

fn unit(random: &mut Random) -> f64 {
    random.uniform().into()
}

fn around_zero(reach: f64, random: &mut Random) -> f64 {
    (2.0 * unit(random) - 1.0) * reach
}

fn direction<S: Bridge>(random: &mut Random) -> Point {
    S::point(&random.normal::<S::Vector>()).normalize()
}

/// Within 100 mm and any turn of the place; rotations stay rotations about z in the plane.
fn some_pose<S: Bridge>(place: [f64; 3], random: &mut Random) -> Pose {
    let at = place.map(|middle| middle + around_zero(0.1, random));
    let turn = around_zero(3.0, random);
    if S::DIMENSION == 2 {
        return planar(at[0], at[1], turn);
    }
    let turn = UnitQuaternion::from_scaled_axis(direction::<S>(random) * turn);
    Pose::from_parts(Translation3::from(Point::from(at)), turn)
}

/// Grasps about an object of 60 mm that is believed to be at `pose`.
fn closings<S: Bridge>(pose: &Pose, random: &mut Random) -> Vec<Closing> {
    let one = |_| {
        let mut hand = some_pose::<S>([0.0; 3], random);
        hand.translation.vector *= 0.3;
        let placement = Placement { hand, spread: 0.5 + 0.5 * unit(random) };
        Closing { hand: pose * hand, strokes: placement.strokes(S::DIMENSION, 0.09) }
    };
    (0..CANDIDATES).map(one).collect()
}

/// Covariance of the pose at the next grasp: the diagonal that both know, and the motion noise.
fn covariance(dimension: usize, own: &Vector6<f64>, motion: MotionNoise) -> Matrix6<f64> {
    let (shift, turn) = (f64::from(motion.translation), f64::from(motion.rotation));
    let moves = |axis: usize| dimension == 3 || matches!(axis, 0 | 1 | 5);
    Matrix6::from_diagonal(&Vector6::from_fn(|axis, _| match axis {
        _ if !moves(axis) => 0.0,
        0..3 => own[axis] + shift * shift,
        _ => own[axis] + turn * turn,
    }))
}

/// The core's worth of every candidate beside the reference's: nats and square millimetres.
#[derive(Default)]
struct Errors {
    nats: Vec<f64>,
    squares: Vec<f64>,
    /// What the reference would lose by taking the core's choice, nats.
    regret: Vec<f64>,
    /// Gains of the reference, for a look at what was compared.
    gains: Vec<f64>,
}

impl Errors {
    fn compare<S: WireSpace + Bridge>(
        &mut self,
        truth: &Foresight<'_>,
        closings: &[Closing],
        mut ask: impl FnMut(&[Candidate<S>], Criterion) -> Choice,
    ) {
        let candidates: Vec<Candidate<S>> = closings.iter().map(Closing::candidate).collect();
        let worth: Vec<(f64, f64)> =
            closings.iter().map(|c| truth.worth(&c.hand, &c.strokes)).collect();
        for (candidate, (nats, square)) in candidates.iter().zip(&worth) {
            let one = std::slice::from_ref(candidate);
            let gain = f64::from(ask(one, Criterion::Information).gain);
            self.nats.push((gain - nats).abs());
            let gain = f64::from(ask(one, Criterion::VarianceSum).gain);
            self.squares.push(1e6 * (gain - square).abs() / (1.0 + 1e4 * square));
            self.gains.push(*nats);
        }
        let choice = ask(&candidates, Criterion::Information);
        assert_eq!(choice.considered, CANDIDATES);
        let best = worth.iter().map(|w| w.0).fold(0.0, f64::max);
        self.regret.push(best - worth[choice.index].0);
    }

    /// The share that is larger than `limit`.
    fn beyond(values: &[f64], limit: f64) -> f64 {
        values.iter().filter(|v| **v > limit).count() as f64 / values.len() as f64
    }

    fn judge(&self, what: &str, (nats, squares): (f64, f64)) {
        let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        let [n, s, r] = [&self.nats, &self.squares, &self.regret];
        let gains = self.gains.iter().sum::<f64>() / self.gains.len() as f64;
        eprintln!(
            "{what}: gains of {gains:.2} nats; errors up to {:.4} nats, {:.4} of variance sums, regret {:.4}",
            most(n),
            most(s),
            most(r)
        );
        assert!(gains > 1.0);
        // Two ways to meet the object that are equally likely may be told apart either way.
        assert!(Self::beyond(n, nats) <= 0.005, "{what}: {} nats", most(n));
        assert!(Self::beyond(s, squares) <= 0.005, "{what}: {} of variance sums", most(s));
        assert!(most(r) <= 2.0 * nats, "{what}: regret {}", most(r));
    }
}

fn same_worth_of_told_faces<S, T>(mut start: impl FnMut() -> Box<T>)
where
    S: Bridge + WireSpace,
    T: Onboard<S>,
{
    let mut random = Random::new(11);
    let mut errors = Errors::default();
    let motion = MotionNoise { translation: 3e-3, rotation: 0.1 };
    for _ in 0..20 {
        let pose = some_pose::<S>([0.2, -0.1, 0.3], &mut random);
        let turn = some_pose::<S>([0.0; 3], &mut random).rotation;
        let half = [0.05, 0.03, 0.04].map(|h| h + around_zero(0.01, &mut random));
        // Some sides of a box, in any order and turned.
        let sides = (0..2 * S::DIMENSION).filter(|_| unit(&mut random) < 0.7).collect::<Vec<_>>();
        let faces: Vec<ToldFace> = sides
            .iter()
            .map(|side| {
                let (axis, sign) = (side / 2, [1.0, -1.0][side % 2]);
                let mut normal = Point::zeros();
                normal[axis] = sign;
                let mut centre = normal * half[axis];
                for other in (0..S::DIMENSION).filter(|other| *other != axis) {
                    centre[other] = around_zero(0.6 * half[other], &mut random);
                }
                let [deviation, tilt] = [1e-3, 0.05].map(|most| most * (0.1 + unit(&mut random)));
                ToldFace { normal: turn * normal, centre: turn * centre, deviation, tilt }
            })
            .collect();
        if faces.is_empty() {
            continue;
        }
        let own = Vector6::from_fn(|axis, _| {
            (if axis < 3 { 2e-3 } else { 0.05 } * (0.1 + unit(&mut random))).powi(2)
        });
        let axes: &[usize] = if S::DIMENSION == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
        let mut told = S::Covariance::ZERO;
        for (i, axis) in axes.iter().enumerate() {
            *told.at_mut(i, i) = own[*axis] as f32;
        }
        let mut tracker = start();
        tracker.prepare();
        tracker.set_motion_noise(motion);
        tracker.believe(&S::pose(&pose), &told).unwrap();
        for face in &faces {
            let summary = FaceSummary {
                normal: S::vector(&face.normal),
                centroid: S::vector(&face.centre),
                deviation: face.deviation as f32,
                tilt: face.tilt as f32,
                contacts: 1,
            };
            tracker.learn(&summary).unwrap();
        }
        let truth = Foresight {
            dimension: S::DIMENSION,
            shape: Shape::Faces(&faces),
            pose,
            covariance: covariance(S::DIMENSION, &own, motion),
            noise: NOISE,
        };
        let closings = closings::<S>(&pose, &mut random);
        errors.compare::<S>(&truth, &closings, |candidates, criterion| {
            tracker.choose(None, candidates, criterion, NOISE as f32).unwrap()
        });
    }
    errors.judge(&format!("faces, {}D", S::DIMENSION), (0.004, 0.004));
}

#[test]
fn faces_are_worth_what_the_reference_says() {
    same_worth_of_told_faces::<Planar, _>(|| Box::new(PlanarHypotheses::new()));
    same_worth_of_told_faces::<Spatial, _>(|| Box::new(SpatialHypotheses::new()));
}

fn same_worth_on_a_map<S, T>(mut start: impl FnMut() -> Box<T>)
where
    S: Bridge + WireSpace,
    T: Onboard<S>,
{
    let mut random = Random::new(12);
    let mut errors = Errors::default();
    let motion = MotionNoise { translation: 3e-3, rotation: 0.1 };
    for _ in 0..10 {
        let pose = some_pose::<S>([0.2, -0.1, 0.3], &mut random);
        let half = [0.05, 0.03, 0.04].map(|h| h + around_zero(0.01, &mut random));
        let count = 5 + (unit(&mut random) * 10.0) as usize;
        // On an ellipsoid, up to one side.
        let contacts: Vec<reference::Contact> = (0..count)
            .map(|_| {
                let mut d = direction::<S>(&mut random);
                d.y = d.y.abs();
                let half = Point::from(half);
                let normal = d.component_div(&half).normalize();
                reference::Contact {
                    point: (pose * Point3::from(d.component_mul(&half))).coords,
                    normal: Some(pose.rotation * normal),
                    point_deviation: NOISE,
                    normal_deviation: 0.087,
                }
            })
            .collect();
        let mut tracker = start();
        tracker.prepare();
        tracker.reset(3);
        tracker.set_motion_noise(motion);
        let felt: Vec<Contact<S>> = contacts
            .iter()
            .map(|c| Contact {
                point: S::vector(&c.point),
                normal: c.normal.map(|n| S::vector(&n)),
                point_deviation: NOISE as f32,
                normal_deviation: 0.087,
                finger: 0,
            })
            .collect();
        tracker.update(None, GraspView { contacts: &felt, free: &[] });
        // The first grasp fixes the frame at its middle.
        let middle = contacts.iter().map(|c| c.point).sum::<Point>() / count as f64;
        let frame = Pose::from_parts(Translation3::from(middle), UnitQuaternion::identity());
        let placed: Vec<reference::Contact> =
            contacts.iter().map(|c| c.transformed(&frame.inverse())).collect();
        let kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 };
        let prior = reference::Prior::fitted(&placed).unwrap();
        let surface =
            reference::Gpis::fit(S::DIMENSION, kernel, prior, Training::Derivative, &placed)
                .unwrap();
        let touched: Vec<Point> = placed.iter().map(|c| c.point).collect();
        let truth = Foresight {
            dimension: S::DIMENSION,
            shape: Shape::Surface(&surface, &touched),
            pose: frame,
            covariance: covariance(S::DIMENSION, &Vector6::zeros(), motion),
            noise: NOISE,
        };
        let closings = closings::<S>(&frame, &mut random);
        errors.compare::<S>(&truth, &closings, |candidates, criterion| {
            tracker.choose(None, candidates, criterion, NOISE as f32).unwrap()
        });
    }
    errors.judge(&format!("map, {}D", S::DIMENSION), (0.004, 0.004));
}

#[test]
fn a_map_is_worth_what_the_reference_says() {
    same_worth_on_a_map::<Planar, _>(|| Box::new(PlanarTracker::new(Truncated::new())));
    same_worth_on_a_map::<Spatial, _>(|| Box::new(SpatialTracker::new(Truncated::new())));
}

/// Grasps, and after each of them what the board would do next by either criterion.
fn advice<S: Sample>(link: impl Link) -> (Vec<ChoiceFrame>, u32) {
    let log = S::log(4);
    let mut session = Session::<S, _>::open(link, Patience::default()).unwrap();
    session.configure(settings_for(&log, 7)).unwrap();
    let mut choices = Vec::new();
    let mut deepest = 0;
    for grasp in &log.grasps {
        let motion = grasp.motion.as_ref().map(S::pose);
        let contacts = track::contacts::<S>(grasp, &log.noise);
        session.grasp(motion.as_ref(), &contacts, &track::free_points::<S>(grasp)).unwrap();
        let candidates: Vec<Candidate<S>> = fixed(S::DIMENSION, &Point::new(0.005, 0.002, 0.0))
            .iter()
            .map(|p| Closing { hand: p.hand, strokes: p.strokes(S::DIMENSION, 0.06) }.candidate())
            .collect();
        for criterion in [Criterion::Information, Criterion::VarianceSum] {
            choices.push(session.choose(criterion, &candidates).unwrap());
        }
        deepest = session.health().unwrap().peak_stack;
    }
    (choices, deepest)
}

fn chooses_as_the_virtual_board<S: Sample>(tracker: TrackerKind) {
    let (here, _) = advice::<S>(virtual_board::start(S::DIMENSION, tracker).unwrap());
    assert!(here.iter().all(|c| c.considered == 10 && c.gain > 0.0 && c.contacts > 0), "{here:?}");
    let Some((_, emulated)) = board::<S>(Machine::Stm32f405, tracker) else { return };
    let (there, deepest) = advice::<S>(emulated);
    let bits = |c: &ChoiceFrame| (c.number, c.considered, c.contacts, c.gain.to_bits());
    assert_eq!(
        there.iter().map(bits).collect::<Vec<_>>(),
        here.iter().map(bits).collect::<Vec<_>>()
    );
    eprintln!("{tracker:?}, {}D: deepest stack {deepest} B", S::DIMENSION);
    assert!(deepest > 500 && deepest < 8 << 10, "{deepest}");
}

#[test]
fn hypotheses_choose_bit_for_bit_in_the_plane() {
    chooses_as_the_virtual_board::<Planar>(TrackerKind::Hypotheses);
}

#[test]
fn hypotheses_choose_bit_for_bit_in_space() {
    chooses_as_the_virtual_board::<Spatial>(TrackerKind::Hypotheses);
}

#[test]
fn maps_choose_bit_for_bit_in_the_plane() {
    chooses_as_the_virtual_board::<Planar>(TrackerKind::Bootstrap);
}

#[test]
fn maps_choose_bit_for_bit_in_space() {
    chooses_as_the_virtual_board::<Spatial>(TrackerKind::Bootstrap);
}
