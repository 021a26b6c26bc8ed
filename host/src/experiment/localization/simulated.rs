//! Known objects at random poses.

use std::path::Path;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};
use rayon::prelude::*;
use serde::Serialize;

use super::Error;
use crate::experiment::Spread;
use crate::localize::{Settings, localize, nats};
use crate::reference::Contact;
use crate::shape::files::read_mesh;
use crate::shape::{Geometry, Mesh, ShapeError};
use crate::sim::random::Random;
use crate::sim::{ObjectSpec, SimError};
use crate::space::{Point, Pose};

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

/// All objects, YCB meshes from `data`/ycb.
pub(super) fn run(
    data: Option<&Path>,
    seeds: u64,
    skipped: &mut Vec<String>,
) -> Result<Vec<Simulated>, Error> {
    let mut rows = Vec::new();
    for (name, mesh) in objects(data, skipped)? {
        for contacts in CONTACTS {
            for normals in [false, true] {
                rows.push(simulated(&name, &mesh, contacts, normals, seeds)?);
            }
        }
    }
    Ok(rows)
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
        skipped.push("YCB meshes: none in $TACTILE_DATA/ycb".into());
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
        let true_nats = nats(mesh, &contacts, &truth)
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
