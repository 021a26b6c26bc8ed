use std::boxed::Box;
use std::vec::Vec;

use super::*;
use crate::matrix::{Matrix, Square, Vector};
use crate::space::{Planar, PlanarPose, Pose};
use crate::track::{Modes, Status};

/// Foretells every grasp with the density per contact that it is told, and writes down what it learns.
#[derive(Clone, Debug, Default)]
struct Told {
    density: f32,
    evidence: f32,
    learnt: Vec<(Option<PlanarPose>, usize, usize)>,
}

impl Tracker<Planar> for Told {
    fn update(
        &mut self,
        motion: Option<&PlanarPose>,
        grasp: GraspView<'_, Planar>,
    ) -> Estimate<Planar> {
        let number = self.learnt.len() as u32;
        self.learnt.push((motion.copied(), grasp.contacts.len(), grasp.free.len()));
        let status = if number == 0 { Status::Started } else { Status::Tracking };
        if number > 0 {
            self.evidence += self.density * grasp.usable().count() as f32;
        }
        let pose = PlanarPose::new(Vector([self.density, 0.0]), 0.0);
        Estimate::after(number, &grasp, (pose, Matrix::<3>::ZERO), status, Modes::one(pose))
    }

    fn reset(&mut self, _seed: u64) {
        *self = Told { density: self.density, ..Told::default() };
    }

    fn set_motion_noise(&mut self, _noise: MotionNoise) {}
}

impl Evidence<Planar> for Told {
    fn evidence(&self) -> f32 {
        self.evidence
    }
}

type Both = Automatic<Planar, Told, Told, 8, 6>;

/// Both trackers, by what they give to each contact.
fn both(first: f32, second: f32) -> Box<Both> {
    let told = |density| Told { density, ..Told::default() };
    Box::new(Both::new(told(first), told(second)))
}

fn contact() -> Contact<Planar> {
    Contact {
        point: Vector([0.01, 0.02]),
        normal: Some(Vector([1.0, 0.0])),
        point_deviation: 1e-3,
        normal_deviation: 0.087,
        finger: 0,
    }
}

/// Grasps of so many contacts; the x of the estimates' poses.
fn felt(tracker: &mut Both, contacts: &[usize]) -> Vec<f32> {
    let known = tracker.first().learnt.len();
    let one = |(number, count): (usize, &usize)| {
        let motion = PlanarPose::new(Vector([number as f32, 0.0]), 0.0);
        let contacts: Vec<_> = (0..*count).map(|_| contact()).collect();
        let grasp = GraspView { contacts: &contacts, free: &[] };
        tracker.update((number > 0).then_some(&motion), grasp).pose.translation()[0]
    };
    contacts.iter().enumerate().map(|(k, c)| (known + k, c)).map(one).collect()
}

/// The density per contact of a surface and a pose that are known: 5.5 for the distance, 1 for the angle.
const KNOWN: f32 = 6.5;

#[test]
fn nobody_learns_twice_what_one_foretells() {
    let mut tracker = both(KNOWN - 2.0, KNOWN);
    assert_eq!(felt(&mut tracker, &[5; 7]), [KNOWN - 2.0; 7]);
    assert_eq!(
        (tracker.learning(), tracker.second().learnt.len()),
        (Learning::FirstUntilItFails, 0)
    );
    // Memory is full: the second will not be needed.
    felt(&mut tracker, &[5; 9]);
    assert_eq!((tracker.learning(), tracker.second().learnt.len()), (Learning::First, 0));
    tracker.reset(0);
    assert_eq!(tracker.learning(), Learning::FirstUntilItFails);
    // Empty grasps foretell nothing, and nothing speaks against whom.
    felt(&mut tracker, &[5, 0, 0, 0, 0]);
    assert_eq!(
        (tracker.learning(), tracker.second().learnt.len()),
        (Learning::FirstUntilItFails, 0)
    );
}

#[test]
fn empty_grasps_do_not_make_the_second_needless() {
    let mut tracker = both(KNOWN - 3.3, KNOWN - 1.0);
    // The hand closes on nothing until memory is full but for two grasps.
    felt(&mut tracker, &[0, 0, 0, 0, 0, 0, 5, 5]);
    assert_eq!(tracker.learning(), Learning::Both);
    assert_eq!(tracker.second().learnt, tracker.first().learnt);
    assert_eq!(felt(&mut tracker, &[5]), [KNOWN - 1.0]);
    // Half of them are enough.
    let mut tracker = both(KNOWN, KNOWN);
    felt(&mut tracker, &[0, 0, 0, 0, 5, 5, 5, 5]);
    assert_eq!((tracker.learning(), tracker.second().learnt.len()), (Learning::First, 0));
}

#[test]
fn who_waited_learns_all_grasps_in_order() {
    let mut tracker = both(KNOWN - 3.3, KNOWN - 1.0);
    // 4 nats too little at every grasp after the first: more than ten at the third of them.
    assert_eq!(felt(&mut tracker, &[5; 3]), [KNOWN - 3.3; 3]);
    assert_eq!(tracker.second().learnt.len(), 0);
    assert_eq!(felt(&mut tracker, &[5]), [KNOWN - 1.0]);
    assert_eq!(tracker.learning(), Learning::Both);
    assert_eq!(tracker.second().learnt, tracker.first().learnt);
    assert!((tracker.advantage() - 15.0 * 2.3).abs() < 1e-3, "{}", tracker.advantage());
    assert_eq!((tracker.meant(), tracker.evidence()), (Meant::Second, tracker.second().evidence()));
    // Fifty nats behind, the first learns no more.
    felt(&mut tracker, &[5, 5]);
    assert_eq!((tracker.learning(), tracker.first().learnt.len()), (Learning::Second, 6));
    assert_eq!(felt(&mut tracker, &[5, 5]), [KNOWN - 1.0; 2]);
    assert_eq!((tracker.first().learnt.len(), tracker.second().learnt.len()), (6, 8));
}

#[test]
fn good_grasps_make_up_for_a_bad_one() {
    let mut tracker = both(KNOWN, KNOWN);
    felt(&mut tracker, &[5]);
    for _ in 0..3 {
        tracker.first_mut().density = KNOWN - 4.0;
        felt(&mut tracker, &[5]);
        tracker.first_mut().density = KNOWN - 0.5;
        felt(&mut tracker, &[5]);
    }
    assert_eq!(tracker.learning(), Learning::FirstUntilItFails);
    tracker.first_mut().density = f32::NAN;
    felt(&mut tracker, &[5]);
    assert_eq!((tracker.learning(), tracker.second().learnt.len()), (Learning::Both, 8));
}

#[test]
fn who_is_behind_is_left_and_a_large_grasp_is_not_kept() {
    // Seven contacts find no room, so both learn at once.
    let mut tracker = both(KNOWN, KNOWN - 5.0);
    assert_eq!(felt(&mut tracker, &[5, 7]), [KNOWN; 2]);
    assert_eq!((tracker.learning(), tracker.second().learnt.len()), (Learning::Both, 2));
    assert_eq!(tracker.second().learnt, tracker.first().learnt);
    felt(&mut tracker, &[5, 5, 5]);
    assert_eq!((tracker.learning(), tracker.second().learnt.len()), (Learning::First, 3));
}

#[test]
fn a_vague_contact_where_it_is_expected_is_not_wild() {
    for point_deviation in [1e-9, 1e-3, 9.9e-3] {
        let wild = wild(&Contact { point_deviation, ..contact() });
        assert_eq!(wild, 2.120_263_5 - 1.837_877_1);
    }
    for point_deviation in [0.02, 0.1, 1e6] {
        let bare = [Contact { point_deviation, normal: None, ..contact() }];
        let exact = all_short_by(&GraspView { contacts: &bare, free: &[] }, 0..1, 0.0);
        assert!((exact - wild(&bare[0]) - 1.566).abs() < 1e-3, "{point_deviation}");
    }
}
