//! Where the links of a hand are, how they move with its joints, and which joints bring a point of a
//! link somewhere.

use nalgebra::{DVector, Matrix3, Matrix3xX, Point3, Translation3, UnitQuaternion};

use super::urdf::{Model, Motion};
use crate::space::{Point, Pose};

/// Steps of the inverse kinematics at most.
const MOST_STEPS: usize = 200;

/// Damping of its steps, metres: a lever shorter than this is no way to move a fingertip.
const DAMPING: f64 = 2e-3;

/// What the inverse kinematics found.
#[derive(Clone, Debug, PartialEq)]
pub struct Reached {
    /// One value per coordinate, all within their limits.
    pub joints: Vec<f64>,
    /// How far the point is from the target with them, metres.
    pub error: f64,
}

impl Model {
    /// The pose of every link (link to root) with these values of the coordinates (radians or metres);
    /// missing ones count as 0.
    pub fn forward(&self, joints: &[f64]) -> Vec<Pose> {
        let mut poses: Vec<Pose> = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let pose = match &link.joint {
                None => Pose::identity(),
                Some(joint) => {
                    let value = |d: &super::urdf::Drive| {
                        d.factor * joints.get(d.coordinate).copied().unwrap_or(0.0) + d.offset
                    };
                    let at = poses[joint.parent] * joint.origin;
                    match &joint.motion {
                        Motion::Fixed => at,
                        Motion::Turn(axis, d) => {
                            at * UnitQuaternion::from_axis_angle(axis, value(d))
                        }
                        Motion::Slide(axis, d) => at * Translation3::from(axis.scale(value(d))),
                    }
                }
            };
            poses.push(pose);
        }
        poses
    }

    /// How a point of a link (link frame, metres) moves with each coordinate: 3 × coordinates, root
    /// frame, metres per radian or metre.
    pub fn jacobian(&self, joints: &[f64], link: usize, point: &Point) -> Matrix3xX<f64> {
        let poses = self.forward(joints);
        let mut jacobian = Matrix3xX::zeros(self.coordinates.len());
        let Some(pose) = poses.get(link) else { return jacobian };
        let at = (pose * Point3::from(*point)).coords;
        for l in self.chain(link) {
            let Some(joint) = &self.links[l].joint else { continue };
            let (column, drive) = match &joint.motion {
                Motion::Fixed => continue,
                Motion::Turn(axis, drive) => {
                    let axis = poses[l].rotation * axis.into_inner();
                    (axis.cross(&(at - poses[l].translation.vector)), drive)
                }
                Motion::Slide(axis, drive) => (poses[l].rotation * axis.into_inner(), drive),
            };
            let mut to = jacobian.column_mut(drive.coordinate);
            to += drive.factor * column;
        }
        jacobian
    }

    /// Values of the coordinates near `start` that bring a point of a link (link frame) as near as they
    /// can to `target` (root frame): damped least squares (Wampler 1986) with the coordinates held
    /// within their limits, those at a limit left out of the step that would pass it. What it finds is as
    /// near as any in the neighbourhood; far from `start` there may be better.
    pub fn solve(&self, link: usize, point: &Point, target: &Point, start: &[f64]) -> Reached {
        let clamp =
            |i: usize, v: f64| v.clamp(self.coordinates[i].lower, self.coordinates[i].upper);
        let count = self.coordinates.len();
        let mut joints: Vec<f64> =
            (0..count).map(|i| clamp(i, start.get(i).copied().unwrap_or(0.0))).collect();
        let away = |joints: &[f64]| {
            let pose = self.forward(joints).get(link).copied().unwrap_or_else(Pose::identity);
            target - (pose * Point3::from(*point)).coords
        };
        let mut error = away(&joints);
        let mut damping = DAMPING;
        for _ in 0..MOST_STEPS {
            if !(error.norm() > 1e-9) {
                break;
            }
            let mut jacobian = self.jacobian(&joints, link, point);
            let mut step = DVector::zeros(count);
            for _ in 0..=count {
                let square =
                    &jacobian * jacobian.transpose() + Matrix3::identity() * (damping * damping);
                let Some(force) = square.cholesky().map(|c| c.solve(&error)) else { break };
                step = jacobian.transpose() * force;
                // A coordinate that would leave its limits stays, and the others do its part.
                let stuck = (0..count).find(|&i| {
                    let past = joints[i] + step[i];
                    jacobian.column(i).norm() > 0.0
                        && joints[i] == clamp(i, past)
                        && past != joints[i]
                });
                let Some(stuck) = stuck else { break };
                jacobian.column_mut(stuck).fill(0.0);
                step[stuck] = 0.0;
            }
            let next: Vec<f64> = (0..count).map(|i| clamp(i, joints[i] + step[i])).collect();
            let left = away(&next);
            if left.norm() < error.norm() {
                damping = (damping * 0.5).max(1e-7);
                (joints, error) = (next, left);
            } else {
                damping *= 4.0;
                if damping > 1e3 {
                    break;
                }
            }
        }
        Reached { joints, error: error.norm() }
    }
}
