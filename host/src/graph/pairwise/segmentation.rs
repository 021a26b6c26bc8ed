//! A planar outline as the straight segments it is about: Douglas and Peucker's simplification (thesis
//! 3.3.3.1), for closed outlines and independent of where they begin.

use crate::reference::Contact;
use crate::shape::Outline;
use crate::space::Point;

/// A contact lies on a segment within this many of its deviations from it, and its normal within as
/// many of its own.
const NEAR: f64 = 4.0;

/// Vertices that are looked at in search of the two farthest apart: that effort grows with the square.
const MOST: usize = 4000;

/// A straight part of the outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Counter-clockwise around the object, metres.
    pub ends: [Point; 2],
    /// Unit, out of the object.
    pub normal: Point,
}

/// Why an outline has no segments.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SegmentationError {
    /// How far the simplified outline may lie from the other.
    #[error("tolerance: expected a positive number of metres, found {found}")]
    Tolerance {
        /// What there is.
        found: f64,
    },
    /// A vertex is not a place.
    #[error("loop {number}, vertex {vertex}: expected finite coordinates")]
    Coordinate {
        /// From 0.
        number: usize,
        /// From 0.
        vertex: usize,
    },
}

/// The segments of an outline none of whose vertices lies more than `tolerance` metres off them, loop
/// after loop in the outline's order. Loops with fewer than three vertices have none.
///
/// # Errors
/// With a tolerance that is not positive or a vertex that is not finite.
pub fn segments(outline: &Outline, tolerance: f64) -> Result<Vec<Segment>, SegmentationError> {
    if !(tolerance > 0.0 && tolerance.is_finite()) {
        return Err(SegmentationError::Tolerance { found: tolerance });
    }
    let mut found = Vec::new();
    for (number, vertices) in outline.loops.iter().enumerate() {
        if let Some(vertex) = vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            return Err(SegmentationError::Coordinate { number, vertex });
        }
        let kept = simplified(vertices, tolerance);
        for (i, a) in kept.iter().enumerate() {
            let b = kept[(i + 1) % kept.len()];
            let [a, b] = [*a, b].map(|v| Point::new(v[0], v[1], 0.0));
            // The object is on the left.
            let along = b - a;
            if let Some(normal) = Point::new(along.y, -along.x, 0.0).try_normalize(1e-12) {
                found.push(Segment { ends: [a, b], normal });
            }
        }
    }
    Ok(found)
}

/// The vertices of a closed polygon that Douglas and Peucker keep, in their order, beginning with that of
/// least coordinates; empty where fewer than three are left.
///
/// The two vertices that lie farthest apart part the ring. A vertex without which everything would still
/// be near goes in the end, as one of these two may.
pub fn simplified(vertices: &[[f64; 2]], tolerance: f64) -> Vec<[f64; 2]> {
    let count = vertices.len();
    if count < 3 {
        return Vec::new();
    }
    let [start, middle] = farthest(vertices);
    // The ring from the start, closed.
    let at = |i: usize| vertices[(start + i) % count];
    let worst = |from: usize, to: usize| {
        let chord = [at(from), at(to)];
        let mut worst: Option<(f64, usize)> = None;
        for i in from + 1..to {
            let distance = off(&chord, &at(i));
            let better = |(most, j): (f64, usize)| {
                distance > most || distance == most && before(&at(i), &at(j))
            };
            if worst.is_none_or(better) {
                worst = Some((distance, i));
            }
        }
        worst
    };
    let middle = (middle + count - start) % count;
    let mut kept = vec![0, middle];
    let mut open = vec![(0, middle), (middle, count)];
    while let Some((from, to)) = open.pop() {
        if let Some((_, i)) = worst(from, to).filter(|w| w.0 > tolerance) {
            kept.push(i);
            open.push((from, i));
            open.push((i, to));
        }
    }
    kept.sort_unstable();
    kept.dedup();
    while kept.len() >= 3 {
        let without = |k: usize| {
            let before = kept[(k + kept.len() - 1) % kept.len()];
            let after = kept[(k + 1) % kept.len()];
            let to = if after > before { after } else { after + count };
            worst(before, to).map_or(0.0, |w| w.0)
        };
        let costs: Vec<f64> = (0..kept.len()).map(without).collect();
        let least = (0..kept.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        match least.filter(|k| costs[*k] <= tolerance) {
            Some(k) => _ = kept.remove(k),
            None => break,
        }
    }
    let mut kept: Vec<[f64; 2]> = kept.into_iter().map(at).collect();
    let first = (0..kept.len()).reduce(|a, b| if before(&kept[b], &kept[a]) { b } else { a });
    kept.rotate_left(first.unwrap_or(0));
    if kept.len() < 3 { Vec::new() } else { kept }
}

/// Two vertices farthest apart; of several such pairs the one with the least coordinates, so that it
/// does not matter where the polygon begins.
fn farthest(vertices: &[[f64; 2]]) -> [usize; 2] {
    let stride = vertices.len().div_ceil(MOST);
    let mut best = ([0, vertices.len() / 2], -1.0);
    for i in (0..vertices.len()).step_by(stride) {
        for j in (0..vertices.len()).step_by(stride) {
            let (a, b) = (&vertices[i], &vertices[j]);
            if i == j || before(b, a) {
                continue;
            }
            let apart = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
            let [least, next]: [usize; 2] = best.0;
            let earlier = || {
                before(a, &vertices[least]) || *a == vertices[least] && before(b, &vertices[next])
            };
            if apart > best.1 || apart == best.1 && earlier() {
                best = ([i, j], apart);
            }
        }
    }
    best.0
}

fn before(a: &[f64; 2], b: &[f64; 2]) -> bool {
    a[0] < b[0] || a[0] == b[0] && a[1] < b[1]
}

/// Distance of a point from a chord.
fn off([a, b]: &[[f64; 2]; 2], p: &[f64; 2]) -> f64 {
    let [a, b, p] = [a, b, p].map(|v| Point::new(v[0], v[1], 0.0));
    distance(&[a, b], &p)
}

fn distance([a, b]: &[Point; 2], p: &Point) -> f64 {
    let along = b - a;
    let length = along.norm_squared();
    let part = if length > 0.0 { ((p - a).dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
    (p - a - along * part).norm()
}

/// The segment that a contact (in the outline's frame) lies on, as far as `tolerance` and its deviations
/// allow; `None` where it lies on none, as a contact at a corner whose normal is between theirs.
pub fn assigned(segments: &[Segment], contact: &Contact, tolerance: f64) -> Option<usize> {
    let fit = |segment: &Segment| {
        let apart = distance(&segment.ends, &contact.point) / contact.point_deviation;
        let turned =
            contact.normal.map_or(0.0, |n| (n - segment.normal).norm() / contact.normal_deviation);
        let slack = tolerance / contact.point_deviation;
        (apart < NEAR + slack && turned < NEAR).then_some(apart.powi(2) + turned.powi(2))
    };
    let fits = segments.iter().enumerate().filter_map(|(i, s)| Some((fit(s)?, i)));
    fits.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| i)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A polygon with more vertices along its sides, each up to `rough` off them.
    fn fine(corners: &[[f64; 2]], between: usize, rough: f64) -> Vec<[f64; 2]> {
        let mut vertices = Vec::new();
        for (i, a) in corners.iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            let side = [b[0] - a[0], b[1] - a[1]];
            let length = side[0].hypot(side[1]);
            for k in 0..between {
                let part = k as f64 / between as f64;
                let sway = if k == 0 { 0.0 } else { rough * (7.0 * k as f64).sin() };
                let out = [side[1] / length * sway, -side[0] / length * sway];
                vertices.push([a[0] + part * side[0] + out[0], a[1] + part * side[1] + out[1]]);
            }
        }
        vertices
    }

    const RECTANGLE: [[f64; 2]; 4] = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]];

    fn hexagon() -> Vec<[f64; 2]> {
        let corner = |k: usize| std::f64::consts::FRAC_PI_3 * (k as f64 + 0.3);
        (0..6).map(|k| [0.045 * corner(k).cos(), 0.045 * corner(k).sin()]).collect()
    }

    fn touch(x: f64, y: f64, normal: Option<[f64; 2]>) -> Contact {
        Contact {
            point: Point::new(x, y, 0.0),
            normal: normal.map(|n| Point::new(n[0], n[1], 0.0)),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
        }
    }

    #[test]
    fn polygons_have_their_sides() {
        let lshape =
            [[0.0, 0.0], [0.09, 0.0], [0.09, 0.035], [0.035, 0.035], [0.035, 0.09], [0.0, 0.09]];
        for (corners, sides) in [(&RECTANGLE[..], 4), (&hexagon(), 6), (&lshape, 6)] {
            let outline = Outline { loops: vec![fine(corners, 40, 0.5e-3)] };
            let found = segments(&outline, 2e-3).unwrap();
            assert_eq!(found.len(), sides);
            for segment in &found {
                let near = |end: &Point| {
                    corners.iter().any(|c| (end - Point::new(c[0], c[1], 0.0)).norm() < 2e-3)
                };
                assert!(segment.ends.iter().all(near), "{segment:?}");
                let middle = (segment.ends[0] + segment.ends[1]) / 2.0;
                let outside = middle + segment.normal * 5e-3;
                assert!(crate::shape::Geometry::Outline(outline.clone()).distance(&outside) > 4e-3);
            }
        }
    }

    proptest! {
        #[test]
        fn it_does_not_matter_where_an_outline_begins(turn in 0usize..160, rough in 0.0f64..1e-3) {
            let vertices = fine(&RECTANGLE, 40, rough);
            let mut turned = vertices.clone();
            turned.rotate_left(turn);
            prop_assert_eq!(simplified(&vertices, 2e-3), simplified(&turned, 2e-3));
        }

        #[test]
        fn no_vertex_is_farther_off_than_allowed(
            radii in proptest::collection::vec(0.02f64..0.06, 3..60), tolerance in 1e-4f64..5e-3,
        ) {
            let count = radii.len() as f64;
            let angle = |k: usize| std::f64::consts::TAU * k as f64 / count;
            let vertices: Vec<[f64; 2]> =
                radii.iter().enumerate().map(|(k, r)| [r * angle(k).cos(), r * angle(k).sin()]).collect();
            let kept = simplified(&vertices, tolerance);
            prop_assert!(kept.iter().all(|v| vertices.contains(v)));
            for v in &vertices {
                let chords = (0..kept.len()).map(|i| [kept[i], kept[(i + 1) % kept.len()]]);
                let nearest = chords.map(|c| off(&c, v)).fold(f64::INFINITY, f64::min);
                prop_assert!(kept.is_empty() || nearest <= tolerance);
            }
        }
    }

    #[test]
    fn contacts_find_their_side_and_corners_none() {
        let outline = Outline { loops: vec![RECTANGLE.to_vec()] };
        let found = segments(&outline, 1e-3).unwrap();
        let on = |contact: Contact| assigned(&found, &contact, 1e-3).map(|i| found[i].normal);
        assert_eq!(on(touch(0.0605, 0.01, Some([1.0, 0.0]))), Some(Point::x()));
        // At a corner the normal decides, and one between those of the sides is of neither.
        assert_eq!(on(touch(0.06, 0.03, Some([0.05f64.sin(), 0.05f64.cos()]))), Some(Point::y()));
        assert_eq!(on(touch(0.06, 0.03, Some([0.5f64.sqrt(), 0.5f64.sqrt()]))), None);
        assert_eq!(on(touch(0.02, -0.029, None)), Some(-Point::y()));
        assert_eq!(on(touch(0.02, 0.0, Some([0.0, 1.0]))), None);
        assert_eq!(on(touch(f64::NAN, 0.0, Some([0.0, 1.0]))), None);
    }

    #[test]
    fn what_is_no_outline_is_told() {
        let outline = |vertices: &[[f64; 2]]| Outline { loops: vec![vertices.to_vec()] };
        assert_eq!(segments(&outline(&[]), 1e-3), Ok(vec![]));
        assert_eq!(segments(&outline(&RECTANGLE[..2]), 1e-3), Ok(vec![]));
        assert_eq!(segments(&outline(&[[0.0, 0.0]; 5]), 1e-3), Ok(vec![]));
        // All of it within the tolerance: nothing is left.
        assert_eq!(segments(&outline(&RECTANGLE), 1.0), Ok(vec![]));
        assert!(matches!(
            segments(&outline(&[[0.0, 0.0], [f64::NAN, 0.0], [0.0, 1.0]]), 1e-3),
            Err(SegmentationError::Coordinate { number: 0, vertex: 1 })
        ));
        for tolerance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(segments(&outline(&RECTANGLE), tolerance).is_err());
        }
    }
}
