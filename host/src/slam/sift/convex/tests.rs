use super::*;
use crate::shape::{align, metrics};
use crate::sim::ObjectSpec;
use crate::slam::choose::Choice;
use crate::slam::fit::tests::touched;
use crate::slam::reconstruct::{Poses, shape};
use crate::slam::sift::tests::with_wild;

#[test]
fn what_contradicts_a_convex_object_is_found_among_few_contacts() {
    for (object, few) in [
        ("rectangle:0.1x0.06", 16),
        ("hexagon:0.045", 16),
        ("ellipse:0.1x0.06", 20),
        ("sphere:0.06", 14),
        ("cylinder:0.06x0.1", 24),
        ("pyramid:0.06,ngon:5,0.04", 24),
        // No body has these sides.
        ("corners:-0.05x-0.03,0.06x-0.03,-0.05x0.05", 24),
    ] {
        let (mut found, mut lost) = (0, 0);
        for seed in 0..4 {
            let (dimension, contacts) = with_wild(object, few, seed);
            let trusted = beside_convex(dimension, &contacts, &[]).unwrap_or(vec![true; few]);
            found += usize::from(trusted.ends_with(&[false; 3]));
            lost += trusted[..few].iter().filter(|trusted| !**trusted).count();
        }
        // A wild one may face as a box's side does.
        assert!(found >= 3 && lost <= 2, "{object}: {found}, {lost}");
    }
}

#[test]
fn a_box_is_a_box_beside_wild_contacts() {
    let object = "box:0.11x0.075x0.055";
    for seed in 0..3 {
        let (dimension, contacts) = with_wild(object, 20, seed);
        let (poses, auto) = (Poses::Known, Choice::Auto);
        let made = shape(dimension, &contacts, &[], poses, auto, &|_, _| {}).unwrap();
        let truth = object.parse::<ObjectSpec>().unwrap().geometry().unwrap();
        let aligned = align::align(&made.geometry, &truth);
        let error = metrics::compare_at(&made.geometry, &aligned, &truth).unwrap().hausdorff;
        assert!(error < 5e-3, "{seed}: {error}");
    }
}

/// A contact at so many metres that is known as well as this one.
fn like(one: &Contact, x: f64, y: f64, normal: [f64; 2]) -> Contact {
    let normal = Some(Point::new(normal[0], normal[1], 0.0));
    Contact { point: Point::new(x, y, 0.0), normal, ..*one }
}

#[test]
fn what_faces_as_a_box_does_is_wild_where_other_sides_of_a_notch_would_have_been_felt() {
    let (dimension, own, _) = touched("rectangle:0.1x0.06", 20, 0);
    let left_out = |others: &[Contact]| {
        let trusted = beside_convex(dimension, &[&own, others].concat(), &[]);
        trusted
            .is_some_and(|trusted| trusted == [vec![true; 20], vec![false; others.len()]].concat())
    };
    let skew =
        [[-0.02, 0.8, 0.6], [-0.01, -0.6, 0.8]].map(|[x, a, b]| like(&own[0], x, 0.0, [a, b]));
    let square =
        [[-0.005, 1.0, 0.0], [-0.03, 0.0, -1.0]].map(|[x, a, b]| like(&own[0], x, 0.01, [a, b]));
    assert!(left_out(&skew));
    assert!(left_out(&square[..1]));
    assert!(left_out(&[skew, square].concat()));
}

#[test]
fn sides_of_a_notch_are_not_wild() {
    let (dimension, own, _) = touched("rectangle:0.1x0.06", 30, 0);
    let sides = [([0.03, 0.018], [1.0, 0.0]), ([0.042, 0.01], [0.0, 1.0])];
    let wild = [([-0.02, 0.0], [0.8, 0.6]), ([-0.01, 0.01], [-0.6, 0.8])];
    let others = [sides, wild].concat();
    let others: Vec<Contact> =
        others.into_iter().map(|([x, y], normal)| like(&own[0], x, y, normal)).collect();
    let trusted = beside_convex(dimension, &[&own, &others[..]].concat(), &[]);
    assert!(trusted.is_some_and(|trusted| trusted.ends_with(&[false; 4])));
    // Without contacts that lie in it.
    let is_in_notch = |c: &Contact| c.point.x > 0.03 && c.point.y > 0.01;
    let beside: Vec<Contact> = own.iter().filter(|c| !is_in_notch(c)).copied().collect();
    assert!(beside.len() >= 24 && beside.len() < 30);
    for felt in [&others[..1], &others[..2], &others[..]] {
        assert!(beside_convex(dimension, &[&beside, felt].concat(), &[]).is_none());
    }
}

#[test]
fn of_two_that_contradict_each_other_alone_the_one_goes_that_others_nearly_contradict() {
    let contact = |x: f64, y: f64, normal: [f64; 2]| Contact {
        point: Point::new(x, y, 0.0),
        normal: Some(Point::new(normal[0], normal[1], 0.0)),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    };
    let sides = [-1.0, 1.0].map(|way| {
        [-0.5, 0.6].map(|along| {
            [
                contact(0.05 * way, 0.03 * along, [way, 0.0]),
                contact(0.05 * along, 0.03 * way, [0.0, way]),
            ]
        })
    });
    let sides = sides.as_flattened().as_flattened();
    // Six millimetres beyond the upper side: 4.2 deviations of the contact beside it, two of the others.
    let wild = contact(0.0, 0.036, [0.0, 1.0]);
    let beside = contact(0.002, 0.03, [0.0, 1.0]);
    assert!(agreeing(&[sides, &[beside]].concat()).is_none());
    for (pair, expected) in [([beside, wild], [true, false]), ([wild, beside], [false, true])] {
        let found = agreeing(&[&pair[..], sides].concat());
        assert_eq!(found, Some([&expected[..], &[true; 8]].concat()));
    }
}

#[test]
fn of_many_contacts_as_large_a_part_of_each_kind_is_judged() {
    let (_, felt, _) = touched("rectangle:0.1x0.06", 20, 0);
    let own = felt.repeat(36);
    let sides = vec![like(&felt[0], 0.0, 0.0, [1.0, 0.0]); 80];
    let is_side = |c: &&Contact| c.point == Point::zeros();
    for (own, sides, askew, expected) in [
        (&own[..], &sides[..], 40, (72, 8, 4)),
        (&own[..], &sides[..1], 0, (79, 1, 0)),
        (&own[..77], &sides[..3], 2, (77, 3, 2)),
        (&own[..20], &sides[..3], 5, (20, 3, 5)),
    ] {
        let (few, known) = few(own, sides, askew);
        let along = few.iter().filter(is_side).count();
        assert_eq!((few.len() - along, along, known), expected);
    }
}

#[test]
fn a_side_that_two_contacts_felt_is_none_of_few_wild_ones() {
    for object in ["triangle:0.055", "corners:-0.05x-0.03,0.06x-0.03,-0.05x0.05"] {
        let (dimension, mut contacts, _) = touched(object, 24, 0);
        let normal = Some(Point::new(0.6, 0.8, 0.0));
        contacts.push(Contact { point: Point::zeros(), normal, ..contacts[0] });
        let trusted = beside_convex(dimension, &contacts, &[]).unwrap();
        assert!(!trusted[24] && trusted[..24].iter().filter(|t| !**t).count() <= 1, "{object}");
        let beside = Point::new(0.008, -0.006, 0.0);
        contacts.push(Contact { point: beside, normal, ..contacts[0] });
        assert!(beside_convex(dimension, &contacts, &[]).is_none(), "{object}");
    }
}

#[test]
fn objects_without_wild_contacts_keep_all() {
    for object in ["ellipse:0.1x0.06", "hexagon:0.045", "box:0.1x0.06x0.05", "sphere:0.06"] {
        for seed in 0..3 {
            let (dimension, contacts, _) = touched(object, 40, seed);
            assert!(beside_convex(dimension, &contacts, &[]).is_none(), "{object} {seed}");
        }
    }
    let hollow = ["lshape:0.09x0.09x0.035", "tshape:0.1x0.08x0.03"];
    for object in
        hollow.iter().chain(&["lshape:0.09x0.09x0.035x0.05", "tshape:0.09x0.09x0.03x0.05"])
    {
        for (seed, few) in [10, 15, 20, 40].into_iter().enumerate() {
            let (dimension, contacts, _) = touched(object, few, seed as u64);
            assert!(beside_convex(dimension, &contacts, &[]).is_none(), "{object} {few}");
        }
    }
}

#[test]
fn many_that_contradict_or_too_few_contacts_say_nothing() {
    let one_wild = |object: &str, few: usize| {
        let (dimension, contacts) = with_wild(object, few, 0);
        beside_convex(dimension, &contacts[..=few], &[])
    };
    let [box_, triangle] = ["box:0.11x0.075x0.055", "corners:-0.05x-0.03,0.06x-0.03,-0.05x0.05"];
    assert!(one_wild(box_, 8).is_none() && one_wild(box_, 20).is_some());
    assert!(one_wild(triangle, 5).is_none() && one_wild(triangle, 10).is_some());
    let (dimension, contacts) = with_wild(box_, 20, 0);
    let many = [&contacts[..20], &contacts[20..].repeat(3)].concat();
    assert!(beside_convex(dimension, &many, &[]).is_none());
    for few in [0, 1] {
        assert!(beside_convex(dimension, &contacts[..few], &[]).is_none());
    }
    // Contacts without normals contradict nothing.
    let bare: Vec<Contact> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    assert!(beside_convex(dimension, &bare, &[]).is_none());
}
