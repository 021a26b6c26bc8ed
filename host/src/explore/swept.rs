//! The contacts that the fingertips of an articulated hand would give, by the belief: balls on their ways
//! against the believed shape, as far as the table lets them. What the inner links might run into is left
//! to the trial.

use nalgebra::Point3;
use rayon::prelude::*;

use super::belief::Belief;
use super::placement::Placement;
use super::prediction::{DEPTHS, Expected, Met};
use crate::shape::Geometry;
use crate::sim::hand::{Articulated, FingerPath};
use crate::space::Point;

/// A fingertip nearer than this touches, metres.
const TOUCHING: f64 = 2e-5;

/// Steps along a way at most.
const MOST_STEPS: usize = 400;

/// Where a fingertip on its way first touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// On the surface, metres.
    pub point: Point,
    /// Towards the fingertip, unit.
    pub normal: Point,
    /// How far along the way its middle is then, metres.
    pub along: f64,
}

/// What the fingertips meet on their ways, for each placement.
pub(super) fn met(hand: &Articulated, belief: &Belief, placements: &[Placement]) -> Vec<Vec<Met>> {
    let one = |placement: &Placement| {
        let met = |path: &FingerPath| {
            let path = placed(path, placement);
            let hit = felt(belief, &path)?;
            let left = (length(&path) - hit.along).min(belief.radius);
            let share = |k: usize| left * (k + 1) as f64 / DEPTHS as f64;
            let Hit { point, normal, along } = hit;
            Some(Met {
                contact: Expected { finger: path.finger, point, normal, chance: 1.0 },
                deeper: std::array::from_fn(|k| at(&path, along + share(k))),
                radius: path.radius,
            })
        };
        hand.paths(placement.spread).iter().filter_map(met).collect()
    };
    placements.par_iter().map(one).collect()
}

/// How many fingertips meet the believed shape on their ways.
pub(super) fn count(hand: &Articulated, belief: &Belief, placement: &Placement) -> usize {
    let touches = |path: &&FingerPath| felt(belief, &placed(path, placement)).is_some();
    hand.paths(placement.spread).iter().filter(touches).count()
}

/// The way in the object frame.
fn placed(path: &FingerPath, placement: &Placement) -> FingerPath {
    let place = |point: &Point| (placement.hand * Point3::from(*point)).coords;
    FingerPath { points: path.points.iter().map(place).collect(), ..*path }
}

/// Where the fingertip touches the believed shape, unless the table stops it before.
fn felt(belief: &Belief, path: &FingerPath) -> Option<Hit> {
    let height = |point: &Point| (belief.pose * Point3::from(*point)).z;
    let stopped = belief.table.and_then(|table| {
        let mut along = 0.0;
        for (i, point) in path.points.iter().enumerate() {
            along += if i > 0 { (point - path.points[i - 1]).norm() } else { 0.0 };
            if height(point) < table + path.radius {
                return Some(along);
            }
        }
        None
    });
    cast(path, &belief.geometry).filter(|hit| stopped.is_none_or(|along| hit.along <= along))
}

fn length(path: &FingerPath) -> f64 {
    path.points.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
}

/// The place so far along the way; its end when that is too far.
fn at(path: &FingerPath, mut along: f64) -> Point {
    for pair in path.points.windows(2) {
        let edge = pair[1] - pair[0];
        let length = edge.norm();
        if along <= length {
            return pair[0] + edge * (along / length.max(1e-12));
        }
        along -= length;
    }
    path.points.last().copied().unwrap_or_else(Point::zeros)
}

/// Where a fingertip first touches the shape on its way: by steps as long as the distance to it, which
/// miss nothing.
pub fn cast(path: &FingerPath, geometry: &Geometry) -> Option<Hit> {
    let whole = length(path);
    let mut along = 0.0;
    for _ in 0..MOST_STEPS {
        let middle = at(path, along);
        let closest = geometry.closest(&middle);
        let away = middle - closest;
        let gap = away.norm() - path.radius;
        if gap <= TOUCHING {
            let normal = away.try_normalize(1e-9)?;
            return Some(Hit { point: closest, normal, along });
        }
        if along >= whole {
            return None;
        }
        along = (along + gap).min(whole);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    #[test]
    fn a_ball_on_its_way_touches_where_it_should() {
        let geometry = "sphere:0.06".parse::<ObjectSpec>().unwrap().geometry().unwrap();
        let points = vec![Point::new(0.1, 0.1, 0.0), Point::new(0.1, 0.0, 0.0), Point::zeros()];
        let path = FingerPath { finger: 3, points, radius: 0.008 };
        let hit = cast(&path, &geometry).unwrap();
        assert!((hit.point - Point::new(0.03, 0.0, 0.0)).norm() < 2e-4, "{hit:?}");
        assert!((hit.normal - Point::x()).norm() < 0.02);
        assert!((hit.along - (0.1 + 0.1 - 0.038)).abs() < 2e-4);
        let aside = FingerPath {
            points: path.points.iter().map(|p| p + 0.05 * Point::z()).collect(),
            ..path
        };
        assert_eq!(cast(&aside, &geometry), None);
    }
}
