//! The bare point cloud: contacts as they are, the simplest representation of a shape (thesis 2.1).

use rayon::prelude::*;

use super::Geometry;
use super::metrics::{Distances, both_ways, judged, summary};
use crate::space::Point;

/// Points on a surface, with nothing between them.
///
/// ```
/// use tactile_host::shape::cloud::Cloud;
/// use tactile_host::shape::{Geometry, Outline};
/// use tactile_host::space::Point;
///
/// let square = vec![[0.0, 0.0], [0.04, 0.0], [0.04, 0.04], [0.0, 0.04]];
/// let square = Geometry::Outline(Outline::new(vec![square])?);
/// let cloud = Cloud::new([Point::new(0.02, 0.0, 0.0), Point::new(0.02, 0.04, 0.0)]);
/// // Both points are on the square, but the middles of the other sides are far from them.
/// assert!((cloud.compare(&square).unwrap().hausdorff - 0.02_f64.hypot(0.02)).abs() < 1e-4);
/// # Ok::<(), tactile_host::shape::ShapeError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Metres, in the frame of whatever it is compared with.
    pub points: Vec<Point>,
}

impl Cloud {
    /// The cloud of these points.
    pub fn new(points: impl IntoIterator<Item = Point>) -> Cloud {
        Cloud { points: points.into_iter().collect() }
    }

    /// Distance from `p` to the nearest point, metres; infinite without any.
    pub fn distance(&self, p: &Point) -> f64 {
        self.points.iter().map(|q| (p - q).norm_squared()).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// How far the cloud and a surface are apart, both ways: from each point to the surface, and from
    /// the surface (its even samples and vertices, see
    /// [`metrics::compare`](super::metrics::compare)) to the nearest point. `None` without points,
    /// without a surface, or when a coordinate is not finite.
    pub fn compare(&self, truth: &Geometry) -> Option<Distances> {
        if self.points.is_empty() {
            return None;
        }
        let there: Vec<f64> = self.points.par_iter().map(|p| truth.distance(p)).collect();
        let (even, corners) = judged(truth);
        let distances = |points: &[Point]| -> Vec<f64> {
            points.par_iter().map(|p| self.distance(p)).collect()
        };
        both_ways(summary(&there, &[]), summary(&distances(&even), &distances(&corners)))
            .filter(|_| !even.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::ObjectSpec;

    fn truth(object: &str) -> Geometry {
        object.parse::<ObjectSpec>().unwrap().geometry().unwrap()
    }

    #[test]
    fn gaps_between_points_count() {
        let circle = truth("ellipse:0.08x0.08");
        let opposite = Cloud::new([Point::new(0.04, 0.0, 0.0), Point::new(-0.04, 0.0, 0.0)]);
        let d = opposite.compare(&circle).unwrap();
        assert!((d.hausdorff - 0.04 * 2f64.sqrt()).abs() < 1e-4);
        // Half of the mean is the way from points on the circle: nothing.
        let chord = |half: f64| 2.0 * 0.04 * (half / 2.0).sin();
        let steps = 10_000;
        let mean = (0..steps)
            .map(|i| chord((f64::from(i) + 0.5) / f64::from(steps) * std::f64::consts::FRAC_PI_2))
            .sum::<f64>()
            / f64::from(steps);
        assert!((d.mean - mean / 2.0).abs() < 1e-5, "{d:?} {mean}");
    }

    #[test]
    fn a_point_off_the_surface_counts() {
        let sphere = truth("sphere:0.08");
        let mut points: Vec<Point> = sphere.samples(3000).into_iter().map(|s| s.0).collect();
        let dense = Cloud::new(points.clone()).compare(&sphere).unwrap();
        assert!(dense.hausdorff < 5e-3 && dense.mean < 1e-3);
        points.push(Point::new(0.0, 0.0, 0.06));
        let wild = Cloud::new(points).compare(&sphere).unwrap();
        assert!((wild.hausdorff - 0.02).abs() < 1e-4);
    }

    #[test]
    fn nothing_and_not_a_number_compare_with_nothing() {
        let sphere = truth("sphere:0.08");
        assert_eq!(Cloud::new([]).compare(&sphere), None);
        assert_eq!(Cloud::new([Point::repeat(f64::NAN)]).compare(&sphere), None);
        let nothing = Geometry::Outline(crate::shape::Outline { loops: vec![] });
        assert_eq!(Cloud::new([Point::zeros()]).compare(&nothing), None);
    }
}
