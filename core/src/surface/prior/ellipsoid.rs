//! The ellipsoid as prior mean: thesis 2.19–2.20.

use super::{Ball, Prior};
use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Pose, Space};

/// m(p) = ((p − μ)ᵀ B (p − μ) − h)/2 with B = h·A (thesis 2.19): zero on an ellipsoid (ellipse),
/// positive outside, slope about one on the surface.
///
/// Two misprints of the thesis are corrected. 2.18 subtracts what the data add: the posterior mean
/// is m(p) + k*ᵀ(K + σ²I)⁻¹(y − m(X)). 2.20 has A = Rᵀ D R; with R the rotation that turns the
/// coordinate axes to the ellipsoid's it is A = R D Rᵀ, the printed form turns it the other way.
///
/// ```
/// use tactile_core::matrix::Vector;
/// use tactile_core::space::{Planar, PlanarPose};
/// use tactile_core::surface::{Ellipsoid, Prior};
///
/// // Half axes of 60 and 30 mm, the long one turned to y.
/// let quarter = PlanarPose::new(Vector([0.0, 0.0]), 1.570_796_4);
/// let ellipse = Ellipsoid::<Planar>::new(Vector([0.0, 0.0]), Vector([0.06, 0.03]), &quarter);
/// let (value, slope) = ellipse.mean(Vector([0.0, 0.06]));
/// assert!(value.abs() < 1e-6 && slope[1] > 0.5 && slope[0].abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid<S: Space> {
    /// μ, metres.
    pub centre: S::Vector,
    /// B = h·A, per metre: symmetric, in its first rows and columns.
    pub curvature: Matrix<3>,
    /// h, metres.
    pub height: f32,
}

/// Most unknowns of a fit: six of B, three of Bμ, one constant.
const UNKNOWNS: usize = 10;

/// Weight of a relative error of the value against an error of the direction: as 1 mm against
/// 0.1 rad on an object of 40 mm.
const VALUE_WEIGHT: f32 = 4.0;

/// How strongly the ball draws: a tenth of one contact.
const RIDGE: f32 = 0.1;

/// Longest half axis over the ball's radius.
const LONGEST: f32 = 4.0;

impl<S: Space> Ellipsoid<S> {
    /// The ellipsoid with these half axes (metres, positive), turned by the rotation of `pose` from
    /// the coordinate axes. h is the harmonic mean of the half axes: the slope at the ends of an
    /// axis a is h/a, and these average to one.
    pub fn new(centre: S::Vector, half_axes: S::Vector, pose: &S::Pose) -> Self {
        let inverse: f32 = half_axes.as_slice().iter().map(|a| 1.0 / a).sum();
        let height = S::DIMENSION as f32 / inverse;
        let mut curvature = Matrix::ZERO;
        for k in 0..S::DIMENSION {
            let axis = pose.rotate(S::Vector::from_fn(|i| if i == k { 1.0 } else { 0.0 }));
            let axis = Vector::from_fn(|i| if i < S::DIMENSION { axis[i] } else { 0.0 });
            curvature.add_outer(height / (half_axes[k] * half_axes[k]), axis, axis);
        }
        Ellipsoid { centre, curvature, height }
    }

    /// The same function as `ball`.
    fn round(ball: Ball<S>) -> Self {
        let mut curvature = Matrix::ZERO;
        for i in 0..S::DIMENSION {
            *curvature.at_mut(i, i) = 1.0 / ball.radius;
        }
        Ellipsoid { centre: ball.centre, curvature, height: ball.radius }
    }

    /// B d.
    #[inline(always)]
    fn turn(&self, d: S::Vector) -> S::Vector {
        S::Vector::from_fn(|i| (0..S::DIMENSION).map(|j| self.curvature.at(i, j) * d[j]).sum())
    }

    /// The ellipsoid that fits the contacts better than `ball` does, if they decide one; see
    /// [`Prior::fitted`] below.
    fn near(
        ball: Ball<S>,
        contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)>,
    ) -> Option<Self> {
        let pairs = S::DIMENSION * (S::DIMENSION + 1) / 2;
        let mut system = Triangle::drawn_to_zero(pairs + S::DIMENSION + 1);
        let (mut mean_slope, mut mean_target, mut felt) = ([0.0; UNKNOWNS], 0.0, 0.0);
        for (point, normal) in contacts {
            let q = (point - ball.centre) * (1.0 / ball.radius);
            // m/R is quadratic: half its slope along q, and what β and δ add.
            let mut value = slope::<S>(q, q).map(|x| 0.5 * VALUE_WEIGHT * x);
            for i in 0..S::DIMENSION {
                value[pairs + i] = -VALUE_WEIGHT * q[i];
            }
            value[pairs + S::DIMENSION] = -0.5 * VALUE_WEIGHT;
            system.observe(value, -0.5 * VALUE_WEIGHT * (q.norm_squared() - 1.0));
            let Some(n) = normal else { continue };
            for across in S::tangents(n).iter().take(S::DIMENSION - 1) {
                system.observe(slope::<S>(q, *across), -across.dot(q));
            }
            for (sum, x) in mean_slope.iter_mut().zip(slope::<S>(q, n)) {
                *sum += x;
            }
            mean_target += 1.0 - n.dot(q);
            felt += 1.0;
        }
        if !(felt > S::DIMENSION as f32) {
            return None;
        }
        let weight = 1.0 / math::sqrt(felt);
        system.observe(mean_slope.map(|x| x * weight), mean_target * weight);
        let x = system.solve();

        // The mean slope that came out; dividing by it makes it one.
        let along: f32 = mean_slope.iter().zip(&x).map(|(a, b)| a * b).sum();
        let scale = felt / (along + felt - mean_target);
        // In the plane, the unused third axis gets a curvature between the two.
        let mut shape = Matrix::<3>::IDENTITY;
        let mut k = 0;
        for i in 0..S::DIMENSION {
            for j in i..S::DIMENSION {
                *shape.at_mut(i, j) += x[k];
                *shape.at_mut(j, i) = shape.at(i, j);
                k += 1;
            }
        }
        if S::DIMENSION == 2 {
            *shape.at_mut(2, 2) = 0.5 * (shape.at(0, 0) + shape.at(1, 1));
        }
        shape.scale(scale);
        let pull =
            Vector::<3>::from_fn(|i| if i < S::DIMENSION { x[pairs + i] * scale } else { 0.0 });
        let constant = (1.0 + x[pairs + S::DIMENSION]) * scale;

        let (bends, axes) = shape.symmetric_eigen();
        let mut middle = Vector::<3>::ZERO;
        for k in 0..3 {
            let axis = Vector::from_fn(|i| axes.at(i, k));
            middle += axis * (axis.dot(pull) / bends[k]);
        }
        let height = constant + middle.dot(pull);
        let least = Ball::<S>::LEAST_RADIUS / ball.radius;
        let good = scale > 0.0
            && height > 0.0
            && height.is_finite()
            && bends[0] * LONGEST * LONGEST > height
            && bends[2] * least * least < height;
        if !good {
            return None;
        }
        if S::DIMENSION == 2 {
            *shape.at_mut(2, 2) = 0.0;
        }
        shape.scale(1.0 / ball.radius);
        let centre = ball.centre + S::Vector::from_fn(|i| middle[i]) * ball.radius;
        Some(Ellipsoid { centre, curvature: shape, height: height * ball.radius })
    }
}

/// Coefficients of v·∇(m/R) at q, less v·q itself, in the unknowns.
fn slope<S: Space>(q: S::Vector, v: S::Vector) -> [f32; UNKNOWNS] {
    let mut row = [0.0; UNKNOWNS];
    let mut k = 0;
    for i in 0..S::DIMENSION {
        for j in i..S::DIMENSION {
            row[k] = if i == j { v[i] * q[i] } else { v[i] * q[j] + v[j] * q[i] };
            k += 1;
        }
    }
    for i in 0..S::DIMENSION {
        row[k + i] = -v[i];
    }
    row
}

/// Least squares as a triangle that takes one row at a time by Givens rotations: twice the digits of
/// normal equations.
struct Triangle {
    rows: [[f32; UNKNOWNS]; UNKNOWNS],
    right: [f32; UNKNOWNS],
    unknowns: usize,
}

impl Triangle {
    /// No rows but the ridge: √RIDGE · x = 0.
    fn drawn_to_zero(unknowns: usize) -> Self {
        // The pairs off the diagonal of a symmetric matrix count twice.
        let twice: &[usize] = if unknowns == UNKNOWNS { &[1, 2, 4] } else { &[1] };
        let mut rows = [[0.0; UNKNOWNS]; UNKNOWNS];
        for (k, row) in rows.iter_mut().enumerate() {
            row[k] = math::sqrt(if twice.contains(&k) { 2.0 * RIDGE } else { RIDGE });
        }
        Triangle { rows, right: [0.0; UNKNOWNS], unknowns }
    }

    /// Adds the equation `row`·x = `right`.
    fn observe(&mut self, mut row: [f32; UNKNOWNS], mut right: f32) {
        for k in 0..self.unknowns {
            let own = &mut self.rows[k];
            let length = math::sqrt(own[k] * own[k] + row[k] * row[k]);
            let (cos, sin) = (own[k] / length, row[k] / length);
            for j in k..self.unknowns {
                (own[j], row[j]) = (cos * own[j] + sin * row[j], cos * row[j] - sin * own[j]);
            }
            (self.right[k], right) =
                (cos * self.right[k] + sin * right, cos * right - sin * self.right[k]);
        }
    }

    /// The least-squares solution; zeros beyond the unknowns.
    fn solve(&self) -> [f32; UNKNOWNS] {
        let mut x = [0.0; UNKNOWNS];
        for k in (0..self.unknowns).rev() {
            let rest: f32 = (k + 1..self.unknowns).map(|j| self.rows[k][j] * x[j]).sum();
            x[k] = (self.right[k] - rest) / self.rows[k][k];
        }
        x
    }
}

impl<S: Space> Prior<S> for Ellipsoid<S> {
    const UNSET: Self = Ellipsoid { centre: S::Vector::ZERO, curvature: Matrix::ZERO, height: 0.0 };

    fn curvature(&self, _point: S::Vector) -> [S::Vector; 3] {
        let mut rows = [S::Vector::ZERO; 3];
        for (i, row) in rows[..S::DIMENSION].iter_mut().enumerate() {
            *row = S::Vector::from_fn(|j| self.curvature.at(i, j));
        }
        rows
    }

    /// Of a quadratic whose curvature is at most the Frobenius norm of B; its gradient is linear.
    fn interpolation(&self, spread: f32) -> (f32, f32) {
        let mut squares = 0.0;
        for i in 0..S::DIMENSION {
            for j in 0..S::DIMENSION {
                squares += self.curvature.at(i, j) * self.curvature.at(i, j);
            }
        }
        (0.5 * math::sqrt(squares) * spread * spread, 0.0)
    }

    #[inline(always)]
    fn mean(&self, point: S::Vector) -> (f32, S::Vector) {
        let d = point - self.centre;
        let slope = self.turn(d);
        (0.5 * (d.dot(slope) - self.height), slope)
    }

    /// m is linear in B, Bμ and its constant. About the [`Ball`] (c, R) fitted to the same contacts,
    /// with q = (p − c)/R, the model is m/R = qᵀMq/2 − β·q − δ/2; M = I, β = 0, δ = 1 is the ball
    /// itself. Least squares over M, β, δ (ten unknowns, six in the plane) asks that m vanish at the
    /// contacts, that its gradient have no part across their normals (its length varies over an
    /// ellipsoid and is left free), and that the mean slope along the normals be one; a ridge of a
    /// tenth of one contact draws to the ball what they leave open. Afterwards h is set so that the
    /// mean slope along the normals is one exactly.
    ///
    /// Where the contacts do not decide an ellipsoid it is the ball: with no more contacts with
    /// normals than the space has dimensions, with a saddle, or with half axes outside
    /// [[`Ball::LEAST_RADIUS`], 4 R]. About 300 multiplications (1200 in space) and ten square roots
    /// per row and contact, half a kilobyte of stack.
    fn fitted(
        &self,
        contacts: impl Iterator<Item = (S::Vector, Option<S::Vector>)> + Clone,
    ) -> Self {
        let ball = Ball::UNSET.fitted(contacts.clone());
        Self::near(ball, contacts).unwrap_or_else(|| Self::round(ball))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::space::{Planar, Spatial, SpatialPose};
    use proptest::prelude::*;
    use std::vec::Vec;

    type Felt = (Vector<3>, Option<Vector<3>>);

    /// Contacts spread over an ellipsoid, moved by `pose`.
    fn touched(count: usize, half: [f32; 3], pose: &SpatialPose) -> Vec<Felt> {
        (0..count)
            .map(|i| {
                let height = (2 * i + 1) as f32 / count as f32 - 1.0;
                let (sin, cos) = (2.399_963 * i as f32 + 0.3).sin_cos();
                let ring = math::sqrt(1.0 - height * height);
                let unit = [ring * cos, ring * sin, height];
                let normal = Vector::<3>::from_fn(|k| unit[k] / half[k]).normalized();
                let point = Vector::from_fn(|k| unit[k] * half[k]);
                (pose.transform(point), normal.map(|n| pose.rotate(n)))
            })
            .collect()
    }

    fn fitted(contacts: &[Felt]) -> Ellipsoid<Spatial> {
        Ellipsoid::UNSET.fitted(contacts.iter().copied())
    }

    fn ball(contacts: &[Felt]) -> Ellipsoid<Spatial> {
        Ellipsoid::round(Ball::UNSET.fitted(contacts.iter().copied()))
    }

    proptest! {
        #[test]
        fn finds_the_ellipsoid(
            half in proptest::array::uniform3(0.03f32..0.06),
            t in proptest::array::uniform6(-0.8f32..0.8),
        ) {
            let t = Vector(t.map(|x| 0.1 * x) ) ;
            let pose = SpatialPose::IDENTITY.retract(Vector([t[0], t[1], t[2], 10.0 * t[3], 10.0 * t[4], 10.0 * t[5]]));
            let contacts = touched(24, half, &pose);
            let ours = fitted(&contacts);
            prop_assert!((ours.centre - pose.translation).norm() < 5e-4);
            let mut mean = 0.0;
            for (p, n) in &contacts {
                let (value, slope) = ours.mean(*p);
                prop_assert!(value.abs() < 1e-3 * slope.norm());
                prop_assert!(slope.dot(n.unwrap()) > 0.999 * slope.norm());
                mean += slope.dot(n.unwrap()) / 24.0;
            }
            prop_assert!((mean - 1.0).abs() < 1e-4);
            // The same function as the one made from the axes, up to its scale.
            let exact = Ellipsoid::<Spatial>::new(pose.translation, Vector(half), &pose);
            for (p, _) in &contacts {
                let q = pose.translation + (*p - pose.translation) * 1.3;
                prop_assert!((ours.mean(q).0 / exact.mean(q).0 - 1.0).abs() < 0.15);
            }
        }

        #[test]
        fn value_has_the_gradient(p in proptest::array::uniform3(-0.1f32..0.1)) {
            let pose = SpatialPose::IDENTITY.retract(Vector([0.0, 0.0, 0.0, 0.4, -0.9, 1.3]));
            let e = Ellipsoid::<Spatial>::new(Vector([0.01, 0.0, -0.02]), Vector([0.06, 0.03, 0.05]), &pose);
            let slope = e.mean(Vector(p)).1;
            for k in 0..3 {
                let step = Vector::<3>::from_fn(|i| if i == k { 1e-2 } else { 0.0 });
                // Central differences of a quadratic are exact.
                let along = (e.mean(Vector(p) + step).0 - e.mean(Vector(p) - step).0) / 2e-2;
                prop_assert!((along - slope[k]).abs() < 1e-4);
            }
        }

        #[test]
        fn never_far_from_the_contacts(count in 0usize..12, seed in any::<u64>()) {
            // Anything at all: random points and normals, at any scale.
            let mut random = Random::new(seed);
            for scale in [5e-4f32, 0.05, 5.0] {
                let contacts: Vec<Felt> = (0..count)
                    .map(|_| (random.normal::<Vector<3>>() * scale, random.normal::<Vector<3>>().normalized()))
                    .collect();
                let e = fitted(&contacts);
                prop_assert!(e.centre.is_finite() && e.height > 0.0 && e.curvature.is_finite());
                let (value, slope) = e.mean(Vector([scale, 0.0, -scale]));
                prop_assert!(value.is_finite() && slope.is_finite());
            }
        }
    }

    #[test]
    fn undecided_is_the_ball() {
        let some = touched(12, [0.06, 0.03, 0.04], &SpatialPose::IDENTITY);
        assert_eq!(fitted(&some[..3]), ball(&some[..3]));
        assert_eq!(fitted(&[]), ball(&[]));
        let same = [some[0]; 8];
        assert_eq!(fitted(&same), ball(&same));
        let bare: Vec<Felt> = some.iter().map(|c| (c.0, None)).collect();
        assert_eq!(fitted(&bare), ball(&bare));
        let bowl: Vec<Felt> = some.iter().map(|c| (c.0, c.1.map(|n| -n))).collect();
        assert_eq!(fitted(&bowl), ball(&bowl));
        let face: Vec<Felt> = some
            .iter()
            .map(|c| (Vector([c.0[0], c.0[1], 0.0]), Some(Vector([0.0, 0.0, 1.0]))))
            .collect();
        assert_eq!(fitted(&face), ball(&face));
        let spoilt =
            [some[0], (Vector([f32::NAN, 0.0, 0.0]), some[1].1), some[2], some[3], some[4]];
        assert!(fitted(&spoilt).height > 0.0);
    }

    #[test]
    fn an_ellipse_in_the_plane() {
        let contacts: Vec<(Vector<2>, Option<Vector<2>>)> = (0..10)
            .map(|i| {
                let (sin, cos) = (0.628 * i as f32).sin_cos();
                (Vector([0.06 * cos, 0.03 * sin]), Vector([cos / 0.06, sin / 0.03]).normalized())
            })
            .collect();
        let e = Ellipsoid::<Planar>::UNSET.fitted(contacts.iter().copied());
        for (p, _) in &contacts {
            let (value, slope) = e.mean(*p);
            assert!(value.abs() < 5e-4 * slope.norm(), "{value}");
        }
        // The ball misses the ends by far.
        let ball = Ball::<Planar>::UNSET.fitted(contacts.iter().copied());
        assert!(ball.mean(contacts[0].0).0.abs() > 0.01);
        assert_eq!(e.curvature.at(2, 2), 0.0);
    }
}
