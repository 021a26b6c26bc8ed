//! From contacts at known poses to a surface: fitted faces where they suit, else a Gaussian process,
//! dense over few contacts and of local experts over many, its hyper-parameters by marginal
//! likelihood, and the outline or mesh of its zero set.

use nalgebra::Matrix6;

use crate::experts;
use crate::log::GraspLog;
use crate::model::notched::Found;
use crate::model::{Doubt, Faces, Mirror, Open, bare};
use crate::reference::Contact;
use crate::reference::gpis::Error as SurfaceError;
use crate::shape::Geometry;
use crate::shape::lattice::LatticeError;
use crate::shape::polytope::{FAR, Polytope, intersection, solid};
use crate::slam::Progress;
use crate::slam::choose::{self, Choice, Model, Refusal, only};
pub use crate::slam::extraction::{extract, extract_at};
use crate::slam::fit::{self, Fitted, fit_experts, open_beside};
use crate::slam::free::Free;
use crate::slam::mirrors::Mirrored;
use crate::slam::place::{Placed, free, place};
use crate::slam::sift;
use crate::slam::track::Step;
use crate::space::{Point, Pose};
use crate::thin::evenly;

/// A surface, in the frame of the contacts that it was made of.
#[derive(Clone, Debug)]
pub struct Shape {
    /// What it was made with.
    pub model: Model,
    /// Outline or mesh: the polytope of the faces, or the touched part of the zero set.
    pub geometry: Geometry,
    /// Standard deviation along the normal at each of its vertices, metres.
    pub deviations: Vec<f64>,
    /// Planes that contacts were reflected in, for the object seems to be its own image there ([`Mirrored`]).
    pub mirrors: Vec<Mirror>,
}

/// Where the poses come from that put contacts into the object frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poses {
    /// They are known.
    Known,
    /// They were estimated. Contacts of one grasp are then wrong together, which makes wrong mirrors likely, so
    /// that none are sought: on simulated hands one shape of twelve gained 10 mm by them, and one lost 11.
    Estimated,
}

impl Poses {
    fn of(steps: &[Step]) -> Poses {
        let is_known = steps.iter().all(|step| step.covariance == Matrix6::zeros());
        if is_known { Poses::Known } else { Poses::Estimated }
    }

    /// The contacts and their images, where there are mirrors.
    fn mirrored(self, dimension: usize, contacts: &[Contact]) -> Option<Mirrored> {
        match self {
            Poses::Known => Mirrored::of(dimension, contacts),
            Poses::Estimated => None,
        }
    }
}

/// A reconstructed object.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Outline or mesh, object frame: the polytope of the faces, or the touched part of the zero set.
    pub geometry: Geometry,
    /// Standard deviation along the normal at each of its vertices, metres.
    pub deviations: Vec<f64>,
    /// All contacts of the log but those of [lost](place()) grasps; wild ones that it was made without among them.
    pub contacts: Vec<Placed>,
    /// What it was made with.
    pub model: Model,
    /// Planes that it was taken to be its own mirror image in, object frame.
    pub mirrors: Vec<Mirror>,
}

/// Why there is no reconstruction.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Not one contact in the log, or none but those of lost grasps.
    #[error("no contacts: there is nothing to reconstruct")]
    NoContacts,
    /// The Gaussian process cannot be fitted.
    #[error("surface: {0}")]
    Surface(#[from] SurfaceError),
    /// Nor can the one of local experts.
    #[error("surface: {0}")]
    Experts(#[from] experts::Error),
    /// Faces were asked for and make no closed shape.
    #[error("faces: {0}")]
    Faces(Refusal),
    /// The contacts span no usable volume.
    #[error("surface extraction: {0}")]
    Lattice(#[from] LatticeError),
}

/// Contacts that decide about faces at most, and that they are fitted to: the effort grows with the
/// number of faces found, and each plane is known to a tenth of the noise by then.
const FACED: usize = 1_000;

/// Contacts that a box less smaller boxes is made from at most: it takes as long as there are many.
pub(super) const NOTCHED: usize = 80;

/// χ² per degree of freedom up to which a body nearly explains contacts. Most bodies are their own images already; what
/// they leave is then of rough or rounded sides, and images would make it larger than it is.
const NEARLY: f64 = 3.0;

/// Contacts that may make a side between them though they are wild.
const PAIR: usize = 2;

/// Deviations by which a free point may lie inside.
const SURELY: f64 = 2.0;

/// Deviation of a free point, in those of contacts, above which it says nothing of faces.
const VAGUE: f64 = 3.0;

/// Contacts that a dense Gaussian process takes at most in the plane and in space; more make local
/// experts, which are as accurate and from there on faster.
const DENSE: [usize; 2] = [800, 400];

/// Refuses a log that [`reconstruct()`] could not take, before anything long is begun.
///
/// # Errors
/// Without contacts.
pub fn check(log: &GraspLog) -> Result<(), Error> {
    if log.grasps.iter().all(|g| g.contacts.is_empty()) { Err(Error::NoContacts) } else { Ok(()) }
}

/// Places every contact of the log by the steps' poses and reconstructs the object.
///
/// # Errors
/// Without contacts, those of lost grasps left out; when faces are asked for and leave the object open; when a
/// contact has unusable numbers, or few are too coincident for a dense surface.
pub fn reconstruct(
    log: &GraspLog,
    steps: &[Step],
    choice: Choice,
    progress: Progress<'_>,
) -> Result<Reconstruction, Error> {
    reconstruct_known(log, steps, None, choice, progress)
}

/// The same where faces were estimated together with the poses, from all contacts of the log in their
/// order: if they suit all contacts ([`choose::trusted`]), these are the shape's; where some are wild, it is made of
/// the contacts alone, as of those at known poses but for mirrors.
///
/// # Errors
/// As [`reconstruct()`].
pub fn reconstruct_known(
    log: &GraspLog,
    steps: &[Step],
    faces: Option<&Faces>,
    choice: Choice,
    progress: Progress<'_>,
) -> Result<Reconstruction, Error> {
    let placed = place(log, steps);
    let near = sift::near(&placed);
    let all: Vec<Contact> = only(&placed, &near).iter().map(|p| p.contact).collect();
    if all.is_empty() {
        return Err(Error::NoContacts);
    }
    let free = free(log, steps);
    let shape = match faces {
        None => shape(log.dimension, &all, &free, Poses::of(steps), choice, progress)?,
        Some(faces) => {
            let faces = Faces { owners: only(&faces.owners, &near), ..faces.clone() };
            with_normals(log.dimension, &all, &free, |all| {
                of_known(&faces, all, &free, choice, progress)
            })?
        }
    };
    Ok(Reconstruction::new(shape, placed))
}

/// The shape of faces that a graph knows. Where some of the contacts are wild, they may have made faces among themselves
/// in it, or kept sides from it that were felt once: then it is made of the contacts alone.
fn of_known(
    faces: &Faces,
    all: &[Contact],
    free: &[Free],
    choice: Choice,
    progress: Progress<'_>,
) -> Result<Shape, Error> {
    let dimension = faces.dimension;
    let outside = outside(all, free);
    let trusted = choose::trusted(faces, all, &outside);
    let contacts = only(all, &trusted);
    let are_all = || contacts.len() == all.len() && choose::judge(dimension, all, &outside).is_ok();
    if choice == Choice::Auto && is_dense(dimension, all) && !are_all() {
        return among_wild(dimension, all, free, Poses::Estimated, progress);
    }
    let owners = only(&faces.owners, &trusted);
    let faces = Faces::explaining(dimension, &contacts, faces.faces.clone(), owners);
    let known = || choose::known(&faces, &contacts, &outside);
    let felt = Felt::believed(&contacts, free);
    shape_of(dimension, felt, &known, Poses::Estimated, choice, progress)
}

impl Shape {
    fn flat(polytope: Polytope, mirrors: Vec<Mirror>) -> Shape {
        let (geometry, deviations) = (polytope.geometry.clone(), polytope.deviations.clone());
        Shape { model: Model::Faces(Box::new(polytope)), geometry, deviations, mirrors }
    }

    /// The touched part of a process' zero set.
    fn curved(dimension: usize, fitted: &Fitted, felt: Mirrored) -> Result<Shape, Error> {
        let (geometry, deviations) = extract(dimension, &fitted.surface, &felt.contacts)?;
        let model = Model::Gp(fitted.kernel);
        Ok(Shape { model, geometry, deviations, mirrors: felt.mirrors })
    }

    /// As uncertain where nobody touched it as what the `contacts` leave open.
    fn doubted(mut self, contacts: &[Contact], doubt: Option<Doubt>) -> Shape {
        match self.model {
            Model::Faces(polytope) => Shape::flat(polytope.doubted(doubt), self.mirrors),
            Model::Gp(_) => {
                let (vertices, normals) = (self.geometry.vertices(), self.geometry.normals());
                if let Some(doubt) = doubt {
                    self.deviations = doubt.widened(&vertices, &self.deviations);
                }
                let open = Open::of(contacts);
                let places = vertices.iter().zip(&normals);
                for (deviation, (vertex, normal)) in self.deviations.iter_mut().zip(places) {
                    *deviation = deviation.hypot(open.deviation(vertex, normal));
                }
                self
            }
        }
    }
}

/// The shape of contacts and free points in the object frame. Of as many as a dense surface takes, it is made without
/// those that [`sift`] does not trust. Where no body of few numbers nearly explains them, and where faces show a hollow,
/// what was felt is taken to hold for its mirror image, too, if the object seems to be its own ([`Mirrored`]) and
/// `poses` are known.
///
/// # Errors
/// As [`reconstruct()`].
pub fn shape(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    poses: Poses,
    choice: Choice,
    progress: Progress<'_>,
) -> Result<Shape, Error> {
    let shape = |contacts: &[Contact]| {
        if choice == Choice::Auto && poses == Poses::Known {
            return among_wild(dimension, contacts, free, poses, progress);
        }
        shape_of(dimension, Felt::believed(contacts, free), &|| None, poses, choice, progress)
    };
    with_normals(dimension, contacts, free, shape)
}

/// The `shape` of contacts that get the likeliest normals where they felt none ([`bare`]). Where that is no
/// flat one and most were guessed, bodies of few numbers that explain the points are better: a guess is no
/// measurement.
fn with_normals(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    shape: impl Fn(&[Contact]) -> Result<Shape, Error>,
) -> Result<Shape, Error> {
    let Some(guessed) = bare::guessed(dimension, contacts) else { return shape(contacts) };
    let shape = shape(&guessed)?;
    let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
    if !matches!(shape.model, Model::Gp(_))
        || !is_dense(dimension, contacts)
        || 2 * felt > contacts.len()
    {
        return Ok(shape);
    }
    let trusted = only(contacts, &sift::trusted(dimension, contacts));
    let Some(fitted) = fit::explained(dimension, &trusted, free)? else { return Ok(shape) };
    let shape = Shape::curved(dimension, &fitted, Mirrored::unmoved(&trusted))?;
    Ok(shape.doubted(&trusted, open_beside(dimension, &trusted, free)))
}

/// The same where some contacts may be wild.
fn among_wild(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    poses: Poses,
    progress: Progress<'_>,
) -> Result<Shape, Error> {
    let outside = outside(contacts, free);
    if !is_dense(dimension, contacts) {
        let felt = Felt { contacts, all: Some(contacts), free };
        return shape_of(dimension, felt, &|| None, poses, Choice::Auto, progress);
    }
    let all = match sift::beside_convex(dimension, contacts, &outside) {
        Some(convex) => only(contacts, &convex),
        None => contacts.to_vec(),
    };
    let trusted = only(&all, &sift::beside_faces(dimension, &all, &outside));
    let felt = Felt { contacts: &trusted, all: Some(&all), free };
    shape_of(dimension, felt, &|| None, poses, Choice::Auto, progress)
}

/// Whether a dense Gaussian process takes so many contacts.
fn is_dense(dimension: usize, contacts: &[Contact]) -> bool {
    contacts.len() <= DENSE[usize::from(dimension == 3)]
}

/// What a shape is made of, object frame.
#[derive(Clone, Copy)]
struct Felt<'a> {
    /// Those that are trusted.
    contacts: &'a [Contact],
    /// And those that may be wild, of which all but a few may make a box less smaller boxes; `None` where that is not to
    /// be asked.
    all: Option<&'a [Contact]>,
    /// Points outside.
    free: &'a [Free],
}

impl<'a> Felt<'a> {
    /// All of them.
    fn believed(contacts: &'a [Contact], free: &'a [Free]) -> Felt<'a> {
        Felt { contacts, all: None, free }
    }
}

/// The same, of faces that are `known` where flat sides suit the contacts and these are not equal.
fn shape_of(
    dimension: usize,
    felt: Felt<'_>,
    known: &dyn Fn() -> Option<Polytope>,
    poses: Poses,
    choice: Choice,
    progress: Progress<'_>,
) -> Result<Shape, Error> {
    let Felt { contacts, all, free } = felt;
    let boxes = || {
        let (polytope, trusted) = notched(dimension, contacts, all?, &outside(contacts, free))?;
        Some(
            Shape::flat(polytope, vec![]).doubted(&trusted, open_beside(dimension, &trusted, free)),
        )
    };
    let are_first = all.is_some() && are_boxes_first(dimension, contacts);
    if are_first && let Some(shape) = boxes() {
        return Ok(shape);
    }
    if let Some(polytope) = faced(dimension, contacts, free, known, choice)? {
        let shape = if choice == Choice::Auto
            && !polytope.is_convex()
            && let Some(felt) = poses.mirrored(dimension, contacts)
        {
            mirrored_faces(polytope, felt, dimension, free)?
        } else {
            Shape::flat(polytope, vec![])
        };
        return Ok(shape.doubted(contacts, open_beside(dimension, contacts, free)));
    }
    // Many contacts do not show sides that nobody felt.
    if !are_first && let Some(shape) = boxes() {
        return Ok(shape);
    }
    if !is_dense(dimension, contacts) {
        let (kernel, experts) = fit_experts(dimension, contacts)?;
        experts.settle(progress);
        let (geometry, deviations) = extract(dimension, &experts, contacts)?;
        let shape = Shape { model: Model::Gp(kernel), geometry, deviations, mirrors: vec![] };
        return Ok(shape.doubted(contacts, open_beside(dimension, contacts, free)));
    }
    let sift = if poses == Poses::Known { sift::trusted_at_known } else { sift::trusted };
    let trusted = only(contacts, &sift(dimension, contacts));
    let doubt = || open_beside(dimension, &trusted, free);
    if trusted.len() < contacts.len()
        && let Some(polytope) = faced(dimension, &trusted, free, known, choice)?
    {
        return Ok(Shape::flat(polytope, vec![]).doubted(&trusted, doubt()));
    }
    let fitted = fit::fit(dimension, &trusted, free)?;
    let mut shape = Shape::curved(dimension, &fitted, Mirrored::unmoved(&trusted))?;
    if !fitted.is_explained
        && fitted.misfit > NEARLY
        && let Some(felt) = poses.mirrored(dimension, &trusted)
    {
        shape = mirrored_surface(shape, felt, dimension, free, choice)?;
    }
    Ok(shape.doubted(&trusted, doubt()))
}

/// Whether a box less smaller boxes says more than faces: these show a hollow, and either they were felt by few contacts
/// each, or one by so few that these may be wild.
fn are_boxes_first(dimension: usize, contacts: &[Contact]) -> bool {
    if Found::says_more(dimension, &evenly(contacts, FACED)) {
        return true;
    }
    let is_doubtful =
        |faces: &Faces| !faces.is_convex() && faces.faces.iter().any(|face| face.contacts <= PAIR);
    contacts.len() <= NOTCHED && Faces::fit(dimension, contacts).as_ref().is_some_and(is_doubtful)
}

/// Whether a box less smaller boxes suits all but a few contacts, where some may be wild.
pub(crate) fn are_boxes(dimension: usize, contacts: &[Contact]) -> bool {
    sift::boxes(dimension, &evenly(contacts, NOTCHED), &[]).is_some()
}

/// A box less smaller boxes, made of few, where one suits the contacts or of `all` those that are not wild;
/// and all that it suits, as many as say how sure it is.
fn notched(
    dimension: usize,
    contacts: &[Contact],
    all: &[Contact],
    free: &[Point],
) -> Option<(Polytope, Vec<Contact>)> {
    let made = |found: Found, few: &[Contact]| {
        solid(&found.faces, few, |point| found.solid.contains(point))
    };
    let few = evenly(contacts, NOTCHED);
    if let Some(found) = Found::of(dimension, &few, free) {
        return Some((made(found, &few)?, contacts.to_vec()));
    }
    let few = evenly(all, NOTCHED);
    let (found, trusted) = sift::boxes(dimension, &few, free)?;
    let polytope = made(found, &only(&few, &trusted))?;
    let suited = all.iter().filter(|c| polytope.off(c) <= FAR).copied().collect();
    Some((polytope, suited))
}

/// Faces that show a hollow, or those of the contacts and their images, if these suit and are no more: of two that are
/// each other's image both are as well known as one was. What was felt they must explain as well: an L whose arms
/// are nearly as long is no image of itself.
fn mirrored_faces(
    own: Polytope,
    felt: Mirrored,
    dimension: usize,
    free: &[Free],
) -> Result<Shape, Error> {
    let mirrored = faced(dimension, &felt.contacts, free, &|| None, Choice::Auto)?;
    let contacts = &felt.contacts[..felt.contacts.len() >> felt.mirrors.len()];
    let is_worse = |faces: &Polytope, c: &Contact| faces.off(c) > own.off(c) + FAR;
    let suits = |faces: &Polytope| {
        faces.touched_planes() <= own.touched_planes()
            && felt.suits(&faces.geometry, &own.geometry)
            && !contacts.iter().any(|c| is_worse(faces, c))
    };
    Ok(match mirrored.filter(suits) {
        Some(mirrored) => Shape::flat(mirrored, felt.mirrors),
        None => Shape::flat(own, vec![]),
    })
}

/// A surface that no body of few numbers explains, or that of the contacts and their images, if it suits: faces where
/// these are trustworthy now.
fn mirrored_surface(
    own: Shape,
    felt: Mirrored,
    dimension: usize,
    free: &[Free],
    choice: Choice,
) -> Result<Shape, Error> {
    let mirrored = match faced(dimension, &felt.contacts, free, &|| None, choice)? {
        Some(polytope) => Shape::flat(polytope, felt.mirrors.clone()),
        None => {
            let fitted = fit::fit(dimension, &felt.contacts, free)?;
            Shape::curved(dimension, &fitted, felt.clone())?
        }
    };
    Ok(if felt.suits(&mirrored.geometry, &own.geometry) { mirrored } else { own })
}

/// The shape of faces, where that is the choice.
fn faced(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    known: &dyn Fn() -> Option<Polytope>,
    choice: Choice,
) -> Result<Option<Polytope>, Error> {
    let few = evenly(contacts, FACED);
    let outside = outside(&few, free);
    let own = match choice {
        Choice::Auto => {
            let Ok((faces, own)) = choose::judge(dimension, &few, &outside) else {
                return Ok(None);
            };
            if let Some(body) = fit::simpler(dimension, &few, &faces) {
                let sides = body.sides(dimension, &few).filter(|sides| is_open(sides, free));
                return Ok(sides.and_then(|sides| intersection(&sides, &few)));
            }
            own
        }
        Choice::Faces => choose::polytope(dimension, &few, &outside).map_err(Error::Faces)?.1,
        Choice::Gp => return Ok(None),
    };
    Ok(Some(known().unwrap_or(own)))
}

/// Where they are, without those in more doubt than contacts usually are by [`VAGUE`]: what weighs points
/// beside faces takes each for as certain as a contact, and those of one grasp at a doubtful pose, wrong
/// together, would outweigh many.
pub(crate) fn outside(contacts: &[Contact], free: &[Free]) -> Vec<Point> {
    let mut deviations: Vec<f64> = contacts.iter().map(|c| c.point_deviation).collect();
    deviations.sort_by(f64::total_cmp);
    let usual = deviations.get(deviations.len() / 2).copied().unwrap_or(f64::INFINITY);
    free.iter().filter(|f| f.deviation <= VAGUE * usual).map(|f| f.point).collect()
}

/// Whether no free point lies surely behind all these sides.
fn is_open(sides: &Faces, free: &[Free]) -> bool {
    let is_outside =
        |f: &Free| sides.active(&f.point).is_none_or(|(value, _)| value > -SURELY * f.deviation);
    free.iter().all(is_outside)
}

impl Reconstruction {
    /// The shape of these contacts, and of wild ones that it was made without.
    pub fn new(shape: Shape, contacts: Vec<Placed>) -> Reconstruction {
        let Shape { model, geometry, deviations, mirrors } = shape;
        Reconstruction { geometry, deviations, contacts, model, mirrors }
    }

    /// Everything in another frame.
    pub fn transformed(&self, pose: &Pose) -> Reconstruction {
        Reconstruction {
            geometry: self.geometry.transformed(pose),
            deviations: self.deviations.clone(),
            contacts: self
                .contacts
                .iter()
                .map(|p| Placed { contact: p.contact.transformed(pose), ..*p })
                .collect(),
            model: self.model.clone(),
            mirrors: self.mirrors.iter().map(|mirror| mirror.transformed(pose)).collect(),
        }
    }
}

#[cfg(test)]
#[path = "reconstruct_tests.rs"]
mod tests;
