//! Whether the reported uncertainty is honest: how often the true surface lies within the 95 % band
//! of the reconstructed one, where it was touched and where it was not.

use std::fmt;
use std::io::Write;
use std::path::Path;

use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::Serialize;

use crate::experiment::Spread;
use crate::quantity::Deviation;
use crate::shape::{Field, Geometry};
use crate::sim::{ObjectSpec, Options, SimError, Touch, simulate};
use crate::slam::choose::{Choice, Model};
use crate::slam::reconstruct::{Reconstruction, reconstruct};
use crate::slam::track;
use crate::space::Point;

/// A point of the true surface is touched within this of a contact, and untouched beyond that,
/// metres.
const TOUCHED: f64 = 0.010;
const UNTOUCHED: f64 = 0.025;

/// Standard deviations of a 95 % band.
const BAND: f64 = 1.96;

/// Points of the true surface that are judged: neighbours err together, more say nothing new.
const SAMPLES: usize = 250;

/// Vertices up to which a mesh is taken to have large triangles, in which deviations are
/// interpolated.
const COARSE: usize = 500;

/// Classes of objects. Concave outlines are in [`OUTLINES`], meshes in the data's folder `ycb`.
const OBJECTS: [(&str, &[&str]); 2] = [
    (
        "curved",
        &[
            "ellipse:0.12x0.06",
            "ellipse:0.09x0.07",
            "ellipsoid:0.12x0.08x0.06",
            "sphere:0.08",
            "cylinder:0.06x0.1",
        ],
    ),
    ("faceted", &["rectangle:0.12x0.06", "hexagon:0.045", "triangle:0.06", "box:0.12x0.06x0.06"]),
];

/// Corners in metres: an L and a U.
const OUTLINES: [&[[f64; 2]]; 2] = [
    &[[0.0, 0.0], [0.08, 0.0], [0.08, 0.03], [0.03, 0.03], [0.03, 0.09], [0.0, 0.09]],
    &[
        [0.0, 0.0],
        [0.1, 0.0],
        [0.1, 0.08],
        [0.07, 0.08],
        [0.07, 0.03],
        [0.03, 0.03],
        [0.03, 0.08],
        [0.0, 0.08],
    ],
];

const MESHES: [&str; 6] = [
    "banana.ply",
    "baseball.ply",
    "mustard_bottle.ply",
    "power_drill.ply",
    "sugar_box.ply",
    "tomato_soup_can.ply",
];

/// Noise of point (metres) and normal (degrees).
const NOISES: [(f64, f64); 3] = [(0.0, 0.0), (1e-3, 5.0), (2.2e-3, 8.0)];

/// Contacts in the plane and in space.
const COUNTS: [&[usize]; 2] = [&[5, 15, 40], &[20, 60]];

/// Why the experiment could not run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An object cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// An outline cannot be written down.
    #[error("outline of a concave object: {0}")]
    Outline(#[from] std::io::Error),
}

/// One object, noise and number of contacts, over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Curved, faceted, concave, scanned.
    pub class: &'static str,
    /// Object, noise, contacts, model asked for.
    pub case: String,
    /// Seeds that gave a surface.
    pub runs: usize,
    /// Runs whose model was faces, as a fraction.
    pub faces: f64,
    /// Share of the touched surface that lies within the band, over all runs; `None` without any.
    pub covered: Option<f64>,
    /// Share of the untouched surface that lies outside the band.
    pub overconfident: Option<f64>,
    /// Standard deviation reported where the surface was touched, millimetres.
    pub deviation_touched_mm: Option<Spread>,
    /// The same where it was not.
    pub deviation_untouched_mm: Option<Spread>,
    /// Error where the surface was touched, millimetres.
    pub error_touched_mm: Option<Spread>,
}

/// The whole table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// In order of class.
    pub rows: Vec<Row>,
    /// Over all rows of a class: its name, share covered, share overconfident.
    pub classes: Vec<(&'static str, Option<f64>, Option<f64>)>,
}

/// What one point of the true surface shows.
#[derive(Clone, Copy)]
struct Shown {
    /// To the nearest contact, metres.
    away: f64,
    /// To the reconstructed surface, metres.
    error: f64,
    /// As reported there, metres.
    deviation: f64,
}

/// Reconstructs all objects with seeds from `first` on, by the automatic model and by the Gaussian
/// process alone. Meshes are judged where `data` has them.
///
/// # Errors
/// When an object cannot be simulated.
pub fn run(data: Option<&Path>, first: u64, seeds: u64) -> Result<Table, Error> {
    let mut outlines = Vec::new();
    for corners in OUTLINES {
        let mut file = tempfile::Builder::new().suffix(".csv").tempfile()?;
        for [x, y] in corners {
            writeln!(file, "{x},{y}")?;
        }
        file.flush()?;
        outlines.push(file);
    }
    let mut cases: Vec<(&'static str, String, ObjectSpec)> = Vec::new();
    for (class, objects) in OBJECTS {
        for object in objects {
            let spec = object.parse().map_err(SimError::from)?;
            cases.push((class, (*object).to_owned(), spec));
        }
    }
    for (file, name) in outlines.iter().zip(["L 80 × 90 mm", "U 100 × 80 mm"]) {
        let spec = ObjectSpec::Polygon(file.path().into());
        cases.push(("concave", name.to_owned(), spec));
    }
    for name in MESHES {
        let file = data.map(|d| d.join("ycb").join(name)).filter(|f| f.is_file());
        cases.extend(file.map(|f| ("scanned", name.to_owned(), ObjectSpec::Mesh(f))));
    }
    let mut settings = Vec::new();
    for (class, name, spec) in cases {
        for (length, degrees) in NOISES {
            for contacts in COUNTS[spec.dimension() - 2] {
                let noise = Deviation { length, angle: degrees.to_radians() };
                let options = Options {
                    grasps: Some(1),
                    contacts: *contacts,
                    touch: Touch::Uniform,
                    contact_noise: noise,
                    ..Options::new(spec.clone())
                };
                let case =
                    format!("{name}, {:.1} mm / {degrees:.0}°, {contacts} contacts", 1e3 * length);
                settings.push((class, case, options));
            }
        }
    }
    // All runs at once: some take a hundred times as long as others.
    let runs: Vec<(usize, Options)> = (0..settings.len())
        .flat_map(|s| (first..first + seeds).map(move |seed| (s, seed)))
        .map(|(s, seed)| (s, Options { seed, ..settings[s].2.clone() }))
        .collect();
    let shown: Vec<(usize, [Option<Run>; 2])> = runs
        .into_par_iter()
        .map(|(setting, options)| Ok((setting, both(&options)?)))
        .collect::<Result<_, SimError>>()?;
    let mut rows = Vec::new();
    let mut all: Vec<(&'static str, Vec<Shown>)> = Vec::new();
    for (setting, (class, case, _)) in settings.iter().enumerate() {
        for (model, name) in ["auto", "gp"].into_iter().enumerate() {
            let own = shown.iter().filter(|(s, _)| *s == setting);
            let runs: Vec<&Run> = own.filter_map(|(_, runs)| runs[model].as_ref()).collect();
            let faces = runs.iter().filter(|r| r.0).count() as f64;
            let count = runs.len();
            let shown: Vec<Shown> = runs.into_iter().flat_map(|r| r.1.clone()).collect();
            let case = format!("{case}, {name}");
            rows.push(row(class, case, count, faces / count.max(1) as f64, &shown));
            // What users get; the process is often the same.
            if name == "auto" {
                all.push((class, shown));
            }
        }
    }
    let mut classes: Vec<(&'static str, Option<f64>, Option<f64>)> = Vec::new();
    for class in ["curved", "faceted", "concave", "scanned"] {
        let shown: Vec<Shown> =
            all.iter().filter(|(c, _)| *c == class).flat_map(|(_, s)| s.clone()).collect();
        classes.push((class, covered(&shown), overconfident(&shown)));
    }
    Ok(Table { rows, classes })
}

/// Whether faces were the model, and what the true surface shows.
type Run = (bool, Vec<Shown>);

/// Of the automatic model and of the Gaussian process, which is often the same.
fn both(options: &Options) -> Result<[Option<Run>; 2], SimError> {
    let auto = one(options, Choice::Auto)?;
    let process = match &auto {
        Some((true, _)) => one(options, Choice::Gp)?,
        _ => auto.clone(),
    };
    Ok([auto, process])
}

/// `None` where nothing was reconstructed.
fn one(options: &Options, choice: Choice) -> Result<Option<Run>, SimError> {
    let simulation = simulate(options)?;
    let Ok(steps) = track::truth(&simulation.log) else { return Ok(None) };
    let Ok(made) = reconstruct(&simulation.log, &steps, choice, &|_, _| {}) else {
        return Ok(None);
    };
    Ok(Some((made.model.name() == "faces", shown(&made, &simulation.geometry))))
}

fn shown(made: &Reconstruction, truth: &Geometry) -> Vec<Shown> {
    let points: Vec<Point> = truth.samples(SAMPLES).into_iter().map(|s| s.0).collect();
    let closest: Vec<Point> = points.iter().map(|p| made.geometry.closest(p)).collect();
    let deviations = match &made.model {
        // Faces know how certain they are anywhere on them, not only at their corners.
        Model::Faces(polytope) => polytope.deviations(&closest),
        Model::Gp(_) => {
            let reported = |p: &Point| deviation(&made.geometry, &made.deviations, p);
            closest.iter().map(reported).collect()
        }
    };
    let one = |((p, closest), deviation): ((&Point, &Point), f64)| {
        let contacts = made.contacts.iter().map(|c| (c.contact.point - p).norm());
        Shown {
            away: contacts.fold(f64::INFINITY, f64::min),
            error: (closest - p).norm(),
            deviation,
        }
    };
    points.iter().zip(&closest).zip(deviations).map(one).collect()
}

/// The deviation reported at a point of the surface: interpolated along the edge or in the triangle
/// it lies on; on a fine mesh that of the nearest vertex. Infinite where nothing is reported.
fn deviation(geometry: &Geometry, deviations: &[f64], point: &Point) -> f64 {
    let mut nearest = (f64::INFINITY, f64::INFINITY);
    let mut offer = |distance: f64, deviation: f64| {
        if distance < nearest.0 {
            nearest = (distance, deviation);
        }
    };
    match geometry {
        Geometry::Outline(outline) => {
            let mut first = 0;
            for vertices in &outline.loops {
                for (i, v) in vertices.iter().enumerate() {
                    let j = (i + 1) % vertices.len();
                    let a = Point::new(v[0], v[1], 0.0);
                    let edge = Point::new(vertices[j][0], vertices[j][1], 0.0) - a;
                    let share = (point - a).dot(&edge) / edge.norm_squared();
                    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
                    let (from, to) = (deviations.get(first + i), deviations.get(first + j));
                    if let (Some(from), Some(to)) = (from, to) {
                        let distance = (a + edge * share - point).norm();
                        offer(distance, from + share * (to - from));
                    }
                }
                first += vertices.len();
            }
        }
        Geometry::Mesh(mesh) if mesh.vertices().len() > COARSE => {
            for (vertex, deviation) in mesh.vertices().iter().zip(deviations) {
                offer((vertex - point).norm(), *deviation);
            }
        }
        Geometry::Mesh(mesh) => {
            for triangle in mesh.triangles() {
                let [a, b, c] = triangle.map(|v| mesh.vertices()[v as usize]);
                let across = (b - a).cross(&(c - a));
                let Some(inverse) = Matrix3::from_columns(&[b - a, c - a, across]).try_inverse()
                else {
                    continue;
                };
                let at = inverse * (point - a);
                // Moved into the triangle: exact for points on it, near enough for the others.
                let (u, v) = (at.x.clamp(0.0, 1.0), at.y.clamp(0.0, 1.0));
                let over = (u + v).max(1.0);
                let (u, v) = (u / over, v / over);
                let found = triangle.map(|v| deviations.get(v as usize).copied());
                if let [Some(x), Some(y), Some(z)] = found {
                    let distance = (a + (b - a) * u + (c - a) * v - point).norm();
                    offer(distance, x + (y - x) * u + (z - x) * v);
                }
            }
        }
    }
    nearest.1
}

fn share(
    shown: &[Shown],
    of: impl Fn(&Shown) -> bool,
    good: impl Fn(&Shown) -> bool,
) -> Option<f64> {
    let counted: Vec<&Shown> = shown.iter().filter(|s| of(s)).collect();
    let right = counted.iter().filter(|s| good(s)).count() as f64;
    (!counted.is_empty()).then(|| right / counted.len() as f64)
}

fn covered(shown: &[Shown]) -> Option<f64> {
    share(shown, |s| s.away < TOUCHED, |s| s.error <= BAND * s.deviation)
}

fn overconfident(shown: &[Shown]) -> Option<f64> {
    share(shown, |s| s.away > UNTOUCHED, |s| s.error > BAND * s.deviation)
}

fn row(class: &'static str, case: String, runs: usize, faces: f64, shown: &[Shown]) -> Row {
    let spread = |of: fn(&Shown) -> bool, what: fn(&Shown) -> f64| {
        Spread::of(shown.iter().filter(|s| of(s)).map(|s| 1e3 * what(s)))
    };
    Row {
        class,
        case,
        runs,
        faces,
        covered: covered(shown),
        overconfident: overconfident(shown),
        deviation_touched_mm: spread(|s| s.away < TOUCHED, |s| s.deviation),
        deviation_untouched_mm: spread(|s| s.away > UNTOUCHED, |s| s.deviation),
        error_touched_mm: spread(|s| s.away < TOUCHED, |s| s.error),
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent =
            |s: Option<f64>| s.map_or("–".to_owned(), |s| format!("{:.1} %", 100.0 * s));
        let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
        writeln!(f, "Calibration: the true surface within the 95 % band (goal 90–98 % of it)")?;
        writeln!(
            f,
            "  {:<10}{:<58}{:>5}{:>7}{:>9}{:>15}  {:<20}{:<20}{:<20}",
            "class",
            "case",
            "runs",
            "faces",
            "covered",
            "overconfident",
            "σ touched mm",
            "error touched mm",
            "σ untouched mm"
        )?;
        for row in &self.rows {
            writeln!(
                f,
                "  {:<10}{:<58}{:>5}{:>7}{:>9}{:>15}  {:<20}{:<20}{:<20}",
                row.class,
                row.case,
                row.runs,
                format!("{:.0} %", 100.0 * row.faces),
                percent(row.covered),
                percent(row.overconfident),
                show(&row.deviation_touched_mm),
                show(&row.error_touched_mm),
                show(&row.deviation_untouched_mm),
            )?;
        }
        for (class, covered, overconfident) in &self.classes {
            if !self.rows.iter().any(|row| row.class == *class) {
                writeln!(
                    f,
                    "  {class}: not judged, for their meshes are not there (docs/data.md)"
                )?;
                continue;
            }
            writeln!(
                f,
                "  {class}: {} of the touched surface covered, {} of the untouched outside the band",
                percent(*covered),
                percent(*overconfident)
            )?;
        }
        write!(
            f,
            "  touched: within {:.0} mm of a contact; untouched: beyond {:.0} mm",
            1e3 * TOUCHED,
            1e3 * UNTOUCHED
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::Outline;
    use crate::shape::mesh::tests::cuboid;

    #[test]
    fn deviations_are_interpolated_on_edges_and_in_triangles() {
        let square = vec![[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
        let outline = Geometry::Outline(Outline::new(vec![square]).unwrap());
        let at =
            |x: f64, y: f64| deviation(&outline, &[1.0, 2.0, 4.0, 8.0], &Point::new(x, y, 0.0));
        assert!((at(0.025, 0.0) - 1.25).abs() < 1e-12);
        assert!((at(0.1, 0.05) - 3.0).abs() < 1e-12);
        assert!((at(0.0, 0.05) - 4.5).abs() < 1e-12);
        // Linear in the vertices' x, so linear in every triangle.
        let mesh = cuboid([0.03, 0.02, 0.01]);
        let linear: Vec<f64> = mesh.vertices().iter().map(|v| 1.0 + 10.0 * v.x).collect();
        let geometry = Geometry::Mesh(mesh);
        for (p, _) in geometry.samples(50) {
            assert!((deviation(&geometry, &linear, &p) - (1.0 + 10.0 * p.x)).abs() < 1e-9);
        }
        assert_eq!(deviation(&geometry, &[], &Point::zeros()), f64::INFINITY);
    }

    #[test]
    fn shares_count_only_their_own_part_of_the_surface() {
        let at = |away: f64, error: f64| Shown { away, error, deviation: 1e-3 };
        let shown =
            [at(0.001, 1e-3), at(0.002, 3e-3), at(0.02, 9.0), at(0.03, 1e-3), at(0.03, 3e-3)];
        assert_eq!(covered(&shown), Some(0.5));
        assert_eq!(overconfident(&shown), Some(0.5));
        assert_eq!(covered(&shown[2..3]), None);
    }

    #[test]
    fn an_ellipse_is_covered_where_it_was_touched() {
        let spec: ObjectSpec = "ellipse:0.1x0.06".parse().unwrap();
        let mut all = Vec::new();
        for seed in 2000..2006 {
            let options = Options {
                grasps: Some(1),
                contacts: 12,
                touch: Touch::Uniform,
                seed,
                ..Options::new(spec.clone())
            };
            let (faces, shown) = one(&options, Choice::Gp).unwrap().unwrap();
            assert!(!faces);
            all.extend(shown);
        }
        let covered = covered(&all).unwrap();
        assert!((0.85..=1.0).contains(&covered), "{covered}");
    }
}
