use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::contact::{Contact, GraspView};
use crate::device::{Onboard, PlanarHypotheses, PlanarTracker, SpatialHypotheses, SpatialTracker};
use crate::math;
use crate::matrix::{Coordinates, Vector};
use crate::space::{Planar, PlanarPose, Spatial, SpatialPose};
use crate::surface::{Map, Truncated};
use crate::track::hypotheses::ToldFace;
use crate::track::{Bootstrap, Hypotheses, MotionNoise, Tracker};
use crate::wire::WireSpace;

const NOISE: f32 = 1e-3;
const STEADY: MotionNoise = MotionNoise { translation: 1e-3, rotation: 0.02 };

fn contact<S: Space>(point: S::Vector, normal: S::Vector) -> Contact<S> {
    let (point_deviation, normal_deviation) = (NOISE, 0.087);
    Contact { point, normal: Some(normal), point_deviation, normal_deviation, finger: 0 }
}

/// A slab felt above and below (±20 mm along y) between x = −15 mm and 15 mm.
fn slab<S: WireSpace, T: Onboard<S>>(tracker: &mut T, noise: MotionNoise) {
    tracker.prepare();
    tracker.set_motion_noise(noise);
    tracker.reset(1);
    let felt: Vec<Contact<S>> = [-1.0, 1.0]
        .into_iter()
        .flat_map(|side| [-0.015, 0.0, 0.015].map(|x| (x, side)))
        .map(|(x, side)| {
            let at = |i| if i == 0 { x } else { f32::from(u8::from(i == 1)) * 0.02 * side };
            let n = |i| f32::from(u8::from(i == 1)) * side;
            contact(S::Vector::from_fn(at), S::Vector::from_fn(n))
        })
        .collect();
    tracker.update(None, GraspView { contacts: &felt, free: &[] });
}

/// A stroke from `start` along `direction` (its length is its travel), the rest of their coordinates 0.
fn stroke<S: Space>(start: [f32; 2], direction: [f32; 2]) -> Stroke<S> {
    let vector = |v: [f32; 2]| S::Vector::from_fn(|i| if i < 2 { v[i] } else { 0.0 });
    let (start, way) = (vector(start), vector(direction));
    Stroke { start, direction: way.normalized().unwrap(), travel: way.norm() }
}

fn hand<S: Space>(strokes: &[Stroke<S>]) -> Candidate<S> {
    let mut candidate = Candidate::new(S::Pose::IDENTITY);
    for (place, stroke) in candidate.strokes.iter_mut().zip(strokes) {
        *place = Some(*stroke);
    }
    candidate.checked().unwrap()
}

fn gain<S: Space, F: Foresight<S>>(belief: &mut F, strokes: &[Stroke<S>]) -> f32 {
    worth(belief, &hand(strokes), Criterion::Information, NOISE).0
}

#[test]
fn independent_contacts_add_up() {
    let mut doubts = Doubts::NONE;
    for i in 0..3 {
        doubts.all[i][i] = 8e-6;
        doubts.pose[i][i] = 1e-6;
    }
    // ½ ln((1 + 8)/(1 + 1)) of each.
    let each = 0.5 * math::ln(4.5);
    let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} {b}");
    close(doubts.information(&[1.0; 3], NOISE), 3.0 * each);
    close(doubts.information(&[0.25, 0.0, 0.5], NOISE), 0.75 * each);
    close(doubts.information(&[], NOISE), 0.0);
    close(1e6 * doubts.variance_sum(&[1.0, 0.5, 0.0]), 7.0 + 3.5);
    // The same thing said thrice is hardly more than once.
    let same = Doubts { all: [[8e-6; FINGERS]; FINGERS], ..Doubts::NONE };
    close(same.information(&[1.0; 3], NOISE), 0.5 * math::ln(25.0));
    close(same.likely(0, 0.0), 0.5);
    assert!(same.likely(0, 0.02) > 0.999_99 && Doubts::NONE.likely(0, 1e-4) > 0.999_99);
}

proptest! {
    #[test]
    fn what_is_known_of_the_pose_never_makes_a_grasp_worth_less(
        surface in proptest::array::uniform5(proptest::array::uniform5(-2e-2f32..2e-2)),
        pose in proptest::array::uniform5(proptest::array::uniform3(-2e-2f32..2e-2)),
        chances in proptest::array::uniform5(0.0f32..1.0),
    ) {
        let mut doubtful = Doubts::NONE;
        let mut certain = Doubts::NONE;
        for i in 0..FINGERS {
            for j in 0..FINGERS {
                let shape: f32 = (0..FINGERS).map(|k| surface[i][k] * surface[j][k]).sum();
                let moved: f32 = (0..3).map(|k| pose[i][k] * pose[j][k]).sum();
                (doubtful.all[i][j], doubtful.pose[i][j]) = (shape + moved, moved);
                certain.all[i][j] = shape;
            }
        }
        let (a, b) = (certain.information(&chances, NOISE), doubtful.information(&chances, NOISE));
        prop_assert!(b >= -1e-3 && b <= a + 1e-2, "{a} {b}");
        // Nor does another contact.
        let mut fewer = chances;
        fewer[2] = 0.0;
        prop_assert!(doubtful.information(&fewer, NOISE) <= b + 1e-2);
    }
}

fn sees_what_was_touched_and_what_was_not<S, F>(belief: &mut F)
where
    S: Space,
    F: Foresight<S>,
{
    let above = |x: f32| stroke::<S>([x, 0.1], [0.0, -0.12]);
    let met = belief.meet(&above(0.0)).unwrap();
    assert!((met.point[1] - 0.02).abs() < 1e-3 && met.normal[1] > 0.99, "{:?}", met.point);
    assert!(met.depth > 0.01 && met.share > 0.99);
    // Where nothing was felt there is more to learn, the more the further.
    let [known, near, far] = [0.0, 0.022, 0.032].map(|x| gain(belief, &[above(x)]));
    assert!(known >= 0.0 && known < 0.5 * near && near < far, "{known} {near} {far}");
    let side = stroke::<S>([0.1, 0.0], [-0.15, 0.0]);
    let at = belief.meet(&side).unwrap();
    assert!(at.point[0] > 0.01 && at.normal[0] > 0.9, "{:?} {:?}", at.point, at.normal);
    let untouched = gain(belief, &[side]);
    assert!(untouched > 2.0 * known && untouched > 1.0, "{untouched} {known}");
    // Two fingers side by side tell less than twice as much, on opposite sides nearly that.
    let beside = stroke::<S>([0.1, 0.004], [-0.15, 0.0]);
    let opposite = stroke::<S>([-0.1, 0.0], [0.15, 0.0]);
    let [two, both] = [[side, beside], [side, opposite]].map(|strokes| gain(belief, &strokes));
    assert!(two > untouched && two < 1.75 * untouched, "{untouched} {two}");
    assert!(both > two, "{two} {both}");
    // Too short, beside, away from it, and far away: nothing is met and nothing is learnt.
    for miss in [
        stroke::<S>([0.0, 0.1], [0.0, -0.05]),
        stroke([0.1, 0.1], [-0.3, 0.0]),
        stroke([0.0, 0.1], [0.0, 0.3]),
        stroke([0.7, 0.7], [0.0, -1.4]),
    ] {
        let (gain, contacts) = worth(belief, &hand(&[miss]), Criterion::Information, NOISE);
        assert!(gain < 0.02, "{miss:?} {gain} {contacts}");
    }
    // A way that begins inside is stopped at once.
    let inside = belief.meet(&stroke::<S>([0.0, 0.0], [0.0, 0.1])).unwrap();
    assert!(inside.point.norm() < 1e-6);
}

#[test]
fn faces_foresee_in_the_plane() {
    let mut tracker = std::boxed::Box::new(PlanarHypotheses::new());
    assert!(tracker.foresee(None).is_none());
    slab::<Planar, _>(&mut *tracker, STEADY);
    let mut belief = tracker.foresee(None).unwrap();
    sees_what_was_touched_and_what_was_not(&mut belief);
    // Along a face, outside of it: nothing.
    assert!(belief.meet(&stroke([0.1, 0.021], [-0.2, 0.0])).is_none());
}

#[test]
fn faces_foresee_in_space() {
    let mut tracker = std::boxed::Box::new(SpatialHypotheses::new());
    slab::<Spatial, _>(&mut *tracker, STEADY);
    sees_what_was_touched_and_what_was_not(&mut tracker.foresee(None).unwrap());
}

#[test]
fn a_map_foresees_in_the_plane() {
    let mut tracker = std::boxed::Box::new(PlanarTracker::new(Truncated::new()));
    assert!(tracker.foresee(None).is_none());
    slab::<Planar, _>(&mut *tracker, STEADY);
    sees_what_was_touched_and_what_was_not(&mut tracker.foresee(None).unwrap());
}

#[test]
fn a_map_foresees_in_space() {
    let mut tracker = std::boxed::Box::new(SpatialTracker::new(Truncated::new()));
    slab::<Spatial, _>(&mut *tracker, STEADY);
    sees_what_was_touched_and_what_was_not(&mut tracker.foresee(None).unwrap());
}

/// A map that has forgotten a side's contacts for its face foresees the side, and its ends.
#[test]
fn a_truncated_map_foresees_its_faces() {
    let mut tracker = std::boxed::Box::new(PlanarTracker::new(Truncated::new()));
    tracker.prepare();
    tracker.set_motion_noise(STEADY);
    tracker.reset(1);
    let felt: Vec<Contact<Planar>> = [-1.0, 1.0]
        .into_iter()
        .flat_map(|side| (0..10).map(move |k| (0.004 * k as f32 - 0.018, side)))
        .map(|(x, side)| contact(Vector([x, 0.02 * side]), Vector([0.0, side])))
        .collect();
    tracker.update(None, GraspView { contacts: &felt, free: &[] });
    assert_eq!((tracker.map().cuts().count(), tracker.map().body().contacts()), (2, 0));
    let mut belief = tracker.foresee(None).unwrap();
    let above = |x: f32| stroke::<Planar>([x, 0.1], [0.0, -0.12]);
    let met = belief.meet(&above(0.0)).unwrap();
    assert!((met.point[1] - 0.02).abs() < 1e-4 && met.normal[1] > 0.999, "{:?}", met.point);
    assert!(met.depth > 0.01 && met.share > 0.99);
    let [known, near, far] = [0.0, 0.024, 0.032].map(|x| gain(&mut belief, &[above(x)]));
    assert!(known < 0.1 && near > 2.0 * known && far > 2.0 * near, "{known} {near} {far}");
    // Nothing was felt of where the slab ends.
    let side = gain(&mut belief, &[stroke([0.1, 0.0], [-0.15, 0.0])]);
    assert!(side > far, "{side} {far}");
}

/// A single contact on a side whose place hangs on the pose alone says little of the shape; a second on
/// the other side tells the two apart.
#[test]
fn doubt_about_the_pose_is_a_nuisance() {
    let gains = [STEADY, MotionNoise { translation: 1e-2, rotation: 0.35 }].map(|noise| {
        let mut tracker = std::boxed::Box::new(PlanarHypotheses::new());
        slab::<Planar, _>(&mut *tracker, noise);
        let mut belief = tracker.foresee(None).unwrap();
        let (one, other) = (stroke([0.1, 0.0], [-0.15, 0.0]), stroke([-0.1, 0.0], [0.15, 0.0]));
        [gain(&mut belief, &[one]), gain(&mut belief, &[one, other])]
    });
    let [[one, two], [blurred, apart]] = gains;
    assert!(blurred < 0.6 * one && apart < two, "{gains:?}");
    assert!(apart > 2.2 * blurred, "{gains:?}");
}

/// A face told independently of the pose: every covariance has a closed form.
#[test]
fn one_told_face_is_what_algebra_says() {
    let mut tracker = Hypotheses::<Planar, 2, 4, 11, 66, 0>::new();
    tracker.set_motion_noise(MotionNoise { translation: 2e-3, rotation: 0.05 });
    let covariance = crate::matrix::Matrix([[1e-6, 0.0, 0.0], [0.0, 4e-6, 0.0], [0.0, 0.0, 1e-4]]);
    tracker.believe(&PlanarPose::IDENTITY, &covariance).unwrap();
    let (deviation, tilt) = (2e-4, 0.01);
    let (normal, centre) = (Vector([0.0, 1.0]), Vector([0.0, 0.02]));
    tracker.learn(&ToldFace { normal, centre, deviation, tilt, contacts: 3 }).unwrap();
    let mut belief = tracker.foresee(None).unwrap();
    let met = belief.meet(&stroke([0.01, 0.1], [0.0, -0.2])).unwrap();
    let doubts = belief.doubts(&[met]);
    // y errs by 2 mm and the motion's 2 mm, the turn lifts 10 mm of lever.
    let pose = 4e-6 + 4e-6 + 1e-4 * (1e-4 + 0.0025);
    let like = (1.0 + 0.173_205_08) * (-0.173_205_08f32).exp();
    let shape = 4e-8 + 1e-4 * 1e-4 + 9e-4 * (1.0 - like * like);
    let close = |a: f32, b: f32| assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
    close(doubts.pose[0][0], pose);
    close(doubts.all[0][0], pose + shape);
    close(met.share, (-0.5f32).exp());
    // The world turned and moved with hand and object changes nothing.
    let moved = PlanarPose::new(Vector([0.3, -0.2]), 1.0);
    let here =
        worth(&mut belief, &hand(&[stroke([0.01, 0.1], [0.0, -0.2])]), Default::default(), NOISE);
    let mut belief = tracker.foresee(Some(&moved)).unwrap();
    let there = Candidate { hand: moved, ..hand(&[stroke([0.01, 0.1], [0.0, -0.2])]) };
    let there = worth(&mut belief, &there, Default::default(), NOISE);
    close(there.0, here.0);
    // Nonsense for a motion is none.
    let nan = PlanarPose::new(Vector([f32::NAN, 0.0]), 0.0);
    assert_eq!(tracker.foresee(Some(&nan)).unwrap().pose(), PlanarPose::IDENTITY);
}

#[test]
fn lists_are_lists() {
    let mut list = Candidates::<Spatial, 3>::new();
    let at = |x: f32| Candidate {
        hand: SpatialPose::from_translation(Vector([x, 0.0, 0.0])),
        ..hand(&[stroke([0.0, 0.1], [0.0, -0.2])])
    };
    assert_eq!(list.put(1, at(1.0)), Err(ListError::Gap));
    assert_eq!(
        (list.put(0, at(0.0)), list.put(1, at(1.0)), list.put(2, at(2.0))),
        (Ok(()), Ok(()), Ok(()))
    );
    assert_eq!(list.put(3, at(3.0)), Err(ListError::Full));
    assert_eq!((list.put(1, at(5.0)), list.as_slice().len()), (Ok(()), 3));
    assert_eq!(list.as_slice()[1], at(5.0));
    assert_eq!((list.put(0, at(7.0)), list.as_slice().len()), (Ok(()), 1));
    list.clear();
    assert_eq!(list.as_slice(), []);
}

/// Numbers on the edge of what is finite choose something and do not panic.
#[test]
fn extremes_are_worth_nothing_or_something() {
    let mut tracker = std::boxed::Box::new(PlanarHypotheses::new());
    slab::<Planar, _>(&mut *tracker, STEADY);
    let mut map = std::boxed::Box::new(Bootstrap::new(Truncated::new()));
    slab::<Planar, PlanarTracker>(&mut *map, STEADY);
    let mut far = hand(&[stroke([0.0, 0.1], [0.0, -0.2])]);
    far.strokes[1] =
        Some(Stroke { start: Vector([3e38, -3e38]), direction: Vector([0.6, 0.8]), travel: 3e38 });
    far.strokes[2] =
        Some(Stroke { start: Vector([0.0; 2]), direction: Vector([1.0, 0.0]), travel: 1e-30 });
    for noise in [1e-30, 1e-6, 1e30] {
        for criterion in [Criterion::Information, Criterion::VarianceSum] {
            let choice = choose(&mut tracker.foresee(None).unwrap(), &[far], criterion, noise);
            assert!(choice.is_some_and(|c| c.gain >= 0.0 && c.gain.is_finite()));
            let choice = choose(&mut map.foresee(None).unwrap(), &[far], criterion, noise);
            assert!(choice.is_some_and(|c| c.gain >= 0.0 && c.gain.is_finite()));
        }
    }
    let none: [Candidate<Planar>; 0] = [];
    assert_eq!(
        choose(&mut tracker.foresee(None).unwrap(), &none, Criterion::Information, NOISE),
        None
    );
}

#[test]
fn fingers_beyond_the_last_are_worth_nothing() {
    let mut doubts = Doubts::NONE;
    (0..FINGERS).for_each(|i| doubts.all[i][i] = 1e-6);
    let chances = [0.5; 32];
    assert_eq!(doubts.likely(FINGERS, 0.1), 0.0);
    assert_eq!(doubts.variance_sum(&chances), doubts.variance_sum(&chances[..FINGERS]));
    assert_eq!(doubts.information(&chances, NOISE), doubts.information(&chances[..FINGERS], NOISE));
}
