//! An object that somebody put elsewhere between two grasps.

use super::super::alignment::Alignments;
use super::super::plane::Touch;
use super::*;

#[test]
fn faces_and_touches_that_look_the_same_way_tell_where_an_object_is() {
    let (polygon, tracker, _) = known_quadrilateral();
    let gauge = tracker.recall(0).unwrap();
    for seed in 0..24 {
        let mut random = Random::new(seed);
        let elsewhere = PlanarPose::new(Vector([0.7, 0.1 * seed as f32]), 0.26 * seed as f32);
        let felt = polygon.grasp(&elsewhere, seed as usize, &mut random);
        let touches: Vec<_> = felt.iter().map(Touch::of).collect();
        let places = Alignments::of(tracker.best().unwrap(), &touches);
        let right = places.poses().iter().position(|pose| {
            let [translation, rotation] = error(pose, &elsewhere, &gauge, 1.0);
            translation < 0.01 && rotation < 0.2
        });
        assert!(right.is_some_and(|place| place < 4), "{seed}: {right:?}");
    }
}

/// New faces would explain anything: a map that is whole has to tell what is not the object there.
#[test]
fn an_object_carried_away_is_missed_at_once_and_found_again() {
    for far in [0.15, 0.6, 2.0] {
        let mut right = 0;
        for seed in 0..12 {
            let (polygon, mut tracker, _) = known_quadrilateral();
            let mut random = Random::new(seed);
            let way = seed as f32;
            let away = Vector([far * way.cos(), far * way.sin()]);
            let elsewhere = PlanarPose::new(away, 0.7 * way);
            let gauge = tracker.recall(0).unwrap();
            let rest = Some(&PlanarPose::IDENTITY);
            let touched = |k| view(&polygon.grasp(&elsewhere, k, &mut random)).contacts.to_vec();
            let grasps: Vec<_> = (0..5).map(touched).collect();
            let first = tracker.update(rest, view(&grasps[0]));
            // What only a slip explains has to be felt again.
            assert_ne!(first.status, Status::Tracking, "{far} {seed}");
            let last = grasps[1..].iter().map(|g| tracker.update(rest, view(g))).last().unwrap();
            let [translation, rotation] = error(&last.pose, &elsewhere, &gauge, 1.0);
            right += usize::from(translation < 6e-3 && rotation < 0.1);
        }
        assert!(right >= 11, "{far}: {right} of 12");
    }
}

/// A new face or two that fit, or old ones prolonged, and there is more than nothing to be said for it.
#[test]
fn a_triangle_carried_away_gets_no_new_sides() {
    let polygon = Polygon::regular(3, 0.03);
    for seed in 0..24 {
        let mut random = Random::new(seed);
        let mut tracker = Box::new(Plane2::new());
        tracker.set_motion_noise(MotionNoise { translation: 2.5e-3, rotation: 0.087 });
        let rest = Some(&PlanarPose::IDENTITY);
        for k in 0..8 {
            tracker.update(rest, view(&polygon.grasp(&PlanarPose::IDENTITY, k, &mut random)));
        }
        let (sin, cos) = math::sin_cos(seed as f32);
        let elsewhere = PlanarPose::new(Vector([0.3 * cos, 0.3 * sin]), 1.0);
        let first = tracker.update(rest, view(&polygon.grasp(&elsewhere, 8, &mut random)));
        assert_ne!(first.status, Status::Tracking, "{seed}");
        for k in 9..14 {
            tracker.update(rest, view(&polygon.grasp(&elsewhere, k, &mut random)));
        }
        let sides = tracker.faces().filter(|face| face.contacts > 2).count();
        assert_eq!(sides, 3, "{seed}");
    }
}

#[test]
fn a_box_carried_away_in_space_is_found_however_it_is_turned() {
    let rest = Some(&SpatialPose::IDENTITY);
    for (far, turned) in [(0.15, 1.0), (1.0, 3.1)] {
        let mut right = 0;
        for seed in 0..8 {
            let mut random = Random::new(seed);
            let mut tracker = Box::new(Space3::new());
            let noise = MotionNoise { translation: 0.01, rotation: 0.2 };
            tracker.configure(Settings { motion: noise, beam: 8, ..Settings::DEFAULT });
            let truth = SpatialPose::new(Vector([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3, 0.9]);
            for k in 0..8 {
                tracker.update(rest, view(&touch_box(&truth, k, &mut random)));
            }
            let gauge = truth.inverse().compose(&tracker.recall(7).unwrap()).inverse();
            let mut way = |length| random.normal::<Vector<3>>().normalized().unwrap() * length;
            let (away, turn): (Vector<3>, Vector<3>) = (way(far), way(turned));
            let elsewhere =
                truth.retract(Vector::from_fn(|i| if i < 3 { away[i] } else { turn[i - 3] }));
            let mut felt = || touch_box(&elsewhere, seed as usize, &mut random);
            let first = tracker.update(rest, view(&felt()));
            assert_ne!(first.status, Status::Tracking, "{seed}");
            let pose = tracker.update(rest, view(&felt())).pose.compose(&gauge);
            // Up to the box's symmetries: all contacts are on its sides.
            let felt = felt();
            let off = felt.iter().map(|c| pose.untransform(c.point)).map(|p| {
                let beyond = [p[0].abs() - 0.06, p[1].abs() - 0.04, p[2].abs() - 0.03];
                beyond.into_iter().fold(f32::MIN, f32::max).abs()
            });
            right += usize::from(off.fold(0.0, f32::max) < 0.015);
        }
        assert!(right >= 7, "{far}: {right} of 8");
    }
}
