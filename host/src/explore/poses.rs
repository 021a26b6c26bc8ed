//! The poses of all grasps while an object is explored: the tracker's, corrected by a graph.

use std::time::Instant;

use tactile_core::track::Status;

use crate::graph::joint::{self, Effort};
use crate::graph::{Corrected, Kind};
use crate::log::GraspLog;
use crate::slam::track::{Follower, Step};
use crate::space::Pose;

use super::episode::Settings;

/// Grasps from which on flat faces are estimated together with the poses without a search: two may have
/// felt different parts of the object.
const FEWEST: usize = 3;

/// What faces must explain to be believed of so few grasps: this share of the contacts, with at most so
/// much χ² per degree of freedom. About 1 on flat faces and above 1.5 on an ellipse.
const EXPLAINED: f64 = 0.9;
const FLAT: f64 = 1.5;

/// No search: the faces that the tracker's poses suggest, settled together with the poses.
const SETTLED: Effort = Effort { rounds: 0, restarts: false, retrack: false };

/// The poses of all grasps as they are known now.
pub(super) struct Poses {
    tracker: Option<Follower>,
    graph: Kind,
    taken: usize,
    /// What the graph made of all grasps taken; `None` where the tracker's poses stand.
    pub corrected: Option<Corrected>,
    /// What tracker and graph have taken, seconds.
    pub tracking: f64,
    /// See `tracking`.
    pub correcting: f64,
}

impl Poses {
    pub fn new(log: &GraspLog, settings: &Settings) -> Poses {
        let tracker = settings.tracker.map(|kind| kind.start(log, settings.seed));
        let (graph, corrected) = (settings.graph, None);
        Poses { tracker, graph, taken: 0, corrected, tracking: 0.0, correcting: 0.0 }
    }

    /// Takes the grasps that are new in the log.
    pub fn after(&mut self, log: &GraspLog) -> Vec<Step> {
        let Some(tracker) = &mut self.tracker else {
            return vec![Step::certain(Pose::identity()); log.grasps.len()];
        };
        let begun = Instant::now();
        for grasp in log.grasps.iter().skip(self.taken) {
            tracker.take(grasp, &log.noise);
        }
        self.taken = log.grasps.len();
        let steps = tracker.steps();
        self.tracking += begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        self.corrected = corrected(self.graph, log, &steps);
        self.correcting += begun.elapsed().as_secs_f64();
        self.corrected.as_ref().map_or(steps, |corrected| corrected.steps.clone())
    }
}

/// The steps as the graph has them, `None` where they stand. The joint graph searches only where there
/// are enough grasps to tell one set of faces from another ([`joint::correct`]); of fewer, what the
/// tracker's own faces, parallel and square ones among them, say about all poses together is better than
/// what a filter made of one grasp after the other.
fn corrected(graph: Kind, log: &GraspLog, steps: &[Step]) -> Option<Corrected> {
    if let Some(corrected) = graph.correct(log, steps) {
        return Some(corrected);
    }
    if graph != Kind::Planes || steps.len() < FEWEST {
        return None;
    }
    let settled = joint::planes(log, &[steps], SETTLED)?;
    let flat = settled.explained() >= EXPLAINED && settled.per_degree <= FLAT;
    flat.then(|| Corrected::jointly(log, settled))
}

/// Whether the tracker could not explain the last grasp.
pub(super) fn is_lost(steps: &[Step]) -> bool {
    steps.last().is_some_and(|s| s.status == Status::Lost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::with_room;
    use crate::quantity::Deviation;
    use crate::sim::{Options, Simulation, simulate};
    use crate::slam::gauge::gauge;
    use crate::slam::trackers;

    fn simulation(object: &str, grasps: usize, seed: u64) -> Simulation {
        let motion_noise = Deviation { length: 5e-3, angle: 10f64.to_radians() };
        let spec = object.parse().unwrap();
        simulate(&Options { grasps: Some(grasps), motion_noise, seed, ..Options::new(spec) })
            .unwrap()
    }

    /// Root mean square turn of the poses off the true ones, radians.
    fn turned(simulation: &Simulation, steps: &[Step]) -> f64 {
        let frame = gauge(&simulation.log, steps, &simulation.geometry).unwrap().inverse();
        let off = simulation.log.grasps.iter().zip(steps).map(|(grasp, step)| {
            (step.pose * frame).rotation.angle_to(&grasp.truth.unwrap().rotation).powi(2)
        });
        (off.sum::<f64>() / steps.len() as f64).sqrt()
    }

    #[test]
    fn a_few_grasps_of_flat_faces_are_corrected_together() {
        let error = |graph: Kind| {
            let mut errors: Vec<f64> = (1000..1009)
                .map(|seed| {
                    let simulation = simulation("rectangle:0.1x0.06", 5, seed);
                    let log = &simulation.log;
                    let steps = trackers::Kind::Hypotheses.follow(log, seed);
                    turned(&simulation, &corrected(graph, log, &steps).map_or(steps, |c| c.steps))
                })
                .collect();
            errors.sort_by(f64::total_cmp);
            errors[4]
        };
        let (alone, together) = with_room(|| (error(Kind::None), error(Kind::Planes)));
        assert!(together < 0.8 * alone, "{together} {alone}");
    }

    #[test]
    fn what_is_curved_or_hardly_felt_stays_with_the_tracker() {
        let accepted = |object: &str, grasps: usize| {
            let one = |seed: &u64| {
                let log = simulation(object, grasps, *seed).log;
                let steps = trackers::Kind::Hypotheses.follow(&log, *seed);
                corrected(Kind::Planes, &log, &steps).is_some()
            };
            (1000..1012).filter(one).count()
        };
        let (little, flat, curved) = with_room(|| {
            let flat = |grasps| accepted("rectangle:0.1x0.06", grasps);
            (flat(2), flat(6), accepted("ellipse:0.08x0.06", 6))
        });
        assert_eq!(little, 0);
        assert!(flat >= 9 && curved <= 6, "{flat} {curved}");
    }
}
