//! Contacts that contradict a convex object: few, where all others make one.
//!
//! On a convex object no contact lies beyond the plane in which another one touched. A wild one does, or others lie
//! beyond its own, and no model is needed to see that: what is fitted to the rest was never bent by it.

use super::verdict::{Bodies, are_wild};
use super::{WILD, are_few, beside_body};
use crate::model::Faces;
use crate::model::body::Body;
use crate::model::notched::Found;
use crate::reference::{Contact, Prior};
use crate::slam::choose::{directions, faces_along, judge, only};
use crate::slam::fit::rounds;
use crate::slam::reconstruct::NOTCHED;
use crate::space::Point;
use crate::thin::evenly;

/// Deviations by which a contact may lie beyond the plane of another.
const BEYOND: f64 = 4.0;

/// χ² per degree of freedom that the others may leave about their body: what contradicts it has many times that.
const MISFIT: f64 = 2.5;

/// Contacts for every side of a polytope that show it to be one: fewer than a body needs, as none of these may
/// contradict another. With four, two of 320 random objects kept wild contacts; with two none lost others.
const OFTEN: f64 = 2.0;

/// Directions are those of a box where any two of them are parallel or square, but for the sine of this angle.
const SQUARE: f64 = 0.25;

/// Which contacts at known poses belong to a convex object, where few contradict that all are of one, and the others
/// make a body of few numbers or faces that were felt often; `None` where there are no such few, or where all together
/// are as likely (`verdict`). Where sides are as those of a box, those that face as they do are none of them if they make
/// it [likelier](Found::is_likelier) that something is cut out of it. `free` are points outside.
pub fn beside_convex(dimension: usize, contacts: &[Contact], free: &[Point]) -> Option<Vec<bool>> {
    let agreeing = agreeing(contacts)?;
    let bodies = |own: &[Contact], faces: Option<&Faces>| -> Vec<Body> {
        let block = faces.and_then(|faces| Body::block(dimension, own, faces));
        let regulars = faces.map(|faces| Body::regulars(dimension, own, faces));
        let flat = block.into_iter().chain(regulars.into_iter().flatten());
        rounds(dimension, own, faces).chain(flat).collect()
    };
    let fits = |body: &Body| body.misfit() < MISFIT;
    let trusted = beside_body(dimension, contacts, agreeing.clone(), bodies, fits)
        .or_else(|| beside_sides(dimension, contacts, agreeing.clone(), free))?;
    // What contradicts the others stays out, though it lies near their body.
    let trusted: Vec<bool> = trusted.iter().zip(&agreeing).map(|(a, b)| *a && *b).collect();
    let is_found = !have_notch(dimension, contacts, &trusted, free)?
        && are_wild(dimension, contacts, &trusted, Bodies::All);
    is_found.then_some(trusted)
}

/// Whether those not trusted that face as the sides of a box make it likelier that something is cut out of it; `None`
/// where the others have no faces.
fn have_notch(
    dimension: usize,
    contacts: &[Contact],
    trusted: &[bool],
    free: &[Point],
) -> Option<bool> {
    let own = only(contacts, trusted);
    let directions = directions(&Faces::fit(dimension, &own)?);
    let is_side = |(c, trusted): (&Contact, &bool)| !trusted && faces_along(c, &directions);
    let sides: Vec<bool> = contacts.iter().zip(trusted).map(is_side).collect();
    let sides = only(contacts, &sides);
    let askew = contacts.len() - own.len() - sides.len();
    let may_be = !sides.is_empty() && are_square(&directions);
    let (few, known) = few(&own, &sides, askew);
    Some(may_be && Found::is_likelier(dimension, &few, free, known))
}

/// No more of those trusted and of those that may be sides than a box less smaller ones is made from, and how
/// many are askew beside them: as large a part of each, so that wild ones are as frequent, but at least one
/// that may be a side.
fn few(own: &[Contact], sides: &[Contact], askew: usize) -> (Vec<Contact>, usize) {
    let share = (NOTCHED as f64 / (own.len() + sides.len()).max(1) as f64).min(1.0);
    let part = |count: usize| (share * count as f64).round() as usize;
    let sides = evenly(sides, part(sides.len()).max(1));
    let own = evenly(own, NOTCHED - sides.len());
    ([own, sides].concat(), part(askew))
}

/// Whether sides have the directions of a box.
fn are_square(directions: &[Point]) -> bool {
    let is_oblique = |a: &Point, b: &Point| a.dot(b).abs().min(a.cross(b).norm()) > SQUARE;
    !directions.iter().any(|a| directions.iter().any(|b| is_oblique(a, b)))
}

/// These, if they make a convex object of sides that were felt often.
fn beside_sides(
    dimension: usize,
    contacts: &[Contact],
    agreeing: Vec<bool>,
    free: &[Point],
) -> Option<Vec<bool>> {
    let own = only(contacts, &agreeing);
    let Some(Prior::Ball { radius, .. }) = Prior::fitted(&own) else { return None };
    let (_, polytope) = judge(dimension, &own, free).ok()?;
    let is_known = own.len() as f64 >= OFTEN * polytope.touched_planes() as f64;
    (is_known && are_few(&agreeing, contacts, radius)).then_some(agreeing)
}

/// Without the few that contradict most others, so that no two contradict each other; `None` where none do, or too
/// many. Of those that contradict as many, the one goes that all others agree with least, in whatever order they
/// are: of two that contradict each other alone, the wild one nearly contradicts others, too.
fn agreeing(contacts: &[Contact]) -> Option<Vec<bool>> {
    let contradicted = |one: &Contact| {
        let (mut by, mut nearly) = (Vec::new(), 0.0);
        for (j, other) in contacts.iter().enumerate() {
            let beyond = beyond(one, other).max(beyond(other, one)).max(0.0);
            if beyond > BEYOND {
                by.push(j);
            }
            nearly += beyond.min(BEYOND).powi(2);
        }
        (by, nearly)
    };
    let (mut against, nearly): (Vec<Vec<usize>>, Vec<f64>) =
        contacts.iter().map(contradicted).unzip();
    let mut agreeing = vec![true; contacts.len()];
    let most = (WILD * contacts.len() as f64) as usize;
    for left_out in 0..=most {
        let worst = (0..contacts.len()).max_by(|a, b| {
            let more = against[*a].len().cmp(&against[*b].len());
            more.then(nearly[*a].total_cmp(&nearly[*b]))
        })?;
        if against[worst].is_empty() {
            return (left_out > 0).then_some(agreeing);
        }
        agreeing[worst] = false;
        against[worst].clear();
        against.iter_mut().for_each(|others| others.retain(|j| *j != worst));
    }
    None
}

/// How far a contact lies beyond the plane in which another touched, in deviations; before it where negative.
fn beyond(contact: &Contact, other: &Contact) -> f64 {
    let Some(normal) = other.normal else { return 0.0 };
    let chord = contact.point - other.point;
    let height = normal.dot(&chord);
    let turned = (chord - normal * height).norm() * other.normal_deviation;
    let deviation = contact.point_deviation.hypot(other.point_deviation).hypot(turned);
    height / deviation
}

#[cfg(test)]
mod tests;
