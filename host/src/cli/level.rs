//! Contacts that all lie in one plane, or in one line of it: or too few for anything else.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::slam::place::Placed;
use crate::space::{Point, centroid, scatter};

/// Deviations of a contact up to which those of all contacts across a plane may be noise.
const NOISE: f64 = 2.0;

/// Cosine between the plane's normal and those of contacts on the two faces of a thin plate, whose thickness was felt.
const ACROSS: f64 = 0.7;

/// What is to be said of contacts all in one plane: how far the object reaches on either side of it, nobody felt. So
/// few always lie in one.
pub(super) fn doubt(dimension: usize, placed: &[Placed]) -> Option<String> {
    if placed.len() <= dimension {
        let plural = if placed.len() == 1 { "" } else { "s" };
        let few = format!("only {} contact{plural}: most of the shape is a guess", placed.len());
        return (!placed.is_empty()).then_some(few);
    }
    let count = placed.len() as f64;
    let points = placed.iter().map(|p| p.contact.point);
    let spread = scatter(points.clone(), &centroid(points)) / count;
    let spread = DMatrix::from_fn(dimension, dimension, |row, column| spread[(row, column)]);
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(spread);
    let thin = eigenvalues.imin();
    let along = |row: usize| if row < dimension { eigenvectors[(row, thin)] } else { 0.0 };
    let axis = Point::from_fn(|row, _| along(row));
    let noise = placed.iter().map(|p| p.contact.point_deviation).sum::<f64>() / count;
    let thickness = eigenvalues[thin].max(0.0).sqrt();
    let ways = placed.iter().filter_map(|p| Some(p.contact.normal?.dot(&axis)));
    let is_across = |way: f64| ways.clone().any(|along| way * along > ACROSS);
    let is_level = thickness < NOISE * noise && !(is_across(1.0) && is_across(-1.0));
    is_level.then(|| {
        let plane = if dimension == 2 { "line" } else { "plane" };
        format!(
            "all contacts lie in one {plane}, to {thickness:.4} m: how far the object reaches beside it is not known"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Contact;

    /// Contacts about a rectangle at such a height, which their normals lean to.
    fn touched(height: impl Fn(u32) -> f64, lean: impl Fn(u32) -> f64) -> Vec<Placed> {
        let placed = |i: u32| {
            let (sin, cos) = (0.7 * f64::from(i)).sin_cos();
            let normal = Point::new(cos, sin, lean(i)).normalize();
            let point = Point::new(0.05 * cos, 0.03 * sin, height(i));
            let contact = Contact {
                point,
                normal: Some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.1,
            };
            Placed { contact, grasp: 0 }
        };
        (0..12).map(placed).collect()
    }

    #[test]
    fn contacts_of_one_plane_say_nothing_of_what_is_beside_it() {
        let level = touched(|i| 1e-3 * f64::from(i % 3), |_| 0.0);
        assert!(doubt(3, &level).is_some_and(|d| d.contains("in one plane")));
        // One side of a box.
        assert!(doubt(3, &touched(|_| 0.02, |_| 9.0)).is_some());
        assert_eq!(doubt(2, &level), None);
        let line: Vec<Placed> = (0..5).map(|i| touched(|_| 0.0, |_| 0.0)[i / 4]).collect();
        assert!(doubt(2, &line).is_some_and(|d| d.contains("in one line")));
    }

    #[test]
    fn solids_and_plates_raise_no_doubt_but_very_few_contacts_do() {
        assert_eq!(doubt(3, &touched(|i| 0.01 * f64::from(i % 3), |_| 0.0)), None);
        let way = |i: u32| if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        assert_eq!(doubt(3, &touched(|i| 1e-3 * way(i), |i| 9.0 * way(i))), None);
        let few = touched(|i| 0.01 * f64::from(i % 3), |_| 0.0);
        assert!(doubt(3, &few[..3]).is_some_and(|d| d.starts_with("only 3 contacts: ")));
        assert!(doubt(2, &few[..1]).is_some_and(|d| d.starts_with("only 1 contact: ")));
        assert_eq!(doubt(3, &few[..4]), None);
        assert_eq!(doubt(3, &[]), None);
    }
}
