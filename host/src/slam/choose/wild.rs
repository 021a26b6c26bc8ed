//! Contacts that lie on no side, though sides were touched often: of something else, or of a sensor that failed.

use super::{Refusal, judge, judged, lost, only, polytope};
use crate::model::faces::{Faces, Owner};
use crate::reference::Contact;
use crate::space::Point;

/// Most contacts that may be wild, as a share: more of them are on sides that the faces do not have.
const WILD: f64 = 0.2;

/// Rounds of leaving out contacts that lie where the others' faces are no surface.
const SIFTED: usize = 3;

/// Contacts of each side from which on hardly any side is touched only once: with as many on average, one
/// in 400.
const OFTEN: f64 = 8.0;

/// Wild contacts that make a side between them at most: that more agree hardly happens.
const PAIR: usize = 2;

/// Deviations by which a normal may be off the direction that it is felt to have, and radians where it is said to be
/// more exact than edges are sharp.
const ASIDE: f64 = 2.5;
const LEAST: f64 = 0.02;

/// Sine of the angle from which on two sides say what is square to both.
const SLANTED: f64 = 0.5;

/// Which contacts to make a shape of where a graph knows the `faces`, each contact's owner among them: all, or
/// without those that lie on none, or where they are no surface. A few of these are wild, of something else or
/// of a sensor that failed, where the others make an object without them and either sides are touched so
/// often that they are no sides touched once, or all contacts together make no object. Of sides touched often those
/// go, too, that two wild contacts made between them: where such a side is no surface.
///
/// One that lies on none but faces as a box would have a side there, parallel or square to others, is wild only where
/// the object is none with it: small ends are felt once among many contacts, and seldom does a wild one face just so.
/// Where sides were touched often and do not close, what lies on none is wild none the less.
pub fn trusted(faces: &Faces, contacts: &[Contact], free: &[Point]) -> Vec<bool> {
    let each = || contacts.iter().zip(&faces.owners);
    let owned: Vec<bool> = each().map(|(c, o)| c.normal.is_none() || o.is_some()).collect();
    let directions = directions(faces);
    let is_square: Vec<bool> = contacts.iter().map(|c| faces_along(c, &directions)).collect();
    let square: Vec<bool> = owned.iter().zip(&is_square).map(|(a, b)| *a || *b).collect();
    let sift = Sift { faces, contacts, free };
    if let Some(found) = sift.believed(square.clone()) {
        return found;
    }
    if square != owned
        && let Some(found) = sift.believed(owned)
    {
        return found;
    }
    let is_many = |owner: &Owner| owner.faces().iter().all(|f| faces.faces[*f].contacts > PAIR);
    let on_many = each().map(|(c, o)| c.normal.is_none() || o.as_ref().is_some_and(is_many));
    let many: Vec<bool> = on_many.zip(is_square).map(|(many, square)| many || square).collect();
    let open = [square, many].into_iter().find(|trusted| sift.is_open(trusted));
    open.unwrap_or(vec![true; contacts.len()])
}

/// Whether so many sides are touched so often that hardly any is touched only once.
pub(in crate::slam) fn often(contacts: &[Contact], sides: usize) -> bool {
    contacts.len() as f64 >= OFTEN * sides as f64
}

/// Those along the normals of sides that were felt more than by chance, and square to two of them.
pub(in crate::slam) fn directions(faces: &Faces) -> Vec<Point> {
    let felt = faces.faces.iter().filter(|face| face.contacts > PAIR);
    let normals: Vec<Point> = felt.map(|face| face.normal).collect();
    let others = if faces.dimension == 2 { vec![Point::z()] } else { normals.clone() };
    let square = normals.iter().flat_map(|a| others.iter().map(|b| a.cross(b)));
    let square: Vec<Point> = square.filter_map(|c| c.try_normalize(SLANTED)).collect();
    [normals, square].concat()
}

/// Whether the contact faces along one of these, to either side.
pub(in crate::slam) fn faces_along(contact: &Contact, directions: &[Point]) -> bool {
    let Some(normal) = contact.normal else { return false };
    let aside = ASIDE * contact.normal_deviation.max(LEAST);
    directions.iter().any(|direction| direction.cross(&normal).norm() < aside)
}

/// What there is to choose from.
struct Sift<'a> {
    faces: &'a Faces,
    contacts: &'a [Contact],
    free: &'a [Point],
}

impl Sift<'_> {
    /// The contacts that make an object without the wild ones: these, or without those, too, that lie where the
    /// others' faces are no surface. `None` where they make none.
    fn believed(&self, mut trusted: Vec<bool>) -> Option<Vec<bool>> {
        let Sift { faces, contacts, free } = *self;
        let mut believed = None;
        for _ in 0..SIFTED {
            if self.are_many_wild(&trusted) {
                break;
            }
            let others = only(contacts, &trusted);
            let is_often = often(&others, faces.faces.len());
            let ((found, polytope), others) = match judged(faces.dimension, &others, free) {
                Ok(_) if !is_often && believed.is_none() => {
                    let is_none = judge(faces.dimension, contacts, free).is_err();
                    return Some(if is_none { trusted } else { vec![true; contacts.len()] });
                }
                Ok(_) if !is_often => break,
                Ok(object) => {
                    believed = Some(trusted.clone());
                    object
                }
                Err(Refusal::Unexplained { .. } | Refusal::Untouched { .. })
                    if believed.is_none() =>
                {
                    let Ok(object) = polytope(faces.dimension, &others, free) else { break };
                    (object, others)
                }
                Err(_) => break,
            };
            let lost = lost(&found, &polytope, &others);
            if is_side_lost(&found, &lost) {
                break;
            }
            let mut lost = lost.into_iter();
            for trusted in trusted.iter_mut().filter(|trusted| **trusted) {
                *trusted = !lost.next().unwrap_or_default();
            }
            if believed.as_ref() == Some(&trusted) {
                break;
            }
        }
        believed
    }

    /// Whether these lie on sides that were touched often and do not close.
    fn is_open(&self, trusted: &[bool]) -> bool {
        let others = only(self.contacts, trusted);
        !self.are_many_wild(trusted)
            && often(&others, self.faces.faces.len())
            && matches!(
                judge(self.faces.dimension, &others, self.free),
                Err(Refusal::Open { .. } | Refusal::Untouched { .. } | Refusal::Unexplained { .. })
            )
    }

    fn are_many_wild(&self, trusted: &[bool]) -> bool {
        let wild = trusted.iter().filter(|trusted| !**trusted).count();
        wild as f64 > WILD * self.contacts.len() as f64
    }
}

/// Whether most contacts of a side are lost, and more than agree by chance: it is one, and the shape is wrong.
fn is_side_lost(faces: &Faces, lost: &[bool]) -> bool {
    (0..faces.faces.len()).any(|face| {
        let own = faces.owners.iter().zip(lost).filter(|(o, _)| **o == Some(Owner::Face(face)));
        let (all, gone) =
            own.fold((0, 0), |(all, gone), (_, lost)| (all + 1, gone + usize::from(*lost)));
        gone > PAIR && 2 * gone > all
    })
}
