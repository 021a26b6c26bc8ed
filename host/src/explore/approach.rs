//! Where an articulated hand can close: it comes from outside towards a place of the believed surface, the
//! palm facing it, until it is near, and closes there. What is in the way, by the belief, is left out.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;

use super::belief::Belief;
use super::placement::Placement;
use super::swept::met;
use crate::shape::Geometry;
use crate::sim::hand::{Articulated, SPREADS, Surroundings, Unreachable};
use crate::sim::random::Random;
use crate::space::{Point, Pose};

/// How many fixed grasps there are, as with the idealised hand.
const FIXED: usize = 10;

/// Between the open hand and what it faces when it closes, metres: of the fixed grasps, and the greatest
/// of drawn ones.
const NEAR: f64 = 0.01;
const FAR: f64 = 0.03;

/// How far off the surface's normal a hand comes at most, radians.
const ASKEW: f64 = 0.7;

/// Where a hand starts, from the middle of the object, beyond the object's radius, metres.
const START: f64 = 0.15;

/// How far the middle of the grasp goes into the object at most, beyond the place that it faces, metres.
const INTO: f64 = 0.04;

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
    /// From the open hand to what it faces, metres.
    gap: f64,
}

/// The ten grasps about the middle of the believed object: from above and all around, as many of them as
/// are feasible.
pub fn fixed(hand: &Articulated, belief: &Belief, table: Option<f64>) -> Vec<Placement> {
    let golden = PI * (3.0 - 5f64.sqrt());
    let ways = (0..FIXED).map(|k| {
        // On a table only the upper half can be come from.
        let lowest = if table.is_some() { 0.1 } else { -1.0 };
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
    feasible(hand, belief, table, ways.collect())
}

/// About `count` grasps at places drawn from the believed surface, all of them feasible.
pub fn drawn(
    hand: &Articulated,
    belief: &Belief,
    table: Option<f64>,
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
                let askew = random.direction(3) * (ASKEW.tan() * random.unit());
                let mut back = (normal + askew).try_normalize(1e-6).unwrap_or(normal);
                if table.is_some() {
                    // Nothing comes from below the table.
                    let mut up = belief.pose.rotation * back;
                    up.z = up.z.abs();
                    back = belief.pose.rotation.inverse() * up;
                }
                let roll = TAU * random.unit();
                let spread = SPREADS[((random.unit() * 3.0) as usize).min(SPREADS.len() - 1)];
                let gap = 5e-3 + (FAR - 5e-3) * random.unit();
                Way { place, back, roll, spread, gap }
            })
            .collect();
        found.extend(feasible(hand, belief, table, ways));
        if found.len() >= count {
            break;
        }
    }
    found
}

/// Those that the belief has nothing against, and by which at least one fingertip would touch.
fn feasible(
    hand: &Articulated,
    belief: &Belief,
    table: Option<f64>,
    ways: Vec<Way>,
) -> Vec<Placement> {
    let shape = &belief.geometry;
    // Built before the threads ask for it.
    shape.distance(&belief.centre);
    let brought: Vec<Placement> =
        ways.par_iter().filter_map(|way| bring(hand, belief, table, way).ok()).collect();
    let met = met(hand, belief, &brought);
    let felt = brought.into_iter().zip(met).filter(|(_, met)| !met.is_empty());
    felt.map(|(placement, _)| placement).collect()
}

/// The grasp at the end of the way.
fn bring(
    hand: &Articulated,
    belief: &Belief,
    table: Option<f64>,
    way: &Way,
) -> Result<Placement, Unreachable> {
    let Geometry::Mesh(mesh) = &belief.geometry else { return Err(Unreachable::NothingFelt) };
    let around = Surroundings { object: Some((mesh, belief.pose)), table };
    let least = Point::ith(way.back.iamin(), 1.0);
    let x = way.back.cross(&least).normalize();
    let facing = Rotation3::from_basis_unchecked(&[x, way.back.cross(&x), way.back]);
    let rotation = UnitQuaternion::from_rotation_matrix(&facing)
        * UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), way.roll);
    let (low, high) = belief.geometry.bounds();
    let far = ((high - low) / 2.0).norm() + START;
    let start = way.place + far * way.back;
    let grasp = belief.pose * Pose::from_parts(Translation3::from(start), rotation);
    let direction = -(belief.pose.rotation * way.back);
    let (along, _) = hand.advance(&grasp, way.spread, &direction, far + INTO, &around);
    let back = (along - way.gap).max(0.0);
    let grasp = Translation3::from(back * direction) * grasp;
    hand.fits(&grasp, way.spread, &around)?;
    Ok(Placement { hand: belief.pose.inverse() * grasp, spread: way.spread })
}
