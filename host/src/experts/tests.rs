use proptest::prelude::*;

use super::*;
use crate::reference::{Gpis, Kernel, Prior, Training};
use crate::shape::Field;
use crate::space::Point;

const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.025, lengthscale: 0.09 };
const BALL: Prior = Prior::Ball { centre: Point::new(0.002, -0.001, 0.0), radius: 0.042 };

/// `count` contacts spread evenly over an ellipse or ellipsoid, with 1 mm and 5° of noise; every
/// seventh without a normal.
fn touches(dimension: usize, count: usize) -> Vec<Contact> {
    let axes = Point::new(0.06, 0.03, 0.04);
    let mut state = 12345u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    };
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let touch = |i: usize| {
        let z = if dimension == 3 { 1.0 - (2 * i + 1) as f64 / count as f64 } else { 0.0 };
        let turn = golden * i as f64;
        let ring = (1.0 - z * z).sqrt();
        let unit = Point::new(ring * turn.cos(), ring * turn.sin(), z);
        let normal = unit.component_div(&axes).normalize();
        let flat = if dimension == 3 { 1.0 } else { 0.0 };
        let mut noise = || 12f64.sqrt() * Point::new(uniform(), uniform(), flat * uniform());
        Contact {
            point: unit.component_mul(&axes) + noise() * 1e-3,
            normal: (i % 7 != 3).then(|| (normal + noise() * 0.0873).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    };
    (0..count).map(touch).collect()
}

fn dense(dimension: usize, contacts: &[Contact]) -> Gpis {
    Gpis::fit(dimension, KERNEL, BALL, Training::Derivative, contacts).unwrap()
}

fn experts(dimension: usize, contacts: &[Contact]) -> Experts {
    Experts::fit(Settings::new(dimension, KERNEL, BALL, 1e-3), contacts).unwrap()
}

/// Points of the band about the true ellipsoid where the surface is sought, and some farther off.
fn asked(dimension: usize, count: usize) -> Vec<Point> {
    let offsets = [0.0, 0.003, -0.003, 0.01];
    let contacts = touches(dimension, count);
    let shifted = |(i, c): (usize, &Contact)| c.point * (1.0 + offsets[i % 4] / c.point.norm());
    contacts.iter().enumerate().map(shifted).collect()
}

fn quantile(mut numbers: Vec<f64>, share: f64) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[((numbers.len() - 1) as f64 * share) as usize]
}

#[test]
fn without_contacts_and_far_from_them_there_is_the_prior() {
    let empty = experts(3, &[]);
    let touched = experts(3, &touches(3, 150));
    let far = [Point::new(3.0, -2.0, 1.0), Point::new(1e12, 0.0, 0.0), Point::new(0.0, 0.0, 1e100)];
    for (surface, points) in [(&empty, &asked(3, 30)[..]), (&touched, &far[..])] {
        for (p, (mean, variance)) in
            points.iter().zip(surface.means(points).into_iter().zip(surface.variances(points)))
        {
            let prior = BALL.value(p);
            assert!((mean - prior).abs() <= 1e-9 * prior.abs().max(1e-3), "{p:?} {mean}");
            assert!((variance / 0.025f64.powi(2) - 1.0).abs() < 1e-9);
        }
    }
    assert_eq!((empty.contacts(), empty.sites(), empty.experts()), (0, 0, 0));
}

#[test]
fn few_contacts_make_the_dense_process_itself() {
    for (dimension, count) in [(2, 1), (2, 25), (3, 1), (3, 40)] {
        let contacts = touches(dimension, count);
        let settings = Settings { reach: 0.0, ..Settings::new(dimension, KERNEL, BALL, 1e-3) };
        let (ours, exact) =
            (Experts::fit(settings, &contacts).unwrap(), dense(dimension, &contacts));
        let points = asked(dimension, 60);
        for i in 0..points.len() {
            let p = &points[i..=i];
            assert!((ours.means(p)[0] - exact.means(p)[0]).abs() < 1e-9);
            assert!((ours.gradients(p)[0] - exact.gradients(p)[0]).norm() < 1e-7);
            assert!((ours.variances(p)[0] - exact.variances(p)[0]).abs() < 1e-11);
            assert!((ours.deviations(p)[0] / exact.deviations(p)[0] - 1.0).abs() < 1e-4);
        }
    }
}

/// Errors of the mean in units of the dense deviation, and ratios of deviations.
fn compared(dimension: usize, count: usize) -> (Vec<f64>, Vec<f64>, Experts) {
    let contacts = touches(dimension, count);
    let (ours, exact) = (experts(dimension, &contacts), dense(dimension, &contacts));
    let points = asked(dimension, 400);
    let ratio = |(a, b): (f64, f64)| (a / b).sqrt();
    let ratios: Vec<f64> =
        ours.variances(&points).into_iter().zip(exact.variances(&points)).map(ratio).collect();
    let scale = exact.variances(&points);
    let errors = ours.means(&points).into_iter().zip(exact.means(&points)).zip(scale);
    (errors.map(|((a, b), v)| (a - b).abs() / v.sqrt()).collect(), ratios, ours)
}

#[test]
fn many_experts_agree_with_the_dense_process() {
    for (dimension, count) in [(2, 150), (3, 300)] {
        let (errors, ratios, ours) = compared(dimension, count);
        assert!(ours.experts() > 4);
        let (median, worst) = (quantile(errors.clone(), 0.5), quantile(errors, 1.0));
        assert!(median < 0.1 && worst < 1.0, "{dimension}D errors {median} {worst}");
        let [low, middle, high] = [0.0, 0.5, 1.0].map(|q| quantile(ratios.clone(), q));
        assert!(
            low > 0.95 && (0.98..1.1).contains(&middle) && high < 1.5,
            "{dimension}D deviations {low} {middle} {high}"
        );
    }
}

#[test]
fn nothing_jumps_at_any_border() {
    for dimension in [2, 3] {
        let surface = experts(dimension, &touches(dimension, 200));
        let grid = surface.partition.grid();
        let leaves = surface.partition.nodes().iter().filter(|n| n.children.is_none());
        let (mut sides, mut steps) = (Vec::new(), Vec::new());
        for (i, leaf) in leaves.enumerate() {
            let (centre, side) = (grid.centre(&leaf.cell), grid.side(leaf.cell.level));
            // On every plane where a weight begins or ends, and the cell's own sides.
            for x in [-0.75, -0.5, -0.25, 0.25, 0.5, 0.75] {
                for axis in 0..dimension {
                    let mut p = centre;
                    for other in 0..dimension {
                        p[other] += side * 0.7 * ((i * 7 + other) as f64).sin();
                    }
                    p[axis] = centre[axis] + x * side;
                    let mut step = Point::zeros();
                    step[axis] = 1e-11;
                    sides.extend([p - step, p + step]);
                    steps.push(2e-11);
                }
            }
        }
        let (means, gradients) = (surface.means(&sides), surface.gradients(&sides));
        let variances = surface.variances(&sides);
        for (i, step) in steps.iter().enumerate() {
            let (a, b) = (2 * i, 2 * i + 1);
            let steepest = 1.0 + gradients[a].norm() + gradients[b].norm();
            assert!((means[a] - means[b]).abs() < 2.0 * steepest * step, "{:?}", sides[a]);
            assert!((gradients[a] - gradients[b]).norm() < 1e-4 * steepest, "{:?}", sides[a]);
            assert!((variances[a] - variances[b]).abs() < 0.1 * step + 1e-12);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn gradient_is_the_derivative_and_the_mixture_is_not_too_sure(
        p in proptest::array::uniform3(-0.08f64..0.08),
        count in 1usize..120,
    ) {
        let surface = experts(3, &touches(3, count));
        let p = Point::from(p);
        let gradient = surface.gradients(&[p])[0];
        for axis in 0..3 {
            let mut step = Point::zeros();
            step[axis] = 1e-6;
            let ends = surface.means(&[p + step, p - step]);
            prop_assert!(((ends[0] - ends[1]) / 2e-6 - gradient[axis]).abs() < 1e-3);
        }
        let variance = surface.variances(&[p])[0];
        let said = surface.partition.shares(&p).into_iter().map(|share| match share.leaf {
            Some(leaf) => {
                let fitted = surface.fitted(leaf);
                fitted.expert.variances(&surface.factor(leaf, &fitted), &[p])[0]
            }
            None => 0.025 * 0.025,
        });
        let least = said.fold(f64::INFINITY, f64::min);
        prop_assert!(variance >= least - 1e-15 && variance <= 1.01 * 0.025 * 0.025);
    }

    #[test]
    fn any_contacts_have_a_finite_answer(
        draws in proptest::collection::vec(
            (proptest::array::uniform3(-2i32..=2), proptest::array::uniform3(-1.0f64..1.0), any::<bool>()),
            1..60,
        ),
        scale in -4i32..=1,
        noise in -7i32..=0,
    ) {
        // On few points: coincident, with opposite normals, on one line or plane.
        let size = 10f64.powi(scale);
        let contacts: Vec<Contact> = draws
            .iter()
            .map(|(at, n, felt)| Contact {
                point: Point::from(at.map(f64::from)) * size,
                normal: felt.then(|| Point::from(*n).try_normalize(1e-3)).flatten(),
                point_deviation: size * 10f64.powi(noise),
                normal_deviation: 10f64.powi(noise),
            })
            .collect();
        let kernel = Kernel::Matern32 { amplitude: size, lengthscale: 2.0 * size };
        let prior = Prior::Ball { centre: Point::zeros(), radius: size };
        let settings = Settings::new(3, kernel, prior, size * 10f64.powi(noise));
        let surface = Experts::fit(settings, &contacts).unwrap();
        let points: Vec<Point> = contacts.iter().map(|c| c.point * 1.1).collect();
        prop_assert!(surface.means(&points).iter().all(|m| m.is_finite()));
        prop_assert!(surface.variances(&points).iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}

#[test]
fn a_thousand_equal_contacts_are_one_known_better() {
    let few = touches(3, 12);
    let many: Vec<Contact> = few.iter().flat_map(|c| std::iter::repeat_n(*c, 1000)).collect();
    let better: Vec<Contact> = few.iter().map(|c| c.with_noise(1000f64.sqrt().recip())).collect();
    let (ours, exact) = (experts(3, &many), dense(3, &better));
    assert_eq!((ours.contacts(), ours.sites()), (12_000, 12));
    let points = asked(3, 40);
    for (a, b) in ours.means(&points).into_iter().zip(exact.means(&points)) {
        assert!((a - b).abs() < 1e-8, "{a} {b}");
    }
    for (a, b) in ours.variances(&points).into_iter().zip(exact.variances(&points)) {
        assert!((a - b).abs() < 1e-10, "{a:e} {b:e}");
    }
}

#[test]
fn sites_and_experts_stay_bounded_while_contacts_stream_in() {
    let few = experts(3, &touches(3, 6_000));
    let many = experts(3, &touches(3, 60_000));
    assert!(many.sites() < 2 * few.sites(), "{} {}", few.sites(), many.sites());
    let points = asked(3, 200);
    let rows = |surface: &Experts| {
        let shares = points.iter().flat_map(|p| surface.partition.shares(p));
        shares.filter_map(|s| Some(surface.fitted(s.leaf?).expert.rows())).max().unwrap()
    };
    let most = rows(&many);
    assert!(most <= 1000, "{most}");
    let shares = points.iter().map(|p| many.partition.shares(p).len()).max().unwrap();
    assert!(shares <= 27, "{shares}");
    // Ten times the contacts, and the truth within what is left of the noise.
    let exact = |p: &Point| p.component_div(&Point::new(0.06, 0.03, 0.04)).norm() - 1.0;
    let on: Vec<Point> = points.iter().map(|p| p / (1.0 + exact(p))).collect();
    let off =
        |surface: &Experts| quantile(surface.means(&on).iter().map(|m| m.abs()).collect(), 0.5);
    assert!(off(&many) < 1.5e-4, "{} {}", off(&few), off(&many));
}

#[test]
fn inside_is_inside_where_the_prior_is_wrong() {
    // Corners of a box lie outside the ball, and the cells within have no site near them.
    let half = Point::new(0.06, 0.03, 0.03);
    let touch = |i: usize| {
        let share = |step: f64| 2.0 * (i as f64 * step).fract() - 1.0;
        let (axis, sign) = (i % 3, if i.is_multiple_of(2) { 1.0 } else { -1.0 });
        let mut at = Point::new(share(0.755), share(0.57), share(0.437));
        at[axis] = sign;
        let mut normal = Point::zeros();
        normal[axis] = sign;
        Contact {
            point: at.component_mul(&half),
            normal: Some(normal),
            point_deviation: 2e-4,
            normal_deviation: 0.035,
        }
    };
    let contacts: Vec<Contact> = (0..4000).map(touch).collect();
    let surface = Experts::fit(Settings::new(3, KERNEL, BALL, 2e-4), &contacts).unwrap();
    let mut points = Vec::new();
    for x in [-0.95, -0.85, -0.4, 0.3, 0.8] {
        for y in [-0.9, -0.5, 0.1, 0.8] {
            points.extend([-0.85, -0.2, 0.6, 0.9].map(|z| Point::new(x, y, z)));
        }
    }
    let inside: Vec<Point> = points.iter().map(|p| p.component_mul(&half)).collect();
    let means = surface.means(&inside);
    for (p, mean) in inside.iter().zip(means) {
        let depth = (half - p.abs()).min();
        assert!(mean < -0.2 * depth, "{p:?}: {mean}, {depth} deep");
    }
}

#[test]
fn sides_of_a_thin_wall_stay_apart() {
    let side = |x: f64, z: f64| Contact {
        point: Point::new(x, 0.0, 0.5e-3 * z),
        normal: Some(Point::new(0.0, 0.0, z)),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    };
    let wall: Vec<Contact> =
        (0..400).map(|i| side(2e-5 * f64::from(i), if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
    let surface = experts(3, &wall);
    let gradients =
        surface.gradients(&[Point::new(0.004, 0.0, 2e-3), Point::new(0.004, 0.0, -2e-3)]);
    assert!(gradients[0].z > 0.1 && gradients[1].z < -0.1, "{gradients:?}");
}

#[test]
fn the_same_contacts_in_the_same_order_give_the_same_bits() {
    let contacts = touches(3, 400);
    let points = asked(3, 100);
    let answer = |threads: usize, ask_between: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut surface = Experts::new(Settings::new(3, KERNEL, BALL, 1e-3)).unwrap();
            for (i, contact) in contacts.iter().enumerate() {
                surface.insert(contact).unwrap();
                if ask_between && i % 100 == 50 {
                    surface.variances(&points[..5]);
                }
            }
            if ask_between {
                surface.settle(|_, _| ());
            }
            let bits = |numbers: Vec<f64>| numbers.into_iter().map(f64::to_bits);
            bits(surface.means(&points)).chain(bits(surface.variances(&points))).collect::<Vec<_>>()
        })
    };
    let once = answer(1, false);
    assert_eq!(once, answer(3, false));
    assert_eq!(once, answer(2, true));
}

#[test]
fn a_point_gets_the_same_bits_alone_and_among_others() {
    let surface = experts(3, &touches(3, 300));
    let points = asked(3, 120);
    let (means, variances) = (surface.means(&points), surface.variances(&points));
    let together = surface.means_and_gradients(&points);
    for (i, p) in points.iter().enumerate() {
        assert_eq!(surface.means(&[*p])[0].to_bits(), means[i].to_bits());
        assert_eq!(surface.variances(&[*p])[0].to_bits(), variances[i].to_bits());
        assert_eq!(surface.means_and_gradients(&[*p])[0], together[i]);
        assert!((together[i].0 - means[i]).abs() < 1e-15);
    }
}

#[test]
fn factors_that_do_not_fit_are_made_anew_with_the_same_result() {
    let contacts = touches(2, 120);
    let settings = Settings::new(2, KERNEL, BALL, 1e-3);
    let roomy = Experts::fit(settings, &contacts).unwrap();
    let tight = Experts::fit(Settings { memory: 100_000, ..settings }, &contacts).unwrap();
    let points = asked(2, 50);
    assert_eq!(roomy.variances(&points), tight.variances(&points));
    assert!(tight.memory() <= 100_000 && roomy.memory() > 100_000);
}

#[test]
fn what_is_unusable_is_refused_by_name_and_changes_nothing() {
    let mut surface = experts(3, &touches(3, 20));
    let good = touches(3, 1)[0];
    let points = asked(3, 10);
    let before = surface.means(&points);
    let nan = Contact { point: Point::new(f64::NAN, 0.0, 0.0), ..good };
    let bent = Contact { normal: Some(Point::new(0.5, 0.0, 0.0)), ..good };
    let sure = Contact { point_deviation: 0.0, ..good };
    for bad in [nan, bent, sure] {
        assert!(matches!(
            surface.insert(&bad),
            Err(Error::Surface(SurfaceError::Contact { index: 20, .. }))
        ));
    }
    let far = Contact { point: Point::new(1e300, 0.0, 0.0), ..good };
    assert_eq!(surface.insert(&far), Err(Error::Far { index: 20 }));
    assert_eq!((surface.contacts(), surface.means(&points)), (20, before));

    let settings = Settings::new(3, KERNEL, BALL, 1e-3);
    let refused = |settings| Experts::new(settings).unwrap_err();
    let plate = Kernel::ThinPlate { amplitude: 0.03, range: 0.5 };
    assert_eq!(refused(Settings { kernel: plate, ..settings }), Error::ThinPlate);
    for settings in [
        Settings { dimension: 4, ..settings },
        Settings { noise: f64::NAN, ..settings },
        Settings { reach: -1.0, ..settings },
        Settings { most: 0, ..settings },
        Settings { prior: Prior::Constant(f64::INFINITY), ..settings },
    ] {
        assert!(matches!(refused(settings), Error::Surface(_)));
    }
}
