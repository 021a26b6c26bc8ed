//! Contacts tried on a hypothesis: its belief conditioned on what they would measure.

use crate::math::{self, normal};
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

use super::chart::{Chart, across};
use super::hypothesis::Hypothesis;
use super::joint::{Joint, Sparse};
use super::plane::{Plane, Row, Rows, Touch, height, measure, solve, turned};

/// What a plane explains of a contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match<S: Space> {
    /// Log density of the contact.
    pub density: f32,
    /// The tangent at the prior pose where contact and plane agree best.
    pub tangent: S::Tangent,
}

/// The working copy of a belief while contacts are tried on it.
#[derive(Clone, Debug)]
pub(super) struct Work<S: Space, const FACES: usize, const ROWS: usize, const PACKED: usize> {
    pub joint: Joint<ROWS, PACKED>,
    /// Displacement from the prior pose and planes.
    pub mean: [f32; ROWS],
    pub gain: [f32; ROWS],
    pub planes: [Plane<S>; FACES],
    pub faces: usize,
}

impl<S: Chart, const FACES: usize, const ROWS: usize, const PACKED: usize>
    Work<S, FACES, ROWS, PACKED>
{
    /// All zero bits.
    pub const fn new() -> Self {
        Work {
            joint: Joint::new(),
            mean: [0.0; ROWS],
            gain: [0.0; ROWS],
            planes: [Plane::UNSET; FACES],
            faces: 0,
        }
    }

    /// The belief of `prior`, its pose about the tangent `about` and more doubtful by `wider` (variances of
    /// each translation and rotation).
    pub fn begin<const GRASPS: usize>(
        &mut self,
        prior: &Hypothesis<S, FACES, ROWS, PACKED, GRASPS>,
        about: S::Tangent,
        wider: [f32; 2],
    ) {
        self.joint.copy_from(&prior.joint);
        for i in 0..S::FREEDOM {
            self.joint.add_variance(i, wider[usize::from(i >= S::DIMENSION)]);
        }
        self.mean[..self.joint.rows()].fill(0.0);
        for i in 0..S::FREEDOM {
            self.mean[i] = about[i];
        }
        self.planes[..prior.faces].copy_from_slice(&prior.planes[..prior.faces]);
        self.faces = prior.faces;
    }

    /// Mean of the pose's displacement.
    pub fn tangent(&self) -> S::Tangent {
        S::Tangent::from_fn(|i| self.mean[i])
    }

    fn first_row(face: usize) -> usize {
        S::FREEDOM + S::DIMENSION * face
    }

    /// Conditions on a contact on a plane, linearised at the prior pose retracted by `at`; its log
    /// density.
    pub fn observe(
        &mut self,
        touch: &Touch<S>,
        prior: &S::Pose,
        at: S::Tangent,
        face: usize,
    ) -> f32 {
        let pose = prior.retract(at);
        let rows = measure::<S>(touch, &pose, &S::transport(at), &self.planes[face]);
        let mut density = 0.0;
        for row in rows.as_slice() {
            let h = sparse(&row.pose, Self::first_row(face), &row.plane);
            // 0 = residual + pose·(x − at) + plane·f + noise.
            let y = row.pose.dot(at) - row.residual;
            density += self.joint.observe(&mut self.mean, &mut self.gain, h, (y, row.noise));
        }
        density
    }

    /// Opens a face at a directed contact, linearised at the prior pose retracted by `at`; the
    /// face's number, `None` when full.
    pub fn open(&mut self, touch: &Touch<S>, prior: &S::Pose, at: S::Tangent) -> Option<usize> {
        let face = self.faces;
        if face >= FACES || !touch.directed {
            return None;
        }
        let pose = prior.retract(at);
        let transport = S::transport(at);
        let normal = pose.unrotate(touch.normal);
        let point = pose.untransform(touch.point);
        let offset = normal.dot(point);
        let axes = across::<S>(normal);
        let last = S::DIMENSION - 1;
        let moved = self.tangent() - at;
        let zero = S::Vector::ZERO;
        for k in 0..S::DIMENSION {
            // ρ is a distance in the world: only translation changes it.
            let derivative = if k < last {
                turned::<S>(S::lever(normal, axes[k]), &transport, true)
            } else {
                turned::<S>(S::lever(zero, normal), &transport, false)
            };
            let h = sparse(&derivative, 0, &zero);
            self.joint.times(h, &mut self.gain);
            let rows = self.joint.rows();
            let mut own = 0.0;
            for i in 0..S::FREEDOM {
                own += derivative[i] * self.gain[i];
            }
            // The axes before this one share the noise of the normal.
            for earlier in 0..k {
                if k == last {
                    self.gain[Self::first_row(face) + earlier] +=
                        touch.normal_variance * axes[earlier].dot(point);
                }
            }
            if k < last {
                own += touch.normal_variance;
            } else {
                own += touch.point_variance;
                for axis in &axes[..last] {
                    let arm = axis.dot(point);
                    own += touch.normal_variance * arm * arm;
                }
            }
            self.mean[rows] = derivative.dot(moved);
            self.joint.append(&self.gain[..rows], own);
        }
        self.planes[face] = Plane { normal, offset };
        self.faces = face + 1;
        Some(face)
    }

    /// How well a contact fits a plane, given all that was observed so far: one or two Gauss–Newton
    /// steps of the pose.
    pub fn fit(&self, touch: &Touch<S>, prior: &S::Pose, face: usize) -> Option<Match<S>> {
        let first = self.attempt(touch, prior, face, S::Tangent::ZERO)?;
        let step = first.tangent - self.tangent();
        let mut turn = 0.0;
        for i in S::DIMENSION..S::FREEDOM {
            turn += step[i] * step[i];
        }
        if turn > 0.1 * 0.1 { self.attempt(touch, prior, face, step) } else { Some(first) }
    }

    /// One step, linearised at the mean displaced by `step`.
    fn attempt(
        &self,
        touch: &Touch<S>,
        prior: &S::Pose,
        face: usize,
        step: S::Tangent,
    ) -> Option<Match<S>> {
        let mean = self.tangent();
        let at = mean + step;
        let rows = measure::<S>(touch, &prior.retract(at), &S::transport(at), &self.planes[face]);
        let rows: &Rows<S> = &rows;
        let first = Self::first_row(face);
        let count = rows.as_slice().len();
        let (mut s, mut e) = ([[0.0; 3]; 3], [0.0; 3]);
        let mut spread = [S::Tangent::ZERO; 3];
        for (k, row) in rows.as_slice().iter().enumerate() {
            let plane = S::Vector::from_fn(|d| self.mean[first + d]);
            e[k] = row.residual + row.plane.dot(plane) - row.pose.dot(step);
            let mut pose = S::Tangent::ZERO;
            for i in 0..S::FREEDOM {
                let mut sum = 0.0;
                for j in 0..S::FREEDOM {
                    sum += self.joint.at(i, j) * row.pose[j];
                }
                for d in 0..S::DIMENSION {
                    sum += self.joint.at(first + d, i) * row.plane[d];
                }
                pose[i] = sum;
            }
            let mut face_part = S::Vector::ZERO;
            for d in 0..S::DIMENSION {
                let mut sum = 0.0;
                for j in 0..S::FREEDOM {
                    sum += self.joint.at(first + d, j) * row.pose[j];
                }
                for c in 0..S::DIMENSION {
                    sum += self.joint.at(first + d, first + c) * row.plane[c];
                }
                face_part[d] = sum;
            }
            spread[k] = pose;
            for (l, other) in rows.as_slice().iter().enumerate() {
                s[l][k] = other.pose.dot(pose) + other.plane.dot(face_part);
            }
            s[k][k] += row.noise;
        }
        let (x, log_determinant) = solve(&s, &e, count)?;
        let mut tangent = mean;
        let mut squared = 0.0;
        for k in 0..count {
            tangent += spread[k] * -x[k];
            squared += e[k] * x[k];
        }
        let density = -0.5 * (squared + log_determinant + count as f32 * LOG_TAU);
        density.is_finite().then_some(Match { density, tangent })
    }

    /// Height of a point (world frame, with this variance) above a plane, metres, and its variance.
    pub fn height(
        &self,
        point: S::Vector,
        variance: f32,
        prior: &S::Pose,
        face: usize,
    ) -> [f32; 2] {
        let row = self.height_row(point, variance, prior, face);
        let h = sparse(&row.pose, Self::first_row(face), &row.plane);
        [row.residual, row.noise + self.joint.variance(h)]
    }

    /// The height of a point, linearised at the mean; the residual is the mean height.
    fn height_row(&self, point: S::Vector, variance: f32, prior: &S::Pose, face: usize) -> Row<S> {
        let at = self.tangent();
        let touch = Touch { point, point_variance: variance, ..Touch::UNSET };
        let plane = &self.planes[face];
        let mut row = height::<S>(&touch, &prior.retract(at), &S::transport(at), plane);
        let first = Self::first_row(face);
        row.residual += row.plane.dot(S::Vector::from_fn(|d| self.mean[first + d]));
        row
    }

    /// Conditions on a point (world frame, with this variance) being inside a plane, or outside with
    /// `side` −1, which is wrong in a share `doubt` of such statements (at most a half); the log
    /// probability of that, beside that of a point which surely is. The posterior keeps the first two moments' derivatives (assumed density; Minka 2001).
    pub fn bound(
        &mut self,
        (point, variance): (S::Vector, f32),
        prior: &S::Pose,
        face: usize,
        (side, doubt): (f32, f32),
    ) -> f32 {
        let row = self.height_row(point, variance, prior, face);
        let height = side * row.residual;
        let h = sparse(&row.pose, Self::first_row(face), &row.plane);
        let total = row.noise + self.joint.variance(h);
        if !(total > 0.0 && total.is_finite()) || (height < 0.0 && height * height > 9.0 * total) {
            return 0.0;
        }
        self.joint.times(h, &mut self.gain);
        let deviation = math::sqrt(total);
        let (density, inside) = normal(-height / deviation);
        let certain = 1.0 - 2.0 * doubt;
        let chance = doubt + certain * inside;
        if !(chance > 1e-12) {
            return 0.0;
        }
        let slope = -certain * density / (deviation * chance);
        let bend = certain * height * density / (total * deviation * chance) - slope * slope;
        // What a mixture would add of doubt is left out, and no more is taken than there is.
        let bend = math::max(math::min(bend, 0.0), -0.9 / total);
        self.joint.nudge(&mut self.mean, &self.gain, side * slope, bend);
        math::ln(chance / (1.0 - doubt))
    }

    /// Log density of planes `a` and `b` being the same, `None` when they are more than 20° apart.
    pub fn coincidence(&self, a: usize, b: usize) -> Option<f32> {
        let [first, second] = [a, b].map(Self::first_row);
        let displaced = |face: usize, first: usize| {
            self.planes[face].displaced(&self.mean[first..first + S::DIMENSION])
        };
        let [of_a, of_b] = [displaced(a, first), displaced(b, second)];
        let mut rows = between::<S>(&of_a, &of_b)?;
        for (_, by_a, by_b) in rows.iter_mut().take(S::DIMENSION) {
            *by_a = undisplaced::<S>(by_a, &self.planes[a], &of_a);
            *by_b = undisplaced::<S>(by_b, &self.planes[b], &of_b);
        }
        let (mut s, mut e) = ([[0.0; 3]; 3], [0.0; 3]);
        for (k, (apart, of_a, of_b)) in rows.iter().enumerate().take(S::DIMENSION) {
            e[k] = *apart;
            for (l, (_, a_too, b_too)) in rows.iter().enumerate().take(S::DIMENSION) {
                for i in 0..S::DIMENSION {
                    for j in 0..S::DIMENSION {
                        s[k][l] += of_a[i] * a_too[j] * self.joint.at(first + i, first + j)
                            + of_b[i] * b_too[j] * self.joint.at(second + i, second + j)
                            + of_a[i] * b_too[j] * self.joint.at(first + i, second + j)
                            + of_b[i] * a_too[j] * self.joint.at(second + i, first + j);
                    }
                }
            }
            s[k][k] += SAME[usize::from(k + 1 == S::DIMENSION)];
        }
        let (x, log_determinant) = solve(&s, &e, S::DIMENSION)?;
        let squared: f32 = (0..S::DIMENSION).map(|k| e[k] * x[k]).sum();
        let density = -0.5 * (squared + log_determinant + S::DIMENSION as f32 * LOG_TAU);
        density.is_finite().then_some(density)
    }

    /// Conditions on planes `a` and `b` being the same, linearised at the planes themselves: the mean
    /// must be zero.
    pub fn join(&mut self, a: usize, b: usize) {
        let [first, second] = [a, b].map(Self::first_row);
        let Some(rows) = between::<S>(&self.planes[a], &self.planes[b]) else { return };
        for (k, (apart, of_a, of_b)) in rows.iter().enumerate().take(S::DIMENSION) {
            let h = Sparse([(first, of_a.as_slice()), (second, of_b.as_slice())]);
            let noise = SAME[usize::from(k + 1 == S::DIMENSION)];
            self.joint.observe(&mut self.mean, &mut self.gain, h, (-apart, noise));
        }
    }
}

const LOG_TAU: f32 = 1.837_877_1;

/// Variances with which planes are made equal: of normals (radians²) and offsets (square metres).
/// Small beside what contacts tell, large beside rounding.
const SAME: [f32; 2] = [1e-6, 1e-9];

/// How far plane `q` is from `p` along each coordinate of `p`, and the derivatives of that by the
/// coordinates of both.
#[allow(clippy::type_complexity)]
#[inline(never)]
pub(super) fn between<S: Chart>(
    p: &Plane<S>,
    q: &Plane<S>,
) -> Option<[(f32, S::Vector, S::Vector); 3]> {
    if !(p.normal.dot(q.normal) > 0.94) {
        return None;
    }
    let (axes, others) = (across::<S>(p.normal), across::<S>(q.normal));
    let last = S::DIMENSION - 1;
    let mut rows = [(0.0, S::Vector::ZERO, S::Vector::ZERO); 3];
    for (k, (apart, of_p, of_q)) in rows.iter_mut().enumerate().take(S::DIMENSION) {
        of_p[k] = -1.0;
        if k == last {
            *apart = q.offset - p.offset;
            of_q[last] = 1.0;
        } else {
            *apart = axes[k].dot(q.normal);
            for (d, other) in others.iter().enumerate().take(last) {
                of_q[d] = axes[k].dot(*other);
            }
        }
    }
    Some(rows)
}

/// A derivative by the coordinates of a plane after its displacement as one by those before, in which the
/// covariance is.
#[inline(never)]
pub(super) fn undisplaced<S: Chart>(
    by: &S::Vector,
    before: &Plane<S>,
    after: &Plane<S>,
) -> S::Vector {
    let (old, new) = (across::<S>(before.normal), across::<S>(after.normal));
    let last = S::DIMENSION - 1;
    S::Vector::from_fn(|j| {
        if j == last { by[last] } else { (0..last).map(|i| by[i] * new[i].dot(old[j])).sum() }
    })
}

fn sparse<'a, T: Coordinates, V: Coordinates>(pose: &'a T, at: usize, plane: &'a V) -> Sparse<'a> {
    Sparse([(0, pose.as_slice()), (at, plane.as_slice())])
}
