use super::*;
use crate::model::body::tests::{cup, square};
use crate::shape::Field;
use crate::sim::{ObjectSpec, Options, Touch, simulate};
use crate::slam::choose::{self, Choice, judge};
use crate::slam::reconstruct::Poses;
use crate::slam::{reconstruct, track};

/// Contacts drawn uniformly, 1 mm and 5°, and points of the true surface.
pub(crate) fn touched(
    object: &str,
    contacts: usize,
    seed: u64,
) -> (usize, Vec<Contact>, Vec<Point>) {
    touched_of(object, contacts, 0.0, seed)
}

/// The same of which such a share is wild.
pub(crate) fn touched_of(
    object: &str,
    contacts: usize,
    outliers: f64,
    seed: u64,
) -> (usize, Vec<Contact>, Vec<Point>) {
    let spec: ObjectSpec = object.parse().unwrap();
    let options = Options {
        grasps: Some(1),
        contacts,
        outliers,
        touch: Touch::Uniform,
        seed,
        ..Options::new(spec.clone())
    };
    let simulation = simulate(&options).unwrap();
    let steps = track::truth(&simulation.log).unwrap();
    let placed = crate::slam::place::place(&simulation.log, &steps);
    let truth = simulation.geometry.samples(200).into_iter().map(|s| s.0).collect();
    (spec.dimension(), placed.into_iter().map(|p| p.contact).collect(), truth)
}

/// Median over seeds of the root mean square of the field on the true surface, metres.
fn error(object: &str, contacts: usize) -> f64 {
    let one = |seed: u64| {
        let (dimension, contacts, truth) = touched(object, contacts, seed);
        let gpis = fit(dimension, &contacts, &[]).unwrap().surface;
        let squares: f64 = gpis.values(&truth).iter().map(|v| v * v).sum();
        (squares / truth.len() as f64).sqrt()
    };
    let mut errors: Vec<f64> = (3000..3005).map(one).collect();
    errors.sort_by(f64::total_cmp);
    errors[2]
}

#[test]
fn an_ellipse_is_known_from_ten_contacts() {
    let error = error("ellipse:0.1x0.05", 10);
    assert!(error < 1.5e-3, "{error}");
}

#[test]
fn five_contacts_say_more_than_a_ball() {
    for (object, most) in [("ellipse:0.1x0.05", 3e-3), ("rectangle:0.1x0.05", 8e-3)] {
        let error = error(object, 5);
        assert!(error < most, "{object} {error}");
    }
}

#[test]
fn planes_that_take_contacts_from_each_other_make_no_spear() {
    let (dimension, contacts, _) = touched_of("pyramid:0.0424,ngon:8,0.0623", 20, 0.1, 91);
    let surface = fit(dimension, &contacts, &[]).unwrap().surface;
    // It reaches 62 mm from its middle.
    let (count, golden) = (3000, 2.4);
    let about = |i: i32| {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        Point::new(z.mul_add(-z, 1.0).sqrt() * cos, z.mul_add(-z, 1.0).sqrt() * sin, z) * 0.14
    };
    let points: Vec<Point> = (0..count).map(about).collect();
    assert!(surface.values(&points).iter().all(|value| *value > 0.0));
}

#[test]
fn what_contacts_contradict_is_no_ball() {
    let gained = |seed: u64| {
        let (dimension, contacts, truth) = touched("lshape:0.1x0.08x0.03", 12, seed);
        let gpis = fit(dimension, &contacts, &[]).unwrap().surface;
        let ball = Body::ball(dimension, &contacts).unwrap();
        let ball = Candidate::new(dimension, &contacts, 0.05, ball, Search::default()).unwrap();
        let Found { kernel, noise, .. } = ball.found;
        let about = Model { kernel, body: ball.body, noise, evidence_per_contact: 0.0 };
        let about = about.surface(dimension, &contacts).unwrap();
        let error = |field: &dyn Field| field.values(&truth).iter().map(|v| v * v).sum::<f64>();
        error(&about) / error(&gpis)
    };
    let mut gained: Vec<f64> = (3000..3009).map(gained).collect();
    gained.sort_by(f64::total_cmp);
    assert!(gained[4] > 1.3, "{gained:?}");
}

/// Weights of the ball and of the likeliest other body, and whether one of those explains the contacts.
fn weighed(contacts: &[Contact]) -> (f64, f64, bool) {
    let candidates = candidates(2, contacts, contacts).unwrap();
    let weights = weights(&candidates, contacts.len());
    let other = weights[1..].iter().copied().fold(0.0, f64::max);
    (weights[0], other, candidates[1..].iter().any(Candidate::explains))
}

#[test]
fn a_body_that_explains_the_contacts_leaves_no_room_for_the_ball() {
    for seed in 3000..3005 {
        let (_, contacts, _) = touched("ellipse:0.1x0.05", 20, seed);
        let (ball, other, is_explained) = weighed(&contacts);
        assert!(is_explained && other == 1.0 && ball < NEGLIGIBLE, "{ball} {other}");
    }
}

#[test]
fn of_bodies_that_explain_contacts_alike_the_smaller_is_likelier() {
    let (dimension, contacts, _) = touched("rectangle:0.1x0.05", 12, 3000);
    let faces = Faces::fit(dimension, &contacts).unwrap();
    let of = |body: Body, size: Option<f64>| {
        let search = residual(dimension, &contacts);
        let candidate = Candidate::new(dimension, &contacts, 0.05, body, search).unwrap();
        Candidate { evidence: 0.0, size, ..candidate }
    };
    let block = || Body::block(dimension, &contacts, &faces).unwrap();
    let ball = Body::ball(dimension, &contacts).unwrap();
    assert!(explains(&block()) && !explains(&ball));
    // A ball that explains nothing is small for no reason; what has no size gains nothing by it.
    let sizes = [(block(), Some(0.36)), (block(), Some(0.3)), (block(), None), (ball, Some(0.1))];
    let mut all = sizes.map(|(body, size)| of(body, size));
    count_sizes(&contacts, &mut all);
    let larger = -(places::places(&contacts) as f64) * 1.2f64.ln();
    for (candidate, expected) in all.iter().zip([larger, 0.0, larger, 0.0]) {
        assert!((candidate.evidence - expected).abs() < 1e-9, "{} {expected}", candidate.evidence);
    }
    // Contacts of one side do not fall anywhere.
    let up = |c: &Contact| Contact { normal: Some(Point::new(0.3, 1.0, 0.0).normalize()), ..*c };
    let one_side: Vec<Contact> = contacts.iter().map(up).collect();
    let before: Vec<f64> = all.iter().map(|candidate| candidate.evidence).collect();
    count_sizes(&one_side, &mut all);
    assert!(all.iter().map(|candidate| candidate.evidence).eq(before));
    // Its sides are 0.3 m together.
    let size = Candidate::new(dimension, &contacts, 0.05, block(), residual(dimension, &contacts));
    assert!((size.unwrap().size.unwrap() - 0.3).abs() < 0.02);
}

#[test]
fn bodies_that_do_not_explain_the_contacts_share_with_the_ball() {
    // A disc with three lobes, which is neither a ball nor another quadric.
    let touch = |i: i32| {
        let angle = 0.3 + std::f64::consts::TAU / 8.0 * f64::from(i);
        let (radius, slope) = (0.05 + 5e-3 * (3.0 * angle).cos(), -0.015 * (3.0 * angle).sin());
        let (sin, cos) = angle.sin_cos();
        let normal = Point::new(radius * cos + slope * sin, radius * sin - slope * cos, 0.0);
        Contact {
            point: Point::new(radius * cos, radius * sin, 0.0),
            normal: Some(normal.normalize()),
            point_deviation: 3e-4,
            normal_deviation: 0.026,
        }
    };
    let contacts: Vec<Contact> = (0..8).map(touch).collect();
    let (ball, other, is_explained) = weighed(&contacts);
    assert!(!is_explained && ball == 1.0 && other > 0.1 && other < 0.9, "{ball} {other}");
}

#[test]
fn faces_of_a_can_are_no_prism_those_of_a_hexagon_equal_and_those_of_a_box_stay() {
    // What is simpler than the faces, how it is reported, and how many sides that has.
    for (object, contacts, seed, simple, sides) in [
        ("cylinder:0.08x0.06", 40, 1002, true, None),
        ("cylinder:0.08x0.06", 40, 1005, true, None),
        ("ellipse:0.1x0.05", 15, 1004, true, None),
        ("box:0.1x0.07x0.05", 20, 1000, false, Some(6)),
        ("corners:-0.04x-0.03,0.05x-0.03,-0.04x0.04", 15, 1000, false, Some(3)),
        ("hexagon:0.05", 40, 1001, true, Some(6)),
        ("prism:0.07,hexagon:0.045", 40, 1000, true, Some(8)),
        ("lshape:0.1x0.08x0.03", 60, 1000, false, Some(6)),
    ] {
        let (dimension, contacts, _) = touched(object, contacts, seed);
        // All of these contacts allow faces.
        let (faces, _) = judge(dimension, &contacts, &[]).unwrap();
        let simpler = simpler(dimension, &contacts, &faces);
        assert_eq!(simpler.is_some(), simple, "{object} {seed}");
        let auto = Choice::Auto;
        let made =
            reconstruct::shape(dimension, &contacts, &[], Poses::Known, auto, &|_, _| {}).unwrap();
        let made = match made.model {
            choose::Model::Gp(_) => None,
            choose::Model::Faces(polytope) => Some(polytope.planes.len()),
        };
        assert_eq!(made, sides, "{object} {seed}");
    }
}

#[test]
fn equal_sides_leave_open_what_is_free() {
    let (dimension, contacts, _) = touched("hexagon:0.05", 40, 1001);
    for (away, is_flat) in [(0.06, true), (0.02, false)] {
        let free = Free { point: Point::x() * away, deviation: 1e-3 };
        let auto = Choice::Auto;
        let made =
            reconstruct::shape(dimension, &contacts, &[free], Poses::Known, auto, &|_, _| {});
        assert_eq!(matches!(made.unwrap().model, choose::Model::Faces(_)), is_flat, "{away}");
    }
}

#[test]
fn bodies_settle_where_contacts_are() {
    let lean = 0.47;
    let upright = square(0.0);
    let faces = Faces::fit(2, &upright).unwrap();
    let (body, _) = Body::flat(2, &upright, &faces).unwrap();
    let contacts = square(lean);
    let search = residual(2, &contacts);
    let settled = Candidate::new(2, &contacts, 0.04, body, search).unwrap();
    let right = settled.body.parts().iter().find_map(|part| match part {
        Part::Plane(plane) if plane.normal.x > 0.5 => Some(-plane.normal.y / plane.normal.x),
        _ => None,
    });
    assert!((right.unwrap() - lean).abs() < 0.03, "{right:?}");
}

#[test]
fn a_can_is_known_from_thirty_contacts() {
    let error = error("cylinder:0.05x0.08", 30);
    assert!(error < 1.8e-3, "{error}");
}

#[test]
fn a_cup_is_known_from_ten_contacts() {
    let surface = fit(3, &cup(1.0, 7, [1, 2]), &[]).unwrap().surface;
    let side: Vec<Point> = cup(1.0, 100, [0, 0]).into_iter().map(|c| c.point).collect();
    let worst = surface.values(&side).into_iter().fold(0.0, |most, v| v.abs().max(most));
    assert!(worst < 1e-3, "{worst}");
}

#[test]
fn a_body_that_contacts_move_has_no_other_sheet() {
    // Boxes whose superquadric is a little off: its sizes and turns must not grow with the distance.
    for (object, contacts, seed) in
        [("box:0.15x0.2x0.06", 40, 1002), ("box:0.1x0.07x0.05", 12, 1002)]
    {
        let (dimension, contacts, truth) = touched(object, contacts, seed);
        let gpis = fit(dimension, &contacts, &[]).unwrap().surface;
        let far: Vec<Point> =
            (4..40).flat_map(|k| truth.iter().map(move |p| p * f64::from(k) * 0.5)).collect();
        let nearest = gpis.values(&far).into_iter().fold(f64::INFINITY, f64::min);
        assert!(nearest > 0.0, "{object} {nearest}");
    }
}

#[test]
fn contacts_on_one_side_leave_the_other_open() {
    // Five touches on a tenth of an ellipse's outline fit a ball.
    let touch = |i: i32| {
        let (sin, cos) = (0.15 * f64::from(i)).sin_cos();
        Contact {
            point: Point::new(0.06 * cos, 0.03 * sin, 0.0),
            normal: Some(Point::new(cos / 0.06, sin / 0.03, 0.0).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    };
    let contacts: Vec<Contact> = (-2..=2).map(touch).collect();
    let no = |_, _| {};
    let reconstruct::Shape { geometry, deviations, .. } =
        reconstruct::shape(2, &contacts, &[], Poses::Known, Default::default(), &no).unwrap();
    let truth = Point::new(-0.06, 0.0, 0.0);
    let vertices = geometry.vertices();
    let nearest = |p: &Point| {
        let away = |i: &usize| (vertices[*i] - p).norm();
        (0..vertices.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap()
    };
    let far = nearest(&truth);
    // Nobody knows how long the ellipse is: what is shown is as uncertain as it is large.
    let size = (vertices[far] - contacts[2].point).norm();
    assert!(deviations[far] > 0.3 * size, "{size} {}", deviations[far]);
    assert!(deviations[nearest(&contacts[2].point)] < 1.5e-3);
}

#[test]
fn local_experts_are_as_sure_as_one_dense_process() {
    let (dimension, contacts, truth) = touched("ellipse:0.1x0.06", 60, 3000);
    let (kernel, experts) = fit_experts(dimension, &contacts).unwrap();
    let Some(prior @ Prior::Ball { radius, .. }) = Prior::fitted(&contacts) else { panic!() };
    let (search, train) = (usual(dimension, &contacts), Training::Derivative);
    let found = search.run(dimension, kernel, prior, train, &contacts, radius).unwrap();
    let noisy = noisy(&contacts, found.noise * exactness(dimension, &contacts));
    let dense = Gpis::fit(dimension, found.kernel, prior, train, &noisy).unwrap();
    let mean = |variances: Vec<f64>| variances.iter().map(|v| v.sqrt()).sum::<f64>();
    let ratio = mean(experts.variances(&truth)) / mean(dense.variances(&truth));
    // Less without what normals have exactly.
    assert!((0.95..1.1).contains(&ratio), "{ratio}");
}

#[test]
fn any_contacts_have_a_finite_answer() {
    let (_, contacts, truth) = touched("cylinder:0.05x0.08", 12, 3000);
    let same = vec![contacts[0]; 5];
    let flat: Vec<Contact> = contacts
        .iter()
        .map(|c| Contact {
            point: Point::new(c.point.x, c.point.y, 0.0),
            normal: Some(Point::z()),
            ..*c
        })
        .collect();
    let bare: Vec<Contact> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    for contacts in [&contacts[..1], &contacts[..2], &same, &flat, &bare] {
        let gpis = fit(3, contacts, &[]).unwrap().surface;
        assert!(gpis.values(&truth).iter().chain(&gpis.deviations(&truth)).all(|v| v.is_finite()));
    }
    assert!(matches!(fit(3, &[], &[]), Err(Error::NoContacts)));
}

/// Contacts that felt no normals: without guesses the surface of forty was 20 mm off the rectangle, and 25 off
/// the L; without the bodies that explain points, 3 mm off the ellipse and 29 off the cylinder.
#[test]
fn points_alone_make_a_shape() {
    for (object, contacts, least) in [
        ("rectangle:0.12x0.06", 40, 6e-3),
        ("ellipse:0.12x0.06", 40, 1.5e-3),
        ("lshape:0.09x0.09x0.035", 40, 8e-3),
        ("cylinder:0.06x0.1", 60, 3e-3),
    ] {
        let (dimension, felt, truth) = touched(object, contacts, 5);
        let bare: Vec<Contact> = felt.iter().map(|c| Contact { normal: None, ..*c }).collect();
        let shape =
            reconstruct::shape(dimension, &bare, &[], Poses::Known, Choice::Auto, &|_, _| {});
        let geometry = shape.unwrap().geometry;
        let off = truth.iter().map(|p| (geometry.closest(p) - p).norm()).fold(0.0, f64::max);
        assert!(off < least, "{object}: {off}");
    }
}
