//! Between the host's double-precision spatial types and the core's spaces.

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use tactile_core::matrix::Vector;
use tactile_core::space::{Planar, PlanarPose, Space, Spatial, SpatialPose};

/// A position or direction: metres, or unit length. Planar data has z = 0.
pub type Point = Vector3<f64>;

/// A rigid transformation, object to world. Planar data turns about z and stays in z = 0.
pub type Pose = Isometry3<f64>;

/// A core space the host can convert to and from.
pub trait Bridge: Space {
    /// To the core, dropping what the space does not have.
    fn vector(point: &Point) -> Self::Vector;
    /// From the core, zero where the space has nothing.
    fn point(vector: &Self::Vector) -> Point;
    /// To the core.
    fn pose(pose: &Pose) -> Self::Pose;
    /// From the core.
    fn isometry(pose: &Self::Pose) -> Pose;
}

impl Bridge for Planar {
    fn vector(p: &Point) -> Vector<2> {
        Vector([p.x as f32, p.y as f32])
    }

    fn point(v: &Vector<2>) -> Point {
        Point::new(v[0] as f64, v[1] as f64, 0.0)
    }

    fn pose(pose: &Pose) -> PlanarPose {
        PlanarPose::new(Self::vector(&pose.translation.vector), angle(pose) as f32)
    }

    fn isometry(pose: &PlanarPose) -> Pose {
        planar(pose.translation[0] as f64, pose.translation[1] as f64, pose.angle() as f64)
    }
}

impl Bridge for Spatial {
    fn vector(p: &Point) -> Vector<3> {
        Vector([p.x as f32, p.y as f32, p.z as f32])
    }

    fn point(v: &Vector<3>) -> Point {
        Point::new(v[0] as f64, v[1] as f64, v[2] as f64)
    }

    fn pose(pose: &Pose) -> SpatialPose {
        let q = pose.rotation.quaternion();
        SpatialPose::new(
            Self::vector(&pose.translation.vector),
            [q.i as f32, q.j as f32, q.k as f32, q.w as f32],
        )
    }

    fn isometry(pose: &SpatialPose) -> Pose {
        let [x, y, z, w] = pose.quaternion().map(f64::from);
        Pose::from_parts(
            Translation3::from(Self::point(&pose.translation)),
            UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
        )
    }
}

/// The pose at (x, y) in metres, turned by `angle` radians about z.
pub fn planar(x: f64, y: f64, angle: f64) -> Pose {
    Pose::from_parts(
        Translation3::new(x, y, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
    )
}

/// The middle of points; of none, the origin.
pub(crate) fn centroid(points: impl Iterator<Item = Point>) -> Point {
    let (sum, count) = points.fold((Point::zeros(), 0.0), |(sum, count), p| (sum + p, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// How points lie about a place: the sum of the squares of their offsets, m². Its eigenvectors are their principal
/// axes.
pub(crate) fn scatter(points: impl Iterator<Item = Point>, about: &Point) -> Matrix3<f64> {
    points.map(|p| p - about).map(|offset| offset * offset.transpose()).sum()
}

/// Two unit directions square to each other and to a unit vector; in the plane the first alone, the other is
/// zero.
pub fn across(dimension: usize, n: &Point) -> [Point; 2] {
    if dimension == 2 {
        return [Point::new(-n.y, n.x, 0.0), Point::zeros()];
    }
    let first = n.cross(&Point::ith(n.iamin(), 1.0)).normalize();
    [first, n.cross(&first)]
}

/// The turn of a planar pose about z, in (−π, π].
pub fn angle(pose: &Pose) -> f64 {
    let q = pose.rotation.quaternion();
    let a = 2.0 * q.k.atan2(q.w);
    a.sin().atan2(a.cos())
}
