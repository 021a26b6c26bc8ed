//! Superquadrics: an ellipsoid whose roundness varies from box to octahedron, fitted to contacts.
//!
//! The surface of thesis 2.1 is where G(x) = ‖(‖(x/a₁, y/a₂)‖, z/a₃)‖ is one, the inner norm with
//! exponent 2/ε₂ and the outer with 2/ε₁ (Barr 1981). G grows in proportion along every ray from the
//! centre, so (G − 1)/|∇G| is the distance to first order everywhere (Taubin 1991). A
//! superquadric with ε ≤ 2 is convex and symmetric about three planes: it cannot be a triangle or
//! an L, and this file does not pretend that it could.

mod fit;

use nalgebra::{Point3, SMatrix, SVector, Translation3, UnitQuaternion};

use super::{Field, Geometry, Mesh, Outline};
use crate::space::{Point, Pose};

/// Numbers that make a superquadric, as one step changes them: three logarithms of half lengths, two
/// exponents, a turn (three, radians) and a shift (three, metres) in its own frame. In the plane
/// the third half length, ε₁, two turns and one shift stay as they are.
const NUMBERS: usize = 11;

/// Those that move in the plane.
const PLANAR: [usize; 6] = [0, 1, 4, 7, 8, 9];

type Step = SVector<f64, NUMBERS>;
type Covariance = SMatrix<f64, NUMBERS, NUMBERS>;

/// Exponents a fit may find: below, corners are sharper than sensors feel; above, the shape is
/// pinched and no longer convex.
pub const EXPONENTS: (f64, f64) = (0.1, 2.0);

/// Vertices around an outline and a mesh, and stacks from pole to pole: multiples of eight, so that
/// corners and edges have vertices of their own.
const AROUND: usize = 360;
const SLICES: usize = 128;
const STACKS: usize = 64;

/// A superquadric with pose, or in the plane a superellipse.
///
/// ```
/// use tactile_host::reference::Contact;
/// use tactile_host::shape::superquadric::Superquadric;
/// use tactile_host::space::Point;
///
/// // Touches all around a disc of 40 mm radius.
/// let contacts: Vec<Contact> = (0..8)
///     .map(|i| {
///         let (sin, cos) = (0.8 * f64::from(i)).sin_cos();
///         let normal = Point::new(cos, sin, 0.0);
///         let point = 0.04 * normal;
///         Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.09 }
///     })
///     .collect();
/// let disc = Superquadric::fit(2, &contacts)?;
/// assert!((disc.value(&Point::new(0.05, 0.0, 0.0)) - 0.01).abs() < 1e-3);
/// # Ok::<(), tactile_host::shape::superquadric::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Superquadric {
    dimension: usize,
    form: Form,
    /// Of a [`Step`] from what was found.
    covariance: Covariance,
    misfit: Misfit,
}

/// How a superquadric suits contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Sum of the squared deviations of points and normals.
    pub chi_squared: f64,
    /// Numbers observed less those sought.
    pub degrees: f64,
    /// Half the squared distance of sizes and exponents from likely ones, in deviations.
    pub oddity: f64,
}

/// The shape alone: sizes, exponents and pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Form {
    /// a₁, a₂, a₃, metres.
    half: [f64; 3],
    /// ε₁ and ε₂.
    exponents: [f64; 2],
    /// Superquadric's frame to the contacts'.
    pose: Pose,
    planar: bool,
}

/// One of the numbers that make a [`Form`], as a change counts them; axes are its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Logarithm of a half length.
    Half(usize),
    /// ε₁ or ε₂.
    Exponent(usize),
    /// Turn about an axis, radians.
    Turn(usize),
    /// Shift along an axis, metres.
    Shift(usize),
}

/// Why contacts give no superquadric.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Neither planar nor spatial.
    #[error("the dimension must be 2 or 3, not {0}")]
    Dimension(usize),
    /// A number of a contact is unusable.
    #[error("contact {index}: {what}")]
    Contact {
        /// Counted from 0.
        index: usize,
        /// What is wrong and what was expected.
        what: &'static str,
    },
    /// Less is known than is sought.
    #[error(
        "{contacts} contacts make {observed} observations: a superquadric needs at least {} \
         contacts and {sought} observations",
        Superquadric::LEAST_CONTACTS
    )]
    Few {
        /// How many there are.
        contacts: usize,
        /// One for each point, one per axis but one for each normal.
        observed: usize,
        /// Numbers that make the shape.
        sought: usize,
    },
    /// All contacts at one place.
    #[error("the contacts lie within {0:.1e} m of their centre and show no size")]
    NoExtent(f64),
    /// No start led anywhere.
    #[error("no superquadric of finite cost was found for these contacts")]
    NoFit,
}

impl Superquadric {
    /// Fewest contacts that are fitted.
    pub const LEAST_CONTACTS: usize = 5;

    /// Half lengths a₁, a₂, a₃ along the superquadric's axes, metres; in the plane only the first
    /// two mean anything.
    pub fn half(&self) -> [f64; 3] {
        self.form.half
    }

    /// ε₁ (along z) and ε₂ (around z), see thesis 2.1; in the plane only ε₂ means anything.
    pub fn exponents(&self) -> [f64; 2] {
        self.form.exponents
    }

    /// From the superquadric's frame to that of the contacts.
    pub fn pose(&self) -> Pose {
        self.form.pose
    }

    /// Sizes, exponents and pose together.
    pub fn form(&self) -> Form {
        self.form
    }

    /// How it suits the contacts it was fitted to.
    pub fn misfit(&self) -> Misfit {
        self.misfit
    }

    /// The forms a little to both sides of the one found, along each number that makes it, with one
    /// over the way from one to the other in standard deviations of what is believed of that number
    /// before any contact: a factor of e for sizes and exponents, a radian for turns, the object's size
    /// for shifts.
    pub fn neighbours(&self) -> Vec<(Form, Form, f64)> {
        let size = self.form.half.iter().fold(0.0, |size: f64, half| size.max(*half));
        let neighbours = |i: usize| {
            let deviation = match i {
                3 | 4 => self.form.exponents[i - 3],
                0..8 => 1.0,
                _ => size,
            };
            let (more, less) = (self.form.nudged(i, NUDGE), self.form.nudged(i, -NUDGE));
            (more, less, deviation / (2.0 * NUDGE))
        };
        self.form.free().map(neighbours).collect()
    }

    /// Directions along its axes in which contacts hardly say how far it goes: where the deviation of
    /// the surface is more than a tenth of the greatest half length.
    pub fn undecided(&self) -> Vec<Point> {
        let size = self.form.half.iter().fold(0.0, |size: f64, half| size.max(*half));
        let ends = self.form.axes().into_iter().zip(self.form.half);
        let ends = ends.flat_map(|(axis, half)| [(axis, half), (-axis, half)]);
        let open = |(axis, half): &(Point, f64)| {
            let end = self.form.pose.translation.vector + axis * *half;
            self.deviation(&end) > 0.1 * size
        };
        ends.filter(open).map(|(axis, _)| axis).collect()
    }

    /// Distance to the surface to first order, metres, negative inside. Exact on the surface, along
    /// the axes and for spheres.
    pub fn value(&self, p: &Point) -> f64 {
        self.form.distance(p).0
    }

    /// Unit vector along which G grows most: on the surface, where the value does too, the outward normal.
    /// Zero at the centre.
    pub fn gradient(&self, p: &Point) -> Point {
        self.form.distance(p).1
    }

    /// Standard deviation of the surface along its normal near `p`, metres: what the contacts leave
    /// open about sizes, exponents and pose, widened where they fit worse than they should. It
    /// knows nothing of an object that is no superquadric.
    pub fn deviation(&self, p: &Point) -> f64 {
        let slopes = Step::from_fn(|i, _| {
            if self.form.planar && !PLANAR.contains(&i) {
                return 0.0;
            }
            let (ahead, behind) = (self.form.nudged(i, NUDGE), self.form.nudged(i, -NUDGE));
            (ahead.distance(p).0 - behind.distance(p).0) / (2.0 * NUDGE)
        });
        (slopes.transpose() * self.covariance * slopes)[0].max(0.0).sqrt()
    }

    /// The surface itself: an outline or a watertight mesh whose vertices are points of thesis 2.1,
    /// taken in even directions instead of even η and ω, which would crowd into the corners.
    pub fn geometry(&self) -> Geometry {
        let form = &self.form;
        let [a, b, c] = form.half;
        let place = |x: f64, y: f64, z: f64| (form.pose * Point3::new(a * x, b * y, c * z)).coords;
        if form.planar {
            let ring = (0..AROUND).map(|i| {
                let (x, y) = unit(i, AROUND, form.exponents[1]);
                let p = place(x, y, 0.0);
                [p.x, p.y]
            });
            return Geometry::Outline(Outline { loops: vec![ring.collect()] });
        }
        let slices = SLICES as u32;
        let mut vertices = vec![place(0.0, 0.0, -1.0)];
        for stack in 1..STACKS {
            // A quarter turn back, so that stacks run from the lower pole to the upper one.
            let (z, out) = unit(stack, 2 * STACKS, form.exponents[0]);
            for slice in 0..SLICES {
                let (x, y) = unit(slice, SLICES, form.exponents[1]);
                vertices.push(place(out * x, out * y, -z));
            }
        }
        vertices.push(place(0.0, 0.0, 1.0));
        let (pole, last) = (vertices.len() as u32 - 1, 1 + (STACKS as u32 - 2) * slices);
        let mut triangles = Vec::new();
        for i in 0..slices {
            let j = (i + 1) % slices;
            triangles.push([0, 1 + j, 1 + i]);
            for ring in (1..last).step_by(SLICES) {
                let next = ring + slices;
                triangles.push([ring + i, ring + j, next + j]);
                triangles.push([ring + i, next + j, next + i]);
            }
            triangles.push([pole, last + i, last + j]);
        }
        Geometry::Mesh(Mesh::trusted(vertices, triangles))
    }
}

/// The point of |x|^(2/ε) + |y|^(2/ε) = 1 in the direction of the `i`-th of `count` equal turns.
fn unit(i: usize, count: usize, exponent: f64) -> (f64, f64) {
    let (sin, cos) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
    let (norm, _, _) = norm(cos, sin, 2.0 / exponent);
    (cos / norm, sin / norm)
}

/// Small next to every number of a [`Step`]: logarithms, exponents, radians and metres alike.
const NUDGE: f64 = 1e-6;

impl Form {
    /// Moved along one number of a [`Step`].
    fn nudged(&self, number: usize, by: f64) -> Form {
        let mut step = Step::zeros();
        step[number] = by;
        self.moved(&step)
    }

    /// Moved by a whole step; exponents are not held within their bounds.
    fn moved(&self, step: &Step) -> Form {
        let mut form = *self;
        for (half, by) in form.half.iter_mut().zip(step.iter()) {
            *half *= by.exp();
        }
        form.exponents[0] += step[3];
        form.exponents[1] += step[4];
        let turn = UnitQuaternion::from_scaled_axis(Point::new(step[5], step[6], step[7]));
        let shift = Translation3::new(step[8], step[9], step[10]);
        form.pose = self.pose * Pose::from_parts(shift, turn);
        form
    }

    /// Half lengths a₁, a₂, a₃, metres; see [`Superquadric::half`].
    pub fn half(&self) -> [f64; 3] {
        self.half
    }

    /// ε₁ and ε₂; see [`Superquadric::exponents`].
    pub fn exponents(&self) -> [f64; 2] {
        self.exponents
    }

    /// From the superquadric's frame to that of the contacts.
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// The same in another frame: points p become `frame` p.
    pub fn transformed(&self, frame: &Pose) -> Form {
        Form { pose: frame * self.pose, ..*self }
    }

    /// The numbers that make it: 6 in the plane, 11 in space.
    pub fn numbers(&self) -> impl Iterator<Item = Number> + use<> {
        self.free().map(|place| match place {
            0..3 => Number::Half(place),
            3 | 4 => Number::Exponent(place - 3),
            5..8 => Number::Turn(place - 5),
            _ => Number::Shift(place - 8),
        })
    }

    /// Changed by as much as `by` says of each of [`Form::numbers`], in their order, with exponents held
    /// within [`EXPONENTS`].
    pub fn changed(&self, by: &[f64]) -> Form {
        let mut step = Step::zeros();
        for (place, by) in self.free().zip(by) {
            step[place] = *by;
        }
        let mut form = self.moved(&step);
        for exponent in &mut form.exponents {
            *exponent = exponent.clamp(EXPONENTS.0, EXPONENTS.1);
        }
        form.pose.rotation.renormalize();
        form
    }

    /// Places in a [`Step`] that mean something.
    fn free(&self) -> impl Iterator<Item = usize> + use<> {
        let planar = self.planar;
        (0..NUMBERS).filter(move |place| !planar || PLANAR.contains(place))
    }

    /// Its axes, as many as there are dimensions, unit length, in the frame of the contacts.
    pub fn axes(&self) -> Vec<Point> {
        let turn = self.pose.rotation.to_rotation_matrix();
        let count = if self.planar { 2 } else { 3 };
        turn.matrix().column_iter().take(count).map(|a| a.into_owned()).collect()
    }

    /// First-order distance, metres, and the unit direction in which G grows, which is that in which the
    /// distance does on the surface and nearly so beside it; at the centre the least half length and no
    /// direction.
    pub fn distance(&self, p: &Point) -> (f64, Point) {
        let (g, slope) = self.gauge(p);
        let steepness = slope.norm();
        if steepness > 0.0 {
            ((g - 1.0) / steepness, slope / steepness)
        } else {
            let [a, b, c] = self.half;
            let third = if self.planar { f64::INFINITY } else { c };
            (-a.min(b).min(third), Point::zeros())
        }
    }

    /// The centre, metres.
    pub fn centre(&self) -> Point {
        self.pose.translation.vector
    }

    /// G, which is one on the surface and grows in proportion along rays from the centre, and its
    /// gradient, 1/metre.
    pub fn gauge(&self, p: &Point) -> (f64, Point) {
        let local = self.pose.inverse() * Point3::from(*p);
        let [a, b, c] = self.half;
        let (s, by_x, by_y) = norm(local.x / a, local.y / b, 2.0 / self.exponents[1]);
        let (g, slope) = if self.planar {
            (s, Point::new(by_x / a, by_y / b, 0.0))
        } else {
            let (g, by_s, by_z) = norm(s, local.z / c, 2.0 / self.exponents[0]);
            (g, Point::new(by_s * by_x / a, by_s * by_y / b, by_z / c))
        };
        (g, self.pose.rotation * slope)
    }
}

/// The norm (|u|^p + |v|^p)^(1/p) and its derivatives; all zero at zero.
fn norm(u: f64, v: f64, p: f64) -> (f64, f64, f64) {
    let greatest = u.abs().max(v.abs());
    if !(greatest > 0.0) {
        return (0.0, 0.0, 0.0);
    }
    let sum = (u.abs() / greatest).powf(p) + (v.abs() / greatest).powf(p);
    let norm = greatest * sum.powf(1.0 / p);
    let slope = |w: f64| w.signum() * (w.abs() / norm).powf(p - 1.0);
    (norm, slope(u), slope(v))
}

impl Field for Superquadric {
    fn values(&self, points: &[Point]) -> Vec<f64> {
        points.iter().map(|p| self.value(p)).collect()
    }

    fn deviations(&self, points: &[Point]) -> Vec<f64> {
        points.iter().map(|p| self.deviation(p)).collect()
    }
}

#[cfg(test)]
mod tests;
