use nalgebra::Matrix3;
use proptest::prelude::*;

use super::*;
use crate::graph::joint::tangent::local;
use crate::sim::random::Random;
use crate::space::planar;

const NOISE: [f64; 2] = [1e-3, 0.0873];

fn touch(point: Point, normal: Point) -> Contact {
    Contact {
        point,
        normal: Some(normal.normalize()),
        point_deviation: NOISE[0],
        normal_deviation: NOISE[1],
    }
}

/// A contact on the face of that direction, so far along it.
fn on(normal: Point, along: [f64; 2], dimension: usize) -> Contact {
    let u = if dimension == 2 { Point::new(-normal.y, normal.x, 0.0) } else { normal.yzx() };
    let v = if dimension == 2 { Point::zeros() } else { normal.cross(&u) };
    let u = (u - normal * u.dot(&normal)).normalize();
    touch(normal * 0.03 + u * along[0] + v * along[1], normal)
}

fn directions(dimension: usize) -> Vec<Point> {
    let z = f64::from(u8::from(dimension == 3));
    vec![
        Point::x(),
        Point::new(-0.4, 1.0, 0.0).normalize(),
        Point::new(-0.7, -0.8, 0.2 * z).normalize(),
        Point::new(0.1, -0.3, 1.0).normalize() * z + Point::y() * (1.0 - z),
        Point::new(0.3, -0.9, -0.8 * z).normalize(),
    ]
}

/// Two grasps of the same faces at other places, the second moved.
fn planted(dimension: usize, along: &[f64], truth: &Pose) -> Vec<Pair> {
    let directions = directions(dimension);
    let one = |(i, n): (usize, &Point)| Pair {
        from: on(*n, [along[4 * i], along[4 * i + 1]], dimension),
        to: on(*n, [along[4 * i + 2], along[4 * i + 3]], dimension).transformed(truth),
        weight: 1.0,
    };
    directions.iter().enumerate().map(one).collect()
}

fn motion(dimension: usize, t: [f64; 6]) -> Pose {
    if dimension == 2 {
        planar(0.02 * t[0], 0.02 * t[1], 0.5 * t[5])
    } else {
        let scaled = [0.02 * t[0], 0.02 * t[1], 0.02 * t[2], 0.4 * t[3], 0.4 * t[4], 0.4 * t[5]];
        retract(&Pose::identity(), &Vector6::from(scaled))
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn planted_poses_are_recovered(
        spatial in any::<bool>(),
        along in proptest::collection::vec(-0.02f64..0.02, 20),
        by in proptest::array::uniform6(-1.0f64..1.0),
        off in proptest::array::uniform6(-1.0f64..1.0),
    ) {
        let dimension = if spatial { 3 } else { 2 };
        let truth = motion(dimension, by);
        let start = motion(dimension, off);
        let found = register(dimension, &planted(dimension, &along, &truth), start).unwrap();
        prop_assert!(local(&truth, &found.pose).norm() < 1e-7, "{:?}", found);
        prop_assert!(found.chi2 < 1e-9);
        let degrees = if spatial { 15.0 - 6.0 } else { 10.0 - 3.0 };
        prop_assert!((found.degrees - degrees).abs() < 1e-12);
    }

    #[test]
    fn a_pair_has_the_derivatives_it_says(
        by in proptest::array::uniform6(-1.0f64..1.0), k in 0usize..6,
        along in proptest::collection::vec(-0.02f64..0.02, 20),
    ) {
        let pairs = planted(3, &along, &Pose::identity());
        let one = checked(&pairs).unwrap()[3];
        let pose = motion(3, by);
        let fit = one.at(&pose);
        let h = 1e-6;
        let at = |h: f64| one.at(&retract(&pose, &Vector6::ith(k, h)));
        let slope = (at(h).off - at(-h).off) / (2.0 * h);
        prop_assert!((slope - fit.by_off[k]).abs() < 1e-7);
        let slope = (at(h).turned - at(-h).turned) / (2.0 * h);
        prop_assert!((slope - fit.by_turned.column(k)).norm() < 1e-7);
    }
}

/// Errors of the relative pose over noisy grasps, and the covariance reported on average.
fn errors(dimension: usize, runs: u64, twice: bool) -> (Vec<Vector6<f64>>, Matrix6<f64>, Vec<f64>) {
    let truth = motion(dimension, [0.3, -0.5, 0.2, 0.1, -0.2, 0.6]);
    let along: Vec<f64> = (0..20).map(|i| 0.015 * (1.7 * f64::from(i)).sin()).collect();
    let clean = planted(dimension, &along, &truth);
    let (mut found, mut reported, mut chi) = (Vec::new(), Matrix6::zeros(), Vec::new());
    for seed in 0..runs {
        let [mut random] = Random::streams(seed);
        let mut noisy = |c: &Contact| {
            let mut draw = || {
                let drawn = random.normal3();
                if dimension == 2 { Point::new(drawn.x, drawn.y, 0.0) } else { drawn }
            };
            let (shift, turn) = (draw() * NOISE[0], draw() * NOISE[1]);
            let n = c.normal.unwrap();
            let across = Matrix3::identity() - n * n.transpose();
            touch(c.point + shift, n + across * turn)
        };
        let mut pairs = Vec::new();
        for pair in &clean {
            let (from, to) = (noisy(&pair.from), noisy(&pair.to));
            if twice {
                // Two contacts on each face of the one grasp: two pairs that share the other.
                let second = noisy(&pair.from);
                let weight = 2.0 / 3.0;
                pairs.push(Pair { from: second, to, weight });
                pairs.push(Pair { from, to, weight });
            } else {
                pairs.push(Pair { from, to, weight: 1.0 });
            }
        }
        let one = register(dimension, &pairs, Pose::identity()).unwrap();
        found.push(local(&truth, &one.pose));
        reported += one.covariance / runs as f64;
        chi.push(one.chi2 / one.degrees);
    }
    (found, reported, chi)
}

#[test]
fn the_covariance_is_what_errors_have() {
    for (dimension, twice) in [(2, false), (3, false), (2, true)] {
        let runs = 300;
        let (found, reported, chi) = errors(dimension, runs, twice);
        let axes: &[usize] = if dimension == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
        for axis in axes {
            let square: f64 = found.iter().map(|e| e[*axis].powi(2)).sum::<f64>() / runs as f64;
            let ratio = (square / reported[(*axis, *axis)]).sqrt();
            assert!((0.75..1.35).contains(&ratio), "{dimension} {twice} axis {axis}: {ratio}");
        }
        let mean = chi.iter().sum::<f64>() / runs as f64;
        assert!((0.75..1.3).contains(&mean), "{dimension} {twice}: {mean}");
    }
}

#[test]
fn bad_pairs_are_told() {
    let start = Pose::identity();
    let along = vec![0.01; 20];
    let good = planted(2, &along, &start);
    let with = |change: fn(&mut Pair)| {
        let mut pairs = good.clone();
        change(&mut pairs[2]);
        register(2, &pairs, start)
    };
    assert_eq!(register(2, &[], start), Err(RegistrationError::Empty));
    assert_eq!(with(|p| p.to.normal = None), Err(RegistrationError::NoNormal { pair: 2 }));
    let number = Err(RegistrationError::Number { pair: 2 });
    assert_eq!(with(|p| p.from.point.x = f64::NAN), number);
    assert_eq!(with(|p| p.from.normal = Some(Point::zeros())), number);
    assert_eq!(with(|p| p.to.point_deviation = 0.0), number);
    assert_eq!(with(|p| p.weight = f64::INFINITY), number);
    let mut nowhere = start;
    nowhere.translation.x = f64::NAN;
    assert_eq!(register(2, &good, nowhere), Err(RegistrationError::Start));
    // Two sides, parallel: nothing holds the object along them.
    let sides = [Point::x(), -Point::x()].map(|n| Pair {
        from: on(n, [0.01, 0.0], 2),
        to: on(n, [-0.01, 0.0], 2),
        weight: 1.0,
    });
    assert_eq!(register(2, &sides, start), Err(RegistrationError::Unobservable));
    assert_eq!(register(3, &good, start), Err(RegistrationError::Unobservable));
}
