//! What the object did between two grasps beside what the hand says: it slipped a little, or, rarely,
//! it was carried away.

use nalgebra::{Cholesky, SMatrix};

use super::factors::{Kernel, step};
use super::problem::{Motion, Problem, either};
use super::tangent::axes;
use crate::space::{Point, Pose};

/// Nats by which an object that was carried away is rarer than one that slipped a little.
const CARRIED: f64 = 5.0;

/// How far it may be then, metres.
const ROOM: f64 = 1.0;

/// The part of a motion that has a say all the same: something has to hold a grasp that no face does.
const LOOSE: f64 = 1e-6;

impl Problem {
    /// What the motion before a grasp costs between the poses `before` and `after` it, slips about `centre`.
    pub fn moved(&self, grasp: usize, before: &Pose, after: &Pose, centre: &Point) -> f64 {
        let Motion { pose, deviations, .. } = &self.motions[grasp];
        let step = step(before, after, pose, *deviations, centre);
        self.slip(grasp, step.residual.norm_squared()).0
    }

    /// What a squared residual of the motion before a grasp costs, nats, and the weight at which least squares
    /// has the same gradient. Robustly, so that one slip does not bend what lies around it, and no more than it
    /// costs that the object was carried to anywhere: else, of an object that was, a second one beside it would be
    /// cheaper.
    pub fn slip(&self, grasp: usize, squared: f64) -> (f64, f64) {
        let (slipped, weight) = Kernel::USUAL.cost(squared);
        let (cost, chance) = either(slipped, self.carried(grasp));
        (cost, weight * chance.max(LOOSE))
    }

    /// Whether that residual is rather one of an object that was carried away.
    pub fn is_carried(&self, grasp: usize, squared: f64) -> bool {
        Kernel::USUAL.cost(squared).0 > self.carried(grasp)
    }

    /// χ² of the motion before a grasp between the `poses`, robustly, and how many numbers of the contacts go
    /// into the pose after it, of which they say as much as is `felt`. A measured motion is as many numbers
    /// as a pose has; one that nobody measured, or of an object that was rather carried away, says nothing, so
    /// that contacts have to.
    pub(super) fn told<const D: usize>(
        &self,
        grasp: usize,
        poses: &[Pose],
        centre: &Point,
        felt: impl FnOnce() -> SMatrix<f64, D, D>,
    ) -> (f64, f64) {
        let Motion { pose, deviations, measured } = &self.motions[grasp];
        let step = step(&poses[grasp - 1], &poses[grasp], pose, *deviations, centre);
        let squared = step.residual.norm_squared();
        let (cost, weight) = self.slip(grasp, squared);
        if *measured && !self.is_carried(grasp, squared) {
            return (2.0 * cost, 0.0);
        }
        // Directions that contacts leave open stay with the motion, however little it says.
        let felt = felt();
        let both = felt + information::<6, D>(&step.by_after) * weight;
        (0.0, Cholesky::new(both).map_or(0.0, |both| both.solve(&felt).trace()))
    }

    /// −ln of how likely it is that the object was carried away before a grasp, over how likely that it is where
    /// the motion says: a uniform density of places and turns over a normal one's peak.
    fn carried(&self, grasp: usize) -> f64 {
        use std::f64::consts::{PI, TAU};
        let [length, angle] =
            self.motions[grasp].deviations.map(|deviation| TAU.sqrt() * deviation);
        let room = if self.dimension == 2 {
            (ROOM / length).powi(2) * TAU / angle
        } else {
            (ROOM / length).powi(3) * 8.0 * PI.powi(2) / angle.powi(3)
        };
        CARRIED + room.ln().max(0.0)
    }
}

/// What residuals say of a pose, by its tangent, whose derivatives they are.
pub(super) fn information<const R: usize, const D: usize>(
    by_pose: &SMatrix<f64, R, 6>,
) -> SMatrix<f64, D, D> {
    let chosen = axes::<D>();
    let rows = SMatrix::<f64, R, D>::from_fn(|r, c| by_pose[(r, chosen[c])]);
    rows.tr_mul(&rows)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::graph::joint;
    use crate::quantity::{Deviation, Displacement};
    use crate::sim::{Options, Simulation, simulate};
    use crate::slam::trackers::Kind;

    fn carried(object: &str, seed: u64) -> Simulation {
        let motion_noise = Deviation { length: 2.5e-3, angle: 5f64.to_radians() };
        let carried = Some(Displacement { length: 0.3, angle: 1.0 });
        let options = Options::new(object.parse().unwrap());
        simulate(&Options { motion_noise, carried, seed, ..options }).unwrap()
    }

    #[test]
    fn a_slip_costs_what_it_did_and_no_more_than_to_be_carried_away() {
        for object in ["triangle:0.06", "box:0.1x0.06x0.05"] {
            let problem = Problem::new(&carried(object, 1).log);
            let cost = |residual: f64| problem.slip(1, residual * residual);
            for residual in [0.0, 0.5, 1.0, 3.0, 4.0] {
                let usual = Kernel::USUAL.cost(residual * residual);
                assert!((cost(residual).0 - usual.0).abs() < 1e-3, "{residual}");
                assert!((cost(residual).1 - usual.1).abs() < 1e-3, "{residual}");
                assert!(!problem.is_carried(1, residual * residual));
            }
            let far = cost(120.0).0;
            assert!(problem.is_carried(1, 120.0 * 120.0) && (15.0..40.0).contains(&far), "{far}");
            // The weight is the cost's slope by half the square.
            for step in 1..40 {
                let (residual, h) = (0.5 * f64::from(step), 1e-4);
                let slope = (cost(residual + h).0 - cost(residual - h).0) / (2.0 * h);
                let said = residual * cost(residual).1;
                assert!((slope - said).abs() < 1e-4, "{residual}: {slope} {said}");
                assert!(cost(residual + 0.5).0 >= cost(residual).0);
            }
        }
    }

    #[test]
    fn an_object_that_was_carried_away_does_not_become_two() {
        let Simulation { log, geometry, .. } = carried("triangle:0.06", 901);
        let steps = Kind::Hypotheses.follow(&log, 0);
        let found = joint::correct(&log, &steps).unwrap();
        assert_eq!(found.faces.len(), 3);
        for (grasp, step) in log.grasps.iter().zip(&found.steps) {
            for contact in &grasp.contacts {
                let point = (step.pose.inverse() * Point3::from(contact.point)).coords;
                // In the frame of the first grasp, which is nearly the true one's.
                let to_truth = log.grasps[0].truth.unwrap().inverse() * found.steps[0].pose;
                let off = geometry.distance(&(to_truth * Point3::from(point)).coords);
                assert!(off < 0.015, "{}: {off}", grasp.index);
            }
        }
    }
}
