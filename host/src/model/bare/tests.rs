use nalgebra::Rotation3;

use super::*;
use crate::sim::{Options, Touch, simulate};

/// Contacts drawn uniformly over an object, with a millimetre of noise; the true normals but for 5°.
fn felt(object: &str, contacts: usize, seed: u64) -> (usize, Vec<Contact>) {
    let options = Options {
        touch: Touch::Uniform,
        grasps: Some(1),
        contacts,
        seed,
        ..Options::new(object.parse().unwrap())
    };
    let log = simulate(&options).unwrap().log;
    let contact = |c: &crate::log::LoggedContact| Contact {
        point: c.point,
        normal: c.normal,
        point_deviation: 1e-3,
        normal_deviation: 0.087,
    };
    (log.dimension, log.grasps[0].contacts.iter().map(contact).collect())
}

fn bared(contacts: &[Contact]) -> Vec<Contact> {
    contacts.iter().map(|c| Contact { normal: None, ..*c }).collect()
}

/// Angles between felt and guessed normals, radians, in order of size, and the share within two deviations
/// per axis.
fn off(felt: &[Contact], guessed: &[Contact]) -> (Vec<f64>, f64) {
    let pairs = felt.iter().zip(guessed).map(|(a, b)| {
        let angle = a.normal.unwrap().angle(&b.normal.unwrap());
        (angle, angle <= 2.0 * b.normal_deviation.hypot(0.087))
    });
    let (mut angles, within): (Vec<f64>, Vec<bool>) = pairs.unzip();
    angles.sort_by(f64::total_cmp);
    let share = within.iter().filter(|w| **w).count() as f64 / within.len() as f64;
    (angles, share)
}

#[test]
fn points_alone_tell_where_a_surface_faces() {
    for (object, contacts, degrees) in [
        ("ellipse:0.1x0.06", 12, 12.0),
        ("rectangle:0.12x0.06", 30, 12.0),
        ("hexagon:0.045", 30, 14.0),
        ("lshape:0.09x0.09x0.035", 40, 14.0),
        ("sphere:0.08", 20, 12.0),
        ("cylinder:0.06x0.1", 60, 18.0),
        ("box:0.12x0.06x0.06", 80, 20.0),
    ] {
        let (mut medians, mut shares) = (Vec::new(), 0.0);
        for seed in 0..5 {
            let (dimension, felt) = felt(object, contacts, seed);
            let (angles, share) = off(&felt, &guessed(dimension, &bared(&felt)).unwrap());
            medians.push(angles[angles.len() / 2].to_degrees());
            shares += share / 5.0;
        }
        medians.sort_by(f64::total_cmp);
        assert!(medians[2] < degrees, "{object}: {medians:?}");
        assert!(shares > 0.55, "{object}: {shares}");
    }
}

/// More contacts than are sought together, with fingers in turn of which one in three feels normals.
#[test]
fn guesses_among_many_are_no_measurements() {
    let (dimension, felt) = felt("rectangle:0.12x0.06", 400, 2);
    for turn in 0..3 {
        let mut some = bared(&felt);
        for i in (turn..felt.len()).step_by(3) {
            // The other way round: what was felt says where outside is.
            let normal = felt[i].normal.map(|n| -n);
            some[i] = Contact { normal, normal_deviation: 0.02, ..felt[i] };
        }
        let with = guessed(dimension, &some).unwrap();
        for (i, guess) in with.iter().enumerate() {
            if i % 3 == turn {
                assert_eq!(*guess, some[i]);
            } else {
                assert!(guess.normal_deviation >= 0.1, "{}", guess.normal_deviation);
            }
        }
        let inward = with
            .iter()
            .zip(&felt)
            .filter(|(guess, felt)| guess.normal.unwrap().dot(&felt.normal.unwrap()) < 0.0);
        assert!(inward.count() > 380);
    }
}

#[test]
fn felt_normals_stay_and_help() {
    let (dimension, felt) = felt("lshape:0.09x0.09x0.035", 24, 3);
    let mut some = bared(&felt);
    for (i, contact) in some.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        *contact = felt[i];
    }
    let with = guessed(dimension, &some).unwrap();
    for i in (0..felt.len()).step_by(3) {
        assert_eq!(with[i], felt[i]);
    }
    let mean = |guess: &[Contact]| off(&felt, guess).0.iter().sum::<f64>();
    assert!(mean(&with) < mean(&guessed(dimension, &bared(&felt)).unwrap()));
}

#[test]
fn how_the_frame_lies_does_not_matter() {
    for object in ["rectangle:0.12x0.06", "box:0.12x0.06x0.06"] {
        let (dimension, felt) = felt(object, 30, 1);
        let axis = if dimension == 2 { Point::z() } else { Point::new(0.3, 0.5, -0.8) };
        let turn = Rotation3::new(axis * 0.7);
        let moved = |c: &Contact| Contact { point: turn * c.point, ..*c };
        let bare = bared(&felt);
        let lying: Vec<Contact> = bare.iter().map(moved).collect();
        let (here, there) =
            (guessed(dimension, &bare).unwrap(), guessed(dimension, &lying).unwrap());
        for (a, b) in here.iter().zip(&there) {
            assert!((turn * a.normal.unwrap() - b.normal.unwrap()).norm() < 1e-3, "{object}");
            assert!((a.normal_deviation - b.normal_deviation).abs() < 1e-3);
        }
    }
}

#[test]
fn more_contacts_than_are_solved_together_get_theirs_too() {
    let (dimension, felt) = felt("ellipse:0.1x0.06", 400, 2);
    let (angles, _) = off(&felt, &guessed(dimension, &bared(&felt)).unwrap());
    assert!(angles[200].to_degrees() < 10.0 && angles[390].to_degrees() < 40.0, "{angles:?}");
}

#[test]
fn what_says_nothing_stays_as_it_is() {
    let bare = |x: f64, y: f64| Contact {
        point: Point::new(x, y, 0.0),
        normal: None,
        point_deviation: 1e-3,
        normal_deviation: 0.087,
    };
    let few = vec![bare(0.0, 0.0), bare(0.01, 0.0), bare(0.0, 0.01)];
    assert_eq!(guessed(2, &few), None);
    assert_eq!(guessed(4, &[few.clone(), few].concat()), None);
    assert_eq!(guessed(2, &[]), None);
    assert_eq!(guessed(2, &vec![bare(f64::NAN, 0.0); 9]), None);
    let felt = Contact { normal: Some(Point::x()), ..bare(0.0, 0.0) };
    assert_eq!(guessed(2, &[felt; 9]), None);
    // In one place, or in a row: whatever comes, it is finite and has length one.
    let row = (0..9).map(|i| bare(0.01 * f64::from(i), 0.0)).collect();
    for contacts in [vec![bare(0.02, 0.01); 9], row] {
        for dimension in [2, 3] {
            for contact in guessed(dimension, &contacts).unwrap_or_default() {
                assert!((contact.normal.unwrap().norm() - 1.0).abs() < 1e-9);
                assert!(contact.normal_deviation.is_finite());
            }
        }
    }
}
