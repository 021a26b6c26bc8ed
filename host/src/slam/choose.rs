//! Which surface model suits the contacts: fitted faces where every sign says that the object is a
//! convex polytope, the Gaussian process otherwise.

use crate::reference::faces::Faces;
use crate::reference::{Contact, Kernel};
use crate::shape::polytope::{Polytope, intersect};
use crate::space::Point;

/// What the user wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Choice {
    /// Faces where they are trustworthy, see [`judge`], else the Gaussian process.
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
    /// A convex polytope.
    Faces(Faces),
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
    /// A contact lies outside another face.
    #[error("the contacts show a concavity: one lies {deviations:.1} deviations outside a face")]
    Concave {
        /// [`Faces::protrusion`].
        deviations: f64,
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
    /// A corner reaches so far beyond the contacts that a side may have been missed.
    #[error("a corner reaches {reach:.1} deviations beyond what the other contacts make likely")]
    Untouched {
        /// In deviations.
        reach: f64,
    },
}

/// χ²/dof above which faces do not fit, and as many deviations above 1 where there are so few
/// contacts that this is more: about 1 on polytopes, about 2 on curves.
const MISFIT: f64 = 1.4;
const MISFIT_DEVIATIONS: f64 = 2.0;

/// Deviations of bending that flat faces do not show: once in a hundred.
const BENT: f64 = 2.3;

/// Most faces per contact.
const SHARE: f64 = 0.6;

/// A shape is closed when it reaches no further from the contacts' centre than this many times the
/// farthest contact.
const REACH: f64 = 2.0;

/// The polytope of the faces, whatever it fits like.
///
/// # Errors
/// When no contact has a normal, or the faces leave the object open.
pub fn polytope(dimension: usize, contacts: &[Contact]) -> Result<(Faces, Polytope), Refusal> {
    let faces = Faces::fit(dimension, contacts).ok_or(Refusal::NoNormals)?;
    let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len().max(1) as f64;
    let farthest = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
    let open = Refusal::Open { faces: faces.faces.len(), contacts: contacts.len() };
    let polytope = intersect(&faces, &centre, REACH * farthest).ok_or(open)?;
    Ok((faces, polytope))
}

/// The polytope, if it is to be trusted.
///
/// # Errors
/// Says which sign speaks against it.
pub fn judge(dimension: usize, contacts: &[Contact]) -> Result<(Faces, Polytope), Refusal> {
    let (faces, polytope) = polytope(dimension, contacts)?;
    let (count, felt) = (faces.faces.len(), faces.faces.iter().map(|f| f.contacts).sum());
    if !faces.is_convex() {
        return Err(Refusal::Concave { deviations: faces.protrusion });
    }
    if count as f64 > SHARE * felt as f64 {
        return Err(Refusal::Few { faces: count, contacts: felt });
    }
    if faces.bending > BENT {
        return Err(Refusal::Curved { deviations: faces.bending });
    }
    let per_degree = faces.chi_squared / faces.degrees.max(1.0);
    let scatter = (2.0 / faces.degrees.max(1.0)).sqrt();
    if per_degree > MISFIT.max(1.0 + MISFIT_DEVIATIONS * scatter) {
        return Err(Refusal::Misfit { per_degree });
    }
    Ok((faces, polytope))
}
