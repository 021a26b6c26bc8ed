//! What a contact is aimed at, and how that draws the pose.

use nalgebra::{Matrix6, Vector6};

use super::Target;
use crate::graph::joint::factors;
use crate::graph::joint::problem::Problem;
use crate::graph::joint::ridge::{self, Ridge};
use crate::graph::joint::tangent::Face;
use crate::model::faces::{self, Owner};
use crate::reference::Contact;
use crate::space::Pose;

/// Up to this enlargement contacts are sought on edges: before, all faces are near.
const FINE: f64 = 1.5;

/// The contact (object frame) as uncertain as it is with respect to an uncertain plane.
fn against(problem: &Problem, plane: &faces::Face, contact: &Contact) -> Contact {
    let turns = plane.normal_covariance.trace() / (problem.dimension - 1) as f64;
    Contact {
        point_deviation: (contact.point_deviation.powi(2) + plane.variance(&contact.point)).sqrt(),
        normal_deviation: (contact.normal_deviation.powi(2) + turns).sqrt(),
        ..*contact
    }
}

impl Target {
    pub(super) fn face(&self) -> Face {
        Face { normal: self.plane.normal, offset: self.plane.offset }
    }
}

/// `measured` with the deviations of the contact (object frame) against the least certain of an owner's
/// targets, larger by `slack`.
fn spread(
    problem: &Problem,
    targets: &[Target],
    owner: &Owner,
    contact: &Contact,
    slack: f64,
    measured: &Contact,
) -> Contact {
    let each = owner.faces().iter().map(|j| against(problem, &targets[*j].plane, contact));
    let (point, normal) = each.fold((0.0_f64, 0.0_f64), |(point, normal), c| {
        (point.max(c.point_deviation), normal.max(c.normal_deviation))
    });
    Contact { point_deviation: slack * point, normal_deviation: slack * normal, ..*measured }
}

/// Where an owner's targets meet.
fn meeting(targets: &[Target], owner: &Owner) -> Option<Ridge> {
    let faces: Vec<Face> = owner.faces().iter().map(|j| targets[*j].face()).collect();
    Ridge::new(&faces)
}

/// The target a contact (object frame) suits best, or the edge of several, and its cost there or without
/// one.
pub(super) fn aim(
    problem: &Problem,
    targets: &[Target],
    contact: &Contact,
    slack: f64,
) -> (Option<Owner>, f64) {
    let (mut found, mut least) = (None, problem.unexplained(contact));
    let mut consider = |owner: Owner, cost: f64| {
        if cost < least {
            (found, least) = (Some(owner), cost);
        }
    };
    for (j, target) in targets.iter().enumerate() {
        let unsure = against(problem, &target.plane, contact);
        consider(Owner::Face(j), problem.on_within(&target.face(), &unsure, slack));
    }
    if problem.edges && slack <= FINE {
        let faces = targets.iter().enumerate().filter(|(_, t)| t.contact.is_none());
        let faces: Vec<(usize, Face)> = faces.map(|(j, t)| (j, t.face())).collect();
        let deviation =
            |j: usize| slack * against(problem, &targets[j].plane, contact).point_deviation;
        for (owner, ridge) in ridge::near(problem, &faces, contact, deviation) {
            let unsure = spread(problem, targets, &owner, contact, 1.0, contact);
            consider(owner, ridge.cost(problem, &unsure, slack));
        }
    }
    (found, least)
}

/// What draws a pose to a contact's targets: residual and derivatives, weighted as the kernel has it.
pub(super) fn pull(
    problem: &Problem,
    targets: &[Target],
    owner: &Owner,
    pose: &Pose,
    world: &Contact,
    slack: f64,
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let contact = world.transformed(&pose.inverse());
    let sure = spread(problem, targets, owner, &contact, slack, world);
    let (mut residual, mut by_pose) = (Vector6::zeros(), Matrix6::zeros());
    // Up to this row it is the distance, from there on the normal.
    let turns = match owner {
        Owner::Face(j) => {
            let touch = factors::touch(pose, &targets[*j].face(), problem.dimension, &sure);
            residual.fixed_rows_mut::<4>(0).copy_from(&touch.residual);
            by_pose.fixed_rows_mut::<4>(0).copy_from(&touch.by_pose);
            1
        }
        _ => {
            let touch = meeting(targets, owner)?.touch(pose, problem.dimension, &sure);
            (residual, by_pose) = (touch.residual, touch.by_pose);
            3
        }
    };
    for rows in [0..turns, turns..6] {
        let squared = rows.clone().map(|row| residual[row] * residual[row]).sum();
        let weight = problem.kernel.cost(squared).1.sqrt();
        for row in rows {
            residual[row] *= weight;
            by_pose.row_mut(row).scale_mut(weight);
        }
    }
    Some((residual, by_pose))
}
