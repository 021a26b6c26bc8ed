//! Of which parts a round body is made: whether its sides are a cylinder's or a superquadric's, and which
//! flat ends it has.

use super::body::{ROUGH, Round, Side};
use super::descent::{Free, descend, price, touches, wild};
use super::{Hypothesis, TOGETHER};
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::Face;
use crate::reference::Contact;

/// Flat ends tried for one hypothesis at a time.
const CUTS: usize = 3;

/// How many flat ends a body may have.
pub(super) const ENDS: usize = 2;

/// Contacts from which on a superquadric is tried: about three for every two of its numbers.
const ENOUGH: usize = 16;

/// The hypothesis and those whose bodies are of other kinds: in space a round cylinder, and a superquadric
/// where a quadric does not suffice.
pub(super) fn kinds<const D: usize>(
    problem: &Problem,
    one: Hypothesis,
    free: Free,
) -> Vec<Hypothesis> {
    let descended = |body: Round| {
        let mut other = Hypothesis { body, ..one.clone() };
        descend::<D>(problem, &mut other, TOGETHER, free);
        other
    };
    let bodies = if problem.dimension == 3 { one.body.cylinders() } else { Vec::new() };
    let cylinders = bodies.into_iter().map(descended);
    let cylinder = cylinders.min_by(|a, b| a.cost.total_cmp(&b.cost));
    let other = superquadric(problem, &one).map(descended);
    cylinder.into_iter().chain(other).chain([one]).collect()
}

/// The superquadric in place of a quadric that leaves contacts unexplained, or takes normals for rough.
fn superquadric(problem: &Problem, one: &Hypothesis) -> Option<Round> {
    let count = problem.starts[one.poses.len()];
    let suffices = || one.body.rough == ROUGH[0] && wild(problem, one) == 0.0;
    if !matches!(one.body.side, Side::Quadric(_)) || count < ENOUGH || suffices() {
        return None;
    }
    let placed: Vec<Contact> = (0..count).map(|i| problem.placed(&one.poses, i)).collect();
    one.body.superquadric(problem.dimension, &placed)
}

/// With the flat ends that pay for themselves, and without those that do not.
pub(super) fn with_ends<const D: usize>(
    problem: &Problem,
    mut one: Hypothesis,
    free: Free,
) -> Hypothesis {
    for at in (0..one.body.ends.len()).rev() {
        let mut fewer = one.clone();
        fewer.body.ends.remove(at);
        descend::<D>(problem, &mut fewer, TOGETHER, free);
        if fewer.cost <= one.cost {
            one = fewer;
        }
    }
    if one.body.ends.len() >= ENDS {
        return one;
    }
    let tried = candidates(problem, &one).into_iter().map(|end| {
        let mut more = one.clone();
        more.body.ends.push(end);
        descend::<D>(problem, &mut more, TOGETHER, free);
        more
    });
    match tried.min_by(|a, b| a.cost.total_cmp(&b.cost)) {
        Some(more) if more.cost < one.cost => more,
        _ => one,
    }
}

/// Planes through contacts that the body does not explain, those that promise most first. One contact
/// is enough: where an object slides along itself, other grasps felt the same end elsewhere.
pub(super) fn candidates(problem: &Problem, one: &Hypothesis) -> Vec<Face> {
    let costs: Vec<f64> = touches(problem, one).iter().map(|touched| touched.cost).collect();
    let placed: Vec<Contact> = (0..costs.len()).map(|i| problem.placed(&one.poses, i)).collect();
    let price = price(problem, one.poses.len(), one.body.numbers(problem.dimension).1);
    let mut planes: Vec<(f64, Face)> = Vec::new();
    for (contact, cost) in placed.iter().zip(&costs) {
        let Some(normal) = contact.normal else { continue };
        let normal = match &one.body.side {
            Side::Quadric(_) => normal,
            Side::Cylinder(axis, _) if normal.dot(axis).abs() > 0.9 => {
                axis * normal.dot(axis).signum()
            }
            Side::Cylinder(..) | Side::Superquadric(_) => continue,
        };
        let face = Face { normal, offset: normal.dot(&contact.point) };
        let lies = |other: &Contact| {
            let turned = 3.0 * other.normal_deviation.hypot(one.body.rough);
            face.value(&other.point).abs() < 3.0 * other.point_deviation
                && other.normal.is_some_and(|n| (n - normal).norm() < turned)
        };
        let others = placed.iter().zip(&costs).filter(|(other, _)| lies(other));
        let gain = others.map(|(_, cost)| *cost).sum::<f64>().max(*cost);
        let alike = |f: &Face| {
            f.normal.dot(&normal) > 0.95 && (f.offset - face.offset).abs() < 0.1 * one.ball.1
        };
        if gain < price || one.body.ends.iter().any(alike) {
            continue;
        }
        match planes.iter_mut().find(|(_, f)| alike(f)) {
            Some(known) if known.0 < gain => *known = (gain, face),
            Some(_) => {}
            None => planes.push((gain, face)),
        }
    }
    planes.sort_by(|a, b| b.0.total_cmp(&a.0));
    planes.into_iter().take(CUTS).map(|(_, face)| face).collect()
}
