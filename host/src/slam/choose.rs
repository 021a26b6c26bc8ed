//! Which surface model suits the contacts: fitted faces where every sign says that the object has flat
//! ones, the Gaussian process otherwise.

use crate::reference::body::Body;
use crate::reference::faces::{Face, Faces, Owner};
use crate::reference::{Contact, Kernel};
use crate::shape::Geometry;
use crate::shape::polytope::{Polytope, assemble, closures};
use crate::space::Point;

/// What the user wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Choice {
    /// Faces where they are trustworthy, see [`judge`], equal ones where such a body is more probable;
    /// the Gaussian process where a round one is ([`simpler`](super::fit::simpler)), and everywhere else.
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
    /// Flat faces, in the frame of the contacts they were fitted to; answers how uncertain the
    /// surface is anywhere on them ([`crate::shape::Field`]).
    Faces(Box<Polytope>),
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
    /// Contacts have each its own face, as on a curve or where a finger lay on a rounded edge.
    #[error(
        "{lone} of {contacts} contacts make faces of their own that no other confirms: the surface is \
         curved, or a finger lay on an edge"
    )]
    Lone {
        /// Faces of one contact that are neither parallel nor square to others.
        lone: usize,
        /// With normals.
        contacts: usize,
    },
    /// No union of cells between the faces has the surface that the contacts show.
    #[error("{unexplained} of {contacts} contacts do not lie on the surface that the faces make")]
    Unexplained {
        /// Contacts whose own face is no part of the surface where they lie.
        unexplained: usize,
        /// With normals.
        contacts: usize,
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

/// Most faces per contact: fewer contacts a face fit anything. More of a hollow object, of which the
/// process knows next to nothing: there doubtful faces say more.
const SHARE: f64 = 0.45;
const SHARE_HOLLOW: f64 = 0.55;

/// Farthest that a corner may lie from every contact, in distances from the contacts' centre to the
/// farthest of them. The neighbours of a missed side of a hexagon meet at 1, of an octagon at 0.7; the
/// corners of rectangles and triangles with 2.5 contacts a side lie at 0.2 to 0.5. Where every face has
/// its counterpart no side was missed. On a hollow object it does not matter, for the same reason.
const UNTOUCHED: f64 = 0.6;

/// Most faces of one contact that nothing else confirms, as a share of the contacts. It estimates how
/// likely the next contact is to make a new face (Good, Biometrika 40, 1953): low where all faces were
/// found, high on curves, where every contact makes its own.
const LONE: f64 = 0.05;

/// Whether so many unconfirmed faces make the others doubtful, too: one less than [`LONE`] allows on a
/// convex object, but never the first on a hollow one.
///
/// A finger on a rounded edge makes a face that stands for the side behind it, and corners far away:
/// the process loses less than that, unless the object is hollow.
fn too_many(lone: usize, faces: &Faces, felt: usize) -> bool {
    let most = (LONE * felt as f64).floor() as usize;
    let most = if faces.is_convex() { most.saturating_sub(1) } else { most.max(1) };
    lone > most
}

/// Closing planes that are tried one at a time.
const MOST_CLOSINGS: usize = 8;

/// Most contacts that the shape may leave unexplained, as a share.
const UNEXPLAINED: f64 = 0.06;

/// Most contacts that may be wild, as a share: more of them are on sides that the faces do not have.
const WILD: f64 = 0.2;

/// Rounds of leaving out contacts that lie where the others' faces are no surface.
const SIFTED: usize = 3;

/// Contacts of each side from which on hardly any side is touched only once: with as many on average, one
/// in 400.
const OFTEN: f64 = 8.0;

/// Deviations from its own face, where that is part of the surface, at which a contact is unexplained.
const FAR: f64 = 4.0;

/// Normals less certain than this (radians, median) fit any polytope: where the poses are in doubt,
/// χ² has nothing to say.
pub(super) const DOUBT: f64 = 0.2;

/// Faces that the contacts show, and the shape they make, whatever it fits like. Sides that nobody
/// touched are closed at the outermost contacts where the faces leave them open or meet far away.
/// `free` are points known to be outside; all in the object frame.
///
/// # Errors
/// When no contact has a normal, or the faces enclose nothing.
pub fn polytope(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    let faces = fitted(dimension, contacts)?;
    let polytope = close(&faces, contacts, free)?;
    Ok((faces, polytope))
}

/// The shape of faces that are known, from contacts that they explain; `None` where they leave contacts
/// unexplained, or where contacts at edges are among those of a face, which only another fit tells.
pub fn known(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Option<Polytope> {
    if faces.simplified(contacts).faces.len() != faces.faces.len() {
        return None;
    }
    let polytope = close(faces, contacts, free).ok()?;
    let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
    let lost = unexplained(faces, &polytope, contacts);
    (lost as f64 <= UNEXPLAINED * felt as f64).then_some(polytope)
}

/// Which contacts to make a shape of where a graph knows the `faces`, each contact's owner among them: all, or
/// without those that lie on none, or where they are no surface. A few of these are wild, of something else or
/// of a sensor that failed, where the others make an object without them and either sides are touched so
/// often that they are no sides touched once, or all contacts together make no object.
pub fn trusted(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Vec<bool> {
    let all = vec![true; contacts.len()];
    let known = contacts.iter().zip(&faces.owners);
    let mut trusted: Vec<bool> = known.map(|(c, o)| c.normal.is_none() || o.is_some()).collect();
    let often = |others: &[Contact]| others.len() as f64 >= OFTEN * faces.faces.len() as f64;
    for _ in 0..SIFTED {
        let wild = trusted.iter().filter(|trusted| !**trusted).count();
        if wild as f64 > WILD * contacts.len() as f64 {
            break;
        }
        let others = only(contacts, &trusted);
        match judge(faces.dimension, &others, free) {
            Ok(_) if often(&others) || judge(faces.dimension, contacts, free).is_err() => {
                return trusted;
            }
            Err(Refusal::Unexplained { .. }) => {
                let Ok((found, polytope)) = polytope(faces.dimension, &others, free) else { break };
                let mut lost = lost(&found, &polytope, &others).into_iter();
                for trusted in trusted.iter_mut().filter(|trusted| **trusted) {
                    *trusted = !lost.next().unwrap_or_default();
                }
            }
            _ => break,
        }
    }
    all
}

/// Those that are marked.
pub fn only<T: Clone>(all: &[T], marked: &[bool]) -> Vec<T> {
    all.iter().zip(marked).filter(|(_, marked)| **marked).map(|(one, _)| one.clone()).collect()
}

/// Faces that the contacts show, without those that others explain, in order where they plausibly are.
pub(super) fn fitted(dimension: usize, contacts: &[Contact]) -> Result<Faces, Refusal> {
    let faces = Faces::fit(dimension, contacts).ok_or(Refusal::NoNormals)?;
    Ok(faces.simplified(contacts).regular(contacts))
}

/// The shape that known faces and the contacts that they were fitted to make. Sides that nobody touched
/// are closed at the outermost contacts; `free` are points known to be outside.
///
/// # Errors
/// When they enclose nothing.
pub fn close(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Result<Polytope, Refusal> {
    let limit = UNTOUCHED * farthest(contacts);
    let closings = closures(faces, contacts);
    let near = |p: &Polytope| closings.is_empty() || untouched(p, contacts) <= limit;
    let closed = |closing: &[Face]| assemble(faces, contacts, free, closing);
    let polytope = match closed(&[]) {
        Some(polytope) if near(&polytope) => Some(polytope),
        // One plane where that suffices, else all.
        wide => closings
            .chunks(1)
            .take(MOST_CLOSINGS)
            .filter_map(|one| closed(one).filter(|p| near(p)))
            .min_by(|a, b| untouched(a, contacts).total_cmp(&untouched(b, contacts)))
            .or_else(|| closed(&closings))
            .or(wide),
    };
    polytope.ok_or(Refusal::Open {
        faces: faces.faces.len(),
        contacts: contacts.iter().filter(|c| c.normal.is_some()).count(),
    })
}

/// The polytope, if it is to be trusted. Contacts that are said to be very exact, and are not quite
/// where faces and sharp edges would have them, get a second chance with three times the deviations.
///
/// # Errors
/// Says which sign speaks against it.
pub fn judge(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    let first = examine(dimension, contacts, free);
    if first.is_ok() || !are_exact(contacts) {
        return first;
    }
    let slack = |c: &Contact| Contact {
        point_deviation: c.point_deviation * SLACK,
        normal_deviation: c.normal_deviation * SLACK,
        ..*c
    };
    let contacts: Vec<Contact> = contacts.iter().map(slack).collect();
    examine(dimension, &contacts, free).or(first)
}

fn examine(
    dimension: usize,
    contacts: &[Contact],
    free: &[Point],
) -> Result<(Faces, Polytope), Refusal> {
    let doubt = doubt(contacts);
    if doubt.is_finite() && doubt > DOUBT {
        return Err(Refusal::Doubtful { degrees: doubt.to_degrees() });
    }
    let felt = contacts.iter().filter(|c| c.normal.is_some()).count();
    // The faces first: their figures are cheap.
    let faces = fitted(dimension, contacts)?;
    let lone = faces.unconfirmed(contacts).len();
    if too_many(lone, &faces, felt) {
        return Err(Refusal::Lone { lone, contacts: felt });
    }
    if faces.bending > BENT {
        return Err(Refusal::Curved { deviations: faces.bending });
    }
    let per_degree = faces.chi_squared / faces.degrees.max(1.0);
    let scatter = (2.0 / faces.degrees.max(1.0)).sqrt();
    if per_degree > MISFIT.max(1.0 + MISFIT_DEVIATIONS * scatter) {
        return Err(Refusal::Misfit { per_degree });
    }
    let polytope = close(&faces, contacts, free)?;
    let is_hollow = !faces.is_convex() && Body::hollow(dimension, contacts, &faces).is_some();
    let count = polytope.touched_planes();
    let share = if is_hollow { SHARE_HOLLOW } else { SHARE };
    if count as f64 > share * felt as f64 {
        return Err(Refusal::Few { faces: count, contacts: felt });
    }
    let unexplained = unexplained(&faces, &polytope, contacts);
    if unexplained as f64 > UNEXPLAINED * felt as f64 {
        return Err(Refusal::Unexplained { unexplained, contacts: felt });
    }
    let distance = untouched(&polytope, contacts);
    let paired = closures(&faces, contacts).is_empty();
    if !is_hollow && distance > UNTOUCHED * farthest(contacts) && !paired {
        return Err(Refusal::Untouched { distance });
    }
    Ok((faces, polytope))
}

/// What the deviations of very exact contacts are multiplied with: real edges are a little round and
/// real skin gives a little.
const SLACK: f64 = 3.0;

/// Median deviation of normals that contacts with slack may have: as uncertain as usual ones, 5°.
const USUAL_DOUBT: f64 = 0.0873;

/// Whether contacts are so exact that nothing real suits them to their deviations.
fn are_exact(contacts: &[Contact]) -> bool {
    doubt(contacts) * SLACK <= USUAL_DOUBT
}

/// Whether faces with so much χ² per degree of freedom fit contacts.
pub fn fit(per_degree: f64, contacts: &[Contact]) -> bool {
    let slack = if are_exact(contacts) { SLACK } else { 1.0 };
    per_degree <= MISFIT * slack * slack
}

/// Median standard deviation of the contacts' normals, radians; infinite without any.
pub(super) fn doubt(contacts: &[Contact]) -> f64 {
    let felt = contacts.iter().filter(|c| c.normal.is_some());
    let mut deviations: Vec<f64> = felt.map(|c| c.normal_deviation).collect();
    deviations.sort_by(f64::total_cmp);
    deviations.get(deviations.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The distance from the contacts' centre to the farthest, metres.
fn farthest(contacts: &[Contact]) -> f64 {
    let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len().max(1) as f64;
    contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max)
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

/// How many contacts lie off every face they belong to, as far as that is surface.
fn unexplained(faces: &Faces, polytope: &Polytope, contacts: &[Contact]) -> usize {
    lost(faces, polytope, contacts).into_iter().filter(|lost| *lost).count()
}

/// Which contacts do.
fn lost(faces: &Faces, polytope: &Polytope, contacts: &[Contact]) -> Vec<bool> {
    let lost = |(contact, owner): (&Contact, &Option<Owner>)| {
        let Some(owner) = owner else { return contact.normal.is_some() };
        owner.faces().iter().any(|face| {
            let variance =
                contact.point_deviation.powi(2) + polytope.planes[*face].variance(&contact.point);
            polytope
                .nearest(&contact.point, Some(*face))
                .is_none_or(|(.., distance)| distance > FAR * variance.sqrt())
        })
    };
    contacts.iter().zip(&faces.owners).map(lost).collect()
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
        let (faces, polytope) = judge(2, &along(&RECTANGLE, 4), &[]).unwrap();
        assert_eq!(faces.faces.len(), 4);
        let Geometry::Outline(outline) = polytope.geometry else { panic!() };
        assert!((outline.area() - 0.0072).abs() < 1e-4);
    }

    #[test]
    fn two_contacts_a_face_are_enough_of_a_hollow_object() {
        let l = [[0.0, 0.0], [90.0, 0.0], [90.0, 35.0], [35.0, 35.0], [35.0, 90.0], [0.0, 90.0]];
        let (_, polytope) = judge(2, &along(&l, 2), &[]).unwrap();
        let Geometry::Outline(outline) = polytope.geometry else { panic!() };
        assert!((outline.area() - 0.005_075).abs() < 2e-4, "{}", outline.area());
        let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
        let hexagon: Vec<[f64; 2]> = (0..6).map(|i| [45.0 * turn(i).1, 45.0 * turn(i).0]).collect();
        assert!(matches!(judge(2, &along(&hexagon, 2), &[]), Err(Refusal::Few { .. })));
    }

    #[test]
    fn what_may_be_something_else_is_refused() {
        let contacts = along(&RECTANGLE, 4);
        assert!(matches!(judge(2, &contacts[..4], &[]), Err(Refusal::Open { .. })));
        let bare: Vec<_> = contacts.iter().map(|c| Contact { normal: None, ..*c }).collect();
        assert_eq!(judge(2, &bare, &[]).unwrap_err(), Refusal::NoNormals);
        let vague: Vec<_> =
            contacts.iter().map(|c| Contact { normal_deviation: 0.3, ..*c }).collect();
        assert!(matches!(judge(2, &vague, &[]), Err(Refusal::Doubtful { .. })));
        let circle: Vec<[f64; 2]> = (0..36)
            .map(|i| (f64::from(i) * 10f64.to_radians()).sin_cos())
            .map(|(sin, cos)| [40.0 * cos, 40.0 * sin])
            .collect();
        assert!(judge(2, &along(&circle, 2), &[]).is_err());
    }

    /// The faces of all but the last `unknown` contacts, on which those do not lie.
    fn all_but(unknown: usize, contacts: &[Contact]) -> Faces {
        let known = &contacts[..contacts.len() - unknown];
        let faces = fitted(2, known).unwrap();
        let owners = faces.owners.iter().copied().chain(std::iter::repeat_n(None, unknown));
        Faces { owners: owners.collect(), ..faces }
    }

    #[test]
    fn contacts_on_no_side_are_left_out_where_sides_are_touched_often() {
        let wild = [(-0.01, 0.005, 0.3), (0.02, -0.012, 2.0), (0.03, 0.05, 4.0), (0.08, 0.0, 2.5)];
        let wild = wild.map(|(x, y, angle): (f64, f64, f64)| Contact {
            point: Point::new(x, y, 0.0),
            normal: Some(Point::new(angle.cos(), angle.sin(), 0.0)),
            ..along(&RECTANGLE, 1)[0]
        });
        for (each, left_out) in [(9, true), (3, false)] {
            let contacts = [along(&RECTANGLE, each), wild.to_vec()].concat();
            let faces = all_but(4, &contacts);
            let trusted = trusted(&faces, &contacts, &[]);
            // More than a fifth wild is another object.
            assert_eq!(trusted.iter().filter(|t| !**t).count(), if left_out { 4 } else { 0 });
            if left_out {
                let kept = only(&contacts, &trusted);
                assert_eq!(judge(2, &kept, &[]).unwrap().0.faces.len(), 4);
                let owners = only(&faces.owners, &trusted);
                let faces = Faces { owners, ..faces };
                let Geometry::Outline(outline) = known(&faces, &kept, &[]).unwrap().geometry else {
                    panic!()
                };
                assert!((outline.area() - 0.0072).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_side_touched_once_is_none_to_leave_out() {
        // The last side by one contact, the others by four each.
        let mut contacts = along(&RECTANGLE, 4);
        contacts.truncate(13);
        let trusted = trusted(&all_but(1, &contacts), &contacts, &[]);
        assert_eq!(trusted, [true; 13]);
    }

    #[test]
    fn an_untouched_side_is_closed_at_the_contacts() {
        // A hexagon without one side: its neighbours would meet far outside.
        let turn = |i: usize| (i as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
        let hexagon: Vec<[f64; 2]> = (0..6).map(|i| [45.0 * turn(i).1, 45.0 * turn(i).0]).collect();
        for corners in [&hexagon[..], &RECTANGLE] {
            let contacts = along(corners, 4);
            let (_, polytope) = judge(2, &contacts[..4 * (corners.len() - 1)], &[]).unwrap();
            let bounds =
                |points: &[[f64; 2]]| points.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
            let Geometry::Outline(outline) = &polytope.geometry else { panic!() };
            assert!(bounds(&outline.loops[0]) < 1.05e-3 * bounds(corners));
            assert!(polytope.deviations.iter().any(|d| *d > 3e-3));
        }
    }

    #[test]
    fn a_face_of_one_contact_does_not_stand_for_a_side() {
        // Three sides of a rectangle, and a finger on the edge between one of them and the fourth.
        let mut contacts = along(&RECTANGLE, 4);
        contacts.truncate(12);
        assert!(judge(2, &contacts, &[]).is_ok());
        let point = Point::new(-0.06, -0.03, 0.0);
        let normal = Some(Point::new(-1.0, -1.0, 0.0).normalize());
        contacts.push(Contact { point, normal, ..contacts[0] });
        let refusal = judge(2, &contacts, &[]).unwrap_err();
        assert!(matches!(refusal, Refusal::Lone { lone: 1, contacts: 13 }), "{refusal}");
    }

    #[test]
    fn exact_contacts_on_a_not_quite_exact_object_get_slack() {
        // Said to be exact to 0.1 mm, and off by 0.35 mm either way.
        let exact = |(i, c): (usize, Contact)| {
            let off = if i % 2 == 0 { 3.5e-4 } else { -3.5e-4 };
            let point = c.point + c.normal.unwrap_or_default() * off;
            Contact { point, point_deviation: 1e-4, normal_deviation: 0.0175, ..c }
        };
        let contacts: Vec<Contact> =
            along(&RECTANGLE, 4).into_iter().enumerate().map(exact).collect();
        assert!(examine(2, &contacts, &[]).is_err());
        let (faces, polytope) = judge(2, &contacts, &[]).unwrap();
        assert_eq!(faces.faces.len(), 4);
        assert!(polytope.deviations.iter().all(|d| *d > 1e-4));
    }

    #[test]
    fn where_every_contact_makes_its_own_face_is_curved() {
        let circle: Vec<[f64; 2]> = (0..12)
            .map(|i| (f64::from(i) * 30f64.to_radians() + 0.2).sin_cos())
            .map(|(sin, cos)| [60.0 * cos, 40.0 * sin])
            .collect();
        let contacts: Vec<Contact> = along(&circle, 2).into_iter().step_by(2).collect();
        let refusal = judge(2, &contacts, &[]).unwrap_err();
        assert!(matches!(refusal, Refusal::Lone { lone, contacts: 12 } if lone > 1), "{refusal}");
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
        for (corners, area) in [(&tee[..], 3200e-6), (&ell[..], 4200e-6)] {
            let contacts = along(corners, 4);
            let (faces, polytope) = judge(2, &contacts, &[]).unwrap();
            assert!(!faces.is_convex());
            let Geometry::Outline(outline) = polytope.geometry else { panic!() };
            assert!((outline.area() / area - 1.0).abs() < 0.06, "{}", outline.area());
            for c in &contacts {
                assert!(outline.distance(&c.point) < 3e-3);
            }
        }
    }

    #[test]
    fn very_exact_contacts_need_not_fit_as_exactly() {
        let usual = along(&RECTANGLE, 5);
        let exact = |c: &Contact| Contact { normal_deviation: 0.01, ..*c };
        let exact: Vec<Contact> = usual.iter().map(exact).collect();
        assert!(fit(1.3, &usual) && !fit(1.5, &usual) && !fit(f64::NAN, &usual));
        assert!(fit(1.5, &exact) && !fit(13.0, &exact));
        // Nobody knows how exact none are.
        assert!(!fit(1.5, &[]));
    }
}
