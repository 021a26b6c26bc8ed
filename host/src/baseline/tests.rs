use super::*;
use crate::reference::filter::{local, retract};
use crate::sim::{Options, simulate};
use crate::space::{Point, angle, planar};
use nalgebra::DVector;
use proptest::prelude::*;
use rand_xoshiro::rand_core::SeedableRng;

const PLANE: Motion = Motion { dimension: 2, translation: 0.004, rotation: 0.08 };

/// On a 120 × 60 mm ellipse, object frame.
fn touch(angle: f64) -> Contact {
    let (sin, cos) = angle.sin_cos();
    Contact {
        point: Point::new(0.06 * cos, 0.03 * sin, 0.0),
        normal: Some(Point::new(cos / 0.06, sin / 0.03, 0.0).normalize()),
        point_deviation: 1e-3,
        normal_deviation: 0.0873,
    }
}

fn surface(model: &Model) -> Gpis {
    let contacts: Vec<Contact> = (0..24).map(|i| touch(f64::from(i) * 0.262)).collect();
    Gpis::fit(2, model.kernel, (model.prior)(&contacts), model.training, &contacts).unwrap()
}

fn beliefs(motion: Motion) -> [(Box<dyn Belief>, &'static Model); 4] {
    [
        (Box::new(Literal::new(motion, 2000, 1)), &literal::MODEL),
        (Box::new(Kalman::new(motion, Transform::Linear)), &CALIBRATED),
        (Box::new(Kalman::new(motion, Transform::Unscented)), &CALIBRATED),
        (Box::new(Manifold::new(motion, 300, 1)), &CALIBRATED),
    ]
}

#[test]
fn every_belief_finds_a_slip_on_a_known_surface() {
    for (i, (mut belief, model)) in beliefs(PLANE).into_iter().enumerate() {
        let surface = surface(model);
        let start = planar(0.2, 0.1, 0.5);
        let motion = planar(0.02, -0.01, 0.3);
        belief.start(start);
        belief.predict(Some(&motion));
        let (predicted, doubt) = belief.mean();
        assert!(local(2, &(motion * start), &predicted).norm() < 0.01);
        assert!((doubt[(0, 0)].sqrt() / 0.004 - 1.0).abs() < 0.2, "{i}: {doubt}");
        let truth = retract(2, &(motion * start), &vec![0.004, -0.003, 0.07].into());
        let felt: Vec<Contact> =
            [0.1, 1.2, 2.5, 3.9, 5.0].iter().map(|a| touch(*a).transformed(&truth)).collect();
        assert!(belief.correct(&surface, &felt));
        let (pose, covariance) = belief.mean();
        let off = local(2, &truth, &pose);
        // The likelihood of the thesis has no scale: a distance of 10 mm is no less likely than e⁻¹.
        let (near, turn) = if i == 0 { (4e-3, 0.09) } else { (1.5e-3, 0.04) };
        assert!(off.rows(0, 2).norm() < near && off[2].abs() < turn, "{i}: {off}");
        assert!(covariance[(1, 1)] < doubt[(1, 1)], "{i}");
    }
}

#[test]
fn the_literal_weights_replace_and_the_gate_shuts() {
    let surface = surface(&literal::MODEL);
    let mut belief = Literal::new(PLANE, 50, 3);
    belief.start(Pose::identity());
    belief.predict(None);
    let felt: Vec<Contact> = (0..5).map(|i| touch(f64::from(i))).collect();
    assert!(belief.correct(&surface, &felt));
    let (once, _) = belief.mean();
    assert!(belief.correct(&surface, &felt));
    assert_eq!(belief.mean().0, once);
    let far: Vec<Contact> = felt.iter().map(|c| c.transformed(&planar(0.3, 0.0, 0.0))).collect();
    assert!(!belief.correct(&surface, &far));
    assert_eq!(belief.mean().0, once);
}

#[test]
fn the_literal_planar_mean_knows_no_seam() {
    let mut belief = Literal::new(PLANE, 500, 3);
    belief.start(planar(0.0, 0.0, 3.0));
    belief.predict(Some(&planar(0.0, 0.0, 0.2)));
    let turn = angle(&belief.mean().0);
    assert!((turn.rem_euclid(std::f64::consts::TAU) - 3.2).abs() < 0.02, "{turn}");
}

#[test]
fn drawn_poses_lie_on_the_manifold() {
    // One contact without noise worth mentioning: every moved pose must put it on the surface.
    let surface = surface(&CALIBRATED);
    let wide = Motion { dimension: 2, translation: 0.01, rotation: 0.3 };
    let mut belief = Manifold::new(wide, 400, 5);
    belief.start(Pose::identity());
    belief.predict(None);
    let felt = [Contact { point_deviation: 1e-4, ..touch(0.7) }];
    assert!(belief.correct(&surface, &felt));
    let (pose, covariance) = belief.mean();
    let at = surface.means(&[felt[0].transformed(&pose.inverse()).point])[0];
    assert!(at.abs() < 3e-3, "{at}");
    assert!(belief.effective() > 40.0, "{}", belief.effective());
    // Along the surface the motion's doubt remains.
    let normal = felt[0].normal.unwrap();
    let (across, along) = (
        DVector::from_vec(vec![normal.x, normal.y, 0.0]),
        DVector::from_vec(vec![-normal.y, normal.x, 0.0]),
    );
    let spread = |d: &DVector<f64>| (d.transpose() * &covariance * d)[0].sqrt();
    assert!(spread(&along) > 0.004, "{}", spread(&along));
    assert!(spread(&across) < spread(&along));
}

#[test]
fn every_baseline_follows_at_small_noise_and_repeats() {
    for (object, part) in [("rectangle:0.10x0.06", 0.25), ("box:0.12x0.06x0.06", 0.1)] {
        let options = Options { grasps: Some(5), seed: 4, ..Options::new(object.parse().unwrap()) };
        let motion_noise = crate::quantity::Deviation {
            length: options.motion_noise.length * part,
            angle: options.motion_noise.angle * part,
        };
        let log = simulate(&Options { motion_noise, ..options }).unwrap().log;
        for baseline in Baseline::ALL {
            let steps = match baseline {
                Baseline::Literal => literal(&log, 500, 2),
                other => other.follow(&log, 2),
            };
            assert_eq!(steps.len(), 5);
            assert_eq!(steps[0].status, Status::Started);
            let frame = log.grasps[0].truth.unwrap().inverse() * steps[0].pose;
            let error = (log.grasps[4].truth.unwrap() * frame).inverse() * steps[4].pose;
            let name = baseline.name();
            // The literal filter drifts even here.
            let slack = if baseline == Baseline::Literal { 2.5 } else { 1.0 };
            assert!(error.translation.vector.norm() < 0.012 * slack, "{object} {name}: {error}");
            assert!(error.rotation.angle() < 0.25 * slack, "{object} {name}: {error}");
            if baseline == Baseline::Manifold && log.dimension == 2 {
                assert_eq!(steps, baseline.follow(&log, 2));
                assert_ne!(steps, baseline.follow(&log, 3));
            }
        }
    }
}

#[test]
fn bad_numbers_are_counted_and_nothing_corrects_nothing() {
    let ellipse = Options::new("ellipse:0.1x0.06".parse().unwrap());
    let mut log = simulate(&Options { grasps: Some(3), ..ellipse }).unwrap().log;
    log.grasps[0].contacts[1].point.x = f64::NAN;
    log.grasps[1].contacts[0].normal = Some(Point::repeat(f64::INFINITY));
    for baseline in [Baseline::Extended, Baseline::Manifold] {
        let steps = baseline.follow(&log, 0);
        let counts: Vec<_> = steps.iter().map(|s| s.contacts).collect();
        assert_eq!(counts, [[4, 1, 0], [4, 1, 0], [5, 0, 0]], "{}", baseline.name());
        assert!(steps[2].pose.translation.vector.norm() < 0.1 && steps[2].corrected);
    }
    for (mut belief, model) in beliefs(PLANE) {
        belief.predict(None);
        assert!(!belief.correct(&surface(model), &[]));
    }
}

#[test]
fn grasps_of_nothing_only_predict() {
    let mut log =
        simulate(&Options { grasps: Some(3), ..Options::new("ellipse:0.1x0.06".parse().unwrap()) })
            .unwrap()
            .log;
    log.grasps[0].contacts.clear();
    log.grasps[2].contacts.clear();
    log.grasps[1].motion = None;
    for baseline in Baseline::ALL {
        let steps = match baseline {
            Baseline::Literal => literal(&log, 100, 0),
            other => other.follow(&log, 0),
        };
        assert_eq!(steps[1].status, Status::Started, "{}", baseline.name());
        assert_eq!(steps[2].status, Status::Predicted);
        assert!(steps.iter().all(|s| s.pose.translation.vector.iter().all(|x| x.is_finite())));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Both Kalman filters agree where the belief is narrow: the derivative is right.
    #[test]
    fn transforms_agree_on_narrow_beliefs(a in 0.0f64..6.0, x in -1.0f64..1.0, turn in -1.0f64..1.0) {
        let surface = surface(&CALIBRATED);
        let narrow = Motion { dimension: 2, translation: 1e-4, rotation: 2e-3 };
        let pose = planar(0.1, 0.2, 1.0);
        let truth = retract(2, &pose, &vec![1e-4 * x, 1e-4, 2e-3 * turn].into());
        let felt: Vec<Contact> = (0..3)
            .map(|i| Contact { point_deviation: 1e-4, ..touch(a + f64::from(i)) })
            .map(|c| c.transformed(&truth))
            .collect();
        let corrected = [Transform::Linear, Transform::Unscented].map(|transform| {
            let mut belief = Kalman::new(narrow, transform);
            belief.start(pose);
            belief.predict(None);
            assert!(belief.correct(&surface, &felt));
            belief.mean()
        });
        let [(a, p), (b, q)] = corrected;
        let off = local(2, &a, &b);
        prop_assert!(off.rows(0, 2).norm() < 2e-5 && off[2].abs() < 4e-4, "{off}");
        for i in 0..3 {
            prop_assert!((p[(i, i)] / q[(i, i)] - 1.0).abs() < 0.1, "{p} {q}");
        }
    }

    /// Few particles survive a strict vote, and each in its proportion.
    #[test]
    fn resampling_happens_when_half_are_idle(heavy in 0.0f64..1.0, seed in 0u64..50) {
        let mut weights = vec![(1.0 - heavy) / 19.0; 20];
        weights[7] = heavy;
        let chosen = resampled(&weights, &mut Xoshiro256PlusPlus::seed_from_u64(seed));
        let idle = effective(weights.iter().copied()) < 10.0;
        prop_assert_eq!(chosen.is_some(), idle);
        if let Some(chosen) = chosen {
            let copies = chosen.iter().filter(|i| **i == 7).count() as f64;
            prop_assert!((copies - 20.0 * heavy).abs() <= 1.0);
        }
    }
}
