//! A body of few parts as the mean of the Gaussian process: a ball or another quadric, cut by
//! planes, planes alone, a block, a regular prism, a superquadric, or nothing but a box where contacts show a hollow.
//!
//! Most things that hands hold are a round body with a few flat ends: a can is a cylinder between
//! two planes, a cup a cone between them, a bottle an ellipsoid on a plane; a block or a nut is planes alone.
//! The body carries what many contacts say together, and the process what is left.

use std::sync::Arc;

use nalgebra::{Matrix3, SymmetricEigen};

use crate::reference::gpis::Error;
use crate::reference::mean::{Local, Mean};
use crate::reference::{Contact, Prior};
use crate::shape::superquadric;
use crate::space::Point;

mod block;
mod blunt;
mod close;
mod end;
mod fit;
mod hollow;
mod moved;
mod regular;
mod sides;
mod size;
mod turned;

pub(crate) use fit::MISFIT;

/// The convex quadric √((p − c)ᵀ A (p − c)) = 1 + t·(p − c) with A positive semi-definite. Without the
/// taper t it is that of the thesis (2.19 and 2.20; an eigenvalue of zero makes a cylinder); with one it
/// may be a cone, too, or one sheet of a hyperboloid, and holds its centre c all the same. As a distance
/// to first order: with the gauge g = √((p − c)ᵀ A (p − c)) − t·(p − c), the field (g − 1)/|∇g| has a
/// gradient of length 1 on the surface, whatever the axes, and is the exact distance of the side of a
/// round cylinder or cone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadric {
    centre: Point,
    form: Matrix3<f64>,
    taper: Point,
    /// Greatest slope of the gauge without the taper, 1/metre: of a ball, its inverse radius.
    steepest: f64,
}

impl Quadric {
    /// About `centre` (metres) with `form` A (1/m²; in the plane its last row and column are zero), as
    /// wide everywhere. `None` unless both are finite and A has a positive eigenvalue.
    pub fn new(centre: Point, form: Matrix3<f64>) -> Option<Quadric> {
        Quadric::tapered(centre, form, Point::zeros())
    }

    /// The same with `taper` t (1/metre): how fast it widens, as a share of its width about the centre.
    /// `None` unless all are finite and A has a positive eigenvalue.
    pub fn tapered(centre: Point, form: Matrix3<f64>, taper: Point) -> Option<Quadric> {
        let is_finite = |numbers: &[f64]| numbers.iter().all(|x| x.is_finite());
        if ![centre.as_slice(), form.as_slice(), taper.as_slice()].into_iter().all(is_finite) {
            return None;
        }
        let steepest = SymmetricEigen::new(form).eigenvalues.max().sqrt();
        let quadric = Quadric { centre, form, taper, steepest };
        (steepest > 0.0 && steepest.recip().is_finite()).then_some(quadric)
    }

    /// c, metres.
    pub fn centre(&self) -> Point {
        self.centre
    }

    /// A, 1/m².
    pub fn form(&self) -> Matrix3<f64> {
        self.form
    }

    /// t, 1/metre.
    pub fn taper(&self) -> Point {
        self.taper
    }

    /// g and its gradient, 1/metre.
    fn gauge(&self, p: &Point) -> (f64, Point) {
        let v = p - self.centre;
        let w = self.form * v;
        let q = v.dot(&w).max(0.0).sqrt();
        let slope = if q > 0.0 { w / q } else { Point::zeros() };
        (q - self.taper.dot(&v), slope - self.taper)
    }

    fn at(&self, p: &Point) -> Local {
        let v = p - self.centre;
        let w = self.form * v;
        let q = v.dot(&w).max(0.0).sqrt();
        let beyond = q - self.taper.dot(&v) - 1.0;
        // At the centre, and on the axis of a cylinder, there is no direction to the surface.
        if !(q > 1e-6) {
            let slope = self.steepest.hypot(self.taper.norm());
            return (beyond / slope, -self.taper / slope);
        }
        let gradient = w / q - self.taper;
        let slope = gradient.norm();
        if !(slope > 0.0) {
            return (beyond / self.steepest, Point::zeros());
        }
        let value = beyond / slope;
        let bend = (self.form * gradient - w * (w.dot(&gradient) / (q * q))) / q;
        (value, (gradient - bend * (value / slope)) / slope)
    }
}

/// The half-space n·p ≤ ρ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit, out of the object.
    pub normal: Point,
    /// ρ, metres.
    pub offset: f64,
}

/// What a body is the intersection of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// A ball, or [`Prior`] of another kind, in its own form: as a square it is smooth at the
    /// centre, which matters where an object is much thinner than the ball about it.
    Prior(Prior),
    /// Ellipsoid, cylinder, cone and what is between.
    Quadric(Quadric),
    /// Between ellipsoid, box and cylinder (thesis 2.1).
    Superquadric(superquadric::Form),
    /// Flat end.
    Plane(Plane),
}

impl Part {
    /// Value and gradient at `p`.
    pub fn at(&self, p: &Point) -> Local {
        match self {
            Part::Prior(prior) => (prior.value(p), prior.gradient(p)),
            Part::Quadric(quadric) => quadric.at(p),
            Part::Superquadric(form) => form.distance(p),
            Part::Plane(plane) => (plane.normal.dot(p) - plane.offset, plane.normal),
        }
    }

    /// Where on its surface a round part is asked for what lies outside.
    fn foot(&self, p: &Point) -> Foot {
        let (centre, (gauge, slope)) = match self {
            Part::Quadric(quadric) => (quadric.centre, quadric.gauge(p)),
            Part::Superquadric(form) => (form.centre(), form.gauge(p)),
            Part::Prior(_) | Part::Plane(_) => (*p, (1.0, Point::zeros())),
        };
        // Within the surface, and in the open where nothing is a number any more.
        if !(gauge > 1.0 && gauge.is_finite()) {
            return Foot { point: *p, ray: Point::zeros(), gauge: 1.0, slope };
        }
        let ray = p - centre;
        Foot { point: centre + ray / gauge, ray, gauge, slope }
    }
}

/// Where the ray from a centre to a point outside leaves a surface; a point within is its own.
struct Foot {
    /// There.
    point: Point,
    /// From the centre to the point outside.
    ray: Point,
    /// How many times as far out that is, and its gradient.
    gauge: f64,
    slope: Point,
}

impl Foot {
    /// The gradient at the point outside of what has this one at the foot.
    fn carried(&self, gradient: Point) -> Point {
        (gradient - self.slope * (self.ray.dot(&gradient) / self.gauge)) / self.gauge
    }
}

/// How parts change with one parameter.
#[derive(Clone, Debug, PartialEq)]
struct Mode {
    changes: Vec<Change>,
    /// 1/(parameter's way from less to more in standard deviations).
    scale: f64,
    /// By how many of those the parts have been moved since they were fitted.
    moved: f64,
}

/// How one part changes, as a difference.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Change {
    part: usize,
    more: Part,
    less: Part,
}

impl Mode {
    /// Of one part.
    fn of(part: usize, more: Part, less: Part, scale: f64) -> Mode {
        Mode { changes: vec![Change { part, more, less }], scale, moved: 0.0 }
    }

    fn of_part(&self, part: usize) -> Option<&Change> {
        self.changes.iter().find(|change| change.part == part)
    }
}

/// The intersection of parts as the maximum of their fields, with creases where they meet.
///
/// ```
/// use tactile_host::model::body::Body;
/// use tactile_host::reference::{Contact, Mean};
/// use tactile_host::space::Point;
///
/// // Twenty touches around an ellipse of 120 × 60 mm.
/// let contacts: Vec<Contact> = (0..20)
///     .map(|i| {
///         let (sin, cos) = (0.314 * f64::from(i)).sin_cos();
///         Contact {
///             point: Point::new(0.06 * cos, 0.03 * sin, 0.0),
///             normal: Some(Point::new(cos / 0.06, sin / 0.03, 0.0).normalize()),
///             point_deviation: 1e-3,
///             normal_deviation: 0.05,
///         }
///     })
///     .collect();
/// let body = Body::quadric(2, &contacts).unwrap();
/// assert!((body.value(&Point::new(0.07, 0.0, 0.0)) - 0.01).abs() < 2e-3);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    parts: Vec<Part>,
    modes: Vec<Mode>,
    /// Half the squared distance of its parameters from those most bodies have, in deviations.
    oddity: f64,
    /// χ² of the body alone and its degrees of freedom.
    chi_squared: f64,
    degrees: f64,
}

/// By how much a side's normals differ from the fitted part's for other reasons than noise, radians: sides
/// bulge, and edges are round.
const LEAN: f64 = 0.25;

impl Body {
    /// What it is the intersection of.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Nats by which its parameters are less probable, before any contact, than the most probable
    /// ones.
    pub fn oddity(&self) -> f64 {
        self.oddity
    }

    /// χ² per degree of freedom of the contacts on the body alone: about 1 where it is right and the
    /// contacts say the truth about their noise.
    pub fn misfit(&self) -> f64 {
        self.chi_squared / self.degrees.max(1.0)
    }

    /// Measured numbers less fitted ones, the expectation of χ².
    pub fn degrees(&self) -> f64 {
        self.degrees
    }

    /// The part that decides at `p`, with its value and gradient.
    fn active(&self, p: &Point) -> (usize, Local) {
        let far = (0, (f64::NEG_INFINITY, Point::zeros()));
        let parts = self.parts.iter().map(|part| part.at(p)).enumerate();
        parts.fold(far, |most, part| if part.1.0 > most.1.0 { part } else { most })
    }

    /// The part a contact was felt on: the most probable one by how far before the surface there it lies, and
    /// by its normal. One near an edge may lie some deviations before the side it is of.
    fn touched(&self, contact: &Contact) -> (usize, Local) {
        let active = self.active(&contact.point);
        let Some(normal) = contact.normal else { return active };
        let most = active.1.0;
        let turned = contact.normal_deviation.powi(2) + LEAN.powi(2);
        let cost = |local: &Local| {
            ((most - local.0) / contact.point_deviation).powi(2)
                + (local.1 - normal).norm_squared() / turned
        };
        let parts = self.parts.iter().map(|part| part.at(&contact.point)).enumerate();
        let least = parts.min_by(|a, b| cost(&a.1).total_cmp(&cost(&b.1)));
        least.unwrap_or(active)
    }

    /// What each mode adds at `p`, to first order on the surface. Beyond a round part's surface that
    /// stays as it is there: to first order sizes would go on adding in proportion to the distance,
    /// and a surface that contacts move by a tenth would have another sheet far away.
    fn modes_of(&self, part: usize, p: &Point) -> impl Iterator<Item = Local> {
        let foot = self.parts.get(part).map(|part| part.foot(p));
        self.modes.iter().map(move |mode| {
            let (Some(foot), Some(change)) = (&foot, mode.of_part(part)) else {
                return (0.0, Point::zeros());
            };
            let (more, less) = (change.more.at(&foot.point), change.less.at(&foot.point));
            let slope = foot.carried((more.1 - less.1) * mode.scale);
            ((more.0 - less.0) * mode.scale, slope)
        })
    }
}

impl Mean for Body {
    fn value(&self, p: &Point) -> f64 {
        let (part, local) = self.active(p);
        local.0 - self.displacement(part, p).0
    }

    fn gradient(&self, p: &Point) -> Point {
        let (part, local) = self.active(p);
        local.1 - self.displacement(part, p).1
    }

    fn felt(&self, contact: &Contact) -> Point {
        let (part, local) = self.touched(contact);
        local.1 - self.displacement(part, &contact.point).1
    }

    fn modes(&self, p: &Point) -> Vec<Local> {
        self.modes_of(self.active(p).0, p).collect()
    }

    fn felt_modes(&self, contact: &Contact) -> Vec<Local> {
        let value = self.modes_of(self.active(&contact.point).0, &contact.point);
        let slope = self.modes_of(self.touched(contact).0, &contact.point);
        value.zip(slope).map(|(v, s)| (v.0, s.1)).collect()
    }

    fn check(&self) -> Result<(), Error> {
        if self.parts.is_empty() {
            return Err(Error::Parameter { name: "number of parts of a body", value: 0.0 });
        }
        Ok(())
    }
}

impl From<Body> for Arc<dyn Mean> {
    fn from(body: Body) -> Self {
        Arc::new(body)
    }
}

#[cfg(test)]
pub(crate) mod tests;
