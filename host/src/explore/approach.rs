//! Where an articulated hand can close: it comes from outside towards a place of the believed surface, the
//! palm facing it and as high above the table as its parts need, and closes at the depth where most
//! fingertips would meet the surface. What is in the way, by the belief, is left out.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;

use super::belief::Belief;
use super::placement::Placement;
use super::swept::count;
use crate::shape::Geometry;
use crate::sim::hand::closing::APPROACH;
use crate::sim::hand::{Articulated, SPREADS, Surroundings, Unreachable};
use crate::sim::random::Random;
use crate::space::{Point, Pose};

/// How many fixed grasps there are, as with the idealised hand.
const FIXED: usize = 10;

/// Between the open hand and what it faces when it closes, metres: the least and the greatest.
const NEAR: f64 = 5e-3;
const FAR: f64 = 0.045;

/// How far off the surface's normal a hand comes at most, radians.
const ASKEW: f64 = 0.7;

/// Where a hand starts, from the middle of the object, beyond the object's radius, metres.
const START: f64 = 0.15;

/// How far the middle of the grasp goes into the object at most, beyond the place that it faces, metres.
const INTO: f64 = 0.04;

/// How far apart the depths are at which a hand may close, metres.
const STEP: f64 = 6e-3;

/// A depth is good enough when this part of the fingertips would touch.
const ENOUGH: f64 = 0.8;

/// Between a hand that is lifted and the table, metres.
const CLEAR: f64 = 2e-3;

/// How far a hand is lifted at most, metres: then it passes over what it was to touch.
const LIFTED: f64 = 0.08;

/// Parts of the hand nearer than this to what is only believed to be there count as touching it, metres.
const BELIEVED: f64 = 1e-3;

/// Draws per candidate that is wanted, at most.
const TRIES: usize = 3;

/// One way to come.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// Of the surface, object frame.
    place: Point,
    /// From there to the palm, unit, object frame.
    back: Point,
    /// Of the hand about it, radians.
    roll: f64,
    /// See [`Placement::spread`].
    spread: f64,
    /// From the open hand to what it faces, metres, where fingers do not mind.
    gap: f64,
}

/// The ten grasps about the middle of the believed object: from above and all around, as many of them as
/// are feasible.
pub fn fixed(hand: &Articulated, belief: &Belief) -> Vec<Placement> {
    let golden = PI * (3.0 - 5f64.sqrt());
    let ways = (0..FIXED).map(|k| {
        // On a table only the upper half can be come from.
        let lowest = if belief.table.is_some() { 0.1 } else { -1.0 };
        let height = 1.0 - (1.0 - lowest) * (k as f64 + 0.5) / FIXED as f64;
        let across = (1.0 - height * height).sqrt();
        let (sin, cos) = (golden * k as f64).sin_cos();
        let back = belief.pose.rotation.inverse() * Point::new(across * cos, across * sin, height);
        Way {
            place: belief.centre,
            back,
            roll: [0.0, PI / 2.0][k % 2],
            spread: SPREADS[k % SPREADS.len()],
            gap: NEAR,
        }
    });
    feasible(hand, belief, ways.collect())
}

/// About `count` grasps at places drawn from the believed surface, all of them feasible.
pub fn drawn(
    hand: &Articulated,
    belief: &Belief,
    count: usize,
    random: &mut Random,
) -> Vec<Placement> {
    let places = belief.geometry.samples(4 * count.max(16));
    if places.is_empty() {
        return Vec::new();
    }
    let mut found = Vec::with_capacity(count);
    for _ in 0..TRIES {
        let ways: Vec<Way> = (0..count - found.len())
            .map(|_| {
                let pick = ((random.unit() * places.len() as f64) as usize).min(places.len() - 1);
                let (place, normal) = places[pick];
                let askew = random.direction(3) * (ASKEW.sin() * random.unit());
                let mut back = (normal + askew).try_normalize(1e-6).unwrap_or(normal);
                if belief.table.is_some() {
                    // Nothing comes from below the table.
                    let mut up = belief.pose.rotation * back;
                    up.z = up.z.abs();
                    back = belief.pose.rotation.inverse() * up;
                }
                let roll = TAU * random.unit();
                let spread = SPREADS[((random.unit() * 3.0) as usize).min(SPREADS.len() - 1)];
                let gap = NEAR + (FAR - NEAR) * random.unit();
                Way { place, back, roll, spread, gap }
            })
            .collect();
        found.extend(feasible(hand, belief, ways));
        if found.len() >= count {
            break;
        }
    }
    found
}

/// Those that the belief has nothing against, and by which at least one fingertip would touch.
fn feasible(hand: &Articulated, belief: &Belief, ways: Vec<Way>) -> Vec<Placement> {
    // Built before the threads ask for it.
    belief.geometry.distance(&belief.centre);
    ways.par_iter().filter_map(|way| bring(hand, belief, way).ok()).collect()
}

/// The grasp at the end of the way: of the depths there, in the order of their distance to the way's own, the
/// first at which nearly all fingertips would touch, or else the one at which most do.
fn bring(hand: &Articulated, belief: &Belief, way: &Way) -> Result<Placement, Unreachable> {
    let Geometry::Mesh(mesh) = &belief.geometry else { return Err(Unreachable::NothingFelt) };
    let object = Some((mesh, belief.pose));
    let around = Surroundings { touching: BELIEVED, ..Surroundings::new(object, belief.table) };
    let least = Point::ith(way.back.iamin(), 1.0);
    let x = way.back.cross(&least).normalize();
    let facing = Rotation3::from_basis_unchecked(&[x, way.back.cross(&x), way.back]);
    let rotation = UnitQuaternion::from_rotation_matrix(&facing)
        * UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), way.roll);
    let facing = belief.pose * Pose::from_parts(Translation3::from(way.place), rotation);
    let facing = Translation3::new(0.0, 0.0, lift(hand, belief, &facing, way.spread)?) * facing;
    let direction = -(belief.pose.rotation * way.back);
    let (low, high) = belief.geometry.bounds();
    let far = ((high - low) / 2.0).norm() + START;
    let start = Translation3::from(-far * direction) * facing;
    hand.within_reach(&facing)?;
    let (along, _) = hand.advance(&start, way.spread, &direction, far + INTO, &around);
    // On its way to any of these depths the hand was clear.
    let depths = (0..).map(|k| along - NEAR - STEP * k as f64);
    let depths = depths.take_while(|depth| along - depth <= FAR && *depth >= APPROACH);
    let mut depths: Vec<f64> = depths.collect();
    let off = |depth: f64| (along - depth - way.gap).abs();
    depths.sort_by(|a, b| off(*a).total_cmp(&off(*b)));
    let to_object = belief.pose.inverse();
    let mut best: Option<(usize, Pose, Placement)> = None;
    for depth in depths {
        let grasp = Translation3::from(depth * direction) * start;
        let placement = Placement { hand: to_object * grasp, spread: way.spread };
        let fingers = count(hand, belief, &placement);
        if fingers > best.map_or(0, |(most, ..)| most) {
            best = Some((fingers, grasp, placement));
        }
        if fingers as f64 >= ENOUGH * hand.fingers().len() as f64 {
            break;
        }
    }
    let (_, grasp, placement) = best.ok_or(Unreachable::NothingFelt)?;
    hand.within_reach(&grasp).map(|()| placement)
}

/// How much higher the open hand must be not to be in the table, metres.
fn lift(
    hand: &Articulated,
    belief: &Belief,
    grasp: &Pose,
    spread: f64,
) -> Result<f64, Unreachable> {
    let Some(table) = belief.table else { return Ok(0.0) };
    let lift = (CLEAR - hand.above(grasp, spread, table)).max(0.0);
    if lift <= LIFTED { Ok(lift) } else { Err(Unreachable::NothingFelt) }
}
