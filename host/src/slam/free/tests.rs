use super::*;
use crate::reference::Prior;
use proptest::prelude::*;

const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.06 };

fn touch(x: f64, y: f64, nx: f64, ny: f64) -> Contact {
    Contact {
        point: Point::new(x, y, 0.0),
        normal: Some(Point::new(nx, ny, 0.0).normalize()),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    }
}

fn at(x: f64, y: f64) -> Free {
    Free { point: Point::new(x, y, 0.0), deviation: 1e-3 }
}

/// The outside of a U, 100 mm wide and 80 mm high with walls of 20 mm, open upwards, touched from
/// outside and on top of its walls only.
fn outside_of_a_u() -> Vec<Contact> {
    let mut contacts = Vec::new();
    for k in 0..5 {
        let s = 0.016 * f64::from(k) + 0.008;
        contacts.push(touch(-0.05, s, -1.0, 0.0));
        contacts.push(touch(0.05, s, 1.0, 0.0));
        contacts.push(touch(-0.04 + 0.02 * f64::from(k), 0.0, 0.0, -1.0));
    }
    for x in [-0.045, -0.035, 0.035, 0.045] {
        contacts.push(touch(x, 0.08, 0.0, 1.0));
    }
    contacts
}

/// Where a finger went down into the U.
fn shaft() -> Vec<Free> {
    (0..40).map(|i| at(-0.02 + 0.01 * f64::from(i % 5), 0.03 + 0.007 * f64::from(i / 5))).collect()
}

#[test]
fn a_u_is_not_filled_where_a_finger_went() {
    let contacts = outside_of_a_u();
    let mean = || Prior::fitted(&contacts).unwrap();
    let shaft = shaft();
    let points: Vec<Point> = shaft.iter().map(|f| f.point).collect();
    let filled = open(2, KERNEL, mean(), &contacts, &[]).unwrap();
    let opened = open(2, KERNEL, mean(), &contacts, &shaft).unwrap();
    let within = |gpis: &Gpis| gpis.means(&points).iter().filter(|v| **v < 0.0).count();
    assert!(within(&filled) > 30, "{}", within(&filled));
    assert_eq!(within(&opened), 0);
    // The walls and the floor are still there.
    let solid =
        [Point::new(-0.042, 0.05, 0.0), Point::new(0.042, 0.05, 0.0), Point::new(0.0, 8e-3, 0.0)];
    assert!(opened.means(&solid).iter().all(|v| *v < 0.0), "{:?}", opened.means(&solid));
    // And the contacts are on the surface.
    let felt: Vec<Point> = contacts.iter().map(|c| c.point).collect();
    assert!(opened.means(&felt).iter().all(|v| v.abs() < 2.5e-3), "{:?}", opened.means(&felt));
}

#[test]
fn what_is_outside_for_certain_changes_nothing() {
    let contacts = outside_of_a_u();
    let mean = || Prior::fitted(&contacts).unwrap();
    let around: Vec<Free> = (0..3000)
        .map(|i| (0.01 * f64::from(i)).sin_cos())
        .map(|(sin, cos)| at(0.25 * cos, 0.04 + 0.25 * sin))
        .chain([at(f64::NAN, 0.0), at(0.0, f64::INFINITY)])
        .collect();
    let (bare, with) = (
        open(2, KERNEL, mean(), &contacts, &[]).unwrap(),
        open(2, KERNEL, mean(), &contacts, &around).unwrap(),
    );
    assert_eq!(bare.rows(), with.rows());
    assert_eq!(bare.log_marginal_likelihood(), with.log_marginal_likelihood());
}

#[test]
fn a_free_point_on_a_contact_leaves_the_contact_where_it_was() {
    let contacts = outside_of_a_u();
    let mean = || Prior::fitted(&contacts).unwrap();
    // Inside by three deviations, and the same point many times over.
    let wrong: Vec<Free> = (0..50).map(|_| at(-0.047, 0.04)).collect();
    let opened = open(2, KERNEL, mean(), &contacts, &wrong).unwrap();
    let value = opened.means(&[Point::new(-0.05, 0.04, 0.0)])[0];
    assert!(value.is_finite() && value.abs() < 4e-3, "{value}");
}

#[test]
fn one_point_has_the_moments_of_the_truncated_normal() {
    let gpis = Gpis::fit(2, KERNEL, Prior::Constant(-0.01), Training::Derivative, &[]).unwrap();
    let free = Free { point: Point::zeros(), deviation: 1e-9 };
    let readings = propagate(&gpis, &[free]);
    let prior = Prior::Constant(-0.01);
    let train = Training::Derivative;
    let opened = Gpis::fit_with(2, KERNEL, prior, train, &[], &readings).unwrap();
    // By summation of the density above zero.
    let step = 1e-6;
    let (mut mass, mut first, mut second) = (0.0, 0.0, 0.0);
    for i in 0..300_000 {
        let f = (f64::from(i) + 0.5) * step;
        let density = (-0.5 * ((f + 0.01) / 0.03).powi(2)).exp();
        mass += density;
        first += density * f;
        second += density * f * f;
    }
    let mean = first / mass;
    let variance = second / mass - mean * mean;
    assert!((opened.means(&[free.point])[0] / mean - 1.0).abs() < 1e-4);
    assert!((opened.variances(&[free.point])[0] / variance - 1.0).abs() < 1e-4);
}

#[test]
fn the_hazard_is_right_where_it_is_known() {
    for (z, known) in [
        (0.0, 0.797_884_560_8),
        (1.0, 0.287_599_970_9),
        (-1.0, 1.525_135_276_2),
        (-10.0, 10.098_093_233_9),
        (8.0, 5.052_271e-15),
    ] {
        assert!((hazard(z) / known - 1.0).abs() < 1e-6, "{z}: {}", hazard(z));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Evidence that points are outside never makes one of them more likely to be inside.
    #[test]
    fn free_points_only_push_outwards(
        places in proptest::collection::vec((-0.08f64..0.08, -0.04f64..0.12), 1..12),
    ) {
        let contacts = outside_of_a_u();
        let mean = || Prior::fitted(&contacts).unwrap();
        let free: Vec<Free> = places.iter().map(|(x, y)| at(*x, *y)).collect();
        let points: Vec<Point> = free.iter().map(|f| f.point).collect();
        let bare = open(2, KERNEL, mean(), &contacts, &[]).unwrap();
        let with = open(2, KERNEL, mean(), &contacts, &free).unwrap();
        let inside = |gpis: &Gpis| gpis.means(&points).iter().map(|v| (-v).max(0.0)).sum::<f64>();
        prop_assert!(inside(&with) <= inside(&bare) + 1e-9);
    }
}
