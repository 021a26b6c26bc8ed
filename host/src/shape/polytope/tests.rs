use super::*;
use nalgebra::Rotation3;
use proptest::prelude::*;

const ELL: [[f64; 2]; 6] =
    [[0.0, 0.0], [80.0, 0.0], [80.0, 30.0], [30.0, 30.0], [30.0, 90.0], [0.0, 90.0]];
const TEE: [[f64; 2]; 8] = [
    [-10.0, -50.0],
    [10.0, -50.0],
    [10.0, 10.0],
    [50.0, 10.0],
    [50.0, 30.0],
    [-50.0, 30.0],
    [-50.0, 10.0],
    [-10.0, 10.0],
];
const RECTANGLE: [[f64; 2]; 4] = [[-60.0, -30.0], [60.0, -30.0], [60.0, 30.0], [-60.0, 30.0]];

fn contact(point: Point, normal: Point) -> Contact {
    Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.05 }
}

/// Exact contacts every 6 mm or so along a polygon (counter-clockwise, millimetres).
fn along(corners: &[[f64; 2]]) -> Vec<Contact> {
    let corner = |i: usize| {
        let [x, y] = corners[i % corners.len()];
        Point::new(x, y, 0.0) * 1e-3
    };
    let mut contacts = Vec::new();
    for i in 0..corners.len() {
        let (a, side) = (corner(i), corner(i + 1) - corner(i));
        let normal = Point::new(side.y, -side.x, 0.0).normalize();
        let count = (side.norm() / 6e-3) as usize;
        for k in 0..count {
            contacts.push(contact(a + side * ((k as f64 + 0.5) / count as f64), normal));
        }
    }
    contacts
}

/// The same polygon from z = 0 to `height`, and what `inside` says of its caps.
fn prism(corners: &[[f64; 2]], height: f64, inside: impl Fn(f64, f64) -> bool) -> Vec<Contact> {
    let mut contacts = Vec::new();
    for c in along(corners) {
        for k in 0..3 {
            let up = Point::z() * (height * (0.2 + 0.3 * f64::from(k)));
            contacts.push(Contact { point: c.point + up, ..c });
        }
    }
    for i in 0..14 {
        for j in 0..14 {
            let (x, y) = (-0.06 + 0.012 * f64::from(i), -0.06 + 0.012 * f64::from(j));
            if inside(x + 1e-4, y + 1e-4) {
                contacts.push(contact(Point::new(x, y, height), Point::z()));
                contacts.push(contact(Point::new(x, y, 0.0), -Point::z()));
            }
        }
    }
    contacts
}

fn shape(dimension: usize, contacts: &[Contact], closing: bool) -> Option<Polytope> {
    let faces = Faces::fit(dimension, contacts)?;
    let closing = if closing { closures(&faces, contacts, COUNTERPART) } else { vec![] };
    assemble(&faces, contacts, &[], &closing)
}

fn planar(polytope: &Polytope) -> &crate::shape::Outline {
    let Geometry::Outline(outline) = &polytope.geometry else { panic!("a mesh in the plane") };
    outline
}

fn spatial(polytope: &Polytope) -> &crate::shape::Mesh {
    let Geometry::Mesh(mesh) = &polytope.geometry else { panic!("an outline in space") };
    mesh
}

#[test]
fn polygons_are_exact_whether_convex_or_not() {
    for (corners, area) in [(&RECTANGLE[..], 7200e-6), (&ELL, 4200e-6), (&TEE, 3200e-6)] {
        let polytope = shape(2, &along(corners), false).unwrap();
        let outline = planar(&polytope);
        assert_eq!(outline.loops.len(), 1);
        assert_eq!(outline.loops[0].len(), corners.len());
        assert!((outline.area() - area).abs() < 1e-9, "{}", outline.area());
        for v in &outline.loops[0] {
            let off = |c: &[f64; 2]| (v[0] - 1e-3 * c[0]).hypot(v[1] - 1e-3 * c[1]);
            assert!(corners.iter().map(off).fold(1.0, f64::min) < 1e-9);
        }
        assert!(polytope.deviations.len() == corners.len());
        assert!(polytope.deviations.iter().all(|d| (1e-4..2e-3).contains(d)));
    }
}

#[test]
fn solids_are_closed_and_exact_whether_convex_or_not() {
    let ell =
        |x: f64, y: f64| x > 0.0 && y > 0.0 && ((x < 0.08 && y < 0.03) || (x < 0.03 && y < 0.09));
    let cuboid = |x: f64, y: f64| x.abs() < 0.06 && y.abs() < 0.03;
    for (contacts, volume, corners) in [
        (prism(&RECTANGLE, 0.04, cuboid), 7200e-6 * 0.04, 8),
        (prism(&ELL, 0.04, ell), 4200e-6 * 0.04, 12),
    ] {
        let polytope = shape(3, &contacts, false).unwrap();
        let mesh = spatial(&polytope);
        assert!(mesh.is_watertight());
        assert!((mesh.volume() - volume).abs() < 1e-9, "{}", mesh.volume());
        assert_eq!(mesh.vertices().len(), corners);
        assert_eq!(mesh.triangles().len(), 2 * corners - 4);
        assert_eq!(polytope.deviations.len(), corners);
        assert!(contacts.iter().all(|c| mesh.distance(&c.point) < 1e-9));
    }
}

#[test]
fn sides_that_meet_in_one_point_are_closed() {
    for count in 3..9 {
        let turn = Rotation3::new(Point::new(0.3, -0.5, 0.2) * f64::from(count));
        let (tip, step) = (Point::new(0.0, 0.0, 0.1), std::f64::consts::TAU / f64::from(count));
        let corner = |k: i32| {
            let angle = step * f64::from(k);
            Point::new(angle.cos(), angle.sin(), 0.0) * 0.06
        };
        let mut contacts = Vec::new();
        for k in 0..count {
            let [a, b] = [corner(k), corner(k + 1)];
            let out = (b - a).cross(&(tip - a)).normalize();
            for [s, t] in [[0.2, 0.2], [0.6, 0.2], [0.2, 0.6], [0.35, 0.35], [0.1, 0.1]] {
                let side = contact(turn * (tip + (a - tip) * s + (b - tip) * t), turn * out);
                let base = contact(turn * (a * s + b * t), turn * -Point::z());
                contacts.extend([side, base]);
            }
        }
        let polytope = shape(3, &contacts, false).unwrap();
        let base = 0.5 * f64::from(count) * 0.06f64.powi(2) * step.sin();
        let volume = spatial(&polytope).volume();
        assert!((volume / (base * 0.1 / 3.0) - 1.0).abs() < 1e-6, "{count}: {volume}");
    }
}

#[test]
fn a_pillar_on_a_plate_has_a_hole_in_its_top() {
    // Both boxes' sides; the plate's top is a ring about the pillar.
    let mut contacts = Vec::new();
    for (half, low, high) in [(0.05, 0.0, 0.02), (0.02, 0.02, 0.07)] {
        for i in 0..4 {
            let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_2).sin_cos();
            let (n, t) = (Point::new(cos, sin, 0.0), Point::new(-sin, cos, 0.0));
            for k in -2..=2 {
                for z in [0.2, 0.5, 0.8] {
                    let up = Point::z() * (low + z * (high - low));
                    contacts.push(contact(n * half + t * (half * 0.4 * f64::from(k)) + up, n));
                }
                let along = t * (half * 0.4 * f64::from(k));
                contacts.push(contact(n * (0.7 * half) + along + Point::z() * high, Point::z()));
                contacts.push(contact(n * (0.7 * half) + along, -Point::z()));
            }
        }
    }
    let contacts: Vec<Contact> =
        contacts.into_iter().filter(|c| c.point.z > 0.0 || c.normal == Some(-Point::z())).collect();
    let polytope = shape(3, &contacts, false).unwrap();
    let mesh = spatial(&polytope);
    assert!(mesh.is_watertight());
    let volume = 0.1 * 0.1 * 0.02 + 0.04 * 0.04 * 0.05;
    assert!((mesh.volume() - volume).abs() < 1e-9, "{}", mesh.volume());
}

#[test]
fn an_open_side_is_closed_at_the_contacts_and_uncertain() {
    let open: Vec<Contact> =
        along(&RECTANGLE).into_iter().filter(|c| c.normal != Some(-Point::y())).collect();
    assert!(shape(2, &open, false).is_none());
    let polytope = shape(2, &open, true).unwrap();
    let lowest = open.iter().map(|c| c.point.y).fold(1.0, f64::min);
    assert!((planar(&polytope).bounds().0.y - lowest).abs() < 1e-9);
    let deviations =
        polytope.deviations(&[Point::new(0.0, lowest, 0.0), Point::new(0.0, 0.03, 0.0)]);
    assert!(deviations[0] > 0.01 && deviations[1] < 1e-3, "{deviations:?}");
}

#[test]
fn an_open_end_is_closed_though_another_face_looks_the_same_way() {
    // The left end of the crossbar; the stem's left side has the same normal.
    let open: Vec<Contact> = along(&TEE).into_iter().filter(|c| c.point.x > -0.0499).collect();
    assert!(shape(2, &open, false).is_none());
    let polytope = shape(2, &open, true).unwrap();
    let outermost = open.iter().map(|c| c.point.x).fold(1.0, f64::min);
    assert!((planar(&polytope).bounds().0.x - outermost).abs() < 1e-9);
    assert_eq!(planar(&polytope).loops[0].len(), 8);
}

#[test]
fn what_lies_behind_all_faces_needs_no_contact_on_each() {
    // Nobody touched the side that cuts a corner of the rectangle off.
    let contacts = along(&RECTANGLE);
    let mut faces = Faces::fit(2, &contacts).unwrap();
    let normal = Point::new(1.0, 1.0, 0.0).normalize();
    let offset = normal.dot(&Point::new(0.05, 0.03, 0.0));
    faces.faces.push(Face { normal, offset, centroid: normal * offset, ..faces.faces[0] });
    let cut = intersection(&faces, &contacts).unwrap();
    let exact = 0.12 * 0.06 - 0.5 * 0.01 * 0.01;
    assert!((planar(&cut).area() / exact - 1.0).abs() < 1e-9, "{}", planar(&cut).area());
    assert_eq!(cut.deviations.len(), 5);
    // The middle of the contacts lies before that one.
    faces.faces[4].offset = -1e-3;
    assert!(intersection(&faces, &contacts).is_none());
}

#[test]
fn contacts_are_off_the_sides_that_face_as_was_felt() {
    let rectangle = shape(2, &along(&RECTANGLE), false).unwrap();
    let off = |x: f64, y: f64, normal: Point| {
        rectangle.off(&contact(Point::new(x, y, 0.0) * 1e-3, normal))
    };
    // The side is known ten times better than a contact is.
    assert!(off(10.0, 30.0, Point::y()) < 0.1);
    assert!((2.8..3.0).contains(&off(10.0, 33.0, Point::y())));
    assert!((2.8..3.0).contains(&off(10.0, 27.0, Point::y())));
    // Where the side would be if it did not end.
    assert!(off(90.0, 30.0, Point::y()) > 20.0);
    assert!(off(10.0, 30.0, -Point::y()) > 40.0 && off(10.0, 30.0, Point::x()) > 40.0);
    let bare = Contact { normal: None, ..contact(Point::new(0.01, 0.03, 0.0), Point::y()) };
    assert!(rectangle.off(&bare) < 0.1);
    assert_eq!(rectangle.off(&contact(Point::y(), Point::y() * f64::NAN)), f64::INFINITY);
}

#[test]
fn points_known_to_be_outside_stay_outside() {
    // A U whose bottom was not touched from inside: the free point says that there is a gap.
    let corners = [
        [0.0, 0.0],
        [90.0, 0.0],
        [90.0, 60.0],
        [60.0, 60.0],
        [60.0, 30.0],
        [30.0, 30.0],
        [30.0, 60.0],
        [0.0, 60.0],
    ];
    let contacts = along(&corners);
    let faces = Faces::fit(2, &contacts).unwrap();
    let gap = Point::new(0.045, 0.05, 0.0);
    let polytope = assemble(&faces, &contacts, &[gap], &[]).unwrap();
    assert!(!planar(&polytope).contains(&gap));
    assert!((planar(&polytope).area() - 4500e-6).abs() < 1e-9);
}

#[test]
fn what_encloses_nothing_is_refused() {
    let one = [contact(Point::x() * 0.01, Point::x())];
    assert!(shape(2, &one, false).is_none() && shape(2, &one, true).is_none());
    let sheet = [one[0], contact(Point::x() * 0.01, -Point::x())];
    assert!(shape(3, &sheet, true).is_none());
    let far = [contact(Point::x() * f64::INFINITY, Point::x()), one[0]];
    let faces = Faces::fit(2, &one).unwrap();
    assert!(assemble(&faces, &far, &[], &[]).is_none());
    let collinear: Vec<Contact> =
        (0..9).map(|k| contact(Point::x() * (0.01 * f64::from(k)), Point::y())).collect();
    assert!(shape(2, &collinear, false).is_none());
}

#[test]
fn the_field_is_the_distance_and_each_face_has_its_own_deviation() {
    let polytope = shape(2, &along(&ELL), false).unwrap();
    let values = polytope.values(&[Point::new(0.01, 0.02, 0.0), Point::new(0.05, 0.04, 0.0)]);
    assert!((values[0] + 0.01).abs() < 1e-9 && (values[1] - 0.01).abs() < 1e-9, "{values:?}");
    let (plane, closest, distance) = polytope.nearest(&Point::new(0.05, 0.04, 0.0), None).unwrap();
    assert!(
        (distance - 0.01).abs() < 1e-9 && (closest - Point::new(0.05, 0.03, 0.0)).norm() < 1e-9
    );
    assert!((polytope.planes[plane].normal - Point::y()).norm() < 1e-9);
    // Contacts on it: 1 mm over the root of their number.
    let expected = 1e-3 / (polytope.planes[plane].contacts as f64).sqrt();
    let found = polytope.deviations(&[polytope.planes[plane].centroid])[0];
    assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
}

proptest! {
    /// Tangent planes of a sphere, well spread or not: where they make a shape, its mesh is closed and
    /// outward, and every vertex lies on three planes.
    #[test]
    fn whatever_comes_out_is_closed_and_sharp(
        normals in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 4..14),
    ) {
        let normals = normals.into_iter().filter_map(|n| Point::from(n).try_normalize(0.1));
        let contacts: Vec<Contact> = normals.map(|n| contact(n * 0.05, n)).collect();
        let Some(faces) = Faces::fit(3, &contacts) else { return Ok(()) };
        for closing in [vec![], closures(&faces, &contacts, COUNTERPART)] {
            let Some(polytope) = assemble(&faces, &contacts, &[], &closing) else { continue };
            let mesh = spatial(&polytope);
            prop_assert!(mesh.is_watertight() && mesh.volume() > 0.0);
            for v in mesh.vertices() {
                let on = polytope.planes.iter().filter(|f| f.value(v).abs() < 1e-9).count();
                prop_assert!(on >= 3);
            }
            prop_assert_eq!(polytope.deviations.len(), mesh.vertices().len());
            prop_assert!(polytope.deviations.iter().all(|d| d.is_finite() && *d > 0.0));
        }
    }
}
