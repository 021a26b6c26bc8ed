use std::boxed::Box;
use std::vec::Vec;

use proptest::prelude::*;

use super::face::Felt;
use super::proposal::{Prior, draw};
use super::*;
use crate::contact::{Contact, FreePoint};
use crate::matrix::{Square, Vector};
use crate::space::{Planar, PlanarPose, Space, Spatial, SpatialPose};

type Filter = RaoBlackwell<Planar, 64, 12, 16>;

fn filter(seed: u64) -> Box<Filter> {
    let mut filter = Box::new(Filter::new());
    filter.configure(MotionNoise::THESIS, seed);
    filter
}

fn contact<S: Space>(point: S::Vector, normal: S::Vector) -> Contact<S> {
    let normal = Some(normal);
    Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.0873, finger: 0 }
}

/// Contacts on a 100 × 60 mm rectangle at `pose`, two on every face, at parameters from `shift`.
fn touch(pose: &PlanarPose, shift: f32) -> Vec<Contact<Planar>> {
    [(0.05, [1.0, 0.0]), (0.03, [0.0, 1.0]), (0.05, [-1.0, 0.0]), (0.03, [0.0, -1.0])]
        .into_iter()
        .flat_map(|(half, n)| [-0.02, 0.015].map(|s| (half, Vector(n), s + shift)))
        .map(|(half, n, s)| {
            contact(pose.transform(n * half + Vector([-n[1], n[0]]) * s), pose.rotate(n))
        })
        .collect()
}

fn view<S: Space>(contacts: &[Contact<S>]) -> GraspView<'_, S> {
    GraspView { contacts, free: &[] }
}

/// The object turned about its middle by 20°, which then slipped.
fn turned(truth: &PlanarPose, slip: [f32; 3]) -> (PlanarPose, PlanarPose) {
    let middle = PlanarPose::from_translation(truth.translation());
    let meant = middle.compose(&PlanarPose::new(Vector::ZERO, 0.35)).compose(&middle.inverse());
    (meant, meant.compose(truth).retract(Vector(slip)))
}

fn slip(noise: &mut Random, part: f32) -> [f32; 3] {
    let v: Vector<3> = noise.normal();
    [0.01 * part * v[0], 0.01 * part * v[1], 0.349 * part * v[2]]
}

#[test]
fn follows_a_rectangle_and_knows_its_path() {
    let mut noise = Random::new(5);
    let mut filter = filter(3);
    let mut truth = PlanarPose::new(Vector([0.3, 0.1]), 0.2);
    let first = filter.update(None, view(&touch(&truth, 0.0)));
    assert_eq!((first.status, first.corrected, first.grasp), (Status::Started, false, 0));
    let gauge = truth.inverse().compose(&first.pose);
    let mut path = std::vec![truth];
    for k in 1..12 {
        let (meant, next) = turned(&truth, slip(&mut noise, 1.0));
        truth = next;
        path.push(truth);
        let estimate = filter.update(Some(&meant), view(&touch(&truth, 0.002 * (k % 4) as f32)));
        assert!(estimate.corrected && estimate.observability.is_full());
        let error = truth.compose(&gauge).local(&estimate.pose);
        assert!(error[0].hypot(error[1]) < 0.003, "{k}: {error:?}");
        assert!(error[2].abs() < 0.06, "{k}: {error:?}");
        assert!(error[2].powi(2) < 16.0 * estimate.covariance.at(2, 2) + 4e-4, "{k}: {error:?}");
    }
    for (k, truth) in (0..).zip(&path) {
        let error = truth.compose(&gauge).local(&filter.recall(k).unwrap());
        assert!(error[0].hypot(error[1]) < 0.003 && error[2].abs() < 0.06, "{k}: {error:?}");
    }
    assert_eq!(filter.recall(12), None);
    let mut sides: Vec<f32> = filter.shape().faces().iter().map(|f| f.offset()).collect();
    sides.sort_by(f32::total_cmp);
    assert_eq!(sides.len(), 4, "{sides:?}");
    for (side, want) in sides.iter().zip([0.03, 0.03, 0.05, 0.05]) {
        assert!((side - want).abs() < 0.003, "{sides:?}");
    }
}

#[test]
fn history_forgets_the_oldest_and_none_is_fine() {
    let mut short = Box::new(RaoBlackwell::<Planar, 16, 8, 2>::new());
    let mut none = Box::new(RaoBlackwell::<Planar, 16, 8, 0>::new());
    for k in 0..5 {
        let grasp = touch(&PlanarPose::IDENTITY, 0.001 * k as f32);
        short.update(None, view(&grasp));
        assert_eq!(none.update(None, view(&grasp)).grasp, k);
        assert!(none.recall(k).is_none());
    }
    assert!(short.recall(2).is_none() && short.recall(3).is_some() && short.recall(4).is_some());
    assert!(short.recall(5).is_none());
}

#[test]
fn wild_contacts_do_not_break_it() {
    for seed in 0..4 {
        let mut noise = Random::new(70 + seed);
        let mut filter = filter(seed);
        let mut truth = PlanarPose::IDENTITY;
        filter.update(None, view(&touch(&truth, 0.0)));
        for k in 1..10 {
            let (meant, next) = turned(&truth, slip(&mut noise, 0.7));
            truth = next;
            let mut grasp = touch(&truth, 0.002 * (k % 5) as f32);
            // One in eight: anywhere within 30 mm, with any normal.
            let wild = &mut grasp[k % 8];
            let (sin, cos) = math::sin_cos(6.0 * noise.uniform());
            wild.point += Vector([cos, sin]) * (0.03 * noise.uniform());
            wild.normal = Some(Vector([sin, cos]));
            let estimate = filter.update(Some(&meant), view(&grasp));
            let error = truth.local(&estimate.pose);
            assert!(error[0].hypot(error[1]) < 0.005, "{seed} {k}: {error:?}");
            assert!(error[2].abs() < 0.09, "{seed} {k}: {error:?}");
        }
    }
}

#[test]
fn an_object_that_is_gone_is_lost_then_found_and_its_shape_kept() {
    let mut filter = filter(1);
    for k in 0..4 {
        filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.001 * k as f32)));
    }
    let before: Vec<usize> = filter.particles().iter().map(|p| p.shape.faces().len()).collect();
    // Something else: a small thing with normals that no rectangle has.
    let strange: Vec<_> = [0.3f32, 1.0, 2.0, 2.9, 4.1, 5.3]
        .map(|a| {
            contact::<Planar>(Vector([0.01 * a.cos(), 0.01 * a.sin()]), Vector([a.cos(), a.sin()]))
        })
        .to_vec();
    for _ in 0..2 {
        let lost = filter.update(None, view(&strange));
        assert_eq!((lost.status, lost.corrected, lost.dropped), (Status::Lost, false, 0));
    }
    let after: Vec<usize> = filter.particles().iter().map(|p| p.shape.faces().len()).collect();
    assert_eq!(before, after);
    // The object again, 60 mm and 50° from where it was.
    let truth = PlanarPose::new(Vector([0.05, 0.033]), 0.87);
    let mut found = false;
    for k in 0..4 {
        let estimate = filter.update(None, view(&touch(&truth, 0.002 * k as f32)));
        let error = truth.local(&estimate.pose);
        found = error[0].hypot(error[1]) < 0.005 && error[2].abs() < 0.09;
        assert_eq!(found, estimate.corrected);
        if found {
            break;
        }
    }
    assert!(found);
}

#[test]
fn a_slip_far_beyond_the_noise_is_found_at_once() {
    let mut filter = filter(8);
    filter.configure(MotionNoise { translation: 1e-3, rotation: 0.03 }, 8);
    for k in 0..3 {
        filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.001 * k as f32)));
    }
    for (away, turned) in [(0.02, 0.5), (1.5, -0.1)] {
        let truth = PlanarPose::new(Vector([away, -0.025]), turned);
        let estimate = filter.update(None, view(&touch(&truth, 0.0)));
        let error = truth.local(&estimate.pose);
        assert!(estimate.corrected && error.norm() < 0.03, "{error:?}");
    }
}

#[test]
fn a_square_turned_by_half_of_its_symmetry_is_ambiguous() {
    let square = |pose: &PlanarPose| -> Vec<Contact<Planar>> {
        [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
            .into_iter()
            .flat_map(|n| [-0.015, 0.01].map(|s| (Vector(n), s)))
            .map(|(n, s)| {
                let point = pose.transform(n * 0.03 + Vector([-n[1], n[0]]) * s);
                contact(point, pose.rotate(n))
            })
            .collect()
    };
    let mut filter = filter(2);
    filter.configure(MotionNoise { translation: 0.005, rotation: 0.6 }, 2);
    filter.update(None, view(&square(&PlanarPose::IDENTITY)));
    let half = PlanarPose::new(Vector::ZERO, core::f32::consts::FRAC_PI_4);
    let estimate = filter.update(None, view(&square(&half)));
    assert_eq!(estimate.status, Status::Ambiguous, "{:?}", estimate.modes);
    let [first, second, ..] = estimate.modes.as_slice() else { panic!() };
    let between = first.pose.local(&second.pose)[2].abs();
    assert!((between - core::f32::consts::FRAC_PI_2).abs() < 0.15, "{between}");
}

#[test]
fn fingers_that_met_nothing_tell_where_the_object_is_not() {
    // Two long sides are known: sliding is free, but for a fingertip that met nothing at an end.
    let sides = |x: f32| -> Vec<Contact<Planar>> {
        [-0.04f32, -0.01, 0.02, 0.04]
            .into_iter()
            .flat_map(|s| [1.0, -1.0].map(|y| (s, y)))
            .map(|(s, y)| contact(Vector([s + x, 0.03 * y]), Vector([0.0, y])))
            .collect()
    };
    let mean = |free: &[FreePoint<Planar>]| {
        let mut filter = filter(4);
        filter.update(None, view(&sides(0.0)));
        filter.update(None, GraspView { contacts: &sides(0.0), free }).pose.translation()[0]
    };
    let free = [FreePoint { point: Vector([0.035, 0.022]), finger: 1 }];
    assert!(mean(&free) < mean(&[]) - 0.005, "{} {}", mean(&free), mean(&[]));
}

#[test]
fn points_without_normals_correct_the_pose() {
    let mut filter = filter(6);
    let bare = |pose: &PlanarPose, shift| {
        let mut contacts = touch(pose, shift);
        contacts.iter_mut().for_each(|c| c.normal = None);
        contacts
    };
    filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
    filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.003)));
    let truth = PlanarPose::new(Vector([0.006, -0.008]), 0.3);
    let estimate = filter.update(None, view(&bare(&truth, 0.001)));
    let error = truth.local(&estimate.pose);
    assert!(error[0].hypot(error[1]) < 0.003 && error[2].abs() < 0.05, "{error:?}");
}

#[test]
fn a_seed_repeats_to_the_bit() {
    let run = |seed| {
        let mut filter = filter(seed);
        filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0)));
        filter.update(None, view(&touch(&PlanarPose::new(Vector([0.01, 0.0]), 0.2), 0.004)))
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5).pose, run(6).pose);
}

#[test]
fn contacts_of_an_ideal_sensor_leave_faces_finite() {
    let mut filter = filter(3);
    let ideal = |contact: &Contact<Planar>| Contact {
        point_deviation: 1e-30,
        normal_deviation: 1e-30,
        ..*contact
    };
    for k in 0..3 {
        let contacts: Vec<_> =
            touch(&PlanarPose::IDENTITY, 0.001 * k as f32).iter().map(ideal).collect();
        filter.update(Some(&PlanarPose::IDENTITY), view(&contacts));
    }
    for face in filter.shape().faces() {
        assert!(face.centroid.is_finite() && face.normal.is_finite() && face.contacts > 2);
    }
}

#[test]
fn bad_contacts_are_counted_and_empty_grasps_only_predict() {
    let mut filter = filter(0);
    let empty = filter.update(None, view(&[]));
    assert!(empty.status == Status::Started && empty.pose == PlanarPose::IDENTITY);
    let mut contacts = touch(&PlanarPose::IDENTITY, 0.0);
    contacts[0].point[1] = f32::NAN;
    contacts[1].normal = Some(Vector([2.0, 0.0]));
    contacts[2].point_deviation = f32::INFINITY;
    let estimate = filter.update(None, view(&contacts));
    assert_eq!((estimate.contacts, estimate.rejected), (5, 3));
    let nowhere = PlanarPose::from_translation(Vector([f32::NAN, 0.0]));
    let free = [FreePoint { point: Vector([f32::NAN, 0.0]), finger: 0 }];
    let spread = filter.update(Some(&nowhere), GraspView { contacts: &[], free: &free });
    assert_eq!((spread.status, spread.corrected), (Status::Predicted, false));
    assert!(spread.covariance.at(0, 0) > 0.4e-4, "{spread:?}");
    // The same contact over and over, and more than there is room for.
    let same = std::vec![touch(&PlanarPose::IDENTITY, 0.0)[0]; 40];
    assert!(filter.update(None, view(&same)).pose.is_finite());
    let round: Vec<_> = (0..30)
        .map(|i| {
            let (sin, cos) = math::sin_cos(0.21 * i as f32);
            contact::<Planar>(Vector([0.05 * cos, 0.05 * sin]), Vector([cos, sin]))
        })
        .collect();
    for _ in 0..3 {
        assert!(filter.update(None, view(&round)).pose.is_finite());
    }
    let far = [contact::<Planar>(Vector([1e20, -1e20]), Vector([1.0, 0.0]))];
    assert!(filter.update(None, view(&far)).pose.is_finite());
    filter.set_motion_noise(MotionNoise { translation: 0.0, rotation: 0.0 });
    assert!(filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0))).pose.is_finite());
}

#[test]
fn a_new_filter_is_zero_and_works_unconfigured() {
    let filter = Box::new(Filter::new());
    let bytes = core::mem::size_of::<Filter>();
    assert!(core::mem::size_of::<RaoBlackwell<Planar, 64, 12, 0>>() < 29_000, "{bytes}");
    assert!(core::mem::size_of::<RaoBlackwell<Spatial, 64, 8, 0>>() < 34_000);
    let mut filter = filter;
    assert!(filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0))).pose.is_finite());
    assert!(filter.update(None, view(&touch(&PlanarPose::IDENTITY, 0.0))).pose.is_finite());
    filter.reset(4);
    assert!(filter.recall(0).is_none());
}

/// Contacts on a box of 120 × 60 × 60 mm.
fn hold(pose: &SpatialPose, shift: f32) -> Vec<Contact<Spatial>> {
    let mut contacts = Vec::new();
    for axis in 0..3 {
        for side in [1.0, -1.0] {
            let mut normal = Vector::ZERO;
            normal[axis] = side;
            let half = if axis == 0 { 0.06 } else { 0.03 };
            let mut along = Vector::ZERO;
            along[(axis + 1) % 3] = 0.01 + shift;
            along[(axis + 2) % 3] = -0.01 * side + shift;
            for along in [along, -along] {
                let point = pose.transform(normal * half + along);
                contacts.push(contact(point, pose.rotate(normal)));
            }
        }
    }
    contacts
}

#[test]
fn follows_a_box_in_space() {
    let mut noise = Random::new(9);
    let mut filter = Box::new(RaoBlackwell::<Spatial, 64, 8, 0>::new());
    let mut truth = SpatialPose::IDENTITY;
    filter.configure(MotionNoise { translation: 0.01, rotation: 0.2 }, 3);
    filter.update(None, view(&hold(&truth, 0.0)));
    for k in 1..8 {
        let v: Vector<6> = noise.normal();
        let slip =
            Vector([0.01 * v[0], 0.01 * v[1], 0.01 * v[2], 0.2 * v[3], 0.2 * v[4], 0.2 * v[5]]);
        truth = truth.retract(slip);
        let estimate = filter.update(None, view(&hold(&truth, 0.003 * (k % 4) as f32)));
        let e = truth.local(&estimate.pose).0;
        assert!(Vector([e[0], e[1], e[2]]).norm() < 0.004, "{k}: {e:?}");
        assert!(Vector([e[3], e[4], e[5]]).norm() < 0.09, "{k}: {e:?}");
    }
}

/// One known face of a planar object and one contact on it without a normal: along the face's
/// normal everything is linear and Gaussian, and the answer known.
#[test]
fn importance_weights_are_unbiased_where_the_answer_is_exact() {
    let mut shape = Shape::<Planar, 4>::NONE;
    for x in [-0.03, -0.01, 0.01, 0.03] {
        shape.learn(
            &Felt::at(
                &PlanarPose::IDENTITY,
                &contact::<Planar>(Vector([x, 0.03]), Vector([0.0, 1.0])),
            ),
            0,
        );
    }
    let seen = shape.view();
    // The motion's rotation is known to 0.1 mrad: only the translation along y matters.
    let noise = MotionNoise { translation: 0.01, rotation: 1e-4 };
    let prior = Prior::<Planar> { mean: PlanarPose::IDENTITY, noise };
    let felt =
        Contact { normal: None, ..contact::<Planar>(Vector([0.0, 0.036]), Vector([0.0, 1.0])) };
    let grasp = [felt];
    let mut random = Random::new(3);
    let (mut total, mut first, mut second) = (0.0f64, 0.0f64, 0.0f64);
    let draws = 20_000;
    for _ in 0..draws {
        let drawn = draw(&seen, &prior, &view(&grasp), &mut random, |k, random| {
            if k == 0 { prior.mean } else { prior.noise.disturb::<Planar>(&prior.mean, random) }
        })
        .unwrap();
        let weight = f64::from(drawn.log_weight).exp();
        let y = f64::from(drawn.pose.translation()[1]);
        total += weight;
        first += weight * y;
        second += weight * y * y;
    }
    // The posterior over y by quadrature: likelihood as the shape states it, prior N(0, 10 mm).
    let (mut want, mut moments) = (0.0f64, [0.0f64; 2]);
    let step = 1e-5;
    for i in -6000..6000 {
        let y = f64::from(i) * step;
        let pose = PlanarPose::from_translation(Vector([0.0, y as f32]));
        let likelihood = f64::from(seen.explain(&Felt::at(&pose, &felt)).log).exp();
        let density =
            (-0.5 * (y / 0.01).powi(2)).exp() / (0.01 * (2.0 * core::f64::consts::PI).sqrt());
        let weight = likelihood * density * step;
        want += weight;
        moments[0] += weight * y;
        moments[1] += weight * y * y;
    }
    let evidence = total / f64::from(draws);
    assert!((evidence / want - 1.0).abs() < 0.05, "{evidence} {want}");
    let (mean, square) = (first / total, second / total);
    assert!((mean - moments[0] / want).abs() < 1.5e-4, "{mean} {}", moments[0] / want);
    let deviation = (square - mean * mean).sqrt();
    let exact = (moments[1] / want - (moments[0] / want).powi(2)).sqrt();
    assert!((deviation / exact - 1.0).abs() < 0.1, "{deviation} {exact}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A face is the least squares plane of its contacts, whatever their order.
    #[test]
    fn faces_do_not_depend_on_the_order_of_contacts(
        heights in proptest::array::uniform6(-2e-3f32..2e-3),
        tilts in proptest::array::uniform6(-0.1f32..0.1),
    ) {
        let contacts: Vec<Felt<Planar>> = heights.iter().zip(tilts).enumerate().map(|(i, (h, t))| {
            let (sin, cos) = math::sin_cos(t);
            let at = Vector([0.012 * i as f32 - 0.03, 0.03 + h]);
            Felt::at(&PlanarPose::IDENTITY, &contact::<Planar>(at, Vector([-sin, cos])))
        }).collect();
        let fit = |order: &[usize]| {
            let mut face = Face::<Planar>::open(&contacts[order[0]], 0).unwrap();
            order[1..].iter().for_each(|&i| face.absorb(&contacts[i], 0));
            face
        };
        let (a, b) = (fit(&[0, 1, 2, 3, 4, 5]), fit(&[5, 0, 4, 2, 1, 3]));
        prop_assert!((a.normal - b.normal).norm() < 2e-3, "{:?} {:?}", a, b);
        prop_assert!((a.centroid - b.centroid).norm() < 1e-6);
        prop_assert!((a.scatter.at(0, 0) / b.scatter.at(0, 0) - 1.0).abs() < 0.06);
        // Least squares: slope from places, heights and normals together.
        let mean_x: f32 = (0..6).map(|i| 0.012 * i as f32 - 0.03).sum::<f32>() / 6.0;
        let mean_h: f32 = heights.iter().sum::<f32>() / 6.0;
        let (mut sxx, mut sxh, mut st) = (0.0, 0.0, 0.0);
        for i in 0..6 {
            let x = 0.012 * i as f32 - 0.03 - mean_x;
            sxx += x * x * 1e6;
            sxh += x * (heights[i] - mean_h) * 1e6;
            st += tilts[i] / 0.0873f32.powi(2);
        }
        let slope = (sxh + st) / (sxx + 6.0 / 0.0873f32.powi(2));
        prop_assert!((math::atan2(-a.normal[0], a.normal[1]) - slope).abs() < 4e-3, "{:?} {}", a.normal, slope);
    }

    /// Children carry the faces of their parents, each parent as many as its weight earns.
    #[test]
    fn resampling_is_fair_and_faces_go_with_their_particles(
        weights in proptest::array::uniform16(0.001f32..1.0),
        seed in 0u64..1000,
    ) {
        let mut filter = Box::new(RaoBlackwell::<Planar, 16, 4, 0>::new());
        filter.configure(MotionNoise::THESIS, seed);
        let total: f32 = weights.iter().sum();
        for (i, particle) in filter.particles.iter_mut().enumerate() {
            let offset = 0.01 * i as f32;
            particle.pose = PlanarPose::from_translation(Vector([i as f32, 0.0]));
            let felt = contact::<Planar>(Vector([offset, 0.0]), Vector([1.0, 0.0]));
            particle.shape.learn(&Felt::at(&PlanarPose::IDENTITY, &felt), 0);
            filter.weights[i] = weights[i] / total;
        }
        let before = filter.weights;
        if filter.resample_if_poor() {
            for (i, weight) in before.iter().enumerate() {
                let children = filter.parents.iter().filter(|&&p| usize::from(p) == i).count();
                prop_assert!((children as f32 - 16.0 * weight).abs() < 1.001);
            }
        }
        for (particle, &parent) in filter.particles.iter().zip(&filter.parents) {
            prop_assert_eq!(particle.pose.translation()[0], f32::from(parent));
            prop_assert!((particle.shape.faces()[0].offset() - 0.01 * f32::from(parent)).abs() < 1e-6);
        }
    }
}
