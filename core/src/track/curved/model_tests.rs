//! The linear model of trajectory and surface against integration and differences.

use super::tests::{ELLIPSE, KERNEL, Plane, Shape, World, tracker, view};
use super::*;
use crate::contact::Contact;
use crate::matrix::{Matrix, Vector};
use crate::random::Random;
use crate::space::{Planar, PlanarPose};
use crate::surface::{Ball, Map, Matern32, Prior, Surface, Training};
use std::boxed::Box;

#[test]
fn laplace_agrees_with_integration() {
    // What is known of a disc with a dent, and one more contact whose pose may be off along x only.
    let mut random = Random::new(1);
    let mut map = Shape::new();
    map.configure(KERNEL, Ball::UNSET, Training::Normals);
    for i in 0..9 {
        let contact = ELLIPSE.touch(&PlanarPose::IDENTITY, 0.7 * i as f32, &mut random);
        map.insert(&contact);
    }
    map.refit();
    let mut memory = Memory::<Planar, 2, 8>::new();
    let drift = Drift { translation: 9e-6, rotation: 4e-4 };
    let still = Move { motion: PlanarPose::IDENTITY, drift };
    let felt = ELLIPSE.grasp(&PlanarPose::new(Vector([0.002, -0.001]), 0.01), &mut random);
    memory.push(0, still, &view(&felt));
    let mut hypothesis = Hypothesis::<Planar, 2, 8>::UNSET;
    hypothesis.base = PlanarPose::IDENTITY;
    // At its best place: two rounds.
    let since = map.rows();
    let mut trajectory = Trajectory::<Planar, 2, 8, 180>::new();
    (hypothesis.about[0], hypothesis.poses[0]) = (PlanarPose::IDENTITY, PlanarPose::IDENTITY);
    let surface = map.clone();
    let zero = Matrix::<3>::ZERO;
    let bend = |h: &mut Hypothesis<Planar, 2, 8>| {
        h.about[0] = h.poses[0];
        for (belief, touch) in h.beliefs.iter_mut().zip(memory.touches()) {
            *belief = Belief::new(surface.bend(h.about[0].untransform(touch.point)));
        }
    };
    for _ in 0..5 {
        bend(&mut hypothesis);
        trajectory.place(&mut map, since, Some(&zero), &memory, &hypothesis, 1);
        trajectory.settle(&map, since, &memory, &mut hypothesis);
    }
    let covariance = trajectory.covariance(&map, since);
    map.withdraw(since);
    map.refit();
    trajectory.place(&mut map, since, Some(&zero), &memory, &hypothesis, 0);
    trajectory.append(&mut map, since, Some(&zero), &memory, &hypothesis, 0);
    let laplace = map.log_density_since(since);

    // The same by brute force: the surface's prediction of the contacts at every pose of a grid.
    let mut total = 0.0f64;
    let (mut mean, mut square) = ([0.0f64; 3], [0.0f64; 3]);
    let steps = [drift.translation.sqrt(), drift.translation.sqrt(), drift.rotation.sqrt()];
    let mut exact = surface.clone();
    let known = [Vector::<3>::ZERO; 4];
    for i in -10i32..=10 {
        for j in -10i32..=10 {
            for k in -10i32..=10 {
                let grid = [i, j, k].map(|v| 0.35 * v as f32);
                let tangent = Vector([grid[0] * steps[0], grid[1] * steps[1], grid[2] * steps[2]]);
                let pose = PlanarPose::IDENTITY.retract(tangent);
                exact.withdraw(since);
                for touch in memory.touches() {
                    let shared = crate::surface::Shared {
                        offset: [0.0; 4],
                        lever: &known,
                        spread: &[],
                        since,
                    };
                    assert_eq!(exact.append(&touch.seen_from(&pose), &shared, &mut [0.0; 256]), 3);
                }
                let prior: f32 = grid.iter().map(|g| -0.5 * g * g - 0.918_938_5).sum();
                let density =
                    f64::from(exact.log_density_since(since) + prior).exp() * 0.35f64.powi(3);
                total += density;
                for axis in 0..3 {
                    mean[axis] += density * f64::from(tangent[axis]);
                    square[axis] += density * f64::from(tangent[axis]).powi(2);
                }
            }
        }
    }
    assert!((f64::from(laplace) - total.ln()).abs() < 0.15, "{laplace} {}", total.ln());
    let apart = PlanarPose::IDENTITY.local(&hypothesis.poses[0]);
    for axis in 0..3 {
        let mean = mean[axis] / total;
        let deviation = (square[axis] / total - mean * mean).sqrt();
        let laplace = f64::from(covariance.0[axis][axis]).sqrt();
        assert!((laplace / deviation - 1.0).abs() < 0.15, "{axis}: {laplace} {deviation}");
        assert!((f64::from(apart[axis]) - mean).abs() < 0.3 * deviation, "{axis}");
    }
}

#[test]
fn levers_are_derivatives() {
    let mut random = Random::new(3);
    let mut map = Shape::new();
    map.configure(KERNEL, Ball::UNSET, Training::Normals);
    for i in 0..12 {
        map.insert(&ELLIPSE.touch(&PlanarPose::IDENTITY, 0.6 * i as f32, &mut random));
    }
    map.refit();
    let pose = PlanarPose::new(Vector([0.1, -0.2]), 0.7);
    let world = ELLIPSE.touch(&pose, 0.25, &mut random);
    let residual = |pose: &PlanarPose| {
        let probe = map.probe(pose.untransform(world.point));
        let n = pose.unrotate(world.normal.unwrap());
        [-probe.value, n[0] - probe.gradient[0], n[1] - probe.gradient[1]]
    };
    let seen = Contact {
        point: pose.untransform(world.point),
        normal: world.normal.map(|n| pose.unrotate(n)),
        ..world
    };
    let bend = map.bend(seen.point);
    for axis in 0..3 {
        let h = if axis < 2 { 5e-4 } else { 1e-2 };
        let mut step = Vector::<3>::ZERO;
        step[axis] = h;
        let (ahead, behind) = (residual(&pose.retract(step)), residual(&pose.retract(-step)));
        for part in 0..3 {
            let slope = (ahead[part] - behind[part]) / (2.0 * h);
            let lever = -trajectory::lever(&seen, &bend, part)[axis];
            let scale = if part > 0 && axis < 2 { 20.0 } else { 1.0 };
            assert!((slope - lever).abs() < 0.06 * scale, "{axis} {part}: {slope} {lever}");
        }
    }
}

#[test]
fn a_past_that_is_laid_already_is_the_past_laid_anew() {
    let mut shared = 0;
    for seed in 0..6 {
        let mut world = World::new(seed);
        let mut tracker = tracker();
        // Longer than memory, so that grasps settle; every ninth contact is wild.
        for grasp in 0..13 {
            let motion = (grasp > 0).then(|| world.turn());
            let mut felt = ELLIPSE.grasp(&world.truth, &mut world.random);
            for (i, contact) in felt.iter_mut().enumerate() {
                if (5 * grasp + i) % 9 == 4 {
                    contact.point += Vector([0.01, -0.02]);
                }
            }
            tracker.update(motion.as_ref(), view(&felt));
            let grasps = tracker.memory.grasps().len();
            for index in (0..tracker.count).rev() {
                let hypothesis = &tracker.hypotheses[index];
                shared += tracker.trajectory.shared(&tracker.memory, hypothesis, grasps);
                tracker.lay(index);
                let kept = tracker.map.weights().to_vec();
                let density = tracker.evidence_of(index, grasps);
                tracker.trajectory.clear();
                tracker.lay(index);
                assert_eq!(tracker.map.weights(), kept, "{seed} {grasp} {index}");
                assert_eq!(tracker.evidence_of(index, grasps), density, "{seed} {grasp} {index}");
            }
        }
    }
    assert!(shared > 100, "{shared}");
}

#[test]
fn a_hundred_times_as_large_is_no_other_object() {
    const SIZE: f32 = 100.0;
    let mut world = World::new(0);
    let mut large = Box::new(Plane::new(Shape::new()));
    let kernel =
        Matern32 { amplitude: SIZE * KERNEL.amplitude, lengthscale: SIZE * KERNEL.lengthscale };
    large.map_mut().configure(kernel, Ball::UNSET, Training::Normals);
    let usual = Settings::DEFAULT.motion;
    let motion = MotionNoise { translation: SIZE * usual.translation, ..usual };
    large.configure(Settings { motion, ..Settings::DEFAULT });
    for grasp in 0..8 {
        let meant = (grasp > 0).then(|| world.turn());
        let meant = meant.map(|pose| PlanarPose::new(pose.translation * SIZE, pose.angle()));
        let mut felt = ELLIPSE.grasp(&world.truth, &mut world.random);
        for contact in &mut felt {
            contact.point = contact.point * SIZE;
            contact.point_deviation *= SIZE;
        }
        assert_ne!(large.update(meant.as_ref(), view(&felt)).status, Status::Lost, "{grasp}");
    }
}
