//! Figure 4.2: the hand delimits the object before it explores it.

use std::fmt;
use std::sync::Arc;

use serde::Serialize;

use super::Spread;
use crate::quantity::Deviation;
use crate::shape::{Geometry, Mesh, ShapeError};
use crate::sim::hand::{Articulated, HandError, Unreachable};
use crate::sim::{Bench, Hand, ObjectSpec, Options, SimError};
use crate::space::{Point, Pose};
use crate::view::drawing::{Drawing, PictureError};
use crate::view::sheet::{self, Panel, Sheet};

/// As the command line names it.
pub const NAME: &str = "figure-4.2";

/// What is delimited.
const OBJECTS: [&str; 6] = [
    "box:0.1x0.06x0.06",
    "cylinder:0.06x0.1",
    "sphere:0.08",
    "lshape:0.09x0.09x0.035x0.05",
    "ellipsoid:0.12x0.08x0.06",
    "prism:0.06,triangle:0.05",
];

/// One object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was delimited.
    pub object: String,
    /// Guarded moves of one probing.
    pub moves: usize,
    /// Touches of one probing, on average.
    pub touches: f64,
    /// Distance of each found face of the box from the true one, millimetres.
    pub face_mm: Option<Spread>,
    /// The greatest of them, millimetres.
    pub worst_mm: f64,
    /// Volume of the found box in that of the true one, percent.
    pub volume: Option<Spread>,
}

/// The figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Probings of each object.
    pub seeds: u64,
    /// One per object.
    pub rows: Vec<Row>,
    /// Seed 0 of each.
    #[serde(skip)]
    pub picture: Drawing,
}

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No hand.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// No object.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// The hand met nothing.
    #[error("{object}, seed {seed}: {source}")]
    Missed {
        /// What was to be delimited.
        object: String,
        /// Of which run.
        seed: u64,
        /// What the probing said.
        source: Unreachable,
    },
    /// No box.
    #[error(transparent)]
    Box(#[from] ShapeError),
    /// No picture.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// Delimits every object on a table with the five-finger hand held flat, at contact noise 1 mm, with seeds
/// from 0 on.
///
/// # Errors
/// When the hand meets nothing, or the picture cannot be drawn.
pub fn run(seeds: u64) -> Result<Figure, Error> {
    let hand = Hand::Articulated(Arc::new(Articulated::five_finger()?));
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    for object in OBJECTS {
        let (mut faces, mut volumes, mut touches, mut moves) = (Vec::new(), Vec::new(), 0, 0);
        for seed in 0..seeds {
            let still = Deviation { length: 0.0, angle: 0.0 };
            let spec: ObjectSpec = object.parse().map_err(SimError::Object)?;
            let options = Options { seed, motion_noise: still, ..Options::new(spec) };
            let mut bench = Bench::with_hand(options, hand.clone(), true)?;
            let found = bench.probe().map_err(|source| Error::Missed {
                object: object.into(),
                seed,
                source,
            })?;
            touches += found.touches().count();
            moves = found.moves;
            let pose = bench.log().grasps.first().and_then(|g| g.truth);
            let truth = bench.geometry().transformed(&pose.unwrap_or_else(Pose::identity));
            let (low, high) = truth.bounds();
            for axis in 0..3 {
                // The table's height is known, not found.
                let ends = [(found.low, low), (found.high, high)];
                let ends = ends.into_iter().skip(usize::from(axis == 2));
                faces.extend(ends.map(|(found, truth)| 1e3 * (found[axis] - truth[axis]).abs()));
            }
            let volume = |low: Point, high: Point| (high - low).product();
            volumes.push(100.0 * volume(found.low, found.high) / volume(low, high));
            if seed == 0 {
                let touched: Vec<(Point, Option<Point>)> =
                    found.touches().map(|(point, outward)| (point, Some(outward))).collect();
                panels.push(Panel {
                    title: object.into(),
                    note: format!("{moves} guarded moves, {} touches", touched.len()),
                    truth,
                    estimate: Some(Geometry::Mesh(block(&found.low, &found.high)?)),
                    deviations: Vec::new(),
                    contacts: touched,
                    groups: Vec::new(),
                    links: Vec::new(),
                });
            }
        }
        rows.push(Row {
            object: object.into(),
            moves,
            touches: touches as f64 / seeds.max(1) as f64,
            worst_mm: faces.iter().copied().fold(0.0, f64::max),
            face_mm: Spread::of(faces),
            volume: Spread::of(volumes),
        });
    }
    let title = "Figure 4.2: the flat hand delimits the area of the object (lines: true shape)";
    let picture = sheet::render(&Sheet { title: title.into(), columns: 3, panels })?;
    Ok(Figure { seeds, rows, picture })
}

/// The box between two corners, outward.
fn block(low: &Point, high: &Point) -> Result<Mesh, ShapeError> {
    let corner = |i: usize| {
        Point::from_fn(|axis, _| if i >> axis & 1 == 1 { high[axis] } else { low[axis] })
    };
    let quads: [[u32; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
    Mesh::new((0..8).map(corner).collect(), triangles.collect())
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Figure 4.2: the box around an object, found by guarded moves with the flat hand, {} seeds\n  \
             (thesis: a picture, without numbers)",
            self.seeds
        )?;
        writeln!(
            f,
            "  {:<30}{:>6}{:>9}{:>24}{:>10}{:>26}",
            "object", "moves", "touches", "face off, mm", "worst", "volume, %"
        )?;
        let spread = |s: &Option<Spread>| s.as_ref().map_or("-".into(), ToString::to_string);
        for row in &self.rows {
            writeln!(
                f,
                "  {:<30}{:>6}{:>9.1}{:>24}{:>10.1}{:>26}",
                row.object,
                row.moves,
                row.touches,
                spread(&row.face_mm),
                row.worst_mm,
                spread(&row.volume)
            )?;
        }
        write!(f, "  median (quartiles); on a table, which is the sixth side; contact noise 1 mm")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_found_to_the_noise_of_a_touch() {
        let figure = run(2).unwrap();
        assert_eq!(figure.rows.len(), OBJECTS.len());
        for row in &figure.rows {
            assert_eq!((row.moves, row.touches), (5, 5.0), "{}", row.object);
            assert!(row.worst_mm < 5.0, "{}: {}", row.object, row.worst_mm);
            let volume = row.volume.unwrap().median;
            assert!((85.0..115.0).contains(&volume), "{}: {volume}", row.object);
        }
        assert!(figure.picture.size().0 > 100);
        let text = figure.to_string();
        assert!(OBJECTS.iter().all(|o| text.contains(o)));
    }

    #[test]
    fn a_block_is_a_box() {
        let mesh = block(&Point::new(0.0, 0.0, 0.0), &Point::new(1.0, 2.0, 3.0)).unwrap();
        assert!(mesh.is_watertight() && (mesh.volume() - 6.0).abs() < 1e-12);
    }
}
