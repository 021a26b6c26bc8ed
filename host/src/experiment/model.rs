//! The models that experiments compare, each from contacts to a shape.

use crate::reference::hyper::{Belief, Search};
use crate::reference::{Contact, Gpis, Kernel, Local, Prior, Spheres, Training};
use crate::shape::occupancy::{Layout, Occupancy};
use crate::shape::superquadric::Superquadric;
use crate::shape::{Field, Geometry, contour, nagata, surface};
use crate::slam::choose::Choice;
use crate::slam::reconstruct;
use crate::space::Point;
use crate::thin::evenly;

/// A way to make a shape of contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// What `tactile slam` does.
    Auto,
    /// Fitted faces, where they close.
    Faces,
    /// The Gaussian process alone.
    Gp,
    /// The thesis' squared exponential with the parameters of greatest likelihood: values ±1 beside
    /// every contact (2.2.2), and in space between two spheres (2.2.4).
    SquaredExponential,
    /// The thesis' thin plate with the same training.
    ThinPlate,
    /// The Gaussian process about a positive constant: outside unless told otherwise (thesis 2.18).
    Outside,
    /// The Gaussian process about zero: on the surface unless told otherwise.
    Undecided,
    /// Thesis 2.21 to 2.23: contacts as planes that meet in corners.
    Local,
    /// Thesis 2.1, fitted to points and normals.
    Superquadric,
    /// Thesis 2.2, through the contacts.
    Nagata,
    /// Cells of 5 mm that were touched.
    Occupancy,
    /// The contacts themselves: no surface, see [`Cloud`](crate::shape::cloud::Cloud).
    Cloud,
}

/// A shape in the object frame.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Metres.
    pub geometry: Geometry,
    /// Standard deviation at each vertex, metres; empty where the model knows none.
    pub deviations: Vec<f64>,
}

/// How far beside a contact the thesis' training puts ±1, metres; it does not say.
const BESIDE: f64 = 0.01;

/// Lattice cells across the contacts, as [`reconstruct`] has them.
const PLANAR_CELLS: f64 = 120.0;
const SPATIAL_CELLS: f64 = 40.0;

/// Contacts that decide a kernel's parameters at most; the fit itself uses all.
const DECIDING: usize = 60;

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
            Model::Local => "local",
            Model::Superquadric => "superquadric",
            Model::Nagata => "Nagata",
            Model::Occupancy => "occupancy",
            Model::Cloud => "cloud",
        }
    }

    /// The shape of contacts in the object frame; `None` where the model gives none.
    pub fn reconstruct(&self, dimension: usize, contacts: &[Contact]) -> Option<Shape> {
        let ours = |choice| {
            let reconstruct::Shape { geometry, deviations, .. } = reconstruct::shape(
                dimension,
                contacts,
                &[],
                reconstruct::Poses::Known,
                choice,
                &|_, _| {},
            )
            .ok()?;
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
            Model::Local => {
                let local = Local::fit(dimension, None, contacts).ok()?;
                bounded(dimension, &local, contacts)
            }
            Model::Superquadric => {
                let fitted = Superquadric::fit(dimension, contacts).ok()?;
                let geometry = fitted.geometry();
                let deviations = fitted.deviations(&vertices(&geometry));
                Some(Shape { geometry, deviations })
            }
            Model::Nagata => {
                let geometry = nagata::interpolate(dimension, contacts).ok()?;
                Some(Shape { geometry, deviations: vec![] })
            }
            Model::Occupancy => {
                let grid = Occupancy::new(dimension, Layout::default(), contacts, &[]).ok()?;
                Some(Shape { geometry: grid.geometry(), deviations: vec![] })
            }
            Model::Cloud => None,
        }
    }
}

/// Of an outline, loop after loop, or of a mesh.
fn vertices(geometry: &Geometry) -> Vec<Point> {
    match geometry {
        Geometry::Outline(o) => {
            o.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect()
        }
        Geometry::Mesh(m) => m.vertices().to_vec(),
    }
}

/// About a constant mean of so many radii of the object, with our kernel and training.
fn about(dimension: usize, contacts: &[Contact], radii: f64) -> Option<Shape> {
    let radius = radius(contacts)?;
    let (prior, training) = (Prior::Constant(radii * radius), Training::Derivative);
    let family = Kernel::Matern32 { amplitude: radius, lengthscale: radius };
    let search = (Search::default(), radius);
    let gpis = seek(dimension, contacts, family, prior, training, search)?;
    let (geometry, deviations) = reconstruct::extract(dimension, &gpis, contacts).ok()?;
    Some(Shape { geometry, deviations })
}

/// Of the ball about the contacts, metres.
fn radius(contacts: &[Contact]) -> Option<f64> {
    match Prior::about(contacts.iter().map(|c| c.point))? {
        Prior::Ball { radius, .. } => Some(radius),
        _ => None,
    }
}

/// In space lengths are multiples of the contacts' extent.
fn thesis(dimension: usize, contacts: &[Contact], kernel: impl Fn(f64) -> Kernel) -> Option<Shape> {
    let search = Search { amplitude: INDIFFERENT, lengthscale: INDIFFERENT, noise: None };
    let (training, radius) = match dimension {
        2 => (Training::OffSurface { distance: BESIDE }, radius(contacts)?),
        _ => (Training::Spheres(Spheres::FEW), 1.0),
    };
    let prior = Prior::Constant(0.0);
    let gpis = seek(dimension, contacts, kernel(radius), prior, training, (search, radius))?;
    bounded(dimension, &gpis, contacts)
}

/// The touched part of the zero set where the thesis looks for it: on a grid that the contact data
/// delimit (2.2.2), here out to the farthest training points. Beyond them a field about zero crosses
/// zero anywhere.
fn bounded(dimension: usize, field: &dyn Field, contacts: &[Contact]) -> Option<Shape> {
    let points: Vec<Point> = contacts.iter().map(|c| c.point).collect();
    let first = points.first()?;
    let low = points.iter().fold(*first, |low, p| low.inf(p));
    let high = points.iter().fold(*first, |high, p| high.sup(p));
    let margin = Point::repeat(BESIDE);
    let bounds = (low - margin, high + margin);
    let size = (high - low).amax().max(BESIDE);
    if dimension == 2 {
        let contour = contour::extract(field, bounds, size / PLANAR_CELLS).ok()?.touched(&points);
        let geometry = Geometry::Outline(contour.outline);
        Some(Shape { geometry, deviations: contour.deviations })
    } else {
        let surface = surface::extract(field, bounds, size / SPATIAL_CELLS).ok()?.touched(&points);
        Some(Shape { geometry: Geometry::Mesh(surface.mesh), deviations: surface.deviations })
    }
}

/// The surface with the kernel's most plausible parameters; `search` comes with the radius that
/// they are multiples of.
fn seek(
    dimension: usize,
    contacts: &[Contact],
    family: Kernel,
    prior: Prior,
    training: Training,
    (search, radius): (Search, f64),
) -> Option<Gpis> {
    let deciding = evenly(contacts, DECIDING);
    let found = search.run(dimension, family, prior, training, &deciding, radius).ok()?;
    let contacts: Vec<Contact> = contacts.iter().map(|c| c.with_noise(found.noise)).collect();
    Gpis::fit(dimension, found.kernel, prior, training, &contacts).ok()
}
