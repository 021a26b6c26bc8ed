//! Planes of a hypothesis, and what a contact on one of them measures.

use crate::contact::Contact;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::{Pose, Space};

use super::chart::{Chart, across};

/// Least deviations of a contact: of its point, metres, and of its normal, radians. Below them the joint
/// covariance loses in rounding what it would gain.
const LEAST: [f32; 2] = [1e-5, 1e-2];

/// The plane n·p = ρ in the object frame. It is displaced by coordinates across n (radians), then ρ
/// (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane<S: Space> {
    /// Unit, out of the object.
    pub normal: S::Vector,
    /// ρ, metres.
    pub offset: f32,
}

impl<S: Space> Plane<S> {
    pub const UNSET: Self = Plane { normal: S::Vector::ZERO, offset: 0.0 };

    /// n·p − ρ, metres.
    pub fn height(&self, point: S::Vector) -> f32 {
        self.normal.dot(point) - self.offset
    }

    /// The plane displaced by `by`, as many numbers as the space has dimensions.
    pub fn displaced(&self, by: &[f32]) -> Self {
        let axes = across::<S>(self.normal);
        let last = S::DIMENSION - 1;
        let mut normal = self.normal;
        for (axis, turn) in axes.iter().zip(&by[..last]) {
            normal += *axis * *turn;
        }
        let normal = normal.normalized().unwrap_or(self.normal);
        Plane { normal, offset: self.offset + by[last] }
    }
}

/// What is remembered of a plane beside its place: which part of it was touched, and whether the
/// object ends there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Record<S: Space> {
    /// Mean of the contacts, metres.
    pub centre: S::Vector,
    /// The two contacts furthest apart.
    pub ends: [S::Vector; 2],
    /// Contacts on the plane.
    pub contacts: u16,
    /// Contacts that lay beyond it: none on a convex object.
    pub beyond: u16,
    /// Contacts that could have.
    pub tested: u16,
    /// Probability that the object reaches beyond it, from both.
    pub reentrant: f32,
}

/// How often contacts lie beyond a plane that bounds the object (they are wild), and beyond one that
/// belongs to a concavity.
pub(super) const BEYOND: [f32; 2] = [0.01, 0.4];

impl<S: Space> Record<S> {
    pub const NONE: Self = Record {
        centre: S::Vector::ZERO,
        ends: [S::Vector::ZERO; 2],
        contacts: 0,
        beyond: 0,
        tested: 0,
        reentrant: 0.0,
    };

    /// Whether the object reaches beyond the plane.
    pub fn is_reentrant(&self) -> bool {
        self.reentrant > 0.5
    }

    /// How likely a contact is to lie beyond the plane, which is reentrant with this probability.
    pub fn doubt(reentrant: f32) -> f32 {
        BEYOND[0] + reentrant * (BEYOND[1] - BEYOND[0])
    }

    /// Learns from the counts whether the plane is reentrant. Concavities come in numbers.
    pub fn judge(&mut self, concave: bool) {
        let beyond = f32::from(self.beyond);
        let inside = f32::from(self.tested) - beyond;
        let mut odds = if concave { -1.0 } else { -3.0 };
        odds += beyond * math::ln(BEYOND[1] / BEYOND[0]);
        odds += inside * math::ln((1.0 - BEYOND[1]) / (1.0 - BEYOND[0]));
        self.reentrant = 1.0 / (1.0 + math::exp(-math::min(math::max(odds, -8.0), 8.0)));
        if self.contacts < 2 {
            // A plane touched once may be no plane at all.
            self.reentrant = math::max(self.reentrant, 0.2);
        }
    }

    #[inline(never)]
    pub fn touch(&mut self, point: S::Vector) {
        if self.contacts == 0 {
            (self.centre, self.ends) = (point, [point; 2]);
        }
        self.contacts = self.contacts.saturating_add(1);
        self.centre += (point - self.centre) * (1.0 / f32::from(self.contacts));
        let [a, b] = self.ends;
        let (ab, ap, bp) =
            ((a - b).norm_squared(), (a - point).norm_squared(), (b - point).norm_squared());
        if ap > ab && ap >= bp {
            self.ends = [a, point];
        } else if bp > ab {
            self.ends = [point, b];
        }
    }

    /// Takes over what another record of the same plane knows.
    pub fn merge(&mut self, other: &Self) {
        let (a, b) = (f32::from(self.contacts), f32::from(other.contacts));
        if a + b > 0.0 {
            self.centre += (other.centre - self.centre) * (b / (a + b));
        }
        let before = self.contacts;
        for end in other.ends {
            let centre = self.centre;
            self.touch(end);
            self.centre = centre;
        }
        self.contacts = before.saturating_add(other.contacts);
        self.beyond = self.beyond.min(other.beyond);
        self.tested = self.tested.max(other.tested);
    }
}

/// A contact as the filter takes it; all zero bits when unset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Touch<S: Space> {
    /// World frame, metres.
    pub point: S::Vector,
    /// World frame, unit; zero where there is none.
    pub normal: S::Vector,
    pub directed: bool,
    /// Square metres.
    pub point_variance: f32,
    /// Radians² per axis.
    pub normal_variance: f32,
}

impl<S: Space> Touch<S> {
    pub const UNSET: Self = Touch {
        point: S::Vector::ZERO,
        normal: S::Vector::ZERO,
        directed: false,
        point_variance: 0.0,
        normal_variance: 0.0,
    };

    /// What a contact tells, which never does without doubt.
    pub fn of(contact: &Contact<S>) -> Self {
        let point_deviation = math::max(contact.point_deviation, LEAST[0]);
        let normal_deviation = math::max(contact.normal_deviation, LEAST[1]);
        Touch {
            point: contact.point,
            normal: contact.normal.unwrap_or(S::Vector::ZERO),
            directed: contact.normal.is_some(),
            point_variance: point_deviation * point_deviation,
            normal_variance: normal_deviation * normal_deviation,
        }
    }
}

/// One number that a contact measures: residual + pose·dx + plane·df, about zero with `noise`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<S: Space> {
    pub residual: f32,
    pub pose: S::Tangent,
    pub plane: S::Vector,
    pub noise: f32,
}

/// A contact's residuals against a plane: the angles of the normal (logarithm on the sphere), where
/// it has one, then the distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows<S: Space> {
    rows: [Row<S>; 3],
    count: usize,
}

impl<S: Space> Rows<S> {
    pub fn as_slice(&self) -> &[Row<S>] {
        &self.rows[..self.count]
    }
}

/// Linearises a contact on a plane at `pose`. Derivatives are by the tangent that `transport` takes
/// to the tangent at `pose`.
///
/// With p and a the contact's point and normal in the object frame, a small displacement of the pose
/// by the tangent (τ, ω) changes n·p by −lever(p, n) and the angle of a about n towards the axis b
/// by −ω·(n × b).
pub(super) fn measure<S: Chart>(
    touch: &Touch<S>,
    pose: &S::Pose,
    transport: &S::Covariance,
    plane: &Plane<S>,
) -> Rows<S> {
    let n = plane.normal;
    let axes = across::<S>(n);
    let last = S::DIMENSION - 1;
    let blank: Row<S> =
        Row { residual: 0.0, pose: S::Tangent::ZERO, plane: S::Vector::ZERO, noise: 0.0 };
    let mut rows = [blank; 3];
    let mut count = 0;
    if touch.directed {
        let a = pose.unrotate(touch.normal);
        let sin = (a - n * n.dot(a)).norm();
        // angle/sine is one for small angles. Opposite normals have no direction to turn in: any will do.
        let stretch = if sin > 1e-3 { S::angle_between(n, a) / sin } else { 1.0 };
        for (k, axis) in axes.iter().enumerate().take(last) {
            let row = &mut rows[count];
            row.residual = axis.dot(a) * stretch;
            row.pose = turned::<S>(S::lever(n, *axis), transport, true);
            row.plane[k] = -1.0;
            row.noise = touch.normal_variance;
            count += 1;
        }
        if sin <= 1e-3 && n.dot(a) < 0.0 {
            rows[0].residual = core::f32::consts::PI;
        }
    }
    rows[count] = height(touch, pose, transport, plane);
    Rows { rows, count: count + 1 }
}

/// The last of these residuals: the distance.
pub(super) fn height<S: Chart>(
    touch: &Touch<S>,
    pose: &S::Pose,
    transport: &S::Covariance,
    plane: &Plane<S>,
) -> Row<S> {
    let n = plane.normal;
    let point = pose.untransform(touch.point);
    let last = S::DIMENSION - 1;
    let mut by_plane = S::Vector::ZERO;
    for (k, axis) in across::<S>(n).iter().enumerate().take(last) {
        by_plane[k] = axis.dot(point);
    }
    by_plane[last] = -1.0;
    Row {
        residual: plane.height(point),
        pose: turned::<S>(S::lever(point, n), transport, false),
        plane: by_plane,
        noise: touch.point_variance,
    }
}

/// −Tᵀ·lever, of its rotation alone where a direction is meant.
pub(super) fn turned<S: Space>(
    lever: S::Tangent,
    transport: &S::Covariance,
    rotation_only: bool,
) -> S::Tangent {
    let from = if rotation_only { S::DIMENSION } else { 0 };
    S::Tangent::from_fn(|j| {
        let mut sum = 0.0;
        for i in from..S::FREEDOM {
            sum -= transport.at(i, j) * lever[i];
        }
        sum
    })
}

/// Solves the positive definite system of at most three rows S·x = e and returns (x, ln det S);
/// `None` when it is not.
pub(super) fn solve(s: &[[f32; 3]; 3], e: &[f32; 3], rows: usize) -> Option<([f32; 3], f32)> {
    let mut l = [[0.0f32; 3]; 3];
    let mut x = [0.0f32; 3];
    let mut log_determinant = 0.0;
    for i in 0..rows {
        for j in 0..=i {
            let mut sum = s[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return None;
                }
                log_determinant += math::ln(sum);
                l[i][i] = math::sqrt(sum);
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    for i in 0..rows {
        let mut sum = e[i];
        for k in 0..i {
            sum -= l[i][k] * x[k];
        }
        x[i] = sum / l[i][i];
    }
    for i in (0..rows).rev() {
        let mut sum = x[i];
        for k in i + 1..rows {
            sum -= l[k][i] * x[k];
        }
        x[i] = sum / l[i][i];
    }
    Some((x, log_determinant))
}
