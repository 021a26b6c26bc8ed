//! Which surface model suits the contacts: fitted faces where every sign says that the object is a
//! convex polytope, the Gaussian process otherwise.

use crate::reference::faces::Faces;
use crate::reference::{Contact, Kernel};
use crate::shape::Geometry;
use crate::shape::polytope::{Polytope, intersect};
use crate::space::Point;

/// What the user wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Choice {
    /// Faces where they are trustworthy, see [`judge`], else the Gaussian process.
    #[default]
    Auto,
    /// Faces; an error where they do not close.
    Faces,
    /// The Gaussian process.
    Gp,
}

/// The model a reconstruction was made with.
#[derive(Clone, Debug)]
pub enum Model {
    /// The Gaussian process, with the kernel that explained the contacts best.
    Gp(Kernel),
    /// A convex polytope.
    Faces(Faces),
}

impl Model {
    /// As reports name it.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Gp(_) => "gp",
            Model::Faces(_) => "faces",
        }
    }
}

/// Why faces are not chosen.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Faces are found from normals.
    #[error("no contact has a normal")]
    NoNormals,
    /// Poses are so doubtful that the contacts would fit anything.
    #[error("normals are only known to {degrees:.0}°: too little to tell faces from a curve")]
    Doubtful {
        /// Median standard deviation of the contacts' normals, degrees, the doubt about the poses
        /// included.
        degrees: f64,
    },
    /// Sides were not touched, or the contacts show a hollow from inside.
    #[error("{faces} faces touched by {contacts} contacts do not close: touch the other sides")]
    Open {
        /// How many were found.
        faces: usize,
        /// From how many contacts.
        contacts: usize,
    },
    /// So few contacts a face that anything fits.
    #[error("{faces} faces for {contacts} contacts: too few contacts to tell faces from a curve")]
    Few {
        /// How many were found.
        faces: usize,
        /// From how many contacts.
        contacts: usize,
    },
    /// A contact lies outside another face.
    #[error("the contacts show a concavity: one lies {deviations:.1} deviations outside a face")]
    Concave {
        /// [`Faces::protrusion`].
        deviations: f64,
    },
    /// The normals turn within faces.
    #[error("the surface is curved: normals turn within faces by {deviations:.1} deviations")]
    Curved {
        /// [`Faces::bending`].
        deviations: f64,
    },
    /// The deviations of the contacts are much larger than they are said to be.
    #[error("the faces do not fit: χ² per degree of freedom is {per_degree:.2}")]
    Misfit {
        /// χ²/dof.
        per_degree: f64,
    },
    /// A corner lies so far from every contact that a side may have been missed there.
    #[error(
        "a corner lies {:.0} mm from the nearest contact: a side may have been missed there",
        1e3 * distance
    )]
    Untouched {
        /// From the corner to the nearest contact, metres.
        distance: f64,
    },
}

/// χ²/dof above which faces do not fit, and as many deviations above 1 where there are so few
/// contacts that this is more: about 1 on polytopes, about 2 on curves.
const MISFIT: f64 = 1.4;
const MISFIT_DEVIATIONS: f64 = 2.0;

/// Deviations of bending that flat faces do not show: once in a hundred.
const BENT: f64 = 2.3;

/// Most faces per contact. With fewer than 2.5 contacts a face, some sides have likely been missed, and
/// its neighbours then meet far outside the object.
const SHARE: f64 = 0.4;

/// Farthest that a corner may lie from every contact, in distances from the contacts' centre to the
/// farthest of them. The neighbours of a missed side of a hexagon meet at 1, of an octagon at 0.7; the
/// corners of rectangles and triangles with 2.5 contacts a side lie at 0.2 to 0.5.
const UNTOUCHED: f64 = 0.6;

/// A shape is closed when it reaches no further from the contacts' centre than this many times the
/// farthest contact.
const REACH: f64 = 2.0;

/// The polytope of the faces, whatever it fits like.
///
/// # Errors
/// When no contact has a normal, or the faces leave the object open.
pub fn polytope(dimension: usize, contacts: &[Contact]) -> Result<(Faces, Polytope), Refusal> {
    let faces = Faces::fit(dimension, contacts).ok_or(Refusal::NoNormals)?;
    let (centre, farthest) = farthest(contacts);
    let open = Refusal::Open { faces: faces.faces.len(), contacts: contacts.len() };
    let polytope = intersect(&faces, &centre, REACH * farthest).ok_or(open)?;
    Ok((faces, polytope))
}

/// The polytope, if it is to be trusted.
///
/// # Errors
/// Says which sign speaks against it.
pub fn judge(dimension: usize, contacts: &[Contact]) -> Result<(Faces, Polytope), Refusal> {
    let (faces, polytope) = polytope(dimension, contacts)?;
    let (count, felt) = (faces.faces.len(), faces.faces.iter().map(|f| f.contacts).sum());
    let doubt = doubt(contacts);
    if doubt > DOUBT {
        return Err(Refusal::Doubtful { degrees: doubt.to_degrees() });
    }
    if !faces.is_convex() {
        return Err(Refusal::Concave { deviations: faces.protrusion });
    }
    if count as f64 > SHARE * felt as f64 {
        return Err(Refusal::Few { faces: count, contacts: felt });
    }
    if faces.bending > BENT {
        return Err(Refusal::Curved { deviations: faces.bending });
    }
    let distance = untouched(&polytope, contacts);
    if distance > UNTOUCHED * farthest(contacts).1 {
        return Err(Refusal::Untouched { distance });
    }
    let per_degree = faces.chi_squared / faces.degrees.max(1.0);
    let scatter = (2.0 / faces.degrees.max(1.0)).sqrt();
    if per_degree > MISFIT.max(1.0 + MISFIT_DEVIATIONS * scatter) {
        return Err(Refusal::Misfit { per_degree });
    }
    Ok((faces, polytope))
}

/// Normals less certain than this (radians, median) fit any polytope: where the poses are in doubt,
/// χ² has nothing to say.
const DOUBT: f64 = 0.2;

/// Median standard deviation of the contacts' normals, radians; infinite without any.
fn doubt(contacts: &[Contact]) -> f64 {
    let felt = contacts.iter().filter(|c| c.normal.is_some());
    let mut deviations: Vec<f64> = felt.map(|c| c.normal_deviation).collect();
    deviations.sort_by(f64::total_cmp);
    deviations.get(deviations.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The contacts' centre, and the distance from there to the farthest, metres.
pub(super) fn farthest(contacts: &[Contact]) -> (Point, f64) {
    let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len().max(1) as f64;
    (centre, contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max))
}

/// The greatest distance from a corner to its nearest contact, metres.
fn untouched(polytope: &Polytope, contacts: &[Contact]) -> f64 {
    let corners: Vec<Point> = match &polytope.geometry {
        Geometry::Outline(o) => {
            o.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect()
        }
        Geometry::Mesh(m) => m.vertices().to_vec(),
    };
    let nearest = |corner: &Point| {
        contacts.iter().map(|c| (c.point - corner).norm()).fold(f64::INFINITY, f64::min)
    };
    corners.iter().map(nearest).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `each` contacts spread over every side of a polygon (counter-clockwise, millimetres), from a
    /// tenth to nine tenths of it, off by up to half a millimetre.
    fn along(corners: &[[f64; 2]], each: usize) -> Vec<Contact> {
        let corner = |i: usize| {
            let [x, y] = corners[i % corners.len()];
            Point::new(x, y, 0.0) * 1e-3
        };
        let mut contacts = Vec::new();
        for i in 0..corners.len() {
            let (a, side) = (corner(i), corner(i + 1) - corner(i));
            let normal = Point::new(side.y, -side.x, 0.0).normalize();
            for k in 0..each {
                let share = 0.1 + 0.8 * k as f64 / (each - 1) as f64;
                let off = 5e-4 * (7.0 * contacts.len() as f64).sin();
                contacts.push(Contact {
                    point: a + side * share + normal * off,
                    normal: Some(normal),
                    point_deviation: 1e-3,
                    normal_deviation: 0.0873,
                });
            }
        }
        contacts
    }

    const RECTANGLE: [[f64; 2]; 4] = [[-60.0, -30.0], [60.0, -30.0], [60.0, 30.0], [-60.0, 30.0]];

    #[test]
    fn a_touched_rectangle_is_faces() {
        let (faces, polytope) = judge(2, &along(&RECTANGLE, 4)).unwrap();
        assert_eq!(faces.faces.len(), 4);
        let Geometry::Outline(outline) = polytope.geometry else { panic!() };
        assert!((outline.area() - 0.0072).abs() < 1e-4);
    }

    #[test]
    fn what_may_be_something_else_is_refused() {
        let contacts = along(&RECTANGLE, 4);
        assert!(matches!(judge(2, &contacts[..12]), Err(Refusal::Open { faces: 3, contacts: 12 })));
        assert!(matches!(judge(2, &along(&RECTANGLE, 2)), Err(Refusal::Few { faces: 4, .. })));
        let bare: Vec<_> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
        assert_eq!(judge(2, &bare).unwrap_err(), Refusal::NoNormals);
        // A hexagon without one side: its neighbours meet far outside.
        let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
        let hexagon: Vec<[f64; 2]> = (0..6).map(|i| [45.0 * turn(i).1, 45.0 * turn(i).0]).collect();
        let missed = judge(2, &along(&hexagon, 4)[..20]);
        assert!(matches!(missed, Err(Refusal::Untouched { distance }) if distance > 0.04));
        let circle: Vec<[f64; 2]> = (0..36)
            .map(|i| (f64::from(i) * 10f64.to_radians()).sin_cos())
            .map(|(sin, cos)| [40.0 * cos, 40.0 * sin])
            .collect();
        assert!(matches!(judge(2, &along(&circle, 2)), Err(Refusal::Curved { .. })));
    }

    #[test]
    fn a_concavity_is_never_hidden() {
        let tee = [
            [-10.0, -50.0],
            [10.0, -50.0],
            [10.0, 10.0],
            [50.0, 10.0],
            [50.0, 30.0],
            [-50.0, 30.0],
            [-50.0, 10.0],
            [-10.0, 10.0],
        ];
        let ell = [[0.0, 0.0], [80.0, 0.0], [80.0, 30.0], [30.0, 30.0], [30.0, 90.0], [0.0, 90.0]];
        for corners in [&tee[..], &ell[..]] {
            let contacts = along(corners, 4);
            let faces = Faces::fit(2, &contacts).unwrap();
            assert!(!faces.is_convex() && faces.protrusion > 10.0);
            assert!(judge(2, &contacts).is_err());
        }
    }
}
