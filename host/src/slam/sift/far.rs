//! Contacts so far from all others that they are of something else.

use crate::reference::Contact;
use crate::space::Point;

/// Those of something else at most, and how many others there are for each of them at least.
const MOST: usize = 2;
const OTHERS: usize = 10;

/// How many times as far from the middle as all others one of them is at least: nearer to none of these than they are
/// to each other.
const FAR: f64 = 3.0;

/// Which contacts are not one or two that lie farther from all others than these reach.
pub fn near(contacts: &[Contact]) -> Vec<bool> {
    let usable: Vec<Point> = contacts.iter().filter_map(|c| Some(c.checked()?.point)).collect();
    let middle = Point::from_fn(|axis, _| {
        let mut along: Vec<f64> = usable.iter().map(|p| p[axis]).collect();
        along.sort_by(f64::total_cmp);
        along.get(along.len() / 2).copied().unwrap_or_default()
    });
    let mut distances: Vec<f64> = usable.iter().map(|p| (p - middle).norm()).collect();
    distances.sort_by(f64::total_cmp);
    let count = distances.len();
    let least = (1..=MOST).filter(|far| count >= far + far * OTHERS).find_map(|far| {
        let (others, first) = (distances[count - far - 1], distances[count - far]);
        (first > FAR * others).then_some(first)
    });
    let is_near = |c: &Contact| least.is_none_or(|least| (c.point - middle).norm() < least);
    contacts.iter().map(is_near).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Touches around a circle of 40 mm, and at these distances from its middle.
    fn circle(count: usize, far: &[f64]) -> Vec<Contact> {
        let touch = |angle: f64, radius: f64| {
            let normal = Point::new(angle.cos(), angle.sin(), 0.0);
            Contact {
                point: radius * normal,
                normal: Some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.09,
            }
        };
        let own = (0..count).map(|i| touch(i as f64, 0.04));
        own.chain(far.iter().zip([0.3, 2.0, 4.0]).map(|(far, angle)| touch(angle, *far))).collect()
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
    }
}
