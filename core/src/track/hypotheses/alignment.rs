//! Where an object may be that was put elsewhere: where faces known of it look the ways that it was touched from,
//! and lie where it was touched.

use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

use super::chart::Chart;
use super::hypothesis::Hypothesis;
use super::plane::Touch;

/// Poses that are looked into at most.
const POSES: usize = 16;

/// Touches that are laid on faces two by two at most.
const PAIRED: usize = 6;

/// Least squared sine between the normals of two touches that tell how the object is turned.
const ACROSS: f32 = 0.2;

/// Rotations this close together, radians², are one.
const SAME: f32 = 0.05;

/// What a touch costs at most, and one that lies on no known face: three deviations, squared.
const WORST: f32 = 9.0;

/// How far off its face a touch may lie beside its own deviation, metres: at first, and when the object has been
/// shifted into its place.
const LOOSE: [f32; 2] = [0.1, 0.003];

/// Variance of normals beside their own, radians²: that of the faces, and of the touches by which it was turned.
const TURNED: f32 = 0.003;

/// Variance of each rotation of an object that was put elsewhere.
pub(super) const ANY_TURN: f32 = 1.5 * 1.5;

/// Poses of an object that was put elsewhere, likeliest first.
pub(super) struct Alignments<S: Space> {
    poses: [S::Pose; POSES],
    costs: [f32; POSES],
    count: usize,
    /// How far the object may be from the nearest of them: variances of each translation and rotation.
    pub near: [f32; 2],
}

impl<S: Chart> Alignments<S> {
    /// None.
    pub const fn none() -> Self {
        Alignments {
            poses: [S::Pose::UNSET; POSES],
            costs: [0.0; POSES],
            count: 0,
            near: [0.03 * 0.03, 0.2 * 0.2],
        }
    }

    /// Those at which a touch (in space two) lies on faces of `prior` that look its way; where there is none, for
    /// want of normals, some of all.
    #[inline(never)]
    pub fn of<const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>(
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        touches: &[Touch<S>],
    ) -> Self {
        let mut all = Self::none();
        let planes = &prior.planes[..prior.faces];
        let paired = &touches[..touches.len().min(PAIRED)];
        for (i, first) in paired.iter().enumerate().filter(|(_, touch)| touch.directed) {
            for plane in planes {
                let looks = prior.pose.unrotate(first.normal);
                let pose = prior.pose.retract(S::turn_to(plane.normal, looks));
                if S::DIMENSION == 2 {
                    all.offer(prior, touches, pose);
                    continue;
                }
                for second in paired[i + 1..].iter().filter(|touch| touch.directed) {
                    let between = first.normal.dot(second.normal);
                    let across = 1.0 - between * between;
                    if across < ACROSS {
                        continue;
                    }
                    let variance = first.normal_variance + second.normal_variance + 0.01;
                    for other in planes {
                        let off = plane.normal.dot(other.normal) - between;
                        if off * off < 9.0 * variance * across {
                            let toward = pose.unrotate(second.normal);
                            let spin = S::spin(plane.normal, other.normal, toward);
                            all.offer(prior, touches, pose.retract(spin));
                        }
                    }
                }
            }
        }
        if all.count == 0 {
            all.near[1] = 0.6 * 0.6;
            for turn in 0..S::TURNS {
                all.offer(prior, touches, prior.pose.retract(S::turn(turn)));
            }
        }
        all
    }

    pub fn poses(&self) -> &[S::Pose] {
        &self.poses[..self.count]
    }

    /// Keeps the pose, shifted to where it fits best, when it is among the best.
    #[inline(never)]
    fn offer<const FACES: usize, const ROWS: usize, const PACKED: usize, const GRASPS: usize>(
        &mut self,
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        touches: &[Touch<S>],
        pose: S::Pose,
    ) {
        let (pose, mut cost) = shifted(prior, touches, pose);
        cost += between::<S>(&prior.pose, &pose).1 * (1.0 / ANY_TURN);
        let alike = |other: &S::Pose| between::<S>(other, &pose).1 < SAME;
        if let Some(same) = self.poses().iter().position(alike) {
            if self.costs[same] <= cost {
                return;
            }
            self.poses.copy_within(same + 1..self.count, same);
            self.costs.copy_within(same + 1..self.count, same);
            self.count -= 1;
        }
        let mut place = self.count;
        while place > 0 && self.costs[place - 1] > cost {
            place -= 1;
        }
        if place >= POSES || !cost.is_finite() {
            return;
        }
        self.count = (self.count + 1).min(POSES);
        self.poses.copy_within(place..self.count - 1, place + 1);
        self.costs.copy_within(place..self.count - 1, place + 1);
        (self.poses[place], self.costs[place]) = (pose, cost);
    }
}

/// The pose shifted until touches lie on the faces that they fit best, from where the middle of the object is that
/// of the touches; and what it costs, in squared deviations.
#[inline(never)]
fn shifted<
    S: Chart,
    const FACES: usize,
    const ROWS: usize,
    const PACKED: usize,
    const GRASPS: usize,
>(
    prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
    touches: &[Touch<S>],
    pose: S::Pose,
) -> (S::Pose, f32) {
    let mut cost = 0.0;
    // In axes of the object.
    let mut shift = pose.untransform(middle(touches)) - prior.middle();
    let mut loose = LOOSE[0];
    while loose >= LOOSE[1] {
        cost = 0.0;
        for touch in touches {
            let (mut least, mut by) = (WORST, S::Vector::ZERO);
            let point = pose.untransform(touch.point) - shift;
            let looks = pose.unrotate(touch.normal);
            for plane in &prior.planes[..prior.faces] {
                let mut off = 0.0;
                if touch.directed {
                    let apart = 2.0 * (1.0 - plane.normal.dot(looks));
                    off = apart / (touch.normal_variance + TURNED);
                }
                let height = plane.height(point);
                off += height * height / (touch.point_variance + loose * loose);
                if off < least {
                    (least, by) = (off, plane.normal * height);
                }
            }
            cost += least;
            shift += by;
        }
        loose *= 0.33;
    }
    (pose.retract(S::Tangent::from_fn(|i| if i < S::DIMENSION { shift[i] } else { 0.0 })), cost)
}

/// The tangent that displaces one pose to another, and the square of its angle.
#[inline(never)]
pub(super) fn between<S: Space>(from: &S::Pose, to: &S::Pose) -> (S::Tangent, f32) {
    let tangent = from.local(to);
    let mut squared = 0.0;
    for i in S::DIMENSION..S::FREEDOM {
        squared += tangent[i] * tangent[i];
    }
    (tangent, squared)
}

/// The mean of the touches, world frame.
pub(super) fn middle<S: Space>(touches: &[Touch<S>]) -> S::Vector {
    let mut sum = S::Vector::ZERO;
    for touch in touches {
        sum += touch.point;
    }
    sum * (1.0 / touches.len().max(1) as f32)
}
