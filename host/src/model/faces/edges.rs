//! Contacts on edges and corners: on several faces at once, with any normal between theirs.
//!
//! Taken for flat, each would make a small face of its own. Such a contact measures as many numbers as
//! one on a face: at an edge, two distances and how far the normal leaves the plane of the two normals;
//! at a corner, three distances. So the costs compare as they are.

use nalgebra::{Matrix2, Matrix3, Vector2};

use super::{Face, Faces, GATE, Moments, Owner, solved};
use crate::reference::Contact;
use crate::space::Point;

/// What an edge costs more than a face, and a corner more than an edge: fingers touch them less often,
/// and without this every contact near an edge would be on it. −2 ln 0.1.
const RARER: f64 = 4.6;

/// Deviations from a plane beyond which a contact does not lie on it.
const NEAR: f64 = 4.0;

/// A contact without a normal lies on a face within this many deviations when on no other.
const BARE: f64 = 3.0;

/// More faces than this are curved, and pairs of them would take long.
const MOST_FACES: usize = 64;

/// χ² of what explains the contact, with the dimension as degrees of freedom (one without a normal).
pub(super) fn cost(faces: &[Face], contact: &Contact, owner: &Owner) -> f64 {
    let face = |i: &usize| &faces[*i];
    match (owner, &contact.normal) {
        (Owner::Face(i), None) => (face(i).value(&contact.point) / contact.point_deviation).powi(2),
        (Owner::Face(i), Some(normal)) => face(i).cost(contact, normal),
        (Owner::Edge([i, j]), _) => {
            let pair = [face(i), face(j)];
            let turned = contact.normal.map_or(0.0, |n| off_arc(&pair, &n));
            apart(&pair, contact) + turned / contact.normal_deviation.powi(2)
        }
        (Owner::Corner([i, j, k]), _) => {
            let three = [face(i), face(j), face(k)];
            let turned = contact.normal.map_or(0.0, |n| off_cone(&three, &n));
            apart_from_corner(&three, contact) + turned / contact.normal_deviation.powi(2)
        }
    }
}

/// χ² of the distance from where two planes meet.
fn apart(pair: &[&Face; 2], contact: &Contact) -> f64 {
    let cosine = pair[0].normal.dot(&pair[1].normal);
    let values = Vector2::from(pair.map(|f| f.value(&contact.point)));
    let own = Matrix2::from_diagonal(&Vector2::from(pair.map(|f| f.variance(&contact.point))));
    let noise = Matrix2::new(1.0, cosine, cosine, 1.0) * contact.point_deviation.powi(2);
    (own + noise).try_inverse().map_or(f64::INFINITY, |i| (values.transpose() * i * values)[0])
}

/// The same of three.
fn apart_from_corner(three: &[&Face; 3], contact: &Contact) -> f64 {
    let normals = Matrix3::from_columns(&three.map(|f| f.normal));
    let values = Point::from(three.map(|f| f.value(&contact.point)));
    let own = Matrix3::from_diagonal(&Point::from(three.map(|f| f.variance(&contact.point))));
    let noise = normals.transpose() * normals * contact.point_deviation.powi(2);
    (own + noise).try_inverse().map_or(f64::INFINITY, |i| (values.transpose() * i * values)[0])
}

/// Squared distance of a unit normal from the arc between those of two faces.
fn off_arc(pair: &[&Face; 2], normal: &Point) -> f64 {
    let [a, b] = pair.map(|f| f.normal);
    let nearer = (normal - a).norm_squared().min((normal - b).norm_squared());
    let Some(axis) = a.cross(&b).try_normalize(1e-3) else { return nearer };
    let flat = normal - axis * normal.dot(&axis);
    let between = a.cross(&flat).dot(&axis) >= 0.0 && flat.cross(&b).dot(&axis) >= 0.0;
    if between { normal.dot(&axis).powi(2) } else { nearer }
}

/// The same from the cone that the normals of three faces span.
fn off_cone(three: &[&Face; 3], normal: &Point) -> f64 {
    let normals = Matrix3::from_columns(&three.map(|f| f.normal));
    let shares = normals.try_inverse().map(|inverse| inverse * normal);
    if shares.is_some_and(|s| s.iter().all(|x| *x >= 0.0)) {
        return 0.0;
    }
    let [a, b, c] = *three;
    [[a, b], [b, c], [c, a]].iter().map(|pair| off_arc(pair, normal)).fold(f64::INFINITY, f64::min)
}

/// What explains a contact best without the face `barred`, and what that costs, rarity included.
fn best(faces: &[Face], contact: &Contact, barred: Option<usize>) -> (Owner, f64) {
    let allowed = (0..faces.len()).filter(|i| Some(*i) != barred);
    let near: Vec<usize> = allowed
        .clone()
        .filter(|i| {
            let variance = contact.point_deviation.powi(2) + faces[*i].variance(&contact.point);
            faces[*i].value(&contact.point).powi(2) < NEAR * NEAR * variance
        })
        .collect();
    let mut found = (Owner::Face(0), f64::INFINITY);
    let mut consider = |owner: Owner, extra: f64| {
        let cost = cost(faces, contact, &owner) + extra;
        if cost < found.1 {
            found = (owner, cost);
        }
    };
    for i in allowed {
        consider(Owner::Face(i), 0.0);
    }
    for (a, &i) in near.iter().enumerate() {
        for (b, &j) in near.iter().enumerate().skip(a + 1) {
            consider(Owner::Edge([i, j]), RARER);
            for &k in &near[b + 1..] {
                consider(Owner::Corner([i, j, k]), 2.0 * RARER);
            }
        }
    }
    found
}

impl Faces {
    /// The same without the faces whose contacts all lie on edges and corners of the others. Contacts
    /// without a normal then go to the face they lie on, where it is the only one, and refine it.
    pub fn simplified(&self, contacts: &[Contact]) -> Faces {
        if self.faces.len() > MOST_FACES || contacts.len() != self.owners.len() {
            return self.clone();
        }
        let mut current = self.reassigned(contacts, self.faces.clone());
        while let Some(fewer) = current.without_one(contacts) {
            current = fewer;
        }
        current
    }

    /// Without the face of fewest contacts that the others explain about as well.
    fn without_one(&self, contacts: &[Contact]) -> Option<Faces> {
        let gate = GATE[self.dimension.clamp(2, 3) - 2];
        let mut order: Vec<usize> = (0..self.faces.len()).collect();
        order.sort_by_key(|i| self.faces[*i].contacts);
        let barred = order.into_iter().find(|face| {
            let mut rise = 0.0;
            let mut members = 0.0_f64;
            for (contact, owner) in contacts.iter().zip(&self.owners) {
                let (Some(owner), Some(_)) = (owner, contact.normal) else { continue };
                if owner.faces().contains(face) {
                    let now = cost(&self.faces, contact, owner);
                    let (other, cost) = best(&self.faces, contact, Some(*face));
                    rise += cost - RARER * (other.faces().len() - 1) as f64 - now;
                    members += 1.0;
                }
            }
            // The difference of two χ², one of `dimension` more degrees of freedom.
            let noise = (4.0 * self.dimension as f64 * (members - 1.0).max(0.0)).sqrt();
            self.faces.len() > 1 && rise < gate + noise
        })?;
        let mut faces = self.faces.clone();
        faces.remove(barred);
        Some(self.reassigned(contacts, faces))
    }

    /// Contacts go to what explains them best among `faces`, which are then fitted anew.
    fn reassigned(&self, contacts: &[Contact], faces: Vec<Face>) -> Faces {
        let mut faces = faces;
        let checked: Vec<Option<Contact>> = contacts.iter().map(Contact::checked).collect();
        for _ in 0..2 {
            let mut groups: Vec<Option<Moments>> = vec![None; faces.len()];
            for contact in checked.iter().flatten() {
                let Some((face, own)) = alone(&faces, contact) else { continue };
                groups[face] = Some(groups[face].map_or(own, |sum| sum.plus(&own)));
            }
            let groups: Vec<Moments> = groups.into_iter().flatten().collect();
            let fitted = solved(&groups, self.dimension);
            if fitted.is_empty() {
                break;
            }
            faces = fitted;
        }
        let owner = |contact: &Option<Contact>| {
            let contact = contact.as_ref()?;
            match contact.normal {
                Some(_) => Some(best(&faces, contact, None).0),
                None => resting(&faces, contact).map(Owner::Face),
            }
        };
        let owners = checked.iter().map(owner).collect();
        Faces::explaining(self.dimension, contacts, faces, owners)
    }
}

/// The face that a contact lies on, away from edges and corners, with what it says about it.
fn alone(faces: &[Face], contact: &Contact) -> Option<(usize, Moments)> {
    match &contact.normal {
        Some(normal) => match best(faces, contact, None).0 {
            Owner::Face(face) => Some((face, Moments::of(contact, *normal))),
            _ => None,
        },
        None => Some((resting(faces, contact)?, Moments::bare(contact))),
    }
}

/// The only face that a contact without a normal can lie on.
fn resting(faces: &[Face], contact: &Contact) -> Option<usize> {
    let on = |i: &usize| {
        let variance = contact.point_deviation.powi(2) + faces[*i].variance(&contact.point);
        faces[*i].value(&contact.point).powi(2) < BARE * BARE * variance
    };
    let mut on = (0..faces.len()).filter(on);
    let only = on.next();
    if on.next().is_some() { None } else { only }
}
