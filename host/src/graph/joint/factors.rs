//! Residuals of the graph and their derivatives, each in standard deviations.

use nalgebra::{Matrix3, Matrix4x3, Matrix4x6, Matrix6, Vector4, Vector6};

use super::tangent::{Face, Tangent, local, log_jacobian};
use crate::reference::Contact;
use crate::space::{Point, Pose};

/// Charbonnier's (soft-L1) kernel: a parabola up to about `bound` deviations, a straight line beyond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// In deviations.
    pub bound: f64,
}

impl Kernel {
    /// Robust against the occasional wild contact, as good as least squares without one.
    pub const USUAL: Kernel = Kernel { bound: 2.5 };

    /// What a squared residual costs (in nats: half of it where it is small), and the weight at which
    /// least squares has the same gradient.
    pub fn cost(&self, squared: f64) -> (f64, f64) {
        let limit = self.bound * self.bound;
        let root = (1.0 + squared / limit).sqrt();
        (limit * (root - 1.0), 1.0 / root)
    }
}

/// A contact on a face, with derivatives with respect to the pose and to the face (turns along its
/// tangents, offset). The first row is the distance, the other three the difference of the normals;
/// they are zero for a contact without a normal.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// In standard deviations.
    pub residual: Vector4<f64>,
    /// By the pose's tangent.
    pub by_pose: Matrix4x6<f64>,
    /// By the face's turns and offset.
    pub by_face: Matrix4x3<f64>,
}

/// (n·p − ρ)/σ_p and (N − n)/σ_θ of a contact given in the world frame. The chord |N − n| rather than
/// its tangent part, because that is zero for the opposite face too.
pub fn touch(pose: &Pose, face: &Face, dimension: usize, contact: &Contact) -> Touch {
    let felt = contact.transformed(&pose.inverse());
    let (p, n) = (felt.point, face.normal);
    let tangents = face.tangents(dimension);
    let mut touch = Touch {
        residual: Vector4::zeros(),
        by_pose: Matrix4x6::zeros(),
        by_face: Matrix4x3::zeros(),
    };
    let exact = 1.0 / contact.point_deviation;
    touch.residual[0] = exact * face.value(&p);
    let lever = n.cross(&p);
    for i in 0..3 {
        touch.by_pose[(0, i)] = -exact * n[i];
        touch.by_pose[(0, 3 + i)] = exact * lever[i];
    }
    for (i, t) in tangents.iter().enumerate() {
        touch.by_face[(0, i)] = exact * t.dot(&p);
    }
    touch.by_face[(0, 2)] = -exact;
    if let Some(m) = felt.normal {
        let exact = 1.0 / contact.normal_deviation;
        touch.residual.fixed_rows_mut::<3>(1).copy_from(&((m - n) * exact));
        touch.by_pose.fixed_view_mut::<3, 3>(1, 3).copy_from(&(m.cross_matrix() * exact));
        for (i, t) in tangents.iter().enumerate() {
            touch.by_face.fixed_view_mut::<3, 1>(1, i).copy_from(&(t * -exact));
        }
    }
    touch
}

/// A motion between two grasps, with the derivatives with respect to both poses.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// In standard deviations.
    pub residual: Vector6<f64>,
    /// By the tangent of the pose before.
    pub by_before: Matrix6<f64>,
    /// By the tangent of the pose after.
    pub by_after: Matrix6<f64>,
}

/// The tangent from motion ∘ `before` to `after`, over the deviations of translation and rotation. It
/// turns about `centre` (object frame): objects slip about their own middle, not about the middle of
/// the first grasp, where the object frame happens to be.
pub fn step(
    before: &Pose,
    after: &Pose,
    motion: &Pose,
    deviations: [f64; 2],
    centre: &Point,
) -> Step {
    let predicted = motion * before;
    let error: Tangent = local(&predicted, after);
    let turned = predicted.rotation.inverse() * after.rotation;
    let moved = error.fixed_rows::<3>(0).into_owned() + turned * centre;
    let (t, w) = (moved - centre, error.fixed_rows::<3>(3).into_owned());
    let [exact_t, exact_w] = deviations.map(|d| 1.0 / d);
    let logarithm = log_jacobian(&w);
    let mut step = Step {
        residual: Vector6::zeros(),
        by_before: Matrix6::zeros(),
        by_after: Matrix6::zeros(),
    };
    step.residual.fixed_rows_mut::<3>(0).copy_from(&(t * exact_t));
    step.residual.fixed_rows_mut::<3>(3).copy_from(&(w * exact_w));
    let rotation = turned.to_rotation_matrix();
    step.by_after.fixed_view_mut::<3, 3>(0, 0).copy_from(&(rotation.matrix() * exact_t));
    let lever = rotation.matrix() * centre.cross_matrix();
    step.by_after.fixed_view_mut::<3, 3>(0, 3).copy_from(&(lever * -exact_t));
    step.by_after.fixed_view_mut::<3, 3>(3, 3).copy_from(&(logarithm * exact_w));
    step.by_before.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * -exact_t));
    step.by_before.fixed_view_mut::<3, 3>(0, 3).copy_from(&(moved.cross_matrix() * exact_t));
    step.by_before.fixed_view_mut::<3, 3>(3, 3).copy_from(&(logarithm.transpose() * -exact_w));
    step
}

#[cfg(test)]
mod tests {
    use super::super::tangent::retract;
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose> {
        proptest::array::uniform6(-0.9f64..0.9)
            .prop_map(|t| retract(&Pose::identity(), &Tangent::from(t)))
    }

    fn direction() -> impl Strategy<Value = Point> {
        proptest::array::uniform3(-1.0f64..1.0)
            .prop_filter_map("too short", |v| Point::from(v).try_normalize(0.1))
    }

    const H: f64 = 1e-6;

    proptest! {
        #[test]
        fn a_contact_has_the_derivatives_it_says(
            pose in pose(),
            n in direction(),
            m in direction(),
            p in proptest::array::uniform3(-0.2f64..0.2),
        ) {
            let face = Face { normal: n, offset: 0.02 };
            let contact = Contact {
                point: Point::from(p),
                normal: Some(m),
                point_deviation: 0.5,
                normal_deviation: 0.3,
            };
            let all = touch(&pose, &face, 3, &contact);
            for k in 0..6 {
                let at = |h: f64| {
                    let moved = retract(&pose, &(Tangent::ith(k, h)));
                    touch(&moved, &face, 3, &contact).residual
                };
                prop_assert!(((at(H) - at(-H)) / (2.0 * H) - all.by_pose.column(k)).norm() < 1e-6);
            }
            for k in 0..3 {
                let at = |h: f64| {
                    let mut change = [0.0; 3];
                    change[k] = h;
                    touch(&pose, &face.retract(3, &change), 3, &contact).residual
                };
                prop_assert!(((at(H) - at(-H)) / (2.0 * H) - all.by_face.column(k)).norm() < 1e-6);
            }
            let bare = touch(&pose, &face, 3, &Contact { normal: None, ..contact });
            prop_assert!(bare.residual[0] == all.residual[0] && bare.residual.rows(1, 3).norm() == 0.0);
        }

        #[test]
        fn a_motion_has_the_derivatives_it_says(
            before in pose(),
            motion in pose(),
            off in proptest::array::uniform6(-0.7f64..0.7),
            centre in proptest::array::uniform3(-0.2f64..0.2),
        ) {
            let after = retract(&(motion * before), &Tangent::from(off));
            let deviations = [0.2, 0.4];
            let centre = Point::from(centre);
            let all = step(&before, &after, &motion, deviations, &centre);
            let turn = retract(&Pose::identity(), &Tangent::from(off)).rotation;
            let shift = Point::new(off[0], off[1], off[2]) + turn * centre - centre;
            prop_assert!((all.residual.fixed_rows::<3>(0) - shift / 0.2).norm() < 1e-9);
            prop_assert!((all.residual[5] - off[5] / 0.4).abs() < 1e-9);
            for k in 0..6 {
                let at = |h: f64, first: bool| {
                    let by = |p: &Pose| retract(p, &Tangent::ith(k, h));
                    let (b, a) = if first { (by(&before), after) } else { (before, by(&after)) };
                    step(&b, &a, &motion, deviations, &centre).residual
                };
                let slope = |first| (at(H, first) - at(-H, first)) / (2.0 * H);
                prop_assert!((slope(true) - all.by_before.column(k)).norm() < 1e-6);
                prop_assert!((slope(false) - all.by_after.column(k)).norm() < 1e-6);
            }
        }

        #[test]
        fn the_kernel_is_a_parabola_and_then_a_line(r in 0.0f64..40.0) {
            let (cost, weight) = Kernel::USUAL.cost(r * r);
            prop_assert!(cost <= 0.5 * r * r + 1e-12 && cost <= 2.5 * r);
            let slope = (Kernel::USUAL.cost((r + H).powi(2)).0 - cost) / H;
            prop_assert!((slope - weight * r).abs() < 1e-4);
        }
    }

    #[test]
    fn the_opposite_face_is_as_far_as_can_be() {
        let contact = Contact {
            point: Point::zeros(),
            normal: Some(Point::x()),
            point_deviation: 1e-3,
            normal_deviation: 0.1,
        };
        let at = |n: Point| {
            let face = Face { normal: n, offset: 0.0 };
            touch(&Pose::identity(), &face, 2, &contact).residual.norm()
        };
        assert_eq!(at(Point::x()), 0.0);
        assert!((at(-Point::x()) - 20.0).abs() < 1e-9 && at(Point::y()) < 15.0);
    }
}
