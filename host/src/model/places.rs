//! How many contacts say of a surface how large it is.
//!
//! Contacts that fall anywhere on a surface alike are each the less likely the larger it is (the size principle of
//! Tenenbaum and Griffiths, Behavioral and Brain Sciences 24, 2001). But whoever touches one place again and again does
//! not let them fall anywhere: together they say as little as one.

use crate::reference::Contact;

/// Deviations up to which two contacts are of one place.
const ONE: f64 = 2.5;

/// Most that count: as many as decide by how much a body explains contacts better than another, which more would
/// outweigh.
pub const MOST: usize = 60;

/// The number of places that were touched, at most [`MOST`].
pub fn places(contacts: &[Contact]) -> usize {
    let mut apart: Vec<&Contact> = Vec::new();
    for contact in contacts {
        if apart.len() == MOST {
            break;
        }
        if !apart.iter().any(|other| is_one(contact, other)) {
            apart.push(contact);
        }
    }
    apart.len()
}

/// Whether both are of one place, and of one side there.
fn is_one(contact: &Contact, other: &Contact) -> bool {
    let away = (contact.point - other.point).norm();
    let turned = match (contact.normal, other.normal) {
        (Some(one), Some(other)) => (one - other).norm(),
        _ => 0.0,
    };
    away < ONE * contact.point_deviation.hypot(other.point_deviation)
        && turned < ONE * contact.normal_deviation.hypot(other.normal_deviation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Point;

    fn touch(x: f64, normal: Option<Point>) -> Contact {
        let point = Point::new(x, 0.0, 0.0);
        Contact { point, normal, point_deviation: 1e-3, normal_deviation: 0.09 }
    }

    #[test]
    fn a_place_counts_once_however_often_it_was_touched() {
        assert_eq!(places(&[]), 0);
        let again: Vec<Contact> =
            (0..300).map(|i| touch(0.05 * f64::from(i % 3) + 1e-5 * f64::from(i), None)).collect();
        assert_eq!(places(&again), 3);
        let apart: Vec<Contact> = (0..20).map(|i| touch(0.01 * f64::from(i), None)).collect();
        assert_eq!(places(&apart), 20);
        let many: Vec<Contact> = (0..200).map(|i| touch(0.01 * f64::from(i), None)).collect();
        assert_eq!(places(&many), MOST);
    }

    #[test]
    fn both_sides_of_a_thin_plate_are_two_places() {
        let side = |way: f64| touch(0.0, Some(Point::y() * way));
        assert_eq!(places(&[side(1.0), side(-1.0), side(1.0)]), 2);
    }
}
