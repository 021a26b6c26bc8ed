//! What a grasp would teach about the shape, in double precision: the yardstick of
//! [`tactile_core::explore`].
//!
//! Mutual information of the contacts and the shape with the pose a nuisance, in expectation over which
//! of the fingers meet the object, and the sum of variances of thesis 4.20.

use nalgebra::{DMatrix, Matrix6, Vector6};

use super::Gpis;
use crate::sim::touch::Stroke;
use crate::space::{Point, Pose};

/// A face that somebody has told of, object frame: independent of the pose and of the other faces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldFace {
    /// Unit, out of the object.
    pub normal: Point,
    /// A point on it, the one place where it was touched.
    pub centre: Point,
    /// Standard deviation along the normal there, metres.
    pub deviation: f64,
    /// Standard deviation of the normal, radians per axis.
    pub tilt: f64,
}

/// What is believed of the shape.
#[derive(Clone, Copy, Debug)]
pub enum Shape<'a> {
    /// A convex body between faces, closed by a ball about the places where they were touched.
    Faces(&'a [ToldFace]),
    /// A Gaussian process.
    Surface(&'a Gpis, &'a [Point]),
}

/// What is believed of the next grasp.
#[derive(Clone, Copy, Debug)]
pub struct Foresight<'a> {
    /// 2 or 3.
    pub dimension: usize,
    /// See there; the second part of `Surface` are the places that were touched.
    pub shape: Shape<'a>,
    /// Object to world.
    pub pose: Pose,
    /// Its covariance at the next grasp, in object axes, translation then rotation.
    pub covariance: Matrix6<f64>,
    /// Standard deviation of a contact's point, metres.
    pub noise: f64,
}

/// How surfaces stray where nothing was touched: s and ℓ of a Matérn-3/2 process, metres.
const STRAY: (f64, f64) = (0.03, 0.1);

/// Least radius of the ball, metres.
const LEAST_RADIUS: f64 = 0.02;

/// A contact to be expected, object frame.
#[derive(Clone, Copy, Debug)]
struct Met {
    point: Point,
    normal: Point,
    depth: f64,
    share: f64,
    face: Option<usize>,
    /// Distance from what was touched, metres; of a Gaussian process the slope.
    extra: f64,
}

impl Foresight<'_> {
    /// Nats about the shape, and the sum of variances in square metres, that the hand at `hand` (hand to
    /// world) would give when its fingers close along `strokes` (hand frame).
    pub fn worth(&self, hand: &Pose, strokes: &[Stroke]) -> (f64, f64) {
        let frame = self.pose.inverse() * hand;
        let met: Vec<Met> = strokes
            .iter()
            .filter_map(|s| {
                let start = (frame * nalgebra::Point3::from(s.start)).coords;
                let direction = frame.rotation * s.direction;
                match self.shape {
                    Shape::Faces(faces) => on_faces(faces, &start, &direction, s.travel),
                    Shape::Surface(surface, touched) => {
                        on_surface(surface, touched, &start, &direction, s.travel)
                    }
                }
            })
            .collect();
        if met.is_empty() {
            return (0.0, 0.0);
        }
        let shape = self.of_shape(&met);
        let n = met.len();
        let row = |m: &Met| {
            let turn = m.point.cross(&m.normal);
            Vector6::new(m.normal.x, m.normal.y, m.normal.z, turn.x, turn.y, turn.z)
        };
        let pose =
            DMatrix::from_fn(n, n, |i, j| row(&met[i]).dot(&(self.covariance * row(&met[j]))));
        let chance = |i: usize| {
            let deviation = (shape[(i, i)] + pose[(i, i)]).max(0.0).sqrt().max(1e-6);
            met[i].share * normal_below(met[i].depth / deviation)
        };
        let chances: Vec<f64> = (0..n).map(chance).collect();
        let variances = (0..n).map(|i| chances[i] * shape[(i, i)]).sum();
        (self.expected(&shape, &pose, &chances, &mut Vec::new()), variances)
    }

    /// Expected information, by taking one contact after the other to come about or not.
    fn expected(
        &self,
        shape: &DMatrix<f64>,
        pose: &DMatrix<f64>,
        chances: &[f64],
        taken: &mut Vec<usize>,
    ) -> f64 {
        let next = shape.nrows() - chances.len();
        let Some((chance, rest)) = chances.split_first() else {
            let unit = self.noise.powi(-2);
            let n = taken.len();
            let one = |m: &DMatrix<f64>| {
                let part = DMatrix::from_fn(n, n, |i, j| unit * m[(taken[i], taken[j])]);
                0.5 * (DMatrix::identity(n, n) + part).determinant().ln()
            };
            return one(&(shape + pose)) - one(pose);
        };
        let without = self.expected(shape, pose, rest, taken);
        taken.push(next);
        let with = self.expected(shape, pose, rest, taken);
        taken.pop();
        chance * with + (1.0 - chance) * without
    }

    /// Covariance of the surface's distances at the contacts.
    fn of_shape(&self, met: &[Met]) -> DMatrix<f64> {
        match self.shape {
            Shape::Surface(surface, _) => {
                let points: Vec<Point> = met.iter().map(|m| m.point).collect();
                let (_, joint) = surface.joint(&points);
                let slope = |i: usize| met[i].extra;
                DMatrix::from_fn(met.len(), met.len(), |i, j| joint[(i, j)] / (slope(i) * slope(j)))
            }
            Shape::Faces(faces) => DMatrix::from_fn(met.len(), met.len(), |i, j| {
                let (a, b) = (&met[i], &met[j]);
                let of_face = match (a.face, b.face) {
                    (Some(f), Some(g)) if f == g => {
                        let face = &faces[f];
                        let across = |p: &Point| {
                            let away = p - face.centre;
                            away - face.normal * face.normal.dot(&away)
                        };
                        let lever = across(&a.point).dot(&across(&b.point));
                        face.deviation.powi(2) + face.tilt.powi(2) * lever
                    }
                    _ => 0.0,
                };
                let stray = |m: &Met| STRAY.0 * (1.0 - like(m.extra).powi(2)).max(0.0).sqrt();
                of_face + stray(a) * stray(b) * like((a.point - b.point).norm())
            }),
        }
    }
}

/// Correlation of the straying at a distance.
fn like(distance: f64) -> f64 {
    let r = 3f64.sqrt() * distance / STRAY.1;
    (1.0 + r) * (-r).exp()
}

/// Φ(z) by Simpson's rule.
fn normal_below(z: f64) -> f64 {
    let z = z.clamp(-9.0, 9.0);
    let density = |x: f64| (-0.5 * x * x).exp();
    let steps = 400;
    let h = z / steps as f64;
    let weight = |k: usize| match k {
        0 => 1.0,
        k if k == steps => 1.0,
        k if k % 2 == 1 => 4.0,
        _ => 2.0,
    };
    let sum: f64 = (0..=steps).map(|k| weight(k) * density(h * k as f64)).sum();
    0.5 + sum * h / 3.0 / std::f64::consts::TAU.sqrt()
}

/// Middle of some places and the greatest distance from it.
fn extent(places: impl Iterator<Item = Point> + Clone) -> (Point, f64) {
    let count = places.clone().count().max(1) as f64;
    let middle = places.clone().sum::<Point>() / count;
    (middle, places.map(|p| (p - middle).norm()).fold(LEAST_RADIUS, f64::max))
}

/// Where a line enters and leaves a ball.
fn through(middle: &Point, radius: f64, start: &Point, direction: &Point) -> Option<(f64, f64)> {
    let nearest = (middle - start).dot(direction);
    let off = (start + direction * nearest - middle).norm();
    (off < radius).then(|| {
        let half = (radius * radius - off * off).sqrt();
        (nearest - half, nearest + half)
    })
}

fn on_faces(faces: &[ToldFace], start: &Point, direction: &Point, travel: f64) -> Option<Met> {
    let height = |face: &ToldFace, p: &Point| face.normal.dot(&(p - face.centre));
    // The part of the line that is behind every face.
    let (mut enter, mut leave, mut entered) = (f64::NEG_INFINITY, travel, None);
    for (k, face) in faces.iter().enumerate() {
        let (above, slope) = (height(face, start), face.normal.dot(direction));
        if slope.abs() < 1e-6 {
            if above > 0.0 {
                return None;
            }
            continue;
        }
        let crossing = -above / slope;
        if slope > 0.0 {
            leave = leave.min(crossing);
        } else if crossing > enter {
            (enter, entered) = (crossing, Some(k));
        }
    }
    let begin = enter.max(0.0);
    if begin >= leave {
        return None;
    }
    let (middle, radius) = extent(faces.iter().map(|f| f.centre));
    let deepest = |from: f64, to: f64, ball: bool| {
        let inside = |k: usize| {
            let p = start + direction * (from + (to - from) * k as f64 / 8.0);
            let walls = faces.iter().map(|f| -height(f, &p)).fold(radius, f64::min);
            if ball { walls.min(radius - (p - middle).norm()) } else { walls }
        };
        (1..=8).map(inside).fold(0.0, f64::max)
    };
    let face = entered.map(|k| {
        let point = start + direction * begin;
        let away = (point - faces[k].centre).norm();
        Met {
            point,
            normal: faces[k].normal,
            depth: deepest(begin, leave.min(begin + 2.0 * radius), false),
            share: (-away / radius).exp(),
            face: Some(k),
            extra: away,
        }
    });
    let left = 1.0 - face.map_or(0.0, |f| f.share);
    let ball = through(&middle, radius, start, direction).and_then(|(first, last)| {
        let (from, to) = (first.max(0.0), last.min(leave));
        (first > enter && from < to).then(|| {
            let point = start + direction * from;
            let away = faces.iter().map(|f| (point - f.centre).norm());
            Met {
                point,
                normal: (point - middle).normalize(),
                depth: deepest(from, to, true),
                share: left,
                face: None,
                extra: away.fold(f64::INFINITY, f64::min),
            }
        })
    });
    match (face, ball) {
        (Some(face), Some(ball)) if ball.share > face.share => Some(ball),
        (face, ball) => face.or(ball),
    }
}

fn on_surface(
    surface: &Gpis,
    touched: &[Point],
    start: &Point,
    direction: &Point,
    travel: f64,
) -> Option<Met> {
    let (middle, radius) = extent(touched.iter().copied());
    let (first, last) = through(&middle, 1.5 * radius, start, direction)?;
    let (begin, end) = (first.max(0.0), last.min(travel));
    if begin >= end {
        return None;
    }
    let along: Vec<f64> = (0..=16).map(|k| begin + (end - begin) * f64::from(k) / 16.0).collect();
    let points: Vec<Point> = along.iter().map(|t| start + direction * *t).collect();
    let values = surface.means(&points);
    let inside = values.iter().position(|v| *v <= 0.0)?;
    let mut hit = along[inside];
    if inside > 0 {
        let (mut out, mut within) = (along[inside - 1], along[inside]);
        for _ in 0..60 {
            hit = 0.5 * (out + within);
            if surface.means(&[start + direction * hit])[0] > 0.0 {
                out = hit;
            } else {
                within = hit;
            }
        }
    }
    let point = start + direction * hit;
    let gradient = surface.gradients(&[point])[0];
    Some(Met {
        point,
        normal: gradient.try_normalize(1e-12).unwrap_or(-direction),
        depth: -values[inside..].iter().copied().fold(0.0, f64::min),
        share: 1.0,
        face: None,
        extra: gradient.norm().max(0.3),
    })
}
