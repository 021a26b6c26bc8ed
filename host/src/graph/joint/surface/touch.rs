//! Contacts on the surface of a Gaussian process, which is itself in doubt.

use nalgebra::{Matrix4, Matrix4x6, SMatrix, SVector, Vector4, Vector6};

use crate::graph::joint::lone::Normal;
use crate::graph::joint::problem::Problem;
use crate::graph::joint::tangent::axes;
use crate::reference::gpis::Evaluation;
use crate::reference::{Contact, Gpis};
use crate::space::Pose;

/// A field flatter than this says nothing about distance.
const LEAST_SLOPE: f64 = 0.3;

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
    for (contact, at) in met(surface, contacts, pose) {
        let Some(touch) = touch(problem, &contact, &at) else { continue };
        let by_pose = SMatrix::<f64, 4, D>::from_fn(|r, c| touch.by_pose[(r, chosen[c])]);
        square += by_pose.tr_mul(&by_pose);
        slope += by_pose.tr_mul(&touch.residual);
    }
    (square, slope)
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
    /// By the tangent of the pose.
    by_pose: Matrix4x6<f64>,
    /// −ln of its density.
    cost: f64,
}

/// Of a contact (object frame); `None` where the field has no direction.
fn touch(problem: &Problem, contact: &Contact, at: &Evaluation) -> Option<Touch> {
    let slope = at.gradient.norm();
    if !(slope > LEAST_SLOPE) {
        return None;
    }
    let n = at.gradient / slope;
    let open = (at.variance.max(0.0).sqrt(), at.gradient_variance.max(0.0).sqrt());
    let widened = Contact {
        point_deviation: contact.point_deviation.hypot(open.0 / slope),
        normal_deviation: contact.normal_deviation.hypot(open.1 / slope),
        ..*contact
    };
    let exact = widened.point_deviation.recip();
    let mut residual = Vector4::zeros();
    let mut by_pose = Matrix4x6::zeros();
    residual[0] = exact * at.value / slope;
    let lever = n.cross(&contact.point);
    by_pose.row_mut(0).copy_from(
        &(Vector6::new(-n.x, -n.y, -n.z, lever.x, lever.y, lever.z) * exact).transpose(),
    );
    if let Some(m) = contact.normal {
        let exact = widened.normal_deviation.recip();
        residual.fixed_rows_mut::<3>(1).copy_from(&((m - n) * exact));
        by_pose.fixed_view_mut::<3, 3>(1, 3).copy_from(&(m.cross_matrix() * exact));
    }
    let off = problem.kernel.cost(residual[0].powi(2));
    let turned = problem.kernel.cost(residual.fixed_rows::<3>(1).norm_squared());
    let cost = off.0 + turned.0 + problem.exact(&widened);
    let [off, turned] = [off.1.sqrt(), turned.1.sqrt()];
    let weights = Matrix4::from_diagonal(&Vector4::new(off, turned, turned, turned));
    Some(Touch { residual: weights * residual, by_pose: weights * by_pose, cost })
}
