use super::*;
use crate::slam::reconstruct::{Poses, shape};

/// `each` contacts spread over every side of a polygon (counter-clockwise, millimetres), from a
/// tenth to nine tenths of it, off by up to half a millimetre.
fn along(corners: &[[f64; 2]], each: usize) -> Vec<Contact> {
    let corner = |i: usize| {
        let [x, y] = corners[i % corners.len()];
        Point::new(x, y, 0.0) * 1e-3
    };
    let mut contacts = Vec::new();
    for i in 0..corners.len() {
        let (a, side) = (corner(i), corner(i + 1) - corner(i));
        let normal = Point::new(side.y, -side.x, 0.0).normalize();
        for k in 0..each {
            let share = 0.1 + 0.8 * k as f64 / (each - 1) as f64;
            let off = 5e-4 * (7.0 * contacts.len() as f64).sin();
            contacts.push(Contact {
                point: a + side * share + normal * off,
                normal: Some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.0873,
            });
        }
    }
    contacts
}

const RECTANGLE: [[f64; 2]; 4] = [[-60.0, -30.0], [60.0, -30.0], [60.0, 30.0], [-60.0, 30.0]];

#[test]
fn a_touched_rectangle_is_faces() {
    let (faces, polytope) = judge(2, &along(&RECTANGLE, 4), &[]).unwrap();
    assert_eq!(faces.faces.len(), 4);
    let Geometry::Outline(outline) = polytope.geometry else { panic!() };
    assert!((outline.area() - 0.0072).abs() < 1e-4);
}

#[test]
fn two_contacts_a_face_are_enough_of_a_hollow_object() {
    let l = [[0.0, 0.0], [90.0, 0.0], [90.0, 35.0], [35.0, 35.0], [35.0, 90.0], [0.0, 90.0]];
    let (_, polytope) = judge(2, &along(&l, 2), &[]).unwrap();
    let Geometry::Outline(outline) = polytope.geometry else { panic!() };
    assert!((outline.area() - 0.005_075).abs() < 2e-4, "{}", outline.area());
    let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
    let hexagon: Vec<[f64; 2]> = (0..6).map(|i| [45.0 * turn(i).1, 45.0 * turn(i).0]).collect();
    assert!(matches!(judge(2, &along(&hexagon, 2), &[]), Err(Refusal::Few { .. })));
}

#[test]
fn what_may_be_something_else_is_refused() {
    let contacts = along(&RECTANGLE, 4);
    assert!(matches!(judge(2, &contacts[..4], &[]), Err(Refusal::Open { .. })));
    let bare: Vec<_> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    assert_eq!(judge(2, &bare, &[]).unwrap_err(), Refusal::NoNormals);
    let vague: Vec<_> = contacts.iter().map(|c| Contact { normal_deviation: 0.3, ..*c }).collect();
    assert!(matches!(judge(2, &vague, &[]), Err(Refusal::Doubtful { .. })));
    let circle: Vec<[f64; 2]> = (0..36)
        .map(|i| (f64::from(i) * 10f64.to_radians()).sin_cos())
        .map(|(sin, cos)| [40.0 * cos, 40.0 * sin])
        .collect();
    assert!(judge(2, &along(&circle, 2), &[]).is_err());
}

/// The faces of all but the last `unknown` contacts, on which those do not lie.
fn all_but(unknown: usize, contacts: &[Contact]) -> Faces {
    let known = &contacts[..contacts.len() - unknown];
    let faces = fitted(2, known).unwrap();
    let owners = faces.owners.iter().copied().chain(std::iter::repeat_n(None, unknown));
    Faces { owners: owners.collect(), ..faces }
}

#[test]
fn contacts_on_no_side_are_left_out_where_sides_are_touched_often() {
    let wild = [(-0.01, 0.005, 0.3), (0.02, -0.012, 2.0), (0.03, 0.05, 4.0), (0.08, 0.0, 2.5)];
    let wild = wild.map(|(x, y, angle)| leaning(x, y, angle));
    for (each, left_out) in [(9, true), (3, false)] {
        let contacts = [along(&RECTANGLE, each), wild.to_vec()].concat();
        let faces = all_but(4, &contacts);
        let trusted = trusted(&faces, &contacts, &[]);
        // More than a fifth wild is another object.
        assert_eq!(trusted.iter().filter(|t| !**t).count(), if left_out { 4 } else { 0 });
        if left_out {
            let kept = only(&contacts, &trusted);
            assert_eq!(judge(2, &kept, &[]).unwrap().0.faces.len(), 4);
            let owners = only(&faces.owners, &trusted);
            let faces = Faces { owners, ..faces };
            let Geometry::Outline(outline) = known(&faces, &kept, &[]).unwrap().geometry else {
                panic!()
            };
            assert!((outline.area() - 0.0072).abs() < 1e-4);
        }
    }
}

#[test]
fn wild_contacts_that_make_a_side_between_them_are_left_out_too() {
    let wild = |x: f64, y: f64, normal: Point| Contact {
        point: Point::new(x, y, 0.0),
        normal: Some(normal),
        ..along(&RECTANGLE, 2)[0]
    };
    let alike = [wild(-0.02, 0.004, Point::y()), wild(0.015, 0.005, Point::y())];
    let single = [wild(0.03, 0.05, -Point::x()), wild(0.08, 0.0, -Point::y())];
    let contacts = [&along(&RECTANGLE, 11)[..], &alike, &single].concat();
    let faces = all_but(2, &contacts);
    assert_eq!(faces.faces.len(), 5);
    let trusted = trusted(&faces, &contacts, &[]);
    let expected: Vec<bool> = (0..48).map(|i| i < 44).collect();
    assert_eq!(trusted, expected);
}

/// A contact that faces along no side of a rectangle.
fn leaning(x: f64, y: f64, angle: f64) -> Contact {
    Contact {
        point: Point::new(x, y, 0.0),
        normal: Some(Point::new(angle.cos(), angle.sin(), 0.0)),
        ..along(&RECTANGLE, 2)[0]
    }
}

#[test]
fn an_end_touched_once_among_many_is_none_to_leave_out_beside_wild_contacts() {
    // The last side by one contact, the others by twelve each.
    let sides = along(&RECTANGLE, 12);
    let wild = [leaning(-0.01, 0.005, 0.7), leaning(0.02, -0.01, 4.0)];
    let contacts = [&sides[..36], &sides[41..42], &wild].concat();
    let faces = all_but(3, &contacts);
    assert_eq!(faces.faces.len(), 3);
    let trusted = trusted(&faces, &contacts, &[]);
    assert_eq!(trusted, (0..39).map(|i| i < 37).collect::<Vec<bool>>());
}

const ELL: [[f64; 2]; 6] =
    [[0.0, 0.0], [110.0, 0.0], [110.0, 25.0], [25.0, 25.0], [25.0, 80.0], [0.0, 80.0]];

/// Contacts on an L but for one of its inner sides, so that the others do not close.
fn open_ell() -> Vec<Contact> {
    let sides = along(&ELL, 11);
    [&sides[..33], &sides[44..]].concat()
}

#[test]
fn a_side_that_does_not_suit_the_others_is_not_wild_but_what_lies_on_none_is() {
    // Four contacts on the other inner side: as few as may be wild.
    let sides = open_ell();
    let few: Vec<Contact> = sides[22..33].iter().step_by(3).copied().collect();
    let sides = [&sides[..22], &few, &sides[33..]].concat();
    assert!(matches!(judge(2, &sides, &[]), Err(Refusal::Unexplained { .. })));
    let contacts = [&sides[..], &[leaning(0.01, 0.02, 0.7)]].concat();
    let trusted = trusted(&all_but(1, &contacts), &contacts, &[]);
    assert_eq!(trusted, (0..49).map(|i| i < 48).collect::<Vec<bool>>());
}

#[test]
fn an_inner_side_that_nobody_felt_is_found_among_boxes_less_smaller_ones() {
    let made = shape(2, &open_ell(), &[], Poses::Known, Choice::Auto, &|_, _| {}).unwrap();
    let Geometry::Outline(outline) = made.geometry else { panic!() };
    assert_eq!(outline.loops[0].len(), 6);
    let near = |corner: &[f64; 2]| {
        let away = |v: &[f64; 2]| (v[0] - 1e-3 * corner[0]).hypot(v[1] - 1e-3 * corner[1]);
        outline.loops[0].iter().map(away).fold(f64::INFINITY, f64::min)
    };
    for (number, corner) in ELL.iter().enumerate() {
        let most = if (3..5).contains(&number) { 0.02 } else { 2e-3 };
        assert!(near(corner) < most, "{number} {}", near(corner));
    }
}

#[test]
fn a_side_touched_once_is_none_to_leave_out() {
    // The last side by one contact, the others by four each.
    let mut contacts = along(&RECTANGLE, 4);
    contacts.truncate(13);
    let trusted = trusted(&all_but(1, &contacts), &contacts, &[]);
    assert_eq!(trusted, [true; 13]);
}

#[test]
fn an_untouched_side_is_closed_at_the_contacts() {
    // A hexagon without one side: its neighbours would meet far outside.
    let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
    let hexagon: Vec<[f64; 2]> = (0..6).map(|i| [45.0 * turn(i).1, 45.0 * turn(i).0]).collect();
    for corners in [&hexagon[..], &RECTANGLE] {
        let contacts = along(corners, 4);
        let (_, polytope) = judge(2, &contacts[..4 * (corners.len() - 1)], &[]).unwrap();
        let bounds =
            |points: &[[f64; 2]]| points.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
        let Geometry::Outline(outline) = &polytope.geometry else { panic!() };
        assert!(bounds(&outline.loops[0]) < 1.05e-3 * bounds(corners));
        assert!(polytope.deviations.iter().any(|d| *d > 3e-3));
    }
}

#[test]
fn a_roof_does_not_stand_for_the_wall_below_it() {
    // A house of which one wall was not touched: the roof would come down on the ground at 85 mm.
    let house = [[-40.0, -30.0], [40.0, -30.0], [40.0, 10.0], [0.0, 50.0], [-40.0, 10.0]];
    let (_, polytope) = judge(2, &along(&house, 4)[..16], &[]).unwrap();
    let Geometry::Outline(outline) = &polytope.geometry else { panic!() };
    let reach = outline.loops[0].iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
    assert!(reach < 0.06, "{reach}");
    // Of a few contacts hardly one would lie where none does.
    let few: Vec<Contact> = along(&house, 4).into_iter().take(16).step_by(2).collect();
    let wide = |contacts: &[Contact]| {
        let faces = fitted(2, contacts).unwrap();
        untouched(&assemble(&faces, contacts, &[], &[]).unwrap(), contacts)
    };
    let [many, few] = [wide(&along(&house, 4)[..16]), wide(&few)];
    assert!(many.expected > EXPECTED && few.expected < EXPECTED, "{many:?} {few:?}");
    assert!((many.expected / many.distance / (few.expected / few.distance) - 2.0).abs() < 0.2);
}

#[test]
fn a_face_of_one_contact_does_not_stand_for_a_side() {
    // Three sides of a rectangle, and a finger on the edge between one of them and the fourth.
    let mut contacts = along(&RECTANGLE, 4);
    contacts.truncate(12);
    assert!(judge(2, &contacts, &[]).is_ok());
    let point = Point::new(-0.06, -0.03, 0.0);
    let normal = Some(Point::new(-1.0, -1.0, 0.0).normalize());
    contacts.push(Contact { point, normal, ..contacts[0] });
    let refusal = judge(2, &contacts, &[]).unwrap_err();
    assert!(matches!(refusal, Refusal::Lone { lone: 1, contacts: 13 }), "{refusal}");
}

#[test]
fn exact_contacts_on_a_not_quite_exact_object_get_slack() {
    // Said to be exact to 0.1 mm, and off by 0.35 mm either way.
    let exact = |(i, c): (usize, Contact)| {
        let off = if i % 2 == 0 { 3.5e-4 } else { -3.5e-4 };
        let point = c.point + c.normal.unwrap_or_default() * off;
        Contact { point, point_deviation: 1e-4, normal_deviation: 0.0175, ..c }
    };
    let contacts: Vec<Contact> = along(&RECTANGLE, 4).into_iter().enumerate().map(exact).collect();
    assert!(examine(2, &contacts, &[]).is_err());
    let (faces, polytope) = judge(2, &contacts, &[]).unwrap();
    assert_eq!(faces.faces.len(), 4);
    assert!(polytope.deviations.iter().all(|d| *d > 1e-4));
}

#[test]
fn exact_contacts_that_got_slack_are_not_wild_without_it() {
    // Said to be exact to 0.1 mm and 1°, which one in the middle of each side is not to 0.7 mm and 6°.
    let each = 11;
    let exact = |(i, c): (usize, Contact)| {
        let normal = c.normal.unwrap_or_default();
        let on = c.point - normal * (5e-4 * (7.0 * i as f64).sin());
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let is_off = i % each == each / 2;
        let (off, turn) = if is_off { (7e-4, 0.105 * sign) } else { (5e-5 * sign, 0.0) };
        let across = Point::new(-normal.y, normal.x, 0.0);
        Contact {
            point: on + normal * off,
            normal: Some((normal + across * turn).normalize()),
            point_deviation: 1e-4,
            normal_deviation: 0.0175,
        }
    };
    let contacts: Vec<Contact> =
        along(&RECTANGLE, each).into_iter().enumerate().map(exact).collect();
    assert!(examine(2, &contacts, &[]).is_err());
    let ((faces, polytope), slack) = judged(2, &contacts, &[]).unwrap();
    assert!(slack.iter().all(|c| c.point_deviation > 2.9e-4));
    let Geometry::Outline(outline) = polytope.geometry else { panic!() };
    assert!((outline.area() - 0.0072).abs() < 1e-4, "{}", outline.area());
    assert_eq!(trusted(&faces, &contacts, &[]), [true; 44]);
    assert!(known(&faces, &contacts, &[]).is_some());
}

#[test]
fn where_every_contact_makes_its_own_face_is_curved() {
    let circle: Vec<[f64; 2]> = (0..12)
        .map(|i| (f64::from(i) * 30f64.to_radians() + 0.2).sin_cos())
        .map(|(sin, cos)| [60.0 * cos, 40.0 * sin])
        .collect();
    let contacts: Vec<Contact> = along(&circle, 2).into_iter().step_by(2).collect();
    let refusal = judge(2, &contacts, &[]).unwrap_err();
    assert!(matches!(refusal, Refusal::Lone { lone, contacts: 12 } if lone > 1), "{refusal}");
}

#[test]
fn a_concavity_is_never_hidden() {
    let tee = [
        [-10.0, -50.0],
        [10.0, -50.0],
        [10.0, 10.0],
        [50.0, 10.0],
        [50.0, 30.0],
        [-50.0, 30.0],
        [-50.0, 10.0],
        [-10.0, 10.0],
    ];
    let ell = [[0.0, 0.0], [80.0, 0.0], [80.0, 30.0], [30.0, 30.0], [30.0, 90.0], [0.0, 90.0]];
    for (corners, area) in [(&tee[..], 3200e-6), (&ell[..], 4200e-6)] {
        let contacts = along(corners, 4);
        let (faces, polytope) = judge(2, &contacts, &[]).unwrap();
        assert!(!faces.is_convex());
        let Geometry::Outline(outline) = polytope.geometry else { panic!() };
        assert!((outline.area() / area - 1.0).abs() < 0.06, "{}", outline.area());
        for c in &contacts {
            assert!(outline.distance(&c.point) < 3e-3);
        }
    }
}

#[test]
fn very_exact_contacts_need_not_fit_as_exactly() {
    let usual = along(&RECTANGLE, 5);
    let exact = |c: &Contact| Contact { normal_deviation: 0.01, ..*c };
    let exact: Vec<Contact> = usual.iter().map(exact).collect();
    assert!(fit(1.3, &usual) && !fit(1.5, &usual) && !fit(f64::NAN, &usual));
    assert!(fit(1.5, &exact) && !fit(13.0, &exact));
    // Nobody knows how exact none are.
    assert!(!fit(1.5, &[]));
}
