//! Which contacts lie on one face: Appendix A of the thesis, made independent of their order.
//!
//! Its first step, by normals, took contacts in order of arrival; here every normal climbs to where
//! normals are densest (mean shift: Fukunaga and Hostetler 1975; Comaniciu and Meer 2002), and those
//! that arrive at one place are one cluster. Its second step parts a cluster where the shortest path
//! between two contacts leads over a third that is not in it; here two contacts of a cluster are
//! neighbours where no other contact lies in the ball about them (Gabriel and Sokal 1969) and they lie
//! on one plane, and a face is what neighbours connect.

use crate::reference::Contact;
use crate::space::Point;

/// Normals within this many of their deviations count as near, and no less or more than these angles
/// in radians.
const NEAR: f64 = 3.0;
const LEAST: f64 = 0.17;
const MOST: f64 = 0.45;

/// Climbs end after a few steps.
const STEPS: usize = 40;

/// Contacts of a face lie within this many deviations of one plane.
const COPLANAR: f64 = 4.0;

/// The face of every contact, from 0 on, the face with most contacts first; `None` for a contact without a
/// normal or with numbers that are not finite. The same for the same contacts in any order.
pub fn clusters(contacts: &[Contact]) -> Vec<Option<usize>> {
    let usable: Vec<usize> = canonical(contacts);
    let normal = |i: usize| contacts[i].normal.unwrap_or_default();
    let by_normal = directions(contacts, &usable);
    let mut faces: Vec<Vec<usize>> = Vec::new();
    for members in groups(usable.len(), |a, b| by_normal[a] == by_normal[b]) {
        let members: Vec<usize> = members.into_iter().map(|m| usable[m]).collect();
        let sum: Point = members.iter().map(|i| normal(*i)).sum();
        let Some(mean) = sum.try_normalize(1e-9) else { continue };
        let count = members.len() as f64;
        let doubt: f64 = members.iter().map(|i| contacts[*i].normal_deviation.powi(2)).sum();
        let linked = |a: usize, b: usize| {
            let (a, b) = (members[a], members[b]);
            coplanar(&contacts[a], &contacts[b], &mean, doubt / (count * count))
                && neighbours(contacts, &usable, a, b)
        };
        let parts = groups(members.len(), linked);
        faces.extend(parts.into_iter().map(|p| p.into_iter().map(|m| members[m]).collect()));
    }
    // Canonical order within a face came from the members; of faces, the first member decides.
    let place = |i: &usize| usable.iter().position(|u| u == i);
    faces.sort_by_key(|f| (usize::MAX - f.len(), f.iter().filter_map(place).min()));
    let mut labels = vec![None; contacts.len()];
    for (number, face) in faces.iter().enumerate() {
        for i in face {
            labels[*i] = Some(number);
        }
    }
    labels
}

/// The usable contacts, sorted by their numbers, so that sums come out the same in any order.
fn canonical(contacts: &[Contact]) -> Vec<usize> {
    let key = |i: usize| {
        let n = contacts[i].normal.unwrap_or_default();
        let p = contacts[i].point;
        [n.x, n.y, n.z, p.x, p.y, p.z]
    };
    let fine = |i: &usize| {
        let c = &contacts[*i];
        c.normal.is_some_and(|n| n.norm() > 0.5)
            && key(*i).iter().all(|v| v.is_finite())
            && c.point_deviation > 0.0
            && c.point_deviation.is_finite()
            && c.normal_deviation > 0.0
            && c.normal_deviation.is_finite()
    };
    let mut usable: Vec<usize> = (0..contacts.len()).filter(fine).collect();
    usable.sort_by(|a, b| {
        let pairs = key(*a).into_iter().zip(key(*b));
        pairs.map(|(a, b)| a.total_cmp(&b)).find(|o| o.is_ne()).unwrap_or(a.cmp(b))
    });
    usable
}

/// The number of each usable contact's cluster of normals.
fn directions(contacts: &[Contact], usable: &[usize]) -> Vec<usize> {
    let normals: Vec<Point> =
        usable.iter().map(|i| contacts[*i].normal.unwrap_or_default().normalize()).collect();
    let mut deviations: Vec<f64> = usable.iter().map(|i| contacts[*i].normal_deviation).collect();
    deviations.sort_by(f64::total_cmp);
    let usual = deviations.get(deviations.len() / 2).copied().unwrap_or(LEAST);
    let least = (NEAR * usual).clamp(LEAST, MOST).cos();
    let summits: Vec<Point> = normals
        .iter()
        .map(|start| {
            let mut at = *start;
            for _ in 0..STEPS {
                let sum: Point = normals.iter().filter(|n| n.dot(&at) > least).sum();
                let Some(next) = sum.try_normalize(1e-9) else { break };
                let settled = (next - at).norm() < 1e-12;
                at = next;
                if settled {
                    break;
                }
            }
            at
        })
        .collect();
    // Summits nearer than half the reach are one: the reach is of normals, which scatter more.
    let close = (0.5 * least.acos()).cos();
    let mut numbers = vec![0; summits.len()];
    let found = groups(summits.len(), |a, b| summits[a].dot(&summits[b]) > close);
    for (number, members) in found.iter().enumerate() {
        for m in members {
            numbers[*m] = number;
        }
    }
    numbers
}

/// Whether two contacts lie on one plane of this normal, whose own variance is in radians².
fn coplanar(a: &Contact, b: &Contact, normal: &Point, variance: f64) -> bool {
    let apart = b.point - a.point;
    let off = apart.dot(normal);
    let across = (apart.norm_squared() - off * off).max(0.0);
    let doubt = a.point_deviation.powi(2) + b.point_deviation.powi(2) + across * variance;
    off * off < COPLANAR.powi(2) * doubt
}

/// Whether no other contact lies in the ball whose diameter two contacts are.
fn neighbours(contacts: &[Contact], usable: &[usize], a: usize, b: usize) -> bool {
    let (p, q) = (contacts[a].point, contacts[b].point);
    usable
        .iter()
        .filter(|k| **k != a && **k != b)
        .all(|k| (p - contacts[*k].point).dot(&(q - contacts[*k].point)) >= 0.0)
}

/// Connected components of a graph, each in ascending order, by their first member.
fn groups(count: usize, linked: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut free: Vec<bool> = vec![true; count];
    let mut found = Vec::new();
    for first in 0..count {
        if !std::mem::replace(&mut free[first], false) {
            continue;
        }
        let mut members = vec![first];
        let mut open = vec![first];
        while let Some(one) = open.pop() {
            for other in 0..count {
                if free[other] && linked(one, other) {
                    free[other] = false;
                    members.push(other);
                    open.push(other);
                }
            }
        }
        members.sort_unstable();
        found.push(members);
    }
    found
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn touch(point: [f64; 3], normal: [f64; 3]) -> Contact {
        Contact {
            point: Point::from(point),
            normal: Some(Point::from(normal).normalize()),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    }

    /// So many contacts on a side about its middle, on a grid that noise has moved.
    fn side(middle: [f64; 3], u: [f64; 3], v: [f64; 3], count: usize, out: &mut Vec<Contact>) {
        let (middle, u, v) = (Point::from(middle), Point::from(u), Point::from(v));
        let normal = u.cross(&v).normalize();
        let number = out.len();
        for i in 0..count * count {
            let at = |k: usize| 2.0 * (k as f64 + 0.5) / count as f64 - 1.0;
            let sway = |k: f64| ((number + i) as f64 * k).sin();
            let p = middle + u * at(i % count) + v * at(i / count) + normal * (1e-3 * sway(7.1));
            let n =
                normal + u.normalize() * (0.08 * sway(3.3)) + v.normalize() * (0.08 * sway(5.7));
            out.push(touch(p.into(), n.into()));
        }
    }

    /// A box of 120 × 60 × 60 mm.
    fn cuboid(count: usize) -> Vec<Contact> {
        let (a, b, c) = (0.06, 0.03, 0.03);
        let mut all = Vec::new();
        side([a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c], count, &mut all);
        side([-a, 0.0, 0.0], [0.0, -b, 0.0], [0.0, 0.0, c], count, &mut all);
        side([0.0, b, 0.0], [-a, 0.0, 0.0], [0.0, 0.0, c], count, &mut all);
        side([0.0, -b, 0.0], [a, 0.0, 0.0], [0.0, 0.0, c], count, &mut all);
        side([0.0, 0.0, c], [a, 0.0, 0.0], [0.0, b, 0.0], count, &mut all);
        side([0.0, 0.0, -c], [-a, 0.0, 0.0], [0.0, b, 0.0], count, &mut all);
        all
    }

    /// The parts as sets of points, whatever their numbers.
    fn parts(contacts: &[Contact], labels: &[Option<usize>]) -> Vec<Vec<[u64; 3]>> {
        let count = labels.iter().flatten().max().map_or(0, |m| m + 1);
        let mut sets = vec![Vec::new(); count];
        for (c, label) in contacts.iter().zip(labels) {
            if let Some(l) = label {
                sets[*l].push([c.point.x, c.point.y, c.point.z].map(f64::to_bits));
            }
        }
        sets.iter_mut().for_each(|s| s.sort_unstable());
        sets
    }

    #[test]
    fn a_box_has_six_faces() {
        for count in [2, 3, 5] {
            let contacts = cuboid(count);
            let labels = clusters(&contacts);
            for (i, label) in labels.iter().enumerate() {
                let first = i / (count * count) * count * count;
                assert_eq!(*label, labels[first], "{count}: contact {i}");
            }
            let distinct: std::collections::BTreeSet<_> = labels.iter().flatten().collect();
            assert_eq!(distinct.len(), 6);
        }
    }

    #[test]
    fn two_faces_of_one_direction_are_two() {
        // A step: two treads at different heights, the riser between them.
        let mut step = Vec::new();
        side([-0.02, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.03, 0.0], 4, &mut step);
        side([0.02, 0.0, 0.03], [0.02, 0.0, 0.0], [0.0, 0.03, 0.0], 4, &mut step);
        let treads = clusters(&step);
        assert!(
            treads[..16].iter().all(|l| *l == treads[0])
                && treads[16..].iter().all(|l| *l == treads[16])
        );
        assert_ne!(treads[0], treads[16]);
        // Two treads of one height with a tower between them.
        let mut gap = Vec::new();
        side([-0.05, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.03, 0.0], 4, &mut gap);
        side([0.05, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.03, 0.0], 4, &mut gap);
        let open = clusters(&gap);
        assert_eq!(open[0], open[16], "nothing stands between them");
        side([-0.02, 0.0, 0.02], [0.0, -0.03, 0.0], [0.0, 0.0, 0.02], 5, &mut gap);
        side([0.02, 0.0, 0.02], [0.0, 0.03, 0.0], [0.0, 0.0, 0.02], 5, &mut gap);
        let parted = clusters(&gap);
        assert_ne!(parted[0], parted[16]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn their_order_does_not_matter(shuffle in Just((0..54usize).collect::<Vec<_>>()).prop_shuffle()) {
            let contacts = cuboid(3);
            let shuffled: Vec<Contact> = shuffle.iter().map(|i| contacts[*i]).collect();
            prop_assert_eq!(
                parts(&contacts, &clusters(&contacts)),
                parts(&shuffled, &clusters(&shuffled))
            );
        }
    }

    #[test]
    fn what_says_nothing_has_no_face() {
        assert!(clusters(&[]).is_empty());
        let good = touch([0.0; 3], [0.0, 0.0, 1.0]);
        let bad = [
            Contact { normal: None, ..good },
            Contact { point: Point::new(f64::NAN, 0.0, 0.0), ..good },
            Contact { normal: Some(Point::new(f64::INFINITY, 0.0, 0.0)), ..good },
            Contact { normal: Some(Point::zeros()), ..good },
            Contact { point_deviation: 0.0, ..good },
        ];
        let labels = clusters(&[bad[0], good, bad[1], bad[2], bad[3], bad[4], good]);
        assert_eq!(labels, [None, Some(0), None, None, None, None, Some(0)]);
    }
}
