//! Laplace proposals: where a grasp may have met the surface, from starts across what the motion leaves
//! open.

use core::f32::consts::PI;

use super::memory::Touch;
use super::small::{Definite, times};
use super::trajectory::{bounded, lever};
use crate::contact::FreePoint;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::{Bend, Probe, Revisable};
use crate::track::Separation;
use crate::track::likelihood::{FREEDOM, LEAST_SLOPE};

/// Gauss–Newton steps of one start.
const STEPS: usize = 8;

/// Steps below this (metres and radians mixed, squared) end the search.
const SETTLED: f32 = 4e-8;

/// Candidates kept of one hypothesis.
pub(super) const CANDIDATES: usize = 8;

/// Candidates closer than this are one.
const SAME: Separation = Separation { translation: 0.003, rotation: 0.06 };

/// Deviation of a free fingertip, metres: it has a radius.
const TIP: f32 = 0.004;

/// How often the surface is wrong about where a finger met nothing: much of it is untouched.
const DOUBT: f32 = 0.05;

/// Gaussian belief over a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<S: Space> {
    pub pose: S::Pose,
    pub covariance: S::Covariance,
}

/// A pose at which the grasp fits, and how well: log posterior of the pose's neighbourhood (Laplace)
/// with contacts taken as independent, up to a constant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate<S: Space> {
    pub pose: S::Pose,
    pub score: f32,
    /// What of it is due to fingers that met nothing.
    pub free: f32,
}

/// The best different candidates, best first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates<S: Space> {
    list: [Candidate<S>; CANDIDATES],
    count: usize,
}

impl<S: Space> Candidates<S> {
    pub fn new() -> Self {
        let none = Candidate { pose: S::Pose::IDENTITY, score: f32::NEG_INFINITY, free: 0.0 };
        Candidates { list: [none; CANDIDATES], count: 0 }
    }

    pub fn as_slice(&self) -> &[Candidate<S>] {
        &self.list[..self.count]
    }

    /// Whether one lies there.
    fn has(&self, pose: &S::Pose) -> bool {
        self.as_slice().iter().any(|c| SAME.between::<S>(&c.pose, pose) < 1.0)
    }

    /// Takes a candidate in, unless a better one lies there.
    fn add(&mut self, candidate: Candidate<S>) {
        let same = |c: &Candidate<S>| SAME.between::<S>(&c.pose, &candidate.pose) < 1.0;
        if let Some(place) = self.as_slice().iter().position(same) {
            if self.list[place].score >= candidate.score {
                return;
            }
            self.list.copy_within(place + 1..self.count, place);
            self.count -= 1;
        }
        let place =
            self.as_slice().iter().take_while(|other| other.score >= candidate.score).count();
        if place >= CANDIDATES {
            return;
        }
        let last = self.count.min(CANDIDATES - 1);
        self.list.copy_within(place..last, place + 1);
        self.list[place] = candidate;
        self.count = last + 1;
    }
}

/// Everything a proposal looks at.
pub(super) struct Scene<'a, S: Space, M> {
    pub map: &'a M,
    pub touches: &'a [Touch<S>],
    pub free: &'a [FreePoint<S>],
    pub prediction: Prediction<S>,
    /// Where the object's middle is, object frame.
    pub middle: S::Vector,
}

impl<S: Space, M: Revisable<S>> Scene<'_, S, M> {
    /// The best fits from all starts. `None` when the prediction is no distribution.
    pub fn propose(&self) -> Option<Candidates<S>> {
        let prior = Definite::<S>::new(&self.prediction.covariance)?;
        let information = prior.inverse();
        let spread = -prior.half_log_determinant();
        let mut candidates = Candidates::new();
        let wide = self.spread(S::DIMENSION) > WIDE;
        let count = if wide {
            WIDE_STARTS
        } else {
            1 + 4 * (S::FREEDOM - S::DIMENSION) + usize::from(S::DIMENSION == 2) * 2
        };
        for number in 0..count {
            let start = if wide { self.wide_start(number) } else { self.start(number) };
            if let Some(mut candidate) = self.climb(start, &information, &candidates) {
                candidate.score += spread;
                candidates.add(candidate);
            }
        }
        Some(candidates)
    }

    /// Predicted standard deviation along an axis of the pose.
    fn spread(&self, axis: usize) -> f32 {
        math::sqrt(math::max(self.prediction.covariance.at(axis, axis), 0.0))
    }

    /// Rotations by whole parts of the deviation about each axis.
    fn start(&self, number: usize) -> S::Pose {
        let mut turn = S::Tangent::ZERO;
        if let Some(number) = number.checked_sub(1) {
            let axes = S::FREEDOM - S::DIMENSION;
            let axis = S::DIMENSION + number / 2 % axes;
            let sign = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
            let far = 0.8 * (1 + number / (2 * axes)) as f32;
            turn[axis] = math::min(far * self.spread(axis), PI) * sign;
        }
        self.prediction.pose.retract(turn)
    }

    /// Rotations all around, the middle of the object in the middle of the contacts or where it is
    /// predicted, in turn.
    fn wide_start(&self, number: usize) -> S::Pose {
        let mut turn = S::Tangent::ZERO;
        // Evenly spread over the rotations that the prediction allows: van der Corput in bases 2, 3, 5.
        for axis in S::DIMENSION..S::FREEDOM {
            let base = [2, 3, 5][(axis - S::DIMENSION) % 3];
            let reach = math::min(2.0 * self.spread(axis), PI);
            turn[axis] = (2.0 * radical_inverse(number / 2 + 1, base) - 1.0) * reach;
        }
        let turned = self.prediction.pose.retract(turn);
        if number.is_multiple_of(2) {
            return turned;
        }
        let mut felt = S::Vector::ZERO;
        for touch in self.touches {
            felt += touch.point;
        }
        felt = felt * (1.0 / self.touches.len().max(1) as f32);
        let off = turned.unrotate(felt - turned.transform(self.middle));
        let mut shift = S::Tangent::ZERO;
        for axis in 0..S::DIMENSION {
            shift[axis] = off[axis];
        }
        turned.retract(shift)
    }

    /// Gauss–Newton on contacts and prediction.
    fn climb(
        &self,
        start: S::Pose,
        information: &S::Covariance,
        found: &Candidates<S>,
    ) -> Option<Candidate<S>> {
        let mut pose = start;
        for step in 0..=STEPS {
            // What comes to where another start ended would end there too.
            if step > 0 && found.has(&pose) {
                return None;
            }
            let apart = pose.local(&self.prediction.pose);
            let pull = times::<S>(information, apart);
            let mut normal = Normal { matrix: *information, right: pull, log: 0.0 };
            for touch in self.touches {
                self.weigh(touch, &pose, &mut normal);
            }
            let solved = Definite::<S>::new(&normal.matrix)?;
            let move_by = bounded::<S>(solved.solve(normal.right), &self.prediction.covariance);
            if !move_by.is_finite() {
                return None;
            }
            if step == STEPS || move_by.norm_squared() < SETTLED {
                let prior = -0.5 * apart.dot(pull);
                let score = normal.log + prior - solved.half_log_determinant();
                let free = self.log_free(&pose);
                return Some(Candidate { pose, score: score + free, free });
            }
            pose = pose.retract(move_by);
        }
        None
    }

    /// Adds one contact to the normal equations.
    fn weigh(&self, touch: &Touch<S>, pose: &S::Pose, normal: &mut Normal<S>) {
        let contact = touch.seen_from(pose);
        let (probe, bend) = self.map.sense(contact.point);
        let slope = math::max(probe.gradient.norm(), LEAST_SLOPE);
        let scale = 1.0 / slope;
        let variance =
            contact.point_deviation * contact.point_deviation + probe.variance * scale * scale;
        let distance = probe.value * scale;
        let felt = contact.normal.filter(|_| probe.gradient.norm() > LEAST_SLOPE);
        let bend = match felt {
            Some(_) => across(&bend, scale),
            None => Bend { gradient: probe.gradient * scale, curvature: [S::Vector::ZERO; 3] },
        };
        let mut squared = distance * distance / variance;
        let mut freedom = 1.0;
        let mut turns = 1.0;
        if let Some(n) = felt {
            turns = contact.normal_deviation * contact.normal_deviation
                + probe.slope_variance * scale * scale;
            squared += (n - bend.gradient).norm_squared() / turns;
            freedom = S::DIMENSION as f32;
        }
        let trust = (FREEDOM + freedom) / (FREEDOM + squared);
        normal.log -= 0.5 * (FREEDOM + freedom) * math::ln(1.0 + squared / FREEDOM)
            + 0.5 * math::ln(variance)
            + 0.5 * (freedom - 1.0) * math::ln(turns);
        // Row: residual e + J·δ, where the lever is −J of the observation, J of the residual's change.
        normal.add(trust / variance, -distance, lever(&contact, &bend, 0));
        if let Some(n) = felt {
            for axis in 0..S::DIMENSION {
                let residual = n[axis] - bend.gradient[axis];
                normal.add(trust / turns, residual, lever(&contact, &bend, 1 + axis));
            }
        }
    }

    /// Log probability that fingertips which met nothing are outside.
    fn log_free(&self, pose: &S::Pose) -> f32 {
        let mut sum = 0.0;
        for free in self.free {
            if !free.point.is_finite() {
                continue;
            }
            let probe: Probe<S> = self.map.probe(pose.untransform(free.point));
            let slope = math::max(probe.gradient.norm(), LEAST_SLOPE);
            let deviation = math::sqrt(TIP * TIP + probe.variance / (slope * slope));
            let height = probe.value / (slope * deviation);
            // So far away that f overflows is outside.
            let outside = if height.is_finite() { math::normal(height).1 } else { 1.0 };
            sum += math::ln(DOUBT + (1.0 - 2.0 * DOUBT) * outside);
        }
        sum
    }
}

/// Rotations known worse than this (radians) are searched all around.
const WIDE: f32 = 0.8;

/// Starts of a wide search.
const WIDE_STARTS: usize = 48;

/// The digits of `number` in `base` behind the point, reversed: in (0, 1).
fn radical_inverse(number: usize, base: usize) -> f32 {
    let (mut rest, mut unit, mut value) = (number, 1.0, 0.0);
    while rest > 0 {
        unit /= base as f32;
        value += unit * (rest % base) as f32;
        rest /= base;
    }
    value
}

/// The bend of the field that f/|∇f| approximates: unit gradient, slopes across it.
fn across<S: Space>(bend: &Bend<S>, scale: f32) -> Bend<S> {
    let gradient = bend.gradient * scale;
    let mut along = S::Vector::ZERO;
    for axis in 0..S::DIMENSION {
        along += bend.curvature[axis] * (gradient[axis] * scale);
    }
    let mut curvature = [S::Vector::ZERO; 3];
    for axis in 0..S::DIMENSION {
        curvature[axis] = bend.curvature[axis] * scale - along * gradient[axis];
    }
    Bend { gradient, curvature }
}

/// Normal equations of a step, and the log likelihood where they were set up.
struct Normal<S: Space> {
    matrix: S::Covariance,
    right: S::Tangent,
    log: f32,
}

impl<S: Space> Normal<S> {
    /// A residual e whose change with the pose is −lever.
    fn add(&mut self, precision: f32, residual: f32, lever: S::Tangent) {
        self.matrix.add_outer(precision, lever, lever);
        self.right += lever * (precision * residual);
    }
}
