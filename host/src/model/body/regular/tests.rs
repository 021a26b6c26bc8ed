use super::*;
use crate::model::body::tests::touch;
use crate::reference::Mean;
use proptest::prelude::*;

/// Sides 30 mm from the middle, ends 40 mm.
const FAR: f64 = 0.03;
const HIGH: f64 = 0.04;

/// A touch of each of those sides of a prism of so many, and as often of the end that is 40 mm up.
fn touched(dimension: usize, sides: usize, on: &[usize]) -> Vec<Contact> {
    let half = FAR * (0.5 * TAU / sides as f64).tan();
    let spread = |i: usize| 0.8 * (2.4 * i as f64).sin();
    let side = |(i, side): (usize, &usize)| {
        let (sin, cos) = (TAU * *side as f64 / sides as f64).sin_cos();
        let out = Point::new(cos, sin, 0.0);
        let up = if dimension == 3 { HIGH * spread(i + 7) } else { 0.0 };
        let along = Point::new(-sin, cos, 0.0) * half * spread(i);
        touch(out * FAR + along + Point::z() * up, out)
    };
    let end = |i: usize| {
        touch(Point::new(0.7 * FAR * spread(i), 0.7 * FAR * spread(i + 4), HIGH), Point::z())
    };
    let ends = if dimension == 3 { on.len() } else { 0 };
    on.iter().enumerate().map(side).chain((0..ends).map(end)).collect()
}

fn regulars(dimension: usize, contacts: &[Contact]) -> Vec<Body> {
    let faces = Faces::fit(dimension, contacts);
    faces.map(|faces| Body::regulars(dimension, contacts, &faces)).unwrap_or_default()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Wherever it is, whatever its size and however it is turned; three neighbours tell the angle.
    #[test]
    fn a_touch_of_half_the_sides_finds_all_of_them(
        turn in prop::array::uniform3(-2f64..2.0),
        away in prop::array::uniform3(-1f64..1.0),
        size in 0.1f64..10.0,
        sides in 5usize..=8,
    ) {
        let turn = Rotation3::new(Point::from(turn));
        let place = |p: Point| turn * p * size + Point::from(away);
        let placed = |c: &Contact| Contact {
            point: place(c.point),
            normal: c.normal.map(|n| turn * n),
            point_deviation: c.point_deviation * size,
            ..*c
        };
        let contacts: Vec<Contact> =
            touched(3, sides, &[0, 1, 2, 3]).iter().map(placed).collect();
        let body = &regulars(3, &contacts)[0];
        prop_assert_eq!(body.parts().len(), sides + 2);
        prop_assert!(body.misfit() < 0.4, "{}", body.misfit());
        let corner = FAR / (0.5 * TAU / sides as f64).cos();
        for side in 0..sides {
            let (sin, cos) = (TAU * (side as f64 + 0.5) / sides as f64).sin_cos();
            let corner = place(Point::new(corner * cos, corner * sin, HIGH));
            prop_assert!(body.value(&corner).abs() < 1e-3 * size, "{}", body.value(&corner));
        }
    }
}

#[test]
fn the_number_of_sides_is_told_where_contacts_tell_it() {
    for sides in SIDES {
        let all: Vec<usize> = (0..sides).collect();
        let found = regulars(2, &touched(2, sides, &all));
        assert_eq!(found[0].parts().len(), sides);
        assert!(found[0].misfit() < 1.0, "{sides} {}", found[0].misfit());
        assert!(found.len() <= KEPT);
    }
    // Every other side of six is all of three, as long as contacts do not say where those end.
    let contacts = touched(2, 6, &[0, 2, 4, 0, 2]);
    let found = regulars(2, &contacts);
    let kinds: Vec<usize> = found.iter().map(|body| body.parts().len()).collect();
    assert_eq!(kinds, [6, 3]);
    // That has the larger surface.
    assert!(found[1].size(2, &contacts) > found[0].size(2, &contacts).map(|size| 1.2 * size));
    // A triangle may be turned twice as far without being another.
    let turns = found[1].oddity() - found[0].oddity();
    assert!(turns > 0.3 && found[0].oddity() > 0.0, "{turns}");
}

#[test]
fn the_end_that_nobody_felt_lies_beyond_the_contacts_and_is_in_doubt() {
    let contacts = touched(3, 6, &[0, 1, 2, 3, 4, 5]);
    let body = &regulars(3, &contacts)[0];
    let last = contacts.iter().map(|c| c.point.z).fold(f64::INFINITY, f64::min);
    assert!(body.value(&(Point::z() * (last - 1e-3))) < 0.0);
    assert!(body.value(&(Point::z() * (last - 0.06))) > 0.0);
    let own = |p: Point| body.modes(&p).iter().filter(|m| m.0 != 0.0).count();
    let doubt = |p: Point| body.modes(&p).last().map(|mode| mode.0.abs());
    assert!(doubt(Point::z() * (last - 0.02)).is_some_and(|doubt| doubt > 2e-3));
    assert_eq!(doubt(Point::z() * HIGH), Some(0.0));
    assert!(own(Point::x() * FAR) >= 4);
}

/// Touches of the sides of a pyramid 60 mm wide and 80 mm high, whose base is 40 mm down, and of that.
fn touched_pyramid(sides: usize, on: &[usize]) -> Vec<Contact> {
    let lean = FAR / (2.0 * HIGH);
    let leant = |contact: &Contact| {
        let Some(flat) = contact.normal.filter(|n| n.z == 0.0) else {
            let point = contact.point * 0.5 - Point::z() * 1.5 * HIGH;
            return touch(point, -Point::z());
        };
        // Towards the axis in proportion to how near the tip it is.
        let left = 0.5 * (1.0 - contact.point.z / HIGH);
        let point = Point::new(contact.point.x * left, contact.point.y * left, contact.point.z);
        touch(point, (flat + Point::z() * lean).normalize())
    };
    touched(3, sides, on).iter().map(leant).collect()
}

#[test]
fn a_pyramid_is_found_with_its_tip_and_its_base() {
    for (sides, on) in [(3, vec![0, 1, 2, 0, 1]), (4, vec![0, 1, 2, 3]), (6, vec![0, 1, 2, 4])] {
        let contacts = touched_pyramid(sides, &on);
        let found = regulars(3, &contacts);
        let tapered = |body: &&Body| body.parts().len() == sides + 2 && body.misfit() < 0.4;
        let body = found.iter().find(tapered).unwrap();
        // Prisms were found as well, and fit worse.
        assert!(found[..KEPT].iter().all(|prism| prism.misfit() > 4.0 * body.misfit()), "{sides}");
        let value = |p: Point| body.value(&p);
        assert!(value(Point::z() * 0.9 * HIGH) < 0.0 && value(Point::z() * 1.2 * HIGH) > 0.0);
        let corner = FAR / (0.5 * TAU / sides as f64).cos();
        for side in 0..sides {
            let (sin, cos) = (TAU * (side as f64 + 0.5) / sides as f64).sin_cos();
            let at = value(Point::new(corner * cos, corner * sin, -HIGH));
            assert!(at.abs() < 1e-3, "{sides} {at}");
        }
    }
}

#[test]
fn the_sides_of_a_prism_hardly_lean() {
    let found = regulars(3, &touched(3, 6, &[0, 1, 2, 3, 4, 5]));
    let leaning = found[KEPT..].iter().find(|body| body.parts().len() == 8).unwrap();
    let axis = leaning.planes().map(|plane| plane.normal).nth(6).unwrap();
    for side in leaning.planes().take(6) {
        assert!(side.normal.dot(&axis).abs() < 0.01, "{}", side.normal.dot(&axis));
    }
}

#[test]
fn turned_its_sides_stay_equal() {
    let body = &regulars(3, &touched(3, 6, &[0, 1, 2, 3, 4, 5]))[0];
    let mut by = vec![0.0; body.modes(&Point::zeros()).len()];
    by[..6].copy_from_slice(&[0.1, -0.1, 0.15, 0.02, -0.03, 0.05]);
    let moved = body.moved(&by, &Point::zeros()).unwrap();
    let planes: Vec<Plane> = moved.planes().take(6).collect();
    assert!(planes[0].normal.dot(&Point::x()).abs() < 0.998);
    let middle: f64 = planes.iter().map(|plane| plane.offset).sum::<f64>() / 6.0;
    assert!(middle > FAR + 5e-4);
    for (one, next) in planes.iter().zip(planes.iter().cycle().skip(1)) {
        assert!((one.normal.dot(&next.normal) - 0.5).abs() < 0.02);
    }
    for (one, across) in planes.iter().zip(&planes[3..]) {
        assert!((one.offset + across.offset - 2.0 * middle).abs() < 1e-3);
    }
}

#[test]
fn what_has_other_sides_fits_none() {
    let normals = [0.0, 70.0, 160.0, 250.0, 300.0f64].map(f64::to_radians);
    let side = |angle: &f64| {
        let out = Point::new(angle.cos(), angle.sin(), 0.0);
        let along = Point::new(-angle.sin(), angle.cos(), 0.0);
        [-0.01, 0.01].map(|by| touch(out * 0.03 + along * by, out))
    };
    let contacts: Vec<Contact> = normals.iter().flat_map(side).collect();
    assert!(regulars(2, &contacts).iter().all(|body| body.misfit() > 4.0));
    // Two contacts say nothing about how many sides there are, one side nothing about the others.
    assert!(regulars(2, &contacts[1..3]).is_empty());
    let bare: Vec<Contact> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    assert!(regulars(2, &bare).is_empty());
    assert!(Body::regulars(2, &[], &Faces::fit(2, &contacts).unwrap()).is_empty());
    let same = vec![contacts[0]; 12];
    for dimension in [2, 3] {
        let usable = |body: &Body| body.value(&Point::x()).is_finite();
        assert!(regulars(dimension, &same).iter().all(usable));
    }
}
