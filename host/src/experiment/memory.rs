//! Bounded memory: a long stream of contacts through a board's map, against a surface that keeps
//! them all.

use std::fmt;

use nalgebra::Rotation3;
use rayon::prelude::*;
use serde::Serialize;
use tactile_core::contact::Contact as Felt;
use tactile_core::device::{Onboard, PlanarTracker, SpatialTracker};
use tactile_core::matrix::Vector;
use tactile_core::random::Random;
use tactile_core::space::{Planar, Spatial};
use tactile_core::surface::{Gpis, Map, Surface};

use crate::experiment::Spread;
use crate::reference::{self, Contact, Kernel, Prior, Training};
use crate::shape::{Geometry, Outline};
use crate::sim::ObjectSpec;
use crate::space::{Bridge, Point};

/// Objects of the experiment; the last of the planar ones is an L of 100 × 80 mm.
const OBJECTS: [&str; 8] = [
    "rectangle:0.12x0.06",
    "ellipse:0.12x0.06",
    "hexagon:0.045",
    "L",
    "box:0.12x0.06x0.06",
    "cylinder:0.06x0.1",
    "sphere:0.07",
    "ellipsoid:0.12x0.08x0.06",
];

/// Contacts in a stream.
const STREAM: usize = 400;

/// Points of the true surface at which errors are measured.
const SAMPLES: usize = 1000;

/// Noise of a contact: metres and radians per axis.
const NOISE: (f64, f64) = (1e-3, 5.0 * std::f64::consts::PI / 180.0);

/// The model a board's map has, in double precision.
const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.1 };

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No such object.
    #[error(transparent)]
    Object(#[from] crate::sim::ObjectError),
    /// The surface that keeps everything.
    #[error(transparent)]
    Reference(#[from] reference::gpis::Error),
}

/// Distances from points of the true surface to the estimated one, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Their mean.
    pub mean: f64,
    /// The greatest: the Hausdorff distance from truth to estimate.
    pub greatest: f64,
}

/// What bounded memory costs on one object. Spreads are over seeds.
#[derive(Clone, Debug, Serialize)]
pub struct MemoryRow {
    /// The object.
    pub object: String,
    /// Contacts the board's map holds.
    pub capacity: usize,
    /// Mean distance with all contacts kept, millimetres.
    pub unlimited_mean_mm: Option<Spread>,
    /// Mean distance of the board's map, millimetres.
    pub bounded_mean_mm: Option<Spread>,
    /// The latter over the former, seed by seed.
    pub mean_ratio: Option<Spread>,
    /// Greatest distance with all contacts kept, millimetres.
    pub unlimited_hausdorff_mm: Option<Spread>,
    /// Greatest distance of the board's map, millimetres.
    pub bounded_hausdorff_mm: Option<Spread>,
    /// The latter over the former, seed by seed.
    pub hausdorff_ratio: Option<Spread>,
}

/// What bounded memory costs.
#[derive(Clone, Debug, Serialize)]
pub struct MemoryTable {
    /// Contacts in a stream.
    pub stream: usize,
    /// One per object.
    pub rows: Vec<MemoryRow>,
}

/// Streams of 400 contacts with 1 mm and 5° of noise over every object.
///
/// # Errors
/// When an object does not exist or the unlimited surface cannot be fitted.
pub fn run(seeds: u64) -> Result<MemoryTable, Error> {
    let rows = OBJECTS.iter().map(|object| {
        let geometry = geometry(object)?;
        let outcomes = (0..seeds)
            .into_par_iter()
            .map(|seed| compare(&geometry, STREAM, seed))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(row(object, &geometry, &outcomes))
    });
    Ok(MemoryTable { stream: STREAM, rows: rows.collect::<Result<_, Error>>()? })
}

fn geometry(object: &str) -> Result<Geometry, Error> {
    if object == "L" {
        let corners = [(50, -40), (50, -5), (-10, -5), (-10, 40), (-50, 40), (-50, -40)];
        let vertices = corners.map(|(x, y)| [f64::from(x) * 1e-3, f64::from(y) * 1e-3]);
        return Ok(Geometry::Outline(Outline { loops: vec![vertices.to_vec()] }));
    }
    Ok(object.parse::<ObjectSpec>()?.geometry()?)
}

fn row(object: &str, geometry: &Geometry, outcomes: &[[Deviation; 2]]) -> MemoryRow {
    let spread = |f: &dyn Fn(&[Deviation; 2]) -> f64| Spread::of(outcomes.iter().map(f));
    MemoryRow {
        object: object.into(),
        capacity: match geometry {
            Geometry::Outline(_) => <PlanarTracker as Onboard<Planar>>::MAP,
            Geometry::Mesh(_) => <SpatialTracker as Onboard<Spatial>>::MAP,
        },
        unlimited_mean_mm: spread(&|o| o[0].mean),
        bounded_mean_mm: spread(&|o| o[1].mean),
        mean_ratio: spread(&|o| o[1].mean / o[0].mean),
        unlimited_hausdorff_mm: spread(&|o| o[0].greatest),
        bounded_hausdorff_mm: spread(&|o| o[1].greatest),
        hausdorff_ratio: spread(&|o| o[1].greatest / o[0].greatest),
    }
}

/// Deviations of the surface that keeps the whole stream and of the board's map.
///
/// # Errors
/// When the unlimited surface cannot be fitted.
pub fn compare(geometry: &Geometry, stream: usize, seed: u64) -> Result<[Deviation; 2], Error> {
    let contacts = touches(geometry, stream, seed);
    let prior = Prior::fitted(&contacts).unwrap_or(Prior::Constant(0.0));
    let dimension = geometry.dimension();
    let all = reference::Gpis::fit(dimension, KERNEL, prior, Training::Derivative, &contacts)?;
    let unlimited = |points: &[Point]| {
        all.means(points).into_iter().zip(all.gradients(points)).collect::<Vec<_>>()
    };
    let bounded = match geometry {
        Geometry::Outline(_) => {
            let mut tracker = Box::new(PlanarTracker::new(Gpis::new()));
            Onboard::<Planar>::prepare(&mut *tracker);
            learn::<Planar, _>(tracker.map_mut(), &contacts);
            deviation(geometry, |points| ask::<Planar, _>(tracker.map(), points))
        }
        Geometry::Mesh(_) => {
            let mut tracker = Box::new(SpatialTracker::new(Gpis::new()));
            Onboard::<Spatial>::prepare(&mut *tracker);
            learn::<Spatial, _>(tracker.map_mut(), &contacts);
            deviation(geometry, |points| ask::<Spatial, _>(tracker.map(), points))
        }
    };
    Ok([deviation(geometry, unlimited), bounded])
}

/// Contacts drawn evenly over the surface, with noise.
fn touches(geometry: &Geometry, count: usize, seed: u64) -> Vec<Contact> {
    let places = geometry.samples(20_000);
    let mut random = Random::new(seed);
    let spatial = geometry.dimension() == 3;
    let mut noise = || {
        let Vector([x, y, z]): Vector<3> = random.normal();
        let place = random.uniform();
        let z = if spatial { f64::from(z) } else { 0.0 };
        (Point::new(x.into(), y.into(), z), place)
    };
    let touch = |_| {
        let ((off, place), (turn, _)) = (noise(), noise());
        let (point, normal) = places[(f64::from(place) * places.len() as f64) as usize];
        let turn = if spatial { turn } else { Point::new(0.0, 0.0, turn.x) };
        Contact {
            point: point + off * NOISE.0,
            normal: Some(Rotation3::new(turn * NOISE.1) * normal),
            point_deviation: NOISE.0,
            normal_deviation: NOISE.1,
        }
    };
    (0..count).map(touch).collect()
}

/// Hands contacts to a map, five at a time as a hand would.
fn learn<S: Bridge, M: Map<S>>(map: &mut M, contacts: &[Contact]) {
    for grasp in contacts.chunks(5) {
        for contact in grasp {
            map.insert(&Felt {
                point: S::vector(&contact.point),
                normal: contact.normal.map(|n| S::vector(&n)),
                point_deviation: contact.point_deviation as f32,
                normal_deviation: contact.normal_deviation as f32,
                finger: 0,
            });
        }
        map.refit();
    }
}

fn ask<S: Bridge, M: Surface<S>>(map: &M, points: &[Point]) -> Vec<(f64, Point)> {
    let ask = |p: &Point| {
        let probe = map.probe(S::vector(p));
        (f64::from(probe.value), S::point(&probe.gradient))
    };
    points.iter().map(ask).collect()
}

/// From points of the true surface to the zero of a field (value and gradient at points), by at most
/// eight steps of Newton's method along the gradient.
fn deviation(geometry: &Geometry, field: impl Fn(&[Point]) -> Vec<(f64, Point)>) -> Deviation {
    let truth: Vec<Point> = geometry.samples(SAMPLES).into_iter().map(|(p, _)| p).collect();
    let mut points = truth.clone();
    for _ in 0..8 {
        let asked = field(&points);
        for (point, (value, gradient)) in points.iter_mut().zip(asked) {
            let step = gradient * (-value / gradient.norm_squared().max(0.05));
            *point += step * (0.01 / step.norm().max(0.01));
        }
    }
    let away = points.iter().zip(&truth).map(|(p, t)| 1e3 * (p - t).norm());
    Deviation {
        mean: away.clone().sum::<f64>() / truth.len().max(1) as f64,
        greatest: away.fold(0.0, f64::max),
    }
}

impl fmt::Display for MemoryTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Bounded memory: streams of {} contacts at known poses, 1 mm / 5°, into a board's map",
            self.stream
        )?;
        writeln!(
            f,
            "  {:<26}{:>8}  {:<19}{:<19}{:<19}{:<19}{:<19}{:<19}",
            "object",
            "kept",
            "mean mm, all kept",
            "bounded",
            "ratio",
            "Hausdorff mm, all",
            "bounded",
            "ratio"
        )?;
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        for row in &self.rows {
            writeln!(
                f,
                "  {:<26}{:>8}  {:<19}{:<19}{:<19}{:<19}{:<19}{:<19}",
                row.object,
                row.capacity,
                show(&row.unlimited_mean_mm),
                show(&row.bounded_mean_mm),
                show(&row.mean_ratio),
                show(&row.unlimited_hausdorff_mm),
                show(&row.bounded_hausdorff_mm),
                show(&row.hausdorff_ratio),
            )?;
        }
        write!(
            f,
            "  median [quartiles]; distances from the true surface; all kept: double precision; \
             goal: ratio ≤ 1.1"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seeds that the experiment's twenty do not have.
    fn median_ratio(object: &str, seeds: std::ops::Range<u64>) -> (f64, f64) {
        let geometry = geometry(object).unwrap();
        let outcomes: Vec<_> = seeds.map(|seed| compare(&geometry, 160, seed).unwrap()).collect();
        let row = row(object, &geometry, &outcomes);
        (row.mean_ratio.unwrap().median, row.hausdorff_ratio.unwrap().median)
    }

    #[test]
    fn a_full_map_loses_little() {
        let (mean, hausdorff) = median_ratio("ellipse:0.12x0.06", 1000..1005);
        assert!(mean < 1.1 && hausdorff < 1.25, "{mean} {hausdorff}");
        // Flat faces meeting in corners are the harder case.
        let (mean, hausdorff) = median_ratio("hexagon:0.045", 1000..1005);
        assert!(mean < 1.3 && hausdorff < 1.6, "{mean} {hausdorff}");
    }
}
