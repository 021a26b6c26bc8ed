//! The surface as it grows: fitted again to what the first few grasps felt, to what some more did, and
//! so on. Coarser than the final one, so that it costs little beside it.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::model::bare;
use crate::reference::Contact;
use crate::shape::{Field, Geometry, Mesh, Outline};
use crate::slam::choose::{self, Model};
use crate::slam::fit::fit;
use crate::slam::free::Free;
use crate::slam::place::Placed;
use crate::slam::reconstruct::{Reconstruction, extract_at, outside};
use crate::space::Point;
use crate::thin::evenly;

/// Surfaces on the way at most, the final one not counted.
const MOMENTS: usize = 7;

/// Contacts and free points that a surface on the way is fitted to at most, in the plane and in space.
const CONTACTS: [usize; 2] = [120, 60];
const FREE: usize = 20;

/// Lattice cells across the contacts' bounding box for surfaces on the way.
const CELLS: [f64; 2] = [80.0, 18.0];

/// Contacts below which there is no telling what the surface is.
const LEAST_CONTACTS: usize = 3;

/// How far beyond the contacts' box a surface on the way is shown, in sizes of the box.
const AROUND: f64 = 0.35;

/// Flat faces are cut into pieces of this share of their size, for their colours.
const PIECE: f64 = 1.0 / 24.0;

/// Most triangles of a surface on the way, and of the final one or a true shape.
const TRIANGLES: usize = 12_000;
const FINAL_TRIANGLES: usize = 100_000;

/// A surface on the way.
#[derive(Clone, Debug)]
pub struct Grown {
    /// Position in the log of the last grasp it was fitted to.
    pub grasp: usize,
    /// Estimated object frame.
    pub geometry: Geometry,
    /// Standard deviation along the normal at each vertex, metres.
    pub deviations: Vec<f64>,
}

/// Surfaces of ever more of the reconstruction's contacts, and at last its own. `free` tells where
/// fingertips touched nothing in so many grasps. Contacts that no surface fits leave a gap.
pub fn grow(
    dimension: usize,
    reconstruction: &Reconstruction,
    free: &(dyn Fn(usize) -> Vec<Free> + Sync),
) -> Vec<Grown> {
    let placed = &reconstruction.contacts;
    let flat = matches!(reconstruction.model, Model::Faces(_));
    let mut grown: Vec<Grown> = moments(placed)
        .into_par_iter()
        .filter_map(|(grasp, count)| {
            let felt: Vec<Contact> = placed[..count].iter().map(|p| p.contact).collect();
            let contacts = evenly(&felt, CONTACTS[usize::from(dimension == 3)]);
            let contacts = bare::guessed(dimension, &contacts).unwrap_or(contacts);
            let free = evenly(&free(grasp + 1), FREE);
            let (geometry, deviations) = coarse(dimension, &contacts, &free, flat)?;
            let (geometry, deviations) = thinned(geometry, deviations, TRIANGLES);
            Some(Grown { grasp, geometry, deviations })
        })
        .collect();
    let last = placed.last().map_or(0, |p| p.grasp);
    let (geometry, deviations) = viewed(reconstruction);
    grown.push(Grown { grasp: last, geometry, deviations });
    grown
}

/// A reconstruction as a viewer draws it: flat faces with vertices enough for their colours, and no
/// more triangles than it draws smoothly; and the standard deviation at each vertex, metres.
pub fn viewed(reconstruction: &Reconstruction) -> (Geometry, Vec<f64>) {
    let (geometry, deviations) = match &reconstruction.model {
        Model::Faces(polytope) => coloured(&reconstruction.geometry, polytope.as_ref()),
        Model::Gp(_) => (reconstruction.geometry.clone(), reconstruction.deviations.clone()),
    };
    thinned(geometry, deviations, FINAL_TRIANGLES)
}

/// Before the last grasp with contacts: the grasps after which to look, closer together at the start,
/// where a grasp teaches most; each with the number of contacts until then.
fn moments(placed: &[Placed]) -> Vec<(usize, usize)> {
    let mut ends: Vec<(usize, usize)> = Vec::new();
    for (i, p) in placed.iter().enumerate() {
        match ends.last_mut() {
            Some((grasp, count)) if *grasp == p.grasp => *count = i + 1,
            _ => ends.push((p.grasp, i + 1)),
        }
    }
    ends.pop();
    ends.retain(|(_, count)| *count >= LEAST_CONTACTS);
    if ends.len() <= MOMENTS {
        return ends;
    }
    let last = (ends.len() - 1) as f64;
    let place = |k: usize| (last * (k as f64 / (MOMENTS - 1) as f64).powf(1.6)).round() as usize;
    let mut places: Vec<usize> = (0..MOMENTS).map(place).collect();
    places.dedup();
    places.into_iter().map(|at| ends[at]).collect()
}

fn coarse(
    dimension: usize,
    contacts: &[Contact],
    free: &[Free],
    flat: bool,
) -> Option<(Geometry, Vec<f64>)> {
    if flat && let Ok((_, polytope)) = choose::judge(dimension, contacts, &outside(contacts, free))
    {
        return Some(coloured(&polytope.geometry, &polytope));
    }
    let blend = fit(dimension, contacts, free).ok()?.surface;
    let (geometry, deviations) =
        extract_at(dimension, &blend, contacts, CELLS[usize::from(dimension == 3)]).ok()?;
    Some(match geometry {
        Geometry::Mesh(mesh) => about(mesh, deviations, contacts),
        outline => (outline, deviations),
    })
}

/// A mesh, if it does not close, as far as it lies about what was touched: few contacts may not make a body,
/// and how the surface goes on far away is the model's fancy.
fn about(mesh: Mesh, deviations: Vec<f64>, contacts: &[Contact]) -> (Geometry, Vec<f64>) {
    if mesh.is_watertight() {
        return (Geometry::Mesh(mesh), deviations);
    }
    let far = Point::repeat(f64::INFINITY);
    let low = contacts.iter().fold(far, |low, c| low.inf(&c.point));
    let high = contacts.iter().fold(-far, |high, c| high.sup(&c.point));
    let reach = Point::repeat(AROUND * (high - low).amax());
    let near = |v: &Point| (v - low + reach).min() >= 0.0 && (high + reach - v).min() >= 0.0;
    let stays = |t: &&[u32; 3]| t.iter().all(|v| near(&mesh.vertices()[*v as usize]));
    let kept: Vec<[u32; 3]> = mesh.triangles().iter().filter(stays).copied().collect();
    // Vertices of what is left only: a scene is as large as they reach.
    let mut number = HashMap::new();
    let mut old: Vec<u32> = Vec::new();
    let triangles = kept.iter().map(|t| {
        t.map(|v| {
            *number.entry(v).or_insert_with(|| {
                old.push(v);
                old.len() as u32 - 1
            })
        })
    });
    let triangles: Vec<[u32; 3]> = triangles.collect();
    let vertices = old.iter().map(|v| mesh.vertices()[*v as usize]).collect();
    let left = old.iter().filter_map(|v| deviations.get(*v as usize).copied()).collect();
    match Mesh::new(vertices, triangles) {
        Ok(about) => (Geometry::Mesh(about), left),
        Err(_) => (Geometry::Mesh(mesh), deviations),
    }
}

/// The same shape with vertices on its faces and edges, and the deviation at each.
fn coloured(geometry: &Geometry, field: &dyn Field) -> (Geometry, Vec<f64>) {
    let (low, high) = geometry.bounds();
    let piece = PIECE * (high - low).amax();
    if !(piece > 0.0 && piece.is_finite()) {
        return (geometry.clone(), Vec::new());
    }
    let (geometry, points) = match geometry {
        Geometry::Outline(outline) => {
            let loops: Vec<_> = outline.loops.iter().map(|l| divided(l, piece)).collect();
            let points = loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect();
            (Geometry::Outline(Outline { loops }), points)
        }
        Geometry::Mesh(mesh) => {
            let mesh = subdivided(mesh, 2.0 * piece);
            let points = mesh.vertices().to_vec();
            (Geometry::Mesh(mesh), points)
        }
    };
    (geometry, field.deviations(&points))
}

/// A polygon with no edge longer than `longest`.
fn divided(corners: &[[f64; 2]], longest: f64) -> Vec<[f64; 2]> {
    let next = corners.iter().cycle().skip(1);
    let edges = corners.iter().zip(next);
    edges
        .flat_map(|(a, b)| {
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            let pieces = (dx.hypot(dy) / longest).ceil().clamp(1.0, 1e3) as usize;
            (0..pieces).map(move |i| {
                let share = i as f64 / pieces as f64;
                [a[0] + share * dx, a[1] + share * dy]
            })
        })
        .collect()
}

/// A mesh whose edges are halved until none is longer than `longest`, or there are many. Neighbours
/// share their edges' middles, so that no gaps open.
fn subdivided(mesh: &Mesh, longest: f64) -> Mesh {
    let mut vertices = mesh.vertices().to_vec();
    let mut triangles = mesh.triangles().to_vec();
    let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
    while triangles.len() < TRIANGLES {
        let before = triangles.len();
        let mut finer = Vec::with_capacity(2 * before);
        for [a, b, c] in triangles {
            // Both owners of an edge see the same length, and halve it or not alike.
            let length = |i: u32, j: u32| (vertices[i as usize] - vertices[j as usize]).norm();
            let long = [length(a, b), length(b, c), length(c, a)].map(|l| l > longest);
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    vertices.push(0.5 * (vertices[i as usize] + vertices[j as usize]));
                    vertices.len() as u32 - 1
                })
            };
            match long {
                [false, false, false] => finer.push([a, b, c]),
                [true, false, false] => split_one(&mut finer, [a, b, c], middle(a, b)),
                [false, true, false] => split_one(&mut finer, [b, c, a], middle(b, c)),
                [false, false, true] => split_one(&mut finer, [c, a, b], middle(c, a)),
                [true, true, false] => {
                    split_two(&mut finer, [a, b, c], middle(a, b), middle(b, c));
                }
                [false, true, true] => {
                    split_two(&mut finer, [b, c, a], middle(b, c), middle(c, a));
                }
                [true, false, true] => {
                    split_two(&mut finer, [c, a, b], middle(c, a), middle(a, b));
                }
                [true, true, true] => {
                    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                    finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
                }
            }
        }
        triangles = finer;
        if triangles.len() == before {
            break;
        }
    }
    Mesh::new(vertices, triangles).unwrap_or_else(|_| mesh.clone())
}

/// The triangle cut from the middle of its first edge.
fn split_one(finer: &mut Vec<[u32; 3]>, [a, b, c]: [u32; 3], ab: u32) {
    finer.extend([[a, ab, c], [ab, b, c]]);
}

/// The triangle cut at the middles of its first and second edge.
fn split_two(finer: &mut Vec<[u32; 3]>, [a, b, c]: [u32; 3], ab: u32, bc: u32) {
    finer.extend([[a, ab, c], [ab, b, bc], [ab, bc, c]]);
}

/// At most `most` triangles: vertices of one cell of a grid become one, in the coarsest grid that is
/// needed. Outlines and small meshes stay as they are.
pub fn thinned(geometry: Geometry, deviations: Vec<f64>, most: usize) -> (Geometry, Vec<f64>) {
    let Geometry::Mesh(mesh) = &geometry else { return (geometry, deviations) };
    if mesh.triangles().len() <= most {
        return (geometry, deviations);
    }
    let (low, high) = mesh.bounds();
    // A closed surface of t triangles on a grid of n cells a side has about 6 n² of them and more.
    let mut cells = (most as f64 / 6.0).sqrt().max(2.0);
    loop {
        let cell = ((high - low).amax() / cells).max(f64::MIN_POSITIVE);
        let (thin, thin_deviations) = clustered(mesh, &deviations, low, cell);
        if thin.triangles().len() <= most || cells < 3.0 {
            return (Geometry::Mesh(thin), thin_deviations);
        }
        cells *= 0.8;
    }
}

fn clustered(mesh: &Mesh, deviations: &[f64], low: Point, cell: f64) -> (Mesh, Vec<f64>) {
    let mut places: HashMap<[i64; 3], u32> = HashMap::new();
    let mut sums: Vec<(Point, f64, f64)> = Vec::new();
    let place: Vec<u32> = mesh
        .vertices()
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let at = (v - low).map(|x| (x / cell).floor() as i64).data.0[0];
            let new = sums.len() as u32;
            let place = *places.entry(at).or_insert(new);
            if place == new {
                sums.push((Point::zeros(), 0.0, 0.0));
            }
            let (sum, deviation, count) = &mut sums[place as usize];
            *sum += v;
            *deviation += deviations.get(i).copied().unwrap_or(f64::NAN);
            *count += 1.0;
            place
        })
        .collect();
    let triangles: Vec<[u32; 3]> = mesh
        .triangles()
        .iter()
        .map(|t| t.map(|v| place[v as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    let vertices = sums.iter().map(|(sum, _, count)| sum / *count).collect();
    let mean = sums.iter().map(|(_, deviation, count)| deviation / count).collect();
    match Mesh::new(vertices, triangles) {
        Ok(thin) => (thin, if deviations.is_empty() { Vec::new() } else { mean }),
        Err(_) => (mesh.clone(), deviations.to_vec()),
    }
}

/// A true shape as a scene shows it: with no more triangles than a viewer draws smoothly.
pub fn shown(truth: &Geometry) -> Geometry {
    thinned(truth.clone(), Vec::new(), FINAL_TRIANGLES).0
}

#[cfg(test)]
#[path = "growth_tests.rs"]
mod tests;
