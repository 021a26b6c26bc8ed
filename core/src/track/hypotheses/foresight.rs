//! What a finger would feel, by the faces of the best answer.

use super::Hypotheses;
use super::chart::{Chart, across};
use super::hypothesis::Hypothesis;
use super::joint::Sparse;
use super::plane::Record;
use crate::explore::{Doubts, FINGERS, Foresight, Meeting, Stroke};
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};
use crate::surface::{Kernel, Matern32};
use crate::track::is_plausible;

/// How a surface may stray from what is believed of it where nothing was touched: as the boards' maps
/// of curved objects have it. For some millimetres beyond a touch that is half as far as one goes.
const UNTOUCHED: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

/// Least radius that an object is taken for, metres.
const LEAST_RADIUS: f32 = 0.02;

/// Points along a way at which its depth in the body is looked for.
const DEPTHS: usize = 8;

/// The belief of [`Hypotheses`] about the next grasp, made by [`Hypotheses::foresee`].
///
/// The body is what the faces of the best hypothesis enclose; planes of a concavity bound nothing. A
/// face is known where it was touched: between the two contacts on it that are furthest apart. It
/// reaches e beyond with the probability exp(−e/R), with R the distance of the contacts from their
/// middle, 20 mm or more. Where no face has been touched, or has ended, the body is closed by the ball
/// of that radius. Of the two a finger is expected to meet what is likelier.
///
/// The distance of a contact hangs on the pose, on its face, and on how much the surface has strayed
/// from both: a Gaussian process of its own (Matérn-3/2, 30 mm, 100 mm), zero where the object was
/// touched. Its variance at a distance e from there is s²(1 − κ(e)²), so that it leaves nothing to learn
/// at a place touched before, and two fingers side by side on an untouched side learn little more than
/// one.
pub struct Foreseen<
    'a,
    S: Space,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> {
    best: &'a Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    column: &'a mut [f32; ROWS],
    pose: S::Pose,
    /// Covariance of the pose if the faces were known, without the motion noise.
    alone: S::Covariance,
    /// Variances of the motion noise, of each translation and rotation.
    noise: [f32; 2],
    middle: S::Vector,
    radius: f32,
}

/// What a foretold contact lies on.
#[derive(Clone, Copy, Debug)]
pub struct On {
    /// The face, none of the ball.
    face: Option<usize>,
    /// How far it is from what was touched, metres.
    beyond: f32,
}

impl<
    S: Chart,
    const K: usize,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
> Hypotheses<S, K, FACES, ROWS, PACKED, GRASPS>
{
    /// What the next grasp would feel, by the best hypothesis: the object is expected to be moved as
    /// `motion` says (world to world), by `None` to stay, up to the motion noise. `None` before
    /// anything is known of its shape.
    pub fn foresee(
        &mut self,
        motion: Option<&S::Pose>,
    ) -> Option<Foreseen<'_, S, FACES, ROWS, PACKED, GRASPS>> {
        let slot = self.order[..self.count].first()?;
        let best = self.slots.get(usize::from(*slot)).filter(|best| best.faces > 0)?;
        let work = &mut self.work;
        work.joint.copy_from(&best.joint);
        for row in S::FREEDOM..best.joint.rows() {
            work.joint.tell(row, best.joint.at(row, row), &mut work.gain);
        }
        let mut alone = S::Covariance::ZERO;
        for i in 0..S::FREEDOM {
            for j in 0..S::FREEDOM {
                *alone.at_mut(i, j) = work.joint.at(i, j);
            }
        }
        let middle = best.middle();
        let mut radius = LEAST_RADIUS * LEAST_RADIUS;
        for (_, point) in best.witnesses() {
            radius = math::max(radius, (point - middle).norm_squared());
        }
        let motion = motion.filter(|m| is_plausible::<S>(m));
        let noise = self.settings.motion;
        Some(Foreseen {
            best,
            column: &mut work.gain,
            pose: motion.map_or(best.pose, |m| m.compose(&best.pose)),
            alone,
            noise: [noise.translation, noise.rotation].map(|deviation| deviation * deviation),
            middle,
            radius: math::sqrt(radius),
        })
    }
}

impl<S: Chart, const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>
    Foreseen<'_, S, FACES, ROWS, PACKED, GRASPS>
{
    /// Variance of the pose's coordinate `i` that the motion adds.
    fn moved(&self, i: usize) -> f32 {
        self.noise[usize::from(i >= S::DIMENSION)]
    }

    /// How deep the way from `from` to `to` (metres along it) comes at most.
    fn depth(&self, way: &Stroke<S>, (from, to): (f32, f32), ball: bool) -> f32 {
        let step = (to - from) * (1.0 / DEPTHS as f32);
        let mut deepest = 0.0;
        for k in 1..=DEPTHS {
            let point = way.at(from + step * k as f32);
            let mut depth = f32::INFINITY;
            for (plane, record) in
                self.best.planes[..self.best.faces].iter().zip(&self.best.records)
            {
                if !record.is_reentrant() {
                    depth = math::min(depth, -plane.height(point));
                }
            }
            if ball {
                depth = math::min(depth, self.radius - (point - self.middle).norm());
            }
            // A body of reentrant planes only is as deep as it is wide.
            deepest = math::max(deepest, math::min(depth, self.radius));
        }
        deepest
    }

    /// Where the way enters and leaves the ball.
    fn through_ball(&self, way: &Stroke<S>) -> Option<(f32, f32)> {
        let from = way.start - self.middle;
        let along = from.dot(way.direction);
        let square = along * along - from.norm_squared() + self.radius * self.radius;
        let half = math::sqrt(math::max(square, 0.0));
        (square > 0.0).then_some((-along - half, half - along))
    }
}

/// How far a point is from the part of a face that was touched: the straight line between two contacts.
fn beyond<S: Space>(record: &Record<S>, point: S::Vector) -> f32 {
    let [a, b] = record.ends;
    let line = b - a;
    let length = line.norm_squared();
    let share = if length > 0.0 { (point - a).dot(line) / length } else { 0.0 };
    let nearest = a + line * math::min(math::max(share, 0.0), 1.0);
    (point - nearest).norm()
}

impl<S: Chart, const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>
    Foresight<S> for Foreseen<'_, S, FACES, ROWS, PACKED, GRASPS>
{
    type Place = On;

    fn pose(&self) -> S::Pose {
        self.pose
    }

    fn meet(&self, way: &Stroke<S>) -> Option<Meeting<S, On>> {
        let (mut enter, mut leave) = (f32::NEG_INFINITY, way.travel);
        let mut entered = None;
        let (planes, records) = (&self.best.planes, &self.best.records);
        for face in 0..self.best.faces {
            if records[face].is_reentrant() {
                continue;
            }
            let height = planes[face].height(way.start);
            let slope = planes[face].normal.dot(way.direction);
            if slope.abs() < 1e-6 {
                if height > 0.0 {
                    return None;
                }
            } else if slope > 0.0 {
                leave = math::min(leave, -height / slope);
            } else if -height / slope > enter {
                (enter, entered) = (-height / slope, Some(face));
            }
        }
        let begin = math::max(enter, 0.0);
        if !(begin < leave) {
            return None;
        }
        // On the face, as far as it reaches.
        let end = |from: f32, to: f32| (from, math::min(to, from + 2.0 * self.radius));
        let on_face = entered.map(|face| {
            let point = way.at(begin);
            let away = beyond(&records[face], point);
            Meeting {
                point,
                normal: planes[face].normal,
                depth: self.depth(way, end(begin, leave), false),
                share: math::exp(-away / self.radius),
                place: On { face: Some(face), beyond: away },
            }
        });
        // Or on the ball, where the face has ended before or there is none.
        let ended = on_face.as_ref().map_or(1.0, |met| 1.0 - met.share);
        let on_ball = self.through_ball(way).and_then(|(first, last)| {
            let (from, to) = (math::max(first, 0.0), math::min(last, leave));
            if !(first > enter && from < to) {
                return None;
            }
            let point = way.at(from);
            let mut away = f32::INFINITY;
            for record in &records[..self.best.faces] {
                away = math::min(away, beyond(record, point));
            }
            Some(Meeting {
                point,
                normal: (point - self.middle).normalized().unwrap_or(-way.direction),
                depth: self.depth(way, (from, to), true),
                share: ended,
                place: On { face: None, beyond: away },
            })
        });
        match (on_face, on_ball) {
            (Some(face), Some(ball)) => Some(if ball.share > face.share { ball } else { face }),
            (face, ball) => face.or(ball),
        }
    }

    fn doubts(&mut self, meetings: &[Meeting<S, On>]) -> Doubts {
        let mut doubts = Doubts::NONE;
        let mut levers = [S::Tangent::ZERO; FINGERS];
        let mut by_plane = [(0, S::Vector::ZERO); FINGERS];
        let mut strays = [0.0; FINGERS];
        let last = S::DIMENSION - 1;
        let unit = Matern32 { amplitude: 1.0, ..UNTOUCHED };
        for (i, met) in meetings.iter().enumerate().take(FINGERS) {
            levers[i] = -S::lever(met.point, met.normal);
            if let Some(face) = met.place.face {
                let mut row = S::Vector::ZERO;
                for (k, axis) in across::<S>(met.normal).iter().enumerate().take(last) {
                    row[k] = axis.dot(met.point);
                }
                row[last] = -1.0;
                by_plane[i] = (S::FREEDOM + S::DIMENSION * face, row);
            }
            let like = unit.value(met.place.beyond * met.place.beyond);
            strays[i] = UNTOUCHED.amplitude * math::sqrt(math::max(1.0 - like * like, 0.0));
        }
        for j in 0..meetings.len().min(FINGERS) {
            let row = |i: usize| {
                let (at, plane): &(usize, S::Vector) = &by_plane[i];
                let plane = if meetings[i].place.face.is_some() { plane.as_slice() } else { &[] };
                Sparse([(0, levers[i].as_slice()), (*at, plane)])
            };
            self.best.joint.times(row(j), self.column);
            let mut alone = S::Tangent::ZERO;
            for k in 0..S::FREEDOM {
                for l in 0..S::FREEDOM {
                    alone[k] += self.alone.at(k, l) * levers[j][l];
                }
            }
            for i in 0..=j {
                let mut moved = 0.0;
                for k in 0..S::FREEDOM {
                    moved += levers[i][k] * self.moved(k) * levers[j][k];
                }
                let apart = (meetings[i].point - meetings[j].point).norm_squared();
                let stray = strays[i] * strays[j] * unit.value(apart);
                let all = row(i).dot(self.column) + moved + stray;
                let pose = levers[i].dot(alone) + moved;
                for (a, b) in [(i, j), (j, i)] {
                    (doubts.all[a][b], doubts.pose[a][b]) = (all, pose);
                }
            }
        }
        doubts
    }
}
