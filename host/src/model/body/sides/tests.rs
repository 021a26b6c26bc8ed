use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, PI, TAU};

use super::*;
use crate::model::faces::tests::touched;

fn regular(object: &str, contacts: usize, seed: u64) -> (Vec<Contact>, Body, Faces) {
    let (dimension, contacts) = touched(object, contacts, seed);
    let faces = Faces::fit(dimension, &contacts).unwrap();
    let body = Body::regulars(dimension, &contacts, &faces).remove(0);
    let sides = body.sides(dimension, &contacts).unwrap();
    (contacts, body, sides)
}

#[test]
fn equal_sides_stay_equal() {
    let (contacts, _, sides) = regular("hexagon:0.05", 12, 3);
    let angle = |face: &Face| face.normal.y.atan2(face.normal.x).to_degrees().rem_euclid(60.0);
    let first = &sides.faces[0];
    let opposite = |face: &Face| {
        let other = sides.faces.iter().find(|f| f.normal.dot(&face.normal) < -0.9).unwrap();
        face.offset + other.offset
    };
    assert_eq!(sides.faces.len(), 6);
    for face in &sides.faces {
        assert!((angle(face) - angle(first)).abs() < 1e-6);
        assert!((opposite(face) - opposite(first)).abs() < 1e-9);
        assert!(face.value(&face.centroid).abs() < 1e-12);
    }
    // Each contact has one of the sides; one of them lies two deviations before another than its own.
    assert_eq!(sides.faces.iter().map(|f| f.contacts).sum::<usize>(), contacts.len());
    assert!(sides.chi_squared < 48.0);
}

/// Of all sides: the mean square of what a true point of one is off it, over what it is expected to be.
fn surprise(object: &str, contacts: usize, truth: &[(Point, Point)]) -> f64 {
    let seeds = 0..60;
    let one = |seed: u64| {
        let (_, _, sides) = regular(object, contacts, seed);
        let square = |(out, along): &(Point, Point)| {
            let own = sides.faces.iter().find(|face| face.normal.dot(out) > 0.9).unwrap();
            let at = out + along;
            own.value(&at).powi(2) / own.variance(&at)
        };
        truth.iter().map(square).sum::<f64>() / truth.len() as f64
    };
    seeds.clone().map(one).sum::<f64>() / seeds.count() as f64
}

#[test]
fn sides_are_as_uncertain_as_they_are_wrong() {
    for (object, contacts, sides) in [("hexagon:0.06", 12, 6), ("triangle:0.06", 12, 3)] {
        // A corner lies on +x, of the triangle on +y.
        let first = if sides == 6 { FRAC_PI_6 } else { -FRAC_PI_2 };
        let far = 0.06 * (PI / f64::from(sides)).cos();
        let side = |i: i32| {
            let (sin, cos) = (first + TAU * f64::from(i) / f64::from(sides)).sin_cos();
            [-0.02, 0.0, 0.02].map(|along| {
                (
                    Point::new(cos, sin, 0.0),
                    Point::new(cos, sin, 0.0) * (far - 1.0) + Point::new(-sin, cos, 0.0) * along,
                )
            })
        };
        let truth: Vec<_> = (0..sides).flat_map(side).collect();
        let mean = surprise(object, contacts, &truth);
        assert!((0.7..1.4).contains(&mean), "{object} {mean}");
    }
}

#[test]
fn what_is_round_has_no_sides() {
    let (dimension, contacts) = touched("cylinder:0.06x0.1", 30, 1);
    let faces = Faces::fit(dimension, &contacts).unwrap();
    for body in [Body::ball(3, &contacts), Body::turned(3, &contacts, &faces, false)] {
        assert!(body.unwrap().sides(dimension, &contacts).is_none());
    }
    let (_, body, _) = regular("hexagon:0.05", 12, 3);
    let lost = Contact { point: Point::repeat(f64::NAN), ..contacts[0] };
    assert!(body.sides(2, &[lost]).is_none());
}
