//! A run's trajectory as a pose graph: the poses found and what the hand says it did between them, for
//! any tool of the field.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::graph::pose::g2o::Graph;
use crate::graph::pose::{Edge, Group, PoseGraph, Se2, Se3};
use crate::log::GraspLog;
use crate::slam::track::{Step, settings};
use crate::space::{Pose, angle};

/// How many times the variance of a motion nobody knows is that of one the log states.
const UNKNOWN: f64 = 4.0;

/// Poses are named by their grasp's number and are those of `steps`, object to world; the first one stays.
/// The edge between two grasps is the log's motion as seen from the first of them, with the information
/// of the motion noise, which acts in the object's axes; where the log knows no motion, that the object
/// did not move, with twice that noise. There are as many poses as grasps with a step.
pub fn odometry_graph(log: &GraspLog, steps: &[Step]) -> Graph {
    let noise = settings(log, 0).motion;
    let weights = [noise.translation, noise.rotation].map(|sigma| f64::from(sigma).powi(-2));
    let [translation, rotation] = weights;
    if log.dimension == 2 {
        let flat = |pose: &Pose| Se2::new(pose.translation.x, pose.translation.y, angle(pose));
        let information = Vector3::new(translation, translation, rotation);
        let edge = |measured| (measured, Matrix3::from_diagonal(&information));
        Graph::Planar(chain(log, steps, flat, edge))
    } else {
        let solid =
            |pose: &Pose| Se3 { translation: pose.translation.vector, rotation: pose.rotation };
        // Of half the angle: the error of a rotation is the vector of its quaternion.
        let (t, r) = (translation, 4.0 * rotation);
        let information = Vector6::new(t, t, t, r, r, r);
        let edge = |measured| (measured, Matrix6::from_diagonal(&information));
        Graph::Spatial(chain(log, steps, solid, edge))
    }
}

fn chain<G: Group<D>, const D: usize>(
    log: &GraspLog,
    steps: &[Step],
    group: impl Fn(&Pose) -> G,
    edge: impl Fn(G) -> (G, nalgebra::SMatrix<f64, D, D>),
) -> PoseGraph<G, D> {
    let grasps = log.grasps.iter().zip(steps);
    let poses: Vec<G> = grasps.clone().map(|(_, step)| group(&step.pose)).collect();
    let motions = log.grasps.iter().map(|grasp| grasp.motion);
    let edges = motions.zip(poses.iter().enumerate()).skip(1).map(|(motion, (to, _))| {
        let before = &poses[to - 1];
        let moved = group(&motion.unwrap_or_else(Pose::identity)).compose(before);
        let (measured, known) = edge(before.between(&moved));
        let information = if motion.is_some() { known } else { known / UNKNOWN };
        Edge { from: to - 1, to, measured, information }
    });
    PoseGraph {
        ids: grasps.map(|(grasp, _)| grasp.index).collect(),
        edges: edges.collect(),
        fixed: if poses.is_empty() { vec![] } else { vec![0] },
        poses,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{LoggedGrasp, Noise};
    use crate::space::planar;

    fn log(dimension: usize, motions: &[Option<Pose>]) -> GraspLog {
        let grasp = |(index, motion): (usize, &Option<Pose>)| LoggedGrasp {
            index: 3 + 2 * index as u64,
            motion: *motion,
            ..LoggedGrasp::default()
        };
        let grasps = motions.iter().enumerate().map(grasp).collect();
        let noise = Noise { translation: Some(0.01), rotation: Some(0.1), ..Noise::default() };
        GraspLog {
            dimension,
            grasps,
            noise,
            description: String::new(),
            fingers: vec![],
            shape: None,
            unknown: serde_json::Map::new(),
        }
    }

    #[test]
    fn edges_agree_with_poses_that_moved_as_the_hand_says() {
        for dimension in [2, 3] {
            let motion = planar(0.02, -0.01, 0.4);
            let log = log(dimension, &[None, Some(motion), None]);
            let first = planar(0.3, 0.1, 1.0);
            let last = motion * first * planar(0.01, 0.0, 0.2);
            let steps = [first, motion * first, last].map(Step::certain);
            let (ids, fixed, chi2, edges) = match odometry_graph(&log, &steps) {
                Graph::Planar(g) => (g.ids.clone(), g.fixed.clone(), g.chi2(), g.edges.len()),
                Graph::Spatial(g) => (g.ids.clone(), g.fixed.clone(), g.chi2(), g.edges.len()),
            };
            assert_eq!((ids, fixed, edges), (vec![3, 5, 7], vec![0], 2));
            // Half a deviation of translation, as nobody knows the motion, and one of rotation; of the quaternion's half
            // angle, its sine.
            let turn = if dimension == 2 { 0.2f64 } else { 2.0 * 0.1f64.sin() };
            let expected = 0.25 * (1.0 + (turn / 0.1).powi(2));
            assert!((chi2 - expected).abs() < 1e-5, "{dimension}: {chi2}, not {expected}");
        }
    }
}
