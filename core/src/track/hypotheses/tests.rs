use super::*;
use crate::contact::Contact;
use crate::matrix::Vector;
use crate::random::Random;
use crate::space::{Planar, PlanarPose, Spatial, SpatialPose};
use crate::surface::cholesky::packed;
use std::boxed::Box;
use std::vec::Vec;

mod carried;

type Plane2 = Hypotheses<Planar, 8, 12, 27, { packed(27) }, 16>;
type Space3 = Hypotheses<Spatial, 4, 10, 36, { packed(36) }, 4>;

/// A convex polygon: outward normal angles and offsets, in order.
struct Polygon(Vec<(f32, f32)>);

impl Polygon {
    fn regular(sides: usize, apothem: f32) -> Self {
        let turn = core::f32::consts::TAU / sides as f32;
        Polygon((0..sides).map(|k| (turn * k as f32, apothem)).collect())
    }

    fn rectangle(x: f32, y: f32) -> Self {
        let quarter = core::f32::consts::FRAC_PI_2;
        Polygon((0..4).map(|k| (quarter * k as f32, if k % 2 == 0 { x } else { y })).collect())
    }

    fn corner(&self, k: usize) -> Vector<2> {
        let ((a, p), (b, q)) = (self.0[k], self.0[(k + 1) % self.0.len()]);
        let determinant = (b - a).sin();
        Vector([p * b.sin() - q * a.sin(), q * a.cos() - p * b.cos()]) * (1.0 / determinant)
    }

    /// The point at a share of a side, and the normal.
    fn at(&self, side: usize, share: f32) -> (Vector<2>, Vector<2>) {
        let n = self.0.len();
        let (from, to) = (self.corner((side + n - 1) % n), self.corner(side));
        let (sin, cos) = self.0[side].0.sin_cos();
        (from + (to - from) * share, Vector([cos, sin]))
    }

    /// Five touches around from `side`, with the noise of 1 mm and 5°.
    fn grasp(&self, pose: &PlanarPose, side: usize, random: &mut Random) -> Vec<Contact<Planar>> {
        let n = self.0.len();
        // Three sides that are neighbours, and the one across.
        let sides = [side % n, side % n, (side + 1) % n, (side + 2) % n, (side + n / 2) % n];
        let touch = |side: usize| {
            let (point, normal) = self.at(side, 0.1 + 0.8 * random.uniform());
            let (a, b) = random.normal_pair();
            let (sin, cos) = (0.0873 * a).sin_cos();
            let noisy =
                Vector([cos * normal[0] - sin * normal[1], sin * normal[0] + cos * normal[1]]);
            contact(pose.transform(point + normal * (1e-3 * b)), pose.rotate(noisy))
        };
        sides.map(touch).into_iter().collect()
    }
}

fn contact(point: Vector<2>, normal: Vector<2>) -> Contact<Planar> {
    Contact {
        point,
        normal: Some(normal),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
        finger: 0,
    }
}

fn view<S: Space>(contacts: &[Contact<S>]) -> GraspView<'_, S> {
    GraspView { contacts, free: &[] }
}

/// Translation (metres) and rotation (radians) from the truth, the frames made equal at `gauge`; a
/// rotation by a whole part of a turn does not count.
fn error(pose: &PlanarPose, truth: &PlanarPose, gauge: &PlanarPose, symmetry: f32) -> [f32; 2] {
    let off = truth.compose(gauge).local(pose);
    let part = core::f32::consts::TAU / symmetry;
    let centre = (truth.transform(Vector::ZERO)
        - pose.compose(&gauge.inverse()).transform(Vector::ZERO))
    .norm();
    [centre, (off[2] - part * (off[2] / part).round()).abs()]
}

/// Turns by 22.5° a grasp, each with noise of 10 mm and 20°; the last error, and what was estimated.
fn follow(
    polygon: &Polygon,
    seed: u64,
    spoil: impl Fn(usize, &mut Vec<Contact<Planar>>, &mut Random),
) -> (PlanarPose, PlanarPose, PlanarPose, Vec<Estimate<Planar>>, Box<Plane2>) {
    let mut random = Random::new(seed);
    let mut tracker = Box::new(Plane2::new());
    let mut truth = PlanarPose::new(Vector([0.2, -0.1]), 0.3);
    let mut estimates = Vec::new();
    let mut gauge = PlanarPose::IDENTITY;
    for k in 0..16 {
        let meant = PlanarPose::new(truth.translation, core::f32::consts::FRAC_PI_8)
            .compose(&PlanarPose::new(truth.translation, 0.0).inverse());
        let motion = (k > 0).then_some(meant);
        if let Some(motion) = motion {
            truth = MotionNoise::THESIS.disturb::<Planar>(&motion.compose(&truth), &mut random);
        }
        let mut contacts = polygon.grasp(&truth, k, &mut random);
        spoil(k, &mut contacts, &mut random);
        let estimate = tracker.update(motion.as_ref(), view(&contacts));
        if k == 0 {
            gauge = truth.inverse().compose(&estimate.pose);
        }
        estimates.push(estimate);
    }
    let pose = estimates[15].pose;
    (pose, truth, gauge, estimates, tracker)
}

#[test]
fn follows_polygons_at_full_noise() {
    let cases = [
        (Polygon::rectangle(0.05, 0.03), 2.0, 4),
        (Polygon::regular(3, 0.025), 3.0, 3),
        (Polygon::regular(6, 0.04), 6.0, 6),
    ];
    for (polygon, symmetry, faces) in &cases {
        for seed in 0..6 {
            let (pose, truth, gauge, estimates, tracker) = follow(polygon, seed, |_, _, _| ());
            let [translation, rotation] = error(&pose, &truth, &gauge, *symmetry);
            assert!(translation < 6e-3 && rotation < 0.12, "{seed} {translation} {rotation}");
            assert_eq!(tracker.faces().filter(|f| f.contacts > 2).count(), *faces);
            assert!(tracker.faces().all(|f| !f.reentrant && f.variance > 0.0));
            assert!(estimates[1..].iter().all(|e| e.corrected && e.covariance.is_finite()));
            assert!(estimates.iter().all(|e| e.status != Status::Lost));
        }
    }
}

#[test]
fn one_wild_contact_in_ten_neither_moves_the_pose_nor_stays_in_the_map() {
    let polygon = Polygon::rectangle(0.05, 0.03);
    for seed in 0..6 {
        let (pose, truth, gauge, _, tracker) = follow(&polygon, seed, |k, contacts, random| {
            if k % 2 == 1 {
                let (a, b) = random.normal_pair();
                contacts[k % 5].point += Vector([0.02 * a, 0.02 * b]);
                let (sin, cos) = (6.3 * random.uniform()).sin_cos();
                contacts[k % 5].normal = Some(Vector([cos, sin]));
            }
        });
        let [translation, rotation] = error(&pose, &truth, &gauge, 2.0);
        assert!(translation < 6e-3 && rotation < 0.0873, "{seed}: {translation} {rotation}");
        let firm: Vec<_> = tracker.faces().filter(|f| f.contacts > 4).collect();
        assert_eq!(firm.len(), 4, "{firm:?}");
    }
}

#[test]
fn later_grasps_teach_about_earlier_poses() {
    let (pose, _, _, estimates, tracker) = follow(&Polygon::rectangle(0.05, 0.03), 3, |_, _, _| ());
    assert_eq!(tracker.recall(15), Some(pose));
    assert_eq!(tracker.recall(16), None);
    let moved = |k: usize| {
        let now = tracker.recall(k as u32).unwrap();
        (now.translation - estimates[k].pose.translation).norm()
    };
    assert!((0..15).any(|k| moved(k) > 0.0) && (0..15).all(|k| moved(k) < 0.03));
}

#[test]
fn unknown_motion_is_found_by_touch() {
    let polygon = Polygon::rectangle(0.05, 0.03);
    let mut random = Random::new(5);
    let mut tracker = Box::new(Plane2::new());
    let mut truth = PlanarPose::new(Vector([0.1, 0.0]), 0.0);
    let mut gauge = PlanarPose::IDENTITY;
    for k in 0..10 {
        let contacts = polygon.grasp(&truth, k, &mut random);
        let estimate = tracker.update(None, view(&contacts));
        if k == 0 {
            gauge = truth.inverse().compose(&estimate.pose);
        }
        let [translation, rotation] = error(&estimate.pose, &truth, &gauge, 2.0);
        assert!(translation < 6e-3 && rotation < 0.1, "{k}: {translation} {rotation}");
        truth = truth.retract(Vector([0.012, -0.008, 0.4]));
    }
}

#[test]
fn a_lost_object_leaves_the_map_alone_and_is_found_again() {
    let polygon = Polygon(std::vec![(0.0, 0.05), (1.2, 0.03), (2.9, 0.04), (4.3, 0.035)]);
    let mut random = Random::new(1);
    let mut tracker = Box::new(Plane2::new());
    let truth = PlanarPose::new(Vector([0.1, 0.0]), 0.0);
    let mut gauge = PlanarPose::IDENTITY;
    for k in 0..8 {
        let estimate = tracker.update(None, view(&polygon.grasp(&truth, k, &mut random)));
        if k == 0 {
            gauge = truth.inverse().compose(&estimate.pose);
        }
    }
    let known: Vec<_> = tracker.faces().map(|f| (f.normal, f.offset, f.contacts)).collect();
    assert_eq!(known.len(), 4);
    // Somebody took it: turned by 140° and 15 cm away. The hand meets something else first.
    let elsewhere = PlanarPose::new(Vector([0.25, 0.02]), 2.44);
    let rest = PlanarPose::IDENTITY;
    let estimate = tracker.update(Some(&rest), view(&something_else()));
    assert_eq!(estimate.status, Status::Lost);
    assert!(!estimate.corrected);
    let still: Vec<_> = tracker.faces().map(|f| (f.normal, f.offset, f.contacts)).collect();
    assert_eq!(known, still);
    let mut last = estimate;
    for k in 1..5 {
        last = tracker.update(Some(&rest), view(&polygon.grasp(&elsewhere, k, &mut random)));
    }
    assert!(matches!(last.status, Status::Tracking | Status::Ambiguous), "{:?}", last.status);
    let [translation, rotation] = error(&last.pose, &elsewhere, &gauge, 1.0);
    assert!(translation < 6e-3 && rotation < 0.1, "{translation} {rotation}");
}

#[test]
fn two_fingers_find_a_lost_object_again_and_one_does_not() {
    let (polygon, lost, elsewhere) = known_quadrilateral();
    let rest = Some(&PlanarPose::IDENTITY);
    for fingers in [1, 2] {
        let (mut tracker, mut random) = (lost.clone(), Random::new(1));
        let mut grasp = |k: usize| polygon.grasp(&elsewhere, k, &mut random);
        assert_eq!(tracker.update(rest, view(&something_else())).status, Status::Lost);
        let found = (1..12).any(|k| {
            let status = tracker.update(rest, view(&grasp(k)[..fingers])).status;
            matches!(status, Status::Tracking | Status::Ambiguous)
        });
        assert_eq!(found, fingers == 2);
    }
}

#[test]
fn a_finger_inside_a_whole_map_is_evidence() {
    // A square seen from two opposite sides may slide along them; a finger that met nothing says how
    // far.
    let square = Polygon::rectangle(0.03, 0.03);
    let mut random = Random::new(2);
    let mut tracker = Box::new(Plane2::new());
    let truth = PlanarPose::IDENTITY;
    for k in 0..6 {
        tracker.update(None, view(&square.grasp(&truth, k, &mut random)));
    }
    let pose = tracker.update(None, view(&[])).pose;
    let sides = [(0, 0.3), (0, 0.7), (2, 0.3), (2, 0.6)].map(|(side, share)| {
        let (point, normal) = square.at(side, share);
        contact(truth.transform(point), truth.rotate(normal))
    });
    let free = [crate::contact::FreePoint { point: Vector([0.0, 0.024]), finger: 0 }];
    let mut other = tracker.clone();
    let without = tracker.update(None, view(&sides)).pose;
    let with = other.update(None, GraspView { contacts: &sides, free: &free }).pose;
    assert!(pose.is_finite());
    let slid = pose.unrotate(with.translation - without.translation);
    assert!(slid[1] < -2e-3, "{slid:?}");
}

#[test]
fn bad_contacts_are_counted_and_empty_grasps_only_predict() {
    let mut tracker = Box::new(Plane2::new());
    let square = Polygon::rectangle(0.03, 0.03);
    let mut random = Random::new(0);
    let empty = tracker.update(None, view(&[]));
    assert!(empty.status == Status::Started && empty.pose == PlanarPose::IDENTITY);
    let mut contacts = square.grasp(&PlanarPose::IDENTITY, 0, &mut random);
    contacts[0].point[1] = f32::NAN;
    contacts[1].normal = Some(Vector([2.0, 0.0]));
    contacts[2].point_deviation = f32::INFINITY;
    let first = tracker.update(None, view(&contacts));
    assert_eq!((first.contacts, first.rejected, first.status), (2, 3, Status::Started));
    let bad = PlanarPose::new(Vector([f32::NAN, 0.0]), 0.0);
    let second = tracker.update(Some(&bad), view(&[]));
    assert!(second.status == Status::Predicted && second.pose.is_finite());
    assert!(second.covariance.at(0, 0) > 1e-4 && !second.corrected);
}

#[test]
fn contacts_without_normals_correct_but_open_no_face() {
    let square = Polygon::rectangle(0.04, 0.03);
    let mut random = Random::new(4);
    let mut tracker = Box::new(Plane2::new());
    tracker.configure(Settings {
        motion: MotionNoise { translation: 5e-3, rotation: 0.1 },
        ..Settings::DEFAULT
    });
    for k in 0..4 {
        tracker.update(None, view(&square.grasp(&PlanarPose::IDENTITY, k, &mut random)));
    }
    let before = tracker.faces().count();
    let moved = PlanarPose::new(Vector([0.004, -0.003]), 0.08);
    let mut contacts = square.grasp(&moved, 1, &mut random);
    let gauge = tracker.update(None, view(&[])).pose;
    contacts.iter_mut().for_each(|c| c.normal = None);
    let estimate = tracker.update(None, view(&contacts));
    let [translation, rotation] = error(&estimate.pose, &moved, &gauge, 2.0);
    assert!(estimate.corrected && translation < 4e-3 && rotation < 0.1, "{translation} {rotation}");
    assert_eq!(tracker.faces().count(), before);
    let mut blind = Box::new(Plane2::new());
    blind.update(None, view(&contacts));
    assert_eq!(blind.update(None, view(&contacts)).status, Status::Predicted);
}

#[test]
fn capacity_is_an_ordinary_event() {
    // Four faces for a hexagon, two hypotheses, two poses remembered, and 40 contacts in a grasp.
    let mut tracker = Hypotheses::<Planar, 2, 4, 11, { packed(11) }, 2>::new();
    let hexagon = Polygon::regular(6, 0.04);
    let mut random = Random::new(9);
    for k in 0..6 {
        let many: Vec<_> =
            (0..8).flat_map(|i| hexagon.grasp(&PlanarPose::IDENTITY, k + i, &mut random)).collect();
        let estimate = tracker.update(None, view(&many));
        assert!(estimate.pose.is_finite() && estimate.contacts == 40);
    }
    assert!(tracker.faces().count() <= 4);
    assert!(tracker.recall(5).is_some() && tracker.recall(4).is_some());
    assert_eq!(tracker.recall(3), None);
}

#[test]
fn every_run_is_the_same_to_the_bit() {
    let run = || follow(&Polygon::regular(6, 0.04), 11, |_, _, _| ()).3;
    assert_eq!(run(), run());
    let mut tracker = Box::new(Plane2::new());
    let contacts = Polygon::regular(5, 0.03).grasp(&PlanarPose::IDENTITY, 0, &mut Random::new(1));
    let first = tracker.update(None, view(&contacts));
    tracker.update(None, view(&contacts));
    tracker.reset(7);
    assert_eq!(tracker.update(None, view(&contacts)), first);
}

/// Eight touches on a box of 120 × 80 × 60 mm, all faces but one.
fn touch_box(pose: &SpatialPose, skip: usize, random: &mut Random) -> Vec<Contact<Spatial>> {
    let half = [0.06, 0.04, 0.03];
    let mut contacts = Vec::new();
    for face in (0..6).filter(|f| *f != skip % 6) {
        let (axis, sign) = (face / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
        let mut point = Vector::<3>::from_fn(|i| half[i] * (1.6 * random.uniform() - 0.8));
        let mut normal = Vector::<3>::ZERO;
        (point[axis], normal[axis]) = (sign * half[axis], sign);
        let noise: Vector<3> = random.normal();
        let turn: Vector<3> = random.normal();
        let tilted = (normal + turn * 0.0873).normalized().unwrap();
        contacts.push(Contact {
            point: pose.transform(point + noise * 1e-3),
            normal: Some(pose.rotate(tilted)),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
            finger: 0,
        });
    }
    contacts
}

#[test]
fn follows_a_box_in_space() {
    for seed in 0..2 {
        let mut random = Random::new(seed);
        let mut tracker = Box::new(Space3::new());
        let noise = MotionNoise { translation: 0.01, rotation: 0.2 };
        tracker.configure(Settings { motion: noise, beam: 8, ..Settings::DEFAULT });
        let mut truth = SpatialPose::new(Vector([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3, 0.9]);
        let mut gauge = SpatialPose::IDENTITY;
        for k in 0..10 {
            if k > 0 {
                truth = noise.disturb::<Spatial>(&truth, &mut random);
            }
            let motion = SpatialPose::IDENTITY;
            let estimate = tracker.update(Some(&motion), view(&touch_box(&truth, k, &mut random)));
            if k == 0 {
                gauge = truth.inverse().compose(&estimate.pose);
            }
            let off = truth.compose(&gauge).local(&estimate.pose);
            let shift = Vector([off[0], off[1], off[2]]).norm();
            let turn = Vector([off[3], off[4], off[5]]).norm();
            // The frame of the first grasp is only as sure as its contacts.
            assert!(shift < 0.02 && turn < 0.2, "{seed} {k}: {shift} {turn}");
        }
        assert_eq!(tracker.faces().filter(|f| f.contacts > 2).count(), 6);
    }
}

#[test]
fn boards_have_room() {
    let sizes = [
        size_of::<crate::device::PlanarHypotheses>(),
        size_of::<crate::device::SpatialHypotheses>(),
        size_of::<Hypotheses<Planar, 12, 12, 27, { packed(27) }, 0>>(),
    ];
    let most = [12, 25, 36].map(|kilobytes| kilobytes * 1024);
    assert!(sizes.iter().zip(most).all(|(size, most)| *size <= most), "{sizes:?}");
}

#[test]
fn contacts_of_an_ideal_sensor_leave_no_negative_variance() {
    let square = Polygon::rectangle(0.05, 0.03);
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let mut tracker = Box::new(Plane2::new());
        for k in 0..30 {
            let pose = match k {
                0 => PlanarPose::IDENTITY,
                _ => PlanarPose::IDENTITY.retract(random.normal::<Vector<3>>() * 0.01),
            };
            let touch = |side, share| {
                let (point, normal) = square.at(side, share);
                let exact = contact(pose.transform(point), pose.rotate(normal));
                Contact { point_deviation: 1e-6, normal_deviation: 1e-3, ..exact }
            };
            let contacts: Vec<_> =
                (0..8).map(|i| touch(i / 2, 0.1 + 0.8 * random.uniform())).collect();
            let estimate = tracker.update(None, view(&contacts));
            let variances = [0, 1, 2].map(|i| estimate.covariance.at(i, i));
            assert!(variances.iter().all(|v| *v >= 0.0), "{seed}, {k}: {variances:?}");
            assert_ne!(estimate.status, Status::Lost, "{seed}, {k}");
        }
    }
}

#[test]
fn free_fingers_count_once_however_many_contacts_there_are() {
    let square = Polygon::rectangle(0.03, 0.03);
    let mut random = Random::new(2);
    let mut tracker = Box::new(Plane2::new());
    for k in 0..6 {
        tracker.update(None, view(&square.grasp(&PlanarPose::IDENTITY, k, &mut random)));
    }
    tracker.update(None, view(&[]));
    tracker.set_motion_noise(MotionNoise { translation: 0.0, rotation: 0.0 });
    // As many as are explained together, twice.
    let sides: Vec<_> = (0..2 * TOUCHES)
        .map(|i| square.at(2 * (i % 2), 0.3 + 0.01 * i as f32))
        .map(|(point, normal)| contact(point, normal))
        .collect();
    let free = [crate::contact::FreePoint { point: Vector([0.0, 0.024]), finger: 0 }];
    let rest = Some(&PlanarPose::IDENTITY);
    let mut other = tracker.clone();
    let at_once = tracker.update(rest, GraspView { contacts: &sides, free: &free }).pose;
    other.update(rest, GraspView { contacts: &sides[..TOUCHES], free: &free });
    let in_turn = other.update(rest, view(&sides[TOUCHES..])).pose;
    assert!(at_once.local(&in_turn).norm() < 1e-5, "{at_once:?} {in_turn:?}");
}

/// A quadrilateral that is known, at rest at the origin, and where somebody took it then.
fn known_quadrilateral() -> (Polygon, Box<Plane2>, PlanarPose) {
    let polygon = Polygon(std::vec![(0.0, 0.05), (1.2, 0.03), (2.9, 0.04), (4.3, 0.035)]);
    let mut random = Random::new(5);
    let mut tracker = Box::new(Plane2::new());
    tracker.set_motion_noise(MotionNoise { translation: 1e-3, rotation: 0.035 });
    for k in 0..8 {
        let at = PlanarPose::IDENTITY;
        tracker.update(Some(&at), view(&polygon.grasp(&at, k, &mut random)));
    }
    (polygon, tracker, PlanarPose::new(Vector([0.15, 0.02]), 2.44))
}

/// Five touches of a star that is nowhere like the quadrilateral.
fn something_else() -> [Contact<Planar>; 5] {
    [0.3f32, 0.7, 1.1, 1.5, 1.9].map(|angle| {
        let (sin, cos) = angle.sin_cos();
        let (across, along) = (3.0 * angle).sin_cos();
        contact(Vector([0.2 + 0.08 * cos, 0.08 * sin]), Vector([along, across]))
    })
}

/// Exact contacts all around.
fn all_around(polygon: &Polygon, count: usize, pose: &PlanarPose) -> Vec<Contact<Planar>> {
    let sides = polygon.0.len();
    (0..count)
        .map(|i| polygon.at(i % sides, 0.2 + 0.6 * i as f32 / count as f32))
        .map(|(p, n)| contact(pose.transform(p), pose.rotate(n)))
        .collect()
}

#[test]
fn the_rest_of_a_large_grasp_is_where_a_lost_object_was_found_again() {
    let (polygon, mut tracker, elsewhere) = known_quadrilateral();
    let rest = Some(&PlanarPose::IDENTITY);
    let recalled = tracker.recall(7).unwrap();
    assert_eq!(tracker.update(rest, view(&something_else())).status, Status::Lost);
    let contacts = all_around(&polygon, 2 * TOUCHES, &elsewhere);
    let mut other = tracker.clone();
    let at_once = tracker.update(rest, view(&contacts));
    assert_eq!((at_once.status, at_once.dropped), (Status::Tracking, 0));
    other.update(rest, view(&contacts[..TOUCHES]));
    other.set_motion_noise(MotionNoise { translation: 0.0, rotation: 0.0 });
    let in_turn = other.update(rest, view(&contacts[TOUCHES..]));
    assert!(at_once.pose.local(&in_turn.pose).norm() < 1e-5, "{at_once:?} {in_turn:?}");
    // Where it was before it was taken away is known as well as before.
    let since = tracker.recall(7).unwrap();
    assert!(recalled.local(&since).norm() < 1e-3, "{recalled:?} {since:?}");
}

#[test]
fn what_nobody_explains_of_a_large_grasp_is_dropped() {
    let (polygon, mut tracker, elsewhere) = known_quadrilateral();
    let mut contacts = all_around(&polygon, TOUCHES, &PlanarPose::IDENTITY);
    contacts.extend(polygon.grasp(&elsewhere, 0, &mut Random::new(1)));
    let estimate = tracker.update(Some(&PlanarPose::IDENTITY), view(&contacts));
    assert_eq!((estimate.status, estimate.dropped), (Status::Tracking, 5));
}

#[test]
fn a_normal_into_a_face_is_not_one_out_of_it() {
    let plane = |normal| plane::Plane::<Planar> { normal, offset: 0.05 };
    let touch = plane::Touch::of(&contact(Vector([0.05, 0.0]), Vector([1.0, 0.0])));
    let (pose, transport) = (PlanarPose::IDENTITY, <Planar as Space>::Covariance::ZERO);
    let residual =
        |normal| plane::measure(&touch, &pose, &transport, &plane(normal)).as_slice()[0].residual;
    assert!(residual(Vector([1.0, 0.0])).abs() < 1e-6);
    assert!((residual(Vector([-1.0, 0.0])).abs() - core::f32::consts::PI).abs() < 1e-6);
}

#[test]
fn contacts_without_room_in_the_first_grasp_are_no_loss() {
    let polygon = Polygon::regular(16, 0.05);
    let mut tracker = Box::new(Plane2::new());
    let rest = Some(&PlanarPose::IDENTITY);
    let all = all_around(&polygon, 2 * TOUCHES, &PlanarPose::IDENTITY);
    assert_eq!(tracker.update(rest, view(&all)).status, Status::Started);
    let next = tracker.update(rest, view(&all[..6]));
    assert!(matches!(next.status, Status::Tracking | Status::Ambiguous), "{:?}", next.status);
}

#[test]
fn a_shift_of_which_nothing_is_known_leaves_single_precision_its_digits() {
    let (polygon, mut tracker, _) = known_quadrilateral();
    tracker.set_motion_noise(MotionNoise { translation: 1000.0, rotation: 0.1 });
    let gauge = tracker.recall(0).unwrap();
    let here = PlanarPose::new(Vector([0.02, -0.01]), 0.1);
    let exact = all_around(&polygon, 8, &here);
    let rest = Some(&PlanarPose::IDENTITY);
    let estimate = tracker.update(rest, view(&exact));
    let [translation, rotation] = error(&estimate.pose, &here, &gauge, 1.0);
    assert!(translation < 3e-3 && rotation < 0.06, "{translation} {rotation} {estimate:?}");
    for i in 0..3 {
        assert!(estimate.covariance.at(i, i) > 0.0, "{:?}", estimate.covariance);
    }
}
