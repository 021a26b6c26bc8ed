use super::*;
use crate::sim::{Options, Touch, simulate};
use crate::slam::place::place;
use crate::slam::track;
use crate::space::{Bridge, Pose, planar};
use nalgebra::{Translation3, UnitQuaternion};
use tactile_core::contact::Contact as CoreContact;
use tactile_core::space::{Planar, Space, Spatial};
use tactile_core::surface::{Faces as CoreFaces, Map, Surface};

/// Contacts drawn uniformly, 1 mm and 5°, in the object frame.
pub(crate) fn touched(object: &str, contacts: usize, seed: u64) -> (usize, Vec<Contact>) {
    let spec: crate::sim::ObjectSpec = object.parse().unwrap();
    let options =
        Options { grasps: Some(1), contacts, touch: Touch::Uniform, seed, ..Options::new(spec) };
    let log = simulate(&options).unwrap().log;
    let steps = track::truth(&log).unwrap();
    (log.dimension, place(&log, &steps).iter().map(|p| p.contact).collect())
}

fn moved(contacts: &[Contact], pose: &Pose) -> Vec<Contact> {
    contacts.iter().map(|c| c.transformed(pose)).collect()
}

#[test]
fn polytopes_fit_as_noise_says_and_curves_do_not() {
    for (object, contacts, sides) in
        [("rectangle:0.12x0.06", 20, 4), ("hexagon:0.045", 40, 6), ("box:0.12x0.06x0.06", 80, 6)]
    {
        let (mut per_degree, mut exact) = (0.0, 0);
        for seed in 0..20 {
            let (dimension, contacts) = touched(object, contacts, seed);
            let faces = Faces::fit(dimension, &contacts).unwrap();
            per_degree += faces.chi_squared / faces.degrees / 20.0;
            exact += usize::from(faces.faces.len() == sides);
            assert!(faces.is_convex(), "{object} {seed}: {}", faces.protrusion);
            assert!(faces.bending < 4.5, "{object} {seed}: {}", faces.bending);
        }
        assert!((0.85..1.15).contains(&per_degree), "{object}: {per_degree}");
        // Now and then a contact is so far off that it stays alone.
        assert!(exact >= 14, "{object}: {exact}");
    }
    for (object, contacts) in
        [("ellipse:0.12x0.06", 30), ("cylinder:0.06x0.1", 80), ("sphere:0.08", 60)]
    {
        let curved = (0..20).filter(|seed| {
            let (dimension, contacts) = touched(object, contacts, *seed);
            Faces::fit(dimension, &contacts).unwrap().bending > 2.5
        });
        assert!(curved.count() >= 15, "{object}");
    }
}

#[test]
fn a_side_stays_one_however_often_it_is_felt() {
    for (object, contacts, sides) in
        [("rectangle:0.12x0.06", 160, 4), ("box:0.1x0.07x0.05", 240, 6)]
    {
        let often = |seed: &u64| {
            let (dimension, contacts) = touched(object, contacts, *seed);
            let faces = Faces::fit(dimension, &contacts).unwrap().faces;
            faces.iter().filter(|face| face.contacts > 2).count() == sides
        };
        let exact = (0..10).filter(often).count();
        assert!(exact >= 9, "{object}: {exact}");
    }
}

#[test]
fn contacts_are_hard_to_tell_apart_only_where_they_lie_among_each_other() {
    // Two planes 1 mm apart, of contacts at these places.
    let plane = |height: f64, places: &mut dyn Iterator<Item = usize>, dimension: usize| {
        let contact = |i: usize| {
            let across = if dimension == 2 { 0.0 } else { 5e-3 * ((i * 7) % 10) as f64 };
            let point = if dimension == 2 {
                Point::new(1e-3 * i as f64, height, 0.0)
            } else {
                Point::new(1e-3 * i as f64, across, height)
            };
            let contact =
                Contact { point, normal: None, point_deviation: 1e-3, normal_deviation: 0.1 };
            let normal = if dimension == 2 { Point::y() } else { Point::z() };
            Moments::of(&contact, normal)
        };
        places.map(contact).reduce(|sum, m| sum.plus(&m)).unwrap()
    };
    for (dimension, normal) in [(2, Point::y()), (3, Point::z())] {
        let cost =
            |parts: [Moments; 2]| mixed(&parts, &parts[0].plus(&parts[1]), &normal, dimension);
        let among = cost([
            plane(0.0, &mut (0..60).step_by(2), dimension),
            plane(1e-3, &mut (1..60).step_by(2), dimension),
        ]);
        // One bit for each of sixty contacts.
        assert!((among - 120.0 * 2.0f64.ln()).abs() < 4.0, "{dimension}: {among}");
        let beside =
            cost([plane(0.0, &mut (0..30), dimension), plane(1e-3, &mut (30..60), dimension)]);
        assert!(beside < 4.0, "{dimension}: {beside}");
        let apart =
            cost([plane(0.0, &mut (0..30), dimension), plane(1e-3, &mut (90..120), dimension)]);
        assert_eq!(apart, 0.0);
        let one =
            cost([plane(0.0, &mut (0..60), dimension), plane(1e-3, &mut (20..21), dimension)]);
        assert_eq!(one, 0.0);
    }
}

#[test]
fn contacts_on_a_line_of_two_sides_are_two_faces() {
    // A thin plate pinched along one straight line.
    let contact = |i: usize| Contact {
        point: Point::new(0.3, 0.1, 0.2) * (0.01 * (i / 2) as f64),
        normal: Some(Point::new(-0.1, 0.3, 0.0).normalize() * [1.0, -1.0][i % 2]),
        point_deviation: 1e-3,
        normal_deviation: 0.1,
    };
    let contacts: Vec<Contact> = (0..40).map(contact).collect();
    let faces = Faces::fit(3, &contacts).unwrap().faces;
    assert_eq!(faces.iter().map(|face| face.contacts).collect::<Vec<_>>(), [20, 20]);
}

#[test]
fn frame_and_order_do_not_matter() {
    for (object, pose) in [
        ("rectangle:0.12x0.06", planar(0.3, -0.2, 0.7)),
        (
            "box:0.12x0.06x0.06",
            Pose::from_parts(
                Translation3::new(0.1, -0.3, 0.2),
                UnitQuaternion::from_euler_angles(0.3, -0.8, 2.0),
            ),
        ),
    ] {
        let (dimension, contacts) = touched(object, 40, 7);
        let here = Faces::fit(dimension, &contacts).unwrap();
        let mut there = moved(&contacts, &pose);
        there.reverse();
        let there = Faces::fit(dimension, &there).unwrap();
        assert_eq!(here.faces.len(), there.faces.len());
        assert!((here.chi_squared - there.chi_squared).abs() < 1e-6);
        for k in 0..20 {
            let p = contacts[k].point * 1.1;
            let (a, fa) = here.active(&p).unwrap();
            let moved = (pose * nalgebra::Point3::from(p)).coords;
            let (b, fb) = there.active(&moved).unwrap();
            assert!((a - b).abs() < 1e-9);
            assert!((fa.variance(&p) / fb.variance(&moved) - 1.0).abs() < 1e-6);
        }
    }
}

fn core_faces<S: Space + Bridge>(contacts: &[Contact]) -> CoreFaces<S, 16> {
    let mut faces = CoreFaces::new();
    for c in contacts {
        let _ = faces.insert(&CoreContact {
            point: S::vector(&c.point),
            normal: c.normal.map(|n| S::vector(&n)),
            point_deviation: c.point_deviation as f32,
            normal_deviation: c.normal_deviation as f32,
            finger: 0,
        });
    }
    faces
}

/// The board's faces, learnt one contact at a time in single precision, against these.
fn core_agrees<S: Space + Bridge>(object: &str, contacts: usize) {
    let mut same = 0;
    for seed in 0..20 {
        let (dimension, contacts) = touched(object, contacts, seed);
        let host = Faces::fit(dimension, &contacts).unwrap();
        let core = core_faces::<S>(&contacts);
        // Now and then they give a contact near an edge to different faces.
        if core.faces().len() != host.faces.len()
            || (f64::from(core.chi_squared()) - host.chi_squared).abs() > 0.05
        {
            continue;
        }
        same += 1;
        assert_eq!(f64::from(core.degrees()), host.degrees);
        for c in &contacts {
            for p in [c.point, c.point * 1.2, c.point * 0.3] {
                let (value, face) = host.active(&p).unwrap();
                let probe = core.probe(S::vector(&p));
                assert!((f64::from(probe.value) - value).abs() < 2e-5, "{object} {seed}");
                let runner_up = host.faces.iter().map(|f| f.value(&p));
                if runner_up.filter(|v| (v - value).abs() < 1e-4).count() == 1 {
                    let ratio = f64::from(probe.variance) / face.variance(&p);
                    assert!((ratio - 1.0).abs() < 0.02, "{object} {seed}: {ratio}");
                }
            }
        }
    }
    assert!(same >= 16, "{object}: {same}");
}

#[test]
fn the_core_finds_the_same_faces() {
    core_agrees::<Planar>("rectangle:0.12x0.06", 30);
    core_agrees::<Planar>("triangle:0.06", 20);
    core_agrees::<Spatial>("box:0.12x0.06x0.06", 60);
}

#[test]
fn degenerate_contacts_have_an_answer() {
    let contact = |x: f64, y: f64, normal: Option<Point>| Contact {
        point: Point::new(x, y, 0.0),
        normal,
        point_deviation: 1e-4,
        normal_deviation: 0.0087,
    };
    let up = Some(Point::new(0.0, 1.0, 0.0));
    assert!(Faces::fit(2, &[]).is_none());
    assert!(Faces::fit(2, &[contact(0.0, 0.0, None)]).is_none());
    let one = Faces::fit(2, &[contact(0.0, 0.0, up)]).unwrap();
    assert_eq!((one.faces.len(), one.degrees, one.chi_squared), (1, 0.0, 0.0));
    // The same contact again and again, and the same point from both sides.
    let many = Faces::fit(3, &[contact(0.01, 0.0, up); 50]).unwrap();
    assert_eq!(many.faces.len(), 1);
    let sheet = Faces::fit(2, &[contact(0.0, 0.0, up), contact(0.0, 0.0, up.map(|n| -n))]);
    assert_eq!(sheet.unwrap().faces.len(), 2);
}

#[test]
fn a_side_that_nobody_felt_takes_no_measured_number() {
    let (dimension, contacts) = touched("rectangle:0.12x0.06", 20, 0);
    let felt = Faces::fit(dimension, &contacts).unwrap();
    let unfelt = Face { contacts: 0, ..felt.faces[0] };
    let faces = [&felt.faces[..], &[unfelt]].concat();
    let all = Faces::explaining(dimension, &contacts, faces, felt.owners.clone());
    assert_eq!((all.degrees, all.chi_squared), (felt.degrees, felt.chi_squared));
}

/// Contacts of a rectangle 120 × 60 mm: three on every side, and on two of its corners with normals
/// anywhere between those of the sides.
fn with_corners() -> Vec<Contact> {
    let contact = |x: f64, y: f64, degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Contact {
            point: Point::new(x, y, 0.0) * 1e-3,
            normal: Some(Point::new(cos, sin, 0.0)),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    };
    let mut contacts = Vec::new();
    for (k, off) in [(-0.6, 0.4), (0.0, -0.5), (0.7, 0.2)] {
        contacts.push(contact(60.0 + off, 30.0 * k, 4.0 * off));
        contacts.push(contact(-60.0 + off, 30.0 * k, 180.0 - 5.0 * off));
        contacts.push(contact(60.0 * k, 30.0 + off, 90.0 + 6.0 * off));
        contacts.push(contact(60.0 * k, -30.0 - off, 270.0 - 3.0 * off));
    }
    for degrees in [25.0, 47.0, 60.0] {
        contacts.push(contact(60.3, 29.5, degrees));
        contacts.push(contact(-59.8, -30.2, 180.0 + degrees));
    }
    contacts
}

#[test]
fn contacts_on_edges_make_no_faces_of_their_own() {
    let contacts = with_corners();
    let raw = Faces::fit(2, &contacts).unwrap();
    assert!(raw.faces.len() > 4);
    let faces = raw.simplified(&contacts);
    assert_eq!(faces.faces.len(), 4);
    assert!(faces.owners[12..].iter().all(|o| matches!(o, Some(Owner::Edge(_)))));
    assert!(faces.owners[..12].iter().all(|o| matches!(o, Some(Owner::Face(_)))));
    assert!(faces.chi_squared / faces.degrees < 1.4);
    assert_eq!(faces.degrees, 2.0 * 18.0 - 8.0);
}

#[test]
fn bare_contacts_refine_the_face_they_lie_on() {
    let mut contacts = with_corners();
    for k in -4..=4 {
        contacts.push(Contact {
            point: Point::new(0.01 * f64::from(k), 0.0302, 0.0),
            normal: None,
            ..contacts[0]
        });
    }
    // Off every face.
    contacts.push(Contact { point: Point::new(0.0, 0.01, 0.0), normal: None, ..contacts[0] });
    let faces = Faces::fit(2, &contacts).unwrap().simplified(&contacts);
    assert_eq!(faces.faces.len(), 4);
    assert_eq!(faces.owners.last(), Some(&None));
    let top = faces.faces.iter().find(|f| f.normal.y > 0.9).unwrap();
    assert_eq!(top.contacts, 12);
    assert!((top.offset - 0.0302).abs() < 3e-4);
}

#[test]
fn nearly_square_faces_become_square_and_others_do_not() {
    let contacts = with_corners();
    let free = Faces::fit(2, &contacts).unwrap().simplified(&contacts);
    let faces = free.regular(&contacts);
    for (i, a) in faces.faces.iter().enumerate() {
        for b in &faces.faces[..i] {
            let cosine = a.normal.dot(&b.normal).abs();
            assert!(!(1e-3..0.9999).contains(&cosine), "{cosine}");
        }
    }
    // All sides tell the angle: the normals are better known, and χ² says that they agree.
    let doubt = |f: &Faces| f.faces.iter().map(|f| f.normal_covariance.trace()).sum::<f64>();
    assert!(doubt(&faces) < 0.5 * doubt(&free));
    assert!(faces.chi_squared < free.chi_squared + 9.0 && faces.degrees == free.degrees + 3.0);
    // Three angles known to a degree or two of the half turn they might be; the other three follow.
    assert!((6.0..15.0).contains(&faces.order) && free.order == 0.0, "{}", faces.order);

    let (dimension, contacts) = touched("triangle:0.06", 40, 1003);
    let free = Faces::fit(dimension, &contacts).unwrap().simplified(&contacts);
    let faces = free.regular(&contacts);
    assert_eq!((faces.chi_squared, faces.order), (free.chi_squared, 0.0));
}

#[test]
fn contacts_that_cannot_be_used_change_nothing() {
    let contacts = with_corners();
    let clean = Faces::fit(2, &contacts).unwrap().simplified(&contacts);
    let good = contacts[3];
    let mut with = contacts.clone();
    with.extend([
        Contact { point: Point::new(f64::NAN, 0.0, 0.0), ..good },
        Contact { point: Point::new(0.0, f64::INFINITY, 0.0), normal: None, ..good },
        Contact { normal: Some(Point::new(f64::NAN, 1.0, 0.0)), ..good },
        Contact { normal: Some(Point::zeros()), ..good },
        Contact { point_deviation: 0.0, ..good },
        Contact { normal_deviation: f64::NAN, ..good },
    ]);
    let faces = Faces::fit(2, &with).unwrap().simplified(&with);
    assert_eq!(faces.faces.len(), clean.faces.len());
    assert_eq!(faces.owners[..contacts.len()], clean.owners[..]);
    assert!(faces.owners[contacts.len()..].iter().all(Option::is_none));
    assert_eq!(faces.chi_squared, clean.chi_squared);
    assert!(Faces::fit(2, &with[contacts.len()..]).is_none());
}
