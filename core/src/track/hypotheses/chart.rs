//! Coordinates for small displacements of poses and of plane normals.

use crate::math;
use crate::matrix::{Coordinates, Matrix, Square, Vector};
use crate::space::{Planar, Space, Spatial};

/// What the joint filter needs of a space beside its poses.
pub trait Chart: Space {
    /// The derivative of `retract` at `by`: takes a small change of the tangent at a pose to the
    /// tangent at the pose retracted by `by` (ℝⁿ × SO(n): the rotation back, and the right Jacobian
    /// of the rotation).
    fn transport(by: Self::Tangent) -> Self::Covariance;

    /// The `index`-th of `count` unit vectors spread evenly over all directions.
    fn direction(index: usize, count: usize) -> Self::Vector;

    /// The measure of all directions: 2π or 4π.
    const DIRECTIONS: f32;

    /// Rotations, as tangents, from one of which any other is near: [`TURNS`](Self::TURNS) of them.
    fn turn(index: usize) -> Self::Tangent;

    /// How many.
    const TURNS: usize;

    /// The shortest turn, as a tangent, that takes one unit vector to another.
    fn turn_to(from: Self::Vector, to: Self::Vector) -> Self::Tangent;

    /// The turn about the unit vector `axis` that takes `from` the nearest to `to`.
    fn spin(axis: Self::Vector, from: Self::Vector, to: Self::Vector) -> Self::Tangent;
}

impl Chart for Planar {
    const DIRECTIONS: f32 = core::f32::consts::TAU;

    fn transport(by: Vector<3>) -> Matrix<3> {
        let (sin, cos) = math::sin_cos(by[2]);
        Matrix([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    }

    fn direction(index: usize, count: usize) -> Vector<2> {
        let (sin, cos) = math::sin_cos(Self::DIRECTIONS * index as f32 / count as f32);
        Vector([cos, sin])
    }

    const TURNS: usize = 8;

    fn turn(index: usize) -> Vector<3> {
        let eighths = if index > 4 { index as f32 - 8.0 } else { index as f32 };
        Vector([0.0, 0.0, core::f32::consts::FRAC_PI_4 * eighths])
    }

    fn turn_to(from: Vector<2>, to: Vector<2>) -> Vector<3> {
        Vector([0.0, 0.0, math::atan2(from[0] * to[1] - from[1] * to[0], from.dot(to))])
    }

    fn spin(_: Vector<2>, from: Vector<2>, to: Vector<2>) -> Vector<3> {
        Self::turn_to(from, to)
    }
}

impl Chart for Spatial {
    const DIRECTIONS: f32 = 2.0 * core::f32::consts::TAU;

    fn transport(by: Vector<6>) -> Matrix<6> {
        let w = [by[3], by[4], by[5]];
        let squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
        let angle = math::sqrt(squared);
        let (sin, cos) = math::sin_cos(angle);
        // sin θ/θ, (1 − cos θ)/θ² and (θ − sin θ)/θ³, by their series where those lose digits.
        let (a, b, c) = if angle > 0.05 {
            let inverse = 1.0 / squared;
            (sin / angle, (1.0 - cos) * inverse, (angle - sin) * inverse / angle)
        } else {
            (1.0 - squared / 6.0, 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0)
        };
        let cross = [[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]];
        let mut out = Matrix::ZERO;
        for i in 0..3 {
            for j in 0..3 {
                let one = if i == j { 1.0 } else { 0.0 };
                let square = w[i] * w[j] - one * squared;
                out.0[i][j] = one - a * cross[i][j] + b * square;
                out.0[i + 3][j + 3] = one - b * cross[i][j] + c * square;
            }
        }
        out
    }

    fn direction(index: usize, count: usize) -> Vector<3> {
        // A spiral whose turns are a golden angle apart (Fibonacci lattice).
        let z = (2.0 * index as f32 + 1.0) / count as f32 - 1.0;
        let r = math::sqrt(math::max(1.0 - z * z, 0.0));
        let (sin, cos) = math::sin_cos(2.399_963_1 * index as f32);
        Vector([r * cos, r * sin, z])
    }

    const TURNS: usize = 24;

    /// The rotations that take a cube to itself.
    fn turn(index: usize) -> Vector<6> {
        const QUARTER: f32 = core::f32::consts::FRAC_PI_2;
        // Sums of the axis' components choose the angle: faces 90°, edges 180°, corners 120°.
        let axis = |x: f32, y: f32, z: f32, angle: f32| {
            let scale = angle / math::sqrt(x * x + y * y + z * z);
            Vector([0.0, 0.0, 0.0, x * scale, y * scale, z * scale])
        };
        let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        match index {
            1 => axis(1.0, 0.0, 0.0, 2.0 * QUARTER),
            2 => axis(0.0, 1.0, 0.0, 2.0 * QUARTER),
            3 => axis(0.0, 0.0, 1.0, 2.0 * QUARTER),
            4 | 5 => axis(sign, 0.0, 0.0, QUARTER),
            6 | 7 => axis(0.0, sign, 0.0, QUARTER),
            8 | 9 => axis(0.0, 0.0, sign, QUARTER),
            10 | 11 => axis(1.0, sign, 0.0, 2.0 * QUARTER),
            12 | 13 => axis(1.0, 0.0, sign, 2.0 * QUARTER),
            14 | 15 => axis(0.0, 1.0, sign, 2.0 * QUARTER),
            16..=23 => {
                let other = if (index / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
                let third = if index < 20 { 1.0 } else { -1.0 };
                axis(sign, other, third, 4.0 / 3.0 * QUARTER)
            }
            _ => Vector::ZERO,
        }
    }

    fn turn_to(from: Vector<3>, to: Vector<3>) -> Vector<6> {
        let axis = from.cross(to).normalized().unwrap_or(from.tangents()[0]);
        Self::spin(axis, from, to)
    }

    #[inline(never)]
    fn spin(axis: Vector<3>, from: Vector<3>, to: Vector<3>) -> Vector<6> {
        let along = axis.dot(from) * axis.dot(to);
        let angle = math::atan2(axis.dot(from.cross(to)), from.dot(to) - along);
        Vector([0.0, 0.0, 0.0, axis[0] * angle, axis[1] * angle, axis[2] * angle])
    }
}

/// Unit vectors across the unit vector `n`, as many as it has coordinates less one (the rest are
/// zero): the columns of the Householder reflection that takes the first axis to ∓n.
pub(super) fn across<S: Space>(n: S::Vector) -> [S::Vector; 2] {
    let mut v = n;
    v[0] += if n[0] < 0.0 { -1.0 } else { 1.0 };
    let scale = 1.0 / (1.0 + n[0].abs());
    let mut axes = [S::Vector::ZERO; 2];
    for k in 1..S::DIMENSION {
        axes[k - 1] = v * (-n[k] * scale);
        axes[k - 1][k] += 1.0;
    }
    axes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::{PlanarPose, Pose, SpatialPose};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn axes_across_are_orthonormal(v in proptest::array::uniform3(-1.0f32..1.0)) {
            if let Some(n) = Vector(v).normalized() {
                let [a, b] = across::<Spatial>(n);
                for (x, y, want) in [(a, a, 1.0), (b, b, 1.0), (a, b, 0.0), (a, n, 0.0), (b, n, 0.0)] {
                    prop_assert!((x.dot(y) - want).abs() < 1e-5);
                }
            }
            if let Some(n) = Vector([v[0], v[1]]).normalized() {
                let [a, none] = across::<Planar>(n);
                prop_assert!(a.dot(n).abs() < 1e-6 && (a.norm() - 1.0).abs() < 1e-6);
                prop_assert_eq!(none, Vector::ZERO);
            }
        }

        #[test]
        fn transport_is_the_derivative_of_retract(
            by in proptest::array::uniform6(-1.2f32..1.2),
            small in proptest::array::uniform6(-1.0f32..1.0),
        ) {
            let (by, small) = (Vector(by), Vector(small) * 2e-3);
            let at = SpatialPose::IDENTITY.retract(by);
            let moved = at.local(&SpatialPose::IDENTITY.retract(by + small));
            let t = Spatial::transport(by);
            let want = Vector::<6>::from_fn(|i| (0..6).map(|j| t.0[i][j] * small[j]).sum());
            prop_assert!((moved - want).norm() < 2e-5, "{moved:?} {want:?}");

            let (by, small) = (Vector([by[0], by[1], by[2]]), Vector([small[0], small[1], small[2]]));
            let at = PlanarPose::IDENTITY.retract(by);
            let moved = at.local(&PlanarPose::IDENTITY.retract(by + small));
            let t = Planar::transport(by);
            let want = Vector::<3>::from_fn(|i| (0..3).map(|j| t.0[i][j] * small[j]).sum());
            prop_assert!((moved - want).norm() < 2e-5, "{moved:?} {want:?}");
        }
    }

    proptest! {
        #[test]
        fn turns_take_one_vector_to_another(v in proptest::array::uniform6(-1.0f32..1.0)) {
            let unit = |i: usize| Vector([v[i], v[i + 1], v[i + 2]]).normalized();
            if let (Some(from), Some(to)) = (unit(0), unit(3)) {
                let turned = SpatialPose::IDENTITY.retract(Spatial::turn_to(from, to));
                prop_assert!((turned.rotate(from) - to).norm() < 1e-3, "{from:?} {to:?}");
                let back = SpatialPose::IDENTITY.retract(Spatial::turn_to(from, -from));
                prop_assert!((back.rotate(from) + from).norm() < 1e-3, "{from:?}");
                // About an axis, as near as that gets.
                let axis = Vector([0.0, 0.6, 0.8]);
                let spun = SpatialPose::IDENTITY.retract(Spatial::spin(axis, from, to));
                prop_assert!((spun.rotate(axis) - axis).norm() < 1e-4);
                let [a, b] = [spun.rotate(from), to].map(|v| v - axis * axis.dot(v));
                prop_assert!((a.dot(b) - a.norm() * b.norm()).abs() < 1e-4, "{from:?} {to:?}");
            }
            let unit = |i: usize| Vector([v[i], v[i + 1]]).normalized();
            if let (Some(from), Some(to)) = (unit(0), unit(2)) {
                let turned = PlanarPose::IDENTITY.retract(Planar::turn_to(from, to));
                prop_assert!((turned.rotate(from) - to).norm() < 1e-4, "{from:?} {to:?}");
            }
        }
    }

    #[test]
    fn directions_are_even() {
        let mut sum = Vector::<3>::ZERO;
        let mut square = Vector::<3>::ZERO;
        for i in 0..48 {
            let d = Spatial::direction(i, 48);
            assert!((d.norm() - 1.0).abs() < 1e-5);
            sum += d;
            square += Vector::from_fn(|k| d[k] * d[k]);
        }
        assert!(sum.norm() < 1.0, "{sum:?}");
        assert!((square * (1.0 / 16.0) - Vector([1.0; 3])).norm() < 0.05, "{square:?}");
        assert!((Planar::direction(6, 24) - Vector([0.0, 1.0])).norm() < 1e-6);
    }
}
