//! What could be known at best: poses drawn from the belief of an estimator that was told the
//! object's faces, which contact lies on which, and the first pose.
//!
//! It is a Kalman filter about the true poses: the motion noise of every grasp, and of every contact
//! its distance along the normal and the normal itself, with the log's deviations. Where a grasp only
//! feels two parallel faces, nobody can say how far the object slid along them. To first order, and
//! with touched places taken as flat: on curved objects it means nothing and is left out.

use std::f64::consts::PI;

use nalgebra::{Matrix6, SymmetricEigen, UnitQuaternion, Vector6};

use crate::log::GraspLog;
use crate::shape::Geometry;
use crate::sim::random::Random;
use crate::slam::deviations;
use crate::slam::track::Step;
use crate::space::{Point, Pose};

/// More directions than this and a surface is curved.
const DIRECTIONS: usize = 24;

/// The directions that the faces of an object look to, in its frame; `None` where it is curved.
pub fn directions(geometry: &Geometry) -> Option<Vec<Point>> {
    let mut directions: Vec<Point> = Vec::new();
    for (_, normal) in geometry.samples(2000) {
        if directions.iter().all(|d| d.dot(&normal) < 0.999) {
            directions.push(normal);
        }
        if directions.len() > DIRECTIONS {
            return None;
        }
    }
    Some(directions)
}

/// The true poses, each displaced by a draw from what could be known of it; steps carry that
/// covariance. Nothing where a true pose is missing.
pub fn follow(log: &GraspLog, directions: &[Point], seed: u64) -> Vec<Step> {
    let [mut random] = Random::streams(seed);
    let centre = centre(log);
    let mut covariance = Matrix6::zeros();
    let mut before: Option<Pose> = None;
    let mut steps = Vec::with_capacity(log.grasps.len());
    for grasp in &log.grasps {
        let Some(truth) = grasp.truth else { return Vec::new() };
        if let Some(before) = before {
            let moved = grasp.motion.unwrap_or_default() * before;
            covariance = moved_by(&covariance, &(moved.inverse() * truth));
            covariance += motion_noise(log, &centre);
        }
        before = Some(truth);
        let to_object = truth.inverse();
        for contact in &grasp.contacts {
            let Some(felt) = contact.normal.map(|n| to_object.rotation * n) else { continue };
            let (point_deviation, normal_deviation) = deviations(contact, &log.noise);
            // That of the face: its own would tell the shape's secrets by its noise.
            let alike = |a: &&Point, b: &&Point| a.dot(&felt).total_cmp(&b.dot(&felt));
            let Some(normal) = directions.iter().max_by(alike) else { continue };
            let arm = (to_object * nalgebra::Point3::from(contact.point)).coords.cross(normal);
            let distance = Vector6::new(normal.x, normal.y, normal.z, arm.x, arm.y, arm.z);
            observe(&mut covariance, &distance, point_deviation);
            for axis in across(log.dimension, normal) {
                let turn = Vector6::new(0.0, 0.0, 0.0, axis.x, axis.y, axis.z);
                observe(&mut covariance, &turn, normal_deviation);
            }
        }
        let mut error = draw(&covariance, &mut random);
        if log.dimension == 2 {
            // Eigenvectors leave the plane by rounding.
            error.fixed_rows_mut::<3>(2).fill(0.0);
        }
        let turn = UnitQuaternion::from_scaled_axis(error.fixed_rows::<3>(3).into_owned());
        let shift = error.fixed_rows::<3>(0).into_owned();
        let pose = truth * Pose::from_parts(shift.into(), turn);
        steps.push(Step { covariance, ..Step::certain(pose) });
    }
    steps
}

/// The mean of the contacts in the true object frame, metres: about where the object's centroid is.
fn centre(log: &GraspLog) -> Point {
    let touched = log.grasps.iter().filter_map(|g| Some((g.truth?.inverse(), &g.contacts)));
    let points = touched.flat_map(|(to_object, contacts)| {
        contacts.iter().map(move |c| (to_object * nalgebra::Point3::from(c.point)).coords)
    });
    let (sum, count) = points.fold((Point::zeros(), 0.0), |(sum, n), p| (sum + p, n + 1.0));
    sum / f64::max(count, 1.0)
}

/// The axes about which a turn changes the normal.
fn across(dimension: usize, normal: &Point) -> Vec<Point> {
    if dimension == 2 {
        return vec![Point::z()];
    }
    let helper = if normal.x.abs() < 0.7 { Point::x() } else { Point::y() };
    let first = normal.cross(&helper).normalize();
    vec![first, normal.cross(&first)]
}

/// The noise of one motion, drawn per axis about the object's centre, at the object's origin.
fn motion_noise(log: &GraspLog, centre: &Point) -> Matrix6<f64> {
    let variance = |deviation: Option<f64>, usual: f64| deviation.unwrap_or(usual).powi(2);
    let shift = variance(log.noise.translation, 0.01);
    let turn = variance(log.noise.rotation, PI / 9.0);
    let own = match log.dimension {
        2 => Vector6::new(shift, shift, 0.0, 0.0, 0.0, turn),
        _ => Vector6::new(shift, shift, shift, turn, turn, turn),
    };
    // A turn about the centre moves the origin.
    let mut about = Matrix6::identity();
    about.fixed_view_mut::<3, 3>(0, 3).copy_from(&centre.cross_matrix());
    about * Matrix6::from_diagonal(&own) * about.transpose()
}

/// The covariance in the axes of the pose that `slip` leads to.
fn moved_by(covariance: &Matrix6<f64>, slip: &Pose) -> Matrix6<f64> {
    let back = slip.rotation.inverse().to_rotation_matrix().into_inner();
    let mut map = Matrix6::zeros();
    map.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
    map.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
    let lever = -back * slip.translation.vector.cross_matrix();
    map.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
    map * covariance * map.transpose()
}

/// Conditions on one measured number.
fn observe(covariance: &mut Matrix6<f64>, h: &Vector6<f64>, deviation: f64) {
    let gain = *covariance * h;
    let variance = h.dot(&gain) + deviation * deviation;
    *covariance -= gain * gain.transpose() / variance;
}

/// A draw with this covariance.
fn draw(covariance: &Matrix6<f64>, random: &mut Random) -> Vector6<f64> {
    let (first, second) = (random.normal3(), random.normal3());
    let white = Vector6::new(first.x, first.y, first.z, second.x, second.y, second.z);
    let eigen = SymmetricEigen::new(*covariance);
    let scaled = white.component_mul(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    eigen.eigenvectors * scaled
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};

    fn deviation(object: &str, along: &Point) -> f64 {
        let simulation = simulate(&Options::new(object.parse().unwrap())).unwrap();
        let faces = directions(&simulation.geometry).unwrap();
        let steps = follow(&simulation.log, &faces, 1);
        let h = Vector6::new(along.x, along.y, along.z, 0.0, 0.0, 0.0);
        let worst = steps.iter().map(|s| h.dot(&(s.covariance * h))).fold(0.0, f64::max);
        worst.sqrt()
    }

    #[test]
    fn a_hexagon_cannot_slide_unnoticed_and_a_long_rectangle_can() {
        for axis in [Point::x(), Point::y()] {
            assert!(deviation("hexagon:0.045", &axis) < 3e-3);
        }
        // Its long sides are all that a hand in their middle feels.
        assert!(deviation("rectangle:0.3x0.06", &Point::x()) > 9e-3);
        assert!(deviation("rectangle:0.3x0.06", &Point::y()) < 4e-3);
    }

    #[test]
    fn conditioning_is_the_textbook_one() {
        let mut covariance = Matrix6::from_diagonal(&Vector6::new(4.0, 1.0, 1.0, 1.0, 1.0, 9.0));
        let h = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let information = covariance.try_inverse().unwrap() + h * h.transpose() / 0.25;
        observe(&mut covariance, &h, 0.5);
        assert!((covariance - information.try_inverse().unwrap()).norm() < 1e-12);
    }

    #[test]
    fn round_objects_are_not_flat() {
        let faces = |text: &str| {
            let spec: crate::sim::ObjectSpec = text.parse().unwrap();
            directions(&spec.geometry().unwrap()).map(|d| d.len())
        };
        assert_eq!(faces("lshape:0.09x0.09x0.035"), Some(4));
        assert_eq!(faces("box:0.12x0.06x0.06"), Some(6));
        assert_eq!((faces("ellipse:0.1x0.06"), faces("cylinder:0.06x0.1")), (None, None));
    }
}
