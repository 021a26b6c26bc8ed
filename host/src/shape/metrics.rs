//! Distances between an estimated and a true surface.

use nalgebra::Point3;
use rayon::prelude::*;

use super::Geometry;
use crate::space::{Point, Pose};

/// Points drawn from each planar shape: one in 0.2 mm around a 400 mm outline.
const PLANAR_SAMPLES: usize = 2_000;

/// Points drawn from each mesh: one a square millimetre on a fist-sized object.
const SPATIAL_SAMPLES: usize = 20_000;

/// How far two surfaces are apart, metres. Every figure looks both ways: from each surface to the
/// other one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    /// The greatest distance from any point of either surface to the other surface.
    pub hausdorff: f64,
    /// Mean distance over both surfaces, each weighing one half.
    pub mean: f64,
    /// Root mean square distance over both surfaces, each weighing one half.
    pub rms: f64,
}

/// Compares two shapes in one frame. Points are drawn evenly from both surfaces, and the distance
/// of each to the other surface is exact; vertices count for the Hausdorff distance too, so that
/// corners are never missed. That distance is the thesis' (C.1–C.3) over these points: over all
/// points of the surfaces it is greater by at most the distance to the nearest of them: 0.1 mm
/// around a 400 mm outline, a millimetre inside the facets of a fist-sized mesh. `None` if either
/// shape is empty, if one is planar and the other is not, or if a coordinate is not finite.
pub fn compare(estimate: &Geometry, truth: &Geometry) -> Option<Distances> {
    compare_at(estimate, &Pose::identity(), truth)
}

/// Compares `estimate` moved by `pose` (estimate's frame to truth's) with `truth`; see [`compare`].
pub fn compare_at(estimate: &Geometry, pose: &Pose, truth: &Geometry) -> Option<Distances> {
    if !comparable(estimate, truth) {
        return None;
    }
    // Distances do not change under rigid motion: the truth's points are moved back instead of
    // building the estimate anew.
    let there = one_way(estimate, pose, truth);
    let back = one_way(truth, &pose.inverse(), estimate);
    both_ways(there, back)
}

/// The Hausdorff distance of [`compare_at`] where it is below `limit`, metres; gives up at the first
/// point that is not.
pub(super) fn nearer_than(
    limit: f64,
    estimate: &Geometry,
    pose: &Pose,
    truth: &Geometry,
) -> Option<f64> {
    if !comparable(estimate, truth) {
        return None;
    }
    let greatest = |from: &Geometry, pose: &Pose, to: &Geometry| {
        let (even, corners) = judged(from);
        let distances = corners.par_iter().chain(&even).map(|p| {
            let distance = to.distance(&(pose * Point3::from(*p)).coords);
            (distance < limit).then_some(distance)
        });
        distances.try_reduce(|| 0.0, |a, b| Some(a.max(b)))
    };
    let there = greatest(estimate, pose, truth)?;
    Some(there.max(greatest(truth, &pose.inverse(), estimate)?))
}

/// C.1 of the thesis for the Hausdorff distance, and both ways alike for mean and root mean square;
/// `None` when a figure is not finite.
pub(super) fn both_ways(there: Distances, back: Distances) -> Option<Distances> {
    let both = Distances {
        hausdorff: there.hausdorff.max(back.hausdorff),
        mean: 0.5 * (there.mean + back.mean),
        rms: (0.5 * (there.rms.powi(2) + back.rms.powi(2))).sqrt(),
    };
    (both.hausdorff.is_finite() && both.rms.is_finite()).then_some(both)
}

/// Whether a shape has no surface at all.
pub fn is_empty(shape: &Geometry) -> bool {
    match shape {
        Geometry::Outline(o) => o.loops.iter().all(|l| l.len() < 2),
        Geometry::Mesh(m) => m.triangles().is_empty(),
    }
}

/// Whether two shapes are of one dimension and neither is empty.
pub(super) fn comparable(a: &Geometry, b: &Geometry) -> bool {
    a.dimension() == b.dimension() && !is_empty(a) && !is_empty(b)
}

/// The vertices that belong to the surface, metres.
fn vertices(shape: &Geometry) -> Vec<Point> {
    match shape {
        Geometry::Outline(o) => {
            o.loops.iter().flatten().map(|v| Point::new(v[0], v[1], 0.0)).collect()
        }
        Geometry::Mesh(m) => {
            let mut used = vec![false; m.vertices().len()];
            for v in m.triangles().iter().flatten() {
                if let Some(used) = used.get_mut(*v as usize) {
                    *used = true;
                }
            }
            m.vertices().iter().zip(used).filter(|(_, u)| *u).map(|(v, _)| *v).collect()
        }
    }
}

/// The points a shape is judged at: drawn evenly, and its vertices.
pub(super) fn judged(shape: &Geometry) -> (Vec<Point>, Vec<Point>) {
    let count = match shape {
        Geometry::Outline(_) => PLANAR_SAMPLES,
        Geometry::Mesh(_) => SPATIAL_SAMPLES,
    };
    (shape.samples(count).into_iter().map(|(p, _)| p).collect(), vertices(shape))
}

/// Distances from the points of `from`, moved by `pose`, to the surface `to`.
fn one_way(from: &Geometry, pose: &Pose, to: &Geometry) -> Distances {
    let distance = |p: &Point| to.distance(&(pose * Point3::from(*p)).coords);
    let (even, corners) = judged(from);
    let distances = |points: &[Point]| points.par_iter().map(distance).collect::<Vec<f64>>();
    summary(&distances(&even), &distances(&corners))
}

/// One way's figures from the distances of evenly drawn points and of vertices: C.2 or C.3 of the
/// thesis.
pub(super) fn summary(even: &[f64], corners: &[f64]) -> Distances {
    let greatest = |a: f64, b: &f64| if b.is_nan() || *b > a { *b } else { a };
    let n = even.len().max(1) as f64;
    Distances {
        hausdorff: even.iter().chain(corners).fold(0.0, greatest),
        mean: even.iter().sum::<f64>() / n,
        rms: (even.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::mesh::tests::cuboid;
    use crate::shape::{Mesh, Outline};
    use crate::space::planar;
    use proptest::prelude::*;

    fn circle(radius: f64) -> Geometry {
        let turn = |i: i32| std::f64::consts::TAU * f64::from(i) / 720.0;
        let vertices = (0..720).map(|i| [radius * turn(i).cos(), radius * turn(i).sin()]).collect();
        Geometry::Outline(Outline { loops: vec![vertices] })
    }

    fn square(half: f64) -> Geometry {
        let vertices = vec![[-half, -half], [half, -half], [half, half], [-half, half]];
        Geometry::Outline(Outline { loops: vec![vertices] })
    }

    #[test]
    fn concentric_circles_are_their_radii_apart() {
        let d = compare(&circle(0.05), &circle(0.047)).unwrap();
        for figure in [d.hausdorff, d.mean, d.rms] {
            assert!((figure - 0.003).abs() < 1e-5, "{d:?}");
        }
    }

    #[test]
    fn a_shifted_square_is_its_shift_apart() {
        let shift = 0.004;
        let d =
            compare(&square(0.03).transformed(&planar(shift, 0.0, 0.0)), &square(0.03)).unwrap();
        assert!((d.hausdorff - shift).abs() < 1e-12);
        // Two of four sides slide along themselves; what juts out there at one end is made up for
        // by the ends of the other two, which come close to the sides that slid.
        assert!((d.mean - shift / 2.0).abs() < 1e-5, "{d:?}");
    }

    #[test]
    fn corners_count_for_the_hausdorff_distance() {
        let d = compare(&square(0.03), &square(0.031)).unwrap();
        assert!((d.hausdorff - 0.001 * 2f64.sqrt()).abs() < 1e-12);
        let d = compare(&Geometry::Mesh(cuboid([0.03; 3])), &Geometry::Mesh(cuboid([0.032; 3])))
            .unwrap();
        assert!((d.hausdorff - 0.002 * 3f64.sqrt()).abs() < 1e-9);
        assert!(d.mean > 0.002 && d.mean < 0.0022, "{d:?}");
    }

    #[test]
    fn a_limit_changes_whether_there_is_an_answer_but_not_which() {
        let (a, b) = (circle(0.05), square(0.04));
        let pose = planar(0.003, -0.002, 0.1);
        let whole = compare_at(&a, &pose, &b).unwrap().hausdorff;
        assert_eq!(nearer_than(1.01 * whole, &a, &pose, &b), Some(whole));
        assert_eq!(nearer_than(whole, &a, &pose, &b), None);
        assert_eq!(
            nearer_than(1.0, &a, &pose, &Geometry::Outline(Outline { loops: vec![] })),
            None
        );
    }

    #[test]
    fn missing_part_of_the_truth_shows() {
        let whole = circle(0.05);
        let Geometry::Outline(Outline { loops }) = &whole else { unreachable!() };
        let half = Geometry::Outline(Outline { loops: vec![loops[0][..361].to_vec()] });
        let d = compare(&half, &whole).unwrap();
        assert!((d.hausdorff - 0.05).abs() < 1e-4, "{d:?}");
        assert_eq!(compare(&half, &whole), Some(compare(&whole, &half).unwrap()));
    }

    #[test]
    fn nothing_compares_with_the_empty_shape_or_another_dimension() {
        let nothing = Geometry::Outline(Outline { loops: vec![] });
        assert_eq!(compare(&nothing, &circle(0.05)), None);
        assert_eq!(compare(&circle(0.05), &nothing), None);
        assert_eq!(compare(&circle(0.05), &Geometry::Mesh(cuboid([0.05; 3]))), None);
        let no_mesh = Geometry::Mesh(Mesh::new(vec![], vec![]).unwrap());
        assert_eq!(compare(&no_mesh, &Geometry::Mesh(cuboid([0.05; 3]))), None);
        assert!(
            is_empty(&nothing)
                && is_empty(&no_mesh)
                && !is_empty(&Geometry::Mesh(cuboid([0.1; 3])))
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        #[test]
        fn the_closest_point_is_on_the_surface_and_as_near_as_the_distance(
            x in -0.1..0.1, y in -0.1..0.1, z in -0.1..0.1,
        ) {
            for shape in [square(0.03), circle(0.05), Geometry::Mesh(cuboid([0.03, 0.04, 0.02]))] {
                let flat = if shape.dimension() == 2 { 0.0 } else { z };
                let point = Point::new(x, y, flat);
                let closest = shape.closest(&point);
                prop_assert!(shape.distance(&closest) < 1e-12);
                prop_assert!(((closest - point).norm() - shape.distance(&point)).abs() < 1e-12);
            }
        }

        #[test]
        fn a_common_motion_changes_nothing(x in -0.1..0.1, y in -0.1..0.1, turn in -3.0..3.0) {
            let pose = planar(x, y, turn);
            let (a, b) = (square(0.03), circle(0.033));
            let still = compare(&a, &b).unwrap();
            let moved = compare(&a.transformed(&pose), &b.transformed(&pose)).unwrap();
            prop_assert!((still.hausdorff - moved.hausdorff).abs() < 1e-9);
            prop_assert!((still.mean - moved.mean).abs() < 1e-6);
            let at = compare_at(&a, &pose, &b).unwrap();
            let explicit = compare(&a.transformed(&pose), &b).unwrap();
            prop_assert!((at.hausdorff - explicit.hausdorff).abs() < 1e-9);
        }
    }
}
