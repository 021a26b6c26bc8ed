//! What every tracker owes, whatever it was told before.

use std::boxed::Box;
use std::vec::Vec;

use crate::contact::{Contact, GraspView};
use crate::device::{
    Onboard, PlanarAutomatic, PlanarCurved, PlanarHypotheses, PlanarRaoBlackwell, PlanarTracker,
};
use crate::matrix::{Coordinates, Vector};
use crate::space::{Planar, PlanarPose, Pose};
use crate::surface::{Gpis, Truncated};
use crate::track::{Automatic, Bootstrap, Curved, Hypotheses, RaoBlackwell, Status};

/// Two touches on each side of a rectangle of 100 × 60 mm.
fn touches() -> Vec<Contact<Planar>> {
    [(0.05, [1.0, 0.0]), (0.03, [0.0, 1.0]), (0.05, [-1.0, 0.0]), (0.03, [0.0, -1.0])]
        .into_iter()
        .flat_map(|(half, n)| [-0.02, 0.015].map(|along| (half, Vector(n), along)))
        .map(|(half, n, along)| Contact {
            point: n * half + Vector([-n[1], n[0]]) * along,
            normal: Some(n),
            point_deviation: 1e-3,
            normal_deviation: 0.0873,
            finger: 0,
        })
        .collect()
}

/// Calls `check` with each kind of tracker that a board may have.
macro_rules! each {
    ($check:ident) => {
        $check("bootstrap", &mut *Box::<PlanarTracker>::new(Bootstrap::new(Truncated::new())));
        $check("Rao-Blackwell", &mut *Box::<PlanarRaoBlackwell>::new(RaoBlackwell::new()));
        $check("hypotheses", &mut *Box::<PlanarHypotheses>::new(Hypotheses::new()));
        $check("curved", &mut *Box::<PlanarCurved>::new(Curved::new(Gpis::new())));
        let automatic = Automatic::new(Hypotheses::new(), Curved::new(Gpis::new()));
        $check("automatic", &mut *Box::<PlanarAutomatic>::new(automatic));
    };
}

fn outlives_motions<T: Onboard<Planar>>(name: &str, tracker: &mut T) {
    let contacts = touches();
    tracker.prepare();
    let mut grasp = |motion: Option<&PlanarPose>| {
        tracker.update(motion, GraspView { contacts: &contacts, free: &[] })
    };
    let mut estimate = grasp(None);
    for motion in [[3e38, 3e38, 0.7], [3e38, 3e38, 0.7], [-2e19, 0.0, 0.0], [f32::NAN, 0.0, 0.0]] {
        let far = PlanarPose::new(Vector([motion[0], motion[1]]), motion[2]);
        estimate = grasp(Some(&far));
        assert!(estimate.pose.is_finite(), "{name} after {motion:?}");
    }
    for _ in 0..4 {
        estimate = grasp(Some(&PlanarPose::IDENTITY));
    }
    assert!(
        matches!(estimate.status, Status::Tracking | Status::Ambiguous),
        "{name}: {estimate:?}"
    );
    assert!(estimate.pose.translation.norm() < 0.02, "{name}: {estimate:?}");
}

#[test]
fn motions_that_no_hand_makes_do_not_lose_the_object() {
    each!(outlives_motions);
}

fn forgets<T: Onboard<Planar>>(name: &str, tracker: &mut T) {
    let contacts = touches();
    tracker.prepare();
    for _ in 0..2 {
        tracker.update(None, GraspView { contacts: &contacts, free: &[] });
        tracker.reset(1);
        assert!(tracker.face(0).is_none(), "{name}");
    }
}

#[test]
fn nothing_is_known_of_the_shape_after_a_reset() {
    each!(forgets);
}
