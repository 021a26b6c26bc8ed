//! The axes that contacts' normals lie on, square to each other.

use nalgebra::{Matrix3, Rotation3};

use crate::reference::Contact;
use crate::space::Point;

/// Contacts whose normals axes are begun with, and rounds of bringing them closer to all normals.
const BEGUN: usize = 12;
const ROUNDS: usize = 6;

/// χ² of a normal from which on it lies on no axis: one in a hundred is farther off in space.
const ASKEW: f64 = 9.0;

/// A normal and its weight.
pub(super) type Normal = (Point, f64);

/// A usable contact's, if it has one.
pub(super) fn normal(contact: &Contact) -> Option<Normal> {
    Some((contact.checked()?.normal?, contact.normal_deviation.powi(-2)))
}

/// How many numbers turn a box.
pub(super) fn directions(dimension: usize) -> usize {
    if dimension == 2 { 1 } else { 3 }
}

/// The frame whose axes are nearest to all normals, and χ² of these.
pub(super) fn axes(dimension: usize, felt: &[Normal]) -> Option<(Rotation3<f64>, f64)> {
    let aligned = firsts(dimension, felt).map(|first| {
        let frame = aligned(dimension, first, felt);
        (frame, felt.iter().map(|normal| off(&frame, normal)).sum::<f64>())
    });
    aligned.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Which contacts' normals lie on the axes that are nearest to most; those without a usable one do not.
pub(super) fn along_axes(dimension: usize, contacts: &[Contact]) -> Vec<bool> {
    let felt: Vec<Normal> = contacts.iter().filter_map(normal).collect();
    let aligned = firsts(dimension, &felt).map(|first| {
        let is_near = |normal: &&Normal| off(&first, normal) < ASKEW;
        let near: Vec<Normal> = felt.iter().filter(is_near).copied().collect();
        let frame = aligned(dimension, first, &near);
        (frame, felt.iter().map(|normal| off(&frame, normal).min(ASKEW)).sum::<f64>())
    });
    let best = aligned.min_by(|a, b| a.1.total_cmp(&b.1));
    let along = |c: &Contact| Some(off(&best.as_ref()?.0, &normal(c)?) < ASKEW);
    contacts.iter().map(|c| along(c).unwrap_or_default()).collect()
}

/// Frames with an axis along one of the first normals and another towards any.
fn firsts<'a>(dimension: usize, felt: &'a [Normal]) -> impl Iterator<Item = Rotation3<f64>> + 'a {
    felt.iter().take(BEGUN).flat_map(move |(first, _)| {
        let seconds: Vec<Point> = match dimension {
            2 => vec![Point::new(-first.y, first.x, 0.0)],
            _ => felt.iter().map(|(normal, _)| normal - first * first.dot(normal)).collect(),
        };
        seconds.into_iter().filter_map(move |second| {
            let second = second.try_normalize(0.5)?;
            let rows = [*first, second, first.cross(&second)].map(|row| row.transpose());
            Some(Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows)))
        })
    })
}

/// The axis nearest to a normal as a frame sees it.
fn nearest(frame: &Rotation3<f64>, normal: &Point) -> Point {
    let seen = frame * normal;
    let most = seen.iamax();
    Point::ith(most, seen[most].signum())
}

/// χ² of a normal off the axis nearest to it.
fn off(frame: &Rotation3<f64>, (normal, weight): &Normal) -> f64 {
    (frame * normal - nearest(frame, normal)).norm_squared() * weight
}

/// The frame near this one whose axes are nearest to all normals (the orthogonal Procrustes problem; Schönemann,
/// Psychometrika 31, 1966).
fn aligned(dimension: usize, mut frame: Rotation3<f64>, felt: &[Normal]) -> Rotation3<f64> {
    for _ in 0..ROUNDS {
        let mut sum = Matrix3::zeros();
        for (normal, weight) in felt {
            sum += nearest(&frame, normal) * normal.transpose() * *weight;
        }
        if dimension == 2 {
            sum[(2, 2)] += sum.norm();
        }
        let svd = sum.svd(true, true);
        let (Some(u), Some(v)) = (svd.u, svd.v_t) else { break };
        let flip = Matrix3::from_diagonal(&Point::new(1.0, 1.0, (u * v).determinant().signum()));
        frame = Rotation3::from_matrix_unchecked(u * flip * v);
    }
    frame
}
