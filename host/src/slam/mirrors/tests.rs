use super::*;
use crate::model::mirror::images;
use crate::shape::{Outline, align, metrics};
use crate::sim::ObjectSpec;
use crate::slam::choose::{Choice, judge};
use crate::slam::fit::tests::touched;
use crate::slam::reconstruct::{self, Poses};

const TEE: &str = "tshape:0.1x0.08x0.03";

#[test]
fn a_tee_is_its_own_image() {
    let is_found = |seed: &u64| {
        let (dimension, contacts, _) = touched(TEE, 25, *seed);
        let Some(felt) = Mirrored::of(dimension, &contacts) else { return false };
        let Mirror { normal, offset } = felt.mirrors[0];
        normal.x.abs() > 0.99 && offset.abs() < 3e-3
    };
    let found = (3000..3010).filter(is_found).count();
    assert!(found >= 7, "{found} of 10");
}

#[test]
fn what_is_not_its_own_image_has_no_mirror() {
    let object = "corners:-0.05x-0.03,0.05x-0.04,0.02x0.04,-0.04x0.02";
    let is_taken = |seed: &u64| {
        let (dimension, contacts, _) = touched(object, 25, *seed);
        Mirrored::of(dimension, &contacts).is_some()
    };
    let taken = (3000..3010).filter(is_taken).count();
    assert!(taken <= 2, "{taken} of 10");
}

#[test]
fn mirrors_are_not_sought_at_poses_that_were_estimated() {
    let (dimension, contacts, _) = touched(TEE, 25, 3000);
    for (poses, mirrors) in [(Poses::Known, 1), (Poses::Estimated, 0)] {
        let choice = Choice::Gp;
        let made = reconstruct::shape(dimension, &contacts, &[], poses, choice, &|_, _| {});
        assert_eq!(made.unwrap().mirrors.len(), mirrors);
    }
}

#[test]
fn a_prism_has_two_mirrors() {
    let object = "tshape:0.1x0.08x0.03x0.05";
    let (dimension, contacts, _) = touched(object, 80, 3000);
    let felt = Mirrored::of(dimension, &contacts).unwrap();
    let [first, second] = [0, 1].map(|i| felt.mirrors[i].normal);
    assert!(first.dot(&second).abs() < 1e-9);
    assert!(first.y.abs() < 0.1 && second.y.abs() < 0.1, "{first} {second}");
    assert_eq!(felt.contacts.len(), 320);
}

#[test]
fn images_are_less_certain_than_contacts() {
    let (dimension, contacts, _) = touched(TEE, 25, 3000);
    let felt = Mirrored::of(dimension, &contacts).unwrap();
    let images = images(&felt.mirrors);
    assert_eq!(felt.contacts.len(), images.len() * contacts.len());
    let all = felt.contacts.chunks(contacts.len()).zip(&images);
    for (seen, image) in all {
        for (seen, contact) in seen.iter().zip(&contacts) {
            assert!((seen.point - image.point(&contact.point)).norm() < 1e-12);
            assert!(seen.point_deviation >= contact.point_deviation);
            assert!(seen.normal_deviation >= contact.normal_deviation);
        }
    }
    // By less than a millimetre where so many contacts speak for the mirror, but by something.
    let more = |c: &Contact| c.point_deviation > 1.02e-3 && c.point_deviation < 2e-3;
    assert!(felt.contacts[contacts.len()..].iter().filter(|c| more(c)).count() > 20);
}

/// Medians of the Hausdorff distance over seeds, metres: as it is, and of the contacts' own faces or surface.
fn errors(object: &str, contacts: usize) -> [f64; 2] {
    let truth = object.parse::<ObjectSpec>().unwrap().geometry().unwrap();
    let one = |seed: u64| {
        let (dimension, contacts, _) = touched(object, contacts, seed);
        let made =
            reconstruct::shape(dimension, &contacts, &[], Poses::Known, Choice::Auto, &|_, _| {})
                .unwrap();
        let alone = match judge(dimension, &contacts, &[]) {
            Ok((_, polytope)) => polytope.geometry,
            Err(_) => {
                let surface = crate::slam::fit::fit(dimension, &contacts, &[]).unwrap().surface;
                reconstruct::extract(dimension, &surface, &contacts).unwrap().0
            }
        };
        [made.geometry, alone].map(|shape| {
            let aligned = align::align(&shape, &truth);
            metrics::compare_at(&shape, &aligned, &truth).unwrap().hausdorff
        })
    };
    let all: Vec<[f64; 2]> = (3000..3009).into_par_iter().map(one).collect();
    [0, 1].map(|which| {
        let mut errors: Vec<f64> = all.iter().map(|errors| errors[which]).collect();
        errors.sort_by(f64::total_cmp);
        errors[4]
    })
}

#[test]
fn what_is_its_own_image_is_known_better() {
    let [made, alone] = errors("tshape:0.09x0.09x0.03", 15);
    assert!(made < 0.85 * alone, "{made} {alone}");
}

#[test]
fn images_cost_what_they_add() {
    let (dimension, contacts, _) = touched(TEE, 25, 3000);
    let felt = Mirrored::of(dimension, &contacts).unwrap();
    let rectangle = |times: f64| {
        let object = format!("rectangle:{}x{}", 0.1 * times, 0.05 * times);
        object.parse::<ObjectSpec>().unwrap().geometry().unwrap()
    };
    let alone = rectangle(1.0);
    assert!(felt.suits(&alone, &alone));
    // So many places are so much less likely on the larger surface.
    let touched = places(&contacts) as f64;
    let suits = |price: f64| felt.suits(&rectangle((price / touched).exp()), &alone);
    assert!(suits(felt.evidence - SURE - 0.1));
    assert!(!suits(felt.evidence - SURE + 0.1));
    let nothing = Geometry::Outline(Outline { loops: vec![] });
    assert!(!felt.suits(&nothing, &alone) && !felt.suits(&alone, &nothing));
}

#[test]
fn an_arm_is_not_added_where_contacts_would_have_fallen() {
    // As seen from these, an L may be a U whose other arm nobody touched.
    for seed in [3016, 3045] {
        let (dimension, contacts, _) = touched("lshape:0.12x0.06x0.03", 15, seed);
        assert!(Mirrored::of(dimension, &contacts).is_some());
        let choice = Choice::Auto;
        let made = reconstruct::shape(dimension, &contacts, &[], Poses::Known, choice, &|_, _| {});
        assert!(made.unwrap().mirrors.is_empty(), "{seed}");
    }
}

#[test]
fn arms_that_are_nearly_as_long_are_no_images_of_each_other() {
    // The process is smooth and takes them for such; the end of the shorter one says otherwise.
    for seed in [0, 2, 5] {
        let (dimension, contacts, _) = touched("lshape:0.0858x0.0754x0.0201", 40, seed);
        assert!(Mirrored::of(dimension, &contacts).is_some());
        let choice = Choice::Auto;
        let made = reconstruct::shape(dimension, &contacts, &[], Poses::Known, choice, &|_, _| {});
        assert!(made.unwrap().mirrors.is_empty(), "{seed}");
    }
}

#[test]
fn nonsense_has_no_mirror() {
    let (dimension, contacts, _) = touched(TEE, 25, 3000);
    assert!(Mirrored::of(dimension, &[]).is_none());
    assert!(Mirrored::of(dimension, &contacts[..1]).is_none());
    assert!(Mirrored::of(dimension, &vec![contacts[0]; 9]).is_none());
    let doubtful: Vec<Contact> =
        contacts.iter().map(|c| Contact { normal_deviation: 0.3, ..*c }).collect();
    assert!(Mirrored::of(dimension, &doubtful).is_none());
    let far: Vec<Contact> =
        contacts.iter().map(|c| Contact { point: c.point * f64::INFINITY, ..*c }).collect();
    assert!(Mirrored::of(dimension, &far).is_none());
    // Nor have so many that images would take long.
    let (_, many, _) = touched(TEE, 161, 3000);
    assert!(Mirrored::of(dimension, &many).is_none());
    let bare: Vec<Contact> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
    let felt = Mirrored::of(dimension, &bare).map(|felt| felt.contacts).unwrap_or_default();
    assert!(felt.iter().all(|c| c.checked().is_some()));
}
