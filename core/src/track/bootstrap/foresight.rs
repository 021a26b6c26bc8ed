//! What a finger would feel, by the map.

use super::{AMBIGUOUS, APART, Bootstrap, Settings};
use crate::explore::{Doubts, FINGERS, Foresight, Meeting, Stroke};
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::Joint;
use crate::track::is_plausible;

/// Points along a way at which the surface is looked for: what is thinner than a sixteenth of the way
/// through the body may be missed.
const POINTS: usize = 17;

/// Steps of regula falsi (Illinois) from between two of these points to the surface.
const STEPS: usize = 4;

/// How far the body may reach, in distances of the contacts from their middle; and the least of these,
/// metres.
const REACH: f32 = 1.5;
const LEAST_RADIUS: f32 = 0.02;

/// Slopes below this do not make a value a distance.
const LEAST_SLOPE: f32 = 0.3;

/// The belief of a [`Bootstrap`] over a Gaussian process, truncated by faces or not, about the next
/// grasp, made by [`Bootstrap::foresee`].
///
/// A finger meets the zero of the mean. Where nothing was touched the surface is as uncertain as its
/// prior, which makes such places worth a grasp; a way that misses the mean surface is expected to meet
/// nothing. Pose and surface are independent here.
pub struct Foreseen<'a, S: Space, M: Joint<S>> {
    map: &'a M,
    pose: S::Pose,
    covariance: S::Covariance,
    middle: S::Vector,
    radius: f32,
}

impl<S: Space, M: Joint<S>, const PARTICLES: usize> Bootstrap<S, M, PARTICLES> {
    /// What the next grasp would feel: the object is expected to be moved as `motion` says (world to
    /// world), by `None` to stay, up to the motion noise. `None` while the map is empty.
    pub fn foresee(&self, motion: Option<&S::Pose>) -> Option<Foreseen<'_, S, M>> {
        let (mut middle, mut count) = (S::Vector::ZERO, 0.0);
        for point in self.map.touched() {
            middle += point;
            count += 1.0;
        }
        if count == 0.0 {
            return None;
        }
        middle = middle * (1.0 / count);
        let mut radius = LEAST_RADIUS * LEAST_RADIUS;
        for point in self.map.touched() {
            radius = math::max(radius, (point - middle).norm_squared());
        }
        let modes = self.particles.modes(&APART);
        let (pose, mut covariance) = match modes.as_slice().first() {
            Some(heaviest) if modes.disagree(AMBIGUOUS) => {
                self.particles.mean_near(heaviest.pose, &APART)
            }
            _ => self.particles.mean(),
        };
        let noise =
            self.running.as_ref().map_or(Settings::DEFAULT.motion, |running| running.motion);
        let noise = noise.after_losing(self.lost);
        for i in 0..S::FREEDOM {
            let deviation = if i < S::DIMENSION { noise.translation } else { noise.rotation };
            *covariance.at_mut(i, i) += deviation * deviation;
        }
        let motion = motion.filter(|m| is_plausible::<S>(m));
        Some(Foreseen {
            map: &self.map,
            pose: motion.map_or(pose, |m| m.compose(&pose)),
            covariance,
            middle,
            radius: REACH * math::sqrt(radius),
        })
    }
}

impl<S: Space, M: Joint<S>> Foreseen<'_, S, M> {
    /// The surface between two points along a way, where the values are `high` above zero and `low`
    /// not.
    fn between(&self, way: &Stroke<S>, outer: (f32, f32), inner: (f32, f32)) -> f32 {
        let ((mut out, mut high), (mut inside, mut low)) = (outer, inner);
        let mut side = 0;
        for _ in 0..STEPS {
            let at = out + (inside - out) * (high / (high - low));
            let [value] = self.map.values(&[way.at(at)]);
            if value > 0.0 {
                (out, high) = (at, value);
                if side > 0 {
                    low *= 0.5;
                }
                side = 1;
            } else {
                (inside, low) = (at, value);
                if side < 0 {
                    high *= 0.5;
                }
                side = -1;
            }
        }
        out + (inside - out) * (high / (high - low))
    }
}

impl<S: Space, M: Joint<S>> Foresight<S> for Foreseen<'_, S, M> {
    /// Length of the gradient there.
    type Place = f32;

    fn pose(&self) -> S::Pose {
        self.pose
    }

    fn meet(&self, way: &Stroke<S>) -> Option<Meeting<S, f32>> {
        let from = way.start - self.middle;
        let along = from.dot(way.direction);
        let square = along * along - from.norm_squared() + self.radius * self.radius;
        let half = math::sqrt(math::max(square, 0.0));
        let begin = math::max(-along - half, 0.0);
        let end = math::min(half - along, way.travel);
        if !(begin < end) {
            return None;
        }
        let step = (end - begin) * (1.0 / (POINTS - 1) as f32);
        let at = |k: usize| begin + step * k as f32;
        let values = self.map.values(&core::array::from_fn::<_, POINTS, _>(|k| way.at(at(k))));
        let first = values.iter().position(|value| *value <= 0.0)?;
        let hit = match first.checked_sub(1) {
            None => begin,
            Some(before) => {
                let (high, low) = (values[before], values[first]);
                self.between(way, (at(before), high), (at(first), low))
            }
        };
        let point = way.at(hit);
        let gradient = self.map.probe(point).gradient;
        let mut lowest = 0.0;
        for value in &values[first..] {
            lowest = math::min(*value, lowest);
        }
        Some(Meeting {
            point,
            normal: gradient.normalized().unwrap_or(-way.direction),
            depth: -lowest,
            share: 1.0,
            place: math::max(gradient.norm(), LEAST_SLOPE),
        })
    }

    fn doubts(&mut self, meetings: &[Meeting<S, f32>]) -> Doubts {
        let mut doubts = Doubts::NONE;
        let count = meetings.len().min(FINGERS);
        let mut points = [S::Vector::ZERO; FINGERS];
        for (point, met) in points.iter_mut().zip(meetings) {
            *point = met.point;
        }
        let surface = self.map.joint::<FINGERS>(&points[..count]);
        for (j, b) in meetings.iter().enumerate().take(count) {
            let lever = S::lever(b.point, b.normal);
            let mut column = S::Tangent::ZERO;
            for k in 0..S::FREEDOM {
                for l in 0..S::FREEDOM {
                    column[k] += self.covariance.at(k, l) * lever[l];
                }
            }
            for (i, a) in meetings.iter().enumerate().take(j + 1) {
                let pose = S::lever(a.point, a.normal).dot(column);
                let all = pose + surface[i][j] / (a.place * b.place);
                for (m, n) in [(i, j), (j, i)] {
                    (doubts.all[m][n], doubts.pose[m][n]) = (all, pose);
                }
            }
        }
        doubts
    }
}
