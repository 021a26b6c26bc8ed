//! Ends for a body that contacts leave open: a can whose bottom nobody touched goes on for ever, and
//! two sides that are nearly parallel meet far away.

use std::f64::consts::TAU;

use super::{Body, Mode, Part, Plane};
use crate::reference::Contact;
use crate::space::{Point, centroid, scatter};

/// A body is open in a direction when it still holds the point this many times the distance from the
/// contacts' centre to the farthest of them beyond where it would end.
const OPEN: f64 = 1.0;

/// The same where contacts do not say how far the body goes.
const UNDECIDED: f64 = 0.05;

/// Standard deviation of where it ends, in the same distances: a side that nobody touched.
const DOUBT: f64 = 0.2;

/// Directions that are looked at in the plane and in space, and planes that are added at most.
const DIRECTIONS: [usize; 2] = [96, 400];
const MOST: usize = 8;

/// Difference of an offset for its slope, metres.
const NUDGE: f64 = 1e-6;

impl Body {
    /// The same body cut by planes beyond the outermost contacts until it is closed: first along the
    /// `undecided` directions, then opposite its planes, then always where it reaches furthest: most
    /// sides have one parallel to them, and a corner closed by a single plane across it is a spike.
    /// How far out the planes lie is a guess, and a mode: of contacts spread evenly over a length the
    /// last is as far from its end as they are from each other.
    pub(super) fn closed(
        mut self,
        dimension: usize,
        contacts: &[Contact],
        undecided: &[Point],
    ) -> Body {
        let centre = centroid(contacts.iter().map(|c| c.point));
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        if !(reach > 0.0 && reach.is_finite()) {
            return self;
        }
        let offset = |normal: &Point| {
            let along = contacts.iter().map(|c| normal.dot(&c.point));
            let low = along.clone().fold(f64::INFINITY, f64::min);
            let high = along.fold(f64::NEG_INFINITY, f64::max);
            high + (high - low) / contacts.len() as f64
        };
        // How deep inside the body a point beyond the contacts is.
        let depth = |body: &Body, normal: &Point, share: f64| {
            let beyond = offset(normal) - normal.dot(&centre) + share * reach;
            -body.active(&(centre + normal * beyond)).1.0
        };
        let end = |body: &mut Body, normal: Point| {
            body.end(Plane { normal, offset: offset(&normal) }, DOUBT * reach);
        };
        for normal in undecided {
            if depth(&self, normal, UNDECIDED) > 0.0 {
                end(&mut self, *normal);
            }
        }
        // Between the even ones a thin rod would go on unseen.
        let directions = [directions(dimension), axes(dimension, &centre, contacts)].concat();
        for _ in 0..MOST {
            let deepest = |directions: &[Point]| {
                let depths = directions.iter().map(|normal| (depth(&self, normal, OPEN), *normal));
                depths.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(depth, _)| *depth > 0.0)
            };
            let Some((_, normal)) = deepest(&self.opposite()).or_else(|| deepest(&directions))
            else {
                break;
            };
            end(&mut self, normal);
        }
        self
    }

    /// Cuts it by a plane whose offset is known to so much, metres.
    pub(super) fn end(&mut self, plane: Plane, deviation: f64) {
        let at = |by: f64| Part::Plane(Plane { offset: plane.offset + by, ..plane });
        let scale = deviation / (2.0 * NUDGE);
        self.modes.push(Mode::of(self.parts.len(), at(NUDGE), at(-NUDGE), scale));
        self.parts.push(at(0.0));
    }

    /// Normals of the sides that its planes would have across from them.
    fn opposite(&self) -> Vec<Point> {
        self.planes().map(|plane| -plane.normal).collect()
    }

    /// How likely it is that contacts anywhere on the surface leave as large a part of it bare as these
    /// do: the part within the largest ball on the surface that holds none, and of as many gaps as
    /// there are contacts (Whitworth 1901). Small where two sides were drawn out to where they meet
    /// because nobody touched the one between them. For planes with the contacts' centre inside.
    pub(super) fn evenness(&self, dimension: usize, contacts: &[Contact]) -> f64 {
        let count = contacts.len() as f64;
        let centre = centroid(contacts.iter().map(|c| c.point));
        let rays = self.rays(dimension, &centre);
        let reached = |ray: &Ray| (centre + ray.out * ray.length, ray.area(dimension));
        let surface: Vec<(Point, f64)> = rays.iter().map(reached).collect();
        let nearest =
            |p: &Point| contacts.iter().map(|c| (c.point - p).norm()).fold(f64::INFINITY, f64::min);
        let bare = surface.iter().map(|(p, _)| (p, nearest(p))).max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((middle, radius)) = bare else { return 0.0 };
        let within = |(p, _): &&(Point, f64)| (p - middle).norm() <= radius;
        let all: f64 = surface.iter().map(|(_, area)| area).sum();
        let part = surface.iter().filter(within).map(|(_, area)| area).sum::<f64>() / all;
        (count * (1.0 - part).powf(count - 1.0)).min(1.0)
    }

    /// Evenly spread ways out of a point inside, as far as its planes go.
    pub(super) fn rays(&self, dimension: usize, centre: &Point) -> Vec<Ray> {
        let ray = |out: Point| {
            let depth = |plane: &Plane| plane.offset - plane.normal.dot(centre);
            let ray = Ray { out, length: f64::INFINITY, along: 1.0 };
            let ray = self.planes().fold(ray, |ray, p| ray.cut(&p.normal, depth(&p)));
            (ray.length > 0.0 && ray.length.is_finite()).then_some(ray)
        };
        directions(dimension).into_iter().filter_map(ray).collect()
    }

    pub(super) fn planes(&self) -> impl Iterator<Item = Plane> {
        self.parts.iter().filter_map(|part| match part {
            Part::Plane(plane) => Some(*plane),
            _ => None,
        })
    }
}

/// A straight way to the surface.
#[derive(Clone, Copy)]
pub(super) struct Ray {
    out: Point,
    length: f64,
    /// Cosine to the normal where it ends.
    along: f64,
}

impl Ray {
    /// The same where it ends at the latest at a plane so far from where it begins.
    pub(super) fn cut(self, normal: &Point, depth: f64) -> Ray {
        let along = normal.dot(&self.out);
        let length = depth / along;
        if along > 0.0 && length < self.length { Ray { length, along, ..self } } else { self }
    }

    /// The part of the surface that it sees of as many rays, up to a factor common to all.
    pub(super) fn area(&self, dimension: usize) -> f64 {
        self.length.powi(dimension as i32 - 1) / self.along
    }
}

/// Evenly spread.
fn directions(dimension: usize) -> Vec<Point> {
    spread(dimension, DIRECTIONS[usize::from(dimension == 3)])
}

/// So many, unit and evenly spread: equal angles, or a golden spiral from pole to pole.
pub(super) fn spread(dimension: usize, count: usize) -> Vec<Point> {
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let direction = |i: usize| {
        if dimension == 2 {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            return Point::new(cos, sin, 0.0);
        }
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (TAU * golden * i as f64).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        Point::new(ring * cos, ring * sin, z)
    };
    (0..count).map(direction).collect()
}

/// Both ways along the principal axes of the contacts about their centre.
fn axes(dimension: usize, centre: &Point, contacts: &[Contact]) -> Vec<Point> {
    let scatter = scatter(contacts.iter().map(|c| c.point), centre);
    let vectors = scatter.symmetric_eigen().eigenvectors;
    let axis = |column: usize| {
        let mut axis: Point = vectors.column(column).into_owned();
        axis.iter_mut().skip(dimension).for_each(|other| *other = 0.0);
        axis.try_normalize(0.5)
    };
    (0..3).filter_map(axis).flat_map(|axis| [axis, -axis]).collect()
}
