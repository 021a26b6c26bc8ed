//! The sides of a body that has flat ones only.

use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen};

use super::{Body, Mode, Part, Plane};
use crate::model::faces::{Face, Faces, Owner};
use crate::reference::Contact;
use crate::space::{Point, centroid};

/// How often the parameters are corrected.
const STEPS: usize = 4;

/// Eigenvalue over the greatest below which a side does not turn that way.
const STIFF: f64 = 1e-9;

impl Body {
    /// Its sides as the faces of these contacts (metres, in their frame): together where the contacts and their
    /// deviations make the body's parameters most probable, and as uncertain as that leaves these (Gauss–Newton
    /// and Laplace's approximation, about what was believed of the body). A side nobody felt is a face of no
    /// contacts. `None` where a part is not flat, and where a contact's numbers are not usable.
    pub fn sides(&self, dimension: usize, contacts: &[Contact]) -> Option<Faces> {
        let contacts: Vec<Contact> =
            contacts.iter().map(Contact::checked).collect::<Option<_>>()?;
        let about = centroid(contacts.iter().map(|c| c.point));
        let mut body = self.clone();
        for _ in 0..STEPS {
            let (by, _) = body.corrected(&contacts)?;
            body = body.moved(by.as_slice(), &about)?;
        }
        let (_, covariance) = body.corrected(&contacts)?;
        let owners: Vec<usize> = contacts.iter().map(|c| body.touched(c).0).collect();
        let face = |side: usize| {
            let own = owners.iter().filter(|owner| **owner == side).count();
            Some(Face { contacts: own, ..body.face(side, &covariance)? })
        };
        let faces = (0..body.parts.len()).map(face).collect::<Option<_>>()?;
        let owners = owners.into_iter().map(|owner| Some(Owner::Face(owner))).collect();
        Some(Faces::explaining(dimension, &contacts, faces, owners))
    }

    /// By how many deviations of each mode the parts are best moved, all in all, and their covariance.
    fn corrected(&self, contacts: &[Contact]) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let count = self.modes.len();
        let moved = DVector::from_iterator(count, self.modes.iter().map(|mode| mode.moved));
        let (mut information, mut right) = (DMatrix::identity(count, count), -&moved);
        for contact in contacts {
            let (part, (value, slope)) = self.touched(contact);
            let modes: Vec<_> = self.modes_of(part, &contact.point).collect();
            let mut add = |row: DVector<f64>, off: f64, deviation: f64| {
                let row = row / deviation;
                information.ger(1.0, &row, &row, 1.0);
                right.axpy(-off / deviation, &row, 1.0);
            };
            let values = modes.iter().map(|mode| mode.0);
            add(DVector::from_iterator(count, values), value, contact.point_deviation);
            let Some(normal) = contact.normal else { continue };
            for axis in 0..3 {
                let slopes = modes.iter().map(|mode| mode.1[axis]);
                let row = DVector::from_iterator(count, slopes);
                add(row, slope[axis] - normal[axis], contact.normal_deviation);
            }
        }
        let factor = information.cholesky()?;
        Some((moved + factor.solve(&right), factor.inverse()))
    }

    /// A side, with this covariance of the modes, and no contacts yet.
    fn face(&self, side: usize, covariance: &DMatrix<f64>) -> Option<Face> {
        let Part::Plane(Plane { normal, offset }) = *self.parts.get(side)? else { return None };
        let ways = self.modes.iter().map(|mode| mode.way(side)).collect::<Option<Vec<_>>>()?;
        let (mut turning, mut both, mut moving) = (Matrix3::zeros(), Point::zeros(), 0.0);
        for (i, (turn, out)) in ways.iter().enumerate() {
            for (j, (other_turn, other_out)) in ways.iter().enumerate() {
                turning += turn * other_turn.transpose() * covariance[(i, j)];
                both += turn * (other_out * covariance[(i, j)]);
                moving += out * other_out * covariance[(i, j)];
            }
        }
        // There, turn and offset are uncorrelated.
        let eigen = SymmetricEigen::new(turning);
        let stiff = STIFF * eigen.eigenvalues.max();
        let axes = eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter());
        let turned = axes.filter(|(value, _)| **value > stiff);
        let across: Point = turned.map(|(value, axis)| axis * (axis.dot(&both) / *value)).sum();
        Some(Face {
            normal,
            offset,
            centroid: normal * offset + across,
            offset_variance: (moving - across.dot(&both)).max(0.0),
            normal_covariance: turning,
            contacts: 0,
        })
    }
}

impl Mode {
    /// By how much one deviation turns a flat side, and how far out it moves it; `None` where it is round.
    fn way(&self, side: usize) -> Option<(Point, f64)> {
        let Some(change) = self.of_part(side) else { return Some((Point::zeros(), 0.0)) };
        let (Part::Plane(more), Part::Plane(less)) = (change.more, change.less) else {
            return None;
        };
        Some(((more.normal - less.normal) * self.scale, (more.offset - less.offset) * self.scale))
    }
}

#[cfg(test)]
mod tests;
