//! What links are made of: convex bodies, and where they are.

use std::path::{Path, PathBuf};

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::shape::SharedShape;

use super::problem::Problem;
use super::{LONGEST, Solid};
use crate::shape::files::read_mesh;
use crate::space::{Point, Pose};

/// A finite pose of sensible size; `place` names it in errors.
pub(super) fn pose(pose: &urdf_rs::Pose, place: impl Fn() -> String) -> Result<Pose, Problem> {
    let (xyz, rpy) = (pose.xyz.0, pose.rpy.0);
    if !xyz.iter().all(|x| x.abs() <= LONGEST) {
        return Err(Problem::Number { place: place(), what: "xyz", found: xyz.to_vec() });
    }
    if !rpy.iter().all(|x| x.abs() <= 1e3) {
        return Err(Problem::Number { place: place(), what: "rpy", found: rpy.to_vec() });
    }
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Pose::from_parts(Translation3::from(Point::from(xyz)), rotation))
}

/// A body of a link, its mesh looked for from `folder` on.
pub(super) fn solid(
    collision: &urdf_rs::Collision,
    link: &str,
    folder: Option<&Path>,
) -> Result<Solid, Problem> {
    let origin = pose(&collision.origin, || format!("link {link:?}"))?;
    let sizes = |what: &'static str, found: &[f64]| {
        if found.iter().all(|x| *x > 0.0 && *x <= LONGEST) {
            return Ok(());
        }
        Err(Problem::Size { link: link.into(), what, found: found.to_vec() })
    };
    // parry's cylinders and capsules stand along y, those of the URDF along z.
    let upright =
        origin * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    Ok(match &collision.geometry {
        urdf_rs::Geometry::Box { size } => {
            sizes("box", &size.0)?;
            let half = Vector3::from(size.0) / 2.0;
            let shape = cuboid(&half).ok_or_else(|| Problem::Size {
                link: link.into(),
                what: "box",
                found: size.to_vec(),
            })?;
            Solid { origin, shape, radius: half.norm() }
        }
        urdf_rs::Geometry::Cylinder { radius, length } => {
            sizes("cylinder", &[*radius, *length])?;
            let shape = SharedShape::cylinder(length / 2.0, *radius);
            Solid { origin: upright, shape, radius: (length / 2.0).hypot(*radius) }
        }
        urdf_rs::Geometry::Capsule { radius, length } => {
            sizes("capsule", &[*radius, *length])?;
            let shape = SharedShape::capsule_y(length / 2.0, *radius);
            Solid { origin: upright, shape, radius: length / 2.0 + radius }
        }
        urdf_rs::Geometry::Sphere { radius } => {
            sizes("sphere", &[*radius])?;
            Solid { origin, shape: SharedShape::ball(*radius), radius: *radius }
        }
        urdf_rs::Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |s| s.0);
            if !scale.iter().all(|s| s.is_finite() && *s != 0.0) {
                return Err(Problem::Size {
                    link: link.into(),
                    what: "scale",
                    found: scale.into(),
                });
            }
            let file = locate(filename, folder)
                .ok_or_else(|| Problem::Package { link: link.into(), uri: filename.clone() })?;
            let mesh =
                read_mesh(&file).map_err(|source| Problem::Mesh { link: link.into(), source })?;
            let scaled = |v: &Point| Vector::new(v.x * scale[0], v.y * scale[1], v.z * scale[2]);
            let points: Vec<Vector> = mesh.vertices().iter().map(scaled).collect();
            let radius = points.iter().map(|p| p.length()).fold(0.0, f64::max);
            if radius > LONGEST {
                return Err(Problem::Number {
                    place: format!("link {link:?}"),
                    what: "mesh of radius",
                    found: vec![radius],
                });
            }
            let flat = || Problem::Flat { link: link.into(), file: file.clone() };
            if !spans_volume(&points) {
                return Err(flat());
            }
            let shape = SharedShape::convex_hull(&points).ok_or_else(flat)?;
            Solid { origin, shape, radius }
        }
    })
}

/// A box as the hull of its corners: to parry's own boxes [`crate::shape::Mesh::nearest`] has no true
/// distance.
pub(in super::super) fn cuboid(half: &Point) -> Option<SharedShape> {
    let side = |i: usize, axis: usize| if i >> axis & 1 == 1 { half[axis] } else { -half[axis] };
    let corners: Vec<Vector> =
        (0..8).map(|i| Vector::new(side(i, 0), side(i, 1), side(i, 2))).collect();
    SharedShape::convex_hull(&corners)
}

/// Whether the points are no plane: the least of their principal extents is above a hundredth of a
/// millimetre.
fn spans_volume(points: &[Vector]) -> bool {
    let n = points.len().max(1) as f64;
    let mean = points.iter().fold(Point::zeros(), |m, p| m + Point::new(p.x, p.y, p.z)) / n;
    let mut covariance = nalgebra::Matrix3::zeros();
    for p in points {
        let d = Point::new(p.x, p.y, p.z) - mean;
        covariance += d * d.transpose() / n;
    }
    points.len() >= 4 && covariance.symmetric_eigenvalues().min() > 1e-10
}

/// The file that a URDF means: relative to its folder, or in a package that lies there or above.
fn locate(uri: &str, folder: Option<&Path>) -> Option<PathBuf> {
    let here = folder.unwrap_or(Path::new(""));
    let Some(inside) = uri.strip_prefix("package://") else {
        return Some(here.join(uri.strip_prefix("file://").unwrap_or(uri)));
    };
    let (package, rest) = inside.split_once('/')?;
    let here = here.canonicalize().unwrap_or_else(|_| here.into());
    here.ancestors()
        .flat_map(|up| {
            let named = up.file_name().is_some_and(|n| n == package).then(|| up.join(rest));
            named.into_iter().chain([up.join(package).join(rest)])
        })
        .find(|file| file.is_file())
}
