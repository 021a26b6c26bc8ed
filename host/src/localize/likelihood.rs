//! How likely contacts are on an object at a pose, and which small motion makes them likelier.
//!
//! With u the distance of a contact from the surface in its standard deviations, the contact costs
//! h(u) = 4(√(1 + u²/4) − 1) nats: u²/2 where contacts fit, 2|u| far beyond, the hyperbolic
//! distribution (Barndorff-Nielsen 1977). Contacts that fit as well as they say are weighed as
//! Gaussian ones, and least squares of them sought; of contacts with errors nobody stated, a finger
//! bent or a model that differs, the least mean distance; no contact pulls harder than two standard
//! deviations' worth. A measured normal costs g(e/σ) = c(1 − exp(−e²/2cσ²)) beside that, e the chord
//! between it and the face's normal: at an edge it may be any of two faces', so that it never counts
//! for more than c = 5 nats.

use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector6};

use super::Surface;
use crate::reference::Contact;
use crate::space::{Point, Pose, centroid};

/// What a normal that fits nothing costs, nats.
const WORST_NORMAL: f64 = 5.0;

/// Normals are never taken to be worse than this, radians: farther off they would mean nothing.
const LOOSEST: f64 = 0.7;

/// How far to both sides a surface is asked how it bends, in radii of the object, and the chord between normals
/// there from which on an edge lies between them.
const BEND: f64 = 0.02;
const EDGE: f64 = 0.5;

/// What contacts say about the pose of one object.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    /// World frame.
    pub contacts: Vec<Contact>,
    /// Turns are about this point, object frame.
    pub centre: Point,
    /// A turn by one radian counts as a shift by this, metres: the object's radius.
    pub radius: f64,
}

/// The likelihood about a pose, to second order in a small motion of the contacts in the object
/// frame: shift v, then turn u/radius about the centre, both metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quadratic {
    /// Negative logarithm of the likelihood, zero for contacts that fit exactly.
    pub nats: f64,
    /// Gauss–Newton approximation, per square metre.
    hessian: Matrix6<f64>,
    /// Half of the downhill gradient.
    downhill: Vector6<f64>,
}

/// Rows below the diagonal of the second derivatives, one after the other.
type Packed = [f64; 21];

impl Evidence {
    /// The contacts as they lie in the object frame, normals turned too; `seen` maps world to
    /// object.
    #[inline]
    fn placed(&self, seen: &Pose) -> impl Iterator<Item = (Point, Option<Point>, &Contact)> {
        let m = seen.rotation.to_rotation_matrix().into_inner();
        let t = seen.translation.vector;
        // Written out: this is the innermost loop, and a matrix product is a call there.
        let turned = move |p: &Point| {
            let row = |i: usize| m[(i, 0)] * p.x + m[(i, 1)] * p.y + m[(i, 2)] * p.z;
            Point::new(row(0), row(1), row(2))
        };
        self.contacts.iter().map(move |c| {
            let y = turned(&c.point);
            (Point::new(y.x + t.x, y.y + t.y, y.z + t.z), c.normal.as_ref().map(&turned), c)
        })
    }

    /// Negative logarithm of the likelihood when the deviations are `width` times what they are
    /// said to be; `seen` maps world to object.
    pub fn nats<S: Surface>(&self, surface: &S, seen: &Pose, width: f64) -> f64 {
        let mut nats = 0.0;
        for (y, normal, contact) in self.placed(seen) {
            let near = surface.near(&y);
            let deviation = contact.point_deviation * width;
            nats += cost(near.distance * near.distance / (deviation * deviation)).0;
            if let Some(normal) = normal {
                let chord = (normal - surface.normal(&near, &y)).norm_squared();
                nats += normal_cost(chord / loosened(contact, width).powi(2)).0;
            }
        }
        nats
    }

    /// The likelihood about `seen`.
    pub fn about<S: Surface>(&self, surface: &S, seen: &Pose, width: f64) -> Quadratic {
        let mut nats = 0.0;
        let mut curvature: Packed = [0.0; 21];
        let mut downhill = [0.0; 6];
        for (y, normal, contact) in self.placed(seen) {
            let near = surface.near(&y);
            let deviation = contact.point_deviation * width;
            let precision = 1.0 / (deviation * deviation);
            let (costs, pull) = cost(near.distance * near.distance * precision);
            nats += costs;
            let weight = pull * precision;
            let row = self.row(&y, &near.gradient);
            let mut at = 0;
            for i in 0..6 {
                let weighted = weight * row[i];
                downhill[i] -= weighted * near.distance;
                for j in 0..=i {
                    curvature[at] += weighted * row[j];
                    at += 1;
                }
            }
            if let Some(measured) = normal {
                let normal = surface.normal(&near, &y);
                let precision = 1.0 / loosened(contact, width).powi(2);
                let excess = (measured - normal).norm_squared() * precision;
                let (costs, pull) = normal_cost(excess);
                nats += costs;
                let weight = pull * precision / self.radius;
                let towards = measured.cross(&normal);
                // Turning the normal leaves it where it is along itself.
                let across = weight / self.radius;
                for i in 0..3 {
                    downhill[3 + i] += weight * towards[i];
                    let first = (3 + i) * (4 + i) / 2 + 3;
                    for j in 0..=i {
                        curvature[first + j] -= across * measured[i] * measured[j];
                    }
                    curvature[first + i] += across;
                }
            }
        }
        let mut hessian = Matrix6::zeros();
        let mut at = 0;
        for i in 0..6 {
            for j in 0..=i {
                (hessian[(i, j)], hessian[(j, i)]) = (curvature[at], curvature[at]);
                at += 1;
            }
        }
        Quadratic { nats, hessian, downhill: Vector6::from(downhill) }
    }

    /// Of the distance of a contact at `y`, by shift and by turn.
    #[inline]
    fn row(&self, y: &Point, gradient: &Point) -> [f64; 6] {
        let (c, g, part) = (&self.centre, gradient, 1.0 / self.radius);
        let arm = [part * (y.x - c.x), part * (y.y - c.y), part * (y.z - c.z)];
        let x = arm[1] * g.z - arm[2] * g.y;
        let z = arm[0] * g.y - arm[1] * g.x;
        [g.x, g.y, g.z, x, arm[2] * g.x - arm[0] * g.z, z]
    }

    /// `seen` after a motion of the contacts in the object frame.
    pub fn moved(&self, seen: &Pose, motion: &Vector6<f64>) -> Pose {
        let shift = Point::new(motion[0], motion[1], motion[2]);
        let turn = Point::new(motion[3], motion[4], motion[5]) / self.radius;
        let about = nalgebra::UnitQuaternion::from_scaled_axis(turn);
        let arm = seen.translation.vector - self.centre;
        let translation = self.centre + shift + about * arm;
        let mut rotation = about * seen.rotation;
        rotation.renormalize();
        Pose::from_parts(translation.into(), rotation)
    }

    /// Fisher information on the pose at `seen`, per square metre, see [`Quadratic`]: what the
    /// contacts would say were all of them where the surface is, with the [misfit](Self::misfit)
    /// they have.
    pub fn information<S: Surface>(&self, surface: &S, seen: &Pose, misfit: f64) -> Matrix6<f64> {
        // Of a Gaussian with that variance, or of a Laplace distribution with that mean.
        let worse = misfit.max(misfit * misfit / 4.0);
        let mut information = Matrix6::zeros();
        for (y, _, contact) in self.placed(seen) {
            let near = surface.near(&y);
            let row = Vector6::from(self.row(&y, &near.gradient));
            let weight = 1.0 / (contact.point_deviation.powi(2) * worse);
            information.ger(weight, &row, &row, 1.0);
            if contact.normal.is_some() {
                let weight = contact.normal_deviation.powi(-2) / worse;
                let change = self.turned(surface, &y, &surface.normal(&near, &y));
                information += weight * change.transpose() * change;
            }
        }
        information
    }

    /// How the normal measured at `y` turns against the surface's there, by shift and by turn: the object's own
    /// turns with it where the surface is round, so that a cylinder's say nothing of a turn about its axis.
    fn turned<S: Surface>(&self, surface: &S, y: &Point, normal: &Point) -> Matrix3x6<f64> {
        let step = BEND * self.radius;
        let mut bend = Matrix3::zeros();
        for axis in 0..3 {
            let [ahead, behind] = [step, -step].map(|step| {
                let beside = y + Point::ith(axis, step);
                surface.normal(&surface.near(&beside), &beside)
            });
            let change = ahead - behind;
            // Over an edge: on either side of it the surface is as flat as it is.
            if change.norm() < EDGE {
                bend.set_column(axis, &(change / (2.0 * step)));
            }
        }
        let arm = (y - self.centre) / self.radius;
        // ω × a is −[a]× ω.
        let turn = bend * arm.cross_matrix() - normal.cross_matrix() / self.radius;
        let mut change = Matrix3x6::zeros();
        change.fixed_view_mut::<3, 3>(0, 0).copy_from(&-bend);
        change.fixed_view_mut::<3, 3>(0, 3).copy_from(&turn);
        change
    }

    /// Unsigned distance of every contact at `seen`, metres.
    pub fn distances<S: Surface>(&self, surface: &S, seen: &Pose) -> Vec<f64> {
        self.placed(seen).map(|(y, ..)| surface.near(&y).distance.abs()).collect()
    }

    /// By how much the cost of the contacts' distances at `seen` exceeds what their deviations
    /// promise: the likeliest factor, corrected for the six numbers that were fitted; one nat then
    /// is worth so much less. One where contacts are too few to tell, and never less.
    pub fn misfit<S: Surface>(&self, surface: &S, seen: &Pose) -> f64 {
        let spare = self.contacts.len() as f64 - 6.0;
        if spare < 4.0 {
            return 1.0;
        }
        let slope = |(y, _, c): (Point, Option<Point>, &Contact)| {
            let squared = (surface.near(&y).distance / c.point_deviation).powi(2);
            squared * cost(squared).1
        };
        (self.placed(seen).map(slope).sum::<f64>() / spare).max(1.0)
    }

    /// The `count` contacts that are farthest apart, from the one farthest from their middle on;
    /// all where there are no more.
    pub fn spread(&self, count: usize) -> Evidence {
        let mut left = self.contacts.clone();
        let mut chosen: Vec<Contact> = Vec::new();
        let middle = centroid(left.iter().map(|c| c.point));
        let mut apart: Vec<f64> = left.iter().map(|c| (c.point - middle).norm()).collect();
        let mut first = true;
        while chosen.len() < count {
            let farthest = (0..left.len()).max_by(|a, b| apart[*a].total_cmp(&apart[*b]));
            let Some(at) = farthest else { break };
            let next = left.swap_remove(at);
            apart.swap_remove(at);
            for (d, c) in apart.iter_mut().zip(&left) {
                let distance = (c.point - next.point).norm();
                *d = if first { distance } else { d.min(distance) };
            }
            first = false;
            chosen.push(next);
        }
        Evidence { contacts: chosen, ..*self }
    }
}

impl Quadratic {
    /// The Gauss–Newton step, `damping` times the mean curvature added in every direction.
    pub fn step(&self, damping: f64) -> Option<Vector6<f64>> {
        let mean = self.hessian.trace() / 6.0;
        let damped = self.hessian + Matrix6::identity() * (damping * mean);
        damped.cholesky().map(|c| c.solve(&self.downhill))
    }

    /// The same with no part along the unit vector `valley`.
    pub fn step_across(&self, valley: &Vector6<f64>) -> Option<Vector6<f64>> {
        let across = Matrix6::identity() - valley * valley.transpose();
        let stiff = valley * valley.transpose() * self.hessian.trace();
        let damping = Matrix6::identity() * (1e-6 * self.hessian.trace());
        let held = across * self.hessian * across + stiff + damping;
        held.cholesky().map(|c| c.solve(&(across * self.downhill)))
    }
}

/// Standard deviation of a contact's normal at this width, radians.
#[inline]
fn loosened(contact: &Contact, width: f64) -> f64 {
    (contact.normal_deviation * width).min(LOOSEST)
}

/// h(u) and h'(u)/u of the module, for u².
#[inline]
fn cost(squared: f64) -> (f64, f64) {
    let root = (1.0 + squared / 4.0).sqrt();
    (4.0 * (root - 1.0), 1.0 / root)
}

/// g(u) and g'(u)/u of the module, for u².
#[inline]
fn normal_cost(squared: f64) -> (f64, f64) {
    let fits = (-squared / (2.0 * WORST_NORMAL)).exp();
    (WORST_NORMAL * (1.0 - fits), fits)
}
