//! The packed arithmetic against textbook formulas in double precision.

use super::chart::{Chart, across};
use super::hypothesis::Hypothesis;
use super::joint::{Joint, Sparse, log_normal};
use super::plane::{Plane, Touch, measure, solve};
use super::work::{Work, between, undisplaced};
use crate::math::normal;
use crate::matrix::{Coordinates, Square, Vector};
use crate::space::{Planar, Pose, Space, Spatial};
use proptest::prelude::*;
use std::vec::Vec;

const N: usize = 9;
type Small = Joint<N, 45>;

fn positive(seed: &[f32]) -> Vec<Vec<f64>> {
    let a =
        |i: usize, j: usize| f64::from(seed[(i * N + j) % seed.len()]) * (1.0 + 0.1 * (i as f64));
    let entry = |i: usize, j: usize| {
        (0..N).map(|k| a(i, k) * a(j, k)).sum::<f64>() + if i == j { 0.2 } else { 0.0 }
    };
    (0..N).map(|i| (0..N).map(|j| entry(i, j)).collect()).collect()
}

fn joint_of(p: &[Vec<f64>]) -> Small {
    let mut joint = Small::new();
    for i in 0..N {
        let row: Vec<f32> = (0..i).map(|j| p[i][j] as f32).collect();
        joint.append(&row, p[i][i] as f32);
    }
    joint
}

/// Gauss–Jordan with pivots: the inverse and the determinant.
fn invert(mut a: Vec<Vec<f64>>) -> (Vec<Vec<f64>>, f64) {
    let n = a.len();
    let mut inverse: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    let mut determinant = 1.0;
    for k in 0..n {
        let pivot = (k..n).max_by(|x, y| a[*x][k].abs().total_cmp(&a[*y][k].abs())).unwrap();
        if pivot != k {
            a.swap(pivot, k);
            inverse.swap(pivot, k);
            determinant = -determinant;
        }
        let d = a[k][k];
        determinant *= d;
        for j in 0..n {
            a[k][j] /= d;
            inverse[k][j] /= d;
        }
        for i in (0..n).filter(|i| *i != k) {
            let f = a[i][k];
            for j in 0..n {
                a[i][j] -= f * a[k][j];
                inverse[i][j] -= f * inverse[k][j];
            }
        }
    }
    (inverse, determinant)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Told all of the last variables, what is left of the others is their Schur complement, also where
    /// one of those told is another's double.
    #[test]
    fn telling_leaves_the_schur_complement(seed in proptest::collection::vec(-1.0f32..1.0, 81)) {
        let mut p = positive(&seed);
        let inner: Vec<Vec<f64>> = (3..N).map(|i| p[i][3..N].to_vec()).collect();
        let (inverse, _) = invert(inner);
        let left = |i: usize, j: usize| {
            let mut sum = p[i][j];
            for a in 3..N { for b in 3..N { sum -= p[i][a] * inverse[a - 3][b - 3] * p[b][j]; } }
            sum
        };
        let want: Vec<f64> = (0..9).map(|k| left(k / 3, k % 3)).collect();
        // The last one again, in place of the first of the three that are left.
        let last = p[N - 1].clone();
        let mut gain = [0.0f32; N];
        for doubled in [false, true] {
            if doubled {
                for i in 0..N { p[3][i] = last[i]; p[i][3] = last[i]; }
                p[3][3] = last[N - 1];
            }
            let before = joint_of(&p);
            let mut joint = joint_of(&p);
            for row in 3..N {
                joint.tell(row, before.at(row, row), &mut gain);
            }
            for k in 0..9 {
                let (i, j) = (k / 3, k % 3);
                let found = f64::from(joint.at(i, j));
                prop_assert!(found.is_finite());
                if !doubled {
                    prop_assert!((found - want[k]).abs() < 2e-3 * (1.0 + want[k].abs()), "{found} {}", want[k]);
                } else if i == j {
                    // Less was told, so no less is left.
                    prop_assert!(found > want[k] - 1e-2 * (1.0 + want[k].abs()));
                }
            }
        }
    }

    /// Three measurements one at a time are the batch update x + K(y − Hx), (I − KH)P and the density
    /// N(y; Hx, HPHᵀ + R).
    #[test]
    fn observing_is_the_kalman_update(
        seed in proptest::collection::vec(-1.0f32..1.0, 81),
        h in proptest::collection::vec(-1.0f32..1.0, 15),
        y in proptest::array::uniform3(-2.0f32..2.0),
    ) {
        let p = positive(&seed);
        let mut joint = joint_of(&p);
        let (mut mean, mut gain) = ([0.0f32; N], [0.0f32; N]);
        for (i, m) in mean.iter_mut().enumerate() {
            *m = 0.1 * i as f32;
        }
        let before: Vec<f64> = mean.iter().map(|m| f64::from(*m)).collect();
        let mut dense = Vec::new();
        let mut density = 0.0;
        for k in 0..3 {
            let (pose, plane) = (&h[5 * k..5 * k + 3], &h[5 * k + 3..5 * k + 5]);
            let at = 3 + 2 * k;
            let row = Sparse([(0, pose), (at, plane)]);
            density += joint.observe(&mut mean, &mut gain, row, (y[k], 0.3));
            let mut full = [0.0f64; N];
            for i in 0..3 { full[i] = f64::from(pose[i]); }
            for i in 0..2 { full[at + i] = f64::from(plane[i]); }
            dense.push(full);
        }
        let ph: Vec<Vec<f64>> = dense
            .iter()
            .map(|h| (0..N).map(|i| (0..N).map(|j| p[i][j] * h[j]).sum()).collect())
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let s: Vec<Vec<f64>> = (0..3)
            .map(|a| (0..3).map(|b| dot(&dense[a], &ph[b]) + if a == b { f64::from(0.3f32) } else { 0.0 }).collect())
            .collect();
        let (inverse, determinant) = invert(s);
        let e: Vec<f64> = (0..3).map(|k| f64::from(y[k]) - dot(&dense[k], &before)).collect();
        let mut squared = 0.0;
        for a in 0..3 { for b in 0..3 { squared += e[a] * inverse[a][b] * e[b]; } }
        let want = -0.5 * (squared + determinant.ln() + 3.0 * core::f64::consts::TAU.ln());
        prop_assert!((f64::from(density) - want).abs() < 1e-3 * (1.0 + want.abs()), "{density} {want}");
        for i in 0..N {
            let mut m = before[i];
            for a in 0..3 { for b in 0..3 { m += ph[a][i] * inverse[a][b] * e[b]; } }
            prop_assert!((f64::from(mean[i]) - m).abs() < 2e-3, "{} {m}", mean[i]);
            for j in 0..N {
                let mut c = p[i][j];
                for a in 0..3 { for b in 0..3 { c -= ph[a][i] * inverse[a][b] * ph[b][j]; } }
                prop_assert!((f64::from(joint.at(i, j)) - c).abs() < 2e-3, "{} {c}", joint.at(i, j));
            }
        }
    }

    #[test]
    fn a_block_is_transformed_with_its_covariances(
        seed in proptest::collection::vec(-1.0f32..1.0, 81),
        t in proptest::collection::vec(-1.0f32..1.0, 9),
        first in 0usize..7,
    ) {
        let p = positive(&seed);
        let mut joint = joint_of(&p);
        joint.transform(first, 3, |i, j| t[3 * i + j]);
        let full = |i: usize, j: usize| -> f64 {
            let inside = |k: usize| (first..first + 3).contains(&k);
            match (inside(i), inside(j)) {
                (true, true) => f64::from(t[3 * (i - first) + j - first]),
                _ => f64::from(u8::from(i == j)),
            }
        };
        for i in 0..N {
            for j in 0..N {
                let mut want = 0.0;
                for a in 0..N { for b in 0..N { want += full(i, a) * p[a][b] * full(j, b); } }
                prop_assert!((f64::from(joint.at(i, j)) - want).abs() < 1e-4 * (1.0 + want.abs()));
            }
        }
    }

    #[test]
    fn removing_rows_keeps_the_others(
        seed in proptest::collection::vec(-1.0f32..1.0, 81), first in 0usize..8,
    ) {
        let p = positive(&seed);
        let mut joint = joint_of(&p);
        joint.remove(first, 2);
        let kept: Vec<usize> = (0..N).filter(|i| *i != first && *i != first + 1).collect();
        prop_assert_eq!(joint.rows(), kept.len());
        for (i, &a) in kept.iter().enumerate() {
            for (j, &b) in kept.iter().enumerate() {
                prop_assert_eq!(joint.at(i, j), p[a.max(b)][a.min(b)] as f32);
            }
        }
    }

    #[test]
    fn small_systems_are_solved(v in proptest::array::uniform9(-1.0f32..1.0), e in proptest::array::uniform3(-1.0f32..1.0)) {
        let mut s = [[0.0; 3]; 3];
        for i in 0..3 { for j in 0..3 {
            s[i][j] = (0..3).map(|k| v[3 * i + k] * v[3 * j + k]).sum::<f32>() + if i == j { 0.1 } else { 0.0 };
        } }
        let (x, log_determinant) = solve(&s, &e, 3).unwrap();
        for i in 0..3 {
            let back: f32 = (0..3).map(|j| s[i][j] * x[j]).sum();
            prop_assert!((back - e[i]).abs() < 1e-4);
        }
        let exact: Vec<Vec<f64>> = s.iter().map(|r| r.iter().map(|v| f64::from(*v)).collect()).collect();
        prop_assert!((f64::from(log_determinant) - invert(exact).1.ln()).abs() < 1e-3);
    }

    /// Derivatives of a contact's residuals by pose and plane, in space and in the plane.
    #[test]
    fn residuals_have_their_derivatives(
        pose in proptest::array::uniform6(-0.5f32..0.5),
        at in proptest::array::uniform6(-0.3f32..0.3),
        small in proptest::array::uniform9(-1.0f32..1.0),
        n in proptest::array::uniform3(-1.0f32..1.0),
        turn in proptest::array::uniform3(-0.3f32..0.3),
    ) {
        if let Some(normal) = Vector(n).normalized() {
            let prior = <Spatial as Space>::Pose::IDENTITY.retract(Vector(pose));
            check::<Spatial>(prior, Vector(at) * 0.3, normal, Vector(turn), &small)?;
        }
        if let Some(normal) = Vector([n[0], n[1]]).normalized() {
            let prior = <Planar as Space>::Pose::IDENTITY.retract(Vector([pose[0], pose[1], pose[5]]));
            let at = Vector([at[0], at[1], at[2]]);
            check::<Planar>(prior, at, normal, Vector([turn[0], turn[1]]), &small)?;
        }
    }
}

fn check<S: Chart>(
    prior: S::Pose,
    at: S::Tangent,
    normal: S::Vector,
    turn: S::Vector,
    small: &[f32; 9],
) -> Result<(), TestCaseError> {
    let plane = Plane::<S> { normal, offset: 0.04 };
    let pose = prior.retract(at);
    let felt = (normal + turn * 0.3).normalized().unwrap();
    let touch = Touch::<S> {
        point: pose.transform(normal * 0.043 + turn * 0.1),
        normal: pose.rotate(felt),
        directed: true,
        point_variance: 1e-6,
        normal_variance: 7e-3,
    };
    let rows = measure::<S>(&touch, &pose, &S::transport(at), &plane);
    let step = S::Tangent::from_fn(|i| 4e-3 * small[i]);
    let shift: Vec<f32> = (0..S::DIMENSION).map(|i| 4e-3 * small[6 + i % 3]).collect();
    let moved = prior.retract(at + step);
    let displaced = plane.displaced(&shift);
    let after = measure::<S>(&touch, &moved, &S::transport(at + step), &displaced);
    // The axes across a normal jump where its first coordinate changes sign: directions are compared
    // along the axes from before.
    let (old, new) = (across::<S>(plane.normal), across::<S>(displaced.normal));
    for (k, row) in rows.as_slice().iter().enumerate() {
        let then: f32 = if k < S::DIMENSION - 1 {
            let along = after.as_slice().iter().zip(&new[..S::DIMENSION - 1]);
            along.map(|(row, axis)| row.residual * axis.dot(old[k])).sum()
        } else {
            after.as_slice()[k].residual
        };
        let by_plane: f32 = (0..S::DIMENSION).map(|i| row.plane[i] * shift[i]).sum();
        let want = row.residual + row.pose.dot(step) + by_plane;
        // Second order in the step, and first in the angle between the normals.
        let tilt = 0.3 * turn.norm();
        let allowed = 1e-4 + tilt * (step.norm() + 4e-3);
        prop_assert!((then - want).abs() < allowed, "{then} {want}");
    }
    Ok(())
}

/// The axes across a normal jump where its first coordinate changes sign, and the covariance is about those
/// from before.
#[test]
fn derivatives_by_a_displaced_plane_are_by_its_coordinates_before() {
    let before =
        Plane::<Planar> { normal: Vector([-0.01, 1.0]).normalized().unwrap(), offset: 0.04 };
    let other = Plane { offset: 0.0401, ..before };
    for tilt in [0.02, -0.02] {
        let rows = |by: f32| {
            let after = before.displaced(&[tilt + by, 0.0]);
            (between::<Planar>(&after, &other).unwrap(), after)
        };
        let ((near, after), (far, _)) = (rows(0.0), rows(1e-3));
        let by = undisplaced::<Planar>(&near[0].1, &before, &after);
        // The coordinate that is compared is along the displaced plane's own axis.
        assert!(((far[0].0 - near[0].0) / 1e-3 - by[0]).abs() < 0.01, "{tilt} {by:?}");
        assert_eq!(by[1], near[0].1[1]);
    }
}

#[test]
fn the_normal_distribution_is_close() {
    for (z, want) in [(-4.0, 3.167_124e-5), (-1.0, 0.158_655_25), (0.0, 0.5), (2.0, 0.977_249_87)] {
        assert!((normal(z).1 - want).abs() < 1e-6, "{z}");
    }
    assert!((normal(1.0).0 - 0.241_970_7).abs() < 1e-6);
    assert!((log_normal(1.0, 4.0) - (-1.737_085_7)).abs() < 1e-5);
}

/// A pose of which nothing is known but its prior, and a contact that opens a face.
#[test]
fn a_new_face_goes_through_its_contact_whatever_the_pose() {
    let mut prior = Hypothesis::<Spatial, 4, 18, 171, 0>::new();
    prior.place(Pose::from_translation(Vector([0.3, 0.0, 0.1])));
    for i in 0..6 {
        prior.joint.add_variance(i, if i < 3 { 1e-4 } else { 0.04 });
    }
    let touch = Touch {
        point: Vector([0.34, 0.01, 0.1]),
        normal: Vector([0.8, 0.6, 0.0]),
        directed: true,
        point_variance: 1e-6,
        normal_variance: 7e-3,
    };
    let mut work = Work::<Spatial, 4, 18, 171>::new();
    work.begin(&prior, Vector::ZERO, [0.0; 2]);
    assert_eq!(work.open(&touch, &prior.pose, Vector::ZERO), Some(0));
    // However the pose is off, its own contact lies on it, but for its noise.
    let [height, variance] = work.height(touch.point, 0.0, &prior.pose, 0);
    assert!(height.abs() < 1e-7 && (variance - 1e-6).abs() < 1e-8, "{height} {variance}");
    // Somewhere else the face is as unsure as its normal.
    let away = touch.point + Vector([-0.6, 0.8, 0.0]) * 0.1;
    let [_, variance] = work.height(away, 0.0, &prior.pose, 0);
    assert!((variance - (1e-6 + 7e-3 * 0.01)).abs() < 1e-7, "{variance}");
    // A face that is already there and the new one are the same when one contact is felt twice.
    assert_eq!(work.open(&touch, &prior.pose, Vector::ZERO), Some(1));
    assert!(work.coincidence(0, 1).unwrap() > 5.0);
    work.join(0, 1);
    let [_, joined] = work.height(away, 0.0, &prior.pose, 0);
    assert!((joined / variance - 0.5).abs() < 0.02, "{joined} {variance}");
    assert!(prior.pose_covariance().is_finite());
}

/// A half-space takes the mean and variance of the normal distribution that is cut there.
#[test]
fn a_bound_cuts_the_normal_distribution() {
    let mut prior = Hypothesis::<Planar, 3, 9, 45, 0>::new();
    prior.place(Pose::IDENTITY);
    let mut work = Work::<Planar, 3, 9, 45>::new();
    let face = Touch {
        point: Vector([0.05, 0.0]),
        normal: Vector([1.0, 0.0]),
        directed: true,
        point_variance: 1e-10,
        normal_variance: 1e-8,
    };
    work.begin(&prior, Vector::ZERO, [0.0; 2]);
    work.open(&face, &prior.pose, Vector::ZERO);
    work.joint.add_variance(0, 1e-4);
    // A point 5 mm outside the face; it moves with x, whose deviation is 10 mm.
    let point = (Vector([0.055, 0.0]), 0.0);
    let chance = work.bound(point, &prior.pose, 0, (1.0, 0.0));
    // For a standard normal cut below −½: mean −(φ/Φ), variance by the same.
    let (density, inside) = normal(-0.5);
    let ratio = density / inside;
    assert!((chance - crate::math::ln(inside)).abs() < 1e-4);
    // The point's height is 5 mm − x.
    assert!((work.mean[0] - 0.01 * ratio).abs() < 1e-5, "{}", work.mean[0]);
    let left = 1e-4 * (1.0 - ratio * (ratio - 0.5));
    assert!((work.joint.at(0, 0) - left).abs() < 1e-6, "{} {left}", work.joint.at(0, 0));
    // What is doubted entirely changes nothing.
    let before = work.mean[0];
    work.bound((Vector([0.09, 0.0]), 0.0), &prior.pose, 0, (1.0, 0.5));
    assert_eq!(work.mean[0], before);
}
