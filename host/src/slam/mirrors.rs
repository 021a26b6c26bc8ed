//! Planes that an object seems to be its own mirror image in: what was felt on one side of them then holds on the
//! other.
//!
//! Much of what people make and much of what grows has such planes. Contacts say where: a surface that is its own
//! mirror image makes them likelier if it is the right plane, and less likely if it is not
//! ([`Gpis::symmetric_evidence`]).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::choose::{DOUBT, doubt};
use super::fit::{exactness, usual};
use crate::model::body::Body;
use crate::model::mirror::{Image, Mirror};
use crate::model::places::{self, places};
use crate::reference::{Contact, Gpis, Kernel, Prior, Training};
use crate::shape::Geometry;
use crate::space::{Point, across};
use crate::thin::evenly;

/// Nats by which contacts must be likelier with one plane more, what its numbers take up paid for: odds of 50:1, for
/// the process is too sure of itself where a surface has corners.
const SURE: f64 = 4.0;

/// Contacts that decide at most, and that starts are compared with.
const DECIDING: usize = places::MOST;
const COMPARING: usize = 30;

/// Contacts and images at most: where there are many contacts, images add little and take long.
const MOST: usize = 320;

/// Directions that starts have where they may be any, and where they are square to one.
const ANYWHERE: u32 = 160;
const AROUND: u32 = 36;

/// Distances of starts from the centre of the ball that fits the contacts, in its radii.
const OFFSETS: [f64; 5] = [-0.3, -0.12, 0.0, 0.12, 0.3];

/// How far from the centre a plane may lie before any contact, to both sides together, in the same.
const ROOM: f64 = 1.0;

/// Starts that are climbed from, and the cosine of the angle that they are apart.
const CLIMBED: usize = 5;
const APART: f64 = 0.97;

/// First and last step of climbing, and that of differences; in radii and radians.
const FIRST: f64 = 0.08;
const LAST: f64 = 0.003;
const STEP: f64 = 0.01;

/// Steps of climbing at most.
const STEPS: usize = 60;

/// Largest deviation of a plane's numbers that contacts leave, in the same.
const WIDEST: f64 = 0.2;

/// Contacts of an object that seems to be its own mirror image.
#[derive(Clone, Debug)]
pub struct Mirrored {
    /// Those that were felt, then all their images, these as much less certain as the mirrors are.
    pub contacts: Vec<Contact>,
    /// The planes, square to each other.
    pub mirrors: Vec<Mirror>,
    /// Nats by which they make the contacts likelier.
    pub evidence: f64,
}

impl Mirrored {
    /// Without mirrors.
    pub fn unmoved(contacts: &[Contact]) -> Mirrored {
        Mirrored { contacts: contacts.to_vec(), mirrors: vec![], evidence: 0.0 }
    }

    /// In the planes that contacts speak for, one in two dimensions and up to two in three. `None` where there
    /// are no such planes, more contacts than images would help, or poses so doubtful that contacts fit anything.
    pub fn of(dimension: usize, contacts: &[Contact]) -> Option<Mirrored> {
        let doubt = doubt(contacts);
        if doubt.is_finite() && doubt > DOUBT || 2 * contacts.len() > MOST {
            return None;
        }
        let surface = Surface::of(dimension, contacts)?;
        let mut felt = Mirrored::unmoved(contacts);
        // A last one, square to all others, could only be moved: something is always in the middle.
        while felt.mirrors.len() + 1 < dimension && 2 * felt.contacts.len() <= MOST {
            let before = surface.evidence(&felt.mirrors, &surface.contacts);
            let found = Search { surface: &surface, before: &felt.mirrors }.found();
            let Some(found) = found.filter(|found| found.evidence > before + SURE) else { break };
            let images: Vec<Contact> = felt.contacts.iter().map(|c| found.image(c)).collect();
            felt.contacts.extend(images);
            felt.mirrors.push(found.mirror);
            felt.evidence += found.evidence - before;
        }
        (!felt.mirrors.is_empty()).then_some(felt)
    }

    /// Whether the shape made with images is to be believed, too, beside the one that contacts make by themselves.
    ///
    /// Where contacts are as likely to lie anywhere on a surface, each is less so by as much as images make that
    /// larger ([`places()`]): the larger it is, the more contacts would have been felt on what only images show. A shape
    /// without any size suits nothing.
    pub fn suits(&self, mirrored: &Geometry, alone: &Geometry) -> bool {
        let felt = &self.contacts[..self.contacts.len() >> self.mirrors.len()];
        let (mirrored, alone) = (mirrored.size(), alone.size());
        let price = places(felt) as f64 * (mirrored / alone).ln();
        mirrored > 0.0 && alone > 0.0 && self.evidence - price > SURE
    }
}

/// What contacts are judged by: the process about the ball that fits them.
struct Surface {
    dimension: usize,
    kernel: Kernel,
    body: Body,
    /// Of the ball, metres.
    centre: Point,
    radius: f64,
    /// At most [`DECIDING`], as noisy as the process finds them.
    contacts: Vec<Contact>,
    /// At most [`COMPARING`] of those.
    few: Vec<Contact>,
}

impl Surface {
    fn of(dimension: usize, contacts: &[Contact]) -> Option<Surface> {
        let Some(Prior::Ball { centre, radius }) = Prior::fitted(contacts) else { return None };
        let body = Body::doubtful_ball(dimension, contacts)?;
        let contacts = evenly(contacts, DECIDING);
        // The search replaces both numbers of the family.
        let family = Kernel::Matern32 { amplitude: radius, lengthscale: radius };
        let search = usual(dimension, &contacts);
        let mean = body.clone();
        let found =
            search.run(dimension, family, mean, Training::Derivative, &contacts, radius).ok()?;
        let noise = found.noise * exactness(dimension, &contacts);
        let contacts: Vec<Contact> = contacts.iter().map(|c| c.with_noise(noise)).collect();
        let few = evenly(&contacts, COMPARING);
        Some(Surface { dimension, kernel: found.kernel, body, centre, radius, contacts, few })
    }

    /// Log probability of the contacts if these planes are its mirrors.
    fn evidence(&self, mirrors: &[Mirror], contacts: &[Contact]) -> f64 {
        let Surface { dimension, kernel, body, .. } = self;
        Gpis::symmetric_evidence(*dimension, *kernel, body, mirrors, contacts)
            .unwrap_or(f64::NEG_INFINITY)
    }
}

/// Looks for one mirror more, square to those `before`.
struct Search<'a> {
    surface: &'a Surface,
    before: &'a [Mirror],
}

/// The likeliest mirror.
struct Found {
    mirror: Mirror,
    /// Log probability of the contacts, wherever it may lie exactly.
    evidence: f64,
    /// The same mirror, moved by one deviation along each axis of its doubt.
    moved: Vec<Image>,
}

impl Search<'_> {
    fn evidence(&self, mirror: Mirror, contacts: &[Contact]) -> f64 {
        let mirrors: Vec<Mirror> = self.before.iter().copied().chain([mirror]).collect();
        self.surface.evidence(&mirrors, contacts)
    }

    /// What the normal is square to, if anything.
    fn axis(&self) -> Option<Point> {
        match self.surface.dimension {
            2 => Some(Point::z()),
            _ => self.before.first().map(|mirror| mirror.normal),
        }
    }

    /// The normals that may be, evenly; each stands for its reverse, too.
    fn normals(&self) -> Vec<Point> {
        let Some(axis) = self.axis() else {
            return (0..ANYWHERE).map(|i| hemisphere(i, ANYWHERE)).collect();
        };
        let [first, second] = across(3, &axis);
        let step = std::f64::consts::PI / f64::from(AROUND);
        let angles = (0..AROUND).map(|i| (f64::from(i) * step).sin_cos());
        angles.map(|(sin, cos)| first * cos + second * sin).collect()
    }

    /// Directions in which the normal may turn.
    fn turns(&self, normal: &Point) -> Vec<Point> {
        match self.axis() {
            Some(axis) => vec![normal.cross(&axis)],
            None => across(3, normal).to_vec(),
        }
    }

    /// The mirror moved along its normal by `by[0]` radii and turned by the other numbers about the centre.
    /// `by` holds one number more than there are [turns](Self::turns), so at least one.
    fn moved(&self, mirror: &Mirror, by: &[f64]) -> Mirror {
        let turns = self.turns(&mirror.normal);
        let turn: Point = turns.iter().zip(&by[1..]).map(|(turn, by)| turn * *by).sum();
        let normal = (mirror.normal + turn).normalize();
        let carried = mirror.offset + (normal - mirror.normal).dot(&self.surface.centre);
        Mirror { normal, offset: carried + by[0] * self.surface.radius }
    }

    /// The likeliest of many mirrors, some angle apart.
    fn starts(&self) -> Vec<Mirror> {
        let Surface { centre, radius, few, .. } = self.surface;
        let at = |normal: Point| {
            OFFSETS.map(|off| Mirror { normal, offset: normal.dot(centre) + off * radius })
        };
        let all = self.normals().into_par_iter().flat_map_iter(at);
        let mut all: Vec<(f64, Mirror)> = all.map(|m| (self.evidence(m, few), m)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut starts: Vec<Mirror> = vec![];
        for (_, mirror) in all {
            let is_apart = |other: &Mirror| other.normal.dot(&mirror.normal).abs() < APART;
            if starts.len() < CLIMBED && starts.iter().all(is_apart) {
                starts.push(mirror);
            }
        }
        starts
    }

    /// The likeliest mirror near this one, with its evidence.
    fn climbed(&self, start: Mirror) -> (f64, Mirror) {
        let contacts = &self.surface.contacts;
        let mut best = (self.evidence(start, contacts), start);
        let numbers = 1 + self.turns(&start.normal).len();
        let mut step = FIRST;
        for _ in 0..STEPS {
            let before = best.0;
            for number in 0..numbers {
                for by in [-step, step] {
                    let mut all = vec![0.0; numbers];
                    all[number] = by;
                    let next = self.moved(&best.1, &all);
                    let evidence = self.evidence(next, contacts);
                    if evidence > best.0 {
                        best = (evidence, next);
                    }
                }
            }
            if best.0 == before {
                step *= 0.5;
            }
            if step < LAST {
                break;
            }
        }
        best
    }

    /// The likeliest of all, and what is left open of it (Laplace's approximation: MacKay, Neural Computation 4,
    /// 1992).
    fn found(&self) -> Option<Found> {
        let climbed = self.starts().into_par_iter().map(|start| self.climbed(start));
        let (height, mirror) = climbed.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let curvature = self.curvature(height, &mirror);
        if !curvature.iter().all(|curve| curve.is_finite()) {
            return None;
        }
        let eigen = curvature.symmetric_eigen();
        let deviations: Vec<f64> =
            eigen.eigenvalues.iter().map(|curve| curve.max(WIDEST.powi(-2)).powf(-0.5)).collect();
        let volume: f64 = deviations.iter().map(|d| (d * std::f64::consts::TAU.sqrt()).ln()).sum();
        // Half of all directions.
        let room = if deviations.len() == 3 { std::f64::consts::TAU } else { std::f64::consts::PI };
        let along = |(axis, deviation): (usize, &f64)| {
            let by: DVector<f64> = eigen.eigenvectors.column(axis) * *deviation;
            self.moved(&mirror, by.as_slice()).image()
        };
        let moved = deviations.iter().enumerate().map(along).collect();
        Some(Found { mirror, evidence: height + volume - (room * ROOM).ln(), moved })
    }

    /// The negative second derivatives of the evidence.
    fn curvature(&self, height: f64, mirror: &Mirror) -> DMatrix<f64> {
        let numbers = 1 + self.turns(&mirror.normal).len();
        let fall = |i: usize, j: usize, signs: [f64; 2]| {
            let mut by = vec![0.0; numbers];
            by[i] += STEP * signs[0];
            by[j] += STEP * signs[1];
            height - self.evidence(self.moved(mirror, &by), &self.surface.contacts)
        };
        DMatrix::from_fn(numbers, numbers, |i, j| {
            // On the diagonal two of them are steps of 2, the others none.
            let same = fall(i, j, [1.0, 1.0]) + fall(i, j, [-1.0, -1.0]);
            let other = fall(i, j, [1.0, -1.0]) + fall(i, j, [-1.0, 1.0]);
            (same - other) / (4.0 * STEP * STEP)
        })
    }
}

impl Found {
    /// Of a contact, as uncertain as it and the mirror are.
    fn image(&self, contact: &Contact) -> Contact {
        let image = self.mirror.image().contact(contact);
        let (mut shift, mut turn) = (0.0, 0.0);
        for moved in &self.moved {
            let away = moved.point(&contact.point) - image.point;
            match (image.normal, contact.normal) {
                (Some(normal), Some(own)) => {
                    shift += normal.dot(&away).powi(2);
                    // As if it were about one axis.
                    turn += (moved.direction(&own) - normal).norm_squared();
                }
                _ => shift += away.norm_squared(),
            }
        }
        Contact {
            point_deviation: contact.point_deviation.hypot(shift.sqrt()),
            normal_deviation: contact.normal_deviation.hypot(turn.sqrt()),
            ..image
        }
    }
}

/// The `index`th of `count` directions spread evenly over half a sphere (Fibonacci's spiral).
fn hemisphere(index: u32, count: u32) -> Point {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let z = (f64::from(index) + 0.5) / f64::from(count);
    let (sin, cos) = (golden * f64::from(index)).sin_cos();
    let out = (1.0 - z * z).sqrt();
    Point::new(out * cos, out * sin, z)
}

#[cfg(test)]
mod tests;
