//! Which surface model suits the contacts: fitted faces where every sign says that the object has flat
//! ones, the Gaussian process otherwise.

mod wild;

pub use wild::trusted;
pub(super) use wild::{directions, faces_along, often};

use crate::model::body::Body;
use crate::model::faces::{Face, Faces, Owner};
use crate::model::misfit;
use crate::reference::{Contact, Kernel};
use crate::shape::Geometry;
use crate::shape::polytope::{COUNTERPART, FAR, OPPOSITE, Polytope, assemble, closures};
use crate::space::{Point, centroid};

/// What the user wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Choice {
    /// A box less smaller boxes where contacts at known poses, or those that a graph finds wild ones among, suit one
    /// that is not convex but for a few, and some face of theirs was felt by few, or they make none that close
    /// ([`Found`](crate::model::notched::Found)); faces where they are trustworthy, see [`judge`], equal
    /// ones where such a body is more probable; the Gaussian process where a round one is
    /// ([`simpler`](super::fit::simpler)), and everywhere else.
    #[default]
    Auto,
    /// Faces; an error where they do not close.
    Faces,
    /// The Gaussian process.
    Gp,
}

/// The model a reconstruction was made with.
#[derive(Clone, Debug)]
pub enum Model {
    /// The Gaussian process, with the kernel that explained the contacts best.
    Gp(Kernel),
    /// Flat faces, in the frame of the contacts they were fitted to; answers how uncertain the
    /// surface is anywhere on them ([`crate::shape::Field`]).
    Faces(Box<Polytope>),
}

impl Model {
    /// As reports name it.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Gp(_) => "gp",
            Model::Faces(_) => "faces",
        }
    }
}

/// Why faces are not chosen.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Faces are found from normals.
    #[error("no contact has a normal")]
    NoNormals,
    /// Poses are so doubtful that the contacts would fit anything.
    #[error("normals are only known to {degrees:.0}°: too little to tell faces from a curve")]
    Doubtful {
        /// Median standard deviation of the contacts' normals, degrees, the doubt about the poses
        /// included.
        degrees: f64,
    },
    /// Sides were not touched, or the contacts show a hollow from inside.
    #[error("{faces} faces touched by {contacts} contacts do not close: touch the other sides")]
    Open {
        /// How many were found.
        faces: usize,
        /// From how many contacts.
        contacts: usize,
    },
    /// So few contacts a face that anything fits.
    #[error("{faces} faces for {contacts} contacts: too few contacts to tell faces from a curve")]
    Few {
        /// How many were found.
        faces: usize,
        /// From how many contacts.
        contacts: usize,
    },
    /// Contacts have each its own face, as on a curve or where a finger lay on a rounded edge.
    #[error(
        "{lone} of {contacts} contacts make faces of their own that no other confirms: the surface is \
         curved, or a finger lay on an edge"
    )]
    Lone {
        /// Faces of one contact that are neither parallel nor square to others.
        lone: usize,
        /// With normals.
        contacts: usize,
    },
    /// No union of cells between the faces has the surface that the contacts show.
    #[error("{unexplained} of {contacts} contacts do not lie on the surface that the faces make")]
    Unexplained {
        /// Contacts whose own face is no part of the surface where they lie.
        unexplained: usize,
        /// With normals.
        contacts: usize,
    },
    /// The normals turn within faces.
    #[error("the surface is curved: normals turn within faces by {deviations:.1} deviations")]
    Curved {
        /// [`Faces::bending`].
        deviations: f64,
    },
    /// The deviations of the contacts are much larger than they are said to be.
    #[error("the faces do not fit: χ² per degree of freedom is {per_degree:.2}")]
    Misfit {
        /// χ²/dof.
        per_degree: f64,
    },
    /// A corner lies so far from every contact that a side may have been missed there.
    #[error(
        "a corner lies {:.0} mm from the nearest contact: a side may have been missed there",
        1e3 * distance
    )]
    Untouched {
        /// From the corner to the nearest contact, metres.
        distance: f64,
    },
}

/// Deviations of bending that flat faces do not show: once in a hundred.
const BENT: f64 = 2.3;

/// Most faces per contact: fewer contacts a face fit anything. More of a hollow object, of which the
/// process knows next to nothing: there doubtful faces say more.
const SHARE: f64 = 0.45;
const SHARE_HOLLOW: f64 = 0.55;

/// Farthest that a corner may lie from every contact, in distances from the contacts' centre to the
/// farthest of them. The neighbours of a missed side of a hexagon meet at 1, of an octagon at 0.7; the
/// corners of rectangles and triangles with 2.5 contacts a side lie at 0.2 to 0.5. On a hollow object it does
/// not matter, for the same reason.
const UNTOUCHED: f64 = 0.6;

/// Where every face has its counterpart ([`COUNTERPART`]) hardly a side was missed: there a corner lies too far
/// only if so many contacts are expected nearer to it, and not every face has one that is [`OPPOSITE`]. Of a
/// house with a gable and one wall unfelt, where the roof comes down on the ground, it is three to five; of
/// rectangles and other quadrilaterals with ten contacts one to three.
const EXPECTED: f64 = 3.3;

/// Most faces of one contact that nothing else confirms, as a share of the contacts. It estimates how
/// likely the next contact is to make a new face (Good, Biometrika 40, 1953): low where all faces were
/// found, high on curves, where every contact makes its own.
const LONE: f64 = 0.05;

/// Whether so many unconfirmed faces make the others doubtful, too: one less than [`LONE`] allows on a
/// convex object, but never the first on a hollow one.
///
/// A finger on a rounded edge makes a face that stands for the side behind it, and corners far away:
/// the process loses less than that, unless the object is hollow.
fn too_many(lone: usize, faces: &Faces, felt: usize) -> bool {
    let most = (LONE * felt as f64).floor() as usize;
    let most = if faces.is_convex() { most.saturating_sub(1) } else { most.max(1) };
    lone > most
}

/// Closing planes that are tried one at a time.
const MOST_CLOSINGS: usize = 8;

/// Most contacts that the shape may leave unexplained, as a share.
const UNEXPLAINED: f64 = 0.06;

/// Normals less certain than this (radians, median) fit any polytope: where the poses are in doubt,
/// χ² has nothing to say.
pub(super) const DOUBT: f64 = 0.2;

/// Faces that the contacts show, and the shape they make, whatever it fits like. Sides that nobody
/// touched are closed at the outermost contacts where the faces leave them open or meet far away.
/// `free` are points known to be outside; all in the object frame.
///
/// # Errors
/// When no contact has a normal, or the faces enclose nothing.
pub fn polytope(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    let faces = fitted(dimension, contacts)?;
    let polytope = close(&faces, contacts, free)?;
    Ok((faces, polytope))
}

/// The shape of faces that are known, from contacts that they explain; `None` where they leave contacts
/// unexplained, or where contacts at edges are among those of a face, which only another fit tells.
pub fn known(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Option<Polytope> {
    if faces.simplified(contacts).faces.len() != faces.faces.len() {
        return None;
    }
    let polytope = close(faces, contacts, free).ok()?;
    let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
    let is_explained = |contacts: &[Contact]| {
        unexplained(faces, &polytope, contacts) as f64 <= UNEXPLAINED * felt as f64
    };
    // With the second chance that they have when they are judged.
    let is_explained =
        is_explained(contacts) || slackened(contacts).is_some_and(|slack| is_explained(&slack));
    is_explained.then_some(polytope)
}

/// Those that are marked.
pub fn only<T: Clone>(all: &[T], marked: &[bool]) -> Vec<T> {
    all.iter().zip(marked).filter(|(_, marked)| **marked).map(|(one, _)| one.clone()).collect()
}

/// Faces that the contacts show, without those that others explain, in order where they plausibly are.
pub(super) fn fitted(dimension: usize, contacts: &[Contact]) -> Result<Faces, Refusal> {
    let faces = Faces::fit(dimension, contacts).ok_or(Refusal::NoNormals)?;
    Ok(faces.simplified(contacts).regular(contacts))
}

/// The shape that known faces and the contacts that they were fitted to make. Sides that nobody touched
/// are closed at the outermost contacts; `free` are points known to be outside.
///
/// # Errors
/// When they enclose nothing.
pub fn close(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Result<Polytope, Refusal> {
    let limit = UNTOUCHED * farthest(contacts);
    let closed = |closing: &[Face]| assemble(faces, contacts, free, closing);
    let wide = closed(&[]);
    let far = |p: &Polytope| untouched(p, contacts).distance;
    let mut closings = closures(faces, contacts, COUNTERPART);
    let is_missed = |p: &Polytope| {
        let Corner { distance, expected } = untouched(p, contacts);
        distance > limit && expected > EXPECTED
    };
    if closings.is_empty() && wide.as_ref().is_some_and(is_missed) {
        closings = closures(faces, contacts, OPPOSITE);
    }
    let near = |p: &Polytope| closings.is_empty() || far(p) <= limit;
    let polytope = match wide {
        Some(polytope) if near(&polytope) => Some(polytope),
        // One plane where that suffices, else all.
        wide => closings
            .chunks(1)
            .take(MOST_CLOSINGS)
            .filter_map(|one| closed(one).filter(|p| near(p)))
            .min_by(|a, b| far(a).total_cmp(&far(b)))
            .or_else(|| closed(&closings))
            .or(wide),
    };
    polytope.ok_or(Refusal::Open {
        faces: faces.faces.len(),
        contacts: contacts.iter().filter(|c| c.normal.is_some()).count(),
    })
}

/// The polytope, if it is to be trusted. Contacts that are said to be very exact, and are not quite
/// where faces and sharp edges would have them, get a second chance with three times the deviations.
///
/// # Errors
/// Says which sign speaks against it.
pub fn judge(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    judged(dimension, contacts, free).map(|(object, _)| object)
}

/// The same, and the contacts with the deviations that they had when it was.
fn judged(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<((Faces, Polytope), Vec<Contact>), Refusal> {
    let refusal = match examine(dimension, contacts, free) {
        Ok(object) => return Ok((object, contacts.to_vec())),
        Err(refusal) => refusal,
    };
    let Some(slack) = slackened(contacts) else { return Err(refusal) };
    match examine(dimension, &slack, free) {
        Ok(object) => Ok((object, slack)),
        Err(_) => Err(refusal),
    }
}

/// Contacts that are said to be very exact, as exact as something real may suit them; `None` of others.
fn slackened(contacts: &[Contact]) -> Option<Vec<Contact>> {
    let slack = |c: &Contact| Contact {
        point_deviation: c.point_deviation * SLACK,
        normal_deviation: c.normal_deviation * SLACK,
        ..*c
    };
    are_exact(contacts).then(|| contacts.iter().map(slack).collect())
}

fn examine(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    let doubt = doubt(contacts);
    if doubt.is_finite() && doubt > DOUBT {
        return Err(Refusal::Doubtful { degrees: doubt.to_degrees() });
    }
    let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
    // The faces first: their figures are cheap.
    let faces = fitted(dimension, contacts)?;
    let lone = faces.unconfirmed(contacts).len();
    if too_many(lone, &faces, felt) {
        return Err(Refusal::Lone { lone, contacts: felt });
    }
    if faces.bending > BENT {
        return Err(Refusal::Curved { deviations: faces.bending });
    }
    let per_degree = faces.chi_squared / faces.degrees.max(1.0);
    if !misfit::is_close(per_degree, faces.degrees) {
        return Err(Refusal::Misfit { per_degree });
    }
    let polytope = close(&faces, contacts, free)?;
    let is_hollow = !faces.is_convex() && Body::hollow(dimension, contacts, &faces).is_some();
    let count = polytope.touched_planes();
    let share = if is_hollow { SHARE_HOLLOW } else { SHARE };
    if count as f64 > share * felt as f64 {
        return Err(Refusal::Few { faces: count, contacts: felt });
    }
    let unexplained = unexplained(&faces, &polytope, contacts);
    if unexplained as f64 > UNEXPLAINED * felt as f64 {
        return Err(Refusal::Unexplained { unexplained, contacts: felt });
    }
    let Corner { distance, expected } = untouched(&polytope, contacts);
    let is_open = |counterpart| !closures(&faces, contacts, counterpart).is_empty();
    let is_far = distance > UNTOUCHED * farthest(contacts);
    if !is_hollow && is_far && (is_open(COUNTERPART) || expected > EXPECTED && is_open(OPPOSITE)) {
        return Err(Refusal::Untouched { distance });
    }
    Ok((faces, polytope))
}

/// What the deviations of very exact contacts are multiplied with: real edges are a little round and
/// real skin gives a little.
const SLACK: f64 = 3.0;

/// Median deviation of normals that contacts with slack may have: as uncertain as usual ones, 5°.
const USUAL_DOUBT: f64 = 0.0873;

/// Whether contacts are so exact that nothing real suits them to their deviations.
fn are_exact(contacts: &[Contact]) -> bool {
    doubt(contacts) * SLACK <= USUAL_DOUBT
}

/// Whether faces with so much χ² per degree of freedom fit contacts.
pub fn fit(per_degree: f64, contacts: &[Contact]) -> bool {
    let slack = if are_exact(contacts) { SLACK } else { 1.0 };
    per_degree <= misfit::MOST * slack * slack
}

/// Median standard deviation of the contacts' normals, radians; infinite without any.
pub(super) fn doubt(contacts: &[Contact]) -> f64 {
    let felt = contacts.iter().filter(|c| c.normal.is_some());
    let mut deviations: Vec<f64> = felt.map(|c| c.normal_deviation).collect();
    deviations.sort_by(f64::total_cmp);
    deviations.get(deviations.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The distance from the contacts' centre to the farthest, metres.
pub(super) fn farthest(contacts: &[Contact]) -> f64 {
    let centre = centroid(contacts.iter().map(|c| c.point));
    contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max)
}

/// The corner that lies farthest from every contact.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    /// To the nearest contact, metres.
    distance: f64,
    /// Contacts that would lie nearer if they were spread evenly.
    expected: f64,
}

fn untouched(polytope: &Polytope, contacts: &[Contact]) -> Corner {
    // Corners, with how much surface lies within a metre of each if its sides go on as far.
    let (corners, surface, power): (Vec<(Point, f64)>, f64, i32) = match &polytope.geometry {
        Geometry::Outline(outline) => {
            let corners = outline.loops.iter().flatten();
            let corners = corners.map(|v| (Point::new(v[0], v[1], 0.0), 2.0));
            (corners.collect(), outline.perimeter(), 1)
        }
        Geometry::Mesh(mesh) => {
            let angles = mesh.angles().into_iter().map(|angle| 0.5 * angle);
            (mesh.vertices().iter().copied().zip(angles).collect(), mesh.area(), 2)
        }
    };
    let corner = |(corner, within): &(Point, f64)| {
        let away = contacts.iter().map(|c| (c.point - corner).norm());
        let distance = away.fold(f64::INFINITY, f64::min);
        let share = within * distance.powi(power) / surface;
        Corner { distance, expected: contacts.len() as f64 * share }
    };
    let corners = corners.iter().map(corner);
    corners.max_by(|a, b| a.distance.total_cmp(&b.distance)).unwrap_or_default()
}

/// How many contacts lie off every face they belong to, as far as that is surface.
fn unexplained(faces: &Faces, polytope: &Polytope, contacts: &[Contact]) -> usize {
    lost(faces, polytope, contacts).into_iter().filter(|lost| *lost).count()
}

/// Which contacts do.
fn lost(faces: &Faces, polytope: &Polytope, contacts: &[Contact]) -> Vec<bool> {
    let lost = |(contact, owner): (&Contact, &Option<Owner>)| {
        let Some(owner) = owner else { return contact.normal.is_some() };
        owner.faces().iter().any(|face| {
            let variance =
                contact.point_deviation.powi(2) + polytope.planes[*face].variance(&contact.point);
            polytope
                .nearest(&contact.point, Some(*face))
                .is_none_or(|(.., distance)| distance > FAR * variance.sqrt())
        })
    };
    contacts.iter().zip(&faces.owners).map(lost).collect()
}

#[cfg(test)]
mod tests;
