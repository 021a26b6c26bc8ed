//! When the object is not where the motion has it.

use super::tests::{Ellipse, World, off, tracker, view};
use super::*;
use crate::contact::Contact;
use crate::matrix::Vector;
use crate::space::{Planar, PlanarPose};
use core::f32::consts::TAU;
use std::vec::Vec;

/// Six fingers around an egg, which fits on itself in one way only.
fn grasp(world: &mut World) -> Vec<Contact<Planar>> {
    let first = TAU * world.random.uniform();
    let finger = |i: usize| {
        let angle = first + TAU / 6.0 * i as f32;
        let half = Ellipse(if angle.cos() > 0.0 { 0.06 } else { 0.03 }, 0.03);
        half.touch(&world.truth, angle, &mut world.random)
    };
    (0..6).map(finger).collect()
}

#[test]
fn a_slip_is_believed_once_the_next_grasp_agrees() {
    for seed in 0..3 {
        let mut world = World::new(seed);
        let mut tracker = tracker();
        let mut gauge = None;
        for grasps in 0..7 {
            let motion = (grasps > 0).then(|| world.turn());
            let felt = grasp(&mut world);
            let estimate = tracker.update(motion.as_ref(), view(&felt));
            gauge.get_or_insert_with(|| world.truth.inverse().compose(&estimate.pose));
        }
        let mut follow = |world: &mut World, motion: &PlanarPose| {
            let felt = grasp(world);
            let estimate = tracker.update(Some(motion), view(&felt));
            let (shift, turn) = off(&world.truth, &gauge.unwrap(), &estimate.pose);
            assert!(estimate.corrected && shift < 0.012 && turn < 0.25, "{seed}: {shift} {turn}");
            (estimate.status, estimate.modes.disagree(AMBIGUOUS))
        };
        // It jumps while nothing was meant to move it.
        world.truth = world.truth.retract(Vector([0.09, -0.06, 0.6]));
        assert_eq!(follow(&mut world, &PlanarPose::IDENTITY), (Status::Ambiguous, false), "{seed}");
        let motion = world.turn();
        assert_eq!(follow(&mut world, &motion), (Status::Tracking, false), "{seed}");
    }
}

#[test]
fn an_object_that_was_put_elsewhere_is_found_where_it_is_touched() {
    for seed in 0..3 {
        let mut world = World::new(seed);
        let mut tracker = tracker();
        let mut gauge = None;
        for grasps in 0..9 {
            let motion = (grasps > 0).then(|| world.turn());
            let felt = grasp(&mut world);
            let estimate = tracker.update(motion.as_ref(), view(&felt));
            gauge.get_or_insert_with(|| world.truth.inverse().compose(&estimate.pose));
        }
        // Far beyond what unknown motion allows, and to the other side.
        world.truth = world.truth.retract(Vector([1.2, -0.7, 3.0]));
        let foreign: Vec<_> = grasp(&mut World::new(seed + 9));
        let mut follow = |felt: &[Contact<Planar>], motion: &PlanarPose, truth: &PlanarPose| {
            let estimate = tracker.update(Some(motion), view(felt));
            let (shift, turn) = off(truth, &gauge.unwrap(), &estimate.pose);
            (estimate.status, shift, turn)
        };
        // Something felt from inside is nowhere, and its place no prediction.
        let inside: Vec<_> =
            foreign.iter().map(|c| Contact { normal: c.normal.map(|n| -n), ..*c }).collect();
        let before = world.truth;
        let (status, shift, _) = follow(&inside, &PlanarPose::IDENTITY, &before);
        assert!(status == Status::Lost && shift > 1.3, "{seed}: {status:?} {shift}");
        let felt = grasp(&mut world);
        let (status, shift, turn) = follow(&felt, &PlanarPose::IDENTITY, &world.truth);
        assert_eq!(status, Status::Ambiguous, "{seed}");
        assert!(shift < 0.012 && turn < 0.25, "{seed}: {shift} {turn}");
        let motion = world.turn();
        let felt = grasp(&mut world);
        let (status, shift, turn) = follow(&felt, &motion, &world.truth);
        assert!(status == Status::Tracking && shift < 0.012 && turn < 0.25, "{shift} {turn}");
    }
}
