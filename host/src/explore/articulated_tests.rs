use std::sync::Arc;

use nalgebra::Point3;

use super::*;
use crate::graph;
use crate::quantity::Deviation;
use crate::shape::Geometry;
use crate::sim::hand::{Articulated, Unreachable};
use crate::sim::{Bench, Hand, Options, SimError};
use crate::slam::track::Step;
use crate::space::{Point, Pose};

fn hand() -> Hand {
    Hand::Articulated(Arc::new(Articulated::five_finger().unwrap()))
}

fn options(object: &str) -> Options {
    let motion_noise = Deviation { length: 0.0, angle: 0.0 };
    Options { motion_noise, seed: 1, ..Options::new(object.parse().unwrap()) }
}

fn bench(object: &str) -> Bench {
    Bench::with_hand(options(object), hand(), true).unwrap()
}

fn settings(candidates: Candidates, most_actions: usize) -> Settings {
    Settings {
        criterion: Criterion::Entropy,
        candidates,
        planning: Planning::SINGLE,
        tracker: None,
        graph: graph::Kind::None,
        until: Until::Coverage(1.0),
        pose: None,
        most_actions,
        seed: 3,
    }
}

/// The belief after probing.
fn probed(bench: &mut Bench) -> Belief {
    bench.probe().unwrap();
    let mut belief = Belief::new(bench.log(), &[Step::certain(Pose::identity())]).unwrap();
    (belief.hand, belief.table) = (bench.hand().clone(), bench.table());
    belief
}

#[test]
fn a_box_on_a_table_is_explored_by_fingers_that_close() {
    let run = |candidates| {
        let mut bench = bench("box:0.06x0.06x0.06");
        let episode = explore(&mut bench, &settings(candidates, 5), |_| ()).unwrap();
        (bench, episode)
    };
    let (bench, episode) = run(Candidates::Continuous(30));
    assert_eq!(episode.actions.len(), 5);
    assert_eq!(episode.actions[0].contacts, 5, "probing from above and from four sides");
    let log = bench.log();
    assert_eq!(log.grasps.len(), 5);
    assert_eq!(log.fingers[4], "th_distal");
    let felt: usize = episode.actions[1..].iter().map(|a| a.contacts).sum();
    assert!(felt >= 4, "{felt}");
    for (k, (grasp, action)) in log.grasps.iter().zip(&episode.actions).enumerate() {
        // The table holds the object where no finger can touch it.
        assert_eq!(grasp.contacts.len(), action.contacts + usize::from(k == 0));
        assert_eq!(grasp.unknown.contains_key("unreachable"), action.refused.is_some());
        let back = grasp.truth.unwrap().inverse();
        for contact in &grasp.contacts {
            let at = (back * Point3::from(contact.point)).coords;
            assert!(bench.geometry().distance(&at) < 6e-3, "within the noise of the surface");
            assert!(contact.point.z > -6e-3);
        }
    }
    let (_, again) = run(Candidates::Continuous(30));
    let placements = |e: &Episode| e.actions.iter().map(|a| a.placement).collect::<Vec<_>>();
    assert_eq!(placements(&episode), placements(&again));
    let (_, fixed) = run(Candidates::Fixed);
    assert!(fixed.end != End::NoCandidate && fixed.actions.len() == 5);
}

#[test]
fn candidates_face_the_object_and_are_clear_of_it() {
    let mut bench = bench("cylinder:0.06x0.08");
    let belief = probed(&mut bench);
    let Hand::Articulated(hand) = bench.hand().clone() else { panic!("a hand") };
    let [mut random] = crate::sim::random::Random::streams(5);
    let drawn = approach::drawn(&hand, &belief, 30, &mut random);
    let fixed = approach::fixed(&hand, &belief);
    assert!(drawn.len() > 15 && fixed.len() >= 5, "{} {}", drawn.len(), fixed.len());
    let Geometry::Mesh(mesh) = &belief.geometry else { panic!("a mesh") };
    let around = crate::sim::hand::Surroundings::new(Some((mesh, belief.pose)), Some(0.0));
    for (placement, met) in drawn.iter().zip(swept::met(&hand, &belief, &drawn)) {
        let grasp = belief.pose * placement.hand;
        assert_eq!(hand.fits(&grasp, placement.spread, &around), Ok(()));
        assert!(hand.above(&grasp, placement.spread, 0.0) > 0.0);
        assert!(!met.is_empty());
        for m in met {
            assert!(belief.geometry.distance(&m.contact.point) < 1e-6);
            assert!((m.contact.normal.norm() - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn low_objects_are_come_at_from_the_side_by_lifted_hands_and_the_table_stops_fingers() {
    let mut bench = bench("box:0.06x0.06x0.03");
    let belief = probed(&mut bench);
    let Hand::Articulated(hand) = bench.hand().clone() else { panic!("a hand") };
    let [mut random] = crate::sim::random::Random::streams(7);
    let drawn = approach::drawn(&hand, &belief, 24, &mut random);
    let up = |p: &Placement| (belief.pose.rotation * p.hand.rotation * Point::z()).z;
    assert!(drawn.iter().filter(|p| up(p) < 0.3).count() >= 2);
    let felt = |table: Option<f64>| -> usize {
        let mut belief = belief.clone();
        belief.table = table;
        swept::met(&hand, &belief, &drawn).iter().map(Vec::len).sum()
    };
    assert_eq!(felt(Some(1.0)), 0);
    assert!(felt(Some(0.012)) < felt(Some(0.0)) && felt(Some(0.0)) <= felt(None));
}

#[test]
fn what_is_expected_is_about_what_is_felt() {
    // Where the belief is the truth, most expected contacts come, near where they were expected.
    let mut bench = bench("box:0.06x0.06x0.06");
    let mut belief = probed(&mut bench);
    let truth = bench.log().grasps[0].truth.unwrap();
    belief.geometry = bench.geometry().transformed(&truth);
    let Hand::Articulated(hand) = bench.hand().clone() else { panic!("a hand") };
    let [mut random] = crate::sim::random::Random::streams(6);
    let drawn = approach::drawn(&hand, &belief, 12, &mut random);
    let (mut expected, mut came, mut near) = (0, 0, 0);
    for (placement, met) in drawn.iter().zip(swept::met(&hand, &belief, &drawn)) {
        bench.grasp(&placement.hand, placement.spread, 0.1).unwrap();
        let felt = &bench.log().grasps.last().unwrap().contacts;
        for m in &met {
            expected += 1;
            let same = felt.iter().find(|c| c.finger == Some(m.contact.finger));
            came += usize::from(same.is_some());
            near += usize::from(same.is_some_and(|c| (c.point - m.contact.point).norm() < 0.012));
        }
    }
    assert!(expected > 15, "{expected}");
    assert!(2 * came > expected, "{came} of {expected}");
    assert!(3 * near > 2 * came, "{near} of {came}");
}

#[test]
fn an_arm_that_is_too_short_ends_the_loop_with_what_there_is() {
    let mut short = Articulated::five_finger().unwrap();
    short.arm.reach = 0.2;
    let hand = Hand::Articulated(Arc::new(short));
    let mut bench = Bench::with_hand(options("box:0.06x0.06x0.06"), hand, true).unwrap();
    for candidates in [Candidates::Fixed, Candidates::Continuous(10)] {
        let episode = explore(&mut bench, &settings(candidates, 5), |_| ()).unwrap();
        assert_eq!(episode.end, End::NoCandidate);
        assert_eq!(episode.actions.len(), 1);
    }
    let high = Pose::translation(0.0, 0.0, 0.3);
    let refused = bench.grasp(&high, 0.0, 0.1).unwrap_err();
    assert!(matches!(refused, Unreachable::OutOfReach { .. }));
    let last = bench.log().grasps.last().unwrap();
    let why = last.unknown["unreachable"].as_str().unwrap();
    assert!(last.contacts.is_empty() && why.contains("the arm reaches 200 mm"), "{why}");
}

#[test]
fn an_object_too_large_for_the_hand_is_delimited_and_not_grasped() {
    let mut bench = bench("box:3x3x3");
    let episode = explore(&mut bench, &settings(Candidates::Fixed, 3), |_| ()).unwrap();
    assert_eq!((episode.end, episode.actions.len()), (End::NoCandidate, 1));
    // Four sides and the top, touched from outside.
    let felt: Vec<_> = bench.log().grasps[0].contacts.iter().map(|c| c.point).collect();
    assert!(felt.iter().all(|p| p.z < 1e-2 || p.xy().amax() > 1.4 || p.z > 2.9), "{felt:?}");
}

#[test]
fn probing_delimits_objects_in_the_plane_and_in_space() {
    let still = |object: &str| Options {
        contact_noise: Deviation { length: 0.0, angle: 0.0 },
        ..options(object)
    };
    let mut planar = Bench::new(still("rectangle:0.1x0.06")).unwrap();
    let mut spatial = Bench::new(still("box:0.1x0.06x0.08")).unwrap();
    let table = Bench::with_hand(still("box:0.1x0.06x0.08"), hand(), true);
    for (bench, touches) in [(&mut planar, 4), (&mut spatial, 6), (&mut table.unwrap(), 5)] {
        let found = bench.probe().unwrap();
        assert_eq!((found.touches().count(), found.moves), (touches, touches));
        let truth = bench.log().grasps[0].truth.unwrap();
        let (low, high) = bench.geometry().transformed(&truth).bounds();
        assert!((found.low - low).norm() < 2e-4, "{} {low}", found.low);
        assert!((found.high - high).norm() < 2e-4, "{} {high}", found.high);
        let contacts = &bench.log().grasps[0].contacts;
        let stands = usize::from(bench.table().is_some());
        assert_eq!(contacts.len(), touches + stands);
        assert!(contacts.iter().all(|c| c.finger.is_none() && c.normal_noise.is_some()));
        let back = truth.inverse();
        let outside = |p: &Point| {
            let at = (back * Point3::from(*p)).coords;
            let Geometry::Mesh(mesh) = bench.geometry() else { return true };
            mesh.signed_distance(&at).unwrap() > 2.5e-3
        };
        let free = &bench.log().grasps[0].free;
        assert_eq!(free.len(), if bench.log().dimension == 3 { 25 * touches } else { 0 });
        assert!(free.iter().all(|f| outside(&f.point)));
        if stands == 1 {
            let foot = contacts.last().unwrap();
            assert_eq!((foot.point.z, foot.normal), (0.0, Some(-Point::z())));
            let at = (back * Point3::from(foot.point)).coords;
            assert!(bench.geometry().distance(&at) < 1e-9);
        }
    }
}

#[test]
fn an_object_that_slips_is_pushed_and_stays_upright_on_its_table() {
    let motion_noise = Deviation { length: 5e-3, angle: 10f64.to_radians() };
    let options = Options { motion_noise, ..options("box:0.06x0.06x0.06") };
    let mut bench = Bench::with_hand(options, hand(), true).unwrap();
    let belief = probed(&mut bench);
    let Hand::Articulated(hand) = bench.hand().clone() else { panic!("a hand") };
    let [mut random] = crate::sim::random::Random::streams(2);
    for placement in approach::drawn(&hand, &belief, 6, &mut random) {
        let _ = bench.grasp(&placement.hand, placement.spread, 0.1);
    }
    for pair in bench.log().grasps.windows(2) {
        let [before, after] = [&pair[0], &pair[1]].map(|g| g.truth.unwrap());
        assert_ne!(before, after);
        let up = after.rotation * Point::z();
        assert!((up - Point::z()).norm() < 1e-9);
        assert!((after.translation.z - before.translation.z).abs() < 1e-9);
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let planar = Bench::with_hand(options("rectangle:0.1x0.06"), hand(), false).unwrap_err();
    assert!(matches!(planar, SimError::Planar { .. }));
    assert!(planar.to_string().contains("prism:HEIGHT,rectangle:0.1x0.06"), "{planar}");
    let table = Bench::with_hand(options("box:0.1x0.1x0.1"), Hand::Idealised, true).unwrap_err();
    assert!(table.to_string().starts_with("--table: expected an articulated hand"), "{table}");
}
