//! How large a body's surface is: contacts that fall anywhere on it are each the less likely the larger it is.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, SymmetricEigen};

use super::Body;
use super::close::spread;
use crate::reference::Contact;
use crate::space::{Point, centroid, scatter};

/// Directions that the surface is looked at in, in the plane and in space. They find it to a fiftieth, of rods and plates
/// twenty times as long as thick, too.
const DIRECTIONS: [usize; 2] = [360, 1_000];

/// Least extent of the contacts that directions are spread as, in the greatest one.
const FLAT: f64 = 0.02;

/// Farthest place that is looked at, in the contacts' reach, as a power of two; and halvings until a place is known.
const FARTHEST: i32 = 4;
const HALVINGS: usize = 24;

/// Least cosine between a direction and the normal where it leaves.
const GRAZING: f64 = 0.02;

impl Body {
    /// The length of its outline in the plane, in metres, or the area of its surface in space, in m², as seen from the
    /// contacts' middle. `None` where that does not lie inside, where the body goes on 16 times as far as contacts do
    /// from there, and where numbers are none.
    pub(crate) fn size(&self, dimension: usize, contacts: &[Contact]) -> Option<f64> {
        let centre = centroid(contacts.iter().map(|c| c.point));
        let reach = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        // A greatest reach knows nothing of what is no number, their sum does.
        let is_usable = reach > 0.0 && reach.is_finite() && centre.norm().is_finite();
        if !(is_usable && self.active(&centre).1.0 < 0.0) {
            return None;
        }
        // Of a rod most directions spread evenly would leave through the sides near the middle.
        let stretch = extents(dimension, &centre, contacts);
        let directions = spread(dimension, DIRECTIONS[usize::from(dimension == 3)]);
        let each = if dimension == 2 { TAU } else { 2.0 * TAU } / directions.len() as f64;
        let shrunk = stretch.determinant();
        let mut size = 0.0;
        for direction in &directions {
            let ray = stretch * direction;
            let along = ray.norm();
            let ray = ray / along;
            let (length, normal) = self.leaves(&centre, &ray, reach)?;
            let grazing = normal.dot(&ray).max(GRAZING);
            let angle = each * shrunk / along.powi(dimension as i32);
            size += length.powi(dimension as i32 - 1) / grazing * angle;
        }
        (size > 0.0 && size.is_finite()).then_some(size)
    }

    /// How far from a centre inside a direction leaves the body, and its normal there.
    fn leaves(&self, centre: &Point, ray: &Point, reach: f64) -> Option<(f64, Point)> {
        let value = |length: f64| self.active(&(centre + ray * length)).1.0;
        let beyond = (0..=FARTHEST).map(|power| reach * f64::from(power).exp2());
        let mut high = beyond.into_iter().find(|length| value(*length) > 0.0)?;
        let mut low = 0.0;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if value(middle) > 0.0 { high = middle } else { low = middle }
        }
        let normal = self.active(&(centre + ray * high)).1.1.try_normalize(1e-9)?;
        Some((high, normal))
    }
}

/// The contacts' extents about their middle along their principal axes, as a matrix; of the plane in its first two rows
/// and columns, with 1 in the last.
fn extents(dimension: usize, centre: &Point, contacts: &[Contact]) -> Matrix3<f64> {
    let eigen = SymmetricEigen::new(scatter(contacts.iter().map(|c| c.point), centre));
    let most = eigen.eigenvalues.max().sqrt();
    let mut stretch = Matrix3::zeros();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        let is_across = dimension == 2 && vector.z.abs() > 0.5;
        let extent = if is_across { 1.0 } else { (value.max(0.0).sqrt() / most).max(FLAT) };
        stretch += vector * vector.transpose() * extent;
    }
    stretch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::body::tests::touch;
    use crate::model::body::{Part, Plane};
    use crate::reference::Prior;

    fn body(parts: Vec<Part>) -> Body {
        Body { parts, modes: vec![], oddity: 0.0, chi_squared: 0.0, degrees: 0.0 }
    }

    /// Contacts in the middle of each side of a block of such half widths about a middle; two in the plane.
    fn sides(halves: &[f64], middle: Point) -> (Vec<Contact>, Body) {
        let out = |axis: usize, way: f64| Point::ith(axis, way);
        let places = (0..halves.len()).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]);
        let contact = |(axis, way): (usize, f64)| {
            touch(middle + out(axis, way) * halves[axis], out(axis, way))
        };
        let plane = |(axis, way): (usize, f64)| {
            let normal = out(axis, way);
            Part::Plane(Plane { normal, offset: normal.dot(&middle) + halves[axis] })
        };
        (places.clone().map(contact).collect(), body(places.map(plane).collect()))
    }

    #[test]
    fn sizes_are_those_of_text_books() {
        let middle = Point::new(0.3, -0.1, 0.05);
        for (halves, truth) in [
            (vec![0.06, 0.03], 0.36),
            (vec![0.11, 0.008], 0.472),
            (vec![0.06, 0.03, 0.02], 0.0288),
            (vec![0.1, 0.005, 0.005], 0.0082),
            (vec![0.1, 0.06, 0.003], 0.051_84),
        ] {
            let flat = if halves.len() == 2 { Point::new(0.3, -0.1, 0.0) } else { middle };
            let (contacts, body) = sides(&halves, flat);
            let size = body.size(halves.len(), &contacts).unwrap();
            assert!((size / truth - 1.0).abs() < 0.02, "{halves:?} {size} {truth}");
        }
        let (contacts, _) = sides(&[0.05, 0.05, 0.05], middle);
        let ball = body(vec![Part::Prior(Prior::Ball { centre: middle, radius: 0.05 })]);
        assert!((ball.size(3, &contacts).unwrap() / 0.031_416 - 1.0).abs() < 1e-3);
        // From another place than its middle.
        let off = middle + Point::new(0.01, 0.02, -0.01);
        let ball = body(vec![Part::Prior(Prior::Ball { centre: off, radius: 0.05 })]);
        assert!((ball.size(3, &contacts).unwrap() / 0.031_416 - 1.0).abs() < 1e-2);
    }

    #[test]
    fn what_is_open_or_elsewhere_has_no_size() {
        let (contacts, block) = sides(&[0.06, 0.03, 0.02], Point::zeros());
        let open = body(block.parts[1..].to_vec());
        assert_eq!(open.size(3, &contacts), None);
        let (far, _) = sides(&[0.06, 0.03, 0.02], Point::x());
        assert_eq!(block.size(3, &far), None);
        assert_eq!(block.size(3, &[]), None);
        assert_eq!(block.size(3, &contacts[..1]), None);
        let none = Contact { point: Point::new(f64::NAN, 0.0, 0.0), ..contacts[0] };
        assert_eq!(block.size(3, &[&contacts[..], &[none]].concat()), None);
    }
}
