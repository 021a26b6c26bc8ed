//! The outline or mesh of a field's zero set where it was touched.

use nalgebra::Matrix3;

use crate::reference::Contact;
use crate::shape::{Field, Geometry, contour, surface};
use crate::slam::reconstruct::Error;
use crate::space::Point;
use crate::thin::evenly;

/// Lattice cells across the contacts' bounding box: a millimetre on a 120 mm outline, three on a
/// mesh.
const PLANAR_CELLS: f64 = 120.0;
const SPATIAL_CELLS: f64 = 40.0;

/// Contacts that say at most which part of a zero set was touched.
const VOTING: usize = 2_000;

/// How often the spacing is halved where a body in space is so thin that it lies between nodes.
const HALVINGS: usize = 2;

/// Contacts that say at most whether it does, the share of them that may be wild, and the deviations by which
/// others may be off.
const ASKED: usize = 200;
const WILD: f64 = 0.2;
const OFF: f64 = 4.0;

/// The touched part of the zero set, in a box about the contacts that grows until it holds it.
///
/// # Errors
/// Without contacts, or when the contacts span no usable volume.
pub fn extract(
    dimension: usize,
    field: &dyn Field,
    contacts: &[Contact],
) -> Result<(Geometry, Vec<f64>), Error> {
    let cells = if dimension == 2 { PLANAR_CELLS } else { SPATIAL_CELLS };
    extract_at(dimension, field, contacts, cells)
}

/// As [`extract`], with so many lattice cells across the contacts' bounding box; more where a body in space is
/// so thin that they miss it.
///
/// # Errors
/// As [`extract`].
pub fn extract_at(
    dimension: usize,
    field: &dyn Field,
    contacts: &[Contact],
    cells: f64,
) -> Result<(Geometry, Vec<f64>), Error> {
    let mut extent = Extent::of(contacts, cells)?;
    let mut traced = extent.traced(dimension, field)?;
    for _ in 0..HALVINGS {
        if dimension == 2 || !extent.misses(&traced.0, contacts) {
            break;
        }
        extent.spacing *= 0.5;
        // What a coarser lattice showed stands where this one has too many nodes.
        let Ok(finer) = extent.traced(dimension, field) else { break };
        traced = finer;
    }
    Ok(traced)
}

/// Where and how closely to look.
struct Extent {
    low: Point,
    high: Point,
    /// Of the longest side, metres.
    size: f64,
    /// Between nodes, metres.
    spacing: f64,
    /// Contacts that vote.
    voters: Vec<Point>,
}

impl Extent {
    fn of(contacts: &[Contact], cells: f64) -> Result<Extent, Error> {
        let points = || contacts.iter().map(|c| c.point);
        let Some(first) = points().next() else { return Err(Error::NoContacts) };
        let low = points().fold(first, |low, p| low.inf(&p));
        let high = points().fold(first, |high, p| high.sup(&p));
        // As large as what few contacts may leave out, which their noise says.
        let noise = contacts.iter().map(|c| c.point_deviation).fold(f64::INFINITY, f64::min);
        let size = (high - low).amax().max((10.0 * noise).clamp(1e-4, 0.01));
        let voters = evenly(contacts, VOTING).iter().map(|c| c.point).collect();
        Ok(Extent { low, high, size, spacing: size / cells, voters })
    }

    /// In a box that grows until the touched part fits in.
    fn traced(&self, dimension: usize, field: &dyn Field) -> Result<(Geometry, Vec<f64>), Error> {
        let mut margin = 0.3 * self.size;
        loop {
            let reach = Point::repeat(margin);
            let bounds = (self.low - reach, self.high + reach);
            let last = margin > self.size;
            if dimension == 2 {
                let contour = contour::extract(field, bounds, self.spacing)?;
                if last || !contour.clipped {
                    let contour = contour.touched(&self.voters);
                    return Ok((Geometry::Outline(contour.outline), contour.deviations));
                }
            } else {
                let surface = surface::extract(field, bounds, self.spacing)?;
                if last || !surface.clipped {
                    let surface = surface.touched(&self.voters);
                    return Ok((Geometry::Mesh(surface.mesh), surface.deviations));
                }
            }
            margin *= 2.0;
        }
    }

    /// Whether a body as thin as the contacts may lie between the nodes, and more of these than are wild are
    /// away from what was found.
    fn misses(&self, found: &Geometry, contacts: &[Contact]) -> bool {
        let few = evenly(contacts, ASKED);
        let count = few.len() as f64;
        let middle = few.iter().map(|c| c.point).sum::<Point>() / count;
        let offsets = few.iter().map(|c| c.point - middle);
        let scatter: Matrix3<f64> = offsets.map(|off| off * off.transpose()).sum();
        // Half the thickness of a plate, and seven tenths of the radius of a rod.
        let least = (scatter / count).symmetric_eigenvalues().min().max(0.0).sqrt();
        let is_away =
            |c: &&Contact| found.distance(&c.point) > self.spacing + OFF * c.point_deviation;
        least < self.spacing && few.iter().filter(is_away).count() as f64 > WILD * count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A round-ended rod about the x axis, with a radius and half a length, metres.
    struct Rod(f64, f64);

    impl Field for Rod {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            let beside = |p: &Point| p - Point::x() * p.x.clamp(-self.1, self.1);
            points.iter().map(|p| beside(p).norm() - self.0).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            vec![1e-4; points.len()]
        }
    }

    #[test]
    fn a_rod_thinner_than_the_spacing_is_found() {
        let (radius, half) = (2.5e-3, 0.12);
        let touch = |i: i32| {
            let out = Point::new(0.0, f64::from(i).cos(), f64::from(i).sin());
            Contact {
                point: Point::x() * (half * (f64::from(i) / 20.0 - 1.0)) + out * radius,
                normal: Some(out),
                point_deviation: 1e-4,
                normal_deviation: 0.02,
            }
        };
        let contacts: Vec<Contact> = (0..=40).map(touch).collect();
        for cells in [18.0, SPATIAL_CELLS] {
            let (found, _) = extract_at(3, &Rod(radius, half), &contacts, cells).unwrap();
            let off = contacts.iter().map(|c| found.distance(&c.point)).fold(0.0, f64::max);
            assert!(off < 2.0 * radius, "{cells}: {off}");
        }
    }
}
