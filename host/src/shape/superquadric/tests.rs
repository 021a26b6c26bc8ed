use super::*;
use crate::reference::Contact;
use crate::shape::metrics::compare;
use crate::space::planar;
use proptest::prelude::*;

fn superquadric(half: [f64; 3], exponents: [f64; 2], pose: Pose, dimension: usize) -> Superquadric {
    let form = Form { half, exponents, pose, planar: dimension == 2 };
    let misfit = Misfit { chi_squared: 0.0, degrees: 1.0, oddity: 0.0 };
    Superquadric { dimension, form, covariance: Covariance::zeros(), misfit }
}

/// Exact contacts spread over a shape, off along the normal by up to `off` metres.
fn touches(shape: &Superquadric, count: usize, off: f64) -> Vec<Contact> {
    let samples = shape.geometry().samples(count);
    let contact = |(i, (p, n)): (usize, (Point, Point))| Contact {
        point: p + n * (off * (7.0 * i as f64).sin()),
        normal: Some(n),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    };
    samples.into_iter().enumerate().map(contact).collect()
}

#[test]
fn special_cases_are_the_shapes_they_should_be() {
    let here = Pose::identity();
    let sphere = superquadric([0.05; 3], [1.0, 1.0], here, 3);
    let p = Point::new(0.03, -0.06, 0.02);
    assert!((sphere.value(&p) - (p.norm() - 0.05)).abs() < 1e-12);
    assert!((sphere.gradient(&p) - p.normalize()).norm() < 1e-12);
    assert_eq!(sphere.value(&Point::zeros()), -0.05);
    let octahedron = superquadric([0.05; 3], [2.0, 2.0], here, 3);
    let face = Point::repeat(0.05 / 3.0);
    assert!(octahedron.value(&face).abs() < 1e-12);
    assert!((octahedron.value(&(2.0 * face)) - face.norm()).abs() < 1e-12);
    let boxed = superquadric([0.06, 0.03, 0.02], [0.1, 0.1], here, 3);
    let Geometry::Mesh(mesh) = boxed.geometry() else { panic!() };
    assert!(mesh.is_watertight());
    assert!((mesh.volume() / (8.0 * 0.06 * 0.03 * 0.02) - 1.0).abs() < 0.02);
    let cylinder = superquadric([0.03, 0.03, 0.05], [0.1, 1.0], here, 3);
    let Geometry::Mesh(mesh) = cylinder.geometry() else { panic!() };
    let exact = std::f64::consts::PI * 0.0009 * 0.1;
    assert!((mesh.volume() / exact - 1.0).abs() < 0.02, "{}", mesh.volume() / exact);
}

#[test]
fn the_parametric_surface_is_that_of_the_thesis() {
    // Thesis 2.1 at an η and ω: on the zero set of the field.
    let (half, exponents) = ([0.06, 0.03, 0.02], [0.4, 1.3]);
    let shape = superquadric(half, exponents, Pose::identity(), 3);
    for (eta, omega) in [(0.3_f64, 0.7_f64), (1.2, 0.1), (0.01, 1.5)] {
        let power = |x: f64, e: f64| x.signum() * x.abs().powf(e);
        let p = Point::new(
            half[0] * power(eta.cos(), exponents[0]) * power(omega.cos(), exponents[1]),
            half[1] * power(eta.cos(), exponents[0]) * power(omega.sin(), exponents[1]),
            half[2] * power(eta.sin(), exponents[0]),
        );
        assert!(shape.value(&p).abs() < 1e-12);
    }
    for (p, _) in [superquadric(half, exponents, planar(0.1, -0.2, 0.5), 2)]
        .iter()
        .flat_map(|s| s.geometry().samples(50).into_iter().map(move |(p, n)| (s.value(&p), n)))
    {
        assert!(p.abs() < 1e-5);
    }
}

#[test]
fn planar_shapes_are_found_again() {
    for (half, exponent) in [([0.06, 0.03], 0.1), ([0.06, 0.03], 1.0), ([0.04, 0.035], 1.8)] {
        let pose = planar(0.02, -0.01, 0.4);
        let truth = superquadric([half[0], half[1], 1.0], [1.0, exponent], pose, 2);
        let found = Superquadric::fit(2, &touches(&truth, 24, 5e-4)).unwrap();
        let d = compare(&found.geometry(), &truth.geometry()).unwrap();
        assert!(d.hausdorff < 2e-3, "{half:?} {exponent}: {d:?} {:?}", found.form);
    }
}

#[test]
fn spatial_shapes_are_found_again() {
    for (half, exponents) in [
        ([0.06, 0.03, 0.03], [0.1, 0.1]),
        ([0.05, 0.04, 0.03], [1.0, 1.0]),
        ([0.03, 0.03, 0.05], [0.1, 1.0]),
    ] {
        let pose = Pose::new(Point::new(0.02, -0.01, 0.3), Point::new(0.3, -0.4, 0.2));
        let truth = superquadric(half, exponents, pose, 3);
        let found = Superquadric::fit(3, &touches(&truth, 60, 5e-4)).unwrap();
        let mean = compare(&found.geometry(), &truth.geometry()).unwrap().mean;
        assert!(mean < 1e-3, "{half:?} {exponents:?}: {mean} {:?}", found.form);
    }
}

#[test]
fn wild_contacts_do_not_decide() {
    let truth = superquadric([0.06, 0.03, 1.0], [1.0, 1.0], planar(0.0, 0.0, 0.3), 2);
    let mut contacts = touches(&truth, 30, 5e-4);
    for wild in contacts.iter_mut().step_by(10) {
        wild.point *= 1.5;
        wild.normal = Some(Point::x());
    }
    let found = Superquadric::fit(2, &contacts).unwrap();
    assert!(compare(&found.geometry(), &truth.geometry()).unwrap().hausdorff < 2e-3);
}

#[test]
fn uncertainty_is_small_where_touched_and_grows_with_fewer_contacts() {
    let truth = superquadric([0.06, 0.03, 1.0], [1.0, 1.0], planar(0.0, 0.0, 0.3), 2);
    let deviation = |count: usize| {
        let found = Superquadric::fit(2, &touches(&truth, count, 5e-4)).unwrap();
        let samples = truth.geometry().samples(40);
        let all = found.deviations(&samples.iter().map(|s| s.0).collect::<Vec<_>>());
        all.iter().sum::<f64>() / 40.0
    };
    let (few, many) = (deviation(6), deviation(60));
    assert!(many < 5e-4 && many > 5e-5 && few > 2.0 * many, "{few} {many}");
}

#[test]
fn what_cannot_be_fitted_is_refused_by_name() {
    let truth = superquadric([0.06, 0.03, 0.04], [1.0, 1.0], Pose::identity(), 3);
    let contacts = touches(&truth, 10, 0.0);
    assert_eq!(Superquadric::fit(4, &contacts).unwrap_err(), Error::Dimension(4));
    assert!(matches!(Superquadric::fit(3, &[]), Err(Error::Few { contacts: 0, .. })));
    assert!(matches!(Superquadric::fit(3, &contacts[..4]), Err(Error::Few { contacts: 4, .. })));
    let bare: Vec<_> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    let few = Superquadric::fit(3, &bare).unwrap_err();
    assert_eq!(few, Error::Few { contacts: 10, observed: 10, sought: 11 });
    assert!(few.to_string().contains("at least 5 contacts and 11 observations"));
    let same = vec![contacts[0]; 8];
    assert!(matches!(Superquadric::fit(3, &same), Err(Error::NoExtent(_))));
    let mut broken = contacts.clone();
    broken[3].point.x = f64::NAN;
    assert!(matches!(Superquadric::fit(3, &broken), Err(Error::Contact { index: 3, .. })));
    // On one line, or all on one side: some finite shape.
    let line: Vec<_> = (0..6)
        .map(|i| Contact {
            point: Point::x() * 0.01 * f64::from(i),
            normal: Some(Point::y()),
            ..contacts[0]
        })
        .collect();
    let found = Superquadric::fit(2, &line).unwrap();
    assert!(found.half().iter().all(|h| h.is_finite() && *h > 0.0));
    assert!(found.deviation(&Point::zeros()).is_finite());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_field_is_a_distance_near_the_surface(
        half in prop::array::uniform3(0.02..0.06), exponents in prop::array::uniform2(0.5..1.5),
        turn in prop::array::uniform3(-1.0..1.0), at in prop::array::uniform3(-1.0..1.0),
    ) {
        let direction = Point::from(at);
        prop_assume!(direction.norm() > 0.1 && direction.iter().all(|x| x.abs() > 0.05));
        let pose = Pose::new(Point::new(0.1, 0.2, -0.1), Point::from(turn));
        let shape = superquadric(half, exponents, pose, 3);
        // From the centre outwards to the surface: the value along a ray is linear.
        let centre = pose.translation.vector;
        let (at_one, at_two) = (shape.value(&(centre + direction)), shape.value(&(centre + 2.0 * direction)));
        let surface = centre + direction * (1.0 - at_one / (at_two - at_one));
        prop_assert!(shape.value(&surface).abs() < 1e-9);
        let normal = shape.gradient(&surface);
        prop_assert!((normal.norm() - 1.0).abs() < 1e-9 && normal.dot(&direction) > 0.0);
        let off = 1e-5;
        let grown = shape.value(&(surface + normal * off));
        prop_assert!((grown / off - 1.0).abs() < 0.02, "{}", grown / off);
    }
}

#[test]
fn a_form_changes_by_its_own_numbers() {
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9);
    let pose = Pose::from_parts(Point::new(0.01, 0.02, 0.03).into(), turn);
    let space = superquadric([0.05, 0.04, 0.03], [0.5, 0.7], pose, 3).form();
    let plane = superquadric([0.05, 0.04, 0.03], [1.0, 0.7], planar(0.1, 0.2, 0.3), 2).form();
    assert_eq!((space.numbers().count(), plane.numbers().count()), (11, 6));
    let changed = |form: &Form, which: Number, by: f64| {
        let by: Vec<f64> = form.numbers().map(|n| if n == which { by } else { 0.0 }).collect();
        form.changed(&by)
    };
    assert!((changed(&space, Number::Half(1), 0.5).half()[1] - 0.04 * 0.5f64.exp()).abs() < 1e-15);
    assert!((changed(&plane, Number::Exponent(1), -0.2).exponents()[1] - 0.5).abs() < 1e-15);
    assert_eq!(changed(&space, Number::Exponent(0), 9.0).exponents(), [EXPONENTS.1, 0.7]);
    assert_eq!(changed(&space, Number::Exponent(1), -9.0).exponents(), [0.5, EXPONENTS.0]);
    let shifted = changed(&space, Number::Shift(2), 0.01);
    assert!((shifted.centre() - space.centre() - space.axes()[2] * 0.01).norm() < 1e-15);
    let turned = changed(&plane, Number::Turn(2), 0.1);
    assert!((turned.pose().rotation.angle() - 0.4).abs() < 1e-12);
    // What means nothing in the plane stays.
    let same = changed(&plane, Number::Half(2), 1.0);
    assert_eq!((same.half(), same.exponents()), (plane.half(), plane.exponents()));
    // Elsewhere it is as far from the points that go along.
    let frame = Pose::from_parts(Point::new(-0.3, 0.1, 0.0).into(), turn.inverse());
    let p = nalgebra::Point3::new(0.06, 0.01, 0.07);
    let moved = space.transformed(&frame).distance(&(frame * p).coords).0;
    assert!((moved - space.distance(&p.coords).0).abs() < 1e-12);
}
