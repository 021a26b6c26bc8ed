//! Which coordinate moves each joint, and between which ends.

use std::collections::HashMap;

use nalgebra::{Unit, Vector3};
use urdf_rs::JointType;

use super::problem::Problem;
use super::{Coordinate, Drive, LONGEST, Motion};

/// Which coordinate moves each joint.
pub(super) struct Drives {
    /// In the order of their joints.
    pub coordinates: Vec<Coordinate>,
    /// One per joint; `None` for those that do not move.
    pub of: Vec<Option<Drive>>,
}

impl Drives {
    pub(super) fn new(joints: &[urdf_rs::Joint]) -> Result<Drives, Problem> {
        let mut index = HashMap::new();
        for (i, joint) in joints.iter().enumerate() {
            if index.insert(joint.name.as_str(), i).is_some() {
                return Err(Problem::Twice { what: "joint", name: joint.name.clone() });
            }
        }
        let moves = |j: &urdf_rs::Joint| j.joint_type != JointType::Fixed;
        let mut drives = Drives { coordinates: Vec::new(), of: vec![None; joints.len()] };
        for (i, joint) in joints.iter().enumerate() {
            if moves(joint) && joint.mimic.is_none() {
                let (lower, upper) = limits(joint)?;
                let coordinate = drives.coordinates.len();
                drives.coordinates.push(Coordinate { joint: joint.name.clone(), lower, upper });
                drives.of[i] = Some(Drive { coordinate, factor: 1.0, offset: 0.0 });
            }
        }
        for (i, joint) in joints.iter().enumerate() {
            if moves(joint) && joint.mimic.is_some() {
                let drive = drives.followed(joints, &index, i)?;
                drives.of[i] = Some(drive);
                drives.narrow(joint, drive)?;
            }
        }
        Ok(drives)
    }

    /// The drive of a joint that mimics another, which may itself mimic one.
    fn followed(
        &self,
        joints: &[urdf_rs::Joint],
        index: &HashMap<&str, usize>,
        first: usize,
    ) -> Result<Drive, Problem> {
        let (mut factor, mut offset) = (1.0, 0.0);
        let mut at = first;
        for _ in 0..=joints.len() {
            let joint = &joints[at];
            let Some(mimic) = &joint.mimic else {
                let Some(Drive { coordinate, .. }) = self.of[at] else { break };
                return Ok(Drive { coordinate, factor, offset });
            };
            let refuse = |problem| {
                Err(Problem::Mimic { joint: joint.name.clone(), of: mimic.joint.clone(), problem })
            };
            let (f, o) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
            if !f.is_finite() || !o.is_finite() || f == 0.0 || f.abs().max(o.abs()) > 1e3 {
                return refuse("expected a finite multiplier that is not zero and a finite offset");
            }
            offset += factor * o;
            factor *= f;
            let Some(next) = index.get(mimic.joint.as_str()) else {
                return refuse("there is no such joint");
            };
            at = *next;
            if joints[at].joint_type == JointType::Fixed {
                return refuse("that joint is fixed");
            }
        }
        let joint = &joints[first];
        let of = joint.mimic.as_ref().map_or_else(String::new, |m| m.joint.clone());
        Err(Problem::Mimic { joint: joint.name.clone(), of, problem: "it follows itself" })
    }

    /// A joint that follows ends where it ends.
    fn narrow(&mut self, joint: &urdf_rs::Joint, drive: Drive) -> Result<(), Problem> {
        let (lower, upper) = limits(joint)?;
        // Descriptions often leave the limits of a follower at their default: no limits then. What turns freely
        // has none either.
        let free = joint.joint_type == JointType::Continuous || joint.limit.upper == f64::INFINITY;
        if lower == upper || free {
            return Ok(());
        }
        let ends = [lower, upper].map(|end| (end - drive.offset) / drive.factor);
        let leader = &mut self.coordinates[drive.coordinate];
        let lower = leader.lower.max(ends[0].min(ends[1]));
        let upper = leader.upper.min(ends[0].max(ends[1]));
        if lower > upper {
            return Err(Problem::Mimic {
                joint: joint.name.clone(),
                of: leader.joint.clone(),
                problem: "their limits leave no place",
            });
        }
        (leader.lower, leader.upper) = (lower, upper);
        Ok(())
    }
}

/// Where a joint ends: as described; one turn where there is no limit to turning.
fn limits(joint: &urdf_rs::Joint) -> Result<(f64, f64), Problem> {
    const TURN: f64 = std::f64::consts::PI;
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    let refuse = || Problem::Limits { joint: joint.name.clone(), lower, upper };
    let fine = |most: f64| lower <= upper && lower.abs().max(upper.abs()) <= most;
    match joint.joint_type {
        JointType::Continuous => Ok((-TURN, TURN)),
        JointType::Revolute if lower == f64::NEG_INFINITY && upper == f64::INFINITY => {
            Ok((-TURN, TURN))
        }
        JointType::Revolute if fine(4.0 * TURN) => Ok((lower, upper)),
        JointType::Prismatic if fine(LONGEST) => Ok((lower, upper)),
        JointType::Revolute | JointType::Prismatic => Err(refuse()),
        JointType::Fixed => Ok((0.0, 0.0)),
        JointType::Floating => Err(Problem::Kind { joint: joint.name.clone(), kind: "floating" }),
        JointType::Planar => Err(Problem::Kind { joint: joint.name.clone(), kind: "planar" }),
        JointType::Spherical => Err(Problem::Kind { joint: joint.name.clone(), kind: "spherical" }),
    }
}

/// How a joint with this drive moves.
pub(super) fn motion(joint: &urdf_rs::Joint, drive: Option<Drive>) -> Result<Motion, Problem> {
    let Some(drive) = drive else { return Ok(Motion::Fixed) };
    let axis = joint.axis.xyz.0;
    let unit = Unit::try_new(Vector3::from(axis), 1e-9)
        .filter(|u| u.iter().all(|x| x.is_finite()))
        .ok_or_else(|| Problem::Axis { joint: joint.name.clone(), axis })?;
    Ok(match joint.joint_type {
        JointType::Prismatic => Motion::Slide(unit, drive),
        _ => Motion::Turn(unit, drive),
    })
}
