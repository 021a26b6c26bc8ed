//! The models that experiments compare, each from contacts to a shape.

use crate::reference::hyper::{Belief, Search};
use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::shape::Geometry;
use crate::slam::choose::Choice;
use crate::slam::reconstruct;

/// A way to make a shape of contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// What `tactile slam` does.
    Auto,
    /// Fitted faces, where they close.
    Faces,
    /// The Gaussian process alone.
    Gp,
    /// The thesis' squared exponential: values ±1 beside every contact (2.2.2) and the parameters
    /// of greatest likelihood.
    SquaredExponential,
    /// The thesis' thin plate with the same training.
    ThinPlate,
    /// The Gaussian process about a positive constant: outside unless told otherwise (thesis 2.18).
    Outside,
    /// The Gaussian process about zero: on the surface unless told otherwise.
    Undecided,
}

/// A shape in the object frame.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Metres.
    pub geometry: Geometry,
    /// Standard deviation at each vertex, metres.
    pub deviations: Vec<f64>,
}

/// How far beside a contact the thesis' training puts ±1, metres; it does not say.
const BESIDE: f64 = 0.01;

/// The thesis seeks the greatest likelihood: hardly any belief beforehand.
const INDIFFERENT: Belief = Belief { mode: 1.0, deviation: 3.0, bounds: (0.1, 10.0) };

impl Model {
    /// As tables name it.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Auto => "auto",
            Model::Faces => "faces",
            Model::Gp => "gp",
            Model::SquaredExponential => "thesis SE",
            Model::ThinPlate => "thesis TP",
            Model::Outside => "prior outside",
            Model::Undecided => "prior zero",
        }
    }

    /// The shape of contacts in the object frame; `None` where the model gives none.
    pub fn reconstruct(&self, dimension: usize, contacts: &[Contact]) -> Option<Shape> {
        let ours = |choice| {
            let (_, geometry, deviations) =
                reconstruct::shape(dimension, contacts, &[], choice).ok()?;
            Some(Shape { geometry, deviations })
        };
        match self {
            Model::Auto => ours(Choice::Auto),
            Model::Faces => ours(Choice::Faces),
            Model::Gp => ours(Choice::Gp),
            Model::SquaredExponential => thesis(dimension, contacts, |radius| {
                Kernel::SquaredExponential { amplitude: radius, lengthscale: radius }
            }),
            Model::ThinPlate => thesis(dimension, contacts, |radius| Kernel::ThinPlate {
                amplitude: radius,
                range: 8.0 * radius,
            }),
            Model::Outside => about(dimension, contacts, 0.5),
            Model::Undecided => about(dimension, contacts, 0.0),
        }
    }
}

/// About a constant mean of so many radii of the object, with our kernel and training.
fn about(dimension: usize, contacts: &[Contact], radii: f64) -> Option<Shape> {
    let radius = radius(contacts)?;
    let (prior, training) = (Prior::Constant(radii * radius), Training::Derivative);
    let family = Kernel::Matern32 { amplitude: radius, lengthscale: radius };
    seek(dimension, contacts, family, prior, training, Search::default())
}

/// Of the ball about the contacts, metres.
fn radius(contacts: &[Contact]) -> Option<f64> {
    match Prior::about(contacts.iter().map(|c| c.point))? {
        Prior::Ball { radius, .. } => Some(radius),
        Prior::Constant(_) => None,
    }
}

fn thesis(dimension: usize, contacts: &[Contact], kernel: impl Fn(f64) -> Kernel) -> Option<Shape> {
    let radius = radius(contacts)?;
    let search = Search { amplitude: INDIFFERENT, lengthscale: INDIFFERENT, noise: None };
    let (prior, training) = (Prior::Constant(0.0), Training::OffSurface { distance: BESIDE });
    seek(dimension, contacts, kernel(radius), prior, training, search)
}

/// The surface with the kernel's most plausible parameters.
fn seek(
    dimension: usize,
    contacts: &[Contact],
    family: Kernel,
    prior: Prior,
    training: Training,
    search: Search,
) -> Option<Shape> {
    let radius = radius(contacts)?;
    let found = search.run(dimension, family, prior, training, contacts, radius).ok()?;
    let contacts: Vec<Contact> = contacts.iter().map(|c| c.with_noise(found.noise)).collect();
    let gpis = Gpis::fit(dimension, found.kernel, prior, training, &contacts).ok()?;
    let (geometry, deviations) = reconstruct::extract(dimension, &gpis, &contacts).ok()?;
    Some(Shape { geometry, deviations })
}
