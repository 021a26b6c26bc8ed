//! Contacts for experiments on shape, at known poses: on simulated objects, on an apple from one
//! side, at a corner.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::reference::Contact;
use crate::shape::{Geometry, Mesh, Outline};
use crate::sim::random::Random;
use crate::sim::{Options, SimError, Touch, simulate};
use crate::slam::place::place;
use crate::slam::track;
use crate::space::Point;

/// Where contacts come from, with 1 mm and 5° of noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// Uniformly drawn from the surface of an object, see [`crate::sim::ObjectSpec`].
    Uniform(&'static str),
    /// One grasp of a hand.
    Grasp(&'static str),
    /// An apple of 80 mm, from the side of −y only.
    Apple,
    /// Two contacts on one side of a square's corner and one on the other, without noise.
    Corner,
}

/// An object and its contacts, object frame, metres.
#[derive(Clone, Debug)]
pub struct Touched {
    /// The true shape.
    pub truth: Geometry,
    /// In the order they were made.
    pub contacts: Vec<Contact>,
}

impl Touched {
    /// The same with the first `count` contacts.
    pub fn first(&self, count: usize) -> Touched {
        let contacts = self.contacts.iter().take(count).copied().collect();
        Touched { truth: self.truth.clone(), contacts }
    }
}

impl Source {
    /// As tables name it.
    pub fn name(&self) -> &'static str {
        match self {
            Source::Uniform(object) | Source::Grasp(object) => object,
            Source::Apple => "apple, one side",
            Source::Corner => "corner",
        }
    }

    /// `count` contacts (a grasp may give fewer, a corner has three); a seed gives the same ones.
    ///
    /// # Errors
    /// When the object cannot be simulated.
    pub fn touch(&self, count: usize, seed: u64) -> Result<Touched, SimError> {
        match self {
            Source::Uniform(object) => simulated(object, Touch::Uniform, count, seed),
            Source::Grasp(object) => simulated(object, Touch::Hand, count, seed),
            Source::Apple => Ok(from_one_side(apple(0.04), count, seed)),
            Source::Corner => Ok(corner()),
        }
    }
}

fn simulated(object: &str, touch: Touch, contacts: usize, seed: u64) -> Result<Touched, SimError> {
    let options =
        Options { grasps: Some(1), contacts, touch, seed, ..Options::new(object.parse()?) };
    let simulation = simulate(&options)?;
    let steps = track::truth(&simulation.log).unwrap_or_default();
    let contacts = place(&simulation.log, &steps).into_iter().map(|p| p.contact).collect();
    Ok(Touched { truth: simulation.geometry, contacts })
}

/// The outer part of a spindle torus: dents at both poles. `reach` is the greatest radius, metres.
fn apple(reach: f64) -> Geometry {
    const SLICES: u32 = 96;
    const STACKS: u32 = 64;
    // Centres of the generating circle lie a quarter of its radius off the axis.
    let radius = reach / 1.25;
    let end = FRAC_PI_2 + 0.25f64.asin();
    let pole = radius * end.sin();
    let mut vertices = vec![Point::new(0.0, 0.0, -pole), Point::new(0.0, 0.0, pole)];
    for stack in 1..STACKS {
        let (sin, cos) = (end * (2.0 * f64::from(stack) / f64::from(STACKS) - 1.0)).sin_cos();
        let (across, z) = (radius * (0.25 + cos), radius * sin);
        vertices.extend((0..SLICES).map(|slice| {
            let (sin, cos) = (TAU * f64::from(slice) / f64::from(SLICES)).sin_cos();
            Point::new(across * cos, across * sin, z)
        }));
    }
    let at = |stack: u32, slice: u32| 2 + stack * SLICES + slice % SLICES;
    let mut triangles = Vec::new();
    for slice in 0..SLICES {
        triangles.push([0, at(0, slice + 1), at(0, slice)]);
        triangles.push([1, at(STACKS - 2, slice), at(STACKS - 2, slice + 1)]);
        for stack in 0..STACKS - 2 {
            let (a, b) = (at(stack, slice), at(stack, slice + 1));
            let (c, d) = (at(stack + 1, slice), at(stack + 1, slice + 1));
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    Geometry::Mesh(Mesh::new(vertices, triangles).unwrap_or_default())
}

/// Contacts on the side of −y, with noise.
fn from_one_side(truth: Geometry, count: usize, seed: u64) -> Touched {
    const CANDIDATES: usize = 4000;
    let [mut places, mut noise] = Random::streams(seed);
    let near: Vec<(Point, Point)> =
        truth.samples(CANDIDATES).into_iter().filter(|(p, _)| p.y < 0.0).collect();
    let contacts = (0..count).filter_map(|_| {
        let (point, normal) = near.get((places.unit() * near.len() as f64) as usize)?;
        let (shift, turn) = (noise.normal3() * POINT, noise.normal3() * NORMAL);
        Some(contact(point + shift, (normal + turn).normalize()))
    });
    let contacts = contacts.collect();
    Touched { truth, contacts }
}

/// Of contacts: 1 mm and 5°.
const POINT: f64 = 1e-3;
const NORMAL: f64 = 0.0873;

fn contact(point: Point, normal: Point) -> Contact {
    Contact { point, normal: Some(normal), point_deviation: POINT, normal_deviation: NORMAL }
}

fn corner() -> Touched {
    let corners = vec![[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]];
    let contacts = vec![
        contact(Point::new(-0.01, 0.03, 0.0), Point::y()),
        contact(Point::new(0.02, 0.03, 0.0), Point::y()),
        contact(Point::new(0.03, 0.01, 0.0), Point::x()),
    ];
    Touched { truth: Geometry::Outline(Outline { loops: vec![corners] }), contacts }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_apple_is_closed_and_dented() {
        let Geometry::Mesh(mesh) = apple(0.04) else { panic!() };
        assert!(mesh.is_watertight() && mesh.volume() > 0.0);
        let (low, high) = mesh.bounds();
        assert!((high.x - 0.04).abs() < 1e-4 && (low.x + 0.04).abs() < 1e-4);
        // At the pole it is lower than around it.
        assert!(mesh.vertices()[1].z < high.z - 5e-4);
    }

    #[test]
    fn contacts_lie_where_they_are_said_to() {
        let apple = Source::Apple.touch(30, 3).unwrap();
        assert_eq!(apple.contacts.len(), 30);
        for c in &apple.contacts {
            assert!(c.point.y < 4e-3 && apple.truth.distance(&c.point) < 5e-3);
            assert!((c.normal.unwrap().norm() - 1.0).abs() < 1e-12);
        }
        let corner = Source::Corner.touch(9, 0).unwrap();
        assert_eq!(corner.contacts.len(), 3);
        assert!(corner.contacts.iter().all(|c| corner.truth.distance(&c.point) < 1e-12));
        let same = |seed| Source::Uniform("ellipse:0.12x0.06").touch(10, seed).unwrap().contacts;
        assert_eq!(same(1), same(1));
        assert_ne!(same(1), same(2));
        assert_eq!(Source::Grasp("sphere:0.07").touch(5, 0).unwrap().contacts.len(), 5);
    }
}
