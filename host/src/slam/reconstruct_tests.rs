use super::*;
use crate::sim::{Options, Touch, simulate};
use crate::slam::fit::tests::touched;
use crate::slam::sift::tests::hausdorff;

/// Contacts of a ball of 80 mm that felt no normals, one of them so far outside.
fn bare_ball(outside: f64) -> Vec<Contact> {
    let options = Options {
        touch: Touch::Uniform,
        grasps: Some(1),
        contacts: 100,
        seed: 4,
        ..Options::new("sphere:0.08".parse().unwrap())
    };
    let log = simulate(&options).unwrap().log;
    let to_object = log.grasps[0].truth.unwrap().inverse();
    let point = |p: &Point| (to_object * nalgebra::Point3::from(*p)).coords;
    let contacts = log.grasps[0].contacts.iter().enumerate().map(|(i, c)| Contact {
        point: point(&c.point) * if i == 30 { 1.0 + outside / 0.04 } else { 1.0 },
        normal: None,
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    });
    contacts.collect()
}

#[test]
fn a_wild_contact_without_a_normal_makes_no_bump() {
    let reach = |outside: f64| {
        let contacts = bare_ball(outside);
        let shape = shape(3, &contacts, &[], Poses::Known, Choice::Auto, &|_, _| {}).unwrap();
        let vertices = shape.geometry.vertices();
        vertices.iter().map(|v| (v.norm() - 0.04).abs()).fold(0.0, f64::max)
    };
    assert!(reach(0.0) < 1.5e-3 && reach(8e-3) < 1.5e-3, "{} {}", reach(0.0), reach(8e-3));
}

#[test]
fn many_contacts_leave_as_open_what_nobody_touched_as_few_do() {
    let touch = |i: i32| {
        let (sin, cos) = (f64::from(i) / 801.0 * std::f64::consts::PI).sin_cos();
        let normal = Point::new(cos, sin, 0.0);
        let point = 0.04 * normal;
        Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.0873 }
    };
    let contacts: Vec<Contact> = (0..801).map(touch).collect();
    // A finger that felt nothing just below the middle.
    let free = [Free { point: Point::new(0.0, -0.01, 0.0), deviation: 1e-3 }];
    assert!(!is_dense(2, &contacts));
    let whole = shape(2, &contacts, &free, Poses::Estimated, Choice::Gp, &|_, _| {}).unwrap();
    let (_, experts) = fit_experts(2, &contacts).unwrap();
    let (_, own) = extract(2, &experts, &contacts).unwrap();
    let doubt = open_beside(2, &contacts, &free).unwrap();
    let doubted = doubt.widened(&whole.geometry.vertices(), &own);
    let open = Open::of(&contacts);
    let places = whole.geometry.vertices().into_iter().zip(whole.geometry.normals());
    let open: Vec<f64> = places.map(|(vertex, normal)| open.deviation(&vertex, &normal)).collect();
    // The flat side of the half circle looks a way that no contact does.
    assert!(open.contains(&0.0) && open.iter().any(|open| *open > 0.01));
    let expected: Vec<f64> = doubted.iter().zip(&open).map(|(a, b)| a.hypot(*b)).collect();
    assert!(whole.deviations.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12));
    let farthest = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
    assert!(farthest(&whole.deviations) > 1.05 * farthest(&own), "{}", farthest(&own));
}

#[test]
fn free_points_in_more_doubt_than_contacts_say_nothing_of_faces() {
    let contacts = bare_ball(0.0);
    let free = |millimetres: f64| Free { point: Point::x(), deviation: 1e-3 * millimetres };
    let count = |times: f64, free: &[Free]| {
        let doubt = |c: &Contact| Contact { point_deviation: times * c.point_deviation, ..*c };
        let contacts: Vec<Contact> = contacts.iter().map(doubt).collect();
        outside(&contacts, free).len()
    };
    assert_eq!(count(1.0, &[free(1.0), free(5.0)]), 1);
    // Where all poses are as doubtful, so are the contacts.
    assert_eq!(count(5.0, &[free(1.0), free(5.0)]), 2);
    assert!(outside(&[], &[free(5.0)]).len() == 1);
}

#[test]
fn a_block_with_rough_sides_needs_no_images() {
    let object = "box:0.09x0.06x0.04";
    for seed in [1, 2, 5] {
        let (_, contacts, _) = touched(object, 20, seed);
        // As scanned cartons are: a third of the normals is off.
        let rough = |(i, c): (usize, &Contact)| {
            let lean = Point::new(0.0, 0.22, 0.18) * f64::from(u8::from(i % 3 == 0));
            Contact { normal: c.normal.map(|normal| (normal + lean).normalize()), ..*c }
        };
        let contacts: Vec<Contact> = contacts.iter().enumerate().map(rough).collect();
        let made = shape(3, &contacts, &[], Poses::Known, Choice::Auto, &|_, _| {}).unwrap();
        assert!(Mirrored::of(3, &contacts).is_some() && made.mirrors.is_empty(), "{seed}");
        // With images, up to three times as much.
        let error = hausdorff(&made.geometry, object);
        assert!(error < 4e-3, "{seed}: {error}");
    }
}
