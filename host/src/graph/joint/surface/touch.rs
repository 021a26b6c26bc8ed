//! Contacts on the surface of a Gaussian process, which is itself in doubt.

use nalgebra::{Matrix3, Matrix4, Matrix4x6, SMatrix, SVector, Vector4, Vector6};

use crate::graph::joint::lone::Normal;
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::axes;
use crate::reference::gpis::Evaluation;
use crate::reference::{Contact, Gpis};
use crate::space::{Point, Pose};

/// A field flatter than this says nothing about distance.
const LEAST_SLOPE: f64 = 0.3;

/// Difference of a point for how the gradient changes, metres.
const NUDGE: f64 = 1e-6;

/// Contacts (world frame) of an object at this pose in its own frame, with the surface there.
fn met(
    surface: &Gpis,
    contacts: &[Contact],
    pose: &Pose,
) -> impl Iterator<Item = (Contact, Evaluation)> {
    let inverse = pose.inverse();
    let placed: Vec<Contact> = contacts.iter().map(|c| c.transformed(&inverse)).collect();
    let points: Vec<_> = placed.iter().map(|c| c.point).collect();
    placed.into_iter().zip(surface.evaluate(&points))
}

/// JᵀJ and Jᵀr of contacts (world frame) on the surface, by the tangent of the pose.
pub(super) fn normal<const D: usize>(
    problem: &Problem,
    surface: &Gpis,
    contacts: &[Contact],
    pose: &Pose,
) -> Normal<D> {
    let (mut square, mut slope) = (SMatrix::zeros(), SVector::zeros());
    let chosen = axes::<D>();
    let met: Vec<(Contact, Evaluation)> = met(surface, contacts, pose).collect();
    let bends = bends(problem.dimension, surface, &met);
    for ((contact, at), bend) in met.iter().zip(&bends) {
        let Some(touch) = touch(problem, contact, at) else { continue };
        let by_pose = touch.by_pose(contact, bend);
        let by_pose = SMatrix::<f64, 4, D>::from_fn(|r, c| by_pose[(r, chosen[c])]);
        square += by_pose.tr_mul(&by_pose);
        slope += by_pose.tr_mul(&touch.residual);
    }
    (square, slope)
}

/// By how much the field's gradient changes along each axis: the normal of a curved surface turns as the
/// contact moves along it, so that a ball turned about its middle stays as it is.
fn bends(dimension: usize, surface: &Gpis, met: &[(Contact, Evaluation)]) -> Vec<Matrix3<f64>> {
    let mut bends = vec![Matrix3::zeros(); met.len()];
    for axis in 0..dimension {
        let moved: Vec<Point> =
            met.iter().map(|(c, _)| c.point + Point::ith(axis, NUDGE)).collect();
        let moved = surface.gradients(&moved);
        for ((bend, moved), (_, at)) in bends.iter_mut().zip(moved).zip(met) {
            bend.set_column(axis, &((moved - at.gradient) / NUDGE));
        }
    }
    bends
}

/// What contacts (world frame) cost on the surface, each for itself, nats.
pub(super) fn cost(problem: &Problem, surface: &Gpis, contacts: &[Contact], pose: &Pose) -> f64 {
    met(surface, contacts, pose)
        .map(|(contact, at)| match touch(problem, &contact, &at) {
            Some(touch) => touch.cost,
            None => problem.unexplained(&contact),
        })
        .sum()
}

/// A contact on the surface.
struct Touch {
    /// Distance and normal in standard deviations that hold the surface's own, robustly weighted.
    residual: Vector4<f64>,
    /// Of distance and normal: the robust weight's root over the deviation.
    exact: [f64; 2],
    /// Length and direction of the field's gradient.
    slope: f64,
    direction: Point,
    /// −ln of its density.
    cost: f64,
}

/// Of a contact (object frame); `None` where the field has no direction.
fn touch(problem: &Problem, contact: &Contact, at: &Evaluation) -> Option<Touch> {
    let slope = at.gradient.norm();
    if !(slope > LEAST_SLOPE) {
        return None;
    }
    let direction = at.gradient / slope;
    let open = (at.variance.max(0.0).sqrt(), at.gradient_variance.max(0.0).sqrt());
    let widened = Contact {
        point_deviation: contact.point_deviation.hypot(open.0 / slope),
        normal_deviation: contact.normal_deviation.hypot(open.1 / slope),
        ..*contact
    };
    let mut residual = Vector4::zeros();
    residual[0] = at.value / (slope * widened.point_deviation);
    if let Some(m) = contact.normal {
        let off = (m - direction) / widened.normal_deviation;
        residual.fixed_rows_mut::<3>(1).copy_from(&off);
    }
    let off = problem.kernel.cost(residual[0].powi(2));
    let turned = problem.kernel.cost(residual.fixed_rows::<3>(1).norm_squared());
    let cost = off.0 + turned.0 + problem.exact(&widened);
    let [off, turned] = [off.1.sqrt(), turned.1.sqrt()];
    let weights = Matrix4::from_diagonal(&Vector4::new(off, turned, turned, turned));
    let exact = [off / widened.point_deviation, turned / widened.normal_deviation];
    Some(Touch { residual: weights * residual, exact, slope, direction, cost })
}

impl Touch {
    /// The residual by the tangent of the pose, where the field's gradient has the derivative `bend`; its
    /// length, the deviations and the weights as they are.
    fn by_pose(&self, contact: &Contact, bend: &Matrix3<f64>) -> Matrix4x6<f64> {
        let n = self.direction;
        let mut by_pose = Matrix4x6::zeros();
        let lever = n.cross(&contact.point);
        let [off, turned] = self.exact;
        let row = Vector6::new(-n.x, -n.y, -n.z, lever.x, lever.y, lever.z) * off;
        by_pose.row_mut(0).copy_from(&row.transpose());
        if let Some(m) = contact.normal {
            let by_point = (bend - n * (n.transpose() * bend)) / self.slope;
            by_pose.fixed_view_mut::<3, 3>(1, 0).copy_from(&(by_point * turned));
            let turning = m.cross_matrix() - by_point * contact.point.cross_matrix();
            by_pose.fixed_view_mut::<3, 3>(1, 3).copy_from(&(turning * turned));
        }
        by_pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::joint::surface::{fitted, placed};
    use crate::graph::joint::tangent::{Tangent, retract};
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    /// The surface of an object's contacts at their true poses, and the contacts' problem.
    fn known(object: &str) -> (Problem, Vec<Pose>, Gpis) {
        let options = Options { grasps: Some(8), ..Options::new(object.parse().unwrap()) };
        let log = simulate(&options).unwrap().log;
        let problem = Problem::new(&log);
        let poses: Vec<Pose> = track::truth(&log).unwrap().iter().map(|s| s.pose).collect();
        let known = fitted::<6>(&problem, poses.clone()).unwrap();
        let surface = known.model.surface(problem.dimension, &placed(&problem, &poses)).unwrap();
        (problem, poses, surface)
    }

    #[test]
    fn a_normal_turns_with_the_surface() {
        for object in ["ellipse:0.12x0.07", "ellipsoid:0.12x0.08x0.06"] {
            let (problem, poses, surface) = known(object);
            let pose = &poses[3];
            // Beside the contacts that made the surface.
            let off = retract(pose, &Tangent::new(3e-3, -2e-3, 0.0, 0.0, 0.0, 0.1));
            let felt: Vec<Contact> = problem.of(3).map(|i| problem.felt[i].contact).collect();
            let met: Vec<_> = met(&surface, &felt, &off).collect();
            let bends = bends(problem.dimension, &surface, &met);
            for (i, ((contact, at), bend)) in met.iter().zip(&bends).enumerate() {
                let here = touch(&problem, contact, at).unwrap();
                let by_pose = here.by_pose(contact, bend);
                for axis in if problem.dimension == 2 { vec![0, 1, 5] } else { (0..6).collect() } {
                    let at = |h: f64| {
                        let moved = retract(&off, &Tangent::ith(axis, h));
                        let (contact, at) = super::met(&surface, &felt, &moved).nth(i).unwrap();
                        contact.normal.unwrap() - touch(&problem, &contact, &at).unwrap().direction
                    };
                    let slope = (at(1e-5) - at(-1e-5)) * (here.exact[1] / 2e-5);
                    let told = by_pose.fixed_view::<3, 1>(1, axis);
                    assert!((slope - told).norm() < 1e-2 * (1.0 + told.norm()), "{object} {axis}");
                }
            }
        }
    }

    #[test]
    fn nobody_sees_a_circle_turn() {
        let (problem, poses, surface) = known("ellipse:0.08x0.08");
        let felt: Vec<Contact> = problem.of(3).map(|i| problem.felt[i].contact).collect();
        // About the middle of the object, where its frame is.
        let (square, _) = normal::<3>(&problem, &surface, &felt, &poses[3]);
        let contacts = felt.len() as f64;
        let exact = contacts / felt[0].normal_deviation.powi(2);
        assert!(square[(2, 2)] < 0.1 * exact, "{} of {exact}", square[(2, 2)]);
    }
}
