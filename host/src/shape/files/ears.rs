//! Faces of more than three corners as triangles.

use crate::space::{Point, across};

/// Corners up to which a face that is not convex is cut with care: that takes the square of their number, or more.
const MOST: usize = 2_000;

/// The triangles of a face that is not convex, as indices into its corners, which lie about a plane: ears are cut off
/// one after the other (Meisters, American Mathematical Monthly 82, 1975). `None` where a fan about the first corner
/// does as well, or where nothing does.
pub(super) fn cut(corners: &[Point]) -> Option<Vec<[usize; 3]>> {
    let count = corners.len();
    let first = *corners.first()?;
    let turn = |a: &Point, b: &Point, c: &Point| (b - a).cross(&(c - a));
    let fan = (2..count).map(|i| turn(&first, &corners[i - 1], &corners[i]));
    // Twice the area, across the face (Newell).
    let normal = fan.clone().sum::<Point>().try_normalize(0.0)?;
    if count > MOST || fan.clone().all(|area| area.dot(&normal) >= 0.0) {
        return None;
    }
    let [x, y] = across(3, &normal);
    let flat: Vec<[f64; 2]> =
        corners.iter().map(|p| [(p - first).dot(&x), (p - first).dot(&y)]).collect();
    let left = |[a, b, c]: [usize; 3]| {
        let [a, b, c] = [flat[a], flat[b], flat[c]];
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let mut ring: Vec<usize> = (0..count).collect();
    let mut triangles = Vec::with_capacity(count - 2);
    while ring.len() > 3 {
        let corner = |k: usize| {
            let last = ring.len() - 1;
            [if k == 0 { ring[last] } else { ring[k - 1] }, ring[k], ring[(k + 1) % ring.len()]]
        };
        let is_empty = |[a, b, c]: [usize; 3]| {
            let is_own = |p: &usize| [a, b, c].iter().any(|own| flat[*own] == flat[*p]);
            let is_outside =
                |p: usize| left([a, b, p]) < 0.0 || left([b, c, p]) < 0.0 || left([c, a, p]) < 0.0;
            ring.iter().all(|p| is_own(p) || is_outside(*p))
        };
        let is_ear = |k: &usize| left(corner(*k)) > 0.0 && is_empty(corner(*k));
        let is_straight = |k: &usize| left(corner(*k)) == 0.0;
        let all = 0..ring.len();
        let ear = all.clone().find(is_ear).or_else(|| all.clone().find(is_straight))?;
        triangles.push(corner(ear));
        ring.remove(ear);
    }
    triangles.push([ring[0], ring[1], ring[2]]);
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Areas of the triangles of a face whose corners lie so in a plane, along its normal.
    fn areas(corners: &[[f64; 2]], x: Point, y: Point) -> Option<Vec<f64>> {
        let points: Vec<Point> = corners.iter().map(|[u, v]| x * *u + y * *v).collect();
        let area = |[a, b, c]: [usize; 3]| {
            (points[b] - points[a]).cross(&(points[c] - points[a])).dot(&x.cross(&y)) / 2.0
        };
        Some(cut(&points)?.into_iter().map(area).collect())
    }

    #[test]
    fn a_face_with_a_notch_is_cut_whichever_corner_is_first() {
        let mut ell = vec![[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
        let mut cuts = 0;
        for _ in 0..ell.len() {
            for (x, y) in
                [(Point::x(), Point::y()), (Point::y(), Point::x()), (Point::z(), Point::x())]
            {
                // A fan does where its middle sees all corners.
                let Some(areas) = areas(&ell, x, y) else { continue };
                cuts += 1;
                assert!(areas.len() == 4 && areas.iter().all(|area| *area >= 0.0), "{areas:?}");
                assert!((areas.iter().sum::<f64>() - 3.0).abs() < 1e-12);
            }
            ell.rotate_left(1);
        }
        assert!(cuts >= 3, "{cuts}");
    }

    #[test]
    fn what_is_convex_or_nothing_is_left_to_a_fan_and_what_crosses_itself_comes_to_an_end() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert!(areas(&square, Point::x(), Point::y()).is_none());
        assert!(cut(&[]).is_none() && cut(&[Point::zeros(); 5]).is_none());
        let crossed = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [-3.0, 0.2]];
        assert!(areas(&crossed, Point::x(), Point::y()).is_none_or(|areas| areas.len() == 3));
    }

    proptest! {
        /// Stars about a middle, from any first corner.
        #[test]
        fn stars_are_covered_once(
            radii in prop::collection::vec(0.1..1.0f64, 5..40), first in 0usize..40,
        ) {
            let count = radii.len();
            let corner = |i: usize| {
                let (sin, cos) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
                [radii[i] * cos, radii[i] * sin]
            };
            let corners: Vec<[f64; 2]> = (0..count).map(|i| corner((i + first) % count)).collect();
            let around = |i: usize| {
                let [a, b] = [corners[i], corners[(i + 1) % count]];
                (a[0] * b[1] - a[1] * b[0]) / 2.0
            };
            let whole: f64 = (0..count).map(around).sum();
            if let Some(areas) = areas(&corners, Point::x(), Point::y()) {
                prop_assert_eq!(areas.len(), count - 2);
                prop_assert!(areas.iter().all(|area| *area > -1e-12));
                prop_assert!((areas.iter().sum::<f64>() - whole).abs() < 1e-9);
            }
        }
    }
}
