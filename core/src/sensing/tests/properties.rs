//! What no word, force or setting may do, and what holds on every skin.

use proptest::prelude::*;

use super::*;

fn any_float() -> impl Strategy<Value = f32> {
    prop_oneof![any::<u32>().prop_map(f32::from_bits), -2.0f32..2.0, Just(0.0)]
}

fn any_vector() -> impl Strategy<Value = Vector<3>> {
    proptest::array::uniform3(any_float()).prop_map(Vector)
}

pub(super) fn shapes() -> [Shape; 4] {
    let mut matrix = Matrix::IDENTITY;
    *matrix.at_mut(0, 1) = 0.3;
    *matrix.at_mut(1, 0) = 0.3;
    [
        Shape::Sphere { radius: 8e-3 },
        Shape::Ellipsoid { half_axes: Vector([12e-3, 9e-3, 8e-3]) },
        Shape::CappedCylinder { radius: 8e-3, length: 0.02 },
        Shape::Quadric { matrix, linear: Vector([1e-3, 0.0, 2e-3]), constant: 6e-5 },
    ]
}

/// A unit vector.
fn direction() -> impl Strategy<Value = Vector<3>> {
    proptest::array::uniform3(-1.0f32..1.0)
        .prop_filter_map("no direction", |v| Vector(v).normalized())
}

proptest! {
    #[test]
    fn no_force_makes_locating_panic(force in any_vector(), moment in any_vector(), k in 0usize..4, edge in any::<bool>()) {
        let edge = edge.then_some(Edge { normal: Vector([1.0, 0.0, 0.0]), offset: 0.0 });
        let fingertip = Fingertip { shape: shapes()[k], edge };
        if let Ok(press) = locate(&fingertip, &Wrench { force, moment }) {
            prop_assert!(press.patch.point.is_finite() && press.push > 0.0);
            prop_assert!((press.patch.outward.norm() - 1.0).abs() < 1e-3, "{:?}", press);
            let _scatter = press.scatter(&Matrix::IDENTITY);
        }
    }

    #[test]
    fn no_words_make_an_estimator_panic(readings in proptest::collection::vec((any::<[i32; 6]>(), any::<u32>(), 0u32..64), 1..40)) {
        let mut bench = Bench::new(&settings());
        for (words, time, shift) in readings {
            let reading = GaugeReading(words.map(|w| w >> (shift % 32)));
            if let Ok(touch) = bench.0.estimate(&reading, time) {
                prop_assert!(touch.contact::<Spatial>(&SpatialPose::IDENTITY, 0).is_some(), "{:?}", touch);
            }
        }
    }

    #[test]
    fn no_words_make_electrodes_panic(readings in proptest::collection::vec((proptest::collection::vec(any::<u16>(), 19), any::<u32>(), 0u32..8), 1..40)) {
        let mut estimator = electrodes::tared();
        for (words, time, shift) in readings {
            let mut reading = ElectrodeReading::default();
            for (to, from) in reading.0.iter_mut().zip(&words) {
                *to = from >> shift;
            }
            if let Ok(touch) = estimator.estimate(&reading, time) {
                prop_assert!(touch.contact::<Spatial>(&SpatialPose::IDENTITY, 0).is_some(), "{:?}", touch);
            }
        }
    }

    #[test]
    fn no_matrix_makes_calibration_panic(matrix in proptest::collection::vec(any_float(), 36), low in any::<i32>(), high in any::<i32>(), words in proptest::array::uniform6(any_float())) {
        let rows = core::array::from_fn(|i| core::array::from_fn(|j| matrix[6 * i + j]));
        let gauges = GaugeCalibration::new(rows, (low, high), WrenchSettings::NANO17);
        if let Some(Ok(wrench)) = gauges.ok().map(|gauges| gauges.wrench(&words)) {
            prop_assert!(wrench.is_finite());
        }
    }

    #[test]
    fn a_push_is_found_on_every_shape(k in 0usize..4, at in direction(), along in direction(), slide in 0.0f32..0.8, twist in -1.5e-3f32..1.5e-3, newtons in 0.05f32..15.0) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let patch = fingertip.project(at * 0.012).unwrap();
        let tangent = along - patch.outward * patch.outward.dot(along);
        let force = (tangent * slide - patch.outward) * newtons;
        let moment = patch.point.cross(force) + patch.outward * (twist * newtons);
        let press = locate(&fingertip, &Wrench { force, moment });
        if !fingertip.covers(patch.point) {
            prop_assert!(press.is_err());
            return Ok(());
        }
        let press = press.unwrap();
        prop_assert!((press.patch.point - patch.point).norm() < 5e-6, "{:?} {:?}", press, patch);
        prop_assert!((press.torsion - twist * newtons).abs() < 5e-6 * newtons);
        prop_assert!((press.push - newtons).abs() < 1e-3 * newtons);
        // The same whatever the unit of force.
        let double = locate(&fingertip, &Wrench { force: force * 2.0, moment: moment * 2.0 }).unwrap();
        prop_assert!((double.patch.point - press.patch.point).norm() < 1e-7);
    }

    #[test]
    fn scatter_is_the_derivative(k in 0usize..4, at in direction(), along in direction(), twist in -1e-3f32..1e-3, component in 0usize..6) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let patch = fingertip.project(at * 0.012).unwrap();
        // Clear of the seam between cylinder and cap, where curvature jumps.
        prop_assume!(fingertip.covers(patch.point) && patch.point[0].abs() > 1e-3);
        let tangent = along - patch.outward * patch.outward.dot(along);
        let force = tangent * 0.4 - patch.outward;
        let moment = patch.point.cross(force) + patch.outward * twist;
        let here = locate(&fingertip, &Wrench { force, moment }).unwrap();
        let step = if component < 3 { 2e-2 } else { 2e-4 };
        let moved = |sign: f32| {
            let mut wrench = Wrench { force, moment };
            if component < 3 { wrench.force[component] += sign * step } else { wrench.moment[component - 3] += sign * step }
            locate(&fingertip, &wrench).unwrap().patch.point
        };
        prop_assume!(patch.point[0].abs() > 2e-3);
        let slope = (moved(1.0) - moved(-1.0)) * (0.5 / step);
        let mut noise = Matrix::<6>::ZERO;
        *noise.at_mut(component, component) = 1.0;
        let Scatter { point: [uu, uv, vv], .. } = here.scatter(&noise);
        let [u, v] = here.patch.tangents.map(|t| t.dot(slope));
        let size = 1e-9 + 0.02 * (uu + vv);
        prop_assert!((uu - u * u).abs() < size && (uv - u * v).abs() < size && (vv - v * v).abs() < size, "{} {} {} {} {}", uu, uv, vv, u, v);
    }

    #[test]
    fn projecting_lands_on_the_skin_at_a_right_angle(k in 0usize..4, at in direction(), far in 0.7f32..2.0) {
        let fingertip = Fingertip { shape: shapes()[k], edge: None }.checked().unwrap();
        let point = fingertip.project(at * 0.01).unwrap().point * far;
        let patch = fingertip.project(point).unwrap();
        prop_assert!(fingertip.height(patch.point).abs() < 1e-6);
        let away = point - patch.point;
        prop_assert!(away.cross(patch.outward).norm() < 2e-5, "{:?} {:?}", away, patch);
        let [u, v] = patch.tangents;
        prop_assert!((u.cross(v) - patch.outward).norm() < 1e-5);
    }
}

#[test]
fn quadrics_must_be_convex_and_real() {
    let quadric = |diagonal: [f32; 3], linear: [f32; 3], constant: f32| {
        let mut matrix = Matrix::ZERO;
        for k in 0..3 {
            *matrix.at_mut(k, k) = diagonal[k];
        }
        let shape = Shape::Quadric { matrix, linear: Vector(linear), constant };
        Fingertip { shape, edge: None }.checked().map(|_| ())
    };
    let refused = Err(CalibrationError::NotConvex);
    assert_eq!(quadric([1.0, 1.0, 1.0], [0.0; 3], 6e-5), Ok(()));
    assert_eq!(quadric([1.0, 1.0, 0.0], [0.0; 3], 6e-5), Ok(()), "a cylinder");
    assert_eq!(quadric([1.0, 2.0, 0.0], [0.0, 0.0, 5e-3], 0.0), Ok(()), "a paraboloid");
    assert_eq!(quadric([1.0, 1.0, -1.0], [0.0; 3], 6e-5), refused, "a hyperboloid");
    assert_eq!(quadric([1.0, 0.0, 0.0], [0.0; 3], 6e-5), refused, "a slab");
    assert_eq!(quadric([1.0, 1.0, 1.0], [0.0; 3], -6e-5), refused, "nothing");
    assert_eq!(quadric([0.0; 3], [0.0; 3], 0.0), refused);
    assert_eq!(quadric([f32::NAN, 1.0, 1.0], [0.0; 3], 1.0), Err(CalibrationError::NotFinite));
}

/// A paraboloid and a cylinder have no closed form here: both are found by Newton's method alone.
#[test]
fn open_quadrics_are_found_too() {
    let mut matrix = Matrix::ZERO;
    *matrix.at_mut(1, 1) = 1.0;
    *matrix.at_mut(2, 2) = 1.5;
    // y² + 1.5 z² + 2·0.004 x = 0, open towards −x.
    let shape = Shape::Quadric { matrix, linear: Vector([4e-3, 0.0, 0.0]), constant: 0.0 };
    let tip = Fingertip { shape, edge: None }.checked().unwrap();
    let (y, z) = (3e-3, -2e-3);
    let patch = tip.patch(Vector([-(y * y + 1.5 * z * z) / 8e-3, y, z]));
    assert!(tip.height(patch.point).abs() < 1e-8);
    let force = patch.outward * -2.0 + patch.tangents[0] * 0.7;
    let moment = patch.point.cross(force) + patch.outward * 2e-3;
    let press = locate(&tip, &Wrench { force, moment }).unwrap();
    assert!((press.patch.point - patch.point).norm() < 2e-6, "{press:?}");
    assert!((press.torsion - 2e-3).abs() < 1e-5);
    // Straight out of its open end nothing touches.
    let out = Wrench { force: Vector([1.0, 0.0, 0.0]), moment: Vector::ZERO };
    assert_eq!(locate(&tip, &out), Err(NoContact::OutsideSkin));
}
