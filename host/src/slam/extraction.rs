//! The outline or mesh of a field's zero set where it was touched.

use crate::reference::Contact;
use crate::shape::{Field, Geometry, contour, surface};
use crate::slam::reconstruct::Error;
use crate::space::{Point, centroid, scatter};
use crate::thin::evenly;

/// Lattice cells across the contacts' bounding box: a millimetre on a 120 mm outline, three on a
/// mesh.
const PLANAR_CELLS: f64 = 120.0;
const SPATIAL_CELLS: f64 = 40.0;

/// Contacts that say at most which part of a zero set was touched.
const VOTING: usize = 2_000;

/// The least part of its spacing that a lattice gets where a body in space is thin.
const FINEST: f64 = 0.25;

/// Deviations of the contacts that a body is thick at least: less may be a flat side's.
const THICK: f64 = 2.0;

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
    if dimension == 2 {
        return extent.traced(dimension, field);
    }
    let (coarsest, finest) = (extent.spacing, FINEST * extent.spacing);
    let thickness = extent.thickness(contacts);
    // Between nodes farther apart a body breaks where it does not vanish, and by less than its noise.
    if thickness > THICK * extent.noise {
        extent.spacing = thickness.clamp(finest, coarsest);
    }
    let mut traced = extent.traced(dimension, field);
    // So many nodes may be too many.
    while traced.is_err() && extent.spacing < coarsest {
        extent.spacing = (2.0 * extent.spacing).min(coarsest);
        traced = extent.traced(dimension, field);
    }
    let mut traced = traced?;
    while thickness < extent.spacing
        && 0.5 * extent.spacing >= finest
        && extent.misses(&traced.0, contacts)
    {
        extent.spacing *= 0.5;
        // What a coarser lattice showed stands where this one has too many nodes.
        let Ok(finer) = extent.traced(dimension, field) else { break };
        traced = finer;
    }
    Ok(traced)
}

/// A touched part, with its deviations.
type Traced = (Geometry, Vec<f64>);

/// Where and how closely to look.
struct Extent {
    low: Point,
    high: Point,
    /// Of the longest side, metres.
    size: f64,
    /// Between nodes, metres.
    spacing: f64,
    /// The least deviation of a contact, metres.
    noise: f64,
    /// How many contacts there are.
    count: usize,
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
        Ok(Extent { low, high, size, spacing: size / cells, noise, count: contacts.len(), voters })
    }

    /// In a box that grows until the touched part fits in. One that never does is taken to end about
    /// where the contacts do.
    fn traced(&self, dimension: usize, field: &dyn Field) -> Result<Traced, Error> {
        let mut margin = 0.3 * self.size;
        loop {
            let reach = Point::repeat(margin);
            let bounds = (self.low - reach, self.high + reach);
            let (traced, clipped) = self.within(&bounds, dimension, field)?;
            if !(clipped && self.ended(&bounds, &traced.0) != bounds) {
                return Ok(traced);
            }
            if margin > self.size {
                return Ok(self.within(&self.ended(&bounds, &traced.0), dimension, field)?.0);
            }
            margin *= 2.0;
        }
    }

    /// The touched part in a box, and whether anything reaches the box's edge.
    fn within(
        &self,
        bounds: &(Point, Point),
        dimension: usize,
        field: &dyn Field,
    ) -> Result<(Traced, bool), Error> {
        if dimension == 2 {
            let contour = contour::extract(field, *bounds, self.spacing)?;
            let contour = contour.touched(&self.voters);
            return Ok(((Geometry::Outline(contour.outline), contour.deviations), contour.clipped));
        }
        let surface = surface::extract(field, *bounds, self.spacing)?;
        let surface = surface.touched(&self.voters);
        Ok(((Geometry::Mesh(surface.mesh), surface.deviations), surface.clipped))
    }

    /// The same box, but where what was found in it reaches through a side, only as far beyond the
    /// contacts as they are from each other; together with them no flatter than the least box, for they
    /// may all lie on one side.
    fn ended(&self, bounds: &(Point, Point), found: &Geometry) -> (Point, Point) {
        let (mut low, mut high) = *bounds;
        let vertices = found.vertices();
        for axis in 0..3 {
            let extent = self.high[axis] - self.low[axis];
            let reach = (extent / self.count as f64).max(0.3 * self.size - extent);
            if vertices.iter().any(|v| v[axis] < bounds.0[axis]) {
                low[axis] = self.low[axis] - reach;
            }
            if vertices.iter().any(|v| v[axis] > bounds.1[axis]) {
                high[axis] = self.high[axis] + reach;
            }
        }
        (low, high)
    }

    /// Half the thickness of a plate, and seven tenths of the radius of a rod, touched all over.
    fn thickness(&self, contacts: &[Contact]) -> f64 {
        let points = contacts.iter().map(|c| c.point);
        let scatter = scatter(points.clone(), &centroid(points));
        (scatter / self.count as f64).symmetric_eigenvalues().min().max(0.0).sqrt()
    }

    /// Whether more of the contacts than are wild are away from what was found.
    fn misses(&self, found: &Geometry, contacts: &[Contact]) -> bool {
        let few = evenly(contacts, ASKED);
        let is_away =
            |c: &&Contact| found.distance(&c.point) > self.spacing + OFF * c.point_deviation;
        few.iter().filter(is_away).count() as f64 > WILD * few.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rod about the x axis, with a radius and half a length, metres, and whether its ends are round:
    /// else it has none.
    struct Rod(f64, f64, bool);

    impl Field for Rod {
        fn values(&self, points: &[Point]) -> Vec<f64> {
            let most = if self.2 { self.1 } else { f64::INFINITY };
            let beside = |p: &Point| p - Point::x() * p.x.clamp(-most, most);
            points.iter().map(|p| beside(p).norm() - self.0).collect()
        }

        fn deviations(&self, points: &[Point]) -> Vec<f64> {
            vec![1e-4; points.len()]
        }
    }

    impl Rod {
        /// Contacts along it and all around it.
        fn touched(&self, deviation: f64) -> Vec<Contact> {
            let touch = |i: i32| {
                let out = Point::new(0.0, f64::from(i).cos(), f64::from(i).sin());
                Contact {
                    point: Point::x() * (self.1 * (f64::from(i) / 20.0 - 1.0)) + out * self.0,
                    normal: Some(out),
                    point_deviation: deviation,
                    normal_deviation: 0.02,
                }
            };
            (0..=40).map(touch).collect()
        }

        /// How far at most a contact is from what is found.
        fn off(&self, deviation: f64, cells: f64) -> f64 {
            let contacts = self.touched(deviation);
            let (found, _) = extract_at(3, self, &contacts, cells).unwrap();
            contacts.iter().map(|c| found.distance(&c.point)).fold(0.0, f64::max)
        }
    }

    #[test]
    fn a_rod_thinner_than_the_spacing_is_found() {
        for cells in [18.0, SPATIAL_CELLS] {
            let rod = Rod(2.5e-3, 0.12, true);
            let off = rod.off(1e-4, cells);
            assert!(off < 0.5 * rod.0, "{cells}: {off}");
        }
    }

    /// Also where the contacts' noise would hide that it is broken.
    #[test]
    fn a_rod_about_as_thick_as_the_spacing_is_whole() {
        let off = Rod(6e-3, 0.2, true).off(1e-3, SPATIAL_CELLS);
        assert!(off < 1e-3, "{off}");
    }

    /// One flat side, with noise: there is no body so thin that it would need more nodes.
    #[test]
    fn a_flat_side_is_no_thin_body() {
        let touch = |i: i32| Contact {
            point: Point::new(f64::from(i % 7), f64::from(i / 7), 0.05 * f64::from(i % 3)) * 0.02,
            normal: Some(Point::z()),
            point_deviation: 1e-3,
            normal_deviation: 0.02,
        };
        let contacts: Vec<Contact> = (0..49).map(touch).collect();
        let extent = Extent::of(&contacts, SPATIAL_CELLS).unwrap();
        assert!(extent.thickness(&contacts) < THICK * extent.noise);
    }

    #[test]
    fn a_rod_that_goes_on_for_ever_ends_about_where_it_was_touched() {
        let endless = Rod(0.02, 0.1, false);
        let (found, _) = extract(3, &endless, &endless.touched(1e-3)).unwrap();
        let ends = found
            .vertices()
            .iter()
            .map(|v| v.x)
            .fold((0.0f64, 0.0f64), |ends, x| (ends.0.min(x), ends.1.max(x)));
        assert!(ends.0 < -0.1 && ends.0 > -0.12 && ends.1 > 0.1 && ends.1 < 0.12, "{ends:?}");
        // What nobody touched across from contacts on one side is not cut off with the ends.
        let touched = endless.touched(1e-3).into_iter().filter(|c| c.point.y > 0.018);
        let (found, _) = extract(3, &endless, &touched.collect::<Vec<_>>()).unwrap();
        let across = found.vertices().iter().map(|v| v.y).fold(0.0, f64::min);
        assert!((across + 0.02).abs() < 1e-3, "{across}");
    }
}
