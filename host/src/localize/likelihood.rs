//! How likely contacts are on an object at a pose, and which small motion makes them likelier.
//!
//! With d the distance of contact i from the surface and σ its standard deviation, the contact
//! costs (ν+1)/2 · ln(1 + d²/νσ²) nats: Student's t distribution, Gaussian at heart with tails for
//! wild points, which pull the less the farther they are. A measured normal costs
//! (ν+2)/2 · ln(1 + e²/νσ_θ²) beside it, e the chord between it and the face's normal.

use nalgebra::{Matrix6, Vector6};

use super::{Near, Surface};
use crate::reference::Contact;
use crate::space::{Point, Pose};

/// Degrees of freedom of the t distribution.
const FREEDOM: f64 = 4.0;

/// Normals are never taken to be worse than this, radians: farther off they would mean nothing.
const LOOSEST: f64 = 0.7;

/// Contacts whose factors are multiplied before a logarithm is taken.
const CHUNK: usize = 16;

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
    /// Negative logarithm of the likelihood, without what does not depend on the pose.
    pub nats: f64,
    /// Gauss–Newton approximation, per square metre.
    hessian: Matrix6<f64>,
    /// Half of the downhill gradient.
    downhill: Vector6<f64>,
}

impl Evidence {
    /// The contacts as they lie in the object frame: `seen` maps world to object.
    fn placed(&self, seen: &Pose) -> impl Iterator<Item = (Point, &Contact)> {
        let turn = seen.rotation.to_rotation_matrix().into_inner();
        let shift = seen.translation.vector;
        self.contacts.iter().map(move |c| (turn * c.point + shift, c))
    }

    /// Negative logarithm of the likelihood when the deviations are `scale` times what they are
    /// said to be; `seen` maps world to object.
    pub fn nats<S: Surface>(&self, surface: &S, seen: &Pose, scale: f64) -> f64 {
        let mut total = 0.0;
        let (mut points, mut normals) = (1.0, 1.0);
        for (k, (y, contact)) in self.placed(seen).enumerate() {
            let near = surface.near(&y);
            points *= 1.0 + squared(near.distance, contact.point_deviation * scale) / FREEDOM;
            if let Some(normal) = contact.normal {
                let chord = (seen.rotation * normal - near.normal).norm();
                normals *= 1.0 + squared(chord, loosened(contact, scale)) / FREEDOM;
            }
            if k % CHUNK == CHUNK - 1 {
                total += logarithm(points, normals);
                (points, normals) = (1.0, 1.0);
            }
        }
        total + logarithm(points, normals)
    }

    /// The likelihood about `seen`.
    pub fn about<S: Surface>(&self, surface: &S, seen: &Pose, scale: f64) -> Quadratic {
        let mut nats = 0.0;
        let (mut points, mut normals) = (1.0, 1.0);
        let mut hessian = Matrix6::zeros();
        let mut downhill = Vector6::zeros();
        for (k, (y, contact)) in self.placed(seen).enumerate() {
            let Near { distance, gradient, normal } = surface.near(&y);
            let variance = (contact.point_deviation * scale).powi(2);
            let excess = distance * distance / variance;
            points *= 1.0 + excess / FREEDOM;
            let weight = (FREEDOM + 1.0) / (FREEDOM + excess) / variance;
            let row = self.row(&y, &gradient);
            for i in 0..6 {
                let weighted = weight * row[i];
                downhill[i] -= weighted * distance;
                for j in i..6 {
                    hessian[(j, i)] += weighted * row[j];
                }
            }
            if let Some(measured) = contact.normal {
                let measured = seen.rotation * measured;
                let variance = loosened(contact, scale).powi(2);
                let excess = (measured - normal).norm_squared() / variance;
                normals *= 1.0 + excess / FREEDOM;
                let weight = (FREEDOM + 2.0) / (FREEDOM + excess) / variance;
                let towards = measured.cross(&normal);
                for i in 0..3 {
                    downhill[3 + i] += weight / self.radius * towards[i];
                    for j in i..3 {
                        let across = if i == j { 1.0 } else { 0.0 } - measured[i] * measured[j];
                        hessian[(3 + j, 3 + i)] += weight / (self.radius * self.radius) * across;
                    }
                }
            }
            if k % CHUNK == CHUNK - 1 {
                nats += logarithm(points, normals);
                (points, normals) = (1.0, 1.0);
            }
        }
        hessian.fill_upper_triangle_with_lower_triangle();
        Quadratic { nats: nats + logarithm(points, normals), hessian, downhill }
    }

    /// Of the distance of a contact at `y`, by shift and by turn.
    fn row(&self, y: &Point, gradient: &Point) -> [f64; 6] {
        let turn = (y - self.centre).cross(gradient) / self.radius;
        [gradient.x, gradient.y, gradient.z, turn.x, turn.y, turn.z]
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
    /// contacts would say were all of them where the surface is.
    pub fn information<S: Surface>(&self, surface: &S, seen: &Pose, scale: f64) -> Matrix6<f64> {
        let mut information = Matrix6::zeros();
        for (y, contact) in self.placed(seen) {
            let near = surface.near(&y);
            let row = Vector6::from(self.row(&y, &near.gradient));
            let share = (FREEDOM + 1.0) / (FREEDOM + 3.0);
            let variance = (contact.point_deviation * scale).powi(2);
            information.ger(share / variance, &row, &row, 1.0);
            if contact.normal.is_some() {
                let share = (FREEDOM + 2.0) / (FREEDOM + 4.0);
                let weight = share / (loosened(contact, scale) * self.radius).powi(2);
                let across = nalgebra::Matrix3::identity() - near.normal * near.normal.transpose();
                let mut turns = information.fixed_view_mut::<3, 3>(3, 3);
                turns += weight * across;
            }
        }
        information
    }

    /// Unsigned distance of every contact at `seen`, metres.
    pub fn distances<S: Surface>(&self, surface: &S, seen: &Pose) -> Vec<f64> {
        self.placed(seen).map(|(y, _)| surface.near(&y).distance.abs()).collect()
    }

    /// How much worse than said the contacts' distances are at `seen`: the maximum of the
    /// likelihood over the scale, by expectation–maximisation, corrected for the six numbers that
    /// were fitted. One where contacts are too few to tell, and never less.
    pub fn scale<S: Surface>(&self, surface: &S, seen: &Pose) -> f64 {
        let excess: Vec<f64> = self
            .placed(seen)
            .map(|(y, c)| squared(surface.near(&y).distance, c.point_deviation))
            .collect();
        let spare = excess.len() as f64 - 6.0;
        if spare < 4.0 {
            return 1.0;
        }
        let mut variance = excess.iter().sum::<f64>() / spare;
        for _ in 0..20 {
            let weighted = |e: &f64| (FREEDOM + 1.0) * e / (FREEDOM + e / variance.max(1e-12));
            variance = excess.iter().map(weighted).sum::<f64>() / spare;
        }
        variance.sqrt().max(1.0)
    }

    /// The `count` contacts that are farthest apart, from the one farthest from their middle on;
    /// all where there are no more.
    pub fn spread(&self, count: usize) -> Evidence {
        let mut left = self.contacts.clone();
        let mut chosen: Vec<Contact> = Vec::new();
        let middle = left.iter().map(|c| c.point).sum::<Point>() / left.len().max(1) as f64;
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

/// Squared in units of the standard deviation.
#[inline]
fn squared(distance: f64, deviation: f64) -> f64 {
    let relative = distance / deviation;
    relative * relative
}

/// Standard deviation of a contact's normal at this scale, radians.
#[inline]
fn loosened(contact: &Contact, scale: f64) -> f64 {
    (contact.normal_deviation * scale).min(LOOSEST)
}

fn logarithm(points: f64, normals: f64) -> f64 {
    (FREEDOM + 1.0) / 2.0 * points.ln() + (FREEDOM + 2.0) / 2.0 * normals.ln()
}
