//! Table 3.1, "global localization of a fixed object": real and simulated fingertip contacts on
//! known objects beside published filters, and simulated ones whose pose is known.

use std::fmt;
use std::path::Path;
use std::time::Instant;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};
use rayon::prelude::*;
use serde::Serialize;

use crate::experiment::Spread;
use crate::localize::contacts::{ContactsError, Fixed, read};
use crate::localize::{LocalizeError, Settings, exhaustive, localize};
use crate::reference::Contact;
use crate::shape::files::{FileError, read_mesh};
use crate::shape::{Geometry, Mesh, ShapeError};
use crate::sim::random::Random;
use crate::sim::{ObjectSpec, SimError};
use crate::space::{Point, Pose};

/// Recordings of tacman's tactile-localization: contacts, model, and what is published or was found
/// elsewhere for them.
const RECORDINGS: [(&str, &str, &str); 6] = [
    (
        "measCylinder_exp",
        "cylinder",
        "memory unscented filter 8.85 mm in 4.9 s; scaling series 5.77 mm in 0.89 s; multi-start ICP 5.8 mm",
    ),
    ("measCleaner_exp", "cleaner", "multi-start ICP 7.1 mm"),
    ("measCleaner_sim", "cleaner", "–"),
    ("measBox100_sim", "box", "–"),
    ("measHelmet_sim", "helmet", "–"),
    ("measTetra30_sim", "tetrahedron", "–"),
];

/// Starts of the search that prunes nothing.
const STARTS: usize = 20_000;

/// A run reaches the optimum when it costs no more than this above the best that is known, nats of
/// its own width.
const REACHED: f64 = 0.1;

/// A search has done what it could when its best pose is at most this much less likely than the true
/// one, nats: normals of a scanned mesh jump from face to face, and the likelihood with them.
const CLOSE: f64 = 2.0;

/// Numbers of simulated contacts.
const CONTACTS: [usize; 3] = [5, 10, 20];

/// Of simulated contacts: 1 mm, and 5° in radians.
const NOISE: [f64; 2] = [1e-3, 0.0873];

/// The object at the pose found lies within this of itself at the true pose, metres.
const FOUND: f64 = 5e-3;

/// Objects with sizes of their own, not those of any recording.
const OBJECTS: [&str; 3] =
    ["box:0.11x0.07x0.045", "lshape:0.09x0.07x0.03x0.05", "cylinder:0.05x0.12"];

/// One recording, localised with many seeds of the search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recorded {
    /// Of its file.
    pub name: String,
    /// How many.
    pub contacts: usize,
    /// Mean distance of the contacts from the surface, millimetres.
    pub mean_mm: Option<Spread>,
    /// From contacts and mesh to modes, seconds.
    pub seconds: Option<Spread>,
    /// Modes of the first seed.
    pub modes: usize,
    /// Directions that it cannot observe.
    pub unobservable: usize,
    /// Runs that reach the best optimum known, of how many.
    pub reached: (usize, usize),
    /// Mean distance at the best pose of a search without pruning, millimetres.
    pub exhaustive_mm: f64,
    /// What others report.
    pub reference: String,
}

/// One object with one number of contacts at random poses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Simulated {
    /// As the simulator has it; `ycb/` and a name for a file.
    pub object: String,
    /// How many.
    pub contacts: usize,
    /// Whether they have normals.
    pub normals: bool,
    /// Part of the runs whose first mode is the true pose.
    pub first: f64,
    /// Part of the runs with the true pose among the modes.
    pub listed: f64,
    /// Part of the runs whose answer is as likely as the true pose: the search did what it could.
    pub optimal: f64,
    /// Weight of the first mode where it is right, and where it is wrong: median.
    pub weights: [Option<f64>; 2],
    /// How many runs.
    pub runs: usize,
}

/// The table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Part one.
    pub recorded: Vec<Recorded>,
    /// Part two.
    pub simulated: Vec<Simulated>,
    /// What was left out and why.
    pub skipped: Vec<String>,
}

/// Why there is no table.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Contacts cannot be read.
    #[error(transparent)]
    Contacts(#[from] ContactsError),
    /// A mesh cannot be read.
    #[error(transparent)]
    Mesh(#[from] FileError),
    /// An object cannot be made.
    #[error(transparent)]
    Object(#[from] SimError),
    /// A shape cannot be made.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// It cannot be localised.
    #[error("{name}: {source}")]
    Localize {
        /// What was.
        name: String,
        /// Why.
        source: LocalizeError,
    },
}

/// Both parts; recordings from `data`/touch, meshes from `data`/ycb where they exist.
///
/// # Errors
/// When a file is there but cannot be read.
pub fn run(data: Option<&Path>, seeds: u64) -> Result<Table, Error> {
    let mut table = Table { recorded: Vec::new(), simulated: Vec::new(), skipped: Vec::new() };
    for (name, model, reference) in RECORDINGS {
        let touch = data.map(|d| d.join("touch"));
        let files = touch.map(|t| {
            (t.join(format!("measurements/{name}.off")), t.join(format!("models/{model}.off")))
        });
        match files.filter(|(contacts, model)| contacts.is_file() && model.is_file()) {
            Some((contacts, model)) => {
                let (_, contacts) = read(&contacts, Fixed::Yes)?;
                let row = recorded(name, &read_mesh(&model)?, &contacts, seeds, reference)?;
                table.recorded.push(row);
            }
            None => table
                .skipped
                .push(format!("{name}: not in $TACTILE_DATA/touch or ../shared/data/touch")),
        }
    }
    for (name, mesh) in objects(data, &mut table.skipped)? {
        for contacts in CONTACTS {
            for normals in [false, true] {
                table.simulated.push(simulated(&name, &mesh, contacts, normals, seeds)?);
            }
        }
    }
    Ok(table)
}

/// Runs one after the other, so that their times mean something.
fn recorded(
    name: &str,
    mesh: &Mesh,
    contacts: &[Contact],
    seeds: u64,
    reference: &str,
) -> Result<Recorded, Error> {
    let wrong = |source| Error::Localize { name: name.into(), source };
    let slow = exhaustive(mesh, contacts, STARTS).map_err(wrong)?;
    let mut runs = Vec::new();
    let mut seconds = Vec::new();
    for seed in 0..seeds.max(1) {
        // A fresh mesh: its search tree is part of the work.
        let mesh = Mesh::new(mesh.vertices().to_vec(), mesh.triangles().to_vec())?;
        let start = Instant::now();
        let settings = Settings { seed, ..Settings::default() };
        runs.push(localize(&mesh, contacts, &settings).map_err(wrong)?);
        seconds.push(start.elapsed().as_secs_f64());
    }
    let nats = |run: &crate::localize::Localization| {
        run.modes.iter().map(|m| m.nats).fold(f64::INFINITY, f64::min)
    };
    let best = runs.iter().map(nats).fold(slow.nats, f64::min);
    let reached = runs.iter().filter(|r| nats(r) <= best + REACHED * r.misfit).count();
    Ok(Recorded {
        name: name.into(),
        contacts: contacts.len(),
        mean_mm: Spread::of(runs.iter().filter_map(|r| r.modes.first()).map(|m| 1e3 * m.mean)),
        seconds: Spread::of(seconds),
        modes: runs.first().map_or(0, |r| r.modes.len()),
        unobservable: runs.first().map_or(0, |r| r.freedoms.len()),
        reached: (reached, runs.len()),
        exhaustive_mm: 1e3 * slow.mean,
        reference: reference.into(),
    })
}

/// What is simulated, with its name.
fn objects(data: Option<&Path>, skipped: &mut Vec<String>) -> Result<Vec<(String, Mesh)>, Error> {
    let mut objects = vec![("wedge".into(), wedge()?), ("tetrahedron".into(), tetrahedron()?)];
    for name in OBJECTS {
        let spec: ObjectSpec = name.parse().map_err(SimError::from)?;
        if let Geometry::Mesh(mesh) = spec.geometry().map_err(SimError::from)? {
            objects.push((name.into(), mesh));
        }
    }
    let folder = data.map(|d| d.join("ycb"));
    let listed = folder.and_then(|f| std::fs::read_dir(f).ok()).into_iter().flatten().flatten();
    let mut meshes: Vec<_> = listed.map(|entry| entry.path()).collect();
    meshes.retain(|path| path.extension().is_some_and(|e| e == "ply"));
    meshes.sort();
    if meshes.is_empty() {
        skipped.push("YCB meshes: none in $TACTILE_DATA/ycb or ../shared/data/ycb".into());
    }
    for path in meshes {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        objects.push((format!("ycb/{name}"), read_mesh(&path)?));
    }
    Ok(objects)
}

/// A prism over a triangle with three different sides.
fn wedge() -> Result<Mesh, ShapeError> {
    let corners = [[0.0, 0.0], [0.1, 0.0], [0.03, 0.06]];
    let vertices = [-0.02, 0.02].iter().flat_map(|z| corners.map(|[x, y]| Point::new(x, y, *z)));
    let triangles = vec![
        [0, 2, 1],
        [3, 4, 5],
        [0, 1, 4],
        [0, 4, 3],
        [1, 2, 5],
        [1, 5, 4],
        [2, 0, 3],
        [2, 3, 5],
    ];
    Mesh::new(vertices.collect(), triangles)
}

/// Regular, with sides of 113 mm.
fn tetrahedron() -> Result<Mesh, ShapeError> {
    let a = 0.04;
    let corners = [[a, a, a], [a, -a, -a], [-a, a, -a], [-a, -a, a]];
    let triangles = vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]];
    Mesh::new(corners.map(Point::from).to_vec(), triangles)
}

/// One run.
struct Run {
    first: bool,
    listed: bool,
    optimal: bool,
    weight: f64,
}

fn simulated(
    name: &str,
    mesh: &Mesh,
    count: usize,
    normals: bool,
    seeds: u64,
) -> Result<Simulated, Error> {
    let rim: Vec<Point> = mesh.samples(300).into_iter().map(|s| s.0).collect();
    let places = mesh.samples(4000);
    let one = |seed: u64| -> Result<Run, Error> {
        let (truth, contacts) = touched(&places, count, normals, seed);
        let found = localize(mesh, &contacts, &Settings { seed, ..Settings::default() })
            .map_err(|source| Error::Localize { name: name.into(), source })?;
        let right = |pose: &Pose| {
            let off = truth.inverse() * pose;
            let away = |p: &Point| mesh.distance(&(off * Point3::from(*p)).coords);
            rim.iter().all(|p| away(p) < FOUND)
        };
        let best = found.modes.iter().map(|m| m.nats).fold(f64::INFINITY, f64::min);
        let true_nats = crate::localize::nats(mesh, &contacts, &truth)
            .map_err(|source| Error::Localize { name: name.into(), source })?;
        Ok(Run {
            first: found.modes.first().is_some_and(|m| right(&m.pose)),
            listed: found.modes.iter().any(|m| right(&m.pose)),
            optimal: best <= true_nats + CLOSE * found.misfit,
            weight: found.modes.first().map_or(0.0, |m| m.weight),
        })
    };
    let runs: Vec<Run> = (0..seeds.max(1)).into_par_iter().map(one).collect::<Result<_, _>>()?;
    let part = |which: fn(&Run) -> bool| {
        runs.iter().filter(|r| which(r)).count() as f64 / runs.len() as f64
    };
    let weight = |right: bool| {
        Spread::of(runs.iter().filter(|r| r.first == right).map(|r| r.weight)).map(|s| s.median)
    };
    Ok(Simulated {
        object: name.into(),
        contacts: count,
        normals,
        first: part(|r| r.first),
        listed: part(|r| r.listed),
        optimal: part(|r| r.optimal),
        weights: [weight(true), weight(false)],
        runs: runs.len(),
    })
}

/// A pose anywhere and contacts on the object there.
fn touched(
    places: &[(Point, Point)],
    count: usize,
    normals: bool,
    seed: u64,
) -> (Pose, Vec<Contact>) {
    let [mut poses, mut choices, mut noise] = Random::streams(seed);
    let [[a, b], [c, d]] = [poses.normal_pair(), poses.normal_pair()];
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(a, b, c, d));
    let shift = Point::from([(); 3].map(|()| poses.around_zero(0.5)));
    let pose = Pose::from_parts(Translation3::from(shift), rotation);
    let contact = |_| {
        let (point, normal) = places.get((choices.unit() * places.len() as f64) as usize)?;
        let (off, turn) = (noise.normal3() * NOISE[0], noise.normal3() * NOISE[1]);
        let normal = (normal + turn).normalize();
        Some(Contact {
            point: (pose * Point3::from(point + off)).coords,
            normal: normals.then_some(rotation * normal),
            point_deviation: NOISE[0],
            normal_deviation: NOISE[1],
        })
    };
    (pose, (0..count).filter_map(contact).collect())
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Table 3.1: global localization of a fixed object, 6 degrees of freedom")?;
        let show = |s: &Option<Spread>, unit: f64| {
            s.map_or("–".to_owned(), |s| {
                let Spread { low, median, high, .. } = s;
                format!("{:.2} [{:.2}, {:.2}]", unit * median, unit * low, unit * high)
            })
        };
        writeln!(
            f,
            "  {:<18}{:>9}  {:<20}{:<24}{:>6}{:>6}{:>10}{:>12}  published",
            "contacts of", "contacts", "mean mm", "time ms", "modes", "free", "optimum", "best mm"
        )?;
        for row in &self.recorded {
            writeln!(
                f,
                "  {:<18}{:>9}  {:<20}{:<24}{:>6}{:>6}{:>10}{:>12.2}  {}",
                row.name,
                row.contacts,
                show(&row.mean_mm, 1.0),
                show(&row.seconds, 1e3),
                row.modes,
                row.unobservable,
                format!("{}/{}", row.reached.0, row.reached.1),
                row.exhaustive_mm,
                row.reference
            )?;
        }
        writeln!(
            f,
            "  median [quartiles] over seeds of the search; optimum: runs that reach the best pose \
             known; best: of {STARTS} starts without pruning\n"
        )?;
        writeln!(
            f,
            "  {:<28}{:>9}{:>9}{:>8}{:>8}{:>9}{:>15}{:>15}{:>6}",
            "object, random pose",
            "contacts",
            "normals",
            "first",
            "listed",
            "optimal",
            "weight, right",
            "weight, wrong",
            "runs"
        )?;
        let share = |s: f64| format!("{:.0} %", 100.0 * s);
        for row in &self.simulated {
            let weight = |k: usize| row.weights[k].map_or("–".into(), share);
            writeln!(
                f,
                "  {:<28}{:>9}{:>9}{:>8}{:>8}{:>9}{:>15}{:>15}{:>6}",
                row.object,
                row.contacts,
                if row.normals { "yes" } else { "no" },
                share(row.first),
                share(row.listed),
                share(row.optimal),
                weight(0),
                weight(1),
                row.runs
            )?;
        }
        write!(
            f,
            "  noise 1 mm and 5°; first, listed: the first mode, any mode, puts the whole surface \
             within 5 mm of the true one; optimal: a pose as likely as the true one was found"
        )?;
        self.skipped.iter().try_for_each(|s| write!(f, "\n  skipped: {s}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_closed_and_outward() {
        for mesh in [wedge().unwrap(), tetrahedron().unwrap()] {
            assert!(mesh.is_watertight() && mesh.volume() > 0.0);
        }
    }

    #[test]
    fn twenty_contacts_suffice_for_a_wedge() {
        let row = simulated("wedge", &wedge().unwrap(), 20, false, 3).unwrap();
        assert_eq!((row.listed, row.optimal, row.runs), (1.0, 1.0, 3), "{row:?}");
    }

    #[test]
    fn without_recordings_the_table_says_so() {
        let none = tempfile::tempdir().unwrap();
        let mut skipped = Vec::new();
        assert_eq!(objects(Some(none.path()), &mut skipped).unwrap().len(), 5);
        assert!(skipped[0].contains("YCB"), "{skipped:?}");
    }
}
