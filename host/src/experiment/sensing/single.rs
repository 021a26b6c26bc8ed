//! Whether some single contact explains a wrench: by search over the skin, sharing nothing with the
//! estimator.
//!
//! At a place of the skin the wrenches of all contacts that friction holds form a convex cone:
//! forces within the friction cone, torsion up to so much per newton of normal force. Here it is
//! spanned by its extreme contacts, and the nearest of its wrenches is found by coordinate descent;
//! a compass search over the skin finds the place. Nothing else is known of one reading, so that two
//! contacts whose wrench some single contact explains within the noise cannot be told from it.

use std::f64::consts::{PI, TAU};

use nalgebra::SVector;

use crate::sim::sensors::Skin;
use crate::space::Point;

/// What a contact can hold: tangential over normal force, and torsion over normal force, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Coefficient of friction.
    pub friction: f64,
    /// Metres.
    pub torsion: f64,
}

/// Tangential directions by which a friction cone is spanned.
const DIRECTIONS: usize = 16;

/// Places of the first look, along and around.
const PLACES: (usize, usize) = (24, 24);

/// Best of these that are followed, and halvings of the step on the way.
const FOLLOWED: usize = 4;
const HALVINGS: usize = 10;

/// Sweeps over a cone's edges, at first and when a place is followed.
const SWEEPS: (usize, usize) = (30, 150);

type Wrench = SVector<f64, 6>;

/// A skin, and how its sensor's wrench scatters.
pub struct Search<'a> {
    skin: &'a Skin,
    hold: Hold,
    /// Standard deviations of the wrench's components.
    noise: Wrench,
}

impl<'a> Search<'a> {
    /// Over contacts of `skin` that hold by `hold`, for wrenches with these deviations.
    pub fn new(skin: &'a Skin, hold: Hold, noise: [f64; 6]) -> Self {
        Search { skin, hold, noise: noise.into() }
    }

    /// How far the nearest wrench of any single contact is, in standard deviations; 0 where it is
    /// nearer than `enough`.
    pub fn distance(&self, wrench: &[f64; 6], enough: f64) -> f64 {
        let target = Wrench::from(*wrench).component_div(&self.noise);
        let reach = match *self.skin {
            Skin::Ellipsoid(_) => PI,
            Skin::Finger { radius, length } => 0.5 * PI * radius + length,
        };
        let step = [reach / PLACES.0 as f64, TAU / PLACES.1 as f64];
        let mut found = Vec::new();
        for i in 0..PLACES.0 {
            for j in 0..PLACES.1 {
                let place = [(i as f64 + 0.5) * step[0], j as f64 * step[1]];
                found.push((self.at(&target, place, SWEEPS.0), place));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = f64::INFINITY;
        for (_, mut place) in found.into_iter().take(FOLLOWED) {
            let mut here = self.at(&target, place, SWEEPS.1);
            let mut step = step;
            for _ in 0..HALVINGS {
                // A few steps of each length.
                for _ in 0..4 {
                    let ways = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
                    let tried = ways.map(|[a, b]| {
                        let along = (place[0] + a * step[0]).clamp(0.0, reach);
                        let place = [along, place[1] + b * step[1]];
                        (self.at(&target, place, SWEEPS.1), place)
                    });
                    let next = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
                    match next {
                        Some((value, there)) if value < here => (here, place) = (value, there),
                        _ => break,
                    }
                }
                if here < enough * enough {
                    return 0.0;
                }
                step = step.map(|s| 0.5 * s);
            }
            best = best.min(here);
        }
        best.sqrt()
    }

    /// Squared distance from the wrenches of all contacts at a place.
    fn at(&self, target: &Wrench, [along, around]: [f64; 2], sweeps: usize) -> f64 {
        let (point, outward) = self.skin.at(along, around);
        let edges = self.edges(&point, &outward);
        let squares = edges.map(|edge| edge.norm_squared());
        let (mut rest, mut shares) = (*target, [0.0; 2 * DIRECTIONS]);
        let mut last = f64::INFINITY;
        for _ in 0..sweeps {
            for ((edge, square), share) in edges.iter().zip(&squares).zip(&mut shares) {
                let more = (edge.dot(&rest) / square).max(-*share);
                *share += more;
                rest -= edge * more;
            }
            let now = rest.norm_squared();
            if last - now < 1e-6 * now {
                break;
            }
            last = now;
        }
        rest.norm_squared()
    }

    /// The extreme contacts at a place of a newton of normal force, in standard deviations.
    fn edges(&self, point: &Point, outward: &Point) -> [Wrench; 2 * DIRECTIONS] {
        let axis = Point::from_fn(|i, _| (i == outward.iamin()) as u8 as f64);
        let u = outward.cross(&axis).normalize();
        let v = outward.cross(&u);
        std::array::from_fn(|k| {
            let (sin, cos) = (TAU * (k / 2) as f64 / DIRECTIONS as f64).sin_cos();
            let force = (u * cos + v * sin) * self.hold.friction - outward;
            let torsion = if k % 2 == 0 { self.hold.torsion } else { -self.hold.torsion };
            let moment = point.cross(&force) + outward * torsion;
            let wrench = Wrench::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            wrench.component_div(&self.noise)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::random::Random;
    use crate::sim::sensors::Push;

    const NOISE: [f64; 6] = [0.013, 0.013, 0.018, 1.3e-4, 1.3e-4, 1.3e-4];

    #[test]
    fn single_contacts_are_explained_and_impossible_wrenches_are_not() {
        let [mut random] = Random::streams(3);
        let skin = Skin::Ellipsoid([12e-3, 9e-3, 8e-3]);
        let hold = Hold { friction: 0.8, torsion: 2e-3 };
        let search = Search::new(&skin, hold, NOISE);
        for _ in 0..3 {
            let push = Push::new(skin.sample(&mut random), 1.0, 0.7, random.direction(3));
            assert_eq!(search.distance(&push.twisted(1.5e-3).wrench(), 1.0), 0.0);
        }
        // A pinch: hardly any force, but a moment that no contact holds; and a torsion beyond.
        assert!(search.distance(&[0.0, 0.0, 0.1, 0.02, 0.0, 0.0], 1.0) > 10.0);
        let push = Push::new(skin.at(1.0, 0.3), 1.0, 0.0, Point::zeros());
        assert!(search.distance(&push.twisted(6e-3).wrench(), 1.0) > 3.0);
    }
}
