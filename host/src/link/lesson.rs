//! What a host that has thought all grasps over tells a board: where the object is, and its faces.

use nalgebra::{Matrix6, Vector3};
use tactile_core::matrix::Square;
use tactile_core::wire::{BeliefFrame, FaceFrame, FaceSummary, WireSpace};

use crate::graph::joint::Corrected;
use crate::graph::joint::problem::Problem;
use crate::log::GraspLog;
use crate::model::faces::Owner;
use crate::space::{Bridge, Point, Pose, centroid};

/// A belief and the faces that belong to it, as frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Lesson<S: WireSpace> {
    /// Pose of the last grasp, as uncertain as it is with respect to the faces.
    pub belief: BeliefFrame<S>,
    /// Those that most contacts speak for first.
    pub faces: Vec<FaceFrame<S>>,
}

impl<S: Bridge + WireSpace> Lesson<S> {
    /// What the joint graph made of a log; at most `room` faces. `None` without grasps or faces, as of
    /// a curved object.
    pub fn new(log: &GraspLog, corrected: &Corrected, room: usize) -> Option<Lesson<S>> {
        let (step, covariance) = corrected.steps.last().zip(corrected.given_faces.last())?;
        let belief = BeliefFrame::new(&S::pose(&step.pose), &core_covariance::<S>(covariance));
        let problem = Problem::new(log);
        let poses: Vec<Pose> = corrected.steps.iter().map(|s| s.pose).collect();
        let centre = |face: usize| {
            let own: Vec<Point> = (0..problem.felt.len().min(corrected.owners.len()))
                .filter(|i| corrected.owners[*i] == Some(Owner::Face(face)))
                .map(|i| problem.placed(&poses, i).point)
                .collect();
            let mean = centroid(own.iter().copied());
            let plane = &corrected.faces[face];
            // On the plane itself.
            mean - plane.normal * (plane.normal.dot(&mean) - plane.offset)
        };
        let mut order: Vec<usize> = (0..corrected.faces.len()).collect();
        order.sort_by_key(|face| (usize::MAX - corrected.faces[*face].contacts, *face));
        order.truncate(room.min(usize::from(u8::MAX)));
        let count = order.len() as u8;
        let face = |(number, face): (usize, &usize)| {
            let plane = &corrected.faces[*face];
            let centre = centre(*face);
            let [u, v] = plane.tangents;
            let lever = Vector3::new(u.dot(&centre), v.dot(&centre), -1.0);
            let height = lever.dot(&(plane.covariance * lever)).max(0.0);
            let turns = plane.covariance[(0, 0)] + plane.covariance[(1, 1)];
            let summary = FaceSummary {
                normal: S::vector(&plane.normal),
                centroid: S::vector(&centre),
                deviation: height.sqrt() as f32,
                tilt: (turns.max(0.0) / (log.dimension - 1) as f64).sqrt() as f32,
                contacts: plane.contacts.min(usize::from(u16::MAX)) as u16,
            };
            FaceFrame::new(&summary, number as u8, count)
        };
        let faces: Vec<FaceFrame<S>> = order.iter().enumerate().map(face).collect();
        (!faces.is_empty()).then_some(Lesson { belief, faces })
    }
}

/// A covariance of the host as the core has it.
fn core_covariance<S: Bridge>(covariance: &Matrix6<f64>) -> S::Covariance {
    let axes: &[usize] = if S::DIMENSION == 2 { &[0, 1, 5] } else { &[0, 1, 2, 3, 4, 5] };
    let mut core = S::Covariance::ZERO;
    for (i, &row) in axes.iter().enumerate() {
        for (j, &column) in axes.iter().enumerate() {
            *core.at_mut(i, j) = covariance[(row, column)] as f32;
        }
    }
    core
}

#[cfg(test)]
mod tests {
    use tactile_core::space::Planar;
    use tactile_core::wire::TrackerKind;

    use super::*;
    use crate::graph::joint;
    use crate::link::session::settings_for;
    use crate::link::{Patience, Session, virtual_board};
    use crate::sim::{Options, simulate};
    use crate::slam::track::truth;

    #[test]
    fn a_board_that_was_taught_finds_the_next_grasp_on_the_hosts_faces() {
        let log = simulate(&Options::new("rectangle:0.10x0.06".parse().unwrap())).unwrap().log;
        let steps = truth(&log).unwrap();
        let mut before = log.clone();
        let last = before.grasps.pop().unwrap();
        let corrected = joint::correct(&before, &steps[..15]).unwrap();
        let lesson = Lesson::<Planar>::new(&before, &corrected, 10).unwrap();
        assert_eq!(lesson.faces.len(), 4);
        for face in &lesson.faces {
            let face = face.face();
            assert!(face.deviation < 2e-3 && face.tilt < 0.05 && face.contacts > 5, "{face:?}");
        }
        assert!(Lesson::<Planar>::new(&before, &corrected, 0).is_none());

        // A board that has seen nothing but the lesson.
        let board = virtual_board::start(2, TrackerKind::Hypotheses).unwrap();
        let mut session = Session::<Planar, _>::open(board, Patience::default()).unwrap();
        session.configure(settings_for(&log, 0)).unwrap();
        session.teach(&lesson).unwrap();
        let faces = session.faces().unwrap();
        assert_eq!(faces.len(), 4);
        for (there, here) in faces.iter().zip(&lesson.faces) {
            let apart = there.face().centroid - here.face().centroid;
            assert!(tactile_core::matrix::Coordinates::norm(apart) < 1e-5);
        }
        let motion = last.motion.as_ref().map(Planar::pose);
        let contacts = crate::slam::track::contacts::<Planar>(&last, &log.noise);
        let outcome = session.grasp(motion.as_ref(), &contacts, &[]).unwrap();
        let found = Planar::isometry(&outcome.estimate.pose().unwrap());
        // In the frame that the first grasp's true pose fixed.
        let off = last.truth.unwrap().inverse() * found;
        assert!(off.rotation.angle() < 0.06, "{off}");
        assert!(off.translation.vector.norm() < 6e-3, "{off}");
    }

    #[test]
    fn boards_without_faces_refuse_a_lesson() {
        let log = simulate(&Options::new("rectangle:0.10x0.06".parse().unwrap())).unwrap().log;
        let corrected = joint::correct(&log, &truth(&log).unwrap()).unwrap();
        let lesson = Lesson::<Planar>::new(&log, &corrected, 10).unwrap();
        let board = virtual_board::start(2, TrackerKind::Bootstrap).unwrap();
        let mut session = Session::<Planar, _>::open(board, Patience::default()).unwrap();
        session.configure(settings_for(&log, 0)).unwrap();
        let error = session.teach(&lesson).unwrap_err().to_string();
        assert!(error.contains("cannot be replaced"), "{error}");
    }
}
