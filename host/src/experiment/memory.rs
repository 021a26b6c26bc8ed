//! Bounded memory: a long stream of contacts through maps of few places, against surfaces that keep
//! them all: a process alone, and a process truncated by flat faces, as a board carries it.

use std::fmt;

use nalgebra::Rotation3;
use rayon::prelude::*;
use serde::Serialize;
use tactile_core::contact::Contact as Felt;
use tactile_core::device::{Onboard, PlanarMap, PlanarTracker, SpatialMap, SpatialTracker};
use tactile_core::matrix::Vector;
use tactile_core::random::Random;
use tactile_core::space::{Planar, Spatial};
use tactile_core::surface::cholesky::packed;
use tactile_core::surface::{
    Ball, Gpis, Map, Matern32, Prior as _, Surface, Training as Learning, Truncated,
};

use crate::experiment::{Spread, with_room};
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

/// The same in single precision.
const BODY: Matern32 = Matern32 { amplitude: 0.03, lengthscale: 0.1 };

const PLANAR: usize = <PlanarTracker as Onboard<Planar>>::MAP;
const SPATIAL: usize = <SpatialTracker as Onboard<Spatial>>::MAP;

/// As many places as a board has, and no faces.
type PlanarAlone =
    Gpis<Planar, Matern32, Ball<Planar>, PLANAR, { 3 * PLANAR }, { packed(3 * PLANAR) }>;
type SpatialAlone =
    Gpis<Spatial, Matern32, Ball<Spatial>, SPATIAL, { 4 * SPATIAL }, { packed(4 * SPATIAL) }>;

/// A place for every contact.
type PlanarUnlimited =
    Truncated<Planar, Matern32, STREAM, { 3 * STREAM }, { packed(3 * STREAM) }, 10>;
type SpatialUnlimited =
    Truncated<Spatial, Matern32, STREAM, { 4 * STREAM }, { packed(4 * STREAM) }, 16>;

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
    /// Contacts a board's map holds, those on its faces aside.
    pub capacity: usize,
    /// Mean distance with all contacts kept, millimetres.
    pub unlimited_mean_mm: Option<Spread>,
    /// Mean distance of the process alone in as many places, millimetres.
    pub bounded_mean_mm: Option<Spread>,
    /// The latter over the former, seed by seed.
    pub mean_ratio: Option<Spread>,
    /// Greatest distance with all contacts kept, millimetres.
    pub unlimited_hausdorff_mm: Option<Spread>,
    /// Greatest distance of that, millimetres.
    pub bounded_hausdorff_mm: Option<Spread>,
    /// The latter over the former, seed by seed.
    pub hausdorff_ratio: Option<Spread>,
    /// Mean distance of the board's map, as many places truncated by faces, millimetres.
    pub truncated_mean_mm: Option<Spread>,
    /// The same over that with all contacts kept in the process alone.
    pub truncated_ratio: Option<Spread>,
    /// The same over that with all contacts kept in the same model.
    pub truncated_own_ratio: Option<Spread>,
    /// Greatest distance of the truncated map, millimetres.
    pub truncated_hausdorff_mm: Option<Spread>,
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
        let outcomes = streams(&geometry, STREAM, 0..seeds)?;
        Ok(row(object, &geometry, &outcomes))
    });
    Ok(MemoryTable { stream: STREAM, rows: rows.collect::<Result<_, Error>>()? })
}

/// [`compare`] for every seed.
fn streams(
    geometry: &Geometry,
    stream: usize,
    seeds: std::ops::Range<u64>,
) -> Result<Vec<Outcome>, Error> {
    with_room(|| seeds.into_par_iter().map(|seed| compare(geometry, stream, seed)).collect())
}

fn geometry(object: &str) -> Result<Geometry, Error> {
    if object == "L" {
        let corners = [(50, -40), (50, -5), (-10, -5), (-10, 40), (-50, 40), (-50, -40)];
        let vertices = corners.map(|(x, y)| [f64::from(x) * 1e-3, f64::from(y) * 1e-3]);
        return Ok(Geometry::Outline(Outline { loops: vec![vertices.to_vec()] }));
    }
    Ok(object.parse::<ObjectSpec>()?.geometry()?)
}

fn row(object: &str, geometry: &Geometry, outcomes: &[Outcome]) -> MemoryRow {
    let spread = |f: &dyn Fn(&Outcome) -> f64| Spread::of(outcomes.iter().map(f));
    MemoryRow {
        object: object.into(),
        capacity: match geometry {
            Geometry::Outline(_) => PLANAR,
            Geometry::Mesh(_) => SPATIAL,
        },
        unlimited_mean_mm: spread(&|o| o.unlimited.mean),
        bounded_mean_mm: spread(&|o| o.bounded.mean),
        mean_ratio: spread(&|o| o.bounded.mean / o.unlimited.mean),
        unlimited_hausdorff_mm: spread(&|o| o.unlimited.greatest),
        bounded_hausdorff_mm: spread(&|o| o.bounded.greatest),
        hausdorff_ratio: spread(&|o| o.bounded.greatest / o.unlimited.greatest),
        truncated_mean_mm: spread(&|o| o.truncated.mean),
        truncated_ratio: spread(&|o| o.truncated.mean / o.unlimited.mean),
        truncated_own_ratio: spread(&|o| o.truncated.mean / o.truncated_unlimited.mean),
        truncated_hausdorff_mm: spread(&|o| o.truncated.greatest),
    }
}

/// What became of one stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The process alone with every contact kept, in double precision.
    pub unlimited: Deviation,
    /// The same in the places of a board's map.
    pub bounded: Deviation,
    /// The map of a board: as many places, truncated by flat faces.
    pub truncated: Deviation,
    /// The same with a place for every contact.
    pub truncated_unlimited: Deviation,
}

/// Deviations of the surfaces that keep the whole stream, of at most 400 contacts, and of those that
/// do not.
///
/// # Errors
/// When the unlimited surface cannot be fitted.
pub fn compare(geometry: &Geometry, stream: usize, seed: u64) -> Result<Outcome, Error> {
    let contacts = touches(geometry, stream, seed);
    let prior = Prior::fitted(&contacts).unwrap_or(Prior::Constant(0.0));
    let dimension = geometry.dimension();
    let all = reference::Gpis::fit(dimension, KERNEL, prior, Training::Derivative, &contacts)?;
    let unlimited = deviation(geometry, |points| {
        all.means(points).into_iter().zip(all.gradients(points)).collect::<Vec<_>>()
    });
    let [bounded, truncated, truncated_unlimited] = match geometry {
        Geometry::Outline(_) => {
            let mut alone = Box::new(PlanarAlone::new());
            alone.configure(BODY, Ball::UNSET, Learning::Normals);
            let (mut few, mut every) =
                (Box::new(PlanarMap::new()), Box::new(PlanarUnlimited::new()));
            few.configure(BODY);
            every.configure(BODY);
            [
                learnt::<Planar, _>(geometry, &mut *alone, &contacts),
                learnt::<Planar, _>(geometry, &mut *few, &contacts),
                learnt::<Planar, _>(geometry, &mut *every, &contacts),
            ]
        }
        Geometry::Mesh(_) => {
            let mut alone = Box::new(SpatialAlone::new());
            alone.configure(BODY, Ball::UNSET, Learning::Normals);
            let (mut few, mut every) =
                (Box::new(SpatialMap::new()), Box::new(SpatialUnlimited::new()));
            few.configure(BODY);
            every.configure(BODY);
            [
                learnt::<Spatial, _>(geometry, &mut *alone, &contacts),
                learnt::<Spatial, _>(geometry, &mut *few, &contacts),
                learnt::<Spatial, _>(geometry, &mut *every, &contacts),
            ]
        }
    };
    Ok(Outcome { unlimited, bounded, truncated, truncated_unlimited })
}

/// The deviation of a map that has learnt these contacts.
fn learnt<S: Bridge, M: Map<S>>(
    geometry: &Geometry,
    map: &mut M,
    contacts: &[Contact],
) -> Deviation {
    learn::<S, M>(map, contacts);
    deviation(geometry, |points| ask::<S, M>(map, points))
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
            "Bounded memory: streams of {} contacts at known poses, 1 mm / 5°, into as many places as a board's map has",
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
            "greatest mm, all",
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
        writeln!(f, "As many places truncated by flat faces")?;
        writeln!(
            f,
            "  {:<26}{:>8}  {:<19}{:<19}{:<19}{:<19}",
            "object", "kept", "mean mm", "ratio", "to all kept so", "greatest mm"
        )?;
        for row in &self.rows {
            writeln!(
                f,
                "  {:<26}{:>8}  {:<19}{:<19}{:<19}{:<19}",
                row.object,
                row.capacity,
                show(&row.truncated_mean_mm),
                show(&row.truncated_ratio),
                show(&row.truncated_own_ratio),
                show(&row.truncated_hausdorff_mm),
            )?;
        }
        write!(
            f,
            "  median [quartiles]; distances from the true surface; all kept: the process alone in \
             double precision; so: truncated, a place for each; goal: ratio ≤ 1.1"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seeds that the experiment's twenty do not have.
    fn medians(object: &str, seeds: std::ops::Range<u64>) -> MemoryRow {
        let geometry = geometry(object).unwrap();
        row(object, &geometry, &streams(&geometry, 160, seeds).unwrap())
    }

    #[test]
    fn a_full_map_loses_little() {
        let row = medians("ellipse:0.12x0.06", 1000..1005);
        let ratios = [row.mean_ratio, row.hausdorff_ratio].map(|r| r.unwrap().median);
        assert!(ratios[0] < 1.1 && ratios[1] < 1.25, "{ratios:?}");
        let ratios = [row.truncated_ratio, row.truncated_own_ratio].map(|r| r.unwrap().median);
        assert!(ratios.iter().all(|r| *r < 1.15), "{ratios:?}");
        // Flat faces meeting in corners are the harder case.
        let row = medians("hexagon:0.045", 1000..1005);
        let ratios = [row.mean_ratio, row.hausdorff_ratio].map(|r| r.unwrap().median);
        assert!(ratios[0] < 1.3 && ratios[1] < 1.6, "{ratios:?}");
    }

    #[test]
    fn faces_keep_what_a_process_loses() {
        for (object, goal) in [("rectangle:0.1x0.05", 0.9), ("box:0.1x0.05x0.04", 0.6)] {
            let row = medians(object, 1000..1003);
            let ratios = [row.truncated_ratio, row.truncated_own_ratio].map(|r| r.unwrap().median);
            assert!(ratios[0] < goal && ratios[1] < 1.1, "{object} {ratios:?}");
        }
    }
}
