//! The ellipsoid as prior mean (thesis 2.19–2.20), and the one that fits contacts best.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion};

use super::{Contact, Prior};
use crate::space::Point;

/// m(p) = ((p − μ)ᵀ B (p − μ) − h)/2 with B = h·A: thesis 2.19. f > 0 outside, and h sets the scale
/// so that f is near a signed distance: the slope is about one on the surface.
///
/// Thesis 2.20 prints A = Rᵀ D R for "the rotation induced by θ". With R the rotation that turns the
/// ellipsoid from the coordinate axes to where it lies, it is A = R D Rᵀ; the printed form turns it
/// the other way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    /// μ, metres.
    pub centre: Point,
    /// B = h·A, per metre: symmetric; zero along an axis without end (z, for an ellipse).
    pub curvature: Matrix3<f64>,
    /// h, metres.
    pub height: f64,
}

impl Ellipsoid {
    /// Weight of a relative error of the value against an error of the direction: as 1 mm against
    /// 0.1 rad on an object of 40 mm.
    const VALUE_WEIGHT: f64 = 4.0;

    /// How strongly it is drawn towards the ball: a tenth of one contact.
    const RIDGE: f64 = 0.1;

    /// Longest half axis over the ball's radius.
    const LONGEST: f64 = 4.0;

    /// The ellipsoid with these half axes (metres), turned by `rotation` from the coordinate axes.
    /// An ellipse in the plane has z = ∞. h is the harmonic mean of the finite half axes: the slope
    /// at the ends of an axis a is h/a, and these average to one.
    pub fn new(centre: Point, half_axes: Point, rotation: &UnitQuaternion<f64>) -> Self {
        let finite: Vec<f64> = half_axes.iter().copied().filter(|a| a.is_finite()).collect();
        let height = finite.len() as f64 / finite.iter().map(|a| 1.0 / a).sum::<f64>();
        let diagonal = half_axes.map(|a| height / (a * a));
        let turn = rotation.to_rotation_matrix().into_inner();
        let curvature = turn * Matrix3::from_diagonal(&diagonal) * turn.transpose();
        Ellipsoid { centre, curvature, height }
    }

    /// The ellipsoid that fits contacts best, or `None` where they do not decide one.
    ///
    /// m is linear in B, Bμ and its constant. About the ball (c, R) of [`Prior::fitted`], with
    /// q = (p − c)/R, the model is m/R = qᵀMq/2 − β·q − δ/2 with M = I, β = 0, δ = 1 for the ball
    /// itself. Least squares over M, β, δ asks that m vanish at the contacts, that its gradient have
    /// no part across their normals (its length varies over an ellipsoid and is left free), and
    /// that the mean slope along the normals be one; a ridge draws what they leave open to the
    /// ball. Afterwards the slope is made one exactly.
    ///
    /// Contacts that are one place, fewer than `dimension` + 1 with normals, a saddle, or half axes outside
    /// [min([`Prior::LEAST_RADIUS`], R/2), 4 R] give none.
    pub fn fitted(dimension: usize, contacts: &[Contact]) -> Option<Self> {
        let Some(Prior::Ball { centre, radius }) = Prior::fitted(contacts) else { return None };
        let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
        if !(2..=3).contains(&dimension) || felt <= dimension || Prior::are_one(contacts) {
            return None;
        }
        // Unknowns: E = M − I (its pairs i ≤ j), β, δ − 1.
        let pairs: Vec<(usize, usize)> =
            (0..dimension).flat_map(|i| (i..dimension).map(move |j| (i, j))).collect();
        let unknowns = pairs.len() + dimension + 1;
        // Coefficients of (∇m)·v at q, less v·q itself.
        let slope = |q: &Point, v: &Point| {
            let products = pairs
                .iter()
                .map(|&(i, j)| if i == j { v[i] * q[i] } else { v[i] * q[j] + v[j] * q[i] });
            let row = products.chain((0..dimension).map(|i| -v[i])).chain([0.0]);
            DVector::from_iterator(unknowns, row)
        };
        let mut rows: Vec<(DVector<f64>, f64)> = Vec::new();
        let (mut mean_slope, mut mean_target) = (DVector::zeros(unknowns), 1.0);
        for contact in contacts {
            let q = (contact.point - centre) / radius;
            // m/R is quadratic: half its slope along q, and what β and δ add.
            let mut value = slope(&q, &q) * 0.5;
            for i in 0..dimension {
                value[pairs.len() + i] = -q[i];
            }
            value[unknowns - 1] = -0.5;
            let error = 0.5 * (q.norm_squared() - 1.0);
            rows.push((value * Self::VALUE_WEIGHT, -error * Self::VALUE_WEIGHT));
            let Some(n) = contact.normal else { continue };
            for axis in 0..dimension {
                let mut unit = Point::zeros();
                unit[axis] = 1.0;
                let across = unit - n * n[axis];
                rows.push((slope(&q, &across), -across.dot(&q)));
            }
            mean_slope += slope(&q, &n) / felt as f64;
            mean_target -= n.dot(&q) / felt as f64;
        }
        let weight = (felt as f64).sqrt();
        rows.push((&mean_slope * weight, mean_target * weight));
        for k in 0..unknowns {
            // An entry off the diagonal stands for two.
            let twice = pairs.get(k).is_some_and(|(i, j)| i != j);
            let mut row = DVector::zeros(unknowns);
            row[k] = (Self::RIDGE * if twice { 2.0 } else { 1.0 }).sqrt();
            rows.push((row, 0.0));
        }
        let matrix = DMatrix::from_fn(rows.len(), unknowns, |i, j| rows[i].0[j]);
        let right = DVector::from_iterator(rows.len(), rows.iter().map(|r| r.1));
        let decomposition = matrix.qr();
        let projected = decomposition.q().transpose() * right;
        let solution = decomposition.r().solve_upper_triangular(&projected)?;

        // The mean slope that came out; dividing by it makes it one.
        let scale = 1.0 / (mean_slope.dot(&solution) + 1.0 - mean_target);
        let mut shape = Matrix3::zeros();
        for (k, &(i, j)) in pairs.iter().enumerate() {
            let own = if i == j { 1.0 } else { 0.0 };
            (shape[(i, j)], shape[(j, i)]) = (own + solution[k], own + solution[k]);
        }
        shape *= scale;
        let pull =
            Point::from_fn(
                |i, _| {
                    if i < dimension { solution[pairs.len() + i] * scale } else { 0.0 }
                },
            );
        let constant = (1.0 + solution[unknowns - 1]) * scale;

        let square = shape.view((0, 0), (dimension, dimension)).clone_owned();
        let mut middle = Point::zeros();
        middle
            .rows_mut(0, dimension)
            .copy_from(&square.clone().lu().solve(&pull.rows(0, dimension).clone_owned())?);
        let height = constant + middle.dot(&pull);
        if !(height.is_finite() && square.iter().all(|b| b.is_finite())) {
            return None;
        }
        let bends = square.symmetric_eigenvalues();
        let (flattest, sharpest) = (bends.min(), bends.max());
        let least = (Prior::least_radius(radius) / radius).powi(2);
        let good = scale > 0.0
            && height > 0.0
            && flattest * Self::LONGEST.powi(2) > height
            && sharpest * least < height;
        good.then(|| Ellipsoid {
            centre: centre + middle * radius,
            curvature: shape / radius,
            height: height * radius,
        })
    }

    /// Half axes in ascending order, metres; infinite where it has no end.
    pub fn half_axes(&self) -> [f64; 3] {
        let mut axes: [f64; 3] = self
            .curvature
            .symmetric_eigenvalues()
            .map(|bend| if bend > 0.0 { (self.height / bend).sqrt() } else { f64::INFINITY })
            .into();
        axes.sort_by(f64::total_cmp);
        axes
    }

    /// Value at `p`, metres.
    pub fn value(&self, p: &Point) -> f64 {
        0.5 * ((p - self.centre).dot(&self.gradient(p)) - self.height)
    }

    /// Gradient at `p`.
    pub fn gradient(&self, p: &Point) -> Point {
        self.curvature * (p - self.centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    /// Contacts spread over an ellipse or ellipsoid, without noise.
    fn touched(
        dimension: usize,
        count: usize,
        half: Point,
        pose: &crate::space::Pose,
    ) -> Vec<Contact> {
        (0..count)
            .map(|i| {
                let height =
                    if dimension == 3 { (2 * i + 1) as f64 / count as f64 - 1.0 } else { 0.0 };
                let (sin, cos) = (2.399_963 * i as f64 + 0.3).sin_cos();
                let ring = (1.0 - height * height).sqrt();
                let unit = Point::new(ring * cos, ring * sin, height);
                let mut normal = unit.component_div(&half);
                if dimension == 2 {
                    normal.z = 0.0;
                }
                Contact {
                    point: unit.component_mul(&half),
                    normal: Some(normal.normalize()),
                    point_deviation: 1e-3,
                    normal_deviation: 0.0873,
                }
                .transformed(pose)
            })
            .collect()
    }

    #[test]
    fn by_hand() {
        // A quarter turn about z: the long axis, 60 mm, lies along y.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let half = Point::new(0.06, 0.03, 0.04);
        let e = Ellipsoid::new(Point::new(0.01, 0.0, 0.0), half, &turn);
        assert!((e.height - 3.0 / (1.0 / 0.06 + 1.0 / 0.03 + 1.0 / 0.04)).abs() < 1e-15);
        for (p, slope) in [
            (Point::new(0.01, 0.06, 0.0), Point::y() * e.height / 0.06),
            (Point::new(0.04, 0.0, 0.0), Point::x() * e.height / 0.03),
            (Point::new(0.01, 0.0, -0.04), -Point::z() * e.height / 0.04),
        ] {
            assert!(e.value(&p).abs() < 1e-15);
            assert!((e.gradient(&p) - slope).norm() < 1e-12);
        }
        assert!((e.value(&e.centre) + 0.5 * e.height).abs() < 1e-15);
        assert!((e.half_axes()[2] - 0.06).abs() < 1e-12);
    }

    #[test]
    fn a_ball_is_a_ball() {
        let half = Point::repeat(0.05);
        let ball = touched(3, 12, half, &crate::space::Pose::identity());
        let e = Ellipsoid::fitted(3, &ball).unwrap();
        for axis in e.half_axes() {
            assert!((axis - 0.05).abs() < 1e-9);
        }
        assert!((e.height - 0.05).abs() < 1e-9 && e.centre.norm() < 1e-9);
    }

    #[test]
    fn too_little_gives_none() {
        let half = Point::new(0.06, 0.03, 0.04);
        let some = touched(3, 12, half, &crate::space::Pose::identity());
        assert_eq!(Ellipsoid::fitted(3, &[]), None);
        assert_eq!(Ellipsoid::fitted(3, &some[..3]), None);
        assert_eq!(Ellipsoid::fitted(3, &[some[0]; 8]), None);
        assert_eq!(Ellipsoid::fitted(4, &some), None);
        // One face, and the inside of a bowl.
        let face: Vec<Contact> = (0..8)
            .map(|i| Contact {
                point: some[i].point.component_mul(&Point::new(1.0, 1.0, 0.0)),
                normal: Some(Point::z()),
                ..some[i]
            })
            .collect();
        assert_eq!(Ellipsoid::fitted(3, &face), None);
        let bowl: Vec<Contact> =
            some.iter().map(|c| Contact { normal: c.normal.map(|n| -n), ..*c }).collect();
        assert_eq!(Ellipsoid::fitted(3, &bowl), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn finds_the_ellipsoid(
            axes in proptest::array::uniform3(0.03..0.06f64),
            turn in proptest::array::uniform3(-2.0..2.0f64),
            shift in proptest::array::uniform3(-0.1..0.1f64),
            planar in any::<bool>(),
        ) {
            let (dimension, mut half) = if planar { (2, Point::from(axes)) } else { (3, Point::from(axes)) };
            let (mut turn, mut shift) = (Vector3::from(turn), Point::from(shift));
            if planar {
                half.z = 1.0;
                turn = Vector3::new(0.0, 0.0, turn.z);
                shift.z = 0.0;
            }
            let turn = UnitQuaternion::from_scaled_axis(turn);
            let pose = crate::space::Pose::from_parts(shift.into(), turn);
            let contacts = touched(dimension, 24, half, &pose);
            let e = Ellipsoid::fitted(dimension, &contacts).unwrap();
            // The ridge pulls a little.
            prop_assert!((e.centre - shift).norm() < 5e-4, "{}", e.centre - shift);
            for c in &contacts {
                let slope = e.gradient(&c.point);
                prop_assert!(e.value(&c.point).abs() < 1e-3 * slope.norm());
                prop_assert!(slope.normalize().dot(&c.normal.unwrap()) > 0.999);
            }
            let mean = contacts.iter().map(|c| e.gradient(&c.point).dot(&c.normal.unwrap())).sum::<f64>();
            prop_assert!((mean / 24.0 - 1.0).abs() < 1e-9);
            let exact = Ellipsoid::new(shift, half, &turn);
            let same = e.half_axes().into_iter().zip(exact.half_axes());
            for (ours, truth) in same.take(dimension) {
                prop_assert!((ours / truth - 1.0).abs() < 0.03, "{ours} {truth}");
            }
        }

        #[test]
        fn value_has_the_gradient(p in proptest::array::uniform3(-0.1..0.1f64), turn in -3.0..3.0f64) {
            let turn = UnitQuaternion::from_euler_angles(turn, 0.3, -turn);
            let e = Ellipsoid::new(Point::new(0.01, 0.02, -0.03), Point::new(0.05, 0.03, 0.08), &turn);
            let p = Point::from(p);
            for axis in 0..3 {
                let mut step = Point::zeros();
                step[axis] = 1e-5;
                let slope = (e.value(&(p + step)) - e.value(&(p - step))) / 2e-5;
                prop_assert!((e.gradient(&p)[axis] - slope).abs() < 1e-8);
            }
        }
    }
}
