//! How large a surface the faces make.
//!
//! Fingers touch anywhere on an object, so a contact's density on a surface of area A is 1/A: of two
//! sets of faces that explain the contacts, the one whose surface they cover is likelier than one that
//! reaches far beyond them (the size principle, Tenenbaum & Griffiths, Behavioral and Brain Sciences
//! 24, 2001). Without it the fewest faces win: a hexagon becomes a parallelogram around it.

use super::tangent::Face;
use crate::space::Point;

/// Surfaces are cut off so many times as far from the middle of the contacts as the farthest of them:
/// sides that nobody touched leave them open.
const OPEN: f64 = 2.0;

/// Corners of the polygon that stands for the cut.
const ROUND: usize = 16;

/// Length (dimension 2) or area (3) of the surface of the convex object between the faces, cut off
/// where nothing was touched; zero where there is none.
pub fn convex(dimension: usize, faces: &[Face], points: &[Point]) -> f64 {
    let count = points.len().max(1) as f64;
    let middle: Point = points.iter().sum::<Point>() / count;
    let reach = points.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max) * OPEN;
    let cuts = rounds(dimension, &smallest(dimension, faces, points).0);
    let cut = |normal: Point| Face { normal, offset: normal.dot(&middle) + reach };
    let planes: Vec<Face> = faces.iter().copied().chain(cuts.into_iter().map(cut)).collect();
    (0..planes.len()).map(|j| piece(dimension, &planes, j, &middle, 4.0 * reach)).sum()
}

/// Sides of the smallest box around the contacts of which one lies along a face, metres: whichever way the
/// frame lies. The last is zero in the plane.
pub fn sides(dimension: usize, faces: &[Face], points: &[Point]) -> [f64; 3] {
    smallest(dimension, faces, points).1
}

/// Axes of that box, and its sides.
fn smallest(dimension: usize, faces: &[Face], points: &[Point]) -> ([Point; 3], [f64; 3]) {
    let spanned = |axes: [Point; 3]| (axes, spans(dimension, &axes, points));
    let along = faces.iter().map(|face| spanned(frame(dimension, faces, face)));
    let size = |(_, sides): &([Point; 3], [f64; 3])| boxed(dimension, *sides);
    let least = along.min_by(|a, b| size(a).total_cmp(&size(b)));
    least.unwrap_or_else(|| spanned([Point::x(), Point::y(), Point::z()]))
}

/// Length or area of the surface of a box with these sides.
pub fn boxed(dimension: usize, [x, y, z]: [f64; 3]) -> f64 {
    if dimension == 2 { 2.0 * (x + y) } else { 2.0 * (x * y + y * z + z * x) }
}

/// By how much larger than the surface of a box with these sides the one is where the centre of a ball of
/// this radius (metres) can be that touches it: what Steiner's formula for the volume adds, by the radius.
pub fn rounding(dimension: usize, sides: [f64; 3], radius: f64) -> f64 {
    use std::f64::consts::TAU;
    if dimension == 2 {
        return TAU * radius;
    }
    TAU * sides.iter().sum::<f64>() * radius + 2.0 * TAU * radius * radius
}

/// Axes along a face's normal and, in space, the part across it of the normal that is squarest to it.
fn frame(dimension: usize, faces: &[Face], face: &Face) -> [Point; 3] {
    let first = face.normal;
    if dimension == 2 {
        return [first, Point::new(-first.y, first.x, 0.0), Point::z()];
    }
    let lean = |n: &Point| n.dot(&first).abs();
    let squarest = faces.iter().map(|f| f.normal).min_by(|a, b| lean(a).total_cmp(&lean(b)));
    let across = squarest.and_then(|n| (n - first * n.dot(&first)).try_normalize(0.1));
    let second = across.unwrap_or(face.tangents(dimension)[0]);
    [first, second, first.cross(&second)]
}

/// How far the points reach along these axes.
fn spans(dimension: usize, axes: &[Point; 3], points: &[Point]) -> [f64; 3] {
    std::array::from_fn(|i| {
        let along = points.iter().map(|p| axes[i].dot(p)).filter(|_| i < dimension);
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = along.fold(ends, |(low, high), at| (low.min(at), high.max(at)));
        (high - low).max(0.0)
    })
}

/// Outward directions of the planes that cut, about these axes.
fn rounds(dimension: usize, axes: &[Point; 3]) -> Vec<Point> {
    if dimension == 2 {
        let angle = |i: usize| (i as f64 * std::f64::consts::TAU / ROUND as f64).sin_cos();
        let turned = |(sine, cosine): (f64, f64)| axes[0] * cosine + axes[1] * sine;
        return (0..ROUND).map(|i| turned(angle(i))).collect();
    }
    axes.iter().flat_map(|axis| [*axis, -axis]).collect()
}

/// What the other half-spaces leave of plane `j`, within `reach` of the point on it that is nearest to the middle.
fn piece(dimension: usize, planes: &[Face], j: usize, middle: &Point, reach: f64) -> f64 {
    let face = &planes[j];
    let [t, u] = face.tangents(dimension);
    let foot = middle - face.normal * face.value(middle);
    let others = planes.iter().enumerate().filter(|(i, _)| *i != j).map(|(_, f)| f);
    if dimension == 2 {
        let (mut low, mut high) = (-reach, reach);
        for other in others {
            let (slope, value) = (other.normal.dot(&t), other.value(&foot));
            if slope > 1e-9 {
                high = high.min(-value / slope);
            } else if slope < -1e-9 {
                low = low.max(-value / slope);
            } else if value > 0.0 {
                return 0.0;
            }
        }
        return (high - low).max(0.0);
    }
    let mut polygon: Vec<Point> = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
        .map(|(a, b)| foot + t * (a * reach) + u * (b * reach))
        .to_vec();
    for other in others {
        polygon = clipped(&polygon, other);
        if polygon.len() < 3 {
            return 0.0;
        }
    }
    let fan =
        (2..polygon.len()).map(|i| (polygon[i - 1] - polygon[0]).cross(&(polygon[i] - polygon[0])));
    0.5 * fan.sum::<Point>().norm()
}

/// The part of a polygon below a plane (Sutherland & Hodgman 1974).
fn clipped(polygon: &[Point], plane: &Face) -> Vec<Point> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, b) in polygon.iter().enumerate() {
        let a = &polygon[(i + polygon.len() - 1) % polygon.len()];
        let (at_a, at_b) = (plane.value(a), plane.value(b));
        if (at_a > 0.0) != (at_b > 0.0) {
            kept.push(a + (b - a) * (at_a / (at_a - at_b)));
        }
        if at_b <= 0.0 {
            kept.push(*b);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces(normals: &[[f64; 3]], offset: f64) -> Vec<Face> {
        normals.iter().map(|n| Face { normal: Point::from(*n).normalize(), offset }).collect()
    }

    const CUBE: [[f64; 3]; 6] = [
        [1.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
    ];

    fn corners(half: f64) -> Vec<Point> {
        let sign = |bit: usize| if bit == 0 { -half } else { half };
        (0..8).map(|i| Point::new(sign(i & 1), sign(i & 2), sign(i & 4))).collect()
    }

    #[test]
    fn a_square_and_a_cube_have_their_own_size() {
        let square = faces(&CUBE[..4], 0.02);
        let flat: Vec<Point> = corners(0.02).iter().map(|p| Point::new(p.x, p.y, 0.0)).collect();
        assert!((convex(2, &square, &flat) - 0.16).abs() < 1e-12);
        assert!((convex(3, &faces(&CUBE, 0.02), &corners(0.02)) - 0.0096).abs() < 1e-12);
        assert!((boxed(3, sides(3, &faces(&CUBE, 0.02), &corners(0.02))) - 0.0096).abs() < 1e-12);
        assert!((boxed(2, sides(2, &square, &flat)) - 0.16).abs() < 1e-12);
    }

    /// However the object lies in its frame, and which faces were felt.
    #[test]
    fn a_box_about_contacts_turns_with_them() {
        for (dimension, axis) in [(2, Point::z()), (3, Point::new(1.0, -2.0, 0.5))] {
            let turn = nalgebra::Rotation3::new(axis.normalize() * 0.6);
            let points: Vec<Point> = corners(0.02)
                .iter()
                .map(|p| Point::new(p.x, 0.5 * p.y, if dimension == 2 { 0.0 } else { 2.0 * p.z }))
                .collect();
            let turned: Vec<Point> = points.iter().map(|p| turn * p).collect();
            for felt in [1, 4, 6] {
                let normals = if dimension == 2 { &CUBE[..felt.min(4)] } else { &CUBE[..felt] };
                let straight = faces(normals, 0.02);
                let lying: Vec<Face> =
                    straight.iter().map(|f| Face { normal: turn * f.normal, ..*f }).collect();
                let about = |faces: &[Face], points: &[Point]| {
                    boxed(dimension, sides(dimension, faces, points))
                };
                let (size, other) = (about(&straight, &points), about(&lying, &turned));
                let known = if dimension == 2 { 0.12 } else { 0.0112 };
                let tells = dimension == 2 || felt > 1;
                assert!(!tells || (size - known).abs() < 1e-12, "{size}");
                assert!(!tells || (other - known).abs() < 1e-12, "{other}");
                assert!(other >= known - 1e-12 && other < 2.0 * known, "{other}");
            }
        }
    }

    #[test]
    fn what_is_open_or_reaches_far_is_larger_and_finite() {
        for open in 1..6 {
            let size = convex(3, &faces(&CUBE[..open], 0.02), &corners(0.02));
            assert!(size > 0.011 && size < 0.2, "{open}: {size}");
        }
        // Without two opposite sides of a hexagon the others meet far outside.
        let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
        let normals: Vec<[f64; 3]> = (0..6).map(|i| [turn(i).1, turn(i).0, 0.0]).collect();
        let touched: Vec<Point> = normals.iter().map(|n| Point::from(*n) * 0.045).collect();
        let whole = convex(2, &faces(&normals, 0.04), &touched);
        let part: Vec<[f64; 3]> = [0, 1, 3, 4].map(|i| normals[i]).to_vec();
        assert!((whole - 6.0 * 0.08 / 3f64.sqrt()).abs() < 1e-12);
        assert!(convex(2, &faces(&part, 0.04), &touched) > 1.25 * whole);
    }

    /// Wherever the frame begins, and however it lies.
    #[test]
    fn what_is_open_is_as_large_elsewhere() {
        let turn = nalgebra::Rotation3::new(Point::new(0.4, -0.7, 0.3));
        let far = Point::new(1.0, 2.0, -1.5);
        for felt in [2, 4, 6] {
            let here = faces(&CUBE[..felt], 0.02);
            let moved = |f: &Face| {
                let normal = turn * f.normal;
                Face { normal, offset: f.offset + normal.dot(&far) }
            };
            let there: Vec<Face> = here.iter().map(moved).collect();
            let points: Vec<Point> = corners(0.02).iter().map(|p| turn * p + far).collect();
            let [a, b] = [convex(3, &here, &corners(0.02)), convex(3, &there, &points)];
            assert!((a - b).abs() < 1e-9, "{felt}: {a} {b}");
        }
        let flat = |far: Point| -> f64 {
            let square = faces(&CUBE[..4], 0.02);
            let moved = |f: &Face| Face { offset: f.offset + f.normal.dot(&far), ..*f };
            let points: Vec<Point> =
                corners(0.02).iter().map(|p| Point::new(p.x, p.y, 0.0) + far).collect();
            convex(2, &square.iter().map(moved).collect::<Vec<_>>(), &points)
        };
        assert!((flat(Point::new(3.0, -4.0, 0.0)) - 0.16).abs() < 1e-9);
    }

    /// As the volume of a ball's dilation grows (Steiner).
    #[test]
    fn a_ball_rounds_edges_and_corners() {
        let [a, b, c] = [0.1, 0.06, 0.05];
        let surface = boxed(3, [a, b, c]);
        let volume = |r: f64| {
            use std::f64::consts::PI;
            a * b * c + surface * r + PI * (a + b + c) * r * r + 4.0 / 3.0 * PI * r.powi(3)
        };
        let (r, h) = (8e-3, 1e-5);
        let grows = (volume(r + h) - volume(r - h)) / (2.0 * h);
        assert!((surface + rounding(3, [a, b, c], r) - grows).abs() < 1e-8);
    }

    #[test]
    fn nothing_has_no_size() {
        assert_eq!(sides(3, &[], &[]), [0.0; 3]);
        assert_eq!(sides(3, &faces(&CUBE, 0.02), &[]), [0.0; 3]);
        assert_eq!(convex(2, &faces(&CUBE[..4], 0.02), &[]), 0.0);
        // Two planes with their insides apart leave nothing between them.
        let apart = faces(&CUBE[..2], -0.01);
        assert_eq!(convex(2, &apart, &[Point::zeros()]), 0.0);
    }
}
