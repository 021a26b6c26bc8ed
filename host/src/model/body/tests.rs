pub(crate) use super::turned::tests::cup;
use super::*;
use crate::model::Faces;
use crate::reference::{Gpis, Kernel, Training};
use proptest::prelude::*;

/// A can standing on z, 60 mm across and 100 mm high, felt all around and on both ends.
fn can(noise: f64) -> Vec<Contact> {
    let mut contacts = Vec::new();
    let mut add = |point: Point, normal: Point| {
        // Off along the normal by a fixed pattern.
        let off = noise * (7.0 * contacts.len() as f64).sin();
        contacts.push(Contact {
            point: point + normal * off,
            normal: Some(normal),
            point_deviation: 1e-3,
            normal_deviation: 0.05,
        });
    };
    for i in 0..30 {
        let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
        let z = -0.045 + 0.09 * f64::from(i) / 29.0;
        add(Point::new(0.03 * cos, 0.03 * sin, z), Point::new(cos, sin, 0.0));
    }
    for i in 0..6 {
        let (sin, cos) = (1.1 * f64::from(i)).sin_cos();
        for end in [-1.0, 1.0] {
            add(Point::new(0.02 * cos, 0.02 * sin, 0.05 * end), Point::z() * end);
        }
    }
    contacts
}

fn ellipse(count: i32) -> Vec<Contact> {
    (0..count)
        .map(|i| (std::f64::consts::TAU * (f64::from(i) + 0.3) / f64::from(count)).sin_cos())
        .map(|(sin, cos)| Contact {
            point: Point::new(0.06 * cos, 0.03 * sin, 0.0),
            normal: Some(Point::new(cos / 0.06, sin / 0.03, 0.0).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.05,
        })
        .collect()
}

#[test]
fn a_can_is_a_cylinder_between_two_planes() {
    let contacts = can(5e-4);
    let faces = Faces::fit(3, &contacts).unwrap();
    let body = Body::cut(3, &contacts, &faces).unwrap();
    assert_eq!(body.parts().len(), 3);
    assert!(body.misfit() < 1.0, "{}", body.misfit());
    for (p, distance) in [
        (Point::new(0.035, 0.0, 0.02), 0.005),
        (Point::new(0.0, -0.025, -0.03), -0.005),
        (Point::new(0.0, 0.01, 0.056), 0.006),
        (Point::new(0.01, 0.0, -0.048), -0.002),
    ] {
        assert!((body.value(&p) - distance).abs() < 1e-3, "{p:?}: {}", body.value(&p));
    }
    // No quadric alone explains it.
    let quadric = Body::quadric(3, &contacts).unwrap();
    assert!(quadric.misfit() > 4.0 * body.misfit());
}

/// A touch at a place, with its normal.
pub(super) fn touch(point: Point, normal: Point) -> Contact {
    Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.05 }
}

proptest! {
    /// Of a cone the field is the distance to the side, where a perpendicular from there meets it.
    #[test]
    fn a_cone_has_its_exact_distance(
        (radius, widening) in (0.01f64..1.0, -2f64..2.0),
        (along, away, turn) in (-0.4f64..0.4, -0.3f64..0.3, 0f64..6.3),
    ) {
        let form = Matrix3::from_diagonal(&Point::new(1.0, 1.0, 0.0)) / (radius * radius);
        let centre = Point::new(0.3, -0.2, 0.1);
        let taper = Point::z() * (widening / radius);
        let cone = Quadric::tapered(centre, form, taper).unwrap();
        // From a point of the side along its normal.
        let (height, slant) = (along * radius, 1f64.hypot(widening));
        let off = away * radius;
        let out = radius + widening * height + off / slant;
        prop_assume!(out > 1e-3 * radius);
        let up = height - off * widening / slant;
        let (sin, cos) = turn.sin_cos();
        let p = centre + Point::new(out * cos, out * sin, up);
        let (value, gradient) = cone.at(&p);
        prop_assert!((value - off).abs() < 1e-9 * radius, "{value} {off}");
        let normal = Point::new(cos, sin, -widening) / slant;
        prop_assert!((gradient - normal).norm() < 1e-9);
    }

    /// Value and gradient of any tapered quadric belong together, and its inside is convex.
    #[test]
    fn a_tapered_quadric_is_convex_and_smooth(
        root in prop::array::uniform6(-2f64..2.0),
        taper in prop::array::uniform3(-2f64..2.0),
        (p, q) in (prop::array::uniform3(-1f64..1.0), prop::array::uniform3(-1f64..1.0)),
        share in 0f64..1.0,
    ) {
        let [a, b, c, d, e, f] = root;
        let root = Matrix3::new(a, 0.0, 0.0, b, c, 0.0, d, e, f);
        let form = root * root.transpose();
        prop_assume!(SymmetricEigen::new(form).eigenvalues.max() > 0.1);
        let quadric = Quadric::tapered(Point::zeros(), form, Point::from(taper)).unwrap();
        let (p, q) = (Point::from(p), Point::from(q));
        prop_assert!(quadric.at(&Point::zeros()).0 < 0.0);
        if quadric.at(&p).0 <= 0.0 && quadric.at(&q).0 <= 0.0 {
            prop_assert!(quadric.at(&(p * share + q * (1.0 - share))).0 < 1e-9);
        }
        // Outside, where a ray from the centre leaves it is on the surface.
        let foot = Part::Quadric(quadric).foot(&p);
        if quadric.at(&p).0 > 0.0 {
            prop_assert!(quadric.at(&foot.point).0.abs() < 1e-6);
            prop_assert!((foot.point * foot.gauge - p).norm() < 1e-9);
        }
        let (square, slope) = (p.dot(&(form * p)), quadric.gauge(&p).1.norm());
        prop_assume!(square > 1e-2 && slope > 0.1);
        let h = 1e-6;
        for axis in 0..3 {
            let step = Point::ith(axis, h);
            let slope = (quadric.at(&(p + step)).0 - quadric.at(&(p - step)).0) / (2.0 * h);
            let gradient = quadric.at(&p).1[axis];
            prop_assert!((slope - gradient).abs() < 1e-4 * (1.0 + slope.abs()), "{slope} {gradient}");
        }
    }
}

#[test]
fn a_quadric_of_no_numbers_is_none() {
    let form = Matrix3::identity();
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(Quadric::new(Point::x() * bad, form), None);
        assert_eq!(Quadric::new(Point::x(), form * bad), None);
        assert_eq!(Quadric::tapered(Point::x(), form, Point::y() * bad), None);
    }
    assert_eq!(Quadric::new(Point::x(), form * 0.0), None);
    // On the axis of a cone there is no direction to its side, but an inside, and a tip beyond.
    let round = Matrix3::from_diagonal(&Point::new(1.0, 1.0, 0.0));
    let cone = Quadric::tapered(Point::zeros(), round, Point::z() * -1.0).unwrap();
    let half = 0.5f64.sqrt();
    assert!((cone.at(&Point::zeros()).0 + half).abs() < 1e-12);
    assert!((cone.at(&(Point::z() * 2.0)).0 - half).abs() < 1e-12);
}

#[test]
fn an_ellipse_is_found_and_a_ball_stays_a_ball() {
    let body = Body::quadric(2, &ellipse(12)).unwrap();
    for i in 0..36 {
        let (sin, cos) = (f64::from(i) * 10f64.to_radians()).sin_cos();
        let p = Point::new(0.06 * cos, 0.03 * sin, 0.0);
        assert!(body.value(&p).abs() < 5e-4, "{p:?}: {}", body.value(&p));
        assert!((body.gradient(&p).norm() - 1.0).abs() < 1e-2);
    }
    assert!(body.misfit() < 0.5 && body.oddity() > 0.0);
    let ball = Body::ball(2, &ellipse(12)).unwrap();
    assert!(ball.misfit() > 10.0);
    assert_eq!(ball.oddity(), 0.0);
    assert_eq!(Body::quadric(2, &[]), None);
}

#[test]
fn at_a_crease_the_normal_says_which_side_was_felt() {
    let contacts = can(0.0);
    let faces = Faces::fit(3, &contacts).unwrap();
    let body = Body::cut(3, &contacts, &faces).unwrap();
    // Half a deviation past the edge, as noise has it, and felt on the end.
    let touch = |normal: Point| Contact {
        point: Point::new(0.0305, 0.0, 0.0498),
        normal: Some(normal),
        ..contacts[0]
    };
    assert!(body.felt(&touch(Point::z())).z > 0.99);
    assert!(body.felt(&touch(Point::x())).x > 0.99);
    // Some deviations before the end; but not in the middle of the side, whatever it says.
    let below = |deviations: f64| {
        let point = Point::new(0.03, 0.0, 0.05 - deviations * contacts[0].point_deviation);
        body.felt(&Contact { point, ..touch(Point::z()) })
    };
    assert!(below(3.0).z > 0.99);
    assert!(below(12.0).x > 0.99);
}

#[test]
fn few_contacts_and_bad_ones_have_a_finite_answer() {
    let one = &ellipse(12)[..1];
    for contacts in [one.to_vec(), vec![one[0]; 4], ellipse(2)] {
        let ball = Body::ball(2, &contacts).unwrap();
        assert!(ball.value(&Point::new(0.2, 0.1, 0.0)).is_finite() && ball.misfit().is_finite());
        // Too few to say more.
        assert_eq!(Body::quadric(2, &contacts), None);
        assert_eq!(Body::superquadric(2, &contacts), None);
    }
    let flat = can(0.0).into_iter().filter(|c| c.point.z > 0.049);
    let flat: Vec<Contact> = flat.flat_map(|c| [c; 4]).collect();
    let body = Body::quadric(3, &flat).unwrap();
    assert!(body.value(&Point::new(0.0, 0.0, 0.3)).is_finite());
}

/// A can whose bottom nobody touched, and two sides that meet far away.
#[test]
fn what_contacts_leave_open_is_closed_beyond_them() {
    let open: Vec<Contact> = can(0.0).into_iter().filter(|c| c.point.z > -0.03).collect();
    let faces = Faces::fit(3, &open).unwrap();
    let side = |angle: f64, x: f64| {
        let normal = Point::new(angle.sin(), angle.cos(), 0.0);
        let point = normal * 0.03 + Point::new(x * angle.cos(), -x * angle.sin(), 0.0);
        Contact { point, normal: Some(normal), point_deviation: 1e-3, normal_deviation: 0.05 }
    };
    let wedge: Vec<Contact> = (-1..2)
        .flat_map(|i| [side(0.1, 0.03 * f64::from(i)), side(3.0, 0.03 * f64::from(i))])
        .collect();
    let sides = Faces::fit(2, &wedge).unwrap();
    for (dimension, contacts, body) in [
        (3, &open, Body::cut(3, &open, &faces).unwrap()),
        (2, &wedge, Body::polytopes(2, &wedge, &sides).remove(0)),
    ] {
        for c in contacts {
            assert!(body.value(&c.point).abs() < 5e-3);
        }
        let far = |i: usize| {
            let turn = 0.1 * i as f64;
            let out = Point::new(turn.cos(), turn.sin(), 0.0);
            if dimension == 2 { out } else { Point::new(out.x, 0.0, out.y) }
        };
        assert!((0..63).all(|i| body.value(&(far(i) * 0.25)) > 0.0));
        // Where it ends is a guess.
        let end = body.modes(&(if dimension == 2 { -Point::x() } else { -Point::z() } * 0.05));
        assert!(end.iter().map(|m| m.0 * m.0).sum::<f64>().sqrt() > 5e-3);
    }
}

/// A corner of a block, its three sides felt three times each: across from them lie parallel ones, not
/// one that cuts across all three axes far away.
#[test]
fn a_corner_is_closed_like_a_block() {
    let side = |axis: usize, u: f64, v: f64| {
        let mut point = Point::zeros();
        (point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]) = (0.03, u, v);
        let normal = Some(Point::ith(axis, 1.0));
        Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.05 }
    };
    let places = [(-0.03, -0.028), (0.02, -0.025), (-0.028, 0.02)];
    let contacts: Vec<Contact> =
        (0..3).flat_map(|axis| places.map(|(u, v)| side(axis, u, v))).collect();
    let sides = (0..3).map(|axis| Plane { normal: Point::ith(axis, 1.0), offset: 0.03 });
    let parts = sides.map(Part::Plane).collect();
    let corner = Body { parts, modes: vec![], oddity: 0.0, chi_squared: 0.0, degrees: 0.0 };
    let body = corner.closed(3, &contacts, &[]);
    assert_eq!(body.parts().len(), 6);
    for axis in 0..3 {
        assert!(body.value(&(Point::ith(axis, -0.045))) > 0.0);
        let along = Point::ith((axis + 1) % 3, 0.025) + Point::ith((axis + 2) % 3, -0.03);
        assert!(body.value(&(along - Point::ith(axis, 0.05))) > 0.0);
        assert!(body.value(&(along - Point::ith(axis, 0.025))) < 0.0);
    }
}

/// Four sides of a rod so thin that none of the evenly spread directions stays within it, nor any across from
/// a side.
#[test]
fn a_thin_rod_is_closed_at_both_ends() {
    let axis = Point::new(0.3, -0.5, 0.8).normalize();
    let across = axis.cross(&Point::x()).normalize();
    let sides = [across, axis.cross(&across), -across, -axis.cross(&across)];
    let contact = |i: usize| Contact {
        point: axis * (0.2 * (i as f64 / 20.0 - 1.0)) + sides[i % 4] * 4e-3,
        normal: Some(sides[i % 4]),
        point_deviation: 1e-3,
        normal_deviation: 0.05,
    };
    let contacts: Vec<Contact> = (0..=40).map(contact).collect();
    let parts = sides.map(|normal| Part::Plane(Plane { normal, offset: 4e-3 })).to_vec();
    let rod = Body { parts, modes: vec![], oddity: 0.0, chi_squared: 0.0, degrees: 0.0 };
    assert!(rod.value(&(axis * 0.25)) < 0.0);
    let body = rod.closed(3, &contacts, &[]);
    for end in [-axis, axis] {
        assert!(body.value(&(end * 0.19)) < 0.0 && body.value(&(end * 0.22)) > 0.0);
    }
}

/// Touches in the plane: places (millimetres) and the normals' angles (degrees).
fn touches(all: &[(f64, f64, f64)]) -> Vec<Contact> {
    let touch = |(x, y, angle): &(f64, f64, f64)| {
        let (sin, cos) = angle.to_radians().sin_cos();
        Contact {
            point: Point::new(x * 1e-3, y * 1e-3, 0.0),
            normal: Some(Point::new(cos, sin, 0.0)),
            point_deviation: 1e-3,
            normal_deviation: 0.05,
        }
    };
    all.iter().map(touch).collect()
}

#[test]
fn few_contacts_make_a_polytope_unless_too_many_sides_are_in_doubt() {
    let polytope = |contacts: &[Contact]| {
        let faces = Faces::fit(2, contacts).unwrap().simplified(contacts).regular(contacts);
        (faces.unconfirmed(contacts).len(), Body::polytopes(2, contacts, &faces).into_iter().next())
    };
    // Two long sides of a block and one end, which is square to them.
    let (up, down) = (90.0, -90.0);
    let mut block = touches(&[
        (-20.0, 30.0, up),
        (15.0, 30.0, up),
        (5.0, -30.0, down),
        (-30.0, -30.0, down),
        (50.0, 5.0, 0.0),
    ]);
    let (unconfirmed, body) = polytope(&block);
    let body = body.unwrap();
    assert_eq!((unconfirmed, body.parts().len()), (0, 4));
    for (x, y) in [(0.0, 30.0), (10.0, -30.0), (50.0, 10.0)] {
        assert!(body.value(&Point::new(x * 1e-3, y * 1e-3, 0.0)).abs() < 1e-3);
    }
    // The other end is as far beyond the last of five contacts as these lie apart.
    assert!(body.value(&Point::new(-0.046, 0.0, 0.0)).abs() < 1e-3);
    // Felt askew nothing confirms two of the sides, and with one that nobody touched there are three.
    block[4] = touches(&[(50.0, 5.0, 25.0)])[0];
    block[2] = touches(&[(5.0, -30.0, -65.0)])[0];
    let (unconfirmed, body) = polytope(&block);
    assert!(unconfirmed == 2 && body.is_none(), "{unconfirmed} {body:?}");
    // Each side of a pentagon touched once may have others between them, touched twice it has not.
    let around = |shift: f64| {
        (0..5).map(move |i| {
            let turn = 72.0 * f64::from(i);
            let (sin, cos) = turn.to_radians().sin_cos();
            (40.0 * cos - shift * sin, 40.0 * sin + shift * cos, turn)
        })
    };
    let once: Vec<_> = around(3.0).collect();
    assert_eq!(polytope(&touches(&once)), (5, None));
    let twice: Vec<_> = once.into_iter().chain(around(-12.0)).collect();
    assert!(matches!(polytope(&touches(&twice)), (0, Some(_))));
    // One of its sides not touched, twelve contacts would not all have missed it by chance.
    let thrice: Vec<_> = twice.into_iter().chain(around(14.0)).filter(|t| t.2 > 0.0).collect();
    assert_eq!(polytope(&touches(&thrice)), (0, None));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Value and gradient of a body and of its modes belong together, away from creases.
    #[test]
    fn gradients_are_derivatives(
        is_can: bool,
        x in -0.1f64..0.1,
        y in -0.1f64..0.1,
        z in -0.1f64..0.1,
    ) {
        let contacts: Vec<Contact> = if is_can { can(5e-4) } else { cup(1.2, 20, [3, 3]) };
        let faces = Faces::fit(3, &contacts).unwrap();
        let body = if is_can {
            Body::cut(3, &contacts, &faces)
        } else {
            Body::turned(3, &contacts, &faces, true)
        };
        let body = body.unwrap();
        let p = Point::new(x, y, z);
        let h = 1e-6;
        prop_assume!(x.hypot(y) > 0.005);
        let part = body.active(&p).0;
        for axis in 0..3 {
            let mut step = Point::zeros();
            step[axis] = h;
            let (up, down) = (p + step, p - step);
            prop_assume!(body.active(&up).0 == part && body.active(&down).0 == part);
            let slope = (body.value(&up) - body.value(&down)) / (2.0 * h);
            prop_assert!((slope - body.gradient(&p)[axis]).abs() < 1e-5);
            let (up, down) = (body.modes(&up), body.modes(&down));
            for ((up, down), mode) in up.iter().zip(&down).zip(body.modes(&p)) {
                let slope = (up.0 - down.0) / (2.0 * h);
                prop_assert!((slope - mode.1[axis]).abs() < 1e-3 * (1.0 + slope.abs()));
            }
        }
    }
}

#[test]
fn doubt_about_the_body_widens_the_band_away_from_contacts() {
    let contacts: Vec<Contact> = ellipse(24).into_iter().filter(|c| c.point.x > 0.0).collect();
    let body = Body::quadric(2, &contacts).unwrap();
    let kernel = Kernel::Matern32 { amplitude: 1e-3, lengthscale: 0.08 };
    let fit = Gpis::fit(2, kernel, body, Training::Derivative, &contacts).unwrap();
    let ends = [Point::new(0.06, 0.0, 0.0), Point::new(-0.06, 0.0, 0.0)];
    let variances = fit.variances(&ends);
    assert!(variances[0].sqrt() < 1e-3, "{}", variances[0].sqrt());
    // The kernel alone would claim a millimetre.
    assert!(variances[1].sqrt() > 3e-3, "{}", variances[1].sqrt());
}

/// A square of 60 mm, each side felt at three places; the right side leans out at the top, with this slope.
pub(crate) fn square(lean: f64) -> Vec<Contact> {
    let mut contacts = Vec::new();
    for along in [-0.02, 0.0, 0.02] {
        for (normal, side) in [
            (Point::new(1.0, -lean, 0.0), Point::new(0.03 + lean * along, along, 0.0)),
            (-Point::x(), Point::new(-0.03, along, 0.0)),
            (Point::y(), Point::new(0.5 * along - 0.01, 0.03, 0.0)),
            (-Point::y(), Point::new(0.5 * along - 0.01, -0.03, 0.0)),
        ] {
            contacts.push(Contact {
                point: side,
                normal: Some(normal.normalize()),
                point_deviation: 1e-4,
                normal_deviation: 0.01,
            });
        }
    }
    contacts
}

#[test]
fn a_plane_that_contacts_turn_takes_its_edges_along() {
    let faces = Faces::fit(2, &square(0.0)).unwrap();
    let (body, _) = Body::flat(2, &square(0.0), &faces).unwrap();
    let kernel = Kernel::Matern32 { amplitude: 1e-3, lengthscale: 0.05 };
    let leaning = square(0.47);
    let fit = |body: &Body| Gpis::fit(2, kernel, body.clone(), Training::Derivative, &leaning);
    let stiff = fit(&body).unwrap();
    let mut turned = body.clone();
    for _ in 0..3 {
        turned = turned.moved(fit(&turned).unwrap().shifts(), &Point::zeros()).unwrap();
    }
    let moved = fit(&turned).unwrap();
    // Above the top side, left of where the right one leans to, right of where it stood.
    let beyond = Point::new(0.042, 0.034, 0.0);
    let [stiff, moved] = [stiff, moved].map(|surface| surface.means(&[beyond])[0]);
    assert!(stiff < 0.0, "a sheet beyond the edge {stiff}");
    assert!((moved - 0.004).abs() < 1e-3, "{moved}");
}

/// The greatest of the parts' fields, and by how much it is greater than the next.
fn decided(body: &Body, p: &Point) -> (f64, f64) {
    let mut values: Vec<f64> = body.parts().iter().map(|part| part.at(p).0).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    (values[0], values[0] - values[1])
}

proptest! {
    // Every case fits a can of its own.
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn moving_a_body_changes_nothing_of_what_is_believed(
        by in prop::collection::vec(-0.2f64..0.2, 40),
        nudged in 0usize..40,
        p in prop::array::uniform3(-0.05f64..0.05),
        away in prop::array::uniform3(-3f64..3.0),
    ) {
        let contacts = can(5e-4);
        let body = Body::cut(3, &contacts, &Faces::fit(3, &contacts).unwrap()).unwrap();
        let (p, origin) = (Point::from(p), Point::zeros());
        let count = body.modes(&p).len();
        let (by, nudged) = (&by[..count], nudged % count);
        let Some(moved) = body.moved(by, &origin) else { return Ok(()) };

        // What the process adds to the mean puts every part where it was moved to.
        let shifts = |body: &Body, by: &[f64]| -> Local {
            let modes = body.modes(&p).into_iter().zip(by);
            modes.fold((0.0, origin), |s, (m, by)| (s.0 + m.0 * by, s.1 + m.1 * *by))
        };
        let (field, margin) = decided(&moved, &p);
        prop_assert!((moved.value(&p) + shifts(&moved, by).0 - field).abs() < 1e-9);
        // Away from creases, and where no foot on a surface is asked in place of the point ...
        if margin < 2e-3 || decided(&body, &p).1 < 2e-3 || field > -1e-3 {
            return Ok(());
        }
        // ... gradients are those of values,
        let step = 1e-6;
        for axis in 0..3 {
            let at = |by: f64| {
                let mut beside = p;
                beside[axis] += by;
                moved.value(&beside)
            };
            let slope = (at(step) - at(-step)) / (2.0 * step);
            prop_assert!((moved.gradient(&p)[axis] - slope).abs() < 1e-4, "{slope}");
        }
        // it strayed by what a little more is more,
        let mut more = by.to_vec();
        more[nudged] += 1e-3;
        prop_assert!(moved.strayed(by) < 1e-12 && (moved.strayed(&more) - 1e-3).abs() < 1e-12);
        prop_assert_eq!(body.strayed(&more), 0.0);
        // modes say what a little more does,
        let Some(there) = body.moved(&more, &origin) else { return Ok(()) };
        let change = decided(&there, &p).0 - field;
        prop_assert!((change - 1e-3 * moved.modes(&p)[nudged].0).abs() < 1e-6, "{change}");
        // a hundredth is a hundredth of the modes,
        let little: Vec<f64> = by.iter().map(|by| 0.01 * by).collect();
        let Some(near) = body.moved(&little, &origin) else { return Ok(()) };
        let expected = body.value(&p) + shifts(&body, &little).0;
        prop_assert!((decided(&near, &p).0 - expected).abs() < 1e-5, "{expected}");
        // and it is the same wherever the object is.
        let away = Point::from(away);
        let elsewhere: Vec<Contact> =
            contacts.iter().map(|c| Contact { point: c.point + away, ..*c }).collect();
        let faces = Faces::fit(3, &elsewhere).unwrap();
        let elsewhere = Body::cut(3, &elsewhere, &faces).unwrap().moved(by, &away).unwrap();
        prop_assert!((decided(&elsewhere, &(p + away)).0 - field).abs() < 1e-4);
    }
}

#[test]
fn a_body_is_moved_nowhere_by_what_is_no_number() {
    let contacts = can(5e-4);
    let body = Body::cut(3, &contacts, &Faces::fit(3, &contacts).unwrap()).unwrap();
    let count = body.modes(&Point::zeros()).len();
    assert!(body.moved(&vec![f64::NAN; count], &Point::zeros()).is_none());
    assert!(body.moved(&vec![f64::INFINITY; count], &Point::zeros()).is_none());
    // Half an axis less than none.
    let quadric = Body::quadric(2, &ellipse(20)).unwrap();
    assert!(quadric.moved(&[0.0, 0.0, -9.0, 0.0, 0.0], &Point::zeros()).is_none());
    // Numbers that are missing are zero.
    assert_eq!(
        body.moved(&[], &Point::zeros()).unwrap().value(&Point::x()),
        body.value(&Point::x())
    );
    let ball = Body::doubtful_ball(3, &contacts).unwrap();
    assert!(ball.moved(&[0.1; 4], &Point::zeros()).is_none());
}
