use super::folded::Folded;
use super::*;
use crate::shape::Geometry;
use crate::shape::polytope;
use proptest::prelude::*;

const OPEN: Span = [f64::NEG_INFINITY, f64::INFINITY];

/// A box of 100 × 80 (× 60) mm from the origin, less these.
fn solid(dimension: usize, notches: &[[Span; 3]]) -> Notched {
    Notched {
        dimension,
        frame: Rotation3::identity(),
        middle: Point::zeros(),
        outer: [[0.0, 0.1], [0.0, 0.08], [0.0, 0.06]],
        notches: notches.iter().map(|spans| Notch { spans: *spans }).collect(),
    }
}

fn above(at: f64) -> Span {
    [at, f64::INFINITY]
}

fn below_of(at: f64) -> Span {
    [f64::NEG_INFINITY, at]
}

/// Contacts on the sides of what has these corners in millimetres, counter-clockwise, at these shares of each, in
/// turn a little inside and outside, turned.
fn felt(corners: &[[f64; 2]], shares: &[&[f64]], turn: f64) -> Vec<Contact> {
    let place = Rotation3::from_axis_angle(&Point::z_axis(), turn);
    let corner = |i: usize| {
        Point::new(corners[i % corners.len()][0], corners[i % corners.len()][1], 0.0) * 1e-3
    };
    let mut contacts: Vec<Contact> = Vec::new();
    for (i, shares) in shares.iter().enumerate() {
        let (from, side) = (corner(i), corner(i + 1) - corner(i));
        let normal = Point::new(side.y, -side.x, 0.0).normalize();
        for share in *shares {
            let off = 5e-4 * (7.0 * contacts.len() as f64).sin();
            let lean = Rotation3::from_axis_angle(
                &Point::z_axis(),
                0.08 * (5.0 * contacts.len() as f64).sin(),
            );
            contacts.push(Contact {
                point: place * (from + side * *share + normal * off),
                normal: Some(place * lean * normal),
                point_deviation: 1e-3,
                normal_deviation: 0.0873,
            });
        }
    }
    contacts
}

const ELL: [[f64; 2]; 6] =
    [[0.0, 0.0], [90.0, 0.0], [90.0, 35.0], [35.0, 35.0], [35.0, 90.0], [0.0, 90.0]];

#[test]
fn surfaces_are_as_large_as_they_are() {
    let area =
        |solid: &Notched| solid.facets().map(|all| all.iter().map(|f| solid.area(f)).sum::<f64>());
    let corner = [above(0.06), above(0.05), OPEN];
    let pocket = [[0.03, 0.06], above(0.05), OPEN];
    for (solid, expected) in [
        (solid(2, &[]), 0.36),
        (solid(2, &[corner]), 0.36),
        (solid(2, &[pocket]), 0.42),
        (solid(2, &[corner, [below_of(0.02), below_of(0.03), OPEN]]), 0.36),
        (solid(3, &[]), 2.0 * (0.008 + 0.006 + 0.0048)),
        (solid(3, &[corner]), 2.0 * (0.008 - 0.0012) + 0.36 * 0.06),
        (solid(3, &[[above(0.06), above(0.05), above(0.04)]]), 2.0 * (0.008 + 0.006 + 0.0048)),
    ] {
        let area = area(&solid).unwrap();
        assert!((area - expected).abs() < 1e-12, "{solid:?} {area} {expected}");
    }
}

#[test]
fn what_is_none_has_no_surface() {
    for notches in [
        // In pieces, or all along one side.
        vec![[[0.03, 0.06], OPEN, OPEN]],
        vec![[below_of(0.05), below_of(0.05), OPEN], [above(0.05), above(0.04), OPEN]],
        vec![[above(0.06), OPEN, OPEN]],
        // Outside, too thin, and in another.
        vec![[above(0.11), above(0.05), OPEN]],
        vec![[above(0.0999), above(0.05), OPEN]],
        vec![[[0.05, 0.051], above(0.05), OPEN]],
        vec![[[0.06, 0.03], above(0.05), OPEN]],
        vec![[above(0.05), above(0.04), OPEN], [above(0.06), above(0.05), OPEN]],
        vec![[above(f64::NAN), above(0.05), OPEN]],
    ] {
        assert!(solid(2, &notches).facets().is_none(), "{notches:?}");
    }
    assert!(solid(2, &[]).moved(Side { notch: None, axis: 0, end: 1 }, -0.1).facets().is_none());
}

proptest! {
    /// Just inside of every facet is inside, just outside is not, whatever is cut out of what.
    #[test]
    fn facets_are_where_inside_ends(
        cuts in proptest::collection::vec((0.01..0.09f64, 0.01..0.07f64, 0.01..0.05f64, 0..8usize, 0..4usize), 0..4),
        turn in -3.0..3.0f64,
    ) {
        let notch = |&(x, y, z, corner, through): &(f64, f64, f64, usize, usize)| {
            let mut spans = [OPEN; 3];
            for (axis, at) in [x, y, z].into_iter().enumerate().filter(|(axis, _)| *axis != through) {
                spans[axis] = if corner >> axis & 1 == 0 { below_of(at) } else { above(at) };
            }
            spans
        };
        let notches: Vec<[Span; 3]> = cuts.iter().map(notch).collect();
        let frame = Rotation3::from_euler_angles(turn, 0.5 * turn, 0.3);
        let solid = Notched { frame, middle: Point::new(0.3, 0.1, 0.2), ..solid(3, &notches) };
        for facet in solid.facets().into_iter().flatten() {
            let mut middle = Point::from_fn(|axis, _| 0.5 * (facet.spans[axis][0] + facet.spans[axis][1]));
            for (off, inside) in [(-1e-9, true), (1e-9, false)] {
                middle[facet.side.axis] = facet.at + facet.side.sign() * off;
                let point = solid.frame.inverse() * middle + solid.middle;
                prop_assert_eq!(solid.contains(&point), inside, "{:?}", facet);
            }
        }
    }
}

/// One of 100 × 80 × 60 mm with notches in the part above its mirrors, at shares of the part's sides.
fn folded(dimension: usize, notches: &[([f64; 3], usize, usize)], mirrored: [bool; 3]) -> Folded {
    let mut folded = Folded::of(&solid(dimension, &[]));
    for axis in (0..dimension).filter(|axis| mirrored[*axis]) {
        folded = folded.toggled(axis, false);
    }
    for (shares, corner, through) in notches {
        let mut spans = [OPEN; 3];
        for axis in (0..dimension).filter(|axis| axis != through) {
            let at = folded.part.outer[axis][0] + shares[axis] * folded.part.size(axis);
            spans[axis] = if corner >> axis & 1 == 0 { below_of(at) } else { above(at) };
        }
        folded.part.notches.push(Notch { spans });
    }
    folded
}

proptest! {
    /// What the part says of the whole is what the whole says itself.
    #[test]
    fn a_part_says_all_of_what_is_its_own_image(
        dimension in 2..4usize,
        cuts in proptest::collection::vec(([0.2..0.8f64, 0.2..0.8f64, 0.2..0.8f64], 0..8usize, 0..4usize), 0..3),
        mirrors in 0..8usize,
        at in proptest::collection::vec([-0.01..0.11f64, -0.01..0.09f64, -0.01..0.07f64], 20),
    ) {
        let mirrored = [0, 1, 2].map(|axis| axis < dimension && mirrors >> axis & 1 == 1);
        let folded = folded(dimension, &cuts, mirrored);
        let whole = folded.whole();
        for p in &at {
            let p = Point::from(*p);
            prop_assert_eq!(folded.contains(&p), whole.contains(&p), "{} {:?}", p, whole);
        }
        let felt = |p: &[f64; 3], axis: usize, sign: f64| Felt {
            point: Point::from(*p),
            normal: Point::ith(axis, sign),
            deviations: (3e-3, 0.09),
        };
        let felt: Vec<Felt> = at.iter().enumerate()
            .map(|(i, p)| felt(p, i % dimension, if i % 4 < 2 { 1.0 } else { -1.0 })).collect();
        let own = folded.likelihood(&felt, &RARE, f64::NEG_INFINITY);
        let other = Folded::of(&whole).likelihood(&felt, &RARE, f64::NEG_INFINITY);
        prop_assert_eq!(own.is_some(), other.is_some());
        if let (Some(own), Some(other)) = (own, other) {
            prop_assert!((own - other).abs() < 1e-9, "{} {}", own, other);
            prop_assert_eq!(folded.likelihood(&felt, &RARE, own - 1e-9), Some(own));
            prop_assert_eq!(folded.likelihood(&felt, &RARE, own + 1e-9), None);
        }
    }

    /// A mirror taken away again leaves what there was.
    #[test]
    fn folding_is_undone_by_unfolding(
        cuts in proptest::collection::vec(([0.2..0.8f64, 0.2..0.8f64, 0.2..0.8f64], 0..8usize, 0..4usize), 0..3),
        mirrors in 0..8usize,
        axis in 0..3usize,
        is_over in 0..2usize,
    ) {
        let folded = folded(3, &cuts, [0, 1, 2].map(|axis| mirrors >> axis & 1 == 1));
        let again = folded.toggled(axis, is_over == 1).toggled(axis, is_over == 1);
        prop_assert_eq!(again.mirrored, folded.mirrored);
        let places = |f: &Folded| -> Vec<f64> {
            let all = f.part.notches.iter().map(|notch| &notch.spans).chain([&f.part.outer]);
            all.flatten().flatten().copied().collect()
        };
        for (a, b) in places(&again).into_iter().zip(places(&folded)) {
            prop_assert!(a == b || (a - b).abs() < 1e-12, "{:?} {:?}", again, folded);
        }
    }
}

#[test]
fn without_contacts_boxes_are_as_usual_as_is_said_before_any() {
    let start = solid(2, &[]);
    let mut chains = chain::Chains::of(&[], &[], RARE, &start);
    let mut replica = chains.replica(&start, 1.0).unwrap();
    // Notches none and one (at a corner, in a side), without a mirror and with one along x, and with both.
    let mut counts = [[0.0; 3]; 3];
    for _ in 0..400_000 {
        chains.step(&mut replica);
        let part = &replica.solid.part;
        let kind = match part.notches[..] {
            [] => 0,
            [notch] => {
                let pocket =
                    notch.spans.iter().any(|span| span[0].is_finite() && span[1].is_finite());
                1 + usize::from(pocket)
            }
            _ => continue,
        };
        match replica.solid.mirrored[..2] {
            [false, false] => counts[0][kind] += 1.0,
            [true, false] => counts[1][kind] += 1.0,
            [true, true] => counts[2][kind] += 1.0,
            _ => (),
        }
    }
    // A side is anywhere in the part, but leaves LEAST of the whole at either end: the share of places that do.
    let one = |parts: f64| 1.0 - 2.0 * LEAST * parts;
    let two = |parts: f64| 0.5 * (1.0 - 3.0 * LEAST * parts).powi(2);
    for (counts, [x, y]) in counts.iter().zip([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]]) {
        let none = counts[0];
        let corner = 2.0 * 0.75 * one(x) * one(y);
        let pocket = 2.0 * 0.25 * 0.5 * (two(x) * one(y) + one(x) * two(y));
        assert!((0.9..1.1).contains(&(counts[1] / none / corner)), "{counts:?} {corner}");
        assert!((0.8..1.25).contains(&(counts[2] / none / pocket)), "{counts:?} {pocket}");
    }
    for (mirrors, other) in [(1, counts[1][0]), (2, counts[2][0])] {
        let share = other / counts[0][0] / chain::MIRRORED.powi(mirrors);
        // The chain is rarely in two mirrors, and long: twenty million steps put these at 1.00 and 1.00.
        assert!((0.75..1.3).contains(&share), "{mirrors} {counts:?}");
    }
}

#[test]
fn six_of_seven_boxes_have_notches_before_any_contact() {
    // Poisson's shares of none to four, two being usual, are as 3, 6, 6, 4 and 2.
    assert!((moves::notched_before() - 18.0 / 21.0).abs() < 1e-12);
}

#[test]
fn an_l_is_found_from_eight_contacts() {
    // Nobody felt where an arm ends: the faces do not close there.
    let shares: [&[f64]; 6] = [&[0.2, 0.9], &[], &[0.3, 0.8], &[0.5], &[0.5], &[0.3, 0.6]];
    let contacts = felt(&ELL, &shares, 0.4);
    let found = Found::of(2, &contacts, &[]).unwrap();
    let place = Rotation3::from_axis_angle(&Point::z_axis(), 0.4);
    for ([x, y], inside) in [
        ([0.03, 0.08], true),
        ([0.08, 0.03], true),
        ([0.04, 0.04], false),
        ([0.02, 0.02], true),
        ([0.06, 0.06], false),
        ([0.04, 0.085], false),
    ] {
        assert_eq!(found.solid.contains(&(place * Point::new(x, y, 0.0))), inside, "{x} {y}");
    }
    let shape = polytope::solid(&found.faces, &contacts, |p| found.solid.contains(p)).unwrap();
    let Geometry::Outline(outline) = &shape.geometry else { panic!() };
    assert_eq!((outline.loops.len(), outline.loops[0].len()), (1, 6));
    // The end lies beyond the last contact, in doubt; the others are known.
    let end = (0..6).find(|i| found.faces.faces[*i].contacts == 0).unwrap();
    let face = &found.faces.faces[end];
    assert!(
        (0.081..0.115).contains(&face.offset)
            && (3e-3..0.03).contains(&face.offset_variance.sqrt()),
        "{face:?}"
    );
    // Two of each contact, less the places of five sides and a turn.
    assert_eq!(found::degrees(&found.faces), 16.0 - 6.0);
    for (i, other) in found.faces.faces.iter().enumerate().filter(|(i, _)| *i != end) {
        assert!(other.offset_variance.sqrt() < 1.2e-3, "{i} {other:?}");
    }
    let corners = outline.loops[0].iter().map(|c| Point::new(c[0], c[1], 0.0));
    let near = |corner: &[f64; 2]| {
        let corner = place * Point::new(corner[0], corner[1], 0.0) * 1e-3;
        corners.clone().map(|c| (c - corner).norm()).fold(f64::INFINITY, f64::min)
    };
    for corner in [ELL[0], ELL[3], ELL[4], ELL[5]] {
        assert!(near(&corner) < 2e-3, "{corner:?} {}", near(&corner));
    }
}

#[test]
fn an_end_that_nobody_felt_is_as_far_as_so_many_contacts_leave_it() {
    // A rectangle 60 wide, felt at three sides up to 70 mm: each millimetre more is two of outline, among which n
    // contacts fell short of it with probability (outline/(outline + 2))ⁿ.
    let corners = [[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]];
    let contacts = felt(&corners, &[&[0.1, 0.3, 0.7], &[], &[0.35, 0.5, 0.8], &[0.3, 0.8]], 0.0);
    let start = found::begun(2, &contacts).unwrap().0;
    let samples = chain::Chains::of(&contacts, &[], RARE, &start).samples(&start);
    let axis = (start.frame * Point::x()).iamax();
    let end = usize::from((start.frame * Point::x())[axis] > 0.0);
    let boxes: Vec<&Notched> = samples.iter().filter(|s| s.notches.is_empty()).collect();
    assert!(2 * boxes.len() > samples.len(), "{}", boxes.len());
    let beyond = |s: &&Notched| {
        let last = contacts.iter().map(|c| (s.frame * (c.point - s.middle))[axis]);
        let last = last.map(|at| if end == 1 { at } else { -at }).fold(f64::NEG_INFINITY, f64::max);
        (if end == 1 { s.outer[axis][1] } else { -s.outer[axis][0] }) - last
    };
    let mean = boxes.iter().map(beyond).sum::<f64>() / boxes.len() as f64;
    let rate = 8.0 * 2.0 / (2.0 * (0.07 + 0.06 + mean));
    assert!((0.6..1.4).contains(&(mean * rate)), "{mean} {rate}");
}

#[test]
fn nothing_is_in_a_free_point() {
    let shares: [&[f64]; 6] = [&[0.2, 0.7], &[], &[0.3, 0.8], &[0.5], &[0.5], &[0.3, 0.6]];
    let contacts = felt(&ELL, &shares, 0.0);
    let free = Point::new(0.079, 0.02, 0.0);
    assert!(Found::of(2, &contacts, &[]).unwrap().solid.contains(&free));
    assert!(!Found::of(2, &contacts, &[free]).unwrap().solid.contains(&free));
}

#[test]
fn what_is_convex_or_leans_is_none() {
    let rectangle = [[0.0, 0.0], [120.0, 0.0], [120.0, 60.0], [0.0, 60.0]];
    assert!(Found::of(2, &felt(&rectangle, &[&[0.2, 0.6][..]; 4], 0.2), &[]).is_none());
    let turn = |i: usize, of: f64| (i as f64 * std::f64::consts::TAU / of).sin_cos();
    let ngon = |n: usize| {
        (0..n).map(|i| [45.0 * turn(i, n as f64).1, 45.0 * turn(i, n as f64).0]).collect::<Vec<_>>()
    };
    for n in [3, 5, 6, 20] {
        assert!(
            Found::of(2, &felt(&ngon(n), &vec![&[0.3, 0.7][..]; n], 0.1), &[]).is_none(),
            "{n}"
        );
    }
}

#[test]
fn faces_say_as_much_where_each_was_felt_often() {
    for (shares, says_more) in [(&[0.2, 0.5, 0.8][..], true), (&[0.1, 0.3, 0.5, 0.7, 0.9], false)] {
        assert_eq!(Found::says_more(2, &felt(&ELL, &[shares; 6], 0.1)), says_more);
    }
    assert!(!Found::says_more(2, &[]));
}

#[test]
fn unusable_contacts_find_nothing() {
    let shares: [&[f64]; 6] = [&[0.2, 0.9], &[0.5], &[0.3, 0.8], &[0.5], &[0.5], &[0.3, 0.6]];
    let contacts = felt(&ELL, &shares, 0.0);
    for change in [
        |c: &Contact| Contact { normal: None, ..*c },
        |c: &Contact| Contact { point: Point::repeat(f64::NAN), ..*c },
        |c: &Contact| Contact { normal: Some(Point::zeros()), ..*c },
        |c: &Contact| Contact { point_deviation: 0.0, ..*c },
        |c: &Contact| Contact { normal_deviation: f64::INFINITY, ..*c },
    ] {
        let mut contacts = contacts.clone();
        contacts[3] = change(&contacts[3]);
        assert!(Found::of(2, &contacts, &[]).is_none());
        assert!(!Found::is_likelier(2, &contacts, &[], 0));
    }
    for dimension in [0, 1, 4] {
        assert!(Found::of(dimension, &contacts, &[]).is_none());
        assert!(!Found::is_likelier(dimension, &contacts, &[], 0));
    }
    for nothing in [&[][..], &[contacts[0]; 8]] {
        assert!(!Found::is_likelier(2, nothing, &[], 0) && !Found::is_likelier(3, nothing, &[], 0));
    }
    for few in 0..3 {
        assert!(Found::of(2, &contacts[..few], &[]).is_none());
        assert!(Found::of(3, &contacts[..few], &[]).is_none());
    }
    assert!(Found::of(2, &vec![contacts[0]; 8], &[]).is_none());
    assert!(Found::of(3, &vec![contacts[0]; 8], &[]).is_none());
}

#[test]
fn a_t_is_found_whose_other_shoulder_nobody_felt() {
    let corners = [
        [-15.0, 0.0],
        [15.0, 0.0],
        [15.0, 50.0],
        [50.0, 50.0],
        [50.0, 80.0],
        [-50.0, 80.0],
        [-50.0, 50.0],
        [-15.0, 50.0],
    ];
    let shares: [&[f64]; 8] =
        [&[0.5], &[0.2, 0.7], &[0.6], &[0.5], &[0.2, 0.5, 0.9], &[0.3], &[], &[0.4, 0.8]];
    let contacts = felt(&corners, &shares, 0.3);
    let found = Found::of(2, &contacts, &[]).unwrap();
    let place = Rotation3::from_axis_angle(&Point::z_axis(), 0.3);
    for ([x, y], inside) in [
        ([-0.03, 0.053], true),
        ([-0.03, 0.047], false),
        ([0.03, 0.053], true),
        ([0.03, 0.047], false),
        ([-0.012, 0.003], true),
        ([-0.018, 0.003], false),
    ] {
        assert_eq!(found.solid.contains(&(place * Point::new(x, y, 0.0))), inside, "{x} {y}");
    }
}

#[test]
fn axes_are_those_of_most_normals() {
    let normal_deviation = 0.09;
    let felt = |normal: [f64; 3]| Contact {
        point: Point::zeros(),
        normal: Some(Point::from(normal).normalize()),
        point_deviation: 1e-3,
        normal_deviation,
    };
    let along = [[1.0, 0.05, 0.0], [0.02, -1.0, 0.0], [-1.0, 0.0, 0.1], [0.0, 0.03, 1.0]];
    let askew = [[1.0, 1.0, 0.0], [0.3, 0.3, 1.0]];
    let contacts: Vec<Contact> = askew.into_iter().chain(along).map(felt).collect();
    let expected = [false, false, true, true, true, true];
    assert_eq!(axes::along_axes(3, &contacts), expected);
    let blind = Contact { normal: None, ..contacts[2] };
    assert_eq!(axes::along_axes(3, &[blind]), [false]);
    assert!(axes::along_axes(2, &[]).is_empty());
}
