//! Lengths and angles that look as if their unit had been forgotten.

use std::f64::consts::PI;

use nalgebra::Point3;

use crate::log::{GraspLog, LoggedGrasp};
use crate::shape::Geometry;
use crate::space::Point;

/// The greatest length of a thing that hands hold, metres.
const WIDEST: f64 = 10.0;

/// Standard deviations between contacts and a surface that no noise explains, and the least of them that
/// counts, metres: contacts said to be exact may well be some millimetres off.
const FARTHEST: f64 = 100.0;
const LEAST: f64 = 1e-3;

/// Extents of what one grasp felt that a deviation of contacts, and of the object's way between grasps, is at most.
const FELT: f64 = 2.0;
const MOVED: f64 = 10.0;

/// A deviation of normals from which they say nothing: nobody states it, but of some degrees it is the number.
const FACING: f64 = 1.2;

/// How many times as large as what was felt of it a true shape is, at most: one in centimetres is a hundred times.
const LARGER: f64 = 90.0;

const QUESTION: &str = "are they metres, or does a unit such as mm lack?";

/// What is to be said of contacts or a model so wide, and of contacts that lie so far from the surface for
/// their standard deviation; all in metres.
pub(super) fn doubt(extent: f64, distance: f64, deviation: f64) -> Option<String> {
    if extent > WIDEST {
        return Some(format!("lengths up to {extent:.0} m: {QUESTION}"));
    }
    (distance > FARTHEST * deviation.max(LEAST)).then(|| {
        format!("contacts with a deviation of {deviation:.4} m lie {distance:.3} m from the surface: {QUESTION}")
    })
}

/// What is to be said of the noise in a log's header.
pub(super) fn noise(log: &GraspLog) -> Option<String> {
    let of = |grasp: &LoggedGrasp| extent(grasp.contacts.iter().map(|contact| contact.point));
    let one = log.grasps.iter().map(of).fold(0.0, f64::max);
    let all = log.grasps.iter().flat_map(|g| g.contacts.iter().map(|contact| contact.point));
    let felt = if one > 0.0 { one } else { extent(all) };
    let noise = &log.noise;
    for (name, deviation, most) in
        [("point", noise.point, FELT * felt), ("translation", noise.translation, MOVED * felt)]
    {
        if let Some(deviation) = deviation.filter(|deviation| felt > 0.0 && *deviation > most) {
            return Some(format!(
                "noise.{name} of {deviation} m where a grasp felt {felt:.3} m of the object: {QUESTION}"
            ));
        }
    }
    for (name, deviation, most) in
        [("normal", noise.normal, FACING), ("rotation", noise.rotation, PI)]
    {
        if let Some(deviation) = deviation.filter(|deviation| *deviation > most) {
            return Some(format!("noise.{name} of {deviation}: are they radians, or degrees?"));
        }
    }
    None
}

/// What is to be said of a true shape that no contact at its true pose is near, or that is far larger than what was
/// felt of it.
pub(super) fn truth(log: &GraspLog, shape: &Geometry) -> Option<String> {
    let points = log.grasps.iter().filter_map(|grasp| Some((grasp.truth?.inverse(), grasp)));
    let points: Vec<Point> = points
        .flat_map(|(to_object, grasp)| {
            grasp.contacts.iter().map(move |c| (to_object * Point3::from(c.point)).coords)
        })
        .collect();
    let (low, high) = shape.bounds();
    let (size, felt) = ((high - low).norm(), extent(points.iter().copied()));
    let outside = |p: &Point| (p - p.sup(&low).inf(&high)).norm();
    let nearest = points.iter().map(outside).fold(f64::INFINITY, f64::min);
    let question = "are the shape and its poses in metres, as the contacts are?";
    if felt > 0.0 && size > LARGER * felt {
        return Some(format!(
            "the true shape is {size:.3} m long, contacts at its true poses {felt:.3} m: {question}"
        ));
    }
    (nearest.is_finite() && nearest > size).then(|| {
        format!("contacts at the true poses lie {nearest:.3} m from the true shape: {question}")
    })
}

/// Diagonal of the box about points, metres; zero without any.
fn extent(points: impl Iterator<Item = Point>) -> f64 {
    let both = points.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)));
    both.map_or(0.0, |(low, high)| (high - low).norm())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Options, simulate};

    #[test]
    fn what_hands_hold_raises_no_doubt() {
        assert_eq!(doubt(0.12, 0.0013, 0.001), None);
        assert_eq!(doubt(0.12, 0.03, 1e-4), None);
        assert!(doubt(60.0, 0.001, 0.001).is_some_and(|d| d.starts_with("lengths up to 60 m")));
        assert!(doubt(6.0, 2.996, 0.001).is_some_and(|d| d.contains("lie 2.996 m from")));
    }

    #[test]
    fn noise_and_truths_in_other_units_raise_a_doubt() {
        for object in ["rectangle:0.12x0.06", "box:0.12x0.06x0.06"] {
            let made = simulate(&Options::new(object.parse().unwrap())).unwrap();
            let (log, shape) = (made.log, made.geometry);
            assert_eq!((noise(&log), truth(&log, &shape)), (None, None), "{object}");
            let with = |change: fn(&mut GraspLog)| {
                let mut log = log.clone();
                change(&mut log);
                [noise(&log), truth(&log, &shape)].map(Option::unwrap_or_default)
            };
            let [said, _] = with(|log| log.noise.point = Some(1.0));
            assert!(said.contains("noise.point of 1 m"), "{said}");
            let [said, _] = with(|log| log.noise.translation = Some(5.0));
            assert!(said.contains("noise.translation of 5 m"), "{said}");
            let [said, _] = with(|log| log.noise.normal = Some(5.0));
            assert!(said.contains("noise.normal of 5: are they radians"), "{said}");
            let [said, _] = with(|log| log.noise.rotation = Some(11.5));
            assert!(said.contains("noise.rotation of 11.5"), "{said}");
            let far = |grasp: &mut LoggedGrasp| {
                grasp.truth.as_mut().unwrap().translation.vector *= 1e3;
                grasp.truth.as_mut().unwrap().translation.vector.x += 400.0;
            };
            let mut moved = log.clone();
            moved.grasps.iter_mut().for_each(far);
            assert!(truth(&moved, &shape).is_some(), "{object}");
            let wide =
                Options::new(object.replace("0.12", "9.9").replace("0.06", "9.9").parse().unwrap());
            let wide = wide.object.geometry().unwrap();
            assert!(truth(&log, &wide).is_some_and(|d| d.contains("m long")), "{object}");
            // Neither without contacts nor without true poses.
            let nothing = with(|log| log.grasps.iter_mut().for_each(|g| g.contacts.clear()));
            assert_eq!(nothing, ["", ""]);
            let nothing = with(|log| log.grasps.iter_mut().for_each(|g| g.truth = None));
            assert_eq!(nothing, ["", ""]);
        }
    }
}
