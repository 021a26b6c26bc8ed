//! How a simulated object is touched: by a hand of five fingers, or everywhere alike.

use std::f64::consts::PI;

use nalgebra::{Point3, Translation3, UnitQuaternion};

use super::random::Random;
use super::world::Options;
use crate::log::LoggedFree;
use crate::shape::Geometry;
use crate::space::{Point, Pose};

/// Names of the hand's fingers, first to little and thumb, as in a log's header.
pub const FINGERS: [&str; 5] = ["ff", "mf", "rf", "lf", "th"];

/// Where contacts come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Touch {
    /// Five-finger grasps: four fingers close from one side, the thumb opposes.
    Hand,
    /// Contacts drawn uniformly over the surface (thesis 2.2.2).
    Uniform,
}

/// The straight way of one fingertip when the hand closes.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// Index into [`FINGERS`].
    pub finger: usize,
    /// Where it starts, metres, hand frame (origin in the middle of the grasp, fingers on the side
    /// of +y, thumb on the side of −y).
    pub start: Point,
    /// Unit direction, hand frame.
    pub direction: Point,
    /// How far the fingertip can go, metres.
    pub travel: f64,
}

/// Sideways position (mm), height (mm, spatial hands only) and turn inwards (degrees) of the four
/// fingers, in the plane and in space.
const PLANAR: [[f64; 3]; 4] =
    [[-55.0, 0.0, 18.0], [-16.0, 0.0, 3.0], [16.0, 0.0, -3.0], [55.0, 0.0, -18.0]];
const SPATIAL: [[f64; 3]; 4] =
    [[-40.0, 20.0, 20.0], [-14.0, -15.0, 4.0], [14.0, 15.0, -4.0], [40.0, -20.0, -20.0]];

/// From the middle of the grasp to where fingertips start, and how far past it they can go, metres.
const STANDOFF: f64 = 0.14;
const PAST: f64 = 0.04;

/// Greatest height of the thumb above or below the middle in space, metres.
const THUMB_HEIGHT: f64 = 0.015;

/// Which fingers close when fewer than five are asked for: opposed ones first.
const ORDER: [usize; 5] = [1, 4, 0, 3, 2];

/// How well the hand is centred on the object, metres per axis, uniform.
const CENTRING: f64 = 0.012;

/// One contact without noise, object frame.
pub(super) struct Felt {
    pub(super) finger: Option<usize>,
    pub(super) point: Point,
    /// Outward, unit length.
    pub(super) normal: Point,
}

/// One closing of the hand that felt something.
pub(super) struct Closed {
    /// The middle of the grasp, world frame.
    pub(super) middle: Point,
    pub(super) felt: Vec<Felt>,
    pub(super) free: Vec<LoggedFree>,
}

/// A hand that always comes from the same side, and the object it closes on.
pub(super) struct Hand<'a> {
    touch: Touch,
    fingers: usize,
    geometry: &'a Geometry,
    uniform: Uniform<'a>,
    /// Object frame, and how far the object reaches from there.
    centre: Point,
    radius: f64,
    /// Hand to world.
    orientation: UnitQuaternion<f64>,
}

impl<'a> Hand<'a> {
    /// A hand whose side is drawn: any in the plane, in space any about z and up to 0.3 rad askew.
    pub(super) fn new(options: &Options, geometry: &'a Geometry, random: &mut Random) -> Self {
        let turn = match geometry.dimension() {
            2 => Point::new(0.0, 0.0, random.around_zero(PI)),
            _ => Point::from([0.3, 0.3, 3.0].map(|reach| random.around_zero(reach))),
        };
        let centre = geometry.centroid();
        let (low, high) = geometry.bounds();
        Hand {
            touch: options.touch,
            fingers: options.contacts,
            geometry,
            uniform: Uniform::new(geometry),
            centre,
            radius: (low - centre).abs().sup(&(high - centre).abs()).norm(),
            orientation: UnitQuaternion::from_scaled_axis(turn),
        }
    }

    /// Closes on the object at `pose`, centred on it within 12 mm; `None` when nothing is felt.
    pub(super) fn close(&self, pose: &Pose, random: &mut Random) -> Option<Closed> {
        let dimension = self.geometry.dimension();
        let offset = [0, 1, 2].map(|axis| match axis {
            2 if dimension == 2 => 0.0,
            _ => random.around_zero(CENTRING),
        });
        let middle = (pose * Point3::from(self.centre)).coords + Point::from(offset);
        let (felt, free): (Vec<Felt>, Vec<LoggedFree>);
        if self.touch == Touch::Uniform {
            let draws = (0..self.fingers).filter_map(|_| self.uniform.draw(random));
            felt = draws.map(|(point, normal)| Felt { finger: None, point, normal }).collect();
            free = Vec::new();
        } else {
            let hand = Pose::from_parts(Translation3::from(middle), self.orientation);
            let reach = self.radius + CENTRING * (dimension as f64).sqrt();
            let thumb = random.around_zero(if dimension == 3 { THUMB_HEIGHT } else { 0.0 });
            let strokes = strokes(dimension, self.fingers, reach, 1.0, thumb);
            (felt, free) = feel(self.geometry, pose, &hand, &strokes);
        }
        (!felt.is_empty()).then_some(Closed { middle, felt, free })
    }
}

/// What the fingers of the hand at `hand` (hand to world) feel of `geometry` at `pose` (object to
/// world) when they close along `strokes`: contacts in the object frame, and the ends of the strokes
/// that met nothing, in the world frame.
pub(super) fn feel(
    geometry: &Geometry,
    pose: &Pose,
    hand: &Pose,
    strokes: &[Stroke],
) -> (Vec<Felt>, Vec<LoggedFree>) {
    let (mut felt, mut free) = (Vec::new(), Vec::new());
    let frame = pose.inverse() * hand;
    for stroke in strokes {
        let start = (frame * Point3::from(stroke.start)).coords;
        let direction = frame.rotation * stroke.direction;
        let finger = Some(stroke.finger);
        match geometry.cast(&start, &direction, stroke.travel) {
            Some((along, normal)) => {
                felt.push(Felt { finger, point: start + along * direction, normal });
            }
            None => {
                let end = stroke.start + stroke.travel * stroke.direction;
                let point = (hand * Point3::from(end)).coords;
                free.push(LoggedFree { finger, point, unknown: Default::default() });
            }
        }
    }
    (felt, free)
}

/// The strokes of a hand that closes on an object no part of which is further than `radius` metres
/// from the middle of the grasp; at most five `fingers`, their distances from each other and turns
/// inwards `spread` times the usual ones, the thumb `thumb` metres above the middle.
pub fn strokes(
    dimension: usize,
    fingers: usize,
    radius: f64,
    spread: f64,
    thumb: f64,
) -> Vec<Stroke> {
    // A hand starts outside the object, so a large one is approached from further away.
    let back = (radius + 0.01 - STANDOFF).max(0.0);
    let table = if dimension == 3 { &SPATIAL } else { &PLANAR };
    let mut chosen: Vec<usize> = ORDER.into_iter().take(fingers).collect();
    chosen.sort_unstable();
    let stroke = |finger: usize| {
        let (start, direction) = match table.get(finger) {
            Some(&[side, height, turn]) => {
                let (sin, cos) = (spread * turn).to_radians().sin_cos();
                let side = spread * side * 1e-3;
                (Point::new(side, STANDOFF, height * 1e-3), Point::new(sin, -cos, 0.0))
            }
            None => (Point::new(0.0, -STANDOFF, thumb), Point::y()),
        };
        let travel = (STANDOFF + PAST) / direction.y.abs() + 2.0 * back;
        Stroke { finger, start: start - back * direction, direction, travel }
    };
    chosen.into_iter().map(stroke).collect()
}

/// Draws points uniformly over a surface.
struct Uniform<'a> {
    geometry: &'a Geometry,
    /// Length or area up to and including each edge or triangle.
    accumulated: Vec<f64>,
}

impl<'a> Uniform<'a> {
    fn new(geometry: &'a Geometry) -> Self {
        let mut sum = 0.0;
        let mut add = |measure: f64| {
            sum += measure;
            sum
        };
        let accumulated = match geometry {
            Geometry::Outline(o) => edges(&o.loops).map(|(a, b)| add((b - a).norm())).collect(),
            Geometry::Mesh(m) => {
                let doubled = |t: &[u32; 3]| {
                    let [a, b, c] = t.map(|v| m.vertices()[v as usize]);
                    add((b - a).cross(&(c - a)).norm())
                };
                m.triangles().iter().map(doubled).collect()
            }
        };
        Uniform { geometry, accumulated }
    }

    /// A point and the outward unit normal there; `None` for the shape of nothing.
    fn draw(&self, random: &mut Random) -> Option<(Point, Point)> {
        let (choice, u, v) = (random.unit(), random.unit(), random.unit());
        let at = choice * self.accumulated.last()?;
        let index = self.accumulated.partition_point(|sum| *sum <= at);
        match self.geometry {
            Geometry::Outline(o) => {
                let (a, b) = edges(&o.loops).nth(index)?;
                let edge = b - a;
                Some((a + u * edge, Point::new(edge.y, -edge.x, 0.0).normalize()))
            }
            Geometry::Mesh(m) => {
                let [a, b, c] = m.triangles().get(index)?.map(|v| m.vertices()[v as usize]);
                let root = u.sqrt();
                let point = a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v);
                Some((point, (b - a).cross(&(c - a)).normalize()))
            }
        }
    }
}

fn edges(loops: &[Vec<[f64; 2]>]) -> impl Iterator<Item = (Point, Point)> + '_ {
    let point = |v: [f64; 2]| Point::new(v[0], v[1], 0.0);
    loops
        .iter()
        .flat_map(move |l| (0..l.len()).map(move |i| (point(l[i]), point(l[(i + 1) % l.len()]))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    fn geometry(text: &str) -> Geometry {
        text.parse::<ObjectSpec>().unwrap().geometry().unwrap()
    }

    #[test]
    fn four_fingers_oppose_the_thumb() {
        for dimension in [2, 3] {
            let hand = strokes(dimension, 5, 0.05, 1.0, 0.0);
            assert_eq!(hand.iter().map(|s| s.finger).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
            for s in &hand {
                assert!((s.direction.norm() - 1.0).abs() < 1e-12);
                assert_eq!(s.direction.y > 0.0, s.finger == 4);
                // Starts outside, ends past the middle.
                let end = s.start + s.travel * s.direction;
                assert!(
                    s.start.norm() > 0.13 && (end.y - 0.04 * s.direction.y.signum()).abs() < 1e-12
                );
            }
            let pinch = strokes(dimension, 2, 0.05, 1.0, 0.0);
            assert_eq!(pinch.iter().map(|s| s.finger).collect::<Vec<_>>(), [1, 4]);
            for s in strokes(dimension, 5, 0.3, 1.0, 0.0) {
                assert!(s.start.norm() > 0.3, "starts outside a large object");
            }
        }
    }

    #[test]
    fn uniform_draws_are_on_the_surface_in_proportion_to_area() {
        let [mut random] = Random::streams(2);
        let half = |p: f64| p > 0.0;
        for (text, share) in [("rectangle:0.12x0.06", 1.0 / 3.0), ("box:0.12x0.06x0.06", 0.2)] {
            let geometry = geometry(text);
            let uniform = Uniform::new(&geometry);
            let n = 8000;
            let (mut top, mut right) = (0, 0);
            for _ in 0..n {
                let (p, normal) = uniform.draw(&mut random).unwrap();
                assert!(geometry.distance(&p) < 1e-12);
                assert!(geometry.distance(&(p + 1e-3 * normal)) > 0.999e-3);
                top += usize::from(normal.y > 0.5);
                right += usize::from(half(p.x));
            }
            let n = n as f64;
            assert!((top as f64 / n - share).abs() < 0.02, "{text}: {top}");
            assert!((right as f64 / n - 0.5).abs() < 0.02, "{text}: {right}");
        }
    }
}
