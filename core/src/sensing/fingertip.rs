//! The skin of a fingertip: where it is, which way it faces, how strongly it curves.

use super::CalibrationError;
use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};

/// A convex surface in the fingertip frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A ball about the origin.
    Sphere {
        /// Its radius.
        radius: f32,
    },
    /// An ellipsoid about the origin, its axes those of the frame.
    Ellipsoid {
        /// Half axes along x, y, z.
        half_axes: Vector<3>,
    },
    /// A finger: a cylinder about x from −`length` to 0, closed by half a ball about the origin.
    CappedCylinder {
        /// Of cylinder and ball.
        radius: f32,
        /// Of the cylinder, without the cap.
        length: f32,
    },
    /// All c with S(c) = cᵀQc + 2b·c − d = 0: an ellipsoid anywhere, an elliptic cylinder or an
    /// elliptic paraboloid.
    Quadric {
        /// Q, symmetric and positive semidefinite.
        matrix: Matrix<3>,
        /// b.
        linear: Vector<3>,
        /// d.
        constant: f32,
    },
}

/// The plane a skin ends at: it covers the points c with `normal`·c ≥ `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Unit vector towards the skin.
    pub normal: Vector<3>,
    /// Metres from the origin.
    pub offset: f32,
}

/// A skin: a convex shape, or as much of it as lies on one side of an edge.
///
/// ```
/// use tactile_core::matrix::{Coordinates, Vector};
/// use tactile_core::sensing::fingertip::{Fingertip, Shape};
///
/// let finger = Fingertip { shape: Shape::CappedCylinder { radius: 0.007, length: 0.02 }, edge: None };
/// let patch = finger.project(Vector([-0.01, 0.003, 0.0])).unwrap();
/// assert!((patch.point - Vector([-0.01, 0.007, 0.0])).norm() < 1e-8);
/// assert!((patch.outward - Vector([0.0, 1.0, 0.0])).norm() < 1e-6);
/// assert!(finger.covers(patch.point));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingertip {
    /// Where the skin is.
    pub shape: Shape,
    /// Where it ends, if it does.
    pub edge: Option<Edge>,
}

/// A point of a skin and its neighbourhood to second order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// On the skin, metres.
    pub point: Vector<3>,
    /// Unit normal out of the fingertip.
    pub outward: Vector<3>,
    /// Two unit tangents; with `outward` a right-handed frame.
    pub tangents: [Vector<3>; 2],
    /// Curvature per metre along the first tangent, between both, along the second: how the normal
    /// turns as the point moves. Not negative definite, as the skin is convex.
    pub curvature: [f32; 3],
}

impl Patch {
    /// Of no skin.
    pub(super) const UNSET: Self = Patch {
        point: Vector([0.0; 3]),
        outward: Vector([0.0; 3]),
        tangents: [Vector([0.0; 3]); 2],
        curvature: [0.0; 3],
    };

    /// The patch at a point, where half the gradient of S is one over `steepness` long and half its
    /// second derivative is `bend`.
    #[inline]
    fn new(point: Vector<3>, outward: Vector<3>, steepness: f32, bend: &Bend) -> Self {
        let [u, v] = outward.tangents();
        let (along, across) = (bend.times(u), bend.times(v));
        let curvature = [u.dot(along), v.dot(along), v.dot(across)].map(|k| k * steepness);
        Patch { point, outward, tangents: [u, v], curvature }
    }
}

/// Newton steps of a projection at most; four suffice for a fingertip.
const STEPS: usize = 12;

impl Fingertip {
    /// The fingertip, if its numbers describe a convex skin.
    ///
    /// # Errors
    /// Numbers that are not finite, lengths that are not positive, an edge whose normal is not a
    /// unit vector within 10⁻³, a quadric that is not convex or has no surface.
    pub fn checked(mut self) -> Result<Self, CalibrationError> {
        let positive = |lengths: &[f32]| {
            if lengths.iter().any(|l| !l.is_finite()) {
                Err(CalibrationError::NotFinite)
            } else if lengths.iter().all(|l| *l > 0.0) {
                Ok(())
            } else {
                Err(CalibrationError::NotPositive)
            }
        };
        match &mut self.shape {
            Shape::Sphere { radius } => positive(&[*radius])?,
            Shape::Ellipsoid { half_axes } => positive(&half_axes.0)?,
            Shape::CappedCylinder { radius, length } => positive(&[*radius, *length])?,
            Shape::Quadric { matrix, linear, constant } => {
                *matrix = checked_quadric(matrix, *linear, *constant)?;
            }
        }
        if let Some(edge) = &mut self.edge {
            if !(edge.normal.is_finite() && edge.offset.is_finite()) {
                return Err(CalibrationError::NotFinite);
            }
            let length = edge.normal.norm();
            if !((length - 1.0).abs() < 1e-3) {
                return Err(CalibrationError::Range);
            }
            edge.normal = edge.normal * (1.0 / length);
        }
        Ok(self)
    }

    /// Whether a point of the shape is on the skin: within its edge, and not behind the finger.
    #[inline]
    pub fn covers(&self, point: Vector<3>) -> bool {
        let behind = match self.shape {
            Shape::CappedCylinder { length, .. } => point[0] < -length,
            _ => false,
        };
        let within = match self.edge {
            Some(edge) => edge.normal.dot(point) >= edge.offset,
            None => true,
        };
        within && !behind
    }

    /// The patch at a point that lies on the shape. A point that lies far from it, or is not
    /// finite, gives numbers that mean nothing.
    #[inline]
    pub fn patch(&self, point: Vector<3>) -> Patch {
        let (gradient, bend) = self.slope(point);
        let steepness = 1.0 / gradient.norm();
        Patch::new(point, gradient * steepness, steepness, &bend)
    }

    /// Half the gradient of S, and half its second derivative.
    #[inline]
    pub(super) fn slope(&self, c: Vector<3>) -> (Vector<3>, Bend) {
        match self.shape {
            Shape::Sphere { .. } => (c, Bend::Axes(Vector([1.0; 3]))),
            Shape::Ellipsoid { half_axes } => {
                let b = Vector(half_axes.0.map(|a| 1.0 / (a * a)));
                (scaled(b, c), Bend::Axes(b))
            }
            Shape::CappedCylinder { .. } => {
                let cap = if c[0] > 0.0 { 1.0 } else { 0.0 };
                let b = Vector([cap, 1.0, 1.0]);
                (scaled(b, c), Bend::Axes(b))
            }
            Shape::Quadric { matrix, linear, .. } => {
                (times(&matrix, c) + linear, Bend::General(matrix))
            }
        }
    }

    /// S at a point, where its half gradient is known.
    #[inline]
    fn value(&self, c: Vector<3>, half_gradient: Vector<3>) -> f32 {
        match self.shape {
            Shape::Sphere { radius } | Shape::CappedCylinder { radius, .. } => {
                half_gradient.norm_squared() - radius * radius
            }
            Shape::Ellipsoid { .. } => c.dot(half_gradient) - 1.0,
            Shape::Quadric { linear, constant, .. } => c.dot(half_gradient + linear) - constant,
        }
    }

    /// How far outside the shape a point is, to first order, metres; negative inside.
    #[inline]
    pub(super) fn height(&self, c: Vector<3>) -> f32 {
        let half_gradient = self.slope(c).0;
        0.5 * self.value(c, half_gradient) / half_gradient.norm()
    }

    /// The patch of the shape nearest to a point; `None` for a point that is not finite, and for
    /// one from which no single point is nearest, as a ball's centre.
    #[inline(always)]
    pub fn project(&self, point: Vector<3>) -> Option<Patch> {
        // Round, but along a cylinder's axis.
        let (radius, on_side) = match self.shape {
            Shape::Sphere { radius } => (radius, false),
            Shape::CappedCylinder { radius, .. } => (radius, point[0] <= 0.0),
            _ => return self.project_on_quadric(point),
        };
        let (nearest, outward) = self.foot(point)?;
        let straight = on_side as u8 as f32;
        let [u, v] = outward.tangents();
        let (bent, along, across) = (1.0 / radius, straight * u[0], straight * v[0]);
        let curvature = [1.0 - along * u[0], -along * v[0], 1.0 - across * v[0]].map(|k| k * bent);
        Some(Patch { point: nearest, outward, tangents: [u, v], curvature })
    }

    #[inline(never)]
    fn project_on_quadric(&self, point: Vector<3>) -> Option<Patch> {
        let (nearest, outward) = self.foot_on_quadric(point)?;
        let (gradient, bend) = self.slope(nearest);
        Some(Patch::new(nearest, outward, 1.0 / gradient.norm(), &bend))
    }

    /// Point and outward normal of the shape nearest to a point; `None` as for [`Self::project`].
    #[inline(always)]
    pub(super) fn foot(&self, point: Vector<3>) -> Option<(Vector<3>, Vector<3>)> {
        let (centre, radius) = match self.shape {
            Shape::Sphere { radius } => (Vector::ZERO, radius),
            Shape::CappedCylinder { radius, .. } => {
                (Vector([math::min(point[0], 0.0), 0.0, 0.0]), radius)
            }
            _ => return self.foot_on_quadric(point),
        };
        // Of a point that is not finite there is no direction.
        let outward = (point - centre).normalized()?;
        Some((centre + outward * radius, outward))
    }

    #[inline(never)]
    fn foot_on_quadric(&self, point: Vector<3>) -> Option<(Vector<3>, Vector<3>)> {
        let nearest = self.nearest(point)?;
        Some((nearest, self.slope(nearest).0.normalized()?))
    }

    /// Nearest point of a quadric: c + λ·∇S(c)/2 = p and S(c) = 0, by Newton's method on both. Each
    /// step replaces the shape by its tangent plane and curvature at the current point.
    #[inline(never)]
    fn nearest(&self, point: Vector<3>) -> Option<Vector<3>> {
        let mut c = point;
        for _ in 0..STEPS {
            let patch = self.patch(c);
            let to = point - c;
            let (height, away) = (self.height(c), patch.outward.dot(to));
            // Along the skin: (1 + away·κ) moves the foot by one.
            let [uu, uv, vv] = patch.curvature.map(|k| k * math::max(away, 0.0));
            let (du, dv) = (patch.tangents[0].dot(to), patch.tangents[1].dot(to));
            let scale = 1.0 / ((1.0 + uu) * (1.0 + vv) - uv * uv);
            let (a, b) = (scale * ((1.0 + vv) * du - uv * dv), scale * ((1.0 + uu) * dv - uv * du));
            let step = patch.outward * -height + patch.tangents[0] * a + patch.tangents[1] * b;
            c += step;
            if !c.is_finite() {
                return None;
            }
            if step.norm_squared() < 1e-14 {
                break;
            }
        }
        Some(c)
    }

    /// Where a straight line enters the shape and where it leaves, each if it does: the points that
    /// a push, and a pull, along `direction` may act at. `None` when it misses.
    pub(super) fn crossings(
        &self,
        on: Vector<3>,
        direction: Vector<3>,
    ) -> Option<[Option<Vector<3>>; 2]> {
        let at = |t: f32| on + direction * t;
        let Shape::CappedCylinder { radius, .. } = self.shape else {
            let (gradient, bend) = self.slope(on);
            let square = direction.dot(bend.times(direction));
            let [enter, leave] = roots(square, direction.dot(gradient), self.value(on, gradient))?;
            return Some([enter.map(at), leave.map(at)]);
        };
        // Cylinder where x ≤ 0, ball where x ≥ 0: the line may meet each twice, and the whole once on
        // its way in and once on its way out.
        let square = direction.norm_squared();
        let linear = direction.dot(on);
        let value = on.norm_squared() - radius * radius;
        let ball = roots(square, linear, value).unwrap_or([None; 2]);
        let (dx, x) = (direction[0], on[0]);
        let side = roots(square - dx * dx, linear - dx * x, value - x * x).unwrap_or([None; 2]);
        let pick = |k: usize| {
            let on_side = side[k].map(at).filter(|c| c[0] <= 0.0);
            on_side.or_else(|| ball[k].map(at).filter(|c| c[0] >= 0.0))
        };
        let ends = [pick(0), pick(1)];
        (ends != [None; 2]).then_some(ends)
    }
}

/// Where square·t² + 2·linear·t + value falls and rises through zero; `None` if it never does.
fn roots(square: f32, linear: f32, value: f32) -> Option<[Option<f32>; 2]> {
    let discriminant = linear * linear - square * value;
    if !(discriminant > 0.0) {
        return None;
    }
    let root = math::sqrt(discriminant);
    // The half that adds numbers of one sign first, the other from the product of both.
    let (falling, rising) = if linear > 0.0 {
        let far = -linear - root;
        (far / square, value / far)
    } else {
        let far = root - linear;
        (value / far, far / square)
    };
    let real = |t: f32| t.is_finite().then_some(t);
    Some([real(falling), real(rising)])
}

/// Half the second derivative of a shape.
#[derive(Clone, Copy, Debug)]
pub(super) enum Bend {
    Axes(Vector<3>),
    General(Matrix<3>),
}

impl Bend {
    #[inline]
    pub(super) fn times(&self, v: Vector<3>) -> Vector<3> {
        match self {
            Bend::Axes(b) => scaled(*b, v),
            Bend::General(matrix) => times(matrix, v),
        }
    }
}

#[inline(always)]
pub(super) fn scaled(b: Vector<3>, v: Vector<3>) -> Vector<3> {
    Vector([b[0] * v[0], b[1] * v[1], b[2] * v[2]])
}

#[inline(always)]
pub(super) fn times(m: &Matrix<3>, v: Vector<3>) -> Vector<3> {
    Vector(m.0.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]))
}

/// The matrix of a convex quadric that has a surface, symmetric.
fn checked_quadric(
    matrix: &Matrix<3>,
    linear: Vector<3>,
    constant: f32,
) -> Result<Matrix<3>, CalibrationError> {
    if !(matrix.is_finite() && linear.is_finite() && constant.is_finite()) {
        return Err(CalibrationError::NotFinite);
    }
    let mut symmetric = Matrix::ZERO;
    for i in 0..3 {
        for j in 0..3 {
            *symmetric.at_mut(i, j) = 0.5 * (matrix.at(i, j) + matrix.at(j, i));
        }
    }
    let (values, vectors) = symmetric.symmetric_eigen();
    let largest = values[2];
    // Curved in two directions at least: a slab is no fingertip.
    if !(values[0] >= -1e-5 * largest && values[1] > 1e-4 * largest && largest > 0.0) {
        return Err(CalibrationError::NotConvex);
    }
    // S at the centre of its curved directions must be negative where nothing else opens it.
    let (mut inside, mut open) = (constant, false);
    for k in 0..3 {
        let b = Vector::<3>::from_fn(|i| vectors.at(i, k)).dot(linear);
        if values[k] > 1e-5 * largest {
            inside += b * b / values[k];
        } else {
            open |= b != 0.0;
        }
    }
    if open || inside > 0.0 { Ok(symmetric) } else { Err(CalibrationError::NotConvex) }
}
