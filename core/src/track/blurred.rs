//! A contact felt at a pose that is not known exactly.

use crate::contact::Contact;
use crate::math;
use crate::matrix::{Coordinates, Square};
use crate::space::Space;

/// The contact (object frame) with the doubt about its pose in its deviations: of the point along its
/// normal, or in all directions alike without one, and of the normal. `covariance` is in tangent
/// coordinates at the pose.
#[inline(never)]
pub(super) fn blurred<S: Space>(contact: &Contact<S>, covariance: &S::Covariance) -> Contact<S> {
    let variance = |direction| variance::<S>(contact.point, direction, covariance);
    let along = match contact.normal {
        Some(normal) => variance(normal),
        None => {
            let axis = |k| variance(S::Vector::from_fn(|i| f32::from(u8::from(i == k))));
            (0..S::DIMENSION).map(axis).sum::<f32>() / S::DIMENSION as f32
        }
    };
    let turns = (S::DIMENSION..S::FREEDOM).map(|i| covariance.at(i, i)).sum::<f32>();
    let turn = turns / (S::FREEDOM - S::DIMENSION) as f32;
    let add = |deviation: f32, more: f32| {
        math::sqrt(deviation * deviation + if more > 0.0 { more } else { 0.0 })
    };
    Contact {
        point_deviation: add(contact.point_deviation, along),
        normal_deviation: add(contact.normal_deviation, turn),
        ..*contact
    }
}

/// Of a point (object frame) along a direction: what the doubt about the pose makes of it.
#[inline(never)]
fn variance<S: Space>(point: S::Vector, direction: S::Vector, covariance: &S::Covariance) -> f32 {
    let h = S::lever(point, direction);
    let mut along = 0.0;
    for i in 0..S::FREEDOM {
        for j in 0..S::FREEDOM {
            along += h[i] * covariance.at(i, j) * h[j];
        }
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Vector;
    use crate::space::Planar;

    #[test]
    fn doubt_counts_along_the_normal_or_everywhere() {
        let contact = Contact::<Planar> {
            point: Vector([0.1, 0.0]),
            normal: Some(Vector([0.0, 1.0])),
            point_deviation: 1e-3,
            normal_deviation: 0.1,
            finger: 0,
        };
        // 3 mm along x, and 0.04 rad: 4 mm at 0.1 m.
        let mut covariance = <Planar as Space>::Covariance::ZERO;
        *covariance.at_mut(0, 0) = 9e-6;
        *covariance.at_mut(2, 2) = 0.04 * 0.04;
        let seen = blurred(&contact, &covariance);
        assert!((seen.point_deviation - math::sqrt(1e-6 + 16e-6)).abs() < 1e-6);
        assert!((seen.normal_deviation - math::sqrt(0.01 + 0.0016)).abs() < 1e-6);
        let bare = blurred(&Contact { normal: None, ..contact }, &covariance);
        assert!((bare.point_deviation - math::sqrt(1e-6 + 12.5e-6)).abs() < 1e-6);
    }
}
