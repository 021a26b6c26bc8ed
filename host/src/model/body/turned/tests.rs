use super::*;
use crate::model::body::tests::touch;
use crate::reference::Mean;
use proptest::prelude::*;

/// A cup standing on z, 80 mm high, 40 mm across at the bottom and 60 at the top, `long` times as long in x
/// and as short in y: felt around its side at so many places, and so often on each end.
pub(crate) fn cup(long: f64, side: i32, ends: [i32; 2]) -> Vec<Contact> {
    let stretch = |p: Point| Point::new(p.x * long, p.y / long, p.z);
    let mut contacts = Vec::new();
    for i in 0..side {
        let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
        let z = -0.038 + 0.076 * (f64::from(i) + 0.5) / f64::from(side);
        let radius = 0.025 + 0.125 * z;
        let normal = Point::new(cos / long, sin * long, -0.125).normalize();
        contacts.push(touch(stretch(Point::new(radius * cos, radius * sin, z)), normal));
    }
    for (end, count) in [1.0, -1.0].into_iter().zip(ends) {
        for i in 0..count {
            let (sin, cos) = (1.1 * f64::from(i)).sin_cos();
            let point = Point::new(0.012 * cos, 0.012 * sin, 0.04 * end);
            contacts.push(touch(stretch(point), Point::z() * end));
        }
    }
    contacts
}

/// 100 mm across and 50 high, the tip at the origin.
fn cone() -> Vec<Contact> {
    let side = |i: i32| {
        let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
        let down = 0.05 * ((f64::from(i) + 0.5) / 14.0).sqrt();
        touch(Point::new(down * cos, down * sin, -down), Point::new(cos, sin, 1.0).normalize())
    };
    let bottom = |i: i32| touch(Point::new(0.02, 0.01 * f64::from(i), -0.05), -Point::z());
    (0..14).map(side).chain((0..4).map(bottom)).collect()
}

fn turned(contacts: &[Contact], is_oval: bool) -> Body {
    Body::turned(3, contacts, &Faces::fit(3, contacts).unwrap(), is_oval).unwrap()
}

#[test]
fn few_contacts_find_a_cup() {
    let body = turned(&cup(1.0, 7, [1, 2]), false);
    assert!(body.misfit() < 0.1 && body.parts().len() == 3, "{body:?}");
    for i in 0..40 {
        let (sin, cos) = (0.7 * f64::from(i)).sin_cos();
        let z = -0.038 + 0.0019 * f64::from(i);
        let out = Point::new(cos, sin, 0.0) * (0.025 + 0.125 * z) + Point::z() * z;
        assert!(body.value(&out).abs() < 1e-3, "{out:?} {}", body.value(&out));
    }
    for p in [Point::z() * 0.04, Point::z() * -0.04] {
        assert!(body.value(&p).abs() < 1e-3);
    }
}

#[test]
fn an_oval_cup_is_not_round() {
    let contacts = cup(1.3, 10, [2, 2]);
    let oval = turned(&contacts, true);
    assert!(oval.misfit() < 0.2, "{}", oval.misfit());
    assert!(turned(&contacts, false).misfit() > 2.0);
    let corner = Point::new(1.3 * 0.03, 0.0, 0.039);
    assert!(oval.value(&corner).abs() < 2e-3, "{}", oval.value(&corner));
    // What is round is also an oval.
    assert!(turned(&cup(1.0, 10, [2, 2]), true).misfit() < 0.1);
}

#[test]
fn a_wide_cone_keeps_its_tip() {
    let body = turned(&cone(), false);
    // The last was felt 9 mm below it.
    let top = (0..100).rev().map(|i| Point::z() * (-0.02 + 3e-4 * f64::from(i)));
    let top = top.clone().find(|p| body.value(p) < 0.0).unwrap_or_default().z;
    assert!((-0.006..1e-3).contains(&top), "{top}");
}

#[test]
fn an_end_that_nobody_felt_lies_beyond_the_contacts_and_is_in_doubt() {
    let body = turned(&cup(1.0, 12, [0, 2]), false);
    let last = Point::z() * 0.035;
    assert!(body.value(&last) < -1e-3);
    assert!(body.value(&(Point::z() * 0.06)) > 0.0);
    let doubt = |p: &Point| body.modes(p).iter().map(|m| m.0 * m.0).sum::<f64>().sqrt();
    assert!(doubt(&(Point::z() * 0.05)) > 1e-3);
    // Less where many would have found more of it.
    let body = turned(&cup(1.0, 60, [0, 2]), false);
    let top = |p: &Point| body.modes(p).last().map_or(f64::NAN, |mode| mode.0.abs());
    assert!((1e-4..3e-3).contains(&top(&(Point::z() * 0.05))));
}

#[test]
fn what_is_oval_ends_where_what_is_round_and_as_large_does() {
    let problem = Problem::of(3, &cone()).unwrap();
    let round = Turned { axis: Point::z(), ends: [false, true], is_oval: false };
    let numbers = round.begun(problem.felt()).parameters().clone();
    let end = |turned: Turned, numbers: DVector<f64>| {
        let body = problem.body(&Fit::begun(Round::Turned(turned), numbers.clone())).unwrap();
        let ended = turned.ended(body, &numbers, &problem);
        ended.planes().last().unwrap()
    };
    let expected = end(round, numbers.clone());
    let oval = Turned { is_oval: true, ..round };
    for longer in [0.2_f64, 0.5, 1.0] {
        // As many times as long in one direction as short in the other, and as pointed.
        let mut stretched = DVector::zeros(oval.count());
        stretched.rows_mut(0, numbers.len()).copy_from(&numbers);
        stretched[INVERSE] *= longer.cosh();
        stretched[WIDENING] /= longer.cosh();
        stretched[numbers.len()] = numbers[INVERSE] * longer.sinh();
        let found = end(oval, stretched);
        assert!(found.normal.z > 0.999 && expected.normal.z > 0.999);
        assert!((found.offset - expected.offset).abs() < 1e-9, "{longer} {found:?} {expected:?}");
    }
}

#[test]
fn contacts_place_it_to_first_order() {
    for (contacts, ends) in [(cup(1.0, 40, [2, 2]), [true, true]), (cone(), [false, true])] {
        // On one side only, the ball about them is not in the middle.
        let is_flat = |c: &Contact| c.normal.is_some_and(|n| n.z.abs() > 0.9);
        let half = contacts.iter().filter(|c| c.point.x > 0.0 || is_flat(c)).copied();
        let problem = Problem::of(3, &half.collect::<Vec<Contact>>()).unwrap();
        let turned = Turned { axis: Point::z(), ends, is_oval: false };
        let body = problem.body(&turned.begun(problem.felt())).unwrap();
        for c in &contacts {
            let off = body.value(&c.point);
            assert!(off.abs() < 1e-3, "{:?} {off}", c.point);
        }
    }
}

#[test]
fn ends_turn_with_the_side() {
    let body = turned(&cup(1.0, 12, [2, 2]), false);
    let count = body.modes(&Point::zeros()).len();
    for mode in 0..count {
        let mut by = vec![0.0; count];
        by[mode] = 0.2;
        let moved = body.moved(&by, &Point::zeros()).unwrap();
        let mut axes = moved.parts().iter().map(|part| match part {
            Part::Quadric(side) => side.taper().normalize(),
            Part::Plane(end) => end.normal,
            _ => panic!("{part:?}"),
        });
        let side = axes.next().unwrap();
        assert!(axes.all(|end| end.dot(&side).abs() > 0.9999), "{mode}");
    }
}

#[test]
fn what_is_no_turned_body_is_none() {
    let contacts = cup(1.0, 12, [2, 2]);
    let faces = Faces::fit(3, &contacts).unwrap();
    assert_eq!(Body::turned(2, &contacts, &faces, false), None);
    assert_eq!(Body::turned(3, &[], &faces, false), None);
    // Two numbers for each of six parameters, and fewer.
    assert!(Body::turned(3, &contacts[..4], &faces, false).is_some());
    assert_eq!(Body::turned(3, &contacts[..3], &faces, false), None);
    // The same place a dozen times, and no normals at all.
    for strange in [vec![contacts[0]; 12], contacts.iter().map(bare).collect()] {
        for is_oval in [false, true] {
            let body = Body::turned(3, &strange, &faces, is_oval);
            assert!(body.is_none_or(|body| body.value(&Point::x()).is_finite()));
        }
    }
}

fn bare(contact: &Contact) -> Contact {
    Contact { normal: None, ..*contact }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Wherever the object is, whatever its size and however it is turned.
    #[test]
    fn a_cup_is_found_anywhere(
        axis in prop::array::uniform3(-2f64..2.0),
        away in prop::array::uniform3(-1f64..1.0),
        size in 0.1f64..10.0,
    ) {
        let turn = nalgebra::Rotation3::new(Point::from(axis));
        let place = |p: Point| turn * p * size + Point::from(away);
        let contacts: Vec<Contact> = cup(1.2, 14, [2, 2])
            .iter()
            .map(|c| Contact {
                point: place(c.point),
                normal: c.normal.map(|n| turn * n),
                point_deviation: c.point_deviation * size,
                ..*c
            })
            .collect();
        let body = turned(&contacts, true);
        prop_assert!(body.misfit() < 0.2, "{}", body.misfit());
        let rim = place(Point::new(0.0, 0.03 / 1.2, 0.04));
        prop_assert!(body.value(&rim).abs() < 2e-3 * size, "{}", body.value(&rim));
    }
}
