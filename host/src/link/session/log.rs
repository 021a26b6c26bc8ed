//! A whole log through a board.

use tactile_core::track::MotionNoise;
use tactile_core::wire::{Hello, Settings, WireSpace};

use super::{GraspOutcome, LogOutcome, Session, SessionError};
use crate::link::Link;
use crate::link::lesson::Lesson;
use crate::log::GraspLog;
use crate::slam::{track, usual_deviations};
use crate::space::Bridge;

impl<S: Bridge + WireSpace, L: Link> Session<S, L> {
    /// Configures the board and feeds it a whole log; `each` is called after every grasp with its
    /// number in the log.
    ///
    /// # Errors
    /// When the log has another dimension, or as every command.
    pub fn run(
        self,
        log: &GraspLog,
        settings: Settings,
        mut each: impl FnMut(usize, &GraspOutcome<S>),
    ) -> Result<LogOutcome<S>, SessionError> {
        self.run_taught(log, settings, |number, _, outcomes| {
            if let Some(last) = outcomes.last() {
                each(number, last);
            }
            None
        })
    }

    /// The same with a teacher, who is asked after every grasp with its number, who answered, and all
    /// outcomes so far.
    ///
    /// # Errors
    /// As [`run`](Self::run), and where the board does not take a lesson.
    pub fn run_taught(
        mut self,
        log: &GraspLog,
        settings: Settings,
        mut teacher: impl FnMut(usize, &Hello, &[GraspOutcome<S>]) -> Option<Lesson<S>>,
    ) -> Result<LogOutcome<S>, SessionError> {
        let hello = match self.hello {
            Some(hello) if log.dimension == S::DIMENSION => hello,
            _ => {
                let board = self.hello.map_or(S::DIMENSION as u8, |h| h.dimension);
                return Err(SessionError::Dimension { board, log: log.dimension });
            }
        };
        self.configure(settings)?;
        let mut grasps = Vec::with_capacity(log.grasps.len());
        for (number, grasp) in log.grasps.iter().enumerate() {
            let motion = grasp.motion.as_ref().map(S::pose);
            let contacts = track::contacts::<S>(grasp, &log.noise);
            let free = track::free_points::<S>(grasp);
            let outcome = self.grasp(motion.as_ref(), &contacts, &free)?;
            grasps.push(outcome);
            if let Some(lesson) = teacher(number, &hello, &grasps) {
                self.teach(&lesson)?;
            }
        }
        let received = *self.decoder.counters();
        Ok(LogOutcome { hello, grasps, received, repeated: self.repeated, shown: 0 })
    }
}

/// The board's settings for a log: the noise that [`crate::slam`] assumes of it.
pub fn settings_for(log: &GraspLog, seed: u64) -> Settings {
    let MotionNoise { translation, rotation } = track::settings(log, seed).motion;
    let (point, normal) = usual_deviations(&log.noise);
    Settings { point: point as f32, normal: normal as f32, translation, rotation, seed }
}
