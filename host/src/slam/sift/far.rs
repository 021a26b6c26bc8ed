//! Contacts so far from all others that they are of something else.

use crate::slam::place::Placed;
use crate::space::Point;

/// Those of something else at most, and how many others there are for each of them at least.
const MOST: usize = 2;
const OTHERS: usize = 10;

/// How many times as far from the middle as all others one of them is at least: nearer to none of these than they are
/// to each other.
const FAR: f64 = 3.0;

/// Which contacts are not one or two that lie farther from all others than these reach, though the hand was there: most
/// of what their grasp felt is with the others. (One alone may be a finger that feels for the end of a rod.)
pub fn near(placed: &[Placed]) -> Vec<bool> {
    let all = vec![true; placed.len()];
    let point = |p: &Placed| Some(p.contact.checked()?.point);
    let usable: Vec<Point> = placed.iter().filter_map(point).collect();
    let middle = Point::from_fn(|axis, _| {
        let mut along: Vec<f64> = usable.iter().map(|p| p[axis]).collect();
        along.sort_by(f64::total_cmp);
        along.get(along.len() / 2).copied().unwrap_or_default()
    });
    let mut distances: Vec<f64> = usable.iter().map(|p| (p - middle).norm()).collect();
    distances.sort_by(f64::total_cmp);
    let count = distances.len();
    let first = (1..=MOST).rev().filter(|far| count >= far + far * OTHERS).find_map(|far| {
        let (others, first) = (distances[count - far - 1], distances[count - far]);
        (first > FAR * others).then_some(first)
    });
    let Some(first) = first else { return all };
    let is_near = |p: &Placed| (p.contact.point - middle).norm() < first;
    let is_there = |grasp: usize| {
        let (mut with, mut far) = (0, 0);
        for p in placed.iter().filter(|p| p.grasp == grasp) {
            *(if is_near(p) { &mut with } else { &mut far }) += 1;
        }
        with > far
    };
    placed.iter().map(|p| is_near(p) || !is_there(p.grasp)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::reference::Contact;

    /// Touches around a circle of 40 mm, four a grasp, and at these distances from its middle by the first grasp.
    fn circle(count: usize, far: &[f64]) -> Vec<Placed> {
        let touch = |angle: f64, radius: f64, grasp: usize| {
            let normal = Point::new(angle.cos(), angle.sin(), 0.0);
            let point = radius * normal;
            let (point_deviation, normal_deviation) = (1e-3, 0.09);
            let normal = Some(normal);
            Placed { contact: Contact { point, normal, point_deviation, normal_deviation }, grasp }
        };
        let own = (0..count).map(|i| touch(i as f64, 0.04, i / 4));
        own.chain(far.iter().zip([0.3, 2.0, 4.0]).map(|(far, at)| touch(at, *far, 0))).collect()
    }

    #[test]
    fn one_or_two_that_are_far_from_all_others_are_of_something_else() {
        let left = |count: usize, far: &[f64]| {
            near(&circle(count, far)).iter().filter(|near| !**near).count()
        };
        assert_eq!(left(24, &[]), 0);
        assert_eq!([left(24, &[0.3]), left(24, &[5e3]), left(24, &[0.3, 2.0])], [1, 1, 2]);
        // Near enough to be of the same object, too many, and too few others.
        assert_eq!([left(24, &[0.1]), left(30, &[0.3, 0.3, 0.3]), left(8, &[0.3])], [0, 0, 0]);
        assert!(near(&[]).is_empty());
        // What a hand felt that was there.
        let mut alone = circle(24, &[0.3]);
        alone[24].grasp = 6;
        assert!(near(&alone).iter().all(|near| *near));
    }
}
