//! What a measured normal says about the pose.
//!
//! It turns with the object. But under a finger that stays where it is the object's own normal changes, too, where the
//! surface is round: a turn about the axis of a cylinder is nothing that its normals could show. With the shape
//! operator H, n(p + d) = n(p) + H d, a shift v and a turn ω of what was felt at p change the normal against the
//! surface's there by ω × n − H (v + ω × p): for faces ω × n alone.

use nalgebra::{Matrix3, Vector6};

use super::belief::Belief;
use crate::space::Point;

/// How far to both sides the surface is asked how it bends, in radii of the object, and the chord between normals
/// there from which on an edge lies between them: on either side of it the surface is as flat as it is.
const STEP: f64 = 0.02;
const EDGE: f64 = 0.5;

/// How a normal changes with the pose in one direction across it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turning {
    /// By shift and by turn, object axes.
    pub row: Vector6<f64>,
    /// The axis about which a turn moves a face's normal so.
    pub axis: Point,
}

impl Turning {
    /// Of a unit normal at a point of a surface that bends so: one in the plane, two in space.
    pub fn of(
        dimension: usize,
        point: &Point,
        normal: &Point,
        bend: &Matrix3<f64>,
    ) -> Vec<Turning> {
        let one = |along: Point| {
            let bent = bend.transpose() * along;
            let axis = normal.cross(&along);
            let turn = axis - point.cross(&bent);
            Turning { row: Vector6::new(-bent.x, -bent.y, -bent.z, turn.x, turn.y, turn.z), axis }
        };
        if dimension == 2 {
            return vec![one(Point::z().cross(normal))];
        }
        match normal.cross(&Point::ith(normal.iamin(), 1.0)).try_normalize(1e-9) {
            Some(first) => vec![one(first), one(normal.cross(&first))],
            None => Vec::new(),
        }
    }
}

impl Belief {
    /// The shape operator of the believed surface at some points of it, 1/metre; zero where it has an edge.
    pub(super) fn bends(&self, points: &[Point]) -> Vec<Matrix3<f64>> {
        let step = STEP * self.radius;
        let axes = self.dimension.clamp(2, 3);
        let beside = |p: &Point| {
            let p = *p;
            (0..axes).flat_map(move |a| [step, -step].map(|by| p + Point::ith(a, by)))
        };
        let all: Vec<Point> = points.iter().flat_map(beside).collect();
        let normals: Vec<Option<Point>> = self
            .surface
            .means_and_gradients(&all)
            .into_iter()
            .map(|(_, gradient)| gradient.try_normalize(1e-9))
            .collect();
        let bend = |normals: &[Option<Point>]| {
            let mut bend = Matrix3::zeros();
            for (axis, ends) in normals.chunks_exact(2).enumerate() {
                let [Some(ahead), Some(behind)] = ends else { continue };
                let change = ahead - behind;
                if change.norm() < EDGE {
                    bend.set_column(axis, &(change / (2.0 * step)));
                }
            }
            bend
        };
        normals.chunks_exact(2 * axes).map(bend).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The normal of a ball about the origin, and how it bends.
    fn ball(p: &Point) -> (Point, Matrix3<f64>) {
        let n = p.normalize();
        (n, (Matrix3::identity() - n * n.transpose()) / p.norm())
    }

    #[test]
    fn turns_of_a_ball_about_its_middle_are_not_seen_and_shifts_are() {
        for p in [Point::new(0.03, 0.02, -0.01), Point::new(0.0, -0.04, 0.0)] {
            let (normal, bend) = ball(&p);
            for turning in Turning::of(3, &p, &normal, &bend) {
                assert!(turning.row.fixed_rows::<3>(3).norm() < 1e-12, "{}", turning.row);
                let shift = turning.row.fixed_rows::<3>(0).norm();
                assert!((shift - 1.0 / p.norm()).abs() < 1e-9, "{shift}");
            }
            // A face's sees every turn but that about itself, and no shift.
            let flat: Vec<Turning> = Turning::of(3, &p, &normal, &Matrix3::zeros());
            let seen: f64 = flat.iter().map(|t| t.row.fixed_rows::<3>(3).norm_squared()).sum();
            assert!((seen - 2.0).abs() < 1e-12);
            for turning in flat {
                assert!(turning.row.fixed_rows::<3>(0).norm() == 0.0);
                assert!(turning.row.fixed_rows::<3>(3).dot(&normal).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn in_the_plane_a_circle_hides_its_turn_and_an_ellipse_shows_it() {
        // At an end of the long axis the normal turns against the surface's by 1 − a/(b²/a), at one of the short
        // axis by 1 − b/(a²/b).
        let (a, b): (f64, f64) = (0.05, 0.03);
        for (point, curvature) in
            [(Point::new(a, 0.0, 0.0), a / (b * b)), (Point::new(0.0, b, 0.0), b / (a * a))]
        {
            let normal = point.normalize();
            let along = Point::z().cross(&normal);
            let bend = along * along.transpose() * curvature;
            let [turning] = Turning::of(2, &point, &normal, &bend)[..] else { panic!() };
            assert!((turning.row[5] - (1.0 - curvature * point.norm())).abs() < 1e-12);
        }
    }
}
