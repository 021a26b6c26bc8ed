//! What every tracker owes, whatever it was told before.

use std::boxed::Box;
use std::vec::Vec;

use crate::contact::{Contact, GraspView};
use crate::device::{
    Onboard, PlanarAutomatic, PlanarCurved, PlanarHypotheses, PlanarRaoBlackwell, PlanarTracker,
};
use crate::matrix::Vector;
use crate::space::Planar;
use crate::surface::{Gpis, Truncated};
use crate::track::{Automatic, Bootstrap, Curved, Hypotheses, RaoBlackwell};

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
