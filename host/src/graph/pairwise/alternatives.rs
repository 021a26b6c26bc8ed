//! All relative poses that explain two grasps (thesis 5.2.4): a hexagon turned by 60° feels the same.
//!
//! The faces as the segmentation has them give one pose. Others come from laying faces of the one
//! grasp on other faces of the other: every rotation that takes one face's normal to another's (in space,
//! two normals at once) is tried, and what it matches is registered.

use nalgebra::{Rotation3, UnitQuaternion};

use super::registration::{Registered, RegistrationError, register};
use super::similarity::{Touched, observable, pairs};
use crate::graph::joint::tangent::{are_near, local};
use crate::space::{Point, Pose};

/// Normals within this angle match, radians: three deviations of what two contacts of 5° differ by.
const ALIKE: f64 = 0.37;

/// Deviations of its χ² beyond which a relative pose does not explain the grasps.
const GATE: f64 = 3.3;

/// Relative poses nearer than this (metres, radians) are one.
const SAME: [f64; 2] = [5e-3, 0.1];

/// How far a relative pose may lie from what is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// A relative pose that explains two grasps.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternative {
    /// Takes contacts of the second grasp into the first one's frame.
    pub registered: Registered,
    /// Faces of the second grasp and those of the first that they lie on.
    pub matched: Vec<[usize; 2]>,
}

impl Alternative {
    /// Whether every face lies on itself.
    pub fn as_labelled(&self) -> bool {
        self.matched.iter().all(|[a, b]| a == b)
    }
}

/// The relative poses of two grasps that fit within noise, that of the labels first and the others by
/// how well they fit. `guess` takes the second grasp's frame into the first one's.
///
/// Never fails: grasps of fewer than three faces, or without normals, have none.
pub fn alternatives(
    dimension: usize,
    first: &Touched,
    second: &Touched,
    guess: &Pose,
    allowed: &Allowed,
) -> Vec<Alternative> {
    let (to, from) = (first.felt(), second.felt());
    let mut tried: Vec<Vec<[usize; 2]>> = Vec::new();
    let mut found: Vec<Alternative> = Vec::new();
    let mut attempt = |matched: Vec<[usize; 2]>, start: Pose| {
        let normals: Vec<Point> =
            from.iter().filter(|(f, _)| matched.iter().any(|m| m[0] == *f)).map(|f| f.1).collect();
        if tried.contains(&matched) || !observable(dimension, &normals) {
            return;
        }
        tried.push(matched.clone());
        let Ok(registered) = register(dimension, &pairs(second, first, &matched), start) else {
            return;
        };
        let apart = local(guess, &registered.pose);
        let near = apart.fixed_rows::<3>(0).norm() < allowed.translation
            && apart.fixed_rows::<3>(3).norm() < allowed.rotation;
        let known = |other: &Alternative| are_near(&other.registered.pose, &registered.pose, SAME);
        if near && plausible(&registered) && !found.iter().any(known) {
            found.push(Alternative { registered, matched });
        }
    };
    let labelled: Vec<[usize; 2]> = from
        .iter()
        .filter(|(f, _)| to.iter().any(|(g, _)| f == g))
        .map(|(f, _)| [*f, *f])
        .collect();
    attempt(labelled, *guess);
    for rotation in rotations(dimension, &from, &to) {
        let turn = guess.rotation.inverse() * rotation;
        if turn.angle() > allowed.rotation {
            continue;
        }
        let matched = matches(&from, &to, &rotation);
        let start = laid(second, first, &matched, rotation);
        attempt(matched, start);
    }
    let others = usize::from(found.first().is_some_and(Alternative::as_labelled));
    found[others..].sort_by(|a, b| a.registered.chi2.total_cmp(&b.registered.chi2));
    found
}

/// The relative pose by the labels alone, as the thesis has it.
///
/// # Errors
/// Where the faces that both felt do not determine it, or numbers are unusable.
pub fn labelled(
    dimension: usize,
    first: &Touched,
    second: &Touched,
    faces: &[usize],
    guess: &Pose,
) -> Result<Registered, RegistrationError> {
    let matched: Vec<[usize; 2]> = faces.iter().map(|f| [*f, *f]).collect();
    register(dimension, &pairs(second, first, &matched), *guess)
}

/// Whether χ² is within what noise does (Wilson and Hilferty's normal approximation).
pub fn plausible(registered: &Registered) -> bool {
    let n = registered.degrees.max(1.0);
    let spread = 2.0 / (9.0 * n);
    let z = ((registered.chi2 / n).cbrt() - (1.0 - spread)) / spread.sqrt();
    z < GATE
}

/// Rotations that lay a face of the one grasp on one of the other; in space, two on two.
fn rotations(
    dimension: usize,
    from: &[(usize, Point)],
    to: &[(usize, Point)],
) -> Vec<UnitQuaternion<f64>> {
    let mut found = Vec::new();
    for (_, m) in from {
        for (_, n) in to {
            if dimension == 2 {
                let angle = n.y.atan2(n.x) - m.y.atan2(m.x);
                found.push(UnitQuaternion::from_axis_angle(&Point::z_axis(), angle));
                continue;
            }
            for (_, m2) in from {
                for (_, n2) in to {
                    let like = (m.dot(m2).clamp(-1.0, 1.0).acos()
                        - n.dot(n2).clamp(-1.0, 1.0).acos())
                    .abs();
                    if like < ALIKE {
                        found.extend(between([m, m2], [n, n2]));
                    }
                }
            }
        }
    }
    found
}

/// The rotation that takes two directions to two others, exactly in their plane's normal and bisector;
/// `None` for parallel ones.
fn between([a, b]: [&Point; 2], [c, d]: [&Point; 2]) -> Option<UnitQuaternion<f64>> {
    let frame = |u: &Point, v: &Point| {
        let normal = u.cross(v).try_normalize(0.2)?;
        let middle = (u + v).try_normalize(1e-3)?;
        let basis = nalgebra::Matrix3::from_columns(&[middle, normal.cross(&middle), normal]);
        Some(Rotation3::from_matrix_unchecked(basis))
    };
    let turn = frame(c, d)? * frame(a, b)?.inverse();
    Some(UnitQuaternion::from_rotation_matrix(&turn))
}

/// Faces that lie on each other after a rotation: each the other's nearest in direction.
fn matches(
    from: &[(usize, Point)],
    to: &[(usize, Point)],
    rotation: &UnitQuaternion<f64>,
) -> Vec<[usize; 2]> {
    let least = ALIKE.cos();
    let alike = |f: &(usize, Point), g: &(usize, Point)| (rotation * f.1).dot(&g.1);
    let mut found = Vec::new();
    for f in from {
        let nearest = to.iter().max_by(|a, b| alike(f, a).total_cmp(&alike(f, b)));
        let Some(g) = nearest.filter(|g| alike(f, g) > least) else { continue };
        let back = from.iter().max_by(|a, b| alike(a, g).total_cmp(&alike(b, g)));
        if back.is_some_and(|b| b.0 == f.0) {
            found.push([f.0, g.0]);
        }
    }
    found
}

/// The pose of that rotation that lays the middle of the matched contacts on the other middle.
fn laid(
    second: &Touched,
    first: &Touched,
    matched: &[[usize; 2]],
    rotation: UnitQuaternion<f64>,
) -> Pose {
    let found = pairs(second, first, matched);
    let total: f64 = found.iter().map(|p| p.weight).sum();
    let middle = |f: fn(&super::registration::Pair) -> Point| {
        found.iter().map(|p| f(p) * p.weight).sum::<Point>() / total.max(1e-12)
    };
    let shift = middle(|p| p.to.point) - rotation * middle(|p| p.from.point);
    Pose::from_parts(shift.into(), rotation)
}
