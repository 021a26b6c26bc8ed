//! Intrinsic contact sensing: where a fingertip is touched, from force and moment alone (Bicchi,
//! Salisbury & Brock, "Contact sensing from force measurements", 1993; thesis 2.3.1).
//!
//! A soft contact at c on the skin S(c) = 0 passes on a force F and a torsion about the normal,
//!
//! ```text
//! M = c × F + k ∇S(c),   S(c) = 0,   F·∇S(c) < 0,
//! ```
//!
//! six equations for six unknowns (c, k and F): every wrench that pushes has one contact that
//! explains it, and there is no residual in the usual sense. What can be tested is whether that
//! contact is possible: its tangential force and its torsion are bounded by friction. Several
//! contacts at once mostly need more torsion than one soft contact can hold.

use super::NoContact;
use super::calibration::Wrench;
use super::fingertip::{Fingertip, Patch, Shape, scaled};
use crate::math;
use crate::matrix::{Coordinates, Matrix, Vector};

/// Force below which there is no direction to speak of, newtons.
const LEAST_FORCE: f32 = 1e-6;

/// Newton steps at most.
const STEPS: usize = 8;

/// The contact that explains a wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Press {
    /// Where, and how the skin lies there.
    pub patch: Patch,
    /// Normal force, newtons: positive.
    pub push: f32,
    /// Tangential force, newtons.
    pub tangential: f32,
    /// Torsion about the skin's outward normal, newton metres.
    pub torsion: f32,
}

/// How noise of the wrench moves a contact, to first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatter {
    /// Variance along the patch's first tangent, covariance of both, variance along the second, m².
    pub point: [f32; 3],
    /// Variance of the torsion where the contact stays, (N m)².
    pub torsion: f32,
}

/// Locates the contact that explains `wrench` (fingertip frame, about its origin).
///
/// In closed form on a sphere, an ellipsoid and a capped cylinder; by at most eight Newton steps
/// from where the force's line of action enters it on a general quadric.
///
/// # Errors
/// [`NoContact::NotFinite`], [`NoContact::TooLight`]; [`NoContact::OutsideSkin`] where the line of
/// action misses the skin, [`NoContact::Pulling`] where only a pull on it explains the wrench,
/// [`NoContact::Inconsistent`] where the steps do not come to rest.
///
/// ```
/// use tactile_core::matrix::{Coordinates, Vector};
/// use tactile_core::sensing::calibration::Wrench;
/// use tactile_core::sensing::fingertip::{Fingertip, Shape};
/// use tactile_core::sensing::intrinsic::locate;
///
/// // Half a newton against the end of y of a ball of 8 mm.
/// let ball = Fingertip { shape: Shape::Sphere { radius: 0.008 }, edge: None };
/// let (point, force) = (Vector([0.0, 0.008, 0.0]), Vector([0.0, -0.5, 0.1]));
/// let press = locate(&ball, &Wrench { force, moment: point.cross(force) }).unwrap();
/// assert!((press.patch.point - point).norm() < 1e-7);
/// assert!((press.push - 0.5).abs() < 1e-6 && press.torsion.abs() < 1e-9);
/// ```
pub fn locate(fingertip: &Fingertip, wrench: &Wrench) -> Result<Press, NoContact> {
    let Wrench { force, moment } = *wrench;
    let size = force.norm();
    if !(size.is_finite() && moment.is_finite()) {
        return Err(NoContact::NotFinite);
    }
    if !(size > LEAST_FORCE) {
        return Err(NoContact::TooLight);
    }
    // Per newton: the contact depends on the ratio only, and lengths are of one magnitude.
    let (f, m) = (force * (1.0 / size), moment * (1.0 / size));
    let point = match fingertip.shape {
        Shape::Sphere { radius } => on_ellipsoid(Vector([radius; 3]), f, m),
        Shape::Ellipsoid { half_axes } => on_ellipsoid(half_axes, f, m),
        Shape::CappedCylinder { radius, .. } => on_finger(radius, f, m),
        Shape::Quadric { .. } => on_quadric(fingertip, f, m),
    }?;
    if !point.is_finite() {
        return Err(NoContact::NotFinite);
    }
    if !fingertip.covers(point) {
        let ends = fingertip.crossings(f.cross(m), f);
        let pulls = ends.and_then(|[_, leave]| leave).is_some_and(|c| fingertip.covers(c));
        return Err(if pulls { NoContact::Pulling } else { NoContact::OutsideSkin });
    }
    let patch = fingertip.patch(point);
    let push = -force.dot(patch.outward);
    let torsion = patch.outward.dot(moment - point.cross(force));
    if !(push.is_finite() && torsion.is_finite()) {
        return Err(NoContact::NotFinite);
    }
    if !(push > 0.0) {
        return Err(NoContact::Pulling);
    }
    let tangential = (force + patch.outward * push).norm();
    Ok(Press { patch, push, tangential, torsion })
}

/// On an ellipsoid about the origin. With A the matrix of inverse half axes, x = Ac has length one
/// and Aᵀ(u × v) = det A · A⁻¹u × A⁻¹v turns the equations into those of the unit ball,
/// A⁻¹M = x × f + κx with f = AF/det A. Taking its length and its product with f gives κ² and
/// (f·x)² as the roots of one quadratic equation; f·x is the negative one, a push.
#[inline]
fn on_ellipsoid(
    half_axes: Vector<3>,
    force: Vector<3>,
    moment: Vector<3>,
) -> Result<Vector<3>, NoContact> {
    let [a, b, c] = half_axes.0;
    // Over the product of the half axes' cube root squared, which keeps lengths near one.
    let size = math::max(math::max(a, b), c);
    let scale = 1.0 / (size * size);
    let f = scaled(Vector([b * c * scale, c * a * scale, a * b * scale]), force);
    let m = scaled(half_axes * scale, moment);
    let (along, squared) = (f.dot(m), f.norm_squared());
    let spare = squared - m.norm_squared();
    let root = math::sqrt(spare * spare + 4.0 * along * along);
    // Whichever of both does not cancel; the other from their product, (f·x)·κ = f·m.
    let (push, torsion) = if spare > 0.0 {
        let push = -math::sqrt(0.5 * (spare + root));
        (push, along / push)
    } else {
        let torsion = math::sqrt(0.5 * (root - spare));
        let torsion = if along > 0.0 { -torsion } else { torsion };
        (along / torsion, torsion)
    };
    // Where neither is left the force only grazes the ellipsoid, without torsion.
    if !(push < 0.0) {
        return Err(NoContact::OutsideSkin);
    }
    let x = m * torsion + f * push + f.cross(m);
    let x = x * (1.0 / (torsion * torsion + squared));
    Ok(scaled(half_axes, x))
}

/// On a cylinder about x that ends in a ball at x = 0. On the side the normal has no x, so that the
/// moment about x alone tells around, and the other two tell along and torsion. Across the seam
/// point and normal go on smoothly: the side's solution has x > 0 exactly when the ball's has.
#[inline]
fn on_finger(radius: f32, f: Vector<3>, m: Vector<3>) -> Result<Vector<3>, NoContact> {
    let across = f[1] * f[1] + f[2] * f[2];
    let inner = radius * radius * across - m[0] * m[0];
    if inner > 0.0 {
        let push = -math::sqrt(inner);
        let scale = 1.0 / across;
        let y = (m[0] * f[2] + push * f[1]) * scale;
        let z = (push * f[2] - m[0] * f[1]) * scale;
        let x = ((m[1] - z * f[0]) * z - (m[2] + y * f[0]) * y) * (-1.0 / push);
        if x <= 0.0 {
            return Ok(Vector([x, y, z]));
        }
    }
    let cap = on_ellipsoid(Vector([radius; 3]), f, m)?;
    if cap[0] >= -1e-3 * radius { Ok(cap) } else { Err(NoContact::OutsideSkin) }
}

/// On any quadric, by Newton's method.
fn on_quadric(fingertip: &Fingertip, f: Vector<3>, m: Vector<3>) -> Result<Vector<3>, NoContact> {
    let Some([Some(enter), _]) = fingertip.crossings(f.cross(m), f) else {
        return Err(NoContact::OutsideSkin);
    };
    let mut c = enter;
    let mut last = f32::INFINITY;
    for _ in 0..STEPS {
        let patch = fingertip.patch(c);
        let n = patch.outward;
        let (rest, height) = (m - c.cross(f), fingertip.height(c));
        let torsion = n.dot(rest);
        // The step along the normal returns to the skin; the rest is explained along the skin.
        let error = rest - n * torsion + n.cross(f) * height;
        let [u, v] = patch.tangents;
        let inverse = response(&patch, f.dot(n), torsion);
        let (eu, ev) = (u.dot(error), v.dot(error));
        let (a, b) =
            (inverse[0][0] * eu + inverse[0][1] * ev, inverse[1][0] * eu + inverse[1][1] * ev);
        let step = u * a + v * b - n * height;
        c += step;
        last = step.norm_squared();
        if !(last > 1e-14) {
            break;
        }
    }
    // NaN counts as not at rest.
    if last < 1e-10 { Ok(c) } else { Err(NoContact::Inconsistent) }
}

/// What the contact point moves by, along both tangents, per unexplained moment along them: the
/// inverse of ∂(c × F + τn)/∂c = τκ + (F·n)J, with κ the curvature and J a quarter turn. Its
/// determinant τ²|κ| + (F·n)² is positive wherever the force pushes.
#[inline]
fn response(patch: &Patch, along_normal: f32, torsion: f32) -> [[f32; 2]; 2] {
    let [uu, uv, vv] = patch.curvature.map(|k| k * torsion);
    let scale = 1.0 / (uu * vv - (uv + along_normal) * (uv - along_normal));
    [[vv * scale, -(uv + along_normal) * scale], [(along_normal - uv) * scale, uu * scale]]
}

impl Press {
    /// How noise of the wrench with covariance `noise` (force first, fingertip frame, about its
    /// origin) moves the contact. The torsion's own variance leaves out that the contact moves,
    /// which adds little unless friction is nearly used up.
    #[inline]
    pub fn scatter(&self, noise: &Matrix<6>) -> Scatter {
        let Patch { point, outward, tangents: [u, v], .. } = self.patch;
        // e·δ(M − c × F) for a direction e: its moment about the origin acts on the force.
        let lever = |e: Vector<3>| {
            let p = point.cross(e);
            [p[0], p[1], p[2], e[0], e[1], e[2]]
        };
        let product = |a: &[f32; 6], b: &[f32; 6]| {
            let mut sum = 0.0;
            for (x, y) in a.iter().zip(b) {
                sum += x * y;
            }
            sum
        };
        let spread = |a: &[f32; 6]| noise.0.map(|row| product(&row, a));
        let (hu, hv, hn) = (lever(u), lever(v), lever(outward));
        let (su, sv) = (spread(&hu), spread(&hv));
        let (uu, uv, vv) = (product(&hu, &su), product(&hu, &sv), product(&hv, &sv));
        let [[a, b], [c, d]] = response(&self.patch, -self.push, self.torsion);
        let point = [
            a * (a * uu + 2.0 * b * uv) + b * b * vv,
            c * (a * uu + b * uv) + d * (a * uv + b * vv),
            c * (c * uu + 2.0 * d * uv) + d * d * vv,
        ];
        Scatter { point, torsion: product(&hn, &spread(&hn)) }
    }
}
